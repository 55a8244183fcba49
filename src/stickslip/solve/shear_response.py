"""Linear response of a packing to shear or compression: non-affine motion, tangent modulus, and softest modes.

Grains that almost float dominate the smallest eigenvalue of a packing but do not affect its mechanics. They are pruned:
first, contacts whose overlap is below a given fraction of the mean overlap are removed; then, repeatedly, grains with
fewer contacts than dimensions (or, without friction, at most as many). All contacts between the remaining grains count,
however small, because these grains may fail when such a contact slides or opens.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import eigvals

from ..core.arguments import checked, knows_bonds
from ..core.contacts.bonds import bond_rows, is_beam
from ..core.contacts.forces import HELD, forces
from ..core.contacts.jacobian import blocks_of, bond_blocks, contact_blocks, linearise
from ..core.dynamics.cell_motion import strained
from ..core.laws.builtin import MU, Law
from ..core.measure import branch_vectors, overlaps, touching, volume
from ..core.readable import readable
from ..core.state import OPEN, SLIDE, STICK, State
from .balance import with_mode
from .freedom import Freedom, assembled, backbone, freedom, incidence, residual_vector
from .linear import DENSE_BELOW, factorised, suitable_threads
from .moduli import HELD_ABOVE
from .spectrum import REAL_BELOW

SOLVED = 1e-9  # largest relative residual of the non-affine motion
FLOATS = 1e-12  # singular value, over the largest one, below which a motion counts as unresisted
SHIFT = 1e-9  # term added to the diagonal of large systems, over their largest entry
SMALL_STRAIN = 1e-8  # step of finite differences
XY = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
PRUNE = 2e-3  # fraction of the mean overlap below which a contact does not support grains


@readable
class Support(NamedTuple):
    """Grains remaining after pruning, and the contacts between them."""

    contacts: np.ndarray  # (C,) bool, mask of the remaining contacts among the pairs in the list
    grains: np.ndarray  # (N,) bool, mask of the remaining grains


@checked
@knows_bonds
def support(state: State, law: Law, *, prune: float = PRUNE) -> Support:
    """Prune contacts with small overlaps, then repeatedly grains with too few contacts.

    Small contacts between remaining grains are kept. Bonds are not pruned; a single beam (bond) can hold a grain.

    Parameters
    ----------
    prune : fraction of the mean overlap below which a contact is pruned

    Examples
    --------
    >>> import stickslip as ss
    >>> state, info = ss.packings.jammed(30, packing_fraction=0.7)
    >>> int(support(state, ss.laws.hertz_mindlin()).grains.sum()) == 30 - info.rattlers
    True
    """
    contacts, n = state.contacts, len(state.grains.radius)
    count, least = int(contacts.count[0]), state.cell.dim + (not law.table[..., MU].any())
    i, j = contacts.i[:count], contacts.j[:count]
    rows, kept, touches = touching(state), np.zeros(count, bool), np.zeros(count, bool)
    touches[rows] = True
    overlap = overlaps(state)
    closed = rows[overlap[rows] > 0]
    kept[closed] = overlap[closed] >= prune * overlap[closed].mean() if len(closed) else False
    holds = np.ones(count)
    if state.bonds:
        held, beams = bond_rows(state.bonds, state.contacts), is_beam(state.bonds, state.cell.dim)
        kept[held[state.bonds.intact]], holds[held[beams]] = True, least
    while True:
        number = np.bincount(np.append(i[kept], j[kept]), np.tile(holds[kept], 2), state.n_bodies)[:n]
        loose = np.append(number < least, np.zeros(state.n_bodies - n, bool))
        now = kept & ~loose[i] & ~loose[j]
        if np.array_equal(now, kept):
            held = ~loose
            return Support(touches & held[i] & held[j], held[:n])
        kept = now


class Response:
    """Response of an accepted state in a periodic cell to a strain, computed from the exact Jacobian on demand.

    The deformation is x → (1 + G ε) x for small strains; by default, simple shear along x with the gradient along y.
    """

    def __init__(self, state: State, law: Law, prune: float = PRUNE, *, slip: bool = True, gradient: np.ndarray = XY):
        self.state, self.law, self.slip, self.gradient = state, law, slip, gradient
        self.support = support(state, law, prune=prune)
        self.line = linearise(state, law)
        self.blocks = blocks_of(state, law, self.line)[0]
        self.branch = branch_vectors(state)
        self._known: dict[tuple[int, int], np.ndarray] = {}

    @cached_property
    def free(self) -> Freedom:
        """Coordinates of the supported grains, without unresisted rotations."""
        free = freedom(self.state).without(~self.support.grains)
        return _without_floating(assembled(self.state, self._supported_blocks(), free), free)

    def _supported_blocks(self) -> np.ndarray:
        return self.blocks * self.support.contacts[:, None, None]

    @cached_property
    def matrix(self) -> np.ndarray:
        """(n, n) −M^(−1/2) J M^(−1/2) of supported grains; λ of common translations is raised to the largest entry."""
        return self._dynamical(self._supported_blocks(), self.free)

    def _dynamical(self, blocks, free: Freedom) -> np.ndarray:
        root = 1 / np.sqrt(free.mass)
        full = -assembled(self.state, blocks, free).toarray() * root * root[:, None]
        rigid = _translations(free, np.sqrt(free.mass))
        return full + np.abs(full).max(initial=0.0) * rigid @ rigid.T

    @cached_property
    def eigenvalues(self) -> np.ndarray:
        """(n,) complex eigenvalues of `matrix` [1/time²]."""
        return _eigenvalues(self.matrix)

    @cached_property
    def with_all_contacts(self) -> np.ndarray:
        """Complex eigenvalues with all contacts, for all grains that are not rattlers [1/time²]."""
        free = backbone(self.state, self.law)
        free = _without_floating(assembled(self.state, self.blocks, free), free)
        return _eigenvalues(self._dynamical(self.blocks, free))

    @cached_property
    def _motion(self) -> tuple[np.ndarray, Freedom]:
        free = backbone(self.state, self.law)
        matrix = assembled(self.state, self.blocks, free)
        free = _without_floating(matrix, free)
        matrix = assembled(self.state, self.blocks, free)
        if len(free) >= DENSE_BELOW:  # a small shift holds translations and floating grains
            shift = SHIFT * np.abs(matrix.data).max() * sparse.eye_array(len(free), format="csr")
            return factorised(sparse.csr_array(shift - matrix))(self._pull(free)), free
        full, rigid = matrix.toarray(), _translations(free, np.ones(len(free)))
        full -= np.abs(full).max(initial=0.0) * rigid @ rigid.T
        with suitable_threads(len(free)):
            return _solve(full, -self._pull(free)), free

    def _pull(self, free: Freedom) -> np.ndarray:
        """(n,) derivative of the generalised forces with respect to the strain, at affine motion [force]."""
        if not self.slip:  # contact memory follows the flow, which the blocks do not describe
            ends = (strained(self.state, SMALL_STRAIN * sign * self.gradient, slip=False) for sign in (1, -1))
            plus, minus = (residual_vector(s, forces(s, self.law, memory=HELD)[0], free) for s in ends)
            return (plus - minus) / (2 * SMALL_STRAIN)
        count, width = self.blocks.shape[:2]
        moved = np.zeros((count, width))
        moved[:, :3] = self.branch @ self.gradient.T
        return incidence(self.state, count, free, width) @ np.einsum("ckl,cl->ck", self.blocks, moved).ravel()

    @cached_property
    def rate(self) -> np.ndarray:
        """(N, 6) non-affine motion of the grains, (x, y, z, R·angle), per unit of strain [length]."""
        motion, free = self._motion
        return free.spread(motion)

    @property
    def speed(self) -> float:
        """Root mean square of `rate` over the supported grains [length]."""
        return root_mean_square(self.rate, self.support.grains)

    @cached_property
    def modulus(self) -> float:
        """Derivative of the stress −σ:G with respect to the strain, non-affine part included [force/length^(dim−1)]."""
        motion, free = self._motion
        count, width = self.blocks.shape[:2]
        change = (incidence(self.state, count, free, width).T @ motion).reshape(count, width)
        change[:, :3] += self.branch @ self.gradient.T
        changed = np.einsum("cal,cl->ca", self.blocks[:, :3], change)
        force, along = self.line.force, self.gradient
        turned = np.einsum("ca,cb,ab->", force, change[:, :3] - np.trace(along) * self.branch, along)
        return -float(np.einsum("ca,cb,ab->", changed, self.branch, along) + turned) / volume(self.state)

    @cached_property
    def mobilisation(self) -> np.ndarray:
        """(C,) |F_t|/(μ F_n) of touching contacts; NaN for all other pairs and without friction."""
        return self.line.mobilisation

    def sticking(self, most: int) -> np.ndarray:
        """Rows of the supported sticking contacts with the largest mobilisation, in descending order."""
        sticks = self.state.contacts.mode[: len(self.branch)] == STICK
        rows = np.flatnonzero(self.support.contacts & sticks & np.isfinite(self.mobilisation))
        return rows[np.argsort(-self.mobilisation[rows], kind="stable")][:most]

    def eigenvalues_if(self, row: int, mode: int = SLIDE) -> np.ndarray:
        """Eigenvalues if one contact slides or is open while all others are unchanged [1/time²]."""
        if (int(row), mode) in self._known:
            return self._known[int(row), mode]
        blocks = self._supported_blocks()
        if mode == OPEN:
            blocks[row] = bond_blocks(self.state)[row] if self.state.bonds else 0.0
        else:
            blocks[row] = contact_blocks(with_mode(self.state, row, mode), self.law)[0][row]
        self._known[int(row), mode] = _eigenvalues(self._dynamical(blocks, self.free))
        return self._known[int(row), mode]


def _solve(matrix: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solution of a linear system; that of least norm if floating grains make the matrix singular to round-off."""
    try:
        x = np.linalg.solve(matrix, b)
        if np.abs(matrix @ x - b).max(initial=0.0) <= SOLVED * np.abs(b).max(initial=0.0):
            return x
    except np.linalg.LinAlgError:
        pass
    return np.linalg.lstsq(matrix, b, rcond=FLOATS)[0]


def _eigenvalues(matrix: np.ndarray) -> np.ndarray:
    with suitable_threads(len(matrix)):
        values = eigvals(matrix, check_finite=False)
    real = np.abs(values.imag) <= REAL_BELOW * np.abs(values).max(initial=0.0)
    return np.where(real, values.real, values)


def softest(eigenvalues: np.ndarray) -> float:
    """Smallest real eigenvalue; infinite if all are complex."""
    return float(eigenvalues.real[eigenvalues.imag == 0].min(initial=np.inf))


def margin(eigenvalues: np.ndarray, drag: float) -> float:
    """Smallest Re λ − (Im λ/ν)², negative if a mode grows under a drag ν [1/time²]; infinite without modes."""
    return float((eigenvalues.real - (eigenvalues.imag / drag) ** 2).min(initial=np.inf))


def damped_exponents(eigenvalues: np.ndarray, drag: float) -> np.ndarray:
    """Larger real part of s, s² + ν s + λ = 0: with a drag ν on all coordinates, a mode grows as exp(s t) [1/time].

    It is negative if and only if Re λ > (Im λ/ν)².
    """
    return np.abs(np.sqrt(0.25 * drag**2 - eigenvalues.astype(complex)).real) - 0.5 * drag


def root_mean_square(motion: np.ndarray, grains: np.ndarray) -> float:
    """Root mean square, over the given grains, of a motion (N, 6) without its mean translation."""
    moved = motion[grains]
    if not len(moved):
        return 0.0
    moved = np.hstack([moved[:, :3] - moved[:, :3].mean(axis=0), moved[:, 3:]])
    return float(np.sqrt((moved**2).sum(axis=1).mean()))


def _translations(free: Freedom, weight: np.ndarray) -> np.ndarray:
    """(n, dim) unit vectors of common translations."""
    moves = np.stack([np.where(free.axis == axis, weight, 0.0) for axis in range(free.dim)], axis=1)
    return moves / np.maximum(np.linalg.norm(moves, axis=0), np.finfo(float).tiny)


def _without_floating(matrix, free: Freedom) -> Freedom:
    """Freedom without unresisted coordinates, such as rotations without friction."""
    size = np.abs(matrix).sum(axis=1)
    kept = size > HELD_ABOVE * size.max(initial=0.0)
    return free if kept.all() else free.only(kept)
