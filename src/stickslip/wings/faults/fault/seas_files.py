"""Text files in the format of the platform for SEAS benchmark problems.

The format is that of sections 4 and 5 of the description of BP1-QD (B. Erickson and J. Jiang, 2018), and for dipping
faults of section 4 of that of BP3-QD (B. Erickson, J. Jiang and E. Dunham, 2021). There, slip and shear stress of
normal faults are negative.
"""

from pathlib import Path

import numpy as np

from .... import __version__
from ..friction.fault import Fault
from ..friction.fault_cycles import FaultHistory
from ..friction.fault_record import origin_of_value

SURFACE_COLUMNS = ("Displacement_1 (m)", "Displacement_2 (m)", "Velocity_1 (m/s)", "Velocity_2 (m/s)")
QUANTITIES = {"slip": "Slip (m)", "stress": "Shear stress (MPa)", "normal": "Normal stress (MPa)"}


def station_file(depth: float) -> str:
    """Return the name of the time series at a depth: its number is in units of 100 m."""
    return f"fltst_dp{_padded(depth / 100, 3)}.txt"


def surface_file(place: float) -> str:
    """Return the name of the time series at the surface: its number is in km, negative on the foot wall."""
    return f"srfst_fn{'-' if place < 0 else '+'}{_padded(abs(place) / 1e3, 2)}.txt"


def profiles(fault: Fault) -> dict[str, str]:
    """Return the names of the files of profiles, each with its quantity."""
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
        "code=stickslip", f"code_version={__version__}", f"element_size={fault.cell:g} m", *kind,
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
    """Write the time series at one station at the surface: horizontal and downward displacement and velocity."""
    series = history.horizontal, history.down, history.horizontal_velocity, history.down_velocity
    location = (f"location=on surface, {surface_file(history.surface[number])[8:-4]} km distance off-fault",)
    columns = {name: values[:, number] for name, values in zip(SURFACE_COLUMNS, series, strict=True)}
    _write_series(history, location, columns, "disp_1 disp_2 vel_1 vel_2", path)


def write_profiles(history: FaultHistory, quantity: str, path: Path) -> None:
    """Write profiles of slip or stress: a row of two zeros and depths; rows of time, log10 of max slip rate and values.

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
