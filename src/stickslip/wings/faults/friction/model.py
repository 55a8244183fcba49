"""Data for fits, friction of the model, and noise: autoregressive models, whitening filters and spikes."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, toeplitz
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from ....kit import check_types, readable
from .laws import DONE, build_slider, history, state_history
from .loads import LoadStep, check_times, leg_arrays
from .ranges import Positive

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
FIT = ("a", "b", "dc", "mu0")  # parameters that are free unless they are fixed
# defaults: one state, no cut-off velocities, and a linear trend
PLAIN = {"b2": 0.0, "dc2": 1.0, "v1": np.inf, "v2": np.inf, "trend_length": np.inf}
DEFAULTS = {"damping": 0.0, "alpha": 0.0, "theta": 1.0, "trend": 0.0, "drift": 0.0, **PLAIN}
LINEAR = ("mu0", "trend", "drift")
LOGARITHMIC = ("a", "b", "dc", "b2", "dc2", "v1", "v2", "stiffness", "damping", "alpha", "theta", "trend_length")
OWN = ("mu0", "theta", "trend", "drift")  # by default, each of several data sets has a separate value


@readable
class Data(NamedTuple):
    """A record of friction and its loading: legs of the load point, or the measured slip velocity."""

    time: np.ndarray  # (N,) increasing, from the start of the legs [time]
    friction: np.ndarray  # (N,)
    legs: (
        list[LoadStep] | tuple[LoadStep, ...]
    ) = ()  # legs of the load point, which pulls the slider through the spring, see `LoadStep`
    velocity: np.ndarray | None = None  # (N,) measured, positive slip velocity instead of legs [length/time]
    sigma: np.ndarray | None = None  # (N,) relative size of the noise; None if it is uniform
    before: Positive | None = None  # slip velocity before the start; None: that of the first leg [length/time]

    def check_entries(self) -> None:
        """Raise ValueError, which `checked` passes on from within a union, if an entry is not valid."""
        try:
            check_types(self)
        except TypeError as problem:
            raise ValueError(f"Data are not valid: {problem}") from None


class Prepared(NamedTuple):
    """Checked data of one record, as arrays."""

    time: np.ndarray
    friction: np.ndarray
    place: np.ndarray  # displacement of the load point, or slip, by which the trend is multiplied
    legs: np.ndarray | None  # (3, L), see `leg_arrays`
    velocity: np.ndarray | None
    sigma: np.ndarray
    used: np.ndarray  # (N,) True for samples that are fitted
    before: float

    @property
    def pieces(self) -> list[slice]:
        """Contiguous runs of fitted samples, as slices into the array of all fitted samples."""
        marks = np.flatnonzero(self.used)
        cuts = np.flatnonzero(np.diff(marks) > 1) + 1
        edges = [0, *cuts.tolist(), len(marks)]
        return [slice(i, j) for i, j in pairwise(edges)]


def prepare(data: Data, windows=None) -> Prepared:
    """Check data and convert them to arrays.

    Parameters
    ----------
    windows : pairs of times; only samples within one of them are fitted. None: all samples
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
        displacement = np.r_[0.0, np.cumsum(mean * np.diff(time))]
        return Prepared(time, friction, displacement, None, velocity, sigma, used, data.before or float(velocity[0]))
    legs = leg_arrays(data.legs)
    ends = np.cumsum(legs[0])
    if time[0] < 0 or time[-1] > ends[-1] * (1 + 1e-9):
        raise ValueError(
            f"samples go from {time[0]:g} to {time[-1]:g}, legs from 0 to {ends[-1]:g}: the legs must cover the data"
        )
    before = float(legs[1, 0]) if data.before is None else data.before
    if not before > 0:
        raise ValueError("the record starts with the load point at rest: give `before`, the slip velocity before it")
    displacement = np.interp(time, np.r_[0.0, ends], np.r_[0.0, np.cumsum(legs[0] * legs[1])])
    return Prepared(np.minimum(time, ends[-1]), friction, displacement, legs, None, sigma, used, before)


def _in_windows(time, windows) -> np.ndarray:
    used = np.zeros(len(time), bool)
    try:
        windows = np.asarray(windows, float).reshape(-1, 2)
    except (TypeError, ValueError):
        raise ValueError(f"windows must be pairs (start, end) of times, got {windows!r}") from None
    for window in windows:
        if not window[0] < window[1]:
            raise ValueError(f"a window must start before it ends, got {tuple(window.tolist())}")
        used |= (time >= window[0]) & (time <= window[1])
    return used


def model_friction(
    case: Prepared, values: dict, law: str, form: str = "logarithmic", tolerance: float = TOLERANCE
) -> np.ndarray | None:
    """Friction of the model at all samples, or None if the slider runs away.

    Parameters
    ----------
    values : a, b, dc, mu0, v0, b2, dc2, v1, v2, stiffness, damping, alpha, theta (ratio of initial to steady state),
        trend, trend_length and drift (default: 0)
    """
    v = PLAIN | values
    slider = build_slider(v, law, form)
    start = np.log(v["theta"] * v["v0"] / case.before)
    length = v["trend_length"]  # slip over which a surface wears in
    worn = case.place if np.isinf(length) else -length * np.expm1(-case.place / length)
    trend = v["trend"] * worn + v.get("drift", 0.0) * case.time
    if case.legs is None:
        mean, spans = 0.5 * (case.velocity[1:] + case.velocity[:-1]), np.diff(case.time)
        states = [np.full(len(case.time), start) for _ in range(2)]
        for state, dc in zip(states, (v["dc"], v["dc2"])[: 2 if v["b2"] else 1], strict=False):
            state[1:] = state_history(start, spans, mean, v["v0"], dc, law)
        return slider.friction(np.stack([np.log(case.velocity / v["v0"]), *states], axis=1)) + trend
    w = np.log(case.before / v["v0"])
    out, code, _ = history(slider, (w, start, start), case.legs, case.time, tolerance)
    if code != DONE or not np.isfinite(out).all():
        return None
    return slider.friction(out) + trend


def linear_column(case: Prepared, name: str) -> np.ndarray:
    """Factors (T,) by which mu0, trend or drift is multiplied in the friction of the samples."""
    return {"mu0": np.ones(len(case.time)), "trend": case.place, "drift": case.time}[name]


MOST = 4  # largest order of an autoregressive model
WHITE = (np.zeros(0), np.zeros((0, 0)))


def autocovariance(pieces, lags: int) -> np.ndarray:
    """Autocovariance γ_l = Σ r_i r_{i+l} / N (lags + 1,) over pieces of a series; biased and thus positive definite."""
    total = sum(len(r) for r in pieces)
    return (
        np.array([sum(float(r[: len(r) - k] @ r[k:]) for r in pieces if len(r) > k) for k in range(lags + 1)]) / total
    )


def autoregression(pieces, most: int = MOST, *, taken=()) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients φ of r_i = Σ φ_m r_{i−m} + e_i, with an order selected by BIC, and the head of the whitening filter.

    The Yule–Walker equations are solved by Levinson's recursion on the autocovariance. The noise absorbed by a fit is
    added to it: residuals of generalised least squares have the covariance Σ − J C Jᵀ, where C is that of the
    parameters, so they are less correlated than the noise.

    Parameters
    ----------
    pieces : contiguous pieces of the residuals, each (n_i,)
    taken : columns g, cut into the same pieces, with Σ_k g_k g_kᵀ = J C Jᵀ; empty if the pieces are the noise itself

    Returns
    -------
    φ : (p,)
    head : (p, p) lower triangular matrix L⁻¹ that whitens the first p values; LLᵀ is their covariance over the variance
        of e
    """
    total = sum(len(r) for r in pieces)
    lags = min(most, max(total // 20, 0))
    gamma = sum((autocovariance(column, lags) for column in taken), autocovariance(pieces, lags))
    if gamma[0] <= 1e-300:
        return np.zeros(0), np.zeros((0, 0))
    phi, variance = np.zeros(0), gamma[0]
    best, score = (phi, variance), total * np.log(variance)
    for order in range(1, len(gamma)):
        reflection = (gamma[order] - phi @ gamma[order - 1 : 0 : -1]) / variance
        phi = np.append(phi - reflection * phi[::-1], reflection)
        variance = max(variance * (1 - reflection**2), 1e-300)
        bic = total * np.log(variance) + order * np.log(total)
        if bic < score:
            best, score = (phi, variance), bic
    phi, variance = best
    if len(phi) == 0:
        return WHITE
    return phi, np.linalg.inv(cholesky(toeplitz(gamma[: len(phi)]) / variance, lower=True))


def whitened(rows, noise, pieces) -> np.ndarray:
    """Filter rows (N, …) of a series so that its noise becomes white, with the variance of e in `autoregression`.

    Parameters
    ----------
    noise : φ and head, from `autoregression`
    pieces : slices of contiguous rows, which together cover all rows
    """
    phi, head = noise
    out = np.array(rows, float)
    for piece in pieces:
        part = np.asarray(rows[piece], float)
        done = part.copy()
        for m, coefficient in enumerate(phi, start=1):
            done[m:] -= coefficient * part[:-m]
        n = min(len(phi), len(part))
        if n:
            done[:n] = head[:n, :n] @ part[:n]
        out[piece] = done
    return out


def effective_samples(noise, total: int) -> float:
    """Number of independent samples that determine a mean as well as `total` samples with this noise do."""
    phi, head = noise
    if len(phi) == 0:
        return float(total)
    return min(total / head[0, 0] ** 2 * (1 - phi.sum()) ** 2, float(total))


def log_head_volume(noise, pieces) -> float:
    """Contribution of the heads of the pieces to the log-determinant of the noise covariance."""
    phi, head = noise
    logs = -np.cumsum(np.log(np.diag(head))) if len(phi) else np.zeros(0)
    return sum(float(logs[min(len(phi), piece.stop - piece.start) - 1]) for piece in pieces) if len(phi) else 0.0


AROUND = 7  # number of samples in the running median with which each sample is compared
FAR = 6.0  # standard deviations beyond which a sample is a spike (one Gaussian sample in 5e8)
MOST_SPIKES = 0.02  # largest fraction of spikes; with more of them, the noise is long-tailed
LEAST_NOISE = 1e-6  # ratio of noise to scatter of friction below which the noise is only round-off
TO_DEVIATION = 1.4826  # standard deviation of Gaussian noise over its median absolute deviation
SPREAD = np.sqrt(70.0)  # standard deviation of the fourth difference of white noise over that of the noise
ABRUPT, STEP = 0.5, 1e-2  # relative changes of the velocity and of the normal stress after which friction may peak
BEFORE, AFTER = -1, 3  # first and last sample, counted from such a change, that cannot be a spike


def find_spikes(case: Prepared) -> np.ndarray:
    """Indices of samples that are spikes, found from the record alone and therefore the same for every law.

    The distance of a spike from the median of its neighbours exceeds both six standard deviations of the noise and the
    change of this median around it, so that neither a resolved peak nor a stress drop counts. No sample at an abrupt
    load change counts as a spike, because it may be the peak of the response.
    """
    middle = _middle(case)
    apart = np.abs(case.friction - middle)
    far = case.used & (apart / case.sigma > FAR * noise_level([case]))
    if far.sum() > MOST_SPIKES * case.used.sum():
        return np.zeros(0, int)
    width = 2 * AROUND + 1
    moves = maximum_filter1d(middle, width) - minimum_filter1d(middle, width)
    if case.legs is None:
        first = np.flatnonzero(_abrupt(case.velocity)) + 1
    else:
        duration, velocity, normal = case.legs
        changes = _abrupt(velocity) | (np.abs(np.diff(normal)) > STEP)
        first = np.searchsorted(case.time, np.cumsum(duration)[:-1][changes])
    for shift in range(BEFORE, AFTER + 1):  # samples at a change of the load or just after it
        far[np.clip(first + shift, 0, len(far) - 1)] = False
    return np.flatnonzero(far & (apart > moves))


def noise_level(cases: list[Prepared]) -> float:
    """Noise between neighbouring samples: its standard deviation over `sigma`, from fourth differences of friction.

    Fourth differences vanish for smooth signals. They show the part of the noise that changes from sample to sample,
    which is smaller for correlated noise.
    """
    runs = [(case.friction / case.sigma)[case.used][run] for case in cases for run in case.pieces]
    fourth = np.abs(np.concatenate([np.diff(run, 4) for run in runs]))
    if not len(fourth):
        return 0.0
    values = np.unique(np.concatenate(runs))
    digit = np.diff(values).min(initial=np.inf) / np.sqrt(12.0)  # rounding error of numbers with few digits
    size = max(TO_DEVIATION * float(np.median(fourth)) / SPREAD, digit if np.isfinite(digit) else 0.0)
    return max(size, LEAST_NOISE * float(np.std(np.concatenate(runs))))


def _middle(case: Prepared) -> np.ndarray:
    """Running median of friction within runs of fitted samples; friction itself elsewhere."""
    out = case.friction.copy()
    rows = np.flatnonzero(case.used)
    for run in case.pieces:
        out[rows[run]] = median_filter(case.friction[rows[run]], AROUND, mode="nearest")
    return out


def _abrupt(velocity: np.ndarray) -> np.ndarray:
    """Mask of velocities that differ strongly from the previous one."""
    size = np.abs(velocity)
    return np.abs(np.diff(velocity)) > ABRUPT * np.maximum(size[1:], size[:-1])


def without(used: np.ndarray, spikes: np.ndarray) -> np.ndarray:
    """Mask of the fitted samples, without spikes."""
    kept = used.copy()
    kept[spikes] = False
    return kept
