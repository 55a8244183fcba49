"""Measures of a pushed array of disks: births of complex pairs, fronts, sliding velocity and transverse mode.

Arrest is described by the equilibria at which the array comes to rest, and by the kinetic threshold that separates
arrest from sliding.
"""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import spectrum
from ....kit import Report, Workers, checkpoint_in, dominant_family, load_or_compute, silent, standard_error
from ....measure import touching
from ....packings import perturbed
from ....protocols import Protocol, fit_growth, free_run, kinetic_threshold
from ....results import Equilibrium, KineticThreshold, Spectrum
from . import fronts
from .fronts import FreeRun
from .simulate import DiskArrayResult, Ensemble, make_protocol, point_at_load

BLOCKS = 8  # number of blocks in the second half of a run, for the error of mean M; longer than the beats of modes
LATE = 4  # number of parts of a run; the mean M of the last part is compared with that of the first
HALVES = (1e-19, 1e-15), (1e-15, 1e-11)  # halves of the window of M in which growth is fitted


def late_birth(path: list[Equilibrium], protocol: Protocol, load: float = 0.083) -> float | None:
    """Return F_x at the birth of the pair that dominates (largest Im λ) at `load`, on a path of increasing load."""
    family = dominant_family([point for point in path if point.load <= load], protocol)
    if family is None:
        return None
    return family.birth.load if family.birth else float(family.loads[0])


def forward_front(result: DiskArrayResult, ensemble: Ensemble) -> fronts.Front | None:
    """Fit the front, from the pushed disk along the row, at which substrate contacts reach the Coulomb limit."""
    order, distance = fronts.row_order(result.pressed, result.scenario.load.disk - 1)
    return fronts.fit_front(ensemble.breach, order, distance, result.scenario.seed)


def backward_order(result: DiskArrayResult) -> tuple[np.ndarray, np.ndarray]:
    """Order of the disks from the last back to the pushed one, and their distances from the last [length]."""
    last = (result.scenario.load.disk - 2) % result.scenario.array.disks
    return fronts.row_order(result.pressed, last, backward=True)


def backward_front(
    result: DiskArrayResult, threshold: float, loads=None, *, smooth: bool = False
) -> fronts.Front | None:
    """Fit the front, backward from the last disk, at which displacements exceed a threshold, to all runs at `loads`.

    With `smooth`, displacements are averaged over their oscillations (see `fronts.Transition`).
    """
    how, name = result.scenario.sliding, "smooth_slide" if smooth else "slide"
    order, distance = backward_order(result)
    k, chosen = how.thresholds.index(threshold), loads or result.sliding
    times = [getattr(result.sliding[load], name)[:, k] for load in chosen]
    return fronts.fit_front(np.concatenate(times), order, distance, result.scenario.seed)


class Line(NamedTuple):
    """Sliding velocity against push, with the line V = intercept + slope F_x fitted to some of the loads."""

    push: np.ndarray  # (L,) all loads
    velocity: np.ndarray  # (L,) means over the realisations that slid before the run ended [length/time]
    error: np.ndarray  # (L,) standard errors of the means
    slope: float
    intercept: float
    slope_error: float
    intercept_error: float


def velocity_line(result: DiskArrayResult, top: float = np.inf) -> Line | None:
    """Fit Eq 10 by weighted least squares to mean sliding velocities up to a push `top`; None with fewer than three."""
    rows = []
    for load, ensemble in result.sliding.items():
        good = ensemble.velocity[np.isfinite(ensemble.velocity)]
        if len(good) > 2:
            rows.append((load, good.mean(), good.std(ddof=1) / np.sqrt(len(good))))
    if sum(load <= top for load, *_ in rows) < 3:
        return None
    load, mean, error = np.array(rows).T
    use = load <= top
    (slope, intercept), covariance = np.polyfit(load[use], mean[use], 1, w=1 / error[use], cov="unscaled")
    slope_error, intercept_error = np.sqrt(np.diag(covariance))
    return Line(load, mean, error, float(slope), float(intercept), float(slope_error), float(intercept_error))


def y_mode(modes: Spectrum) -> int:
    """Index of the mode with the largest fraction of motion in y."""
    return int(np.argmax(modes.shares()[:, 1]))


def wave_power(modes: Spectrum) -> tuple[np.ndarray, np.ndarray]:
    """Wave numbers (Q,) [1/diameter] of a row, and the fraction (Q, n) of each mode's y motion at each of them."""
    y = modes.modes[modes.free.axis == 1]
    n = len(y)
    power = np.abs(np.fft.fft(y, axis=0)) ** 2
    folded = np.array([power[q] + (power[-q] if 0 < q < n - q else 0) for q in range(n // 2 + 1)])
    whole = power.sum(axis=0)
    return 2 * np.pi * np.arange(len(folded)) / n, np.divide(folded, whole, out=np.zeros_like(folded), where=whole > 0)


def exceeds(value: float, error: float, bound: float) -> bool | None:
    """Return True if a number exceeds a bound, None if the difference is less than two standard errors."""
    return None if not abs(value - bound) > 2 * error else bool(value > bound)


def growth_error(free: FreeRun) -> float | None:
    """Half the difference between the growth rates fitted in the two halves of the window [1/time].

    None if either fit fails.

    M is in units of (2R)², which is 1 in the paper's scenarios.
    """
    if free.predicted_growth <= 0:
        return None
    guess = {"growth_rate": free.predicted_growth, "frequency": free.predicted_frequency}
    fits = [fit_growth(free.time, free.msd, window=window, **guess) for window in HALVES]
    return None if None in fits else 0.5 * abs(fits[0].growth_rate - fits[1].growth_rate)


def saturation_error(free: FreeRun) -> float | None:
    """Standard error of the mean of M over the second half of one run, from block averages [length²]."""
    late = free.msd[free.time >= free.time[0] + 0.5 * (free.time[-1] - free.time[0])]
    return standard_error([block.mean() for block in np.array_split(late, BLOCKS)])


def growth_factor(free: FreeRun) -> float:
    """Ratio of mean M in the last quarter of a run to that in the first; about 1 without growth."""
    parts = np.array_split(free.msd[1:], LATE)
    return float(parts[-1].mean() / parts[0].mean())


def power_law(x: np.ndarray, speed: np.ndarray, error: np.ndarray) -> tuple[float, float] | None:
    """Exponent p of speed ∝ x^p and its standard error, widened by the misfit; None with fewer than three speeds."""
    if len(x) < 3 or (speed <= 0).any() or np.ptp(x) == 0:
        return None
    x, y, w = np.log(x), np.log(speed), speed / error
    (slope, level), covariance = np.polyfit(x, y, 1, w=w, cov="unscaled")
    misfit = float((((y - level - slope * x) * w) ** 2).sum() / (len(x) - 2))
    return float(slope), float(np.sqrt(covariance[0, 0] * max(1.0, misfit)))


def drift_front(result: DiskArrayResult, threshold: float, loads) -> tuple[float, float] | None:
    """Speed and error of the backward front of an array that drifts with a constant profile of displacements.

    See `fronts.drift_speed`; None if no run passes the threshold.
    """
    how = result.scenario.sliding
    order, distance = backward_order(result)
    k = how.thresholds.index(threshold)
    profile = np.concatenate([result.sliding[load].profile[:, k] for load in loads])
    drift = np.concatenate([result.sliding[load].drift[:, k] for load in loads])
    return fronts.drift_speed(profile, drift, order, distance, result.scenario.seed)


class Proportion(NamedTuple):
    """Speed of the forward front against Im λ of the strongest pair, at loads where both are known."""

    load: np.ndarray  # (L,)
    im_lambda: np.ndarray  # (L,) [1/time²]
    speed: np.ndarray  # (L,) [length/time]
    speed_error: np.ndarray  # (L,)

    @property
    def ratio(self) -> np.ndarray:
        """(L,) V_1/Im λ [length·time]."""
        return self.speed / self.im_lambda

    @property
    def mean_ratio(self) -> tuple[float, float]:
        """Mean of the ratios, and its standard error propagated from those of the speeds."""
        errors = self.speed_error / self.im_lambda
        return float(self.ratio.mean()), float(np.sqrt((errors**2).sum()) / len(errors))

    @property
    def exponent(self) -> tuple[float, float] | None:
        """Exponent p of V_1 ∝ (Im λ)^p and its standard error; see `power_law`."""
        return power_law(self.im_lambda, self.speed, self.speed_error)


def speed_proportion(result: DiskArrayResult, im_lambda: dict[float, float], *, free: bool) -> Proportion:
    """Pair the front speeds, fitted through the start or with a free intercept, with Im λ given as {load: value}."""
    by_load = {load: forward_front(result, result.sliding[load]) for load in im_lambda}
    there = [load for load, front in by_load.items() if front and im_lambda[load] > 0]
    speeds = [(f.free_intercept, f.free_error) if free else (f.speed, f.speed_error) for f in map(by_load.get, there)]
    speed, error = np.array(speeds).reshape(-1, 2).T
    return Proportion(np.array(there), np.array([im_lambda[load] for load in there]), speed, error)


LATE_STATES = 8  # number of late states of a run that are relaxed
ARREST_LOADS = (0.030, 0.040)  # loads at which the paper's array comes to rest after growth
KICK = 1e-4  # standard deviation of initial velocities, far above the noise from which a pair grows [length/time]
KICKED_LOADS = (0.030, 0.040, 0.0425, 0.045, 0.0475, 0.050, 0.055, 0.083)
FEWER_LOADS = (0.040, 0.045, 0.050, 0.083)  # loads of a quick run
REALIZATIONS = {False: 20, True: 8}  # realisations at each load, in a full and in a quick run


class Arrest(NamedTuple):
    """Late states of a free run, relaxed at the same load."""

    load: float
    late: np.ndarray  # (K,) M of the late states [length²]
    static: np.ndarray  # (K,) M of the equilibria to which they relax [length²]
    pairs: np.ndarray  # (K,) number of complex pairs of these equilibria
    neighbours: np.ndarray  # (K,) number of disk–disk contacts of these equilibria
    charge: np.ndarray  # (K,) mean |t_iw| of the late states over that of the equilibrium from which the run starts
    before: int  # number of disk–disk contacts of that equilibrium


def find_arrest(result: DiskArrayResult, load: float) -> Arrest:
    """Relax the end state of the free run at a load, and of its continuations by an eighth of its duration each."""
    scenario, law, how = result.scenario, result.law, result.scenario.dynamics
    point, protocol = point_at_load(result.path, load), make_protocol(result.scenario, result.law)
    end, rows = perturbed(point.state, scenario.seed, how.seed_velocity), []
    start = point.state.grains.position
    for k in range(LATE_STATES):
        duration = how.duration if k == 0 else how.duration / LATE_STATES
        end, _, _ = free_run(end, law, duration=duration, sample=duration, **how.options)
        rest, _ = protocol.settle(end, load)
        rows.append((
            *(float(((state.grains.position - start) ** 2).sum()) for state in (end, rest)),
            len(spectrum(rest, law).pairs), _neighbours(rest),
            _wall_slip(end) / _wall_slip(point.state),
        ))  # fmt: skip
    return Arrest(load, *(np.array(column) for column in zip(*rows, strict=True)), _neighbours(point.state))


def _wall_slip(state) -> float:
    """Mean |t_iw| of the contacts with the substrate [length]."""
    here = touching(state)
    here = here[state.contacts.j[here] >= len(state.grains.radius)]
    return float(np.linalg.norm(state.contacts.slip[here], axis=-1).mean())


def _neighbours(state) -> int:
    """Number of disk–disk contacts."""
    return int((state.contacts.j[touching(state)] < len(state.grains.radius)).sum())


def kick_array(
    result: DiskArrayResult, *, quick: bool = False, folder: Path | None = None, workers: Workers = None,
    report: Report = silent,
) -> KineticThreshold:  # fmt: skip
    """Kinetic threshold of the array on its load path."""
    scenario, kept = result.scenario, checkpoint_in(folder, result.scenario)
    return kinetic_threshold(
        result.path, make_protocol(scenario, result.law), loads=FEWER_LOADS if quick else KICKED_LOADS, kicks=KICK,
        realizations=REALIZATIONS[quick], duration=scenario.sliding.duration,
        dt=2 * scenario.dynamics.dt, seed=scenario.seed, workers=workers, kept=kept and kept.of("threshold"),
        report=report,
    )  # fmt: skip


def find_arrests(result: DiskArrayResult, folder: Path | None = None) -> list[Arrest]:
    """Relaxed late states at the loads at which the paper's array comes to rest; saved in the run folder."""
    kept = checkpoint_in(folder, result.scenario, Arrest)
    return [load_or_compute(kept, f"arrest-{x!r}", partial(find_arrest, result, x)) for x in ARREST_LOADS]
