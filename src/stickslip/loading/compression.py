"""Frictional packings: loose grains compressed slowly, with friction, until they carry a given pressure."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from ..core.arguments import Seed, Values, checked, require_not_negative, require_positive
from ..core.contacts.forces import forces
from ..core.control import stress_controlled
from ..core.dynamics.run import run
from ..core.dynamics.timestep import stable_time_step
from ..core.laws.builtin import Law, hertz_mindlin
from ..core.measure import coordination, packing_fraction, volume
from ..core.measure import pressure as pressure_of
from ..core.outcome import NotInEquilibriumError, Outcome
from ..core.progress import Report, silent
from ..core.scales import natural_scales
from ..core.state import State, assembly, box, disks, loads, resting, spheres
from ..solve.equilibrate import BALANCED
from ..solve.newton import newton
from ..solve.quench import quench
from .packing import DENSEST, frictionless, packing_info, random_grains

LOOSE = {2: 0.72, 3: 0.50}  # packing fractions at the start, below those of random loose packings
DEEPEST = 0.25  # largest overlap of a contact that carries the pressure, over the smallest radius
RESOLVED = 1e3  # least force of such a contact over the tolerance
SHARE = 0.15  # time step over the stable one of such a contact
AT_REST = (1e-4, 1e-6, 1e-8)  # unbalanced forces at which Newton's method is tried, over that of such a contact
CRITICAL = 4.0  # drag of grains and cell times the time scale
BLOCK, LONGEST = 0.02, 2000  # linear strain of loose grains between two reports, and largest number of steps
STEPS = 20_000_000  # largest number
NARROWEST = 2  # smallest width of the loose cell over the largest diameter


class Scales(NamedTuple):
    """Scales of a packing under a pressure, from one contact that carries the force F = p d^(dim−1)."""

    force: float  # F [force]
    time: float  # √(m d/F), in which the pressure moves a grain by its diameter [time]
    stiffness: float  # k d/F, the stiffness of the contact over that of the pressure
    dt: float  # time step [time]


@checked
def compressed(
    n: int,
    *,
    pressure: float,
    mu: float | None = None,
    dim: int = 3,
    radius: Values = (0.5, 0.7),
    mass: Values = 1.0,
    law: Law | None = None,
    seed: Seed = 0,
    tolerance: float | None = None,
    report: Report = silent,
):
    """Frictional packing in a periodic box, compressed slowly from a loose state until it carries a pressure.

    Grains that do not touch are compressed by a cell whose normal strains follow the stress, σ_xx = σ_yy = σ_zz = p.
    Drag brings them to rest, and Newton's method balances forces and pressure. Friction acts from the first contact on,
    so that the contact number lies between 2 dim without friction and dim + 1 with much of it; the distance to the
    latter is set by μ and p. The cell's inertia and the drag are such that the pressure is approached without
    oscillation, at inertial numbers near p/k, the pressure over the stiffness of a contact.

    Parameters
    ----------
    pressure : float [force/length^(dim−1)]
    mu : friction coefficient, not negative, of the law `hertz_mindlin(mu=mu)`; give this or a law
    dim, radius, mass, seed, tolerance : as in `jammed`
    law : Law with which to compress
    report : called as report(stage, share, text) during the compression, with the share of the pressure that was
        reached, and a text that gives pressure, unbalanced force, contact number and packing fraction

    Returns
    -------
    State, PackingInfo
        the state is at rest in a cell that is held fixed. The least number of contacts of a grain that is not a
        rattler is 2, without friction dim + 1

    Raises
    ------
    ValueError
        if an argument is invalid, or grains under this law cannot carry the pressure.
    NotInEquilibriumError
        if the pressure was not reached; the message says how far the compression got.

    Source
    ------
    Quasi-static compression with friction, as in Silbert, doi:10.1039/c001973a; generalised isostaticity: Shundyak
    et al., doi:10.1103/PhysRevE.75.010301.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, info = ss.packings.compressed(20, mu=0.5, pressure=1e-3, dim=2, seed=1)
    >>> round(info.pressure, 9), info.coordination < 4
    (0.001, True)
    """
    if (mu is None) == (law is None):
        raise ValueError("give either mu or a law")
    require_positive(pressure=pressure)
    require_not_negative(mu=mu)
    law = hertz_mindlin(mu=mu) if law is None else law
    start = random_grains(n, LOOSE.get(dim, 1.0), dim, radius=radius, mass=mass, i0=None, seed=seed)
    if _width(start) < NARROWEST * 2 * start.grains.radius.max():
        raise ValueError(
            f"{n} grains were given: their cell would be narrower than {NARROWEST} of the largest grains, so that "
            f"it could collapse; use more grains"
        )
    tolerance = BALANCED * natural_scales(start, law).force if tolerance is None else tolerance
    require_positive(tolerance=tolerance)
    scales = compression_scales(start, law, pressure, tolerance)
    loose = quench(start, frictionless(law), 0.5 * tolerance)
    end = _compress(loose, law, pressure, scales, tolerance, report)
    end = end._replace(control=loads(n))
    return end, packing_info(end, law)


def check_pressure(law: Law, pressure: float, *, radius: np.ndarray, mass: np.ndarray, dim: int) -> None:
    """Raise ValueError with one sentence if grains under a law cannot carry a pressure."""
    position = np.zeros((len(radius), dim))
    position[:, 0] = np.cumsum(2 * radius)
    start = assembly((disks if dim == 2 else spheres)(position, radius, mass=mass), cell=box(dim=dim))
    compression_scales(start, law, pressure, BALANCED * natural_scales(start, law).force)


def compression_scales(start: State, law: Law, pressure: float, tolerance: float) -> Scales:
    """Scales of a compression; ValueError if the pressure is out of reach."""
    grains, dim = start.grains, start.cell.dim
    diameter, depth = 2 * float(grains.radius.mean()), DEEPEST * float(grains.radius.min())
    area = diameter ** (dim - 1)
    force, most = pressure * area, _force_between(start, law, depth)
    if not force <= most:
        raise ValueError(
            f"pressure = {pressure:g} was given: grains under this law would overlap by more than {DEEPEST:g} of their "
            f"radius; give at most {most / area:.2g}, or a stiffer law"
        )
    if force < RESOLVED * tolerance:
        raise ValueError(
            f"pressure = {pressure:g} was given: its contact forces of {force:.2g} are too small for a tolerance of "
            f"{tolerance:g}; give a pressure of at least {RESOLVED * tolerance / area:.2g}, or a smaller tolerance"
        )
    overlap = brentq(lambda x: _force_between(start, law, x) - force, 0.0, depth, rtol=1e-6, xtol=1e-300)
    slope = (_force_between(start, law, 1.01 * overlap) - force) / (0.01 * overlap)
    time, dt = np.sqrt(grains.mass.mean() * diameter / force), SHARE * stable_time_step(_pair(start, overlap), law)
    scales = Scales(force, float(time), slope * diameter / force, dt)
    steps = 0.1 * scales.stiffness * scales.time / scales.dt  # for a linear strain of a tenth
    if not steps <= STEPS:
        raise ValueError(
            f"pressure = {pressure:g} was given: a slow compression to it would take about {steps:.0e} steps; give a "
            f"higher pressure, or a softer law"
        )
    return scales


def _pair(start: State, overlap: float) -> State:
    """Two touching grains of the mean radius and the smallest mass of a packing."""
    grains, dim = start.grains, start.cell.dim
    radius, mass = grains.radius.mean(), grains.mass.min()
    i0 = (grains.inertia / (grains.mass * grains.radius**2)).min()
    position = np.zeros((2, 3))
    position[1, 0] = 2 * radius - overlap
    return assembly(disks(position[:, :dim], radius, mass=mass, i0=i0), cell=box(dim=dim))


def _force_between(start: State, law: Law, overlap: float) -> float:
    """Normal force between two grains of the mean radius [force], positive for repulsion."""
    return float(forces(_pair(start, overlap), law)[0].force[1, 0])


def _compress(state: State, law: Law, pressure: float, scales: Scales, tolerance: float, report) -> State:
    """Equilibrium of loose grains after slow compression by a cell that follows the stress.

    The cell approaches L = V p/(M ℓ² ν) before grains touch. With L = 1/(κ t) and the drag ν = 4/t, its mass M makes
    its oscillation against the stiffness κ p of the packing critically damped.
    """
    dim, p = state.cell.dim, pressure
    mass = critical_mass(state, p, scales)
    axes = ("xx", "yy", "zz")[:dim]
    state = state._replace(control=stress_controlled(state.control, dict.fromkeys(axes, p), mass=mass))
    block = int(np.clip(BLOCK * scales.stiffness * scales.time / scales.dt, 50, LONGEST))
    levels = iter((*(share * scales.force for share in AT_REST), 0.5 * tolerance))
    level = next(levels)
    for _ in range(STEPS // block):
        state, _, outcome = run(state, law, block, scales.dt, drag=CRITICAL / scales.time, tolerance=level)
        report("compression", *_progress(state, law, pressure, outcome))
        if outcome.broken or packing_fraction(state) > DENSEST or _width(state) < state.grains.radius.max():
            break
        if outcome.ok:
            end, outcome = newton(stopped(state), law, tolerance=tolerance)
            if outcome.ok:
                return end
            level = next(levels, level)
    raise _pressure_error(state, law, pressure, outcome)


def critical_mass(state: State, pressure: float, scales: Scales) -> float:
    """Mass with which the cell's oscillation against a packing is damped critically by the drag 4/t [mass]."""
    return volume(state) ** (1 - 2 / state.cell.dim) * pressure * scales.stiffness * scales.time**2 / CRITICAL


def _width(state: State) -> float:
    """Smallest distance between opposite faces of the cell [length]."""
    dim = state.cell.dim
    return float(1 / np.linalg.norm(np.linalg.inv(state.cell.vectors)[:dim, :dim], axis=0).max())


def stopped(state: State) -> State:
    """State that does not move, at time zero."""
    return resting(state)._replace(instant=None, time=0.0)


def _progress(state: State, law: Law, wanted: float, outcome: Outcome) -> tuple[float, str]:
    reached, number = pressure_of(state, law), coordination(state)
    progress = f"pressure {reached:.3g}, unbalanced force {outcome.residual:.1e}, contact number {number:.3f}"
    return float(np.clip(reached / wanted, 0.0, 1.0)), f"{progress}, packing fraction {packing_fraction(state):.4f}"


def _pressure_error(state: State, law: Law, wanted: float, outcome: Outcome) -> NotInEquilibriumError:
    message = f"no packing at rest under a pressure of {wanted:g} was found"
    if not outcome.broken:
        reached, fraction = pressure_of(state, law), packing_fraction(state)
        message += f", the compression ended at {reached:.3g} with a packing fraction of {fraction:.4g}"
    return NotInEquilibriumError(message, outcome)
