"""Fits that name a remedy: a trend that was left out, and a stiffness in another unit."""

import numpy as np
import pytest

from stickslip.wings.faults.friction.fitting import fit, solve_fit
from stickslip.wings.faults.friction.inference import gain_by
from stickslip.wings.faults.friction.laboratory import LabRecord, write_csv
from stickslip.wings.faults.friction.laws import RateState, Spring, spring_slider
from stickslip.wings.faults.friction.loads import velocity_steps
from stickslip.wings.faults.rate_state import fit_report

STIFFNESS, TREND, NOISE = 1500.0, 4.0, 2e-4
SURFACE = RateState(0.010, 0.013, 1e-5, 0.6, 1e-6, "slip")
LEGS = velocity_steps([1e-6, 1e-5, 1e-6], distance=2e-4)


@pytest.fixture(scope="module")
def lab():
    times = np.unique(np.r_[np.linspace(0, 200, 61), 200 + np.geomspace(0.05, 20, 120), np.linspace(220, 420, 120)])
    h = spring_slider(SURFACE, Spring(STIFFNESS), LEGS, times=times)
    noise = NOISE * np.random.default_rng(5).normal(size=len(times))
    return LabRecord(h.time, h.friction + noise, h.load_point, np.full(len(times), 5e6))


def found_in(folder, record, **options):
    path = write_csv(folder / "record.csv", record)
    given = {"fixed": {"stiffness": STIFFNESS}, "laws": ("slip",)}
    return fit_report.fit_record(path, **given | options)


def test_a_trend_that_was_left_out_is_measured(tmp_path, lab):
    sloped = lab._replace(friction=lab.friction + TREND * (lab.load_point - lab.load_point[0]))
    result = found_in(tmp_path, sloped)
    (said,) = fit_report.doubts(result)
    detrended = found_in(tmp_path, sloped, free=("trend",))
    fall = 1 - np.std(detrended.fits[0].residuals[0]) / np.std(result.fits[0].residuals[0])
    assert fall > 0.3  # the trend is most of the misfit
    assert f"falls by {100 * fall:.0f} %" in said and "--detrend" in said
    assert fit_report.doubts(detrended) == []


def test_noise_alone_is_no_trend(tmp_path, lab):
    assert fit_report.doubts(found_in(tmp_path, lab)) == []
    data = found_in(tmp_path, lab).data
    gain = gain_by("trend", solve_fit(data, law="slip", fixed={"stiffness": STIFFNESS}))
    assert 0 <= gain.fall < 0.01 and not gain.helps


def test_every_record_has_a_trend_of_its_own(lab):
    first = fit_report.record_data(lab)
    second = first._replace(friction=first.friction + TREND * np.interp(first.time, first.time, lab.load_point))
    solution = solve_fit([first, second], law="slip", fixed={"stiffness": STIFFNESS})
    gain = gain_by("trend", solution)
    assert gain.helps
    assert gain.values == pytest.approx([0.0, TREND], abs=0.3)  # the errors of single fits are 0.1/m
    refitted = fit([first, second], law="slip", fixed={"stiffness": STIFFNESS}, free=("trend",))
    assert gain.values == pytest.approx([refitted.values["trend[1]"], refitted.values["trend[2]"]], abs=0.05)


@pytest.mark.parametrize(("given", "unit"), [(1.5, "1/mm"), (7.5e9, "Pa/m"), (7.5, "GPa/m")])
def test_a_stiffness_in_another_unit_is_suspected(tmp_path, lab, given, unit):
    said = [
        line for line in fit_report.doubts(found_in(tmp_path, lab, fixed={"stiffness": given})) if "stiffness" in line
    ]
    assert len(said) == 1
    assert f"{given:g} {unit} is 1500 1/m" in said[0]
    assert "--stiffness 1500" in said[0]


def test_without_a_normal_stress_the_one_that_would_explain_it_is_named(tmp_path, lab):
    result = found_in(tmp_path, lab._replace(normal_stress=None), fixed={"stiffness": 7.5})
    (said,) = [line for line in fit_report.doubts(result) if "stiffness" in line]
    assert "GPa/m" in said and "normal stress of 5" in said


def test_a_stiffness_that_is_a_quarter_off_is_told_with_both_values(tmp_path, lab):
    (said,) = [
        line for line in fit_report.doubts(found_in(tmp_path, lab, fixed={"stiffness": 1.25 * STIFFNESS}))
        if "contradicts" in line
    ]  # fmt: skip
    assert "a stiffness of 1875 1/m contradicts the record, which shows 1494 1/m" in said and "unit" not in said


@pytest.mark.parametrize(("factor", "size"), [(1e-3, "small"), (1e3, "large")])
def test_the_unit_of_the_displacement_is_the_other_candidate(tmp_path, lab, factor, size):
    record = lab._replace(load_point=factor * lab.load_point)
    (said,) = [line for line in fit_report.doubts(found_in(tmp_path, record)) if "contradicts" in line]
    assert f"or displacements are 1000 times too {size} (wrong unit of load_point, or of --velocity)" in said
    assert "friction, 0" not in said


def test_a_stiffness_that_fits_is_not_suspected(tmp_path, lab):
    for right in (1000.0, 2500.0):
        assert not [
            line for line in fit_report.doubts(found_in(tmp_path, lab, fixed={"stiffness": right})) if "unit" in line
        ]
