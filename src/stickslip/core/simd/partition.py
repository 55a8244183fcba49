"""Assignment of pairs to blocks, and of grains to tiles and threads: see `blocks`."""

from functools import cache

import numpy as np
from numba import njit, prange

from ..contacts.mechanics import effective_mass, effective_radius, needs_mass
from ..options import INNER
from ..state import OPEN, SLIDE, STICK
from .blocks import LOOSE, STUCK_AGAIN, Blocks, commit
from .reduce import IS_FIRST, IS_I, PREFETCH_DISTANCE, ROW, WIDTH
from .transpose import LANES, RADIUS, empty_aligned

# columns of a picked pair: its row in the list; its bodies in the order of memory; its bucket times _BUCKET, plus _FAR
# if its block needs vectors, plus its mode in a block; its class: 0 if it touches, else by distance
_ROW, _I, _J, _BUCKET_AND_MODE, _CLASS, _COLUMNS = range(6)
_FAR, _BUCKET = 8, 16
_CLASSES = 8


def split_layers(x, rows, parts):
    """Split some of the points x (3, n) into equal-sized parts of neighbours: layers, rows within these, and so on.

    Parts are ordered by layers along the longest side, so that at any time few pairs connect earlier parts with later
    ones.
    """
    if parts == 1 or not len(rows):
        return [rows] * parts
    sides = np.array([np.ptp(one[rows]) for one in x])
    wide, along = sides[sides > 0], x[np.argmax(sides)]
    edge = (wide.prod() / parts) ** (1 / len(wide)) if len(wide) else 0.0
    layers = min(parts, max(2, round(sides.max() / edge))) if edge else parts
    bound = parts * np.arange(layers + 1) // layers
    cut = len(rows) * bound // parts
    rows = rows[np.argpartition(along[rows], cut[1:-1])]
    layer = [split_layers(x, rows[cut[k] : cut[k + 1]], bound[k + 1] - bound[k]) for k in range(layers)]
    return [part for parts in layer for part in parts]


def balance_threads(share, spent):
    """Tile bounds that equalise the times of the threads, given the time each `spent` on its previous tiles.

    Cores differ: some are slower by design, and others are shared with other processes.
    """
    if not (spent > 0).all():
        return share
    speed, rank = np.diff(share) / spent, np.arange(1, len(share))
    bound = np.rint(share[-1] * np.cumsum(speed) / speed.sum())
    bound = np.maximum.accumulate(np.maximum(bound - rank, 0)) + rank  # each thread keeps a tile
    return np.append(0, np.minimum(bound, share[-1] - rank[::-1] + 1)).astype(share.dtype)


@njit(cache=True)
def morton_keys(x, size):
    """Morton keys (n,) of points (3, n) in cells of `size`; coordinates must not be negative."""
    key = np.zeros(x.shape[1], np.int64)
    for k in range(3):
        for a in range(len(key)):
            cell = np.int64(x[k, a] / size)
            for bit in range(20):
                key[a] |= ((cell >> bit) & 1) << (3 * bit + k)
    return key


@njit(cache=True, **INNER)
def _grow(old, need):
    """Return the old array if it is long enough, else a new one.

    Allocating new memory costs more than writing to it.
    """
    return old if len(old) >= need else np.empty(need + need // 8, old.dtype)


@njit(cache=True, **INNER)
def _first_rows(contacts, bodies):
    """First row of each body, (B + 1,), in the list, which is sorted by the first body of each pair."""
    first = np.zeros(bodies + 1, np.int32)
    for c in range(np.uint64(contacts.count[0])):
        first[np.uint64(contacts.i[c]) + np.uint64(1)] += 1
    for a in range(bodies):
        first[a + 1] += first[a]
    return first


@njit(error_model="numpy", forceinline=True, **INNER)
def _distance_class(mode, left, most):
    """Class of a pair: 0 if it touches, else increasing with distance; `left` is the remaining part of `most`."""
    if mode != OPEN:
        return 0
    # bounded as a float, because without a skin `most` is zero and the quotient infinite
    return _CLASSES - 1 - np.int64(min((_CLASSES - 1) * max(left, 0.0) / most, _CLASSES - 2.0))


@njit(cache=True, error_model="numpy", _nrt=False, **INNER)
def _pick_pairs(
    begin, end, contacts, moving, first, internal, tile_of, worker, normal, vectors, room, gap, materials, material,
    picked, start, held,
):  # fmt: skip
    """Pick all pairs that touch or may soon touch, for first bodies `begin` to `end` in memory order.

    Returns their number. A row of `picked` holds all the data that blocks need about a pair, except its slip, so that
    the list is read only once. Stores the number of pairs of each body in `start` and of each bucket in `held`. Buckets
    hold pairs between a tile and later ones of the same thread, then pairs between threads or within the last tile,
    and finally pairs within each of the other tiles; each pair of materials has separate buckets.
    """
    order, body, image, mode, last = moving.order, moving.body, contacts.image, contacts.mode, len(moving.tile) - 1
    number, n = np.uint64(0), np.uint64(len(order) - len(normal))
    for g in range(np.uint64(begin), np.uint64(end)):  # unsigned, so that indices are not checked for negative values
        a = np.uint64(order[g])
        for c in range(np.uint64(first[a]), np.uint64(first[a + np.uint64(1)])):
            z = np.uint64(contacts.j[c])
            h = np.uint64(internal[z])
            dx, dy, dz = body[g, 0] - body[h, 0], body[g, 1] - body[h, 1], body[g, 2] - body[h, 2]
            touch = body[g, RADIUS] + body[h, RADIUS]
            near = gap + room[g] + room[h] + touch
            if z >= n:
                square = max(dx * normal[z - n, 0] + dy * normal[z - n, 1] + dz * normal[z - n, 2], 0.0) ** 2
            else:
                if image[c, 0] != 0 or image[c, 1] != 0 or image[c, 2] != 0:
                    dx += image[c, 0] * vectors[0, 0] + image[c, 1] * vectors[1, 0] + image[c, 2] * vectors[2, 0]
                    dy += image[c, 0] * vectors[0, 1] + image[c, 1] * vectors[1, 1] + image[c, 2] * vectors[2, 1]
                    dz += image[c, 0] * vectors[0, 2] + image[c, 1] * vectors[1, 2] + image[c, 2] * vectors[2, 2]
                square = dx * dx + dy * dy + dz * dz
            if square < near * near or mode[c] != OPEN:
                group, later = min(tile_of[g], tile_of[h]), max(tile_of[g], tile_of[h])
                if group == later and later < last:
                    group += last + 1
                elif later < last and worker[group] != worker[later]:
                    group = last
                kind = group if materials == 1 else (group * materials + material[a]) * materials + material[z]
                bucket = 2 * kind + (z >= n)
                moved = z < n and (image[c, 0] != 0 or image[c, 1] != 0 or image[c, 2] != 0)
                now = STUCK_AGAIN if mode[c] == STICK and contacts.reached[c] else mode[c]
                now = LOOSE if mode[c] == SLIDE and not contacts.reached[c] else now
                picked[number, _ROW], picked[number, _I], picked[number, _J] = c, g, h
                picked[number, _BUCKET_AND_MODE] = bucket * _BUCKET + (_FAR if moved or z >= n else 0) + now
                picked[number, _CLASS] = _distance_class(now, near * near - square, near * near - touch * touch)
                held[np.uint64(bucket)] += 1
                start[h + np.uint64(2)] += 1
                start[g + np.uint64(2)] += 1
                number += np.uint64(1)
    return number


@njit(cache=True, **INNER)
def _assign_load_rows(place, bound, top, share, tile_of, i, j, row):
    """Assign each block its first row of loads. Returns the number of rows.

    Blocks of pairs between threads have separate rows. Tiles of a thread share rows for pairs within a tile. Rows for
    pairs between tiles are reused by another block as soon as the last of the tiles has summed them.
    """
    rows, following, due = 0, np.empty(bound[top], np.int32), np.full(top, -1, np.int32)
    for b in range(bound[top - 1], bound[top]):
        place[b] = rows
        rows += LANES
    for k in range(len(share) - 1):
        given, inner, largest = np.empty(bound[share[k + 1]] - bound[share[k]], np.int64), top + share[k], 0
        count = 0
        for t in range(share[k], share[k + 1]):
            for b in range(bound[t], bound[t + 1]):
                if count:
                    count -= 1
                    place[b] = given[count]
                else:
                    place[b] = rows
                    rows += LANES
                last = t
                for s in range(LANES * b, LANES * (b + 1)):
                    if row[s] >= 0:
                        last = max(last, tile_of[i[s]], tile_of[j[s]])
                following[b], due[last] = due[last], b
            b = due[t]
            while b >= 0:
                given[count] = place[b]
                count += 1
                b = following[b]
            largest = max(largest, bound[top + t + 1] - bound[top + t])
        for t in range(inner, top + share[k + 1]):
            for b in range(bound[t], bound[t + 1]):
                place[b] = rows + (b - bound[t]) * LANES
        rows += largest * LANES
    return rows


@njit(cache=True, _nrt=False, **INNER)
def _pad_blocks(from_slot, to_slot, bodies, i, j, row, wall, at, size, mass, slip, mode):
    """Fill unused lanes of a block with a body paired with itself; the pair's vector keeps it from touching."""
    b = from_slot // LANES
    if to_slot > from_slot:
        at[b] = 0
    for s in range(from_slot, to_slot):
        l = s % LANES
        i[s] = j[s] = bodies - 1 if wall[b] else 0
        row[s], mode[s] = -1, OPEN
        for m in range(3):
            slip[(3 * b + m) * LANES + l] = 0.0
        if len(size):
            size[s] = 1.0
        if len(mass):
            mass[s] = 1.0


@njit(cache=True, _nrt=False, **INNER)
def _place_vectors(at):
    """Replace marks of blocks with the starts of their vectors, and return the end of the last one."""
    end = 0
    for b in range(len(at)):
        if at[b] >= 0:
            at[b] = end
            end += 3 * LANES
    return end


@njit(cache=True, _nrt=False, **INNER)
def _write_vectors(contacts, row, wall, at, normal, across, bodies, far, vector):
    """Write the vectors of all blocks that have them; `far` prevents a body from touching itself."""
    n, image = bodies - len(normal), contacts.image
    for b in range(len(at)):
        if at[b] < 0:
            continue
        for l in range(LANES):
            c = row[LANES * b + l]
            for m in range(3):
                value = 0.0
                if c < 0:
                    value = 0.0 if wall[b] or m else far
                elif wall[b]:
                    value = normal[contacts.j[c] - n, m]
                else:
                    for k in range(3):
                        value += image[c, k] * across[k, m]
                vector[at[b] + m * LANES + l] = value


@njit(cache=True, _nrt=False, **INNER)
def _write_summation_order(contacts, slot, place, internal, start, code, nothing):
    """Convert counts in `start` to the loads that each body sums, in the order of partners.

    A body without loads gets the row `nothing`, so that it also has a first row.
    """
    one, lanes = np.uint64(1), np.uint64(LANES)
    for a in range(len(internal)):
        held = start[a + 2]
        start[a + 2] = start[a + 1] + max(held, 1)
        if held == 0:
            code[start[a + 1]] = nothing * ROW
            start[a + 1] += 1
    for c in range(np.uint64(contacts.count[0])):
        if slot[c] >= 0:
            s = np.uint64(slot[c])
            load = (np.uint64(place[s // lanes]) + s % lanes) * np.uint64(ROW)
            a = np.uint64(internal[np.uint64(contacts.i[c])]) + one
            z = np.uint64(internal[np.uint64(contacts.j[c])]) + one
            code[np.uint64(start[z])] = load
            start[z] += 1  # before the next line, as a grain may touch its own image
            code[np.uint64(start[a])] = load + np.uint64(IS_I)
            start[a] += 1
    for a in range(len(internal)):
        code[start[a]] += IS_FIRST


@njit(cache=True, _nrt=False, **INNER)
def _rank(picked, p, tile_of, crossing):
    """Rank of a pair: by its last tile if it connects tiles of one thread, and then by its class."""
    g, h = np.uint64(picked[p, _I]), np.uint64(picked[p, _J])
    last = max(tile_of[g], tile_of[h]) if picked[p, _BUCKET_AND_MODE] < crossing * _BUCKET else 0
    return np.uint64(_CLASSES * last + picked[p, _CLASS])


@njit(cache=True, **INNER)
def _sort_picked(picked, tile_of, tiles, crossing):
    """Sort pairs between tiles of a thread by their last tile, after all others, and pairs of a tile by their class.

    `crossing` is the number of buckets of pairs between tiles.
    """
    first, turn = np.zeros(_CLASSES * tiles + 1, np.int64), np.empty(len(picked), np.int32)
    for p in range(np.uint64(len(picked))):
        first[_rank(picked, p, tile_of, crossing) + np.uint64(1)] += 1
    for t in range(_CLASSES * tiles):
        first[t + 1] += first[t]
    for p in range(np.uint64(len(picked))):
        t = _rank(picked, p, tile_of, crossing)
        turn[np.uint64(first[t])] = p
        first[t] += 1
    return turn


@njit(cache=True, error_model="numpy", _nrt=False, **INNER)
def _fill_blocks(picked, turn, filled, contacts, order, materials, material, radius, inverse_mass, parts, slot):
    """Write the picked pairs to the lanes of their buckets' blocks, and mark blocks that need vectors."""
    i, j, row, size, mass, slip, mode, pair, wall, at = parts
    lanes = np.uint64(LANES)
    for k in range(np.uint64(len(turn))):  # unsigned, see `_pick_pairs`
        p = np.uint64(turn[k])
        c, what = np.uint64(picked[p, _ROW]), picked[p, _BUCKET_AND_MODE]
        g, h, within = np.uint64(picked[p, _I]), np.uint64(picked[p, _J]), np.uint64(what // _BUCKET)
        is_wall = within & np.uint64(1) == np.uint64(1)
        s = np.uint64(filled[within])
        filled[within] += 1
        b, l = s // lanes, s % lanes
        i[s], j[s], row[s], wall[b], mode[s], slot[c] = g, h, c, is_wall, what % _FAR, s
        if materials > 1:
            pair[b, 0], pair[b, 1] = material[order[g]], material[order[h]]
        if len(size):
            size[s] = effective_radius(radius, g, h, is_wall)
        if len(mass):
            mass[s] = effective_mass(inverse_mass, np.uint64(order[g]), np.uint64(order[h]))
        for m in range(np.uint64(3)):
            slip[(np.uint64(3) * b + m) * lanes + l] = contacts.slip[c, m]
        if what & _FAR:
            at[b] = 0


@njit(cache=True, **INNER)
def _prepare(contacts, moving, workers, materials):
    """Prepare places, tiles and threads of bodies, and a separate range of rows for the pairs picked by each thread."""
    order, tile, share, bodies = moving.order, moving.tile, moving.share, len(moving.order)
    internal, tile_of = np.empty(bodies, np.int32), np.empty(bodies, np.int32)
    for g in range(bodies):
        internal[order[g]] = g
    for t in range(len(tile)):
        tile_of[tile[t] : tile[t + 1] if t + 1 < len(tile) else bodies] = t
    worker, own = np.zeros(len(tile), np.int32), np.zeros((workers, 2), np.int64)
    for k in range(workers):
        worker[share[k] : share[k + 1]] = k
        own[k, 0], own[k, 1] = tile[share[k]], tile[share[k + 1]] if k + 1 < workers else bodies
    first, begin = _first_rows(contacts, bodies), np.zeros(workers, np.int64)
    for k in range(workers - 1):
        begin[k + 1] = begin[k]
        for g in range(own[k, 0], own[k, 1]):
            begin[k + 1] += first[order[g] + 1] - first[order[g]]
    picked, start = np.empty((contacts.count[0], _COLUMNS), np.int32), np.zeros((workers, bodies + 2), np.uint32)
    held = np.zeros((workers, 2 * len(tile) * materials * materials * 2), np.int64)
    return internal, tile_of, worker, own, first, begin, picked, start, held


@njit(cache=True, **INNER)
def _lay_out(old, contacts, moving, start, held, materials, by_size, viscous):
    """Allocate all blocks, in the memory of `old` if it is large enough, and find the slots of each thread and bucket.

    The counts of each body are summed over threads into the first row of `start`.
    """
    workers, buckets, top = len(held), held.shape[1], len(moving.tile)
    classes, first, filled = buckets // (2 * top), np.zeros(buckets + 1, np.int64), np.empty_like(held)
    for k in range(buckets):
        pairs = 0
        for w in range(workers):
            filled[w, k] = first[k] * LANES + pairs
            pairs += held[w, k]
        first[k + 1] = first[k] + (pairs + LANES - 1) // LANES
    for w in range(1, workers):
        for a in range(start.shape[1]):
            start[0, a] += start[w, a]
    blocks, bound = first[-1], first[::classes].copy()
    slots = blocks * LANES
    i, j, row = _grow(old.i, slots), _grow(old.j, slots), _grow(old.row, slots)
    size, mass = _grow(old.size, slots if by_size else 0), _grow(old.mass, slots if needs_mass(viscous) else 0)
    slip, mode, place = _grow(old.slip, 3 * slots), _grow(old.mode, slots), _grow(old.place, blocks)
    pair, wall, at = np.zeros((blocks, 2), np.int64), np.zeros(blocks, np.bool_), np.full(blocks, -1, np.int32)
    slot = np.full(contacts.count[0], -1, np.int32)
    return first, bound, filled, place, slot, (i, j, row, size, mass, slip, mode, pair, wall, at)


@njit(cache=True, **INNER)
def _assemble_blocks(
    old, contacts, moving, normal, across, room, gap, first, bound, filled, place, slot, parts, internal, tile_of, start
):  # fmt: skip
    """Complete the filled blocks with padding, vectors, rows of loads and the order of summation."""
    i, j, row, size, mass, slip, mode, pair, wall, at = parts
    bodies, top, far = len(internal), len(moving.tile), 1.0 + gap
    for g in range(bodies):
        far = max(far, 4.0 * moving.body[g, RADIUS] + 1.0 + gap + 2.0 * room[g])
    for k in range(len(first) - 1):
        _pad_blocks(filled[-1, k], first[k + 1] * LANES, bodies, i, j, row, wall, at, size, mass, slip, mode)
    most = _assign_load_rows(place, bound, top, moving.share, tile_of, i, j, row)
    vector = _grow(old.vector, _place_vectors(at))
    _write_vectors(contacts, row, wall, at, normal, across, bodies, far, vector)
    load, pairs = old.load, old.pair
    if len(load) <= most:
        rows = most + most // 8 + 1
        load, pairs = empty_aligned(rows, WIDTH), np.empty((rows if len(moving.virial) > 0 else 0, 3))
    for k in range(WIDTH):
        load[most, k] = 0.0
    active, start = 0, start[0]
    for a in range(bodies):
        active += max(start[a + 2], 1)
    code = _grow(old.code, active + PREFETCH_DISTANCE)
    _write_summation_order(contacts, slot, place, internal, start, code, most)
    return Blocks(
        i, j, row, pair, wall, at, vector, size, mass, slip, mode, place, bound[: top + 1].copy(),
        bound[top:].copy(), load, pairs, start[: bodies + 1].copy(), code,
    )  # fmt: skip


@cache
def block_chooser(parallel: bool):
    """Compiled function that chooses blocks, on one thread or several.

    Results are bitwise independent of the number of threads.
    """

    @njit(cache=True, error_model="numpy", parallel=parallel)
    def choose_blocks(
        old, contacts, moving, inverse_mass, material, normal, vectors, across, room, gap, materials, by_size, viscous
    ):  # fmt: skip
        """Choose blocks for all pairs that may touch within the displacement limits, in the memory of `old` blocks.

        The old blocks are first written back to the list. The tiles of a thread share rows of loads, which stay in its
        cache. `across` maps an image to the shift of the pair vector: the cell's vectors, or the unit matrix if there
        is a frame, which has the current vectors.
        """
        # the body must depend on `parallel`, because the cache of compiled code is keyed by it alone
        workers, crossing = len(moving.share) - 1 if parallel else 1, len(moving.tile) - 1
        for k in prange(workers):
            commit(old, contacts, k, np.int64(workers))
        internal, tile_of, worker, own, first, begin, picked, start, held = _prepare(
            contacts, moving, workers, materials
        )
        number = np.empty(workers, np.int64)
        for k in prange(workers):
            number[k] = _pick_pairs(
                own[k, 0], own[k, 1], contacts, moving, first, internal, tile_of, worker, normal, vectors, room, gap,
                materials, material, picked[begin[k] :], start[k], held[k],
            )  # fmt: skip
        first_block, bound, filled, place, slot, parts = _lay_out(
            old, contacts, moving, start, held, materials, by_size, viscous
        )
        buckets = crossing * (held.shape[1] // (2 * (crossing + 1)))
        for k in prange(workers):
            own_picked = picked[begin[k] : begin[k] + number[k]]
            _fill_blocks(
                own_picked, _sort_picked(own_picked, tile_of, crossing + 1, buckets), filled[k], contacts, moving.order,
                materials, material, moving.body[:, RADIUS], inverse_mass, parts, slot,
            )  # fmt: skip
        return _assemble_blocks(
            old, contacts, moving, normal, across, room, gap, first_block, bound, filled, place, slot, parts, internal,
            tile_of, start,
        )  # fmt: skip

    return choose_blocks
