"""What a paper states, what the package measured, and an honest verdict."""

import json
import math
from pathlib import Path
from typing import NamedTuple

REPRODUCED, PARTLY, NOT_REPRODUCED = "reproduced", "partly", "not reproduced"

Value = float | bool | list | None


class Claim(NamedTuple):
    """One row of a claims table; `tolerance` is relative."""

    id: str
    source: str
    paper: Value
    measured: Value
    unit: str
    tolerance: float
    verdict: str
    note: str


def claim(
    id: str, source: str, paper: Value, measured: Value, unit: str, tolerance: float, note: str = "", error: float = 0.0
) -> Claim:
    """A row with its verdict.

    Numbers: reproduced within the tolerance, partly within twice it; a tolerance of 1 is a factor of two either way.
    Windows: each end counts for half. Booleans: equal or not. Nothing measured: not reproduced. Measured, but without a
    number in the paper to compare with: partly. A measurement whose own error (one standard deviation) exceeds the
    tolerance is partly reproduced if it is within two errors.

    Examples
    --------
    >>> claim("speed", "Fig 5", 0.075, 0.080, "1", 0.25).verdict
    'reproduced'
    """
    verdict = _verdict(paper, measured, tolerance)
    if math.isnan(error):
        verdict = PARTLY if verdict == REPRODUCED else verdict
        return Claim(
            id, source, paper, measured, unit, tolerance, verdict, f"{note}; its error is not known: one realization"
        )
    if measured is not None and error > 0 and error > tolerance * abs(paper):
        verdict = PARTLY if abs(measured - paper) <= 2 * error else NOT_REPRODUCED
        note = f"{note}; its error exceeds the tolerance: too few realizations to decide"
    return Claim(id, source, paper, measured, unit, tolerance, verdict, note)


def _verdict(paper: Value, measured: Value, tolerance: float) -> str:
    if measured is None:
        return NOT_REPRODUCED
    if paper is None:
        return PARTLY
    if isinstance(paper, bool):
        return REPRODUCED if measured == paper else NOT_REPRODUCED
    if isinstance(paper, list):
        good = sum(_within(m, p, tolerance) for m, p in zip(measured, paper, strict=True))
        return (NOT_REPRODUCED, PARTLY, REPRODUCED)[good]
    if _within(measured, paper, tolerance):
        return REPRODUCED
    return PARTLY if _within(measured, paper, 2 * tolerance) else NOT_REPRODUCED


def _within(measured: float, paper: float, tolerance: float) -> bool:
    """Relative distance from the paper's number; from a half on, tolerances are factors 1 + tolerance either way."""
    if tolerance < 0.5:
        return abs(measured - paper) <= tolerance * abs(paper)
    return measured * paper > 0 and 1 / (1 + tolerance) <= measured / paper <= 1 + tolerance


def write(path: str | Path, claims: list[Claim]) -> None:
    """claims.json: a list of objects whose keys are the fields of Claim."""
    Path(path).write_text(json.dumps([c._asdict() for c in claims], indent=1, allow_nan=False) + "\n", encoding="utf-8")


def shown(value: Value) -> str:
    """A value as the table prints it."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return "–".join(shown(v) for v in value)
    return f"{value:.3g}"
