"""Linear relations for a packing of disks under slow loads, and the stiffness matrix k = c K S cᵀ.

A contact exerts the force F = (F_n, F_t) on its body i, along n (from j to i) and t (clockwise from n), and has the
spring elongation D = (−δ, s·t). With v the generalised velocities (rotations as R ω), Table I of the paper reads

    f = c F,     dF/dt = −K dD/dt,     dD/dt = S V,     V = cᵀ v.

S is 1 at a sticking contact and ((1, 0), (−m sgn D_t, 0)) at a sliding one, which thus stays at the Coulomb limit;
m = μ K_n/K_t for a linear law. A law whose tangential force depends on the overlap has K = ((K_n, 0), (−φ', K_t)), φ'
= sgn D_t ∂φ/∂δ, and m = (μ K_n − ∂φ/∂δ)/K_t. The geometric stiffness −(dc/dt) F, due to the rotation of contacts, is
small, of the order of the overlap over the radius.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. III, with the errata given in the
documentation.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from ..core.arguments import Numbers, checked, require_shape
from ..core.contacts.jacobian import linearise
from ..core.laws.builtin import KEEPS_FORCE, SMOOTH, Law
from ..core.measure import branch_vectors, touching
from ..core.measure import rattlers as loose_grains
from ..core.readable import readable
from ..core.state import OPEN, SLIDE, State
from ..solve.freedom import Freedom, cell_geometric_terms, freedom, incidence
from .walls import append_wall_rotations


@readable
class LinearSystem(NamedTuple):
    """Matrices and vectors of Table I, for the M touching contacts of a state and its n free coordinates."""

    rows: np.ndarray  # (M,) rows of the contacts in the contact list
    c: sparse.csr_array  # (n, 2M) force on coordinates from (F_n, F_t) of every contact
    springs: np.ndarray  # (M, 2, 2) K of a sticking contact [force/length]
    damping: np.ndarray  # (M, 2) Γ_n, Γ_t [force time/length]
    slope: np.ndarray  # (M,) m, the rate at which D_t of a sliding contact follows D_n
    sign: np.ndarray  # (M,) sgn D_t
    mu: np.ndarray  # (M,)
    force: np.ndarray  # (M, 2) F_n, F_t on body i [force]
    limit: np.ndarray  # (M,) bool: currently at the Coulomb limit
    geometric: sparse.csr_array  # (n, n) geometric stiffness [force/length]
    free: Freedom

    @property
    def count(self) -> int:
        """Number M of contacts."""
        return len(self.rows)

    @property
    def margin(self) -> np.ndarray:
        """(M,) F̃ = μ F_n − |F_t| [force]."""
        return self.mu * self.force[:, 0] - np.abs(self.force[:, 1])


@checked
def linear_system(
    state: State, law: Law, *, rattlers: bool | np.ndarray = False, wall_arm: float | None = None
) -> LinearSystem:
    """Compute the matrices of an accepted state.

    Parameters
    ----------
    state : State in two dimensions; walls and rigid groups are bodies, and a free cell adds its strain
    law : Law with sharp Coulomb friction
    rattlers : whether rattlers and their contacts are included; or (N,) bool, the grains to exclude instead
    wall_arm : if given, every wall may also rotate about its point: the last coordinates are this arm times the angles
        of the walls [length]; see `walls`

    Raises
    ------
    ValueError
        in three dimensions; for a smooth law, under which contacts neither slide nor stick; or if walls cannot rotate.
    """
    if state.cell.dim != 2:
        raise ValueError(
            "a packing in three dimensions was given: contacts there can slide in a continuum of directions, and this "
            "theory, with its two statuses, applies only to disks in two dimensions"
        )
    if law.coulomb == SMOOTH:
        raise ValueError(
            "a law with smooth friction was given: contact status needs coulomb='sharp', where contacts stick or slide"
        )
    if state.control.spring.any():
        raise ValueError(
            "a state with springs was given: this theory supports dead loads only; use `force_controlled` instead"
        )
    rows, line = touching(state), linearise(state, law)
    loose = np.zeros(state.n_bodies, bool)
    if not isinstance(rattlers, bool):
        if np.shape(rattlers) != (len(state.grains.radius),):
            raise ValueError(
                f"rattlers of shape {np.shape(rattlers)} was given: True, False, or one bool for each grain is needed"
            )
        loose[: len(state.grains.radius)] = rattlers
    elif not rattlers:
        parted = np.zeros(len(state.contacts.mode), bool)  # such as those of rattlers that a path moved aside
        parted[rows] = ~line.normal[rows].any(axis=1)
        modes = np.where(parted, OPEN, state.contacts.mode)
        loose[: len(state.grains.radius)] = loose_grains(
            state._replace(contacts=state.contacts._replace(mode=modes)), 2
        )
    rows = rows[~(loose[state.contacts.i[rows]] | loose[state.contacts.j[rows]])]
    free = freedom(state).without(loose)
    count = len(line.normal)
    normal = line.normal[rows]
    parted = ~normal.any(axis=1)  # contacts with memory that do not overlap, to the last digits
    apart = branch_vectors(state)[rows[parted]]
    normal[parted] = apart / np.linalg.norm(apart, axis=1)[:, None]
    along = np.stack([normal[:, 1], -normal[:, 0], np.zeros(len(rows))], axis=1)
    c = sparse.csr_array(incidence(state, count, free) @ _directions(rows, normal, along, count))
    slip = np.einsum("ck,ck->c", line.slip[rows], along)
    # a contact at the limit exerts exactly μ F_n, whatever the round-off of its slip
    sliding = state.contacts.mode[rows] == SLIDE
    pull = np.where(sliding, line.mu[rows] * line.force_n[rows], line.stiffness_t[rows] * np.abs(slip))
    sign = np.where(slip < 0, -1.0, 1.0)
    force = np.stack([line.force_n[rows], -sign * pull], axis=1)
    k_n, k_t = line.slope_n[rows], line.stiffness_t[rows]
    by_overlap = line.slope_t[rows] * np.abs(slip) * (not law.properties & KEEPS_FORCE)
    springs = np.zeros((len(rows), 2, 2))
    springs[:, 0, 0], springs[:, 1, 1], springs[:, 1, 0] = k_n, k_t, -sign * by_overlap
    slope = np.divide(line.mu[rows] * k_n - by_overlap, k_t, out=np.zeros(len(rows)), where=k_t > 0)
    geometric = _geometric_stiffness(state, free, rows, force, normal, along, line.inverse[rows], count)
    if wall_arm is not None:
        c, geometric, free = append_wall_rotations(state, rows, force, c, geometric, free, wall_arm)
    return LinearSystem(
        rows, c, springs, np.stack([line.damping_n[rows], line.damping_t[rows]], axis=1), slope, sign, line.mu[rows],
        force, sliding, geometric, free,
    )  # fmt: skip


def _directions(rows, normal, along, count: int):
    """(6 count, 2M) sparse: (F, T/R) of a contact from its (F_n, F_t)."""
    m = len(rows)
    at = 6 * rows[:, None] + np.arange(3)
    place = [at.ravel(), at.ravel(), 6 * rows + 5]
    column = [np.repeat(2 * np.arange(m), 3), np.repeat(2 * np.arange(m) + 1, 3), 2 * np.arange(m) + 1]
    values = [normal.ravel(), along.ravel(), np.ones(m)]
    where = (np.concatenate(place), np.concatenate(column))
    return sparse.csr_array((np.concatenate(values), where), shape=(6 * count, 2 * m))


def _geometric_stiffness(state: State, free: Freedom, rows, force, normal, along, inverse, count: int):
    """(n, n) geometric stiffness −(dc/dt) F: contact forces rotate with the normal, (F_n t − F_t n)(t·dr)/|r|."""
    turning = inverse[:, None] * (force[:, :1] * along - force[:, 1:] * normal)
    blocks = np.zeros((count, 6, 6))
    blocks[rows, :3, :3] = -turning[:, :, None] * along[:, None, :]
    q = incidence(state, count, free)
    flat = sparse.bsr_array((blocks, np.arange(count), np.arange(count + 1)), shape=(6 * count, 6 * count))
    turned = sparse.csr_array(q @ flat @ q.T)
    if not free.length:
        return turned
    vectors = np.zeros((count, 3))
    vectors[rows] = force[:, :1] * normal + force[:, 1:] * along
    return sparse.csr_array(turned - cell_geometric_terms(state, vectors, free))


def statuses(matrix: LinearSystem, sliding) -> np.ndarray:
    """(M, 2, 2) blocks S of every contact; `sliding` (M,) bool."""
    out = np.tile(np.eye(2), (matrix.count, 1, 1))
    out[sliding, 1, 1] = 0.0
    out[sliding, 1, 0] = -(matrix.slope * matrix.sign)[sliding]
    return out


def block_diagonal(parts: np.ndarray):
    """(2M, 2M) sparse block-diagonal matrix of (M, 2, 2) parts."""
    m = len(parts)
    return sparse.bsr_array((parts, np.arange(m), np.arange(m + 1)), shape=(2 * m, 2 * m))


@checked
def stiffness_matrix(matrix: LinearSystem, sliding: Numbers | None = None, *, geometric: bool = True):
    """(n, n) sparse k = c K S cᵀ with df_ext/dt = k v, plus the geometric stiffness; equal to −J for these statuses.

    Parameters
    ----------
    sliding : (M,) bool, mask of sliding contacts; default: those currently at the Coulomb limit
    geometric : whether the forces rotate with the contacts
    """
    sliding = _status_of_all(matrix, sliding)
    k = matrix.c @ block_diagonal(matrix.springs @ statuses(matrix, sliding)) @ matrix.c.T
    return sparse.csr_array(k + matrix.geometric if geometric else k)


def force_rates(matrix: LinearSystem, sliding: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """(M, 2) dF/dt = −K S cᵀ v of all contacts; `sliding` (M,) bool, `velocity` (n,)."""
    relative = (matrix.c.T @ velocity).reshape(-1, 2)
    stretched = np.einsum("mab,mb->ma", statuses(matrix, sliding), relative)
    return -np.einsum("mab,mb->ma", matrix.springs, stretched)


def _status_of_all(matrix: LinearSystem, sliding) -> np.ndarray:
    """(M,) mask of sliding contacts: the given one, or contacts currently at the Coulomb limit."""
    sliding = matrix.limit if sliding is None else np.asarray(sliding, bool)
    if sliding.shape != (matrix.count,):
        raise ValueError(
            f"statuses of shape {sliding.shape} were given for {matrix.count} contacts: one for each contact is needed"
        )
    return sliding


@checked
def damping_matrix(matrix: LinearSystem, sliding: Numbers | None = None):
    """(n, n) sparse c Γ cᵀ, the derivative of −f with respect to velocities; equal to −C for these statuses.

    A sliding contact has no tangential dashpot; its tangential force follows the normal one, dashpot included, by μ.
    """
    sliding = _status_of_all(matrix, sliding)
    damping = np.einsum("ma,ab->mab", matrix.damping, np.eye(2))
    damping[sliding, 1, 1] = 0.0
    damping[sliding, 1, 0] = -(matrix.sign * matrix.mu * matrix.damping[:, 0])[sliding]
    return sparse.csr_array(matrix.c @ block_diagonal(damping) @ matrix.c.T)


@checked
def quadratic_form(matrix: LinearSystem, velocity: np.ndarray, sliding: Numbers | None = None) -> float:
    """Q = vᵀ k v without geometric stiffness; stability is assumed to mean Q > 0 for all v (Eq. 41)."""
    require_shape((len(matrix.free),), velocity=velocity)
    return float(velocity @ (stiffness_matrix(matrix, sliding, geometric=False) @ velocity))
