"""Short `repr` and HTML tables for readers: they show quantities with meaning and unit, not arrays and types."""

import html
import re
import textwrap
from collections.abc import Iterable
from enum import Enum

import numpy as np

from .units import meanings_of, units_of

MAX_LINES, LINE_WIDTH, MAX_LENGTH = 6, 110, 60  # lines of a repr, characters per line, characters per value
MOST_ROWS, LONGEST = 40, 400  # rows of a table, characters of a text in a table


def readable(kind=None, *, head=None, rows=None, picture=None):
    """Decorate a NamedTuple class with a repr of at most six lines, and a small table for notebooks.

    Parameters
    ----------
    head : function of the value that returns one line, such as its counts. Default: `str` of the value, else all fields
    rows : function of the value that returns rows of the table: (quantity, value), (quantity, value, unit) or
        (quantity, value, unit, meaning); those whose value is None or "" are left out. Default: all fields, with the
        units and meanings in the comments beside their definitions
    picture : function of the value that returns an SVG to be shown above the table
    """
    if kind is None:
        return lambda kind: readable(kind, head=head, rows=rows, picture=picture)
    own = head or vars(kind).get("__str__")
    head = own or _list_fields

    def to_html(self) -> str:
        title = f"{words(kind.__name__)}: {head(self)}" if own and not rows else words(kind.__name__)
        return (picture(self) if picture else "") + table(title, (rows or rows_of_fields)(self))

    kind.__repr__ = lambda self: folded(f"{kind.__name__}: {head(self)}")
    kind._repr_html_ = to_html
    kind._summary = own or (lambda value: words(kind.__name__))
    kind.__eq__, kind.__ne__ = _equal, lambda a, b: not _equal(a, b)
    return kind


def _equal(a, b) -> bool:
    """Return True if two values are equal in all entries, including those of arrays; NaN equals NaN."""
    if a is b:
        return True
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind in "fc" and b.dtype.kind in "fc")
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_equal(value, b[key]) for key, value in a.items())
    if isinstance(a, list | tuple):
        return isinstance(b, tuple if isinstance(a, tuple) else list) and len(a) == len(b) and all(map(_equal, a, b))
    if hasattr(a, "nnz") and hasattr(b, "nnz"):  # sparse matrices
        return a.shape == b.shape and not (a != b).nnz
    if hasattr(a, "equals") and type(a) is type(b):  # tables of pandas and xarray
        return bool(a.equals(b))
    return type(a) is not np.ndarray and type(b) is not np.ndarray and bool(a == b or (a != a and b != b))


def _list_fields(value) -> str:
    return "; ".join(f"{words(name)} = {format_value(entry)}" for name, entry in fields(value) if _is_given(entry))


def fields(value) -> list[tuple[str, object]]:
    """Names and values of the public fields of a NamedTuple."""
    return [(name, getattr(value, name)) for name in value._fields if not name.startswith("_")]


def rows_of_fields(value) -> list[tuple]:
    """Name in words, value, unit and meaning of all public fields of a NamedTuple."""
    units, meanings = units_of(type(value)), meanings_of(type(value))
    return [(words(k), v, units.get(k, ""), meanings.get(k, "")) for k, v in fields(value)]


def table(title: str, rows: Iterable[tuple]) -> str:
    """HTML of a small table: quantity, value, unit and meaning in each row."""
    rows = [_without_blanks(row) for row in map(tuple, rows) if _is_given(row[1])]
    more = len(rows) - MOST_ROWS
    rows = [*rows[:MOST_ROWS], (f"{more} more",)] if more > 0 else rows
    width = max(map(len, rows), default=0)

    def cells(row):
        texts = [format_value(cell, LONGEST) for cell in row]
        texts[2:3] = map(unit_in_signs, texts[2:3])
        for k, text in enumerate(texts):
            spans = f" colspan='{width - k}'" if k == len(texts) - 1 < width - 1 else ""
            yield f"<td{spans} style='text-align:left'>{html.escape(text.replace('`', ''))}</td>"

    lines = "".join(f"<tr>{''.join(cells(row))}</tr>" for row in rows)
    return f"<p>{html.escape(folded(title))}</p><table>{lines}</table>"


def _is_given(value) -> bool:
    return not (value is None or (isinstance(value, str) and not value))


def _without_blanks(row: tuple) -> tuple:
    """Row without trailing empty texts."""
    return _without_blanks(row[:-1]) if row and isinstance(row[-1], str) and not row[-1] else row


def words(name: str) -> str:
    """Name of a field or a class in words.

    Examples
    --------
    >>> words("shear_stress"), words("SlowRun")
    ('shear stress', 'slow run')
    """
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower() if name[:1].isupper() else name
    return apart.replace("_", " ").replace("@", " at ")


def unit_in_signs(unit: str) -> str:
    """Unit in brackets, as printed; empty for a dimensionless number.

    Examples
    --------
    >>> unit_in_signs("force/length^(dim-1)"), unit_in_signs("mass length^2")
    ('[force/length^(dim−1)]', '[mass length²]')
    """
    return f"[{unit.replace('^2', '²').replace('^3', '³').replace('-', '−')}]" if unit not in ("", "1") else ""


def folded(text: str) -> str:
    """Wrap text to at most six lines, and mark omissions."""
    return "\n".join(
        textwrap.wrap(
            text, LINE_WIDTH, subsequent_indent="  ", max_lines=MAX_LINES, placeholder=" …", break_on_hyphens=False
        )
    )


def format_value(value, longest: int = MAX_LENGTH) -> str:
    """Format a value in a few characters: an array by its range, a list by its length."""
    if isinstance(value, np.ndarray):
        return _format_array(value) if value.ndim else format_value(value.item())
    if value is None:
        return "none"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | np.integer):
        return truncate(str(value), longest)
    if isinstance(value, complex | np.complexfloating):
        return f"{complex(value):.6g}"
    if isinstance(value, float | np.floating):
        return f"{float(value):.6g}" if value == value else "undefined"
    if isinstance(value, Enum):
        return truncate(value.value if isinstance(value.value, str) else words(value.name.lower()), longest)
    if isinstance(value, str):
        return truncate(value, longest)
    if hasattr(type(value), "_summary"):
        return truncate(value._summary().split("\n")[0], longest)
    if isinstance(value, dict):
        return truncate(", ".join(f"{k}: {format_value(v)}" for k, v in value.items()), longest) if value else "none"
    if isinstance(value, list | tuple | set | frozenset) and not hasattr(value, "_fields"):
        return _format_list(list(value))
    return words(value.__name__ if isinstance(value, type) or callable(value) else type(value).__name__)


def _format_list(items: list) -> str:
    if len(items) > 4 and all(isinstance(x, int | float) for x in items):
        return _format_array(np.array(items, float))
    if len(items) <= 4 and all(isinstance(x, int | float | str | None.__class__ | Enum) for x in items):
        return truncate(", ".join(map(format_value, items))) or "none"
    kinds = {words(type(x).__name__) for x in items if x is not None}
    return f"{len(items)} of the kind {kinds.pop()}" if len(kinds) == 1 else f"{len(items)} items"


def _format_array(value: np.ndarray) -> str:
    """The numbers of a small array, or else their range and count."""
    if not value.size:
        return "none"
    if value.dtype.kind == "b":
        return f"{np.count_nonzero(value)} of {value.size}"
    if value.dtype.kind not in "iufc":
        return pluralize(len(value), "entry").replace("entrys", "entries")
    if value.size <= 4 or (value.ndim == 2 and value.size <= 9):
        lines = (", ".join(f"{x:.4g}" for x in row) for row in np.atleast_2d(value))
        return "; ".join(lines) if value.ndim <= 2 else _format_array(value.ravel())
    size = np.abs(value) if value.dtype.kind == "c" else value
    finite = size[np.isfinite(size)]
    number = f"{' × '.join(map(str, value.shape))} values"
    if not finite.size:
        return f"undefined ({number})"
    low, high = finite.min(), finite.max()
    extent = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    modulus, left_out = ("modulus " if value.dtype.kind == "c" else ""), value.size - finite.size
    return f"{modulus}{extent} ({number}{f', {left_out} undefined or infinite' if left_out else ''})"


def pluralize(number: int, word: str) -> str:
    """Format a number with its noun, as in "2 grains"."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def truncate(text: str, longest: int = MAX_LENGTH) -> str:
    """Truncate text to a number of characters."""
    return text if len(text) <= longest else text[: longest - 1] + "…"
