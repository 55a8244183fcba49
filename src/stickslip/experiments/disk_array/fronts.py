"""Transition from static to dynamic friction in a row of disks: slip times of the disks and speeds of the fronts."""

import warnings
from typing import NamedTuple

import numpy as np

from ...core.laws.builtin import Law
from ...core.state import SLIDE, State
from ...loading.protocols import free_run, perturbed

BOOTSTRAPS = 1000


class Transition(NamedTuple):
    """One realization of the transition. Times of events that did not happen are NaN."""

    breach: np.ndarray  # (N,) first time at the Coulomb limit of each disk's contact with the substrate [time]
    slide: np.ndarray  # (H, N) first time at which a disk has moved along the row by each threshold [time]
    # velocity of the center of mass over the last third of the run; NaN unless all disks slid before it [length/time]
    velocity: float  # [length/time]
    time: np.ndarray  # (S,) [time]
    center: np.ndarray  # (S, 2) center of mass [length]


class Front(NamedTuple):
    """Front fitted to the mean times at each disk: distance = speed × time, through its start (Eq 9)."""

    distance: np.ndarray  # (N,) from the disk where it starts [length]
    delay: np.ndarray  # (N,) mean time after its start [time]
    error: np.ndarray  # (N,) standard error of the mean [time]
    speed: float  # [length/time]
    speed_error: float  # bootstrap over realizations, one standard deviation [length/time]
    free_intercept: float  # speed by regression of time on distance without fixing the start [length/time]
    free_error: float  # same bootstrap, half of the central 68 % interval, as 1/slope has long tails [length/time]
    complete: int  # realizations in which the event happened at every disk
    counted: int  # realizations included in the fit


def breach_times(events: np.ndarray, start: State) -> np.ndarray:
    """Return the first time at which each grain's contact with a wall reached the Coulomb limit, shape (N,).

    It is the time of `start`, the state before the run, if the contact was already at the limit then, and NaN if
    it never reached the limit.
    """
    n, contacts = len(start.grains.radius), start.contacts
    times = np.full(n, np.nan)
    at_limit = (contacts.mode == SLIDE) & (contacts.j >= n) & (np.arange(len(contacts.i)) < contacts.count[0])
    at_wall = events[(events["kind"] == "limit") & (events["j"] >= n)]
    for event in at_wall[::-1]:
        times[event["i"]] = event["time"]
    times[contacts.i[at_limit]] = start.time
    return times


def crossing_times(time: np.ndarray, displacement: np.ndarray, thresholds) -> np.ndarray:
    """Return the first time at which |displacement| (T, N) exceeds each threshold, shape (H, N).

    NaN if it never does.
    """
    beyond = np.abs(displacement)[None] > np.asarray(thresholds, float)[:, None, None]
    first = np.argmax(beyond, axis=1)
    return np.where(beyond.any(axis=1), time[first], np.nan)


def run_transition(
    state: State,
    law: Law,
    seed: int,
    *,
    velocity: float,
    duration: float,
    dt: float,
    sample: float,
    thresholds,
    drag=0.0,
    spin_drag=None,
) -> Transition:
    """Run the dynamics freely from an equilibrium perturbed by random velocities."""
    start = perturbed(state, seed, velocity)
    _, record, outcome = free_run(start, law, duration=duration, dt=dt, sample=sample, drag=drag, spin_drag=spin_drag)
    if outcome.broken:
        raise FloatingPointError(str(outcome))
    along = record.position[:, :, 0] - state.grains.position[:, 0]
    slide = crossing_times(record.time, along, thresholds) - state.time
    late = record.time - state.time >= duration * 2 / 3
    slides = late.sum() > 2 and bool((slide[np.argmax(thresholds)] < duration * 2 / 3).all())
    thin = slice(None, None, max(1, len(record.time) // 500))
    return Transition(
        breach_times(record.events, start) - state.time,
        slide,
        float(np.polyfit(record.time[late], record.center[late, 0], 1)[0]) if slides else np.nan,
        record.time[thin],
        record.center[thin, :2],
    )


def row_order(state: State, start: int, *, backward: bool = False):
    """Return the order of the disks from disk `start` along the row (or against it), and their distances [length]."""
    n, x = len(state.grains.radius), state.grains.position[:, 0]
    order = (start + np.arange(n)) % n if not backward else (start - np.arange(n)) % n
    gap = (x[order] - x[start]) * (-1 if backward else 1)
    return order, np.mod(gap + 1e-9, state.cell.vectors[0, 0]) - 1e-9


def fit_front(times: np.ndarray, order: np.ndarray, distance: np.ndarray, seed: int = 0) -> Front | None:
    """Fit a front to times of the same event, shape (realizations, N).

    Delays are counted from the disk where the front starts.

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Eq 9: V (τ_i − τ_start) = distance, for times averaged over realizations.
    """
    delay = times[:, order] - times[:, order[:1]]
    delay = delay[np.isfinite(delay).sum(axis=1) > 1]
    if len(delay) < 2 or len(order) < 2 or not np.isfinite(delay).any(axis=0).all():
        return None
    counted = np.isfinite(delay).sum(axis=0)
    mean = np.nanmean(delay, axis=0)
    error = np.nanstd(delay, axis=0) / np.sqrt(np.maximum(counted - 1, 1))
    rng = np.random.default_rng(seed)
    picks = rng.integers(0, len(delay), (BOOTSTRAPS, len(delay)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a resample may contain no delay for some disk
        resampled = np.nanmean(delay[picks], axis=1)
    resampled = resampled[np.isfinite(resampled).all(axis=1)]
    away = distance - distance.mean()
    free = away @ away / (resampled @ away)
    slope = np.polyfit(distance, mean, 1)[0]
    return Front(
        distance,
        mean,
        error,
        float(distance @ distance / (distance @ mean)),
        float(np.std(distance @ distance / (resampled @ distance))),
        float(1 / slope) if slope else np.inf,
        float(0.5 * np.subtract(*np.quantile(free, [0.84, 0.16]))),
        int(np.isfinite(delay).all(axis=1).sum()),
        len(delay),
    )
