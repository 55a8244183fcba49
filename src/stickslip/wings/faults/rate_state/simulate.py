"""Simulation of a spring-slider."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....kit import Report, checked, result_of, silent
from ..friction.laws import Sliding, SlipHistory, Spring, spring_slider, steady_sliding
from ..friction.loads import LoadStep
from . import EXPERIMENT
from .scenario import RateStateScenario

EARLIEST = 1e-4  # first sample of each leg on the logarithmic grid, as a fraction of the leg's duration


@result_of(EXPERIMENT)
class SliderResult(NamedTuple):
    """Result of a scenario."""

    scenario: RateStateScenario
    legs: tuple[LoadStep, ...]
    history: SlipHistory
    recorded: np.ndarray  # friction with noise, (N,)
    sliding: tuple[Sliding, ...]  # stability of steady sliding in each moving leg


@checked
def simulate_slider(
    scenario: RateStateScenario, *, folder: Path | None = None, workers: int | None = None, report: Report = silent
) -> SliderResult:
    """Run a scenario in one process; nothing is saved during the run."""
    surface, spring = scenario.surface.rate_state, Spring(**scenario.spring.model_dump())
    legs = tuple(LoadStep(leg.time, leg.velocity, leg.normal) for leg in scenario.legs)
    sliding = tuple(steady_sliding(surface, spring, leg.velocity) for leg in legs if leg.velocity > 0)
    rate = f"stiffness {spring.stiffness:g}, growth rate {max(regime.growth_rate for regime in sliding):.2e}"
    report("slider", 0.0, f"{len(legs)} legs of the load point, {rate}")
    few = scenario.samples.number // 3  # number of samples per leg evenly spaced in ln t; others: in t
    share = np.r_[np.geomspace(EARLIEST, 1.0, few), np.linspace(0, 1, scenario.samples.number - few + 1)[1:]]
    ends = np.cumsum([leg.duration for leg in legs])
    times = [end - leg.duration * (1 - np.unique(share)) for end, leg in zip(ends, legs, strict=True)]
    history = spring_slider(surface, spring, legs, times=np.unique(np.r_[0.0, np.concatenate(times)]))
    report("slider", 1.0, f"{rate}, friction {history.friction[-1]:.4f} at {history.velocity[-1]:.1e} m/s")
    return SliderResult(scenario, legs, history, history.friction + _noise(scenario, len(history.time)), sliding)


def _noise(scenario: RateStateScenario, number: int) -> np.ndarray:
    rng, rho = np.random.default_rng(scenario.seed), scenario.samples.correlation
    out = rng.normal(size=number)
    for k in range(1, number):
        out[k] = rho * out[k - 1] + np.sqrt(1 - rho**2) * out[k]
    return scenario.samples.noise * out
