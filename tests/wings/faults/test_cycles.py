"""Recurrence of stick–slip: artificial steps, sliders, and the figure of a sweep."""

import numpy as np
import pytest

from stickslip.runs.sweep.dataset import open_sweep
from stickslip.wings.faults.friction.laboratory import event_starts, passing_velocity, recurrence, repeated_slip
from stickslip.wings.faults.friction.laws import RateState, Spring, spring_slider
from stickslip.wings.faults.friction.loads import LoadStep
from tests.conftest import stickslip_here

STUDY = """
experiment = "rate-state"
legs = [{velocity = 1.1e-9, duration = 1e8}, {velocity = 1e-9, duration = 6e9}]
[surface]
law = "slip"
a = 0.010
b = 0.014
dc = 2e-5
mu0 = 0.6
v0 = 1e-6
[spring]
stiffness = 0.1
damping = 0.0433
[samples]
number = 6000
[sweep]
"surface.b" = [0.0135, 0.0140, 0.0145]
"""


def stairs(period, jump, number=5000, many=6.3):
    time = np.linspace(0.0, many * period, number)
    slip = jump * np.floor(time / period) + 1e-3 * jump * np.mod(time / period, 1.0)
    return time, slip, np.full(number, 1e-3 * jump / period)


def test_artificial_steps():
    time, slip, slow = stairs(7.0, 2.0)
    velocity = passing_velocity(time, slip, slow)
    assert len(event_starts(velocity)) == 6
    assert recurrence(time, velocity) == pytest.approx(7.0, abs=0.01)
    since = np.array([-3.5, 0.1, 3.5, 6.9, 7.1, 20.0])
    repeated = repeated_slip(time, velocity, slip, since)
    assert np.allclose(repeated, [0.0, 2.0, 2.0, 2.0, 4.0, 6.0], atol=0.01)
    steady = passing_velocity(time, time * 1.0, np.ones(len(time)))
    assert np.isnan(recurrence(time, steady))
    assert repeated_slip(time, steady, time, since) is None


@pytest.mark.parametrize("number", [3000, 20_000])
def test_a_slider_moves_with_its_load_point(number):
    """Slip of an event over its period is the velocity of the load point, however events fall between samples."""
    surface = RateState(0.010, 0.014, 2e-5, 0.6, 1e-6, "slip")
    legs, times = (LoadStep(1e8, 1.1e-9), LoadStep(1e10, 1e-9)), np.linspace(0, 1.01e10, number)
    h = spring_slider(surface, Spring(0.1, 0.0433), legs, times=times)
    velocity = passing_velocity(h.time, h.slip, h.velocity)
    period = recurrence(h.time, velocity)
    starts = event_starts(velocity)
    assert len(starts) >= 6
    jump = (h.slip[starts[-1]] - h.slip[starts[1]]) / (len(starts) - 2)
    assert jump / period == pytest.approx(1e-9, rel=0.01)
    drop = (h.friction.max() - h.friction.min()) / 0.1  # the spring unloads by what is slipped in an event
    assert jump == pytest.approx(drop, rel=0.02)


@pytest.mark.parametrize("law", ["aging", "slip"])
def test_steps_in_events_may_be_shorter_than_the_resolution_of_time(law):
    """Steps of 1e-8 s in a leg of 1e10 s; the result does not depend on where samples are."""
    surface = RateState(0.0099, 0.01405, 1.98e-5, 0.62, 1e-6, law)
    legs = (LoadStep(1e8, 1.1e-9), LoadStep(5e9, 1e-9))
    ends = []
    for number in (1000, 4000):
        h = spring_slider(surface, Spring(0.1, 0.0433), legs, times=np.linspace(0, 5.1e9, number))
        assert h.ok, h.reached
        ends.append(np.log(h.velocity[-1]))
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


@pytest.mark.slow
def test_a_sweep_of_cycles_is_drawn(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    done = stickslip_here("run", "study.toml", "--out", "out", "--workers", "1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "cycles.png").stat().st_size > 10_000
    times = open_sweep(tmp_path / "out")["recurrence"]
    assert times.attrs["units"] == "s"
    assert (np.diff(times) > 0).all()  # the stress drop grows with b − a
    page = stickslip_here("report", "out", cwd=tmp_path)
    assert page.returncode == 0, page.stderr
    assert "<h2>Cycles</h2>" in (tmp_path / "out" / "report.html").read_text()
    again = stickslip_here("run", "study.toml", "--out", "out", "--workers", "1", cwd=tmp_path)
    assert again.returncode == 0, again.stderr


def test_the_first_interval_does_not_count():
    velocity = np.ones(40)
    velocity[[10, 15, 25, 35]] = 1e3
    assert recurrence(np.arange(40.0), velocity) == 10.0
