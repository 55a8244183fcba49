"""Output of sheared packings: files in the run folder, and terminal summary."""

from typing import NamedTuple

from ....kit import Measures, Quantities, Quantity, archive_fields, console, median, pluralize, quantities_of
from ....results import Released
from . import figures as figures_of
from .simulate import ShearPath, ShearResult


def figures(result: ShearResult):
    """Yield (file name, Figure) for each figure of a run."""
    yield "fig1_complex_pairs.png", figures_of.pairs_along_strain(result.paths, result.scenario.shear.strain[1])
    runs = [r for r in (*result.single, *result.later) if r]
    if not runs:
        return
    shown = max(runs, key=lambda r: (r.growth is not None, r.pairs == 1, r.msd[-1]))
    if len(shown.snapshot_time):
        yield "fig2_spectrum_in_time.png", figures_of.spectrum_in_time(shown)
    yield "fig3_growth.png", figures_of.growth(shown)
    yield "fig4_trajectories.png", figures_of.trajectories(shown, result.scenario.packing.dim)
    later = [r for r in result.later if r and r is not shown]
    violent = max(later, key=lambda r: r.msd[-1], default=None)
    yield "fig5_stress.png", figures_of.stress_through_failure(shown, violent)


def numbers(result: ShearResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    out = {"scenario": result.scenario.text, "law": result.law, "units": "2 sigma_1 = m = k_n = 1"}
    for name, items in (("paths", result.paths), ("single", result.single), ("later", result.later)):
        out[name] = {
            f"{path.seed:03d}": archive_fields(item)
            for path, item in zip(result.paths, items, strict=True)
            if item is not None
        }
    return out


def show(result: ShearResult) -> None:
    """Print a summary of a run on the terminal."""
    PACKING.show_rows(_sheared(result), title="Sheared packings")
    for p in result.paths:
        steps = pluralize(len(p.strain), "step")
        ends = f"{p.unstable} ended at an unstable equilibrium and {p.left} left their branch"
        console.print(f"packing {p.seed}: of {steps}, {ends}")
        if p.stopped:
            console.print(f"packing {p.seed} stopped early: {p.stopped}", style="yellow")
    if runs := [r for r in (*result.single, *result.later) if r]:
        RUN.show_rows(runs, title="Newtonian runs")
    for failure in result.failures:
        console.print(failure, style="yellow")


class Sheared(NamedTuple):
    """A packing: its path, and the runs from the state with one pair and from the last state."""

    path: ShearPath
    single: Released | None
    later: Released | None


def _sheared(result: ShearResult) -> list[Sheared]:
    return [*map(Sheared, result.paths, result.single, result.later)]


NAN, STRESS = float("nan"), "force/length^(dim-1)"
RUN = Quantities([
    *quantities_of(Released, "strain", "pairs", "growth_rate").values(),
    Quantity("fitted", "1/time", "growth rate fitted to M", "growth.growth_rate"),
    Quantity("last M", "length^2", "M at the end", lambda run: run.msd[-1]),
    Quantity("drop/p", "1", "drop of the shear stress over the first pressure", lambda run: run.drop / run.pressure[0]),
    Quantity("contacts_lost", "1", "contacts lost"),
])  # fmt: skip
MEASURES = Measures([
    Quantity("packing_fraction", "1", "packing fraction before shear", "path.packed.packing_fraction"),
    Quantity("packing_pressure", STRESS, "pressure before shear", "path.packed.pressure"),
    Quantity("coordination", "1", "mean contact number before shear", "path.packed.coordination"),
    Quantity("rattlers", "1", "rattlers before shear", "path.packed.rattlers"),
    Quantity("onset_strain", "1", "strain at which the first pair is born", "path.onset.strain"),
    Quantity("onset_exponent", "1", "exponent of Im λ as a function of the distance from onset", "path.onset.exponent"),
    Quantity("onset_share_at_limit", "1", "fraction of contacts at the Coulomb limit at onset", "path.onset.at_limit"),
    Quantity("onset_mobilisation", "1", "largest |F_t|/(μ F_n) at onset", "path.onset.mobilisation"),
    Quantity("pairs_at_last_strain", "1", "complex pairs at the last strain", lambda s: s.path.pairs[-1]),
    Quantity("unstable_steps", "1", "steps that ended at an unstable equilibrium", "path.unstable"),
    Quantity("steps_off_branch", "1", "steps that left their branch", "path.left"),
    Quantity("largest_growth_rate", "1/time", "largest growth rate of a pair", lambda s: s.path.growth_rate.max()),
    Quantity("shear_stress_at_last_strain", STRESS, "last shear stress", lambda s: s.path.shear_stress[-1]),
    Quantity("fitted_over_predicted_growth", "1", "growth rate fitted to M, over that from the spectrum",
             lambda s: s.single.growth.growth_rate / s.single.corrected_rate if s.single and s.single.growth else NAN),
    Quantity("stress_drop_over_pressure", "1", "drop of the shear stress in the last run, over its initial pressure",
             lambda s: RUN["drop/p"].of(s.later) if s.later else NAN),
    Quantity("contacts_lost", "1", "contacts lost in the last run", "later.contacts_lost"),
], samples=_sheared, over=median)  # fmt: skip
PACKING = Quantities([
    Quantity("packing", "1", "seed of the packing", "path.seed"),
    *(MEASURES[name] for name in ("packing_fraction", "packing_pressure", "coordination", "rattlers")),
    Quantity("first pair", "1", "strain at which the first pair is born", lambda s:
             f"{s.path.onset.strain:.6g}" if s.path.onset else "at the start" if s.path.pairs[0] else "never"),
    MEASURES["pairs_at_last_strain"],
])  # fmt: skip
