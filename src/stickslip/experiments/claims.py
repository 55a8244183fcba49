"""What a paper states, what the package measured, and an honest verdict."""

import json
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


def claim(id: str, source: str, paper: Value, measured: Value, unit: str, tolerance: float, note: str = "") -> Claim:
    """A row with its verdict.

    Numbers: reproduced within the tolerance, partly within twice it. Windows: each end counts for half. Booleans:
    equal or not. Nothing measured: not reproduced.

    Examples
    --------
    >>> claim("speed", "Fig 5", 0.075, 0.080, "1", 0.25).verdict
    'reproduced'
    """
    return Claim(id, source, paper, measured, unit, tolerance, _verdict(paper, measured, tolerance), note)


def _verdict(paper: Value, measured: Value, tolerance: float) -> str:
    if measured is None or paper is None:
        return NOT_REPRODUCED
    if isinstance(paper, bool):
        return REPRODUCED if measured == paper else NOT_REPRODUCED
    if isinstance(paper, list):
        good = sum(abs(m - p) <= tolerance * abs(p) for m, p in zip(measured, paper, strict=True))
        return (NOT_REPRODUCED, PARTLY, REPRODUCED)[good]
    error = abs(measured - paper)
    if error <= tolerance * abs(paper):
        return REPRODUCED
    return PARTLY if error <= 2 * tolerance * abs(paper) else NOT_REPRODUCED


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
