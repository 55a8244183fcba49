"""Events at the end of a linear piece of a path, and rattlers that other grains push aside.

Within a piece, forces and positions are linear in the load, until a contact reaches the cone or its apex, or a pair
closes. If the nonlinearity of the packing matters, an event is approached in several steps. Otherwise two contacts of a
disk, whose forces vanish together, would appear to reach the cone just before the forces are zero.

Rattlers carry no load, so that no force balance determines their positions. A grain that presses into a rattler moves
it by the smallest distance that makes room. If the contacts that push a rattler can hold it by friction, they drag it
along with the smallest possible slip. If that does not make room either, the rattler is wedged and counts as an
ordinary grain from then on.

Source for the smallest distance: Lawson and Hanson, Solving Least Squares Problems (SIAM 1995), chapter 23.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from ... import OPEN, Law, State
from ...kit import bond_crossings, bond_limits, bond_motions, builtin, judge_loads, shifts, with_neighbor_list
from ...measure import bond_shares, branch_vectors
from .complementarity import SLACK
from .matrices import contact_frames, joined_bodies
from .status import ContactStatus

NUDGE = 1e-12  # gap to which rattlers are pushed aside, and overlap of a new contact, over the radius
ROUNDS = 30  # largest number of iterations of pushing, needed because directions change
NEAR = 30.0  # ratio of gap to deepest overlap below which a pair may close while rattlers move
BALANCED = 1e-8  # residual of a force balance, for forces of size 1
ROTATIONS = {2: [2], 3: [0, 1, 2]}  # axes about which grains rotate
TURNS = 2 * np.pi * np.arange(12) / 12
EDGES = {2: np.array([[1.0], [-1.0]]), 3: np.stack([np.cos(TURNS), np.sin(TURNS)], axis=1)}  # cone edges over μ F_n


def gaps(state: State, rows) -> tuple[np.ndarray, np.ndarray]:
    """Return normals (C, 3) and gaps (C,) of pairs in the contact list; a negative gap is an overlap [length]."""
    n, radius = len(state.grains.radius), np.append(state.grains.radius, np.zeros(len(state.walls.mass)))
    branch = branch_vectors(state)[rows]
    contacts, distance = state.contacts, np.linalg.norm(branch, axis=1)
    normal = branch / distance[:, None]
    wall = contacts.j[rows] >= n
    if wall.any():
        position = np.concatenate([state.grains.position, state.walls.point])
        normal[wall] = state.walls.normal[contacts.j[rows][wall] - n]
        apart = position[contacts.i[rows][wall]] - position[contacts.j[rows][wall]]
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
    unit = joined_bodies(state)
    number = np.where(whole, (np.cumsum(whole & (unit == np.arange(len(unit)))) - 1)[unit], -1)
    clustered = np.bincount(unit, minlength=len(unit))[unit] > 1
    for _ in range(ROUNDS):
        # pairs that involve rattlers and overlap, or may do so when rattlers are moved
        contacts, count = state.contacts, int(state.contacts.count[0])
        rows = np.flatnonzero(whole[contacts.i[:count]] | whole[contacts.j[:count]])
        rows = rows[unit[contacts.i[rows]] != unit[contacts.j[rows]]]
        normal, gap = gaps(state, rows)
        near = gap < NEAR * max(-gap.min(initial=0.0), 0.0)
        rows, normal, gap = rows[near], normal[near], gap[near]
        if not len(rows) or gap.min() >= 0:
            return release_rattlers(state, loose), nothing
        i, j = contacts.i[rows], contacts.j[rows]
        move, pressed = _smallest_displacement(_gap_directions(i, j, normal[:, : state.cell.dim], number), tiny - gap)
        friction = law.table[material[i], material[j], builtin.MU]
        frame = contact_frames(normal[pressed], np.zeros_like(normal[pressed]), state.cell.dim)
        wedge = _wedging_contacts(state, i[pressed], j[pressed], frame, friction[pressed], unit, number)
        if len(wedge) or move is None:
            held = rows[pressed][wedge] if len(wedge) else rows[pressed]
            caught = np.zeros_like(whole)
            caught[np.concatenate([contacts.i[held], contacts.j[held]])] = True
            caught &= whole
            if before is None or (caught & (drawn | clustered)).any():
                return state, held
            position, drawn = _dragged_positions(state, before, caught, held), drawn | caught
        else:
            position = state.grains.position.copy()
            position[loose, : state.cell.dim] += move.reshape(-1, state.cell.dim)[number[whole]]
        state = release_rattlers(
            with_neighbor_list(state._replace(grains=state.grains._replace(position=position))), loose
        )
    return state, rows[gap < 0]


def _dragged_positions(state: State, before: State, caught: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return positions (N, 3) in which caught rattlers follow the bodies that hold them, with the smallest slip."""
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


def _gap_directions(i, j, normal, number) -> np.ndarray:
    """Return derivatives (C, dim L) of gaps with respect to positions of L rattlers, or of groups joined by beams."""
    dim = normal.shape[1]
    out = np.zeros((len(i), dim * (number.max() + 1)))
    for body, sign in ((i, 1.0), (j, -1.0)):
        rows = np.flatnonzero(number[body] >= 0)
        for axis in range(dim):
            out[rows, dim * number[body[rows]] + axis] += sign * normal[rows, axis]
    return out


def _smallest_displacement(directions: np.ndarray, needed: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    """Return the smallest x with G x ≥ h, or None if there is none, and a mask of the active rows."""
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


def _wedging_contacts(state: State, i, j, frame, mu, unit, number) -> np.ndarray:
    """Indices of contacts that can hold rattlers by balanced forces within their cones; empty if none can.

    In three dimensions, the cones are replaced by pyramids within them.
    """
    if len(i) < 2:
        return np.zeros(0, int)
    dim = frame.shape[1]
    turning, radius, position = ROTATIONS[dim], state.grains.radius, state.grains.position
    size, edges = dim + len(turning), EDGES[dim]
    columns = np.zeros((size * (number.max() + 1) + 1, len(edges) * len(i)))
    for edge, weights in enumerate(edges):
        pull = mu[:, None] * np.einsum("a,cak->ck", weights, frame[:, 1:])
        force, moment = frame[:, 0] + pull, -np.cross(frame[:, 0], pull)
        for body, sign in ((i, 1.0), (j, -1.0)):
            rows = np.flatnonzero(number[body] >= 0)
            at, own, lead = size * number[body[rows]][:, None], body[rows], unit[body[rows]]
            columns[at + np.arange(dim), len(edges) * rows[:, None] + edge] += sign * force[rows, :dim]
            arm = (position[own] - position[lead]) / radius[lead, None]  # of a body that beams join to others
            turn = moment[rows] * (radius[own] / radius[lead])[:, None] + sign * np.cross(arm, force[rows])
            columns[at + dim + np.arange(size - dim), len(edges) * rows[:, None] + edge] += turn[:, turning]
    columns[-1] = 1.0
    aim = np.zeros(len(columns))
    aim[-1] = 1.0
    weights, rest = nnls(columns, aim)
    if rest > BALANCED:
        return np.zeros(0, int)
    return np.flatnonzero(weights.reshape(-1, len(edges)).sum(axis=1) > 1e-9)


def release_rattlers(state: State, loose: np.ndarray) -> State:
    """Remove the forces of contacts of rattlers, except those within bonded clusters; return the state."""
    body = np.append(loose, np.zeros(state.n_bodies - len(loose), bool))
    contacts, count = state.contacts, int(state.contacts.count[0])
    unit, (i, j) = joined_bodies(state), (contacts.i[:count], contacts.j[:count])
    return with_modes(state, np.flatnonzero((body[i] | body[j]) & (unit[i] != unit[j])), OPEN)


def with_modes(state: State, rows: np.ndarray, mode: int) -> State:
    """Set the mode of some contacts, remove their slip, and reset their memory to the current positions."""
    contacts = state.contacts
    modes, slip, pair, roll = (a.copy() for a in (contacts.mode, contacts.slip, contacts.pair, contacts.roll))
    modes[rows], slip[rows] = mode, 0.0
    position = np.concatenate([state.grains.position, state.walls.point])
    turned = np.concatenate([state.grains.angle * state.grains.radius[:, None], np.zeros((len(state.walls.mass), 3))])
    i, j = contacts.i[rows], contacts.j[rows]
    pair[rows] = position[i] - position[j] + shifts(contacts, state.cell.vectors)[rows]
    roll[rows] = turned[i] + turned[j]
    return state._replace(contacts=contacts._replace(mode=modes, slip=slip, pair=pair, roll=roll))


APEX = 1e-6  # ratio of normal force to its mean below which a contact is at the apex of the cone
NEAR_APEX = 1e-4  # ratio of normal force to its mean below which a linear step reaches the apex to within APEX
NEAR_CONE = 1e-5  # ratio of distance from the cone to normal force below which a linear step reaches the cone
APPROACH = 0.9  # fraction of the distance to an event that a linear step would miss; c is recomputed there
TOGETHER = 1e-9  # fraction of an increment within which events are simultaneous
NEAR_BREAK = 1e-5  # margin of a bond, relative to its strength, below which a linear step breaks it
REACHES, CLOSES, AT_APEX, NEARS, INCREMENT, BREAKS = (
    "reaches the cone",
    "closes",
    "at the apex",
    "nears an event",
    "increment",
    "bond breaks",
)


class Event(NamedTuple):
    """Event on a load path."""

    load: float  # in legs of the load
    kind: str  # "reaches the cone", "opens", "closes", "bond breaks by tension", …, or why the path ends
    i: int  # bodies of the contact or bond, or one body; −1 if there is none
    j: int


class Fork(NamedTuple):
    """Load at which several combinations of statuses were consistent, and the one chosen."""

    load: float  # in legs of the load
    contacts: tuple[tuple[int, int], ...]  # bodies of the contacts whose statuses differ
    taken: tuple[str, ...]  # status of each of these contacts: "sticks", "slides", "slides back" or "opens"
    others: tuple[tuple[str, ...], ...]  # statuses of these contacts in the other combinations
    forces: bool  # True if the force rates differ; False if only a motion is undetermined


class NextEvent(NamedTuple):
    """End of a linear piece."""

    step: float  # fraction of the increment
    contacts: np.ndarray  # numbers of all simultaneous contacts; from M on: pairs that do not touch yet
    kind: str


def next_event(
    increment, force: np.ndarray, rate: np.ndarray, known: np.ndarray, choice: ContactStatus, left: float,
    moved: np.ndarray,
) -> NextEvent:  # fmt: skip
    """Find the end of a linear piece that begins with given forces.

    Parameters
    ----------
    increment : Increment
    force, rate : (M, 2) forces and their rates over the whole increment [force]
    known : (M,) bool, contacts that were on the cone with a consistent status; those that stick leave the cone
    left : remaining fraction of the increment
    moved : (n,) motion since the beginning of the increment [length]
    """
    reached = _shares_to_cone(increment, force, rate, known, choice)
    first = _first_on_cone(increment, force, reached, NextEvent(left, np.zeros(0, int), INCREMENT))
    first = _first_closing(increment, choice, _first_on_apex(increment, force, rate, first, left))
    return _first_break(increment, moved, choice.velocity, first) if increment.state.bonds else first


def _first_break(increment, moved: np.ndarray, velocity: np.ndarray, first: NextEvent) -> NextEvent:
    """Find the first bond whose load, which changes linearly, reaches its strength."""
    state, free, loose = increment.state, increment.matrix.free, increment.loose
    held = state.bonds.intact & ~(loose[state.bonds.i] | loose[state.bonds.j])
    here, ahead = (
        bond_limits(state, bond_motions(state, free.spread(way), free.strain(way))) for way in (moved, velocity)
    )
    load = here.load + here.slope
    # load over strength is convex, so a bond that holds at the end holds until then
    breaks = held & (judge_loads(state.bonds, load + first.step * ahead.slope)[0] >= 1)
    if not breaks.any():
        return first
    time = min(bond_crossings(state.bonds, load, ahead.slope, breaks)[0].min(), first.step)
    if time > 0 and bond_shares(state)[held].max() < 1 - NEAR_BREAK:
        return NextEvent(float(APPROACH * time), np.zeros(0, int), NEARS)
    return NextEvent(float(time), np.zeros(0, int), BREAKS)


def _shares_to_cone(increment, force, rate, known, choice) -> np.ndarray:
    """Return the fractions (M,) of the increment after which sticking contacts reach the cone, on either side."""
    m, reached = increment.matrix, np.full(len(force), np.inf)
    if m.width == 3:
        sticks = ~choice.sliding
        reached[sticks] = _shares_to_round_cone(m.mu[sticks], force[sticks], rate[sticks], known[sticks])
        reached[increment.paired & (force[:, 0] <= increment.faint)] = np.inf
        return reached
    for side in (1.0, -1.0):
        margin = m.mu * force[:, 0] - side * force[:, 1]
        slope = m.mu * rate[:, 0] - side * rate[:, 1]
        here = known & (side * force[:, 1] > 0)
        leaves = ~choice.sliding & ~here & (slope < -SLACK * np.abs(rate).max(initial=0.0))
        time = np.where(leaves, np.maximum(margin, 0.0) / np.where(leaves, -slope, 1.0), np.inf)
        reached = np.minimum(reached, time)
    at = np.where(np.isfinite(reached), reached, 0.0)
    reached[increment.paired & (force[:, 0] + at * rate[:, 0] <= increment.faint)] = np.inf
    return reached


def _shares_to_round_cone(mu: np.ndarray, force: np.ndarray, rate: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Return the fractions (C,) after which |F_t| = μ F_n: the first positive root of a quadratic, or infinity.

    Contacts `on` the cone, (C,) bool, leave it first.
    """
    sign = np.append(np.ones(1), -np.ones(force.shape[1] - 1))
    weight = np.where(np.arange(force.shape[1]) == 0, mu[:, None], 1.0)
    start, slope = weight * force, weight * rate
    # (μ F_n)² − |F_t|² = a x² + 2 b x + c, positive at first
    a, b, c = (slope * slope) @ sign, (start * slope) @ sign, (start * start) @ sign
    c = np.where(on, 0.0, np.maximum(c, 0.0))
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    falls = (b < 0) & ~on & (b * b >= a * c)
    rises = (b > 0) & (a < 0)
    out = np.where(falls, c / np.where(falls, root - b, 1.0), np.inf)
    return np.where(rises, (b + root) / np.where(rises, -a, 1.0), out)


def _first_on_cone(increment, force, reached, first: NextEvent) -> NextEvent:
    """Find the first contact that reaches the cone, if it does so before the end found so far."""
    m, soonest = increment.matrix, reached.min(initial=np.inf)
    # the force on a disk with two contacts turns with the line between them, which a linear step predicts poorly
    far = m.mu * force[:, 0] - np.linalg.norm(force[:, 1:], axis=1) > NEAR_CONE * force[:, 0]
    early = np.where(increment.paired & far, APPROACH * reached, np.inf).min(initial=np.inf)
    if early < min(soonest, first.step):
        return NextEvent(float(early), first.contacts, NEARS)
    if soonest < first.step:
        return NextEvent(float(soonest), np.flatnonzero(reached <= soonest + TOGETHER), REACHES)
    return first


def _first_on_apex(increment, force, rate, first: NextEvent, left: float) -> NextEvent:
    """Find the first contact whose force vanishes, if it does so before the end found so far."""
    falls = rate[:, 0] < -SLACK * np.abs(rate).max(initial=0.0)
    time = np.where(falls, np.maximum(force[:, 0], 0.0) / np.where(falls, -rate[:, 0], 1.0), np.inf)
    soonest = time.min(initial=np.inf)
    early = np.where(force[:, 0] > NEAR_APEX * increment.mean, APPROACH * time, np.inf).min(initial=np.inf)
    if early < first.step and soonest <= left:
        return NextEvent(float(early), np.zeros(0, int), NEARS)
    if soonest <= first.step:
        # contacts of disks that are held by nothing else lose their forces together, to within APEX
        faint = force[:, 0] + soonest * rate[:, 0] <= APEX * increment.mean
        return NextEvent(
            float(soonest), with_partners(increment, np.flatnonzero(faint | (time <= soonest + TOGETHER))), AT_APEX
        )
    met = first.contacts
    if first.kind == REACHES and (force[met, 0] + first.step * rate[met, 0] <= APEX * increment.mean).any():
        return first._replace(kind=AT_APEX)
    return first


def with_partners(increment, contacts: np.ndarray) -> np.ndarray:
    """Add to the given contacts the other contact of each disk that has two, since both reach the apex together."""
    chosen = np.zeros(increment.matrix.count, bool)
    chosen[contacts] = True
    while True:
        pulled = np.zeros(increment.state.n_bodies, bool)
        pulled[increment.ends[chosen].ravel()] = True
        more = ((pulled & increment.has_two)[increment.ends]).any(axis=1) | chosen
        if np.array_equal(more, chosen):
            return np.flatnonzero(chosen)
        chosen = more


def open_pairs(state: State, loose: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows of the pair list that are not among `rows` and do not involve rattlers."""
    rest = np.setdiff1d(np.arange(int(state.contacts.count[0])), rows)
    held = np.append(~loose, np.ones(state.n_bodies - len(loose), bool))
    return rest[held[state.contacts.i[rest]] & held[state.contacts.j[rest]]]


def _first_closing(increment, choice: ContactStatus, first: NextEvent) -> NextEvent:
    """Find the first pair that closes, if it does so before the end found so far."""
    state, rows = increment.state, increment.gap_rows
    moves = increment.matrix.free.spread(choice.velocity)[:, :3]
    normal, gap = gaps(state, rows)
    apart = moves[state.contacts.i[rows]] - moves[state.contacts.j[rows]]
    if increment.matrix.free.length:
        apart = apart + branch_vectors(state)[rows] @ increment.matrix.free.strain(choice.velocity).T
    closing = np.einsum("ck,ck->c", apart, normal)
    small = float(state.grains.radius.min())
    reach = np.maximum(gap, 0.0) + NUDGE * small  # slightly beyond zero, so that they touch
    time = np.where(closing < 0, reach / np.where(closing < 0, -closing, 1.0), np.inf)
    soonest = time.min(initial=np.inf)
    if not soonest < first.step:
        return first
    # a pair whose bodies move past each other overlaps more than predicted by a linear step
    aside = float((apart[time.argmin()] ** 2).sum() - closing[time.argmin()] ** 2) * soonest**2
    if increment.stiffest * aside / (2 * small) > APEX * increment.mean:
        return NextEvent(float(APPROACH * soonest), np.zeros(0, int), NEARS)
    return NextEvent(float(soonest), increment.matrix.count + np.flatnonzero(time <= soonest + TOGETHER), CLOSES)
