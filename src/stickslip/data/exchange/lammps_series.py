"""Frames of LAMMPS dumps in a folder, found while they are written: one growing file, or one file for each frame.

A frame is complete when all rows declared in its header have been written, the last one with its newline. Files are
read once: each search continues where the previous one ended. Packings of a running simulation are read as soon as
their frames are complete.
"""

import hashlib
import time
from collections.abc import Iterator
from contextlib import suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from ...core.arguments import Positive, checked
from ...core.laws.builtin import Law
from ...core.state import State
from ...core.text import parse_integer
from ..sample import WALLS, Obstacle, PackingError, notes_about, refusing, with_one_account
from .columns import Packing
from .files import build_state, capture_warnings, chosen_law, lammps_law, separate_law, with_inertia
from .lammps_file import pairs_from_table
from .lammps_folder import read_folder
from .lammps_text import Table, packing_from_table, parse_step

GRAINS, CONTACTS = "ATOMS", "ENTRIES"  # names of the entries that a dump counts
BEGIN, ITEM = b"ITEM: TIMESTEP", b"ITEM:"
COMPRESSED = (b"\x1f\x8b", b"\x28\xb5\x2f\xfd")  # first bytes of gzip and Zstandard files
HEAD = 512  # number of bytes at the beginning of a file that identify its format


class DumpFrame(NamedTuple):
    """Place of one time step in a dump."""

    step: int  # −1 if its header cannot be read
    kind: str  # GRAINS, CONTACTS, or another label
    path: Path
    start: int  # first byte
    stop: int  # byte after the last one
    digest: str  # digest of its bytes
    problem: str = ""  # reason why it cannot be used; empty for a complete frame


class Dump(NamedTuple):
    """A file and the frames found in it so far."""

    frames: tuple[DumpFrame, ...]
    read: int  # bytes already searched for frames
    size: int  # size of the file at the last search [bytes]
    modified: int  # time of its last change [ns]

    @property
    def partial(self) -> bool:
        """True if the file ends in the middle of a frame."""
        return self.read < self.size


def find_dumps(folder: Path, known: dict[Path, Dump], pattern: str = "*") -> dict[Path, Dump]:
    """Dumps in a folder whose names match a pattern; `known` are those of the previous search."""
    dumps = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not fnmatch(path.name, pattern) or not path.is_file():
            continue
        stat, before = path.stat(), known.get(path)
        if before and (before.size, before.modified) == (stat.st_size, stat.st_mtime_ns):
            dumps[path] = before
        elif before and stat.st_size >= before.size:
            dumps[path] = _read_new_frames(path, before, stat.st_mtime_ns)
        elif ITEM.startswith(head := _head(path)) or head.startswith(ITEM):  # an empty file may become a dump
            dumps[path] = _read_new_frames(path, Dump((), 0, 0, 0), stat.st_mtime_ns)
    return dumps


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD)


def has_dumps(folder: Path, kind: str, pattern: str = "*") -> bool:
    """Return True if a folder has a (possibly incomplete) dump of this kind, or an empty file named like a dump."""
    mark = f"NUMBER OF {kind}".encode()
    for path in folder.iterdir() if folder.is_dir() else ():
        if not path.name.startswith(".") and fnmatch(path.name, pattern) and path.is_file():
            head = _head(path)
            if (head.startswith(ITEM) and mark in head) or (not head and "dump" in path.name):
                return True
    return False


def _read_new_frames(path: Path, before: Dump, modified: int) -> Dump:
    """Find the frames that were written since the previous search."""
    with path.open("rb") as file:
        frames = list(before.frames)
        file.seek(before.read)
        while (at := _find_time_step(file)) is not None:
            file.seek(at)
            if (frame := _next_frame(file, path)) is None:  # still being written
                break
            frames.append(frame)
            file.seek(frame.stop)
        size, read = file.seek(0, 2), frames[-1].stop if frames else 0
        file.seek(read)
        blank = size - read < HEAD and not file.read(size - read).strip()
    return Dump(tuple(frames), size if blank else read, size, modified)


def _find_time_step(file: BinaryIO) -> int | None:
    """Position of the next ITEM: TIMESTEP."""
    while line := file.readline():
        if (at := line.find(BEGIN)) >= 0 and line.endswith(b"\n"):
            return file.tell() - len(line) + at
    return None


def _next_frame(file: BinaryIO, path: Path) -> DumpFrame | None:
    """Frame that begins at the position of the file; None if it is still being written.

    A frame that was cut off counts as damaged once another frame follows it.
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
    location = f"{path.name}, step {step}" if step >= 0 else f"{path.name}, byte {start}"
    return None if stop is None else DumpFrame(step, "", path, start, stop, "", f"{location}: {damage}")


def frames_of(dumps: dict[Path, Dump], kind: str) -> tuple[dict[int, DumpFrame], list[str]]:
    """Complete frames of a kind by step, and notes on damaged ones and on duplicate steps.

    Among several frames with the same step, the last one written is used.
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
        f"step {step} is in {old.name} and in {new.name}: the latter, which was written last, is used; give a pattern "
        "for files that belong together"
        if old != new
        else f"step {step} occurs twice in {old.name}, as after `reset_timestep`: the last one is used"
        for (old, new), step in twice.items()
    ]
    damage = [frame.problem for dump in dumps.values() for frame in dump.frames if frame.problem]
    return dict(sorted(frames.items())), [*damage, *notes]


def read_content(frame: DumpFrame) -> Table:
    """Content of a frame."""
    with frame.path.open("rb") as file:
        file.seek(frame.start)
        content = file.read(frame.stop - frame.start)
    if hashlib.blake2b(content, digest_size=8).hexdigest() != frame.digest:
        raise PackingError(f"{frame.path.name}, step {frame.step}: the file was replaced while it was read")
    with refusing(lambda problem: f"{frame.path.name}, step {frame.step} is damaged: {problem}", IndexError, KeyError):
        return parse_step(frame.path, frame.step, content.decode("utf-8").partition("ITEM: TIMESTEP")[2])


INTERVAL = 1.0  # time between two searches of the folder [s]
FRESH = 3.0  # time after which an unchanged file is considered complete [s]
NEEDS = "`stickslip docs lammps` describes the required output of LAMMPS"


class Source(NamedTuple):
    """Location of the dumps, and options for reading them."""

    folder: Path
    grains: str  # pattern of the names of dumps of grains
    contacts: Path | None  # folder and pattern of dumps of contacts; None without memory
    law: Law
    columns: str | None
    boundary: str | None
    i0: float | None
    run: Packing | None = None  # packing of the folder, for law, walls and loads of the frames


class Pair(NamedTuple):
    """A frame of grains, and the frame of their contacts."""

    grains: DumpFrame
    contacts: DumpFrame | None


class Look(NamedTuple):
    """Contents of the folder at one time."""

    dumps: dict[Path, Dump]  # dumps of grains
    local: dict[Path, Dump]  # dumps of contacts
    ready: list[Pair]  # complete frames, by step
    waiting: tuple[int, ...]  # steps whose contacts may still be written
    lost: tuple[int, ...]  # steps without contacts, although later steps have them
    notes: tuple[str, ...]

    @property
    def sizes(self) -> dict[Path, tuple[int, int]]:
        """Sizes and modification times of all files, which change when the simulation writes."""
        return {path: (dump.size, dump.modified) for path, dump in (self.dumps | self.local).items()}


def open_source(place: str | Path, *, memory: bool = True, **options) -> Source:
    """Check a folder of dumps, or one dump, and the options for reading it.

    Parameters
    ----------
    memory : whether dumps of contacts are used, either the dumps named by `contacts` or all in the folder
    options : those of `read_packing` for LAMMPS dumps. `contacts` may be a pattern such as contacts.*.dump. If no law
    is given, the log or script in the folder defines the law, walls, loads and held grains

    Raises
    ------
    PackingError
        If there are no dumps or an option is missing.
    """
    given = {name: value for name, value in options.items() if value is not None}
    if "frame" in given:
        raise PackingError(
            "--frame does not apply here, as all frames are read: leave it out, or use stickslip stability"
        )
    if "atom_style" in given:
        raise PackingError("--atom-style does not apply to dumps, which name their columns: leave it out")
    if not Path(place).exists():
        raise PackingError(f"{place} does not exist: give the folder into which LAMMPS writes its dumps")
    folder, grains = (Path(place), "*") if Path(place).is_dir() else (Path(place).parent, Path(place).name)
    contacts, columns, boundary, i0 = (given.pop(name, None) for name in ("contacts", "columns", "boundary", "i0"))
    if not memory and (contacts or columns):
        raise PackingError(f"--no-contacts and --{'contacts' if contacts else 'columns'} exclude each other")
    _require_dumps(folder, grains, GRAINS)
    path = Path(contacts or "*")
    where = folder / path if path.parent == Path() else path
    given, file_law = separate_law(given)
    memory = memory and (_await_contacts(folder, grains, where) or contacts is not None)
    run = None
    if file_law is None and "law" not in given and Path(place).is_dir():
        with suppress(PackingError):  # the run may not have started yet
            run = read_folder(folder)[0]
    if file_law is None and "law" not in given and (run is None or run.law is None):
        raise PackingError(
            "LAMMPS dumps do not contain the contact law: give --law with --kn, --kt and --mu as in the pair_style, "
            "or a folder with log.lammps or the input script"
        )
    law = file_law or (chosen_law(run, given, None, memory=memory) if run else lammps_law(given, memory=memory))
    if memory:
        _require_dumps(where.parent, where.name, CONTACTS)
    return Source(folder, grains, where if memory else None, law, columns, boundary, i0, run)


def _await_contacts(folder: Path, grains: str, where: Path) -> bool:
    """Return True if there is a dump of contacts; wait for it while LAMMPS writes its first frame."""
    start = time.monotonic()
    while not (there := has_dumps(where.parent, CONTACTS, where.name)):
        changes = [path.stat().st_mtime for path in folder.iterdir() if path.is_file()]
        fresh = time.time() - max(changes, default=0.0) < FRESH
        complete = any(dump.frames for dump in find_dumps(folder, {}, grains).values())
        if not fresh or (complete and time.monotonic() - start > FRESH):
            break
        time.sleep(INTERVAL / 4)
    return there


def _require_dumps(folder: Path, pattern: str, kind: str) -> None:
    """Raise PackingError if no file in the folder is, or may become, a dump of this kind."""
    if has_dumps(folder, kind, pattern):
        return
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if "dump" in path.name and path.is_file() and _head(path).startswith(COMPRESSED):
            raise PackingError(f"{path} is compressed: decompress it, or have LAMMPS write text")
    if kind == CONTACTS:
        raise PackingError(f"{folder / pattern} is not a text file of contacts from `dump local` in LAMMPS: {NEEDS}")
    empty = not any(folder.iterdir())
    what = "is empty" if empty else "has no LAMMPS text dump of grains"
    raise PackingError(f"{folder if pattern == '*' else folder / pattern} {what}: {NEEDS}")


def look(source: Source, before: Look | None = None) -> Look:
    """Search the folder again; frames found `before` are not read again."""
    dumps = find_dumps(source.folder, before.dumps if before else {}, source.grains)
    grains, notes = frames_of(dumps, GRAINS)
    if source.contacts is None:
        return Look(dumps, {}, [Pair(frame, None) for frame in grains.values()], (), (), tuple(notes))
    folder, pattern = source.contacts.parent, source.contacts.name
    same = (folder, pattern) == (source.folder, source.grains)
    local = dumps if same else find_dumps(folder, before.local if before else {}, pattern)
    contacts, more = frames_of(local, CONTACTS)
    last = max(contacts, default=-1)
    alone = [step for step in grains if step not in contacts]
    return Look(
        dumps, local, [Pair(frame, contacts[step]) for step, frame in grains.items() if step in contacts],
        tuple(step for step in alone if step > last), tuple(step for step in alone if step < last),
        tuple(dict.fromkeys((*notes, *more))),
    )  # fmt: skip


def missing_frames(seen: Look) -> list[str]:
    """Notes on missing data if nothing more will be written."""
    cut = [path.name for path, dump in (seen.dumps | seen.local).items() if dump.partial]
    notes = [f"{name} ends in the middle of a frame, which is left out" for name in cut]
    for steps, state in ((seen.waiting, "not yet written"), (seen.lost, "not in the dumps")):
        if steps:
            some = ", ".join(map(str, steps[:6])) + (" …" if len(steps) > 6 else "")
            notes.append(f"left out because their contacts are {state}: step {some}")
    return notes


def read_pair(source: Source, pair: Pair) -> tuple[State, list[str]]:
    """Accepted state of a frame, and notes.

    Raises
    ------
    PackingError
        If the frame cannot be used.
    """
    table, contacts = read_content(pair.grains), pair.contacts
    local = None if contacts is None else read_content(contacts)
    if local is not None and table.periodic is None:
        table = table._replace(periodic=local.periodic)
    packing, run = packing_from_table(table, pair.grains.path, source.boundary), source.run
    if run is not None:
        if run.setting is not None and run.ids is not None and not np.array_equal(packing.ids, run.ids):
            raise PackingError(
                "its grains are not those of the newest packing of the run, which defines walls and loads: give --law"
            )
        known = [] if run.setting is None else notes_about(packing.notes, WALLS)
        acts = [note for note in run.notes if isinstance(note, Obstacle)]
        notes = dict.fromkeys([*(note for note in packing.notes if note not in known), *acts])
        packing = packing._replace(setting=run.setting, notes=[*notes])
    pairs = None if local is None else pairs_from_table(local, contacts.path, packing, source.columns)
    (state, more), said = capture_warnings(build_state, packing, pairs, source.law)
    return with_inertia(state, source.i0), [*with_one_account([*packing.notes, *more]), *said]


@checked
def follow_packings(
    place: str | Path, *, until_idle: float = 10.0, memory: bool = True, interval: Positive = INTERVAL, **options
) -> Iterator[tuple[str, State, Law, list[str]]]:
    """Read the frames of a running LAMMPS simulation as they become complete, in the order of their steps.

    Parameters
    ----------
    place : folder into which LAMMPS writes its dumps as text, in one growing file or one file for each frame; or one
        dump in it
    until_idle : stop when nothing has been written for this time [s]; with 0, only existing frames are read
    memory : whether dumps of contacts are used; with False, or without such dumps, slip is zero
    interval : time between two searches of the folder [s]
    options : those of `read_packing` for LAMMPS dumps; `contacts` may be a pattern such as contacts.*.dump

    Yields
    ------
    name, state, law and notes of each frame, as from `read_packings`

    Raises
    ------
    PackingError
        If there are no dumps, or a frame cannot be used.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> text = "ITEM: TIMESTEP\\n7\\nITEM: NUMBER OF ATOMS\\n2\\n"
    >>> text += "ITEM: BOX BOUNDS pp pp pp\\n0 3\\n0 3\\n0 3\\n"
    >>> text += "ITEM: ATOMS id x y z radius mass\\n1 1 1 1 0.5 1\\n2 1.99 1 1 0.5 1\\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "grains.dump").write_text(text)
    ...     frames = follow_packings(folder, until_idle=0.0, law="linear", mu=0.5)
    ...     [name for name, *_ in frames]
    ['7']
    """
    source, seen, known, last = open_source(place, memory=memory, **options), None, {}, time.monotonic()
    while True:
        before, seen = seen, look(source, seen)
        last = time.monotonic() if before is None or before.sizes != seen.sizes else last
        for pair in seen.ready:
            step, digest = pair.grains.step, pair.grains.digest
            if known.get(step) != digest:
                known[step] = digest
                state, notes = read_pair(source, pair)
                yield str(step), state, source.law, notes
        if time.monotonic() - last >= until_idle:
            return
        time.sleep(interval)
