"""Rows of bodies into planes of lanes and loads back into rows, against plain loops, bit by bit."""

import numpy as np
import pytest
from numba import njit

from stickslip.core.simd import transpose as lanes
from stickslip.core.simd.transpose import LANES, MOTION, MOTION_AHEAD, PAIR, RADII, ROLL, ROLL_AHEAD, SCRATCH


@njit
def gathered(dim, predict, first, i, j, body, ahead, scratch):
    lanes.gather_positions(dim, first, i, j, body, scratch)
    lanes.gather_motion(dim, predict, first, i, j, body, ahead, scratch)


@njit
def scattered(place, scratch, load):
    lanes.scatter_loads(place, scratch, load)


def planes(scratch, first, count):
    return scratch[first : first + count * LANES].reshape(count, LANES)


@pytest.mark.parametrize("predict", [False, True], ids=["seen", "predicted"])
@pytest.mark.parametrize("dim", [2, 3])
def test_lanes_see_what_a_plain_loop_sees(dim, predict):
    rng = np.random.default_rng(0)
    body, ahead = rng.normal(size=(40, lanes.BODY)), rng.normal(size=(40, lanes.BODY_AHEAD))
    i, j = rng.integers(0, 40, (2, 2 * LANES)).astype(np.uint32)
    scratch = np.full(SCRATCH, np.nan)
    gathered(dim, int(predict), LANES, i, j, body, ahead, scratch)
    a, b = i[LANES:], j[LANES:]
    radius = body[:, lanes.RADIUS]
    for first, spin_first, rows, at in (
        (MOTION, ROLL, body, (lanes.VELOCITY, lanes.SPIN)),
        (MOTION_AHEAD, ROLL_AHEAD, ahead, (lanes.VELOCITY_AHEAD, lanes.SPIN_AHEAD)),
    ):
        if rows is ahead and not predict:
            assert np.isnan(planes(scratch, first, 6)).all()
            continue
        velocity, spin = (rows[:, k : k + 3] for k in at)
        np.testing.assert_array_equal(planes(scratch, first, dim), (velocity[a] - velocity[b]).T[:dim])
        rolled = (radius[a, None] * spin[a] + radius[b, None] * spin[b]).T
        turns = [2] if dim == 2 else [0, 1, 2]
        # a product and a sum may be one operation, which rounds once
        np.testing.assert_allclose(planes(scratch, spin_first, 3)[turns], rolled[turns], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(planes(scratch, PAIR, dim), (body[a, :3] - body[b, :3]).T[:dim])
    np.testing.assert_array_equal(planes(scratch, RADII, 1)[0], radius[a] + radius[b])


def test_loads_come_back_as_rows():
    scratch, load = np.random.default_rng(0).normal(size=SCRATCH), np.full((3 * LANES, 8), np.nan)
    scattered(LANES, scratch, load)
    np.testing.assert_array_equal(load[LANES : 2 * LANES, :6], planes(scratch, 0, 6).T)
    assert (load[LANES : 2 * LANES, 6:] == 0).all()
    assert np.isnan(load[:LANES]).all() and np.isnan(load[2 * LANES :]).all()


@pytest.mark.parametrize("rows", [0, 1, 7])
def test_aligned_rows_begin_with_a_line_of_the_cache(rows):
    for _ in range(5):
        found = lanes.empty_aligned(rows, 8)
        assert found.shape == (rows, 8) and found.ctypes.data % 64 == 0
