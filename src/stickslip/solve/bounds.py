"""Voigt and Reuss bounds of the elastic moduli of a packing."""

from typing import NamedTuple

import numpy as np

from ..core.arguments import checked
from ..core.contacts.jacobian import cross_matrix, linearise
from ..core.contacts.tangent import column, outer
from ..core.laws.builtin import Law
from ..core.measure import volume
from ..core.readable import readable
from ..core.state import State
from .freedom import assembled, incidence
from .moduli import VOIGT, elastic_moduli, solve_resisted, voigt, with_free_cell


@readable
class ModuliBounds(NamedTuple):
    """Elastic moduli between their bounds, in the order and with the strains of `ElasticModuli.voigt`.

    C − C_Reuss and C_Voigt − C have no negative eigenvalue, up to terms of the order of the stress: in small packings
    under a stress of 0.03 to 0.1 of C, eigenvalues of −0.01 to −0.2 of C occur.
    """

    reuss: np.ndarray  # (3, 3) or (6, 6) lower bound [force/length^(dim−1)]
    tensor: np.ndarray  # (3, 3) or (6, 6) C
    voigt: np.ndarray  # (3, 3) or (6, 6) upper bound: affine motion

    @property
    def bulk(self) -> tuple[float, float, float]:
        """K of the three."""
        return tuple(_bulk_and_shear(c)[0] for c in self)

    @property
    def shear(self) -> tuple[float, float, float]:
        """G of the three."""
        return tuple(_bulk_and_shear(c)[1] for c in self)


def _bulk_and_shear(c: np.ndarray) -> tuple[float, float]:
    d = 2 if len(c) == 3 else 3
    whole, trace = c[:d, :d].sum(), np.trace(c[:d, :d]) + 2 * np.trace(c[d:, d:])
    return float(whole) / d**2, float(trace - whole / d) / ((d - 1) * (d + 2))


@checked
def moduli_bounds(state: State, law: Law) -> ModuliBounds:
    """Elastic moduli and their bounds: Voigt by affine motion, Reuss by smooth contact forces under a uniform stress.

    Voigt: all grains move with the cell and do not rotate; the elastic energy of any motion is not below the true one.
    Reuss: contact forces that balance on each grain, torques included, and add up to the stress; the complementary
    energy of any such forces is not below the true one. Taken are those with the smallest Σ|f|², which the packing
    would bear if all its contacts were equally stiff along and across. Both are theorems for forces that have a
    potential: they hold for packings without sliding contacts, up to terms of the order of stress over stiffness.

    Raises
    ------
    ValueError
        as `elastic_moduli`, or if no forces balance under some stress.

    Source
    ------
    Agnolin & Roux, doi:10.48550/arXiv.0705.3198, for Voigt and Reuss bounds of packings of spheres.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(30, packing_fraction=0.68, seed=1)
    >>> low, exact, high = moduli_bounds(state, law).shear
    >>> low < exact < high
    True
    """
    moduli = elastic_moduli(state, law)
    state, _, free, grain, cell = with_free_cell(state, law)
    line, dim = linearise(state, law), state.cell.dim
    nn, lateral = outer(line.normal, line.normal), line.closed * (line.along > 0)
    stiff = column(line.closed) * nn + column(lateral) * (np.eye(3) - nn)
    reach = np.concatenate([np.broadcast_to(np.eye(3), nn.shape), cross_matrix(line.normal)], axis=2)
    matrix = assembled(state, -reach.transpose(0, 2, 1) @ stiff @ reach, free)
    motion = np.eye(len(free))[:, cell]
    motion[grain] = solve_resisted(matrix[grain][:, grain], matrix[grain][:, cell].toarray(), free)
    moved = (incidence(state, len(nn), free).T @ motion).reshape(len(nn), 6, dim, dim) * free.length
    forces = np.stack([np.einsum("cij,cj->ci", stiff @ reach, moved[..., a, b] + moved[..., b, a]) / 2
                       for a, b in VOIGT[dim]], axis=2)  # fmt: skip
    forces = forces @ _inverse(np.einsum("cia,cib->ab", forces, forces)) * volume(state)
    soft = [np.divide(1, k, out=np.zeros_like(k), where=k > 0) for k in (line.slope_n, line.along)]
    compliance = column(soft[0]) * nn + column(soft[1]) * (np.eye(3) - nn)
    lower = _inverse(np.einsum("cia,cij,cjb->ab", forces, compliance, forces) / volume(state))
    return ModuliBounds(lower, moduli.voigt, voigt(moduli.affine))


def _inverse(matrix: np.ndarray) -> np.ndarray:
    if not np.linalg.cond(matrix) < 1e12:
        raise ValueError("no contact forces balance under some stress: bounds of moduli need a packing that bears any")
    return np.linalg.inv(matrix)
