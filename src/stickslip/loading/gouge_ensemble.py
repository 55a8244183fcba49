"""Realizations of a gouge experiment in parallel processes; a finished one is kept in a file and not run again."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from .. import __version__
from ..data import archive
from ..data.gouge_scenario import GougeScenario
from ..data.kept import Kept, kept_in
from ..ensemble import Workers, run_members
from .gouge_numbers import Range
from .gouge_run import OURS, Engine, Realization, Series, Tell, Test, realization

MEMBERS = "realizations"  # folder beside the results
Report = Callable[[str, float, str], None]


class GougeResult(NamedTuple):
    """All realizations that a scenario asked for."""

    scenario: GougeScenario
    realizations: tuple[Realization, ...]
    failures: tuple[str, ...]  # a sentence for each realization that failed
    reused: int  # realizations that were finished before


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
    folder : where finished realizations are kept, each as soon as it is, and pieces of unfinished ones; what is there
        is not run again
    workers : number of processes, or a Dask scheduler's address
    report : called as report(stage, share done, words)

    Raises
    ------
    RuntimeError
        with one sentence, if the engine is not installed, or every realization failed.
    ArchiveError
        if a file of what was finished before is damaged, or of another version.
    """
    engine_of(scenario)
    seeds = range(scenario.seed, scenario.seed + scenario.realizations)
    alone = [scenario.model_copy(update={"realizations": 1, "seed": seed}) for seed in seeds]
    reused = [_read(_kept(one, folder)) for one in alone]
    missing, kept = reused.count(None), kept_in(folder, scenario)

    def live(share, words):
        report(f"realizations ({missing} to run)", share, words)

    def save(k, one):
        if folder:
            path = _kept(alone[k], folder)
            path.parent.mkdir(parents=True, exist_ok=True)
            archive.write(path, {"realization": one}, scenario=alone[k].text, version=__version__)
            kept.of(alone[k].digest).clear()

    if missing:
        if kept:
            for one in alone:
                kept.of(one.digest).check()
            kept.announce()
        before = f"; {len(alone) - missing} were finished before" if missing < len(alone) else ""
        live(0.0, f"each takes {scenario.words}{before}")
    tasks = [(one.text, kept and kept.of(one.digest)) for one in alone]
    members = run_members(_member, tasks, workers=workers, live=live, load=reused.__getitem__, save=save)
    found = tuple(member.result for member in members if member.failure is None)
    failures = tuple(
        f"realization {seed} failed: {re.sub(r'^[A-Z][A-Za-z]+: ', '', member.failure)}"
        for seed, member in zip(seeds, members, strict=True)
        if member.failure
    )
    if not found:
        raise RuntimeError(f"no realization succeeded; {failures[0]}")
    return GougeResult(scenario, found, failures, len(alone) - missing)


def engine_of(scenario: GougeScenario) -> Engine:
    """The engine that a scenario names.

    Raises
    ------
    RuntimeError
        with a sentence that says how to get it, if it is not installed.
    """
    if scenario.engine == "stickslip":
        return OURS
    from .lammps import engine

    return engine()


def _member(text: str, kept: Kept | None, tell: Tell) -> Realization:
    """One realization, in whichever process."""
    one = GougeScenario.model_validate_json(text)
    return realization(one, one.seed, engine_of(one), tell, kept and kept.seen())


def _kept(one: GougeScenario, folder: Path | None) -> Path | None:
    """Where a realization is kept: by the digest of what defines it, so that no other scenario takes it for its own."""
    return folder / MEMBERS / f"{one.digest}.h5" if folder else None


def _read(path: Path | None) -> Realization | None:
    """A realization that was finished before; None if there is none."""
    if path is None or not path.exists():
        return None
    if (version := archive.attributes(path)["stickslip"]) != __version__:
        raise archive.ArchiveError(
            f"{path} was computed by stickslip {version}, and this is {__version__}, whose numbers may differ: move it "
            f"away to have it computed again"
        )
    return archive.read(path, nouns=(Realization, Range, Test, Series))["realization"]
