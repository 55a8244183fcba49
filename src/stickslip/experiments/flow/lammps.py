"""LAMMPS as the engine of a flow: each stage is a leg, run here or written for a queue and read back."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from ...core.contacts.neighbors import without_walls
from ...core.state import State
from ...data.schema import ScenarioError
from ...lammps.job import leg_folder, write_job
from ...lammps.leg import Leg, Wave
from ...lammps.process import require_lammps
from ...lammps.run import read_leg, run_leg, walls_at
from ...lammps.supported import check_leg
from .pouring import Poured, poured, sample_count
from .scenario import AXES, FlowScenario, Shaking
from .stages import FlowEngine, StageConditions, StagePart, stage_conditions, with_controls


def engine(scenario: FlowScenario, start: Poured, folder: Path | None) -> FlowEngine:
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
        return FlowEngine(partial(_read, legs, folder), False)
    require_lammps(scenario.ranks)
    return FlowEngine(partial(_run, scenario, start), True)


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
        part = StagePart(number, conditions, state, state.time, 0, sample_count(stage, scenario), stage.duration)
        leg = _make_leg(scenario, start, part)
        legs.append(leg)
        elapsed = leg.steps * leg.dt
        state, before = state._replace(walls=walls_at(leg, elapsed), time=state.time + elapsed), conditions.walls
    return legs


def _make_leg(scenario: FlowScenario, start: Poured, part: StagePart) -> Leg:
    """Return the leg that runs what remains of a stage."""
    steps = round((part.begin + part.duration - part.state.time) / start.dt)
    walls = tuple(start.walls.index(name) for name in part.conditions.walls)
    return Leg(
        part.state, start.law, start.dt, steps, part.count - part.done, part.conditions.drag, walls,
        _waves(part.state, start, part.conditions), scenario.ranks, number=part.number,
    )  # fmt: skip


def _waves(state: State, start: Poured, conditions: StageConditions) -> dict[int, Wave]:
    """Return the courses that are sines, which LAMMPS evaluates as such, by their column in the control."""
    waves, n = {}, len(state.grains.radius)
    for name, axes in conditions.motion.items():
        if name not in (*conditions.walls, *start.plates):
            continue
        row = start.plates[name][0] if name in start.plates else n + conditions.walls.index(name)
        for axis, way in axes.items():
            if way[0] == "velocity" and isinstance(way[1], Shaking):
                shaking = way[1]
                column = int(state.control.follows[row, AXES.index(axis)])
                waves[column] = Wave(shaking.amplitude, shaking.frequency, shaking.phase, way[2])
    return waves


def _run(scenario: FlowScenario, start: Poured, part: StagePart) -> Iterator[State]:
    """Yield the states at the remaining samples of a stage."""
    with TemporaryDirectory(prefix="stickslip-lammps-") as name:
        yield from run_leg(_make_leg(scenario, start, part), Path(name))


def _read(legs: list[Leg], folder: Path, part: StagePart) -> Iterator[State]:
    """Yield the states at the remaining samples of a stage that LAMMPS has run elsewhere."""
    for k, state in enumerate(read_leg(legs[part.number], leg_folder(folder, part.number))):
        if k >= part.done:
            yield state
