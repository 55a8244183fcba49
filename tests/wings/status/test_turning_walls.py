"""Walls that may turn: their columns of c and the geometric stiffness by finite differences, the third rigid motion."""

from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.wings.status.apex_status import contact_status
from stickslip.wings.status.matrices import linear_system, stiffness_matrix
from stickslip.wings.status.rigidity import IDLE, RIGID, mechanisms, rigid_rotation
from stickslip.wings.status.system import pinned_coordinates

N, ARM = 45, 3.0  # with 30 disks, walls of which few disks hold turn by mechanisms of their own


@cache
def boxed(pressure):
    """Disks at rest between four walls, which are then all free to translate; each wall touches two disks or more.

    A wall that a single disk holds moves along itself, a mechanism. Which seeds lead to one differs among processors.
    """
    for seed in range(1, 10):
        state, law = ss.packings.biaxial_box(N, pressure=pressure, seed=seed)
        touched = state.contacts.j[linear_system(state, law).rows]
        if np.bincount(touched, minlength=N + 4)[N:].min() >= 2:
            break
    free = state.control.free.copy()
    free[N:, :2] = True
    return state._replace(control=state.control._replace(free=free)), law


def turned(state, free, step):
    """The state with its coordinates moved, walls' angles included."""
    angle = free.spread(step)[N:, 5] / ARM
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = state.walls.normal.T
    normal = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)
    moved = ss.modes.displaced(state, free, step)
    return moved._replace(walls=moved.walls._replace(normal=normal))


def overlaps(state, rows):
    radius = np.append(state.grains.radius, np.zeros(4))
    far = np.linalg.norm(ss.measure.branch_vectors(state)[rows], axis=1)
    return radius[state.contacts.i[rows]] + radius[state.contacts.j[rows]] - far


def test_overlaps_change_as_the_columns_of_turning_walls_say():
    state, law = boxed(1e-3)
    m, h = linear_system(state, law, wall_arm=ARM), 1e-6
    v = np.random.default_rng(0).normal(size=len(m.free))
    v[m.free.axis == 5] *= 3
    before, after = (overlaps(turned(state, m.free, s * h * v), m.rows) for s in (-1, 1))
    # curvature 1/R times the square of the step, and round-off over the step
    np.testing.assert_allclose((m.c.T @ v)[::2], (before - after) / (2 * h), atol=1e-8)
    on_walls = state.contacts.j[m.rows] >= N
    assert np.abs((m.c[-4:].T @ v[-4:])[::2][on_walls]).min() > 1e-3


def test_geometric_stiffness_of_turning_walls_is_how_c_turns():
    state, law = boxed(1e-3)
    m, h = linear_system(state, law, wall_arm=ARM), 1e-5
    assert np.abs(m.force[:, 1]).max() > 0.05 * m.force[:, 0].mean()
    columns, numeric = [*range(0, len(m.free) - 4, 4), *range(len(m.free) - 4, len(m.free))], []  # all of the walls
    for unit in np.eye(len(m.free))[columns]:
        pair = [
            linear_system(turned(state, m.free, s * h * unit), law, wall_arm=ARM).c @ m.force.ravel() for s in (1, -1)
        ]
        numeric.append((pair[1] - pair[0]) / (2 * h))
    assert {0, 1, 5} == set(m.free.axis[columns[:-4]].tolist())
    numeric = np.stack(numeric, axis=1)
    # forces of 1e-3 and third derivatives of order 1/R² times the squared step; round-off of 1e-19 over the step
    np.testing.assert_allclose(m.geometric.toarray()[:, columns], numeric, atol=1e-11)
    assert np.abs(numeric[-4:]).max() > 1e-5


def test_without_turning_nothing_changes():
    state, law = boxed(1e-3)
    plain, more = linear_system(state, law), linear_system(state, law, wall_arm=ARM)
    size = len(plain.free)
    assert len(more.free) == size + 4
    assert np.array_equal(more.c.toarray()[:size], plain.c.toarray())
    assert np.array_equal(more.free.component[:size], plain.free.component)
    assert more.free.body[size:].tolist() == [N, N + 1, N + 2, N + 3]
    assert (more.free.axis[size:] == 5).all()
    change = (more.geometric[:size][:, :size] - plain.geometric).toarray()
    assert not change.any()
    assert np.array_equal(pinned_coordinates(more), pinned_coordinates(plain))


# 4 s: boxes at two pressures, of which one is for this test alone
def test_the_rigid_rotation_costs_the_square_of_the_overlap():
    pressures, quotients = np.array([1e-3, 1e-5]), []
    for pressure in pressures:
        state, law = boxed(pressure)
        m = linear_system(state, law, wall_arm=ARM)
        v = rigid_rotation(state, m.free, ARM)
        relative = (m.c.T @ v).reshape(-1, 2)
        assert np.abs(relative[:, 0]).max() < 1e-12
        np.testing.assert_allclose(np.abs(relative[:, 1]), overlaps(state, m.rows), atol=1e-12)
        cost = v @ (stiffness_matrix(m, geometric=False) @ v)
        assert not m.limit.any()
        assert cost == pytest.approx((m.springs[:, 1, 1] * overlaps(state, m.rows) ** 2).sum(), rel=1e-9)
        quotients.append(cost / (v @ v))
    slope = np.log(quotients[0] / quotients[-1]) / np.log(pressures[0] / pressures[-1])
    # packings at other pressures have other force networks: mean squares of overlaps over P² within a factor of 3
    assert slope == pytest.approx(2, abs=0.25)


@pytest.mark.parametrize("pressure", [1e-3, 1e-5])
def test_three_rigid_motions_with_turning_walls_and_two_without(pressure):
    state, law = boxed(pressure)
    two, three = mechanisms(state, law), mechanisms(state, law, wall_arm=ARM)
    assert [m.quotient for m in two if m.kind == RIGID] == [0, 0]
    rigid = [m for m in three if m.kind == RIGID]
    assert [m.deforms for m in rigid] == [False, False, True]
    assert [m.quotient for m in rigid][:2] == [0, 0]
    assert 0.1 * pressure**2 < rigid[2].quotient < 10 * pressure**2
    vectors = np.stack([m.vector for m in rigid])
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(3), atol=1e-12)
    # walls may also turn about the one disk that touches them
    assert {m.kind for m in two} <= {m.kind for m in three} <= {m.kind for m in two} | {IDLE}
    # at 1e-5 the turn's singular value is below 1e-10 of the largest: it is not counted again beside walls that turn
    # about the one disk that touches them
    idle = np.array([m.vector for m in three if m.kind == IDLE]).reshape(-1, vectors.shape[1])
    assert np.linalg.norm(idle @ vectors[2]) < 1e-6


def test_a_wall_that_stands_still_resists():
    state, law = boxed(1e-3)
    free = state.control.free.copy()
    free[N, 0] = False
    held = state._replace(control=state.control._replace(free=free))
    assert [m.kind for m in mechanisms(held, law, wall_arm=ARM)].count(RIGID) == 1


def test_status_takes_turning_walls():
    state, law = boxed(1e-3)
    m, critical = linear_system(state, law, wall_arm=ARM), np.array([0, 5, 9])
    velocity = np.random.default_rng(1).normal(size=len(m.free))
    normal, along = (m.c.T @ velocity).reshape(-1, 2).T
    slides = np.isin(np.arange(m.count), critical) & (m.slope * normal + m.sign * along > 0)
    load = stiffness_matrix(m, slides) @ velocity  # which one status balances, at least
    status = contact_status(m, load, critical=critical)
    assert status.ok
    np.testing.assert_allclose(stiffness_matrix(m, status.sliding) @ status.velocity, load, atol=1e-6)


def test_walls_that_cannot_turn_are_refused():
    state, law = boxed(1e-3)
    with pytest.raises(ValueError, match="must be positive"):
        linear_system(state, law, wall_arm=-1.0)
    group = state.control.group.copy()
    group[N:] = 0
    with pytest.raises(ValueError, match="rigid group"):
        linear_system(state._replace(control=state.control._replace(group=group)), law, wall_arm=ARM)
    packing, _ = ss.packings.jammed(30, packing_fraction=0.88, dim=2, seed=1)
    law = ss.laws.linear(1.0, 0.5, 0.5, coulomb="sharp")
    with pytest.raises(ValueError, match="the packing has no walls"):
        linear_system(ss.accept(packing, ss.forces(packing, law)[1]), law, wall_arm=ARM)
