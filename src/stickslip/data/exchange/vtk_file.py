"""VTK files, which ParaView reads: grains as points with radii, contacts as lines with their forces, one file each.

NAME.vtu contains the grains (Glyph: sphere, scaled by `diameter`), and NAME-contacts.vtu contains the lines. Several
frames become NAME_0000.vtu and so on, which ParaView opens as a series.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ...core.readable import pluralize
from ...extras import require
from ..atomic import name_file_in_errors
from ..sample import PackingError
from .frame import Frame, list_losses, wrapped_into


def vtk_paths(path: Path, count: int) -> list[tuple[Path, Path]]:
    """Paths of the files of grains and of contacts for each frame."""
    stems = [path.stem] if count == 1 else [f"{path.stem}_{k:04d}" for k in range(count)]
    one = "{}-contacts{}" if count == 1 else "{0[0]}-contacts_{0[1]}{1}"
    names = [one.format(stem if count == 1 else stem.rsplit("_", 1), path.suffix) for stem in stems]
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
    words = [f"{pluralize(bare, 'frame')} without contacts: no file of lines was written"] if bare else []
    return [*words, f"VTK does not store {', '.join(lost)}; stickslip writes it but does not read it"]


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
    return hl.pointsToVTK(path, *_split_axes(_positions(frame)), data=_to_vtk_columns(columns | frame.grains))


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
