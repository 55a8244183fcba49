"""Columns of grains under the names that programs give them: positions, radii, masses, velocities, numbers."""

import re

import numpy as np

from ...known import HARMLESS, USED
from ..sample import Assumption, Obstacle, PackingError, account_for
from .content import Packing

PLACES = (
    "", "pos", "position", "positions", "point", "points", "coord", "coordinate", "coordinates", "coords", "center",
    "centers", "centre", "centres", "c", "p", "x",
)  # fmt: skip
MOTIONS = ("v", "vel", "velo", "velocity", "velocities", "linvel", "linvelvec")
TURNS = ("w", "omega", "spin", "angvel", "angvelvec", "angularvelocity")
SINGLE = {
    "radius": ("r", "rad", "radius", "radii", "ballradius", "particleradius"),
    "diameter": ("d", "dia", "diam", "diameter", "diameters", "particlediameter"),
    "mass": ("m", "mass", "masses", "particlemass"),
    "density": ("rho", "density", "densities"),
    "id": ("id", "ids", "particleid", "ballid", "atomid"),
}
KINDS = (
    "type",
    "types",
    "material",
    "materials",
    "mat",
    "matid",
    "materialid",
    "species",
    "kind",
    "atomtype",
    "particletype",
    "particlematerial",
)
TIMES = ("time", "t", "step", "timestep", "frame", "times")
VECTORS = {"position": PLACES, "velocity": MOTIONS, "spin": TURNS}
LENGTHS = {p + a for p in PLACES for a in "xyz"} | {a + p for p in PLACES for a in "xyz"}  # names of columns
LENGTHS |= {*SINGLE["radius"], *SINGLE["diameter"]}
CLOSE = 1e-3  # relative deviation of numbers with few digits
NEEDED = "x y z (or x y, in a plane) and radius (or diameter)"


def plain_name(name: str) -> str:
    """Name of a column in small letters, without units and punctuation: "Pos_X [mm]" becomes "posx"."""
    return re.sub(r"[^a-z0-9]", "", re.sub(r"[\[(].*?[\])]", "", name.lower()))


def identify_columns(columns: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns by the names used here, vectors (N, 2) or (N, 3), others (N,); and the names of those left out."""
    plain = {plain_name(name): np.asarray(value) for name, value in columns.items()}
    out, taken = {}, set()
    for noun, names in SINGLE.items():
        match = next((name for name in names if name in plain and plain[name].ndim == 1), None)
        if match is not None:
            out[noun] = plain[match]
            taken |= set(names)
    for noun, prefixes in VECTORS.items():
        vector, names = _find_vector(plain, prefixes)
        if vector is not None:
            out[noun] = vector
            taken |= set(names)
    return out, [name for name in columns if plain_name(name) not in taken]


def _find_vector(plain: dict[str, np.ndarray], prefixes) -> tuple[np.ndarray | None, list[str]]:
    """Vector from one column with two or three components, or from a column for each, and the names of these."""
    for prefix in prefixes:
        whole = plain.get(prefix)
        if whole is not None and whole.ndim == 2 and whole.shape[1] in (2, 3):
            return whole, [prefix]
        for axes in ("xyz", "012", "123"):
            parts = [n for a in axes for n in (prefix + a, a + prefix) if n in plain and plain[n].ndim == 1]
            parts = list(dict.fromkeys(parts))
            if len(parts) >= 2 and (prefix or axes == "xyz"):
                return np.stack([plain[name] for name in parts], axis=1), parts
    return None, []


def packing_of_columns(columns: dict[str, np.ndarray], what: str, name: str = "", **more) -> Packing:
    """Packing from columns; `what` names the file, and `more` holds further entries of `Packing.arrays`.

    Raises
    ------
    PackingError
        if there are no positions or no radii, with the columns that there are.
    """
    known, rest = identify_columns(columns)
    if "position" not in known or not {"radius", "diameter"} & set(known):
        some = " ".join(list(columns)[:20])
        lacks = "no positions" if "position" not in known else "no radii"
        there = f"columns {some}: {lacks} among them;" if some else "no columns:"
        raise PackingError(f"{what} has {there} {NEEDED} are needed, under such names")
    arrays = {n: known[n] for n in ("position", "velocity", "mass") if n in known}
    arrays["radius"] = known["radius"] if "radius" in known else known["diameter"] / 2
    arrays |= more
    notes = []
    if arrays["position"].shape[1] == 2 or not np.any(arrays["position"][:, 2:]):
        arrays["dim"] = 2
        notes.append(Assumption(f"{what} has no third coordinate: its grains are taken as disks in a plane"))
    if "spin" in known and known["spin"].shape[1] == 3:
        arrays["spin"] = known["spin"]
    elif arrays.get("dim") == 2 and (turn := _column_of(TURNS, rest, columns)):
        arrays["spin"] = np.outer(columns[turn], [0.0, 0.0, 1.0])
        rest = [name for name in rest if name != turn]
    if "mass" not in arrays:
        arrays["density"] = known.get("density", 1.0)
        notes += [] if "density" in known else [mass_note(what)]
    types = None
    if kind := _column_of(KINDS, rest, columns):
        types, rest = _numbered(np.asarray(columns[kind])), [name for name in rest if name != kind]
    notes += [
        *contradictions(what, known, arrays.get("dim", 3)),
        *at_rest(what, arrays),
        *_notes_on_columns(what, columns, rest),
    ]
    ids = known.get("id")
    if ids is not None and len(np.unique(ids)) == len(ids) and (ids == np.round(ids)).all():
        order = np.argsort(ids, kind="stable")
        ids = ids[order].astype(np.int64)
        arrays = {
            n: a[order] if np.ndim(a) and len(a) == len(order) and n not in UNSORTED else a for n, a in arrays.items()
        }
        types = None if types is None else types[order]
    else:
        ids = None
    return Packing(name, arrays, notes, ids=ids, types=types)


def _column_of(names: tuple[str, ...], rest: list[str], columns: dict[str, np.ndarray]) -> str | None:
    """The first of the remaining columns of single numbers that has one of the names."""
    return next((name for name in rest if plain_name(name) in names and np.ndim(columns[name]) == 1), None)


def _numbered(kinds: np.ndarray) -> np.ndarray:
    """(N,) kinds of grains from 0: as they are if they are such numbers, and otherwise in their order."""
    if (kinds == np.round(kinds)).all() and kinds.min(initial=0) == 0:
        return kinds.astype(np.int64)
    return np.unique(kinds, return_inverse=True)[1]


def _notes_on_columns(what: str, columns: dict[str, np.ndarray], rest: list[str]) -> list[str]:
    """Account of the columns, and notes on those that are not understood; what is zero everywhere acts on nothing."""
    used = {name: USED for name in columns if name not in rest}
    zero = {name: HARMLESS for name in rest if np.ndim(columns[name]) and not np.any(columns[name])}
    own = {name: HARMLESS for name in rest if _differs(plain_name(name), np.asarray(columns[name]))}
    return account_for("column of a table", columns, what, used | zero | own, plain_name)


def _differs(name: str, column: np.ndarray) -> bool:
    """Whether a column has accelerations that differ from grain to grain, which are those by contacts as well."""
    return bool(re.fullmatch(r"accel.*|a.", name)) and column.ndim > 0 and bool(np.ptp(column, axis=0).any())


def at_rest(what: str, arrays: dict) -> list[str]:
    """Note that motion which a file does not have is taken to be zero."""
    lacking = [word for name, word in (("velocity", "velocities"), ("spin", "spins")) if name not in arrays]
    if not lacking:
        return []
    how = {"velocities": "not to move", "spins": "not to turn"}[lacking[0]] if len(lacking) == 1 else "to be at rest"
    return [Assumption(f"{what} has no {' and no '.join(lacking)}: the grains are taken {how}")]


UNSORTED = ("cell", "periodic")


def contradictions(what: str, known: dict[str, np.ndarray], dim: int = 3) -> list[str]:
    """Notes on radii and masses that differ from the diameters and densities of the same grains.

    A factor that is the same for all grains, as of another unit of density, changes no sign of an eigenvalue.
    """
    radius = known["radius"] if "radius" in known else known["diameter"] / 2
    pairs = [("radius", "half the diameter", radius, known["diameter"] / 2)] if "diameter" in known else []
    if {"mass", "density"} <= set(known):
        volumes = [4 / 3 * np.pi * radius**3, *([np.pi * radius**2] if dim == 2 else [])]
        weighed = min((known["density"] * volume for volume in volumes), key=lambda m: np.abs(m - known["mass"]).max())
        pairs.append(("mass", "density times volume", known["mass"], weighed))
    notes = []
    for name, other, ours, theirs in pairs:
        k = int(np.argmax(np.abs(ours - theirs)))
        told = f"{what}: {name} is {ours[k]:.4g}, and {other} {theirs[k]:.4g}"
        same = np.ptp(ours * theirs[k] - theirs * ours[k]) <= CLOSE * abs(ours[k] * theirs[k])
        if abs(ours[k] - theirs[k]) <= CLOSE * abs(ours[k]):
            continue
        if name == "mass" and same:
            notes.append(Assumption(f"{told}: {name} is used"))
        else:
            notes.append(Obstacle(f"{told}, in row {k + 1} of {len(ours)}: leave one of them out"))
    return notes


def mass_note(what: str) -> Assumption:
    """Note on masses that a file does not have."""
    return Assumption(f"{what} has no masses: those of grains of density 1 are assumed")
