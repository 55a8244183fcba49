"""Spectrum of −M⁻¹J: stability, complex pairs, growth rates, modes, tracking along a path, and density of states."""

from typing import Literal, NamedTuple

import numpy as np
import scipy  # scipy.optimize is imported on first use, as this takes a tenth of a second
from scipy import sparse
from scipy.linalg import eig, eigvals
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, eigsh

from ..core.arguments import NotNegative, Seed, checked, knows_bonds
from ..core.laws.builtin import Law
from ..core.progress import Report, Size, require_sizes, silent
from ..core.readable import pluralize, readable
from ..core.state import State
from .balance import BALANCED_BELOW, force_imbalance, linearised
from .freedom import ZERO_BELOW, Freedom, backbone, dynamical_matrix, equations_of_motion, freedom, translations
from .linear import factorised, suitable_threads

ALL_UP_TO = 120  # number of coordinates up to which all eigenvalues are computed even if a few suffice
SOFTEST = 40  # number of eigenvalues nearest to zero that are otherwise computed
NEGATIVE_BELOW = 1e-8  # eigenvalues of the scaled symmetric part above minus this value do not count as negative
REAL_BELOW = 1e-9  # |Im λ| below this share of the largest |λ| is round-off: J carries noise of 1e-15
DENSE_UP_TO = 2_500  # number of coordinates whose density of states takes half a minute
PROBES = 16  # number of random vectors for the trace in the density of states
MARGIN = 0.01  # margin of the bounds, over the width of the spectrum; bounds are accurate to a tenth of the margin
SHARP = 4.0  # ratio of the bin width to the resolution of the polynomials


@readable(head=lambda result: _summary(result))
class Spectrum(NamedTuple):
    """All eigenvalues λ of −M⁻¹J, sorted by real part, with their modes.

    A stable mode has λ > 0 and frequency √λ; λ < 0 means buckling. A complex pair λ_r ± iλ_i oscillates at ω_r and
    grows as exp(ω_i t), with ω_r + iω_i = √(λ_r + iλ_i).
    """

    MADE_BY = "spectrum"

    eigenvalues: np.ndarray  # (n,) complex [1/time²]
    modes: np.ndarray  # (n, m) complex, columns: generalised displacements of unit mass-weighted norm
    free: Freedom
    residual: float  # largest unbalanced force or torque/R over the mean normal contact force; see `imbalance`

    @property
    def pairs(self) -> np.ndarray:
        """Eigenvalues with Im λ > 0, one for each complex pair, fastest growing first [1/time²]."""
        return self.eigenvalues[self.pair_indices]

    @property
    def pair_indices(self) -> np.ndarray:
        """Indices of `pairs` in `eigenvalues`, and likewise in the modes, growth rates and frequencies."""
        index = np.flatnonzero(self.eigenvalues.imag > 0)
        return index[np.argsort(-self.growth_rate[index])]

    @property
    def im_lambda(self) -> np.ndarray:
        """Im λ [1/time²] of each eigenvalue."""
        return self.eigenvalues.imag

    @property
    def frequency(self) -> np.ndarray:
        """ω_r = |Re √λ| [1/time] of each eigenvalue."""
        return np.abs(np.sqrt(self.eigenvalues).real)

    @property
    def growth_rate(self) -> np.ndarray:
        """ω_i = |Im √λ| [1/time]: displacements grow as exp(ω_i t), M(t) as exp(2 ω_i t); zero for stable modes."""
        return np.abs(np.sqrt(self.eigenvalues).imag)

    @property
    def stable(self) -> bool | None:
        """True if there is no complex pair and no negative eigenvalue beyond round-off; None away from equilibrium."""
        if not self.residual <= BALANCED_BELOW:
            return None
        floor = -REAL_BELOW * np.abs(self.eigenvalues).max()
        return not len(self.pairs) and bool((self.eigenvalues.real > floor).all())

    def shares(self) -> np.ndarray:
        """(n, 7) shares of x, y, z, three rotations and the cell in the mass-weighted norm of each mode, with sum 1."""
        weight = self.free.mass[:, None] * np.abs(self.modes) ** 2
        axis = self.free.axis
        return np.stack([weight[axis == k].sum(axis=0) for k in range(7)], axis=1)


@checked
@knows_bonds
def spectrum(state: State, law: Law, *, modes: bool = True) -> Spectrum:
    """Compute all eigenvalues and modes of −M⁻¹J at an accepted state, with each contact held in its mode.

    The eigenvalue problem is solved with dense matrices. Drag and velocity-dependent parts of the law are not included;
    see `damped_growth`.

    Parameters
    ----------
    modes : if False, modes are not computed and have the shape (n, 0); this reduces the run time to a third

    Raises
    ------
    ValueError
        Beyond 10,000 coordinates, where a dense solution takes hours; use `complex_pairs` or `fastest_pair`.

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Eq 8; the mass matrix is that of its supplement, Eq 2, with I = I0 m R² for any I0.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> found = ss.spectrum(state, law)
    >>> len(found.eigenvalues), len(found.pairs)
    (300, 0)
    """
    free = freedom(state)
    if not len(free):
        raise ValueError("nothing is free to move: the spectrum needs at least one free coordinate")
    if len(free) > 10_000:
        raise ValueError(
            f"the dense spectrum supports at most 10000 coordinates, got {len(free)}: use `complex_pairs` up to 12000 "
            "and `fastest_pair` beyond"
        )
    here, root = linearised(state, law), np.sqrt(free.mass)
    matrix = here.dynamical_matrix(free).toarray()
    with suitable_threads(len(free)):
        if modes:
            values, vectors = eig(matrix, overwrite_a=True)
        else:
            values, vectors = eigvals(matrix, overwrite_a=True), np.zeros((len(free), 0))
    order = np.lexsort((values.imag, values.real))
    values, vectors = values[order], vectors[:, order] if modes else vectors
    real = np.abs(values.imag) <= REAL_BELOW * np.abs(values).max()
    values = np.where(real, values.real, values)
    return Spectrum(values, vectors / root[:, None], free, force_imbalance(here))


class SoftModes(NamedTuple):
    """Negative and zero eigenvalues among those computed at the bottom of the spectrum."""

    negative: np.ndarray  # (K,) λ < 0, lowest first [1/time²]
    vectors: np.ndarray  # (n, K) modes of these, as generalised displacements of unit mass-weighted norm
    zero: int  # number of zero eigenvalues


def soft_modes(matrix, count: int = SOFTEST, tolerance: float = 1e-10):
    """Negative eigenvalues with their modes, and the number of zero eigenvalues, among those nearest to zero.

    Parameters
    ----------
    matrix : (n, n) sparse, from `dynamical_matrix`
    count : int, number of eigenvalues computed, by Arnoldi's method with shift and invert
    tolerance : float, relative tolerance of the eigenvalues

    Returns
    -------
    (k,) negative λ, sorted [1/time²]; int; (n, k) eigenvectors of the matrix
    """
    values, vectors, scale = near_zero(matrix, count, tolerance)
    zero = np.abs(values) < ZERO_BELOW * scale
    negative = np.flatnonzero(~zero & (values.real < 0) & (np.abs(values.imag) <= REAL_BELOW * scale))
    negative = negative[np.argsort(values.real[negative])]
    return values.real[negative], int(zero.sum()), vectors[:, negative]


def softest_eigenvalue(matrix, count: int = SOFTEST, tolerance: float = 1e-10) -> complex:
    """Eigenvalue with the smallest real part among those nearest to zero, except zero modes; NaN if there are none.

    Parameters
    ----------
    matrix, count, tolerance : as for `soft_modes`; up to `ALL_UP_TO` coordinates, all eigenvalues are computed
    """
    if matrix.shape[0] <= ALL_UP_TO:
        values = eigvals(matrix.toarray())
        scale = np.abs(values).max(initial=0.0)
    else:
        values, _, scale = near_zero(matrix, count, tolerance)
    values = values[np.abs(values) >= ZERO_BELOW * scale]
    return complex(values[np.argmin(values.real)]) if len(values) else complex("nan")


def near_zero(matrix, count: int, tolerance: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Eigenvalues nearest to zero, their eigenvectors, and the largest entry of the matrix."""
    size, scale = matrix.shape[0], np.abs(matrix.data).max()
    shift = -1e-7 * scale
    solve = factorised(sparse.csr_array(matrix - shift * sparse.eye_array(size)))
    inverse = LinearOperator(matrix.shape, matvec=solve, dtype=float)
    start = np.random.default_rng(0).normal(size=size)
    try:
        values, vectors = eigs(matrix, k=min(count, size - 2), sigma=shift, OPinv=inverse, v0=start, tol=tolerance)
    except ArpackNoConvergence as problem:
        values, vectors = problem.eigenvalues, problem.eigenvectors
    return values, vectors, scale


def symmetric_part_is_positive(matrix, rigid: np.ndarray) -> bool:
    """Return True if no direction has negative stiffness, and False otherwise or in doubt; needs no factorisation.

    Lanczos's method finds the smallest eigenvalue of the symmetric part, scaled to a unit diagonal, which leaves the
    number of negative eigenvalues unchanged. If it is positive, all eigenvalues of the matrix have positive real parts.

    Parameters
    ----------
    matrix : (n, n) sparse, from `dynamical_matrix`, without empty rows
    rigid : (n, k) directions that the matrix does not resist, from `translations`
    """
    diagonal = matrix.diagonal()
    if not (diagonal > 0).all():
        return False
    scale = sparse.diags_array(1 / np.sqrt(diagonal))
    scaled = sparse.csr_array(scale @ (0.5 * (matrix + matrix.T)) @ scale)
    rigid = np.linalg.qr(np.sqrt(diagonal)[:, None] * rigid)[0]
    lifted = LinearOperator(matrix.shape, matvec=lambda x: scaled @ x + rigid @ (rigid.T @ x), dtype=float)
    start = np.random.default_rng(0).normal(size=len(diagonal))
    try:
        low = eigsh(lifted, 1, which="SA", v0=start, ncv=40, maxiter=100, tol=0.1, return_eigenvectors=False)
    except ArpackNoConvergence:
        return False
    return bool(low[0] > -NEGATIVE_BELOW)


@checked
def damped_growth(
    state: State, law: Law, *, drag: NotNegative = 0.0, spin_drag: NotNegative | None = None
) -> np.ndarray:
    """Exponents s of exp(st) of the linearised motion M q̈ = J q + C q̇ − M ν q̇, sorted by real part, largest first.

    All free coordinates are included, even rattlers and common translations; without drag, each adds s = 0 twice.
    LAPACK computes all eigenvalues; the exponents of a single contact agree with their closed form to 1e-12
    (`tests/unit/test_damped.py`).

    Parameters
    ----------
    drag, spin_drag : float [1/time]

    Returns
    -------
    (2n,) complex [1/time]; unstable if any real part is positive. Without drag and dashpots, s² = −λ.
    """
    motion = equations_of_motion(state, law)
    size, mass, axis = len(motion.mass), motion.mass[:, None], motion.axis
    rate = np.where((axis < 3) | (axis == 6), drag, drag if spin_drag is None else spin_drag)
    upper = np.hstack([np.zeros((size, size)), np.eye(size)])
    pull, friction = motion.jacobian.toarray() / mass, motion.damping.toarray() / mass - np.diag(rate)
    with suitable_threads(size):
        values = eigvals(np.vstack([upper, np.hstack([pull, friction])]))
    return values[np.argsort(-values.real)]


def mode_overlap(a: np.ndarray, b: np.ndarray, mass: np.ndarray) -> float:
    """Overlap, from 0 to 1, of the planes of two complex modes in the mass-weighted metric.

    A plane is spanned by the real and imaginary parts of a mode. The result is the smaller of the cosines of
    the two principal angles.
    """

    def plane(mode):
        columns = np.stack([mode.real, mode.imag], axis=1) * np.sqrt(mass)[:, None]
        return np.linalg.qr(columns)[0]

    return float(np.linalg.svd(plane(a).T @ plane(b), compute_uv=False).min())


@checked
def match_pairs(spectra: list[Spectrum], *, at_least: float = 0.5) -> list[dict[int, int]]:
    """Match complex pairs through a sequence of spectra by the overlap of their modes.

    Parameters
    ----------
    spectra : sequence of Spectrum, at neighbouring loads
    at_least : float, smallest overlap at which two pairs count as the same

    Returns
    -------
    list of dict
        one for each family: index of the spectrum -> index of the eigenvalue. A family ends where its pair becomes
        real.
    """
    families: list[dict[int, int]] = []
    for k, now in enumerate(spectra):
        living = [f for f in families if k - 1 in f]
        pairs = now.pair_indices
        taken = set()
        if living and len(pairs):
            before = spectra[k - 1]
            score = np.array(
                [
                    [mode_overlap(before.modes[:, f[k - 1]], now.modes[:, p], now.free.mass) for p in pairs]
                    for f in living
                ]
            )
            for row, col in zip(*scipy.optimize.linear_sum_assignment(-score), strict=True):
                if score[row, col] >= at_least:
                    living[row][k] = int(pairs[col])
                    taken.add(int(pairs[col]))
        families += [{k: int(p)} for p in pairs if int(p) not in taken]
    return families


def _summary(result: Spectrum) -> str:
    pairs, real = result.pair_indices, result.eigenvalues.real[result.eigenvalues.imag == 0]
    rate = f", the fastest grows at {result.growth_rate[pairs[0]]:.4g}" if len(pairs) else ""
    return (
        f"{len(result.eigenvalues)} eigenvalues, {pluralize(len(pairs), 'complex pair')}{rate}, "
        f"smallest real eigenvalue {real.min(initial=np.inf):.4g}, residual {result.residual:.1e}"
    )


@checked
def participation_ratio(modes: np.ndarray, free: Freedom) -> np.ndarray:
    """Participation ratio of modes, the fraction of bodies that take part.

    p = (Σ_b w_b)²/(N Σ_b w_b²), where w_b = Σ m |q|² over the coordinates of body b. It is 1 if all bodies move alike,
    as in a plane wave, and 1/N if only one moves. The weights include mass, rotations and |q|² of complex modes; for
    grains of equal mass they are the squares of polarisation vectors. A rigid group, with the mass of all its members,
    counts as one body, and so does a free cell.

    Parameters
    ----------
    modes : (n, K) real or complex generalised displacements, as in `Spectrum`, `Stability` and `ComplexPairs`
    free : Freedom of the modes, with N bodies; those of `stability` and `density_of_states` exclude rattlers

    Returns
    -------
    (K,) between 1/N and 1

    Source
    ------
    Bell & Dean, doi:10.1039/df9705000055; Silbert, Liu & Nagel, doi:10.1103/PhysRevE.79.021308, for
    polarisation vectors.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.linear()
    >>> state = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> pair = ss.spectrum(state, law)
    >>> round(float(participation_ratio(pair.modes, pair.free)[-1]), 6)
    1.0
    """
    modes = np.asarray(modes)
    if modes.ndim != 2 or len(modes) != len(free):
        raise ValueError(f"modes must have shape (n, K) with n = {len(free)} as in `free`, got {modes.shape}")
    bodies, where = np.unique(free.body, return_inverse=True)
    weight = np.zeros((len(bodies), modes.shape[1]))
    np.add.at(weight, where, free.mass[:, None] * np.abs(modes) ** 2)
    return weight.sum(axis=0) ** 2 / (len(bodies) * (weight**2).sum(axis=0))


@readable
class DensityOfStates(NamedTuple):
    """D(ω) of an undamped packing. Σ density · Δω is the fraction of its n modes with frequencies within the edges."""

    edges: np.ndarray  # (B + 1,) [1/time]
    density: np.ndarray  # (B,) D, with real λ > 0 at ω = √λ and both λ of a complex pair at ω = |Re √λ| [time]
    error: np.ndarray  # (B,) standard error from the random probes; zero if all eigenvalues were computed [time]
    of_pairs: np.ndarray  # (B,) contribution of complex pairs to `density`; NaN if it was not computed [time]
    frequency: np.ndarray  # (K,) frequencies of oscillating modes, sorted; empty if not all λ were computed [1/time]
    n: int  # number of modes: coordinates without those of rattlers
    zero: int  # number of modes that do not oscillate, λ = 0
    negative: int  # number of modes with λ < 0; −1 if they were not counted
    resolution: float  # resolution of frequencies; 0 if all eigenvalues were computed [1/time]
    method: str  # "dense" or "polynomials"

    @property
    def middle(self) -> np.ndarray:
        """(B,) centres of the bins [1/time]."""
        return (self.edges[1:] + self.edges[:-1]) / 2


@checked
def density_of_states(
    state: State, law: Law, *, bins: int | np.ndarray = 50,
    method: Literal["auto", "dense", "polynomials"] = "auto", probes: int = PROBES, seed: Seed = 0,
    report: Report = silent,
) -> DensityOfStates:  # fmt: skip
    """Density of states D(ω) = (1/n) Σ_k δ(ω − ω_k), with ω_k = |Re √λ_k| for the n eigenvalues λ_k of −M⁻¹J.

    Rattlers are excluded. J is not symmetric: a pair λ_r ± iλ_i counts twice, at its ω_r, and is also reported
    separately in `of_pairs`. Modes with λ = 0 and λ < 0 have no frequency and are counted separately.

    Parameters
    ----------
    bins : number of bins between 0 and the largest frequency, or their edges [1/time]
    method : "dense" computes all eigenvalues (at most 10,000 coordinates); "polynomials" estimates the counts by the
        kernel polynomial method: (1/n) tr T_k(A) with random probes, the Jackson kernel and bins integrated in closed
        form. It uses Re λ of pairs, with errors of order (λ_i/λ_max)², and counts negative λ and zero modes
        other than translations in the lowest bin. "auto" selects "dense" up to 2500 coordinates
    probes, seed : number of random vectors of ±1, and their seed; the error decreases as 1/√(probes n)
    report : called as report(stage, share done, text)

    Source
    ------
    Weiße, Wellein, Alvermann & Fehske, doi:10.1103/RevModPhys.78.275, Sec. II.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.linear()
    >>> state = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> pair = density_of_states(state, law, bins=2)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    ValueError: the packing has only rattlers: a density of states needs grains ...
    """
    if isinstance(bins, int | np.integer):
        require_sizes([Size(f"bins = {bins} makes", bins, "points", "use fewer bins")])
    free = backbone(state, law)
    if not len(free):
        raise ValueError("the packing has only rattlers: a density of states needs grains that support each other")
    if method == "auto":
        method = "dense" if len(free) <= DENSE_UP_TO else "polynomials"
    if method == "dense" and len(free) > 10_000:
        raise ValueError(f"the method 'dense' supports at most 10000 coordinates, got {len(free)}: use 'polynomials'")
    matrix = dynamical_matrix(state, law, free)
    if method == "dense":
        with suitable_threads(len(free)):
            return _count_modes(eigvals(matrix.toarray(), overwrite_a=True), bins)
    return _estimate_density(matrix, translations(matrix, free), bins, probes, seed, report)


def _bin_edges(bins, largest: float) -> np.ndarray:
    if np.ndim(bins) == 0 and not (isinstance(bins, int | np.integer) and bins > 0):
        raise ValueError(f"bins must be a number of bins, at least 1, or an array of edges, got {bins}")
    edges = np.linspace(0.0, largest, bins + 1) if np.ndim(bins) == 0 else np.asarray(bins, float)
    if edges.ndim != 1 or len(edges) < 2 or not (np.diff(edges) > 0).all() or edges[0] < 0:
        raise ValueError("the bin edges must be at least two increasing frequencies, none of them negative")
    return edges


def _count_modes(values: np.ndarray, bins) -> DensityOfStates:
    n, scale = len(values), np.abs(values).max(initial=0.0)
    zero, complex_ones = np.abs(values) < ZERO_BELOW * scale, np.abs(values.imag) > REAL_BELOW * scale
    negative = ~zero & ~complex_ones & (values.real < 0)
    rings = ~zero & ~negative
    frequency = np.abs(np.sqrt(values).real)
    # keep the largest frequency in the last bin despite round-off
    edges = _bin_edges(bins, frequency.max(initial=0.0) * (1 + 1e-12) or 1.0)
    per = n * np.diff(edges)
    density, of_pairs = (np.histogram(frequency[chosen], edges)[0] / per for chosen in (rings, rings & complex_ones))
    return DensityOfStates(
        edges, density, np.zeros(len(per)), of_pairs, np.sort(frequency[rings]), n, int(zero.sum()),
        int(negative.sum()), 0.0, "dense",
    )  # fmt: skip


def _estimate_density(matrix, rigid: np.ndarray, bins, probes: int, seed: int, report) -> DensityOfStates:
    """Density of states from Chebyshev moments.

    With λ = centre + half · cos θ, a resolution of π/K in θ corresponds to (√λ_max/2) π/K in ω.
    """
    if probes < 2:
        raise ValueError(f"probes must be at least 2 to estimate the error, got {probes}")
    n, rng = matrix.shape[0], np.random.default_rng(seed)
    low, high = _spectral_bounds(matrix, rng.standard_normal(n))
    edges = _bin_edges(bins, float(np.sqrt(high)))
    half, centre = (high - low) / 2, (high + low) / 2
    order = int(np.ceil(SHARP * np.pi * np.sqrt(high) / 2 / np.diff(edges).min()))
    moments = np.empty((order, probes))
    vectors = rng.choice([-1.0, 1.0], (n, probes))
    vectors -= rigid @ (rigid.T @ vectors)
    before, now = vectors, (matrix @ vectors - centre * vectors) / half
    moments[0] = np.einsum("ij,ij->j", vectors, vectors)
    for k in range(1, order):
        moments[k] = np.einsum("ij,ij->j", vectors, now)
        before, now = now, 2 / half * (matrix @ now - centre * now) - before
        if k % 50 == 0:
            report("density of states", k / order, f"{k} of {order} polynomials")
    moments *= (n - rigid.shape[1]) / moments[0]
    angle = np.arccos(np.clip((edges**2 - centre) / half, -1.0, 1.0))
    angle[0] = np.pi if edges[0] == 0 else angle[0]  # the part smeared below zero belongs to the first bin
    k, turn = np.arange(1, order), np.pi / (order + 1)  # the factors of Jackson keep the density positive
    jackson = ((order - k + 1) * np.cos(k * turn) + np.sin(k * turn) / np.tan(turn)) / (order + 1)
    weights = 2 * jackson[:, None] * np.sin(k[:, None] * angle) / k[:, None]
    above = (angle[:, None] * moments[0] + weights.T @ moments[1:]) / np.pi  # number of λ above each edge
    share = -np.diff(above, axis=0) / (n * np.diff(edges)[:, None])
    error = share.std(axis=1, ddof=1) / np.sqrt(probes)
    return DensityOfStates(
        edges, share.mean(axis=1), error, np.full(len(error), np.nan), np.zeros(0), n, rigid.shape[1], -1,
        float(np.sqrt(high) / 2 * np.pi / order), "polynomials",
    )  # fmt: skip


def _spectral_bounds(matrix, start: np.ndarray) -> tuple[float, float]:
    """Interval that contains zero and the real parts of all eigenvalues, from the symmetric part with a margin."""
    symmetric, eye = (matrix + matrix.T) / 2, sparse.eye_array(matrix.shape[0])

    def top(of) -> float:
        return float(eigsh(of, k=1, which="LA", tol=0.1 * MARGIN, v0=start, return_eigenvectors=False)[0])

    high = top(symmetric)
    low = min(high - top(high * eye - symmetric), 0.0)  # the smallest may be zero, for which a relative tolerance fails
    return low - MARGIN * (high - low), high + MARGIN * (high - low)
