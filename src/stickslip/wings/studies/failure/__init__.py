"""Failure of a packing from a file, sheared or compressed from its current state, with forecasts of the next event."""

from functools import partial

from .... import examples
from ....kit import Experiment, attach, lazy_function, lazy_functions
from .scenario import FailureScenario

_here = partial(lazy_function, __name__)


def references(scenario: FailureScenario) -> dict[str, tuple[str, ...]]:
    """Return keys of references.bib, grouped by purpose."""
    return {"complex pairs of a sheared packing": ("Bonfanti2020",)}


SMALLEST = {
    "packing": {"file": str(examples.path("sheared_spheres.npz"))},
    "law": {"mu": 10.0},
    "shear": {"until": 1e-5, "step": 1e-5},
}

EXPERIMENT = Experiment(
    scenario=FailureScenario,
    words="when a packing from a file fails: first pair, first event, forecasts",
    simulate=_here("simulate.simulate_failure"),
    **lazy_functions(__name__, "simulate", "numbers", "show", "figures", "files"),
    measures=_here("simulate.MEASURES"),
    references=references,
    writes=(r"(curve|pairs|events|contacts|breaks|forecasts)\.csv",),
    smallest=(SMALLEST,),
    parallel=False,
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
