"""Skill of predictors: the ROC against the definition of Mann and Whitney, and resampling of whole packings."""

import numpy as np
import pytest

from stickslip.wings.studies.catalogue.figures import roc_curves
from stickslip.wings.studies.catalogue.simulate import (
    event_table,
    label_steps,
    resampled_skill,
    roc,
    skills,
    step_table,
)
from tests.events.made import samples


def area_by_pairs(score, followed) -> float:
    """Share of pairs of steps, one of each kind, in which the right one has the larger score; ties count one half."""
    pairs = [(a, b) for a in score[followed] for b in score[~followed]]
    return sum(1.0 if a > b else 0.5 if a == b else 0.0 for a, b in pairs) / len(pairs)


@pytest.mark.parametrize("levels", [3, 1000])
def test_area_is_the_share_of_pairs_in_the_right_order(levels):
    rng = np.random.default_rng(levels)
    followed = rng.random(60) < 0.3
    score = np.round(rng.normal(size=60) * levels + levels * followed) / levels  # with many ties, or few
    curve = roc(score, followed)
    assert curve.area == pytest.approx(area_by_pairs(score, followed), abs=1e-12)
    assert curve.false_alarms[0] == curve.hits[0] == 0 and curve.false_alarms[-1] == curve.hits[-1] == 1
    assert (np.diff(curve.hits) >= 0).all() and (np.diff(curve.false_alarms) >= 0).all()


def test_points_of_the_curve_are_those_of_all_thresholds():
    rng = np.random.default_rng(1)
    score, followed = rng.integers(0, 6, 40).astype(float), rng.random(40) < 0.4
    curve = roc(score, followed)
    for threshold in np.unique(score):
        announced = score >= threshold
        point = (announced[~followed].mean(), announced[followed].mean())
        assert np.isclose(np.stack([curve.false_alarms, curve.hits], axis=1), point).all(axis=1).any()


def test_weights_count_steps_several_times():
    rng = np.random.default_rng(2)
    score, followed, weight = rng.normal(size=30), rng.random(30) < 0.4, rng.integers(0, 4, 30)
    repeated = roc(np.repeat(score, weight), np.repeat(followed, weight))
    assert roc(score, followed, weight).area == pytest.approx(repeated.area, abs=1e-12)


def test_no_events_have_no_area():
    assert np.isnan(roc(np.arange(4.0), np.zeros(4, bool)).area)


def test_scores_must_be_finite():
    with pytest.raises(ValueError, match="finite"):
        roc(np.array([1.0, np.nan]), np.array([True, False]))


def test_packings_are_resampled_as_a_whole():
    """All steps of a packing are equal: its number of steps adds no information, and must not narrow the interval."""
    rng = np.random.default_rng(0)
    level, fate = rng.normal(size=30), np.arange(30) % 2 == 0
    few, many = (
        resampled_skill("x", np.repeat(level, n), np.repeat(fate, n), np.repeat(np.arange(30), n), resamples=400)
        for n in (1, 50)
    )
    assert many.high - many.low == pytest.approx(few.high - few.low, rel=1e-9)
    alone = resampled_skill(
        "x", np.repeat(level, 50), np.repeat(fate, 50), np.arange(1500), resamples=400
    )  # wrong: every step taken as independent
    assert alone.high - alone.low < 0.3 * (many.high - many.low)
    assert many.low < many.roc.area < many.high
    assert many.packings == 30 and many.steps == 1500


def test_interval_covers_the_true_area():
    """Packings with random scores and no skill: 95 % intervals contain 1/2 about 95 times in 100."""
    rng = np.random.default_rng(5)
    inside = 0
    for _ in range(100):
        block = np.repeat(np.arange(25), 8)
        score = rng.normal(size=25)[block] + 0.3 * rng.normal(size=200)
        followed = rng.random(200) < 0.25
        skill = resampled_skill("x", score, followed, block, resamples=200)
        inside += skill.low <= 0.5 <= skill.high
    assert 86 <= inside <= 100


def test_one_packing_has_no_interval():
    skill = resampled_skill("x", np.arange(4.0), np.array([False, True, False, True]), np.zeros(4, int), resamples=10)
    assert np.isnan(skill.low) and np.isnan(skill.band).all() and skill.roc.area == 0.75


def test_which_steps_an_event_follows():
    steps = {"sample": np.array([1] * 6 + [2] * 3), "strain": np.array([0, 1, 2, 3, 4, 5, 0, 1, 2.0])}
    events = {"sample": np.array([1, 2]), "strain": np.array([3.0, 2.5])}
    followed, known = label_steps(steps, events, 1.0)
    assert followed.tolist() == [False, False, True, False, False, False, False, False, True]
    assert known.tolist() == [True, True, True, True, True, False, True, True, True]
    followed, _ = label_steps(steps, events, 2.0)
    assert followed.tolist() == [False, True, True, False, False, False, False, True, True]


def test_a_predictor_that_announces_is_distinguished_from_those_that_do_not():
    made = samples(12, 6)
    steps, events = step_table(made), event_table(made)
    steps["switch"][5] = np.nan
    values = {skill.predictor: skill for skill in skills(steps, events, 4e-4, resamples=200)}
    assert values["switch"].low > 0.95 and values["nonaffine_rate"].low > 0.6
    assert values["loss_ahead"].roc.area == 1 and len(values["loss_ahead"].roc.hits) == 3  # infinite strains are ties
    assert values["softest"].low < 0.5 < values["softest"].high
    assert values["switch"].followed == values["softest"].followed == 72
    assert values["softest"].steps - values["switch"].steps == 1


@pytest.mark.parametrize("name", ["softest", "tangent_modulus", "switch", "loss_ahead"])
@pytest.mark.parametrize("falls", [True, False])
def test_softening_announces_an_event_and_stiffening_does_not(name, falls):
    made = samples(2, 4)
    steps, events = step_table(made), event_table(made)
    followed, _ = label_steps(steps, events, 4e-4)
    steps[name] = np.where(followed == falls, 1.0, 2.0)
    (skill,) = (one for one in skills(steps, events, 4e-4, resamples=2) if one.predictor == name)
    assert skill.roc.area == falls


@pytest.mark.parametrize("name", ["nonaffine_rate", "growth"])
def test_faster_motion_announces_an_event(name):
    made = samples(2, 4)
    steps, events = step_table(made), event_table(made)
    followed, _ = label_steps(steps, events, 4e-4)
    steps[name] = np.where(followed, 2.0, 1.0)
    (skill,) = (one for one in skills(steps, events, 4e-4, resamples=2) if one.predictor == name)
    assert skill.roc.area == 1


def test_one_law_takes_a_column_and_two_laws_the_width_of_a_page():
    made = samples(4, 4)
    found = skills(step_table(made), event_table(made), 4e-4, resamples=2)
    widths = [25.4 * roc_curves(panels).get_figwidth() for panels in (found, [found, found])]
    assert widths == pytest.approx([86, 178])  # mm
