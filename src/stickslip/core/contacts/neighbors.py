"""Neighbour list: pairs within range, sorted by key. The memory of contacts survives rebuilds."""

from typing import NamedTuple

import numpy as np

from ..arguments import Bodies, checked
from ..fields import BODY_BITS, IMAGE_BITS
from ..laws.builtin import Law
from ..laws.compiled import evaluate
from ..laws.kinds import bridges_gaps, own_memory
from ..laws.properties import angular_columns
from ..library import core
from ..state import PER_PAIR, Cell, Contacts, State, empty_contacts
from .bonds import bond_gap

_IMAGE_OFFSET = 1 << (IMAGE_BITS - 1)
MAX_BODIES = 1 << BODY_BITS
TOO_FAR = f"touching or bonded grains are {_IMAGE_OFFSET} or more periodic boxes apart: shift positions by whole boxes"


class TooFarApartError(ValueError):
    """Two touching grains are more periodic boxes apart than a key can encode."""


class Grid(NamedTuple):
    """Cell data for the pair search, constant while the cell does not change."""

    vectors: np.ndarray  # (3, 3) [length]
    inverse: np.ndarray  # (3, 3) [1/length]
    height: np.ndarray  # (3,) distance between opposite faces [length]
    periodic: np.ndarray  # (3,) bool


def grid_of(cell: Cell) -> Grid:
    """Grid of a cell, sheared or not."""
    inverse = np.linalg.inv(cell.vectors) if cell.periodic.any() else np.eye(3)
    vectors = cell.vectors if cell.periodic.any() else np.eye(3)
    height = 1.0 / np.linalg.norm(inverse, axis=0)
    return Grid(np.ascontiguousarray(vectors), np.ascontiguousarray(inverse), height, cell.periodic)


def needs_rebuild(x, contacts) -> bool:
    """Return True if the list is stale, or if some body has moved by half the skin since it was built."""
    return contacts.stale or not core.largest_displacement(x, contacts.origin, len(x)) <= 0.5 * contacts.skin


def check_list(state: State, gap: float = 0.0) -> None:
    """Raise ValueError if the contact list is not valid at the positions of a state or does not cover a gap."""
    if needs_rebuild(body_positions(state), state.contacts) or gap > state.contacts.gap:
        raise ValueError(
            "the list of contacts does not match these positions: equilibrate, or accept(state, trial) first"
        )


def rebuild_list(x, radius, wall_normal, grid, old: Contacts, threads: int = 1) -> Contacts:
    """Build a contact list at positions x, with the memory and the optional arrays of the old list.

    The count of the new list is −1 on failure.
    """
    pairs = core.find_pairs(grid, x, radius, wall_normal, len(x), len(wall_normal), old.skin + old.gap, threads)
    if pairs is None:
        raise MemoryError("there is not enough memory for the neighbour list")
    try:
        count = core.count_pairs(pairs)
        rows = max(count, 0)
        new = empty_contacts(len(x), rows, old.skin, len(old.pair) < len(old.i), len(old.key) == len(old.i))
        rolling = None if old.rolling is None else np.zeros((rows, old.rolling.shape[1]))
        new = new._replace(origin=x.copy(), gap=old.gap, stale=False, count=np.array([count]), rolling=rolling)
        if count > 0:
            core.fill_list(pairs, old, new)
    finally:
        core.free_pairs(pairs)
    return new


def body_positions(state: State) -> np.ndarray:
    """Positions of grains and of a point of each wall, (N + W, 3) [length]."""
    return np.concatenate([state.grains.position, state.walls.point])


def body_radii(state: State) -> np.ndarray:
    """Radii, (N + W,), zero for walls [length]. Do not write to it: without walls, it is the array of the grains."""
    return join_bodies(state.grains.radius, np.zeros(len(state.walls.mass)))


def join_bodies(grains: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Concatenate values of grains and walls. Without walls, return the array of the grains itself, to save memory."""
    return np.concatenate([grains, walls]) if len(walls) else grains


def with_neighbor_list(state: State, law: Law | None = None) -> State:
    """State with a contact list that is valid at its positions and for a law. Memory is matched by key."""
    if law is not None:
        state = state._replace(contacts=with_own_memory(with_range(state, law), law))
    x = body_positions(state)
    if not needs_rebuild(x, state.contacts):
        return state
    if len(x) > MAX_BODIES:
        raise ValueError(f"at most {MAX_BODIES} bodies are supported, got {len(x)}")
    contacts = rebuild_list(x, body_radii(state), state.walls.normal, grid_of(state.cell), state.contacts)
    if contacts.count[0] < 0:
        raise TooFarApartError(TOO_FAR)
    return state._replace(contacts=contacts if law is None else with_own_memory(contacts, law))


def select_rows(contacts: Contacts, rows) -> Contacts:
    """Contact list with selected rows only. Optional arrays that are absent stay absent."""
    parts = {name: getattr(contacts, name) for name in PER_PAIR}
    some = {name: part[rows] for name, part in parts.items() if part is not None and len(part)}
    return contacts._replace(**some, count=np.array([len(rows)]))


@checked
def without_walls(state: State, walls: Bodies) -> State:
    """State without the given walls, numbered 0 … W−1.

    All other contacts keep their memory, and later walls are renumbered.

    Examples
    --------
    >>> import stickslip as ss
    >>> corner = ss.flat_walls([[0, 0], [0, 0]], [[0, 1], [1, 0]])
    >>> state = ss.assembly(ss.disks([[0.5, 0.5]], 0.5), corner)
    >>> without_walls(state, [0]).walls.normal
    array([[1., 0., 0.]])
    """
    contacts, n, count = state.contacts, len(state.grains.radius), int(state.contacts.count[0])
    kept = np.ones(state.n_bodies, bool)
    for wall in np.atleast_1d(walls):
        if wall not in range(state.n_bodies - n):
            raise ValueError(f"wall {wall} does not exist: the state has {state.n_bodies - n} walls, numbered from 0")
    kept[n + np.asarray(walls, np.int64)] = False
    rows = np.flatnonzero(kept[contacts.j[:count]])
    number = np.cumsum(kept) - 1
    contacts = select_rows(contacts, rows)
    j = number[contacts.j].astype(contacts.j.dtype)
    key = contacts.key - ((contacts.j.astype(np.int64) - j) << (3 * IMAGE_BITS))  # see `pack_keys`
    per_body = ("force", "torque", "free", "rate", "group", "follows", "spring", "anchor", "leads")
    control = state.control._replace(**{name: getattr(state.control, name)[kept] for name in per_body})
    return state._replace(
        walls=type(state.walls)(*(part[kept[n:]] for part in state.walls)),
        contacts=contacts._replace(j=j, key=key, origin=contacts.origin[kept]),
        control=control,
        instant=None,
    )


# ---- requirements of some laws: pairs across gaps, and rows for memory


def gap_of_bonds(state: State) -> float:
    """Largest gap across which a bond acts in a state, rounded up; see `bond_gap` [length]."""
    if not state.bonds:
        return 0.0
    return bond_gap(state.bonds, state.grains.position, state.grains.radius, state.cell.vectors, state.contacts.skin)


def largest_gap(state: State, law: Law) -> float:
    """Largest gap across which a law or a bond acts between bodies of a state [length]."""
    across = gap_of_bonds(state)
    if not bridges_gaps(law.kind):
        return across
    r_eff = float(state.grains.radius.max()) * (1.0 if len(state.walls.mass) else 0.5)
    a, b = np.indices(law.table.shape[:2])
    return max(across, float(evaluate(law, "range", a=a, b=b, overlap=0.0, r_eff=r_eff).max()))


def with_range(state: State, law: Law) -> Contacts:
    """Contact list of a state, marked for a rebuild with a larger gap if the range of the law requires it."""
    contacts, gap = state.contacts, largest_gap(state, law)
    return contacts._replace(gap=gap, stale=True) if gap > contacts.gap else contacts


def with_own_memory(contacts: Contacts, law: Law) -> Contacts:
    """Contact list with a row of memory for each pair, if the law has rotational or user-defined memory."""
    row = np.append(np.zeros(angular_columns(law)), [*own_memory(law.kind).values()])
    if not len(row) or (contacts.rolling is not None and contacts.rolling.shape[1] == len(row)):
        return contacts
    return contacts._replace(rolling=np.tile(row, (len(contacts.i), 1)))


# ---- geometry of pairs


def shifts(contacts, cell) -> np.ndarray:
    """Periodic shift cellᵀ·image of every pair, (C, 3) [length]."""
    out = np.empty((int(contacts.count[0]), 3))
    core.find_shifts(contacts.image, len(out), np.ascontiguousarray(cell), out)
    return out
