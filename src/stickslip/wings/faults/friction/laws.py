"""Laws of rate-and-state friction in terms of the logarithms of velocity and states, and a slider on a spring.

Rows (w, s, s2) contain w = ln(V/V0), s = ln(V0 θ/D_c), and s2 for a second state θ2 with D_c2. Rows (a, b, b2, mu0,
cut, cut2) contain the parameters of a surface: cut = V0/V1 and cut2 = V0/V2, with the cut-off velocities V1 and V2 of
the direct and the evolution effect; b2 = 0 with one state. The laws themselves are in `_core/rate_state.h`. `python -m
benchmarks rate_state` compares the speed of the integrator with that of LSODA.
"""

from typing import NamedTuple

import numpy as np

from ....kit import core

EVOLUTIONS = {"aging": 0, "slip": 1}
REFERENCES = {"aging": ("Dieterich1979", "Ruina1983"), "slip": ("Ruina1983",)}  # keys of references.bib
FORMS = {"logarithmic": 0, "regularized": 1}
CUT_OFF = 2


def form_code(form: str, cut: float, cut2: float) -> int:
    """Code of a form of the law, with or without cut-off velocities."""
    return CUT_OFF if cut > 0 or cut2 > 0 else FORMS[form]


def friction(form: int, logs, surface) -> np.ndarray:
    """Friction coefficient for rows of logarithms (N,), with one surface or one per row."""
    return _evaluate(form, logs, surface, 0)


def slopes(form: int, logs, surface) -> np.ndarray:
    """Derivatives of friction with respect to w, s and s2 (N, 3)."""
    return _evaluate(form, logs, surface, 1)


def curvatures(form: int, logs, surface) -> np.ndarray:
    """Second derivatives of friction: ww, ws, ws2, ss, ss2, s2s2 (N, 6)."""
    return _evaluate(form, logs, surface, 2)


def _evaluate(form: int, logs, surface, order: int) -> np.ndarray:
    logs, surfaces = np.array(logs, float, order="C", ndmin=2), np.array(surface, float, order="C", ndmin=2)
    out = np.empty((len(logs), (1, 3, 6)[order]))
    results = [out if k == order else None for k in range(3)]
    core.friction_of_rows(form, len(logs), logs, surfaces, len(surfaces), *results)
    return out if order else out[:, 0]


DONE = 0  # code of a complete history; other codes follow the order of `ratestate.End`


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

    def friction(self, logs) -> np.ndarray:
        """Friction coefficient for rows of logarithms (N,)."""
        return friction(self.form, logs, self[:6])


def build_slider(values: dict, law: str, form: str) -> Slider:
    """Build a slider from named values: a, b, b2, mu0, v1, v2, dc, dc2, v0, alpha, stiffness and damping."""
    cuts = {"cut": values["v0"] / values["v1"], "cut2": values["v0"] / values["v2"]}
    codes = {"form": form_code(form, *cuts.values()), "evolution": EVOLUTIONS[law]}
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
        rows (N, 3), NaN after a failure; a code; the time reached. At the end of a leg, values are those before the
        next leg begins.
    """
    out, reached = np.full((len(times), 3), np.nan), np.zeros(1)
    code = core.slider_history(slider, *start, legs, legs.shape[1], times, len(times), tolerance, out, reached)
    return out, code, float(reached[0])


def rates(slider: Slider, logs, velocity: float, normal: float) -> tuple[np.ndarray, np.ndarray]:
    """Time derivatives of w, s and s2 (3,), and their Jacobian (3, 3); those of s2 are 0 if b2 = 0.

    Parameters
    ----------
    velocity : velocity of the load point
    normal : normal stress over its reference
    """
    out, jacobian = np.empty(3), np.empty((3, 3))
    core.slider_rates(slider, np.array(logs, float), velocity, normal, out, jacobian)
    return out, jacobian


def state_history(start: float, duration, velocity, v0: float, dc: float, law: str) -> np.ndarray:
    """Exact ln(V0 θ/D_c) at the ends of intervals of constant slip velocity, from its initial value."""
    duration, velocity = np.ascontiguousarray(duration, float), np.ascontiguousarray(velocity, float)
    out = np.empty(len(duration))
    core.state_history(EVOLUTIONS[law], start, len(out), duration, velocity, v0, dc, out)
    return out
