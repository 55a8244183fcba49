"""Strain steps of sphere packings compared with damped dynamics, and spectra of large packings compared with LAPACK."""

import pickle
import time
from pathlib import Path
from unittest import mock

import numpy as np
from scipy.linalg import eig, eigvals

import stickslip as ss
from stickslip.core.dynamics.run import run
from stickslip.core.measure import mean_normal_force
from stickslip.data.archive import SCHEMA
from stickslip.loading.packing import jammed, sheared
from stickslip.loading.quasistatic import aqs
from stickslip.solve.equilibrate import equilibrate
from stickslip.solve.freedom import dynamical_matrix, freedom
from stickslip.solve.linear import has_pardiso, one_thread
from stickslip.solve.newton import Factorisation

LAW = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")
TOLERANCE, STEP = 5e-14, 1e-5
STORE = Path("results") / "benchmark-packings"  # large packings take minutes and are saved


def packing(n: int, strain: float = 2e-4):
    """Packing at φ = 0.68, sheared slightly so that contacts carry slip."""
    path = STORE / f"{n}-{SCHEMA}.pkl"  # the file depends on the layout of states
    if path.exists():
        return pickle.loads(path.read_bytes())
    state, _ = jammed(n, packing_fraction=0.68, seed=0)
    protocol = aqs(LAW)
    for gamma in np.arange(1, 11) * strain / 10:
        state, _ = protocol.settle(protocol.apply(state, gamma), gamma)
    STORE.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(state))
    return state


def relax_damped(state, *, drag, spin_drag, dt):
    """Force evaluations and seconds until the forces balance, checked every 200 steps."""
    evaluations, start = 0, time.perf_counter()
    here = sheared(state, STEP)
    while True:
        here, _, _ = run(here, LAW, 200, dt, drag=drag, spin_drag=spin_drag)
        evaluations += 200
        rest = here._replace(grains=here.grains._replace(velocity=0 * here.grains.velocity, spin=0 * here.grains.spin))
        if ss.measure.residual(rest, LAW)[0] <= TOLERANCE and np.abs(here.grains.velocity).max() * drag <= TOLERANCE:
            return evaluations, time.perf_counter() - start
        if evaluations >= 2_000_000:
            return np.inf, np.inf


def newton_steps(state, count: int, check: str = "buckling", step: float = STEP):
    """Seconds per strain step after a warm-up, the largest residual, and factorisations per step."""
    keep, worst = Factorisation(), 0.0
    state, _ = equilibrate(sheared(state, step), LAW, keep=keep, check=check)
    start, before = time.perf_counter(), keep.factorisations
    for _ in range(count):
        state, outcome = equilibrate(sheared(state, step), LAW, keep=keep, check=check)
        if not outcome.ok:
            raise RuntimeError(str(outcome))
        worst = max(worst, outcome.residual)
    return (time.perf_counter() - start) / count, worst, (keep.factorisations - before) / count


def long_steps(n: int, count: int) -> list[dict]:
    """Alternating steps of 1e-5 and 1e-4 from the same packing; long steps refactorise and rearrange."""
    state, found = packing(n), {}
    for _ in range(3):
        for step in (STEP, 10 * STEP):
            seconds, _, again = newton_steps(state, count, "nothing", step)
            found[step] = min(found.get(step, (np.inf, 0.0)), (seconds, again))
    (short, few), (long, many) = found[STEP], found[10 * STEP]
    name = f"step of {STEP:.0e} ({few:.1f} factorisations)"
    line = row(f"strain step of {10 * STEP:.0e} ({many:.1f} factorisations)", n, long, short, name)
    return [line | {"ratio": long / short}]


def strain_steps() -> list[dict]:
    """Newton's method with reused factorisations against the paper's drag and strong drag, N = 100, best of three."""
    state = packing(100)
    run(state, LAW, 200, 0.1, drag=0.1)
    newton_steps(state, 3)
    ours, paper, strong, call = [], [], [], []
    for _ in range(3):
        ours.append(newton_steps(state, 30)[0])
        paper.append(relax_damped(state, drag=0.022, spin_drag=0.0, dt=0.1))
        strong.append(relax_damped(state, drag=0.3, spin_drag=0.3, dt=0.2))
        start = time.perf_counter()
        run(state, LAW, 5000, 0.1)
        call.append((time.perf_counter() - start) / 5000)
    mine, one = min(ours), min(call)
    rows = [
        row(
            "strain step, force evaluations",
            100,
            mine / one,
            min(p[0] for p in paper),
            "drag 0.022 on translations",
            "",
        ),
        row("strain step", 100, mine, min(p[1] for p in paper), "drag 0.022 on translations"),
        row("strain step", 100, mine, min(s[1] for s in strong), "drag 0.3 on both"),
    ]
    for r in rows:
        r["ratio"] = r["peer"] / r["ours"]
    return rows


def row(case: str, n: int, ours: float, peer: float | None, peer_name: str, unit: str = "s") -> dict:
    """One row of the table; the ratio is our time over a budget, or a peer's time over ours."""
    ratio = ours / peer if peer else None
    return {
        "case": case, "n": n, "threads": 2, "ours": ours, "peer": peer, "peer_name": peer_name, "ratio": ratio,
        "unit": unit,
    }  # fmt: skip


def steps_at_size(sizes) -> list[dict]:
    """Seconds per strain step with PARDISO (with a budget) and with SuperLU."""
    rows = []
    for n, budget in sizes:
        state = packing(n)
        count = 20 if n <= 1000 else 8
        if has_pardiso():
            for case, check in (("as in a path", "nothing"), ("with check for buckling", "buckling")):
                seconds = newton_steps(state, count, check)[0]
                rows.append(row(f"strain step {case}, PARDISO", n, seconds, budget, "budget"))
        if n <= 4000:
            with mock.patch("stickslip.solve.linear.has_pardiso", return_value=False):
                rows.append(
                    row("strain step as in a path, SuperLU", n, newton_steps(state, count, "nothing")[0], None, "")
                )
    return rows


def pairs_at_size() -> list[dict]:
    """All complex pairs at N = 1000 compared with dense LAPACK, both measured in this run."""
    from stickslip.solve.pairs import complex_pairs

    protocol, state = aqs(LAW), packing(1000)
    for gamma in 2e-4 + np.arange(1, 31) * 2e-5:
        state, _ = protocol.settle(protocol.apply(state, gamma), gamma)
    start = time.perf_counter()
    found = complex_pairs(state, LAW)
    mine = time.perf_counter() - start
    matrix = dynamical_matrix(state, LAW, freedom(state)).toarray()
    start = time.perf_counter()
    values = eigvals(matrix, overwrite_a=True)
    lapack = time.perf_counter() - start
    truth = values[values.imag > 1e-9 * np.abs(values).max()]
    missed = sum(np.abs(found.eigenvalues - v).min(initial=np.inf) > 1e-3 * v.imag + 1e-12 for v in truth)
    name = f"LAPACK ({len(truth)} pairs; {len(found.eigenvalues)} found, {missed} missed)"
    out = row("all complex pairs", 1000, mine, lapack, name)
    out["ratio"] = lapack / mine
    return [out, row("all complex pairs", 1000, mine, 45.0, "budget")]


def sheared_packing(n: int):
    """Packing at a strain of 8e-4 (4e-4 with 10,000 spheres), where it has pairs; saved like `packing`."""
    path = STORE / f"{n}-sheared-{SCHEMA}.pkl"
    if path.exists():
        return pickle.loads(path.read_bytes())
    protocol, state = aqs(LAW), packing(n)
    for gamma in 2e-4 + (np.arange(1, 11) * 2e-5 if n >= 10_000 else np.arange(1, 7) * 1e-4):
        state, _ = protocol.settle(protocol.apply(state, gamma), gamma)
    path.write_bytes(pickle.dumps(state))
    return state


def pairs_by_size(sizes):
    """All complex pairs compared with LAPACK with and without eigenvectors, in processor seconds on one thread."""
    from stickslip.solve.pairs import complex_pairs

    for n in sizes:
        state = sheared_packing(n)
        matrix = dynamical_matrix(state, LAW, freedom(state)).toarray()
        with one_thread():
            times = []
            for solve in (lambda: complex_pairs(state, LAW), lambda: eigvals(matrix), lambda: eig(matrix)):  # noqa: B023
                start = time.process_time()
                solve()
                times.append(time.process_time() - start)
        for peer, words in zip(times[1:], ("λ only", "λ and modes"), strict=True):
            line = row("all complex pairs with modes", n, times[0], peer, f"LAPACK, {words}") | {"threads": 1}
            yield line | {"ratio": peer / times[0]}


def spectra(*, smallest: bool = False):
    """Yield the rows for all pairs of large packings; the fastest pair has a separate benchmark."""
    yield from pairs_by_size([100] if smallest else [300, 600, 1000])


def robustness(n: int, steps: int, seeds) -> list[dict]:
    """Number of strain steps of 1e-3 that needed damped dynamics, and the largest residual."""
    rows = []
    for seed, fraction in seeds:
        state, _ = jammed(n, packing_fraction=fraction, seed=seed)
        keep, helped, worst, start = Factorisation(), 0, 0.0, time.perf_counter()
        for _ in range(steps):
            state, outcome = equilibrate(sheared(state, 1e-3), LAW, keep=keep, check="nothing")
            if not outcome.ok:
                raise RuntimeError(str(outcome))
            helped, worst = helped + outcome.fallback, max(worst, outcome.residual)
        each = (time.perf_counter() - start) / steps
        case = f"{steps} steps of 1e-3 at {fraction}, seed {seed}: steps with fallback"
        name = f"steps; largest residual {worst:.0e}, {each:.2g} s per step, force {mean_normal_force(state, LAW):.1e}"
        rows.append(row(case, n, helped, steps, name, ""))
    return rows


def rows(*, smallest: bool = False):
    """Yield all rows except those of `spectra`, which is a separate benchmark."""
    if smallest:
        yield from long_steps(30, 2)
        yield from robustness(30, 2, [(0, 0.68)])
        return
    yield from strain_steps()
    yield from long_steps(100, 30)
    yield from steps_at_size([(1000, 0.15), (4000, 2.5), (10_000, 10.0)])
    yield from long_steps(1000, 20)
    yield from pairs_at_size()
    yield from robustness(100, 300, enumerate((0.66, 0.67, 0.68, 0.69, 0.70)))
    yield from robustness(1000, 60, [(0, 0.68)])
