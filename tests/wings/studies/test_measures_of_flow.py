"""Measures of `experiment = "flow"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

import stickslip as ss
from tests.measures import ENERGY, LENGTH, NUMBER, RATE, STRESS, TIME, check

MEANT = {
    TIME: "end",
    ENERGY: "kinetic_energy",
    STRESS: "plane_pressure",
    RATE: "plane_shear_rate",
    LENGTH: "deposit_top deposit_length run_out plane_height",
    NUMBER: "coordination grains_in_deposit plane_friction plane_friction_deviation plane_inertial_number "
    "plane_packing_fraction",
}
SWEPT = ({"grains.number": [40]}, "deposit_top", "length")  # a swept key, and a measure with its unit


def poured():
    """Three disks in a row and one that flies, between two plates of one grain each, the upper one moving."""
    place = np.array([[1.0, 2.0], [2.0, 2.0], [3.0, 2.0], [3.0, 9.0], [4.0, 0.0], [4.0, 12.0]])
    state = ss.assembly(ss.disks(place, 0.5, mass=1.5, velocity=np.array([[0.0, 0, 0]] * 5 + [[3.0, 0, 0]])))
    time = np.arange(1.0, 5.0)
    height, force = np.zeros((4, 2, 3)), np.zeros((4, 2, 3))
    height[:, 1, 1] = 12.0
    force[:, 1, :2] = [[0, 9], [0, 9], [-2.0, 8.0], [-4.0, 12.0]]
    series = Made(time=time, kinetic_energy=time**2, coordination=time / 2, plate_position=height, plate_force=force)
    scenario = Made(cell=Made(periodic=(), size=(5.0, 12.0)), grains=Made(dim=2))
    plates = {"bottom": np.array([4]), "top": np.array([5])}
    result = Made(series=series, frames=[state], scenario=scenario, poured=Made(loose=np.arange(4), plates=plates),
                 stages=[Made(start=0.0, end=4.0)])  # fmt: skip
    gap, pressure = 11.0, 10.0 / 5.0
    return result, {
        "end": 4.0, "kinetic_energy": 16.0, "coordination": 2.0, "deposit_top": 2.5, "grains_in_deposit": 3,
        "deposit_length": 3.0, "run_out": 3.5, "plane_friction": 0.3, "plane_friction_deviation": 0.1,
        "plane_pressure": pressure, "plane_shear_rate": 3 / gap, "plane_height": gap,
        "plane_inertial_number": 3 / gap * np.sqrt(1.5 / (np.pi / 4) / pressure),
        "plane_packing_fraction": np.pi / (5.0 * gap),
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("flow", *poured(), monkeypatch)
