"""Terminal output of all commands: console, tables, and progress with physical quantities."""

import os
import sys
import time
from bisect import bisect
from collections.abc import Iterable
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text

from ..core.progress import displayed_by, hidden
from ..core.text import printable
from ..core.units import heading

UNBROKEN = 1000  # width of lines in a pipe or file, which other programs read


class _Console(Console):
    """Console that shows control characters in texts instead of sending them."""

    def render(self, renderable, options=None):
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else printable(text), style, control)


_FITTED = (sys.stdout is not None and sys.stdout.isatty()) or "COLUMNS" in os.environ  # output to a terminal
# paths and names are printed verbatim
console = _Console(soft_wrap=False, markup=False, highlight=False, width=None if _FITTED else UNBROKEN)

NARROW = 60  # width below which the cells of tables would be broken
READABLE = 100  # largest width of a text
WIDE = 110  # smallest width at which a stage and its text share a line
STEADY = 5.0  # time after which the remaining time of a stage may be estimated [s]
LINES = 30.0  # time between lines of progress if there is no terminal [s]
STYLE = {"title_justify": "left", "header_style": "bold", "box": SIMPLE_HEAD, "pad_edge": False}


@contextmanager
def console_output(quiet: bool = False, as_json: bool = False):
    """Route console output to standard output, to standard error if standard output is JSON, or nowhere if `quiet`.

    With `as_json`, output is printed only if standard error is a terminal.
    """
    before = console.quiet, console.stderr
    console.stderr = as_json
    console.quiet = quiet or (as_json and not can_redraw())
    try:
        with displayed_by(hidden) if quiet or as_json else nullcontext():
            yield
    finally:
        console.quiet, console.stderr = before


def can_redraw() -> bool:
    """Return True if the console supports redrawing lines. FORCE_COLOR does not turn a pipe into a terminal."""
    return console.is_terminal and console.file.isatty() and not console.is_dumb_terminal


class _Bars(Progress):
    """A line for each stage, with its text below on narrow terminals."""

    def get_renderables(self):
        if console.width >= WIDE:
            yield self.make_tasks_table(self.tasks)
            return
        for task in self.tasks:
            yield self.make_tasks_table([task])
            yield Text(f"  {task.fields['text']}", style="dim", no_wrap=True, overflow="ellipsis")


def _columns():
    """Yield the columns: stage, bar, elapsed time, remaining time, and the text on wide terminals."""
    stage = Column(no_wrap=True, overflow="ellipsis", **({"width": 34} if console.width >= WIDE else {"ratio": 1}))
    left = Column(no_wrap=True, justify="right", width=13)
    yield TextColumn("{task.description}", table_column=stage, markup=False)
    yield BarColumn(bar_width=20 if console.width >= 80 else 10)
    yield TimeElapsedColumn()
    yield TextColumn("{task.fields[left]}", table_column=left)
    if console.width >= WIDE:
        column = Column(no_wrap=True, overflow="ellipsis", ratio=1)
        yield TextColumn("{task.fields[text]}", table_column=column, markup=False)


@contextmanager
def progress(*, transient: bool = False):
    """Show the time and the main quantities of each stage: live, or as plain lines if there is no terminal.

    Parameters
    ----------
    transient : whether the lines are removed at the end (if so, stages are not printed without a terminal)
    """
    stages: dict[str, int] = {}
    past: dict[str, list[tuple[float, float]]] = {}
    plain_line = None if can_redraw() else _plain_progress(transient)
    console.is_interactive = can_redraw()
    with _Bars(*_columns(), console=console, disable=not can_redraw(), transient=transient, expand=True) as bar:

        def update(stage: str, share: float, text: str) -> None:
            if stage not in stages:
                for task in stages.values():
                    bar.update(task, total=1.0, completed=1.0, left="")
                stages[stage] = bar.add_task(stage, total=1.0, text=text, left="")
            task, spent = stages[stage], bar.tasks[stages[stage]].elapsed or 0.0
            history = past.setdefault(stage, [])
            if len(history) > 1000:
                history[:] = history[::2]
            history.append((spent, share))
            left = estimate_left(history)
            shown = f"{share:.0%}" if 0 < share < 1 else ""
            bar.update(
                task, completed=share, text=text, left=shown if left is None else f"{format_duration(left)} left"
            )
            if plain_line:
                plain_line(stage, share, text, left)

        with displayed_by(partial(_unmeasured, bar)) if can_redraw() else nullcontext():
            yield update
        for task in stages.values():
            bar.update(task, total=1.0, completed=1.0, left="")


@contextmanager
def _unmeasured(bar: Progress, text: str):
    """Line for work of unknown progress, shown below the stages while it lasts."""
    task = bar.add_task(text, total=None, text="", left="")
    try:
        yield
    finally:
        bar.remove_task(task)


def estimate_left(history: list[tuple[float, float]]) -> float | None:
    """Estimate the remaining time of a stage [s] from its elapsed times and shares; None if its rate is not steady.

    The mean rate and the rate in the second half of the time must agree within a factor of 1.3. Otherwise the remaining
    time is unknown: steps of a load path, for example, take longer towards its end.
    """
    (spent, share), half = history[-1], history[bisect(history, (0.5 * history[-1][0],)) - 1]
    if not 0.05 < share < 1 or spent < STEADY or share <= half[1]:
        return None
    mean, recent = spent * (1 - share) / share, (spent - half[0]) * (1 - share) / (share - half[1])
    return recent if max(mean, recent) <= 1.3 * min(mean, recent) else None


def _plain_progress(transient: bool):
    """Return a function that prints each stage when it starts, and its progress from time to time."""
    announced, last = set(), time.monotonic()

    def line(stage: str, share: float, text: str, left: float | None) -> None:
        nonlocal last
        if stage not in announced:
            announced.add(stage)
            if not transient:
                last = time.monotonic()
                console.print(f"{stage} …")
        elif time.monotonic() - last >= LINES:
            last = time.monotonic()
            rest = f"; {format_duration(left)} left" if left else ""
            console.print(f"  {share:.0%}: {text}{rest}", soft_wrap=True)

    return line


def format_duration(seconds: float) -> str:
    """Format a duration in a short form."""
    for size, name in ((86400, "days"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.0f} s"


def new_table(*columns: str, title: str | None = None, units: dict[str, str] | None = None, left=()) -> Table:
    """Table without rows, with units in its headings and columns aligned to the right, except those in `left`."""
    table = Table(title=title, **STYLE)
    for name in columns:
        justify = "left" if name in left else "right"
        table.add_column(heading(name, (units or {}).get(name, "1")), justify=justify, overflow="fold")
    return table


def show_table(table: Table) -> None:
    """Print a table.

    On a terminal too narrow for the table, print each row as lines, each with a heading and a value.
    """
    room = console.width
    if room >= NARROW or Measurement.get(console, console.options.update(max_width=1000), table).maximum <= room:
        return console.print(table)
    if table.title:
        console.print(table.title, style="italic")
    names = [str(column.header) for column in table.columns]
    for row in zip(*(column.cells for column in table.columns), strict=True):
        for name, cell in zip(names, row, strict=True):
            console.print(Text.assemble(f"  {name}: " if name else "  ", cell))
        console.print()
    return None


def show_markdown(text: str) -> None:
    """Print a text in Markdown."""
    from rich.markdown import Markdown

    with console.pager() if can_redraw() else nullcontext():
        console.print(Markdown(text), width=min(console.width, READABLE))


def show_pairs(title: str, pairs: dict) -> None:
    """Print names with their values or descriptions."""
    table = Table(title=title, show_header=False, **STYLE)
    table.add_column(no_wrap=True)
    table.add_column()
    for name, value in pairs.items():
        table.add_row(name, str(value))
    show_table(table)


def show_lines(lines: Iterable[str]) -> None:
    """Print sentences, each starting on a new line."""
    for line in lines:
        console.print(f"  {line}", soft_wrap=True)


def show_paths(paths: list[Path]) -> None:
    """Print the paths of the files written, one per line."""
    console.print("Written:")
    show_lines(map(str, paths))
