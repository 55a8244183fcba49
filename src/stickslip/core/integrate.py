"""Velocity Verlet with optional drag: n steps, records and events without leaving compiled code."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit

from .forces import (
    EVENT_COLUMNS,
    FREE,
    FROZEN,
    OPENED,
    Bodies,
    bodies,
    check_materials,
    elastic_pair,
    has_dashpots,
    sweep,
)
from .geometry import shifts
from .laws import Law
from .neighbors import TOO_FAR, grid_of, rebuilt, updated
from .outcome import Outcome, Status
from .state import OPEN, SLIDE, State

SERIES = (
    "time", "msd", "kinetic_energy", "center_x", "center_y", "center_z", "touching", "sliding",
    *(f"virial_{a}{b}" for a in "xyz" for b in "xyz"),
)  # fmt: skip
CHECK_EVERY = 200  # steps between checks for NaN and, with a tolerance, for rest
_DONE, _CONVERGED, _BAD, _FULL, _MOVED = range(5)


class Record(NamedTuple):
    """What a run wrote down, T samples of P probed grains."""

    time: np.ndarray  # (T,) [time]
    msd: np.ndarray  # (T,) Σ|Δr|² over grains, from the reference positions [length²]
    kinetic_energy: np.ndarray  # (T,) [energy], translations and rotations of all grains
    center: np.ndarray  # (T, 3) mean position of the grains [length]
    touching: np.ndarray  # (T,) number of closed contacts
    sliding: np.ndarray  # (T,) number of contacts at Coulomb's limit
    virial: np.ndarray  # (T, 3, 3) Σ f ⊗ r over contacts between grains, elastic part [energy]; over volume: the stress
    position: np.ndarray  # (T, P, 3) of the probed grains [length]
    angle: np.ndarray  # (T, P, 3) [rad]
    events: np.ndarray  # structured: kind ("closed", "opened", "limit"), time, i, j, image, position of i


class Plan(NamedTuple):
    """What the loop multiplies with, constant during a run.

    Rows 0–2 of `motion` are for translations, 3–5 for rotations: half a step over mass (zero where not free), factor
    of explicit drag, factor of implicit drag.
    """

    motion: np.ndarray  # (6, 3B)
    drag: np.ndarray  # (B, 6) [1/time]
    external: np.ndarray  # (2, B, 3) forces and torques
    mass: np.ndarray  # (N,)
    inertia: np.ndarray  # (N,)
    lever: np.ndarray  # (B,) radius, 1 for walls
    dt: float


class Writing(NamedTuple):
    """Where the loop writes samples and events."""

    every: int
    reference: np.ndarray  # (N, 3)
    probes: np.ndarray  # (P,)
    series: np.ndarray  # (T, len(SERIES))
    tracks: np.ndarray  # (T, P, 6)
    events: np.ndarray  # (E, len(EVENT_COLUMNS))
    event_count: np.ndarray  # (1,)


@njit(cache=True, fastmath=False)  # said aloud: a function inherits fastmath from whoever compiles it first
def first_bad(x, angle):
    """First body with a coordinate that is not finite, or −1."""
    for a in range(len(x)):
        for k in range(3):
            if not (np.isfinite(x[a, k]) and np.isfinite(angle[a, k])):
                return a
    return -1


@njit(cache=True)
def _sample(kind, coulomb, dim, p, k, bodies, contacts, shift, plan, writing, time):
    """Row k of the series and of the tracks."""
    x, angle, v, spin = bodies.position, bodies.angle, bodies.velocity, bodies.spin
    row, track, n = writing.series[k], writing.tracks[k], len(plan.mass)
    row[:] = 0.0
    row[0] = time
    for a in range(n):
        for m in range(3):
            row[1] += (x[a, m] - writing.reference[a, m]) ** 2
            row[2] += 0.5 * plan.mass[a] * v[a, m] ** 2 + 0.5 * plan.inertia[a] * spin[a, m] ** 2
            row[3 + m] += x[a, m] / n
    for c in range(contacts.count[0]):
        row[6] += contacts.mode[c] != OPEN
        row[7] += contacts.mode[c] == SLIDE
        if contacts.mode[c] != OPEN and contacts.j[c] < n:
            r, f = elastic_pair(kind, coulomb, dim, p, bodies, contacts, shift, c)
            for m in range(3):
                for q in range(3):
                    row[8 + 3 * m + q] += f[m] * r[q]
    for a in range(len(writing.probes)):
        for m in range(3):
            track[a, m] = x[writing.probes[a], m]
            track[a, 3 + m] = angle[writing.probes[a], m]


@njit(cache=True, fastmath=False, error_model="numpy")
def _unbalanced(v, spin, force, torque, plan):
    """Largest of force, torque/R and drag force over the free components, NaN above all, and its body."""
    motion, drag = plan.motion, plan.drag
    residual, worst = 0.0, -1
    for a in range(len(v)):
        for k in range(6):
            turning, q = k >= 3, 3 * a + k % 3
            kick = motion[3, q] if turning else motion[0, q]
            if kick > 0.0:
                f = torque[a, k - 3] if turning else force[a, k]
                rate = spin[a, k - 3] if turning else v[a, k]
                size = abs(f) + 0.0 * rate
                if not np.isfinite(size):
                    return np.nan, a
                size = max(size, drag[a, k] * abs(rate) * 0.5 * plan.dt / kick)
                size /= plan.lever[a] if turning else 1.0
                if size > residual:
                    residual, worst = size, a
    return residual, worst


@njit(fastmath=True, error_model="numpy", forceinline=True)
def first_half(x, v, force, kick, keep, dt):
    """Half a kick with explicit drag, then the drift, on flat arrays so that it is done in vectors."""
    for q in range(len(x)):
        v[q] = keep[q] * v[q] + kick[q] * force[q]
        x[q] += dt * v[q]


@njit(fastmath=True, error_model="numpy", forceinline=True)
def second_half(v, force, kick, slow):
    """The other half of the kick, with implicit drag."""
    for q in range(len(v)):
        v[q] = (v[q] + kick[q] * force[q]) * slow[q]


@njit(fastmath=True, error_model="numpy", forceinline=True)
def moved(x, origin, limit):
    """True if some coordinate is further than `limit` from its origin, or if fastmath cannot say so because of NaN."""
    far = 0.0
    for q in range(len(x)):
        far = max(far, abs(x[q] - origin[q]))
    return far > limit


@cache
def stepper(kind: int, coulomb: int, dim: int, viscous: int):
    """Compiled loop over time steps for one law and dimension, with or without dashpots."""

    @njit(cache=True, fastmath=True, error_model="numpy")
    def advance(
        bodies, contacts, shift, p, plan, force, torque, time, start, steps, drifted, tolerance, writing
    ):  # fmt: skip
        """Steps `start` + 1 … `steps`; `drifted`: positions are those of step `start` already, velocities not yet."""
        x, angle, v, spin = bodies.position, bodies.angle, bodies.velocity, bodies.spin
        events, event_count, every, dt, motion = (
            writing.events,
            writing.event_count,
            writing.every,
            plan.dt,
            plan.motion,
        )
        flat_x, flat_v, flat_f = x.reshape(-1), v.reshape(-1), force.reshape(-1)
        flat_angle, flat_spin, flat_t = angle.reshape(-1), spin.reshape(-1), torque.reshape(-1)
        kick, keep, slow, kick_t, keep_t, slow_t = motion[0], motion[1], motion[2], motion[3], motion[4], motion[5]
        load, load_t = plan.external[0].reshape(-1), plan.external[1].reshape(-1)
        origin, limit = contacts.origin.reshape(-1), 0.5 * contacts.skin[0] / np.sqrt(dim)
        # dashpots see velocities at the full step, predicted from the forces before it: second order in dt
        seen = Bodies(x, angle, np.zeros_like(x), np.zeros_like(x), bodies.radius, bodies.material, bodies.normal)
        ahead_v, ahead_t = seen.velocity.reshape(-1), seen.spin.reshape(-1)
        room, residual, worst = len(events), np.inf, -1
        for step in range(start, steps + 1):
            fresh = step == start and not drifted
            if step > start:
                first_half(flat_x, flat_v, flat_f, kick, keep, dt)
                first_half(flat_angle, flat_spin, flat_t, kick_t, keep_t, dt)
                if moved(flat_x, origin, limit):
                    return _MOVED, step, residual, worst
            if room > 0 and event_count[0] + contacts.count[0] > room:
                return _FULL, step, residual, worst
            if viscous:
                for q in range(len(flat_v)):
                    ahead_v[q], ahead_t[q] = flat_v[q], flat_spin[q]
                    if not fresh:
                        ahead_v[q] += kick[q] * flat_f[q]
                        ahead_t[q] += kick_t[q] * flat_t[q]
            for q in range(len(flat_f)):
                flat_f[q], flat_t[q] = load[q], load_t[q]
            sweep(
                kind, coulomb, dim, seen, contacts, shift, p, viscous, FROZEN if fresh else FREE, force, torque,
                time + step * dt, events, event_count,
            )  # fmt: skip
            if not fresh:
                second_half(flat_v, flat_f, kick, slow)
                second_half(flat_spin, flat_t, kick_t, slow_t)
            if every > 0 and step % every == 0:
                _sample(kind, coulomb, dim, p, step // every, bodies, contacts, shift, plan, writing, time + step * dt)
            if step % CHECK_EVERY == 0:
                bad = first_bad(x, angle)
                if bad >= 0:
                    return _BAD, step, residual, bad
                if tolerance > 0.0:
                    residual, worst = _unbalanced(v, spin, force, torque, plan)
                    if not np.isfinite(residual):
                        return _BAD, step, residual, worst
                    if residual <= tolerance:
                        return _CONVERGED, step, residual, worst
        return _DONE, steps, residual, worst

    return advance


def run(
    state: State,
    law: Law,
    steps: int,
    dt: float,
    *,
    drag: float = 0.0,
    spin_drag: float | None = None,
    every: int = 0,
    probes=(),
    events: bool = False,
    tolerance: float = 0.0,
    reference: np.ndarray | None = None,
):
    """Velocity Verlet: m r̈ = F − m ν ṙ, I ω̇ = T − I ν' ω, for all free components of grains and walls.

    Second order in dt. The state given is not changed. Stops early when `tolerance` > 0 and both the largest unbalanced
    force (or torque/R) and the largest drag force are below it.

    Parameters
    ----------
    steps : int; dt : float [time]
    drag, spin_drag : float [1/time], the same for both if only one is given
    every : int, sample each `every` steps (0: no samples)
    probes : grains whose position and angle are sampled
    events : also record each contact that closes, opens, or first reaches Coulomb's limit since it closed
    tolerance : float [force]
    reference : (N, 3) positions from which `msd` is taken [length]; default: where the run starts

    Returns
    -------
    State, Record, Outcome
        the outcome is DONE, or with `tolerance` CONVERGED or STEPS_SPENT, or NOT_A_NUMBER with the grain

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Eqs 6–7 and the computational protocol of its supplement.
    """
    check_materials(state, law)
    if not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt = {dt} was given: the time step must be positive")
    if steps < 0 or every < 0:
        raise ValueError(f"steps = {steps}, every = {every} were given: neither may be negative")
    state = updated(state)
    plan = _plan(state, drag, drag if spin_drag is None else spin_drag, dt)
    if tolerance > 0 and not (plan.drag[_free(plan.motion)] > 0).all():
        raise ValueError("a tolerance was given without drag on every free component: rest is not reached without it")
    writing = _writing(state, steps, every, probes, events, reference)
    end, code, done, residual, worst, writing = _advanced(state, law, plan, steps, tolerance, writing)
    finished = Status.STEPS_SPENT if tolerance > 0 else Status.DONE
    status = {_BAD: Status.NOT_A_NUMBER, _CONVERGED: Status.CONVERGED}.get(code, finished)
    return end, _record(writing, done), Outcome(status, residual, done, worst)


def _advanced(state: State, law: Law, plan: Plan, steps: int, tolerance: float, writing: Writing):
    """Enter the compiled loop, again whenever it asks for a new list of contacts or for more room for events."""
    work, contacts = _moving(state), type(state.contacts)(*(a.copy() for a in state.contacts))
    force, torque = np.zeros((2, state.n_bodies, 3))
    grid = grid_of(state.cell)
    advance = stepper(law.kind, law.coulomb, state.cell.dim, has_dashpots(law))
    done, drifted = 0, False
    while True:
        code, done, residual, worst = advance(
            work, contacts, shifts(contacts, state.cell.vectors), law.table, plan, force, torque,
            state.time, done, steps, drifted, tolerance, writing,
        )  # fmt: skip
        drifted = True
        bad = first_bad(work.position, work.angle)
        if bad >= 0:
            code, worst = _BAD, bad
        if code == _FULL:
            writing = writing._replace(events=np.concatenate([writing.events, np.zeros_like(writing.events)]))
        elif code == _MOVED:
            before, contacts = contacts, rebuilt(work.position, work.radius, work.normal, grid, contacts)
            if contacts.count[0] < 0:
                raise ValueError(TOO_FAR)
            writing = _with_lost(writing, before, contacts, work.position, state.time + done * plan.dt)
        else:
            break
    n = len(state.grains.radius)
    end = state._replace(
        grains=state.grains._replace(
            position=work.position[:n], angle=work.angle[:n], velocity=work.velocity[:n], spin=work.spin[:n]
        ),
        walls=state.walls._replace(point=work.position[n:], velocity=work.velocity[n:]),
        contacts=contacts,
        time=state.time + done * plan.dt,
    )
    return end, code, done, residual, worst, writing


def _moving(state: State):
    """Fresh arrays of all bodies, with the velocities that `Control` prescribes."""
    work, control = bodies(state), state.control
    work.velocity[:] = np.where(control.free[:, :3], work.velocity, control.rate[:, :3])
    work.spin[:] = np.where(control.free[:, 3:], work.spin, control.rate[:, 3:])
    if state.cell.dim == 2:
        work.velocity[:, 2], work.spin[:, :2] = 0.0, 0.0
    return work


def _writing(state: State, steps: int, every: int, probes, events: bool, reference) -> Writing:
    n, samples = len(state.grains.radius), steps // every + 1 if every else 0
    probes = np.asarray(probes, np.int64)
    if ((probes < 0) | (probes >= n)).any():
        raise ValueError(f"probes {probes.tolist()} were given: they must be grains between 0 and {n - 1}")
    reference = state.grains.position if reference is None else np.ascontiguousarray(reference, dtype=float)
    if reference.shape != (n, 3):
        raise ValueError(f"a reference of shape {reference.shape} was given: it must be {(n, 3)}")
    room = max(1024, 8 * len(state.contacts.i)) if events else 0
    return Writing(
        every, reference, probes, np.zeros((samples, len(SERIES))), np.zeros((samples, len(probes), 6)),
        np.zeros((room, len(EVENT_COLUMNS))), np.zeros(1, np.int64),
    )  # fmt: skip


def _free(motion):
    """(B, 6) components that forces can move."""
    return np.concatenate([motion[0].reshape(-1, 3), motion[3].reshape(-1, 3)], axis=1) > 0


def _with_lost(writing: Writing, before, after, position, time) -> Writing:
    """Record as opened those contacts that left the list in one step."""
    n, count = int(before.count[0]), int(writing.event_count[0])
    lost = np.flatnonzero((before.mode[:n] != OPEN) & ~np.isin(before.key[:n], after.key[: after.count[0]]))
    if not len(lost) or not len(writing.events):
        return writing
    rows = [(OPENED, time, before.i[c], before.j[c], *before.image[c], *position[before.i[c]]) for c in lost]
    writing.event_count[0] += len(lost)
    return writing._replace(events=np.concatenate([writing.events[:count], rows, writing.events[count:]]))


def _plan(state: State, drag: float, spin_drag: float, dt: float) -> Plan:
    grains, walls, control = state.grains, state.walls, state.control
    n, half = len(grains.radius), 0.5 * dt
    kick, rate = np.zeros((2, state.n_bodies, 6))
    mass = np.concatenate([grains.mass, walls.mass])
    kick[:, :3], kick[:n, 3:] = half / mass[:, None], half / grains.inertia[:, None]
    kick[~control.free] = 0.0
    if state.cell.dim == 2:
        kick[:, 2:5] = 0.0
    rate[:, :3], rate[:, 3:] = drag, spin_drag
    rate[kick == 0.0] = 0.0
    parts = (kick, 1.0 - half * rate, 1.0 / (1.0 + half * rate))
    motion = np.stack([part[:, side].ravel() for side in (slice(0, 3), slice(3, 6)) for part in parts])
    external = np.stack([control.force + mass[:, None] * control.gravity, control.torque])
    lever = np.append(grains.radius, np.ones(len(walls.mass)))
    return Plan(motion, rate, external, grains.mass, grains.inertia, lever, float(dt))


_EVENT_TYPE = np.dtype(
    [("kind", "U6"), ("time", float), ("i", int), ("j", int), ("image", int, 3), ("position", float, 3)]
)
_EVENT_NAMES = np.array(["closed", "opened", "limit"])


def _record(writing: Writing, done: int) -> Record:
    kept = done // writing.every + 1 if writing.every else 0
    series, tracks, rows = writing.series[:kept], writing.tracks[:kept], writing.events[: writing.event_count[0]]
    events = np.zeros(len(rows), _EVENT_TYPE)
    events["kind"] = _EVENT_NAMES[rows[:, 0].astype(int)]
    events["time"], events["i"], events["j"] = rows[:, 1], rows[:, 2], rows[:, 3]
    events["image"], events["position"] = rows[:, 4:7], rows[:, 7:10]
    column = {name: series[:, k] for k, name in enumerate(SERIES)}
    return Record(
        column["time"],
        column["msd"],
        column["kinetic_energy"],
        series[:, 3:6],
        column["touching"],
        column["sliding"],
        series[:, 8:].reshape(-1, 3, 3),
        tracks[..., :3],
        tracks[..., 3:],
        events,
    )
