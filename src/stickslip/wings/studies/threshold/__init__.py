"""Static and kinetic friction of a sample: the load above which kicks make it slide, and that at which it stops."""

from functools import partial

from ....kit import Experiment, attach, law_references, lazy_function, lazy_functions
from .scenario import ThresholdScenario

_here = partial(lazy_function, __name__)


def references(scenario: ThresholdScenario) -> dict[str, tuple[str, ...]]:
    """Return keys of references.bib, grouped by purpose."""
    sample = scenario.sample
    kind = {
        "disk-array": ("the sample", ("Charan2020",)),
        "packing": ("the sample", ("Bonfanti2020",)),
        "gouge": ("the sample (from the supplement to the first)", ("Ferdowsi2021", "Ferdowsi2020")),
    }
    law = "hertz_mindlin_reff" if sample.kind == "gouge" else sample.law
    return dict([kind[sample.kind], ("contact law", law_references(law))])


SMALLEST = (
    {
        "sample": {"kind": "disk-array", "disks": 3},
        "load": {"loads": [0.01], "step": 0.01},
        "kicks": {"velocities": [1e-6], "realizations": 1, "duration": 20.0},
    },
    {
        "sample": {"kind": "packing", "grains": 20, "dim": 2, "pressure": 1e-3},
        "load": {"loads": [0.02], "step": 0.02},
        "kicks": {"velocities": [1e-6], "realizations": 1, "duration": 20.0},
    },
)

EXPERIMENT = Experiment(
    scenario=ThresholdScenario,
    words="static and kinetic friction of an array, a packing or gouge",
    simulate=_here("simulate.simulate_threshold"),
    **lazy_functions(__name__, "simulate", "numbers", "show", "figures", "files"),
    measures=_here("simulate.MEASURES"),
    references=references,
    writes=(r"threshold\.csv",),
    smallest=SMALLEST,
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
