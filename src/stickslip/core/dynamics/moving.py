"""Bodies of a run in memory order, and the division of grains among tiles and threads."""

from typing import NamedTuple

import numpy as np

from ..contacts.forces import Bodies, moving_masses
from ..contacts.neighbors import grid_of
from ..library import core
from ..state import State
from .coefficients import Plan, find_members, movable

TILE_SIZE = 1024  # maximum number of grains
_LINE = 8  # numbers in a cache line


class MovingBodies(NamedTuple):
    """Bodies in memory order: tiles of neighbouring grains, then rigid groups, then walls; see `core.h`."""

    order: np.ndarray  # (B,) number of each body in the state
    body: np.ndarray  # (B, BODY) position, velocity, spin, radius and kicks
    angle: np.ndarray  # (B, 3)
    ahead: np.ndarray  # (B, BODY_AHEAD) velocity and spin predicted at the full step, for dashpots; else (0, …)
    force: np.ndarray  # (B, 6) force and torque, written if a step ends without starting the next
    free: np.ndarray  # (B, 6) bool
    whole: np.ndarray  # (B,) bool: all components that exist in this dimension are free
    external: np.ndarray  # (B, 8) external forces, and zeros; or (1, 8) without any
    torque: np.ndarray  # (B, 3) external torques, or (1, 3) without any
    virial: np.ndarray  # (B, 9) Σ f ⊗ r over contacts in which a body is i, only with a frame; otherwise (0, 9)
    origin: np.ndarray  # (B, 4) positions when blocks were chosen, and 1/d² (1 with a frame); d: displacement limit
    tile: np.ndarray  # (T + 1,) bounds of the tiles of grains; rigid groups and walls follow
    member: np.ndarray  # (M,) bodies in rigid groups, group after group
    members: np.ndarray  # (G + 1,) bounds of the groups
    share: np.ndarray  # (threads + 1,) bounds of the tiles of each thread
    spent: np.ndarray  # (threads, 8) first column: ticks that each thread spent on its tiles


class Springs(NamedTuple):
    """Springs on the bodies of the last tile."""

    stiffness: np.ndarray  # (L, 3)
    anchor: np.ndarray  # (L, 3)
    leads: np.ndarray  # (L, 3) column of `course`, −1: none
    knots: np.ndarray  # (K,)
    course: np.ndarray  # (K, C)
    clock: np.ndarray  # (1,) time, accumulated step by step

    @property
    def courses(self) -> int:
        """Number of time profiles."""
        return self.course.shape[1]


def gather_springs(state: State, moving: MovingBodies) -> Springs | None:
    """Springs on the bodies of the last tile, or None."""
    control, last = state.control, moving.order[moving.tile[-1] :]
    if not control.spring.any():
        return None
    parts = control.spring[last], control.anchor[last], control.leads[last].astype(int), control.knots, control.course
    return Springs(*map(np.ascontiguousarray, parts), np.full(1, state.time))


def _empty_aligned(rows: int, width: int) -> np.ndarray:
    """Uninitialised array (rows, width) aligned to cache lines: access across two lines takes twice as long."""
    flat = np.empty(rows * width + _LINE)
    first = -(flat.ctypes.data // 8) % _LINE
    return flat[first : first + rows * width].reshape(rows, width)


def split_layers(x, rows, parts):
    """Split the points x (3, n) in `rows` into equal-sized parts of neighbours: layers, rows within them, and so on.

    Parts are ordered by layers along the longest side, so that at any time few pairs connect earlier parts with later
    ones.
    """
    if parts == 1 or not len(rows):
        return [rows] * parts
    sides = np.array([np.ptp(coordinate[rows]) for coordinate in x])
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
    bound = np.maximum.accumulate(np.maximum(bound - rank, 0)) + rank  # each thread keeps at least one tile
    return np.append(0, np.minimum(bound, share[-1] - rank[::-1] + 1)).astype(share.dtype)


def _memory_order(state: State, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """Bodies in memory order, (B,): tile by tile, then the grains of the last tile, then the walls.

    Also returns the bounds of the tiles, (T + 1,), with the same number of tiles for each thread. Within a tile, grains
    lie along a space-filling curve. Without threads, all bodies are in the last tile, in the state's order.
    """
    if not threads:
        return np.arange(state.n_bodies), np.zeros(2, np.int64)
    control, n = state.control, len(state.grains.radius)
    last = ((control.group >= 0) | control.spring.any(axis=1))[:n]
    single, grid = np.flatnonzero(~last), grid_of(state.cell)
    # a BLAS product would wake the threads of BLAS, see `fields`
    fraction = np.einsum("kb,nk->bn", grid.inverse, state.grains.position[single])
    x = (fraction - np.where(grid.periodic[:, None], np.floor(fraction), 0.0)) * grid.height[:, None]
    x -= x.min(axis=1, initial=np.inf)[:, None]
    each, size = max(1, -(-len(single) // (threads * TILE_SIZE))), 2 * state.grains.radius.mean()
    shares = split_layers(x, np.arange(len(single)), threads)
    parts = [part for share in shares for part in split_layers(x, share, each)]
    parts = [part[np.argsort(_morton_keys(x[:, part], size))] for part in parts]
    order = np.concatenate([*(single[part] for part in parts), np.flatnonzero(last), np.arange(n, state.n_bodies)])
    return order, np.cumsum([0] + [len(part) for part in parts])


def _morton_keys(x: np.ndarray, size: float) -> np.ndarray:
    key = np.empty(x.shape[1], np.int64)
    core.morton_keys(np.ascontiguousarray(x), len(key), size, key)
    return key


def make_moving_bodies(
    state: State, plan: Plan, here: Bodies, predict: bool, imposed: bool, by_rows: bool, threads: int
) -> MovingBodies:
    """Working copy of all bodies in memory order."""
    n, dim, b = len(state.grains.radius), state.cell.dim, state.n_bodies
    order, tile = _memory_order(state, 0 if by_rows else threads)
    mass, inertia = moving_masses(state), np.append(state.grains.inertia, np.ones(b - n))
    free = movable(state)
    used = [0, 1, 5] if dim == 2 else range(6)
    external, torque = np.zeros((b if plan.external[0].any() else 1, 8)), np.zeros((1, 3))
    if plan.external[0].any():
        external[:, :3] = plan.external[0][order]
    if plan.external[1].any():
        torque = plan.external[1][order]
    place = np.empty(b, np.int64)
    place[order] = np.arange(b)
    moving = MovingBodies(
        order, _empty_aligned(b, core.BODY), here.angle[order], _empty_aligned(b * predict, core.BODY_AHEAD),
        np.zeros((b, 6)), free[order], free[:, used].all(axis=1)[order], external, torque,
        np.zeros((b if imposed else 0, 9)), np.zeros((b, 4)), tile, *find_members(state.control, place),
        np.arange(threads + 1) * (len(tile) - 1) // threads, np.zeros((threads, 8), np.int64),
    )  # fmt: skip
    core.gather_bodies(moving, here, 0.5 * plan.dt / mass, 0.5 * plan.dt / inertia)
    return moving
