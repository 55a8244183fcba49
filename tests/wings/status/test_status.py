"""Contact status by the principle of minimum sliding: solvers against enumeration, P-matrices against bijectivity."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stickslip as ss
from stickslip.loading.compression import TOP
from stickslip.wings.status import status as room
from stickslip.wings.status import uniqueness
from stickslip.wings.status.apex_status import contact_status
from stickslip.wings.status.complementarity import (
    AllSolutions,
    Complementarity,
    Solution,
    complementarity,
    enumerate_solutions,
    lemke,
    status_map,
)
from stickslip.wings.status.matrices import force_rates, linear_system, stiffness_matrix
from stickslip.wings.status.status import Verdict
from stickslip.wings.status.system import StatusSolver, pinned_coordinates
from stickslip.wings.status.uniqueness import UniquenessVerdict, certificate
from tests.conftest import make_law, stirred
from tests.derivatives.test_free_cell import packed
from tests.wings.status.five_packings import sample
from tests.wings.status.test_status_against_enumeration import drawn


def jammed_disks(seed, n=24):
    """Matrices of a periodic packing of disks that carry slip; which contacts are critical, and whereto, is drawn."""
    law, rng = make_law("linear", "sharp", mu=0.5), np.random.default_rng(seed)
    state = packed(2, n=n, seed=seed % 4)
    state = stirred(state._replace(control=ss.control.loads(n)), law, rng, size=2e-3)
    m = linear_system(state, law)
    return m._replace(sign=rng.choice([-1.0, 1.0], m.count)), rng


def minors(a):
    """All principal minors, the slow obvious way."""
    n = len(a)
    return [np.linalg.det(a[np.ix_(s, s)]) for k in range(1, n + 1) for s in itertools.combinations(range(n), k)]


def problem(seed, n, strength):
    rng = np.random.default_rng(seed)
    return Complementarity(np.eye(n) + strength * rng.normal(size=(n, n)), rng.normal(size=n))


@given(st.integers(0, 10_000), st.integers(1, 6), st.floats(0.05, 1.5))
def test_the_status_map_is_bijective_for_p_matrices_and_only_for_them(seed, n, strength):
    made = problem(seed, n, strength)
    mapped = status_map(made)
    assert mapped.bijective == (min(minors(made.matrix)) > 0)
    if mapped.bijective:
        assert len(mapped.consistent) == 1


@given(st.integers(0, 10_000), st.integers(1, 9), st.floats(0.05, 0.6))
def test_lemke_finds_the_one_solution(seed, n, strength):
    made = problem(seed, n, strength)
    solution = lemke(made)
    if min(minors(made.matrix)) > 0:
        assert solution is not None
    if solution is not None:
        w = made.matrix @ solution + made.vector
        assert solution.min() >= -1e-9
        assert w.min() >= -1e-9 * max(1, np.abs(w).max())
        assert abs(w @ solution) < 1e-8 * max(1, np.abs(solution).max() * np.abs(w).max())


@given(st.integers(0, 10_000), st.integers(1, 8), st.floats(0.05, 1.5))
def test_a_certificate_is_never_wrong(seed, n, strength):
    made = problem(seed, n, strength)
    uniqueness = certificate(made)
    assert uniqueness.unique == (min(minors(made.matrix)) > 0)
    assert uniqueness.reason


def test_a_certificate_for_many_contacts():
    large = problem(0, 60, 0.01)
    assert certificate(large).unique
    large.matrix[3, 3] = -1
    assert certificate(large).unique is False
    ring = np.eye(30) + 1.2 * np.roll(np.eye(30), 1, axis=1)  # det = 1 − 1.2³⁰, all smaller minors are 1
    uniqueness = certificate(Complementarity(ring, np.ones(30)))
    assert uniqueness.verdict is UniquenessVerdict.NOT_UNIQUE
    assert uniqueness.value == pytest.approx(1 - 1.2**30)
    half = np.eye(16) + 1.2 * np.roll(np.eye(16), 1, axis=1)
    two = Complementarity(np.kron(np.eye(2), half), np.ones(32))  # the minors of either half are negative, not of both
    assert certificate(two).verdict is UniquenessVerdict.UNDECIDED
    assert certificate(two).unique is None
    two.matrix[16:, :16] = two.matrix[:16, :16]
    two.matrix[:16, 16:] = two.matrix[16:, 16:]
    assert certificate(two).verdict in (UniquenessVerdict.NOT_UNIQUE, UniquenessVerdict.SINGULAR)


@pytest.mark.parametrize("seed", range(12))
def test_status_of_a_packing_against_enumeration(seed):
    m, rng = jammed_disks(seed)
    critical = np.sort(rng.choice(m.count, 6, replace=False))
    load = m.c @ rng.normal(size=2 * m.count)
    made = complementarity(m, load, critical=critical)
    mapped, status = status_map(made), contact_status(m, load, critical=critical)
    if mapped.bijective:
        assert status.ok
        bits = status.sliding[critical] @ (1 << np.arange(6))
        assert mapped.consistent.tolist() == [bits]
    if status.ok:
        k = stiffness_matrix(m, status.sliding)
        np.testing.assert_allclose(k @ status.velocity, load, atol=1e-9)
        relative = (m.c.T @ status.velocity).reshape(-1, 2)[critical]
        tilde = m.slope[critical] * relative[:, 0] + m.sign[critical] * relative[:, 1]
        np.testing.assert_allclose(tilde, status.rate, atol=1e-9)
        assert ((tilde >= -1e-9) == status.sliding[critical]).all()
    else:
        assert not mapped.bijective


@pytest.mark.parametrize("seed", range(3))
def test_minors_are_ratios_of_determinants_of_the_stiffness(seed):
    """det A_SS = det k(S)/det k₀."""
    m, rng = jammed_disks(seed)
    critical = np.sort(rng.choice(m.count, 5, replace=False))
    a = complementarity(m, np.zeros(len(m.free)), critical=critical).matrix
    kept = np.setdiff1d(np.arange(len(m.free)), pinned_coordinates(m))
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
    monkeypatch.setattr(room, "MAPPED", 0)  # as for many contacts
    first = contact_status(m, load, critical=critical)
    monkeypatch.setattr(room, "_flip_inconsistent", lambda *_: None)
    second = contact_status(m, load, critical=critical)
    monkeypatch.setattr(room, "principal_pivoting", lambda *_: (None, 0))
    third = contact_status(m, load, critical=critical)
    assert [c.method for c in (first, second, third)] == ["flip all", "principal pivoting", "Lemke"]
    for other in (second, third):
        assert np.array_equal(other.sliding, first.sliding)


def test_a_mechanism_that_the_load_drives_is_reported():
    law = ss.laws.linear(1.0, 0.5, 0.5)
    grains = ss.disks([[0, 0.49], [1.5, 0.49]], 0.5)
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0]), ss.box(dim=2), ss.control.loads(2, 1))
    state = ss.accept(state, ss.forces(state, law)[1])
    m = linear_system(state, law, rattlers=True)
    load = np.zeros(len(m.free))
    load[0] = 1.0  # rolls
    assert contact_status(m, load).verdict is Verdict.MECHANISM


def test_no_consistent_status_is_reported_and_so_are_two():
    nothing = Complementarity(np.array([[-1.0]]), np.array([-1.0]))
    assert lemke(nothing) is None
    assert not len(status_map(nothing).consistent)
    both = Complementarity(np.array([[-1.0]]), np.array([1.0]))
    assert len(status_map(both).consistent) == 2


def test_too_many_contacts_for_a_map():
    with pytest.raises(ValueError, match="15 critical contacts"):
        status_map(Complementarity(np.eye(15), np.ones(15)))


def test_two_critical_contacts_of_one_disk_are_singular_and_not_unique():
    """Its rotation is free: it may slip at either contact, or at both; the forces are the same."""
    state, law = ss.packings.biaxial_box(24, seed=0)
    m = ss.quasirigid.linear_system(state, law)
    lid = (m.free.body == 24 + TOP).astype(float)
    turns = [row for row in np.flatnonzero(m.free.axis == 5) if len(np.unique(m.c[[row]].indices // 2)) == 2]
    verdicts = {}
    for row, side, load in itertools.product(turns, (1.0, -1.0), (lid, -lid)):
        pair, sign = np.unique(m.c[[row]].indices // 2), m.sign.copy()
        sign[pair] = side, -side
        turned = m._replace(sign=sign)
        a = complementarity(turned, load, critical=pair).matrix
        np.testing.assert_allclose(a, a[0, 0], atol=1e-12)
        choice = contact_status(turned, load, critical=pair)
        assert choice.uniqueness.verdict is (
            UniquenessVerdict.SINGULAR if a[0, 0] > 0 else UniquenessVerdict.NOT_UNIQUE
        )
        verdicts[a[0, 0] > 0, choice.verdict] = turned, pair, choice
    assert {v for whole, v in verdicts if whole} == {Verdict.SINGULAR, Verdict.UNIQUE}
    assert {v for whole, v in verdicts if not whole} == {Verdict.NOT_UNIQUE, Verdict.UNSTABLE}
    m, pair, choice = verdicts[True, Verdict.SINGULAR]
    assert choice.ok
    assert choice.uniqueness.value < 1e-12
    first, other = [c for c in (choice, *choice.others) if c.sliding[pair].sum() == 1]
    assert not (first.sliding & other.sliding).any()
    assert first.rate.max() == pytest.approx(other.rate.max())
    here, there = (force_rates(m, c.sliding, c.velocity) for c in (first, other))
    np.testing.assert_allclose(here, there, atol=1e-9 * np.abs(here).max())
    assert np.abs(first.velocity - other.velocity).max() > 0.1 * np.abs(first.velocity).max()


def test_lemke_on_a_ray_does_not_make_a_packing_unstable(monkeypatch):
    """Cases where flipping goes round and Lemke's algorithm ends on a ray although a stable status is consistent."""
    monkeypatch.setattr(room, "_flip_inconsistent", lambda *_: None)
    rng, met = np.random.default_rng(0), 0
    for number in range(800):
        m = sample("box", number % 4)
        m = m._replace(sign=rng.choice([-1.0, 1.0], m.count))
        critical = rng.choice(m.count, 4, replace=False)
        load = m.c @ rng.normal(size=2 * m.count)
        problem = complementarity(m, load, critical=critical)
        if lemke(problem) is not None or not any(s.sign > 0 for s in enumerate_solutions(problem).solutions):
            continue
        met += 1
        choice = contact_status(m, load, critical=critical)
        assert choice.ok
        assert choice.stable
        monkeypatch.setattr(room, "MAPPED", 0)  # as for many contacts
        assert contact_status(m, load, critical=critical).verdict not in (Verdict.UNSTABLE, Verdict.MECHANISM)
        monkeypatch.setattr(room, "MAPPED", 14)
        if met > 2:
            return
    pytest.fail("fewer than three cases")


def many(seed, count=18):
    m = sample(("strained", "box")[seed % 2], seed % 4)
    rng = np.random.default_rng(seed)
    m = m._replace(sign=rng.choice([-1.0, 1.0], m.count))
    return m, rng.choice(m.count, count, replace=False), m.c @ rng.normal(size=2 * m.count)


def test_beyond_fourteen_contacts_every_verdict_has_its_evidence():
    """At least twenty cases, and as many more as are needed to meet every verdict."""
    met, wanted = set(), {Verdict.UNIQUE, Verdict.CONSISTENT, Verdict.UNSTABLE, Verdict.NOT_FOUND}
    for seed in range(80):
        if seed >= 20 and met >= wanted:
            break
        m, critical, load = many(seed)
        choice = contact_status(m, load, critical=critical, unique=True)
        met.add(choice.verdict)
        if choice.verdict is Verdict.UNSTABLE:
            problem = complementarity(m, load, critical=critical)
            y = choice.proof.vector
            assert y.min() >= 0 > problem.vector @ y
            assert (problem.matrix.T @ y).max() <= 1e-9 * np.abs(problem.matrix.T @ y).max()
        elif choice.verdict is Verdict.NOT_FOUND:
            assert choice.proof is None
            assert "but one may exist" in choice.verdict.value
        else:
            assert choice.verdict is not Verdict.UNIQUE or choice.uniqueness.verdict is UniquenessVerdict.UNIQUE
            assert (choice.stable is False) == (choice.verdict is Verdict.NEGATIVE)
            cheap = contact_status(m, load, critical=critical)
            if cheap.method == "flip all":
                assert (cheap.stable, cheap.uniqueness, cheap.verdict) == (None, None, Verdict.CONSISTENT)
    assert met >= wanted


def test_a_certificate_of_farkas_is_verified_before_it_is_believed(monkeypatch):
    """What the linear programme returns is a proposal."""
    made = Complementarity(np.eye(3), np.array([-1.0, 2.0, -3.0]))  # λ = (1, 0, 3)
    for wrong in ([1.0, 0, 0, 1.0], [0, 0, 1.0, 1.0], [np.nan, 0, 0, 1.0]):
        answer = SimpleNamespace(status=0, x=np.array(wrong))
        monkeypatch.setattr(uniqueness, "linprog", lambda *_, answer=answer, **__: answer)
        assert uniqueness.farkas(made) is None
    monkeypatch.undo()
    proof = uniqueness.farkas(Complementarity(np.array([[0.0]]), np.array([-1.0])))  # a motion that nothing resists
    assert proof.slip > 1e9
    assert uniqueness.farkas(Complementarity(np.array([[1e-7]]), np.array([-1.0]))) is None  # λ = 1e7


def test_a_solver_whose_answer_is_not_consistent_is_not_believed(monkeypatch):
    """Whatever a solver returns is verified with k(S)."""
    m, rng = jammed_disks(1)
    critical = np.sort(rng.choice(m.count, 8, replace=False))
    load = m.c @ rng.normal(size=2 * m.count)
    truth = contact_status(m, load, critical=critical).sliding[critical]
    monkeypatch.setattr(room, "MAPPED", 0)
    monkeypatch.setattr(room, "_flip_inconsistent", lambda *_: None)
    monkeypatch.setattr(room, "principal_pivoting", lambda *_: (~truth, 1))
    monkeypatch.setattr(room, "lemke", lambda *_: np.where(truth, np.nan, 1.0))
    status = contact_status(m, load, critical=critical)
    assert status.verdict is Verdict.NOT_FOUND
    assert not status.ok
    assert np.isnan(status.velocity).all()


def test_a_status_found_by_flipping_stands_if_enumeration_confirms_none(monkeypatch):
    """And without either the verdict is NOT_FOUND, also for few contacts: nothing is proven."""
    monkeypatch.setattr(room, "_verify_solution", lambda system, solution: None)
    seen = set()
    for number in (k for k in range(60) if k % 5 in (0, 2)):  # boxes and rows
        m, load, critical = drawn(number, 6)
        choice = contact_status(m, load, critical=critical)
        if not choice.uniqueness or choice.uniqueness.unique or choice.verdict in (Verdict.UNSTABLE, Verdict.MECHANISM):
            continue
        seen.add(choice.verdict)
        if choice.verdict is Verdict.CONSISTENT:
            k = stiffness_matrix(m, choice.sliding).toarray()
            assert np.abs(k @ choice.velocity - load).max() < 1e-6 * np.abs(load).max()
    assert seen == {Verdict.CONSISTENT, Verdict.NOT_FOUND}


def test_rattlers_among_the_coordinates_do_not_hide_a_status():
    """k is singular: the rattlers, which no load drives, stand still."""
    m, without = sample("row", 1), sample("row", 1)
    assert np.linalg.matrix_rank(stiffness_matrix(m, np.zeros(m.count, bool)).toarray()) < len(m.free)
    critical = np.array([2, 11])
    load = without.c @ np.random.default_rng(1).normal(size=2 * m.count)
    choice = contact_status(m, load, critical=critical)
    assert choice.ok
    np.testing.assert_allclose(stiffness_matrix(m, choice.sliding) @ choice.velocity, load, atol=1e-9)
    load[m.free.body == 15] += 1.0  # a rattler
    choice = contact_status(m, load, critical=critical)
    assert choice.verdict is Verdict.MECHANISM
    k = stiffness_matrix(m, np.zeros(m.count, bool))
    assert np.abs(k @ choice.proof.velocity).max() < 1e-12
    assert abs(choice.proof.balance @ load) > 0.1
    assert set(np.flatnonzero(np.abs(choice.proof.velocity) > 1e-9)) <= set(np.flatnonzero(m.free.body == 15))


def test_a_contact_just_on_the_edge_is_marginal_and_its_status_is_still_unique():
    m, _ = jammed_disks(3)
    critical = np.array([4, 9])
    c = m.c.toarray()
    g = c[:, 2 * critical] * m.slope[critical] + c[:, 2 * critical + 1] * m.sign[critical]
    v = np.linalg.lstsq(g.T, [0.0, -1.0], rcond=None)[0]
    load = stiffness_matrix(m, np.zeros(m.count, bool)) @ v
    choice = contact_status(m, load, critical=critical)
    assert choice.verdict is Verdict.UNIQUE
    assert choice.marginal.tolist() == [True, False]


def tilted(angle, mu=0.3, depth=0.01):
    """One disk that cannot turn, at the Coulomb limit on a tilted floor: nothing resists that it slides on."""
    normal = np.array([np.sin(angle), np.cos(angle), 0])
    down = np.array([normal[1], -normal[0], 0])
    law = ss.laws.for_pair(ss.laws.linear(1.0, 0.37, mu), 0, 1)
    control = ss.control.loads(1, 1, force=[depth * (mu * down - normal)])
    control.free[:, 3:] = control.free[1:] = False
    state = ss.assembly(
        ss.disks([(0.5 - depth) * normal], 0.5), ss.flat_walls([0, 0, 0], normal), ss.box(dim=2), control
    )
    state = ss.accept(state, ss.forces(state, law)[1])
    state.contacts.slip[0], state.contacts.mode[0] = mu * depth / 0.37 * down, ss.SLIDE
    return linear_system(state, law, rattlers=True), down[:2]


def test_what_slides_without_resistance_is_a_mechanism_whatever_round_off_does():
    for angle in np.linspace(0.01, 1.5, 15):
        m, down = tilted(angle)
        choice = contact_status(m, down)
        assert choice.verdict is Verdict.MECHANISM
        assert abs(choice.proof.power) == pytest.approx(np.cos(np.arctan(0.3)), abs=0.02)  # forces turn by δ/R
        assert contact_status(m, -down).verdict is Verdict.UNIQUE  # it sticks


def test_in_a_packing_of_two_contacts_no_status_is_found_that_is_not_consistent():
    """Where sliding needs no load, A has entries of round-off, which must not become units."""
    state, law = ss.packings.biaxial_box(6, pressure=1e-3, mu=1.0, seed=1000, tolerance=1e-6)
    whole = linear_system(state, law)
    critical, rng, met = np.arange(whole.count)[:4], np.random.default_rng(0), set()
    for _ in range(25):
        m = whole._replace(sign=rng.choice([-1.0, 1.0], whole.count))
        slides = np.isin(np.arange(m.count), critical[rng.random(len(critical)) < 0.5])
        load = stiffness_matrix(m, slides) @ rng.normal(size=len(m.free))
        choice = contact_status(m, load, critical=critical)
        met.add(choice.verdict)
        for status in [choice, *choice.others] if choice.ok else []:
            normal, along = (m.c.T @ status.velocity).reshape(-1, 2).T[:, critical]
            rate = m.slope[critical] * normal + m.sign[critical] * along
            slack = 1e-6 * np.abs(rate).max() + 1e-12 * np.abs(status.velocity).max()
            assert (np.where(status.sliding[critical], rate, -rate) > -slack).all()
    assert len(met) > 1


def test_a_solution_with_huge_error_bounds_is_verified_all_the_same(monkeypatch):
    m, down = tilted(0.3)
    vague = Solution(np.array([False]), np.zeros(1), np.zeros(1), np.full(1, 1e30), 0)
    monkeypatch.setattr(room, "enumerate_solutions", lambda *_: AllSolutions((vague,), ()))
    monkeypatch.setattr(room, "_flip_inconsistent", lambda *_: None)
    assert contact_status(m, down).verdict is Verdict.NOT_FOUND


def test_a_motion_that_is_resisted_or_not_driven_is_no_mechanism():
    m, down = tilted(0.3)
    status, slides = contact_status(m, down).proof, np.array([True])
    system = StatusSolver(m, down, np.array([0]), True)
    v, u = status.velocity[system.kept], status.balance[system.kept]
    across = np.array([-v[1], v[0]])
    assert uniqueness._verify_motion(system, v, u, slides).power == pytest.approx(status.power)
    assert uniqueness._verify_motion(system, v, u, ~slides) is None  # it sticks
    assert uniqueness._verify_motion(system, across, u, slides) is None
    assert uniqueness._verify_motion(system, v, across, slides) is None
    idle = StatusSolver(m, np.array([-status.balance[1], status.balance[0]]), np.array([0]), True)
    assert uniqueness._verify_motion(idle, v, u, slides) is None
