"""Ranges of the parameters of friction and of faults, as annotations that `checked` understands."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import numpy as np

from ....kit import NOT_NEGATIVE, POSITIVE, Requirement, Series, check_value


def allowed(words: str, test: Callable) -> Requirement:
    """Requirement that a test holds for a number, or for all entries of an array."""

    def check(name, value):
        values = np.atleast_1d(np.asarray(value, float))
        if not (good := test(values)).all():
            raise ValueError(f"{name} must be {words}, got {values[~good][0]:g}")

    return Requirement(check)


def _require_list(name: str, value) -> None:
    check_value(name, value.tolist() if isinstance(value, np.ndarray) else value, list[float], given=True)


def _require_number(name: str, value) -> None:
    """Raise ValueError, which `checked` passes on from within a union, unless the value is a number."""
    try:
        check_value(name, value, float, given=True)
    except TypeError as problem:
        raise ValueError(str(problem)) from None


ALL_POSITIVE = allowed("positive and finite", lambda v: (v > 0) & np.isfinite(v))
ALL_NOT_NEGATIVE = allowed("finite and not negative", lambda v: (v >= 0) & np.isfinite(v))
Positive = Annotated[float, POSITIVE]
NotNegative = Annotated[float, NOT_NEGATIVE]
PositiveSeries = Annotated[Series, ALL_POSITIVE]
NotNegativeSeries = Annotated[Series, ALL_NOT_NEGATIVE]
Bounded = Annotated[float, allowed("finite", np.isfinite)]
Number = Annotated[Any, Requirement(_require_number)]
Places = Annotated[Sequence[float], Requirement(_require_list)]
LEAST_TOLERANCE = 1e-14  # round-off is larger than smaller errors per step
Tolerance = Annotated[Positive, allowed(f"at least {LEAST_TOLERANCE:g}", lambda error: error >= LEAST_TOLERANCE)]
Unbounded = Annotated[float, allowed("positive, or inf", lambda v: v > 0)]
