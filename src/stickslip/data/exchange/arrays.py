"""Formats that store states exactly: .npz files with the arrays of `from_arrays`, HDF5 archives, and GSD files.

OVITO, freud and VMD read GSD: grains, and contacts as bonds with their forces. These programs display the standard
chunks, which are in single precision and in a box around the origin. Columns per grain and per contact are under
`log/particles/` and `log/bonds/`. All arrays of the state are under `stickslip/`, which other programs ignore, so that
files written by this package are read back to the last bit. From other files, only the standard chunks are read.
"""

import difflib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...core import state as core
from ...core.contacts.bonding import with_bonds
from ...core.laws.builtin import KEEPS_FORCE, LEVER, NO_TENSION, PARAMETERS, ROLLING, TWISTING, Law
from ...core.laws.kinds import Kind, own_memory
from ...core.laws.properties import resists_rolling
from ...core.readable import pluralize
from ...core.reading import NPY, Budget, Reader, read_arrays
from ...core.state import Bonds, State, check
from ...core.units import current_units, units_from
from ...extras import require
from .. import archive
from ..archive import trimmed, with_fields
from ..run_files import replace_atomically
from ..sample import COLUMNS, Assumption, PackingError, account_for, law_by_name, naming, refusing, repeated_note
from ..sample import stored_note as stored
from .columns import Packing, choice_note, chosen_frames, extent_note, only_state, packing_of_columns
from .frame import Frame, bounding_box, law_from_dict, law_to_dict, list_losses, without_walls, wrapped_into

REQUIRED = ("position", "radius")
CONTACTS = ("pair_i", "pair_j", "image", "slip", "mode")
MOTION = ("velocity", "spin", "angle")
BOND = "bond_"  # prefix of the names of bond fields
BONDS = tuple(f"{BOND}{name}" for name in Bonds._fields)
OPTIONAL = (*BONDS, "mass", "density", "cell", "periodic", *CONTACTS, *MOTION, "external_force", "dim", "i0", "assumed")
UNITS = "units"  # optional: "SI", or names of length, mass and time
PROPERTIES = {
    LEVER: "lever arms R − δ/2", KEEPS_FORCE: "memory of forces", ROLLING: "rolling moments",
    TWISTING: "twisting moments",
}  # fmt: skip
# optional arrays that define the law of the packing
LAW = ("law", "coulomb", "kn", "kt", "mu", "damping", "damping_n", "damping_t", "tension")


def write_npz(path: str | Path, frame: Frame) -> list[str]:
    """Write the arrays that `from_arrays` takes, and a law of a single material; return notes on lost information."""
    state, law = frame.state, frame.law
    grains, control, n = state.grains, state.control, len(state.grains.radius)
    pairs, notes = without_walls(frame)
    if "bond" in pairs:  # without the rows of bonds
        pairs = {name: values[pairs["bond"] == 0] for name, values in pairs.items()}
    arrays = {
        "position": grains.position, "radius": grains.radius, "mass": grains.mass, "dim": state.cell.dim,
        "i0": grains.inertia / (grains.mass * grains.radius**2), "pair_i": pairs["i"], "pair_j": pairs["j"],
        "image": pairs["image"], "slip": pairs["slip"], "mode": pairs["mode"],
        **{name: getattr(grains, name) for name in MOTION},
    }  # fmt: skip
    if state.bonds:
        arrays |= {f"{BOND}{name}": values for name, values in state.bonds._asdict().items()}
    if current_units():
        arrays[UNITS] = str(current_units())
    if state.cell.periodic.any():
        arrays |= {"cell": state.cell.vectors, "periodic": state.cell.periodic}
    if control.force[:n].any():
        arrays["external_force"] = control.force[:n]
    rest = frame._replace(state=state._replace(control=control._replace(force=np.zeros_like(control.force))))
    own = isinstance(law.kind, Kind) or law.table.shape[2] > len(PARAMETERS)
    lost = list_losses(rest, law=len(law.table) > 1 or own)
    if state.contacts.rolling is not None and (resists_rolling(law) or own_memory(law.kind)):
        lost.append("the memory of rolling, twisting or of the law")
    left = [f"the {feature} of the law" for part, feature in PROPERTIES.items() if law.properties & part]
    lost += left
    if len(law.table) == 1 and not own:
        arrays |= {k: v for k, v in law_to_dict(law).items() if k in ("law", "coulomb", "damping")}
        arrays |= {"tension": False} if law.damping & NO_TENSION else {}
        arrays |= dict(zip(PARAMETERS, law.table[0, 0], strict=True))
        assumed = [*frame.assumed, *(f"left out, as .npz does not store it: {text}" for text in left)]
        arrays |= {"assumed": [stored(note) for note in assumed]} if assumed else {}
    with replace_atomically(Path(path)) as part:
        np.savez(part, **arrays)
    return notes + ([f".npz does not store {', '.join(lost)}"] if lost else [])


def recognize(head: bytes) -> bool:
    """Return True for NumPy's .npz and .npy files, judged by their first bytes."""
    return head.startswith((b"PK\x03\x04", NPY))


def read(path: Path, frame: str | None = None) -> list[Packing]:
    """Read arrays named as in this package or in a common way (x, radius), or one array with columns x y z radius."""
    only_state(path, frame)
    arrays = load_arrays(path)
    if "position" not in arrays and not set(arrays) & {*CONTACTS, *LAW}:
        flat = next(iter(arrays.values())) if list(arrays) == [""] else None
        notes = [Assumption(extent_note(path.name))]
        if flat is not None and flat.ndim == 2 and flat.shape[1] == 4:
            text = f"{path.name} has four columns without names: x y z radius is assumed"
            notes = [Assumption(text, COLUMNS), *notes]
            arrays = dict(zip(("x", "y", "z", "radius"), flat.T, strict=True))
        elif flat is not None:
            arrays = {name: flat[name] for name in flat.dtype.names or ()}
        return [packing_of_columns(arrays, path.name, path.stem, notes)]
    arrays, given = check_arrays(path, arrays)
    del arrays["units"]
    assumed = np.atleast_1d(arrays.pop("assumed", np.zeros(0, "U1")))
    if assumed.ndim > 1 or (assumed.size and assumed.dtype.kind != "U"):
        got = f"the shape {assumed.shape} and the type {assumed.dtype}"
        raise PackingError(f"assumed has {got} in {path}: it must be text, or a one-dimensional array of text")
    notes = [repeated_note(text) for text in assumed.tolist()]
    bonds = {name: arrays.pop(name) for name in BONDS if name in arrays}
    return [Packing(path.stem, arrays, notes, law=given or None, setting=_bonding(path, bonds) if bonds else None)]


def _bonding(path: Path, arrays: dict[str, np.ndarray]) -> Callable[[State], State]:
    """Function that adds bonds, given by their fields in a file, to the grains of a state."""
    if missing := sorted({*BONDS} - {*arrays}):
        raise PackingError(f"{path} has {min(arrays)!r} but not {missing[0]!r}: bonds need all of {', '.join(BONDS)}")

    def add_bonds(state: State) -> State:
        bonds = Bonds(**{name.removeprefix(BOND): values for name, values in arrays.items()})
        with naming(path), refusing():
            state._replace(bonds=bonds).check_entries()
            return with_bonds(state, bonds)

    return add_bonds


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a NumPy file by name; the array of an .npy file has the name ""."""
    try:
        return read_arrays(path, remedy="write it again")
    except Exception:  # numpy, zipfile and zlib raise various errors for a damaged file
        raise PackingError(f"{path} cannot be read as .npz: use numpy.savez without Python objects") from None


def check_arrays(path: Path, arrays: dict[str, np.ndarray]) -> tuple[dict, dict]:
    """Arrays for `from_arrays`, including `units` (None if not in the file), and options for `law_by_name`.

    Raises
    ------
    PackingError
        If the file has arrays with other names, or lacks required ones.
    """
    names = (*REQUIRED, *OPTIONAL, *LAW, UNITS)
    for name in arrays:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
            hint = f"did you mean {near[0]!r}?" if near else f"it may contain {', '.join(names)}"
            raise PackingError(f"{path} has an unknown array {name!r}: {hint}")
    for name in REQUIRED:
        if name not in arrays:
            raise PackingError(f"{path} has no array {name!r}: it needs {' and '.join(REQUIRED)}")
    given = {}
    for name in (*LAW, "dim"):
        if name in arrays:
            value = arrays.pop(name)
            if value.ndim:
                raise PackingError(f"{name} has shape {value.shape} in {path}: it must be a single value")
            given[name] = value.item()
    dim = given.pop("dim", 3)
    if not isinstance(dim, int | float) or dim not in (2, 3):
        raise PackingError(f"{path}: dim must be 2 or 3, got {dim}")
    with naming(path), refusing():
        units = units_from(arrays[UNITS].tolist(), int(dim)) if UNITS in arrays else None
    return arrays | {"dim": int(dim), UNITS: units}, given


def write_archive(path: str | Path, frames: list[Frame]) -> list[str]:
    """Write complete states, and the law of the first state, as an archive."""
    path = Path(path)
    if not path.parent.is_dir():
        raise PackingError(f"the folder {path.parent} does not exist: create it first")
    tree: dict = {"law": frames[0].law}
    if frames[0].assumed:
        tree["assumed"] = "\n".join(stored(note) for note in frames[0].assumed)
    if len(frames) == 1:
        tree["state"] = frames[0].state
    else:
        tree["frames"] = {f"{k:06d}": frame.state for k, frame in enumerate(frames)}
    archive.write(path, tree, units=current_units())
    return []


REMEDY = (
    "of HDF5 files, the results.h5 of a run and archives from write_packing or convert are read; "
    "`stickslip docs exchange` lists other formats"
)


def recognize_archive(head: bytes) -> bool:
    """Return True for HDF5, including archives of this package, which begin with a checksum."""
    return b"\x89HDF\r\n\x1a\n" in head


def read_archive(path: Path, wanted: str | None = None) -> list[Packing]:
    """Read the states of an archive, each with its path in the archive and the law stored nearest above it."""
    tree = archive.read(path, remedy=REMEDY)
    states = dict(_find_states(tree))
    if not states:
        raise PackingError(f"{path} contains no state: give an archive of states, or an .npz file")
    some = ", ".join(list(states)[:4]) + (" …" if len(states) > 4 else "")
    if wanted is None and len(states) > 1:
        raise PackingError(f"{path} contains {len(states)} states: choose one with --frame, from {some}")
    if wanted not in (None, "all") and wanted not in states:
        raise PackingError(f"{path} has no state {wanted!r}: it has {some}")
    names = list(states) if wanted in (None, "all") else [wanted]
    assumed = [repeated_note(text) for text in str(tree.get("assumed", "")).splitlines()]
    return [Packing(name, {}, assumed, state=states[name][0], law=states[name][1]) for name in names]


def _find_states(tree: dict, above: str = "", law: Law | None = None):
    """Yield each state in an archive, at any depth, with its name and the law stored nearest above it."""
    law = tree.get("law", law)
    for name, value in tree.items():
        if isinstance(value, State):
            yield above + name, (value, law)
        elif isinstance(value, dict):
            yield from _find_states(value, f"{above}{name}/", law)


def law_from_options(options: dict) -> Law:
    """Law from options, some of which may be None."""
    return law_by_name(**{name: value for name, value in options.items() if value is not None})


GSD_SCHEMA = 2  # schema of the chunks under stickslip/; earlier schemas are also read
PREFIX = "stickslip/"
SHOWN = ("sticking", "sliding")  # types of GSD bonds that stand for contacts
CEMENT = ("bond", "broken bond")  # types of GSD bonds that stand for bonds
META = f"{PREFIX}meta"
ENTRY = np.dtype("<u8, <u8, <i8, <u4, <u2, u1, u1")  # entry of the file index
ENTRY.names = "frame", "rows", "at", "columns", "id", "type", "flags"
NAME, TYPES = 64, np.array([0.0, 1, 2, 4, 8, 1, 2, 4, 8, 4, 8, 1])  # sizes of a name, and of one number by type [bytes]
# memory of a particle or bond [bytes], which it takes even if the file contains only the number of particles or bonds
TAKES = {"particles": 300, "bonds": 20, "angles": 24, "dihedrals": 32, "impropers": 32, "constraints": 16, "pairs": 20}
KINDS = (core.Grains, core.Walls, core.Cell, core.Contacts, core.Control, core.Instant, core.Bonds)
NOUNS = {kind.__name__.lower(): kind for kind in KINDS}


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
    out.bonds.N, out.bonds.types = len(pairs["i"]), [*SHOWN, *(CEMENT if "bond" in pairs else ())]
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
    """Column converted to a type that other programs read: small integers become 32-bit integers."""
    return np.ascontiguousarray(column.astype(np.int32) if column.dtype.kind in "iub" else column)


def _state_chunks(frame: Frame) -> dict[str, np.ndarray]:
    """Chunks of the complete state: flattened arrays, with their shapes and the law as JSON."""
    if frame.moving:
        return {META: _json_chunk({"schema": GSD_SCHEMA, "moving": True})}
    chunks, shapes, state = {}, {}, frame.state._replace(contacts=trimmed(frame.state.contacts))
    for noun in [noun for noun in NOUNS if getattr(state, noun) is not None]:
        for name, value in getattr(state, noun)._asdict().items():
            if value is None:
                continue
            value = np.asarray(value)
            shapes[f"{noun}/{name}"] = [value.dtype.str, list(value.shape)]
            if value.size:
                flat = np.ascontiguousarray(value).ravel()
                chunks[f"{PREFIX}{noun}/{name}"] = flat.astype(np.uint8) if flat.dtype == bool else flat
    meta = {
        "schema": GSD_SCHEMA,
        "moving": False,
        "time": frame.state.time,
        "law": law_to_dict(frame.law),
        "assumed": [stored(note) for note in frame.assumed],
        "shapes": shapes,
    }
    return {META: _json_chunk(meta), **chunks}


def _json_chunk(entries: dict) -> np.ndarray:
    return np.frombuffer(json.dumps(entries).encode(), np.uint8)


def recognize_gsd(head: bytes) -> bool:
    """Return True for GSD files, judged by their first bytes."""
    return head.startswith(b"\xdf\x65" * 4)


def read_gsd(path: Path, frame: str | None = None) -> list[Packing]:
    """Read the frames of a GSD file, named by their number from 0; frames of other programs lack slip and a law.

    Raises
    ------
    PackingError
        If the file is truncated, has an unsupported version, or is not a GSD file.
    """
    hoomd = require("gsd.hoomd", "exchange")
    try:
        sizes = _sizes_of_frames(path)  # checked first, because the library does not check sizes
        with hoomd.open(str(path), "r") as file:
            if not len(file):
                raise PackingError(f"{path} has no frames: give a GSD file with at least one frame")
            names = [str(k) for k in range(len(file))]
            chosen, several = chosen_frames(path, names, frame), choice_note(path, names, frame, "frames")
            budget = Budget(path, path.stat().st_size, remedy="write it again", error=PackingError)
            for k in chosen:
                budget.take(sizes.get(k, 0), f"frame {k}")
                for part, size in TAKES.items():
                    budget.take(size * _number(file.file, k, part), part)
            packings = [_read_frame(path, file, k) for k in chosen]
            return [packing._replace(notes=[*several, *packing.notes]) for packing in packings]
    except PackingError:
        raise
    except (OSError, RuntimeError, KeyError, IndexError, TypeError, ValueError, MemoryError, OverflowError) as problem:
        why = str(problem).replace("\n", " ").strip("'\"")
        raise PackingError(
            f"{path} cannot be read as GSD ({type(problem).__name__}: {why[:120]}): it is truncated, has another "
            f"version, or is not a GSD file"
        ) from None


def _sizes_of_frames(path: Path) -> dict[int, float]:
    """Total size of the chunks of each frame [bytes] according to the file index; chunks may overlap."""
    stored = path.stat().st_size
    with open(path, "rb") as file:
        head = Reader(file.read(40), 8)
        (start, number), (names, most) = (head.array("<u8", 2).tolist() for _ in range(2))
        if start + number * ENTRY.itemsize > stored or names + most * NAME > stored:
            raise ValueError(f"a file of {stored} bytes declares an index of {number} entries and {most} names")
        file.seek(start)
        index = np.frombuffer(file.read(number * ENTRY.itemsize), ENTRY)
    index = index[np.cumprod(index["at"] != 0).astype(bool)]  # the first entry without a location ends the index
    size = TYPES[np.minimum(index["type"], len(TYPES) - 1)] * index["rows"] * index["columns"]
    if ((index["at"] < 0) | (index["at"] + size > stored)).any():
        raise ValueError("a chunk is declared beyond the end of the file")
    frames, places = np.unique(index["frame"], return_inverse=True)
    sizes = np.bincount(places, 8.0 * index["rows"] * index["columns"])  # size in memory, in double precision
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
    if not meta["schema"] <= GSD_SCHEMA:
        raise PackingError(
            f"{path} has stickslip GSD schema {meta['schema']}, but this version reads schemas up to {GSD_SCHEMA}"
        )
    if meta["moving"]:
        raise PackingError(f"{path} is an animation of a mode, not a state: give the packing it was made from")
    parts = {}
    for noun, kind in NOUNS.items():
        fields = {}
        for name in kind._fields:
            if (place := f"{noun}/{name}") in meta["shapes"]:
                dtype, shape = np.dtype(meta["shapes"][place][0]), tuple(meta["shapes"][place][1])
                if dtype.kind not in "biuf":
                    raise ValueError(f"{place} has type {dtype}")
                filled = np.prod(shape, dtype=int)
                flat = file.file.read_chunk(number, PREFIX + place).astype(dtype) if filled else np.zeros(0, dtype)
                fields[name] = flat.reshape(shape) if shape else flat.item()
        if fields:  # only runs with dashpots store forces
            parts[noun] = with_fields(kind, fields)
    state = State(**parts, time=float(meta["time"]))
    check(state)
    notes = [repeated_note(text) for text in meta.get("assumed", ())]
    return Packing(str(number), {}, notes, state=state, law=law_from_dict(meta["law"]))


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
        if getattr(frame, name).N and tuple(getattr(frame, name).types or ())[:2] != SHOWN:
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
