"""Simulation of a flow in stages, which run in chunks between samples; also measures, output files and summary.

Measures are those of the deposit, the velocity profile, and the friction of plane shear.
"""

import time
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .... import FROZEN, SLIDE, Law, State, forces
from ....kit import (
    ArchiveError,
    Bodies,
    Engine,
    Fields,
    Measures,
    Quantity,
    Report,
    archive_fields,
    body_numbers,
    checked,
    checkpoint_in,
    console,
    heading,
    least_supports,
    new_table,
    own_engine,
    readable,
    require_filled,
    require_index,
    result_of,
    show_table,
    silent,
    units_of,
    with_unit,
    write_table,
)
from ....measure import (
    contact_forces,
    coordination,
    elastic_energy,
    inertial_number,
    touching,
    unbalanced_forces,
    wrapped,
)
from ....packings import without_walls
from . import EXPERIMENT
from .pouring import Poured, lammps_of, poured, sample_count, stage_conditions, stage_leg, with_controls
from .scenario import FlowScenario

BINS = 24  # number of bins of the profile along y
SAVE_EVERY = 20.0  # time after which a piece is saved even if no frame is due [s]
ENCLOSED = 0.99  # fraction of the grains below `high`, and fraction above `low`


@readable
class FlowSeries(NamedTuple):
    """Time series with T rows for the poured grains, W walls and P plates, in the order of the scenario."""

    time: np.ndarray  # (T,) [time]
    stage: np.ndarray  # (T,) index of the stage that the sample belongs to
    kinetic_energy: np.ndarray  # (T,) translations and rotations [energy]
    elastic_energy: np.ndarray  # (T,) stored in normal springs, plates included [energy]
    speed: np.ndarray  # (T,) mean [length/time]
    unbalanced: np.ndarray  # (T,) mean unbalanced force over mean contact force; infinite without contacts [1]
    coordination: np.ndarray  # (T,) mean number of contacts of grains that are not rattlers [1]
    sliding_fraction: np.ndarray  # (T,) fraction of contacts at the Coulomb limit [1]
    center: np.ndarray  # (T, 3) centre of mass [length]
    low: np.ndarray  # (T, 3) position along each axis below which 1 % of the grains' centres lie [length]
    high: np.ndarray  # (T, 3) position above which 1 % of the grains' centres lie [length]
    wall_point: np.ndarray  # (T, W, 3) [length], NaN after removal
    wall_force: np.ndarray  # (T, W, 3) force of the grains on the wall [force], NaN after removal
    plate_position: np.ndarray  # (T, P, 3) position of the plate's centre [length]
    plate_force: np.ndarray  # (T, P, 3) force of the grains on the plate [force]
    profile_count: np.ndarray  # (T, BINS) number of grains by height
    profile_velocity: np.ndarray  # (T, BINS, 3) mean velocity by height, NaN without grains [length/time]


class StageEnd(NamedTuple):
    """End of a stage."""

    name: str
    start: float  # [time]
    end: float  # [time]
    rested: bool | None  # True if rest was reached; None if not requested


@result_of(EXPERIMENT)
class FlowResult(NamedTuple):
    """Result of a flow scenario."""

    scenario: FlowScenario
    law: Law
    poured: Poured
    stages: tuple[StageEnd, ...]
    series: FlowSeries
    edges: np.ndarray  # (BINS + 1,) heights of the bin edges of the profile [length]
    frames: tuple[State, ...]  # at the start, at the ends of stages, and in between
    frame_walls: tuple[tuple[str, ...], ...]  # names of the walls that remain in each frame


class Piece(NamedTuple):
    """Part of a run since the previous saved piece, and the state from which it continues."""

    stage: int
    begin: float  # start of the stage [time]
    samples: int  # number of finished samples of the stage
    rows: dict[str, np.ndarray]  # columns of `FlowSeries`
    state: State
    frame: bool  # True if the state is a frame of the result
    end: StageEnd | None  # end of the stage, if it is finished


@checked
def simulate_flow(
    scenario: FlowScenario, *, folder: Path | None = None, threads: int | None = None, report: Report = silent
) -> FlowResult:
    """Pour the grains of a scenario and run its stages.

    Parameters
    ----------
    folder : folder in which frames are saved during the run. An interrupted run resumes from them, with a result
        bitwise identical to that of an uninterrupted run
    threads : as in `run`
    report : called as report(stage, share done, text) after every sample

    Raises
    ------
    ScenarioError
        If grains, walls, plates and dt are incompatible; raised before the run.
    RuntimeError
        If a grain moves more than a radius in one step or a position is not a number.
    """
    start, checkpoint = poured(scenario), checkpoint_in(folder, scenario, Piece, StageEnd)
    chosen = find_engine(scenario, start, folder, threads)
    names = checkpoint.names if checkpoint else []
    for k, name in enumerate(names):
        if name != f"{k:06d}":
            raise ArchiveError(f"piece {k:06d} is missing from {checkpoint.folder}: start again with --overwrite")
    pieces = [checkpoint.load(name, Piece) for name in names]

    def keep(piece):
        if checkpoint:
            checkpoint.save(f"{len(pieces):06d}", piece)
        pieces.append(piece)

    for number in range(len(scenario.stages)):
        if not any(piece.end for piece in pieces if piece.stage == number):
            _run_stage(scenario, start, number, pieces, keep, chosen, report)
    series = FlowSeries(*(np.concatenate([piece.rows[name] for piece in pieces]) for name in FlowSeries._fields))
    shown = [piece for piece in pieces if piece.frame]
    walls = [stage_conditions(scenario, [0.0] * (piece.stage + 1)).walls for piece in shown]
    return FlowResult(
        scenario, start.law, start, tuple(piece.end for piece in pieces if piece.end), series, _bin_edges(start),
        (start.state, *(piece.state for piece in shown)), (start.walls, *walls),
    )  # fmt: skip


def _run_stage(
    scenario: FlowScenario, start: Poured, number: int, pieces: list[Piece], keep, engine: Engine, report: Report
) -> None:
    """Run the rest of a stage; `keep` appends to the pieces."""
    stage, edges = scenario.stages[number], _bin_edges(start)
    state, begin, done, conditions = _enter_stage(scenario, start, number, pieces)
    count = sample_count(stage, scenario)
    every = max(1, round(scenario.samples / scenario.frames))
    total, rows, saved = sum(len(piece.rows["time"]) for piece in pieces), [], time.monotonic()
    leg = stage_leg(scenario, start, number, conditions, state, begin, done)
    with closing(engine.pieces(leg)) as states:
        for k, (state, _) in enumerate(states, start=done):
            rows.append(_measure(state, start, conditions.walls, number, edges))
            row = rows[-1]
            calm = (
                row["unbalanced"] < stage.unbalanced and row["kinetic_energy"] < stage.kinetic * row["elastic_energy"]
            )
            summary, rests = _describe_row(row), stage.until == "rest" and calm
            over = (rests and engine.stops) or k + 1 == count
            frame = over or (total + k + 1 - done) % every == 0
            if frame or time.monotonic() - saved > SAVE_EVERY:
                end = StageEnd(stage.name, begin, state.time, rests if stage.until else None) if over else None
                columns = Fields(
                    {name: np.array([row[name] for row in rows]) for name in FlowSeries._fields}, FlowSeries
                )
                keep(Piece(number, begin, k + 1, columns, state, frame, end))
                rows, saved = [], time.monotonic()
            report(stage.name, (k + 1) / count, f"{summary}, {sum(piece.frame for piece in pieces)} frames saved")
            if over:
                return


def _enter_stage(scenario: FlowScenario, start: Poured, number: int, pieces: list[Piece]):
    """Return the state, the start time of the stage, its finished samples and its conditions."""
    last = pieces[-1] if pieces else None
    begins = [piece.end.start for piece in pieces if piece.end]
    if last and last.stage == number:
        return last.state, last.begin, last.samples, stage_conditions(scenario, [*begins, last.begin])
    state = last.state if last else start.state
    before, conditions = stage_conditions(scenario, begins), stage_conditions(scenario, [*begins, state.time])
    begin, stage = state.time, scenario.stages[number]
    state = without_walls(state, [k for k, name in enumerate(before.walls) if name in stage.remove])
    return with_controls(state, start, conditions, begin + stage.duration), begin, 0, conditions


def _bin_edges(start: Poured) -> np.ndarray:
    """Return the (BINS + 1,) edges between the bins of the profile [length]."""
    height = start.state.grains.position[:, 1]
    return np.linspace(height.min(), height.max(), BINS + 1)


def find_engine(scenario: FlowScenario, start: Poured, folder: Path | None, threads: int | None) -> Engine:
    """Return the engine for a scenario.

    Raises
    ------
    ScenarioError
        If the engine cannot run this scenario.
    MissingExtraError
        If the engine is not installed. The message contains the installation command.
    """
    if scenario.engine == "stickslip":
        return own_engine(threads)
    return lammps_of(scenario, start, folder)


def _measure(state: State, start: Poured, walls: tuple[str, ...], number: int, edges) -> dict:
    """Return one row of the time series."""
    grains, loose, n = state.grains, start.loose, len(state.grains.radius)
    loads, _ = forces(state, start.law, memory=FROZEN)
    velocity, position, mass = grains.velocity[loose], grains.position[loose], grains.mass[loose]
    rows = touching(state)
    between = np.linalg.norm(contact_forces(state, start.law)[rows], axis=1)
    pull = np.linalg.norm(unbalanced_forces(state, loads)[loose, :3], axis=1).mean()
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
        "coordination": coordination(state, least_supports(start.law, state.cell.dim)),
        "sliding_fraction": (state.contacts.mode[rows] == SLIDE).mean() if len(rows) else 0.0,
        "center": mass @ position / mass.sum(),
        "low": np.quantile(position, 1 - ENCLOSED, axis=0),
        "high": np.quantile(position, ENCLOSED, axis=0),
        "wall_point": np.array([state.walls.point[w] if w >= 0 else nothing for w in here]).reshape(-1, 3),
        "wall_force": np.array([loads.force[n + w] if w >= 0 else nothing for w in here]).reshape(-1, 3),
        "plate_position": np.array([grains.position[p].mean(axis=0) for p in plates]).reshape(-1, 3),
        "plate_force": np.array([loads.force[p].sum(axis=0) for p in plates]).reshape(-1, 3),
        "profile_count": count,
        "profile_velocity": np.where(count[:, None] > 0, sums / np.maximum(count, 1)[:, None], np.nan),
    }


def _describe_row(row: dict) -> str:
    """Describe a row for progress reports."""
    return (
        f"t = {row['time']:.4g}, kinetic {row['kinetic_energy']:.1e}, unbalanced {row['unbalanced']:.0e}, "
        f"z {row['coordination']:.1f}, {row['sliding_fraction']:.0%} sliding, speed {row['speed']:.1e}"
    )


def simulate_on_workers(scenario: FlowScenario, *, workers: int | None = None, **options) -> FlowResult:
    """Run a scenario; the signature is that of all experiments, and `workers` is the number of threads of the run."""
    return simulate_flow(scenario, threads=workers, **options)


@readable
class Deposit(NamedTuple):
    """Largest cluster of grains with gaps smaller than a radius, which excludes grains that fly or roll away."""

    grains: np.ndarray  # indices
    low: np.ndarray  # (3,) lower corner of the bounding box, including radii [length]
    high: np.ndarray  # (3,) upper corner [length]


@readable
class PlaneShear(NamedTuple):
    """Steady shear between two plates: means and standard deviation over the second half of the last stage."""

    friction: float  # shear over normal force on the upper plate [1]
    friction_deviation: float
    pressure: float  # normal force over length or area of the cell [force/length^(dim−1)]
    shear_rate: float  # velocity difference over the height between the plates' surfaces [1/time]
    inertial_number: float
    packing_fraction: float  # poured grains over the space between the plates' surfaces [1]
    height: float  # distance between the plates' surfaces [length]


@checked
def deposit(state: State, loose: Bodies) -> Deposit:
    """Return the deposit of a state; `loose` are the indices of the poured grains.

    Examples
    --------
    >>> import stickslip as ss
    >>> row = ss.assembly(ss.disks([[0, 0.5], [1, 0.5], [2, 0.5], [8, 0.5]], 0.5))
    >>> deposit(row, np.arange(4)).high
    array([2.5, 1. , 0.5])
    """
    loose = body_numbers(state.control, loose)
    require_filled("loose", loose)
    require_index(len(state.grains.radius), loose=int(loose.max()))
    n, position = len(loose), wrapped(state)[loose]
    reach, size = 3 * float(state.grains.radius[loose].mean()), np.diag(state.cell.vectors)
    near = cKDTree(position, boxsize=np.where(state.cell.periodic, size, 0.0))
    pairs = near.query_pairs(reach, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n))
    label = connected_components(graph, directed=False)[1]
    members = loose[label == np.bincount(label).argmax()]
    position, radius = wrapped(state)[members], state.grains.radius[members, None]
    return Deposit(members, (position - radius).min(axis=0), (position + radius).max(axis=0))


@checked
def plane_shear(result: FlowResult) -> PlaneShear | None:
    """Return the measures of plane shear; None unless two plates move relative to each other along x at the end.

    I = γ̇ d √(ρ/P) with the mean diameter d and the grains' density ρ.

    Source
    ------
    GDR MiDi, doi:10.1140/epje/i2003-10153-0.
    """
    series, state, scenario = result.series, result.frames[-1], result.scenario
    if len(result.poured.plates) != 2:
        return None
    late = second_half(result)
    names = list(result.poured.plates)
    upper = int(np.argmax(series.plate_position[late, :, 1].mean(axis=0)))
    members = [result.poured.plates[names[k]] for k in (1 - upper, upper)]
    below, above = (state.grains.velocity[m, 0].mean() for m in members)
    force = series.plate_force[late, upper]
    if above == below or not force[:, 1].mean() > 0:
        return None
    radii = sum(float(state.grains.radius[m[0]]) for m in members)
    distance = series.plate_position[late, upper, 1] - series.plate_position[late, 1 - upper, 1]
    height = float(distance.mean()) - radii
    lengths = [scenario.cell.size[k] for k in range(scenario.grains.dim) if k != 1]
    area, grains = float(np.prod(lengths)), state.grains
    radius, mass = grains.radius[result.poured.loose], grains.mass[result.poured.loose]
    volume = float((np.pi * radius**2 if scenario.grains.dim == 2 else 4 / 3 * np.pi * radius**3).sum())
    pressure, rate = float(force[:, 1].mean()) / area, float(above - below) / height
    friction = -np.sign(rate) * force[:, 0] / force[:, 1].mean()
    return PlaneShear(
        float(friction.mean()), float(friction.std()), pressure, rate,
        inertial_number(rate, pressure, diameter=2 * float(radius.mean()), density=float(mass.sum()) / volume),
        volume / (area * height), height,
    )  # fmt: skip


def second_half(result: FlowResult) -> np.ndarray:
    """Mask of the samples in the second half of the last stage (T,)."""
    last = result.stages[-1]
    return result.series.time > 0.5 * (last.start + last.end)


@checked
def velocity_profile(result: FlowResult) -> np.ndarray:
    """Mean velocity (BINS, 3) of the grains at each height in the second half of the last stage.

    NaN where there are no grains.
    """
    late = second_half(result)
    count, velocity = result.series.profile_count[late], result.series.profile_velocity[late]
    total = count.sum(axis=0)[:, None]
    sums = np.where(count[..., None] > 0, velocity, 0.0) * count[..., None]
    return np.where(total > 0, sums.sum(axis=0) / np.maximum(total, 1), np.nan)


def profile_deviation(result: FlowResult) -> np.ndarray:
    """Standard deviation over time (BINS, 3) of the velocities averaged by `velocity_profile`.

    NaN where there are no grains.
    """
    late = second_half(result)
    count, velocity = result.series.profile_count[late], result.series.profile_velocity[late]
    total = count.sum(axis=0)[:, None]
    off = np.where(count[..., None] > 0, velocity - velocity_profile(result), 0.0)
    squares = (off**2 * count[..., None]).sum(axis=0)
    return np.where(total > 0, np.sqrt(squares / np.maximum(total, 1)), np.nan)


PRESSURE = "force/length^(dim-1)"


def figures(result: FlowResult):
    """Yield (file name, Figure) of a run."""
    from . import figures as figures_of

    yield "fig1_snapshots.png", figures_of.snapshots(result)
    yield "fig2_time_series.png", figures_of.time_series(result)
    if result.poured.plates or "x" in result.scenario.cell.periodic:
        profile = figures_of.velocity_profile(result.edges, velocity_profile(result), profile_deviation(result))
        yield "fig3_velocity_profile.png", profile


def files(result: FlowResult):
    """Yield (file name, function that writes it) for the time series as CSV."""
    yield "series.csv", partial(_write_series, result)


def numbers(result: FlowResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    extra, shear = {}, plane_shear(result)
    if shear:
        extra["plane_shear"] = archive_fields(shear)
    tree = {
        "scenario": result.scenario.text,
        "law": result.law,
        "dt": result.poured.dt,
        "walls": "\n".join(result.poured.walls),
        "plates": result.poured.plates,
        "stages": {
            f"{k:02d}": Fields({"name": s.name, "start": s.start, "end": s.end, "rested": str(s.rested)}, StageEnd)
            for k, s in enumerate(result.stages)
        },
        "series": archive_fields(result.series),
        "profile": Fields(
            {"edges": result.edges, "velocity": velocity_profile(result)},
            FlowResult,
            velocity=units_of(FlowSeries)["profile_velocity"],
        ),
        "frame_walls": {f"{k:04d}": "\n".join(names) for k, names in enumerate(result.frame_walls)},
        "frames": {f"{k:04d}": state for k, state in enumerate(result.frames)},
        "units": "those of the scenario",
        **extra,
    }
    return Fields(tree, Poured)


def _write_series(result: FlowResult, path: Path) -> None:
    """Write a header and one row per sample.

    Columns of vectors end with _x, _y and _z; those of walls and plates begin with their names.
    """
    series, columns, units = result.series, {}, units_of(FlowSeries)
    bodies = {"wall": result.poured.walls, "plate": tuple(result.poured.plates)}
    for name in FlowSeries._fields:
        values, kind, unit = getattr(series, name), name.split("_")[0], units.get(name, "1")
        if kind in bodies:
            for k, body in enumerate(bodies[kind]):
                what = f"{body}_{name.split('_')[1]}".replace(",", " ")
                columns |= {heading(f"{what}_{a}", unit): values[:, k, m] for m, a in enumerate("xyz")}
        elif values.ndim == 1:
            columns[heading(name, unit)] = values
        elif name in ("center", "low", "high"):
            columns |= {heading(f"{name}_{a}", unit): values[:, m] for m, a in enumerate("xyz")}
    write_table(path, columns, zip(*columns.values(), strict=True))


def show(result: FlowResult) -> None:
    """Print the end of each stage and the measures of plane shear."""
    units = {"until": "time", "energy": "energy", "deposit along x": "length", "top": "length"}
    names = ("stage", "until", "energy", "unbalanced", "z", "deposit along x", "top")
    table = new_table(*names, title="Stages", units=units)
    series, around = result.series, "x" in result.scenario.cell.periodic
    for number, stage in enumerate(result.stages):
        k = np.flatnonzero(series.stage == number)[-1]
        left = deposit(next(f for f in result.frames if f.time == stage.end), result.poured.loose)
        table.add_row(
            stage.name, f"{stage.end:.4g}", f"{series.kinetic_energy[k]:.1e}",
            f"{series.unbalanced[k]:.1e}", f"{series.coordination[k]:.3g}",
            "periodic" if around else f"{left.low[0]:.3g} … {left.high[0]:.3g}", f"{left.high[1]:.3g}",
        )  # fmt: skip
    show_table(table)
    for stage in result.stages:
        if stage.rested is False:
            warning = (
                f"stage {stage.name!r} reached its duration before the grains came to rest: "
                "use a longer duration or more drag"
            )
            console.print(warning, style="yellow")
    if shear := plane_shear(result):
        console.print(
            f"Plane shear: friction {shear.friction:.3f} ± {shear.friction_deviation:.3f} (standard deviation in time) "
            f"at pressure {with_unit(f'{shear.pressure:.4g}', PRESSURE)}, shear rate "
            f"{with_unit(f'{shear.shear_rate:.3g}', '1/time')}, inertial number "
            f"{shear.inertial_number:.2e}, packing fraction {shear.packing_fraction:.3f}."
        )


class Flow(NamedTuple):
    """Result of a flow, its final deposit and its plane shear, from which `MEASURES` are computed."""

    series: FlowSeries
    deposit: Deposit
    shear: PlaneShear | None
    around: bool  # True if the cell is periodic along x, so that the deposit has no ends


def _of_shear(name: str, meaning: str, unit: str = "1") -> Quantity:
    return Quantity(f"plane_{name}", unit, meaning, lambda flow: getattr(flow.shear, name, None))


MEASURES = Measures([
    Quantity("end", "time", "end of the last stage", lambda flow: flow.series.time[-1]),
    Quantity("kinetic_energy", "energy", "kinetic energy at the end", lambda flow: flow.series.kinetic_energy[-1]),
    Quantity("coordination", "1", "mean contact number at the end", lambda flow: flow.series.coordination[-1]),
    Quantity("deposit_top", "length", "height of the deposit", lambda flow: flow.deposit.high[1]),
    Quantity("grains_in_deposit", "1", "grains in the deposit", lambda flow: len(flow.deposit.grains)),
    Quantity("deposit_length", "length", "length of the deposit along x, unless the cell is periodic",
             lambda flow: None if flow.around else flow.deposit.high[0] - flow.deposit.low[0]),
    Quantity("run_out", "length", "largest x of the deposit", lambda f: None if f.around else f.deposit.high[0]),
    _of_shear("friction", "shear over normal force on the upper of two plates"),
    _of_shear("friction_deviation", "standard deviation in time of this friction"),
    _of_shear("pressure", "normal force over the area of the plate", PRESSURE),
    _of_shear("shear_rate", "relative velocity of the plates over their distance", "1/time"),
    _of_shear("inertial_number", "inertial number between the plates"),
    _of_shear("packing_fraction", "packing fraction between the plates"),
    _of_shear("height", "distance between the plates", "length"),
], subject=lambda r: Flow(r.series, deposit(r.frames[-1], r.poured.loose), plane_shear(r),
                          "x" in r.scenario.cell.periodic))  # fmt: skip
