"""Simulation of gouge experiments in parallel processes, sample files, and legs written for a queue.

Finished realisations are saved and not run again.

A sample file contains the series of one realisation, in a form compact enough to be kept and exchanged, and its
scenario. It can be evaluated together with files of the same scenario and other seeds. It contains no states; the state
at the end of the trunk, from which further tests can start, is written to a separate file. All columns except times and
load-point displacements are rounded to single precision.

For a queue, the protocol runs once with an engine that writes legs instead of running them, and again with an engine
that reads the results of LAMMPS. A leg is identified by its name.
"""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import numpy as np

from .... import State, __version__
from ....kit import (
    LEGS,
    SI,
    ArchiveError,
    Checkpoint,
    Device,
    Engine,
    Leg,
    Realizations,
    Report,
    ScenarioError,
    Task,
    Workers,
    archive,
    checked,
    checkpoint_in,
    given_keys,
    join_samples,
    lammps_restart,
    open_device,
    own_engine,
    result_of,
    run_realizations,
    shortened,
    silent,
    take_sample,
    within,
)
from ....results import Record
from ...lammps.run import (
    clear_legs,
    lammps_engine,
    leg_folder,
    read_leg,
    require_lammps,
    restart_path,
    with_records,
    write_scripts,
    write_start,
)
from ...lammps.script import write_input
from ...lammps.supported import check_leg
from . import EXPERIMENT
from .protocol import (
    TRUNK,
    Branch,
    Realization,
    Series,
    Test,
    Trunk,
    make_realization,
    run_branch,
    run_trunk,
    settled_sample,
    slide_trunk,
)
from .sample import Gouge, Range, gouge_law
from .scenario import GougeScenario

PHYSICS = 1  # increased whenever a change of preparation, law, integrator or protocol changes the statistics
EXACT = ("time", "load_point")  # columns in which small differences are relevant
STATES = "states"  # folder of the states, next to the samples
_FREE = {"seed", "realizations"}  # keys that differ between samples of one result


class Sample(NamedTuple):
    """A stored sample."""

    path: Path
    scenario: GougeScenario  # scenario of this sample alone
    realization: Realization
    version: str  # version of the package that computed it


def sample_path(folder: Path, scenario: GougeScenario) -> Path:
    """Return the path of a sample file, named after damping and seed."""
    law = scenario.law
    kind = f"damping-{law.damping_n:g}" if law.restitution is None else f"{law.reading}-{law.restitution:g}"
    return folder / f"{kind}-seed-{scenario.seed:04d}.h5"


def check_folder(folder: Path) -> None:
    """Create the folder of samples if necessary; raise ValueError if it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as problem:
        raise ValueError(f"cannot write to the folder {folder} ({problem.strerror}): choose another one") from None


def write_sample(folder: Path, scenario: GougeScenario, realization: Realization) -> None:
    """Write a sample, and the state at the end of its trunk; `scenario` is that of this sample alone."""
    path = sample_path(folder, scenario)
    (folder / STATES).mkdir(parents=True, exist_ok=True)
    about: dict[str, Any] = {"scenario": scenario.text, "version": __version__, "units": SI}
    archive.write(folder / STATES / path.name, {"physics": PHYSICS, "end": realization.states["end"]}, **about)
    tests = tuple(
        t._replace(series=Series(*(c if n in EXACT else c.astype(np.float32) for n, c in t.series._asdict().items())))
        for t in realization.tests
    )
    archive.write(path, {"physics": PHYSICS, "sample": realization._replace(tests=tests, states={})}, **about)


def read_samples(folder: Path, scenarios: dict[str, GougeScenario]) -> dict[str, dict[int, Sample]]:
    """Read all samples of a folder, sorted by scenario and seed.

    Parameters
    ----------
    scenarios : scenarios by name; their seeds and numbers of realisations are irrelevant

    Raises
    ------
    ArchiveError
        If a file is not a sample, belongs to none of the scenarios or to another version of the physics, or if two
        files have the same scenario and seed.
    """
    found: dict[str, dict[int, Sample]] = {name: {} for name in scenarios}
    for path in sorted(folder.glob("*.h5")):
        sample = read_sample(path, *scenarios.values())
        mine = next(found[name] for name, one in scenarios.items() if not _differences(sample.scenario, one))
        if other := mine.get(sample.scenario.seed):
            raise ArchiveError(f"{other.path} and {path} are the same sample: remove one of them")
        mine[sample.scenario.seed] = sample
    return {name: dict(sorted(mine.items())) for name, mine in found.items()}


REMEDY = (
    "give a folder that has only samples, which `stickslip reproduce gouge --paper-size` writes in its folder samples"
)


def read_sample(path: Path, *scenarios: GougeScenario) -> Sample:
    """Read a sample of one of several scenarios.

    Raises
    ------
    ArchiveError
        If the file is not a sample, or belongs to another scenario or version of the physics.
    """
    content = archive.read(path, nouns=(Realization, Range, Test, Series), remedy=REMEDY)
    about = archive.attributes(path)
    sample, physics = content.get("sample"), content.get("physics")
    if not isinstance(sample, Realization):
        raise ArchiveError(f"{path} is not a sample of gouge: move it to another folder")
    if physics != PHYSICS:
        raise ArchiveError(
            f"{path} was computed with version {physics} of the physics of gouge, and this is version {PHYSICS}: "
            f"compute it again in another folder"
        )
    try:
        scenario = GougeScenario.model_validate_json(about["scenario"])
    except ValueError:
        raise ArchiveError(
            f"{path} has a scenario that is unknown to this version: use the version that wrote it"
        ) from None
    fewest = min((_differences(scenario, one) for one in scenarios), key=len)
    if fewest:
        raise ArchiveError(
            f"{path} is a sample of another scenario ({'; '.join(fewest[:3])}): move it to another folder"
        )
    tests = tuple(t._replace(series=Series(*(np.asarray(c, float) for c in t.series))) for t in sample.tests)
    return Sample(path, scenario, sample._replace(tests=tests), about["stickslip"])


def _differences(one: GougeScenario, other: GougeScenario) -> list[str]:
    """Name each key in which two scenarios differ, with both values, except seeds and numbers of realisations."""
    a, b = ({key: value for key, value, *_ in given_keys(scenario) if key not in _FREE} for scenario in (one, other))
    return [
        f"{key} = {shortened(str(a.get(key, 'default')))} instead of {shortened(str(b.get(key, 'default')))}"
        for key in sorted(a.keys() | b.keys())
        if a.get(key) != b.get(key)
    ]


TABLE = "legs.json"


def export(scenario: GougeScenario, folder: Path) -> list[Path]:
    """Write a folder that LAMMPS can run without this package; `stickslip resume` then reads the result from it.

    Samples settle on the local machine, which needs LAMMPS to write their contact memory.

    Raises
    ------
    ScenarioError
        If the end of a leg depends on steady friction, or if LAMMPS has already run legs in this folder.
    MissingExtraError
        If LAMMPS is missing.
    """
    if scenario.preparation.steady or any(part.kind == "slide" and part.steady for part in scenario.protocol):
        raise ScenarioError(
            "--export must know all legs in advance, but this gouge slides until the measured friction is steady: set "
            "preparation.steady = false and leave steady = true out of slides, or "
            "run stickslip with --engine lammps inside the job"
        )
    require_lammps()
    clear_legs(folder)
    written = _Legs(folder, scenario.ranks)
    engine = Engine(written.pieces)
    for seed in range(scenario.seed, scenario.seed + scenario.realizations):
        single = scenario.model_copy(update={"realizations": 1, "seed": seed})
        kept = checkpoint_in(folder, scenario, Gouge).of(single.digest).of(TRUNK)
        gouge = settled_sample(single, seed, silent, kept)
        bare = single.model_copy(update={"ledger_steps": 0})
        trunk = slide_trunk(bare, gouge, engine, silent)
        for start in trunk.branches:
            run_branch(bare, start, engine, silent)
    (folder / LEGS / TABLE).write_text(json.dumps(written.table, indent=1), encoding="utf-8")
    return [*written.paths, folder / LEGS / TABLE, *write_scripts(folder, written.ends, scenario.ranks)]


def queued_engine(folder: Path) -> Engine:
    """Return an Engine that reads the legs run by LAMMPS in a folder written by `export`.

    Raises
    ------
    ScenarioError
        If a leg has not finished.
    """
    path = folder / LEGS / TABLE
    try:
        legs = json.loads(path.read_text(encoding="utf-8")).items()
        table = {name: (leg_folder(folder, int(number)), Path(end).name) for name, (number, end) in legs}
    except (ValueError, TypeError, AttributeError, RecursionError):
        raise ScenarioError(f"{path} is damaged: write it again with --export") from None
    for place, end in table.values():
        if not lammps_restart.is_complete(place / end):
            raise ScenarioError(
                f"LAMMPS has not finished in {place}: let it finish there first, for example with sh run.sh"
            )
    return Engine(lambda leg: with_records(leg, read_leg(leg, table[leg.name][0])), stops=False)


class _Legs:
    """Engine that writes legs instead of running them."""

    def __init__(self, folder: Path, ranks: int):
        self.folder, self.ranks = folder, ranks
        self.table, self.paths, self.ends = {}, [], []

    def pieces(self, leg: Leg) -> Iterator[tuple[State, Record]]:
        """Write a leg; yield its end state, in which the grains have not moved."""
        check_leg(leg)
        target, leg = leg_folder(self.folder, len(self.ends)), leg._replace(ranks=self.ranks)
        if leg.after:
            number, last = self.table[leg.after]
            self.paths.append(write_input(leg, target, begin=f"../{leg_folder(self.folder, number).name}/{last}"))
        else:
            self.paths.append(write_start(leg, target))
        end = restart_path(leg, target, leg.steps)
        self.table[leg.name] = len(self.ends), end.name
        self.ends.append(end)
        still = join_samples([take_sample(leg.state, leg)] * 2, leg)
        yield leg.state._replace(time=leg.state.time + leg.steps * leg.dt), still


MEMBERS = "realizations"  # folder next to the results


@result_of(EXPERIMENT)
class GougeResult(NamedTuple):
    """All realisations of a scenario."""

    scenario: GougeScenario
    realizations: tuple[Realization, ...]
    failures: tuple[str, ...]  # one sentence per failed realisation
    reused: int  # number of realisations finished earlier


@checked
def simulate_gouge(
    scenario: GougeScenario, *, folder: Path | None = None, workers: Workers = None, device: str | None = None,
    samples: Path | None = None, report: Report = silent,
) -> GougeResult:  # fmt: skip
    """Run all realisations of a scenario.

    Parameters
    ----------
    folder : run folder, in which finished realisations and pieces of unfinished ones are saved; saved parts are not run
        again
    workers : number of processes, or the address of a Dask scheduler; default: number of cores divided by the
        number of MPI ranks per process
    device : "cuda" to run all realisations, and then all branches, side by side on a graphics processor
    samples : folder to which each sample is written when it has finished; samples already in it are not run
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If the device cannot run this scenario, or if the folder of samples cannot be written.
    MissingExtraError
        If CuPy is missing.
    RuntimeError
        If there is no such device, if the engine is not installed, or if every realisation failed.
    ArchiveError
        If a file of a finished realisation is damaged, or was written by another version.
    """
    if samples:
        check_folder(samples)
    if device and scenario.engine != "stickslip":
        raise ValueError(
            f'device = "{device}" does not apply to engine = "{scenario.engine}", which runs elsewhere: give only one'
        )
    law = gouge_law(scenario, scenario.law.mu)
    where = open_device(device, law) if device else find_engine(scenario, folder) and None
    if workers is None and scenario.ranks > 1:
        workers = max(1, (os.cpu_count() or 1) // scenario.ranks)  # each worker starts this many MPI processes
    seeds = range(scenario.seed, scenario.seed + scenario.realizations)
    alone = [scenario.model_copy(update={"realizations": 1, "seed": seed}) for seed in seeds]
    realizations = [_find_realization(member, folder, samples) for member in alone]
    missing = [k for k, member in enumerate(realizations) if member is None]
    failures = {}
    if missing:
        kept, rest = checkpoint_in(folder, scenario), [alone[k] for k in missing]
        if kept:
            for member in rest:
                kept.of(member.digest).check()
            kept.announce()
        ensemble = _Ensemble(scenario, rest, kept, folder, samples, workers, where, report)
        for k, member in zip(missing, ensemble.run(), strict=True):
            realizations[k], failures[seeds[k]] = (None, member) if isinstance(member, str) else (member, "")
    sentences = tuple(f"realisation {seed} failed: {failure}" for seed, failure in failures.items() if failure)
    done = tuple(member for member in realizations if member is not None)
    if not done:
        raise RuntimeError(f"every realisation failed; first message: {sentences[0]}")
    return GougeResult(scenario, done, sentences, len(alone) - len(missing))


class _Ensemble(NamedTuple):
    """Runs unfinished realisations: all trunks in parallel, then all branches of the trunks."""

    scenario: GougeScenario
    alone: list[GougeScenario]  # scenarios of single realisations
    kept: Checkpoint | None
    folder: Path | None
    samples: Path | None
    workers: Workers
    device: Device | None
    report: Report

    @property
    def first(self) -> float:
        """Share of the work done by the trunks."""
        return self.scenario.trunk_duration / self.scenario.duration

    def run(self) -> list[Realization | str]:
        """Return each realisation, or one sentence with the reason for its failure."""
        before = self.scenario.realizations - len(self.alone)
        more = f"; {before} had finished earlier" if before else ""
        cost = f"each takes {self.scenario.expected_cost}{more}"
        self.report(f"realisations ({len(self.alone)} to run)", 0.0, cost)
        nouns = (Trunk, Branch, Test, Series, Gouge)
        places = [self.kept and self.kept.of(member.digest, *nouns) for member in self.alone]
        tasks = [
            Task(f"trunk {member.seed}", (member.text, place and place.of(TRUNK)), TRUNK, place)
            for member, place in zip(self.alone, places, strict=True)
        ]
        trunks = self._run(_trunk_task, tasks, 0.0, self.first)
        owners = [k for k, trunk in enumerate(trunks.results) if trunk for _ in trunk.branches]
        starts = [start for trunk in trunks.results if trunk for start in trunk.branches]
        names = [f"branch-{start.part:02d}-{start.before:.6g}-{start.number:03d}" for start in starts]
        places = [self.kept and self.kept.of(self.alone[k].digest, Test, Series) for k in owners]
        tasks = [
            Task(name, (self.alone[k].text, start, place and place.of(name)), name, place)
            for k, start, place, name in zip(owners, starts, places, names, strict=True)
        ]
        tests = self._run(_branch_task, tasks, self.first, 1.0)
        out = []
        for k, (member, trunk) in enumerate(zip(self.alone, trunks.results, strict=True)):
            mine = [b for b, owner in enumerate(owners) if owner == k]
            if wrong := next(filter(None, [trunks.reasons[k], *(tests.reasons[b] for b in mine)]), None):
                out.append(wrong)
                continue
            out.append(made := make_realization(member, member.seed, trunk, [tests.results[b] for b in mine]))
            if self.samples:
                write_sample(self.samples, member, made)
            if self.folder:
                path = _realization_path(member, self.folder)
                path.parent.mkdir(parents=True, exist_ok=True)
                archive.write(path, {"realization": made}, scenario=member.text, version=__version__)
                self.kept.of(member.digest).clear()
        return out

    def _run(self, function: Callable, tasks: list[Task], begin: float, end: float) -> Realizations:
        stage, report = f"realisations ({len(self.alone)} to run)", within(self.report, begin, end)
        return run_realizations(function, tasks, stage=stage, workers=self.workers, device=self.device, report=report)


def find_engine(scenario: GougeScenario, folder: Path | None = None) -> Engine:
    """Return the engine named in a scenario or, for a folder written for a queue, the engine that reads its legs."""
    if scenario.engine == "stickslip":
        return own_engine(threads=1)
    return queued_engine(folder) if folder and (folder / LEGS / TABLE).is_file() else lammps_engine(scenario.ranks)


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
    """Path of a saved realisation, named after the digest of its scenario and thus unique to that scenario."""
    return folder / MEMBERS / f"{member.digest}.h5" if folder else None


def _find_realization(member: GougeScenario, folder: Path | None, samples: Path | None) -> Realization | None:
    """Return a realisation that finished earlier, from the samples or the run folder; None if there is none."""
    if samples and (path := sample_path(samples, member)).exists():
        return read_sample(path, member).realization
    path, found = _realization_path(member, folder), None
    if path and path.exists():
        if (version := archive.attributes(path)["stickslip"]) != __version__:
            raise ArchiveError(
                f"{path} was computed by stickslip {version}, but this is version {__version__}, whose numbers may "
                f"differ: move the file away to compute it again"
            )
        found = archive.read(path, nouns=(Realization, Range, Test, Series))["realization"]
    if samples and found:
        write_sample(samples, member, found)
    return found
