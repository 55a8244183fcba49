"""Tables of draws whose rows become the points of a sweep, such as the posterior of a fit."""

from pathlib import Path

import numpy as np

from ...core.tables import read_table, split_label
from ...core.text import parse_number
from ...data.dotted_keys import field_at
from ...data.schema import LARGEST, ScenarioError, split_unit
from .axes import Values

MOST_ROWS = 100_000  # the values are part of the text of the sweep
PLAIN = ("", "-", "1")  # units of numbers


def read_draws(draws, entries: dict, kind) -> dict[str, list[float]]:
    """Return the columns of a table of draws that a sweep uses, {name: values}.

    Parameters
    ----------
    draws : path of a CSV file with headers such as `dc [m]`, or {name: values}
    entries : those of all swept keys
    kind : class of the scenario; the unit in a header must be that of the key, unless the entry has a factor `times`
    """
    columns = {key: entry for key, entry in entries.items() if isinstance(entry, Values) and entry.column is not None}
    if draws is None:
        if columns:
            raise ScenarioError(f"sweep.{next(iter(columns))} names a column: give the file with sweep.draws")
        return {}
    if not columns:
        raise ScenarioError('sweep.draws was given, but no key uses it: give one, as "surface.a" = {column = "a"}')
    of_file = isinstance(draws, str | Path)
    table, out = _read_file(Path(draws)) if of_file else _check_table(draws), {}
    for key, entry in columns.items():
        name = entry.column
        if name not in table:
            raise ScenarioError(f"sweep.{key}: sweep.draws has no column {name!r}: its columns are {', '.join(table)}")
        unit, out[name] = table[name]
        if of_file and entry.times is None:
            _check_unit(key, name, unit, field_at(kind, key).description)
    lengths = {name: len(values) for name, values in out.items()}
    if len(set(lengths.values())) > 1:
        raise ScenarioError(f"the columns of sweep.draws have different lengths: {lengths}")
    return out


def _read_file(path: Path) -> dict[str, tuple[str, list[float]]]:
    try:
        (_, header), *rows = read_table(path)
    except OSError as problem:
        raise ScenarioError(f"sweep.draws = {path} cannot be read ({problem.strerror}): give a CSV file") from None
    except ValueError as problem:
        raise ScenarioError(f"sweep.draws: {problem}") from None
    if not 1 <= len(rows) <= MOST_ROWS:
        raise ScenarioError(f"sweep.draws = {path} has {len(rows)} rows: give 1 to {MOST_ROWS}")
    names = [(name, unit or "") for name, unit in map(split_label, header)]
    if len({name for name, _ in names}) < len(names):
        raise ScenarioError(f"sweep.draws = {path} has two columns of the same name: keep one")
    return {name: (unit, [_parse(path, row, k, name) for row in rows]) for k, (name, unit) in enumerate(names)}


def _parse(path: Path, row: tuple[int, list[str]], k: int, name: str) -> float:
    number, fields = row
    try:
        value = parse_number(fields[k])
    except ValueError:
        value = np.nan
    if not abs(value) <= LARGEST:
        raise ScenarioError(
            f"sweep.draws = {path}, line {number}: {name} is {fields[k][:40]!r}, not a finite number: remove the line"
        )
    return value


def _check_table(draws) -> dict[str, tuple[str, list[float]]]:
    out = {}
    for name, values in draws.items() if isinstance(draws, dict) else ():
        try:
            column = np.asarray(values, float)
        except (TypeError, ValueError):
            column = np.array([np.nan])
        if column.ndim != 1 or not 1 <= len(column) <= MOST_ROWS or not (np.abs(column) <= LARGEST).all():
            raise ScenarioError(f"sweep.draws.{name} is not a list of 1 to {MOST_ROWS} finite numbers")
        out[name] = ("", column.tolist())
    if not out:
        raise ScenarioError("sweep.draws must be the path of a CSV file, or a table of columns")
    return out


def _check_unit(key: str, name: str, unit: str, description: str | None) -> None:
    wanted = split_unit(description)[1]
    if unit != wanted and not (unit in PLAIN and wanted in PLAIN):
        raise ScenarioError(
            f"sweep.{key}: column {name!r} is in [{unit or '-'}] and the key in [{wanted or '-'}]: give the factor "
            f'between them, as in {{column = "{name}", times = 1e-6}}'
        )
