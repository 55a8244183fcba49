"""Laboratory records, converted to metres, seconds and pascals on reading, and model-free measurements from them.

Measurements are steady means with standard errors, peaks after holds, healing and cycles.
"""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from scipy.special import stdtrit

from ....kit import (
    POSITIVE,
    Series,
    check_types,
    checked,
    heading_of,
    known,
    laboratory_table,
    pluralize,
    readable,
    require_not_negative,
    require_shape,
    write_table,
)
from .fitting import Data
from .loads import LoadStep, check_times, contradiction, find_steps, leg_arrays, load_steps, stated_legs, with_normal
from .ranges import Positive, PositiveSeries

EXAMPLE, NUMBERED = "time [s], load_point [um], friction [-]", "--columns 'time [s]=0,load_point [um]=1,friction=2'"
WANTED = laboratory_table.Wanted(
    ("time", "load_point", "friction", "shear_stress", "normal_stress", "pore_pressure", "slip", "velocity", "theta"),
    EXAMPLE, "column of a record", NUMBERED, ("pore_pressure",),
)  # fmt: skip
LEAST = 10  # smallest number of rows
LEAST_FRICTION, MOST_FRICTION = 0.005, 3.0  # range of friction outside which its unit is doubtful
CROOKED = 0.2  # straight legs per sample above which a displacement counts as noisy


@readable
class LabRecord(NamedTuple):
    """A record of N samples in metres, seconds and pascals; missing columns are None."""

    time: Series  # (N,) [s]
    friction: np.ndarray  # (N,) [1]
    load_point: np.ndarray | None = None  # (N,) [m]
    normal_stress: np.ndarray | None = None  # (N,) [Pa]
    slip: np.ndarray | None = None  # (N,) [m]
    velocity: np.ndarray | None = None  # (N,) [m/s]
    theta: np.ndarray | None = None  # (N,) [s]

    check_entries = check_types


@checked
def read_record(path: str | Path, *, columns: dict[str, int | str] | None = None, motion: bool = True) -> LabRecord:
    """Read a record from a text table, HDF5, MATLAB or binary XLOOK file; the content determines the format.

    Required columns are time; friction, or shear_stress and normal_stress; and load_point, or velocity (of slip).
    Optional columns are slip, theta and pore_pressure. The pore pressure is subtracted from the normal stress, unless
    the column is named effective_normal_stress; a friction column is used unchanged. `record_columns` lists unused
    columns, and a warning names unknown ones. Units are in brackets (`time [s]`), after the name (`time_s`), in a row
    below the names, or in the attribute `units` of an HDF5 dataset.

    Text files may begin with arbitrary lines. Separators are commas, semicolons, tabs or white space; unless they are
    commas, numbers may have decimal commas. Lines that start with # or % are comments. Files that are not UTF-8 are
    read as Windows-1252. Rows that lack a number in a used column (an empty cell, nan, or -9999 far from all others)
    are skipped. If a displacement decreases, its sign is reversed. Each of these causes a warning.

    Parameters
    ----------
    columns : standard name → number of the column, counted from 0, or its heading, as in
        {"time": 0, "load_point [um]": "LVDT 2", "friction": 3}. Without a unit here, the unit in the heading applies;
        in a file without headings, units are metres, seconds or pascals
    motion : False if the record need not contain the motion of the load point, as with `record_data(…, velocity=…)`

    Raises
    ------
    ValueError
        If a column, unit or line cannot be interpreted; the message names it and lists the allowed ones.
    """
    path = Path(path)
    table = _open_record(path, columns)
    _check_columns(table, motion)
    if told := table.list_unknown():
        warnings.warn(
            f"{path}: unknown columns, not used: {told}; name a column with --columns if it is needed", stacklevel=2
        )
    values = table.numbers()
    if len(values["time"]) < LEAST:
        raise ValueError(f"{path} has {pluralize(len(values['time']), 'row')} of numbers: give at least {LEAST}")
    _make_effective(path, values)
    if "friction" not in values:
        if not (values["normal_stress"] > 0).all():
            raise ValueError(f"{path}: normal_stress must be positive at every sample: remove those before loading")
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
            warnings.warn(f"{path}: {name} is counted backwards: its sign was reversed", stacklevel=2)
            values[name] = -values[name]
    return LabRecord(**values)


def _doubt_friction(path: Path, values: dict[str, np.ndarray]) -> None:
    """Warn of friction that no material has (perhaps in per cent) or that contradicts the recorded stresses."""
    usual = float(np.median(np.abs(values["friction"])))
    told = f"{path}: friction is about {usual:.3g}"
    if usual > MOST_FRICTION or 0 < usual < LEAST_FRICTION:
        warnings.warn(f"{told}: is it in per cent, or do the units of the stresses differ?", stacklevel=3)
    if {"shear_stress", "normal_stress"} <= set(values) and (values["normal_stress"] > 0).all():
        ratio = float(np.median(np.abs(values["shear_stress"] / values["normal_stress"])))
        if abs(ratio - usual) > 0.1 * usual:
            warnings.warn(
                f"{told}, but shear over normal stress is about {ratio:.3g}: friction is used; correct the wrong "
                "column",
                stacklevel=3,
            )


def _doubt_time(table: laboratory_table.LaboratoryTable) -> None:
    """Warn if displacement over time differs from the recorded velocity by the ratio of two units of time."""
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
    """Headings of a record in three groups: used, without effect, and unknown.

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
    """Write a record to a CSV file in metres, seconds and pascals, which `read_record` can read.

    Parameters
    ----------
    comments : lines written before the header, each after a #
    """
    units = {"time": "s", "friction": "-", "normal_stress": "Pa", "velocity": "m/s", "theta": "s"}
    names = [name for name in LabRecord._fields if getattr(record, name) is not None]
    labels, path = [heading_of(name, units.get(name, "m")) for name in names], Path(path)
    rows = zip(*(getattr(record, name) for name in names), strict=True)
    lines = [line for text in comments for line in text.splitlines() or [""]]
    write_table(path, labels, rows, digits=12, comments=lines)
    return path


@checked
def record_data(
    record: LabRecord, *, before: Positive | None = None, normal: bool = False, velocity: str | None = None
) -> Data:
    """Data for `fit`, with legs from the load-point displacement or, if it was not recorded, the slip velocity.

    If the displacement is so noisy that hardly any samples lie on straight lines, steps of constant velocity are fitted
    to it, and a warning states them in the syntax of `velocity`. A stated velocity that contradicts the recorded
    displacement is used, with a warning.

    Parameters
    ----------
    velocity : load-point velocities that replace the displacement, such as "1e-6 until 120 s, then 1e-5"
    before : slip velocity before the record, if it does not start with steady sliding [m/s]
    normal : True to include changes of normal stress relative to its initial value (alpha of Linker and Dieterich)
    """
    time = np.asarray(record.time, float) - record.time[0]
    if record.load_point is None and velocity is None:
        return Data(time, record.friction, velocity=record.velocity, before=before)
    factor = None
    if normal:
        if record.normal_stress is None:
            raise ValueError("the record has no normal_stress: leave --normal out")
        factor = record.normal_stress / record.normal_stress[0]
    if velocity is not None:
        legs = stated_legs("velocity", velocity, record.time)
        if record.load_point is not None and (told := contradiction(legs, record.time, record.load_point)):
            warnings.warn(f"{told}: the fit uses --velocity; leave it out to use the displacement", stacklevel=2)
    else:
        legs = load_steps(time, record.load_point)
        if len(legs) > CROOKED * len(time):
            steps = find_steps(record.time, record.load_point)
            warnings.warn(f"{steps.sentence} [m, m/s, s]; if this is wrong, give --velocity", stacklevel=2)
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
    """Table of a record; the pore pressure is left out if there is no normal stress to correct."""
    table = laboratory_table.open_table(path, WANTED, columns)
    places = dict(table.places)
    units, aliases = laboratory_table.COLUMNS["normal_stress"]
    stress = places.get("normal_stress")
    if stress is None or laboratory_table.unit_of(table.headings[stress[0]], aliases, units)[0].startswith("eff"):
        places.pop("pore_pressure", None)
    return table._replace(places=places)


def _make_effective(path: Path, values: dict[str, np.ndarray]) -> None:
    """Subtract the pore pressure from the normal stress."""
    pressure = values.pop("pore_pressure", None)
    if pressure is None or not pressure.any():
        return
    values["normal_stress"] = values["normal_stress"] - pressure
    kept = "; friction is used as recorded" if "friction" in values else ""
    warnings.warn(
        f"{path}: the recorded pore pressure was subtracted from the normal stress{kept}; name that column "
        f"effective_normal_stress (--columns) if it is already effective",
        stacklevel=3,
    )


def _check_columns(table: laboratory_table.LaboratoryTable, motion: bool) -> None:
    """Raise ValueError if the header lacks required columns; the message lists present and required names."""
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
        f"{path} has no column for {lacks}: its columns are {seen}, and accepted names of {lacks} are {sought}; "
        f"rename one, as in '{EXAMPLE}'"
    )


def _names(column: str) -> str:
    return ", ".join(laboratory_table.QUANTITIES[column][1].split())


@readable
class Mean(NamedTuple):
    """Mean of correlated values."""

    mean: float
    error: float  # standard error
    effective: float  # number of independent values that would give the same error


@readable
class Healing(NamedTuple):
    """Fitted excess of peak friction over steady friction after a hold of duration t, Δμ = slope ln t + intercept."""

    slope: float  # per e-fold of hold time
    intercept: float
    error: float  # standard error of the slope
    interval: tuple[float, float]  # 95 % interval of the slope


@readable
class HoldResponse(NamedTuple):
    """Response of friction to the K holds in a record."""

    hold: np.ndarray  # duration [time]
    steady: np.ndarray  # friction before the hold
    drop: np.ndarray  # decrease of friction until the end of the hold
    excess: np.ndarray  # peak friction after the hold minus `steady`


@checked
def steady_mean(values: Series) -> Mean:
    """Mean of a stationary series, with a standard error that accounts for correlation.

    error² = s² 2τ/N with the integrated autocorrelation time τ = ½ + Σ ρ_l, summed up to the first lag above 5τ
    (A. Sokal, doi:10.1007/978-1-4899-0319-8_6); s² is corrected for the scatter of the mean.

    Parameters
    ----------
    values : (N,), evenly sampled

    Examples
    --------
    >>> found = steady_mean(np.sin(np.arange(1000.0)))
    >>> abs(found.mean) < 3 * found.error + 0.01
    True
    """
    x = _check_series(values, least=8)
    n, mean = len(x), float(x.mean())
    rest = x - mean
    variance = float(rest @ rest) / n
    if variance <= (1e-14 * max(abs(mean), 1e-300)) ** 2:
        return Mean(mean, 0.0, float(n))
    spectrum = np.fft.rfft(rest, 2 * n)
    rho = np.fft.irfft(np.abs(spectrum) ** 2)[: n // 2] / (n * variance)
    sums = 0.5 + np.cumsum(rho[1:])
    enough = np.flatnonzero(np.arange(1, len(sums) + 1) >= 5 * sums)
    tau = max(float(sums[enough[0] if len(enough) else -1]), 0.5)
    tau = min(tau, n / 4)
    effective = n / (2 * tau)
    return Mean(mean, float(np.sqrt(variance / max(effective - 1, 0.5))), float(effective))


@checked
def steady_start(values: Series, *, batch: Annotated[int, POSITIVE] = 5) -> int:
    """Index from which a series with an initial transient can be considered steady.

    The cut d minimises Σ_{i≥d} (x_i − mean)²/(N − d)², computed from means of `batch` values, and removes at most half
    of the series (MSER; K. P. White, doi:10.1177/003754979706900601).

    Parameters
    ----------
    values : (N,), evenly sampled
    """
    batch = int(batch)  # True becomes 1
    x = _check_series(values, least=4 * batch)
    means = x[: len(x) // batch * batch].reshape(-1, batch).mean(axis=1)[::-1]
    count = np.arange(1, len(means) + 1)
    spread = np.maximum(np.cumsum(means**2) - np.cumsum(means) ** 2 / count, 0.0)
    score = (spread / count**2)[::-1][: len(means) // 2 + 1]
    return int(np.argmin(score)) * batch


@checked
def healing(hold: PositiveSeries, excess: Series) -> Healing:
    """Least-squares fit of the peak excess against ln(hold time), with the 95 % interval of Student's t distribution.

    Parameters
    ----------
    hold : (K,) K ≥ 3 [time]
    excess : (K,) peak friction above steady friction
    """
    hold, excess = np.asarray(hold, float), np.asarray(excess, float)
    require_shape(hold.shape, excess=excess)
    if len(np.unique(hold)) < 3:
        raise ValueError(f"a fit with an interval needs three different holds, got {len(np.unique(hold))}")
    x = np.log(hold) - np.log(hold).mean()
    slope = float(x @ excess / (x @ x))
    rest = excess - excess.mean() - slope * x
    error = float(np.sqrt(rest @ rest / (len(x) - 2) / (x @ x)))
    reach = float(stdtrit(len(x) - 2, 0.975)) * error
    intercept = float(excess.mean() - slope * np.log(hold).mean())
    return Healing(slope, intercept, error, (slope - reach, slope + reach))


@checked
def hold_response(time: Series, friction: Series, legs: Iterable[LoadStep], *, before: Positive = 0.2) -> HoldResponse:
    """Drop of friction during each hold of a record, and the peak after it.

    Parameters
    ----------
    time, friction : (N,), from the start of the legs
    legs : legs of the load point; a hold is a leg of velocity 0 between two others
    before : final fraction of the leg before a hold, over which steady friction is averaged
    """
    legs = tuple(legs)
    time, friction, ends = np.asarray(time, float), np.asarray(friction, float), np.cumsum(leg_arrays(legs)[0])
    if friction.shape != time.shape:
        raise ValueError(f"friction must have one value per time, got shapes {friction.shape} and {time.shape}")
    drops = []
    for k in range(1, len(legs) - 1):
        if legs[k].velocity != 0.0:
            continue
        start, stop = ends[k - 1], ends[k]
        prior = friction[(time > start - before * legs[k - 1].duration) & (time <= start)]
        within, after = friction[(time > start) & (time <= stop)], friction[(time > stop) & (time <= ends[k + 1])]
        if not (len(prior) and len(within) and len(after)):
            raise ValueError(
                f"no samples before, during or after the hold at time {start:g}: a higher sampling rate is needed"
            )
        level = float(prior.mean())
        drops.append((legs[k].duration, level, level - float(within[-1]), float(after.max()) - level))
    if not drops:
        raise ValueError("the legs contain no hold (velocity 0) between two others: there is nothing to measure")
    return HoldResponse(*np.array(drops).T)


def _check_series(values, least: int) -> np.ndarray:
    x = np.asarray(values, float)
    if x.ndim != 1 or len(x) < least:
        raise ValueError(f"values have shape {x.shape}: give a one-dimensional array of at least {least}")
    require_not_negative(values=float(np.abs(x).max(initial=0.0)))
    return x


CONTRAST = 100.0  # slip velocity at which an event begins, over the median velocity
SKIPPED = 1  # number of initial intervals excluded because they depend on the start


def passing_velocity(time, slip, velocity) -> np.ndarray:
    """Slip velocity at samples, or the mean velocity up to the next sample if that is larger.

    Events that begin and end between two samples appear only in the mean velocity.
    """
    mean = np.append(np.diff(slip) / np.diff(time), velocity[-1])
    return np.maximum(velocity, mean)


def event_starts(velocity) -> np.ndarray:
    """Indices of the samples at which events begin: the velocity rises above CONTRAST times its median."""
    fast = velocity > CONTRAST * np.median(velocity)
    return np.flatnonzero(fast[1:] & ~fast[:-1]) + 1


def recurrence(time, velocity) -> float:
    """Mean time between the starts of events, without the first interval; NaN with fewer than three events."""
    intervals = np.diff(np.asarray(time)[event_starts(velocity)])[SKIPPED:]
    return float(np.mean(intervals)) if len(intervals) else np.nan


def repeated_slip(time, velocity, slip, since) -> np.ndarray | None:
    """Slip since the start of an event, with the last complete cycle repeated; None if there is none.

    Parameters
    ----------
    since : (N,) times since the start of the event; negative before it
    """
    starts = event_starts(velocity)
    if len(starts) < SKIPPED + 2:
        return None
    first, last = starts[-2], starts[-1]
    period, jump = time[last] - time[first], slip[last] - slip[first]
    count = np.floor(since / period)
    part = slice(first, last + 1)
    return count * jump + np.interp(since - count * period, time[part] - time[first], slip[part] - slip[first])
