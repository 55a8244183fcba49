"""Run folders: names of files and their atomic replacement, the manifest with their digests, and the lock.

Experiments list further files in `writes`. A file is written under a temporary name in the same folder, flushed to
disk, and renamed. A file that does not match the manifest was written by another program: runs replace or remove it
only with --overwrite. While a file is being replaced, the manifest lists the digests of the old and the new file, so
that a run that is killed at that moment leaves no unknown file. Only one process at a time works in a folder; the
operating system releases the lock when the process ends.
"""

import errno
import hashlib
import json
import os
import re
import shlex
import socket
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SCENARIO, NUMBERS = "scenario.json", "results.h5"
CLAIMS, NOTES, CHART = "claims.json", "claims.md", "claims.png"
REPRODUCTION, OPTIONS = "reproduce.json", "sweep-options.json"  # arguments of the call, for `stickslip resume`
LOOK = "look.json"  # style and formats of the run's figures
PAGE, FILM = "report.html", "movie.gif"  # written by stickslip report and movie
NAMES = (SCENARIO, NUMBERS, CLAIMS, NOTES, CHART, PAGE, FILM)
FIGURES = r"(fig\d_\w+|claims)\.(png|pdf|svg)"
# a folder and a file beside the results, and the folders of sweep members and of LAMMPS legs
UNFINISHED, SWEEP, MEMBERS, LEGS = "unfinished", "sweep.json", "members", "lammps"
# temporary folders: results being written, a sweep that replaces another, pieces being removed
WRITING, ANEW, GONE = ".writing", ".anew", f".{UNFINISHED}"
BEGUN = "scenario-"  # prefix, followed by a digest, of the file with the scenario of an unfinished run
SHOWN = 8  # largest number of file names listed in a message


def foreign_files_message(folder: Path, names: list[str]) -> str:
    """Return the message about files in a run folder that no run wrote."""
    return (
        f"{folder} contains files that stickslip did not write or that have changed since ({join_names(names)}): "
        f"choose another --out, or add --overwrite"
    )


def join_names(names: list[str]) -> str:
    """Join names for a message; if there are many, only the first few are listed."""
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def resume_command(folder: Path) -> str:
    """Return the command that a user types to continue a run."""
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


MANIFEST = "manifest.json"
_ABOUT = "SHA-256 of the files that stickslip wrote here; it does not replace any others"
_FOLDER, _OTHER = "folder", "neither"  # in place of a digest, for folders and everything else that is not a file
_OVERWRITABLE = "overwritten.json"  # stored with the checkpoint: files that --overwrite may replace when the run ends

_PART = re.compile(r"\..+\.\d+(\.\w+)?")  # temporary file of an unfinished write
_PIECE = re.compile(r".+\.(records|h5)|(scenario|part)(-\w+)?\.json|(reproduce|look)\.json|" + re.escape(_OVERWRITABLE))
_SWEEP_FILES = (MANIFEST, SWEEP, "sweep-options.json", "sweep.nc", MEMBERS, "ready")

Files = dict[str, list[str]]  # digests by file name: one, or two while the file is being replaced


def read_manifest(folder: Path) -> Files:
    """Digests of the files that runs have written; empty if there is no readable manifest."""
    return _read(folder / MANIFEST)


def write_manifest(folder: Path, files: Files) -> None:
    """Write the manifest of a run folder."""
    content = {"about": _ABOUT, "files": dict(sorted(files.items()))}
    write_atomically(folder / MANIFEST, json.dumps(content, indent=1).encode())


def add_to_manifest(folder: Path, *names: str) -> None:
    """Add the present files and folders with these names to the manifest."""
    write_manifest(folder, read_manifest(folder) | {name: [digest(folder / name)] for name in names})


def write_file(folder: Path, name: str, content: bytes) -> None:
    """Write or replace a run file atomically."""
    manifest, new = read_manifest(folder), hashlib.sha256(content).hexdigest()
    write_manifest(folder, manifest | {name: [*manifest.get(name, []), new]})
    write_atomically(folder / name, content)
    write_manifest(folder, manifest | {name: [new]})


def digest(path: Path) -> str:
    """SHA-256 digest of a file; a fixed word for a folder or anything else."""
    if path.is_dir():
        return _FOLDER
    if not path.is_file():
        return _OTHER  # a pipe or a device, which could be read forever, or a broken link
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unfinished_scenario(folder: Path) -> Path | None:
    """Path of the scenario of the unfinished run in a folder, or None."""
    notes = sorted((folder / UNFINISHED).glob(f"{BEGUN}*.json"))
    if len(notes) > 1 and (folder / SCENARIO).is_file():  # versions before 0.2 named the notes of parts in this way
        first = (folder / SCENARIO).read_bytes()
        notes = [path for path in notes if path.read_bytes() == first] or notes
    return notes[0] if notes else None


def find_foreign(folder: Path, ours: Callable[[str], bool]) -> list[str]:
    """Names of files that no run has written, or that have been changed since.

    If there is no trace of a run, all files are named.

    Parameters
    ----------
    ours : function that returns True if a run may write, replace or remove a file of this name. If a run has left files
    in the folder, files with other names are ignored; hidden files are always ignored
    """
    if not folder.is_dir():
        return []
    own, adopted, begun = read_manifest(folder), _read(folder / UNFINISHED / _OVERWRITABLE), unfinished_scenario(folder)
    own = {name: [sha for sha in digests if sha != _OTHER] for name, digests in own.items()}  # a run writes no others
    known = {name: own.get(name, []) + adopted.get(name, []) for name in own | adopted}
    if begun is not None:  # the run wrote its scenario before the manifest
        known[SCENARIO] = [*known.get(SCENARIO, []), digest(begun)]
    trace = bool(own) or begun is not None
    seen = (path for path in folder.iterdir() if not path.name.startswith(".") and not _is_empty_run_folder(path))
    mine = {MANIFEST, UNFINISHED} if trace else set()
    rest = (path for path in seen if path.name not in mine and (ours(path.name) or not trace))
    return sorted(path.name for path in rest if path.name not in known or digest(path) not in known[path.name])


def _is_empty_run_folder(path: Path) -> bool:
    """Return True for an empty folder that a stopped run created early."""
    if path.name not in (UNFINISHED, MEMBERS) or path.is_symlink() or not path.is_dir():
        return False
    return all(inner.is_dir() and not inner.is_symlink() for inner in path.rglob("*"))


def check_hidden(folder: Path, ours: Callable[[str], bool]) -> None:
    """Check that run folders are not links, and that temporary ones contain no foreign files.

    Parameters
    ----------
    ours : function that returns True if a run may write a result of this name

    Raises
    ------
    ValueError
        If there is a foreign file or link, which the message names.
    """
    for path in (folder / MEMBERS, folder / LEGS):
        if link := next((inner for inner in (path, *path.rglob("*")) if inner.is_symlink()), None):
            raise ValueError(
                f"{link} is a link that leads outside the run folder: move it away, or choose another --out"
            )
    for member in (folder / MEMBERS).iterdir() if (folder / MEMBERS).is_dir() else ():
        check_hidden(member, ours)
    for name in (WRITING, ANEW, GONE, UNFINISHED):
        path, piece = folder / name, name in (GONE, UNFINISHED)
        if not os.path.lexists(path):
            continue
        inside = path.rglob("*") if piece else path.iterdir()
        if path.is_symlink() or not path.is_dir():
            there = name
        elif other := next((p for p in inside if not _is_own_hidden(p, piece, ours)), None):
            there = str(other.relative_to(folder))
        else:
            continue
        raise ValueError(
            f"{folder} contains {there}, a name that runs use for unfinished results: move it away, or choose another "
            "--out"
        )


def _is_own_hidden(path: Path, piece: bool, ours: Callable[[str], bool]) -> bool:
    if path.is_symlink():
        return False
    if _PART.fullmatch(path.name):
        return True
    if piece:
        return path.is_dir() or (path.is_file() and _PIECE.fullmatch(path.name) is not None)
    return path.is_dir() if path.name == MEMBERS else path.is_file() and (ours(path.name) or path.name in _SWEEP_FILES)


def allow_overwriting(folder: Path, names: Iterable[str]) -> None:
    """Allow the run starting in this folder to replace these files when it finishes."""
    (folder / UNFINISHED).mkdir(exist_ok=True)
    content = {"files": {name: [digest(folder / name)] for name in names}}
    write_atomically(folder / UNFINISHED / _OVERWRITABLE, json.dumps(content).encode())


def _read(path: Path) -> Files:
    try:
        files = json.loads(path.read_text(encoding="utf-8"))["files"] if path.is_file() else {}
        return {str(name): [str(checksum) for checksum in digests] for name, digests in files.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}


TRIES = 20
LOCK, HOLDER = ".lock", ".lock.json"  # both are removed at the end


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock on a folder, which is created if it does not exist.

    Locking a member of a sweep locks the whole sweep. The lock is only as reliable as the operating system's own locks:
    on some network file systems, these do not work between machines.

    Raises
    ------
    ValueError
        If another process holds the lock, or the folder is not writable.
    """
    from filelock import FileLock, Timeout

    place = folder.absolute()
    if place.parent.name == MEMBERS and (place.parent.parent / SWEEP).is_file():
        place = place.parent.parent
    if place.is_file():
        raise ValueError(f"{folder} is a file, not a folder: choose another --out")
    if name := _find_foreign_file(place):
        raise ValueError(
            f"{folder} contains {name}, which stickslip did not write: move it away, or choose another --out"
        )
    made = [path for path in (place, *place.parents) if not path.exists()]
    lock = FileLock(place / LOCK, timeout=0)
    try:
        for left in reversed(range(TRIES)):
            try:
                place.mkdir(parents=True, exist_ok=True)
                lock.acquire()
                break
            except (FileNotFoundError, FileExistsError):  # another process may be removing a folder that it created
                if not left:
                    raise
    except Timeout:
        raise ValueError(
            f"{folder} is in use: {_describe_holder(place)}; wait until it ends, or choose another --out"
        ) from None
    except OSError as problem:
        _remove_empty(made)
        raise ValueError(f"cannot write to the folder {folder} ({problem.strerror}): choose another --out") from None
    try:
        by = " ".join(["stickslip", *sys.argv[1:2]])
        note = {"pid": os.getpid(), "host": socket.gethostname(), "since": time.strftime("%Y-%m-%d %H:%M:%S"), "by": by}
        with suppress(OSError):  # a full disk is reported when results are written
            write_atomically(place / HOLDER, json.dumps(note).encode())
        yield
    finally:
        # while locked: a process that opened the old file notices that it is gone, and retries
        for name in (HOLDER, LOCK):
            with suppress(OSError):
                (place / name).unlink()
        lock.release()
        _remove_empty(made)


def _describe_holder(place: Path) -> str:
    """Describe the process that holds the lock, if its note can be read."""
    try:
        note = json.loads((place / HOLDER).read_text(encoding="utf-8"))
        return f"process {note['pid']} on {note['host']} ({note['by']}) has been using it since {note['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process is using it"


def _find_foreign_file(place: Path) -> str | None:
    """Name of a foreign file or link found in place of the (empty) lock file or the note about its holder."""
    for name in (LOCK, HOLDER):
        path = place / name
        with suppress(OSError):  # it may have been removed meanwhile
            if not stat.S_ISREG(path.lstat().st_mode):
                return name
            text = path.read_bytes()
            if text and (name == LOCK or not text.startswith(b"{")):
                return name
    return None


def _remove_empty(folders: list[Path]) -> None:
    """Remove those of the newly created folders that are empty."""
    for path in folders:
        with suppress(OSError):
            path.rmdir()
