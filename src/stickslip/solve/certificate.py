"""Certificate of real eigenvalues: Gershgorin discs after similarity passes, in floating point."""

import time
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, eig, lu_factor, lu_solve

from .windows import Basis, Report, symmetric_basis

CLUSTER = 0.3  # |E_ij/(d_j − d_i)| beyond which two modes are left coupled by a similarity pass
WORK = 40.0  # time of a certificate over that of n³ floating-point operations of a matrix product; 38 to 44 measured
CONVERGED = 1e-8  # a pass with W leaves W², which is then below round-off


class Certificate(NamedTuple):
    """Classification of all eigenvalues by Gershgorin discs, in floating-point rather than interval arithmetic."""

    size: int  # eigenvalues examined
    real: int  # alone in a disc with a real centre; real since the spectrum of A is symmetric about the real axis
    zero: int  # exactly zero, from coordinates that nothing resists; not counted in `size`
    pairs: int  # pairs whose disc is isolated and does not touch the real axis
    undecided: np.ndarray  # (k,) centres of overlapping discs [1/time²]
    members: np.ndarray  # (k,) eigenvalues in each
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
    """Estimated time of a certificate for `size` coordinates, from the speed of a matrix product here [s]."""
    some = np.ones((1000, 1000))
    times = []
    for _ in range(2):  # the first product also starts the threads of BLAS
        start = time.perf_counter()
        some @ some
        times.append(time.perf_counter() - start)
    return WORK * min(times) * (size / 1000) ** 3 / 2


def format_seconds(seconds: float) -> str:
    """A duration in words, to one or two digits."""
    return (
        f"{seconds:.2g} s"
        if seconds < 100
        else f"{seconds / 60:.2g} min"
        if seconds < 6000
        else f"{seconds / 3600:.2g} h"
    )


def gershgorin_certificate(matrix, basis: Basis | None, pairs: np.ndarray, zero: int, tell: Report) -> Certificate:
    """Certificate from the discs of A, after similarity passes that reduce its off-diagonal part quadratically."""
    n = matrix.shape[0]
    if not n:
        return Certificate(0, 0, zero, 0, np.empty(0), np.empty(0, int), True)
    if basis is None:
        basis = symmetric_basis(matrix, np.float64, lambda share, message: None)
    centres, radii = _discs(basis.vectors.T @ basis.image, basis.scale, tell)
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


def _discs(B: np.ndarray, scale: float, tell: Report, passes: int = 6):
    """Centres and radii of Gershgorin discs of B = D + E after passes (I + W)⁻¹ B (I + W), W_ij = E_ij/(d_j − d_i).

    Modes that are too close together for a pass keep their coupling. At the end, each group of such modes is
    diagonalised as a block.
    """
    n = len(B)
    for k in range(passes):
        tell(0.85 + 0.02 * k, f"certificate, similarity pass {k + 1} of at most {passes}")
        d = np.diag(B).copy()
        W = d - d[:, None]
        W[np.abs(B) >= CLUSTER * np.abs(W)] = np.inf
        np.divide(B, W, out=W)
        if np.abs(W).max() < CONVERGED:
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
        own = np.diag(rows)
        # in a block with pairs, a real eigenvalue has an imaginary part of round-off size: move its disc back
        centre = np.where(np.concatenate(values).imag == 0, own.real, own)
        radius = np.abs(rows).sum(axis=1) - np.abs(own) + np.abs(inverse @ B[turned][:, others]).sum(1)
        centres[turned], radii[turned] = centre, radius + np.abs(own - centre)
        alone = np.abs(B[np.ix_(others, others)]).sum(axis=1) - np.abs(B[others, others])
        radii[others] = alone + np.abs(columns[others]).sum(axis=1)
    return centres, radii + n * np.finfo(float).eps * scale  # round-off of the passes


def _overlapping_groups(centres: np.ndarray, radii: np.ndarray) -> list[np.ndarray]:
    """Groups of discs whose projections onto the real axis overlap."""
    left, right = centres.real - radii, centres.real + radii
    order = np.argsort(left)
    reach = np.maximum.accumulate(right[order])
    return np.split(order, np.flatnonzero(left[order][1:] > reach[:-1]) + 1)
