"""Earthquake cycles beside QDYN: recurrence, slip and processor time on the same fault; a few minutes.

    python -m benchmarks --qdyn

QDYN (Luo et al. 2017, doi:10.5281/zenodo.322459) is built from its source by `make` with gfortran and MPI, and found
as `qdyn` on the path; the package of this name on PyPI is another program. The benchmark problem BP1-QD is run for
420 years by both codes, each in its own process on one core, alternating; the least processor time of some rounds
counts. QDYN takes slip to be a Fourier series, and ours takes it to be uniform in each cell, so that errors differ at
equal cells. Errors are differences from the limit of small cells, extrapolated from two runs of ours with order 2.
"""

import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console

YEARS, YEAR, THRESHOLD, ROUNDS = 420.0, 365.25 * 86400, 1e-3, 3
WIDTH, DENSITY, WAVE_SPEED, NORMAL, PLATE_RATE = 40e3, 2670.0, 3464.0, 50e6, 1e-9
MODULUS, MU0, V0, B, DC = DENSITY * WAVE_SPEED**2, 0.6, 1e-6, 0.015, 8e-3
DEPTHS, A = (15e3, 18e3), (0.010, 0.025)
CASES = {  # numbers of cells and tolerances
    "ours": [(512, 1e-3), (512, 1e-4), (1024, 1e-3), (1024, 1e-4)],
    "QDYN": [(512, 1e-4), (512, 1e-5), (1024, 1e-4), (1024, 1e-5)],
}
LIMIT = ((1024, 1e-4), (2048, 1e-4))
SAME_CELLS = {"ours": (1024, 1e-3), "QDYN": (1024, 1e-4)}  # where cells, not steps, make the error
GOOD = 3e-4  # of an event's time, or of the recurrence
OURS = "import sys; from benchmarks.qdyn import ours; print(*ours(int(sys.argv[1]), float(sys.argv[2])))"
console = Console()


def ours(cells: int, tolerance: float) -> tuple[float, float, float]:
    """Start of the second event and time to the third [years], and slip of the third at the surface [m]."""
    from stickslip import friction

    a = list(zip(DEPTHS, A, strict=True))
    fault = friction.line_fault(WIDTH, WIDTH / cells, a=a, b=B, dc=DC, normal=NORMAL, shear_modulus=MODULUS)
    events = friction.simulate_fault(fault, YEARS, tolerance=tolerance).events
    return events.start[1] / YEAR, np.diff(events.start)[1] / YEAR, events.surface_slip[2]


def write_input(folder: Path, cells: int, tolerance: float) -> None:
    """Write `qdyn.in`: half of a fault that is symmetric about the surface, solved by Runge–Kutta–Fehlberg."""
    a = np.interp((np.arange(cells) + 0.5) * WIDTH / cells, DEPTHS, A)
    stress = NORMAL * A[1] * np.arcsinh(PLATE_RATE / (2 * V0) * np.exp((MU0 + B * np.log(V0 / PLATE_RATE)) / A[1]))
    theta = DC / V0 * np.exp(a / B * np.log(2 * V0 / PLATE_RATE * np.sinh(stress / (a * NORMAL))) - MU0 / B)
    lines = [
        "1", f"{cells}", f"{WIDTH} 5e4", "3", "1", "2", "0", "0 0 0", f"1 1000000 1 {cells} 1 1 1 0 0",
        f"{WAVE_SPEED} {MODULUS} 3e10 0 0 0.01", "31536000 0", f"1e-8 0 {YEARS * YEAR} {tolerance}", "0", "0 0",
        "1e18 1e-3 1e-4", "1 2",
    ]  # fmt: skip
    for k in range(cells):
        known = (NORMAL, PLATE_RATE, theta[k], a[k], B, DC, 0.01, 1e-7, MU0, V0, int(k == 0), 0, 0, PLATE_RATE)
        lines.append(" ".join(f"{value:.15g}" for value in known))
    (folder / "qdyn.in").write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_output(folder: Path) -> tuple[float, float, float]:
    """The same of QDYN, from its series of the largest velocity and of the slip at the surface."""
    time, velocity = np.loadtxt(folder / "output_vmax", usecols=(0, 2)).T
    slip = np.loadtxt(folder / "output_ot_0", usecols=7)
    fast = velocity >= THRESHOLD
    last, end = np.flatnonzero(~fast[:-1] & fast[1:]), np.flatnonzero(fast[:-1] & ~fast[1:])
    share = np.log(THRESHOLD / velocity[last]) / np.log(velocity[last + 1] / velocity[last])
    start = (time[last] + share * (time[last + 1] - time[last])) / YEAR
    return start[1], start[2] - start[1], slip[end[2]] - slip[last[2]]


def run(code: str, cells: int, tolerance: float) -> tuple[float, np.ndarray]:
    """Processor time of a run [s], and what it has found."""
    with tempfile.TemporaryDirectory() as place:
        write_input(Path(place), cells, tolerance)
        python = code == "ours"
        words = [sys.executable, "-c", OURS, str(cells), str(tolerance)] if python else [shutil.which("qdyn")]
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        done = subprocess.run(words, cwd=None if python else place, capture_output=True, text=True, check=True)
        seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        return seconds, np.array([float(word) for word in done.stdout.split()] if python else read_output(Path(place)))


def measure() -> tuple[dict, np.ndarray]:
    """Least processor time and results of every case, and the limit of small cells."""
    cases = [
        (code, *case) for pair in zip(*CASES.values(), strict=True) for code, case in zip(CASES, pair, strict=True)
    ]
    best: dict[tuple, tuple] = {}
    for _ in range(ROUNDS):
        for case in cases:
            seconds, found = run(*case)
            best[case] = min(best.get(case, (np.inf,))[0], seconds), found
    coarse, fine = (run("ours", *case)[1] for case in LIMIT)
    return best, (4 * fine - coarse) / 3


def rows() -> list[dict]:
    """Simulated years per second of both codes with about 1000 cells; prints a table; empty without QDYN."""
    if not shutil.which("qdyn"):
        console.print("[yellow]QDYN skipped[/]: build it from its source, and put `qdyn` on the path")
        return []
    best, limit = measure()
    errors = {case: np.abs(found / limit - 1) for case, (_, found) in best.items()}
    print("<!-- written by python -m benchmarks --qdyn -->")
    heads = ("code", "cells", "tolerance", "event [years]", "error", "recurrence [years]", "error", "slip [m]", "error")
    print(f"| {' | '.join(heads)} | time [s] |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for code, chosen in CASES.items():
        for cells, tolerance in chosen:
            seconds, found = best[code, cells, tolerance]
            pairs = zip(found, errors[code, cells, tolerance], strict=True)
            numbers = " | ".join(f"{value:.6g} | {error:.0e}" for value, error in pairs)
            print(f"| {code} | {cells} | {tolerance:.0e} | {numbers} | {seconds:.1f} |")
    print("| limit | | | {:.6g} | | {:.6g} | | {:.6g} | | |".format(*limit))
    same = {code: best[code, *case][0] for code, case in SAME_CELLS.items()}
    return [_row("1024 cells", same)] + [
        _row(f"{what} to {GOOD:.0e}", {code: _least(best, errors, code, k) for code in CASES})
        for k, what in enumerate(("time of an event", "recurrence"))
    ]


def _least(best: dict, errors: dict, code: str, k: int) -> float:
    """Least processor time with which a code has a number to `GOOD` [s]."""
    return min((best[case][0] for case in best if case[0] == code and errors[case][k] < GOOD), default=np.nan)


def _row(what: str, seconds: dict) -> dict:
    return {
        "case": f"BP1-QD, {what}, years of a fault/s", "n": 1024, "threads": 1, "ours": YEARS / seconds["ours"],
        "peer": YEARS / seconds["QDYN"], "peer_name": "QDYN, Runge–Kutta–Fehlberg",
        "ratio": seconds["QDYN"] / seconds["ours"], "unit": "1/s",
    }  # fmt: skip
