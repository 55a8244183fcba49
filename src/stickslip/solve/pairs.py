"""All complex pairs of −M⁻¹J where dense LAPACK is slow: modes of the symmetric part, coupled window by window."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, block_diag, eig, eigh, lu_factor, lu_solve, qr, schur
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

from ..core.laws import Law
from ..core.state import State
from .freedom import Freedom, freedom, stiffness
from .linear import factorised, one_thread
from .spectrum import REAL_BELOW

Report = Callable[[float, str], None]
LARGEST = 12_000  # coordinates: four dense matrices of this size take 3 GB, and the time grows with the cube
DENSE_BELOW = 1500  # coordinates; below it LAPACK takes a few seconds
# modes of S treated together, and their neighbours on either side: with 32 and 28, windows of strongly sheared packings
# were off by as much as their pairs were wide
WINDOW, HALO = 40, 80
# windows are trusted to NEAR_PAIR of the largest |λ| and MIXED mixing² of their half width: the largest errors seen
# were 1e-6 (1000 spheres) and 0.1 (150)
NEAR_PAIR, MIXED = 5e-6, 0.2
WEAK = 0.3  # largest first-order share of outer modes in a window's mode for which second order is trusted
CONVERGED, ENOUGH = 2e-15, 1e-12  # residual over the largest |λ|: aimed at, and accepted where round-off stops earlier
SAME = 1e-9  # share of the largest |λ| within which two refined eigenvalues with one eigenvector are one
NEIGHBOURS = 20  # eigenvalues beside those of a subspace that Arnoldi's method looks at
CLUSTER = 0.3  # |E_ij/(d_j − d_i)| beyond which two modes are left coupled by a similarity pass


class Certificate(NamedTuple):
    """What Gershgorin discs say about every eigenvalue, in floating point, not interval arithmetic."""

    size: int  # eigenvalues examined
    real: int  # alone in a disc with a real centre: real, because the spectrum of a real matrix is its own mirror image
    zero: int  # coordinates that nothing holds: exactly zero, not among those examined
    pairs: int  # pairs whose disc is isolated and does not touch the real axis
    undecided: np.ndarray  # (k,) centres of overlapping discs [1/time²]
    members: np.ndarray  # (k,) eigenvalues in each
    consistent: bool  # every pair found is certified or among the undecided, and every certified pair was found

    def __str__(self):
        centres = ", ".join(f"{c:.6g} ({m})" for c, m in zip(self.undecided, self.members, strict=True))
        return (
            f"of {self.size} eigenvalues, {self.real} are certified real and {self.pairs} pairs certified complex "
            f"(floating point, not interval arithmetic); {self.zero} more are exactly zero; "
            + (f"undecided around λ = {centres}" if centres else "none is undecided")
            + ("" if self.consistent else "; THE PAIRS FOUND CONTRADICT THIS: use spectrum()")
        )


class Pairs(NamedTuple):
    """Every complex pair of −M⁻¹J, one λ with Im λ > 0 for each, fastest growing first."""

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


class Basis(NamedTuple):
    """Modes of the symmetric part S of A = S + K, and A seen in them."""

    vectors: np.ndarray  # (n, n), orthonormal to single precision
    image: np.ndarray  # (n, n) A times them, in double precision
    diagonal: np.ndarray  # (n,) Rayleigh quotients, in double precision [1/time²]
    skew: np.ndarray  # (n, n) single precision: K between the modes [1/time²]

    @property
    def scale(self) -> float:
        """Largest |λ| [1/time²], to the precision that thresholds need."""
        return float(np.abs(self.diagonal).max())


class Window(NamedTuple):
    """Modes `inside`, all others eliminated to second order: (N⁻¹M − (λ − centre)) c = 0."""

    inside: slice
    centre: float
    M: np.ndarray
    N: np.ndarray
    mixing: float  # largest first-order share of outer modes in one of the window


class Cluster(NamedTuple):
    """Neighbouring eigenvalues that may hold a pair: a real invariant subspace to be refined."""

    window: Window
    vectors: np.ndarray  # (n, p)
    expected: np.ndarray  # complex eigenvalues with Im λ > 0 that the window found in it [1/time²]


def complex_pairs(
    state: State, law: Law, *, certificate: bool = False, report: Report | None = None, dense_below: int = DENSE_BELOW
) -> Pairs:
    """Every complex pair λ_r ± iλ_i of −M⁻¹J at an accepted state, to double precision.

    M^(−1/2)(−J)M^(−1/2) = S + K with a skew part K that is 1e-3 of S: a pair is born where K couples two nearly
    degenerate modes of S more strongly than they are apart. S is diagonalised in single precision; windows of its modes
    are coupled by K in double precision, all modes outside to second order. What is a pair, or too near to one to tell,
    is refined as an invariant subspace of A itself, and counted if Im λ > 1e-9 of the largest |λ|. Where K is too
    strong for that (sliding contacts), and for small systems, dense LAPACK does it all.

    Parameters
    ----------
    certificate : count by Gershgorin discs what is real; needs double precision and several times the time
    report : called as report(share done, words)
    dense_below : coordinates below which LAPACK is used

    Raises
    ------
    ValueError, LinAlgError
        without coordinates, or beyond 12,000 of them; if a candidate could not be refined.

    Source
    ------
    The pairs: S. Bonfanti et al., doi:10.1103/PhysRevE.101.052902.

    Examples
    --------
    >>> found = complex_pairs(state, law)  # 1000 spheres, sheared by 8e-4
    >>> len(found.eigenvalues), found.eigenvalues[0]
    (146, 0.0360062+4.69e-05j)
    """
    tell = report or _silent
    free = freedom(state)
    n = len(free)
    if not n:
        raise ValueError("nothing is free to move: pairs need at least one free coordinate")
    if n > LARGEST:
        raise ValueError(f"{n} coordinates were given, at most {LARGEST} are taken: use `fastest_pair` instead")
    matrix = stiffness(state, law, free)
    # a row of zeros is an eigenvalue zero, and its coordinate does not move in any other mode
    held = np.flatnonzero(abs(matrix).sum(axis=1))
    matrix = matrix[held][:, held]
    basis, clusters = None, None
    if len(held) >= dense_below:
        basis = _basis(matrix, np.float64 if certificate else np.float32, tell)
        clusters = _candidates(basis, tell)
    dense = clusters is None  # small, or K too strong
    values, vectors, scale = _dense(matrix, tell) if dense else _refined(matrix, basis, clusters, tell)
    order = np.argsort(-np.abs(np.sqrt(values).imag))
    order = order[values.imag[order] > REAL_BELOW * scale]
    values, vectors = values[order], vectors[:, order]
    residual = np.linalg.norm(matrix @ vectors - vectors * values, axis=0) / (scale or 1.0)
    certified = _certificate(matrix, basis, values, n - len(held), tell) if certificate else None
    modes = np.zeros((n, len(values)), complex)
    modes[held] = vectors / np.sqrt(free.mass[held])[:, None]
    tell(1.0, f"{len(values)} complex pairs")
    return Pairs(values, modes, residual, free, certified)


def _silent(share: float, words: str) -> None:
    """Tell nobody."""


def _dense(matrix, tell: Report):
    """Eigenvalues with Im λ > 0, unit eigenvectors, and the largest |λ|, by LAPACK."""
    tell(0.7, "dense eigenvalues")
    values, vectors = eig(matrix.toarray(order="F"), overwrite_a=True)
    upper = values.imag > 0
    return values[upper], vectors[:, upper], float(np.abs(values).max(initial=0.0))


def _basis(matrix, precision, tell: Report) -> Basis:
    tell(0.0, f"modes of the symmetric part of {matrix.shape[0]} coordinates")
    symmetric = ((matrix + matrix.T) / 2).toarray(order="F").astype(precision, copy=False)
    vectors = eigh(symmetric, driver="evd", overwrite_a=True, check_finite=False)[1]
    tell(0.6, "their coupling")
    vectors = np.ascontiguousarray(vectors)  # rows together: what a sparse matrix multiplies
    double = vectors.astype(float, copy=False)
    image = matrix @ double
    diagonal = np.einsum("ij,ij->j", double, image) / np.einsum("ij,ij->j", double, double)
    single = vectors.astype(np.float32, copy=False)
    skew = single.T @ (((matrix - matrix.T) / 2).astype(np.float32) @ single)
    return Basis(vectors, image, diagonal, skew)


def _window(basis: Basis, first: int) -> Window:
    """The window of modes first … first + WINDOW and its halo.

    Outer modes are eliminated to second order and to first order in λ − centre:
    M = H − centre G − K_PQ (D_Q − centre)⁻¹ K_QP, N = G + K_PQ (D_Q − centre)⁻² K_QP, with K_PQ = −K_QPᵀ. G differs
    from one, and H from D + K, by the round-off of the modes, which would blur pairs at first order.
    """
    n = len(basis.diagonal)
    last = min(n, first + WINDOW) - 1
    inside = slice(max(0, first - HALO), min(n, last + 1 + HALO))
    centre = (basis.diagonal[first] + basis.diagonal[last]) / 2
    x = basis.vectors[:, inside].astype(float, copy=False)
    # products joined: each is split over threads, which then wait for each other
    G, H = np.split(np.hstack([x, basis.image[:, inside]]).T @ x, 2)
    H = H.T - centre * G
    K = -basis.skew[inside].T.astype(float)
    share = K / _apart(basis.diagonal - centre, basis.scale)[:, None]
    share[inside] = 0
    mixing = float(np.linalg.norm(share, axis=0).max())
    second, slope = np.split(np.hstack([K, share]).T @ share, 2)
    return Window(inside, centre, H + second, G - slope, mixing)


def _apart(gap: np.ndarray, scale: float) -> np.ndarray:
    """Gaps kept off zero: an outer mode at the very centre makes the mixing huge, not infinite."""
    least = 1e-12 * scale
    return np.where(np.abs(gap) < least, least, gap)


def _candidates(basis: Basis, tell: Report) -> list[Cluster] | None:
    """Clusters that are or may be pairs; None where K is too strong for windows."""
    tell(0.65, "windows")
    clusters = []
    # an eigenvalue next to the border of two windows is taken by both, and told apart after refinement
    margin = 10 * NEAR_PAIR * basis.scale
    n, sorted_diagonal = len(basis.diagonal), np.sort(basis.diagonal)
    for first in range(0, n, WINDOW):
        window = _window(basis, first)
        if window.mixing > WEAK:
            return None
        left = sorted_diagonal[first - 1 : first + 1].mean() - margin if first else -np.inf
        end = first + WINDOW
        right = sorted_diagonal[end - 1 : end + 1].mean() + margin if end < n else np.inf
        with one_thread():
            values, vectors = eig(np.linalg.solve(window.N, window.M))
        order = np.lexsort((values.imag, values.real))
        values, vectors = values[order] + window.centre, vectors[:, order]
        near = NEAR_PAIR * basis.scale + MIXED * window.mixing**2 * np.ptp(basis.diagonal[window.inside]) / 2
        for members in _suspects(values, vectors, near):
            if left <= values[members].real.mean() <= right:
                plane = np.hstack([vectors[:, members].real, vectors[:, members].imag])
                small = qr(plane, mode="economic", pivoting=True)[0][:, : len(members)]
                part = basis.vectors[:, window.inside]
                mine = values[members]
                clusters.append(Cluster(window, part.astype(float, copy=False) @ small, mine[mine.imag > 0]))
    return clusters


def _suspects(values: np.ndarray, vectors: np.ndarray, near: float) -> list[np.ndarray]:
    """Index sets of sorted eigenvalues that hold a pair or real ones about to become one."""
    real = (values.imag[:-1] == 0) & (values.imag[1:] == 0)
    conjugate = (values.imag[:-1] != 0) & (values[:-1] == values[1:].conj())
    links = np.flatnonzero(conjugate | (real & (_distance(values, vectors) < near)))
    chains = np.split(links, np.flatnonzero(np.diff(links) > 1) + 1) if len(links) else []
    return [np.arange(chain[0], chain[-1] + 2) for chain in chains]


def _distance(values: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(n − 1,) how much skew coupling neighbouring real eigenvalues lack of being a pair [1/time²].

    [[δ/2, k], [−k, −δ/2]] has eigenvectors with the cosine c = 2k/δ and a gap δ√(1 − c²), so that
    δ/2 − k = gap/2 · √((1 − c)/(1 + c)): a small gap alone does not mean a pair to come.
    """
    gap = np.abs(np.diff(values))
    cosine = np.minimum(np.abs(np.einsum("ij,ij->j", vectors[:, :-1].conj(), vectors[:, 1:])), 1.0)
    return gap / 2 * np.sqrt((1 - cosine) / (1 + cosine))


def _refined(matrix, basis: Basis, clusters: list[Cluster], tell: Report, sweeps: int = 20):
    """Eigenvalues with Im λ > 0 and unit eigenvectors of all clusters, each once, and the largest |λ|.

    Every sweep takes the residual R = AX − XB of each invariant subspace X and removes X's error with an approximate
    inverse of A − σ in the modes of S: two large matrix products for all clusters together, instead of one sparse
    factor for each.
    """
    tell(0.8, f"refining {len(clusters)} candidates")
    subspaces = [qr(cluster.vectors, mode="economic")[0] for cluster in clusters]
    single = np.float32  # a correction needs a few digits only
    V = basis.vectors.astype(single, copy=False)
    last, active = np.full(len(clusters), np.inf), range(len(clusters))
    for _ in range(sweeps):
        residuals = {k: _residual(matrix, subspaces[k]) for k in active}
        size = {k: np.linalg.norm(R) / basis.scale for k, (R, _) in residuals.items()}
        active = [k for k in active if size[k] > (CONVERGED if size[k] < last[k] / 2 else ENOUGH)]
        for k, s in size.items():
            last[k] = s
        real = {k for k in active if _surely_real(residuals[k][1], 10 * size[k] * basis.scale)}
        active = [k for k in active if k not in real]
        last[list(real)] = 0
        if not active:
            break
        inner = V.T @ np.hstack([residuals[k][0] for k in active]).astype(single)
        border = V.T @ np.hstack([subspaces[k] for k in active]).astype(single)
        ends = np.cumsum([subspaces[k].shape[1] for k in active])[:-1]
        parts = zip(active, np.split(inner, ends, axis=1), np.split(border, ends, axis=1), strict=True)
        inner = np.hstack([_correction(basis, clusters[k].window, residuals[k][1], r, x) for k, r, x in parts])
        for k, change in zip(active, np.split(V @ inner.astype(single), ends, axis=1), strict=True):
            subspaces[k] = qr(subspaces[k] - change, mode="economic")[0]
    good = [subspace for subspace, size in zip(subspaces, last, strict=True) if size <= ENOUGH]
    for k in np.flatnonzero(last > ENOUGH):
        good += _by_arnoldi(matrix, subspaces[k], basis.scale)
    values, vectors = _distinct(matrix, good, basis.scale)
    tell(0.82, "comparing with what the windows found")
    lost = [clusters[k] for k in _unmatched(values, clusters, 2 * NEAR_PAIR * basis.scale)]
    if lost:  # refinement ran into a neighbour of the pair that it started from
        for cluster in lost:
            good += _by_arnoldi(matrix, qr(cluster.vectors, mode="economic")[0], basis.scale)
        values, vectors = _distinct(matrix, good, basis.scale)
    return values, vectors, basis.scale


def _unmatched(values: np.ndarray, clusters: list[Cluster], tolerance: float) -> list[int]:
    """Clusters with an expected pair that no eigenvalue of its own lies near to, clear pairs only."""
    owner = np.repeat(np.arange(len(clusters)), [len(c.expected) for c in clusters])
    expected = np.concatenate([np.zeros(0, complex), *(c.expected for c in clusters)])
    clear = expected.imag > 10 * tolerance
    owner, expected = owner[clear], expected[clear]
    if not len(expected):
        return []
    if not len(values):
        return sorted(set(owner.tolist()))
    # the windows' borders list some pairs twice: one eigenvalue may answer two clusters, but not twice the same
    apart = np.abs(expected[:, None] - values[None, :])
    near = apart < tolerance + 0.05 * expected.imag[:, None]
    lost = set(owner[~near.any(axis=1)].tolist())
    for k in set(owner.tolist()) - lost:
        mine = owner == k
        if len(np.unique(apart[mine].argmin(axis=1))) < mine.sum():
            lost.add(k)
    return sorted(lost)


def _surely_real(B: np.ndarray, error: float) -> bool:
    """True if two real eigenvalues of a subspace are farther from being a pair than its error."""
    values, vectors = np.linalg.eig(B)
    return len(B) == 2 and not np.iscomplexobj(values) and _distance(values, vectors)[0] > error


def _residual(matrix, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R = AX − XB of an orthonormal X, and B = XᵀAX."""
    image = matrix @ X
    B = X.T @ image
    return image - X @ B, B


def _correction(basis: Basis, window: Window, B: np.ndarray, R: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Z in the modes of S with AZ − ZB ≈ R, without a part in the subspace itself (`border`).

    Column by column in the complex Schur form B = QTQᴴ: it exists also where two eigenvalues of B coalesce.
    """
    T, Q = schur(B, output="complex")
    p, m = len(B), len(window.M)
    K = basis.skew[window.inside]  # K_PQ and more; K_QP = −K_PQᵀ
    system, R, Z = np.zeros((m + p, m + p), complex), R @ Q, np.zeros(R.shape, complex)
    system[:m, m:] = border[window.inside]
    system[m:, :m] = border[window.inside].T
    for j in range(p):
        right = R[:, j] + Z[:, :j] @ T[:j, j]
        weight = 1 / _apart(basis.diagonal - T[j, j], basis.scale)
        weight[window.inside] = 0
        outside = right * weight
        right = np.append(right[window.inside] - _real_times(K, outside), np.zeros(p))
        system[:m, :m] = window.M - (T[j, j] - window.centre) * window.N
        own = np.linalg.solve(system, right)[:m]
        Z[:, j] = outside + weight * _real_times(K.T, own)
        Z[window.inside, j] = own
    return (Z @ Q.conj().T).real


def _real_times(K: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Kz of a real single-precision K, without a complex copy of it."""
    product = K @ np.stack([z.real, z.imag], axis=1).astype(K.dtype)
    return product[:, 0] + 1j * product[:, 1]


def _by_arnoldi(matrix, subspace: np.ndarray, scale: float) -> list[np.ndarray]:
    """Planes of all pairs among the eigenvalues nearest to those of a subspace, by shift and invert.

    Raises
    ------
    LinAlgError
        if Arnoldi's method does not converge.
    """
    shift = np.trace(_residual(matrix, subspace)[1]) / subspace.shape[1] + 1e-9 * scale  # off the eigenvalue itself
    solve = factorised(sparse.csr_array(matrix - shift * sparse.eye_array(len(subspace))))
    inverse = LinearOperator(matrix.shape, matvec=solve, dtype=float)
    count = min(subspace.shape[1] + NEIGHBOURS, matrix.shape[0] - 2)
    try:
        values, vectors = eigs(matrix, k=count, sigma=shift, OPinv=inverse, v0=subspace.sum(axis=1))
    except ArpackNoConvergence:
        raise LinAlgError(f"the pair near λ = {shift:.6g} could not be refined: use `spectrum`") from None
    pairs = np.flatnonzero(values.imag > 0.1 * REAL_BELOW * scale)
    return [qr(np.stack([vectors[:, k].real, vectors[:, k].imag], axis=1), mode="economic")[0] for k in pairs]


def _distinct(matrix, subspaces: list[np.ndarray], scale: float):
    """Eigenvalues with Im λ > 0 and eigenvectors within subspaces; one that two of them share is taken once."""
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


def _certificate(matrix, basis: Basis | None, pairs: np.ndarray, zero: int, tell: Report) -> Certificate:
    """Discs of A after similarity passes that shrink its off-diagonal part quadratically."""
    n = matrix.shape[0]
    if not n:
        return Certificate(0, 0, zero, 0, np.empty(0), np.empty(0, int), True)
    if basis is None:
        basis = _basis(matrix, np.float64, _silent)
    centres, radii = _discs(basis.vectors.T @ basis.image, basis.scale, tell)
    real, certain, undecided, loose = 0, [], [], []
    for group in _touching(centres, radii):
        c, r = centres[group], radii[group]
        apart = np.abs(c[:, None] - c) > r[:, None] + r
        np.fill_diagonal(apart, True)
        alone = apart.all(axis=1)
        real += int((alone & (c.imag == 0)).sum())
        certain += [(z, s) for z, s in zip(c[alone], r[alone], strict=True) if z.imag > s]
        rest = ~(alone & ((c.imag == 0) | (np.abs(c.imag) > r)))
        if rest.any():
            undecided.append((c[rest].real.mean(), int(rest.sum())))
            loose += zip(c[rest], r[rest], strict=True)

    def within(z, discs):
        return any(abs(z - c) <= r for c, r in discs)

    met = [sum(abs(z - c) <= r for z in pairs) for c, r in certain]
    consistent = all(k == 1 for k in met) and all(within(z, certain) or within(z, loose) for z in pairs)
    centre = np.array([c for c, _ in undecided])
    return Certificate(n, real, zero, len(certain), centre, np.array([m for _, m in undecided], int), consistent)


def _discs(B: np.ndarray, scale: float, tell: Report, passes: int = 3):
    """Centres and radii of Gershgorin discs of B = D + E after passes (I + W)⁻¹ B (I + W), W_ij = E_ij/(d_j − d_i).

    Modes too close for that keep their coupling; at the end each group of them is diagonalised as a block.
    """
    n = len(B)
    for k in range(passes):
        tell(0.85 + 0.04 * k, f"certificate, similarity pass {k + 1} of {passes}")
        d = np.diag(B).copy()
        W = d - d[:, None]
        W[np.abs(B) >= CLUSTER * np.abs(W)] = np.inf
        np.divide(B, W, out=W)
        B += B @ W
        W[np.diag_indices(n)] += 1.0
        B = lu_solve(lu_factor(W, overwrite_a=True, check_finite=False), B, overwrite_b=True, check_finite=False)
    centres, radii = np.diag(B).astype(complex), np.abs(B).sum(axis=1) - np.abs(np.diag(B))
    groups = [g for g in _touching(centres, radii) if len(g) > 1]
    if groups:
        turned = np.concatenate(groups)
        blocks = [eig(B[np.ix_(g, g)])[1] for g in groups]
        Y = block_diag(*blocks)
        columns = B[:, turned] @ Y
        inverse = block_diag(*[np.linalg.inv(block) for block in blocks])
        others = np.setdiff1d(np.arange(n), turned)
        rows = inverse @ columns[turned]
        centres[turned] = np.diag(rows)
        radii[turned] = np.abs(rows).sum(axis=1) - np.abs(np.diag(rows)) + np.abs(inverse @ B[turned][:, others]).sum(1)
        alone = np.abs(B[np.ix_(others, others)]).sum(axis=1) - np.abs(B[others, others])
        radii[others] = alone + np.abs(columns[others]).sum(axis=1)
    return centres, radii + n * np.finfo(float).eps * scale  # the passes' own round-off


def _touching(centres: np.ndarray, radii: np.ndarray) -> list[np.ndarray]:
    """Groups of discs whose shadows on the real axis overlap."""
    left, right = centres.real - radii, centres.real + radii
    order = np.argsort(left)
    reach = np.maximum.accumulate(right[order])
    return np.split(order, np.flatnonzero(left[order][1:] > reach[:-1]) + 1)
