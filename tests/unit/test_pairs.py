"""Complex pairs by windows: what LAPACK finds, no more and no less."""

import warnings
from functools import cache

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigvals

import stickslip as ss
from stickslip.core.contacts.jacobian import linearise
from stickslip.core.progress import silent
from stickslip.loading.packing import jammed, sheared
from stickslip.solve import pairs as module
from stickslip.solve.equilibrate import equilibrate
from stickslip.solve.freedom import dynamical_matrix, freedom
from stickslip.solve.pairs import _discs, complex_pairs, gershgorin_certificate
from stickslip.solve.spectrum import mode_overlap, spectrum
from tests.conftest import make_law, make_packing, stirred

LAW = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")


def sheared_packing(n, dim, fraction, strain, steps, seed=3):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        state, _ = jammed(n, packing_fraction=fraction, dim=dim, seed=seed, tolerance=1e-12)
        for _ in range(steps):
            state, outcome = equilibrate(sheared(state, strain / steps), LAW)
            assert outcome.ok
    return state


@cache
def known_packing(n, dim, fraction, strain):
    """A packing with several pairs and more modes than a window takes, and its spectrum."""
    state = sheared_packing(n, dim, fraction, strain, steps=4)
    return state, spectrum(state, LAW)


SPHERES, DISKS = (70, 3, 0.68, 4e-3), (100, 2, 0.88, 4e-3)


@pytest.fixture(scope="module", params=[SPHERES, DISKS], ids=["spheres", "disks"])
def packing(request):
    return known_packing(*request.param)


@pytest.fixture(scope="module")
def disks():
    return known_packing(*DISKS)


def assert_same(result, full):
    expected = full.pairs
    scale = np.abs(full.eigenvalues).max()
    assert len(result.eigenvalues) == len(expected)
    # both solve to 1e-15 of the largest |λ|, and eigenvalues next to their birth amplify that by a hundred
    np.testing.assert_allclose(result.eigenvalues, expected, rtol=0, atol=1e-12 * scale)
    norm = (result.free.mass[:, None] * np.abs(result.modes) ** 2).sum(axis=0)
    np.testing.assert_allclose(norm, 1, rtol=1e-12)
    for k, p in enumerate(full.pair_indices):
        assert mode_overlap(result.modes[:, k], full.modes[:, p], full.free.mass) == pytest.approx(1, abs=1e-6)
    assert np.all(result.residual < 1e-12)


def test_windows_find_the_pairs_of_lapack(packing):
    state, full = packing
    assert len(full.eigenvalues) > 2 * (module.WINDOW + module.HALO)
    assert len(full.pairs) > 1
    assert_same(complex_pairs(state, LAW, dense_below=0), full)


def test_small_systems_go_to_lapack_directly(packing):
    state, full = packing
    assert_same(complex_pairs(state, LAW), full)


def test_strong_skew_coupling_goes_to_lapack(packing, monkeypatch):
    state, full = packing
    monkeypatch.setattr(module, "WEAK", 0.0)
    monkeypatch.setattr(module, "_refine", None)  # would fail if it were called
    assert_same(complex_pairs(state, LAW, dense_below=0), full)


@pytest.mark.parametrize("dim", [2, 3])
def test_walls_and_sliding_contacts(dim):
    law = make_law("hertz_mindlin", "sharp", mu=0.2)
    state = stirred(make_packing(dim, 2, n=12), law, np.random.default_rng(2))
    full = spectrum(state, law)
    pairs = complex_pairs(state, law, dense_below=0)
    scale = np.abs(full.eigenvalues).max()
    np.testing.assert_allclose(pairs.eigenvalues, full.pairs, rtol=0, atol=1e-11 * scale)


def test_certificate_accounts_for_every_eigenvalue(packing):
    state, full = packing
    pairs = complex_pairs(state, LAW, certificate=True, dense_below=0)
    certified = pairs.certified
    assert_same(pairs, full)
    assert certified.consistent
    assert certified.real + 2 * certified.pairs + certified.members.sum() == certified.size
    assert certified.size + certified.zero == len(full.eigenvalues)
    assert certified.pairs + len(certified.members) >= len(full.pairs)
    assert certified.real + 2 * certified.pairs > 0.95 * certified.size
    # the translations coincide at zero and no disc can tell them apart
    assert np.abs(certified.undecided).min() < 1e-12
    assert "floating point, not interval arithmetic" in str(certified)


def test_certificate_notices_a_missing_and_an_invented_pair(packing):
    state, full = packing
    matrix = dynamical_matrix(state, LAW, freedom(state))
    held = np.flatnonzero(abs(matrix).sum(axis=1))
    matrix = matrix[held][:, held]
    values = full.pairs
    scale = np.abs(full.eigenvalues).max()

    def consistent(pairs):
        return gershgorin_certificate(matrix, None, pairs, 0, silent).consistent

    assert consistent(values)
    assert not consistent(values[1:])
    assert not consistent(np.append(values, 0.5 * scale + 1e-3j))


def test_discs_are_gershgorins_after_the_blocks_are_diagonal():
    """Radii are row sums of T⁻¹BT written out, T the eigenvectors of modes that are too close to be told apart."""
    rng = np.random.default_rng(4)
    diagonal = np.array([1.0, 1.02, 3.0, 5.0, 5.0, 8.0])
    for pair in ([[0, 0.5], [-0.5, 0]], [[0, 0.5], [0.4, 0]]):
        B = np.diag(diagonal) + 0.05 * rng.normal(size=(6, 6)) * (1 - np.eye(6))
        B[np.ix_([3, 4], [3, 4])] = 5.0 * np.eye(2) + pair
        T = np.eye(6, dtype=complex)
        for together in ([0, 1], [3, 4]):
            T[np.ix_(together, together)] = np.linalg.eig(B[np.ix_(together, together)])[1]
        turned = np.linalg.inv(T) @ B @ T
        radii = np.abs(turned).sum(axis=1) - np.abs(np.diag(turned))
        centres, found = _discs(B.copy(), 0.0, silent, passes=0)
        at = np.lexsort((np.diag(turned).imag.round(9), np.diag(turned).real.round(9)))
        mine = np.lexsort((centres.imag.round(9), centres.real.round(9)))
        np.testing.assert_allclose(centres[mine], np.diag(turned)[at], atol=1e-12)
        np.testing.assert_allclose(found[mine], radii[at], atol=1e-12)
        wider = _discs(B.copy(), 10.0, silent, passes=0)[1] - found
        np.testing.assert_allclose(wider, 6 * np.finfo(float).eps * 10.0, rtol=0.1)  # a difference of two radii


@pytest.mark.parametrize("seed", range(5))
def test_discs_of_a_small_matrix_hold_its_eigenvalues(seed):
    """As many as discs in every connected part: also after passes that make them small."""
    rng = np.random.default_rng(seed)
    B = np.diag(np.arange(12.0)) + 0.02 * rng.normal(size=(12, 12))
    B[5, 6], B[6, 5] = 0.9, -0.9
    values = eigvals(B)
    for passes in (0, 1, 6):
        centres, radii = _discs(B.copy(), 12.0, silent, passes=passes)
        near = np.abs(values[:, None] - centres) <= radii
        assert near.any(axis=1).all()
        alone = (np.abs(centres[:, None] - centres) > radii[:, None] + radii).sum(axis=1) == len(B) - 1
        assert (near[:, alone].sum(axis=0) == 1).all()
        assert alone.any() or passes == 0


def test_a_poor_subspace_is_recovered_by_a_sparse_factor(packing):
    state, full = packing
    matrix = dynamical_matrix(state, LAW, freedom(state))
    vector = full.modes[:, full.pair_indices[0]] * np.sqrt(full.free.mass)
    scale = np.abs(full.eigenvalues).max()
    rough = np.stack([vector.real, vector.imag], axis=1) + 1e-5 * np.random.default_rng(0).normal(size=(len(vector), 2))
    rough = np.linalg.qr(rough)[0]
    found = module._search_by_arnoldi(matrix, module._disc_of_subspace(matrix, rough), scale)
    values = np.linalg.eigvals(found.T @ (matrix @ found))
    assert np.abs(values - full.pairs[0]).min() < 1e-12 * scale


def coupled_modes(size, width, strength, seed):
    """Modes that are weakly coupled, and a pair that two mixtures of about 2·`width` of them form."""
    rng = np.random.default_rng(seed)
    own = np.sort(rng.uniform(0.1, 1.0, size))
    near = np.exp(-(((np.arange(size) - size / 2) / width) ** 2) / 2)
    u, v = np.linalg.qr((rng.normal(size=(2, size)) * near).T)[0].T
    weak = rng.normal(size=(size, size)) * 2e-4
    skew = (weak - weak.T) / 2 + strength * (np.outer(u, v) - np.outer(v, u))
    return sparse.csr_array(np.diag(own) + skew)


def two_identical_halves():
    """Every pair is double: LAPACK returns its vectors in any order and direction."""
    rng = np.random.default_rng(6)
    own = np.sort(rng.uniform(0.1, 1.0, 120))
    half = np.diag(own)
    for i in range(3, 117, 6):
        couple(half, i, i + 1, own[i + 1] - own[i])
    weak = rng.normal(size=(120, 120)) * 1e-4
    return np.kron(np.eye(2), half + weak - weak.T)


def another_mode_between():
    """A pair that the window estimates as two real eigenvalues, with an unrelated one between them."""
    own = np.linspace(0.1, 1.0, 160)
    own[43:46] = 0.344226415, 0.348226415, 0.3464
    matrix = np.diag(own)
    for j in range(120, 160):
        couple(matrix, 43, j, 0.0022)
    couple(matrix, 43, 44, 0.001821)
    return matrix


def gap_in_the_spectrum():
    """A window on both sides of a gap, with a pair whose modes are coupled to modes close to the window."""
    own = np.append(np.linspace(0.1, 0.3, 155), 0.9 + 1e-4 * np.arange(125))
    own[157] = own[156] + 1.3e-4
    own[158] = own[157] + 1e-4
    matrix = np.diag(own)
    couple(matrix, 156, 206, 6e-4)
    couple(matrix, 156, 157, 4.5e-5)
    return matrix


def border_of_windows():
    """A pair next to a border of windows, in modes so dense that one of the two windows joins them into a chain."""
    own = np.hstack([np.linspace(0.1, 0.3, 95), 0.305 + 9e-6 * np.arange(70), np.linspace(0.31, 1.0, 155)])
    matrix = np.diag(own)
    for j in range(200, 240):
        couple(matrix, 97, j, 2e-4)
    couple(matrix, 97, 98, 1.148e-6)
    return matrix


@pytest.mark.parametrize("make", [two_identical_halves, another_mode_between, gap_in_the_spectrum, border_of_windows])
def test_pairs_that_are_easily_missed(make):
    free = freedom(make_packing(3, n=60, wall=False))
    matrix, size = np.zeros((len(free), len(free))), len(make())
    matrix[:size, :size] = make()  # rows of zeros are left out
    pairs = module.find_pairs(free, lambda _: sparse.csr_array(matrix), False, silent, dense_below=0).eigenvalues
    values = eigvals(matrix)
    expected = values[values.imag > 1e-9 * np.abs(values).max()]
    assert len(pairs) == len(expected) > 0
    assert np.abs(pairs[:, None] - expected).min(axis=0).max() < 1e-9
    assert np.abs(pairs[:, None] - expected).min(axis=1).max() < 1e-9


@pytest.mark.parametrize("make", [gap_in_the_spectrum, lambda: coupled_modes(600, 120, 0.15, seed=0).toarray()])
def test_windows_with_modes_that_extend_beyond_them_are_searched_as_a_whole(monkeypatch, make):
    monkeypatch.setattr(module, "STRONG", np.inf)
    matrix = make()
    basis = module.symmetric_basis(sparse.csr_array(matrix), np.float64, silent)
    _, discs = module.find_candidates(basis, silent)
    largest = eigvals(matrix)[eigvals(matrix).imag.argmax()]
    assert any(abs(largest - disc.centre) < disc.radius for disc in discs)


def test_a_chain_across_a_border_is_refined_even_if_no_window_has_its_middle(monkeypatch):
    basis = module.symmetric_basis(sparse.csr_array(np.diag(np.linspace(1.0, 2.0, 120))), np.float64, silent)
    border, chains = basis.diagonal[39:41].mean(), [(-1, 10), (-10, 1), (0, 0)]

    def suspects(values, vectors, near):
        first, last = np.searchsorted(values.real, border) + chains.pop(0)
        return [np.arange(first, last)] if last > first else []

    monkeypatch.setattr(module, "_find_suspects", suspects)
    clusters, _ = module.find_candidates(basis, silent)
    assert [cluster.vectors.shape[1] for cluster in clusters] == [11, 11]


@pytest.mark.parametrize(("strong", "strength"), [(module.STRONG, 0.15), (module.STRONG, 0.2), (np.inf, 0.15)])
def test_a_pair_of_many_modes_is_not_missed(monkeypatch, strong, strength):
    """Windows contain only parts of its modes, and their estimates of λ are far off."""
    monkeypatch.setattr(module, "STRONG", strong)
    free = freedom(make_packing(3, n=100, wall=False))
    matrix = coupled_modes(len(free), 120, strength, seed=0)
    pairs = module.find_pairs(free, lambda _: matrix, False, silent, dense_below=0)
    values = eigvals(matrix.toarray())
    expected = values[values.imag > 1e-9]
    assert len(pairs.eigenvalues) == len(expected) > 0
    assert np.abs(pairs.eigenvalues[:, None] - expected).min(axis=0).max() < 1e-12
    assert pairs.residual.max() < 1e-12


def couple(matrix, i, j, strength):
    matrix[i, j], matrix[j, i] = strength, -strength


def test_a_double_pair_found_in_several_subspaces_is_reported_twice():
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    matrix = np.diag([1.0, 1.0, 1.0, 1.0, 2.0, 3.0])
    couple(matrix, 0, 1, 1e-3)
    couple(matrix, 2, 3, 1e-3)
    matrix = turn @ matrix @ turn.T
    space = turn[:, :4]
    spaces = [space @ np.linalg.qr(rng.normal(size=(4, 4)))[0] for _ in range(5)]
    values, vectors = module._extract_pairs(matrix, spaces, 3.0)
    np.testing.assert_allclose(values, [1 + 1e-3j] * 2, atol=1e-13)
    assert np.linalg.matrix_rank(vectors, tol=1e-3) == 2


def test_too_many_coordinates_name_the_other_method(disks, monkeypatch):
    monkeypatch.setattr(module, "LARGEST", 10)
    with pytest.raises(ValueError, match="fastest_pair"):
        complex_pairs(disks[0], LAW)


@pytest.mark.parametrize("dense_below", [module.DENSE_BELOW, 0])
def test_progress_is_reported_in_order_and_the_time_of_a_certificate_first(disks, dense_below):
    told = []
    complex_pairs(disks[0], LAW, certificate=True, dense_below=dense_below, report=lambda *now: told.append(now))
    shares = [share for _, share, _ in told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert "certificate" in told[0][2] and "estimated time" in told[0][2]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_thousand_spheres_agree_with_lapack(seed):
    state = sheared_packing(1000, 3, 0.68, 6e-4, steps=8, seed=seed)
    pairs = complex_pairs(state, LAW)
    values = eigvals(dynamical_matrix(state, LAW, freedom(state)).toarray(order="F"), overwrite_a=True)
    scale = np.abs(values).max()
    expected = values[values.imag > 1e-9 * scale]
    assert len(pairs.eigenvalues) == len(expected) > 0
    apart = np.abs(pairs.eigenvalues[:, None] - expected[None, :])
    assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-12 * scale


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_windows_miss_nothing_on_independent_packings(seed):
    """At 150 spheres LAPACK is cheap enough for many states; the windows are the same as at 1000."""
    state = sheared_packing(150, 3, 0.66 + 0.01 * (seed % 4), 2e-3 * (1 + seed), steps=6, seed=seed)
    full = spectrum(state, LAW)
    assert len(full.pairs) > 3
    assert_same(complex_pairs(state, LAW, dense_below=0), full)


def test_an_unaffordable_certificate_is_refused_with_its_time(disks, monkeypatch):
    monkeypatch.setattr(module, "LARGEST", 10)
    with pytest.raises(ValueError, match="certificate would take about"):
        complex_pairs(disks[0], LAW, certificate=True)


@pytest.mark.parametrize(("asked", "way"), [("fastest", "dense"), ("all", "dense"), ("certify", "certify")])
def test_stability_takes_the_cheapest_way_and_names_it(disks, asked, way):
    state, full = disks
    result = ss.stability(state, LAW, method=asked)
    assert result.method == way and result.way
    np.testing.assert_allclose(result.pairs[0], full.pairs[0], rtol=0, atol=1e-12 * np.abs(full.eigenvalues).max())


@pytest.mark.parametrize(("asked", "way"), [("fastest", "fastest"), ("all", "pairs"), ("auto", "pairs")])
def test_stability_beyond_lapack_agrees_with_it(packing, monkeypatch, asked, way):
    state, full = packing
    monkeypatch.setattr("stickslip.solve.stability.DENSE_UP_TO", 10)
    calls = []
    for room in ("balance", "freedom"):
        monkeypatch.setattr(f"stickslip.solve.{room}.linearise", lambda *a, **o: calls.append(a) or linearise(*a, **o))
    result = ss.stability(state, LAW, method=asked)
    assert result.method == way and result.scope
    assert len(calls) == 1  # the pairs are those of the matrix on which the verdict rests
    np.testing.assert_allclose(result.pairs[0], full.pairs[0], rtol=1e-9)


def test_too_many_coordinates_for_a_certificate_name_the_other_method(disks, monkeypatch):
    monkeypatch.setattr("stickslip.solve.stability.PAIRS_UP_TO", 10)
    with pytest.raises(ValueError, match=r"would take about .* use 'fastest'"):
        ss.stability(disks[0], LAW, method="certify")
