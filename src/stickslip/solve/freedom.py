"""Generalised coordinates: the free components of all bodies and of the cell, built from `Control`."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from ..core.arguments import Numbers, checked, knows_bonds, require_shape
from ..core.contacts.forces import HELD, ContactLoads, forces, moving_masses, unbalanced_forces
from ..core.contacts.jacobian import Linearisation, blocks_of, inverse_radii, linearise, triplets
from ..core.dynamics.cell_motion import cell_mass, strained
from ..core.fields import Field, check_entry
from ..core.laws.builtin import Law
from ..core.measure import Committed, branch_vectors, least_supports, rattlers, volume
from ..core.readable import readable
from ..core.state import State, groups

ZERO_BELOW = 1e-10  # fraction of the largest |λ| below which an eigenvalue counts as zero
PAIR_ABOVE = 1e-9  # fraction of the largest |λ| above which |Im λ| is more than round-off


@readable(head=lambda free: f"{len(free)} coordinates of {free.bodies} bodies")
class Freedom(NamedTuple):
    """Free coordinates q of x = P q + x₀, where x contains (x, y, z, R·angle) of every body.

    P selects the free components; all others are prescribed. Components are ordered body by body. In two dimensions,
    a grain has x, y and R·angle_z. A rigid group has one coordinate per direction, placed at that of its first member.
    Free components of the cell strain ε come last: their coordinates are ℓ ε_ab with ℓ = V^(1/dim), and grains move
    affinely with the cell, x → x + ε x.
    """

    MADE_BY = "freedom"

    component: np.ndarray  # (n,) index of each coordinate in the flattened (B, 6) array of bodies, then ε (3, 3)
    mass: np.ndarray  # (n,) mass, or I/R² for rotations [mass]
    dim: int
    place: np.ndarray  # (6B + 9,) coordinate of each component, −1 if it is prescribed: the nonzero entries of P
    length: float  # ℓ, 0 if the cell is not free [length]

    @property
    def axis(self) -> np.ndarray:
        """(n,) axis of each coordinate: 0, 1, 2 for x, y, z; 3, 4, 5 for rotations about them; 6 for the cell."""
        return np.where(self.body < self.bodies, self.component % 6, 6)

    @property
    def body(self) -> np.ndarray:
        """(n,) body of each coordinate; for the cell, the number of bodies."""
        return np.minimum(self.component // 6, self.bodies)

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return (len(np.atleast_1d(self.place)) - 9) // 6

    def check_entries(self) -> None:
        """Raise ValueError if an entry has a wrong type, shape or range."""
        sizes = {"n": len(np.atleast_1d(self.component)), "places": 6 * self.bodies + 9}
        sizes["last"] = sizes["n"] - 1
        check_entry("free.component", self.component, Field(np.int64, ("n",), 0, sizes["places"] - 1), sizes)
        check_entry("free.mass", self.mass, Field(np.float64, ("n",), 5e-324), sizes)
        check_entry("free.dim", self.dim, Field(np.int64, None, 2, 3), sizes)
        check_entry("free.length", self.length, Field(np.float64, None, 0.0), sizes)
        check_entry("free.place", self.place, Field(np.int64, ("places",), -1, "last"), sizes)

    def check_belongs(self, others) -> None:
        """Raise ValueError if any state among the given values has a different number of bodies."""
        for state in others:
            if isinstance(state, State) and state.n_bodies != self.bodies:
                raise ValueError(
                    f"the free coordinates are those of {self.bodies} bodies, but the state has {state.n_bodies}: use "
                    "freedom(state)"
                )

    def __len__(self):
        return len(self.component)

    def spread(self, q: np.ndarray) -> np.ndarray:
        """(B, 6) components P q of all bodies for coordinates q (n,)."""
        return self._expand(q)[: 6 * self.bodies].reshape(-1, 6)

    def strain(self, q: np.ndarray) -> np.ndarray:
        """(3, 3) displacement gradient of the cell for coordinates (n,)."""
        return self._expand(q)[6 * self.bodies :].reshape(3, 3) / (self.length or 1.0)

    def _expand(self, q):
        require_shape((len(self),), q=q)
        return np.where(self.place >= 0, np.append(q, 0)[self.place], 0)

    def without(self, bodies: np.ndarray) -> "Freedom":
        """Freedom with the given bodies, (B,) bool, held fixed."""
        return self.only(~np.append(bodies, False)[self.body])

    def only(self, kept: np.ndarray, length: float | None = None) -> "Freedom":
        """Freedom of the coordinates in the mask `kept` (n,), all others prescribed; `length` 0 excludes the cell."""
        length = self.length if length is None else length
        number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
        return Freedom(self.component[kept], self.mass[kept], self.dim, number[self.place], length)


@checked
@knows_bonds
def freedom(state: State) -> Freedom:
    """Free coordinates of a state; walls only translate."""
    grains, free = state.grains, state.control.free.copy()
    n = len(grains.radius)
    free[n:, 3:] = False
    if state.cell.dim == 2:
        free[:, 2:5] = False
    mass = np.ones((state.n_bodies, 6))
    mass[:, :3] = moving_masses(state)[:, None]
    mass[:n, 3:] = (grains.inertia / grains.radius**2)[:, None]
    leads = free.copy()
    together = list(filter(len, groups(state.control)))
    for members in together:
        leads[members[1:]] = False
    cell = state.control.cell_free
    component = np.flatnonzero(np.append(leads, cell))
    place = np.full(6 * state.n_bodies + 9, -1)
    place[component] = np.arange(len(component))
    of_bodies = place[:-9].reshape(-1, 6)
    for members in together:
        of_bodies[members] = of_bodies[members[0]]
    mass = np.append(mass, np.full(9, cell_mass(state)))
    length = volume(state) ** (1 / state.cell.dim) if cell.any() else 0.0
    return Freedom(component, mass[component], state.cell.dim, place, length)


def unsupported_grains(state: State, law: Law) -> np.ndarray:
    """(N,) mask of rattlers: grains without the number of contacts that support a grain under this law."""
    return rattlers(state, least_supports(law, state.cell.dim))


@checked
@knows_bonds
def backbone(state: Committed, law: Law) -> Freedom:
    """Free coordinates of a state without its rattlers."""
    loose = unsupported_grains(state, law)
    return freedom(state).without(np.append(loose, np.zeros(state.n_bodies - len(loose), bool)))


def translations(matrix, free: Freedom) -> np.ndarray:
    """(n, k) unit vectors of common translations that A of `dynamical_matrix` does not resist."""
    weight, scale = np.sqrt(free.mass), np.abs(matrix.data).max(initial=0.0)
    moves = np.stack([np.where(free.axis == axis, weight, 0.0) for axis in range(free.dim)], axis=1)
    moves = moves[:, moves.any(axis=0)]
    nothing = np.abs(matrix @ moves).max(axis=0) <= ZERO_BELOW * scale * moves.max(axis=0)
    return moves[:, nothing] / np.linalg.norm(moves[:, nothing], axis=0)


@checked
@knows_bonds
def residual_vector(state: State, loads: ContactLoads, free: Freedom) -> np.ndarray:
    """(n,) generalised unbalanced force Pᵀf [force].

    Parameters
    ----------
    loads : first result of `forces`
    free : coordinates, from `freedom`
    """
    force = unbalanced_forces(state, loads).ravel()
    if free.length:
        cell = (loads.virial - volume(state) * state.control.stress) / free.length
        force = np.append(force, cell.ravel())
    return force[free.component]


@checked
@knows_bonds
def jacobian(state: State, law: Law, free: Freedom | None = None, *, memory: int = HELD):
    """(n, n) sparse J = ∂(Pᵀf)/∂q, with each contact held in its mode or, with FREE, in that of its trial memory.

    The force on a free component of the cell is Σ f_a r_b − V σ_ab. In addition to the change in f, its row of J
    contains f_a ∂r_b/∂q and, in the column of a strain ε_cd, −V σ_ab δ_cd from the change in volume. If `free` is
    None, the coordinates are those of `freedom(state)`.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> ss.jacobian(state, law).shape
    (300, 300)
    """
    free, line = freedom(state) if free is None else free, linearise(state, law, memory=memory)
    return stiffness_of(state, line, blocks_of(state, law, line, memory)[0], free)


def stiffness_of(state: State, line: Linearisation, blocks: np.ndarray, free: Freedom):
    """(n, n) sparse J from a linearisation and its contact blocks; see `jacobian`."""
    matrix = assembled(state, blocks, free)
    if state.control.spring.any():
        matrix = sparse.csr_array(matrix - spring_stiffness(state, free))
    if not free.length:
        return matrix
    return sparse.csr_array(matrix + cell_geometric_terms(state, line.force, free))


def spring_stiffness(state: State, free: Freedom):
    """(n, n) sparse diagonal stiffness of the springs attached to free coordinates."""
    body, axis = np.nonzero(state.control.spring)
    place = free.place[6 * body + axis]
    kept = place >= 0
    return sparse.diags_array(np.bincount(place[kept], state.control.spring[body, axis][kept], len(free)).astype(float))


def cell_geometric_terms(state: State, force: np.ndarray, free: Freedom):
    """(n, n) sparse derivative of the force on the cell due to changes in r and volume at constant contact forces."""
    count = len(force)
    turn = np.zeros((9, count, 6))  # ∂(f_a r_b)/∂(r, ρ) at constant f
    for k in range(9):
        turn[k, :, k % 3] = force[:, k // 3]
    rows = np.arange(9)[:, None].repeat(6 * count, axis=1).ravel()
    columns = np.tile(np.arange(6 * count), 9)
    changed = sparse.csr_array((turn.ravel(), (rows, columns)), shape=(9, 6 * count)) / free.length
    geometry, places = (changed @ incidence(state, count, free).T).toarray(), free.place[-9:]
    swells = places[[0, 4, 8]]
    geometry[:, swells[swells >= 0]] -= (volume(state) / free.length**2 * state.control.stress).reshape(9, 1)
    cell = np.flatnonzero(places >= 0)
    lift = sparse.csr_array((np.ones(len(cell)), (places[cell], cell)), shape=(len(free), 9))
    return sparse.csr_array(lift @ sparse.csr_array(geometry))


@checked
@knows_bonds
def assembled(state: State, blocks: np.ndarray, free: Freedom):
    """(n, n) sparse PᵀKP of the matrix K assembled from contact blocks."""
    width = 9 if np.shape(blocks)[-1:] == (9,) else 6
    require_shape((int(state.contacts.count[0]), width, width), blocks=blocks)
    if free.length:
        q = incidence(state, len(blocks), free, blocks.shape[1])
        flat = sparse.bsr_array((blocks, np.arange(len(blocks)), np.arange(len(blocks) + 1)))
        return sparse.csr_array(q @ flat @ q.T)
    matrix = _block_matrix(state, blocks)
    if np.array_equal(free.place[:-9], np.arange(len(free))):
        return matrix.tocsr()
    matrix = matrix.tocoo()
    rows, cols = free.place[matrix.row], free.place[matrix.col]
    keep = (rows >= 0) & (cols >= 0)
    return sparse.csr_array((matrix.data[keep], (rows[keep], cols[keep])), shape=(len(free), len(free)))


def _block_matrix(state: State, blocks: np.ndarray):
    """(6B, 6B) matrix of all bodies in blocks of 6 × 6, without pairs whose block is zero; see `triplets`.

    Blocks at the same position are summed, which is several times faster than summing their entries.
    """
    size, used = 6 * state.n_bodies, np.flatnonzero(blocks.any(axis=(1, 2)))
    i, j, block = state.contacts.i[used], state.contacts.j[used], blocks[used]
    if blocks.shape[1] == 6:
        sign = np.array([-1.0, -1, -1, 1, 1, 1])
        values = np.empty((4, *block.shape))
        values[0] = block
        np.multiply(block, sign, out=values[1])
        np.multiply(block, sign[:, None], out=values[2])
        np.multiply(values[2], sign, out=values[3])
    else:
        values = triplets(state._replace(contacts=state.contacts._replace(i=i, j=j)), block)[2]
    values = values.reshape(-1, 6, 6)
    # 64 bits: block numbers of more than 46,340 bodies exceed 32 bits
    place = np.concatenate([i, i, j, j]).astype(np.int64) * state.n_bodies + np.concatenate([i, j, i, j])
    order = np.argsort(place, kind="stable")
    place = place[order]
    first = np.flatnonzero(np.diff(place, prepend=-1))
    data = np.add.reduceat(values[order], first, axis=0) if len(first) else values
    row, column = np.divmod(place[first], state.n_bodies)
    starts = np.searchsorted(row, np.arange(state.n_bodies + 1))
    return sparse.bsr_array((data, column, starts), shape=(size, size))


@readable(head=lambda motion: f"equations of motion of {len(motion.mass)} coordinates")
class EquationsOfMotion(NamedTuple):
    """M q̈ = f + J δq + C q̇ near a state, for small changes δq of its n free coordinates."""

    jacobian: sparse.csr_array  # (n, n) J = ∂f/∂q, in general not symmetric [force/length]
    damping: sparse.csr_array  # (n, n) C = ∂f/∂q̇ of the dashpots [force time/length]
    mass: np.ndarray  # (n,) diagonal of M; I/R² for a rotation, whose coordinate is R·angle [mass]
    force: np.ndarray  # (n,) f, the unbalanced force [force]
    body: np.ndarray  # (n,) body of each coordinate: grains first, then walls; for the cell, the number of bodies
    axis: np.ndarray  # (n,) 0, 1, 2 for x, y, z; 3, 4, 5 for rotations about them; 6 for the cell


@checked
@knows_bonds
def equations_of_motion(state: Committed, law: Law, free: Freedom | None = None) -> EquationsOfMotion:
    """Linearise the equations of motion of an accepted state, with each contact held in its mode.

    The coordinates are those of `freedom(state)` unless `free` is given, such as `modes.backbone(state, law)`.
    `io.write_matrices` writes the result. The sign of J is that of a force: the eigenvalues of −M⁻¹J are λ.

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Eqs 6–8, and supplement Eqs 9–35 for J, here extended to dashpots and any law.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> ss.modes.equations_of_motion(state, ss.laws.hertz_mindlin(mu=0.5))
    EquationsOfMotion: equations of motion of 300 coordinates
    """
    free, line = freedom(state) if free is None else free, linearise(state, law)
    springs, dashpots = blocks_of(state, law, line, HELD)
    force = residual_vector(state, forces(state, law, memory=HELD)[0], free)
    damping = sparse.csr_array(assembled(state, dashpots, free))
    return EquationsOfMotion(
        sparse.csr_array(stiffness_of(state, line, springs, free)), damping, free.mass, force, free.body, free.axis
    )


@checked
@knows_bonds
def dynamical_matrix(state: State, law: Law, free: Freedom | None = None):
    """(n, n) sparse A = −M^(−1/2) J M^(−1/2) of an accepted state, with each contact held in its mode [1/time²].

    It is similar to −M⁻¹J, and symmetric if the forces have a potential. Its eigenvalues are λ, and its eigenvectors
    divided by √mass are the modes.
    """
    free = freedom(state) if free is None else free
    return mass_weighted(jacobian(state, law, free), free)


def mass_weighted(matrix, free: Freedom):
    """(n, n) sparse −M^(−1/2) J M^(−1/2), which overwrites J."""
    root = 1 / np.sqrt(free.mass)
    matrix.data *= -root[matrix.indices] * np.repeat(root, np.diff(matrix.indptr))
    return matrix


def incidence(state: State, count: int, free: Freedom, width: int = 6):
    """(n, width count) sparse Q such that blocks B of the first `count` contacts assemble to Q B Qᵀ; see `triplets`.

    With a width of 9, blocks include rolling moments.
    """
    k = np.arange(6)
    column = (width * np.arange(count)[:, None] + k).ravel()
    rows, columns, values = [], [], []
    for body, sign in ((state.contacts.i, np.ones(6)), (state.contacts.j, np.array([-1.0, -1, -1, 1, 1, 1]))):
        row = free.place[(6 * body[:count, None] + k).ravel()]
        rows.append(row[row >= 0])
        columns.append(column[row >= 0])
        values.append(np.tile(sign, count)[row >= 0])
        if width > 6:
            row = free.place[6 * body[:count, None] + k[3:]].ravel()
            turn = np.repeat(sign[0] * inverse_radii(state)[body[:count]], 3)
            rows.append(row[row >= 0])
            columns.append((width * np.arange(count)[:, None] + np.arange(6, 9)).ravel()[row >= 0])
            values.append(turn[row >= 0])
    if free.length:  # dr = ε r: ℓ ε_ab moves component a by r_b/ℓ
        branch = branch_vectors(state)[:count] / free.length
        for k in np.flatnonzero(free.place[-9:] >= 0):
            rows.append(np.full(count, free.place[6 * free.bodies + k]))
            columns.append(width * np.arange(count) + k // 3)
            values.append(branch[:, k % 3])
    where = (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_array((np.concatenate(values), where), shape=(len(free), width * count))


def resized(state: State, radius: np.ndarray) -> State:
    """State with new radii (N,) in which no contact rolls because of the change."""
    contacts, count, angle = state.contacts, int(state.contacts.count[0]), np.zeros((state.n_bodies, 3))
    angle[: len(radius)] = (radius - state.grains.radius)[:, None] * state.grains.angle
    roll = contacts.roll.copy()
    roll[:count] += angle[contacts.i[:count]] + angle[contacts.j[:count]]
    return state._replace(grains=state.grains._replace(radius=radius), contacts=contacts._replace(roll=roll))


@checked
@knows_bonds
def displaced(state: State, free: Freedom, step: Numbers) -> State:
    """State with its free coordinates moved by `step` (n,) [length]; contact memory is left unchanged."""
    full = free.spread(step)
    if free.length:
        state = strained(state, free.strain(step))
    grains, n = state.grains, len(state.grains.radius)
    return state._replace(
        grains=grains._replace(
            position=grains.position + full[:n, :3], angle=grains.angle + full[:n, 3:] / grains.radius[:, None]
        ),
        walls=state.walls._replace(point=state.walls.point + full[n:, :3]),
    )


def moving(state: State, free: Freedom, rate: np.ndarray) -> State:
    """State whose free coordinates have the velocities `rate` (n,) [length/time]; all others are at rest."""
    full, grains, n = free.spread(rate), state.grains, len(state.grains.radius)
    strain_rate = free.strain(rate) if free.length else np.zeros((3, 3))
    return state._replace(
        grains=grains._replace(velocity=full[:n, :3].copy(), spin=full[:n, 3:] / grains.radius[:, None]),
        walls=state.walls._replace(velocity=full[n:, :3].copy()), cell=state.cell._replace(rate=strain_rate),
    )  # fmt: skip
