"""Slider with rate-and-state friction on a spring, in logarithms of velocity and states; see `laws` for their rows.

`python -m benchmarks rate_state` compares the speed of the integrator with that of LSODA.
"""

from typing import NamedTuple

import numpy as np

from ....core.library import core
from . import laws

DONE = 0  # code of a complete history; the others are in the order of `ratestate.End`


class Slider(NamedTuple):
    """Parameters of a surface and its spring, in the units of `RateState` and `Spring`."""

    a: float
    b: float
    b2: float
    mu0: float
    cut: float  # V0/V1
    cut2: float  # V0/V2
    dc: float
    dc2: float
    v0: float
    alpha: float
    stiffness: float
    damping: float
    form: int
    evolution: int


def build_slider(values: dict, law: str, form: str) -> Slider:
    """Slider with named values: a, b, b2, mu0, v1, v2, dc, dc2, v0, alpha, stiffness and damping."""
    cuts = {"cut": values["v0"] / values["v1"], "cut2": values["v0"] / values["v2"]}
    codes = {"form": laws.form_code(form, *cuts.values()), "evolution": laws.EVOLUTIONS[law]}
    given = {name: values[name] for name in Slider._fields if name in values}
    return Slider(**{**given, **cuts, **codes})


def history(slider: Slider, start, legs: np.ndarray, times: np.ndarray, tolerance: float):
    """Integrate w, s and s2 from `start` to `times` (ascending, from the start of the legs).

    Parameters
    ----------
    legs : (3, L), see `loads.leg_arrays`

    Returns
    -------
    tuple
        rows (N, 3), NaN after a failure; a code; the time reached. At the end of a leg, the values are those before the
        next leg begins.
    """
    out, reached = np.full((len(times), 3), np.nan), np.zeros(1)
    code = core.slider_history(slider, *start, legs, legs.shape[1], times, len(times), tolerance, out, reached)
    return out, code, float(reached[0])


def rates(slider: Slider, logs, velocity: float, normal: float) -> tuple[np.ndarray, np.ndarray]:
    """Time derivatives of w, s and s2 (3,), and their Jacobian (3, 3); those of s2 are 0 if b2 = 0.

    Parameters
    ----------
    velocity : of the load point
    normal : normal stress over its reference
    """
    out, jacobian = np.empty(3), np.empty((3, 3))
    core.slider_rates(slider, np.array(logs, float), velocity, normal, out, jacobian)
    return out, jacobian


def friction(slider: Slider, logs) -> np.ndarray:
    """Friction coefficient at rows of logarithms (N,)."""
    return laws.friction(slider.form, logs, slider[:6])


def state_history(start: float, duration, velocity, v0: float, dc: float, law: str) -> np.ndarray:
    """Exact ln(V0 θ/D_c) at the ends of pieces of constant slip velocity, from its initial value."""
    duration, velocity = np.ascontiguousarray(duration, float), np.ascontiguousarray(velocity, float)
    out = np.empty(len(duration))
    core.state_history(laws.EVOLUTIONS[law], start, len(out), duration, velocity, v0, dc, out)
    return out
