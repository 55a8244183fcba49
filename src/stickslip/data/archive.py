"""HDF5 archives: scenario text, versions, and a tree of arrays, strings, states and results.

Schema 5. Groups and datasets mirror nested dictionaries, tuples and NamedTuples; a group that stores a NamedTuple has
its class name in the attribute `noun`. The root has the attributes `schema`, `stickslip` and `versions` (of the
software that computed the data) and `scenario` (canonical text), but no time stamps or host names. Entries are written
in order of name, so that the bytes do not depend on whether a part was computed or read. Contact lists are
stored without unused capacity, but with all of their memory. Datasets have the attribute `units` if the unit is known.
Large arrays are stored with the filters shuffle and gzip, which every HDF5 library has.

A file is assembled in memory, written to a temporary file and renamed, so that an interrupted write or a full disk
leaves the previous file unchanged. It begins with a block of text that HDF5 skips and that holds a checksum of the
rest, because HDF5 itself may hang on a damaged file.
"""

import hashlib
import platform
import uuid
import zlib
from collections.abc import Iterable
from contextlib import contextmanager
from enum import Enum
from functools import cache
from itertools import groupby
from pathlib import Path

import h5py
import numpy as np

from ..core.laws.builtin import Law
from ..core.laws.kinds import Kind, describe_law, restore_kind
from ..core.state import PER_PAIR, Cell, Contacts, Control, Grains, Instant, State, Walls
from ..core.text import SentenceError, check_regular_file
from ..core.units import Fields, Units, in_units, units_from, units_of
from .atomic import write_atomically
from .older_contacts import restore_contacts

SCHEMA, OLDEST = 5, 4  # written, and the oldest that is read
_BLOCK, _HEADER = 512, b"stickslip archive, SHA-256 of what follows this block:\n"
_NOUNS = (State, Grains, Walls, Cell, Contacts, Control, Instant, Law)
_VERSIONS = ("numpy", "numba", "scipy", "h5py")
LARGE, EXPANDS = 2**26, 100  # size of an array that is always accepted [bytes], and largest multiple of the file size
_FILTERS = {"compression": "gzip", "shuffle": True}  # of datasets with more than 1000 numbers
_LONG, _CHUNK = 2**16, 2**19  # least size of a column that has chunks of its own, and largest size of these [bytes]
_SAMPLE, _WORTH = 2048, 0.5  # part of a plane that is compressed as a trial [bytes], and largest ratio that counts
# exceptions raised by HDF5, and when objects are rebuilt, for damaged files
_DAMAGE = (OSError, RuntimeError, LookupError, TypeError, ValueError, AttributeError, OverflowError, MemoryError)


class ArchiveError(SentenceError):
    """Raised for a file that cannot be read as an archive; the message is one sentence for the user."""


def write(path: str | Path, tree: dict, *, scenario: str = "", version: str = "", units: Units | None = None) -> None:
    """Write a tree to an HDF5 file, all or nothing.

    Parameters
    ----------
    tree : nested dictionaries of arrays, numbers, strings, None, and tuples and NamedTuples of these, including states
    scenario : canonical text
    version : of the package that computed it
    units : named in the attribute `units` of datasets; without them, it gives dimensions

    Raises
    ------
    OSError
        if the file cannot be written; an existing file is left unchanged.
    """
    path = Path(path)
    memory = {"driver": "core", "backing_store": False, "userblock_size": _BLOCK}
    with h5py.File(uuid.uuid4().hex, "w", **memory) as file:
        file.attrs["schema"], file.attrs["scenario"], file.attrs["stickslip"] = SCHEMA, scenario, version
        file.attrs["versions"] = versions()
        if units is not None:
            file.attrs["units"], file.attrs["dim"] = str(units), units.dim
        known = tree.units if isinstance(tree, Fields) else {}
        for name, value in sorted(tree.items()):
            _store(file, name, value, units, known.get(name))
        file.flush()
        image = file.id.get_file_image()
    write_atomically(path, _checksum_block(image), image)


def _checksum_block(image: bytes) -> bytes:
    """Block of text with the checksum of the file image that follows it."""
    return _HEADER + hashlib.sha256(image).hexdigest().encode().ljust(_BLOCK - len(_HEADER), b"\n")


@cache
def versions() -> str:
    """Versions of the software on which numbers may depend.

    Cached, because looking them up takes as long as a write.
    """
    from importlib.metadata import version

    return ", ".join([f"python {platform.python_version()}", *(f"{name} {version(name)}" for name in _VERSIONS)])


def read(path: str | Path, *, nouns: Iterable[type] = ()) -> dict:
    """Read the tree that `write` stored; states are returned as `State`.

    Parameters
    ----------
    nouns : classes of other NamedTuples and enums to restore; those not given are returned as dictionaries and strings

    Raises
    ------
    ArchiveError
        if the file is not an archive, is truncated, or has a schema that this version does not read.
    """
    known = {noun.__name__: noun for noun in (*_NOUNS, *nouns)}
    with _open(path) as file:
        return {name: _load(value, known) for name, value in file.items()}


def units(path: str | Path) -> dict[str, str]:
    """Units of the datasets of an archive, keyed by path; errors as in `read`."""
    found = {}
    with _open(path) as file:
        file.visititems(lambda name, item: found.update({name: item.attrs["units"]} if "units" in item.attrs else {}))
    return found


def named_units(path: str | Path) -> Units | None:
    """Units that `write` was given; None if they are not named. Errors as in `read`."""
    with _open(path) as file:
        return units_from(file.attrs["units"], int(file.attrs["dim"])) if "units" in file.attrs else None


def attributes(path: str | Path) -> dict[str, str]:
    """Attributes `scenario`, `stickslip` (version) and `versions` of an archive; errors as in `read`."""
    with _open(path) as file:
        return {name: str(file.attrs.get(name, "")) for name in ("scenario", "stickslip", "versions")}


@contextmanager
def _open(path):
    try:
        _check_checksum(path)
        with h5py.File(path) as file:
            _check_schema(path, file.attrs.get("schema"))
            yield file
    except ArchiveError:
        raise
    except _DAMAGE as problem:
        words = str(problem).split(" (")[0].lower()
        raise ArchiveError(f"{path} cannot be read as an archive ({words}): give the results.h5 of a run") from None


def _check_checksum(path) -> None:
    check_regular_file(path, "give the results.h5 of a run")
    with open(path, "rb") as file:
        block = file.read(_BLOCK)
        if not block.startswith(_HEADER):
            raise ArchiveError(f"{path} is not an archive: give the results.h5 of a run")
        digest = hashlib.file_digest(file, "sha256").hexdigest().encode()
    if block[len(_HEADER) :].strip() != digest:
        raise ArchiveError(
            f"{path} is damaged or was modified (its checksum does not match): restore a copy, or run it again"
        )


def _check_schema(path, schema) -> None:
    if not OLDEST <= schema <= SCHEMA:
        remedy = "install a later stickslip" if schema > SCHEMA else "run it again"
        raise ArchiveError(
            f"{path} has archive schema {schema}, but this version reads schemas {OLDEST} to {SCHEMA}: {remedy}"
        )


def _store(group, name: str, value, units: Units | None, unit: str | None = None) -> None:
    if isinstance(value, Contacts):
        value = trimmed(value)
    if isinstance(value, Enum):
        group[name] = value.name
        group[name].attrs["noun"] = type(value).__name__
        return
    if hasattr(value, "_asdict"):
        child = group.create_group(name)
        child.attrs["noun"] = type(value).__name__
        known = units_of(type(value))
        for key, item in sorted(value._asdict().items()):
            _store(child, key, item, units, known.get(key))
        if isinstance(value, Law) and isinstance(value.kind, Kind):
            _store(child, "own", describe_law(value), units)
    elif isinstance(value, dict):
        child = group.create_group(name)
        numbers = [key for key in value if not isinstance(key, str)]
        if numbers:
            child.attrs["keys"] = type(numbers[0]).__name__
        named = {key if isinstance(key, str) else repr(key): item for key, item in value.items()}
        known = value.units if isinstance(value, Fields) else dict.fromkeys(named, unit)
        for key, item in sorted(named.items()):
            _store(child, key, item, units, known.get(key))
    elif isinstance(value, tuple | list) and not _is_homogeneous(value):
        child = group.create_group(name)
        child.attrs["sequence"] = type(value).__name__
        for k, item in enumerate(value):
            _store(child, f"{k:06d}", item, units, unit)
    else:
        _store_array(group, name, value, units, unit)


def _store_array(group, name: str, value, units: Units | None, unit: str | None) -> None:
    if value is None:
        group.create_dataset(name, data=h5py.Empty("f8"))
        return
    if isinstance(value, bytes):
        group.create_dataset(name, data=np.frombuffer(value, np.uint8)).attrs["sequence"] = "bytes"
        return
    array = np.asarray(value)
    if array.dtype.kind == "U":
        array = np.asarray(value, dtype=h5py.string_dtype())
    if array.dtype.kind in "biufc" and array.ndim and len(array) * array.itemsize >= _LONG:
        made = _store_columns(group, name, array)
    else:
        filters = _FILTERS if array.size > 1000 and array.dtype.kind != "O" else {}
        made = group.create_dataset(name, data=array, **filters)
    if isinstance(value, tuple | list):
        made.attrs["sequence"] = type(value).__name__
    if array.dtype.kind in "fc" and unit:
        made.attrs["units"] = in_units(unit, units)


def _store_columns(group, name: str, array: np.ndarray) -> h5py.Dataset:
    """Store an array in chunks of one column each, such as one component of a vector; chunks of zeros take no space."""
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
    digits, are stored as they are: most of the time would be spent on them.
    """
    stream = [b"\x78\x01"]
    for worth, alike in groupby(planes, _is_compressible):
        packer = _packer(level=int(worth))
        stream += [*map(packer.compress, alike), packer.flush(zlib.Z_FULL_FLUSH)]
    end = b"\x03\x00"  # an empty last block
    return b"".join([*stream, end, zlib.adler32(planes).to_bytes(4, "big")])


def _is_compressible(plane: np.ndarray) -> bool:
    """Return True if a sample of a plane, from its middle, shrinks enough."""
    start = max(0, (len(plane) - _SAMPLE) // 2)
    sample, packer = plane[start : start + _SAMPLE], _packer(level=1)
    return len(packer.compress(sample) + packer.flush()) <= _WORTH * len(sample)


def _packer(level: int):
    """Compressor for a part of a zlib stream; level 0 stores. It looks for runs only, which is fast."""
    return zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)


def _is_homogeneous(value) -> bool:
    """Return True if a sequence can be stored as one array: all floats, or all integers."""
    return bool(value) and any(all(type(v) is kind for v in value) for kind in (float, int))


def trimmed(contacts: Contacts) -> Contacts:
    """Contact list without the unused capacity after its last pair."""
    count = int(contacts.count[0])
    parts = {name: getattr(contacts, name) for name in PER_PAIR}
    return contacts._replace(**{name: part[:count] for name, part in parts.items() if part is not None})


def _load(item, known: dict):
    if isinstance(item, h5py.Dataset):
        value, noun = _load_array(item), known.get(item.attrs.get("noun"))
        return noun[value] if noun else value
    tree = {name: _load(child, known) for name, child in item.items()}
    if "sequence" in item.attrs:
        made = list(tree.values())
        return tuple(made) if item.attrs["sequence"] == "tuple" else made
    if "keys" in item.attrs:
        number = {"float": float, "int": int}[item.attrs["keys"]]
        return {number(name): value for name, value in tree.items()}
    noun = known.get(item.attrs.get("noun"))
    if noun is Law and "own" in tree:
        tree["kind"] = _load_kind(tree["kind"], tree.pop("own"))
    made = restore_contacts(tree) if noun is Contacts else noun(**tree) if noun else tree
    if noun in (State, Law):
        made.check_entries()
    return made


def _load_kind(kind: int, about: dict) -> Kind:
    try:
        return restore_kind(kind, about)
    except ValueError as problem:
        raise ArchiveError(f"this archive cannot be read: {problem}") from None


def _load_array(item: h5py.Dataset):
    stored = item.file.id.get_filesize()
    if item.nbytes > max(LARGE, EXPANDS * stored):
        raise ArchiveError(
            f"{item.file.filename} holds {stored / 1e6:.3g} MB, but its {item.name} claims {item.nbytes / 1e9:.3g} GB: "
            f"no run writes such a file; give the results.h5 of a run"
        )
    value = item[()]
    if isinstance(value, h5py.Empty):
        return None
    if h5py.check_string_dtype(item.dtype) is not None:
        return value.decode() if isinstance(value, bytes) else np.array([v.decode() for v in value.ravel()], str)
    if "sequence" in item.attrs:
        return {"tuple": tuple, "list": list, "bytes": bytes}[item.attrs["sequence"]](value.tolist())
    return value.item() if np.ndim(value) == 0 else value
