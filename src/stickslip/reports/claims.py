"""Claims of a paper: the printed value, the measured value with its error, and a verdict that accounts for noise."""

import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy  # scipy.special is imported on first use, as this takes a tenth of a second

REPRODUCED, PARTLY, NOT_REPRODUCED = "reproduced", "partly", "not reproduced"
REFUTED, NOT_REFUTED = "refuted", "not refuted"
UNDECIDED, NO_REFERENCE = "undecided", "no reference"
VERDICTS = (REPRODUCED, PARTLY, NOT_REPRODUCED, REFUTED, NOT_REFUTED, UNDECIDED, NO_REFERENCE)
IS, CAN, ALWAYS = "is", "can", "always"  # kinds of statements: true in this case, possible, true in every case
DECISIVE = 2.0  # distance to the band in standard errors, above which a number is not reproduced
FACTOR = 0.5  # tolerances from this value on are factors in both directions; below it, bands are symmetric
NEGLIGIBLE = 5e-4  # relative error below which it does not show in the three digits of a table
ROUND_OFF = 1e-12  # relative slack at the edges of a band: 1.1 − 1.0 is more than 0.1 in floating point

Value = float | bool | list | None


class Claim(NamedTuple):
    """One row of a claims table.

    `paper` is the printed value at `source`: True for a statement, None without one. `reference` is any
    other value to compare with, and `reference_source` its origin. `error` is one standard error of a number, 0 if the
    number is deterministic, and None if it is unknown or does not apply. `tolerance` is relative.
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
    """Evaluate a measurement.

    The note gives the reason if the verdict is undecided, and the comparison with the reference.

    Parameters
    ----------
    source : "PLACE: words", where PLACE is a figure, equation, table or section of the paper
    error : one standard error of a number, 0 if it is deterministic; with None the claim stays undecided
    quantifier : "is"; "can": one instance suffices, and without one the claim stays undecided; "always": one
        counterexample refutes it, and cases without one do not prove it

    Examples
    --------
    >>> claim("speed", "Fig 5: text", 0.075, 0.080, "1", 0.25, error=0.01).verdict
    'reproduced'
    """
    paper, measured, reference = to_builtin(paper), to_builtin(measured), to_builtin(reference)
    error = None if error is None or not math.isfinite(error) else float(error)
    if not source.partition(":")[2].strip():
        raise ValueError(f"{id}: a source must be 'PLACE: words', a place in the paper and its words, got {source!r}")
    if (reference is None) == bool(reference_source):
        raise ValueError(f"{id}: give reference and reference_source together, or neither")
    word = verdict(paper, measured, tolerance, error, quantifier)
    if word == REFUTED and not note:
        raise ValueError(f"{id}: a refuted claim needs a note that states the counterexample")
    made = Claim(
        id, source, paper, measured, unit, tolerance, word, note, error, reference, reference_source, quantifier
    )
    notes = [note, f"undecided: {undecided_reason(made)}" if word == UNDECIDED else "", _describe_reference(made)]
    return made._replace(note="; ".join(text for text in notes if text))


def statement(id: str, source: str, holds: bool | None, note: str = "", **more) -> Claim:
    """Evaluate a statement of the paper that holds, does not hold, or is undecided (None); see `claim`."""
    return claim(id, source, True, holds, "", 0.0, note, **more)


def verdict(paper: Value, measured: Value, tolerance: float, error: float | None, quantifier: str = IS) -> str:
    """Compare a measurement with the paper's value and return one of `VERDICTS`.

    reproduced
        A number within the tolerance of the paper's, with a standard error that does not exceed the tolerance (the
        distance to the nearer edge of its band); a statement that holds (for "can": in at least one instance).
    partly
        A number within twice the tolerance, with such an error; a window with one end within the tolerance.
    not reproduced
        A number beyond that, and more than two standard errors away from the band; a window with both ends outside the
        tolerance, or one that was searched for and not found (an empty list); a statement that does not hold.
    refuted
        A statement claimed always to hold, with a counterexample in the note.
    not refuted
        A statement claimed always to hold, without a counterexample in the cases that were examined.
    undecided
        Any other number, or one whose error is unknown, as for a single realisation; a missing measurement; a "can"
        statement without an observed instance.
    no reference
        The paper prints nothing to compare with, even if another reference is given.

    A tolerance below 0.5 is a fraction of the paper's number. From 0.5 upwards, it is a factor of 1 + tolerance in both
    directions. If the paper prints zero, the tolerance is absolute. Twice the tolerance is twice the fraction, or a
    factor of 1 + 2 tolerance.

    Raises
    ------
    ValueError
        If tolerance or error is negative, the tolerance is not finite, the quantifier is unknown, or a statement is
        compared with a number, or a window with another kind of value.
    """
    paper, measured = to_builtin(paper), to_builtin(measured)
    if not 0 <= tolerance < math.inf:
        raise ValueError(f"a tolerance must be finite and not negative, got {tolerance}")
    if error is not None and error < 0:
        raise ValueError(f"a standard error must not be negative, got {error}")
    if quantifier not in (IS, CAN, ALWAYS):
        raise ValueError(f"quantifier must be is, can or always, got {quantifier!r}")
    return NO_REFERENCE if paper is None else _compare(paper, measured, tolerance, error, quantifier)


def _compare(target: Value, measured: Value, tolerance: float, error: float | None, quantifier: str) -> str:
    if measured is None:
        return UNDECIDED
    if isinstance(target, bool) or isinstance(measured, bool):
        if not (isinstance(target, bool) and isinstance(measured, bool)):
            raise ValueError(
                f"the measured value {measured!r} cannot be compared with the printed {target!r}: compare statements "
                "with statements"
            )
        holds = NOT_REFUTED if quantifier == ALWAYS else REPRODUCED
        return holds if measured == target else {IS: NOT_REPRODUCED, CAN: UNDECIDED, ALWAYS: REFUTED}[quantifier]
    if isinstance(target, list) != isinstance(measured, list) or (
        measured and isinstance(target, list) and len(measured) != len(target)
    ):
        raise ValueError(
            f"the measured value {measured!r} cannot be compared with the printed {target!r}: compare windows of the "
            "same length"
        )
    if isinstance(target, list):
        pairs = zip(target, measured, strict=True) if measured else ()
        ends = [_compare_numbers(p, m, tolerance, error) for p, m in pairs]
        if UNDECIDED in ends:
            return UNDECIDED
        return (NOT_REPRODUCED, PARTLY, REPRODUCED)[ends.count(REPRODUCED)]
    return _compare_numbers(target, measured, tolerance, error)


def _compare_numbers(target: float, measured: float, tolerance: float, error: float | None) -> str:
    if error is None or not math.isfinite(error) or not math.isfinite(measured):
        return UNDECIDED
    low, high = band(target, tolerance)
    slack = ROUND_OFF * abs(target)
    precise = error <= min(high - target, target - low) + slack
    for times, word in ((1, REPRODUCED), (2, PARTLY)):
        least, most = band(target, tolerance, times)
        if precise and least - slack <= measured <= most + slack:
            return word
    return NOT_REPRODUCED if max(low - measured, measured - high) > DECISIVE * error + slack else UNDECIDED


def band(target: float, tolerance: float, times: int = 1) -> tuple[float, float]:
    """Return the smallest and largest values within a multiple of the tolerance around a number."""
    wide = times * tolerance
    if target == 0:
        return -wide, wide
    if tolerance < FACTOR:
        return target - wide * abs(target), target + wide * abs(target)
    ends = target / (1 + wide), target * (1 + wide)
    return min(ends), max(ends)


def undecided_reason(made: Claim) -> str:
    """Return the reason why a claim is undecided."""
    if made.measured is None:
        return "left open" if _is_statement(made) else "not measured"
    if made.quantifier == CAN and _is_statement(made):
        return "no instance was observed"
    if made.error is None:
        return "its error is unknown"
    low, high = band(made.paper, made.tolerance) if isinstance(made.paper, int | float) else (-math.inf, math.inf)
    if low <= made.measured <= high if isinstance(made.measured, int | float) else True:
        return f"its error {made.error:.1e} exceeds the tolerance"
    return f"it is less than {DECISIVE:g} errors of {made.error:.1e} beyond the tolerance"


def _describe_reference(made: Claim) -> str:
    if made.reference is None:
        return ""
    word = _compare(made.reference, made.measured, made.tolerance, made.error, made.quantifier)
    relation = {PARTLY: "is within twice the tolerance of"}.get(word, "differs from")
    relation = "agrees with" if word in (REPRODUCED, NOT_REFUTED) else relation
    relation = "cannot be compared with" if word == UNDECIDED else relation
    value = "" if _is_statement(made) else f" {format_value(made.reference)}"
    return f"it {relation} the reference{value} ({made.reference_source})"


def _is_statement(made: Claim) -> bool:
    return isinstance(made.paper, bool) or isinstance(made.reference, bool)


def note_quick_run(claims: list[Claim]) -> list[Claim]:
    """Return the claims, with a note on those not measured in a quick run."""
    out = []
    for c in claims:
        reason = "left open by a quick run" if _is_statement(c) else "not measured by a quick run"
        out.append(c if c.measured is not None else c._replace(note="; ".join(filter(None, (reason, c.note)))))
    return out


def standard_error(values) -> float | None:
    """Standard error of a mean, widened by Student's t for few values.

    It is half of the half-width of a 95 % confidence interval. None with fewer than two values, since a single
    realisation has no known error.
    """
    if len(values) < 2:
        return None
    return float(np.std(values, ddof=1) / np.sqrt(len(values)) * 0.5 * scipy.special.stdtrit(len(values) - 1, 0.975))


def median_error(values) -> float | None:
    """Standard error of the median of normally distributed values: √(π/2) times that of their mean."""
    error = standard_error(values)
    return None if error is None else float(np.sqrt(np.pi / 2)) * error


def to_builtin(value) -> Value:
    """Convert NumPy types to built-in types, and non-finite numbers to None."""
    if value is None or isinstance(value, bool | np.bool_):
        return value if value is None else bool(value)
    if isinstance(value, list | tuple | np.ndarray):
        ends = [to_builtin(v) for v in value]
        return None if None in ends else ends
    if not math.isfinite(value):
        return None
    return int(value) if isinstance(value, int | np.integer) else float(value)


def write_json(path: str | Path, claims: list[Claim]) -> None:
    """Write claims.json, a list of objects whose keys are the fields of Claim."""
    Path(path).write_text(json.dumps([c._asdict() for c in claims], indent=1, allow_nan=False) + "\n", encoding="utf-8")


def format_value(value: Value) -> str:
    """Format a value for tables."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return "–".join(map(format_value, value)) or "none"
    return f"{value:.3g}"


def format_measured(made: Claim) -> str:
    """Format the measured value and its error for tables."""
    text, value = format_value(made.measured), made.measured
    if isinstance(value, bool | list) or value is None or not made.error or made.error < NEGLIGIBLE * abs(value):
        return text
    return f"{text} ± {made.error:.2g}"
