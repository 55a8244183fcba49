"""Fastest growing complex pair of a large system: windows from the bottom of the spectrum, then random probes above.

Growth is g = |Im √λ| ≈ Im λ/(2√λ), so that pairs at the bottom of the spectrum grow fast for their Im λ. The lowest
modes are computed by shift and invert, and their number is checked. What lies higher is searched by tangent dynamics.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

from ..core.arguments import checked, require_positive
from ..core.laws.builtin import Law
from ..core.readable import readable
from ..core.state import State
from .freedom import Freedom, dynamical_matrix, freedom
from .frontal import Inertia, dissect
from .probes import SPANS, ProbeRun, time_step
from .shift_windows import BOTTOM, ShiftWindow, ShiftWindows

# steps of the first run, few enough to avoid overflow; each run is LONGER times longer than the one before
SHORTEST, LONGER = 128, 16
WINDOWS = 8  # largest number of windows per spectrum; their factorisations dominate the time
GAPS = 3  # gaps of the spectrum in which the modes below are counted until the numbers agree
ZERO_MODES = 1e-6  # share of the largest λ below which a mode counts as a zero mode
FAINT = 10.0  # a mode is assumed to be excited with at least 1/FAINT of the mean power


class Bottom(NamedTuple):
    """Modes at the bottom of the spectrum, all of which were computed."""

    limit: float  # all λ with Re λ below it are known, provided that the count is confirmed [1/time²]
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
    duration: float  # duration of the tangent dynamics [time]
    probes: int  # random initial vectors of the tangent dynamics
    candidates: list[ShiftWindow]
    unverified: int  # peaks of the last spectrum that no window verified
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
            above += f"; {self.unverified} weaker peaks of the spectrum were not verified"
        return f"{below}; {above}"

    def __str__(self):
        if self.eigenvalue is None:
            return f"no growing mode found; {self.guarantee}"
        kind = "buckling mode (real λ < 0)" if self.eigenvalue.imag == 0 else "pair found"
        found = f"λ = {self.eigenvalue:.6g}, growth rate {self.growth_rate:.4g}, frequency {self.frequency:.4g}"
        return f"fastest {kind}: {found}, residual {self.residual:.0e}; {self.guarantee}"


@checked
def fastest_pair(
    state: State,
    law: Law,
    *,
    amplification: float = 3.0,
    rate: float = 1e-4,
    probes: int = 16,
    seed: int = 0,
    report=None,
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
    order = dissect(state, free, touched, matrix)
    if report:
        report("bottom of the spectrum", 0.0, f"{len(touched)} coordinates")
    windows = ShiftWindows(matrix, norm, order, rng)
    bottom = _search_bottom(windows, symmetric, order)
    # where a verified mode grows, probes need not run until slower ones stand out
    longest = max(amplification / max(rate, windows.growth) / time_step(norm), SHORTEST)
    runs = int(np.log(longest / SHORTEST) / np.log(LONGER))
    for steps in longest / LONGER ** np.arange(runs, -1, -1.0):  # short runs first: they are cheap and may suffice
        run = ProbeRun(matrix, norm, int(np.ceil(steps / SPANS)), probes, rng)
        unverified = _run_stage(run, windows, amplification, longest, report)
        if windows.growth * run.time >= amplification:
            break
    mode = None
    if windows.value is not None:
        mode = np.zeros(len(free), complex)
        mode[touched] = windows.vector
        mode /= np.sqrt(free.mass)
    frequency = 0.0 if windows.value is None else float(abs(np.sqrt(windows.value).real))
    found = (windows.value, mode, windows.growth, frequency, windows.residual)
    return FastestPair(*found, bottom, amplification, run.time, run.probes, windows.done, unverified, free)


def _search_bottom(windows: ShiftWindows, symmetric, order) -> Bottom:
    """Compute the modes at the bottom of the spectrum, and check their number in up to GAPS of its gaps."""
    size = min(BOTTOM, symmetric.shape[0] // 4)
    values = windows.search(-1e-6 * windows.norm, 0.0, np.inf, (size,)).real
    top = windows.done[0].shift + windows.done[0].radius
    skew = float(abs(windows.matrix - windows.matrix.T).sum(axis=1).max()) / 2  # row sums bound the norm
    inertia = Inertia(symmetric, order, ZERO_MODES * windows.norm)
    tried = []
    for limit in _widest_gaps(values, top)[:GAPS]:
        found, expected, zero = int((values < limit).sum()), inertia.below(limit), False
        if found != expected:
            if not tried and (values < -inertia.floor).sum() < inertia.negative:
                values = np.append(values, _search_negative(windows, symmetric))
            # of many zero modes only some are found: count without them
            found, zero = int(((values < limit) & (np.abs(values) > inertia.floor)).sum()), True
            expected -= inertia.zero
        tried.append(Bottom(limit, found, expected, zero, skew / (2 * np.sqrt(limit))))
        if tried[-1].confirmed:
            break
    return next((bottom for bottom in tried if bottom.confirmed), tried[0])


def _widest_gaps(values: np.ndarray, top: float) -> np.ndarray:
    """Middles of the widest gaps between positive values in the upper part of a range that ends at `top`, first."""
    if not np.isfinite(top):
        return np.array([2 * values.max()])
    ends = np.append(np.sort(values[values > top / 2]), top)
    if len(ends) == 1:
        ends = np.array([top / 2, top])
    return (ends[:-1] + np.diff(ends) / 2)[np.argsort(-np.diff(ends), kind="stable")]


def _search_negative(windows: ShiftWindows, symmetric) -> np.ndarray:
    """Real parts of eigenvalues below the window at the bottom, from windows at and above the lowest of S."""
    edge, found = windows.done[0].shift - windows.done[0].radius, []
    # real parts of the eigenvalues of A are above the lowest eigenvalue of S
    shift = lowest = float(eigsh(symmetric, k=1, which="SA", tol=1e-3, return_eigenvectors=False)[0]) * 1.01
    for _ in range(WINDOWS):
        if lowest >= edge:
            break
        values = windows.search(shift, 0.0, 0.0).real
        reach = shift + windows.done[-1].radius
        found.append(values[(values >= lowest) & (values < min(edge, reach))])
        shift, lowest = reach + 0.5 * windows.done[-1].radius, reach
    return np.concatenate(found) if found else np.zeros(0)


def _run_stage(run: ProbeRun, windows: ShiftWindows, amplification: float, longest: float, report) -> int:
    """Run the probes once; return the number of suspicious peaks that no window has verified."""
    unverified = 0
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
            width = run.resolution(value)
            if abs(value.imag) < 4 * width:
                windows.search(value.real, growth, abs(value.imag) + width)
            else:
                windows.search(value, growth, abs(value.imag) / 2 + width)
        if report:
            words = f"{run.time:.0f} time units, fastest so far {windows.growth:.2e}"
            report("random probes in a leapfrog", min(1.0, (k + 1) * run.span / longest), words)
        if k and windows.growth * run.time >= amplification:
            break
    return unverified
