"""GSD files, which OVITO, freud and VMD read: grains, contacts as bonds with their forces, and the complete state.

Other programs display the standard chunks, which are in single precision and in a box around the origin. Columns per
grain and per contact are under `log/particles/` and `log/bonds/`. All arrays of the state are under `stickslip/`, which
other programs ignore: files written by this package are read back exactly, to the last bit. From other files, only the
standard chunks are read.
"""

import json
from pathlib import Path

import numpy as np

from ...core import state as core
from ...core.readable import pluralize
from ...core.reading import Budget, Reader
from ...core.state import State, check
from ...extras import require
from ..nodes import restore_bonds, restore_contacts
from ..run_files import replace_atomically
from ..sample import PackingError, account_for, repeated_note
from .content import Packing, chosen_frames
from .frame import Frame, bounding_box, law_from_dict, law_to_dict, without_walls, wrapped_into

SCHEMA = 2  # schema of the chunks under stickslip/; earlier ones are read
PREFIX = "stickslip/"
CONTACTS = ("sticking", "sliding")  # types of the bonds that show contacts
CEMENT = ("bond", "broken bond")  # and of those that show bonds
META = f"{PREFIX}meta"
ENTRY = np.dtype("<u8, <u8, <i8, <u4, <u2, u1, u1")  # of the file index
ENTRY.names = "frame", "rows", "at", "columns", "id", "type", "flags"
NAME, TYPES = 64, np.array([0.0, 1, 2, 4, 8, 1, 2, 4, 8, 4, 8, 1])  # sizes of a name, and of numbers by type [bytes]
# memory of a particle or bond [bytes], even if the file contains only their number: the rest has defaults
TAKES = {"particles": 300, "bonds": 20, "angles": 24, "dihedrals": 32, "impropers": 32, "constraints": 16, "pairs": 20}
NOUNS = {
    "grains": core.Grains,
    "walls": core.Walls,
    "cell": core.Cell,
    "contacts": core.Contacts,
    "control": core.Control,
    "instant": core.Instant,
    "bonds": core.Bonds,
}


def write_gsd(path: str | Path, frames: list[Frame]) -> list[str]:
    """Write frames as a trajectory; return notes on data that other programs ignore."""
    hoomd = require("gsd.hoomd", "exchange")
    notes = []
    with replace_atomically(Path(path)) as part, hoomd.open(str(part), "w") as file:
        for step, frame in enumerate(frames):
            picture, lost = _to_hoomd(hoomd, frame, step)
            for name, chunk in _state_chunks(frame).items():
                file.file.write_chunk(name, chunk)
            file.append(picture)
            notes += [note for note in lost if note not in notes]
    return notes


def _to_hoomd(hoomd, frame: Frame, step: int):
    """Convert one frame to `gsd.hoomd.Frame`."""
    state, out = frame.state, hoomd.Frame()
    grains, cell, n = state.grains, state.cell, len(state.grains.radius)
    vectors, corner = bounding_box(state, "GSD")
    middle = corner + vectors.sum(axis=0) / 2
    inside, image = wrapped_into(grains.position, vectors, corner, cell.periodic)
    a, b, c = np.diag(vectors)
    out.configuration.step, out.configuration.dimensions = step, cell.dim
    out.configuration.box = [a, b, c, vectors[1, 0] / b, vectors[2, 0] / c, vectors[2, 1] / c]
    angle = grains.angle * [0, 0, 1] if cell.dim == 2 else np.zeros((n, 3))
    turn = quaternion(angle if frame.turned is None else frame.turned)
    kinds = int(grains.material.max(initial=0)) + 1
    p = out.particles
    p.N, p.position, p.image, p.velocity = n, inside - middle, image, grains.velocity
    p.diameter, p.mass, p.orientation = 2 * grains.radius, grains.mass, turn
    p.moment_inertia = np.repeat(grains.inertia[:, None], 3, axis=1)
    p.angmom = 2 * quaternion_product(turn, np.pad(grains.inertia[:, None] * grains.spin, ((0, 0), (1, 0))))
    p.types, p.typeid = [f"material {k}" for k in range(kinds)], grains.material
    pairs, notes = without_walls(frame)
    out.bonds.N, out.bonds.types = len(pairs["i"]), [*CONTACTS, *(CEMENT if "bond" in pairs else ())]
    out.bonds.group = np.stack([pairs["i"], pairs["j"]], axis=1)
    kind = (pairs["mode"] == core.SLIDE).astype(np.uint32)
    out.bonds.typeid = (
        np.where(pairs["bond"] > 0, pairs["bond"] + 1, kind).astype(np.uint32) if "bond" in pairs else kind
    )
    out.log["time"] = np.array([state.time])
    columns = {"spin": grains.spin, **frame.grains}
    out.log |= {f"particles/{name}": _exported(column) for name, column in columns.items()}
    if len(pairs["i"]):
        out.log |= {
            f"bonds/{name}": _exported(column) for name, column in pairs.items() if name not in ("i", "j", "image")
        }
    if not cell.periodic[: cell.dim].all():
        notes.append("GSD has no open boxes: other programs will show a periodic box around the grains")
    if len(state.walls.mass):
        notes.append(f"{pluralize(len(state.walls.mass), 'wall')} stored for stickslip; other programs ignore them")
    return out, notes


def _exported(column: np.ndarray) -> np.ndarray:
    """Column in a type that other programs read: small integers as 32-bit integers."""
    return np.ascontiguousarray(column.astype(np.int32) if column.dtype.kind in "iub" else column)


def _state_chunks(frame: Frame) -> dict[str, np.ndarray]:
    """Chunks of the complete state: flattened arrays, with their shapes and the law as JSON."""
    if frame.moving:
        return {META: _json_chunk({"schema": SCHEMA, "moving": True})}
    chunks, shapes, count = {}, {}, int(frame.state.contacts.count[0])
    for noun in [noun for noun in NOUNS if getattr(frame.state, noun) is not None]:
        for name, value in getattr(frame.state, noun)._asdict().items():
            if value is None:
                continue
            value = np.asarray(value)
            if noun == "contacts" and name in core.PER_PAIR:
                value = value[:count]
            shapes[f"{noun}/{name}"] = [value.dtype.str, list(value.shape)]
            if value.size:
                flat = np.ascontiguousarray(value).ravel()
                chunks[f"{PREFIX}{noun}/{name}"] = flat.astype(np.uint8) if flat.dtype == bool else flat
    meta = {
        "schema": SCHEMA,
        "moving": False,
        "time": frame.state.time,
        "law": law_to_dict(frame.law),
        "assumed": list(frame.assumed),
        "shapes": shapes,
    }
    return {META: _json_chunk(meta), **chunks}


def _json_chunk(entries: dict) -> np.ndarray:
    return np.frombuffer(json.dumps(entries).encode(), np.uint8)


def recognize(head: bytes) -> bool:
    """Return True for GSD."""
    return head.startswith(b"\xdf\x65" * 4)


def read(path: Path, frame: str | None = None) -> list[Packing]:
    """Read frames of a GSD file, named by their number from 0; for foreign files, arrays for `from_arrays`.

    Raises
    ------
    PackingError
        If the file is truncated, of another version, or not a GSD file.
    """
    hoomd = require("gsd.hoomd", "exchange")
    try:
        sizes = _sizes_of_frames(path)  # first, because the library does not check them
        with hoomd.open(str(path), "r") as file:
            if not len(file):
                raise PackingError(f"{path} has no frames: give a GSD file with at least one")
            chosen = chosen_frames(path, [str(k) for k in range(len(file))], frame)
            budget = Budget(path, path.stat().st_size, remedy="write it again", error=PackingError)
            for k in chosen:
                budget.take(sizes.get(k, 0), f"frame {k}")
                for part, size in TAKES.items():
                    budget.take(size * _number(file.file, k, part), part)
            return [_read_frame(path, file, k) for k in chosen]
    except PackingError:
        raise
    except (OSError, RuntimeError, KeyError, IndexError, TypeError, ValueError, MemoryError, OverflowError) as problem:
        why = str(problem).replace("\n", " ").strip("'\"")
        raise PackingError(
            f"{path} cannot be read as GSD ({type(problem).__name__}: {why[:120]}): it is truncated, of another "
            f"version, or not a GSD file"
        ) from None


def _sizes_of_frames(path: Path) -> dict[int, float]:
    """Sizes of all chunks of each frame [bytes] by the file index; chunks may overlap."""
    stored = path.stat().st_size
    with open(path, "rb") as file:
        head = Reader(file.read(40), 8)
        (start, number), (names, most) = (head.array("<u8", 2).tolist() for _ in range(2))
        if start + number * ENTRY.itemsize > stored or names + most * NAME > stored:
            raise ValueError(f"a file of {stored} bytes declares an index of {number} entries and {most} names")
        file.seek(start)
        index = np.frombuffer(file.read(number * ENTRY.itemsize), ENTRY)
    index = index[np.cumprod(index["at"] != 0).astype(bool)]  # the first entry without a location ends it
    size = TYPES[np.minimum(index["type"], len(TYPES) - 1)] * index["rows"] * index["columns"]
    if ((index["at"] < 0) | (index["at"] + size > stored)).any():
        raise ValueError("a chunk is declared beyond the end of the file")
    frames, places = np.unique(index["frame"], return_inverse=True)
    sizes = np.bincount(places, 8.0 * index["rows"] * index["columns"])  # as numbers in double precision
    return dict(zip(frames.tolist(), sizes.tolist(), strict=True))


def _number(file, frame: int, part: str) -> int:
    """Number of particles or bonds in a frame, by default that of the first frame."""
    name = f"{part}/N"
    at = next((k for k in (frame, 0) if file.chunk_exists(k, name)), None)
    return 0 if at is None else int(file.read_chunk(at, name)[0])


def _read_frame(path, file, number: int) -> Packing:
    if not file.file.chunk_exists(number, META):
        frame = file[number]
        return Packing(str(number), *_read_foreign(frame), types=frame.particles.typeid.astype(np.int64))
    meta = json.loads(file.file.read_chunk(number, META).tobytes().decode())
    if not meta["schema"] <= SCHEMA:
        raise PackingError(
            f"{path} has stickslip GSD schema {meta['schema']}, but this version reads schemas up to {SCHEMA}"
        )
    if meta["moving"]:
        raise PackingError(f"{path} is an animation of a mode, not a state: give the packing it was made from")
    parts = {}
    for noun, kind in NOUNS.items():
        there = [name for name in kind._fields if f"{noun}/{name}" in meta["shapes"]]
        fields = {name: _read_array(file.file, number, meta["shapes"], f"{noun}/{name}") for name in there}
        if fields:  # only runs with dashpots store forces
            maker = {"contacts": restore_contacts, "bonds": restore_bonds}.get(noun)
            parts[noun] = maker(fields) if maker else kind(**fields)
    parts["cell"] = parts["cell"]._replace(dim=int(parts["cell"].dim))
    parts["control"] = parts["control"]._replace(cell_mass=float(parts["control"].cell_mass))
    if "instant" in parts:
        parts["instant"] = parts["instant"]._replace(mark=int(parts["instant"].mark))
    state = State(**parts, time=float(meta["time"]))
    check(state)
    notes = [repeated_note(text) for text in meta.get("assumed", ())]
    return Packing(str(number), {}, notes, state=state, law=law_from_dict(meta["law"]))


def _read_array(file, number: int, shapes: dict, name: str) -> np.ndarray:
    dtype, shape = np.dtype(shapes[name][0]), tuple(shapes[name][1])
    if dtype.kind not in "biuf":
        raise ValueError(f"{name} has type {dtype}")
    if not np.prod(shape, dtype=int):
        return np.zeros(shape, dtype)
    return file.read_chunk(number, PREFIX + name).astype(dtype).reshape(shape)


def _read_foreign(frame):
    """Read arrays from the standard chunks, which contain neither slip nor law."""
    p, (a, b, c, xy, xz, yz) = frame.particles, frame.configuration.box.astype(float)
    dim = int(frame.configuration.dimensions)
    vectors = np.array([[a, 0, 0], [xy * b, b, 0], [xz * c, yz * c, c or 1.0]])
    turn, momentum = p.orientation.astype(float), p.angmom.astype(float)
    body = quaternion_product(turn * [1, -1, -1, -1], momentum)[:, 1:] / 2
    inertia = p.moment_inertia.astype(float)
    spin = np.divide(body, inertia, out=np.zeros_like(body), where=inertia > 0)
    spin = quaternion_product(quaternion_product(turn, np.pad(spin, ((0, 0), (1, 0)))), turn * [1, -1, -1, -1])[:, 1:]
    position = p.position.astype(float) + p.image @ vectors
    if dim == 2:
        position[:, 2] = 0.0
        vectors[2], vectors[:2, 2] = (0, 0, 1), 0
    arrays = {
        "position": position, "radius": p.diameter.astype(float) / 2, "mass": p.mass.astype(float), "cell": vectors,
        "velocity": p.velocity.astype(float), "spin": spin, "dim": dim,
    }  # fmt: skip
    notes = ["the file was not written by stickslip: it has positions with seven digits, no contact memory and no law"]
    for name in ("bonds", "angles", "dihedrals", "impropers"):
        if getattr(frame, name).N and tuple(getattr(frame, name).types or ())[:2] != CONTACTS:
            notes += account_for("part of a GSD file", [name], "the file")
    if p.charge is not None and np.any(p.charge):
        notes += account_for("column of a dump", ["q"], "the file")
    if (p.diameter == 1).all():
        notes.append("all diameters are 1, the default of GSD")
    if (inertia[:, 2] > 0).all():
        arrays["i0"] = inertia[:, 2] / (arrays["mass"] * arrays["radius"] ** 2)
    return arrays, notes


def quaternion(angle: np.ndarray) -> np.ndarray:
    """(N, 4) unit quaternions of rotation vectors (N, 3) [rad]."""
    half = 0.5 * np.linalg.norm(angle, axis=1, keepdims=True)
    return np.hstack([np.cos(half), 0.5 * np.sinc(half / np.pi) * angle])


def quaternion_product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(N, 4) products of quaternions, scalar part first."""
    a, u, b, v = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    return np.hstack([a * b - (u * v).sum(axis=1, keepdims=True), a * v + b * u + np.cross(u, v)])
