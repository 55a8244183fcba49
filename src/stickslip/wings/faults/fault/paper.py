"""Reproduction of the SEAS benchmark problem BP1-QD.

Erickson et al. 2020, doi:10.1785/0220190248; description by B. Erickson and J. Jiang, 13 April 2018.
"""

from pathlib import Path
from typing import NamedTuple

from ....kit import Claim, Report, Workers, note_quick_run, silent, validate_scenario, within
from .claims import evaluate_claims
from .scenario import FaultScenario
from .simulate import FaultResult, simulate_cycles


class Reproduction(NamedTuple):
    """Result of the benchmark, results with longer cells, and the evaluated claims."""

    main: FaultResult
    coarser: tuple[FaultResult, ...]  # cells of twice the length, and so on
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0, cell: float | None = None) -> FaultScenario:
    """Return the scenario: cells of 25 m and 1200 of the 3000 years, which are periodic from the fifth event on."""
    cell = cell or (50.0 if quick else 25.0)
    return validate_scenario(FaultScenario, seed=seed, line={"cell": cell}, run={"years": 700.0 if quick else 1200.0})


def reproduce(
    *, quick: bool = False, seed: int = 0, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> Reproduction:
    """Run the benchmark and evaluate its claims; arguments as in `simulate_cycles`."""
    main = simulate_cycles(paper_scenario(quick=quick, seed=seed), folder=folder, report=report)
    coarser = []
    for cell in (100.0,) if quick else (50.0, 100.0):
        scenario = paper_scenario(quick=quick, seed=seed, cell=cell)
        coarser.append(simulate_cycles(scenario, folder=folder, report=within(report, stage=f"cells of {cell:g} m")))
    claims = evaluate_claims(main, tuple(coarser))
    return Reproduction(main, tuple(coarser), note_quick_run(claims) if quick else claims)
