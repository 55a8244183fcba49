"""Ways to deform a periodic cell: simple and pure shear, isotropic and uniaxial compression."""

from typing import Literal, NamedTuple

import numpy as np

from ..core.arguments import checked
from ..core.dynamics.cell_motion import strained
from ..core.measure import volume
from ..core.state import State
from ..solve.shear_response import XY
from .packing import shear_strain

Mode = Literal["simple", "pure", "isotropic", "uniaxial"]
MODES = {
    "simple": "simple shear γ along x, with the gradient along y",
    "pure": "pure shear: longer along x and shorter along y, γ = ln(Lx/Ly)",
    "isotropic": "compression on all sides, ε = −ln V",
    "uniaxial": "compression along y between fixed sides, ε = −ln Ly",
}


class Deformation(NamedTuple):
    """Homogeneous deformation of a cell by one strain: x → exp(G ε) x.

    The stress that does work on it is −σ:G, with the stress σ positive in compression: −σ_xy in simple shear,
    (σ_yy − σ_xx)/2 in pure shear, the pressure in isotropic and σ_yy in uniaxial compression.
    """

    mode: Mode
    gradient: np.ndarray  # (3, 3) G, displacement gradient for a small unit strain
    sign: int  # −1 if the strain falls along the path: it is then counted downwards

    def finite(self, strain: float) -> np.ndarray:
        """(3, 3) exp(G ε) − 1; G is nilpotent or diagonal."""
        diagonal = np.diag(self.gradient)
        return strain * (self.gradient - np.diag(diagonal)) + np.diag(np.expm1(strain * diagonal))

    def apply(self, state: State, strain: float, *, slip: bool = True) -> State:
        """State after an affine deformation by a strain, not in equilibrium; see `strained`."""
        return strained(state, self.finite(strain), slip=slip)

    def place(self, state: State) -> float:
        """Strain of the cell, from an origin of its own."""
        across, along = np.abs(state.cell.vectors[: state.cell.dim, :2]).sum(axis=0)
        if self.mode == "simple":
            return self.sign * shear_strain(state)
        if self.mode == "isotropic":
            return -self.sign * float(np.log(volume(state)))
        return self.sign * float(np.log(across / along) if self.mode == "pure" else -np.log(along))


@checked
def deformation(mode: Mode = "simple", dim: Literal[2, 3] = 3, sign: Literal[1, -1] = 1) -> Deformation:
    """Deformation by its name.

    Examples
    --------
    >>> deformation("isotropic", dim=2).finite(0.02)[0, 0].round(6)
    np.float64(-0.00995)
    """
    flat = {"pure": [0.5, -0.5, 0.0], "isotropic": [-1 / dim] * dim + [0.0] * (3 - dim), "uniaxial": [0.0, -1.0, 0.0]}
    return Deformation(mode, sign * (XY if mode == "simple" else np.diag(flat[mode])), sign)


SIMPLE = deformation()
