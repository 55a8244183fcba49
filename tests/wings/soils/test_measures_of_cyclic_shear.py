"""Measures of `experiment = "cyclic-shear"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

import stickslip as ss
from stickslip.core.dynamics.ledger import Ledger
from stickslip.wings.soils.cyclic_shear.simulate import CyclicRun, Response
from tests.measures import NUMBER, STRESS, both, check

MEANT = {
    NUMBER: both("gamma_half gamma_elastic gamma_returns residual in_band") + " G_ratio damping",
    STRESS: both("G0 G_smallest"),
}
SWEPT = ({"sample.friction": [0.2]}, "G_smallest", "N/m")  # a swept key, and a measure with its unit


def cycled_sample():
    """Two elastic samples, which yield at a larger amplitude: loops with a straight axis, and an area of their own."""
    theta = np.linspace(0, 2 * np.pi, 401)

    def response(amplitude, g, width, distance):
        gamma, tau = amplitude * np.sin(theta), g * amplitude * np.sin(theta) + width * np.cos(theta)
        energies = np.zeros((2, 401, len(Ledger._fields)))
        energies[:, -1, Ledger._fields.index("external")] = np.pi * amplitude * width
        rows = [np.tile(values, (2, 1)) for values in (gamma, tau, *4 * [0 * theta])]
        return Response(amplitude, *rows, energies, np.zeros(2), np.zeros(2), distance * (1 - np.eye(3)))

    chosen = ss.scenario(experiment="cyclic-shear", cycles={"amplitudes": [1e-6, 1e-4]})
    run = CyclicRun(0, None, 1e8, (response(1e-6, 1e8, 0.0, 0.0), response(1e-4, 4e7, 1e3, 1.0)), None, "")
    return Made(scenario=chosen, runs=(run, run)), {
        "G0": 1e8, "G0_error": 0.0, "G_smallest": 1e8, "gamma_half": 10 ** (-6 + 2 * 0.5 / 0.6), "G_ratio@0.0001": 0.4,
        "damping@0.0001": 1e3 / (2 * 4e7 * 1e-4), "gamma_elastic": 1e-6, "gamma_returns": 1e-6, "residual": 1.0,
        "in_band": 0.0,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("cyclic-shear", *cycled_sample(), monkeypatch)
