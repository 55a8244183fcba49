"""Checkpoints of an unfinished run: a folder of archives ("pieces"), from which a run that was killed can be resumed.

Every piece contains the scenario that it belongs to, and is never used for another one. The pieces are removed when the
run has written its results.
"""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from .. import __version__
from ..core.units import Units
from . import archive
from .atomic import write_atomically

# a folder and two files in the folder of the results, and the folders of a sweep's members and of legs for LAMMPS
UNFINISHED, SCENARIO, SWEEP, MEMBERS, LEGS = "unfinished", "scenario.json", "sweep.json", "members", "lammps"
# temporary folders: results being written, a sweep that replaces another, pieces being removed
WRITING, ANEW, GONE = ".writing", ".anew", f".{UNFINISHED}"
_NOTE, _PART = "scenario-", "part-"  # followed by a digest: scenario of the run, and of its parts


class Checkpoint(NamedTuple):
    """Location of the pieces of a run, or of one of its parts."""

    run: Path  # folder of the run
    scenario: str  # canonical text
    nouns: tuple[type, ...] = ()  # classes of the NamedTuples and enums in its pieces
    part: str = "."
    units: Units | None = None  # None if they are not named

    def of(self, part: str, *nouns: type) -> "Checkpoint":
        """Location of the pieces of one of several parts."""
        return self._replace(part=f"{self.part}/{part}", nouns=nouns or self.nouns)

    @property
    def folder(self) -> Path:
        """Folder of the pieces."""
        return self.run / UNFINISHED / self.part

    @property
    def names(self) -> list[str]:
        """Names of the existing pieces, sorted."""
        return sorted(path.stem for path in self.folder.glob("*.h5") if not path.name.startswith("."))

    def has(self, name: str) -> bool:
        """Return True if a piece exists."""
        return self._path(name).is_file()

    def announce(self) -> None:
        """Write the scenario, so that the run can be resumed and other processes can find its folder.

        The scenario of an earlier run is kept with its results.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        # a reproduction runs several scenarios: the first is that of the run, the others are those of its parts
        if not self._has_note:
            write_atomically(self._part_note if unfinished_scenario(self.run) else self._note, self.scenario.encode())
        if not (self.run / SCENARIO).exists():
            write_atomically(self.run / SCENARIO, self.scenario.encode())

    def if_visible(self) -> "Checkpoint | None":
        """Return self if this process can see the run's folder, else None (as for a worker on another machine)."""
        return self if self._has_note else None

    def check(self) -> None:
        """Raise ArchiveError if a piece of this part, or of its own parts, cannot be used."""
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
    def _has_note(self) -> bool:
        return self._note.is_file() or self._part_note.is_file()

    @property
    def _digest(self) -> str:
        return hashlib.sha256(self.scenario.encode()).hexdigest()[:16]

    def save(self, name: str, value: Any) -> None:
        """Write a piece, all or nothing; it survives whatever happens to this process."""
        self.announce()
        content = {"name": f"{self.part}/{name}", "piece": value}
        archive.write(self._path(name), content, scenario=self.scenario, version=__version__, units=self.units)

    def load(self, name: str) -> Any:
        """Read a piece.

        Raises
        ------
        ArchiveError
            if the piece is damaged, belongs to another scenario or version, or is not the one requested.
        """
        path = self._path(name)
        self._check(path)
        found = archive.read(path, nouns=self.nouns)
        if found.get("name") != f"{self.part}/{name}":
            raise archive.ArchiveError(f"{path} contains piece {found.get('name')}: restore the original file names")
        return found["piece"]

    def _check(self, path: Path) -> None:
        about = archive.attributes(path)
        if about["scenario"] != self.scenario:
            raise archive.ArchiveError(
                f"{path} was computed for a scenario other than the folder's, perhaps with another law: restore that "
                f"scenario, or run the new one with --overwrite"
            )
        if about["stickslip"] != __version__:
            raise archive.ArchiveError(
                f"{path} was computed by stickslip {about['stickslip']}, and this is {__version__}, whose numbers may "
                f"differ: resume with that version, or start again with --overwrite"
            )

    def clear(self) -> None:
        """Remove all pieces of this part."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.h5"


def unfinished_scenario(folder: Path) -> Path | None:
    """Path of the scenario of the unfinished run in a folder, or None."""
    notes = sorted((folder / UNFINISHED).glob(f"{_NOTE}*.json"))
    if len(notes) > 1 and (folder / SCENARIO).is_file():  # versions before 0.2 named the notes of parts in this way
        first = (folder / SCENARIO).read_bytes()
        notes = [path for path in notes if path.read_bytes() == first] or notes
    return notes[0] if notes else None


def is_worth_resuming(folder: Path) -> bool:
    """Return True if any part of an unfinished run or sweep has been saved in its folder."""
    saved = (path for place in (UNFINISHED, MEMBERS) for path in (folder / place).rglob("*.h5"))
    return any(not path.name.startswith(".") for path in saved)


def checkpoint_in(folder: Path | None, scenario, *nouns: type) -> Checkpoint | None:
    """Location of the pieces of a scenario that is run in a folder; None without a folder."""
    return Checkpoint(folder, scenario.text, nouns, units=scenario.named_units) if folder else None


def load_or_compute(kept: Checkpoint | None, name: str, make: Callable[[], Any]) -> Any:
    """Load a piece if it exists, otherwise compute and save it."""
    if kept is None:
        return make()
    if not kept.has(name):
        kept.save(name, make())
    return kept.load(name)


def abandon(kept: Checkpoint) -> None:
    """Remove what a run saved before its input proved to be wrong; results of an earlier run remain."""
    remove_checkpoint(kept.run)
    if all(path.name == SCENARIO or path.name.startswith(".") for path in kept.run.iterdir()):
        (kept.run / SCENARIO).unlink(missing_ok=True)


def remove_checkpoint(folder: Path) -> None:
    """Remove the pieces of a run that has written its results."""
    gone = folder / GONE  # renamed first, so that a kill cannot leave only some of them
    shutil.rmtree(gone, ignore_errors=True)
    if (folder / UNFINISHED).is_dir():
        (folder / UNFINISHED).rename(gone)
    shutil.rmtree(gone, ignore_errors=True)
