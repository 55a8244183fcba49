"""VTK files for ParaView: grains as points with radii, contacts as lines with their forces, in separate files.

NAME.vtu contains the grains (Glyph: sphere, scaled by `diameter`), and NAME-contacts.vtu contains the lines, whose
column `bond` is 1 for bonds and 2 for broken ones. Several frames become NAME_0000.vtu and so on, which ParaView opens
as a series. Legacy files and XML files (.vtu and .vtp), as written by ParaView, YADE and VTK itself, are read without
a library.

Source: Kitware, VTK XML file formats, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html.
"""

import re
import zlib
from base64 import b64decode
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from ...core.readable import pluralize
from ...core.reading import Budget, Reader
from ...core.text import parse_numbers
from ...extras import require
from ..run_files import name_file_in_errors
from ..sample import Assumption, PackingError, refusing
from .columns import Packing, extent_note, only_state, packing_of_columns, read_content
from .frame import Frame, exported, list_losses, with_bonds, wrapped_into

MARK, END = b"<VTKFile", b"</VTKFile>"
TYPES = {f"{kind}{8 * size}": f"{kind[0].lower()}{size}" for kind in ("Int", "UInt") for size in (1, 2, 4, 8)}
TYPES |= {"Float32": "f4", "Float64": "f8"}


class _Source(NamedTuple):
    """Encoded bytes of arrays, and their encoding."""

    content: bytes
    base64: bool
    header: np.dtype  # type of the byte counts that precede data
    order: str  # byte order, < or >
    packed: bool  # compressed by zlib
    budget: Budget

    def decode(self, at: int, count: int) -> tuple[bytes, int]:
        """Decode `count` bytes, and return them with the position after them."""
        reader = Reader(self.content, at)
        taken = reader.take(4 * -(-count // 3) if self.base64 else count)
        return (b64decode(taken, validate=True)[:count] if self.base64 else taken), reader.at

    def sizes(self, at: int, count: int) -> np.ndarray:
        """Whole numbers at the beginning of an array."""
        return np.frombuffer(self.decode(at, count * self.header.itemsize)[0], self.header).astype(np.int64)

    def array(self, at: int) -> bytes:
        """Bytes of the array that begins at a position."""
        first, width = int(self.sizes(at, 1)[0]), self.header.itemsize
        if not self.packed:
            alone = at + 4 * -(-width // 3)  # some programs encode the byte count separately
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


def _xml_columns(content: bytes, budget: Budget) -> dict[str, np.ndarray]:
    """Points and point data, of all pieces together.

    Raises
    ------
    ValueError
        If the file is damaged, of another kind, or not compressed with zlib; the message is a few words.
    """
    head, mark, tail = content.partition(b"<AppendedData")
    complete = END in tail or not mark
    try:
        root = ElementTree.fromstring(head + (END if mark and complete else b""))
    except ElementTree.ParseError as problem:
        raise ValueError(f"incomplete XML: {problem}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # without namespaces
    kind = root.get("type", "")
    if kind not in ("UnstructuredGrid", "PolyData"):
        hint = ": it refers to other files, give one of those" if kind.startswith("P") else ""
        raise ValueError(f"unsupported VTK type {kind}{hint or ': UnstructuredGrid and PolyData are read'}")
    compressor = root.get("compressor", "vtkZLibDataCompressor")
    if compressor != "vtkZLibDataCompressor":
        raise ValueError(f"compressed by {compressor}: only vtkZLibDataCompressor is supported")
    order = "<" if root.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    header = np.dtype(TYPES[root.get("header_type", "UInt32")]).newbyteorder(order)
    coded = b"base64" in tail.partition(b">")[0]
    appended = tail[tail.find(b"_") + 1 :]
    source = _Source(appended, coded, header, order, "compressor" in root.attrib, budget)
    pieces = []
    for piece in root.iter("Piece"):
        places, data = piece.find("Points/DataArray"), piece.findall("PointData/DataArray")
        arrays = {"points": places} if places is not None else {}
        arrays |= {array.get("Name", ""): array for array in data}
        columns = {name: _array(array, source) for name, array in arrays.items() if array.get("type") in TYPES}
        count = len(columns.get("points", ()))
        if int(piece.get("NumberOfPoints", count)) != count:
            raise ValueError(f"{piece.get('NumberOfPoints')} points are declared, but there are {count}")
        pieces += [columns] if count else []
    names = [name for name in pieces[0] if all(name in piece for piece in pieces)] if pieces else []
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in names}


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


def vtk_paths(path: Path, count: int) -> list[tuple[Path, Path]]:
    """Paths of the files of grains and of contacts for each frame."""
    ends = [path.suffix] if count == 1 else [f"_{k:04d}{path.suffix}" for k in range(count)]
    return [(path.with_name(path.stem + end), path.with_name(f"{path.stem}-contacts{end}")) for end in ends]


def write_vtk(path: str | Path, frames: list[Frame]) -> list[str]:
    """Write two .vtu files per frame, all or none; return notes on data that these files cannot store."""
    hl, path = require("pyevtk.hl", "exchange"), Path(path)
    if not path.parent.is_dir():
        raise PackingError(f"the folder {path.parent} does not exist: create it first")
    pairs = vtk_paths(path, len(frames))
    frames = [frame._replace(contacts=with_bonds(frame)) for frame in frames]
    with name_file_in_errors(path), TemporaryDirectory(prefix=f".{path.stem}.", dir=path.parent) as folder:
        made = []
        for frame, targets in zip(frames, pairs, strict=True):
            for target, write in zip(targets, (_write_grains, _write_lines), strict=True):
                if write is _write_lines and not len(frame.contacts["i"]):
                    continue  # pyevtk cannot write an empty file
                made.append((Path(write(hl, str(Path(folder) / target.stem), frame)), target))
        for part, target in made:
            part.replace(target)
    lost = ["the cell", "the images of contacts", *list_losses(frames[0])]
    bare = sum(not len(frame.contacts["i"]) for frame in frames)
    notes = [f"{pluralize(bare, 'frame')} without contacts: no line file was written"] if bare else []
    return [*notes, f"VTK does not store {', '.join(lost)}"]


def _positions(frame: Frame) -> np.ndarray:
    """Positions wrapped into the box; unwrapped for animations, so that no grain jumps across the box."""
    state = frame.state
    if frame.moving or not state.cell.periodic.any():
        return state.grains.position
    return wrapped_into(state.grains.position, state.cell.vectors, np.zeros(3), state.cell.periodic)[0]


def _write_grains(hl, path: str, frame: Frame) -> str:
    grains = frame.state.grains
    columns = {name: getattr(grains, name) for name in ("radius", "mass", "inertia", "material")}
    columns |= {"diameter": 2 * grains.radius, "velocity": grains.velocity, "spin": grains.spin, "angle": grains.angle}
    return hl.pointsToVTK(path, *_split_axes(_positions(frame)), data=_to_vtk_columns(columns | exported(frame.grains)))


def _write_lines(hl, path: str, frame: Frame) -> str:
    """Write lines from i along the branch vector to j, or to the surface of a wall, even across the box boundary."""
    c = frame.contacts
    start = _positions(frame)[c["i"]]
    ends = np.stack([start, start - c["branch"]], axis=1).reshape(-1, 3)
    columns = {name: column for name, column in c.items() if name != "image"}
    return hl.linesToVTK(path, *_split_axes(ends), cellData=_to_vtk_columns(columns))


def _split_axes(points: np.ndarray):
    return (np.ascontiguousarray(axis) for axis in points.T)


def _to_vtk_columns(columns: dict) -> dict:
    """Convert columns for pyevtk: vectors as three arrays, small integers as 32-bit integers."""
    out = {}
    for name, column in columns.items():
        values = column.astype(np.int32) if column.dtype.kind in "iub" else column
        out[name] = tuple(_split_axes(values)) if values.ndim == 2 else np.ascontiguousarray(values)
    return out


LEGACY = b"# vtk DataFile"
LEGACY_TYPES = {
    "float": "f4", "double": "f8", "char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2",
    "int": "i4", "unsigned_int": "u4", "long": "i8", "unsigned_long": "u8", "vtktypeint64": "i8", "vtkIdType": "i8",
}  # fmt: skip


def recognize(head: bytes) -> bool:
    """Return True for legacy VTK files and for VTU and VTP."""
    return head.lstrip().startswith(LEGACY) or (head.lstrip().startswith(b"<") and MARK in head)


def read(path: Path, frame: str | None = None) -> list[Packing]:
    """Read the points of a VTK file, legacy or XML, with the radii in its point data."""
    only_state(path, frame)
    content = read_content(path)
    budget = Budget(path, len(content), remedy="write it again", error=PackingError)
    legacy = content.lstrip().startswith(LEGACY)
    damage = f"{path} is truncated, or not VTK of points"
    with refusing(lambda problem: f"{damage} ({str(problem)[:120]})", IndexError, KeyError, zlib.error):
        columns = _legacy_columns(content) if legacy else _xml_columns(content, budget)
        columns = {name: c[:, 0] if c.ndim == 2 and c.shape[1] == 1 else c for name, c in columns.items()}
    return [packing_of_columns(columns, path.name, path.stem, [Assumption(extent_note(path.name))])]


def _legacy_columns(content: bytes) -> dict[str, np.ndarray]:
    """Points and point data of a legacy file."""
    reader = _Legacy(content)
    columns, count, of_points = {}, -1, False
    while tokens := reader.tokens():
        key = tokens[0].upper()
        if key == "POINTS":
            count = int(tokens[1])
            columns["points"] = reader.numbers(3 * count, tokens[2]).reshape(count, 3)
        elif key in ("POINT_DATA", "CELL_DATA"):
            of_points = key == "POINT_DATA"
        elif key in ("VECTORS", "NORMALS") and of_points:
            columns[tokens[1]] = reader.numbers(3 * count, tokens[2]).reshape(count, 3)
        elif key == "SCALARS" and of_points:
            reader.tokens()  # LOOKUP_TABLE
            width = int(tokens[3]) if len(tokens) > 3 else 1
            columns[tokens[1]] = reader.numbers(width * count, tokens[2]).reshape(count, width)
        elif key == "FIELD" and of_points:
            for _ in range(int(tokens[2])):
                name, width, rows, kind = reader.tokens()
                columns[name] = reader.numbers(int(width) * int(rows), kind).reshape(int(rows), int(width))
        elif key == "METADATA":
            while reader.left and reader.line():  # up to the next empty line
                pass
        elif key in ("VERTICES", "LINES", "POLYGONS", "CELLS", "CELL_TYPES") and reader.binary and len(tokens) > 1:
            reader.numbers(int(tokens[-1]), "int")
    return columns


class _Legacy(Reader):
    """Position in a legacy file: lines of words, and arrays that follow them."""

    def __init__(self, content: bytes):
        super().__init__(content)
        self.tokens(), self.tokens()
        self.binary = self.tokens()[0].upper() == "BINARY"

    def tokens(self) -> list[str]:
        """Tokens of the next line that is not empty; none at the end."""
        while self.left:
            if tokens := self.line().decode("latin-1").split():
                return tokens
        return []

    def numbers(self, count: int, kind: str) -> np.ndarray:
        """The next `count` numbers of a type."""
        if not 0 <= count <= self.left:
            raise ValueError(f"{count} numbers are declared, but {self.left} bytes follow")
        if self.binary:
            return self.array(np.dtype(LEGACY_TYPES[kind]).newbyteorder(">"), count).astype(float)
        tokens = []
        while len(tokens) < count and (line := self.tokens()):
            tokens += line
        return parse_numbers(tokens[:count])
