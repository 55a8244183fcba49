"""Reproduction of the SEAS benchmark problem BP3-QD: earthquakes on a dipping thrust or normal fault.

Erickson et al. 2023, doi:10.1785/0120220066; description by B. Erickson, J. Jiang and E. Dunham, 1 October 2021. Public
FDRA time series (C. Cattania and Y. Sun, 2020 and 2021, boundary elements of 25 m) exist for a thrust dipping 60° and a
normal fault dipping 30°, at a point 7.5 km down dip and at the surface. None were found for the other dips.
"""

import numpy as np

from ....kit import Claim, Report, claim, note_quick_run, silent, validate_scenario, within
from ..friction.fault_record import YEAR
from .claims import Reproduction
from .scenario import FaultScenario
from .simulate import FaultResult, simulate_cycles

STATION = 7500.0  # distance of the series down dip [m]
SURFACE = (-32e3, -16e3, -8e3, -0.01, 0.01, 8e3, 16e3, 32e3)  # [m]
FINE, QUICK = (25.0, 50.0), (50.0, 62.5)  # cell lengths: main runs, and coarser runs for errors [m]
YEARS = (250.0, 490.0)  # years at which slip [m], shear stress and normal stress [MPa] are compared
PUBLISHED = {
    (60.0, "thrust"): {
        "events": (177.100, 277.342, 334.302, 421.255),  # years
        "cycle": (4, 338.993),  # number of last intervals, and their total in years
        "fault": ((1.05925, 30.01822, 50.50724), (9.40878, 30.69542, 50.65259)),
        "surface": (
            (-16e3, 2.2623, 6.1174),
            (0.01, -3.5007, -3.0403),
            (16e3, -3.8207, -5.7339),
        ),  # in the last year [m]
    },
    (30.0, "normal"): {
        "events": (206.699, 279.214, 391.957, 465.389),
        "cycle": (2, 183.800),
        "fault": ((3.41102, 28.59389, 48.42895), (11.89953, 27.99331, 48.70064)),
        "surface": ((-16e3, -6.0232, -3.7518), (0.01, 4.6949, 2.3838), (16e3, 5.4964, 3.4039)),
    },
}
OTHERS = ((30.0, "thrust"), (60.0, "normal"), (90.0, "thrust"))
TOLERANCE = {
    "state": 1e-6,  # a closed form
    "event": 2e-3,  # relative to the time since the start
    "cycle": 5e-3,  # as for BP1-QD, where codes differ by 0.7 %
    "slip": 5e-3,
    "stress": 2e-3,
    "normal": 1e-3,
    "surface": 5e-3,
}
SHOWS = {"Sec 3": ("initial conditions", "initial-stress"), "Series": ("time series of FDRA", "event-2-60-thrust")}


def paper_scenario(
    *, quick: bool = False, seed: int = 0, dip: float = 60.0, slip: str = "thrust", cell: float | None = None
) -> FaultScenario:
    """Return the scenario for one dip and direction of slip."""
    return validate_scenario(
        FaultScenario, seed=seed, run={"years": 500.0 if quick else 1500.0, "surface": SURFACE},
        line={"cell": cell or (QUICK if quick else FINE)[0], "shear": "in-plane", "dip": dip, "slip": slip},
    )  # fmt: skip


def reproduce(
    *, quick: bool = False, seed: int = 0, folder=None, workers=None, report: Report = silent
) -> Reproduction:
    """Run the benchmark: dips with published series at both cell lengths, others with the coarser cells only."""
    fine, coarse = QUICK if quick else FINE
    cases = [(dip, slip, cell) for cell in (fine, coarse) for dip, slip in PUBLISHED]
    cases += [] if quick else [(dip, slip, coarse) for dip, slip in OTHERS]
    runs = [
        simulate_cycles(
            paper_scenario(quick=quick, seed=seed, dip=dip, slip=slip, cell=cell), folder=folder,
            report=within(report, stage=f"{slip} fault, {dip:g}°, cells of {cell:g} m"),
        )
        for dip, slip, cell in cases
    ]  # fmt: skip
    number = len(PUBLISHED)
    claims = evaluate_claims(runs[:number], runs[number : 2 * number])
    claims += [_recurrence_claim(run) for run in runs[2 * number :]]
    return Reproduction(runs[0], tuple(runs[1:]), note_quick_run(claims) if quick else claims)


def evaluate_claims(fine: list[FaultResult], coarse: list[FaultResult]) -> list[Claim]:
    """Evaluate the claims about published series and recurrence, for runs in the order of `reproduce`.

    The error of a value is its change with coarser cells. If these are less than √2 times as long, the error is larger
    than the change, because the method is of second order.
    """
    state = fine[0].history.state
    theta = float(np.log10(fine[0].history.theta[0, 0]))
    claims = [
        claim(
            "initial-stress", "Sec 3: equation 25; 26.54612 MPa in files of FDRA", 26.546122120666,
            state.prestress[0] / 1e6, "MPa", TOLERANCE["state"], error=0.0,
        ),
        claim(
            "initial-state", "Sec 3: equation 26; 3.903090 in files of FDRA", 3.9030898454309, theta, "log10 s",
            TOLERANCE["state"], error=0.0,
        ),
    ]  # fmt: skip
    for (case, published), run, other in zip(PUBLISHED.items(), fine, coarse, strict=True):
        scale = max(1.0, 1 / ((other.history.fault.cell / run.history.fault.cell) ** 2 - 1))
        for (name, kind, unit, value, mine), (*_, rough) in zip(
            _numbers(run, published), _numbers(other, published), strict=True
        ):
            made = claim(
                f"{name}-{case[0]:g}-{case[1]}", f"Series: FDRA, {case[1]} fault of {case[0]:g}°", value, mine, unit,
                TOLERANCE[kind], error=scale * abs(mine - rough),
            )  # fmt: skip
            claims.append(made)
    return claims


def _numbers(run: FaultResult, published: dict):
    """Yield name, kind, unit, published value and measured value of each number within the duration of the run."""
    history, start, (intervals, length) = run.history, run.history.events.start / YEAR, published["cycle"]
    for k, year in enumerate(published["events"]):
        yield f"event-{k + 1}", "event", "years", year, float(start[k]) if k < len(start) else np.nan
    if run.scenario.run.years > 1000:
        yield "cycle", "cycle", "years", length, float(start[-1] - start[-1 - intervals])

    def at(year: float, place: float, places: np.ndarray, table: np.ndarray) -> float:
        column = int(np.flatnonzero(places == place)[0])
        return float(np.interp(year * YEAR, history.time, table[:, column]))

    stresses = ("stress", "MPa", history.stress / 1e6), ("normal", "MPa", history.normal / 1e6)
    on_fault = ("slip", "m", history.slip), *stresses
    for year, values in zip(YEARS, published["fault"], strict=True):
        for (kind, unit, table), value in zip(on_fault, values, strict=True):
            yield f"{kind}-{year:g}", kind, unit, value, at(year, STATION, history.station, table)
    for place, *moved in published["surface"]:
        where = f"{abs(place) / 1e3:.0f}-km-{'foot' if place < 0 else 'hanging'}"
        for direction, value in zip(("horizontal", "down"), moved, strict=True):
            measured = at(YEARS[-1], place, history.surface, getattr(history, direction))
            yield f"{direction}-{where}", "surface", "m", value, measured


def _recurrence_claim(run: FaultResult) -> Claim:
    """Make a claim about the recurrence of a fault without published series."""
    fault = run.history.fault
    times = ", ".join(f"{time:.2f}" for time in run.history.events.recurrence[-6:] / YEAR)
    note = f"cells of {fault.cell:g} m; last intervals: {times} years"
    return claim(
        f"recurrence-{fault.dip:g}-{fault.slip}", f"Series: {fault.slip} fault of {fault.dip:g}°; we found none", None,
        run.recurrence / YEAR, "years", TOLERANCE["cycle"], note,
    )  # fmt: skip
