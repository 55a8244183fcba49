"""Simulation of quasi-rigid loading: load paths, slow dynamics of the same samples, and stiffness along paths."""

from functools import partial
from pathlib import Path as Folder
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, eigvals, eigvalsh

from .... import HELD, Control, Law, State, forces
from ....control import between, spring_forces, stress_controlled
from ....kit import (
    Checkpoint,
    Report,
    Task,
    Workers,
    body_positions,
    builtin,
    checked,
    checkpoint_in,
    load_or_compute,
    result_of,
    run_realizations,
    silent,
    suitable_threads,
    within,
)
from ....measure import branch_vectors, contact_forces, touching
from ....modes import displaced, residual_vector
from ....packings import BOTTOM, LEFT, RIGHT, TOP, biaxial_box, sheared_box
from ....quasirigid import slow_dynamics, with_load, with_machine, with_travel  # fmt: skip
from ....results import SlowRun
from ...status.collapse import Collapse
from ...status.complementarity import complementarity, status_map
from ...status.events import Event, Fork
from ...status.matrices import LinearSystem, force_rates, linear_system, stiffness_matrix
from ...status.path import LoadPath, PathPoint, load_path
from ...status.status import Verdict
from ...status.system import external_force, pinned_coordinates
from ...status.uniqueness import certificate
from . import EXPERIMENT
from .scenario import QuasiScenario

MAX_POINTS = 60  # largest number of points of a path at which eigenvalues are computed
MAX_ENUMERATED = 10  # largest number of critical contacts for enumeration of all statuses
PAIR = 1e-9  # ratio of the imaginary part to the largest eigenvalue above which two eigenvalues count as a pair
# size of the random motion of `table_one`: at most CLOSED times the smallest overlap, but at least LEAST, 1e-6 of
# which is round-off
CLOSED, LEAST = 0.1, 1e-10
STRAIN = 0.01  # travel of a machine, see `Loading.strain`
COMPARED = 0.95  # fraction of the path's load within which path and dynamics are compared
BURST, ALIKE, BEFORE, ASTRAY = 30.0, 0.5, 20, 0.05  # see `collapse_load`


class Curve(NamedTuple):
    """Stress-strain curve of T points, in quantities that are usual in engineering."""

    load: np.ndarray  # (T,) fraction of the load
    strain: np.ndarray  # (T,) strain in the loaded direction, compression positive; or shear strain [1]
    volumetric: np.ndarray  # (T,) volumetric strain, compression positive [1]
    ratio: np.ndarray  # (T,) ratio of stresses in the loaded and the other direction; or shear stress over pressure [1]


class PathStiffness(NamedTuple):
    """Properties of the stiffness at L points of a path; eigenvalues are divided by kn."""

    load: np.ndarray  # (L,)
    critical: np.ndarray  # (L,) number of contacts at the Coulomb limit
    lowest: np.ndarray  # (L,) smallest real part of the eigenvalues of k
    symmetric: np.ndarray  # (L,) smallest eigenvalue of the symmetric part of k; if negative, Q > 0 fails for some v
    pairs: np.ndarray  # (L,) number of complex pairs of m⁻¹k
    growth_rate: np.ndarray  # (L,) growth rate of the fastest pair, 0 without pairs [1/time]
    unique: np.ndarray  # (L,) 1 if the status is unique for every load, 0 if not, −1 if unknown
    consistent: np.ndarray  # (L,) number of consistent statuses under the load, −1 with too many critical contacts
    bijective: np.ndarray  # (L,) 1 if the status map is bijective, 0 if not, −1 with too many critical contacts


class SlowDynamics(NamedTuple):
    """Run of slow dynamics, compared with the path."""

    time: float  # duration of the whole load [time]
    curve: Curve
    kinetic_energy: np.ndarray  # (T,) largest value in each load step [energy]
    error: float  # largest difference from the strain of the path, over the path's last strain


class SampleResult(NamedTuple):
    """Results of one sample."""

    seed: int
    law: Law
    path: LoadPath
    curve: Curve
    back: Curve | None  # unloading, if requested
    looks: PathStiffness
    slow: tuple[SlowDynamics, ...]
    collapse: float | None  # load at which dynamics lost stability; None if it did not, or if runs are too few
    forces: np.ndarray  # (T, C, 2) F_n and F_t of contacts that last throughout the path [force]
    pairs: np.ndarray  # (C, 2) bodies of these contacts


@result_of(EXPERIMENT)
class QuasiResult(NamedTuple):
    """Results of all samples of a scenario, and the reasons for missing ones."""

    scenario: QuasiScenario
    tested: tuple[SampleResult, ...]
    failures: tuple[str, ...]


@checked
def simulate_quasi(
    scenario: QuasiScenario, *, folder: Folder | None = None, workers: Workers = None, report: Report = silent
) -> QuasiResult:
    """Prepare the samples of a scenario, load them along a path and by slow dynamics, and analyse their stiffness.

    Parameters
    ----------
    folder : run folder, in which samples and their paths and runs are saved as soon as they finish; a killed run
        resumes from them
    workers : number of processes, one sample each, or the address of a Dask scheduler; the results do not depend on it
    report : called as report(stage, share done, text)
    """
    path = (LoadPath, PathPoint, Event, Fork, Collapse, Verdict)
    kept = checkpoint_in(folder, scenario, SampleResult, *path, Curve, PathStiffness, SlowDynamics, SlowRun)
    seeds = [scenario.seed + k for k in range(scenario.samples)]
    tasks = [
        Task(f"sample {seed}", (scenario, seed, kept and kept.of(f"sample-{seed}")), f"sample-{seed}", kept)
        for seed in seeds
    ]
    samples = run_realizations(simulate_sample, tasks, stage="path and slow dynamics", workers=workers, report=report)
    return QuasiResult(scenario, tuple(samples.successful("sample")), samples.failures)


def prepare(scenario: QuasiScenario, seed: int) -> tuple[State, Law, Control]:
    """Return a sample in equilibrium, its law, and the control at the end of the load."""
    disks, load = scenario.disks, scenario.loading
    make = biaxial_box if load.test == "biaxial" else sheared_box
    options = scenario.law.model_dump(exclude={"kind"})
    state, law = make(disks.number, pressure=disks.pressure, radius=disks.radius, seed=seed, **options)
    if load.test == "biaxial":
        wall = disks.number + (TOP if load.wall == "top" else RIGHT)
        if load.machine:
            state = with_machine(state, wall, load.machine)
            axis = 1 if load.wall == "top" else 0
            apart = state.walls.point[wall - disks.number, axis] - state.walls.point[(LEFT, BOTTOM)[axis], axis]
            return state, law, with_travel(state.control, wall, -(load.strain or STRAIN) * apart * np.eye(3)[axis])
        return state, law, with_load(state.control, wall, load.factor)
    shear = float(state.control.stress[0, 1]) - load.ratio * disks.pressure
    return state, law, stress_controlled(state.control, {"xy": shear})


def simulate_sample(
    scenario: QuasiScenario, seed: int, kept: Checkpoint | None = None, report: Report = silent
) -> SampleResult:
    """Load one sample along a path and by slow dynamics, and save each result as soon as it is finished."""
    load, slow = scenario.loading, scenario.dynamics
    kept = kept and kept.if_visible()
    name = f"sample {seed}"
    report(name, 0.0, "equilibrating")
    state, law, end = load_or_compute(kept, "prepared", partial(prepare, scenario, seed))
    drag = slow.drag if load.collapses else None
    options = {"increment": load.increment, "geometric": load.geometric, "drag": drag}
    loading = within(report, 0.0, 0.3, stage=name)
    path = load_or_compute(kept, "path", partial(load_path, state, law, end, report=loading, **options))
    curve, back = stress_strain_curve(path.states, path.load, scenario), None
    if load.unload:
        turn = load.turn * path.load[-1]
        there = between(state.control, end, turn)
        way = load_path(state, law, there, state.control, **options)
        down = [p for p in way.points if p.load >= 1]
        back = stress_strain_curve(
            [state, *(p.state for p in down)], [0, *(turn * (2 - p.load) for p in down)], scenario
        )
        back = Curve(*(values[1:] for values in back))
    first = min((event.load for event in path.collapses if not event.quiet), default=np.inf)
    smooth = Curve(*(values[curve.load <= first] for values in curve))  # up to the first collapse
    until, runs = min(1.0, (1 + slow.beyond) * path.load[-1]), []
    for k, time in enumerate(slow.times if until > 0 else ()):
        part = within(report, *(0.3 + 0.6 * n / len(slow.times) for n in (k, k + 1)), stage=name)
        follow = partial(slow_dynamics, state, law, end, time=time, until=until, drag=slow.drag, report=part)
        run = load_or_compute(kept, f"slow-{k}", follow)
        followed = stress_strain_curve([state, *run.states], np.append(0.0, run.load), scenario)
        runs.append(SlowDynamics(time, followed, run.kinetic_energy, strain_difference(smooth, followed)))
    chosen = np.unique(np.linspace(0, len(path.points) - 1, MAX_POINTS).round().astype(int))
    with suitable_threads(3 * len(state.grains.radius)):
        rows = [stiffness_at(path.points[k].state, law, state.control, end) for k in chosen]
    looks = PathStiffness(path.load[chosen], *(np.array(column) for column in zip(*rows, strict=True)))
    lasting, track = force_tracks(path)
    return SampleResult(seed, law, path, curve, back, looks, tuple(runs), collapse_load(runs, smooth), track, lasting)


def stress_strain_curve(states: list[State], load, scenario: QuasiScenario) -> Curve:
    """Stress-strain curve of states at given fractions of the load; strains are relative to the first state."""
    if scenario.loading.test == "shear":
        cells, pressure = np.array([s.cell.vectors for s in states]), scenario.disks.pressure
        shear, area = cells[:, 1, 0] / cells[:, 1, 1], cells[:, 0, 0] * cells[:, 1, 1]
        stress = np.array([s.control.stress[0, 1] for s in states])
        return Curve(np.array(load), shear - shear[0], 1 - area / area[0], (stress[0] - stress) / pressure)
    walls = np.array([s.walls.point for s in states])
    length = np.stack([walls[:, RIGHT, 0] - walls[:, LEFT, 0], walls[:, TOP, 1] - walls[:, BOTTOM, 1]], axis=1)
    n = scenario.disks.number
    pull = [s.control.force + spring_forces(s.control, body_positions(s), s.time) for s in states]
    force = np.array([[f[n + RIGHT, 0], f[n + TOP, 1]] for f in pull])
    stress, area = -force / length[:, ::-1], length.prod(axis=1)
    axis = 1 if scenario.loading.wall == "top" else 0
    strain = 1 - length[:, axis] / length[0, axis]
    return Curve(np.array(load), strain, 1 - area / area[0], stress[:, axis] / stress[:, 1 - axis])


def strain_difference(path: Curve, dynamics: Curve) -> float:
    """Largest difference in strain up to 95 % of the path's load, relative to the path's final strain."""
    near = dynamics.load <= COMPARED * path.load[-1]
    apart = dynamics.strain[near] - np.interp(dynamics.load[near], path.load, path.strain)
    return float(np.abs(apart).max(initial=0.0) / max(abs(path.strain[-1]), 1e-300))


def collapse_load(runs: list[SlowDynamics], path: Curve) -> float | None:
    """Load at which the slowest run leaves the path and moves fast by itself; None if it does not.

    In slow motion, kinetic energy scales as the square of the loading rate. A load step may begin a collapse if the
    slowest run has more than half the energy of the next faster run near that load, and more than thirty times its
    previous median. It does begin a collapse if the strain then departs from that of the path, or if the path has
    ended. After soft stretches, where dynamics lags behind, the strain returns to that of the path instead.
    """
    if len(runs) < 2:
        return None
    faster, slowest = sorted(runs, key=lambda run: run.time)[-2:]
    a, b, load = faster.kinetic_energy, slowest.kinetic_energy, slowest.curve.load[1:]
    off = np.abs(slowest.curve.strain[1:] - np.interp(load, path.load, path.strain)) / abs(path.strain[-1])
    for k in range(BEFORE, len(b)):
        alone = b[k] > BURST * np.median(b[:k]) and b[k] > ALIKE * a[max(0, k - 3) : k + 4].max()
        left = off[k:][load[k:] <= path.load[-1]]
        if alone and (not len(left) or np.median(left) > ASTRAY):
            return float(load[k])
    return None


def stiffness_at(state: State, law: Law, begin: Control, end: Control) -> tuple:
    """Return the fields of PathStiffness after `load` for one state."""
    m = linear_system(state, law)
    kept = np.setdiff1d(np.arange(len(m.free)), pinned_coordinates(m))
    k, scale = stiffness_matrix(m)[kept][:, kept].toarray(), float(law.table[0, 0, builtin.KN])
    squares = eigvals(k / m.free.mass[kept][:, None])
    rates = np.sqrt(squares.astype(complex)).imag[squares.imag > PAIR * np.abs(squares).max()]
    load = external_force(state._replace(control=end), m.free) - external_force(state._replace(control=begin), m.free)
    unique, consistent, bijective = _uniqueness(m, load)
    return (
        int(m.limit.sum()), float(eigvals(k).real.min()) / scale, eigvalsh(0.5 * (k + k.T))[0] / scale, len(rates),
        float(np.abs(rates).max(initial=0.0)), unique, consistent, bijective,
    )  # fmt: skip


def _uniqueness(m: LinearSystem, load: np.ndarray) -> tuple[int, int, int]:
    """Return the fields `unique`, `consistent` and `bijective` of PathStiffness; −1 means unknown."""
    if not m.limit.any():
        return 1, 1, 1
    try:
        problem = complementarity(m, load)
    except LinAlgError:  # a contact has just opened and released a disk
        return -1, -1, -1
    known = certificate(problem).unique
    unique = -1 if known is None else int(known)
    if len(problem.vector) > MAX_ENUMERATED:
        return unique, -1, -1
    mapped = status_map(problem)
    return unique, len(mapped.consistent), int(mapped.bijective)


def force_tracks(path: LoadPath) -> tuple[np.ndarray, np.ndarray]:
    """Bodies (C, 2) and force trajectories (T, C, 2) of the contacts that last throughout the path."""
    lasting = None
    for state in path.states:
        keys = set(state.contacts.key[touching(state)].tolist())
        lasting = keys if lasting is None else lasting & keys
    keys, track = np.array(sorted(lasting), np.int64), []
    for state in path.states:
        rows = np.searchsorted(state.contacts.key[: int(state.contacts.count[0])], keys)
        track.append(force_components(state, path.law, rows))
    contacts = path.states[0].contacts
    rows = np.searchsorted(contacts.key[: int(contacts.count[0])], keys)
    return np.stack([contacts.i[rows], contacts.j[rows]], axis=1), np.array(track)


def force_components(state: State, law: Law, rows: np.ndarray) -> np.ndarray:
    """F_n along the branch vector and F_t clockwise from it, for given rows of the contact list (C, 2) [force]."""
    normal = branch_vectors(state)[rows]
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    along = np.stack([normal[:, 1], -normal[:, 0], np.zeros(len(rows))], axis=1)
    force = contact_forces(state, law)[rows]
    return np.stack([(force * normal).sum(axis=1), (force * along).sum(axis=1)], axis=1)


def table_one(state: State, law: Law, seed: int = 0, size: float = 1e-7) -> dict[str, float]:
    """Relative errors of the four linear relations of Table I, compared with forces of the engine.

    The engine's contact forces, resultants and velocities before and after a small random motion of all bodies, which
    opens no contact, are compared with predictions from c, K, S and cᵀ.
    """
    m = linear_system(state, law)
    size = min(size, max(CLOSED * float((m.force[:, 0] / m.springs[:, 0, 0]).min()), LEAST))
    loads, _ = forces(state, law)
    outer = np.random.default_rng(seed)
    v = outer.normal(size=len(m.free)) * size
    moved = displaced(state, m.free, v)
    bare = state.control._replace(
        force=0 * state.control.force, torque=0 * state.control.torque, gravity=np.zeros(3), stress=np.zeros((3, 3))
    )
    inner = residual_vector(state._replace(control=bare), loads, m.free)
    trial = forces(moved, law, memory=HELD)[1]
    before, after = force_components(state, law, m.rows), force_components(moved._replace(contacts=trial), law, m.rows)
    relative, predicted = (m.c.T @ v).reshape(-1, 2), force_rates(m, m.limit, v)
    turned = branch_vectors(moved)[m.rows] - branch_vectors(state)[m.rows]
    normal = branch_vectors(state)[m.rows]
    closing = np.einsum("ck,ck->c", turned, normal / np.linalg.norm(normal, axis=1, keepdims=True))

    def far(got, wanted):
        return float(np.abs(got - wanted).max() / np.abs(wanted).max())

    return {
        "f = cF": far(m.c @ m.force.ravel(), inner),
        "F = -KD": far(before, m.force),
        "dD = SV dt": far(after - before, predicted),
        "V = c'v": far(relative[:, 0], closing),
    }
