"""Output of a spring-slider: files, archive, terminal summary and measures."""

from functools import partial
from pathlib import Path

import numpy as np

from ....data.run_files import SERIES
from ....kit import archive_fields, console, new_table, show_table
from ..friction.cycles import passing_velocity, recurrence, repeated_slip
from ..friction.laboratory import LabRecord, write_csv
from ..friction.ratestate import steady_friction
from . import figures as figures_of
from .simulate import SliderResult


def figures(result: SliderResult):
    """Yield (file name, Figure) of a run."""
    yield "fig1_history.png", figures_of.slid(result.history, result.recorded, result.legs)


def files(result: SliderResult):
    """Yield (file name, function that writes it) for the time series as CSV, which `stickslip fit` reads."""
    yield SERIES, partial(_write_series, result)


def _write_series(result: SliderResult, path: Path) -> None:
    h, noise = result.history, result.scenario.samples.noise
    record = LabRecord(h.time, result.recorded, h.load_point, slip=h.slip, velocity=h.velocity, theta=h.theta)
    note = f"noise of {noise:g} was added to friction" if noise else "no noise"
    write_csv(path, record, (f"stickslip, experiment rate-state: {note}",))


def numbers(result: SliderResult) -> dict:
    """Return the contents of the archive, besides scenario and version."""
    history = archive_fields(result.history._replace(end=result.history.end.value))
    return {"history": history, "recorded": result.recorded, "units": "m, s"}


def show(result: SliderResult) -> None:
    """Print the legs, their stability and the end of the history."""
    h, names = result.history, ("velocity [m/s]", "until [s]", "final friction", "least", "greatest")
    table = new_table(*names, title="Legs of the load point")
    ends = np.cumsum([leg.duration for leg in result.legs])
    for leg, end in zip(result.legs, ends, strict=True):
        within = (h.time > end - leg.duration) & (h.time <= end)
        if within.any():
            part = h.friction[within]
            cells = (f"{leg.velocity:.4g}", f"{end:.6g}", f"{part[-1]:.5f}", f"{part.min():.5f}", f"{part.max():.5f}")
            table.add_row(*cells)
    show_table(table)
    for sentence in dict.fromkeys(regime.sentence for regime in result.sliding):
        console.print(f"  {sentence}")
    if not h.ok:
        console.print(f"{h.end.value} (after {h.reached:.6g} s)", style="yellow")


def cycles(tree: dict, since: np.ndarray) -> np.ndarray | None:
    """Return slip at times since an event, from the contents of an archive; None without a cycle."""
    time, slip, velocity = (tree["history"][name] for name in ("time", "slip", "velocity"))
    return repeated_slip(time, passing_velocity(time, slip, velocity), slip, since)


def measures(result: SliderResult) -> dict[str, tuple[float, str]]:
    """Return {name: (value, unit)} for sweeps; stability is that of the last moving leg.

    The critical stiffness is 0 if sliding is stable with any spring: no stiffness is negative.

    The recurrence time is given if there are at least three events.
    """
    h, surface = result.history, result.scenario.surface.rate_state
    velocity = [leg.velocity for leg in result.legs if leg.velocity > 0][-1]
    period = recurrence(h.time, passing_velocity(h.time, h.slip, h.velocity))
    return {
        "final_friction": (h.friction[-1], "1"),
        "final_velocity": (h.velocity[-1], "m/s"),
        "least_friction": (h.friction.min(), "1"),
        "greatest_friction": (h.friction.max(), "1"),
        "steady_friction": (float(steady_friction(surface, velocity)), "1"),
        "critical_stiffness": (max(result.sliding[-1].critical, 0.0), "1/m"),
        "growth_rate": (result.sliding[-1].growth_rate, "1/s"),
        "stable": (result.sliding[-1].stable, "1"),
        "reached": (h.reached, "s"),
    } | ({"recurrence": (period, "s")} if np.isfinite(period) else {})
