"""Earthquake cycles compared with QDYN: recurrence, slip and processor time on the same faults.

    python -m benchmarks qdyn

QDYN (Luo et al. 2017, doi:10.5281/zenodo.322459) is built from its source by `make` with gfortran and MPI, and must be
on the path as `qdyn`; the PyPI package of this name is a different program. Both codes run the benchmark problem BP1-QD
and a fault with in-plane shear in an infinite body for 420 years, alternating, each in its own process on one core; the
shortest processor time of several rounds counts. In both codes, slip has no waves shorter than two cells. Errors are
differences from the limit of small cells, extrapolated with order 2 from two of our runs. Runs take ten minutes.

QDYN has only antiplane shear. In-plane shear is obtained with G/(1 − ν) instead of G; the radiation damping G/(2 c_s)
is unchanged if c_s is divided by 1 − ν as well. Both codes start from the steady stress where `a` is largest.
"""

import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

YEARS, YEAR, THRESHOLD, ROUNDS = 420.0, 365.25 * 86400, 1e-3, 3
WIDTH, DENSITY, WAVE_SPEED, NORMAL, PLATE_RATE = 40e3, 2670.0, 3464.0, 50e6, 1e-9
MODULUS, MU0, V0, B, DC = DENSITY * WAVE_SPEED**2, 0.6, 1e-6, 0.015, 8e-3
POISSON = 0.25


class Problem(NamedTuple):
    """A fault: values of `a` at depths, its kind for both codes, and the place at which slip is compared."""

    depths: tuple[float, ...]  # [m]
    a: tuple[float, ...]
    shear: str
    boundary: str
    finite: int  # QDYN option: 1 for a segment in an infinite body, 3 for half of a segment symmetric about the surface
    softer: float  # 1 − ν for in-plane shear, else 1
    place: float  # place at which slip is compared [m]


PROBLEMS = {
    "BP1-QD": Problem((15e3, 18e3), (0.010, 0.025), "antiplane", "surface", 3, 1.0, 0.0),
    "in-plane": Problem(
        (5e3, 15e3, 30e3, 31e3), (0.025, 0.010, 0.010, 0.025), "in-plane", "infinite", 1, 1 - POISSON, 22.5e3
    ),
}
CASES = {  # numbers of cells and tolerances
    "ours": [(512, 1e-3), (512, 1e-4), (1024, 1e-3), (1024, 1e-4)],
    "QDYN": [(512, 1e-4), (512, 1e-5), (1024, 1e-4), (1024, 1e-5)],
}
LIMIT = ((1024, 1e-5), (2048, 1e-5))
SAME_CELLS = (1024, 1e-4)
GOOD = 3e-4  # relative error of an event's time, or of the recurrence, that counts as good
OURS = "import sys; from benchmarks.qdyn import ours; print(*ours(sys.argv[1], int(sys.argv[2]), float(sys.argv[3])))"


def ours(name: str, cells: int, tolerance: float) -> tuple[float, float, float]:
    """Start of the second event and time until the third [years], and slip of the third event at one place [m]."""
    from stickslip import friction

    problem = PROBLEMS[name]
    fault = friction.line_fault(
        WIDTH, WIDTH / cells, a=list(zip(problem.depths, problem.a, strict=True)), b=B, dc=DC, normal=NORMAL,
        shear_modulus=MODULUS, poisson=POISSON, shear=problem.shear, boundary=problem.boundary,
    )  # fmt: skip
    recording = friction.Recording(stations=(problem.place,))
    history = friction.simulate_fault(fault, YEARS, recording=recording, tolerance=tolerance)
    return _numbers(history.events.start, history.events.end, history.time, history.slip[:, 0])


def _numbers(start: np.ndarray, end: np.ndarray, time: np.ndarray, slip: np.ndarray) -> tuple[float, float, float]:
    before, after = np.interp([start[2], end[2]], time, slip)
    return start[1] / YEAR, (start[2] - start[1]) / YEAR, after - before


def write_input(folder: Path, name: str, cells: int, tolerance: float) -> None:
    """Write `qdyn.in` for the Runge–Kutta–Fehlberg solver."""
    problem = PROBLEMS[name]
    a, most = np.interp((np.arange(cells) + 0.5) * WIDTH / cells, problem.depths, problem.a), max(problem.a)
    stress = NORMAL * most * np.arcsinh(PLATE_RATE / (2 * V0) * np.exp((MU0 + B * np.log(V0 / PLATE_RATE)) / most))
    theta = DC / V0 * np.exp(a / B * np.log(2 * V0 / PLATE_RATE * np.sinh(stress / (a * NORMAL))) - MU0 / B)
    lines = [
        "1", f"{cells}", f"{WIDTH} 5e4", f"{problem.finite}", "1", "2", "0", "0 0 0",
        f"1 1000000 1 {cells} 1 1 1 0 0", f"{WAVE_SPEED / problem.softer} {MODULUS / problem.softer} 3e10 0 0 0.01",
        "31536000 0", f"1e-8 0 {YEARS * YEAR} {tolerance}", "0", "0 0", "1e18 1e-3 1e-4", "1 2",
    ]  # fmt: skip
    stations = _stations(problem.place, cells)
    for k in range(cells):
        known = (NORMAL, PLATE_RATE, theta[k], a[k], B, DC, 0.01, 1e-7, MU0, V0, int(k in stations), 0, 0, PLATE_RATE)
        lines.append(" ".join(f"{value:.15g}" for value in known))
    (folder / "qdyn.in").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _stations(place: float, cells: int) -> set[int]:
    """Cells on both sides of a place between two cells, or the first cell for the surface."""
    k = round(place * cells / WIDTH)
    return {max(k - 1, 0), k}


def read_output(folder: Path) -> tuple[float, float, float]:
    """Same numbers as from `ours`, from QDYN's series of the largest velocity and of slip at the place."""
    time, velocity = np.loadtxt(folder / "output_vmax", usecols=(0, 2)).T
    slip = np.mean([np.loadtxt(path, usecols=7) for path in folder.glob("output_ot_*")], axis=0)
    fast = velocity >= THRESHOLD

    def crossings(last):
        share = np.log(THRESHOLD / velocity[last]) / np.log(velocity[last + 1] / velocity[last])
        return time[last] + share * (time[last + 1] - time[last])

    start, end = (crossings(np.flatnonzero(fast[:-1] < fast[1:])), crossings(np.flatnonzero(fast[:-1] > fast[1:])))
    return _numbers(start, end, time, slip)


def run(name: str, code: str, cells: int, tolerance: float) -> tuple[float, np.ndarray]:
    """Processor time of a run [s], and its results."""
    with tempfile.TemporaryDirectory() as place:
        write_input(Path(place), name, cells, tolerance)
        python = code == "ours"
        words = [sys.executable, "-c", OURS, name, str(cells), str(tolerance)] if python else [shutil.which("qdyn")]
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        done = subprocess.run(words, cwd=None if python else place, capture_output=True, text=True, check=True)
        seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        return seconds, np.array([float(word) for word in done.stdout.split()] if python else read_output(Path(place)))


def measure(name: str) -> tuple[dict, np.ndarray]:
    """Shortest processor time and results of each case of a problem, and the limit of small cells."""
    cases = [
        (code, *case) for pair in zip(*CASES.values(), strict=True) for code, case in zip(CASES, pair, strict=True)
    ]
    best: dict[tuple, tuple] = {}
    for _ in range(ROUNDS):
        for case in cases:
            seconds, results = run(name, *case)
            best[case] = min(best.get(case, (np.inf,))[0], seconds), results
    coarse, fine = (run(name, "ours", *case)[1] for case in LIMIT)
    return best, (4 * fine - coarse) / 3


def rows(*, smallest: bool = False):
    """Table of results, and simulated years per second of both codes with about 1000 cells."""
    if smallest:
        yield f"ours, 512 cells: {run('BP1-QD', 'ours', 512, 1e-2)[1]}"
    if not shutil.which("qdyn"):
        yield "QDYN skipped: build it from its source, and put `qdyn` on the path"
        return
    if smallest:
        return
    heads = ("event [years]", "error", "recurrence [years]", "error", "slip [m]", "error")
    yield f"| fault | code | cells | tolerance | {' | '.join(heads)} | time [s] |"
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for name in PROBLEMS:
        yield from _compare(name)


def _compare(name: str):
    """Table lines and rows for a problem."""
    best, limit = measure(name)
    errors = {case: np.abs(results / limit - 1) for case, (_, results) in best.items()}
    for code, cells, tolerance in ((code, *case) for code, chosen in CASES.items() for case in chosen):
        seconds, results = best[code, cells, tolerance]
        pairs = zip(results, errors[code, cells, tolerance], strict=True)
        numbers = " | ".join(f"{value:.6g} | {error:.0e}" for value, error in pairs)
        yield f"| {name} | {code} | {cells} | {tolerance:.0e} | {numbers} | {seconds:.1f} |"
    yield "| {} | limit | | | {:.6g} | | {:.6g} | | {:.6g} | | |".format(name, *limit)
    same = {code: best[code, *SAME_CELLS][0] for code in CASES}
    yield _row(name, "1024 cells", same)
    for k, what in enumerate(("time of an event", "recurrence")):
        yield _row(name, f"{what} to {GOOD:.0e}", {code: _least(best, errors, code, k) for code in CASES})


def _least(best: dict, errors: dict, code: str, k: int) -> float:
    """Shortest processor time with which a code reaches `GOOD`; NaN if it never does [s]."""
    return min((best[case][0] for case in best if case[0] == code and errors[case][k] < GOOD), default=np.nan)


def _row(name: str, what: str, seconds: dict) -> dict:
    return {
        "case": f"{name}, {what}, years of a fault/s", "n": 1024, "threads": 1, "ours": YEARS / seconds["ours"],
        "peer": YEARS / seconds["QDYN"], "peer_name": "QDYN, Runge–Kutta–Fehlberg",
        "ratio": seconds["QDYN"] / seconds["ours"], "unit": "1/s",
    }  # fmt: skip
