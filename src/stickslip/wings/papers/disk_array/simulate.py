"""Simulation of a disk array: press, push quasi-statically, compute spectra, run freely at chosen loads, and slide."""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, Outcome, State, Status, spectrum
from ....kit import (
    Change,
    Checkpoint,
    Device,
    Family,
    Growth,
    Report,
    Task,
    Workers,
    checked,
    checkpoint_in,
    equilibrium,
    load_or_compute,
    make_law,
    open_device,
    result_of,
    run_realizations,
    silent,
    within,
)
from ....modes import track_pairs
from ....packings import disk_array, with_push
from ....protocols import Protocol, load_path, ramp
from ....results import Equilibrium, Spectrum
from . import EXPERIMENT, fronts
from .fronts import FreeRun, Trajectory, check_time_step, fastest_period, resample_transition, run_free
from .scenario import DiskArrayScenario

RAMP, BIRTHS, FREE = "quasi-static ramp", "births and deaths of pairs", "free runs"  # names of stages


class Ensemble(NamedTuple):
    """Realisations of sliding at one load; fields as in `Transition`."""

    load: float
    breach: np.ndarray  # (S, N) [time]
    slide: np.ndarray  # (S, H, N) [time]
    velocity: np.ndarray  # (S,) [length/time]
    wall_first: np.ndarray  # (S,)
    msd_at_breach: np.ndarray  # (S,) [length²]
    unloading: np.ndarray  # (S, N)
    power: np.ndarray  # (S,)
    late_velocity: np.ndarray  # (S, 2) [length/time]
    late_height: np.ndarray  # (S, 2) [length]
    smooth_slide: np.ndarray  # (S, H, N) [time]
    profile: np.ndarray  # (S, H, N) [length]
    drift: np.ndarray  # (S, H) [length/time]
    time: np.ndarray  # (T,) [time]
    center: np.ndarray  # (T, 2) centre of mass of the first realisation [length]
    failures: tuple[str, ...]


@result_of(EXPERIMENT)
class DiskArrayResult(NamedTuple):
    """Results of a scenario."""

    scenario: DiskArrayScenario
    law: Law
    pressed: State
    pressed_spectrum: Spectrum
    path: list[Equilibrium]  # equilibria along the path, with loads in the scenario's numbers
    families: list[Family]
    coarse_families: list[Family]  # pairs on the same path with twice the load step, if requested
    free_runs: dict[float, FreeRun]
    trajectory: Trajectory | None
    sliding: dict[float, Ensemble]


def make_protocol(scenario: DiskArrayScenario, law: Law) -> Protocol:
    """Return the protocol by which a scenario applies a push (in the scenario's numbers) and finds equilibria."""
    how = scenario.relaxation
    options = _damping(scenario) if how.method == "dynamics" else {"tolerance": how.tolerance}

    def apply(state, load):
        return with_push(state, load * scenario.load.unit, scenario.load.disk - 1)

    def settle(state, load):
        return equilibrium(state, law, method=how.method, what=f"push = {load:g}", **options)

    return Protocol(law, apply, settle)


def press(scenario: DiskArrayScenario) -> tuple[State, Law]:
    """Bring the array to equilibrium under its normal load."""
    array, load, law = scenario.array, scenario.load, make_law(scenario.law)
    state = disk_array(
        array.disks, array.radius, press=load.press * load.unit, mass=array.mass, i0=array.i0, gap=array.gap
    )
    return equilibrium(state, law, what="the normal load alone", **_damping(scenario))[0], law


def _damping(scenario: DiskArrayScenario) -> dict:
    """Options of `relax`, from the scenario."""
    return {name: getattr(scenario.relaxation, name) for name in ("tolerance", "drag", "spin_drag", "dt", "steps")}


@checked
def push_disk_array(
    scenario: DiskArrayScenario, *, step: float | None = None, kept: Checkpoint | None = None, report: Report = silent
):
    """Press the array and push it along its path; return State, Law and a list of Equilibrium.

    Parameters
    ----------
    step : load step that replaces the scenario's, to test its influence on the path
    kept : storage for the points of the path
    """
    state, law = press(scenario)
    through = (*scenario.dynamics.loads, *scenario.sliding.loads)
    loads = load_path(scenario.load.push, step or scenario.load.step, through)
    return state, law, ramp(state, loads, make_protocol(scenario, law), within(report, stage=RAMP), kept=kept)


def _coarse_pairs(scenario: DiskArrayScenario, law: Law, report: Report) -> list[Family]:
    """Track pairs on the path with twice the load step."""
    ramping, tracking = (within(report, *ends, stage=f"{BIRTHS}, twice the load step") for ends in ((0, 0.8), (0.8, 1)))
    path = push_disk_array(scenario, step=2 * scenario.load.step, report=ramping)[2]
    return track_pairs(path, make_protocol(scenario, law), tracking)


def point_at_load(path: list[Equilibrium], load: float) -> Equilibrium:
    """Return the first point on a path at a given load."""
    return min(path, key=lambda point: abs(point.load - load))


def run_sliding(
    points: list[Equilibrium], law: Law, scenario: DiskArrayScenario, workers: Workers, report: Report = silent, *,
    kept: Checkpoint | None = None, device: Device | None = None,
) -> dict[float, Ensemble]:  # fmt: skip
    """Run the realisations of sliding at every load in parallel; their seeds are the scenario's seed + 1, 2, 3 …"""
    how, dynamics = scenario.sliding, scenario.dynamics
    options = {"velocity": dynamics.seed_velocity, "duration": how.duration, "thresholds": how.thresholds}
    for point in points:
        check_time_step(point, dynamics.dt)
    seeds = [scenario.seed + 1 + k for k in range(how.realizations)]
    tasks = []
    for p in points:
        options |= dynamics.options | {"sample": fastest_period(p) / 10}
        tasks += [Task(f"seed {s}", (p.state, law, p.load, s, dict(options)), f"{p.load!r}-{s}", kept) for s in seeds]
    runs = run_realizations(
        _transition_task, tasks, stage="realisations of sliding", workers=workers, device=device, report=report,
        describe=_describe_member,
    )  # fmt: skip
    out = {}
    for point, group in zip(points, runs.groups(len(seeds)), strict=True):
        good = group.successful(f"realisation at push = {point.load:g}")
        out[point.load] = Ensemble(
            point.load,
            *map(np.array, zip(*(t[: -len(("time", "center"))] for t in good), strict=True)),
            good[0].time,
            good[0].center,
            group.failures,
        )
    return out


def _describe_member(member) -> str:
    """Describe the outcome of a realisation."""
    if member.failure:
        return member.failure
    velocity = member.result.velocity
    return f"sliding velocity {velocity:.2e}" if np.isfinite(velocity) else "did not slide in time"


def _transition_task(state, law, load, seed, options, report, engine=None):
    report(f"push {load:g}, seed {seed}", 0.0, "started")
    return fronts.run_transition(state, law, seed, engine=engine, **options)


@checked
def simulate_disk_array(
    scenario: DiskArrayScenario, *, folder: Path | None = None, workers: Workers = None, device: str | None = None,
    sensitivity: bool = False, report: Report = silent,
) -> DiskArrayResult:  # fmt: skip
    """Run a scenario from beginning to end.

    Parameters
    ----------
    folder : run folder, in which loads, free runs and realisations are saved as soon as they finish; a killed run
        resumes from them
    workers : number of processes for the realisations of sliding, or the address of a Dask scheduler; the result does
        not depend on it
    device : "cuda" to run the realisations of sliding side by side on a graphics processor; they agree with those on
        the CPU until round-off errors have grown
    sensitivity : also track the pairs on the same path with twice the load step, to test its influence on births
    report : called as report(stage, share done, text with the relevant quantities)

    Raises
    ------
    NotInEquilibriumError
        If the scenario's method finds no equilibrium at a load. The message names the load and suggests a remedy.
    ValueError
        If the device cannot run this scenario.
    MissingExtraError
        If CuPy is missing.
    RuntimeError
        If there is no such device.

    Examples
    --------
    >>> import stickslip as ss
    >>> short = ss.scenario(
    ...     load={"push": (0.0, 0.02), "step": 0.01}, dynamics={"loads": ()}
    ... )
    >>> [len(point.spectrum.pairs) for point in simulate_disk_array(short).path]
    [0, 1, 1]
    """
    where = device and open_device(device, make_law(scenario.law))
    kept = open_checkpoint(folder, scenario)
    result = simulate_before_sliding(scenario, kept, sensitivity, report)
    return add_sliding(result, kept, workers, report, where)


def open_checkpoint(folder: Path | None, scenario: DiskArrayScenario) -> Checkpoint | None:
    """Storage of a run's data, after a check of existing data; None without a folder."""
    nouns = (FreeRun, Growth, Trajectory, fronts.Transition, Family, Change, Outcome, Status)
    kept = checkpoint_in(folder, scenario, *nouns)
    if kept:
        kept.check()
        kept.announce()
    return kept


def simulate_before_sliding(
    scenario: DiskArrayScenario, kept: Checkpoint | None, sensitivity: bool = False, report: Report = silent
) -> DiskArrayResult:
    """Run a scenario, except the realisations of sliding, in this process."""
    kept = kept and kept.if_visible()
    pressed, law, path = push_disk_array(scenario, kept=kept and kept.of("ramp"), report=report)
    report(BIRTHS, 0.0, "bisection in the push")
    tracking = within(report, stage=BIRTHS)
    born = load_or_compute(kept, "families", partial(track_pairs, path, make_protocol(scenario, law), tracking))
    coarse = []
    if sensitivity:
        coarse = load_or_compute(kept, "coarse-families", partial(_coarse_pairs, scenario, law, report))
    free_runs, trajectory = {}, None
    for k, load in enumerate(scenario.dynamics.loads):
        point, count = point_at_load(path, load), len(scenario.dynamics.loads)
        rate = f"push {load:g}, growth rate {point.spectrum.growth_rate.max(initial=0.0):.2e}"
        report(FREE, k / count, rate)
        free_runs[load] = load_or_compute(kept, f"free-run-{load!r}", partial(run_free, point, law, scenario))
        report(FREE, (k + 1) / count, f"{rate}, M = {free_runs[load].msd[-1]:.1e}")
        wanted = free_runs[load].slid if scenario.dynamics.watch is None else load == scenario.dynamics.watch
        if wanted and trajectory is None:
            resample = partial(resample_transition, point, law, scenario, free_runs[load])
            trajectory = load_or_compute(kept, "trajectory", resample)
    return DiskArrayResult(
        scenario, law, pressed, spectrum(pressed, law), path, born, coarse, free_runs, trajectory, {}
    )


def add_sliding(
    result: DiskArrayResult,
    kept: Checkpoint | None,
    workers: Workers = None,
    report: Report = silent,
    device: Device | None = None,
) -> DiskArrayResult:
    """Run the realisations of sliding from loads on the path of a result."""
    scenario = result.scenario
    if not scenario.sliding.loads:
        return result
    points = [point_at_load(result.path, load) for load in scenario.sliding.loads]
    sliding = run_sliding(
        points, result.law, scenario, workers, report, kept=kept and kept.of("sliding"), device=device
    )
    return result._replace(sliding=sliding)


def simulate_with_sensitivity(scenario: DiskArrayScenario, **options) -> DiskArrayResult:
    """Run a scenario, then repeat its path with twice the load step to show its influence on the births."""
    return simulate_disk_array(scenario, sensitivity=True, **options)
