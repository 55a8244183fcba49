"""This package's own formats: .npz files with the arrays of `from_arrays`, and HDF5 archives."""

import difflib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...core.contacts.bonding import with_bonds
from ...core.laws.builtin import (
    DAMPING_N,
    DAMPING_T,
    KEEPS_FORCE,
    KN,
    KT,
    LEVER,
    MU,
    NO_TENSION,
    PARAMETERS,
    ROLLING,
    TWISTING,
    Law,
)
from ...core.laws.kinds import Kind, own_memory
from ...core.laws.properties import resists_rolling
from ...core.reading import NPY, read_arrays
from ...core.state import Bonds, State
from ...core.units import Units, current_units, units_from
from ..run_files import replace_atomically
from ..sample import COLUMNS, Assumption, PackingError, law_by_name, repeated_note
from .columns import packing_of_columns
from .content import Packing, extent_note, only_state
from .frame import Frame, law_to_dict, list_losses, without_walls

REQUIRED = ("position", "radius")
CONTACTS = ("pair_i", "pair_j", "image", "slip", "mode")
MOTION = ("velocity", "spin", "angle")
BOND = "bond_"  # begins the names of the fields of bonds
BONDS = tuple(f"{BOND}{name}" for name in Bonds._fields)
OPTIONAL = (*BONDS, "mass", "density", "cell", "periodic", *CONTACTS, *MOTION, "external_force", "dim", "i0", "assumed")
UNITS = "units"  # optional: "SI", or names of length, mass and time
PROPERTIES = {
    LEVER: "lever arms R − δ/2", KEEPS_FORCE: "memory of forces", ROLLING: "rolling moments",
    TWISTING: "twisting moments",
}  # fmt: skip
# optional: the law of the packing
LAW = ("law", "coulomb", "kn", "kt", "mu", "damping", "damping_n", "damping_t", "tension")


def write_npz(path: str | Path, frame: Frame) -> list[str]:
    """Write the arrays of `from_arrays`, and the law if it has one material; return notes on lost information."""
    state, law = frame.state, frame.law
    grains, control, n = state.grains, state.control, len(state.grains.radius)
    pairs, notes = without_walls(frame)
    if "bond" in pairs:  # contacts alone
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
        values = law.table[0, 0]
        arrays |= {k: v for k, v in law_to_dict(law).items() if k in ("law", "coulomb", "damping")}
        arrays |= {"tension": False} if law.damping & NO_TENSION else {}
        numbers = {"kn": KN, "kt": KT, "mu": MU, "damping_n": DAMPING_N, "damping_t": DAMPING_T}
        arrays |= {name: values[column] for name, column in numbers.items()}
        assumed = [*frame.assumed, *(f"left out, as .npz does not store it: {text}" for text in left)]
        arrays |= {"assumed": assumed} if assumed else {}
    with replace_atomically(Path(path)) as part:
        np.savez(part, **arrays)
    return notes + ([f".npz does not store {', '.join(lost)}"] if lost else [])


def recognize(head: bytes) -> bool:
    """Return True for NumPy's .npz and .npy."""
    return head.startswith((b"PK\x03\x04", NPY))


def read(path: Path, frame: str | None = None) -> list[Packing]:
    """Read arrays with this package's names or usual ones such as x and radius, or one array of x y z radius."""
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
        packing = packing_of_columns(arrays, path.name, path.stem)
        return [packing._replace(notes=[*packing.notes, *notes])]
    arrays, given = check_arrays(path, arrays)
    del arrays["units"]
    notes = [repeated_note(text) for text in np.atleast_1d(arrays.pop("assumed", [])).tolist()]
    bonds = {name: arrays.pop(name) for name in BONDS if name in arrays}
    return [Packing(path.stem, arrays, notes, law=given or None, setting=_bonding(path, bonds) if bonds else None)]


def _bonding(path: Path, arrays: dict[str, np.ndarray]) -> Callable[[State], State]:
    """Function that adds bonds, given by their fields in a file, to the grains of a state."""
    if missing := sorted({*BONDS} - {*arrays}):
        raise PackingError(f"{path} has {min(arrays)!r} but not {missing[0]!r}: bonds need all of {', '.join(BONDS)}")

    def add_bonds(state: State) -> State:
        bonds = Bonds(**{name.removeprefix(BOND): values for name, values in arrays.items()})
        try:
            state._replace(bonds=bonds).check_entries()
            return with_bonds(state, bonds)
        except ValueError as problem:
            raise PackingError(f"{path}: {problem}") from None

    return add_bonds


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a NumPy file by name; that of an .npy file has the name ""."""
    try:
        return read_arrays(path, remedy="write it again")
    except Exception:  # numpy, zipfile and zlib raise various errors for a damaged file
        raise PackingError(f"{path} cannot be read as .npz: write it with numpy.savez, without objects") from None


def check_arrays(path: Path, arrays: dict[str, np.ndarray]) -> tuple[dict, dict]:
    """Arrays for `from_arrays`, with `units` or None, and options for `law_by_name`.

    Raises
    ------
    PackingError
        If the file has arrays with other names, or lacks some.
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
    return arrays | {"dim": int(dim), UNITS: _units(path, arrays.get(UNITS), int(dim))}, given


def _units(path: Path, given: np.ndarray | None, dim: int) -> Units | None:
    if given is None:
        return None
    try:
        return units_from(given.tolist(), dim)
    except ValueError as problem:
        raise PackingError(f"{path}: {problem}") from None


def write_archive(path: str | Path, frames: list[Frame]) -> list[str]:
    """Write complete states, and the law of the first, as an archive."""
    path = Path(path)
    if not path.parent.is_dir():
        raise PackingError(f"the folder {path.parent} does not exist: create it first")
    tree: dict = {"law": frames[0].law} | ({"assumed": "\n".join(frames[0].assumed)} if frames[0].assumed else {})
    if len(frames) == 1:
        tree["state"] = frames[0].state
    else:
        tree["frames"] = {f"{k:06d}": frame.state for k, frame in enumerate(frames)}
    from .. import archive  # imports h5py

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
    """Read the states of an archive, each with its path in the archive and the nearest law above it."""
    from .. import archive  # imports h5py

    tree = archive.read(path, remedy=REMEDY)
    states = dict(_find_states(tree))
    if not states:
        raise PackingError(f"{path} contains no state: give an archive of states, or an .npz")
    some = ", ".join(list(states)[:4]) + (" …" if len(states) > 4 else "")
    if wanted is None and len(states) > 1:
        raise PackingError(f"{path} contains {len(states)} states: choose one with --frame, from {some}")
    if wanted not in (None, "all") and wanted not in states:
        raise PackingError(f"{path} has no state {wanted!r}: it has {some}")
    names = list(states) if wanted in (None, "all") else [wanted]
    assumed = [repeated_note(text) for text in str(tree.get("assumed", "")).splitlines()]
    return [Packing(name, {}, assumed, state=states[name], law=_law_above(tree, name)) for name in names]


def _law_above(tree: dict, name: str) -> Law | None:
    holder, law = tree, tree.get("law")
    for part in name.split("/")[:-1]:
        holder = holder[part]
        law = holder.get("law", law) if isinstance(holder, dict) else law
    return law


def _find_states(tree: dict, above: str = ""):
    """Yield the names and values of all states in an archive, at any depth."""
    for name, value in tree.items():
        if isinstance(value, State):
            yield above + name, value
        elif isinstance(value, dict):
            yield from _find_states(value, f"{above}{name}/")


def law_from_options(options: dict) -> Law:
    """Law from options, some of which may be None."""
    return law_by_name(**{name: value for name, value in options.items() if value is not None})
