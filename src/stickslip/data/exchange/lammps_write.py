"""Packings for LAMMPS: a data file of `atom_style sphere`, and a second file of contacts as LAMMPS would dump them.

LAMMPS reads the data file but cannot import the memory of contacts; `read_lammps` reads it from the second file.
"""

import shlex
from pathlib import Path

import numpy as np

from ...core.contacts.jacobian import linearise
from ...core.laws.builtin import SHARP, damping_model
from ...core.measure import contact_velocity, touching
from ...core.readable import pluralize
from ...core.state import SLIDE
from ..atomic import replace_atomically
from .frame import Frame, bounding_box, list_losses, without_walls, wrapped_into
from .lammps_file import ORDER
from .lammps_text import VOLUME


def contacts_path(path: Path) -> Path:
    """Path of the contacts of a data file: packing.contacts.dump for packing.data."""
    return path.with_name(f"{path.stem}.contacts.dump")


def write_lammps(path: str | Path, frame: Frame) -> list[str]:
    """Write a data file and its contacts; return notes on what they do not store."""
    path, state = Path(path), frame.state
    vectors, corner = bounding_box(state, "LAMMPS")
    if state.cell.dim == 2:
        vectors, corner = vectors.copy(), corner.copy()
        vectors[2], corner[2] = (0, 0, 1), -0.5
    notes = [f"LAMMPS data does not store {', '.join(lost)}" for lost in [list_losses(frame)] if lost]
    if not state.cell.periodic[: state.cell.dim].all():
        letters = "".join("p" if p else "f" for p in state.cell.periodic[: state.cell.dim]) + "p" * (3 - state.cell.dim)
        notes.append(f"LAMMPS data does not store which directions are periodic: use `boundary {' '.join(letters)}`")
    i0 = state.grains.inertia / (state.grains.mass * state.grains.radius**2)
    if np.abs(i0 - 0.4).max() > 1e-12:
        notes.append(
            "LAMMPS uses the moment of inertia of spheres, 2/5 m R², or with `disc` 1/2 m R²: set it here with --i0"
        )
    if state.grains.angle.any():
        notes.append("LAMMPS data does not store angles")
    with replace_atomically(path) as part:
        part.write_text(_format_data(frame, vectors, corner), encoding="utf-8")
        notes += _write_contacts(contacts_path(path), frame, vectors, corner)
    return notes


def _format_rows(rows) -> list[str]:
    """Format rows of numbers so that they can be read back exactly, to the last bit."""
    return [" ".join(map(repr, row)) for row in rows]


def _format_data(frame: Frame, vectors, corner) -> str:
    state, grains = frame.state, frame.state.grains
    inside, image = wrapped_into(grains.position, vectors, corner, state.cell.periodic)
    size, tilt = np.diag(vectors), (vectors[1, 0], vectors[2, 0], vectors[2, 1])
    density = grains.mass / (VOLUME * grains.radius**3)
    numbers = _format_rows(np.column_stack([2 * grains.radius, density, inside]).tolist())
    whole = _format_rows(image.tolist())
    kinds = (grains.material + 1).tolist()
    atoms = [f"{k} {t} {a} {b}" for k, (t, a, b) in enumerate(zip(kinds, numbers, whole, strict=True), 1)]
    motion = _format_rows(np.hstack([grains.velocity, grains.spin]).tolist())
    head = [f"LAMMPS data file of grains, timestep = 0, written by stickslip ({state.cell.dim} dimensions)", ""]
    head += [f"{len(kinds)} atoms", f"{max(kinds)} atom types", ""]
    head += [f"{float(c)!r} {float(c + s)!r} {a}lo {a}hi" for c, s, a in zip(corner, size, "xyz", strict=True)]
    if any(tilt):
        head.append(" ".join(repr(float(t)) for t in tilt) + " xy xz yz")
    moving = ["", "Velocities", "", *(f"{k} {row}" for k, row in enumerate(motion, 1))]
    return "\n".join([*head, "", "Atoms # sphere", "", *atoms, *moving, ""])


def _write_contacts(path: Path, frame: Frame, vectors, corner) -> list[str]:
    """Write the contacts between grains as `compute pair/local` does; return notes on what is not written."""
    state, law = frame.state, frame.law
    pairs, notes = without_walls(frame)
    if law.coulomb != SHARP:
        return [*notes, "LAMMPS has sharp friction, but this law is smooth: the memory of contacts is not written"]
    rows = touching(state)
    rows = rows[state.contacts.j[rows] < len(state.grains.radius)]
    c = linearise(state, law)
    vn, vt = contact_velocity(state, rows, c.normal[rows])
    normal = (c.force_n[rows] - c.damping_n[rows] * vn)[:, None] * c.normal[rows]
    tangential = pairs["tangential"] - c.damping_t[rows, None] * vt
    length = np.linalg.norm(pairs["branch"], axis=1)
    numbers = _format_rows(np.column_stack([length, pairs["branch"], normal, tangential]).tolist())
    ends = zip((pairs["i"] + 1).tolist(), (pairs["j"] + 1).tolist(), numbers, strict=True)
    flags = ["pp" if p else "ff" for p in state.cell.periodic]
    xy, xz, yz = vectors[1, 0], vectors[2, 0], vectors[2, 1]
    low, high = corner.copy(), corner + np.diag(vectors)
    low[0] += min(0.0, xy, xz, xy + xz)
    high[0] += max(0.0, xy, xz, xy + xz)
    low[1] += min(0.0, yz)
    high[1] += max(0.0, yz)
    bounds = _format_rows(np.column_stack([low, high, (xy, xz, yz)]).tolist())
    head = ["ITEM: TIMESTEP", "0", "ITEM: NUMBER OF ENTRIES", str(len(rows))]
    head += [f"ITEM: BOX BOUNDS xy xz yz {' '.join(flags)}", *bounds, f"ITEM: ENTRIES {' '.join(ORDER)}"]
    with replace_atomically(path) as part:
        part.write_text("\n".join([*head, *(f"{i} {j} {row}" for i, j, row in ends), ""]), encoding="utf-8")
    sliding = int(((pairs["mode"] == SLIDE) & (vt.any(axis=1) | (vn != 0))).sum())
    if damping_model(law) and sliding:
        notes.append(
            f"the slip of {pluralize(sliding, 'sliding contact')} in motion is stored without the force carried by "
            f"dashpots"
        )
    back = f"read it back with --contacts {shlex.quote(str(path))}"
    return [*notes, f"LAMMPS cannot import the memory of contacts, which is in {path.name}: {back}"]
