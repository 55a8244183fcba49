"""Model-free measurements on a record: steady means with standard errors, peaks after holds, healing, cycles."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from ....kit import Series, checked, readable, require_not_negative, require_positive
from .loads import LoadStep, leg_arrays


@readable
class Mean(NamedTuple):
    """Mean of correlated values."""

    mean: float
    error: float  # standard error
    effective: float  # number of independent values with the same error


@readable
class Healing(NamedTuple):
    """Peak excess against the logarithm of the hold time, Δμ = slope ln t + intercept."""

    slope: float  # per e-fold of hold time
    intercept: float
    error: float  # standard error of the slope
    interval: tuple[float, float]  # 95 %


@readable
class HoldResponse(NamedTuple):
    """Response to the K holds in a record."""

    hold: np.ndarray  # duration [time]
    steady: np.ndarray  # friction before the hold
    drop: np.ndarray  # decrease of friction at its end
    excess: np.ndarray  # peak after the hold, above `steady`


@checked
def steady_mean(values: Series) -> Mean:
    """Mean of a stationary series, with a standard error that accounts for correlation.

    error² = s² 2τ/N with the integrated autocorrelation time τ = ½ + Σ ρ_l, summed up to the first lag above 5τ
    (A. Sokal, doi:10.1007/978-1-4899-0319-8_6); s² is corrected for the scatter of the mean.

    Parameters
    ----------
    values : (N,), evenly sampled

    Examples
    --------
    >>> found = steady_mean(np.sin(np.arange(1000.0)))
    >>> abs(found.mean) < 3 * found.error + 0.01
    True
    """
    x = _check_series(values, least=8)
    n, mean = len(x), float(x.mean())
    rest = x - mean
    variance = float(rest @ rest) / n
    if variance <= (1e-14 * max(abs(mean), 1e-300)) ** 2:
        return Mean(mean, 0.0, float(n))
    spectrum = np.fft.rfft(rest, 2 * n)
    rho = np.fft.irfft(np.abs(spectrum) ** 2)[: n // 2] / (n * variance)
    sums = 0.5 + np.cumsum(rho[1:])
    enough = np.flatnonzero(np.arange(1, len(sums) + 1) >= 5 * sums)
    tau = max(float(sums[enough[0] if len(enough) else -1]), 0.5)
    tau = min(tau, n / 4)
    effective = n / (2 * tau)
    return Mean(mean, float(np.sqrt(variance / max(effective - 1, 0.5))), float(effective))


@checked
def steady_start(values: Series, *, batch: int = 5) -> int:
    """Index from which a series with an initial transient can be considered steady.

    The cut d minimises Σ_{i≥d} (x_i − mean)²/(N − d)², computed from means of `batch` values, and removes at most half
    of the series (MSER; K. P. White, doi:10.1177/003754979706900601).

    Parameters
    ----------
    values : (N,), evenly sampled
    """
    require_positive(batch=batch)
    batch = int(batch)  # True is 1
    x = _check_series(values, least=4 * batch)
    means = x[: len(x) // batch * batch].reshape(-1, batch).mean(axis=1)[::-1]
    count = np.arange(1, len(means) + 1)
    spread = np.maximum(np.cumsum(means**2) - np.cumsum(means) ** 2 / count, 0.0)
    score = (spread / count**2)[::-1][: len(means) // 2 + 1]
    return int(np.argmin(score)) * batch


@checked
def healing(hold: Series, excess: Series) -> Healing:
    """Least-squares fit of the peak excess against ln(hold time), with the 95 % interval of Student's t distribution.

    Parameters
    ----------
    hold : (K,) positive, K ≥ 3 [time]
    excess : (K,) peak friction above steady friction
    """
    hold, excess = np.asarray(hold, float), np.asarray(excess, float)
    if hold.shape != excess.shape or hold.ndim != 1 or len(np.unique(hold)) < 3:
        raise ValueError(f"{len(np.unique(hold))} different holds were given: a fit with an interval needs three")
    if not (np.isfinite(excess).all() and (hold > 0).all() and np.isfinite(hold).all()):
        raise ValueError("holds must be positive and finite, and peaks must be finite: leave out all others")
    x = np.log(hold) - np.log(hold).mean()
    slope = float(x @ excess / (x @ x))
    rest = excess - excess.mean() - slope * x
    error = float(np.sqrt(rest @ rest / (len(x) - 2) / (x @ x)))
    reach = float(stdtrit(len(x) - 2, 0.975)) * error
    intercept = float(excess.mean() - slope * np.log(hold).mean())
    return Healing(slope, intercept, error, (slope - reach, slope + reach))


@checked
def hold_response(time: Series, friction: Series, legs: Iterable[LoadStep], *, before: float = 0.2) -> HoldResponse:
    """Drop in friction during every hold of a record, and the peak after it.

    Parameters
    ----------
    time, friction : (N,), from the start of the legs
    legs : legs of the load point; a hold is a leg of velocity 0 between two others
    before : final fraction of the leg before a hold, over which steady friction is averaged
    """
    legs = tuple(legs)
    time, friction, ends = np.asarray(time, float), np.asarray(friction, float), np.cumsum(leg_arrays(legs)[0])
    if friction.shape != time.shape:
        raise ValueError(f"friction has shape {friction.shape}, time {time.shape}: give one value per time")
    require_positive(before=before)
    drops = []
    for k in range(1, len(legs) - 1):
        if legs[k].velocity != 0.0:
            continue
        start, stop = ends[k - 1], ends[k]
        prior = friction[(time > start - before * legs[k - 1].duration) & (time <= start)]
        within, after = friction[(time > start) & (time <= stop)], friction[(time > stop) & (time <= ends[k + 1])]
        if not (len(prior) and len(within) and len(after)):
            raise ValueError(
                f"the record has no samples before, in or after the hold at time {start:g}: use a higher sampling rate"
            )
        level = float(prior.mean())
        drops.append((legs[k].duration, level, level - float(within[-1]), float(after.max()) - level))
    if not drops:
        raise ValueError("the legs contain no hold (velocity 0) between two others: there is nothing to measure")
    return HoldResponse(*np.array(drops).T)


def _check_series(values, least: int) -> np.ndarray:
    x = np.asarray(values, float)
    if x.ndim != 1 or len(x) < least:
        raise ValueError(f"values have shape {x.shape}: give a one-dimensional array of at least {least}")
    require_not_negative(values=float(np.abs(x).max(initial=0.0)))
    return x


CONTRAST = 100.0  # slip velocity of an event over the median one
SKIPPED = 1  # first intervals between events, which depend on the start


def passing_velocity(time, slip, velocity) -> np.ndarray:
    """Slip velocity at samples, or the mean velocity up to the next sample if that is larger.

    Events that begin and end between two samples appear in the mean velocity.
    """
    mean = np.append(np.diff(slip) / np.diff(time), velocity[-1])
    return np.maximum(velocity, mean)


def event_starts(velocity) -> np.ndarray:
    """Indices of the samples at which events begin: the velocity rises above CONTRAST times its median."""
    fast = velocity > CONTRAST * np.median(velocity)
    return np.flatnonzero(fast[1:] & ~fast[:-1]) + 1


def recurrence(time, velocity) -> float:
    """Mean time between the starts of events, without the first interval; NaN with fewer than three events."""
    intervals = np.diff(np.asarray(time)[event_starts(velocity)])[SKIPPED:]
    return float(np.mean(intervals)) if len(intervals) else np.nan


def repeated_slip(time, velocity, slip, since) -> np.ndarray | None:
    """Slip since the start of an event, as the last complete cycle repeated; None without one.

    Parameters
    ----------
    since : (N,) times since the start of the event; negative ones are before it
    """
    starts = event_starts(velocity)
    if len(starts) < SKIPPED + 2:
        return None
    first, last = starts[-2], starts[-1]
    period, jump = time[last] - time[first], slip[last] - slip[first]
    count = np.floor(since / period)
    part = slice(first, last + 1)
    return count * jump + np.interp(since - count * period, time[part] - time[first], slip[part] - slip[first])
