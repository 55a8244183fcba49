"""A flow, run: grains poured, then stage after stage in chunks between samples, each told in physical quantities."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..core.contact import FROZEN
from ..core.control import driven, following
from ..core.forces import forces, unbalanced
from ..core.integrate import run
from ..core.laws import Law
from ..core.measure import contact_forces, coordination, elastic_energy, touching
from ..core.neighbors import without_walls
from ..core.state import SLIDE, State, loads
from ..data.flow_scenario import AXES, FlowScenario, Shaking, Stage, axis_of
from .pouring import Poured, inward, poured, pressing

Report = Callable[[str, float, str], None]
KNOTS = 32  # of a period of shaking, between which its velocity is linear: 0.5 per cent off at most
BINS = 24  # of the profile along y
MOST = 0.99  # share of the grains that `low` and `high` enclose from either side


class Series(NamedTuple):
    """What was measured, T rows: of the poured grains, W walls and P plates, in the order of the scenario."""

    time: np.ndarray  # (T,) [time]
    stage: np.ndarray  # (T,) number of the stage that ends or goes on here
    kinetic_energy: np.ndarray  # (T,) translations and rotations [energy]
    elastic_energy: np.ndarray  # (T,) stored in normal springs, plates included [energy]
    speed: np.ndarray  # (T,) mean [length/time]
    unbalanced: np.ndarray  # (T,) mean unbalanced force of a grain over mean contact force; infinite without contacts
    coordination: np.ndarray  # (T,) contacts of a grain that is no rattler
    sliding_fraction: np.ndarray  # (T,) share of the contacts that is at Coulomb's limit
    center: np.ndarray  # (T, 3) of mass [length]
    low: np.ndarray  # (T, 3) below which 1 % of the grains' centres lie, along each axis [length]
    high: np.ndarray  # (T, 3) above which 1 % of them lie [length]
    wall_point: np.ndarray  # (T, W, 3) [length], NaN once removed
    wall_force: np.ndarray  # (T, W, 3) of the grains on the wall [force], NaN once removed
    plate_position: np.ndarray  # (T, P, 3) of the plate's centre [length]
    plate_force: np.ndarray  # (T, P, 3) of the grains on the plate [force]
    profile_count: np.ndarray  # (T, BINS) grains by height
    profile_velocity: np.ndarray  # (T, BINS, 3) their mean velocity, NaN without any [length/time]


class StageEnd(NamedTuple):
    """How a stage ended."""

    name: str
    start: float  # [time]
    end: float  # [time]
    rested: bool | None  # whether rest was reached, None where it was not asked for


class FlowResult(NamedTuple):
    """Everything that a flow scenario found."""

    scenario: FlowScenario
    law: Law
    poured: Poured
    stages: tuple[StageEnd, ...]
    series: Series
    edges: np.ndarray  # (BINS + 1,) heights between the bins of the profile [length]
    frames: tuple[State, ...]  # at the start, the ends of stages, and in between
    frame_walls: tuple[tuple[str, ...], ...]  # names of the walls that each frame still has


def simulate_flow(
    scenario: FlowScenario, *, threads: int | None = None, report: Report = lambda stage, share, words: None
) -> FlowResult:
    """Pour the grains of a scenario and run its stages.

    Parameters
    ----------
    threads : as in `run`
    report : called as report(stage, share done, words) after every sample

    Raises
    ------
    ScenarioError
        with one sentence, before anything is run, if grains, walls, plates and dt do not go together.
    RuntimeError
        with one sentence, if a grain moves faster than a radius in one step, or a position is not a number.
    """
    return run_flow(scenario, poured(scenario), threads=threads, report=report)


def run_flow(scenario: FlowScenario, start: Poured, *, threads: int | None, report: Report) -> FlowResult:
    """The stages of a scenario from a given start; arguments as in `simulate_flow`."""
    state, walls, motion = start.state, start.walls, _first_motion(scenario)
    height = state.grains.position[:, 1]
    edges = np.linspace(height.min(), height.max(), BINS + 1)
    interval = scenario.duration / scenario.samples
    every = max(1, round(scenario.samples / scenario.frames))
    rows, frames, ends = [], [(state, walls)], []
    gravity, drag = scenario.gravity or (0.0,) * scenario.grains.dim, scenario.drag
    for number, stage in enumerate(scenario.stages):
        begin = state.time
        gone = [k for k, name in enumerate(walls) if name in stage.remove]
        state, walls = without_walls(state, gone), tuple(n for n in walls if n not in stage.remove)
        motion = _changed(motion, stage, scenario, begin)
        gravity, drag = stage.gravity or gravity, drag if stage.drag is None else stage.drag
        rested = None if stage.until is None else False
        state = controlled(state, start, walls, motion, gravity, begin + stage.duration)
        count = max(1, round(stage.duration / interval))
        for k in range(count):
            target = begin + (k + 1) * stage.duration / count
            state = _advanced(state, start, drag, target, threads)
            rows.append(_measured(state, start, walls, number, edges))
            share = (k + 1) / count
            report(stage.name, share, _words(rows[-1]))
            if stage.until == "rest" and _rests(rows[-1], stage):
                rested = True
                break
            if len(rows) % every == 0 and share < 1:
                frames.append((state, walls))
        ends.append(StageEnd(stage.name, begin, state.time, rested))
        frames.append((state, walls))
    series = Series(*(np.array([row[name] for row in rows]) for name in Series._fields))
    return FlowResult(
        scenario, start.law, start, tuple(ends), series, edges, tuple(f for f, _ in frames), tuple(w for _, w in frames)
    )


def _first_motion(scenario: FlowScenario) -> dict:
    """What moves each body along each axis: ("velocity", course, when it began) or ("force", size); else it stands."""
    motion = {}
    for body in (*scenario.walls, *scenario.plates):
        motion[body.name] = {axis: ("velocity", course, 0.0) for axis, course in body.velocity.prescribed.items()}
    for plate in scenario.plates:
        if (push := pressing(plate, scenario)) is not None:
            motion[plate.name]["y"] = ("force", push)
    for wall in scenario.walls:
        if wall.force is not None:
            motion[wall.name][axis_of(wall)] = ("force", wall.force * _sign(wall))
    return motion


def _sign(wall) -> float:
    """Along which way of its axis a wall's normal points."""
    return float(np.sign(sum(wall.normal)))


def _changed(motion: dict, stage: Stage, scenario: FlowScenario, now: float) -> dict:
    """What moves each body from the start of a stage on."""
    bodies = {body.name: body for body in (*scenario.walls, *scenario.plates)}
    plates = {plate.name for plate in scenario.plates}
    motion = {name: dict(axes) for name, axes in motion.items()}
    for name, moves in stage.velocity.items():
        motion[name] |= {axis: ("velocity", course, now) for axis, course in moves.prescribed.items()}
    for name, size in stage.force.items():
        body = bodies[name]
        sign = inward(body, scenario) if name in plates else _sign(body)
        motion[name][axis_of(body)] = ("force", sign * size)
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


def controlled(state: State, start: Poured, walls: tuple[str, ...], motion: dict, gravity, until: float) -> State:
    """The state with walls and plates controlled from now to the end of a stage."""
    n, pull = len(state.grains.radius), np.zeros(3)
    pull[: len(gravity)] = gravity
    control = loads(n, len(walls), gravity=pull)._replace(group=state.control.group)
    for name in (*walls, *start.plates):
        rows = start.plates.get(name)
        rows = np.array([n + walls.index(name)]) if rows is None else rows
        control = driven(control, rows, 0.0)
        for axis, way in motion[name].items():
            k = AXES.index(axis)
            if way[0] == "force":
                control.free[rows, k], control.force[rows[0], k] = True, way[1]
            elif isinstance(way[1], int | float):
                control.rate[rows, k] = way[1]
            else:
                times, values = knots(way[1], until - way[2])
                control.rate[rows, k] = 1.0
                control = following(control, rows, way[2] + times, values, axes=[k])
    return state._replace(control=control)


def _advanced(state: State, start: Poured, drag: float, target: float, threads) -> State:
    """The state at the target time, to half a step."""
    steps = round((target - state.time) / start.dt)
    if steps < 1:
        return state
    state, _, outcome = run(state, start.law, steps, start.dt, drag=drag, threads=threads)
    if not outcome.ok:
        raise RuntimeError(f"the run ended at time {state.time:.6g}: {outcome}")
    return state


def _measured(state: State, start: Poured, walls: tuple[str, ...], number: int, edges) -> dict:
    """One row of the series."""
    grains, loose, n = state.grains, start.loose, len(state.grains.radius)
    loads, _ = forces(state, start.law, memory=FROZEN)
    velocity, position, mass = grains.velocity[loose], grains.position[loose], grains.mass[loose]
    rows = touching(state)
    between = np.linalg.norm(contact_forces(state, start.law)[rows], axis=1)
    pull = np.linalg.norm(unbalanced(state, loads)[loose, :3], axis=1).mean()
    energy = 0.5 * (mass @ (velocity**2).sum(axis=1) + grains.inertia[loose] @ (grains.spin[loose] ** 2).sum(axis=1))
    bins = np.searchsorted(edges, position[:, 1], side="right") - 1
    inside = (bins >= 0) & (bins < BINS)
    count = np.bincount(bins[inside], minlength=BINS)
    sums = np.stack([np.bincount(bins[inside], velocity[inside, k], BINS) for k in range(3)], axis=1)
    here = [walls.index(name) if name in walls else -1 for name in start.walls]
    nothing = np.full(3, np.nan)
    plates = list(start.plates.values())
    return {
        "time": state.time,
        "stage": number,
        "kinetic_energy": energy,
        "elastic_energy": elastic_energy(state, start.law),
        "speed": np.linalg.norm(velocity, axis=1).mean(),
        "unbalanced": pull / between.mean() if len(rows) and between.mean() > 0 else np.inf,
        "coordination": coordination(state),
        "sliding_fraction": (state.contacts.mode[rows] == SLIDE).mean() if len(rows) else 0.0,
        "center": mass @ position / mass.sum(),
        "low": np.quantile(position, 1 - MOST, axis=0),
        "high": np.quantile(position, MOST, axis=0),
        "wall_point": np.array([state.walls.point[w] if w >= 0 else nothing for w in here]).reshape(-1, 3),
        "wall_force": np.array([loads.force[n + w] if w >= 0 else nothing for w in here]).reshape(-1, 3),
        "plate_position": np.array([grains.position[p].mean(axis=0) for p in plates]).reshape(-1, 3),
        "plate_force": np.array([loads.force[p].sum(axis=0) for p in plates]).reshape(-1, 3),
        "profile_count": count,
        "profile_velocity": np.where(count[:, None] > 0, sums / np.maximum(count, 1)[:, None], np.nan),
    }


def _rests(row: dict, stage: Stage) -> bool:
    return row["unbalanced"] < stage.unbalanced and row["kinetic_energy"] < stage.kinetic * row["elastic_energy"]


def _words(row: dict) -> str:
    """One row in words, while the run goes on."""
    return (
        f"t = {row['time']:.4g}, kinetic {row['kinetic_energy']:.1e}, unbalanced {row['unbalanced']:.0e}, "
        f"z {row['coordination']:.1f}, {row['sliding_fraction']:.0%} sliding, speed {row['speed']:.1e}"
    )
