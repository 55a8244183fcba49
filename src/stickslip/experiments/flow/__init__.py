"""Granular flows: pouring, walls, plates, gates and gravity, in stages."""

from functools import partial

from ...builtin_laws import BY_NAME
from ...lazy import attach
from ..experiment import Experiment, lazy_function
from ..sources import law_references
from .scenario import FlowScenario

_here = partial(lazy_function, __name__)


def references(scenario: FlowScenario) -> dict[str, tuple[str, ...]]:
    """Return keys of references.bib, grouped by purpose."""
    law = scenario.law
    dashpots = law.damping or BY_NAME[law.kind].damping
    damped = law.restitution is not None or law.damping_n or law.damping_t
    more = ("Silbert2001",) if damped and dashpots != "velocity" else ()
    contact = law_references(law)
    return {
        "contact law": contact + tuple(key for key in more if key not in contact),
        "inertial number of plane shear": ("GDRMiDi2004",) if scenario.plates else (),
    }


EXPERIMENT = Experiment(
    scenario=FlowScenario,
    words="granular flows: pouring, walls, plates and gates, in stages",
    simulate=_here("simulate.simulate_on_workers"),
    numbers=_here("report.numbers"),
    measures=_here("report.measures"),
    show=_here("report.show"),
    figures=_here("report.figures"),
    references=references,
    files=_here("report.files"),
    parallel=False,
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
