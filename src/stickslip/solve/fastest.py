"""Search for the fastest-growing complex pair of a large system, at the bottom of the spectrum and by probes above it.

The growth rate is g = |Im √λ| ≈ Im λ/(2√λ), so for a given Im λ, pairs with low Re λ grow fastest. The lowest modes are
computed by the shift-and-invert method, in block Krylov subspaces of (A − σ)⁻¹, and their number is checked. Higher
modes are found by tangent dynamics (see `solve.probes`). If the factors do not fit into memory, the probes search the
whole spectrum.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, eig
from scipy.sparse.linalg import eigsh

from ..core.arguments import POSITIVE, Positive, Seed, checked
from ..core.laws.builtin import Law
from ..core.progress import Report, silent
from ..core.readable import readable
from ..core.state import State
from .freedom import ZERO_BELOW, Freedom, dynamical_matrix, freedom, translations
from .linear import FACTORS_UP_TO, Dissection, FrontalFactor, count_below, dissect, suitable_threads
from .probes import CLEAR, Effort, Motion, search_by_probes
from .spectrum import REAL_BELOW, SoftModes

BLOCK = 8  # number of right-hand sides solved together; eigenvalues up to this multiplicity are resolved
BOTTOM = 560, 240  # size of the subspace at the bottom of the spectrum, up to REFINED_UP_TO coordinates and beyond
POLISHING = 48, 96, 240, 560  # sizes of the subspaces, tried in turn, in which a pair is refined from its vector
NEAR = 0.1  # largest relative change of an eigenvalue by refinement
CONVERGED = 1e-12  # residual over ‖A‖ of eigenvalues that count as computed
GAPS = 2  # largest number of gaps in the spectrum below which modes are counted, until the counts agree
ZERO_MODES = 1e-6  # share of the largest λ below which a mode counts as a zero mode
ALONE = 100.0  # ratio of Im λ to the residual at which filtering ends, for a pair that is not refined
DENSE_BELOW = 1500  # number of coordinates for which LAPACK takes two seconds
EFFORT = Effort()
REFINED_UP_TO = 30_000  # number of coordinates above which a pair is not refined further, to save a factorisation


class ShiftWindow(NamedTuple):
    """Eigenvalues of A nearest to a shift."""

    shift: float  # [1/time²]
    radius: float  # all eigenvalues within this distance were computed, if the iteration missed none [1/time²]
    growing: np.ndarray  # complex eigenvalues with Im λ > 0, and negative real ones; empty if there are none [1/time²]


class ShiftWindows:
    """Eigenvalues nearest to several shifts, by the shift-and-invert method, and the fastest-growing one of them."""

    def __init__(self, matrix, norm: float, order: Dissection, rng):
        self.matrix, self.norm, self.order, self.rng = matrix, norm, order, rng
        self.done: list[ShiftWindow] = []
        self.growth, self.residual, self.value, self.vector = 0.0, 0.0, None, None
        self.soft = SoftModes(np.zeros(0), np.zeros((matrix.shape[0], 0)), 0)

    def search(self, shift: float, size: int) -> np.ndarray:
        """Compute and return the eigenvalues nearest to a shift that a subspace of this size resolves."""
        n = self.matrix.shape[0]
        if 2 * size >= n:  # the subspace would be most of the space: compute all eigenvalues
            return self._keep(shift, *self._all_eigenvalues())
        shift, solve = self._factorised(shift)
        values, error, vectors = KrylovSubspace(solve, self._start(0)).eigenvalues(shift, size)
        distance = np.abs(values - shift)
        radius = float(distance[error > CONVERGED * self.norm].min(initial=np.inf))
        inside = distance < radius
        return self._keep(shift, values[inside], (vectors[0], vectors[1][:, inside]), radius)

    def polish(self, value: complex, vector: np.ndarray) -> None:
        """Refine an approximate growing eigenvalue and its vector to round-off, and keep it if it is the fastest."""
        if self.matrix.shape[0] < DENSE_BELOW:
            self._keep(value.real, *self._all_eigenvalues())
            return
        shift, solve = self._factorised(value.real)
        start = self._start(2)
        start[:, -2:] = np.stack([vector.real, vector.imag], axis=1)
        subspace = KrylovSubspace(solve, start)
        for size in POLISHING:
            values, error, (basis, y) = subspace.eigenvalues(shift, size)
            k = int(np.argmin(np.abs(values - value)))
            if error[k] <= CONVERGED * self.norm:
                break
        if abs(values[k] - value) < abs(value) * NEAR:
            self._refine(basis @ y[:, k])

    def _start(self, given: int) -> np.ndarray:
        """(n, BLOCK) random start vectors, the last `given` of which are zero, to be replaced."""
        start = np.zeros((self.matrix.shape[0], BLOCK))
        start[:, : BLOCK - given] = self.rng.standard_normal((len(start), BLOCK - given))
        return start

    def _factorised(self, shift: float) -> tuple[float, Callable[[np.ndarray], np.ndarray]]:
        """Shift, moved if it is an eigenvalue, and a function that solves linear systems with A − shift."""
        identity = sparse.eye_array(self.matrix.shape[0], format="csr")
        try:
            return shift, FrontalFactor(self.matrix - shift * identity, self.order).solve
        except LinAlgError:
            shift += 1e-7 * self.norm
            return shift, FrontalFactor(self.matrix - shift * identity, self.order).solve

    def _keep(self, shift: float, values: np.ndarray, vectors, radius: float) -> np.ndarray:
        """Store a window, and its fastest-growing eigenvalue if it grows faster than all found before."""
        real = np.abs(values.imag) <= REAL_BELOW * self.norm
        values = np.where(real, values.real, values)
        if not self.done:
            zero = np.abs(values) < ZERO_BELOW * np.abs(self.matrix.data).max()
            negative = np.flatnonzero(real & ~zero & (values.real < 0))
            negative = negative[np.argsort(values.real[negative])]
            self.soft = SoftModes(values.real[negative], (vectors[0] @ vectors[1][:, negative]).real, int(zero.sum()))
        growing = np.flatnonzero(np.where(real, values.real < -REAL_BELOW * self.norm, values.imag > 0))
        self.done.append(ShiftWindow(shift, radius, values[growing]))
        for k in growing[np.argsort(-np.abs(np.sqrt(values[growing].astype(complex)).imag))]:
            if abs(np.sqrt(complex(values[k])).imag) <= self.growth:
                break
            if self._refine(vectors[0] @ vectors[1][:, k]):
                break
        return values

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
    """Block Krylov subspace of a linear map B, from BLOCK vectors: BV = VH + QREᵀ with an orthonormal basis V.

    Every block is orthogonalised twice against all others.
    """

    def __init__(self, apply, start: np.ndarray):
        self.apply, self.next = apply, np.linalg.qr(start)[0]
        self.basis, self.projection = np.empty((len(start), 0), order="F"), np.zeros((0, 0))
        self.last = np.zeros((BLOCK, BLOCK))

    def eigenvalues(self, shift: float, size: int):
        """Eigenvalues of A from B = (A − shift)⁻¹, their residuals, and the factors V and y of their vectors Vy."""
        basis, H, last = self.extended(size)
        mu, y = eig(H)
        return shift + 1 / mu, np.linalg.norm(last @ y[-BLOCK:], axis=0) / np.abs(mu) ** 2, (basis, y)

    def extended(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """V (n, size), H = VᵀBV and R, with a size rounded up to whole blocks."""
        old, size = self.basis.shape[1], -(-size // BLOCK) * BLOCK
        V, H = np.empty((len(self.next), size), order="F"), np.zeros((size, size))
        V[:, :old], H[:old, :old] = self.basis, self.projection
        for k in range(old, size, BLOCK):
            block = slice(k, k + BLOCK)
            V[:, block] = self.next
            if k:
                H[block, k - BLOCK : k] = self.last
            basis = V[:, : k + BLOCK]
            image = self.apply(self.next)
            H[: k + BLOCK, block] = basis.T @ image
            q, r = np.linalg.qr(image - basis @ H[: k + BLOCK, block])
            # needed also if the subspace is exhausted and q consists of round-off
            again = basis.T @ q
            H[: k + BLOCK, block] += again @ r
            self.next, r_again = np.linalg.qr(q - basis @ again)
            self.last = r_again @ r
        self.basis, self.projection = V, H
        return V, H, self.last


class Bottom(NamedTuple):
    """Modes at the bottom of the spectrum, all of which were computed."""

    # all λ with Re λ below this are known if the count is confirmed; inf if all were computed, 0 if none [1/time²]
    limit: float
    found: int  # number of eigenvalues found below the limit
    expected: int  # number of eigenvalues of the symmetric part S below the limit, by Sylvester's law of inertia
    zero: bool  # whether both numbers exclude zero modes, of which only some are found if there are many
    above: float  # upper bound on growth rates above the limit: ‖K‖/(2√limit), skew part K; ‖K‖/2 for limit 0 [1/time]

    @property
    def confirmed(self) -> bool:
        """True if as many eigenvalues were found below the limit as the symmetric part has there."""
        return self.found == self.expected


@readable
class FastestPair(NamedTuple):
    """Fastest-growing eigenvalue found, and the guarantee of the search; `str` describes both."""

    eigenvalue: complex | None  # Im λ > 0, or λ < 0 (buckling); None if none was found [1/time²]
    mode: np.ndarray | None  # (n,) complex, generalised displacement of unit mass-weighted norm
    growth_rate: float  # g = |Im √λ|; 0 if none was found [1/time]
    frequency: float  # ω = |Re √λ| [1/time]
    residual: float  # ‖Av − λv‖/‖A‖ of the unit vector v = √M mode
    bottom: Bottom
    exponent: float  # amplification exponent at which a pair above the bottom would have stood out
    duration: float  # duration of the tangent dynamics; inf if all eigenvalues were computed [time]
    probes: int  # number of random initial vectors of the tangent dynamics
    candidates: list[ShiftWindow]  # windows computed; the first, if any, is that at the bottom
    unverified: int  # number of growing peaks of the spectra from which no eigenvalue was extracted
    suspected: float  # growth rate of the fastest of these peaks, estimated from its amplitude; 0 if none [1/time]
    free: Freedom
    soft: SoftModes | None = None  # negative and zero λ; None if the bottom of the spectrum was not computed

    @property
    def looked(self) -> float:
        """Growth rate above which the probes would have revealed a pair; slower ones may be missed [1/time]."""
        return self.exponent / self.duration

    @property
    def guarantee(self) -> str:
        """Statement of how far pairs other than the one found are excluded."""
        low, none = self.bottom, "no pair" if self.eigenvalue is None else "no other pair"
        faster = "grows" if self.eigenvalue is None else "grows faster"
        if np.isinf(low.limit):
            return f"{none} {faster}: all {low.found} eigenvalues were computed"
        zero, most = " apart from zero modes" if low.zero else "", f"{low.above:.2g}"
        if low.limit == 0:
            below, most = "", f"{low.above:.2g}/ω at an angular frequency ω"
        elif low.confirmed:
            computed = f"all {low.found} eigenvalues{zero} there were computed"
            below = f"below λ = {low.limit:.4g} {none} {faster}: {computed}; above, "
        else:
            below = (
                f"below λ = {low.limit:.4g} {none} {faster} among the {low.found} eigenvalues{zero} found, but the "
                f"symmetric part has {low.expected} there, so that some may be missing; above, "
            )
        run = f"tangent dynamics of {self.duration:.4g} time units with {self.probes} random probes"
        least = f"{max(self.looked, self.growth_rate):.3g}"
        if self.unverified:
            grown = "1 peak" if self.unverified == 1 else f"{self.unverified} peaks"
            above = (
                f"in {run}, growth faster than {least} would have been visible, and {grown} of the spectra grew, the "
                f"fastest at about {self.suspected:.3g}, from which no mode was extracted"
            )
        else:
            above = f"{run} found none faster than {least}, which is not a proof"
        return f"{below}{above}" + (f"; none can exceed {most}" if np.isfinite(low.above) else "")

    def __str__(self):
        if self.eigenvalue is None:
            return f"no growing mode {'verified' if self.unverified else 'found'}; {self.guarantee}"
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
    saved: Path | None = None,
    dense_below: int = DENSE_BELOW,
    factors_up_to: int = FACTORS_UP_TO,
) -> FastestPair:
    """Find the fastest-growing eigenvalue of −M⁻¹J in a large system.

    The growth rate is g = |Im √λ| ≈ Im λ/(2√λ): fast pairs have low frequencies. All modes at the bottom of the
    spectrum are computed by shift and invert, and their number is compared with that of the symmetric part of the
    matrix. For higher modes, random probes run until the time `amplification`/`rate`, or until a mode that was found
    has grown by exp(`amplification`). By then, any faster mode would stand out. At frequencies where power grows,
    filters extract eigenvalues from the running probes, which distinguishes pairs from nearly degenerate real modes.

    Parameters
    ----------
    amplification : float, exponent gT at which the search for modes ends; at 1.4, real doublets look like pairs, and
        the ranking is wrong
    rate : float, slowest growth rate that the search above the bottom covers [1/time]; the run time is inversely
        proportional to it
    probes : int, number of random initial vectors, rounded up to a multiple of 16; a mode is missed if all of them
        excite it weakly
    report : called as report(stage, share done, text)
    saved : file in which the search is saved every minute, and from which it continues; it is removed at the end
    dense_below : number of coordinates below which LAPACK computes all eigenvalues
    factors_up_to : number of coordinates up to which factors are computed, for the modes at the bottom and, up to
        30,000 coordinates, to refine the pair to round-off. Beyond `factors_up_to`, the probes alone search the whole
        spectrum

    Notes
    -----
    `FastestPair.guarantee` states how far other pairs are excluded. If the symmetric part has as many eigenvalues
    below a limit as were found, this indicates completeness for a weak skew part, but does not prove it. In single
    precision, `rate` must be above about 1e-6 of the largest frequency. Extracted pairs are eigenvalues of A in double
    precision, with the stated residual: a hundredth of Im λ or, if filters converge slowly, at most a tenth.

    Source
    ------
    doi:10.1103/PhysRevE.101.052902, for the complex pairs.
    """
    free, effort = freedom(state), Effort(amplification, rate, probes, seed)
    matrix = dynamical_matrix(state, law, free)
    found = find_fastest(state, free, matrix, report, effort, saved, dense_below, factors_up_to)
    if saved:
        saved.unlink(missing_ok=True)
    return found


def find_fastest(
    state: State,
    free: Freedom,
    matrix,
    report: Report,
    effort: Effort = EFFORT,
    saved: Path | None = None,
    dense_below: int = DENSE_BELOW,
    factors_up_to: int = FACTORS_UP_TO,
    drag=None,
) -> FastestPair:
    """Fastest-growing eigenvalue of a given A in the coordinates `free`; see `fastest_pair`.

    With dashpots, q̈ = −A q + `drag` q̇, and the result is λ = −s² of the fastest-growing exponent s, found by probes
    alone.
    """
    touched = np.flatnonzero(abs(matrix).sum(axis=1) > 0)  # rattlers have rows of zeros
    if not len(touched):
        raise ValueError(
            "no contact resists the free coordinates: growth rates need a packing with contacts and free coordinates"
        )
    rigid = translations(matrix, free)
    matrix = sparse.csr_array(matrix[touched][:, touched])
    order = dissect(state, free, touched, matrix)
    place = np.concatenate(order.pivots)  # in this order, neighbours are close in memory
    touched, matrix = touched[place], sparse.csr_array(matrix[place][:, place])
    order = order._replace(pivots=np.split(np.arange(len(place)), np.cumsum([len(part) for part in order.pivots])[:-1]))
    rng = np.random.default_rng(effort.seed)
    symmetric = sparse.csr_array((matrix + matrix.T) / 2)
    start = rng.standard_normal(len(touched))
    norm = float(eigsh(symmetric, k=1, which="LA", tol=1e-3, v0=start, return_eigenvectors=False)[0])
    skew = float(abs(matrix - matrix.T).sum(axis=1).max()) / 2  # row sums bound the norm
    windows = ShiftWindows(matrix, norm, order, rng)
    if len(touched) < dense_below and drag is None:
        values = windows.search(0.0, len(touched))
        bottom, time, exponent, used, left = Bottom(np.inf, len(values), len(values), False, 0.0), np.inf, 3.0, 0, []
    else:
        bottom, factors = Bottom(0.0, 0, 0, False, skew / 2), len(touched) <= factors_up_to and drag is None
        if drag is not None:
            bottom, drag = bottom._replace(above=np.inf), sparse.csr_array(drag[touched][:, touched])
        refines = factors and len(touched) <= REFINED_UP_TO
        if factors:
            report("bottom of the spectrum", 0.0, f"{len(touched)} coordinates")
            bottom = _search_bottom(windows, symmetric, skew)
        del symmetric
        disc = (windows.done[0].shift, windows.done[0].radius) if windows.done else (0.0, 0.0)
        found, run, left = search_by_probes(
            Motion(matrix, norm, rigid[touched], drag), disc, windows.growth, effort, report, saved,
            CLEAR if refines else ALONE,
        )  # fmt: skip
        time, used, exponent = run.time, run.probes, found.excluded(run) * run.time
        if found.value is not None and refines:
            report("fastest pair to round-off", 0.0, f"growth rate {found.growth:.4g}")
            windows.polish(found.value, found.vector)
        if windows.growth < (1 - NEAR) * found.growth:
            windows.growth, windows.value, windows.vector = found.growth, found.value, found.vector
            windows.residual = found.residual
    mode = None
    if windows.value is not None:
        mode = np.zeros(len(free), complex)
        mode[touched] = windows.vector
        mode /= np.sqrt(free.mass)
    frequency = 0.0 if windows.value is None else float(abs(np.sqrt(windows.value).real))
    soft = None
    if windows.done:
        vectors = np.zeros((len(free), len(windows.soft.negative)))
        vectors[touched] = windows.soft.vectors
        soft = windows.soft._replace(vectors=vectors / np.sqrt(free.mass)[:, None])
    pair = (windows.value, mode, windows.growth, frequency, windows.residual)
    suspected = left[0][1] if left else 0.0
    return FastestPair(*pair, bottom, exponent, time, used, windows.done, len(left), suspected, free, soft)


def _search_bottom(windows: ShiftWindows, symmetric, skew: float) -> Bottom:
    """Compute the modes at the bottom of the spectrum, and check their number at up to GAPS of its gaps."""
    size, order = BOTTOM[symmetric.shape[0] > REFINED_UP_TO], windows.order
    size = min(size, symmetric.shape[0] // 4)
    values = windows.search(-1e-6 * windows.norm, size).real
    top = windows.done[0].shift + windows.done[0].radius
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
    """Middles of the gaps between values in the upper quarter of the range from zero to `top`, widest gap first."""
    if not np.isfinite(top):
        return np.array([2 * values.max()])
    ends = np.append(np.sort(values[values > 0.75 * top]), top)
    if len(ends) == 1:
        ends = np.array([0.75 * top, top])
    return (ends[:-1] + np.diff(ends) / 2)[np.argsort(-np.diff(ends), kind="stable")]
