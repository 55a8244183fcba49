"""Units of the fields of NamedTuples, read from the comments beside their definitions.

A comment such as `(T, 3) [length/time]` states a unit once: readers of the code, archives, datasets and tables all use
it.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import NamedTuple

from .arguments import checked
from .fields import definitions
from .text import quoted

YEAR = 365.25 * 86400.0  # [s]
_SI = {"length": "m", "time": "s", "mass": "kg", "force": "N", "energy": "J", "stress": "Pa"}
_POWERS = {  # powers of mass, length and time
    "mass": (1, 0, 0), "length": (0, 1, 0), "time": (0, 0, 1), "force": (1, 1, -2), "energy": (1, 2, -2),
}  # fmt: skip
_WORDS = {*_SI, *_SI.values(), "W", "ns", "rad", "amplitude", "dim", "steps"}
_PRESSURE = "force/length^(dim-1)"


@cache
def units_of(kind: type) -> dict[str, str]:
    """Units of those fields of a NamedTuple that have exactly one: dimensions, or SI units if the class uses SI.

    A unit in the first line of the class docstring applies to all fields.

    Examples
    --------
    >>> from stickslip.core.state import Grains
    >>> units_of(Grains)["inertia"]
    'mass length^2'
    """
    whole, comments = definitions(kind)
    units = dict.fromkeys(getattr(kind, "_fields", ()), unit) if (unit := _unit_in(whole)) else {}
    return units | {name: unit for name, text in comments.items() if (unit := _unit_in(text))}


@cache
def meanings_of(kind: type) -> dict[str, str]:
    """Meanings of the fields of a NamedTuple: the comments beside them, without shapes, types and units.

    Examples
    --------
    >>> from stickslip.core.state import Grains
    >>> meanings_of(Grains)["angle"]
    'time integral of spin'
    """
    meanings = {}
    for name, text in definitions(kind)[1].items():
        text = re.sub(r"^\s*\([^()]*\)|\s*\(([A-Z\d+ ]+, ?)+[A-Z\d+ ]*\)", "", text)  # shapes
        text = re.sub(r"^\s*(bool|u?int\d+|complex|float|structured)\b[:,]?", "", text)
        text = re.sub(r"\s*\[([^\]]+)\]", lambda unit: "" if _is_unit(unit[1]) else unit[0], text)
        meanings[name] = re.sub(r"[;:,]? see `[^`]*`", "", text).replace("`", "").strip(" ,;")
    return {name: text for name, text in meanings.items() if text}


def _unit_in(text: str) -> str | None:
    """The unit in brackets in a text, in ASCII, with powers as in m^2; None if there is none, or more than one."""
    units = [unit for unit in re.findall(r"\[([^\]]+)\]", text) if _is_unit(unit)]
    return units[0].replace("²", "^2").replace("³", "^3").replace("−", "-") if len(units) == 1 else None


def _is_unit(text: str) -> bool:
    symbols = set(re.findall("[A-Za-z]+", text))
    return text == "1" or (len(symbols) > 0 and symbols <= _WORDS)


class Units(NamedTuple):
    """Names of the units of length, mass and time, from which those of other quantities follow."""

    length: str
    mass: str
    time: str
    dim: int = 3  # number of dimensions: a stress is a force per area, or per length in two dimensions

    def __str__(self) -> str:
        return "SI" if self[:3] == SI[:3] else ", ".join(self[:3])


SI = Units("m", "kg", "s")
EXAMPLE = '"SI", or names of length, mass and time as in {length = "mm", mass = "g", time = "s"}'
_IN_USE: ContextVar[Units | None] = ContextVar("units in use", default=None)


def units_from(given, dim: int = 3) -> Units:
    """Units from "SI", from a dictionary with the keys length, mass and time, or from three names in this order.

    Raises
    ------
    ValueError
        If the units cannot be used.

    Examples
    --------
    >>> str(units_from("mm, g, s"))
    'mm, g, s'
    """
    names = [name.strip() for name in given.split(",")] if isinstance(given, str) else given
    if isinstance(names, dict) and set(names) == {"length", "mass", "time"}:
        names = [names[name] for name in ("length", "mass", "time")]
    if names in (["SI"], ("SI",)):
        return SI._replace(dim=dim)
    names = names if isinstance(names, list | tuple) else ()
    good = len(names) == 3 and all(isinstance(name, str) and name.isalpha() and len(name) <= 12 for name in names)
    if not good or len(set(names)) < 3:
        raise ValueError(f"units must be {EXAMPLE}, three different words of up to 12 letters, got {quoted(given)}")
    return Units(*names, dim=dim)


def in_units(unit: str, units: Units | None) -> str:
    """Unit of a quantity with given dimensions; without `units`, and for units of other kinds, it is unchanged.

    Examples
    --------
    >>> in_units("force/length^(dim-1)", SI), in_units("force", Units("mm", "g", "s"))
    ('Pa', 'g mm/s^2')
    """
    if units is None or not _is_unit(unit):
        return unit
    unit = unit.replace(_PRESSURE, "stress").replace("^dim", f"^{units.dim}")
    if units.dim == 2 or str(units) != "SI":  # only in SI and three dimensions does the unit of stress have a name
        power = units.dim - 1
        unit = re.sub(r"stress(/length)?", lambda match: _per_length(power + (match[1] is not None)), unit)
    if str(units) == "SI":
        return re.sub("[a-z]+", lambda word: _SI.get(word[0], word[0]), unit)
    return _product(unit, units)


def _per_length(power: int) -> str:
    return f"force/length^{power}" if power > 1 else "force/length"


def _product(unit: str, units: Units) -> str:
    """Unit as a product of powers of unit names."""
    above, _, below = unit.partition("/")
    total: dict[str, int] = {}
    for side, sign in ((above, 1), (below, -1)):
        whole = re.fullmatch(r"\((.*)\)\^(\d+)", side)
        for word in (whole[1] if whole else side).split():
            name, _, power = word.partition("^")
            times = sign * int(power or 1) * (int(whole[2]) if whole else 1)
            known = name in _POWERS
            parts = zip((units.mass, units.length, units.time), _POWERS[name], strict=True) if known else ((name, 1),)
            for part, exponent in parts:
                total[part] = total.get(part, 0) + times * exponent
    sides = [
        [name + (f"^{abs(power)}" if abs(power) > 1 else "") for name, power in total.items() if power * sign > 0]
        for sign in (1, -1)
    ]
    top, bottom = ([name for name in side if name != "1"] for side in sides)
    text = " ".join(top) or "1"
    return text if not bottom else f"{text}/{bottom[0]}" if len(bottom) == 1 else f"{text}/({' '.join(bottom)})"


def in_si(unit: str) -> str:
    """SI unit of a quantity with given dimensions.

    Examples
    --------
    >>> in_si("mass length^2"), in_si("force/length^(dim-1)"), in_si("m/s")
    ('kg m^2', 'Pa', 'm/s')
    """
    return in_units(unit, SI)


@contextmanager
@checked
def units_in_use(units: Units | str | dict[str, str] | None) -> Iterator[None]:
    """Print units in figures, tables and sentences within a `with` statement; no number changes.

    Parameters
    ----------
    units : "SI", names of length, mass and time as in "mm, g, s", a dictionary of these, or the result of
        `packing_units`; None to print only dimensions

    Examples
    --------
    >>> with units_in_use("mm, g, s"):
    ...     unit_name("force")
    'g mm/s²'
    """
    token = _IN_USE.set(units_from(units) if isinstance(units, str | dict) else units)
    try:
        yield
    finally:
        _IN_USE.reset(token)


def current_units() -> Units | None:
    """Units in use for printing; None if unknown."""
    return _IN_USE.get()


def unit_name(unit: str, dim: int | None = None) -> str:
    """Unit of a quantity with given dimensions, for a label: "length" or, with units in use, "mm".

    Parameters
    ----------
    dim : number of dimensions, if it may differ from that of the units in use
    """
    if not _is_unit(unit):  # a formula, such as that of a natural unit
        return unit
    units = _IN_USE.get()
    units = units._replace(dim=dim) if units and dim else units
    return in_units(unit, units).replace("^2", "²").replace("^3", "³")


def with_unit(number: str, unit: str, *, unnamed: str = "") -> str:
    """Return a number followed by its unit, or by `unnamed` if no units are in use."""
    return f"{number} {unit_name(unit) if _IN_USE.get() else unnamed}".rstrip()


def heading(name: str, unit: str) -> str:
    """Return the heading of a column, with its unit if units are in use."""
    return name if unit == "1" or _IN_USE.get() is None else f"{name} [{unit_name(unit)}]"


def in_readable_units(values, unit: str) -> tuple:
    """Return values and their unit for readers: times are in years if any is longer than a year."""
    if unit == "s" and any(abs(value) > YEAR for value in values):
        return tuple(value / YEAR for value in values), "years"
    return tuple(values), unit


class Fields(dict):
    """Values by name, with units for an archive.

    Units are given by name, or taken from the first NamedTuple that has fields of the same names.
    """

    def __init__(self, values, *kinds: type, **units: str):
        super().__init__(values)
        self.units = {name: unit for kind in reversed(kinds) for name, unit in units_of(kind).items()} | units
