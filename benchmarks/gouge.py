"""Time steps of fault gouge in steady sliding: ours and LAMMPS `gran/hertz/history` from the same state, alternating.

The sample is settled and slid by one mean diameter by our engine; both sides start from it without memory of contacts,
with the same forces on the plate, the same time step, on one core. LAMMPS has the neighbour skin that is the fastest of
`SKINS` on this machine; ours chooses its own.
"""

import os
import pickle
import subprocess
import sys
from pathlib import Path

from .engine import HERE, ROUNDS, STORE, console, row

VELOCITY = 0.3  # of the load point [m/s]
SKINS = (0.01, 0.02, 0.04, 0.08)  # [D]
CELLS = {
    "gouge, reduced cell": {},
    "gouge, the paper's number of grains": {"grains": {"number": 4815}, "cell": {"length": 0.06, "width": 0.04}},
}


def scene(name: str) -> tuple[Path, int]:
    """A file with a scenario and the place from which its legs start, and how many grains there are."""
    from stickslip import scenario
    from stickslip.loading import lammps
    from stickslip.loading.gouge import settled
    from stickslip.loading.gouge_run import OURS

    whole = scenario(experiment="gouge", protocol=[{"kind": "slide", "velocity": VELOCITY, "slip": 1.0}], **CELLS[name])
    path = STORE / f"gouge-{whole.digest[:16]}.pickle"
    if not path.exists():
        console.print(f"{name}: a sample is prepared once, which takes minutes")
        gouge = OURS.start(whole, settled(whole, whole.seed))
        gouge, _ = OURS.leg(whole, gouge, VELOCITY, round(whole.grains.mean / VELOCITY / whole.dt))
        STORE.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps((whole.text, lammps.start(whole, gouge))))
    _, place = pickle.loads(path.read_bytes())
    return path, len(place.gouge.state.grains.radius)


def timed(side: str, path: Path, steps: int, skin: float = 0.0) -> float:
    """Seconds a step of a side, in a process of its own; raises RuntimeError with the reason if it cannot run."""
    env = os.environ | {
        "LD_LIBRARY_PATH": f"{sys.prefix}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}",
        "OMP_NUM_THREADS": "1",
    }
    words = [sys.executable, str(HERE / "gouge_sides.py"), side, str(path.resolve()), str(steps), str(skin)]
    run = subprocess.run(words, capture_output=True, text=True, env=env)
    if run.returncode:
        raise RuntimeError((run.stderr.strip().splitlines() or ["no output"])[-1])
    return float(run.stdout.split()[-1])


def rows() -> list[dict]:
    """A row for each cell."""
    out = []
    for name in CELLS:
        path, n = scene(name)
        steps = max(2000, 12_000_000 // n)
        ours, peers = [], []
        try:
            skin = min(SKINS, key=lambda s: min(timed("lammps", path, steps, s) for _ in range(2)))
            for _ in range(ROUNDS):
                ours.append(timed("ours", path, steps))
                peers.append(timed("lammps", path, steps, skin))
            peer, words = n / min(peers), f"LAMMPS gran/hertz/history, skin {skin:g} D"
        except RuntimeError as problem:
            console.print(f"[yellow]LAMMPS skipped[/] ({problem}): install it with `pip install lammps mpich`.")
            ours, peer, words = ours or [timed("ours", path, steps)], None, ""
        out.append(row(name, n, 1, n / min(ours), peer, words))
    return out
