"""Output of quasi-rigid loading: files in the run folder, and terminal summary."""

from types import SimpleNamespace as Made

import numpy as np

from .... import figures as common_figures
from ....kit import Fields, Measures, Quantities, Quantity, archive_fields, console, median, quantities_of, units_of
from ...status.collapse import Collapse
from . import figures as figures_of
from .simulate import Curve, QuasiResult, SampleResult, SlowDynamics

COLUMNS = [name for name in Collapse._fields if name not in ("reason", "strain", "direction", "sliding")]


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
    curves = []
    for sample in result.tested:
        named = {"path": sample.curve, "unloading": sample.back}
        named |= {f"dynamics {run.time:g}": run.curve for run in sample.slow}
        curves += [Made(seed=sample.seed, curve=k, **curve._asdict()) for k, curve in named.items() if curve]
    yield "series.csv", lambda path: CURVE.write(path, curves)
    if result.scenario.loading.collapses:
        yield "collapses.csv", lambda path: COLLAPSE.write(path, _collapses(result))


def numbers(result: QuasiResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    return {
        "scenario": result.scenario.text,
        "units": "units of the scenario; loads are fractions of the change from the first to the last load",
        "samples": {f"{sample.seed:03d}": _sample(sample) for sample in result.tested},
    }


def _sample(sample: SampleResult) -> dict:
    path, events = sample.path, sample.path.events
    columns = {name: np.array([getattr(event, name) for event in path.collapses]) for name in Collapse._fields}
    reasons = "\n".join(columns.pop("reason").tolist())
    out = {
        "law": sample.law,
        "path": {"verdict": path.verdict.value, "load": path.load}
        | {name: np.array([getattr(p, name) for p in path.points]) for name in ("sliding", "contacts", "residual")},
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


SAMPLE = Quantity("sample", "1", "seed of the sample", "seed")
CURVE = Quantities([
    SAMPLE, Quantity("curve", "1", "path, unloading, or dynamics and their duration"),
    *quantities_of(Curve, "load", "strain").values(),
    Quantity("volumetric_strain", "1", "volumetric strain, compression positive", "volumetric"),
    Quantity("stress_ratio", "1", "ratio of the stresses, or shear stress over pressure", "ratio"),
])  # fmt: skip
COLLAPSE = Quantities([
    SAMPLE, *quantities_of(Collapse, *COLUMNS).values(),
    Quantity("sliding_before", "1", "contacts at the limit before the collapse", lambda event: event.sliding[0]),
    Quantity("sliding_after", "1", "contacts at the limit after the collapse", lambda event: event.sliding[1]),
])  # fmt: skip


def _collapses(result: QuasiResult) -> list[Made]:
    return [Made(seed=sample.seed, **e._asdict()) for sample in result.tested for e in sample.path.collapses]


NAN = float("nan")
MEASURES = Measures([
    Quantity("last_load", "1", "fraction of the load at which the path ends", lambda sample: sample.path.load[-1]),
    Quantity("stress_ratio", "1", "stress ratio at the end of the path", lambda sample: sample.curve.ratio[-1]),
    Quantity("strain", "1", "strain at the end of the path", lambda sample: sample.curve.strain[-1]),
    Quantity("events", "1", "changes of contact status along the path", lambda sample: len(sample.path.events)),
    Quantity("collapses", "1", "collapses with larger motion than the load alone would cause",
             lambda sample: sum(not event.quiet for event in sample.path.collapses)),
    Quantity("sliding_share", "1", "fraction of contacts at the Coulomb limit at the end",
             lambda sample: sample.path.points[-1].sliding / max(sample.path.points[-1].contacts, 1)),
    Quantity("error_of_slowest_dynamics", "1", "difference in strain between the slowest dynamics and the path",
             lambda sample: max(sample.slow, key=lambda run: run.time).error if sample.slow else NAN),
    Quantity("collapse_load", "1", "load at which the dynamics loses stability",
             lambda sample: NAN if sample.collapse is None else sample.collapse),
], samples=lambda result: result.tested, over=median)  # fmt: skip


def show(result: QuasiResult) -> None:
    """Print the end of every path on the terminal."""
    Quantities([SAMPLE, *MEASURES.values()]).show_rows(result.tested, title="Ends of the paths")
    for sample in result.tested:
        console.print(f"  sample {sample.seed}: {sample.path.summary}")
    if result.scenario.loading.collapses:
        loud = [event for event in _collapses(result) if not event.quiet]
        title = "Collapses, with the overlap of their motion with unresisted motions before"
        shown = ("sample", "load", "largest", "motion", "released", "participation", "lost", "gained", "overlap")
        COLLAPSE.show_rows(loud, *shown, title=title)
    for failure in result.failures:
        console.print(failure, style="yellow")
