"""Realizations of a gouge experiment in parallel processes; a finished one is kept in a file and not run again."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from .. import __version__
from ..data import archive
from ..data.gouge_scenario import GougeScenario
from ..ensemble import run_members
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
    workers: int | None = None,
    report: Report = lambda stage, share, words: None,
) -> GougeResult:
    """Run all realizations of a scenario.

    Parameters
    ----------
    folder : where finished realizations are kept, each as soon as it is; those that it holds are not run again
    workers : number of processes
    report : called as report(stage, share done, words)

    Raises
    ------
    RuntimeError
        with one sentence, if the engine is not installed, or every realization failed.
    """
    engine_of(scenario)
    seeds = range(scenario.seed, scenario.seed + scenario.realizations)
    alone = [scenario.model_copy(update={"realizations": 1, "seed": seed}) for seed in seeds]
    kept = [_kept(one, folder) for one in alone]
    found = {one.seed: again for one, path in zip(alone, kept, strict=True) if (again := _read(path, one))}
    reused = len(found)
    missing = [
        (one.text, str(path) if path else "") for one, path in zip(alone, kept, strict=True) if one.seed not in found
    ]

    def live(share, words):
        report(f"realizations ({len(missing)} to run)", share, words)

    if missing:
        live(0.0, f"each takes {scenario.words}" + (f"; {reused} were finished before" if reused else ""))
    members = run_members(_member, missing, workers=workers, live=live)
    failures = []
    for (text, _), member in zip(missing, members, strict=True):
        seed = GougeScenario.model_validate_json(text).seed
        if member.failure:
            failures.append(f"realization {seed} failed: {re.sub(r'^[A-Z][A-Za-z]+: ', '', member.failure)}")
        else:
            found[seed] = member.result
    if not found:
        raise RuntimeError(f"no realization succeeded; {failures[0]}")
    return GougeResult(scenario, tuple(found[seed] for seed in sorted(found)), tuple(failures), reused)


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


def _member(text: str, path: str, tell: Tell) -> Realization:
    """One realization, in whichever process."""
    one = GougeScenario.model_validate_json(text)
    found = realization(one, one.seed, engine_of(one), tell)
    if path:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        archive.write(path, tree_of(found), scenario=text, version=__version__)
    return found


def _kept(one: GougeScenario, folder: Path | None) -> Path | None:
    """Where a realization is kept: by the digest of what defines it, so that no other scenario takes it for its own."""
    return folder / MEMBERS / f"{one.digest}.h5" if folder else None


def tree_of(found: Realization) -> dict:
    """A realization as an archive holds it."""
    return {
        "version": __version__,
        "seed": found.seed,
        "range": found.range._asdict(),
        "tests": {
            f"{k:04d}": {**test._asdict(), "series": test.series._asdict()} for k, test in enumerate(found.tests)
        },
        "states": found.states,
        "ledger": found.ledger,
    }


def _read(path: Path | None, one: GougeScenario) -> Realization | None:
    """A realization that was finished before by this version; None if there is none, or the file is broken."""
    if path is None or not path.exists():
        return None
    try:
        tree = archive.read(path)
        tests = [
            Test(**{**tree["tests"][name], "series": Series(**tree["tests"][name]["series"])})
            for name in sorted(tree["tests"])
        ]
        found = Realization(int(tree["seed"]), Range(**tree["range"]), tuple(tests), tree["states"], tree["ledger"])
    except (ValueError, KeyError, TypeError):
        return None
    return found if tree["version"] == __version__ and found.seed == one.seed else None
