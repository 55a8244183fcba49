"""Curves of holds and of slides after holds in fault gouge, for figures and claims."""

import numpy as np

from ...faults.friction.loads import LoadStep
from ...faults.friction.ratestate import RateState, Spring, spring_slider
from . import measures
from .dimensionless import stiffness
from .simulate import GougeResult
from .statistics import slope


def predict_hold(result: GougeResult, before: float, times) -> dict:
    """Predict the change in friction during a hold from rate-and-state friction with the scenario's a, b and dc.

    Returns {law: (times, change in friction)} for the slip law and the aging law.
    """
    scales, scenario = result.scenario.scales, result.scenario
    spring = Spring(stiffness(scenario) / scenario.load.normal_stress)
    out = {}
    for law in ("slip", "aging"):
        rs = RateState(scales.a, scales.b, scales.dc, mu0=0.0, v0=before, law=law)
        history = spring_slider(rs, spring, (LoadStep(float(times[-1]) * (1 + 1e-9), 0.0),), times=times, before=before)
        out[law] = (times, history.friction)
    return out


def predict_per_efold(result: GougeResult, before: float, times, law: str) -> float:
    """Slope of a predicted hold against the logarithm of time, over the times used by `measures.per_efold`."""
    time, change = predict_hold(result, before, times)[law]
    late = time >= min(measures.EARLIEST, time[-1] / 10)
    return float(np.polyfit(np.log(time[late]), change[late], 1)[0])


def reslides_after_longest(result: GougeResult, before: float):
    """Return curves, velocities and peaks of slides after the longest hold, slowest first, and the hold itself."""
    longest = max(h for v, h, _ in measures.reslides(result) if v == before)
    after = [w for v, h, w in measures.reslides(result) if (v, h) == (before, longest)]
    curves = [measures.reslide_curve(result, before, longest, w) for w in after]
    return curves, np.array(after), [measures.peak(c) for c in curves], longest


def holds_with_common_velocity(result: GougeResult, before: float) -> tuple[list[float], float]:
    """Return the hold times followed by slides at one common velocity, and that velocity.

    The velocity is the one before the hold if there are such slides, otherwise the slowest.
    """
    holds = [(h, w) for v, h, w in measures.reslides(result) if v == before]
    chosen = before if any(w == before for _, w in holds) else min(w for _, w in holds)
    return sorted(h for h, w in holds if w == chosen), chosen


def healing_peaks(result: GougeResult, before: float):
    """Return hold times, the peaks after them at one velocity, and the slope of these per e-fold of hold time."""
    times, after = holds_with_common_velocity(result, before)
    peaks = [measures.peak(measures.reslide_curve(result, before, h, after)) for h in times]
    return times, peaks, slope(np.log(times), peaks)
