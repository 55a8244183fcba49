"""Content of exported frames: the state, and columns per grain and per contact that other programs can display.

Files are written to a temporary path and then renamed, so that no partially written file has the final name.
"""

from typing import NamedTuple

import numpy as np

from ...builtin_laws import NAMES
from ...core.arguments import checked
from ...core.contacts.forces import forces
from ...core.laws.builtin import COULOMB, DAMPING, NO_TENSION, Law
from ...core.laws.kinds import Kind, describe_law, restore_kind
from ...core.measure import branch_vectors, contact_forces, contact_numbers, touching
from ...core.readable import pluralize, readable
from ...core.state import State
from ..sample import PackingError


@readable
class Frame(NamedTuple):
    """A state with derived columns for export; frames of an animation have further columns."""

    state: State
    law: Law
    grains: dict[str, np.ndarray]  # derived columns per grain, (N,) or (N, 3)
    contacts: dict[str, np.ndarray]  # columns per touching contact, (M,) or (M, 3), including i, j, image and branch
    turned: np.ndarray | None = None  # (N, 3) rotation since the first frame [rad]; None if known only in the plane
    moving: bool = False  # True in an animation of a mode, which is not a state to continue from
    assumed: tuple[str, ...] = ()  # what was assumed about the packing


def exported(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns under the names that files have: a force or a torque alone could come from outside."""
    return {f"contact_{name}" if name in ("force", "torque") else name: column for name, column in columns.items()}


@checked
def frame_of(state: State, law: Law) -> Frame:
    """Columns of an accepted state: resultants for each grain, and the elastic force on i for each contact [force].

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> frame_of(pair, law).contacts["force_n"]
    array([0.001])
    """
    rows, c, n = touching(state), state.contacts, len(state.grains.radius)
    branch = branch_vectors(state)[rows]
    force = contact_forces(state, law)[rows]
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    size = np.einsum("ck,ck->c", force, normal)
    tangential = force - size[:, None] * normal
    contacts = {
        "i": c.i[rows], "j": c.j[rows], "image": c.image[rows], "branch": branch, "force_n": size,
        "force_t": np.linalg.norm(tangential, axis=1), "tangential": tangential, "slip": c.slip[rows],
        "mode": c.mode[rows],
    }  # fmt: skip
    loads = forces(state, law)[0]
    grains = {"force": loads.force[:n], "torque": loads.torque[:n], "coordination": contact_numbers(state)}
    return Frame(state, law, grains, contacts)


def without_walls(frame: Frame) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns of the contacts between grains, and a note on contacts with walls."""
    between = frame.contacts["j"] < len(frame.state.grains.radius)
    walls = int((~between).sum())
    notes = [f"{pluralize(walls, 'contact')} with walls not written, for lack of a second grain"] if walls else []
    return {name: column[between] for name, column in frame.contacts.items()}, notes


def law_to_dict(law: Law) -> dict:
    """Convert a law to names and numbers, which JSON stores to the last bit."""
    own = {"own": describe_law(law)} if isinstance(law.kind, Kind) else {}
    return own | {
        "law": f"own {int(law.kind):x}" if own else NAMES[law.kind],
        "coulomb": next(name for name, number in COULOMB.items() if number == law.coulomb),
        "damping": next(name for name, number in DAMPING.items() if number == law.damping & ~NO_TENSION),
        "tension": not law.damping & NO_TENSION,
        "table": law.table.tolist(), "properties": law.properties,
    }  # fmt: skip


def law_from_dict(about: dict) -> Law:
    """Rebuild the law described by `law_to_dict`; ValueError, KeyError or TypeError if there is no such law."""
    table = np.array(about["table"], float)
    if table.ndim != 3 or table.shape[0] != table.shape[1] or table.shape[2] < 5 or not np.isfinite(table).all():
        raise ValueError(f"a law's table of shape {table.shape}")
    damping = DAMPING[about["damping"]] + (0 if about["tension"] else NO_TENSION)
    kind = restore_kind(int(about["own"]["digest"], 16), about["own"]) if "own" in about else NAMES.index(about["law"])
    return Law(kind, COULOMB[about["coulomb"]], table, damping, about.get("properties", 0))


def lower_triangular_vectors(state: State, name: str) -> np.ndarray:
    """(3, 3) box vectors, the first along x and the second in the x–y plane, as most formats require."""
    vectors = state.cell.vectors
    if np.triu(vectors, 1).any() or not (np.diag(vectors) > 0).all():
        raise PackingError(
            f"{name} requires the first box vector along x and the second in the x-y plane, which this cell does not "
            f"satisfy: write .npz, .h5 or .vtu"
        )
    return vectors


def bounding_box(state: State, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Vectors and corner of a box that contains all grains: the cell along periodic directions, enclosing along others.

    Returns
    -------
    (3, 3) vectors as rows; (3,) corner [length]
    """
    grains, cell = state.grains, state.cell
    vectors, corner = np.diag([1.0, 1.0, 1.0]), np.zeros(3)
    if cell.periodic.any():
        vectors = np.where(cell.periodic[:, None], lower_triangular_vectors(state, name), 0.0)
    low = (grains.position - grains.radius[:, None]).min(axis=0)
    high = (grains.position + grains.radius[:, None]).max(axis=0)
    for k in np.flatnonzero(~cell.periodic):
        vectors[k], vectors[k, k] = 0.0, 1.02 * (high[k] - low[k])
        corner[k] = low[k] - 0.01 * (high[k] - low[k])
    return vectors, corner


def wrapped_into(position: np.ndarray, vectors, corner, periodic) -> tuple[np.ndarray, np.ndarray]:
    """Positions wrapped into a box with a given corner, and their periodic images: x = wrapped + image @ vectors."""
    share = (position - corner) @ np.linalg.inv(vectors)
    image = np.where(periodic, np.floor(share), 0.0)
    inside = position - image @ vectors
    image = image.astype(np.int64)
    return inside, image


def list_losses(frame: Frame, *, walls: bool = True, law: bool = True, imposed: bool = True) -> list[str]:
    """List what a format does not store: walls, the law, and anything in `Control` other than free grains."""
    state, losses = frame.state, []
    control, n = state.control, len(state.grains.radius)
    if walls and len(state.walls.mass):
        losses.append(f"{len(state.walls.mass)} wall(s)")
    if law:
        losses.append("the contact law")
    acts = control.force.any() or control.torque.any() or control.gravity.any() or control.spring.any()
    held = not control.free[:n, : state.cell.dim].all() or control.cell_free.any() or control.cell_rate.any()
    if imposed and (acts or held or (control.group >= 0).any()):
        losses.append("loads and boundary conditions")
    return losses
