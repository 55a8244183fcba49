"""All complex pairs of −M⁻¹J for large systems: modes of the symmetric part, coupled in windows."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, eig, qr, schur
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

from ..core.arguments import checked
from ..core.laws.builtin import Law
from ..core.progress import Report, silent
from ..core.readable import readable
from ..core.state import State
from .certificate import Certificate, certificate_seconds, format_seconds, gershgorin_certificate
from .freedom import Freedom, dynamical_matrix, freedom
from .linear import factorised, one_thread, suitable_threads
from .spectrum import REAL_BELOW
from .windows import (
    NEAR_PAIR,
    STAGE,
    Basis,
    Cluster,
    Window,
    find_candidates,
    pair_margin,
    regularise_gaps,
    symmetric_basis,
)

LARGEST = 12_000  # coordinates: four dense matrices of this size take 3 GB, and the time grows with the cube
DENSE_BELOW = 1500  # coordinates below which LAPACK takes a few seconds
# residual over the largest |λ|: target, and limit of acceptance if round-off stops earlier
CONVERGED, ENOUGH = 2e-15, 1e-12
SAME = 1e-9  # share of the largest |λ| within which two refined eigenvalues with one eigenvector are identical
NEIGHBOURS = 20  # additional eigenvalues that Arnoldi's method computes near those of a subspace


@readable
class ComplexPairs(NamedTuple):
    """All complex pairs of −M⁻¹J, one λ with Im λ > 0 for each, fastest growing first."""

    eigenvalues: np.ndarray  # (P,) complex [1/time²]
    modes: np.ndarray  # (n, P) complex, columns: generalised displacements of unit mass-weighted norm
    residual: np.ndarray  # (P,) ‖Ax − λx‖ of the unit eigenvector x over the largest |λ|
    free: Freedom
    certified: Certificate | None

    @property
    def growth_rate(self) -> np.ndarray:
        """(P,) ω_i = |Im √λ| [1/time]."""
        return np.abs(np.sqrt(self.eigenvalues).imag)

    @property
    def frequency(self) -> np.ndarray:
        """(P,) ω_r = |Re √λ| [1/time]."""
        return np.abs(np.sqrt(self.eigenvalues).real)


@checked
def complex_pairs(
    state: State, law: Law, *, certificate: bool = False, report: Report = silent, dense_below: int = DENSE_BELOW
) -> ComplexPairs:
    """Find all complex pairs λ_r ± iλ_i of −M⁻¹J at an accepted state, to double precision.

    M^(−1/2)(−J)M^(−1/2) = S + K with a skew part K that is about 1e-3 of S in size. A pair is born where K couples two
    nearly degenerate modes of S by more than their separation. S is diagonalised in single precision. Windows of its
    modes are coupled by K in double precision; all modes outside enter to second order. Pairs, and eigenvalues too
    close to forming a pair for a decision, are refined as invariant subspaces of A itself and counted if Im λ > 1e-9 of
    the largest |λ|. Dense LAPACK is used where K is too strong (sliding contacts) and for small systems.

    Parameters
    ----------
    certificate : whether real eigenvalues are certified by Gershgorin discs; needs double precision and several times
        the run time, an estimate of which is reported first
    report : called as report(stage, share done, text)
    dense_below : number of coordinates below which LAPACK is used

    Raises
    ------
    ValueError, LinAlgError
        if there are no coordinates or more than 12,000; or if a candidate could not be refined.

    Source
    ------
    S. Bonfanti et al., doi:10.1103/PhysRevE.101.052902, for the pairs.

    Examples
    --------
    >>> # 1000 spheres, sheared by 8e-4
    >>> found = complex_pairs(state, law)  # doctest: +SKIP
    >>> len(found.eigenvalues), found.eigenvalues[0]  # doctest: +SKIP
    (146, 0.0360062+4.69e-05j)
    """
    free = freedom(state)
    n = len(free)
    if not n:
        raise ValueError("nothing is free to move: pairs need at least one free coordinate")
    if n > LARGEST:
        time = f", and the certificate would take about {format_seconds(certificate_seconds(n))}" if certificate else ""
        raise ValueError(
            f"{n} coordinates were given: `complex_pairs` takes at most {LARGEST}{time}; use `fastest_pair` instead"
        )
    if certificate:
        report(STAGE, 0.0, f"certificate of {n} coordinates, estimated time {format_seconds(certificate_seconds(n))}")
    matrix = dynamical_matrix(state, law, free)
    # a row of zeros gives a zero eigenvalue, and its coordinate does not move in any other mode
    held = np.flatnonzero(abs(matrix).sum(axis=1))
    matrix = matrix[held][:, held]
    basis, clusters = None, None
    if len(held) >= dense_below:
        basis = symmetric_basis(matrix, np.float64 if certificate else np.float32, report)
        clusters = find_candidates(basis, report)
    dense = clusters is None  # small, or K too strong
    values, vectors, scale = (
        _pairs_dense(matrix, report) if dense else _refine_clusters(matrix, basis, clusters, report)
    )
    order = np.argsort(-np.abs(np.sqrt(values).imag))
    order = order[values.imag[order] > REAL_BELOW * scale]
    values, vectors = values[order], vectors[:, order]
    residual = np.linalg.norm(matrix @ vectors - vectors * values, axis=0) / (scale or 1.0)
    certified = gershgorin_certificate(matrix, basis, values, n - len(held), report) if certificate else None
    modes = np.zeros((n, len(values)), complex)
    modes[held] = vectors / np.sqrt(free.mass[held])[:, None]
    report(STAGE, 1.0, f"{len(values)} complex pairs")
    return ComplexPairs(values, modes, residual, free, certified)


def _pairs_dense(matrix, report: Report):
    """Eigenvalues with Im λ > 0, unit eigenvectors, and the largest |λ|, from LAPACK."""
    report(STAGE, 0.7, "dense eigenvalues")
    with suitable_threads(matrix.shape[0]):
        values, vectors = eig(matrix.toarray(order="F"), overwrite_a=True)
    upper = values.imag > 0
    return values[upper], vectors[:, upper], float(np.abs(values).max(initial=0.0))


def _refine_clusters(matrix, basis: Basis, clusters: list[Cluster], report: Report, sweeps: int = 20):
    """Eigenvalues with Im λ > 0 and unit eigenvectors of all clusters, without duplicates, and the largest |λ|.

    Every sweep computes the residual R = AX − XB of each invariant subspace X and removes the error in X by applying
    an approximate inverse of A − σ in the modes of S. This takes two large matrix products for all clusters together,
    instead of one sparse factor for each.
    """
    report(STAGE, 0.8, f"refining {len(clusters)} candidates")
    subspaces = [qr(cluster.vectors, mode="economic")[0] for cluster in clusters]
    single = np.float32  # a correction needs only a few digits
    V = basis.vectors.astype(single, copy=False)
    # subspaces in the modes of S, which only say which directions a correction leaves out
    borders = [basis.vectors[:, c.window.inside].T @ x for c, x in zip(clusters, subspaces, strict=True)]
    last, active = np.full(len(clusters), np.inf), range(len(clusters))
    for _ in range(sweeps):
        residuals = {k: _subspace_residual(matrix, subspaces[k]) for k in active}
        size = {k: np.linalg.norm(R) / basis.scale for k, (R, _) in residuals.items()}
        active = [k for k in active if size[k] > (CONVERGED if size[k] < last[k] / 2 else ENOUGH)]
        for k, s in size.items():
            last[k] = s
        real = {k for k in active if _is_certainly_real(residuals[k][1], 10 * size[k] * basis.scale)}
        active = [k for k in active if k not in real]
        last[list(real)] = 0
        if not active:
            break
        inner = V.T @ np.hstack([residuals[k][0] for k in active]).astype(single)
        ends = np.cumsum([subspaces[k].shape[1] for k in active])[:-1]
        parts = zip(active, np.split(inner, ends, axis=1), strict=True)
        with one_thread():  # many small systems
            inner = np.hstack(
                [_subspace_correction(basis, clusters[k].window, residuals[k][1], r, borders[k]) for k, r in parts]
            )
        for k, change in zip(active, np.split(V @ inner.astype(single), ends, axis=1), strict=True):
            subspaces[k] = qr(subspaces[k] - change, mode="economic")[0]
    good = [subspace for subspace, size in zip(subspaces, last, strict=True) if size <= ENOUGH]
    for k in np.flatnonzero(last > ENOUGH):
        good += _search_by_arnoldi(matrix, subspaces[k], basis.scale)
    values, vectors = _extract_pairs(matrix, good, basis.scale)
    report(STAGE, 0.82, "comparing with the pairs found by the windows")
    lost = [clusters[k] for k in _unmatched_clusters(values, clusters, 2 * NEAR_PAIR * basis.scale)]
    if lost:  # refinement converged to a neighbour of the pair that it started from
        for cluster in lost:
            good += _search_by_arnoldi(matrix, qr(cluster.vectors, mode="economic")[0], basis.scale)
        values, vectors = _extract_pairs(matrix, good, basis.scale)
    return values, vectors, basis.scale


def _unmatched_clusters(values: np.ndarray, clusters: list[Cluster], tolerance: float) -> list[int]:
    """Clusters in which a clear pair is expected but no eigenvalue matches it."""
    owner = np.repeat(np.arange(len(clusters)), [len(c.expected) for c in clusters])
    expected = np.concatenate([np.zeros(0, complex), *(c.expected for c in clusters)])
    clear = expected.imag > 10 * tolerance
    owner, expected = owner[clear], expected[clear]
    if not len(expected):
        return []
    if not len(values):
        return sorted(set(owner.tolist()))
    # pairs at window borders occur twice: one eigenvalue may match two clusters, but not two pairs of one cluster
    far = np.abs(expected[:, None] - values[None, :])
    near = far < tolerance + 0.05 * expected.imag[:, None]
    lost = set(owner[~near.any(axis=1)].tolist())
    for k in set(owner.tolist()) - lost:
        mine = owner == k
        if len(np.unique(far[mine].argmin(axis=1))) < mine.sum():
            lost.add(k)
    return sorted(lost)


def _is_certainly_real(B: np.ndarray, error: float) -> bool:
    """Return True if the two real eigenvalues of a subspace are farther from being a pair than its error allows."""
    values, vectors = np.linalg.eig(B)
    return len(B) == 2 and not np.iscomplexobj(values) and pair_margin(values, vectors)[0] > error


def _subspace_residual(matrix, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R = AX − XB of an orthonormal X, and B = XᵀAX."""
    image = matrix @ X
    B = X.T @ image
    return image - X @ B, B


def _subspace_correction(basis: Basis, window: Window, B: np.ndarray, R: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Z in the modes of S with AZ − ZB ≈ R, without a component in the subspace itself.

    `border` holds the subspace in the modes of the window.

    Solved column by column in the complex Schur form B = QTQᴴ, which also exists if two eigenvalues of B coalesce.
    """
    T, Q = schur(B, output="complex")
    p, m = len(B), len(window.M)
    K = basis.skew[window.inside]  # includes K_PQ; K_QP = −K_PQᵀ
    system, R, Z = np.zeros((m + p, m + p), complex), R @ Q, np.zeros(R.shape, complex)
    system[:m, m:] = border
    system[m:, :m] = border.T
    for j in range(p):
        right = R[:, j] + Z[:, :j] @ T[:j, j]
        weight = 1 / regularise_gaps(basis.diagonal - T[j, j], basis.scale)
        weight[window.inside] = 0
        outside = right * weight
        right = np.append(right[window.inside] - _real_matmul(K, outside), np.zeros(p))
        system[:m, :m] = window.M - (T[j, j] - window.centre) * window.N
        own = np.linalg.solve(system, right)[:m]
        Z[:, j] = outside + weight * _real_matmul(K.T, own)
        Z[window.inside, j] = own
    return (Z @ Q.conj().T).real


def _real_matmul(K: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Kz for a real single-precision K, without a complex copy of K."""
    product = K @ np.stack([z.real, z.imag], axis=1).astype(K.dtype)
    return product[:, 0] + 1j * product[:, 1]


def _search_by_arnoldi(matrix, subspace: np.ndarray, scale: float) -> list[np.ndarray]:
    """Invariant planes of all pairs among the eigenvalues nearest to those of a subspace, by shift and invert.

    Raises
    ------
    LinAlgError
        if Arnoldi's method does not converge.
    """
    # off the eigenvalue itself
    shift = np.trace(_subspace_residual(matrix, subspace)[1]) / subspace.shape[1] + 1e-9 * scale
    solve = factorised(sparse.csr_array(matrix - shift * sparse.eye_array(len(subspace))))
    inverse = LinearOperator(matrix.shape, matvec=solve, dtype=float)
    count = min(subspace.shape[1] + NEIGHBOURS, matrix.shape[0] - 2)
    try:
        values, vectors = eigs(matrix, k=count, sigma=shift, OPinv=inverse, v0=subspace.sum(axis=1))
    except ArpackNoConvergence:
        raise LinAlgError(f"the pair near λ = {shift:.6g} could not be refined: use `spectrum`") from None
    pairs = np.flatnonzero(values.imag > 0.1 * REAL_BELOW * scale)
    return [qr(np.stack([vectors[:, k].real, vectors[:, k].imag], axis=1), mode="economic")[0] for k in pairs]


def _extract_pairs(matrix, subspaces: list[np.ndarray], scale: float):
    """Eigenvalues with Im λ > 0 and eigenvectors within subspaces, without duplicates."""
    values, vectors = [], []
    for X in subspaces:
        theta, y = eig(X.T @ (matrix @ X))
        for k in np.flatnonzero(theta.imag > 0):
            x = X @ y[:, k]
            x /= np.linalg.norm(x)
            if np.linalg.norm(matrix @ x - theta[k] * x) > 10 * ENOUGH * scale:
                continue
            near = [w for v, w in zip(values, vectors, strict=True) if abs(theta[k] - v) < SAME * scale]
            if not any(abs(np.vdot(x, w)) > 0.9 for w in near):
                values.append(theta[k])
                vectors.append(x)
    return np.array(values, complex), np.array(vectors, complex).reshape(-1, matrix.shape[0]).T
