"""Measures of `experiment = "sphere-shear"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

from tests.measures import NUMBER, RATE, STRESS, check

MEANT = {
    NUMBER: "packing_fraction coordination rattlers onset_strain onset_exponent pairs_at_last_strain "
    "onset_share_at_limit onset_mobilisation fitted_over_predicted_growth stress_drop_over_pressure "
    "contacts_lost unstable_steps steps_off_branch",
    STRESS: "packing_pressure shear_stress_at_last_strain",
    RATE: "largest_growth_rate",
}
SWEPT = ({"law.mu": [10.0]}, "coordination", "1")  # a swept key, and a measure with its unit


def spheres():
    """Three packings: medians are those of the middle one, or half-way between the two that have the measure."""

    def path(k):
        packed = Made(packing_fraction=0.6 + k / 100, pressure=1e-3 * k, coordination=5.0 + k, rattlers=10 * k)
        onset = Made(strain=1e-4 * k, exponent=0.5 + k, at_limit=0.1 * k, mobilisation=0.4 * k) if k < 3 else None
        return Made(packed=packed, onset=onset, pairs=np.array([9, k]), growth_rate=np.array([0.01, 0.1]) * k,
                    shear_stress=np.array([9.0, 2e-3 * k]), unstable=5 * k, left=k - 1)  # fmt: skip

    single = [Made(growth=Made(growth_rate=0.3), corrected_rate=0.2), Made(growth=None, corrected_rate=1.0), None]
    later = [Made(drop=0.1, pressure=np.array([0.5, 9.0]), contacts_lost=7), None, None]
    return Made(paths=[path(k) for k in (1, 2, 3)], single=single, later=later), {
        "packing_fraction": 0.62, "packing_pressure": 2e-3, "coordination": 7.0, "rattlers": 20, "onset_strain": 1.5e-4,
        "onset_share_at_limit": 0.15, "onset_mobilisation": 0.6,
        "onset_exponent": 2.0, "pairs_at_last_strain": 2, "largest_growth_rate": 0.2,
        "shear_stress_at_last_strain": 4e-3, "fitted_over_predicted_growth": 1.5, "stress_drop_over_pressure": 0.2,
        "contacts_lost": 7, "unstable_steps": 10, "steps_off_branch": 1,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("sphere-shear", *spheres(), monkeypatch)
