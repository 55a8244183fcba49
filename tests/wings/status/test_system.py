"""The fast solver behind `contact_status` against dense solutions, and what it refuses to believe."""

import numpy as np
import pytest
from scipy.linalg import LinAlgError

import stickslip as ss
from stickslip.wings.status import status as room
from stickslip.wings.status import system as fast
from stickslip.wings.status.apex_status import contact_status
from stickslip.wings.status.complementarity import Complementarity, complementarity, principal_pivoting, status_map
from stickslip.wings.status.matrices import linear_system, stiffness_matrix
from stickslip.wings.status.status import Verdict
from stickslip.wings.status.system import StatusSolver, elimination_order, pinned_coordinates
from tests.conftest import make_law, stirred
from tests.derivatives.test_free_cell import packed


def sample(seed, cell_free=False, n=40):
    """Matrices of a packing that carries slip, 14 contacts to be critical, and a load that it carries."""
    law, rng = make_law("linear", "sharp", mu=0.5), np.random.default_rng(seed)
    state = packed(2, n=n, seed=seed % 4)
    control = ss.control.loads(n)
    if cell_free:
        control = ss.control.stress_controlled(control, {"xx": 0.01, "yy": 0.01, "xy": 2e-3})
    m = linear_system(stirred(state._replace(control=control), law, rng, size=2e-3), law)
    m = m._replace(sign=rng.choice([-1.0, 1.0], m.count))
    critical = np.sort(rng.choice(m.count, 14, replace=False))
    return m, critical, m.c @ rng.normal(size=2 * m.count), rng


def densely(m, load, sliding, geometric=True):
    """Velocities of a status by LAPACK, and Ṽ of all contacts from the relative velocities."""
    kept = np.setdiff1d(np.arange(len(m.free)), pinned_coordinates(m))
    k = stiffness_matrix(m, sliding, geometric=geometric).toarray()[np.ix_(kept, kept)]
    v = np.zeros(len(m.free))
    v[kept] = np.linalg.solve(k, load[kept])
    relative = (m.c.T @ v).reshape(-1, 2)
    return v, m.slope * relative[:, 0] + m.sign * relative[:, 1]


@pytest.mark.parametrize("few", [0, 3, 100])
@pytest.mark.parametrize("cell_free", [False, True])
@pytest.mark.parametrize("geometric", [True, False])
def test_rates_of_a_walk_through_statuses_are_those_of_lapack(few, cell_free, geometric, monkeypatch):
    """few: never, sometimes, and always (but for the first one) is a factor corrected instead of made anew."""
    monkeypatch.setattr(fast, "FEW", few)
    m, critical, load, rng = sample(few, cell_free)
    system = StatusSolver(m, load, critical, geometric)
    slides = rng.random(14) < 0.5
    for turn in range(12):
        slides = slides ^ np.isin(np.arange(14), rng.choice(14, 1 + turn % 6, replace=False))
        sliding = np.isin(np.arange(m.count), critical[slides])
        v, tilde = densely(m, load, sliding, geometric)
        velocity, rate = system.rates(slides)
        scale = np.abs(v).max()
        np.testing.assert_allclose(velocity, v, atol=1e-9 * scale)  # condition numbers up to 1e6
        np.testing.assert_allclose(rate, tilde[critical], atol=1e-9 * scale)
    assert system.solves == {0: 12, 100: 1}.get(few, system.solves)


def test_bodies_in_elimination_order_are_all_coordinates_once():
    m, _, _, _ = sample(2, cell_free=True)
    order = elimination_order(m.c, m.free.body)
    assert np.array_equal(np.sort(order), np.arange(len(m.free)))
    body = m.free.body[order]
    assert (np.diff(body) != 0).sum() == len(np.unique(body)) - 1  # coordinates of one body stay together
    assert body[-1] == m.free.bodies or (body[-4:] == m.free.bodies).any()  # the cell touches all: among the last
    assert elimination_order(m.c[:0], m.free.body[:0]).tolist() == []


def disk_between_floors():
    """A disk between two floors: k is singular unless both contacts stick."""
    law = ss.laws.linear(1.0, 0.5, 0.5)
    walls = ss.flat_walls([[0, 0.01], [0, 0.99]], [[0, 1], [0, -1]])
    state = ss.assembly(ss.disks([[0, 0.5]], 0.5), walls, ss.box(dim=2), ss.control.loads(1, 2))
    return linear_system(ss.accept(state, ss.forces(state, law)[1]), law)


@pytest.mark.parametrize(
    ("load", "verdict"),
    [
        ([0, 0, -1.0], Verdict.UNIQUE),  # turns it out of sliding
        ([0, 0, 1.0], Verdict.MECHANISM),
        ([0.2, -1.0, 0], Verdict.MECHANISM),
    ],
)
def test_a_singular_status_on_the_way_is_no_verdict(load, verdict):
    m = disk_between_floors()
    both, load = np.array([0, 1]), np.array(load)
    with pytest.raises(LinAlgError):
        StatusSolver(m, load, both, True).rates(np.array([True, True]))
    status = contact_status(m, load, critical=both)
    assert status.verdict is verdict
    mapped = status_map(complementarity(m, load, critical=both))
    assert mapped.consistent.tolist() == ([0] if status.ok else [])
    assert not status.sliding.any()
    if not status.ok:
        k = stiffness_matrix(m, np.isin([0, 1], both[status.proof.sliding]))
        assert np.abs(k @ status.proof.velocity).max() < 1e-12
        assert np.abs(k.T @ status.proof.balance).max() < 1e-12
        assert abs(status.proof.balance @ load) > 0.1


def test_a_solution_that_misses_the_load_is_not_believed():
    m, critical, load, _ = sample(1)
    system, slides = StatusSolver(m, load, critical, True), np.zeros(14, bool)
    system.rates(slides)
    right = system.answer
    for wrong in (np.full_like(right, np.nan), 1.001 * right):
        system.answer = wrong
        with pytest.raises(LinAlgError):
            system.rates(slides)
    # where a correction goes wrong, a factor made anew takes its place
    slides[3] = True
    velocity, _ = system.rates(slides)
    v, _ = densely(m, load, np.isin(np.arange(m.count), critical[3]))
    np.testing.assert_allclose(velocity, v, atol=1e-9 * np.abs(v).max())
    assert system.solves == 2


def test_without_a_p_matrix_lemke_takes_over_at_once(monkeypatch):
    called = []
    monkeypatch.setattr(room, "MAPPED", 0)  # as for many contacts
    monkeypatch.setattr(room, "_flip_inconsistent", lambda *_: None)
    monkeypatch.setattr(room, "may_be_p_matrix", lambda a: False)
    monkeypatch.setattr(room, "principal_pivoting", lambda problem: called.append(1))
    m, critical, load, _ = sample(1)
    status = contact_status(m, load, critical=critical)
    assert status.method == "Lemke"
    assert not called


def test_pivoting_that_comes_back_gives_up():
    """A 3-cycle of Murty's rule: no P-matrix."""
    rng, ended = np.random.default_rng(0), []
    for _ in range(300):
        problem = Complementarity(rng.normal(size=(3, 3)), rng.normal(size=3))
        solution, pivots = principal_pivoting(problem)
        ended.append((solution is None, pivots))
    assert any(gone and pivots > 0 for gone, pivots in ended)
    assert max(pivots for _, pivots in ended) <= 8


def test_loads_that_are_no_loads_are_refused():
    m, critical, load, _ = sample(1)
    with pytest.raises(ValueError, match="one component for each coordinate"):
        contact_status(m, load[1:], critical=critical)
    load[3] = np.nan
    with pytest.raises(ValueError, match="load contains NaN or infinity"):
        contact_status(m, load, critical=critical)
