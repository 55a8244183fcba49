"""Time to generate packings: `jammed` at a packing fraction and at a pressure, `compressed` with friction."""

import time

import stickslip as ss

from .spheres import row


def cpu_seconds(make, **options) -> float:
    """Processor time of one packing, after a small one that compiles."""
    make(**options | {"n": 30})
    start = time.process_time()
    make(**options)
    return time.process_time() - start


def rows(full: bool) -> list[dict]:
    """All rows, in processor time of one thread; budgets for spheres. 10,000 spheres require `--large`."""
    jammed, compressed = ss.packings.jammed, ss.packings.compressed
    found = []
    for n, budget in [(1000, None), (4000, 10.0)] + ([(10_000, 40.0)] if full else []):
        seconds = cpu_seconds(jammed, n=n, packing_fraction=0.68)
        found.append(row("jammed spheres at 0.68", n, seconds, budget, "budget" if budget else ""))
    found.append(row("jammed spheres at p = 1e-4", 1000, cpu_seconds(jammed, n=1000, pressure=1e-4), None, ""))
    for dim, words in ((2, "disks"), (3, "spheres")):
        seconds = cpu_seconds(compressed, n=400, mu=0.5, pressure=1e-4, dim=dim)
        found.append(row(f"frictional {words} at p = 1e-4", 400, seconds, None, ""))
    return [line | {"threads": 1} for line in found]
