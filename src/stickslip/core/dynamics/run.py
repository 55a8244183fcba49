"""Runs with velocity Verlet and optional drag: time step, engines such as LAMMPS, and `run` itself."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..arguments import Bodies, checked, knows_bonds, require_not_negative
from ..contacts.bonds import frequency_bound_of_bonds
from ..contacts.forces import Bodies as BodyArrays
from ..contacts.forces import bodies, check_materials
from ..contacts.neighbors import shifts, with_neighbor_list
from ..contacts.rolling import rolling_bound
from ..laws.builtin import SMOOTH, Law
from ..laws.compiled import law_struct
from ..library import core
from ..measure import volume
from ..progress import Outcome, Size, Status, require_sizes
from ..state import State, groups
from .cell_motion import cell_mass
from .coefficients import driven_bodies, inverse_inertia_of, make_plan, matching_instant, movable, with_mark
from .driver import run_steps
from .ledger import open_books
from .record import GROUPS, Record, allocate_buffers, columns, make_record, observables


class Wave(NamedTuple):
    """A velocity A sin(2π f (t − t₀) + φ), which LAMMPS evaluates as a formula."""

    amplitude: float  # A [length/time]
    frequency: float  # f [1/time]
    phase: float  # φ
    start: float  # t₀ [time]

    def __call__(self, time):
        """Velocity at a time."""
        return self.amplitude * np.sin(2 * np.pi * self.frequency * (time - self.start) + self.phase)


class Leg(NamedTuple):
    """Part of a run: the complete input of an engine.

    With `every` = 0, a state is returned at each of `samples` times, without a record. Otherwise only the last state is
    returned, with a record of the leg.
    """

    state: State
    law: Law
    dt: float  # [time]
    steps: int  # number of steps from the state
    samples: int = 1  # number of returned states, evenly spaced, the last one at the end
    drag: float = 0.0  # [1/time]
    spin_drag: float | None = None  # [1/time], if different from drag; not in LAMMPS
    every: int = 0  # steps between samples of the record; 0: none
    detailed: bool = False  # whether the record has contact events, and all grains at each sample; not with LAMMPS
    before: tuple[int, int] = 0, 0  # samples and steps that preceded the state, if all samples are evenly spaced
    walls: tuple[int, ...] | None = None  # number of each wall, if earlier legs had more walls
    waves: Mapping[int, Wave] = MappingProxyType({})  # courses that are waves, by column
    number: int = 0  # index in a sequence of legs
    name: str = ""  # identifiers of the leg and of the previous one, for engines that store legs in files
    after: str = ""
    skin_diameters: float = 0.1  # skin of neighbour lists in mean diameters, for engines that do not choose it
    ranks: int = 1  # number of processes, for parallel engines

    @property
    def skin(self) -> float:
        """Skin of neighbour lists [length]."""
        return self.skin_diameters * 2 * float(self.state.grains.radius.mean())

    @property
    def wall_numbers(self) -> tuple[int, ...]:
        """Number of each wall of the state among the walls of all legs."""
        return tuple(range(len(self.state.walls.mass))) if self.walls is None else self.walls

    @property
    def sample_steps(self) -> list[int]:
        """Numbers of steps after which a state is returned or a sample is recorded, including the last step."""
        if self.every:
            return [*range(self.every, self.steps, self.every), self.steps]
        past, done = self.before
        spacing = (done + self.steps) / (past + self.samples)
        return [int(k * spacing + 0.5) - done for k in range(past + 1, past + self.samples + 1)]


class Engine(NamedTuple):
    """Program that runs legs: `run` is one, LAMMPS another.

    `pieces` yields the requested states of a leg, each with a record, which is empty unless requested. Such a state may
    start another leg, even in another process. Closing the iterator ends the leg.
    """

    MADE_BY = "protocols.lammps_engine"
    pieces: Callable[[Leg], Iterator[tuple[State, Record]]]
    stops: bool = True  # whether a leg can be ended before its last step
    samples: int = 100  # largest number of samples of a leg, if a long one may be divided


MOST_STEPS = 10**15  # largest number of steps of a run


@checked
@knows_bonds
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

    The scheme is of second order in dt even with friction. Where contacts with dashpots close or open, its order is 3/2
    for `viscoelastic` damping, which starts as √δ v, and 1 for `velocity` and `mass_velocity` damping, which act in
    full from the first touch. With `slip_update="rate"`, its order is 1. The given state is not modified. If a positive
    `tolerance` is given, the run stops early once both the largest unbalanced force (or torque/R) and the largest drag
    force are below it.

    Parameters
    ----------
    steps : int; dt : float [time]
    drag, spin_drag : float [1/time]; spin_drag defaults to drag
    every : int, number of steps between samples (0: no samples)
    probes : grains whose position and angle are sampled
    events : also record each contact that closes, opens, or reaches the Coulomb limit for the first time after closing
    ledger : also compute the energy ledger, updated after every step and sampled every `every` steps: see `Ledger`.
        With a number of steps instead of True, it is updated only once in that many steps, so its sums are coarser;
        `every` must be a multiple of this number
    tolerance : float [force]
    reference : (N, 3) positions from which `msd` is measured [length]; default: positions at the start of the run
    slip_update : "difference": the slip rotates with the contact and follows the exact displacements of the grains. A
        closing contact counts for the fraction of the step during which it touched. Dashpots use velocities at the full
        step, and the Coulomb limit is μ max(F_n, 0). "rate", as in LAMMPS `gran/*/history`, for comparison: slip
        increments are velocities at the half step times dt, projected onto the contact plane at the end of the step. A
        closing contact counts for the whole step. The limit of a built-in law is μ |F_n|, and the slip of a sliding
        contact is set so that spring and dashpot together are at the limit. "rate" is first order in dt where contacts
        rotate, close or have dashpots
    threads : int, by default one for few grains and one per core for many; results are bitwise independent of it
    engine : another program that runs the same steps: see `protocols.lammps_engine`. It supports only `drag` and
        `every`

    Returns
    -------
    State, Record, Outcome
        the outcome is DONE or, with `tolerance`, CONVERGED or STEPS_SPENT; a run that fails stops at once, and its
        outcome, NOT_A_NUMBER or BLOWN_UP, names the grain, the step, the time and the largest stable time step

    Raises
    ------
    ValueError
        If dt is longer than `stable_time_step`.

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
            "tolerance": tolerance, "reference": reference is not None, "bonds": bool(state.bonds),
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
        raise ValueError(
            "tolerance requires drag on every free component, without which the state does not come to rest: add drag"
        )
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
        how = f"step {done}, time {state.time + done * dt:g}; the grains were initially {known}"
    record = make_record(writing, done, books, end.cell)
    return end, record, Outcome(ends.get(code, finished), residual, done, worst, how)


def own_engine(threads: int | None = None) -> Engine:
    """Return `run` as an engine; it raises RuntimeError if a run fails."""
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
        raise ValueError(f"another engine supports drag and every only, not {' and '.join(asked)}")
    ((end, record),) = engine.pieces(leg)
    return end, record, Outcome(Status.DONE, np.nan, leg.steps)


def take_sample(state: State, leg: Leg) -> Record:
    """Record with one sample: a state computed by another engine during a leg."""
    return run(state, leg.law, 0, leg.dt, every=1, reference=leg.state.grains.position)[1]


def join_samples(samples: list[Record], leg: Leg) -> Record:
    """Record with the samples of several records of a leg."""
    names = (*observables(), *(f"group_{name}" for name in GROUPS), "position", "angle") if samples else ()
    each = {name: np.concatenate([getattr(record, name) for record in samples]) for name in names}
    return run(leg.state, leg.law, 0, leg.dt)[1]._replace(**each)


def check_steps(steps: int, dt: float, every: int) -> None:
    """Raise ValueError if the number of steps, their length or the spacing of samples is not allowed."""
    if not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt must be positive, got {dt}")
    if steps < 0 or every < 0:
        raise ValueError(f"steps and every must not be negative, got {steps} and {every}")
    if steps > MOST_STEPS:
        raise ValueError(f"steps must be at most {MOST_STEPS:g}, got {float(steps):.4g}")
    samples = float(steps // every) if every else 0.0
    require_sizes([Size(f"every = {float(every):.4g} makes", samples, "samples", "use a larger `every`")])


def _check_arguments(
    law: Law, steps: int, dt: float, every: int, ledger: bool | int, slip_update: str, threads: int | None
) -> None:
    """Raise ValueError if an argument of `run` is not allowed."""
    check_steps(steps, dt, every)
    if ledger and not every:
        raise ValueError("ledger = True requires samples: set every to 1 or more steps")
    if ledger < 0 or (ledger and every % ledger):
        raise ValueError(f"every must be a multiple of ledger, got every = {every} and ledger = {ledger}")
    if slip_update not in ("difference", "rate"):
        raise ValueError(f"slip_update must be 'difference' or 'rate', got {slip_update!r}")
    if slip_update == "rate" and law.coulomb == SMOOTH:
        raise ValueError("slip_update='rate' requires sharp friction, as in LAMMPS: use coulomb='sharp'")
    if threads is not None and threads < 1:
        raise ValueError(f"threads must be at least 1, got {threads}")


ROUNDS = 300  # number of power iterations


def _network(state: State, law: Law, here: BodyArrays) -> tuple:
    """Contacts with their law and inertia, as arguments of core functions."""
    struct, shift = law_struct(law, members=("force", "slopes", "range")), shifts(state.contacts, state.cell.vectors)
    free, inverse = state.control.cell_free, np.zeros((3, 3))  # 1/(M ℓ²) of the free components of the cell
    if free.any():
        inverse = free / (cell_mass(state) * volume(state) ** (2 / state.cell.dim))
    return struct, state.cell.dim, here, state.contacts, shift, inverse_inertia_of(state), inverse


def _spring_bound(state: State, law: Law, here: BodyArrays) -> float:
    """Upper bound on ω² due to bonds, rolling springs, and springs from bodies or groups to load points [1/time²]."""
    total = state.control.spring.copy()
    for members in groups(state.control):
        total[members] = total[members].sum(axis=0)
    loads = float((total.max(axis=1) * here.inverse_mass).max()) if total.any() else 0.0
    if state.bonds:
        loads += frequency_bound_of_bonds(state.bonds, here, state.cell.vectors, inverse_inertia_of(state))
    return loads + rolling_bound(state, law, here, inverse_inertia_of(state))


@checked
@knows_bonds
def stable_time_step(state: State, law: Law) -> float:
    """Largest stable time step 2/ω_max of all touching contacts, sliding or not [time]; infinite without contacts.

    Springs to load points and rolling springs are included through upper bounds on their ω². Dashpots are not: where
    they act, steps must also be below 2/ν, where ν is the fastest decay rate, at most the sum of c/m over contacts.

    Velocity Verlet is unstable beyond this time step. A tenth of this limit gives the force of a contact to four
    digits. The geometric stiffness due to contact forces is ignored: the limit was up to 3 % shorter than that of the
    spectrum for sheared disks, and 0.5 % shorter for spheres (`tests/unit/test_timestep.py`).

    Examples
    --------
    >>> import stickslip as ss
    >>> pair = ss.assembly(ss.spheres([[0, 0, 0], [0.99, 0, 0]], 0.5))
    >>> round(stable_time_step(pair, ss.laws.linear(kn=1.0, kt=0.0)), 6)  # ω² = 2 k_n/m
    1.414214
    """
    check_materials(state, law)
    state = with_neighbor_list(state, law)
    here = bodies(state)
    # ω² of the contact network by power iteration on M^(−1/2) K M^(−1/2)
    start = np.sin(1.0 + 7.0 * np.arange(state.n_bodies)[:, None] + 3.1 * np.arange(6))
    scratch = np.empty_like(start), np.empty((len(state.contacts.i), 6))
    largest = core.largest_squared_frequency(*_network(state, law, here), ROUNDS, start, *scratch)
    largest += _spring_bound(state, law, here)
    return float(2 / np.sqrt(largest)) if largest > 0 else np.inf


def check_time_step(state: State, law: Law, here: BodyArrays, dt: float) -> None:
    """Raise ValueError with the largest stable time step if `dt` is above it; the list must be up to date."""
    if not (state.contacts.count[0] or state.control.spring.any() or state.bonds):
        return
    bound = _spring_bound(state, law, here)
    bound += core.frequency_bound(*_network(state, law, here), np.zeros((state.n_bodies, 2)))
    if dt * dt * bound <= 4.0:
        return
    longest = stable_time_step(state, law)
    if dt > longest:
        raise ValueError(
            f"dt = {dt:g} is unstable: with contacts this stiff, use at most {longest:.4g}, or a tenth of it for "
            "accuracy"
        )
