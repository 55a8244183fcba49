"""Stages of a flow: motion of walls and plates, gravity and drag, and the legs that engines and LAMMPS run."""

from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import State
from ....control import driven, loads, time_dependent
from ....kit import Engine, Leg, ScenarioError, Wave
from ....packings import without_walls
from ....results import Record
from ...lammps.run import lammps_engine, leg_folder, read_leg, walls_at, with_records, write_job
from ...lammps.supported import check_leg
from .pouring import Poured, initial_plate_force, inward_sign, poured, sample_count
from .scenario import AXES, FlowScenario, Shaking, Stage, force_axis


def lammps_of(scenario: FlowScenario, start: Poured, folder: Path | None) -> Engine:
    """Return LAMMPS as an engine; in a folder written by `export`, it reads results computed elsewhere.

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
    """Write a folder that LAMMPS can run without this package; `stickslip resume` then reads the result from it.

    A stage with `until = "rest"` lasts its whole duration there.

    Raises
    ------
    ScenarioError
        If the law is a Python file, which LAMMPS cannot use; the file is not executed.
    """
    if scenario.law.file is not None:
        raise ScenarioError(
            f"--export does not support law.file = {scenario.law.file}, as LAMMPS has only built-in laws: set law.kind"
        )
    legs = stage_legs(scenario, poured(scenario))
    for leg in legs:
        check_leg(leg)
    return write_job(folder, legs, scenario.ranks)


def stage_legs(scenario: FlowScenario, start: Poured) -> list[Leg]:
    """Return the leg of each stage, with initial grains, but with the walls as they are at the start of the stage."""
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
    """Yield the states of a leg that LAMMPS ran elsewhere, from the beginning of its stage."""
    states = read_leg(legs[leg.number], leg_folder(folder, leg.number))
    return with_records(leg, islice(states, leg.before[0], None))


KNOTS = 32  # knots per period of shaking; linear interpolation between them has an error of at most 0.5 %


class StageConditions(NamedTuple):
    """Conditions during a stage."""

    walls: tuple[str, ...]  # names of the remaining walls
    motion: dict[str, dict]  # motion of walls and plates, by axis: ("velocity", values, start time) or ("force", value)
    gravity: tuple[float, ...]
    drag: float


def stage_conditions(scenario: FlowScenario, begins: list[float]) -> StageConditions:
    """Return the conditions of the last stage that has started, or the initial ones, given all start times so far."""
    conditions = StageConditions(
        tuple(wall.name for wall in scenario.walls), _initial_motion(scenario),
        scenario.gravity or (0.0,) * scenario.grains.dim, scenario.drag,
    )  # fmt: skip
    for stage, begin in zip(scenario.stages, begins, strict=False):
        conditions = StageConditions(
            tuple(name for name in conditions.walls if name not in stage.remove),
            _update_motion(conditions.motion, stage, scenario, begin),
            stage.gravity or conditions.gravity,
            conditions.drag if stage.drag is None else stage.drag,
        )
    return conditions


def _initial_motion(scenario: FlowScenario) -> dict:
    """Return the initial motion of each body as in `StageConditions`; bodies are fixed along other axes."""
    motion = {}
    for body in (*scenario.walls, *scenario.plates):
        motion[body.name] = {axis: ("velocity", course, 0.0) for axis, course in body.velocity.prescribed.items()}
    for plate in scenario.plates:
        if (push := initial_plate_force(plate, scenario)) is not None:
            motion[plate.name]["y"] = ("force", push)
    for wall in scenario.walls:
        if wall.force is not None:
            motion[wall.name][force_axis(wall)] = ("force", wall.force * _normal_sign(wall))
    return motion


def _normal_sign(wall) -> float:
    """Return the sign of a wall's normal along its axis."""
    return float(np.sign(sum(wall.normal)))


def _update_motion(motion: dict, stage: Stage, scenario: FlowScenario, now: float) -> dict:
    """Return the motion of each body from the start of a stage onwards."""
    bodies = {body.name: body for body in (*scenario.walls, *scenario.plates)}
    plates = {plate.name for plate in scenario.plates}
    motion = {name: dict(axes) for name, axes in motion.items()}
    for name, moves in stage.velocity.items():
        motion[name] |= {axis: ("velocity", course, now) for axis, course in moves.prescribed.items()}
    for name, size in stage.force.items():
        body = bodies[name]
        sign = inward_sign(body, scenario) if name in plates else _normal_sign(body)
        motion[name][force_axis(body)] = ("force", sign * size)
    return motion


def knots(course: float | tuple | Shaking, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the times and values of a velocity that is linear between them and then constant.

    Examples
    --------
    >>> knots(((1.0, 0.0), (2.0, 0.5)), 10.0)
    (array([1., 2.]), array([0. , 0.5]))
    """
    if isinstance(course, Shaking):
        times = np.linspace(0.0, duration, 1 + max(1, int(np.ceil(duration * course.frequency * KNOTS))))
        return times, course.amplitude * np.sin(2 * np.pi * course.frequency * times + course.phase)
    if isinstance(course, tuple):
        return tuple(np.array(course, float).T)
    return np.zeros(1), np.full(1, float(course))


def with_controls(state: State, start: Poured, conditions: StageConditions, until: float) -> State:
    """Return the state with the control of walls and plates that holds until the end of a stage."""
    n, pull = len(state.grains.radius), np.zeros(3)
    pull[: len(conditions.gravity)] = conditions.gravity
    control = loads(n, len(conditions.walls), gravity=pull)._replace(group=state.control.group)
    for name in (*conditions.walls, *start.plates):
        rows = start.plates.get(name)
        rows = np.array([n + conditions.walls.index(name)]) if rows is None else rows
        control = driven(control, rows, 0.0)
        for axis, way in conditions.motion[name].items():
            k = AXES.index(axis)
            if way[0] == "force":
                control.free[rows, k], control.force[rows[0], k] = True, way[1]
            elif isinstance(way[1], int | float):
                control.rate[rows, k] = way[1]
            else:
                times, values = knots(way[1], until - way[2])
                control.rate[rows, k] = 1.0
                control = time_dependent(control, rows, way[2] + times, values, axes=[k])
    return state._replace(control=control)


def stage_leg(
    scenario: FlowScenario,
    start: Poured,
    number: int,
    conditions: StageConditions,
    state: State,
    begin: float,
    done: int = 0,
) -> Leg:
    """Return the remaining leg of a stage that began at a given time, after a number of samples."""
    stage = scenario.stages[number]
    before = round((state.time - begin) / start.dt)
    steps = round((begin + stage.duration - state.time) / start.dt)
    walls = tuple(start.walls.index(name) for name in conditions.walls)
    return Leg(
        state, start.law, start.dt, steps, sample_count(stage, scenario) - done, conditions.drag, before=(done, before),
        walls=walls, waves=_waves(state, start, conditions), number=number, ranks=scenario.ranks,
    )  # fmt: skip


def _waves(state: State, start: Poured, conditions: StageConditions) -> dict[int, Wave]:
    """Return the sinusoidal velocities, which LAMMPS evaluates as formulas, by their column in the control."""
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
