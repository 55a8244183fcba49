"""Pairs within reach, sorted by key, with memory carried across rebuilds: a cell list in fractional coordinates.

The bins follow the cell's vectors, so that sheared cells and boxes narrower than a grain's reach need no special case:
every image is a bin some boxes away.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from .state import Cell, State, empty_contacts

_BODY_BITS, _IMAGE_BITS = 21, 7
_IMAGE_OFFSET = 1 << (_IMAGE_BITS - 1)
MAX_BODIES = 1 << _BODY_BITS
TOO_FAR = f"two touching grains are {_IMAGE_OFFSET} or more periodic boxes apart: shift positions by whole boxes"


@njit(cache=True)
def pack_key(i, j, a, b, c):
    """One integer that sorts as (i, j, image) does."""
    key = (np.int64(i) << _BODY_BITS) | np.int64(j)
    for m in (a, b, c):
        key = (key << _IMAGE_BITS) | np.int64(m + _IMAGE_OFFSET)
    return key


class Grid(NamedTuple):
    """What a search for pairs needs of the cell: constant while the cell does not change."""

    vectors: np.ndarray  # (3, 3) [length]
    inverse: np.ndarray  # (3, 3) [1/length]
    height: np.ndarray  # (3,) distance between opposite faces [length]
    periodic: np.ndarray  # (3,) bool


def grid_of(cell: Cell) -> Grid:
    """The grid of a cell, sheared or not."""
    inverse = np.linalg.inv(cell.vectors) if cell.periodic.any() else np.eye(3)
    vectors = cell.vectors if cell.periodic.any() else np.eye(3)
    height = 1.0 / np.linalg.norm(inverse, axis=0)
    return Grid(np.ascontiguousarray(vectors), np.ascontiguousarray(inverse), height, cell.periodic)


class Bins(NamedTuple):
    """Grains sorted into bins, those of a bin side by side in memory."""

    place: np.ndarray  # (N, 3) bin of each grain
    box: np.ndarray  # (N, 3) periodic box in which it lies
    start: np.ndarray  # (bins + 1,) first entry of each bin
    member: np.ndarray  # (N,) grain of each entry
    wrapped: np.ndarray  # (N, 4) position in box 0 and radius of each entry
    turn: np.ndarray  # (3, …) where a step beyond the bins along each axis ends up: bin ≥ 0, or −1 outside
    over: np.ndarray  # (3, …) and how many boxes away
    around: np.ndarray  # (3,) bins to look at on either side


@njit(cache=True, fastmath=False)
def _placed(x, n, radius, grid, reach):
    """Bins of all grains in fractional coordinates."""
    fraction, box = np.empty((n, 3)), np.zeros((n, 3), np.int64)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for a in range(n):
        for k in range(3):
            f = 0.0
            for m in range(3):
                f += x[a, m] * grid.inverse[m, k]
            if not abs(f) < 1e15:  # NaN touches nothing, wherever it is put
                f = 0.0
            if grid.periodic[k]:
                box[a, k] = np.int64(np.floor(f))
                f -= box[a, k]
            fraction[a, k] = f
            low[k], high[k] = min(low[k], f), max(high[k], f)
    bins, around, place = np.ones(3, np.int64), np.zeros(3, np.int64), np.zeros((n, 3), np.int64)
    most = np.int64(np.ceil((4.0 * n) ** (1 / 3))) + 1
    for k in range(3):
        if grid.periodic[k]:
            low[k], high[k] = 0.0, 1.0
        span = (high[k] - low[k]) * grid.height[k]
        wide = max(span / reach, 1.0)
        bins[k] = np.int64(min(wide, 1e6))
    while bins[0] * bins[1] * bins[2] > 8 * n + most:
        bins[np.argmax(bins)] = (bins.max() + 1) // 2
    for k in range(3):
        span = (high[k] - low[k]) * grid.height[k]
        if span > 0.0 and (grid.periodic[k] or bins[k] > 1):
            around[k] = np.int64(np.ceil(reach * bins[k] / span))
        for a in range(n):
            if bins[k] > 1:
                at = np.int64((fraction[a, k] - low[k]) / (high[k] - low[k]) * bins[k])
                place[a, k] = min(max(at, 0), bins[k] - 1)
    stride = np.array([bins[1] * bins[2], bins[2], 1])
    turn, over = np.full((3, (bins + 2 * around).max()), -1), np.zeros((3, (bins + 2 * around).max()), np.int64)
    for k in range(3):
        for u in range(-around[k], bins[k] + around[k]):
            q = u // bins[k]
            if q == 0 or grid.periodic[k]:
                turn[k, u + around[k]], over[k, u + around[k]] = (u - q * bins[k]) * stride[k], q
    start = np.zeros(bins[0] * bins[1] * bins[2] + 1, np.int64)
    for a in range(n):
        start[place[a, 0] * stride[0] + place[a, 1] * stride[1] + place[a, 2] + 1] += 1
    start = np.cumsum(start)
    member, wrapped, filled = np.empty(n, np.int64), np.empty((n, 4)), start.copy()
    for a in range(n):
        b = place[a, 0] * stride[0] + place[a, 1] * stride[1] + place[a, 2]
        e = filled[b]
        filled[b] += 1
        member[e], wrapped[e, 3] = a, radius[a]
        for m in range(3):
            wrapped[e, m] = x[a, m]
            for k in range(3):
                wrapped[e, m] -= box[a, k] * grid.vectors[k, m]
    return Bins(place, box, start, member, wrapped, turn, over, around)


@njit(cache=True)
def _sort_by_key(first, last, i, j, image, key):
    """Insertion sort of a short stretch of the list."""
    for c in range(first + 1, last):
        d = c
        while d > first and key[d - 1] > key[d]:
            key[d - 1], key[d] = key[d], key[d - 1]
            j[d - 1], j[d] = j[d], j[d - 1]
            for m in range(3):
                image[d - 1, m], image[d, m] = image[d, m], image[d - 1, m]
            d -= 1


@njit(cache=True)
def candidate_pairs(x, radius, wall_normal, grid, skin, i, j, image, key):
    """Fill the arrays with all pairs closer than `skin` beyond touching, sorted by key: a cell list.

    Returns the number of pairs, which may exceed the capacity (then call again with more room), or −1 if a pair lies
    more boxes apart than a key can hold.
    """
    n, n_bodies, vectors = len(radius) - len(wall_normal), len(radius), grid.vectors
    capacity, count = len(i), 0
    bins = _placed(x, n, radius, grid, 2 * radius[:n].max() + skin)
    start, member, wrapped, box, turn, over = bins.start, bins.member, bins.wrapped, bins.box, bins.turn, bins.over
    wide, high, deep = 2 * bins.around + 1
    own = np.empty(3)
    for a in range(n):
        first, near = count, radius[a] + skin
        for m in range(3):
            own[m] = x[a, m]
            for k in range(3):
                own[m] -= box[a, k] * vectors[k, m]
        for u in range(bins.place[a, 0], bins.place[a, 0] + wide):
            if turn[0, u] < 0:
                continue
            for v in range(bins.place[a, 1], bins.place[a, 1] + high):
                if turn[1, v] < 0:
                    continue
                w = bins.place[a, 2]
                last = w + deep
                while w < last:
                    if turn[2, w] < 0:
                        w += 1
                        continue
                    # bins side by side along the last axis are side by side in memory: looked through in one go
                    q0, q1, q2, at = over[0, u], over[1, v], over[2, w], turn[0, u] + turn[1, v] + turn[2, w]
                    begin = at
                    while w < last and over[2, w] == q2 and turn[2, w] >= 0:
                        at += 1
                        w += 1
                    sx, sy, sz = own[0], own[1], own[2]
                    if q0 != 0 or q1 != 0 or q2 != 0:
                        sx -= q0 * vectors[0, 0] + q1 * vectors[1, 0] + q2 * vectors[2, 0]
                        sy -= q0 * vectors[0, 1] + q1 * vectors[1, 1] + q2 * vectors[2, 1]
                        sz -= q0 * vectors[0, 2] + q1 * vectors[1, 2] + q2 * vectors[2, 2]
                    for e in range(np.uint64(start[begin]), np.uint64(start[at])):
                        dx, dy, dz = sx - wrapped[e, 0], sy - wrapped[e, 1], sz - wrapped[e, 2]
                        reach = near + wrapped[e, 3]
                        if not dx * dx + dy * dy + dz * dz < reach * reach:
                            continue
                        b = member[e]
                        if b < a:
                            continue
                        p, q, r = box[b, 0] - box[a, 0] - q0, box[b, 1] - box[a, 1] - q1, box[b, 2] - box[a, 2] - q2
                        if a == b and (p < 0 or (p == 0 and (q < 0 or (q == 0 and r <= 0)))):
                            continue
                        if max(abs(p), abs(q), abs(r)) >= _IMAGE_OFFSET:
                            return -1
                        if count < capacity:
                            i[count], j[count], key[count] = a, b, pack_key(a, b, p, q, r)
                            image[count, 0], image[count, 1], image[count, 2] = p, q, r
                        count += 1
        if count <= capacity:
            _sort_by_key(first, count, i, j, image, key)
        for b in range(n, n_bodies):
            gap = -radius[a] - skin
            for k in range(3):
                gap += (x[a, k] - x[b, k]) * wall_normal[b - n, k]
            if gap < 0.0:
                if count < capacity:
                    i[count], j[count], key[count] = a, b, pack_key(a, b, 0, 0, 0)
                    image[count] = 0
                count += 1
    return count


@njit(cache=True)
def carry_memory(old, new):
    """Copy the memory of every contact that is in both sorted lists; the rest of `new` starts open."""
    c = 0
    for m in range(new.count[0]):
        while c < old.count[0] and old.key[c] < new.key[m]:
            c += 1
        if c < old.count[0] and old.key[c] == new.key[m]:
            new.slip[m], new.pair[m], new.roll[m] = old.slip[c], old.pair[c], old.roll[c]
            new.mode[m], new.reached[m] = old.mode[c], old.reached[c]


@njit(cache=True, fastmath=False)
def farthest(x, contacts):
    """Distance of the body that moved most since the list was made; infinite if none was made."""
    most = 0.0
    for a in range(len(x)):
        square = 0.0
        for m in range(3):
            d = x[a, m] - contacts.origin[a, m]
            square += d * d
        if not square <= most:
            most = square if square < np.inf else np.inf
    return np.sqrt(most)


def moved_too_far(x, contacts) -> bool:
    """True if some body has moved by half the skin since the list was made, or if none was made."""
    return not farthest(x, contacts) <= 0.5 * contacts.skin[0]


@njit(cache=True)
def rebuilt(x, radius, wall_normal, grid, old):
    """A new list of contacts at positions x, with the memory of the old one; its count is −1 on failure."""
    capacity = max(len(old.i), 4 * len(x))
    while True:
        new = empty_contacts(len(x), capacity, old.skin[0])
        count = candidate_pairs(x, radius, wall_normal, grid, new.skin[0], new.i, new.j, new.image, new.key)
        if count <= capacity:
            break
        capacity = count + count // 16
    new.count[0] = count
    new.origin[:] = x
    if count > 0:
        carry_memory(old, new)
    return new


def body_positions(state: State) -> np.ndarray:
    """(N + W, 3) positions of grains and of a point of each wall [length]."""
    return np.concatenate([state.grains.position, state.walls.point])


def body_radii(state: State) -> np.ndarray:
    """(N + W,) radii [length]; zero for walls."""
    return np.concatenate([state.grains.radius, np.zeros(len(state.walls.mass))])


def updated(state: State) -> State:
    """The state with a list of contacts that is valid at its positions; memory is carried by key."""
    x = body_positions(state)
    if not moved_too_far(x, state.contacts):
        return state
    if len(x) > MAX_BODIES:
        raise ValueError(f"{len(x)} bodies were given: at most {MAX_BODIES} are supported")
    contacts = rebuilt(x, body_radii(state), state.walls.normal, grid_of(state.cell), state.contacts)
    if contacts.count[0] < 0:
        raise ValueError(TOO_FAR)
    return state._replace(contacts=contacts)


def without_walls(state: State, walls) -> State:
    """The state without some walls, numbers 0 … W−1; all other contacts keep their memory, later walls move up.

    Examples
    --------
    >>> from stickslip import assembly, disks, flat_walls
    >>> state = assembly(disks([[0.5, 0.5]], 0.5), flat_walls([[0, 0], [0, 0]], [[0, 1], [1, 0]]))
    >>> without_walls(state, [0]).walls.normal
    array([[1., 0., 0.]])
    """
    contacts, n, count = state.contacts, len(state.grains.radius), int(state.contacts.count[0])
    kept = np.ones(state.n_bodies, bool)
    kept[n + np.asarray(walls, np.int64)] = False
    rows = np.flatnonzero(kept[contacts.j[:count]])
    number = np.cumsum(kept) - 1
    per_row = ("i", "j", "image", "key", "slip", "mode", "pair", "roll", "reached")
    fields = {name: getattr(contacts, name)[rows] for name in per_row}
    fields["j"] = number[fields["j"]].astype(fields["j"].dtype)
    shift = (contacts.j[rows].astype(np.int64) - fields["j"]) << (3 * _IMAGE_BITS)  # see `pack_key`
    fields["key"] = fields["key"] - shift
    per_body = ("force", "torque", "free", "rate", "group", "follows")
    control = state.control._replace(**{name: getattr(state.control, name)[kept] for name in per_body})
    return state._replace(
        walls=type(state.walls)(*(part[kept[n:]] for part in state.walls)),
        contacts=contacts._replace(**fields, origin=contacts.origin[kept], count=np.array([len(rows)])),
        control=control,
    )
