"""Linear relations for a packing under slow loads, and the stiffness matrix k = c K S cᵀ.

A contact exerts the force F = (F_n, F_t) on its body i, along n (from j to i) and t (clockwise from n), and has the
spring elongation D = (−δ, s·t). With v the generalised velocities (rotations as R ω), Table I of the paper reads

    f = c F,     dF/dt = −K dD/dt,     dD/dt = S V,     V = cᵀ v.

S is 1 at a sticking contact and ((1, 0), (−m sgn D_t, 0)) at a sliding one, which thus stays at the Coulomb limit;
m = μ K_n/K_t for a linear law. A law whose tangential force depends on the overlap has K = ((K_n, 0), (−φ', K_t)), φ'
= sgn D_t ∂φ/∂δ, and m = (μ K_n − ∂φ/∂δ)/K_t. The geometric stiffness −(dc/dt) F, due to the rotation of contacts, is
small, of the order of the overlap over the radius.

In three dimensions, t is along the slip and t′ = n × t: F and V have three components, D_t is the length of the slip,
and its sign is 1. A contact slides along t only; along t′, S is 1 and K is K_t, which turns the force. The geometric
stiffness, which is the same for all statuses, is the part of the Jacobian beyond c K S cᵀ.

Walls may rotate. Each then has one additional coordinate, its arm times its angle about its point. A disk at x_i and a
wall with point p, normal n and tangent t touch on the surface of the wall, at p + a t with a = (x_i − p)·t. This point
is at R − δ from the centre of the disk, while the disk itself has the lever arm R. If the wall rotates at the rate Ω,
its surface at this point moves with velocity Ω a n. The torque of (F_n, F_t) on the wall is therefore −a F_n, without a
contribution from F_t. n and t rotate with the wall, dn = −Ω t and dt = Ω n, and da = (v_i − v_w)·t + (R − δ) Ω; this is
the contribution to the geometric stiffness −(dc/dt) F. `displaced` moves such walls, but does not rotate them. With
lever arms R, a rigid rotation of the packing causes slip comparable to the overlap: vᵀkv/vᵀv is not zero, but of the
order of the squared overlap over the squared size of the packing.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. III, with the errata given in the
documentation.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components

from ... import OPEN, SLIDE, STICK, Law, State, freedom
from ...kit import (
    Linearisation,
    Numbers,
    Positive,
    blocks_of,
    bond_blocks,
    bond_rows,
    bond_vectors,
    builtin,
    check_types,
    checked,
    cross_matrix,
    incidence,
    is_beam,
    knows_bonds,
    linearise,
    readable,
    require_shape,
    resists_rolling,
    spring_stiffness,
    stiffness_of,
    supports,
)
from ...measure import branch_vectors, touching
from ...measure import rattlers as rattlers_of
from ...modes import assembled, residual_vector
from ...results import ContactLoads, Freedom


@readable
class LinearSystem(NamedTuple):
    """Matrices and vectors of Table I, for the M touching contacts of a state and its n free coordinates.

    Contacts have d = 2 components (n, t) in two dimensions and d = 3 components (n, t, t′) in three.
    """

    MADE_BY = "quasirigid.linear_system"

    rows: np.ndarray  # (M,) rows of the contacts in the contact list
    frame: np.ndarray  # (M, d, 3) n, t and t′
    c: sparse.csr_array  # (n, dM) force on coordinates from the components of every contact
    springs: np.ndarray  # (M, d, d) K of a sticking contact [force/length]
    damping: np.ndarray  # (M, 2) Γ_n, Γ_t [force time/length]
    slope: np.ndarray  # (M,) m, the rate at which D_t of a sliding contact follows D_n
    sign: np.ndarray  # (M,) sgn D_t
    mu: np.ndarray  # (M,)
    force: np.ndarray  # (M, d) force of each contact on its body i [force]
    limit: np.ndarray  # (M,) bool: currently at the Coulomb limit
    geometric: sparse.csr_array  # (n, n) geometric stiffness [force/length]
    machine: sparse.csr_array  # (n, n) stiffness of springs that pull bodies, and of bonds [force/length]
    free: Freedom
    rigid: sparse.csr_array | None = None  # (K, n) B: rigid bonds forbid motions with B v ≠ 0; None without them
    unit: np.ndarray | None = None  # (B,) first of the grains that beams join to each body; None without bonds
    clusters: sparse.csr_array | None = None  # (n, 6U) translations and rotations of U clusters, see `rigid_motions`

    check_entries = check_types

    @property
    def count(self) -> int:
        """Number M of contacts."""
        return len(self.rows)

    @property
    def width(self) -> int:
        """Number d of components of a contact."""
        return self.springs.shape[1]

    @property
    def margin(self) -> np.ndarray:
        """Distance from the Coulomb cone (M,), F̃ = μ F_n − |F_t| [force]."""
        return self.mu * self.force[:, 0] - np.linalg.norm(self.force[:, 1:], axis=1)


@checked
@knows_bonds
def linear_system(
    state: State, law: Law, *, rattlers: bool | np.ndarray = False, wall_arm: Positive | None = None,
    bonds: Literal["rigid", "elastic"] = "rigid",
) -> LinearSystem:  # fmt: skip
    """Compute the matrices of an accepted state.

    Intact bonds are constraints or springs. A rigid bond does not stretch and, if it resists shear, bending or
    twisting, does not deform in these ways either: B v = 0, where B v are the rates of these deformations. Grains
    joined by bonds that resist all of them move as one, and contacts between them neither slide nor open. Under a load,
    velocities are those of elastic bonds in the limit of infinite stiffness; forces of bonds turn with the bonds.

    Parameters
    ----------
    state : State; walls and rigid groups are bodies, and a free cell adds its strain
    law : Law with sharp Coulomb friction
    rattlers : whether rattlers and their contacts are included; or (N,) bool, the grains to exclude instead
    wall_arm : if given, every wall of a packing of disks may also rotate about its point: the last coordinates are this
        arm times the angles of the walls [length]
    bonds : whether intact bonds are rigid, or have their stiffness

    Raises
    ------
    ValueError
        If the law is smooth, so that contacts neither slide nor stick; if it has rolling resistance; or if `wall_arm`
        is given but walls cannot rotate.
    """
    if law.coulomb == builtin.SMOOTH:
        raise ValueError(
            "contact status needs coulomb='sharp', as contacts under smooth friction neither stick nor slide"
        )
    if resists_rolling(law):
        raise ValueError("contact status does not support rolling resistance: use a law without it")
    rows, modes = touching(state), np.minimum(state.contacts.mode, STICK)
    if state.bonds:
        rows = rows[state.contacts.mode[rows] != OPEN]
    stuck = state._replace(contacts=state.contacts._replace(mode=modes))
    line = linearise(stuck, law)
    parted = ~line.normal[rows].any(axis=1)  # contacts with memory that do not overlap, to round-off
    loose = _excluded_bodies(state, rattlers, rows[parted])
    kept = ~(loose[state.contacts.i[rows]] | loose[state.contacts.j[rows]])
    rows, parted = rows[kept], parted[kept]
    free = freedom(state).without(loose)
    normal = line.normal[rows]
    apart = branch_vectors(state)[rows[parted]]
    normal[parted] = apart / np.linalg.norm(apart, axis=1)[:, None]
    frame = contact_frames(normal, line.slip[rows], state.cell.dim)
    count = len(line.normal)
    c = sparse.csr_array(incidence(state, count, free) @ _directions(rows, frame, count))
    slip = np.einsum("ck,ck->c", line.slip[rows], frame[:, 1])
    # a contact at the limit exerts exactly μ F_n, despite round-off of its slip; without friction none sticks
    slippery = ~parted & (line.mu[rows] == 0)
    sliding = (state.contacts.mode[rows] == SLIDE) & ~slippery
    k_n, k_t = line.slope_n[rows], np.where(slippery, 0.0, line.stiffness_t[rows])
    pull = np.where(sliding, line.mu[rows] * line.force_n[rows], k_t * np.abs(slip))
    sign = np.where(slip < 0, -1.0, 1.0)
    force = np.zeros((len(rows), state.cell.dim))
    force[:, 0], force[:, 1] = line.force_n[rows], -sign * pull
    by_overlap = line.slope_t[rows] * np.abs(slip) * (not law.properties & builtin.KEEPS_FORCE)
    springs = np.zeros((len(rows), state.cell.dim, state.cell.dim))
    springs[:, 0, 0], springs[:, 1, 1], springs[:, -1, -1], springs[:, 1, 0] = k_n, k_t, k_t, -sign * by_overlap
    slope = np.divide(line.mu[rows] * k_n - by_overlap, k_t, out=np.zeros(len(rows)), where=k_t > 0)
    matrix = LinearSystem(
        rows, frame, c, springs, np.stack([line.damping_n[rows], line.damping_t[rows]], axis=1), slope, sign,
        line.mu[rows], force, sliding, sparse.csr_array((len(free), len(free))),
        sparse.csr_array(spring_stiffness(state, free)), free,
    )  # fmt: skip
    dead = stuck._replace(control=stuck.control._replace(spring=np.zeros_like(stuck.control.spring)), bonds=None)
    bare = line._replace(bond=np.zeros((1, 3)))
    matrix = matrix._replace(geometric=_geometric_stiffness(dead, law, bare, matrix))
    if state.bonds:
        intact = state.bonds.intact & ~(loose[state.bonds.i] | loose[state.bonds.j])
        held = state._replace(bonds=state.bonds._replace(intact=intact))
        elastic = matrix.machine - assembled(held, bond_blocks(held), free)
        forbidden = forbidden_rates(held, free) if bonds == "rigid" else None
        limit = sliding & ~(_within_clusters(held, rows) & (bonds == "rigid"))
        matrix = matrix._replace(
            machine=sparse.csr_array(elastic), rigid=forbidden, limit=limit, unit=joined_bodies(held),
            clusters=rigid_motions(held, free) if free.dim == 3 else None,
        )  # fmt: skip
    return matrix if wall_arm is None else append_wall_rotations(state, matrix, wall_arm)


def joined_bodies(state: State) -> np.ndarray:
    """Return, for each body (B,), the first of the bodies that intact beams join to it."""
    if not state.bonds:
        return np.arange(state.n_bodies)
    beams = np.flatnonzero(is_beam(state.bonds, state.cell.dim))
    ends = state.bonds.i[beams], state.bonds.j[beams]
    part = connected_components(sparse.coo_array((np.ones(len(beams)), ends), shape=(state.n_bodies,) * 2))[1]
    return np.unique(part, return_index=True)[1][part]


def loose_grains(state: State, known: np.ndarray | None = None, *, loaded: bool = True) -> np.ndarray:
    """Return the mask (N,) of rattlers, which have fewer than two supports; grains that beams join count as one body.

    Grains that beams join around a periodic cell are not rattlers, and contacts with images of the same body count as
    supports. In a packing with bonds, grains that carry an external load count as supported unless `loaded`.
    """
    if not state.bonds:
        return rattlers_of(state, 2, known)
    unit, number = supports(state)
    n, contacts, rows = state.n_bodies, state.contacts, touching(state)
    ends = np.tile(np.arange(n), 2), np.append(unit, joined_bodies(state))
    part = connected_components(sparse.coo_array((np.ones(2 * n), ends), shape=(n, n)), directed=False)[1]
    held, loose = np.zeros(n, int), np.zeros(n, bool)
    np.maximum.at(held, part, number)
    if known is not None:
        loose[part[: len(known)][known]] = True
    if not loaded:
        whole, nothing = freedom(state), np.zeros((n, 3))
        pull = residual_vector(state, ContactLoads(nothing, nothing, np.zeros((3, 3))), whole)
        held[part[np.setdiff1d(whole.body[pull != 0], n)]] = 2
    beams, rows = np.flatnonzero(is_beam(state.bonds, state.cell.dim)), rows[contacts.mode[rows] != OPEN]
    ends = state.bonds.i[beams], state.bonds.j[beams], state.bonds.image[beams].astype(int)
    place = _unwrapped(n, *ends)[1]
    held[part[ends[0][(ends[2] - place[ends[0]] + place[ends[1]]).any(axis=1)]]] = 2
    i, j = contacts.i[rows], contacts.j[rows]
    apart = (contacts.image[rows] - place[i] + place[j]).any(axis=1) | (part[i] != part[j])
    i, j = part[i], part[j]
    while True:
        holds = ~(loose[i] | loose[j]) & apart
        new = (held + np.bincount(np.concatenate([i[holds], j[holds]]), minlength=n) < 2) & ~loose
        if not new[part].any():
            return loose[part][: len(state.grains.radius)]
        loose |= new


def _within_clusters(state: State, rows: np.ndarray) -> np.ndarray:
    """Return the mask (C,) of contacts between two grains that beams hold together; they neither slide nor open.

    A contact between periodic images of one cluster moves as the cluster rotates, unless beams around the cell prevent
    this: in the same direction or, if the cell is held, in enough directions that the cluster cannot rotate.
    """
    bonds, contacts, dim = state.bonds, state.contacts, state.cell.dim
    beams = np.flatnonzero(is_beam(bonds, dim))
    i, j, image = bonds.i[beams], bonds.j[beams], bonds.image[beams].astype(int)
    part, place = _unwrapped(state.n_bodies, i, j, image)
    loops = image - place[i] + place[j]
    a, b = contacts.i[rows], contacts.j[rows]
    apart = contacts.image[rows] - place[a] + place[b]
    within = part[a] == part[b]
    for k in np.flatnonzero(within & apart.any(axis=1)):
        around = loops[part[i] == part[a[k]]]
        rank = np.linalg.matrix_rank(around) if len(around) else 0
        turns = state.control.cell_free.any() or rank < dim - 1
        within[k] = not turns or np.linalg.matrix_rank(np.vstack([around, apart[k]])) == rank
    return within


def _unwrapped(n: int, i: np.ndarray, j: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the cluster of each of n bodies joined by bonds, and the image (n, 3) that puts it next to the others."""
    joined = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(n, n))
    part = connected_components(joined, directed=False)[1]
    first = np.unique(part, return_index=True)[1]
    tree = sparse.coo_array(  # from a root to the first body of each cluster, and along bonds
        (np.ones(len(first) + len(i)), (np.append(np.full(len(first), n), i), np.append(first, j))), (n + 1, n + 1)
    ).tocsr()
    order, before = breadth_first_order(tree, n, directed=False)
    steps = dict(zip(zip(i.tolist(), j.tolist(), strict=True), image, strict=True))
    steps |= {(b, a): -step for (a, b), step in steps.items()}
    place = np.zeros((n, 3), int)
    for body in order[1:].tolist():
        if (former := int(before[body])) < n:
            place[body] = place[former] + steps[body, former]
    return part, place


def rigid_motions(state: State, free: Freedom) -> sparse.csr_array:
    """Return translations and rotations (n, 6U) of U clusters of spheres joined by beams and held only by contacts.

    Clusters around a periodic cell, which cannot rotate, are left out.
    """
    bonds, control, radius = state.bonds, state.control, state.grains.radius
    beams = np.flatnonzero(is_beam(bonds, 3))
    i, j, image = bonds.i[beams], bonds.j[beams], bonds.image[beams].astype(int)
    part, place = _unwrapped(state.n_bodies, i, j, image)
    position, own = state.grains.position + place[: len(radius)] @ state.cell.vectors, free.place[:-9].reshape(-1, 6)
    alone = (own >= 0).all(axis=1) & (control.group < 0) & ~control.spring.any(axis=1)
    excluded = np.concatenate([part[~alone], part[i[(image - place[i] + place[j]).any(axis=1)]]])
    size, blocks = np.bincount(part), []
    for cluster in np.setdiff1d(np.flatnonzero(size > 1), excluded):
        members = np.flatnonzero(part == cluster)
        apart, block = position[members] - position[members[0]], np.zeros((len(free), 6))
        block[own[members, :3], :3] = np.eye(3)
        block[own[members, :3], 3:] = -cross_matrix(apart)
        block[own[members, 3:], 3:] = radius[members, None, None] * np.eye(3)
        blocks.append(sparse.csr_array(block))
    return sparse.csr_array(sparse.hstack(blocks)) if blocks else sparse.csr_array((len(free), 0))


def forbidden_rates(state: State, free: Freedom) -> sparse.csr_array:
    """Return the rates (K, n) of deformation of intact bonds: stretching and, if resisted, shear, bending and twisting.

    Shear is the velocity of i relative to j at the point where the shear force acts (see `core/contacts/bonds.py`);
    rotations are multiplied by the bond's length, so all rates are velocities.
    """
    bonds, count, dim = state.bonds, int(state.contacts.count[0]), state.cell.dim
    held = np.flatnonzero(bonds.intact)
    r = bond_vectors(bonds, state.grains.position, state.cell.vectors)[held]
    a, b = (state.grains.radius[end[held]] for end in (bonds.i, bonds.j))
    arm, long = bonds.arm[held], np.linalg.norm(r, axis=1)
    frame = contact_frames(r / long[:, None], np.zeros_like(r), 3)
    if dim == 2:
        frame[:, 2], frame[:, 1] = [0.0, 0.0, 1.0], np.cross([0.0, 0.0, 1.0], frame[:, 0])
    # of (r, ρ, angle_i − angle_j); θ at the arm is (ρ + ((1 − α) R_j − α R_i)(angle_i − angle_j))/(R_i + R_j)
    lever = cross_matrix(r) / (a + b)[:, None, None]
    moved = np.zeros((len(held), 3, 9))
    moved[:, :, :3], moved[:, :, 3:6] = np.eye(3), lever
    moved[:, :, 6:] = ((1 - arm) * b - arm * a)[:, None, None] * lever
    turned = np.zeros((len(held), 3, 9))
    turned[:, :, 6:] = long[:, None, None] * np.eye(3)
    stiff = bonds.stiffness[held] > 0
    across = [1] if dim == 2 else [1, 2]
    parts = [(frame[:, :1] @ moved, stiff[:, 0]), (frame[:, across] @ moved, stiff[:, 1])]
    parts += [(turned[:, 2:], stiff[:, 2])] if dim == 2 else [
        (frame[:, 1:] @ turned, stiff[:, 2]), (frame[:, :1] @ turned, stiff[:, 3])
    ]  # fmt: skip
    column = (9 * bond_rows(bonds, state.contacts)[held, None, None] + np.arange(9)).astype(np.int64)
    blocks = []
    for part, acts in parts:
        row = np.arange(acts.sum() * part.shape[1]).reshape(-1, part.shape[1], 1)
        place = np.broadcast_to(row, part[acts].shape), np.broadcast_to(column[acts], part[acts].shape)
        shape = (acts.sum() * part.shape[1], 9 * count)
        blocks.append(sparse.csr_array((part[acts].ravel(), tuple(p.ravel() for p in place)), shape=shape))
    return sparse.csr_array(sparse.vstack(blocks) @ incidence(state, count, free, 9).T)


def _excluded_bodies(state: State, rattlers: bool | np.ndarray, parted: np.ndarray) -> np.ndarray:
    """Return the mask (B,) of the grains to exclude; contacts in the rows `parted` do not support grains."""
    n, loose = len(state.grains.radius), np.zeros(state.n_bodies, bool)
    if not isinstance(rattlers, bool):
        if np.shape(rattlers) != (n,):
            raise ValueError(
                f"rattlers must be True, False, or one bool for each grain, got shape {np.shape(rattlers)}"
            )
        loose[:n] = rattlers
    elif not rattlers:
        modes = state.contacts.mode.copy()  # some contacts have parted, such as those of rattlers moved aside by a path
        modes[parted] = OPEN
        loose[:n] = loose_grains(state._replace(contacts=state.contacts._replace(mode=modes)))
    return loose


def contact_frames(normal: np.ndarray, slip: np.ndarray, dim: int) -> np.ndarray:
    """Return axes n, t and t′ (C, dim, 3): t is clockwise from n in a plane, and along the slip in three dimensions.

    Without slip, t is perpendicular to the axis that is farthest from n.
    """
    if dim == 2:
        return np.stack([normal, np.stack([normal[:, 1], -normal[:, 0], np.zeros(len(normal))], axis=1)], axis=1)
    farthest = np.eye(3)[np.abs(normal).argmin(axis=1)]
    along = np.where(slip.any(axis=1)[:, None], slip, np.cross(normal, farthest))
    along = along - np.einsum("ck,ck->c", along, normal)[:, None] * normal
    along /= np.linalg.norm(along, axis=1)[:, None]
    return np.stack([normal, along, np.cross(normal, along)], axis=1)


def _directions(rows, frame, count: int):
    """Return the sparse matrix (6 count, dM) that gives (F, T/R) of each contact from its components."""
    m, width = frame.shape[:2]
    load = np.concatenate([frame, -np.cross(frame[:, :1], frame)], axis=2)
    if width == 2:
        load[:, 1, 3:] = [0.0, 0.0, 1.0]
    row = np.broadcast_to((6 * rows[:, None] + np.arange(6))[:, None, :], load.shape)
    column = np.broadcast_to(np.arange(width * m).reshape(m, width, 1), load.shape)
    turns = np.ones(load.shape, bool)
    turns[:, 0, 3:] = False
    return sparse.csr_array((load[turns], (row[turns], column[turns])), shape=(6 * count, width * m))


def _geometric_stiffness(state: State, law: Law, line: Linearisation, matrix: LinearSystem):
    """Return the geometric stiffness (n, n): −J of sticking contacts minus c K cᵀ."""
    rows, kept, slip = matrix.rows, np.zeros(len(line.normal)), np.zeros_like(line.slip)
    if matrix.width == 2:
        return _geometric_stiffness_in_plane(state, line, matrix)
    kept[rows] = 1.0
    k_t, pull = matrix.springs[:, 1, 1], np.einsum("ma,mak->mk", matrix.force[:, 1:], matrix.frame[:, 1:])
    slip[rows] = -pull / np.where(k_t > 0, k_t, 1.0)[:, None]
    line = line._replace(
        before=slip, slip=slip, closed=kept * line.closed, force_n=kept * line.force_n, secant=kept * line.secant
    )
    whole = stiffness_of(state, line, blocks_of(state, law, line)[0], matrix.free)
    stuck = stiffness_matrix(matrix, np.zeros(matrix.count, bool), geometric=False)
    return sparse.csr_array(-whole - stuck + matrix.machine)


def _geometric_stiffness_in_plane(state: State, line: Linearisation, matrix: LinearSystem):
    """Return the geometric stiffness (n, n) in two dimensions, from the force (F_n t − F_t n)(t·dr)/|r|.

    This form avoids the round-off of a difference, which could decide at a fork which path is taken.
    """
    rows, force, (normal, along) = matrix.rows, matrix.force, matrix.frame.transpose(1, 0, 2)
    turning = line.inverse[rows, None] * (force[:, :1] * along - force[:, 1:] * normal)
    blocks, vectors = np.zeros((len(line.normal), 6, 6)), np.zeros_like(line.normal)
    blocks[rows, :3, :3] = turning[:, :, None] * along[:, None, :]
    vectors[rows] = force[:, :1] * normal + force[:, 1:] * along
    line = line._replace(normal=vectors, force_n=np.ones(len(vectors)), secant=np.zeros(len(vectors)))
    return sparse.csr_array(-stiffness_of(state, line, blocks, matrix.free))


def statuses(matrix: LinearSystem, sliding) -> np.ndarray:
    """Return the blocks S (M, d, d) of all contacts; `sliding` is a mask (M,)."""
    out = np.tile(np.eye(matrix.width), (matrix.count, 1, 1))
    out[sliding, 1, 1] = 0.0
    out[sliding, 1, 0] = -(matrix.slope * matrix.sign)[sliding]
    return out


def block_diagonal(parts: np.ndarray):
    """Return the sparse block-diagonal matrix (dM, dM) of the blocks `parts` (M, d, d)."""
    m, width = parts.shape[:2]
    return sparse.bsr_array((parts, np.arange(m), np.arange(m + 1)), shape=(width * m, width * m))


@checked
def stiffness_matrix(matrix: LinearSystem, sliding: Numbers | None = None, *, geometric: bool = True):
    """Return the sparse k = c K S cᵀ (n, n), with df_ext/dt = k v, plus the geometric and the machine's stiffness.

    For these statuses, it equals −J, with the Jacobian J of the forces.

    Parameters
    ----------
    sliding : (M,) bool, mask of sliding contacts; default: those currently at the Coulomb limit
    geometric : whether the forces rotate with the contacts
    """
    sliding = _status_of_all(matrix, sliding)
    k = matrix.c @ block_diagonal(matrix.springs @ statuses(matrix, sliding)) @ matrix.c.T + matrix.machine
    return sparse.csr_array(k + matrix.geometric if geometric else k)


def force_rates(matrix: LinearSystem, sliding: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return the force rates dF/dt = −K S cᵀ v (M, d) of all contacts; `sliding` is a mask (M,), `velocity` is (n,)."""
    relative = (matrix.c.T @ velocity).reshape(-1, matrix.width)
    stretched = np.einsum("mab,mb->ma", statuses(matrix, sliding), relative)
    return -np.einsum("mab,mb->ma", matrix.springs, stretched)


def _status_of_all(matrix: LinearSystem, sliding) -> np.ndarray:
    """Return the mask (M,) of sliding contacts: the given mask or, by default, contacts now at the Coulomb limit."""
    sliding = matrix.limit if sliding is None else np.asarray(sliding, bool)
    if sliding.shape != (matrix.count,):
        raise ValueError(
            f"sliding must have one status for each of the {matrix.count} contacts, got shape {sliding.shape}"
        )
    return sliding


@checked
def damping_matrix(matrix: LinearSystem, sliding: Numbers | None = None):
    """Return the sparse c Γ cᵀ (n, n), the derivative of −f with respect to velocities; equal to −C for these statuses.

    A sliding contact has no dashpot along t; its tangential force is μ times the normal force, dashpot included.
    """
    sliding = _status_of_all(matrix, sliding)
    damping = np.einsum("ma,ab->mab", matrix.damping[:, [0, 1, 1][: matrix.width]], np.eye(matrix.width))
    damping[sliding, 1, 1] = 0.0
    damping[sliding, 1, 0] = -(matrix.sign * matrix.mu * matrix.damping[:, 0])[sliding]
    return sparse.csr_array(matrix.c @ block_diagonal(damping) @ matrix.c.T)


@checked
def quadratic_form(matrix: LinearSystem, velocity: Numbers, sliding: Numbers | None = None) -> float:
    """Q = vᵀ k v without geometric stiffness; stability is assumed to mean Q > 0 for all v (Eq. 41)."""
    require_shape((len(matrix.free),), velocity=velocity)
    return float(velocity @ (stiffness_matrix(matrix, sliding, geometric=False) @ velocity))


def append_wall_rotations(state: State, matrix, arm: float):
    """Append the rotations of all walls, in the order of the walls, to the coordinates of a `LinearSystem`.

    Parameters
    ----------
    matrix : LinearSystem of disks between walls that only translate
    arm : factor on the angle of a wall [length]
    """
    _check_walls(state)
    rows, c, free = matrix.rows, matrix.c, matrix.free
    n, count = len(state.grains.radius), len(state.walls.mass)
    mine = np.flatnonzero(state.contacts.j[rows] >= n)
    body, wall = state.contacts.i[rows[mine]], state.contacts.j[rows[mine]]
    normal = state.walls.normal[wall - n]
    along = np.stack([normal[:, 1], -normal[:, 0], np.zeros(len(mine))], axis=1)
    apart = state.grains.position[body] - state.walls.point[wall - n]
    lever, height = np.einsum("ck,ck->c", apart, along), np.einsum("ck,ck->c", apart, normal)
    c_more = sparse.csr_array((-lever / arm, (wall - n, 2 * mine)), shape=(count, c.shape[1]))

    f_n, f_t = matrix.force[mine].T
    own, size, held = len(free) + wall - n, len(free) + count, np.append(free.place, -1)
    entries = [(own, own, f_n * height / arm**2)]
    for k in range(2):
        bends = (f_n * along[:, k] - f_t * normal[:, k]) / arm
        pulls = f_n * along[:, k] / arm
        for end, sign in ((body, 1.0), (wall, -1.0)):
            place = held[6 * end + k]
            entries += [(place, own, sign * bends), (own, place, sign * pulls)]
    row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    kept = (row >= 0) & (column >= 0)
    more = sparse.csr_array((value[kept], (row[kept], column[kept])), shape=(size, size))
    still = sparse.csr_array((count, count))
    # the rotation of each wall about z; the arm serves as its radius of gyration
    component, held_at = 6 * (n + np.arange(count)) + 5, free.place.copy()
    held_at[component] = len(free) + np.arange(count)
    mass = np.append(free.mass, state.walls.mass)
    padded, machine = (sparse.block_diag([a, still], format="csr") for a in (matrix.geometric, matrix.machine))
    return matrix._replace(
        c=sparse.csr_array(sparse.vstack([c, c_more])), geometric=sparse.csr_array(padded + more),
        machine=sparse.csr_array(machine),
        free=Freedom(np.append(free.component, component), mass, free.dim, held_at, free.length),
    )  # fmt: skip


def _check_walls(state: State) -> None:
    n = len(state.grains.radius)
    if state.cell.dim != 2:
        raise ValueError("wall_arm does not apply in three dimensions, where walls only translate: leave it out")
    if not len(state.walls.mass):
        raise ValueError("wall_arm does not apply, as the packing has no walls: leave it out")
    if state.cell.periodic.any():
        raise ValueError("wall_arm does not apply in a periodic cell, where a wall cannot rotate: leave it out")
    if (state.control.group[n:] >= 0).any():
        raise ValueError(
            "wall_arm requires a wall that can rotate, unlike one in a rigid group: remove the wall from the group"
        )
