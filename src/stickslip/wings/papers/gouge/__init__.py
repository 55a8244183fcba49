"""Ferdowsi & Rubin 2021: sheared fault gouge in steady sliding, holds, slides after holds, and velocity steps."""

from functools import partial

from ....kit import Experiment, Paper, attach, law_references, lazy_function, lazy_functions
from ...faults.friction.laws import REFERENCES
from .scenario import GougeScenario

_here = partial(lazy_function, __name__)


def references(scenario: GougeScenario) -> dict[str, tuple[str, ...]]:
    """Keys of references.bib, grouped by purpose."""
    return {
        "the experiment (from the supplement to the first)": ("Ferdowsi2021", "Ferdowsi2020"),
        "contact law": law_references("hertz_mindlin_reff"),
        "rate-and-state friction, for comparison": REFERENCES["aging"],
    }


SMALLEST = {
    "realizations": 1,
    "grains": {"number": 70},
    "cell": {"length": 0.016, "width": 0.016},
    "law": {"damping_n": 1e4},
    "dt": 2e-7,
    "sample_every": 100,
    "ledger_steps": 0,
    "preparation": {"slip": 0.4, "window": 0.2, "change": 1.0, "approach": 10.0, "unbalanced": 0.03},
    "protocol": [
        {
            "kind": "slide-hold-slide", "before": [0.3], "holds": [2e-4, 1e-4], "after": [0.3], "approach": 0.1,
            "slip": 0.1, "twin": 0.0,
        }
    ],
}  # fmt: skip

EXPERIMENT = Experiment(
    scenario=GougeScenario,
    words="Ferdowsi & Rubin 2021: fault gouge",
    simulate=_here("simulate.simulate_gouge"),
    **lazy_functions(__name__, "report", "numbers", "show", "figures", "files", "announce"),
    measures=_here("report.MEASURES"),
    references=references,
    writes=(r"(series|curves|slips|steps_\d+_\d+)\.csv",),
    export=_here("simulate.export"),
    device=True,
    smallest=(SMALLEST,),
    paper=Paper(
        title="Ferdowsi & Rubin 2021: fault gouge",
        cuts=(
            "2 samples of 300 grains with 2 states each, instead of 8 of 500 with 3; holds of 0.1 s instead of 1 s, "
            "after less slip and with no slides after them; two damping values instead of three"
        ),
        scenario=_here("paper.paper_scenario"),
        reproduce=_here("paper.reproduce"),
        shows=_here("claims.SHOWS"),
        figures=_here("report.paper_figures"),
        files=_here("report.paper_files"),
        failures=_here("report.paper_failures"),
    ),
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
