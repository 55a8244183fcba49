"""Short `repr` and HTML tables of values: counts and sizes instead of arrays."""

import html
import textwrap
from enum import Enum

import numpy as np

from .units import units_of

MAX_LINES, LINE_WIDTH, MAX_LENGTH = 6, 110, 60  # lines of a repr, characters per line, characters per value


def readable(kind=None, *, head=None, picture=None):
    """Decorate a NamedTuple class with a repr of at most six lines, and a small table for notebooks.

    Parameters
    ----------
    head : function of the value that returns one line, such as its counts. Default: its own `str`, else all fields
    picture : function of the value that returns an SVG to be shown above the table
    """
    if kind is None:
        return lambda kind: readable(kind, head=head, picture=picture)
    head = (
        head
        or vars(kind).get("__str__")
        or (lambda value: ", ".join(f"{k} = {format_value(v)}" for k, v in fields(value)))
    )

    def to_html(self) -> str:
        title = f"<p>{html.escape(folded(f'{kind.__name__}: {head(self)}'))}</p>"
        left = "style='text-align:left'"
        known = {name: f"[{unit}]" for name, unit in units_of(kind).items()}
        cells = ((k, html.escape(format_value(v)), known.get(k, "")) for k, v in fields(self))
        rows = (f"<tr><td {left}>{k}</td><td {left}>{v}</td><td {left}>{unit}</td></tr>" for k, v, unit in cells)
        return (picture(self) if picture else "") + title + f"<table>{''.join(rows)}</table>"

    kind.__repr__ = lambda self: folded(f"{kind.__name__}: {head(self)}")
    kind._repr_html_ = to_html
    return kind


def fields(value) -> list[tuple[str, object]]:
    """Names and values of the public fields of a NamedTuple."""
    return [(name, getattr(value, name)) for name in value._fields if not name.startswith("_")]


def folded(text: str) -> str:
    """Wrap text to at most six lines, and mark omissions."""
    return "\n".join(
        textwrap.wrap(
            text, LINE_WIDTH, subsequent_indent="  ", max_lines=MAX_LINES, placeholder=" …", break_on_hyphens=False
        )
    )


def format_value(value) -> str:
    """Format a value in a few characters."""
    if isinstance(value, np.ndarray) and value.ndim:
        return (
            f"{value.dtype} {value.shape}" if value.size > 3 or value.ndim > 1 else np.array2string(value, precision=4)
        )
    if isinstance(value, bool | np.bool_ | None.__class__):
        return str(value)
    if isinstance(value, complex | np.complexfloating):
        return f"{complex(value):.6g}"
    if isinstance(value, float | np.floating):
        return f"{float(value):.6g}"
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, str):
        return value if len(value) <= MAX_LENGTH else value[: MAX_LENGTH - 1] + "…"
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value).__name__
    if isinstance(value, list | tuple | dict | set):
        items = list(value.values()) if isinstance(value, dict) else list(value)
        if len(items) <= 4 and all(isinstance(x, int | float | str | None.__class__) for x in items):
            shown = dict(value) if isinstance(value, dict) else value
            return truncate(str(shown))
        kinds = {type(x).__name__ for x in items}
        return f"{len(items)} {kinds.pop()}" if len(kinds) == 1 else f"{len(items)} items"
    return truncate(str(value).split("\n")[0]) if isinstance(value, int) else type(value).__name__


def pluralize(number: int, word: str) -> str:
    """Format a number with its noun, as in "2 grains"."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def truncate(text: str) -> str:
    """Truncate text to MAX_LENGTH characters."""
    return text if len(text) <= MAX_LENGTH else text[: MAX_LENGTH - 1] + "…"
