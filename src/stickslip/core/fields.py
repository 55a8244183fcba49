"""Fields of a state: type, shape, range and, for indices, their targets. Checks of states are based on this table.

Compiled code does not check types, indices or lengths. `check_parts` is therefore called wherever states or their parts
enter the package: in public functions (`arguments.checked`), when files are read, and when a state is built. Shapes and
units are stated in comments beside the fields of a NamedTuple (`definitions`).
"""

import ast
import inspect
import re
from collections.abc import Mapping
from functools import cache
from numbers import Integral, Real
from typing import Any, NamedTuple

import numpy as np


@cache
def _classes(module) -> dict[str, str]:
    """Sources of the top-level classes of a module, read at once, because `inspect` would parse it for each class."""
    try:
        text = inspect.getsource(module)
    except (OSError, TypeError):  # defined in an interpreter
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
    except (OSError, TypeError, ValueError):  # not a NamedTuple, or one defined in an interpreter
        return "", {}
    fields = (re.match(r"\s+(\w+): [^#]*#(.*)", line) for line in reversed(lines))
    return head, {field[1]: field[2] for field in fields if field and field[1] in names}  # the first one counts


@cache
def shapes_of(kind: type) -> dict[str, tuple[str, ...]]:
    """Shapes of fields, such as (N, 3), at the beginning of their comments or in the first line of the docstring.

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


BODY_BITS, IMAGE_BITS = 21, 7  # bits of a body number and of each component of an image in the key of a contact
LARGEST = 1e150  # largest magnitude of any number in a state, so that squares are finite
LONG = 10_000  # smallest array size for which BLAS uses several threads
COURSE_DTYPE = np.int16  # type of column numbers; small, because there are nine per body


class Field(NamedTuple):
    """Type, shape and range of an entry. Sizes and bounds may be names of sizes (see `_sizes`)."""

    dtype: type
    shape: tuple[int | str | None, ...] | None = None  # None: a scalar, or any length
    low: float | str = -LARGEST
    high: float | str = LARGEST
    optional: bool = False


def _real(*shape, low: float = -LARGEST, optional: bool = False) -> Field:
    return Field(np.float64, shape, low, optional=optional)


def _positive(*shape) -> Field:
    return _real(*shape, low=1 / LARGEST)


FIELDS = {
    "grains": {
        "position": _real("grains", 3), "angle": _real("grains", 3), "velocity": _real("grains", 3),
        "spin": _real("grains", 3), "radius": _positive("grains"), "mass": _positive("grains"),
        "inertia": _real("grains", low=5e-324), "material": Field(np.int64, ("grains",), 0),
    },
    "walls": {
        "point": _real("walls", 3), "normal": _real("walls", 3), "velocity": _real("walls", 3),
        "mass": _positive("walls"), "material": Field(np.int64, ("walls",), 0),
    },
    "cell": {
        "vectors": _real(3, 3), "periodic": Field(np.bool_, (3,)), "dim": Field(np.int64, None, 2, 3),
        "rate": _real(3, 3),
    },
    "contacts": {
        "i": Field(np.int32, ("rows",), 0, "last grain"), "j": Field(np.int32, ("rows",), 0, "last body"),
        "image": Field(np.int16, ("rows", 3), -(1 << IMAGE_BITS - 1), (1 << IMAGE_BITS - 1) - 1),
        "key": Field(np.int64, ("rows",), 0, np.inf), "slip": _real("rows", 3), "mode": Field(np.int8, ("rows",), 0, 2),
        "pair": _real("rows", 3), "roll": _real("rows", 3), "reached": Field(np.bool_, ("rows",)),
        "origin": _real("bodies", 3), "skin": Field(np.float64, None, 5e-324), "gap": Field(np.float64, None, 0),
        "stale": Field(np.bool_, None), "count": Field(np.int64, (1,), 0, "rows"),
        "rolling": _real("rows", None, optional=True),
    },
    "control": {
        "force": _real("bodies", 3), "torque": _real("bodies", 3), "free": Field(np.bool_, ("bodies", 6)),
        "rate": _real("bodies", 6), "gravity": _real(3), "group": Field(np.int64, ("bodies",), -1, "last body"),
        "cell_free": Field(np.bool_, (3, 3)), "cell_rate": _real(3, 3), "stress": _real(3, 3),
        "cell_mass": Field(np.float64, None, 0), "knots": _real("knots"), "course": _real("knots", "courses"),
        "follows": Field(COURSE_DTYPE, ("bodies", 6), -1, "last course"),
        "cell_follows": Field(np.int64, (3, 3), -1, "last course"), "spring": _real("bodies", 3, low=0),
        "anchor": _real("bodies", 3), "leads": Field(COURSE_DTYPE, ("bodies", 3), -1, "last course"),
    },
    "bonds": {
        "i": Field(np.int32, ("bonds",), 0, "last grain"), "j": Field(np.int32, ("bonds",), 0, "last grain"),
        "image": Field(np.int16, ("bonds", 3), -(1 << IMAGE_BITS - 1), (1 << IMAGE_BITS - 1) - 1),
        "intact": Field(np.bool_, ("bonds",)), "length": _positive("bonds"), "arm": Field(np.float64, ("bonds",), 0, 1),
        "direction": _real("bonds", 3), "turn": _real("bonds", 4), "angle_i": _real("bonds", 3),
        "angle_j": _real("bonds", 3), "stiffness": _real("bonds", 4, low=0), "damping": _real("bonds", 4, low=0),
        "strength": Field(np.float64, ("bonds", 4), 1 / LARGEST, 1e300), "form": Field(np.int8, ("bonds",), 0, 2),
        "fading": Field(np.int8, ("bonds",), 0, 8), "failed": Field(np.int8, ("bonds",), 0, 5),
    },
    "instant": {"force": _real("bodies", 6), "pull": _real(3, 3), "mark": Field(np.int64, None, -np.inf, np.inf)},
    "": {"time": Field(np.float64)},
}  # fmt: skip


def _prepare_check(part: str, name: str, field: Field) -> tuple:
    """Full name of a field, the field, its type, its number of dimensions, and whether any number is allowed."""
    unbounded = field.dtype is np.float64 and field.shape is not None and not field.optional and field.low == -LARGEST
    dimensions = None if field.shape is None else len(field.shape)
    return f"{part}.{name}".strip("."), field, np.dtype(field.dtype), dimensions, unbounded


_ENTRIES = {part: tuple(_prepare_check(part, *one) for one in fields.items()) for part, fields in FIELDS.items()}


def check_parts(parts: Mapping[str, Any]) -> None:
    """Raise ValueError if an entry of a state, or of parts of it, is not allowed.

    Parameters
    ----------
    parts : the parts by their names in a state, and the state itself under the name ""
    """
    entries = []
    for part, noun in parts.items():
        if part and getattr(noun, "_fields", None) != tuple(FIELDS[part]):
            raise ValueError(f"{part} must be those of a State, got {type(noun).__name__}")
        values = noun if part else (noun.time,)
        entries += [(name, value, *known) for (name, *known), value in zip(_ENTRIES[part], values, strict=True)]
    for name, value, field, dtype, dimensions, _ in entries:
        if not (type(value) is np.ndarray and value.dtype is dtype and value.ndim == dimensions):
            _check_type(name, value, field)
    sizes = _sizes(parts)
    for name, value, field, *_ in entries:
        _check_shape(name, value, field, sizes)
    for name, value, field, _, _, unbounded in entries:
        if unbounded:  # a finite sum of squares shows in one pass that no entry is NaN or too large
            known = value[: sizes["pairs"]] if field.shape[0] == "rows" else value
            if _sum_squares(known) <= LARGEST**2:
                continue
        _check_range(name, value, field, sizes)
    if "contacts" in parts:
        # pairs are sorted by their keys
        contacts = parts["contacts"]
        count = int(contacts.count[0])
        key = pack_keys(contacts.i[:count], contacts.j[:count], contacts.image[:count])
        if not np.array_equal(key, contacts.key[:count]) or (key[1:] <= key[:-1]).any():
            raise ValueError("contacts are not sorted, or their keys do not match them: use the contacts of this state")


def _sum_squares(values: np.ndarray) -> float:
    """Sum of squares without BLAS, whose threads would keep spinning beside those of a run."""
    return np.vdot(values, values) if values.size < LONG else np.einsum("...i,...i->...", values, values).sum()


def check_entry(name: str, value, field: Field, sizes: Mapping[str, int]) -> None:
    """Raise ValueError if an entry does not have the type, shape and range of a field."""
    _check_type(name, value, field)
    _check_shape(name, value, field, sizes)
    _check_range(name, value, field, sizes)


def _sizes(parts: Mapping[str, Any]) -> dict[str, int]:
    """Lengths of the arrays of a state, and the largest values of indices.

    Incomplete states define only some of these: a control defines the number of bodies, but not that of grains.
    """
    sizes = {}
    if "instant" in parts:
        sizes["bodies"] = len(parts["instant"].force)
    if "contacts" in parts:
        contacts = parts["contacts"]
        sizes |= {"bodies": len(contacts.origin), "rows": len(contacts.i)}
        sizes["pairs"] = min(max(int(contacts.count[:1].sum()), 0), sizes["rows"])
    if "bonds" in parts:
        sizes["bonds"] = len(parts["bonds"].i)
    if "control" in parts:
        control = parts["control"]
        sizes |= {"bodies": len(control.force), "knots": len(control.knots), "courses": control.course.shape[1]}
        sizes["last course"] = sizes["courses"] - 1
    if "walls" in parts:
        sizes["walls"] = len(parts["walls"].mass)
    if "grains" in parts:
        sizes["grains"] = len(parts["grains"].radius)
    if "grains" in parts and "walls" in parts:
        sizes["bodies"] = sizes["grains"] + sizes["walls"]
    sizes["last body"] = sizes.get("bodies", 0) - 1
    sizes["last grain"] = sizes.get("grains", sizes.get("bodies", 0)) - 1
    return sizes


_SCALARS = {np.float64: (Real, "a number"), np.int64: (Integral, "a whole number"), np.bool_: (bool, "True or False")}


def _check_type(name: str, value, field: Field) -> None:
    if field.optional and value is None:
        return
    if field.shape is None:
        kinds, allowed = _SCALARS[field.dtype]
        if not isinstance(value, kinds) or (isinstance(value, bool) and field.dtype is not np.bool_):
            raise ValueError(f"{name} has type {type(value).__name__}: it must be {allowed}")
    elif not isinstance(value, np.ndarray) or value.dtype != field.dtype or value.ndim != len(field.shape):
        got = f"{value.dtype} in {value.ndim} dimensions" if isinstance(value, np.ndarray) else type(value).__name__
        raise ValueError(
            f"{name} must be an array of {np.dtype(field.dtype)} in {len(field.shape)} dimensions, got {got}"
        )


def _check_shape(name: str, value, field: Field, sizes: Mapping[str, int]) -> None:
    if value is None or field.shape is None:
        return
    shape = tuple(
        [n if size is None else sizes.get(size, size) for n, size in zip(value.shape, field.shape, strict=True)]
    )
    if value.shape != shape:
        parts = " and ".join(f"{sizes[key]} {key}" for key in ("grains", "walls") if key in sizes)
        remedy = f": the parts of a state with {parts} must belong together" if parts else ""
        raise ValueError(f"{name} has shape {value.shape} where {shape} is needed{remedy}")


def _check_range(name: str, value, field: Field, sizes: Mapping[str, int]) -> None:
    if value is None or field.dtype is np.bool_:
        return
    if field.shape and field.shape[0] == "rows":
        value = value[: sizes["pairs"]]
    if field.shape and not value.size:
        return
    low, high = (sizes.get(bound, bound) for bound in (field.low, field.high))
    least, most = (f.reduce(value, axis=None) if field.shape else value for f in (np.minimum, np.maximum))
    if not (low <= least and most <= high):
        _refuse(name, np.asarray(value), field, low, high)


def _refuse(name: str, value: np.ndarray, field: Field, low, high) -> None:
    bad = np.argwhere(~((value >= low) & (value <= high)))[0]
    place = f"[{', '.join(map(str, bad))}]" if len(bad) else ""
    got = value[tuple(bad)]
    shown = "NaN" if got != got else f"{got:g}"
    if field.dtype is not np.float64:
        shown = str(got)
        allowed = str(low) if low == high else f"between {low} and {high}" if high < LARGEST else f"at least {low}"
    else:
        sign = "positive and " if low > 0 else "zero or positive and " if low == 0 else ""
        allowed = (
            f"{sign}finite"
            if abs(got) < 1 / LARGEST or got < 0 <= low
            else f"{sign}finite, at most {LARGEST:g} in size"
        )
    raise ValueError(f"{name}{place} is {shown}: it must be {allowed}")


def pack_keys(i, j, image) -> np.ndarray:
    """Pack each (i, j, image) into one integer, such that the order is kept."""
    key = i.astype(np.int64) << BODY_BITS | j
    for m in range(3):
        key = key << IMAGE_BITS | image[:, m] + np.int64(1 << IMAGE_BITS - 1)
    return key
