"""Measures of `experiment = "failure"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

import stickslip as ss
from tests.measures import NUMBER, RATE, STRESS, check

MEANT = {
    NUMBER: "strain first_pair first_event first_break broken events pairs first_slide drop",
    STRESS: "stress",
    RATE: "growth_rate",
}
SWEPT = ({"law.mu": [10.0]}, "stress", "force/length^(dim-1)")  # a swept key, and a measure with its unit


def failed():
    """A contact slides in the second of three steps, and the third has an event that breaks two bonds."""
    slid, none = np.array([[2, 0, 1]]), np.zeros((0, 3), int)
    event = Made(strain=2.5e-4, stress_drop=0.1, broken=np.array([[0, 1], [2, 3]]))
    steps = [
        Made(strain=k * 1e-4, stress=k, pairs=k, growth=0.1 * k, changes=slid if k == 1 else none) for k in range(1, 4)
    ]
    return Made(scenario=ss.scenario(experiment="failure", packing={"file": "a.npz"}), found=Made(
        steps=steps, events=[event], onset=Made(load=2e-4))
    ), {
        "strain": 3e-4, "stress": 3, "pairs": 3, "growth_rate": 0.3, "first_pair": 2e-4, "first_event": 2.5e-4,
        "first_break": 2.5e-4, "broken": 2, "events": 1, "drop": 0.1, "first_slide": 1e-4,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("failure", *failed(), monkeypatch)
