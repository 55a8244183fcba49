"""Measures of `experiment = "gouge"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

import stickslip as ss
from stickslip.wings.papers.gouge import protocol as gouge_run
from tests.measures import LENGTH, NUMBER, check

MEANT = {
    LENGTH: "thickness",
    NUMBER: "inertial_number stiffness_over_b steady_friction steady_friction_half peak slips largest_friction_drop",
}
SWEPT = ({"law.mu": [0.5]}, "steady_friction@0.3", "1")  # a swept key, and a measure with its unit


def crushed():
    """Two samples at two levels of friction, and slides after a hold whose peak is 0.05 above either level."""
    parts = [{"kind": "slide", "velocity": 0.3, "slip": 1.0}]
    load = {"stiffness": 200.0, "definition": "per_stress"}
    scenario = ss.scenario(experiment="gouge", law={"damping_n": 1e4}, protocol=parts, load=load)
    place = np.arange(1, 401) / 200

    def sample(seed, level):
        calm = Made(load_point=place * scenario.grains.mean, friction=np.full(400, level), time=place / 100,
                    velocity=np.full(400, 0.3), slip=place * scenario.grains.mean)  # fmt: skip
        calm.velocity[100:103] = 4.0
        peak = Made(load_point=calm.load_point, friction=level + 0.05 * (np.abs(place - 1) < 0.1))
        rows = ("slide", 0.3, 0.3, 0.0, calm), ("reslide", 0.3, 0.3, 1e-3, peak)
        tests = tuple(gouge_run.Test(*row) for row in rows)
        return gouge_run.Realization(seed, Made(thickness=21.0, inertial_number=2e-4), tests, {}, {})

    return Made(scenario=scenario, realizations=[sample(0, 0.4), sample(1, 0.5)]), {
        "slips": 2, "largest_friction_drop": 0.0,
        "thickness": 0.063, "inertial_number": 2e-4, "steady_friction@0.3": 0.45, "peak@0.3,0.001s,0.3": 0.05,
        "stiffness_over_b": 200.0 * scenario.scales.dc / scenario.scales.b,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("gouge", *crushed(), monkeypatch)
