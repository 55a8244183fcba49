"""Small packings of five kinds: boxes, sheared cells, rows with loose disks, heaps, strained cells.

All but rows are in balance. Rows of spheres are square layers.
"""

from functools import cache

import numpy as np

import stickslip as ss
from stickslip.core.dynamics.cell_motion import strained
from stickslip.core.laws.builtin import KT, MU
from stickslip.core.state import SLIDE
from stickslip.loading.compression import settle
from stickslip.loading.packing import sheared
from stickslip.wings.status.matrices import linear_system

KINDS = ("box", "sheared", "row", "gravity", "strained")


@cache
def sample(kind: str, seed: int):
    """Matrices of one packing of disks, with rattlers among the coordinates where the kind says so."""
    state, law, rattlers = {
        "box": _box, "sheared": _sheared, "row": _row, "gravity": _gravity, "strained": _strained,
    }[kind](seed)  # fmt: skip
    return linear_system(state, law, rattlers=rattlers)


@cache
def spheres(kind: str, seed: int):
    """State, law and whether rattlers are included, of one packing of spheres."""
    return {
        "box": _box_of_spheres, "sheared": _sheared_spheres, "row": _layer, "gravity": _heap,
        "strained": _strained_spheres,
    }[kind](seed)  # fmt: skip


def on_the_cone(state, law, rows, along):
    """State in which the contacts in some rows are at the Coulomb limit, with slips along given vectors (C, 3)."""
    normal = ss.measure.branch_vectors(state)[rows]
    wall = state.contacts.j[rows] >= len(state.grains.radius)
    normal[wall] = state.walls.normal[state.contacts.j[rows][wall] - len(state.grains.radius)]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    slip = along - (along * normal).sum(axis=1, keepdims=True) * normal
    force = (ss.measure.contact_forces(state, law)[rows] * normal).sum(axis=1)
    length = law.table[0, 0, MU] * force / law.table[0, 0, KT]
    slips, modes = state.contacts.slip.copy(), state.contacts.mode.copy()
    slips[rows] = length[:, None] * slip / np.linalg.norm(slip, axis=1, keepdims=True)
    modes[rows] = SLIDE
    return state._replace(contacts=state.contacts._replace(slip=slips, mode=modes))


def _box(seed):
    return *ss.packings.biaxial_box(24, pressure=1e-3, mu=0.3 + 0.2 * (seed % 2), seed=seed, tolerance=1e-6), False


def _sheared(seed):
    return *ss.packings.sheared_box(24, pressure=1e-3, mu=0.3 + 0.2 * (seed % 2), seed=seed, tolerance=1e-6), False


def _row(seed):
    """Disks on a floor that push each other, others above the gaps between them, and rattlers that touch nothing."""
    rng, law = np.random.default_rng(seed), ss.laws.for_pair(ss.laws.linear(1.0, 0.5, 0.4), 0, 1)
    state = ss.packings.disk_array(10, press=1e-3, gap=-2e-3)
    centre = state.grains.position[:, :2] - [0, 1e-3]
    gaps = rng.choice(10, 4, replace=False)
    height = np.sqrt(0.999**2 - 0.499**2)
    above = centre[gaps] + [0.499, height]
    free = np.stack([np.linspace(1, 9, 3), np.full(3, 5.0)], axis=1)
    grains = ss.disks(np.concatenate([centre, above, free]), 0.5)
    state = ss.assembly(grains, state.walls, state.cell, ss.control.loads(17, 1))
    state = ss.accept(state, ss.forces(state, law)[1])
    return state, law, bool(seed % 2)


def _gravity(seed):
    """A heap of disks on a floor between periodic images."""
    rng = np.random.default_rng(seed)
    law = ss.laws.linear(1.0, 0.5, 0.3, coulomb="sharp", damping="mass_velocity", damping_n=0.3, damping_t=0.3)
    place = np.stack(np.meshgrid(np.arange(5) * 1.2 + 0.6, np.arange(4) * 1.1 + 0.6), axis=-1).reshape(-1, 2)
    radius = rng.uniform(0.4, 0.55, len(place))
    grains = ss.disks(place + rng.uniform(-0.02, 0.02, place.shape), radius, mass=4 * radius**2)
    control = ss.control.loads(len(place), 1)._replace(gravity=np.array([0.0, -1e-3, 0.0]))
    floor = ss.flat_walls([0, 0, 0], [0, 1, 0])
    state = ss.assembly(grains, floor, ss.box([6, 20, 1], [True, False, False], dim=2), control)
    state, _, outcome = ss.run(state, law, 200_000, 0.2, drag=0.02, tolerance=1e-8)
    assert outcome.ok
    return state, law, False


def _strained(seed):
    """A periodic cell of fixed shape after a strain of one per cent, with friction."""
    law = ss.laws.linear(1.0, 0.5, 0.4, coulomb="sharp", damping="mass_velocity", damping_n=0.3, damping_t=0.3)
    state, _ = ss.packings.jammed(24, packing_fraction=0.88, dim=2, seed=seed)
    state = state._replace(control=ss.control.loads(24))
    state = sheared(state, 0.01)
    state, _, outcome = ss.run(state, law, 100_000, 0.2, drag=0.02, tolerance=1e-8)
    assert outcome.ok
    return state, law, False


GRAINS = 14  # spheres of a packing
TOLERANCE = 1e-13  # of the balance; forces are about 1e-3


def _law(mu):
    return ss.laws.linear(1.0, 0.5, mu, coulomb="sharp", damping="mass_velocity", damping_n=0.2, damping_t=0.2)


def _jammed(seed):
    state, _ = ss.packings.jammed(GRAINS, pressure=1e-3, dim=3, seed=seed)
    return state, float(state.cell.vectors[0, 0])


def _box_of_spheres(seed):
    """Spheres between three fixed walls and three that press."""
    packed, side = _jammed(seed)
    law, room, way = _law(0.3 + 0.2 * (seed % 2)), 0.7, np.eye(3)
    grains = packed.grains._replace(position=1.1 * np.mod(packed.grains.position, side) + room)
    length = 1.1 * side + 2 * room
    walls = ss.flat_walls(np.concatenate([0 * way, length * way]), np.concatenate([way, -way]), mass=4.0)
    control = ss.control.loads(GRAINS, 6)
    for axis in range(3):
        control = ss.control.force_controlled(control, [GRAINS + 3 + axis], -1e-3 * length**2 * way[axis])
    state = ss.assembly(grains, walls, ss.box(dim=3), control)
    return settle(state, law, TOLERANCE), law, False


def _sheared_spheres(seed):
    """A periodic cell under pressure that may shear."""
    state, _ = _jammed(seed)
    law = _law(0.3 + 0.2 * (seed % 2))
    control = ss.control.stress_controlled(ss.control.loads(GRAINS), {"xx": 1e-3, "yy": 1e-3, "zz": 1e-3, "xy": 0.0})
    return settle(strained(state._replace(control=control), 0.02 * np.eye(3)), law, TOLERANCE), law, False


def _layer(seed):
    """A square layer of spheres on a floor, three others above the gaps between them, and a rattler."""
    rng, law, apart = np.random.default_rng(seed), _law(0.4), 1 - 2e-3
    centre = np.stack(np.meshgrid(np.arange(3), np.arange(3), [0.0]), axis=-1).reshape(-1, 3) * apart + [0, 0, 0.499]
    above = centre[rng.choice(9, 3, replace=False)] + [apart / 2, apart / 2, np.sqrt(0.999**2 - apart**2 / 2)]
    grains = ss.spheres(np.concatenate([centre, above, [[0.0, 0.0, 5.0]]]), 0.5)
    cell = ss.box([3 * apart, 3 * apart, 20.0], [True, True, False], dim=3)
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 0, 1]), cell, ss.control.loads(13, 1))
    return ss.accept(state, ss.forces(state, law)[1]), law, bool(seed % 2)


def _heap(seed):
    """A heap of spheres on a floor between periodic images."""
    rng, law = np.random.default_rng(seed), _law(0.3)
    place = np.stack(np.meshgrid(np.arange(2), np.arange(2), np.arange(3)), axis=-1).reshape(-1, 3) * 1.05 + 0.6
    grains = ss.spheres(place + rng.uniform(-0.05, 0.05, place.shape), rng.uniform(0.4, 0.5, len(place)))
    control = ss.control.loads(len(place), 1)._replace(gravity=np.array([0.0, 0.0, -1e-3]))
    cell = ss.box([2.0, 2.0, 20.0], [True, True, False], dim=3)
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 0, 1]), cell, control)
    return settle(state, law, TOLERANCE), law, False


def _strained_spheres(seed):
    """A periodic cell of fixed shape after a strain of one per cent, with friction."""
    state, _ = _jammed(seed)
    state = sheared(state._replace(control=ss.control.loads(GRAINS)), 0.01)
    return settle(state, _law(0.4), TOLERANCE), _law(0.4), False
