"""Time per step of laws with rolling, twisting or more memory, and of user-defined laws, relative to `hertz_mindlin`.

python -m benchmarks contact_laws
"""

import math
import time

import numpy as np

import stickslip as ss

from .records import number

ROUNDS, STEPS, DT = 7, 300, 0.05
HM = "hertz_mindlin"
HERTZ = {"kn": 1.0, "kt": 2 / 7, "mu": 0.5}


def normal_force(overlap, kn):
    return kn * overlap * math.sqrt(overlap)


def tangential_stiffness(overlap, kt):
    return kt * math.sqrt(overlap)


def rolling_stiffness(overlap, kr):
    return kr * overlap


def rolling_cap(normal_force, mu_r):
    return mu_r * normal_force


def gas(side: int) -> ss.State:
    """Moving spheres in contact in a periodic box."""
    rng = np.random.default_rng(0)
    place = np.stack(np.meshgrid(*3 * [np.arange(side)], indexing="ij"), -1).reshape(-1, 3) * 0.98
    grains = ss.spheres(place + rng.normal(0, 0.01, place.shape), 0.5, velocity=rng.normal(0, 0.01, place.shape))
    return ss.assembly(grains, cell=ss.box([side * 0.98] * 3, [True] * 3, 3))


def ratio(state: ss.State, one: ss.Law, other: ss.Law, steps: int = STEPS) -> float:
    """Shortest time with the second law over that with the first, on one thread."""
    best = [np.inf, np.inf]
    for _ in range(ROUNDS):
        for k, law in enumerate((one, other)):
            start = time.process_time()
            ss.run(state, law, steps, DT, threads=1)
            best[k] = min(best[k], time.process_time() - start)
    return best[1] / best[0]


def cases():
    """Yield all cases: name of the law, side of the cube of spheres, name of the reference, law, and reference law."""
    own = {"normal_force": normal_force, "tangential_stiffness": tangential_stiffness}
    rolls = {"rolling_stiffness": rolling_stiffness, "rolling_cap": rolling_cap}
    plain, damped = ss.laws.hertz_mindlin(**HERTZ), ss.laws.hertz_mindlin(**HERTZ, damping_n=0.1, damping_t=0.1)
    yield "copy of hertz_mindlin", 14, HM, ss.laws.custom(**own, parameters=HERTZ), plain
    yield (
        "with rolling resistance",
        10,
        HM,
        ss.laws.custom(**own, **rolls, parameters=HERTZ | {"kr": 0.01, "mu_r": 0.1}),
        plain,
    )
    rolling = ss.laws.with_rolling(damped, k_roll=0.05, mu_roll=0.1, gamma_roll=0.1)
    yield "rolling spring", 14, HM, rolling, damped
    twisting = ss.laws.with_twisting(rolling, k_twist=0.05, mu_twist=0.1, gamma_twist=0.1)
    yield "rolling and twisting springs", 14, HM, twisting, damped
    yield "memory of forces", 14, HM, ss.laws.with_memory(damped, "force"), damped
    linear = ss.laws.linear(kn=1.0, kt=2 / 7, mu=0.5)
    yield "walton_braun", 14, "linear", ss.laws.walton_braun(kn=1.0, kt=2 / 7, mu=0.5, k_unload=2.0), linear


def rows(*, smallest: bool = False):
    """Ratios of all cases."""
    for name, side, base, law, other in cases():
        state = gas(5 if smallest else side)
        for one in (other, law):
            ss.run(state, one, 10, DT, threads=1)  # compile, or load from the cache
        took = ratio(state, other, law, 2 if smallest else STEPS)
        yield number(f"{name}, {len(state.grains.radius)} spheres, time over that of {base}", took)
