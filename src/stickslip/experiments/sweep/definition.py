"""A sweep: many scenarios from one, by a table [sweep] of keys with lists of values or distributions.

A value of the table is a list, or a table with one of the kinds below and `number`. Draws depend on `draw_seed` and on
their own key alone, so that another key in the table does not change them.
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
from ...data.dotted_keys import field_at, put
from ...data.law_file import sealed
from ...data.schema import LARGEST, ScenarioError, Whole
from ..registry import scenario, scenario_class, tables_of

MODES = ("grid", "zip", "sample")
OPTIONS = ("mode", "number", "draw_seed")
SPACED, DRAWN = ("linspace", "geomspace"), ("uniform", "loguniform", "integers", "normal")
KINDS = (*SPACED, *DRAWN, "count")
MOST = 1_000_000  # members: their names and numbers are held in memory


class Axis(NamedTuple):
    """One key that is swept, with its values; in a sample without values there is what they are drawn from."""

    key: str
    values: tuple
    kind: str  # "list", or one of KINDS
    told: Any  # the entry of the table


@readable
class Sweep(NamedTuple):
    """Many scenarios: `base` with the values of `axes` in their places.

    In a grid every axis is a dimension. Otherwise all axes but a counted seed go side by side along one dimension, and
    every point is repeated with all seeds.
    """

    base: dict
    axes: tuple[Axis, ...]
    mode: str
    text: str  # canonical; the order of keys is that of the dimensions

    @property
    def shape(self) -> tuple[int, ...]:
        """Members along every dimension."""
        return tuple(len(group[0].values) for group in self.groups)

    @property
    def groups(self) -> tuple[tuple[Axis, ...], ...]:
        """Axes that vary together, for every dimension."""
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

    name: str  # of its folder: what is swept, and a digest of the whole scenario
    values: dict  # {key: value}
    scenario: Whole


def read_sweep(path: str | Path) -> Sweep:
    """A sweep from a TOML file with a table [sweep], or from the sweep.json that a run left behind."""
    return sweep(**tables_of(path))


def sweep(**tables) -> Sweep:
    """A sweep from nested dictionaries, as in the TOML file; nothing but the table [sweep] is judged here.

    Raises
    ------
    ScenarioError
        with one sentence that names the key, what was got and what is allowed.

    Examples
    --------
    >>> both = sweep(experiment="rate-state", sweep={"surface.a": [0.01, 0.02], "seed": {"count": 3}})
    >>> both.count, [one.values for one in members(both)][1]
    (6, {'surface.a': 0.01, 'seed': 1})
    """
    tables = sealed(tables)
    base, table = {k: v for k, v in tables.items() if k != "sweep"}, tables.get("sweep")
    if not isinstance(table, dict):
        raise ScenarioError("a sweep needs a table [sweep] of keys with lists of values or distributions")
    kind = scenario_class(base)
    mode, number, seed = _read_options(table)
    entries = _flatten_entries({k: v for k, v in table.items() if k not in OPTIONS})
    if not entries:
        raise ScenarioError('[sweep] holds no key: give one, such as "law.mu" = [0.2, 0.4]')
    for key in entries:
        field_at(kind, key)
        if key in ("law.file", "law.checksum"):
            raise ScenarioError(f"sweep.{key} was given: a law's file cannot be swept, make a sweep for each")
    axes = tuple(_parse_axis(key, told, base, mode, number, seed) for key, told in entries.items())
    if mode == "sample":
        axes = _draw_latin_hypercube(axes, number, seed)
    if mode == "zip":
        _check_same_length(axes)
    found = Sweep(base, axes, mode, json.dumps(tables, indent=1, default=str))
    if found.count > MOST:
        raise ScenarioError(f"[sweep] makes {found.count} members: at most {MOST} are allowed")
    return found


def members(chosen: Sweep) -> Iterator[Member]:
    """All members, the last dimension fastest; each is judged when its turn comes, as in `member`."""
    return (member(chosen, k) for k in range(chosen.count))


def member(chosen: Sweep, k: int) -> Member:
    """The member at a place, counted from 0, the last dimension fastest.

    Raises
    ------
    ScenarioError
        with one sentence that names the member, and the key with what is wrong.
    """
    places = zip(np.unravel_index(k, chosen.shape), chosen.groups, strict=True)
    values = {axis.key: axis.values[place] for place, group in places for axis in group}
    try:
        one = scenario(**reduce(lambda tables, item: put(tables, *item), values.items(), chosen.base))
    except ScenarioError as problem:
        raise ScenarioError(f"member {', '.join(f'{k} = {v}' for k, v in values.items())}: {problem}") from None
    return Member(_member_name(values, one), values, one)


def describe_differences(old: dict, new: dict) -> str:
    """What makes the tables of two sweeps different studies, in words; nothing if only values of their keys differ."""
    (base, keys, mode), (its_base, its_keys, its_mode) = map(_split_tables, (old, new))
    words = []
    if set(keys) != set(its_keys):
        words.append(f"that one sweeps {', '.join(keys)}, this one {', '.join(its_keys)}")
    if mode != its_mode:
        words.append(f"its mode is {mode}, not {its_mode}")
    changed = [key for key in dict.fromkeys((*base, *its_base)) if base.get(key) != its_base.get(key)]
    for key in changed[:3]:
        there, here = (json.dumps(one[key])[:60] if key in one else "left out" for one in (base, its_base))
        words.append(f"{key} is {there} there and {here} here")
    if len(changed) > 3:
        words.append(f"{len(changed) - 3} more keys differ")
    return ", ".join(words)


def _split_tables(tables: dict) -> tuple[dict, list[str], str]:
    """Dotted keys of the base with their values, keys that are swept, mode."""
    table = tables.get("sweep", {})
    base = {"experiment": "disk-array"} | _flatten({k: v for k, v in tables.items() if k != "sweep"})
    return base, list(_flatten_entries({k: v for k, v in table.items() if k not in OPTIONS})), table.get("mode", "grid")


def _flatten(table: dict, above: str = "") -> dict:
    out = {}
    for key, value in table.items():
        out |= _flatten(value, f"{above}{key}.") if isinstance(value, dict) else {above + key: value}
    return out


def _member_name(values: dict, one: Whole) -> str:
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
        raise ScenarioError("sweep.number belongs to zip and sample: give a grid's distributions their own number")
    return mode, number, _check_integer("sweep.draw_seed", seed, 0)


def _flatten_entries(table: dict, above: str = "") -> dict:
    """Dotted keys: [sweep.law] mu = … and "law.mu" = … are the same."""
    out = {}
    for key, value in table.items():
        if isinstance(value, dict) and not _is_distribution(value):
            out |= _flatten_entries(value, f"{above}{key}.")
        else:
            out[above + key] = value
    return out


def _is_distribution(value: dict) -> bool:
    return not value or not all(isinstance(item, list | dict) for item in value.values()) or bool(set(value) & {*KINDS})


def _parse_axis(key: str, told, base: dict, mode: str, number: int | None, seed: int) -> Axis:
    """What is swept at a key, with its values; those of a sample come later."""
    if isinstance(told, list):
        if not told:
            raise ScenarioError(f"sweep.{key} is an empty list: give at least one value")
        if mode == "grid" and (twice := _find_duplicate(told)):
            raise ScenarioError(f"sweep.{key} holds {twice} twice: give every value once")
        return Axis(key, tuple(told), "list", told)
    if not isinstance(told, dict):
        raise ScenarioError(f"sweep.{key} = {told!r} was given: use a list of values, or {{{' | '.join(KINDS)} = …}}")
    kind, many = _values_kind(key, told), told.get("number", number)
    if kind == "count":
        if key != "seed":
            raise ScenarioError(f"sweep.{key} has count, which is for seed: use a list, linspace or a distribution")
        first = base.get("seed", 0)
        count = _check_integer("sweep.seed.count", told["count"], 1, MOST)
        return Axis(key, tuple(range(_check_integer("seed", first, 0), first + count)), kind, told)
    _check_parameters(key, kind, told[kind])
    if mode == "sample":
        if "number" in told:
            raise ScenarioError(f"sweep.{key}.number was given, but a sample has one for all keys: give sweep.number")
        return Axis(key, (), kind, told)
    if many is None:
        raise ScenarioError(f"sweep.{key} has no number of values: give one, as in {{{kind} = …, number = 5}}")
    many = _check_integer(f"sweep.{key}.number", many, 1, MOST)
    if kind in SPACED:
        return Axis(key, _spaced_values(kind, *told[kind], many), kind, told)
    draws = np.random.default_rng([seed, zlib.crc32(key.encode())]).random(many)
    return Axis(key, _quantiles(kind, told[kind], np.sort(draws) if mode == "grid" else draws), kind, told)


def _find_duplicate(told: list) -> str | None:
    """The first value of a list that stands there twice."""
    seen = set()
    for words in map(str, told):
        if words in seen:
            return words
        seen.add(words)
    return None


def _values_kind(key: str, told: dict) -> str:
    """Which kind of values a table in [sweep] means."""
    kinds, unknown = [k for k in told if k in KINDS], [k for k in told if k not in (*KINDS, "number")]
    if unknown:
        hint = "did you mean 'geomspace', whose ends are values?" if unknown[0] == "logspace" else None
        raise ScenarioError(f"sweep.{key} has no key {unknown[0]!r}: {hint or 'it has ' + ', '.join(KINDS)}")
    if len(kinds) != 1:
        raise ScenarioError(f"sweep.{key} has {len(kinds)} kinds of values: give one of {', '.join(KINDS)}")
    return kinds[0]


def _check_parameters(key: str, kind: str, told) -> None:
    """Two ends in order, or mean and sd."""
    if kind == "normal":
        right = isinstance(told, dict) and set(told) == {"mean", "sd"} and all(map(_is_number, told.values()))
        if not (right and told["sd"] > 0):
            raise ScenarioError(
                f"sweep.{key}.normal = {told} was given: use {{mean = 0.4, sd = 0.1}} with sd > 0, up to {LARGEST:g}"
            )
        return
    if not (isinstance(told, list) and len(told) == 2 and all(map(_is_number, told))):
        raise ScenarioError(f"sweep.{key}.{kind} = {told} was given: use two numbers up to {LARGEST:g}, the ends")
    if not told[0] < told[1] and kind in DRAWN:
        raise ScenarioError(f"sweep.{key}.{kind} = {told} was given: the first end must be below the second")
    if kind in ("geomspace", "loguniform") and min(told) <= 0:
        raise ScenarioError(f"sweep.{key}.{kind} = {told} was given: both ends must be positive")
    if kind == "integers" and not all(isinstance(value, int) for value in told):
        raise ScenarioError(f"sweep.{key}.integers = {told} was given: use two whole numbers, both may be drawn")


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


def _quantiles(kind: str, told, share: np.ndarray) -> tuple:
    """Values below which a share of the distribution lies."""
    if kind == "normal":
        from scipy.special import ndtri

        return tuple((told["mean"] + told["sd"] * ndtri(np.clip(share, 1e-16, 1 - 1e-16))).tolist())
    low, high = told
    if kind == "integers":
        return tuple(np.minimum(low + np.floor(share * (high - low + 1)), high).astype(int).tolist())
    if kind in ("loguniform", "geomspace"):
        return tuple(np.exp(math.log(low) + share * math.log(high / low)).tolist())
    return tuple((low + share * (high - low)).tolist())


def _draw_latin_hypercube(axes: tuple[Axis, ...], number: int, seed: int) -> tuple[Axis, ...]:
    """A Latin hypercube: every axis is cut into `number` parts of equal probability, each of which gives one value.

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
            values = tuple(axis.told[int(s * len(axis.told))] for s in share)
        else:
            values = _quantiles(axis.kind, axis.told[axis.kind], share)
        out.append(axis._replace(values=values))
    return tuple(out)


def _check_same_length(axes: tuple[Axis, ...]) -> None:
    side = [axis for axis in axes if axis.kind != "count"]
    for axis in side[1:]:
        if len(axis.values) != len(side[0].values):
            raise ScenarioError(
                f"sweep.{side[0].key} has {len(side[0].values)} values and sweep.{axis.key} {len(axis.values)}: in the "
                "mode zip all have the same number"
            )
