"""Columns of grains under the names that programs give them: positions, radii, masses, velocities, numbers."""

import re

import numpy as np

from ..sample import Assumption, PackingError
from .content import Packing

PLACES = (
    "",
    "pos",
    "position",
    "point",
    "points",
    "coord",
    "coordinate",
    "coordinates",
    "center",
    "centre",
    "c",
    "p",
    "x",
)
MOTIONS = ("v", "vel", "velo", "velocity", "velocities", "linvel", "linvelvec")
TURNS = ("w", "omega", "spin", "angvel", "angvelvec", "angularvelocity")
SINGLE = {
    "radius": ("r", "rad", "radius", "radii", "ballradius"),
    "diameter": ("d", "dia", "diam", "diameter"),
    "mass": ("m", "mass", "masses"),
    "density": ("rho", "density"),
    "id": ("id", "ids", "particleid", "ballid", "atomid"),
}
VECTORS = {"position": PLACES, "velocity": MOTIONS, "spin": TURNS}
LENGTHS = {p + a for p in PLACES for a in "xyz"} | {a + p for p in PLACES for a in "xyz"}  # names of columns
LENGTHS |= {*SINGLE["radius"], *SINGLE["diameter"]}
NEEDED = "x y z (or x y, in a plane) and radius (or diameter)"


def plain_name(name: str) -> str:
    """Name of a column in small letters, without units and punctuation: "Pos_X [mm]" becomes "posx"."""
    return re.sub(r"[^a-z0-9]", "", re.sub(r"[\[(].*?[\])]", "", name.lower()))


def identify_columns(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns by the names used here: vectors (N, 2) or (N, 3), others (N,); columns of other names are left out."""
    plain = {plain_name(name): np.asarray(value) for name, value in columns.items()}
    out = {}
    for noun, names in SINGLE.items():
        match = next((plain[name] for name in names if name in plain and plain[name].ndim == 1), None)
        if match is not None:
            out[noun] = match
    for noun, prefixes in VECTORS.items():
        vector = _find_vector(plain, prefixes)
        if vector is not None:
            out[noun] = vector
    return out


def _find_vector(plain: dict[str, np.ndarray], prefixes) -> np.ndarray | None:
    """Vector from one column with two or three components, or from a column for each."""
    for prefix in prefixes:
        whole = plain.get(prefix)
        if whole is not None and whole.ndim == 2 and whole.shape[1] in (2, 3):
            return whole
        for axes in ("xyz", "012", "123"):
            parts = [n for a in axes for n in (prefix + a, a + prefix) if n in plain and plain[n].ndim == 1]
            parts = list(dict.fromkeys(parts))
            if len(parts) >= 2 and (prefix or axes == "xyz"):
                return np.stack([plain[name] for name in parts], axis=1)
    return None


def packing_of_columns(columns: dict[str, np.ndarray], what: str, name: str = "", **more) -> Packing:
    """Packing from columns; `what` names the file, and `more` holds further entries of `Packing.arrays`.

    Raises
    ------
    PackingError
        if there are no positions or no radii, with the columns that there are.
    """
    known = identify_columns(columns)
    if "position" not in known or not {"radius", "diameter"} & set(known):
        some = " ".join(list(columns)[:20])
        lacks = "no positions" if "position" not in known else "no radii"
        there = f"columns {some}: {lacks} among them;" if some else "no columns:"
        raise PackingError(f"{what} has {there} {NEEDED} are needed, under such names")
    arrays, notes = {n: known[n] for n in ("position", "velocity", "mass") if n in known}, []
    arrays["radius"] = known["radius"] if "radius" in known else known["diameter"] / 2
    arrays |= more
    if arrays["position"].shape[1] == 2 or not np.any(arrays["position"][:, 2:]):
        arrays["dim"] = 2
        notes.append(Assumption(f"{what} has no third coordinate: its grains are taken as disks in a plane"))
    if "spin" in known and known["spin"].shape[1] == 3:
        arrays["spin"] = known["spin"]
    if "mass" not in arrays:
        arrays["density"] = known.get("density", 1.0)
        notes += [] if "density" in known else [mass_note(what)]
    ids = known.get("id")
    if ids is not None and len(np.unique(ids)) == len(ids) and (ids == np.round(ids)).all():
        order = np.argsort(ids, kind="stable")
        ids = ids[order].astype(np.int64)
        arrays = {
            n: a[order] if np.ndim(a) and len(a) == len(order) and n not in UNSORTED else a for n, a in arrays.items()
        }
    else:
        ids = None
    return Packing(name, arrays, notes, ids=ids)


UNSORTED = ("cell", "periodic")


def mass_note(what: str) -> Assumption:
    """Note on masses that a file does not have."""
    return Assumption(f"{what} has no masses: those of grains of density 1 are assumed")
