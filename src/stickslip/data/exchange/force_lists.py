"""Tables of grains and contact forces, with headings, or without them as in the lists of PeGS2 and RigidLibrary."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from ...known import USED
from ..sample import Assumption, PackingError, account_for
from .columns import (
    HEAD,
    chosen_frames,
    head_text,
    identify_columns,
    packing_of_columns,
    plain_name,
    read_content,
    read_lines,
)
from .table_file import names_of, read_columns, recognize

PIXELS = ("px", "pix", "pixel", "pixels")
NEEDED, FORCES = ("i", "j", "fn", "ft"), ("fn", "ft", "fnerror", "fterror")
OPTIONAL = ("fixed", "edge", "loadx", "loady", "loadz", "positionerror")  # columns of grains, named as by `plain_name`
FRAMES = ("frame", "step", "timestep", "time")
WIDEST = 1.0  # largest gap or overlap of grains in contact, over the smaller radius
FAR = 5.0  # number of standard errors beyond which a negative normal force is impossible
# readings of contacts at both grains are opposite if the mean square of their averages, over that of half their
# differences, is below this
OPPOSITE = 0.05
FEW = 0.1  # largest fraction of contacts that may pull if errors are unknown
SIGNED = 10  # number of tangential forces whose common sign is unlikely to be due to chance
NAMELESS_GRAINS = {
    3: ["x", "y", "radius"], 4: ["x", "y", "z", "radius"], 5: ["id", "x", "y", "radius", "edge"],
    6: ["frame", "id", "x", "y", "radius", "edge"],
}  # fmt: skip
NAMELESS_CONTACTS = {4: ["i", "j", "fn", "ft"], 5: ["frame", "i", "j", "ft", "fn"]}
BONDS = ["i", "j", "slides", "ft", "fn"]  # columns of RigidLibrary, whose third column has flags
MATRICES = ("Norm", "Tan")  # parts of the file names of RigidLibrary's matrices of normal and tangential forces
ALIASES = {
    "i": ("i", "id1", "i1", "p1", "grain1", "particle1", "particleid1", "particleid", "body1", "a"),
    "j": ("j", "id2", "j2", "i2", "p2", "grain2", "particle2", "particleid2", "body2", "neighborid", "b"),
    "fn": ("fn", "fnormal", "forcen", "forcenormal", "normal", "normalforce"),
    "ft": ("ft", "ftangential", "forcet", "forcetangential", "tangential", "tangentialforce", "shear", "shearforce"),
    **{f"f{axis}": (f"f{axis}", f"force{axis}") for axis in "xyz"},
    **{f"ft{axis}": (f"ft{axis}", f"t{axis}") for axis in "xyz"},
}  # fmt: skip
PLAIN = {other: name for name, others in ALIASES.items() for other in others}
VECTORS = ("f", "ft")  # total and tangential force on the first grain


def is_table_of_forces(grains: Path, contacts: Path) -> bool:
    """Return True for a table with a column of normal forces, or another list of forces beside a table of grains."""
    text = head_text(read_content(contacts, HEAD))
    if text.startswith("ITEM: TIMESTEP"):
        return False
    lines = [line for line in text.splitlines() if line.strip()]
    found = [names_of(line) for line in lines[:20]]
    if any("fn" in map(_contact_name, names) for names in found if names):
        return True
    if not lines or not grains.is_file():
        return False
    bare = all(names is None for names in found)
    bare = bare and (len(_entries(lines[0])) in NAMELESS_CONTACTS or _may_be_matrix(lines[0]))
    head = read_content(grains, HEAD)
    first = next((line for line in head_text(head).splitlines() if line.strip()), "")
    nameless = names_of(first) is None and len(_entries(first)) in NAMELESS_GRAINS
    return (bare or any(map(_has_forces, found))) and (recognize(head) or nameless)


def _entries(line: str) -> list[str]:
    return [word for word in re.split(r"[;,\s]+", line.strip()) if word]


def _may_be_matrix(line: str) -> bool:
    """Return True for a row that is too long for a list of contacts."""
    return len(_entries(line)) > max(NAMELESS_CONTACTS)


def _contact_name(name: str) -> str:
    plain = plain_name(name)
    return PLAIN.get(plain, plain)


def _has_forces(names: list[str] | None) -> bool:
    """Return True if the names include those of two grains and of a force between them."""
    columns = set(map(_contact_name, names or []))
    return {"i", "j"} <= columns and ("fn" in columns or {"fx", "fy"} <= columns)


def frames_of_lists(path: Path, contacts: Path) -> list[str]:
    """Names of the frames in both tables; empty if there is no frame column."""
    grains = _grains_of(path)[0]
    forces = _contacts_of(contacts, grains)[0]
    return [f"{step:g}" for step in _common_frames(path, grains, contacts, forces, [])]


def read_lists(path: Path, contacts: Path, frame: str | None = None) -> tuple[dict[str, Any], list[str]]:
    """Grains and contact forces of one frame, by default the last, as arguments of `measured_forces`, and notes.

    Grains at walls are held: those that are fixed, at an edge, or in contact with a grain that has a negative number or
    no position. Contacts listed for both of their grains are averaged.
    """
    grains, notes = _grains_of(path)
    forces, more = _contacts_of(contacts, grains)
    used = {*grains} - {*identify_columns(grains)[1]} | {*OPTIONAL, *FRAMES}
    read = {*NEEDED, *FORCES, *FRAMES, *(f"{name}{axis}" for name in VECTORS for axis in "xyz")}
    notes = [
        *notes, *more, *account_for("column of a table", grains, path.name, dict.fromkeys(used, USED)),
        *account_for("column of contacts", forces, contacts.name, dict.fromkeys(read, USED)),
    ]  # fmt: skip
    steps = _common_frames(path, grains, contacts, forces, notes)
    if len(steps):
        ((at),) = chosen_frames(path, [f"{step:g}" for step in steps], frame)
        if frame is None and len(steps) > 1:
            notes.append(f"{path.name} has {len(steps)} frames: the last, {steps[at]:g}, is used; give another --frame")
        tables = []
        for table in (grains, forces):
            times = _frame_column(table)
            tables.append(table if times is None else {name: c[times == steps[at]] for name, c in table.items()})
        grains, forces = tables
    elif frame is not None:
        raise PackingError(f"frame {frame!r} does not apply, as {path.name} has no frame column: leave it out")
    return _join(path, grains, contacts, forces, notes), notes


def _grains_of(path: Path) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns of grains, named as by `plain_name`."""
    columns, notes = read_columns(path, NAMELESS_GRAINS)
    _check_units(path, columns)
    out = {plain_name(name): values for name, values in columns.items()}
    if notes and len(out) == 4 and (out["radius"] <= 0).any():  # as in centers.txt of PeGS2
        out = dict(zip(("x", "y", "radius", "edge"), out.values(), strict=True))
        out["id"] = 1.0 + np.arange(len(out["x"]))
    more = []
    if notes and "frame" not in out and "id" in out and not np.isin(out.get("edge", 0), (0, 1)).all():
        del out["edge"]  # as in ParticleData.dlm of RigidLibrary
        more = [f"{path.name}: the fifth, unnamed column is ignored"]
    if notes:
        said = f"{path.name} does not name its columns: {' '.join(out)} is assumed, all lengths in one unit"
        notes = [Assumption(f"{said}, as in lists of PeGS2 (pixels): law and errors must be in the same unit"), *more]
    return out, notes


def _contacts_of(path: Path, grains: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns of contacts, named as by `plain_name`."""
    first = _first_line(path)
    if _may_be_matrix(first) and names_of(first) is None and len(_entries(first)) == len(grains["x"]):
        return _matrices_of(path, grains)
    columns, notes = read_columns(path, NAMELESS_CONTACTS, _has_forces)
    _check_units(path, columns)
    out = {_contact_name(name): values for name, values in columns.items()}
    if notes and "frame" in out and np.isin(out["j"], (0, 1)).all():
        if not np.ptp(out["frame"]) > 0:
            raise PackingError(
                f"{path} has five unnamed columns; the first is constant and the third contains flags instead of "
                "grains: name the columns, as in i j slides ft fn"
            )
        out = dict(zip(BONDS, out.values(), strict=True))
    if notes:
        program = "RigidLibrary" if "slides" in out else "PeGS2"
        said = f"{path.name} does not name its columns: {' '.join(out)} is assumed"
        notes = [Assumption(f"{said}, as in lists of {program}")]
    vectors = any({f"{name}x", f"{name}y"} <= {*out} for name in VECTORS)
    for name in NEEDED:
        if name not in out and (name in "ij" or not vectors):
            raise PackingError(
                f"{path} has no column {name}: its columns are {' '.join(out)}, but i j fn ft are needed, or i j and "
                "the force on grain i, fx fy (fz)"
            )
    return out, notes


def _first_line(path: Path) -> str:
    return next((line for line in read_lines(path, fallback="cp1252").splitlines() if line.strip()), "")


def _matrices_of(path: Path, grains: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Contacts from two RigidLibrary matrices (N, N) in one folder: that of normal and that of tangential forces."""
    normal, tangential = MATRICES
    if normal not in path.name:
        raise PackingError(
            f"{path} is a matrix: give that of normal forces, …NormWeightedAdjacencyMatrix.dlm, with "
            "…TanWeightedAdjacencyMatrix.dlm in the same folder"
        )
    beside, n = path.with_name(path.name.replace(normal, tangential)), len(grains["x"])
    if not beside.is_file():
        raise PackingError(
            f"{beside} is missing: put the matrix of tangential forces into the folder of the normal forces"
        )
    both = []
    for file in (path, beside):
        width = len(_entries(_first_line(file)))
        columns, _ = read_columns(file, {width: [f"{k}" for k in range(width)]}, lambda _: False)
        matrix = np.stack([*columns.values()], axis=1)
        if matrix.shape != (n, n):
            raise PackingError(f"{file} has shape {matrix.shape}, but there are {n} grains: give a row for each")
        both.append(matrix)
    i, j = np.nonzero((both[0] != 0) | (both[1] != 0))
    ids = grains.get("id", np.arange(n))
    notes = [Assumption(f"{path.name} and {beside.name} are RigidLibrary matrices, with a row for each row of grains")]
    return {"i": ids[i], "j": ids[j], "fn": both[0][i, j], "ft": both[1][i, j]}, notes


def _check_units(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Raise PackingError if lengths are in pixels, or forces in several units."""
    units = {name: match[1].strip() for name in columns if (match := re.search(r"[\[(](.*?)[\])]", name))}
    for name, unit in units.items():
        if unit.lower() in PIXELS:
            raise PackingError(f"{path} has {name!r} in pixels: give lengths in the law's unit of length")
    forces = sorted({unit for name, unit in units.items() if _contact_name(name) in (*FORCES, "fx", "fy", "fz")})
    if len(forces) > 1:
        raise PackingError(f"{path} has forces in {' and '.join(forces)}: give them in one unit")


def _frame_column(columns: dict[str, np.ndarray]) -> np.ndarray | None:
    return next((columns[name] for name in FRAMES if name in columns), None)


def _common_frames(path: Path, grains: dict, contacts: Path, forces: dict, notes: list[str]) -> np.ndarray:
    """Frames in both tables; raise PackingError if there are none, or only one table has several frames."""
    frames = [np.unique(c[np.isfinite(c)]) for c in map(_frame_column, (grains, forces)) if c is not None]
    if len(frames) == 2:
        both = np.intersect1d(*frames)
        if not len(both):
            some = [", ".join(f"{step:g}" for step in steps[:4]) for steps in frames]
            raise PackingError(
                f"{path} has the frames {some[0]} and {contacts.name} has {some[1]}: give tables of the same frames"
            )
        if len(alone := np.setxor1d(*frames)):
            some = ", ".join(f"{step:g}" for step in alone[:4]) + (" …" if len(alone) > 4 else "")
            notes.append(f"frames in only one of {path.name} and {contacts.name} are left out: {some}")
        return both
    if frames and len(frames[0]) > 1:
        lacks = contacts if _frame_column(forces) is None else path
        raise PackingError(f"{lacks} needs a column frame, as the other table has {len(frames[0])} frames")
    return frames[0] if frames else np.zeros(0)


def _join(path: Path, grains: dict, contacts: Path, forces: dict, notes: list[str]) -> dict[str, Any]:
    """Network of the grains and contacts of one frame."""
    grains, lost = _place(path, grains, notes)
    packing = packing_of_columns(grains, path.name)
    if not (n := len(packing.arrays["radius"])):
        raise PackingError(f"{path} has no grains: give a row with x y radius for each")
    named, zero = packing.ids is not None, np.zeros(n)
    order = np.argsort(identify_columns(grains)[0]["id"], kind="stable") if named else np.arange(n)
    ids = packing.ids if named else order
    grains = {name: values[order] for name, values in grains.items()}
    forces = _finite_rows(forces, contacts, notes)
    ends = np.stack([forces["i"], forces["j"]])
    outside = (ends < 0) | np.isin(ends, lost)
    for wrong in ends[~outside & ~np.isin(ends, ids)]:
        use = "the ids of grains" if named else f"rows of grains, 0 to {n - 1}"
        if not named and wrong == n and not (ends == 0).any():
            use += "; these numbers seem to start at 1: give the grains a column id"
        raise PackingError(f"{contacts} names grain {wrong:g}, which {path.name} does not have: use {use}")
    for name in ("fixed", "edge"):
        if not np.isfinite(grains.get(name, zero)).all():
            raise PackingError(f"{path}: column {name} must be 1 for held grains and 0 for others in every row")
    walls, edge = outside.any(axis=0), grains.get("edge", zero) != 0
    held = (grains.get("fixed", zero) != 0) | edge
    beside = np.searchsorted(ids, np.unique(ends[:, walls][~outside[:, walls]]))
    held[beside] = True
    if walls.any():
        notes.append(
            f"contacts in {contacts.name} with walls, which have negative numbers, or with grains without a position "
            f"are left out, and their grains held: {walls.sum()} of {len(walls)} rows, {len(beside)} grains"
        )
    if edge.any():
        notes.append(f"grains at an edge are held: {edge.sum()}")
    dim = packing.arrays.get("dim", 3)
    position, radius = packing.arrays["position"][:, :dim], packing.arrays["radius"]
    forces, ends = {name: values[~walls] for name, values in forces.items()}, np.searchsorted(ids, ends[:, ~walls])
    load = np.stack([grains.get(f"load{axis}", zero) for axis in "xyz"[:dim]], axis=1)
    network = _pressing(contacts, _average(contacts, forces, ends, position, ids, notes), ids, notes)
    network = _near(contacts, network, position, radius, notes)
    _note_doubts(contacts, network, notes)
    return network | {
        "position": position, "radius": radius, "held": np.flatnonzero(held), "ids": ids, "load": load,
        "position_error": grains.get("positionerror", np.nan),
    }  # fmt: skip


def _place(path: Path, grains: dict, notes: list[str]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Rows of grains without missing numbers, and the ids of grains with missing numbers."""
    known, rest = identify_columns(grains)
    whole = np.all([np.isfinite(values) for name, values in grains.items() if name not in rest], axis=0)
    ids = known.get("id", np.zeros(0))
    if not whole.all() and not len(ids):
        raise PackingError(f"{path} has incomplete rows and no column id: add this column, or remove these rows")
    if not whole.all():
        notes.append(f"grains with incomplete rows in {path.name} are left out: {(~whole).sum()}")
    kept = ids[whole] if len(ids) else ids
    if (kept != np.round(kept)).any():
        raise PackingError(f"{path} has grain ids that are not whole numbers")
    number, count = np.unique(kept, return_counts=True)
    for twice in number[count > 1]:
        raise PackingError(f"{path} has grain {twice:g} more than once: give each grain once, or add a column frame")
    return {name: values[whole] for name, values in grains.items()}, ids[~whole] if len(ids) else ids


def _finite_rows(forces: dict, contacts: Path, notes: list[str]) -> dict[str, np.ndarray]:
    """Rows of contacts without missing numbers."""
    read = [name for name in forces if name in NEEDED or name[:-1] in VECTORS]
    whole = np.all([np.isfinite(forces[name]) for name in read], axis=0)
    if not whole.all():
        notes.append(f"incomplete rows of {contacts.name} are left out: {(~whole).sum()}")
    forces = {name: values[whole] for name, values in forces.items()}
    for name in "ij":
        if (forces[name] != np.round(forces[name])).any():
            raise PackingError(f"{contacts}: grains in column {name} must be whole numbers")
    return forces


def _parts(contacts: Path, forces: dict, ends: np.ndarray, place: np.ndarray, ids, notes: list[str]):
    """Normal forces (C,), and tangential forces: (C,) in a plane, otherwise vectors (C, 3) on the first grain."""
    dim = place.shape[1]
    branch = place[ends[0]] - place[ends[1]]
    length = np.linalg.norm(branch, axis=1)
    for c in np.flatnonzero(length == 0):
        one, other = ids[ends[:, c]]
        if one == other:
            raise PackingError(f"{contacts} has a contact of grain {one} with itself: check the grain numbers")
        raise PackingError(f"grains {one} and {other} of {contacts} have the same position: check the grain numbers")
    normal = branch / length[:, None]
    vector = {name: np.stack([forces[part] for part in _axes(name, dim)], axis=1) for name in VECTORS
              if {*_axes(name, dim)} <= {*forces}}  # fmt: skip
    if "fn" in forces and ("ft" in vector or (dim == 2 and "ft" in forces)):
        along = forces["fn"]
    elif "f" in vector:
        if "fn" in forces:
            notes.append(
                f"column fn of {contacts.name} is not used: normal forces follow from {' '.join(_axes('f', dim))}"
            )
        along = np.einsum("ck,ck->c", vector["f"], normal)
        sign = -1.0 if along.sum() < 0 else 1.0
        if sign < 0:
            notes.append(f"forces in {contacts.name} are assumed to act on the second grain, as contacts must press")
        along, vector["ft"] = sign * along, sign * (vector["f"] - along[:, None] * normal)
    else:
        raise PackingError(
            f"{contacts} has no force directions{' between spheres' if dim == 3 else ''}: give the force on grain i, "
            f"{' '.join(_axes('f', dim))}, or fn and its tangential part, {' '.join(_axes('t', dim))}"
        )
    if dim == 2:
        if any(np.any(forces.get(f"{name}z", 0.0)) for name in VECTORS):
            notes.append(f"forces along z in {contacts.name} are left out, as all grains lie in the plane z = 0")
        across = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
        turn = np.einsum("ck,ck->c", vector["ft"], across) if "ft" in vector else forces["ft"]
        return along, turn
    return along, vector["ft"]


def _axes(name: str, dim: int) -> list[str]:
    return [name + axis for axis in "xyz"[:dim]]


def _average(contacts: Path, forces: dict, ends: np.ndarray, place: np.ndarray, ids, notes: list[str]) -> dict:
    """Contacts, each once, as arguments of `measured_forces`; those listed for both grains are averaged."""
    n, (along, across) = len(ids), _parts(contacts, forces, ends, place, ids, notes)
    low, high = np.sort(ends, axis=0)
    if across.ndim == 2:
        across = across * np.where(ends[0] > ends[1], -1.0, 1.0)[:, None]
    key, row, count = np.unique(low * n + high, return_inverse=True, return_counts=True)
    pair = {"pair_i": key // n, "pair_j": key % n}
    for c in np.flatnonzero(count > 2):
        i, j = (ids[grain[c]] for grain in pair.values())
        raise PackingError(
            f"{contacts} lists the contact of grains {i} and {j} {count[c]} times: give it once, or once for each grain"
        )

    def mean(values: np.ndarray) -> np.ndarray:
        out = np.zeros((len(key), *values.shape[1:]))
        np.add.at(out, row, values)
        return (out.T / count).T

    out = pair | {"force_n": mean(along), "force_t": mean(across)}
    out |= {f"force_{a}_error": mean(forces.get(f"f{a}error", np.full(len(row), np.nan))) for a in "nt"}
    if not (twice := count == 2).any():
        return out
    size = {}
    for a, values in (("n", along), ("t", across)):
        half = (values - out[f"force_{a}"][row])[twice[row]]  # half the difference of two readings
        if 2 * (out[f"force_{a}"][twice] ** 2).sum() < OPPOSITE * (half**2).sum():
            noun = "normal" if a == "n" else "tangential"
            raise PackingError(
                f"{contacts} lists contacts for both of their grains with opposite {noun} forces: fn must be positive "
                "if it presses, ft positive if it turns both grains from x to y, and vectors are the force on the "
                "first grain"
            )
        size[a], known = float(np.sqrt((half**2).mean())), out[f"force_{a}_error"]
        out[f"force_{a}_error"] = np.where(np.isnan(known) & (size[a] > 0), size[a], known)
    told = f"half their differences, {size['n']:.3g} normal and {size['t']:.3g} tangential, are the errors of forces"
    told = told if any(size.values()) else "both are equal, so that errors remain unknown"
    notes.append(f"{twice.sum()} contacts of {contacts.name} are listed twice: readings are averaged; {told}")
    if twice.all() or twice.mean() <= 0.5:
        return out
    notes.append(f"contacts listed for only one of their grains are left out: {(~twice).sum()}")
    return {name: values[twice] for name, values in out.items()}


def _pressing(contacts: Path, network: dict, ids: np.ndarray, notes: list[str]) -> dict:
    """Contacts that press; raise PackingError if others pull more than errors explain."""
    force, error = network["force_n"], network["force_n_error"]
    if not (pulls := force < 0).any():
        return network
    c, mean = int(np.argmin(force)), np.abs(force).mean()
    unknown = np.isnan(error[pulls]).any() and (pulls.mean() > FEW or -force[c] > force.max())
    if unknown or (-force[pulls] > FAR * error[pulls]).any():
        i, j = (ids[network[name][c]] for name in ("pair_i", "pair_j"))
        raise PackingError(
            f"{pulls.sum()} of {len(force)} contacts of {contacts} pull by more than errors explain, the contact of "
            f"grains {i} and {j} most, by {-force[c]:.4g}: normal forces must press and be positive; check the order "
            "of the columns"
        )
    notes.append(
        f"contacts with negative normal forces are left out: {pulls.sum()}, down to −{-force[c] / mean:.2g} times the "
        "mean force"
    )
    return {name: values[~pulls] for name, values in network.items()}


def _near(contacts: Path, network: dict, place: np.ndarray, radius: np.ndarray, notes: list[str]) -> dict:
    """Drop contacts between distant grains, such as mistaken contacts, if there are few; otherwise keep them all."""
    i, j = network["pair_i"], network["pair_j"]
    gap = np.linalg.norm(place[i] - place[j], axis=1) - radius[i] - radius[j]
    share = np.abs(gap) / np.minimum(radius[i], radius[j])
    if not (far := share > WIDEST).any() or far.mean() > FEW:
        return network
    notes.append(
        f"contacts of {contacts.name} between grains that do not touch are left out: {far.sum()} of {len(far)}, with a "
        f"gap or overlap of up to {share.max():.3g} radii"
    )
    return {name: values[~far] for name, values in network.items()}


def _note_doubts(contacts: Path, network: dict, notes: list[str]) -> None:
    """Note tangential forces whose column or sign seems to be wrong."""
    across, sign = network["force_t"], np.sign(network["force_t"])
    size = np.abs(across) if across.ndim == 1 else np.linalg.norm(across, axis=1)
    beyond = np.count_nonzero(size > network["force_n"])
    if 2 * beyond > len(size):
        notes.append(
            f"tangential forces in {contacts.name} exceed normal ones at {beyond} of {len(size)} contacts: check the "
            "order of the columns"
        )
    if across.ndim == 1 and abs(sign.sum()) == np.count_nonzero(sign) >= SIGNED:
        notes.append(
            f"all tangential forces in {contacts.name} have the same sign, so that torques on grains cannot balance: "
            "ft is positive if it turns both grains from x to y, negative otherwise"
        )
