"""Definition of a sweep: many scenarios from one, where a [sweep] table lists values or distributions for some keys.

A value in the table is a list, or a table with one of the kinds below and `number`. Random values depend only on
`draw_seed` and their own key, so adding another key does not change them. Points that do not satisfy the conditions
`where` are refused and counted.
"""

import hashlib
import json
import math
import re
from collections.abc import Iterator
from functools import reduce
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.arguments import checked
from ...core.readable import format_value, pluralize, readable
from ...core.sizes import MOST, Size, require_sizes
from ...data.dotted_keys import field_at, with_value
from ...data.law_file import trust_law_files, with_checksums
from ...data.schema import ScenarioBase, ScenarioError, split_unit
from ...experiments.registry import read_tables, scenario, scenario_class
from .axes import Axis, check_integer, column_values, flatten_entries, parse_axis
from .condition import find_broken, parse_conditions
from .draws import read_draws
from .points import DRAWS, check_effort, describe_refusals, latin_hypercubes, quantiles, sobol_points

MODES = ("grid", "zip", "sample")
FEWER = "use fewer values"
OPTIONS = ("mode", "number", "draw", "draw_seed", "where", "draws")


@readable(head=lambda chosen: _describe(chosen), rows=lambda chosen: _rows(chosen))
class Sweep(NamedTuple):
    """Many scenarios: `base`, with the values of `axes` substituted.

    In a grid, every axis is a dimension, and the columns of a table of draws share one. Otherwise all axes, except a
    seed given as a count, vary together along one dimension, and every point is repeated for all seeds.
    """

    base: dict
    axes: tuple[Axis, ...]
    mode: str  # "zip" for a grid with conditions, whose accepted points are a list
    text: str  # canonical; the order of keys is that of the dimensions
    tried: int = 0  # points that conditions were applied to
    refused: tuple[tuple[str, int], ...] = ()  # conditions and the number of points that each refused

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of members along each dimension."""
        return tuple(len(group[0].values) for group in self.groups)

    @property
    def groups(self) -> tuple[tuple[Axis, ...], ...]:
        """Axes that vary together, for each dimension."""
        if self.mode == "grid":
            columns = tuple(axis for axis in self.axes if axis.kind == "column")
            return tuple(filter(None, (columns, *((axis,) for axis in self.axes if axis.kind != "column"))))
        points = tuple(axis for axis in self.axes if axis.kind != "count")
        return tuple(group for group in (points, *((a,) for a in self.axes if a.kind == "count")) if group)

    @property
    def count(self) -> int:
        """Number of members."""
        return math.prod(self.shape)

    @property
    def refusals(self) -> str:
        """One sentence on the points that were refused; empty if there are none."""
        count = sum(many for _, many in self.refused)
        words = f"{count} of {self.tried} points were refused: {describe_refusals(dict(self.refused))}."
        return words if count else ""

    @property
    def digest(self) -> str:
        """Hash of the canonical text."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]


def _describe(chosen: Sweep) -> str:
    swept = ", ".join(f"{axis.key} = {format_value(axis.values)}" for axis in chosen.axes)
    refused = f"; {chosen.refusals}" if chosen.refusals else ""
    return f"{pluralize(chosen.count, 'member')} of {_experiment(chosen)}, {swept}{refused}"


def _rows(chosen: Sweep):
    kind = scenario_class(chosen.base)
    yield "experiment", _experiment(chosen)
    for axis in chosen.axes:
        yield axis.key, axis.values, *reversed(split_unit(field_at(kind, axis.key).description))
    yield "members", chosen.count, "", " × ".join(map(str, chosen.shape)) if len(chosen.shape) > 1 else ""
    yield "refused points", chosen.refusals or None


def _experiment(chosen: Sweep) -> str:
    return scenario_class(chosen.base).model_fields["experiment"].default


class Member(NamedTuple):
    """A member of a sweep."""

    name: str  # of its folder: the swept values, and a digest of the whole scenario
    values: dict  # {key: value}
    scenario: ScenarioBase


@checked
def read_sweep(path: str | Path, *, trust: bool = False) -> Sweep:
    """Read a sweep from a TOML file with a [sweep] table, or from the sweep.json of a run; `trust` as in `scenario`."""
    return sweep(trust=trust, **read_tables(path))


@checked
def sweep(*, trust: bool = False, **tables) -> Sweep:
    """Create a sweep from nested dictionaries, as in the TOML file; only the [sweep] table is validated here.

    Parameters
    ----------
    trust : True if runs may execute the present text of the Python file `law.file`

    Raises
    ------
    ScenarioError
        If the table is invalid; the message names the key, the value given and the values allowed.

    Examples
    --------
    >>> grid = sweep(
    ...     experiment="rate-state",
    ...     sweep={"surface.a": [0.01, 0.02], "seed": {"count": 3}},
    ... )
    >>> grid.count, [one.values for one in members(grid)][1]
    (6, {'surface.a': 0.01, 'seed': 1})
    """
    if trust:
        trust_law_files(tables)
    tables = with_checksums(tables)
    base, table = {k: v for k, v in tables.items() if k != "sweep"}, tables.get("sweep")
    if not isinstance(table, dict):
        raise ScenarioError("a sweep needs a [sweep] table whose keys have lists of values, or distributions")
    kind = scenario_class(base)
    mode = _check_options(table)
    entries = flatten_entries({k: v for k, v in table.items() if k not in OPTIONS})
    if not entries:
        raise ScenarioError('[sweep] contains no keys: give one, such as "law.mu" = [0.2, 0.4]')
    for key in entries:
        field_at(kind, key)
        if key in ("law.file", "law.checksum"):
            raise ScenarioError(f"sweep.{key} was given, but law files cannot be swept: make one sweep for each file")
    table = _embed_draws(table, entries, kind)
    tables = tables | {"sweep": table}
    axes = tuple(parse_axis(key, entry, base, table) for key, entry in entries.items())
    if mode == "zip":
        _check_same_length(axes)
    found = _select_points(Sweep(base, axes, mode, json.dumps(tables, indent=1, default=str)), table)
    require_sizes([Size("[sweep] defines", found.count, "members", FEWER)], ScenarioError)
    return found


def members(chosen: Sweep) -> Iterator[Member]:
    """Iterate over all members, with the last dimension varying fastest.

    Each is validated when it is reached, as in `member`.
    """
    return (member(chosen, k) for k in range(chosen.count))


def member(chosen: Sweep, k: int) -> Member:
    """Return member `k`, counted from 0 with the last dimension varying fastest.

    Raises
    ------
    ScenarioError
        If the scenario is invalid; the message names the member, the key and the problem.
    """
    places = zip(np.unravel_index(k, chosen.shape), chosen.groups, strict=True)
    values = {axis.key: axis.values[place] for place, group in places for axis in group}
    try:
        one = scenario(**reduce(lambda tables, item: with_value(tables, *item), values.items(), chosen.base))
    except ScenarioError as problem:
        raise ScenarioError(f"member {', '.join(f'{k} = {v}' for k, v in values.items())}: {problem}") from None
    return Member(_member_name(values, one), values, one)


def describe_differences(old: dict, new: dict) -> str:
    """Describe how the tables of two sweeps differ; the result is empty if only the values of swept keys differ."""
    (base, keys, mode), (its_base, its_keys, its_mode) = map(_split_tables, (old, new))
    words = []
    if set(keys) != set(its_keys):
        words.append(f"the old sweep has keys {', '.join(keys)}, the new one {', '.join(its_keys)}")
    if mode != its_mode:
        words.append(f"the mode was {mode} and is now {its_mode}")
    changed = [key for key in dict.fromkeys((*base, *its_base)) if base.get(key) != its_base.get(key)]
    for key in changed[:3]:
        there, here = (json.dumps(one[key])[:60] if key in one else "not given" for one in (base, its_base))
        words.append(f"{key} was {there} and is now {here}")
    if len(changed) > 3:
        words.append(f"{len(changed) - 3} more keys differ")
    return ", ".join(words)


def _split_tables(tables: dict) -> tuple[dict, list[str], str]:
    """Return the dotted keys of the base with their values, the swept keys, and the mode."""
    table = tables.get("sweep", {})
    base = {"experiment": "disk-array"} | _flatten({k: v for k, v in tables.items() if k != "sweep"})
    return base, list(flatten_entries({k: v for k, v in table.items() if k not in OPTIONS})), table.get("mode", "grid")


def _flatten(table: dict, above: str = "") -> dict:
    out = {}
    for key, value in table.items():
        out |= _flatten(value, f"{above}{key}.") if isinstance(value, dict) else {above + key: value}
    return out


def _member_name(values: dict, one: ScenarioBase) -> str:
    words = ",".join(f"{key}={f'{v:.6g}' if isinstance(v, float) else v}" for key, v in values.items())
    return f"{re.sub(r'[^A-Za-z0-9.=,+_-]+', '_', words)[:80]}-{one.digest[:10]}"


def _check_options(table: dict) -> str:
    """Check the options of a [sweep] table and return its mode."""
    mode, number, draw = table.get("mode", "grid"), table.get("number"), table.get("draw")
    if mode not in MODES:
        raise ScenarioError(f"sweep.mode = {mode!r} was given: use {', '.join(map(repr, MODES))}")
    if number is not None:
        check_integer("sweep.number", number, 1, MOST)
    if mode == "sample" and number is None:
        raise ScenarioError('sweep.mode = "sample" needs the number of points: give sweep.number')
    if mode == "grid" and number is not None:
        raise ScenarioError("sweep.number is only for zip and sample: in a grid, give each distribution its own number")
    if draw is not None and draw not in DRAWS:
        raise ScenarioError(f"sweep.draw = {draw!r} was given: use {', '.join(map(repr, DRAWS))}")
    if draw is not None and mode != "sample":
        raise ScenarioError('sweep.draw was given, but only points of a sample are drawn: set sweep.mode = "sample"')
    check_integer("sweep.draw_seed", table.get("draw_seed", 0), 0)
    return mode


def _embed_draws(table: dict, entries: dict, kind) -> dict:
    """Return the table with the columns of `draws` that are used, instead of the name of their file."""
    users = {k: v for k, v in entries.items() if isinstance(v, dict) and "column" in v}
    if "draws" not in table:
        if users:
            raise ScenarioError(f"sweep.{next(iter(users))} names a column: give the file with sweep.draws")
        return table
    return table | {"draws": read_draws(table["draws"], users, kind)}


def _select_points(found: Sweep, table: dict) -> Sweep:
    """Draw the points of a sample, and leave out the points that do not satisfy the conditions."""
    free = [axis for axis in found.axes if axis.kind != "count"]
    conditions = parse_conditions(table["where"], [axis.key for axis in free]) if "where" in table else ()
    if found.mode == "sample" and free:
        return _draw_sample(found, free, table, conditions)
    if not conditions:
        return found
    many = math.prod(n for group, n in zip(found.groups, found.shape, strict=True) if group[0].kind != "count")
    require_sizes([Size("[sweep] defines", many, "points", FEWER)], ScenarioError)
    groups = [group for group in found.groups if group[0].kind != "count"]
    rows = product(*(zip(*(axis.values for axis in group), strict=True) for group in groups))
    keys = [axis.key for group in groups for axis in group]
    points = [dict(zip(keys, sum(row, ()), strict=True)) for row in rows]
    broken = [find_broken(point, conditions) for point in points]
    counts = {one.text: broken.count(one.text) for one in conditions}
    kept = [point for point, words in zip(points, broken, strict=True) if words is None]
    if not kept:
        raise ScenarioError(f"sweep.where refuses all {many} points: {describe_refusals(counts)}")
    return _with_points(found, kept)._replace(mode="zip", tried=many, refused=tuple(counts.items()))


def _with_points(found: Sweep, points: list[dict]) -> Sweep:
    axes = (
        axis if axis.kind == "count" else axis._replace(values=tuple(p[axis.key] for p in points))
        for axis in found.axes
    )
    return found._replace(axes=tuple(axes))


def _draw_sample(found: Sweep, free: list[Axis], table: dict, conditions) -> Sweep:
    """Draw points until enough satisfy the conditions."""
    number, points, tried = table["number"], [], 0
    refused = dict.fromkeys((one.text for one in conditions), 0)
    keys, names = [axis.key for axis in free], list(dict.fromkeys(_coordinate(axis) for axis in free))
    batches = sobol_points if table.get("draw") == "sobol" else latin_hypercubes
    for share in batches(names, number, table.get("draw_seed", 0)):
        columns = [_sample_values(axis, share[_coordinate(axis)], table.get("draws")) for axis in free]
        for row in zip(*columns, strict=True):
            point, tried = dict(zip(keys, row, strict=True)), tried + 1
            broken = find_broken(point, conditions)
            if broken is not None:
                refused[broken] += 1
                continue
            points.append(point)
            if len(points) == number:
                counts = tuple(refused.items())
                return _with_points(found, points)._replace(tried=tried if conditions else 0, refused=counts)
        check_effort(len(points), tried, refused)
    raise AssertionError("batches do not end")


def _coordinate(axis: Axis) -> str:
    """Name of the random coordinate of an axis; the columns of a table of draws share one, which chooses the row."""
    return "draws" if axis.kind == "column" else axis.key


def _sample_values(axis: Axis, share: np.ndarray, draws: dict | None) -> tuple:
    if axis.kind in ("list", "column"):
        values = axis.entry if axis.kind == "list" else column_values(axis.entry, draws)
        return tuple(values[int(s * len(values))] for s in share)
    return quantiles(axis.kind, axis.entry[axis.kind], share)


def _check_same_length(axes: tuple[Axis, ...]) -> None:
    side = [axis for axis in axes if axis.kind != "count"]
    for axis in side[1:]:
        if len(axis.values) != len(side[0].values):
            raise ScenarioError(
                f"sweep.{side[0].key} has {len(side[0].values)} values and sweep.{axis.key} {len(axis.values)}: in "
                "zip mode, all keys need the same number of values"
            )
