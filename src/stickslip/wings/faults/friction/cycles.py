"""Stick–slip cycles in a record of slip velocity: events, recurrence, and slip against the time since an event."""

import numpy as np

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
