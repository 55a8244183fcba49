"""Unresisted motions: null modes of the stiffness matrix, and rigid clusters of a frictional packing.

Clusters follow from linear algebra, or from the (3,3) pebble game for generic rigidity of bodies in a plane joined by
bars. In the game, a body has three pebbles, its degrees of freedom. An independent bar takes one pebble from one of its
two bodies; a bar is independent if four pebbles can be collected at its ends. A block of n bodies with 3n − 3
independent bars is tight, and thus rigid. Blocks that share a body form one block; rigid blocks can therefore be
contracted to a single body as soon as they appear. A bar within a block is then redundant, and any other bar is
independent.

Source: Jacobs and Hendrickson (1997), doi:10.1006/jcph.1997.5809; Lee and Streinu (2008), pebble game algorithms and
sparse graphs, doi:10.1016/j.disc.2007.07.104; McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. III
E, for the classes of null modes, which are motions that quasi-static balance leaves undetermined.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import null_space, qr, svd
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from ... import Law, State
from ...kit import Committed, Numbers, Positive, checked, readable, supports
from ...measure import branch_vectors, rattlers
from ...results import Freedom
from .matrices import LinearSystem, linear_system, stiffness_matrix
from .system import elimination_order, load_of

SHIFT, MORE = 1e-12, 100.0  # shift of squared singular values, so that none is zero; factor to a second, larger shift
REPEATS = 4  # number of solves; each reduces other components by SHIFT over their squared singular value
SAMPLES = 4  # number of random vectors of the null space
STILL = 1e-7  # fraction of the largest motion or self-stress below which it is zero
PLANE = (0, 1, 5)  # x, y and rotation


@readable(head=lambda value: f"{len(value.sizes)} rigid clusters, the largest of {value.sizes.max(initial=0)} bodies")
class RigidClusters(NamedTuple):
    """Rigid clusters of B bodies with M contacts, numbered from 0 by decreasing size; −1 denotes none."""

    body: np.ndarray  # (B,) cluster of each grain, then of each wall; −1 if no other body moves with it
    contact: np.ndarray  # (M,) cluster of each contact; −1 for a hinge, whose bodies may move relative to each other
    sizes: np.ndarray  # (K,) number of bodies
    overconstrained: np.ndarray  # (M,) bool, contacts that carry a self-stress
    floppy: int  # number of independent unresisted motions, including those of rattlers and of the whole packing
    constraints: int  # two per sticking contact of disks, three per sticking contact of spheres, one per sliding one
    redundant: int  # number of constraints that could be removed without adding a motion
    rows: np.ndarray  # (M,) rows of the contacts in the contact list
    sliding: np.ndarray  # (M,) bool


@checked
def rigid_clusters(
    state: Committed, law: Law, *, method: Literal["null-space", "pebbles"] = "null-space"
) -> RigidClusters:
    """Decompose a packing into clusters that move as rigid bodies in every unresisted motion.

    A contact below its Coulomb limit resists any relative velocity of the two surfaces; a sliding contact resists only
    the velocity along its normal. Walls, rigid groups and fixed bodies are bodies like grains. Everything held in place
    is one additional body; the cell is fixed. Springs are not constraints. Contact points divide the line of centres in
    proportion to the radii, so that a rigid rotation of overlapping disks or spheres does not count as slip: their
    lever arms are R |r|/(R_i + R_j), and R − δ at a wall.

    Parameters
    ----------
    state : accepted state of disks or spheres
    law : Law with sharp Coulomb friction
    method : "null-space" uses the positions of disks or spheres; 10,000 disks need 2 s, 1000 spheres 2 s, and 3000
        spheres 40 s. "pebbles" is the (3,3) pebble game for disks, which only counts constraints and treats the lines
        of contact forces as generic. It overlooks the spins of disks whose contacts all slide, the counter-rotation of
        disks in networks without odd loops, and the fact that a cluster around a periodic cell cannot rotate

    Returns
    -------
    RigidClusters

    Raises
    ------
    ValueError
        If there are no contacts; if the law has no friction, smooth friction or rolling resistance; or if `method` is
        "pebbles" for spheres.

    Notes
    -----
    The null space of the constraint matrix A is sampled by random vectors, to which (AᵀA + εI)⁻¹ is applied four times
    with ε = 1e-12 and a sparse factor. The rank follows from the growth of det(AᵀA + εI) with ε. Two bodies move as one
    in all motions if they do in all samples. A contact is overconstrained if a random vector of the left null space,
    a self-stress, has a component at that contact. Motions that distort contacts by less than about 1e-4 of their
    amplitude cannot be distinguished from floppy ones.

    Sources: Henkes, Quint, Fily & Schwarz (2016), doi:10.1103/PhysRevLett.116.028001, for the game with friction; Liu,
    Kollmer, Daniels, Schwarz & Henkes (2021), doi:10.1103/PhysRevLett.126.088002, for its comparison with motions.

    Examples
    --------
    Three disks that touch each other are rigid; a fourth disk rolls on one of them:

    >>> import numpy as np
    >>> import stickslip as ss
    >>> law = ss.laws.linear(kn=1.0, kt=0.5, mu=0.4)
    >>> places = 0.99 * np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [2, 0]])
    >>> state = ss.packings.from_arrays(places, np.full(4, 0.5), law, dim=2)
    >>> clusters = ss.quasirigid.rigid_clusters(state, law)
    >>> clusters.body, clusters.floppy
    (array([ 0,  0,  0, -1]), 4)
    """
    if method == "pebbles" and state.cell.dim == 3:
        raise ValueError('method = "pebbles" is valid for disks only: use method="null-space" for spheres')
    held = state._replace(control=state.control._replace(cell_free=np.zeros((3, 3), bool)))
    matrix = linear_system(held, law, rattlers=True)
    if not matrix.count:
        raise ValueError("the packing has no contacts, which rigid clusters need: compress it first")
    if not matrix.mu.any():
        raise ValueError("rigid clusters need friction, as they consist of sticking contacts: use mu > 0")
    return (_by_pebbles if method == "pebbles" else _by_null_space)(held, matrix)


def _sliding(matrix: LinearSystem) -> np.ndarray:
    return matrix.limit | (matrix.mu == 0)


def _by_pebbles(state: State, matrix: LinearSystem) -> RigidClusters:
    """Find clusters by the pebble game; bars join fixed components to a fixed body."""
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
    """Find clusters from samples of the right and left null spaces of the constraint matrix."""
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
    """Return a sparse matrix (constraints, n) of relative velocities that contacts resist, and each row's contact."""
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
    """Return the rank of a sparse matrix (m, n) and random vectors of its right and left null spaces (n, k) and (m, k).

    Each vector is zero or has a largest component of 1.
    """
    random = np.random.default_rng(0)
    stresses = random.normal(size=(a.shape[0], SAMPLES))
    if not len(order):
        return 0, np.zeros((0, SAMPLES)), _scaled(stresses)
    a = sparse.csc_array(a)[:, order]
    factor, lifted = _shifted_factor(a, SHIFT), _shifted_factor(a, MORE * SHIFT)
    # det(AᵀA + ε) is the product of all σ² + ε, and therefore proportional to ε^nullity
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
    """Number the clusters of labelled bodies by decreasing size; return the cluster of each body, and the sizes."""
    _, label, size = np.unique(block, return_inverse=True, return_counts=True)
    order = np.argsort(-size, kind="stable")
    number = np.empty(len(size), int)
    number[order] = np.where(size[order] > 1, np.arange(len(size)), -1)
    return number[label], size[order][size[order] > 1]


PEBBLES = 3


class PebbleGame:
    """Play the game for bodies 0 … `bodies` − 1 and a list `bars` of pairs of bodies; parallel bars are allowed.

    Afterwards, `redundant` lists the dependent bars, and `block` returns the rigid block of a body.
    """

    def __init__(self, bodies: int, bars: list[tuple[int, int]]):
        self.bars, self.redundant = bars, []
        self.free, self.out = [PEBBLES] * bodies, [[] for _ in range(bodies)]  # per block: pebbles, bars it pays for
        self.touching: list[list[int]] = [[] for _ in range(bodies)]  # per block: independent bars at its bodies
        self.head = [0] * len(bars)  # end of each independent bar that does not pay for it
        # union by size without shortcuts: each step towards the root records the contraction that made it
        self.parent, self.size, self.when = list(range(bodies)), [1] * bodies, [len(bars)] * bodies
        self.events: list[list[int]] = []  # independent bars among the blocks of each contraction
        for number in range(len(bars)):
            self._insert(number)

    def block(self, body: int, before: int | None = None) -> int:
        """Rigid block of a body, at the end or before a contraction."""
        before = len(self.events) if before is None else before
        while self.when[body] < before:
            body = self.parent[body]
        return body

    def _insert(self, bar: int) -> None:
        a, b = self.bars[bar]
        u, v = self.block(a), self.block(b)
        if u == v:
            self.redundant.append(bar)
            return
        while self.free[u] + self.free[v] <= PEBBLES:
            self._collect(u, v)
        tail, self.head[bar] = (u, b) if self.free[u] else (v, a)
        self.free[tail] -= 1
        self.out[tail].append(bar)
        for end in (u, v):
            self.touching[end].append(bar)
        if self.free[u] + self.free[v] == PEBBLES:
            reached, pebble = self._search(u, v)
            if pebble is None:
                self._grow(list(reached))

    def _search(self, u: int, v: int) -> tuple[dict, int | None]:
        """Blocks reached along bars from u and v, each with its bar and previous block, and a block with a pebble."""
        reached: dict = {u: None, v: None}
        queue = [u, v]
        for block in queue:
            for bar in self.out[block]:
                other = self.block(self.head[bar])
                if other not in reached:
                    reached[other] = (bar, block)
                    if self.free[other]:
                        return reached, other
                    queue.append(other)
        return reached, None

    def _collect(self, u: int, v: int) -> None:
        """Move a pebble to u or v by reversing the bars on the way to it."""
        reached, block = self._search(u, v)
        if block is None:
            raise AssertionError("no pebble is left for a bar between two rigid blocks")
        self.free[block] -= 1
        while reached[block] is not None:
            bar, before = reached[block]
            self.out[before].remove(bar)
            self.out[block].append(bar)
            a, b = self.bars[bar]
            self.head[bar] = a if self.head[bar] == b else b
            block = before
        self.free[block] += 1

    def _grow(self, blocks: list[int]) -> None:
        """Contract blocks, and then everything that has become rigid with them, the smallest part first.

        Such a part pays for a bar into a block that is new to the largest block; otherwise, it would have been rigid
        with that block before.
        """
        suspects = self._contract(blocks)
        while suspects:
            root, block = self.block(blocks[0]), self.block(suspects[-1])
            reached, pebble = ({}, 0) if root == block or self.free[block] else self._search(root, block)
            if pebble is None:
                suspects += self._contract([root, *self._smallest(reached, root)])
            else:
                suspects.pop()

    def _smallest(self, reached: dict, root: int) -> list[int]:
        """Smallest part of the blocks `reached` that pays only for internal bars and bars into the root."""
        blocks = [block for block in reached if block != root]
        number = {block: k for k, block in enumerate(blocks)}
        ends = [(number[b], self.block(self.head[bar])) for b in blocks for bar in self.out[b]]
        ends = [(k, number[other]) for k, other in ends if other != root]
        if not ends:
            return blocks[:1]
        row, column = np.array(ends).T
        graph = sparse.coo_array((np.ones(len(row)), (row, column)), shape=(len(blocks), len(blocks)))
        part = connected_components(graph, connection="strong")[1]
        leaves = np.bincount(part[row], part[row] != part[column], len(blocks))[part] > 0
        return [block for k, block in enumerate(blocks) if part[k] == part[~leaves][0]]

    def _contract(self, blocks: list[int]) -> list[int]:
        """Contract blocks to one; return the blocks that pay for bars into any of them except the largest."""
        root = max(blocks, key=self.size.__getitem__)
        event = len(self.events)
        self.events.append([bar for block in blocks for bar in self.out[block]])
        outside = []
        for block in blocks:
            self.out[block] = []
            if block != root:
                self.parent[block], self.when[block] = root, event
                self.size[root] += self.size[block]
                outside += self.touching[block]
        self.touching[root] += outside
        self.free[root] = PEBBLES
        ends = [self.block(end) for bar in outside for end in self.bars[bar]]
        return [end for end in ends if end != root]

    def stressed(self) -> set[int]:
        """Bars that carry a self-stress: redundant bars, and bars whose removal would make a redundant bar independent.

        The latter are the bars of the smallest tight block that contains both ends of a redundant bar. A contraction
        joins smaller blocks. If a self-stress crosses a contraction, all bars of the contraction are stressed, and so
        are those of the smallest blocks that connect their ends within each of the joined blocks.
        """
        marked, joined, crossed = set(self.redundant), _Sets(len(self.parent)), {}
        tasks: list = [self.bars[bar] for bar in self.redundant]
        while tasks:
            task = tasks.pop()
            if isinstance(task, int):  # blocks joined by this contraction are now connected by stressed bars
                for bar in self.events[task]:
                    joined.unite(*self.bars[bar])
            elif joined.root(task[0]) != joined.root(task[1]):
                event = self._meeting(*task)
                if event not in crossed:
                    marked.update(self.events[event])
                    tasks.append(event)
                    crossed[event] = ends = {}
                    for body in (end for bar in self.events[event] for end in self.bars[bar]):
                        tasks.append((ends.setdefault(self.block(body, event), body), body))
                tasks += [(crossed[event][self.block(body, event)], body) for body in task]
        return marked

    def _meeting(self, x: int, y: int) -> int:
        """Contraction that joined two bodies in one block."""
        event = -1
        while x != y:
            x, y = (x, y) if self.when[x] <= self.when[y] else (y, x)
            event, x = self.when[x], self.parent[x]
        return event


class _Sets:
    """Disjoint sets of numbers."""

    def __init__(self, count: int):
        self.parent = list(range(count))

    def root(self, x: int) -> int:
        while self.parent[x] != x:
            self.parent[x] = x = self.parent[self.parent[x]]
        return x

    def unite(self, x: int, y: int) -> None:
        self.parent[self.root(x)] = self.root(y)


ZERO = 1e-10  # fraction of the largest singular value below which a singular value is zero
ALIKE = 0.9  # fraction of the rigid rotation in the null modes above which it counts as one of them
DENSE_UP_TO = 6000  # largest number of coordinates for which singular values are computed
RIGID, RATTLER, IDLE, DRIVEN = (
    "a rigid motion of the apparatus",
    "a rattler, which supports nothing",
    "a mechanism that the load does not excite",
    "a mechanism that the load drives: the packing collapses",
)


@readable
class Mechanism(NamedTuple):
    """Null mode of k, an unresisted motion."""

    kind: str  # RIGID, RATTLER, IDLE or DRIVEN
    vector: np.ndarray  # (n,) mode of unit length, in the coordinates of `linear_system(state, law, rattlers=True)`
    power: float  # |load · left null vector| over |load|; balance is possible if it is zero
    deforms: bool  # True if a contact moves, and thus slides; otherwise no contact is affected
    quotient: float = 0.0  # vᵀkv; nonzero only for a rigid rotation, which causes slip at overlaps [force/length]

    def __str__(self):
        return self.kind


@checked
def mechanisms(
    state: State,
    law: Law,
    load: np.ndarray | None = None,
    sliding: Numbers | None = None,
    *,
    wall_arm: Positive | None = None,
) -> list[Mechanism]:
    """Find all null modes of k, classified as in Sec. III E of McNamara and Herrmann.

    Parameters
    ----------
    load : (n,) rate of the external load on all free coordinates, including rattlers [force/time]; default: no load
    sliding : (M,) bool, sliding contacts of `linear_system(state, law, rattlers=True)`; default: those at the limit
    wall_arm : arm of walls that may also rotate, as in `linear_system`; the rotation of the whole packing about a point
        is then RIGID, too, if only overlaps resist it; its `quotient` is correspondingly small

    Returns
    -------
    list of Mechanism
        in this order: rigid motions, rattlers, mechanisms that the load does not drive, and mechanisms that it drives

    Raises
    ------
    ValueError
        If there are more than 6000 coordinates, for which singular values take too long.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, law = ss.packings.biaxial_box(30, pressure=1e-3, seed=1)
    >>> found = ss.quasirigid.mechanisms(state, law)
    >>> sum(one.deforms for one in found)
    0
    """
    matrix = linear_system(state, law, rattlers=True, wall_arm=wall_arm)
    size = len(matrix.free)
    if size > DENSE_UP_TO:
        raise ValueError(f"null modes are computed for at most {DENSE_UP_TO} coordinates, got {size}")
    load = np.zeros(size) if load is None else load_of(matrix, load)
    k = stiffness_matrix(matrix, sliding, geometric=False).toarray()
    rigid = _rigid_motions(matrix)
    turn = np.zeros((size, 0))  # rotation of the whole packing, if only overlaps resist it
    if wall_arm is not None:
        move = rigid_rotation(state, matrix.free, wall_arm)
        if not resists_turning(state, matrix.rows, (matrix.c.T @ move).reshape(-1, 2)):
            turn = (move / np.linalg.norm(move))[:, None]
    loose = rattlers(state, 2)
    loose_coordinates = np.flatnonzero(
        np.append(loose, np.zeros(state.n_bodies - len(loose) + 1, bool))[matrix.free.body]
    )
    out = [Mechanism(RIGID, v, _load_share(load, v), False) for v in rigid.T]
    out += [Mechanism(RIGID, v, _load_share(load, v), True, float(v @ k @ v)) for v in turn.T]
    out += [Mechanism(RATTLER, np.eye(size)[c], _load_share(load, np.eye(size)[c]), False) for c in loose_coordinates]
    rest = np.setdiff1d(np.arange(size), loose_coordinates)
    return out + _find_mechanisms(matrix, k, rest, rigid[rest], turn[rest], load)


def _load_share(load: np.ndarray, vector: np.ndarray) -> float:
    size = np.linalg.norm(load)
    return float(abs(load @ vector) / size) if size else 0.0


def _rigid_motions(matrix: LinearSystem) -> np.ndarray:
    """Orthonormal translations (n, r) of the whole packing that no contact and no fixed body resists."""
    moves = []
    for axis in range(matrix.free.dim):
        move = (matrix.free.axis == axis).astype(float)
        if move.any() and np.abs(matrix.c.T @ move).max(initial=0.0) < 1e-12:
            moves.append(move / np.linalg.norm(move))
    return np.stack(moves, axis=1) if moves else np.zeros((len(matrix.free), 0))


def _find_mechanisms(matrix: LinearSystem, k, rest, rigid, turn, load) -> list[Mechanism]:
    """Null modes of the coordinates `rest` without rigid motions: idle modes, then modes driven by the load."""
    if not len(rest):
        return []
    part = k[np.ix_(rest, rest)]
    left, values, right = svd(part)
    zero = values < ZERO * values.max(initial=0.0)
    null, co = right[zero].T, left[:, zero]
    if rigid.shape[1]:
        base = qr(rigid, mode="economic")[0]
        null, co = _complement(null, base), _complement(co, base)
    if turn.shape[1]:  # at very small overlaps, the rotation is a null mode of k, which must not be counted twice
        null, co = _without_rotation(null, turn, rigid), _without_rotation(co, turn, rigid)
    if not null.shape[1]:
        return []
    # one direction of the left null space contains the whole load; the corresponding motion is driven
    taken = co.T @ load[rest]
    size = np.linalg.norm(load)
    power = float(np.linalg.norm(taken) / size) if size else 0.0
    driven = []
    if power > 1e-9:
        along = null.T @ load[rest]  # if the load is orthogonal to all modes, the first is driven
        answer = null @ (along if np.linalg.norm(along) > 1e-12 * np.linalg.norm(load[rest]) else np.eye(len(along))[0])
        driven = [_make_mechanism(DRIVEN, matrix, rest, answer, power)]
        null = _complement(null, (answer / np.linalg.norm(answer))[:, None])
    return [_make_mechanism(IDLE, matrix, rest, v, 0.0) for v in null.T] + driven


def _complement(vectors: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the part of the span of `vectors` orthogonal to `base`."""
    inside = null_space(base.T @ vectors, rcond=1e-8) if vectors.shape[1] else np.zeros((0, 0))
    return vectors @ inside


def _without_rotation(vectors: np.ndarray, turn: np.ndarray, rigid: np.ndarray) -> np.ndarray:
    """Null vectors without the rigid rotation, if they contain it."""
    base = qr(rigid, mode="economic")[0]
    turn = turn - base @ (base.T @ turn)
    inside = vectors @ (vectors.T @ turn) / np.linalg.norm(turn)
    return _complement(vectors, inside) if np.linalg.norm(inside) > ALIKE else vectors


def _make_mechanism(kind: str, matrix: LinearSystem, rest, vector, power: float) -> Mechanism:
    full = np.zeros(len(matrix.free))
    full[rest] = vector / np.linalg.norm(vector)
    return Mechanism(kind, full, power, bool(np.abs(matrix.c.T @ full).max(initial=0.0) > 1e-8))


def rigid_rotation(state: State, free: Freedom, arm: float) -> np.ndarray:
    """Return velocities (n,) of a rotation with unit angular velocity about the mean position of all moving bodies.

    Parameters
    ----------
    free : coordinates of `linear_system(..., wall_arm=arm)`
    """
    position = np.concatenate([state.grains.position, state.walls.point])
    radius = np.append(state.grains.radius, np.full(len(state.walls.mass), arm))
    x, y = position[free.body, 0], position[free.body, 1]
    out = radius[free.body]
    for axis, value in ((0, -y), (1, x)):
        mine = free.axis == axis
        out[mine] = (value - value[mine].mean())[mine] if mine.any() else 0.0
    return out


def resists_turning(state: State, rows, relative: np.ndarray) -> bool:
    """Return True if a rotation with unit angular velocity moves contacts by more than their overlaps.

    Parameters
    ----------
    relative : (M, 2) V = cᵀ v of the contacts `rows` [length]
    """
    radius = np.append(state.grains.radius, np.zeros(len(state.walls.mass)))
    i, j = state.contacts.i[rows], state.contacts.j[rows]
    overlap = radius[i] + radius[j] - np.linalg.norm(branch_vectors(state)[rows], axis=1)
    slack = 1e-9 * float(state.grains.radius.max())
    return bool((np.abs(relative[:, 0]) > slack).any() or (np.abs(np.abs(relative[:, 1]) - overlap) > slack).any())
