"""The matrices of Sec. III of paper 002: Table I against the engine, k against the Jacobian of `core`."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.quasirigid.matrices import damping_matrix, matrices, quadratic_form, stiffness_matrix
from stickslip.solve.freedom import jacobian
from tests.conftest import make_law, make_packing, stirred
from tests.derivatives.test_free_cell import packed
from tests.derivatives.test_jacobian import sample


@pytest.mark.parametrize("law_name", ["linear", "hertz_mindlin", "hertz_mindlin_reff"])
@pytest.mark.parametrize("seed", range(3))
def test_stiffness_is_minus_the_jacobian_in_stick_and_in_slip(law_name, seed):
    state, law = sample(law_name, "sharp", 2, seed)
    m = matrices(state, law, rattlers=True)
    assert 0 < m.limit.sum() < m.count
    k, exact = stiffness_matrix(m).toarray(), jacobian(state, law, m.free).toarray()
    np.testing.assert_allclose(k, -exact, atol=1e-13 * np.abs(exact).max(), rtol=0)
    frozen = stiffness_matrix(m, geometric=False).toarray()
    np.testing.assert_allclose(k - frozen, m.geometric.toarray(), atol=1e-13)
    assert np.abs(m.geometric.toarray()).max() > 1e-3 * np.abs(exact).max()
    np.testing.assert_allclose(m.geometric.toarray().sum(), 0, atol=1e-2)


def test_stiffness_of_a_stress_controlled_cell():
    law = make_law("linear", "sharp", mu=0.1)
    state = packed(2, n=30)
    control = ss.stress_controlled(state.control, {"xx": 0.01, "yy": 0.01, "xy": 2e-3})
    state = stirred(state._replace(control=control), law, np.random.default_rng(1), size=3e-3)
    m = matrices(state, law, rattlers=True)
    exact = jacobian(state, law, m.free).toarray()
    np.testing.assert_allclose(stiffness_matrix(m).toarray(), -exact, atol=1e-13 * np.abs(exact).max(), rtol=0)


@pytest.mark.parametrize("seed", range(3))
def test_table_one_against_the_engine(seed):
    """f = cF, V = cᵀv, dD/dt = S V and dF/dt = −K dD/dt, from a step of the engine and from its forces."""
    state, law = sample("linear", "sharp", 2, seed)
    m, n = matrices(state, law, rattlers=True), len(state.grains.radius)
    loads, _ = ss.forces(state, law)
    assert len(m.free) == 3 * n
    np.testing.assert_allclose(m.c @ m.force.ravel(), ss.residual_vector(state, loads, m.free), atol=1e-14)
    rng, h = np.random.default_rng(seed), 1e-7
    v = rng.normal(size=len(m.free))
    moved = ss.displaced(state, m.free, h * v)
    trial = ss.forces(moved, law, memory=ss.HELD)[1]
    relative = (m.c.T @ v).reshape(-1, 2)
    slides = m.limit
    overlap = ss.branches(moved._replace(contacts=trial))[m.rows] - ss.branches(state)[m.rows]
    normal, along = m.c.T @ v, None
    changed = matrices(moved._replace(contacts=trial), law, rattlers=True)
    rate = (changed.force - m.force) / h
    # what the geometry adds is of the order of overlap over radius; here overlaps are large, so k itself is compared
    predicted = -np.einsum("mab,mb->ma", m.springs, np.einsum("mab,mb->ma", _status(m), relative))
    np.testing.assert_allclose(rate, predicted, atol=1e-5)
    assert np.abs(predicted[slides, 0]).max() > 1e-3
    np.testing.assert_allclose(np.abs(rate[slides, 1]), m.mu[slides] * np.abs(rate[slides, 0]), atol=1e-5)
    assert overlap.shape == (m.count, 3)
    assert normal.shape == (2 * m.count,)
    assert along is None


def _status(m):
    from stickslip.quasirigid.matrices import statuses

    return statuses(m, m.limit)


def test_damping_matrix_is_that_of_the_jacobian():
    law = make_law("linear", "sharp", damping="mass_velocity", damping_n=0.3, damping_t=0.2)
    state = stirred(make_packing(2, seed=3), law, np.random.default_rng(3), size=0.001)
    m = matrices(state, law, rattlers=True)
    exact = ss.restricted(state, ss.contact_blocks(state, law)[1], m.free).toarray()
    np.testing.assert_allclose(damping_matrix(m).toarray(), -exact, atol=1e-13)


def test_quadratic_form_is_a_sum_over_contacts():
    state, law = sample("linear", "sharp", 2, 1)
    m = matrices(state, law, rattlers=True)
    v = np.random.default_rng(0).normal(size=len(m.free))
    relative = (m.c.T @ v).reshape(-1, 2)
    stuck = m.springs[:, 0, 0] * relative[:, 0] ** 2 + m.springs[:, 1, 1] * relative[:, 1] ** 2
    assert quadratic_form(m, v, np.zeros(m.count, bool)) == pytest.approx(stuck.sum())
    tilde = m.slope * relative[:, 0] + m.sign * relative[:, 1]
    less = m.springs[:, 1, 1] * relative[:, 1] * m.sign * tilde  # Eqs 46 to 48
    assert quadratic_form(m, v) == pytest.approx((stuck - m.limit * less).sum())


def test_three_dimensions_and_smooth_friction_are_refused():
    state, law = sample("linear", "smooth", 3, 0)
    with pytest.raises(ValueError, match="disks in the plane"):
        matrices(state, law, rattlers=True)
    state, law = sample("linear", "smooth", 2, 0)
    with pytest.raises(ValueError, match="coulomb='sharp'"):
        matrices(state, law, rattlers=True)
    state, law = sample("linear", "sharp", 2, 0)
    with pytest.raises(ValueError, match=r"\(3,\) statuses"):
        stiffness_matrix(matrices(state, law), [True, False, True])
