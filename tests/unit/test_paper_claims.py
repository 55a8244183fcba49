"""What the rows of the papers' claims measure, on constructed inputs."""

from types import SimpleNamespace as Made

import numpy as np
import pytest

import stickslip as ss
from stickslip.loading.protocols import Growth
from stickslip.reports.claims import (
    NO_REFERENCE,
    NOT_REFUTED,
    NOT_REPRODUCED,
    REFUTED,
    REPRODUCED,
    UNDECIDED,
    note_quick_run,
)
from stickslip.wings.papers.disk_array import claims as disk_claims
from stickslip.wings.papers.disk_array import measures as disk_measures
from stickslip.wings.papers.disk_array.fronts import fit_front
from stickslip.wings.papers.disk_array.measures import Arrest, find_arrest
from stickslip.wings.papers.quasi_rigid import claims as quasi_claims
from stickslip.wings.papers.sphere_shear import claims as shear_claims
from stickslip.wings.status.path import LoadPath
from stickslip.wings.status.status import Verdict

RATE, FREQUENCY = 1e-3, 0.5


def released(start: float, end: float, *, duration: float = 6e4, drop: float = 0.2, lost: int = 3, rate: float = RATE):
    """A run from one pair: M at a level, then growing with its oscillation, then constant; stress falls with it."""
    time = np.linspace(0, duration, 20_001)
    wave = 1 + 0.5 * np.cos(2 * FREQUENCY * time)
    msd = start * (1 + 0.1 * wave) + 1e-3 * start * wave * np.exp(np.minimum(2 * rate * time, 600))
    msd = np.minimum(msd, end)
    inside = time[(msd > 1e-22) & (msd < 1e-11)]
    grown = msd[-1] > 1e-11
    growth = Growth(rate, FREQUENCY, inside[0], inside[-1], 11.0) if grown else None
    return Made(
        time=time, msd=msd, growth=growth, growth_rate=RATE, corrected_rate=RATE, corrected_frequency=FREQUENCY,
        drop=drop, shear_stress=np.ones(3), pressure=np.ones(3), contacts_lost=lost, pairs=1, strain=1e-3,
        constant=(1e-12, 1e-11),
    )  # fmt: skip


def sheared(single, *, reappears=(False, False), later=(), zero=(0.0, 0.0)):
    """A result of sheared packings with what claims read."""
    packed = Made(packing_fraction=0.68, pressure=1e-3, rattlers=1)
    paths = [
        Made(onset=Made(strain=4e-4, exponent=0.5), packed=packed, pairs=np.array([none, 1.0]), zero_modes=9,
             strain=np.array([0.0, 0.02]), reappears=back)
        for back, none in zip(reappears, zero, strict=True)
    ]  # fmt: skip
    scenario = Made(packing=Made(dim=3), release=Made(seed_velocity=1e-13))
    result = Made(paths=paths, single=list(single), later=list(later), scenario=scenario)
    parts = (shear_claims._path_claims, shear_claims._growth_claims, shear_claims._failure_claims)
    return {c.id: c for part in parts for c in part(result)}


def test_pairs_can_reappear_one_instance_is_enough_and_none_decides_nothing():
    runs = [None, None]
    assert sheared(runs)["pairs-reappear"].verdict == UNDECIDED
    assert sheared(runs, reappears=(True, False))["pairs-reappear"].verdict == REPRODUCED
    few = sheared([None] * 3, reappears=(False, True, False), zero=(0.0,) * 3)["pairs-reappear"]
    assert few.verdict == REPRODUCED
    assert "in 1 of 3 packings" in few.note


def test_one_packing_with_a_pair_at_zero_slip_is_enough_against_the_paper():
    assert sheared([None, None])["pairs-at-zero-slip"].verdict == REPRODUCED
    assert sheared([None, None], zero=(0.0, 1.0))["pairs-at-zero-slip"].verdict == NOT_REPRODUCED


@pytest.mark.parametrize(("start", "end", "decades"), [(1e-25, 1e-6, 19), (1e-25, 1e-9, 16), (1e-23, 1e-5, 18)])
def test_decades_are_those_of_the_growth_and_not_of_the_window_of_the_fit(start, end, decades):
    stretch = shear_claims.exponential_stretch(released(start, end))
    # the line is left where the level of the start is as high as the growing part, and the growth is cut at `end`
    assert stretch.decades == pytest.approx(decades, abs=0.7)
    assert stretch.last == pytest.approx(end, rel=0.1)
    assert stretch.ended
    row = sheared([released(start, end), released(start, end)])["decades-of-growth"]
    assert row.measured == pytest.approx(stretch.decades)
    assert row.verdict == UNDECIDED  # the paper does not print how large its perturbation was
    assert sheared([released(start, end)] * 2)["growth-follows-prediction"].verdict == REPRODUCED


def test_growth_at_another_rate_does_not_follow_the_prediction():
    row = sheared([released(1e-25, 1e-6, rate=0.9 * RATE)] * 2)["growth-follows-prediction"]
    assert row.verdict == NOT_REPRODUCED


def test_a_run_that_still_grows_has_lost_nothing_yet():
    growing = released(1e-25, 1.0, duration=2.3e4)
    assert growing.growth
    assert not shear_claims.exponential_stretch(growing).ended
    rows = sheared([growing, growing])
    assert rows["stress-drop-one-pair"].measured is None
    assert rows["stress-drop-one-pair"].verdict == UNDECIDED
    told = {c.id: c for c in note_quick_run(list(rows.values()))}
    assert told["stress-drop-one-pair"].note.startswith("not measured by a quick run")
    failed = [released(1e-25, 1e-6, drop=d) for d in (0.2, 0.21)]
    assert sheared(failed)["stress-drop-one-pair"].verdict == REPRODUCED
    assert sheared([*failed[:1], None])["stress-drop-one-pair"].verdict == UNDECIDED  # one realization
    later = sheared([None, None], later=failed)["stress-drop-later"]
    assert (later.verdict, later.paper, later.reference) == (NO_REFERENCE, None, 0.22)


def sample(end: float, verdict: str, collapse: float | None):
    path = LoadPath((Made(load=end),), (), Verdict[verdict], (), 0, None)
    return Made(path=path, collapse=collapse)


@pytest.mark.parametrize(
    ("tested", "low", "high"),
    [
        (sample(0.5, "UNSTABLE", 0.51), 1.02, 1.02),
        (sample(0.5, "NEGATIVE", None), 1.1, np.inf),  # dynamics passed the end by a tenth
        (sample(0.98, "UNSTABLE", None), 1 / 0.98, np.inf),  # and came to the whole load
        (sample(1.0, "CONSISTENT", 0.9), 0.0, 0.9),  # the path goes on
        (sample(0.5, "NOT_FOUND", 0.4), 0.0, 0.8),
        (sample(1.0, "CONSISTENT", None), 0.0, np.inf),
        (sample(0.0, "UNSTABLE", None), 0.0, np.inf),
    ],
)
def test_a_sample_in_which_path_or_dynamics_does_not_end_bounds_its_ratio(tested, low, high):
    assert quasi_claims.collapse_ratio(tested, 0.1) == pytest.approx((low, high))


def test_the_collapse_ratio_counts_every_sample():
    passed, fell, early = (1.1, np.inf), (1.0, 1.0), (0.9, 0.9)
    assert quasi_claims.censored_median([fell, early, fell]) == 1.0
    assert quasi_claims.censored_median([fell, passed, early]) == 1.0  # the passed one is above, however far
    assert quasi_claims.censored_median([fell, passed, passed]) is None
    assert quasi_claims.censored_median([(0.0, np.inf)]) is None
    tested = (sample(0.5, "UNSTABLE", 0.5), sample(0.5, "UNSTABLE", None), sample(1.0, "CONSISTENT", None))
    row = quasi_claims._collapse(Made(tested=tested, scenario=Made(dynamics=Made(beyond=0.1))))
    assert row.measured is None
    assert row.verdict == NO_REFERENCE
    for part in ("all 3 samples", "1.0000 to 1.0000 in 1", "above 1.1000 in 1", "1 whose path did not end"):
        assert part in row.note


def looked(symmetric, unique):
    """A sample whose path has lost Q > 0 or uniqueness at some points."""
    load = np.linspace(0.1, 0.5, len(symmetric))
    return Made(seed=7, looks=Made(load=load, symmetric=np.array(symmetric), unique=np.array(unique)))


def test_the_premise_is_refuted_by_a_state_that_outlives_it():
    kept = looked([0.1, 0.1, -0.1], [1, 1, 1])  # it fails where the path ends
    row = quasi_claims._premise(Made(tested=(kept,)))
    assert row.verdict == NOT_REFUTED
    lost = looked([0.1, -0.2, -0.1], [1, 0, 0])  # uniqueness is lost with it
    assert quasi_claims._premise(Made(tested=(kept, lost))).verdict == NOT_REFUTED
    outlived = looked([0.1, -0.2, -0.1], [1, 1, 0])
    row = quasi_claims._premise(Made(tested=(kept, outlived)))
    assert row.verdict == REFUTED
    assert "counterexample: sample 7 at load 0.3" in row.note


@pytest.mark.parametrize(
    ("yes", "total", "told"), [(5, 5, True), (0, 5, False), (4, 5, None), (2, 2, None), (0, 2, None), (9, 10, True)]
)
def test_few_samples_do_not_tell_more_often_from_less_often(yes, total, told):
    assert quasi_claims.sign_test(yes, total) is told


def pushed(msd):
    time = np.linspace(0, 1e4, len(msd))
    return Made(free_runs={0.062: Made(time=time, msd=np.array(msd), predicted_growth=0.0)})


def test_stable_means_that_m_does_not_rise():
    time = np.linspace(0, 1e4, 2001)
    beating = 1e-20 * (1.5 + np.cos(0.3 * time) + 0.4 * np.cos(0.0004 * time))
    assert disk_claims._stability(pushed(beating), "").verdict == REPRODUCED
    assert disk_claims._stability(pushed(beating * np.exp(1e-3 * time)), "").verdict == NOT_REPRODUCED
    assert disk_claims._stability(Made(free_runs={}), "").verdict == UNDECIDED


def test_the_power_of_im_lambda_is_found_with_its_error():
    rng, im = np.random.default_rng(1), np.array([1e-4, 2e-4, 4e-4, 8e-4])
    results = []
    for _ in range(300):
        speed = 2.0 * im**0.7 * (1 + 0.05 * rng.normal(size=4))
        results.append(disk_measures.Proportion(im, im, speed, 0.05 * speed).exponent)
    values, errors = np.array(results).T
    assert values.mean() == pytest.approx(0.7, abs=0.01)
    assert np.median(errors) == pytest.approx(values.std(), rel=0.25)
    assert disk_measures.Proportion(im[:2], im[:2], im[:2], im[:2]).exponent is None
    ratio, error = disk_measures.Proportion(im, im, 3 * im, 0.1 * im).mean_ratio
    assert (ratio, error) == (pytest.approx(3.0), pytest.approx(0.1 / 2))


def test_both_estimators_of_a_front_have_an_error_that_repeated_ensembles_show():
    rng, distance = np.random.default_rng(0), np.arange(10.0)
    fits = []
    for _ in range(60):
        times = 100 + 50 * (distance > 0) + distance / 0.05 + 20 * rng.normal(size=(40, 10))
        times[:, 0] = 100
        fits.append(fit_front(times, np.arange(10), distance))
    for value, error in (("speed", "speed_error"), ("free_intercept", "free_error")):
        spread = np.std([getattr(f, value) for f in fits])
        assert np.median([getattr(f, error) for f in fits]) == pytest.approx(spread, rel=0.3)  # 60 fits: 9 % and more
    late = np.mean([f.free_intercept for f in fits]) / np.mean([f.speed for f in fits])
    assert late > 1.05  # a start that is early pulls the fit through it down


def test_arrest_is_compared_with_the_late_motion_and_pairs_with_none():
    late = np.array([1.6e-5, 1.7e-5, 1.5e-5])
    arrest = Arrest(0.03, late, 1.02 * late, np.array([0, 1, 0]), np.array([1, 1, 2]), np.array([1.2, 1.1, 1.3]), 9)
    msd, pairs = disk_claims._arrest_claims(arrest)
    assert msd.id == "arrest-msd-0.030" and msd.measured == pytest.approx(1.632e-5) and msd.verdict == REPRODUCED
    assert "agrees with the reference 1.6e-05" in msd.note and "of 9 disk–disk contacts they have 1, 1, 2" in msd.note
    assert pairs.measured == 0 and "2 have none" in pairs.note
    far = disk_claims._arrest_claims(arrest._replace(static=0.01 * late))[0]
    assert far.verdict == NOT_REPRODUCED and "differs from the reference" in far.note


@pytest.mark.parametrize(
    ("interval", "verdict"),
    [((0.043, 0.045), REPRODUCED), ((0.038, 0.045), NOT_REPRODUCED), ((0.043, 0.09), NOT_REPRODUCED),
     ((-np.inf, 0.045), UNDECIDED)],
)  # fmt: skip
def test_the_threshold_must_lie_between_arrest_and_sliding(interval, verdict):
    threshold = Made(
        loads=np.array([0.04, 0.083]), probability=np.array([[0.1], [1.0]]), runs=np.full((2, 1), 16), distance=0.1,
        lasting_probability=np.array([[0.0], [0.9]]), kicks=np.array([1e-4]), lasting_threshold=np.array([0.044]),
        lasting_interval=np.array([interval]), arrest=np.array([[0.04, 0.045]] * 3), arrest_range=(0.04, 0.045),
    )  # fmt: skip
    value, between = disk_claims._threshold_claims(threshold)
    assert "slide by 0.1, and that keep sliding: 0.1 and 0 at 0.04, 1 and 0.9 at 0.083" in value.note
    assert "3 sliding arrays stopped between 0.04 and 0.045" in value.note
    assert between.verdict == verdict and value.verdict == NO_REFERENCE
    assert value.measured == (None if verdict == UNDECIDED else 0.044)


def test_late_states_of_an_array_relax_to_equilibria_at_rest():
    """Three disks at a push at which they oscillate: M of the equilibria is that of relaxation by hand."""
    chosen = ss.scenario(load={"push": (0.0, 0.03), "step": 5e-3}, array={"disks": 3}, dynamics={
        "loads": (0.03,), "duration": 400.0, "seed_velocity": 1e-6})  # fmt: skip
    result = ss.simulate(chosen)
    arrest = find_arrest(result, 0.03)
    start = result.path[-1].state
    state = ss.packings.perturbed(start, velocity=1e-6, seed=0)
    for k, duration in enumerate((400.0, *[50.0] * 7)):
        state, _, _ = ss.run(state, result.law, round(duration / 0.1), 0.1, threads=1)
        rest, outcome = ss.relax(state, result.law, tolerance=1e-14)
        assert outcome.ok
        assert arrest.late[k] == pytest.approx(((state.grains.position - start.grains.position) ** 2).sum(), rel=1e-6)
        assert arrest.static[k] == pytest.approx(((rest.grains.position - start.grains.position) ** 2).sum(), abs=1e-14)
    # while the pair still grows, the state relaxes to where it was: to the same contacts, and the same pair
    assert (
        arrest.static[0] < 1e-6 * arrest.late[0] and arrest.neighbours[0] == arrest.before == 2 and arrest.pairs[0] == 1
    )
