"""Exact Jacobian of contact forces and torques with memory: one 6 × 6 block per contact.

Coordinates of a body are (x, y, z, R·angle), and torques are divided by R. A contact depends only on r = r_i − r_j
and ρ = R_i angle_i + R_j angle_j. Its loads on i are (F, T/R) = (F, −n × F). The geometric derivatives are written by
hand; those of the law are computed by its code. With the slip u (see `tangent`) and the tangential force φ(δ, |u|):

    dF = −F_n' n (n·dr) + F_n dn − [φ/|u| (I − û ûᵀ) + ∂φ/∂|u| û ûᵀ] du + ∂φ/∂δ û (n·dr),      dn = P dr/|r|

At an accepted state, du = P dr − n (u·dn) + n × dρ, P = I − n nᵀ. The papers' supplements omit the term −n (u·dn),
which describes the rotation of the memory with the contact.
"""

from typing import NamedTuple

import numpy as np

from ..arguments import checked, knows_bonds
from ..laws.builtin import Law
from ..laws.compiled import TANGENTS, law_struct
from ..laws.properties import angular_columns, resists_rolling
from ..library import core
from ..state import State
from .bonds import bond_forces, with_bonds
from .forces import HELD, bodies, check_materials, check_memory
from .neighbors import check_list, largest_gap, shifts, with_own_memory
from .rolling import with_moments
from .tangent import column, make_turn, memory_tangent, outer, spring_tangent, with_shorter_arms


class Linearisation(NamedTuple):
    """Vectors and scalars of the linearisation, one row per contact."""

    normal: np.ndarray  # (C, 3)
    inverse: np.ndarray  # (C,) 1/|r|, zero at walls
    before: np.ndarray  # (C, 3) slip when the memory was committed
    way: np.ndarray  # (C, 3) Δr since the commit
    turn: np.ndarray  # (C, 3) Δρ since the commit
    slip: np.ndarray  # (C, 3) current slip before truncation at the Coulomb limit
    closed: np.ndarray  # (C,) 1 if the contact touches, else 0
    remembers: np.ndarray  # (C,) 1 if the contact already touched when the memory was committed
    slides: np.ndarray  # (C,) 1 if the contact slides
    weighted: np.ndarray  # (C,) 1 if the contact keeps sliding in three dimensions, so that the slip may turn
    force_n: np.ndarray  # (C,) F_n
    slope_n: np.ndarray  # (C,) dF_n/dδ
    secant: np.ndarray  # (C,) φ/|u|
    along: np.ndarray  # (C,) ∂φ/∂|u|
    by_overlap: np.ndarray  # (C,) ∂φ/∂δ at fixed |u|
    by_force: np.ndarray  # (C,) ∂φ/∂F_n, needed because dashpots change F_n
    damping_n: np.ndarray  # (C,)
    damping_t: np.ndarray  # (C,)
    stiffness_t: np.ndarray  # (C,) k_t of a sticking contact
    slope_t: np.ndarray  # (C,) dk_t/dδ
    limit: np.ndarray  # (C,) Coulomb limit of the tangential force
    mu: np.ndarray  # (C,) derivative of the limit with respect to F_n
    fade: np.ndarray  # (C,) factor by which the law shortens the slip as the overlap decreases
    fading: np.ndarray  # (C,) derivative of `fade` with respect to the overlap
    half: np.ndarray  # (C,) half the overlap, by which lever arms are shorter than R
    half_mid: np.ndarray  # (C,) half the overlap at the midpoint between the commit and now
    together: np.ndarray  # (C, 3) change of angle_i + angle_j since the commit, if lever arms are shorter than R
    bond: np.ndarray = np.zeros((1, 3))  # force of bonds on body i, (C, 3), or zeros (1, 3) without bonds

    @property
    def force(self) -> np.ndarray:
        """(C, 3) elastic force on body i [force]."""
        return self.force_n[:, None] * self.normal - self.secant[:, None] * self.slip + self.bond

    @property
    def bearing(self) -> np.ndarray:
        """(C,) |F_n|, or |F_n n + F| with bond forces F [force]."""
        if not self.bond.any():
            return np.abs(self.force_n)
        return np.linalg.norm(self.force_n[:, None] * self.normal + self.bond, axis=1)

    @property
    def mobilisation(self) -> np.ndarray:
        """(C,) |F_t|/(μ F_n) of touching contacts; NaN for all other pairs and without friction."""
        bears, pull = (self.closed > 0) & (self.limit > 0), self.secant * np.linalg.norm(self.slip, axis=1)
        return np.divide(pull, self.limit, out=np.full(len(pull), np.nan), where=bears)


def linearise(state: State, law: Law, *, memory: int = HELD) -> Linearisation:
    """Linearisation of every contact at zero velocity; see `contact_blocks` for the arguments."""
    check_materials(state, law)
    check_memory(memory)
    check_list(state, largest_gap(state, law))
    count = int(state.contacts.count[0])
    vectors = ("normal", "before", "way", "turn", "slip", "together")
    out = Linearisation(*(np.zeros((count, 3) if name in vectors else count) for name in Linearisation._fields[:-1]))
    state = state._replace(contacts=with_own_memory(state.contacts, law))
    struct, shift = law_struct(law, members=TANGENTS), shifts(state.contacts, state.cell.vectors)
    core.linearise(struct, state.cell.dim, bodies(state), state.contacts, shift, memory, out)
    if memory == HELD and (out.closed > out.remembers).any():
        raise ValueError("a touching contact was never committed: equilibrate, or accept(state, trial) first")
    if state.bonds:
        vectors = state.cell.vectors
        out = out._replace(bond=bond_forces(state.bonds, state.cell.dim, bodies(state), vectors, state.contacts))
    return out


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """Matrices X (C, 3, 3) with X y = v × y, for rows v (C, 3)."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


@checked
@knows_bonds
def contact_blocks(state: State, law: Law, *, memory: int = HELD):
    """Derivatives of (F, T/R) on body i with respect to (r, ρ) and to their rates, at zero velocity.

    They are exact for any state. At the positions of the commit, a law with `rescaled=True` has only directional
    derivatives; those for a growing overlap are returned.

    Parameters
    ----------
    state : State whose list of contacts is valid at its positions
    memory : HELD, each contact stays in its mode (default: the Jacobian of an accepted state); FREE, each contact has
        the mode of the trial memory (for Newton's method)

    Returns
    -------
    (C, 6, 6) [force/length], (C, 6, 6) [force time/length]
        or, with bonds, rolling resistance or lever arms R − δ/2, (C, 9, 9) derivatives of (F, T/R, M) with respect to
        (r, ρ, angle_i − angle_j): see `rolling` and `tangent`

    Raises
    ------
    ValueError
        If the list of contacts is not valid at these positions or, with HELD, a touching contact was never committed.

    Source
    ------
    doi:10.48550/arXiv.1908.11724, supplement Eqs 9–35, with the errata listed in the documentation.
    """
    return blocks_of(state, law, linearise(state, law, memory=memory), memory)


def blocks_of(state: State, law: Law, c: Linearisation, memory: int = HELD):
    """Contact blocks of a linearisation; see `contact_blocks`."""
    stiff, damp = _blocks_of_law(state, law, c, memory)
    if state.bonds:
        about = state.cell.dim, bodies(state), state.cell.vectors, state.contacts
        stiff, damp = with_bonds(state.bonds, *about, stiff, damp)
    return stiff, damp


def bond_blocks(state: State) -> np.ndarray:
    """Part of the contact blocks that is due to bonds, (C, 9, 9)."""
    nothing = np.zeros((2, int(state.contacts.count[0]), 9, 9))
    return next(with_bonds(state.bonds, state.cell.dim, bodies(state), state.cell.vectors, state.contacts, *nothing))


def _blocks_of_law(state: State, law: Law, c: Linearisation, memory: int):
    count, cross_n = len(c.normal), cross_matrix(c.normal)
    turn = make_turn(c.normal, c.inverse, c.way)
    by_way = np.zeros((count, 3, 6))
    by_way[:, :, :3] = np.eye(3) - cross_matrix(c.turn) @ turn.by_mid
    by_way[:, :, 3:] = cross_matrix(turn.mid)
    soft = np.where(c.stiffness_t > 0, c.stiffness_t, 1.0)
    reach = np.where(c.stiffness_t > 0, c.limit / soft, 0.0)
    fading = (c.fade, c.fading) if c.fading.any() else ()
    slip, by_slip, by_reach = memory_tangent(
        turn, c.before, c.way + np.cross(turn.mid, c.turn), by_way, reach, (c.by_overlap - reach * c.slope_t) / soft,
        c.weighted > 0, *fading,
    )  # fmt: skip
    spring, hat = spring_tangent(slip, c.remembers, c.secant, c.along)
    force = c.force_n[:, None] * c.normal - c.secant[:, None] * slip
    nn, hat_n = outer(c.normal, c.normal), outer(hat, c.normal)

    stiff, damp = np.zeros((2, count, 6, 6))
    stiff[:, :3, :3] = -column(c.slope_n) * nn + column(c.force_n) * turn.by_normal + column(c.by_overlap) * hat_n
    stiff[:, :3] += spring @ by_slip
    stiff[:, 3:] = -cross_n @ stiff[:, :3]
    stiff[:, 3:, :3] += cross_matrix(force) @ turn.by_normal
    dashpot = column(c.damping_t) * (np.eye(3) - column(c.slides) * outer(hat, hat))
    by_force = c.by_force[:, None] * hat - np.einsum("ckl,cl->ck", spring, by_reach * (c.mu / soft)[:, None])
    damp[:, :3, :3] = -dashpot @ (np.eye(3) - nn) + column(c.damping_n) * (outer(by_force, c.normal) - nn)
    damp[:, :3, 3:] = -dashpot @ cross_n
    damp[:, 3:] = -cross_n @ damp[:, :3]
    stiff, damp = column(c.closed) * stiff, column(c.closed) * damp
    if not angular_columns(law):
        return stiff, damp
    stiff, damp = with_shorter_arms(state, c, stiff, damp)
    if not resists_rolling(law):
        return stiff, damp
    state = state._replace(contacts=with_own_memory(state.contacts, law))
    return with_moments(state, law, bodies(state), c, turn, memory, stiff, damp)


def triplets(state: State, blocks: np.ndarray):
    """Rows, columns and values of the (6B, 6B) matrix of all bodies, assembled from contact blocks.

    The force is +F on body i and −F on body j; torque/R is the same on both. r = x_i − x_j, ρ = ρ_i + ρ_j. Entries with
    the same row and column are summed. A moment M contributes +M/R_i and −M/R_j, and angle_i − angle_j = ρ_i/R_i −
    ρ_j/R_j.
    """
    count = len(blocks)
    if blocks.shape[1] > 6:
        return _triplets_with_moments(state, blocks)
    ends = (
        (state.contacts.i[:count], np.array([1.0, 1, 1, 1, 1, 1])),
        (state.contacts.j[:count], np.array([-1.0, -1, -1, 1, 1, 1])),
    )
    rows, cols, values = [], [], []
    k, shape = np.arange(6), (count, 6, 6)
    for body, sign in ends:
        for other, other_sign in ends:
            rows.append(np.broadcast_to((6 * body[:, None] + k)[:, :, None], shape).ravel())
            cols.append(np.broadcast_to((6 * other[:, None] + k)[:, None, :], shape).ravel())
            values.append((blocks * sign[:, None] * other_sign).ravel())
    return np.concatenate(rows), np.concatenate(cols), np.concatenate(values)


def inverse_radii(state: State) -> np.ndarray:
    """Inverse radii 1/R of all bodies, (B,), zero for walls, which do not rotate [1/length]."""
    return np.append(1.0 / state.grains.radius, np.zeros(len(state.walls.mass)))


def _triplets_with_moments(state: State, blocks: np.ndarray):
    """Triplets of (C, 9, 9) blocks: the coordinates at each end are (r, ρ, θ) = G x, its loads Gᵀ (F, T/R, M)."""
    count, k = len(blocks), np.arange(6)
    ends, inverse = (state.contacts.i[:count], state.contacts.j[:count]), inverse_radii(state)
    maps = []
    for body, sign in zip(ends, (1.0, -1.0), strict=True):
        g = np.zeros((count, 9, 6))
        g[:, :6, :6] = np.diag([sign, sign, sign, 1.0, 1.0, 1.0])
        g[:, 6:, 3:] = sign * inverse[body][:, None, None] * np.eye(3)
        maps.append(g)
    rows, cols, values = [], [], []
    for body, g in zip(ends, maps, strict=True):
        for other, h in zip(ends, maps, strict=True):
            rows.append(np.broadcast_to((6 * body[:, None] + k)[:, :, None], (count, 6, 6)).ravel())
            cols.append(np.broadcast_to((6 * other[:, None] + k)[:, None, :], (count, 6, 6)).ravel())
            values.append((g.transpose(0, 2, 1) @ blocks @ h).ravel())
    return np.concatenate(rows), np.concatenate(cols), np.concatenate(values)
