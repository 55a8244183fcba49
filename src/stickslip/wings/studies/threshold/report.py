"""Output for the static and kinetic friction of a sample: files in the run folder, and terminal summary."""

from typing import NamedTuple

import numpy as np

from ....figures import static_and_kinetic
from ....kit import Fields, Measures, Quantities, Quantity, archive_fields, console  # fmt: skip
from ....results import FastestPair
from .simulate import ThresholdResult

LABEL = {
    "disk-array": "push over normal force",
    "packing": "shear stress over normal stress",
    "gouge": "shear force over normal force",
}


def figures(result: ThresholdResult):
    """Yield (file name, Figure) of a run."""
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
    """Print a summary of a run on the terminal."""
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
    _by_kick("threshold", "load at which half of the runs slide, after kicks of a velocity", lambda f: f.threshold),
    _by_kick("threshold_low", "lower end of the interval of that load", lambda f: f.interval[:, 0]),
    _by_kick("threshold_high", "upper end of the interval of that load", lambda f: f.interval[:, 1]),
    _by_kick("largest_share", "largest fraction of runs that slide", lambda f: f.probability.max(axis=0)),
    _by_kick("lasting_threshold", "load at which half of the runs slide and continue", lambda f: f.lasting_threshold),
    _by_kick("lasting_threshold_low", "lower end of the interval of that load", lambda f: f.lasting_interval[:, 0]),
    _by_kick("lasting_threshold_high", "upper end of the interval of that load", lambda f: f.lasting_interval[:, 1]),
    _by_kick("largest_lasting_share", "largest fraction of runs that slide and continue",
             lambda f: f.lasting_probability.max(axis=0)),
    Quantity("arrest_low", "1", "lower end of the loads at which sliding stops as the load decreases",
             lambda r: r.found.arrest_range[0]),
    Quantity("arrest_high", "1", "upper end of these loads", lambda r: r.found.arrest_range[1]),
    Quantity("strength", "1", "load at which the sample slides without a kick"),
    Quantity("first_pair", "1", "smallest load with a complex pair", "found.first_pair"),
    Quantity("first_limit", "1", "smallest load with a contact at the Coulomb limit", "found.first_limit"),
])  # fmt: skip
