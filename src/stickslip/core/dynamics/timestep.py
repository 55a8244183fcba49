"""Largest stable time step of velocity Verlet: 2/ω of the stiffest mode of the contact network."""

import numpy as np
from numba import njit

from ..arguments import checked
from ..contacts.forces import Bodies, bodies, check_materials
from ..contacts.geometry import normal_and_overlap, pair_vector, shifts
from ..contacts.mechanics import effective_values, out_of_range
from ..contacts.neighbors import with_neighbor_list
from ..contacts.rolling import rolling_bound
from ..laws.builtin import Law
from ..laws.oracle import row, tangential_stiffness, tangents
from ..measure import volume
from ..options import INNER
from ..state import State, groups
from .cell_motion import cell_mass
from .coefficients import inverse_inertia_of


@njit(cache=True, error_model="numpy", _nrt=False, **INNER)
def _contact_spring(kind, dim, bodies, contacts, shift, p, c):
    """Normal, stiffnesses k_n, k_t and branch length of a contact; the last three are zero if it does not touch."""
    _, _, _, _, radius, material, inverse_mass, wall_normal, _ = bodies
    n = np.uint64(len(radius) - len(wall_normal))
    i, j = np.uint64(contacts.i[c]), np.uint64(contacts.j[c])
    rx, ry, rz = pair_vector(dim, bodies.position, shift, c, i, j)
    nx, ny, nz, overlap, _ = normal_and_overlap(i, j, j >= n, j - n, radius, wall_normal, rx, ry, rz)
    if out_of_range(kind, p, material, radius, inverse_mass, i, j, j >= n, overlap):
        return nx, ny, nz, 0.0, 0.0, 0.0
    q = row(kind, p, np.uint64(material[i]), np.uint64(material[j]))
    r_eff, _ = effective_values(kind, 0, radius, inverse_mass, i, j, j >= n)
    # cohesion may have negative stiffness; its absolute value gives a safe bound
    along = abs(tangents(kind, q, r_eff, overlap)[0])
    return nx, ny, nz, along, tangential_stiffness(kind, q, r_eff, overlap), np.sqrt(rx * rx + ry * ry + rz * rz)


@njit(cache=True, error_model="numpy", _nrt=False)
def _contact_springs(kind, dim, bodies, contacts, shift, p, normal, springs):
    """Write normals, stiffnesses (k_n, k_t) and branch lengths of all touching contacts; zero for the rest."""
    for c in range(np.uint64(contacts.count[0])):
        normal[c, 0], normal[c, 1], normal[c, 2], springs[c, 0], springs[c, 1], springs[c, 2] = _contact_spring(
            kind, dim, bodies, contacts, shift, p, c
        )


@njit(cache=True, error_model="numpy")
def _frequency_bound(kind, dim, bodies, contacts, shift, p, inverse_inertia, cell):
    """Upper bound on ω²: (a − b)² ≤ 2a² + 2b² in every contact, (a − b + c + d)² ≤ 4 (a² + b² + c² + d²) along it.

    A free cell adds one term, and `cell` (3, 3) holds 1/(M ℓ²) of its free components.
    """
    radius, inverse_mass, weight = bodies.radius, bodies.inverse_mass, cell.max()
    moves, turns, strains, more = np.zeros(len(radius)), np.zeros(len(radius)), 0.0, 1.0 if weight > 0.0 else 0.0
    for c in range(np.uint64(contacts.count[0])):
        _, _, _, kn, kt, branch = _contact_spring(kind, dim, bodies, contacts, shift, p, c)
        if branch > 0.0:
            for end in (contacts.i[c], contacts.j[c]):
                a = np.uint64(end)
                moves[a] += max((2 + more) * kn, (4 + more) * kt) * inverse_mass[a]
                turns[a] += (4 + more) * kt * radius[a] ** 2 * inverse_inertia[a]
            strains += 5 * max(kn, kt) * branch**2 * weight
    return max(moves.max(), turns.max(), strains)


@njit(cache=True, _nrt=False)
def _add_spring_forces(contacts, normal, springs, x, e, y, pull):
    """Add K x to y and, for the cell, to `pull`. Scalars are used because array expressions compile slowly."""
    for c in range(contacts.count[0]):
        i, j = contacts.i[c], contacts.j[c]
        n0, n1, n2, arm = normal[c, 0], normal[c, 1], normal[c, 2], springs[c, 2]
        d0, d1, d2 = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
        w0, w1, w2 = x[i, 3] + x[j, 3], x[i, 4] + x[j, 4], x[i, 5] + x[j, 5]
        d0 += (e[0, 0] * n0 + e[0, 1] * n1 + e[0, 2] * n2) * arm
        d1 += (e[1, 0] * n0 + e[1, 1] * n1 + e[1, 2] * n2) * arm
        d2 += (e[2, 0] * n0 + e[2, 1] * n1 + e[2, 2] * n2) * arm
        t0, t1, t2 = d0 + n1 * w2 - n2 * w1, d1 + n2 * w0 - n0 * w2, d2 + n0 * w1 - n1 * w0
        along, across = springs[c, 0] * (d0 * n0 + d1 * n1 + d2 * n2), t0 * n0 + t1 * n1 + t2 * n2
        f0 = along * n0 + springs[c, 1] * (t0 - across * n0)
        f1 = along * n1 + springs[c, 1] * (t1 - across * n1)
        f2 = along * n2 + springs[c, 1] * (t2 - across * n2)
        for k, f, q in ((0, f0, n2 * f1 - n1 * f2), (1, f1, n0 * f2 - n2 * f0), (2, f2, n1 * f0 - n0 * f1)):
            y[i, k] += f
            y[j, k] -= f
            y[i, 3 + k] += q
            y[j, 3 + k] += q
            pull[k, 0] += f * n0 * arm
            pull[k, 1] += f * n1 * arm
            pull[k, 2] += f * n2 * arm


def _largest_squared_frequency(contacts, normal, springs, radius, inverse_mass, inverse_inertia, cell, rounds):
    """Largest ω² by power iteration on M^(−1/2) K M^(−1/2)."""
    root = np.repeat(np.sqrt(np.stack([inverse_mass, radius**2 * inverse_inertia], axis=1)), 3, axis=1)
    x, weight = np.sin(1.0 + 7.0 * np.arange(len(radius))[:, None] + 3.1 * np.arange(6)), np.sqrt(cell)
    e, value = weight, 0.0
    for _ in range(rounds):
        value = float(np.sqrt((x * x).sum() + (e * e).sum()))
        if value == 0.0:
            return 0.0
        y, pull = np.zeros_like(x), np.zeros((3, 3))
        _add_spring_forces(contacts, normal, springs, x * (root / value), e * (weight / value), y, pull)
        x, e = y * root, pull * weight
    return value


def _spring_network(state: State, law: Law, here: Bodies):
    count = int(state.contacts.count[0])
    normal, springs = np.empty((count, 3)), np.empty((count, 3))
    shift = shifts(state.contacts, state.cell.vectors)
    _contact_springs(law.kind, state.cell.dim, here, state.contacts, shift, law.table, normal, springs)
    return normal, springs


def _inverse_cell_inertia(state: State) -> np.ndarray:
    """Inverse inertia 1/(M ℓ²) of the free components of the cell, (3, 3), else zero [1/(mass length²)]."""
    free = state.control.cell_free
    return free / (cell_mass(state) * volume(state) ** (2 / state.cell.dim)) if free.any() else np.zeros((3, 3))


def _load_spring_bound(state: State, here: Bodies) -> float:
    """Largest ω² of a body or rigid group due to its springs to load points alone [1/time²]."""
    if not state.control.spring.any():
        return 0.0
    total = state.control.spring.copy()
    for members in groups(state.control):
        total[members] = total[members].sum(axis=0)
    return float((total.max(axis=1) * here.inverse_mass).max())


@checked
def stable_time_step(state: State, law: Law) -> float:
    """Largest stable time step 2/ω_max of all touching contacts, sliding or not [time]; infinite without contacts.

    Springs to load points and rolling springs are included through upper bounds on their ω².

    Velocity Verlet is unstable beyond this time step. A tenth of this limit gives the force of a contact to four
    digits.

    Examples
    --------
    >>> import stickslip as ss
    >>> pair = ss.assembly(ss.spheres([[0, 0, 0], [0.99, 0, 0]], 0.5))
    >>> round(stable_time_step(pair, ss.laws.linear(kn=1.0, kt=0.0)), 6)  # ω² = 2 k_n/m
    1.414214
    """
    check_materials(state, law)
    state = with_neighbor_list(state, law)
    here = bodies(state)
    normal, springs = _spring_network(state, law, here)
    largest = _largest_squared_frequency(
        state.contacts, normal, springs, here.radius, here.inverse_mass, inverse_inertia_of(state),
        _inverse_cell_inertia(state), 300,
    )  # fmt: skip
    largest += _load_spring_bound(state, here) + rolling_bound(state, law, here, inverse_inertia_of(state))
    return float(2 / np.sqrt(largest)) if largest > 0 else np.inf


def check_time_step(state: State, law: Law, here: Bodies, dt: float) -> None:
    """Raise ValueError with the largest stable time step if `dt` is above it; the list must be up to date."""
    if not (state.contacts.count[0] or state.control.spring.any()):
        return
    inverse_inertia, shift = inverse_inertia_of(state), shifts(state.contacts, state.cell.vectors)
    bound = (
        _load_spring_bound(state, here)
        + rolling_bound(state, law, here, inverse_inertia)
        + _frequency_bound(
            law.kind,
            state.cell.dim,
            here,
            state.contacts,
            shift,
            law.table,
            inverse_inertia,
            _inverse_cell_inertia(state),
        )
    )
    if dt * dt * bound <= 4.0:
        return
    longest = stable_time_step(state, law)
    if dt > longest:
        raise ValueError(
            f"dt = {dt:g} was given, but with contacts this stiff steps are stable only up to {longest:.4g}: "
            f"use at most that, or a tenth of it for accuracy"
        )
