"""User-defined contact laws: plain Python functions of scalars, compiled when a law is first used.

The arguments of a function are `overlap`, `r_eff`, others that depend on its role (see `ROLES`), and parameters of the
law. Every other name that it uses must be a number, a function, `math` or `numpy`. The values of these names are part
of the digest that identifies a law, so a law in which any of them has changed is a different law.

Tangents come from a complex step, f'(x) = Im f(x + ih)/h. `max`, `min`, `abs` and `math` are therefore replaced by
versions that accept complex numbers and branch on the real part.
"""

import builtins
import copyreg
import dis
import hashlib
import inspect
import linecache
import math
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..arguments import checked, require_positive
from ..text import read_text
from .builtin import COULOMB, DAMPING, NO_TENSION, PARAMETERS, Law, check_parameter
from .kinds import HELP, ROLES, USER_LAWS, Kind, UserLaw
from .validation import locate_error, validate_law

_DEFAULTS = {"kn": 1.0, "kt": 0.0, "mu": 0.0, "damping_n": 0.0, "damping_t": 0.0}


# ---- replacements of functions that do not accept complex numbers


def _max(a, b):
    return a if a.real >= b.real else b


def _min(a, b):
    return a if a.real <= b.real else b


def _abs(a):
    return a if a.real >= 0.0 else -a


_REPLACEMENTS = {max: _max, min: _min, abs: _abs, math.fabs: _abs}
_NUMPY_NAMES = {"pow": "power", "asin": "arcsin", "acos": "arccos", "atan": "arctan"}
for _name in (
    "sqrt",
    "exp",
    "log",
    "log10",
    "expm1",
    "log1p",
    "sin",
    "cos",
    "tan",
    "sinh",
    "cosh",
    "tanh",
    *_NUMPY_NAMES,
):
    _REPLACEMENTS[getattr(math, _name)] = getattr(np, _NUMPY_NAMES.get(_name, _name))
_ALLOWED_BUILTINS = (float, complex, int, bool, range, len)


def _resolve_global(name: str, value, made: dict):
    """Replacement for a global name used in a user-defined function."""
    if value is math:
        whole = types.ModuleType("math")
        for key, thing in vars(math).items():
            if isinstance(thing, float) or (callable(thing) and thing in _REPLACEMENTS):
                setattr(whole, key, _resolve_global(key, thing, made))
        return whole
    if callable(value) and not isinstance(value, type) and getattr(value, "__hash__", None) and value in _REPLACEMENTS:
        value = _REPLACEMENTS[value]
    value = getattr(value, "py_func", value)
    if isinstance(value, types.FunctionType):
        return _copy_function(value, made)
    plain = isinstance(value, bool | int | float | complex | np.number) or value in _ALLOWED_BUILTINS
    if plain or value is np or isinstance(value, np.ufunc):
        return value
    if isinstance(value, tuple) and all(isinstance(v, int | float) for v in value):
        return value
    raise ValueError(
        f"a contact law uses {name!r} of type {type(value).__name__}: only numbers, functions, math and numpy are "
        f"allowed; {HELP}"
    )


def _find_globals(function) -> dict:
    """Global names and enclosing variables that a function uses, with their values."""
    values, codes = dict(inspect.getclosurevars(function).nonlocals), [function.__code__]
    while codes:
        code = codes.pop()
        codes += [c for c in code.co_consts if isinstance(c, types.CodeType)]
        for step in dis.get_instructions(code):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                name = step.argval
                if name not in function.__globals__ and not hasattr(builtins, name):
                    raise ValueError(f"{function.__name__} of the contact law uses {name!r}, which is not defined")
                values[name] = function.__globals__.get(name, getattr(builtins, name, None))
    return values


def _copy_function(function, made: dict):
    """Copy a function; the names that it uses are replaced by `_resolve_global`."""
    if function in made:
        return made[function]
    used = _find_globals(function)
    scope = {name: _resolve_global(name, value, made) for name, value in used.items() if value is not function}
    scope["__builtins__"] = builtins
    cells = tuple(types.CellType(scope[name]) for name in function.__code__.co_freevars)
    copy = types.FunctionType(function.__code__, scope, function.__name__, function.__defaults__, cells)
    made[function] = scope[function.__name__] = copy
    return copy


def _fingerprint(function, seen: set) -> list:
    """Data that determine the result of a function."""
    if function in seen:
        return []
    seen.add(function)
    out: list = [function.__name__, inspect.getfullargspec(function).args, function.__defaults__]
    codes = [function.__code__]
    while codes:
        code = codes.pop()
        out += [code.co_code, code.co_names, code.co_varnames, code.co_freevars]
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                codes.append(constant)
            else:
                out.append(repr(constant))
    for name, value in sorted(_find_globals(function).items()):
        value = getattr(value, "py_func", value)
        inner = _fingerprint(value, seen) if isinstance(value, types.FunctionType) else [repr(value)]
        out += [name, *(["<module>"] if isinstance(value, types.ModuleType) else inner)]
    return out


def _argument_names(role: str, function, names: tuple[str, ...], memory=()) -> tuple[str, ...]:
    """Argument names of a function, in order. Raise ValueError if any of them is not allowed."""
    if not isinstance(function, types.FunctionType):
        raise ValueError(f"{role} is a {type(function).__name__}: give a plain Python function")
    spec = inspect.getfullargspec(function)
    if spec.varargs or spec.varkw or spec.kwonlyargs:
        raise ValueError(f"{role} has *, ** or keyword-only arguments: use plain ones, such as {role}(overlap)")
    for name in spec.args:
        memory_names = () if role == "contact_range" else memory
        if name not in (*ROLES[role], *names, *memory_names):
            allowed = ", ".join((*ROLES[role], *names, *memory_names))
            raise ValueError(f"{role} has an argument {name!r}, which is not a parameter: allowed names are {allowed}")
    return tuple(spec.args)


@checked
def custom(
    *, normal_force: Callable, tangential_stiffness: Callable | None = None, cap: Callable | None = None,
    contact_range: Callable | None = None, rolling_stiffness: Callable | None = None,
    rolling_cap: Callable | None = None, normal_energy: Callable | None = None, update: Callable | None = None,
    parameters: dict | None = None, memory: dict | None = None, bonds: bool = False,
    coulomb: str = "sharp", damping: str = "velocity", tension: bool = True, size: float = 1.0,
    name: str = "a user's law",
) -> Law:  # fmt: skip
    """Contact law from user-defined functions: F_n(δ), k_t(δ), |F_t| ≤ cap, −M = k_r(δ) ψ with |M| ≤ rolling cap.

    Each function is a plain Python function of scalars with the arguments `overlap` δ, `r_eff` and any parameters of
    the law, by name; caps may also have `normal_force`. Derivatives are taken by complex-step differentiation, so
    functions must branch on the real part: `if overlap.real < 0.0`. A law is validated when it is created, and compiled
    when it is first used.

    Parameters
    ----------
    normal_force : F_n [force], positive for repulsion; for overlap < 0 the force across a gap within the range
    tangential_stiffness : k_t [force/length], not negative; default the parameter `kt`
    cap : largest tangential force [force]; negative values count as zero; default μ max(F_n, 0). Not evaluated where
        μ = 0
    contact_range : largest gap at which grains act on each other [length]; default 0
    rolling_stiffness : k_r of the moment that opposes the relative rotation ψ of i and j, perpendicular to the normal,
        accumulated since the contact closed [force length]; default none
    rolling_cap : largest such moment [force length]; required with `rolling_stiffness`. Not evaluated where μ = 0
    normal_energy : ∫F_n dδ from the end of the range [energy]; by default computed by quadrature, which is exact for
        powers δ, δ^{3/2}, δ² … and accurate to a few digits for others; used by the energy ledger only
    update : new memory of a contact, from the previous memory, `overlap`, `r_eff` and parameters: a number, or a tuple
        in the order of `memory`. A second update at the same overlap must leave it unchanged. Other functions receive
        the memory after the update
    parameters : values by name. kn, kt, mu, damping_n and damping_t exist in every law (1, 0, 0, 0, 0 unless given; mu
        is 1 if there is a `cap` that does not use it); others may be added
    memory : values by name when a contact closes. All functions except `contact_range` may use these names as arguments
    bonds : True if a pair acts across a gap only after it has touched, until the gap exceeds the range
    coulomb, damping, tension : as in `hertz_mindlin`; dashpots act only where overlap > 0
    size : a grain radius for which the law is validated [length]
    name : used in tables and messages

    Raises
    ------
    ValueError
        If a function has a wrong signature, returns values that are not finite or not reproducible, or does not accept
        complex numbers. A LawWarning reports a force that jumps at the end of the range.

    Source
    ------
    Complex step: Squire & Trapp, doi:10.1137/S003614459631241X.

    Examples
    --------
    >>> law = custom(
    ...     normal_force=lambda overlap, kn: kn * overlap, parameters={"kn": 2.0}
    ... )
    >>> float(law.table[0, 0, 0])
    2.0
    """
    given = {
        "normal_force": normal_force, "tangential_stiffness": tangential_stiffness, "cap": cap,
        "contact_range": contact_range, "rolling_stiffness": rolling_stiffness, "rolling_cap": rolling_cap,
        "normal_energy": normal_energy, "update": update,
    }  # fmt: skip
    given = {role: function for role, function in given.items() if function is not None}
    if ("rolling_stiffness" in given) != ("rolling_cap" in given):
        raise ValueError("rolling resistance needs both rolling_stiffness and rolling_cap, got only one")
    values = _parameter_values(parameters or {}, given)
    memory_values = _memory_values(memory or {}, values, "update" in given)
    arguments = {
        role: _argument_names(role, function, tuple(values), memory_values) for role, function in given.items()
    }
    if bonds and "contact_range" not in given:
        raise ValueError("bonds = True requires contact_range, the largest gap across which bonds act")
    kind = _register(given, arguments, tuple(values), name, memory_values, bonds)
    if coulomb not in COULOMB or damping not in DAMPING:
        raise ValueError(
            f"coulomb must be one of {', '.join(COULOMB)}, and damping one of {', '.join(DAMPING)}, got {coulomb!r} "
            f"and {damping!r}"
        )
    table = np.array(list(values.values()), float)[None, None, :].copy()
    law = Law(kind, COULOMB[coulomb], table, DAMPING[damping] + (0 if tension else NO_TENSION))
    require_positive(size=size)
    validate_law(law, size)
    USER_LAWS[kind] = USER_LAWS[kind]._replace(size=float(size))
    return law


def _parameter_values(parameters: dict, given: dict) -> dict:
    """Values of all parameters, in the order of the law's table."""
    for name, value in parameters.items():
        if not (isinstance(name, str) and name.isidentifier()) or any(name in allowed for allowed in ROLES.values()):
            raise ValueError(
                "the name of a parameter must be an identifier other than overlap, r_eff and normal_force, got "
                f"{name!r}"
            )
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise ValueError(f"{name} must be a number, got {value!r}")
    capped = "cap" in given and "mu" not in inspect.getfullargspec(given["cap"]).args
    values = _DEFAULTS | ({"mu": 1.0} if capped else {}) | parameters
    for name, value in values.items():
        check_parameter(name, value, tuple(values), signed=values.keys() - {*PARAMETERS})
    return {name: float(value) for name, value in values.items()}


def _memory_values(memory: dict, parameters: dict, updated: bool) -> dict[str, float]:
    """Additional memory of a contact when it closes."""
    if bool(memory) != updated:
        raise ValueError("a law with memory needs both memory and update, got only one")
    for name, value in memory.items():
        taken = name in parameters or any(name in allowed for allowed in ROLES.values())
        if not (isinstance(name, str) and name.isidentifier()) or taken:
            raise ValueError(f"the name of a memory must be a unique identifier, got {name!r}")
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise ValueError(f"memory {name} must be a finite number, got {value!r}")
    return {name: float(value) for name, value in memory.items()}


def _register(given: dict, arguments: dict, names: tuple[str, ...], name: str, memory: dict, bonds: bool) -> Kind:
    """Register the functions of a law in this process, and return its kind."""
    content: list = [names, sorted(arguments.items()), *([memory] if memory else []), *(["bonds"] if bonds else [])]
    for role in sorted(given):
        content += [role, *_fingerprint(given[role], set())]
    digest = hashlib.sha256(repr(content).encode()).digest()
    kind = Kind(int.from_bytes(digest[:8], "big") >> 2 | 1 << 61)
    if kind not in USER_LAWS:
        made: dict = {}
        plain = {role: _copy_function(function, made) for role, function in given.items()}
        USER_LAWS[kind] = UserLaw(name, names, _source_text(given), "", plain, arguments, memory, bonds, 1.0)
    USER_LAWS[kind] = USER_LAWS[kind]._replace(name=name)
    return kind


def _source_text(given: dict) -> str:
    """Source text of the functions, if available."""
    texts = []
    for function in given.values():
        try:
            texts.append(inspect.getsource(function))
        except (OSError, TypeError):
            texts.append(f"# the text of {function.__name__} is not available\n")
    return "\n".join(texts)


@checked
def from_file(path: str | Path, **parameters: float) -> Law:
    """Contact law from a Python file with functions named like the arguments of `custom`, and a dict `parameters`.

    The file is executed. It may also set `coulomb`, `damping`, `tension`, `memory`, `bonds` and `size`.

    Parameters
    ----------
    path : a file ending in .py
    parameters : values that replace those in the file

    Raises
    ------
    ValueError
        If the file does not compile or run, or if `custom` raises ValueError; the message gives the line.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path} is not a file: give a Python file with a function normal_force")
    return from_text(read_text(path, remedy="give a Python file"), path, parameters)


def from_text(text: str, path: Path, parameters: dict) -> Law:
    """Contact law from the text of a Python file, which is executed; see `from_file`."""
    scope = {"__name__": path.stem, "__file__": str(path)}
    linecache.cache[str(path)] = len(text), None, text.splitlines(keepends=True), str(path)  # for lines in messages
    try:
        exec(compile(text, str(path), "exec"), scope)
    except SyntaxError as problem:
        line = (problem.text or "").strip()
        raise ValueError(f"{path} does not compile, line {problem.lineno}: {line!r} ({problem.msg})") from None
    except (Exception, SystemExit) as problem:  # sys.exit(0) would end the program as if successful
        raise ValueError(f"{path} does not run, {locate_error(problem, path)}") from None
    given = {role: scope[role] for role in ROLES if role in scope}
    if "normal_force" not in given:
        raise ValueError(f"{path} has no function normal_force: define one, such as def normal_force(overlap, kn)")
    values = scope.get("parameters", {})
    if not isinstance(values, dict):
        raise ValueError(f"{path}: parameters is a {type(values).__name__}: give a dictionary of numbers by name")
    for name in parameters:
        if name not in (*values, *PARAMETERS):
            raise ValueError(
                f"{path} has no parameter {name!r}: it has {', '.join(dict.fromkeys((*values, *PARAMETERS)))}"
            )
    options = {key: scope[key] for key in ("coulomb", "damping", "tension", "size", "memory", "bonds") if key in scope}
    try:
        law = custom(**given, parameters=values | parameters, name=path.stem, **options)
    except ValueError as problem:
        raise ValueError(f"{path}: {problem}") from None
    USER_LAWS[law.kind] = USER_LAWS[law.kind]._replace(source=text, file=str(path))
    return law


def _reduce_kind(kind: Kind):
    """Pickle a kind for another process of the same run, with the text of its file if it has one."""
    user_law = USER_LAWS.get(kind)
    return _restore_kind, (int(kind), user_law.source, user_law.file) if user_law and user_law.file else (
        int(kind),
        "",
        "",
    )


def _restore_kind(number: int, text: str, file: str) -> Kind:
    """Unpickle a kind, and create its law if it is unknown in this process."""
    if text and number not in USER_LAWS:
        from_text(text, Path(file), {})
    return Kind(number)


copyreg.pickle(Kind, _reduce_kind)
