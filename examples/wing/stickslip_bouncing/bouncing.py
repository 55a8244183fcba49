"""A disk falls on a floor: `stickslip run` with `experiment = "bouncing"`."""

from typing import Literal, NamedTuple

import numpy as np

import stickslip as ss
from stickslip import kit


class Bouncing(kit.ScenarioBase):
    """A disk of diameter, mass and stiffness 1 that falls on a floor."""

    experiment: Literal["bouncing"] = "bouncing"
    height: kit.Positive = 1.0
    damping: kit.Positive = 0.1


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


@kit.styled
def draw(result: Bounce):
    """Height against time."""
    figure, axes = kit.column_axes()
    axes.plot(result.time, result.height)
    kit.label_axes(axes, x=("time", "time"), y=("height", "length"))
    return figure


REBOUND = kit.Quantity("rebound", "1", "height of the rebound over the initial height",
                       lambda result: result.height[np.argmin(result.height) :].max() / result.height[0])  # fmt: skip
EXPERIMENT = kit.Experiment(
    Bouncing, "a disk that falls on a floor and bounces", simulate, measures=kit.Measures([REBOUND]),
    numbers=lambda result: {"time": result.time, "height": result.height},
    show=lambda result: kit.console.print(f"rebound: {REBOUND.of(result):.4g} of the height"),
    figures=lambda result: [("fig1_height.png", draw(result))],
)  # fmt: skip
