"""Reports on the claims of a paper: JSON, Markdown and image files, and a summary on the terminal."""

import math
from collections import Counter
from pathlib import Path

from rich.table import Table

from ..data.run_files import CHART, CLAIMS, NOTES
from ..figures.claims import Row, claims_chart
from ..figures.saving import PLAIN, Look, render_all
from .claims import (
    CAN,
    FACTOR,
    NO_REFERENCE,
    NOT_REFUTED,
    NOT_REPRODUCED,
    PARTLY,
    REFUTED,
    REPRODUCED,
    UNDECIDED,
    VERDICTS,
    Claim,
    format_measured,
    format_value,
    write_json,
)
from .terminal import UNBROKEN, console

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
WIDE = 120  # number of columns from which each line includes the content of the figure


def write_claims(
    folder: Path, claims: list[Claim], shows: Shows, title: str, failures=(), look: Look = PLAIN
) -> None:  # fmt: skip
    """Write claims.json, claims.md and claims.png; `failures` are sentences, printed and listed in claims.md."""
    for failure in failures:
        console.print(failure, style="yellow")
    write_json(folder / CLAIMS, claims)
    (folder / NOTES).write_text(markdown(claims, shows, title, failures), encoding="utf-8")
    for name, content in render_all(CHART, claims_chart(chart_rows(claims, shows), title), look).items():
        (folder / name).write_bytes(content)


def place(made: Claim) -> str:
    """Return the figure, table or section of a claim: its source up to the colon."""
    return made.source.partition(":")[0]


def variant(made: Claim) -> str:
    """Return the model variant of a claim: its id after @, empty for the paper's own model."""
    return made.id.partition("@")[2]


def chart_rows(claims: list[Claim], shows: Shows) -> list[Row]:
    """Return the rows of the chart, by figure: deviations from the paper or the reference, in units of the tolerance.

    The paper's own model comes first, then the variants.
    """
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

    Empty for statements and missing values.
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
    """Return the number of sentences that have a row, and how many of them have no undecided row.

    Rows with the same source belong to one sentence. Variants, and rows without a value in the paper, do not count.
    """
    own = [c for c in claims if c.paper is not None and not variant(c)]
    sentences = {c.source for c in own}
    return len(sentences), len(sentences - {c.source for c in own if c.verdict == UNDECIDED})


def summarize(claims: list[Claim], shows: Shows) -> tuple[str, str, str]:
    """Return three sentences: numbers of decided sentences and reproduced claims, and reasons for the others."""
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
    return sentences, first, _main_reason(judged, shows)


def _main_reason(judged: list[Claim], shows: Shows) -> str:
    missed = [c for c in judged if c.verdict in (NOT_REPRODUCED, REFUTED)]
    parts = [_most_missed(missed, shows)] if missed else []
    why = Counter(_undecided_cause(c) for c in judged if c.verdict == UNDECIDED)
    if why:
        parts.append("undecided because " + ", ".join(f"{reason} ({n})" for reason, n in why.most_common()))
    text = "; ".join(parts) or "every claim agrees within its tolerance"
    return text[0].upper() + text[1:] + "."


def _most_missed(missed: list[Claim], shows: Shows) -> str:
    """Describe the figure with the most rows that disagree, and one of these rows, if possible the one to quote."""
    (most, number), *_ = Counter(map(place, missed)).most_common(1)
    share = f"{number} of {len(missed)}"
    verb = "is" if number == 1 else "are"
    how = "the disagreement is in" if number == len(missed) else f"of the rows that disagree, {share} {verb} in"
    here = [c for c in missed if place(c) == most]
    what, key = shows.get(most, ("", ""))
    quoted = next((c for c in here if c.id == key), here[0])
    return f"{how} {most}{f' ({what})' if what else ''}: {_quote(quoted)}"


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
    """Return a line per figure of the paper: name, content, number of reproduced rows, key number."""
    out = []
    for name, (content, key) in shows.items():
        here = [c for c in claims if place(c) == name]
        variants = dict.fromkeys(map(variant, here))
        counted = [_count_reproduced([c for c in here if variant(c) == v], v) for v in variants]
        quoted = next((_quote(c) for c in here if c.id == key), "")
        out.append((name, content, ", ".join(filter(None, counted)) or "–", quoted))
    return out


def _count_reproduced(here: list[Claim], name: str) -> str:
    judged = [c for c in here if c.verdict != NO_REFERENCE]
    done = sum(c.verdict == REPRODUCED for c in judged)
    return (f"{name} " if name else "") + f"{done} of {len(judged)}" if judged else ""


def show_claims(claims: list[Claim], shows: Shows) -> None:
    """Print three sentences and a line per figure of the paper; everything else is in claims.md."""
    for sentence in summarize(claims, shows):
        console.print(sentence)
    # on a narrow terminal, the key number is folded
    lines = figure_lines(claims, shows)
    folded = console.width < UNBROKEN
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
        lines += [_markdown_row(c) for c in claims if place(c) == name]
    lines += ["", "## Notes", ""]
    for c in claims:
        lines += [f"- **{c.id}** ({c.verdict}): {_escape(c.note) or '–'}."]
    return "\n".join(lines) + "\n"


def _markdown_row(c: Claim) -> str:
    source = c.source.partition(":")[2].strip() or c.source
    tolerance = f"{c.tolerance:.2g}" if c.tolerance < FACTOR else f"a factor of {1 + c.tolerance:.2g}"
    tolerance = "–" if isinstance(c.measured, bool) or not c.tolerance else tolerance
    cells = (
        c.id, source, format_value(c.paper), format_value(c.reference), format_measured(c), c.unit or "–", tolerance,
        f"**{c.verdict}**",
    )  # fmt: skip
    return "| " + " | ".join(_escape(cell) for cell in cells) + " |"


def _escape(text: str) -> str:
    """Escape text for a cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")
