"""Checkpoints of an unfinished run: named pieces, from which a killed run can be resumed.

Pieces are records in files that only grow. Each file names the scenario to which its pieces belong. They are not used
for any other scenario, and are removed when the run has written its results. Every process appends to its own file, so
that no locks are needed. A process that is killed while it appends leaves an incomplete record at the end of its file:
reading stops at the first record that does not match its checksum. The first record of a file identifies its owner.
"""

import hashlib
import json
import os
import shutil
import struct
import time
from collections import ChainMap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, overload
from zlib import crc32

from .. import __version__
from .._core import build
from ..core.arguments import check_value
from ..core.units import Units
from .archive import ArchiveError, Node, from_bytes, known_nouns, make_node, refuse_damage, restore, to_bytes
from .run_files import BEGUN, GONE, MEMBERS, SCENARIO, UNFINISHED, unfinished_scenario, write_atomically

SUFFIX = ".records"
SYNC = 1.0  # shortest time between two flushes to disk: a power failure loses no more work than this [s]
_FRAME = struct.Struct("<IHQ")  # checksum of the rest, length of the name, length of the content


class Record(NamedTuple):
    """Location of a record in a file of pieces."""

    path: Path
    start: int
    size: int

    def read(self) -> bytes:
        """Content of the record."""
        with self.path.open("rb") as file:
            file.seek(self.start)
            return file.read(self.size)


class Index:
    """Records that have been read from a file so far, by name, and the owner of the file."""

    def __init__(self, first: bytes):
        self.first, self.end = first, 0
        self.found: dict[str, Record] = {}
        self.about: dict[str, str] = {}


_INDEX: dict[Path, Index] = {}
_OWN: dict[tuple[int, Path], Path] = {}  # file to which a process appends, by process and folder
_SYNCED: dict[Path, float] = {}  # time of the last flush to disk


def record_files(folder: Path) -> list[Path]:
    """Files of records in a folder."""
    return sorted(folder.glob(f"*{SUFFIX}"))


def append_record(folder: Path, name: str, content: bytes, about: dict) -> None:
    """Append a record; it survives a crash of this process.

    Parameters
    ----------
    about : description of the owner of the folder, written to the first record of a new file
    """
    key = os.getpid(), folder
    path = _OWN.setdefault(key, folder / f"{os.urandom(8).hex()}{SUFFIX}")
    try:
        with path.open("ab") as file:
            first = b"" if file.tell() else _to_frame("", json.dumps(about | {"file": os.urandom(8).hex()}).encode())
            file.write(first + _to_frame(name, content))
            file.flush()
            if time.monotonic() - _SYNCED.get(path, -SYNC) >= SYNC:
                os.fsync(file.fileno())
                _SYNCED[path] = time.monotonic()
    except OSError as problem:
        del _OWN[key]  # the file may end with an incomplete record, after which nothing is read
        problem.filename = str(path)
        raise


def _to_frame(name: str, content: bytes) -> bytes:
    label = name.encode()
    sizes = _FRAME.pack(0, len(label), len(content))[4:]
    return b"".join([struct.pack("<I", crc32(content, crc32(label, crc32(sizes)))), sizes, label, content])


OTHER_VERSION = "resume with that version, or restart with --overwrite"
_PART = "part-"  # prefix, followed by a digest, of the file with the scenario of a part of the run


class Checkpoint(NamedTuple):
    """Location of the saved pieces of a run, or of one of its parts."""

    run: Path  # folder of the run
    scenario: str  # canonical text
    nouns: tuple[type, ...] = ()  # classes of the NamedTuples and enums in the pieces
    part: str = "."
    units: Units | None = None  # None if the run does not name units

    def of(self, part: str, *nouns: type) -> "Checkpoint":
        """Location of the pieces of one part of the run."""
        return self._replace(part=f"{self.part}/{part}", nouns=nouns or self.nouns)

    @property
    def folder(self) -> Path:
        """Folder of the pieces."""
        return self.run / UNFINISHED / self.part

    @property
    def names(self) -> list[str]:
        """Names of the existing pieces, sorted."""
        return sorted(self._find())

    def has(self, name: str) -> bool:
        """Return True if a piece exists."""
        return name in self._find()

    def announce(self) -> None:
        """Write the scenario, so that the run can be resumed and other processes can find its folder.

        The scenario of an earlier run is kept with its results.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        # a reproduction runs several scenarios: the first is that of the run, the others are those of its parts
        if not self._has_note:
            note = self._note(_PART if unfinished_scenario(self.run) else BEGUN)
            write_atomically(note, self.scenario.encode())
        if not (self.run / SCENARIO).exists():
            write_atomically(self.run / SCENARIO, self.scenario.encode())

    def if_visible(self) -> "Checkpoint | None":
        """Return self if this process can access the run's folder, else None (as for a worker on another machine)."""
        return self if self._has_note else None

    def check(self) -> None:
        """Raise ArchiveError if a piece of this part, or of a part within it, cannot be used."""
        for folder in (self.folder, *sorted(path for path in self.folder.rglob("*") if path.is_dir())):
            inside = folder.relative_to(self.folder)
            if UNFINISHED not in inside.parts:
                self.of(str(inside))._find()

    def _note(self, kind: str) -> Path:
        digest = hashlib.sha256(self.scenario.encode()).hexdigest()[:16]
        return self.run / UNFINISHED / f"{kind}{digest}.json"

    @property
    def _has_note(self) -> bool:
        return any(self._note(kind).is_file() for kind in (BEGUN, _PART))

    def save(self, name: str, value: Any) -> None:
        """Write a piece atomically; it survives a crash of this process."""
        self.announce()
        about = {"scenario": self.scenario, "stickslip": __version__, "part": self._place, "core": build.best_level()}
        append_record(self.folder, name, to_bytes(make_node(value, self.units)), about)

    def load(self, name: str, kind: Any = Any) -> Any:
        """Read a piece of the type that the annotation `kind` describes.

        Raises
        ------
        ArchiveError
            If the piece belongs to another scenario, version or part, contains an unknown law, or is damaged.
        """
        piece = self._find()[name]
        with _refuse_damage(piece.path):
            value = restore(from_bytes(piece.read()), known_nouns(self.nouns))
            check_value(name, value, kind)
        return value

    def _find(self) -> Mapping[str, Record]:
        """Existing pieces by name."""
        if any(not path.name.startswith(".") for path in self.folder.glob("*.h5")):
            raise ArchiveError(
                f"{self.folder} contains checkpoints in the format of an earlier version: {OTHER_VERSION}"
            )
        indices = [read_index(path) for path in record_files(self.folder)]
        for index in indices:
            self._check(index.about)
        return ChainMap(*(index.found for index in indices))

    def _check(self, about: dict) -> None:
        if about and about["scenario"] != self.scenario:
            raise ArchiveError(
                f"{self.folder} contains parts of a run of a different scenario, perhaps with another law: "
                "restore the earlier scenario, or run the present one with --overwrite"
            )
        if about and about["stickslip"] != __version__:
            raise ArchiveError(
                f"{self.folder} was computed by stickslip {about['stickslip']}, whose numbers may differ from those "
                f"of this version, {__version__}: {OTHER_VERSION}"
            )
        if about and about["part"] != self._place:
            raise ArchiveError(f"{self.folder} contains pieces of {about['part']}: restore the original folder names")

    @property
    def _place(self) -> str:
        return Path(self.part).as_posix()

    def clear(self) -> None:
        """Remove all pieces of this part."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _refuse_damage(path: Path):
    return refuse_damage(path, "a checkpoint", "remove it and resume again, so that its part is computed again")


def read_index(path: Path) -> Index:
    """Index of a file of pieces; raise ArchiveError if it does not identify their owner."""
    with _refuse_damage(path):
        with path.open("rb") as file:  # read only the records appended since the last call
            first = file.read(_FRAME.size)
            index = _INDEX.get(path)
            if index is None or index.first != first:  # another file: first records are unique
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
        if index.found or index.about:
            check_value("about", index.about, dict[str, str])
            index.about["scenario"], index.about["stickslip"], index.about["part"]
    return index


def is_worth_resuming(folder: Path) -> bool:
    """Return True if any part of an unfinished run or sweep has been saved in its folder."""
    inside = [path for name in (UNFINISHED, MEMBERS) for path in (folder / name).rglob("*")]
    return any(path.suffix in (SUFFIX, ".h5") and not path.name.startswith(".") for path in inside)


def note_on_levels(folder: Path) -> str:
    """Sentence about checkpoints that were computed by the core for other processors; empty if there are none."""
    levels = {read_index(path).about.get("core") for path in folder.rglob(f"*{SUFFIX}")}
    others, level = sorted(levels - {None, build.best_level()}), build.best_level()
    if not others:
        return ""
    return (
        f"{folder} contains checkpoints computed by the core for {' and '.join(others)}, but this is the core for "
        f"{level}: results will agree with those of an uninterrupted run to round-off, not bit for bit"
        + (f"; STICKSLIP_LEVEL={others[0]} continues with that core" if others[0] in build.usable_levels() else "")
    )


def read_pieces(folder: Path) -> tuple[dict[str, Node], dict[str, str]]:
    """Pieces that an unfinished run has saved so far, by part and name, and their owner."""
    pieces, about = {}, {}
    for path in sorted((folder / UNFINISHED).rglob(f"*{SUFFIX}")):
        index, part = read_index(path), path.parent.relative_to(folder / UNFINISHED)
        with _refuse_damage(path):
            pieces |= {(part / name).as_posix(): from_bytes(record.read()) for name, record in index.found.items()}
        about = about or index.about
    return dict(sorted(pieces.items())), about


@overload
def checkpoint_in(folder: Path, scenario, *nouns: type) -> Checkpoint: ...
@overload
def checkpoint_in(folder: Path | None, scenario, *nouns: type) -> Checkpoint | None: ...
def checkpoint_in(folder, scenario, *nouns):
    """Location of the pieces of a scenario that is run in a folder; None without a folder."""
    return Checkpoint(folder, scenario.text, nouns, units=scenario.named_units) if folder else None


def load_or_compute(kept: Checkpoint | None, name: str, make: Callable[[], Any], kind: Any = None) -> Any:
    """Load a piece if it exists, otherwise compute and save it; `kind` is its type, by default that of the result."""
    if kept is None:
        return make()
    if not kept.has(name):
        kept.save(name, make())
    return kept.load(name, kind or kind_of_result(make))


def kind_of_result(function: Callable) -> Any:
    """Annotation of the result of a function or `partial`; Any if there is none."""
    return getattr(getattr(function, "func", function), "__annotations__", {}).get("return", Any)


def abandon(kept: Checkpoint) -> None:
    """Remove pieces of a run whose input proved to be wrong; results of an earlier run remain."""
    remove_checkpoint(kept.run)
    if all(path.name == SCENARIO or path.name.startswith(".") for path in kept.run.iterdir()):
        (kept.run / SCENARIO).unlink(missing_ok=True)


def remove_checkpoint(folder: Path) -> None:
    """Remove the pieces of a run that has written its results."""
    gone = folder / GONE  # renamed first, so that an interruption cannot leave only some of the pieces
    shutil.rmtree(gone, ignore_errors=True)
    if (folder / UNFINISHED).is_dir():
        (folder / UNFINISHED).rename(gone)
    shutil.rmtree(gone, ignore_errors=True)
