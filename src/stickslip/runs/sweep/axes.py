"""Swept keys: the entries of a [sweep] table, each a list of values or a table that describes them."""

from typing import Any, NamedTuple

import numpy as np

from ...core.sizes import MOST
from ...data.schema import LARGEST, ScenarioError
from .points import generator, quantiles

SPACED, DRAWN = ("linspace", "geomspace"), ("uniform", "loguniform", "integers", "normal")
KINDS = (*SPACED, *DRAWN, "column", "count")


class Axis(NamedTuple):
    """A swept key and its values; `values` is empty if they are still to be sampled."""

    key: str
    values: tuple
    kind: str  # "list", or one of KINDS
    entry: Any  # of the table


def flatten_entries(table: dict, above: str = "") -> dict:
    """Flatten tables to dotted keys: [sweep.law] mu = … is the same as "law.mu" = …"""
    out = {}
    for key, value in table.items():
        if isinstance(value, dict) and not _is_distribution(value):
            out |= flatten_entries(value, f"{above}{key}.")
        else:
            out[above + key] = value
    return out


def _is_distribution(value: dict) -> bool:
    return not value or not all(isinstance(item, list | dict) for item in value.values()) or bool(set(value) & {*KINDS})


def parse_axis(key: str, entry, base: dict, table: dict) -> Axis:
    """Parse the entry of a swept key; the values of a sample are drawn later."""
    mode, number, seed = table.get("mode", "grid"), table.get("number"), table.get("draw_seed", 0)
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
        count = check_integer("sweep.seed.count", entry["count"], 1, MOST)
        return Axis(key, tuple(range(check_integer("seed", first, 0), first + count)), kind, entry)
    _check_parameters(key, kind, entry[kind])
    if mode == "sample":
        if "number" in entry:
            raise ScenarioError(
                f"sweep.{key}.number was given: a sample has one number for all keys, given by sweep.number"
            )
        return Axis(key, (), kind, entry)
    if kind == "column":
        return Axis(key, column_values(entry, table["draws"]), kind, entry)
    if many is None:
        raise ScenarioError(f"sweep.{key} has no number of values: give it, as in {{{kind} = …, number = 5}}")
    many = check_integer(f"sweep.{key}.number", many, 1, MOST)
    if kind in SPACED:
        return Axis(key, _spaced_values(kind, *entry[kind], many), kind, entry)
    draws = generator(seed, key).random(many)
    return Axis(key, quantiles(kind, entry[kind], np.sort(draws) if mode == "grid" else draws), kind, entry)


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
    kinds, unknown = [k for k in entry if k in KINDS], [k for k in entry if k not in (*KINDS, "number", "times")]
    if unknown:
        hint = "did you mean 'geomspace', which takes the end values themselves?" if unknown[0] == "logspace" else None
        raise ScenarioError(f"sweep.{key} has no key {unknown[0]!r}: {hint or 'it has ' + ', '.join(KINDS)}")
    if len(kinds) != 1:
        raise ScenarioError(f"sweep.{key} has {len(kinds)} kinds of values: give one of {', '.join(KINDS)}")
    if "times" in entry and kinds[0] != "column":
        raise ScenarioError(f"sweep.{key}.times was given with {kinds[0]}: it is a factor for the values of a column")
    if "times" in entry and not (_is_number(entry["times"]) and entry["times"] != 0):
        raise ScenarioError(f"sweep.{key}.times = {entry['times']!r} was given: use a number other than 0")
    return kinds[0]


def _check_parameters(key: str, kind: str, entry) -> None:
    """Check the parameters of a distribution: two ends in order, or mean and sd."""
    if kind == "column":
        return  # checked with the table of draws
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


def check_integer(name: str, value, least: int, most: int | None = None) -> int:
    """Return a whole number of a [sweep] table, or raise ScenarioError."""
    if not isinstance(value, int) or isinstance(value, bool) or value < least or (most and value > most):
        beyond = f" to {most}" if most else " or more"
        raise ScenarioError(f"{name} = {value!r} was given: use a whole number, {least}{beyond}")
    return value


def _spaced_values(kind: str, first, last, number: int) -> tuple:
    values = getattr(np, kind)(float(first), float(last), number)
    whole = isinstance(first, int) and isinstance(last, int) and (values == np.round(values)).all()
    return tuple((values.astype(int) if whole else values).tolist())


def column_values(entry: dict, draws: dict) -> tuple:
    """Return the values of a key that takes them from a column of `draws`."""
    return tuple(entry.get("times", 1.0) * value for value in draws[entry["column"]])
