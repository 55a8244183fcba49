"""Null modes of the stiffness matrix fall into the classes of Sec. III E of McNamara & Herrmann 2006."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.wings.status.matrices import linear_system, stiffness_matrix
from stickslip.wings.status.rigidity import DRIVEN, IDLE, RATTLER, RIGID, mechanisms
from tests.conftest import make_law


def boxed(free_walls=True):
    """Four disks between four walls that translate, and a fifth one in the hole between them that touches nothing."""
    d = 0.495
    grains = ss.disks([[-d, -d], [d, -d], [d, d], [-d, d], [0, 0]], [0.5, 0.5, 0.5, 0.5, 0.1])
    side = 2 * d - 0.01
    walls = ss.flat_walls([[-side, 0], [side, 0], [0, -side], [0, side]], [[1, 0], [-1, 0], [0, 1], [0, -1]])
    control = ss.control.loads(5, 4)
    control.free[5:, :2] = free_walls
    state = ss.assembly(grains, walls, ss.box(dim=2), control)
    law = ss.laws.linear(1.0, 0.5, 0.4)
    return ss.accept(state, ss.forces(state, law)[1]), law


def test_walls_that_translate_and_a_rattler():
    state, law = boxed()
    modes = mechanisms(state, law)
    assert [m.kind for m in modes] == [RIGID] * 2 + [RATTLER] * 3
    k = stiffness_matrix(linear_system(state, law, rattlers=True), geometric=False)
    for mode in modes:
        assert np.linalg.norm(k @ mode.vector) < 1e-12
        assert np.linalg.norm(mode.vector) == pytest.approx(1)
        assert not mode.deforms
    assert not [m for m in mechanisms(*boxed(free_walls=False)) if m.kind == RIGID]


def test_a_disk_that_rolls_is_driven_by_a_push_and_not_by_a_press():
    law = ss.laws.linear(1.0, 0.5, 0.5)
    grains = ss.disks([[0, 0.49]], 0.5)
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0]), ss.box(dim=2), ss.control.loads(1, 1))
    state = ss.accept(state, ss.forces(state, law)[1])
    assert len(linear_system(state, law).free) == 0  # one contact: a rattler
    pushed, pressed = (mechanisms(state, law, np.array(load)) for load in ([1.0, 0, 0], [0, -1.0, 0]))
    assert {m.kind for m in pushed} == {RATTLER}
    assert [m.power for m in pushed] == pytest.approx([1, 0, 0])
    assert [m.power for m in pressed] == pytest.approx([0, 1, 0])


def test_sliding_contacts_make_a_mechanism_that_some_loads_drive():
    """A disk between two floors whose both contacts slide moves along them freely."""
    law = ss.laws.linear(1.0, 0.5, 0.5)
    grains = ss.disks([[0, 0.5]], 0.5)
    walls = ss.flat_walls([[0, 0.01], [0, 0.99]], [[0, 1], [0, -1]])
    state = ss.assembly(grains, walls, ss.box(dim=2), ss.control.loads(1, 2))
    state = ss.accept(state, ss.forces(state, law)[1])
    stuck = mechanisms(state, law, np.array([1.0, 0, 0]), sliding=[False, False])
    assert not stuck
    along = mechanisms(state, law, np.array([1.0, 0, 0]), sliding=[True, True])
    assert sorted(m.kind for m in along) == sorted([IDLE, DRIVEN])
    driven = next(m for m in along if m.kind == DRIVEN)
    assert abs(driven.vector[0]) == pytest.approx(1)
    assert driven.deforms
    # a press changes both normal forces, and friction with them; a push of mu times as much takes that up
    across = mechanisms(state, law, np.array([0.0, -1.0, 0]), sliding=[True, True])
    assert DRIVEN in [m.kind for m in across]
    balanced = mechanisms(state, law, np.array([0.5, -1.0, 0]), sliding=[True, True])
    assert [m.kind for m in balanced] == [IDLE, IDLE]


def test_bad_loads_are_refused():
    state, law = boxed()
    with pytest.raises(ValueError, match="one component for each coordinate"):
        mechanisms(state, law, np.zeros(3))


def test_a_free_periodic_packing_translates():
    state, _ = ss.packings.jammed(30, packing_fraction=0.88, dim=2, seed=1)
    law = make_law("linear", "sharp")
    state = ss.accept(state, ss.forces(state, law)[1])
    loose = ss.measure.rattlers(state, 2).sum()
    assert [m.kind for m in mechanisms(state, law)] == [RIGID] * 2 + [RATTLER] * (3 * loose)
