"""Points and point data of VTK files in XML: .vtu and .vtp, as ParaView, YADE and VTK itself write them.

Source: Kitware, VTK XML file formats, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html.
"""

import re
import zlib
from base64 import b64decode
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from ...core.text import parse_numbers
from .content import MOST_EXPANDED

MARK, END = b"<VTKFile", b"</VTKFile>"
TYPES = {f"{kind}{8 * size}": f"{kind[0].lower()}{size}" for kind in ("Int", "UInt") for size in (1, 2, 4, 8)}
TYPES |= {"Float32": "f4", "Float64": "f8"}


class _Source(NamedTuple):
    """Encoded bytes of arrays, and how the file says that they are encoded."""

    content: bytes
    base64: bool
    header: np.dtype  # of the numbers of bytes that precede data
    order: str  # of bytes, < or >
    packed: bool  # by zlib
    most: int  # bytes that an array may have

    def take(self, at: int, count: int) -> tuple[bytes, int]:
        """Decode `count` bytes, and return them with the place after them."""
        end = at + (4 * -(-count // 3) if self.base64 else count)
        if not 0 <= at <= end <= len(self.content):
            raise ValueError(f"{count} bytes are declared, but {max(len(self.content) - at, 0)} follow")
        taken = self.content[at:end]
        return (b64decode(taken, validate=True)[:count] if self.base64 else taken), end

    def sizes(self, at: int, count: int) -> np.ndarray:
        """Whole numbers at the beginning of an array."""
        return np.frombuffer(self.take(at, count * self.header.itemsize)[0], self.header).astype(np.int64)

    def array(self, at: int) -> bytes:
        """Bytes of the array that begins at a place."""
        first, width = int(self.sizes(at, 1)[0]), self.header.itemsize
        if not self.packed:
            return self.take(at, width + first)[0][width:]
        _, begin = self.take(at, (3 + first) * width)
        compressed = self.sizes(at, 3 + first)[3:]
        data = self.take(begin, int(compressed.sum()))[0]
        ends = np.cumsum(compressed)
        return b"".join(self._expand(data[end - size : end]) for size, end in zip(compressed, ends, strict=True))

    def _expand(self, block: bytes) -> bytes:
        return zlib.decompressobj().decompress(block, self.most)


def read_columns(content: bytes) -> dict[str, np.ndarray]:
    """Points and point data, of all pieces together.

    Raises
    ------
    ValueError
        if the file is damaged, is of another kind or compressed otherwise than by zlib, in a few words
    """
    head, mark, tail = content.rstrip().partition(b"<AppendedData")
    complete = tail.endswith(END) or not mark
    try:
        root = ElementTree.fromstring(head + (END if mark and complete else b""))
    except ElementTree.ParseError as problem:
        raise ValueError(f"no complete XML: {problem}") from None
    kind = root.get("type", "")
    if kind not in ("UnstructuredGrid", "PolyData"):
        hint = ": it names other files, give one of those" if kind.startswith("P") else ""
        raise ValueError(f"VTK of type {kind}{hint or ': UnstructuredGrid and PolyData are read'}")
    compressor = root.get("compressor", "vtkZLibDataCompressor")
    if compressor != "vtkZLibDataCompressor":
        raise ValueError(f"compressed by {compressor}: only vtkZLibDataCompressor is read")
    order = "<" if root.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    header = np.dtype(TYPES[root.get("header_type", "UInt32")]).newbyteorder(order)
    coded = b"base64" in tail.partition(b">")[0]
    appended = tail[tail.find(b"_") + 1 :]
    source = _Source(appended, coded, header, order, "compressor" in root.attrib, MOST_EXPANDED * len(content))
    pieces = [_piece(piece, source) for piece in root.iter("Piece")]
    names = [name for name in pieces[0] if all(name in piece for piece in pieces)] if pieces else []
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in names}


def _piece(piece: ElementTree.Element, source: _Source) -> dict[str, np.ndarray]:
    """Columns of a piece of the grid."""
    places, data = piece.find("Points/DataArray"), piece.findall("PointData/DataArray")
    arrays = {"points": places} if places is not None else {}
    arrays |= {array.get("Name", ""): array for array in data}
    return {name: _array(array, source) for name, array in arrays.items() if array.get("type") in TYPES}


def _array(array: ElementTree.Element, source: _Source) -> np.ndarray:
    """Values of an array, (N,) or (N, components)."""
    text, form, width = array.text or "", array.get("format", "ascii"), int(array.get("NumberOfComponents") or 1)
    if form == "ascii":
        values = parse_numbers(text.split())
    else:
        inline = source._replace(content=re.sub(rb"\s", b"", text.encode()), base64=True)
        content = source.array(int(array.get("offset", ""))) if form == "appended" else inline.array(0)
        values = np.frombuffer(content, np.dtype(TYPES[array.get("type", "")]).newbyteorder(source.order)).astype(float)
    return values.reshape(-1, width) if width > 1 else values
