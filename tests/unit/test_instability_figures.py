"""Figures of what follows an instability, on constructed inputs whose curves are known."""

from types import SimpleNamespace as Made

import numpy as np
import pytest
from matplotlib import pyplot as plt

import stickslip as ss

SIGMA, OMEGA, PEAK = 1e-3, 0.2, 3e-5


@pytest.fixture(autouse=True)
def _closed():
    yield
    plt.close("all")


def burst(centres):
    """One disk that moves along x and turns with a known amplitude, recorded, at rest, and the form of its pair."""
    time = np.arange(0.0, 4e4, 0.5)
    envelope = sum(PEAK / np.cosh(SIGMA * (time - t)) for t in centres)
    amplitude = envelope * np.cos(OMEGA * time)
    state = ss.assembly(ss.disks([[1.0, 2.0]], 0.5, mass=4.0))
    mass, mode = np.array([4.0, 2.0]), np.array([0.3, 0.4])
    mode = mode / np.sqrt(mass @ mode**2)
    way = 2 * amplitude[:, None] * mode
    position = state.grains.position + np.stack([way[:, 0], 0 * time, 0 * time], axis=1)[:, None]
    angle = np.stack([0 * time, 0 * time, way[:, 1] / 0.5], axis=1)[:, None]
    free = Made(mass=mass, component=np.array([0, 5]), bodies=1)
    form = Made(growth_rate=SIGMA, peak=PEAK, mode=mode, free=free)
    return time, amplitude, Made(time=time, position=position, angle=angle), state, form


def test_envelopes_of_bursts_touch_the_motion():
    centres = (1.1e4, 3e4)
    time, amplitude, *shown = burst(centres)
    above, below = ss.figures.bursts(*shown).axes
    (band,) = above.collections  # 1300 oscillations, denser than pixels
    for edge, end in ((amplitude.max(), 1), (amplitude.min(), -1)):
        reach = end * (end * band.get_paths()[0].vertices[:, 1]).max()
        assert reach == pytest.approx(edge / PEAK, rel=1e-9)
    envelopes = [line for line in above.get_lines() if line.get_linestyle() == "--"]
    assert len(envelopes) == 4  # two bursts, above and below zero
    for line in envelopes[::2]:
        x, y = line.get_data()
        at = x[np.argmax(y)]
        assert min(abs(at - t) for t in centres) < 2 * np.pi / OMEGA and y.max() == pytest.approx(1.0)
        inside = np.abs(amplitude[np.searchsorted(time, x)]) / PEAK
        assert (inside <= y * 1.05 + 1e-3).all() and (inside > 0.9 * y).any()
        np.testing.assert_allclose(np.log(y[0] / 2) / (at - x[0]), -SIGMA, rtol=0.02)  # growth before the burst
    assert below.get_yscale() == "log" and below.get_legend_handles_labels()[1] == [
        "run: range of $a$", "predicted envelope", "predicted peak $a_0$",
    ]  # fmt: skip


def test_thresholds_are_drawn_where_they_are():
    threshold = Made(
        loads=np.array([0.1, 0.2, 0.3]), kicks=np.array([1e-6, 3e-3]), probability=np.array([[0, 0], [0, 0.5], [0, 1]]),
        lifetime=np.array([[np.nan, np.nan], [np.nan, 40.0], [np.nan, 10.0]]), duration=50.0,
        width=np.array([np.nan, 0.01]),
        threshold=np.array([np.nan, 0.2]), interval=np.array([[-np.inf, np.inf], [0.15, np.inf]]),
        lasting_probability=np.array([[0, 0], [0, 0.4], [0, 0.9]]), lasting_width=np.array([np.nan, 0.01]),
        lasting_threshold=np.array([np.nan, 0.22]), lasting_interval=np.array([[-np.inf, np.inf], [0.18, 0.25]]),
        arrest=np.array([[0.1, 0.15], [-np.inf, 0.1]]), arrest_range=(-np.inf, 0.15), first_pair=0.0, first_limit=0.25,
        distance=0.1,
    )  # fmt: skip
    above, below = ss.figures.static_and_kinetic(threshold, label="push", strength=0.4).axes
    lines = {line.get_label(): line for line in above.get_lines()}
    circles = [line.get_ydata().tolist() for line in above.get_lines() if len(line.get_xdata()) == 3]
    assert circles[2:] == [[0, 0.5, 1], [0, 0.4, 0.9]] and {"slid by 0.1", "slid for as long again"} <= set(lines)
    assert lines[r"kicked by $3\times 10^{-3}$"].get_ydata().tolist() == [0, 0.4, 0.9] and below.get_xlabel() == "push"
    verticals = {word: lines[word].get_xdata()[0] for word in ("first limit", "slides spontaneously")}
    assert verticals == {"first limit": 0.25, "slides spontaneously": 0.4} and "first pair" not in lines
    curve, lasting = (line for line in above.get_lines() if len(line.get_xdata()) == 400)
    x, y = curve.get_data()
    assert x[-1] == 0.4 and np.interp(0.2, x, y) == pytest.approx(0.5, abs=0.01)
    assert np.interp(0.22, *lasting.get_data()) == pytest.approx(0.5, abs=0.01)
    bands = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in above.patches]
    assert [tuple(np.round(band, 9)) for band in bands] == [(0.15, 0.4), (0.18, 0.25), (0.1, 0.15)]
    assert below.get_lines()[1].get_ydata()[1:].tolist() == [40.0, 10.0]


@pytest.mark.parametrize(("first", "marked"), [(1.2, True), (3.5, False)])
def test_the_axis_of_growth_ends_near_its_curves(first, marked):
    """The growth rate vanishes at a = 1, a displacement of 2; amplitudes go on to the loss of a contact."""
    a = np.linspace(0, first, 30)
    rates = np.sqrt(np.where(a < 1, 4 - 4 * a**2, np.nan))
    form = Made(growth_rate=2.0, beta=-8.0, amplitudes=a, rates=rates, peak=1.0, first=first)
    form.displacement = lambda amplitude: 2 * amplitude
    (axes,) = ss.figures.growth_by_amplitude.__wrapped__(form).axes
    lines = {line.get_label(): line.get_xdata() for line in axes.lines}
    assert ("a contact is lost" in lines) == marked and lines["burst turns back"][0] == 2
    assert axes.get_xlim()[1] == pytest.approx(1.05 * 2 * (first if marked else 1.0), rel=0.02)
