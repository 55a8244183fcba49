"""Tables of events and of strain steps: dictionaries of columns, and CSV files with units in the header.

Every table has the column `sample`, the seed of the packing. Columns with several values for each event, such as the
eigenvalue at several distances, are arrays with two dimensions; in a file they are spread over numbered columns.
"""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from .... import kit
from ....kit import EVENT_RATIO, Fields, checked, current_units, heading_of, in_units, split_label, units_of
from ....results import Event, StrainStep

Table = dict[str, np.ndarray]
LENGTHS = {"jump": "D", "newton_distance": "D"}  # in mean diameters
_WHOLE = ("sample", "trigger_i", "trigger_j", "opened", "closed")
_SPREAD = re.compile(r"(\w+)_(\d+)")


def event_table(samples) -> Table:
    """Return one row for each event of several samples: sample, kind, and the other fields of `Event`."""
    rows = [(sample.seed, event) for sample in samples for event in sample.found.events]
    events = [event for _, event in rows]
    places = [_places(event.distances, sample.found.step) for sample in samples for event in sample.found.events]
    out: Table = {"sample": np.array([seed for seed, _ in rows], int)}
    for name in Event._fields:
        values = [getattr(event, name) for event in events]
        if name == "kind":
            out[name] = np.array([kind.name.lower() for kind in values], str)
        elif name == "trigger":
            pairs = np.array(values, int).reshape(-1, 2)
            out |= {"trigger_i": pairs[:, 0], "trigger_j": pairs[:, 1]}
        elif name in ("opened", "closed"):
            out[name] = np.array(values, int)
        elif name in ("distances", "softest", "re_pair", "growth"):
            out[name] = _stack_by_distance(values, places)
        else:
            out[name] = np.array(values, float)
    return Fields(out, Event)


def step_table(samples) -> Table:
    """Return one row for each strain step of several samples: sample, and the fields of `StrainStep`."""
    counts = [len(sample.found.steps.strain) for sample in samples]
    out: Table = {"sample": np.repeat([sample.seed for sample in samples], counts)}
    for name in StrainStep._fields:
        out[name] = np.concatenate([getattr(sample.found.steps, name) for sample in samples])
    return Fields(out, StrainStep)


def _places(distances: np.ndarray, step: float) -> np.ndarray:
    """Return k of each distance step · 8^(−k)."""
    return np.round(np.log(step / distances) / np.log(EVENT_RATIO)).astype(int)


def _stack_by_distance(values: list, places: list) -> np.ndarray:
    """Stack the values of several events so that a column belongs to one distance; NaN where there is no value."""
    out = np.full((len(values), 1 + max((int(k.max()) for k in places if len(k)), default=-1)), np.nan)
    for row, value, k in zip(out, values, places, strict=True):
        row[k] = value
    return out


def write_table(path: Path, table: Table, digits: int = 8) -> None:
    """Write a table as CSV, with units in the header and numbers with a number of significant digits."""
    columns, units = {}, units_of(Event) | units_of(StrainStep) | LENGTHS
    for name, values in table.items():
        unit = units.get(name, "1")
        unit = in_units(unit, current_units()) if current_units() else unit.replace("force/length^(dim-1)", "stress")
        flat = {name: values} if values.ndim == 1 else {f"{name}_{k}": v for k, v in enumerate(values.T)}
        columns |= {
            label if values.dtype.kind == "U" else heading_of(label, unit.replace("^", "")): column
            for label, column in flat.items()
        }
    kit.write_table(path, columns, zip(*columns.values(), strict=True), digits=digits)


@checked
def read_table(path: str | Path) -> Table:
    """Read a table that a catalogue wrote; columns have the names that the archive uses, without units.

    Parameters
    ----------
    path : events.csv or steps.csv in the folder of a run

    Examples
    --------
    >>> import stickslip as ss
    >>> read_table = ss.experiments.catalogue.read_table
    >>> events = read_table("results/catalogue/events.csv")  # doctest: +SKIP
    """
    (_, labels), *rows = kit.read_table(path, remedy="give events.csv or steps.csv in the folder of a run")
    out: dict[str, list] = {}
    for label, cells in zip(labels, np.array([fields for _, fields in rows]).reshape(-1, len(labels)).T, strict=True):
        name, unit = split_label(label)
        spread = _SPREAD.fullmatch(name)
        kind = int if name in _WHOLE else str if unit is None else float
        out.setdefault(spread[1] if spread else name, []).append(cells.astype(kind))
    return {name: parts[0] if len(parts) == 1 else np.stack(parts, axis=1) for name, parts in out.items()}


def stack_tables(tables: Iterable[tuple[str, Table]], label: str) -> Table:
    """Stack tables with the same columns, with a first column that names the table each row comes from.

    Tables without rows may lack the columns that have several values in each row.
    """
    tables = list(tables)
    full = max((table for _, table in tables), key=len)
    width = {
        name: max(t[name].shape[1] for _, t in tables if name in t) for name, values in full.items() if values.ndim > 1
    }
    out: Table = {label: np.repeat([name for name, _ in tables], [len(t["sample"]) for _, t in tables])}
    for name in full:
        columns = [t[name] for _, t in tables if name in t]
        if name in width:
            columns = [np.pad(c, ((0, 0), (0, width[name] - c.shape[1])), constant_values=np.nan) for c in columns]
        out[name] = np.concatenate(columns)
    return out


def rows_of(table: Table, rows) -> Table:
    """Select rows of all columns."""
    return {name: values[rows] for name, values in table.items()}
