"""Memory cost of time steps of large packings: `python -m benchmarks.engine_limits [GRAINS]`.

Counts the memory traffic of a step, in streams and in cache lines at arbitrary addresses, measures the cost of both on
this core, and compares their sum with the additional time per grain-step relative to a packing that fits into the
cache.
"""

import sys
import time

import numpy as np
from numba import njit

import stickslip as ss
from stickslip.core.dynamics import driver
from stickslip.core.simd.blocks import LANES

from .engine import GRAIN_STEPS, SIZE_STEPS, scene

LAW, DT = ss.laws.hertz_mindlin_reff(2.0, 4 / 7, 0.5), 0.1


@njit
def _stream(values):
    for k in range(len(values)):
        values[k] += 1.0


@njit
def _visit(values, line):
    total = 0.0
    for k in range(len(line)):
        total += values[8 * line[k]]
    return total


def best(work, rounds: int = 5) -> float:
    """Shortest time of several calls [s]."""
    found = []
    for _ in range(rounds + 1):  # the first one compiles
        start = time.perf_counter()
        work()
        found.append(time.perf_counter() - start)
    return min(found[1:])


def costs() -> tuple[float, float]:
    """Nanoseconds per byte of a stream that is read and written, and per line of 64 bytes at an arbitrary address."""
    values = np.ones(1 << 26)  # 512 MB, more than any cache
    line = np.random.default_rng(0).permutation(len(values) // 8)
    stream, lines = best(lambda: _stream(values)), best(lambda: _visit(values, line), 2)
    return 1e9 * stream / (16 * len(values)), 1e9 * lines / len(line)


def memory_traffic(n: int) -> tuple[float, float]:
    """Bytes of streams, and lines at arbitrary addresses, per grain-step."""
    seen, chooser = [], driver.block_chooser
    chosen = chooser(False)

    def watched(*args):
        seen.append((chosen(*args), args[2]))
        return seen[-1][0]

    driver.block_chooser = lambda parallel: watched
    try:
        ss.run(packing(n), LAW, 10, DT, threads=1)
    finally:
        driver.block_chooser = chooser
    blocks, moving = seen[-1]
    slots, cross = LANES * blocks.inner[-1] / n, LANES * blocks.cross[-1] / n
    a_slot = 2 * blocks.i.itemsize + 8 * (len(blocks.size) > 0) + 2 * (3 * 8 + 1)  # slip and mode are also written
    a_grain = 2 * (moving.body[0].nbytes + moving.angle[0].nbytes) + moving.origin[0].nbytes + 1
    a_grain += blocks.code.itemsize * 2 * slots + blocks.start.itemsize
    rows = (blocks.place[: blocks.inner[-1]].max() + LANES) / n  # in use at a time
    # for a pair across tiles: two lines of the other body
    return slots * a_slot + a_grain + 2 * blocks.load[0].nbytes * rows, 2 * cross


def packing(n: int):
    """The dense spheres of the benchmark."""
    held = dict(np.load(scene(3, 0.66, n, 0.001)))
    grains = ss.spheres(held["position"], held["radius"], mass=held["mass"], velocity=held["velocity"])
    return ss.assembly(grains, cell=ss.box([float(held["size"])] * 3, [True] * 3, 3), skin=0.2)


def grain_step_times(counts) -> list[float]:
    """Nanoseconds per grain-step of each size, alternating, best of three."""
    states = [ss.run(packing(n), LAW, 100, DT, threads=1)[0] for n in counts]
    found = [[] for _ in counts]
    for _ in range(3):
        for n, state, times in zip(counts, states, found, strict=True):
            runs, start = max(1, GRAIN_STEPS // (n * SIZE_STEPS)), time.perf_counter()
            for _ in range(runs):
                ss.run(state, LAW, SIZE_STEPS, DT, threads=1)
            times.append(1e9 * (time.perf_counter() - start) / (runs * SIZE_STEPS * n))
    return [min(times) for times in found]


def main() -> None:
    """Print the analysis."""
    n = int(float(sys.argv[1])) if len(sys.argv) > 1 else 100_000
    (stream, line), (size, lines), (few, many_grains) = costs(), memory_traffic(n), grain_step_times((1000, n))
    beyond = many_grains - few
    print(f"{n} grains: {many_grains:.0f} ns per grain-step; 1000 grains: {few:.0f} ns; difference {beyond:.0f} ns")
    print(f"  streams: {size:.0f} bytes at {1 / stream:.1f} GB/s: {size * stream:.0f} ns")
    print(f"  lines at arbitrary addresses: {lines:.1f} at {line:.0f} ns: {lines * line:.0f} ns")


if __name__ == "__main__":
    main()
