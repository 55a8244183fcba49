"""Which files of a folder runs have written: their digests, in a manifest beside them.

What the manifest does not prove is somebody else's: no run replaces or removes it unasked. While one file takes the
place of another the manifest knows both, so that who is killed meanwhile leaves nothing that it does not know.
"""

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path

from . import atomic as whole
from .checkpoint import ANEW, GONE, MEMBERS, SCENARIO, SWEEP, UNFINISHED, WRITING, under_way

MANIFEST = "manifest.json"
_ABOUT = "SHA-256 of the files that stickslip wrote here: it replaces no others"
_FOLDER, _OTHER = "folder", "neither"  # what stands for the digest of one, and of what is no file
_OVERWRITABLE = "overwritten.json"  # beside the pieces: what --overwrite gave up, until the run has taken its place

_PART = re.compile(r"\..+\.\d+(\.\w+)?")  # of a file that is being written
_PIECE = re.compile(r".+\.h5|(scenario|part)(-\w+)?\.json|reproduce\.json|" + re.escape(_OVERWRITABLE))
_SWEEP_FILES = (MANIFEST, SWEEP, "sweep-options.json", "sweep.nc", MEMBERS, "ready")

Files = dict[str, list[str]]  # digests by name: one, or two where a file is about to be replaced


def proven(folder: Path) -> Files:
    """What runs have written; nothing without a manifest, or with one that cannot be read."""
    return _read(folder / MANIFEST)


def note(folder: Path, files: Files) -> None:
    """Write the manifest."""
    told = {"about": _ABOUT, "files": dict(sorted(files.items()))}
    whole.replace(folder / MANIFEST, json.dumps(told, indent=1).encode())


def note_too(folder: Path, *names: str) -> None:
    """Add files and folders, as they are now, to the manifest."""
    note(folder, proven(folder) | {name: [digest(folder / name)] for name in names})


def put(folder: Path, name: str, content: bytes) -> None:
    """Put a file of a run in place of another, all or nothing."""
    known, new = proven(folder), hashlib.sha256(content).hexdigest()
    note(folder, known | {name: [*known.get(name, []), new]})
    whole.replace(folder / name, content)
    note(folder, known | {name: [new]})


def digest(path: Path) -> str:
    """SHA-256 of a file; of a folder that it is one."""
    if path.is_dir():
        return _FOLDER
    if not path.is_file():
        return _OTHER  # a pipe or a device, which would be read for ever, or a link to nothing
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def strange(folder: Path, ours: Callable[[str], bool]) -> list[str]:
    """Names of what no run has written, or what was changed since; where there is no trace of a run, of all there is.

    Parameters
    ----------
    ours : whether a run may write, replace or remove a file of a name; others do not count beside its own, and hidden
        ones never
    """
    if not folder.is_dir():
        return []
    own, adopted, begun = proven(folder), _read(folder / UNFINISHED / _OVERWRITABLE), under_way(folder)
    known = {name: own.get(name, []) + adopted.get(name, []) for name in own | adopted}
    if begun is not None:  # which wrote its scenario before there was a manifest
        known[SCENARIO] = [*known.get(SCENARIO, []), digest(begun)]
    trace = bool(own) or begun is not None
    seen = (path for path in folder.iterdir() if not path.name.startswith(".") and not _is_empty_run_folder(path))
    mine = {MANIFEST, UNFINISHED} if trace else set()
    rest = (path for path in seen if path.name not in mine and (ours(path.name) or not trace))
    return sorted(path.name for path in rest if path.name not in known or digest(path) not in known[path.name])


def _is_empty_run_folder(path: Path) -> bool:
    """Whether it is one of the folders with which runs begin, and holds no file yet: who made it was stopped then."""
    if path.name not in (UNFINISHED, MEMBERS) or path.is_symlink() or not path.is_dir():
        return False
    return all(inner.is_dir() and not inner.is_symlink() for inner in path.rglob("*"))


def check_hidden(folder: Path, ours: Callable[[str], bool]) -> None:
    """Make sure that folders which runs use for a while, and remove, hold nothing else.

    Parameters
    ----------
    ours : whether a run may write a result of a name

    Raises
    ------
    ValueError
        with one sentence that names what somebody else has there.
    """
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
            f"{folder} holds {there}, where runs keep what is not finished: move it away, or choose another --out"
        )


def _is_own_hidden(path: Path, piece: bool, ours: Callable[[str], bool]) -> bool:
    if path.is_symlink():
        return False
    if _PART.fullmatch(path.name):
        return True
    if piece:
        return path.is_dir() or (path.is_file() and _PIECE.fullmatch(path.name) is not None)
    return ours(path.name) or path.name in _SWEEP_FILES


def adopt(folder: Path, names: Iterable[str]) -> None:
    """Give up files of others: the run that begins there may replace them when it has ended."""
    (folder / UNFINISHED).mkdir(exist_ok=True)
    told = {"files": {name: [digest(folder / name)] for name in names}}
    whole.replace(folder / UNFINISHED / _OVERWRITABLE, json.dumps(told).encode())


def _read(path: Path) -> Files:
    try:
        files = json.loads(path.read_text(encoding="utf-8"))["files"] if path.is_file() else {}
        return {str(name): [str(one) for one in digests] for name, digests in files.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
