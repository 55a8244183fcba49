"""A spring-slider with rate-and-state friction."""

from functools import partial

from ....kit import Experiment, attach, lazy_function, lazy_functions
from ..friction.laws import REFERENCES
from .scenario import RateStateScenario

_here = partial(lazy_function, __name__)


def references(scenario: RateStateScenario) -> dict[str, tuple[str, ...]]:
    """Return keys of references.bib, grouped by purpose."""
    surface = scenario.surface
    more = ("Linker1992",) if surface.alpha else ()
    more += ("Rice2001",) if surface.form == "regularized" else ()
    more += ("Okubo1989",) if surface.v1 or surface.v2 else ()
    more += ("Gu1984",) if surface.b2 else ()
    return {"rate-and-state friction": REFERENCES[surface.law] + more}


EXPERIMENT = Experiment(
    scenario=RateStateScenario,
    words="a spring-slider with rate-and-state friction",
    simulate=_here("simulate.simulate_slider"),
    **lazy_functions(__name__, "report", "numbers", "show", "figures", "files"),
    measures=_here("report.MEASURES"),
    references=references,
    writes=(r"series\.csv",),
    compare=_here("report.compare"),
    compares=("cycles.png",),
    smallest=({},),
    parallel=False,
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
