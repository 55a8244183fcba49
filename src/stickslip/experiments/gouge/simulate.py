"""Simulation of gouge experiments in parallel processes; finished realizations are saved and not run again."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ... import __version__
from ...core.readable import readable
from ...data import archive
from ...data.checkpoint import Checkpoint, checkpoint_in
from ...ensemble import Workers, run_members
from .dimensionless import Range
from .protocol import (
    STICKSLIP,
    Branch,
    Engine,
    Realization,
    Series,
    Tell,
    Test,
    Trunk,
    make_realization,
    run_branch,
    run_trunk,
)
from .scenario import GougeScenario

MEMBERS = "realizations"  # folder next to the results
TRUNK, LEGS = "trunk", "legs"  # names of pieces of an unfinished realization
Report = Callable[[str, float, str], None]


@readable
class GougeResult(NamedTuple):
    """All realizations of a scenario."""

    scenario: GougeScenario
    realizations: tuple[Realization, ...]
    failures: tuple[str, ...]  # one sentence for each failed realization
    reused: int  # number of realizations that had been finished before


def simulate_gouge(
    scenario: GougeScenario,
    *,
    folder: Path | None = None,
    workers: Workers = None,
    report: Report = lambda stage, share, words: None,
) -> GougeResult:
    """Run all realizations of a scenario.

    Parameters
    ----------
    folder : run folder, in which realizations are saved as soon as they finish, together with pieces of unfinished
        ones; saved parts are not run again
    workers : number of processes, or the address of a Dask scheduler
    report : called as report(stage, share done, words)

    Raises
    ------
    RuntimeError
        If the engine is not installed, or if every realization failed.
    ArchiveError
        If a file of a finished realization is damaged, or was written by another version.
    """
    find_engine(scenario)
    seeds = range(scenario.seed, scenario.seed + scenario.realizations)
    alone = [scenario.model_copy(update={"realizations": 1, "seed": seed}) for seed in seeds]
    found = [_read_realization(_realization_path(one, folder)) for one in alone]
    missing = [k for k, one in enumerate(found) if one is None]
    failures = {}
    if missing:
        ensemble = _Ensemble(scenario, [alone[k] for k in missing], folder, workers, report)
        for k, one in zip(missing, ensemble.run(), strict=True):
            found[k], failures[seeds[k]] = (None, one) if isinstance(one, str) else (one, "")
    sentences = tuple(f"realization {seed} failed: {words}" for seed, words in failures.items() if words)
    done = tuple(one for one in found if one is not None)
    if not done:
        raise RuntimeError(f"no realization succeeded; {sentences[0]}")
    return GougeResult(scenario, done, sentences, len(alone) - len(missing))


class _Ensemble:
    """Run unfinished realizations: all their trunks in parallel, then all branches of these."""

    def __init__(self, scenario: GougeScenario, alone: list, folder: Path | None, workers: Workers, report: Report):
        self.scenario, self.alone, self.folder, self.workers, self.report = scenario, alone, folder, workers, report
        self.kept = checkpoint_in(folder, scenario)
        self.first = scenario.trunk_duration / scenario.duration  # share of the work done by the trunks
        if self.kept:
            for one in alone:
                self.kept.of(one.digest).check()
            self.kept.announce()

    def run(self) -> list[Realization | str]:
        """Return each realization, or one sentence with the reason why it failed."""
        before = self.scenario.realizations - len(self.alone)
        more = f"; {before} were finished before" if before else ""
        self._report_progress(0.0, f"each takes {self.scenario.expected_cost}{more}")
        trunks = self._run_trunks()
        owners = [k for k, stem in enumerate(trunks) if stem.failure is None for _ in stem.result.branches]
        starts = [start for stem in trunks if stem.failure is None for start in stem.result.branches]
        members = self._run_branches(owners, starts)
        out = []
        for k, (one, stem) in enumerate(zip(self.alone, trunks, strict=True)):
            mine = [member for owner, member in zip(owners, members, strict=True) if owner == k]
            wrong = next((member.failure for member in (stem, *mine) if member.failure), None)
            if wrong:
                out.append(re.sub(r"^[A-Z][A-Za-z]+: ", "", wrong))
                continue
            out.append(make_realization(one, one.seed, stem.result, [member.result for member in mine]))
            self._save(one, out[-1])
        return out

    def _run_trunks(self):
        """Run the trunk of every realization."""
        nouns = (Trunk, Branch, Test, Series, *find_engine(self.scenario).nouns, *STICKSLIP.nouns)
        places = [self.kept and self.kept.of(one.digest, *nouns) for one in self.alone]

        def save(k, result):
            if places[k]:
                places[k].save(TRUNK, result)
                places[k].of(LEGS).clear()

        return run_members(
            _trunk_task,
            [(one.text, place and place.of(LEGS)) for one, place in zip(self.alone, places, strict=True)],
            workers=self.workers,
            live=lambda share, words: self._report_progress(self.first * share, words),
            load=lambda k: places[k].load(TRUNK) if places[k] and places[k].has(TRUNK) else None,
            save=save,
        )

    def _run_branches(self, owners: list[int], starts: list[Branch]):
        """Run the tests of every branch of every trunk."""
        names = [f"branch-{start.part:02d}-{start.before:.6g}-{start.number:03d}" for start in starts]
        places = [self.kept and self.kept.of(self.alone[k].digest, Test, Series) for k in owners]

        def save(k, result):
            if places[k]:
                places[k].save(names[k], result)
                places[k].of(names[k]).clear()

        return run_members(
            _branch_task,
            [
                (self.alone[k].text, start, place and place.of(name))
                for k, start, place, name in zip(owners, starts, places, names, strict=True)
            ],
            workers=self.workers,
            live=lambda share, words: self._report_progress(self.first + (1 - self.first) * share, words),
            load=lambda k: places[k].load(names[k]) if places[k] and places[k].has(names[k]) else None,
            save=save,
        )

    def _save(self, one: GougeScenario, result: Realization) -> None:
        if self.folder:
            path = _realization_path(one, self.folder)
            path.parent.mkdir(parents=True, exist_ok=True)
            archive.write(path, {"realization": result}, scenario=one.text, version=__version__)
            self.kept.of(one.digest).clear()

    def _report_progress(self, share: float, words: str) -> None:
        self.report(f"realizations ({len(self.alone)} to run)", share, words)


def find_engine(scenario: GougeScenario) -> Engine:
    """Return the engine that a scenario names.

    Raises
    ------
    RuntimeError
        If it is not installed. The message says how to install it.
    """
    if scenario.engine == "stickslip":
        return STICKSLIP
    from .lammps import engine

    return engine()


def _trunk_task(text: str, kept: Checkpoint | None, tell: Tell) -> Trunk:
    """Run one trunk, possibly in a worker process."""
    one = GougeScenario.model_validate_json(text)
    return run_trunk(one, one.seed, find_engine(one), tell, kept and kept.seen())


def _branch_task(text: str, start: Branch, kept: Checkpoint | None, tell: Tell) -> tuple[Test, ...]:
    """Run one branch, possibly in a worker process."""
    one = GougeScenario.model_validate_json(text)
    return run_branch(one, start, find_engine(one), tell, kept and kept.seen())


def _realization_path(one: GougeScenario, folder: Path | None) -> Path | None:
    """Path of a saved realization, named by the digest of its scenario so that no other scenario uses it."""
    return folder / MEMBERS / f"{one.digest}.h5" if folder else None


def _read_realization(path: Path | None) -> Realization | None:
    """Read a realization that was finished before; None if there is none."""
    if path is None or not path.exists():
        return None
    if (version := archive.attributes(path)["stickslip"]) != __version__:
        raise archive.ArchiveError(
            f"{path} was computed by stickslip {version}, but this is version {__version__}, whose numbers may differ: "
            f"move the file away to compute it again"
        )
    return archive.read(path, nouns=(Realization, Range, Test, Series))["realization"]
