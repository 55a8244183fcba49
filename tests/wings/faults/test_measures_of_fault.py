"""Measures of `experiment = "fault"`: names, units and values."""

from types import SimpleNamespace as Made

import numpy as np

from stickslip.wings.faults.fault.simulate import FaultResult
from stickslip.wings.faults.friction.fault_cycles import Energy
from stickslip.wings.faults.friction.fault_record import FaultEvents
from tests.measures import FORCE, LENGTH, LINE_ENERGY, NUMBER, STRESS, TIME, VELOCITY, check

MEANT = {
    NUMBER: "events radiated_fraction energy_residual event_energy_residual magnitude",
    TIME: "first_event recurrence duration",
    VELOCITY: "max_velocity rupture_speed",
    FORCE: "moment",
    LENGTH: "surface_slip max_slip nucleation_depth nucleation_length rupture_bottom rupture_length crept_length",
    STRESS: "stress_drop slip_weighted_stress_drop seismological_stress_drop",
    LINE_ENERGY: "released radiated fracture",
}
SWEPT = ({"friction.dc": [6e-3]}, "energy_residual", "1")  # a swept key, and a measure with its unit


def cycled():
    """Five events, of which the last two are settled; without an event there is no average."""
    start = 10.0 * np.arange(5)
    steady = {name: np.ones(5) for name in FaultEvents._fields} | {
        "start": start,
        "end": start + np.array([0, 0, 0, 1, 3]),
    }
    fault, state = Made(cell=50.0, dc=0.1, changes=("injection",)), Made(excess_slip=np.array([0.05, 0.1, 0.3]))
    history = Made(events=FaultEvents(**steady), energy=Energy(10.0, 7.0, 1.0, 1.0), fault=fault, state=state)
    return FaultResult(Made(line=Made(strike_length=10**19.6)), history, None), {
        "events": 5, "magnitude": 7.0, "event_energy_residual": 0.0, "first_event": 0.0, "recurrence": 10.0,
        "duration": 2.0, "radiated_fraction": 0.1, "energy_residual": 0.1, "moment": 1.0, "crept_length": 100.0,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("fault", *cycled(), monkeypatch)
