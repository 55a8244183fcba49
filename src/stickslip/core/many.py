"""Runs of many grains: bodies put in order, blocks chosen again when they must be, stops to look and to record."""

import numba
import numpy as np

from .blocks import TILE, Moving, anchored, committed, no_blocks
from .contact import FROZEN, needs_radius
from .forces import Bodies, forces, moved_masses
from .frame import PULL, RATE, SINCE, VECTORS, frame_of, imposes, room_left, unbalanced_cell
from .geometry import shifts
from .instant import bodies_at_start
from .laws import Law, dashpots
from .ledger import entered
from .neighbors import TOO_FAR, farthest, grid_of, of_rows, rebuilt
from .plan import (
    AWAY,
    BAD,
    CHECK_EVERY,
    CONVERGED,
    DONE,
    FULL,
    MOVED,
    Plan,
    first_bad,
    largest_unbalanced,
    pool_of,
    runaway,
    state_after,
)
from .reach import gap_listed
from .record import Writing, sample, sample_groups, with_lost
from .selection import chosen_blocks, morton
from .state import OPEN, Instant, State, deforms
from .sums import WIDTH
from .tiles import Pace, Pull, exported, marcher

MANY = 48  # bodies from which blocks are faster than a plain sweep
WORTH = 2000  # grains a thread should have


def _threads(n: int, asked: int | None, watched: bool) -> int:
    """Threads of a run; events are recorded in order of memory, so with them it takes one."""
    available = numba.get_num_threads()
    return 1 if watched else min(available, max(1, n // WORTH) if asked is None else asked)


def _ordered(state: State, radius: float) -> np.ndarray:
    """(B,) bodies in the order in which they lie in memory: grains along a curve, the last tile's grains, walls."""
    n, last = len(state.grains.radius), _in_last_tile(state)
    single = np.flatnonzero(~last)
    last = np.append(np.flatnonzero(last), np.arange(n, state.n_bodies))
    if len(single) > TILE:
        grid = grid_of(state.cell)
        fraction = state.grains.position[single] @ grid.inverse
        fraction -= np.where(grid.periodic, np.floor(fraction), 0.0)
        low = np.where(grid.periodic, 0.0, fraction.min(axis=0))
        single = single[np.argsort(morton(fraction, np.eye(3), low, 4.0 * radius / grid.height), kind="stable")]
    return np.append(single, last)


def _in_last_tile(state: State) -> np.ndarray:
    """(N,) bool: grains in rigid groups, and those that a spring pulls."""
    control = state.control
    return ((control.group >= 0) | control.spring.any(axis=1))[: len(state.grains.radius)]


def _pull(state: State, moving: Moving) -> Pull | None:
    """Springs, if there are any."""
    control, last = state.control, moving.order[moving.tile[-1] :]
    if not control.spring.any():
        return None
    parts = (np.ascontiguousarray(part[last]) for part in (control.spring, control.anchor, control.leads.astype(int)))
    return Pull(*parts, control.knots, control.course, np.full(1, state.time))


def _moving(state: State, plan: Plan, here: Bodies, predict: bool, imposed: bool, threads: int) -> Moving:
    """Working copy of all bodies in the order of memory."""
    n, dim, b = len(state.grains.radius), state.cell.dim, state.n_bodies
    order = _ordered(state, float(state.grains.radius.mean()))
    mass, inertia = moved_masses(state), np.append(state.grains.inertia, np.ones(b - n))
    free = state.control.free.copy()
    free[n:, 3:] = False
    if dim == 2:
        free[:, 2:5] = False
    used = [0, 1, 5] if dim == 2 else range(6)
    external, torque = np.zeros((b if plan.external[0].any() else 1, WIDTH)), np.zeros((1, 3))
    if plan.external[0].any():
        external[:, :3] = plan.external[0][order]
    if plan.external[1].any():
        torque = plan.external[1][order]
    single = int((~_in_last_tile(state)).sum())
    size = TILE if threads == 1 else min(TILE, -(-n // (4 * threads)))
    tile = np.append(np.arange(0, single, size), single)
    place = np.empty(b, np.int64)
    place[order] = np.arange(b)
    return Moving(
        order,
        np.concatenate([here.position, here.velocity, here.spin, here.radius[:, None]], axis=1)[order],
        here.angle[order],
        np.concatenate([here.velocity, here.spin], axis=1)[order] if predict else np.zeros((0, 6)),
        np.zeros((b, 6)),
        (0.5 * plan.dt / np.stack([mass, inertia], axis=1))[order],
        free[order],
        free[:, used].all(axis=1)[order],
        external,
        torque,
        np.zeros((b if imposed else 0, 9)),
        here.position[order],
        tile,
        *pool_of(state.control, place),
        np.arange(threads + 1) * (len(tile) - 1) // threads,
    )


def marched(
    state: State, law: Law, plan: Plan, steps: int, tolerance: float, writing: Writing, books, instant, *, rate: int,
    threads,
):  # fmt: skip
    """As many steps as asked, in blocks; see `run`. Returns what the plain stepper does."""
    contacts, here, nothing = state.contacts, bodies_at_start(state, instant), np.zeros((0, 3))
    at = (here.position, here.angle, here.radius)
    if anchored(contacts, *at, state.cell.vectors, nothing, nothing):
        # what a run writes; pair vectors and angles are written when it ends
        own = {name: getattr(contacts, name).copy() for name in ("slip", "mode", "reached")}
        contacts = contacts._replace(**own)
    else:
        _, contacts = forces(state, law, memory=FROZEN)
    contacts = contacts._replace(pair=nothing, roll=nothing)
    viscous, dim = dashpots(law), state.cell.dim
    threads = _threads(len(state.grains.radius), threads, len(writing.events) > 0)
    imposed = imposes(state)
    march = marcher(law.kind, law.coulomb, dim, viscous, rate, threads > 1)
    moving = _moving(state, plan, here, viscous > 0 and not rate, imposed, threads)
    frame, flow = frame_of(state, moving.order) if imposed else (None, None)
    pull = _pull(state, moving)
    drags = [0.5 * plan.dt * nu for nu in plan.drags]
    pace = Pace(plan.dt, 1 - drags[0], 1 / (1 + drags[0]), 1 - drags[1], 1 / (1 + drags[1]))
    every, deforming, gap = writing.every, deforms(state), gap_listed(contacts)
    ended, by_size = instant is not None, needs_radius(law.kind, viscous)
    step, stop, fresh, code, residual, worst = 0, 0, not ended, MOVED, np.inf, -1
    if ended:
        moving.force[:] = instant.force[moving.order]
        if imposed:
            flow.matrix[PULL] = instant.pull
    blocks, before = no_blocks(), numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        while True:
            if code == MOVED:
                reach, skin = _wanted(state, plan, here, contacts, frame, steps - step)
                if skin > 0:
                    blocks = no_blocks()  # before there is a new list: memory
                    contacts = former = _closed(contacts)
                    contacts = _with_skin(skin, here, contacts, grid_of(state.cell))
                    writing = with_lost(writing, former, contacts, here.position, state.time + step * plan.dt)
                    del former
                if imposed:
                    frame.reach[0], flow.matrix[SINCE] = reach, np.eye(3)
                    frame.made[:] = state.cell.vectors if skin > 0 else frame.made
                moving.origin[:], limit = moving.body[:, :3], (0.5 * reach) ** 2
                blocks = chosen_blocks(
                    blocks, contacts, moving, here.radius, here.inverse_mass, here.material, here.normal,
                    state.cell.vectors, np.eye(3) if imposed else state.cell.vectors, reach + gap, len(law.table),
                    by_size, viscous,
                )  # fmt: skip
            code, step, ended = march(
                moving, blocks, contacts, law.table, pace, frame, flow, pull, state.time, step, stop, ended, fresh,
                limit, writing.events, writing.event_count,
            )  # fmt: skip
            if code == FULL:
                writing = writing._replace(events=np.concatenate([writing.events, np.zeros_like(writing.events)]))
                continue
            fresh = False
            exported(moving, here)
            if deforming:
                vectors, here.rate[:] = flow.matrix[VECTORS].copy(), flow.matrix[RATE]
                state = state._replace(cell=state.cell._replace(vectors=vectors, rate=here.rate.copy()))
            committed(blocks, contacts)
            bad, away = first_bad(here.position, here.angle), runaway(here.velocity, here.radius, plan.dt)
            if bad >= 0 or away >= 0:
                code, worst = (BAD, bad) if bad >= 0 else (AWAY, away)
                break
            if code == MOVED:
                continue
            if books:
                books = entered(books, law, state, plan, here, contacts, step, every)
            if every and step % every == 0:
                vectors, time = state.cell.vectors, state.time + step * plan.dt
                sample(
                    law.kind, law.coulomb, dim, law.table, step // every, here, contacts, shifts(contacts, vectors),
                    plan, writing, vectors, time,
                )  # fmt: skip
                if writing.groups.shape[1]:
                    sample_groups(writing.groups[step // every], state, plan.external, here, _forces(moving), time)
            if step % CHECK_EVERY == 0 and tolerance > 0:
                force = _forces(moving)
                residual, worst = largest_unbalanced(here.velocity, here.spin, force[:, :3], force[:, 3:], plan)
                residual = max(residual, unbalanced_cell(frame, flow, dim, plan.drags[0]) if deforming else 0.0)
                code = BAD if not np.isfinite(residual) else CONVERGED if residual <= tolerance else DONE
            if step == steps or code != DONE:
                break
            stop = min(steps, (step // CHECK_EVERY + 1) * CHECK_EVERY, (step // every + 1) * every if every else steps)
            stop = step + 1 if books else stop
    finally:
        numba.set_num_threads(before)
    clock = frame.clock if imposed else pull.clock if pull else [state.time + step * plan.dt]
    time = float(clock[0])
    del blocks  # memory for what is given back
    instant = Instant(_forces(moving), flow.matrix[PULL].copy() if imposed else np.zeros((3, 3)), 0)
    del moving, frame, flow
    if deforming or contacts.skin[0] != state.contacts.skin[0]:
        # a list tells whether it is still good by how far grains have moved, not by how the cell has
        contacts = _closed(contacts)
        contacts = _with_skin(float(state.contacts.skin[0]), here, contacts, grid_of(state.cell))
    contacts = contacts._replace(pair=np.zeros_like(contacts.slip), roll=np.zeros_like(contacts.slip))
    anchored(contacts, *at, state.cell.vectors, contacts.pair, contacts.roll)
    end = state_after(state, here, contacts, time)._replace(instant=instant)
    return end, code, step, residual, worst, writing, books


def _forces(moving: Moving) -> np.ndarray:
    """(B, 6) forces and torques at the end of a step, in the state's order."""
    force = np.empty_like(moving.force)
    force[moving.order] = moving.force
    return force


def _wanted(state, plan, here, contacts, frame, steps):
    """Reach within which to choose blocks, and the skin of the list that must be made first, or 0 if this one will do.

    The longer the reach, the rarer the choice and the more pairs in vain: what both cost together is least where the
    reach goes with the root of the speed, and likewise for the skin, with factors that were measured.
    """
    skin, size = float(contacts.skin[0]), 2 * float(state.grains.radius.mean())
    stride = np.sqrt((here.velocity**2).sum(axis=1).max()) * plan.dt
    wanted = 2 * np.sqrt(stride * size * (1 + 300 / len(state.grains.radius)))
    reach = min(max(wanted, 0.05 * skin), 0.5 * skin)
    left, carried = skin, contacts
    if deforms(state):
        left, deformation = room_left(state.cell.vectors, frame.made, skin, frame.widest)
        carried = contacts._replace(origin=contacts.origin @ deformation.T)
    if 2 * farthest(here.position, carried) + reach <= left:
        return reach, 0.0
    skin = float(state.contacts.skin[0])
    if 2 * stride * steps > 4 * skin:  # else making the list that the caller gets back is not worth it
        skin = max(skin, min(4 * wanted, size))
    return min(max(wanted, 0.05 * skin), 0.5 * skin), skin


def _closed(contacts):
    """The list without open pairs, which takes half the memory."""
    return of_rows(contacts, np.flatnonzero(contacts.mode[: contacts.count[0]] != OPEN))


def _with_skin(skin, here, contacts, grid):
    """The list made anew with the given skin."""
    contacts = rebuilt(
        here.position, here.radius, here.normal, grid, contacts._replace(skin=np.append(skin, contacts.skin[1:]))
    )
    if contacts.count[0] < 0:
        raise ValueError(TOO_FAR)
    return contacts
