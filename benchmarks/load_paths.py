"""Ends of quasi-rigid paths: dependence on the load increment, and comparison with slow dynamics.

    python -m benchmarks load_paths                # 50 samples with four increments (about an hour on one core)
    python -m benchmarks load_path_dynamics        # the first 24 samples of 60 disks, compared with slow dynamics
    python -m benchmarks wedged_paths              # boxes of 100 disks in which rattlers are wedged

A sample is a box of disks, with or without its rattlers. The force on one wall grows to three times its initial value
or falls to a tenth of it. Ends agree if their loads differ by at most 1 %. If ends do not agree, at least one path must
have reported that other choices are consistent as well, or that it is undecided.
"""

import time
from collections import Counter
from typing import NamedTuple

import numpy as np

import stickslip as ss
from stickslip.core.state import Control, State
from stickslip.loading.compression import RIGHT, TOP, biaxial_box, settle, with_load
from stickslip.loading.settling import slow_dynamics
from stickslip.wings.status.path import RETURNS, LoadPath, load_path

from .records import number

INCREMENTS = (0.01, 0.005, 0.002, 0.0005)
DIRECTIONS = {"lid down": (TOP, 3.0), "side in": (RIGHT, 3.0), "lid up": (TOP, 0.1), "side out": (RIGHT, 0.1)}
SIZES = {60: 20, 100: 14, 200: 10, 400: 6}  # number of samples of each size
WEDGED = range(702180, 702238)  # seeds of boxes in which rattlers are wedged
FIRST_SEED = 101  # seeds from here on are not used by any test
AGREE = 0.01  # largest relative difference between ends that agree
PRESSURE = 1e-4
TIMES, DRAG, BEYOND = (3e5, 1e6), 0.02, 1.3  # ramp times of the whole load, drag, last load over that of the path
BURST, ALIKE, BEFORE = 30.0, 0.5, 10  # kinetic energy over its median, and over the faster run's; steps in a median
ASTRAY = 0.02  # distance of the wall from the path, over its last shift, that cannot be a lag of the dynamics


class Sample(NamedTuple):
    """A sample and its load direction."""

    n: int
    seed: int
    whole: bool
    direction: str

    @property
    def name(self) -> str:
        """Description in one line."""
        return f"{self.n:4d} disks, seed {self.seed}, {'whole' if self.whole else 'no rattlers'}, {self.direction}"


class PathEnd(NamedTuple):
    """End of a path."""

    load: float
    verdict: str
    forks: int  # number of reported alternatives
    unchecked: int
    seconds: float
    undecided: bool  # True if the path cannot decide how to continue


def samples(sizes: dict[int, int] = SIZES) -> list[Sample]:
    """All samples, alternately with and without rattlers, with alternating directions."""
    out = []
    for n, count in sizes.items():
        for k in range(count):
            out.append(Sample(n, FIRST_SEED + k, (k // 4) % 2 == 0, list(DIRECTIONS)[k % 4]))
    return out


def prepare(sample: Sample) -> tuple[State, ss.Law, Control]:
    """Return state, law, and the control at the end of the leg."""
    state, law = biaxial_box(sample.n, seed=sample.seed, pressure=PRESSURE)
    while not sample.whole and (loose := ss.measure.rattlers(state, 2)).any():
        state = settle(without(state, loose), law, 1e-9 * PRESSURE)
    wall, factor = DIRECTIONS[sample.direction]
    return state, law, with_load(state.control, len(state.grains.radius) + wall, factor)


def without(state: State, loose: np.ndarray) -> State:
    """Return the state without some disks; contacts start without slip."""
    kept, walls, g = ~loose, state.walls, state.grains
    grains = ss.disks(g.position[kept, :2], g.radius[kept], mass=g.mass[kept])
    bodies = np.append(kept, np.ones(len(walls.mass), bool))
    control = state.control
    changed = ss.control.loads(int(kept.sum()), len(walls.mass))
    parts = {name: getattr(control, name)[bodies] for name in ("free", "force", "torque", "group")}
    return ss.assembly(grains, walls, state.cell, changed._replace(**parts))


def follow_path(state: State, law, end: Control, increment: float) -> tuple[PathEnd, LoadPath]:
    """Follow the path with one increment and return its end."""
    begin = time.process_time()
    path = load_path(state, law, end, increment=increment)
    seconds = time.process_time() - begin
    undecided = path.verdict.name in ("NO_PROGRESS", "NOT_FOUND")
    out = PathEnd(path.points[-1].load, path.verdict.name, len(path.alternatives), path.unchecked, seconds, undecided)
    return out, path


def agree(ends: list[PathEnd]) -> bool:
    """Return True if the last loads differ by at most 1 %."""
    loads = [one.load for one in ends]
    return max(loads) - min(loads) <= AGREE * max(loads)


def compare(sample: Sample, increments=INCREMENTS) -> tuple[str, list[PathEnd]]:
    """Line with the ends for all increments, and the ends themselves."""
    state, law, end = prepare(sample)
    ends = [follow_path(state, law, end, increment)[0] for increment in increments]
    line = f"{sample.name:44s}" + "".join(f" {one.load:8.5f}" for one in ends)
    words = ",".join(sorted({one.verdict for one in ends}))
    forks, seconds = "/".join(str(one.forks) for one in ends), max(one.seconds for one in ends)
    verdict = "agree" if agree(ends) else "alternative" if any(o.forks or o.undecided for o in ends) else "DISAGREE"
    return f"{line}  {verdict:11s} forks {forks}, {words}, {seconds:.1f} s", ends


def shift(states, sample: Sample) -> np.ndarray:
    """Displacement of the loaded wall (T,) [length]."""
    wall = DIRECTIONS[sample.direction][0]
    at = np.array([s.walls.point[wall] @ s.walls.normal[wall] for s in states])
    return at - at[0]


def slow_end(sample: Sample, state: State, law, end: Control, path: LoadPath) -> float | None:
    """Load at which slow dynamics collapses; None without a collapse up to 1.3 times the last load of the path.

    The kinetic energy of slow motion scales as the square of the rate. A load step is a burst if the slower of two runs
    has more than half of the kinetic energy of the faster run, and thirty times its own median. A burst is a collapse
    if the wall deviates from the path from then on, or if the path has ended.
    """
    last = path.points[-1].load
    until = min(1.0, BEYOND * last)
    faster, slower = (slow_dynamics(state, law, end, time=whole, until=until, drag=DRAG) for whole in TIMES)
    there = shift(path.states, sample)
    moved = shift([state, *slower.states], sample)[1:]
    off = np.abs(moved - np.interp(slower.load, path.load, there)) / np.abs(there).max()
    energy = slower.kinetic_energy
    for k in range(BEFORE, len(energy)):
        near = faster.kinetic_energy[max(0, k - 3) : k + 4].max()
        left = off[k:][slower.load[k:] <= last]
        burst = energy[k] > BURST * np.median(energy[:k]) and energy[k] > ALIKE * near
        if burst and (len(left) == 0 or np.median(left) > ASTRAY):
            return float(slower.load[k])
    return None


def compare_with_dynamics(some: list[Sample]):
    """Compare the ends of paths with those of slow dynamics, including all samples in the statistics."""
    ratios, survivors = [], 0
    for sample in some:
        state, law, end = prepare(sample)
        path, way = follow_path(state, law, end, INCREMENTS[1])
        begin = time.process_time()
        found = slow_end(sample, state, law, end, way)
        seconds = time.process_time() - begin
        limit = min(1.0, BEYOND * path.load)
        words = f"no collapse up to {limit:.5f}" if found is None else f"collapses at {found:.5f}"
        survivors += found is None
        ratios += [] if found is None else [found / path.load - 1]
        tail = "" if found is None else f", {found / path.load - 1:+.2%}"
        yield f"{sample.name:44s} path {path.load:.5f} {path.verdict}, dynamics {words}{tail}, {seconds:.0f} s"
    size = np.sort(np.abs(ratios))
    yield f"{len(some)} samples: {len(size)} collapse, {survivors} do not up to {BEYOND} times the last load"
    for limit in (0.001, 0.003, 0.01, 0.03, 0.1):
        yield number(
            f"dynamics collapses within {100 * limit:g} % of the end of the path", int((size <= limit).sum()), "samples"
        )
    if len(size):
        yield f"  relative difference of those that collapse: median {np.median(size):.2%}, largest {size[-1]:.2%}"


def summary(results: list[list[PathEnd]]):
    """Numbers of samples whose ends agree, and of samples that report an alternative."""
    same = [agree(ends) for ends in results]
    reported = [any(one.forks or one.undecided for one in ends) for ends in results]
    neither = sum(not a and not t for a, t in zip(same, reported, strict=True))
    also = sum(a and any(o.forks for o in ends) for a, ends in zip(same, results, strict=True))
    yield number("samples", len(results))
    yield number(f"ends agree within {AGREE:.0%}", sum(same), "samples")
    yield number("ends differ, an alternative was reported", len(same) - sum(same) - neither, "samples")
    yield number("ends differ, nothing was reported", neither, "samples")
    yield number("ends agree, an alternative was reported", also, "samples")
    verdicts = sorted({one.verdict for ends in results for one in ends})
    counts = {v: sum(one.verdict == v for ends in results for one in ends) for v in verdicts}
    yield "  verdicts: " + ", ".join(f"{count} {name}" for name, count in counts.items())


def rows_of_dynamics(*, smallest: bool = False):
    """Samples of 60 disks compared with slow dynamics."""
    yield from compare_with_dynamics(samples({20: 1} if smallest else {60: 24}))


def rows_of_wedged(*, smallest: bool = False):
    """Ends of paths on which the wall to the right is loaded, and how often a disk is wedged."""
    alike, most = [], 0
    for seed in WEDGED[:1] if smallest else WEDGED:
        state, law = biaxial_box(20 if smallest else 100, seed=seed, mu=0.5, pressure=5e-4)
        end = with_load(state.control, len(state.grains.radius) + RIGHT, 3.0)
        paths = [load_path(state, law, end, increment=h) for h in INCREMENTS[::2]]
        loads = [path.points[-1].load for path in paths]
        alike.append(max(loads) - min(loads) <= 2e-3 * max(loads))
        wedged = Counter((k, e.i) for k, path in enumerate(paths) for e in path.events if e.kind == RETURNS)
        most = max([most, *wedged.values()])
    yield number("boxes", len(alike))
    yield number("ends agree within 0.2 %", sum(alike), "boxes")
    yield number("most often that a disk is wedged", most)


def rows(*, smallest: bool = False):
    """All samples with all increments."""
    results, longest = [], {}
    yield f"{'':44s}" + "".join(f" {increment:8g}" for increment in INCREMENTS)
    for sample in samples({20: 1} if smallest else SIZES):
        line, ends = compare(sample, INCREMENTS[:1] if smallest else INCREMENTS)
        results.append(ends)
        yield line
        longest[sample.n] = max(longest.get(sample.n, 0.0), *(one.seconds for one in ends), 0.0)
    yield from summary(results)
    for n, seconds in longest.items():
        yield number(f"longest path, {n} disks", seconds, "s")
