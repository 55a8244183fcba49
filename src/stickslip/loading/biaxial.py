"""Boxes of disks at rest under a pressure: initial states of biaxial tests and of simple shear."""

from typing import NamedTuple

import numpy as np

from ..core.arguments import Numbers, Seed, Values, checked, require_index, require_positive
from ..core.contacts.neighbors import body_positions
from ..core.control import force_controlled, spring_loaded, stress_controlled
from ..core.dynamics.run import run
from ..core.fields import LARGEST
from ..core.laws.builtin import Law, hertz_mindlin, linear
from ..core.outcome import NotInEquilibriumError
from ..core.state import Control, State, as_rows, assembly, box, disks, flat_walls, loads, resting
from ..solve.equilibrate import BALANCED, equilibrate
from .packing import balance, check_radii, frictionless, random_grains

LEFT, BOTTOM, RIGHT, TOP = range(4)  # walls; the first two are fixed
STEPS, BLOCKS = 20_000, 150  # steps of a block of damped dynamics, and largest number of blocks
SOFT = 0.01  # largest pressure over kn; beyond it overlaps are not small
FRACTION = 0.86  # packing fraction of the jammed packing
LOOSE = 1.15  # expansion of the jammed packing before the walls compress it


@checked
def biaxial_box(
    n: int = 200,
    *,
    pressure: float = 1e-4,
    kn: float = 1.0,
    kt: float = 0.5,
    mu: float = 0.5,
    radius: Values = (0.4, 0.6),
    density: float = 4 / np.pi,
    seed: Seed = 0,
    tolerance: float = 1e-9,
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
    NotInEquilibriumError
        if the packing does not come to rest.

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
    law = _contact_law(kn, kt, mu, pressure, scales)
    position, side = _jammed_positions(sizes, scales.length, seed)
    room = float(sizes.max())
    grains = disks(LOOSE * np.mod(position, side) + room, sizes, mass=density * np.pi * sizes**2)
    length = LOOSE * side + 2 * room
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
    n: int = 100, *, pressure: float = 1e-4, kn: float = 1.0, kt: float = 0.5, mu: float = 0.5,
    radius: Values = (0.4, 0.6), density: float = 4 / np.pi, seed: Seed = 0, tolerance: float = 1e-9,
) -> tuple[State, Law]:  # fmt: skip
    """Frictional disks at rest under a prescribed pressure in a periodic cell with free strains xx, yy and xy.

    Arguments, law and errors are those of `biaxial_box`.
    """
    sizes, scales = _sizes(n, radius, density, kn)
    law = _contact_law(kn, kt, mu, pressure, scales)
    position, side = _jammed_positions(sizes, scales.length, seed)
    grains = disks(1.02 * position, sizes, mass=density * np.pi * sizes**2)
    control = stress_controlled(loads(n), {"xx": pressure, "yy": pressure, "xy": 0.0})
    cell = box([1.02 * side, 1.02 * side, 1.0], periodic=(True, True, False), dim=2)
    state = assembly(grains, cell=cell, control=control)
    return settle(state, law, tolerance * pressure * scales.length, scales.time), law


class _Scales(NamedTuple):
    """Units of a packing of disks, all 1 by default."""

    length: float  # sum of the smallest and the largest radius [length]
    mass: float  # of a disk of that diameter [mass]
    time: float  # √(mass/kn) [time]


def _sizes(n: int, radius, density: float, kn: float) -> tuple[np.ndarray, _Scales]:
    """Radii of n disks, and the units of their packing."""
    require_positive(density=density, kn=kn)
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
        if it does not come to rest.
    """
    for _ in range(BLOCKS):
        # keeps the sample of each seed unchanged, so that its known numbers remain valid
        state = state._replace(instant=None)
        state, _, outcome = run(state, law, STEPS, 0.2 * time, drag=0.02 / time, tolerance=tolerance)
        if outcome.ok and outcome.iterations < STEPS:
            break
    state, outcome = equilibrate(resting(state), law, tolerance=tolerance, check="nothing")
    if not outcome.ok:
        raise NotInEquilibriumError("the disks did not come to rest", outcome)
    return state


def _contact_law(kn: float, kt: float, mu: float, pressure: float, scales: _Scales) -> Law:
    require_positive(kn=kn)
    if not kn / LARGEST < pressure <= SOFT * kn:
        raise ValueError(f"pressure = {pressure} was given: it must be above 0 and at most {SOFT:g} kn = {SOFT * kn:g}")
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
def with_machine(state: State, wall: int, stiffness: float) -> State:
    """State in which a spring exerts the present force on a wall: a testing machine of finite stiffness.

    A leg that moves the load point (`with_travel`) drives the displacement of the wall if the machine is much stiffer
    than the packing, and its force if it is much softer.

    Parameters
    ----------
    wall : body number of a wall under a force
    stiffness : of the machine [force/length]

    Examples
    --------
    >>> import stickslip as ss
    >>> state, law = ss.packings.biaxial_box(30, pressure=1e-3, seed=1)
    >>> lid = 30 + ss.packings.TOP
    >>> held = ss.quasirigid.with_machine(state, lid, 100.0)
    >>> float(held.control.spring[lid, 1]), float(held.control.force[lid, 1])
    (100.0, 0.0)
    """
    require_positive(stiffness=stiffness)
    require_index(state.n_bodies, wall=wall)
    pull, control, place = state.control.force[wall], state.control, body_positions(state)[wall]
    if not pull.any():
        raise ValueError(f"body {wall} has no force that a machine could exert: give a wall under a force")
    for axis in np.flatnonzero(pull):
        control = spring_loaded(control, [wall], [place + pull / stiffness], stiffness, axis=int(axis))
    force = control.force.copy()
    force[wall] = 0.0
    return state._replace(control=control._replace(force=force))


@checked
def with_travel(control: Control, wall: int, travel: Numbers) -> Control:
    """Control with the load point of the spring that pulls a wall moved by `travel`, (3,) or (2,) [length]."""
    require_index(len(control.spring), wall=wall)
    if not control.spring[wall].any():
        raise ValueError(f"body {wall} is not pulled by a spring: use `with_machine` first")
    if np.shape(travel) not in ((2,), (3,)):
        raise ValueError(f"travel has the shape {np.shape(travel)}: it must be (3,) or (2,)")
    anchor = control.anchor.copy()
    anchor[wall] += as_rows(travel, 1, 3)[0]
    return control._replace(anchor=anchor)
