"""Definition of a sweep: many scenarios from one, where a [sweep] table lists values or distributions for some keys.

A value in the table is a list, or a table with one of `axes.KINDS` and `number`. Random values depend only on
`draw_seed` and their own key, so adding another key does not change them. Points that do not satisfy the conditions
`where` are rejected and counted. Conditions may contain names of swept keys, numbers, comparisons, arithmetic, `and`,
`or` and `not`; everything else is rejected before Python evaluates anything.
"""

import ast
import hashlib
import json
import math
import re
import warnings
from collections.abc import Callable, Iterator
from functools import reduce
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.arguments import checked
from ...core.progress import Size, require_sizes
from ...core.readable import format_value, pluralize, readable
from ...core.text import shortened
from ...data.law_schema import trust_law_files, with_checksums
from ...data.schema import LARGEST, ScenarioBase, ScenarioError, field_at, validate_table, with_value
from ...experiments.registry import DEFAULT, read_tables, scenario, scenario_class
from .axes import (
    BATCHES,
    OPTIONS,
    Axis,
    Options,
    check_effort,
    describe_refusals,
    flatten,
    make_axis,
    parse_entry,
    quantiles,
    read_draws,
    swept_entries,
)

FEWER = "use fewer values"


@readable(head=lambda chosen: _describe(chosen), rows=lambda chosen: _rows(chosen))
class Sweep(NamedTuple):
    """Many scenarios: `base`, with the values of `axes` substituted.

    In a grid, every axis is a dimension, and the columns of a draws table share a dimension. Otherwise all axes, except
    a seed given as a count, vary together along one dimension, and every point is repeated for all seeds.
    """

    MADE_BY = "sweep or io.read_sweep"

    base: dict
    axes: tuple[Axis, ...]
    mode: str  # "zip" for a grid with conditions, whose accepted points form a list
    text: str  # canonical text, in which the order of keys is that of the dimensions
    tried: int = 0  # number of points tested by conditions
    refused: tuple[tuple[str, int], ...] = ()  # conditions and the number of points rejected by each

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of members along each dimension."""
        return tuple(len(group[0].values) for group in self.groups)

    @property
    def groups(self) -> tuple[tuple[Axis, ...], ...]:
        """Axes that vary together, for each dimension."""
        together = [axis.kind == "column" if self.mode == "grid" else axis.kind != "count" for axis in self.axes]
        first = tuple(axis for axis, joined in zip(self.axes, together, strict=True) if joined)
        others = ((axis,) for axis, joined in zip(self.axes, together, strict=True) if not joined)
        return tuple(filter(None, (first, *others)))

    @property
    def count(self) -> int:
        """Number of members."""
        return math.prod(self.shape)

    @property
    def refusals(self) -> str:
        """One sentence on rejected points; empty if there are none."""
        count = sum(many for _, many in self.refused)
        sentence = f"{count} of {self.tried} points were rejected: {describe_refusals(dict(self.refused))}."
        return sentence if count else ""

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
        yield axis.key, axis.values, *reversed(field_at(kind, axis.key))
    yield "members", chosen.count, "", " × ".join(map(str, chosen.shape)) if len(chosen.shape) > 1 else ""
    yield "rejected points", chosen.refusals or None


def _experiment(chosen: Sweep) -> str:
    return scenario_class(chosen.base).model_fields["experiment"].default


class Member(NamedTuple):
    """A member of a sweep."""

    name: str  # name of its folder: the swept values, and a digest of the whole scenario
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
    >>> grid.count, [member.values for member in members(grid)][1]
    (6, {'surface.a': 0.01, 'seed': 1})
    """
    if trust:
        trust_law_files(tables)
    tables = with_checksums(tables)
    base, table = {k: v for k, v in tables.items() if k != "sweep"}, tables.get("sweep")
    if not isinstance(table, dict):
        raise ScenarioError("a sweep needs a [sweep] table whose keys have lists of values, or distributions")
    kind = scenario_class(base)
    options = validate_table(Options, {key: table[key] for key in OPTIONS if key in table}, "sweep")
    entries = {key: parse_entry(key, entry) for key, entry in swept_entries(table).items()}
    if not entries:
        raise ScenarioError('[sweep] contains no keys: give one, such as "law.mu" = [0.2, 0.4]')
    for key in entries:
        field_at(kind, key)
        if key in ("law.file", "law.checksum"):
            raise ScenarioError(f"sweep.{key} is not supported: make one sweep for each law file")
    draws = read_draws(options.draws, entries, kind)
    text = json.dumps(tables | {"sweep": table | ({"draws": draws} if draws else {})}, indent=1, default=str)
    axes = tuple(make_axis(key, entry, base.get("seed", 0), options, draws) for key, entry in entries.items())
    if options.mode == "zip":
        side = [axis for axis in axes if axis.kind != "count"]
        for axis in side[1:]:
            if len(axis.values) != len(side[0].values):
                raise ScenarioError(
                    f"sweep.{side[0].key} has {len(side[0].values)} values, but sweep.{axis.key} has "
                    f"{len(axis.values)}: in zip mode, all keys need the same number of values"
                )
    chosen = _select_points(Sweep(base, axes, options.mode, text), options)
    require_sizes([Size("[sweep] defines", chosen.count, "members", FEWER)], ScenarioError)
    return chosen


def members(chosen: Sweep) -> Iterator[Member]:
    """Iterate over all members, with the last dimension varying fastest.

    Members are validated one by one, as in `member`.
    """
    return (member(chosen, k) for k in range(chosen.count))


def member(chosen: Sweep, k: int) -> Member:
    """Return member `k`, counted from 0 with the last dimension varying fastest.

    Raises
    ------
    ScenarioError
        If the scenario is invalid; the message names the member, the key and the problem.
    """
    values = values_of(chosen, k)
    try:
        validated = scenario(**reduce(lambda tables, item: with_value(tables, *item), values.items(), chosen.base))
    except ScenarioError as problem:
        raise ScenarioError(f"member {', '.join(f'{k} = {v}' for k, v in values.items())}: {problem}") from None
    label = ",".join(f"{key}={f'{v:.6g}' if isinstance(v, float) else v}" for key, v in values.items())
    name = f"{re.sub(r'[^A-Za-z0-9.=,+_-]+', '_', label)[:80]}-{validated.digest[:10]}"
    return Member(name, values, validated)


def values_of(chosen: Sweep, k: int) -> dict:
    """Return the values of the swept keys of member `k`."""
    places = zip(np.unravel_index(k, chosen.shape), chosen.groups, strict=True)
    return {axis.key: axis.values[index] for index, group in places for axis in group}


def describe_differences(old: dict, new: dict) -> str:
    """Describe differences between two sweeps; empty if only the values of swept keys differ."""
    (base, keys, mode), (its_base, its_keys, its_mode) = map(_split_tables, (old, new))
    differences = []
    if set(keys) != set(its_keys):
        differences.append(f"the old sweep has keys {', '.join(keys)}, the new one {', '.join(its_keys)}")
    if mode != its_mode:
        differences.append(f"the mode was {mode} and is now {its_mode}")
    changed = [key for key in dict.fromkeys((*base, *its_base)) if base.get(key) != its_base.get(key)]
    for key in changed[:3]:
        there, here = (json.dumps(keys[key])[:60] if key in keys else "not given" for keys in (base, its_base))
        differences.append(f"{key} was {there} and is now {here}")
    if len(changed) > 3:
        differences.append(f"{len(changed) - 3} more keys differ")
    return ", ".join(differences)


def _split_tables(tables: dict) -> tuple[dict, list[str], str]:
    """Return the dotted keys of the base with their values, the swept keys, and the mode."""
    table = tables.get("sweep", {})
    base = {"experiment": DEFAULT} | flatten({k: v for k, v in tables.items() if k != "sweep"})
    return base, list(swept_entries(table)), table.get("mode", "grid")


def _select_points(chosen: Sweep, options: Options) -> Sweep:
    """Draw the points of a sample, and reject points that do not satisfy the conditions."""
    groups = [group for group in chosen.groups if group[0].kind != "count"]
    keys = [axis.key for group in groups for axis in group]
    conditions = () if options.where is None else parse_conditions(options.where, keys)
    sampled = chosen.mode == "sample" and bool(keys)
    if not (sampled or conditions):
        return chosen
    if sampled:
        number, rows = options.number, _sample_rows(groups[0], options)
    else:
        number = math.prod(len(group[0].values) for group in groups)
        require_sizes([Size("[sweep] defines", number, "points", FEWER)], ScenarioError)
        rows = (sum(row, ()) for row in product(*(zip(*(a.values for a in group), strict=True) for group in groups)))
    points, refused = [], {condition.text: 0 for condition in conditions}
    for tried, row in enumerate(rows, start=1):
        broken = find_broken(dict(zip(keys, row, strict=True)), conditions)
        if broken is None:
            points.append(row)
        else:
            refused[broken] += 1
        if len(points) == number:
            break
        if sampled and tried % number == 0:
            check_effort(len(points), tried, refused)
    if not points:
        raise ScenarioError(f"sweep.where rejects all {number} points: {describe_refusals(refused)}")
    values = dict(zip(keys, zip(*points, strict=True), strict=True))
    axes = tuple(axis._replace(values=values.get(axis.key, axis.values)) for axis in chosen.axes)
    mode, tried = "sample" if sampled else "zip", tried if conditions else 0
    return chosen._replace(axes=axes, mode=mode, tried=tried, refused=tuple(refused.items()))


def _sample_rows(axes: tuple[Axis, ...], options: Options) -> Iterator[tuple]:
    """Yield random points endlessly; the columns of a draws table share a coordinate, which chooses the row."""
    names = ["draws" if axis.kind == "column" else axis.key for axis in axes]
    for share in BATCHES[options.draw](list(dict.fromkeys(names)), options.number, options.draw_seed):
        yield from zip(*(_sample(axis, share[name]) for axis, name in zip(axes, names, strict=True)), strict=True)


def _sample(axis: Axis, share: np.ndarray) -> tuple:
    if axis.values:
        return tuple(axis.values[int(s * len(axis.values))] for s in share)
    return quantiles(axis.kind, axis.parameters, share)


LONGEST, DEEPEST = 1000, 50  # limits of a condition: characters, and levels of parentheses and operators
ARITHMETIC = (ast.Add, ast.Sub, ast.Mult, ast.Div)
COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
POWER = "**"  # name of a function that cannot be a key
ALLOWED = "use names of swept keys, numbers, comparisons, + - * / **, and, or, not"


class Condition(NamedTuple):
    """One condition; conditions joined by `and` are split into several."""

    text: str
    holds: Callable[[dict], bool]  # function of {key: value}


def parse_conditions(where, keys) -> tuple[Condition, ...]:
    """Parse the conditions of a sweep, which are a text or a list of texts.

    Parameters
    ----------
    keys : dotted names of the swept keys. A condition may use their last parts alone if these are unique; names that
    are not valid in Python, such as legs.2.velocity, are quoted

    Examples
    --------
    >>> (above,) = parse_conditions("b > 1.2 * a", ("surface.a", "surface.b"))
    >>> above.text, above.holds({"surface.a": 0.010, "surface.b": 0.013})
    ('b > 1.2 * a', True)
    """
    texts = where if isinstance(where, list | tuple) else [where]
    if not texts or not all(isinstance(text, str) for text in texts):
        raise ScenarioError(f"sweep.where must be a condition such as 'b > a', got {shortened(str(where))!r}")
    return tuple(part for text in texts for part in _parse(text, tuple(keys)))


def find_broken(values: dict, conditions) -> str | None:
    """Return the text of the first condition that a point does not satisfy, or None."""
    return next((condition.text for condition in conditions if not condition.holds(values)), None)


def _parse(text: str, keys: tuple[str, ...]) -> list[Condition]:
    if len(text) > LONGEST:
        raise ScenarioError(f"sweep.where has {len(text)} characters: at most {LONGEST} are allowed")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's warnings about odd expressions, which are rejected below
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _refusal(text, "it cannot be read", ALLOWED) from None
    parts = tree.values if isinstance(tree, ast.BoolOp) and isinstance(tree.op, ast.And) else [tree]
    return [Condition(ast.unparse(part), _compile(_restrict(part, text, keys, bool), text)) for part in parts]


def _compile(tree: ast.expr, text: str) -> Callable[[dict], bool]:
    """Return a function of {key: value} that raises a one-sentence error for values at which it is undefined."""
    code = compile(ast.fix_missing_locations(ast.Expression(tree)), "sweep.where", "eval")

    def holds(values: dict) -> bool:
        used = {key: values[key] for key in code.co_names if key != POWER}
        for key, value in used.items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                problem = f"{key} has the value {shortened(str(value))!r}"
                raise _refusal(text, problem, "only numbers can be compared")
        try:
            return eval(code, {"__builtins__": {}, POWER: math.pow}, {key: float(value) for key, value in used.items()})
        except (ArithmeticError, ValueError):
            where = ", ".join(f"{key} = {value}" for key, value in values.items())
            raise _refusal(text, f"it is undefined at {shortened(where)}", "exclude that point") from None

    return holds


def _restrict(node: ast.expr, text: str, keys: tuple[str, ...], wanted: type, depth: int = 0) -> ast.expr:
    """Copy of an expression of type bool or float, built from allowed parts only."""
    if depth > DEEPEST:
        raise _refusal(text, "it is nested too deeply", f"at most {DEEPEST} levels are allowed")

    def below(inner: ast.expr, kind: type = float) -> ast.expr:
        return _restrict(inner, text, keys, kind, depth + 1)

    if wanted is bool:
        match node:
            case ast.BoolOp():
                return ast.BoolOp(node.op, [below(part, bool) for part in node.values])
            case ast.UnaryOp(op=ast.Not()):
                return ast.UnaryOp(node.op, below(node.operand, bool))
            case ast.Compare() if all(isinstance(op, COMPARISONS) for op in node.ops):
                return ast.Compare(below(node.left), node.ops, [below(side) for side in node.comparators])
        raise _refusal(text, f"{_quoted(node)} is neither true nor false", "compare two numbers, as in 'b > a'")
    match node:
        case ast.Constant() if type(node.value) in (int, float):
            if not abs(node.value) <= LARGEST:
                raise _refusal(text, "it contains a number that is too large", f"use numbers up to {LARGEST:g}")
            return ast.Constant(float(node.value))
        case ast.UnaryOp(op=ast.USub() | ast.UAdd()):
            return ast.UnaryOp(node.op, below(node.operand))
        case ast.BinOp(op=ast.Pow()):  # powers of negative numbers are complex in Python
            return ast.Call(ast.Name(POWER, ast.Load()), [below(node.left), below(node.right)], [])
        case ast.BinOp() if isinstance(node.op, ARITHMETIC):
            return ast.BinOp(below(node.left), node.op, below(node.right))
    if (name := _dotted_name(node)) is not None:
        matches = [key for key in keys if key == name] or [key for key in keys if key.endswith(f".{name}")]
        if len(matches) == 1:
            return ast.Name(matches[0], ast.Load())
        if matches:
            raise _refusal(text, f"{name!r} may be {' or '.join(matches)}", "give the whole name")
        raise _refusal(text, f"{shortened(name)!r} is not a swept key", f"the keys are {shortened(', '.join(keys))}")
    raise _refusal(text, f"{_quoted(node)} is not a number or the name of a swept key", ALLOWED)


def _dotted_name(node: ast.AST) -> str | None:
    """Return a name, names joined by dots, or a text in quotes; None for anything else."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    parts = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    return ".".join([node.id, *reversed(parts)]) if isinstance(node, ast.Name) else None


def _quoted(node: ast.AST) -> str:
    try:
        return repr(shortened(ast.unparse(node)))
    except RecursionError:
        return "an expression"


def _refusal(text: str, problem: str, remedy: str) -> ScenarioError:
    return ScenarioError(f"sweep.where = {shortened(text)!r} is not valid, because {problem}: {remedy}")
