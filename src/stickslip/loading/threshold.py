"""Kinetic threshold: from which load on a kicked sample slides, and at which load a sliding sample stops.

A sample that is at rest at a load is kicked with random velocities and runs freely. It has *slid* once what bears the
load has moved by a given distance (see `travel`), and is at rest again if it has not within the duration. The share of
kicks that end in sliding rises with the load; a logistic curve is fitted to it by maximum likelihood.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from ..core.arguments import checked, require_not_negative, require_positive
from ..core.dynamics.coefficients import driven_bodies
from ..core.dynamics.run import run
from ..core.dynamics.timestep import check_time_step
from ..core.laws.builtin import Law
from ..core.outcome import NotInEquilibriumError
from ..core.readable import readable
from ..core.state import SLIDE, State
from ..data.checkpoint import Checkpoint, load_or_compute
from ..ensemble import Workers, run_members
from .protocols import Equilibrium, Protocol, perturbed

LEGS = 40  # into which a run is divided, to see whether the sample has slid
SLID = 0.1  # distance by which a sample has slid, as of `travel`
FINE, WIDTHS = 200, 80  # thresholds per range of loads, and widths, at which the likelihood is evaluated
BEYOND, WIDEST = 5, 50  # largest distance of a threshold from the loads and largest width, in their range
DROP = 1.92  # of the log-likelihood at the ends of an interval of 95 % (half of the quantile 3.84 of χ² with 1 degree)


@readable(head=lambda found: found.sentence)
class KineticThreshold(NamedTuple):
    """Outcomes of kicks at several loads, the threshold fitted to them, and the static thresholds of the same path."""

    loads: np.ndarray  # (L,)
    kicks: np.ndarray  # (K,) standard deviation of the initial velocities [length/time]
    slid: np.ndarray  # (L, K) number of runs that slid
    runs: np.ndarray  # (L, K) number of runs
    lifetime: np.ndarray  # (L, K) median time until a run had slid, NaN without any [time]
    threshold: np.ndarray  # (K,) load at which half of the runs slide; NaN if all or none slid
    interval: np.ndarray  # (K, 2) of 95 % by the likelihood ratio; infinite where nothing bounds it
    width: np.ndarray  # (K,) of the logistic curve 1/(1 + exp(−(load − threshold)/width))
    arrest: tuple[float, float] | None  # loads between which a sliding sample stops, ramped down; None if not tried
    first_pair: float  # smallest load on the path with a complex pair; NaN without
    first_limit: float  # smallest load on the path at which a contact is at the Coulomb limit; NaN without
    duration: float  # of a run [time]

    @property
    def probability(self) -> np.ndarray:
        """(L, K) share of the runs that slid."""
        return self.slid / self.runs

    @property
    def sentence(self) -> str:
        """Thresholds in words."""
        words = []
        for kick, at, (low, high), slid in zip(self.kicks, self.threshold, self.interval, self.slid.T, strict=True):
            found = f"slide from {at:.4g} on (95 %: {low:.4g} to {high:.4g})"
            found = found if np.isfinite(at) else "always slide" if slid.any() else "never slide"
            words.append(f"runs from velocities of {kick:.3g} {found}")
        if self.arrest:
            words.append(f"a sliding sample stops between {self.arrest[0]:.4g} and {self.arrest[1]:.4g}")
        for name, load in (("first complex pair", self.first_pair), ("first contact at the limit", self.first_limit)):
            words.append(f"{name} at {load:.4g}" if np.isfinite(load) else f"no {name.removeprefix('first ')}")
        return "; ".join(words)


@checked
def kinetic_threshold(
    path: list[Equilibrium], protocol: Protocol, *, kicks=(1e-13, 1e-4), realizations: int = 10, duration: float,
    dt: float, loads=None, distance: float = SLID, ramp_down: bool = True, drag: float = 0.0, seed: int = 0,
    workers: Workers = None, kept: Checkpoint | None = None, report: Callable | None = None,
) -> KineticThreshold:  # fmt: skip
    """Kick the equilibria of a load path and find from which load on they slide.

    Results do not depend on `workers`.

    Parameters
    ----------
    path : equilibria along a rising load, from `ramp`
    protocol : how loads are applied, used to lower the load of a sliding sample
    kicks : (K,) standard deviations of random initial velocities [length/time]
    realizations : number of seeds for each load and kick
    duration, dt : of a run [time]
    loads : loads of the path that are tried; default: all
    distance : by which a sample has slid: shear strain of a cell whose shear follows a stress; or else the displacement
        of a plate (rigid groups that are free to move) in mean diameters; or else the median one of all grains
    ramp_down : whether the load is also lowered from a sliding sample, through the loads that are tried; it stays at
        each of them while the sample slows down, and has come to rest if it does not slide in two runs
    drag : of all runs [1/time]
    kept : where finished runs are saved; runs that it has are not repeated
    report : called as report(share done, words)

    Raises
    ------
    ValueError
        if a given load does not lie on the path, if loads do not rise along it, if a kick is negative or not finite,
        or if dt is longer than `stable_time_step` or a fortieth of `duration`.
    RuntimeError
        if a run blows up.

    Examples
    --------
    Three disks in a row on a substrate; one is pushed. Small kicks do not make them slide:

    >>> import stickslip as ss
    >>> law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=0.5), 0, 1)
    >>> protocol = ss.protocols.Protocol(law, ss.packings.with_push, lambda state, load: ss.relax(state, law))
    >>> path = ss.protocols.ramp(ss.packings.disk_array(3, press=5e-5), [0.0, 1e-6, 2e-6], protocol)
    >>> found = kinetic_threshold(path, protocol, kicks=1e-9, realizations=2, duration=100.0, dt=0.1, workers=1)
    >>> found.slid.tolist()
    [[0], [0], [0]]
    """
    require_positive(duration=duration, dt=dt, realizations=realizations, distance=distance)
    require_not_negative(drag=drag, seed=seed)
    realizations, seed = int(realizations), int(seed)
    if duration < LEGS * dt:
        raise ValueError(f"duration = {duration:g} and dt = {dt:g} were given: a run needs at least {LEGS} steps")
    kicks, known = _velocities(kicks), np.array([point.load for point in path])
    if not len(known) or (np.diff(known) <= 0).any():
        raise ValueError(f"a path with the loads {known.tolist()} was given: it needs loads that rise")
    wanted = known if loads is None else np.unique(np.asarray(loads, float))
    places = [int(np.argmin(np.abs(known - load))) for load in wanted]
    if not len(wanted) or not np.abs(known[places] - wanted).max() <= 1e-9 * np.abs(known).max():
        raise ValueError(f"loads = {wanted.tolist()} were given: the path has {known.tolist()}")
    for place in places:
        check_time_step(path[place].state, protocol.law, driven_bodies(path[place].state), dt)
    how = (protocol.law, duration, dt, distance, drag)
    tasks = [
        (path[place].state, kick, seed + k, *how) for place in places for kick in kicks for k in range(realizations)
    ]
    done = run_members(
        _kick, tasks, workers=workers,
        report=report and (lambda count, total, one: report(count / total, _describe_run(one))),
        load=lambda k: kept.load(f"run-{k:06d}") if kept and kept.has(f"run-{k:06d}") else None,
        save=lambda k, time: kept and kept.save(f"run-{k:06d}", time),
    )  # fmt: skip
    for one in done:
        if one.failure:
            raise RuntimeError(one.failure)
    times = np.array([one.result for one in done]).reshape(len(places), len(kicks), realizations)
    slid = np.isfinite(times).sum(axis=2)
    lifetime = np.full(slid.shape, np.nan)
    lifetime[slid > 0] = np.nanmedian(times[slid > 0], axis=1)
    runs = np.full(slid.shape, realizations)
    fits = [fit_threshold(known[places], s, r) for s, r in zip(slid.T, runs.T, strict=True)]
    threshold, interval, width = (np.array(values) for values in zip(*fits, strict=True))
    arrest = None
    if ramp_down and slid.any():
        found = load_or_compute(
            kept, "arrest", lambda: _ramp_down(path, places, slid, times, kicks, seed, protocol, how, report)
        )
        arrest = (float(found[0]), float(found[1])) if np.isfinite(found).all() else None
    pair = [point.load for point in path if len(point.spectrum.pairs)]
    limit = [point.load for point in path if _at_limit(point.state)]
    return KineticThreshold(
        known[places], kicks, slid, runs, lifetime, threshold, interval, width, arrest, min(pair, default=np.nan),
        min(limit, default=np.nan), duration,
    )  # fmt: skip


def _velocities(kicks) -> np.ndarray:
    """(K,) standard deviations of velocities."""
    try:
        out = np.atleast_1d(np.asarray(kicks, float))
    except (TypeError, ValueError):
        out = np.zeros(0)
    if out.ndim > 1 or not len(out) or not (np.isfinite(out) & (out >= 0)).all():
        raise ValueError(f"kicks = {kicks!r} were given: one or more velocities are needed, none of them negative")
    return out


def fit_threshold(loads, slid, runs) -> tuple[float, tuple[float, float], float]:
    """Load at which half of the runs slide, its 95 % interval and the width of the logistic curve.

    The likelihood is evaluated on a grid. Widths far below the spacing of the loads cannot be told apart: if all runs
    above a load slide and none below it, the interval is the gap between these loads.
    """
    loads, slid, runs = (np.asarray(a, float) for a in (loads, slid, runs))
    if not 0 < slid.sum() < runs.sum() or len(loads) < 2:
        return np.nan, (-np.inf, np.inf), np.nan
    gap, span = np.diff(loads).min(), np.ptp(loads)
    middle = np.linspace(loads[0] - BEYOND * span, loads[-1] + BEYOND * span, (2 * BEYOND + 1) * FINE + 1)
    width = np.geomspace(gap / 50, WIDEST * span, WIDTHS)
    x = (loads - middle[:, None, None]) / width[:, None]
    log = (slid * np.log(expit(x) + 1e-300) + (runs - slid) * np.log(expit(-x) + 1e-300)).sum(axis=2)
    profile = log.max(axis=1)
    best = profile.max()
    inside = middle[profile >= best - DROP]
    at = float(middle[profile >= best - 1e-6].mean())
    ends = (float(inside[0]), float(inside[-1]))
    ends = (-np.inf if ends[0] == middle[0] else ends[0], np.inf if ends[1] == middle[-1] else ends[1])
    return at, ends, float(width[np.argmax(log[np.argmin(np.abs(middle - at))])])


def _at_limit(state: State) -> bool:
    count = int(state.contacts.count[0])
    return bool((state.contacts.reached[:count] & (state.contacts.mode[:count] == SLIDE)).any())


def travel(start: State, end: State) -> float:
    """Distance by which a sample has slid.

    Of a cell whose shear follows a stress, its shear strain. Otherwise, in mean diameters, the displacement of rigid
    groups that are free to move, such as a plate, or the median displacement of all grains if there are none.
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
    return f"slid after {member.result:.4g}" if np.isfinite(member.result) else "did not slide"


def _kick(state: State, kick: float, seed: int, law: Law, duration: float, dt: float, distance: float, drag: float):
    """Time until a kicked sample has slid, NaN if it does not."""
    return _run_until_slid(perturbed(state, seed, kick), law, duration, dt, distance, drag)[1]


def _run_until_slid(start: State, law: Law, duration: float, dt: float, distance: float, drag: float):
    """State at the end of a run, and the time at which it had slid; NaN if it did not."""
    end, steps = start, max(1, round(duration / dt / LEGS))
    for leg in range(LEGS):
        end, _, outcome = run(end, law, steps, dt, drag=drag, threads=1)
        if outcome.broken:
            raise NotInEquilibriumError("a run of the kinetic threshold blew up", outcome)
        if travel(start, end) > distance:
            return end, (leg + 1) * steps * dt
    return end, np.nan


def _ramp_down(path, places, slid, times, kicks, seed, protocol: Protocol, how, report) -> np.ndarray:
    """(2,) loads between which a sample that slides at the highest load that lets it slide comes to rest, or NaN."""
    last = int(np.flatnonzero(slid.any(axis=1))[-1])
    kick, k = np.argwhere(np.isfinite(times[last]))[-1]
    moving, start = path[places[last]].load, path[places[last]].state
    state, time = _run_until_slid(perturbed(start, seed + int(k), kicks[kick]), *how)
    velocity = travel(start, state) / time
    for place in places[:last][::-1]:
        load = path[place].load
        state, velocity = _slow_down(protocol.apply(state, load), velocity, how)
        if report:
            report(1.0, f"ramp down, load {load:.4g}: {'slides' if velocity else 'stopped'}")
        if not velocity:
            return np.array([load, moving])
        moving = load
    return np.full(2, np.nan)


def _slow_down(state: State, velocity: float, how) -> tuple[State, float]:
    """Run a sliding sample as long as it becomes slower; its velocity at the end, and zero if it came to rest."""
    while True:
        end, time = _run_until_slid(state, *how)
        if np.isnan(time):
            calm, time = _run_until_slid(end, *how)  # it may just have been slowing down
            if np.isnan(time):
                return calm, 0.0
            state, end = end, calm
        before, velocity, state = velocity, travel(state, end) / time, end
        if velocity >= before:
            return state, velocity
