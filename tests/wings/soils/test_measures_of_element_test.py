"""Measures of `experiment = "element-test"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

import stickslip as ss
from stickslip.wings.soils.element_test.simulate import ElementRun, ElementSeries, SmallStrain
from tests.measures import NUMBER, STRESS, both, check

MEANT = {
    NUMBER: both(
        "e0 coordination nu0 strain_at_peak e_critical K0 compression_index rowe_correlation skempton "
        "largest_unbalanced rearranged_share strain_at_cone stiffness_number critical_reached critical_from "
        "critical_ratio compression_misfit swelling_index swelling_misfit reloading_index reloading_misfit skempton_B "
        "end_ratio e_end nu nu_half bonds broken_before broken_tension_peak broken_shear_peak broken_tension "
        "broken_shear"
    ),
    STRESS: both(
        "G0 E0 E50 p_critical u_at_peak sigma1_peak sigma3_peak sigma1_critical sigma3_critical p_end "
        "sigma1_end sigma3_end E E_half UCS tensile_strength strength crack_initiation"
    ),
    "angle": both("phi_peak psi phi_residual phi_rowe cone_direction"),
}
SWEPT = ({"sample.friction": [0.2]}, "phi_peak", "degrees")  # a swept key, and a measure with its unit


def loaded_sample():
    """Two triaxial tests of a sample that is elastic and incompressible, one of which is softer."""
    axial = np.linspace(0, 0.1, 101)

    def run(young):
        strain, stress = np.zeros((101, 4)), np.zeros((101, 3, 3))
        strain[:, :3] = axial[:, None] * [-0.5, -0.5, 1]
        stress[:, range(3), range(3)] = 1e5 + young * axial[:, None] * [0, 0, 1]
        columns = {name: np.zeros(101) for name in ElementSeries._fields}
        series = ElementSeries(**columns | {"load": axial, "strain": strain, "stress": stress})
        return ElementRun(0, None, SmallStrain(1.0, 2.0, 3.0, 0.3), series, None, "")

    result = Made(scenario=ss.scenario(experiment="element-test"), runs=(run(1e6), run(1.2e6)))
    return result, {
        "G0": 1.0, "G0_error": 0.0, "nu0": 0.3, "E50": 1.1e6, "E50_error": 12.7062 * 0.1e6, "psi": 0.0,
        "strain_at_peak": 0.1, "phi_peak": 0.5 * np.degrees(np.arcsin(1 / 3) + np.arcsin(0.12 / 0.32)), "e0": 0.0,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("element-test", *loaded_sample(), monkeypatch)
