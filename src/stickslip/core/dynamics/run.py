"""Velocity Verlet with optional drag; steps, records and events stay in compiled code."""

from functools import cache

import numpy as np
from numba import njit

from ..arguments import checked, require_not_negative
from ..contacts.forces import Bodies, check_materials, sweep_contacts
from ..contacts.geometry import shifts
from ..contacts.interaction_range import with_rolling_memory
from ..contacts.mechanics import FREE, FROZEN
from ..contacts.neighbors import TOO_FAR, grid_of, rebuild_list, with_neighbor_list
from ..contacts.rolling import resists_rolling
from ..laws.builtin import SMOOTH, Law, damping_model, rescaling_flag
from ..laws.dispatch import Kind, as_numpy_integers
from ..options import INNER
from ..outcome import Outcome, Status
from ..state import Instant, State
from .cell_motion import needs_frame
from .coefficients import (
    CHECK_EVERY,
    CONVERGED,
    DONE,
    FULL,
    MOVED,
    NOT_FINITE,
    RUNAWAY,
    Plan,
    driven_bodies,
    find_not_finite,
    find_runaway,
    largest_unbalanced,
    make_plan,
    moved_by_forces,
    state_after,
)
from .driver import MIN_BODIES, run_blocks
from .last_forces import bodies_at_start, matching_instant, with_mark
from .ledger import open_books, post_step
from .record import RecordBuffers, allocate_buffers, make_record, with_lost_contacts, write_sample
from .timestep import check_time_step, stable_time_step


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True, **INNER)
def kick_and_drift(x, v, force, kick, keep, dt):
    """Half a kick with explicit drag, then the drift, on flat arrays so that the loop is vectorised."""
    for q in range(len(x)):
        v[q] = keep[q] * v[q] + kick[q] * force[q]
        x[q] += dt * v[q]


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True, **INNER)
def second_kick(v, force, kick, slow):
    """Second half of the kick, with implicit drag."""
    for q in range(len(v)):
        v[q] = (v[q] + kick[q] * force[q]) * slow[q]


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True, **INNER)
def any_moved(x, origin, limit):
    """Return True if a coordinate is further than `limit` from its origin, unless a NaN hides this under fast math."""
    far = 0.0
    for q in range(len(x)):
        far = max(far, abs(x[q] - origin[q]))
    return far > limit


@cache
def stepper(kind: int, coulomb: int, dim: int, viscous: int):
    """Compiled loop over time steps for one law and dimension, with or without dashpots."""
    rescaled, (kind, coulomb) = rescaling_flag(kind), as_numpy_integers(kind, coulomb)

    @njit(cache=True, fastmath=True, error_model="numpy")
    def advance(
        bodies, contacts, shift, vectors, p, plan, force, torque, time, start, steps, drifted, ended, tolerance, writing
    ):  # fmt: skip
        """Run steps `start` … `steps`. `drifted`: positions are already those of step `start`, but velocities are not.

        `ended`: velocities are also those of this step, and forces are known.
        """
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
        # dashpots use velocities at the full step, predicted from the previous forces: second order in dt
        seen = Bodies(
            x,
            angle,
            np.zeros_like(x),
            np.zeros_like(x),
            bodies.radius,
            bodies.material,
            bodies.inverse_mass,
            bodies.normal,
            bodies.rate,
        )
        ahead_v, ahead_t = seen.velocity.reshape(-1), seen.spin.reshape(-1)
        room, residual, worst = len(events), np.inf, -1
        for step in range(start, steps + 1):
            fresh, known = step == start and not drifted, step == start and ended
            if step > start:
                kick_and_drift(flat_x, flat_v, flat_f, kick, keep, dt)
                kick_and_drift(flat_angle, flat_spin, flat_t, kick_t, keep_t, dt)
                if any_moved(flat_x, origin, limit):
                    return MOVED, step, residual, worst
            if room > 0 and not known and event_count[0] + contacts.count[0] > room:
                return FULL, step, residual, worst
            if viscous:
                for q in range(len(flat_v)):
                    ahead_v[q], ahead_t[q] = flat_v[q], flat_spin[q]
                    if not fresh:
                        ahead_v[q] += kick[q] * flat_f[q]
                        ahead_t[q] += kick_t[q] * flat_t[q]
            if not known:
                for q in range(len(flat_f)):
                    flat_f[q], flat_t[q] = load[q], load_t[q]
                sweep_contacts(
                    kind, coulomb, dim, seen, contacts, shift, p, viscous, FROZEN if fresh else FREE,
                    (v, spin, 0.0 if fresh else dt), force, torque, time + step * dt, events, event_count, rescaled,
                )  # fmt: skip
            if not (fresh or known):
                second_kick(flat_v, flat_f, kick, slow)
                second_kick(flat_spin, flat_t, kick_t, slow_t)
            if every > 0 and step % every == 0:
                write_sample(
                    kind, coulomb, dim, p, step // every, bodies, contacts, shift, plan, writing, vectors,
                    time + step * dt,
                )  # fmt: skip
            if step % CHECK_EVERY == 0:
                bad = find_not_finite(x, angle)
                if bad >= 0:
                    return NOT_FINITE, step, residual, bad
                if tolerance > 0.0:
                    residual, worst = largest_unbalanced(v, spin, force, torque, plan)
                    if not np.isfinite(residual):
                        return NOT_FINITE, step, residual, worst
                    if residual <= tolerance:
                        return CONVERGED, step, residual, worst
        return DONE, steps, residual, worst

    return advance


@checked
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
    ledger: bool = False,
    tolerance: float = 0.0,
    reference: np.ndarray | None = None,
    slip_update: str = "difference",
    threads: int | None = None,
):
    """Velocity Verlet: m r̈ = F − m ν ṙ, I ω̇ = T − I ν' ω, for all free components of grains and walls.

    The scheme is second order in dt, even with friction. It is first order where contacts with dashpots that act from
    first touch (`velocity`, `mass_velocity`) close or open, and with slip_update="rate". The given state is not
    modified. If `tolerance` > 0, the run stops early once both the largest unbalanced force (or torque/R) and the
    largest drag force are below it.

    Parameters
    ----------
    steps : int; dt : float [time]
    drag, spin_drag : float [1/time]; spin_drag defaults to drag
    every : int, number of steps between samples (0: no samples)
    probes : grains whose position and angle are sampled
    events : also record each contact that closes, opens, or first reaches the Coulomb limit since it closed
    ledger : also compute the energy ledger, updated after every step and sampled every `every` steps: see `Ledger`
    tolerance : float [force]
    reference : (N, 3) positions from which `msd` is measured [length]; default: positions at the start of the run
    slip_update : "difference": the slip rotates with the contact and follows the exact displacements of the grains, a
        closing contact counts for the fraction of the step during which it touched, dashpots use velocities at the full
        step, and the Coulomb limit is μ max(F_n, 0). "rate", as in LAMMPS `gran/*/history`, for comparison: slip
        increments are velocities at the half step times dt, projected onto the contact plane at the end of the step, a
        closing contact counts for the whole step, the limit is μ |F_n|, and the slip of a sliding contact is set so
        that spring and dashpot together are at the limit. "rate" is first order in dt where contacts rotate, close or
        have dashpots
    threads : int, by default one for few grains and one per core for many; results are bitwise independent of it

    Returns
    -------
    State, Record, Outcome
        the outcome is DONE, or with `tolerance` CONVERGED or STEPS_SPENT; a run that fails stops
        at once with NOT_A_NUMBER or BLOWN_UP, with the grain, the step, the time and the largest stable time step

    Raises
    ------
    ValueError
        with a one-sentence message, if dt is longer than `stable_time_step` or an argument is not allowed.

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Eqs 6–7 and the computational protocol in its supplement.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> moving = ss.packings.perturbed(state, velocity=1e-6, seed=1)
    >>> end, record, outcome = ss.run(moving, law, steps=100, dt=0.05, every=10)
    >>> record.kinetic_energy.shape, round(end.time, 6)
    ((11,), 5.0)
    """
    check_materials(state, law)
    require_not_negative(drag=drag, spin_drag=spin_drag, tolerance=tolerance)
    steps, every, dt = int(steps), int(every), float(dt)
    _check_arguments(law, steps, dt, every, ledger, slip_update, threads)
    instant = matching_instant(state, law, slip_update)
    state = with_neighbor_list(state, law)
    check_time_step(state, law, driven_bodies(state), dt)
    grouped = bool(state.control.spring.any() or (state.control.group >= 0).any())
    only_many = slip_update == "rate" or needs_frame(state) or grouped  # not supported by the plain stepper
    if resists_rolling(law.kind) and only_many:
        raise ValueError(
            "a law with rolling resistance was given with a deforming cell, time profiles, rigid groups or springs, "
            "which do not support it: omit these or rolling_stiffness"
        )
    many = only_many or (state.n_bodies >= MIN_BODIES and not resists_rolling(law.kind))
    plan = make_plan(state, drag, drag if spin_drag is None else spin_drag, dt, bare=many and not tolerance > 0)
    if tolerance > 0 and not (plan.drag[moved_by_forces(plan.motion)] > 0).all():
        raise ValueError("a tolerance was given without drag on every free component: add drag to reach equilibrium")
    writing = allocate_buffers(state, steps, every, probes, events, reference)
    books = open_books(len(writing.series), driven_bodies(state), state, slip_update == "rate") if ledger else None
    if many:
        rate = int(slip_update == "rate")
        result = run_blocks(state, law, plan, steps, tolerance, writing, books, instant, rate=rate, threads=threads)
    else:
        result = _run_stepper(state, law, plan, steps, tolerance, writing, books, instant)
    end, code, done, residual, worst, writing, books = result
    end = with_mark(end, law, slip_update) if code in (DONE, CONVERGED) else end._replace(instant=None)
    finished = Status.STEPS_SPENT if tolerance > 0 else Status.DONE
    ends = {NOT_FINITE: Status.NOT_A_NUMBER, RUNAWAY: Status.BLOWN_UP, CONVERGED: Status.CONVERGED}
    how = ""
    if code in (NOT_FINITE, RUNAWAY):
        longest = stable_time_step(state, law)
        known = f"stable up to dt = {longest:.4g}" if np.isfinite(longest) else "without contacts"
        how = f"step {done}, time {state.time + done * dt:g}; at the start the grains were {known}"
    return end, make_record(writing, done, books), Outcome(ends.get(code, finished), residual, done, worst, how)


def _check_arguments(
    law: Law, steps: int, dt: float, every: int, ledger: bool, slip_update: str, threads: int | None
) -> None:
    """Raise ValueError with a one-sentence message if an argument of `run` is not allowed."""
    if not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt = {dt} was given: the time step must be positive")
    if steps < 0 or every < 0:
        raise ValueError(f"steps = {steps}, every = {every} were given: neither may be negative")
    if ledger and not every:
        raise ValueError("ledger = True was given without samples: set every to 1 or more steps")
    if slip_update not in ("difference", "rate"):
        raise ValueError(f"slip_update={slip_update!r} was given: 'difference' and 'rate' are allowed")
    if slip_update == "rate" and law.coulomb == SMOOTH:
        raise ValueError(
            "slip_update='rate' was given with smooth friction, which LAMMPS does not have: use coulomb='sharp'"
        )
    if slip_update == "rate" and isinstance(law.kind, Kind):
        raise ValueError(
            "slip_update='rate' was given with a user's law: use a built-in law, or slip_update='difference'"
        )
    if threads is not None and threads < 1:
        raise ValueError(f"threads = {threads} was given: at least 1 is needed")


def _run_stepper(
    state: State, law: Law, plan: Plan, steps: int, tolerance: float, writing: RecordBuffers, books, instant
):
    """Run the compiled loop, and reenter it whenever it needs a new contact list or more room for events."""
    work, contacts = bodies_at_start(state, instant), type(state.contacts)(*(a.copy() for a in state.contacts))
    force, torque = (
        np.zeros((2, state.n_bodies, 3)) if instant is None else np.stack(np.split(instant.force, 2, axis=1))
    )
    grid = grid_of(state.cell)
    advance = stepper(law.kind, law.coulomb, state.cell.dim, damping_model(law))
    known = instant is not None
    done, drifted, ended, stop = 0, known, known, 0 if books else steps
    while True:
        code, done, residual, worst = advance(
            work, contacts, shifts(contacts, state.cell.vectors), state.cell.vectors, law.table, plan, force, torque,
            state.time, done, stop, drifted, ended, tolerance, writing,
        )  # fmt: skip
        drifted, ended = True, code == DONE
        bad, away = find_not_finite(work.position, work.angle), find_runaway(work.velocity, work.radius, plan.dt)
        if bad >= 0:
            code, worst = NOT_FINITE, bad
        elif away >= 0:
            code, worst = RUNAWAY, away
        if code == FULL:
            writing = writing._replace(events=np.concatenate([writing.events, np.zeros_like(writing.events)]))
        elif code == MOVED:
            before, contacts = contacts, rebuild_list(work.position, work.radius, work.normal, grid, contacts)
            contacts = with_rolling_memory(contacts, law)
            if contacts.count[0] < 0:
                raise ValueError(TOO_FAR)
            writing = with_lost_contacts(writing, before, contacts, work.position, state.time + done * plan.dt)
        elif code in (DONE, CONVERGED) and books:
            books = post_step(books, law, state, plan, work, contacts, done, writing.every)
            stop += 1
        if code not in (FULL, MOVED) and (code != DONE or done == steps):
            break
    end = state_after(state, work, contacts, state.time + done * plan.dt)
    end = end._replace(instant=Instant(np.concatenate([force, torque], axis=1), np.zeros((3, 3)), 0))
    return end, code, done, residual, worst, writing, books
