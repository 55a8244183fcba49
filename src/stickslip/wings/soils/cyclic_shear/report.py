"""Output of cyclic shear: table of cycles, loops, figures, archive and terminal summary."""

from functools import partial
from pathlib import Path

import numpy as np

from ....data.run_files import CYCLES, SERIES
from ....kit import archive_fields, console, heading, new_table, pluralize, show_table, unit_name, write_table
from ..element_test.report import for_engineers
from . import figures as figures_of
from .measures import (
    CYCLE_UNITS,
    MEANING,
    PARTS,
    STRESS,
    cycle_numbers,
    estimates,
    kind_of,
    largest_modulus,
    last_cycles,
    sentences,
    units_of,
)
from .sands import band
from .simulate import CyclicRun, CyclicShearResult

LOOPS = {"gamma": "1", "tau": STRESS, "normal": STRESS, "pressure": STRESS, "height": "1", "rearranged": "1"}
SHOWN = ("G", "G_ratio", "damping", "storage", "loss", "sliding", "residual", "returned")


def _write_cycles(result: CyclicShearResult, path: Path) -> None:
    """Table of all cycles: sample, kind of the amplitude, and numbers of the cycle."""
    names = ["sample", "kind", *(heading(name, unit) for name, unit in CYCLE_UNITS.items())]
    rows = (
        (run.seed, kind_of(response), *cycle_numbers(run, response, k).values())
        for run in result.runs
        for response in run.responses
        for k in range(len(response.gamma))
    )
    write_table(path, names, rows)


def _write_loops(result: CyclicShearResult, path: Path) -> None:
    """Table of all equilibria."""
    names = ["sample", "amplitude", "cycle", *(heading(name, unit) for name, unit in LOOPS.items())]
    rows = (
        (run.seed, response.amplitude, k + 1, *map(float, row))
        for run in result.runs
        for response in run.responses
        for k in range(len(response.gamma))
        for row in zip(*(getattr(response, name)[k] for name in LOOPS), strict=True)
    )
    write_table(path, names, rows)


def files(result: CyclicShearResult):
    """Yield (file name, function that writes it) for the cycles and the loops of all samples."""
    yield CYCLES, partial(_write_cycles, result)
    yield SERIES, partial(_write_loops, result)


def figures(result: CyclicShearResult):
    """Yield (file name, Figure) of a run."""
    first, tables, sample = result.runs[0], [last_cycles(run) for run in result.runs], result.scenario.sample
    scale = largest_modulus(first)
    loops = {r.amplitude: (r.gamma / r.amplitude, r.tau / (scale * r.amplitude)) for r in first.responses}
    yield "fig1_loops.png", figures_of.loops(loops)
    gamma, sands = np.geomspace(1e-6, 1e-2, 200), None
    if sample.dim == 3 and result.scenario.units == "SI":
        sands = {"amplitude": gamma} | band(sample.pressure, gamma)
    yield "fig2_modulus_and_damping.png", figures_of.modulus_and_damping(tables, sands)
    yield "fig3_moduli.png", figures_of.complex_modulus(tables, [largest_modulus(run) for run in result.runs])
    yield "fig4_work.png", figures_of.work(tables[0], PARTS)
    returns = {r.amplitude: np.diagonal(r.distance, 1) for r in first.responses}
    kinds = {r.amplitude: kind_of(r) for r in first.responses}
    yield "fig5_return.png", figures_of.returns(returns, kinds)


def numbers(result: CyclicShearResult) -> dict:
    """Return the contents of the archive, besides scenario and version."""
    runs = {f"{run.seed:04d}": run for run in result.runs} | ({"finer": result.checked} if result.checked else {})
    return {
        "law": result.law,
        "samples": {name: _contents(run) for name, run in runs.items()},
        "failures": "\n".join(result.failures),
    }


def _contents(run: CyclicRun) -> dict:
    responses = {f"{k:03d}": archive_fields(response) for k, response in enumerate(run.responses)}
    return {
        "packed": archive_fields(run.packed),
        "modulus": run.modulus,
        "responses": responses,
        "end": run.end,
        "ended": run.ended,
    }


def show(result: CyclicShearResult) -> None:
    """Print the last cycle at each amplitude of the first sample, the numbers of all samples, and what limits them."""
    scenario, first = result.scenario, result.runs[0]
    title = f"cyclic shear of {pluralize(len(result.runs), 'sample')} of {scenario.sample.grains} grains"
    columns, unit = last_cycles(first), for_engineers(0, unit_name(STRESS))[1]
    words = [f"{name} [{unit}]" if CYCLE_UNITS[name] == STRESS else name for name in SHOWN]
    table = new_table("γ₀", *words, "", title=f"{title}: last cycles of sample {first.seed}", left=("",))
    for k, response in enumerate(first.responses):
        values = [for_engineers(columns[name][k], unit_name(CYCLE_UNITS[name]))[0] for name in SHOWN]
        cells = [f"{value:.3g}" if np.isfinite(value) else "–" for value in values]
        table.add_row(f"{response.amplitude:g}", *cells, kind_of(response))
    show_table(table)
    table = new_table("", "mean", "95 % ±", "unit", "", title=title, left=("", "unit"))
    units = units_of(scenario)
    for name, number in estimates(result).items():
        if "@" in name and len(result.runs) < 2:  # as in the table above
            continue
        (mean, half), unit = for_engineers(np.array(number[:2]), unit_name(units[name]))
        width = f"{half:.2g}" if np.isfinite(half) else "–"
        table.add_row(name, f"{mean:.4g}", width, "" if unit == "1" else unit, MEANING[name.split("@")[0]])
    show_table(table)
    for sentence in (*sentences(result), *result.failures):
        console.print(f"  {sentence}", soft_wrap=True)
