"""Measures of gouge on made-up samples: what is read off holds, slides after them, and velocity steps."""

from types import SimpleNamespace

import numpy as np
import pytest

from stickslip.wings.papers.gouge import claims as gouge_curves
from stickslip.wings.papers.gouge import measures
from tests.wings.papers.test_gouge import made, of_tests

INTERVAL = 2e-5  # of `small()`


def with_columns(test, **columns):
    return test._replace(series=test.series._replace(**columns))


def hold(count=2000, **columns):
    """A hold of evenly sampled time with given columns, and the slide before it."""
    slide = made("slide", 0.3, 0.3, 0.0, np.full(400, 0.4))
    return [slide, with_columns(made("hold", 0.3, 0.0, 0.0, np.full(count, 0.4)), **columns)._replace(elastic=2.0)]


def test_relaxation_is_a_slope_against_the_logarithm_of_time():
    """−0.02 ln(t/t0): the last of the slide before it counts as zero, and early times are left out."""
    time = INTERVAL * np.arange(1, 2001)
    tests = [hold(friction=0.4 - 0.02 * np.log(time / INTERVAL) + noise) for noise in (0.0, 0.001, -0.001)]
    curve = measures.hold_curve(of_tests(*tests), 0.3)
    assert measures.per_efold(curve).value == pytest.approx(-0.02, rel=1e-3)
    assert curve.mean[0] == pytest.approx(0.0, abs=1e-12)
    assert curve.at(1e-2).value == pytest.approx(-0.02 * np.log(1e-2 / INTERVAL), rel=0.01)


def test_a_value_before_a_hold_is_a_mean_over_its_last_slip():
    """0.02 D of 3 mm at 0.3 m/s are ten samples, up to one more at their edge; those before do not count."""
    slide, held = hold()
    friction = np.where(np.arange(400) < 390, 0.2, 0.4 + 0.05 * (-1.0) ** np.arange(400))
    curve = measures.hold_curve(of_tests([with_columns(slide, friction=friction), held]), 0.3)
    assert curve.mean == pytest.approx(0.0, abs=0.0185)


def test_creep_is_the_slope_of_the_plates_slip():
    time = INTERVAL * np.arange(1, 2001)
    curve = measures.creep_velocity(of_tests(hold(slip=3e-4 * time + 1e-6)), 0.3)
    inner = slice(len(curve.x) // 4, -len(curve.x) // 10)
    assert curve.mean[inner] == pytest.approx(3e-4, rel=0.02)  # slip is joined by straight lines in ln t


def test_kinetic_energy_is_over_what_the_contacts_store():
    curve = measures.energy_ratio(of_tests(hold(kinetic_energy=np.full(2000, 3e-4))), 0.3)
    assert curve.mean == pytest.approx(1.5e-4)


def test_a_peak_is_looked_for_after_elastic_reloading():
    """Friction rises elastically from −0.1 to 0.03 at 0.2 D and falls; a window at small slips would be negative."""
    slip = np.linspace(0, 1, 1000)
    rising, falling = -0.1 + 0.65 * slip, 0.03 * np.exp(-(slip - 0.2) / 0.5)
    friction = 0.4 + np.where(slip < 0.2, rising, falling)
    tests = [made("slide", 0.3, 0.3, 0.0, np.full(400, 0.4)), made("reslide", 0.3, 0.3, 1e-2, friction[:500])]
    curve = measures.reslide_curve(of_tests(tests), 0.3, 1e-2, 0.3)
    assert measures.peak(curve).value == pytest.approx(0.03, abs=2e-3)  # smoothed over 0.02 D
    assert measures.just_after(curve).value < -0.08
    assert measures.peak_slip(curve) == pytest.approx(0.2 * curve.x[-1] / 0.5, rel=0.05)


@pytest.mark.parametrize(("a", "eta"), [(0.02, 0.06), (0.01, 0.0)])
def test_peaks_after_steps_tell_direct_effect_and_impedance(a, eta):
    """a ln(V2/V1) + η ΔV, up and down, of two sizes, for a while: both are found in samples of different levels."""
    pairs = [(0.3, 0.6), (0.6, 0.3), (0.06, 0.3), (0.3, 0.06)]
    samples = []
    for level in (0.35, 0.4, 0.42):
        tests = [made("slide", v, v, 0.0, np.full(400, level)) for v in (0.3, 0.6, 0.06)]
        for k, (old, new) in enumerate(pairs):
            change = a * np.log(new / old) + eta * (new - old)
            tests.append(made("step", old, new, 0.0, level + change * (np.arange(400) < 80))._replace(part=k))
        samples.append(tests)
    found = measures.response(of_tests(*samples))
    assert found.a.value == pytest.approx(a, rel=1e-6)
    assert found.impedance.value == pytest.approx(eta, rel=1e-6, abs=1e-9)


def test_steps_of_one_size_do_not_tell_impedance_from_direct_effect():
    tests = [made("slide", 0.3, 0.3, 0.0, np.full(400, 0.4)), made("step", 0.3, 0.6, 0.0, np.full(400, 0.42))]
    assert measures.response(of_tests(tests)) is None


def test_the_slip_over_which_friction_is_correlated():
    """AR(1) noise that forgets within 20 samples of 0.002 D: 2τ = (1 + ρ)/(1 − ρ) samples."""
    rng, rho = np.random.default_rng(0), np.exp(-1 / 20)
    noise = np.zeros(200_000)
    for k in range(1, len(noise)):
        noise[k] = rho * noise[k - 1] + rng.normal()
    found = measures.correlation_slip(of_tests([made("slide", 0.3, 0.3, 0.0, 0.4 + 0.01 * noise)]), 0.3)
    assert found == pytest.approx(0.002 * (1 + rho) / (1 - rho), rel=0.15)


def test_predicted_slopes_are_those_of_the_slip_law():
    """A hold with a soft spring: −a per e-fold at late times where state hardly changes; with this a, b, dc −0.024."""
    result = of_tests(hold())
    times = np.geomspace(1e-3, 1.0, 200)
    slope = gouge_curves.predict_per_efold(result, 0.03, times, "slip")
    assert slope == pytest.approx(-0.024, abs=1e-3)


def test_steady_friction_is_that_of_two_windows_and_of_second_halves():
    point = np.arange(10.0)
    series = SimpleNamespace(load_point=point, friction=10 + point)
    kinds = [("steady", None, 1.0), ("slide", 1.0, 1.0), ("step", 0.1, 1.0), ("step", 1.0, 0.1)]
    tests = [SimpleNamespace(kind=k, before=before, velocity=v, series=series) for k, before, v in kinds]
    sample = SimpleNamespace(of=lambda *wanted: [test for test in tests if test.kind in wanted])
    pieces = measures._steady_pieces(sample, 1.0, 2.0, "friction")
    assert [piece.tolist() for piece in pieces] == [[16, 17, 18, 19], [*range(10, 20)], [15, 16, 17, 18, 19]]
