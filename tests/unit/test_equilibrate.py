"""Equilibrium after a step, come what may."""

import warnings

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.measure import rattlers, touching
from stickslip.loading.packing import jammed, sheared
from stickslip.solve.equilibrate import UnstableEquilibriumWarning, equilibrate
from stickslip.solve.freedom import assembled, dynamical_matrix, freedom, incidence
from stickslip.solve.linear import factorised, has_pardiso
from stickslip.solve.newton import Factorisation

LAW = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")


@pytest.mark.parametrize(("dim", "fraction"), [pytest.param(3, 0.67, marks=pytest.mark.slow), (2, 0.86)])
def test_large_strain_steps_all_end_in_equilibrium(dim, fraction):
    """Steps of 1e-3, a tenth of an overlap each: rattlers come and go, contacts vanish, Newton alone fails at times."""
    state, _ = jammed(40, packing_fraction=fraction, dim=dim, seed=0)
    keep, helped = Factorisation(), 0
    for _ in range(60):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnstableEquilibriumWarning)
            state, outcome = equilibrate(sheared(state, 1e-3), LAW, keep=keep)
        assert outcome.ok, outcome
        assert ss.measure.residual(state, LAW)[0] <= 5e-14
        assert outcome.how
        helped += outcome.fallback
    assert helped < 20
    assert len(touching(state)) > 40 * dim / 2


def test_a_kept_factor_leads_to_the_same_equilibrium():
    state, _ = jammed(40, packing_fraction=0.68, seed=1)
    keep, a, b = Factorisation(), state, state
    for _ in range(5):
        a, outcome = equilibrate(sheared(a, 1e-5), LAW, keep=keep)
        b, other = equilibrate(sheared(b, 1e-5), LAW)
        assert outcome.ok
        assert other.ok
    assert keep.factorisations < 5
    # both balance forces to 5e-14; the softest mode, some 1e-3 of the stiffest, turns that into displacement
    drift = a.grains.position - b.grains.position
    np.testing.assert_allclose(drift - drift.mean(axis=0), 0, atol=1e-10)


def test_a_grain_with_one_contact_is_pushed_out():
    position = [[0, 0], [0.99, 0], [0.495, 0.85], [-0.85, -0.4]]
    state = ss.assembly(ss.disks(position, 0.5), cell=ss.box([20.0, 20.0, 1.0], [True, True, False], dim=2))
    control = state.control
    free = control.free.copy()
    free[:3] = False
    end, outcome = ss.newton(state._replace(control=control._replace(free=free)), LAW)
    assert outcome.ok
    assert outcome.iterations <= 2
    assert rattlers(end).tolist() == [False, False, False, True]
    assert np.linalg.norm(end.grains.position[3] - end.grains.position[0]) >= 1.0


def test_a_loaded_grain_with_one_contact_stays_where_it_is_held():
    state = ss.assembly(
        ss.disks([[0.0, 0.499]], 0.5),
        ss.flat_walls([0, 0, 0], [0, 1, 0]),
        ss.box(dim=2),
        ss.control.loads(1, 1, force=[0, -1e-4, 0]),
    )
    end, outcome = equilibrate(state, ss.laws.for_pair(LAW, 0, 1))
    assert outcome.ok
    assert end.grains.position[0, 1] == pytest.approx(0.5 - 1e-4 ** (2 / 3), abs=1e-12)


def buckled():
    """A straight column of three disks between frozen ones, without friction: it balances, and the middle buckles."""
    grains = ss.disks([[0, 0], [0, 0.95], [0, 1.9]], 0.5)
    state = ss.assembly(grains, cell=ss.box(dim=2))
    return state._replace(control=ss.control.fixed(state.control, [0, 2]))


def test_an_unstable_equilibrium_is_reported():
    law = ss.laws.hertz_mindlin(mu=0.0)
    with pytest.warns(UnstableEquilibriumWarning, match="negative stiffness"):
        end, outcome = equilibrate(buckled(), law)
    assert outcome.ok
    assert "unstable" in outcome.warning
    modes = ss.spectrum(end, law)
    assert (modes.eigenvalues.real < 0).sum() == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _, quiet = equilibrate(buckled(), law, check="nothing")
    assert not quiet.warning


def test_an_unstable_equilibrium_is_reported_at_any_size(monkeypatch):
    monkeypatch.setattr("stickslip.solve.equilibrate.DENSE_BELOW", 0)
    monkeypatch.setattr("stickslip.solve.linear.DENSE_BELOW", 0)
    law = ss.laws.hertz_mindlin(mu=0.0)
    column = ss.assembly(ss.disks([[0, 0.95 * k] for k in range(12)], 0.5), cell=ss.box(dim=2))
    column = column._replace(control=ss.control.fixed(column.control, [0, 11]))
    with pytest.warns(UnstableEquilibriumWarning, match="10 direction"):
        equilibrate(column, law)


def test_complex_pairs_are_reported_on_request():
    state, _ = jammed(30, packing_fraction=0.7, seed=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnstableEquilibriumWarning)
        for _ in range(15):
            state, _ = equilibrate(sheared(state, 1e-3), LAW)
    assert len(ss.spectrum(state, LAW).pairs)
    with pytest.warns(UnstableEquilibriumWarning, match="complex pair"):
        equilibrate(state, LAW, check="spectrum")


def test_an_unknown_check_gives_a_one_sentence_error():
    with pytest.raises(ValueError, match="check must be 'buckling', 'spectrum' or 'nothing', got 'all'"):
        equilibrate(buckled(), LAW, check="all")


def test_incidence_adds_up_to_the_same_matrix():
    state, _ = jammed(30, packing_fraction=0.7, seed=2)
    free = freedom(state)
    blocks, _ = ss.modes.contact_blocks(state, LAW)
    q = incidence(state, len(blocks), free).toarray()
    flat = np.zeros((6 * len(blocks), 6 * len(blocks)))
    for c, block in enumerate(blocks):
        flat[6 * c : 6 * c + 6, 6 * c : 6 * c + 6] = block
    np.testing.assert_allclose(q @ flat @ q.T, assembled(state, blocks, free).toarray(), atol=1e-14)


@pytest.mark.parametrize(
    "method",
    ["dense", "superlu", pytest.param("pardiso", marks=pytest.mark.skipif(not has_pardiso(), reason="extra `fast`"))],
)
def test_every_solver_solves(method):
    state, _ = jammed(30, packing_fraction=0.7, seed=2)
    matrix = dynamical_matrix(state, LAW, freedom(state))
    matrix = (matrix + 0.01 * np.abs(matrix.data).max() * np.eye(len(freedom(state)))).copy()
    from scipy import sparse

    matrix = sparse.csr_array(matrix)
    b = np.random.default_rng(0).normal(size=matrix.shape[0])
    np.testing.assert_allclose(matrix @ factorised(matrix, method=method)(b), b, atol=1e-10)
