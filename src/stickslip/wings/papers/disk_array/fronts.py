"""Free runs of a row of disks and its transition to dynamic friction: slip times and front speeds.

Newtonian dynamics starts from equilibria on the load path of the array.
"""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from .... import SLIDE, Law, NotInEquilibriumError, State
from ....kit import Engine, Growth, Leg, builtin, own_engine
from ....modes import damped_growth
from ....packings import perturbed
from ....protocols import fit_growth, free_run
from ....results import Equilibrium
from .scenario import DiskArrayScenario, Dynamics

BOOTSTRAPS = 1000
AROUND = 200  # number of samples before and after a time that are averaged: 20 periods of the fastest mode each


class Transition(NamedTuple):
    """One realisation of the transition; times of events that did not happen are NaN."""

    breach: np.ndarray  # (N,) time when each disk's contact with the substrate first reaches the Coulomb limit [time]
    slide: np.ndarray  # (H, N) first time at which a disk has moved along the row by each threshold [time]
    # velocity of the centre of mass over the last third of the run; NaN unless all disks slid earlier [length/time]
    velocity: float  # [length/time]
    wall_first: float  # 1 if the first contact at the Coulomb limit is with the substrate, 0 if not; NaN if none
    msd_at_breach: float  # M when the first contact with the substrate reaches the Coulomb limit [length²]
    unloading: np.ndarray  # (N,) overlap with the substrate at the breach of each disk, over that before the run
    power: float  # p in M ∝ (t − t_b)^p over the last third of the run, t_b the first breach; NaN unless all disks slid
    late_velocity: np.ndarray  # (2,) `velocity` in each half of the last third [length/time]
    late_height: np.ndarray  # (2,) standard deviation of the centre's height in each half of the last third [length]
    # the following use displacements along the row, averaged over `AROUND` samples before and after
    smooth_slide: np.ndarray  # (H, N) first time at which averaged displacements exceed each threshold [time]
    profile: np.ndarray  # (H, N) displacements minus their mean when the mean passes each threshold [length]
    drift: np.ndarray  # (H,) velocity of the mean displacement at that time [length/time]
    time: np.ndarray  # (S,) [time]
    center: np.ndarray  # (S, 2) centre of mass [length]


class Front(NamedTuple):
    """Front fitted to the mean times at each disk: distance = speed × time, through its start (Eq 9)."""

    distance: np.ndarray  # (N,) distance from the disk where the front starts [length]
    delay: np.ndarray  # (N,) mean time after the start of the front [time]
    error: np.ndarray  # (N,) standard error of the mean [time]
    speed: float  # [length/time]
    speed_error: float  # standard deviation in a bootstrap over realisations [length/time]
    free_intercept: float  # speed by regression of time on distance without fixing the start [length/time]
    free_error: float  # half the central 68 % interval in this bootstrap, as 1/slope has long tails [length/time]
    complete: int  # number of realisations in which the event happened at every disk
    counted: int  # number of realisations included in the fit


def breach_times(events: np.ndarray, start: State) -> np.ndarray:
    """Return the first time at which each grain's contact with a wall reached the Coulomb limit, shape (N,).

    This is the time of `start`, the state before the run, if the contact was at the limit from the beginning, and NaN
    if the contact never reached the limit.
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

    The time is NaN if |displacement| never exceeds the threshold.
    """
    beyond = np.abs(displacement)[None] > np.asarray(thresholds, float)[:, None, None]
    first = np.argmax(beyond, axis=1)
    return np.where(beyond.any(axis=1), time[first], np.nan)


def run_transition(
    state: State, law: Law, seed: int, *, velocity: float, duration: float, dt: float, sample: float, thresholds,
    drag=0.0, spin_drag=None, engine: Engine | None = None,
) -> Transition:  # fmt: skip
    """Run the dynamics freely from an equilibrium perturbed by random velocities."""
    start, every = perturbed(state, seed, velocity), max(1, round(sample / dt))
    leg = Leg(start, law, dt, round(duration / dt), every=every, detailed=True, drag=drag, spin_drag=spin_drag)
    run = _run_in_pieces(leg, engine or own_engine()._replace(samples=leg.steps))
    along, time = run.along - state.grains.position[:, 0], run.time - state.time
    smooth = uniform_filter1d(along, 2 * AROUND + 1, axis=0, mode="nearest")
    slide = crossing_times(time, along, thresholds)
    late = time >= duration * 2 / 3
    slides = late.sum() > 4 and bool((slide[np.argmax(thresholds)] < duration * 2 / 3).all())
    breach = breach_times(run.events, start) - state.time
    limits = run.events["j"][run.events["kind"] == "limit"]
    thin = slice(None, None, max(1, len(time) // 500))
    return Transition(
        breach,
        slide,
        velocity_of(time[late], run.center[late, 0]) if slides else np.nan,
        float(limits[0] >= along.shape[1]) if len(limits) else np.nan,
        float(np.interp(np.nanmin(breach), time, run.msd)) if np.isfinite(breach).any() else np.nan,
        unloading(state, time, run.height, breach),
        msd_power(time[late], run.msd[late], breach) if slides else np.nan,
        *(late_halves(time[late], run.center[late]) if slides else np.full((2, 2), np.nan)),
        crossing_times(time, smooth, thresholds),
        *drift_profile(time, smooth, thresholds),
        run.time[thin].copy(),  # copies, because views would keep the whole record in memory
        run.center[thin].copy(),
    )


class _Run(NamedTuple):
    """Motion of an array at T samples, and its contact events."""

    time: np.ndarray  # (T,)
    msd: np.ndarray  # (T,) M relative to the positions at the start of the run
    center: np.ndarray  # (T, 2)
    along: np.ndarray  # (T, N)
    height: np.ndarray  # (T, N)
    events: np.ndarray


def _run_in_pieces(leg: Leg, engine: Engine) -> _Run:
    """Run a leg in pieces, each with as many samples as the engine returns at once."""
    state, parts, left = leg.state, [], leg.steps
    while left or not parts:
        steps = min(left, engine.samples * leg.every)
        ((state, record),) = engine.pieces(leg._replace(state=state, steps=steps))
        position, new = record.position, slice(1 if parts else 0, None)
        way = position - leg.state.grains.position
        parts.append(
            _Run(
                record.time[new], (way**2).sum(axis=(1, 2))[new], record.center[new, :2], position[new, :, 0],
                position[new, :, 1], record.events,
            )
        )  # fmt: skip
        left -= steps
    return _Run(*map(np.concatenate, zip(*parts, strict=True)))


def velocity_of(time: np.ndarray, position: np.ndarray) -> float:
    """Velocity as the slope of a line fitted to a position against time [length/time]."""
    return float(np.polyfit(time, position, 1)[0])


def unloading(state: State, time: np.ndarray, height: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Overlap (N,) of each disk with the substrate at its time `at`, over that in `state`; NaN where `at` is NaN."""
    radius, before = state.grains.radius, state.grains.position[:, 1]
    then = [np.interp(t, time, y) if np.isfinite(t) else np.nan for t, y in zip(at, height.T, strict=True)]
    return np.maximum(radius - then, 0.0) / (radius - before)


def msd_power(time: np.ndarray, msd: np.ndarray, breach: np.ndarray) -> float:
    """Exponent p of M ∝ (t − t_b)^p, with t_b the first of the times `breach`; NaN unless all times are later."""
    first = np.nanmin(breach) if np.isfinite(breach).any() else np.inf
    return velocity_of(np.log(time - first), np.log(msd)) if time[0] > first else np.nan


def late_halves(time: np.ndarray, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity along the row and standard deviation of the height of the centre of mass, in each half of a run."""
    halves = np.array_split(np.arange(len(time)), 2)
    velocity = np.array([velocity_of(time[half], center[half, 0]) for half in halves])
    return velocity, np.array([center[half, 1].std() for half in halves])


def drift_profile(time: np.ndarray, smooth: np.ndarray, thresholds) -> tuple[np.ndarray, np.ndarray]:
    """Displacements minus their mean (H, N), and velocity of the mean (H,), when the mean passes each threshold.

    Values are NaN unless the run contains the `AROUND` samples before and after that time that determine the velocity.
    """
    mean = smooth.mean(axis=1)
    profile, drift = np.full((len(thresholds), smooth.shape[1]), np.nan), np.full(len(thresholds), np.nan)
    for k, threshold in enumerate(thresholds):
        n = int(np.argmax(np.abs(mean) > threshold))  # 0 if it never passes
        if AROUND <= n < len(mean) - AROUND:
            profile[k] = smooth[n] - mean[n]
            drift[k] = (mean[n + AROUND] - mean[n - AROUND]) / (time[n + AROUND] - time[n - AROUND])
    return profile, drift


def row_order(state: State, start: int, *, backward: bool = False):
    """Return the order of the disks from disk `start` along the row (or against it), and their distances [length]."""
    n, x = len(state.grains.radius), state.grains.position[:, 0]
    order = (start + np.arange(n)) % n if not backward else (start - np.arange(n)) % n
    gap = (x[order] - x[start]) * (-1 if backward else 1)
    return order, np.mod(gap + 1e-9, state.cell.vectors[0, 0]) - 1e-9


def drift_speed(
    profile: np.ndarray, drift: np.ndarray, order: np.ndarray, distance: np.ndarray, seed: int = 0
) -> tuple[float, float] | None:
    """Speed of the front formed by disks that keep their displacements u_i (S, N) while they drift at speeds V (S,).

    Disk i passes a threshold later than the disk where the front starts, by (u_start − u_i)/V. Delays follow from the
    means of u_i and V over realisations; a line through the start is fitted to them, as in `fit_front`. The error is
    from a bootstrap over realisations. None with fewer than two realisations.
    """
    whole = np.isfinite(profile).all(axis=1) & np.isfinite(drift)
    profile, drift = profile[whole][:, order], drift[whole]
    if len(drift) < 2:
        return None
    picks = np.random.default_rng(seed).integers(0, len(drift), (BOOTSTRAPS, len(drift)))
    picks[0] = np.arange(len(drift))
    mean = profile[picks].mean(axis=1)
    delay = (mean[:, :1] - mean) / drift[picks].mean(axis=1)[:, None]
    speeds = distance @ distance / (delay @ distance)
    return float(speeds[0]), float(speeds.std())


def fit_front(times: np.ndarray, order: np.ndarray, distance: np.ndarray, seed: int = 0) -> Front | None:
    """Fit a front to the times of the same event (realisations, N).

    Delays are counted from the disk where the front starts.

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Eq 9: V (τ_i − τ_start) = distance, for times averaged over realisations.
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
        distance, mean, error, float(distance @ distance / (distance @ mean)),
        float(np.std(distance @ distance / (resampled @ distance))), float(1 / slope) if slope else np.inf,
        float(0.5 * np.subtract(*np.quantile(free, [0.84, 0.16]))), int(np.isfinite(delay).all(axis=1).sum()),
        len(delay),
    )  # fmt: skip


SLIDING_THRESHOLD = 0.1  # the array slides once every disk has moved by this many mean diameters


class FreeRun(NamedTuple):
    """Newtonian dynamics from the equilibrium at one load."""

    load: float
    time: np.ndarray  # (T,) [time]
    msd: np.ndarray  # (T,) M(t) = Σ|Δr|² [length²]
    center: np.ndarray  # (T, 2) [length]
    kinetic_energy: np.ndarray  # (T,) [energy]
    touching: np.ndarray  # (T,) number of touching contacts
    breach: np.ndarray  # (N,) first time at which each wall contact is at the Coulomb limit; NaN if never [time]
    first_limit: np.ndarray  # (3,) time, i, j of the first contact anywhere to reach the Coulomb limit; NaN if none
    predicted_growth: float  # ω_i of the fastest-growing mode, with drag and dashpots [1/time]
    predicted_frequency: float  # [1/time]
    growth: Growth | None
    saturation: float  # mean of M over the second half of the run [length²]
    slid: bool


class Trajectory(NamedTuple):
    """Finely sampled motion of all disks around the transition."""

    load: float
    time: np.ndarray  # (T,) [time]
    position: np.ndarray  # (T, N, 2) [length]
    angle: np.ndarray  # (T, N) [rad]
    first_limit: float  # first time at which any contact reached the Coulomb limit
    breach: np.ndarray  # (N,) [time]
    slide: np.ndarray  # (N,) first time at which each disk has moved by SLIDING_THRESHOLD diameters [time]


def diameter(state: State) -> float:
    """Mean diameter of the grains, used as the unit of displacements [length]."""
    return 2 * float(state.grains.radius.mean())


def fastest_period(point: Equilibrium) -> float:
    """Period of the fastest mode, used as the unit of sampling [time]."""
    return 2 * np.pi / float(point.spectrum.frequency.max())


def predicted_growth(point: Equilibrium, law: Law, how: Dynamics) -> tuple[float, float]:
    """Growth rate and frequency of the fastest-growing mode of a free run, with drag and dashpots [1/time]."""
    if how.drag or how.spin_drag or builtin.damping_model(law):
        fastest = damped_growth(point.state, law, drag=how.drag, spin_drag=how.spin_drag)[0]
        return max(0.0, float(fastest.real)), abs(float(fastest.imag))
    modes = point.spectrum
    k = int(np.argmax(modes.growth_rate))
    return float(modes.growth_rate[k]), float(modes.frequency[k])


def check_time_step(point: Equilibrium, dt: float) -> None:
    """Raise ValueError if velocity Verlet cannot follow the fastest mode."""
    longest = 2 / float(point.spectrum.frequency.max())
    if dt >= longest:
        raise ValueError(
            f"dynamics.dt = {dt:g} is too long at push = {point.load:g}: velocity Verlet is unstable above "
            f"{longest:.3g}; use at most {0.2 * longest:.1g}"
        )


def run_free(point: Equilibrium, law: Law, scenario: DiskArrayScenario) -> FreeRun:
    """Run Newtonian dynamics from an equilibrium with tiny random velocities."""
    how = scenario.dynamics
    check_time_step(point, how.dt)
    start = perturbed(point.state, scenario.seed, how.seed_velocity)
    _, record, outcome = free_run(start, law, duration=how.duration, sample=fastest_period(point) / 5, **how.options)
    if outcome.broken:
        raise NotInEquilibriumError(f"the free run at push = {point.load:g} diverged", outcome)
    rate, frequency = predicted_growth(point, law, how)
    growth = None
    if rate > 0 and frequency > 0:
        scale = diameter(start) ** 2
        growth = fit_growth(record.time, record.msd / scale, growth_rate=rate, frequency=frequency)
    late = record.time >= record.time[0] + 0.5 * how.duration
    moved = np.abs(record.position[-1, :, 0] - start.grains.position[:, 0])
    limits = record.events[record.events["kind"] == "limit"][:1]
    first = np.array([[e["time"], e["i"], e["j"]] for e in limits], float).reshape(-1, 3)
    return FreeRun(
        point.load, record.time, record.msd, record.center[:, :2], record.kinetic_energy, record.touching,
        breach_times(record.events, start), first[0] if len(first) else np.full(3, np.nan), rate, frequency, growth,
        float(record.msd[late].mean()), bool((moved > SLIDING_THRESHOLD * diameter(start)).all()),
    )  # fmt: skip


def resample_transition(point: Equilibrium, law: Law, scenario: DiskArrayScenario, known: FreeRun) -> Trajectory | None:
    """Repeat a free run, bit for bit, with fine sampling from before the first slip until well after sliding begins."""
    if not (np.isfinite(known.breach).any() and np.isfinite(known.first_limit[0])):
        return None
    how = scenario.dynamics
    period = fastest_period(point)
    begin = max(0.0, float(known.first_limit[0]) - 30 * period)
    start = perturbed(point.state, scenario.seed, how.seed_velocity)
    before, _, _ = free_run(start, law, duration=begin, sample=how.duration, **how.options)
    length = min(how.duration - begin, 600 * period)
    _, record, _ = free_run(before, law, duration=length, sample=period / 20, **how.options)
    along = record.position[:, :, 0] - point.state.grains.position[:, 0]
    slide = crossing_times(record.time, along, [SLIDING_THRESHOLD * diameter(point.state)])[0]
    return Trajectory(
        point.load, record.time, record.position[:, :, :2], record.angle[:, :, 2], float(known.first_limit[0]),
        known.breach, slide,
    )  # fmt: skip
