"""Measures of a flow (deposit, profile, friction of plane shear), and its files, archive and terminal summary."""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .... import State
from ....kit import (
    Bodies,
    Fields,
    Measures,
    Quantity,
    archive_fields,
    body_numbers,
    checked,
    console,
    heading,
    new_table,
    readable,
    require_filled,
    require_index,
    show_table,
    units_of,
    with_unit,
    write_table,
)
from ....measure import inertial_number, wrapped
from . import figures as figures_of
from .pouring import Poured
from .simulate import FlowResult, FlowSeries, StageEnd


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
    """Result of a flow, its final deposit and its plane shear, to which `MEASURES` apply."""

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
