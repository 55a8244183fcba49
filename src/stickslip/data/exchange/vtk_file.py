"""VTK files, which ParaView reads: grains as points with radii, contacts as lines with their forces, one file each.

NAME.vtu contains the grains (Glyph: sphere, scaled by `diameter`), and NAME-contacts.vtu contains the lines. Several
frames become NAME_0000.vtu and so on, which ParaView opens as a series.
"""

import zlib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ...core.readable import pluralize
from ...core.reading import Budget, Reader
from ...core.text import parse_numbers
from ...extras import require
from ..atomic import name_file_in_errors
from ..sample import Assumption, PackingError
from . import vtk_xml
from .columns import packing_of_columns
from .content import Packing, extent_note, only_state, read_content
from .frame import Frame, exported, list_losses, wrapped_into


def vtk_paths(path: Path, count: int) -> list[tuple[Path, Path]]:
    """Paths of the files of grains and of contacts for each frame."""
    stems = [path.stem] if count == 1 else [f"{path.stem}_{k:04d}" for k in range(count)]
    pattern = "{}-contacts{}" if count == 1 else "{0[0]}-contacts_{0[1]}{1}"
    names = [pattern.format(stem if count == 1 else stem.rsplit("_", 1), path.suffix) for stem in stems]
    return [(path.with_name(stem + path.suffix), path.with_name(n)) for stem, n in zip(stems, names, strict=True)]


def write_vtk(path: str | Path, frames: list[Frame]) -> list[str]:
    """Write two .vtu files per frame, all or none; return notes on what they do not store."""
    hl, path = require("pyevtk.hl", "exchange"), Path(path)
    if not path.parent.is_dir():
        raise PackingError(f"the folder {path.parent} does not exist: create it first")
    pairs = vtk_paths(path, len(frames))
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
    notes = [f"{pluralize(bare, 'frame')} without contacts: no file of lines was written"] if bare else []
    return [*notes, f"VTK does not store {', '.join(lost)}"]


def _positions(frame: Frame) -> np.ndarray:
    """Positions wrapped into the box; unwrapped for animations, so that no grain jumps across the box."""
    state = frame.state
    if frame.moving or not state.cell.periodic.any():
        return state.grains.position
    vectors, corner = state.cell.vectors, np.zeros(3)
    return wrapped_into(state.grains.position, vectors, corner, state.cell.periodic)[0]


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
TYPES = {
    "float": "f4", "double": "f8", "char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2",
    "int": "i4", "unsigned_int": "u4", "long": "i8", "unsigned_long": "u8", "vtktypeint64": "i8", "vtkIdType": "i8",
}  # fmt: skip


def recognize(head: bytes) -> bool:
    """Return True for legacy VTK files and for VTU and VTP."""
    return head.lstrip().startswith(LEGACY) or (head.lstrip().startswith(b"<") and vtk_xml.MARK in head)


def read(path: Path, frame: str | None = None) -> list[Packing]:
    """Read the points of a VTK file, legacy or XML, with the radii in its point data."""
    only_state(path, frame)
    content = read_content(path)
    budget = Budget(path, len(content), remedy="write it again", error=PackingError)
    legacy = content.lstrip().startswith(LEGACY)
    try:
        columns = _legacy_columns(content) if legacy else vtk_xml.read_columns(content, budget)
        columns = {name: _squeeze(column) for name, column in columns.items()}
    except PackingError:
        raise
    except (ValueError, IndexError, KeyError, zlib.error) as problem:
        raise PackingError(f"{path} is truncated, or not VTK of points ({str(problem)[:120]})") from None
    packing = packing_of_columns(columns, path.name, path.stem)
    return [packing._replace(notes=[*packing.notes, Assumption(extent_note(path.name))])]


def _squeeze(column: np.ndarray) -> np.ndarray:
    return column[:, 0] if column.ndim == 2 and column.shape[1] == 1 else column


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
            reader.skip_block()
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

    def skip_block(self) -> None:
        """Skip to the next empty line."""
        while self.left and self.line():
            pass

    def numbers(self, count: int, kind: str) -> np.ndarray:
        """The next `count` numbers of a type."""
        if not 0 <= count <= self.left:
            raise ValueError(f"{count} numbers are declared, but {self.left} bytes follow")
        if self.binary:
            return self.array(np.dtype(TYPES[kind]).newbyteorder(">"), count).astype(float)
        tokens = []
        while len(tokens) < count and (line := self.tokens()):
            tokens += line
        return parse_numbers(tokens[:count])
