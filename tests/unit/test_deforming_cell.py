"""A cell that deforms strongly: no contact is missed, whether grains move in the flow or rest in it."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.dynamics.cell_motion import make_frame
from stickslip.core.library import core

GRADIENT = np.array([[-0.02, 0.01, 0], [0, -0.012, 0], [0, 0, 0]])


def loose(motion: float) -> ss.State:
    """Sixteen disks far apart, in a cell that closes in on them by a fifth and a third while it is sheared."""
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(*[np.arange(4)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    place, velocity = 1.6 * grid + rng.uniform(-0.2, 0.2, grid.shape), rng.normal(0, 1, grid.shape)
    grains = ss.disks(place, 0.5, velocity=motion * velocity)
    control = ss.control.strained_at(ss.control.loads(16), GRADIENT)
    return ss.assembly(grains, cell=ss.box([6.4, 6.4, 1.0], [True, True, False], 2), control=control)


@pytest.mark.parametrize("motion", [0.0, 1e-4, 3e-2])
def test_one_run_sees_every_contact_that_runs_of_a_step_each_see(motion):
    """Each of these makes a list of its own; a run on its own has to notice that the cell brings new pairs together."""
    law = ss.laws.linear(kn=1.0, kt=0.5, mu=0.4)
    start = stepwise = loose(motion)
    seen = 0
    for _ in range(8):
        for _ in range(25):
            stepwise, _, _ = ss.run(stepwise, law, 1, 0.1)
        seen += len(ss.measure.touching(stepwise))
    whole, _, _ = ss.run(start, law, 200, 0.1)
    assert seen > 2
    # a continued run is the same to the last bit
    np.testing.assert_array_equal(whole.grains.position, stepwise.grains.position)
    np.testing.assert_array_equal(whole.grains.velocity, stepwise.grains.velocity)
    slips = [state.contacts.slip[ss.measure.touching(state)] for state in (whole, stepwise)]
    np.testing.assert_array_equal(*slips)
    # A = (1 − ½ dt L)⁻¹ (1 + ½ dt L), every step
    identity, half = np.eye(3), 0.05 * GRADIENT
    stretch = np.linalg.matrix_power(np.linalg.solve(identity - half, identity + half), 200)
    np.testing.assert_allclose(whole.cell.vectors, start.cell.vectors @ stretch.T, rtol=1e-12, atol=1e-14)


def test_a_step_leaves_grains_what_the_strain_since_the_choice_has_not_taken():
    """Half of s − e (w + s), squared, with e the strain since blocks were chosen; −1 where nothing is left."""
    frame, flow = make_frame(loose(0.0), np.arange(16))
    room, widest, dt = 0.2, 1.0, 1.0
    frame.reach[0] = room
    half = 0.5 * dt * GRADIENT
    stretch, since, told = np.linalg.solve(np.eye(3) - half, np.eye(3) + half), np.eye(3), []
    for _ in range(12):
        since = stretch @ since
        left = room - np.linalg.norm(since - np.eye(3)) * (widest + room)
        told.append(core.begin_cell_step(frame, flow, dt, 1.0, 1.0))
        assert told[-1] == pytest.approx((0.5 * left) ** 2 if left > 0 else -1.0, rel=1e-9)
        np.testing.assert_allclose(flow.matrix[core.SINCE], since, rtol=1e-13, atol=1e-15)
    assert told[0] > 0 > told[-1]


@pytest.mark.parametrize("factors", [[1.0, 1.0], [0.0, 0.0]])
def test_walls_that_follow_a_course_bear_grains_as_walls_at_its_rate_do(factors):
    """A floor and a leaning wall, under disks in a cell that is periodic along the third edge alone."""
    law, velocity = ss.laws.linear(kn=1.0, kt=0.5, mu=0.4), [0.02, 0.01, 0, 0, 0, 0]
    grains = ss.disks([[0.6, 0.49], [1.59, 0.5], [2.6, 0.48]], 0.5)
    walls = ss.flat_walls([[0, 0], [0, 0]], [[0, 1], [1, 0.1]])
    control = ss.control.driven(ss.control.loads(3, 2, force=[-2e-3, -1e-2, 0]), [3], factors[0] * np.array(velocity))
    state = ss.assembly(grains, walls, ss.box([8.0, 1.0, 1.0], [True, False, False], 2), control)
    plain, _, _ = ss.run(state, law, 300, 0.05)
    control = ss.control.time_dependent(ss.control.driven(state.control, [3], velocity), [3], [0.0, 20.0], factors)
    followed, _, _ = ss.run(state._replace(control=control), law, 300, 0.05)
    assert plain.grains.position[:, 1].min() > 0.45 + plain.walls.point[0, 1]
    for name in ("position", "velocity", "spin"):
        ours, other = getattr(followed.grains, name), getattr(plain.grains, name)
        np.testing.assert_allclose(ours, other, rtol=1e-9, atol=1e-13)


def test_a_cell_that_still_deforms_without_stress_is_not_at_rest():
    control = ss.control.stress_controlled(ss.control.loads(2), {"yy": 0.0})
    grains, box = ss.disks([[0.0, 0.0], [3.0, 3.0]], 0.5), ss.box([6.4, 6.4, 1.0], [True, True, False], 2)
    state = ss.assembly(grains, cell=box._replace(rate=np.diag([0.0, -0.01, 0.0])), control=control)
    end, _, outcome = ss.run(state, ss.laws.linear(), 5000, 0.1, drag=0.1, tolerance=1e-6)
    assert outcome.ok
    assert end.cell.rate[1, 1] == pytest.approx(-0.01 * np.exp(-0.1 * end.time), rel=0.01)
    assert end.time > 50
