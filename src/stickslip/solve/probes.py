"""Random probes in a linear leapfrog, and growing peaks of their power spectra.

The leapfrog q_{n+1} − 2q_n + q_{n−1} = −dt² A q_n near the largest stable step is the Chebyshev recurrence. A mode with
√λ = ω + ig advances by θ + iγ per step, λ = (4/dt²) sin²((θ + iγ)/2), so that its power grows as exp(2γn) at frequency
θ.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy  # scipy.ndimage is imported on first use: that takes a tenth of a second
from scipy import sparse

from .leapfrog import BLOCK, LANES, leapfrog

SPANS = 8  # power spectra per run; growth is measured relative to the first
BUCKETS = 16  # random sums of coordinates recorded for each probe


def time_step(norm: float) -> float:
    """Time step [time]. The limit is 2/√λmax; the Lanczos estimate of λmax is low by less than the margin."""
    return 1.9 / np.sqrt(norm)


class ProbeRun:
    """Probes advanced by the leapfrog, and power spectra of random sums of their coordinates."""

    def __init__(self, matrix, norm: float, span: int, probes: int, rng):
        size = -(-matrix.shape[0] // BLOCK) * BLOCK  # rows of zeros are added, where nothing moves
        self.dt, self.span, self.spectra, self.log_scale = time_step(norm), span, [], 0.0
        # single precision halves the memory traffic of each product and perturbs λ by 1e-7 of the largest
        pull = sparse.csr_array((-(self.dt**2)) * matrix)
        pull.resize(size, size)
        pull = pull.tobsr((BLOCK, BLOCK))
        blocks = pull.data.reshape(-1, BLOCK**2).astype(np.float32)
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
                "the probes overflow because of a growing mode that no window found: use `spectrum` instead"
            )
        self.spectra.append(sum(powers) * np.exp(2 * self.log_scale))
        if size > 1e3:
            for array in self.q + self.v:
                array /= size
            self.log_scale += np.log(size)

    def _advance_probes(self, q, v) -> tuple[np.ndarray, float]:
        """Advance a few probes in place; return their power spectrum and largest component."""
        record = np.zeros((self.span, BUCKETS, LANES), np.float32)
        leapfrog(*self.product, *self.sums, q, v, record)
        taper = np.hanning(self.span + 1)[:-1].astype(np.float32)
        with np.errstate(over="ignore", invalid="ignore"):  # `advance` checks the size
            power = np.zeros(self.span // 2 + 1)
            for k in range(BUCKETS):  # one at a time: spectra of all together would need several times the memory
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
