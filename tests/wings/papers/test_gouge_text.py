"""Rows of Ferdowsi & Rubin 2021 that follow from closed forms, on cases with a known answer."""

from types import SimpleNamespace

import numpy as np
import pytest

from stickslip.wings.faults.friction.laws import RateState, Spring, spring_slider
from stickslip.wings.faults.friction.loads import LoadStep
from stickslip.wings.papers.gouge import claims as gouge_claims
from stickslip.wings.papers.gouge import claims as text
from stickslip.wings.papers.gouge.paper import paper_scenario
from stickslip.wings.papers.gouge.statistics import Number


def number(value, error):
    draws = value + error * np.random.default_rng(0).normal(size=400)
    return Number(value, error, 8, 8, draws)


def test_peaks_that_collapse_have_no_defect():
    x = np.log([1.0, 2.5, 5.0, 15.0])
    collapsed = [number(0.0155 * (5 + one), 0.0) for one in x]
    assert text.collapse_defect(x, collapsed).value == pytest.approx(0, abs=1e-12)
    flat = [number(0.02, 0.0)] * 4
    assert text.collapse_defect(x, flat).value == pytest.approx(-0.02 / 5)


def test_below_is_left_open_within_the_interval():
    assert text.below_or_not(number(0.0, 1e-3), 0.0178) is True
    assert text.below_or_not(number(0.05, 1e-3), 0.0178) is False
    assert text.below_or_not(number(0.01, 1e-2), 0.0178) is None


def test_hold_times_by_their_definitions():
    """V_i t/D_c gives 437 s; k V_i t/(a σ) gives 1.43 s with k D_c/(b σ) = 425."""
    scenario = paper_scenario()
    soft = 425 * text.B * 5e6 / text.DC
    assert text.hold_time(scenario, "load_point", soft) == pytest.approx(1650 * text.DC / 0.02)
    assert text.hold_time(scenario, "frozen", soft) == pytest.approx(1650 * text.A * 5e6 / (soft * 0.02))


def test_peaks_of_stationary_holds_are_those_of_the_closed_form():
    """A stiff spring: the aging law heals by b ln(1 + V_i t/D_c), the slip law not at all."""
    for law, healed in (("aging", text.B * np.log1p(0.02 * 100 / text.DC)), ("slip", 0.0)):
        found = text.predict_peaks(law, 1e6, 100.0, np.array([0.02, 0.1]))
        assert found[0] == pytest.approx(healed, abs=2e-3)
        assert found[1] - found[0] == pytest.approx(text.A * np.log(5), abs=2e-3)


@pytest.mark.parametrize("law", ["slip", "aging"])
def test_the_law_of_a_hold_is_recognised(law):
    time = np.geomspace(1e-4, 1.0, 200)
    rs = RateState(text.A, text.B, text.DC, mu0=0.0, v0=0.03, law=law)
    friction = spring_slider(rs, Spring(1433.0), (LoadStep(1.001, 0.0),), times=time, before=0.03).friction
    noisy = friction + 1e-3 * np.random.default_rng(0).normal(size=200)
    assert text.compare_hold_laws(time, noisy, 0.03, 1433.0).preferred == law


def test_the_time_step_is_that_of_the_hertzian_collision():
    """t_col = 3.218 (m_eff²/(K² R_eff v))^(1/5) for 1 mm grains at 25 m/s."""
    made = text._time_step(paper_scenario())
    mass, stiff = 2500 * np.pi / 6 * 1e-9 / 2, 2 / 3 * 50e9 / (1 - 0.3**2)
    assert made.measured == pytest.approx(3.218e-2 * (mass**2 / (stiff**2 * 0.25e-3 * 25)) ** 0.2, rel=1e-3)
    assert made.verdict == "reproduced"


@pytest.mark.parametrize(
    ("errors", "measured", "outside"),
    [((0.01, 0.02), False, "after a hold"), ((0.03, 0.02), None, "none"), ((np.nan, 0.02), None, "none")],
)
def test_restitution_of_collisions_matters_only_if_a_difference_exceeds_its_interval(
    monkeypatch, errors, measured, outside
):
    """Two of eight samples each differ by 0.06: √2 · 2.145 times an error of 0.01 is less, of 0.03 more."""
    plain, calibrated = (
        SimpleNamespace(scenario=SimpleNamespace(law=SimpleNamespace(reading=reading)))
        for reading in ("eq8", "collision")
    )
    pairs = {
        "after a hold": (number(-0.07, errors[0]), number(-0.01, errors[0])),
        "steady friction": (number(0.41, errors[1]), number(0.40, errors[1])),
    }

    def compare(first, second):
        assert first is plain and second is calibrated
        return pairs, "both"

    monkeypatch.setattr(gouge_claims, "_compare_dampings", compare)
    monkeypatch.setattr(gouge_claims, "_scale_note", lambda result: "small")
    monkeypatch.setattr(gouge_claims, "damping", lambda scenario: 1.0)
    row, ratio = gouge_claims._collisions({"plain": plain, "calibrated": calibrated})
    assert ratio.measured == pytest.approx(1 / 7)
    assert row.measured is measured and row.verdict == ("not reproduced" if measured is False else "undecided")
    assert f"outside their 95 % intervals: {outside}; small" in row.note
    missing, _ = gouge_claims._collisions({"plain": plain})
    assert missing.measured is None and "needs holds" in missing.note


def test_a_number_without_an_interval_decides_nothing():
    """As that of a single sample."""
    assert text.below_or_not(Number(0.001, np.nan, 1, 1, np.zeros(0)), 0.0178) is None
