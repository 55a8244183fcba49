"""Pieces of a run that is not finished: archives in a folder, each whole, so that who was killed goes on where it was.

A piece knows the scenario that it belongs to, and is taken for no other. When a run has written its results, its pieces
go away.
"""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from .. import __version__
from . import archive
from .atomic import replace

# a folder and two files beside the results to come, and the folder of a sweep's members
UNFINISHED, SCENARIO, SWEEP, MEMBERS = "unfinished", "scenario.json", "sweep.json", "members"
# folders for a while: of results that are being written, of a sweep that replaces another, of pieces that go away
WRITING, ANEW, GONE = ".writing", ".anew", f".{UNFINISHED}"
_NOTE, _PART = "scenario-", "part-"  # and a digest: scenario of the run whose pieces these are, and of parts of it


class Kept(NamedTuple):
    """Where a run keeps its pieces, and one of its parts keeps its own."""

    run: Path  # folder of the run
    scenario: str  # canonical text
    nouns: tuple[type, ...] = ()  # classes of NamedTuples and enums that its pieces hold
    part: str = "."
    si: bool = False  # whether units are SI

    def of(self, part: str, *nouns: type) -> "Kept":
        """A place of its own for one of several parts."""
        return self._replace(part=f"{self.part}/{part}", nouns=nouns or self.nouns)

    @property
    def folder(self) -> Path:
        """Where the pieces are."""
        return self.run / UNFINISHED / self.part

    @property
    def names(self) -> list[str]:
        """Of the pieces that are there, in order."""
        return sorted(path.stem for path in self.folder.glob("*.h5") if not path.name.startswith("."))

    def has(self, name: str) -> bool:
        """Whether a piece is there."""
        return self._path(name).is_file()

    def announce(self) -> None:
        """Write the scenario, with which the run can be gone on with and other processes find its folder.

        Where results of an earlier run stand, theirs stays beside them.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        if (
            not self._noted
        ):  # a reproduction runs several scenarios: the first stands for the run, others for parts of it
            replace(self._part_note if under_way(self.run) else self._note, self.scenario.encode())
        if not (self.run / SCENARIO).exists():
            replace(self.run / SCENARIO, self.scenario.encode())

    def seen(self) -> "Kept | None":
        """The same, if this process sees the run's folder; a worker on another machine may not."""
        return self if self._noted else None

    def check(self) -> None:
        """Raise ArchiveError if a piece of this part, or of parts of it, cannot be used."""
        for path in sorted(self.folder.rglob("*.h5")):
            inside = path.relative_to(self.folder)
            if not path.name.startswith(".") and UNFINISHED not in inside.parts:
                self._check(path)

    @property
    def _note(self) -> Path:
        return self.run / UNFINISHED / f"{_NOTE}{self._digest}.json"

    @property
    def _part_note(self) -> Path:
        return self.run / UNFINISHED / f"{_PART}{self._digest}.json"

    @property
    def _noted(self) -> bool:
        return self._note.is_file() or self._part_note.is_file()

    @property
    def _digest(self) -> str:
        return hashlib.sha256(self.scenario.encode()).hexdigest()[:16]

    def save(self, name: str, value: Any) -> None:
        """Write a piece, all or nothing; from here on it is there whatever happens to this process."""
        self.announce()
        told = {"name": f"{self.part}/{name}", "piece": value}
        archive.write(self._path(name), told, scenario=self.scenario, version=__version__, si=self.si)

    def load(self, name: str) -> Any:
        """A piece.

        Raises
        ------
        ArchiveError
            with one sentence, if it is damaged, belongs to another scenario or version, or is another piece.
        """
        path = self._path(name)
        self._check(path)
        found = archive.read(path, nouns=self.nouns)
        if found.get("name") != f"{self.part}/{name}":
            raise archive.ArchiveError(f"{path} is the piece {found.get('name')}: give files their names back")
        return found["piece"]

    def _check(self, path: Path) -> None:
        about = archive.attributes(path)
        if about["scenario"] != self.scenario:
            raise archive.ArchiveError(
                f"{path} was computed for another scenario than the folder's, perhaps with another law: put that one "
                f"back, or run the new one with --overwrite"
            )
        if about["stickslip"] != __version__:
            raise archive.ArchiveError(
                f"{path} was computed by stickslip {about['stickslip']}, and this is {__version__}, whose numbers may "
                f"differ: go on with that version, or begin again with --overwrite"
            )

    def clear(self) -> None:
        """Remove all pieces of this part."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.h5"


def under_way(folder: Path) -> Path | None:
    """The scenario of the run that was begun in a folder and is not finished."""
    notes = sorted((folder / UNFINISHED).glob(f"{_NOTE}*.json"))
    if len(notes) > 1 and (folder / SCENARIO).is_file():  # versions before 0.2 gave parts the same kind of note
        first = (folder / SCENARIO).read_bytes()
        notes = [path for path in notes if path.read_bytes() == first] or notes
    return notes[0] if notes else None


def kept_in(folder: Path | None, scenario, *nouns: type) -> Kept | None:
    """Where the run of a scenario in a folder keeps its pieces; None without a folder."""
    return Kept(folder, scenario.text, nouns, si=scenario.si) if folder else None


def piece(kept: Kept | None, name: str, make: Callable[[], Any]) -> Any:
    """A piece that is there, else one that is made and kept."""
    if kept is None:
        return make()
    if not kept.has(name):
        kept.save(name, make())
    return kept.load(name)


def hooks(kept: Kept | None, names: list[str]) -> dict[str, Callable]:
    """`load` and `save` of `run_members`, for members of these names."""
    if kept is None:
        return {}
    kept.check()
    kept.announce()
    return {
        "load": lambda k: kept.load(names[k]) if kept.has(names[k]) else None,
        "save": lambda k, result: kept.save(names[k], result),
    }


def finished(folder: Path) -> None:
    """Remove the pieces of a run that has written its results."""
    gone = folder / GONE  # renamed first: a kill must not leave some of them
    shutil.rmtree(gone, ignore_errors=True)
    if (folder / UNFINISHED).is_dir():
        (folder / UNFINISHED).rename(gone)
    shutil.rmtree(gone, ignore_errors=True)
