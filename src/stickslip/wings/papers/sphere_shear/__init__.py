"""Bonfanti et al. 2020: quasi-static shear of packings, growth of an oscillatory instability, and failure."""

from functools import partial

from ....kit import Experiment, Paper, attach, law_references, lazy_function, lazy_functions
from .scenario import ShearScenario

_here = partial(lazy_function, __name__)


def references(scenario: ShearScenario) -> dict[str, tuple[str, ...]]:
    """Keys of references.bib, grouped by purpose."""
    return {"the experiment": ("Bonfanti2020",), "contact law": law_references(scenario.law)}


SMALLEST = {
    "packings": 1,
    "packing": {"grains": 30},
    "shear": {"strain": [0.0, 1e-4], "step": 5e-5},
    "release": {"duration": 100.0},
}

EXPERIMENT = Experiment(
    scenario=ShearScenario,
    words="Bonfanti et al. 2020: sheared packings of spheres",
    simulate=_here("simulate.simulate_shear"),
    **lazy_functions(__name__, "report", "numbers", "show", "figures"),
    measures=_here("report.MEASURES"),
    references=references,
    smallest=(SMALLEST,),
    paper=Paper(
        title="Bonfanti et al. 2020: sheared packings of spheres",
        cuts=(
            "4 packings of 40 spheres instead of 5 of 100; strain steps of 1e-3 beyond 1e-3 instead of 1e-4 beyond "
            "2e-3; Newtonian runs of 25 growth times (at least 2e4 time units) instead of 45 (5e4); 12 spectra per run "
            "instead of 40"
        ),
        scenario=_here("claims.paper_scenario"),
        reproduce=_here("claims.reproduce"),
        shows=_here("claims.SHOWS"),
    ),
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
