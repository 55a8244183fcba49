"""Watch a simulation: write its frames to a table and a page, and show them in the terminal.

The table is a CSV file with a comment that states how it was computed. The terminal shows a live table, or one line per
frame if it cannot redraw.
"""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ... import __version__
from ...kit import (
    Array,
    check_free,
    check_output,
    console,
    describe_law,
    format_table,
    lammps_series,
    page,
    parse_number,
    pluralize,
    read_table,
    read_text,
    render,
    staged_file,
    style,
    terminal,
    write_atomically,
)
from ...measure import BALANCED_BELOW
from .watch import Progress, Row, verdict_word, watch

Column = Annotated[Any, Array((1,), finite=False)]  # NaN for unknown quantities
COLOURS = {"stable": style.GREEN, "unstable": style.RED}  # other verdicts have no colour


def _line(axes, step, values, color, label=None, quantity=None):
    finite = np.isfinite(values)
    axes.plot(step[finite], values[finite], "o-", color=color, ms=2, lw=0.8, label=label)
    if quantity:
        style.label_axes(axes, y=quantity)


@style.styled
def watched_stress(step: Column, pressure: Column, shear: Column):
    """Pressure, and the ratio of shear stress to pressure, against the time step."""
    figure, (above, below) = style.column_axes(2, 2.8, sharex=True)
    _line(above, step, pressure, style.BLUE, quantity=("pressure", "stress"))
    ratio = np.divide(shear, pressure, out=np.full(len(step), np.nan), where=np.abs(pressure) > 0)
    _line(below, step, ratio, style.ORANGE, quantity="shear / pressure")
    style.label_axes(below, x="time step")
    return figure


@style.styled
def watched_contacts(step: Column, coordination: Column, sliding: Column):
    """Coordination number and fraction of sliding contacts against the time step."""
    figure, (above, below) = style.column_axes(2, 2.8, sharex=True)
    _line(above, step, coordination, style.BLUE, quantity="contacts per grain")
    _line(below, step, sliding, style.ORANGE, quantity="sliding fraction")
    below.set_ylim(0, 1.1 * max(np.nanmax(sliding, initial=0.0), 0.01))
    if not np.isfinite(sliding).any():
        below.text(0.5, 0.5, "unknown without memory", ha="center", va="center", transform=below.transAxes)
        below.set_yticks([])
    style.label_axes(below, x="time step")
    return figure


@style.styled
def watched_spectrum(step: Column, softest: Column, growth: Column, verdicts: list[str]):
    """Softest eigenvalue and growth rate of the fastest pair against the time step; filled marks have a verdict.

    Parameters
    ----------
    growth : growth rates, 0 if no pair grows, NaN without a spectrum
    verdicts : one word per frame, such as stable or unstable
    """
    figure, (above, below) = style.column_axes(2, 2.8, sharex=True)
    _line(above, step, softest, style.BLUE, quantity=(r"softest $\lambda$", "1/time$^2$"))
    if (softest < 0).any():
        above.axhline(0, color="0.6", lw=0.6)
    finite = np.isfinite(growth)
    below.plot(step[finite], growth[finite], "-", color="0.7", lw=0.8, zorder=1)
    for word, color in COLOURS.items():
        chosen = finite & np.array([verdict == word for verdict in verdicts], bool)
        if chosen.any():
            below.plot(step[chosen], growth[chosen], "o", color=color, ms=2.5, label=word)
    rest = finite & np.array([verdict not in COLOURS for verdict in verdicts], bool)
    if rest.any():
        below.plot(step[rest], growth[rest], "o", mfc="white", mec=style.SKY, ms=2.5, mew=0.7, label="no verdict")
    if finite.any():
        style.legend_above(below, ncol=3)
    style.label_axes(below, y=("growth rate", "1/time"))
    below.set_ylim(bottom=0)
    style.label_axes(below, x="time step")
    return figure


@style.styled
def watched_balance(step: Column, residual: Column, limit: float):
    """Largest unbalanced force over the mean contact force against the time step, and the limit for a verdict."""
    figure, axes = style.column_axes(1, 1.7)
    good = np.where(residual > 0, residual, np.nan)
    _line(axes, step, good, style.BLUE)
    axes.axhline(limit, color=style.RED, lw=0.7, ls="--", label="limit for a verdict")
    axes.set_yscale("log")
    style.label_axes(axes, x="time step", y="unbalanced force / mean")
    style.legend_above(axes)
    return figure


RELOAD = 10  # time after which the page reloads [s]
CHARTED = (
    "pressure", "shear_stress", "coordination", "softest", "residual", "sliding", "contacts", "pairs", "growth_rate"
)  # fmt: skip
ROWS = 60  # largest number of rows in the table of frames
HEADINGS = (
    "step", "contacts", "per grain", "sliding", "pressure", "shear/pressure", "unbalanced", "softest λ", "pairs",
    "growth rate", "verdict",
)  # fmt: skip


def write_page(path: Path, place: Path, table: Path, done: Progress, how: dict) -> None:
    """Write the page; it reloads itself only while the simulation may be running."""
    rows = [row for _, row in sorted(done.rows.items())]
    now = time.strftime("%Y-%m-%d %H:%M:%S")
    live = f"written at {now}; this page reloads every {RELOAD} s" if done.live else f"ended at {now}"
    usable = [row for row in rows if row.computed]
    sections = [("Newest frame", _newest(usable[-1], done) if usable else page.paragraph("No frame yet.", kind="soft"))]
    if usable:
        step = np.array([row.step for row in usable], float)
        known = {name: np.array([getattr(row, name) for row in usable], float) for name in CHARTED}  # None: NaN
        sliding = known["sliding"] / np.maximum(known["contacts"], 1)
        growth = np.where(np.isfinite(known["pairs"]), np.nan_to_num(known["growth_rate"]), np.nan)
        spectrum = watched_spectrum(step, known["softest"], growth, [verdict_word(row) for row in usable])
        sections.append(("Charts", page.pictures({
            "stress": render(watched_stress(step, known["pressure"], known["shear_stress"])),
            "contacts": render(watched_contacts(step, known["coordination"], sliding)),
            "softest mode, and fastest growing pair": render(spectrum),
            "unbalanced force": render(watched_balance(step, known["residual"], BALANCED_BELOW)),
        })))  # fmt: skip
        lines = [[str(row.step), *cells(row), verdict_word(row)] for row in reversed(rows[-ROWS:])]
        frames = page.table(list(HEADINGS), lines, classes=dict.fromkeys(HEADINGS[:-1], "number"))
        rest = f"And {len(rows) - ROWS} earlier ones" if len(rows) > ROWS else "All frames with all measures"
        sections.append(("Frames", frames + page.paragraph(f"{rest} in {table.name}.", kind="soft")))
    facts = [["law", how["law"]], *(["note", line] for line in done.notes)]
    sections.append(("Conditions", page.table(["", "value"], facts)))
    title, about = f"Watching {place.resolve().name}", f"stickslip {__version__}, {live}"
    text = page.page(title, about, sections, reload=RELOAD if done.live else None)
    with staged_file(path) as part:
        part.write_bytes(text.encode())


def _newest(row: Row, done: Progress) -> str:
    verdict = row.verdict or row.note
    html = page.paragraph(f"Step {row.step}: {verdict}.", kind="verdict" if row.stable is not None else "")
    if row.scope:
        html += page.paragraph(f"Scope: {row.scope}.", kind="soft")
    if row.note and row.verdict:
        html += page.paragraph(row.note[:1].upper() + row.note[1:] + ".", kind="soft")
    if done.left:
        html += page.paragraph(
            f"Not computed yet: {pluralize(done.left, 'frame')}. The newest frame is computed first, the others while "
            "the simulation is not writing.",
            kind="warning",
        )
    return html


def cells(row: Row) -> list[str]:
    """Return the numbers of a row as text; a missing number is a dash."""

    def text(value, form: str) -> str:
        return "–" if value is None else format(value, form)

    share = None if row.sliding is None or not row.contacts else row.sliding / row.contacts
    ratio = None if row.shear_stress is None or not row.pressure else row.shear_stress / row.pressure
    return [
        text(row.contacts, "d"), text(row.coordination, ".3f"), text(share, ".1%"), text(row.pressure, ".4g"),
        text(ratio, ".3f"), text(row.residual, ".1e"), text(row.softest, ".3g"), text(row.pairs, "d"),
        text(row.growth_rate, ".3g"),
    ]  # fmt: skip


MARK = "written by stickslip watch "
NUMBERS = {name: kind for name, kind in Row.__annotations__.items() if kind is not str}


def describe(source: lammps_series.Source, method: str) -> dict:
    """Return the settings that, together with the frame, determine the numbers of a row."""
    law = source.law
    return {
        "law": describe_law(law), "parameters": law.table.tolist(), "kind": str(law.kind),
        "memory": source.contacts is not None, "columns": source.columns, "boundary": source.boundary,
        "i0": source.i0, "method": method,
    }  # fmt: skip


def write_rows(path: Path, rows: dict[int, Row], how: dict) -> None:
    """Write all rows atomically, ordered by step."""
    ordered = [row for _, row in sorted(rows.items())]
    comment = f"{MARK}{__version__}: {json.dumps(how)}"
    write_atomically(path, format_table(Row._fields, ordered, digits=None, comments=[comment]).encode())


def read_rows(path: Path, how: dict, *, overwrite: bool = False) -> dict[int, Row]:
    """Return the rows of an earlier watch by step, except those that could not be computed; empty without a table.

    Raises
    ------
    ValueError
        If the file is not a watch table, or was computed with other settings.
    """
    if not path.exists() or overwrite:
        return {}
    remedy = "give another --out, or --overwrite to compute it again"
    text = read_text(path, remedy=remedy)
    head = text.partition("\n")[0]
    try:
        if not head.startswith(f"# {MARK}"):
            raise ValueError("its first line is not a comment of stickslip watch")
        before = json.loads(head.partition(": ")[2])
        if not isinstance(before, dict):
            raise ValueError("its comment is not a JSON object")
        (_, names), *lines = read_table(path)
        rows = [_parse(dict(zip(names, fields, strict=True))) for _, fields in lines]
    except (ValueError, KeyError, TypeError):
        raise ValueError(f"{path} is not a table that stickslip watch wrote: {remedy}") from None
    other = [name for name, value in json.loads(json.dumps(how)).items() if before.get(name) != value]
    if other:
        told = "law" if "parameters" in other or "kind" in other else other[0]
        raise ValueError(f"{path} was computed with another {told} ({before.get(told)}): {remedy}")
    return {row.step: row for row in rows if row.computed}


def _parse(line: dict[str, str]) -> Row:
    values = {name: line[name] for name in Row._fields} | {"step": str(int(line["step"]))}
    return Row(**{name: _number(text) if name in NUMBERS else text for name, text in values.items()})


def _number(text: str) -> int | float | bool | None:
    if text in ("", "True", "False"):
        return {"": None, "True": True, "False": False}[text]
    return int(text) if text.lstrip("-").isdigit() else parse_number(text)


NARROW = 78  # terminal width below which lines replace the table
AROUND = 9  # terminal lines not used by table rows
COLORS = {"stable": "green", "unstable": "bold red", "damaged": "red"}
COLUMNS = {"step": 9, "pressure": 9, "shear/p": 7, "Z": 5, "sliding": 7, "softest λ": 9, "growth": 8, "verdict": 10}


def _words(row: Row) -> list[str]:
    """Cells of a row in the order of COLUMNS."""
    _, z, sliding, pressure, ratio, _, softest, _, growth = cells(row)
    return [str(row.step), pressure, ratio, z, sliding, softest, growth, verdict_word(row)]


@contextmanager
def screen() -> "Iterator[_Live | _Lines]":
    """Context manager that yields a display: `show(done)` updates it, `report` shows progress within a frame."""
    if terminal.can_redraw() and console.width >= NARROW:
        with Live(console=console, refresh_per_second=4) as live:
            yield _Live(live)
    else:
        yield _Lines()


class _Live:
    """A table below the notes, redrawn after each change."""

    def __init__(self, live: Live):
        self.live, self.said, self.done, self.stage = live, 0, Progress({}, (), 0), ""

    def show(self, done: Progress) -> None:
        for note in done.notes[self.said :]:
            console.print(note, style="yellow")
        self.said, self.done, self.stage = max(self.said, len(done.notes)), done, ""
        self._draw()

    def report(self, stage: str, share: float, text: str) -> None:
        self.stage = f"{stage} {share:.0%}"
        self._draw()

    def _draw(self) -> None:
        done = self.done
        computed = sum(row.computed for row in done.rows.values())
        parts = [f"{computed} frame{'s' * (computed != 1)}"]
        if done.at is not None:
            parts.append(f"computing step {done.at}")
        elif done.live and not done.left:
            parts.append("waiting for the next one")
        if (older := done.left - (done.at is not None)) > 0:
            parts.append(f"{older} more to compute")
        text = ": ".join(filter(None, [", ".join(parts), self.stage]))
        self.live.update(Group(_table(done), Text(text, style="dim", no_wrap=True, overflow="ellipsis")))


def _table(done: Progress) -> Table:
    table = Table(**terminal.STYLE, padding=(0, 0, 0, 1))
    for name in COLUMNS:
        table.add_column(name, justify="left" if name == "verdict" else "right", no_wrap=True)
    rows = [row for _, row in sorted(done.rows.items())]
    for row in rows[-max(console.height - AROUND, 5) :]:
        *numbers, word = _words(row)
        table.add_row(*numbers, Text(word, style=COLORS.get(word, "dim")))
    return table


class _Lines:
    """One line per computed frame."""

    def __init__(self):
        self.said, self.begun = 0, False

    def show(self, done: Progress) -> None:
        for note in done.notes[self.said :]:
            console.print(note, soft_wrap=True)
        self.said = max(self.said, len(done.notes))
        if not self.begun:
            self.begun = True
            console.print(_align(list(COLUMNS)), soft_wrap=True)
        if done.fresh:
            console.print(_align(_words(done.fresh)), soft_wrap=True)

    def report(self, stage: str, share: float, text: str) -> None:
        """Print nothing: each frame gets a single line, once it is computed."""


def _align(columns: list[str]) -> str:
    *numbers, last = (word.rjust(width) for word, width in zip(columns, COLUMNS.values(), strict=True))
    return "  ".join([*numbers, last.strip()])


SAVE_EVERY = 3.0  # minimum time between two writes of table and page [s]
REST = 5.0  # smallest ratio of the interval between two writes to the duration of a write


def watch_and_record(
    source: lammps_series.Source, table: Path, *, method: str, once: bool, until_idle: float | None, overwrite: bool,
    made_from=(),
) -> tuple[Progress, str]:  # fmt: skip
    """Watch until the end; return the results and, after ctrl-C or SIGTERM, a sentence that names the table.

    Raises
    ------
    ValueError
        If the table or the page would replace a foreign file; this is checked before any computation.
    """
    page, how = table.with_suffix(".html"), describe(source, method)
    if table.suffix.lower() != ".csv":
        raise ValueError(f"--out must end in .csv, got {table}")
    check_output(page, (".html",), overwrite=overwrite, made_from=made_from)
    check_free([table], overwrite=True, made_from=made_from)
    known, due = read_rows(table, how, overwrite=overwrite), float("-inf")
    done = Progress(known, (), 0)

    def save(done: Progress) -> None:
        write_rows(table, done.rows, how)
        write_page(page, source.folder, table, done, how)

    try:
        with screen() as shown:
            for done in watch(source, known, method=method, once=once, until_idle=until_idle, report=shown.report):
                shown.show(done)
                if not done.live or (done.any_computed and time.monotonic() >= due):
                    start = time.monotonic()
                    save(done)
                    now = time.monotonic()
                    due = now + max(SAVE_EVERY, REST * (now - start))
    except KeyboardInterrupt as problem:
        said = f"stopped by {str(problem) or 'the user'}"
        if not done.any_computed:
            return done, f"{said} before a frame was computed: there is no table"
        save(done._replace(live=False))
        left = f"; {done.left} frames have not been computed yet" if done.left else ""
        return done, f"{said}: {table} has {len(done.rows)} frames{left}, and the same command continues"
    return done, ""
