"""Eigenvalues of A nearest to a shift, by block Krylov subspaces of (A − σ)⁻¹."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, eig

from .frontal import Dissection, FrontalFactor
from .linear import one_thread
from .spectrum import REAL_BELOW

BLOCK = 8  # vectors that are solved for together; multiplicities up to it are resolved
# vectors of the subspace at the bottom of the spectrum; of a window; of a second attempt if that is too narrow
BOTTOM, SUBSPACES = 560, (160, 480)
CONVERGED = 1e-12  # residual over ‖A‖ of eigenvalues that count as computed


class ShiftWindow(NamedTuple):
    """Eigenvalues of A nearest to a shift."""

    shift: complex  # real, unless a pair far from the real axis is expected [1/time²]
    radius: float  # all eigenvalues within it were computed, provided that the iteration missed none [1/time²]
    expected: float  # growth rate suggested by the leapfrog; 0 for the window at the bottom [1/time]
    growing: np.ndarray  # complex eigenvalues with Im λ > 0, and negative real ones; empty if there are none [1/time²]


class ShiftWindows:
    """Shift-invert windows computed so far, and the fastest growing eigenvalue in them."""

    def __init__(self, matrix, norm: float, order: Dissection, rng):
        self.matrix, self.norm, self.order, self.rng = matrix, norm, order, rng
        self.done: list[ShiftWindow] = []
        self.growth, self.residual, self.value, self.vector = 0.0, 0.0, None, None

    def covered(self, value: complex) -> bool:
        """Return True if a window would have contained an eigenvalue at this value."""
        return any(abs(value - w.shift) < 0.9 * w.radius for w in self.done)

    def search(self, shift: complex, expected: float, reach: float, subspaces=SUBSPACES) -> np.ndarray:
        """Compute and return the eigenvalues nearest to a shift, within `reach` if the subspaces suffice."""
        identity = sparse.eye_array(self.matrix.shape[0], format="csr")
        try:
            solve = FrontalFactor(self.matrix - shift * identity, self.order).solve
        except LinAlgError:  # the shift is an eigenvalue
            shift += 1e-7 * self.norm
            solve = FrontalFactor(self.matrix - shift * identity, self.order).solve
        for size in subspaces:
            values, vectors, radius = self._nearest(solve, shift, size)
            if radius > reach:
                break
        real = np.abs(values.imag) <= REAL_BELOW * self.norm
        values = np.where(real, values.real, values)
        growing = np.flatnonzero(np.where(real, values.real < -REAL_BELOW * self.norm, values.imag > 0))
        self.done.append(ShiftWindow(shift, radius, expected, values[growing]))
        for k in growing[np.argsort(-np.abs(np.sqrt(values[growing].astype(complex)).imag))]:
            if abs(np.sqrt(complex(values[k])).imag) <= self.growth:
                break
            if self._refine(vectors[0] @ vectors[1][:, k]):
                break
        return values

    def _nearest(self, solve, shift: complex, size: int):
        """Converged eigenvalues, the factors of their eigenvectors, and the radius within which all have converged."""
        n, size = self.matrix.shape[0], -(-size // BLOCK) * BLOCK
        if 2 * size >= n:  # a subspace of most of the space: all eigenvalues at once
            with one_thread():
                values, vectors = eig(self.matrix.toarray())
            return values, (np.eye(n), vectors), np.inf
        basis, H, last = block_arnoldi(solve, n, size, self.rng, type(shift))
        mu, y = eig(H)
        error = np.linalg.norm(last @ y[-BLOCK:], axis=0) / np.abs(mu) ** 2
        values = shift + 1 / mu
        distance = np.abs(values - shift)
        radius = float(distance[error > CONVERGED * self.norm].min(initial=np.inf))
        inside = distance < radius
        return values[inside], (basis, y[:, inside]), radius

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


def block_arnoldi(apply, n: int, size: int, rng, kind=float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Orthonormal basis V (n, size), H = VᴴBV, and the last coupling R of a linear map B: BV = VH + Q R Eᵀ.

    Blocks start from random vectors, and are orthogonalised twice against all others.
    """
    V, H = np.empty((n, size), kind, order="F"), np.zeros((size, size), kind)
    V[:, :BLOCK] = np.linalg.qr(rng.standard_normal((n, BLOCK)))[0]
    for k in range(0, size, BLOCK):
        known, own = V[:, : k + BLOCK], slice(k, k + BLOCK)
        adjoint, image = known.T if kind is float else known.conj().T, apply(V[:, own])
        H[: k + BLOCK, own] = adjoint @ image
        q, r = np.linalg.qr(image - known @ H[: k + BLOCK, own])
        # also if the subspace is exhausted, and q is what round-off makes of it
        again = adjoint @ q
        H[: k + BLOCK, own] += again @ r
        q, r_again = np.linalg.qr(q - known @ again)
        r = r_again @ r
        if k + BLOCK < size:
            H[k + BLOCK : k + 2 * BLOCK, own], V[:, k + BLOCK : k + 2 * BLOCK] = r, q
    return V, H, r
