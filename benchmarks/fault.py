"""Time steppers for earthquake cycles: processor time against the error in the time of the second event.

    python -m benchmarks fault

The benchmark problem BP1-QD with cells of 100 m is run for 280 years with our stepper and with `scipy.integrate`
(RK23, RK45, DOP853, LSODA), all with the same compiled rates and one thread. Our stepper is also DOP853, but with
compiled stages and a step size that also depends on the previous error. Tolerances of SciPy's solvers are absolute and
refer to the same unknowns, slip/D_c and ln θ. The error is the difference from our stepper with a tolerance of 1e-9.
The benchmark takes a few minutes.
"""

import time

import numpy as np
from scipy.integrate import DOP853, LSODA, RK23, RK45

from stickslip import friction
from stickslip.wings.faults.friction.fault_record import YEAR
from stickslip.wings.faults.friction.fault_state import NUMBER, Machine, initial_state

YEARS, THRESHOLD, ROUNDS = 280.0, 1e-3, 3
SOLVERS = {"RK23": RK23, "RK45": RK45, "DOP853": DOP853, "LSODA": LSODA}
TOLERANCES = {"RK23": (1e-3, 1e-4), "RK45": (1e-4, 1e-5), "LSODA": (1e-4,)}


def benchmark_fault(cell: float = 100.0):
    """Fault of BP1-QD."""
    return friction.line_fault(
        40e3, cell, a=[(15e3, 0.010), (18e3, 0.025)], b=0.015, dc=8e-3, normal=50e6, shear_modulus=2670 * 3464.0**2
    )


def ours(fault, tolerance: float) -> tuple[float, float, int]:
    """Time of the second event [s], processor time [s], and evaluations of the rates."""
    start = time.process_time()
    found = friction.simulate_fault(fault, YEARS, tolerance=tolerance)
    return found.events.start[1], time.process_time() - start, NUMBER * (found.steps + found.rejected)


def scipys(fault, name: str, tolerance: float) -> tuple[float, float, int]:
    """Time of the second event [s], processor time [s], and evaluations of the rates, with a SciPy solver."""
    state = initial_state(fault)
    machine, n, w = Machine(fault, state.prestress), len(fault.depth), state.log_velocity.copy()
    out, power = np.empty((2, n)), np.empty(3)

    def rates(_, y):
        if not machine.rates(y.reshape(2, n), w, out, power):
            w[:] = state.log_velocity
            return np.full(2 * n, 1e30)
        return out.ravel().copy()

    begin = time.process_time()
    scale = np.r_[fault.dc, np.ones(n)] * tolerance
    y = np.r_[state.excess_slip, state.log_state]
    solver = SOLVERS[name](rates, 0.0, y, YEARS * YEAR, rtol=1e-13, atol=scale, first_step=state.step)
    before, events, fast = (0.0, fault.plate_rate), [], False
    while solver.status == "running" and time.process_time() - begin < 120:
        solver.step()
        rates(0.0, solver.y)
        now = solver.t, fault.v0 * float(np.exp(w.max()))
        if now[1] >= THRESHOLD and not fast:
            share = np.log(THRESHOLD / before[1]) / np.log(now[1] / before[1])
            events.append(before[0] + share * (now[0] - before[0]))
        fast, before = now[1] >= THRESHOLD, now
    return events[1] if len(events) > 1 else np.nan, time.process_time() - begin, solver.nfev


def rows(*, smallest: bool = False):
    """Table; processor times are the shortest of three rounds in which steppers alternate."""
    fault = benchmark_fault()
    exact = ours(fault, 1e-2 if smallest else 1e-9)[0]
    yield f"second event after {exact / YEAR:.6f} years"
    if smallest:
        return
    cases = [(name, one) for name in ("ours", *SOLVERS) for one in TOLERANCES.get(name, (1e-2, 1e-3, 1e-4, 1e-5))]
    best: dict[tuple, tuple] = {}
    for _ in range(ROUNDS):
        for name, tolerance in cases:
            event, seconds, number = ours(fault, tolerance) if name == "ours" else scipys(fault, name, tolerance)
            before = best.get((name, tolerance), (np.inf,))[0]
            best[name, tolerance] = min(before, seconds), abs(event - exact), number
    yield ("stepper   tolerance   error [s]   processor time [s]   evaluations")
    for (name, tolerance), (seconds, error, number) in best.items():
        yield (f"{name:8s} {tolerance:10.0e} {error:11.3g} {seconds:20.2f} {number:13d}")
