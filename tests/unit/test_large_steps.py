"""Strain steps of packings that are solved by iteration, without a factorisation."""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigvalsh

import stickslip as ss
from stickslip.core.contacts.jacobian import triplets
from stickslip.loading.packing import jammed, sheared
from stickslip.solve.equilibrate import equilibrate
from stickslip.solve.freedom import assembled, dynamical_matrix, freedom, jacobian, translations
from stickslip.solve.linear import DENSE_BELOW, block_diagonal_solve, iterate
from stickslip.solve.newton import Factorisation
from stickslip.solve.spectrum import symmetric_part_is_positive

LAW = ss.laws.hertz_mindlin(mu=0.5)


@pytest.fixture(scope="module")
def packing():
    state, _ = jammed(150, packing_fraction=0.67, seed=3)
    assert len(freedom(state)) >= DENSE_BELOW
    return state


def path(state, steps: int, keep: Factorisation):
    for _ in range(steps):
        state, outcome = equilibrate(sheared(state, 2e-5), LAW, keep=keep, check="nothing")
        assert outcome.ok
    return state


@pytest.fixture(scope="module")
def iterated(packing):
    """The packing after ten steps, and the solver that was kept."""
    keep = Factorisation()
    return path(packing, 10, keep), keep


def test_iteration_and_factorisation_lead_to_the_same_equilibria(packing, iterated, monkeypatch):
    (end, keep), exact = iterated, Factorisation()
    assert keep.factorisations == 0
    assert ss.measure.residual(end, LAW)[0] <= 5e-14
    monkeypatch.setattr("stickslip.solve.newton.DENSE_BELOW", 10**6)
    other = path(packing, 10, exact)
    assert exact.factorisations > 0
    held = ~ss.measure.rattlers(end)
    drift = (end.grains.position - other.grains.position)[held]
    # forces balance to 5e-14; the softest mode, some 1e-3 of the stiffest, turns that into displacement
    np.testing.assert_allclose(drift - drift.mean(axis=0), 0, atol=1e-9)
    assert np.abs(end.grains.position - packing.grains.position)[held].max() > 1e-5
    count = int(end.contacts.count[0])
    assert (end.contacts.mode[:count] == other.contacts.mode[:count]).all()


def test_a_matrix_is_reused_within_and_between_steps(iterated):
    _, keep = iterated
    assert keep.renewals < 0.7 * keep.solves


@pytest.mark.parametrize("small", [40, 130])
def test_a_solver_of_another_packing_is_not_used(packing, small):
    keep = Factorisation()
    path(packing, 1, keep)
    path(jammed(small, packing_fraction=0.68, seed=1)[0], 2, keep)
    path(packing, 1, keep)


def test_a_system_that_iteration_does_not_solve_is_factorised(packing, monkeypatch):
    monkeypatch.setattr("stickslip.solve.newton.ITERATIONS", 3)
    keep = Factorisation()
    end = path(packing, 4, keep)
    assert 1 <= keep.factorisations <= 8
    assert keep.factored
    assert ss.measure.residual(end, LAW)[0] <= 5e-14


def test_iteration_reaches_the_residual_asked_for(packing):
    matrix = sparse.csr_array(-jacobian(packing, LAW))
    free = freedom(packing)
    empty = np.abs(matrix).sum(axis=1) == 0
    assert empty.any()  # rattlers
    b = matrix @ np.random.default_rng(0).normal(size=len(free))
    sizes = []
    for relative in (1e-2, 1e-6):
        x, spent = iterate(matrix, b, block_diagonal_solve(matrix, free.body), relative, 300)
        assert spent < 300
        assert np.linalg.norm(matrix @ x - b) <= 2 * relative * np.linalg.norm(b)
        assert not x[empty].any()
        sizes.append(spent)
    assert sizes[0] < sizes[1]
    assert iterate(matrix, b, block_diagonal_solve(matrix, free.body), 1e-14, 5)[1] == 5


def test_blocks_of_different_sizes_are_inverted():
    full = np.zeros((6, 6))
    full[:2, :2], full[2, 2], full[3:, 3:] = [[2, 1], [0, 3]], 4, np.eye(3) + 0.1
    solve = block_diagonal_solve(sparse.csr_array(full), np.array([0, 0, 1, 4, 4, 4]))
    b = np.arange(1.0, 7)
    np.testing.assert_allclose(full @ solve(b), b, rtol=1e-7)  # the diagonal is increased by 1e-9


@pytest.mark.parametrize("frozen", [[], [0, 7]])
@pytest.mark.parametrize(("dim", "fraction"), [(3, 0.7), (2, 0.86)])
def test_blocks_are_assembled_like_their_entries(dim, fraction, frozen):
    state, _ = jammed(30, packing_fraction=fraction, dim=dim, seed=2)
    state = state._replace(control=ss.control.fixed(state.control, frozen))
    free = freedom(state)
    blocks, _ = ss.modes.contact_blocks(state, LAW)
    rows, cols, values = triplets(state, blocks)
    whole = sparse.csr_array((values, (rows, cols)), shape=(180, 180)).toarray()
    np.testing.assert_allclose(
        assembled(state, blocks, free).toarray(), whole[np.ix_(free.component, free.component)], atol=1e-14
    )


def test_contacts_that_vanish_together_open_at_once():
    """An unloaded disk in the notch of two fixed ones: Newton's method alone leaves a third of the overlap."""
    height = np.sqrt(0.999**2 - 0.55**2)
    state = ss.assembly(ss.disks([[-0.55, 0], [0.55, 0], [0, height]], 0.5), cell=ss.box(dim=2))
    state = state._replace(control=ss.control.fixed(state.control, [0, 1]))
    end, outcome = ss.newton(state, LAW)
    assert outcome.ok
    assert outcome.iterations <= 4
    assert not len(ss.measure.touching(end))


def test_patience_limits_slow_steps():
    state, _ = jammed(40, packing_fraction=0.65, seed=0)
    far = sheared(state, 2e-2)
    _, patient = ss.newton(far, LAW, tolerance=5e-14)
    _, outcome = ss.newton(far, LAW, tolerance=5e-14, patience=0)
    assert not outcome.ok
    assert outcome.iterations < patient.iterations
    with pytest.raises(ValueError, match="patience"):
        ss.newton(far, LAW, patience=-1)


def test_negative_stiffness_is_found_without_a_factorisation(packing):
    def verdict(state, law):
        free = freedom(state)
        matrix = dynamical_matrix(state, law, free)
        held = np.flatnonzero(np.abs(matrix).sum(axis=1) > 0)
        inner = matrix[held][:, held]
        low = eigvalsh(0.5 * (inner + inner.T).toarray())[0]
        return symmetric_part_is_positive(inner, translations(matrix, free)[held]), low / np.abs(inner.data).max()

    positive, low = verdict(packing, LAW)
    assert positive
    assert low > -1e-10
    column = ss.assembly(ss.disks([[0, 0.95 * k] for k in range(30)], 0.5), cell=ss.box(dim=2))
    column = column._replace(control=ss.control.fixed(column.control, [0, 29]))
    smooth = ss.laws.hertz_mindlin(mu=0.0)
    column = ss.accept(column, ss.forces(column, smooth)[1])
    positive, low = verdict(column, smooth)
    assert not positive
    assert low < -1e-3
