"""Stick–slip events of gouge that is driven through a soft spring: times at which the upper plate runs ahead."""

from typing import NamedTuple

import numpy as np

from .protocol import Realization, Test

JOINED = 0.01  # displacement of the load point within which rebounds after a slip belong to it [D]


class Slips(NamedTuple):
    """Slips in slides at constant velocity of the load point, K rows.

    A slip begins with the first sample at which the plate moves faster than `threshold` times the load point, and ends
    with the first one at which it is no longer faster than the load point. Rebounds that begin before the load point
    has moved on by 0.01 D belong to the slip. Slips that a slide does not contain from beginning to end are left out.
    """

    realization: np.ndarray  # (K,) seed
    load_velocity: np.ndarray  # (K,) velocity of the load point [m/s]
    time: np.ndarray  # (K,) of the last sample before the slip, from the start of sliding [s]
    load_point: np.ndarray  # (K,) displacement of the load point at that time [m]
    duration: np.ndarray  # (K,) [s]
    slip: np.ndarray  # (K,) displacement of the plate [m]
    drop: np.ndarray  # (K,) decrease of the friction, which is the force of the spring over σ A [1]
    velocity: np.ndarray  # (K,) largest velocity of the plate [m/s]


def find_slips(realizations: tuple[Realization, ...], threshold: float, diameter: float) -> Slips:
    """Find the slips in all slides of several realizations.

    Parameters
    ----------
    threshold : velocity of the plate over that of the load point
    diameter : D [m]
    """
    rows = [
        (sample.seed, test.velocity, *_measure(test, begin, end))
        for sample in realizations
        for test in sample.of("slide")
        if test.velocity > 0
        for begin, end in _slips_of(test, threshold, JOINED * diameter)
    ]
    return Slips(*np.array(rows, float).reshape(-1, len(Slips._fields)).T)


def _slips_of(test: Test, threshold: float, joined: float) -> list[tuple[int, int]]:
    """Return the first fast sample of each slip, and the first one after the slip; the load point is `joined` apart."""
    series, last = test.series, len(test.series.time)
    fast = np.flatnonzero(series.velocity > threshold * test.velocity)
    slow = np.flatnonzero(series.velocity <= test.velocity)
    out: list[tuple[int, int]] = []
    for begin in fast:
        if out and begin < out[-1][1]:
            continue
        later = slow[slow > begin]
        end = int(later[0]) if len(later) else last
        if out and series.load_point[begin] - series.load_point[min(out[-1][1], last - 1)] < joined:
            begin = out.pop()[0]
        out.append((int(begin), end))
    return [(begin, end) for begin, end in out if begin > 0 and end < last]


def _measure(test: Test, begin: int, after: int) -> tuple:
    """Return time, load point, duration, slip, drop and largest velocity of one slip."""
    series, before = test.series, begin - 1
    return (
        series.time[before],
        series.load_point[before],
        series.time[after] - series.time[before],
        series.slip[after] - series.slip[before],
        series.friction[before] - series.friction[after],
        series.velocity[begin:after].max(),
    )
