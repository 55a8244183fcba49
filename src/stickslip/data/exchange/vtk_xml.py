"""Points and point data of VTK files in XML: .vtu and .vtp, as ParaView, YADE and VTK itself write them.

Source: Kitware, VTK XML file formats, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html.
"""

import re
import zlib
from base64 import b64decode
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from ...core.reading import Budget, Reader
from ...core.text import parse_numbers

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
    budget: Budget

    def decode(self, at: int, count: int) -> tuple[bytes, int]:
        """Decode `count` bytes, and return them with the place after them."""
        reader = Reader(self.content, at)
        taken = reader.take(4 * -(-count // 3) if self.base64 else count)
        return (b64decode(taken, validate=True)[:count] if self.base64 else taken), reader.at

    def sizes(self, at: int, count: int) -> np.ndarray:
        """Whole numbers at the beginning of an array."""
        return np.frombuffer(self.decode(at, count * self.header.itemsize)[0], self.header).astype(np.int64)

    def array(self, at: int) -> bytes:
        """Bytes of the array that begins at a place."""
        first, width = int(self.sizes(at, 1)[0]), self.header.itemsize
        if not self.packed:
            alone = at + 4 * -(-width // 3)  # some programs encode the number of bytes by itself
            if self.base64 and self.content[alone - 1 : alone] == b"=":
                return self.decode(alone, first)[0]
            return self.decode(at, width + first)[0][width:]
        _, begin = self.decode(at, (3 + first) * width)
        compressed = self.sizes(at, 3 + first)[3:]
        blocks = Reader(self.decode(begin, int(compressed.sum()))[0])
        return b"".join(self._expand(blocks.take(int(size))) for size in compressed)

    def _expand(self, block: bytes) -> bytes:
        content = zlib.decompressobj().decompress(block, self.budget.left + 1)
        self.budget.take(len(content), "array")
        return content


def read_columns(content: bytes, budget: Budget) -> dict[str, np.ndarray]:
    """Points and point data, of all pieces together.

    Raises
    ------
    ValueError
        if the file is damaged, is of another kind or compressed otherwise than by zlib, in a few words
    """
    head, mark, tail = content.partition(b"<AppendedData")
    complete = END in tail or not mark
    try:
        root = ElementTree.fromstring(head + (END if mark and complete else b""))
    except ElementTree.ParseError as problem:
        raise ValueError(f"no complete XML: {problem}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # without namespaces
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
    source = _Source(appended, coded, header, order, "compressor" in root.attrib, budget)
    pieces = [columns for piece in root.iter("Piece") if len((columns := _piece(piece, source)).get("points", ()))]
    names = [name for name in pieces[0] if all(name in piece for piece in pieces)] if pieces else []
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in names}


def _piece(piece: ElementTree.Element, source: _Source) -> dict[str, np.ndarray]:
    """Columns of a piece of the grid."""
    places, data = piece.find("Points/DataArray"), piece.findall("PointData/DataArray")
    arrays = {"points": places} if places is not None else {}
    arrays |= {array.get("Name", ""): array for array in data}
    columns = {name: _array(array, source) for name, array in arrays.items() if array.get("type") in TYPES}
    count = len(columns.get("points", ()))
    if int(piece.get("NumberOfPoints", count)) != count:
        raise ValueError(f"{piece.get('NumberOfPoints')} points are declared, but there are {count}")
    return columns


def _array(array: ElementTree.Element, source: _Source) -> np.ndarray:
    """Values of an array, (N,) or (N, components)."""
    text, form = array.text or "", array.get("format", "ascii").lower()
    width = int(array.get("NumberOfComponents") or 1)
    if form == "ascii":
        values = parse_numbers(text.split())
    else:
        dtype = np.dtype(TYPES[array.get("type", "")]).newbyteorder(source.order)
        inline = source._replace(content=re.sub(rb"\s", b"", text.encode()), base64=True)
        content = source.array(int(array.get("offset", ""))) if form == "appended" else inline.array(0)
        source.budget.take(8 * (len(content) // dtype.itemsize), "array")  # they become doubles
        values = np.frombuffer(content, dtype).astype(float)
    return values.reshape(-1, width) if width > 1 else values
