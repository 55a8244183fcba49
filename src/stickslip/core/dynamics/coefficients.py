"""Coefficients of the time integration, and criteria for convergence and failure of a run."""

import zlib
from typing import NamedTuple

import numpy as np

from ..contacts.forces import Bodies, bodies
from ..control import factors_at
from ..laws.builtin import Law, damping_model
from ..laws.properties import resists_rolling
from ..state import Control, Instant, State, groups


class GroupMembers(NamedTuple):
    """Members of all rigid groups, group after group."""

    member: np.ndarray  # (M,)
    start: np.ndarray  # (G + 1,)


def find_members(control: Control, place: np.ndarray | None = None) -> GroupMembers:
    """Find the members of the rigid groups; `place` is the position of each body in memory."""
    rigid = groups(control)
    member = np.concatenate([*rigid, np.zeros(0, np.int64)]).astype(np.int64)
    return GroupMembers(member if place is None else place[member], np.cumsum([0, *map(len, rigid)]))


class Plan(NamedTuple):
    """Coefficients that are constant during a run."""

    external: np.ndarray  # (2, B, 3) forces and torques
    drags: tuple[float, float]  # drags of translations and of rotations [1/time]
    dt: float
    tolerance: float = 0.0  # largest unbalanced force at rest [force]


def driven_bodies(state: State) -> Bodies:
    """New arrays of all bodies, with the velocities prescribed by `Control`."""
    work, control = bodies(state), state.control
    factor = factors_at(control, state.time)
    if not control.free.all():
        rate = control.rate * factor[control.follows]
        work.velocity[:] = np.where(control.free[:, :3], work.velocity, rate[:, :3])
        work.spin[:] = np.where(control.free[:, 3:], work.spin, rate[:, 3:])
    work.rate[:] = np.where(control.cell_free, work.rate, control.cell_rate * factor[control.cell_follows])
    if state.cell.dim == 2:
        work.velocity[:, 2], work.spin[:, :2] = 0.0, 0.0
    for members in filter(len, groups(control)):
        mass = np.concatenate([state.grains.mass, state.walls.mass])[members]
        mean = mass @ work.velocity[members] / mass.sum()
        work.velocity[members] = np.where(control.free[members, :3], mean, work.velocity[members])
    return work


def state_after(state: State, work: Bodies, contacts, time: float) -> State:
    """State at the end of a run, from the run's working copy of all bodies."""
    n = len(state.grains.radius)
    grains = state.grains._replace(
        position=work.position[:n], angle=work.angle[:n], velocity=work.velocity[:n], spin=work.spin[:n]
    )
    walls = state.walls._replace(point=work.position[n:], velocity=work.velocity[n:])
    cell = state.cell._replace(rate=work.rate)
    return state._replace(grains=grains, walls=walls, cell=cell, contacts=contacts, time=time)


def movable(state: State) -> np.ndarray:
    """Components of bodies that forces can move, (B, 6) bool."""
    free, n = state.control.free.copy(), len(state.grains.radius)
    free[n:, 3:] = False
    if state.cell.dim == 2:
        free[:, 2:5] = False
    return free


def inverse_inertia_of(state: State) -> np.ndarray:
    """Inverse inertia 1/I of bodies that can rotate, zero for others, (B,) [1/(mass length²)]."""
    free = state.control.free[:, 5 if state.cell.dim == 2 else slice(3, 6)]
    n = len(state.grains.radius)
    out = np.zeros(state.n_bodies)
    out[:n] = (free[:n] if free.ndim == 1 else free[:n].any(axis=1)) / state.grains.inertia
    return out


def make_plan(state: State, drag: float, spin_drag: float, dt: float, tolerance: float = 0.0) -> Plan:
    """Drags and external loads of all bodies, and the unbalanced force below which they are at rest."""
    grains, control = state.grains, state.control
    mass = np.concatenate([grains.mass, state.walls.mass])
    external = np.zeros((2, state.n_bodies, 3))
    if control.force.any() or control.gravity.any():
        external[0] = control.force + mass[:, None] * control.gravity
    if control.torque.any():
        external[1] = control.torque
    return Plan(external, (float(drag), float(spin_drag)), float(dt), tolerance)


# ---- forces at the end of a run, stored so that the next run continues as if there had been no stop


# these fields follow from the others, or do not affect forces
_IGNORED = ("pair", "roll", "origin", "skin", "gap", "stale", "i", "j", "image")


def state_checksum(state: State, law: Law, memory: str) -> int:
    """Checksum of everything that forces depend on: all arrays of a state, the law and the mode of memory."""
    models = law[3:] if law.properties else law.damping
    out = zlib.crc32(f"{law.kind} {law.coulomb} {models} {memory} {float(state.time)!r}".encode())
    count = int(state.contacts.count[0])
    for noun in filter(None, (state.grains, state.walls, state.cell, state.contacts, state.control, state.bonds)):
        for name, array in zip(noun._fields, noun, strict=True):
            if noun is state.contacts and (name in _IGNORED or array is None):
                continue
            rows = array[:count] if noun is state.contacts and name != "count" else array
            out = zlib.crc32(_bytes(rows), out)
    return zlib.crc32(_bytes(law.table), out)


def with_mark(state: State, law: Law, memory: str) -> State:
    """State at the end of a run, with its last forces, or without them if a new run would reproduce them bit for bit.

    Without dashpots, contact forces are reproduced, but moments and forces of bonds only to round-off, as their memory
    has been committed since. The mean velocity of a rigid group is not reproduced.
    """
    if not (damping_model(law) or resists_rolling(law) or state.bonds or (state.control.group >= 0).any()):
        return state._replace(instant=None)
    return state._replace(instant=state.instant._replace(mark=state_checksum(state, law, memory)))


def matching_instant(state: State, law: Law, memory: str) -> Instant | None:
    """Forces stored by an earlier run, if they belong to this state."""
    instant = state.instant
    return instant if instant is not None and instant.mark == state_checksum(state, law, memory) else None


def bodies_at_start(state: State, instant: Instant | None) -> Bodies:
    """New arrays of all bodies, with the velocities of the previous step, or those prescribed by `Control`."""
    return driven_bodies(state) if instant is None else bodies(state)


def _bytes(values) -> np.ndarray:
    return np.ascontiguousarray(values).reshape(-1).view(np.uint8)
