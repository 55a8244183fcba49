"""Slips of a plate that is pulled through a soft spring, found in series made by a formula."""

import numpy as np
import pytest

from stickslip.wings.papers.gouge import figures as figures
from stickslip.wings.papers.gouge.protocol import Realization, Series, find_slips
from stickslip.wings.papers.gouge.protocol import Test as Leg
from stickslip.wings.papers.gouge.sample import Range
from stickslip.wings.papers.gouge.scenario import GougeScenario

DT, V, K = 1e-3, 0.01, 100.0  # interval [s], velocity of the load point [m/s], friction per displacement [1/m]
D = 3e-3  # [m]; the load point moves by 0.01 D in three samples


def series(velocity) -> Series:
    """A series with a given velocity of the plate, and the friction of the spring that follows from it."""
    velocity = np.asarray(velocity, float)
    time = DT * np.arange(1, len(velocity) + 1)
    slip, load_point = np.cumsum(velocity) * DT, V * time
    friction = 0.4 + K * (load_point - slip)
    zero, fabric = np.zeros(len(time)), np.zeros((len(time), 3, 3))
    return Series(time, load_point, slip, velocity, friction, friction, zero, zero, zero, zero, zero, zero, fabric)


def realization(*tests: Leg) -> Realization:
    return Realization(3, Range(*6 * [1.0]), tests, {}, {})


def stick_slip() -> np.ndarray:
    """At rest, with slips of three samples at 50 V, one of which pauses below the threshold but above V."""
    v = np.zeros(60)
    v[[10, 11, 12]] = 50 * V
    v[[30, 31, 32, 33]] = [20 * V, 2 * V, 30 * V, 1.5 * V]
    v[45:47] = 5 * V  # faster than the load point, but no slip
    return v


def test_slips_are_found_with_their_drops():
    found = find_slips((realization(Leg("slide", 0.1, V, 0.0, series(stick_slip()))),), 10, D)
    assert found.time == pytest.approx([10 * DT, 30 * DT])
    assert found.duration == pytest.approx([4 * DT, 5 * DT])
    assert found.slip == pytest.approx(V * DT * np.array([150, 53.5]))
    assert found.drop == pytest.approx(K * (found.slip - V * found.duration))  # the spring unloads
    assert found.velocity == pytest.approx([50 * V, 30 * V])
    assert set(found.realization) == {3} and set(found.load_velocity) == {V}


def test_rebounds_belong_to_their_slip():
    v = stick_slip()
    v[15] = 12 * V  # two samples after the end of the first slip
    test = Leg("slide", 0.1, V, 0.0, series(v))
    found = find_slips((realization(test),), 10, D)
    assert found.time == pytest.approx([10 * DT, 30 * DT]) and found.duration[0] == pytest.approx(7 * DT)
    assert found.slip[0] == pytest.approx(V * DT * 162)
    assert len(find_slips((realization(test),), 10, D / 2).time) == 3  # farther apart than 0.01 of a smaller diameter


def test_a_higher_threshold_finds_fewer():
    test = Leg("slide", 0.1, V, 0.0, series(stick_slip()))
    assert [len(find_slips((realization(test),), x, D).time) for x in (4.0, 10.0, 40.0, 60.0)] == [3, 2, 1, 0]


def test_incomplete_slips_and_other_legs_do_not_count():
    v = stick_slip()
    v[:2], v[-2:] = 20 * V, 20 * V
    slide = Leg("slide", 0.1, V, 0.0, series(v))
    others = (slide._replace(kind="steady"), slide._replace(kind="reslide"), slide._replace(velocity=0.0))
    assert len(find_slips((realization(slide, *others),), 10, D).time) == 2
    assert len(find_slips((realization(*others),), 10, D).time) == 0
    assert len(find_slips((realization(Leg("slide", 0.1, V, 0.0, series(np.zeros(5)))),), 10, D).time) == 0


def test_figure_marks_the_slips():
    one = realization(Leg("slide", 0.1, V, 0.0, series(stick_slip())))
    found = find_slips((one,), 10, D)
    above, below = figures.stick_slip(one, found, D).axes
    drops = above.collections[0].get_segments()
    assert [abs(a[1] - b[1]) for a, b in drops] == pytest.approx(found.drop)
    assert len(next(line for line in below.lines if "largest" in line.get_label()).get_xdata()) == 2


@pytest.mark.parametrize("bad", [0.5, float("inf"), float("nan"), "10"])
def test_a_threshold_below_the_drive_is_refused(bad):
    with pytest.raises(ValueError, match="slip_threshold"):
        GougeScenario(
            law={"damping_n": 1e4}, protocol=[{"kind": "slide", "velocity": 0.1, "slip": 1.0}], slip_threshold=bad
        )
