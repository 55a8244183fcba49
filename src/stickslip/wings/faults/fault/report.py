"""Output of earthquake cycles: files, archive, terminal summary and measures."""

from functools import partial

import numpy as np

from ....kit import Fields, Measures, Quantity, console, in_readable_units, new_table, show_table
from ..friction.fault import Fault
from ..friction.fault_cycles import FaultHistory
from ..friction.fault_record import YEAR
from ..friction.measure import repeated_slip
from . import figures as figures_of
from . import seas_files
from .simulate import FaultResult

SHOWN = 12  # events in the table


def figures(result: FaultResult):
    """Yield (file name, Figure) of a run."""
    history = result.history
    yield "fig1_slip.png", figures_of.slip_contours(history)
    yield "fig2_velocity.png", figures_of.max_slip_velocity(history, result.scenario.run.threshold)
    if len(history.station):
        yield "fig3_stations.png", figures_of.station_series(history)
        if history.fault.changes:
            yield "fig4_normal_stress.png", figures_of.normal_stress_series(history)
    if len(history.surface):
        yield "fig5_surface.png", figures_of.surface_series(history)


def files(result: FaultResult):
    """Yield (file name, function that writes it) in the format of the SEAS platform."""
    history = result.history
    for number, depth in enumerate(history.station):
        yield seas_files.station_file(depth), partial(seas_files.write_station, history, number)
    for number, place in enumerate(history.surface):
        yield seas_files.surface_file(place), partial(seas_files.write_surface_station, history, number)
    for name, quantity in seas_files.profiles(history.fault).items():
        yield name, partial(seas_files.write_profiles, history, quantity)


def remarks(result: FaultResult) -> list[str]:
    """Sentences on what did not happen, and on nucleation."""
    run = result.scenario.run
    (lasted,), unit = in_readable_units([result.history.time[-1]], "s")
    nothing = f"There was no event in {lasted:.3g} {unit}: no slip velocity reached {run.threshold:g} m/s."
    return [nothing] * (not len(result.history.events.start)) + [result.nucleation.sentence]


def numbers(result: FaultResult) -> dict:
    """Return the contents of the archive, besides scenario and version."""
    h = result.history
    series = {
        name: getattr(h, name)
        for name in ("time", "max_velocity", "moment_rate", "station", "slip", "velocity", "stress", "theta")
    }
    state = {"stress": h.state.stress(h.fault), "theta": h.state.theta(h.fault)}
    if h.fault.changes or h.fault.dips:
        series["normal"] = h.normal
    if h.fault.states > 1:
        series["theta2"], state["theta2"] = h.theta2, h.state.theta2(h.fault)
    profiles = {
        "time": h.profile_time, "seismic": h.profile_seismic, "max_velocity": h.profile_max_velocity,
        "depth": h.profile_depth, "slip": h.profile_slip,
    }  # fmt: skip
    if h.fault.dips:
        profiles |= {"stress": h.profile_stress, "normal": h.profile_normal}
    fault = {name: getattr(h.fault, name) for name in ("depth", "a", "b", "dc", "normal", "b2", "dc2")}
    moved = ("time", "horizontal", "down", "horizontal_velocity", "down_velocity")
    surface = {name: getattr(h, name) for name in moved} | {"station": h.surface}
    beside = {"surface": Fields(surface, FaultHistory)} if len(h.surface) else {}
    return {
        **beside, "series": Fields(series, FaultHistory, Fault), "profiles": Fields(profiles, FaultHistory, Fault),
        "events": h.events, "energy": h.energy, "fault": Fields(fault | state, Fault, FaultHistory),
        "remarks": "\n".join(remarks(result)), "units": "SI",
    }  # fmt: skip


def show(result: FaultResult) -> None:
    """Print the events and their average."""
    events = result.history.events
    lasted, unit = in_readable_units(events.end - events.start, "s")
    table = new_table(
        "year", f"duration [{unit}]", "nucleates at [km]", "rupture [km]", "max V [m/s]", "slip [m]", "surface [m]",
        title="Events",
    )  # fmt: skip
    for k in range(min(SHOWN, len(events.start))):
        table.add_row(
            f"{events.start[k] / YEAR:.3f}", f"{lasted[k]:.4g}", f"{events.depth[k] / 1e3:.2f}",
            f"{events.top[k] / 1e3:.1f}–{events.bottom[k] / 1e3:.1f}", f"{events.max_velocity[k]:.3g}",
            f"{events.max_slip[k]:.3f}", f"{events.surface_slip[k]:.3f}",
        )  # fmt: skip
    if len(events.start):
        show_table(table)
    if len(events.start) > SHOWN:
        console.print(f"  and {len(events.start) - SHOWN} more")
    for sentence in remarks(result):
        console.print(f"  {sentence}", style=None if result.nucleation.possible else "yellow")
    if np.isfinite(result.recurrence):
        console.print(f"  recurrence {result.recurrence / YEAR:.4g} years")
    if np.isfinite(result.crept_length):
        console.print(f"  {result.crept_length / 1e3:.4g} km of the fault slipped by D_c or more beyond plate motion")
    work = "loading" if result.history.energy.loading else "friction"
    console.print(f"  energy balance closed to {abs(result.history.energy.residual):.1e} of the work of {work}")


def cycles(tree: dict, since: np.ndarray) -> np.ndarray | None:
    """Return slip at times since an event, at the station that slips most in steps; None without a cycle."""
    series = tree["series"]
    time, slip = series["time"], series["slip"]
    uneven = np.std(slip - np.outer(time / time[-1], slip[-1]), axis=0)
    return repeated_slip(time, series["max_velocity"], slip[:, int(np.argmax(uneven))], since)


def _of_events(name: str, unit: str, meaning: str, of=None) -> Quantity:
    """Mean over settled events; NaN without any."""

    def mean(result: FaultResult) -> float:
        values = of(result.late_events) if of else getattr(result.late_events, name)
        return float(np.mean(values)) if len(values) else np.nan

    return Quantity(name, unit, f"{meaning}, mean over settled events", mean)


MEASURES = Measures([
    Quantity("events", "1", "number of events", lambda r: len(r.history.events.start)),
    Quantity("first_event", "s", "time of the first event",
             lambda r: float(r.history.events.start[0]) if len(r.late_events.start) else np.nan),
    Quantity("recurrence", "s", "mean time between the starts of settled events"),
    _of_events("surface_slip", "m", "slip at the surface"),
    _of_events("max_slip", "m", "largest slip"),
    _of_events("max_velocity", "m/s", "largest slip velocity"),
    _of_events("duration", "s", "duration", lambda events: events.end - events.start),
    _of_events("nucleation_depth", "m", "depth at which an event nucleates", lambda events: events.depth),
    _of_events("nucleation_length", "m", "length of the nucleation"),
    _of_events("rupture_bottom", "m", "lower end of the rupture", lambda events: events.bottom),
    _of_events("moment", "N", "moment for each unit of length along strike"),
    Quantity("radiated_fraction", "1", "radiated energy over the work of loading",
             lambda r: r.history.energy.radiated / r.history.energy.loading if r.history.energy.loading else np.nan),
    Quantity("energy_residual", "1", "rest of the energy balance over the work", "history.energy.residual"),
    Quantity("crept_length", "m", "length that slipped by D_c or more beyond plate motion; NaN at constant stress"),
])  # fmt: skip
