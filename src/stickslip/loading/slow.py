"""Slow dynamics of a packing under a changing load, with dashpots and drag, in small steps of the load."""

from typing import NamedTuple

import numpy as np

from ..core.arguments import checked, require_not_negative, require_positive
from ..core.control import between
from ..core.dynamics.run import run
from ..core.dynamics.timestep import stable_time_step
from ..core.laws.builtin import Law
from ..core.progress import Report, silent
from ..core.readable import readable
from ..core.state import Control, State

STEPS = 500  # steps of the load over the whole path
SHARE = 0.1  # time step over the stable one


@readable
class SlowRun(NamedTuple):
    """Slow run over T load steps."""

    time: float  # duration of a whole leg [time]
    load: np.ndarray  # (T,) in legs, at the end of each step
    states: tuple[State, ...]
    kinetic_energy: np.ndarray  # (T,) largest during each step [energy]


@checked
def slow_dynamics(
    state: State, law: Law, *legs: Control, time: float, until: float, drag: float, report: Report = silent
) -> SlowRun:
    """Follow a packing by dynamics while its control changes linearly from one given control to the next.

    The first leg begins at the control of the state, which may move. Loads are absolute, not increments.

    Parameters
    ----------
    legs : as in `load_path`
    time : duration of each leg [time]
    until : load at which to stop, in legs
    drag : drag on translations and rotations [1/time]
    report : called as report(stage, share done, text)

    Raises
    ------
    RuntimeError
        if a position is not a number.
    """
    require_positive(time=time, until=until)
    require_not_negative(drag=drag)
    if not 0 < until <= len(legs):
        raise ValueError(f"until = {until} was given for {len(legs)} legs: it must be above 0 and at most {len(legs)}")
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
        report("slow dynamics", load / until, f"load {load:.4f}, kinetic energy {energy[-1]:.1e}")
    return SlowRun(time, np.array(loads), tuple(states), np.array(energy))
