"""Complementarity problems that are made to be awkward: solutions, certificates and proofs against an enumeration."""

import numpy as np
import pytest

from stickslip.wings.status.complementarity import (
    Complementarity,
    enumerate_rates,
    enumerate_solutions,
    inconsistent,
    lemke,
    principal_pivoting,
    scale_problem,
    status_map,
)
from stickslip.wings.status.uniqueness import UniquenessVerdict, certificate, farkas
from tests.wings.status import brute_force as brute

KINDS = ("P", "any", "Z", "singular", "twins", "integers", "skew", "hidden Z")


def awkward(kind, n, rng):
    """A and q of one kind."""
    a, q = rng.normal(size=(n, n)), rng.normal(size=n)
    if kind == "P":
        a = a @ a.T + 0.3 * (a - a.T) + 0.1 * np.eye(n)
    elif kind == "Z":
        a = np.eye(n) * rng.uniform(0.2, 2) - np.abs(a) / n
    elif kind == "singular":
        a = a[:, : n - 1] @ rng.normal(size=(n - 1, n)) if n > 1 else np.zeros((1, 1))
    elif kind == "twins":  # the two contacts of a disk that has no others, beside the rest
        a = np.eye(n) + 0.3 * a
        a[:, -1:], q[-1:] = a[:, :1], q[:1]
        a[-1] = a[0]
    elif kind == "integers":
        a, q = rng.integers(-2, 3, (n, n)).astype(float), rng.integers(-2, 3, n).astype(float)
    elif kind == "skew":
        a = a - a.T + np.diag(rng.integers(0, 2, n))
    elif kind == "hidden Z":
        a = (np.eye(n) - np.abs(a) / (2 * n)) @ np.linalg.inv(np.eye(n) + 0.1 * np.abs(rng.normal(size=(n, n))))
    return a, q


def compared(a, q, size):
    """What differs between the enumeration of (A, q) and the solutions of (size A, q), and the number of solutions."""
    expected = brute.answers(a, q, np.abs(a).max(initial=1e-300), 1e-12)
    ours = [
        (size * s.slip, np.where(s.slides, size * s.rate, s.rate))
        for s in enumerate_solutions(Complementarity(size * a, q))[0]
    ]
    bad = []
    for answer in expected:
        if answer.sure and 0 not in answer.signs and not any(brute.same(answer.rate, rate, 1e-11) for _, rate in ours):
            bad.append(f"{answer.rate} is missing")
    if not expected and ours:
        bad.append("solutions where there are none")
    if any(answer.sure for answer in expected) and not ours:
        bad.append("no solution where there is one")
    for slip, _ in ours:
        w, scale = a @ slip + q, max(np.abs(q).max(), (np.abs(a) @ np.abs(slip)).max())
        if w.min() < -1e-8 * scale or slip.min() < -1e-8 * slip.max() or (np.abs(w) * slip).max() > 1e-7 * scale:
            bad.append(f"{slip} solves nothing")
    if all(answer.sure and 0 not in answer.signs for answer in expected) and len(expected) != len(ours):
        bad.append(f"{len(ours)} solutions where there are {len(expected)}")
    return bad, len(expected)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [1.0, 1e-12, 1e12])
def test_solutions_and_certificates_of_awkward_problems(kind, size):
    counts = set()
    for seed in range(25 if size == 1 else 10):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 6))
        a, q = awkward(kind, n, rng)
        if seed % 3 == 0:
            q[: 1 + n // 2] = 0.0
        with np.errstate(all="warn", under="ignore"):  # the enumeration divides by what it then leaves out
            signs = brute.minor_signs(a, np.abs(a).max(initial=1e-300))
            bad, count = compared(a, q, size)
        problem = Complementarity(size * a, q)
        assert bad == [], (seed, bad)
        counts.add(min(count, 2))
        known = certificate(problem)
        if not np.isnan(signs).any():
            expected = (
                UniquenessVerdict.NOT_UNIQUE
                if signs.min() < 0
                else UniquenessVerdict.SINGULAR
                if signs.min() == 0
                else UniquenessVerdict.UNIQUE
            )
            assert known.verdict is expected, (seed, known, signs)
        _check_evidence(problem, known)
        _check_farkas(problem, count)
    assert counts == {1} if kind in ("P", "hidden Z") else len(counts) > 1


def _check_evidence(problem, known):
    part = problem.matrix[np.ix_(known.contacts, known.contacts)]
    unit = np.abs(problem.matrix).max()
    if known.verdict is UniquenessVerdict.NOT_UNIQUE:
        assert np.linalg.slogdet(part)[0] < 0
    if known.verdict is UniquenessVerdict.SINGULAR:
        assert np.abs(part @ known.vector).max() <= 1e-10 * unit
        assert np.abs(known.vector).max() == 1
    if "H-matrix" in known.reason:
        diagonal = np.diag(part)
        assert ((2 * np.diag(diagonal) - np.abs(part)) @ known.vector > 0).all()


def _check_farkas(problem, count):
    proof = farkas(problem)
    if proof is None:
        return
    assert count == 0
    assert (proof.vector >= 0).all()
    assert problem.vector @ proof.vector < 0
    above = problem.matrix.T @ proof.vector
    assert above.max() <= 1e-9 * (np.abs(problem.matrix).T @ proof.vector).max()


def test_verdicts_do_not_depend_on_units():
    """Rows and columns in units that differ by powers of two: the same minors, the same statuses."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        a, q = rng.normal(size=(2, 5, 5))[0] + np.eye(5), rng.normal(size=5)
        rows, columns = 2.0 ** rng.integers(-30, 30, (2, 5))
        here, there = (
            enumerate_rates(scale_problem(p))
            for p in (Complementarity(a, q), Complementarity(rows[:, None] * a * columns, rows * q))
        )
        assert np.array_equal(here.sign, there.sign)
        assert np.array_equal(here.consistent, there.consistent)


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_signs_of_rates_do_not_depend_on_units(unit):
    assert inconsistent(np.array([True, False]), unit * np.array([-1.0, 0.5])).all()
    assert not inconsistent(np.array([True, False, False]), unit * np.array([-1e-10, 1e-10, -1.0])).any()


def test_slips_of_lemke_are_in_the_units_of_the_problem():
    """A P-matrix with rows and columns in other units: its one solution satisfies the given problem."""
    rng = np.random.default_rng(0)
    rows, columns = 2.0 ** rng.integers(-20, 20, (2, 5))
    a = rows[:, None] * (np.eye(5) + 0.1 * rng.normal(size=(5, 5))) * columns
    q = -rows * rng.uniform(0.5, 1.0, 5)
    slip = lemke(Complementarity(a, q))
    np.testing.assert_allclose(slip, np.linalg.solve(a, -q), rtol=1e-10)
    assert (slip > 0).all()


def test_two_contacts_of_one_disk_are_singular_whatever_round_off_says():
    """A ∝ ((1, 1), (1, 1)) passes a Cholesky factorisation where round-off is on its side."""
    for tiny in (0.0, 1e-16, -1e-16, 3e-15):
        twins = Complementarity(np.array([[1.0, 1.0], [1.0, 1.0 + tiny]]), np.array([-1.0, -1.0]))
        known = certificate(twins)
        assert known.verdict is UniquenessVerdict.SINGULAR
        assert known.value < 1e-14
        np.testing.assert_allclose(np.abs(known.vector), 1)
        slips = sorted(tuple(s.slip.round(9)) for s in enumerate_solutions(twins).solutions)
        assert slips == [(0, 1), (1, 0)]
    known = certificate(Complementarity(np.array([[1.0, 1.0], [1.0, 1.0 + 1e-10]]), np.array([-1.0, -1.0])))
    assert known.verdict is UniquenessVerdict.UNIQUE  # the data say so
    noisy = Complementarity(np.array([[1.0, 1.0], [1.0, 1.0 + 1e-10]]), np.array([-1.0, -1.0]), matrix_error=1e-9)
    assert certificate(noisy).verdict is UniquenessVerdict.SINGULAR  # their errors do not


def test_a_ray_of_lemke_is_no_proof():
    """Lemke's algorithm ends on a ray where a solution exists; enumeration finds it, Farkas says nothing."""
    rng, rays = np.random.default_rng(0), 0
    for _ in range(300):
        problem = Complementarity(rng.normal(size=(3, 3)), rng.normal(size=3))
        if lemke(problem) is None and enumerate_solutions(problem).solutions:
            rays += 1
            assert farkas(problem) is None
    assert rays > 10


def test_farkas_beyond_fourteen_contacts():
    rng = np.random.default_rng(0)
    a, q = rng.normal(size=(30, 30)), rng.normal(size=30)
    a[7], q[7] = -np.abs(a[7]), -1.0  # this contact leaves the cone whatever the others do
    proof = farkas(Complementarity(a, q))
    assert proof.by == "Farkas"
    assert proof.slip == np.inf
    assert (a.T @ proof.vector).max() <= 0
    q[7] = 1.0
    assert farkas(Complementarity(np.eye(30) + 0.01 * a, q)) is None


def test_what_is_not_finite_is_refused():
    for a, q in ((np.array([[np.nan]]), np.ones(1)), (np.eye(1), np.array([np.inf]))):
        with pytest.raises(ValueError, match="not finite"):
            certificate(Complementarity(a, q))
    assert principal_pivoting(Complementarity(np.eye(2), np.array([np.nan, 1.0])))[0] is None


def test_a_map_has_no_image_where_it_is_singular():
    twins = Complementarity(np.ones((2, 2)), np.array([-1.0, -1.0]))
    assert status_map(twins).image.tolist() == [0, 3, 3, -1] or status_map(twins).image[3] == -1
    assert not status_map(twins).bijective
