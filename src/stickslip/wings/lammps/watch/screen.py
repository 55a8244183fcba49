"""The terminal while a simulation is watched: a live table, or one line for each frame without a terminal."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ....kit import console
from ....reports.terminal import STYLE, can_redraw
from .loop import Progress
from .measures import Row, verdict_word
from .page import cells

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
    if can_redraw() and console.width >= NARROW:
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
    table = Table(**STYLE, padding=(0, 0, 0, 1))
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
