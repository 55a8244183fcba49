"""Earthquake cycles on a straight fault; `reproduce` runs the SEAS benchmark problems BP1-QD, BP3-QD and BP6-QD."""

from functools import partial

from ....kit import Experiment, Paper, attach, lazy_function, lazy_functions
from ..friction.laws import REFERENCES
from .scenario import FaultScenario

_here = partial(lazy_function, __name__)


def references(scenario: FaultScenario) -> dict[str, tuple[str, ...]]:
    """Return keys of references.bib, grouped by purpose."""
    cut = scenario.friction.v1 or scenario.friction.v2
    form = ("Okubo1989",) if cut else ("Rice2001",) if scenario.friction.form == "regularized" else ()
    form += ("Gu1984",) if scenario.fault.states > 1 else ()
    return {
        "earthquake cycles": ("Erickson2020", "Rice1993", "Rubin2005"),
        "rate-and-state friction": REFERENCES[scenario.friction.law] + form,
        "time stepping": ("Hairer1993",),
        "magnitudes and stress drops": ("Hanks1979", "Noda2013"),
        **({"dipping faults": ("Erickson2023", "Head1953")} if scenario.fault.dips else {}),
        **({"normal stress that acts on the state": ("Linker1992",)} if scenario.friction.alpha else {}),
        **({"injected fluid": ("Lambert2025",)} if scenario.injection.flux else {}),
    }


SMALLEST = {
    "line": {"width": 2000.0, "cell": 100.0},
    "friction": {"a": 0.010, "normal": 1e7},
    "run": {"years": 1.0, "stations": [0.0]},
}

EXPERIMENT = Experiment(
    scenario=FaultScenario,
    words="earthquake cycles on a straight fault",
    simulate=_here("simulate.simulate_cycles"),
    **lazy_functions(__name__, "report", "numbers", "show", "figures", "files"),
    measures=_here("report.MEASURES"),
    writes=(
        r"events\.csv",
        r"(fltst_dp|srfst_fn[+-])\d+(\.\d+)?\.txt",
        r"(devol|slip|shear_stress|normal_stress)\.dat",
    ),
    compare=_here("report.compare"),
    compares=("cycles.png",),
    references=references,
    smallest=(SMALLEST,),
    parallel=False,
    paper=Paper(
        name="seas-bp1",
        title="SEAS benchmark problem BP1-QD: earthquake cycles on a strike-slip fault",
        cuts="cells of 50 m instead of 25 m, and 700 years instead of 1200; the coarser runs have cells of 100 m",
        scenario=_here("claims.bp1_scenario"),
        reproduce=_here("claims.reproduce_bp1"),
        shows=_here("claims.BP1_SHOWS"),
    ),
    more_papers=(
        Paper(
            name="seas-bp3",
            title="SEAS benchmark problem BP3-QD: earthquake cycles on a dipping fault",
            cuts="cells of 50 m instead of 25 m, 500 years instead of 1500, only dips with published series; the "
            "coarser runs have cells of 62.5 m",
            scenario=_here("claims.bp3_scenario"),
            reproduce=_here("claims.reproduce_bp3"),
            shows=_here("claims.BP3_SHOWS"),
        ),
        Paper(
            name="seas-bp6",
            title="SEAS benchmark problem BP6-QD: aseismic slip due to injected fluid",
            cuts="the slip law with cells of 19.5 m instead of 6.5 m, and samples every 20,000 s instead of 10,000 s",
            scenario=_here("claims.bp6_scenario"),
            reproduce=_here("claims.reproduce_bp6"),
            shows=_here("claims.BP6_SHOWS"),
        ),
    ),
)

__getattr__, __dir__, __all__ = attach(__name__, __file__)
