"""Packings of a running simulation: what its folder of LAMMPS dumps offers, and frames as they become complete."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from ...core.arguments import checked, require_positive
from ...core.laws.builtin import Law
from ...core.state import State
from ..sample import Account, MemoryNote, PackingError
from .content import Packing
from .files import capture_warnings, chosen_law, lammps_law, law_from_file, with_inertia
from .lammps_folder import read_folder
from .lammps_series import (
    CONTACTS,
    GRAINS,
    Dump,
    DumpFrame,
    find_compressed,
    find_dumps,
    frames_of,
    has_dumps,
    read_frame,
)

INTERVAL = 1.0  # time between two looks at the folder [s]
FRESH = 3.0  # time after which a file that has not changed is not being written [s]
NEEDS = "`stickslip docs lammps` shows what LAMMPS must write"


class Source(NamedTuple):
    """Place of the dumps, and options for reading them."""

    folder: Path
    grains: str  # pattern of the names of dumps of grains
    contacts: Path | None  # folder and pattern of dumps of contacts; None without memory
    law: Law
    columns: str | None
    boundary: str | None
    i0: float | None
    run: Packing | None = None  # packing of the folder whose law, walls and loads the frames have


class Pair(NamedTuple):
    """A frame of grains, and that of their contacts."""

    grains: DumpFrame
    contacts: DumpFrame | None


class Look(NamedTuple):
    """Contents of the folder at one time."""

    dumps: dict[Path, Dump]  # of grains
    local: dict[Path, Dump]  # of contacts
    ready: list[Pair]  # complete frames, by step
    waiting: tuple[int, ...]  # steps whose contacts may still be written
    lost: tuple[int, ...]  # steps without contacts, although later ones have them
    notes: tuple[str, ...]

    @property
    def sizes(self) -> dict[Path, tuple[int, int]]:
        """Size and time of change of every file: they differ if the simulation has written."""
        return {path: (dump.size, dump.modified) for path, dump in (self.dumps | self.local).items()}


def open_source(place: str | Path, *, memory: bool = True, **options) -> Source:
    """Check a folder of dumps, or one dump, and the options for reading it.

    Parameters
    ----------
    memory : whether dumps of contacts are used: those named by `contacts`, or those in the folder
    options : those of `read_packing` for LAMMPS dumps. `contacts` may be a pattern such as contacts.*.dump. Without a
        law, that of the log or the script in the folder is taken, with walls, loads and what holds grains

    Raises
    ------
    PackingError
        if there are no dumps or an option is missing; the message is one sentence.
    """
    given = {name: value for name, value in options.items() if value is not None}
    if "frame" in given:
        raise PackingError("--frame was given, but all frames are read: leave it out, or use stickslip stability")
    if "atom_style" in given:
        raise PackingError("--atom-style was given, but dumps name their columns: leave it out")
    folder, grains = _place(Path(place))
    contacts, columns, boundary, i0 = (given.pop(name, None) for name in ("contacts", "columns", "boundary", "i0"))
    if not memory and (contacts or columns):
        raise PackingError(f"--no-contacts was given with --{'contacts' if contacts else 'columns'}: leave one out")
    _require_dumps(folder, grains, GRAINS)
    path = Path(contacts or "*")
    where = folder / path if path.parent == Path() else path
    given, own = law_from_file(given)
    memory = memory and (_await_contacts(folder, grains, where) or contacts is not None)
    run = _run_in(folder) if own is None and "law" not in given and Path(place).is_dir() else None
    if own is None and "law" not in given and (run is None or run.law is None):
        raise PackingError(
            "LAMMPS dumps contain no contact law: give --law and its parameters, --kn, --kt and --mu, as in the "
            "pair_style, or the folder with log.lammps or the input script"
        )
    law = own or (chosen_law(run, given, None, memory=memory) if run else lammps_law(given, memory=memory))
    if memory:
        _require_dumps(where.parent, where.name, CONTACTS)
    return Source(folder, grains, where if memory else None, law, columns, boundary, i0, run)


def _run_in(folder: Path) -> Packing | None:
    """Newest packing of a run of LAMMPS, with the law of its commands; None if there is none yet."""
    try:
        return read_folder(folder)[0]
    except PackingError:
        return None


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


def _place(place: Path) -> tuple[Path, str]:
    """Folder, and pattern of the names of its dumps of grains."""
    if place.is_file():
        return place.parent, place.name
    if not place.is_dir():
        raise PackingError(f"{place} does not exist: give the folder into which LAMMPS writes its dumps")
    return place, "*"


def _require_dumps(folder: Path, pattern: str, kind: str) -> None:
    """Raise PackingError if no file of the folder is, or may become, a dump of a kind."""
    if has_dumps(folder, kind, pattern):
        return
    if folder.is_dir() and (packed := find_compressed(folder)):
        raise PackingError(f"{packed} is compressed: decompress it, or have LAMMPS write text")
    if kind == CONTACTS:
        raise PackingError(f"{folder / pattern} is no `dump local` with contacts that LAMMPS wrote as text: {NEEDS}")
    empty = not any(folder.iterdir())
    what = "is empty" if empty else "has no dump of grains that LAMMPS wrote as text"
    raise PackingError(f"{folder if pattern == '*' else folder / pattern} {what}: {NEEDS}")


def look(source: Source, before: Look | None = None) -> Look:
    """Look into the folder again; frames found `before` are not read again."""
    dumps = find_dumps(source.folder, before.dumps if before else {}, source.grains)
    grains, notes = frames_of(dumps, GRAINS)
    if source.contacts is None:
        return Look(dumps, {}, [Pair(frame, None) for frame in grains.values()], (), (), (*_damage(dumps), *notes))
    folder, pattern = source.contacts.parent, source.contacts.name
    same = (folder, pattern) == (source.folder, source.grains)
    local = dumps if same else find_dumps(folder, before.local if before else {}, pattern)
    contacts, more = frames_of(local, CONTACTS)
    last = max(contacts, default=-1)
    alone = [step for step in grains if step not in contacts]
    return Look(
        dumps, local, [Pair(frame, contacts[step]) for step, frame in grains.items() if step in contacts],
        tuple(step for step in alone if step > last), tuple(step for step in alone if step < last),
        tuple(dict.fromkeys((*_damage(dumps), *_damage(local), *notes, *more))),
    )  # fmt: skip


def _damage(dumps: dict[Path, Dump]) -> list[str]:
    return [frame.problem for dump in dumps.values() for frame in dump.frames if frame.problem]


def missing_frames(seen: Look) -> list[str]:
    """Notes on what is missing if nothing more will be written."""
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
        if the frame cannot be used; the message is one sentence.
    """
    how = {"columns": source.columns, "boundary": source.boundary, "run": source.run}
    (state, notes), said = capture_warnings(read_frame, pair.grains, pair.contacts, source.law, **how)
    return with_inertia(state, source.i0), [*notes, *said]


def remarks(notes: list[str]) -> list[str]:
    """Notes that are neither on the memory of contacts nor on what acts on grains, which hold for every frame."""
    return [note for note in notes if not isinstance(note, MemoryNote | Account)]


@checked
def follow_packings(
    place: str | Path, *, until_idle: float = 10.0, memory: bool = True, interval: float = INTERVAL, **options
) -> Iterator[tuple[str, State, Law, list[str]]]:
    """Read the frames of a running LAMMPS simulation as they become complete, in the order of their steps.

    Parameters
    ----------
    place : folder into which LAMMPS writes its dumps as text, in one growing file or one file for each frame; or one
        dump in it
    until_idle : end when nothing has been written for this time [s]; with 0, only frames that are there are read
    memory : whether dumps of contacts are used; with False, or without such dumps, no contact has slipped
    interval : time between two looks at the folder [s]
    options : those of `read_packing` for LAMMPS dumps; `contacts` may be a pattern such as contacts.*.dump

    Yields
    ------
    name, state, law and notes of each frame, as from `read_packings`

    Raises
    ------
    PackingError
        if there are no dumps, or a frame cannot be used; the message is one sentence.

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
    require_positive(interval=interval)
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
