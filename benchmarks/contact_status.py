"""Status of 400 critical contacts of 3000 disks: `contact_status`, cold and warm, against slower methods.

The disks fill a periodic box at packing fraction 0.83 and are relaxed with friction 0.2 by damped dynamics, which takes
two seconds. They are then also in balance with friction 0.5, without contacts at the limit. Critical contacts and their
sliding directions are drawn at random; no disk has two critical contacts, and disks with one have at least three
contacts.
"""

import time

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

import stickslip as ss
from stickslip.solve.equilibrate import relax
from stickslip.solve.linear import one_thread
from stickslip.wings.status.apex_status import contact_status
from stickslip.wings.status.complementarity import complementarity, lemke, principal_pivoting
from stickslip.wings.status.matrices import LinearSystem, linear_system, stiffness_matrix
from stickslip.wings.status.system import pinned_coordinates
from stickslip.wings.status.uniqueness import certificate

DISKS, CRITICAL, CHANGED, ROUNDS = 3000, 400, 5, 7
COLD, WARM = 0.25, 0.1  # budgets [s]


def packing(n: int = DISKS):
    """Disks at rest and their law: placed on a randomly perturbed lattice, quenched at constant volume."""
    rng = np.random.default_rng(1)
    radius = np.where(np.arange(n) % 2, 0.4, 0.6)
    side, across = np.sqrt(np.pi * (radius**2).sum() / 0.83), int(np.ceil(np.sqrt(n)))
    cells = rng.permutation(across**2)[:n]
    place = (np.stack([cells % across, cells // across], axis=1) + 0.5) * side / across
    grains = ss.disks(place + rng.normal(0, 0.1, place.shape), radius, mass=4 * radius**2)
    state = ss.assembly(grains, cell=ss.box([side, side, 1.0], [True, True, False], dim=2), control=ss.control.loads(n))
    slippery = ss.laws.linear(1.0, 0.5, 0.2, coulomb="sharp", damping="mass_velocity", damping_n=0.2, damping_t=0.2)
    state, outcome = relax(state, slippery, tolerance=1e-10, drag=0.02, dt=0.2, steps=400_000)
    if not outcome.ok:
        raise RuntimeError(str(outcome))
    return state, ss.laws.linear(1.0, 0.5, 0.5, coulomb="sharp")


def draw_critical(state, matrix: LinearSystem, seed: int, count: int) -> tuple[LinearSystem, np.ndarray]:
    """Draw signs of all contacts, and critical contacts: at most one per disk, none at disks with two contacts."""
    rng = np.random.default_rng(seed)
    ends = np.stack([state.contacts.i[matrix.rows], state.contacts.j[matrix.rows]], axis=1)
    taken, found = np.bincount(ends.ravel(), minlength=state.n_bodies) < 3, []
    for contact in rng.permutation(matrix.count):
        if len(found) < count and not taken[ends[contact]].any():
            taken[ends[contact]] = True
            found.append(contact)
    return matrix._replace(sign=rng.choice([-1.0, 1.0], matrix.count)), np.sort(found)


def shear_load(state, matrix: LinearSystem) -> np.ndarray:
    """Load rate that shears the packing: minus the contact forces of an affine shear at unit rate."""
    branch = ss.measure.branch_vectors(state)[matrix.rows]
    normal = branch / np.linalg.norm(branch, axis=1, keepdims=True)
    relative = branch[:, 1:2] * np.stack([normal[:, 0], normal[:, 1]], axis=1)
    return matrix.c @ np.einsum("mab,mb->ma", matrix.springs, relative).ravel()


def flip_and_solve(matrix: LinearSystem, load, critical, sliding) -> tuple[np.ndarray, int]:
    """Find sliding contacts by flipping all inconsistent contacts after each `spsolve`; also return the rounds."""
    kept = np.setdiff1d(np.arange(len(matrix.free)), pinned_coordinates(matrix))
    sliding, v = sliding.copy(), np.zeros(len(load))
    for turn in range(1, 60):
        v[kept] = spsolve(sparse.csc_array(stiffness_matrix(matrix, sliding)[kept][:, kept]), load[kept])
        relative = (matrix.c.T @ v).reshape(-1, 2)
        rate = (matrix.slope * relative[:, 0] + matrix.sign * relative[:, 1])[critical]
        wrong = (rate > 0) != sliding[critical]
        if not wrong.any():
            return sliding, turn
        sliding[critical[wrong]] ^= True
    raise RuntimeError("flipping does not converge")


def problem(disks: int = DISKS, count: int = CRITICAL):
    """Return the first draw for which no minor of one or two contacts shows that the status is not unique."""
    state, law = packing(disks)
    seconds, plain = time_call(lambda: linear_system(state, law))
    for seed in range(20):
        matrix, critical = draw_critical(state, plain, seed, count)
        load = shear_load(state, matrix)
        if certificate(complementarity(matrix, load, critical=critical)).unique is not False:
            return (
                min(seconds, *(time_call(lambda: linear_system(state, law))[0] for _ in range(ROUNDS))),
                matrix,
                critical,
                load,
            )
    raise RuntimeError("no draw of critical contacts has a unique status")


def time_call(call) -> tuple:
    """Return the seconds taken by a call, and its result."""
    start = time.perf_counter()
    answer = call()
    return time.perf_counter() - start, answer


def rows(*, smallest: bool = False) -> list[dict]:
    """Return all rows, with the best times of several rounds in which methods alternate, on one thread."""
    made, matrix, critical, load = problem(*((100, 5) if smallest else (DISKS, CRITICAL)))
    all_slide = np.isin(np.arange(matrix.count), critical)
    truth = contact_status(matrix, load, critical=critical)
    near = truth.sliding.copy()
    near[np.random.default_rng(0).choice(critical, CHANGED, replace=False)] ^= True

    def by(algorithm):
        sliding = np.zeros(matrix.count, bool)
        sliding[critical] = algorithm(complementarity(matrix, load, critical=critical))
        return sliding

    sides = {
        "cold": lambda: contact_status(matrix, load, critical=critical).sliding,
        "warm": lambda: contact_status(matrix, load, critical=critical, start=near).sliding,
        "principal pivoting": lambda: by(lambda a: principal_pivoting(a)[0]),
        "Lemke": lambda: by(lambda a: lemke(a) > 0),
        "flips and spsolve": lambda: flip_and_solve(matrix, load, critical, all_slide)[0],
        "flips and spsolve, warm": lambda: flip_and_solve(matrix, load, critical, near)[0],
    }
    best = dict.fromkeys(sides, np.inf)
    with one_thread():
        for _ in range(ROUNDS):
            for name, side in sides.items():
                seconds, sliding = time_call(side)
                if not np.array_equal(sliding, truth.sliding):
                    raise RuntimeError(f"{name} found a different status")
                best[name] = min(best[name], seconds)
    return table(best, made, matrix.count, truth)


def table(best: dict, made: float, contacts: int, truth) -> list[dict]:
    """Format the rows; ratios are our time over a budget, or the time of another method over ours."""
    cold = f"contact status, {CRITICAL} critical, cold"
    warm = f"contact status, {CHANGED} of {CRITICAL} changed, warm"
    found = f"budget ({truth.method}, {truth.solves} factors, {truth.sliding.sum()} slide)"
    out = [row(cold, best["cold"], COLD, found, False), row(warm, best["warm"], WARM, "budget", False)]
    out += [row(cold, best["cold"], best[name], name) for name in ("principal pivoting", "Lemke", "flips and spsolve")]
    out.append(row(warm, best["warm"], best["flips and spsolve, warm"], "flips and spsolve"))
    return [*out, row("matrices of the same disks", made, None, "")]


def row(case: str, ours: float, peer: float | None, name: str, over: bool = True) -> dict:
    """Row of the benchmark for one case."""
    ratio = (peer / ours if over else ours / peer) if peer else None
    return {
        "case": case, "n": DISKS, "threads": 1, "ours": ours, "peer": peer, "peer_name": name, "ratio": ratio,
        "unit": "s",
    }  # fmt: skip
