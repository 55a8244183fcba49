"""Three dimensions: the Jacobian in a sheared cell, its null space and symmetry, Newton against dynamics, growth."""

from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.forces import HELD
from stickslip.core.contacts.jacobian import contact_blocks
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.measure import branch_vectors, touching
from stickslip.loading.packing import frictionless, jammed, sheared
from stickslip.loading.protocols import ramp, release
from stickslip.loading.quasistatic import aqs
from stickslip.solve.equilibrate import equilibrate
from stickslip.solve.freedom import assembled, dynamical_matrix, freedom
from stickslip.wings.papers.sphere_shear.simulate import find_onset
from tests.derivatives.test_jacobian import differences, random_ways

LAW = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")
SLIDING = {name: ss.laws.hertz_mindlin(1.0, 2 / 7, 0.6, coulomb=name) for name in ("smooth", "sharp")}


def committed(state, law=LAW):
    state = with_neighbor_list(state)
    _, trial = ss.forces(state, law)
    return ss.accept(state, trial)


@cache
def leaning(coulomb, seed, strain=0.25):
    """Unlike radii in a strongly sheared cell, out of equilibrium, with large slip and without grazing contacts.

    Made once for all tests, none of which writes to it.
    """
    law = SLIDING[coulomb]
    for attempt in range(200):
        state, _ = jammed(14, packing_fraction=0.75, radius=(0.4, 0.5, 0.65), seed=100 * seed + attempt)
        for _ in range(10):
            state = committed(sheared(state, strain / 10), law)
        rows = touching(state)
        radius, c = state.grains.radius, state.contacts
        gap = radius[c.i] + radius[c.j]
        overlap = gap[: c.count[0]] - np.linalg.norm(branch_vectors(state), axis=1)
        if np.abs(overlap).min() > 1e-3 and np.linalg.norm(c.slip[rows], axis=1).min() > 1e-3:
            return state
    raise AssertionError("no suitable packing in 200 attempts")


@pytest.mark.parametrize(("coulomb", "seed"), [("smooth", 0), ("sharp", 1)])
def test_jacobian_in_a_sheared_cell_against_differences(coulomb, seed):
    state, law = leaning(coulomb, seed), SLIDING[coulomb]
    assert {ss.STICK, ss.SLIDE} <= set(state.contacts.mode[touching(state)])
    free = freedom(state)
    analytic, ways = assembled(state, contact_blocks(state, law)[0], free), random_ways(free)
    most = 1e-8 * np.abs(analytic.data).max()
    numeric = (differences(state, law, free, HELD, h, ways) for h in (2e-6, 4e-6, 1e-6))
    assert any(np.abs(values - analytic @ ways).max() <= most for values in numeric)


def test_translations_are_in_the_null_space():
    state = leaning("smooth", 0)
    free = freedom(state)
    matrix = dynamical_matrix(state, SLIDING["smooth"], free)
    for axis in range(3):
        move = np.where(free.axis == axis, np.sqrt(free.mass), 0.0)
        assert np.abs(matrix @ move).max() <= 1e-13 * np.abs(matrix.data).max()


def test_without_friction_the_jacobian_is_symmetric_and_with_it_is_not():
    state = leaning("smooth", 0)
    free = freedom(state)
    for law, symmetric in ((frictionless(LAW), True), (LAW, False)):
        matrix = dynamical_matrix(committed(state, law), law, free).toarray()
        skew = np.abs(matrix - matrix.T).max() / np.abs(matrix).max()
        assert (skew <= 1e-15) == symmetric
        assert symmetric or skew > 1e-3


def test_newton_and_dynamics_part_with_the_square_of_the_strain_step():
    start, _ = jammed(30, packing_fraction=0.7, seed=1)
    apart = []
    steps = (2e-4, 1e-4, 5e-5)
    for step in steps:
        fast = slow = start
        for _ in range(2):
            fast, a = equilibrate(sheared(fast, step), LAW, tolerance=1e-15)
            slow, b = ss.relax(sheared(slow, step), LAW, tolerance=1e-15, drag=0.2, dt=0.2)
            assert a.ok
            assert b.ok
        drift = fast.grains.position - slow.grains.position
        apart.append(np.linalg.norm(drift - drift.mean(axis=0)))
    slopes = np.diff(np.log(apart)) / np.diff(np.log(steps))
    assert ((slopes > 1.7) & (slopes < 2.3)).all(), slopes


@pytest.fixture(scope="module")
def path():
    """A path of thirty spheres through the onset and beyond."""
    state, _ = jammed(30, packing_fraction=0.7, seed=2)
    return ramp(state, np.arange(0, 21) * 1e-3, aqs(LAW, modes=True))


def test_at_zero_slip_nothing_is_complex(path):
    modes = path[0].spectrum
    assert not len(modes.pairs)
    size = np.abs(modes.eigenvalues)
    assert (size < 1e-10 * size.max()).sum() == 3  # translations; this packing has no rattlers


def test_im_lambda_is_born_as_a_square_root(path):
    first = next(k for k, p in enumerate(path) if len(p.spectrum.pairs))
    protocol = aqs(LAW)
    clean, strain = path[first - 1], path[first].load
    for _ in range(8):  # nearer to the birth, where the pair is alone
        middle = protocol.step(clean.state, 0.5 * (clean.load + strain))
        if len(middle.spectrum.pairs):
            strain = middle.load
        else:
            clean = middle
    onset = find_onset(clean, strain, protocol)
    assert onset.above - onset.below <= 1e-6 * onset.above
    assert onset.exponent == pytest.approx(0.5, abs=0.02)


def test_growth_of_a_free_run_is_that_of_the_spectrum(path):
    """After Verlet's correction, 1 + (ω_r dt)²/8 in the rate and 1 + (ω_r dt)²/24 in the frequency."""
    fastest = max(path, key=lambda p: p.spectrum.growth_rate[p.spectrum.pair_indices].max(initial=0.0))
    run = release(fastest.state, LAW, e_folds=25.0, snapshots=20, seed=1)
    assert run.growth.decades >= 8
    assert run.growth.growth_rate / run.corrected_rate == pytest.approx(1, abs=1e-3)
    assert run.growth.frequency / run.corrected_frequency == pytest.approx(1, abs=1e-5)
    before = run.snapshots[run.snapshot_msd < 1e-16].imag.max(axis=1)
    np.testing.assert_allclose(before, fastest.spectrum.im_lambda.max(), rtol=1e-3)
