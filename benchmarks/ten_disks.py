"""Steps per second of the ten-disk array with the sharp law, compared with LAMMPS.

Each side runs in its own process; sides alternate, and the best of several rounds counts.
"""

import subprocess
import sys
from pathlib import Path

from .engine import row
from .native_lammps import NATIVE, environment

HERE = Path(__file__).parent
ROUNDS, STEPS = 5, 400_000


def run_python(*words: str, native: bool = False) -> str:
    """Output of a Python process that may import LAMMPS; raise RuntimeError if it fails."""
    run = subprocess.run([sys.executable, *words], capture_output=True, text=True, env=environment(native=native))
    if run.returncode:
        raise RuntimeError(run.stderr.strip().splitlines()[-1] if run.stderr.strip() else "no output")
    return run.stdout


def rows(*, smallest: bool = False):
    """Yield one row per LAMMPS build, or only our speed if LAMMPS is not installed."""
    sides = {"ours": "array_stickslip.py", "": "array_lammps.py", NATIVE: "array_lammps.py"}
    found, steps = {side: [] for side in sides}, str(100 if smallest else STEPS)
    for _ in range(1 if smallest else ROUNDS):
        for side in list(found):
            try:
                words = run_python(str(HERE / sides[side]), steps, native=side == NATIVE)
                found[side].append(1 / float(words.split()[0]))
            except RuntimeError as problem:
                if side == "ours":
                    raise
                yield f"{side}LAMMPS skipped ({problem})"
                del found[side]
    ours = max(found.pop("ours"))
    for side, values in found.items() or [("", [])]:
        peer = max(values, default=None)
        name = f"{side}LAMMPS gran/hertz/history"
        yield row("10-disk array, sharp Coulomb, steps/s", 10, 1, ours, peer, name, "1/s")
