"""Spring-slider integrator and compiled LSODA (numbalsoda) on the same equations, alternating.

Both restart at every leg and are called once per history. They are compared at equal tolerances, and with a smaller
tolerance of LSODA that makes errors about equal. Errors are relative to our integrator at a tolerance of 1e-13.
"""

import time

import numpy as np

from stickslip.wings.faults.friction.laws import RateState, Spring, history, slider_of

TOLERANCE, TIGHTER, EXACT, SAMPLES, ROUNDS = 1e-10, 1e-12, 1e-13, 500, 25
# Ferdowsi & Rubin 2021, with a spring and the aging law
SURFACE, SPRING = RateState(0.0247, 0.0178, 5.3e-3, 0.4, 0.02), Spring(168.0)
HISTORIES = {  # durations [s] and velocities of the load point [m/s]
    "spring-slider, one velocity step": ([0.2, 1.0], [0.02, 0.2]),
    "spring-slider, five holds": ([1.0, 0.3, 1.0, 1.0, 1.0, 3.0, 1.0, 10.0, 1.0, 30.0, 1.0], [0.02, 0.0] * 5 + [0.02]),
}


def ours(duration, velocity, times, tolerance=TOLERANCE) -> np.ndarray:
    """ln V/V0 and ln V0 θ/D_c at all times, from stickslip."""
    legs = np.stack([duration, velocity, np.ones(len(duration))])
    return history(slider_of(SURFACE, SPRING), (0.0, 0.0, 0.0), legs, times, tolerance)[0][:, :2]


def compiled_lsoda():
    """Return a function like `ours` that uses LSODA in C++ with compiled equations; may raise ImportError."""
    from numba import carray, cfunc, njit
    from numbalsoda import lsoda, lsoda_sig

    a, b, dc, _, v0 = SURFACE[:5]
    stiffness = SPRING.stiffness

    @cfunc(lsoda_sig)
    def rates(_, y, dy, given):
        (w, s), velocity, slope = carray(y, (2,)), carray(given, (1,))[0], carray(dy, (2,))
        e = np.exp(w)
        slope[1] = v0 / dc * (np.exp(-s) - e)
        slope[0] = (stiffness * (velocity - v0 * e) - b * slope[1]) / a

    address = rates.address

    @njit
    def follow_legs(duration, velocity, times, tolerance):
        found, place, given = np.zeros((len(times), 2)), np.zeros(2), np.zeros(1)
        start, k = 0.0, 1
        for leg in range(len(duration)):
            end, first, given[0] = start + duration[leg], k, velocity[leg]
            while k < len(times) and times[k] <= end:
                k += 1
            at = np.concatenate((np.array([start]), times[first:k], np.array([end * (1 + 1e-15)])))
            rows, good = lsoda(address, place, at, given, tolerance, tolerance, 100_000)
            if not good:
                raise RuntimeError("LSODA failed")
            found[first:k], start = rows[1:-1], end
            place[:] = rows[-1]
        return found

    return follow_legs


def rows(*, smallest: bool = False):
    """Solutions per second of both integrators, and their errors; only those of ours if LSODA is not installed."""
    try:
        theirs = compiled_lsoda()
    except ImportError:
        yield "LSODA skipped: install it with `pip install numbalsoda` (needs a Fortran compiler)"
        theirs = None
    for case, (duration, velocity) in HISTORIES.items():
        duration, velocity = np.array(duration), np.array(velocity)
        times = np.linspace(0.0, duration.sum() * (1 - 1e-12), SAMPLES)
        exact = ours(duration, velocity, times, EXACT)
        for tolerance in (TOLERANCE, TIGHTER) if theirs else (TOLERANCE,):
            sides = [lambda: ours(duration, velocity, times)]  # noqa: B023
            sides += [lambda: theirs(duration, velocity, times, tolerance)] if theirs else []  # noqa: B023
            errors, best = [np.abs(side() - exact).max() for side in sides], [np.inf] * len(sides)
            for _ in range(1 if smallest else ROUNDS):
                for k, side in enumerate(sides):
                    start = time.perf_counter()
                    side()
                    best[k] = min(best[k], time.perf_counter() - start)
            mine, peer = 1 / best[0], 1 / best[1] if theirs else None
            name = f"LSODA to {tolerance:.0e} (error {errors[-1]:.0e}, ours {errors[0]:.0e})"
            yield {
                "case": f"{case}, solutions/s", "n": 1, "threads": 1, "ours": mine, "peer": peer, "peer_name": name,
                "ratio": mine / peer if peer else None, "unit": "1/s",
            }  # fmt: skip
