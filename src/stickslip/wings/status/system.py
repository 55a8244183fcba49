"""Solve k(S) v = b for a changing contact status S; one factorisation is corrected while few contacts change."""

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, cholesky, eigvals, qr
from scipy.sparse.linalg import splu

from ... import Law, State, forces, freedom
from ...kit import factorised, with_neighbor_list
from ...modes import residual_vector
from ...results import ContactLoads, Freedom
from .matrices import LinearSystem, linear_system, stiffness_matrix

# number of changed contacts beyond which a factor is recomputed instead of corrected; for 3000 disks, both cost
# the same at 48, but the result of a correction is verified with a new factor
FEW = 24
RESIDUAL = 1e-6  # largest residual of k(S) v over the load; beyond it k(S) is treated as singular
NEUTRAL = 1e-9  # ratio of stiffness to contact stiffness below which a cluster rolls without resistance
ROUND_OFF = 1e-13  # round-off of a velocity over the largest one nearby, for condition numbers of a few hundred
RELAXATIONS = 20  # largest number of Newton steps for bonded rattlers
RELAXED = 1e-10  # unbalanced force of bonded rattlers over stiffness and radius; also the cut-off of rigid motions
AT_MOST = 3000  # largest number of coordinates if there are rigid bonds, which require dense algebra
RANK = 1e-10  # share of the largest pivot below which a rate that bonds forbid is redundant
CHECKED_UP_TO = 2500  # largest number of coordinates for which the stability of a state is checked
AT_ONCE = 16  # right-hand sides per call; more do not fit into the cache


class StatusSolver:
    """Velocities of a packing under one load rate, for any status of its critical contacts.

    Coordinates are in a fill-reducing order, which is computed once. The coordinates in `held` are fixed, in addition
    to one for each free translation of the whole packing. Rigid bonds require B v = 0: rank(B) coordinates then follow
    from the others, z, as v = N z, and the equations are Nᵀ k(S) N z = Nᵀ b.
    """

    def __init__(self, matrix: LinearSystem, load: np.ndarray, critical: np.ndarray, geometric: bool, held=()):
        self.critical, self.solves = critical, 0
        self.matrix, self.geometric, self.load = matrix, geometric, load_of(matrix, load)
        order = elimination_order(matrix.c, matrix.free.body, matrix.width)
        fixed = np.append(pinned_coordinates(matrix), np.asarray(held, np.int64))
        following, self.basis = (np.zeros(0, np.int64), None) if matrix.rigid is None else follow_bonds(matrix, fixed)
        self.kept = order[~np.isin(order, np.append(fixed, following))]
        self.basis = None if self.basis is None else sparse.csc_array(self.basis[:, self.kept])
        c = sparse.csr_array(self.reduce(matrix.c))
        self.right = self.reduce(self.load)
        geometry = (matrix.geometric if geometric else 0.0 * matrix.geometric) + roll_springs(matrix, geometric)
        parts = {"geometric": geometry, "machine": matrix.machine}
        parts = {k: sparse.csr_array(self.reduce(self.reduce(sparse.csr_array(a)).T).T) for k, a in parts.items()}
        ordered = matrix._replace(c=c, **parts)
        self.stuck = sparse.csc_array(stiffness_matrix(ordered, np.zeros(matrix.count, bool)))
        columns = sparse.csc_array(c)
        normal, along = columns[:, matrix.width * critical], columns[:, matrix.width * critical + 1]
        sign, slope = matrix.sign[critical], matrix.slope[critical]
        self.pull = sparse.csc_array(along * (matrix.springs[critical, 1, 1] * sign))
        self.sees = sparse.csc_array(normal * slope + along * sign)
        self.reading = np.abs(self.sees).T
        self.factor, self.factored, self.answer, self.reached = None, None, None, {}

    def reduce(self, rows):
        """Convert loads (n, …) on all coordinates to loads on the kept ones."""
        return rows[self.kept] if self.basis is None else self.basis.T @ rows

    def stiffness(self, slides: np.ndarray):
        """Return k(S) of the kept coordinates."""
        if not slides.any():
            return self.stuck
        return sparse.csc_array(self.stuck - self.pull[:, slides] @ self.sees[:, slides].T)

    def factorise(self, slides: np.ndarray) -> None:
        """Factorise k(S)."""
        self.factored, self.factor = None, None
        self.factor = factorised(self.stiffness(slides), method="superlu", ordered=True)
        self.answer, self.reached = self.factor(self.right), {}
        self.factored = slides.copy()
        self.solves += 1

    def solve_columns(self, columns: np.ndarray) -> np.ndarray:
        """Solve for several columns (kept, m) with the last factor."""
        out = np.empty_like(columns)
        for k in range(0, columns.shape[1], AT_ONCE):
            out[:, k : k + AT_ONCE] = self.factor(np.asfortranarray(columns[:, k : k + AT_ONCE]))
        return out

    def rates(self, slides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocities (n,) for a status, and Ṽ of the critical contacts.

        LinAlgError is raised if k(S) v does not balance the load because k(S) is singular to round-off.
        """
        v = self._woodbury(slides)
        if v is None:
            if self.factored is None or not np.array_equal(slides, self.factored):
                self.factorise(slides)
            v = self.answer
            if not self._is_balanced(slides, v):
                raise LinAlgError("singular")
        return self.expand(v), self.sees.T @ v

    def rates_for_slip(self, slides: np.ndarray, slip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocities (n,) and Ṽ for a status with given slip rates; k(S) may be singular.

        LinAlgError is raised if k(S) v does not balance the load.
        """
        stuck = np.zeros(len(slides), bool)
        if self.factored is None or not np.array_equal(self.factored, stuck):
            self.factorise(stuck)
        v = self.answer + self.factor(self.pull @ slip)
        if not self._is_balanced(slides, v):
            raise LinAlgError("singular")
        return self.expand(v), self.sees.T @ v

    def round_off(self, velocity: np.ndarray) -> np.ndarray:
        """Return the round-off (Mc,) of Ṽ, which is proportional to the velocities of the touching bodies."""
        return ROUND_OFF * (self.reading @ np.abs(velocity[self.kept]))

    def expand(self, v: np.ndarray) -> np.ndarray:
        """Return the velocities (n,) of all coordinates, computed from those of the kept ones."""
        if self.basis is not None:
            return self.basis @ v
        full = np.zeros(len(self.load))
        full[self.kept] = v
        return full

    def _woodbury(self, slides: np.ndarray) -> np.ndarray | None:
        """Solve for v with the factor of a status that differs in only a few contacts (Woodbury).

        Returns None if this is not applicable.
        """
        if self.factored is None:
            return None
        flipped = np.flatnonzero(slides != self.factored)
        if not 0 < len(flipped) <= FEW:
            return None
        new = [k for k in flipped if k not in self.reached]  # the others were already flipped in an earlier round
        self.reached.update(zip(new, self.solve_columns(self.pull[:, new].toarray(order="F")).T, strict=True))
        turn, sees = np.where(slides[flipped], -1.0, 1.0), self.sees[:, flipped]
        reach = np.stack([self.reached[k] for k in flipped], axis=1) * turn
        try:
            v = self.answer - reach @ np.linalg.solve(np.eye(len(flipped)) + sees.T @ reach, sees.T @ self.answer)
        except np.linalg.LinAlgError:
            return None
        return v if self._is_balanced(slides, v) else None

    def _is_balanced(self, slides: np.ndarray, v: np.ndarray) -> bool:
        """Return True if k(S) v balances the load; False for NaN."""
        slip = np.where(slides, self.sees.T @ v, 0.0)
        missed = self.stuck @ v - self.pull @ slip - self.right
        return bool(np.abs(missed).max(initial=0.0) <= RESIDUAL * np.abs(self.right).max(initial=0.0))


def load_of(matrix: LinearSystem, load) -> np.ndarray:
    """Return the load (n,) as an array; raise ValueError unless it has a finite number for each coordinate."""
    load, size = np.asarray(load, float), len(matrix.free)
    if load.shape != (size,):
        raise ValueError(f"a load must have shape {(size,)}, one component for each coordinate, got {load.shape}")
    if not np.isfinite(load).all():
        raise ValueError("every component of a load must be finite")
    return load


def follow_bonds(matrix: LinearSystem, fixed: np.ndarray) -> tuple[np.ndarray, sparse.csr_array]:
    """Return the coordinates that rigid bonds determine from the others, z, and the matrix N (n, n) in v = N z.

    The others include the fixed coordinates. The columns of N for determined coordinates are zero.
    """
    size = len(matrix.free)
    if size > AT_MOST:
        raise ValueError(f"rigid bonds require at most {AT_MOST} coordinates, got {size}")
    open_, forbidden = np.setdiff1d(np.arange(size), fixed), matrix.rigid.toarray()
    _, r, pivots = qr(forbidden[:, open_], pivoting=True, mode="economic")
    diagonal = np.abs(np.diag(r))
    rank = int((diagonal > RANK * diagonal.max(initial=0.0)).sum())
    following, basis = open_[pivots[:rank]], np.eye(size)
    leading = np.concatenate([open_[pivots[rank:]], fixed]).astype(np.int64)
    reach = np.linalg.lstsq(forbidden[:, following], -forbidden[:, leading], rcond=None)[0]
    basis[following] = 0.0
    basis[np.ix_(following, leading)] = np.where(np.abs(reach) > RANK, reach, 0.0)
    return following, sparse.csr_array(basis)


def pinned_coordinates(matrix: LinearSystem) -> np.ndarray:
    """Return coordinates that may be fixed without affecting contacts: one for each free translation of the packing."""
    return np.array([np.flatnonzero(move)[0] for move in _free_translations(matrix)], np.int64)


def _free_translations(matrix: LinearSystem) -> list[np.ndarray]:
    """Return the translations (n,) of the whole packing that move no contact."""
    moves = [(matrix.free.axis == axis).astype(float) for axis in range(matrix.free.dim)]
    slack = 1e-12 * np.abs(matrix.machine.data).max(initial=0.0)  # bonds resist no translation, except for round-off
    moves = [move for move in moves if move.any() and np.abs(matrix.machine @ move).max() <= slack]
    return [move for move in moves if np.abs(matrix.c.T @ move).max(initial=0.0) < 1e-12]


def rolling_motions(matrix: LinearSystem, geometric: bool = True) -> np.ndarray:
    """Return motions u (K, n), of unit length, of spheres and clusters that may roll about a line through two contacts.

    The contacts do not move, so uᵀk(S) is the same for all statuses. It vanishes if nothing else acts on the
    sphere, because both forces then act along this line.
    """
    moves = []
    for own in _coordinates_of_bridges(matrix):
        roll = np.linalg.svd(matrix.c[own].toarray(), full_matrices=False)[0][:, -1]
        bends = matrix.geometric[own].toarray()
        if not geometric or np.abs(roll @ bends).max() <= RESIDUAL * np.abs(bends).max():
            moves.append(np.zeros(len(matrix.free)))
            moves[-1][own] = roll
    stuck = np.zeros(matrix.count, bool)
    for roll in _rolling_clusters(matrix):
        if np.abs(roll @ stiffness_matrix(matrix, stuck, geometric=geometric)).max() <= NEUTRAL * matrix.springs.max():
            moves.append(roll)
    return np.array(moves).reshape(-1, len(matrix.free))


def roll_springs(matrix: LinearSystem, geometric: bool = True):
    """Return a sparse stiffness (n, n) that keeps rolling spheres from spinning about the line through their contacts.

    If the load does not drive this motion, the springs carry no force. Force balance does not determine the spin;
    inertia and drag do. The spin affects other contacts only to the order of the overlap over the radius.
    """
    spins = np.where(matrix.free.axis >= 3, rolling_motions(matrix, geometric), 0.0)
    held = sparse.csr_array(np.sqrt(matrix.springs.max(initial=0.0)) * spins)
    return sparse.csr_array(held.T @ held)


def regular_stiffness(matrix: LinearSystem, sliding: np.ndarray, geometric: bool):
    """Return the sparse stiffness k(S) (n, n), including `roll_springs`."""
    k = stiffness_matrix(matrix, sliding, geometric=geometric)
    return sparse.csr_array(k + roll_springs(matrix, geometric)) if matrix.width == 3 else k


def lowest_eigenvalue(matrix: LinearSystem) -> float:
    """Return the smallest real part of the eigenvalues of k if all contacts stick; 0 if none is negative or k is large.

    If the symmetric part of k is positive, so are the real parts. Spins of spheres with two contacts are excluded.
    """
    kept = np.setdiff1d(np.arange(len(matrix.free)), pinned_coordinates(matrix))
    if len(kept) > CHECKED_UP_TO:
        return 0.0
    part = regular_stiffness(matrix, np.zeros(matrix.count, bool), True)[kept][:, kept].toarray()
    least = -1e-9 * np.abs(part).max(initial=0.0)
    try:
        cholesky(0.5 * (part + part.T) - least * np.eye(len(part)))
    except LinAlgError:
        lowest = float(eigvals(part).real.min())
        return lowest if lowest < least else 0.0
    return 0.0


def driven_motions(matrix: LinearSystem, load: np.ndarray, geometric: bool = True) -> np.ndarray:
    """Return free translations and rolling motions (K, n) that the load drives because no force balances it there."""
    moves = np.array([*_free_translations(matrix), *rolling_motions(matrix, geometric)]).reshape(-1, len(load))
    return moves[np.abs(moves @ load) > RESIDUAL * np.abs(load).sum()]


def _coordinates_of_bridges(matrix: LinearSystem) -> np.ndarray:
    """Return the coordinates (K, 6) of the spheres that have two contacts and are free in all directions."""
    if matrix.free.dim == 2:
        return np.zeros((0, 6), int)
    c, body = matrix.c.tocoo(), matrix.free.body
    springs = matrix.machine.tocoo()
    bonded = body[springs.col[springs.row != springs.col]]
    pairs = np.unique(body[c.row].astype(np.int64) * matrix.count + c.col // 3)
    two = np.bincount(pairs // max(matrix.count, 1), minlength=body.max(initial=0) + 1) == 2
    two[bonded] = False
    first = np.flatnonzero((matrix.free.axis == 0) & two[body])
    own = np.minimum(first[:, None] + np.arange(6), len(body) - 1)
    return own[(matrix.free.axis[own] == np.arange(6)).all(axis=1)]


def _rolling_clusters(matrix: LinearSystem) -> list[np.ndarray]:
    """Return the rotations (n,) of clusters with two contacts about the line through both."""
    if matrix.clusters is None:
        return []
    out, motions = [], sparse.csc_array(matrix.clusters)
    moved = sparse.csc_array(matrix.c.T @ motions)
    for first in range(0, motions.shape[1], 6):
        own = moved[:, first : first + 6]
        contacts = np.unique(own.indices // matrix.width)
        rates = own.tocsr()[(matrix.width * contacts[:, None] + np.arange(matrix.width)).ravel()].toarray()
        rates = rates.reshape(-1, matrix.width, 6)
        outside = np.abs(rates[:, :, :3]).max(axis=(1, 2)) > 0.5  # translations do not move contacts within a cluster
        if outside.sum() == 2:
            about = np.linalg.svd(rates[outside].reshape(-1, 6))[2][-1]
            roll = motions[:, first : first + 6] @ about
            out.append(roll / np.linalg.norm(roll))
    return out


def relax_clusters(state: State, law: Law, loose: np.ndarray) -> State:
    """Move bonded rattlers (N,), as little as possible, to where the forces of bonds and contacts balance."""
    if not state.bonds or not (intact := state.bonds.intact & loose[state.bonds.i] & loose[state.bonds.j]).any():
        return state
    moves = np.zeros(state.n_bodies, bool)
    moves[state.bonds.i[intact]] = moves[state.bonds.j[intact]] = True
    alone = state._replace(bonds=state.bonds._replace(intact=intact), instant=None)
    free, grains = freedom(state), state.grains
    own = np.flatnonzero(np.append(moves, False)[free.body])
    slack = RELAXED * state.bonds.stiffness[intact, 0].max() * grains.radius.min()
    for _ in range(RELAXATIONS):
        here = alone._replace(grains=grains)
        missing = residual_vector(here, forces(here, law)[0], free)[own]
        if np.abs(missing).max(initial=0.0) <= slack:
            break
        matrix = linear_system(here, law, rattlers=~loose, bonds="elastic")
        kept = matrix.free.place[free.component[own]]
        step = np.zeros(len(free))
        step[own] = np.linalg.lstsq(stiffness_matrix(matrix)[kept][:, kept].toarray(), missing, rcond=RELAXED)[0]
        moved = free.spread(step)[: len(loose)]
        grains = grains._replace(
            position=grains.position + moved[:, :3], angle=grains.angle + moved[:, 3:] / grains.radius[:, None]
        )
    return state if grains is state.grains else with_neighbor_list(state._replace(grains=grains, instant=None))


def elimination_order(c, body: np.ndarray, width: int = 2) -> np.ndarray:
    """Return a fill-reducing order (n,) of coordinates: minimum degree on the graph of bodies in contact.

    Parameters
    ----------
    c : (n, width M) sparse, as in `LinearSystem`
    body : (n,) body of each coordinate

    Notes
    -----
    SuperLU computes an order for the matrix that it factorises. The graph of bodies is far smaller than the graph of
    coordinates and gives an equally good order.
    """
    _, lead, node = np.unique(body, return_index=True, return_inverse=True)
    if len(lead) < 2:
        return np.arange(len(body))
    # the first coordinate of a body is involved in all of its contacts
    part = sparse.csr_array(c[lead])
    row = np.repeat(np.arange(len(lead)), np.diff(part.indptr))
    shape = (len(lead), c.shape[1] // width)
    touch = sparse.csr_array((np.ones(len(row)), (row, part.indices // width)), shape=shape)
    graph = sparse.csc_array(touch @ touch.T)
    graph.data[:] = -1.0
    graph.setdiag(1.0 + np.diff(graph.indptr))  # larger than the rest of its column, so that there is no pivoting
    rank = splu(graph, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).perm_c
    return np.argsort(rank[node], kind="stable")


def external_force(state: State, free: Freedom) -> np.ndarray:
    """Return the generalised external force (n,) on the free coordinates [force]."""
    nothing = np.zeros((state.n_bodies, 3))
    return residual_vector(state, ContactLoads(nothing, nothing, np.zeros((3, 3))), free)
