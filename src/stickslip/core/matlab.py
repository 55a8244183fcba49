"""MATLAB files up to version 7, checked before SciPy reads them: it trusts their lengths, and wrong ones may crash it.

Source: MathWorks, MAT-File Format, level 5: a header of 128 bytes, then elements, each with a type, a length and data.
"""

import math
import zlib

import numpy as np

from .reading import Budget, Reader

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
}  # bytes of numbers, by type
CELL, STRUCT, OBJECT, CHAR, SPARSE, OTHER = 1, 2, 3, 4, 5, 16  # classes of arrays; from OTHER on, functions and others
TEXT, DEEPEST = (1, 2, 16), 20  # types of names; arrays within arrays


def check_matlab(content: bytes, budget: Budget) -> None:
    """Raise ValueError, in a few words, if lengths in a file do not fit together, or would take too much memory."""
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
    """Type and data of the next element; short ones have both in one word."""
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
    _numbers(reader, order, *TEXT)  # its name
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
            raise ValueError(f"an element of type {inner} where an array is needed")
        _check_array(part, order, budget, depth + 1)


def _numbers(reader: Reader, order: str, *kinds: int) -> bytes:
    """Data of the next element, which must be of one of some types."""
    got, data = _element(reader, order)
    if got not in kinds or len(data) % WIDTHS[got]:
        raise ValueError(f"an element of type {got} with {len(data)} bytes where type {kinds[0]} is needed")
    return data
