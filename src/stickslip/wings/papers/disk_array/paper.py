"""Reproduction of Charan et al. 2020: the transition from static to dynamic friction in an array of disks.

Charan, Chattoraj, Pica Ciamarra, Procaccia, doi:10.48550/arXiv.1908.11724. Units: 2R = m = k_n = 1, forces in the
paper's numbers (a force of 1 is 1/2000 here, as k_n = 2000 there), time in √(m/(k_n √(2R))).

There are two scenarios. `main` is the printed model with I0 = 1/2, the value for a disk. `quarter` is a hypothesis
found by a search, with no documented justification: the disk–disk normal stiffness is a quarter of the printed one, and
I0 = 1. It is labelled as a hypothesis everywhere.
"""

from typing import NamedTuple

from ....data.checkpoint import UNFINISHED
from ....kit import (
    Checkpoint,
    Claim,
    Report,
    Task,
    Workers,
    make_law,
    note_quick_run,
    open_device,
    run_realizations,
    silent,
    validate_scenario,
    within,
)
from ....results import KineticThreshold
from .arrest import Arrest, find_arrests, kick_array
from .claims import evaluate_claims
from .printed import FRONT_LOADS, STABLE_LOAD
from .scenario import DiskArrayScenario
from .simulate import BIRTHS, FREE, RAMP, DiskArrayResult, add_sliding, open_checkpoint, simulate_before_sliding

MODELS, PUSHED = ("printed", "quarter"), "ramps and free runs"  # the name of a stage
SHARES = {RAMP: (0.0, 0.6), BIRTHS: (0.6, 0.8), FREE: (0.8, 1.0)}  # of the work before sliding, in a quick run


class Reproduction(NamedTuple):
    """Results of both scenarios and the evaluated claims."""

    main: DiskArrayResult
    quarter: DiskArrayResult
    arrests: list[Arrest]  # of the main scenario
    threshold: KineticThreshold  # likewise
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> DiskArrayScenario:
    """Return the scenario of the printed model: N = 10, μ = 10, k_t = 2/7 k_n, smooth Coulomb, F_y = 0.1."""
    return validate_scenario(
        DiskArrayScenario,
        seed=seed,
        load={"push": (0.0, 0.12), "step": 5e-4},
        dynamics={"duration": 30_000.0 if quick else 60_000.0, "watch": 0.083},
        sliding={
            "loads": (*FRONT_LOADS, 0.095, 0.1, 0.12),
            "realizations": 16 if quick else 200,
            "duration": 25_000.0 if quick else 40_000.0,
        },
    )


def quarter_scenario(*, quick: bool = False, seed: int = 0) -> DiskArrayScenario:
    """Return the hypothetical scenario: disk–disk normal stiffness divided by four, I0 = 1, the rest as printed."""
    main = paper_scenario(quick=quick, seed=seed)
    return validate_scenario(
        DiskArrayScenario,
        seed=seed,
        array={"i0": 1.0},
        law={"kn": 0.25, "wall": {"kn": 1.0}},
        load=main.load.model_dump(),
        dynamics={"loads": (STABLE_LOAD,), "duration": main.dynamics.duration},
        sliding=main.sliding.model_dump()
        | {
            "loads": (*FRONT_LOADS, 0.1),
            "realizations": 8 if quick else 100,
            "duration": 60_000.0 if quick else 80_000.0,
        },
    )


def reproduce(
    *,
    quick: bool = False,
    seed: int = 0,
    folder=None,
    workers: Workers = None,
    device: str | None = None,
    report: Report = silent,
) -> Reproduction:
    """Run both scenarios and evaluate every claim of the paper.

    Parameters
    ----------
    quick : use fewer realizations and shorter runs
    seed : seed of all random velocities
    workers : number of processes for the realizations, or the address of a Dask scheduler
    device : "cuda": realizations of sliding run on a graphics processor; see `simulate_disk_array` for errors
    report : called as report(stage, share done, text)
    """
    ones = paper_scenario(quick=quick, seed=seed), quarter_scenario(quick=quick, seed=seed)
    where = device and open_device(device, make_law(ones[0].law))
    folders = folder, folder and folder / UNFINISHED / "quarter"
    kept = [open_checkpoint(*here) for here in zip(folders, ones, strict=True)]
    tasks = [Task(name, (name, *case), name, None) for name, *case in zip(MODELS, ones, kept, strict=True)]
    report(PUSHED, 0.0, f"models: {', '.join(MODELS)}")
    main, quarter = run_realizations(_before_sliding, tasks, stage=PUSHED, workers=workers, report=report).complete
    main = add_sliding(main, kept[0], workers, report, where)
    quarter = add_sliding(quarter, kept[1], workers, within(report, prefix="quarter: "), where)
    threshold = kick_array(main, quick=quick, folder=folder, workers=workers, report=report)
    arrests = find_arrests(main, folder)
    report("claims", 0.0, "births by bisection, for four load steps")
    claims = evaluate_claims(main, quarter, arrests, threshold, workers, report)
    return Reproduction(main, quarter, arrests, threshold, note_quick_run(claims) if quick else claims)


def _before_sliding(name: str, scenario: DiskArrayScenario, kept: Checkpoint | None, report: Report) -> DiskArrayResult:
    def tell(stage: str, share: float, text: str) -> None:
        within(report, *SHARES[stage], prefix=f"{name}: ")(stage, share, text)

    return simulate_before_sliding(scenario, kept, report=tell)
