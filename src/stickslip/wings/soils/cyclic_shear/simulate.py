"""Simulation of cyclic shear, and measures of its cycles: modulus, damping ratio, split of the work, and return.

Each step ends in equilibrium, and its energies are entered in a ledger. γ_a and τ_a = G γ_a are half the differences of
strain and stress between the turns of a loop. The damping ratio is D = ΔW/(4π W), with the area ΔW of the loop and W =
½ τ_a γ_a. ΔW is the work of the shear stress, including work within steps in which grains rearrange. G′ and G″ are the
first Fourier coefficients of τ over γ₀, for γ = γ₀ sin θ, so ΔW = π γ₀² G″ up to the error of the trapezoidal rule.
"""

from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, NotInEquilibriumError, State
from ....kit import (
    Checkpoint,
    Fields,
    PathLedger,
    Quantities,
    Quantity,
    Report,
    Task,
    Workers,
    checked,
    checkpoint_in,
    compression_scales,
    least_supports,
    load_or_compute,
    make_law,
    quantities_of,
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
from ....results import Factorisation, Ledger, PackingInfo
from ..element_test.sample import BALANCED, Drive, check_pressures, controlled, make_sample, strain_of
from ..element_test.simulate import MODULI_UP_TO
from . import EXPERIMENT
from .scenario import CyclicShearScenario

ELASTIC = 1e-3  # damping ratio below which cycles are elastic if the grains return
RETURNED = 1e-2  # ratio of rms displacement to γ₀ D below which a sample has returned
CLEAR = 1e-5  # damping ratio above which the work is split; the area of smaller loops is lost in round-off
NAN = float("nan")
SHEAR = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # displacement gradient of γ = 1


class Cycle(NamedTuple):
    """One cycle of T steps."""

    rows: dict[str, np.ndarray]  # those fields of `Response` that have a row for each equilibrium
    busiest: float
    strong: float
    end: State


@readable
class Response(NamedTuple):
    """C cycles of T steps at one amplitude; rows are equilibria, the first at the start of a cycle."""

    amplitude: float
    gamma: np.ndarray  # (C, T + 1) shear strain
    tau: np.ndarray  # (C, T + 1) shear stress, −σ_xy [force/length^(dim−1)]
    normal: np.ndarray  # (C, T + 1) σ_yy [force/length^(dim−1)]
    pressure: np.ndarray  # (C, T + 1) pressure [force/length^(dim−1)]
    height: np.ndarray  # (C, T + 1) ε_yy, compression positive, which is the volumetric strain
    rearranged: np.ndarray  # (C, T + 1) bool, True if dynamics was needed to find the equilibrium
    energies: np.ndarray  # (C, T + 1, 11) columns of `Ledger`, over the volume of the sample [energy/length^dim]
    busiest: np.ndarray  # (C,) fraction of the sliding work in the tenth of the contacts that dissipates most
    strong: np.ndarray  # (C,) fraction of the sliding work in contacts with more than the mean force
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
    return Cycle(Fields(columns, Response), work.busiest, work.strong, state)


def _measure(rig: Rig, state: State, account: PathLedger, rearranged: bool) -> dict:
    """Return one row of a cycle."""
    sigma, strain = stress(state, rig.law), strain_of(state.cell.vectors, rig.sample.cell.vectors)
    return {
        "gamma": strain[3], "tau": -sigma[0, 1], "normal": sigma[1, 1], "pressure": pressure(state, rig.law),
        "height": strain[1], "rearranged": rearranged, "energies": account.row / volume(rig.sample),
    }  # fmt: skip


class SlidingWork:
    """Work of friction at each contact, computed from the slip between equilibria."""

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
        """Share of the work in contacts that carry more than the mean force; NaN without sliding."""
        total = float(np.concatenate(self.values).sum())
        return self.in_strong / total if total > 0 else np.nan

    @property
    def busiest(self) -> float:
        """Share of the work in the tenth of the contacts that dissipates most; NaN without sliding."""
        _, index = np.unique(np.concatenate(self.keys), return_inverse=True)
        by_contact = np.sort(np.bincount(index, np.concatenate(self.values)))[::-1]
        total = by_contact.sum()
        return float(by_contact[: -(-len(by_contact) // 10)].sum() / total) if total > 0 else np.nan


def _response(amplitude: float, cycles: list[Cycle], ends: list[State], law: Law) -> Response:
    """All cycles at one amplitude."""
    rows = {name: np.array([cycle.rows[name] for cycle in cycles]) for name in cycles[0].rows}
    rows |= {name: np.array([getattr(cycle, name) for cycle in cycles]) for name in ("busiest", "strong")}
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
    """Return dτ/dγ at constant volume or constant σ_yy from elastic moduli of the sample; NaN if they are unknown."""
    if len(rig.sample.grains.radius) > MODULI_UP_TO:
        return np.nan
    try:
        c = elastic_moduli(rig.sample, rig.law).tensor
    except ValueError:
        return np.nan
    return float(c[0, 1, 0, 1] - (c[0, 1, 1, 1] * c[1, 1, 0, 1] / c[1, 1, 1, 1] if rig.drive.free else 0.0))


class Loop:
    """Cycle k of a response, with the quantities of `CYCLE`."""

    def __init__(self, response: Response, k: int, run: CyclicRun | None = None):
        self.response, self.k, self.run = response, k % len(response.gamma), run

    @cached_property
    def turns(self) -> tuple[float, float]:
        """G and γ_a between the turns [force/length^(dim−1), 1]."""
        quarter = (self.response.gamma.shape[1] - 1) // 4
        turns = [quarter, 3 * quarter]
        tau, gamma = (-np.diff(v[self.k][turns])[0] / 2 for v in (self.response.tau, self.response.gamma))
        return float(tau / gamma), float(gamma)

    @cached_property
    def harmonics(self) -> tuple[float, float]:
        """G′ and G″ [force/length^(dim−1)]."""
        tau = self.response.tau[self.k]
        theta = np.linspace(0, 2 * np.pi, len(tau))
        return tuple(
            float(np.trapezoid(tau * wave(theta), theta)) / (np.pi * self.response.amplitude)
            for wave in (np.sin, np.cos)
        )

    @cached_property
    def book(self) -> Ledger:
        """Energies of the cycle, in columns (T + 1,) [energy/length^dim]."""
        return Ledger(*self.response.energies[self.k].T)

    @cached_property
    def normal_work(self) -> float:
        """Work of σ_yy [energy/length^dim]."""
        height = self.response.height[self.k]
        return float(np.trapezoid(self.response.normal[self.k] * np.exp(-height), height))

    @cached_property
    def area(self) -> float:
        """Area of the loop: work of the shear stress [energy/length^dim]."""
        return float(self.book.external[-1] - self.book.external[0]) - self.normal_work

    @cached_property
    def damping(self) -> float:
        """Damping ratio D."""
        g, amplitude = self.turns
        return self.area / (2 * np.pi * g * amplitude**2)

    @cached_property
    def shares(self) -> dict[str, float]:
        """Contributions to the area: dissipation and storage, minus the work of σ_yy, and the residual.

        `drawn` is the excess area of the polygon through the equilibria.
        """
        spent = {name: float(column[-1] - column[0]) for name, column in self.book._asdict().items()}
        shares = {
            "sliding": spent["coulomb"], "rolling": spent["rolling"], "dashpots": spent["viscous"],
            "drag": spent["drag"], "nonpotential": -spent["nonpotential"],
            "stored": spent["normal"] + spent["tangential"], "normal": -self.normal_work,
        }  # fmt: skip
        shares["residual"] = self.area - sum(shares.values())
        shares["drawn"] = float(np.trapezoid(self.response.tau[self.k], self.response.gamma[self.k])) - self.area
        return {name: value / self.area for name, value in shares.items()}

    @property
    def in_rearrangements(self) -> float:
        """Share of the dissipation in steps in which grains rearrange; NaN without dissipation."""
        book, moved = self.book, self.response.rearranged[self.k][1:]
        dissipated = np.diff(book.coulomb + book.rolling + book.viscous + book.drag)
        total = dissipated.sum()
        return float(dissipated[moved].sum() / total) if total else NAN

    @property
    def clear(self) -> bool:
        """True if the work can be split."""
        return abs(self.damping) >= CLEAR


STRESS, WORK = "force/length^(dim-1)", "energy/length^dim"
PARTS = {
    "sliding": "sliding contacts", "rolling": "rolling friction", "dashpots": "dashpots", "drag": "drag",
    "nonpotential": "changes of the tangential springs", "stored": "energy stored in contacts",
    "normal": "work of σ_yy, negative", "residual": "remainder that the ledger does not explain",
}  # fmt: skip


def _share(name: str, meaning: str) -> Quantity:
    return Quantity(name, "1", meaning, lambda loop: loop.shares[name] if loop.clear else NAN)


CYCLE = Quantities([
    Quantity("sample", "1", "seed of the sample", "run.seed"),
    Quantity("kind", "1", "kind of the last cycles at the amplitude", lambda loop: kind_of(loop.response)),
    Quantity("amplitude", "1", "amplitude γ₀", "response.amplitude", r"amplitude of the shear strain $\gamma_0$"),
    Quantity("cycle", "1", "number of the cycle", lambda loop: loop.k + 1),
    Quantity("G", STRESS, "secant modulus between the turns", lambda loop: loop.turns[0]),
    Quantity("G_ratio", "1", "G/Gmax", lambda loop: loop.turns[0] / largest_modulus(loop.run), r"$G/G_\mathrm{max}$"),
    Quantity("damping", "1", "damping ratio", label="damping ratio $D$"),
    Quantity("storage", STRESS, "G′, storage modulus", lambda loop: loop.harmonics[0], "$G'$"),
    Quantity("loss", STRESS, "G″, loss modulus", lambda loop: loop.harmonics[1], "$G''$"),
    Quantity("area", WORK, "area of the loop, the work of the shear stress"),
    *(_share(name, f"fraction of the area: {words}") for name, words in PARTS.items()),
    _share("drawn", "excess of the polygon through the equilibria, over the area"),
    Quantity("in_rearrangements", "1", "fraction of the dissipation in steps with rearrangements",
             lambda loop: loop.in_rearrangements if loop.clear else NAN),
    Quantity("busiest", "1", "fraction of sliding work in the tenth of the contacts that dissipates most",
             lambda loop: loop.response.busiest[loop.k] if loop.clear else NAN),
    Quantity("strong", "1", "fraction of sliding work in contacts with more than the mean force",
             lambda loop: loop.response.strong[loop.k] if loop.clear else NAN),
    Quantity("rearranged", "1", "fraction of steps with rearrangements",
             lambda loop: float(loop.response.rearranged[loop.k][1:].mean())),
    Quantity("pressure", STRESS, "pressure at the end", lambda loop: float(loop.response.pressure[loop.k][-1])),
    Quantity("volumetric_strain", "1", "volumetric strain at the end, compression positive",
             lambda loop: float(loop.response.height[loop.k][-1])),
    Quantity("returned", "1", "rms displacement of grains in the cycle, over γ₀ D",
             lambda loop: float(loop.response.distance[loop.k + 1][loop.k])),
])  # fmt: skip

LOOP = Quantities([
    *(CYCLE[name] for name in ("sample", "amplitude", "cycle")),
    *quantities_of(Response, "gamma", "tau", "normal", "pressure", "height", "rearranged",
                   of=lambda name: lambda loop: getattr(loop.response, name)[loop.k]).values(),
])  # fmt: skip


def loops_of(result: CyclicShearResult) -> list[Loop]:
    """All cycles of all samples."""
    return [
        Loop(response, k, run)
        for run in result.runs
        for response in run.responses
        for k in range(len(response.gamma))
    ]  # fmt: skip


def last_cycles(run: CyclicRun) -> dict[str, np.ndarray]:
    """Quantities of the last cycle at each amplitude: columns by name."""
    return CYCLE.columns(Loop(response, -1, run) for response in run.responses)


def largest_modulus(run: CyclicRun) -> float:
    """Gmax of a sample: its tangent modulus or, if that is not known, G at the smallest amplitude."""
    return run.modulus if np.isfinite(run.modulus) else Loop(run.responses[0], -1).turns[0]


def period(response: Response) -> int:
    """Return the number of cycles after which grains return, judged at the last cycle; 0 if they do not return."""
    back = response.distance[-1][-2::-1]
    returned = np.flatnonzero(back < RETURNED)
    return int(returned[0]) + 1 if len(returned) else 0


def kind_of(response: Response) -> str:
    """Kind of the final cycles at an amplitude.

    elastic: grains return after a cycle, and the damping ratio is below `ELASTIC`; reversible: grains return, but the
    loop has an area, so sliding is reversed; periodic: grains return after several cycles; irreversible: grains
    do not return. Grains return if their rms displacement is below `RETURNED` times γ₀ times the mean diameter.
    """
    if len(response.gamma) < 2:
        return "undecided"
    n = period(response)
    if n == 1:
        return "elastic" if abs(Loop(response, -1).damping) < ELASTIC else "reversible"
    return "periodic" if n else "irreversible"
