"""What every run leaves in its folder and on the terminal: scenario, raw numbers, claims table, progress."""

import re
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

from .. import __version__
from ..core.state import State
from ..data import archive
from ..data.atomic import named
from ..data.checkpoint import SCENARIO, SWEEP, WRITING, finished, kept_in, under_way
from ..data.manifest import adopt, check_hidden, digest, note, proven, strange
from .terminal import console

NUMBERS, MOVIE = "results.h5", "transition.gif"
CLAIMS, NOTES, CHART = "claims.json", "claims.md", "claims.png"
REPRODUCTION, OPTIONS = "reproduce.json", "sweep-options.json"  # what a call was given, for `stickslip resume`
PAGE, FILM = "report.html", "movie.gif"  # of stickslip report and movie
SERIES, CURVES = "series.csv", "curves.csv"
RUN_FILES = (SCENARIO, NUMBERS, CLAIMS, NOTES, CHART, MOVIE, SERIES, CURVES, PAGE, FILM)
_RUN_FILE = re.compile(r"fig\d_\w+\.png|steps_\d+_\d+\.csv|" + "|".join(map(re.escape, RUN_FILES)))
SHOWN = 8  # names of files in a sentence


def claim_folder(folder: Path, scenario, *, overwrite: bool = False) -> None:
    """Make sure that results can go to a folder before anything is computed.

    With `overwrite`, what is kept of an unfinished run goes away; results go when those of the new run are complete.

    Raises
    ------
    ValueError
        if it is a file, cannot be written, or holds results of another scenario, or files that no run wrote.
    """
    check_writable(folder)
    if not folder.is_dir():
        return
    if (folder / SWEEP).exists():
        raise ValueError(f"{folder} holds the results of a sweep: choose another --out")
    install_results(folder)
    others, known = strange(folder, is_run_file), under_way(folder) or folder / SCENARIO
    if overwrite:
        _discard_previous(folder, scenario, others)
    elif others:
        raise ValueError(foreign_files_message(folder, others))
    elif known.exists() and known.read_bytes() != scenario.text.encode():
        what = "an unfinished run" if under_way(folder) else "the results"
        raise ValueError(f"{folder} holds {what} of another scenario: choose another --out, or add --overwrite")


def check_writable(folder: Path) -> None:
    """Raise ValueError with one sentence if nothing can be written to a folder."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file, not a folder: choose another --out")
    if folder.is_dir():
        check_hidden(folder, is_run_file)
    try:
        _probe(folder)
    except OSError as problem:
        raise ValueError(f"the folder {folder} cannot be written ({problem.strerror}): choose another --out") from None


def foreign_files_message(folder: Path, names: list[str]) -> str:
    """The sentence about files that no run wrote."""
    return (
        f"{folder} holds what no run of stickslip wrote, or what was changed since ({join_names(names)}): choose another "
        f"--out, or add --overwrite"
    )


def _discard_previous(folder: Path, scenario, others: list[str]) -> None:
    """Say what will go, drop the pieces of another run, and note what may be replaced."""
    going = sorted({path.name for path in files_of(folder)} | {name for name in others if is_run_file(name)})
    if name := next((name for name in going if (folder / name).is_dir()), None):
        raise ValueError(
            f"{folder / name} is a folder where a run writes a file: move it away, or choose another --out"
        )
    if going:
        console.print(
            f"--overwrite: {join_names(going)} in {folder} will be replaced or removed when the new results are complete.",
            soft_wrap=True,
        )  # fmt: skip
    if others or going or under_way(folder):
        finished(folder)
        adopt(folder, [name for name in others if is_run_file(name)])
        kept_in(folder, scenario).announce()


def join_names(names: list[str]) -> str:
    """Names in a sentence, the first ones of many."""
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def is_run_file(name: str) -> bool:
    """Whether runs write files of this name."""
    return _RUN_FILE.fullmatch(name) is not None


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
def staged_results(folder: Path, *, failures=()):
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
        if others := strange(folder, lambda name: is_run_file(name) or name in files):
            raise RuntimeError(
                f"{folder} holds what another program wrote there meanwhile ({join_names(others)}): move it away, then "
                f"stickslip resume {folder} goes on with what is kept"
            )
        note(room, files)
    except BaseException:
        shutil.rmtree(room, ignore_errors=True)
        raise
    install_results(folder)
    if not failures:
        finished(folder)


def install_results(folder: Path) -> None:
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
    return sorted(path for path in folder.iterdir() if is_run_file(path.name))


def save(room: Path, scenario, numbers: dict) -> None:
    """Scenario and raw numbers."""
    archive.write(room / NUMBERS, numbers, scenario=scenario.text, version=__version__, si=scenario.si)
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
