"""Kinetic threshold: loads at which kicked samples start to slide, continue to slide, and stop.

A sample at rest under a load is kicked with random velocities and runs freely. It has *slid* once it has moved by a
given distance under its load within the duration of a run (see `travel`). A run that has slid continues for the same
duration again. It *lasts* if it moves on by that distance, and by a quarter of it in each quarter of that time;
otherwise, the sample has slid by a limited distance only. Near the threshold, sliding samples stop at random times, so
fewer runs last for longer durations. The fractions of runs that slide and of runs that last rise with the load; a
logistic curve is fitted to each by maximum likelihood. Runs have independent random numbers, as the likelihood
requires.
"""

from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from ..core.arguments import NotNegative, Positive, checked
from ..core.contacts.neighbors import TooFarApartError
from ..core.dynamics.coefficients import driven_bodies
from ..core.dynamics.run import check_time_step, run
from ..core.laws.builtin import Law
from ..core.progress import NotInEquilibriumError, Report, Size, require_sizes, silent
from ..core.readable import readable
from ..core.scales import natural_scales
from ..core.state import SLIDE, State
from ..data.checkpoint import Checkpoint, load_or_compute
from ..ensemble import Workers, run_members
from ..solve.balance import BALANCED_BELOW, force_imbalance, linearised, motion_imbalance
from .packing import reduced_cell, wrapped
from .protocols import Equilibrium, Protocol, perturbed

KICK_LEGS = 40  # number of parts of a run; sliding is checked after each
WINDOWS = 4  # number of parts of a duration; in each, a lasting run moves by a part of the distance
FAR = 8  # grains are put back into the cell when a pair is this many periodic boxes apart; the limit is 64
SLOWING = 0.95  # ratio of the travel in the last window to that in the first, below which a sample still slows down
KICKS = (1e-13, 1e-4)  # default kicks, in natural units
SLID = 0.1  # distance that counts as sliding, as in `travel`
FINE, WIDTHS = 60, 80  # numbers of thresholds between two loads, and of widths, in the table of the likelihood
BEYOND, WIDEST = 5, 50  # largest distance of a trial threshold from the loads and largest width, in load ranges
DROP = 1.92  # drop of the log-likelihood at the ends of a 95 % interval (half of the quantile 3.84 of χ² with 1 degree)


@readable(head=lambda threshold: "; ".join(threshold.sentences))
class KineticThreshold(NamedTuple):
    """Outcomes of kicks at several loads, the thresholds fitted to them, and the static thresholds of the same path."""

    loads: np.ndarray  # (L,)
    kicks: np.ndarray  # (K,) standard deviation of the initial velocities [length/time]
    slid: np.ndarray  # (L, K) number of runs that moved by `distance` within `duration`
    runs: np.ndarray  # (L, K) number of runs
    lifetime: np.ndarray  # (L, K) median over all runs of the time until they had slid; NaN unless most slid [time]
    threshold: np.ndarray  # (K,) load at which half of the runs slide; NaN if the loads do not bracket it
    interval: np.ndarray  # (K, 2) 95 % interval by the likelihood ratio; infinite where the loads do not bound it
    width: np.ndarray  # (K,) width of the logistic curve 1/(1 + exp(−(load − threshold)/width))
    arrest: np.ndarray  # (R, 2) load at which the sample stopped in each ramp down (−inf: none), and the next one above
    first_pair: float  # smallest load on the path with a complex pair; NaN if there is none
    first_limit: float  # smallest load on the path at which a contact is at the Coulomb limit; NaN if there is none
    duration: float  # duration of a run [time]
    distance: float  # distance that counts as sliding, as in `travel`
    lasting: np.ndarray  # (L, K) number of runs that lasted: they slid and continued for another `duration`
    lasting_threshold: np.ndarray  # (K,) load at which half of the runs last: the kinetic threshold proper
    lasting_interval: np.ndarray  # (K, 2)
    lasting_width: np.ndarray  # (K,)

    @property
    def probability(self) -> np.ndarray:
        """(L, K) share of the runs that slid."""
        return self.slid / self.runs

    @property
    def lasting_probability(self) -> np.ndarray:
        """(L, K) share of the runs that lasted."""
        return self.lasting / self.runs

    @property
    def arrest_range(self) -> tuple[float, float]:
        """Lowest and highest end of the brackets of all ramps down; NaN if there are none."""
        return (float(self.arrest[:, 0].min()), float(self.arrest[:, 1].max())) if len(self.arrest) else (np.nan,) * 2

    @property
    def sentences(self) -> list[str]:
        """Thresholds in words."""
        sentences, slides, lasts = [], f"slide by {self.distance:g}", f"keep sliding for another {self.duration:g}"
        for k, kick in enumerate(self.kicks):
            rise = _describe_rise(slides, self.threshold[k], self.interval[k], self.probability[:, k])
            if self.slid[:, k].any():
                at, interval = self.lasting_threshold[k], self.lasting_interval[k]
                rise += f" and {_describe_rise(lasts, at, interval, self.lasting_probability[:, k])}"
            sentences.append(f"runs from velocities of {kick:.3g} {rise}")
        sentences += _describe_arrest(self)
        for name, load in (("complex pair", self.first_pair), ("contact at the limit", self.first_limit)):
            sentences.append(f"first {name} at {load:.4g}" if np.isfinite(load) else f"no {name}")
        return sentences


def _describe_rise(verb: str, at: float, interval, share) -> str:
    """Load from which runs slide or last, in words."""
    if np.isfinite(at):
        return f"{verb} from {at:.4g} (95 %: {interval[0]:.4g} to {interval[1]:.4g})"
    if share.min() == share.max() and share.max() in (0, 1):
        return f"{'always' if share.max() else 'never'} {verb}"
    return f"{verb} from a load that is not bracketed by these loads"


def _describe_arrest(threshold: KineticThreshold) -> list[str]:
    """Outcome of the ramps down, in words."""
    count, stopped = len(threshold.arrest), np.isfinite(threshold.arrest[:, 0])
    if not count:
        return [] if threshold.lasting.any() else ["no run keeps sliding, so the load cannot be lowered"]
    lines = []
    if stopped.any():
        low, high = threshold.arrest[stopped, 0].min(), threshold.arrest[stopped, 1].max()
        lines.append(f"{stopped.sum()} of {count} sliding samples stop between {low:.4g} and {high:.4g}")
    if not stopped.all():
        lines.append(
            f"{(~stopped).sum()} of {count} still slide at {threshold.loads[0]:.4g}, the lowest of these loads"
        )
    return lines


class _Dynamics(NamedTuple):
    """Law, time step and drag of the runs."""

    law: Law
    leg: int  # number of steps
    dt: float
    distance: float
    drag: float


@checked
def kinetic_threshold(
    path: list[Equilibrium], protocol: Protocol, *, kicks=None, realizations: int = 10, duration: Positive,
    dt: Positive, loads=None, distance: Positive = SLID, ramps: int = 3, drag: NotNegative = 0.0,
    seed: int = 0, workers: Workers = None, kept: Checkpoint | None = None, report: Report = silent,
) -> KineticThreshold:  # fmt: skip
    """Kick the equilibria of a load path and find the loads above which they slide, and above which they keep sliding.

    The random numbers of each run depend only on the seed, the load, the velocity in natural units and the number of
    the run. Results do not depend on `workers`, nor on units unless the load itself has a unit.

    In 196 of 200 repetitions with ten kicks of a block at each of 20 loads, the 95 % interval contained the threshold
    found with 400,000 velocities; for known curves, it did so in 118 of 120 cases
    (`tests/wings/studies/test_threshold.py`).

    Parameters
    ----------
    path : equilibria along a rising load, from `ramp`
    protocol : application of loads, used to lower the load of a sliding sample
    kicks : (K,) standard deviations of random initial velocities; default: 1e-13 and 1e-4 smallest diameters per
        natural unit of time (see `relax`) [length/time]
    realizations : number of runs for each load and kick
    duration, dt : duration and time step of a run [time]; a run that slides continues for another duration
    loads : loads of the path that are tried; default: all
    distance : distance that counts as sliding: shear strain of a cell whose shear follows a stress; or else
        displacement of a plate (rigid groups that are free to move) in mean diameters; or else median displacement of
        all grains
    ramps : largest number of ramps. Each starts from a lasting run at the highest load that has any, and lowers the
        load through the tried loads. Each load acts for one duration, or longer while the sample slows down. The
        sample has stopped unless it slides throughout, like a run that lasts
    drag : drag in all runs [1/time]
    kept : storage of finished runs, which are not repeated
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If a given load does not lie on the path; if loads do not rise along it; if a state of the path is not at rest
        at its load; if a kick is negative, not finite or given twice; if it moves grains by more than a radius in a
        step; or if dt is longer than `stable_time_step` or a fortieth of `duration`.
    RuntimeError
        If a run blows up.

    Examples
    --------
    Three disks in a row on a substrate; one is pushed. Small kicks do not make them slide:

    >>> import stickslip as ss
    >>> law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=10.0, coulomb="smooth"), 0, 1)
    >>> protocol = ss.protocols.Protocol(
    ...     law, ss.packings.with_push, lambda state, load: ss.relax(state, law)
    ... )
    >>> path = ss.protocols.ramp(
    ...     ss.packings.disk_array(3, press=5e-5), [0.0, 1e-6, 2e-6], protocol
    ... )
    >>> runs = {"kicks": 1e-9, "realizations": 2, "duration": 100.0, "dt": 0.1}
    >>> found = kinetic_threshold(path, protocol, **runs, workers=1)
    >>> found.slid.tolist()
    [[0], [0], [0]]
    """
    _require_count(1, realizations=realizations)
    require_sizes([Size(f"realizations = {realizations} makes", realizations, "runs", "use fewer")])
    _require_count(0, seed=seed, ramps=ramps)
    if duration < KICK_LEGS * dt:
        raise ValueError(f"a run needs at least {KICK_LEGS} steps, got duration = {duration:g} and dt = {dt:g}")
    tried = _points_at(path, loads)
    protocol = protocol.starting(path[0].state, path[0].load)
    scales = natural_scales(tried[0].state, protocol.law)
    speed = scales.length / scales.time
    kicks = _velocities([speed * kick for kick in KICKS] if kicks is None else kicks)
    for point in tried:
        check_time_step(point.state, protocol.law, driven_bodies(point.state), dt)
        _require_rest(point, protocol)
        if kicks.max() * dt > point.state.grains.radius.min():
            raise ValueError(
                f"with kicks = {kicks.max():g} and dt = {dt:g}, grains would move by more than a radius in a step: "
                "use smaller velocities"
            )
    how = _Dynamics(protocol.law, max(1, round(duration / dt / KICK_LEGS)), dt, distance, drag)
    starts = [
        (point.state, float(kick), _seed(int(seed), point.load, kick / speed, k))
        for point in tried for kick in kicks for k in range(int(realizations))
    ]  # fmt: skip
    done = run_members(
        _kick, [(*start, how) for start in starts], workers=workers,
        stage="kicked runs", report=report, describe=_describe_run,
        load=lambda k: kept.load(f"kick-{k:06d}", np.ndarray) if kept and kept.has(f"kick-{k:06d}") else None,
        save=lambda k, result: kept and kept.save(f"kick-{k:06d}", result),
    )  # fmt: skip
    for trial in done:
        if trial.failure:
            raise RuntimeError(trial.failure)
    results = np.array([trial.result for trial in done]).reshape(len(tried), len(kicks), -1, 2)
    time, lasts = results[..., 0], results[..., 1] > 0
    where, runs = np.array([point.load for point in tried]), np.full(time.shape[:2], time.shape[2])
    slid, lasting = np.isfinite(time).sum(axis=2), lasts.sum(axis=2)
    median = np.median(np.where(np.isnan(time), np.inf, time), axis=2)
    arrest = np.zeros((0, 2))
    if ramps and lasts.any():
        top = int(np.flatnonzero(lasts.any(axis=(1, 2)))[-1])
        chosen = [k for k in np.flatnonzero(lasts) if k // lasts[0].size == top][-int(ramps) :]
        points = tried[: top + 1]
        arrest = np.array([
            load_or_compute(kept, f"ramp-{k:06d}", partial(_ramp_down, starts[k], points, protocol, how, report))
            for k in chosen
        ])  # fmt: skip
    pair = [point.load for point in path if len(point.spectrum.pairs)]
    limit = [point.load for point in path if _at_limit(point.state)]
    return KineticThreshold(
        where, kicks, slid, runs, np.where(np.isfinite(median), median, np.nan), *_fit_each(where, slid, runs), arrest,
        min(pair, default=np.nan), min(limit, default=np.nan), float(duration), float(distance), lasting,
        *_fit_each(where, lasting, runs),
    )  # fmt: skip


def _require_count(least: int, **values) -> None:
    for name, value in values.items():
        if isinstance(value, bool | np.bool_) or not least <= value <= 10**18:
            raise ValueError(f"{name} must be a whole number from {least} to 1e18, got {value}")


def _points_at(path: list[Equilibrium], loads) -> list[Equilibrium]:
    """Points of a path at the given loads, or all."""
    known = np.array([point.load for point in path])
    if not len(known) or (np.diff(known) <= 0).any():
        raise ValueError(f"the loads of a path must increase, got {known.tolist()}")
    if loads is None:
        return list(path)
    try:
        wanted = np.unique(np.asarray(loads, float))
    except (TypeError, ValueError):
        raise ValueError(f"loads must be numbers, or None for all loads of the path, got {loads!r}") from None
    places = [int(np.argmin(np.abs(known - load))) for load in wanted]
    if not len(wanted) or not np.abs(known[places] - wanted).max() <= 1e-9 * np.abs(known).max():
        raise ValueError(f"the path does not contain loads = {wanted.tolist()}: it has {known.tolist()}")
    return [path[index] for index in places]


def _require_rest(point: Equilibrium, protocol: Protocol) -> None:
    """Raise ValueError if a state is not at rest under its load."""
    here = linearised(protocol.apply(point.state, point.load), protocol.law)
    share = max(force_imbalance(here), motion_imbalance(here))
    if not share <= BALANCED_BELOW:
        raise ValueError(
            f"the state of the path at a load of {point.load:.4g} is not at rest there (residual forces are "
            f"{share:.2g} of the mean contact force): use equilibria with their own loads, from ramp with this protocol"
        )


def _velocities(kicks) -> np.ndarray:
    """(K,) standard deviations of velocities."""
    try:
        out = np.atleast_1d(np.asarray(kicks, float))
    except (TypeError, ValueError):
        out = np.zeros(0)
    if out.ndim > 1 or not len(out) or not (np.isfinite(out) & (out >= 0)).all():
        raise ValueError(f"kicks must be one or more velocities, none of them negative, got {kicks!r}")
    if len(np.unique(out)) < len(out):
        raise ValueError(f"kicks must be distinct velocities, got {out.tolist()}")
    return out


def _seed(seed: int, load: float, kick: float, number: int) -> int:
    """Seed of one run, independent of all other runs; `kick` is in natural units."""
    entropy = [seed, *np.array([load, float(f"{kick:.12g}")]).view(np.uint64).tolist(), number]
    return int(np.random.SeedSequence(entropy).generate_state(1, np.uint64)[0])


def fit_threshold(loads, slid, runs) -> tuple[float, tuple[float, float], float]:
    """Load at which half of the runs slide, its 95 % interval and the width of the logistic curve.

    The likelihood is evaluated on a grid. Widths far below the spacing of the loads cannot be distinguished: if all
    runs above a load slide and none below it, the interval is the gap between these loads. A threshold outside the
    loads is NaN, and an end of an interval outside them is infinite. Fractions that do not rise with the load have no
    threshold.
    """
    loads, slid, runs = (np.asarray(a, float) for a in (loads, slid, runs))
    nothing = np.nan, (-np.inf, np.inf), np.nan
    slope = ((slid - runs * slid.sum() / runs.sum()) * loads).sum()  # has the sign of the best curve's slope
    if not (0 < slid.sum() < runs.sum() and slope > 1e-9 * runs.sum() * np.ptp(loads)):
        return nothing
    gap, span = np.diff(loads).min(), np.ptp(loads)
    ends = np.array([loads[0] - BEYOND * span, *loads, loads[-1] + BEYOND * span])
    middle = np.concatenate([np.linspace(a, b, FINE, endpoint=False) for a, b in pairwise(ends)])
    width = np.geomspace(gap / 50, WIDEST * span, WIDTHS)
    x = (loads - middle[:, None, None]) / width[:, None]
    log = (slid * np.log(expit(x) + 1e-300) + (runs - slid) * np.log(expit(-x) + 1e-300)).sum(axis=2)
    profile = log.max(axis=1)
    best = profile.max()
    inside = middle[profile >= best - DROP]
    at = float(middle[profile >= best - 1e-6][[0, -1]].mean())
    if not loads[0] <= at <= loads[-1]:
        return nothing
    ends = (
        float(inside[0]) if inside[0] > loads[0] else -np.inf,
        float(inside[-1]) if inside[-1] < loads[-1] else np.inf,
    )
    return at, ends, float(width[np.argmax(log[np.argmin(np.abs(middle - at))])])


def _fit_each(loads, counts, runs) -> tuple[np.ndarray, ...]:
    """Thresholds (K,), intervals (K, 2) and widths (K,) for each column of counts."""
    fits = [fit_threshold(loads, *pair) for pair in zip(counts.T, runs.T, strict=True)]
    return tuple(np.array(values) for values in zip(*fits, strict=True))


def _at_limit(state: State) -> bool:
    count = int(state.contacts.count[0])
    return bool((state.contacts.reached[:count] & (state.contacts.mode[:count] == SLIDE)).any())


def travel(start: State, end: State) -> float:
    """Distance by which a sample has slid.

    This is the shear strain of the cell if its shear follows a stress. Otherwise, it is the displacement of rigid
    groups that are free to move, such as a plate, or, if there are none, the median displacement of all grains; both
    are in mean diameters.
    """
    control, count = start.control, len(start.grains.radius)
    shear = control.cell_free & ~np.eye(3, dtype=bool)
    if shear.any():
        gradient = np.linalg.solve(start.cell.vectors, end.cell.vectors).T
        return float(np.abs(gradient[shear]).max())
    way = np.linalg.norm(end.grains.position - start.grains.position, axis=1)
    plate = (control.group[:count] >= 0) & control.free[:count, :3].any(axis=1)
    return float(np.median(way[plate] if plate.any() else way) / (2 * start.grains.radius.mean()))


def _describe_run(member) -> str:
    if member.failure:
        return member.failure
    time, lasts = member.result
    end = "keeps sliding" if lasts else "stopped"
    return f"slid after {time:.4g} and {end}" if np.isfinite(time) else "did not slide"


def _kick(state: State, kick: float, seed: int, how: _Dynamics, report: Report) -> np.ndarray:
    """(2,) time until a kicked sample has slid, NaN if it does not, and 1 if it then lasts, else 0."""
    end, time = _run_until_slid(perturbed(state, seed, kick), how)
    return np.array([time, np.isfinite(time) and len(_continue_slide(end, how)[1]) > 0])


def _run_until_slid(start: State, how: _Dynamics) -> tuple[State, float]:
    """State at the end of a run, and the time at which it had slid; NaN if it did not."""
    end = start
    for count in range(1, KICK_LEGS + 1):
        (start,), end = _run_leg((start,), end, how, how.leg)
        if travel(start, end) > how.distance:
            return end, count * how.leg * how.dt
    return end, np.nan


def _continue_slide(start: State, how: _Dynamics) -> tuple[State, list[float]]:
    """State of a sliding sample after another duration, and its travel in each window; an empty list if it stopped."""
    end, ways = start, []
    for _ in range(WINDOWS):
        before = end
        for _ in range(KICK_LEGS // WINDOWS):
            (start, before), end = _run_leg((start, before), end, how, how.leg)
        ways.append(travel(before, end))
        if ways[-1] < how.distance / WINDOWS:
            return end, []
    return end, ways if travel(start, end) >= how.distance else []  # otherwise it has moved back and forth


def _run_leg(earlier: tuple[State, ...], state: State, how: _Dynamics, steps: int) -> tuple[tuple[State, ...], State]:
    """Continue the run of a state. If it flows across boxes, its grains, and those of earlier states, are wrapped."""
    try:
        end, _, outcome = run(state, how.law, steps, how.dt, drag=how.drag, threads=1)
    except TooFarApartError as problem:
        if steps < 2 or state.control.spring.any():
            raise RuntimeError("a sample slid by tens of periodic boxes: use a shorter duration") from problem
        earlier, state = _run_leg(earlier, state, how, steps // 2)
        return _run_leg(earlier, state, how, steps - steps // 2)
    if outcome.broken:
        raise NotInEquilibriumError("a run of the kinetic threshold became unstable", outcome)
    if np.abs(end.contacts.image[: end.contacts.count[0]]).max(initial=0) <= FAR or end.control.spring.any():
        return earlier, end
    back = wrapped(reduced_cell(end))
    change = np.round(back.cell.vectors @ np.linalg.pinv(end.cell.vectors))
    shift = back.grains.position - end.grains.position
    # `travel` needs only the positions and the cell of earlier states
    moved = [
        old._replace(
            cell=old.cell._replace(vectors=change @ old.cell.vectors),
            grains=old.grains._replace(position=old.grains.position + shift),
        )
        for old in earlier
    ]
    return tuple(moved), back


def _ramp_down(start, points: list[Equilibrium], protocol: Protocol, how: _Dynamics, report) -> np.ndarray:
    """(2,) load at which a sample sliding at the last point stops, or −inf, and the lowest load at which it slid."""
    state, kick, seed = start
    state, _ = _run_until_slid(perturbed(state, seed, kick), how)  # not longer, as its speed may grow without limit
    moving = points[-1].load
    for point in points[-2::-1]:
        state, ways = protocol.apply(state, point.load), [np.inf, 0.0]
        while ways and ways[-1] < SLOWING * ways[0]:
            state, ways = _continue_slide(state, how)
        report("kicked runs", 1.0, f"ramp down, load {point.load:.4g}: {'slides' if ways else 'stopped'}")
        if not ways:
            return np.array([point.load, moving])
        moving = point.load
    return np.array([-np.inf, moving])
