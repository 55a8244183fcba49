"""Fastest growing complex pair of a large system: windows from the bottom of the spectrum, then random probes above.

Growth is g = |Im √λ| ≈ Im λ/(2√λ), so that pairs at the bottom of the spectrum grow fast for their Im λ. The lowest
modes are computed by shift and invert, in block Krylov subspaces of (A − σ)⁻¹, and their number is checked. Higher
modes are searched by tangent dynamics: random probes in a linear leapfrog, and growing peaks of their power spectra.

The leapfrog q_{n+1} − 2q_n + q_{n−1} = −dt² A q_n near the largest stable step is the Chebyshev recurrence. A mode with
√λ = ω + ig advances by θ + iγ per step, λ = (4/dt²) sin²((θ + iγ)/2), so that its power grows as exp(2γn) at frequency
θ.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, NamedTuple

import numpy as np
import scipy  # scipy.ndimage is imported on first use, as this takes a tenth of a second
from scipy import sparse
from scipy.linalg import LinAlgError, eig
from scipy.sparse.linalg import eigsh

from ..core.arguments import POSITIVE, Positive, Seed, checked
from ..core.laws.builtin import Law
from ..core.library import core
from ..core.progress import Report, silent
from ..core.readable import readable
from ..core.state import State
from .freedom import Freedom, dynamical_matrix, freedom
from .linear import Dissection, FrontalFactor, count_below, dissect, suitable_threads
from .spectrum import REAL_BELOW

ROWS = 3  # rows of a block: three displacements, three rotations, or both kinds in two dimensions
LANES = 16  # vectors advanced together: one AVX-512 register, two AVX2 or four NEON registers
SPANS = 8  # power spectra per run; growth is measured relative to the first
BUCKETS = 16  # random sums of coordinates recorded for each probe
BLOCK = 8  # vectors solved for together, which resolves multiplicities up to this number
# subspace dimensions: at the bottom of the spectrum, in other windows, and in windows found too narrow
BOTTOM, SUBSPACES = 560, (240, 560)
CONVERGED = 1e-12  # residual over ‖A‖ of eigenvalues that count as computed
# steps of the first run, few enough to avoid overflow; each run is LONGER times longer than the previous one
SHORTEST, LONGER = 256, 16
WINDOWS = 8  # largest number of windows at the end of a run; their factorisations dominate the time
FEW, PATIENCE = 2, 2  # with more peaks than FEW at its end, a run continues up to PATIENCE times its duration
GAPS = 2  # gaps of the spectrum in which the modes below are counted until the numbers agree
ZERO_MODES = 1e-6  # fraction of the largest λ below which a mode counts as a zero mode
FAINT = 10.0  # a mode is assumed to be excited with at least 1/FAINT of the mean power
DENSE_BELOW = 1500  # number of coordinates for which LAPACK takes two seconds


def time_step(norm: float) -> float:
    """Time step [time]. The limit is 2/√λmax; the Lanczos estimate of λmax is low by less than the margin."""
    return 1.9 / np.sqrt(norm)


class ProbeRun:
    """Probes advanced by the leapfrog, and power spectra of random sums of their coordinates."""

    def __init__(self, matrix, norm: float, span: int, probes: int, rng):
        size = -(-matrix.shape[0] // ROWS) * ROWS  # padding rows of zeros do not move
        self.dt, self.span, self.spectra, self.log_scale = time_step(norm), span, [], 0.0
        # single precision halves the memory traffic of each product and perturbs λ by 1e-7 of the largest
        pull = sparse.csr_array((-(self.dt**2)) * matrix)
        pull.resize(size, size)
        pull = pull.tobsr((ROWS, ROWS))
        blocks = pull.data.reshape(-1, ROWS**2).astype(np.float32)
        self.product = pull.indptr.astype(np.int64), pull.indices.astype(np.uint32), blocks
        self.q = [rng.standard_normal((size, LANES), np.float32) for _ in range(-(-probes // LANES))]
        # velocities half a step before the start, where the probes are at rest
        self.v = [np.ascontiguousarray(-0.5 * (pull @ q), np.float32) for q in self.q]
        self.probes = LANES * len(self.q)
        self.sums = rng.integers(BUCKETS, size=size), rng.choice(np.array([-1, 1], np.float32), size)

    @property
    def time(self) -> float:
        """Time run so far [time]."""
        return len(self.spectra) * self.span * self.dt

    def advance(self):
        """Run one span and store its power spectrum, summed over probes and buckets."""
        with ThreadPoolExecutor() as pool:
            powers, sizes = zip(*pool.map(self._advance_probes, self.q, self.v), strict=True)
        size = max(sizes)
        if not self.log_scale + np.log(size) < 300:  # its square is at the limit of double precision
            raise FloatingPointError(
                "the probes overflow because of a growing mode outside all windows: use `spectrum` instead"
            )
        self.spectra.append(sum(powers) * np.exp(2 * self.log_scale))
        if size > 1e3:
            for array in self.q + self.v:
                array /= size
            self.log_scale += np.log(size)

    def _advance_probes(self, q, v) -> tuple[np.ndarray, float]:
        """Advance a few probes in place; return their power spectrum and largest component."""
        record = np.zeros((self.span, BUCKETS, LANES), np.float32)
        rows = len(self.product[0]) - 1  # in blocks
        core.leapfrog(rows, *self.product, *self.sums, q, v, self.span, BUCKETS, record)
        taper = np.hanning(self.span + 1)[:-1].astype(np.float32)
        with np.errstate(over="ignore", invalid="ignore"):  # `advance` checks the size
            power = np.zeros(self.span // 2 + 1)
            for k in range(BUCKETS):  # one at a time, as spectra of all together would need several times the memory
                power += (np.abs(np.fft.rfft(record[:, k] * taper[:, None], axis=0)).astype(float) ** 2).sum(axis=1)
            return power, float(np.abs(q).max())

    def peaks(self) -> list[tuple[complex, float]]:
        """(λ, growth rate) of peaks that have grown since the first span, assuming mean excitation; fastest first."""
        first, now = self.spectra[0], self.spectra[-1]
        excess = now - first
        ratio = now / np.maximum(first, 1e-12 * first.max())
        noise = 1.5 * np.median(np.abs(ratio - np.median(ratio)))  # real modes beat within the sketch
        unit = self.probes * (self.span / 4) ** 2  # power of one mode of unit amplitude under Hann's taper
        top = (excess == scipy.ndimage.maximum_filter1d(excess, 5)) & (excess > 2 * unit) & (excess > 5 * noise * first)
        index = np.flatnonzero(top)
        gamma = np.log(excess[index] / unit) / (2 * self.span * (len(self.spectra) - 0.5))
        # offsets from the bin centres, by parabolic interpolation of the logarithms; 0 at the ends
        inside = np.clip(index, 1, len(excess) - 2)
        left, mid, right = (np.log(np.maximum(excess[inside + k], 1e-3 * excess[index])) for k in (-1, 0, 1))
        curve = np.minimum(left + right - 2 * mid, -1e-3)
        offset = np.where(inside == index, np.clip((left - right) / (2 * curve), -0.5, 0.5), 0.0)
        theta = 2 * np.pi / self.span * (index + offset)
        value = 4 / self.dt**2 * np.sin((theta + 1j * gamma) / 2) ** 2
        growth = np.sqrt(value).imag
        return [(complex(value[k]), float(growth[k])) for k in np.argsort(-growth)]

    def resolution(self, value: complex) -> float:
        """Largest distance in λ of a mode from its peak: half a frequency bin."""
        return float(np.sqrt(4 / self.dt**2 * abs(value)) + np.pi / self.span / self.dt**2) * np.pi / self.span


class ShiftWindow(NamedTuple):
    """Eigenvalues of A nearest to a shift."""

    shift: complex  # real, unless a pair far from the real axis is expected [1/time²]
    radius: float  # all eigenvalues within this radius were computed, unless the iteration missed some [1/time²]
    expected: float  # growth rate suggested by the leapfrog; 0 for the window at the bottom [1/time]
    growing: np.ndarray  # complex eigenvalues with Im λ > 0, and negative real ones; empty if there are none [1/time²]


class ShiftWindows:
    """Shift-invert windows computed so far, and the fastest growing eigenvalue in them."""

    def __init__(self, matrix, norm: float, order: Dissection, rng):
        self.matrix, self.norm, self.order, self.rng = matrix, norm, order, rng
        self.done: list[ShiftWindow] = []
        # values, with uncertainties, for which a window proved too narrow
        self.narrow: list[tuple[complex, float]] = []
        self.growth, self.residual, self.value, self.vector = 0.0, 0.0, None, None

    def covers(self, value: complex) -> bool:
        """Return True if a window contains this value, or was made for it in vain."""
        discs = [(w.shift, 0.9 * w.radius) for w in self.done] + self.narrow
        return any(abs(value - centre) < radius for centre, radius in discs)

    def search(self, shift: complex, expected: float, reach: float, subspaces=SUBSPACES) -> np.ndarray:
        """Compute and return the eigenvalues nearest to a shift, within `reach` if the subspaces suffice."""
        n = self.matrix.shape[0]
        if 2 * subspaces[0] >= n:
            return self._keep(shift, expected, *self._all_eigenvalues())
        identity = sparse.eye_array(n, format="csr")
        try:
            solve = FrontalFactor(self.matrix - shift * identity, self.order).solve
        except LinAlgError:  # the shift is an eigenvalue
            shift += 1e-7 * self.norm
            solve = FrontalFactor(self.matrix - shift * identity, self.order).solve
        subspace = KrylovSubspace(solve, n, self.rng, type(shift))
        for size in subspaces:
            values, vectors, radius = self._nearest(subspace, shift, size)
            if radius > reach:
                break
        return self._keep(shift, expected, values, vectors, radius)

    def _keep(self, shift, expected: float, values: np.ndarray, vectors, radius: float) -> np.ndarray:
        """Store a window, and its fastest growing eigenvalue if it is faster than those of all others."""
        real = np.abs(values.imag) <= REAL_BELOW * self.norm
        values = np.where(real, values.real, values)
        growing = np.flatnonzero(np.where(real, values.real < -REAL_BELOW * self.norm, values.imag > 0))
        self.done.append(ShiftWindow(shift, radius, expected, values[growing]))
        for k in growing[np.argsort(-np.abs(np.sqrt(values[growing].astype(complex)).imag))]:
            if abs(np.sqrt(complex(values[k])).imag) <= self.growth:
                break
            if self._refine(vectors[0] @ vectors[1][:, k]):
                break
        return values

    def _nearest(self, subspace: "KrylovSubspace", shift: complex, size: int):
        """Converged eigenvalues, the factors of their eigenvectors, and the radius within which all have converged."""
        n = self.matrix.shape[0]
        if 2 * size >= n:  # a subspace of most of the space: all eigenvalues at once
            return self._all_eigenvalues()
        basis, H, last = subspace.extended(size)
        mu, y = eig(H)
        error = np.linalg.norm(last @ y[-BLOCK:], axis=0) / np.abs(mu) ** 2
        values = shift + 1 / mu
        distance = np.abs(values - shift)
        radius = float(distance[error > CONVERGED * self.norm].min(initial=np.inf))
        inside = distance < radius
        return values[inside], (basis, y[:, inside]), radius

    def _all_eigenvalues(self):
        """All eigenvalues, the factors of their eigenvectors, and an infinite radius."""
        with suitable_threads(self.matrix.shape[0]):
            values, vectors = eig(self.matrix.toarray(order="F"), overwrite_a=True)
        return values, (np.eye(len(values)), vectors), np.inf

    def _refine(self, vector: np.ndarray) -> bool:
        """Refine a growing eigenvalue in its invariant plane, and keep it if it still grows faster than all others."""
        plane = np.stack([vector.real, vector.imag], axis=1) if np.abs(vector.imag).max() > 0 else vector.real[:, None]
        plane = np.linalg.qr(plane)[0]
        values, vectors = eig(plane.T @ (self.matrix @ plane))
        k = int(np.argmax(np.abs(np.sqrt(values.astype(complex)).imag) * (values.imag >= 0)))
        value, vector = complex(values[k]), plane @ vectors[:, k]
        if abs(value.imag) <= REAL_BELOW * self.norm:
            value = complex(value.real)
        growth = float(abs(np.sqrt(value).imag))
        if growth <= self.growth or (value.imag == 0 and value.real >= -REAL_BELOW * self.norm):
            return False
        vector = vector.astype(complex) / np.linalg.norm(vector)
        defect = self.matrix @ vector - value * vector
        self.growth, self.value, self.vector = growth, value, vector
        self.residual = float(np.linalg.norm(defect)) / self.norm
        return True


class KrylovSubspace:
    """Block Krylov subspace of a linear map B, from random vectors: BV = VH + QREᵀ with an orthonormal basis V.

    Every block is orthogonalised twice against all others.
    """

    def __init__(self, apply, n: int, rng, kind=float):
        self.apply = apply
        self.next = np.linalg.qr(rng.standard_normal((n, BLOCK)))[0].astype(kind)
        self.basis, self.projection = np.empty((n, 0), kind, order="F"), np.zeros((0, 0), kind)
        self.last = np.zeros((BLOCK, BLOCK), kind)

    def extended(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """V (n, size), H = VᴴBV and R, with a size rounded up to whole blocks."""
        old, size = self.basis.shape[1], -(-size // BLOCK) * BLOCK
        V, H = np.empty((len(self.next), size), self.next.dtype, order="F"), np.zeros((size, size), self.next.dtype)
        V[:, :old], H[:old, :old] = self.basis, self.projection
        for k in range(old, size, BLOCK):
            own = slice(k, k + BLOCK)
            V[:, own] = self.next
            if k:
                H[own, k - BLOCK : k] = self.last
            known = V[:, : k + BLOCK]
            adjoint, image = known.conj().T, self.apply(self.next)
            H[: k + BLOCK, own] = adjoint @ image
            q, r = np.linalg.qr(image - known @ H[: k + BLOCK, own])
            # also if the subspace is exhausted and q consists of round-off
            again = adjoint @ q
            H[: k + BLOCK, own] += again @ r
            self.next, r_again = np.linalg.qr(q - known @ again)
            self.last = r_again @ r
        self.basis, self.projection = V, H
        return V, H, self.last


class Bottom(NamedTuple):
    """Modes at the bottom of the spectrum, all of which were computed."""

    limit: float  # all λ with Re λ below it are known if the count is confirmed; inf if all were computed [1/time²]
    found: int  # eigenvalues found below it
    expected: int  # eigenvalues of the symmetric part S below it, by Sylvester's law of inertia
    zero: bool  # whether both numbers exclude zero modes, of which only some are found if there are many
    above: float  # ‖K‖/(2√limit) ≥ growth rate of any pair above it, with the skew part K [1/time]

    @property
    def confirmed(self) -> bool:
        """True if as many eigenvalues were found as the symmetric part has."""
        return self.found == self.expected


class Effort(NamedTuple):
    """Settings of the search for the fastest pair; see `fastest_pair`."""

    amplification: float = 3.0  # exponent up to which modes are sought
    rate: float = 1e-4  # slowest growth rate sought above the bottom [1/time]
    probes: int = 16  # random initial vectors
    seed: int = 0
    dense_below: int = DENSE_BELOW


EFFORT = Effort()


@readable
class FastestPair(NamedTuple):
    """Fastest growing eigenvalue found, and the guarantee of the search; `str` describes both."""

    eigenvalue: complex | None  # Im λ > 0, or λ < 0 (buckling); None if none was found [1/time²]
    mode: np.ndarray | None  # (n,) complex, generalised displacement of unit mass-weighted norm
    growth_rate: float  # g = |Im √λ|; 0 if none was found [1/time]
    frequency: float  # ω = |Re √λ| [1/time]
    residual: float  # ‖Av − λv‖/‖A‖ of the unit vector v = √M mode
    bottom: Bottom
    exponent: float  # amplification exponent up to which modes above the bottom were sought
    duration: float  # duration of the tangent dynamics; inf if all eigenvalues were computed [time]
    probes: int  # random initial vectors of the tangent dynamics
    candidates: list[ShiftWindow]
    unverified: int  # peaks of the spectra that were not, or only partly, verified by windows
    free: Freedom

    @property
    def looked(self) -> float:
        """Growth rate that reaches `exponent` within `duration`; slower pairs may be missed [1/time]."""
        return self.exponent / self.duration

    @property
    def guarantee(self) -> str:
        """Guarantee on pairs other than the one found, in words."""
        low, none = self.bottom, "no pair" if self.eigenvalue is None else "no other pair"
        faster = "grows" if self.eigenvalue is None else "grows faster"
        if np.isinf(low.limit):
            return f"{none} {faster}: all {low.found} eigenvalues were computed"
        zero = " apart from zero modes" if low.zero else ""
        if low.confirmed:
            below = f"below λ = {low.limit:.4g} {none} {faster}: all {low.found} eigenvalues{zero} there were computed"
        else:
            below = (
                f"below λ = {low.limit:.4g} {none} {faster} among the {low.found} eigenvalues{zero} found, but the "
                f"symmetric part has {low.expected} there, so that some may be missing"
            )
        seen = max(self.looked, self.growth_rate)
        above = (
            f"above, tangent dynamics of {self.duration:.4g} time units with {self.probes} random probes found "
            f"none faster than {seen:.3g}, which is not a proof; none can exceed {low.above:.2g}"
        )
        if self.unverified:
            above += f"; {self.unverified} peaks of its spectra were not verified"
        return f"{below}; {above}"

    def __str__(self):
        if self.eigenvalue is None:
            return f"no growing mode found; {self.guarantee}"
        kind = "buckling mode (real λ < 0)" if self.eigenvalue.imag == 0 else "pair found"
        numbers = f"λ = {self.eigenvalue:.6g}, growth rate {self.growth_rate:.4g}, frequency {self.frequency:.4g}"
        return f"fastest {kind}: {numbers}, residual {self.residual:.0e}; {self.guarantee}"


@checked
def fastest_pair(
    state: State,
    law: Law,
    *,
    amplification: Positive = 3.0,
    rate: Positive = 1e-4,
    probes: Annotated[int, POSITIVE] = 16,
    seed: Seed = 0,
    report: Report = silent,
    dense_below: int = DENSE_BELOW,
) -> FastestPair:
    """Find the fastest growing eigenvalue of −M⁻¹J in a large system.

    The growth rate is g = |Im √λ| ≈ Im λ/(2√λ): fast pairs have low frequencies. All modes at the bottom of the
    spectrum are computed by shift and invert, and their number is compared with that of the symmetric part of the
    matrix. For higher modes, random probes run until the time `amplification`/`rate`, or until a verified mode has
    grown by exp(`amplification`), when any faster mode would stand out. Peaks of growing power are verified by
    shift-invert windows, which distinguish pairs from nearly degenerate real modes.

    Parameters
    ----------
    amplification : float, exponent gT up to which modes are sought; at 1.4, real doublets look like pairs, and the
        ranking is wrong
    rate : float, slowest growth rate sought above the bottom [1/time]; the run time is inversely proportional to it
    probes : int, number of random initial vectors, rounded up to a multiple of 16; a mode is missed if all of them
        excite it weakly
    report : called as report(stage, share done, text)
    dense_below : number of coordinates below which LAPACK computes all eigenvalues

    Notes
    -----
    `FastestPair.guarantee` describes the knowledge about other pairs. If the symmetric part has as many eigenvalues
    below a limit as were found, this indicates completeness for a weak skew part, but does not prove it. In single
    precision, `rate` must be above about 1e-6 of the largest frequency. The windows are in double precision.

    Source
    ------
    doi:10.1103/PhysRevE.101.052902, for the complex pairs.
    """
    free, effort = freedom(state), Effort(amplification, rate, probes, seed, dense_below)
    return find_fastest(state, free, dynamical_matrix(state, law, free), report, effort)


def find_fastest(state: State, free: Freedom, matrix, report: Report, effort: Effort = EFFORT) -> FastestPair:
    """Fastest growing eigenvalue of a given A in the coordinates `free`; see `fastest_pair`."""
    touched = np.flatnonzero(abs(matrix).sum(axis=1) > 0)  # rattlers have rows of zeros
    if not len(touched):
        raise ValueError(
            "no contact resists the free coordinates: growth rates need a packing with contacts and free coordinates"
        )
    matrix = sparse.csr_array(matrix[touched][:, touched])
    rng = np.random.default_rng(effort.seed)
    start = rng.standard_normal(len(touched))
    symmetric = sparse.csr_array((matrix + matrix.T) / 2)
    norm = float(eigsh(symmetric, k=1, which="LA", tol=1e-3, v0=start, return_eigenvectors=False)[0])
    report("bottom of the spectrum", 0.0, f"{len(touched)} coordinates")
    order = dissect(state, free, touched, matrix)
    windows = ShiftWindows(matrix, norm, order, rng)
    if len(touched) < effort.dense_below:
        values = windows.search(0.0, 0.0, np.inf, (len(touched),))
        bottom, time, used, unverified = Bottom(np.inf, len(values), len(values), False, 0.0), np.inf, 0, 0
    else:
        bottom = _search_bottom(windows, symmetric, order)
        time, used, unverified = _search_above(windows, effort, rng, report)
    mode = None
    if windows.value is not None:
        mode = np.zeros(len(free), complex)
        mode[touched] = windows.vector
        mode /= np.sqrt(free.mass)
    frequency = 0.0 if windows.value is None else float(abs(np.sqrt(windows.value).real))
    pair = (windows.value, mode, windows.growth, frequency, windows.residual)
    return FastestPair(*pair, bottom, effort.amplification, time, used, windows.done, unverified, free)


def _search_bottom(windows: ShiftWindows, symmetric, order) -> Bottom:
    """Compute the modes at the bottom of the spectrum, and check their number in up to GAPS of its gaps."""
    size = min(BOTTOM, symmetric.shape[0] // 4)
    values = windows.search(-1e-6 * windows.norm, 0.0, np.inf, (size,)).real
    top = windows.done[0].shift + windows.done[0].radius
    skew = float(abs(windows.matrix - windows.matrix.T).sum(axis=1).max()) / 2  # row sums bound the norm
    floor = ZERO_MODES * windows.norm
    zero = int((np.abs(values) < floor).sum()) >= BLOCK  # then some may be missing, so count without zero modes
    beside = count_below(symmetric, floor, order) - count_below(symmetric, -floor, order) if zero else 0
    tried = []
    for limit in _widest_gaps(values, top)[:GAPS]:
        count = int(((values < limit) & ~(zero & (np.abs(values) < floor))).sum())
        expected = count_below(symmetric, limit, order) - beside
        tried.append(Bottom(limit, count, expected, zero, skew / (2 * np.sqrt(limit))))
        if tried[-1].confirmed:
            break
    return next((bottom for bottom in tried if bottom.confirmed), tried[0])


def _widest_gaps(values: np.ndarray, top: float) -> np.ndarray:
    """Middles of the widest gaps between positive values in the upper part of a range that ends at `top`, first."""
    if not np.isfinite(top):
        return np.array([2 * values.max()])
    ends = np.append(np.sort(values[values > 0.75 * top]), top)
    if len(ends) == 1:
        ends = np.array([0.75 * top, top])
    return (ends[:-1] + np.diff(ends) / 2)[np.argsort(-np.diff(ends), kind="stable")]


def _search_above(windows: ShiftWindows, effort: Effort, rng, report):
    """Run probes until slower modes than `rate`, or than the fastest verified one, would stand out.

    Returns
    -------
    duration [time], number of probes, and number of peaks that were not verified
    """
    steps = needed = _steps_needed(windows, effort)
    while steps >= LONGER * SHORTEST:  # short runs first: they are cheap and may suffice
        steps /= LONGER
    while True:
        run = ProbeRun(windows.matrix, windows.norm, int(np.ceil(steps / SPANS)), effort.probes, rng)
        unverified = _run_stage(run, windows, effort.amplification, needed, report)
        if steps >= needed or windows.growth * run.time >= effort.amplification:
            break
        needed = _steps_needed(windows, effort)  # fewer, if a faster mode was verified
        steps = min(LONGER * steps, needed)
    return run.time, run.probes, unverified


def _steps_needed(windows: ShiftWindows, effort: Effort) -> float:
    return max(effort.amplification / max(effort.rate, windows.growth) / time_step(windows.norm), SHORTEST)


def _run_stage(run: ProbeRun, windows: ShiftWindows, amplification: float, longest: float, report) -> int:
    """Run the probes once; return the number of promising peaks at the end that no window has verified."""
    ends = np.inf
    # a much longer run resolves more
    windows.narrow = [(value, width) for value, width in windows.narrow if width < 4 * run.resolution(value)]
    while True:
        run.advance()
        text = f"{run.time:.0f} time units, fastest so far {windows.growth:.2e}"
        report("random probes in a leapfrog", min(1.0, len(run.spectra) * run.span / longest), text)
        if len(run.spectra) == 1:
            continue
        peaks = _hopeful_peaks(run, windows)
        if windows.growth * run.time < amplification and peaks and peaks[0][1] * run.time >= amplification:
            _verify_peak(run, windows, *peaks[0])  # it decides whether the run may end early
            peaks = _hopeful_peaks(run, windows)
        if windows.growth * run.time < amplification:
            if len(run.spectra) < SPANS:
                continue
            if SPANS * run.span < longest:  # a longer run follows
                return 0
        ends = min(ends, run.time)
        if len(peaks) > FEW and run.time < PATIENCE * ends:  # a longer run is cheaper than many windows
            continue
        for _ in range(WINDOWS):
            if not peaks:
                break
            _verify_peak(run, windows, *peaks[0])
            peaks = _hopeful_peaks(run, windows)
        return len(peaks) + len(windows.narrow)


def _hopeful_peaks(run: ProbeRun, windows: ShiftWindows) -> list[tuple[complex, float]]:
    """Peaks outside all windows that may grow faster than the fastest verified mode, fastest first."""
    # estimates assume mean excitation; a weakly excited mode grows faster than estimated
    least = max(1.0, windows.growth * run.time - np.log(FAINT) / 2)
    return [(value, g) for value, g in run.peaks() if g * run.time > least and not windows.covers(value)]


def _verify_peak(run: ProbeRun, windows: ShiftWindows, value: complex, growth: float) -> None:
    """Compute the eigenvalues around a peak."""
    width = run.resolution(value)
    near = abs(value.imag) < 4 * width
    reach = abs(value.imag) + width if near else abs(value.imag) / 2 + width
    windows.search(value.real if near else value, growth, reach)
    if windows.done[-1].radius < reach:  # the subspace was too small: do not try again
        windows.narrow.append((value, width))
