"""The matrices of Sec. III of McNamara & Herrmann 2006: Table I against the engine, k against `core`'s Jacobian."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.state import SLIDE, STICK
from stickslip.solve.freedom import jacobian
from stickslip.wings.status.matrices import damping_matrix, linear_system, quadratic_form, statuses, stiffness_matrix
from tests.conftest import make_law, make_packing, stirred
from tests.derivatives.test_free_cell import packed
from tests.derivatives.test_jacobian import sample


@pytest.mark.parametrize("law_name", ["linear", "hertz_mindlin", "hertz_mindlin_reff", "forces"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", range(2))
def test_stiffness_is_minus_the_jacobian_in_stick_and_in_slip(law_name, dim, seed):
    """And so it is for any other statuses of the contacts at the limit, with the same geometric stiffness."""
    state, law = sample("hertz_mindlin" if law_name == "forces" else law_name, "sharp", dim, seed)
    law = ss.laws.with_memory(law, "force") if law_name == "forces" else law
    m = linear_system(state, law, rattlers=True)
    assert 0 < m.limit.sum() < m.count
    k, exact = stiffness_matrix(m).toarray(), jacobian(state, law, m.free).toarray()
    np.testing.assert_allclose(k, -exact, atol=1e-13 * np.abs(exact).max(), rtol=0)
    sliding = m.limit & (np.cumsum(m.limit) % 2 == 0)
    mode = state.contacts.mode.copy()
    mode[m.rows] = np.where(sliding, SLIDE, STICK)
    other = jacobian(state._replace(contacts=state.contacts._replace(mode=mode)), law, m.free).toarray()
    assert np.abs(other - exact).max() > 1e-3 * np.abs(exact).max()
    np.testing.assert_allclose(stiffness_matrix(m, sliding).toarray(), -other, atol=1e-13 * np.abs(exact).max(), rtol=0)
    frozen = stiffness_matrix(m, geometric=False).toarray()
    np.testing.assert_allclose(k - frozen, m.geometric.toarray(), atol=1e-13)
    assert np.abs(m.geometric.toarray()).max() > 1e-3 * np.abs(exact).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_stiffness_of_a_stress_controlled_cell(dim):
    law = make_law("linear", "sharp", mu=0.1)
    state = packed(dim, n=30)
    control = ss.control.stress_controlled(state.control, {"xx": 0.01, "yy": 0.01, "xy": 2e-3})
    state = stirred(state._replace(control=control), law, np.random.default_rng(1), size=3e-3)
    m = linear_system(state, law, rattlers=True)
    exact = jacobian(state, law, m.free).toarray()
    np.testing.assert_allclose(stiffness_matrix(m).toarray(), -exact, atol=1e-13 * np.abs(exact).max(), rtol=0)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", range(2))
def test_table_one_against_the_engine(dim, seed):
    """f = cF from the engine's resultants; dF = −K S cᵀ v dt from its contact forces before and after a small step.

    In three dimensions the tangential forces turn with the axes t and t′, too.
    """
    state, law = sample("linear", "sharp", dim, seed)
    m, n = linear_system(state, law, rattlers=True), len(state.grains.radius)
    loads, _ = ss.forces(state, law)
    assert len(m.free) == {2: 3, 3: 6}[dim] * n
    np.testing.assert_allclose(m.c @ m.force.ravel(), ss.modes.residual_vector(state, loads, m.free), atol=1e-14)
    rng, h = np.random.default_rng(seed), 1e-8
    v = rng.normal(size=len(m.free))
    moved = ss.modes.displaced(state, m.free, h * v)
    trial = ss.forces(moved, law, memory=ss.HELD)[1]
    relative = (m.c.T @ v).reshape(-1, dim)
    after = _components(moved._replace(contacts=trial), law, m.rows, _turned_frames(moved, m))
    rate = (after - _components(state, law, m.rows, m.frame)) / h
    predicted = -np.einsum("mab,mb->ma", m.springs, np.einsum("mab,mb->ma", statuses(m, m.limit), relative))
    # the step times curvatures of order 1, and round-off over the step
    np.testing.assert_allclose(rate, predicted, atol=1e-6)
    assert np.abs(predicted[m.limit]).min(axis=1).max() > 1e-3


def _components(state, law, rows, frame):
    """(M, d) contact forces of the engine along given axes."""
    return np.einsum("mk,mak->ma", ss.measure.contact_forces(state, law)[rows], frame)


def _turned_frames(state, m):
    """(M, d, 3) axes of the contacts, turned by the least rotation to the normals of a state."""
    normal = ss.measure.branch_vectors(state)[m.rows]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tilt = np.einsum("mak,mk->ma", m.frame[:, 1:], normal)  # to first order, as the step is small
    along = m.frame[:, 1:] - tilt[..., None] * normal[:, None]
    return np.concatenate([normal[:, None], along / np.linalg.norm(along, axis=2, keepdims=True)], axis=1)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(("mu", "slides"), [(10.0, False), (0.3, True)])
def test_damping_matrix_is_that_of_the_jacobian(mu, slides, dim):
    law = make_law("linear", "sharp", mu=mu, damping="mass_velocity", damping_n=0.3, damping_t=0.2)
    state = stirred(make_packing(dim, seed=5 - dim), law, np.random.default_rng(3), size=0.05 if slides else 0.001)
    m = linear_system(state, law, rattlers=True)
    assert m.limit.any() == slides and not m.limit.all()
    exact = ss.modes.assembled(state, ss.modes.contact_blocks(state, law)[1], m.free).toarray()
    np.testing.assert_allclose(damping_matrix(m).toarray(), -exact, atol=1e-13)


def test_quadratic_form_is_a_sum_over_contacts():
    state, law = sample("linear", "sharp", 2, 1)
    m = linear_system(state, law, rattlers=True)
    v = np.random.default_rng(0).normal(size=len(m.free))
    relative = (m.c.T @ v).reshape(-1, 2)
    stuck = m.springs[:, 0, 0] * relative[:, 0] ** 2 + m.springs[:, 1, 1] * relative[:, 1] ** 2
    assert quadratic_form(m, v, np.zeros(m.count, bool)) == pytest.approx(stuck.sum())
    tilde = m.slope * relative[:, 0] + m.sign * relative[:, 1]
    less = m.springs[:, 1, 1] * relative[:, 1] * m.sign * tilde  # Eqs 46 to 48
    assert quadratic_form(m, v) == pytest.approx((stuck - m.limit * less).sum())


def test_smooth_friction_and_rolling_resistance_are_refused():
    state, law = sample("linear", "smooth", 2, 0)
    with pytest.raises(ValueError, match="coulomb='sharp'"):
        linear_system(state, law, rattlers=True)
    state, law = sample("linear", "sharp", 2, 0)
    with pytest.raises(ValueError, match="rolling resistance"):
        linear_system(state, ss.laws.with_rolling(law, k_roll=0.5, mu_roll=0.1), rattlers=True)
    with pytest.raises(ValueError, match=r"sliding must have one status .* got shape \(3,\)"):
        stiffness_matrix(linear_system(state, law), [True, False, True])
