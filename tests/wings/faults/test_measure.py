"""Means with honest errors, healing, and what holds show."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import linregress
from scipy.stats import t as student

from stickslip.wings.faults.friction.laboratory import healing, hold_response, steady_mean, steady_start
from stickslip.wings.faults.friction.laws import RateState, Spring, spring_slider
from stickslip.wings.faults.friction.loads import LoadStep, slide_hold_slide


def memory(seed, number, rho):
    return lfilter([np.sqrt(1 - rho**2)], [1, -rho], np.random.default_rng(seed).normal(size=number + 500))[500:]


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_the_error_of_a_mean_is_that_of_repetitions(rho):
    values = [steady_mean(memory(seed, 2000, rho)) for seed in range(200)]
    scatter = np.std([level.mean for level in values])
    # 200 repetitions tell a standard deviation to 5 %; the estimate is some per cent low for slow noise
    assert np.mean([level.error for level in values]) == pytest.approx(scatter, rel=0.2)
    assert np.mean([level.effective for level in values]) == pytest.approx(2000 * (1 - rho) / (1 + rho), rel=0.25)
    assert np.mean([abs(level.mean) < 1.96 * level.error for level in values]) > 0.88


def test_a_constant_has_no_error():
    assert steady_mean(np.full(20, 0.3))[:2] == (pytest.approx(0.3), 0.0)


def test_where_a_series_gets_steady():
    cuts = []
    for seed in range(20):
        series = 0.4 + 0.01 * memory(seed, 3000, 0.5) + 0.3 * np.exp(-np.arange(3000) / 100)
        cut = steady_start(series)
        cuts.append(cut)
        assert abs(steady_mean(series[cut:]).mean - 0.4) < 5 * steady_mean(series[cut:]).error + 1e-3
    assert 200 < np.median(cuts) < 900  # the transient is down to the noise after some 340
    assert steady_start(memory(0, 3000, 0.0)) <= 1500


def test_healing_is_a_straight_line_in_ln_t():
    hold = np.array([1.0, 3.0, 10.0, 30.0])
    line = healing(hold, 0.0178 * np.log(hold) + 0.003)
    assert line[:2] == (pytest.approx(0.0178), pytest.approx(0.003))
    hits, rng = 0, np.random.default_rng(0)
    for noise in rng.normal(0, 0.002, (4000, 4)):
        low, high = healing(hold, 0.0178 * np.log(hold) + noise).interval
        hits += low <= 0.0178 <= high
    assert 0.938 <= hits / 4000 <= 0.962  # 95 %, and a standard deviation of 0.34 %


@pytest.mark.parametrize("count", [3, 4, 12])
def test_the_error_of_healing_is_that_of_a_regression(count):
    """Two parameters are taken from the points: n − 2 in the variance and in Student's t, as SciPy has it."""
    hold = np.geomspace(1.0, 300.0, count)
    excess = 0.02 * np.log(hold) + 1e-3 * np.random.default_rng(count).normal(size=count)
    line, told = healing(hold, excess), linregress(np.log(hold), excess)
    assert line[:3] == (pytest.approx(told.slope), pytest.approx(told.intercept), pytest.approx(told.stderr))
    reach = student.ppf(0.975, count - 2) * told.stderr
    assert line.interval == pytest.approx((told.slope - reach, told.slope + reach))


def test_the_error_of_few_uncorrelated_values_is_the_textbook_one():
    """s/√n with n − 1 in s: values whose neighbours differ more than by chance count as independent."""
    values = np.array([0.4, 0.1] * 4)
    assert steady_mean(values).effective == 8
    assert steady_mean(values).error == pytest.approx(values.std(ddof=1) / np.sqrt(8))


def test_holds_of_a_stiff_slider_heal_as_the_aging_law_says():
    rs = RateState(0.0247, 0.0178, 5.3e-3, 0.4, 0.02)
    holds = [1.0, 10.0, 100.0, 1000.0]
    legs = slide_hold_slide(holds, velocity=0.02, distance=0.1)
    h = spring_slider(rs, Spring(1e6), legs)
    drops = hold_response(h.time, h.friction, legs)
    assert drops.hold.tolist() == holds
    assert drops.steady == pytest.approx(0.4, abs=1e-6)
    assert (np.diff(drops.drop) > 0).all()
    late = healing(drops.hold[1:], drops.excess[1:])
    assert late.slope == pytest.approx(rs.b, rel=0.05)  # ln(1 + V t/D_c), less what slips before the peak
    slip = spring_slider(rs._replace(law="slip"), Spring(1e6), legs)
    assert np.abs(hold_response(slip.time, slip.friction, legs).excess).max() < 0.1 * rs.b


def test_a_hold_lowers_friction_by_what_is_missing_at_its_end():
    legs = (LoadStep(1, 1), LoadStep(1, 0), LoadStep(1, 1))
    found = hold_response([0.5, 1.0, 1.3, 2.0, 2.5, 3.0], [0.9, 0.6, 0.5, 0.55, 0.7, 0.65], legs)
    assert np.ravel(found) == pytest.approx([1.0, 0.6, 0.05, 0.1])


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: steady_mean([1.0, 2.0]), "at least 8"),
        (lambda: steady_mean([1.0] * 9 + [np.nan]), "contains NaN or infinity"),
        (lambda: steady_start(np.ones(40), batch=0), "batch must be positive, got 0"),
        (lambda: healing([1, 1, 2], [0, 0, 0]), "three different holds, got 2"),
        (lambda: healing([0, 1, 2], [0, 0, 0]), "positive and finite"),
        (lambda: hold_response([0, 1, 2], [0, 0, 0], (LoadStep(2, 1),)), "no hold"),
        (
            lambda: hold_response([0, 2.9], [0, 0], (LoadStep(1, 1), LoadStep(1, 0), LoadStep(1, 1))),
            "no samples before",
        ),
    ],
)
def test_bad_input_gives_a_one_sentence_error(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call()


def test_slides_after_holds_may_have_another_velocity():
    legs = slide_hold_slide([1.0, 3.0], velocity=2.0, distance=4.0, reslide=8.0)
    assert [(leg.velocity, leg.duration) for leg in legs] == [(2, 2), (0, 1), (8, 0.5), (0, 3), (8, 0.5)]
