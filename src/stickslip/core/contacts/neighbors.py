"""Neighbour list: pairs within range, sorted by key. The memory of contacts survives rebuilds.

Pairs are found with a cell list in fractional coordinates. Its bins follow the cell's vectors. Sheared cells and boxes
narrower than the range of a grain therefore need no special case: an image is simply a bin that lies some number of
boxes away.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from ..arguments import Bodies, checked
from ..fields import BODY_BITS, IMAGE_BITS
from ..laws.builtin import Law
from ..options import INNER
from ..state import OPEN, PER_PAIR, Cell, Contacts, State, empty_contacts
from .interaction_range import copy_rolling_memory, with_range, with_rolling_memory

_IMAGE_OFFSET = 1 << (IMAGE_BITS - 1)
MAX_BODIES = 1 << BODY_BITS
TOO_FAR = f"two touching grains are {_IMAGE_OFFSET} or more periodic boxes apart: shift positions by whole boxes"


@njit(cache=True)
def pack_key(i, j, a, b, c):
    """Pack (i, j, image) into one integer with the same order."""
    key = (np.int64(i) << BODY_BITS) | np.int64(j)
    for m in (a, b, c):
        key = (key << IMAGE_BITS) | np.int64(m + _IMAGE_OFFSET)
    return key


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


class Bins(NamedTuple):
    """Grains sorted into bins, with the grains of each column of bins contiguous in memory.

    Columns run along the second axis, because in two dimensions there is only one bin along the third. Bins are shorter
    along columns. A search therefore reads a few contiguous stretches of memory that are only slightly longer than the
    search range.
    """

    number: np.ndarray  # (3,) bins along each axis
    around: np.ndarray  # (3,) bins to search on either side
    turn: np.ndarray  # (3, …) bin reached by a step beyond the bins along each axis, or −1 outside
    over: np.ndarray  # (3, …) number of boxes crossed by that step
    start: np.ndarray  # (bins + 1,) first entry of each bin
    member: np.ndarray  # (N,) grain of each entry
    wrapped: np.ndarray  # (N, 4) position in box 0 and radius of each entry
    box: np.ndarray  # (N, 3) periodic box in which the grain lies


_BINS_PER_REACH = 3  # along columns


def _lay_out_bins(span, n, periodic, reach):
    """Bins along each axis, bins to search on either side, strides, and the bins that steps beyond the grid reach."""
    number, most = np.ones(3, np.int64), int(np.ceil((4.0 * n) ** (1 / 3))) + 1
    for k in range(3):
        number[k] = min(max(span[k] / reach * (_BINS_PER_REACH if k == 1 else 1), 1.0), 1e6)
    while number.prod() > 8 * n + most:
        number[np.argmax(number)] = (number.max() + 1) // 2
    wide = (span > 0.0) & (periodic | (number > 1))
    around = np.where(wide, np.ceil(reach * number / np.where(wide, span, 1.0)), 0.0).astype(np.int64)
    stride = np.array([number[1], 1, number[0] * number[1]])
    turn = np.full((3, (number + 2 * around).max()), -1)
    over = np.zeros_like(turn)
    for k in range(3):
        step = np.arange(-around[k], number[k] + around[k])
        boxes = step // number[k]
        inside = (boxes == 0) | periodic[k]
        turn[k, : len(step)] = np.where(inside, (step - boxes * number[k]) * stride[k], -1)
        over[k, : len(step)] = np.where(inside, boxes, 0)
    return number, around, stride, turn, over


@njit(cache=True, fastmath=False, _nrt=False)
def _wrap_positions(x, grid, fraction, box, low, high):
    """Fractional coordinates of grains in box 0, the boxes in which they lie, and the range of the coordinates."""
    for a in range(len(box)):
        for k in range(3):
            f = x[a, 0] * grid.inverse[0, k] + x[a, 1] * grid.inverse[1, k] + x[a, 2] * grid.inverse[2, k]
            if not abs(f) < 1e9:  # NaN touches nothing, whatever its bin
                f = 0.0
            if grid.periodic[k]:
                whole = np.floor(f)
                box[a, k] = np.int32(whole)
                f -= whole
            fraction[a, k] = f
            low[k], high[k] = min(low[k], f), max(high[k], f)


@njit(cache=True, fastmath=False, _nrt=False)
def _fill_bins(x, radius, vectors, fraction, boxes, low, scale, stride, bins, place):
    """Sort grains into bins; the start of each bin is counted two entries ahead and moves back as it is filled."""
    number, start = bins.number, bins.start
    for a in range(len(place)):
        at = np.int64(0)
        for k in range(3):
            at += min(max(np.int64((fraction[a, k] - low[k]) * scale[k]), 0), number[k] - 1) * stride[k]
        place[a] = at
        start[at + 2] += 1
    for b in range(len(start) - 2):
        start[b + 2] += start[b + 1]
    for a in range(len(place)):
        e = start[place[a] + 1]
        start[place[a] + 1] = e + 1
        bins.member[e], bins.wrapped[e, 3] = a, radius[a]
        for m in range(3):
            bins.box[e, m], bins.wrapped[e, m] = boxes[a, m], x[a, m]
            for k in range(3):
                bins.wrapped[e, m] -= boxes[a, k] * vectors[k, m]


def _sort_into_bins(x, n, radius, grid, reach) -> Bins:
    """Sort all grains into bins in fractional coordinates."""
    fraction, boxes, low, high = np.empty((n, 3)), np.zeros((n, 3), np.int32), np.full(3, np.inf), np.full(3, -np.inf)
    _wrap_positions(x, grid, fraction, boxes, low, high)
    low, high = np.where(grid.periodic, 0.0, low), np.where(grid.periodic, 1.0, high)
    number, around, stride, turn, over = _lay_out_bins((high - low) * grid.height, n, grid.periodic, reach)
    scale = np.divide(number, high - low, out=np.zeros(3), where=number > 1)  # else the extent may be 0 or tiny
    start = np.zeros(number.prod() + 2, np.int32)
    bins = Bins(number, around, turn, over, start, np.empty(n, np.int32), np.empty((n, 4)), np.empty((n, 3), np.int32))
    _fill_bins(x, radius, grid.vectors, fraction, boxes, low, scale, stride, bins, np.empty(n, np.int32))
    return bins


@njit(cache=True, _nrt=False, **INNER)
def _columns_around(column, bins, vectors, base, boxes, push):
    """Find the first bins of the columns around a column, the boxes crossed, and the shifts of positions."""
    number, around, turn, over, known = bins.number, bins.around, bins.turn, bins.over, 0
    for t in range(column // number[0], column // number[0] + 2 * around[2] + 1):
        for u in range(column % number[0], column % number[0] + 2 * around[0] + 1):
            if turn[2, t] >= 0 and turn[0, u] >= 0:
                base[known] = turn[2, t] + turn[0, u]
                boxes[known, 0], boxes[known, 1] = over[0, u], over[2, t]
                for m in range(3):
                    push[known, m] = over[0, u] * vectors[0, m] + over[2, t] * vectors[2, m]
                known += 1
    return known


@njit(cache=True, _nrt=False)
def _fill_windows(high, around, turn, over, bound, window):
    """Ranges of bins to search around each bin of a column: bounds in the list of first bin, end and boxes crossed."""
    known = 0
    for w in range(high):
        for v in range(w, w + 2 * around + 1):
            if turn[v] >= 0:
                if known > bound[w] and window[known - 1, 2] == over[v]:
                    window[known - 1, 1] += 1
                else:
                    window[known, 0], window[known, 1], window[known, 2] = turn[v], turn[v] + 1, over[v]
                    known += 1
        bound[w + 1] = known


@njit(cache=True, _nrt=False, **INNER)
def _sort(key, first, last):
    """Sort a short range by insertion."""
    for c in range(first + 1, last):
        k, d = key[c], c
        while d > first and key[d - 1] > k:
            key[d] = key[d - 1]
            d -= 1
        key[d] = k


class Search(NamedTuple):
    """Arrays for a search: allocated outside the kernels, which therefore compile faster."""

    bound: np.ndarray  # (bins of a column + 1,)
    window: np.ndarray  # (W, 3) see `_fill_windows`
    base: np.ndarray  # (D,) first bin of each of D columns around one
    boxes: np.ndarray  # (D, 2) boxes crossed along the first and third axis
    push: np.ndarray  # (D, 3) shift of positions
    hit: np.ndarray  # (H,) pairs of one grain


def _start_search(bins: Bins, hits: int) -> Search:
    high, columns = bins.number[1], np.prod(2 * bins.around[[0, 2]] + 1)
    bound, window = np.zeros(high + 1, np.int64), np.empty((high * (2 * bins.around[1] + 1), 3), np.int64)
    _fill_windows(high, bins.around[1], bins.turn[1], bins.over[1], bound, window)
    return Search(
        bound, window, np.empty(columns, np.int64), np.empty((columns, 2), np.int64), np.empty((columns, 3)),
        np.empty(hits, np.int64),
    )  # fmt: skip


_FULL, _TOO_FAR, _MANY = -1, -2, -3


@njit(cache=True, _nrt=False)
def _find_pairs(bins, search, x, radius, wall_normal, vectors, skin, key, first, many):
    """Write the keys of all pairs to `key`, sorted for each grain.

    Returns the end of the keys, or _FULL if `key` is too short, _MANY if `search.hit` is too short, or _TOO_FAR if a
    pair is more boxes apart than a key can hold.
    """
    n, start, member, wrapped, box = len(radius) - len(wall_normal), bins.start, bins.member, bins.wrapped, bins.box
    bound, window, base, boxes, push, hit = search
    high, at, wrong = bins.number[1], np.int64(0), np.int64(len(base) >> 16 << IMAGE_BITS)
    for column in range(bins.number[0] * bins.number[2]):
        known = _columns_around(column, bins, vectors, base, boxes, push)
        for w in range(high):
            for e in range(start[column * high + w], start[column * high + w + 1]):
                a, near, hits = member[e], wrapped[e, 3] + skin, 0
                for p in range(bound[w], bound[w + 1]):
                    turns = window[p, 2]
                    for r in range(known):
                        from_entry, to_entry = start[base[r] + window[p, 0]], start[base[r] + window[p, 1]]
                        if hits + to_entry - from_entry > len(hit):
                            return _MANY
                        sx = wrapped[e, 0] - push[r, 0] - turns * vectors[1, 0]
                        sy = wrapped[e, 1] - push[r, 1] - turns * vectors[1, 1]
                        sz = wrapped[e, 2] - push[r, 2] - turns * vectors[1, 2]
                        code = turns << 48 | r << 32
                        for f in range(np.uint64(from_entry), np.uint64(to_entry)):
                            dx, dy, dz = sx - wrapped[f, 0], sy - wrapped[f, 1], sz - wrapped[f, 2]
                            reach = near + wrapped[f, 3]
                            # all are written and few are counted, which is cheaper than an unpredictable branch
                            hit[np.uint64(hits)] = code | np.int64(f)
                            hits += dx * dx + dy * dy + dz * dz < reach * reach
                if at + hits + len(wall_normal) > len(key):
                    return _FULL
                first[a], own = at, pack_key(a, a, 0, 0, 0)
                for h in range(hits):
                    f, r = hit[h] & 0xFFFFFFFF, (hit[h] >> 32) & 0xFFFF
                    i, j = box[f, 0] - box[e, 0] - boxes[r, 0], box[f, 1] - box[e, 1] - (hit[h] >> 48)
                    k = box[f, 2] - box[e, 2] - boxes[r, 1]
                    wrong |= (i + _IMAGE_OFFSET) | (j + _IMAGE_OFFSET) | (k + _IMAGE_OFFSET)
                    key[at] = pack_key(a, member[f], i, j, k)
                    at += key[at] > own
                _sort(key, first[a], at)
                for b in range(n, len(radius)):
                    gap = -radius[a] - skin
                    for k in range(3):
                        gap += (x[a, k] - x[b, k]) * wall_normal[b - n, k]
                    if gap < 0.0:
                        key[at] = pack_key(a, b, 0, 0, 0)
                        at += 1
                many[a] = at - first[a]
    return at if wrong >> IMAGE_BITS == 0 else _TOO_FAR


@njit(cache=True, _nrt=False)
def _fill_list(key, first, many, new, rows):
    """Fill a list from the keys of each grain, and `rows` with the first row of each grain."""
    c, low, keyed = 0, (1 << IMAGE_BITS) - 1, len(new.key) > 0
    for a in range(len(many)):
        rows[a] = c
        for at in range(first[a], first[a] + many[a]):
            k = key[at]
            if keyed:
                new.key[c] = k
            new.i[c], new.j[c] = a, (k >> 3 * IMAGE_BITS) & (MAX_BODIES - 1)
            new.image[c, 0] = ((k >> 2 * IMAGE_BITS) & low) - _IMAGE_OFFSET
            new.image[c, 1] = ((k >> IMAGE_BITS) & low) - _IMAGE_OFFSET
            new.image[c, 2] = (k & low) - _IMAGE_OFFSET
            c += 1
    rows[len(many)] = c


@njit(cache=True, _nrt=False)
def copy_memory(old, new, rows):
    """Copy the memory of every closed contact that is in both lists. The rest of `new` starts open."""
    anchors, was, now = len(old.pair) > 0 and len(new.pair) > 0, old.image, new.image
    for c in range(old.count[0]):
        if old.mode[c] != OPEN:
            for m in range(rows[old.i[c]], rows[old.i[c] + 1]):
                same = now[m, 0] == was[c, 0] and now[m, 1] == was[c, 1] and now[m, 2] == was[c, 2]
                if new.j[m] == old.j[c] and same:
                    new.mode[m], new.reached[m] = old.mode[c], old.reached[c]
                    for k in range(3):
                        new.slip[m, k] = old.slip[c, k]
                        if anchors:
                            new.pair[m, k], new.roll[m, k] = old.pair[c, k], old.roll[c, k]


@njit(cache=True, fastmath=False, _nrt=False)
def largest_displacement(x, contacts):
    """Largest displacement of a body since the list was built; infinite if a position is not a number."""
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
    """Return True if the list is stale, or if some body has moved by half the skin since it was built."""
    return contacts.stale or not largest_displacement(x, contacts) <= 0.5 * contacts.skin


def check_list(state: State, gap: float = 0.0) -> None:
    """Raise ValueError if the list of contacts is not valid at the positions of a state, or across a gap."""
    if moved_too_far(body_positions(state), state.contacts) or gap > state.contacts.gap:
        raise ValueError(
            "the list of contacts does not match these positions: equilibrate, or accept(state, trial) first"
        )


@njit(cache=True)
def pack_keys(contacts):
    """Keys for a list that has none."""
    key = np.empty(len(contacts.i), np.int64)
    for c in range(len(key)):
        image = contacts.image
        key[c] = pack_key(contacts.i[c], contacts.j[c], image[c, 0], image[c, 1], image[c, 2])
    return key


def rebuild_list(x, radius, wall_normal, grid, old: Contacts) -> Contacts:
    """Build a list at positions x with the memory of the old one and the same optional arrays.

    Its count is −1 on failure.
    """
    n, skin = len(radius) - len(wall_normal), old.skin + old.gap
    bins = _sort_into_bins(x, n, radius, grid, 2 * radius[:n].max() + skin)
    first, many = np.empty(n, np.int64), np.empty(n, np.int32)
    search, room = _start_search(bins, 1024), 2 * max(int(old.count[0]), 8 * len(x))
    while True:
        key = np.empty(room, np.int64)
        end = _find_pairs(bins, search, x, radius, wall_normal, grid.vectors, skin, key, first, many)
        if end == _MANY:
            search = search._replace(hit=np.empty(2 * len(search.hit), np.int64))
        elif end == _FULL:
            room *= 2
        else:
            break
    new = empty_contacts(len(x), max(end, 0), old.skin, len(old.pair) < len(old.i), len(old.key) == len(old.i))
    new = new._replace(origin=x.copy(), gap=old.gap, stale=False, count=np.array([max(end, -1)]))
    if end > 0:
        rows = np.empty(n + 1, np.int64)
        _fill_list(key, first, many, new, rows)
        copy_memory(old, new, rows)
    return copy_rolling_memory(old, new)


def body_positions(state: State) -> np.ndarray:
    """Positions of grains and of a point of each wall, (N + W, 3) [length]."""
    return np.concatenate([state.grains.position, state.walls.point])


def body_radii(state: State) -> np.ndarray:
    """Radii, (N + W,), zero for walls [length]. Do not write to this array: without walls, it is the grains' own."""
    return join_bodies(state.grains.radius, np.zeros(len(state.walls.mass)))


def join_bodies(grains: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Concatenate values of grains and walls. Without walls, return the grains' own array, to save memory."""
    return np.concatenate([grains, walls]) if len(walls) else grains


def with_neighbor_list(state: State, law: Law | None = None) -> State:
    """State with a list of contacts that is valid at its positions and for a given law.

    The memory is matched by key.
    """
    if law is not None:
        state = state._replace(contacts=with_rolling_memory(with_range(state, law), law))
    x = body_positions(state)
    if not moved_too_far(x, state.contacts):
        return state
    if len(x) > MAX_BODIES:
        raise ValueError(f"{len(x)} bodies were given: at most {MAX_BODIES} are supported")
    contacts = rebuild_list(x, body_radii(state), state.walls.normal, grid_of(state.cell), state.contacts)
    if contacts.count[0] < 0:
        raise ValueError(TOO_FAR)
    return state._replace(contacts=contacts if law is None else with_rolling_memory(contacts, law))


def select_rows(contacts: Contacts, rows) -> Contacts:
    """List with selected rows only. Optional arrays that are absent stay absent."""
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
            raise ValueError(f"wall {wall} was given: the state has {state.n_bodies - n} walls, numbered from 0")
    kept[n + np.asarray(walls, np.int64)] = False
    rows = np.flatnonzero(kept[contacts.j[:count]])
    number = np.cumsum(kept) - 1
    contacts = select_rows(contacts, rows)
    j = number[contacts.j].astype(contacts.j.dtype)
    key = contacts.key - ((contacts.j.astype(np.int64) - j) << (3 * IMAGE_BITS))  # see `pack_key`
    per_body = ("force", "torque", "free", "rate", "group", "follows", "spring", "anchor", "leads")
    control = state.control._replace(**{name: getattr(state.control, name)[kept] for name in per_body})
    return state._replace(
        walls=type(state.walls)(*(part[kept[n:]] for part in state.walls)),
        contacts=contacts._replace(j=j, key=key, origin=contacts.origin[kept]),
        control=control,
        instant=None,
    )
