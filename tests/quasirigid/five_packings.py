"""Small packings of five kinds, in balance: boxes, sheared cells, rows with loose disks, heaps, strained cells."""

from functools import cache

import numpy as np

import stickslip as ss
from stickslip.loading.shear import sheared
from stickslip.quasirigid.matrices import linear_system

KINDS = ("box", "sheared", "row", "gravity", "strained")


@cache
def sample(kind: str, seed: int):
    """Matrices of one packing, with rattlers among the coordinates where the kind says so."""
    state, law, rattlers = {
        "box": _box, "sheared": _sheared, "row": _row, "gravity": _gravity, "strained": _strained,
    }[kind](seed)  # fmt: skip
    return linear_system(state, law, rattlers=rattlers)


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
