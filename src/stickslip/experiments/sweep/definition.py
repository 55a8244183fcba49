"""Definition of a sweep: many scenarios from one, where a [sweep] table lists values or distributions for some keys.

A value in the table is a list, or a table with one of the kinds below and `number`. Random values depend only on
`draw_seed` and their own key, so adding another key does not change them.
"""

import hashlib
import json
import math
import re
import zlib
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...core.readable import readable
from ...data.dotted_keys import field_at, with_value
from ...data.law_file import with_checksum
from ...data.schema import LARGEST, ScenarioBase, ScenarioError
from ..registry import read_tables, scenario, scenario_class

MODES = ("grid", "zip", "sample")
OPTIONS = ("mode", "number", "draw_seed")
SPACED, DRAWN = ("linspace", "geomspace"), ("uniform", "loguniform", "integers", "normal")
KINDS = (*SPACED, *DRAWN, "count")
MOST = 1_000_000  # members, since their names and measures are held in memory


class Axis(NamedTuple):
    """A swept key and its values; `values` is empty for a distribution that is still to be sampled."""

    key: str
    values: tuple
    kind: str  # "list", or one of KINDS
    entry: Any  # of the table


@readable
class Sweep(NamedTuple):
    """Many scenarios: `base`, with the values of `axes` substituted.

    In a grid, every axis is a dimension. Otherwise all axes, except a seed given as a count, vary together along one
    dimension, and every point is repeated for all seeds.
    """

    base: dict
    axes: tuple[Axis, ...]
    mode: str
    text: str  # canonical; the order of keys is that of the dimensions

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of members along each dimension."""
        return tuple(len(group[0].values) for group in self.groups)

    @property
    def groups(self) -> tuple[tuple[Axis, ...], ...]:
        """Axes that vary together, for each dimension."""
        if self.mode == "grid":
            return tuple((axis,) for axis in self.axes)
        points = tuple(axis for axis in self.axes if axis.kind != "count")
        return tuple(group for group in (points, *((a,) for a in self.axes if a.kind == "count")) if group)

    @property
    def count(self) -> int:
        """Number of members."""
        return math.prod(self.shape)

    @property
    def digest(self) -> str:
        """Hash of the canonical text."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]


class Member(NamedTuple):
    """A member of a sweep."""

    name: str  # of its folder: the swept values, and a digest of the whole scenario
    values: dict  # {key: value}
    scenario: ScenarioBase


def read_sweep(path: str | Path) -> Sweep:
    """Read a sweep from a TOML file with a [sweep] table, or from the sweep.json of a run."""
    return sweep(**read_tables(path))


def sweep(**tables) -> Sweep:
    """Create a sweep from nested dictionaries, as in the TOML file; only the [sweep] table is validated here.

    Raises
    ------
    ScenarioError
        If the table is invalid; the message names the key, the value given and the values allowed.

    Examples
    --------
    >>> grid = sweep(experiment="rate-state", sweep={"surface.a": [0.01, 0.02], "seed": {"count": 3}})
    >>> grid.count, [one.values for one in members(grid)][1]
    (6, {'surface.a': 0.01, 'seed': 1})
    """
    tables = with_checksum(tables)
    base, table = {k: v for k, v in tables.items() if k != "sweep"}, tables.get("sweep")
    if not isinstance(table, dict):
        raise ScenarioError("a sweep needs a [sweep] table whose keys have lists of values, or distributions")
    kind = scenario_class(base)
    mode, number, seed = _read_options(table)
    entries = _flatten_entries({k: v for k, v in table.items() if k not in OPTIONS})
    if not entries:
        raise ScenarioError('[sweep] contains no keys: give one, such as "law.mu" = [0.2, 0.4]')
    for key in entries:
        field_at(kind, key)
        if key in ("law.file", "law.checksum"):
            raise ScenarioError(f"sweep.{key} was given, but law files cannot be swept: make one sweep for each file")
    axes = tuple(_parse_axis(key, entry, base, mode, number, seed) for key, entry in entries.items())
    if mode == "sample":
        axes = _draw_latin_hypercube(axes, number, seed)
    if mode == "zip":
        _check_same_length(axes)
    found = Sweep(base, axes, mode, json.dumps(tables, indent=1, default=str))
    if found.count > MOST:
        raise ScenarioError(f"[sweep] defines {found.count} members: at most {MOST} are allowed")
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
    return base, list(_flatten_entries({k: v for k, v in table.items() if k not in OPTIONS})), table.get("mode", "grid")


def _flatten(table: dict, above: str = "") -> dict:
    out = {}
    for key, value in table.items():
        out |= _flatten(value, f"{above}{key}.") if isinstance(value, dict) else {above + key: value}
    return out


def _member_name(values: dict, one: ScenarioBase) -> str:
    words = ",".join(f"{key}={f'{v:.6g}' if isinstance(v, float) else v}" for key, v in values.items())
    return f"{re.sub(r'[^A-Za-z0-9.=,+_-]+', '_', words)[:80]}-{one.digest[:10]}"


def _read_options(table: dict) -> tuple[str, int | None, int]:
    mode, number, seed = table.get("mode", "grid"), table.get("number"), table.get("draw_seed", 0)
    if mode not in MODES:
        raise ScenarioError(f"sweep.mode = {mode!r} was given: use {', '.join(map(repr, MODES))}")
    if number is not None:
        _check_integer("sweep.number", number, 1)
    if mode == "sample" and number is None:
        raise ScenarioError('sweep.mode = "sample" needs the number of points: give sweep.number')
    if mode == "grid" and number is not None:
        raise ScenarioError("sweep.number is only for zip and sample: in a grid, give each distribution its own number")
    return mode, number, _check_integer("sweep.draw_seed", seed, 0)


def _flatten_entries(table: dict, above: str = "") -> dict:
    """Flatten tables to dotted keys: [sweep.law] mu = … is the same as "law.mu" = …"""
    out = {}
    for key, value in table.items():
        if isinstance(value, dict) and not _is_distribution(value):
            out |= _flatten_entries(value, f"{above}{key}.")
        else:
            out[above + key] = value
    return out


def _is_distribution(value: dict) -> bool:
    return not value or not all(isinstance(item, list | dict) for item in value.values()) or bool(set(value) & {*KINDS})


def _parse_axis(key: str, entry, base: dict, mode: str, number: int | None, seed: int) -> Axis:
    """Parse the entry of a swept key; the values of a sample are drawn later."""
    if isinstance(entry, list):
        if not entry:
            raise ScenarioError(f"sweep.{key} is an empty list: give at least one value")
        if mode == "grid" and (twice := _find_duplicate(entry)):
            raise ScenarioError(f"sweep.{key} contains {twice} twice: give each value once")
        return Axis(key, tuple(entry), "list", entry)
    if not isinstance(entry, dict):
        raise ScenarioError(f"sweep.{key} = {entry!r} was given: use a list of values, or {{{' | '.join(KINDS)} = …}}")
    kind, many = _values_kind(key, entry), entry.get("number", number)
    if kind == "count":
        if key != "seed":
            raise ScenarioError(
                f"sweep.{key} has count, which is valid only for seed: use a list, linspace or a distribution"
            )
        first = base.get("seed", 0)
        count = _check_integer("sweep.seed.count", entry["count"], 1, MOST)
        return Axis(key, tuple(range(_check_integer("seed", first, 0), first + count)), kind, entry)
    _check_parameters(key, kind, entry[kind])
    if mode == "sample":
        if "number" in entry:
            raise ScenarioError(
                f"sweep.{key}.number was given: a sample has one number for all keys, given by sweep.number"
            )
        return Axis(key, (), kind, entry)
    if many is None:
        raise ScenarioError(f"sweep.{key} has no number of values: give it, as in {{{kind} = …, number = 5}}")
    many = _check_integer(f"sweep.{key}.number", many, 1, MOST)
    if kind in SPACED:
        return Axis(key, _spaced_values(kind, *entry[kind], many), kind, entry)
    draws = np.random.default_rng([seed, zlib.crc32(key.encode())]).random(many)
    return Axis(key, _quantiles(kind, entry[kind], np.sort(draws) if mode == "grid" else draws), kind, entry)


def _find_duplicate(values: list) -> str | None:
    """Return the first value that occurs twice in a list, or None."""
    seen = set()
    for words in map(str, values):
        if words in seen:
            return words
        seen.add(words)
    return None


def _values_kind(key: str, entry: dict) -> str:
    """Return the kind of values that a table in [sweep] defines."""
    kinds, unknown = [k for k in entry if k in KINDS], [k for k in entry if k not in (*KINDS, "number")]
    if unknown:
        hint = "did you mean 'geomspace', which takes the end values themselves?" if unknown[0] == "logspace" else None
        raise ScenarioError(f"sweep.{key} has no key {unknown[0]!r}: {hint or 'it has ' + ', '.join(KINDS)}")
    if len(kinds) != 1:
        raise ScenarioError(f"sweep.{key} has {len(kinds)} kinds of values: give one of {', '.join(KINDS)}")
    return kinds[0]


def _check_parameters(key: str, kind: str, entry) -> None:
    """Check the parameters of a distribution: two ends in order, or mean and sd."""
    if kind == "normal":
        right = isinstance(entry, dict) and set(entry) == {"mean", "sd"} and all(map(_is_number, entry.values()))
        if not (right and entry["sd"] > 0):
            raise ScenarioError(
                f"sweep.{key}.normal = {entry} was given: use {{mean = 0.4, sd = 0.1}} with sd > 0, up to {LARGEST:g}"
            )
        return
    if not (isinstance(entry, list) and len(entry) == 2 and all(map(_is_number, entry))):
        raise ScenarioError(
            f"sweep.{key}.{kind} = {entry} was given: use two numbers up to {LARGEST:g} as the two ends"
        )
    if not entry[0] < entry[1] and kind in DRAWN:
        raise ScenarioError(f"sweep.{key}.{kind} = {entry} was given: the first end must be below the second")
    if kind in ("geomspace", "loguniform") and min(entry) <= 0:
        raise ScenarioError(f"sweep.{key}.{kind} = {entry} was given: both ends must be positive")
    if kind == "integers" and not all(isinstance(value, int) for value in entry):
        raise ScenarioError(f"sweep.{key}.integers = {entry} was given: use two whole numbers, both included")


def _is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def _check_integer(name: str, value, least: int, most: int | None = None) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < least or (most and value > most):
        beyond = f" to {most}" if most else " or more"
        raise ScenarioError(f"{name} = {value!r} was given: use a whole number, {least}{beyond}")
    return value


def _spaced_values(kind: str, first, last, number: int) -> tuple:
    values = getattr(np, kind)(float(first), float(last), number)
    whole = isinstance(first, int) and isinstance(last, int) and (values == np.round(values)).all()
    return tuple((values.astype(int) if whole else values).tolist())


def _quantiles(kind: str, entry, share: np.ndarray) -> tuple:
    """Return the quantiles of a distribution at given probabilities."""
    if kind == "normal":
        from scipy.special import ndtri

        return tuple((entry["mean"] + entry["sd"] * ndtri(np.clip(share, 1e-16, 1 - 1e-16))).tolist())
    low, high = entry
    if kind == "integers":
        return tuple(np.minimum(low + np.floor(share * (high - low + 1)), high).astype(int).tolist())
    if kind in ("loguniform", "geomspace"):
        return tuple(np.exp(math.log(low) + share * math.log(high / low)).tolist())
    return tuple((low + share * (high - low)).tolist())


def _draw_latin_hypercube(axes: tuple[Axis, ...], number: int, seed: int) -> tuple[Axis, ...]:
    """Draw a Latin hypercube sample: each axis has `number` intervals of equal probability, with one value in each.

    McKay, Beckman and Conover 1979, doi:10.1080/00401706.1979.10489755.
    """
    out = []
    for axis in axes:
        if axis.kind == "count":
            out.append(axis)
            continue
        rng = np.random.default_rng([seed, zlib.crc32(axis.key.encode())])
        share = (rng.permutation(number) + rng.random(number)) / number
        if axis.kind == "list":
            values = tuple(axis.entry[int(s * len(axis.entry))] for s in share)
        else:
            values = _quantiles(axis.kind, axis.entry[axis.kind], share)
        out.append(axis._replace(values=values))
    return tuple(out)


def _check_same_length(axes: tuple[Axis, ...]) -> None:
    side = [axis for axis in axes if axis.kind != "count"]
    for axis in side[1:]:
        if len(axis.values) != len(side[0].values):
            raise ScenarioError(
                f"sweep.{side[0].key} has {len(side[0].values)} values and sweep.{axis.key} {len(axis.values)}: in "
                "zip mode, all keys need the same number of values"
            )
