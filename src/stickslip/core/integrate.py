"""Velocity Verlet with optional drag: n steps, records and events without leaving compiled code."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit

from .forces import EVENT_COLUMNS, FREE, FROZEN, bodies, check_materials, has_dashpots, sweep
from .laws import Law
from .neighbors import images, moved_too_far, rebuilt, updated
from .outcome import Outcome, Status
from .state import OPEN, SLIDE, State

SERIES = ("time", "msd", "kinetic_energy", "center_x", "center_y", "center_z", "touching", "sliding")
_DONE, _CONVERGED, _BAD, _FULL, _TOO_FAR = range(5)


class Record(NamedTuple):
    """What a run wrote down, T samples of P probed grains."""

    time: np.ndarray  # (T,) [time]
    msd: np.ndarray  # (T,) Σ|Δr|² over grains, from the reference positions [length²]
    kinetic_energy: np.ndarray  # (T,) [energy], translations and rotations of free grains
    center: np.ndarray  # (T, 3) mean position of the grains [length]
    touching: np.ndarray  # (T,) number of closed contacts
    sliding: np.ndarray  # (T,) number of contacts at Coulomb's limit
    position: np.ndarray  # (T, P, 3) of the probed grains [length]
    angle: np.ndarray  # (T, P, 3) [rad]
    events: np.ndarray  # structured: kind ("closed", "opened", "limit"), time, i, j, image, position of i


@njit(cache=True)
def _first_bad(x, angle):
    """First body with a coordinate that is not finite, or −1. Kept away from fastmath."""
    for a in range(len(x)):
        for k in range(3):
            if not (np.isfinite(x[a, k]) and np.isfinite(angle[a, k])):
                return a
    return -1


@njit(cache=True)
def _sample(row, track, bodies, contacts, mass, inertia, reference, probes, time):
    x, angle, v, spin = bodies.position, bodies.angle, bodies.velocity, bodies.spin
    n = len(mass)
    row[:] = 0.0
    row[0] = time
    for a in range(n):
        for k in range(3):
            row[1] += (x[a, k] - reference[a, k]) ** 2
            row[2] += 0.5 * mass[a] * v[a, k] ** 2 + 0.5 * inertia[a] * spin[a, k] ** 2
            row[3 + k] += x[a, k] / n
    for c in range(contacts.count[0]):
        row[6] += contacts.mode[c] != OPEN
        row[7] += contacts.mode[c] == SLIDE
    for m in range(len(probes)):
        for k in range(3):
            track[m, k] = x[probes[m], k]
            track[m, 3 + k] = angle[probes[m], k]


@cache
def stepper(kind: int, coulomb: int, dim: int):
    """Compiled loop over time steps for one law and dimension."""

    @njit(cache=True, fastmath=True, error_model="numpy")
    def advance(
        bodies,
        contacts,
        images,
        p,
        viscous,
        mass,
        inertia,
        radius_or_one,
        external,
        kick,
        drag,
        dt,
        steps,
        start,
        time,
        check_every,
        tolerance,
        every,
        reference,
        probes,
        series,
        tracks,
        events,
        event_count,
    ):
        x, angle, v, spin = bodies.position, bodies.angle, bodies.velocity, bodies.spin
        n_bodies = len(x)
        cell = images.vectors
        first_turn = 0 if dim == 3 else 2
        force, torque = np.zeros((n_bodies, 3)), np.zeros((n_bodies, 3))
        h = 0.5 * dt
        room = len(events)
        memory = FROZEN
        residual, worst = np.inf, -1
        for step in range(start, steps + 1):
            if step > start:
                if room > 0 and event_count[0] + contacts.count[0] > room:
                    return _FULL, step - 1, residual, worst, contacts
                for a in range(n_bodies):
                    for k in range(dim):
                        v[a, k] = (1.0 - h * drag[a, k]) * v[a, k] + h * kick[a, k] * force[a, k]
                        x[a, k] += dt * v[a, k]
                    for k in range(first_turn, 3):
                        spin[a, k] = (1.0 - h * drag[a, 3 + k]) * spin[a, k] + h * kick[a, 3 + k] * torque[a, k]
                        angle[a, k] += dt * spin[a, k]
                if moved_too_far(x, contacts):
                    bad = _first_bad(x, angle)
                    if bad >= 0:
                        return _BAD, step, residual, bad, contacts
                    contacts = rebuilt(x, bodies.radius, bodies.normal, images, contacts)
                    if contacts.count[0] < 0:
                        return _TOO_FAR, step, residual, worst, contacts
                memory = FREE
            for a in range(n_bodies):
                for k in range(3):
                    force[a, k] = external[a, k]
                    torque[a, k] = external[a, 3 + k]
            sweep(
                kind,
                coulomb,
                dim,
                bodies,
                contacts,
                cell,
                p,
                viscous,
                memory,
                force,
                torque,
                time + step * dt,
                events,
                event_count,
            )
            if step > start:
                for a in range(n_bodies):
                    for k in range(dim):
                        v[a, k] = (v[a, k] + h * kick[a, k] * force[a, k]) / (1.0 + h * drag[a, k])
                    for k in range(first_turn, 3):
                        spin[a, k] = (spin[a, k] + h * kick[a, 3 + k] * torque[a, k]) / (1.0 + h * drag[a, 3 + k])
            if every > 0 and step % every == 0 and (step > start or start == 0):
                row = step // every
                _sample(series[row], tracks[row], bodies, contacts, mass, inertia, reference, probes, time + step * dt)
            if check_every > 0 and step % check_every == 0:
                bad = _first_bad(x, angle)
                if bad >= 0:
                    return _BAD, step, residual, bad, contacts
                if tolerance > 0.0:
                    residual = 0.0
                    for a in range(n_bodies):
                        for k in range(6):
                            if kick[a, k] > 0.0:
                                f = force[a, k] if k < 3 else torque[a, k - 3] / radius_or_one[a]
                                speed = v[a, k] if k < 3 else spin[a, k - 3] * radius_or_one[a]
                                scale = kick[a, k] if k < 3 else kick[a, k] * radius_or_one[a] ** 2
                                size = max(abs(f), drag[a, k] * abs(speed) / scale)
                                if size > residual:
                                    residual, worst = size, a
                    if residual <= tolerance:
                        return _CONVERGED, step, residual, worst, contacts
        return _DONE, steps, residual, worst, contacts

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
        the outcome is CONVERGED, STEPS_SPENT (with `tolerance`), NOT_A_NUMBER, CONTACT_LOST, or INTERRUPTED never

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
    grains, walls, control, n = state.grains, state.walls, state.control, len(state.grains.radius)
    work = bodies(state)
    work.velocity[:] = np.where(control.free[:, :3], work.velocity, control.rate[:, :3])
    work.spin[:] = np.where(control.free[:, 3:], work.spin, control.rate[:, 3:])
    kick, damping, external = _coefficients(state, drag, drag if spin_drag is None else spin_drag)
    contacts = type(state.contacts)(*(a.copy() for a in state.contacts))
    probes = np.asarray(probes, np.int64)
    samples = steps // every + 1 if every else 0
    series, tracks = np.zeros((samples, len(SERIES))), np.zeros((samples, len(probes), 6))
    rows = np.zeros((max(1024, 8 * len(contacts.i)) if events else 0, len(EVENT_COLUMNS)))
    count = np.zeros(1, np.int64)
    grid = images(state.cell, float(grains.radius.max()), float(contacts.skin[0]))
    radius_or_one = np.where(work.radius > 0, work.radius, 1.0)
    reference = grains.position if reference is None else np.ascontiguousarray(reference, dtype=float)
    advance, start = stepper(law.kind, law.coulomb, state.cell.dim), 0
    while True:
        code, done, residual, worst, contacts = advance(
            work,
            contacts,
            grid,
            law.table,
            has_dashpots(law),
            grains.mass,
            grains.inertia,
            radius_or_one,
            external,
            kick,
            damping,
            dt,
            steps,
            start,
            state.time,
            200,
            tolerance,
            every,
            reference,
            probes,
            series,
            tracks,
            rows,
            count,
        )
        if code != _FULL:
            break
        start = done
        rows = np.concatenate([rows, np.zeros_like(rows)])
    if code == _TOO_FAR:
        raise ValueError("two touching grains are 64 or more periodic boxes apart: shift positions by whole boxes")
    if code == _DONE and _first_bad(work.position, work.angle) >= 0:
        code, worst = _BAD, _first_bad(work.position, work.angle)
    end = state._replace(
        grains=grains._replace(
            position=work.position[:n], angle=work.angle[:n], velocity=work.velocity[:n], spin=work.spin[:n]
        ),
        walls=walls._replace(point=work.position[n:], velocity=work.velocity[n:]),
        contacts=contacts,
        time=state.time + done * dt,
    )
    status = {_BAD: Status.NOT_A_NUMBER, _CONVERGED: Status.CONVERGED}.get(code, Status.STEPS_SPENT)
    kept = done // every + 1 if every else 0
    record = _record(series[:kept], tracks[:kept], rows[: count[0]])
    return end, record, Outcome(status, residual, done, worst)


def _coefficients(state: State, drag: float, spin_drag: float):
    """Inverse masses (zero where not free), drag rates and external loads, each (N + W, 6)."""
    grains, walls, control = state.grains, state.walls, state.control
    n = len(grains.radius)
    kick, damping, external = (np.zeros((state.n_bodies, 6)) for _ in range(3))
    mass = np.concatenate([grains.mass, walls.mass])
    kick[:, :3], kick[:n, 3:] = 1 / mass[:, None], 1 / grains.inertia[:, None]
    kick[~control.free] = 0.0
    if state.cell.dim == 2:
        kick[:, 2:5] = 0.0
    damping[:, :3], damping[:, 3:] = drag, spin_drag
    damping[kick == 0.0] = 0.0
    external[:, :3] = control.force + mass[:, None] * control.gravity
    external[:, 3:] = control.torque
    return kick, damping, external


_EVENT_TYPE = np.dtype(
    [("kind", "U6"), ("time", float), ("i", int), ("j", int), ("image", int, 3), ("position", float, 3)]
)
_EVENT_NAMES = np.array(["closed", "opened", "limit"])


def _record(series, tracks, rows) -> Record:
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
        tracks[..., :3],
        tracks[..., 3:],
        events,
    )
