"""Measures of `experiment = "quasi-rigid"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

from tests.measures import NUMBER, check

MEANT = {NUMBER: "last_load stress_ratio strain events collapses sliding_share error_of_slowest_dynamics collapse_load"}
SWEPT = ({"law.mu": [0.5]}, "stress_ratio", "1")  # a swept key, and a measure with its unit


def rigid():
    """Three samples; two have dynamics, and in one of them stability was lost."""

    def sample(k):
        points = [Made(sliding=0, contacts=1), Made(sliding=k, contacts=10)]
        collapses = [Made(quiet=True), *[Made(quiet=False)] * (k - 1)]
        path = Made(load=np.array([0.0, 0.1 * k]), events=[None] * k, points=points, collapses=collapses)
        slow = [Made(time=1.0, error=9.0), Made(time=1e4, error=0.01 * k), Made(time=1e3, error=9.0)] if k < 3 else []
        curve = Made(ratio=np.array([0.0, 0.2 * k]), strain=np.array([0.0, 1e-3 * k]))
        return Made(path=path, curve=curve, slow=slow, collapse=0.9 if k == 1 else None)

    return Made(tested=[sample(k) for k in (1, 2, 3)]), {
        "last_load": 0.2, "stress_ratio": 0.4, "strain": 2e-3, "events": 2, "sliding_share": 0.2, "collapses": 1,
        "error_of_slowest_dynamics": 0.015, "collapse_load": 0.9,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("quasi-rigid", *rigid(), monkeypatch)
