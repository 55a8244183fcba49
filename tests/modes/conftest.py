"""Small sheared packings: one that is stable, one with a complex pair."""

import warnings

import numpy as np
import pytest

import stickslip as ss

LAW = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")
OVERLAP = 1e-8  # of lattices: so small that it carries no pressure to speak of


def sheared(n, dim, fraction, strain, *, seed, law=LAW, steps=3):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        state, _ = ss.packings.jammed(n, packing_fraction=fraction, dim=dim, seed=seed, tolerance=1e-12)
        for _ in range(steps):
            state, outcome = ss.equilibrate(ss.packings.strained(state, strain / steps * np.eye(dim, k=1)), law)
            assert outcome.ok
    return state


def triangular(law, across=4):
    """Disks of diameter 1, six contacts each."""
    site = np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [1.5, 0.75**0.5]])
    steps = np.array([[2 * i, 3**0.5 * j] for i in range(across // 2) for j in range(across // 2)])
    place = (steps[:, None] + site).reshape(-1, 2)
    return ss.packings.from_arrays(
        place, np.full(len(place), 0.5 + OVERLAP / 2), law, cell=[across, across / 2 * 3**0.5], dim=2
    )


@pytest.fixture(scope="session")
def calm():
    """A stable packing of disks."""
    return sheared(12, 2, 0.88, 6e-4, seed=3)


@pytest.fixture(scope="session")
def swinging():
    """An unstable packing of spheres, with one complex pair."""
    return sheared(16, 3, 0.68, 4e-3, seed=1)
