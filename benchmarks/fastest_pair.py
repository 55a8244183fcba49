"""Fastest-growing pair of large packings: processor time, and checks against dense spectra and runs.

    python -m benchmarks fastest_pair [1000] [4000] [10000] [100000] [crystal]

Sheared packings have 1000, 4000 and 10,000 spheres, or 100,000 spheres as ten side-by-side copies of the last, for
which factors do not fit into memory. The time of a quasi-static strain step is measured as well. The engine then runs
for one e-folding time, starting on the mode found.

`crystal` consists of 10,000 spheres in 200 copies of a small cell. Like 100,000 spheres, it is searched without
factors. By Bloch's theorem, its spectrum is that of 200 small matrices, A(k) = Σ_R A_0R exp(ik·R), which LAPACK
computes in full.
"""

import resource
import time
import warnings

import numpy as np
from scipy import sparse
from scipy.linalg import eigvals

import stickslip as ss
from stickslip.core.dynamics.run import run
from stickslip.loading.packing import jammed
from stickslip.loading.quasistatic import aqs
from stickslip.solve.fastest import fastest_pair
from stickslip.solve.freedom import displaced, dynamical_matrix, moving
from stickslip.solve.linear import one_thread

from .spheres import LAW, row, sheared_packing

BUDGETS = {10_000: 120.0, 100_000: 3600.0}  # seconds


def tiled(state, times):
    """Return side-by-side copies of a periodic packing as one packing; numbers grow fastest along the last axis."""
    times, contacts, rows = np.array(times), state.contacts, ss.measure.touching(state)
    cells = np.stack(np.meshgrid(*map(np.arange, times), indexing="ij"), -1).reshape(-1, 3)
    count, n = len(cells), len(state.grains.radius)
    reached = cells[:, None] - contacts.image[rows]  # r_ij = r_i − r_j + cellᵀ·image
    copy = np.ravel_multi_index(np.moveaxis(reached % times, 2, 0), times)
    position = (state.grains.position + (cells @ state.cell.vectors)[:, None]).reshape(-1, 3)
    return ss.packings.from_arrays(
        position, np.tile(state.grains.radius, count), LAW, mass=np.tile(state.grains.mass, count),
        cell=state.cell.vectors * times[:, None], dim=3,
        pair_i=(np.arange(count)[:, None] * n + contacts.i[rows]).ravel(),
        pair_j=(copy * n + contacts.j[rows]).ravel(), image=(reached % times - reached).reshape(-1, 3) // times,
        slip=np.tile(contacts.slip[rows], (count, 1)), mode=np.tile(contacts.mode[rows], count),
    )  # fmt: skip


def bloch_spectrum(matrix, times) -> np.ndarray:
    """All eigenvalues with Im λ > 0 of the matrix A of a `tiled` packing, from the rows of its first copy."""
    size = matrix.shape[0] // int(np.prod(times))
    first = sparse.coo_array(matrix[:size])
    cell = np.stack(np.unravel_index(first.col // size, times))
    found = []
    for k in np.ndindex(*times):
        if k > tuple((-np.array(k)) % times):  # −k has the complex conjugate eigenvalues
            continue
        phase = np.exp(2j * np.pi * (np.array(k) / times) @ cell)
        block = np.zeros((size, size), complex)
        np.add.at(block, (first.row, first.col % size), first.data * phase)
        values = eigvals(block, overwrite_a=True)
        found.append(np.where(values.imag > 0, values, values.conj()))
    return np.concatenate(found)


def growth_in_a_run(state, found) -> float:
    """Growth rate in a run of the engine from the mode, over whole periods of about one e-folding time [1/time]."""
    s, size = found.growth_rate - 1j * found.frequency, 1e-6 / np.abs(found.mode).max()
    start = displaced(moving(state, found.free, (s * size * found.mode).real), found.free, (size * found.mode).real)
    duration = max(1, round(found.frequency / found.growth_rate / (2 * np.pi))) * 2 * np.pi / found.frequency
    steps = int(np.ceil(duration / min(0.2, np.pi / found.frequency / 50)))
    end, _, _ = run(start, LAW, steps, duration / steps)

    def amplitude(now):
        moved = now.grains.position - state.grains.position
        return np.sqrt((now.grains.mass[:, None] * (found.frequency**2 * moved**2 + now.grains.velocity**2)).sum())

    return float(np.log(amplitude(end) / amplitude(start)) / duration)


def searched(state, **options):
    """Fastest-growing pair of a state, and processor seconds of the search."""
    with one_thread():
        start = time.process_time()
        found = fastest_pair(state, LAW, **options)
        return found, time.process_time() - start


def times(n: int):
    """Processor seconds on one thread, with budgets, and the growth rate in a run."""
    state = tiled(sheared_packing(10_000), (5, 2, 1)) if n == 100_000 else sheared_packing(n)
    found, seconds = searched(state)
    yield f"{n} spheres: {found}"
    yield row("fastest pair", n, seconds, BUDGETS.get(n), "budget") | {"threads": 1}
    if n == 100_000:
        protocol = aqs(LAW)
        with one_thread():
            start = time.process_time()
            protocol.settle(protocol.apply(state, 2e-5), 2e-5)
        yield row("strain step of 2e-5", n, time.process_time() - start, 60.0, "budget") | {"threads": 1}
    if found.eigenvalue is not None and found.frequency > 0:
        ratio = growth_in_a_run(state, found) / found.growth_rate
        yield row("fastest pair, growth in a run over that of the eigenvalue", n, ratio, None, "", "") | {"threads": 1}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    yield row("fastest pair, memory so far", n, peak, None, "", "GiB") | {"threads": 1}


def crystal(smallest: bool):
    """Yield the rows for ten thousand spheres whose eigenvalues are known."""
    copies = (2, 2, 1) if smallest else (10, 5, 4)
    cell, protocol = jammed(30 if smallest else 50, packing_fraction=0.68, seed=0)[0], aqs(LAW)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ss.modes.UnstableEquilibriumWarning)
        for gamma in np.arange(1, 11) * 2e-4:
            cell, _ = protocol.settle(protocol.apply(cell, gamma), gamma)
    state = tiled(cell, copies)
    n = len(state.grains.radius)
    found, seconds = searched(state, dense_below=0, factors_up_to=0)
    yield f"crystal of {n} spheres: {found}"
    yield row("fastest pair of a crystal", n, seconds, None, "") | {"threads": 1}
    start = time.process_time()
    truth = bloch_spectrum(dynamical_matrix(state, LAW), copies)
    growth = np.abs(np.sqrt(truth).imag) * (truth.imag > 1e-9 * np.abs(truth).max())
    k = int(np.argmax(growth))
    yield f"by Bloch's theorem: λ = {truth[k]:.6g}, growth rate {growth[k]:.4g}; {time.process_time() - start:.0f} s"
    name = "fastest pair of a crystal, growth rate over the largest of all"
    yield row(name, n, found.growth_rate / growth[k], None, "", "") | {"threads": 1}


def rows(*parts: str, smallest: bool = False):
    """Rows of the named parts; default: all."""
    for part in parts or (("100", "crystal") if smallest else ("1000", "4000", "10000", "100000", "crystal")):
        yield from crystal(smallest) if part == "crystal" else times(int(part))
