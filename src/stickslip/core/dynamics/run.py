"""Velocity Verlet with optional drag."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from ..arguments import Bodies, checked, require_not_negative
from ..contacts.forces import check_materials
from ..contacts.neighbors import with_neighbor_list
from ..laws.builtin import SMOOTH, Law
from ..library import core
from ..outcome import Outcome, Status
from ..sizes import Size, require_sizes
from ..state import State
from .coefficients import driven_bodies, make_plan, matching_instant, movable, with_mark
from .driver import run_steps
from .engine import Engine, Leg
from .ledger import open_books
from .record import GROUPS, Record, allocate_buffers, columns, make_record, observables
from .timestep import check_time_step, stable_time_step

MOST_STEPS = 10**15  # of a run


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
    probes: Bodies = (),
    events: bool = False,
    ledger: bool | int = False,
    tolerance: float = 0.0,
    reference: np.ndarray | None = None,
    slip_update: str = "difference",
    threads: int | None = None,
    engine: Engine | None = None,
):
    """Velocity Verlet: m r̈ = F − m ν ṙ, I ω̇ = T − I ν' ω, for all free components of grains and walls.

    The scheme is second order in dt, even with friction. Where contacts with dashpots close or open, it is of order 3/2
    (`viscoelastic`, which start as √δ v) or first order (`velocity`, `mass_velocity`, which act in full from the first
    touch), and with slip_update="rate" first order. The given state is not
    modified. If `tolerance` > 0, the run stops early once both the largest unbalanced force (or torque/R) and the
    largest drag force are below it.

    Parameters
    ----------
    steps : int; dt : float [time]
    drag, spin_drag : float [1/time]; spin_drag defaults to drag
    every : int, number of steps between samples (0: no samples)
    probes : grains whose position and angle are sampled
    events : also record each contact that closes, opens, or first reaches the Coulomb limit since it closed
    ledger : also compute the energy ledger, updated after every step and sampled every `every` steps: see `Ledger`. A
        number of steps: updated after so many, of which `every` is a multiple; sums over steps are then coarser
    tolerance : float [force]
    reference : (N, 3) positions from which `msd` is measured [length]; default: positions at the start of the run
    slip_update : "difference": the slip rotates with the contact and follows the exact displacements of the grains, a
        closing contact counts for the fraction of the step during which it touched, dashpots use velocities at the full
        step, and the Coulomb limit is μ max(F_n, 0). "rate", as in LAMMPS `gran/*/history`, for comparison: slip
        increments are velocities at the half step times dt, projected onto the contact plane at the end of the step, a
        closing contact counts for the whole step, the limit of a built-in law is μ |F_n|, and the slip of a sliding
        contact is set so that spring and dashpot together are at the limit. "rate" is first order in dt where contacts
        rotate, close or have dashpots
    threads : int, by default one for few grains and one per core for many; results are bitwise independent of it
    engine : another program that runs the same steps: see `protocols.lammps_engine`. It knows `drag` and `every` only

    Returns
    -------
    State, Record, Outcome
        the outcome is DONE, or with `tolerance` CONVERGED or STEPS_SPENT; a run that fails stops
        at once with NOT_A_NUMBER or BLOWN_UP, with the grain, the step, the time and the largest stable time step

    Raises
    ------
    ValueError
        if dt is longer than `stable_time_step`.

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
    require_sizes([Size("a run of", steps, "time steps", "run it in parts")])
    _check_arguments(law, steps, dt, every, ledger, slip_update, threads)
    if engine is not None:
        asked = {
            "spin_drag": spin_drag is not None, "probes": np.size(probes), "events": events, "ledger": bool(ledger),
            "tolerance": tolerance, "reference": reference is not None,
        }  # fmt: skip
        leg = Leg(state, law, dt, steps, drag=drag, every=every)
        return _run_elsewhere(engine, leg, [name for name, is_asked in asked.items() if is_asked])
    every = min(every, steps + 1)
    instant = matching_instant(state, law, slip_update)
    state = with_neighbor_list(state, law)
    check_time_step(state, law, driven_bodies(state), dt)
    spin_drag = drag if spin_drag is None else spin_drag
    plan, free = make_plan(state, drag, spin_drag, dt, tolerance), movable(state)
    if tolerance > 0 and ((free[:, :3].any() and not drag > 0) or (free[:, 3:].any() and not spin_drag > 0)):
        raise ValueError("a tolerance was given without drag on every free component: add drag to reach equilibrium")
    probes = np.atleast_1d(probes)
    rows, groups = steps // every + 1 if every else 0, int(state.control.group.max(initial=-1)) + 1
    memory = 8 * rows * (columns() + 12 * groups + 6 * len(probes))
    require_sizes([Size(f"{rows} samples take", memory, "bytes", "use a larger `every`, or fewer probes or steps")])
    writing = allocate_buffers(state, steps, every, probes, events, reference)
    rate = int(slip_update == "rate")
    books = open_books(len(writing.series), int(ledger), driven_bodies(state), state, law, rate > 0) if ledger else None
    result = run_steps(state, law, plan, steps, writing, books, instant, rate=rate, threads=threads)
    end, code, done, residual, worst, writing, books = result
    end = with_mark(end, law, slip_update) if code in (core.DONE, core.CONVERGED) else end._replace(instant=None)
    finished = Status.STEPS_SPENT if tolerance > 0 else Status.DONE
    ends = {
        core.NOT_FINITE: Status.NOT_A_NUMBER, core.RUNAWAY: Status.BLOWN_UP, core.CONVERGED: Status.CONVERGED
    }  # fmt: skip
    how = ""
    if code in (core.NOT_FINITE, core.RUNAWAY):
        longest = stable_time_step(state, law)
        known = f"stable up to dt = {longest:.4g}" if np.isfinite(longest) else "without contacts"
        how = f"step {done}, time {state.time + done * dt:g}; at the start the grains were {known}"
    record = make_record(writing, done, books, end.cell)
    return end, record, Outcome(ends.get(code, finished), residual, done, worst, how)


def own_engine(threads: int | None = None) -> Engine:
    """Return `run` as an engine; it raises RuntimeError, with a one-sentence message, if a run fails."""
    return Engine(partial(_pieces, threads))


def _pieces(threads: int | None, leg: Leg) -> Iterator[tuple[State, Record]]:
    """Run a leg; see `Engine`."""
    state, done = leg.state, 0
    for step in [leg.steps] if leg.every else leg.sample_steps:
        options = {"drag": leg.drag, "spin_drag": leg.spin_drag, "every": leg.every, "threads": threads}
        if leg.detailed:
            options |= {"probes": np.arange(len(state.grains.radius)), "events": True}
        state, record, outcome = run(state, leg.law, step - done, leg.dt, **options)
        if not outcome.ok:
            raise RuntimeError(f"the run ended at time {state.time:.6g}: {outcome}")
        done = step
        yield state, record


def _run_elsewhere(engine: Engine, leg: Leg, asked: list[str]) -> tuple[State, Record, Outcome]:
    """Run a leg with another engine."""
    if asked:
        raise ValueError(f"{' and '.join(asked)} were given with another engine, which has drag and every only")
    ((end, record),) = engine.pieces(leg)
    return end, record, Outcome(Status.DONE, np.nan, leg.steps)


def take_sample(state: State, leg: Leg) -> Record:
    """Record with one sample, a state that another engine has computed during a leg."""
    return run(state, leg.law, 0, leg.dt, every=1, reference=leg.state.grains.position)[1]


def join_samples(samples: list[Record], leg: Leg) -> Record:
    """Record with the samples of several records of a leg."""
    names = (*observables(), *(f"group_{name}" for name in GROUPS), "position", "angle") if samples else ()
    each = {name: np.concatenate([getattr(record, name) for record in samples]) for name in names}
    return run(leg.state, leg.law, 0, leg.dt)[1]._replace(**each)


def check_steps(steps: int, dt: float, every: int) -> None:
    """Raise ValueError with a one-sentence message if these steps are not allowed."""
    if not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt = {dt} was given: the time step must be positive")
    if steps < 0 or every < 0:
        raise ValueError(f"steps = {steps}, every = {every} were given: neither may be negative")
    if steps > MOST_STEPS:
        raise ValueError(f"steps = {float(steps):.4g} was given: at most {MOST_STEPS:g} are allowed")
    samples = float(steps // every) if every else 0.0
    require_sizes([Size(f"every = {float(every):.4g} makes", samples, "samples", "use a larger `every`")])


def _check_arguments(
    law: Law, steps: int, dt: float, every: int, ledger: bool | int, slip_update: str, threads: int | None
) -> None:
    """Raise ValueError with a one-sentence message if an argument of `run` is not allowed."""
    check_steps(steps, dt, every)
    if ledger and not every:
        raise ValueError("ledger = True was given without samples: set every to 1 or more steps")
    if ledger < 0 or (ledger and every % ledger):
        raise ValueError(f"ledger = {ledger} and every = {every} were given: every must be a multiple of ledger")
    if slip_update not in ("difference", "rate"):
        raise ValueError(f"slip_update={slip_update!r} was given: 'difference' and 'rate' are allowed")
    if slip_update == "rate" and law.coulomb == SMOOTH:
        raise ValueError(
            "slip_update='rate' was given with smooth friction, which LAMMPS does not have: use coulomb='sharp'"
        )
    if threads is not None and threads < 1:
        raise ValueError(f"threads = {threads} was given: at least 1 is needed")
