"""Rattlers on a load path: other grains push them aside until they are wedged and carry load again.

Rattlers carry no load, so no force balance determines their positions. A grain that presses into a rattler moves it by
the least distance that makes room. If the contacts that push a rattler can hold it by friction, they drag it along with
as little slip as possible. If that does not make room either, the rattler is wedged and is an ordinary grain from then
on.

Source for the least distance: Lawson and Hanson, Solving Least Squares Problems (SIAM 1995), chapter 23.
"""

import numpy as np
from scipy.optimize import nnls

from ... import OPEN, Law, State
from ...core.contacts.neighbors import shifts, with_neighbor_list
from ...core.laws.builtin import MU
from ...measure import branch_vectors
from .matrices import contact_frames

NUDGE = 1e-12  # gap, in radii, to which rattlers are pushed aside, and overlap of a new contact
ROUNDS = 30  # iterations of pushing, since directions change
NEAR = 30.0  # gap, in deepest overlaps, within which a pair may close while rattlers move
BALANCED = 1e-8  # residual of a force balance, for forces of size 1
ROTATIONS = {2: [2], 3: [0, 1, 2]}  # axes about which grains rotate
TURNS = 2 * np.pi * np.arange(12) / 12
EDGES = {2: np.array([[1.0], [-1.0]]), 3: np.stack([np.cos(TURNS), np.sin(TURNS)], axis=1)}  # of the cone, over μ F_n


def gaps(state: State, rows) -> tuple[np.ndarray, np.ndarray]:
    """Normals (C, 3) and gaps (C,) of pairs of the list; a negative gap is an overlap [length]."""
    n, radius = len(state.grains.radius), np.append(state.grains.radius, np.zeros(len(state.walls.mass)))
    branch = branch_vectors(state)[rows]
    contacts, distance = state.contacts, np.linalg.norm(branch, axis=1)
    normal = branch / distance[:, None]
    wall = contacts.j[rows] >= n
    if wall.any():
        place = np.concatenate([state.grains.position, state.walls.point])
        normal[wall] = state.walls.normal[contacts.j[rows][wall] - n]
        apart = place[contacts.i[rows][wall]] - place[contacts.j[rows][wall]]
        distance[wall] = np.einsum("ck,ck->c", apart, normal[wall])
    return normal, distance - radius[contacts.i[rows]] - radius[contacts.j[rows]]


def move_aside(state: State, law: Law, loose: np.ndarray, before: State | None = None) -> tuple[State, np.ndarray]:
    """Move rattlers out of contact; return the state and the rows of contacts that wedge some of them.

    Parameters
    ----------
    loose : (N,) bool, the rattlers
    law : Law, whose friction may hold a rattler
    before : State before the increment, from which rattlers may be dragged along

    Returns
    -------
    State, (K,) rows
        if K > 0, some rattlers are wedged by these contacts of the returned state, and no other rattlers were moved
    """
    whole = np.append(loose, np.zeros(state.n_bodies - len(loose), bool))
    nothing, material = np.zeros(0, int), np.concatenate([state.grains.material, state.walls.material])
    if not loose.any():
        return state, nothing
    tiny, drawn = NUDGE * float(state.grains.radius.min()), np.zeros_like(whole)
    for _ in range(ROUNDS):
        contacts, (rows, normal, gap) = state.contacts, _nearby_pairs(state, whole)
        if not len(rows) or gap.min() >= 0:
            return release_rattlers(state, loose), nothing
        i, j = contacts.i[rows], contacts.j[rows]
        move, pressed = _smallest_displacement(_gap_directions(i, j, normal[:, : state.cell.dim], whole), tiny - gap)
        friction = law.table[material[i], material[j], MU]
        frame = contact_frames(normal[pressed], np.zeros_like(normal[pressed]), state.cell.dim)
        wedge = _wedging_contacts(i[pressed], j[pressed], frame, friction[pressed], whole)
        if len(wedge) or move is None:
            held = rows[pressed][wedge] if len(wedge) else rows[pressed]
            caught = np.zeros_like(whole)
            caught[np.concatenate([contacts.i[held], contacts.j[held]])] = True
            caught &= whole
            if before is None or (caught & drawn).any():
                return state, held
            position, drawn = _dragged_positions(state, before, caught, held), drawn | caught
        else:
            position = state.grains.position.copy()
            position[loose, : state.cell.dim] += move.reshape(-1, state.cell.dim)
        state = release_rattlers(
            with_neighbor_list(state._replace(grains=state.grains._replace(position=position))), loose
        )
    return state, rows[gap < 0]


def _nearby_pairs(state: State, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, normals and gaps of pairs that involve rattlers and overlap, or may do so when rattlers are moved."""
    contacts, count = state.contacts, int(state.contacts.count[0])
    rows = np.flatnonzero(whole[contacts.i[:count]] | whole[contacts.j[:count]])
    normal, gap = gaps(state, rows)
    near = gap < NEAR * max(-gap.min(initial=0.0), 0.0)
    return rows[near], normal[near], gap[near]


def _dragged_positions(state: State, before: State, caught: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(N, 3) positions in which caught rattlers follow the bodies that hold them, with the least slip at contacts."""
    contacts, count, dim = state.contacts, len(state.grains.radius), state.cell.dim
    i, j = contacts.i[rows], contacts.j[rows]
    normal = gaps(state, rows)[0]
    frame, turning = contact_frames(normal, np.zeros_like(normal), dim), ROTATIONS[dim]
    spin = np.cross(frame, normal[:, None])[:, :, turning]
    way = np.concatenate([state.grains.position - before.grains.position, state.walls.point - before.walls.point])
    roll = np.zeros_like(way)
    roll[:count] = (state.grains.angle - before.grains.angle) * state.grains.radius[:, None]
    way[caught], roll[caught] = 0.0, 0.0
    bent = shifts(contacts, state.cell.vectors)[rows] - shifts(contacts, before.cell.vectors)[rows]
    slip = np.einsum("cab,cb->ca", frame, way[i] - way[j] + bent)
    slip += np.einsum("cab,cb->ca", spin, (roll[i] + roll[j])[:, turning])
    number, size = np.cumsum(caught) - 1, dim + len(turning)
    columns = np.zeros((len(rows), dim, size * int(caught.sum())))
    for body, sign in ((i, 1.0), (j, -1.0)):
        for row in np.flatnonzero(caught[body]):
            at = size * number[body[row]]
            columns[row, :, at : at + dim] += sign * frame[row, :, :dim]
            columns[row, :, at + dim : at + size] += spin[row]
    follow = np.linalg.lstsq(columns.reshape(dim * len(rows), -1), -slip.ravel(), rcond=None)[0].reshape(-1, size)
    position = state.grains.position.copy()
    position[caught[:count], :dim] = before.grains.position[caught[:count], :dim] + follow[:, :dim]
    return position


def _gap_directions(i, j, normal, whole) -> np.ndarray:
    """(C, dim L) derivatives of gaps with respect to positions of rattlers."""
    number, dim = np.where(whole, np.cumsum(whole) - 1, -1), normal.shape[1]
    out = np.zeros((len(i), dim * int(whole.sum())))
    for body, sign in ((i, 1.0), (j, -1.0)):
        rows = np.flatnonzero(whole[body])
        for axis in range(dim):
            out[rows, dim * number[body[rows]] + axis] += sign * normal[rows, axis]
    return out


def _smallest_displacement(directions: np.ndarray, needed: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    """Smallest x with G x ≥ h, or None if there is none, and a mask of the active rows."""
    scale = np.abs(needed).max()
    system = np.vstack([directions.T, needed / scale])
    aim = np.zeros(len(system))
    aim[-1] = 1.0
    weights, _ = nnls(system, aim)
    rest = system @ weights - aim
    pressed = weights > 1e-9 * weights.max(initial=0.0)
    if abs(rest[-1]) < BALANCED:
        return None, pressed
    return -scale * rest[:-1] / rest[-1], pressed


def _wedging_contacts(i, j, frame, mu, whole) -> np.ndarray:
    """Indices of contacts that can hold rattlers in balance by forces within their cones; empty if none can.

    In space, the cones are replaced by pyramids within them.
    """
    if len(i) < 2:
        return np.zeros(0, int)
    dim = frame.shape[1]
    turning, number = ROTATIONS[dim], np.where(whole, np.cumsum(whole) - 1, -1)
    size, edges = dim + len(turning), EDGES[dim]
    columns = np.zeros((size * int(whole.sum()) + 1, len(edges) * len(i)))
    for edge, weights in enumerate(edges):
        pull = mu[:, None] * np.einsum("a,cak->ck", weights, frame[:, 1:])
        force, moment = frame[:, 0] + pull, -np.cross(frame[:, 0], pull)
        for body, sign in ((i, 1.0), (j, -1.0)):
            rows = np.flatnonzero(whole[body])
            at = size * number[body[rows]][:, None]
            columns[at + np.arange(dim), len(edges) * rows[:, None] + edge] += sign * force[rows, :dim]
            columns[at + dim + np.arange(size - dim), len(edges) * rows[:, None] + edge] += moment[rows][:, turning]
    columns[-1] = 1.0
    aim = np.zeros(len(columns))
    aim[-1] = 1.0
    weights, rest = nnls(columns, aim)
    if rest > BALANCED:
        return np.zeros(0, int)
    return np.flatnonzero(weights.reshape(-1, len(edges)).sum(axis=1) > 1e-9)


def release_rattlers(state: State, loose: np.ndarray) -> State:
    """State in which the contacts of rattlers carry no force."""
    body = np.append(loose, np.zeros(state.n_bodies - len(loose), bool))
    contacts, count = state.contacts, int(state.contacts.count[0])
    return with_modes(state, np.flatnonzero(body[contacts.i[:count]] | body[contacts.j[:count]]), OPEN)


def with_modes(state: State, rows: np.ndarray, mode: int) -> State:
    """State with the mode of some contacts set, their slip removed and their memory reset to the current positions."""
    contacts = state.contacts
    modes, slip, pair, roll = (a.copy() for a in (contacts.mode, contacts.slip, contacts.pair, contacts.roll))
    modes[rows], slip[rows] = mode, 0.0
    place = np.concatenate([state.grains.position, state.walls.point])
    turned = np.concatenate([state.grains.angle * state.grains.radius[:, None], np.zeros((len(state.walls.mass), 3))])
    i, j = contacts.i[rows], contacts.j[rows]
    pair[rows] = place[i] - place[j] + shifts(contacts, state.cell.vectors)[rows]
    roll[rows] = turned[i] + turned[j]
    return state._replace(contacts=contacts._replace(mode=modes, slip=slip, pair=pair, roll=roll))
