"""Watching a simulation with its table, its page and the terminal.

The table is a CSV file with a comment that says how it was computed. The terminal shows a live table, or one line for
each frame if it cannot draw again.
"""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ... import __version__
from ...kit import (
    check_free,
    check_output,
    console,
    describe_law,
    format_table,
    lammps_series,
    parse_number,
    read_table,
    read_text,
    terminal,
    write_atomically,
)
from .watch import Progress, Row, verdict_word, watch
from .watch_page import cells, write_page

MARK = "written by stickslip watch "
NUMBERS = {name: kind for name, kind in Row.__annotations__.items() if kind is not str}


def describe(source: lammps_series.Source, method: str) -> dict:
    """What determines the numbers of a row besides its frame."""
    law = source.law
    return {
        "law": describe_law(law), "parameters": law.table.tolist(), "kind": str(law.kind),
        "memory": source.contacts is not None, "columns": source.columns, "boundary": source.boundary,
        "i0": source.i0, "method": method,
    }  # fmt: skip


def write_rows(path: Path, rows: dict[int, Row], how: dict) -> None:
    """Write all rows, by step, all or nothing."""
    ordered = [row for _, row in sorted(rows.items())]
    comment = f"{MARK}{__version__}: {json.dumps(how)}"
    write_atomically(path, format_table(Row._fields, ordered, digits=None, comments=[comment]).encode())


def read_rows(path: Path, how: dict, *, overwrite: bool = False) -> dict[int, Row]:
    """Rows of an earlier watch, without those that could not be computed; none if there is no table.

    Raises
    ------
    ValueError
        if the file is not such a table, or was computed in another way; the message is one sentence.
    """
    if not path.exists() or overwrite:
        return {}
    remedy = "give another --out, or --overwrite to compute it anew"
    text = read_text(path, remedy=remedy)
    head = text.partition("\n")[0]
    try:
        if not head.startswith(f"# {MARK}"):
            raise ValueError("it has no such comment")
        before = json.loads(head.partition(": ")[2])
        if not isinstance(before, dict):
            raise ValueError("its comment is no JSON object")
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


NARROW = 78  # columns below which there are lines instead of a table
AROUND = 9  # lines of the terminal that the rows of the table leave free
COLORS = {"stable": "green", "unstable": "bold red", "damaged": "red"}
COLUMNS = {"step": 9, "pressure": 9, "shear/p": 7, "Z": 5, "sliding": 7, "softest λ": 9, "growth": 8, "verdict": 10}


def _line(row: Row) -> list[str]:
    """Cells of a row in the order of COLUMNS."""
    _, z, sliding, pressure, ratio, _, softest, _, growth = cells(row)
    return [str(row.step), pressure, ratio, z, sliding, softest, growth, verdict_word(row)]


@contextmanager
def screen() -> "Iterator[_Live | _Lines]":
    """Context manager for what shows the progress, `show(done)`, and that of one frame, `report`."""
    if terminal.can_redraw() and console.width >= NARROW:
        with Live(console=console, refresh_per_second=4) as live:
            yield _Live(live)
    else:
        yield _Lines()


class _Live:
    """A table that is drawn again and again, below the notes."""

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
        text = ": ".join(filter(None, [_state(self.done), self.stage]))
        self.live.update(Group(_table(self.done), Text(text, style="dim", no_wrap=True, overflow="ellipsis")))


def _table(done: Progress) -> Table:
    table = Table(**terminal.STYLE, padding=(0, 0, 0, 1))
    for name in COLUMNS:
        table.add_column(name, justify="left" if name == "verdict" else "right", no_wrap=True)
    rows = [row for _, row in sorted(done.rows.items())]
    for row in rows[-max(console.height - AROUND, 5) :]:
        *numbers, word = _line(row)
        table.add_row(*numbers, Text(word, style=COLORS.get(word, "dim")))
    return table


def _state(done: Progress) -> str:
    """What is being done, in a few words."""
    computed = sum(row.computed for row in done.rows.values())
    parts = [f"{computed} frame{'s' * (computed != 1)}"]
    if done.at is not None:
        parts.append(f"computing step {done.at}")
    elif done.live and not done.left:
        parts.append("waiting for the next one")
    older = done.left - (done.at is not None)
    if older > 0:
        parts.append(f"{older} more to compute")
    return ", ".join(parts)


class _Lines:
    """A line for each frame that was computed."""

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
            console.print(_align(_line(done.fresh)), soft_wrap=True)

    def report(self, stage: str, share: float, text: str) -> None:
        """Nothing: a frame has one line."""


def _align(columns: list[str]) -> str:
    *numbers, last = (word.rjust(width) for word, width in zip(columns, COLUMNS.values(), strict=True))
    return "  ".join([*numbers, last.strip()])


SAVE_EVERY = 3.0  # least time between two writes of table and page [s]
REST = 5.0  # the same, over the time that a write takes


def watch_and_record(
    source: lammps_series.Source, table: Path, *, method: str, once: bool, until_idle: float | None, overwrite: bool,
    made_from=(),
) -> tuple[Progress, str]:  # fmt: skip
    """Watch until the end; return what is known then, and, after ctrl-C, a sentence that names the table.

    Raises
    ------
    ValueError
        before anything is computed, if the table or the page would replace something else.
    """
    page, how = table.with_suffix(".html"), describe(source, method)
    if table.suffix.lower() != ".csv":
        raise ValueError(f"--out {table} ends with {table.suffix or 'nothing'!r}: use .csv")
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
    except KeyboardInterrupt:
        if not done.any_computed:
            return done, "stopped by the user before a frame was computed: there is no table"
        save(done._replace(live=False))
        left = f"; {done.left} frames are not computed yet" if done.left else ""
        return done, f"stopped by the user: {table} has {len(done.rows)} frames{left}, and the same command continues"
    return done, ""
