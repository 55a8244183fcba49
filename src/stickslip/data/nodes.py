"""Conversion of states, results and nested containers to and from trees of nodes, which files can store.

A node has attributes and either arrays and strings, or other nodes by name. The class of a NamedTuple or enum is the
attribute `noun`, that of a tuple or list `sequence`, and that of the keys of a dictionary `keys`. Contact lists are
stored without unused capacity, but with all of their memory.
"""

import json
import math
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import Enum
from functools import cache
from typing import NamedTuple, get_args, get_type_hints

import numpy as np

from ..core.arguments import check_value
from ..core.laws.builtin import Law
from ..core.laws.kinds import Kind, describe_law, restore_kind
from ..core.reading import Reader
from ..core.state import PER_PAIR, Bonds, Cell, Contacts, Control, Grains, Instant, State, Walls
from ..core.text import SentenceError
from ..core.units import Fields, Units, in_units, units_of

_NOUNS = (State, Grains, Walls, Cell, Contacts, Control, Instant, Bonds, Law)
_LENGTH = struct.Struct("<Q")  # length of the outline of a tree [bytes]


# exceptions raised by HDF5, JSON and NumPy, and when objects are rebuilt, for damaged files
_DAMAGE = (OSError, RuntimeError, LookupError, TypeError, ValueError, AttributeError, OverflowError, MemoryError)


class ArchiveError(SentenceError):
    """Raised for a file that cannot be read as an archive; the message is one sentence for the user."""


@contextmanager
def refuse_damage(path, kind: str, remedy: str) -> Iterator[None]:
    """Raise ArchiveError for any error caused by a damaged file."""
    try:
        yield
    except ArchiveError:
        raise
    except _DAMAGE as problem:
        reason = str(problem).split(" (")[0].lower()
        raise ArchiveError(f"{path} cannot be read as {kind} ({reason}): {remedy}") from None


class Node(NamedTuple):
    """A group of nodes, or an array; text is an array of strings."""

    attrs: dict[str, str]
    content: "dict[str, Node] | np.ndarray | None"


def make_node(value, units: Units | None = None, unit: str | None = None) -> Node:
    """Node of a value; arrays with a known unit have the attribute `units`."""
    if isinstance(value, Contacts):
        value = trimmed(value)
    if isinstance(value, Enum):
        return Node({"noun": type(value).__name__}, np.array(value.name))
    if hasattr(value, "_asdict"):
        known = units_of(type(value))
        content = {key: make_node(item, units, known.get(key)) for key, item in sorted(value._asdict().items())}
        if isinstance(value, Law) and isinstance(value.kind, Kind):
            content["own"] = make_node(describe_law(value), units)
        return Node({"noun": type(value).__name__}, content)
    if isinstance(value, dict):
        numbers = [key for key in value if not isinstance(key, str)]
        named = {key if isinstance(key, str) else repr(key): item for key, item in value.items()}
        known = value.units if isinstance(value, Fields) else dict.fromkeys(named, unit)
        content = {key: make_node(item, units, known.get(key)) for key, item in sorted(named.items())}
        return Node({"keys": type(numbers[0]).__name__} if numbers else {}, content)
    if isinstance(value, tuple | list) and {*map(type, value)} not in ({float}, {int}):  # others are one array
        content = {f"{k:06d}": make_node(item, units, unit) for k, item in enumerate(value)}
        return Node({"sequence": type(value).__name__}, content)
    if value is None:
        return Node({}, None)
    if isinstance(value, bytes):
        return Node({"sequence": "bytes"}, np.frombuffer(value, np.uint8))
    array = np.asarray(value)
    attrs = {"sequence": type(value).__name__} if isinstance(value, tuple | list) else {}
    if array.dtype.kind in "fc" and unit:
        attrs["units"] = in_units(unit, units)
    return Node(attrs, array)


def trimmed(contacts: Contacts) -> Contacts:
    """Contact list without the unused capacity after its last pair."""
    count = int(contacts.count[0])
    parts = {name: getattr(contacts, name) for name in PER_PAIR}
    return contacts._replace(**{name: part[:count] for name, part in parts.items() if part is not None})


def known_nouns(nouns: Iterable[type]) -> dict[str, type]:
    """Classes that `restore` may build, by name: states and laws, the given ones, and those of their fields."""
    found = {noun.__name__: noun for noun in _NOUNS}
    rest = list(nouns)
    while rest:
        noun = rest.pop()
        if found.setdefault(noun.__name__, noun) is noun and hasattr(noun, "_fields"):
            rest += [inner for inner in _classes_of_fields(noun) if inner.__name__ not in found]
    return found


@cache
def _classes_of_fields(noun: type) -> tuple[type, ...]:
    """NamedTuples and enums in the annotations of a NamedTuple."""

    def within(annotation) -> Iterator[type]:
        if isinstance(annotation, type) and (hasattr(annotation, "_fields") or issubclass(annotation, Enum)):
            yield annotation
        for inner in get_args(annotation):
            yield from within(inner)

    return tuple(inner for annotation in get_type_hints(noun).values() for inner in within(annotation))


def restore(node: Node, known: dict[str, type]):
    """Value of a node; unknown classes become dictionaries and strings."""
    noun = known.get(node.attrs.get("noun", ""))
    if not isinstance(node.content, dict):
        value = _restore_leaf(node)
        return noun[value] if noun else value
    tree = {name: restore(child, known) for name, child in node.content.items()}
    if "sequence" in node.attrs:
        made = list(tree.values())
        return tuple(made) if node.attrs["sequence"] == "tuple" else made
    if "keys" in node.attrs:
        number = {"float": float, "int": int}[node.attrs["keys"]]
        return {number(name): value for name, value in tree.items()}
    if noun is Law and "own" in tree:
        tree["kind"] = _restore_kind(tree["kind"], tree.pop("own"))
    maker = {Contacts: restore_contacts, Bonds: restore_bonds}.get(noun)
    made = maker(tree) if maker else noun(**tree) if noun else tree
    if noun in (State, Law) or (noun and noun not in _NOUNS):  # parts of a state are checked together with it
        check_value(noun.__name__, made, noun)
    return made


def _restore_leaf(node: Node):
    if node.content is None:
        return None
    if "sequence" in node.attrs:
        return {"tuple": tuple, "list": list, "bytes": bytes}[node.attrs["sequence"]](node.content.tolist())
    return node.content if node.content.ndim else node.content.item()


def _restore_kind(kind: int, about: dict) -> Kind:
    try:
        return restore_kind(kind, about)
    except ValueError as problem:
        raise ArchiveError(f"this archive cannot be read: {problem}") from None


def units_within(node: Node, path: str = "") -> dict[str, str]:
    """Units of the arrays in a tree, keyed by path."""
    if not isinstance(node.content, dict):
        return {path: node.attrs["units"]} if "units" in node.attrs else {}
    inner = (units_within(child, f"{path}/{name}" if path else name) for name, child in node.content.items())
    return {name: unit for units in inner for name, unit in units.items()}


def to_bytes(node: Node) -> bytes:
    """Bytes of a tree: an outline in JSON, then the arrays."""
    arrays: list[bytes] = []

    def outline(node: Node):
        if isinstance(node.content, dict):
            return node.attrs, {name: outline(child) for name, child in node.content.items()}
        if node.content is None:
            return node.attrs, None
        if node.content.dtype.kind in "OV":
            raise TypeError(f"arrays of {node.content.dtype} cannot be saved")
        arrays.append(node.content.tobytes())
        return node.attrs, node.content.dtype.str, node.content.shape

    text = json.dumps(outline(node)).encode()
    return b"".join([_LENGTH.pack(len(text)), text, *arrays])


def from_bytes(data: bytes) -> Node:
    """Tree of nodes from its bytes."""
    reader = Reader(data)

    def rebuilt(attrs, content, *shape) -> Node:
        if not shape:
            return Node(attrs, content and {name: rebuilt(*child) for name, child in content.items()})
        return Node(attrs, reader.array(content, math.prod(shape[0])).reshape(shape[0]).copy())

    return rebuilt(*json.loads(reader.take(reader.number(_LENGTH.format))))


def archive_fields(record) -> Fields:
    """Return the fields of a NamedTuple for an archive: None is omitted, and tuples of strings become lines."""
    out = {}
    for name, value in record._asdict().items():
        if value is None:
            continue
        if hasattr(value, "_asdict") and not isinstance(value, State):
            value = Fields(value._asdict(), type(value))
        is_text = isinstance(value, tuple) and all(isinstance(v, str) for v in value)
        out[name] = "\n".join(value) if is_text else value
    return Fields(out, type(record))


def restore_contacts(fields: dict) -> Contacts:
    """Contact list from its fields in a file.

    Up to archive schema 4 and GSD schema 1, skin was an array with the gap as second entry, infinite positions marked a
    stale list, and a law without rolling memory had an array without rows.
    """
    fields = {name: v.item() if isinstance(v, np.ndarray) and not v.ndim else v for name, v in fields.items()}
    if "stale" not in fields:
        skin, finite = np.atleast_1d(fields["skin"]), np.isfinite(fields["origin"])
        fields |= {"skin": float(skin[0]), "gap": float(skin[1:].sum()), "stale": not finite.all()}
        fields["origin"] = np.where(finite, fields["origin"], 0.0)
        if not len(fields.get("rolling", ())):
            fields["rolling"] = None
    return Contacts(**fields)


def restore_bonds(fields: dict) -> Bonds:
    """Bonds from their fields in a file. Files of early versions do not contain the breaking loads."""
    return Bonds(**{"failed": np.zeros(len(fields["i"]), np.int8)} | fields)
