"""LAMMPS as the engine of a flow: each stage is a leg, run here or written for a queue and read back."""

from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import Path

from .... import State
from ....kit import Engine, Leg, ScenarioError
from ....packings import without_walls
from ....results import Record
from ...lammps.run import lammps_engine, leg_folder, read_leg, walls_at, with_records, write_job
from ...lammps.supported import check_leg
from .pouring import Poured, poured
from .scenario import FlowScenario
from .stages import stage_conditions, stage_leg, with_controls


def engine(scenario: FlowScenario, start: Poured, folder: Path | None) -> Engine:
    """Return LAMMPS as an engine; it reads what ran elsewhere if the folder was written by `export`.

    Raises
    ------
    ScenarioError
        If LAMMPS cannot run a stage exactly, or if there are fewer cores than ranks.
    MissingExtraError
        If LAMMPS or mpirun is missing and needed.
    """
    legs = stage_legs(scenario, start)
    for leg in legs:
        check_leg(leg)
    if folder and leg_folder(folder, 0).is_dir():
        return Engine(partial(_read, legs, folder), stops=False)
    return lammps_engine(scenario.ranks)


def export(scenario: FlowScenario, folder: Path) -> list[Path]:
    """Write a folder that LAMMPS runs without this package, and from which `stickslip resume` reads the result.

    A stage with `until = "rest"` lasts its whole duration there.

    Raises
    ------
    ScenarioError
        If the law is a Python file, which LAMMPS cannot use and which is not executed.
    """
    if scenario.law.file is not None:
        raise ScenarioError(
            f"--export was given with law.file = {scenario.law.file}: LAMMPS has only built-in laws; set law.kind"
        )
    legs = stage_legs(scenario, poured(scenario))
    for leg in legs:
        check_leg(leg)
    return write_job(folder, legs, scenario.ranks)


def stage_legs(scenario: FlowScenario, start: Poured) -> list[Leg]:
    """Return the leg of each stage; their grains are those at the start, but walls are where each stage begins."""
    state, begins, legs, before = start.state, [], [], start.walls
    for number, stage in enumerate(scenario.stages):
        begins.append(state.time)
        conditions = stage_conditions(scenario, begins)
        state = without_walls(state, [k for k, name in enumerate(before) if name in stage.remove])
        state = with_controls(state, start, conditions, state.time + stage.duration)
        legs.append(leg := stage_leg(scenario, start, number, conditions, state, state.time))
        elapsed = leg.steps * leg.dt
        state, before = state._replace(walls=walls_at(leg, elapsed), time=state.time + elapsed), conditions.walls
    return legs


def _read(legs: list[Leg], folder: Path, leg: Leg) -> Iterator[tuple[State, Record]]:
    """Yield the states of a leg that LAMMPS has run elsewhere, from the beginning of its stage."""
    states = read_leg(legs[leg.number], leg_folder(folder, leg.number))
    return with_records(leg, islice(states, leg.before[0], None))
