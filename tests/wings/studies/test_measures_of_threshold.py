"""Measures of `experiment = "threshold"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

from tests.measures import NUMBER, check

MEANT = {
    NUMBER: "threshold threshold_low threshold_high largest_share lasting_threshold lasting_threshold_low "
    "lasting_threshold_high largest_lasting_share arrest_low arrest_high strength first_pair first_limit"
}
SWEPT = ({"kicks.realizations": [1]}, "largest_share@1e-06", "1")  # a swept key, and a measure with its unit


def kicked():
    """Two velocities, of which the smaller never makes the sample slide."""
    threshold = Made(
        kicks=np.array([1e-13, 1e-4]), threshold=np.array([np.nan, 0.04]), arrest_range=(0.02, 0.03), first_pair=0.01,
        interval=np.array([[-np.inf, np.inf], [0.035, 0.05]]), probability=np.array([[0.0, 0.2], [0.0, 0.9]]),
        first_limit=0.015, lasting_threshold=np.array([np.nan, 0.045]),
        lasting_interval=np.array([[-np.inf, np.inf], [0.042, 0.048]]),
        lasting_probability=np.array([[0.0, 0.1], [0.0, 0.8]]),
    )  # fmt: skip
    return Made(found=threshold, strength=0.06), {
        "threshold_low@1e-13": -np.inf, "threshold_high@1e-13": np.inf,
        "largest_share@1e-13": 0.0, "threshold@0.0001": 0.04, "threshold_low@0.0001": 0.035,
        "threshold_high@0.0001": 0.05, "largest_share@0.0001": 0.9, "arrest_low": 0.02, "arrest_high": 0.03,
        "lasting_threshold@0.0001": 0.045, "lasting_threshold_low@0.0001": 0.042,
        "lasting_threshold_high@0.0001": 0.048, "largest_lasting_share@0.0001": 0.8,
        "strength": 0.06, "first_pair": 0.01, "first_limit": 0.015,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("threshold", *kicked(), monkeypatch)
