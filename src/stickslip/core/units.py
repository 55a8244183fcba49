"""Units of the fields of NamedTuples, read from the comments beside their definitions.

A comment such as `(T, 3) [length/time]` states a unit once: readers of the code, archives, datasets and tables all take
it from there. The sources are at hand wherever kernels are compiled, since `kernel_cache` reads them too.
"""

import inspect
import re
from functools import cache

_SI = {"length": "m", "time": "s", "mass": "kg", "force": "N", "energy": "J", "stress": "Pa"}
_WORDS = {*_SI, *_SI.values(), "W", "ns", "rad", "amplitude", "dim", "steps"}
_PRESSURE = "force/length^(dim-1)"


@cache
def units_of(kind: type) -> dict[str, str]:
    """Units of those fields of a NamedTuple that have exactly one: dimensions, or SI units if the class is in SI.

    A unit in the first line of the class's docstring is that of all fields.

    Examples
    --------
    >>> from stickslip.core.state import Grains
    >>> units_of(Grains)["inertia"]
    'mass length^2'
    """
    whole, comments = _definitions(kind)
    found = dict.fromkeys(getattr(kind, "_fields", ()), unit) if (unit := _unit_in(whole)) else {}
    return found | {name: unit for name, text in comments.items() if (unit := _unit_in(text))}


@cache
def meanings_of(kind: type) -> dict[str, str]:
    """What the fields of a NamedTuple are, in words: the comments beside them, without shapes, types and units.

    Examples
    --------
    >>> from stickslip.core.state import Grains
    >>> meanings_of(Grains)["angle"]
    'time integral of spin'
    """
    found = {}
    for name, text in _definitions(kind)[1].items():
        text = re.sub(r"^\s*\([^()]*\)|\s*\(([A-Z\d+ ]+, ?)+[A-Z\d+ ]*\)", "", text)  # shapes
        text = re.sub(r"^\s*(bool|u?int\d+|complex|float|structured)\b[:,]?", "", text)
        text = re.sub(r"\s*\[([^\]]+)\]", lambda unit: "" if _is_unit(unit[1]) else unit[0], text)
        found[name] = re.sub(r"[;:,]? see `[^`]*`", "", text).replace("`", "").strip(" ,;")
    return {name: text for name, text in found.items() if text}


@cache
def _definitions(kind: type) -> tuple[str, dict[str, str]]:
    """The first line of a NamedTuple's docstring, and the comments beside its fields."""
    names = getattr(kind, "_fields", ())
    try:
        head, *lines = (line for line in inspect.getsource(kind).splitlines() if not re.match(r"@|class |\s*$", line))
    except (OSError, TypeError, ValueError):  # no NamedTuple, or one defined in an interpreter
        return "", {}
    fields = (re.match(r"\s+(\w+): [^#]*#(.*)", line) for line in reversed(lines))
    return head, {field[1]: field[2] for field in fields if field and field[1] in names}  # the first such line counts


def _unit_in(text: str) -> str | None:
    """The unit in brackets in a text, in ASCII, with powers as in m^2; None if there is none, or more than one."""
    units = [unit for unit in re.findall(r"\[([^\]]+)\]", text) if _is_unit(unit)]
    return units[0].replace("²", "^2").replace("³", "^3").replace("−", "-") if len(units) == 1 else None


def _is_unit(text: str) -> bool:
    words = set(re.findall("[A-Za-z]+", text))
    return text == "1" or (len(words) > 0 and words <= _WORDS)


def in_si(unit: str) -> str:
    """SI unit of a quantity with given dimensions.

    Examples
    --------
    >>> in_si("mass length^2"), in_si("force/length^(dim-1)"), in_si("m/s")
    ('kg m^2', 'Pa', 'm/s')
    """
    return "Pa" if unit == _PRESSURE else re.sub("[a-z]+", lambda word: _SI.get(word[0], word[0]), unit)


class Fields(dict):
    """Values by name, with units for an archive.

    Units are those of the fields of the same names in NamedTuples, of which the first one that has it counts, or given
    by name.
    """

    def __init__(self, values, *kinds: type, **units: str):
        super().__init__(values)
        self.units = {name: unit for kind in reversed(kinds) for name, unit in units_of(kind).items()} | units
