"""Quasi-static paths that say when a step ends at an unstable equilibrium or on another branch."""

import warnings

import numpy as np
import pytest

import stickslip as ss
from stickslip.modes import UnstableEquilibriumWarning
from stickslip.solve.equilibrate import LeftPathError
from tests.events.packings import FRICTIONLESS, LINEAR, SMOOTH, drag, packing

EVENT = 0.0049365  # first event of the frictionless packing, see test_events.py


@pytest.fixture(scope="module")
def state():
    return packing(FRICTIONLESS, 3, 0.88)


def path(state, law, strains, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnstableEquilibriumWarning)
        return ss.protocols.ramp(state, strains, ss.protocols.aqs(law, **options))


def test_a_step_across_an_event_is_reported_and_the_first_warning_names_the_strain(state):
    strains = np.arange(0.0, 0.0072, 8e-4)
    with pytest.warns(UnstableEquilibriumWarning, match=r"at strain 0\.0056 the step left its branch") as caught:
        points = ss.protocols.ramp(state, strains, ss.protocols.aqs(FRICTIONLESS))
    assert len(caught) == 1
    marks = [point.outcome.left for point in points]
    across = int(np.searchsorted(strains, EVENT))
    assert marks.index(True) == across
    assert sum(marks) == 1


def test_small_steps_away_from_events_are_not_told(state):
    points = path(state, FRICTIONLESS, np.arange(0.0, 0.0048, 2e-4))
    assert not any(point.outcome.warning for point in points)


def test_a_path_can_stop(state):
    with pytest.raises(LeftPathError, match=r"at strain 0\.0056 the step left its branch") as error:
        path(state, FRICTIONLESS, np.arange(0.0, 0.0072, 8e-4), on_instability="stop")
    assert "\n" not in str(error.value)


def test_a_path_can_follow_dynamics():
    """The end of the step is that of damped dynamics from its beginning, not that of Newton's method."""
    sample = packing(LINEAR, 4)
    nu, step = drag(sample, LINEAR), 1e-3
    before = ss.protocols.find_events(sample, LINEAR, to=0.021, drag=nu, step=step)  # a contact slides at 0.02125
    assert not before.events
    strains = [0.021, 0.022]
    alone = path(before.state, LINEAR, strains)[-1]
    followed = path(before.state, LINEAR, strains, on_instability="follow-dynamics", drag=nu)[-1]
    assert alone.outcome.left and "damped dynamics" in followed.outcome.warning
    end, outcome = ss.relax(ss.packings.sheared(before.state, step), LINEAR, tolerance=1e-12, drag=nu)
    assert outcome.ok
    place = [state.grains.position - state.grains.position.mean(axis=0) for state in (end, followed.state, alone.state)]
    assert np.abs(place[1] - place[0]).max() < 3e-5  # the time steps differ
    assert np.abs(place[2] - place[0]).max() > 1e-3


def test_pairs_are_in_the_outcome_and_count_only_if_they_grow():
    """Pairs are seen in the spectrum of a path, so that there is no warning beside the outcome."""
    law, strains = ss.laws.hertz_mindlin(mu=10.0, coulomb="smooth"), np.arange(0.0, 3.2e-3, 4e-4)
    sample, _ = ss.packings.jammed(30, packing_fraction=0.68, seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UnstableEquilibriumWarning)
        points = ss.protocols.ramp(sample, strains, ss.protocols.aqs(law))
    with_pairs = [bool(len(point.spectrum.pairs)) for point in points]
    assert any(with_pairs)
    assert [point.outcome.unstable for point in points] == with_pairs
    damped = path(sample, law, strains, drag=5.0)
    assert not any(point.outcome.unstable for point in damped)


def test_missing_drag_and_unknown_choices_are_refused():
    for options, message in (
        ({"on_instability": "follow-dynamics"}, "requires drag"),
        ({"on_instability": "ignore"}, "'tell', 'follow-dynamics' or 'stop'"),
        ({"drag": -1.0}, "drag must be positive, got -1.0"),
    ):
        with pytest.raises(ValueError, match=message) as error:
            ss.protocols.aqs(SMOOTH, **options)
        assert "\n" not in str(error.value)


def test_sphere_shear_counts_such_steps():
    short = {"packings": 1, "packing": {"grains": 16, "dim": 2, "packing_fraction": 0.88}, "seed": 3}
    scenario = ss.scenario(
        experiment="sphere-shear", **short, law={"mu": 0.5, "coulomb": "smooth"},
        shear={"strain": (0.0, 4e-3), "step": 1e-3}, release={"duration": 10.0},
    )  # fmt: skip
    (sheared,) = ss.simulate(scenario, workers=1).paths
    assert sheared.unstable == int(((sheared.pairs > 0) | (sheared.negative > 0)).sum())
    assert 0 <= sheared.left <= 4
    with pytest.raises(ValueError, match=r"requires shear\.drag"):
        ss.scenario(experiment="sphere-shear", shear={"on_instability": "follow-dynamics"})
