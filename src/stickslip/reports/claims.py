"""Claims of a paper: the printed value, the measured value with its error, and a verdict that accounts for noise.

Claims are reported in a summary on the terminal, and in JSON, Markdown and image files.
"""

import json
import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy  # scipy.special is imported on first use, as this takes a tenth of a second

from .. import reports
from ..data.run_files import CHART, CLAIMS, NOTES

if TYPE_CHECKING:  # these need Matplotlib
    from ..figures.claims import Row
    from ..figures.style import Look

REPRODUCED, PARTLY, NOT_REPRODUCED = "reproduced", "partly", "not reproduced"
REFUTED, NOT_REFUTED = "refuted", "not refuted"
UNDECIDED, NO_REFERENCE = "undecided", "no reference"
VERDICTS = (REPRODUCED, PARTLY, NOT_REPRODUCED, REFUTED, NOT_REFUTED, UNDECIDED, NO_REFERENCE)
IS, CAN, ALWAYS = "is", "can", "always"  # kinds of statements: true in this case, possible, true in every case
DECISIVE = 2.0  # distance to the band in standard errors, above which a number is not reproduced
FACTOR = 0.5  # tolerances from this value on are factors in both directions; below it, bands are symmetric
NEGLIGIBLE = 5e-4  # relative error below which an error does not show in the three digits of a table
ROUND_OFF = 1e-12  # relative slack at the edges of a band: 1.1 − 1.0 is more than 0.1 in floating point

Value = float | bool | list | None


class Claim(NamedTuple):
    """One row of a claims table.

    `paper` is the printed value at `source`: True for a statement, None if there is no value. `reference` is any
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
    """Compare a measurement with the paper's value, and return a row of the claims table.

    To `note`, the reason is added if the verdict is undecided, and the comparison with the reference if there is one.

    Parameters
    ----------
    source : "PLACE: words", where PLACE is a figure, equation, table or section of the paper
    error : one standard error of a number, 0 if it is deterministic; with None, the claim stays undecided
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
        raise ValueError(
            f"{id}: a source must be 'PLACE: words', a place in the paper and the words there, got {source!r}"
        )
    if (reference is None) == bool(reference_source):
        raise ValueError(f"{id}: give reference and reference_source together, or neither")
    word = verdict(paper, measured, tolerance, error, quantifier)
    if word == REFUTED and not note:
        raise ValueError(f"{id}: a refuted claim needs a note that states the counterexample")
    made = Claim(
        id, source, paper, measured, unit, tolerance, word, note, error, reference, reference_source, quantifier
    )
    notes = [note, f"undecided: {undecided_reason(made)}" if word == UNDECIDED else ""]
    if reference is not None:
        found = _compare(reference, measured, tolerance, error, quantifier)
        relation = {
            REPRODUCED: "agrees with", NOT_REFUTED: "agrees with", PARTLY: "is within twice the tolerance of",
            UNDECIDED: "cannot be compared with",
        }.get(found, "differs from")  # fmt: skip
        value = "" if _is_statement(made) else f" {format_value(reference)}"
        notes.append(f"it {relation} the reference{value} ({reference_source})")
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

    A tolerance below 0.5 is a fraction of the paper's number. From 0.5 upwards, it allows a factor of 1 + tolerance in
    either direction. If the paper prints zero, the tolerance is absolute. Twice the tolerance is twice the fraction, or
    a factor of 1 + 2 tolerance.

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
                f"the measured value {measured!r} cannot be compared with the value {target!r}: compare statements "
                "with statements"
            )
        holds = NOT_REFUTED if quantifier == ALWAYS else REPRODUCED
        return holds if measured == target else {IS: NOT_REPRODUCED, CAN: UNDECIDED, ALWAYS: REFUTED}[quantifier]
    if isinstance(target, list) != isinstance(measured, list) or (
        measured and isinstance(target, list) and len(measured) != len(target)
    ):
        raise ValueError(
            f"the measured value {measured!r} cannot be compared with the value {target!r}: compare windows of the "
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

    It is half of the half-width of a 95 % confidence interval. With fewer than two values, the result is None, since a
    single realisation has no known error.
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


Shows = dict[str, tuple[str, str]]  # figure of the paper: its content, and the id of the claim to quote
MEANING = {
    REPRODUCED: "within the tolerance; a statement that holds",
    PARTLY: "within twice the tolerance; one end of a window",
    NOT_REPRODUCED: "beyond that, by more than two errors from the tolerance; a statement that does not hold",
    REFUTED: "claimed always to hold, with a counterexample in the note",
    NOT_REFUTED: "claimed always to hold, without a counterexample in the cases of the note",
    UNDECIDED: "the error is too large or unknown; not measured; possible, but not observed",
    NO_REFERENCE: "the paper prints nothing to compare with",
}
WIDE = 120  # smallest number of columns at which each line includes the content of the figure


def write_claims(
    folder: Path, claims: list[Claim], shows: Shows, title: str, failures=(), look: "Look | None" = None
) -> None:
    """Write claims.json, claims.md and claims.png; `failures` are sentences, printed and listed in claims.md."""
    from ..figures.claims import claims_chart
    from ..figures.style import PLAIN, render_all

    for failure in failures:
        reports.terminal.console.print(failure, style="yellow")
    write_json(folder / CLAIMS, claims)
    (folder / NOTES).write_text(markdown(claims, shows, title, failures), encoding="utf-8")
    for name, content in render_all(CHART, claims_chart(chart_rows(claims, shows), title), look or PLAIN).items():
        (folder / name).write_bytes(content)


def place(made: Claim) -> str:
    """Return the figure, table or section of a claim: its source up to the colon."""
    return made.source.partition(":")[0]


def variant(made: Claim) -> str:
    """Return the model variant of a claim: its id after @, empty for the paper's own model."""
    return made.id.partition("@")[2]


def chart_rows(claims: list[Claim], shows: Shows) -> "list[Row]":
    """Return the rows of the chart, by figure: deviations from the paper or the reference, in units of the tolerance.

    The paper's own model comes first, then the variants.
    """
    from ..figures.claims import Row

    order, out = list(shows), []
    for c in sorted(claims, key=lambda c: (variant(c), order.index(place(c)))):
        uses_reference = c.paper is None and c.reference is not None
        target = c.reference if uses_reference else c.paper
        ends, error = deviation(target, c.measured, c.tolerance, c.error)
        group = place(c) + (f" @{variant(c)}" if variant(c) else "")
        label = c.id.partition("@")[0].replace("-", " ")
        unit = "" if c.unit == "1" else c.unit
        missing = "left open" if isinstance(target, bool) else "not measured"
        instead = missing if c.measured is None else format_value(c.measured) if isinstance(c.measured, bool) else ""
        values = format_measured(c), format_value(target)
        out.append(Row(label, group, c.verdict, ends, error, *values, uses_reference, unit, not variant(c), instead))
    return out


def deviation(target, measured, tolerance: float, error: float | None) -> tuple[tuple[float, ...], float]:
    """Return the deviations of numbers and their errors, in units of the tolerance.

    There are no deviations for statements and missing values.
    """
    if measured is None or target is None or isinstance(target, bool):
        return (), 0.0
    pairs = list(zip(target, measured, strict=True)) if isinstance(target, list) and measured else [(target, measured)]
    if not all(isinstance(x, int | float) for pair in pairs for x in pair):
        return (), 0.0
    ends = tuple(_distance(p, m, tolerance) for p, m in pairs)
    half = abs(_distance(pairs[0][0], pairs[0][0] + (error or 0.0) * math.copysign(1, pairs[0][0]), tolerance))
    return ends, half if math.isfinite(half) else 0.0


def _distance(target: float, measured: float, tolerance: float) -> float:
    if measured == target:
        return 0.0
    if tolerance == 0:
        return math.copysign(math.inf, measured - target)
    if tolerance < FACTOR or target == 0:
        return (measured - target) / (tolerance * (abs(target) or 1.0))
    if measured * target <= 0:
        return math.copysign(math.inf, measured - target)
    return math.copysign(1, target) * math.log(measured / target) / math.log(1 + tolerance)


def count_sentences(claims: list[Claim]) -> tuple[int, int]:
    """Return the number of the paper's sentences that have a row, and the number of those without an undecided row.

    Rows with the same source belong to one sentence. Variants, and rows without a value in the paper, do not count.
    """
    own = [c for c in claims if c.paper is not None and not variant(c)]
    sentences = {c.source for c in own}
    return len(sentences), len(sentences - {c.source for c in own if c.verdict == UNDECIDED})


def summarize(claims: list[Claim], shows: Shows) -> tuple[str, str, str]:
    """Return three sentences: counts of decided sentences and reproduced claims, and the reasons for the others."""
    own = [c for c in claims if not variant(c)]
    total, decided = count_sentences(claims)
    judged = [c for c in own if c.verdict != NO_REFERENCE]
    count = Counter(c.verdict for c in judged)
    kinds = {PARTLY: "in part", NOT_REPRODUCED: "not", REFUTED: "refuted", NOT_REFUTED: "not refuted",
             UNDECIDED: "undecided"}  # fmt: skip
    others = [f"{count[kind]} {label}" for kind, label in kinds.items() if count[kind]]
    lacking = len(own) - len(judged)
    verb = "is" if count[REPRODUCED] == 1 else "are"
    first = f"{count[REPRODUCED]} of the paper's {len(judged)} claims {verb} reproduced"
    first += f", {', '.join(others)}" if others else ""
    first += f"; the paper prints nothing to compare with for {lacking} more rows." if lacking else "."
    sentences = f"Of the paper's sentences, {total} {'has' if total == 1 else 'have'} a row, and {decided} of these "
    sentences += f"{'is' if decided == 1 else 'are'} decided."
    missed = [c for c in judged if c.verdict in (NOT_REPRODUCED, REFUTED)]
    parts = [_most_missed(missed, shows)] if missed else []
    why = Counter(_undecided_cause(c) for c in judged if c.verdict == UNDECIDED)
    if why:
        parts.append("undecided because " + ", ".join(f"{reason} ({n})" for reason, n in why.most_common()))
    reason = "; ".join(parts) or "every claim agrees within its tolerance"
    return sentences, first, f"{reason[0].upper()}{reason[1:]}."


def _most_missed(missed: list[Claim], shows: Shows) -> str:
    """Describe the figure with the most rows that disagree, and one of these rows, if possible the one to quote."""
    (most, number), *_ = Counter(map(place, missed)).most_common(1)
    share = f"{number} of {len(missed)}"
    verb = "is" if number == 1 else "are"
    how = "the disagreement is in" if number == len(missed) else f"of the rows that disagree, {share} {verb} in"
    here = [c for c in missed if place(c) == most]
    content, key = shows.get(most, ("", ""))
    quoted = next((c for c in here if c.id == key), here[0])
    return f"{how} {most}{f' ({content})' if content else ''}: {_quote(quoted)}"


def _undecided_cause(made: Claim) -> str:
    """Return the reason why a claim is undecided, without numbers."""
    if made.measured is None:
        return "its interval leaves it open" if made.paper is True else "nothing could be measured"
    if made.quantifier == CAN:
        return "no instance was observed"
    return "its error is unknown" if made.error is None else "its error is too large"


def _quote(made: Claim) -> str:
    """Format a claim with its two numbers."""
    if isinstance(made.measured, bool):
        return f"{made.id} {format_value(made.measured) if made.paper is None else made.verdict}"
    name, value = ("reference", made.reference) if made.paper is None else ("paper", made.paper)
    measured = "not measured" if made.measured is None else format_measured(made)
    return f"{made.id} {measured}" + (f", {name} {format_value(value)}" if value is not None else "")


def figure_lines(claims: list[Claim], shows: Shows) -> list[tuple[str, str, str, str]]:
    """Return a line per figure of the paper: name, content, number of reproduced rows, and key number."""
    out = []
    for name, (content, key) in shows.items():
        here = [c for c in claims if place(c) == name]
        judged = Counter(variant(c) for c in here if c.verdict != NO_REFERENCE)
        done = Counter(variant(c) for c in here if c.verdict == REPRODUCED)
        counted = (f"{v} {done[v]} of {judged[v]}".lstrip() for v in dict.fromkeys(map(variant, here)) if judged[v])
        quoted = next((_quote(c) for c in here if c.id == key), "")
        out.append((name, content, ", ".join(counted) or "–", quoted))
    return out


def show_claims(claims: list[Claim], shows: Shows) -> None:
    """Print three sentences and a line per figure of the paper; everything else is in claims.md."""
    from rich.table import Table

    console = reports.terminal.console
    for sentence in summarize(claims, shows):
        console.print(sentence)
    # on a narrow terminal, the key number is wrapped
    lines = figure_lines(claims, shows)
    folded = console.width < reports.terminal.UNBROKEN
    table = Table(box=None, pad_edge=False, header_style="bold", expand=folded)
    names = ("paper", "shows", "reproduced", "key number")
    for k, name in enumerate(names):
        width = max(len(name), *(len(line[k]) for line in lines))
        if k == len(names) - 1:
            table.add_column(name, overflow="fold", ratio=1 if folded else None)
        elif name != "shows" or console.width >= WIDE:
            table.add_column(name, no_wrap=True, min_width=width)
    for name, content, share, number in lines:
        cells = (name, content, share, number) if console.width >= WIDE else (name, share, number)
        table.add_row(*cells)
    console.print(table)
    console.print(f"All rows, with reasons, are in {NOTES}.")


def markdown(claims: list[Claim], shows: Shows, title: str, failures=()) -> str:
    """Return claims.md: summary, failures, meaning of the verdicts, a table per figure of the paper, and all notes."""
    lines = [f"# {title}", "", " ".join(summarize(claims, shows)), "", f"![claims]({CHART})", ""]
    if failures:
        lines += ["Missing, because they failed:", "", *(f"- {_escape(failure)}" for failure in failures), ""]
    for word in VERDICTS:
        own, others = (sum(c.verdict == word and bool(variant(c)) == kind for c in claims) for kind in (False, True))
        lines.append(f"- **{word}** ({own}{f' + {others} of variants' if others else ''}): {MEANING[word]}")
    head = "| claim | source | paper | reference | measured | unit | tolerance | verdict |"
    for name in dict.fromkeys(map(place, claims)):
        what = f": {shows[name][0]}" if name in shows else ""
        lines += ["", f"## {name}{what}", "", head, "|---|---|---|---|---|---|---|---|"]
        for c in (c for c in claims if place(c) == name):
            source = c.source.partition(":")[2].strip() or c.source
            tolerance = f"{c.tolerance:.2g}" if c.tolerance < FACTOR else f"a factor of {1 + c.tolerance:.2g}"
            tolerance = "–" if isinstance(c.measured, bool) or not c.tolerance else tolerance
            values = format_value(c.paper), format_value(c.reference), format_measured(c)
            cells = (c.id, source, *values, c.unit or "–", tolerance, f"**{c.verdict}**")
            lines.append("| " + " | ".join(map(_escape, cells)) + " |")
    lines += ["", "## Notes", ""]
    for c in claims:
        lines += [f"- **{c.id}** ({c.verdict}): {_escape(c.note) or '–'}."]
    return "\n".join(lines) + "\n"


def _escape(text: str) -> str:
    """Escape text for a cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")
