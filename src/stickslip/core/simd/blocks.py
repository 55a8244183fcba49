"""Contacts of many grains in vectorised blocks of 64, for fast time stepping.

Grains are divided into equal-sized tiles of neighbours, and follow a space-filling curve within each tile. A block
holds contacts of one pair of materials, either within one tile, or between a tile and later ones (`cross`), or with
walls. Contacts are evaluated block by block. Each grain then gathers the loads of its contacts in the order of its
partners' numbers. The orientation of a pair and the order of summation depend only on the numbers of the grains in the
state, and every contact goes through the same vector instructions. Trajectories are therefore bitwise independent of
the number of threads and of the memory order.

Blocks contain only touching and nearly touching pairs: those that could touch within the displacement limits of both
bodies. The limits are larger for faster bodies. When a body reaches its limit, blocks are chosen anew from the contact
list.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from ..contacts.geometry import at_contact, touching_fraction
from ..contacts.mechanics import FREE, contact_forces, needs_mass, needs_radius, transport_slip
from ..flow import INVERSE_HALF, RATE, RATE_AHEAD, VECTORS
from ..laws.oracle import reach, row
from ..options import INNER
from ..state import OPEN, SLIDE, STICK
from .reduce import WIDTH
from .transpose import (
    BODY,
    LANES,
    MOTION,
    MOTION_AHEAD,
    PAIR,
    RADII,
    ROLL,
    ROLL_AHEAD,
    gather_motion,
    gather_positions,
    prefetch_for_read,
    prefetch_for_write,
    scatter_loads,
    use_widest_vectors,
)

# options of functions that are inlined into their callers. They allocate no arrays, and references to arrays taken out
# of tuples are not counted, which would take half of a step with dashpots. They are cached separately, so that kernels
# of other laws find them compiled
KERNEL_OPTIONS = {"error_model": "numpy", "forceinline": True, "_nrt": False, "cache": True}
TILE_SIZE = 1024  # maximum number of grains
# further modes of contacts in blocks. STUCK_AGAIN: sticks but has been at the Coulomb limit since it closed; LOOSE: it
# slides because its limit is zero, and has not been at a limit
STUCK_AGAIN, LOOSE = 3, 4
_SQUARE_MARGIN = 1.0 + 1e-9  # factor on squared distances beyond which nothing can touch, whatever the rounding


class MovingBodies(NamedTuple):
    """Bodies in memory order: tiles of neighbouring grains, then rigid groups, then walls."""

    order: np.ndarray  # (B,) number of each body in the state
    body: np.ndarray  # (B, BODY) position, velocity, spin, radius and kicks, see `transpose`
    angle: np.ndarray  # (B, 3)
    ahead: np.ndarray  # (B, BODY_AHEAD) velocity and spin predicted at the full step, for dashpots; else (0, …)
    force: np.ndarray  # (B, 6) force and torque, written where a step ends without beginning the next
    free: np.ndarray  # (B, 6) bool
    whole: np.ndarray  # (B,) bool: all components that exist in this dimension are free
    external: np.ndarray  # (B, 8) external forces, and zeros, see `reduce`; or (1, 8) without any
    torque: np.ndarray  # (B, 3) external torques, or (1, 3) without any
    virial: np.ndarray  # (B, 9) Σ f ⊗ r over contacts in which a body is i, written with a frame; else (0, 9)
    origin: np.ndarray  # (B, 4) positions when blocks were chosen, and 1/d² (1 with a frame), d the displacement limit
    tile: np.ndarray  # (T + 1,) bounds of the tiles of grains; rigid groups and walls follow
    member: np.ndarray  # (M,) bodies in rigid groups, group after group
    members: np.ndarray  # (G + 1,) bounds of the groups
    share: np.ndarray  # (threads + 1,) bounds of the tiles of each thread
    spent: np.ndarray  # (threads, 8) first column: ticks that each thread spent on its tiles, see `cycle_counter`


class Blocks(NamedTuple):
    """Pairs in K blocks of LANES, padded with pairs that never touch. The arrays may be longer than needed."""

    i: np.ndarray  # (K LANES,) uint32, in memory order
    j: np.ndarray  # (K LANES,)
    row: np.ndarray  # (K LANES,) row in the list of contacts, −1 for padding
    material: np.ndarray  # (K, 2)
    wall: np.ndarray  # (K,) bool: all pairs of the block are with walls
    at: np.ndarray  # (K,) int32 start of a block's vectors, −1: no pair is with a wall or across a boundary
    vector: np.ndarray  # (V · 3 · LANES,) periodic shift (with a frame: the image), or the wall's normal
    size: np.ndarray  # (K LANES,) R_eff, or (0,) if the law does not use it
    mass: np.ndarray  # (K LANES,) m_eff, or (0,) if the law does not use it
    slip: np.ndarray  # (K · 3 · LANES,)
    mode: np.ndarray  # (K LANES,) int64: OPEN, STICK, SLIDE, STUCK_AGAIN or LOOSE; as wide as the other numbers
    place: np.ndarray  # (K,) first row of a block's loads
    cross: np.ndarray  # (T + 2,) bounds of the blocks between a tile and later ones; then those between threads
    inner: np.ndarray  # (T + 2,) bounds of the blocks within each tile
    load: np.ndarray  # (L, 8) force on i and −n × F_t, see `reduce`
    pair: np.ndarray  # (L, 3) with a frame, the pair vectors; else (0, 3)
    start: np.ndarray  # (B + 1,) uint32: bounds of each body's part of `code`
    code: np.ndarray  # (…,) uint32 rows of `load` in the order of summation, see `reduce`


def empty_blocks() -> Blocks:
    """Make blocks without pairs, from which the first real ones are made."""
    whole, flag = np.zeros((0, 2), np.int64), np.zeros(0, np.bool_)
    pairs, numbers, bounds = np.zeros(0, np.uint32), np.zeros(0), np.zeros(1, np.int64)
    return Blocks(
        pairs, pairs, np.zeros(0, np.int32), whole, flag, np.zeros(0, np.int32), numbers, numbers, numbers, numbers,
        bounds[:0], bounds[:0], bounds, bounds, np.zeros((0, WIDTH)), np.zeros((0, 3)), pairs, pairs,
    )  # fmt: skip


@njit(cache=True, _nrt=False)
def commit(blocks, contacts, part, parts):
    """Write the slip and mode of some of the blocks back to their rows in the list of contacts."""
    lanes = np.uint64(LANES)  # unsigned, so that indices are not checked for negative values
    first, last = blocks.inner[-1] * part // parts, blocks.inner[-1] * (part + 1) // parts
    for s in range(np.uint64(first) * lanes, np.uint64(last) * lanes):
        if blocks.row[s] >= 0:
            c, b, l = np.uint64(blocks.row[s]), s // lanes, s % lanes
            for m in range(np.uint64(3)):
                contacts.slip[c, m] = blocks.slip[(np.uint64(3) * b + m) * lanes + l]
            mode = blocks.mode[s]
            contacts.mode[c] = STICK if mode == STUCK_AGAIN else SLIDE if mode == LOOSE else mode
            contacts.reached[c] = mode in (SLIDE, STUCK_AGAIN)


@njit(cache=True, fastmath=False, _nrt=False)
def store_reference(contacts, position, angle, radius, vectors, pair_out, roll_out):
    """Write the current pair vectors and angles of touching contacts.

    Returns True if they are those of the committed memory. With empty arrays, nothing is written.
    """
    rested, image = True, contacts.image
    for c in range(contacts.count[0]):
        if contacts.mode[c] != OPEN:
            i, j = contacts.i[c], contacts.j[c]
            for m in range(3):
                shift = image[c, 0] * vectors[0, m] + image[c, 1] * vectors[1, m] + image[c, 2] * vectors[2, m]
                pair = position[i, m] - position[j, m] + shift
                roll = radius[i] * angle[i, m] + radius[j] * angle[j, m]
                rested &= pair == contacts.pair[c, m] and roll == contacts.roll[c, m]
                if len(pair_out):
                    pair_out[c, m], roll_out[c, m] = pair, roll
    return rested


@njit(**KERNEL_OPTIONS, **INNER)
def _prefetch_pairs(blocks, body, b):
    """Prefetch both bodies of each pair of a block, two cache lines per body."""
    for s in range(LANES * b, LANES * (b + 1)):
        for g in (np.int64(blocks.i[np.uint64(s)]), np.int64(blocks.j[np.uint64(s)])):
            prefetch_for_read(body, g * BODY)
            prefetch_for_read(body, g * BODY + 8)


@njit(**KERNEL_OPTIONS, **INNER)
def _prefetch_bodies(body, first, last):
    """Prefetch a range of bodies that will be moved."""
    for at in range(first * BODY, last * BODY, 8):
        prefetch_for_write(body, at)


@njit(fastmath=True, **KERNEL_OPTIONS, **INNER)
def _gather_pair_vectors(dim, flow, blocks, body, b, scratch):
    """Gather pair vectors and sums of radii of block b, plane by plane."""
    gather_positions(np.int64(dim), np.int64(b * LANES), blocks.i, blocks.j, body, scratch)
    if blocks.at[b] < 0 or blocks.wall[b]:
        return
    at = np.uint64(blocks.at[b])
    if flow is None:
        for k in range(dim):
            for lane in range(LANES):
                l = np.uint64(lane)
                scratch[PAIR + k * LANES + l] += blocks.vector[at + k * LANES + l]
    else:
        h = flow.matrix[VECTORS]
        for lane in range(LANES):
            l = np.uint64(lane)
            p, q, r = blocks.vector[at + l], blocks.vector[at + 64 + l], blocks.vector[at + 128 + l]
            scratch[PAIR + l] += p * h[0, 0] + q * h[1, 0] + r * h[2, 0]
            scratch[PAIR + 64 + l] += p * h[0, 1] + q * h[1, 1] + r * h[2, 1]
            if dim == 3:
                scratch[PAIR + 128 + l] += p * h[0, 2] + q * h[1, 2] + r * h[2, 2]


@njit(fastmath=True, **KERNEL_OPTIONS, **INNER)
def _add_flow(dim, predict, flow, scratch):
    """Add the contribution L r of a deforming cell to relative velocities.

    (1 + ½ dt L)⁻¹ (Δv + L r), with r at the end of the step, is the change of r during the step divided by dt.
    """
    rate, back, ahead = flow.matrix[RATE], flow.matrix[INVERSE_HALF], flow.matrix[RATE_AHEAD]
    for lane in range(LANES):
        l = np.uint64(lane)
        if dim == 2:
            scratch[PAIR + 128 + l] = scratch[MOTION + 128 + l] = 0.0
        x, y, z = scratch[PAIR + l], scratch[PAIR + 64 + l], scratch[PAIR + 128 + l]
        u = scratch[MOTION + l] + rate[0, 0] * x + rate[0, 1] * y + rate[0, 2] * z
        v = scratch[MOTION + 64 + l] + rate[1, 0] * x + rate[1, 1] * y + rate[1, 2] * z
        w = scratch[MOTION + 128 + l] + rate[2, 0] * x + rate[2, 1] * y + rate[2, 2] * z
        for k in range(3):
            scratch[MOTION + k * LANES + l] = back[k, 0] * u + back[k, 1] * v + back[k, 2] * w
            if predict:
                scratch[MOTION_AHEAD + k * LANES + l] += ahead[k, 0] * x + ahead[k, 1] * y + ahead[k, 2] * z


@njit(fastmath=True, **KERNEL_OPTIONS, **INNER)
def _evaluate_block(kind, coulomb, dim, viscous, rate, rescaled, wall, q, blocks, b, dt, hold, scratch):
    """Evaluate forces and memory of one block. Lanes that do not touch get zeros. With `hold`, the memory is kept."""
    use_widest_vectors()
    predict = viscous > 0 and not rate
    v, w = (MOTION_AHEAD, ROLL_AHEAD) if predict else (MOTION, ROLL)
    lanes, idle = slice(LANES * b, LANES * b + LANES), blocks.load[np.uint64(0)]
    # arrays that the law does not use are replaced by memory that nothing overlaps. Compiled code checks for overlaps,
    # and takes another path, which rounds differently, if an empty array lies just before another array
    size = blocks.size[lanes] if needs_radius(kind, viscous) else idle
    mass = blocks.mass[lanes] if needs_mass(viscous) else idle
    mode = blocks.mode[lanes]
    slip, vector = blocks.slip[3 * LANES * b : 3 * LANES * (b + 1)], blocks.vector[blocks.at[b] :]  # of walls only
    for l in range(LANES):
        rx, ry, rz = scratch[PAIR + l], scratch[PAIR + 64 + l], scratch[PAIR + 128 + l] if dim == 3 else 0.0
        if wall:
            nx, ny, nz = vector[l], vector[64 + l], vector[128 + l] if dim == 3 else 0.0
            distance, inverse = rx * nx + ry * ny + rz * nz, 0.0
        else:
            distance = np.sqrt(rx * rx + ry * ry + rz * rz)
            inverse = 1.0 / distance
            nx, ny, nz = rx * inverse, ry * inverse, rz * inverse
        overlap = scratch[RADII + l] - distance
        r_eff = size[l] if needs_radius(kind, viscous) else 1.0
        edge = 0.0 - reach(kind, q, r_eff)
        touches = overlap > edge
        overlap = overlap if touches else edge
        before = mode[l]
        # displacement and rolled length during the step
        dx, dy, dz = dt * scratch[MOTION + l], dt * scratch[MOTION + 64 + l], dt * scratch[MOTION + 128 + l]
        wx, wy, wz = dt * scratch[ROLL + l], dt * scratch[ROLL + 64 + l], dt * scratch[ROLL + 128 + l]
        if dim == 2:
            dz = wx = wy = 0.0
        sx, sy, sz = slip[l], slip[64 + l], slip[128 + l] if dim == 3 else 0.0
        part, whole = 1.0, 1.0
        if not rate:
            part, whole = touching_fraction(nx, ny, nz, inverse, overlap - edge, dx, dy, dz)
            part, whole = part if before == OPEN else 1.0, whole if before == OPEN else 1.0
        ox, oy, oz, dx, dy, dz, _, _, _, fade = transport_slip(
            rate, rescaled, nx, ny, nz, inverse, overlap, dx, dy, dz, wx, wy, wz, sx, sy, sz
        )
        if hold:
            ox, oy, oz, dx, dy, dz = sx, sy, sz, 0.0, 0.0, 0.0
        m_eff = mass[l] if needs_mass(viscous) else 1.0
        vx = vy = vz = 0.0
        if viscous:
            ax, ay, az = (
                scratch[w + l] if dim == 3 else 0.0,
                scratch[w + 64 + l] if dim == 3 else 0.0,
                scratch[w + 128 + l],
            )
            vx, vy, vz = scratch[v + l], scratch[v + 64 + l], scratch[v + 128 + l] if dim == 3 else 0.0
            vx, vy, vz = at_contact(nx, ny, nz, vx, vy, vz, ax, ay, az)
        slid = not rate and before in (SLIDE, LOOSE)
        fn, tx, ty, tz, sx, sy, sz, limit, slides = contact_forces(
            kind, coulomb, dim, viscous, rate, rescaled, FREE, hold, touches, q, r_eff, m_eff, nx, ny, nz, overlap, ox,
            oy, oz, dx, dy, dz, fade, part, whole, slid, vx, vy, vz,
        )  # fmt: skip
        here = 1.0 if touches else 0.0
        slip[l], slip[64 + l] = here * sx, here * sy
        if dim == 3:
            slip[128 + l] = here * sz
        reached = before in (SLIDE, STUCK_AGAIN)
        sliding, sticking = SLIDE if reached or limit > 0.0 else LOOSE, STUCK_AGAIN if reached else STICK
        after = sliding if slides else sticking
        after = before if hold and before != OPEN else after
        mode[l] = after if touches else OPEN
        scratch[l], scratch[64 + l] = fn * nx + tx, fn * ny + ty
        scratch[320 + l] = ny * tx - nx * ty
        if dim == 3:
            scratch[128 + l] = fn * nz + tz
            scratch[192 + l], scratch[256 + l] = nz * ty - ny * tz, nx * tz - nz * tx
        else:
            scratch[128 + l] = scratch[192 + l] = scratch[256 + l] = 0.0


@njit(fastmath=True, **KERNEL_OPTIONS)
def _idle(kind, dim, viscous, wall, q, blocks, b, scratch):
    """Return True if no pair in a block touches or has touched before. May be False if a pair nearly touches."""
    lanes = slice(LANES * b, LANES * b + LANES)
    size = blocks.size[lanes] if needs_radius(kind, viscous) else blocks.load[np.uint64(0)]
    mode, vector = blocks.mode[lanes], blocks.vector[blocks.at[b] :]
    least, held = 1.0, 0
    for l in range(LANES):
        rx, ry, rz = scratch[PAIR + l], scratch[PAIR + 64 + l], scratch[PAIR + 128 + l] if dim == 3 else 0.0
        ranged = scratch[RADII + l] + reach(kind, q, size[l] if needs_radius(kind, viscous) else 1.0)
        if wall:
            square = rx * vector[l] + ry * vector[64 + l] + (rz * vector[128 + l] if dim == 3 else 0.0)
            square, ranged = square * abs(square), ranged * abs(ranged)
        else:
            square, ranged = rx * rx + ry * ry + rz * rz, ranged * ranged
        least = min(least, square - _SQUARE_MARGIN * ranged)
        held |= mode[l]
    return least > 0.0 and held == 0


@njit(fastmath=True, **KERNEL_OPTIONS, **INNER)
def evaluate_blocks(
    kind, coulomb, dim, viscous, rate, rescaled, first, last, crossing, begin, end, blocks, body, ahead, p, dt, hold,
    flow, scratch,
):  # fmt: skip
    """Evaluate loads and memory of a range of blocks; inlined into its callers.

    Data are prefetched meanwhile. If the blocks are `crossing`, their bodies may be anywhere and are prefetched one
    block ahead. Otherwise bodies in the range `begin` to `end`, which come next, are prefetched.
    """
    load, predict = blocks.load, viscous > 0 and not rate
    each = (end - begin) // max(last - first, 1) + 1
    for b in range(first, last):
        if crossing:
            _prefetch_pairs(blocks, body, min(b + 1, last - 1))
        else:
            _prefetch_bodies(body, min(begin, end), min(begin + each, end))
            begin += each
        _gather_pair_vectors(dim, flow, blocks, body, b, scratch)
        place, q = blocks.place[b], row(kind, p, blocks.material[b, 0], blocks.material[b, 1])
        if _idle(kind, dim, viscous, blocks.wall[b], q, blocks, b, scratch):
            for s in range(np.uint64(place), np.uint64(place + LANES)):
                for m in range(np.uint64(WIDTH)):
                    load[s, m] = 0.0
                if flow is not None:
                    for m in range(np.uint64(3)):
                        blocks.pair[s, m] = 0.0
            continue
        gather_motion(
            np.int64(dim), np.int64(predict), np.int64(b * LANES), blocks.i, blocks.j, body, ahead, scratch
        )  # fmt: skip
        if flow is not None:
            _add_flow(dim, predict, flow, scratch)
            for lane in range(LANES):
                l, s = np.uint64(lane), np.uint64(place + lane)
                blocks.pair[s, 0], blocks.pair[s, 1], blocks.pair[s, 2] = (
                    scratch[PAIR + l], scratch[PAIR + 64 + l], scratch[PAIR + 128 + l],
                )  # fmt: skip
        if blocks.wall[b]:
            _evaluate_block(kind, coulomb, dim, viscous, rate, rescaled, True, q, blocks, b, dt, hold, scratch)
        else:
            _evaluate_block(kind, coulomb, dim, viscous, rate, rescaled, False, q, blocks, b, dt, hold, scratch)
        scatter_loads(np.int64(place), scratch, load)
