"""Simulation of cyclic shear: each step ends in equilibrium, and its energies are posted to a ledger."""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, NotInEquilibriumError, State
from ....kit import (
    Checkpoint,
    PathLedger,
    Report,
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
    silent,
    strain_step,
    volume,
    within,
)
from ....measure import contact_forces, dissipation, pressure, rattlers, stress
from ....modes import elastic_moduli
from ....results import Factorisation, PackingInfo
from ..element_test.sample import BALANCED, Drive, check_pressures, controlled, make_sample, strain_of
from ..element_test.simulate import MODULI_UP_TO
from . import EXPERIMENT
from .scenario import CyclicShearScenario

SHEAR = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # displacement gradient of γ = 1


class Cycle(NamedTuple):
    """One cycle of T steps; rows are equilibria, the first at the start of the cycle."""

    gamma: np.ndarray  # (T + 1,) shear strain
    tau: np.ndarray  # (T + 1,) −σ_xy [force/length^(dim−1)]
    normal: np.ndarray  # (T + 1,) σ_yy [force/length^(dim−1)]
    pressure: np.ndarray  # (T + 1,) [force/length^(dim−1)]
    height: np.ndarray  # (T + 1,) ε_yy, compression positive, which is the volumetric strain
    rearranged: np.ndarray  # (T + 1,) bool, True if dynamics was needed to find the equilibrium
    energies: np.ndarray  # (T + 1, 11) columns of `Ledger`, over the volume of the sample [energy/length^dim]
    busiest: float  # fraction of the sliding work in the tenth of the contacts that dissipates most
    strong: float  # fraction of the sliding work in contacts with more than the mean force
    end: State


@readable
class Response(NamedTuple):
    """C cycles at one amplitude; fields as in `Cycle`, with a first axis of cycles."""

    amplitude: float
    gamma: np.ndarray  # (C, T + 1)
    tau: np.ndarray  # (C, T + 1) [force/length^(dim−1)]
    normal: np.ndarray  # (C, T + 1) [force/length^(dim−1)]
    pressure: np.ndarray  # (C, T + 1) [force/length^(dim−1)]
    height: np.ndarray  # (C, T + 1)
    rearranged: np.ndarray  # (C, T + 1) bool
    energies: np.ndarray  # (C, T + 1, 9) [energy/length^dim]
    busiest: np.ndarray  # (C,)
    strong: np.ndarray  # (C,)
    distance: np.ndarray  # (C + 1, C + 1) rms displacement of grains between the ends of two cycles, over γ₀ D


class CyclicRun(NamedTuple):
    """Cycles of one sample."""

    seed: int
    packed: PackingInfo
    modulus: float  # dτ/dγ of the sample while no contact changes [force/length^(dim−1)]; NaN if it is not known
    responses: tuple[Response, ...]  # one per amplitude reached
    end: State  # after the last cycle
    ended: str  # reasons for missing cycles


class Rig(NamedTuple):
    """Sample with its law and the control of its shear."""

    scenario: CyclicShearScenario
    law: Law
    sample: State
    steps: int

    @property
    def drive(self) -> Drive:
        """Control of the cell."""
        return Drive(SHEAR, (1,) if self.scenario.cycles.normal == "constant-stress" else ())


@result_of(EXPERIMENT)
class CyclicShearResult(NamedTuple):
    """Cycles of all samples."""

    scenario: CyclicShearScenario
    law: Law
    runs: tuple[CyclicRun, ...]
    checked: CyclicRun | None  # the first sample with twice as many steps
    failures: tuple[str, ...]


@checked
def simulate_cyclic_shear(
    scenario: CyclicShearScenario, *, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> CyclicShearResult:
    """Shear samples with the seeds seed, seed + 1, … back and forth.

    All strains, even at later amplitudes, are measured from the prepared sample; the normal stress is absolute.

    Parameters
    ----------
    folder : run folder, in which samples and cycles are saved as soon as they are finished
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
    ...     experiment="cyclic-shear",
    ...     sample={"dim": 2, "grains": 50, "pressure": 100.0, "friction": 0.1},
    ...     law={"young": 1e9, "poisson": 0.2},
    ...     cycles={"amplitudes": [1e-7], "number": 1, "steps": 12},
    ... )
    >>> run = simulate_cyclic_shear(short).runs[0]
    >>> response = run.responses[0]
    >>> round(float(np.ptp(response.tau) / np.ptp(response.gamma) / run.modulus), 2)
    1.0
    """
    law = make_law(scenario.law)
    kept = checkpoint_in(folder, scenario, CyclicRun, PackingInfo, Response, Cycle)
    check_pressures(scenario.sample, law, kept)
    seeds = [scenario.seed + k for k in range(scenario.realizations)]
    jobs = [(f"sample-{seed}", seed, 1) for seed in seeds]
    jobs += [(f"sample-{scenario.seed}-fine", scenario.seed, 2)] if scenario.check else []
    tasks = [
        Task(name, (scenario, seed, finer, kept and kept.of(name, PackingInfo, Cycle)), name, kept)
        for name, seed, finer in jobs
    ]
    made = run_realizations(shear_sample, tasks, stage="samples", workers=workers, report=report)
    runs = tuple(made.groups(len(seeds))[0].successful("sample"))
    return CyclicShearResult(scenario, law, runs, made.results[-1] if scenario.check else None, made.failures)


def shear_sample(
    scenario: CyclicShearScenario, seed: int, finer: int, kept: Checkpoint | None, report: Report
) -> CyclicRun:
    """Make one sample and shear it at all amplitudes, with `finer` times as many steps."""
    law, kept = make_law(scenario.law), kept and kept.if_visible()
    state, packed = load_or_compute(kept, "packing", partial(make_sample, scenario.sample, law, seed, report))
    rig, amplitudes = Rig(scenario, law, state, finer * scenario.cycles.steps), scenario.cycles.amplitudes
    responses, problems, here = [], [], state
    for k, amplitude in enumerate(amplitudes):
        ends, cycles = [here], []
        try:
            for number in range(scenario.cycles.number):
                done, unit = k * scenario.cycles.number + number, 1 / (len(amplitudes) * scenario.cycles.number)
                told = within(report, done * unit, (done + 1) * unit, stage=f"sample {seed}")
                make = partial(shear_once, rig, ends[-1], amplitude, told)
                cycles.append(load_or_compute(kept, f"{k:03d}-{number:05d}", make))
                ends.append(cycles[-1].end)
        except NotInEquilibriumError as problem:
            problems.append(f"cycle {len(cycles) + 1} at an amplitude of {amplitude:g} was not finished: {problem}")
        if cycles:
            last = ends[-1]
            responses.append(_response(amplitude, cycles, ends, law))
        here = ends[-1] if scenario.cycles.start == "previous" else state
    if not responses:
        raise RuntimeError(problems[0])
    return CyclicRun(seed, packed, tangent_modulus(rig), tuple(responses), last, "; ".join(problems))


def shear_once(rig: Rig, state: State, amplitude: float, report: Report = silent) -> Cycle:
    """Shear a sample through one cycle, about the strain of the prepared sample."""
    p, area = rig.scenario.sample.pressure, float(2 * state.grains.radius.mean()) ** (state.cell.dim - 1)
    tolerance, keep, account = BALANCED * p * area, Factorisation(), PathLedger(state, rig.law)
    scales = compression_scales(rig.sample, rig.law, p, tolerance)
    state = controlled(state, rig.drive, np.full(3, p), servo_mass(rig.sample, p, scales))
    rows, work = [_measure(rig, state, account, False)], SlidingWork()
    for gamma in amplitude * np.sin(2 * np.pi * np.arange(1, rig.steps + 1) / rig.steps):
        before, change = state, gamma - rows[-1]["gamma"]
        state, outcome = strain_step(
            state, rig.law, scales, change * SHEAR, tolerance=tolerance, keep=keep, account=account
        )
        work.add(before, state, rig.law)
        rows.append(_measure(rig, state, account, outcome.fallback))
        report("cycles", len(rows) / (rig.steps + 1), f"γ {gamma:.3g}, τ {rows[-1]['tau']:.4g}")
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return Cycle(**columns, busiest=work.busiest, strong=work.strong, end=state)


def _measure(rig: Rig, state: State, account: PathLedger, rearranged: bool) -> dict:
    """Return one row of a cycle."""
    sigma, strain = stress(state, rig.law), strain_of(state.cell.vectors, rig.sample.cell.vectors)
    return {
        "gamma": strain[3], "tau": -sigma[0, 1], "normal": sigma[1, 1], "pressure": pressure(state, rig.law),
        "height": strain[1], "rearranged": rearranged, "energies": account.row / volume(rig.sample),
    }  # fmt: skip


class SlidingWork:
    """Work of friction by contact, from the slip between equilibria."""

    def __init__(self):
        self.keys, self.values, self.in_strong = [], [], 0.0

    def add(self, before: State, after: State, law: Law) -> None:
        """Add one step."""
        lost = dissipation(before, after, law).sliding
        force = np.linalg.norm(contact_forces(after, law), axis=1)
        self.keys.append(after.contacts.key[: len(lost)].copy())
        self.values.append(lost)
        self.in_strong += float(lost[force > force[force > 0].mean()].sum()) if force.any() else 0.0

    @property
    def strong(self) -> float:
        """Share in contacts with more than the mean force; NaN without sliding."""
        total = float(np.concatenate(self.values).sum())
        return self.in_strong / total if total > 0 else np.nan

    @property
    def busiest(self) -> float:
        """Share of the tenth of the contacts that dissipates most; NaN without sliding."""
        _, index = np.unique(np.concatenate(self.keys), return_inverse=True)
        by_contact = np.sort(np.bincount(index, np.concatenate(self.values)))[::-1]
        total = by_contact.sum()
        return float(by_contact[: -(-len(by_contact) // 10)].sum() / total) if total > 0 else np.nan


def _response(amplitude: float, cycles: list[Cycle], ends: list[State], law: Law) -> Response:
    """All cycles at one amplitude."""
    rows = {name: np.array([getattr(c, name) for c in cycles]) for name in Cycle._fields if name != "end"}
    unit = amplitude * 2 * float(ends[0].grains.radius.mean())
    distance = [[_distance(a, b, law) / unit for b in ends] for a in ends]
    return Response(amplitude, **rows, distance=np.array(distance))


def _distance(one: State, other: State, law: Law) -> float:
    """Root mean square displacement of grains between two states, relative to the cell and without rattlers."""
    least = least_supports(law, one.cell.dim)
    bears = ~(rattlers(one, least) | rattlers(other, least))
    cells = [np.where(s.cell.vectors.any(axis=1)[:, None], s.cell.vectors, np.eye(3)) for s in (one, other)]
    moved = (other.grains.position - one.grains.position @ np.linalg.solve(*cells))[bears]
    moved -= moved.mean(axis=0)
    return float(np.sqrt((moved**2).sum(axis=1).mean())) if bears.any() else np.nan


def tangent_modulus(rig: Rig) -> float:
    """Modulus dτ/dγ of the sample from its elastic moduli, at constant volume or constant σ_yy; NaN if it has none."""
    if len(rig.sample.grains.radius) > MODULI_UP_TO:
        return np.nan
    try:
        c = elastic_moduli(rig.sample, rig.law).tensor
    except ValueError:
        return np.nan
    return float(c[0, 1, 0, 1] - (c[0, 1, 1, 1] * c[1, 1, 0, 1] / c[1, 1, 1, 1] if rig.drive.free else 0.0))
