"""Contact status by the principle of minimum sliding: solvers against enumeration, P-matrices against bijectivity."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stickslip as ss
from stickslip.quasirigid import status as room
from stickslip.quasirigid.matrices import matrices, stiffness_matrix
from stickslip.quasirigid.status import (
    Complementarity,
    Verdict,
    certificate,
    complementarity,
    is_p_matrix,
    lemke,
    status,
    status_map,
)
from stickslip.quasirigid.system import pins
from tests.conftest import make_law, stirred
from tests.derivatives.test_free_cell import packed


def jammed_disks(seed, n=24):
    """Matrices of a periodic packing of disks that carry slip; which contacts are critical, and whereto, is drawn."""
    law, rng = make_law("linear", "sharp", mu=0.5), np.random.default_rng(seed)
    state = packed(2, n=n, seed=seed % 4)
    state = stirred(state._replace(control=ss.loads(n)), law, rng, size=2e-3)
    m = matrices(state, law)
    return m._replace(sign=rng.choice([-1.0, 1.0], m.count)), rng


def minors(a):
    """All principal minors, the slow obvious way."""
    n = len(a)
    return [np.linalg.det(a[np.ix_(s, s)]) for k in range(1, n + 1) for s in itertools.combinations(range(n), k)]


def problem(seed, n, strength):
    rng = np.random.default_rng(seed)
    return Complementarity(np.eye(n) + strength * rng.normal(size=(n, n)), rng.normal(size=n))


@given(st.integers(0, 10_000), st.integers(1, 6), st.floats(0.05, 1.5))
def test_recursion_on_schur_complements_finds_p_matrices(seed, n, strength):
    a = problem(seed, n, strength).matrix
    assert is_p_matrix(a) == (min(minors(a)) > 0)


@given(st.integers(0, 10_000), st.integers(1, 7), st.floats(0.05, 1.5))
def test_the_status_map_is_bijective_for_p_matrices_and_only_for_them(seed, n, strength):
    made = problem(seed, n, strength)
    mapped = status_map(made)
    assert mapped.bijective == is_p_matrix(made.matrix)
    if mapped.bijective:
        assert len(mapped.consistent) == 1


@given(st.integers(0, 10_000), st.integers(1, 9), st.floats(0.05, 0.6))
def test_lemke_finds_the_one_solution(seed, n, strength):
    made = problem(seed, n, strength)
    found = lemke(made)
    if is_p_matrix(made.matrix):
        assert found is not None
    if found is not None:
        w = made.matrix @ found + made.vector
        assert found.min() >= -1e-9
        assert w.min() >= -1e-9 * max(1, np.abs(w).max())
        assert abs(w @ found) < 1e-8 * max(1, np.abs(found).max() * np.abs(w).max())


@given(st.integers(0, 10_000), st.integers(1, 8), st.floats(0.05, 1.5))
def test_a_certificate_is_never_wrong(seed, n, strength):
    made = problem(seed, n, strength)
    found = certificate(made)
    assert found.unique == is_p_matrix(made.matrix)
    assert found.reason


def test_a_certificate_for_many_contacts():
    large = problem(0, 60, 0.01)
    assert certificate(large).unique
    large.matrix[3, 3] = -1
    assert certificate(large).unique is False
    cyclic = np.eye(30) + 1.2 * np.roll(np.eye(30), 1, axis=1)
    cyclic[0, 1:] += 0.3
    found = certificate(Complementarity(cyclic, np.ones(30)))
    assert found.unique is None
    assert "not known" in found.reason


@pytest.mark.parametrize("seed", range(20))
def test_status_of_a_packing_against_enumeration(seed):
    m, rng = jammed_disks(seed)
    critical = np.sort(rng.choice(m.count, 6, replace=False))
    load = m.c @ rng.normal(size=2 * m.count)
    made = complementarity(m, load, critical=critical)
    mapped, found = status_map(made), status(m, load, critical=critical)
    if mapped.bijective:
        assert found.ok
        bits = found.sliding[critical] @ (1 << np.arange(6))
        assert mapped.consistent.tolist() == [bits]
    if found.ok:
        k = stiffness_matrix(m, found.sliding)
        np.testing.assert_allclose(k @ found.velocity, load, atol=1e-9)
        relative = (m.c.T @ found.velocity).reshape(-1, 2)[critical]
        tilde = m.slope[critical] * relative[:, 0] + m.sign[critical] * relative[:, 1]
        np.testing.assert_allclose(tilde, found.rate, atol=1e-9)
        assert ((tilde >= -1e-9) == found.sliding[critical]).all()
    else:
        assert not mapped.bijective


@pytest.mark.parametrize("seed", range(5))
def test_minors_are_ratios_of_determinants_of_the_stiffness(seed):
    """det A_SS = det k(S)/det k₀."""
    m, rng = jammed_disks(seed)
    critical = np.sort(rng.choice(m.count, 5, replace=False))
    a = complementarity(m, np.zeros(len(m.free)), critical=critical).matrix
    kept = np.setdiff1d(np.arange(len(m.free)), pins(m))
    assert len(kept) == len(m.free) - 2
    base = np.linalg.slogdet(stiffness_matrix(m, np.zeros(m.count, bool)).toarray()[np.ix_(kept, kept)])
    for number in range(32):
        chosen = critical[(number >> np.arange(5)) & 1 == 1]
        slides = np.isin(np.arange(m.count), chosen)
        sign, size = np.linalg.slogdet(stiffness_matrix(m, slides).toarray()[np.ix_(kept, kept)])
        inside = np.isin(critical, chosen)
        minor = np.linalg.det(a[np.ix_(inside, inside)]) if inside.any() else 1.0
        assert minor == pytest.approx(sign * base[0] * np.exp(size - base[1]), rel=1e-7, abs=1e-10)


def test_cycles_hand_over_to_pivoting_and_that_to_lemke(monkeypatch):
    m, rng = jammed_disks(1)
    critical = np.sort(rng.choice(m.count, 8, replace=False))
    load = m.c @ rng.normal(size=2 * m.count)
    first = status(m, load, critical=critical)
    monkeypatch.setattr(room, "_flipped", lambda *_: None)
    second = status(m, load, critical=critical)
    monkeypatch.setattr(room, "pivoted", lambda *_: (None, 0))
    third = status(m, load, critical=critical)
    assert [c.method for c in (first, second, third)] == ["flip all", "principal pivoting", "Lemke"]
    for other in (second, third):
        assert np.array_equal(other.sliding, first.sliding)


def test_a_mechanism_that_the_load_drives_is_said_so():
    law = ss.linear(1.0, 0.5, 0.5)
    grains = ss.disks([[0, 0.49], [1.5, 0.49]], 0.5)
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0]), ss.box(dim=2), ss.loads(2, 1))
    state = ss.accept(state, ss.forces(state, law)[1])
    m = matrices(state, law, rattlers=True)
    load = np.zeros(len(m.free))
    load[0] = 1.0  # rolls
    assert status(m, load).verdict is Verdict.MECHANISM


def test_no_consistent_status_is_reported_and_so_are_two():
    nothing = Complementarity(np.array([[-1.0]]), np.array([-1.0]))
    assert lemke(nothing) is None
    assert not len(status_map(nothing).consistent)
    both = Complementarity(np.array([[-1.0]]), np.array([1.0]))
    assert len(status_map(both).consistent) == 2


def test_too_many_contacts_for_a_map():
    with pytest.raises(ValueError, match="15 critical contacts"):
        status_map(Complementarity(np.eye(15), np.ones(15)))
