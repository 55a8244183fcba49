"""Coefficients of the time integration, and criteria for convergence and failure of a run."""

from typing import NamedTuple

import numpy as np
from numba import njit

from ..contacts.forces import Bodies, bodies
from ..control import factors_at
from ..options import INNER
from ..simd.transpose import KICK, KICK_T, RADIUS, SPIN, VELOCITY
from ..state import Control, State, groups

CHECK_EVERY = 200  # steps between checks for NaN and, with a tolerance, for rest
DONE, CONVERGED, NOT_FINITE, FULL, MOVED, RUNAWAY = range(6)  # return codes of a compiled loop over steps


class GroupMembers(NamedTuple):
    """Members of all rigid groups, group after group."""

    member: np.ndarray  # (M,)
    start: np.ndarray  # (G + 1,)


def find_members(control: Control, place: np.ndarray | None = None) -> GroupMembers:
    """Find the members of the rigid groups; `place` is the position of each body in memory."""
    found = groups(control)
    member = np.concatenate([*found, np.zeros(0, np.int64)]).astype(np.int64)
    return GroupMembers(member if place is None else place[member], np.cumsum([0, *map(len, found)]))


@njit(cache=True, fastmath=False, **INNER)
def sum_over_groups(member, start, force):
    """Replace the force on each member of a group by the sum over its members, in the order of their numbers."""
    for g in range(len(start) - 1):
        for k in range(3):
            total = 0.0
            for e in range(start[g], start[g + 1]):
                total += force[member[e], k]
            for e in range(start[g], start[g + 1]):
                force[member[e], k] = total


class Plan(NamedTuple):
    """Coefficients of a run, constant during it."""

    external: np.ndarray  # (2, B, 3) forces and torques
    drags: tuple[float, float]  # of translations and of rotations [1/time]
    mass: np.ndarray  # (N,)
    inertia: np.ndarray  # (N,)
    dt: float


@njit(cache=True, fastmath=False)  # explicit, or a function inherits fastmath from its first caller
def find_not_finite(x, angle):
    """Find the first body with a non-finite coordinate, or return −1."""
    for a in range(len(x)):
        for k in range(3):
            if not (np.isfinite(x[a, k]) and np.isfinite(angle[a, k])):
                return a
    return -1


@njit(cache=True, fastmath=False, error_model="numpy", **INNER)
def largest_unbalanced(moving, plan):
    """Largest force, torque/R or drag force on the free components of moving bodies, and the body on which it acts.

    NaN counts as largest.
    """
    body, most, worst = moving.body, 0.0, -1
    for g in range(len(body)):
        for k in range(6):
            turning = k >= 3
            kick = body[g, KICK_T] if turning else body[g, KICK]
            if moving.free[g, k] and kick > 0.0:
                rate = body[g, SPIN + k - 3] if turning else body[g, VELOCITY + k]
                drag = plan.drags[1] if turning else plan.drags[0]
                size = max(abs(moving.force[g, k]), drag * abs(rate) * 0.5 * plan.dt / kick)
                size = (size + 0.0 * moving.force[g, k] * rate) / (body[g, RADIUS] if turning else 1.0)
                if not np.isfinite(size):
                    return np.nan, moving.order[g]
                if size > most:
                    most, worst = size, moving.order[g]
    return most, worst


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
    for members in groups(control):
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
    """Components that forces can move, (B, 6) bool."""
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


@njit(cache=True, fastmath=False)
def find_runaway(velocity, radius, dt):
    """Find the first grain that moves by more than its radius in one step, or −1."""
    for a in range(len(radius)):
        square = velocity[a, 0] ** 2 + velocity[a, 1] ** 2 + velocity[a, 2] ** 2
        if radius[a] > 0.0 and not square * dt * dt <= radius[a] ** 2:
            return a
    return -1


def make_plan(state: State, drag: float, spin_drag: float, dt: float) -> Plan:
    """Drags and external loads of all bodies."""
    grains, control = state.grains, state.control
    mass = np.concatenate([grains.mass, state.walls.mass])
    external = np.zeros((2, state.n_bodies, 3))
    if control.force.any() or control.gravity.any():
        external[0] = control.force + mass[:, None] * control.gravity
    if control.torque.any():
        external[1] = control.torque
    return Plan(external, (float(drag), float(spin_drag)), grains.mass, grains.inertia, float(dt))
