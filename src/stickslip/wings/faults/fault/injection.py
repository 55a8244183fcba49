"""Reproduction of the SEAS benchmark problem BP6-QD: aseismic slip due to fluid injected into a fault.

Lambert et al. 2025, doi:10.1029/2024JB030601. The parameters are those of the public inputs of tandem, RSFaultZ and
QDBIM, which agree. Results are compared with a public copy of the CYCLAPS series (P. Dublanchet, 2024), which are for
the aging law only. Their pressures show that "z = 0" is the cell beside the source, 9.77 m away, and "z = 0.5 km" is 50
cells away.
"""

import numpy as np

from ....kit import Claim, Report, claim, note_quick_run, silent, validate_scenario, within
from .claims import Reproduction
from .scenario import FaultScenario
from .simulate import FaultResult, simulate_cycles

HALF, BESIDE = 20e3, 9.765625  # half length of the fault; distance of the first station, one CYCLAPS cell [m]
FINE, COARSE = 3072, 1024  # numbers of cells
DAY = 86400.0
# time [s], slip [m], log10 of the slip velocity, shear stress and pressure [MPa] at the CYCLAPS stations
PUBLISHED = {
    BESIDE: (
        (112597.63, 2.46491e-7, -11.49413, 29.19997, 0.688495),
        (5938583.9, 9.71039e-3, -8.10676, 28.32044, 5.37384),
        (6897838.2, 2.20767e-2, -7.66729, 27.68244, 5.7963),
        (63066887.0, 0.2092647, -10.27701, 28.07028, 1.257822),
    ),
    50 * BESIDE: ((13003187.44, 0.187216996, -8.632712719, 27.463680359, 3.127105837),),
}
TOLERANCE = {
    "state": 1e-6,  # a closed form
    "slip": 5e-3,
    "velocity": 1e-3,  # of log10, about 0.01
    "stress": 1e-3,
    "pressure": 1e-3,  # CYCLAPS integrates the diffusion
}
SHOWS = {
    "Sec 3": ("initial state", "initial-state"),
    "Series": ("time series of CYCLAPS", "slip-4"),
    "Title": ("no earthquake", "aseismic"),
}


def paper_scenario(*, quick: bool = False, seed: int = 0, cells: int = FINE, law: str = "aging") -> FaultScenario:
    """Return the scenario: one half of the fault, with a free surface at the source, about which slip is even.

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


def reproduce(
    *, quick: bool = False, seed: int = 0, folder=None, workers=None, report: Report = silent
) -> Reproduction:
    """Run the benchmark with the aging law and the slip law, and evaluate its claims."""
    main, slip, coarse = (
        simulate_cycles(
            paper_scenario(quick=quick, seed=seed, law=law, cells=cells), folder=folder,
            report=within(report, stage=f"{law} law, cells of {HALF / cells:.3g} m"),
        )
        for law, cells in (("aging", FINE), ("slip", COARSE if quick else FINE), ("aging", COARSE))
    )  # fmt: skip
    claims = evaluate_claims(main, slip, coarse)
    return Reproduction(main, (slip, coarse), note_quick_run(claims) if quick else claims)


def evaluate_claims(main: FaultResult, slip: FaultResult, coarse: FaultResult) -> list[Claim]:
    """Evaluate all claims; the error of a value is its change when cells are three times as long."""
    state = float(np.log10(main.history.theta[0, 0]))
    claims = [
        claim(
            "initial-state", "Sec 3: 10.612318 in files of other codes", 10.612318, state, "log10 s",
            TOLERANCE["state"], error=0.0,
        )
    ]  # fmt: skip
    rows = [(station, row) for station, table in PUBLISHED.items() for row in table]
    kinds = (("slip", "m"), ("velocity", "log10 m/s"), ("stress", "MPa"), ("pressure", "MPa"))
    for number, (station, (time, *values)) in enumerate(rows, start=1):
        ours, rough = sampled(main, station, time), sampled(coarse, station, time)
        source = f"Series: CYCLAPS, {station:g} m from the source after {time / DAY:.2f} days"
        claims += [
            claim(f"{kind}-{number}", source, value, mine, unit, TOLERANCE[kind], error=abs(mine - other))
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
