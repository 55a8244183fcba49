"""Folder lock: only one process at a time works in a folder. The operating system releases it when the process ends."""

import json
import os
import socket
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from . import atomic
from .checkpoint import MEMBERS, SWEEP

TRIES = 20
LOCK, HOLDER = ".lock", ".lock.json"  # both are removed when the work is done


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock on a folder, which is created if it does not exist.

    Locking a member of a sweep locks the whole sweep. The lock is only as reliable as the operating system's own locks:
    on some network file systems, these do not work between machines.

    Raises
    ------
    ValueError
        with a one-sentence message: which process holds the lock and since when, or why the folder is not writable.
    """
    place = _folder_to_lock(folder)
    if place.is_file():
        raise ValueError(f"{folder} is a file, not a folder: choose another --out")
    if name := _find_foreign_file(place):
        raise ValueError(f"{folder} holds {name}, which stickslip did not write: move it away, or choose another --out")
    made = [path for path in (place, *place.parents) if not path.exists()]
    lock = FileLock(place / LOCK, timeout=0)
    try:
        _acquire(place, lock)
    except Timeout:
        raise ValueError(
            f"{folder} is in use: {_describe_holder(place)}; wait until it ends, or choose another --out"
        ) from None
    except OSError as problem:
        _remove_empty(made)
        raise ValueError(f"the folder {folder} cannot be written ({problem.strerror}): choose another --out") from None
    try:
        _write_holder(place)
        yield
    finally:
        for name in (HOLDER, LOCK):  # under the lock: a process that opened the old file sees it is gone, and retries
            with suppress(OSError):
                (place / name).unlink()
        lock.release()
        _remove_empty(made)


def _acquire(place: Path, lock: FileLock) -> None:
    """Create the folder and acquire the lock; retry while another process is removing a folder that it had created."""
    for last in (False,) * (TRIES - 1) + (True,):
        try:
            place.mkdir(parents=True, exist_ok=True)
            lock.acquire()
            return
        except (FileNotFoundError, FileExistsError):
            if last:
                raise


def _folder_to_lock(folder: Path) -> Path:
    """Folder that contains the lock; for a member of a sweep, the sweep's folder."""
    place = folder.absolute()
    above = place.parent.parent
    return above if place.parent.name == MEMBERS and (above / SWEEP).is_file() else place


def _write_holder(place: Path) -> None:
    command = " ".join(["stickslip", *sys.argv[1:2]])
    note = {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "since": time.strftime("%Y-%m-%d %H:%M:%S"),
        "by": command,
    }
    with suppress(OSError):  # a full disk is reported when results are written
        atomic.write_atomically(place / HOLDER, json.dumps(note).encode())


def _describe_holder(place: Path) -> str:
    """Describe the process that holds the lock, as far as its note can be read."""
    try:
        note = json.loads((place / HOLDER).read_text(encoding="utf-8"))
        return f"process {note['pid']} on {note['host']} ({note['by']}) has been using it since {note['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process is using it"


def _find_foreign_file(place: Path) -> str | None:
    """Name of a foreign file or link found in place of the (empty) lock file or the note about its holder."""
    for name in (LOCK, HOLDER):
        path = place / name
        with suppress(OSError):  # gone meanwhile
            if not stat.S_ISREG(path.lstat().st_mode):
                return name
            text = path.read_bytes()
            if text and (name == LOCK or not text.startswith(b"{")):
                return name
    return None


def _remove_empty(folders: list[Path]) -> None:
    """Remove any created folders that are empty."""
    for path in folders:
        with suppress(OSError):
            path.rmdir()
