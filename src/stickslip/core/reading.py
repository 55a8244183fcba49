"""Bounded reading of foreign files: declared sizes are compared with the size of the file before memory is allocated.

`read_bytes` opens a file, a `Budget` counts the memory of its decompressed content, and a `Reader` returns bytes in
order, so that lengths stated in a file can only move the position forwards, within the file. MATLAB files up to version
7 are checked before SciPy reads them, because wrong lengths may crash SciPy.

Source: MathWorks, MAT-File Format, level 5: a header of 128 bytes, then elements, each with a type, a length and data.
"""

import math
import os
import struct
import zlib
from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path
from typing import BinaryIO
from zipfile import ZipFile

import numpy as np

LARGEST_FILE = 2**33  # [bytes]
LARGE, EXPANDS = 2**26, 100  # content allowed for any file [bytes], and largest multiple of the file size
NPY = b"\x93NUMPY"
_PIECE = 2**20  # bytes read at a time


def read_bytes(path: str | Path, *, remedy: str, size: int = -1) -> bytes:
    """Read a regular file, or its first `size` bytes.

    Raises
    ------
    ValueError
        If the file is a device or a pipe, or larger than 8 GiB.
    OSError
        If the file cannot be read.
    """
    check_regular_file(path, remedy)
    with open(path, "rb") as file:
        stored = os.fstat(file.fileno()).st_size
        if size < 0 and stored > LARGEST_FILE:
            raise ValueError(f"{path} has {stored / 1e9:.3g} GB: at most {LARGEST_FILE / 1e9:.3g} are read; {remedy}")
        return file.read(size)


def check_regular_file(path: str | Path, remedy: str) -> None:
    """Raise ValueError for a device or a pipe, which could be read forever."""
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError(f"{path} is a device or a pipe, which may never end: {remedy}")


def read_arrays(path: str | Path, *, remedy: str, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Arrays of an .npz file by name, all or selected ones; the array of an .npy file has the name "".

    Raises
    ------
    Exception
        Any exception of NumPy, zipfile, zlib or this module, if the file is damaged or lacks one of the names.
    """
    content = read_bytes(path, remedy=remedy)
    budget = Budget(path, len(content), remedy=remedy)
    if content.startswith(NPY):
        return {"": _array_of(content)}
    with ZipFile(BytesIO(content)) as packed:
        members = {name.removesuffix(".npy"): name for name in packed.namelist()}
        arrays = {}
        for name in members if names is None else names:
            budget.take(packed.getinfo(members[name]).file_size, name)  # zipfile reads no more than this
            arrays[name] = _array_of(packed.read(members[name]))
        return arrays


def _array_of(content: bytes) -> np.ndarray:
    """Array of an .npy file; raises ValueError, before allocating memory, if the file declares too many numbers."""
    file = BytesIO(content)
    first, _ = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if first == 1 else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    if math.prod(shape) * dtype.itemsize > len(content) - file.tell():
        raise ValueError(f"an array of shape {shape} is declared, but {len(content) - file.tell()} bytes follow")
    file.seek(0)
    return np.load(file, allow_pickle=False)


class Budget:
    """Memory that the content of a file may still take [bytes]: at first 100 times the file size, at least 64 MiB."""

    def __init__(self, path: str | Path, stored: int, *, remedy: str, error: Callable[[str], Exception] = ValueError):
        self.path, self.stored, self.remedy, self.error = path, stored, remedy, error
        self.left = self.most = max(LARGE, EXPANDS * stored)

    def take(self, size: int, what: str = "content") -> None:
        """Count bytes that are about to be allocated; raise `error` if there are too many."""
        if not 0 <= size <= self.left:
            raise self.error(
                f"{self.path} has {self.stored / 1e6:.3g} MB, but up to its {what} it would need more than "
                f"{self.most / 1e6:.3g} MB, 100 times the file size or 64 MiB: it is damaged; {self.remedy}"
            )
        self.left -= size

    def expand(self, file: BinaryIO, what: str = "content") -> bytes:
        """Read an open file with decompression."""
        pieces = []
        while piece := file.read(_PIECE):
            self.take(len(piece), what)
            pieces.append(piece)
        return b"".join(pieces)


class Reader:
    """Reader that only moves forwards in a byte string; raises ValueError, with a short message, at its end."""

    def __init__(self, content: bytes, at: int = 0):
        self.content, self.at = content, 0
        self._skip(at)

    @property
    def left(self) -> int:
        """Number of bytes that follow."""
        return len(self.content) - self.at

    def take(self, size: int) -> bytes:
        """The next bytes."""
        return self.content[self._skip(size) : self.at]

    def array(self, dtype: np.dtype | str, count: int) -> np.ndarray:
        """The next numbers, as a view."""
        dtype = np.dtype(dtype)
        return np.frombuffer(self.content, dtype, count, self._skip(count * dtype.itemsize))

    def number(self, form: str):
        """The next number, in a format of `struct`."""
        return struct.unpack_from(form, self.content, self._skip(struct.calcsize(form)))[0]

    def line(self) -> bytes:
        """The next line, without its end; empty at the end of the content."""
        end = self.content.find(b"\n", self.at)
        start, self.at = self.at, len(self.content) if end < 0 else end + 1
        return self.content[start : self.at].rstrip(b"\n")

    def _skip(self, size: int) -> int:
        if not 0 <= size <= self.left:
            raise ValueError(f"{size} bytes are declared, but {max(self.left, 0)} follow")
        start, self.at = self.at, self.at + size
        return start


MATRIX, COMPRESSED = 14, 15  # types of elements that contain others
WIDTHS = {
    1: 1,
    2: 1,
    3: 2,
    4: 2,
    5: 4,
    6: 4,
    7: 4,
    9: 8,
    12: 8,
    13: 8,
    16: 1,
    17: 2,
    18: 4,
}  # bytes per number, by type
CELL, STRUCT, OBJECT, CHAR, SPARSE, OTHER = 1, 2, 3, 4, 5, 16  # classes of arrays; from OTHER on, functions and others
TEXT, DEEPEST = (1, 2, 16), 20  # types of elements with names; largest depth of arrays within arrays


def check_matlab(content: bytes, budget: Budget) -> None:
    """Raise ValueError, with a short message, if lengths in a file are inconsistent or would need too much memory."""
    order = "<" if Reader(content, 126).take(2) == b"IM" else ">"
    reader = Reader(content, 128)
    while reader.left >= 8:
        kind, data = _element(reader, order)
        if kind == COMPRESSED:
            inner = zlib.decompressobj().decompress(data, budget.left + 1)
            budget.take(len(inner))
            kind, data = _element(Reader(inner), order)
        if kind == MATRIX:
            _check_array(data, order, budget, 0)


def _element(reader: Reader, order: str) -> tuple[int, bytes]:
    """Type and data of the next element; a short element stores both in eight bytes."""
    word = reader.number(f"{order}I")
    if word >> 16:
        size, kind = word >> 16, word & 0xFFFF
        if size > 4:
            raise ValueError(f"a short element of {size} bytes")
        return kind, reader.take(4)[:size]
    size = reader.number(f"{order}I")
    data = reader.take(size)
    if word != COMPRESSED:
        reader.take(min(-size % 8, reader.left))
    return word, data


def _check_array(data: bytes, order: str, budget: Budget, depth: int) -> None:
    """Check an array with all that it contains."""
    if not data:
        return
    if depth > DEEPEST:
        raise ValueError(f"arrays within arrays, more than {DEEPEST} deep")
    reader = Reader(data)
    flags = np.frombuffer(_numbers(reader, order, 6), f"{order}u4")
    if len(flags) != 2:
        raise ValueError("an array without flags")
    kind = int(flags[0]) & 0xFF
    if kind >= OTHER:
        while reader.left >= 8:
            inner, part = _element(reader, order)
            if inner == MATRIX:
                _check_array(part, order, budget, depth + 1)
        return
    sizes = np.frombuffer(_numbers(reader, order, 5), f"{order}i4").tolist()
    if len(sizes) < 2 or min(sizes) < 0 or kind == SPARSE:
        raise ValueError(f"an array of shape {tuple(sizes)} and class {kind}")
    count = math.prod(sizes)
    budget.take(8 * count)
    _numbers(reader, order, *TEXT)  # name of the array
    if kind in (CELL, STRUCT, OBJECT):
        _check_parts(reader, order, budget, depth, kind, count)
        return
    for _ in range(2 if int(flags[0]) & 0x800 else 1):  # real and imaginary parts
        type_, part = _element(reader, order)
        fits = len(part) >= count if kind == CHAR else len(part) == count * WIDTHS.get(type_, 0)
        if type_ not in WIDTHS or (count and not fits):
            raise ValueError(f"{count} numbers of type {type_} in {len(part)} bytes")


def _check_parts(reader: Reader, order: str, budget: Budget, depth: int, kind: int, count: int) -> None:
    """Check the arrays in a cell array, or in the fields of structures."""
    fields = 1
    if kind == OBJECT:
        _numbers(reader, order, *TEXT)  # name of the class
    if kind != CELL:
        (length,) = np.frombuffer(_numbers(reader, order, 5), f"{order}i4").tolist()
        names = _numbers(reader, order, *TEXT)
        if length < 1 or len(names) % length:
            raise ValueError(f"names of fields in {len(names)} bytes of {length} each")
        fields = len(names) // length
    if count * fields > reader.left:
        raise ValueError(f"{count * fields} arrays in {reader.left} bytes")
    for _ in range(count * fields):
        inner, part = _element(reader, order)
        if inner != MATRIX:
            raise ValueError(f"an element of type {inner} instead of an array")
        _check_array(part, order, budget, depth + 1)


def _numbers(reader: Reader, order: str, *kinds: int) -> bytes:
    """Data of the next element, which must be one of the given types."""
    got, data = _element(reader, order)
    if got not in kinds or len(data) % WIDTHS[got]:
        raise ValueError(f"an element of type {got} with {len(data)} bytes instead of type {kinds[0]}")
    return data
