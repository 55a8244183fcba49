"""Load histories: legs of constant velocity and normal stress, stated or derived from a measured displacement."""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ....kit import Series, checked, laboratory_table, readable, require_shape
from .ranges import Bounded, NotNegative, Positive, PositiveSeries


@readable
class LoadStep(NamedTuple):
    """One leg of a load history, with constant velocity of the load point."""

    duration: Positive  # [time]
    velocity: Bounded  # velocity of the load point; 0 in a hold [length/time]
    normal: Positive = 1.0  # normal stress over its reference value


@checked
def velocity_steps(velocities: PositiveSeries, *, distance: Positive) -> tuple[LoadStep, ...]:
    """Legs at successive velocities with equal load-point displacements.

    Parameters
    ----------
    velocities : [length/time] (K,)
    distance : [length] displacement of each leg

    Examples
    --------
    >>> velocity_steps([1e-6, 1e-5], distance=1e-4)[1]
    LoadStep: duration = 10; velocity = 1e-05; normal = 1
    """
    return tuple(LoadStep(float(distance / v), float(v)) for v in velocities)


@checked
def slide_hold_slide(
    holds: PositiveSeries, *, velocity: Positive, distance: Positive, reslide: Positive | None = None
) -> tuple[LoadStep, ...]:
    """Legs of a slide-hold-slide test that begins and ends with sliding.

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
    legs = [LoadStep(float(distance / velocity), float(velocity))]
    for hold in holds:
        legs += [LoadStep(float(hold), 0.0), LoadStep(float(distance / again), float(again))]
    return tuple(legs)


@checked
def load_steps(
    time: Series, load_point: Series, normal: PositiveSeries | None = None, *, roughness: NotNegative = 1e-3
) -> tuple[LoadStep, ...]:
    """Legs of a measured load-point displacement, interpolated linearly between samples.

    Successive intervals are merged into one leg as long as a straight line from its first sample stays close to all
    others: within `roughness` times the median displacement between moving samples. A motor at constant velocity
    thus gives one leg.

    Parameters
    ----------
    time : [time] (N,) increasing
    load_point : [length] (N,)
    normal : (N,) normal stress over its reference, constant from each sample to the next; None if it never changes
    """
    time, displacement = np.asarray(time, float), np.asarray(load_point, float)
    check_times(time)
    if displacement.shape != time.shape:
        raise ValueError(
            f"load_point must have one displacement per sample, got shapes {displacement.shape} and {time.shape}"
        )
    factor = np.ones(len(time)) if normal is None else np.asarray(normal, float)
    require_shape(time.shape, normal=factor)
    moved = np.abs(np.diff(displacement))
    slack = roughness * float(np.median(moved[moved > 0])) if (moved > 0).any() else 0.0
    legs, first = [], 0
    while first < len(time) - 1:
        last = _end_of_line(time, displacement, factor, first, slack)
        span = float(time[last] - time[first])
        legs.append(LoadStep(span, float(displacement[last] - displacement[first]) / span, float(factor[first])))
        first = last
    return tuple(legs)


def _end_of_line(time, place, factor, first: int, slack: float) -> int:
    """Last sample that a line from sample `first` can reach while staying within `slack` of all samples in between."""
    low, high, last = -np.inf, np.inf, first + 1
    for k in range(first + 1, len(time)):
        span, rise = time[k] - time[first], place[k] - place[first]
        if k > first + 1 and (not low <= rise / span <= high or factor[k - 1] != factor[first]):
            break
        low, high, last = max(low, (rise - slack) / span), min(high, (rise + slack) / span), k
    return last


def leg_arrays(legs) -> np.ndarray:
    """Durations, velocities and factors of the normal stress (3, L) of legs."""
    table = np.array([tuple(leg) for leg in legs], float).reshape(-1, 3)
    if len(table) == 0:
        raise ValueError("a load history needs at least one LoadStep(duration, velocity)")
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


CANDIDATES, SEARCHED = 400, 4000  # largest numbers of trial times for a velocity change, and of samples searched
MOST, ROUNDS = 60, 40  # largest numbers of velocity changes, and of iterations that refine their times
CERTAIN = 4.0  # required decrease of the sum of squares per change, over σ² ln N; BIC requires 2, for white noise
REST, EXACT = 4.0, 1e-9  # standard errors, and fraction of the largest velocity, below which a velocity counts as zero
OFF, CLEARLY = 0.03, 6.0  # departures that contradict a stated leg, over its length and over the noise
_LEG = re.compile(r"\s*(?:then\s+)?([-+.\deE]+)\s*([a-zµμ]*)(?:/(\w+))?\s*(?:until\s+([.\deE+-]+)\s*(\w*))?\s*")


@readable
class FoundSteps(NamedTuple):
    """Steps of constant velocity found in a noisy displacement."""

    legs: tuple[LoadStep, ...]
    noise: float  # standard deviation of the displacement around these steps [length]
    sentence: str


@checked
def stated_steps(text: str, time: Series) -> tuple[LoadStep, ...]:
    """Legs stated by the user, as in "1e-6 until 120 s, then 1e-5"; the last leg ends with the record.

    Parameters
    ----------
    text : load-point velocities, in m/s unless a unit is stated; each applies until a stated time, except the last
    time : (N,) times of the samples [s]

    Raises
    ------
    ValueError
        If the text does not have this form.

    Examples
    --------
    >>> legs = stated_steps("1 um/s until 2 min, then 1e-5", [0, 200])
    >>> [leg.duration for leg in legs]
    [120.0, 80.0]
    """
    return stated_legs("text", text, time)


def stated_legs(name: str, text: str, time) -> tuple[LoadStep, ...]:
    """Legs from the text of an argument; see `stated_steps`."""
    check_times(np.asarray(time, float))
    parts, legs, start, end = text.split(","), [], float(time[0]), float(time[-1])
    for k, part in enumerate(parts):
        match, last = _LEG.fullmatch(part), k == len(parts) - 1
        try:
            number, length, span, until, unit = match.groups() if match else (None,) * 5
            velocity = float(number) * laboratory_table.LENGTH[length or "m"] / laboratory_table.TIME[span or "s"]
            stop = end if last and until is None else float(until) * laboratory_table.TIME[unit or "s"]
        except (TypeError, ValueError, KeyError):
            raise ValueError(
                f"{name}: expected velocities and times as in '1e-6 until 120 s, then 10 um/s', got {part.strip()!r}"
            ) from None
        if not start < stop <= end:
            raise ValueError(
                f"{name}: a leg ends at {stop:g} s: it must end after {start:g} s and within the {end:g} s recorded"
            )
        legs.append(LoadStep(stop - start, velocity))
        start = stop
    if start < end:
        raise ValueError(
            f"{name} ends at {start:g} s, but the record ends at {end:g} s: add the rest, or leave out 'until'"
        )
    return tuple(legs)


@checked
def find_steps(time: Series, load_point: Series) -> FoundSteps:
    """Steps of constant velocity in a noisy displacement of the load point.

    A continuous, piecewise linear curve is fitted by least squares. Changes of velocity are added one by one where they
    lower the sum of squares most, as long as the decrease is far larger than noise explains. All times of change are
    then refined together. Velocities that are zero within their errors become holds.

    Parameters
    ----------
    time : (N,) increasing [time]
    load_point : (N,) [length]
    """
    time, displacement = np.asarray(time, float), np.asarray(load_point, float)
    check_times(time)
    thin = max(1, -(-len(time) // SEARCHED))
    require_shape(np.shape(time), load_point=displacement)
    sparse, rough = time[::thin], displacement[::thin]
    worth = CERTAIN * np.log(len(time)) * float(np.mean(np.diff(displacement, 2) ** 2)) / 6
    changes = np.zeros(0)
    while len(changes) < MOST:
        gain, best = _best_change(sparse, rough, changes)
        if gain * thin < worth:
            break
        changes = _refine(sparse, rough, np.sort(np.append(changes, best)))
    changes = _without_needless(
        time, displacement, _refine(time, displacement, changes) if thin > 1 else changes, worth
    )
    basis = _pieces(time, changes)
    slopes, *_ = np.linalg.lstsq(basis, displacement, rcond=None)
    rest = displacement - basis @ slopes
    noise = float(np.sqrt(rest @ rest / max(len(time) - 2 * len(changes) - 2, 1)))
    error = noise * np.sqrt(np.diag(np.linalg.pinv(basis.T @ basis)))
    least = np.maximum(REST * error[1:], EXACT * np.abs(slopes[1:]).max())
    velocity = np.where(np.abs(slopes[1:]) < least, 0.0, slopes[1:])
    legs = tuple(map(LoadStep, np.diff([time[0], *changes, time[-1]]).tolist(), velocity.tolist()))
    text = steps_text(legs, time)
    return FoundSteps(legs, noise, f'the load point has noise of {noise:.2g}; its velocity is assumed to be "{text}"')


def steps_text(legs: Sequence[LoadStep], time: np.ndarray) -> str:
    """Legs in the syntax of `stated_steps`, with times on the clock of the samples."""
    digits = max(0, 3 - int(np.floor(np.log10(np.median(np.diff(time))))))
    ends = time[0] + np.cumsum([leg.duration for leg in legs])[:-1]
    parts = [f"{leg.velocity:.6g} until {end:.{digits}f}" for leg, end in zip(legs, ends, strict=False)]
    return ", then ".join([*parts, f"{legs[-1].velocity:.6g}"])


def contradiction(legs: Sequence[LoadStep], time: np.ndarray, place: np.ndarray) -> str:
    """Sentence about the stated leg that a measured displacement contradicts most; empty if no leg is contradicted.

    A leg is contradicted if the displacement departs from the stated line by more than 3 % of the leg's length and by
    more than its noise.
    """
    noise = float(np.sqrt(np.mean(np.diff(place, 2) ** 2) / 6)) if len(place) > 2 else 0.0
    start, worst, told = float(time[0]), OFF, ""
    for leg in legs:
        end = start + leg.duration
        rows = (time >= start) & (time <= end)
        if rows.sum() > 1:
            t, x = time[rows], place[rows] - place[rows][0]
            apart = np.abs(x - leg.velocity * (t - t[0]))
            way = max(abs(leg.velocity) * (t[-1] - t[0]), np.abs(x).max())
            share = float(apart.max()) / way if apart.max() > CLEARLY * noise else 0.0
            if share > worst:
                k = int(apart.argmax())
                said = f"--velocity states {leg.velocity:g} m/s from {start:g} to {end:g} s, but the load point"
                way = leg.velocity * (t[k] - t[0])
                worst, told = share, f"{said} moved by {x[k]:.4g} m until {t[k]:g} s instead of {way:.4g} m"
                if way and (unit := laboratory_table.unit_of_time(x[k] / way)):
                    told += f", as if the times were in {unit}"
        start = end
    return told


def _pieces(time: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Basis (N, K + 2) of piecewise linear curves: a constant, and the time spent in each of the K + 1 pieces."""
    edges = np.array([time[0], *changes, time[-1]])
    spent = [np.clip(time, low, high) - low for low, high in pairwise(edges)]
    return np.stack([np.ones(len(time)), *spent], axis=1)


def _best_change(time: np.ndarray, place: np.ndarray, changes: np.ndarray) -> tuple[float, float]:
    """Largest decrease of the sum of squares by one more change of velocity, and the time of this change."""
    q, _ = np.linalg.qr(_pieces(time, changes))
    rest = place - q @ (q.T @ place)
    tried = time[np.unique(np.linspace(2, len(time) - 3, CANDIDATES).astype(int))]
    bends = np.maximum(time[:, None] - tried, 0.0)
    bends -= q @ (q.T @ bends)
    size = (bends**2).sum(axis=0)
    gain = np.where(size > 1e-9 * size.max(initial=1e-300), (rest @ bends) ** 2 / np.maximum(size, 1e-300), 0.0)
    return float(gain.max(initial=0.0)), float(tried[int(gain.argmax())])


def _without_needless(time: np.ndarray, place: np.ndarray, changes: np.ndarray, worth: float) -> np.ndarray:
    """Remove changes of velocity that become unnecessary when the others are shifted."""
    while len(changes):
        fewer = [_refine(time, place, np.delete(changes, k)) for k in range(len(changes))]
        sums = [_misfit(time, place, rest) for rest in fewer]
        least = int(np.argmin(sums))
        if sums[least] - _misfit(time, place, changes) > worth:
            break
        changes = fewer[least]
    return changes


def _misfit(time: np.ndarray, place: np.ndarray, changes: np.ndarray) -> float:
    """Sum of squared deviations from the best curve with given times of change."""
    basis = _pieces(time, changes)
    basis /= np.abs(basis).max(axis=0)
    square = np.einsum("ni,nj->ij", basis, basis)  # with so few columns, QR decomposition takes many times longer
    rest = place - basis @ np.linalg.solve(square, np.einsum("ni,n->i", basis, place))
    return float(rest @ rest)


def _refine(time: np.ndarray, place: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Times of change at which the lines fitted to neighbouring pieces meet.

    These times have the same limiting distribution as those of the best continuous curve (Feder,
    doi:10.1214/aos/1176342999).
    """
    for _ in range(ROUNDS if len(changes) else 0):
        edges = np.array([time[0], *changes, time[-1]])
        room = 0.45 * np.minimum(np.diff(edges)[:-1], np.diff(edges)[1:])
        piece = np.searchsorted(changes, time)
        since = time - time[0]
        sums = np.ones(len(time)), since, place, since**2, since * place
        count, t, x, tt, tx = (np.bincount(piece, values, len(edges) - 1) for values in sums)
        spread = count * tt - t**2
        slope = np.divide(count * tx - t * x, spread, out=np.zeros_like(t), where=(count > 1) & (spread > 0))
        height = np.divide(x - slope * t, count, out=np.zeros_like(t), where=count > 0)
        bend, gap = np.diff(slope), -np.diff(height)
        meets = time[0] + np.divide(gap, bend, out=changes - time[0], where=(bend != 0) & (np.diff(count > 1) == 0))
        moved = np.clip(meets, changes - room, changes + room)
        if np.allclose(moved, changes, rtol=1e-12, atol=0):
            break
        changes = moved
    return changes


def with_normal(legs: tuple[LoadStep, ...], time: np.ndarray, factor: np.ndarray) -> tuple[LoadStep, ...]:
    """Cut legs where the normal stress changes; the stress is constant from each sample to the next.

    Parameters
    ----------
    time : (N,) from the start of the legs [time]
    factor : (N,) normal stress over its reference
    """
    ends = np.cumsum([leg.duration for leg in legs])
    cuts = time[1:][np.diff(factor) != 0]
    edges = np.unique(np.concatenate([[0.0], ends, cuts[cuts < ends[-1]]]))
    middle = 0.5 * (edges[1:] + edges[:-1])
    velocity = [legs[min(k, len(legs) - 1)].velocity for k in np.searchsorted(ends, middle)]
    held = factor[np.maximum(np.searchsorted(time, middle, side="right") - 1, 0)]
    return tuple(map(LoadStep, np.diff(edges).tolist(), velocity, held.tolist()))
