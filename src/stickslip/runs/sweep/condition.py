"""Conditions on the values of swept keys, such as "b > a".

The text is parsed with Python's grammar, but only names of swept keys, numbers, comparisons, arithmetic, and, or and
not are accepted; everything else is refused before anything is evaluated.
"""

import ast
import math
import operator
import warnings
from collections.abc import Callable
from typing import NamedTuple

from ...core.text import shortened
from ...data.schema import LARGEST, ScenarioError

LONGEST, DEEPEST = 1000, 50  # characters of a condition, and levels of parentheses and operators
ARITHMETIC = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
              ast.Pow: math.pow}  # fmt: skip
COMPARISONS = {ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge,
               ast.Eq: operator.eq, ast.NotEq: operator.ne}  # fmt: skip
ALLOWED = "use names of swept keys, numbers, comparisons, + - * / **, and, or, not"


class Condition(NamedTuple):
    """A condition; one that joins several by `and` is split into them."""

    text: str
    holds: Callable[[dict], bool]  # of {key: value}


def parse_conditions(where, keys) -> tuple[Condition, ...]:
    """Parse the conditions of a sweep, a text or a list of texts.

    Parameters
    ----------
    keys : dotted names of the swept keys. A condition may use their last parts alone if these are unique; names that
        Python cannot read, such as legs.2.velocity, are written in quotes

    Examples
    --------
    >>> (above,) = parse_conditions("b > 1.2 * a", ("surface.a", "surface.b"))
    >>> above.text, above.holds({"surface.a": 0.010, "surface.b": 0.013})
    ('b > 1.2 * a', True)
    """
    texts = where if isinstance(where, list | tuple) else [where]
    if not texts or not all(isinstance(text, str) for text in texts):
        raise ScenarioError(f"sweep.where = {shortened(str(where))!r} was given: use a condition such as 'b > a'")
    return tuple(part for text in texts for part in _parse(text, tuple(keys)))


def find_broken(values: dict, conditions) -> str | None:
    """Return the text of the first condition that a point does not satisfy, or None."""
    return next((condition.text for condition in conditions if not condition.holds(values)), None)


def _parse(text: str, keys: tuple[str, ...]) -> list[Condition]:
    if len(text) > LONGEST:
        raise ScenarioError(f"sweep.where has {len(text)} characters: at most {LONGEST} are allowed")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's remarks on odd expressions, which are refused below
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _refusal(text, "it cannot be read", ALLOWED) from None
    parts = tree.values if isinstance(tree, ast.BoolOp) and isinstance(tree.op, ast.And) else [tree]
    return [Condition(ast.unparse(part), _guarded(text, _compile(part, text, keys, bool))) for part in parts]


def _guarded(text: str, function: Callable) -> Callable[[dict], bool]:
    """Return the function with one sentence for values at which it is not defined."""

    def holds(values: dict) -> bool:
        try:
            return function(values)
        except ScenarioError:  # also a ValueError
            raise
        except (ArithmeticError, ValueError):
            where = ", ".join(f"{key} = {value}" for key, value in values.items())
            raise _refusal(text, f"it is not defined at {shortened(where)}", "exclude that point") from None

    return holds


def _compile(node: ast.AST, text: str, keys: tuple[str, ...], wanted: type, depth: int = 0) -> Callable:
    """Return a function of {key: value} for a node that must give a truth value (bool) or a number (float)."""
    if depth > DEEPEST:
        raise _refusal(text, "it is nested too deeply", f"at most {DEEPEST} levels are allowed")

    def below(inner: ast.AST, kind: type) -> Callable:
        return _compile(inner, text, keys, kind, depth + 1)

    if wanted is bool:
        return _compile_truth(node, text, below)
    return _compile_number(node, text, keys, below)


def _compile_truth(node: ast.AST, text: str, below: Callable) -> Callable:
    if isinstance(node, ast.BoolOp):
        parts, joined = [below(part, bool) for part in node.values], all if isinstance(node.op, ast.And) else any
        return lambda values: joined(part(values) for part in parts)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        inner = below(node.operand, bool)
        return lambda values: not inner(values)
    if isinstance(node, ast.Compare) and all(type(op) in COMPARISONS for op in node.ops):
        sides, signs = [below(side, float) for side in (node.left, *node.comparators)], [type(op) for op in node.ops]

        def compare(values: dict) -> bool:
            numbers = [side(values) for side in sides]
            return all(COMPARISONS[s](p, q) for s, p, q in zip(signs, numbers, numbers[1:], strict=False))

        return compare
    raise _refusal(text, f"{_quoted(node)} is neither true nor false", "compare two numbers, as in 'b > a'")


def _compile_number(node: ast.AST, text: str, keys: tuple[str, ...], below: Callable) -> Callable:
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        if not abs(node.value) <= LARGEST:
            raise _refusal(text, "it contains a number that is too large", f"use numbers up to {LARGEST:g}")
        number = float(node.value)
        return lambda values: number
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner, sign = below(node.operand, float), -1.0 if isinstance(node.op, ast.USub) else 1.0
        return lambda values: sign * inner(values)
    if isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
        left, right, apply = below(node.left, float), below(node.right, float), ARITHMETIC[type(node.op)]
        return lambda values: apply(left(values), right(values))
    if (name := _dotted_name(node)) is not None:
        key = _find_key(name, text, keys)
        return lambda values: _number(values[key], key, text)
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


def _find_key(name: str, text: str, keys: tuple[str, ...]) -> str:
    matches = [key for key in keys if key == name] or [key for key in keys if key.endswith(f".{name}")]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise _refusal(text, f"{name!r} may be {' or '.join(matches)}", "give the whole name")
    raise _refusal(text, f"{shortened(name)!r} is not a swept key", f"the keys are {shortened(', '.join(keys))}")


def _number(value, key: str, text: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _refusal(text, f"{key} has the value {shortened(str(value))!r}", "only numbers can be compared")
    return float(value)


def _quoted(node: ast.AST) -> str:
    try:
        return repr(shortened(ast.unparse(node)))
    except RecursionError:
        return "an expression"


def _refusal(text: str, problem: str, remedy: str) -> ScenarioError:
    return ScenarioError(f"sweep.where = {shortened(text)!r} was given, but {problem}: {remedy}")
