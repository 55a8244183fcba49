"""Files of named records that only grow, for checkpoints.

Every process appends to a file of its own in a folder, so that no locks are needed. A process that is killed while it
appends leaves an incomplete record at the end of its file: reading ends before the first record that does not match its
checksum. The first record of a file says what it belongs to.
"""

import json
import os
import struct
import time
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

SUFFIX = ".records"
SYNC = 1.0  # shortest time between two flushes to disk: a power failure loses no more work than this [s]
_FRAME = struct.Struct("<IHQ")  # checksum of what follows, length of the name, length of the content


class Record(NamedTuple):
    """Location of a record."""

    path: Path
    start: int
    size: int

    def read(self) -> bytes:
        """Content of the record."""
        with self.path.open("rb") as file:
            file.seek(self.start)
            return file.read(self.size)


class Index:
    """Records of a file by name, as far as it has been read, and what the file belongs to."""

    def __init__(self, first: bytes):
        self.first, self.end = first, 0
        self.found: dict[str, Record] = {}
        self.about: dict[str, str] = {}


_INDEX: dict[Path, Index] = {}
_OWN: dict[tuple[int, Path], Path] = {}  # file to which a process appends, by process and folder
_SYNCED: dict[Path, float] = {}  # time of the last flush to disk


def files(folder: Path) -> list[Path]:
    """Files of records in a folder."""
    return sorted(folder.glob(f"*{SUFFIX}"))


def read_index(path: Path) -> Index:
    """Read what has been appended to a file since the last call."""
    with path.open("rb") as file:
        first = file.read(_FRAME.size)
        index = _INDEX.get(path)
        if index is None or index.first != first:  # the file is another one: its first record is unique
            index = _INDEX[path] = Index(first)
        file.seek(index.end)
        while len(frame := file.read(_FRAME.size)) == _FRAME.size:
            checksum, length, size = _FRAME.unpack(frame)
            if index.end + len(frame) + length + size > os.fstat(file.fileno()).st_size:
                break
            data = file.read(length + size)
            if crc32(data, crc32(frame[4:])) != checksum:
                break
            if index.end == 0:
                index.about = json.loads(data)
            else:
                index.found[data[:length].decode()] = Record(path, index.end + len(frame) + length, size)
            index.end += len(frame) + len(data)
    return index


def append(folder: Path, name: str, content: bytes, about: dict) -> None:
    """Append a record; it survives whatever happens to this process.

    Parameters
    ----------
    about : what the folder belongs to, for the first record
    """
    own = os.getpid(), folder
    path = _OWN.setdefault(own, folder / f"{os.urandom(8).hex()}{SUFFIX}")
    try:
        with path.open("ab") as file:
            first = b"" if file.tell() else _framed("", json.dumps(about | {"file": os.urandom(8).hex()}).encode())
            file.write(first + _framed(name, content))
            file.flush()
            if time.monotonic() - _SYNCED.get(path, -SYNC) >= SYNC:
                os.fsync(file.fileno())
                _SYNCED[path] = time.monotonic()
    except OSError as problem:
        del _OWN[own]  # the file may end with an incomplete record, after which nothing is read
        problem.filename = str(path)
        raise


def _framed(name: str, content: bytes) -> bytes:
    label = name.encode()
    sizes = _FRAME.pack(0, len(label), len(content))[4:]
    return b"".join([struct.pack("<I", crc32(content, crc32(label, crc32(sizes)))), sizes, label, content])
