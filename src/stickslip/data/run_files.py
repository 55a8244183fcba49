"""Files that runs of every experiment write: their names, and atomic replacement.

Experiments list further files in `writes`. A file is written under a temporary name in the same folder, flushed to
disk, and renamed.
"""

import errno
import os
import shlex
from collections.abc import Iterable
from contextlib import contextmanager, suppress
from pathlib import Path

SCENARIO, NUMBERS = "scenario.json", "results.h5"
CLAIMS, NOTES, CHART = "claims.json", "claims.md", "claims.png"
REPRODUCTION, OPTIONS = "reproduce.json", "sweep-options.json"  # arguments of the call, for `stickslip resume`
LOOK = "look.json"  # how its figures are written
PAGE, FILM = "report.html", "movie.gif"  # written by stickslip report and movie
NAMES = (SCENARIO, NUMBERS, CLAIMS, NOTES, CHART, PAGE, FILM)
FIGURES = r"(fig\d_\w+|claims)\.(png|pdf|svg)"
SHOWN = 8  # file names listed in a message


def foreign_files_message(folder: Path, names: list[str]) -> str:
    """Return the message about foreign files."""
    return (
        f"{folder} contains files that stickslip did not write or that have changed since ({join_names(names)}): "
        f"choose another --out, or add --overwrite"
    )


def join_names(names: list[str]) -> str:
    """Join names for a message; if there are many, only the first few are listed."""
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def resume_command(folder: Path) -> str:
    """Return the command that continues a run, as typed."""
    return shlex.join(["stickslip", "resume", str(folder)])


@contextmanager
def name_file_in_errors(path: str | Path):
    """Add a path to operating-system errors, such as a full disk, raised by libraries that do not name the file."""
    try:
        yield
    except OSError as problem:
        if problem.strerror and not problem.filename:
            problem.filename = str(path)
        raise


@contextmanager
def replace_atomically(path: str | Path):
    """Yield a temporary path in the same folder, with the same extension, that replaces `path` on success.

    Raises
    ------
    OSError
        If the file cannot be written; the message names it, and an existing file is left unchanged.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "its folder does not exist: create it first", str(path))
    part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as problem:
        problem.filename = str(path)
        raise
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def check_free(paths: Iterable[Path], *, overwrite: bool = False, made_from: Iterable[str | Path | None] = ()) -> None:
    """Check that output files may be written, before anything is computed.

    Parameters
    ----------
    overwrite : True if existing files may be replaced
    made_from : input files, which are never replaced

    Raises
    ------
    ValueError
        If a file may not be written; the message names the first one.
    """
    sources = [Path(path) for path in made_from if path is not None]
    for path in paths:
        if any(path.exists() and source.exists() and path.samefile(source) for source in sources):
            raise ValueError(f"{path} would replace its own input file: give another name")
        if path.is_dir():
            raise ValueError(f"{path} is a folder: give the name of a file")
        if os.path.lexists(path) and not overwrite:
            raise ValueError(f"{path} exists: give another name, or add --overwrite")


def write_atomically(path: str | Path, *content: bytes) -> None:
    """Write or replace a file, given in one or more parts, atomically; errors as in `replace_atomically`."""
    with replace_atomically(path) as part, part.open("wb") as file:
        file.writelines(content)
