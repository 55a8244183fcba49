"""Many systems side by side: legs of runs are packed into a batch, run together, and unpacked.

A batch runs on a graphics processor or on the host, where the same functions give the same bits (see `batch.h`). Bodies
of a system are in memory order: single grains, with sizes mixed so that all blocks of threads have similar numbers of
contacts; then grains in rigid groups or on springs; then walls.
"""

from math import prod
from typing import NamedTuple, Protocol

import numpy as np

from ...builtin_laws import NAMES
from ..contacts.forces import check_materials, moving_masses
from ..contacts.neighbors import TOO_FAR, grid_of, rebuild_list, with_neighbor_list
from ..laws.builtin import MU, Law, damping_model
from ..laws.compiled import FORCES, law_struct
from ..laws.kinds import Kind
from ..laws.properties import angular_columns, remembers_more
from ..library import core
from ..measure import supports
from ..state import OPEN, Contacts, Instant, State, empty_contacts
from .cell_motion import needs_frame
from .coefficients import (
    Plan,
    bodies_at_start,
    find_members,
    make_plan,
    matching_instant,
    movable,
    state_after,
    state_checksum,
)
from .driver import run_steps
from .record import Record, allocate_buffers, columns, make_record
from .run import Leg, check_time_step

SKIN = 0.02  # skin of the lists, in mean diameters
WARP = 32  # array sizes are multiples of this
_HALF = 1 << core.ENTRY_IMAGE - 1
_SHIFTS = [core.ENTRY_FLAGS + core.ENTRY_IMAGE * k for k in (2, 1, 0)]
STAY = "run without a device"
_WIDTHS = {  # columns of the arrays of bodies
    "point": core.POINT_WIDTH, "motion": core.MOTION_WIDTH, "angle": 3, "origin": 3, "force": 6, "external": 6,
    "kick": 2, "heavy": 3, "normal": 3, "reference": 3, "free": 6, "material": 0, "unit": 0, "supports": 0, "loose": 0,
    "touching": 0, "spring": 6, "leads": 3, "head": 0, "next": 0,
}  # fmt: skip
_TYPES = {"free": np.bool_, "leads": np.int64} | dict.fromkeys(
    ("material", "unit", "supports", "loose", "touching", "entries", "head", "next", "arrived", "happened"), np.int32
)
_INTEGERS = "number", "periodic", "members", "entry"


class Sizes(NamedTuple):
    """Array sizes of a batch, sufficient for all of its systems."""

    slots: int
    room: int  # largest number of bodies of a system
    most: int  # largest number of entries in the list of a body
    dim: int
    groups: int
    knots: int
    courses: int
    samples: int
    least: int  # smallest number of contacts of a grain that is not a rattler
    events: int  # rows for the events of a system
    tracks: int  # bodies recorded in each sample
    table: tuple[int, ...]  # shape of the table of a law


class Device(Protocol):
    """Processor that runs a batch."""

    def allocate(self, arrays: dict[str, tuple[tuple[int, ...], type]], law: dict, sizes: Sizes) -> None:
        """Allocate arrays of zeros from their shapes and types, and set the law."""

    def write(self, name: str, place: int | tuple, values: np.ndarray) -> None:
        """Write to a part of an array."""

    def read(self, name: str, place: int | tuple) -> np.ndarray:
        """Read a part of an array."""

    def run(self, steps: int) -> np.ndarray:
        """Run each system for at most this number of steps; return the array `number`."""


class Processor:
    """The host processor, on one core, for tests only: `run` for one system after another is far faster."""

    def allocate(self, arrays, law, sizes) -> None:
        """Allocate arrays of zeros, and set the law."""
        self.arrays = {name: np.zeros(shape, kind) for name, (shape, kind) in arrays.items()}
        self.law, self.batch = core.fill("Law", law), core.fill("Batch", sizes._asdict() | self.arrays)

    def write(self, name, place, values) -> None:
        """Write to a part of an array."""
        self.arrays[name][place] = values

    def read(self, name, place) -> np.ndarray:
        """Read a part of an array."""
        return self.arrays[name][place].copy()

    def run(self, steps: int) -> np.ndarray:
        """Run each system for at most this number of steps."""
        core.run_batch(self.law, self.batch, min(steps, 50))
        return self.arrays["number"].copy()


class System(NamedTuple):
    """One leg with the data for its start."""

    leg: Leg
    state: State  # state at the start, with the forces of its last step
    order: np.ndarray  # (B,) number of each body in the state
    single: int  # number of single grains
    events: np.ndarray  # (E, EVENT) events at the start, see `RecordBuffers.events`


def run_legs(legs: list[Leg], device: Device) -> list[tuple[State, Record] | RuntimeError]:
    """Run legs side by side; return the last state and record of each, or the reason why it became unstable.

    Raises
    ------
    ValueError
        If the device cannot run a leg, or if a time step is too long.
    """
    return run_systems([prepare(leg) for leg in legs], device)


def run_systems(systems: list[System], device: Device) -> list[tuple[State, Record] | RuntimeError]:
    """Run systems side by side; see `run_legs`."""
    most = _entries(systems)
    while True:
        if most > core.MOST_ENTRIES:
            raise ValueError(f"a device supports at most {core.MOST_ENTRIES} neighbours of a grain: {STAY}")
        sizes = _sizes(systems, most)
        try:
            device.allocate(_shapes(sizes), law_struct(systems[0].leg.law, members=FORCES), sizes)
        except MemoryError:
            raise RuntimeError(
                f"{sizes.slots} systems of up to {sizes.room} bodies do not fit into the memory of the device: run "
                f"fewer at once"
            ) from None
        for slot, system in enumerate(systems):
            for name, place, values in _pack(system, slot, sizes):
                device.write(name, place, values)
        number, events = _run(device, max(system.leg.steps for system in systems), sizes)
        if not (number[:, core.SLOT_PHASE] == core.CROWDED).any():
            return [_unpack(system, slot, device, number[slot], events[slot]) for slot, system in enumerate(systems)]
        most = min(2 * most, max(most + 1, core.MOST_ENTRIES))


def _run(device: Device, wanted: int, sizes: Sizes) -> tuple[np.ndarray, list[np.ndarray]]:
    """Run all systems until each has ended or a list is too short; return `number` and the events of every system."""
    events = [[] for _ in range(sizes.slots)]
    while True:
        number = device.run(wanted + 1)
        phase = number[:, core.SLOT_PHASE]
        ended = np.isin(phase, (core.FINISHED, core.BROKE, core.APART))
        crowded = (phase == core.CROWDED).any()
        for slot in np.flatnonzero(ended if ended.all() else phase == core.WAITING) if sizes.events else ():
            count = int(device.read("happened", slice(slot, slot + 1))[0])
            events[slot].append(device.read("event", (slot, slice(count))))
            device.write("happened", slice(slot, slot + 1), [0])
        for slot in np.flatnonzero(phase == core.WAITING):
            device.write("number", (slot, slice(core.SLOT_PHASE, core.SLOT_PHASE + 1)), [core.RUNNING])
        if ended.all() or crowded:
            return number, [np.concatenate([np.zeros((0, core.EVENT)), *rows]) for rows in events]
        wanted = int((number[:, core.SLOT_STOP] - number[:, core.SLOT_STEP])[~ended].max())


def check_law(law: Law) -> None:
    """Raise ValueError if a device cannot evaluate a law."""
    own = isinstance(law.kind, Kind) or law_struct(law, members=FORCES)["force"] is not None
    if own or remembers_more(law) or angular_columns(law):
        name = "a user-defined law" if isinstance(law.kind, Kind) else NAMES[law.kind]
        more = "" if own else " with other lever arms, a memory of forces, rolling or twisting resistance"
        raise ValueError(
            f"a device does not support {name}{more}; it supports linear and Hertz springs with friction and "
            f"dashpots, lever arms R and no rolling resistance: use one of these, or {STAY}"
        )


def check_leg(leg: Leg) -> None:
    """Raise ValueError if a device cannot run a leg."""
    state = leg.state
    check_materials(state, leg.law)
    check_law(leg.law)
    if state.bonds:
        raise ValueError(f"a device does not support bonds: {STAY}")
    if (state.control.group[len(state.grains.radius) :] >= 0).any():
        raise ValueError(f"a device does not support walls in a rigid group: {STAY}")
    if (groups := int(state.control.group.max(initial=-1)) + 1) > core.SUMS // 3:
        raise ValueError(f"a device supports at most {core.SUMS // 3} rigid groups, got {groups}: {STAY}")
    if needs_frame(state):
        raise ValueError(f"a device supports neither cells that deform nor rates with a time profile: {STAY}")
    if state.control.free[len(state.grains.radius) :, :3].any():
        raise ValueError(f"a device moves walls at prescribed rates only, not under loads: {STAY}")
    if leg.samples > 1 and not leg.every:
        raise ValueError(f"a device returns the last state only, not {leg.samples} states: {STAY}")
    height, reach = grid_of(state.cell).height, 2 * float(state.grains.radius.max(initial=0.0)) + _skin(state)
    if (narrow := height[state.cell.periodic & (np.arange(3) < state.cell.dim)]).size and narrow.min() < 2 * reach:
        raise ValueError(
            f"the periodic cell is {narrow.min():.4g} across, but a device needs twice the largest diameter plus the "
            f"skin, {2 * reach:.4g}: use a larger cell, or {STAY}"
        )


def _skin(state: State) -> float:
    """Skin of the lists of a system [length]."""
    return SKIN * 2 * float(state.grains.radius.mean())


def prepare(leg: Leg) -> System:
    """Evaluate the forces at the start of a leg, unless the state contains them, and choose the order of its bodies."""
    check_leg(leg)
    state, law = leg.state, leg.law
    plan, instant = _plan(leg), matching_instant(state, law, "difference")
    state, events = with_neighbor_list(state, law), np.zeros((0, core.EVENT))
    if instant is None:
        nothing = allocate_buffers(state, 0, 0, (), leg.detailed, None)
        state, *_, writing, _ = run_steps(state, law, plan, 0, nothing, None, None, rate=0, threads=1)
        events = writing.events[: writing.event_count[0]]
    here = bodies_at_start(state, state.instant)
    check_time_step(state, law, here, leg.dt)
    control, n = state.control, len(state.grains.radius)
    special = ((control.group >= 0) | control.spring.any(axis=1))[:n]
    single, rest = np.flatnonzero(~special), np.flatnonzero(special)
    single = single[np.argsort(-state.grains.radius[single], kind="stable")]
    single = np.concatenate([single[k :: len(single) // WARP + 1] for k in range(len(single) // WARP + 1)])
    rest = rest[np.argsort(control.group[rest] % (control.group.max(initial=0) + 2), kind="stable")]  # no group: last
    return System(leg, state, np.concatenate([single, rest, np.arange(n, state.n_bodies)]), len(single), events)


def _plan(leg: Leg) -> Plan:
    """Coefficients of the motion of the bodies in a leg."""
    return make_plan(leg.state, leg.drag, leg.drag if leg.spin_drag is None else leg.spin_drag, leg.dt)


def _entries(systems: list[System]) -> int:
    """Number of entries reserved for the list of a body: 1.5 times the longest initial list, up to the limit."""
    listed = touching = 0
    for system in systems:
        contacts, n = system.state.contacts, len(system.state.grains.radius)
        rows = np.arange(contacts.count[0])
        listed = max(listed, _longest(contacts, rows, n))
        touching = max(touching, _longest(contacts, rows[contacts.mode[rows] != OPEN], n))
    return max(touching, min(8 * (int(1.5 * listed) // 8 + 1), core.MOST_ENTRIES))


def _longest(contacts: Contacts, rows: np.ndarray, grains: int) -> int:
    """Largest number of pairs of a grain."""
    pairs = np.concatenate([contacts.i[rows], contacts.j[rows]])
    return int(np.bincount(pairs, minlength=1)[:grains].max(initial=0))


def _sizes(systems: list[System], most: int) -> Sizes:
    """Array sizes that suffice for all systems."""
    states, legs = [system.state for system in systems], [system.leg for system in systems]
    law, dim = legs[0].law, states[0].cell.dim
    if any(s.cell.dim != dim for s in states) or any(_law_form(law) != _law_form(leg.law) for leg in legs):
        raise ValueError(
            "the systems in a batch must have the same dimension and law: run the others in separate batches"
        )
    room = -(-max(state.n_bodies for state in states) // WARP) * WARP
    detailed = any(leg.detailed for leg in legs)
    return Sizes(
        len(systems), room, most, dim,
        max(int(state.control.group.max(initial=-1)) + 1 for state in states),
        max(1, *(len(state.control.knots) for state in states)),
        max(1, *(state.control.course.shape[1] for state in states)),
        max(leg.steps // leg.every + 1 if leg.every else 0 for leg in legs),
        2 if _has_friction(law) else dim + 1, 6 * room * most if detailed else 0, room if detailed else 0,
        law.table.shape,
    )  # fmt: skip


def _law_form(law: Law) -> tuple:
    """Properties that all laws of one batch share."""
    return law.kind, law.coulomb, damping_model(law), law.properties, law.table.shape, _has_friction(law)


def _has_friction(law: Law) -> bool:
    return bool((law.table[..., MU] > 0).any())


def _shapes(sizes: Sizes) -> dict[str, tuple[tuple[int, ...], type]]:
    """Shape and type of every array of a batch."""
    s, r, t, g = sizes.slots, sizes.room, sizes.samples, sizes.groups
    shapes = {name: (s, r, width) if width else (s, r) for name, width in _WIDTHS.items()}
    shapes |= {"point": (2, *shapes["point"]), "motion": (2, *shapes["motion"])}
    shapes |= {
        "number": (s, core.SLOT_NUMBERS), "value": (s, core.PACE_VALUES), "vectors": (s, 3, 3), "inverse": (s, 3, 3),
        "periodic": (s, 3), "table": (s, *sizes.table), "members": (s, g + 1), "knot": (s, sizes.knots),
        "course": (s, sizes.knots, sizes.courses), "entry": (2, s, r, sizes.most), "slip": (2, 3, s, r, sizes.most),
        "entries": (2, s, r), "arrived": (s,),
        "partial": (s, core.TEAM, core.SUMS), "series": (s, t, columns()),
        "group": (s, t, g, 4, 3), "track": (s, t, sizes.tracks, 6), "event": (s, sizes.events, core.EVENT),
        "happened": (s,),
    }  # fmt: skip
    return {
        name: (shape, _TYPES.get(name, np.int64 if name in _INTEGERS else np.float64)) for name, shape in shapes.items()
    }


def _pack(system: System, slot: int, sizes: Sizes):
    """Yield name, position and values of every nonzero part of a system."""
    leg, state, order, single, _ = system
    control, here, n = state.control, bodies_at_start(state, state.instant), len(state.grains.radius)
    plan, place = _plan(leg), np.argsort(order)
    body, grains = (slot, slice(len(order))), (slot, slice(n))
    inertia = np.append(state.grains.inertia, np.ones(len(order) - n))
    unit, number = supports(state)
    still = np.zeros((len(order), 6))
    yield "point", (0, *body), np.column_stack([here.position, here.radius])[order]
    yield "motion", (0, *body), np.column_stack([here.velocity, here.spin, still])[order]
    yield "angle", body, here.angle[order]
    yield "origin", body, here.position[order]
    yield "force", body, state.instant.force[order]
    yield "external", body, np.concatenate(plan.external, axis=1)[order]
    yield "kick", body, 0.5 * leg.dt / np.column_stack([moving_masses(state), inertia])[order]
    yield "heavy", grains, np.column_stack([here.inverse_mass[:n], state.grains.mass, state.grains.inertia])[order[:n]]
    yield "heavy", (slot, slice(n, len(order)), 0), here.inverse_mass[n:]
    yield "normal", (slot, slice(n, len(order))), here.normal
    yield "reference", grains, state.grains.position[order[:n]]
    yield "free", body, movable(state)[order]
    yield "material", body, here.material[order]
    yield "unit", body, place[unit[order]]
    yield "supports", body, number[order]
    yield "spring", body, np.column_stack([control.spring, control.anchor])[order]
    yield "leads", body, control.leads[order]
    yield from _pack_loads(state, single, slot, sizes)
    yield from _pack_contacts(state, place, slot, sizes)
    yield from _pack_numbers(system, slot, sizes)


def _pack_loads(state: State, single: int, slot: int, sizes: Sizes):
    """Yield the bounds of rigid groups, the time profiles and the cell."""
    control, grid = state.control, grid_of(state.cell)
    start = single + find_members(control).start
    yield "members", slot, np.append(start, np.full(sizes.groups + 1 - len(start), start[-1]))
    knots, courses = len(control.knots), control.course.shape[1]
    if knots and courses:
        knot, course = np.full(sizes.knots, np.inf), np.zeros((sizes.knots, sizes.courses))
        knot[:knots], course[:knots, :courses] = control.knots, control.course
        yield "knot", slot, knot
        yield "course", slot, course
    yield "vectors", slot, state.cell.vectors
    yield "inverse", slot, grid.inverse
    yield "periodic", slot, grid.periodic & (np.arange(3) < state.cell.dim)


def _pack_contacts(state: State, place: np.ndarray, slot: int, sizes: Sizes):
    """Yield the lists of all bodies, which contain the closed contacts."""
    contacts, n = state.contacts, len(state.grains.radius)
    rows = np.flatnonzero(contacts.mode[: contacts.count[0]] != OPEN)
    grains = rows[contacts.j[rows] < n]  # a wall has no list
    body = place[np.concatenate([contacts.i[rows], contacts.j[grains]])]
    partner = place[np.concatenate([contacts.j[rows], contacts.i[grains]])]
    image = np.concatenate([contacts.image[rows], -contacts.image[grains]]).astype(int) + _HALF
    slip = np.concatenate([contacts.slip[rows], -contacts.slip[grains]])
    flags = contacts.mode.astype(int) | contacts.reached.astype(int) << 2
    word = partner << core.ENTRY_PARTNER | np.concatenate([flags[rows], flags[grains]])
    for k in range(3):
        word |= image[:, k] << _SHIFTS[k]
    first = np.lexsort([word, body])
    many = np.bincount(body, minlength=sizes.room)
    column = np.arange(len(body)) - np.repeat(np.cumsum(many) - many, many)
    entry, slips = np.zeros((sizes.room, sizes.most), np.int64), np.zeros((3, sizes.room, sizes.most))
    entry[body[first], column], slips[:, body[first], column] = word[first], slip[first].T
    yield "entry", (0, slot), entry
    yield "slip", (0, slice(None), slot), slips
    yield "entries", (0, slot), many


def _pack_numbers(system: System, slot: int, sizes: Sizes):
    """Yield the counters of a system and its coefficients of motion."""
    leg, state, order, single, _ = system
    n, skin, grid = len(state.grains.radius), _skin(state), grid_of(state.cell)
    reach, dim = 2 * float(state.grains.radius.max(initial=0.0)) + skin, state.cell.dim
    part = state.grains.position @ grid.inverse
    low = np.where(grid.periodic, 0.0, part.min(axis=0, initial=np.inf))
    high = np.where(grid.periodic, 1.0, part.max(axis=0, initial=-np.inf))
    bins = np.clip((high - low) * grid.height / reach, 1, [1e6] * dim + [1] * (3 - dim)).astype(int)
    while prod(bins) > sizes.room:
        bins[bins.argmax()] = max(1, bins.max() // 2)
    number, value = np.zeros(core.SLOT_NUMBERS, np.int64), np.zeros(core.PACE_VALUES)
    number[core.SLOT_PHASE], number[core.SLOT_MOVED_FAR] = core.SAMPLING, 1
    number[core.SLOT_STOP], number[core.SLOT_EVERY] = leg.steps, leg.every
    number[core.SLOT_BODIES], number[core.SLOT_GRAINS], number[core.SLOT_SINGLE] = len(order), n, single
    number[core.SLOT_BINS : core.SLOT_BINS + 3] = bins
    half, turn = (0.5 * leg.dt * drag for drag in _plan(leg).drags)
    value[: core.PACE_LOWEST] = leg.dt, 1 - half, 1 / (1 + half), 1 - turn, 1 / (1 + turn), skin, *(state.time,) * 2
    value[core.PACE_LOWEST : core.PACE_DENSITY] = low
    value[core.PACE_DENSITY :] = bins / np.where(high > low, high - low, 1.0)
    yield "number", slot, number
    yield "value", slot, value
    yield "table", slot, law_struct(leg.law, members=FORCES)["table"]


def _unpack(
    system: System, slot: int, device: Device, number: np.ndarray, events: np.ndarray
) -> tuple[State, Record] | RuntimeError:
    """Last state and record of a system, or the reason why it became unstable."""
    leg, state, order, *_ = system
    ended = f"the run ended at time {state.time + number[core.SLOT_STEP] * leg.dt:.6g}"
    if number[core.SLOT_PHASE] == core.APART:
        return RuntimeError(f"{ended}: {TOO_FAR}")
    now, b = int(number[core.SLOT_NOW]), len(order)

    def read(name: str, *place) -> np.ndarray:
        out = np.empty((b, _WIDTHS[name]))
        out[order] = device.read(name, (*place, slot))[:b]
        return out

    motion, here = read("motion", now), bodies_at_start(state, state.instant)
    if number[core.SLOT_PHASE] == core.BROKE:
        far = np.linalg.norm(motion[:, : state.cell.dim], axis=1) * leg.dt
        grain = int(np.argmin(far <= here.radius))  # the first one that moved farther, or to NaN; walls come last
        return RuntimeError(f"{ended}: grain {grain} moved by more than its radius in a step")
    here = here._replace(
        position=np.ascontiguousarray(read("point", now)[:, :3]), angle=read("angle"),
        velocity=np.ascontiguousarray(motion[:, :3]), spin=np.ascontiguousarray(motion[:, 3:6]),
    )  # fmt: skip
    contacts = _unpack_contacts(system, slot, device, int(number[core.SLOT_LISTED]))
    contacts = rebuild_list(here.position, here.radius, here.normal, grid_of(state.cell), contacts)
    if contacts.count[0] < 0:
        return RuntimeError(f"{ended}: {TOO_FAR}")
    core.store_reference(
        contacts, here.position, here.angle, here.radius, state.cell.vectors, 0, contacts.pair, contacts.roll
    )
    sprung = state.control.spring.any()
    time = float(device.read("value", slot)[core.PACE_CLOCK]) if sprung else state.time + leg.steps * leg.dt
    end = state_after(state, here, contacts, time)
    instant = Instant(read("force"), np.zeros((3, 3)), state_checksum(end, leg.law, "difference"))
    grains = np.arange(len(state.grains.radius))
    writing = allocate_buffers(state, leg.steps, leg.every, grains if leg.detailed else (), False, None)
    samples, groups = len(writing.series), writing.groups.shape[1]
    series, motion = device.read("series", (slot, slice(samples))), device.read("group", (slot, slice(samples)))
    writing = writing._replace(series=series, groups=motion[:, :groups])
    if leg.detailed:
        writing.tracks[:, order[grains]] = device.read("track", (slot, slice(samples), slice(len(grains))))
        events = np.concatenate([system.events, _unpack_events(events, order)])
        writing = writing._replace(events=events, event_count=np.array([len(events)]))
    return end._replace(instant=instant), make_record(writing, leg.steps, None, end.cell)


def _unpack_events(events: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Events in chronological order, without duplicates."""
    out = events.copy()
    out[:, 2], out[:, 3] = order[events[:, 2].astype(int)], order[events[:, 3].astype(int)]
    out = out[_is_first(out[:, 2], out[:, 3], out[:, 4:7])]
    return out[np.lexsort([out[:, 0], *out[:, 6:3:-1].T, out[:, 3], out[:, 2], out[:, 1]])]


def _is_first(i: np.ndarray, j: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Mask of the list entries of a contact's first body; each contact is listed for both of its bodies."""
    forward = (image > 0) @ [4, 2, 1] > (image < 0) @ [4, 2, 1]  # contact of a grain with its own image
    return (i < j) | ((i == j) & forward)


def _unpack_contacts(system: System, slot: int, device: Device, held: int) -> Contacts:
    """Closed contacts of a system, without duplicates."""
    order, old = system.order, system.state.contacts
    many, entry = device.read("entries", (held, slot)), device.read("entry", (held, slot))
    row, column = np.nonzero((np.arange(entry.shape[1]) < many[:, None]) & (entry & 3 != OPEN))
    word = entry[row, column]
    i, j = order[row], order[word >> core.ENTRY_PARTNER]
    image = np.stack([(word >> shift & 2 * _HALF - 1) - _HALF for shift in _SHIFTS], axis=1)
    mine = np.flatnonzero(_is_first(i, j, image))
    slip = device.read("slip", (held, slice(None), slot))[:, row[mine], column[mine]].T
    out = empty_contacts(len(order), len(mine), old.skin)
    return out._replace(
        i=i[mine].astype(np.int32), j=j[mine].astype(np.int32), image=image[mine].astype(np.int16),
        slip=np.ascontiguousarray(slip), mode=(word[mine] & 3).astype(np.int8), reached=(word[mine] & 4) > 0,
        gap=old.gap, count=np.array([len(mine)]),
    )  # fmt: skip
