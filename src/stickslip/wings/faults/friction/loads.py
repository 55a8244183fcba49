"""Load histories: legs of constant load-point velocity and constant normal stress."""

from typing import NamedTuple

import numpy as np

from ....kit import Series, checked, readable, require_positive, require_shape


@readable
class LoadStep(NamedTuple):
    """One leg of a load history, with constant velocity of the load point."""

    duration: float  # [time]
    velocity: float  # of the load point; 0 in a hold [length/time]
    normal: float = 1.0  # normal stress over its reference value


@checked
def velocity_steps(velocities: Series, *, distance: float) -> tuple[LoadStep, ...]:
    """Legs at successive velocities, each over the same load-point displacement.

    Parameters
    ----------
    velocities : [length/time] (K,), positive
    distance : [length] of each leg

    Examples
    --------
    >>> velocity_steps([1e-6, 1e-5], distance=1e-4)[1]
    LoadStep: duration = 10; velocity = 1e-05; normal = 1
    """
    require_positive(distance=distance)
    for v in velocities:
        require_positive(velocity=v)
    return tuple(LoadStep(float(distance / v), float(v)) for v in velocities)


@checked
def slide_hold_slide(
    holds: Series, *, velocity: float, distance: float, reslide: float | None = None
) -> tuple[LoadStep, ...]:
    """Legs of a slide-hold-slide test, which begins and ends with sliding.

    Parameters
    ----------
    holds : [time] (K,) durations of the holds
    velocity : [length/time] before the first hold, and after each if `reslide` is None
    distance : [length] load-point displacement between holds
    reslide : [length/time] velocity after each hold

    Examples
    --------
    >>> legs = slide_hold_slide([1.0, 10.0], velocity=1e-5, distance=1e-4)
    >>> [leg.velocity for leg in legs]
    [1e-05, 0.0, 1e-05, 0.0, 1e-05]
    """
    again = velocity if reslide is None else reslide
    require_positive(velocity=velocity, reslide=again, distance=distance)
    legs = [LoadStep(float(distance / velocity), float(velocity))]
    for hold in holds:
        require_positive(hold=hold)
        legs += [LoadStep(float(hold), 0.0), LoadStep(float(distance / again), float(again))]
    return tuple(legs)


@checked
def load_steps(
    time: Series, load_point: Series, normal: Series | None = None, *, roughness: float = 1e-3
) -> tuple[LoadStep, ...]:
    """Legs of a measured load-point displacement, which is interpolated linearly between samples.

    Neighbouring intervals are merged into one leg as long as a straight line from its first sample passes all others to
    within `roughness` times the median displacement between (moving) samples, so that a motor at constant velocity is
    one leg.

    Parameters
    ----------
    time : [time] (N,) increasing
    load_point : [length] (N,)
    normal : (N,) normal stress over its reference, held from each sample to the next; None if constant
    """
    time, place = np.asarray(time, float), np.asarray(load_point, float)
    check_times(time)
    if place.shape != time.shape:
        raise ValueError(f"load_point has shape {place.shape}, time {time.shape}: give one displacement per sample")
    factor = np.ones(len(time)) if normal is None else np.asarray(normal, float)
    require_shape(time.shape, normal=factor)
    moved = np.abs(np.diff(place))
    slack = roughness * float(np.median(moved[moved > 0])) if (moved > 0).any() else 0.0
    legs, first = [], 0
    while first < len(time) - 1:
        last = _end_of_line(time, place, factor, first, slack)
        span = float(time[last] - time[first])
        legs.append(LoadStep(span, float(place[last] - place[first]) / span, float(factor[first])))
        first = last
    return tuple(legs)


def _end_of_line(time, place, factor, first: int, slack: float) -> int:
    """Last sample that a straight line from sample `first` can reach within `slack` of every sample between them."""
    low, high, last = -np.inf, np.inf, first + 1
    for k in range(first + 1, len(time)):
        span, rise = time[k] - time[first], place[k] - place[first]
        if k > first + 1 and (not low <= rise / span <= high or factor[k - 1] != factor[first]):
            break
        low, high, last = max(low, (rise - slack) / span), min(high, (rise + slack) / span), k
    return last


def leg_arrays(legs) -> np.ndarray:
    """Check legs and return their durations, velocities and normal factors (3, L)."""
    try:
        table = np.array([tuple(leg) for leg in legs], float).reshape(-1, 3)
    except (TypeError, ValueError):
        raise ValueError("a leg holds something other than numbers: give LoadStep(duration, velocity)") from None
    if len(table) == 0:
        raise ValueError("no legs were given: a load history needs at least one LoadStep(duration, velocity)")
    for k, (duration, velocity, normal) in enumerate(table, start=1):
        if not (duration > 0 and np.isfinite(duration)):
            raise ValueError(f"leg {k} lasts {duration:g}: every leg needs a positive duration")
        if not np.isfinite(velocity):
            raise ValueError(f"leg {k} has the velocity {velocity:g}: give a finite one, 0 for a hold")
        if not (normal > 0 and np.isfinite(normal)):
            raise ValueError(f"leg {k} has {normal:g} times the normal stress: give a positive factor")
    return np.ascontiguousarray(table.T)


def check_times(time) -> None:
    """Raise ValueError unless times are finite and strictly increasing."""
    if time.ndim != 1 or len(time) < 2:
        raise ValueError(f"time has shape {time.shape}: give a one-dimensional array of at least two times")
    wrong = np.flatnonzero(~np.isfinite(time))
    if len(wrong):
        raise ValueError(f"time {wrong[0] + 1} of {len(time)} is {time[wrong[0]]}: give finite times")
    wrong = np.flatnonzero(np.diff(time) <= 0)
    if len(wrong):
        k = wrong[0]
        raise ValueError(
            f"time must increase, but sample {k + 2} ({time[k + 1]:g}) is not later than sample {k + 1} ({time[k]:g}): "
            "sort the samples and remove duplicates"
        )
