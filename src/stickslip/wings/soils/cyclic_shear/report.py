"""Output of cyclic shear: table of cycles, loops, figures, archive and terminal summary."""

import numpy as np

from ....kit import archive_fields, console, new_table, pluralize, show_table, unit_name
from ..element_test.report import for_engineers
from . import figures as figures_of
from .measures import (
    CYCLE,
    LOOP,
    MEASURES,
    PARTS,
    STRESS,
    band,
    kind_of,
    largest_modulus,
    last_cycles,
    loops_of,
    sentences,
)  # fmt: skip
from .simulate import CyclicShearResult

SHOWN = ("G", "G_ratio", "damping", "storage", "loss", "sliding", "residual", "returned")


def files(result: CyclicShearResult):
    """Yield (file name, function that writes it) for the cycles and the loops of all samples."""
    yield "cycles.csv", lambda path: CYCLE.write(path, loops_of(result))
    yield "series.csv", lambda path: LOOP.write(path, loops_of(result))


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
    yield "fig4_work.png", figures_of.work(tables[0], tuple(PARTS))
    returns = {r.amplitude: np.diagonal(r.distance, 1) for r in first.responses}
    kinds = {r.amplitude: kind_of(r) for r in first.responses}
    yield "fig5_return.png", figures_of.returns(returns, kinds)


def numbers(result: CyclicShearResult) -> dict:
    """Return the contents of the archive, besides scenario and version."""
    runs = {f"{run.seed:04d}": run for run in result.runs} | ({"finer": result.checked} if result.checked else {})
    return {
        "law": result.law,
        "samples": {
            name: {
                "packed": archive_fields(run.packed), "modulus": run.modulus, "end": run.end, "ended": run.ended,
                "responses": {f"{k:03d}": archive_fields(each) for k, each in enumerate(run.responses)},
            }
            for name, run in runs.items()
        },
        "failures": "\n".join(result.failures),
    }  # fmt: skip


def show(result: CyclicShearResult) -> None:
    """Print the last cycle at each amplitude of the first sample, the numbers of all samples, and remarks."""
    scenario, first = result.scenario, result.runs[0]
    title = f"cyclic shear of {pluralize(len(result.runs), 'sample')} of {scenario.sample.grains} grains"
    columns, unit = last_cycles(first), for_engineers(0, unit_name(STRESS))[1]
    words = [f"{name} [{unit}]" if CYCLE[name].unit == STRESS else name for name in SHOWN]
    table = new_table("γ₀", *words, "", title=f"{title}: last cycles of sample {first.seed}", left=("",))
    for k, kind in enumerate(columns["kind"]):
        values = [for_engineers(columns[name][k], unit_name(CYCLE[name].unit))[0] for name in SHOWN]
        cells = [f"{value:.3g}" if np.isfinite(value) else "–" for value in values]
        table.add_row(f"{columns['amplitude'][k]:g}", *cells, kind)
    show_table(table)
    above = [name for name in MEASURES.of(result) if "@" in name] if len(result.runs) < 2 else []
    MEASURES.show(result, title=title, readable=for_engineers, without=above)
    for sentence in (*sentences(result), *result.failures):
        console.print(f"  {sentence}", soft_wrap=True)
