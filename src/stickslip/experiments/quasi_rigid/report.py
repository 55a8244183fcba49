"""Output of quasi-rigid loading: files in the run folder and the summary on the terminal."""

from functools import partial
from pathlib import Path

import numpy as np

from ...core.tables import write_table
from ...core.units import Fields, units_of
from ...data.nodes import archive_fields
from ...data.run_files import SERIES
from ...figures import quasi_rigid as figures_of
from ...figures.grains import packing
from ...reports.terminal import console, new_table, show_table
from .simulate import Curve, QuasiResult, SampleResult, SlowDynamics


def figures(result: QuasiResult):
    """Yield (file name, Figure) for each figure of a run."""
    longest = max(result.tested, key=lambda one: len(one.path.events))
    yield "fig1_curves.png", figures_of.curves(result.tested, result.scenario.loading.test)
    end = longest.path.points[-1]
    title = f"sample {longest.seed} where its path ends, load {end.load:.4g}"
    yield "fig2_statuses.png", packing(end.state, longest.law, title=title)
    if len(longest.pairs):
        yield "fig3_cone.png", figures_of.cone(longest, result.scenario.law.mu)
    yield "fig4_stiffness.png", figures_of.stiffness(longest)
    if result.scenario.dynamics.times:
        yield "fig5_dynamics.png", figures_of.errors(result.tested)


def files(result: QuasiResult):
    """Yield (file name, function that writes it) for the curves as CSV."""
    yield SERIES, partial(_write_curves, result)


def numbers(result: QuasiResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    return {
        "scenario": result.scenario.text,
        "units": "those of the scenario; loads are shares of the change from the first to the last load",
        "samples": {f"{one.seed:03d}": _sample(one) for one in result.tested},
    }


def _sample(one: SampleResult) -> dict:
    path, events = one.path, one.path.events
    out = {
        "law": one.law,
        "path": {
            "verdict": path.verdict.value,
            "load": path.load,
            "sliding": np.array([p.sliding for p in path.points]),
            "contacts": np.array([p.contacts for p in path.points]),
            "residual": np.array([p.residual for p in path.points]),
        },
        "events": {
            "load": np.array([e.load for e in events]),
            "kind": "\n".join(e.kind for e in events),
            "bodies": np.array([[e.i, e.j] for e in events]).reshape(-1, 2),
        },
        "curve": archive_fields(one.curve),
        "looks": archive_fields(one.looks),
        "slow": {
            f"{run.time:g}": Fields(
                {"error": run.error, "kinetic_energy": run.kinetic_energy} | run.curve._asdict(), SlowDynamics, Curve
            )
            for run in one.slow
        },
        "contacts": Fields({"bodies": one.pairs, "force": one.forces}, force=units_of(SampleResult)["forces"]),
        "frames": {"start": path.states[0], "end": path.states[-1]},
    }
    if one.back is not None:
        out["unloading"] = archive_fields(one.back)
    if one.collapse is not None:
        out["collapse"] = one.collapse
    return out


def _write_curves(result: QuasiResult, path: Path) -> None:
    """Write one row per point: sample, curve, load, strain, volumetric strain, stress ratio."""
    curves = []
    for one in result.tested:
        curves.append((one.seed, "path", one.curve))
        curves += [] if one.back is None else [(one.seed, "unloading", one.back)]
        curves += [(one.seed, f"dynamics {run.time:g}", run.curve) for run in one.slow]
    names = ("sample", "curve", "load", "strain", "volumetric_strain", "stress_ratio")
    write_table(path, names, ((seed, name, *row) for seed, name, curve in curves for row in zip(*curve, strict=True)))


def show(result: QuasiResult) -> None:
    """Print the end of every path on the terminal."""
    names = ("sample", "ends at", "ratio", "strain", "sliding", "events", "error", "collapse")
    table = new_table(*names, title="Paths, strain error of the slowest dynamics, and its collapse load")
    for one in result.tested:
        last = one.path.points[-1]
        off = min(one.slow, key=lambda run: -run.time).error if one.slow else None
        table.add_row(
            str(one.seed), f"{last.load:.4g}", f"{one.curve.ratio[-1]:.4g}", f"{one.curve.strain[-1]:.2e}",
            f"{last.sliding}/{last.contacts}", str(len(one.path.events)), "–" if off is None else f"{off:.1e}",
            "–" if one.collapse is None else f"{one.collapse:.4g}",
        )  # fmt: skip
    show_table(table)
    for one in result.tested:
        end = one.path.summary
        console.print(f"  sample {one.seed}: {end}")
    for failure in result.failures:
        console.print(failure, style="yellow")


def measures(result: QuasiResult) -> dict[str, tuple[float, str]]:
    """Return the measures of a run for sweeps as {name: (value, unit)}: medians over samples, loads as shares."""
    slowest = [min(one.slow, key=lambda run: -run.time) for one in result.tested if one.slow]
    columns = {
        "last_load": [one.path.load[-1] for one in result.tested],
        "stress_ratio": [one.curve.ratio[-1] for one in result.tested],
        "strain": [one.curve.strain[-1] for one in result.tested],
        "events": [len(one.path.events) for one in result.tested],
        "sliding_share": [p.sliding / max(p.contacts, 1) for p in (one.path.points[-1] for one in result.tested)],
        "error_of_slowest_dynamics": [run.error for run in slowest],
        "collapse_load": [one.collapse for one in result.tested if one.collapse is not None],
    }
    return {name: (float(np.median(values)) if values else np.nan, "1") for name, values in columns.items()}
