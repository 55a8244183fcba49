"""Definitions of NamedTuples: the comments beside their fields, and the shapes that these state."""

import ast
import inspect
import re
from functools import cache


@cache
def _classes(module) -> dict[str, str]:
    """Source of the classes at the top of a module: `inspect` parses the whole module for each of them."""
    try:
        text = inspect.getsource(module)
    except (OSError, TypeError):  # an interpreter
        return {}
    lines = text.splitlines()
    tops = (node for node in ast.parse(text).body if isinstance(node, ast.ClassDef))
    return {node.name: "\n".join(lines[node.lineno - 1 : node.end_lineno]) for node in tops}


@cache
def definitions(kind: type) -> tuple[str, dict[str, str]]:
    """The first line of a NamedTuple's docstring, and the comments beside its fields."""
    names = getattr(kind, "_fields", ())
    try:
        text = _classes(inspect.getmodule(kind)).get(kind.__qualname__) or inspect.getsource(kind)
        head, *lines = (line for line in text.splitlines() if not re.match(r"@|class |\s*$", line))
    except (OSError, TypeError, ValueError):  # no NamedTuple, or one defined in an interpreter
        return "", {}
    fields = (re.match(r"\s+(\w+): [^#]*#(.*)", line) for line in reversed(lines))
    return head, {field[1]: field[2] for field in fields if field and field[1] in names}  # the first such line counts


@cache
def shapes_of(kind: type) -> dict[str, tuple[str, ...]]:
    """Shapes of fields as their comments begin with them, such as (N, 3), or as the docstring's first line has one.

    Examples
    --------
    >>> from stickslip.core.state import Grains
    >>> shapes_of(Grains)["position"]
    ('N', '3')
    """
    whole, comments = definitions(kind)
    shared = _SHAPE.findall(whole)
    shapes = dict.fromkeys(getattr(kind, "_fields", ()), shared[0]) if len(shared) == 1 else {}
    shapes |= {name: shape[1] for name, text in comments.items() if (shape := re.match(rf"\s*{_SHAPE.pattern}", text))}
    return {name: tuple(part.strip() for part in shape.split(",") if part.strip()) for name, shape in shapes.items()}


_SHAPE = re.compile(r"\(((?:\w+, ?)+(?:\w+)?)\)")
