"""Frictional packings under a pressure: compressed in a periodic box, between walls, or in a cell with free strains."""

from typing import NamedTuple

import numpy as np
import scipy  # scipy.optimize, whose import takes a tenth of a second, is imported on first use

from ..core.arguments import NotNegative, Numbers, Positive, Seed, Values, checked, require_index, require_positive
from ..core.contacts.forces import forces
from ..core.contacts.neighbors import body_positions
from ..core.control import force_controlled, spring_loaded, stress_controlled
from ..core.dynamics.run import run, stable_time_step
from ..core.laws.builtin import Law, hertz_mindlin, linear
from ..core.measure import coordination, packing_fraction, volume
from ..core.measure import pressure as pressure_of
from ..core.progress import NotInEquilibriumError, Report, silent
from ..core.scales import natural_scales
from ..core.state import Control, State, as_rows, assembly, box, disks, flat_walls, loads, resting, spheres
from ..solve.equilibrate import BALANCED, equilibrate, quench
from ..solve.newton import newton
from .packing import DENSEST, balance, check_radii, frictionless, packing_info, random_grains

LOOSE = {2: 0.72, 3: 0.50}  # packing fractions at the start, below those of random loose packings
DEEPEST = 0.25  # largest overlap of a contact that carries the pressure, in smallest radii
RESOLVED = 1e3  # smallest force of a contact that carries the pressure, in units of the tolerance
SHARE = 0.15  # time step, in units of the largest stable one for a contact that carries the pressure
AT_REST = (1e-4, 1e-6, 1e-8)  # unbalanced forces at which Newton's method is tried, relative to F in `Scales`
PATIENCE = 50  # reports at the last level after which Newton's method is tried anyway: loose grains come to rest slowly
CRITICAL = 4.0  # drag of grains and cell, times the time scale
BLOCK, LONGEST = 0.02, 2000  # linear strain of loose grains between two reports, and largest number of steps
STEPS = 20_000_000  # largest number of time steps of a compression
NARROWEST = 2  # smallest width of the loose cell, in largest diameters
LEFT, BOTTOM, RIGHT, TOP = range(4)  # walls; the first two are fixed
BOX_STEPS, BLOCKS = 20_000, 150  # boxes: steps in a block of damped dynamics, and largest number of blocks
SOFT = 0.01  # largest pressure, in units of kn; beyond it, overlaps are not small
FRACTION = 0.86  # boxes: packing fraction of the jammed packing
LOOSENED = 1.15  # expansion of the jammed packing before the walls compress it


class Scales(NamedTuple):
    """Scales of a packing under a pressure, from one contact that carries the force F = p d^(dim−1)."""

    force: float  # F [force]
    time: float  # √(m d/F), time in which the pressure moves a grain by its diameter [time]
    stiffness: float  # k d/F, the stiffness k of the contact in units of F/d
    dt: float  # time step [time]


@checked
def compressed(
    n: int,
    *,
    pressure: Positive,
    mu: NotNegative | None = None,
    dim: int = 3,
    radius: Values = (0.5, 0.7),
    mass: Values = 1.0,
    law: Law | None = None,
    seed: Seed = 0,
    tolerance: Positive | None = None,
    report: Report = silent,
):
    """Frictional packing in a periodic box, compressed slowly from a loose state until it carries a pressure.

    Grains that do not touch are compressed by a cell whose normal strains follow the stress, σ_xx = σ_yy = σ_zz = p.
    Drag brings them to rest, and Newton's method balances forces and pressure. Friction acts from the first contact on,
    so the contact number lies between 2 dim without friction and dim + 1 at large friction, depending on μ and p.
    The inertia of the cell and the drag are chosen such that the pressure is approached without oscillation, at
    inertial numbers near p/k, the pressure divided by the stiffness of a contact.

    Parameters
    ----------
    pressure : float [force/length^(dim−1)]
    mu : friction coefficient, not negative, of the law `hertz_mindlin(mu=mu)`; give this or a law
    dim, radius, mass, seed, tolerance : as in `jammed`
    law : Law that acts during the compression
    report : called as report(stage, share, text) during the compression, with the share of the pressure that was
        reached, and a text that gives pressure, unbalanced force, contact number and packing fraction

    Returns
    -------
    State, PackingInfo
        the state is at rest in a fixed cell. Grains that are not rattlers have at least 2 contacts, or dim + 1 without
        friction

    Raises
    ------
    ValueError
        If grains under this law cannot carry the pressure.
    NotInEquilibriumError
        If the pressure was not reached; the message states the pressure that was reached.

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
    law = hertz_mindlin(mu=mu) if law is None else law
    start = random_grains(n, LOOSE.get(dim, 1.0), dim, radius=radius, mass=mass, i0=None, seed=seed)
    if _width(start) < NARROWEST * 2 * start.grains.radius.max():
        raise ValueError(
            f"the cell of {n} grains would be narrower than {NARROWEST} of the largest grains and could collapse: use "
            "more grains"
        )
    tolerance = BALANCED * natural_scales(start, law).force if tolerance is None else tolerance
    require_positive(tolerance=tolerance)
    scales = compression_scales(start, law, pressure, tolerance)
    loose = quench(start, frictionless(law), 0.5 * tolerance)
    end = _compress(loose, law, pressure, scales, tolerance, report)
    end = end._replace(control=loads(n))
    return end, packing_info(end, law)


def check_pressure(
    law: Law, pressure: float, *, radius: np.ndarray, mass: np.ndarray, dim: int, name: str = "pressure"
) -> None:  # fmt: skip
    """Raise ValueError if grains under a law cannot carry a pressure; `name` is its key in the message."""
    position = np.zeros((len(radius), dim))
    position[:, 0] = np.cumsum(2 * radius)
    start = assembly((disks if dim == 2 else spheres)(position, radius, mass=mass), cell=box(dim=dim))
    compression_scales(start, law, pressure, BALANCED * natural_scales(start, law).force, name)


def compression_scales(start: State, law: Law, pressure: float, tolerance: float, name: str = "pressure") -> Scales:
    """Scales of a compression; raise ValueError if the pressure is out of reach."""
    grains, dim = start.grains, start.cell.dim
    diameter, depth = 2 * float(grains.radius.mean()), DEEPEST * float(grains.radius.min())
    area = diameter ** (dim - 1)
    force, most = pressure * area, _force_between(start, law, depth)
    if not force <= most:
        raise ValueError(
            f"{name} must be at most {most / area:.2g}, or grains under this law would overlap by more than "
            f"{DEEPEST:g} of their radius, got {pressure:g}; use a stiffer law"
        )
    if force < RESOLVED * tolerance:
        raise ValueError(
            f"{name} = {pressure:g} gives contact forces of {force:.2g}, too small for a tolerance of "
            f"{tolerance:g}: use a pressure of at least {RESOLVED * tolerance / area:.2g}, or a smaller tolerance"
        )
    overlap = scipy.optimize.brentq(lambda x: _force_between(start, law, x) - force, 0.0, depth, rtol=1e-6, xtol=1e-300)
    slope = (_force_between(start, law, 1.01 * overlap) - force) / (0.01 * overlap)
    time, dt = np.sqrt(grains.mass.mean() * diameter / force), SHARE * stable_time_step(_pair(start, overlap), law)
    scales = Scales(force, float(time), slope * diameter / force, dt)
    steps = 0.1 * scales.stiffness * scales.time / scales.dt  # for a linear strain of a tenth
    if not steps <= STEPS:
        raise ValueError(
            f"a slow compression to pressure = {pressure:g} would take about {steps:.0e} steps: use a higher "
            "pressure, or a softer law"
        )
    return scales


def _pair(start: State, overlap: float) -> State:
    """Two touching grains with the mean radius and the smallest mass of a packing."""
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

    Before grains touch, the strain rate of the cell approaches L = V p/(M ℓ² ν). With L = 1/(κ t) and the drag ν = 4/t,
    the oscillation of a cell of mass M against the stiffness κ p of the packing is critically damped.
    """
    dim, p = state.cell.dim, pressure
    mass = critical_mass(state, p, scales)
    axes = ("xx", "yy", "zz")[:dim]
    state = state._replace(control=stress_controlled(state.control, dict.fromkeys(axes, p), mass=mass))
    block = int(np.clip(BLOCK * scales.stiffness * scales.time / scales.dt, 50, LONGEST))
    last = 0.5 * tolerance
    levels = iter((*(share * scales.force for share in AT_REST), last))
    level, waited = next(levels), 0
    for _ in range(STEPS // block):
        state, _, outcome = run(state, law, block, scales.dt, drag=CRITICAL / scales.time, tolerance=level)
        reached, fraction = pressure_of(state, law), packing_fraction(state)
        text = (
            f"pressure {reached:.3g}, unbalanced force {outcome.residual:.1e}, contact number {coordination(state):.3f}"
        )
        report("compression", float(np.clip(reached / p, 0.0, 1.0)), f"{text}, packing fraction {fraction:.4f}")
        if outcome.broken or fraction > DENSEST or _width(state) < state.grains.radius.max():
            break
        waited += level == last
        if outcome.ok or (waited and waited % PATIENCE == 0):
            at_rest = outcome.ok
            end, outcome = newton(stopped(state), law, tolerance=tolerance)
            if outcome.ok:
                return end
            level = next(levels, level) if at_rest else level
    message = f"no packing at rest under a pressure of {p:g} was found"
    if not outcome.broken:
        message += f", the compression ended at {reached:.3g} with a packing fraction of {fraction:.4g}"
    raise NotInEquilibriumError(message, outcome)


def critical_mass(state: State, pressure: float, scales: Scales) -> float:
    """Mass for which the drag 4/t critically damps the cell's oscillation against a packing [mass]."""
    return volume(state) ** (1 - 2 / state.cell.dim) * pressure * scales.stiffness * scales.time**2 / CRITICAL


def _width(state: State) -> float:
    """Smallest distance between opposite faces of the cell [length]."""
    dim = state.cell.dim
    return float(1 / np.linalg.norm(np.linalg.inv(state.cell.vectors)[:dim, :dim], axis=0).max())


def stopped(state: State) -> State:
    """State at rest, at time zero."""
    return resting(state)._replace(instant=None, time=0.0)


@checked
def biaxial_box(
    n: int = 200,
    *,
    pressure: float = 1e-4,
    kn: Positive = 1.0,
    kt: float = 0.5,
    mu: float = 0.5,
    radius: Values = (0.4, 0.6),
    density: Positive = 4 / np.pi,
    seed: Seed = 0,
    tolerance: Positive = 1e-9,
) -> tuple[State, Law]:
    """Frictional disks at rest in a box, compressed by two walls under constant forces.

    The walls are bodies n + LEFT and n + BOTTOM, which are fixed, and n + RIGHT and n + TOP, which move along their
    normals under a force of `pressure` times the length of the initial, loose box.

    Parameters
    ----------
    pressure : float; pressure/kn is the typical overlap in diameters [force/length]
    kn, kt : stiffnesses [force/length]
    radius : as in `jammed` [length]
    density : float, mass per area of a disk; a disk of diameter 1 has the mass 1 by default [mass/length²]
    tolerance : float, largest unbalanced force, in units of the pressure times the sum of the smallest and the largest
        radius

    Returns
    -------
    State, Law
        the law is `linear` with sharp friction and dashpots

    Raises
    ------
    ValueError
        If the pressure is too large for these grains, or so small that round-off exceeds the tolerance.
    NotInEquilibriumError
        If the packing does not come to rest.

    Source
    ------
    McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Fig 1.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, law = ss.packings.biaxial_box(30, pressure=1e-3, seed=1)
    >>> len(state.grains.radius), len(state.walls.normal)
    (30, 4)
    """
    sizes, scales = _sizes(n, radius, density, kn)
    law = _contact_law(kn, kt, mu, pressure, tolerance, scales)
    position, side = _jammed_positions(sizes, scales.length, seed)
    room = float(sizes.max())
    grains = disks(LOOSENED * np.mod(position, side) + room, sizes, mass=density * np.pi * sizes**2)
    length = LOOSENED * side + 2 * room
    walls = flat_walls(
        [[0, 0], [0, 0], [length, 0], [0, length]], [[1, 0], [0, 1], [-1, 0], [0, -1]],
        mass=len(sizes) / 4 * scales.mass,
    )  # fmt: skip
    control = loads(n, 4)
    control = force_controlled(control, [n + RIGHT], [-pressure * length, 0])
    control = force_controlled(control, [n + TOP], [0, -pressure * length])
    state = assembly(grains, walls, box(dim=2), control)
    return settle(state, law, tolerance * pressure * scales.length, scales.time), law


@checked
def sheared_box(
    n: int = 100, *, pressure: float = 1e-4, kn: Positive = 1.0, kt: float = 0.5, mu: float = 0.5,
    radius: Values = (0.4, 0.6), density: Positive = 4 / np.pi, seed: Seed = 0, tolerance: Positive = 1e-9,
) -> tuple[State, Law]:  # fmt: skip
    """Frictional disks at rest under a prescribed pressure in a periodic cell with free strains xx, yy and xy.

    Arguments, law and errors are those of `biaxial_box`.
    """
    sizes, scales = _sizes(n, radius, density, kn)
    law = _contact_law(kn, kt, mu, pressure, tolerance, scales)
    position, side = _jammed_positions(sizes, scales.length, seed)
    grains = disks(1.02 * position, sizes, mass=density * np.pi * sizes**2)
    control = stress_controlled(loads(n), {"xx": pressure, "yy": pressure, "xy": 0.0})
    cell = box([1.02 * side, 1.02 * side, 1.0], periodic=(True, True, False), dim=2)
    state = assembly(grains, cell=cell, control=control)
    return settle(state, law, tolerance * pressure * scales.length, scales.time), law


class _Scales(NamedTuple):
    """Units of a packing of disks, all 1 by default."""

    length: float  # sum of the smallest and the largest radius [length]
    mass: float  # mass of a disk of the diameter `length` [mass]
    time: float  # √(mass/kn) [time]


def _sizes(n: int, radius, density: float, kn: float) -> tuple[np.ndarray, _Scales]:
    """Radii of n disks, and the units of their packing."""
    sizes = check_radii(radius, n)
    length = float(sizes.min() + sizes.max())
    mass = density * np.pi * (0.5 * length) ** 2
    return sizes, _Scales(length, mass, float(np.sqrt(mass / kn)))


def _jammed_positions(sizes: np.ndarray, length: float, seed: int) -> tuple[np.ndarray, float]:
    """Positions (n, 2) of jammed disks without friction, and the side of their periodic cell."""
    start = random_grains(
        len(sizes), FRACTION, 2, radius=sizes / length, mass=1.0, i0=None, seed=seed, length=1.0
    )  # fmt: skip
    packing = balance(start, frictionless(hertz_mindlin()), BALANCED, length=1.0)
    return length * packing.grains.position[:, :2], length * float(packing.cell.vectors[0, 0])


def settle(state: State, law: Law, tolerance: float, time: float = 1.0) -> State:
    """Bring a state to rest by damped dynamics until its largest unbalanced force is below the tolerance.

    `time` is the time √(m/k) of a contact [time].

    Raises
    ------
    NotInEquilibriumError
        If the state does not come to rest.
    """
    for _ in range(BLOCKS):
        # keeps the sample of each seed unchanged, so that stored numbers remain valid
        state = state._replace(instant=None)
        state, _, outcome = run(state, law, BOX_STEPS, 0.2 * time, drag=0.02 / time, tolerance=tolerance)
        if outcome.ok and outcome.iterations < BOX_STEPS:
            break
    state, outcome = equilibrate(resting(state), law, tolerance=tolerance, check="nothing")
    if not outcome.ok:
        raise NotInEquilibriumError("the disks did not come to rest", outcome)
    return state


def _contact_law(kn: float, kt: float, mu: float, pressure: float, tolerance: float, scales: _Scales) -> Law:
    if not 0 < pressure <= SOFT * kn:
        raise ValueError(f"pressure must be above 0 and at most {SOFT:g} kn = {SOFT * kn:g}, got {pressure}")
    round_off = float(np.finfo(float).eps) * kn  # of the force of a contact, over the length
    if not tolerance * pressure >= round_off:
        raise ValueError(
            f"forces cannot balance to {tolerance:g} of a pressure of {pressure:g} with kn = {kn:g}, because their "
            f"round-off is larger: use a pressure of at least {round_off / tolerance:.2g}, a smaller kn, or a larger "
            "tolerance"
        )
    rate = 0.2 / scales.time
    return linear(kn, kt, mu, coulomb="sharp", damping="mass_velocity", damping_n=rate, damping_t=rate)


@checked
def with_load(control: Control, wall: int, factor: float) -> Control:
    """Control with the force on a wall multiplied by a factor; `wall` is a body number."""
    require_index(len(control.force), wall=wall)
    force = control.force.copy()
    if not force[wall].any():
        raise ValueError(f"body {wall} has no force to multiply: wall k of a packing with n grains is body n + k")
    force[wall] *= factor
    return control._replace(force=force)


@checked
def with_machine(state: State, wall: int, stiffness: Positive) -> State:
    """State in which a spring exerts the present force on a wall, like a testing machine of finite stiffness.

    Moving the load point (`with_travel`) controls the displacement of the wall if the machine is much stiffer than the
    packing, and its force if it is much softer.

    Parameters
    ----------
    wall : body number of a wall under a force
    stiffness : stiffness of the machine [force/length]

    Examples
    --------
    >>> import stickslip as ss
    >>> state, law = ss.packings.biaxial_box(30, pressure=1e-3, seed=1)
    >>> lid = 30 + ss.packings.TOP
    >>> held = ss.quasirigid.with_machine(state, lid, 100.0)
    >>> float(held.control.spring[lid, 1]), float(held.control.force[lid, 1])
    (100.0, 0.0)
    """
    require_index(state.n_bodies, wall=wall)
    pull, control, position = state.control.force[wall], state.control, body_positions(state)[wall]
    if not pull.any():
        raise ValueError(f"body {wall} carries no load that a machine could exert: choose a wall under a force")
    for axis in np.flatnonzero(pull):
        control = spring_loaded(control, [wall], [position + pull / stiffness], stiffness, axis=int(axis))
    force = control.force.copy()
    force[wall] = 0.0
    return state._replace(control=control._replace(force=force))


@checked
def with_travel(control: Control, wall: int, travel: Numbers) -> Control:
    """Control in which the load point of a wall's spring is moved by `travel`, (3,) or (2,) [length]."""
    require_index(len(control.spring), wall=wall)
    if not control.spring[wall].any():
        raise ValueError(f"body {wall} is not pulled by a spring: use `with_machine` first")
    if np.shape(travel) not in ((2,), (3,)):
        raise ValueError(f"travel has the shape {np.shape(travel)}: it must be (3,) or (2,)")
    anchor = control.anchor.copy()
    anchor[wall] += as_rows(travel, 1, 3)[0]
    return control._replace(anchor=anchor)
