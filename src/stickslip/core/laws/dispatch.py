"""Dispatch of user-defined laws to compiled kernels: the kind of a law is a number that the compiler sees as a type.

Kernels pass the kind of a law down to the scalar functions of `builtin`. A built-in kind is a plain integer. The kind
of a user's law is a `Kind`. Numba sees each of its numbers as a separate type without a value, so that every function
that receives it is compiled for that law, and the user's functions are looked up in `COMPILED` during type inference.
The number is a digest of everything that determines the machine code of these functions. The disk cache is therefore
hit in other processes, but never after a law has changed. On a hit the functions themselves are not needed.
"""

from collections.abc import Callable
from functools import wraps
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.core import types
from numba.core.errors import TypingError
from numba.core.imputils import lower_constant
from numba.extending import NativeValue, models, overload, register_model, typeof_impl, unbox

from ...builtin_laws import BUILTIN_LAWS
from ..options import INNER

HELP = "see `stickslip docs contact_laws`"
ROLES = {  # arguments that a function of each name may take, in addition to parameters of the law
    "normal_force": ("overlap", "r_eff"),
    "normal_energy": ("overlap", "r_eff"),
    "tangential_stiffness": ("overlap", "r_eff"),
    "cap": ("normal_force", "overlap", "r_eff"),
    "contact_range": ("r_eff",),
    "rolling_stiffness": ("overlap", "r_eff"),
    "rolling_cap": ("normal_force", "overlap", "r_eff"),
}
COMPILED: dict[int, dict] = {}  # by kind: compiled scalar functions by name, as called by kernels
FAST = {"fastmath": True, "error_model": "numpy"}


class UserLaw(NamedTuple):
    """Description of a user-defined law."""

    name: str
    names: tuple[str, ...]  # of all parameters, in the order of the law's table
    source: str  # text, as far as it is known
    file: str  # path, if the source is the text of a whole file; else empty
    functions: dict[str, Callable]  # by role, as written except for the replacements of `math`, `max` …
    arguments: dict[str, tuple[str, ...]]  # arguments of each function, in order


USER_LAWS: dict[int, UserLaw] = {}  # by kind: laws defined in this process


class Kind(int):
    """Kind of a user-defined law."""


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


def check_kind(kind: int) -> None:
    """Raise ValueError if a number is neither that of a built-in law nor the kind of a user-defined one."""
    if not isinstance(kind, Kind) and not 0 <= kind < len(BUILTIN_LAWS):
        raise ValueError(
            f"a law of kind {kind} was given: built-in laws have kinds 0 to {len(BUILTIN_LAWS) - 1}; create a law "
            f"with a function of stickslip.laws"
        )


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


def compiled_functions(kind: int) -> dict:
    """Compiled scalar functions of a user-defined law, by name.

    Raises
    ------
    ValueError
        if the law is not known to this process.
    """
    if int(kind) not in COMPILED:
        raise ValueError(
            f"the law with digest {int(kind):x} is user-defined and not known to this process: create it with "
            f"laws.custom or laws.from_file first"
        )
    return COMPILED[int(kind)]


def by_kind(function):
    """Decorate a scalar function of a law: `function` for built-in kinds, `COMPILED[kind][name]` for a user's law."""
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


def find_user_law(kind: int) -> UserLaw:
    """Description of a user-defined law.

    Raise ValueError with a one-sentence message if the law was not created in this process.
    """
    compiled_functions(kind)
    return USER_LAWS[kind]


def describe_law(law) -> dict:
    """Record of a user-defined law without its numbers. It identifies the law and can be read, but is not run."""
    own = find_user_law(law.kind)
    return {"name": own.name, "digest": f"{int(law.kind):x}", "source": own.source, "parameters": " ".join(own.names)}


def restore_kind(kind: int, about: dict) -> Kind:
    """Kind of a user-defined law from its record, if the law was created in this process. Its text is never run.

    Raises
    ------
    ValueError
        with a one-sentence message, if neither the law nor another with the same text has been created.
    """
    if kind in USER_LAWS:
        return Kind(kind)
    same = [k for k, own in USER_LAWS.items() if own.source == about.get("source") and "\n" in own.source]
    if same and " ".join(USER_LAWS[same[0]].names) == about.get(
        "parameters"
    ):  # digests differ between versions of Python
        return same[0]
    raise ValueError(
        f"it was computed with {about.get('name', 'a law')!r}, a user-defined contact law (digest {int(kind):x}). "
        f"Code is never run from a results file: create that law first, with laws.from_file or --law"
    )


def evaluate_role(kind: Kind, role: str, values, **given):
    """Evaluate a function of a law in plain Python; `values` are its parameters in the order of the table."""
    own = find_user_law(kind)
    values = dict(zip(own.names, values, strict=True)) | given
    return own.functions[role](*(values[name] for name in own.arguments[role]))
