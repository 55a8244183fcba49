"""Driver of runs: it updates the contact list and the blocks, and stops for records.

In small systems, contacts are evaluated one after another, by rows of the list; in large ones, they are evaluated in
vectorised blocks (see `blocks.h`). Blocks contain only touching and nearly touching pairs: those that could touch
within the displacement limits of both bodies. The limits are larger for faster bodies. When a body reaches its limit,
blocks are chosen anew from the contact list.
"""

import os
import weakref

import numpy as np

from ..contacts.bonds import bond_gap, follow_rotations
from ..contacts.forces import FROZEN, Bodies, forces
from ..contacts.neighbors import (
    TOO_FAR,
    TooFarApartError,
    grid_of,
    rebuild_list,
    select_rows,
    with_neighbor_list,
    with_own_memory,
)
from ..fields import pack_keys
from ..laws.builtin import Law
from ..laws.compiled import FORCES, law_struct
from ..laws.properties import angular_columns
from ..library import core
from ..progress import available_cores
from ..state import OPEN, Instant, State, deforms
from .cell_motion import make_frame, needs_frame, remaining_skin
from .coefficients import Plan, bodies_at_start, state_after
from .ledger import post_step
from .moving import balance_threads, gather_springs, make_moving_bodies
from .record import RecordBuffers, add_bonds, with_lost_contacts, write_groups

MIN_BODIES = 16  # number of bodies above which blocks are faster than rows
GRAINS_PER_THREAD = 2000  # minimum for good efficiency
# displacement after which blocks are chosen anew: BASE √(u D) + SPAN √(D/u) times the displacement per step, where u
# is the displacement per step at the typical speed, and D a diameter
BASE, SPAN = 1.4, 0.8
_MOVING_FIELDS, _EMPTY = ("position", "angle", "velocity", "spin"), np.zeros((0, 3))


def available_threads() -> int:
    """Number of threads that a run may use: the cores that this process may use, at most OMP_NUM_THREADS."""
    asked, cores = os.environ.get("OMP_NUM_THREADS", ""), available_cores()
    return min(int(asked), cores) if asked.isdecimal() and int(asked) else cores


def _thread_count(n: int, asked: int | None, watched: bool) -> int:
    """Number of threads for a run: one if events are recorded, because they are recorded in memory order."""
    if watched or (asked is None and n < 2 * GRAINS_PER_THREAD):
        return 1
    wanted = min(available_threads(), n // GRAINS_PER_THREAD) if asked is None else asked
    return max(1, min(wanted, core.MOST_THREADS))


class _Run:
    """State of a run.

    It holds the only references to the list and blocks, so that their memory can be freed before new ones are made.
    Contacts in small systems and in those with bonds are evaluated by rows, all others by blocks.
    """

    def __init__(
        self, state: State, law: Law, plan: Plan, steps: int, writing: RecordBuffers, books, instant, *, rate: int,
        threads,
    ):  # fmt: skip
        self.state, self.law, self.plan, self.steps = state, law, plan, steps
        self.imposed, self.deforming = needs_frame(state), deforms(state)
        self.struct = core.fill("Law", law_struct(law, rate=rate > 0, members=FORCES))
        remembers, watched = bool(self.struct.angular or self.struct.len_memory), len(writing.events) > 0
        self.by_rows = state.n_bodies < MIN_BODIES or state.bonds is not None
        self.threads = 1 if self.by_rows else _thread_count(len(state.grains.radius), threads, watched)
        here = bodies_at_start(state, instant)
        self.set_contacts(_working_contacts(state, law, here, bool(books or watched or remembers)))
        self.blocks = core.new_blocks()
        weakref.finalize(self, core.free_blocks, self.blocks).atexit = False  # a daemon thread may still use them
        self.bonds = state.bonds and _working_bonds(state, here)
        self.bonded = self.bonds and core.fill("Bonds", self.bonds)
        damped = self.struct.damping or (self.bonds and self.bonds.damping.any())
        predict = bool(damped) and not rate
        self.moving = make_moving_bodies(state, plan, here, predict, self.imposed, self.by_rows, self.threads)
        self.moved = core.fill("Moving", self.moving)
        self.known = here._replace(**dict.fromkeys(_MOVING_FIELDS, _EMPTY))
        self.bodies = core.fill("Bodies", self.known)
        self.frame, self.flow = make_frame(state, self.moving.order) if self.imposed else (None, None)
        self.pull, drags = gather_springs(state, self.moving), [0.5 * plan.dt * nu for nu in plan.drags]
        factors = 1 - drags[0], 1 / (1 + drags[0]), 1 - drags[1], 1 / (1 + drags[1])
        names = "dt", "keep", "slow", "keep_t", "slow_t", "drag", "spin_drag"
        pace = dict(zip(names, (plan.dt, *factors, *plan.drags), strict=True))
        given = ("Pace", pace), ("Frame", self.frame), ("Flow", self.flow), ("Pull", self.pull)
        self.constants = [value and core.fill(kind, value) for kind, value in given]
        self.set_writing(writing)
        self.few = 1 + 300 / len(state.grains.radius)  # choosing few pairs is disproportionately expensive
        # number of the step; whether it has ended; whether velocities are already those of the full step
        self.progress = np.array([0, instant is not None, instant is None])
        self.residual = np.array([np.inf, -1.0])
        if instant is not None:
            self.moving.force[:] = instant.force[self.moving.order]
            if self.imposed:
                self.flow.matrix[core.PULL] = instant.pull

    @property
    def step(self) -> int:
        """Number of the current step."""
        return int(self.progress[0])

    def set_contacts(self, contacts) -> None:
        """Replace the contact list."""
        self.contacts, self.listed = contacts, core.fill("Contacts", contacts)

    def set_writing(self, writing: RecordBuffers) -> None:
        """Replace the buffers for records."""
        self.writing, self.buffers = writing, core.fill("Writing", writing)

    def choose_pairs(self) -> None:
        """Choose the pairs that may touch before a body has moved too far.

        The list is rebuilt first if too little of its skin is left.
        """
        state, moving, known = self.state, self.moving, self.known
        room, skin = self._choose_limits()
        if skin > 0:
            self._rebuild_list(skin)
        if self.imposed:
            self.frame.reach[0], self.flow.matrix[core.SINCE] = 2 * room.min(), np.eye(3)
            self.frame.made[:] = state.cell.vectors if skin > 0 else self.frame.made
        moving.origin[:, :3], moving.origin[:, 3] = moving.body[:, :3], 1.0 if self.imposed else room**-2
        if self.by_rows:
            return
        moving.share[:], moving.spent[:] = balance_threads(moving.share, moving.spent[:, 0]), 0
        across = np.eye(3) if self.imposed else state.cell.vectors
        if not core.choose_blocks(
            self.blocks, self.struct, self.listed, self.moved, known.inverse_mass, known.material, known.normal,
            len(known.normal), state.cell.vectors, across, room, self.contacts.gap,
        ):  # fmt: skip
            raise MemoryError

    def _rebuild_list(self, skin: float) -> None:
        """Rebuild the list with all pairs closer than `skin`."""
        core.commit_blocks(self.blocks, self.listed)
        core.clear_blocks(self.blocks)  # free memory before the new list is made
        former = _without_open_pairs(self.contacts)
        self.set_contacts(former)
        position = np.empty((len(self.moving.order), 3))
        position[self.moving.order] = self.moving.body[:, :3]
        self.set_contacts(self._list_at(position, former, skin))
        self.set_writing(with_lost_contacts(self.writing, former, self.contacts, position, self._time()))

    def advance(self, stop: int) -> int:
        """Advance to a step, or until blocks must be chosen again. Returns the code of the compiled loop."""
        while True:
            code = core.run_steps(
                self.struct, self.state.cell.dim, self.moved, None if self.by_rows else self.blocks, self.bodies,
                self.listed, self.state.cell.vectors, *self.constants, self.bonded, self.buffers, self.state.time, stop,
                self.plan.tolerance, self.residual, self.progress,
            )  # fmt: skip
            if code == core.NO_MEMORY:
                raise MemoryError
            if code != core.FULL:
                break
            events = self.writing.events
            self.set_writing(self.writing._replace(events=np.concatenate([events, np.zeros_like(events)])))
        if self.deforming:
            vectors, self.known.rate[:] = self.flow.matrix[core.VECTORS].copy(), self.flow.matrix[core.RATE]
            self.state = self.state._replace(
                cell=self.state.cell._replace(vectors=vectors, rate=self.known.rate.copy())
            )
        return code

    def find_broken(self) -> tuple[int, int]:
        """NOT_FINITE or RUNAWAY and the body concerned; otherwise DONE and −1."""
        for code, row in (
            (core.NOT_FINITE, core.find_not_finite(self.moved)),
            (core.RUNAWAY, core.find_runaway(self.moved, self.plan.dt)),
        ):
            if row >= 0:
                return code, int(self.moving.order[row])
        return core.DONE, -1

    def gather(self) -> Bodies:
        """Copy all bodies to new arrays in the state's order, and the contact memory to the contact list.

        Keep the arrays only while they are in use, to save memory.
        """
        core.commit_blocks(self.blocks, self.listed)
        here = self.known._replace(**{name: np.empty_like(self.moving.angle) for name in _MOVING_FIELDS})
        core.scatter_bodies(self.moved, here)
        return here

    def record_groups(self, here: Bodies, row: int) -> None:
        """Write one row of the series of rigid groups; the compiled loop writes all others."""
        external, force = self.plan.external, _forces_in_state_order(self.moving)
        write_groups(self.writing.groups[row], self.state, external, here, force, self._time())

    def record_bonds(self, here: Bodies, row: int) -> None:
        """Add bonds to one sample; the compiled loop writes the contributions of contacts."""
        contacts = self.contacts
        listed = contacts._replace(key=pack_keys(contacts.i, contacts.j, contacts.image), stale=True)
        state = state_after(self.state, here, listed, self._time())._replace(bonds=self.bonds)
        add_bonds(self.writing.series[row], with_neighbor_list(state, self.law), self.law)

    def finish(self, skin: float) -> State:
        """State at the last step, with a contact list of the given skin."""
        clock = self.frame.clock if self.imposed else self.pull.clock if self.pull else [self._time()]
        pull, time = self.flow.matrix[core.PULL].copy() if self.imposed else np.zeros((3, 3)), float(clock[0])
        instant, here = Instant(_forces_in_state_order(self.moving), pull, 0), self.gather()
        core.clear_blocks(self.blocks)  # free memory for the result
        vectors = self.state.cell.vectors
        del self.moving, self.moved
        gap = bond_gap(self.bonds, here.position, here.radius, vectors, skin) if self.bonds else 0.0
        if self.deforming or self.contacts.skin != skin or gap > self.contacts.gap:
            # the validity of a list is checked by displacements of grains, not by the deformation of the cell
            former = _without_open_pairs(self.contacts)
            self.set_contacts(former._replace(gap=max(gap, former.gap)))
            self.set_contacts(self._list_at(here.position, self.contacts, skin))
        contacts, before = self.contacts, self.state.contacts
        key = before.key if contacts.i is before.i else pack_keys(contacts.i, contacts.j, contacts.image)
        contacts = contacts._replace(key=key, pair=np.zeros_like(contacts.slip), roll=np.zeros_like(contacts.slip))
        core.store_reference(
            contacts, here.position, here.angle, here.radius, vectors, self.struct.angular, contacts.pair, contacts.roll
        )
        return state_after(self.state, here, contacts, time)._replace(instant=instant, bonds=self.bonds)

    def _list_at(self, position: np.ndarray, former, skin: float):
        """Contact list with a given skin at given positions, and with the memory of the former list."""
        known, former = self.known, former._replace(skin=skin)
        contacts = rebuild_list(position, known.radius, known.normal, grid_of(self.state.cell), former, self.threads)
        if contacts.count[0] < 0:
            raise TooFarApartError(TOO_FAR)
        return with_own_memory(contacts, self.law)

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
        if not contacts.stale and core.limit_displacements(self.moved, origin, 0.5 * left, room):
            return room, 0.0
        skin = state.contacts.skin
        if (
            2 * stride * (self.steps - self.step) > 4 * skin
        ):  # otherwise a larger skin does not compensate for the final rebuild
            skin = max(skin, min(8 * np.sqrt(stride * size * self.few), size))
        return self._limits(skin)[0], skin

    def _limits(self, skin: float) -> tuple[np.ndarray, float]:
        """Displacement limit of each body, (B,), and the displacement of the fastest body per step.

        With larger limits, blocks are chosen less often but contain more pairs that do not touch. The total cost is
        minimal if the limit is proportional to the square root of the speed; the factors were found by measurement.
        Fast bodies have larger limits.
        """
        dt, size, speed = self.plan.dt, 2 * float(self.state.grains.radius.mean()) * self.few, np.empty(2)
        core.speeds(self.moved, speed)
        fastest, usual = speed * dt
        base, span = np.sqrt(fastest * size), 0.0
        if not self.imposed and usual > 0:
            base, span = BASE * np.sqrt(usual * size), SPAN * np.sqrt(size / usual) * dt
        room = np.empty(len(self.moving.order))
        if self.by_rows:  # all pairs of the list are evaluated
            room[:] = 0.5 * skin
            return room, fastest
        core.displacement_limits(self.moved, base, span, 0.025 * skin, 0.25 * skin, room)
        return room, fastest


def run_steps(
    state: State, law: Law, plan: Plan, steps: int, writing: RecordBuffers, books, instant, *, rate: int, threads
):  # fmt: skip
    """Run all steps; see `run`.

    Returns the final state, the code of the compiled loop, the number of steps, the largest unbalanced force and its
    body, the buffers and the books.
    """
    current = _Run(state, law, plan, steps, writing, books, instant, rate=rate, threads=threads)
    every, stop, code, worst = writing.every, 0, core.MOVED, -1
    sampling = every if writing.groups.shape[1] or state.bonds else 0  # the loop itself writes all other samples
    while True:
        if code == core.MOVED:
            current.choose_pairs()
        code = current.advance(stop)
        broken, body = current.find_broken()
        if broken != core.DONE:
            code, worst = broken, body
            break
        if code == core.MOVED:
            continue
        step = current.step
        sampled = sampling and step % sampling == 0
        here = current.gather() if books or sampled else None
        if books:
            books = post_step(books, current.state, plan, here, current.contacts, current.bonds, step, every)
        if sampled:
            current.record_groups(here, step // every)
            if current.bonds:
                current.record_bonds(here, step // every)
        if not np.isfinite(current.residual[0]) and plan.tolerance > 0 and step % core.CHECK_EVERY == 0:
            code = core.NOT_FINITE
        if step == steps or code != core.DONE:
            break
        stop = min(steps, (step // sampling + 1) * sampling if sampling else steps)
        if plan.tolerance > 0:  # the loop fuses steps in blocks, and checks for rest only where it stops
            stop = min(stop, (step // core.CHECK_EVERY + 1) * core.CHECK_EVERY)
        stop = min(stop, (step // books.stride + 1) * books.stride) if books else stop
    residual = float(current.residual[0])
    worst = worst if worst >= 0 else int(current.residual[1])
    end = current.finish(state.contacts.skin)
    return end, code, current.step, residual, worst, current.writing, books


def _working_contacts(state: State, law: Law, here: Bodies, keyed: bool):
    """Writable copy of the contact list for a run.

    Pair vectors, angles and unused keys are left out until the run ends.
    """
    contacts = state.contacts
    columns = angular_columns(law)
    if core.store_reference(contacts, here.position, here.angle, here.radius, state.cell.vectors, columns, None, None):
        own = {name: getattr(contacts, name) for name in ("slip", "mode", "reached", "rolling")}
        contacts = contacts._replace(**{name: part.copy() for name, part in own.items() if part is not None})
    else:
        _, contacts = forces(state, law, memory=FROZEN)
    return contacts._replace(pair=_EMPTY, roll=_EMPTY, key=contacts.key[: None if keyed else 0])


def _working_bonds(state: State, here: Bodies):
    """Writable copy of the bonds for a run, with their memory committed."""
    bonds = follow_rotations(state.bonds, state.cell.dim, here, state.cell.vectors)
    return bonds._replace(intact=bonds.intact.copy(), failed=bonds.failed.copy())


def _forces_in_state_order(moving) -> np.ndarray:
    """Forces and torques at the end of a step, (B, 6), in the state's order."""
    force = np.empty_like(moving.force)
    force[moving.order] = moving.force
    return force


def _without_open_pairs(contacts):
    """Contact list without open pairs; it takes half the memory."""
    return select_rows(contacts, np.flatnonzero(contacts.mode[: contacts.count[0]] != OPEN))
