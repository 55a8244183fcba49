"""Fastest growing complex pair of a large system, from random probes in a linear leapfrog and shift-invert windows.

The leapfrog q_{n+1} − 2q_n + q_{n−1} = −dt² A q_n near the largest stable step is the Chebyshev recurrence. A mode with
√λ = ω + ig advances by θ + iγ per step, λ = (4/dt²) sin²((θ + iγ)/2), so that its power grows as exp(2γn) at frequency
θ.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import scipy  # scipy.ndimage is imported on first use: that takes a tenth of a second
from numba import njit
from scipy import sparse
from scipy.linalg import LinAlgError
from scipy.sparse.linalg import LinearOperator, eigs, eigsh

from ..core.arguments import checked, require_positive
from ..core.laws.builtin import Law
from ..core.readable import readable
from ..core.state import State
from .freedom import Freedom, dynamical_matrix, freedom
from .linear import factorised
from .spectrum import REAL_BELOW

SPANS = 8  # power spectra per run; growth is measured relative to the first
# steps of the first run, few enough to avoid overflow; each run is LONGER times longer than the one before
SHORTEST, LONGER = 128, 8
ABREAST = 4  # probes that one thread advances together, without waiting for other threads
BUCKETS = 32  # random sums of coordinates recorded for each probe
COUNTS = 24, 96  # eigenvalues in a window, and in a second attempt if it is too narrow
WINDOWS = 8  # largest number of windows per spectrum; their factorisations dominate the memory
FAINT = 10.0  # a mode is assumed to be excited with at least 1/FAINT of the mean power


class ShiftWindow(NamedTuple):
    """Eigenvalues of A nearest to a real shift."""

    shift: float  # [1/time²]
    radius: float  # all eigenvalues within it were computed, provided that Arnoldi's method missed none [1/time²]
    expected: float  # growth rate suggested by the leapfrog; 0 for a window made without it [1/time]
    growing: np.ndarray  # complex eigenvalues with Im λ > 0, and negative real ones; empty if there are none [1/time²]


@readable
class FastestPair(NamedTuple):
    """Fastest growing eigenvalue that was excited, and the limits of the search; `str` describes both."""

    eigenvalue: complex | None  # Im λ > 0, or λ < 0 (buckling); None if none was found [1/time²]
    mode: np.ndarray | None  # (n,) complex, generalised displacement of unit mass-weighted norm
    growth_rate: float  # g = |Im √λ|; 0 if none was found [1/time]
    frequency: float  # ω = |Re √λ| [1/time]
    residual: float  # ‖Av − λv‖/‖A‖ of the unit vector v = √M mode
    exponent: float  # amplification exponent up to which modes were sought
    duration: float  # duration of the leapfrog [time]
    candidates: list[ShiftWindow]
    unverified: int  # peaks of the last spectrum that no window verified
    free: Freedom

    @property
    def looked(self) -> float:
        """Growth rate that reaches `exponent` within `duration`; slower pairs may be missed [1/time]."""
        return self.exponent / self.duration

    def __str__(self):
        limits = (
            f"searched up to amplification exponent {self.exponent:.3g}, growth rate {self.looked:.3g}: a slower pair, "
            "or one not excited by the probes, cannot be excluded"
        )
        if self.unverified:
            limits += f"; {self.unverified} weaker peaks of the spectrum were not verified"
        if self.eigenvalue is None:
            return f"no growing mode found: no pair with a growth rate above {self.looked:.3g} was excited; {limits}"
        kind = "buckling mode (real λ < 0)" if self.eigenvalue.imag == 0 else "excited pair"
        found = f"λ = {self.eigenvalue:.6g}, growth rate {self.growth_rate:.4g}, frequency {self.frequency:.4g}"
        if self.growth_rate < self.looked:
            found += " (slower than the search limit: others may be faster)"
        return f"fastest {kind}: {found}, residual {self.residual:.0e}; {limits}"


@checked
def fastest_pair(
    state: State,
    law: Law,
    *,
    amplification: float = 3.0,
    rate: float = 1e-4,
    probes: int = 8,
    seed: int = 0,
    report=None,
) -> FastestPair:
    """Find the fastest growing eigenvalue of −M⁻¹J in a large system, as excited by random probes.

    The growth rate is g = |Im √λ|. The probes run until the time `amplification`/`rate`, or until a verified mode has
    grown by exp(`amplification`), by which time any faster mode would stand out. Peaks of growing power are verified by
    shift-invert windows, which distinguish pairs from nearly degenerate real modes. The window at λ ≈ 0 is always
    computed; it shows slow buckling.

    Parameters
    ----------
    amplification : float, exponent gT up to which modes are sought; at 1.4, real doublets look like pairs, and the
        ranking is wrong
    rate : float, slowest growth rate sought [1/time]; the run time is inversely proportional to it
    probes : int, number of random initial vectors; a mode is missed if all of them excite it weakly
    report : called as report(stage, share done, words)

    Notes
    -----
    The result is not a proof; see `FastestPair.__str__`. In single precision, `rate` must be above about 1e-6 of the
    largest frequency. The windows are in double precision.

    Source
    ------
    doi:10.1103/PhysRevE.101.052902, for the complex pairs.
    """
    require_positive(rate=rate, probes=probes)
    free = freedom(state)
    matrix = dynamical_matrix(state, law, free)
    touched = np.flatnonzero(abs(matrix).sum(axis=1) > 0)  # rattlers have rows of zeros
    if not len(touched):
        raise ValueError(
            "no contact resists a free coordinate: growth rates need a packing with contacts and free coordinates"
        )
    matrix = sparse.csr_array(matrix[touched][:, touched])
    rng = np.random.default_rng(seed)
    start = rng.standard_normal(len(touched))
    norm = float(eigsh((matrix + matrix.T) / 2, k=1, which="LA", tol=1e-3, v0=start, return_eigenvectors=False)[0])
    windows = _ShiftWindows(matrix, norm, start)
    windows.search(-1e-6 * norm, 0.0, 1e-3 * norm)
    longest = max(amplification / rate / _time_step(norm), SHORTEST)
    runs = int(np.log(longest / SHORTEST) / np.log(LONGER))
    for steps in longest / LONGER ** np.arange(runs, -1, -1.0):  # short runs first: they are cheap and may suffice
        run = _ProbeRun(matrix, norm, int(np.ceil(steps / SPANS)), probes, rng)
        time, unverified = _run_stage(run, windows, amplification, longest, report)
        if windows.growth * time >= amplification:
            break
    mode = None
    if windows.value is not None:
        mode = np.zeros(len(free), complex)
        mode[touched] = windows.vector
        mode /= np.sqrt(free.mass)
    frequency = 0.0 if windows.value is None else float(abs(np.sqrt(windows.value).real))
    found = (windows.value, mode, windows.growth, frequency, windows.residual)
    return FastestPair(*found, amplification, time, windows.done, unverified, free)


def _time_step(norm: float) -> float:
    """Time step [time]. The limit is 2/√λmax; the Lanczos estimate of λmax is low by less than the margin."""
    return 1.9 / np.sqrt(norm)


def _run_stage(
    run: "_ProbeRun", windows: "_ShiftWindows", amplification: float, longest: float, report
) -> tuple[float, int]:
    """Run the probes once; return the time run and the number of suspicious peaks that no window has verified."""
    for k in range(SPANS):
        run.advance()
        peaks = run.peaks() if k else []
        final = (k + 1) * run.span >= longest
        asked = unverified = 0
        for value, growth in peaks:
            # the estimate assumes mean excitation; a weakly excited mode grows faster than estimated
            hopeful = growth * run.time + np.log(FAINT) / 2 > windows.growth * run.time
            if growth * run.time < (1.0 if final else amplification) or not hopeful or windows.covered(value):
                continue
            if asked == WINDOWS:
                unverified += 1
                continue
            asked += 1
            windows.search(value.real, growth, abs(value.imag) + run.resolution(value))
        if report:
            words = f"{run.time:.0f} time units, fastest so far {windows.growth:.2e}"
            report("random probes in a leapfrog", min(1.0, (k + 1) * run.span / longest), words)
        if k and windows.growth * run.time >= amplification:
            break
    return run.time, unverified


class _ProbeRun:
    """Probes advanced by the leapfrog, and power spectra of random sums of their coordinates."""

    def __init__(self, matrix, norm: float, span: int, probes: int, rng):
        n = matrix.shape[0]
        self.dt, self.span, self.spectra, self.log_scale = _time_step(norm), span, [], 0.0
        # single precision halves the memory traffic of each product and perturbs λ by 1e-7 of the largest
        pull = (self.dt**2 * matrix).astype(np.float32)
        self.product = pull.indptr.astype(np.int32), pull.indices.astype(np.int32), pull.data
        self.q = [rng.standard_normal((n, ABREAST), np.float32) for _ in range(-(-probes // ABREAST))]
        # velocities half a step before the start, where the probes are at rest
        self.v = [0.5 * (pull @ q) for q in self.q]
        bucket = rng.integers(BUCKETS, size=n)
        members = np.argsort(bucket, kind="stable")
        bounds = np.searchsorted(bucket[members], np.arange(BUCKETS + 1))
        self.sums = bounds, members, rng.choice(np.array([-1, 1], np.float32), n)

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
                "the probes overflow because of a growing mode that no window found: use `spectrum` instead"
            )
        self.spectra.append(sum(powers) * np.exp(2 * self.log_scale))
        if size > 1e3:
            for array in self.q + self.v:
                array /= size
            self.log_scale += np.log(size)

    def _advance_probes(self, q, v) -> tuple[np.ndarray, float]:
        """Advance a few probes in place; return their power spectrum and largest component."""
        record = np.zeros((self.span, BUCKETS, ABREAST), np.float32)
        _leapfrog(*self.product, *self.sums, q, v, record)
        taper = np.hanning(self.span + 1)[:-1].astype(np.float32)
        with np.errstate(over="ignore", invalid="ignore"):  # `advance` checks the size
            power = np.abs(np.fft.rfft(record * taper[:, None, None], axis=0)).astype(float) ** 2
            return power.sum(axis=(1, 2)), float(np.abs(q).max())

    def peaks(self) -> list[tuple[complex, float]]:
        """(λ, growth rate) of peaks that have grown since the first span, assuming mean excitation; fastest first."""
        first, now = self.spectra[0], self.spectra[-1]
        excess = now - first
        ratio = now / np.maximum(first, 1e-12 * first.max())
        noise = 1.5 * np.median(np.abs(ratio - np.median(ratio)))  # real modes beat within the sketch
        one = ABREAST * len(self.q) * (self.span / 4) ** 2  # power of one mode of unit amplitude under Hann's taper
        top = (excess == scipy.ndimage.maximum_filter1d(excess, 5)) & (excess > 2 * one) & (excess > 5 * noise * first)
        index = np.flatnonzero(top)
        gamma = np.log(excess[index] / one) / (2 * self.span * (len(self.spectra) - 0.5))
        theta = 2 * np.pi / self.span * (index + self._offset(excess, index))
        value = 4 / self.dt**2 * np.sin((theta + 1j * gamma) / 2) ** 2
        growth = np.sqrt(value).imag
        return [(complex(value[k]), float(growth[k])) for k in np.argsort(-growth)]

    @staticmethod
    def _offset(excess: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Offset of each peak from its bin centre, by parabolic interpolation of the logarithms; 0 at the ends."""
        inside = np.clip(index, 1, len(excess) - 2)
        left, mid, right = (np.log(np.maximum(excess[inside + k], 1e-3 * excess[index])) for k in (-1, 0, 1))
        curve = np.minimum(left + right - 2 * mid, -1e-3)
        return np.where(inside == index, np.clip((left - right) / (2 * curve), -0.5, 0.5), 0.0)

    def resolution(self, value: complex) -> float:
        """Largest distance in λ of a mode from its peak: half a frequency bin."""
        return float(np.sqrt(4 / self.dt**2 * abs(value)) + np.pi / self.span / self.dt**2) * np.pi / self.span


@njit(cache=True, nogil=True, fastmath={"contract"})
def _leapfrog(indptr, indices, values, bounds, members, signs, q, v, record):
    """Advance q (n, ABREAST) and v in place by len(record) steps; store the signed bucket sums in record[t]."""
    for t in range(len(record)):
        for i in range(len(indptr) - 1):  # sums in registers are twice as fast as a loop over columns of v
            a, b, c, d = v[i, 0], v[i, 1], v[i, 2], v[i, 3]
            for e in range(indptr[i], indptr[i + 1]):
                x, j = values[e], indices[e]
                a -= x * q[j, 0]
                b -= x * q[j, 1]
                c -= x * q[j, 2]
                d -= x * q[j, 3]
            v[i, 0], v[i, 1], v[i, 2], v[i, 3] = a, b, c, d
        for k in range(len(bounds) - 1):
            for m in range(bounds[k], bounds[k + 1]):
                i = members[m]
                for p in range(ABREAST):
                    q[i, p] += v[i, p]
                    record[t, k, p] += signs[i] * q[i, p]


class _ShiftWindows:
    """Shift-invert windows computed so far, and the fastest growing eigenvalue in them."""

    def __init__(self, matrix, norm: float, start: np.ndarray):
        self.matrix, self.norm, self.start = matrix, norm, start
        self.done: list[ShiftWindow] = []
        self.growth, self.residual, self.value, self.vector = 0.0, 0.0, None, None

    def covered(self, value: complex) -> bool:
        """Return True if a window would have contained an eigenvalue at this value."""
        return any(abs(value - w.shift) < 0.8 * w.radius for w in self.done)

    def search(self, shift: float, expected: float, reach: float):
        """Compute the eigenvalues nearest to a real shift, within `reach` [1/time²] unless there are too many."""
        n, identity = len(self.start), sparse.eye_array(len(self.start), format="csr")
        try:
            solve = factorised(sparse.csr_array(self.matrix - shift * identity))
        except LinAlgError:  # the shift is an eigenvalue
            shift += 1e-7 * self.norm
            solve = factorised(sparse.csr_array(self.matrix - shift * identity))
        inverse = LinearOperator((n, n), matvec=solve, dtype=float)
        for count in COUNTS:
            values, vectors = eigs(self.matrix, k=min(count, n - 2), sigma=shift, OPinv=inverse, v0=self.start)
            radius = float(np.abs(values - shift).max())
            if radius > reach:
                break
        real = np.abs(values.imag) <= REAL_BELOW * self.norm
        values = np.where(real, values.real, values)
        growing = np.flatnonzero(np.where(real, values.real < -REAL_BELOW * self.norm, values.imag > 0))
        self.done.append(ShiftWindow(shift, radius, expected, values[growing]))
        for k in growing:
            growth = float(abs(np.sqrt(values[k]).imag))
            if growth > self.growth:
                self.growth, self.value, self.vector = growth, complex(values[k]), vectors[:, k]
                defect = self.matrix @ self.vector - self.value * self.vector
                self.residual = float(np.linalg.norm(defect)) / self.norm
