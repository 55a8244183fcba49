"""Granular flows: pouring, walls, plates, gates and gravity, in stages."""

from functools import partial

from ....kit import Experiment, attach, law_references, lazy_function, lazy_functions
from .scenario import FlowScenario

_here = partial(lazy_function, __name__)


def references(scenario: FlowScenario) -> dict[str, tuple[str, ...]]:
    """Return keys of references.bib, grouped by purpose."""
    law = scenario.law
    damped = law.restitution is not None or law.damping_n or law.damping_t
    more = ("Silbert2001",) if damped and law.dashpots != "velocity" else ()
    contact = law_references(law)
    return {
        "contact law": contact + tuple(key for key in more if key not in contact),
        "inertial number of plane shear": ("GDRMiDi2004",) if scenario.plates else (),
    }


_GRAINS = {"number": 40, "mass": 1.0, "polydispersity": 0.1}
_LAW = {"kn": 1e4, "mu": 0.5, "restitution": 0.3}
_SHORT = {"samples": 20, "frames": 4}
SETTLING = _SHORT | {
    "grains": _GRAINS | {"low": [0.0, 0.0], "high": [6.0, 16.0]},
    "gravity": [0.0, -1.0],
    "law": _LAW,
    "walls": [
        {"name": "floor", "point": [0.0, 0.0], "normal": [0.0, 1.0]},
        {"name": "left", "point": [0.0, 0.0], "normal": [1.0, 0.0], "mu": 0.0},
        {"name": "gate", "point": [6.0, 0.0], "normal": [-1.0, 0.0], "mu": 0.0},
    ],
    "stages": [{"name": "settle", "duration": 4.0}],
}
SHEARED = _SHORT | {
    "grains": _GRAINS | {"low": [0.0, 1.0], "high": [8.0, 11.0]},
    "cell": {"size": [8.0, 12.0], "periodic": ["x"]},
    "law": _LAW,
    "plates": [{"name": "bottom", "height": 0.0}, {"name": "top", "height": 12.0, "pressure": 2.0, "mass": 8.0}],
    "stages": [{"name": "shear", "duration": 4.0, "velocity": {"top": {"x": 1.0}}}],
}

EXPERIMENT = Experiment(
    scenario=FlowScenario,
    words="granular flows: pouring, walls, plates and gates, in stages",
    simulate=_here("simulate.simulate_on_workers"),
    **lazy_functions(__name__, "simulate", "numbers", "show", "figures", "files"),
    measures=_here("simulate.MEASURES"),
    references=references,
    writes=(r"series\.csv",),
    smallest=(SETTLING, SHEARED),
    export=_here("pouring.export"),
    parallel=False,
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
