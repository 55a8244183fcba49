"""One process at a time works in a folder: a lock of the system, which ends with the process however that ends."""

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

from . import atomic as whole
from .checkpoint import MEMBERS, SWEEP

TRIES = 20
LOCK, HOLDER = ".lock", ".lock.json"  # neither is there any more when the work is done


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Work in a folder, which is made if it is missing, while no other process does.

    A member of a sweep is held with the whole sweep. Where the system's locks do not reach, as between machines on some
    network file systems, neither does this one.

    Raises
    ------
    ValueError
        with one sentence that says which process works there and since when, or why nothing can be written there.
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
        for name in (HOLDER, LOCK):  # under the lock: who opens the old file now sees that it is gone, and tries again
            with suppress(OSError):
                (place / name).unlink()
        lock.release()
        _remove_empty(made)


def _acquire(place: Path, lock: FileLock) -> None:
    """Make the folder and take the lock in it; tried again where another process removes what it had made itself."""
    for last in (False,) * (TRIES - 1) + (True,):
        try:
            place.mkdir(parents=True, exist_ok=True)
            lock.acquire()
            return
        except (FileNotFoundError, FileExistsError):
            if last:
                raise


def _folder_to_lock(folder: Path) -> Path:
    """Where the lock is: a member's stands in the sweep's folder."""
    whole = folder.absolute()
    above = whole.parent.parent
    return above if whole.parent.name == MEMBERS and (above / SWEEP).is_file() else whole


def _write_holder(place: Path) -> None:
    words = " ".join(["stickslip", *sys.argv[1:2]])
    told = {"pid": os.getpid(), "host": socket.gethostname(), "since": time.strftime("%Y-%m-%d %H:%M:%S"), "by": words}
    with suppress(OSError):  # a full disk is told when results are written
        whole.replace(place / HOLDER, json.dumps(told).encode())


def _describe_holder(place: Path) -> str:
    """Who works there, in words; a note that is being written or is gone tells nothing."""
    try:
        told = json.loads((place / HOLDER).read_text(encoding="utf-8"))
        return f"process {told['pid']} on {told['host']} ({told['by']}) has worked in it since {told['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process works in it"


def _find_foreign_file(place: Path) -> str | None:
    """Somebody's file or link by the name of the lock, which is empty, or of the note about who holds it."""
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
    """Those that were made here and hold nothing."""
    for path in folders:
        with suppress(OSError):
            path.rmdir()
