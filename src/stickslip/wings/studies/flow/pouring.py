"""Initial state of a flow (grains on a loose lattice between walls and plates), and the stages that follow.

Stages move walls and plates and set gravity and drag; an engine, for example LAMMPS, runs each stage as a leg.
"""

from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, State, assembly, box, disks, flat_walls, spheres
from ....control import driven, loads, rigid, time_dependent
from ....kit import (
    Engine,
    Leg,
    ScenarioError,
    Size,
    Wave,
    checked,
    evaluate,
    largest_stiffness,
    make_law,
    pluralize,
    readable,
    require_sizes,
)
from ....laws import for_pair
from ....measure import heights
from ....packings import without_walls
from ....results import Record
from ...lammps.run import lammps_engine, leg_folder, read_leg, walls_at, with_records, write_job
from ...lammps.supported import check_leg
from .scenario import AXES, FlowScenario, Plate, Shaking, Stage, force_axis

SAFETY = 0.1  # dt in √(m/k): 1/20 of a collision's duration π √(m/2k), and 1/6 of the stability limit with six contacts
LIMIT = 0.58  # dt in √(m/k): the stability limit 2/√12 with six neighbours at rest and contacts of stiffness k
JITTER = 0.9  # fraction of the free space around each grain on the lattice


@readable
class Poured(NamedTuple):
    """State of a flow before its first stage."""

    state: State
    law: Law
    walls: tuple[str, ...]  # names of the walls, in the order of the state
    plates: dict[str, np.ndarray]  # indices of the grains of each plate
    dt: float  # [time]

    @property
    def loose(self) -> np.ndarray:
        """Indices of the grains outside plates."""
        return np.flatnonzero(self.state.control.group[: len(self.state.grains.radius)] < 0)


@checked
def poured(scenario: FlowScenario) -> Poured:
    """Return the grains, walls and plates of a scenario, at rest and without contacts.

    Raises
    ------
    ScenarioError
        If the grains do not fit, if they lie behind a wall, or if dt is too long.
    """
    chosen, dim = scenario.grains, scenario.grains.dim
    rng = np.random.default_rng(scenario.seed)
    given = np.atleast_1d(np.asarray(chosen.radius, float))
    radius = given[np.arange(chosen.number) * len(given) // chosen.number]
    spread = rng.uniform(-chosen.polydispersity, chosen.polydispersity, chosen.number)
    radius = rng.permutation(radius * (1 + spread))
    position = _place_grains(scenario, radius, rng)
    places, sizes, plates = [position], [radius], {}
    for plate in scenario.plates:
        row, size = _plate_grains(plate, scenario, radius)
        start = sum(map(len, sizes))
        plates[plate.name] = np.arange(start, start + len(row))
        places.append(row)
        sizes.append(np.full(len(row), size))
    all_sizes = np.concatenate(sizes)
    if chosen.mass is not None:
        mass = np.full(len(all_sizes), chosen.mass)
    else:
        mass = chosen.density * (np.pi * all_sizes**2 if dim == 2 else 4 / 3 * np.pi * all_sizes**3)
    for plate in scenario.plates:
        if plate.mass is not None:
            mass[plates[plate.name]] = plate.mass / len(plates[plate.name])
    make, more = (disks if dim == 2 else spheres), ({} if chosen.i0 is None else {"i0": chosen.i0})
    grains = make(np.concatenate(places), all_sizes, mass=mass, **more)
    control = loads(len(all_sizes), len(scenario.walls))
    for members in plates.values():
        control = rigid(control, members)
    size = np.ones(3)
    size[:dim] = scenario.cell.size or np.ones(dim)
    cell = box(size, [axis in scenario.cell.periodic for axis in AXES], dim)
    names, walls = tuple(wall.name for wall in scenario.walls), _make_walls(scenario)
    _check_walls(grains.position, walls, names, dim)
    state = assembly(grains, walls, cell, control)
    law = flow_law(scenario, radius, mass[: len(radius)])
    start = Poured(state, law, names, plates, _time_step(scenario, law, radius, mass))
    _check_sampling(scenario, start.dt)
    return start


def sample_count(stage: Stage, scenario: FlowScenario) -> int:
    """Return the number of samples of a stage in the time series."""
    return max(1, round(stage.duration * scenario.samples / scenario.duration))


def _check_sampling(scenario: FlowScenario, dt: float) -> None:
    for stage in scenario.stages:
        count, steps = sample_count(stage, scenario), stage.duration / dt
        if steps < 0.5 * count:
            raise ScenarioError(
                f"stage {stage.name!r} has {pluralize(count, 'sample')} in {steps:.3g} time steps of {dt:.3g}: "
                f"use fewer samples, a longer stage or a smaller dt"
            )


def flow_law(scenario: FlowScenario, radius, mass) -> Law:
    """Return the law of a scenario: grains are material 0, and wall k is material k + 1 if it has its own friction."""
    law = make_law(scenario.law, radius=float(np.mean(radius)), mass=float(np.mean(mass)))
    for k, wall in enumerate(scenario.walls):
        if wall.mu is not None:
            law = for_pair(law, 0, k + 1, mu=wall.mu)
    return law


def _check_walls(position, walls, names: tuple[str, ...], dim: int) -> None:
    grains, behind = np.nonzero(heights(position, walls) < 0)
    if len(grains):
        location = ", ".join(f"{x:.4g}" for x in position[grains[0], :dim])
        raise ScenarioError(
            f"grain {grains[0] + 1} at ({location}) is behind wall {names[behind[0]]!r}: move the wall or the grains, "
            "or turn the wall's normal towards the grains"
        )


def _make_walls(scenario: FlowScenario):
    material = [k + 1 if wall.mu is not None else 0 for k, wall in enumerate(scenario.walls)]
    mass = [wall.mass or 1.0 for wall in scenario.walls]
    if not scenario.walls:
        return flat_walls()
    normals = np.array([w.normal for w in scenario.walls])
    normals /= np.abs(normals).max(axis=1, keepdims=True)  # keeps squares finite for any length
    return flat_walls([w.point for w in scenario.walls], normals, mass=mass, material=material)


def _place_grains(scenario: FlowScenario, radius, rng) -> np.ndarray:
    """Place grains on a lattice from the bottom up, with random displacements and no contacts; return (N, 3)."""
    chosen, dim, largest = scenario.grains, scenario.grains.dim, float(radius.max())
    low, high = np.array(chosen.low), np.array(chosen.high)
    wide = 2 * largest * (1 + chosen.gap)
    counts = np.floor((high - low) / wide * (1 + 1e-12))
    cells, sites = float(np.prod(counts)), np.zeros((0, 3))
    if 0 < cells <= 1e8:
        number = counts.astype(int)
        step = (high - low) / number
        step[1] = wide  # from the bottom up
        rows = -(-len(radius) // int(cells // number[1]))
        lines = [low[k] + (np.arange(number[k]) + 0.5) * step[k] for k in range(dim)]
        sites = _free_sites(scenario, lines, largest * (1 + JITTER * chosen.gap), len(radius), rows)
    elif cells:
        raise ScenarioError(f"the region of grains has room for {cells:.0e} grains: use a smaller region")
    if len(sites) < len(radius):
        raise ScenarioError(
            f"grains.number = {len(radius)} is too large, as the region from {list(chosen.low)} to "
            f"{list(chosen.high)} has room for {len(sites)} grains of radius {largest:.4g} clear of walls and plates: "
            "use a larger region, fewer grains or a smaller gap"
        )
    out = sites[: len(radius)]
    out[:, :dim] += rng.uniform(-1, 1, (len(out), dim)) * JITTER * chosen.gap * largest
    return out


def _free_sites(scenario: FlowScenario, lines, reach: float, wanted: int, rows: int) -> np.ndarray:
    """Return lattice sites, from the bottom up, that are at least `reach` away from walls and plate grains."""
    walls, most = _make_walls(scenario), float(np.max(scenario.grains.radius)) * (1 + scenario.grains.polydispersity)
    free, total = [np.zeros((0, 3))], 0
    for start in range(0, len(lines[1]), rows):
        part = np.meshgrid(lines[1][start : start + rows], *lines[2:], lines[0], indexing="ij")
        y, *z, x = (p.ravel() for p in part)
        sites = np.stack([x, y, z[0] if z else np.zeros(len(x))], axis=1)
        good = (heights(sites, walls) >= reach * (1 - 1e-9)).all(axis=1)
        for plate in scenario.plates:
            good &= np.abs(y - plate.height) >= reach + (plate.radius or most)
        free.append(sites[good])
        total += good.sum()
        if total >= wanted:
            break
    return np.concatenate(free)


def _plate_grains(plate: Plate, scenario: FlowScenario, radius) -> tuple[np.ndarray, float]:
    """Return the positions of a plate's grains and their radius."""
    dim, size = scenario.grains.dim, plate.radius or float(np.mean(radius))
    spacing = 2.4 * size if plate.spacing is None else plate.spacing
    if spacing < 2 * size:
        raise ScenarioError(
            f"plate {plate.name!r} has spacing = {spacing:g}, below the diameter {2 * size:g} of its grains: "
            f"use a larger spacing"
        )
    lengths = [scenario.cell.size[k] for k in range(dim) if k != 1]
    # the number of grains that fills the length without overlap, at a spacing closest to the requested one
    number = [min(round(length / spacing), int(length / (2 * size) * (1 + 1e-12))) for length in lengths]
    if min(number) < 1:
        raise ScenarioError(
            f"plate {plate.name!r} has spacing = {spacing:g}, longer than the cell ({min(lengths):g}): use a "
            f"smaller spacing"
        )
    wide = max(length / n for length, n in zip(lengths, number, strict=True)) * (1 if dim == 2 else np.sqrt(2))
    if wide >= 2 * (size + float(radius.min())):
        raise ScenarioError(
            f"plate {plate.name!r} has holes of {wide - 2 * size:.3g} between its grains, through which the smallest "
            f"grain (diameter {2 * radius.min():.3g}) would fall: use a smaller spacing or a larger radius"
        )
    many = Size(f"plate {plate.name!r} would have", float(np.prod(np.array(number, float))), "grains",
                "use larger ones or a smaller cell")  # fmt: skip
    require_sizes([many], ScenarioError)
    lines = [(np.arange(n) + 0.5) * length / n for n, length in zip(number, lengths, strict=True)]
    mesh = [part.ravel() for part in np.meshgrid(*lines, indexing="ij")]
    row = np.zeros((len(mesh[0]), 3))
    row[:, 0], row[:, 1] = mesh[0], plate.height
    if dim == 3:
        row[:, 2] = mesh[1]
    return row, size


def initial_plate_force(plate: Plate, scenario: FlowScenario) -> float | None:
    """Return the initial force on a plate along y, or None; scenario forces are positive towards the grains."""
    if plate.force is None and plate.pressure is None:
        return None
    area = float(np.prod([scenario.cell.size[k] for k in range(scenario.grains.dim) if k != 1]))
    return inward_sign(plate, scenario) * (plate.force if plate.pressure is None else plate.pressure * area)


def inward_sign(plate: Plate, scenario: FlowScenario) -> float:
    """Return +1 for a plate below the middle of the region of grains and −1 for one above."""
    return 1.0 if plate.height < (scenario.grains.low[1] + scenario.grains.high[1]) / 2 else -1.0


def _time_step(scenario: FlowScenario, law: Law, radius, mass) -> float:
    """Return dt for the contact stiffness at the overlap reached in the hardest expected collision.

    The initial state cannot be used: it has no contacts, and the Hertz stiffness increases with overlap. The collision
    speed is that of a fall through the region, plus the largest prescribed velocity. A force on a plate or wall may
    cause a larger overlap.
    """
    lightest, r_eff = float(mass.min()), float(radius.min()) / 2
    # the overlap at which a contact carries the largest force and stores the energy of the collision
    gravities = [g for g in (scenario.gravity, *(s.gravity for s in scenario.stages)) if g is not None]
    g = max((float(np.linalg.norm(v)) for v in gravities), default=0.0)
    height = float(np.linalg.norm(np.subtract(scenario.grains.high, scenario.grains.low)))
    motions = [body.velocity for body in (*scenario.walls, *scenario.plates)]
    motions += [motion for stage in scenario.stages for motion in stage.velocity.values()]
    fastest = 0.0
    for course in (course for motion in motions for course in motion.prescribed.values()):
        values = [v for _, v in course] if isinstance(course, tuple) else [course]
        fastest = max(fastest, *(abs(v.amplitude if isinstance(v, Shaking) else v) for v in values))
    speed = float(np.sqrt(2 * g * height)) + fastest
    pushes = [abs(p) for p in (initial_plate_force(plate, scenario) for plate in scenario.plates) if p is not None]
    pushes += [abs(w.force) for w in scenario.walls if w.force is not None]
    pushes += [abs(f) for stage in scenario.stages for f in stage.force.values()]
    span = scenario.cell.size or np.subtract(scenario.grains.high, scenario.grains.low)
    share = np.prod([4 * r_eff / span[k] for k in range(scenario.grains.dim) if k != 1])
    static = max(pushes, default=0.0) * min(float(share), 1.0)
    energy = 0.25 * float(mass[: len(radius)].max()) * speed**2
    low, high = 0.0, 2 * r_eff
    for _ in range(60):  # up to one radius, beyond which no law is meaningful
        middle = 0.5 * (low + high)
        force, stored = evaluate(law, "force", "energy", overlap=middle, r_eff=r_eff)
        low, high = (middle, high) if stored < energy or force < static else (low, middle)
    unit = float(np.sqrt(lightest / largest_stiffness(law, r_eff, max(high, 1e-12 * r_eff))))
    if scenario.dt is not None and scenario.dt > LIMIT * unit:
        raise ScenarioError(
            f"dt = {scenario.dt:g} exceeds the largest stable value for six contacts on the lightest grain, "
            f"{LIMIT * unit:.3g}: use a smaller one, or leave dt out to use {SAFETY * unit:.3g}"
        )
    dt = scenario.dt or SAFETY * unit
    texts = f"with dt = {dt:.3g}, the stages take", "use softer grains or shorter stages"
    require_sizes([Size(texts[0], scenario.duration / dt, "time steps", texts[1])], ScenarioError)
    return dt


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

    In LAMMPS, a stage with `until = "rest"` lasts its whole duration.

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
    """Return the conditions of the last stage in `begins`, the start times so far; if empty, the initial conditions."""
    bodies = {body.name: body for body in (*scenario.walls, *scenario.plates)}
    motion: dict[str, dict] = {}  # bodies are fixed along other axes
    for name, body in bodies.items():
        motion[name] = {axis: ("velocity", course, 0.0) for axis, course in body.velocity.prescribed.items()}
    for plate in scenario.plates:
        if (push := initial_plate_force(plate, scenario)) is not None:
            motion[plate.name]["y"] = ("force", push)
    for wall in scenario.walls:
        if wall.force is not None:
            motion[wall.name][force_axis(wall)] = ("force", wall.force * _normal_sign(wall))
    conditions = StageConditions(
        tuple(wall.name for wall in scenario.walls), motion, scenario.gravity or (0.0,) * scenario.grains.dim,
        scenario.drag,
    )  # fmt: skip
    for stage, begin in zip(scenario.stages, begins, strict=False):
        motion = {name: dict(axes) for name, axes in motion.items()}
        for name, moves in stage.velocity.items():
            motion[name] |= {axis: ("velocity", course, begin) for axis, course in moves.prescribed.items()}
        for name, size in stage.force.items():
            body = bodies[name]
            sign = inward_sign(body, scenario) if isinstance(body, Plate) else _normal_sign(body)
            motion[name][force_axis(body)] = ("force", sign * size)
        conditions = StageConditions(
            tuple(name for name in conditions.walls if name not in stage.remove), motion,
            stage.gravity or conditions.gravity, conditions.drag if stage.drag is None else stage.drag,
        )  # fmt: skip
    return conditions


def _normal_sign(wall) -> float:
    """Return the sign of a wall's normal along its axis."""
    return float(np.sign(sum(wall.normal)))


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
    waves, n = {}, len(state.grains.radius)  # sinusoidal velocities, which LAMMPS evaluates as formulas
    for name in (*conditions.walls, *start.plates):
        row = start.plates[name][0] if name in start.plates else n + conditions.walls.index(name)
        for axis, way in conditions.motion[name].items():
            if way[0] == "velocity" and isinstance(shaking := way[1], Shaking):
                column = int(state.control.follows[row, AXES.index(axis)])
                waves[column] = Wave(shaking.amplitude, shaking.frequency, shaking.phase, way[2])
    return Leg(
        state, start.law, start.dt, steps, sample_count(stage, scenario) - done, conditions.drag, before=(done, before),
        walls=walls, waves=waves, number=number, ranks=scenario.ranks,
    )  # fmt: skip
