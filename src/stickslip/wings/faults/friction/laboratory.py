"""Laboratory records, converted to metres, seconds and pascals on reading."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....kit import check_types, checked, heading_of, known, laboratory_table, readable, require_filled, write_table
from .fitting import Data
from .loads import check_times, contradiction, find_steps, load_steps, stated_steps, with_normal

EXAMPLE, NUMBERED = "time [s], load_point [um], friction [-]", "--columns 'time [s]=0,load_point [um]=1,friction=2'"
WANTED = laboratory_table.Wanted(
    ("time", "load_point", "friction", "shear_stress", "normal_stress", "pore_pressure", "slip", "velocity", "theta"),
    EXAMPLE, "column of a record", NUMBERED, ("pore_pressure",),
)  # fmt: skip
LEAST = 10  # rows
LEAST_FRICTION, MOST_FRICTION = 0.005, 3.0  # beyond which a unit is doubted
CROOKED = 0.2  # straight legs per sample from which a displacement counts as noisy


@readable
class LabRecord(NamedTuple):
    """A record of N samples in metres, seconds and pascals; missing columns are None."""

    time: np.ndarray  # (N,) [s]
    friction: np.ndarray  # (N,) [1]
    load_point: np.ndarray | None = None  # (N,) [m]
    normal_stress: np.ndarray | None = None  # (N,) [Pa]
    slip: np.ndarray | None = None  # (N,) [m]
    velocity: np.ndarray | None = None  # (N,) [m/s]
    theta: np.ndarray | None = None  # (N,) [s]

    check_entries = check_types


@checked
def read_record(path: str | Path, *, columns: dict[str, int | str] | None = None, motion: bool = True) -> LabRecord:
    """Read a record from a table as text, an HDF5 or a MATLAB file, whichever its content is.

    Required columns are time; friction, or shear_stress and normal_stress; load_point, or velocity (of slip). Optional
    columns are slip, theta and pore_pressure, by which the normal stress is made the effective one unless it is named
    effective_normal_stress; a friction that the record has is taken as it is. `record_columns` lists what is not used,
    and a warning names what is not understood. Units stand in brackets (`time [s]`), after the name (`time_s`), in
    a row below the names, or in the attribute `units` of an HDF5 dataset. Text may begin with any lines; separators are
    commas, semicolons, tabs or white space; except with commas, numbers may have decimal commas. Lines that start with
    # or % are comments. Files that are not UTF-8 are read as Windows-1252. Rows without a number (an empty cell, nan,
    or -9999 far from all others) in a column that is used are left out, and a displacement that is counted backwards
    is turned round, each with a warning.

    Parameters
    ----------
    columns : numbers of columns, counted from 0, or their headings, keyed by the names they stand for, as in
        {"time": 0, "load_point [um]": "LVDT 2", "friction": 3}. A column without a unit has that of its heading; in a
        file without headings it is in metres, seconds or pascals
    motion : False if the record need not say how the load point moved, as with `record_data(…, velocity=…)`

    Raises
    ------
    ValueError
        with one sentence that names the offending column, unit or line, and states what is allowed.
    """
    path = Path(path)
    table = _open_record(path, columns)
    _check_columns(table, motion)
    if told := table.list_unknown():
        warnings.warn(
            f"{path}: not understood, and not used: {told}; name a column with --columns if it is needed", stacklevel=2
        )
    values = table.numbers()
    if len(values["time"]) < LEAST:
        raise ValueError(f"{path} has {len(values['time'])} rows of numbers: give at least {LEAST}")
    _make_effective(path, values)
    if "friction" not in values:
        if not (values["normal_stress"] > 0).all():
            raise ValueError(f"{path}: normal_stress must be positive at every sample: remove samples before loading")
        values["friction"] = values["shear_stress"] / values["normal_stress"]
    _doubt_friction(path, values)
    _doubt_time(table)
    values.pop("shear_stress", None)
    if (values["friction"] < 0).all():
        raise ValueError(f"{path}: friction is negative throughout: is its sign reversed? give positive values")
    try:
        check_times(values["time"])
    except ValueError as problem:
        raise ValueError(f"{path}: {problem}") from None
    for name in ("load_point", "slip"):
        moved = np.diff(values.get(name, ()))
        if len(moved) and moved.sum() < 0 and (moved < 0).sum() > 2 * (moved > 0).sum():
            warnings.warn(f"{path}: {name} is counted backwards: its sign was turned round", stacklevel=2)
            values[name] = -values[name]
    return LabRecord(**values)


def _doubt_friction(path: Path, values: dict[str, np.ndarray]) -> None:
    """Warn of friction that no material has, as in per cent or of mixed units, or that differs from its stresses."""
    usual = float(np.median(np.abs(values["friction"])))
    told = f"{path}: friction is about {usual:.3g}"
    if usual > MOST_FRICTION or 0 < usual < LEAST_FRICTION:
        warnings.warn(f"{told}: is it in per cent, or are units of the stresses mixed up?", stacklevel=3)
    if {"shear_stress", "normal_stress"} <= set(values) and (values["normal_stress"] > 0).all():
        ratio = float(np.median(np.abs(values["shear_stress"] / values["normal_stress"])))
        if abs(ratio - usual) > 0.1 * usual:
            warnings.warn(
                f"{told}, and shear over normal stress is about {ratio:.3g}: friction is used; correct the column that "
                f"is wrong",
                stacklevel=3,
            )


def _doubt_time(table: laboratory_table.LaboratoryTable) -> None:
    """Warn if a displacement over time is a velocity of the record times the ratio of two units of time."""
    path, sheet, places = table.path, table.sheet, table.places
    units = [
        laboratory_table.unit_of(heading, (), {})[1] or unit
        for heading, unit in zip(sheet.headings, sheet.units, strict=True)
    ]
    taken = {k for k, _ in places.values()}
    speeds = [places["velocity"]] if "velocity" in places else []
    known_units = laboratory_table.SPEED
    speeds += [(k, known_units[unit]) for k, unit in enumerate(units) if unit in known_units and k not in taken]
    for name in ("load_point", "slip"):
        for speed in speeds if name in places else ():
            columns = [table.loose_numbers(k) * factor for k, factor in (places["time"], places[name], speed)]
            t, x, v = np.compress(np.isfinite(columns).all(axis=0), columns, axis=1)
            way = float(np.trapezoid(v, t)) if len(t) > 1 else 0.0
            ratio = abs(float(x[-1] - x[0]) / way) if way else 1.0
            if unit := laboratory_table.unit_of_time(ratio, places["time"][1]):
                warnings.warn(
                    f"{path}: {name} over time is {ratio:.3g} times {sheet.headings[speed[0]]!r}: times seem to be in "
                    f"{unit}, unless the unit of the displacement or of the velocity is wrong",
                    stacklevel=3,
                )
                return


@checked
def record_columns(path: str | Path, *, columns: dict[str, int | str] | None = None) -> dict[str, list[str]]:
    """Headings of a record in three groups: used, without influence on forces, and not understood.

    Parameters
    ----------
    columns : as in `read_record`
    """
    table = _open_record(Path(path), columns)
    groups: dict[str, list[str]] = {known.USED: [], known.HARMLESS: [], known.UNKNOWN: []}
    for name, group, why in table.groups("it may change the effective normal stress"):
        groups[group].append(f"{name}: {why}" if why else name)
    return groups


@checked
def write_csv(path: str | Path, record: LabRecord, comments: tuple[str, ...] = ()) -> Path:
    """Write a record to a CSV file that `read_record` can read, in metres, seconds and pascals.

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
def record_data(
    record: LabRecord, *, before: float | None = None, normal: bool = False, velocity: str | None = None
) -> Data:
    """Data for `fit`: legs from the load-point displacement, or, if it was not recorded, the slip velocity.

    If the displacement is so noisy that hardly any samples lie on straight lines, steps of constant velocity are found
    in it, with a warning that states them as `velocity` takes them. A stated velocity that a recorded displacement
    contradicts is taken, with a warning.

    Parameters
    ----------
    velocity : velocities of the load point, such as "1e-6 until 120 s, then 1e-5", instead of its displacement
    before : slip velocity before the record, if it does not start with steady sliding [m/s]
    normal : True to include changes in normal stress, relative to its initial value (alpha, after Linker and Dieterich)
    """
    require_filled("record.time", record.time)
    time = np.asarray(record.time, float) - record.time[0]
    if record.load_point is None and velocity is None:
        return Data(time, record.friction, velocity=record.velocity, before=before)
    factor = None
    if normal:
        if record.normal_stress is None:
            raise ValueError("the record has no normal_stress: leave --normal out")
        factor = record.normal_stress / record.normal_stress[0]
    if velocity is not None:
        legs = stated_steps(velocity, record.time)
        if record.load_point is not None and (told := contradiction(legs, record.time, record.load_point)):
            warnings.warn(f"{told}: the fit takes --velocity; leave it out to take the displacement", stacklevel=2)
    else:
        legs = load_steps(time, record.load_point)
        if len(legs) > CROOKED * len(time):
            steps = find_steps(record.time, record.load_point)
            warnings.warn(f"{steps.sentence} [m, m/s, s]; give another --velocity if this is wrong", stacklevel=2)
            legs = steps.legs
    if factor is not None:
        legs = with_normal(legs, time, factor)
    if before is None and not legs[0].velocity > 0:
        start = "the record does not start with sliding"
        if velocity is not None:
            start = f"--velocity starts with {legs[0].velocity:g} m/s, but a fit starts from sliding"
        raise ValueError(f"{start}: give the slip velocity before the record (--before), or remove its start")
    return Data(time, record.friction, legs, before=before)


def _open_record(path: Path, columns: dict[str, int | str] | None) -> laboratory_table.LaboratoryTable:
    """Table of a record, without a pore pressure that there is nothing to take off from."""
    table = laboratory_table.open_table(path, WANTED, columns)
    places = dict(table.places)
    units, aliases = laboratory_table.COLUMNS["normal_stress"]
    stress = places.get("normal_stress")
    if stress is None or laboratory_table.unit_of(table.headings[stress[0]], aliases, units)[0].startswith("eff"):
        places.pop("pore_pressure", None)
    return table._replace(places=places)


def _make_effective(path: Path, values: dict[str, np.ndarray]) -> None:
    """Take the pore pressure off the normal stress."""
    pressure = values.pop("pore_pressure", None)
    if pressure is None or not pressure.any():
        return
    values["normal_stress"] = values["normal_stress"] - pressure
    kept = "; friction is the one of the record" if "friction" in values else ""
    warnings.warn(
        f"{path}: the normal stress is made effective, by the pore pressure of the record{kept}; name it "
        f"effective_normal_stress (--columns) if it is already",
        stacklevel=3,
    )


def _check_columns(table: laboratory_table.LaboratoryTable, motion: bool) -> None:
    """Raise ValueError if the header lacks columns that a fit needs; with the columns seen and sought."""
    path, header, there = table.path, table.headings, table.places
    if "time" not in there:
        lacks, sought = "time", _names("time")
    elif "friction" not in there and not {"shear_stress", "normal_stress"} <= set(there):
        lacks = "friction"
        stresses = f"{_names('shear_stress')} with {_names('normal_stress')}, such as 'shear_stress [MPa]'"
        sought = f"{_names('friction')}, or {stresses} and 'normal_stress [MPa]'"
    elif motion and "load_point" not in there and "velocity" not in there:
        lacks, sought = "load_point or velocity", f"{_names('load_point')}, or {_names('velocity')}"
    else:
        return
    if not (seen := table.list_columns()):
        nameless = f"its {len(header)} columns have no headings; give their numbers ({NUMBERED})"
        raise ValueError(f"{path} has no column for {lacks}: {nameless if header else 'it has no columns of numbers'}")
    raise ValueError(
        f"{path} has no column for {lacks}: its columns are {seen}, and {lacks} is sought under the names {sought}; "
        f"rename one, as in '{EXAMPLE}'"
    )


def _names(column: str) -> str:
    foreign = laboratory_table.OTHER_LANGUAGES.get(column, "").split()
    return ", ".join(name for name in laboratory_table.COLUMNS[column][1] if name not in foreign)
