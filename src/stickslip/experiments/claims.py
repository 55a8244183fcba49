"""Claims of a paper: what it prints, what was measured with its error, and a verdict that noise cannot earn."""

import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

REPRODUCED, PARTLY, NOT_REPRODUCED = "reproduced", "partly", "not reproduced"
REFUTED, UNDECIDED, NO_REFERENCE = "refuted", "undecided", "no reference"
VERDICTS = (REPRODUCED, PARTLY, NOT_REPRODUCED, REFUTED, UNDECIDED, NO_REFERENCE)
IS, CAN, ALWAYS = "is", "can", "always"  # kinds of statements: something is so, can be so, is always so
FACTOR = 0.5  # tolerance from which on it is a factor either way: below, a symmetric band is as good
NEGLIGIBLE = 5e-4  # error, relative, below which it does not show in the three digits of a table
ROUND_OFF = 1e-12  # relative, on the edges of a band: 1.1 − 1.0 is more than 0.1 in floating point

Value = float | bool | list | None


class Claim(NamedTuple):
    """One row of a claims table.

    `paper` is what the paper prints at `source`, None if it prints nothing; a statement is True. `reference` is any
    other value to compare with, and `reference_source` its origin. `error` is one standard error of a number, 0 if it
    follows from the model without chance, None if it is not known or does not apply. `tolerance` is relative.
    """

    id: str
    source: str
    paper: Value
    measured: Value
    unit: str
    tolerance: float
    verdict: str
    note: str
    error: float | None = None
    reference: Value = None
    reference_source: str = ""
    quantifier: str = IS


def claim(
    id: str, source: str, paper: Value, measured: Value, unit: str, tolerance: float, note: str = "", *,
    error: float | None = None, reference: Value = None, reference_source: str = "", quantifier: str = IS,
) -> Claim:  # fmt: skip
    """Judge a measurement; its note then says why nothing was decided, and how it compares with the reference.

    Parameters
    ----------
    source : "PLACE: words", where PLACE is a figure, equation, table or section of the paper
    error : one standard error of a number; without one (None) nothing is decided; 0 for what involves no chance
    quantifier : "is"; "can": one instance is enough, and none seen decides nothing; "always": a counterexample refutes

    Examples
    --------
    >>> claim("speed", "Fig 5: text", 0.075, 0.080, "1", 0.25, error=0.01).verdict
    'reproduced'
    """
    paper, measured, reference = to_builtin(paper), to_builtin(measured), to_builtin(reference)
    error = None if error is None or not math.isfinite(error) else float(error)
    if not source.partition(":")[2].strip():
        raise ValueError(f"{id}: source {source!r} names no place of the paper, a colon, and what stands there")
    if (reference is None) == bool(reference_source):
        raise ValueError(f"{id}: a reference needs its origin, and an origin a reference")
    word = verdict(paper, measured, tolerance, error, quantifier)
    if word == REFUTED and not note:
        raise ValueError(f"{id}: a refutation needs a note with its counterexample")
    made = Claim(
        id, source, paper, measured, unit, tolerance, word, note, error, reference, reference_source, quantifier
    )
    said = [note, f"undecided: {undecided_reason(made)}" if word == UNDECIDED else "", _describe_reference(made)]
    return made._replace(note="; ".join(words for words in said if words))


def verdict(paper: Value, measured: Value, tolerance: float, error: float | None, quantifier: str = IS) -> str:
    """Decide what a measurement says about what the paper prints; one of `VERDICTS`.

    reproduced
        A number within the tolerance of the paper's; a statement that holds (of "can": in one instance at least).
    partly
        A number within twice the tolerance; one end of a window within the tolerance.
    not reproduced
        A number beyond that; a window whose ends both are, or that was looked for and is not there (an empty list);
        a statement that does not hold.
    refuted
        A statement that is said to hold always, of which the note exhibits a counterexample.
    undecided
        The standard error exceeds the tolerance (the distance to the nearer edge of its band) or is not known, as with
        one realization; nothing was measured; something that can happen was not seen.
    no reference
        The paper prints nothing to compare with, whatever a reference from elsewhere says.

    A tolerance below 0.5 is a share of the paper's number, from 0.5 on a factor 1 + tolerance either way; beside a
    printed zero it is absolute. Twice the tolerance is twice the share, or the factor 1 + 2 tolerance.

    Raises
    ------
    ValueError
        if tolerance or error is negative or the tolerance not finite, if the quantifier is unknown, and if a statement
        stands beside a number, or a window beside something else.
    """
    paper, measured = to_builtin(paper), to_builtin(measured)
    if not 0 <= tolerance < math.inf:
        raise ValueError(f"a tolerance of {tolerance} was given: a number from 0 on is needed")
    if error is not None and error < 0:
        raise ValueError(f"an error of {error} was given: a standard error is not negative")
    if quantifier not in (IS, CAN, ALWAYS):
        raise ValueError(f"quantifier {quantifier!r} was given: use is, can or always")
    return NO_REFERENCE if paper is None else _compare(paper, measured, tolerance, error, quantifier)


def _compare(target: Value, measured: Value, tolerance: float, error: float | None, quantifier: str) -> str:
    if measured is None:
        return UNDECIDED
    if isinstance(target, bool) or isinstance(measured, bool):
        if not (isinstance(target, bool) and isinstance(measured, bool)):
            raise ValueError(f"{measured!r} was measured where {target!r} is printed: a statement beside a number")
        otherwise = {IS: NOT_REPRODUCED, CAN: UNDECIDED, ALWAYS: REFUTED}[quantifier]
        return REPRODUCED if measured == target else otherwise
    if isinstance(target, list) != isinstance(measured, list) or (
        measured and isinstance(target, list) and len(measured) != len(target)
    ):
        raise ValueError(f"{measured!r} was measured where {target!r} is printed: windows need windows")
    if isinstance(target, list):
        ends = (
            [_compare_numbers(p, m, tolerance, error) for p, m in zip(target, measured, strict=True)]
            if measured
            else []
        )
        if UNDECIDED in ends:
            return UNDECIDED
        return (NOT_REPRODUCED, PARTLY, REPRODUCED)[ends.count(REPRODUCED)]
    return _compare_numbers(target, measured, tolerance, error)


def _compare_numbers(target: float, measured: float, tolerance: float, error: float | None) -> str:
    if error is None or not math.isfinite(error) or not math.isfinite(measured):
        return UNDECIDED
    low, high = band(target, tolerance)
    slack = ROUND_OFF * abs(target)
    if error > min(high - target, target - low) + slack:
        return UNDECIDED
    if low - slack <= measured <= high + slack:
        return REPRODUCED
    low, high = band(target, tolerance, times=2)
    return PARTLY if low - slack <= measured <= high + slack else NOT_REPRODUCED


def band(target: float, tolerance: float, times: int = 1) -> tuple[float, float]:
    """Least and greatest value within some times a tolerance of a number."""
    wide = times * tolerance
    if target == 0:
        return -wide, wide
    if tolerance < FACTOR:
        return target - wide * abs(target), target + wide * abs(target)
    ends = target / (1 + wide), target * (1 + wide)
    return min(ends), max(ends)


def undecided_reason(made: Claim) -> str:
    """Why a claim is undecided, in words."""
    if made.measured is None:
        return "left open" if _is_statement(made) else "not measured"
    if made.quantifier == CAN and _is_statement(made):
        return "what can happen was not seen"
    if made.error is None:
        return "its error is not known"
    return f"its error {made.error:.1e} exceeds the tolerance"


def _describe_reference(made: Claim) -> str:
    if made.reference is None:
        return ""
    word = _compare(made.reference, made.measured, made.tolerance, made.error, made.quantifier)
    how = {REPRODUCED: "agrees with", PARTLY: "is within twice the tolerance of"}.get(word, "differs from")
    how = "cannot be compared with" if word == UNDECIDED else how
    value = "" if _is_statement(made) else f" {shown(made.reference)}"
    return f"it {how} the reference{value} ({made.reference_source})"


def _is_statement(made: Claim) -> bool:
    return isinstance(made.paper, bool) or isinstance(made.reference, bool)


def for_quick_run(claims: list[Claim]) -> list[Claim]:
    """The claims, where those without a measurement say that a quick run is why."""
    out = []
    for c in claims:
        said = "left open by a quick run" if _is_statement(c) else "not measured by a quick run"
        out.append(c if c.measured is not None else c._replace(note="; ".join(filter(None, (said, c.note)))))
    return out


def standard_error(values) -> float | None:
    """Standard error of a mean, widened by Student's t for few values (half of a 95 % interval's half width).

    None with fewer than two values: one realization does not tell its error.
    """
    if len(values) < 2:
        return None
    return float(np.std(values, ddof=1) / np.sqrt(len(values)) * 0.5 * student.ppf(0.975, len(values) - 1))


def median_error(values) -> float | None:
    """Standard error of a median of values with normal scatter: √(π/2) times that of their mean."""
    error = standard_error(values)
    return None if error is None else float(np.sqrt(np.pi / 2)) * error


def to_builtin(value) -> Value:
    """A value without NumPy's types; None for a number that is not finite."""
    if value is None or isinstance(value, bool | np.bool_):
        return value if value is None else bool(value)
    if isinstance(value, list | tuple | np.ndarray):
        ends = [to_builtin(v) for v in value]
        return None if None in ends else ends
    if not math.isfinite(value):
        return None
    return int(value) if isinstance(value, int | np.integer) else float(value)


def write_json(path: str | Path, claims: list[Claim]) -> None:
    """claims.json: a list of objects whose keys are the fields of Claim."""
    Path(path).write_text(json.dumps([c._asdict() for c in claims], indent=1, allow_nan=False) + "\n", encoding="utf-8")


def shown(value: Value) -> str:
    """A value as tables print it."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return "–".join(map(shown, value)) or "none"
    return f"{value:.3g}"


def format_measured(made: Claim) -> str:
    """What was measured, with its error, as tables print it."""
    words, value = shown(made.measured), made.measured
    if isinstance(value, bool | list) or value is None or not made.error or made.error < NEGLIGIBLE * abs(value):
        return words
    return f"{words} ± {made.error:.2g}"
