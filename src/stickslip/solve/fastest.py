"""Fastest growing complex pair of a large system: windows from the bottom of the spectrum, then random probes above.

Growth is g = |Im √λ| ≈ Im λ/(2√λ), so that pairs at the bottom of the spectrum grow fast for their Im λ. The lowest
modes are computed by shift and invert, and their number is checked. What lies higher is searched by tangent dynamics.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

from ..core.arguments import Seed, checked, require_positive
from ..core.laws.builtin import Law
from ..core.readable import readable
from ..core.state import State
from .freedom import Freedom, dynamical_matrix, freedom
from .frontal import count_below, dissect
from .probes import SPANS, ProbeRun, time_step
from .shift_windows import BLOCK, BOTTOM, ShiftWindow, ShiftWindows

# steps of the first run, few enough to avoid overflow; each run is LONGER times longer than the one before
SHORTEST, LONGER = 256, 16
WINDOWS = 8  # largest number of windows at the end of a run; their factorisations dominate the time
FEW, PATIENCE = 2, 2  # with more peaks than FEW at its end, a run goes on until PATIENCE times its duration
GAPS = 2  # gaps of the spectrum in which the modes below are counted until the numbers agree
ZERO_MODES = 1e-6  # share of the largest λ below which a mode counts as a zero mode
FAINT = 10.0  # a mode is assumed to be excited with at least 1/FAINT of the mean power


DENSE_BELOW = 1500  # coordinates for which LAPACK takes two seconds


class Bottom(NamedTuple):
    """Modes at the bottom of the spectrum, all of which were computed."""

    limit: float  # all λ with Re λ below it are known if the count is confirmed; inf if all were computed [1/time²]
    found: int  # eigenvalues found below it
    expected: int  # eigenvalues of the symmetric part S below it, by Sylvester's law of inertia
    zero: bool  # whether both numbers leave out zero modes, of which only some are found if there are many
    above: float  # ‖K‖/(2√limit) ≥ growth rate of any pair above it, with the skew part K [1/time]

    @property
    def confirmed(self) -> bool:
        """True if as many eigenvalues were found as the symmetric part has."""
        return self.found == self.expected


@readable
class FastestPair(NamedTuple):
    """Fastest growing eigenvalue that was found, and what the search guarantees; `str` describes both."""

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
    unverified: int  # peaks of the spectra that no window verified, or only in part
    free: Freedom

    @property
    def looked(self) -> float:
        """Growth rate that reaches `exponent` within `duration`; slower pairs may be missed [1/time]."""
        return self.exponent / self.duration

    @property
    def guarantee(self) -> str:
        """What is known about pairs other than the one found, in words."""
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
            f"above, tangent dynamics of {self.duration:.4g} time units with {self.probes} random probes saw none "
            f"faster than {seen:.3g}, which is not a proof; none can exceed {low.above:.2g}"
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
    amplification: float = 3.0,
    rate: float = 1e-4,
    probes: int = 16,
    seed: Seed = 0,
    report: Callable | None = None,
    dense_below: int = DENSE_BELOW,
) -> FastestPair:
    """Find the fastest growing eigenvalue of −M⁻¹J in a large system.

    The growth rate is g = |Im √λ| ≈ Im λ/(2√λ): fast pairs lie low. All modes at the bottom of the spectrum are
    computed by shift and invert, and their number is compared with that of the symmetric part of the matrix. For what
    lies higher, random probes run until the time `amplification`/`rate`, or until a verified mode has grown by
    exp(`amplification`), by which time any faster mode would stand out. Peaks of growing power are verified by
    shift-invert windows, which distinguish pairs from nearly degenerate real modes.

    Parameters
    ----------
    amplification : float, exponent gT up to which modes are sought; at 1.4, real doublets look like pairs, and the
        ranking is wrong
    rate : float, slowest growth rate sought above the bottom [1/time]; the run time is inversely proportional to it
    probes : int, number of random initial vectors, rounded up to a multiple of 16; a mode is missed if all of them
        excite it weakly
    report : called as report(stage, share done, words)
    dense_below : number of coordinates below which LAPACK computes all eigenvalues

    Notes
    -----
    `FastestPair.guarantee` says what is known about other pairs. That the symmetric part has as many eigenvalues below
    a limit as were found is a check of completeness as long as the skew part is weak; it is not a proof. In single
    precision, `rate` must be above about 1e-6 of the largest frequency. The windows are in double precision.

    Source
    ------
    doi:10.1103/PhysRevE.101.052902, for the complex pairs.
    """
    require_positive(rate=rate, probes=probes, amplification=amplification)
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
    symmetric = sparse.csr_array((matrix + matrix.T) / 2)
    norm = float(eigsh(symmetric, k=1, which="LA", tol=1e-3, v0=start, return_eigenvectors=False)[0])
    if report:
        report("bottom of the spectrum", 0.0, f"{len(touched)} coordinates")
    order = dissect(state, free, touched, matrix)
    windows = ShiftWindows(matrix, norm, order, rng)
    if len(touched) < dense_below:
        values = windows.search(0.0, 0.0, np.inf, (len(touched),))
        bottom, time, used, unverified = Bottom(np.inf, len(values), len(values), False, 0.0), np.inf, 0, 0
    else:
        bottom = _search_bottom(windows, symmetric, order)
        time, used, unverified = _search_above(windows, amplification, rate, probes, rng, report)
    mode = None
    if windows.value is not None:
        mode = np.zeros(len(free), complex)
        mode[touched] = windows.vector
        mode /= np.sqrt(free.mass)
    frequency = 0.0 if windows.value is None else float(abs(np.sqrt(windows.value).real))
    pair = (windows.value, mode, windows.growth, frequency, windows.residual)
    return FastestPair(*pair, bottom, amplification, time, used, windows.done, unverified, free)


def _search_bottom(windows: ShiftWindows, symmetric, order) -> Bottom:
    """Compute the modes at the bottom of the spectrum, and check their number in up to GAPS of its gaps."""
    size = min(BOTTOM, symmetric.shape[0] // 4)
    values = windows.search(-1e-6 * windows.norm, 0.0, np.inf, (size,)).real
    top = windows.done[0].shift + windows.done[0].radius
    skew = float(abs(windows.matrix - windows.matrix.T).sum(axis=1).max()) / 2  # row sums bound the norm
    floor = ZERO_MODES * windows.norm
    zero = int((np.abs(values) < floor).sum()) >= BLOCK  # then some may be missing: count without zero modes
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


def _search_above(windows: ShiftWindows, amplification: float, rate: float, probes: int, rng, report):
    """Run probes until slower modes than `rate`, or than the fastest verified one, would stand out.

    Returns
    -------
    duration [time], number of probes, and number of peaks that were not verified
    """
    steps = needed = _steps_needed(windows, amplification, rate)
    while steps >= LONGER * SHORTEST:  # short runs first: they are cheap and may suffice
        steps /= LONGER
    while True:
        run = ProbeRun(windows.matrix, windows.norm, int(np.ceil(steps / SPANS)), probes, rng)
        unverified = _run_stage(run, windows, amplification, needed, report)
        if steps >= needed or windows.growth * run.time >= amplification:
            break
        needed = _steps_needed(windows, amplification, rate)  # fewer, if a faster mode was verified
        steps = min(LONGER * steps, needed)
    return run.time, run.probes, unverified


def _steps_needed(windows: ShiftWindows, amplification: float, rate: float) -> float:
    return max(amplification / max(rate, windows.growth) / time_step(windows.norm), SHORTEST)


def _run_stage(run: ProbeRun, windows: ShiftWindows, amplification: float, longest: float, report) -> int:
    """Run the probes once; return the number of hopeful peaks at the end that no window has verified."""
    ends = np.inf
    # a much longer run resolves more
    windows.narrow = [(value, width) for value, width in windows.narrow if width < 4 * run.resolution(value)]
    while True:
        run.advance()
        if report:
            progress = f"{run.time:.0f} time units, fastest so far {windows.growth:.2e}"
            report("random probes in a leapfrog", min(1.0, len(run.spectra) * run.span / longest), progress)
        if len(run.spectra) == 1:
            continue
        peaks = _hopeful_peaks(run, windows)
        if windows.growth * run.time < amplification and peaks and peaks[0][1] * run.time >= amplification:
            _verify_peak(run, windows, *peaks[0])  # it tells whether the run may end early
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
    return [(value, g) for value, g in run.peaks() if g * run.time > least and not windows.covered(value)]


def _verify_peak(run: ProbeRun, windows: ShiftWindows, value: complex, growth: float) -> None:
    """Compute the eigenvalues around a peak."""
    width = run.resolution(value)
    near = abs(value.imag) < 4 * width
    reach = abs(value.imag) + width if near else abs(value.imag) / 2 + width
    windows.search(value.real if near else value, growth, reach)
    if windows.done[-1].radius < reach:  # the subspace was too small: do not ask again
        windows.narrow.append((value, width))
