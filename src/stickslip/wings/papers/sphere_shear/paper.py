"""Reproduction of Bonfanti et al. 2020: oscillatory instabilities of sheared packings of spheres.

Bonfanti, Chattoraj, Guerra, Procaccia, Zapperi, doi:10.1103/PhysRevE.101.052902. Units: 2σ_1 = m = k_n = 1; I0 = 0.4,
k_t = 2/7, μ = 10, smooth Coulomb. The paper does not state the packing fraction; here it is 0.68 for every packing.
"""

from typing import NamedTuple

from ....kit import Claim, Report, Workers, note_quick_run, silent, validate_scenario
from .claims import evaluate_claims
from .scenario import ShearScenario
from .simulate import ShearResult, simulate_shear


class Reproduction(NamedTuple):
    """Result of the scenario and the evaluated claims."""

    main: ShearResult
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> ShearScenario:
    """Return the scenario: N = 100 spheres, radii 0.5 and 0.7, strain steps of 2e-5, then of 1e-4 up to 0.02."""
    if quick:
        return validate_scenario(
            ShearScenario,
            seed=seed,
            packings=4,
            packing={"grains": 40},
            shear={"strain": (0.0, 1e-3, 0.02), "step": (2e-5, 1e-3)},
            release={"e_folds": 25.0, "least": 2e4, "duration": 3e5, "snapshots": 12},
        )
    return validate_scenario(ShearScenario, seed=seed)


def reproduce(*, quick: bool = False, seed: int = 0, folder=None, workers: Workers = None, report: Report = silent):
    """Run the paper's scenario and evaluate its claims; arguments as in `simulate_shear`. Returns a Reproduction."""
    main = simulate_shear(paper_scenario(quick=quick, seed=seed), folder=folder, workers=workers, report=report)
    claims = evaluate_claims(main)
    return Reproduction(main, note_quick_run(claims) if quick else claims)
