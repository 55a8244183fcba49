"""Output of sheared packings: files in the run folder and the summary on the terminal."""

import numpy as np

from ....kit import archive_fields, console, new_table, pluralize, show_table
from . import figures as figures_of
from .simulate import ShearResult


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
    names = ("packing", "φ", "pressure", "z", "rattlers", "first pair", "pairs at the end")
    table = new_table(*names, title="Sheared packings", units={"pressure": "force/length^(dim-1)"})
    for p in result.paths:
        born = f"{p.onset.strain:.6g}" if p.onset else "at the start" if p.pairs[0] else "never"
        table.add_row(
            str(p.seed), f"{p.packed.packing_fraction:.4g}", f"{p.packed.pressure:.3g}",
            f"{p.packed.coordination:.3g}", str(p.packed.rattlers), born, f"{p.pairs[-1]:.0f} at {p.strain[-1]:.4g}",
        )  # fmt: skip
    show_table(table)
    for p in result.paths:
        steps = pluralize(len(p.strain), "step")
        ends = f"{p.unstable} ended at an unstable equilibrium and {p.left} left their branch"
        console.print(f"packing {p.seed}: of {steps}, {ends}")
        if p.stopped:
            console.print(f"packing {p.seed} stopped early: {p.stopped}", style="yellow")
    runs = [r for r in (*result.single, *result.later) if r]
    if runs:
        units = {"growth rate": "1/time", "fitted": "1/time", "last M": "length^2"}
        table = new_table("strain", "pairs", *units, "drop/p", "contacts lost", title="Newtonian runs", units=units)
        for r in runs:
            fitted = f"{r.growth.growth_rate:.4e}" if r.growth else "–"
            table.add_row(
                f"{r.strain:.4g}", str(r.pairs), f"{r.growth_rate:.4e}", fitted, f"{r.msd[-1]:.1e}",
                f"{r.drop / r.pressure[0]:.3g}", str(r.contacts_lost),
            )  # fmt: skip
        show_table(table)
    for failure in result.failures:
        console.print(failure, style="yellow")


def measures(result: ShearResult) -> dict[str, tuple[float, str]]:
    """Return the measures of a run for sweeps as {name: (value, unit)}: medians over packings, NaN where none exist."""
    paths, runs = result.paths, [r for r in result.single if r]
    fitted = [r.growth.growth_rate / r.corrected_rate for r in runs if r.growth]
    columns = {
        "packing_fraction": ([p.packed.packing_fraction for p in paths], "1"),
        "packing_pressure": ([p.packed.pressure for p in paths], "force/length^(dim-1)"),
        "coordination": ([p.packed.coordination for p in paths], "1"),
        "rattlers": ([p.packed.rattlers for p in paths], "1"),
        "onset_strain": ([p.onset.strain for p in paths if p.onset], "1"),
        "onset_exponent": ([p.onset.exponent for p in paths if p.onset], "1"),
        "onset_share_at_limit": ([p.onset.at_limit for p in paths if p.onset], "1"),
        "onset_mobilisation": ([p.onset.mobilisation for p in paths if p.onset], "1"),
        "pairs_at_last_strain": ([p.pairs[-1] for p in paths], "1"),
        "unstable_steps": ([p.unstable for p in paths], "1"),
        "steps_off_branch": ([p.left for p in paths], "1"),
        "largest_growth_rate": ([p.growth_rate.max() for p in paths], "1/time"),
        "shear_stress_at_last_strain": ([p.shear_stress[-1] for p in paths], "force/length^(dim-1)"),
        "fitted_over_predicted_growth": (fitted, "1"),
        "stress_drop_over_pressure": ([r.drop / r.pressure[0] for r in result.later if r], "1"),
        "contacts_lost": ([r.contacts_lost for r in result.later if r], "1"),
    }
    return {name: (float(np.median(values)) if values else np.nan, unit) for name, (values, unit) in columns.items()}
