"""Time steps of sliding fault gouge: stickslip and LAMMPS `gran/hertz/history` from the same state, alternating.

The sample settles and slides by one mean diameter with stickslip; the larger sample consists of 3 × 3 copies. Both
sides start without contact memory, with the same forces on the plate and the same time step, on one core. LAMMPS uses
the skin of `SKINS` that is fastest on this machine; stickslip chooses its skin itself.
"""

import pickle
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from stickslip.data.archive import SCHEMA

from .engine import HERE, ROUNDS, STORE, console, row
from .native_lammps import NATIVE, environment

VELOCITY = 0.3  # velocity of the load point [m/s]
SKINS = (0.005, 0.01, 0.02, 0.04)  # neighbour skins of LAMMPS [D]
CELLS = {"gouge, 500 mobile grains": 1, "gouge, 4500 mobile grains": 3}  # copies along x and along z


def scene(copies: int, small: bool = False) -> tuple[Path, int]:
    """Return a file with a scenario and the start of its legs, and the number of grains."""
    from stickslip import scenario
    from stickslip.core.dynamics.run import own_engine
    from stickslip.core.state import empty_contacts
    from stickslip.wings.papers.gouge.protocol import slide_leg
    from stickslip.wings.papers.gouge.sample import prepare_sample

    whole = scenario(
        experiment="gouge", law={"damping_n": 6e7}, protocol=[{"kind": "slide", "velocity": VELOCITY, "slip": 1.0}],
        **{"grains": {"number": 60}, "cell": {"length": 0.02, "width": 0.02}} if small else {},
    )  # fmt: skip
    path = STORE / f"gouge-{whole.digest[:16]}-{copies}-{SCHEMA}.pickle"
    if path.exists() and copies == 1:  # copies are quick to make
        _, gouge = pickle.loads(path.read_bytes())
        return path, len(gouge.state.grains.radius)
    if copies > 1:
        _, gouge = pickle.loads(scene(1, small)[0].read_bytes())
        size = {"length": copies * whole.cell.length, "width": copies * whole.cell.width}
        whole = whole.model_copy(update={"cell": whole.cell.model_copy(update=size)})
        gouge = copied(gouge, copies)._replace(area=whole.area)
    else:
        console.print("gouge: preparing a sample, once; takes a minute")
        gouge = prepare_sample(whole, whole.seed)
        leg = slide_leg(whole, gouge, VELOCITY, round((0.01 if small else 1) * whole.grains.mean / VELOCITY / whole.dt))
        ((state, _),) = own_engine().pieces(leg)
        gouge = gouge._replace(state=state)
    STORE.mkdir(parents=True, exist_ok=True)
    state = gouge.state
    bare = state._replace(contacts=empty_contacts(state.n_bodies, 0, state.contacts.skin))
    path.write_bytes(pickle.dumps((whole.text, gouge._replace(state=bare))))
    return path, len(gouge.state.grains.radius)


def copied(gouge, copies: int):
    """Copies of a sample along x and z, under one plate with one spring."""
    from stickslip.core.state import empty_contacts

    state, n = gouge.state, len(gouge.state.grains.radius)
    size = np.diag(state.cell.vectors)
    offsets = np.array([[a * size[0], 0, b * size[2]] for a in range(copies) for b in range(copies)])

    def repeat(array, shift=False):
        whole = np.concatenate([array] * len(offsets))
        return whole + np.repeat(offsets, n, axis=0) if shift else whole

    grains = state.grains._replace(
        **{name: repeat(array, name == "position") for name, array in state.grains._asdict().items()}
    )
    control = state.control._replace(**{
        name: repeat(field, name == "anchor")
        for name, field in state.control._asdict().items()
        if np.ndim(field) and len(field) == n
    })  # fmt: skip
    cell = state.cell._replace(vectors=np.diag(size * [copies, 1, copies]))
    contacts = empty_contacts(len(grains.radius), 0, state.contacts.skin)
    return gouge._replace(
        state=state._replace(grains=grains, control=control, cell=cell, contacts=contacts, instant=None)
    )


def measure(side: str, path: Path, steps: int, skin: float = 0.0) -> float:
    """Return the seconds per step of a side, run in a separate process; raise RuntimeError if it cannot run."""
    env = environment(native=side.startswith(NATIVE)) | {"OMP_NUM_THREADS": "1"}
    words = [
        sys.executable,
        str(HERE / "gouge_runner.py"),
        side.removeprefix(NATIVE),
        str(path.resolve()),
        str(steps),
        str(skin),
    ]
    run = subprocess.run(words, capture_output=True, text=True, env=env)
    if run.returncode:
        raise RuntimeError((run.stderr.strip().splitlines() or ["no output"])[-1])
    return float(run.stdout.split()[-1])


def run_seconds(workers: int) -> float:
    """Seconds for four realisations with two branches each, from settling to the last hold."""
    import stickslip as ss

    whole = ss.scenario(
        experiment="gouge", realizations=4, grains={"number": 150}, law={"damping_n": 1e4}, preparation={"slip": 1.0},
        protocol=[
            {"kind": "slide-hold-slide", "before": (VELOCITY,), "holds": (0.02,), "approach": 1.0, "branches": 2}
        ],
    )  # fmt: skip
    start = time.perf_counter()
    assert not ss.simulate(whole, workers=workers).failures
    return time.perf_counter() - start


def scaling() -> dict:
    """Speed of two processes relative to one, for realisations and branches; the ideal is 2."""
    run_seconds(2)
    one, two = zip(*((run_seconds(1), run_seconds(2)) for _ in range(2)), strict=True)
    name = "gouge, 4 realizations with 2 branches each, runs/s"
    return row(name, 150, 2, 1 / min(two), 1 / min(one), "one process", "1/s")


def rows(*, smallest: bool = False):
    """One row per cell size, and one for the scaling over processes."""
    if not smallest:
        yield scaling()
    for name, copies in CELLS.items():
        path, n = scene(copies, smallest)
        steps = 20 if smallest else max(2000, 12_000_000 // n)
        sides = {"ours": (0.0, [])}
        for side in ("lammps", NATIVE + "lammps"):
            try:
                skin = min(SKINS, key=lambda s, side=side: min(measure(side, path, steps, s) for _ in range(2)))
                sides[side] = (skin, [])
            except RuntimeError as problem:
                yield f"{side.replace('lammps', 'LAMMPS')} skipped ({problem})"
        for _ in range(ROUNDS):
            for side, (skin, seconds) in sides.items():
                seconds.append(measure(side, path, steps, skin))
        ours = n / min(sides.pop("ours")[1])
        for side, (skin, seconds) in sides.items():
            words = f"{side.replace('lammps', 'LAMMPS')} gran/hertz/history (skin {skin:g} D)"
            yield row(name, n, 1, ours, n / min(seconds), words)
        if not sides:
            yield row(name, n, 1, ours, None, "")
