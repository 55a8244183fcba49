"""Pairs within reach, sorted by key, with memory carried across rebuilds.

`candidate_pairs` here looks at every pair and every image: right for a few hundred grains. Whatever fills the same
arrays in the same order can take its place.
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


class Images(NamedTuple):
    """What a search for pairs needs of the cell: constant while the cell does not change."""

    vectors: np.ndarray  # (3, 3) [length]
    inverse: np.ndarray  # (3, 3) [1/length]
    periodic: np.ndarray  # (3,) bool
    extra: np.ndarray  # (3,) images on either side of the nearest one that can come within reach


def images(cell: Cell, largest: float, skin: float) -> Images:
    """Images that can matter for grains of radius up to `largest`."""
    extra = np.zeros(3, np.int64)
    inverse = np.eye(3)
    if cell.periodic.any():
        inverse = np.linalg.inv(cell.vectors)
        inverse_heights = np.linalg.norm(inverse, axis=0)
        extra[cell.periodic] = np.ceil(0.5 + (2 * largest + skin) * inverse_heights[cell.periodic])
    return Images(cell.vectors, np.ascontiguousarray(inverse), cell.periodic, extra)


@njit(cache=True)
def candidate_pairs(x, radius, wall_normal, images, skin, i, j, image, key):
    """Fill the arrays with all pairs closer than `skin` beyond touching, sorted by key.

    Returns the number of pairs, which may exceed the capacity (then call again with more room), or −1 if a pair lies
    more boxes apart than a key can hold.
    """
    n, n_bodies = len(radius) - len(wall_normal), len(radius)
    cell, inverse, periodic, extra = images
    capacity, count = len(i), 0
    any_periodic = periodic[0] or periodic[1] or periodic[2]
    base = np.zeros(3, np.int64)
    for a in range(n):
        for b in range(a, n_bodies):
            if b >= n:
                gap = -radius[a] - skin
                for k in range(3):
                    gap += (x[a, k] - x[b, k]) * wall_normal[b - n, k]
                if gap < 0.0:
                    if count < capacity:
                        i[count], j[count], key[count] = a, b, pack_key(a, b, 0, 0, 0)
                        image[count] = 0
                    count += 1
                continue
            if a == b and not any_periodic:
                continue
            for k in range(3):
                if periodic[k]:
                    fraction = 0.0
                    for m in range(3):
                        fraction += (x[a, m] - x[b, m]) * inverse[m, k]
                    base[k] = -int(np.round(fraction))
            reach = radius[a] + radius[b] + skin
            for p in range(base[0] - extra[0], base[0] + extra[0] + 1):
                for q in range(base[1] - extra[1], base[1] + extra[1] + 1):
                    for r in range(base[2] - extra[2], base[2] + extra[2] + 1):
                        if a == b and (p < 0 or (p == 0 and (q < 0 or (q == 0 and r <= 0)))):
                            continue
                        square = 0.0
                        for m in range(3):
                            d = x[a, m] - x[b, m] + p * cell[0, m] + q * cell[1, m] + r * cell[2, m]
                            square += d * d
                        if square < reach * reach:
                            if max(abs(p), abs(q), abs(r)) >= _IMAGE_OFFSET:
                                return -1
                            if count < capacity:
                                i[count], j[count], key[count] = a, b, pack_key(a, b, p, q, r)
                                image[count, 0], image[count, 1], image[count, 2] = p, q, r
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
def moved_too_far(x, contacts):
    """True if some body has moved by half the skin since the list was made, or if none was made."""
    limit = (0.5 * contacts.skin[0]) ** 2
    for a in range(len(x)):
        square = 0.0
        for m in range(3):
            d = x[a, m] - contacts.origin[a, m]
            square += d * d
        if not square <= limit:
            return True
    return False


@njit(cache=True)
def rebuilt(x, radius, wall_normal, images, old):
    """A new list of contacts at positions x, with the memory of the old one; its count is −1 on failure."""
    capacity = max(len(old.i), 4 * len(x))
    while True:
        new = empty_contacts(len(x), capacity, old.skin[0])
        count = candidate_pairs(x, radius, wall_normal, images, new.skin[0], new.i, new.j, new.image, new.key)
        if count <= capacity:
            break
        capacity = count + count // 4
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
    grid = images(state.cell, float(state.grains.radius.max()), float(state.contacts.skin[0]))
    contacts = rebuilt(x, body_radii(state), state.walls.normal, grid, state.contacts)
    if contacts.count[0] < 0:
        raise ValueError(TOO_FAR)
    return state._replace(contacts=contacts)
