"""Small sheared packings: one that is stable, one with a complex pair."""

import warnings

import numpy as np
import pytest

import stickslip as ss

LAW = ss.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")


def sheared(n, dim, fraction, strain, *, seed, law=LAW, steps=3):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        state, _ = ss.jammed(n, packing_fraction=fraction, dim=dim, seed=seed, tolerance=1e-12)
        for _ in range(steps):
            state, outcome = ss.equilibrate(ss.strained(state, strain / steps * np.eye(dim, k=1)), law)
            assert outcome.ok
    return state


@pytest.fixture(scope="session")
def calm():
    """A stable packing of disks."""
    return sheared(12, 2, 0.88, 6e-4, seed=3)


@pytest.fixture(scope="session")
def swinging():
    """An unstable packing of spheres, with one complex pair."""
    return sheared(30, 3, 0.68, 3e-3, seed=3)
