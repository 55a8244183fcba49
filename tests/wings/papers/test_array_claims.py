"""What the statements of Charan et al. 2020 measure, on series, fronts and spectra whose answer is known."""

from types import SimpleNamespace as Made

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from stickslip.reports.claims import NOT_REPRODUCED, REPRODUCED, UNDECIDED
from stickslip.wings.papers.disk_array import claims, claims_of_motion, fronts, measures
from stickslip.wings.papers.disk_array.fronts import Front
from stickslip.wings.papers.disk_array.measures import Arrest

TIME = np.linspace(0.0, 1e4, 5001)


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_power_of_m_is_counted_from_the_first_breach(power):
    late = TIME[TIME > 6000]
    msd = 3e-9 * (late - 2000.0) ** power
    assert fronts.msd_power(late, msd, np.array([2500.0, 2000.0, np.nan])) == pytest.approx(power, rel=1e-9)
    assert np.isnan(fronts.msd_power(late, msd, np.array([7000.0, np.nan])))
    assert np.isnan(fronts.msd_power(late, msd, np.array([np.nan])))


def test_a_breach_is_the_first_time_at_the_limit_of_the_substrate():
    contacts = Made(mode=np.zeros(1, int), i=np.zeros(1, int), j=np.array([2]), count=np.array([1]))
    start = Made(grains=Made(radius=np.ones(2)), contacts=contacts, time=0.0)
    rows = [("limit", 1.0, 0, 2), ("closed", 1.5, 1, 2), ("limit", 2.0, 1, 0), ("limit", 3.0, 0, 2)]
    events = np.array(rows, [("kind", "U6"), ("time", float), ("i", int), ("j", int)])
    np.testing.assert_array_equal(fronts.breach_times(events, start), [1.0, np.nan])


def test_delays_have_standard_errors_of_their_means():
    times = np.array([[0, 1, 2], [5, 6.2, 7.4], [2, 2.8, 3.6]])
    front = fronts.fit_front(times, np.arange(3), np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(front.error, np.array([0, 0.2, 0.4]) / 3**0.5, atol=1e-15)
    assert front.speed == pytest.approx(1)


def test_profile_and_drift_of_a_row_that_slides_and_oscillates():
    shape = np.array([-1.0, -0.5, 0.0, 1.5]) * 1e-3
    wave = 5e-4 * np.sin(2 * np.pi * TIME[:, None] / 40.0 + np.arange(4))
    along = 2e-5 * TIME[:, None] + shape + wave
    smooth = uniform_filter1d(along, 2 * fronts.AROUND + 1, axis=0)
    profile, drift = fronts.drift_profile(TIME, smooth, (0.05, 0.1, 10.0))
    assert np.allclose(profile[:2], shape - shape.mean(), atol=2e-5) and np.allclose(drift[:2], 2e-5, rtol=0.01)
    assert np.isnan(profile[2]).all() and np.isnan(drift[2])  # the row never gets there


def test_a_drift_with_a_linear_profile_makes_a_front_of_known_speed():
    """Disks one diameter apart, each behind the next by 4e-4 diameters, drift at 2e-5: the front has 2e-5/4e-4."""
    rng, distance = np.random.default_rng(1), np.arange(10.0)
    order = np.arange(10)[::-1]
    profile = (-4e-4 * distance)[order] + 1e-5 * rng.normal(size=(40, 10))
    drift = np.r_[2e-5 * (1 + 0.1 * rng.normal(size=39)), np.nan]
    speed, error = fronts.drift_speed(profile, drift, order, distance)
    assert speed == pytest.approx(np.nanmean(drift) / 4e-4, rel=0.01)
    assert error == pytest.approx(speed * 0.1 / np.sqrt(39), rel=0.3)
    assert fronts.drift_speed(profile[:1], drift[:1], order, distance) is None


def test_overlap_at_the_time_of_a_breach():
    state = Made(grains=Made(radius=np.full(2, 0.5), position=np.array([[0.5, 0.499], [1.5, 0.499]])))
    height = np.column_stack([0.499 + 1e-7 * TIME, np.full(len(TIME), 0.51)])
    assert fronts.unloading(state, TIME, height, np.array([5000.0, 1.0])) == pytest.approx([0.5, 0.0])
    assert np.isnan(fronts.unloading(state, TIME, height, np.array([np.nan, 1.0]))[0])


def test_halves_of_a_steady_and_of_a_growing_motion():
    center = np.column_stack([2e-5 * TIME, 1e-4 * np.sin(0.2 * TIME)])
    velocity, height = fronts.late_halves(TIME, center)
    assert np.allclose(velocity, 2e-5) and np.allclose(height, 1e-4 / np.sqrt(2), rtol=0.01)
    growing = np.column_stack([1e-9 * TIME**2, center[:, 1] * np.exp(TIME / 5000)])
    velocity, height = fronts.late_halves(TIME, growing)
    assert velocity[1] / velocity[0] == pytest.approx(3.0, rel=1e-3)
    assert height[1] / height[0] == pytest.approx(np.e, rel=0.01)


@pytest.mark.parametrize("waves", [0, 2, 5])
def test_wave_number_of_a_mode_and_its_share(waves):
    n, x = 10, np.arange(10)
    y = np.cos(2 * np.pi * waves * x / n)
    modes = np.zeros((2 * n, 2))
    modes[::2, 1], modes[1::2, 0] = 1.0, 3 * y  # the first one moves along y, the second one along x
    number, power = measures.wave_power(Made(modes=modes, free=Made(axis=np.tile([0, 1], n))))
    assert number == pytest.approx(2 * np.pi * np.arange(6) / 10)
    assert number[np.argmax(power[:, 0])] == pytest.approx(2 * np.pi * waves / n)
    assert power[:, 0].sum() == pytest.approx(1.0) and power[waves, 0] == pytest.approx(1.0) and not power[:, 1].any()


def test_what_lies_within_two_errors_of_a_bound_is_left_open():
    assert measures.exceeds(0.6, 0.04, 0.5) is True and measures.exceeds(0.4, 0.04, 0.5) is False
    assert measures.exceeds(0.6, 0.06, 0.5) is None and measures.exceeds(np.nan, np.inf, 0.5) is None


@pytest.mark.parametrize(("distance", "kind"), [(lambda d: np.sqrt(d), True), (lambda d: d, False)])
def test_exponents_at_a_birth_tell_a_meeting_from_a_crossing(monkeypatch, distance, kind):
    def step(_, load):
        gap = distance(abs(load - 0.5))
        return Made(spectrum=two(gap) if load < 0.5 else pair(gap))

    def two(gap):
        return Made(eigenvalues=np.array([1.0, 3.0 - gap, 3.0 + gap, 7.0 - 1j, 7.0 + 1j]))

    def pair(gap):
        return Made(pairs=np.array([7.0 + 1j, 3.0 + 1j * gap]))

    monkeypatch.setattr(claims, "make_protocol", lambda *_: Made(step=step))
    born = Made(birth=Made(load=0.5, below=0.5, above=0.5), eigenvalues=np.array([3.0 + 1e-3j]))
    main = Made(path=[Made(load=0.4, state=None), Made(load=0.6, state=None)], scenario=None, law=None, families=[born])
    expected = 0.5 if kind else 1.0
    assert claims.birth_exponents(born, main) == pytest.approx((expected, expected), rel=1e-6)
    assert claims._coalescence(main).measured is kind
    near = Made(path=[Made(load=0.49999, state=None)], families=[born])
    assert claims._coalescence(near).verdict == UNDECIDED  # no room for the distances


def test_no_push_is_balanced_below_unit_friction():
    """The last disk touches one neighbour and the substrate: |F_t| = F_n at the neighbour balances it, or nothing."""
    assert claims.first_pair(array={"disks": 3}, law={"mu": 0.9}) == 0.0
    assert claims.first_pair(array={"disks": 3}, law={"mu": 1.1}) > 0


def test_births_are_counted_up_to_the_largest_load_of_the_paper_and_quiet_states_above_0082_refute():
    def born(load, death):
        return Made(birth=Made(load=load), death=death and Made(load=death))

    def result(pairs, slid=False):
        path = [
            Made(load=load, spectrum=Made(pairs=np.ones(n))) for load, n in zip((0.05, 0.083, 0.09), pairs, strict=True)
        ]
        families = [born(0.08, None), born(0.01, 0.05), born(0.1, None), Made(birth=None)]
        return Made(families=families, path=path, free_runs={0.03: Made(slid=slid), 0.083: Made(slid=True)})

    count, dies, above = claims._births(result((0, 1, 2)))
    assert (count.measured, count.verdict, dies.measured, above.measured) == (2, REPRODUCED, True, True)
    assert claims._births(result((0, 1, 2), slid=True))[1].measured is False
    assert claims._births(result((1, 1, 0)))[2].verdict == "refuted"


def front(delay, error=1.0, speed=0.05):
    n = len(delay)
    return Front(
        np.arange(float(n)), np.array(delay, float), np.full(n, error), speed, 0.02 * speed, speed, 0.0, 20, 20
    )


def test_the_order_of_a_front_and_its_speed_in_both_halves():
    there, back = front(np.arange(10) * 20), front([0, 20, 40, 60, 80, 100, 120, 140, 100, 60])
    assert claims_of_motion._order({0.083: there}).verdict == REPRODUCED
    assert claims_of_motion._order({0.083: there, 0.09: back}).verdict == NOT_REPRODUCED
    assert "disk 8 at 0.09" in claims_of_motion._order({0.083: there, 0.09: back}).note
    assert claims_of_motion._order({0.083: there, 0.09: back._replace(error=np.full(10, 50.0))}).verdict == UNDECIDED
    assert claims_of_motion._order({0.083: there, 0.09: None}).verdict == UNDECIDED
    assert claims_of_motion.halves_ratio(there) == pytest.approx(1.0)
    assert claims_of_motion.halves_ratio(front([0, 10, 20, 30, 40, 50, 70, 90, 110, 130])) == pytest.approx(2.0)
    assert claims_of_motion.halves_ratio(back) < 0


@pytest.mark.parametrize(("first", "measured"), [(40, True), (4, False), (20, None)])
def test_a_front_starts_where_most_realizations_start(first, measured):
    times = 100.0 + np.arange(10) + np.zeros((40, 10))
    times[first:, 5] = 1.0
    row = claims_of_motion._start("start", "Fig 5: text", 0, np.vstack([times, np.full(10, np.nan)]))
    assert row.measured is measured and f"in {first / 40:.0%} of 40 complete" in row.note


def test_powers_of_the_push_and_the_ratio_of_both_fronts(monkeypatch):
    loads = (0.083, 0.087, 0.09, 0.12)
    main = Made(sliding={load: load for load in loads})
    forward = {load: front(range(3), speed=load**3) for load in loads}
    monkeypatch.setattr(claims_of_motion, "backward_front", lambda _, t, load: front(range(3), speed=0.08))
    first, second, ratio = claims_of_motion._dependences(main, forward)
    assert first.measured is True and "3.00 ±" in first.note
    assert second.measured == pytest.approx(0.0, abs=1e-9) and second.verdict == REPRODUCED and ratio.measured is True
    monkeypatch.setattr(claims_of_motion, "backward_front", lambda _, t, load: front(range(3), speed=2 * load[0] ** 3))
    _, second, ratio = claims_of_motion._dependences(main, forward)
    assert second.measured == pytest.approx(3.0) and second.verdict == NOT_REPRODUCED and ratio.measured is False


def test_slip_that_is_charged_grows_by_more_than_a_tenth():
    def row(charge):
        charge = np.array(charge)
        return claims_of_motion._charging(Arrest(0.03, charge, charge, charge, charge, charge, 9)).measured

    assert row([2.0, 2.1, 1.9]) is True and row([1.01, 0.99, 1.0]) is False and row([0.6, 1.1, 1.9]) is None


def test_m_at_the_breach_is_a_length_in_units_of_r_and_the_first_contact_is_counted():
    runs = Made(msd_at_breach=np.array([2.5e-5, 2.5e-5, np.nan]), wall_first=np.array([0.0, 0.0, np.nan]))
    main = Made(sliding=dict.fromkeys((0.083, 0.087, 0.09), runs))
    row = claims_of_motion._msd_at_breach(main)
    assert row.measured == pytest.approx(1e-2) and row.verdict == REPRODUCED and "1.0e-04 R²" in row.note
    first = claims_of_motion._where_first(main)
    assert first.verdict == NOT_REPRODUCED and "in 0 of 6 realisations" in first.note


def test_a_ratio_of_means_has_the_error_that_repeated_runs_show():
    rng, results = np.random.default_rng(0), []
    for _ in range(300):
        values = np.array([1.0, 1.2]) * (1 + 0.2 * rng.normal(size=(30, 2)))
        results.append(claims_of_motion._ratio("r", "Fig 7: text", np.vstack([values, [np.nan, 1.0]]), 0.1, "ratio"))
    measured = np.array([row.measured for row in results])
    assert measured.mean() == pytest.approx(1.2, rel=0.01) and "over 30 runs" in results[0].note
    assert np.median([row.error for row in results]) == pytest.approx(measured.std(), rel=0.15)
    assert claims_of_motion._ratio("r", "Fig 7: text", np.full((3, 2), np.nan), 0.1, "ratio").verdict == UNDECIDED


def test_one_case_without_balance_refutes_always_and_one_without_a_pair_leaves_it_open(monkeypatch):
    def row(*pushes):
        births = iter(pushes)
        monkeypatch.setattr(claims, "VARIED", [{"law": {"mu": k}} for k in range(len(pushes))])
        monkeypatch.setattr(claims, "first_pair", lambda **_: next(births))
        return claims._variants()

    assert row(0.1, 0.5).verdict == "not refuted" and "0.5 with mu 1" in row(0.1, 0.5).note
    assert row(0.1, None).verdict == UNDECIDED and "no pair up to 2 with mu 1" in row(0.1, None).note
    assert row(0.0, None).verdict == "refuted" and "Counterexample: with mu 0" in row(0.0, None).note


def drifting(raw: float, smooth: float, drift: float):
    """A result whose backward fronts, and front by the drift, have given speeds, with threshold 0.05 the second one."""
    distance = np.arange(10.0)[::-1]  # from the last disk
    delays = [np.tile(distance / speed, (8, 1)) for speed in (raw, smooth)]
    times = [100 + np.stack([2 * delay, delay], axis=1) for delay in delays]
    profile = np.stack([np.zeros((8, 10)), np.tile(-2e-5 * distance / drift, (8, 1))], axis=1)
    ensemble = Made(slide=times[0], smooth_slide=times[1], profile=profile, drift=np.full((8, 2), 2e-5), failures=())
    position = np.column_stack([np.arange(10.0) + 0.5, np.zeros((10, 2))])
    state = Made(grains=Made(radius=np.full(10, 0.5), position=position), cell=Made(vectors=np.diag([10.0, 1.0, 1.0])))
    scenario = Made(sliding=Made(thresholds=(0.01, 0.05)), seed=0, load=Made(disk=1), array=Made(disks=10))
    return Made(scenario=scenario, pressed=state, sliding=dict.fromkeys((0.083, 0.087, 0.09), ensemble))


def test_the_front_without_oscillation_is_compared_with_the_drift():
    row = claims_of_motion._drift(drifting(0.07, 0.1, 0.1))
    assert row.measured == pytest.approx(0.1) and row.reference == pytest.approx(0.1)
    assert "then it is 0.070" in row.note and "it agrees with the reference" in row.note
    assert "differs from the reference" in claims_of_motion._drift(drifting(0.1, 0.1, 0.4)).note
    speed = claims_of_motion.backward_claims(drifting(0.07, 0.1, 0.1), "")[0]
    assert speed.measured == pytest.approx(0.07) and "does not confirm the explanation" in speed.note
