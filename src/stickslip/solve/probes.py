"""Tangent dynamics of random probes: a linear leapfrog, its power spectra, and filters that extract growing modes.

The leapfrog q_{n+1} − 2q_n + q_{n−1} = −dt² A q_n near the largest stable step is the Chebyshev recurrence. A mode with
√λ = ω + ig advances by θ + iγ per step, λ = (4/dt²) sin²((θ + iγ)/2), so its power grows as exp(2γn) at frequency
θ. Sums of q_n with the weights of a frequency filter span the growing modes there; their eigenvalues follow from A
in that span. With dashpots, q̈ = −A q + D q̇, and λ = −s² for the exponents s = g − iω. In a search, the forces of
dashpots lag by half a step, which reduces the damping of a mode by the factor cos(θ/2). While filters run, these forces
follow from two velocities, with weights that make modes at the frequency of the first peak exact.
"""

import hashlib
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy  # scipy.ndimage is imported on first use, as this takes a tenth of a second
from scipy import sparse
from scipy.linalg import eig

from ..core.library import core
from ..core.progress import Report
from .pairs import format_seconds

ROWS = 3  # number of rows of a block: three displacements, three rotations, or both kinds in two dimensions
LANES = 16  # number of vectors advanced together: one register of AVX-512, two of AVX2, four of NEON
SPANS = 8  # number of power spectra per run; growth is measured relative to the first
BUCKETS = 16  # number of random sums of coordinates recorded for each probe
FAINT = 10.0  # a mode is assumed to be excited with at least 1/FAINT of the mean power
EXCITED = 1.15  # largest excess of a peak, as a growth exponent, that strong excitation of its mode can explain
# steps of the first run, few enough to avoid overflow; each run is LONGER times longer than the previous one
SHORTEST, LONGER = 256, 16
NOISE = 1e-6  # share of the largest |λ| below which Im λ is not distinguished from noise in single precision
GAIN, PASSES, MOST_PASSES = 2.0, 6, 12  # growth exponent of a pair per filter pass; usual and largest number of passes
STALLED = 1.2  # after PASSES, filters run on only while Im λ over its residual grows by this factor in each pass
CLEAR = 10.0  # smallest ratio of Im λ to the residual that is accepted after the last pass
FAR = 150.0  # logarithm of the amplitude at which probes stop, since double precision ends at 700
STAGE = "random probes in a leapfrog"  # name in progress reports
SHORT = 60.0  # time above which an estimate is shown [s]
ROUNDS = 8  # largest number of peaks at the end of a run for which filters run
SAVED_EVERY = 60.0  # interval at which a search is saved [s]


class Effort(NamedTuple):
    """Extent of the search for the fastest pair; see `fastest_pair`."""

    amplification: float = 3.0  # growth exponent at which the search for modes ends
    rate: float = 1e-4  # slowest growth rate that the search covers [1/time]
    probes: int = 16  # number of random initial vectors
    seed: int = 0


class Motion(NamedTuple):
    """Equations of motion q̈ = −A q + D q̇ of mass-weighted displacements."""

    matrix: sparse.csr_array  # (n, n) A, ordered so that neighbours are close in memory [1/time²]
    norm: float  # estimate of the largest eigenvalue of A [1/time²]
    rigid: np.ndarray  # (n, k) orthonormal zero modes that are excluded, since round-off makes them drift
    drag: sparse.csr_array | None = None  # (n, n) D; None without dashpots [1/time]

    @property
    def time_step(self) -> float:
        """Time step of the leapfrog [time]. The limit is dt² λmax = 4; the margin exceeds errors of λmax.

        With dashpots, dt² λmax + 2 dt ‖D‖ stays below 2, so that their forces damp all modes for any tuning.
        """
        drag, most = (0.0, 3.61) if self.drag is None else (abs(self.drag).sum(axis=1).max(), 1.805)
        return most / (drag + np.sqrt(drag**2 + most * self.norm))


class ProbeRun:
    """Probes advanced by the leapfrog, and power spectra of random sums of their coordinates."""

    def __init__(self, motion: Motion, span: int, probes: int, rng):
        matrix, size = motion.matrix, -(-motion.matrix.shape[0] // ROWS) * ROWS  # padded with zeros, which do not move
        self.dt, self.span, self.spectra, self.log_scale, self.seen = motion.time_step, span, [], 0.0, np.inf
        pull, self.product = _blocks((-(self.dt**2)) * matrix, size)
        self.dampers = (None, None, None) if motion.drag is None else _blocks(self.dt * motion.drag, size)[1]
        self.weights = 1.0, 0.0  # weights of the last two velocities in the forces of dashpots
        self.q = [rng.standard_normal((size, LANES), np.float32) for _ in range(-(-probes // LANES))]
        # velocities half a step before the start, where the probes are at rest
        self.v = [np.ascontiguousarray(-0.5 * (pull @ q), np.float32) for q in self.q]
        self.rigid = np.zeros((size, motion.rigid.shape[1]), np.float32)
        self.rigid[: matrix.shape[0]] = motion.rigid
        self.probes = LANES * len(self.q)
        self.previous = [None if motion.drag is None else v.copy() for v in self.v]
        self.sums = rng.integers(BUCKETS, size=size), rng.choice(np.array([-1, 1], np.float32), size)

    @property
    def time(self) -> float:
        """Time that the probes have run so far [time]."""
        return len(self.spectra) * self.span * self.dt

    def seconds(self, steps: float) -> float:
        """Estimate the time that a number of steps takes, from two steps of zeros [s]."""
        q, record, begin = np.zeros_like(self.q[0]), np.zeros((2, BUCKETS, LANES), np.float32), time.perf_counter()
        self._leap(q, q.copy(), None if self.previous[0] is None else q.copy(), record, (None, None, None))
        return (time.perf_counter() - begin) / 2 * steps

    def tune(self, value: complex | None) -> None:
        """Choose weights that make dashpots exact at the frequency of a peak, where possible; otherwise, they lag.

        The weights w of the present and the previous velocity solve w₀ exp(−iθ/2) + w₁ exp(−3iθ/2) = 1.
        """
        theta = 0.0 if value is None else self.angle(value)
        exact = 1e-3 < theta < np.pi / 2  # at higher frequencies, the weights would drive slow modes
        self.weights = (np.sin(1.5 * theta) / np.sin(theta), -0.5 / np.cos(0.5 * theta)) if exact else (1.0, 0.0)

    def _leap(self, q: np.ndarray, v: np.ndarray, previous: np.ndarray | None, record: np.ndarray, extra) -> None:
        """Advance q and v in place by one step for each row of `record`, in which their sums are stored."""
        rows, drawn = len(self.product[0]) - 1, None if previous is None else np.empty_like(v)
        core.leapfrog(
            rows, *self.product, *self.dampers, *self.weights, *self.sums, q, v, previous, drawn, len(record), BUCKETS,
            record, *extra,
        )  # fmt: skip

    def advance(self, filters: "Filters | None" = None):
        """Run one span and store its power spectrum, summed over probes and buckets."""
        with ThreadPoolExecutor() as pool:
            results = pool.map(self._advance_probes, range(len(self.q)), [filters] + [None] * (len(self.q) - 1))
            powers, sizes = zip(*results, strict=True)
        size = max(sizes)
        if not self.log_scale + np.log(size) < 300:  # its square is at the limit of double precision
            raise FloatingPointError(f"the probes overflow: a mode grows by a factor of 1e38 within {self.span} steps")
        self.lanes = powers[0]
        self.spectra.append(sum(power.sum(axis=1) for power in powers) * np.exp(2 * self.log_scale))
        if len(self.spectra) > 1:
            self._note_what_is_seen()
        if size > 1e3 or 0 < size < 1e-3:
            for array in [*self.q, *self.v, *self.previous, filters and filters.sums]:
                if array is not None:
                    array /= size
            self.log_scale += np.log(size)

    def _advance_probes(self, k: int, filters) -> tuple[np.ndarray, float]:
        """Advance some probes in place; return their power spectra (frequencies, LANES) and largest component."""
        q, record = self.q[k], np.zeros((self.span, BUCKETS, LANES), np.float32)
        self._leap(q, self.v[k], self.previous[k], record, filters.next(self.span) if filters else (None, None, None))
        taper = np.hanning(self.span + 1)[:-1].astype(np.float32)
        with np.errstate(over="ignore", invalid="ignore"):  # `advance` checks the size
            power = np.zeros((self.span // 2 + 1, LANES))
            for bucket in range(BUCKETS):  # one at a time: all together would need several times the memory
                power += np.abs(np.fft.rfft(record[:, bucket] * taper[:, None], axis=0)).astype(float) ** 2
            for moving in (q, self.v[k]):
                moving -= self.rigid @ (self.rigid.T @ moving)
            return power, float(np.abs(q).max())

    def _excess(self, leaks: bool = False) -> tuple[np.ndarray, np.ndarray, float]:
        """Power gained since the first span, smallest power that stands out, and power of a mode of unit amplitude.

        If a growing mode `leaks` into most frequencies, their power is not noise: there, power above 8.5 times that of
        the first span stands out.
        """
        first, now = self.spectra[0], self.spectra[-1]
        ratio = now / np.maximum(first, 1e-12 * first.max())
        middle = np.median(ratio)
        noise = 1.5 * np.median(np.abs(ratio - middle))  # neighbouring real modes beat, which changes the power
        if leaks:
            noise /= max(1.0, middle)
        unit = self.probes * (self.span / 4) ** 2  # under Hann's taper
        return now - first, np.maximum(2 * unit, 5 * noise * first), unit

    def _note_what_is_seen(self) -> None:
        """Store the growth rate at which a mode excited with 1/FAINT of the mean power would stand out [1/time].

        The smallest rate so far is kept, because modes that have grown may drown the spectrum later.
        """
        _, least, unit = self._excess()
        seen = float(np.log(FAINT * least.max() / unit)) / (2 * self.dt * self.span * (len(self.spectra) - 0.5))
        self.seen = min(self.seen, seen)

    def peaks(self) -> list[tuple[complex, float]]:
        """(λ, growth rate) of peaks that have grown since the first span, assuming mean excitation; fastest first."""
        excess, least, unit = self._excess(leaks=True)
        top = (excess == scipy.ndimage.maximum_filter1d(excess, 5)) & (excess > least)
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

    def strongest_lanes(self, value: complex) -> np.ndarray:
        """Numbers of the first LANES probes in descending order of their power at a peak in the last span."""
        k = round(self.span * self.angle(value) / (2 * np.pi))
        return np.argsort(-self.lanes[min(k, self.span // 2)], kind="stable")

    def angle(self, value: complex) -> float:
        """Phase per step of a mode [rad]."""
        return float(2 * np.arcsin(np.sqrt(complex(value)) * self.dt / 2).real)


def _blocks(matrix, size: int):
    """Matrix in blocks, padded with zeros, and its arrays in single precision.

    Single precision halves the memory traffic of each product, and perturbs λ by 1e-7 of the largest.
    """
    matrix = sparse.csr_array(matrix)
    matrix.resize(size, size)
    matrix = matrix.tobsr((ROWS, ROWS))
    blocks = matrix.data.reshape(-1, ROWS**2).astype(np.float32)
    return matrix, (matrix.indptr.astype(np.int64), matrix.indices.astype(np.uint32), blocks)


class RitzModes(NamedTuple):
    """Approximate eigenvalues λ of A, or λ = −s² of growing exponents s with dashpots."""

    value: np.ndarray  # (K,) λ [1/time²]
    root: np.ndarray  # (K,) √λ [1/time]
    vector: np.ndarray  # (n, K) unit vectors v
    error: np.ndarray  # (K,) ‖Av − λv‖, or ‖Av − sDv + s²v‖ [1/time²]


class Filters:
    """Sums of the first LANES probes over some spans, weighted by Hann's taper and the phase of each peak.

    Each of the LANES/2 complex filters uses one probe; each peak is assigned the probes in which it is strongest.
    """

    def __init__(self, run: ProbeRun, peaks: list[complex], spans: int):
        peaks, count = peaks[: LANES // 2], LANES // 2
        chosen = [(peaks[k % len(peaks)], k // len(peaks)) for k in range(count)]
        self.lane = np.repeat([run.strongest_lanes(value)[rank] for value, rank in chosen], 2).astype(np.int64)
        self.theta = np.array([run.angle(value) for value, _ in chosen])
        self.sums, self.steps, self.done = np.zeros_like(run.q[0]), spans * run.span, 0

    def next(self, span: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Probe of each sum, weights of the next steps (span, LANES), and the sums."""
        step = self.done + np.arange(span)
        self.done += span
        phase = self.theta * step[:, None]
        taper = np.sin(np.pi * (step + 0.5) / self.steps)[:, None] ** 2
        weights = np.stack([taper * np.cos(phase), taper * np.sin(phase)], axis=2).reshape(span, LANES)
        return self.lane, weights.astype(np.float32), self.sums

    def eigenvalues(self, motion: Motion) -> RitzModes:
        """Approximate eigenvalues in the span of the sums."""
        sums = self.sums[: motion.matrix.shape[0]].astype(float)
        basis = np.linalg.qr(sums / np.maximum(np.linalg.norm(sums, axis=0), 1e-300))[0]
        image = motion.matrix @ basis
        H = basis.T @ image
        if motion.drag is None:
            values, y = eig(H)
            residual = np.linalg.norm((image - basis @ H) @ y, axis=0)
            return RitzModes(values, np.sqrt(values.astype(complex)), basis @ y, residual)
        pace = np.sqrt(np.linalg.norm(H, 2))  # in units of it, s is of order one
        dragged = motion.drag @ basis
        first_order = np.block([[np.zeros_like(H), np.eye(len(H))], [-H / pace**2, basis.T @ dragged / pace]])
        s, y = eig(first_order)
        s, y = pace * s[s.imag <= 0], y[: len(H), s.imag <= 0]
        y /= np.linalg.norm(y, axis=0)
        vectors = basis @ y
        residual = np.linalg.norm(image @ y - s * (dragged @ y) + s**2 * vectors, axis=0)
        return RitzModes(-(s**2), 1j * s, vectors, residual)


class GrowingModes:
    """Growing eigenvalues that filters extract while probes run on, and the fastest of those not known before.

    Parameters
    ----------
    disc : centre and radius of a disc in which all eigenvalues are known [1/time²]
    growth : fastest growth rate known [1/time]
    clear : Im λ, or −λ of buckling, over the residual of a mode that counts as extracted
    """

    def __init__(self, motion: Motion, disc: tuple[float, float], growth: float, clear: float):
        self.motion, self.disc, self.growth, self.clear = motion, disc, growth, clear
        self.residual, self.value, self.vector = 0.0, None, None
        # peaks that extracted modes explain, and peaks of this run without one: frequency, half-width, growth [1/time]
        self.explained: list[tuple[float, float, float]] = []
        self.failed: list[tuple[float, float, float]] = []
        self.rounds = 0  # number of peaks at the end of this run for which filters have run

    def start_again(self) -> None:
        """Forget peaks that failed, since another run may reveal their modes."""
        self.failed.clear()
        self.rounds = 0

    def hopeful(self, run: ProbeRun) -> list[tuple[complex, float]]:
        """Untried peaks of modes that may grow faster than the fastest known mode, fastest first."""
        return [(value, g) for value, g in self.unverified(run) if not _covers(self.failed, value, g, run.time)]

    def unverified(self, run: ProbeRun) -> list[tuple[complex, float]]:
        """Peaks without an extracted mode that may grow faster than the fastest known mode, fastest first."""
        # estimates assume mean excitation; a weakly excited mode grows faster than estimated
        least = max(1.0, self.growth * run.time - np.log(FAINT) / 2)
        peaks = [(value, g) for value, g in run.peaks() if abs(value - self.disc[0]) >= 0.9 * self.disc[1]]
        return [(v, g) for v, g in peaks if g * run.time > least and not _covers(self.explained, v, g, run.time)]

    def excluded(self, run: ProbeRun) -> float:
        """Growth rate above which there is no unknown mode, neither a faint one nor one next to an extracted mode."""
        return max(run.seen, self.growth + EXCITED / run.time if self.value is not None else 0.0)

    def extract(self, run: ProbeRun, follow: Callable[[], None]) -> None:
        """Let the probes run on until filters at hopeful peaks yield the growing mode of the first peak, or fail."""
        value, growth = self.hopeful(run)[0]
        centre, bin_width = np.sqrt(complex(value)).real, 2 * np.pi / (run.span * run.dt)
        peak = centre, bin_width, growth
        run.tune(value)
        found = self._filter(run, follow, value, peak)
        run.tune(None)
        # noted only now: a search that is interrupted while filters run tries the peak again
        (self.explained if found else self.failed).append(peak)

    def _filter(self, run: ProbeRun, follow: Callable[[], None], value: complex, peak: tuple) -> bool:
        """Run filters until the growing mode of a peak stands clear of its residual; False if they stop converging."""
        (centre, bin_width, growth), best = peak, 0.0
        for k in range(MOST_PASSES):
            if run.log_scale > FAR:
                return False
            spans = max(1, round(GAIN / growth / (run.span * run.dt)))
            others = [other for other, g in self.hopeful(run) if not _covers([peak], other, g, run.time)]
            filters = Filters(run, [value, *others], spans)
            for _ in range(spans):
                run.advance(filters)
                follow()
            modes = filters.eigenvalues(self.motion)
            clearness = self._clearness(modes)
            stalled = k + 1 >= PASSES and clearness.max() < STALLED * best
            ends = k + 1 == MOST_PASSES or stalled or run.log_scale > FAR
            clear = min(CLEAR, self.clear) if ends else self.clear
            found = self._keep(modes, clearness > clear)
            self.explained += [(frequency, bin_width, rate) for frequency, rate in found]
            if any(abs(frequency - centre) < bin_width for frequency, _ in found):
                return True
            if ends:
                return False
            clearness[clearness > clear] = 0.0
            first = int(np.argmax(clearness))
            best = clearness[first]
            if best > 1:  # peaks overestimate the growth of modes that were excited strongly
                growth = abs(modes.root[first].imag)
        return False

    def _clearness(self, modes: RitzModes) -> np.ndarray:
        """Im λ, or −λ of buckling, over the residual; 0 if it may be noise."""
        apart = np.where(modes.value.imag == 0, -modes.value.real, modes.value.imag)
        apart = np.where(modes.root.imag > 0, apart, 0.0)
        return np.where(apart > NOISE * self.motion.norm, apart / np.maximum(modes.error, 1e-300), 0.0)

    def _keep(self, modes: RitzModes, chosen: np.ndarray) -> list[tuple[float, float]]:
        """Store the fastest growing of the chosen modes; return the frequencies and growth rates of all of them."""
        for k in np.flatnonzero(chosen):
            growth = float(abs(modes.root[k].imag))
            if growth > self.growth:
                self.growth, self.value, self.vector = growth, complex(modes.value[k]), modes.vector[:, k]
                self.residual = float(modes.error[k]) / self.motion.norm
        return [(float(abs(root.real)), float(abs(root.imag))) for root in modes.root[chosen]]


def _covers(known: list[tuple[float, float, float]], value: complex, growth: float, time: float) -> bool:
    """Return True for a known peak, unless it has grown by more than strong excitation of the known mode explains."""
    frequency = np.sqrt(complex(value)).real
    return any(abs(frequency - centre) < width and (growth - g) * time < EXCITED for centre, width, g in known)


def search_by_probes(
    motion: Motion, disc: tuple, growth: float, effort: Effort, report: Report, path: Path | None, clear: float
) -> tuple[GrowingModes, ProbeRun, list[tuple[complex, float]]]:
    """Run probes until every mode that grows faster than `rate` and the fastest known mode would stand out.

    Parameters
    ----------
    disc, growth, clear : as in `GrowingModes`
    path : file in which the search is saved, and from which it continues

    Returns
    -------
    extracted modes, the last run, and the peaks of this run from which no mode was extracted, fastest first
    """

    def start(span: int) -> ProbeRun:
        rng = np.random.default_rng([effort.seed, span])
        return ProbeRun(motion, span, effort.probes, rng)

    def needed() -> float:
        return max(effort.amplification / max(effort.rate, modes.growth) / motion.time_step, SHORTEST)

    modes = GrowingModes(motion, disc, growth, clear)
    stage = STAGE
    saved = path and SavedSearch(path, motion, (disc, growth, effort, clear))
    run = saved and saved.restore(modes, start)
    steps, most = run.span * SPANS if run else needed(), np.inf  # longer runs overflow
    while not run and steps >= LONGER * SHORTEST:  # short runs first: they are cheap and may suffice
        steps /= LONGER
    while True:
        run, longest = run or start(int(np.ceil(steps / SPANS))), needed()
        if stage == STAGE and (seconds := run.seconds(longest)) > SHORT:
            stage = f"{STAGE}, about {format_seconds(seconds)} until growth faster than {effort.rate:g} is seen"
        try:
            left = _run_stage(run, modes, effort.amplification, longest, partial(report, stage), saved)
        except FloatingPointError:
            if steps <= 2 * SPANS:
                raise
            run, steps = None, steps / LONGER
            most = steps
            modes.start_again()
            continue
        if steps >= min(longest, most) or modes.growth * run.time >= effort.amplification or run.log_scale >= FAR:
            if saved:
                saved.save(run, modes, finished=True)
            return modes, run, left
        run, steps = None, min(LONGER * steps, needed(), most)  # fewer, if a faster mode was found
        modes.start_again()


def _run_stage(
    run: ProbeRun, modes: GrowingModes, amplification: float, longest: float, tell, saved
) -> list[tuple[complex, float]]:
    """Run the probes once; return the peaks at the end from which filters extract no mode, fastest first."""

    def show() -> None:
        text = f"{run.time:.0f} time units, fastest so far {modes.growth:.2e}"
        if len(run.spectra) > 1:
            text = f"{text}, growth faster than {run.seen:.2e} would be seen"
        tell(min(1.0, len(run.spectra) * run.span / longest), text)

    def save() -> None:  # not while filters run, since their sums are not saved
        if saved:
            saved.save(run, modes)

    def is_known() -> bool:
        """Return True if a mode faster than the fastest known mode would have stood out."""
        gain = modes.growth * run.time
        return gain >= amplification and (run.seen <= modes.growth or gain >= 3 * amplification)

    while True:
        if not modes.rounds and len(run.spectra) > 1 and modes.growth * run.time < amplification:
            peaks = modes.hopeful(run)
            if peaks and peaks[0][1] * run.time >= amplification:
                modes.extract(run, show)  # determines whether the run may end early
        if len(run.spectra) >= SPANS or run.log_scale >= FAR or is_known():
            break
        run.advance()
        show()
        save()
    if modes.growth * run.time < amplification and SPANS * run.span < longest:  # a longer run follows
        return []
    while modes.rounds < ROUNDS and modes.hopeful(run):
        modes.extract(run, show)
        modes.rounds += 1
        save()
    return modes.unverified(run)


class SavedSearch:
    """File in which a search for one motion is saved, and from which it continues."""

    def __init__(self, path: Path, motion: Motion, given: tuple):
        self.path, self.last = path, time.monotonic()
        content = hashlib.blake2b()
        for matrix in filter(lambda one: one is not None, (motion.matrix, motion.drag)):
            content.update(matrix.data)
            content.update(matrix.indices)
        content.update(repr(given).encode())
        self.digest = content.hexdigest()

    def save(self, run: ProbeRun, modes: GrowingModes, finished: bool = False) -> None:
        """Replace the file atomically, unless it was written a moment ago and the search continues."""
        if not finished and time.monotonic() - self.last < SAVED_EVERY:
            return
        part = self.path.with_name(f".{self.path.stem}.{os.getpid()}.npz")
        np.savez(
            part, digest=self.digest, span=run.span, log_scale=run.log_scale, seen=run.seen,
            spectra=run.spectra, lanes=run.lanes, q=run.q, v=run.v,
            previous=[] if run.previous[0] is None else run.previous,
            explained=np.array(modes.explained).reshape(-1, 3), failed=np.array(modes.failed).reshape(-1, 3),
            growth=modes.growth, rounds=modes.rounds,
            residual=modes.residual, value=[] if modes.value is None else [modes.value],
            vector=[] if modes.vector is None else modes.vector,
        )  # fmt: skip
        os.replace(part, self.path)
        self.last = time.monotonic()

    def restore(self, modes: GrowingModes, start: Callable[[int], ProbeRun]) -> ProbeRun | None:
        """Return the saved run, and restore the `modes` that it had found; None if this search was not saved."""
        if not self.path.is_file():
            return None
        with np.load(self.path) as saved:
            if str(saved["digest"]) != self.digest:
                return None
            run = start(int(saved["span"]))
            run.q, run.v, run.spectra = list(saved["q"]), list(saved["v"]), list(saved["spectra"])
            if len(saved["previous"]):
                run.previous = list(saved["previous"])
            run.log_scale, run.seen, run.lanes = float(saved["log_scale"]), float(saved["seen"]), saved["lanes"]
            modes.explained, modes.failed = (
                [tuple(map(float, one)) for one in saved[key]] for key in ("explained", "failed")
            )
            modes.growth, modes.residual = float(saved["growth"]), float(saved["residual"])
            modes.rounds = int(saved["rounds"])
            if len(saved["value"]):
                modes.value, modes.vector = complex(saved["value"][0]), saved["vector"]
        return run
