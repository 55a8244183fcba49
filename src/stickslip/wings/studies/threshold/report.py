"""Output of the static and kinetic friction of a sample: files in the run folder and the summary on the terminal."""

from functools import partial
from pathlib import Path

import numpy as np

from ....data.run_files import THRESHOLD
from ....figures import static_and_kinetic
from ....kit import Fields, archive_fields, console, heading, new_table, show_table, write_table
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


def files(result: ThresholdResult):
    """Yield (file name, function that writes it) for the outcomes at each load and velocity."""
    yield THRESHOLD, partial(_write_outcomes, result)


def _write_outcomes(result: ThresholdResult, path: Path) -> None:
    velocity, lifetime = heading("velocity", "length/time"), heading("median lifetime", "time")
    names = ("load", velocity, "runs", "slid", "share", "lasting", "lasting share", lifetime)
    rows = (
        (load, kick, runs, slid, slid / runs, lasting, lasting / runs, time)
        for load, _, kick, runs, slid, lasting, time in _outcomes(result)
    )
    write_table(path, names, rows, digits=None)


def _outcomes(result: ThresholdResult):
    """Rows (load, number of complex pairs, velocity, runs, slid, lasting, lifetime)."""
    kinetic = result.found
    pairs = {point.load: len(point.spectrum.pairs) for point in result.path}
    for row, load in enumerate(kinetic.loads):
        for column, kick in enumerate(kinetic.kicks):
            yield (
                float(load), pairs[float(load)], float(kick), int(kinetic.runs[row, column]),
                int(kinetic.slid[row, column]), int(kinetic.lasting[row, column]), float(kinetic.lifetime[row, column]),
            )  # fmt: skip


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
    units = {"velocity": "length/time", "median lifetime": "time"}
    names = ("load", "pairs", "velocity", "slid", "lasting", "median lifetime")
    table = new_table(*names, title="Kicked runs", units=units)
    for load, pairs, kick, runs, slid, lasting, lifetime in _outcomes(result):
        time = f"{lifetime:.4g}" if np.isfinite(lifetime) else "–"
        table.add_row(f"{load:.4g}", str(pairs), f"{kick:.3g}", f"{slid} of {runs}", f"{lasting} of {runs}", time)
    show_table(table)
    for sentence in result.sentences:
        console.print(f"  {sentence}", soft_wrap=True)
    if left := [load for load in result.scenario.load.loads if load > result.path[-1].load]:
        console.print(
            f"No kicks at {', '.join(f'{load:.4g}' for load in left)}: the sample slides by itself there.",
            style="yellow", soft_wrap=True,
        )  # fmt: skip


def measures(result: ThresholdResult) -> dict[str, tuple[float, str]]:
    """Return the measures of a run for sweeps as {name: (value, unit)}; loads are shear force over normal force."""
    kinetic, out = result.found, {}
    for which, at, interval, share in (
        ("", kinetic.threshold, kinetic.interval, kinetic.probability),
        ("lasting_", kinetic.lasting_threshold, kinetic.lasting_interval, kinetic.lasting_probability),
    ):
        for k, kick in enumerate(kinetic.kicks):
            out |= {
                f"{which}threshold@{kick:g}": (at[k], "1"), f"{which}threshold_low@{kick:g}": (interval[k, 0], "1"),
                f"{which}threshold_high@{kick:g}": (interval[k, 1], "1"),
                f"largest_{which}share@{kick:g}": (share[:, k].max(), "1"),
            }  # fmt: skip
    low, high = kinetic.arrest_range
    return out | {
        "arrest_low": (low, "1"), "arrest_high": (high, "1"), "strength": (result.strength, "1"),
        "first_pair": (kinetic.first_pair, "1"), "first_limit": (kinetic.first_limit, "1"),
    }  # fmt: skip
