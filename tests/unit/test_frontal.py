"""Multifrontal factors and inertia against dense LAPACK; the compiled leapfrog against a sparse product."""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import LinAlgError

from stickslip.core.laws.builtin import hertz_mindlin
from stickslip.solve.fastest import KrylovSubspace
from stickslip.solve.freedom import dynamical_matrix, freedom
from stickslip.solve.linear import FrontalFactor, count_below, dissect
from stickslip.solve.probes import LANES, Filters, Motion, ProbeRun
from tests.conftest import make_law, make_packing, stirred
from tests.unit.test_fastest import lattice

LAW = hertz_mindlin(1, 2 / 7, 10, coulomb="smooth")


def matrix_of(state, law=LAW):
    free = freedom(state)
    matrix = dynamical_matrix(state, law, free)
    touched = np.flatnonzero(abs(matrix).sum(axis=1) > 0)
    matrix = sparse.csr_array(matrix[touched][:, touched])
    return matrix, dissect(state, free, touched, matrix)


@pytest.fixture(scope="module", params=["spheres", "disks", "walls"])
def system(request):
    """Periodic packings, and one between walls, which touch many grains."""
    if request.param == "walls":
        law = make_law("hertz_mindlin", "smooth")
        return matrix_of(stirred(make_packing(2, 2, n=60), law, np.random.default_rng(0)), law)
    return matrix_of(lattice(3, 5, 0.01) if request.param == "spheres" else lattice(2, 12, 0.01))


def test_every_coordinate_is_eliminated_once(system):
    matrix, order = system
    assert len(order.pivots) > 3
    assert sorted(np.concatenate(order.pivots)) == list(range(matrix.shape[0]))


@pytest.mark.parametrize("shift", [-0.01, 0.3, 0.3 + 0.1j])
def test_solutions_fulfil_the_equations(system, shift):
    matrix, order = system
    shifted = matrix - shift * sparse.eye_array(matrix.shape[0])
    b = np.random.default_rng(0).standard_normal((matrix.shape[0], 3))
    x = FrontalFactor(shifted, order).solve(b)
    size = np.abs(shifted).sum(axis=1).max() * np.abs(x).max()
    assert np.abs(shifted @ x - b).max() < 1e-12 * size  # pivots are chosen within parts, at a loss of some digits


def test_eigenvalues_below_a_shift_are_counted(system):
    matrix, order = system
    symmetric = (matrix + matrix.T) / 2
    values = np.linalg.eigvalsh(symmetric.toarray())
    gaps = np.diff(values)
    for part in np.array_split(np.arange(len(gaps)), 5):
        k = part[np.argmax(gaps[part])]  # away from all eigenvalues
        shift = values[k : k + 2].mean()
        assert count_below(symmetric, shift, order) == (values < shift).sum()


def test_a_singular_matrix_is_an_error(system):
    matrix, order = system
    with pytest.raises(LinAlgError):
        FrontalFactor(0 * matrix, order)


def test_a_krylov_subspace_grows_without_starting_again(system):
    matrix, _ = system
    subspace = KrylovSubspace(lambda x: matrix @ x, np.random.default_rng(0).standard_normal((matrix.shape[0], 8)))
    first, _, _ = subspace.extended(16)
    basis, projection, last = subspace.extended(40)
    assert np.array_equal(basis[:, :16], first)
    np.testing.assert_allclose(basis.T @ basis, np.eye(40), atol=1e-12)
    rest = matrix @ basis - basis @ projection
    np.testing.assert_allclose(rest[:, :-8], 0, atol=1e-12)
    np.testing.assert_allclose(rest[:, -8:], subspace.next @ last, atol=1e-12)


@pytest.mark.parametrize("damped", [False, True])
def test_the_leapfrog_is_its_equation(system, damped):
    """Five steps, and filtered sums, in single precision; rows need not be a multiple of the block size."""
    matrix, _ = system
    matrix = sparse.csr_array(matrix[1:][:, 1:])
    n = matrix.shape[0]
    drag = sparse.csr_array(-0.1 * matrix[:, ::-1]) if damped else None
    run = ProbeRun(Motion(matrix, 4.0, np.zeros((n, 0)), drag), 5, LANES, np.random.default_rng(0))
    run.weights = 1.3, -0.4
    q, v = run.q[0][:n].astype(float), run.v[0][:n].astype(float)
    before = v
    run.lanes = np.arange(48.0).reshape(3, LANES)
    filters, sums = Filters(run, [0.3 + 0.1j, 2.0], 1), np.zeros((n, LANES))
    lane, weights, _ = Filters(run, [0.3 + 0.1j, 2.0], 1).next(5)
    run.advance(filters)
    for step in range(5):
        drawn = run.dt * (drag @ (1.3 * v - 0.4 * before)) if damped else 0.0
        before, v = v, v - run.dt**2 * (matrix @ q) + drawn
        q = q + v
        sums += weights[step] * q[:, lane]
    assert run.probes == LANES
    np.testing.assert_allclose(run.q[0][:n], q, atol=1e-4 * np.abs(q).max())
    np.testing.assert_allclose(filters.sums[:n], sums, atol=1e-4 * np.abs(sums).max())
    assert lane[:8].tolist() == [15, 15, 15, 15, 14, 14, 14, 14]  # the strongest probes, for both peaks


def test_probes_do_not_drift_along_rigid_translations():
    still = np.full((30, 1), 30**-0.5)
    run = ProbeRun(Motion(sparse.csr_array((30, 30)), 1.0, still), 5, LANES, np.random.default_rng(0))
    assert np.abs(still.T @ run.q[0]).max() > 0.1
    run.advance()
    assert np.abs(still.T @ run.q[0]).max() < 1e-5
