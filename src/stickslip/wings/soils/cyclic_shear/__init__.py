"""Cyclic shear of samples in quasi-static steps: loops, modulus, damping, split of the work, and return of grains."""

from functools import partial

from ....kit import Experiment, attach, law_references, lazy_function, lazy_functions
from .scenario import CyclicShearScenario

_here = partial(lazy_function, __name__)


def references(scenario: CyclicShearScenario) -> dict[str, tuple[str, ...]]:
    """Return keys of references.bib, grouped by purpose."""
    return {"curves of sands": ("Darendeli2001", "Menq2003"), "contact law": law_references(scenario.law)}


DISKS = {"dim": 2, "grains": 50, "pressure": 100.0}
SMALLEST = ({"sample": DISKS, "cycles": {"amplitudes": [1e-6, 1e-5], "number": 2, "steps": 12}},)

EXPERIMENT = Experiment(
    scenario=CyclicShearScenario,
    words="cyclic shear of soils: modulus reduction, damping ratio, hysteresis loops",
    simulate=_here("simulate.simulate_cyclic_shear"),
    **lazy_functions(__name__, "report", "numbers", "show", "figures", "files"),
    measures=_here("report.MEASURES"),
    references=references,
    writes=(r"(cycles|series)\.csv",),
    smallest=SMALLEST,
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
