"""`contact_status` with contacts that carry no force: closed forms, Newton's method, and what it refuses."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.control import between
from stickslip.wings.status import apex_status
from stickslip.wings.status.events import APEX
from stickslip.wings.status.status import Verdict
from stickslip.wings.status.system import external_force
from tests.wings.status.test_status_of_spheres import path_of, squeezed

PRESS = 0.01


def beside_a_wall(dim):
    """A grain between a floor and a lid, neither of which can turn it, which touches a third wall without force."""
    up, along = np.eye(3)[1], np.eye(3)[0]
    walls = ss.flat_walls([(PRESS - 0.5) * up, (0.5 - PRESS) * up, (0.5 - 1e-12) * along], [up, -up, -along])
    make = ss.disks if dim == 2 else ss.spheres
    law = ss.laws.linear(1.0, 0.5, 0.4, coulomb="sharp")
    state = ss.assembly(make([[0, 0, 0]], 0.5), walls, ss.box(dim=dim), ss.control.loads(1, 3))
    state = ss.accept(state, ss.forces(state, law)[1])
    return ss.quasirigid.linear_system(state, law)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(("way", "velocity"), [(1.0, 0.5), (-1.0, -1.0)])
def test_a_grain_leans_on_a_wall_or_leaves_it(dim, way, velocity):
    """Two tangential springs of 0.5, with one normal spring of 1 beside them if it leans on the wall."""
    m = beside_a_wall(dim)
    assert m.count == 3
    choice = ss.quasirigid.contact_status(m, way * (m.free.axis == 0))
    assert choice.verdict is Verdict.CONSISTENT
    assert choice.ok
    assert choice.velocity[m.free.axis == 0] == pytest.approx(velocity, rel=1e-2)  # overlaps turn forces, too
    assert choice.opens.tolist() == [False, False, way < 0]
    flat = ss.quasirigid.contact_status(m, way * (m.free.axis == 0), geometric=False)
    assert flat.velocity[m.free.axis == 0] == pytest.approx(velocity)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_status_that_is_not_that_of_the_law_is_not_returned(dim, monkeypatch):
    m = beside_a_wall(dim)
    load = 1.0 * (m.free.axis == 0)

    def other(matrix, load, *given, **how):
        return decide(matrix, -load, *given, **how)

    def wrong(*given, **how):
        choice = decide(*given, **how)
        return choice._replace(motion=-choice.motion)

    def none(*given, **how):
        return decide(*given, **how)._replace(status=None)

    decide = apex_status.decide_statuses
    for instead in (other, wrong, none):
        monkeypatch.setattr(apex_status, "decide_statuses", instead)
        choice = ss.quasirigid.contact_status(m, load)
        assert choice.verdict is Verdict.NOT_FOUND
        assert not choice.ok
        assert np.isnan(choice.velocity).all()


@pytest.mark.slow
def test_statuses_on_a_path_are_those_of_small_increments_by_newtons_method():
    """Where a contact of spheres has lost its force or is about to carry some; two increments, whose difference counts.

    In a few cases another contact reaches its limit within the increments.
    """
    errors, path = [], path_of(2)
    start, end, last = path.points[0].state, squeezed(path.points[0].state.control), -1.0
    for point in path.points[1:-1]:
        state = point.state._replace(control=between(start.control, end, point.load))
        m = ss.quasirigid.linear_system(state, path.law)
        if point.load < last + 1e-3 or not (m.force[:, 0] <= APEX * m.force[:, 0].mean()).any():
            continue
        last = point.load
        load = external_force(state._replace(control=end), m.free) - external_force(state, m.free)
        choice, cells = ss.quasirigid.contact_status(m, load), []
        assert choice.verdict is Verdict.CONSISTENT
        for size in (1e-4, 2e-4):
            moved = state._replace(control=between(state.control, end, size))
            moved, outcome = ss.equilibrate(moved, path.law, check="nothing")
            assert outcome.ok
            cells.append(moved.cell.vectors)
        strain, predicted = np.linalg.solve(*cells).T - np.eye(3), m.free.strain(choice.velocity)
        errors.append(np.abs(strain / 1e-4 - predicted).max() / np.abs(predicted).max())
    assert len(errors) >= 3
    assert np.median(errors) < 1e-3
