"""Measures of a flow: its deposit, its velocity profile and, in plane shear, its friction and inertial number."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .... import State
from ....kit import Bodies, body_numbers, checked, readable, require_filled, require_index
from ....measure import inertial_number, wrapped
from .simulate import FlowResult


@readable
class Deposit(NamedTuple):
    """The largest cluster of grains separated by gaps smaller than a radius, excluding grains that fly or roll away."""

    grains: np.ndarray  # indices
    low: np.ndarray  # (3,) lower corner of the bounding box, including radii [length]
    high: np.ndarray  # (3,) upper corner [length]


@readable
class PlaneShear(NamedTuple):
    """Steady shear between two plates: means and a standard deviation over the second half of the last stage."""

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
    """Return the measures of plane shear, or None unless two plates move relative to each other along x at the end.

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
    """Select the samples in the second half of the last stage, (T,) bool."""
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
