"""Shear stress on a straight fault due to its own slip, in a homogeneous elastic body.

The fault is divided into N cells of length h and uniform slip. Stress at the centres of the cells is a discrete
convolution, evaluated with transforms from `scipy.fft` in O(N log N) operations; `stress_matrix` returns the same as a
dense matrix, which is a sum of a Toeplitz and, with a free surface, a Hankel matrix.

A cell of slip δ between z₁ and z₂ adds τ(z) = (G*/2π) [1/(z − z₂) − 1/(z − z₁)] δ, with G* = G for antiplane and
G/(1 − ν) for in-plane shear (P. Segall, Earthquake and Volcano Deformation, 2010, sections 2.1 and 3.2).
"""

from typing import NamedTuple

import numpy as np
from scipy import fft

BOUNDARIES = ("surface", "infinite", "periodic")


class StressTransfer(NamedTuple):
    """Linear map from slip to shear stress, for N cells."""

    boundary: str  # "surface", "infinite" or "periodic"
    number: int  # N
    symbol: np.ndarray  # real eigenvalues of the convolution [stress/length]

    def __call__(self, slip: np.ndarray) -> np.ndarray:
        """Shear stress (N,) due to slip (N,)."""
        n = self.number
        if self.boundary == "surface":  # even about the surface, and zero below the fault
            waves = fft.dct(slip, 2, n=2 * n)
            waves *= self.symbol
            return fft.idct(waves, 2, overwrite_x=True)[:n]
        length = n if self.boundary == "periodic" else 2 * n
        waves = fft.rfft(slip, length)
        waves *= self.symbol
        return fft.irfft(waves, length, overwrite_x=True)[:n]


def stress_transfer(number: int, cell: float, modulus: float, boundary: str, thickness: float = np.inf):
    """Return the StressTransfer of a fault.

    Parameters
    ----------
    number : N
    cell : h [length]
    modulus : G* [stress]
    boundary : "surface": from a free surface downwards; "infinite": a segment in an infinite body; "periodic": period
        N h, for which slip e^{ikz} gives the stress −(G*/2) |k| coth(|k| W) e^{ikz} between plates of thickness W whose
        far sides do not move
    thickness : W of each plate, for a periodic fault [length]
    """
    if boundary == "periodic":
        k = 2 * np.pi * np.arange(number // 2 + 1) / (number * cell)
        rest = np.divide(1.0, thickness)  # limit of k coth(kW) for k → 0
        with np.errstate(invalid="ignore"):
            symbol = np.where(k > 0, k / np.tanh(np.where(k > 0, k * thickness, 1.0)), rest)
        return StressTransfer(boundary, number, -0.5 * modulus * symbol)
    period = (4 if boundary == "surface" else 2) * number
    lag = np.minimum(np.arange(period), period - np.arange(period))
    symbol = fft.rfft(_influence(lag, cell, modulus)).real
    return StressTransfer(boundary, number, symbol[: 2 * number] if boundary == "surface" else symbol)


def _influence(lag, cell: float, modulus: float):
    """Stress at a cell due to unit slip of the cell that is `lag` cells away."""
    return modulus / (2 * np.pi * cell) / (np.asarray(lag, float) ** 2 - 0.25)


def stress_matrix(number: int, cell: float, modulus: float, boundary: str) -> np.ndarray:
    """Dense matrix (N, N) of the stress due to slip; boundary "surface" or "infinite".

    Examples
    --------
    >>> stress = stress_matrix(4, 1.0, 1.0, "infinite")
    >>> print(np.round(np.pi * stress[0], 4))
    [-2.      0.6667  0.1333  0.0571]
    """
    i = np.arange(number)
    out = _influence(i[:, None] - i, cell, modulus)
    if boundary == "surface":
        out = out + _influence(i[:, None] + i + 1, cell, modulus)  # images above the surface
    return out
