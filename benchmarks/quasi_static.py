"""Quasi-static strain steps of frictional spheres: CPU time, factorisations per step, and share of fallbacks.

    python -m benchmarks quasi_static

Packings are jammed without friction and sheared by 1e-3 in ten steps with a friction coefficient of 0.5. Packings of
10,000 spheres are sheared by 1.6e-4 in eight steps, because a step with rearrangements takes minutes. The steps that
follow are timed. Contacts slide, open and close in every step; in some steps, grains that become loose rearrange.
"""

import os
import pickle
import time
import warnings

import numpy as np

import stickslip as ss
from stickslip.data.archive import SCHEMA
from stickslip.loading.packing import jammed, sheared
from stickslip.solve.equilibrate import equilibrate
from stickslip.solve.newton import Factorisation

from .spheres import STORE, row

LAW = ss.laws.hertz_mindlin(mu=0.5)
FRACTION, TOLERANCE = 0.66, 5e-14
PREPARING, LARGE_PREPARING = (1e-4, 10), (2e-5, 8)  # size and number of steps before timing, also for 10,000 spheres
BUDGETS = {(1000, 2e-5): 0.1, (1000, 1e-4): 0.1, (4000, 2e-5): 2.0, (4000, 1e-4): 2.0, (10_000, 2e-5): 10.0}


def take_steps(state, step: float, count: int):
    """Take strain steps; return the last state, and CPU seconds, factorisations and fallback of each step."""
    keep, found = Factorisation(), []
    for _ in range(count):
        start, before = time.process_time(), keep.factorisations
        state, outcome = equilibrate(sheared(state, step), LAW, tolerance=TOLERANCE, keep=keep, check="nothing")
        if not outcome.ok:
            raise RuntimeError(str(outcome))
        found.append((time.process_time() - start, keep.factorisations - before, outcome.fallback, outcome.residual))
    return state, np.array(found, float)


def packing(n: int):
    """Sheared packing, saved because large ones take minutes."""
    path = STORE / f"mu05-{n}-{SCHEMA}.pkl"
    if path.exists():
        return pickle.loads(path.read_bytes())
    state, _ = jammed(n, packing_fraction=FRACTION, seed=0)
    state, _ = take_steps(state, *(LARGE_PREPARING if n >= 10_000 else PREPARING))
    STORE.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(state))
    return state


def timed_steps(n: int, step: float, count: int) -> list[dict]:
    """Mean CPU time per step, median number of factorisations, and share of fallbacks."""
    state = packing(n)
    take_steps(state, step, 1)  # compiles the kernels
    seconds, factors, helped, _ = take_steps(state, step, count)[1].T
    case, budget = f"{count} strain steps of {step:.0e}", BUDGETS[n, step]
    rows = [
        row(f"{case}: mean CPU time", n, seconds.mean(), budget, "budget"),
        row(f"{case}: longest", n, seconds.max(), None, ""),
        row(f"{case}: factorisations, median", n, float(np.median(factors)), None, "", ""),
        row(f"{case}: share with fallback", n, helped.mean(), None, "", ""),
    ]
    return [r | {"threads": 1} for r in rows]


def robustness(count: int, packings: int = 20, n: int = 100) -> list[dict]:
    """Steps of 1e-3 at volume fractions from 0.64 to 0.72; any failure stops the benchmark."""
    found = []
    for seed, fraction in enumerate(np.linspace(0.64, 0.72, packings)):
        state, _ = jammed(n, packing_fraction=float(fraction), seed=seed)
        found.append(take_steps(state, 1e-3, count)[1])
    seconds, factors, helped, residual = np.concatenate(found).T
    case = f"{packings * count} strain steps of 1e-03"
    rows = [
        row(f"{case}: mean CPU time", n, seconds.mean(), None, ""),
        row(f"{case}: factorisations, median", n, float(np.median(factors)), None, "", ""),
        row(f"{case}: share with fallback", n, helped.mean(), None, "", ""),
        row(f"{case}: largest residual over tolerance", n, residual.max() / TOLERANCE, None, "", ""),
    ]
    return [r | {"threads": 1} for r in rows]


def rows(*, smallest: bool = False):
    """Yield all rows of timed steps and of robustness."""
    warnings.simplefilter("ignore", ss.packings.PackingWarning)
    os.environ["OMP_NUM_THREADS"] = "1"  # otherwise damped dynamics uses all cores, and waiting threads count as busy
    if smallest:
        yield from robustness(2, packings=1, n=30)
        return
    for case in ((1000, 2e-5, 50), (1000, 1e-4, 50), (4000, 2e-5, 30), (4000, 1e-4, 30), (10_000, 2e-5, 20)):
        yield from timed_steps(*case)
    yield from robustness(500)
