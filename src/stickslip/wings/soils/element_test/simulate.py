"""Simulation of element tests: samples are compressed, then loaded along a path, quasi-statically or at a rate."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import FROZEN, SLIDE, Law, NotInEquilibriumError, State, forces, run
from ....control import strained_at
from ....kit import (
    SETTLING_DRAG,
    Checkpoint,
    Engine,
    Fields,
    Report,
    Scales,
    Task,
    Workers,
    checked,
    checkpoint_in,
    compression_scales,
    least_supports,
    load_or_compute,
    make_law,
    readable,
    result_of,
    run_realizations,
    servo_mass,
    settle,
    silent,
    stopped,
    within,
)
from ....measure import (
    contact_forces,
    coordination,
    fabric,
    overlaps,
    packing_fraction,
    stress,
    touching,
    unbalanced_forces,
)
from ....modes import elastic_moduli
from ....packings import strained
from ....protocols import Envelope
from ....results import Factorisation, Localisation, PackingInfo
from ...lammps.run import lammps_engine
from . import EXPERIMENT
from .sample import (
    BALANCED,
    Breaks,
    Cemented,
    Drive,
    ProbedState,
    check_pressures,
    controlled,
    depends_on_stress,
    describe_break,
    drive_of,
    fluid_pressure,
    has_failed,
    join,
    make_sample,
    plane_of,
    probe,
    strain_of,
    unloaded,
    wanted_stress,
    with_cement,
    without_answer,
)  # fmt: skip
from .scenario import FIRST, GROWTH, LOG_STEP, ElementTestScenario

FOLLOWED = 1e-6  # largest deviation of a stress coupled to another stress, over the pressure
SEALED = 1e-7  # largest deviation of the total stress (grains and pore fluid), over that of the cell
FOLLOWS = 30  # largest number of corrections of these stresses per step
BLOCK = 100  # time steps between two corrections of the controlled stresses
GAINS = 0.5, 0.2  # proportional and integral gain per block in the control of a total stress
LAG = 0.01  # change of the total stress per block, over the pressure, for a sample that does not yield
PRESSURE_RATE = 100.0  # rate of ln p of a dynamic isotropic path over the strain rate of other paths
MODULI_UP_TO = 5000  # largest number of grains for which elastic moduli are computed
FURTHER, FURTHER_BY = 10, 0.1  # steps after damped dynamics, and their strain over (mean overlap)/(diameter)
SAVE_EVERY = 20.0  # time between two saved pieces of an unfinished path [s]


@readable
class ElementSeries(NamedTuple):
    """Series of T equilibria, or of T instants of a test at a finite rate; compression is positive."""

    load: np.ndarray  # (T,) imposed strain, or ln p of an isotropic path
    strain: np.ndarray  # (T, 4) logarithmic ε_xx, ε_yy, ε_zz, and the shear strain γ along x with gradient y
    stress: np.ndarray  # (T, 3, 3) [force/length^(dim−1)]
    void_ratio: np.ndarray  # (T,) volume of the voids over that of the grains [1]
    coordination: np.ndarray  # (T,) mean contact number without rattlers [1]
    fabric_anisotropy: np.ndarray  # (T,) largest minus smallest principal value of the fabric [1]
    sliding_fraction: np.ndarray  # (T,) fraction of contacts at the Coulomb limit [1]
    unbalanced: np.ndarray  # (T,) mean unbalanced force over mean contact force [1]
    rearranged: np.ndarray  # (T,) bool, True if dynamics was needed to find the equilibrium


class SmallStrain(NamedTuple):
    """Elastic moduli of a sample before its path; NaN if not computed."""

    shear: float  # G [force/length^(dim−1)]
    bulk: float  # K [force/length^(dim−1)]
    young: float  # E [force/length^(dim−1)]
    poisson: float  # ν [1]


class ElementRun(NamedTuple):
    """Test of one sample."""

    seed: int
    packed: PackingInfo
    elastic: SmallStrain
    series: ElementSeries
    end: State
    ended: str  # reason for an early end of the path, or an empty string
    probes: tuple[ProbedState, ...] = ()  # probes of the first sample, if the scenario requests them
    breaks: Breaks | None = None  # broken bonds of a cemented sample


class Piece(NamedTuple):
    """Part of a path since the previous saved piece, and the state from which it continues."""

    rows: dict[str, np.ndarray]
    state: State
    breaks: Breaks


Steps = Iterator[tuple[State, float, bool]]  # state, load, and True if dynamics was needed
SAVED = (  # classes of saved results
    ElementRun, PackingInfo, SmallStrain, Piece, ProbedState, Envelope, Localisation, Breaks, Cemented,
)  # fmt: skip


class Rig(NamedTuple):
    """Sample with its law and the control of its load."""

    scenario: ElementTestScenario
    law: Law
    start: State  # the isotropic sample, cemented if the scenario requires it
    drive: Drive
    tolerance: float  # largest unbalanced force of an equilibrium [force]
    keep: Factorisation
    engine: Engine | None  # engine of a dynamic test; None: `run`
    probed: frozenset[int] = frozenset()  # indices of the loads at which the sample is probed
    breaks: Breaks | None = None  # broken bonds of a cemented sample before its path

    @property
    def dim(self) -> int:
        """Number of dimensions."""
        return self.start.cell.dim

    def scales(self, pressure: float) -> Scales:
        """Scales of the sample under a pressure."""
        return compression_scales(self.start, self.law, pressure, self.tolerance)

    def missing_stress(self, state: State, total: float) -> np.ndarray:
        """Total stress of the cell minus that of a state and its fluid, along the strains `Drive.sealed` (K,)."""
        e, start = (1 / packing_fraction(each) - 1 for each in (state, self.start))
        fluid = fluid_pressure(e, start, self.scenario.path.fluid_modulus)
        return self.drive.sealed @ (total - fluid - np.diag(stress(state, self.law)))

    def sealed_stiffness(self, scales: Scales, pressure: float) -> np.ndarray:
        """Stiffness (K, K) of the sample and its fluid against the strains `Drive.sealed`.

        The stiffness of the fluid, K_f/n, is exact. That of the sample is an estimate: K = p (k d/F)/dim, as if
        contacts moved with the strain, and G = K/2.
        """
        bulk = pressure * scales.stiffness / self.dim
        fluid = self.scenario.path.fluid_modulus / (1 - packing_fraction(self.start))
        stiffness = (fluid + bulk * (1 - 1 / self.dim)) + bulk * np.eye(3)
        return self.drive.sealed @ stiffness @ self.drive.sealed.T


@result_of(EXPERIMENT)
class ElementTestResult(NamedTuple):
    """Tests of all samples."""

    scenario: ElementTestScenario
    law: Law
    runs: tuple[ElementRun, ...]
    checked: ElementRun | None  # the first sample, with half the step or rate
    failures: tuple[str, ...]


@checked
def simulate_element_test(
    scenario: ElementTestScenario, *, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> ElementTestResult:
    """Load samples with the seeds seed, seed + 1, … along the path of a scenario.

    Strains are measured from the prepared sample; pressures are absolute.

    Parameters
    ----------
    folder : run folder, in which samples and parts of their paths are saved as soon as they are finished
    workers : number of processes, or the address of a Dask scheduler; the result does not depend on it
    report : called as report(stage, share done, text)

    Raises
    ------
    ScenarioError
        If the law cannot carry the pressure.
    RuntimeError
        If every sample failed.

    Examples
    --------
    >>> import stickslip as ss
    >>> short = ss.scenario(
    ...     experiment="element-test",
    ...     sample={"dim": 2, "grains": 50, "pressure": 100.0},
    ...     path={"kind": "undrained", "strain": 1e-3},
    ... )
    >>> series = simulate_element_test(short).runs[0].series
    >>> round(abs(series.strain[:, :3].sum(axis=1)).max(), 12)
    np.float64(0.0)
    """
    law, kept = make_law(scenario.law), checkpoint_in(folder, scenario, *SAVED)
    check_pressures(scenario.sample, law, kept, path=scenario.path.pressures or (), cement=scenario.cement)
    seeds = [scenario.seed + k for k in range(scenario.realizations)]
    jobs = [(seed, False) for seed in seeds] + ([(scenario.seed, True)] if scenario.check else [])
    tasks = []
    for seed, half in jobs:
        name = _name(seed, half)
        words = f"sample {seed}{' at half the step' if half else ''}"
        tasks.append(Task(words, (scenario, seed, half, kept and kept.of(name)), name, kept))
    made = run_realizations(load_sample, tasks, stage="samples", workers=workers, report=report)
    runs = tuple(made.groups(len(seeds))[0].successful("sample"))
    return ElementTestResult(scenario, law, runs, made.results[-1] if scenario.check else None, made.failures)


def _name(seed: int, half: bool) -> str:
    return f"sample-{seed}{'-half' if half else ''}"


def load_sample(
    scenario: ElementTestScenario, seed: int, half: bool, kept: Checkpoint | None, report: Report
) -> ElementRun:
    """Make one sample and load it, with half the step or rate if `half` is set."""
    law = make_law(scenario.law)
    engine = find_engine(scenario)
    kept = kept and kept.if_visible()
    state, packed = load_or_compute(kept, "packing", partial(make_sample, scenario.sample, law, seed, report))
    if half:
        path = scenario.path
        slower = {"step": 0.5 * path.step} if path.integrator == "quasi-static" else {
            "rate": 0.5 * scenario.rate, "inertial_number": None}  # fmt: skip
        scenario = scenario.model_copy(update={"path": path.model_copy(update=slower)})
    tolerance = BALANCED * scenario.stress_scale * scenario.sample.area
    breaks = None
    if scenario.cement:
        state, breaks = load_or_compute(kept, "cemented", partial(_cement, scenario, state, law, seed, tolerance))
    drive = drive_of(scenario.path, state.cell.dim)
    probed = _rows_to_probe(scenario) if seed == scenario.seed and not half else frozenset()
    rig = Rig(scenario, law, state, drive, tolerance, Factorisation(), engine, probed, breaks)
    series, end, ended, probes, breaks = _follow(rig, kept, within(report, stage=f"sample {seed}"))
    return ElementRun(seed, packed, _small_strain(state, law), series, end, ended, probes, breaks)


def _cement(scenario: ElementTestScenario, state: State, law: Law, seed: int, tolerance: float) -> Cemented:
    """Cement a sample under its pressure and unload it to the pressure of its test."""
    state = with_cement(state, scenario.cement, scenario.contact_modulus, seed)
    scales = compression_scales(state, law, scenario.stress_scale, tolerance)
    mass = servo_mass(state, scenario.stress_scale, scales)
    return unloaded(state, law, (scenario.sample.pressure, scenario.confining), mass, scales, tolerance)


def find_engine(scenario: ElementTestScenario) -> Engine | None:
    """Return the engine of a scenario; None for the default engine of `run`."""
    return lammps_engine(scenario.ranks) if scenario.engine == "lammps" else None


def _small_strain(state: State, law: Law) -> SmallStrain:
    if len(state.grains.radius) > MODULI_UP_TO:
        return SmallStrain(*[np.nan] * 4)
    try:
        moduli = elastic_moduli(state, law)
    except ValueError:
        return SmallStrain(*[np.nan] * 4)
    return SmallStrain(moduli.shear, moduli.bulk, moduli.young, moduli.poisson)


def loads_of(scenario: ElementTestScenario) -> np.ndarray:
    """Imposed strains along a path, or ln p: steps of a leg grow from `FIRST` by `GROWTH` up to the largest step."""
    path = scenario.path
    isotropic = path.kind == "isotropic"
    turns = np.log((scenario.sample.pressure, *path.turns)) if isotropic else np.array((0.0, *path.turns))
    scale = LOG_STEP if isotropic else 1.0
    out = [turns[:1]]
    for a, b in pairwise(turns):
        length, most = abs(b - a), scale * path.step
        growing = scale * FIRST * np.cumsum(GROWTH ** np.arange(1 + int(np.log(path.step / FIRST) / np.log(GROWTH))))
        growing = growing[growing < length]
        rest = length - (growing[-1] if len(growing) else 0.0)
        even = length - rest + rest * np.linspace(0, 1, 1 + max(1, int(np.ceil(round(rest / most, 6)))))[1:]
        out.append(a + np.sign(b - a) * np.concatenate([growing, even]))
    return np.concatenate(out)


def _rows_to_probe(scenario: ElementTestScenario) -> frozenset[int]:
    """Return the indices of the loads, before the first turn, that are nearest to the strains to probe."""
    loads = np.abs(loads_of(scenario))
    first = loads[: int(np.argmin(np.append(np.diff(loads), -1.0) > 0)) + 1]
    return frozenset(int(np.abs(first - abs(strain)).argmin()) for strain in scenario.probed_strains)


def _follow(rig: Rig, kept: Checkpoint | None, report: Report):
    """Return the series along the path, last state, reason for an early end, probed states, and broken bonds."""
    wanted, pieces = loads_of(rig.scenario), []
    while kept and kept.has(f"{len(pieces):06d}"):
        pieces.append(kept.load(f"{len(pieces):06d}", Piece))
    done = sum(len(piece.rows["load"]) for piece in pieces)
    state, rows, ended, saved = pieces[-1].state if pieces else rig.start, [], "", time.monotonic()
    broken: list[Breaks] = []

    def keep() -> None:
        columns = {name: np.array([row[name] for row in rows]) for name in ElementSeries._fields}
        pieces.append(Piece(Fields(columns, ElementSeries), state, join(broken)))
        if kept:
            kept.save(f"{len(pieces) - 1:06d}", pieces[-1])
        rows.clear()
        broken.clear()

    def note(before: State, after: State) -> None:
        broken.append(describe_break(before, after, done))

    move = partial(quasi_static, broke=note) if rig.scenario.path.integrator == "quasi-static" else dynamic
    probes: list[ProbedState] = [
        kept.load(_probe_name(k), ProbedState) for k in sorted(rig.probed) if kept and k < done
    ]
    steps = _with_probes(rig, move(rig, state, wanted, done), done, kept, probes)
    if _has_failed(rig, pieces, rows):
        steps = iter(())
    try:
        for state, load, rearranged in steps:
            rows.append(_measure(rig, state, load, rearranged))
            report("path", (done := done + 1) / len(wanted), _describe_row(rows[-1], rig.dim))
            if time.monotonic() - saved > SAVE_EVERY:
                keep()
                saved = time.monotonic()
            if _has_failed(rig, pieces, rows):
                break
    except NotInEquilibriumError as problem:
        if not (rows or pieces):
            raise
        ended = str(problem)
        broken = [each for each in broken if each.row < done]  # except on the way to an equilibrium that was not found
    if rows:
        keep()
    columns = [np.concatenate([piece.rows[name] for piece in pieces]) for name in ElementSeries._fields]
    breaks = rig.breaks and join([rig.breaks, *(piece.breaks for piece in pieces)])
    return ElementSeries(*columns), state, ended, tuple(probes), breaks


def _has_failed(rig: Rig, pieces: list[Piece], rows: list[dict]) -> bool:
    """Return True if a cemented sample has failed; see `has_failed`."""
    if rig.scenario.cement is None:
        return False
    stress = [*(each for piece in pieces for each in piece.rows["stress"]), *(row["stress"] for row in rows)]
    return has_failed(np.reshape(stress, (-1, 3, 3)), rig.scenario.cement, rig.dim)


def _probe_name(row: int) -> str:
    return f"probes-{row:06d}"


def _with_probes(rig: Rig, steps: Steps, done: int, kept: Checkpoint | None, probes: list[ProbedState]) -> Steps:
    """Pass on the steps from number `done`; probe selected states and append the results to a list."""
    for row, (state, load, rearranged) in enumerate(steps, start=done):
        if row in rig.probed:
            probes.append(load_or_compute(kept, _probe_name(row), partial(_probe, rig, state, load, rearranged)))
        yield state, load, rearranged


def _probe(rig: Rig, state: State, load: float, rearranged: bool) -> ProbedState:
    """Probe a state of the path after it has come to rest in a held cell.

    When dynamics brings a sample to rest, contacts move slightly away from the Coulomb limit. The sample is therefore
    loaded further by small quasi-static steps until contacts slide as along the path.
    """
    path, scales = rig.scenario.path, rig.scales(rig.scenario.sample.pressure)
    try:
        rest, outcome = settle(
            stopped(_hold_cell(state)), rig.law, scales, tolerance=rig.tolerance, keep=Factorisation()
        )
        if rearranged or outcome.fallback or path.integrator == "dynamic":
            rest = _hold_cell(_load_further(rig, rest, scales))
    except NotInEquilibriumError as problem:
        return without_answer(load, stress(state, rig.law), str(problem))
    return probe(rest, rig.law, load, plane_of(path, rig.dim)[0], rig.scenario.probes.directions)


def _hold_cell(state: State) -> State:
    """Return the state with a cell that is held and does not follow the stress."""
    nothing = np.zeros((3, 3))
    return state._replace(
        control=state.control._replace(cell_free=nothing.astype(bool), cell_rate=nothing, stress=nothing)
    )


def _load_further(rig: Rig, state: State, scales: Scales) -> State:
    """Load a state at rest further by small steps, the last `FURTHER` of them without dynamics if possible."""
    overlap = overlaps(state)[touching(state)].mean() / (2 * state.grains.radius.mean())
    step, keep, calm = np.sign(rig.scenario.path.turns[0]) * FURTHER_BY * overlap / FURTHER, Factorisation(), 0
    state = controlled(state, rig.drive, np.diag(stress(state, rig.law)))
    for _ in range(5 * FURTHER):
        state, outcome = settle(_strained(state, rig.drive, step), rig.law, scales, tolerance=rig.tolerance, keep=keep)
        calm = 0 if outcome.fallback else calm + 1
        if calm == FURTHER:
            break
    return state


def quasi_static(
    rig: Rig, state: State, loads: np.ndarray, done: int,
    *, broke: Callable[[State, State], None] = lambda before, after: None,
) -> Steps:  # fmt: skip
    """Yield equilibria at the loads from number `done`: state, load, and True if dynamics was needed; see `settle`."""
    path = rig.scenario.path
    scales, wanted = rig.scales(rig.scenario.stress_scale), np.full(3, rig.scenario.confining)
    if done and depends_on_stress(path):
        wanted = np.diag(stress(state, rig.law)).copy()
    for k in range(done, len(loads)):
        if path.kind == "isotropic":
            wanted[:] = np.exp(loads[k])
            scales = rig.scales(float(wanted[0]))
        elif k:
            state = _strained(state, rig.drive, loads[k] - loads[k - 1])
        state, wanted, rearranged = _settle(rig, state, wanted, scales, broke)
        if rig.drive.sealed is not None:
            state, more = _seal(rig, state, float(wanted[0]), scales)
            rearranged |= more
        yield state, float(loads[k]), rearranged


def _seal(rig: Rig, state: State, total: float, scales: Scales) -> tuple[State, bool]:
    """Find the equilibrium whose stress plus pore pressure equals the total stress; return True if dynamics was needed.

    Strains are corrected by Broyden's method.
    """
    stiffness, rearranged, off = rig.sealed_stiffness(scales, total), False, rig.missing_stress(state, total)
    for _ in range(FOLLOWS):
        if np.abs(off).max() <= SEALED * total:
            return state, rearranged
        step = np.linalg.solve(stiffness, off)
        moved = strained(state, np.diag(np.expm1(-step @ rig.drive.sealed)))
        state, outcome = settle(moved, rig.law, scales, tolerance=rig.tolerance, keep=rig.keep)
        before, off = off, rig.missing_stress(state, total)
        if not outcome.fallback:
            stiffness += np.outer(before - off - stiffness @ step, step) / (step @ step)
        rearranged |= outcome.fallback
    raise NotInEquilibriumError(f"the total stress of the cell was not reached in {FOLLOWS} corrections", outcome)


def _strained(state: State, drive: Drive, step: float) -> State:
    """Return the state after an affine increment of the driven strain."""
    gradient = drive.gradient * step
    return strained(state, gradient if gradient[0, 1] else np.diag(np.expm1(np.diag(gradient))))


def _settle(rig: Rig, state: State, wanted: np.ndarray, scales: Scales, broke) -> tuple[State, np.ndarray, bool]:
    """Find the equilibrium under the prescribed stresses; return it, these stresses, and True if dynamics was needed.

    Cemented samples begin each step without a stored factorisation, so a resumed run is bitwise identical.
    """
    path, p, dim = rig.scenario.path, rig.scenario.stress_scale, rig.dim
    keep = Factorisation() if rig.scenario.cement else rig.keep
    mass, rearranged, share, before = servo_mass(state, p, scales), False, 0.4, None
    for _ in range(FOLLOWS if depends_on_stress(path) else 1):
        state, outcome = settle(
            controlled(state, rig.drive, wanted, mass), rig.law, scales, tolerance=rig.tolerance, keep=keep, broke=broke
        )
        rearranged |= outcome.fallback
        if not depends_on_stress(path):
            return state, wanted, rearranged
        off = (wanted_stress(path, p, stress(state, rig.law), dim) - wanted)[rig.drive.free[-1]]
        if abs(off) <= FOLLOWED * p:
            return state, wanted, rearranged
        if before is not None and off != before:  # secant
            share = float(np.clip(share * before / (before - off), 0.1, 2.0))
        before, wanted = off, wanted.copy()
        change = share * off
        wanted[: dim - 1] += change if path.kind == "constant-p" else np.array([0.0, change])[: dim - 1]
    raise NotInEquilibriumError(f"the stresses of the path were not reached in {FOLLOWS} corrections", outcome)


def dynamic(rig: Rig, state: State, loads: np.ndarray, done: int) -> Steps:
    """Yield the states of a test at a finite rate, at the loads from number `done`."""
    scenario = rig.scenario
    path, rate, p = scenario.path, scenario.rate, scenario.sample.pressure
    isotropic = path.kind == "isotropic"
    rate = PRESSURE_RATE * rate if isotropic else rate
    scales = rig.scales(max(p, *(path.pressures or (p,))))
    mass = servo_mass(rig.start, p, scales, rate=scenario.rate)
    unit = rate * scales.dt
    follow, most = None, BLOCK
    if rig.drive.sealed is not None:
        most = int(np.clip(LAG / (scales.stiffness * scenario.rate * scales.dt), 1, BLOCK))
        follow = _follow_total(rig, scales, max(p, *(path.pressures or (p,))), state, most * scales.dt)
    place = np.rint((loads - loads[0]) / unit).astype(int)  # in time steps
    for k in range(done, len(loads)):
        here = int(place[max(k - 1, 0)])
        sign = int(np.sign(place[k] - here))
        while here != place[k]:
            left = abs(int(place[k]) - here)
            block = min(left, most) if isotropic or depends_on_stress(path) or follow else left
            total = np.exp(loads[0] + unit * here) if isotropic else p
            here += sign * block
            wanted = np.full(3, np.exp(loads[0] + unit * here))
            if not isotropic:
                wanted = wanted_stress(path, p, stress(state, rig.law), rig.dim)
            gradient = sign * rate * rig.drive.gradient
            if follow:
                gradient = gradient + follow(state, float(total), block / most)
            moving = state._replace(control=strained_at(state.control, gradient))
            state = _advance(rig, controlled(moving, rig.drive, wanted, mass), block, scales)
        yield state, float(loads[0] + unit * place[k]), False


def _follow_total(rig: Rig, scales: Scales, pressure: float, state: State, time: float) -> Callable:
    """Return a proportional-integral controller of the total stress, which acts in blocks of a given time.

    The returned function maps the state, the total stress of the cell, and the length of the next block (relative to a
    whole block) to a velocity gradient (3, 3). In a resumed run, the integral begins with the current rate.
    """
    sealed, stiffness = rig.drive.sealed, rig.sealed_stiffness(scales, pressure)
    gain, integral = GAINS
    basis = np.vstack([sealed, -np.diag(rig.drive.gradient)]).T
    taken = time * stiffness @ np.linalg.lstsq(basis, -np.diag(state.control.cell_rate))[0][:-1]  # per block [stress]

    def follow(state: State, total: float, share: float) -> np.ndarray:
        nonlocal taken
        off = rig.missing_stress(state, total)
        taken = taken + integral * share * off
        return -np.diag(np.linalg.solve(stiffness, gain * off + taken) @ sealed) / time

    return follow


def _advance(rig: Rig, state: State, steps: int, scales: Scales) -> State:
    """Return the state after some time steps of the scenario's engine."""
    state, _, outcome = run(state, rig.law, steps, scales.dt, drag=SETTLING_DRAG / scales.time, engine=rig.engine)
    if not outcome.ok:
        raise RuntimeError(f"the run ended: {outcome}")
    return state


def _measure(rig: Rig, state: State, load: float, rearranged: bool) -> dict:
    """Return one row of the series."""
    load_now, _ = forces(state, rig.law, memory=FROZEN)
    rows = touching(state)
    between = np.linalg.norm(contact_forces(state, rig.law)[rows], axis=1).mean() if len(rows) else 0.0
    pull = np.linalg.norm(unbalanced_forces(state, load_now)[: len(state.grains.radius), :3], axis=1).mean()
    principal = np.linalg.eigvalsh(fabric(state)[: rig.dim, : rig.dim])
    return {
        "load": load,
        "strain": strain_of(state.cell.vectors, rig.start.cell.vectors),
        "stress": stress(state, rig.law),
        "void_ratio": 1 / packing_fraction(state) - 1,
        "coordination": coordination(state, least_supports(rig.law, rig.dim)),
        "fabric_anisotropy": principal[-1] - principal[0],
        "sliding_fraction": (state.contacts.mode[rows] == SLIDE).mean() if len(rows) else 0.0,
        "unbalanced": pull / between if between > 0 else np.inf,
        "rearranged": rearranged,
    }


def _describe_row(row: dict, dim: int) -> str:
    """Describe a row for progress reports."""
    axial, p = row["stress"][dim - 1, dim - 1], np.trace(row["stress"]) / dim
    return f"load {row['load']:.4g}, axial stress {axial:.4g}, p {p:.4g}, z {row['coordination']:.2f}"
