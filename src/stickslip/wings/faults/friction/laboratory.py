"""Laboratory records, converted to metres, seconds and pascals on reading."""

import contextlib
import difflib
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....core.tables import split_label
from ....kit import check_types, checked, heading_of, parse_number, readable, require_filled, shortened, write_table
from ....known import HARMLESS, UNKNOWN, USED, find_row
from .fitting import Data
from .loads import check_times, contradiction, find_steps, load_steps, stated_steps, with_normal
from .record_files import LENGTH, NUMBER, SPEED, STRESS, TIME, Sheet, read_sheet, unit_of, unit_of_time

COLUMNS = {  # where several columns of a file have names of one quantity, the first of these names is taken
    "time": (TIME, ("time", "t", "sample_time", "elapsed_time", "test_time", "time_elapsed")),
    "load_point": (
        LENGTH,
        ("load_point", "load_point_displacement", "load_point_disp", "loadpoint", "lp_displacement", "lp_disp",
         "lpdisp", "shear_displacement", "shear_disp", "vdcdt", "displacement", "disp"),
    ),
    "friction": (
        NUMBER, ("friction", "mu", "μ", "friction_coefficient", "coefficient_of_friction", "friction_coeff", "cof")
    ),
    "shear_stress": (STRESS, ("shear_stress", "shr_stress", "tau", "τ", "shear", "vstress")),
    "normal_stress": (
        STRESS,
        ("effective_normal_stress", "eff_normal_stress", "eff_norm_stress", "effns", "normal_stress", "norm_stress",
         "nor_stress", "sigma_n", "σ_n", "sn", "hstress"),
    ),
    "pore_pressure": (
        STRESS,
        ("pore_pressure", "pore_press", "pore_pres", "porepressure", "pore_fluid_pressure", "pore_water_pressure",
         "fluid_pressure", "water_pressure", "pore", "p_pore", "pore_p", "pp", "p_p", "pf", "p_f", "pfluid", "p_fluid"),
    ),
    "slip": (LENGTH, ("slip", "fault_slip", "ec_disp")),
    "velocity": (SPEED, ("velocity", "slip_velocity", "slip_rate")),
    "theta": (TIME, ("theta", "state")),
}  # fmt: skip
LEAST = 10  # rows
LEAST_FRICTION, MOST_FRICTION = 0.005, 3.0  # beyond which a unit is doubted
ABSENT = (-9999.0, -999.0, -99999.0)  # written by some programs where there is no number
CROOKED = 0.2  # straight legs per sample from which a displacement counts as noisy
SHOWN = 8  # columns that a message lists


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
    sheet, headings, places = _find_columns(path, columns)
    _check_columns(path, headings, places, motion)
    strange = [name for name, group, _ in _grouped_columns(sheet, places) if group == UNKNOWN]
    if strange:
        told = ", ".join(repr(shortened(name)) for name in strange[:SHOWN]) + (" …" if len(strange) > SHOWN else "")
        warnings.warn(
            f"{path}: not understood, and not used: {told}; name a column with --columns if it is needed", stacklevel=2
        )
    values = _numbers(path, sheet, {name: k for name, (k, _) in places.items()})
    if len(values["time"]) < LEAST:
        raise ValueError(f"{path} has {len(values['time'])} rows of numbers: give at least {LEAST}")
    for name, (_, factor) in places.items():
        values[name] = values[name] * factor
    _make_effective(path, values)
    if "friction" not in values:
        if not (values["normal_stress"] > 0).all():
            raise ValueError(f"{path}: normal_stress must be positive at every sample: remove samples before loading")
        values["friction"] = values["shear_stress"] / values["normal_stress"]
    _doubt_friction(path, values)
    _doubt_time(path, sheet, places)
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


def _doubt_time(path: Path, sheet: Sheet, places: dict[str, tuple[int, float]]) -> None:
    """Warn if a displacement over time is a velocity of the record times the ratio of two units of time."""
    units = [unit_of(heading, (), {})[1] or unit for heading, unit in zip(sheet.headings, sheet.units, strict=True)]
    taken = {k for k, _ in places.values()}
    speeds = [places["velocity"]] if "velocity" in places else []
    speeds += [(k, SPEED[unit]) for k, unit in enumerate(units) if unit in SPEED and k not in taken]
    for name in ("load_point", "slip"):
        for speed in speeds if name in places else ():
            columns = [_loose_numbers(sheet, k) * factor for k, factor in (places["time"], places[name], speed)]
            t, x, v = np.compress(np.isfinite(columns).all(axis=0), columns, axis=1)
            way = float(np.trapezoid(v, t)) if len(t) > 1 else 0.0
            ratio = abs(float(x[-1] - x[0]) / way) if way else 1.0
            if unit := unit_of_time(ratio, places["time"][1]):
                warnings.warn(
                    f"{path}: {name} over time is {ratio:.3g} times {sheet.headings[speed[0]]!r}: times seem to be in "
                    f"{unit}, unless the unit of the displacement or of the velocity is wrong",
                    stacklevel=3,
                )
                return


def _loose_numbers(sheet: Sheet, k: int) -> np.ndarray:
    """Numbers of a column, NaN for what is none."""
    if sheet.values is not None:
        return sheet.values[k]
    column = np.full(len(sheet.rows or ()), np.nan)
    for row, (_, fields) in enumerate(sheet.rows or ()):
        with contextlib.suppress(ValueError):
            column[row] = parse_number(fields[k])
    return np.where(_is_missing(column), np.nan, column)


@checked
def record_columns(path: str | Path, *, columns: dict[str, int | str] | None = None) -> dict[str, list[str]]:
    """Headings of a record in three groups: used, without influence on forces, and not understood.

    Parameters
    ----------
    columns : as in `read_record`
    """
    sheet, _, places = _find_columns(Path(path), columns)
    groups: dict[str, list[str]] = {USED: [], HARMLESS: [], UNKNOWN: []}
    for name, group, why in _grouped_columns(sheet, places):
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


def _find_columns(
    path: Path, columns: dict[str, int | str] | None
) -> tuple[Sheet, list[str], dict[str, tuple[int, float]]]:
    """Sheet of a record, its headings as the user names them, and the places and factors of known columns."""
    for name in columns or ():
        if not _described(name)[0]:
            near = difflib.get_close_matches(name, COLUMNS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"use {', '.join(COLUMNS)}, with a unit such as 'time [s]'"
            raise ValueError(f"a column {name!r} was named, which is not known: {hint}")
    sheet = read_sheet(path, lambda heading: _is_known(heading, columns), named=columns is not None)
    headings, bare = (sheet.headings, False) if columns is None else _named_headings(path, sheet, columns)
    below = sheet.units if columns is None else [None] * len(headings)
    places = _match_columns(path, headings, below, si=bare)
    units, aliases = COLUMNS["normal_stress"]
    if "normal_stress" in places and unit_of(headings[places["normal_stress"][0]], aliases, units)[0].startswith("eff"):
        places.pop("pore_pressure", None)
    if "normal_stress" not in places:
        places.pop("pore_pressure", None)
    return sheet, headings, places


def _grouped_columns(sheet: Sheet, places: dict[str, tuple[int, float]]) -> list[tuple[str, str, str]]:
    """Heading, group and reason of each column; those of known names that are not taken are without influence."""
    used, out = {k for k, _ in places.values()}, []
    for k, heading in enumerate(sheet.headings):
        word, unit = unit_of(heading, (), {})
        row = find_row("column of a record", word)
        stress = (unit or sheet.units[k] or word.rpartition("_")[2]).lower() in STRESS
        known = k in used or _is_known(heading, None) or not heading
        group = USED if k in used else HARMLESS if known else row.group
        why = "" if group != UNKNOWN else row.why or "it may change the effective normal stress" * stress
        out.append((heading or f"column {k}", group, why))
    return out


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


def _is_known(heading: str, columns: dict[str, int | str] | None) -> bool:
    """Whether a heading names a column that is sought."""
    if columns is not None and heading in columns.values():
        return True
    return any(unit_of(heading, aliases, units)[0] in aliases for units, aliases in COLUMNS.values())


def _named_headings(path: Path, sheet: Sheet, columns: dict[str, int | str]) -> tuple[list[str], bool]:
    """Headings by which the user names columns, and whether the file has none of its own."""
    width, headings, bare = len(sheet.headings), [""] * len(sheet.headings), not any(sheet.headings)
    for name, place in columns.items():
        if isinstance(place, str):
            if place not in sheet.headings:
                seen = ", ".join(repr(shortened(heading)) for heading in sheet.headings[:SHOWN] if heading)
                raise ValueError(
                    f"{path}: column {place!r} was given for {name!r}: the file has {seen or 'no headings'}"
                )
            place = sheet.headings.index(place)
        if not 0 <= place < width:
            raise ValueError(f"{path}: column {place} was given for {name!r}: the file has columns 0 to {width - 1}")
        headings[place] = name
        aliases, units = _described(name)
        own, given = unit_of(sheet.headings[place], aliases, units)[1] or sheet.units[place], split_label(name)[1]
        if given is None and own and not bare:
            headings[place] = f"{name} [{own}]"
        elif given and own and units.get(own) != units.get(given):
            warnings.warn(
                f"{path}: --columns gives {name!r}, but the file has the unit {own!r} for it: {given!r} is taken",
                stacklevel=3,
            )
    units, aliases = COLUMNS["pore_pressure"]
    for k, heading in enumerate(sheet.headings):
        word, unit = unit_of(heading, aliases, units)
        if not headings[k] and word in aliases and (unit or sheet.units[k]):
            headings[k] = f"{word} [{unit or sheet.units[k]}]"
    return headings, bare


def _described(name: str) -> tuple[tuple[str, ...], dict[str, float]]:
    """Names and units of the column for which a user's name stands."""
    return next(
        ((aliases, units) for units, aliases in COLUMNS.values() if unit_of(name, aliases, units)[0] in aliases),
        ((), {}),
    )


def _numbers(path: Path, sheet: Sheet, places: dict[str, int]) -> dict[str, np.ndarray]:
    """Numbers in columns, without the samples of which one is missing; a warning tells of them."""
    rows = sheet.rows or []
    values = {
        name: np.array([_parse_number(path, row, k, name) for row in rows]) if sheet.values is None else sheet.values[k]
        for name, k in places.items()
    }
    missing = np.any([_is_missing(column) for column in values.values()], axis=0)
    if missing.any():
        first = int(missing.argmax())
        place = f"line {rows[first][0]}" if rows else f"sample {first + 1}"
        warnings.warn(
            f"{path}: {missing.sum()} of {len(missing)} rows lack a number (an empty cell, nan or -9999) and are left "
            f"out; the first is {place}",
            stacklevel=2,
        )
    return {name: column[~missing] for name, column in values.items()}


def _is_missing(column: np.ndarray) -> np.ndarray:
    """Samples without a number, or with one of `ABSENT` if it is farther from all others than any two neighbours."""
    missing = ~np.isfinite(column)
    for mark in ABSENT:
        others = np.unique(column[~missing & (column != mark)])
        if len(others) and np.abs(others - mark).min() > np.diff(others).max(initial=0.0):
            missing |= column == mark
    return missing


def _match_columns(path: Path, header: list[str], below: list[str | None], *, si: bool) -> dict[str, tuple[int, float]]:
    """Positions of known columns, and factors that convert them to metres, seconds and pascals."""
    places = {}
    for column, (units, aliases) in COLUMNS.items():
        labels = [unit_of(field, aliases, units) for field in header]
        alias = next((alias for alias in aliases if any(word == alias for word, _ in labels)), None)
        chosen = [k for k, (word, _) in enumerate(labels) if word == alias]
        if alias is None:
            continue
        if len(chosen) > 1:
            raise ValueError(f"{path} has two columns for {column}: keep one")
        others = [header[k] for k, (word, _) in enumerate(labels) if word in aliases and k != chosen[0]]
        if others:
            warnings.warn(f"{path}: {column} is {header[chosen[0]]!r}, not {others[0]!r}", stacklevel=2)
        own, row = labels[chosen[0]][1], below[chosen[0]]
        places[column] = (chosen[0], _factor(path, alias, own or row, units, si))
        if own and row in units and units[row] != places[column][1]:
            raise ValueError(f"{path}: {alias} has the unit {own!r} in its heading and {row!r} below it: keep one")
    return places


def _factor(path: Path, word: str, unit: str | None, units: dict[str, float], si: bool) -> float:
    """Factor that converts a column to metres, seconds and pascals."""
    if unit is None and units is not NUMBER:
        if si:
            return 1.0
        raise ValueError(f"{path}: column {word!r} has no unit: write it as '{word} [{next(iter(units))}]'")
    given = "" if unit is None or (units is NUMBER and unit == ".") else unit.replace(" ", "")
    known = next((u for u in units if u == given), None) or next((u for u in units if u.lower() == given.lower()), None)
    if known is None:
        raise ValueError(
            f"{path}: {word} has the unit {shortened(given)!r}: use {', '.join(list(filter(None, units))[:SHOWN])}"
        )
    return units[known]


def _check_columns(path: Path, header: list[str], known: dict, motion: bool) -> None:
    """Raise ValueError if the header lacks columns that a fit needs; with the columns seen and sought."""
    example = "as in 'time [s], load_point [um], friction [-]'"
    if "time" not in known:
        lacks, sought = "time", _names("time")
    elif "friction" not in known and not {"shear_stress", "normal_stress"} <= set(known):
        lacks = "friction"
        stresses = f"{_names('shear_stress')} with {_names('normal_stress')}, such as 'shear_stress [MPa]'"
        sought = f"{_names('friction')}, or {stresses} and 'normal_stress [MPa]'"
    elif motion and "load_point" not in known and "velocity" not in known:
        lacks, sought = "load_point or velocity", f"{_names('load_point')}, or {_names('velocity')}"
    else:
        return
    seen = [repr(shortened(field)) for field in header if field]
    if not seen:
        nameless = (
            f"its {len(header)} columns have no headings; give their numbers (--columns 'time [s]=0,load_point [um]=1,"
            f"friction=2')"
        )
        raise ValueError(f"{path} has no column for {lacks}: {nameless if header else 'it has no columns of numbers'}")
    more = f" and {len(seen) - SHOWN} more" if len(seen) > SHOWN else ""
    raise ValueError(
        f"{path} has no column for {lacks}: its columns are {', '.join(seen[:SHOWN])}{more}, and {lacks} is sought "
        f"under the names {sought}; rename one, {example}"
    )


def _names(column: str) -> str:
    return ", ".join(COLUMNS[column][1])


def _parse_number(path: Path, row: tuple[int, list[str]], k: int, name: str) -> float:
    line, fields = row
    if fields[k].lower() in ("", "nan"):
        return np.nan
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
