"""Rattlers are pushed aside by the least distance, and wedged where there is no room or friction holds them."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.measure import mean_normal_force
from stickslip.wings.status.events import gaps, move_aside, release_rattlers
from stickslip.wings.status.increment import PathState
from stickslip.wings.status.path import _reinstate_wedged

LAW = ss.laws.linear(1.0, 0.5, 0.5, coulomb="sharp")


def between(*others, law=LAW):
    """A rattler of radius 1/2 at the origin, and grains that hold their places, at given centres."""
    position = [[0.0, 0.0], *others]
    state = ss.assembly(ss.disks(position, 0.5), cell=ss.box(dim=2))
    state = ss.accept(state, ss.forces(state, law)[1])
    return state, np.arange(len(position)) == 0


def test_a_pressed_rattler_gives_way_along_the_normal():
    state, loose = between([0.99, 0.0])
    moved, wedge = move_aside(state, LAW, loose)
    assert not len(wedge)
    assert moved.grains.position[0] == pytest.approx([-0.01, 0, 0], abs=1e-11)
    assert moved.grains.position[1] == pytest.approx([0.99, 0, 0])
    assert not len(ss.measure.touching(moved))


def test_two_at_right_angles_push_it_into_the_free_quarter():
    state, loose = between([0.99, 0.0], [0.0, 0.98])
    moved, wedge = move_aside(state, LAW, loose)
    assert not len(wedge)
    _, gap = gaps(moved, np.arange(int(moved.contacts.count[0])))
    assert gap.min() >= 0
    assert moved.grains.position[0, :2] == pytest.approx([-0.01, -0.02], abs=3e-4)


def test_two_opposite_ones_wedge_it():
    state, loose = between([0.99, 0.0], [-0.99, 0.0])
    same, wedge = move_aside(state, LAW, loose)
    assert len(wedge) == 2
    assert np.array_equal(same.grains.position, state.grains.position)


def test_friction_holds_what_would_slip_out_without():
    """Normals 20 degrees off the line: within the friction angle of 27 degrees for μ = 1/2, outside 6 for μ = 0.1."""
    turn = np.radians(20)
    place = 0.99 * np.array([np.cos(turn), np.sin(turn)])
    state, loose = between(place, place * [-1, 1])
    assert len(move_aside(state, LAW, loose)[1]) == 2
    slippery = ss.laws.linear(1.0, 0.5, 0.1, coulomb="sharp")
    moved, wedge = move_aside(state, slippery, loose)
    assert not len(wedge)
    assert moved.grains.position[0, 1] < -0.01


def test_friction_draws_along_what_it_holds():
    """Neighbours below it that rise by 0.01 hold a rattler by friction; it rises with them, and has room as before."""
    beside, height = 1.0001 * np.cos(0.3), 1.0001 * np.sin(0.3)
    before, _ = between([beside, -height], [-beside, -height])
    state, loose = between([beside, 0.01 - height], [-beside, 0.01 - height])
    assert len(move_aside(state, LAW, loose)[1]) == 2  # pushed without being drawn, it is held
    moved, wedge = move_aside(state, LAW, loose, before)
    assert not len(wedge)
    assert moved.grains.position[0] == pytest.approx([0, 0.01, 0], abs=1e-9)
    closer = before.grains.position * [0.999, 1, 1]
    state = before._replace(grains=before.grains._replace(position=closer))
    state = ss.accept(state, ss.forces(state, LAW)[1])
    assert len(move_aside(state, LAW, loose, before)[1]) == 2  # what comes from both sides wedges it


def test_a_chain_of_rattlers_moves_together_and_three_hold_one():
    state, _ = between([-0.99, 0.0], [0.99, 0.0])
    moved, wedge = move_aside(state, LAW, np.array([True, False, True]))
    assert not len(wedge)
    assert moved.grains.position[2, 0] > moved.grains.position[0, 0] > 0
    angles = 2 * np.pi * np.arange(3) / 3
    ring = 0.99 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    assert len(move_aside(*_swapped(between(*ring)))[1]) >= 2


def _swapped(pair):
    state, loose = pair
    return state, LAW, loose


def test_without_rattlers_nothing_happens():
    state, loose = between([0.99, 0.0])
    assert move_aside(state, LAW, np.zeros_like(loose))[0] is state


def test_of_rattlers_wedged_at_once_none_is_left_behind():
    """Two, each between neighbours of its own; what wedges the first is handed over, and the second carries, too."""
    centres = [[0, 0], [0.99, 0], [-0.99, 0], [0, 9], [0.99, 9], [-0.99, 9]]
    state = ss.assembly(ss.disks(centres, 0.5), cell=ss.box(dim=2))
    state = ss.accept(state, ss.forces(state, LAW)[1])
    contacts, none = state.contacts, np.zeros(len(state.contacts.mode), bool)
    first = np.flatnonzero((contacts.i == 0) | (contacts.j == 0))
    place = PathState(release_rattlers(state, np.arange(6) % 3 == 0), np.arange(6) % 3 == 0, none, none, True, -np.inf)
    after, events = _reinstate_wedged(place, LAW, first, 0.5)
    assert not after.loose.any()
    assert [(e.kind, e.i) for e in events] == [
        ("is wedged and carries load again", 0),
        ("is wedged and carries load again", 3),
    ]
    assert len(ss.measure.touching(after.state)) == after.fresh.sum() == 4
    assert mean_normal_force(after.state, LAW) == pytest.approx(0.01)
