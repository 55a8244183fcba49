"""Static and kinetic friction of a sample: raise the load, kick the sample, lower the load, and write the results."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, NotInEquilibriumError, Outcome, State, Status
from ....kit import (  # fmt: skip
    KICK_LEGS,
    Checkpoint,
    Fields,
    Measures,
    Quantities,
    Quantity,
    Report,
    ScenarioError,
    Workers,
    abandon,
    archive_fields,
    checked,
    checkpoint_in,
    console,
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
from ....results import Equilibrium, FastestPair, KineticThreshold, PackingInfo
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
        static = f"slid spontaneously at {self.strength:.4g}" if np.isfinite(self.strength) else "did not slide"
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
    """Find equilibria along rising loads until the sample slides; return them and the load at which it slides, or NaN.

    The sample slides if there is no equilibrium, or only one that is farther away than `distance`.
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
        If the sample slides spontaneously below the smallest load of the kicks, or if its runs would be unstable.
    RuntimeError
        If a run becomes numerically unstable.

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


LABEL = {
    "disk-array": "push over normal force",
    "packing": "shear stress over normal stress",
    "gouge": "shear force over normal force",
}


def figures(result: ThresholdResult):
    """Yield (file name, Figure) of a run."""
    from ....figures import static_and_kinetic

    label = LABEL[result.scenario.sample.kind]
    yield "fig1_static_and_kinetic.png", static_and_kinetic(result.found, label=label, strength=result.strength)


class Kicked(NamedTuple):
    """Kicked runs at one load and one velocity."""

    load: float
    pairs: int
    velocity: float
    runs: int
    slid: int
    lasting: int
    lifetime: float


KICKED = Quantities([
    Quantity("load", "1", "load at which the sample is kicked"),
    Quantity("velocity", "length/time", "root mean square velocity of a kick"),
    Quantity("runs", "1", "number of runs"),
    Quantity("slid", "1", "runs that slid"),
    Quantity("share", "1", "fraction that slid", lambda kicked: kicked.slid / kicked.runs),
    Quantity("lasting", "1", "runs that slid and continued"),
    Quantity("lasting share", "1", "fraction that slid and continued", lambda kicked: kicked.lasting / kicked.runs),
    Quantity("median lifetime", "time", "median time until a run slid", "lifetime"),
])  # fmt: skip


def files(result: ThresholdResult):
    """Yield (file name, function that writes it) for the outcomes at each load and velocity."""
    yield "threshold.csv", lambda path: KICKED.write(path, _outcomes(result), digits=None)


def _outcomes(result: ThresholdResult):
    """Outcomes at all loads and velocities."""
    kinetic = result.found
    pairs = {point.load: len(point.spectrum.pairs) for point in result.path}
    for row, load in enumerate(kinetic.loads):
        for column, kick in enumerate(kinetic.kicks):
            counts = (int(values[row, column]) for values in (kinetic.runs, kinetic.slid, kinetic.lasting))
            yield Kicked(float(load), pairs[float(load)], float(kick), *counts, float(kinetic.lifetime[row, column]))


def numbers(result: ThresholdResult) -> dict:
    """Return the contents of the archive, besides scenario and version."""
    path, kept = result.path, set(result.found.loads)
    return {
        "law": result.law,
        "path": Fields(
            {
                "load": np.array([point.load for point in path]),
                "pairs": np.array([len(point.spectrum.pairs) for point in path]),
                "growth_rate": np.array([point.spectrum.growth_rate.max(initial=0.0) for point in path]),
            },
            FastestPair,
        ),
        "frames": {f"{point.load:.6f}": point.state for point in path if point.load in kept},
        "threshold": archive_fields(result.found),
        "strength": result.strength,
    }


def show(result: ThresholdResult) -> None:
    """Print a summary of a run in the terminal."""
    table = Quantities([*KICKED.values(), Quantity("pairs", "1", "complex pairs at this load")])
    names = ("load", "pairs", "velocity", "runs", "slid", "lasting", "median lifetime")
    table.show_rows(_outcomes(result), *names, title="Kicked runs")
    for sentence in result.sentences:
        console.print(f"  {sentence}", soft_wrap=True)
    if left := [load for load in result.scenario.load.loads if load > result.path[-1].load]:
        console.print(
            f"No kicks at {', '.join(f'{load:.4g}' for load in left)}, where the sample slides spontaneously.",
            style="yellow", soft_wrap=True,
        )  # fmt: skip


def _by_kick(name: str, meaning: str, of) -> Quantity:
    """Quantity at each kick velocity; `of` is a function that returns an array for a KineticThreshold."""
    return Quantity(name, "1", meaning, lambda r: dict(zip(r.found.kicks, of(r.found), strict=True)))


MEASURES = Measures([
    _by_kick("threshold", "load at which half of the runs slide after kicks of this velocity", lambda f: f.threshold),
    _by_kick("threshold_low", "lower end of the interval of that load", lambda f: f.interval[:, 0]),
    _by_kick("threshold_high", "upper end of the interval of that load", lambda f: f.interval[:, 1]),
    _by_kick("largest_share", "largest fraction of runs that slide", lambda f: f.probability.max(axis=0)),
    _by_kick("lasting_threshold", "load at which half of the runs slide and continue", lambda f: f.lasting_threshold),
    _by_kick("lasting_threshold_low", "lower end of the interval of that load", lambda f: f.lasting_interval[:, 0]),
    _by_kick("lasting_threshold_high", "upper end of the interval of that load", lambda f: f.lasting_interval[:, 1]),
    _by_kick("largest_lasting_share", "largest fraction of runs that slide and continue",
             lambda f: f.lasting_probability.max(axis=0)),
    Quantity("arrest_low", "1", "lower end of the range of loads at which sliding stops as the load decreases",
             lambda r: r.found.arrest_range[0]),
    Quantity("arrest_high", "1", "upper end of this range", lambda r: r.found.arrest_range[1]),
    Quantity("strength", "1", "load at which the sample slides without a kick"),
    Quantity("first_pair", "1", "smallest load with a complex pair", "found.first_pair"),
    Quantity("first_limit", "1", "smallest load with a contact at the Coulomb limit", "found.first_limit"),
])  # fmt: skip
