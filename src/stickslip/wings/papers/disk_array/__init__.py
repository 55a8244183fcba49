"""Charan et al. 2020: an array of frictional disks on a substrate, from static to dynamic friction."""

from functools import partial

from ....kit import Experiment, Paper, attach, law_references, lazy_function, lazy_functions
from .scenario import DiskArrayScenario

_here = partial(lazy_function, __name__)


def references(scenario: DiskArrayScenario) -> dict[str, tuple[str, ...]]:
    """Keys of references.bib, grouped by purpose."""
    return {"the experiment": ("Charan2020",), "contact law": law_references(scenario.law)}


SMALLEST = {
    "array": {"disks": 3},
    "load": {"push": [0.0, 0.02], "step": 5e-3},
    "dynamics": {"loads": [0.02], "duration": 600.0},
    "sliding": {"loads": [0.02], "realizations": 2, "duration": 600.0},
}

EXPERIMENT = Experiment(
    scenario=DiskArrayScenario,
    words="Charan et al. 2020: ten disks pushed along a substrate",
    simulate=_here("simulate.simulate_with_sensitivity"),
    **lazy_functions(__name__, "report", "numbers", "show", "figures", "files", "failures"),
    measures=_here("report.MEASURES"),
    references=references,
    writes=(r"transition\.gif",),
    device=True,
    smallest=(SMALLEST,),
    paper=Paper(
        title="Charan et al. 2020: an array of frictional disks",
        cuts=(
            "16 realisations of sliding at each load instead of 200 (quarter: 8 instead of 100); M(t) for 30000 "
            "time units instead of 60000; sliding for 25000 instead of 40000 (quarter: 60000 instead of 80000); 8 "
            "kicked runs at each of 4 pushes instead of 20 at 8"
        ),
        scenario=_here("claims.paper_scenario"),
        reproduce=_here("claims.reproduce"),
        shows=_here("claims_of_motion.SHOWS"),
        numbers=_here("report.paper_numbers"),
        figures=_here("report.paper_figures"),
        failures=_here("report.paper_failures"),
    ),
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
