"""What every run leaves in its folder and on the terminal: scenario, raw numbers, claims table, progress."""

import json
import re
import shutil
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column
from rich.text import Text

from .. import __version__
from ..core.state import State
from ..data import archive
from ..data.kept import SCENARIO, SWEEP, UNFINISHED, WRITING, finished, kept_in, under_way
from ..data.law_file import check_sealed
from ..data.manifest import adopt, check_hidden, digest, note, proven, strange
from ..data.parts import Whole
from ..data.scenario import read as read_scenario
from ..data.units import SI
from ..data.whole import named, replace

console = Console(soft_wrap=False, markup=False, highlight=False)  # paths and names are shown as they are
WIDE = 110  # columns from which on a stage and its words share a line
LINES = 30.0  # between two lines where there is no terminal [s]
NUMBERS, MOVIE = "results.h5", "transition.gif"
CLAIMS, NOTES, CHART = "claims.json", "claims.md", "claims.png"
REPRODUCTION, OPTIONS = "reproduce.json", "sweep-options.json"  # what a call was given, for `stickslip resume`
PAGE, FILM = "report.html", "movie.gif"  # of stickslip report and movie
SERIES, CURVES = "series.csv", "curves.csv"
OURS = (SCENARIO, NUMBERS, CLAIMS, NOTES, CHART, MOVIE, SERIES, CURVES, PAGE, FILM)
_OURS = re.compile(r"fig\d_\w+\.png|steps_\d+_\d+\.csv|" + "|".join(map(re.escape, OURS)))
SHOWN = 8  # names of files in a sentence
STYLE = {"title_justify": "left", "header_style": "bold", "box": SIMPLE_HEAD, "pad_edge": False}


class Begun(NamedTuple):
    """A run that was begun in a folder and is not finished."""

    scenario: Whole | None
    reproduction: dict | None = None  # arguments of `reproduce`, if the run is that of a paper
    sweep: dict | None = None  # tables, if it is one
    figures: bool = False  # whether its members draw theirs


def begin_reproduction(folder: Path, scenario, **arguments) -> None:
    """Note in the folder which paper's run begins there, for `begun`."""
    kept_in(folder, scenario).announce()
    replace(folder / UNFINISHED / REPRODUCTION, json.dumps(arguments).encode())


def begun(folder: Path) -> Begun | None:
    """What is unfinished in a folder; None if it is finished.

    Raises
    ------
    ValueError
        with one sentence, if there is no run.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder: give the one of a run that was stopped")
    check_hidden(folder, is_ours)
    if (folder / SWEEP).is_file():
        options = folder / OPTIONS
        figures = noted(options).get("figures", False) if options.is_file() else False
        tables = noted(folder / SWEEP)
        check_sealed(tables, folder / SWEEP)
        return Begun(None, sweep=tables, figures=figures)
    _settle(folder)
    known, arguments = under_way(folder), folder / UNFINISHED / REPRODUCTION
    if known is None and not (folder / SCENARIO).is_file():
        raise ValueError(f"{folder} holds nothing to go on from: begin with stickslip run SCENARIO --out {folder}")
    if known is None and (folder / NUMBERS).is_file():
        return None
    if known and (others := strange(folder, is_ours)):
        raise ValueError(
            f"{folder} holds what no run of stickslip wrote, or what was changed since ({_listed(others)}): move it "
            f"away, then resume goes on"
        )
    return Begun(read_scenario(known or folder / SCENARIO), noted(arguments) if arguments.is_file() else None)


def noted(path: Path) -> dict:
    """What a file of JSON holds; ValueError with one sentence, if it is damaged."""
    try:
        if isinstance(found := json.loads(path.read_text(encoding="utf-8")), dict):
            return found
    except (ValueError, RecursionError):
        pass
    raise ValueError(f"{path} is damaged: begin again, with --overwrite")


def claim_folder(folder: Path, scenario, *, overwrite: bool = False) -> None:
    """Make sure that results can go to a folder before anything is computed.

    With `overwrite`, what is kept of an unfinished run goes away; results go when those of the new run are complete.

    Raises
    ------
    ValueError
        if it is a file, cannot be written, or holds results of another scenario, or files that no run wrote.
    """
    checked(folder)
    if not folder.is_dir():
        return
    if (folder / SWEEP).exists():
        raise ValueError(f"{folder} holds the results of a sweep: choose another --out")
    _settle(folder)
    others, known = strange(folder, is_ours), under_way(folder) or folder / SCENARIO
    if overwrite:
        _given_up(folder, scenario, others)
    elif others:
        raise ValueError(foreign(folder, others))
    elif known.exists() and known.read_bytes() != scenario.text.encode():
        what = "an unfinished run" if under_way(folder) else "the results"
        raise ValueError(f"{folder} holds {what} of another scenario: choose another --out, or add --overwrite")


def checked(folder: Path) -> None:
    """Raise ValueError with one sentence if nothing can be written to a folder."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file, not a folder: choose another --out")
    if folder.is_dir():
        check_hidden(folder, is_ours)
    try:
        _probe(folder)
    except OSError as problem:
        raise ValueError(f"the folder {folder} cannot be written ({problem.strerror}): choose another --out") from None


def foreign(folder: Path, names: list[str]) -> str:
    """The sentence about files that no run wrote."""
    return (
        f"{folder} holds what no run of stickslip wrote, or what was changed since ({_listed(names)}): choose another "
        f"--out, or add --overwrite"
    )


def _given_up(folder: Path, scenario, others: list[str]) -> None:
    """Say what will go, drop the pieces of another run, and note what may be replaced."""
    going = sorted({path.name for path in files_of(folder)} | {name for name in others if is_ours(name)})
    if name := next((name for name in going if (folder / name).is_dir()), None):
        raise ValueError(
            f"{folder / name} is a folder where a run writes a file: move it away, or choose another --out"
        )
    if going:
        console.print(
            f"--overwrite: {_listed(going)} in {folder} will be replaced or removed when the new results are complete.",
            soft_wrap=True,
        )  # fmt: skip
    if others or going or under_way(folder):
        finished(folder)
        adopt(folder, [name for name in others if is_ours(name)])
        kept_in(folder, scenario).announce()


def _listed(names: list[str]) -> str:
    """Names in a sentence, the first ones of many."""
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def is_ours(name: str) -> bool:
    """Whether runs write files of this name."""
    return _OURS.fullmatch(name) is not None


def _probe(folder: Path) -> None:
    """Write and remove a file there, and every folder that this needed."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    finally:
        for path in missing:
            if path.exists():
                path.rmdir()


@contextmanager
def speaking(*, quiet: bool = False, as_json: bool = False):
    """Who hears the console meanwhile: people, nobody, or, where programs read standard output, people beside them."""
    before = console.quiet, console.stderr
    console.stderr = as_json
    console.quiet = quiet or (as_json and not live())
    try:
        yield
    finally:
        console.quiet, console.stderr = before


def live() -> bool:
    """Whether lines can be drawn again: FORCE_COLOR alone does not make a pipe a terminal."""
    return console.is_terminal and console.file.isatty() and not console.is_dumb_terminal


class _Bars(Progress):
    """A line for each stage; where the terminal is narrow its words stand below."""

    def get_renderables(self):
        if console.width >= WIDE:
            yield self.make_tasks_table(self.tasks)
            return
        for task in self.tasks:
            yield self.make_tasks_table([task])
            yield Text(f"  {task.fields['words']}", style="dim", no_wrap=True, overflow="ellipsis")


def _columns():
    """Stage, bar, time spent, time left, and words where there is room."""
    stage = Column(no_wrap=True, overflow="ellipsis", **({"width": 34} if console.width >= WIDE else {"ratio": 1}))
    left = Column(no_wrap=True, justify="right", width=13)
    yield TextColumn("{task.description}", table_column=stage, markup=False)
    yield BarColumn(bar_width=20 if console.width >= 80 else 10)
    yield TimeElapsedColumn()
    yield TextColumn("{task.fields[left]}", table_column=left)
    if console.width >= WIDE:
        words = Column(no_wrap=True, overflow="ellipsis", ratio=1)
        yield TextColumn("{task.fields[words]}", table_column=words, markup=False)


@contextmanager
def progress(*, transient: bool = False):
    """A live line for each stage: time spent and left, the quantities that matter; without a terminal, plain lines.

    Parameters
    ----------
    transient : whether the lines go away at the end (and stages are not named where there is no terminal)
    """
    stages: dict[str, int] = {}
    plain_line = None if live() else _lines(transient)
    console.is_interactive = live()
    with _Bars(*_columns(), console=console, disable=not live(), transient=transient, expand=True) as bar:

        def tell(stage: str, share: float, words: str, left: float | None = None) -> None:
            if stage not in stages:
                for task in stages.values():
                    bar.update(task, completed=1.0, left="")
                stages[stage] = bar.add_task(stage, total=1.0, words=words, left="")
            task, spent = stages[stage], bar.tasks[stages[stage]].elapsed or 0.0
            if left is None and 0 < share < 1 and spent > 2:
                left = spent * (1 - share) / share
            bar.update(task, completed=share, words=words, left="" if left is None else f"{duration(left)} left")
            if plain_line:
                plain_line(stage, share, words, left)

        yield tell
        for task in stages.values():
            bar.update(task, completed=1.0, left="")


def _lines(transient: bool):
    """The same without a terminal: every stage when it begins, and how far it is now and then."""
    known, last = set(), time.monotonic()

    def line(stage: str, share: float, words: str, left: float | None) -> None:
        nonlocal last
        if stage not in known:
            known.add(stage)
            if not transient:
                last = time.monotonic()
                console.print(f"{stage} …")
        elif time.monotonic() - last >= LINES:
            last = time.monotonic()
            rest = f"; {duration(left)} left" if left else ""
            console.print(f"  {share:.0%}: {words}{rest}", soft_wrap=True)

    return line


def duration(seconds: float) -> str:
    """About how long, in words that are short."""
    for size, name in ((86400, "days"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.0f} s"


@contextmanager
def complete(folder: Path, *, failures=()):
    """A room whose files go to the folder at the end, in the place of an earlier run's, when all are complete.

    The run is finished then, unless members failed: `stickslip resume` tries these again.

    Raises
    ------
    RuntimeError
        with one sentence, where a file of somebody else is in the way; nothing is replaced or removed then.
    """
    folder.mkdir(parents=True, exist_ok=True)
    room = folder / WRITING
    shutil.rmtree(room, ignore_errors=True)
    room.mkdir()
    try:
        with named(folder):
            yield room
        files = {path.name: [digest(path)] for path in room.iterdir()}
        if others := strange(folder, lambda name: is_ours(name) or name in files):
            raise RuntimeError(
                f"{folder} holds what another program wrote there meanwhile ({_listed(others)}): move it away, then "
                f"stickslip resume {folder} goes on with what is kept"
            )
        note(room, files)
    except BaseException:
        shutil.rmtree(room, ignore_errors=True)
        raise
    _settle(folder)
    if not failures:
        finished(folder)


def _settle(folder: Path) -> None:
    """Move complete results into their folder; who was killed while doing so is followed by the next one."""
    room = folder / WRITING
    new = proven(room)
    if not new:
        return
    old = proven(folder)
    note(folder, {name: old.get(name, []) + new.get(name, []) for name in old | new})
    for path in files_of(folder):
        if path.name not in new:
            path.unlink()
    for name in new:
        if (room / name).exists():
            (room / name).replace(folder / name)
    note(folder, new)
    shutil.rmtree(room, ignore_errors=True)


def files_of(folder: Path) -> list[Path]:
    """Files of ours that a folder holds, sorted."""
    return sorted(path for path in folder.iterdir() if is_ours(path.name))


def save(room: Path, scenario, numbers: dict) -> None:
    """Scenario and raw numbers."""
    si = scenario.experiment in SI
    archive.write(room / NUMBERS, numbers, scenario=scenario.text, version=__version__, si=si)
    (room / SCENARIO).write_text(scenario.text, encoding="utf-8")


def plain(record) -> dict:
    """Fields of a NamedTuple that a file can hold: None is left out, tuples of words become lines."""
    out = {}
    for name, value in record._asdict().items():
        if value is None:
            continue
        if hasattr(value, "_asdict") and not isinstance(value, State):
            value = value._asdict()
        words = isinstance(value, tuple) and all(isinstance(v, str) for v in value)
        out[name] = "\n".join(value) if words else value
    return out


def show_paths(paths: list[Path]) -> None:
    """Where everything is, one path a line."""
    console.print("Written:")
    for path in paths:
        console.print(f"  {path}", soft_wrap=True)
