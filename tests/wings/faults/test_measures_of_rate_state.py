"""Measures of `experiment = "rate-state"`: names, units and values."""

import stickslip as ss
from stickslip.wings.faults.rate_state.simulate import simulate_slider
from tests.measures import NUMBER, PER_LENGTH, RATE, TIME, VELOCITY, check

MEANT = {
    NUMBER: "final_friction least_friction greatest_friction steady_friction stable",
    VELOCITY: "final_velocity",
    PER_LENGTH: "critical_stiffness",
    RATE: "growth_rate",
    TIME: "reached",
}
SWEPT = ({"surface.law": ["slip"]}, "critical_stiffness", "1/m")  # a swept key, and a measure with its unit


def slid():
    """The spring-slider's own example."""
    chosen = ss.scenario(experiment="rate-state")
    return simulate_slider(chosen), {}


def test_measures_have_their_values_and_units(monkeypatch):
    check("rate-state", *slid(), monkeypatch)
