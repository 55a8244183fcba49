"""HDF5 archives: scenario text, versions, and a tree of arrays, strings, states and results.

States, results and nested containers are converted to and from a tree of nodes, which files can store. A node has
attributes and either arrays and strings, or other nodes by name. The attribute `noun` is the class of a NamedTuple or
enum, `sequence` is the class of a tuple or list, and `keys` is the class of the keys of a dictionary. Contact lists
are stored without unused capacity, but with all of their memory.

This is schema 5. The groups, datasets and attributes of a file form this tree. The root has the attributes `schema`,
`stickslip` and `versions` (of the software that computed the data) and `scenario` (canonical text), but no time stamps
or host names. Entries are written in the order of their names, so that the bytes do not depend on whether a part was
computed or read. Large arrays are stored with the filters shuffle and gzip, which every HDF5 library has.

A file is assembled in memory, written to a temporary file and renamed, so an interrupted write or a full disk
leaves the previous file unchanged. The file begins with a block of text that HDF5 skips. This block holds a checksum of
the remaining bytes, because HDF5 itself may hang on a damaged file.
"""

import hashlib
import json
import math
import platform
import struct
import uuid
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import Enum
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import NamedTuple, get_args, get_type_hints

import numpy as np

from .._core import build
from ..core.arguments import check_value
from ..core.laws.builtin import Law
from ..core.laws.kinds import Kind, describe_law, restore_kind
from ..core.reading import Budget, Reader, check_regular_file
from ..core.state import PER_PAIR, Bonds, Cell, Contacts, Control, Grains, Instant, State, Walls
from ..core.text import SentenceError
from ..core.units import Fields, Units, in_units, units_from, units_of
from .run_files import write_atomically

_NOUNS = (State, Grains, Walls, Cell, Contacts, Control, Instant, Bonds, Law)
_LENGTH = struct.Struct("<Q")  # length of the outline of a tree [bytes]


# exceptions raised for damaged files by HDF5, JSON and NumPy, and while objects are rebuilt
_DAMAGE = (OSError, RuntimeError, LookupError, TypeError, ValueError, AttributeError, OverflowError, MemoryError)


class ArchiveError(SentenceError):
    """Raised for a file that cannot be read as an archive; the message is one sentence for the user."""


@contextmanager
def refuse_damage(path, kind: str, remedy: str) -> Iterator[None]:
    """Context in which every error caused by a damaged file becomes an ArchiveError."""
    try:
        yield
    except ArchiveError:
        raise
    except _DAMAGE as problem:
        reason = str(problem).split(" (")[0].lower()
        raise ArchiveError(f"{path} cannot be read as {kind} ({reason}): {remedy}") from None


class Node(NamedTuple):
    """A group of named nodes, or an array; text is stored as an array of strings."""

    attrs: dict[str, str]
    content: "dict[str, Node] | np.ndarray | None"


def make_node(value, units: Units | None = None, unit: str | None = None) -> Node:
    """Node that stores a value; arrays with a known unit have the attribute `units`."""
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
    if isinstance(value, tuple | list) and {*map(type, value)} not in ({float}, {int}):  # else one array of numbers
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
    """Classes that `restore` may build, by name: states, laws, the given classes, and the classes of their fields."""
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
    """Value stored in a node; instances of unknown classes become dictionaries or strings."""
    noun = known.get(node.attrs.get("noun", ""))
    if not isinstance(node.content, dict):
        value = node.content
        if "sequence" in node.attrs and value is not None:
            value = {"tuple": tuple, "list": list, "bytes": bytes}[node.attrs["sequence"]](value.tolist())
        elif value is not None and not value.ndim:
            value = value.item()
        return noun[value] if noun else value
    tree = {name: restore(child, known) for name, child in node.content.items()}
    if "sequence" in node.attrs:
        made = list(tree.values())
        return tuple(made) if node.attrs["sequence"] == "tuple" else made
    if "keys" in node.attrs:
        number = {"float": float, "int": int}[node.attrs["keys"]]
        return {number(name): value for name, value in tree.items()}
    if noun is Law and "own" in tree:
        try:
            tree["kind"] = restore_kind(tree["kind"], tree.pop("own"))
        except ValueError as problem:
            raise ArchiveError(f"this archive cannot be read: {problem}") from None
    made = with_fields(noun, tree) if noun else tree
    if noun in (State, Law) or (noun and noun not in _NOUNS):  # parts of a state are checked together with it
        check_value(noun.__name__, made, noun)
    return made


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
    """Rebuild a tree of nodes from its bytes."""
    reader = Reader(data)

    def rebuilt(attrs, content, *shape) -> Node:
        if not shape:
            return Node(attrs, content and {name: rebuilt(*child) for name, child in content.items()})
        return Node(attrs, reader.array(content, math.prod(shape[0])).reshape(shape[0]).copy())

    return rebuilt(*json.loads(reader.take(reader.number(_LENGTH.format))))


def archive_fields(record) -> Fields:
    """Return the fields of a NamedTuple for an archive, without those that are None; tuples of strings become lines."""
    out = {}
    for name, value in record._asdict().items():
        if value is None:
            continue
        if hasattr(value, "_asdict") and not isinstance(value, State):
            value = Fields(value._asdict(), type(value))
        is_text = isinstance(value, tuple) and all(isinstance(v, str) for v in value)
        out[name] = "\n".join(value) if is_text else value
    return Fields(out, type(record))


def with_fields(noun: type, fields: dict):
    """NamedTuple with the given fields, which may come from a file of an earlier version.

    Up to archive schema 4 and GSD schema 1, the skin of contacts was an array whose second entry was the gap, infinite
    positions marked a stale list, and a law without rolling memory had an array without rows. Early versions did not
    store the loads that broke bonds.
    """
    if noun is Bonds:
        fields = {"failed": np.zeros(len(fields["i"]), np.int8)} | fields
    if noun is Contacts and "stale" not in fields:
        skin, finite = np.atleast_1d(fields["skin"]), np.isfinite(fields["origin"])
        fields |= {"skin": float(skin[0]), "gap": float(skin[1:].sum()), "stale": not finite.all()}
        fields["origin"] = np.where(finite, fields["origin"], 0.0)
        if not len(fields.get("rolling", ())):
            fields["rolling"] = None
    return noun(**fields)


SCHEMA, OLDEST = 5, 4  # schema that is written, and the oldest one that is read
REMEDY = "give the results.h5 of a run"
_BLOCK, _HEADER = 512, b"stickslip archive, SHA-256 of what follows this block:\n"
_VERSIONS = ("numpy", "scipy", "h5py")
_FILTERS = {"compression": "gzip", "shuffle": True}  # filters of datasets with more than 1000 numbers
_LONG, _CHUNK = 2**16, 2**19  # smallest column that is stored in chunks, and largest chunk [bytes]
_SAMPLE, _WORTH = 2048, 0.5  # size of a sample of a plane [bytes], and largest compressed fraction that is worthwhile


def write(path: str | Path, tree: dict, *, scenario: str = "", version: str = "", units: Units | None = None) -> None:
    """Write a tree to an HDF5 file atomically.

    Parameters
    ----------
    tree : nested dictionaries of arrays, numbers, strings, None, and tuples and NamedTuples of these, including states
    scenario : canonical text of the scenario
    version : version of the package that computed the tree
    units : units named in the attribute `units` of datasets; without them, the attribute gives dimensions

    Raises
    ------
    OSError
        If the file cannot be written; an existing file is left unchanged.
    """
    import h5py  # imported on demand, because checkpoints do without it

    path = Path(path)
    memory = {"driver": "core", "backing_store": False, "userblock_size": _BLOCK}
    with h5py.File(uuid.uuid4().hex, "w", **memory) as file:
        file.attrs["schema"], file.attrs["scenario"], file.attrs["stickslip"] = SCHEMA, scenario, version
        file.attrs["versions"] = versions()
        if units is not None:
            file.attrs["units"], file.attrs["dim"] = str(units), units.dim
        for name, node in make_node(tree, units).content.items():
            _store(file, name, node)
        file.flush()
        image = file.id.get_file_image()
    write_atomically(path, _checksum_block(image), image)


def _checksum_block(image: bytes) -> bytes:
    """Block of text with the checksum of the file image that follows it."""
    return _HEADER + hashlib.sha256(image).hexdigest().encode().ljust(_BLOCK - len(_HEADER), b"\n")


@cache
def versions() -> str:
    """Versions of the software that may affect the numbers in results.

    Cached, because looking them up takes as long as a write.
    """
    from importlib.metadata import version

    python, core = f"python {platform.python_version()}", f"core for {build.best_level()}"
    return ", ".join([python, *(f"{name} {version(name)}" for name in _VERSIONS), core])


def read(path: str | Path, *, nouns: Iterable[type] = (), remedy: str = REMEDY) -> dict:
    """Read the tree that `write` stored; states are returned as `State`.

    Parameters
    ----------
    nouns : classes of other NamedTuples and enums to restore; all others are returned as dictionaries and strings
    remedy : advice if the file is not an archive, such as the inputs that the caller accepts

    Raises
    ------
    ArchiveError
        If the file is not an archive, is truncated, or has a schema that this version does not read.
    """
    known = known_nouns(nouns)
    with _open(path, remedy) as file:
        budget = Budget(path, file.id.get_filesize(), remedy=remedy, error=ArchiveError)
        return {name: restore(_read_node(item, budget), known) for name, item in file.items()}


def units(path: str | Path) -> dict[str, str]:
    """Units of the datasets of an archive, keyed by path; errors are those of `read`."""
    unit_of = {}
    with _open(path) as file:
        file.visititems(lambda name, item: unit_of.update({name: item.attrs["units"]} if "units" in item.attrs else {}))
    return unit_of


def named_units(path: str | Path) -> Units | None:
    """Units passed to `write`; None if the file does not name any. Errors are those of `read`."""
    with _open(path) as file:
        return units_from(file.attrs["units"], int(file.attrs["dim"])) if "units" in file.attrs else None


def attributes(path: str | Path) -> dict[str, str]:
    """Attributes `scenario`, `stickslip` (version) and `versions` of an archive; errors as in `read`."""
    with _open(path) as file:
        return {name: str(file.attrs.get(name, "")) for name in ("scenario", "stickslip", "versions")}


@contextmanager
def _open(path, remedy: str = REMEDY):
    import h5py

    with refuse_damage(path, "an archive", remedy):
        check_regular_file(path, remedy)
        with open(path, "rb") as content:
            block = content.read(_BLOCK)
            if not block.startswith(_HEADER):
                raise ArchiveError(f"{path} is not a stickslip archive: {remedy}")
            digest = hashlib.file_digest(content, "sha256").hexdigest().encode()
        if block[len(_HEADER) :].strip() != digest:
            raise ArchiveError(
                f"{path} is damaged or was modified (its checksum does not match): restore a copy, or repeat the run"
            )
        with h5py.File(path) as file:
            if not OLDEST <= (schema := file.attrs.get("schema")) <= SCHEMA:
                remedy = "install a later stickslip" if schema > SCHEMA else "run it again"
                raise ArchiveError(
                    f"{path} has archive schema {schema}, but this version reads schemas {OLDEST} to {SCHEMA}: {remedy}"
                )
            yield file


def _store(group, name: str, node: Node) -> None:
    is_group = isinstance(node.content, dict)
    made = group.create_group(name) if is_group else _store_array(group, name, node.content)
    for key, text in node.attrs.items():
        made.attrs[key] = text
    for key, child in node.content.items() if is_group else ():
        _store(made, key, child)


def _store_array(group, name: str, array: np.ndarray | None):
    import h5py

    if array is None:
        return group.create_dataset(name, data=h5py.Empty("f8"))
    if array.dtype.kind == "U":
        return group.create_dataset(name, data=array.astype(object), dtype=h5py.string_dtype())
    if array.dtype.kind not in "biufc" or not array.ndim or len(array) * array.itemsize < _LONG:
        return group.create_dataset(name, data=array, **(_FILTERS if array.size > 1000 else {}))
    # chunks of one column each, such as one component of a vector; chunks of zeros take no space
    pieces = -(-len(array) * array.itemsize // _CHUNK)
    rows = -(-len(array) // pieces)
    chunks = (rows, *(1,) * (array.ndim - 1))
    made = group.create_dataset(name, array.shape, array.dtype, chunks=chunks, **_FILTERS)
    for column in np.ndindex(array.shape[1:]):
        for start in range(0, len(array), rows):
            part = np.zeros(rows, array.dtype)  # the last chunk of a column is stored in full
            some = array[(slice(start, start + rows), *column)]
            part[: len(some)] = some
            planes = np.ascontiguousarray(part.view(np.uint8).reshape(rows, -1).T)
            if planes.any():
                made.id.write_direct_chunk((start, *column), _compress_planes(planes))
    return made


def _compress_planes(planes: np.ndarray) -> bytes:
    """Compress shuffled bytes as HDF5's filter gzip does, in a quarter of the time.

    A plane holds the bytes of equal significance of all numbers. Planes that hardly shrink, such as those of the last
    digits, are stored uncompressed, because they would take most of the time.
    """
    stream = [b"\x78\x01"]
    for worth, alike in groupby(planes, _is_compressible):
        packer = _packer(level=int(worth))
        stream += [*map(packer.compress, alike), packer.flush(zlib.Z_FULL_FLUSH)]
    end = b"\x03\x00"  # an empty last block
    return b"".join([*stream, end, zlib.adler32(planes).to_bytes(4, "big")])


def _is_compressible(plane: np.ndarray) -> bool:
    """Return True if compression makes a sample from the middle of a plane small enough."""
    start = max(0, (len(plane) - _SAMPLE) // 2)
    sample, packer = plane[start : start + _SAMPLE], _packer(level=1)
    return len(packer.compress(sample) + packer.flush()) <= _WORTH * len(sample)


def _packer(level: int):
    """Fast compressor for part of a zlib stream, which finds only repeated bytes; level 0 stores them uncompressed."""
    return zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)


def _read_node(item, budget: Budget) -> Node:
    import h5py

    attrs = dict(item.attrs)
    if not isinstance(item, h5py.Dataset):
        return Node(attrs, {name: _read_node(child, budget) for name, child in item.items()})
    budget.take(item.nbytes, item.name)
    value = item[()]
    if isinstance(value, h5py.Empty):
        return Node(attrs, None)
    if h5py.check_string_dtype(item.dtype) is not None:
        texts = value.decode() if isinstance(value, bytes) else [v.decode() for v in value.ravel()]
        return Node(attrs, np.array(texts, str))
    return Node(attrs, np.asarray(value))
