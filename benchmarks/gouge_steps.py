"""Design of velocity steps of gouge at the paper's size: sequences that separate b and D_c, and their cost.

For sequences of velocity steps, errors of rate-and-state parameters are computed from two inputs: the sensitivities of
the slip law, with the a, b, D_c and stiffness of Ferdowsi & Rubin 2021, and the fluctuations of friction in steady
sliding of the stored samples, whose correlation decays exponentially with slip. Costs are in units of one sample
that runs the protocol at the paper's size.

python -m benchmarks gouge_steps
"""

from pathlib import Path

import numpy as np

from stickslip.friction import LoadStep, RateState, Spring, spring_slider
from stickslip.wings.faults.friction.laboratory import steady_mean
from stickslip.wings.papers.gouge.claims import DC, A, B
from stickslip.wings.papers.gouge.paper import MAIN, PAPER, STEPS, paper_size_scenario, stored_samples
from stickslip.wings.papers.gouge.sample import stiffness

SAMPLES, POINTS = 8, 120  # number of samples to run, and of points per leg
STORED = Path(__file__).parents[1] / "docs/reference/gouge_paper_size"
SEQUENCES = {  # slips [D] at the velocities [m/s]
    "1 D each": ((PAPER, 0.2, PAPER, 0.002, PAPER), (1, 1, 1, 1, 1)),
    "8 D up, 4 D down": ((PAPER, 0.2, PAPER), (1, 8, 4)),
    "16 D up, 4 D down": ((PAPER, 0.2, PAPER), (1, 16, 4)),
    "the protocol's": ((PAPER, 0.2, PAPER, 0.002, PAPER), STEPS),
    "twice 8 D up, 4 D down": ((PAPER, 0.2, PAPER, 0.2, PAPER), (1, 8, 4, 8, 4)),
}


def fluctuations(size: float) -> tuple[float, float]:
    """Standard deviation of friction in the slide before the steps, and its correlation length along slip [m]."""
    found = []
    for sample in stored_samples(STORED)[MAIN].values():
        slide = sample.realization.of("slide")[0].series
        late = slide.load_point > slide.load_point[0] + 0.7 * size
        length = np.ptp(slide.load_point[late]) / steady_mean(slide.friction[late]).effective
        found.append((slide.friction[late].std(ddof=1), length / 2))
    return tuple(np.mean(found, axis=0))


def model(legs, spring: float, values) -> np.ndarray:
    """Friction at equally spaced slips of each leg (velocity, slip [m]), for ln a, ln b, ln D_c and mu0."""
    a, b, dc = np.exp(values[:3])
    steps = [LoadStep(slip / velocity, velocity) for velocity, slip in legs]
    ends = np.cumsum([0.0, *(step.duration for step in steps)])
    share = (np.arange(POINTS) + 0.5) / POINTS
    times = np.concatenate([end + share * step.duration for end, step in zip(ends, steps, strict=False)])
    law = RateState(a, b, dc, mu0=values[3], v0=PAPER, law="slip")
    return spring_slider(law, Spring(spring), steps, times=times, before=PAPER).friction


def errors(legs, spring: float, noise: tuple[float, float]) -> np.ndarray:
    """Covariance of ln a, ln b, ln D_c and mu0 for the mean of `SAMPLES` samples."""
    middle, step = np.array([np.log(A), np.log(B), np.log(DC), 0.4]), 1e-3
    shifts = step * np.eye(4)
    columns = [(model(legs, spring, middle + d) - model(legs, spring, middle - d)) / (2 * step) for d in shifts]
    ends = np.cumsum([0.0, *(slip for _, slip in legs)])
    share = (np.arange(POINTS) + 0.5) / POINTS
    slip = np.concatenate([end + share * one for end, (_, one) in zip(ends, legs, strict=False)])
    scatter, length = noise
    alike = scatter**2 / SAMPLES * np.exp(-np.abs(slip[:, None] - slip) / length)
    jacobian = np.array(columns).T
    return np.linalg.inv(jacobian.T @ np.linalg.solve(alike, jacobian))


def rows(*, smallest: bool = False):
    """Table; the smallest size has only its first row."""
    scenario = paper_size_scenario()
    size, spring = scenario.grains.mean, stiffness(scenario) / scenario.load.normal_stress
    noise = fluctuations(size)
    yield (f"friction fluctuates by {noise[0]:.3f}, over {noise[1] / size:.2f} D of slip; {SAMPLES} samples")
    yield ("steps | b ± | D_c ± | correlation of ln b and ln D_c | a − b ± | cost of each [samples]")
    for name, (velocities, slips) in list(SEQUENCES.items())[: 1 if smallest else None]:
        legs = [(v, s * size) for v, s in zip(velocities, slips, strict=True)]
        inner = errors(legs, spring, noise)
        size_of = 1.96 * np.sqrt(np.diag(inner))
        weights = np.array([A, -B, 0.0, 0.0])
        gap, alike = 1.96 * np.sqrt(weights @ inner @ weights), inner[1, 2] / np.sqrt(inner[1, 1] * inner[2, 2])
        cost = sum(slip / velocity for velocity, slip in legs[1:]) / scenario.duration
        yield (f"{name} | {size_of[1]:.0%} | {size_of[2]:.0%} | {alike:.2f} | {gap:.4f} | {cost:.2f}")
