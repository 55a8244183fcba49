"""Shear and normal stress on a straight fault due to its own slip, in a homogeneous elastic body.

The fault is divided into N cells of length h and uniform slip. Stress at the centres of the cells is a discrete
convolution, evaluated with transforms from `scipy.fft` in O(N log N) operations; `stress_matrix` returns the same as a
dense matrix, which is a sum of a Toeplitz and, with a free surface, a Hankel matrix.

A cell of slip δ between z₁ and z₂ adds τ(z) = (G*/2π) [1/(z − z₂) − 1/(z − z₁)] δ, with G* = G for antiplane and
G/(1 − ν) for in-plane shear (P. Segall, Earthquake and Volcano Deformation, 2010, sections 2.1 and 3.2).

What a free surface adds for in-plane shear depends on two distances down dip, ξ of the cell that is stressed and ξ' of
the one that slips, and is smooth in ξ but for ξ = ξ' = 0. Between ξ and 2ξ it is a polynomial in ξ within round-off.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander
from scipy import fft, sparse

from .half_space import half_space_stress

BOUNDARIES = ("surface", "infinite", "periodic")


class StressTransfer(NamedTuple):
    """Linear map from slip to shear stress, for N cells."""

    boundary: str  # "surface", "infinite" or "periodic"
    number: int  # N
    symbol: np.ndarray  # real eigenvalues of the convolution [stress/length]
    image: tuple | None = None  # of in-plane slip below a free surface, see `_image`
    sense: int = 1  # −1 for slip of a normal fault

    def __call__(self, slip: np.ndarray) -> np.ndarray:
        """Shear stress (N,) due to slip (N,)."""
        return self.tractions(slip)[0]

    def tractions(self, slip: np.ndarray) -> tuple[np.ndarray, np.ndarray | float]:
        """Shear stress and normal stress (N,) due to slip (N,); compression is positive, zero without an image."""
        shear = self._convolved(slip)
        if self.image is None:
            return shear, 0.0
        spread, table = self.image
        sheared, clamped = (table @ slip).reshape(2, -1)
        return shear + spread @ sheared, self.sense * (spread @ clamped)

    def _convolved(self, slip: np.ndarray) -> np.ndarray:
        n = self.number
        if self.boundary == "surface":  # even about the surface, and zero below the fault
            waves = fft.dct(slip, 2, n=2 * n)
            waves *= self.symbol
            return fft.idct(waves, 2, overwrite_x=True)[:n]
        length = n if self.boundary == "periodic" else 2 * n
        waves = fft.rfft(slip, length)
        waves *= self.symbol
        return fft.irfft(waves, length, overwrite_x=True)[:n]


def stress_transfer(
    number: int, cell: float, modulus: float, boundary: str, thickness: float = np.inf, *, dip: float | None = None,
    sense: int = 1,
) -> StressTransfer:  # fmt: skip
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
    dip : for in-plane slip below a free surface; with `boundary` "infinite" [degrees]
    sense : 1 if positive slip is that of a thrust, −1 if it is that of a normal fault
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
    image = None if dip is None else _image(number, cell, modulus, dip)
    return StressTransfer(boundary, number, symbol[: 2 * number] if boundary == "surface" else symbol, image, sense)


def image_nodes(number: int, dip: float) -> int:
    """Number of places down dip, at most, from which the effect of the surface is interpolated to N cells."""
    order = min(_order(dip), number)
    return min(number, order * (2 + max(0, int(np.ceil(np.log2(number / (2 * order)))))))


def _order(dip: float) -> int:
    """Number of Chebyshev nodes between ξ and 2ξ with which the error ρ^−n is round-off.

    ρ belongs to the ellipse about the interval through the nearest singularity, at ξ' e^{2iψ}.
    """
    poles = 2 * np.geomspace(0.2, 5.0, 200) * np.exp(2j * np.radians(dip)) - 3  # the interval is mapped to −1 to 1
    growth = np.log(np.abs(poles + np.sqrt(poles - 1) * np.sqrt(poles + 1)).min())
    return int(np.ceil(np.log(1e16) / max(growth, 1e-3))) + 2


@lru_cache(maxsize=4)
def _image(number: int, cell: float, modulus: float, dip: float) -> tuple[sparse.csr_array, np.ndarray]:
    """Interpolation from R nodes to the cells (N, R), and shear and normal stress at the nodes due to slip (2R, N).

    Between ξ and 2ξ the nodes are those of Chebyshev; near the surface they are the cells.
    """
    t, places, order = np.exp(1j * np.radians(dip)), np.arange(number) + 0.5, _order(dip)
    nodes, blocks, high = [], [], number
    while high > 2 * order:
        here = places[high // 2 : high]
        middle, half = 0.5 * (here[0] + here[-1]), 0.5 * (here[-1] - here[0])
        points = chebpts1(order)
        basis = np.linalg.solve(chebvander(points, order - 1).T, chebvander((here - middle) / half, order - 1).T)
        nodes, blocks, high = [middle + half * points, *nodes], [basis.T, *blocks], high // 2
    at = np.concatenate([places[:high], *nodes])
    mean, deviator = half_space_stress(at * t * cell, np.arange(number + 1) * cell, dip, image=True)
    stress = modulus * (mean + t**2 * deviator)
    spread = sparse.csr_array(sparse.block_diag([sparse.eye_array(high), *blocks]))
    return spread, np.concatenate([stress.imag, -stress.real])


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
