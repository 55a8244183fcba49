"""Duration of whole commands, compared with the times stated in help and documentation."""

import os
import subprocess
import sys
import tempfile
import time

ROUNDS = 5
QUICK = {"disk-array": 35, "sphere-shear": 120, "quasi-rigid": 60, "gouge": 240}


def seconds(*words: str) -> float:
    """Seconds taken by a command line."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "stickslip", *words], check=True, capture_output=True)
    return time.perf_counter() - start


def row(case: str, value: float, budget: float) -> dict:
    """Row of the benchmark for one command."""
    return {
        "case": case, "n": 0, "threads": os.cpu_count() or 1, "ours": value, "peer": budget, "peer_name": "budget",
        "ratio": value / budget, "unit": "s",
    }  # fmt: skip


def rows(*, smallest: bool = False):
    """Yield a row for each command; for the smallest size, only for the first command."""
    yield row("stickslip --version", min(seconds("--version") for _ in range(1 if smallest else ROUNDS)), 0.5)
    with tempfile.TemporaryDirectory() as folder:
        for name, budget in () if smallest else QUICK.items():
            took = seconds("reproduce", name, "--quick", "--out", f"{folder}/{name}")
            yield row(f"reproduce {name} --quick", took, budget)
