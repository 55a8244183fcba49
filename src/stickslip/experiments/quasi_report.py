"""What quasi-rigid loading leaves in its folder and on the terminal."""

from pathlib import Path

import numpy as np
from rich.table import Table

from ..ensemble import Workers
from ..figures import quasi_rigid as figures
from ..figures.grains import packing
from ..figures.style import save as save_figure
from .claims_report import write_claims
from .quasi_claims import SHOWS
from .quasi_rigid import Reproduction
from .quasi_test import Curve, QuasiResult, Tested, simulate_quasi
from .report import SERIES, STYLE, complete, console, files_of, plain, save


def simulate(scenario, *, folder: Path, workers: Workers, report) -> QuasiResult:
    """Run a user's scenario."""
    return simulate_quasi(scenario, folder=folder, workers=workers, report=report)


def write_reproduction(folder: Path, found: Reproduction) -> list[Path]:
    """Figures, claims, curves, scenario and raw numbers of the paper's test; returns their paths."""
    return _write(folder, found.main, found.claims)


def write_result(folder: Path, result: QuasiResult) -> list[Path]:
    """Figures, curves as CSV, scenario and raw numbers of a user's scenario; returns their paths."""
    return _write(folder, result, None)


def _write(folder: Path, result: QuasiResult, claims) -> list[Path]:
    longest = max(result.tested, key=lambda one: len(one.path.events))
    with complete(folder, failures=result.failures) as room:
        save(room, result.scenario, numbers(result))
        _write_curves(room / SERIES, result)
        save_figure(figures.curves(result.tested, result.scenario.loading.test), room / "fig1_curves.png")
        end = longest.path.points[-1]
        title = f"sample {longest.seed} where its path ends, load {end.load:.4g}"
        save_figure(packing(end.state, longest.law, title=title), room / "fig2_statuses.png")
        if len(longest.pairs):
            save_figure(figures.cone(longest, result.scenario.law.mu), room / "fig3_cone.png")
        save_figure(figures.stiffness(longest), room / "fig4_stiffness.png")
        if result.scenario.dynamics.times:
            save_figure(figures.errors(result.tested), room / "fig5_dynamics.png")
        if claims is not None:
            write_claims(room, claims, SHOWS, "Paper 002: quasi-rigidity", result.failures)
    return files_of(folder)


def numbers(result: QuasiResult) -> dict:
    """What the archive holds besides scenario and version."""
    return {
        "scenario": result.scenario.text,
        "units": "those of the scenario; loads are shares of the way from the first to the last load",
        "samples": {f"{one.seed:03d}": _sample(one) for one in result.tested},
    }


def _sample(one: Tested) -> dict:
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
        "curve": plain(one.curve),
        "looks": plain(one.looks),
        "slow": {
            f"{run.time:g}": {"error": run.error, "kinetic_energy": run.kinetic_energy, **plain(run.curve)}
            for run in one.slow
        },
        "contacts": {"bodies": one.pairs, "force": one.forces},
        "frames": {"start": path.states[0], "end": path.states[-1]},
    }
    if one.back is not None:
        out["unloading"] = plain(one.back)
    if one.collapse is not None:
        out["collapse"] = one.collapse
    return out


def _write_curves(path: Path, result: QuasiResult) -> None:
    """One row a point: sample, what it belongs to, load, strain, volumetric strain, stress ratio."""
    lines = ["sample,curve,load,strain,volumetric_strain,stress_ratio"]

    def add(seed: int, name: str, curve: Curve) -> None:
        for row in zip(*curve, strict=True):
            lines.append(f"{seed},{name}," + ",".join(f"{x:.9g}" for x in row))

    for one in result.tested:
        add(one.seed, "path", one.curve)
        if one.back is not None:
            add(one.seed, "unloading", one.back)
        for run in one.slow:
            add(one.seed, f"dynamics {run.time:g}", run.curve)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def show_result(result: QuasiResult) -> None:
    """Where every path ended, on the terminal."""
    title = "Paths, how far the slowest dynamics is off in strain, and where it falls"
    table = Table(title=title, **STYLE)
    names = ("sample", "ends at", "ratio", "strain", "slide", "events", "off by", "falls at")
    for name in names:
        table.add_column(name, justify="right", no_wrap=True)
    for one in result.tested:
        last = one.path.points[-1]
        off = min(one.slow, key=lambda run: -run.time).error if one.slow else None
        table.add_row(
            str(one.seed), f"{last.load:.4g}", f"{one.curve.ratio[-1]:.4g}", f"{one.curve.strain[-1]:.2e}",
            f"{last.sliding}/{last.contacts}", str(len(one.path.events)), "–" if off is None else f"{off:.1e}",
            "–" if one.collapse is None else f"{one.collapse:.4g}",
        )  # fmt: skip
    console.print(table)
    for one in result.tested:
        end = one.path.summary
        console.print(f"  sample {one.seed}: {end}")
    for failure in result.failures:
        console.print(failure, style="yellow")


def scalars(result: QuasiResult) -> dict[str, tuple[float, str]]:
    """{name: (value, unit)} of a run, for sweeps: medians over its samples; loads are shares of the whole load."""
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
