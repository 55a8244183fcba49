"""Legs of fault gouge written for a queue, and read back from it.

The protocol runs once with an engine that writes legs instead of running them, and once more with one that reads what
LAMMPS made of them. A leg is identified by the leg before it, its velocity and its number of steps.
"""

import json
from functools import partial
from pathlib import Path

import numpy as np

from ...core.progress import silent
from ...data.checkpoint import LEGS, checkpoint_in
from ...data.exchange.lammps_restart import is_complete
from ...data.schema import ScenarioError
from ...lammps.job import clear_legs, leg_folder, write_scripts
from ...lammps.process import require_lammps
from ...lammps.run import sample_path, write_start
from ...lammps.script import write_input
from .lammps import Place, engine_of, make_leg, read_output
from .protocol import TRUNK, Engine, Series, run_branch, settled_sample, slide_trunk
from .sample import Gouge
from .scenario import GougeScenario

TABLE = "legs.json"


def export(scenario: GougeScenario, folder: Path) -> list[Path]:
    """Write a folder that LAMMPS runs without this package, and from which `stickslip resume` reads the result.

    Samples settle here, and LAMMPS is needed here to write the memory of their contacts.

    Raises
    ------
    ScenarioError
        If a leg ends when friction is steady, or if LAMMPS has already run legs in this folder.
    MissingExtraError
        If LAMMPS is missing.
    """
    if scenario.preparation.steady or any(part.kind == "slide" and part.steady for part in scenario.protocol):
        raise ScenarioError(
            "--export was given with fault gouge that slides until the measured friction is steady, so that its legs "
            "cannot be written in advance: set preparation.steady = false and leave steady = true out of slides, or "
            "run stickslip with --engine lammps inside the job"
        )
    require_lammps()
    clear_legs(folder)
    written = _Legs(folder, scenario.ranks)
    for seed in range(scenario.seed, scenario.seed + scenario.realizations):
        one = scenario.model_copy(update={"realizations": 1, "seed": seed})
        kept = checkpoint_in(folder, scenario, Gouge).of(one.digest).of(TRUNK)
        gouge = settled_sample(one, seed, silent, kept)
        bare = one.model_copy(update={"ledger_steps": 0})
        trunk = slide_trunk(bare, gouge, engine_of(written.write), silent)
        for start in trunk.branches:
            run_branch(bare, start, engine_of(written.write), silent)
    (folder / LEGS / TABLE).write_text(json.dumps(written.table, indent=1), encoding="utf-8")
    return [*written.paths, folder / LEGS / TABLE, *write_scripts(folder, written.ends, scenario.ranks)]


def is_written(folder: Path) -> bool:
    """Return True if the legs of a scenario have been written to a folder."""
    return (folder / LEGS / TABLE).is_file()


def engine(folder: Path) -> Engine:
    """Return an Engine that reads the legs that LAMMPS has run in a folder written by `export`.

    Raises
    ------
    ScenarioError
        If a leg has not finished.
    """
    path = folder / LEGS / TABLE
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        numbers = {tuple(key): int(number) for number, (*key, _) in table.items()}
        ends = [leg_folder(folder, int(number) - 1) / Path(end).name for number, (*_, end) in table.items()]
    except (ValueError, TypeError, AttributeError, RecursionError):
        raise ScenarioError(f"{path} is damaged: write it again with --export") from None
    for end in ends:
        if not is_complete(end):
            raise ScenarioError(
                f"LAMMPS has not finished in {end.parent}: let it finish there first, for example with sh run.sh"
            )
    return engine_of(partial(_read, folder, numbers))


def _key(scenario: GougeScenario, place: Place, velocity: float, steps: int) -> tuple:
    return scenario.seed, place.number, float(velocity), steps


def _read(folder: Path, numbers: dict, scenario: GougeScenario, place: Place, velocity: float, steps: int):
    """Return the end and the series of a leg."""
    number = numbers[_key(scenario, place, velocity, steps)]
    end, series = read_output(scenario, place, velocity, steps, leg_folder(folder, number - 1))
    return end._replace(restart=b"", number=number), series


class _Legs:
    """Legs that have been written."""

    def __init__(self, folder: Path, ranks: int):
        self.folder, self.ranks = folder, ranks
        self.numbers, self.table, self.paths, self.ends = {}, {}, [], []

    def write(self, scenario: GougeScenario, place: Place, velocity: float, steps: int) -> tuple[Place, Series]:
        """Write a leg unless the same one has been written; return its end, where grains have not moved."""
        key, leg = _key(scenario, place, velocity, steps), make_leg(scenario, place, velocity, steps, ranks=self.ranks)
        if key not in self.numbers:
            self.numbers[key] = len(self.numbers) + 1
            target = leg_folder(self.folder, len(self.ends))
            if place.number:
                before = self.ends[place.number - 1]
                self.paths.append(write_input(leg, target, begin=f"../{before.parent.name}/{before.name}"))
            else:
                self.paths.append(write_start(leg, target))
            self.ends.append(sample_path(leg, target, steps))
            self.table[str(self.numbers[key])] = [*key, self.ends[-1].name]
        state = leg.state._replace(time=leg.state.time + steps * scenario.dt)
        nothing = Series(*(np.zeros((1, 3, 3) if name == "fabric" else 1) for name in Series._fields))
        return Place(place.gouge._replace(state=state), b"", self.numbers[key]), nothing
