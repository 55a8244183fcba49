"""What moves walls and plates in the stages of a flow, gravity and drag."""

from typing import NamedTuple

import numpy as np

from ...core.control import driven, time_dependent
from ...core.state import State, loads
from .pouring import Poured, initial_plate_force, inward_sign
from .scenario import AXES, FlowScenario, Shaking, Stage, force_axis

KNOTS = 32  # of a period of shaking, between which its velocity is linear: 0.5 per cent off at most


class StageConditions(NamedTuple):
    """What acts during a stage."""

    walls: tuple[str, ...]  # that are left
    motion: dict[str, dict]  # of walls and plates, by axis: ("velocity", course, when it began) or ("force", size)
    gravity: tuple[float, ...]
    drag: float


def stage_conditions(scenario: FlowScenario, begins: list[float]) -> StageConditions:
    """What acts in the last of the stages that began at these times; without any, what the scenario begins with."""
    acts = StageConditions(
        tuple(wall.name for wall in scenario.walls), _initial_motion(scenario),
        scenario.gravity or (0.0,) * scenario.grains.dim, scenario.drag,
    )  # fmt: skip
    for stage, begin in zip(scenario.stages, begins, strict=False):
        acts = StageConditions(
            tuple(name for name in acts.walls if name not in stage.remove),
            _update_motion(acts.motion, stage, scenario, begin),
            stage.gravity or acts.gravity,
            acts.drag if stage.drag is None else stage.drag,
        )
    return acts


def _initial_motion(scenario: FlowScenario) -> dict:
    """What moves each body along each axis: ("velocity", course, when it began) or ("force", size); else it stands."""
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
    """Along which way of its axis a wall's normal points."""
    return float(np.sign(sum(wall.normal)))


def _update_motion(motion: dict, stage: Stage, scenario: FlowScenario, now: float) -> dict:
    """What moves each body from the start of a stage on."""
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
    """Times and values of a course, linear between them and constant after the last.

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


def with_controls(state: State, start: Poured, acts: StageConditions, until: float) -> State:
    """The state with walls and plates controlled from now to the end of a stage."""
    n, pull = len(state.grains.radius), np.zeros(3)
    pull[: len(acts.gravity)] = acts.gravity
    control = loads(n, len(acts.walls), gravity=pull)._replace(group=state.control.group)
    for name in (*acts.walls, *start.plates):
        rows = start.plates.get(name)
        rows = np.array([n + acts.walls.index(name)]) if rows is None else rows
        control = driven(control, rows, 0.0)
        for axis, way in acts.motion[name].items():
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
