"""A packing under a load that grows slowly: dynamics with dashpots and drag, in small steps of the load."""

from typing import NamedTuple

import numpy as np

from ..core.control import between
from ..core.dynamics.run import run
from ..core.dynamics.timestep import stable_time_step
from ..core.laws.builtin import Law
from ..core.readable import readable
from ..core.state import Control, State

STEPS = 500  # of the load, on the way to its end
SHARE = 0.1  # of the stable time step


@readable
class SlowRun(NamedTuple):
    """A slow run, T steps of the load."""

    time: float  # that a whole leg takes [time]
    load: np.ndarray  # (T,) in legs, at the end of each step
    states: tuple[State, ...]
    kinetic_energy: np.ndarray  # (T,) largest during each step [energy]


def slow_dynamics(
    state: State, law: Law, *legs: Control, time: float, until: float, drag: float, report=None
) -> SlowRun:
    """Follow a packing by dynamics while its control goes in straight lines through the given ones.

    Parameters
    ----------
    legs : as in `load_path`
    time : that each leg takes [time]
    until : load at which to stop, in legs
    drag : of translations and rotations [1/time]
    report : called as report(share done, words)

    Raises
    ------
    RuntimeError
        with one sentence, if a position is not a number.
    """
    dt = SHARE * stable_time_step(state, law)
    points, here, loads, states, energy = (state.control, *legs), state, [], [], []
    steps = max(1, round(time * until / STEPS / dt))
    for load in np.linspace(0, until, STEPS + 1)[1:]:
        leg = min(int(np.ceil(load)) - 1, len(legs) - 1)
        here = here._replace(control=between(points[leg], points[leg + 1], load - leg))
        here, record, outcome = run(here, law, steps, dt, drag=drag, every=max(1, steps // 20))
        if not outcome.ok:
            raise RuntimeError(f"slow dynamics ended at load {load:.4g}: {outcome}")
        loads.append(load)
        states.append(here)
        energy.append(float(record.kinetic_energy.max(initial=0.0)))
        if report:
            report(load / until, f"load {load:.4f}, kinetic energy {energy[-1]:.1e}")
    return SlowRun(time, np.array(loads), tuple(states), np.array(energy))
