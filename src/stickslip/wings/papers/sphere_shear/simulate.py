"""Simulation of sheared packings: pack, shear quasi-statically with spectra, locate the onset, and release."""

import warnings
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, NotInEquilibriumError, Outcome, State, Status, spectrum
from ....kit import (
    Checkpoint,
    Growth,
    LeftPathError,
    Member,
    Realizations,
    Report,
    Task,
    Workers,
    bisect_change,
    checked,
    checkpoint_in,
    linearise,
    load_or_compute,
    make_law,
    make_packing,
    readable,
    result_of,
    run_realizations,
    silent,
)
from ....measure import pressure, stress, touching
from ....modes import UnstableEquilibriumWarning
from ....protocols import Protocol, aqs, load_path, release
from ....results import Equilibrium, PackingInfo, Released
from . import EXPERIMENT
from .scenario import ShearScenario

HALVINGS = 7  # number of distances above the first birth, each half the previous one, at which Im λ is measured


class Onset(NamedTuple):
    """Birth of the first complex pair, located by bisection from the last saved state without a pair."""

    below: float
    above: float
    offset: np.ndarray  # (K,) γ − γ_c
    im_lambda: np.ndarray  # (K,) Im λ of the pair [1/time²]
    exponent: float  # exponent of Im λ as a function of γ − γ_c; NaN if other pairs exist
    at_limit: float  # fraction of contacts at the Coulomb limit just above the birth
    mobilisation: float  # largest |F_t|/(μ F_n) just above the birth; NaN without friction

    @property
    def strain(self) -> float:
        """Onset strain γ_c, the middle of the bracket."""
        return 0.5 * (self.below + self.above)


@readable
class ShearPath(NamedTuple):
    """Quasi-static shear of one packing."""

    seed: int
    packed: PackingInfo
    # modes with |λ| below 1e-9 of the largest, at zero slip: 3 translations (2 in the plane) and 6 (3) per rattler
    zero_modes: int
    strain: np.ndarray  # (P,) [1]
    pairs: np.ndarray  # (P,) number of complex pairs
    largest: np.ndarray  # (P,) largest Im λ, 0 without pairs [1/time²]
    smallest: np.ndarray  # (P,) smallest Im λ among the pairs [1/time²]
    growth_rate: np.ndarray  # (P,) growth rate of the fastest complex pair [1/time]
    negative: np.ndarray  # (P,) number of negative real eigenvalues
    shear_stress: np.ndarray  # (P,) −σ_xy [force/length^(dim−1)]
    pressure: np.ndarray  # (P,) [force/length^(dim−1)]
    touching: np.ndarray  # (P,) number of contacts
    residual: np.ndarray  # (P,) largest unbalanced force or torque/R [force]
    fallbacks: int  # number of steps in which Newton's method needed a fallback
    unstable: int  # number of steps that ended at an unstable equilibrium
    left: int  # number of steps that left their branch
    onset: Onset | None
    single: State | None  # the fastest-growing state with one pair, before a second pair appears
    single_strain: float
    last: State
    stopped: str  # reason why the path ended early, or an empty string

    @property
    def reappears(self) -> bool:
        """Return True if all pairs vanished after the onset and some reappeared."""
        there = self.pairs > 0
        return bool((np.diff(there.astype(int)) == 1).sum() > 1)


@result_of(EXPERIMENT)
class ShearResult(NamedTuple):
    """Results of a shear scenario; lists have one entry per seed, None if a run failed or had no state to release."""

    scenario: ShearScenario
    law: Law
    paths: list[ShearPath]
    single: list[Released | None]  # runs from one-pair states
    later: list[Released | None]  # runs from the last state of each path
    failures: tuple[str, ...]


def strain_path(scenario: ShearScenario) -> np.ndarray:
    """Return all strains of a path, with a separate step for each leg."""
    legs = zip(pairwise(scenario.shear.strain), scenario.shear.steps, strict=True)
    return np.concatenate([np.zeros(1), *(load_path(ends, step)[1:] for ends, step in legs)])


class Step(NamedTuple):
    """One point of a path."""

    strain: float
    state: State
    row: tuple  # columns of ShearPath from `pairs` to `residual`
    zero_modes: int
    fallback: bool
    unstable: bool
    left: bool


def shear_packing(
    scenario: ShearScenario, seed: int, kept: Checkpoint | None = None, report: Report = silent
) -> ShearPath:
    """Pack one sample and shear it; if no equilibrium is found, the path ends early and states the reason.

    Parameters
    ----------
    kept : storage for the packing and the points of the path
    report : called as report(stage, share done, text)
    """
    law, kept = make_law(scenario.law), kept and kept.if_visible()
    report(f"packing {seed}", 0.0, f"packing {scenario.packing.grains} grains")
    shear = scenario.shear
    state, packed = load_or_compute(
        kept, "packing", partial(make_packing, scenario.packing, law, seed, shear.tolerance)
    )
    protocol = aqs(
        law, slip=shear.slip, tolerance=shear.tolerance, on_instability=shear.on_instability, drag=shear.drag
    )
    path, loads, stopped = [], strain_path(scenario), ""
    for k, strain in enumerate(loads):
        try:
            step = load_or_compute(kept, f"strain-{k:06d}", partial(_equilibrate, protocol, state, strain))
        except (NotInEquilibriumError, LeftPathError) as problem:
            stopped = str(problem)
            break
        path.append(step)
        state, (pairs, _, _, rate, *_, residual) = step.state, step.row
        text = f"strain {strain:.2e}, {pairs} pairs, growth rate {rate:.1e}, unbalanced {residual:.0e}"
        report(f"packing {seed}", (k + 1) / len(loads), text)
    if not path:
        raise RuntimeError(stopped)
    numbers = [step.row[0] for step in path]
    born = next((k for k, pairs in enumerate(numbers) if pairs), 0)
    onset = None
    if born:
        last = path[born - 1]
        modes = spectrum(last.state, law, modes=protocol.modes)
        clean = Equilibrium(last.strain, last.state, modes, Outcome(Status.CONVERGED, last.row[-1], 0))
        onset = find_onset(clean, path[born].strain, protocol)
    two = next((k for k, pairs in enumerate(numbers) if pairs > 1), len(path))
    single = max((step for step in path[:two] if step.row[0]), key=lambda step: step.row[3], default=None)
    return ShearPath(
        seed, packed, path[0].zero_modes, loads[: len(path)], *np.array([step.row for step in path]).T,
        *(sum(getattr(step, name) for step in path) for name in ("fallback", "unstable", "left")),
        onset, single.state if single else None, single.strain if single else np.nan, state, stopped,
    )  # fmt: skip


def _equilibrate(protocol: Protocol, state: State, strain: float) -> Step:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnstableEquilibriumWarning)  # these steps are counted
        point = protocol.step(state, strain)
    modes, pairs, how = point.spectrum, point.spectrum.pair_indices, point.outcome
    size, im = np.abs(modes.eigenvalues), modes.im_lambda[pairs]
    real = modes.eigenvalues[modes.eigenvalues.imag == 0].real
    row = (  # columns of ShearPath, from `pairs` to `residual`
        len(pairs), im.max(initial=0.0), im.min() if len(im) else 0.0, modes.growth_rate[pairs].max(initial=0.0),
        int((real < -1e-9 * size.max()).sum()), -stress(point.state, protocol.law)[0, 1],
        pressure(point.state, protocol.law), len(touching(point.state)), how.residual,
    )  # fmt: skip
    zeros = int((size < 1e-9 * size.max()).sum())
    return Step(float(strain), point.state, row, zeros, how.fallback, how.unstable, how.left)


def find_onset(clean: Equilibrium, above: float, protocol: Protocol) -> Onset:
    """Locate the birth of the first pair by bisection between a state without pairs and a strain with pairs.

    Every trial is one strain step from the saved state, so that the path does not depend on the search.
    """
    # γ_c must be much more accurate than the smallest distance from it at which Im λ is measured
    fine = 0.01 * 0.5**HALVINGS * (above - clean.load) / above
    change = bisect_change(clean, above, protocol, lambda s: bool(len(s.pairs)), relative=min(1e-6, fine))
    protocol = protocol.starting(clean.state, clean.load)
    offset = (above - change.load) * 0.5 ** np.arange(HALVINGS)
    spectra = [protocol.step(clean.state, change.load + d).spectrum for d in offset]
    im = np.array([s.im_lambda.max() for s in spectra])
    alone = [k for k, s in enumerate(spectra) if len(s.pairs) == 1][-5:]  # nearest to the birth
    exponent = float(np.polyfit(np.log(offset[alone]), np.log(im[alone]), 1)[0]) if len(alone) >= 3 else np.nan
    born = linearise(protocol.step(clean.state, change.above).state, protocol.law)
    bears = np.isfinite(born.mobilisation)
    at_limit = float(born.slides[bears].mean()) if bears.any() else 0.0
    most = max(born.mobilisation[bears], default=np.nan)
    return Onset(change.below, change.above, offset, im, exponent, at_limit, most)


@checked
def simulate_shear(
    scenario: ShearScenario, *, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> ShearResult:
    """Run a shear scenario from beginning to end, with one packing for each of the seeds seed, seed + 1, …

    Parameters
    ----------
    folder : run folder, in which each run and each point of a path is saved as soon as it is finished; a killed run
        resumes from them and agrees with an uninterrupted run to within the tolerance of the solver
    workers : number of processes, or the address of a Dask scheduler; the result does not depend on it
    report : called as report(stage, share done, text with the relevant quantities)

    Examples
    --------
    >>> import stickslip as ss
    >>> short = ss.scenario(
    ...     experiment="sphere-shear",
    ...     packings=1,
    ...     packing={"grains": 30},
    ...     shear={"strain": (0.0, 1e-4), "step": 5e-5},
    ...     release={"duration": 100.0},
    ... )
    >>> simulate_shear(short, workers=1).paths[0].pairs.shape
    (3,)
    """
    seeds = [scenario.seed + k for k in range(scenario.packings)]
    kept = checkpoint_in(folder, scenario, ShearPath, Step, PackingInfo, Onset, Released, Growth)

    def run(stage: str, function: Callable, tasks: list[Task]) -> Realizations:
        return run_realizations(function, tasks, stage=stage, workers=workers, report=report, describe=_describe_member)

    sheared = run("quasi-static shear", shear_packing, [
        Task(f"packing {seed}", (scenario, seed, kept and kept.of(f"packing-{seed}")), f"packing-{seed}", kept)
        for seed in seeds
    ])  # fmt: skip
    paths = sheared.successful("packing")
    starts = [(scenario, p.seed, p.single, p.single_strain) for p in paths]
    starts += [(scenario, p.seed, p.last, float(p.strain[-1])) for p in paths]
    wanted = [k for k, (*_, state, _) in enumerate(starts) if state is not None]
    wanted = [k for k in wanted if k < len(paths) or paths[k - len(paths)].pairs[-1]]
    runs = run("Newtonian runs", _release, [
        Task(f"packing {starts[k][1]} released at strain {starts[k][3]:g}", starts[k], f"released-{k:04d}", kept)
        for k in wanted
    ])  # fmt: skip
    released: list[Released | None] = [None] * len(starts)
    for k, result in zip(wanted, runs.results, strict=True):
        released[k] = result
    single, later = released[: len(paths)], released[len(paths) :]
    return ShearResult(scenario, make_law(scenario.law), paths, single, later, sheared.failures + runs.failures)


def _describe_member(member: Member) -> str:
    """Describe the outcome of a finished member."""
    result = member.result
    if member.failure:
        return member.failure
    if isinstance(result, Released):
        fitted = f", fitted {result.growth.growth_rate:.2e}" if result.growth else ""
        return (
            f"strain {result.strain:.2e}: growth rate {result.growth_rate:.2e}{fitted}, M = {result.msd[-1]:.0e}, "
            f"{result.contacts_lost} contacts lost"
        )
    born = f"first pair at {result.onset.strain:.3e}" if result.onset else "no first pair located"
    return f"packing {result.seed}: {born}, {result.pairs[-1]:.0f} pairs at {result.strain[-1]:.2e}"


def _release(scenario: ShearScenario, seed: int, state: State, strain: float, report) -> Released:
    how = scenario.release.model_dump()
    made = release(state, make_law(scenario.law), seed=seed, velocity=how.pop("seed_velocity"), report=report, **how)
    return made._replace(strain=strain)
