"""The fastest growing complex pair of big systems: random probes grow in a linear leapfrog, windows verify the peaks.

q_{n+1} − 2q_n + q_{n−1} = −dt² A q_n at nearly the largest stable step is the Chebyshev recurrence. A mode with
√λ = ω + ig advances by θ + iγ a step, λ = (4/dt²) sin²((θ + iγ)/2), so that its power grows as exp(2γn) at frequency θ.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy import sparse
from scipy.linalg import LinAlgError
from scipy.ndimage import maximum_filter1d
from scipy.sparse.linalg import LinearOperator, eigs, eigsh

from ..core.laws.builtin import Law
from ..core.readable import readable
from ..core.state import State
from .freedom import Freedom, dynamical_matrix, freedom
from .linear import factorised
from .spectrum import REAL_BELOW

SPANS = 8  # spectra a run; growth is read off by comparison with the first
SHORTEST, LONGER = (
    128,
    8,
)  # fewest steps of the first run, so few that nothing overflows; the next is LONGER times longer
ABREAST = 4  # probes that one thread advances together, without waiting for the other threads
BUCKETS = 32  # random sums of coordinates that are recorded of each probe
COUNTS = 24, 96  # eigenvalues in a window, and in one that turns out too narrow
WINDOWS = 8  # most windows that one spectrum may ask for: the factorisations are what costs memory
FAINT = 10.0  # a mode is taken to have been excited with at least 1/FAINT of the mean power


class ShiftWindow(NamedTuple):
    """Eigenvalues of A nearest to a real shift."""

    shift: float  # [1/time²]
    radius: float  # all eigenvalues within it were computed, as far as Arnoldi's method misses none [1/time²]
    expected: float  # growth rate that the leapfrog suggested; 0 where a window was made without [1/time]
    growing: np.ndarray  # complex eigenvalues, Im λ > 0, and real ones below 0; empty: all are real [1/time²]


@readable
class FastestPair(NamedTuple):
    """The fastest growing eigenvalue that was excited, and how far the search looked. str() says it in words."""

    eigenvalue: complex | None  # Im λ > 0, or λ < 0 (buckling); None if none was found [1/time²]
    mode: np.ndarray | None  # (n,) complex, generalised displacement of unit mass-weighted norm
    growth_rate: float  # g = |Im √λ|; 0 if none was found [1/time]
    frequency: float  # ω = |Re √λ| [1/time]
    residual: float  # ‖Av − λv‖/‖A‖ of the unit vector v = √M mode
    exponent: float  # amplification exponent up to which was looked
    duration: float  # of the leapfrog [time]
    candidates: list[ShiftWindow]
    unverified: int  # peaks that the last spectrum showed and no window looked at
    free: Freedom

    @property
    def looked(self) -> float:
        """Growth rate [1/time] that is amplified by `exponent` within `duration`: slower pairs may be missed."""
        return self.exponent / self.duration

    def __str__(self):
        limits = (
            f"looked up to amplification exponent {self.exponent:.3g} of growth rate {self.looked:.3g}: a pair slower "
            "than about that, or not excited by the probes, cannot be excluded"
        )
        if self.unverified:
            limits += f"; {self.unverified} weaker peaks of the spectrum were not verified"
        if self.eigenvalue is None:
            return f"no growing mode found: no pair with a growth rate above {self.looked:.3g} was excited; {limits}"
        kind = "buckling mode (real λ < 0)" if self.eigenvalue.imag == 0 else "excited pair"
        found = f"λ = {self.eigenvalue:.6g}, growth rate {self.growth_rate:.4g}, frequency {self.frequency:.4g}"
        if self.growth_rate < self.looked:
            found += " (slower than the run can rank: others may be faster)"
        return f"fastest {kind}: {found}, residual {self.residual:.0e}; {limits}"


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
    """The eigenvalue of −M⁻¹J with the largest growth rate g = |Im √λ| that random probes excite, for big systems.

    The probes run until `amplification`/`rate`, or until a verified mode has grown by exp(`amplification`), when any
    faster one would stand out. Peaks of growing power are verified by shift-invert windows, which tell pairs from
    nearly degenerate real modes. The window at λ ≈ 0 is always made: it shows slow buckling.

    Parameters
    ----------
    amplification : float, exponent gT to look up to; at 1.4 real doublets look like pairs, and ranks are wrong
    rate : float, slowest growth rate to look for [1/time]; the time taken is inversely proportional to it
    probes : int, random right-hand sides; a mode is missed if all of them excite it weakly
    report : called as report(stage, share done, words with the quantities that matter)

    Notes
    -----
    Nothing is proved: see `FastestPair.__str__`. Single precision limits `rate` to more than about 1e-6 of the largest
    frequency; the windows are in double precision.

    Source
    ------
    doi:10.1103/PhysRevE.101.052902, for the complex pairs.
    """
    free = freedom(state)
    matrix = dynamical_matrix(state, law, free)
    touched = np.flatnonzero(abs(matrix).sum(axis=1) > 0)  # rattlers have rows of zeros
    if not len(touched):
        raise ValueError("no contact resists a motion: growth rates need a packing with contacts and free coordinates")
    matrix = sparse.csr_array(matrix[touched][:, touched])
    rng = np.random.default_rng(seed)
    start = rng.standard_normal(len(touched))
    norm = float(eigsh((matrix + matrix.T) / 2, k=1, which="LA", tol=1e-3, v0=start, return_eigenvectors=False)[0])
    windows = _ShiftWindows(matrix, norm, start)
    windows.search(-1e-6 * norm, 0.0, 1e-3 * norm)
    longest = max(amplification / rate / _time_step(norm), SHORTEST)
    runs = int(np.log(longest / SHORTEST) / np.log(LONGER))
    for steps in longest / LONGER ** np.arange(runs, -1, -1.0):  # short runs first: they cost little, and may suffice
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
    """Time step [time]: the limit is 2/√λmax; Lanczos' estimate of λmax is low by less than the margin."""
    return 1.9 / np.sqrt(norm)


def _run_stage(
    run: "_ProbeRun", windows: "_ShiftWindows", amplification: float, longest: float, report
) -> tuple[float, int]:
    """One run from random probes; time run, and the number of suspicious peaks that no window has looked at."""
    for k in range(SPANS):
        run.advance()
        peaks = run.peaks() if k else []
        final = (k + 1) * run.span >= longest
        asked = unverified = 0
        for value, growth in peaks:
            # the estimate holds for a mode of mean excitation; weaker ones are faster than it says
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
    """Probes in the leapfrog, and the power spectra of a sketch of them."""

    def __init__(self, matrix, norm: float, span: int, probes: int, rng):
        n = matrix.shape[0]
        self.dt, self.span, self.spectra, self.log_scale = _time_step(norm), span, [], 0.0
        # single precision halves the memory that each product reads, and disturbs λ by 1e-7 of the largest
        pull = (self.dt**2 * matrix).astype(np.float32)
        self.product = pull.indptr.astype(np.int32), pull.indices.astype(np.int32), pull.data
        self.q = [rng.standard_normal((n, ABREAST), np.float32) for _ in range(-(-probes // ABREAST))]
        self.v = [0.5 * (pull @ q) for q in self.q]  # half a step before the start, where the probes are at rest
        bucket = rng.integers(BUCKETS, size=n)
        members = np.argsort(bucket, kind="stable")
        bounds = np.searchsorted(bucket[members], np.arange(BUCKETS + 1))
        self.sums = bounds, members, rng.choice(np.array([-1, 1], np.float32), n)

    @property
    def time(self) -> float:
        """Time run so far."""
        return len(self.spectra) * self.span * self.dt

    def advance(self):
        """Run one span and keep its power spectrum, summed over probes and buckets."""
        with ThreadPoolExecutor() as pool:
            powers, sizes = zip(*pool.map(self._advance_probes, self.q, self.v), strict=True)
        size = max(sizes)
        if not self.log_scale + np.log(size) < 300:  # squared, the limit of double precision
            raise FloatingPointError("the probes overflow: a mode grows that no window found; use `spectrum`")
        self.spectra.append(sum(powers) * np.exp(2 * self.log_scale))
        if size > 1e3:
            for array in self.q + self.v:
                array /= size
            self.log_scale += np.log(size)

    def _advance_probes(self, q, v) -> tuple[np.ndarray, float]:
        """Power spectrum and largest component of a few probes, advanced in place."""
        record = np.zeros((self.span, BUCKETS, ABREAST), np.float32)
        _leapfrog(*self.product, *self.sums, q, v, record)
        taper = np.hanning(self.span + 1)[:-1].astype(np.float32)
        with np.errstate(over="ignore", invalid="ignore"):  # `advance` looks at the size
            power = np.abs(np.fft.rfft(record * taper[:, None, None], axis=0)).astype(float) ** 2
            return power.sum(axis=(1, 2)), float(np.abs(q).max())

    def peaks(self) -> list[tuple[complex, float]]:
        """(λ, growth rate) where power has grown since the first span, if excited as the mean; fastest first."""
        first, now = self.spectra[0], self.spectra[-1]
        excess = now - first
        ratio = now / np.maximum(first, 1e-12 * first.max())
        noise = 1.5 * np.median(np.abs(ratio - np.median(ratio)))  # real modes beat within the sketch
        one = ABREAST * len(self.q) * (self.span / 4) ** 2  # power of one mode of unit amplitude under Hann's taper
        top = (excess == maximum_filter1d(excess, 5)) & (excess > 2 * one) & (excess > 5 * noise * first)
        index = np.flatnonzero(top)
        gamma = np.log(excess[index] / one) / (2 * self.span * (len(self.spectra) - 0.5))
        theta = 2 * np.pi / self.span * (index + self._offset(excess, index))
        value = 4 / self.dt**2 * np.sin((theta + 1j * gamma) / 2) ** 2
        growth = np.sqrt(value).imag
        return [(complex(value[k]), float(growth[k])) for k in np.argsort(-growth)]

    @staticmethod
    def _offset(excess: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Distance of each peak from its bin, by a parabola through the logarithms; 0 at the ends."""
        inside = np.clip(index, 1, len(excess) - 2)
        left, mid, right = (np.log(np.maximum(excess[inside + k], 1e-3 * excess[index])) for k in (-1, 0, 1))
        curve = np.minimum(left + right - 2 * mid, -1e-3)
        return np.where(inside == index, np.clip((left - right) / (2 * curve), -0.5, 0.5), 0.0)

    def resolution(self, value: complex) -> float:
        """Half a bin of frequency, in λ: how far from a peak its mode may be."""
        return float(np.sqrt(4 / self.dt**2 * abs(value)) + np.pi / self.span / self.dt**2) * np.pi / self.span


@njit(cache=True, nogil=True, fastmath={"contract"})
def _leapfrog(indptr, indices, values, bounds, members, signs, q, v, record):
    """Advance q (n, ABREAST) and v in place by len(record) steps; record[t] gets the signed sums of each bucket."""
    for t in range(len(record)):
        for i in range(len(indptr) - 1):  # sums in registers: twice as fast as a loop over columns of v
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
    """Shift-invert windows made so far, and the fastest growing eigenvalue in them."""

    def __init__(self, matrix, norm: float, start: np.ndarray):
        self.matrix, self.norm, self.start = matrix, norm, start
        self.done: list[ShiftWindow] = []
        self.growth, self.residual, self.value, self.vector = 0.0, 0.0, None, None

    def covered(self, value: complex) -> bool:
        """True if an eigenvalue there would have been seen."""
        return any(abs(value - w.shift) < 0.8 * w.radius for w in self.done)

    def search(self, shift: float, expected: float, reach: float):
        """Eigenvalues nearest to a real shift, at least as far as `reach` [1/time²] if that does not take too many."""
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
