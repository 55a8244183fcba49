"""Output of earthquake cycles: files for the SEAS platform, figures, archive, terminal summary and measures.

Files follow sections 4 and 5 of the description of BP1-QD (B. Erickson and J. Jiang, 2018). Files of dipping faults
follow section 4 of the description of BP3-QD (B. Erickson, J. Jiang and E. Dunham, 2021), in which slip and shear
stress of normal faults are negative.
"""

from functools import partial
from pathlib import Path

import numpy as np

from .... import __version__
from ....kit import (
    Comparison,
    Fields,
    Measures,
    Quantity,
    SweepMember,
    console,
    heading_of,
    in_readable_units,
    new_table,
    show_table,
    units_of,
    write_table,
)
from ..friction.fault import Fault
from ..friction.fault_cycles import FaultHistory
from ..friction.fault_record import YEAR, FaultEvents, origin_of_value
from ..friction.laboratory import repeated_slip
from ..rate_state.report import compare_cycles
from . import figures as figures_of
from .simulate import FaultResult

SURFACE_COLUMNS = ("Displacement_1 (m)", "Displacement_2 (m)", "Velocity_1 (m/s)", "Velocity_2 (m/s)")
QUANTITIES = {"slip": "Slip (m)", "stress": "Shear stress (MPa)", "normal": "Normal stress (MPa)"}


def station_file(depth: float) -> str:
    """Return the file name of the time series at a depth, with the depth in units of 100 m."""
    return f"fltst_dp{_padded(depth / 100, 3)}.txt"


def surface_file(place: float) -> str:
    """Return the file name of a time series at the surface, with the distance in km, negative on the foot wall."""
    return f"srfst_fn{'-' if place < 0 else '+'}{_padded(abs(place) / 1e3, 2)}.txt"


def profiles(fault: Fault) -> dict[str, str]:
    """Return the names of the profile files, each with its quantity."""
    names = {"slip.dat": "slip", "shear_stress.dat": "stress", "normal_stress.dat": "normal"}
    return names if fault.dips else {"devol.dat": "slip"}


def _padded(number: float, digits: int) -> str:
    whole, _, part = f"{number:.4f}".partition(".")
    return f"{whole.zfill(digits)}.{part.rstrip('0')}".rstrip(".")


def _header(history: FaultHistory, lines) -> str:
    fault = history.fault
    kind = (f"motion={fault.slip}", f"dip_angle={fault.dip:g} degrees") if fault.dips else ()
    start = (
        "This is the file header:", f"problem=SEAS Benchmark {'BP3-QD' if fault.dips else 'BP1-QD, BP6-QD'} or similar",
        "code=stickslip", f"code_version={__version__}",
        f"element_size={fault.cell:g} m, {history.state.kernel} slip", *kind,
    )  # fmt: skip
    return "".join(f"# {line}\n" for line in (*start, *lines))


def _write_series(history: FaultHistory, location: tuple[str, ...], columns: dict, names: str, path: Path) -> None:
    steps = np.diff(history.time)
    lines = (
        f"minimum_time_step={steps.min(initial=np.inf):g}", f"maximum_time_step={steps.max(initial=0.0):g}",
        f"num_time_steps={len(history.time)}", *location,
        *(f"Column #{k} = {column}" for k, column in enumerate(("Time (s)", *columns), start=1)),
        "The line below lists the names of the data fields",
    )  # fmt: skip
    with path.open("w", encoding="utf-8") as file:
        file.write(f"{_header(history, lines)}t {names}\n# Here is the time-series data.\n")
        table = np.stack([history.time, *columns.values()], axis=1)
        np.savetxt(file, table, fmt=" ".join(["%21.13E", *["%14.6E"] * len(columns)]))


def write_station(history: FaultHistory, number: int, path: Path) -> None:
    """Write the time series at one station."""
    fault, dips = history.fault, history.fault.dips
    columns = {
        "Slip (m)": fault.sense * history.slip[:, number],
        "Slip rate (log10 m/s)": np.log10(history.velocity[:, number]),
        "Shear stress (MPa)": fault.sense * history.stress[:, number] / 1e6,
        **({"Normal stress (MPa)": history.normal[:, number] / 1e6} if dips else {}),
        "State (log10 s)": np.log10(history.theta[:, number]),
    }  # fmt: skip
    depth = history.station[number]
    place = f"location=on fault, {depth / 1e3:g} km {'down-dip distance' if dips else 'depth'}"
    location = place, f"values={origin_of_value(fault, depth)}"
    names = f"slip slip_rate shear_stress {'normal_stress ' if dips else ''}state"
    _write_series(history, location, columns, names, path)


def write_surface_station(history: FaultHistory, number: int, path: Path) -> None:
    """Write the time series at one surface station: horizontal and downward displacement and velocity."""
    series = history.horizontal, history.down, history.horizontal_velocity, history.down_velocity
    location = (f"location=on surface, {surface_file(history.surface[number])[8:-4]} km distance off-fault",)
    columns = {name: values[:, number] for name, values in zip(SURFACE_COLUMNS, series, strict=True)}
    _write_series(history, location, columns, "disp_1 disp_2 vel_1 vel_2", path)


def write_profiles(history: FaultHistory, quantity: str, path: Path) -> None:
    """Write profiles of slip or stress.

    The first row contains two zeros and the depths; each other row contains the time, log10 of the largest slip rate,
    and the values.

    Parameters
    ----------
    quantity : "slip", "stress" or "normal"
    """
    points, fault = len(history.profile_depth), history.fault
    name, depth = QUANTITIES[quantity], ("Distance down dip", "xd") if fault.dips else ("Depth", "z")
    lines = (
        f"Row #1 = {depth[0]} (m) with two zeros first", "Column #1 = Time (s)",
        "Column #2 = Max slip rate (log10 m/s)", f"Columns #3-{points + 2} = {name}",
        f"Computational domain size: depth {fault.width / 1e3:g} km",
        "The line below lists the names of the data fields",
    )  # fmt: skip
    scale = (1.0 if quantity == "slip" else 1e-6) * (1 if quantity == "normal" else fault.sense)
    table = scale * getattr(history, f"profile_{quantity}")
    rows = np.column_stack([history.profile_time, np.log10(history.profile_max_velocity), table])
    field = name.partition(" (")[0].lower().replace(" ", "_")
    with path.open("w", encoding="utf-8") as file:
        file.write(f"{_header(history, lines)}{depth[1]}\nt max_slip_rate {field}\n# Here are the data\n")
        layout = ["%21.13E", *["%14.6E"] * (points + 1)]
        np.savetxt(file, np.r_[0.0, 0.0, history.profile_depth][None], fmt=layout)
        np.savetxt(file, rows, fmt=layout)


SHOWN = 12  # largest number of events in a table
EVENTS = "events.csv"
EVENT_UNITS = {"seismic_moment": "N m"}


def event_table(result: FaultResult) -> dict[str, np.ndarray]:
    """Columns of the event table, with moments and magnitudes if the length along strike is given."""
    columns = result.history.events._asdict()
    if result.scenario.line.strike_length:
        columns |= {"seismic_moment": result.seismic_moment, "magnitude": result.magnitude}
    return columns


def write_events(result: FaultResult, path: Path) -> None:
    """Write the event table: one row per event, units in the headings; without events, comments and headings only."""
    run, length, units = result.scenario.run, result.scenario.line.strike_length, units_of(FaultEvents) | EVENT_UNITS
    table = event_table(result) | {"first": result.history.events.first.astype(int)}
    columns = [heading_of(name, units.get(name, "1")) for name in table]
    notes = [
        f"events of a fault, intervals in which the largest slip velocity is at least {run.threshold:g} m/s",
        f"moments and magnitudes are for a length along strike of {length:g} m" if length
        else "moments are per metre along strike; with line.strike_length, magnitudes are given as well",
        *remarks(result),
    ]  # fmt: skip
    write_table(
        path, columns, zip(*(values.tolist() for values in table.values()), strict=True), digits=12, comments=notes
    )


def figures(result: FaultResult):
    """Yield (file name, Figure) for each figure of a run."""
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
    """Yield (file name, function that writes it) for each file, in the format of the SEAS platform."""
    history = result.history
    yield EVENTS, partial(write_events, result)
    for number, depth in enumerate(history.station):
        yield station_file(depth), partial(write_station, history, number)
    for number, distance in enumerate(history.surface):
        yield surface_file(distance), partial(write_surface_station, history, number)
    for name, quantity in profiles(history.fault).items():
        yield name, partial(write_profiles, history, quantity)


def remarks(result: FaultResult) -> list[str]:
    """Sentences on missing events, on the first event, and on nucleation."""
    run, events = result.scenario.run, result.history.events
    (lasted,), unit = in_readable_units([result.history.time[-1]], "s")
    nothing = f"There was no event in {lasted:.3g} {unit}: no slip velocity reached {run.threshold:g} m/s."
    first = [
        f"The first event, after {years:.4g} years, follows from the initial state and not from an earlier event."
        for years in events.start[events.first] / YEAR
    ]
    return [nothing] * (not len(events.start)) + first + [result.nucleation.sentence]


def numbers(result: FaultResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
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
        "events": Fields(event_table(result), FaultEvents, **EVENT_UNITS),
        "energy": h.energy, "fault": Fields(fault | state, Fault, FaultHistory),
        "remarks": "\n".join(remarks(result)), "units": "SI",
    }  # fmt: skip


def show(result: FaultResult) -> None:
    """Print the events, their sources and their average."""
    events = result.history.events
    if len(events.start):
        lasted, unit = in_readable_units(events.end - events.start, "s")
        table = new_table(
            "year", f"lasts [{unit}]", "starts at [km]", "rupture [km]", "speed [km/s]", "max V [m/s]", "slip [m]",
            "surface [m]", title="Events (* the first, after an artificial start)",
        )  # fmt: skip
        for k in range(min(SHOWN, len(events.start))):
            table.add_row(
                _year_of(events, k), f"{lasted[k]:.4g}", f"{events.depth[k] / 1e3:.2f}",
                f"{events.top[k] / 1e3:.1f}–{events.bottom[k] / 1e3:.1f}", _known(events.rupture_speed[k] / 1e3),
                f"{events.max_velocity[k]:.3g}", f"{events.max_slip[k]:.3f}", f"{events.surface_slip[k]:.3f}",
            )  # fmt: skip
        show_table(table)
        show_table(_table_of_sources(result))
        names = ("released", "frictional", "fracture", "radiated")
        table = new_table("year", *(f"{name} [GJ]" for name in names), title="Energies per metre along strike")
        for k in range(min(SHOWN, len(events.start))):
            table.add_row(_year_of(events, k), *(f"{getattr(events, name)[k] / 1e9:.4g}" for name in names))
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
    if len(events.start):
        rest = np.abs(events.energy_residual).max()
        console.print(f"  energies of each event balanced to {rest:.1e} of the energy that it released")


def _year_of(events: FaultEvents, k: int) -> str:
    """Year of an event, with an asterisk for the first one."""
    return f"{events.start[k] / YEAR:.3f}{'*' if events.first[k] else ' '}"


def _known(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"


def _table_of_sources(result: FaultResult):
    """Table of moments and stress drops of the events."""
    events, length = result.history.events, result.scenario.line.strike_length
    size = ("moment [N m]", "M_w") if length else ("moment [N]",)
    table = new_table(
        "year", *size, "mean [MPa]", "by slip [MPa]", "by moment [MPa]",
        title=f"Moments for {length / 1e3:g} km along strike, and stress drops" if length
        else "Moments per metre along strike, and stress drops",
    )  # fmt: skip
    drops = np.array([events.stress_drop, events.slip_weighted_stress_drop, events.seismological_stress_drop]) / 1e6
    moments = np.array([result.seismic_moment, result.magnitude] if length else [events.moment])
    for k in range(min(SHOWN, len(events.start))):
        cells = f"{moments[0, k]:.3e}", *(f"{m:.2f}" for m in moments[1:, k]), *map(_known, drops[:, k])
        table.add_row(_year_of(events, k), *cells)
    return table


def compare(members: list[SweepMember]) -> Comparison:
    """Compare the cycles of the members of a sweep."""
    return compare_cycles(members, _cycles)


def _cycles(tree: dict, since: np.ndarray) -> np.ndarray | None:
    """Return slip since an event at the station with the largest coseismic slip; None if there is no cycle."""
    series = tree["series"]
    time, slip = series["time"], series["slip"]
    uneven = np.std(slip - np.outer(time / time[-1], slip[-1]), axis=0)
    return repeated_slip(time, series["max_velocity"], slip[:, int(np.argmax(uneven))], since)


def _of_events(name: str, unit: str, meaning: str, of=None) -> Quantity:
    """Mean of a quantity over settled events; NaN if there are none."""

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
    _of_events("nucleation_length", "m", "length of the nucleation zone"),
    _of_events("rupture_bottom", "m", "lower end of the rupture", lambda events: events.bottom),
    _of_events("moment", "N", "moment for each unit of length along strike"),
    Quantity("magnitude", "1", "moment magnitude for line.strike_length, mean over settled events",
             lambda r: float(np.mean(r.magnitude[r.settled])) if len(r.late_events.start) else np.nan),
    _of_events("rupture_length", "m", "length of the rupture"),
    _of_events("rupture_speed", "m/s", "mean speed of the rupture"),
    _of_events("stress_drop", "Pa", "mean stress drop over the rupture"),
    _of_events("slip_weighted_stress_drop", "Pa", "stress drop weighted with slip"),
    _of_events("seismological_stress_drop", "Pa", "stress drop from moment and length"),
    _of_events("released", "J/m", "elastic energy released, per length along strike"),
    _of_events("radiated", "J/m", "radiated energy, per length along strike"),
    _of_events("fracture", "J/m", "work of friction above slip times final stress, per length along strike"),
    Quantity("event_energy_residual", "1", "largest residual of the energies of an event, over the energy released",
             lambda r: float(np.abs(r.history.events.energy_residual).max(initial=0.0))),
    Quantity("radiated_fraction", "1", "radiated energy over the work of loading",
             lambda r: r.history.energy.radiated / r.history.energy.loading if r.history.energy.loading else np.nan),
    Quantity("energy_residual", "1", "residual of the energy balance over the work", "history.energy.residual"),
    Quantity("crept_length", "m", "length of the part that slipped by D_c or more in excess of "
             "plate motion; NaN at constant stress"),
])  # fmt: skip
