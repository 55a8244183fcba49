"""Macroscopic quantities of a state: stress, pressure, coordination, rattlers, packing fraction.

Measures use the contacts at the present positions. If the list of contacts or their memory belongs to other positions,
a measure raises ValueError: commit the memory first, with `accept(state, forces(state, law)[1])`.
"""

from typing import Annotated

import numpy as np

from .arguments import Positive, Requirement, checked, knows_bonds, require_shape
from .contacts.bonds import bond_rows, is_beam, limits_of_bonds
from .contacts.forces import HELD, bodies, check_materials
from .contacts.jacobian import linearise
from .contacts.neighbors import body_radii, check_list, gap_of_bonds, shifts
from .laws.builtin import MU, Law
from .laws.compiled import law_struct
from .library import core
from .readable import pluralize
from .state import OPEN, State, grain_volumes, groups, volume

HELD_FAST = 1 << 20  # number of supports of a body that cannot move: more than any grain needs

ROUND_OFF = 1e-9  # uncertainty of positions in radii: pairs closer to contact than this may or may not touch


def require_committed(name: str, state: State) -> None:
    """Raise ValueError if the contact memory does not belong to the positions of the state.

    Pairs within the range of a law may be in contact across a gap.
    """
    check_list(state)
    contacts, count, radius = state.contacts, int(state.contacts.count[0]), body_radii(state)
    i, j, known = contacts.i[:count], contacts.j[:count], contacts.mode[:count] != OPEN
    overlap, slack = radius[i] + radius[j] - np.linalg.norm(branch_vectors(state), axis=1), ROUND_OFF * radius[i]
    closed, opened = int((~known & (overlap > slack)).sum()), int((known & (overlap < -contacts.gap - slack)).sum())
    if closed or opened:
        number = f"{closed} closed" if closed else f"{opened} opened"
        raise ValueError(
            f"contacts have changed since they were committed ({number}, of {pluralize(count, 'listed pair')}): "
            "equilibrate, or accept(state, trial) first"
        )


Committed = Annotated[State, Requirement(require_committed)]


@checked
@knows_bonds
def touching(state: Committed) -> np.ndarray:
    """Rows of the contact list whose pairs touch, or are joined across a gap by a law or bond.

    Bonds, `jkr`, `liquid_bridge` and user-defined laws with `contact_range` act across gaps; `overlaps` is negative
    there.
    """
    joined = state.contacts.mode[: state.contacts.count[0]] != OPEN
    if state.bonds:
        check_list(state, gap_of_bonds(state))
        joined[bond_rows(state.bonds, state.contacts)[state.bonds.intact]] = True
    return np.flatnonzero(joined)


@checked
@knows_bonds
def branch_vectors(state: State) -> np.ndarray:
    """Vectors r_i − r_j + cellᵀ·image of all pairs in the list, (C, 3); at a wall, from its surface to i [length]."""
    contacts, grains, count, n = state.contacts, state.grains, int(state.contacts.count[0]), len(state.grains.radius)
    i, j = contacts.i[:count], contacts.j[:count]
    position = np.concatenate([grains.position, state.walls.point])
    out = position[i] - position[j] + shifts(contacts, state.cell.vectors)
    wall = j >= n
    normal = state.walls.normal[j[wall] - n]
    out[wall] = np.einsum("ck,ck->c", out[wall], normal)[:, None] * normal
    return out


@checked
@knows_bonds
def overlaps(state: State) -> np.ndarray:
    """Overlap of every pair in the list, (C,), negative for a gap [length]."""
    count, radius = int(state.contacts.count[0]), np.append(state.grains.radius, np.zeros(len(state.walls.mass)))
    reach = radius[state.contacts.i[:count]] + radius[state.contacts.j[:count]]
    return reach - np.linalg.norm(branch_vectors(state), axis=1)


def contact_velocity(state: State, rows: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity of i relative to j, a grain or a wall, at contacts: normal part (M,), tangential vector (M, 3).

    The flow of a deforming cell is included; `normal` points from j to i.
    """
    grains, n = state.grains, len(state.grains.radius)
    speed = np.concatenate([grains.velocity, state.walls.velocity])
    turn = np.concatenate([grains.radius[:, None] * grains.spin, np.zeros((len(state.walls.mass), 3))])
    i, j = state.contacts.i[rows], state.contacts.j[rows]
    flow = np.where((j < n)[:, None], branch_vectors(state)[rows] @ state.cell.rate.T, 0.0)
    v = speed[i] - speed[j] + flow - np.cross(turn[i] + turn[j], normal)
    pace = np.einsum("ck,ck->c", v, normal)
    return pace, v - pace[:, None] * normal


@checked
@knows_bonds
def contact_forces(state: State, law: Law, *, memory: int = HELD) -> np.ndarray:
    """Elastic force on body i of every pair in the list, (C, 3), zero for open pairs [force].

    `memory`: HELD for an accepted state; FREE for the forces of its trial memory, as in `contact_blocks`.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> force = ss.measure.contact_forces(state, law)
    >>> force.shape[1]
    3
    """
    return linearise(state, law, memory=memory).force


@checked
@knows_bonds
def stress(state: State, law: Law) -> np.ndarray:
    """Stress σ = (1/V) Σ f ⊗ r, each contact counted once, compression positive [force/length^(dim−1)].

    Parameters
    ----------
    state : State, accepted; in two dimensions V is the area
    law : Law

    Returns
    -------
    (3, 3); σ_ab has component a of the force and b of the branch vector; it is symmetric only if torques balance.
        Kinetic contributions are not included

    Source
    ------
    Bonfanti et al., doi:10.1103/PhysRevE.101.052902, before Fig. 5, with the opposite sign and 1/L² for 1/V.

    Examples
    --------
    >>> import numpy as np
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> stress = ss.measure.stress(state, law)
    >>> bool(np.isclose(np.trace(stress) / 3, ss.measure.pressure(state, law)))
    True
    """
    return np.einsum("ca,cb->ab", contact_forces(state, law), branch_vectors(state)) / volume(state)


@checked
@knows_bonds
def pressure(state: State, law: Law) -> float:
    """Trace of the stress divided by the number of dimensions."""
    return float(np.trace(stress(state, law))) / state.cell.dim


def mean_normal_force(state: State, law: Law) -> float:
    """Mean of |F_n| over touching contacts, forces of bonds included [force]; zero without contacts."""
    force = linearise(state, law).bearing[touching(state)]
    return float(force.mean()) if len(force) else 0.0


@checked
@knows_bonds
def wrapped(state: State) -> np.ndarray:
    """Positions wrapped into the cell, (N, 3): from 0 to 1 times the cell vectors along periodic directions."""
    return state.grains.position - periodic_box(state) @ state.cell.vectors


def periodic_box(state: State) -> np.ndarray:
    """Indices of the periodic image of the cell that contains each grain, (N, 3); zero along other axes."""
    cell = state.cell
    used = np.where(cell.vectors.any(axis=1)[:, None], cell.vectors, np.eye(3))
    return np.where(cell.periodic, np.floor(state.grains.position @ np.linalg.inv(used)), 0.0).astype(np.int64)


@checked
@knows_bonds
def fabric(state: Committed) -> np.ndarray:
    """Fabric tensor, (3, 3), the mean of n ⊗ n over touching contacts: trace 1, and 1/dim on the diagonal if isotropic.

    Source
    ------
    Oda, doi:10.3208/sandf1972.22.4_96.
    """
    normal = branch_vectors(state)[touching(state)]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return normal.T @ normal / max(len(normal), 1)


@checked
def inertial_number(shear_rate: float, pressure: Positive, *, diameter: Positive, density: Positive) -> float:
    """Inertial number I = γ̇ d √(ρ/P). Flows with I < 1e-3 count as quasi-static.

    In two dimensions, the density is mass per area.

    Source
    ------
    GDR MiDi, doi:10.1140/epje/i2003-10153-0.

    Examples
    --------
    >>> round(inertial_number(0.1, 5e6, diameter=3e-3, density=2500.0), 10)
    6.7082e-06
    """
    return abs(shear_rate) * diameter * float(np.sqrt(density / pressure))


@checked
@knows_bonds
def packing_fraction(state: State) -> float:
    """Volume of the grains (area of disks), with overlaps counted twice, divided by the volume of the cell."""
    return float(grain_volumes(state).sum()) / volume(state)


@checked
@knows_bonds
def contact_numbers(state: Committed) -> np.ndarray:
    """Number of touching contacts of each grain, (N,), walls included."""
    n, rows = len(state.grains.radius), touching(state)
    ends = np.concatenate([state.contacts.i[rows], state.contacts.j[rows]])
    return np.bincount(ends, minlength=state.n_bodies)[:n]


def least_supports(law: Law, dim: int) -> int:
    """Supports that a grain needs to carry forces: 2 with friction (one force cannot be balanced), dim + 1 without."""
    return 2 if law.table[..., MU].any() else dim + 1


def supports(state: State) -> tuple[np.ndarray, np.ndarray]:
    """First member of each body's rigid group, and number of the body's supports other than contacts, both (N + W,)."""
    control, dim = state.control, state.cell.dim
    free, load = control.free[:, :dim], control.force[:, :dim].copy()
    load[: len(state.grains.mass)] += np.outer(state.grains.mass, control.gravity[:dim])
    held = ~free | (control.spring[:, :dim] > 0)
    number = np.where(held.all(axis=1), HELD_FAST, (held | (load != 0)).any(axis=1))
    number[len(state.grains.mass) :] = HELD_FAST
    unit = np.arange(state.n_bodies)
    for members in filter(len, groups(control)):
        unit[members], number[members] = members[0], number[members].max()
    return unit, number


@checked
@knows_bonds
def rattlers(state: Committed, least: int = 2, known: np.ndarray | None = None) -> np.ndarray:
    """Rattlers, (N,) bool: grains with fewer than `least` supports, after recursive removal of rattlers.

    Each contact is a support, and so is a load, a spring or a fixed direction: at rest, the single contact of a grain
    under a load carries this load. Grains held in all directions are not rattlers. A rigid group is one body.

    Parameters
    ----------
    least : int, see `least_supports`
    known : (N,) bool, grains known to be rattlers, irrespective of contacts
    """
    n, rows = len(state.grains.radius), touching(state)
    unit, number = supports(state)
    i, j = unit[state.contacts.i[rows]], unit[state.contacts.j[rows]]
    if state.bonds:  # a single beam can hold a grain
        bonds = state.bonds
        beams = is_beam(bonds, state.cell.dim)
        i = np.append(i, np.repeat(unit[bonds.i[beams]], least))
        j = np.append(j, np.repeat(unit[bonds.j[beams]], least))
    loose = np.zeros(state.n_bodies, bool)
    if known is not None:
        require_shape((n,), known=known)
        loose[:n] = known
    while True:
        holds = ~(loose[i] | loose[j]) & (i != j)
        touched = np.bincount(np.concatenate([i[holds], j[holds]]), minlength=state.n_bodies)
        new = ((number + touched)[unit] < least) & ~loose
        if not new.any():
            return loose[:n]
        loose |= new


@checked
@knows_bonds
def coordination(state: Committed, least: int = 2) -> float:
    """Mean number of contacts of grains that have contacts and are not rattlers; zero if there are none.

    Contacts with rattlers are excluded, contacts with walls are included. `least` is passed to `rattlers`.
    """
    n, rows = len(state.grains.radius), touching(state)
    held = np.append(~rattlers(state, least), np.ones(len(state.walls.mass), bool))
    ends = np.stack([state.contacts.i[rows], state.contacts.j[rows]], axis=1)
    number = np.bincount(ends[held[ends].all(axis=1)].ravel(), minlength=state.n_bodies)[:n]
    return float(number.sum() / max(np.count_nonzero(number), 1))


@checked
@knows_bonds
def elastic_energy(state: State, law: Law) -> float:
    """Energy stored in normal springs and in bonds [energy]; tangential forces of contacts have no potential.

    Normal springs store Σ ∫ F_n dδ up to the overlap, k δ²/2 per contact for a linear law and (2/5) k δ^{5/2} for a
    Hertzian one. A bond stores ½ (k_n (|r| − r₀)² + k_s |u|² + k_b |β|² + k_ψ ψ²), see `core/contacts/bonds.py`; a
    fading bond stores the work that its loads do if all grow in proportion.
    """
    check_materials(state, law)
    struct, shift = law_struct(law, members=("energy", "range")), shifts(state.contacts, state.cell.vectors)
    here = bodies(state)
    stored = core.elastic_energy(struct, state.cell.dim, here, state.contacts, shift)
    if not state.bonds:
        return stored
    held = limits_of_bonds(state.bonds, state.cell.dim, here, state.cell.vectors).energy[state.bonds.intact]
    return stored + float(held.sum())
