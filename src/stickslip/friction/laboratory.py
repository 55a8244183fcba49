"""Laboratory records as CSV files with units in their headers, converted to metres and seconds on reading."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..core.arguments import check_types, checked
from ..core.readable import readable
from ..core.tables import heading_of, read_table, split_label, write_table
from ..core.text import parse_number, shortened
from ..core.units import YEAR
from .fitting import Data
from .loads import check_times, load_steps

DAY = 86400.0
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "micron": 1e-6, "nm": 1e-9}
TIME = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "min": 60.0, "h": 3600.0}
TIME |= {"d": DAY, "day": DAY, "days": DAY} | dict.fromkeys(("yr", "year", "years"), YEAR)
STRESS = {"pa": 1.0, "kpa": 1e3, "mpa": 1e6, "gpa": 1e9, "bar": 1e5}
NUMBER = {"-": 1.0, "1": 1.0, "": 1.0}
SPEED = {f"{m}/{s}": value / span for m, value in LENGTH.items() for s, span in TIME.items()}
COLUMNS = {
    "time": (TIME, ("time", "t")),
    "load_point": (LENGTH, ("load_point", "load_point_displacement", "lp_disp", "displacement")),
    "friction": (NUMBER, ("friction", "mu", "μ", "friction_coefficient")),
    "shear_stress": (STRESS, ("shear_stress", "tau")),
    "normal_stress": (STRESS, ("normal_stress", "sigma_n", "effective_normal_stress")),
    "slip": (LENGTH, ("slip", "fault_slip")),
    "velocity": (SPEED, ("velocity", "slip_velocity", "slip_rate")),
    "theta": (TIME, ("theta", "state")),
}
LEAST = 10  # rows
SHOWN = 8  # columns that a message lists


@readable
class LabRecord(NamedTuple):
    """A record of N samples in metres, seconds and pascals; missing columns are None."""

    time: np.ndarray  # [s]
    friction: np.ndarray  # [1]
    load_point: np.ndarray | None = None  # [m]
    normal_stress: np.ndarray | None = None  # [Pa]
    slip: np.ndarray | None = None  # [m]
    velocity: np.ndarray | None = None  # [m/s]
    theta: np.ndarray | None = None  # [s]

    check_entries = check_types


@checked
def read_csv(path: str | Path, *, columns: dict[str, int] | None = None) -> LabRecord:
    """Read a record from a CSV file.

    The file has one row of headers such as `time [s], load_point [um], friction [-]`, followed by numbers; units may
    also be in parentheses. Required columns are time; friction, or shear_stress and normal_stress; load_point, or
    velocity (of slip). Optional columns are slip and theta; others are ignored. Separators are commas, semicolons or
    tabs; with the last two, numbers may have decimal commas. Lines that start with # are comments. Files that are not
    UTF-8 are read as Windows-1252. Rows with an empty cell in a column that is used are skipped, with a warning.

    Parameters
    ----------
    columns : for a file without headers: column numbers, counted from 0, keyed by the headers they stand for, as in
        {"time": 0, "load_point [um]": 1, "friction": 3}; a column without a unit is in metres, seconds or pascals

    Raises
    ------
    ValueError
        with one sentence that names the offending column, unit or line, and states what is allowed.
    """
    path = Path(path)
    header, rows = _read(path, columns)
    places = _match_columns(path, header, si=columns is not None)
    _check_columns(path, header, places)
    full = [row for row in rows if all(row[1][k] for k, _ in places.values())]
    if len(full) < len(rows):
        first = next(number for number, fields in rows if not all(fields[k] for k, _ in places.values()))
        warnings.warn(
            f"{path}: {len(rows) - len(full)} of {len(rows)} rows have an empty cell and are left out; the first is "
            f"line {first}",
            stacklevel=2,
        )
    rows = full
    if len(rows) < LEAST:
        raise ValueError(f"{path} has {len(rows)} rows of numbers: give at least {LEAST}")
    values = {name: np.array([_parse_number(path, row, k, name) for row in rows]) for name, (k, _) in places.items()}
    for name, (_, factor) in places.items():
        values[name] *= factor
    if "friction" not in values:
        if not (values["normal_stress"] > 0).all():
            raise ValueError(f"{path}: normal_stress must be positive at every sample: remove samples before loading")
        values["friction"] = values["shear_stress"] / values["normal_stress"]
    values.pop("shear_stress", None)
    if (values["friction"] < 0).all():
        raise ValueError(f"{path}: friction is negative throughout: is its sign reversed? give positive values")
    try:
        check_times(values["time"])
    except ValueError as problem:
        raise ValueError(f"{path}: {problem}") from None
    return LabRecord(**values)


@checked
def write_csv(path: str | Path, record: LabRecord, comments: tuple[str, ...] = ()) -> Path:
    """Write a record to a CSV file that `read_csv` can read, in metres, seconds and pascals.

    Parameters
    ----------
    comments : lines written before the header, each after a #
    """
    units = {"time": "s", "friction": "-", "normal_stress": "Pa", "velocity": "m/s", "theta": "s"}
    names = [name for name in LabRecord._fields if getattr(record, name) is not None]
    labels, path = [heading_of(name, units.get(name, "m")) for name in names], Path(path)
    rows = zip(*(getattr(record, name) for name in names), strict=True)
    write_table(path, labels, rows, digits=12, comments=comments)
    return path


@checked
def record_data(record: LabRecord, *, before: float | None = None, normal: bool = False) -> Data:
    """Data for `fit`: legs from the load-point displacement, or, if it was not recorded, the slip velocity.

    Parameters
    ----------
    before : slip velocity before the record, if it does not start with steady sliding [m/s]
    normal : True to include changes in normal stress, relative to its initial value (alpha, after Linker and Dieterich)
    """
    time = record.time - record.time[0]
    if record.load_point is None:
        return Data(time, record.friction, velocity=record.velocity, before=before)
    factor = None
    if normal:
        if record.normal_stress is None:
            raise ValueError("the record has no normal_stress: leave --normal out")
        factor = record.normal_stress / record.normal_stress[0]
    legs = load_steps(time, record.load_point, factor)
    if before is None and not legs[0].velocity > 0:
        raise ValueError(
            "the record does not start with sliding: give the slip velocity before it, or remove the start"
        )
    return Data(time, record.friction, legs, before=before)


def _read(path: Path, columns: dict[str, int] | None) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Read the fields of the header, and the line number and fields of each row."""
    rows = read_table(path)
    if columns is None:
        return rows[0][1], rows[1:]
    width = len(rows[0][1])
    header = [""] * width
    for name, k in columns.items():
        if not 0 <= k < width:
            raise ValueError(f"{path}: column {k} was given for {name!r}: the file has columns 0 to {width - 1}")
        header[k] = name
    return header, rows


def _match_columns(path: Path, header: list[str], *, si: bool) -> dict[str, tuple[int, float]]:
    """Positions of known columns, and factors that convert them to metres, seconds and pascals."""
    places = {}
    for k, field in enumerate(header):
        word, unit = split_label(field)
        word = word.lower().replace(" ", "_").replace("-", "_")
        name = next((name for name, (_, aliases) in COLUMNS.items() if word in aliases), None)
        if name is None:
            continue
        if name in places:
            raise ValueError(f"{path} has two columns for {name}: keep one")
        units = COLUMNS[name][0]
        if unit is None and si:
            unit = next(iter(units)) if units is not STRESS else "Pa"
        elif unit is None and units is not NUMBER:
            raise ValueError(f"{path}: column {word!r} has no unit: write it as '{word} [{next(iter(units))}]'")
        unit = unit or ""
        known = unit.lower() if units is STRESS else unit.replace(" ", "")
        if known not in units:
            raise ValueError(f"{path}: {word} has the unit {shortened(unit)!r}: use {', '.join(_common_units(units))}")
        places[name] = (k, units[known])
    return places


def _common_units(units: dict) -> list[str]:
    return [unit for unit in units if unit][:8]


def _check_columns(path: Path, header: list[str], known: dict) -> None:
    """Raise ValueError if the header lacks columns that a fit needs; with the columns seen and sought."""
    example = "as in 'time [s], load_point [um], friction [-]'"
    if "time" not in known:
        lacks, sought = "time", _names("time")
    elif "friction" not in known and not {"shear_stress", "normal_stress"} <= set(known):
        lacks = "friction"
        stresses = f"{_names('shear_stress')} with {_names('normal_stress')}, such as 'shear_stress [MPa]'"
        sought = f"{_names('friction')}, or {stresses} and 'normal_stress [MPa]'"
    elif "load_point" not in known and "velocity" not in known:
        lacks, sought = "load_point or velocity", f"{_names('load_point')}, or {_names('velocity')}"
    else:
        return
    seen = [repr(shortened(field)) for field in header if field]
    more = f" and {len(seen) - SHOWN} more" if len(seen) > SHOWN else ""
    raise ValueError(
        f"{path} has no column for {lacks}: its columns are {', '.join(seen[:SHOWN])}{more}, and {lacks} is sought "
        f"under the names {sought}; rename one, {example}"
    )


def _names(column: str) -> str:
    return ", ".join(COLUMNS[column][1])


def _parse_number(path: Path, row: tuple[int, list[str]], k: int, name: str) -> float:
    line, fields = row
    try:
        value = parse_number(fields[k])
    except ValueError:
        raise ValueError(
            f"{path}, line {line}: {name} is {shortened(fields[k])!r}, not a number: correct or remove the line"
        ) from None
    if not np.isfinite(value):
        raise ValueError(
            f"{path}, line {line}: {name} is {shortened(fields[k])}, not a finite number: remove such lines"
        )
    return value
