"""Paper 003, at a reduced scale: Ferdowsi and Rubin, slide-hold-slide and velocity steps of granular fault gouge.

The paper's cell has about 4800 grains and velocities down to 0.2 mm/s, at time steps of 20 ns: months of one core. Here
a tenth of the grains slides at a tenth of a metre a second. `examples/gouge_paper.toml` is the paper's own scale.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ..data.gouge_scenario import GougeScenario
from ..data.scenario import scenario
from ..ensemble import Workers
from ..loading.gouge_ensemble import GougeResult, simulate_gouge
from .claims import Claim, for_quick_run
from .gouge_claims import FAST, evaluated
from .gouge_report import foretell

CUTS = (
    "4 realizations of 340 grains instead of 16 of 500, in a shorter cell; one hold at 0.3 m/s instead of three; "
    "holds up to 10 ms instead of 50 ms; velocities from 0.1 instead of 0.03 m/s; less slip before it all"
)
MIDDLE, SLOW = 0.1, 0.03  # velocities beside FAST [m/s]

Report = Callable[[str, float, str], None]


class Reproduction(NamedTuple):
    """The scenario, run, its twin with strongly damped contacts, and the claims that both support."""

    main: GougeResult
    damped: GougeResult
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> GougeScenario:
    """Steady sliding, velocity steps down and up, and slides after holds, at the reduced scale."""
    number, length, runs = (340, 0.024, 4) if quick else (500, 0.03, 16)
    velocities = (FAST, MIDDLE, FAST) if quick else (FAST, SLOW, FAST, SLOW, FAST)
    cycle = {
        "kind": "slide-hold-slide", "before": (FAST,), "holds": (1e-3, 1e-2) if quick else (1e-3, 1e-2, 5e-2),
        "after": (FAST,) if quick else (MIDDLE, FAST), "approach": 1.0, "slip": 0.4, "twin": 0.4,
    }  # fmt: skip
    slow = cycle | {"before": (MIDDLE if quick else SLOW,), "after": (MIDDLE, FAST) if quick else (SLOW, MIDDLE, FAST)}
    slow["holds"] = cycle["holds"][-1:]
    return scenario(
        experiment="gouge", seed=seed, realizations=runs, dt=2e-7, sample_every=250, ledger_steps=2000,
        grains={"number": number}, cell={"length": length}, preparation={"slip": 5.0 if quick else 8.0},
        protocol=[
            {"kind": "velocity-steps", "velocities": velocities, "slip": 1.0, "twin": 0.3},
            *[cycle] * (1 if quick else 3),
            slow,
        ],
    )  # fmt: skip


def damped_scenario(chosen: GougeScenario) -> GougeScenario:
    """The same with restitution 0.3: steady sliding, the shorter holds, and slides after them."""
    cycle = chosen.protocol[1]
    protocol = [part.model_dump() for part in chosen.protocol[1:-1][:2]]
    for part in protocol:
        part |= {"holds": cycle.holds[:2], "after": (FAST,)}
    law = chosen.law.model_copy(update={"restitution": 0.3})
    return scenario(**chosen.model_dump() | {"law": law.model_dump(), "protocol": protocol, "ledger_steps": 0})


def reproduce(
    *,
    quick: bool = False,
    seed: int = 0,
    folder: Path | None = None,
    workers: Workers = None,
    report: Report = lambda stage, share, words: None,
) -> Reproduction:
    """Run both scenarios and judge the claims; arguments as in `simulate_gouge`."""
    chosen = paper_scenario(quick=quick, seed=seed)
    foretell(chosen)
    main = simulate_gouge(chosen, folder=folder, workers=workers, report=report)
    second = damped_scenario(chosen)
    damped = simulate_gouge(
        second, folder=folder, workers=workers, report=lambda stage, *rest: report(f"restitution 0.3: {stage}", *rest)
    )
    claims = evaluated(main, damped)
    return Reproduction(main, damped, for_quick_run(claims) if quick else claims)
