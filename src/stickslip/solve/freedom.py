"""Generalised coordinates: which components of which bodies move, built from `Control`."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from ..core.forces import Loads, moved_masses, unbalanced
from ..core.jacobian import contact_blocks, triplets
from ..core.laws import Law
from ..core.state import State, groups


class Freedom(NamedTuple):
    """x = P q + x₀: P picks the free components of (x, y, z, R·angle) of every body; the rest is prescribed.

    Components are ordered body by body; in two dimensions a grain has x, y and R·angle_z. A rigid group has one
    coordinate a direction, which stands where its first member does.
    """

    component: np.ndarray  # (n,) position of each coordinate in the flattened (B, 6) array
    mass: np.ndarray  # (n,) mass, or I/R² for rotations [mass]
    dim: int
    place: np.ndarray  # (6B,) coordinate of each component, −1 for what is prescribed: the ones of P

    @property
    def axis(self) -> np.ndarray:
        """(n,) 0, 1, 2 for x, y, z; 3, 4, 5 for rotations about them."""
        return self.component % 6

    @property
    def body(self) -> np.ndarray:
        """(n,) body to which each coordinate belongs."""
        return self.component // 6

    def __len__(self):
        return len(self.component)

    def spread(self, q: np.ndarray) -> np.ndarray:
        """(B, 6) P q of coordinates (n,)."""
        return np.where(self.place >= 0, np.append(q, 0)[self.place], 0).reshape(-1, 6)

    def without(self, bodies: np.ndarray) -> "Freedom":
        """Freedom in which the given bodies, (B,) bool, are held."""
        kept = ~bodies[self.body]
        number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
        return Freedom(self.component[kept], self.mass[kept], self.dim, number[self.place])


def freedom(state: State) -> Freedom:
    """Free coordinates of a state. Walls translate only."""
    grains, free = state.grains, state.control.free.copy()
    n = len(grains.radius)
    free[n:, 3:] = False
    if state.cell.dim == 2:
        free[:, 2:5] = False
    mass = np.ones((state.n_bodies, 6))
    mass[:, :3] = moved_masses(state)[:, None]
    mass[:n, 3:] = (grains.inertia / grains.radius**2)[:, None]
    leads = free.copy()
    together = groups(state.control)
    for members in together:
        leads[members[1:]] = False
    component = np.flatnonzero(leads)
    place = np.full(6 * state.n_bodies, -1)
    place[component] = np.arange(len(component))
    place = place.reshape(-1, 6)
    for members in together:
        place[members] = place[members[0]]
    return Freedom(component, mass.ravel()[component], state.cell.dim, place.ravel())


def residual_vector(state: State, loads: Loads, free: Freedom) -> np.ndarray:
    """(n,) generalised unbalanced force Pᵀf [force]."""
    return unbalanced(state, loads).ravel()[free.component]


def restricted(state: State, blocks: np.ndarray, free: Freedom):
    """(n, n) sparse PᵀKP of the matrix K that contact blocks add up to."""
    rows, cols, values = triplets(state, blocks)
    rows, cols = free.place[rows], free.place[cols]
    keep = (rows >= 0) & (cols >= 0)
    return sparse.csr_array((values[keep], (rows[keep], cols[keep])), shape=(len(free), len(free)))


def stiffness(state: State, law: Law, free: Freedom):
    """(n, n) sparse A = −M^(−1/2) J M^(−1/2) of an accepted state, each contact held in its mode [1/time²].

    Similar to −M⁻¹J, and symmetric where the forces have a potential: its eigenvalues are λ, and its eigenvectors over
    √mass are modes.
    """
    blocks, _ = contact_blocks(state, law)
    matrix = restricted(state, blocks, free)
    root = 1 / np.sqrt(free.mass)
    matrix.data *= -root[matrix.indices] * np.repeat(root, np.diff(matrix.indptr))
    return matrix


def incidence(state: State, count: int, free: Freedom):
    """(n, 6 count) sparse Q such that blocks B of the first `count` contacts add up to Q B Qᵀ: see `triplets`."""
    k = np.arange(6)
    column = np.arange(6 * count)
    rows, columns, values = [], [], []
    for body, sign in ((state.contacts.i, np.ones(6)), (state.contacts.j, np.array([-1.0, -1, -1, 1, 1, 1]))):
        row = free.place[(6 * body[:count, None] + k).ravel()]
        rows.append(row[row >= 0])
        columns.append(column[row >= 0])
        values.append(np.tile(sign, count)[row >= 0])
    where = (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_array((np.concatenate(values), where), shape=(len(free), 6 * count))


def displaced(state: State, free: Freedom, step: np.ndarray) -> State:
    """The state with its free coordinates moved by `step` (n,) [length]; memory is not touched."""
    full = free.spread(step)
    grains, n = state.grains, len(state.grains.radius)
    return state._replace(
        grains=grains._replace(
            position=grains.position + full[:n, :3], angle=grains.angle + full[:n, 3:] / grains.radius[:, None]
        ),
        walls=state.walls._replace(point=state.walls.point + full[n:, :3]),
    )
