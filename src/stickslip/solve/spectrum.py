"""Spectrum of −M⁻¹J: stability, complex pairs, growth rates, mode shapes, and tracking of pairs along a load."""

from typing import NamedTuple

import numpy as np
import scipy  # scipy.optimize is imported on first use: that takes a tenth of a second
from scipy import sparse
from scipy.linalg import eig, eigvals
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, eigsh

from ..core.arguments import checked, require_not_negative
from ..core.contacts.jacobian import contact_blocks
from ..core.laws.builtin import Law
from ..core.readable import pluralize, readable
from ..core.state import State
from .balance import BALANCED_BELOW, force_imbalance
from .freedom import ZERO_BELOW, Freedom, assembled, freedom, jacobian
from .linear import factorised, suitable_threads
from .linearised import linearised

ALL_UP_TO = 120  # coordinates up to which all eigenvalues are computed where a few would do
SOFTEST = 40  # eigenvalues nearest to zero that are computed if not all are
NEGATIVE_BELOW = 1e-8  # a scaled eigenvalue of the symmetric part above minus this is not negative
REAL_BELOW = 1e-9  # |Im λ| below this share of the largest |λ| is round-off: J carries noise of 1e-15


@readable(head=lambda result: _summary(result))
class Spectrum(NamedTuple):
    """All eigenvalues λ of −M⁻¹J, sorted by real part, with their modes.

    A stable mode has λ > 0 and frequency √λ; λ < 0 means buckling. A complex pair λ_r ± iλ_i oscillates at ω_r and
    grows as exp(ω_i t), ω_r + iω_i = √(λ_r + iλ_i).
    """

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
        """Indices of `pairs` in `eigenvalues`, and of their modes, growth rates and frequencies."""
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
        """(n, 7) shares of the mass-weighted norm of each mode in x, y, z, rotations and the cell; they add up to 1."""
        weight = self.free.mass[:, None] * np.abs(self.modes) ** 2
        axis = self.free.axis
        return np.stack([weight[axis == k].sum(axis=0) for k in range(7)], axis=1)


@checked
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
        beyond 10,000 coordinates, where a dense solution takes hours; use `complex_pairs` or `fastest_pair`.

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
            f"{len(free)} coordinates were given: the dense spectrum takes at most 10000; "
            f"use `complex_pairs` up to 12000 and `fastest_pair` beyond"
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


def soft_modes(matrix, count: int = SOFTEST, tolerance: float = 1e-10):
    """Negative eigenvalues with modes, and number of zero eigenvalues, among those nearest to zero.

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
    """Eigenvalue with the smallest real part among those nearest to zero, without zero modes; NaN if there are none.

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
    """Return True if no direction has negative stiffness, without a factorisation; False if there is one or in doubt.

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
def damped_growth(state: State, law: Law, *, drag: float = 0.0, spin_drag: float | None = None) -> np.ndarray:
    """Exponents s of exp(st) of the linearised motion M q̈ = J q + C q̇ − M ν q̇, sorted by real part, largest first.

    All free coordinates take part, those of rattlers and common translations too: without drag each adds s = 0 twice.
    All eigenvalues are computed, by LAPACK: the exponents of a single contact are those of its closed form to 1e-12
    (`tests/unit/test_damped.py`).

    Parameters
    ----------
    drag, spin_drag : float [1/time]

    Returns
    -------
    (2n,) complex [1/time]; unstable if any real part is positive. Without drag and dashpots, s² = −λ.
    """
    free = freedom(state)
    require_not_negative(drag=drag, spin_drag=spin_drag)
    _, dashpots = contact_blocks(state, law)
    rate = np.where((free.axis < 3) | (free.axis == 6), drag, drag if spin_drag is None else spin_drag)
    upper = np.hstack([np.zeros((len(free), len(free))), np.eye(len(free))])
    pull = jacobian(state, law, free).toarray() / free.mass[:, None]
    friction = assembled(state, dashpots, free).toarray() / free.mass[:, None] - np.diag(rate)
    with suitable_threads(len(free)):
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
