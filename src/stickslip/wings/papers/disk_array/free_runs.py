"""Free runs of a disk array: Newtonian dynamics from equilibria on its path."""

from typing import NamedTuple

import numpy as np

from .... import Law, NotInEquilibriumError, State
from ....core.laws.builtin import damping_model
from ....loading.protocols import Growth
from ....modes import damped_growth
from ....packings import perturbed
from ....protocols import fit_growth, free_run
from ....results import Equilibrium
from . import fronts
from .scenario import DiskArrayScenario, Dynamics

SLIDING_THRESHOLD = 0.1  # the array slides once every disk has moved by this many mean diameters


class FreeRun(NamedTuple):
    """Newtonian dynamics from the equilibrium at one load."""

    load: float
    time: np.ndarray  # (T,) [time]
    msd: np.ndarray  # (T,) M(t) = Σ|Δr|² [length²]
    center: np.ndarray  # (T, 2) [length]
    kinetic_energy: np.ndarray  # (T,) [energy]
    touching: np.ndarray  # (T,)
    breach: np.ndarray  # (N,) first time at the Coulomb limit of each wall contact; NaN if never [time]
    first_limit: np.ndarray  # (3,) time, i, j of the first contact anywhere to reach the Coulomb limit; NaN if none
    predicted_growth: float  # ω_i of the fastest-growing mode, with drag and dashpots [1/time]
    predicted_frequency: float  # [1/time]
    growth: Growth | None
    saturation: float  # mean of M over the last half of the run [length²]
    slid: bool


class Trajectory(NamedTuple):
    """Finely sampled motion of all disks around the transition."""

    load: float
    time: np.ndarray  # (T,) [time]
    position: np.ndarray  # (T, N, 2) [length]
    angle: np.ndarray  # (T, N) [rad]
    first_limit: float  # first time that any contact reached the Coulomb limit
    breach: np.ndarray  # (N,) [time]
    slide: np.ndarray  # (N,) first displacement by SLID diameters [time]


def diameter(state: State) -> float:
    """Mean diameter of the grains, used as the unit of displacements [length]."""
    return 2 * float(state.grains.radius.mean())


def fastest_period(point: Equilibrium) -> float:
    """Period of the fastest mode, used as the unit of sampling [time]."""
    return 2 * np.pi / float(point.spectrum.frequency.max())


def predicted_growth(point: Equilibrium, law: Law, how: Dynamics) -> tuple[float, float]:
    """Growth rate and frequency of the fastest-growing mode of a free run, with its drag and dashpots [1/time]."""
    if how.drag or how.spin_drag or damping_model(law):
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
    """Run Newtonian dynamics from one equilibrium with a tiny random velocity."""
    how = scenario.dynamics
    check_time_step(point, how.dt)
    start = perturbed(point.state, scenario.seed, how.seed_velocity)
    _, record, outcome = free_run(
        start,
        law,
        duration=how.duration,
        dt=how.dt,
        sample=fastest_period(point) / 5,
        drag=how.drag,
        spin_drag=how.spin_drag,
    )
    if outcome.broken:
        raise NotInEquilibriumError(f"the free run at push = {point.load:g} blew up", outcome)
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
        point.load,
        record.time,
        record.msd,
        record.center[:, :2],
        record.kinetic_energy,
        record.touching,
        fronts.breach_times(record.events, start),
        first[0] if len(first) else np.full(3, np.nan),
        rate,
        frequency,
        growth,
        float(record.msd[late].mean()),
        bool((moved > SLIDING_THRESHOLD * diameter(start)).all()),
    )


def resample_transition(point: Equilibrium, law: Law, scenario: DiskArrayScenario, known: FreeRun) -> Trajectory | None:
    """Repeat a free run, bit for bit, with fine sampling from before the first slip until well after sliding begins."""
    if not (np.isfinite(known.breach).any() and np.isfinite(known.first_limit[0])):
        return None
    how = scenario.dynamics
    period = fastest_period(point)
    begin = max(0.0, float(known.first_limit[0]) - 30 * period)
    options = {"drag": how.drag, "spin_drag": how.spin_drag, "dt": how.dt}
    start = perturbed(point.state, scenario.seed, how.seed_velocity)
    before, _, _ = free_run(start, law, duration=begin, sample=how.duration, **options)
    length = min(how.duration - begin, 600 * period)
    _, record, _ = free_run(before, law, duration=length, sample=period / 20, **options)
    along = record.position[:, :, 0] - point.state.grains.position[:, 0]
    slide = fronts.crossing_times(record.time, along, [SLIDING_THRESHOLD * diameter(point.state)])[0]
    return Trajectory(
        point.load,
        record.time,
        record.position[:, :, :2],
        record.angle[:, :, 2],
        float(known.first_limit[0]),
        known.breach,
        slide,
    )
