"""Candidate complex pairs of A = S + K, from windows of modes of S that are coupled by the skew part K."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import eig, eigh, qr

from ..core.progress import Report
from .linear import one_thread

STAGE = "complex pairs"  # of progress
# modes treated together, and neighbours on either side; all others enter to second order
WINDOW, HALO = 40, 40
# assumed errors of windows: NEAR_PAIR of the largest |λ|, and MIXED mixing² of the half width; the largest errors seen
# were 1e-6 (1000 spheres) and 0.1 (150 spheres)
NEAR_PAIR, MIXED = 5e-6, 0.2
WEAK = 0.3  # largest first-order share of outer modes in a mode of a window for which second order is trusted


class Basis(NamedTuple):
    """Modes of the symmetric part S of A = S + K, and A in this basis."""

    vectors: np.ndarray  # (n, n), orthonormal to single precision
    image: np.ndarray  # (n, n) A times them, in double precision
    diagonal: np.ndarray  # (n,) Rayleigh quotients, in double precision [1/time²]
    skew: np.ndarray  # (n, n) single precision: K between the modes [1/time²]

    @property
    def scale(self) -> float:
        """Largest |λ| [1/time²], as precise as the thresholds require."""
        return float(np.abs(self.diagonal).max())


class Window(NamedTuple):
    """Reduced problem of the modes `inside`, with others eliminated to second order: (N⁻¹M − (λ − centre)) c = 0."""

    inside: slice
    centre: float
    M: np.ndarray
    N: np.ndarray
    mixing: float  # largest first-order share of outer modes in a mode of the window


class Cluster(NamedTuple):
    """Neighbouring eigenvalues that may hold a pair: a real invariant subspace to be refined."""

    window: Window
    vectors: np.ndarray  # (n, p)
    expected: np.ndarray  # its complex eigenvalues with Im λ > 0 according to the window [1/time²]


def symmetric_basis(matrix, precision, report: Report) -> Basis:
    """Modes of the symmetric part of a sparse matrix, in single or double precision."""
    report(STAGE, 0.0, f"modes of the symmetric part of {matrix.shape[0]} coordinates")
    symmetric = ((matrix + matrix.T) / 2).toarray(order="F").astype(precision, copy=False)
    vectors = eigh(symmetric, driver="evd", overwrite_a=True, check_finite=False)[1]
    report(STAGE, 0.6, "coupling of these modes")
    vectors = np.ascontiguousarray(vectors)  # row-major, as sparse products need it
    double = vectors.astype(float, copy=False)
    image = matrix @ double
    diagonal = np.einsum("ij,ij->j", double, image) / np.einsum("ij,ij->j", double, double)
    single = vectors.astype(np.float32, copy=False)
    skew = _skew_product(single, ((matrix - matrix.T) / 2).astype(np.float32) @ single)
    return Basis(vectors, image, diagonal, skew)


def _skew_product(V: np.ndarray, KV: np.ndarray, block: int = 1024) -> np.ndarray:
    """VᵀKV of a skew K, from its upper half."""
    n = V.shape[1]
    out = np.empty((n, n), V.dtype)
    for k in range(0, n, block):
        out[k : k + block, k:] = V[:, k : k + block].T @ KV[:, k:]
        out[k + block :, k : k + block] = -out[k : k + block, k + block :].T
    return out


def build_window(basis: Basis, first: int) -> Window:
    """Window of modes first … first + WINDOW with its halo.

    Outer modes are eliminated to second order and to first order in λ − centre:
    M = H − centre G − K_PQ (D_Q − centre)⁻¹ K_QP, N = G + K_PQ (D_Q − centre)⁻² K_QP, with K_PQ = −K_QPᵀ. G differs
    from the identity, and H from D + K, by the round-off of the modes, which would blur pairs at first order.
    """
    n = len(basis.diagonal)
    last = min(n, first + WINDOW) - 1
    inside = slice(max(0, first - HALO), min(n, last + 1 + HALO))
    centre = (basis.diagonal[first] + basis.diagonal[last]) / 2
    x = basis.vectors[:, inside].astype(float, copy=False)
    # joined products: each product is split over threads, which wait for each other at its end
    G, H = np.split(np.hstack([x, basis.image[:, inside]]).T @ x, 2)
    H = H.T - centre * G
    K = -basis.skew[inside].T.astype(float)
    share = K / regularise_gaps(basis.diagonal - centre, basis.scale)[:, None]
    share[inside] = 0
    mixing = float(np.linalg.norm(share, axis=0).max())
    second, slope = np.split(np.hstack([K, share]).T @ share, 2)
    return Window(inside, centre, H + second, G - slope, mixing)


def regularise_gaps(gap: np.ndarray, scale: float) -> np.ndarray:
    """Keep gaps away from zero, so that an outer mode at the very centre makes the mixing huge, not infinite."""
    least = 1e-12 * scale
    return np.where(np.abs(gap) < least, least, gap)


def find_candidates(basis: Basis, report: Report) -> list[Cluster] | None:
    """Clusters that are or may be pairs; None if K is too strong for windows."""
    report(STAGE, 0.65, "windows")
    clusters = []
    # an eigenvalue near the border of two windows is taken by both; duplicates are removed after refinement
    margin = 10 * NEAR_PAIR * basis.scale
    n, sorted_diagonal = len(basis.diagonal), np.sort(basis.diagonal)
    for first in range(0, n, WINDOW):
        window = build_window(basis, first)
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
        for members in _find_suspects(values, vectors, near):
            if left <= values[members].real.mean() <= right:
                plane = np.hstack([vectors[:, members].real, vectors[:, members].imag])
                small = qr(plane, mode="economic", pivoting=True)[0][:, : len(members)]
                part = basis.vectors[:, window.inside]
                mine = values[members]
                clusters.append(Cluster(window, part.astype(float, copy=False) @ small, mine[mine.imag > 0]))
    return clusters


def _find_suspects(values: np.ndarray, vectors: np.ndarray, near: float) -> list[np.ndarray]:
    """Index sets of sorted eigenvalues that form a pair, or are real and about to form one."""
    real = (values.imag[:-1] == 0) & (values.imag[1:] == 0)
    conjugate = (values.imag[:-1] != 0) & (values[:-1] == values[1:].conj())
    links = np.flatnonzero(conjugate | (real & (pair_margin(values, vectors) < near)))
    chains = np.split(links, np.flatnonzero(np.diff(links) > 1) + 1) if len(links) else []
    return [np.arange(chain[0], chain[-1] + 2) for chain in chains]


def pair_margin(values: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(n − 1,) additional skew coupling that neighbouring real eigenvalues would need to become a pair [1/time²].

    [[δ/2, k], [−k, −δ/2]] has eigenvectors with the cosine c = 2k/δ and a gap δ√(1 − c²), so that
    δ/2 − k = gap/2 · √((1 − c)/(1 + c)): a small gap alone does not signal a pair.
    """
    gap = np.abs(np.diff(values))
    cosine = np.minimum(np.abs(np.einsum("ij,ij->j", vectors[:, :-1].conj(), vectors[:, 1:])), 1.0)
    return gap / 2 * np.sqrt((1 - cosine) / (1 + cosine))
