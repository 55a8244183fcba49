"""Simulation of gouge experiments in parallel processes; finished realizations are saved and not run again."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from .... import __version__
from ....core.dynamics.batch import Device
from ....core.dynamics.engine import Engine
from ....core.dynamics.run import own_engine
from ....data import archive
from ....kit import (
    Checkpoint,
    Realizations,
    Report,
    Task,
    Workers,
    checked,
    checkpoint_in,
    open_device,
    result_of,
    run_realizations,
    silent,
    within,
)
from . import EXPERIMENT
from .dimensionless import Range
from .protocol import TRUNK, Branch, Realization, Series, Test, Trunk, make_realization, run_branch, run_trunk
from .sample import Gouge, gouge_law
from .samples import check_folder, read_sample, sample_path, write_sample
from .scenario import GougeScenario

MEMBERS = "realizations"  # folder next to the results


@result_of(EXPERIMENT)
class GougeResult(NamedTuple):
    """All realizations of a scenario."""

    scenario: GougeScenario
    realizations: tuple[Realization, ...]
    failures: tuple[str, ...]  # one sentence for each failed realization
    reused: int  # number of realizations that had been finished before


@checked
def simulate_gouge(
    scenario: GougeScenario,
    *,
    folder: Path | None = None,
    workers: Workers = None,
    device: str | None = None,
    samples: Path | None = None,
    report: Report = silent,
) -> GougeResult:
    """Run all realizations of a scenario.

    Parameters
    ----------
    folder : run folder, in which realizations are saved as soon as they finish, together with pieces of unfinished
        ones; saved parts are not run again
    workers : number of processes, or the address of a Dask scheduler; by default, as many as there are cores, over the
        number of MPI ranks of each
    device : "cuda": run all realizations, and then all branches, side by side on a graphics processor
    samples : folder to which each sample is written when it has finished; those that it contains are not run
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If the device cannot run this scenario, or if the folder of samples cannot be written.
    MissingExtraError
        If CuPy is missing.
    RuntimeError
        If there is no such device, if the engine is not installed, or if every realization failed.
    ArchiveError
        If a file of a finished realization is damaged, or was written by another version.
    """
    if samples:
        check_folder(samples)
    where = _open_device(device, scenario) if device else find_engine(scenario, folder) and None
    if workers is None and scenario.ranks > 1:
        workers = max(1, (os.cpu_count() or 1) // scenario.ranks)  # each of them starts so many MPI processes
    seeds = range(scenario.seed, scenario.seed + scenario.realizations)
    alone = [scenario.model_copy(update={"realizations": 1, "seed": seed}) for seed in seeds]
    realizations = [_find_realization(member, folder, samples) for member in alone]
    missing = [k for k, member in enumerate(realizations) if member is None]
    failures = {}
    if missing:
        ensemble = _Ensemble(scenario, [alone[k] for k in missing], folder, samples, workers, where, report)
        for k, member in zip(missing, ensemble.run(), strict=True):
            realizations[k], failures[seeds[k]] = (None, member) if isinstance(member, str) else (member, "")
    sentences = tuple(f"realization {seed} failed: {failure}" for seed, failure in failures.items() if failure)
    done = tuple(member for member in realizations if member is not None)
    if not done:
        raise RuntimeError(f"every realization failed, the first with {sentences[0]}")
    return GougeResult(scenario, done, sentences, len(alone) - len(missing))


class _Ensemble:
    """Run unfinished realizations: all their trunks in parallel, then all branches of the trunks."""

    def __init__(
        self,
        scenario: GougeScenario,
        alone: list,
        folder: Path | None,
        samples: Path | None,
        workers: Workers,
        device: Device | None,
        report: Report,
    ):
        self.scenario, self.alone, self.folder, self.samples = scenario, alone, folder, samples
        self.workers, self.device, self.report = workers, device, report
        self.kept = checkpoint_in(folder, scenario)
        self.first = scenario.trunk_duration / scenario.duration  # share of the work done by the trunks
        if self.kept:
            for member in alone:
                self.kept.of(member.digest).check()
            self.kept.announce()

    def run(self) -> list[Realization | str]:
        """Return each realization, or one sentence that says why it failed."""
        before = self.scenario.realizations - len(self.alone)
        more = f"; {before} had finished earlier" if before else ""
        cost = f"each takes {self.scenario.expected_cost}{more}"
        self.report(f"realizations ({len(self.alone)} to run)", 0.0, cost)
        trunks = self._run_trunks()
        owners = [k for k, trunk in enumerate(trunks.results) if trunk for _ in trunk.branches]
        starts = [start for trunk in trunks.results if trunk for start in trunk.branches]
        tests = self._run_branches(owners, starts)
        out = []
        for k, (member, trunk) in enumerate(zip(self.alone, trunks.results, strict=True)):
            mine = [b for b, owner in enumerate(owners) if owner == k]
            if wrong := next(filter(None, [trunks.reasons[k], *(tests.reasons[b] for b in mine)]), None):
                out.append(wrong)
                continue
            out.append(make_realization(member, member.seed, trunk, [tests.results[b] for b in mine]))
            self._save(member, out[-1])
        return out

    def _run_trunks(self) -> Realizations:
        """Run the trunk of every realization."""
        nouns = (Trunk, Branch, Test, Series, Gouge)
        places = [self.kept and self.kept.of(member.digest, *nouns) for member in self.alone]
        tasks = [
            Task(f"trunk {member.seed}", (member.text, place and place.of(TRUNK)), TRUNK, place)
            for member, place in zip(self.alone, places, strict=True)
        ]
        return self._run(_trunk_task, tasks, 0.0, self.first)

    def _run_branches(self, owners: list[int], starts: list[Branch]) -> Realizations:
        """Run the tests of every branch of every trunk."""
        names = [f"branch-{start.part:02d}-{start.before:.6g}-{start.number:03d}" for start in starts]
        places = [self.kept and self.kept.of(self.alone[k].digest, Test, Series) for k in owners]
        tasks = [
            Task(name, (self.alone[k].text, start, place and place.of(name)), name, place)
            for k, start, place, name in zip(owners, starts, places, names, strict=True)
        ]
        return self._run(_branch_task, tasks, self.first, 1.0)

    def _run(self, function: Callable, tasks: list[Task], begin: float, end: float) -> Realizations:
        stage, report = f"realizations ({len(self.alone)} to run)", within(self.report, begin, end)
        return run_realizations(function, tasks, stage=stage, workers=self.workers, device=self.device, report=report)

    def _save(self, member: GougeScenario, result: Realization) -> None:
        if self.samples:
            write_sample(self.samples, member, result)
        if self.folder:
            path = _realization_path(member, self.folder)
            path.parent.mkdir(parents=True, exist_ok=True)
            archive.write(path, {"realization": result}, scenario=member.text, version=__version__)
            self.kept.of(member.digest).clear()


def find_engine(scenario: GougeScenario, folder: Path | None = None) -> Engine:
    """Return the engine that a scenario names; it reads legs that were written to the folder for a queue.

    Raises
    ------
    RuntimeError
        If it is not installed. The message says how to install it.
    ScenarioError
        If a leg has not run in the queue.
    """
    if scenario.engine == "stickslip":
        return own_engine(threads=1)
    from . import queue

    if folder and queue.is_written(folder):
        return queue.engine(folder)
    from ...lammps.run import lammps_engine

    return lammps_engine(scenario.ranks)


def _open_device(name: str, scenario: GougeScenario) -> Device:
    """Return the device that runs a scenario; see `simulate_gouge` for errors."""
    if scenario.engine != "stickslip":
        raise ValueError(
            f'device = "{name}" was given with engine = "{scenario.engine}", which runs elsewhere: give one'
        )
    return open_device(name, gouge_law(scenario, scenario.law.mu))


def _trunk_task(text: str, kept: Checkpoint | None, report: Report, engine: Engine | None = None) -> Trunk:
    """Run one trunk, possibly in a worker process."""
    scenario = GougeScenario.model_validate_json(text)
    engine = engine or find_engine(scenario, kept and kept.run)
    return run_trunk(scenario, scenario.seed, engine, report, kept and kept.if_visible())


def _branch_task(
    text: str, start: Branch, kept: Checkpoint | None, report: Report, engine: Engine | None = None
) -> tuple[Test, ...]:
    """Run one branch, possibly in a worker process."""
    scenario = GougeScenario.model_validate_json(text)
    engine = engine or find_engine(scenario, kept and kept.run)
    return run_branch(scenario, start, engine, report, kept and kept.if_visible())


def _realization_path(member: GougeScenario, folder: Path | None) -> Path | None:
    """Path of a saved realization, named after the digest of its scenario so that no other scenario uses it."""
    return folder / MEMBERS / f"{member.digest}.h5" if folder else None


def _find_realization(member: GougeScenario, folder: Path | None, samples: Path | None) -> Realization | None:
    """Return a realization that has finished earlier, among the samples or in the run folder; None if there is none."""
    if samples and (path := sample_path(samples, member)).exists():
        return read_sample(path, member).realization
    found = _read_realization(_realization_path(member, folder))
    if samples and found:
        write_sample(samples, member, found)
    return found


def _read_realization(path: Path | None) -> Realization | None:
    """Read a realization that has already finished; None if there is none."""
    if path is None or not path.exists():
        return None
    if (version := archive.attributes(path)["stickslip"]) != __version__:
        raise archive.ArchiveError(
            f"{path} was computed by stickslip {version}, but this is version {__version__}, whose numbers may differ: "
            f"move the file away to compute it again"
        )
    return archive.read(path, nouns=(Realization, Range, Test, Series))["realization"]
