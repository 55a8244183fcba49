"""Driver of runs: memory order of bodies, updates of the list and of the blocks, stops for records."""

import numba
import numpy as np

from ..contacts.forces import Bodies, forces, moved_masses
from ..contacts.geometry import shifts
from ..contacts.interaction_range import with_rolling_memory
from ..contacts.mechanics import FROZEN, needs_radius
from ..contacts.neighbors import TOO_FAR, grid_of, rebuild_list, select_rows
from ..contacts.rolling import resists_rolling
from ..contacts.rows import Step
from ..fields import pack_keys
from ..flow import INVERSE_HALF, PULL, RATE, RATE_AHEAD, SINCE, VECTORS
from ..laws.builtin import Law, damping_model
from ..simd.blocks import TILE_SIZE, MovingBodies, commit, empty_blocks, store_reference
from ..simd.layout import displacement_limits, gather_bodies, limit_displacements, scatter_bodies, speeds
from ..simd.partition import balance_threads, block_chooser, morton_keys, split_layers
from ..simd.reduce import WIDTH
from ..simd.transpose import BODY, BODY_AHEAD, KICK, RADIUS, SPIN, SPIN_AHEAD, VELOCITY, VELOCITY_AHEAD, empty_aligned
from ..state import OPEN, Instant, State, deforms
from .cell_motion import make_frame, needs_frame, remaining_skin
from .coefficients import (
    CHECK_EVERY,
    DONE,
    FULL,
    MOVED,
    NOT_FINITE,
    RUNAWAY,
    Plan,
    find_members,
    find_not_finite,
    find_runaway,
    movable,
    state_after,
)
from .last_forces import bodies_at_start
from .ledger import post_step
from .loop import Rows, Springs, StepFactors, step_loop
from .record import RecordBuffers, with_lost_contacts, write_groups, write_sample

MIN_BODIES = 48  # number of bodies above which blocks are faster than rows
GRAINS_PER_THREAD = 2000  # minimum for good efficiency
# displacement after which blocks are chosen again: BASE √(u D) + SPAN √(D/u) times the displacement per step, where u
# is the displacement per step at the typical speed, and D a diameter
BASE, SPAN = 1.4, 0.8
_MOVING_FIELDS, _EMPTY = ("position", "angle", "velocity", "spin"), np.zeros((0, 3))


def _thread_count(n: int, asked: int | None, watched: bool) -> int:
    """Number of threads for a run. Events are recorded in memory order, which requires one thread."""
    available = numba.get_num_threads()
    return 1 if watched else min(available, max(1, n // GRAINS_PER_THREAD) if asked is None else asked)


def _memory_order(state: State, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """Bodies in memory order, (B,): tile by tile, then the grains of the last tile, then the walls.

    Also returns the bounds of the tiles, (T + 1,), with the same number of tiles for each thread. Within a tile, grains
    lie along a space-filling curve. Without threads, all bodies are in the last tile, in the state's order.
    """
    if not threads:
        return np.arange(state.n_bodies), np.zeros(2, np.int64)
    n, last = len(state.grains.radius), _in_last_tile(state)
    single, grid = np.flatnonzero(~last), grid_of(state.cell)
    fraction = grid.inverse.T @ state.grains.position[single].T
    x = (fraction - np.where(grid.periodic[:, None], np.floor(fraction), 0.0)) * grid.height[:, None]
    x -= x.min(axis=1, initial=np.inf)[:, None]
    each, size = max(1, -(-len(single) // (threads * TILE_SIZE))), 2 * state.grains.radius.mean()
    shares = split_layers(x, np.arange(len(single)), threads)
    parts = [part for share in shares for part in split_layers(x, share, each)]
    parts = [part[np.argsort(morton_keys(x[:, part], size))] for part in parts]
    order = np.concatenate([*(single[part] for part in parts), np.flatnonzero(last), np.arange(n, state.n_bodies)])
    return order, np.cumsum([0] + [len(part) for part in parts])


def _in_last_tile(state: State) -> np.ndarray:
    """Grains in rigid groups and grains pulled by springs, (N,) bool."""
    control = state.control
    return ((control.group >= 0) | control.spring.any(axis=1))[: len(state.grains.radius)]


def _gather_springs(state: State, moving: MovingBodies) -> Springs | None:
    """Springs on the bodies of the last tile, or None."""
    control, last = state.control, moving.order[moving.tile[-1] :]
    if not control.spring.any():
        return None
    parts = (np.ascontiguousarray(part[last]) for part in (control.spring, control.anchor, control.leads.astype(int)))
    return Springs(*parts, control.knots, control.course, np.full(1, state.time))


def _make_moving_bodies(
    state: State, plan: Plan, here: Bodies, predict: bool, imposed: bool, by_rows: bool, threads: int
) -> MovingBodies:
    """Working copy of all bodies in memory order."""
    n, dim, b = len(state.grains.radius), state.cell.dim, state.n_bodies
    order, tile = _memory_order(state, 0 if by_rows else threads)
    mass, inertia = moved_masses(state), np.append(state.grains.inertia, np.ones(b - n))
    free = movable(state)
    used = [0, 1, 5] if dim == 2 else range(6)
    external, torque = np.zeros((b if plan.external[0].any() else 1, WIDTH)), np.zeros((1, 3))
    if plan.external[0].any():
        external[:, :3] = plan.external[0][order]
    if plan.external[1].any():
        torque = plan.external[1][order]
    place = np.empty(b, np.int64)
    place[order] = np.arange(b)
    # a spare row for `_columns_from`
    body, ahead = empty_aligned(b + 1, BODY)[:b], empty_aligned(b + 1 if predict else 1, BODY_AHEAD)[: b * predict]
    gather_bodies(order, here, 0.5 * plan.dt / mass, 0.5 * plan.dt / inertia, body, ahead)
    return MovingBodies(
        order,
        body,
        here.angle[order],
        ahead,
        np.zeros((b + 1, 6))[:b],
        free[order],
        free[:, used].all(axis=1)[order],
        external,
        torque,
        np.zeros((b if imposed else 0, 9)),
        np.zeros((b, 4)),
        tile,
        *find_members(state.control, place),
        np.arange(threads + 1) * (len(tile) - 1) // threads,
        np.zeros((threads, 8), np.int64),
    )


class _Run:
    """State of a run.

    It holds the only references to the list and blocks, so that their memory can be freed before new ones are made.
    Few grains, and contacts with rolling resistance, are evaluated by rows, others by blocks.
    """

    def __init__(
        self, state: State, law: Law, plan: Plan, steps: int, tolerance: float, writing: RecordBuffers, books, instant,
        rate: int, threads,
    ):  # fmt: skip
        self.state, self.law, self.plan, self.steps, self.writing = state, law, plan, steps, writing
        self.viscous, self.imposed, self.deforming = damping_model(law), needs_frame(state), deforms(state)
        self.by_rows = state.n_bodies < MIN_BODIES or resists_rolling(law.kind)
        watched = len(writing.events) > 0
        self.threads = 1 if self.by_rows else _thread_count(len(state.grains.radius), threads, watched)
        self.loop = step_loop(law.kind, law.coulomb, state.cell.dim, self.viscous, rate, self.threads > 1)
        self.block_function = block_chooser(self.threads > 1)
        here = bodies_at_start(state, instant)
        keyed = bool(books or watched or resists_rolling(law.kind))
        self.contacts, self.blocks, self.rows = _working_contacts(state, law, here, keyed), empty_blocks(), None
        self.predict = self.viscous > 0 and not rate
        self.moving = _make_moving_bodies(
            state, plan, here, self.predict, self.imposed, self.by_rows, self.threads
        )  # fmt: skip
        self.known = here._replace(**dict.fromkeys(_MOVING_FIELDS, _EMPTY))
        self.frame, self.flow = make_frame(state, self.moving.order) if self.imposed else (None, None)
        self.pull, drags = _gather_springs(state, self.moving), [0.5 * plan.dt * nu for nu in plan.drags]
        self.pace = StepFactors(plan.dt, 1 - drags[0], 1 / (1 + drags[0]), 1 - drags[1], 1 / (1 + drags[1]))
        self.few = 1 + 300 / len(state.grains.radius)  # small choices are disproportionately expensive
        self.step, self.ended, self.fresh = 0, instant is not None, instant is None
        self.tolerance, self.residual = tolerance, np.array([np.inf, -1.0])
        if self.ended:
            self.moving.force[:] = instant.force[self.moving.order]
            if self.imposed:
                self.flow.matrix[PULL] = instant.pull

    def choose_pairs(self) -> None:
        """Choose the pairs that may touch before a body has moved too far.

        The list is rebuilt first if too little of its skin is left.
        """
        state, moving, known = self.state, self.moving, self.known
        room, skin = self._choose_limits()
        if skin > 0:
            self._rebuild_list(skin)
        if self.imposed:
            self.frame.reach[0], self.flow.matrix[SINCE] = 2 * room.min(), np.eye(3)
            self.frame.made[:] = state.cell.vectors if skin > 0 else self.frame.made
        moving.origin[:, :3], moving.origin[:, 3] = moving.body[:, :3], 1.0 if self.imposed else room**-2
        if self.by_rows:
            self.rows = self._make_rows()
            return
        moving.share[:], moving.spent[:] = balance_threads(moving.share, moving.spent[:, 0]), 0
        across = np.eye(3) if self.imposed else state.cell.vectors
        self.blocks = self.block_function(
            self.blocks, self.contacts, moving, known.inverse_mass, known.material, known.normal,
            state.cell.vectors, across, room, self.contacts.gap, len(self.law.table),
            needs_radius(self.law.kind, self.viscous), self.viscous,
        )  # fmt: skip

    def _make_rows(self) -> Rows:
        """Views of the moving bodies for contacts by rows."""
        moving, known, zero, vectors = self.moving, self.known, np.zeros((3, 3)), self.state.cell.vectors
        gradient, back, ahead = (
            (self.flow.matrix[k] for k in (RATE, INVERSE_HALF, RATE_AHEAD)) if self.flow else [zero] * 3
        )
        vectors = self.flow.matrix[VECTORS] if self.flow else vectors
        body, seen = moving.body, moving.ahead if self.predict else moving.body
        v, w = (VELOCITY_AHEAD, SPIN_AHEAD) if self.predict else (VELOCITY, SPIN)
        views = {"position": body, "velocity": _columns_from(seen, v), "spin": _columns_from(seen, w)}
        views |= {"angle": moving.angle, "radius": known.radius, "rate": ahead}
        here = known._replace(**{name: np.empty_like(moving.angle) for name in _MOVING_FIELDS})
        step = Step(_columns_from(body, VELOCITY), _columns_from(body, SPIN), gradient, back)
        force, torque = moving.force, _columns_from(moving.force, 3)
        shift = shifts(self.contacts, vectors)
        return Rows(step, known._replace(**views), shift, vectors, force, torque, here)

    def _rebuild_list(self, skin: float) -> None:
        """Rebuild the list with all pairs closer than `skin`."""
        commit(self.blocks, self.contacts, 0, 1)
        self.blocks = empty_blocks()  # free memory before the new list is made
        self.contacts = former = _without_open_pairs(self.contacts)
        position = _positions_in_state_order(self.moving)
        self.contacts = _rebuild_with_skin(skin, position, self.known, former, self.state.cell, self.law)
        self.writing = with_lost_contacts(self.writing, former, self.contacts, position, self._time())

    def advance(self, stop: int) -> int:
        """Advance to a step, or until blocks must be chosen again. Returns the code of the compiled loop."""
        while True:
            writing = self.writing
            blocks = None if self.by_rows else self.blocks
            code, self.step, self.ended = self.loop(
                self.moving, blocks, self.rows, self.contacts, self.law.table, self.plan, self.pace, self.frame,
                self.flow, self.pull, writing, self.tolerance, self.residual, self.state.time, self.step, stop,
                self.ended, self.fresh,
            )  # fmt: skip
            if code != FULL:
                break
            self.writing = writing._replace(events=np.concatenate([writing.events, np.zeros_like(writing.events)]))
        self.fresh = False
        if self.deforming:
            vectors, self.known.rate[:] = self.flow.matrix[VECTORS].copy(), self.flow.matrix[RATE]
            self.state = self.state._replace(
                cell=self.state.cell._replace(vectors=vectors, rate=self.known.rate.copy())
            )
        return code

    def find_broken(self) -> tuple[int, int]:
        """NOT_FINITE or RUNAWAY with the body concerned, or DONE and −1 if there is no such body."""
        body, found = self.moving.body, -1
        for code, found in (
            (NOT_FINITE, find_not_finite(body[:, :3], self.moving.angle)),
            (RUNAWAY, find_runaway(body[:, VELOCITY:KICK], body[:, RADIUS], self.plan.dt)),
        ):
            if found >= 0:
                return code, int(self.moving.order[found])
        return DONE, found

    def gather(self) -> Bodies:
        """Copy all bodies to new arrays in the state's order, and the contact memory to the contact list.

        To save memory, keep the arrays only while they are in use.
        """
        commit(self.blocks, self.contacts, 0, 1)
        here = self.known._replace(**{name: np.empty_like(self.moving.angle) for name in _MOVING_FIELDS})
        scatter_bodies(self.moving, here)
        return here

    def record(self, here: Bodies, row: int) -> None:
        """Write one row of all series; the loop does so itself if it evaluates contacts by rows."""
        law, cell, time = self.law, self.state.cell, self._time()
        if not self.by_rows:
            write_sample(
                law.kind, law.coulomb, cell.dim, law.table, row, here, self.contacts,
                shifts(self.contacts, cell.vectors), self.plan, self.writing, cell.vectors, time,
            )  # fmt: skip
        if self.writing.groups.shape[1]:
            external = self.plan.external
            write_groups(
                self.writing.groups[row], self.state, external, here, _forces_in_state_order(self.moving), time
            )

    def finish(self, skin: float) -> State:
        """State at the last step, whose list has the given skin."""
        commit(self.blocks, self.contacts, 0, 1)
        self.blocks = empty_blocks()  # free memory for the result
        clock = self.frame.clock if self.imposed else self.pull.clock if self.pull else [self._time()]
        pull, time = self.flow.matrix[PULL].copy() if self.imposed else np.zeros((3, 3)), float(clock[0])
        instant, here, vectors = (
            Instant(_forces_in_state_order(self.moving), pull, 0),
            self.gather(),
            self.state.cell.vectors,
        )
        del self.moving, self.rows
        if self.deforming or self.contacts.skin != skin:
            # the validity of a list is checked by displacements of grains, not by the deformation of the cell
            self.contacts = _without_open_pairs(self.contacts)
            self.contacts = _rebuild_with_skin(skin, here.position, here, self.contacts, self.state.cell, self.law)
        contacts, before = self.contacts, self.state.contacts
        key = before.key if contacts.i is before.i else pack_keys(contacts.i, contacts.j, contacts.image)
        contacts = contacts._replace(key=key, pair=np.zeros_like(contacts.slip), roll=np.zeros_like(contacts.slip))
        store_reference(contacts, here.position, here.angle, here.radius, vectors, contacts.pair, contacts.roll)
        return state_after(self.state, here, contacts, time)._replace(instant=instant)

    def _time(self) -> float:
        return self.state.time + self.step * self.plan.dt

    def _choose_limits(self) -> tuple[np.ndarray, float]:
        """Displacement limit of each body, (B,), and the skin of the list to build first, or 0 to keep the list."""
        state, contacts = self.state, self.contacts
        skin, size = contacts.skin, 2 * float(state.grains.radius.mean())
        left, origin = skin, contacts.origin
        if self.deforming:
            left, deformation = remaining_skin(state.cell.vectors, self.frame.made, skin, self.frame.widest)
            origin = origin @ deformation.T
        room, stride = self._limits(skin)
        if not contacts.stale and limit_displacements(self.moving, origin, 0.5 * left, room):
            return room, 0.0
        skin = state.contacts.skin
        if 2 * stride * (self.steps - self.step) > 4 * skin:  # else a larger skin does not repay the final rebuild
            skin = max(skin, min(8 * np.sqrt(stride * size * self.few), size))
        return self._limits(skin)[0], skin

    def _limits(self, skin: float) -> tuple[np.ndarray, float]:
        """Displacement limit of each body, (B,), and the displacement of the fastest body per step.

        With larger limits, blocks are chosen less often but contain more pairs that do not touch. The total cost is
        minimal if the limit is proportional to the square root of the speed; the factors were found by measurement.
        Fast bodies have larger limits.
        """
        dt, size = self.plan.dt, 2 * float(self.state.grains.radius.mean()) * self.few
        fastest, usual = (speed * dt for speed in speeds(self.moving))
        base, span = np.sqrt(fastest * size), 0.0
        if not self.imposed and usual > 0:
            base, span = BASE * np.sqrt(usual * size), SPAN * np.sqrt(size / usual) * dt
        room = np.empty(len(self.moving.order))
        if self.by_rows:  # all pairs of the list are evaluated
            room[:] = 0.5 * skin
            return room, fastest
        displacement_limits(self.moving, base, span, 0.025 * skin, 0.25 * skin, room)
        return room, fastest


def run_steps(
    state: State, law: Law, plan: Plan, steps: int, tolerance: float, writing: RecordBuffers, books, instant, *,
    rate: int, threads,
):  # fmt: skip
    """Run all steps; see `run`.

    Returns the final state, the code of the compiled loop, the number of steps, the largest unbalanced force and its
    body, the buffers and the books.
    """
    current = _Run(state, law, plan, steps, tolerance, writing, books, instant, rate, threads)
    every, stop, code, worst, before = writing.every, 0, MOVED, -1, numba.get_num_threads()
    # the loop writes samples itself if contacts are evaluated by rows, but not those of groups
    sampling = every if writing.groups.shape[1] or not current.by_rows else 0
    numba.set_num_threads(current.threads)
    try:
        while True:
            if code == MOVED:
                current.choose_pairs()
            code = current.advance(stop)
            broken, body = current.find_broken()
            if broken != DONE:
                code, worst = broken, body
                break
            if code == MOVED:
                continue
            step = current.step
            sampled = sampling and step % sampling == 0
            here = current.gather() if books or sampled else None
            if books:
                books = post_step(books, law, current.state, plan, here, current.contacts, step, every)
            if sampled:
                current.record(here, step // every)
            if not np.isfinite(current.residual[0]) and tolerance > 0 and step % CHECK_EVERY == 0:
                code = NOT_FINITE
            if step == steps or code != DONE:
                break
            stop = min(steps, (step // sampling + 1) * sampling if sampling else steps)
            if tolerance > 0:  # the loop fuses steps in blocks, and looks for rest only where it stops
                stop = min(stop, (step // CHECK_EVERY + 1) * CHECK_EVERY)
            stop = step + 1 if books else stop
    finally:
        numba.set_num_threads(before)
    residual = float(current.residual[0])
    worst = worst if worst >= 0 else int(current.residual[1])
    end = current.finish(state.contacts.skin)
    return end, code, current.step, residual, worst, current.writing, books


def _columns_from(rows: np.ndarray, first: int) -> np.ndarray:
    """Contiguous view whose column 0 is a later column of `rows`, which kernels index faster than a slice.

    It ends within the spare row that follows `rows` in memory.
    """
    return np.lib.stride_tricks.as_strided(rows[:, first:], rows.shape, rows.strides)


def _working_contacts(state: State, law: Law, here: Bodies, keyed: bool):
    """Copy of the contact list, to which a run can write.

    Pair vectors, angles and unused keys are left out until the run ends.
    """
    contacts = state.contacts
    if store_reference(contacts, here.position, here.angle, here.radius, state.cell.vectors, _EMPTY, _EMPTY):
        own = {name: getattr(contacts, name) for name in ("slip", "mode", "reached", "rolling")}
        contacts = contacts._replace(**{name: part.copy() for name, part in own.items() if part is not None})
    else:
        _, contacts = forces(state, law, memory=FROZEN)
    return contacts._replace(pair=_EMPTY, roll=_EMPTY, key=contacts.key[: None if keyed else 0])


def _forces_in_state_order(moving: MovingBodies) -> np.ndarray:
    """Forces and torques at the end of a step, (B, 6), in the state's order."""
    force = np.empty_like(moving.force)
    force[moving.order] = moving.force
    return force


def _positions_in_state_order(moving: MovingBodies) -> np.ndarray:
    """Positions, (B, 3), in the state's order."""
    position = np.empty((len(moving.order), 3))
    position[moving.order] = moving.body[:, :3]
    return position


def _without_open_pairs(contacts):
    """List without open pairs; it takes half the memory."""
    return select_rows(contacts, np.flatnonzero(contacts.mode[: contacts.count[0]] != OPEN))


def _rebuild_with_skin(skin, position, known: Bodies, contacts, cell, law: Law):
    """List rebuilt with the given skin."""
    contacts = rebuild_list(position, known.radius, known.normal, grid_of(cell), contacts._replace(skin=skin))
    if contacts.count[0] < 0:
        raise ValueError(TOO_FAR)
    return with_rolling_memory(contacts, law)
