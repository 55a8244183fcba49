"""Ranges of the parameters of friction and of faults, as annotations that `checked` understands."""

from collections.abc import Callable
from typing import Annotated

import numpy as np

from ....kit import NOT_NEGATIVE, POSITIVE, Requirement, Series


def allowed(words: str, test: Callable) -> Requirement:
    """Requirement that a test holds for a number, or for all entries of an array."""

    def check(name, value):
        values = np.atleast_1d(np.asarray(value, float))
        if not (good := test(values)).all():
            raise ValueError(f"{name} must be {words}, got {values[~good][0]:g}")

    return Requirement(check)


ALL_POSITIVE = allowed("positive and finite", lambda v: (v > 0) & np.isfinite(v))
ALL_NOT_NEGATIVE = allowed("finite and not negative", lambda v: (v >= 0) & np.isfinite(v))
Positive = Annotated[float, POSITIVE]
NotNegative = Annotated[float, NOT_NEGATIVE]
PositiveSeries = Annotated[Series, ALL_POSITIVE]
NotNegativeSeries = Annotated[Series, ALL_NOT_NEGATIVE]
Bounded = Annotated[float, allowed("finite", np.isfinite)]
Unbounded = Annotated[float, allowed("positive, or inf", lambda v: v > 0)]
