"""How a law written by a user reaches compiled kernels: its kind is a number that the compiler sees as a type.

Kernels pass a law's kind along, down to the scalar functions of `laws`. A built-in kind is a plain integer. A user's is
a `Kind`: to Numba a type of its own for each number, without any value, so that everything it is passed to is compiled
for that law, and the user's functions are found in `COMPILED` while types are inferred. The number is a digest of all that
decides the machine code of these functions, so that the disk cache hits in another process, and never when a law has
changed; on a hit the functions themselves are not needed.
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

HELP = "see docs/contact_laws.md"
ROLES = {  # what a function of each name may ask for besides parameters of the law
    "normal_force": ("overlap", "r_eff"),
    "normal_energy": ("overlap", "r_eff"),
    "tangential_stiffness": ("overlap", "r_eff"),
    "cap": ("normal_force", "overlap", "r_eff"),
    "contact_range": ("r_eff",),
    "rolling_stiffness": ("overlap", "r_eff"),
    "rolling_cap": ("normal_force", "overlap", "r_eff"),
}
COMPILED: dict[int, dict] = {}  # by kind: compiled scalar functions by name, as kernels call them
FAST = {"fastmath": True, "error_model": "numpy"}


class UserLaw(NamedTuple):
    """What is known of a law by a user."""

    name: str
    names: tuple[str, ...]  # of all parameters, in the order of the law's table
    source: str  # text, as far as it is known
    file: str  # where it is the text of a whole file, else nothing
    functions: dict[str, Callable]  # by role, as written but for what stands for `math`, `max` …
    asks: dict[str, tuple[str, ...]]  # what each function takes, in order


USER_LAWS: dict[int, UserLaw] = {}  # by kind: the laws of this process


class Kind(int):
    """The kind of a law that a user wrote."""


class KindType(types.Type):
    """Numba's type of a `Kind`: one for each number."""

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
    """A law's kind and other numbers for a kernel's closure, as NumPy's integers instead of literals.

    What takes a literal is compiled for that value alone, from Python on, mostly in vain: constants of both sorts are
    folded once callees are part of the kernel. Dimension and dashpots stay literals where vectors are made of loops, or
    where rounding would change.
    """
    return (kind if isinstance(kind, Kind) else np.int64(kind), *map(np.int64, numbers))


def compiled_functions(kind: int) -> dict:
    """Compiled scalar functions of a user's law by name.

    Raises
    ------
    ValueError
        if this process does not know the law.
    """
    if int(kind) not in COMPILED:
        raise ValueError(
            f"the law with digest {int(kind):x} is a user's own and not known here: make it with contact_law or "
            f"law_from_file first"
        )
    return COMPILED[int(kind)]


def by_kind(function):
    """A scalar function of a law: for built-in kinds `function`, for a user's what `COMPILED` has under its name."""
    name, compiled = function.__name__, njit(**FAST)(function)

    @wraps(function)
    def scalar(kind, *rest):
        return compiled_functions(kind)[name](kind, *rest) if isinstance(kind, Kind) else compiled(kind, *rest)

    @overload(scalar, jit_options=FAST, strict=False)
    def _(kind, *rest):
        if not isinstance(kind, KindType):
            return function
        try:
            return compiled_functions(kind.number)[name].py_func
        except ValueError as problem:
            raise TypingError(str(problem)) from None

    return scalar


def known(kind: int) -> UserLaw:
    """What this process knows of a user's law; ValueError with one sentence if it was not made here."""
    compiled_functions(kind)
    return USER_LAWS[kind]


def described(law) -> dict:
    """What is written down of a user's law beside its numbers, to be recognised and read, not to be run."""
    own = known(law.kind)
    return {"name": own.name, "digest": f"{int(law.kind):x}", "source": own.source, "parameters": " ".join(own.names)}


def recalled(kind: int, about: dict) -> Kind:
    """The kind of a user's law that was written down, if this process was given the law; its text is never run.

    Raises
    ------
    ValueError
        with one sentence, if the law, or another with the same text, was not made before.
    """
    if kind in USER_LAWS:
        return Kind(kind)
    same = [k for k, own in USER_LAWS.items() if own.source == about.get("source") and "\n" in own.source]
    if same and " ".join(USER_LAWS[same[0]].names) == about.get(
        "parameters"
    ):  # digests of other versions of Python differ
        return same[0]
    raise ValueError(
        f"it was computed with {about.get('name', 'a law')!r}, a contact law of a user (digest {int(kind):x}), whose "
        f"code is never run from a file of results: make that law first, with law_from_file or --law"
    )


def evaluate_role(kind: Kind, role: str, values, **given):
    """What a function of a law says, in plain Python; `values` are its parameters in the order of the table."""
    own = known(kind)
    values = dict(zip(own.names, values, strict=True)) | given
    return own.functions[role](*(values[name] for name in own.asks[role]))
