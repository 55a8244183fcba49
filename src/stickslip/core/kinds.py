"""How a law written by a user reaches compiled kernels: its kind is a number that the compiler sees as a type.

Kernels pass a law's kind along, down to the scalar functions of `laws`. A built-in kind is a plain integer. A user's is
a `Kind`: to Numba a type of its own for each number, without any value, so that everything it is passed to is compiled
for that law, and the user's functions are found in `OWN` while types are inferred. The number is a digest of all that
decides the machine code of these functions, so that the disk cache hits in another process, and never when a law has
changed; on a hit the functions themselves are not needed.
"""

from functools import wraps

from numba import njit
from numba.core import types
from numba.core.errors import TypingError
from numba.core.imputils import lower_constant
from numba.extending import NativeValue, models, overload, register_model, typeof_impl, unbox

OWN: dict[int, dict] = {}  # by kind: compiled scalar functions by name, as kernels call them
FAST = {"fastmath": True, "error_model": "numpy"}


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


def functions_of(kind: int) -> dict:
    """Compiled scalar functions of a user's law by name.

    Raises
    ------
    ValueError
        if this process does not know the law.
    """
    if int(kind) not in OWN:
        raise ValueError(
            f"the law with digest {int(kind):x} is a user's own and not known here: make it with contact_law or "
            f"law_from_file first"
        )
    return OWN[int(kind)]


def by_kind(function):
    """A scalar function of a law: for built-in kinds `function`, for a user's what `OWN` has under its name."""
    name, compiled = function.__name__, njit(**FAST)(function)

    @wraps(function)
    def scalar(kind, *rest):
        return functions_of(kind)[name](kind, *rest) if isinstance(kind, Kind) else compiled(kind, *rest)

    @overload(scalar, jit_options=FAST, strict=False)
    def _(kind, *rest):
        if not isinstance(kind, KindType):
            return function
        try:
            return functions_of(kind.number)[name].py_func
        except ValueError as problem:
            raise TypingError(str(problem)) from None

    return scalar
