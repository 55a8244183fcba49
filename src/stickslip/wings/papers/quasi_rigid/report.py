"""Output of quasi-rigid loading: files in the run folder and the summary on the terminal."""

from functools import partial
from pathlib import Path

import numpy as np

from .... import figures as common_figures
from ....kit import Fields, archive_fields, console, new_table, run_files, show_table, units_of, write_table
from ...status.collapse import Collapse
from . import figures as figures_of
from .simulate import Curve, QuasiResult, SampleResult, SlowDynamics


def figures(result: QuasiResult):
    """Yield (file name, Figure) for each figure of a run."""
    longest = max(result.tested, key=lambda sample: len(sample.path.events))
    yield "fig1_curves.png", figures_of.curves(result.tested, result.scenario.loading.test)
    end = longest.path.points[-1]
    title = f"sample {longest.seed} where its path ends, load {end.load:.4g}"
    yield "fig2_statuses.png", common_figures.packing(end.state, longest.law, title=title)
    if len(longest.pairs):
        yield "fig3_cone.png", figures_of.cone(longest, result.scenario.law.mu)
    yield "fig4_stiffness.png", figures_of.stiffness(longest)
    if result.scenario.dynamics.times:
        yield "fig5_dynamics.png", figures_of.errors(result.tested)


def files(result: QuasiResult):
    """Yield (file name, function that writes it) for the curves and collapses as CSV."""
    yield run_files.SERIES, partial(_write_curves, result)
    if result.scenario.loading.collapses:
        yield run_files.COLLAPSES, partial(_write_collapses, result)


def numbers(result: QuasiResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    return {
        "scenario": result.scenario.text,
        "units": "those of the scenario; loads are shares of the change from the first to the last load",
        "samples": {f"{sample.seed:03d}": _sample(sample) for sample in result.tested},
    }


def _sample(sample: SampleResult) -> dict:
    path, events = sample.path, sample.path.events
    columns = {name: np.array([getattr(event, name) for event in path.collapses]) for name in Collapse._fields}
    reasons = "\n".join(columns.pop("reason").tolist())
    out = {
        "law": sample.law,
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
        "collapses": Fields(columns | {"reason": reasons}, Collapse),
        "curve": archive_fields(sample.curve),
        "looks": archive_fields(sample.looks),
        "slow": {
            f"{run.time:g}": Fields(
                {"error": run.error, "kinetic_energy": run.kinetic_energy} | run.curve._asdict(), SlowDynamics, Curve
            )
            for run in sample.slow
        },
        "contacts": Fields({"bodies": sample.pairs, "force": sample.forces}, force=units_of(SampleResult)["forces"]),
        "frames": {"start": path.states[0], "end": path.states[-1]},
    }
    if sample.back is not None:
        out["unloading"] = archive_fields(sample.back)
    if sample.collapse is not None:
        out["collapse"] = sample.collapse
    return out


def _write_collapses(result: QuasiResult, path: Path) -> None:
    """Write one row per collapse."""
    names = [name for name in Collapse._fields if name not in ("reason", "strain", "direction", "sliding")]
    rows = (
        (sample.seed, *(float(getattr(event, name)) for name in names), *event.sliding)
        for sample in result.tested
        for event in sample.path.collapses
    )
    write_table(path, ("sample", *names, "sliding_before", "sliding_after"), rows)


def _write_curves(result: QuasiResult, path: Path) -> None:
    """Write one row per point: sample, curve, load, strain, volumetric strain, stress ratio."""
    curves = []
    for sample in result.tested:
        curves.append((sample.seed, "path", sample.curve))
        curves += [] if sample.back is None else [(sample.seed, "unloading", sample.back)]
        curves += [(sample.seed, f"dynamics {run.time:g}", run.curve) for run in sample.slow]
    names = ("sample", "curve", "load", "strain", "volumetric_strain", "stress_ratio")
    write_table(path, names, ((seed, name, *row) for seed, name, curve in curves for row in zip(*curve, strict=True)))


def show(result: QuasiResult) -> None:
    """Print the end of every path on the terminal."""
    names = ("sample", "ends at", "ratio", "strain", "sliding", "events", "error", "collapse")
    table = new_table(*names, title="Paths, strain error of the slowest dynamics, and its collapse load")
    for sample in result.tested:
        last = sample.path.points[-1]
        off = min(sample.slow, key=lambda run: -run.time).error if sample.slow else None
        table.add_row(
            str(sample.seed), f"{last.load:.4g}", f"{sample.curve.ratio[-1]:.4g}", f"{sample.curve.strain[-1]:.2e}",
            f"{last.sliding}/{last.contacts}", str(len(sample.path.events)), "–" if off is None else f"{off:.1e}",
            "–" if sample.collapse is None else f"{sample.collapse:.4g}",
        )  # fmt: skip
    show_table(table)
    for sample in result.tested:
        console.print(f"  sample {sample.seed}: {sample.path.summary}")
    if result.scenario.loading.collapses:
        _show_collapses(result)
    for failure in result.failures:
        console.print(failure, style="yellow")


def _show_collapses(result: QuasiResult) -> None:
    along = ("largest motion", "along the load", "released", "participation", "lost", "gained", "mode")
    table = new_table(
        "sample", "load", *along, title="Collapses, with the overlap of their motion with what nothing resists before"
    )
    for sample in result.tested:
        for event in sample.path.collapses:
            if not event.quiet:
                table.add_row(
                    str(sample.seed), f"{event.load:.4g}", f"{event.largest:.1e}", f"{event.motion:.1e}",
                    f"{event.released:.1e}", f"{event.participation:.2f}", str(event.lost), str(event.gained),
                    f"{event.overlap:.2f}",
                )  # fmt: skip
    show_table(table)


def measures(result: QuasiResult) -> dict[str, tuple[float, str]]:
    """Return the measures of a run for sweeps as {name: (value, unit)}: medians over samples, loads as shares."""
    slowest = [min(sample.slow, key=lambda run: -run.time) for sample in result.tested if sample.slow]
    columns = {
        "last_load": [sample.path.load[-1] for sample in result.tested],
        "stress_ratio": [sample.curve.ratio[-1] for sample in result.tested],
        "strain": [sample.curve.strain[-1] for sample in result.tested],
        "events": [len(sample.path.events) for sample in result.tested],
        "collapses": [sum(not event.quiet for event in sample.path.collapses) for sample in result.tested],
        "sliding_share": [p.sliding / max(p.contacts, 1) for p in (sample.path.points[-1] for sample in result.tested)],
        "error_of_slowest_dynamics": [run.error for run in slowest],
        "collapse_load": [sample.collapse for sample in result.tested if sample.collapse is not None],
    }
    return {name: (float(np.median(values)) if values else np.nan, "1") for name, values in columns.items()}
