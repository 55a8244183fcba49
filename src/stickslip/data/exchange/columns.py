"""Columns of grains and contacts, identified by the names that programs use or, without names, by their content."""

import re
from pathlib import Path

import numpy as np

from ...known import HARMLESS, USED
from ..sample import COLUMNS, Assumption, Obstacle, PackingError, account_for
from .content import HEAD, Packing, read_content

PLACES = (
    "", "pos", "position", "positions", "point", "points", "coord", "coordinate", "coordinates", "coords", "center",
    "centers", "centre", "centres", "c", "p", "x",
)  # fmt: skip
MOTIONS = ("v", "vel", "velo", "velocity", "velocities", "linvel", "linvelvec")
TURNS = ("w", "omega", "spin", "angvel", "angvelvec", "angularvelocity")
SINGLE = {
    "radius": ("r", "rad", "radius", "radii", "ballradius", "particleradius", "cradius"),
    "diameter": ("d", "dia", "diam", "diameter", "diameters", "particlediameter", "cdiameter", "durchmesser"),
    "mass": ("m", "mass", "masses", "particlemass"),
    "density": ("rho", "density", "densities"),
    "id": ("id", "ids", "particleid", "ballid", "atomid", "grainid", "trackid", "particle", "grain", "track"),
}
KINDS = (
    "type", "types", "material", "materials", "mat", "matid", "materialid", "species", "kind", "atomtype",
    "particletype", "particlematerial",
)  # fmt: skip
TIMES = ("time", "t", "step", "timestep", "frame", "times")
VECTORS = {"position": PLACES, "velocity": MOTIONS, "spin": TURNS}
LENGTHS = {p + a for p in PLACES for a in "xyz"} | {a + p for p in PLACES for a in "xyz"}  # names of columns
LENGTHS |= {*SINGLE["radius"], *SINGLE["diameter"]}
CLOSE = 1e-3  # relative tolerance for numbers with few digits
NEEDED = "x y z (or x y, in a plane) and radius (or diameter)"
UNIT = re.compile(r"[\[(](.*?)[\])]|[_ ](m|cm|mm|um|µm|μm|micron|nm)$", re.IGNORECASE)  # after the name of a column
PHASES = 10  # kinds of grains in MFIX, each of one radius and density


def plain_name(name: str) -> str:
    """Name of a column in lower case, without units and punctuation: "Pos_X [mm]" and "pos_x_mm" become "posx"."""
    return re.sub(r"[^a-z0-9]", "", UNIT.sub("", name.lower().strip()))


def names_by_content(rows: np.ndarray) -> list[str] | None:
    """Names for unnamed columns of grains, from their content; None if no known layout fits.

    A first column that counts the rows, from 0 or 1, is read as ids, unless it may be the coordinate of grains in a
    row. Eight columns, or six in a plane, are read as MFIX's particle_input.dat, version 1; any other six as lists of
    PeGS2 and RigidLibrary.
    """
    count, width = rows.shape
    counts = count > 0 and rows[0, 0] in (0, 1) and bool((rows[:, 0] == rows[0, 0] + np.arange(count)).all())
    if width == 5:
        return ["id", "x", "y", "z", "radius"] if counts else None
    if width == 4:
        return (
            ["id", "x", "y", "radius"] if counts and np.ptp(rows[:, 1:3], axis=0).all() else ["x", "y", "z", "radius"]
        )
    if width == 6 and (rows[:, :2] == np.round(rows[:, :2])).all() and np.isin(rows[:, 5], (-1, 0, 1)).all():
        return ["frame", "id", "x", "y", "radius", "edge"]
    size = width // 2 - 1  # the first of radius and density
    if width in (6, 8) and (sizes := rows[:, size : size + 2]).min(initial=1.0) > 0:
        names = [*"xyz"[:size], "radius", "density", *("vx", "vy", "vz")[:size]]
        return names if len(np.unique(sizes, axis=0)) <= PHASES else None
    return None


def is_matlab(path: Path) -> bool:
    """Return True for a MATLAB file."""
    return path.is_file() and read_content(path, HEAD).startswith(b"MATLAB ")


def identify_columns(columns: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns by the names used here, vectors (N, 2) or (N, 3), others (N,); and the names of unused ones."""
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
        If positions or radii are missing; the message lists the columns.
    """
    known, rest = identify_columns(columns)
    if "position" not in known or not {"radius", "diameter"} & set(known):
        some = " ".join(list(columns)[:20])
        lacks = "no positions" if "position" not in known else "no radii"
        there = f"columns {some}: {lacks} among them;" if some else "no columns:"
        raise PackingError(f"{what} has {there} {NEEDED} are needed, under such names")
    count = len(known["position"])
    for column, values in columns.items():
        if column not in rest and np.ndim(values) and len(values) != count:
            raise PackingError(f"{what} has {len(values)} values of {column} for {count} grains: write it again")
    notes = []
    whole = [name for name in rest if np.ndim(columns[name]) and len(columns[name]) != count]  # not one row per grain
    if whole:
        has = "has" if len(whole) == 1 else "have"
        notes.append(Assumption(f"{what}: {', '.join(whole)} {has} no row for each grain", COLUMNS))
    if known["position"].shape[1] == 2 or not np.any(known["position"][:, 2:]):
        more = {**more, "dim": 2}
        notes.append(Assumption(f"{what} has no third coordinate: its grains are treated as disks in a plane"))
    if known.get("spin", np.zeros((0, 3))).shape[1] != 3:
        del known["spin"]
    if "spin" not in known and more.get("dim") == 2 and (turn := _column_of(TURNS, rest, columns)):
        known["spin"] = np.outer(columns[turn], [0.0, 0.0, 1.0])
        rest = [name for name in rest if name != turn]
    if kind := _column_of(KINDS, rest, columns):
        known["types"], rest = _number_kinds(np.asarray(columns[kind])), [name for name in rest if name != kind]
    ids = known.get("id")
    if ids is not None and not (len(np.unique(ids)) == len(ids) and (ids == np.round(ids)).all()):
        del known["id"]
        value, times = max(zip(*np.unique(ids, return_counts=True), strict=True), key=lambda one: one[1])
        why = f"has grain {value:g} {times} times" if times > 1 else "has ids that are not whole numbers"
        notes.append(Assumption(f"{what} {why}: ids are ignored, and each row is treated as a grain", COLUMNS))
    ids, arrays, said = arrange_grains(what, known, more.get("dim", 3))
    types = arrays.pop("types", None)
    notes += [*said, *_notes_on_columns(what, columns, rest)]
    return Packing(name, arrays | more, notes, ids=ids, types=types)


def arrange_grains(
    what: str, known: dict[str, np.ndarray], dim: int = 3, *, volume: float | None = None
) -> tuple[np.ndarray | None, dict, list[str]]:
    """Ids and arrays of grains sorted by id, and notes on missing or contradictory data.

    Parameters
    ----------
    known : columns by the names of `from_arrays`, `radius` or `diameter`, and `id`, `types`, `force`
    volume : volume of a grain of radius 1, for formats in which densities always refer to spheres
    """
    arrays = {n: known[n] for n in ("position", "velocity", "spin", "mass", "types", "force") if n in known}
    arrays["radius"] = known["radius"] if "radius" in known else known["diameter"] / 2
    notes = contradictions(what, known, dim)
    if "mass" not in known:
        density = known.get("density", 1.0)
        arrays |= {"density": density} if volume is None else {"mass": density * volume * arrays["radius"] ** 3}
        notes += [] if "density" in known else [mass_note(what)]
    notes += at_rest(what, known)
    if "id" not in known:
        return None, arrays, notes
    order = np.argsort(known["id"], kind="stable")
    ids = known["id"][order].astype(np.int64)
    return ids, {name: column[order] if np.ndim(column) else column for name, column in arrays.items()}, notes


def _column_of(names: tuple[str, ...], rest: list[str], columns: dict[str, np.ndarray]) -> str | None:
    """The first remaining scalar column with one of these names."""
    return next((name for name in rest if plain_name(name) in names and np.ndim(columns[name]) == 1), None)


def _number_kinds(kinds: np.ndarray) -> np.ndarray:
    """(N,) kinds of grains from 0: unchanged if they are such numbers, otherwise numbered in sorted order."""
    if (kinds == np.round(kinds)).all() and kinds.min(initial=0) == 0:
        return kinds.astype(np.int64)
    return np.unique(kinds, return_inverse=True)[1]


def _notes_on_columns(what: str, columns: dict[str, np.ndarray], rest: list[str]) -> list[str]:
    """Account of the columns, and notes on unknown ones.

    Columns of zeros have no effect; accelerations that differ between grains include those due to contacts.
    """
    groups = {name: USED for name in columns if name not in rest}
    for name in rest:
        column = np.atleast_1d(columns[name])
        own = len(column) and re.fullmatch(r"accel.*|a.", plain_name(name)) and np.ptp(column, axis=0).any()
        if np.ndim(columns[name]) and (own or not np.any(column)):
            groups[name] = HARMLESS
    return account_for("column of a table", columns, what, groups, plain_name)


def contradictions(what: str, known: dict[str, np.ndarray], dim: int = 3) -> list[str]:
    """Notes on radii and masses that contradict the diameters and densities of the same grains.

    A common factor of all grains, such as another unit of density, does not change the sign of an eigenvalue.
    """
    radius = known["radius"] if "radius" in known else known["diameter"] / 2
    if not len(radius):
        return []
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
            notes.append(Obstacle(f"{told}, in row {k + 1} of {len(ours)}: leave out one of them"))
    return notes


def at_rest(what: str, known: dict) -> list[Assumption]:
    """Note that motion missing from a file is assumed to be zero."""
    lacking = [word for name, word in (("velocity", "velocities"), ("spin", "spins")) if name not in known]
    if not lacking:
        return []
    how = {"velocities": "not to move", "spins": "not to turn"}[lacking[0]] if len(lacking) == 1 else "to be at rest"
    return [Assumption(f"{what} has no {' and no '.join(lacking)}: the grains are assumed {how}")]


def mass_note(what: str) -> Assumption:
    """Note on missing masses."""
    return Assumption(f"{what} has no masses: a density of 1 is assumed")


SLACK = 1e-3  # relative tolerance for numbers with few digits
MOST = 40  # columns
TOTAL = "Fx", "Fy", "Fz"


def pair_branches(packing: Packing, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(M, 3) vectors from grain j to the nearest image of grain i [length]."""
    position = np.asarray(packing.arrays["position"])
    branch = position[i] - position[j]
    if "cell" in packing.arrays:
        cell, periodic = np.asarray(packing.arrays["cell"]), np.asarray(packing.arrays.get("periodic", (True,) * 3))
        for axis in (2, 1, 0):
            if periodic[axis]:
                branch = branch - np.round(branch[:, axis] / cell[axis, axis])[:, None] * cell[axis]
    return branch


def group_hint(packing: Packing) -> str:
    """Sentence stating that gaps in the ids suggest the grains of a group; empty without gaps."""
    ids = np.zeros(0, int) if packing.ids is None else packing.ids
    if not len(ids) or ids[-1] == len(ids):
        return ""
    return f"the {len(ids)} grains have ids up to {ids[-1]}, as in the dump of a group: give a dump of all grains"


def name_contact_columns(values: np.ndarray, packing: Packing, path: Path) -> list[str]:
    """Names of columns of contacts in their order; "" for unused columns.

    The two id columns name grains that touch. The distance and the branch vector of each pair follow from the
    positions of its grains. A normal force is parallel to the branch vector, a tangential one perpendicular to it.
    Without either, the last three columns that are neither positions nor distances are the total force.

    Parameters
    ----------
    values : (M, columns)

    Raises
    ------
    PackingError
        If no columns fit.
    """
    names, ids = [""] * values.shape[1], packing.ids
    ends = next((k for k in range(min(values.shape[1], MOST) - 1) if _are_pairs(values[:, k : k + 2], packing)), None)
    if ends is None or ids is None:
        raise PackingError(
            f"{path} has {values.shape[1]} unnamed columns, none of which contain ids of touching grains: "
            f"{group_hint(packing) or 'its grains are those of another time step or run, or name its columns'}"
        )
    i, j = np.searchsorted(ids, values[:, ends : ends + 2].astype(np.int64)).T
    names[ends : ends + 2] = "i", "j"
    branch = pair_branches(packing, i, j)
    length = np.linalg.norm(branch, axis=1)
    for k in range(values.shape[1]):
        if not names[k] and _is_small(values[:, k] - length, length):
            names[k] = "dist"
            break
    normal, at = branch / length[:, None], 0
    while at + 3 <= min(values.shape[1], MOST):
        kind = "" if any(names[at : at + 3]) else _kind_of_vector(values[:, at : at + 3], branch, normal, names)
        names[at : at + 3] = [kind + axis for axis in "xyz"] if kind else names[at : at + 3]
        at += 3 if kind else 1
    if "tx" in names:
        return names
    return _with_total_force(names, values, packing, (i, j), normal)


def _is_small(rest: np.ndarray, whole: np.ndarray) -> bool:
    """Return True if the remainder is a small fraction of the whole."""
    return bool(np.abs(rest).sum() <= SLACK * np.abs(whole).sum())


def _are_pairs(columns: np.ndarray, packing: Packing) -> bool:
    """Return True if two columns are ids of grains and nearly all pairs touch."""
    if not (columns == np.round(columns)).all() or not np.isin(columns, packing.ids).all():
        return False
    i, j = np.searchsorted(packing.ids, columns.astype(np.int64)).T
    reach = np.asarray(packing.arrays["radius"])[i] + np.asarray(packing.arrays["radius"])[j]
    near = np.linalg.norm(pair_branches(packing, i, j), axis=1) < (1 + SLACK) * reach
    return bool((i != j).all() and near.mean() > 0.9)


def _kind_of_vector(vector: np.ndarray, branch: np.ndarray, normal: np.ndarray, names: list[str]) -> str:
    """Kind of three columns: "d" branch vector, "f" normal force, "t" tangential force, "" otherwise."""
    along = np.einsum("ck,ck->c", vector, normal)
    across = vector - along[:, None] * normal
    if "dx" not in names and _is_small(vector - branch, branch):
        return "d"
    if "fx" not in names and along.any() and _is_small(across, along) and along.sum() > 0:
        return "f"
    known = across.any() or "fx" in names  # without friction, tangential forces are zero
    return "t" if "tx" not in names and known and _is_small(along, across) else ""


def _with_total_force(names: list[str], values: np.ndarray, packing: Packing, ends, normal: np.ndarray) -> list[str]:
    """Name the columns of the total force on the first grain, which presses the grains apart."""
    position = np.asarray(packing.arrays["position"])
    flags = (values == np.round(values)).all(axis=0)
    for at in range(values.shape[1] - 3, -1, -1):
        vector = values[:, at : at + 3]
        known = any(names[at : at + 3]) or flags[at : at + 3].all()
        if known or any(_is_small(vector - position[end], position[end]) for end in ends):
            continue
        along = np.einsum("ck,ck->c", vector, normal)
        if along.sum() > 0.5 * np.linalg.norm(vector, axis=1).sum():
            names[at : at + 3] = TOTAL
            break
    return names
