"""Eigenvalues of A nearest to a shift, by block Krylov subspaces of (A − σ)⁻¹."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, eig

from .frontal import Dissection, FrontalFactor
from .linear import suitable_threads
from .spectrum import REAL_BELOW

BLOCK = 8  # vectors that are solved for together; multiplicities up to it are resolved
# vectors of the subspace at the bottom of the spectrum; of other windows, and of those that turn out too narrow
BOTTOM, SUBSPACES = 560, (240, 560)
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
        # values, and their uncertainties, for which a window was made that is too narrow to contain them
        self.narrow: list[tuple[complex, float]] = []
        self.growth, self.residual, self.value, self.vector = 0.0, 0.0, None, None

    def covers(self, value: complex) -> bool:
        """Return True if a window would have contained an eigenvalue at this value, or was made for it in vain."""
        discs = [(w.shift, 0.9 * w.radius) for w in self.done] + self.narrow
        return any(abs(value - centre) < radius for centre, radius in discs)

    def search(self, shift: complex, expected: float, reach: float, subspaces=SUBSPACES) -> np.ndarray:
        """Compute and return the eigenvalues nearest to a shift, within `reach` if the subspaces suffice."""
        n = self.matrix.shape[0]
        if 2 * subspaces[0] >= n:
            return self._keep(shift, expected, *self._all_eigenvalues())
        identity = sparse.eye_array(n, format="csr")
        try:
            solve = FrontalFactor(self.matrix - shift * identity, self.order).solve
        except LinAlgError:  # the shift is an eigenvalue
            shift += 1e-7 * self.norm
            solve = FrontalFactor(self.matrix - shift * identity, self.order).solve
        subspace = KrylovSubspace(solve, n, self.rng, type(shift))
        for size in subspaces:
            values, vectors, radius = self._nearest(subspace, shift, size)
            if radius > reach:
                break
        return self._keep(shift, expected, values, vectors, radius)

    def _keep(self, shift, expected: float, values: np.ndarray, vectors, radius: float) -> np.ndarray:
        """Store a window, and its fastest growing eigenvalue if it is faster than those of all others."""
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

    def _nearest(self, subspace: "KrylovSubspace", shift: complex, size: int):
        """Converged eigenvalues, the factors of their eigenvectors, and the radius within which all have converged."""
        n = self.matrix.shape[0]
        if 2 * size >= n:  # a subspace of most of the space: all eigenvalues at once
            return self._all_eigenvalues()
        basis, H, last = subspace.extended(size)
        mu, y = eig(H)
        error = np.linalg.norm(last @ y[-BLOCK:], axis=0) / np.abs(mu) ** 2
        values = shift + 1 / mu
        distance = np.abs(values - shift)
        radius = float(distance[error > CONVERGED * self.norm].min(initial=np.inf))
        inside = distance < radius
        return values[inside], (basis, y[:, inside]), radius

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
    """Block Krylov subspace of a linear map B, from random vectors: BV = VH + QREᵀ with an orthonormal basis V.

    Every block is orthogonalised twice against all others.
    """

    def __init__(self, apply, n: int, rng, kind=float):
        self.apply = apply
        self.next = np.linalg.qr(rng.standard_normal((n, BLOCK)))[0].astype(kind)
        self.basis, self.projection = np.empty((n, 0), kind, order="F"), np.zeros((0, 0), kind)
        self.last = np.zeros((BLOCK, BLOCK), kind)

    def extended(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """V (n, size), H = VᴴBV and R, with a size rounded up to whole blocks."""
        old, size = self.basis.shape[1], -(-size // BLOCK) * BLOCK
        V, H = np.empty((len(self.next), size), self.next.dtype, order="F"), np.zeros((size, size), self.next.dtype)
        V[:, :old], H[:old, :old] = self.basis, self.projection
        for k in range(old, size, BLOCK):
            own = slice(k, k + BLOCK)
            V[:, own] = self.next
            if k:
                H[own, k - BLOCK : k] = self.last
            known = V[:, : k + BLOCK]
            adjoint, image = known.conj().T, self.apply(self.next)
            H[: k + BLOCK, own] = adjoint @ image
            q, r = np.linalg.qr(image - known @ H[: k + BLOCK, own])
            # also if the subspace is exhausted, and q is what round-off makes of it
            again = adjoint @ q
            H[: k + BLOCK, own] += again @ r
            self.next, r_again = np.linalg.qr(q - known @ again)
            self.last = r_again @ r
        self.basis, self.projection = V, H
        return V, H, self.last
