"""Legs of fault gouge written for a queue, and read back from it.

The protocol runs once with an engine that writes legs instead of running them, and once more with one that reads what
LAMMPS made of them. A leg is identified by its name.
"""

import json
from collections.abc import Iterator
from pathlib import Path

from .... import State
from ....core.dynamics.engine import Engine, Leg
from ....core.dynamics.run import join_samples, sample
from ....data.checkpoint import LEGS
from ....data.exchange.lammps_restart import is_complete
from ....experiments import ScenarioError
from ....kit import checkpoint_in, silent
from ....results import Record
from ...lammps.process import require_lammps
from ...lammps.run import clear_legs, leg_folder, read_leg, sample_path, with_records, write_scripts, write_start
from ...lammps.script import write_input
from ...lammps.supported import check_leg
from .protocol import TRUNK, run_branch, settled_sample, slide_trunk
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
        legs = json.loads(path.read_text(encoding="utf-8")).items()
        table = {name: (leg_folder(folder, int(number)), Path(end).name) for name, (number, end) in legs}
    except (ValueError, TypeError, AttributeError, RecursionError):
        raise ScenarioError(f"{path} is damaged: write it again with --export") from None
    for place, end in table.values():
        if not is_complete(place / end):
            raise ScenarioError(
                f"LAMMPS has not finished in {place}: let it finish there first, for example with sh run.sh"
            )
    return Engine(lambda leg: with_records(leg, read_leg(leg, table[leg.name][0])), stops=False)


class _Legs:
    """Legs that have been written."""

    def __init__(self, folder: Path, ranks: int):
        self.folder, self.ranks = folder, ranks
        self.table, self.paths, self.ends = {}, [], []

    def pieces(self, leg: Leg) -> Iterator[tuple[State, Record]]:
        """Write a leg; yield its end, where grains have not moved."""
        check_leg(leg)
        target, leg = leg_folder(self.folder, len(self.ends)), leg._replace(ranks=self.ranks)
        if leg.after:
            number, last = self.table[leg.after]
            self.paths.append(write_input(leg, target, begin=f"../{leg_folder(self.folder, number).name}/{last}"))
        else:
            self.paths.append(write_start(leg, target))
        end = sample_path(leg, target, leg.steps)
        self.table[leg.name] = len(self.ends), end.name
        self.ends.append(end)
        still = join_samples([sample(leg.state, leg)] * 2, leg)
        yield leg.state._replace(time=leg.state.time + leg.steps * leg.dt), still
