"""Elastic moduli of a packing with friction, by the response of the stress to a small strain, and their bounds."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError

from ..core.arguments import checked, knows_bonds
from ..core.contacts.jacobian import cross_matrix, linearise
from ..core.contacts.tangent import column, outer
from ..core.laws.builtin import Law
from ..core.measure import stress, volume
from ..core.readable import readable
from ..core.state import State
from .freedom import Freedom, assembled, backbone, incidence, jacobian
from .linear import factorised

# row sum of J over the largest row sum, above which a coordinate counts as resisted; excludes frictionless rotations
HELD_ABOVE = 1e-13
SOLVED = 1e-9  # largest residual of the non-affine motion, over the largest row of J, for a valid solution
DENSE_UP_TO = 3_000  # number of coordinates up to which floppy modes are distinguished from unsupported loads
PLANAR = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[1, 0], [0, -1]], [[0, 1], [1, 0]]])  # dilation, rotation
VOIGT = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))}


@readable
class ElasticModuli(NamedTuple):
    """C_abcd = −∂σ_ab/∂G_cd for a displacement gradient G, and its affine part [force/length^(dim−1)].

    `shear`, `bulk` and so on are the moduli of the isotropic tensor nearest to C. In two dimensions, they are plane
    moduli.
    """

    tensor: np.ndarray  # (dim,) * 4, C_abcd
    affine: np.ndarray  # (dim,) * 4, C_abcd if grains moved affinely with the cell and did not rotate
    motion: np.ndarray  # (n, dim, dim) non-affine motion per unit of G_cd, in the coordinates `free` [length]
    free: Freedom

    @property
    def dim(self) -> int:
        """Number of dimensions."""
        return len(self.tensor)

    @property
    def non_affine(self) -> np.ndarray:
        """(dim,) * 4 contribution of the non-affine motion to C, usually negative."""
        return self.tensor - self.affine

    @property
    def voigt(self) -> np.ndarray:
        """(3, 3) or (6, 6) C in the order xx, yy, xy or xx, yy, zz, yz, xz, xy, for strains ε_xx … and γ = 2ε_xy."""
        return voigt(self.tensor)

    @property
    def bulk(self) -> float:
        """K = C_aabb/dim²."""
        return isotropic(self.tensor)[0]

    @property
    def shear(self) -> float:
        """G = (C_abab − C_aabb/dim)/((dim − 1)(dim + 2)), with C symmetrised in a, b and in c, d."""
        return isotropic(self.tensor)[1]

    @property
    def bulk_affine(self) -> float:
        """Bulk modulus K of the affine part."""
        return isotropic(self.affine)[0]

    @property
    def shear_affine(self) -> float:
        """Shear modulus G of the affine part."""
        return isotropic(self.affine)[1]

    @property
    def poisson(self) -> float:
        """ν = (dim K − 2G)/(dim (dim − 1) K + 2G): (K − G)/(K + G) in two dimensions."""
        d, (bulk, shear) = self.dim, isotropic(self.tensor)
        return (d * bulk - 2 * shear) / (d * (d - 1) * bulk + 2 * shear)

    @property
    def young(self) -> float:
        """E = 2G (1 + ν)."""
        return 2 * self.shear * (1 + self.poisson)

    @property
    def odd_shear(self) -> float:
        """K^o of the isotropic part of C in two dimensions, zero in three (Scheibner, doi:10.1038/s41567-020-0795-y).

        With s₂ = G_xx − G_yy, s₃ = G_xy + G_yx and tension τ, τ_xx − τ_yy = 2G s₂ + 2K^o s₃, τ_xy + τ_yx = 2G s₃ −
        2K^o s₂. A cycle of strain, counterclockwise in (s₂, s₃), does work per unit volume of 2K^o times its area.
        """
        return float(self._planar[2, 3] - self._planar[3, 2]) / 2 if self.dim == 2 else 0.0

    @property
    def odd_torque(self) -> float:
        """A of the isotropic part of C in two dimensions: τ_yx − τ_xy = 2A (G_xx + G_yy); source: as for `odd_shear`.

        A vanishes where torques balance; for lever arms R, a remainder of the order of overlap over diameter is left.
        """
        return float(self._planar[1, 0]) if self.dim == 2 else 0.0

    @property
    def _planar(self) -> np.ndarray:
        """(4, 4) couplings of stress and displacement gradient in the basis `PLANAR`."""
        return np.einsum("kab,abcd,lcd->kl", PLANAR, self.tensor, PLANAR) / 4

    @property
    def anisotropy(self) -> float:
        """Distance of C from its isotropic part, relative to C, in Frobenius norms of symmetrised tensors."""
        c = symmetrised(self.tensor)
        return float(np.linalg.norm(c - isotropic_tensor(self.dim, *isotropic(c))) / np.linalg.norm(c))

    @property
    def asymmetry(self) -> float:
        """Antisymmetric fraction of C, C_abcd ≠ C_cdab: zero without stress if forces have a potential."""
        c = symmetrised(self.tensor)
        return float(np.linalg.norm(c - c.transpose(2, 3, 0, 1)) / 2 / np.linalg.norm(c))


@checked
@knows_bonds
def elastic_moduli(state: State, law: Law) -> ElasticModuli:
    """Elastic moduli C = −∂σ/∂G = −(ℓ²/V) (J_cc − J_cg J_gg⁻¹ J_gc) of a packing.

    c denotes the coordinates ℓG of the cell and g those of the grains. The first term is affine: grains move with the
    cell, x → x + Gx, and do not rotate. The second term is the contribution of the non-affine motion that restores the
    balance of forces and torques. Each contact is held in its mode, so C is a tangent modulus: it is valid for strains
    so small that no contact opens, closes, or changes between stick and slide. σ is the Cauchy stress, compression
    positive, so C is positive where a packing resists. Under a pressure p, C differs from the second derivative of
    an energy by terms of order p. Rattlers are excluded.

    In 16 disks and 20 spheres without sliding contacts, with overlaps of 1 to 3 %, the change of the shear stress
    differed from the prediction by C_xyxy by 0.03 % after a strain of 1e-4, and by 0.3 % after 1e-3
    (`tests/modes/test_moduli.py`).

    Parameters
    ----------
    state : State, accepted and in equilibrium, in a fully periodic cell, without walls or rigid groups

    Raises
    ------
    ValueError
        If the state has walls, rigid groups, springs or open sides, or if a strain drives unresisted motions.

    Source
    ------
    Maloney & Lemaître, doi:10.1103/PhysRevE.74.016118, with −J for the Hessian; Barron & Klein,
    doi:10.1088/0370-1328/85/3/313, for stress-strain coefficients under an initial stress.

    Examples
    --------
    Disks on a triangular lattice have K = (√3/2) k_n and G = (√3/4)(k_n + k_t):

    >>> import numpy as np
    >>> import stickslip as ss
    >>> law = ss.laws.linear(1.0, 0.5, 0.5)
    >>> site = np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [1.5, 0.75**0.5]])
    >>> shifts = [[0, 0], [0, 3**0.5], [2, 0], [2, 3**0.5]]
    >>> place = np.concatenate([site + shift for shift in shifts])
    >>> state = ss.packings.from_arrays(
    ...     place, np.full(16, 0.5 + 1e-9), law, cell=[4, 2 * 3**0.5], dim=2
    ... )
    >>> found = elastic_moduli(state, law)
    >>> round(found.bulk, 6), round(found.shear, 6), round(found.poisson, 6)
    (0.866025, 0.649519, 0.142857)
    """
    state, matrix, free, grain, cell = with_free_cell(state, law)
    dim = state.cell.dim
    unit = -(free.length**2) / volume(state)
    affine = unit * matrix[cell][:, cell].toarray()
    pull = matrix[grain][:, cell].toarray()
    motion = solve_resisted(matrix[grain][:, grain], pull, free)
    tensor = affine + unit * (matrix[cell][:, grain] @ motion)
    shape = (dim,) * 4
    moved = free.length * motion.reshape(len(grain), dim, dim)
    return ElasticModuli(tensor.reshape(shape), affine.reshape(shape), moved, free.only(free.axis < 6, 0.0))


def adjoint_motion(state: State, law: Law, strain: np.ndarray) -> np.ndarray:
    """(n,) motion of the grains for a strain (dim, dim), as in `ElasticModuli.motion` but with J_ggᵀ for J_gg."""
    _, matrix, free, grain, cell = with_free_cell(state, law)
    pull = free.length * (matrix[cell][:, grain].T @ strain.ravel())
    return solve_resisted(matrix[grain][:, grain].T.tocsr(), pull[:, None], free)[:, 0]


def with_free_cell(state: State, law: Law):
    """State whose cell is free under its present stress, its J and coordinates, and those of grains and cell alone."""
    check_cell(state, "elastic moduli")
    dim = state.cell.dim
    free_cell = np.zeros((3, 3), bool)
    free_cell[:dim, :dim] = True
    # with σ itself as the imposed stress, rows of J for the cell are derivatives of σ
    control = state.control._replace(cell_free=free_cell, stress=stress(state, law), cell_rate=np.zeros((3, 3)))
    state = state._replace(control=control)
    free = backbone(state, law)
    if (free.axis == 6).all():
        raise ValueError("the packing has only rattlers: elastic moduli need grains that support each other")
    return state, jacobian(state, law, free), free, np.flatnonzero(free.axis < 6), np.flatnonzero(free.axis == 6)


def check_cell(state: State, what: str) -> None:
    """Raise ValueError if a cell cannot be strained as a whole; the message names the quantity that requires this."""
    control, periodic = state.control, state.cell.periodic[: state.cell.dim]
    if len(state.walls.mass) or (control.group >= 0).any() or control.spring.any() or not periodic.all():
        raise ValueError(
            f"the packing has walls, rigid groups, springs or open sides: {what} need a cell that is periodic in all "
            "its dimensions and can be strained as a whole"
        )


def solve_resisted(matrix, pull: np.ndarray, free: Freedom, cause: str = "a strain") -> np.ndarray:
    """Solve J x = −pull; translations and unresisted coordinates do not move. The message names the `cause`."""
    size, axis, largest = np.abs(matrix).sum(axis=1), free.axis[: matrix.shape[0]], np.abs(matrix.data).max(initial=0.0)
    scale = size.max(initial=0.0)
    held = size > HELD_ABOVE * scale
    solved = held.copy()
    for k in range(free.dim):  # one coordinate per axis is held if nothing resists a common translation
        along = held & (axis == k)
        if along.any() and np.abs(matrix @ along.astype(float)).max() <= 1e-10 * largest:
            solved[np.flatnonzero(along)[0]] = False
    rows = np.flatnonzero(solved)
    inner, out = matrix[rows][:, rows], np.zeros_like(pull)
    try:
        out[rows] = factorised(sparse.csr_array(-inner))(np.ascontiguousarray(pull[rows]))
    except LinAlgError:
        out[:] = np.inf
    if (
        not _is_balanced(matrix, out, pull, scale) and len(rows) <= DENSE_UP_TO
    ):  # there may be floppy modes that no strain drives
        out = np.zeros_like(pull)
        out[rows] = np.linalg.lstsq(-inner.toarray(), pull[rows], rcond=1e-11)[0]
    if not _is_balanced(matrix, out, pull, scale):
        raise ValueError(f"{cause} drives unresisted motions: this packing has no elastic response")
    return out


def _is_balanced(matrix, out, pull, scale) -> bool:
    return bool(np.isfinite(out).all()) and np.abs(matrix @ out + pull).max(initial=0.0) <= SOLVED * scale


def symmetrised(tensor: np.ndarray) -> np.ndarray:
    """C_abcd symmetrised in a, b and in c, d: the response to strains without rotation."""
    first = (tensor + tensor.transpose(1, 0, 2, 3)) / 2
    return (first + first.transpose(0, 1, 3, 2)) / 2


def voigt(tensor: np.ndarray) -> np.ndarray:
    """(3, 3) or (6, 6) matrix of a tensor (dim,) * 4 in Voigt order; see `ElasticModuli.voigt`."""
    pairs = VOIGT[len(tensor)]
    c = symmetrised(tensor)
    return np.array([[c[*row, *column] for column in pairs] for row in pairs])


def isotropic(tensor: np.ndarray) -> tuple[float, float]:
    """Bulk and shear modulus of the isotropic tensor nearest to a tensor (dim,) * 4."""
    d, c = len(tensor), symmetrised(tensor)
    whole, trace = float(np.einsum("aabb", c)), float(np.einsum("abab", c))
    return whole / d**2, (trace - whole / d) / ((d - 1) * (d + 2))


def isotropic_tensor(dim: int, bulk: float, shear: float) -> np.ndarray:
    """(dim,) * 4 isotropic tensor (K − 2G/dim) δ_ab δ_cd + G (δ_ac δ_bd + δ_ad δ_bc)."""
    delta = np.eye(dim)
    swapped = np.einsum("ac,bd->abcd", delta, delta) + np.einsum("ad,bc->abcd", delta, delta)
    return (bulk - 2 * shear / dim) * np.einsum("ab,cd->abcd", delta, delta) + shear * swapped


@readable
class ModuliBounds(NamedTuple):
    """Elastic moduli and their bounds, in the order and with the strains of `ElasticModuli.voigt`.

    C − C_Reuss and C_Voigt − C have no negative eigenvalue, up to terms of the order of the stress: in small packings
    under a stress of 0.03 to 0.1 times C, eigenvalues of −0.01 to −0.2 times C occur.
    """

    reuss: np.ndarray  # (3, 3) or (6, 6) lower bound [force/length^(dim−1)]
    tensor: np.ndarray  # (3, 3) or (6, 6) C
    voigt: np.ndarray  # (3, 3) or (6, 6) upper bound: affine motion

    @property
    def bulk(self) -> tuple[float, float, float]:
        """K of the three tensors: lower bound, C, upper bound."""
        return tuple(_bulk_and_shear(c)[0] for c in self)

    @property
    def shear(self) -> tuple[float, float, float]:
        """G of the three tensors: lower bound, C, upper bound."""
        return tuple(_bulk_and_shear(c)[1] for c in self)


def _bulk_and_shear(c: np.ndarray) -> tuple[float, float]:
    d = 2 if len(c) == 3 else 3
    whole, trace = c[:d, :d].sum(), np.trace(c[:d, :d]) + 2 * np.trace(c[d:, d:])
    return float(whole) / d**2, float(trace - whole / d) / ((d - 1) * (d + 2))


@checked
def moduli_bounds(state: State, law: Law) -> ModuliBounds:
    """Elastic moduli and their bounds: Voigt by affine motion, Reuss by smooth contact forces under a uniform stress.

    Voigt: all grains move with the cell and do not rotate; no motion has less elastic energy than the true one. Reuss:
    contact forces balance on each grain, as do torques, and add up to the stress; no such forces have less
    complementary energy than the true ones. Those with the smallest Σ|f|² are used, as in a packing whose contacts are
    equally stiff along and across the normal. Both bounds are theorems for forces that have a potential: they hold for
    packings without sliding contacts, up to terms of the order of stress over stiffness.

    Raises
    ------
    ValueError
        As in `elastic_moduli`, or if there is a stress that no contact forces balance.

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
        raise ValueError("no contact forces balance a certain stress: bounds need a packing that carries every stress")
    return np.linalg.inv(matrix)
