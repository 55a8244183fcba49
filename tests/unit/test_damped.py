"""Stability with dashpots: against the closed form of one contact, the whole spectrum, and the other method."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.jacobian import contact_blocks
from stickslip.solve.freedom import assembled, dynamical_matrix
from tests.exchange.packings import spheres

LAW = ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp", damping="velocity", damping_n=0.03, damping_t=0.02)


def growing(values):
    kept = (values.real > 1e-9) & (values.imag >= 0) & (np.abs(values) > 1e-5)
    return np.sort_complex(values[kept])


@pytest.fixture(scope="module")
def packing():
    return spheres(law=ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp"), motion=False)


@pytest.mark.parametrize(
    "damping", [pytest.param(1e-3, marks=pytest.mark.slow), 1e-2, pytest.param(0.1, marks=pytest.mark.slow)]
)
def test_exponents_are_those_of_the_whole_spectrum(packing, damping):
    law = ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp", damping_n=damping, damping_t=damping / 2)
    found = ss.modes.damped_stability(packing, law)
    truth = growing(ss.modes.damped_growth(packing, law))
    np.testing.assert_allclose(np.sort_complex(found.exponents), truth, atol=1e-9)
    assert found.grows == bool(len(truth))
    assert found.stable is None and not found.balanced  # arbitrary slips: no equilibrium


def test_modes_solve_the_quadratic_problem(packing):
    law = ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp", damping_n=1e-3)
    found = ss.modes.damped_stability(packing, law)
    assert len(found.exponents)
    free, root = found.free, np.sqrt(found.free.mass)
    pull, drag = dynamical_matrix(packing, law, free), assembled(packing, contact_blocks(packing, law)[1], free)
    for s, mode in zip(found.exponents, found.modes.T, strict=True):
        y = root * mode
        assert np.linalg.norm(y) == pytest.approx(1)
        assert np.linalg.norm(s**2 * y - s * (drag @ mode) / root + pull @ y) < 1e-9


@pytest.mark.slow
def test_methods_for_large_packings_find_the_same(packing):
    law = ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp", damping_n=1e-3, damping_t=1e-3)
    dense, near = (ss.modes.damped_stability(packing, law, method=method) for method in ("dense", "pairs"))
    assert len(dense.exponents)
    assert "growth caused by dashpots alone was not" in near.scope
    np.testing.assert_allclose(near.exponents[:3], dense.exponents[:3], atol=1e-9)


def test_a_pair_of_disks_swings_as_in_closed_form():
    """Two disks, one contact: m/2 s² + c s + k = 0 along the normal."""
    k, c = 1.0, 0.1
    law = ss.laws.linear(k, 0.0, 0.5, damping_n=c)
    state = ss.packings.from_arrays([[0, 0], [0.99, 0]], [0.5, 0.5], law, dim=2)
    s = ss.modes.damped_growth(state, law)
    truth = -c + 1j * np.sqrt(2 * k - c**2)
    assert np.abs(s - truth).min() < 1e-12


def test_too_large_for_dense_names_another_method(packing, monkeypatch):
    monkeypatch.setattr("stickslip.solve.damped.DENSE_AT_MOST", 10)
    with pytest.raises(ValueError, match="use 'pairs' or 'fastest'"):
        ss.modes.damped_stability(packing, LAW, method="dense")
