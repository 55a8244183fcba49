"""Contact laws as Numba sees them, until all kernels are in the compiled core.

Kernels pass the kind of a law down to the scalar functions here. A built-in kind is a plain integer. The kind of a
user's law is a `Kind`. Numba sees each of its numbers as a separate type without a value, so that every function that
receives it is compiled for that law, and the user's functions are looked up during type inference. The number is a
digest of everything that determines the machine code of these functions. The disk cache is therefore hit in other
processes, but never after a law has changed. On a hit the functions themselves are not needed.

The scalar functions take real or complex arguments and branch on the real part. Their tangents come from the same
source by complex-step differentiation, f'(x) = Im f(x + ih)/h, which is exact to round-off because nothing is
subtracted.
"""

from functools import cache, wraps

import numpy as np
from numba import njit
from numba.core import types
from numba.core.errors import TypingError
from numba.core.imputils import lower_constant
from numba.extending import NativeValue, models, overload, register_model, typeof_impl, unbox

from ...builtin_laws import BUILTIN_LAWS
from ..options import INNER
from .builtin import DAMPING_N, DAMPING_T, KN, KT, MASS, MU, SMOOTH, STEP, VISCOELASTIC
from .compiled import numba_functions
from .kinds import ROLES, Kind, UserLaw, check_kind, find_user_law

HERTZ_MINDLIN, LINEAR, HERTZ_MINDLIN_REFF, HERTZ_MINDLIN_RESCALED, HERTZ_MINDLIN_REFF_RESCALED = range(
    len(BUILTIN_LAWS)
)
USING_RADIUS = tuple(kind for kind, law in enumerate(BUILTIN_LAWS) if law.uses_radius)
RESCALED = tuple(kind for kind, law in enumerate(BUILTIN_LAWS) if law.rescales)
FAST = {"fastmath": True, "error_model": "numpy"}


class KindType(types.Type):
    """Numba type of a `Kind`, one for each number."""

    def __init__(self, number: int):
        self.number = number
        super().__init__(f"Kind({number})")


@typeof_impl.register(Kind)
def _(value, _):
    return KindType(int(value))


register_model(KindType)(models.OpaqueModel)


@unbox(KindType)
def _(_, __, c):
    return NativeValue(c.context.get_dummy_value())


@lower_constant(KindType)
def _(context, _, __, ___):
    return context.get_dummy_value()


def as_numpy_integers(kind: int, *numbers: int) -> tuple:
    """Convert a law's kind and other numbers to NumPy integers, for use in the closure of a kernel.

    Functions that take a literal are compiled for that value alone, beginning with the call from Python. This effort is
    mostly wasted, because literals and other constants alike are folded once callees have become part of the kernel.
    The dimension and the damping model stay literals where vectors are made from loops, or where rounding would change.

    Raises
    ------
    ValueError
        if there is no law of this kind.
    """
    check_kind(kind)
    return (kind if isinstance(kind, Kind) else np.int64(kind), *map(np.int64, numbers))


@cache
def _kernel_functions_of(number: int) -> dict:
    return _kernel_functions(find_user_law(number), numba_functions(Kind(number)))


def compiled_functions(kind: int) -> dict:
    """Compiled scalar functions of a user-defined law, by name.

    Raises
    ------
    ValueError
        if the law is not known to this process.
    """
    find_user_law(kind)
    return _kernel_functions_of(int(kind))


def by_kind(function):
    """Decorate a scalar function of a law: `function` for built-in kinds, the compiled function for a user's law."""
    name, compiled = function.__name__, njit(cache=True, **FAST)(function)

    @wraps(function)
    def scalar(kind, *rest):
        return compiled_functions(kind)[name](kind, *rest) if isinstance(kind, Kind) else compiled(kind, *rest)

    @overload(scalar, jit_options=FAST | INNER, strict=False)
    def _(kind, *rest):
        if not isinstance(kind, KindType):
            return function
        try:
            return compiled_functions(kind.number)[name].py_func
        except ValueError as problem:
            raise TypingError(str(problem)) from None

    return scalar


@njit(cache=True, fastmath=True, error_model="numpy")
def parameters(p, a, b):
    """Row of a built-in law's table for a pair of materials, as scalars."""
    return p[a, b, KN], p[a, b, KT], p[a, b, MU], p[a, b, DAMPING_N], p[a, b, DAMPING_T]


@by_kind
def row(kind, p, a, b):
    """Row of the law's table for a pair of materials, as scalars."""
    return parameters(p, a, b)


@by_kind
def uses_radius(kind):
    """Return True if the law's functions use R_eff."""
    return kind in USING_RADIUS


@by_kind
def rescales(kind):
    """Return True if a decreasing overlap shortens the slip: see `hertz_mindlin`."""
    return kind in RESCALED


def rescaling_flag(kind: int) -> bool | None:
    """True for laws that rescale, None for others. Numba prunes branches on None before anything is optimised.

    Kernels of all other laws are therefore identical, bit for bit, to kernels without support for rescaling.
    """
    return True if kind in RESCALED and not isinstance(kind, Kind) else None  # in Python: nothing is compiled


@by_kind
def acts_across_gaps(kind):
    """Return True if grains may act on each other across a gap."""
    return False


@by_kind
def reach(kind, q, r_eff):
    """Largest gap across which grains act on each other [length]."""
    return 0.0


@by_kind
def normal_force(kind, q, r_eff, overlap):
    """Elastic normal force [force], positive for repulsion; q from `parameters`, overlap > 0."""
    if kind in (HERTZ_MINDLIN, HERTZ_MINDLIN_RESCALED):
        return q[KN] * overlap * np.sqrt(overlap)
    if kind in (HERTZ_MINDLIN_REFF, HERTZ_MINDLIN_REFF_RESCALED):
        return q[KN] * overlap * np.sqrt(overlap * r_eff)
    return q[KN] * overlap


@by_kind
def normal_energy(kind, q, r_eff, overlap):
    """Elastic energy of the normal spring [energy]; overlap > 0."""
    power = 2.0 if kind == LINEAR else 2.5
    return normal_force(kind, q, r_eff, overlap) * overlap / power


@by_kind
def tangential_stiffness(kind, q, r_eff, overlap):
    """Stiffness of the unmobilised tangential spring [force/length]; overlap > 0."""
    if kind in (HERTZ_MINDLIN, HERTZ_MINDLIN_RESCALED):
        return q[KT] * np.sqrt(overlap)
    if kind in (HERTZ_MINDLIN_REFF, HERTZ_MINDLIN_REFF_RESCALED):
        return q[KT] * np.sqrt(overlap * r_eff)
    return q[KT] + 0.0 * overlap


@by_kind
def cap(kind, q, r_eff, overlap, fn):
    """Largest tangential force of a contact with normal force fn [force], not negative."""
    return q[MU] * max(fn, 0.0)


@by_kind
def rate_cap(kind, q, r_eff, overlap, fn):
    """Largest tangential force with `slip_update="rate"`: μ |F_n| as in LAMMPS; a user's law has its own cap."""
    return q[MU] * abs(fn)


@by_kind
def cap_slopes(kind, q, r_eff, overlap, fn):
    """Derivatives d(cap)/d(fn) and d(cap)/d(overlap) where fn > 0."""
    return q[MU], 0.0


@by_kind
def least_force(kind, elastic):
    """Lowest normal force that a dashpot may cause with `tension=False`; attraction by the law itself is allowed."""
    return 0.0


@by_kind
def masked(kind, touches, value):
    """Value, or zero where a pair is out of range. Built-in laws are zero there in any case."""
    return value


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def contact_damping(kind, viscous, r_eff, m_eff, overlap):
    """Factor on the damping coefficients, zero where grains do not touch."""
    if acts_across_gaps(kind) and overlap <= 0.0:
        return 0.0
    return damping_factor(viscous, r_eff, m_eff, overlap)


@njit(cache=True, fastmath=True, error_model="numpy")
def damping_factor(viscous, r_eff, m_eff, overlap):
    """Factor on the damping coefficients: see `hertz_mindlin`."""
    model = viscous & 3
    if model == VISCOELASTIC:
        return m_eff * np.sqrt(overlap * r_eff)
    if model == MASS:
        return m_eff + 0.0 * overlap
    return 1.0 + 0.0 * overlap


@njit(cache=True, fastmath=True, error_model="numpy")
def mobilisation(coulomb, x):
    """Factor on the tangential stiffness of a spring whose force k_t |s| is a fraction x of the Coulomb limit."""
    if coulomb == SMOOTH:
        return 1.0 + x - x * x
    return 1.0 + 0.0 * x


@njit(cache=True, fastmath=True, error_model="numpy")
def tangents(kind, q, r_eff, overlap):
    """Derivatives d(normal force)/d(overlap) and d(tangential stiffness)/d(overlap), by complex-step
    differentiation."""
    z = complex(overlap, STEP)
    return normal_force(kind, q, r_eff, z).imag / STEP, tangential_stiffness(kind, q, r_eff, z).imag / STEP


@njit(cache=True, fastmath=True, error_model="numpy")
def mobilisation_tangent(coulomb, x):
    """Derivative d(mobilisation)/dx, by complex-step differentiation."""
    return mobilisation(coulomb, complex(x, STEP)).imag / STEP


def complex_step_slopes(function):
    """Derivatives of f(kind, q, r_eff, overlap, fn) with respect to fn and overlap, by complex-step differentiation."""

    @njit(fastmath=True, error_model="numpy")
    def slopes(kind, q, r_eff, overlap, fn):
        by_force = function(kind, q, r_eff, overlap, complex(fn, STEP))
        return by_force.imag / STEP, function(kind, q, r_eff, complex(overlap, STEP), fn).imag / STEP

    return slopes


_GAUSS = tuple(zip(*np.polynomial.legendre.leggauss(8), strict=True))


def energy_by_quadrature(force, reach):
    """Integral ∫F dδ from −reach to the overlap by Gauss quadrature: over √δ where grains touch, over δ in the gap."""

    @njit(fastmath=True, error_model="numpy")
    def energy(kind, q, r_eff, overlap):
        end, total = -reach(kind, q, r_eff), 0.0
        root, gap = np.sqrt(max(overlap, 0.0)), min(overlap, 0.0) - end
        for place, weight in _GAUSS:
            t, x = 0.5 * root * (1.0 + place), end + 0.5 * gap * (1.0 + place)
            total += 0.5 * weight * root * 2.0 * t * force(kind, q, r_eff, t * t)
            total += 0.5 * weight * gap * force(kind, q, r_eff, x)
        return total

    return energy


def _compile_expression(signature: str, expression: str, **scope):
    """Compile a function with a given signature that returns the value of an expression."""
    text = f"def shim({signature}):\n    return {expression}\n"
    exec(compile(text, "<contact law>", "exec"), scope)
    return njit(**FAST)(scope["shim"])


def _kernel_functions(own: UserLaw, functions: dict) -> dict:
    """Compiled functions by the names under which kernels look them up."""
    names, arguments = own.names, own.arguments

    def call(role, **given):
        parts = [
            given.get(name, name) if name in ROLES[role] else f"q[{names.index(name)}]" for name in arguments[role]
        ]
        return f"f({', '.join(parts)})"

    has, out = own.functions.__contains__, {}
    here = "kind, q, r_eff, overlap"
    out["row"] = _compile_expression(
        "kind, p, a, b", "(" + ", ".join(f"p[a, b, {k}]" for k in range(len(names))) + ",)"
    )
    out["normal_force"] = _compile_expression(here, call("normal_force"), f=functions["normal_force"])
    soft = call("tangential_stiffness") if has("tangential_stiffness") else "q[1] + 0.0 * overlap"
    out["tangential_stiffness"] = _compile_expression(here, soft, f=functions.get("tangential_stiffness"))
    wide = call("contact_range") if has("contact_range") else "0.0"
    out["reach"] = _compile_expression("kind, q, r_eff", wide, f=functions.get("contact_range"))
    whole = f"{here}, fn"
    for role in ("cap", "rolling_cap"):
        if has(role):  # without friction it is zero, and values from a user may be negative
            value = call(role, normal_force="fn")
            out[role] = _compile_expression(whole, f"cut(q[{MU}], {value})", f=functions[role], cut=_clip_cap)
        else:
            out[role] = _compile_expression(whole, f"cut(q[{MU}], q[{MU}] * fn)", cut=_clip_cap)
        out[f"{role}_slopes"] = complex_step_slopes(out[role])
    out["rate_cap"] = out["cap"]
    if has("rolling_stiffness"):
        out["rolling_stiffness"] = _compile_expression(
            here, call("rolling_stiffness"), f=functions["rolling_stiffness"]
        )
    if has("normal_energy"):
        out["normal_energy"] = _compile_expression(here, call("normal_energy"), f=functions["normal_energy"])
    else:
        out["normal_energy"] = energy_by_quadrature(out["normal_force"], out["reach"])
    out["least_force"] = _compile_expression("kind, elastic", "min(elastic, 0.0)")
    out["masked"] = _compile_expression("kind, touches, value", "value if touches else 0.0")
    radius = any("r_eff" in taken for taken in arguments.values())
    out["uses_radius"] = _compile_expression("kind", str(radius))
    out["acts_across_gaps"] = _compile_expression("kind", str(has("contact_range")))
    out["rescales"] = _compile_expression("kind", "False")
    return out


@njit(**FAST)
def _clip_cap(mu, value):
    """Value of a cap, or zero if there is no friction or the cap is negative."""
    return value if mu > 0.0 and value.real > 0.0 else 0.0 * value
