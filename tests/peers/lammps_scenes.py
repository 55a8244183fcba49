"""Small states that exercise everything LAMMPS is told, and the comparison of a run of ours with one of LAMMPS."""

from functools import cache

import numpy as np

import stickslip as ss
from stickslip.core.state import empty_contacts
from stickslip.loading import packing

REFF = ss.laws.hertz_mindlin_reff(1.0, 0.4, 0.3)
REFF_DAMPED = ss.laws.hertz_mindlin_reff(1.0, 0.4, 0.3, damping_n=0.3, damping_t=0.2)
LINEAR = ss.laws.linear(1.0, 0.4, 0.3)
LINEAR_DAMPED = ss.laws.linear(1.0, 0.4, 0.3, damping="mass_velocity", damping_n=0.3, damping_t=0.2)
STEPS, DT = 50, 0.05


def arms(law):
    """The law with lever arms R − δ/2, as in `pair_style granular`."""
    return ss.laws.with_lever(law, "overlap")


GRANULAR = {
    "velocity": arms(ss.laws.linear(1.0, 0.4, 0.3, damping="velocity", damping_n=0.1, damping_t=0.05)),
    "viscoelastic": arms(ss.laws.linear(1.0, 0.4, 0.3, damping="viscoelastic", damping_n=0.3, damping_t=0.2)),
    "restitution": arms(REFF._replace(damping=9, table=np.array([[[1.0, 0.4, 0.3, 0.7, 0.5]]]))),
    "tsuji": arms(ss.laws.linear(1.0, 0.4, 0.3, damping="tsuji", damping_n=0.7, damping_t=0.5)),
    "dmt": arms(ss.laws.dmt(1.0, 0.4, 0.3, work=1e-3, damping_n=0.3, damping_t=0.2)),
    "forces": ss.laws.with_memory(arms(REFF), "force"),
    "rescaled forces": ss.laws.with_memory(arms(ss.laws.hertz_mindlin_reff(1.0, 0.4, 0.3, rescaled=True)), "force"),
    "rolling": ss.laws.with_rolling(arms(REFF), k_roll=0.3, mu_roll=0.05),
}


@cache
def jammed(number, packing_fraction, dim):
    """Made once for all scenes, none of which writes to it."""
    return packing.jammed(number, packing_fraction=packing_fraction, dim=dim, seed=0)[0]


def fresh(state):
    """The state without contact memory."""
    return state._replace(contacts=empty_contacts(state.n_bodies, 0, state.contacts.skin))


def stirred(number=200):
    """A dense periodic packing with random velocities and spins."""
    state = jammed(number, 0.66, 3)
    velocity, spin = np.random.default_rng(0).normal(0, 0.02, (2, number, 3))
    return fresh(state._replace(grains=state.grains._replace(velocity=velocity, spin=spin)))


def opened():
    """The stirred packing without periodic sides, which expands."""
    state = stirred()
    return fresh(state._replace(cell=ss.box(np.diag(state.cell.vectors), [False] * 3, 3)))


def on_a_floor():
    """Grains under gravity on a floor, with open sides."""
    grains, size = lattice(3)
    control = ss.control.loads(len(grains.radius), 1, gravity=[0, -0.01, 0])
    return ss.assembly(grains, ss.flat_walls([[0, 0.02, 0]], [[0, 1, 0]]), ss.box([size] * 3, [False] * 3, 3), control)


def stirred_disks():
    """A dense periodic packing of disks with random velocities and spins."""
    state = jammed(100, 0.88, 2)
    velocity, spin = np.random.default_rng(0).normal(0, 0.02, (2, 100, 3))
    velocity[:, 2], spin[:, :2] = 0, 0
    return fresh(state._replace(grains=state.grains._replace(velocity=velocity, spin=spin)))


def lattice(dim, *, equal=False):
    """Grains on a lattice that overlaps by a tenth, with random velocities and spins; and the lattice's length."""
    rng, side = np.random.default_rng(2), 4 if dim == 3 else 6
    axes = [np.arange(side)] * dim + [[0.0]] * (3 - dim)
    position = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(float)
    position[:, :dim] = (position[:, :dim] + 0.5) * 0.9
    n, plane = len(position), np.array([1, 1, dim == 3])
    position += rng.normal(0, 0.01, position.shape) * plane
    radius = np.full(n, 0.49) if equal else rng.uniform(0.46, 0.5, n)
    velocity, spin = rng.normal(0, 0.05, (2, n, 3))
    if dim == 2:
        velocity[:, 2], spin[:, :2] = 0, 0
    make = ss.spheres if dim == 3 else ss.disks
    return make(position, radius, mass=rng.uniform(0.5, 2.0, n), velocity=velocity, spin=spin), 0.9 * side


def between_walls(dim, *, moving=False, equal=False):
    """Grains under gravity on two walls, one of them inclined and of another material, one moving if wanted."""
    grains, size = lattice(dim, equal=equal)
    n, inclined = len(grains.radius), [0.1, 0.7, 0.7] if dim == 3 else [0.1, 1.0, 0.0]
    walls = ss.flat_walls([[0.02] * 3, [0.0] * 3], [[1, 0, 0], inclined], material=[0, 1])
    control = ss.control.loads(n, 2, gravity=[0, -0.01, 0])
    if moving:
        control = ss.control.driven(control, [n], [0.1, 0.05, 0, 0, 0, 0])
        control = ss.control.time_dependent(control, [n], [0.0, 1.0, 1.5, 9.0], [1.0, 1.0, -1.0, 2.0], axes=[0])
    cell = ss.box([size, size, 9.0][:dim] if dim == 3 else [size, size], [False, dim == 3, False], dim)
    return ss.assembly(grains, walls, cell, control)


def between_plates(dim, way):
    """Grains between a driven plate and one that is pressed, both rigid, with a spring or a shaken plate if wanted."""
    grains, size = lattice(dim)
    x, n = grains.position, len(grains.radius)
    low, high = np.flatnonzero(x[:, 1] < 0.6), np.flatnonzero(x[:, 1] > x[:, 1].max() - 0.3)
    grains.radius[np.append(low, high)] = 0.42  # grains of a plate do not touch each other
    control = ss.control.loads(n, gravity=[0, -0.01, 0])
    for members in (low, high):
        control = ss.control.rigid(control, members)
    control = ss.control.driven(control, low, 0.0)
    control.rate[low, 0] = -0.1
    control.free[high, 0] = control.free[high, 2] = False
    control.rate[high, 0] = 0.2
    control = ss.control.force_controlled(control, high, [0, -0.01])
    if way == "spring":
        control = ss.control.spring_loaded(
            control, high, x[high], 0.3, times=[0.0, 1.0, 2.5], displacement=[0.0, 0.1, 0.15]
        )
    if way == "shaken":
        control = ss.control.time_dependent(control, low, [0.0, 1.0, 1.5, 9.0], [1.0, 1.0, -1.0, 2.0], axes=[0])
    cell = ss.box([size] * dim, [True, False, dim == 3][:dim] if dim == 2 else [True, False, True], dim)
    return ss.assembly(grains, cell=cell, control=control)


def sheared(a, b):
    """The periodic packing in a cell in simple shear."""
    rate = np.zeros((3, 3))
    rate[a, b] = 0.05
    state = stirred()
    return state._replace(control=ss.control.strained_at(state.control, rate))


def under_stress(stress, rate=None, *, dim=3, growing=False):
    """The packing in a cell some of whose lengths follow a stress, in shear or already moving if wanted."""
    state = stirred() if dim == 3 else stirred_disks()
    control = state.control if rate is None else ss.control.strained_at(state.control, rate)
    control = ss.control.stress_controlled(control, stress, mass=20.0) if stress else control
    cell = state.cell._replace(rate=np.diag([0.02, -0.03, 0.0])) if growing else state.cell
    return state._replace(control=control, cell=cell)


def walls_law(law):
    """The law with another friction at the second wall."""
    return ss.laws.for_pair(law, 0, 1, mu=0.1)


SCENES = {
    "packing": (stirred, REFF),
    "packing with dashpots": (stirred, REFF_DAMPED),
    "packing without tension": (stirred, REFF_DAMPED._replace(damping=REFF_DAMPED.damping | 4)),
    "linear packing": (stirred, LINEAR_DAMPED),
    "walls, disks": (lambda: between_walls(2), walls_law(LINEAR_DAMPED)),
    "walls, spheres": (lambda: between_walls(3), walls_law(REFF_DAMPED)),
    "walls, no dashpots": (lambda: between_walls(3), walls_law(LINEAR)),
    "walls, equal spheres": (
        lambda: between_walls(3, equal=True),
        walls_law(ss.laws.hertz_mindlin(1.0, 0.4, 0.3, damping="viscoelastic", damping_n=0.3, damping_t=0.2)),
    ),
    "moving wall": (lambda: between_walls(2, moving=True), walls_law(LINEAR)),
    "plates, disks": (lambda: between_plates(2, ""), LINEAR_DAMPED),
    "plates, spheres": (lambda: between_plates(3, ""), REFF_DAMPED),
    "spring": (lambda: between_plates(3, "spring"), LINEAR_DAMPED),
    "shaken plate": (lambda: between_plates(2, "shaken"), LINEAR),
    "cell sheared along xy": (lambda: sheared(0, 1), REFF_DAMPED),
    "cell sheared along xz": (lambda: sheared(0, 2), REFF),
    "cell sheared along yz": (lambda: sheared(1, 2), REFF),
    "cell under stress": (lambda: under_stress({"xx": 0.05, "yy": 0.02, "zz": 0.08}), REFF_DAMPED),
    "cell under stress, disks": (lambda: under_stress({"xx": 0.05, "yy": 0.05}, dim=2), LINEAR_DAMPED),
    "cell under stress, moving": (lambda: under_stress({"xx": 0.05, "yy": 0.05}, growing=True), REFF),
    "shear under stress": (lambda: under_stress({"yy": 0.05}, [[0, 0.05], [0, 0]]), REFF),
    "shear under stresses": (lambda: under_stress({"xx": 0.05, "yy": 0.05}, [[0, 0.05], [0, 0]]), REFF_DAMPED),
    "compressed and sheared": (lambda: under_stress({}, [[-0.02, 0, 0.03], [0, 0.01, 0.05], [0, 0, 0.03]]), REFF),
}


def differ(a, b):
    """Largest difference over largest value."""
    return np.abs(a - b).max(initial=0.0) / max(np.abs(b).max(initial=0.0), 1e-300)
