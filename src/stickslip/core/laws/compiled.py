"""Laws for the compiled core: the struct `Law` of `core.h`, with compiled functions of user-defined laws.

Each role of a law, such as force or cap, becomes one C function that evaluates n contacts of one pair of materials.
Numba compiles it on demand.
"""

import ctypes
import linecache
import os
import re
import types
import warnings
from functools import cache, lru_cache, partial

import numpy as np

from ...builtin_laws import BUILTIN_LAWS, FIRST_OF_OWN
from ...extras import require
from ..library import core
from ..progress import announced
from .builtin import (
    DAMPING_N,
    DAMPING_T,
    KEEPS_FORCE,
    KT,
    LEVER,
    NO_TENSION,
    ROLLING,
    SCALED,
    SMOOTH,
    STEP,
    TWISTING,
    VISCOUS,
    Law,
    damping_model,
    parameter_names,
)
from .kinds import HELP, USER_LAWS, Kind, UserLaw, bound, check_kind, evaluate_role, find_user_law, update_memory
from .properties import angular_columns, dashpot_coefficients
from .validation import sample_points

FORCES = "force", "cap", "range", "rolling", "rolling_cap", "update"
TANGENTS = *FORCES, "slopes", "cap_slopes", "rolling_slopes"
MEMBERS = {  # C functions of a user-defined law, and the Python function that each one needs
    "force": "normal_force",
    "cap": "cap",
    "slopes": "normal_force",
    "cap_slopes": "cap",
    "energy": "normal_force",
    "range": "contact_range",
    "rolling": "rolling_stiffness",
    "rolling_cap": "rolling_cap",
    "rolling_slopes": "rolling_cap",
    "update": "update",
}
_GAUSS = tuple(zip(*np.polynomial.legendre.leggauss(8), strict=True))
_OPTIONS = {"fastmath": True, "error_model": "numpy"}
_OWN = "force", "cap", "slopes", "cap_slopes", "energy", "range", "update"  # members of a law in `normal_laws.cpp`
_INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def law_struct(law: Law, *, rate: bool = False, members=tuple(MEMBERS)) -> dict:
    """Members of the struct of a law.

    Parameters
    ----------
    rate : True if the slip is updated as in LAMMPS
    members : functions of a user-defined law that will be called, such as `FORCES`; others are null
    """
    if isinstance(law.kind, Kind):
        find_user_law(law.kind)
        if "slopes" in members:
            _check_slopes(law.kind, tuple(law.table[0, 0].tolist()))
    return _fixed_members(law.kind, members) | {
        "smooth": law.coulomb == SMOOTH, "damping": damping_model(law) & ~NO_TENSION,
        "tension": not law.damping & NO_TENSION, "rate": rate, "lever": bool(law.properties & LEVER),
        "angular": angular_columns(law), "roll_at": _column(law, ROLLING), "twist_at": _column(law, TWISTING),
        "roll_viscous": bool(law.properties & VISCOUS), "twist_scaled": bool(law.properties & SCALED),
        "keeps_force": bool(law.properties & KEEPS_FORCE), "len_table": len(law.table), "width": law.table.shape[2],
        "table": _table(law),
    }  # fmt: skip


@lru_cache
def _check_slopes(kind: Kind, values: tuple[float, ...]) -> None:
    """Raise ValueError if slopes of the compiled functions differ from those in Python, as can happen for powers."""
    own, call = find_user_law(kind), block_function(kind, "slopes").ctypes
    known = dict(zip(own.names, values, strict=False))  # properties have additional parameters
    for r_eff, overlap in sample_points(own, known, own.size):
        given = [np.array(x, float) for x in (values, [r_eff], [overlap], [0.0], [*own.memory.values()], [0.0], [0.0])]
        pointers = [array.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for array in given]
        call(pointers[0], 1, *pointers[1:])
        at = {"overlap": complex(overlap, STEP), "r_eff": r_eff}
        now = known | update_memory(own, known, **at) | at
        for role, compiled in zip(("normal_force", "tangential_stiffness"), given[-2:], strict=True):
            if role in own.functions:
                slope = own.functions[role](
                    *bound(own, role, now | {"overlap": complex(overlap, STEP), "r_eff": r_eff})
                )
                exact = np.imag(slope) / STEP
                if not np.isclose(compiled[0], exact, rtol=1e-6, atol=1e-9 * abs(exact) + 1e-300):
                    raise ValueError(
                        f"{role} at overlap = {overlap:.4g} has the slope {exact:.4g}, but {compiled[0]:.4g} when "
                        f"compiled: write x * x * x for powers of numbers that may be negative; {HELP}"
                    )


def _column(law: Law, part: int) -> int:
    """Column of the first parameter of a property, after those of previous properties; 0 if the law lacks it."""
    return len(parameter_names(law._replace(properties=law.properties % part))) if law.properties & part else 0


def _table(law: Law) -> np.ndarray:
    table = np.array(law.table, float)
    table[..., [DAMPING_N, DAMPING_T]] = dashpot_coefficients(law)
    return table


@lru_cache
def _fixed_members(kind: int, members: tuple[str, ...]) -> dict:
    """Struct members that all laws of a kind share."""
    check_kind(kind)
    out = dict.fromkeys(MEMBERS)
    if not isinstance(kind, Kind):
        known = BUILTIN_LAWS[kind]
        if known.parameters:
            out |= {name: core.law_function(kind - FIRST_OF_OWN, k) for k, name in enumerate(_OWN)}
        return out | {
            "hertz": known.exponent == 1.5, "uses_radius": known.uses_radius, "rescaled": known.rescales,
            "bonds": known.bonds, "memory": np.zeros(len(known.memory)),
        }  # fmt: skip
    own = USER_LAWS[kind]
    out |= {name: block_function(kind, name).address for name in members if MEMBERS[name] in own.functions}
    out |= {
        "uses_radius": any("r_eff" in taken for taken in own.arguments.values()), "bonds": own.bonds,
        "memory": np.array([*own.memory.values()], float),
    }  # fmt: skip
    return {"hertz": False, "rescaled": False, **out}


@cache
def block_function(kind: Kind, name: str):
    """C function `LawFunction` of a user-defined law, compiled by Numba.

    Raises
    ------
    MissingExtraError
        If Numba is not installed.
    ValueError
        If Numba cannot compile the function; the message names the line.
    """
    own = USER_LAWS[kind]
    with announced(f"compiling {own.name}: {MEMBERS[name]}"):
        return _compiled_block(own, kind, name)


def _compiled_block(own: UserLaw, kind: Kind, name: str):
    """Compile a function of a user-defined law."""
    numba = require("numba", "laws")
    numbers = numba.types.CPointer(numba.types.float64)
    signature = numba.types.void(numbers, numba.types.int64, *6 * [numbers])
    scope = dict(numba_functions(kind))
    exec(compile(_block_text(own, name), "<contact law>", "exec"), scope)
    try:
        with warnings.catch_warnings(action="ignore"):
            return numba.cfunc(signature, **_OPTIONS)(scope["block"])
    except Exception as problem:  # Numba does not derive all of its errors from NumbaError
        files = {os.path.abspath(function.__code__.co_filename) for function in own.functions.values()}
        place, reason = f"{own.file}: " if own.file else "", _summarize_numba_error(str(problem), files)
        raise ValueError(f"{place}{MEMBERS[name]} cannot be compiled, {reason}; {HELP}") from None


@cache
def numba_functions(kind: Kind) -> dict:
    """Functions of a user-defined law compiled by Numba, and the other names that block functions use."""
    made: dict = {}
    njit = require("numba", "laws").njit
    functions = {name: _compile(function, made, njit) for name, function in USER_LAWS[kind].functions.items()}
    return functions | {"GAUSS": _GAUSS, "STEP": STEP, "sqrt": np.sqrt}


def _compile(function, made: dict, njit):
    """Compiled copy of a function, which calls compiled copies of other functions."""
    if isinstance(function, types.ModuleType) and function is not np:
        if function in made:  # modules may refer to each other
            return made[function]
        module = made[function] = types.ModuleType(function.__name__)
        vars(module).update({name: _compile(value, made, njit) for name, value in vars(function).items()})
        return module
    if not isinstance(function, types.FunctionType):
        return function
    if function not in made:
        scope, cells = {}, [types.CellType() for _ in function.__closure__ or ()]
        copy = types.FunctionType(function.__code__, scope, function.__name__, function.__defaults__, tuple(cells))
        made[function] = njit(**_OPTIONS, **_INNER)(copy)
        named = {name: function.__globals__[name] for name in _names(copy.__code__) if name in function.__globals__}
        scope.update({name: _compile(value, made, njit) for name, value in named.items()})
        for cell, old in zip(cells, function.__closure__ or (), strict=True):
            cell.cell_contents = _compile(old.cell_contents, made, njit)
    return made[function]


def _names(code: types.CodeType) -> set[str]:
    """Global names that code uses, including those used by nested functions."""
    inner = (part for part in code.co_consts if isinstance(part, types.CodeType))
    return {*code.co_names, *(name for part in inner for name in _names(part))}


def _summarize_numba_error(message: str, files: set[str]) -> str:
    """Innermost line that Numba reports in the files of a law, and Numba's message."""
    lines = [line.strip() for line in re.sub(r"\x1b\[[0-9;]*m", "", message).splitlines() if line.strip()]
    starts = re.compile(r"(No implementation|Use of|Unknown|Cannot|Invalid|Untyped)")
    said = next(filter(starts.match, lines), lines[0]).partition(" Raised from ")[0][:200]
    for quoted, plain, number in re.findall(r'(?:File "([^"]+)", line |(?:at|from) (\S+) \()(\d+)', message):
        path = os.path.abspath(quoted or plain)
        if path in files and (line := linecache.getline(path, int(number)).strip()):
            return f"line {number}: {line!r} ({said})"
    return f"({said})"


def _block_text(own: UserLaw, name: str) -> str:
    """Text of a function that evaluates n contacts."""
    numbers, values = (", ".join(form.format(k) for k in range(len(own.names))) for form in ("q{}", "q[{}]"))
    lines = "\n        ".join(_LINES[name](partial(_call, own)))
    former = "".join(f"    {name} = memory[{k}]\n" for k, name in enumerate(_memory_names(own)))
    return f"""def block(q, n, r_eff, overlap, fn, memory, one, two):
    {numbers} = {values}
{former}    for k in range(n):
        {lines}
"""


def _memory_names(own: UserLaw) -> list[str]:
    """Names of the variables that hold the memory of a contact before its update."""
    return [f"m{k}" for k in range(len(own.memory))]


def _call(own: UserLaw, name: str, overlap="overlap[k]", normal_force="fn[k]", default="", seen="") -> str:
    """Expression that calls a function of the law at contact k, whose memory is updated at the overlap `seen`."""
    if name not in own.functions:
        return default
    at = {"overlap": overlap, "r_eff": "r_eff[k]", "normal_force": normal_force}
    if name == "update":
        at |= zip(own.memory, _memory_names(own), strict=True)
    else:
        many, whole = len(own.memory) > 1, _call(own, "update", seen or overlap)
        at |= {key: f"{whole}[{k}]" if many else whole for k, key in enumerate(own.memory)}
    return f"{name}({', '.join(at.get(key) or f'q{own.names.index(key)}' for key in own.arguments[name])})"


_DEEPER, _STRONGER = "complex(overlap[k], STEP)", "complex(fn[k], STEP)"


def _force(call):
    return f"one[k] = {call('normal_force')}", f"two[k] = {call('tangential_stiffness', default='q1')}"


def _slopes(call):
    stiffness = call("tangential_stiffness", _DEEPER, default="0.0")
    return f"one[k] = {call('normal_force', _DEEPER)}.imag / STEP", f"two[k] = {stiffness}.imag / STEP"


def _cap(name):
    return lambda call: (f"x = {call(name)}", "one[k] = x if q2 > 0.0 and x > 0.0 else 0.0")


def _cap_slopes(name):
    cut = "imag / STEP if q2 > 0.0 and x.real > 0.0 else 0.0"
    return lambda call: (
        f"x = {call(name, normal_force=_STRONGER)}", f"one[k] = x.{cut}", f"x = {call(name, _DEEPER)}",
        f"two[k] = x.{cut}",
    )  # fmt: skip


def _energy(call):
    """Energy; by default ∫F dδ from the end of the range by Gauss quadrature, over √δ or, in the gap, over δ."""
    if given := call("normal_energy"):
        return (f"one[k] = {given}",)
    return (
        f"end, total, x = -{call('contact_range', default='0.0')}, 0.0, overlap[k]",
        "root, gap = sqrt(max(x, 0.0)), min(x, 0.0) - end",
        "for place, weight in GAUSS:",
        "    t, d = 0.5 * root * (1.0 + place), end + 0.5 * gap * (1.0 + place)",
        f"    total += 0.5 * weight * (2.0 * root * t * {call('normal_force', 't * t', seen='x')} + gap * "
        f"{call('normal_force', 'd', seen='x')})",
        "one[k] = total",
    )


def _rolling(call):
    return (f"one[k] = {call('rolling_stiffness')}", f"two[k] = {call('rolling_stiffness', _DEEPER)}.imag / STEP")


def _update(call):
    many = len(call.args[0].memory)
    return (", ".join(f"one[{k}]" for k in range(many)) + f" = {call('update')}",)


_LINES = {
    "force": _force, "cap": _cap("cap"), "slopes": _slopes, "cap_slopes": _cap_slopes("cap"), "energy": _energy,
    "range": lambda call: (f"one[k] = {call('contact_range')}",), "rolling": _rolling,
    "update": _update, "rolling_cap": _cap("rolling_cap"), "rolling_slopes": _cap_slopes("rolling_cap"),
}  # fmt: skip


# ---- values of a contact law at given overlaps, from the compiled core


_PAIRS = "slopes", "cap_slopes"
_MEMBERS = {"stiffness": "force"}  # function of a user-defined law that gives a result, if its name differs


def evaluate(law: Law, *wanted: str, overlap, r_eff=1.0, a=0, b=0, m_eff=1.0, normal_force=0.0):
    """Values of a law at given contacts: an array for each name, or a single array for one name.

    Overlaps are positive, or within the range of the law. All arguments are numbers or arrays of the same shape.

    Parameters
    ----------
    wanted : "force" and "energy" of the normal spring; "stiffness" of the tangential one; "slopes" (…, 2), the
        derivatives of force and stiffness; "cap" and "cap_slopes" (…, 2), those of the cap with respect to
        normal force and overlap; "range"; "damping", the factor that multiplies the damping coefficients
    overlap, r_eff : δ and R_eff [length]
    a, b : materials of the two bodies
    m_eff : effective mass, for dashpots [mass]
    normal_force : normal force including that of the dashpot, for caps [force]
    """
    given = np.broadcast_arrays(a, b, overlap, r_eff, m_eff, normal_force)
    types, shape = (np.int64, np.int64, *4 * [float]), given[0].shape
    names = "a", "b", "overlap", "r_eff", "m_eff", "fn"
    points = {n: np.array(x, t).ravel() for n, x, t in zip(names, given, types, strict=True)}
    results = dict.fromkeys(("force", "stiffness", "energy", "slopes", "cap", "cap_slopes", "range", "damping"))
    results |= {"memory": None}
    results |= {name: np.empty((*shape, 2) if name in _PAIRS else shape) for name in wanted}
    struct = law_struct(law, members=tuple(_MEMBERS.get(name, name) for name in wanted if name != "damping"))
    core.law_values(struct | {"damping": law.damping & ~NO_TENSION}, points | results)
    values = tuple(results[name] for name in wanted)
    return values if len(values) > 1 else values[0]


def largest_stiffness(law: Law, r_eff: float, deepest: float) -> float:
    """Largest stiffness of a law for material 0 between the end of its range and the overlap `deepest` [force/length].

    The stiffness of a built-in law grows with the overlap. The rolling stiffness of a user-defined law is converted to
    k_r m/I, with the I of spheres.
    """
    values = law.table[0, 0].tolist()
    if not isinstance(law.kind, Kind):
        own = dict(zip(parameter_names(law), values, strict=True))
        slopes, tangential = evaluate(law, "slopes", "stiffness", overlap=deepest, r_eff=r_eff)
        return max(slopes[0], tangential, own.get("k_unload", 0.0))
    functions, most = find_user_law(law.kind).functions, 0.0
    end = evaluate_role(law.kind, "contact_range", values, r_eff=r_eff) if "contact_range" in functions else 0.0
    for x in np.append(np.linspace(-end, 0, 33)[1:-1] if end else [], np.geomspace(1e-6, 1, 33) * deepest):
        at = {"overlap": complex(x, STEP), "r_eff": r_eff}
        most = max(most, abs(np.imag(evaluate_role(law.kind, "normal_force", values, **at))) / STEP)
        if "tangential_stiffness" in functions:
            most = max(most, np.real(evaluate_role(law.kind, "tangential_stiffness", values, **at)))
        if "rolling_stiffness" in functions:
            most = max(
                most, np.real(evaluate_role(law.kind, "rolling_stiffness", values, **at)) / (0.4 * (2 * r_eff) ** 2)
            )
    return max(float(most), float(values[KT]) if "tangential_stiffness" not in functions else 0.0)
