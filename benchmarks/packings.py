"""Time to generate packings: `jammed` at a packing fraction and at a pressure, `compressed` with friction."""

import time

import stickslip as ss

from .spheres import row


def cpu_seconds(make, **options) -> float:
    """Processor time of one packing, after a small packing that compiles the code."""
    make(**options | {"n": 30})
    start = time.process_time()
    make(**options)
    return time.process_time() - start


def rows(*, smallest: bool = False):
    """Yield all rows: processor times on one thread, with budgets for spheres."""
    one = {"threads": 1}
    for n, budget in [(30, None)] if smallest else [(1000, None), (4000, 10.0), (10_000, 40.0)]:
        seconds = cpu_seconds(ss.packings.jammed, n=n, packing_fraction=0.68)
        yield row("jammed spheres at 0.68", n, seconds, budget, "budget" if budget else "") | one
    n = 30 if smallest else 1000
    yield row("jammed spheres at p = 1e-4", n, cpu_seconds(ss.packings.jammed, n=n, pressure=1e-4), None, "") | one
    n = 30 if smallest else 400
    for dim, words in ((2, "disks"), (3, "spheres")):
        seconds = cpu_seconds(ss.packings.compressed, n=n, mu=0.5, pressure=1e-4, dim=dim)
        yield row(f"frictional {words} at p = 1e-4", n, seconds, None, "") | one
