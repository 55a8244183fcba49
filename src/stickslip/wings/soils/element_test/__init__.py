"""Element tests: triaxial, oedometric, undrained and other tests of soil samples, as in engineering practice."""

from functools import partial

from ....kit import Experiment, attach, law_references, lazy_function, lazy_functions
from .scenario import ElementTestScenario

_here = partial(lazy_function, __name__)


def references(scenario: ElementTestScenario) -> dict[str, tuple[str, ...]]:
    """Return keys of references.bib, grouped by purpose."""
    return {
        "stress and dilatancy": ("Rowe1962",),
        "inertial number": ("GDRMiDi2004",),
        "contact law": law_references(scenario.law),
    }


DISKS = {"dim": 2, "grains": 50, "pressure": 100.0}
SMALLEST = (
    {"sample": DISKS, "path": {"strain": 2e-3, "step": 1e-3}, "probes": {"states": 1, "directions": 8}},
    {"sample": DISKS, "path": {"strain": 1e-4, "integrator": "dynamic", "inertial_number": 1e-3}},
)

EXPERIMENT = Experiment(
    scenario=ElementTestScenario,
    words="element tests of soils: triaxial, oedometric, undrained, simple shear",
    simulate=_here("simulate.simulate_element_test"),
    **lazy_functions(__name__, "report", "numbers", "show", "figures", "files"),
    measures=_here("measures.MEASURES"),
    references=references,
    writes=(r"(series|probes|envelopes|breaks)\.csv",),
    overlay=_here("laboratory.overlay"),
    compare=_here("report.compare"),
    compares=("mohr.png", "mohr.csv", "critical_state.png"),
    smallest=SMALLEST,
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
