"""A disk falls on a floor: `stickslip run` with `experiment = "bouncing"`."""

from typing import Literal, NamedTuple

import numpy as np

import stickslip as ss
from stickslip.kit import Experiment, Positive, ScenarioBase, column_axes, console, label_axes, styled


class Bouncing(ScenarioBase):
    """A disk of diameter, mass and stiffness 1 that falls on a floor."""

    experiment: Literal["bouncing"] = "bouncing"
    height: Positive = 1.0
    damping: Positive = 0.1


class Bounce(NamedTuple):
    """Height of the disk over the floor."""

    scenario: Bouncing
    time: np.ndarray  # (T,) [time]
    height: np.ndarray  # (T,) [length]


def simulate(scenario, *, folder=None, workers=None, report=None) -> Bounce:
    """Let the disk fall, and bounce once."""
    grain = ss.disks([[0, 0.5 + scenario.height, 0]], 0.5)
    weight = ss.control.loads(1, 1, gravity=(0, -1e-3, 0))
    state = ss.assembly(grain, ss.flat_walls([[0, 0, 0]], [[0, 1, 0]]), ss.box((9, 9, 1), dim=2), weight)
    law, dt = ss.laws.linear(damping="velocity", damping_n=scenario.damping), 0.02
    steps = int(2.5 * np.sqrt(2e3 * scenario.height) / dt)
    _, record, _ = ss.run(state, law, steps, dt, every=10, probes=[0])
    return Bounce(scenario, record.time, record.position[:, 0, 1] - 0.5)


@styled
def draw(result: Bounce):
    """Height against time."""
    figure, axes = column_axes()
    axes.plot(result.time, result.height)
    label_axes(axes, x=("time", "time"), y=("height", "length"))
    return figure


def rebound(result: Bounce) -> float:
    """Height of the rebound over the initial height."""
    return float(result.height[np.argmin(result.height) :].max() / result.height[0])


EXPERIMENT = Experiment(
    Bouncing, "a disk that falls on a floor and bounces", simulate,
    numbers=lambda result: {"time": result.time, "height": result.height},
    measures=lambda result: {"rebound": (rebound(result), "1")},
    show=lambda result: console.print(f"rebound: {rebound(result):.4g} of the height"),
    figures=lambda result: [("fig1_height.png", draw(result))],
)  # fmt: skip
