"""Where grains lie in memory and how they are shared out among threads."""

import numpy as np
import pytest

from stickslip.core.dynamics.moving import balance_threads, split_layers


@pytest.mark.parametrize(
    ("spent", "bounds"),
    [
        ((70, 70), (0, 5, 10)),
        ((50, 75), (0, 6, 10)),  # the second core is a third slower
        ((1, 1000), (0, 9, 10)),
        ((1000, 1), (0, 1, 10)),
    ],
)
def test_a_slower_core_gets_fewer_tiles_but_never_none(spent, bounds):
    assert tuple(balance_threads(np.array([0, 5, 10]), np.array(spent))) == bounds


def test_tiles_stay_where_they_are_without_a_clock_or_before_the_first_step():
    share = np.array([0, 3, 7, 9])
    assert balance_threads(share, np.zeros(3, np.int64)) is share


def test_sharing_out_again_settles_where_all_take_as_long():
    speed, share = np.array([3.0, 1.0, 2.0, 2.0]), np.array([0, 40, 80, 120, 160])
    for _ in range(3):
        share = balance_threads(share, np.diff(share) / speed)
    assert np.array_equal(np.diff(share), [60, 20, 40, 40])


@pytest.mark.parametrize("tiles", [4, 5, 12, 100])
def test_no_thread_is_ever_left_without_a_tile(tiles):
    rng, share = np.random.default_rng(tiles), np.array([0, 1, 2, 3, tiles])
    for _ in range(200):
        share = balance_threads(share, rng.choice([1, 10, 1000, 10**6], 4))
        assert (np.diff(share) >= 1).all()
        assert (share[0], share[-1]) == (0, tiles)


@pytest.mark.parametrize("parts", [1, 3, 10])
def test_parts_hold_every_point_once_and_are_of_a_size(parts):
    x = np.random.default_rng(parts).random((3, 500)) * np.array([[4.0], [1.0], [1.0]])
    layers = split_layers(x, np.arange(500), parts)
    assert np.array_equal(np.sort(np.concatenate(layers)), np.arange(500))
    assert max(map(len, layers)) - min(map(len, layers)) <= 4
