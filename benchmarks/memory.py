"""Memory of states and of runs, and a million grains that are packed, sheared and written (Linux only).

    python -m benchmarks memory

Spheres of radii 0.5 and 0.7 start at random positions in a dilute periodic cell, are compressed by dynamics with drag
and then sheared. The memory of a state is that of its arrays. The memory of a run is the largest amount in use during
it beyond that in use before, and includes the state that it returns.
"""

import ctypes
import json
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from .engine import HERE, row

DILUTE, DENSE = 0.35, 0.66  # packing fractions
DT, DRAG, RATE = 0.1, 0.3, 1e-3  # time step, drag while packing, strain rates
SHEAR = 0.02  # strain
PARTS = "grains", "contacts", "control"


def _status(name: str) -> int:
    """An entry of the status of this process [bytes]."""
    (words,) = [line.split() for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name)]
    return 1024 * int(words[1])


def measured(action):
    """Result of a function, and the memory in use before it and at most during it [bytes]."""
    ctypes.CDLL(None).malloc_trim(0)  # returns freed memory, which is not in use
    Path("/proc/self/clear_refs").write_text("5")  # resets the largest amount of memory in use
    before = _status("VmRSS")
    return action(), before, _status("VmHWM")


def stages(n: int, folder: str) -> dict:
    """Pack, shear and write n grains; return the memory of each stage, and of the parts of the last state."""
    import stickslip as ss

    law, random = ss.laws.hertz_mindlin(mu=0.5), np.random.default_rng(0)
    radius = np.resize([0.5, 0.7], n)
    side = float(np.sum(4 / 3 * np.pi * radius**3) / DILUTE) ** (1 / 3)

    def scattered():
        grains = ss.spheres(random.uniform(0, side, (n, 3)), radius)
        return ss.assembly(grains, cell=ss.box([side] * 3, [True] * 3, 3), skin=0.2)

    def moved(state, rate, strain, drag):
        control = ss.control.strained_at(state.control, rate)
        steps = max(1, round(strain / RATE / DT))
        end, _, outcome = ss.run(state._replace(control=control), law, steps, DT, drag=drag)
        if not outcome.ok:
            raise RuntimeError(str(outcome))
        return end

    def packed():
        state = moved(scattered(), np.zeros((3, 3)), 0.1, 1.0)  # random overlaps vanish
        return moved(state, -RATE * np.eye(3), np.log(DENSE / DILUTE) / 3, DRAG)

    shear = np.array([[0.0, RATE, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    found = {}
    state, *found["packed"] = measured(packed)
    for stage, rate, strain in (("run", np.zeros((3, 3)), 0.01), ("sheared", shear, SHEAR)):
        state, *found[stage] = measured(partial(moved, state, rate, strain, DRAG))
    _, *found["written"] = measured(partial(ss.io.write_packing, Path(folder) / "grains.npz", state, law))
    for part in PARTS:
        found[part] = sum(array.nbytes for array in getattr(state, part) if isinstance(array, np.ndarray))
    return found | {"pairs": int(state.contacts.count[0])}


def rows(*, smallest: bool = False):
    """Bytes per grain of a state by parts and of a run, and the peak of each stage."""
    n = 1000 if smallest else 1_000_000
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "benchmarks.memory", str(n), folder]
        run = subprocess.run(words, cwd=HERE.parent, capture_output=True, text=True)
    if run.returncode:
        raise RuntimeError(run.stderr.strip().splitlines()[-1])
    found = json.loads(run.stdout)
    for part in PARTS:
        yield _row(f"state, {part}", n, found[part] / n, "bytes per grain")
    yield _row("pairs in the contact list", n, found["pairs"] / n, "per grain")
    for stage in ("run", "sheared"):
        before, peak = found[stage]
        yield _row(f"{stage}, beyond the first state", n, (peak - before) / n, "bytes per grain")
    for stage in ("packed", "sheared", "written"):
        yield _row(f"{stage}, largest", n, found[stage][1] / 2**30, "GiB")


def _row(case: str, n: int, value: float, unit: str) -> dict:
    return row(case, n, 2, value, None, "", unit)


if __name__ == "__main__":
    print(json.dumps(stages(int(sys.argv[1]), sys.argv[2])))
