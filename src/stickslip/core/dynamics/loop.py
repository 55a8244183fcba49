"""Time steps of all grains. Contacts are evaluated by rows (few grains, or a law with rolling) or by blocks.

By rows, all bodies are in the last tile, and samples are written without leaving compiled code. By blocks, for whose
order see `blocks`, a step first evaluates the contacts between bodies of different threads. Then each thread goes
through its tiles. It evaluates a tile's contacts, both with later tiles and within the tile, and moves the tile's
grains while they are in the processor's cache. The kinematics are compiled without fast math, so that stopping after a
step for a record does not change a single bit of the trajectory.
"""

from functools import cache
from typing import NamedTuple

import numba
import numpy as np
from numba import njit, prange

from ..contacts.forces import Bodies
from ..contacts.mechanics import FREE
from ..contacts.rows import CLOSED, OPENED, REACHED_LIMIT, Step, record_event, sweep_contacts
from ..flow import STRETCH, TURN
from ..laws.oracle import as_numpy_integers, rescaling_flag
from ..options import INNER
from ..simd.blocks import KERNEL_OPTIONS, STUCK_AGAIN, evaluate_blocks
from ..simd.cycle_counter import ticks
from ..simd.layout import scatter_bodies
from ..simd.reduce import IS_FIRST, IS_I, ROW, WIDTH, sum_rows
from ..simd.transpose import (
    KICK,
    KICK_T,
    LANES,
    RADIUS,
    SCRATCH,
    SPIN,
    SPIN_AHEAD,
    VELOCITY,
    VELOCITY_AHEAD,
    empty_aligned,
)
from ..state import OPEN, SLIDE
from .cell_motion import begin_cell_step, course_at, end_cell_step, unbalanced_cell
from .coefficients import CHECK_EVERY, CONVERGED, DONE, FULL, MOVED, largest_unbalanced, sum_over_groups
from .record import write_sample

CHUNK = 64  # bodies whose forces are summed together
_NOT_FINITE_SQUARE = 1e300  # squared displacement returned for NaN

# a parallel region costs 1 µs with GNU's or Intel's OpenMP, 15 µs with TBB, 80 µs with Numba's own layer; the first
# that can be loaded is used
if not numba.config.THREADING_LAYER or numba.config.THREADING_LAYER == "default":
    numba.config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]


class StepFactors(NamedTuple):
    """Time step and the drag factors, for translations and for rotations."""

    dt: float
    keep: float  # 1 − ν dt/2
    slow: float  # 1/(1 + ν dt/2)
    keep_t: float
    slow_t: float


class Rows(NamedTuple):
    """Views of the moving bodies as `sweep_contacts` expects them; all bodies are in the state's order."""

    step: Step
    bodies: Bodies  # with the velocities that dashpots use
    shift: np.ndarray  # (C, 3) periodic shift of every pair
    vectors: np.ndarray  # (3, 3) of the cell
    force: np.ndarray  # (B, 3)
    torque: np.ndarray  # (B, 3)
    here: Bodies  # contiguous copy for samples


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


@njit(fastmath=False, error_model="numpy", **INNER)
def _add_springs(pull, first, body, force):
    """Add the forces of springs to those on the bodies of the last tile."""
    for s in range(len(pull.stiffness)):
        for k in range(3):
            if pull.stiffness[s, k] > 0.0:
                ahead, c = 0.0, pull.leads[s, k]
                if c >= 0:
                    _, ahead = course_at(pull.knots, pull.course, c, pull.clock[0])
                force[first + s, k] += pull.stiffness[s, k] * (pull.anchor[s, k] + ahead - body[first + s, k])


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _kick(keep, slow, kick, half, go_on, v, f):
    """Velocity of a free component after the end of a step (`half`) and half a kick of the next one (`go_on`)."""
    if half:
        v = (v + kick * f) * slow
    if go_on:
        v = keep * v + kick * f
    return v


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _transform(m, x, y, z):
    """Multiply a 3 × 3 matrix by a vector."""
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _turn_velocity(flow, free, g, vx, vy, vz):
    """Velocity relative to the flow after half a step of the term −L v; components that are not free are unchanged."""
    x, y, z = _transform(flow.matrix[TURN], vx, vy, vz)
    return x if free[g, 0] else vx, y if free[g, 1] else vy, z if free[g, 2] else vz


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _free_or_imposed(flow, when, free, g, k, value):
    """Rate of a component: its own if free, else the imposed one, averaged over the step (0) or at its end (1)."""
    return value if free[g, k] else flow.rate[g, k] * flow.factor[when, flow.follows[g, k]]


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _drift(flow, dt, x, y, z, vx, vy, vz):
    """Position of a body at the end of the step."""
    if flow is None:
        return x + dt * vx, y + dt * vy, z + dt * vz
    half = 0.5 * dt
    x, y, z = _transform(flow.matrix[STRETCH], x + half * vx, y + half * vy, z + half * vz)
    return x + half * vx, y + half * vy, z + half * vz


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _move_body(dim, predict, moving, pace, flow, g, half, go_on, fx, fy, fz, tx, ty, tz):
    """End a step with half a kick (implicit drag), and begin the next with half a kick (explicit drag) and the drift.

    Returns the squared displacement since the blocks were chosen, divided by that allowed for the body.
    """
    body, angle, free, origin = moving.body, moving.angle, moving.free, moving.origin
    a, b, dt = body[g, KICK], body[g, KICK_T], pace.dt
    keep, slow, keep_t, slow_t = pace.keep, pace.slow, pace.keep_t, pace.slow_t
    x, y, z = body[g, 0], body[g, 1], body[g, 2]
    vx, vy, vz = body[g, VELOCITY], body[g, VELOCITY + 1], body[g, VELOCITY + 2]
    wx, wy, wz = body[g, SPIN], body[g, SPIN + 1], body[g, SPIN + 2]
    # a separate test for None is evaluated before type inference, and the code it guards is not compiled
    if flow is not None:  # noqa: SIM102
        if half:
            vx, vy, vz = _turn_velocity(flow, free, g, vx, vy, vz)
    if moving.whole[g]:
        vx, vy = _kick(keep, slow, a, half, go_on, vx, fx), _kick(keep, slow, a, half, go_on, vy, fy)
        wz = _kick(keep_t, slow_t, b, half, go_on, wz, tz)
        if dim == 3:
            vz = _kick(keep, slow, a, half, go_on, vz, fz)
            wx, wy = _kick(keep_t, slow_t, b, half, go_on, wx, tx), _kick(keep_t, slow_t, b, half, go_on, wy, ty)
    else:
        vx = _kick(keep, slow, a, half, go_on, vx, fx) if free[g, 0] else vx
        vy = _kick(keep, slow, a, half, go_on, vy, fy) if free[g, 1] else vy
        wz = _kick(keep_t, slow_t, b, half, go_on, wz, tz) if free[g, 5] else wz
        if dim == 3:
            vz = _kick(keep, slow, a, half, go_on, vz, fz) if free[g, 2] else vz
            wx = _kick(keep_t, slow_t, b, half, go_on, wx, tx) if free[g, 3] else wx
            wy = _kick(keep_t, slow_t, b, half, go_on, wy, ty) if free[g, 4] else wy
    if flow is not None:
        if go_on:
            vx, vy, vz = _turn_velocity(flow, free, g, vx, vy, vz)
        if not moving.whole[g] and (half or go_on):
            when = 0 if go_on else 1
            vx, vy = _free_or_imposed(flow, when, free, g, 0, vx), _free_or_imposed(flow, when, free, g, 1, vy)
            vz, wz = _free_or_imposed(flow, when, free, g, 2, vz), _free_or_imposed(flow, when, free, g, 5, wz)
            wx, wy = _free_or_imposed(flow, when, free, g, 3, wx), _free_or_imposed(flow, when, free, g, 4, wy)
    body[g, VELOCITY], body[g, VELOCITY + 1], body[g, SPIN + 2] = vx, vy, wz
    if dim == 3:
        body[g, VELOCITY + 2], body[g, SPIN], body[g, SPIN + 1] = vz, wx, wy
    if not go_on:
        return 0.0
    x, y, z = _drift(flow, dt, x, y, z, vx, vy, vz)
    if flow is not None:
        origin[g, 0], origin[g, 1], origin[g, 2] = _transform(
            flow.matrix[STRETCH], origin[g, 0], origin[g, 1], origin[g, 2]
        )
    dx, dy, dz = x - origin[g, 0], y - origin[g, 1], 0.0
    body[g, 0], body[g, 1] = x, y
    angle[g, 2] += dt * wz
    if dim == 3:
        dz = z - origin[g, 2]
        body[g, 2] = z
        angle[g, 0] += dt * wx
        angle[g, 1] += dt * wy
    if predict:
        ahead, whole = moving.ahead, moving.whole[g]
        if flow is not None:
            vx, vy, vz = _turn_velocity(flow, free, g, vx, vy, vz)
        ahead[g, VELOCITY_AHEAD] = slow * (vx + a * fx) if whole or free[g, 0] else vx
        ahead[g, VELOCITY_AHEAD + 1] = slow * (vy + a * fy) if whole or free[g, 1] else vy
        ahead[g, SPIN_AHEAD + 2] = slow_t * (wz + b * tz) if whole or free[g, 5] else wz
        if dim == 3:
            ahead[g, VELOCITY_AHEAD + 2] = slow * (vz + a * fz) if whole or free[g, 2] else vz
            ahead[g, SPIN_AHEAD] = slow_t * (wx + b * tx) if whole or free[g, 3] else wx
            ahead[g, SPIN_AHEAD + 1] = slow_t * (wy + b * ty) if whole or free[g, 4] else wy
        if flow is not None:  # noqa: SIM102
            if not whole:
                for k in range(6):
                    c = VELOCITY_AHEAD + k if k < 3 else SPIN_AHEAD + k - 3
                    ahead[g, c] = _free_or_imposed(flow, 1, free, g, k, ahead[g, c])
    square = (dx * dx + dy * dy + dz * dz) * origin[g, 3]
    return square if square < _NOT_FINITE_SQUARE else _NOT_FINITE_SQUARE


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _sum_virial(virial, blocks, first, last):
    """Sum f ⊗ r over the contacts in which a body is i, for a range of bodies."""
    g, load, pair = np.uint64(first) - np.uint64(1), blocks.load, blocks.pair
    for e in range(np.uint64(blocks.start[first]), np.uint64(blocks.start[last])):
        c = np.uint64(blocks.code[e])
        if c & np.uint64(IS_FIRST):
            g += np.uint64(1)
            for k in range(9):
                virial[g, k] = 0.0
        if c & np.uint64(IS_I):
            at = c // np.uint64(ROW)
            for k in range(3):
                for m in range(3):
                    virial[g, 3 * k + m] += load[at, k] * pair[at, m]


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _sum_loads(flow, moving, blocks, first, last, total):
    """Sum external loads and those of all contacts, in the order of their partners, for at most CHUNK bodies."""
    far = np.int64(len(moving.tile) > 2)  # with one tile, all data are near
    sum_rows(blocks.code, blocks.start, np.int64(first), np.int64(last), far, blocks.load, moving.external, total)
    if flow is not None:
        _sum_virial(moving.virial, blocks, first, last)
    for at in range(first, last):
        g, t = np.uint64(at), np.uint64(at - first)
        own, radius = g if len(moving.torque) > 1 else np.uint64(0), moving.body[g, RADIUS]
        for k in range(np.uint64(3)):
            total[t, 3 + k] = moving.torque[own, k] + radius * total[t, 3 + k]


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _store_forces(force, total, first, last):
    """Store the forces on a range of bodies."""
    for at in range(first, last):
        g, t = np.uint64(at), np.uint64(at - first)
        force[g, 0], force[g, 1], force[g, 2] = total[t, 0], total[t, 1], total[t, 2]
        force[g, 3], force[g, 4], force[g, 5] = total[t, 3], total[t, 4], total[t, 5]


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _end_step(dim, predict, first, last, moving, blocks, pace, flow, fresh, go_on, total):
    """End the step of a tile's grains and begin the next one, or store the forces."""
    far = 0.0
    for start in range(first, last, CHUNK):
        end = min(start + CHUNK, last)
        _sum_loads(flow, moving, blocks, start, end, total)
        for at in range(start, end):
            g, t = np.uint64(at), np.uint64(at - start)
            fx, fy, fz, tx, ty, tz = total[t, 0], total[t, 1], total[t, 2], total[t, 3], total[t, 4], total[t, 5]
            far = max(far, _move_body(dim, predict, moving, pace, flow, g, not fresh, go_on, fx, fy, fz, tx, ty, tz))
        if not go_on:
            _store_forces(moving.force, total, start, end)
    return far


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _end_last_tile(dim, predict, moving, blocks, pace, flow, pull, fresh, go_on, total):
    """End the step of the last tile: walls, bodies on springs, and rigid groups, whose members get the total force."""
    first, last, force = moving.tile[-1], len(moving.body), moving.force
    if blocks is not None:
        for start in range(first, last, CHUNK):
            end = min(start + CHUNK, last)
            _sum_loads(flow, moving, blocks, start, end, total)
            _store_forces(force, total, start, end)
    if pull is not None:
        _add_springs(pull, first, moving.body, force)
    sum_over_groups(moving.member, moving.members, force)
    far = 0.0
    for at in range(first, last):
        g = np.uint64(at)
        fx, fy, fz, tx, ty, tz = force[g, 0], force[g, 1], force[g, 2], force[g, 3], force[g, 4], force[g, 5]
        far = max(far, _move_body(dim, predict, moving, pace, flow, g, not fresh, go_on, fx, fy, fz, tx, ty, tz))
    return far


@njit(fastmath=False, **KERNEL_OPTIONS, **INNER)
def _begin_step(dim, predict, first, last, moving, pace, flow):
    """Begin the step of a tile's grains with the stored forces."""
    far, force = 0.0, moving.force
    no, yes = np.bool_(False), np.bool_(True)  # as literals they would compile `_move_body` once more
    for at in range(first, last):
        g = np.uint64(at)
        fx, fy, fz, tx, ty, tz = force[g, 0], force[g, 1], force[g, 2], force[g, 3], force[g, 4], force[g, 5]
        far = max(far, _move_body(dim, predict, moving, pace, flow, g, no, yes, fx, fy, fz, tx, ty, tz))
    return far


@njit(cache=True, fastmath=False, error_model="numpy", forceinline=True, **INNER)
def _evaluate_rows(
    kind, coulomb, dim, viscous, rate, rescaled, rows, contacts, moving, p, dt, hold, flow, time, events, event_count
):  # fmt: skip
    """Evaluate external loads and those of all contacts, row by row."""
    force, external, torque = moving.force, moving.external, moving.torque
    for a in range(len(force)):
        g = np.uint64(a)
        own, turning = g if len(external) > 1 else np.uint64(0), g if len(torque) > 1 else np.uint64(0)
        force[g, 0], force[g, 1], force[g, 5] = external[own, 0], external[own, 1], torque[turning, 2]
        if dim == 3:
            force[g, 2], force[g, 3], force[g, 4] = external[own, 2], torque[turning, 0], torque[turning, 1]
    if flow is not None:
        image, vectors, shift = contacts.image, rows.vectors, rows.shift
        for g in range(len(force)):
            for k in range(9):
                moving.virial[g, k] = 0.0
        for c in range(contacts.count[0]):
            for m in range(3):
                shift[c, m] = image[c, 0] * vectors[0, m] + image[c, 1] * vectors[1, m] + image[c, 2] * vectors[2, m]
    sweep_contacts(
        kind, coulomb, dim, viscous, rate, rescaled, FREE, rows.step, dt, hold, flow, rows.bodies, contacts, rows.shift,
        p, rows.force, rows.torque, moving.virial, time, events, event_count,
    )  # fmt: skip


@njit(cache=True, **INNER)
def _record_events(blocks, before, contacts, moving, time, events, event_count):
    """Record the contacts whose modes show that they closed, opened or first reached the Coulomb limit."""
    for s in range(len(before)):
        old, new, c = before[s], blocks.mode[s], blocks.row[s]
        if old == new or c < 0:
            continue
        i, j, g = contacts.i[c], contacts.j[c], blocks.i[s]
        if new == OPEN or old == OPEN:
            kind = OPENED if new == OPEN else CLOSED
            record_event(events, event_count, kind, time, i, j, contacts.image, c, moving.body, g)
        if new == SLIDE and old not in (SLIDE, STUCK_AGAIN):
            record_event(events, event_count, REACHED_LIMIT, time, i, j, contacts.image, c, moving.body, g)


@njit(**KERNEL_OPTIONS, **INNER)
def _add_ticks(spent, k, since):
    """Add the ticks since a given time to those of a thread."""
    spent[k, 0] += ticks() - since


@cache
def step_loop(kind: int, coulomb: int, dim: int, viscous: int, rate: int, parallel: bool):
    """Compiled loop over time steps for one law and dimension, on one thread or several, with or without a frame."""
    rescaled, (kind, coulomb, axes, predict) = (
        rescaling_flag(kind),
        as_numpy_integers(kind, coulomb, dim, viscous > 0 and not rate),
    )

    @njit(cache=True, fastmath=False, error_model="numpy", parallel=parallel)
    def loop(
        moving, blocks, rows, contacts, p, plan, pace, frame, flow, pull, writing, tolerance, residual, time, step,
        stop, ended, fresh,
    ):  # fmt: skip
        """Run from step `step` to the end of step `stop`, or until a body has moved too far for the list or the blocks.

        `blocks` or `rows` is None, and its branches are not compiled. `ended`: the step has ended and forces are
        stored; else positions are those of the step, but forces are not known yet. `fresh`: velocities are also those
        of the step, and memory is not transported. `residual` (2,): largest unbalanced force at the last check, and
        its body.
        """
        tile, share, body, ahead, every = moving.tile, moving.share, moving.body, moving.ahead, writing.every
        events, event_count = writing.events, writing.event_count
        # the body must depend on `parallel`, because the cache of compiled code is keyed by it alone
        workers = len(share) - 1 if parallel else 1
        tiles, dt, watch, limit = len(tile) - 1, pace.dt, len(events) > 0, 1.0
        far, total = np.zeros(tiles + 1), np.zeros((0, WIDTH))
        if blocks is not None:
            cross, inner = blocks.cross, blocks.inner
            before = np.zeros(inner[tiles] * LANES if watch else 0, np.int64)
            sums, scratches = empty_aligned((workers + 1) * CHUNK, WIDTH), empty_aligned(workers, SCRATCH)
            between = cross[tiles + 1] - cross[tiles]  # blocks between threads, and within the last tile
        yes, none = np.bool_(True), np.int64(0)  # as literals they would compile `evaluate_blocks` once more
        while True:
            if not ended:
                go_on = step < stop and flow is None
                if rows is not None:
                    if watch and event_count[0] + contacts.count[0] > len(events):
                        return FULL, step, ended
                    go_on = go_on and step % CHECK_EVERY > 0 and not (every > 0 and step % every == 0)
                    _evaluate_rows(
                        kind, coulomb, dim, viscous, rate, rescaled, rows, contacts, moving, p, dt, fresh, flow,
                        time + step * dt, events, event_count,
                    )  # fmt: skip
                if blocks is not None:
                    if watch:
                        if event_count[0] + 2 * len(before) > len(events):
                            return FULL, step, ended
                        for s in range(len(before)):
                            before[s] = blocks.mode[s]
                    go_on = go_on and not watch
                    if between > 0:  # the condition prevents the compiler from fusing this loop with the next
                        for k in prange(workers):
                            first, last = (
                                cross[tiles] + between * k // workers,
                                cross[tiles] + between * (k + 1) // workers,
                            )
                            evaluate_blocks(
                                kind, coulomb, dim, viscous, rate, rescaled, first, last, yes, none, none, blocks, body,
                                ahead, p, dt, fresh, flow, scratches[k],
                            )  # fmt: skip
                    for k in prange(workers):
                        scratch, own, since = scratches[k], sums[k * CHUNK : (k + 1) * CHUNK], ticks()
                        for t in range(share[k], share[k + 1]):
                            begin, end = tile[t + 1], tile[min(t + 2, share[k + 1])]  # next tile of the thread
                            for within in range(2):
                                first, last = (inner[t], inner[t + 1]) if within else (cross[t], cross[t + 1])
                                evaluate_blocks(
                                    kind, coulomb, dim, viscous, rate, rescaled, first, last, not within, begin, end,
                                    blocks, body, ahead, p, dt, fresh, flow, scratch,
                                )  # fmt: skip
                            far[t] = _end_step(
                                axes, predict, tile[t], tile[t + 1], moving, blocks, pace, flow, fresh, go_on, own
                            )
                        _add_ticks(moving.spent, k, since)
                    total = sums[workers * CHUNK :]
                far[tiles] = _end_last_tile(axes, predict, moving, blocks, pace, flow, pull, fresh, go_on, total)
                if flow is not None:
                    end_cell_step(axes, frame, flow, pace, moving, fresh)
                if blocks is not None:  # noqa: SIM102
                    if watch:
                        _record_events(blocks, before, contacts, moving, time + step * dt, events, event_count)
                ended, fresh = not go_on, False
            if ended:
                if rows is not None:  # noqa: SIM102
                    if every > 0 and step % every == 0:
                        scatter_bodies(moving, rows.here)
                        write_sample(
                            kind, coulomb, dim, p, step // every, rows.here, contacts, rows.shift, plan, writing,
                            rows.vectors, time + step * dt,
                        )  # fmt: skip
                if tolerance > 0.0 and step % CHECK_EVERY == 0:
                    residual[0], residual[1] = largest_unbalanced(moving, plan)
                    if flow is not None:
                        residual[0] = max(residual[0], unbalanced_cell(axes, frame, flow, plan.drags[0]))
                    if residual[0] <= tolerance:
                        return CONVERGED, step, ended
                if step == stop:
                    return DONE, step, ended
                if flow is not None:
                    limit = begin_cell_step(frame, flow, pace)
                if blocks is not None:
                    for k in prange(workers):
                        for t in range(share[k], share[k + 1]):
                            far[t] = _begin_step(axes, predict, tile[t], tile[t + 1], moving, pace, flow)
                far[tiles] = _begin_step(axes, predict, tile[tiles], len(body), moving, pace, flow)
            ended = False
            step += 1
            if pull is not None:
                pull.clock[0] += dt
            for t in range(tiles + 1):  # not far.max(), which would become a separate parallel region
                if far[t] > limit:
                    return MOVED, step, ended

    return loop
