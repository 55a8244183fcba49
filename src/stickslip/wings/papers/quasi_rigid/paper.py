"""Reproduction of McNamara & Herrmann 2006, Quasi-rigidity: some uniqueness issues.

The paper contains proofs and prints no numbers. Its biaxial test is run here with the linear law, K_t = K_n/2 and
μ = 1/2 at P/K_n = 1e-4. Units: K_n = 1, mean diameter 1, and a disk density of 4/π.
"""

from typing import NamedTuple

from ....kit import Claim, Report, Workers, note_quick_run, silent, validate_scenario
from .claims import CASES, evaluate_claims
from .scenario import QuasiScenario
from .simulate import QuasiResult, simulate_quasi

QUICK_CASES = 60


class Reproduction(NamedTuple):
    """Result of the scenario and the evaluated claims."""

    main: QuasiResult
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> QuasiScenario:
    """Return the biaxial test: the force on the lid grows, at most fourfold, until stability is lost."""
    loading = {"test": "biaxial", "factor": 4.0, "increment": 2e-3 if quick else 1e-3, "unload": True}
    if quick:
        return validate_scenario(
            QuasiScenario, seed=seed, samples=2, disks={"number": 60}, loading=loading,
            dynamics={"times": (1e4, 2e4, 4e4)},
        )  # fmt: skip
    return validate_scenario(
        QuasiScenario, seed=seed, samples=5, disks={"number": 100}, loading=loading,
        dynamics={"times": (3e4, 1e5, 3e5, 1e6)},
    )  # fmt: skip


def reproduce(*, quick: bool = False, seed: int = 0, folder=None, workers: Workers = None, report: Report = silent):
    """Run the paper's scenario and evaluate its claims; arguments as in `simulate_quasi`. Returns a Reproduction."""
    main = simulate_quasi(paper_scenario(quick=quick, seed=seed), folder=folder, workers=workers, report=report)
    report("constructed cases", 0.0, "statuses and the apex")
    claims = evaluate_claims(main, cases=QUICK_CASES if quick else CASES, quick=quick)
    return Reproduction(main, note_quick_run(claims) if quick else claims)
