"""The slider's integrator against SciPy's odeint on the same compiled equations, alternating, with equal tolerances."""

import time

import numpy as np
from scipy.integrate import odeint

from stickslip.friction import kernel

TOLERANCE, SAMPLES, ROUNDS = 1e-10, 500, 5
PARAMETERS = np.array([0.0247, 0.0178, 5.3e-3, 0.4, 0.02, 168.0, 0.0, 0.0])  # paper 003 and a spring, slip law
HISTORIES = {  # durations [s] and velocities of the load point [m/s]
    "slider, one velocity step": ([0.2, 1.0], [0.02, 0.2]),
    "slider, five holds": ([1.0, 0.3, 1.0, 1.0, 1.0, 3.0, 1.0, 10.0, 1.0, 30.0, 1.0], [0.02, 0.0] * 5 + [0.02]),
}


def ours(duration, velocity, times) -> np.ndarray:
    """ln V/V0 and ln V0 θ/D_c at all times by the package's kernel."""
    normal = np.ones(len(duration))
    return kernel.follow(0.0, 0.0, PARAMETERS, 0.0, duration, velocity, normal, 1.0, times, TOLERANCE)[0]


def theirs(duration, velocity, times) -> np.ndarray:
    """The same by odeint, restarted at every leg."""

    def slopes(_, y, v):
        return np.reshape(kernel.slopes(y[0], y[1], PARAMETERS, v, 1.0), (2, 2))

    def rates(_, y, v):
        return kernel.rates(y[0], y[1], PARAMETERS, v, 1.0)

    place, start, rows = np.zeros(2), 0.0, [np.zeros((1, 2))]
    for end, v in zip(np.cumsum(duration), velocity, strict=True):
        within = times[(times > start) & (times <= end)]
        found = odeint(
            rates, place, np.r_[start, within, end * (1 + 1e-15)], args=(v,), Dfun=slopes, tfirst=True,
            rtol=TOLERANCE, atol=TOLERANCE, mxstep=100_000,
        )  # fmt: skip
        rows.append(found[1:-1])
        place, start = found[-1], end
    return np.concatenate(rows)


def rows() -> list[dict]:
    """Solutions a second of both, and how far they are apart."""
    found = []
    for case, (duration, velocity) in HISTORIES.items():
        duration, velocity = np.array(duration), np.array(velocity)
        times = np.linspace(0.0, duration.sum() * (1 - 1e-12), SAMPLES)
        apart = np.abs(ours(duration, velocity, times) - theirs(duration, velocity, times)).max()
        best = [np.inf, np.inf]
        for _ in range(ROUNDS):
            for k, side in enumerate((ours, theirs)):
                start = time.perf_counter()
                side(duration, velocity, times)
                best[k] = min(best[k], time.perf_counter() - start)
        mine, peer = (1 / seconds for seconds in best)
        name = f"SciPy odeint, {apart:.0e} apart"
        found.append({
            "case": f"{case}, solutions/s", "n": 1, "threads": 1, "ours": mine, "peer": peer, "peer_name": name,
            "ratio": mine / peer, "unit": "1/s",
        })  # fmt: skip
    return found
