"""Catalogue of events in sheared packings: their classes, and the quantities that announce them."""

from functools import partial

from ....kit import Experiment, attach, law_references, lazy_function, lazy_functions
from .scenario import CatalogueScenario

_here = partial(lazy_function, __name__)


def references(scenario: CatalogueScenario) -> dict[str, tuple[str, ...]]:
    """Keys of references.bib, grouped by purpose."""
    return {
        "eigenvalues of frictional packings before events": ("Ishima2022",),
        "skill of predictors": ("Hanley1982",),
        "contact law": law_references(scenario.law),
    }


SMALLEST = {
    "events": 1,
    "packings": 1,
    "packing": {"grains": 20, "dim": 2, "packing_fraction": 0.9},
    "shear": {"drag": 0.1, "strain": 4e-4, "step": 2e-4, "window": 2e-4},
}

EXPERIMENT = Experiment(
    scenario=CatalogueScenario,
    words="events of sheared packings, and their precursors",
    simulate=_here("simulate.simulate_catalogue"),
    **lazy_functions(__name__, "simulate", "numbers", "show", "figures", "files"),
    measures=_here("simulate.MEASURES"),
    references=references,
    writes=(r"(events|steps)\.csv",),
    smallest=(SMALLEST,),
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
