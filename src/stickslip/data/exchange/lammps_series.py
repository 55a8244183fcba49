"""Frames of LAMMPS dumps in a folder, found while they are written: one growing file, or one file for each frame.

A frame is complete when all rows that its header declares have been written, the last one with its newline. Files are
read once: each look continues where the one before ended.
"""

import hashlib
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from ...core.laws.builtin import Law
from ...core.state import State
from ...core.text import parse_integer
from ..sample import WALLS, Obstacle, PackingError, notes_about, with_one_account
from .content import Packing
from .lammps_file import build_state, packing_from_table, pairs_from_table
from .lammps_text import Table, parse_step

GRAINS, CONTACTS = "ATOMS", "ENTRIES"  # what a dump says that it has a number of
BEGIN, ITEM = b"ITEM: TIMESTEP", b"ITEM:"
COMPRESSED = (b"\x1f\x8b", b"\x28\xb5\x2f\xfd")  # first bytes of gzip and Zstandard files
HEAD = 512  # bytes at the beginning of a file that tell what it is


class DumpFrame(NamedTuple):
    """Place of one time step in a dump."""

    step: int  # −1 if its header cannot be read
    kind: str  # GRAINS, CONTACTS, or the label of something else
    path: Path
    start: int  # first byte
    stop: int  # byte after the last one
    digest: str  # of its bytes
    problem: str = ""  # why it cannot be used; empty for a complete frame


class Dump(NamedTuple):
    """A file and the frames found in it so far."""

    frames: tuple[DumpFrame, ...]
    read: int  # bytes up to which frames are known
    size: int  # bytes of the file at the last look
    modified: int  # time of its last change [ns]

    @property
    def partial(self) -> bool:
        """True if the file ends in the middle of a frame."""
        return self.read < self.size


def find_dumps(folder: Path, known: dict[Path, Dump], pattern: str = "*") -> dict[Path, Dump]:
    """Dumps in a folder whose names match a pattern; `known` are those of the look before."""
    dumps = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not fnmatch(path.name, pattern) or not path.is_file():
            continue
        stat, before = path.stat(), known.get(path)
        if before and (before.size, before.modified) == (stat.st_size, stat.st_mtime_ns):
            dumps[path] = before
        elif (before and stat.st_size >= before.size) or _is_dump(path):
            kept = before if before and stat.st_size >= before.size else Dump((), 0, 0, 0)
            dumps[path] = _read_new_frames(path, kept, stat.st_mtime_ns)
    return dumps


def _is_dump(path: Path) -> bool:
    """Return True for text dumps, and for empty files, which may become one."""
    head = _head(path)
    return ITEM.startswith(head) or head.startswith(ITEM)


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD)


def has_dumps(folder: Path, kind: str, pattern: str = "*") -> bool:
    """Return True if a folder has a dump of a kind, if only its beginning, or an empty file named like a dump."""
    mark = f"NUMBER OF {kind}".encode()
    for path in folder.iterdir() if folder.is_dir() else ():
        if not path.name.startswith(".") and fnmatch(path.name, pattern) and path.is_file():
            head = _head(path)
            if (head.startswith(ITEM) and mark in head) or (not head and "dump" in path.name):
                return True
    return False


def find_compressed(folder: Path) -> Path | None:
    """First compressed file in a folder whose name contains "dump"."""
    for path in sorted(folder.iterdir()):
        if "dump" in path.name and path.is_file() and _head(path).startswith(COMPRESSED):
            return path
    return None


def _read_new_frames(path: Path, before: Dump, modified: int) -> Dump:
    """Find the frames that were written after those of an earlier look."""
    with path.open("rb") as file:
        frames = (*before.frames, *_frames_from(file, path, before.read))
        size = file.seek(0, 2)
    read = frames[-1].stop if frames else 0
    return Dump(frames, size if _is_blank(path, read, size) else read, size, modified)


def _is_blank(path: Path, start: int, stop: int) -> bool:
    """Return True if only white space follows the last frame."""
    with path.open("rb") as file:
        file.seek(start)
        return stop - start < HEAD and not file.read(stop - start).strip()


def _frames_from(file: BinaryIO, path: Path, start: int) -> Iterator[DumpFrame]:
    """Complete and damaged frames from a position on; stops before one that is still being written."""
    file.seek(start)
    while (at := _find_time_step(file)) is not None:
        file.seek(at)
        frame = _next_frame(file, path)
        if frame is None:
            return
        yield frame
        file.seek(frame.stop)


def _find_time_step(file: BinaryIO) -> int | None:
    """Position of the next ITEM: TIMESTEP."""
    while line := file.readline():
        if (at := line.find(BEGIN)) >= 0 and line.endswith(b"\n"):
            return file.tell() - len(line) + at
    return None


def _next_frame(file: BinaryIO, path: Path) -> DumpFrame | None:
    """Frame that begins at the position of the file; None if it is still being written.

    A frame that was cut off is damaged once another one follows it.
    """
    start, digest = file.tell(), hashlib.blake2b(digest_size=8)
    try:
        head = _read_head(file, digest)
        if head is None:
            return None
        step, kind, rows = head
    except ValueError as problem:
        return _damaged_frame(file, path, start, -1, str(problem))
    for number in range(rows):
        line = file.readline()
        if BEGIN in line:
            file.seek(-len(line), 1)
            return _damaged_frame(file, path, start, step, f"the frame was cut off after {number} of {rows} rows")
        if not line.endswith(b"\n"):
            return None
        digest.update(line)
    return DumpFrame(step, kind, path, start, file.tell(), digest.hexdigest())


def _read_head(file: BinaryIO, digest) -> tuple[int, str, int] | None:
    """Step, kind and number of rows of a frame; None if its header is still being written, ValueError if damaged."""
    numbers: dict[str, int] = {}
    name, kind = "", ""
    while not (kind and name.startswith(f"{kind} ")):
        line = file.readline()
        if not line.endswith(b"\n"):
            return None
        if BEGIN in (line[1:] if not name else line):
            file.seek(-len(line) + (0 if name else 1), 1)
            raise ValueError("the header was cut off")
        digest.update(line)
        text = line.decode("utf-8", "replace")
        if line.startswith(ITEM):
            name = text.removeprefix("ITEM:").strip()
            kind = name.removeprefix("NUMBER OF ") if name.startswith("NUMBER OF ") else kind
        elif name == "TIMESTEP" or name.startswith("NUMBER OF "):
            numbers[name] = parse_integer(text)
    try:
        return numbers["TIMESTEP"], kind, numbers[f"NUMBER OF {kind}"]
    except KeyError as missing:
        raise ValueError(f"the header has no {missing.args[0]}") from None


def _damaged_frame(file: BinaryIO, path: Path, start: int, step: int, damage: str) -> DumpFrame | None:
    """Damaged frame, which ends where the next one begins; None if there is none yet."""
    stop = _find_time_step(file)
    place = f"{path.name}, step {step}" if step >= 0 else f"{path.name}, byte {start}"
    return None if stop is None else DumpFrame(step, "", path, start, stop, "", f"{place}: {damage}")


def frames_of(dumps: dict[Path, Dump], kind: str) -> tuple[dict[int, DumpFrame], list[str]]:
    """Complete frames of a kind by their step, and notes on steps that are in more than one file.

    Of several frames with the same step, the one that was written last is used.
    """
    frames: dict[int, DumpFrame] = {}
    twice: dict[tuple[Path, Path], int] = {}
    for path, dump in sorted(dumps.items(), key=lambda item: (item[1].modified, item[0])):
        for frame in dump.frames:
            if frame.kind == kind:
                other = frames.get(frame.step)
                if other:
                    twice.setdefault((other.path, path), frame.step)
                frames[frame.step] = frame
    notes = [
        f"step {step} is in {old.name} and in {new.name}: the latter, which was written last, is used; name the files "
        f"that belong together"
        if old != new
        else f"step {step} is twice in {old.name}, as after `reset_timestep`: the last of both is used"
        for (old, new), step in twice.items()
    ]
    return dict(sorted(frames.items())), notes


def read_content(frame: DumpFrame) -> Table:
    """Content of a frame."""
    with frame.path.open("rb") as file:
        file.seek(frame.start)
        content = file.read(frame.stop - frame.start)
    if hashlib.blake2b(content, digest_size=8).hexdigest() != frame.digest:
        raise PackingError(f"{frame.path.name}, step {frame.step}: the file was replaced while it was read")
    try:
        return parse_step(frame.step, content.decode("utf-8").partition("ITEM: TIMESTEP")[2])
    except (ValueError, IndexError, KeyError) as problem:
        raise PackingError(f"{frame.path.name}, step {frame.step} is damaged: {problem}") from None


def read_frame(
    grains: DumpFrame, contacts: DumpFrame | None, law: Law, *, columns: str | None = None,
    boundary: str | None = None, run: Packing | None = None,
) -> tuple[State, list[str]]:  # fmt: skip
    """Accepted state of a frame, with memory if there is one of contacts, and notes; see `read_lammps`.

    With the packing of its run, it is put amid the walls and loads of the run.
    """
    table, pairs = read_content(grains), None
    local = None if contacts is None else read_content(contacts)
    if local is not None and table.periodic is None:
        table = table._replace(periodic=local.periodic)
    packing = packing_from_table(table, grains.path, boundary)
    if run is not None:
        packing = _in_run(packing, run)
    if contacts is not None and local is not None:
        pairs = pairs_from_table(local, contacts.path, packing, columns)
    state, notes = build_state(packing, pairs, law)
    return state, with_one_account([*packing.notes, *notes])


def _in_run(packing: Packing, run: Packing) -> Packing:
    """Packing of a frame with the walls, loads and law of its run, and the notes on these."""
    alike = run.ids is None or np.array_equal(packing.ids, run.ids)
    if run.setting is not None and not alike:
        raise PackingError(
            "it has other grains than the newest packing of the run, whose walls and loads it would have: give --law"
        )
    known = [] if run.setting is None else notes_about(packing.notes, WALLS)
    own = [note for note in packing.notes if note not in known]
    acts = [note for note in run.notes if isinstance(note, Obstacle)]
    return packing._replace(setting=run.setting, notes=[*own, *(note for note in acts if note not in own)])
