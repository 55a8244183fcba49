"""Data for fits, and model friction for given parameters."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ....kit import check_types, readable
from .loads import LoadStep, check_times, leg_arrays
from .slider import DONE, build_slider, friction, history, state_history

TOLERANCE = 1e-10
NAMES = (
    "a",
    "b",
    "dc",
    "mu0",
    "b2",
    "dc2",
    "v1",
    "v2",
    "stiffness",
    "damping",
    "alpha",
    "theta",
    "trend",
    "trend_length",
    "drift",
)
FIT = ("a", "b", "dc", "mu0")  # free unless fixed
# one state, no cut-off velocities, and a linear trend
PLAIN = {"b2": 0.0, "dc2": 1.0, "v1": np.inf, "v2": np.inf, "trend_length": np.inf}
DEFAULTS = {"damping": 0.0, "alpha": 0.0, "theta": 1.0, "trend": 0.0, "drift": 0.0, **PLAIN}
LINEAR = ("mu0", "trend", "drift")
LOGARITHMIC = ("a", "b", "dc", "b2", "dc2", "v1", "v2", "stiffness", "damping", "alpha", "theta", "trend_length")
OWN = ("mu0", "theta", "trend", "drift")  # by default separate for each of several data sets


@readable
class Data(NamedTuple):
    """A record of friction and its loading: legs of the load point, or the measured slip velocity."""

    time: np.ndarray  # (N,) increasing, from the start of the legs [time]
    friction: np.ndarray  # (N,)
    legs: (
        list[LoadStep] | tuple[LoadStep, ...]
    ) = ()  # of the load point, see `LoadStep`; it pulls the surface through the spring
    velocity: np.ndarray | None = None  # (N,) measured slip velocity, positive; instead of legs [length/time]
    sigma: np.ndarray | None = None  # (N,) relative size of the noise; None if it is uniform
    before: float | None = None  # slip velocity before the start; None for that of the first leg [length/time]

    check_entries = check_types


class Prepared(NamedTuple):
    """Data as arrays."""

    time: np.ndarray
    friction: np.ndarray
    place: np.ndarray  # displacement of the load point (or slip), for the trend
    legs: np.ndarray | None  # (3, L), see `leg_arrays`
    velocity: np.ndarray | None
    sigma: np.ndarray
    used: np.ndarray  # (N,) True for samples that are fitted
    before: float

    @property
    def pieces(self) -> list[slice]:
        """Contiguous runs of fitted samples, as slices of those samples."""
        marks = np.flatnonzero(self.used)
        cuts = np.flatnonzero(np.diff(marks) > 1) + 1
        edges = [0, *cuts.tolist(), len(marks)]
        return [slice(i, j) for i, j in pairwise(edges)]


def prepare(data: Data, windows=None) -> Prepared:
    """Check data and convert them to arrays.

    Parameters
    ----------
    windows : pairs of times; only samples within one of them are fitted. None for all
    """
    time, friction = np.asarray(data.time, float), np.asarray(data.friction, float)
    check_times(time)
    if friction.shape != time.shape or not np.isfinite(friction).all():
        raise ValueError(
            f"friction must be {len(time)} finite numbers, one for each time: remove samples with missing values"
        )
    sigma = np.ones(len(time)) if data.sigma is None else np.asarray(data.sigma, float)
    if sigma.shape != time.shape or not ((sigma > 0) & np.isfinite(sigma)).all():
        raise ValueError(f"sigma must be {len(time)} positive numbers, one for each time, or None")
    if (data.velocity is None) == (len(data.legs) == 0):
        raise ValueError("data need either legs of the load point or the measured slip velocity: give exactly one")
    used = np.ones(len(time), bool) if windows is None else _in_windows(time, windows)
    if used.sum() < 8:
        raise ValueError(f"only {used.sum()} samples are used: a fit needs at least 8; give wider windows or more data")
    if data.velocity is not None:
        velocity = np.asarray(data.velocity, float)
        if velocity.shape != time.shape or not ((velocity > 0) & np.isfinite(velocity)).all():
            raise ValueError(
                "the measured slip velocity must be positive at every sample: smooth it, or fit with a spring"
            )
        mean = 0.5 * (velocity[1:] + velocity[:-1])
        place = np.r_[0.0, np.cumsum(mean * np.diff(time))]
        return Prepared(time, friction, place, None, velocity, sigma, used, data.before or float(velocity[0]))
    legs = leg_arrays(data.legs)
    ends = np.cumsum(legs[0])
    if time[0] < 0 or time[-1] > ends[-1] * (1 + 1e-9):
        raise ValueError(
            f"samples go from {time[0]:g} to {time[-1]:g}, legs from 0 to {ends[-1]:g}: the legs must cover the data"
        )
    before = float(legs[1, 0]) if data.before is None else data.before
    if not before > 0:
        raise ValueError("the record starts with the load point at rest: give `before`, the slip velocity before it")
    place = np.interp(time, np.r_[0.0, ends], np.r_[0.0, np.cumsum(legs[0] * legs[1])])
    return Prepared(np.minimum(time, ends[-1]), friction, place, legs, None, sigma, used, before)


def _in_windows(time, windows) -> np.ndarray:
    used = np.zeros(len(time), bool)
    try:
        windows = np.asarray(windows, float).reshape(-1, 2)
    except (TypeError, ValueError):
        raise ValueError(f"windows = {windows!r} was given: use pairs (start, end) of times") from None
    for window in windows:
        if not window[0] < window[1]:
            raise ValueError(
                f"the window {tuple(window.tolist())} was given: use pairs (start, end) with start before end"
            )
        used |= (time >= window[0]) & (time <= window[1])
    return used


def model_friction(
    case: Prepared, values: dict, law: str, form: str = "logarithmic", tolerance: float = TOLERANCE
) -> np.ndarray | None:
    """Model friction at all samples, or None if the slider runs away.

    Parameters
    ----------
    values : a, b, dc, mu0, v0, b2, dc2, v1, v2, stiffness, damping, alpha, theta (initial over steady state),
        trend, trend_length and drift (default: 0)
    """
    v = PLAIN | values
    slider = build_slider(v, law, form)
    start = np.log(v["theta"] * v["v0"] / case.before)
    trend = v["trend"] * _worn(case.place, v["trend_length"]) + v.get("drift", 0.0) * case.time
    if case.legs is None:
        mean, spans = 0.5 * (case.velocity[1:] + case.velocity[:-1]), np.diff(case.time)
        states = [np.full(len(case.time), start) for _ in range(2)]
        for state, dc in zip(states, (v["dc"], v["dc2"])[: 2 if v["b2"] else 1], strict=False):
            state[1:] = state_history(start, spans, mean, v["v0"], dc, law)
        return friction(slider, np.stack([np.log(case.velocity / v["v0"]), *states], axis=1)) + trend
    w = np.log(case.before / v["v0"])
    out, code, _ = history(slider, (w, start, start), case.legs, case.time, tolerance)
    if code != DONE or not np.isfinite(out).all():
        return None
    return friction(slider, out) + trend


def linear_column(case: Prepared, name: str) -> np.ndarray:
    """Factor of mu0, trend or drift at all samples, (T,)."""
    return {"mu0": np.ones(len(case.time)), "trend": case.place, "drift": case.time}[name]


def _worn(place: np.ndarray, length: float) -> np.ndarray:
    """Displacement that a trend counts: all of it, or L (1 − exp(−x/L)), as while a surface wears in."""
    return place if np.isinf(length) else -length * np.expm1(-place / length)
