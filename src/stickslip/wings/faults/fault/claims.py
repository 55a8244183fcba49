"""Reproductions of the SEAS benchmark problems BP1-QD, BP3-QD and BP6-QD, and their claims.

BP1-QD, earthquakes on a vertical strike-slip fault: Erickson et al. 2020, doi:10.1785/0220190248; description by B.
Erickson and J. Jiang, 13 April 2018, which prints rough numbers as a "sanity check". Recurrence is compared with the
time series that three groups uploaded to the SEAS platform: HBI (S. Ozawa, 2024, boundary elements of 10 m in a
half-space) 78.34 years, tandem (C. Uphoff, 2021, discontinuous Galerkin method) 78.28 years, and BICyclE (J. Jiang,
2018, spectral boundary elements of 25 m, periodic) 78.85 years. Each value follows from the times of two events, which
are 11, 28 and 30 intervals apart, respectively.

BP3-QD, earthquakes on a dipping thrust or normal fault: Erickson et al. 2023, doi:10.1785/0120220066; description by B.
Erickson, J. Jiang and E. Dunham, 1 October 2021. Public FDRA time series (C. Cattania and Y. Sun, 2020 and 2021,
boundary elements of 25 m) exist for a thrust dipping 60° and a normal fault dipping 30°, at a point 7.5 km down dip and
at the surface. None were found for the other dips.

BP6-QD, aseismic slip due to fluid injected into a fault: Lambert et al. 2025, doi:10.1029/2024JB030601. The parameters
are those of the public inputs of tandem, RSFaultZ and QDBIM, which agree. Results are compared with a public copy of
the CYCLAPS series (P. Dublanchet, 2024), which exist for the aging law only. Their pressures show that "z = 0" is the
cell beside the source, 9.77 m away, and "z = 0.5 km" is 50 cells away.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....kit import Claim, Report, Workers, claim, note_quick_run, silent, validate_scenario, within
from ..friction.fault_record import YEAR
from .scenario import FaultScenario
from .simulate import SETTLING, FaultResult, simulate_cycles


class Reproduction(NamedTuple):
    """Benchmark result, results with longer cells, and evaluated claims."""

    main: FaultResult
    coarser: tuple[FaultResult, ...]  # results with cells twice as long, four times as long …
    claims: list[Claim]


def bp1_scenario(*, quick: bool = False, seed: int = 0, cell: float | None = None) -> FaultScenario:
    """Return the scenario with 25 m cells, for 1200 years instead of 3000; events are periodic from the fifth on."""
    cell = cell or (50.0 if quick else 25.0)
    return validate_scenario(FaultScenario, seed=seed, line={"cell": cell}, run={"years": 700.0 if quick else 1200.0})


def reproduce_bp1(
    *, quick: bool = False, seed: int = 0, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> Reproduction:
    """Run the benchmark and evaluate its claims; the arguments are those of `simulate_cycles`."""
    main = simulate_cycles(bp1_scenario(quick=quick, seed=seed), folder=folder, report=report)
    coarser = []
    for cell in (100.0,) if quick else (50.0, 100.0):
        scenario = bp1_scenario(quick=quick, seed=seed, cell=cell)
        coarser.append(simulate_cycles(scenario, folder=folder, report=within(report, stage=f"cells of {cell:g} m")))
    claims = bp1_claims(main, tuple(coarser))
    return Reproduction(main, tuple(coarser), note_quick_run(claims) if quick else claims)


BP1_SHOWS = {
    "Sec 3": ("initial conditions", "initial-stress"),
    "Sec 4": ("time series of other codes", "recurrence"),
    "Sec 7": ("sanity check", "surface-slip"),
    "Abstract": ("periodic earthquakes", "periodic"),
}
BP1_TOLERANCE = {
    "initial": 1e-6,  # closed forms
    "recurrence": 0.005,  # the codes differ by 0.7 %
    "time": 0.005,
    "rough": 0.25,  # the description prints "∼" and one digit
    "depth": 0.1,  # "∼12–13 km" and "∼18 km"
}
PERIODIC = 1e-3  # relative spread of settled recurrence times below which the sequence is periodic
HBI_FOURTH = 428.069  # year of the fourth event in the series of HBI


def bp1_claims(main: FaultResult, coarser: tuple[FaultResult, ...]) -> list[Claim]:
    """Evaluate all claims; the error of a value is its change when cells are twice as long."""
    return [
        claim(
            "initial-stress", "Sec 3: equation 11; 26.546122 MPa in files of other codes", 26.546122120666,
            main.history.state.prestress[0] / 1e6, "MPa", BP1_TOLERANCE["initial"], error=0.0,
        ),
        claim(
            "initial-state", "Sec 3: equation 12; 3.9030898454 in files of other codes", 3.9030898454309,
            float(np.log10(main.history.theta[0, 0])), "log10 s", BP1_TOLERANCE["initial"], error=0.0,
        ),
        *_recurrence_claims(main, coarser), *_event_claims(main, coarser),
    ]  # fmt: skip


def _error(function, main: FaultResult, coarser: tuple[FaultResult, ...]) -> float:
    return abs(function(main) - function(coarser[0]))


def _recurrence_claims(main: FaultResult, coarser: tuple[FaultResult, ...]) -> list[Claim]:
    def recurrence(result: FaultResult) -> float:
        return result.recurrence / YEAR

    def fourth(result: FaultResult) -> float:
        return float(result.history.events.start[SETTLING]) / YEAR

    intervals = main.late_events.recurrence / YEAR
    runs = (main, *coarser)
    cells = ", ".join(f"{recurrence(run):.3f} with {run.history.fault.cell:g} m" for run in runs)
    error = _error(recurrence, main, coarser)
    return [
        claim(
            "recurrence", "Sec 4: series of other codes: HBI 78.34, tandem 78.28, BICyclE 78.85 years", 78.34,
            recurrence(main), "years", BP1_TOLERANCE["recurrence"], f"cells: {cells}", error=error,
        ),
        claim(
            "fourth-event", "Sec 4: series of other codes: HBI, year of the fourth event", HBI_FOURTH, fourth(main),
            "years", BP1_TOLERANCE["time"], error=_error(fourth, main, coarser),
        ),
        claim(
            "recurrence-rough", 'Sec 7: "every ∼100 years"', 100.0, recurrence(main), "years", BP1_TOLERANCE["rough"],
            "the description expects about 30 earthquakes in 3000 years; the three codes give one in 78 or 79 years",
            error=error,
        ),
        claim(
            "periodic", 'Abstract: "earthquakes with periodic occurrences (BP1)"', True,
            bool(np.ptp(intervals[1:]) < PERIODIC * intervals.mean()) if len(intervals) > 2 else None, "", 0.0,
            f"intervals from the fourth event on: {', '.join(f'{interval:.3f}' for interval in intervals)} years",
        ),
    ]  # fmt: skip


def _event_claims(main: FaultResult, coarser: tuple[FaultResult, ...]) -> list[Claim]:
    def of(name: str, size: float = 1.0):
        return lambda result: float(getattr(result.late_events, name).mean()) / size

    def compare(id: str, source: str, paper: float, measure, unit: str, tolerance: str, note: str = "") -> Claim:
        error = _error(measure, main, coarser)
        return claim(id, f"Sec 7: {source}", paper, measure(main), unit, BP1_TOLERANCE[tolerance], note, error=error)

    plates = main.recurrence * main.scenario.loading.plate_rate
    return [
        compare("nucleation-depth", '"nucleate at a depth of ∼12–13 km"', 12.5, of("depth", 1e3), "km", "depth"),
        compare("arrest-depth", '"arrest at a depth of ∼18 km"', 18.0, of("bottom", 1e3), "km", "depth"),
        compare(
            "surface-slip", '"surface slip of ∼3 m"', 3.0, of("surface_slip"), "m", "rough",
            f"plate motion between two events is {plates:.4f} m",
        ),
        compare("surface-velocity", '"max surface slip rate of ∼5 m/s"', 5.0, of("surface_velocity"), "m/s", "rough"),
    ]  # fmt: skip


STATION = 7500.0  # distance down dip of the published series [m]
SURFACE = (-32e3, -16e3, -8e3, -0.01, 0.01, 8e3, 16e3, 32e3)  # distances of stations from the trace [m]
CELLS, QUICK_CELLS = (25.0, 50.0), (50.0, 62.5)  # cell lengths: main runs, and coarser runs for errors [m]
YEARS = (250.0, 490.0)  # years at which slip [m], shear stress and normal stress [MPa] are compared
FDRA = {
    (60.0, "thrust"): {
        "events": (177.100, 277.342, 334.302, 421.255),  # years
        "cycle": (4, 338.993),  # number of intervals before the last event, and their total in years
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
BP3_TOLERANCE = {
    "state": 1e-6,  # a closed form
    "event": 2e-3,  # relative to the time since the start
    "cycle": 5e-3,  # as for BP1-QD, where codes differ by 0.7 %
    "slip": 5e-3,
    "stress": 2e-3,
    "normal": 1e-3,
    "surface": 5e-3,
}
BP3_SHOWS = {"Sec 3": ("initial conditions", "initial-stress"), "Series": ("time series of FDRA", "event-2-60-thrust")}


def bp3_scenario(
    *, quick: bool = False, seed: int = 0, dip: float = 60.0, slip: str = "thrust", cell: float | None = None
) -> FaultScenario:
    """Return the scenario for one dip and direction of slip."""
    return validate_scenario(
        FaultScenario, seed=seed, run={"years": 500.0 if quick else 1500.0, "surface": SURFACE},
        line={"cell": cell or (QUICK_CELLS if quick else CELLS)[0], "shear": "in-plane", "dip": dip, "slip": slip},
    )  # fmt: skip


def reproduce_bp3(
    *, quick: bool = False, seed: int = 0, folder=None, workers=None, report: Report = silent
) -> Reproduction:
    """Run the benchmark: both cell lengths for dips with published series, only the coarser cells for the others."""
    fine, coarse = QUICK_CELLS if quick else CELLS
    cases = [(dip, slip, cell) for cell in (fine, coarse) for dip, slip in FDRA]
    cases += [] if quick else [(dip, slip, coarse) for dip, slip in OTHERS]
    runs = [
        simulate_cycles(
            bp3_scenario(quick=quick, seed=seed, dip=dip, slip=slip, cell=cell), folder=folder,
            report=within(report, stage=f"{slip} fault, {dip:g}°, cells of {cell:g} m"),
        )
        for dip, slip, cell in cases
    ]  # fmt: skip
    number = len(FDRA)
    claims = bp3_claims(runs[:number], runs[number : 2 * number])
    for run in runs[2 * number :]:  # without published series
        fault, last = run.history.fault, run.history.events.recurrence[-6:] / YEAR
        note = f"cells of {fault.cell:g} m; last intervals: {', '.join(f'{time:.2f}' for time in last)} years"
        claims.append(claim(
            f"recurrence-{fault.dip:g}-{fault.slip}", f"Series: {fault.slip} fault of {fault.dip:g}°; we found none",
            None, run.recurrence / YEAR, "years", BP3_TOLERANCE["cycle"], note,
        ))  # fmt: skip
    return Reproduction(runs[0], tuple(runs[1:]), note_quick_run(claims) if quick else claims)


def bp3_claims(fine: list[FaultResult], coarse: list[FaultResult]) -> list[Claim]:
    """Evaluate the claims about published series and recurrence, for runs in the order of `reproduce_bp3`.

    The error of a value is its change with coarser cells. If the coarser cells are less than √2 times as long, the
    error is larger than the change, because the method is of second order.
    """
    state = fine[0].history.state
    theta = float(np.log10(fine[0].history.theta[0, 0]))
    claims = [
        claim(
            "initial-stress", "Sec 3: equation 25; 26.54612 MPa in files of FDRA", 26.546122120666,
            state.prestress[0] / 1e6, "MPa", BP3_TOLERANCE["state"], error=0.0,
        ),
        claim(
            "initial-state", "Sec 3: equation 26; 3.903090 in files of FDRA", 3.9030898454309, theta, "log10 s",
            BP3_TOLERANCE["state"], error=0.0,
        ),
    ]  # fmt: skip
    for (case, published), run, other in zip(FDRA.items(), fine, coarse, strict=True):
        scale = max(1.0, 1 / ((other.history.fault.cell / run.history.fault.cell) ** 2 - 1))
        for (name, kind, unit, value, mine), (*_, rough) in zip(
            _numbers(run, published), _numbers(other, published), strict=True
        ):
            made = claim(
                f"{name}-{case[0]:g}-{case[1]}", f"Series: FDRA, {case[1]} fault of {case[0]:g}°", value, mine, unit,
                BP3_TOLERANCE[kind], error=scale * abs(mine - rough),
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


HALF, BESIDE = 20e3, 9.765625  # half-length of the fault; distance of the first station: one CYCLAPS cell [m]
FINE, COARSE = 3072, 1024  # numbers of cells
DAY = 86400.0
# time [s], slip [m], log10 of the slip velocity, shear stress and pressure [MPa] at the CYCLAPS stations
CYCLAPS = {
    BESIDE: (
        (112597.63, 2.46491e-7, -11.49413, 29.19997, 0.688495),
        (5938583.9, 9.71039e-3, -8.10676, 28.32044, 5.37384),
        (6897838.2, 2.20767e-2, -7.66729, 27.68244, 5.7963),
        (63066887.0, 0.2092647, -10.27701, 28.07028, 1.257822),
    ),
    50 * BESIDE: ((13003187.44, 0.187216996, -8.632712719, 27.463680359, 3.127105837),),
}
BP6_TOLERANCE = {
    "state": 1e-6,  # a closed form
    "slip": 5e-3,
    "velocity": 1e-3,  # relative to log10 V, so about 0.01 in log10 V
    "stress": 1e-3,
    "pressure": 1e-3,  # CYCLAPS solves the diffusion equation numerically
}
BP6_SHOWS = {
    "Sec 3": ("initial state", "initial-state"),
    "Series": ("time series of CYCLAPS", "slip-4"),
    "Title": ("no earthquake", "aseismic"),
}


def bp6_scenario(*, quick: bool = False, seed: int = 0, cells: int = FINE, law: str = "aging") -> FaultScenario:
    """Return the scenario of one half of the fault, with a free surface at the source, about which slip is even.

    The number of cells is an odd multiple of 1024, so a cell centre lies at the station beside the source.
    """
    return validate_scenario(
        FaultScenario, seed=seed, line={"width": HALF, "cell": HALF / cells},
        friction={"law": law, "a": 0.007, "b": 0.005, "dc": 4e-3, "normal": 50e6},
        injection={"flux": 1.25e-6, "storage": 1e-9, "diffusivity": 0.1, "stop": 100 * DAY},
        loading={"plate_rate": 0.0, "velocity": 1e-12, "stress": 29.2e6},
        run={
            "years": 2.0, "stations": (BESIDE, 50 * BESIDE, 1500.0, 2500.0, 3500.0, 5000.0), "interval": 0.05,
            "spacing": 50.0, "sampling": 2e4 if quick else 1e4,
        },
    )  # fmt: skip


def reproduce_bp6(
    *, quick: bool = False, seed: int = 0, folder=None, workers=None, report: Report = silent
) -> Reproduction:
    """Run the benchmark with the aging law and the slip law, and evaluate its claims."""
    main, slip, coarse = (
        simulate_cycles(
            bp6_scenario(quick=quick, seed=seed, law=law, cells=cells), folder=folder,
            report=within(report, stage=f"{law} law, cells of {HALF / cells:.3g} m"),
        )
        for law, cells in (("aging", FINE), ("slip", COARSE if quick else FINE), ("aging", COARSE))
    )  # fmt: skip
    claims = bp6_claims(main, slip, coarse)
    return Reproduction(main, (slip, coarse), note_quick_run(claims) if quick else claims)


def bp6_claims(main: FaultResult, slip: FaultResult, coarse: FaultResult) -> list[Claim]:
    """Evaluate all claims; the error of a value is its change when cells are three times as long."""
    state = float(np.log10(main.history.theta[0, 0]))
    claims = [
        claim(
            "initial-state", "Sec 3: 10.612318 in files of other codes", 10.612318, state, "log10 s",
            BP6_TOLERANCE["state"], error=0.0,
        )
    ]  # fmt: skip
    rows = [(station, row) for station, table in CYCLAPS.items() for row in table]
    kinds = (("slip", "m"), ("velocity", "log10 m/s"), ("stress", "MPa"), ("pressure", "MPa"))
    for number, (station, (time, *values)) in enumerate(rows, start=1):
        ours, rough = sampled(main, station, time), sampled(coarse, station, time)
        source = f"Series: CYCLAPS, {station:g} m from the source after {time / DAY:.2f} days"
        claims += [
            claim(f"{kind}-{number}", source, value, mine, unit, BP6_TOLERANCE[kind], error=abs(mine - other))
            for (kind, unit), value, mine, other in zip(kinds, values, ours, rough, strict=True)
        ]
    reach = [f"{2 * run.crept_length / 1e3:.2f} km" for run in (main, slip)]
    return [
        *claims,
        claim(
            "aseismic", 'Title: "fluid-induced aseismic slip"', True,
            not any(len(run.history.events.start) for run in (main, slip)), "", 0.0,
            f"slip of D_c or more on {reach[0]} of the fault with the aging law, {reach[1]} with the slip law",
        ),
    ]  # fmt: skip


def sampled(result: FaultResult, station: float, time: float) -> tuple[float, ...]:
    """Slip [m], log10 of the slip velocity, shear stress and pressure [MPa] at a station and a time."""
    history, (source,) = result.history, result.scenario.changes
    column = int(np.flatnonzero(history.station == station)[0])
    series = history.slip[:, column], np.log10(history.velocity[:, column]), history.stress[:, column] / 1e6
    values = [float(np.interp(time, history.time, values)) for values in series]
    return (*values, float(source.pressure(np.array([station]), time)[0]) / 1e6)
