"""Rigid clusters of a frictional packing, by the pebble game and by linear algebra."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from ... import Law, State
from ...core.measure import Committed, supports
from ...kit import checked, readable
from ...measure import branch_vectors
from .matrices import LinearSystem, linear_system
from .pebbles import PEBBLES, PebbleGame
from .system import elimination_order

SHIFT, MORE = 1e-12, 100.0  # added to squared singular values, so that none is zero; a larger one by this factor
REPEATS = 4  # of a solve; each one reduces what is not null by SHIFT over its squared singular value
SAMPLES = 4  # random vectors of the null space
STILL = 1e-7  # of the largest motion or self-stress, below which one is zero
PLANE = (0, 1, 5)  # x, y and rotation


@readable(head=lambda value: f"{len(value.sizes)} rigid clusters, the largest of {value.sizes.max(initial=0)} bodies")
class RigidClusters(NamedTuple):
    """Rigid clusters of B bodies with M contacts, numbered from 0 by decreasing size; −1 stands for none."""

    body: np.ndarray  # (B,) cluster of each grain, then of each wall; −1 if nothing moves with it
    contact: np.ndarray  # (M,) cluster of each contact; −1 for a hinge, whose bodies may move against each other
    sizes: np.ndarray  # (K,) number of bodies
    overconstrained: np.ndarray  # (M,) bool: contacts that bear a self-stress
    floppy: int  # number of independent motions that no contact resists, with those of rattlers and of the whole
    constraints: int  # two for a sticking contact of disks, three for one of spheres, one for a sliding contact
    redundant: int  # constraints without which the motions were the same
    rows: np.ndarray  # (M,) rows of the contacts in the contact list
    sliding: np.ndarray  # (M,) bool


@checked
def rigid_clusters(state: Committed, law: Law, *, method: str = "null-space") -> RigidClusters:
    """Decompose a packing into clusters that every motion without resistance moves as rigid bodies.

    A contact below its Coulomb limit resists any relative velocity of the two surfaces, a sliding one only that along
    its normal. Walls, rigid groups and fixed bodies are bodies like grains, and what is held in place is one more; the
    cell is fixed. Springs are no constraints. Grains touch where the line of centres is shared in proportion to the
    radii, so that a rigid rotation of disks or spheres that overlap does not count as slip: their arms are
    R |r|/(R_i + R_j), and R − δ at a wall.

    Parameters
    ----------
    state : accepted state of disks or spheres
    law : Law with sharp Coulomb friction
    method : "null-space" uses the positions and takes disks and spheres; 10,000 disks take 2 s, 1000 spheres 2 s, and
        3000 spheres 40 s. "pebbles" is the (3,3) pebble game of disks, which only counts: it takes the lines of contact
        forces for arbitrary ones. It overlooks the spins of disks all of whose contacts slide, the counter-rotation of
        disks in networks without odd loops, and that a cluster around a periodic cell cannot rotate

    Returns
    -------
    RigidClusters

    Raises
    ------
    ValueError
        if there are no contacts, if the law has no or smooth friction or resists rolling, or for spheres with
        "pebbles".

    Notes
    -----
    The null space of the constraint matrix A is sampled by random vectors, on which (AᵀA + εI)⁻¹ acts four times, with
    ε = 1e-12 and a sparse factor; how det(AᵀA + εI) grows with ε gives the rank. Two bodies move as one in all motions
    if they do in such samples. A contact is overconstrained if a random vector of the left null space, a self-stress,
    has a component there. Motions that distort contacts by less than about 1e-4 of their amplitude cannot be told from
    floppy ones.

    Sources: Henkes, Quint, Fily & Schwarz (2016), doi:10.1103/PhysRevLett.116.028001, for the game with friction; Liu,
    Kollmer, Daniels, Schwarz & Henkes (2021), doi:10.1103/PhysRevLett.126.088002, for its comparison with motions.

    Examples
    --------
    Three disks that touch each other are rigid, a fourth rolls on one of them:

    >>> import numpy as np
    >>> import stickslip as ss
    >>> law = ss.laws.linear(kn=1.0, kt=0.5, mu=0.4)
    >>> places = 0.99 * np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [2, 0]])
    >>> state = ss.packings.from_arrays(places, np.full(4, 0.5), law, dim=2)
    >>> clusters = ss.quasirigid.rigid_clusters(state, law)
    >>> clusters.body, clusters.floppy
    (array([ 0,  0,  0, -1]), 4)
    """
    if method not in ("null-space", "pebbles"):
        raise ValueError(f'method = {method!r} was given: give "null-space" or "pebbles"')
    if method == "pebbles" and state.cell.dim == 3:
        raise ValueError(
            'method = "pebbles" was given for spheres: the game holds for disks only, use method="null-space"'
        )
    held = state._replace(control=state.control._replace(cell_free=np.zeros((3, 3), bool)))
    matrix = linear_system(held, law, rattlers=True)
    if not matrix.count:
        raise ValueError("a packing without contacts was given: rigid clusters need some, so compress it until it has")
    if not matrix.mu.any():
        raise ValueError(
            "a law without friction was given: rigid clusters are those of contacts that stick, so give mu > 0"
        )
    return (_by_pebbles if method == "pebbles" else _by_null_space)(held, matrix)


def _sliding(matrix: LinearSystem) -> np.ndarray:
    return matrix.limit | (matrix.mu == 0)


def _by_pebbles(state: State, matrix: LinearSystem) -> RigidClusters:
    """Clusters by the pebble game; what is held is a body to which a bar holds each component that is not free."""
    unit, sliding, ground = supports(state)[0], _sliding(matrix), state.n_bodies
    places = matrix.free.place[:-9].reshape(-1, 6)[:, PLANE]
    leads = np.unique(unit)
    bars = [(body, ground) for body in leads for _ in range(np.count_nonzero(places[body] < 0))]
    first = len(bars)
    of_contact = np.repeat(np.arange(matrix.count), np.where(sliding, 1, 2))
    i, j = (unit[ends[matrix.rows]] for ends in (state.contacts.i, state.contacts.j))
    bars += zip(i[of_contact].tolist(), j[of_contact].tolist(), strict=True)
    game = PebbleGame(ground + 1, bars)
    stressed = np.array([bar - first for bar in game.stressed() if bar >= first], int)
    overconstrained = np.zeros(matrix.count, bool)
    overconstrained[of_contact[stressed]] = True
    block = np.array([game.block(body) for body in unit])
    floppy = PEBBLES * len(leads) - (len(bars) - len(game.redundant))
    body, sizes = _numbered(block)
    contact = np.where(block[i] == block[j], body[i], -1)
    counts = floppy, len(of_contact), len(game.redundant)
    return RigidClusters(body, contact, sizes, overconstrained, *counts, matrix.rows, sliding)


def _by_null_space(state: State, matrix: LinearSystem) -> RigidClusters:
    """Clusters by samples of the right and left null spaces of the constraint matrix."""
    constraints, of_contact = _constraint_matrix(state, matrix)
    rank, motions, stresses = _null_samples(constraints, elimination_order(matrix.c, matrix.free.body, matrix.width))
    moves = np.array([matrix.free.spread(motion) for motion in motions.T])
    radius = np.append(state.grains.radius, np.ones(len(state.walls.mass)))
    i, j = state.contacts.i[matrix.rows], state.contacts.j[matrix.rows]
    velocity, spin = moves[..., :3], moves[..., 3:] / radius[:, None]
    carried = np.cross(spin[:, i], branch_vectors(state)[matrix.rows])
    apart = np.concatenate([velocity[:, i] - velocity[:, j] - carried, (spin[:, i] - spin[:, j]) * radius[i, None]], 2)
    together = ~(np.abs(apart) > STILL).any(axis=(0, 2))
    at_rest = np.flatnonzero(~(np.abs(moves) > STILL).any(axis=(0, 2)))
    ends = [
        (i[together], j[together]),
        (at_rest[1:], np.full(max(len(at_rest) - 1, 0), at_rest[:1].sum())),
        (np.arange(state.n_bodies), supports(state)[0]),
    ]
    row, column = (np.concatenate(part) for part in zip(*ends, strict=True))
    graph = sparse.coo_array((np.ones(len(row)), (row, column)), shape=(state.n_bodies, state.n_bodies))
    block = connected_components(graph, directed=False)[1]
    overconstrained = np.bincount(of_contact, (np.abs(stresses) > STILL).any(axis=1), matrix.count) > 0
    body, sizes = _numbered(block)
    counts = len(matrix.free) - rank, constraints.shape[0], constraints.shape[0] - rank
    contact = np.where(together, body[i], -1)
    return RigidClusters(body, contact, sizes, overconstrained, *counts, matrix.rows, _sliding(matrix))


def _constraint_matrix(state: State, matrix: LinearSystem):
    """Relative velocities that contacts resist, sparse (constraints, n), and the contact of each one (constraints,)."""
    i, j = state.contacts.i[matrix.rows], state.contacts.j[matrix.rows]
    radius = np.append(state.grains.radius, np.zeros(len(state.walls.mass)))
    reach = np.linalg.norm(branch_vectors(state)[matrix.rows], axis=1) / (radius[i] + radius[j])
    c = matrix.c.tocoo()
    arm = np.where(matrix.free.axis[c.row] >= 3, reach[c.col // matrix.width], 1.0)
    columns = sparse.csc_array((c.data * arm, (c.row, c.col)), shape=c.shape)
    of_contact = np.repeat(np.arange(matrix.count), matrix.width)
    kept = ~_sliding(matrix)[of_contact] | (np.arange(len(of_contact)) % matrix.width == 0)
    return sparse.csr_array(columns.T)[kept], of_contact[kept]


def _null_samples(a, order: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """Rank of a sparse (m, n) matrix, and random vectors of its right and left null spaces, (n, k) and (m, k).

    Each vector has a largest component of one, or is zero.
    """
    random = np.random.default_rng(0)
    stresses = random.normal(size=(a.shape[0], SAMPLES))
    if not len(order):
        return 0, np.zeros((0, SAMPLES)), _scaled(stresses)
    a = sparse.csc_array(a)[:, order]
    factor, lifted = _shifted_factor(a, SHIFT), _shifted_factor(a, MORE * SHIFT)
    # det(AᵀA + ε) is the product of all σ² + ε, and therefore proportional to ε to the power of the nullity
    growth = np.log(lifted.U.diagonal() / factor.U.diagonal()).sum()
    rank = len(order) - round(float(growth / np.log(MORE)))
    motions = random.normal(size=(len(order), SAMPLES))
    for _ in range(REPEATS):
        motions = SHIFT * factor.solve(motions)
        stresses = stresses - a @ factor.solve(a.T @ stresses)
    out = np.empty_like(motions)
    out[order] = motions
    none = rank == len(order), rank == a.shape[0]
    return rank, *(0 * part if empty else _scaled(part) for part, empty in zip((out, stresses), none, strict=True))


def _shifted_factor(a, shift: float):
    """SuperLU factor of AᵀA + ε I, without pivoting."""
    gram = sparse.csc_array(a.T @ a + shift * sparse.eye_array(a.shape[1]))
    return splu(gram, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _scaled(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.abs(vectors).max(axis=0)


def _numbered(block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cluster of every body from a label of every body, and the sizes of clusters, by decreasing size."""
    _, label, size = np.unique(block, return_inverse=True, return_counts=True)
    order = np.argsort(-size, kind="stable")
    number = np.empty(len(size), int)
    number[order] = np.where(size[order] > 1, np.arange(len(size)), -1)
    return number[label], size[order][size[order] > 1]
