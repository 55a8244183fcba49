"""Measures of `experiment = "disk-array"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

from tests.measures import NUMBER, RATE, RATE_SQUARED, VELOCITY, check

MEANT = {
    NUMBER: "pairs",
    "load": "first_birth last_birth first_load_that_slides",
    RATE_SQUARED: "largest_im_lambda",
    RATE: "largest_growth_rate fitted_growth_rate",
    VELOCITY: "sliding_velocity",
}
SWEPT = ({"law.mu": [10.0]}, "largest_growth_rate", "1/time")  # a swept key, and a measure with its unit


def disks():
    """Two pairs are born, and one of three runs slides, whose growth could not be fitted."""

    def family(load, *values):
        return Made(eigenvalues=5 + 1j * np.array(values), birth=Made(load=load) if load else None)

    def free(slid, rate):
        return Made(slid=slid, growth=Made(growth_rate=rate) if rate else None)

    path = [Made(spectrum=Made(growth_rate=np.array(rates))) for rates in ([], [0.0, 0.03], [0.02])]
    runs = {0.02: free(False, 0.011), 0.04: free(False, 0.012), 0.08: free(True, None)}
    families = [family(0.06, 2e-3, 4e-3), family(0.05, 3e-3), family(None, 1e-3)]
    sliding = {0.08: Made(velocity=np.array([0.1, np.nan, 0.3]))}
    return Made(families=families, path=path, free_runs=runs, sliding=sliding), {
        "pairs": 3, "first_birth": 0.05, "last_birth": 0.06, "largest_im_lambda": 4e-3, "largest_growth_rate": 0.03,
        "first_load_that_slides": 0.08, "fitted_growth_rate": 0.012, "sliding_velocity@0.08": 0.2,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("disk-array", *disks(), monkeypatch)
