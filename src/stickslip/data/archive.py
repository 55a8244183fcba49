"""HDF5 archives: scenario text, versions, and a tree of arrays, strings, states and results.

Schema 5. Groups, datasets and their attributes are the tree of nodes that `nodes` describes. The root has the
attributes `schema`, `stickslip` and `versions` (of the software that computed the data) and `scenario` (canonical
text), but no time stamps or host names. Entries are written in order of name, so that the bytes do not depend on
whether a part was computed or read. Large arrays are stored with the filters shuffle and gzip, which every HDF5
library has.

A file is assembled in memory, written to a temporary file and renamed, so an interrupted write or a full disk
leaves the previous file unchanged. It begins with a block of text that HDF5 skips and that holds a checksum of the
rest, because HDF5 itself may hang on a damaged file.
"""

import hashlib
import platform
import uuid
import zlib
from collections.abc import Iterable
from contextlib import contextmanager
from functools import cache
from itertools import groupby
from pathlib import Path

import h5py
import numpy as np

from .._core import build
from ..core.reading import Budget, check_regular_file
from ..core.units import Units, units_from
from .nodes import ArchiveError, Node, known_nouns, make_node, refuse_damage, restore
from .run_files import write_atomically

SCHEMA, OLDEST = 5, 4  # schema that is written, and the oldest one that is read
REMEDY = "give the results.h5 of a run"
_BLOCK, _HEADER = 512, b"stickslip archive, SHA-256 of what follows this block:\n"
_VERSIONS = ("numpy", "scipy", "h5py")
_FILTERS = {"compression": "gzip", "shuffle": True}  # filters of datasets with more than 1000 numbers
_LONG, _CHUNK = 2**16, 2**19  # smallest size of a column that has separate chunks, and largest size of a chunk [bytes]
_SAMPLE, _WORTH = (
    2048,
    0.5,
)  # size of the sample of a plane [bytes], and the largest ratio at which compression is worthwhile


def write(path: str | Path, tree: dict, *, scenario: str = "", version: str = "", units: Units | None = None) -> None:
    """Write a tree to an HDF5 file atomically.

    Parameters
    ----------
    tree : nested dictionaries of arrays, numbers, strings, None, and tuples and NamedTuples of these, including states
    scenario : canonical text
    version : of the package that computed it
    units : units named in the attribute `units` of datasets; without them, the attribute gives dimensions

    Raises
    ------
    OSError
        If the file cannot be written; an existing file is left unchanged.
    """
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
    """Versions of the software on which numbers may depend.

    Cached, because looking them up takes as long as a write.
    """
    from importlib.metadata import version

    python, core = f"python {platform.python_version()}", f"core for {build.best_level()}"
    return ", ".join([python, *(f"{name} {version(name)}" for name in _VERSIONS), core])


def read(path: str | Path, *, nouns: Iterable[type] = (), remedy: str = REMEDY) -> dict:
    """Read the tree that `write` stored; states are returned as `State`.

    Parameters
    ----------
    nouns : classes of other NamedTuples and enums to restore; those not given are returned as dictionaries and strings
    remedy : advice if the file is not an archive: the inputs that the caller accepts

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
    """Units of the datasets of an archive, keyed by path; errors as in `read`."""
    unit_of = {}
    with _open(path) as file:
        file.visititems(lambda name, item: unit_of.update({name: item.attrs["units"]} if "units" in item.attrs else {}))
    return unit_of


def named_units(path: str | Path) -> Units | None:
    """Units passed to `write`; None if they are not named. Errors as in `read`."""
    with _open(path) as file:
        return units_from(file.attrs["units"], int(file.attrs["dim"])) if "units" in file.attrs else None


def attributes(path: str | Path) -> dict[str, str]:
    """Attributes `scenario`, `stickslip` (version) and `versions` of an archive; errors as in `read`."""
    with _open(path) as file:
        return {name: str(file.attrs.get(name, "")) for name in ("scenario", "stickslip", "versions")}


@contextmanager
def _open(path, remedy: str = REMEDY):
    with refuse_damage(path, "an archive", remedy):
        _check_checksum(path, remedy)
        with h5py.File(path) as file:
            if not OLDEST <= (schema := file.attrs.get("schema")) <= SCHEMA:
                remedy = "install a later stickslip" if schema > SCHEMA else "run it again"
                raise ArchiveError(
                    f"{path} has archive schema {schema}, but this version reads schemas {OLDEST} to {SCHEMA}: {remedy}"
                )
            yield file


def _check_checksum(path, remedy: str) -> None:
    check_regular_file(path, remedy)
    with open(path, "rb") as file:
        block = file.read(_BLOCK)
        if not block.startswith(_HEADER):
            raise ArchiveError(f"{path} is not a stickslip archive: {remedy}")
        digest = hashlib.file_digest(file, "sha256").hexdigest().encode()
    if block[len(_HEADER) :].strip() != digest:
        raise ArchiveError(
            f"{path} is damaged or was modified (its checksum does not match): restore a copy, or run it again"
        )


def _store(group, name: str, node: Node) -> None:
    is_group = isinstance(node.content, dict)
    made = group.create_group(name) if is_group else _store_array(group, name, node.content)
    for key, text in node.attrs.items():
        made.attrs[key] = text
    for key, child in node.content.items() if is_group else ():
        _store(made, key, child)


def _store_array(group, name: str, array: np.ndarray | None) -> h5py.Dataset:
    if array is None:
        return group.create_dataset(name, data=h5py.Empty("f8"))
    if array.dtype.kind == "U":
        return group.create_dataset(name, data=array.astype(object), dtype=h5py.string_dtype())
    if array.dtype.kind in "biufc" and array.ndim and len(array) * array.itemsize >= _LONG:
        return _store_columns(group, name, array)
    return group.create_dataset(name, data=array, **(_FILTERS if array.size > 1000 else {}))


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
    digits, are stored uncompressed, because they would take most of the time.
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


def _read_node(item, budget: Budget) -> Node:
    attrs = dict(item.attrs)
    if isinstance(item, h5py.Dataset):
        return Node(attrs, _read_array(item, budget))
    return Node(attrs, {name: _read_node(child, budget) for name, child in item.items()})


def _read_array(item: h5py.Dataset, budget: Budget) -> np.ndarray | None:
    budget.take(item.nbytes, item.name)
    value = item[()]
    if isinstance(value, h5py.Empty):
        return None
    if h5py.check_string_dtype(item.dtype) is not None:
        return np.array(value.decode() if isinstance(value, bytes) else [v.decode() for v in value.ravel()], str)
    return np.asarray(value)
