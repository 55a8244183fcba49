"""The vector loop that adds up loads against one in plain Python, bit by bit."""

import numpy as np
import pytest
from numba import njit

from stickslip.core.simd.reduce import IS_FIRST, IS_I, PREFETCH_DISTANCE, ROW, WIDTH, sum_rows


@njit
def summed(code, start, first, last, far, load, external, total):
    sum_rows(code, start, first, last, far, load, external, total)


def slow(entries, load, external):
    out = np.zeros((len(entries), WIDTH))
    for a, rows in enumerate(entries):
        out[a] = external[a % len(external)]
        for row, is_i in rows:
            out[a] += np.where(np.arange(WIDTH) < 3, 1.0 if is_i else -1.0, 1.0) * load[row]
    return out


def coded(entries):
    start = np.cumsum([0, *map(len, entries)])
    code = [ROW * row + IS_I * is_i + IS_FIRST * (k == 0) for rows in entries for k, (row, is_i) in enumerate(rows)]
    return start.astype(np.uint32), np.array(code + [0] * PREFETCH_DISTANCE, np.uint32)


@pytest.mark.parametrize("far", [0, 1], ids=["near", "far"])
@pytest.mark.parametrize("loaded", [False, True], ids=["no external loads", "external loads"])
def test_sums_are_those_of_a_plain_loop_to_the_last_bit(loaded, far):
    rng = np.random.default_rng(0)
    load = np.append(rng.normal(size=(50, WIDTH)), np.zeros((1, WIDTH)), axis=0)
    entries = [
        [(int(rng.integers(50)), int(rng.integers(2))) for _ in range(k)] or [(50, 0)] for k in rng.integers(0, 9, 40)
    ]
    external = rng.normal(size=(40, WIDTH)) if loaded else np.zeros((1, WIDTH))
    start, code = coded(entries)
    for a, b in ((0, 40), (7, 19)):
        total = np.full((b - a, WIDTH), np.nan)
        summed(code, start, a, b, far, load, external, total)
        np.testing.assert_array_equal(total, slow(entries, load, external)[a:b])


def test_what_is_not_a_number_stays_with_its_body():
    load = np.ones((3, WIDTH))
    load[1] = np.nan
    start, code = coded([[(0, 1)], [(1, 1), (0, 1)], [(2, 0)]])
    total = np.zeros((3, WIDTH))
    summed(code, start, 0, 3, 0, load, np.zeros((1, WIDTH)), total)
    assert np.isnan(total).any(axis=1).tolist() == [False, True, False]
