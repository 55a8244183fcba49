"""Simulation of the static and kinetic friction of a sample: raise the load, kick the sample, lower the load."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, NotInEquilibriumError, Outcome, State, Status
from ....kit import (
    KICK_LEGS,
    Checkpoint,
    Report,
    ScenarioError,
    Workers,
    abandon,
    checked,
    checkpoint_in,
    load_or_compute,
    make_law,
    make_packing,
    result_of,
    silent,
    solve_point,
    travel,
)
from ....measure import pressure, stable_time_step
from ....protocols import Protocol, cell_shear, kinetic_threshold, load_path, plate_shear
from ....results import Equilibrium, KineticThreshold, PackingInfo
from ...papers.disk_array import simulate as disk_array
from ...papers.gouge.sample import Gouge, prepare_sample
from . import EXPERIMENT
from .scenario import ArraySample, GougeSample, Kicks, PackingSample, ThresholdScenario

STEP_SHARE = 0.2  # default time step over the largest stable time step


@result_of(EXPERIMENT, head=lambda result: "; ".join(result.sentences))
class ThresholdResult(NamedTuple):
    """Static and kinetic friction of a sample."""

    scenario: ThresholdScenario
    law: Law
    path: list[Equilibrium]  # equilibria on the rising load, up to the static strength
    strength: float  # load at which the sample slid spontaneously; NaN if it held the largest load
    found: KineticThreshold

    @property
    def sentences(self) -> list[str]:
        """Sentences on the static and kinetic friction."""
        held = f"held a load of {self.path[-1].load:.4g}"
        static = f"slid spontaneously at {self.strength:.4g}" if np.isfinite(self.strength) else "did not slide "
        "spontaneously"
        return [f"the sample {held} and {static}", *self.found.sentences]


def make_sample(scenario: ThresholdScenario, kept: Checkpoint | None, report: Report) -> tuple[State, Protocol]:
    """Make the sample without shear load, and the protocol of its load."""
    sample = scenario.sample
    make = {ArraySample: _array, PackingSample: _packing, GougeSample: _gouge}[type(sample)]
    return make(scenario, kept, report)


def _array(scenario: ThresholdScenario, kept: Checkpoint | None, report: Report):
    recipe = scenario.sample.recipe(scenario.load.loads[-1] or scenario.load.step, scenario.load.step)
    state, law = disk_array.press(recipe)
    _check_kicks(scenario, state, law)
    return state, disk_array.make_protocol(recipe, law)


def _packing(scenario: ThresholdScenario, kept: Checkpoint | None, report: Report):
    sample, law = scenario.sample, make_law(scenario.sample.law)

    def make() -> tuple[State, PackingInfo]:
        state, outcome = make_packing(sample, law, scenario.seed)
        _check_kicks(scenario, state, law)
        return state, outcome

    state, _ = load_or_compute(kept, "packing", make)
    return state, cell_shear(law, sample.pressure or pressure(state, law))


def _gouge(scenario: ThresholdScenario, kept: Checkpoint | None, report: Report):
    def make() -> Gouge:
        made = prepare_sample(scenario.sample.recipe, scenario.seed, report=report)
        _check_kicks(scenario, made.state, made.law)
        return made

    made = load_or_compute(kept, "gouge", make)
    return made.state, plate_shear(made.law, made.top)


def _time_step(how: Kicks, state: State, law: Law) -> float:
    return how.dt or min(STEP_SHARE * stable_time_step(state, law), how.duration / KICK_LEGS)


def _check_kicks(scenario: ThresholdScenario, state: State, law: Law) -> None:
    """Raise ScenarioError, before anything is saved, if runs of a sample without shear load would be unstable."""
    how, dt = scenario.kicks, _time_step(scenario.kicks, state, law)
    longest, radius = stable_time_step(state, law), state.grains.radius.min()
    if dt > longest:
        raise ScenarioError(
            f"kicks.dt = {dt:g} exceeds the largest stable time step of the sample, {longest:.3g}: use a fifth of "
            "that, or leave dt out"
        )
    if how.duration / dt > 1e9:
        raise ScenarioError(f"kicks.duration = {how.duration:g} exceeds 1e9 time steps of {dt:.3g}: use shorter runs")
    if max(how.velocities) * dt > radius:
        raise ScenarioError(
            f"kicks.velocities = {max(how.velocities):g} moves grains by more than a radius in a time step of "
            f"{dt:.3g}: use velocities below {radius / dt:.2g}"
        )


def raise_load(
    state: State, loads, protocol: Protocol, distance: float, kept: Checkpoint | None, report: Report
) -> tuple[list[Equilibrium], float]:
    """Equilibria along rising loads until the sample slides, and the load at which it slides (NaN if never).

    The sample slides if there is no equilibrium, or only one farther away than a given distance.
    """
    path: list[Equilibrium] = []
    for k, load in enumerate(loads):
        try:
            point = solve_point(state, load, protocol, kept, f"load-{k:06d}")
        except NotInEquilibriumError:
            if not path:
                raise
            report("rising load", 1.0, f"load {load:.4g}: no equilibrium")
            return path, float(load)
        way = travel(state, point.state) if path else 0.0
        progress = f"load {load:.4g}, {len(point.spectrum.pairs)} pairs, moved by {way:.1e}"
        report("rising load", (k + 1) / len(loads), progress)
        if way > distance:
            return path, float(load)
        path.append(point)
        state = point.state
    return path, np.nan


@checked
def simulate_threshold(
    scenario: ThresholdScenario, *, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> ThresholdResult:
    """Raise the load on a sample, kick its equilibria, and lower the load again.

    Parameters
    ----------
    folder : run folder, in which each equilibrium and run is saved as soon as it is finished; a killed run resumes from
        them
    workers : number of processes for the kicked runs, or the address of a Dask scheduler; the result does not depend
        on it
    report : called as report(stage, share done, text)

    Raises
    ------
    NotInEquilibriumError
        If the sample has no equilibrium without shear load.
    ScenarioError
        If it slides spontaneously below the smallest load of the kicks, or if its runs would be unstable.
    RuntimeError
        If a run blows up.

    Examples
    --------
    >>> import stickslip as ss
    >>> short = ss.scenario(
    ...     experiment="threshold",
    ...     sample={"kind": "disk-array", "disks": 3},
    ...     load={"loads": [0.0, 0.02], "step": 0.01},
    ...     kicks={"velocities": [1e-9], "realizations": 2, "duration": 100.0},
    ... )
    >>> simulate_threshold(short, workers=1).found.slid.tolist()
    [[0], [0]]
    """
    kept = checkpoint_in(folder, scenario, Outcome, Status, Gouge, PackingInfo)
    state, protocol = make_sample(scenario, kept, report)
    wanted, how = scenario.load.loads, scenario.kicks
    loads = load_path((0.0, wanted[-1]), scenario.load.step, wanted) if wanted[-1] else np.zeros(1)
    path, strength = raise_load(state, loads, protocol, how.distance, kept and kept.of("path"), report)
    tried = [load for load in wanted if load <= path[-1].load]
    if not tried:
        if kept:
            abandon(kept)
        raise ScenarioError(
            f"the sample slides spontaneously at a load of {strength:.4g}, below all of load.loads: add smaller loads"
        )
    dt = _time_step(how, path[0].state, protocol.law)
    threshold = kinetic_threshold(
        path, protocol, loads=tried, kicks=how.velocities, realizations=how.realizations, duration=how.duration, dt=dt,
        distance=how.distance, ramps=how.ramps if how.ramp_down else 0, drag=how.drag, seed=scenario.seed,
        workers=workers, kept=kept and kept.of("runs"), report=report,
    )  # fmt: skip
    return ThresholdResult(scenario, protocol.law, path, strength, threshold)
