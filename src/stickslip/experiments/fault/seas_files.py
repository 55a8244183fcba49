"""Text files in the format of the platform for SEAS benchmark problems.

The format is that of sections 4 and 5 of the description of BP1-QD (B. Erickson and J. Jiang, 2018).
"""

from pathlib import Path

import numpy as np

from ... import __version__
from ...friction.fault_cycles import FaultHistory

SERIES_COLUMNS = ("Time (s)", "Slip (m)", "Slip rate (log10 m/s)", "Shear stress (MPa)", "State (log10 s)")


def station_file(depth: float) -> str:
    """Return the name of the time series at a depth: its number is in units of 100 m."""
    whole, _, part = f"{depth / 100:.4f}".partition(".")
    return f"fltst_dp{whole.zfill(3)}.{part.rstrip('0')}".rstrip(".") + ".txt"


def _header(history: FaultHistory, lines) -> str:
    start = (
        "This is the file header:", "problem=SEAS Benchmark BP1-QD, BP6-QD or similar", "code=stickslip",
        f"code_version={__version__}", f"element_size={history.fault.cell:g} m",
    )  # fmt: skip
    return "".join(f"# {line}\n" for line in (*start, *lines))


def write_station(history: FaultHistory, number: int, path: Path) -> None:
    """Write the time series at one station."""
    steps = np.diff(history.time)
    lines = (
        f"minimum_time_step={steps.min(initial=np.inf):g}", f"maximum_time_step={steps.max(initial=0.0):g}",
        f"num_time_steps={len(history.time)}", f"location=on fault, {history.station[number] / 1e3:g} km depth",
        *(f"Column #{k} = {column}" for k, column in enumerate(SERIES_COLUMNS, start=1)),
        "The line below lists the names of the data fields",
    )  # fmt: skip
    columns = (
        history.time, history.slip[:, number], np.log10(history.velocity[:, number]), history.stress[:, number] / 1e6,
        np.log10(history.theta[:, number]),
    )  # fmt: skip
    with path.open("w", encoding="utf-8") as file:
        file.write(_header(history, lines) + "t slip slip_rate shear_stress state\n# Here is the time-series data.\n")
        np.savetxt(file, np.stack(columns, axis=1), fmt="%21.13E %14.6E %14.6E %14.6E %14.6E")


def write_slip_evolution(history: FaultHistory, path: Path) -> None:
    """Write slip profiles: a row of two zeros and depths; rows of time, log10 of the maximum slip rate, and slip."""
    points = len(history.profile_depth)
    lines = (
        "Row #1 = Depth (m) with two zeros first", "Column #1 = Time (s)", "Column #2 = Max slip rate (log10 m/s)",
        f"Columns #3-{points + 2} = Slip (m)", f"Computational domain size: depth {history.fault.width / 1e3:g} km",
        "The line below lists the names of the data fields",
    )  # fmt: skip
    rows = np.column_stack([history.profile_time, np.log10(history.profile_max_velocity), history.profile_slip])
    with path.open("w", encoding="utf-8") as file:
        file.write(_header(history, lines) + "z\nt max_slip_rate slip\n# Here are the data\n")
        layout = ["%21.13E", *["%14.6E"] * (points + 1)]
        np.savetxt(file, np.r_[0.0, 0.0, history.profile_depth][None], fmt=layout)
        np.savetxt(file, rows, fmt=layout)
