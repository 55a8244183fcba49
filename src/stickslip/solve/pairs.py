"""All complex pairs of −M⁻¹J for large systems, from coupled modes of the symmetric part, and their certificate.

With A = S + K, candidates come from windows of modes of the symmetric part S, which the skew part K couples. Real
eigenvalues are certified by Gershgorin discs after similarity passes, in floating point.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, block_diag, eig, eigh, lu_factor, lu_solve, qr, schur, svdvals
from scipy.sparse.linalg import ArpackError, LinearOperator, eigs

from ..core.arguments import checked
from ..core.laws.builtin import Law
from ..core.progress import Report, silent
from ..core.readable import readable
from ..core.state import State
from .freedom import Freedom, dynamical_matrix, freedom
from .linear import factorised, one_thread, suitable_threads
from .spectrum import REAL_BELOW

STAGE = "complex pairs"  # name of the stage in progress reports
# numbers of modes treated together, and of neighbours on either side; all other modes enter to second order
WINDOW, HALO = 40, 40
# assumed errors of windows: NEAR_PAIR times the largest |λ|, and MIXED · mixing² times the half-width; the largest
# factors found were 1e-6 (1000 spheres) and 0.1 (150 spheres)
NEAR_PAIR, MIXED = 5e-6, 0.2
# largest first-order fraction of outer modes in a window mode for which second order is trusted; beyond it, a mode may
# extend over several windows, and the estimates of its pair may all be wrong
WEAK = 0.05
TOGETHER = 4  # number of neighbouring windows above WEAK that share a factor
STRONG = 0.2  # fraction of eigenvalues computed for windows above WEAK beyond which LAPACK takes less time
CLUSTER = 0.3  # |E_ij/(d_j − d_i)| above which a similarity pass leaves two modes coupled
WORK = 40.0  # time of a certificate over that of n³ operations in a matrix product; measured values are 38 to 44
SIMILAR = 1e-8  # a pass with W leaves W², which is then below round-off
LARGEST = (
    12_000  # largest number of coordinates: four dense matrices of this size take 3 GB, and the time grows as its cube
)
DENSE_BELOW = 1500  # number of coordinates below which LAPACK takes a few seconds
# residual over the largest |λ|: target, and largest accepted value if round-off prevents the target
CONVERGED, ENOUGH = 2e-15, 1e-12
SAME = 1e-8  # two refined eigenvalues with one eigenvector are the same if closer than this fraction of the largest |λ|
INDEPENDENT = 0.01  # least part of a further eigenvector outside the span of those with the same eigenvalue
NEIGHBOURS = 20  # number of additional eigenvalues that Arnoldi's method computes near those of a subspace


class Basis(NamedTuple):
    """Modes of the symmetric part S of A = S + K, and A in this basis."""

    vectors: np.ndarray  # (n, n), orthonormal to single precision
    image: np.ndarray  # (n, n) A times `vectors`, in double precision
    diagonal: np.ndarray  # (n,) Rayleigh quotients, in double precision [1/time²]
    skew: np.ndarray  # (n, n) K in the basis of the modes, in single precision [1/time²]

    @property
    def scale(self) -> float:
        """Largest |λ| [1/time²], as precise as the thresholds require."""
        return float(np.abs(self.diagonal).max())


class Window(NamedTuple):
    """Reduced problem (N⁻¹M − (λ − centre)) c = 0 of the modes `inside`; others are eliminated to second order."""

    inside: slice
    centre: float
    M: np.ndarray
    N: np.ndarray
    mixing: float  # largest first-order share of outer modes in a mode of the window


class Cluster(NamedTuple):
    """Neighbouring eigenvalues that may contain a pair: a real invariant subspace to be refined."""

    window: Window
    vectors: np.ndarray  # (n, p), orthonormal


def symmetric_basis(matrix, precision, report: Report) -> Basis:
    """Modes of the symmetric part of a sparse matrix, in single or double precision."""
    report(STAGE, 0.0, f"modes of the symmetric part of {matrix.shape[0]} coordinates")
    symmetric = ((matrix + matrix.T) / 2).toarray(order="F").astype(precision, copy=False)
    vectors = eigh(symmetric, driver="evd", overwrite_a=True, check_finite=False)[1]
    report(STAGE, 0.6, "coupling of these modes")
    vectors = np.ascontiguousarray(vectors)  # row-major, as sparse products require
    double = vectors.astype(float, copy=False)
    image = matrix @ double
    diagonal = np.einsum("ij,ij->j", double, image) / np.einsum("ij,ij->j", double, double)
    single = vectors.astype(np.float32, copy=False)
    # VᵀKV of a skew K, from its upper half
    KV = ((matrix - matrix.T) / 2).astype(np.float32) @ single
    n = single.shape[1]
    skew = np.empty((n, n), single.dtype)
    for k in range(0, n, 1024):
        skew[k : k + 1024, k:] = single[:, k : k + 1024].T @ KV[:, k:]
        skew[k + 1024 :, k : k + 1024] = -skew[k : k + 1024, k + 1024 :].T
    return Basis(vectors, image, diagonal, skew)


def build_window(basis: Basis, first: int) -> Window:
    """Window of modes first … first + WINDOW with its halo.

    Outer modes are eliminated to second order and to first order in λ − centre:
    M = H − centre G − K_PQ (D_Q − centre)⁻¹ K_QP, N = G + K_PQ (D_Q − centre)⁻² K_QP, with K_PQ = −K_QPᵀ. The Gram
    matrix G differs from the identity, and the projection H of A from D + K, by the round-off of the modes, which
    would blur pairs at first order.
    """
    n = len(basis.diagonal)
    last = min(n, first + WINDOW) - 1
    inside = slice(max(0, first - HALO), min(n, last + 1 + HALO))
    centre = (basis.diagonal[first] + basis.diagonal[last]) / 2
    x = basis.vectors[:, inside].astype(float, copy=False)
    # two products joined into one, because threads wait for each other at the end of each product
    G, H = np.split(np.hstack([x, basis.image[:, inside]]).T @ x, 2)
    H = H.T - centre * G
    K = -basis.skew[inside].T.astype(float)
    share = K / regularise_gaps(basis.diagonal - centre, basis.scale)[:, None]
    share[inside] = 0
    # the mixing at the end of the window that is nearest to each outer mode
    gaps = np.abs(basis.diagonal - centre)
    nearest = gaps / np.maximum(gaps - gaps[first : last + 1].max(), 1e-12 * basis.scale)
    mixing = float(np.linalg.norm(share * nearest[:, None], axis=0).max())
    second, slope = np.split(np.hstack([K, share]).T @ share, 2)
    return Window(inside, centre, H + second, G - slope, mixing)


def regularise_gaps(gap: np.ndarray, scale: float) -> np.ndarray:
    """Keep gaps away from zero, so that an outer mode at the very centre makes the mixing huge, not infinite."""
    least = 1e-12 * scale
    return np.where(np.abs(gap) < least, least, gap)


class Disc(NamedTuple):
    """Disc of the complex plane in which all pairs are searched for by Arnoldi's method."""

    centre: float  # [1/time²]
    radius: float  # [1/time²]
    count: int  # approximate number of eigenvalues
    start: np.ndarray  # (n,) first vector


def find_candidates(basis: Basis, report: Report) -> tuple[list[Cluster], list[Disc]] | None:
    """Clusters that are or may be pairs, and discs of windows above WEAK; None if K is too strong for windows."""
    report(STAGE, 0.65, "windows")
    clusters, mixed, tallest = [], [], 0.0
    # an eigenvalue near the border of two windows is found in both; duplicates are removed after refinement
    margin = 10 * NEAR_PAIR * basis.scale
    n, sorted_diagonal = len(basis.diagonal), np.sort(basis.diagonal)
    for first in range(0, n, WINDOW):
        window = build_window(basis, first)
        left = sorted_diagonal[first - 1 : first + 1].mean() - margin if first else -np.inf
        end = first + WINDOW
        right = sorted_diagonal[end - 1 : end + 1].mean() + margin if end < n else np.inf
        with one_thread():
            values, vectors = eig(np.linalg.solve(window.N, window.M))
        order = np.argsort(values.real, kind="stable")  # leaves conjugate eigenvalues together
        values, vectors = values[order] + window.centre, vectors[:, order]
        if window.mixing > WEAK:
            mixed.append(first)
            tallest = max(tallest, values.imag.max())
            if len(mixed) * WINDOW > STRONG * n:
                return None
            continue
        near = NEAR_PAIR * basis.scale + MIXED * window.mixing**2 * np.ptp(basis.diagonal[window.inside]) / 2
        for members in _find_suspects(values, vectors, near):
            if left - near <= values[members[-1]].real and values[members[0]].real <= right + near:
                plane = np.hstack([vectors[:, members].real, vectors[:, members].imag])
                small = qr(plane, mode="economic", pivoting=True)[0][:, : len(members)]
                part = basis.vectors[:, window.inside].astype(float, copy=False)
                clusters.append(Cluster(window, qr(part @ small, mode="economic")[0]))
    discs = _discs_of_windows(basis, mixed, margin, 2 * tallest)
    return (clusters, discs) if sum(disc.count for disc in discs) <= STRONG * n else None


def _discs_of_windows(basis: Basis, windows: list[int], margin: float, height: float) -> list[Disc]:
    """Discs that contain all pairs of windows with an Im λ of up to `height`, for up to TOGETHER neighbours each."""
    if not windows:
        return []
    discs, ordered = [], np.sort(basis.diagonal)
    for run in np.split(windows, np.flatnonzero(np.diff(windows) > WINDOW) + 1):
        for part in np.split(run, range(TOGETHER, len(run), TOGETHER)):
            modes = slice(max(0, part[0] - 1), part[-1] + WINDOW + 1)
            left, right = ordered[modes][[0, -1]]
            centre, half = (left + right) / 2, (right - left) / 2 + margin
            radius = np.hypot(half, max(half / 2, height))
            count = int((np.abs(ordered - centre) < radius).sum())
            discs.append(Disc(centre, radius, count, basis.vectors[:, modes].sum(axis=1, dtype=float)))
    return discs


def _find_suspects(values: np.ndarray, vectors: np.ndarray, near: float) -> list[np.ndarray]:
    """Index sets of sorted eigenvalues that form a pair, or are real and about to form one."""
    linked = (values.imag[:-1] != 0) & (values[:-1] == values[1:].conj())
    real = np.flatnonzero(values.imag == 0)
    for first, last in real[np.argwhere(np.triu(pair_margins(values[real].real, vectors[:, real].real) < near, 1))]:
        linked[first:last] = True  # with the eigenvalues between the two
    links = np.flatnonzero(linked)
    chains = np.split(links, np.flatnonzero(np.diff(links) > 1) + 1) if len(links) else []
    return [np.arange(chain[0], chain[-1] + 2) for chain in chains]


def pair_margins(values: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(n, n) additional skew coupling that two real eigenvalues would need to become a pair [1/time²].

    [[δ/2, k], [−k, −δ/2]] has eigenvectors with the cosine c = 2k/δ and a gap δ√(1 − c²), so
    δ/2 − k = gap/2 · √((1 − c)/(1 + c)): a small gap alone does not signal a pair.
    """
    gap = np.abs(values[:, None] - values)
    cosine = np.minimum(np.abs(vectors.T @ vectors), 1.0)
    return gap / 2 * np.sqrt((1 - cosine) / (1 + cosine))


class Certificate(NamedTuple):
    """Classification of all eigenvalues by Gershgorin discs, in floating-point rather than interval arithmetic."""

    size: int  # number of eigenvalues examined
    real: int  # number alone in a disc with a real centre: real, as the spectrum is symmetric about the real axis
    zero: int  # number of exact zeros, from unresisted coordinates; not counted in `size`
    pairs: int  # number of pairs whose disc is isolated and does not touch the real axis
    undecided: np.ndarray  # (k,) centres of groups of overlapping discs [1/time²]
    members: np.ndarray  # (k,) number of eigenvalues in each of these groups
    consistent: bool  # True if every pair found is certified or undecided, and every certified pair was found

    def __str__(self):
        centres = ", ".join(f"{c:.6g} ({m})" for c, m in zip(self.undecided, self.members, strict=True))
        return (
            f"of {self.size} eigenvalues, {self.real} are certified real and {self.pairs} pairs certified complex "
            f"(floating point, not interval arithmetic); {self.zero} more are exactly zero; "
            + (f"undecided around λ = {centres}" if centres else "none is undecided")
            + ("" if self.consistent else "; THE PAIRS FOUND CONTRADICT THIS: use spectrum()")
        )


def certificate_seconds(size: int) -> float:
    """Estimated time of a certificate for `size` coordinates, from the speed of a matrix product measured now [s]."""
    some = np.ones((1000, 1000))
    times = []
    for _ in range(2):  # the first product also starts the threads of BLAS
        start = time.perf_counter()
        some @ some
        times.append(time.perf_counter() - start)
    return WORK * min(times) * (size / 1000) ** 3 / 2


def format_seconds(seconds: float) -> str:
    """Duration in words, to one or two digits."""
    return (
        f"{seconds:.2g} s"
        if seconds < 100
        else f"{seconds / 60:.2g} min"
        if seconds < 6000
        else f"{seconds / 3600:.2g} h"
    )


def gershgorin_certificate(matrix, basis: Basis | None, pairs: np.ndarray, zero: int, report: Report) -> Certificate:
    """Certificate from the discs of A, after similarity passes that reduce its off-diagonal part quadratically."""
    n = matrix.shape[0]
    if not n:
        return Certificate(0, 0, zero, 0, np.empty(0), np.empty(0, int), True)
    if basis is None:
        basis = symmetric_basis(matrix, np.float64, silent)
    centres, radii = _discs(basis.vectors.T @ basis.image, basis.scale, report)
    real, certain, undecided, loose = 0, [], [], []
    for group in _overlapping_groups(centres, radii):
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


def _discs(B: np.ndarray, scale: float, report: Report, passes: int = 6):
    """Centres and radii of Gershgorin discs of B = D + E after passes (I + W)⁻¹ B (I + W), W_ij = E_ij/(d_j − d_i).

    Modes that are too close together for a pass keep their coupling. At the end, each group of such modes is
    diagonalised as a block.
    """
    n = len(B)
    for k in range(passes):
        report(STAGE, 0.85 + 0.02 * k, f"certificate, similarity pass {k + 1} of at most {passes}")
        d = np.diag(B).copy()
        W = d - d[:, None]
        W[np.abs(B) >= CLUSTER * np.abs(W)] = np.inf
        np.divide(B, W, out=W)
        if np.abs(W).max() < SIMILAR:
            break
        B += B @ W
        W[np.diag_indices(n)] += 1.0
        B = lu_solve(lu_factor(W, overwrite_a=True, check_finite=False), B, overwrite_b=True, check_finite=False)
    centres, radii = np.diag(B).astype(complex), np.abs(B).sum(axis=1) - np.abs(np.diag(B))
    groups = [g for g in _overlapping_groups(centres, radii) if len(g) > 1]
    if groups:
        turned = np.concatenate(groups)
        values, blocks = zip(*(eig(B[np.ix_(g, g)]) for g in groups), strict=True)
        Y = block_diag(*blocks)
        columns = B[:, turned] @ Y
        inverse = block_diag(*[np.linalg.inv(block) for block in blocks])
        others = np.setdiff1d(np.arange(n), turned)
        rows = inverse @ columns[turned]
        diagonal = np.diag(rows)
        # in a block with pairs, a real eigenvalue has an imaginary part of round-off size: move its disc to the axis
        centre = np.where(np.concatenate(values).imag == 0, diagonal.real, diagonal)
        radius = np.abs(rows).sum(axis=1) - np.abs(diagonal) + np.abs(inverse @ B[turned][:, others]).sum(1)
        centres[turned], radii[turned] = centre, radius + np.abs(diagonal - centre)
        alone = np.abs(B[np.ix_(others, others)]).sum(axis=1) - np.abs(B[others, others])
        radii[others] = alone + np.abs(columns[others]).sum(axis=1)
    return centres, radii + n * np.finfo(float).eps * scale  # round-off of the passes


def _overlapping_groups(centres: np.ndarray, radii: np.ndarray) -> list[np.ndarray]:
    """Groups of discs whose projections onto the real axis overlap."""
    left, right = centres.real - radii, centres.real + radii
    order = np.argsort(left)
    reach = np.maximum.accumulate(right[order])
    return np.split(order, np.flatnonzero(left[order][1:] > reach[:-1]) + 1)


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
    modes are coupled by K in double precision; modes outside a window enter to second order. Pairs, and eigenvalues
    that may form a pair, are refined as invariant subspaces of A itself and counted if Im λ > 1e-9 of the largest |λ|.
    Windows whose modes mix too much with outer modes are searched by Arnoldi's method. Dense LAPACK is used where there
    are many such windows (sliding contacts) and for small systems.

    Parameters
    ----------
    certificate : whether real eigenvalues are certified by Gershgorin discs; needs double precision and several times
        the run time, an estimate of which is reported first
    report : called as report(stage, share done, text)
    dense_below : number of coordinates below which LAPACK is used

    Raises
    ------
    ValueError, LinAlgError
        If there are no coordinates or more than 12,000; or if a candidate could not be refined.

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
    return find_pairs(freedom(state), partial(dynamical_matrix, state, law), certificate, report, dense_below)


def find_pairs(
    free: Freedom, matrix_of: Callable, certificate: bool, report: Report, dense_below: int = DENSE_BELOW
) -> ComplexPairs:
    """All complex pairs of the matrix A returned by `matrix_of` for the coordinates `free`; see `complex_pairs`."""
    n = len(free)
    if not n:
        raise ValueError("nothing is free to move: pairs need at least one free coordinate")
    if n > LARGEST:
        time = f", and the certificate would take about {format_seconds(certificate_seconds(n))}" if certificate else ""
        raise ValueError(
            f"`complex_pairs` supports at most {LARGEST} coordinates{time}, got {n}: use `fastest_pair` instead"
        )
    if certificate:
        report(STAGE, 0.0, f"certificate of {n} coordinates, estimated time {format_seconds(certificate_seconds(n))}")
    matrix = matrix_of(free)
    # a row of zeros gives a zero eigenvalue, and its coordinate does not move in any other mode
    held = np.flatnonzero(abs(matrix).sum(axis=1))
    matrix = matrix[held][:, held]
    basis, candidates = None, None
    if len(held) >= dense_below:
        basis = symmetric_basis(matrix, np.float64 if certificate else np.float32, report)
        candidates = find_candidates(basis, report)
    if candidates is None:  # small, or K too strong
        report(STAGE, 0.7, "dense eigenvalues")
        with suitable_threads(len(held)):
            values, vectors = eig(matrix.toarray(order="F"), overwrite_a=True)
        scale, upper = float(np.abs(values).max(initial=0.0)), values.imag > 0
        values, vectors = values[upper], vectors[:, upper]
    else:
        values, vectors, scale = _refine(matrix, basis, *candidates, report)
    order = np.argsort(-np.abs(np.sqrt(values).imag))
    order = order[values.imag[order] > REAL_BELOW * scale]
    values, vectors = values[order], vectors[:, order]
    residual = np.linalg.norm(matrix @ vectors - vectors * values, axis=0) / (scale or 1.0)
    certified = gershgorin_certificate(matrix, basis, values, n - len(held), report) if certificate else None
    modes = np.zeros((n, len(values)), complex)
    modes[held] = vectors / np.sqrt(free.mass[held])[:, None]
    report(STAGE, 1.0, f"{len(values)} complex pairs")
    return ComplexPairs(values, modes, residual, free, certified)


def _refine(matrix, basis: Basis, clusters: list[Cluster], discs: list[Disc], report: Report, sweeps: int = 20):
    """Eigenvalues with Im λ > 0 and unit eigenvectors of clusters and discs, without duplicates, and the largest |λ|.

    Every sweep computes the residual R = AX − XB of each invariant subspace X and removes the error in X by applying
    an approximate inverse of A − σ in the modes of S. This takes two large matrix products for all clusters together,
    instead of one sparse factor for each.
    """
    report(STAGE, 0.7, f"Arnoldi's method in {len(discs)} intervals")
    found = [_search_by_arnoldi(matrix, disc, basis.scale) for disc in discs]
    report(STAGE, 0.8, f"refining {len(clusters)} candidates")
    subspaces = [cluster.vectors for cluster in clusters]
    single = np.float32  # a correction needs only a few digits
    V = basis.vectors.astype(single, copy=False)
    # subspaces in the modes of S, which only define the directions excluded from a correction
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
    # refinement fails, or converges to neighbours of the eigenvalues that it started from
    strayed = [
        k for k, cluster in enumerate(clusters)
        if last[k] > ENOUGH or svdvals(cluster.vectors.T @ subspaces[k]).min() < 0.5
    ]  # fmt: skip
    for k in strayed:
        subspaces[k] = _search_by_arnoldi(matrix, _disc_of_subspace(matrix, clusters[k].vectors), basis.scale)
    return *_extract_pairs(matrix, found + subspaces, basis.scale), basis.scale


def _is_certainly_real(B: np.ndarray, error: float) -> bool:
    """Return True if the two real eigenvalues of a subspace are farther from being a pair than its error allows."""
    values, vectors = np.linalg.eig(B)
    return len(B) == 2 and not np.iscomplexobj(values) and pair_margins(values, vectors)[0, 1] > error


def _subspace_residual(matrix, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R = AX − XB of an orthonormal X, and B = XᵀAX."""
    image = matrix @ X
    B = X.T @ image
    return image - X @ B, B


def _subspace_correction(basis: Basis, window: Window, B: np.ndarray, R: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Correction Z with AZ − ZB ≈ R, in the basis of the modes of S, without a component in the subspace itself.

    `border` contains the subspace in the basis of the modes of the window.

    Columns are solved one by one in the complex Schur form B = QTQᴴ, which also exists if eigenvalues of B coalesce.
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


def _disc_of_subspace(matrix, subspace: np.ndarray) -> Disc:
    """Disc around the eigenvalues that a subspace approximates."""
    residual, B = _subspace_residual(matrix, subspace)
    centre = np.trace(B) / len(B)
    radius = np.abs(np.linalg.eigvals(B) - centre).max() + np.linalg.norm(residual)
    return Disc(centre, radius, len(B) + NEIGHBOURS, subspace.sum(axis=1))


def _search_by_arnoldi(matrix, disc: Disc, scale: float) -> np.ndarray:
    """Real invariant subspace of all eigenvalues in a disc, and of some others near it, by shift and invert.

    Raises
    ------
    LinAlgError
        If Arnoldi's method does not converge.
    """
    shift = disc.centre + 1e-9 * scale  # not equal to an eigenvalue
    shifted = sparse.csr_array(matrix - shift * sparse.eye_array(matrix.shape[0]))
    solve = factorised(shifted)
    inverse = LinearOperator(matrix.shape, matvec=solve, dtype=float)
    count = disc.count + 5
    while True:
        if count > matrix.shape[0] - 2:
            return np.eye(matrix.shape[0])
        try:
            values, vectors = eigs(matrix, k=count, sigma=shift, OPinv=inverse, v0=disc.start)
        except ArpackError:
            raise LinAlgError(f"the pairs near λ = {shift:.6g} could not be found: use `spectrum`") from None
        reached = np.abs(values - disc.centre).max()
        if reached > disc.radius:
            break
        # eigenvalues are about equally dense along the real axis
        count = int(count * max(1.1, 1.1 * disc.radius / reached))
    subspace = qr(np.hstack([vectors[:, values.imag >= 0].real, vectors[:, values.imag > 0].imag]), mode="economic")[0]
    # one step of inverse iteration of Schur vectors removes the round-off in modes far from the disc
    T, Z = schur(_subspace_residual(matrix, subspace)[1])
    right, better = subspace @ Z, np.zeros_like(subspace)
    for _ in range(2):  # the factor has lost some digits to pivots near the diagonal
        better += np.stack([solve(x) for x in (right - shifted @ better).T], axis=1)
    return qr(better @ (T - shift * np.eye(len(T))), mode="economic")[0]


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
            same = [w for v, w in zip(values, vectors, strict=True) if abs(theta[k] - v) < SAME * scale]
            known = qr(np.array(same).T, mode="economic")[0] if same else np.zeros((len(x), 0))
            if np.linalg.norm(x - known @ (known.conj().T @ x)) > INDEPENDENT:
                values.append(theta[k])
                vectors.append(x)
    return np.array(values, complex), np.array(vectors, complex).reshape(-1, matrix.shape[0]).T
