"""McNamara & Herrmann 2006: quasi-rigid disks under biaxial load or shear, with a unique contact status."""

from functools import partial

from ....kit import Experiment, Paper, attach, law_references, lazy_function, lazy_functions
from .scenario import QuasiScenario

_here = partial(lazy_function, __name__)


def references(scenario: QuasiScenario) -> dict[str, tuple[str, ...]]:
    """Keys of references.bib, grouped by purpose."""
    return {"the experiment and its method": ("McNamara2006",), "contact law": law_references("linear")}


SMALLEST = {
    "samples": 1,
    "disks": {"number": 40},
    "loading": {"test": "shear", "ratio": 0.02, "increment": 0.25},
    "dynamics": {"times": []},
}
BETWEEN_WALLS = {
    "samples": 1,
    "disks": {"number": 60},
    "loading": {"test": "biaxial", "factor": 1.001, "increment": 0.1},
    "dynamics": {"times": []},
}

EXPERIMENT = Experiment(
    scenario=QuasiScenario,
    words="McNamara & Herrmann 2006: disks under biaxial load",
    simulate=_here("simulate.simulate_quasi"),
    **lazy_functions(__name__, "report", "numbers", "show", "figures", "files"),
    measures=_here("report.MEASURES"),
    references=references,
    writes=(r"(series|collapses)\.csv",),
    smallest=(SMALLEST, BETWEEN_WALLS),
    paper=Paper(
        title="McNamara & Herrmann 2006: quasi-rigidity",
        cuts=(
            "2 packings of 60 disks instead of 5 of 100; slow dynamics of 1e4, 2e4 and 4e4 time units instead of "
            "3e4, 1e5, 3e5 and 1e6; load increments of 2e-3 instead of 1e-3; 60 constructed cases of each"
            " kind instead of 500"
        ),
        scenario=_here("claims.paper_scenario"),
        reproduce=_here("claims.reproduce"),
        shows=_here("claims.SHOWS"),
    ),
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
