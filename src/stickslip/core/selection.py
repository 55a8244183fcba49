"""Which pairs go into which blocks, and where grains lie in memory: see `blocks`."""

import numpy as np
from numba import njit

from .blocks import LANES, LOOSE, STUCK_AGAIN, Blocks
from .contact import effective, needs_mass, needs_radius
from .state import OPEN, SLIDE, STICK


@njit(cache=True)
def morton(x, inverse, low, size):
    """(n,) places along a space-filling curve through cells of `size`."""
    key = np.zeros(len(x), np.int64)
    for a in range(len(x)):
        for k in range(3):
            f = 0.0
            for m in range(3):
                f += (x[a, m] - low[m]) * inverse[m, k]
            cell = np.int64(max(f, 0.0) / size[k])
            for bit in range(20):
                key[a] |= ((cell >> bit) & 1) << (3 * bit + k)
    return key


@njit(cache=True)
def _room(old, need):
    """The old array if it is long enough: fresh memory costs more than what is written to it."""
    return old if len(old) >= need else np.empty(need + need // 8, old.dtype)


@njit(cache=True)
def _chosen(
    contacts, position, radius, normal, vectors, internal, tile_of, last, n, reach, materials, material, group, mate
):
    """Group and pair class of every row that touches or may soon touch; others get group −1. Returns their number."""
    number, tiles = 0, tile_of.max() + 1 if len(tile_of) else 1
    for c in range(contacts.count[0]):
        i, j = contacts.i[c], contacts.j[c]
        wall = j >= n
        across = contacts.image[c, 0] != 0 or contacts.image[c, 1] != 0 or contacts.image[c, 2] != 0
        gap, square = -radius[i], 0.0
        for m in range(3):
            d = position[i, m] - position[j, m]
            if wall:
                gap += d * normal[j - n, m]
            else:
                if across:
                    for k in range(3):
                        d += contacts.image[c, k] * vectors[k, m]
                square += d * d
        if not wall:
            gap = np.sqrt(square) - radius[i] - radius[j]
        group[c] = -1
        if gap < reach or contacts.mode[c] != OPEN:
            number += 1
            a, b = tile_of[internal[i]], tile_of[internal[j]]
            group[c] = min(a, b) + (tiles if a == b and a < last else 0)
            mate[c] = (material[i] * materials + material[j]) * 2 + wall
    return number


@njit(cache=True)
def _bucketed(count, group, mate, groups, classes):
    """Blocks of every (group, class) bucket: first block of each, and of each group."""
    held = np.zeros(groups * classes, np.int64)
    for c in range(count):
        if group[c] >= 0:
            held[group[c] * classes + mate[c]] += 1
    first = np.zeros(groups * classes + 1, np.int64)
    for k in range(groups * classes):
        first[k + 1] = first[k] + (held[k] + LANES - 1) // LANES
    return first, first[::classes].copy()


@njit(cache=True)
def _in_order(contacts, group, internal, active):
    """Rows that are in a group, in the order of the first of their bodies in memory."""
    start = np.zeros(len(internal) + 1, np.int64)
    for c in range(contacts.count[0]):
        if group[c] >= 0:
            start[min(internal[contacts.i[c]], internal[contacts.j[c]]) + 1] += 1
    start = np.cumsum(start)
    out = np.empty(active, np.int64)
    for c in range(contacts.count[0]):
        if group[c] >= 0:
            owner = min(internal[contacts.i[c]], internal[contacts.j[c]])
            out[start[owner]] = c
            start[owner] += 1
    return out


@njit(cache=True)
def _rows_of_loads(place, bound, top, crossing, share):
    """Set the first row of every block's loads; the tiles of a thread share rows. Returns the number of rows."""
    for b in range(crossing):
        place[b] = b * LANES
    largest = 0
    for t in range(top, 2 * top):
        largest = max(largest, bound[t + 1] - bound[t])
    for k in range(len(share) - 1):
        for t in range(top + share[k], top + share[k + 1]):
            for b in range(bound[t], bound[t + 1]):
                place[b] = (crossing + k * largest + b - bound[t]) * LANES
    return (crossing + (len(share) - 1) * largest) * LANES


@njit(cache=True)
def _pad(slots, bodies, far, asked, i, j, row, wall, shifted, vector, eff, slip, mode):
    """Fill lanes without a contact with a pair of a body with itself, `far` from touching."""
    for s in range(slots):
        if row[s] < 0:
            b, l = s // LANES, s % LANES
            i[s] = j[s] = bodies - 1 if wall[b] else 0
            mode[s] = OPEN
            if not wall[b] and not shifted[b]:
                shifted[b] = True
                vector[3 * LANES * b : 3 * LANES * (b + 1)] = 0.0
            for m in range(3):
                slip[(3 * b + m) * LANES + l] = 0.0
                vector[(3 * b + m) * LANES + l] = 0.0 if wall[b] or m else far
            for m in range(2 if asked else 0):
                eff[(2 * b + m) * LANES + l] = 1.0


@njit(cache=True)
def _order_of_summation(contacts, group, mate, internal, start, code):
    """From counts in `start` to the rows of loads that each body adds up: as j, then as i, in the order of partners."""
    for k in range(len(start) - 1):
        start[k + 1] += start[k]
    for c in range(contacts.count[0]):
        if group[c] >= 0:
            for at in (2 * internal[contacts.j[c]] + 1, 2 * internal[contacts.i[c]] + 2):
                code[start[at]] = mate[c]
                start[at] += 1


@njit(cache=True)
def chosen_blocks(
    old, contacts, position, radius, inverse_mass, material, normal, vectors, order, tile, share, n, reach,
    materials, kind, viscous, imposed,
):  # fmt: skip
    """Blocks of all pairs nearer than `reach`, in the memory of `old` ones; positions in the state's order.

    The tiles of a thread share rows of loads, which stay in its cache.
    """
    across = np.eye(3) if imposed else vectors
    count, bodies, tiles = contacts.count[0], len(radius), len(tile) - 1
    internal, tile_of = np.empty(bodies, np.int64), np.empty(bodies, np.int64)
    for g in range(bodies):
        internal[order[g]] = g
    for t in range(tiles):
        tile_of[tile[t] : tile[t + 1]] = t
    tile_of[tile[tiles] :] = tiles
    group, mate, classes = np.empty(count, np.int64), np.empty(count, np.int64), 2 * materials * materials
    # the walls' tile has no blocks of its own: groups 0 … tiles are cross, then inner
    active = _chosen(
        contacts, position, radius, normal, vectors, internal, tile_of, tiles, n, reach, materials, material, group,
        mate,
    )  # fmt: skip
    top = tile_of.max() + 1
    first, bound = _bucketed(count, group, mate, 2 * top, classes)
    blocks = first[-1]
    slots = blocks * LANES
    crossing, asked = bound[top], needs_radius(kind, viscous) or needs_mass(viscous)
    i, j, row = _room(old.i, slots), _room(old.j, slots), _room(old.row, slots)
    vector, eff, slip = (
        _room(old.vector, 3 * slots),
        _room(old.effective, 2 * slots if asked else 0),
        _room(old.slip, 3 * slots),
    )
    mode, place = _room(old.mode, slots), _room(old.place, blocks)
    row[:slots] = -1
    pair, wall, shifted = np.zeros((blocks, 2), np.int64), np.zeros(blocks, np.bool_), np.zeros(blocks, np.bool_)
    most = _rows_of_loads(place, bound, top, crossing, share)
    filled = first[:-1] * LANES
    start = np.zeros(2 * bodies + 2, np.uint32)
    for c in _in_order(contacts, group, internal, active):
        bucket = group[c] * classes + mate[c]
        s = filled[bucket]
        filled[bucket] += 1
        b, l = s // LANES, s % LANES
        a, z = contacts.i[c], contacts.j[c]
        is_wall = z >= n
        i[s], j[s], row[s] = internal[a], internal[z], c
        pair[b, 0], pair[b, 1], wall[b] = material[a], material[z], is_wall
        at = 3 * LANES * b + l
        if asked:
            r_eff, m_eff = effective(kind, viscous, radius, inverse_mass, a, z, is_wall)
            eff[at - LANES * b], eff[at - LANES * b + LANES] = r_eff, m_eff
        for m in range(3):
            slip[at + m * LANES] = contacts.slip[c, m]
            if is_wall:
                vector[at + m * LANES] = normal[z - n, m]
        if contacts.image[c, 0] != 0 or contacts.image[c, 1] != 0 or contacts.image[c, 2] != 0:
            if not shifted[b]:
                shifted[b] = True
                vector[3 * LANES * b : 3 * LANES * (b + 1)] = 0.0
            for k in range(3):
                for m in range(3):
                    vector[at + m * LANES] += contacts.image[c, k] * across[k, m]
        was = contacts.mode[c]
        if was == STICK and contacts.reached[c]:
            was = STUCK_AGAIN
        elif was == SLIDE and not contacts.reached[c]:
            was = LOOSE
        mode[s] = was
        start[2 * internal[z] + 2] += 1
        start[2 * internal[a] + 3] += 1
        mate[c] = place[b] + l
    _pad(slots, bodies, 4.0 * radius.max() + 1.0, asked, i, j, row, wall, shifted, vector, eff, slip, mode)
    code, load = _room(old.code, 2 * active), old.load
    if len(load) < most:
        load = np.empty((most + most // 8, 9 if imposed else 6))
    _order_of_summation(contacts, group, mate, internal, start, code)
    return Blocks(
        i, j, row, pair, wall, shifted, vector, eff, slip, mode, place, bound[: top + 1].copy(), bound[top:].copy(),
        load, start[: 2 * bodies + 1].copy(), code,
    )  # fmt: skip
