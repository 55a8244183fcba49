"""Output of a spring-slider: files, archive, terminal summary and measures."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from ....kit import Comparison, Measures, Quantity, SweepMember, archive, archive_fields, console, new_table, show_table
from ..friction.laboratory import LabRecord, passing_velocity, recurrence, repeated_slip, write_csv
from ..friction.laws import steady_friction
from . import figures as figures_of
from .simulate import SliderResult

LEAST, MOST = 3, 500  # smallest number of members with cycles for a figure, and largest number drawn in it
BEFORE, SPAN, POINTS = 0.1, 2.3, 1200  # range of times in a figure, in median recurrence times, and number of times


def figures(result: SliderResult):
    """Yield (file name, Figure) for each figure of a run."""
    yield "fig1_history.png", figures_of.slid(result.history, result.recorded, result.legs)


def files(result: SliderResult):
    """Yield (file name, function that writes it) for the time series as CSV, which `stickslip fit` reads."""
    yield "series.csv", partial(_write_series, result)


def _write_series(result: SliderResult, path: Path) -> None:
    h, noise = result.history, result.scenario.samples.noise
    record = LabRecord(h.time, result.recorded, h.load_point, slip=h.slip, velocity=h.velocity, theta=h.theta)
    note = f"noise of {noise:g} was added to friction" if noise else "no noise"
    write_csv(path, record, (f"stickslip, experiment rate-state: {note}",))


def numbers(result: SliderResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
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


def compare(members: list[SweepMember]) -> Comparison:
    """Compare the cycles of the members of a sweep."""
    return compare_cycles(members, _cycles)


def compare_cycles(members: list[SweepMember], cycles: Callable) -> Comparison:
    """Compare slip since an event and recurrence times of the members of a sweep if at least three have cycles.

    Parameters
    ----------
    cycles : (contents of the archive, times since an event) -> slip since that event; None without a cycle
    """
    known = {member.archive: member.measures.get("recurrence", (np.nan,))[0] for member in members}
    known = {path: time for path, time in known.items() if np.isfinite(time)}
    if len(known) < LEAST:
        return Comparison()
    recurrence = np.array(list(known.values()))
    since = np.linspace(-BEFORE, SPAN, POINTS) * np.median(recurrence)
    trees = (archive.read(path) for path in list(known)[:MOST])
    curves = [curve for tree in trees if (curve := cycles(tree, since)) is not None]
    if len(curves) < LEAST:
        return Comparison()
    without = len(members) - len(known)
    return Comparison({"cycles.png": figures_of.cycles(since, np.array(curves), recurrence, without=without)})


def _cycles(tree: dict, since: np.ndarray) -> np.ndarray | None:
    """Return slip at times since an event, from the contents of an archive; None without a cycle."""
    time, slip, velocity = (tree["history"][name] for name in ("time", "slip", "velocity"))
    return repeated_slip(time, passing_velocity(time, slip, velocity), slip, since)


def _recurrence(result: SliderResult) -> float | None:
    """Recurrence time from at least three events; None with fewer."""
    h = result.history
    period = recurrence(h.time, passing_velocity(h.time, h.slip, h.velocity))
    return period if np.isfinite(period) else None


MEASURES = Measures([
    Quantity("final_friction", "1", "friction at the end", lambda r: r.history.friction[-1]),
    Quantity("final_velocity", "m/s", "slip velocity at the end", lambda r: r.history.velocity[-1]),
    Quantity("least_friction", "1", "smallest friction", lambda r: r.history.friction.min()),
    Quantity("greatest_friction", "1", "greatest friction", lambda r: r.history.friction.max()),
    Quantity("steady_friction", "1", "steady friction at the velocity of the last moving leg",
             lambda r: float(steady_friction(
                 r.scenario.surface.rate_state, [leg.velocity for leg in r.legs if leg.velocity > 0][-1]))),
    Quantity("critical_stiffness", "1/m", "stiffness below which sliding is unstable; 0: none",
             lambda r: max(r.sliding[-1].critical, 0.0)),
    Quantity("growth_rate", "1/s", "growth rate of a small disturbance", lambda r: r.sliding[-1].growth_rate),
    Quantity("stable", "1", "1 if sliding in the last moving leg is stable", lambda r: r.sliding[-1].stable),
    Quantity("reached", "s", "end of the history", "history.reached"),
    Quantity("recurrence", "s", "recurrence time, with at least three events", _recurrence),
])  # fmt: skip
