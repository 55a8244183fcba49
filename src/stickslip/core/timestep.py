"""The largest time step that velocity Verlet bears: 2/ω of the stiffest mode of the contact network."""

import numpy as np
from numba import njit

from .contact import apart, effective
from .forces import Bodies, bodies, check_materials
from .frame import cell_mass
from .geometry import normal_and_overlap, pair_vector, shifts
from .laws import Law, row, tangential_stiffness, tangents
from .measure import volume
from .neighbors import updated
from .plan import inverse_inertia_of
from .rolling import of_rolling
from .state import State, groups


@njit(cache=True, error_model="numpy")
def _springs(kind, dim, bodies, contacts, shift, p, normal, springs):
    """Normals, and stiffnesses (k_n, k_t) and branch length of all contacts that touch; zero for the rest."""
    _, _, _, _, radius, material, inverse_mass, wall_normal, _ = bodies
    n = len(radius) - len(wall_normal)
    for c in range(contacts.count[0]):
        i, j = contacts.i[c], contacts.j[c]
        rx, ry, rz = pair_vector(dim, bodies.position, shift, c, i, j)
        nx, ny, nz, overlap, _ = normal_and_overlap(i, j, j >= n, j - n, radius, wall_normal, rx, ry, rz)
        springs[c, 0] = springs[c, 1] = springs[c, 2] = 0.0
        if not apart(kind, p, material, radius, inverse_mass, i, j, j >= n, overlap):
            q = row(kind, p, material[i], material[j])
            r_eff, _ = effective(kind, 0, radius, inverse_mass, i, j, j >= n)
            # cohesion softens with the gap: as stiff as if it were not negative, to be on the safe side
            springs[c, 0] = abs(tangents(kind, q, r_eff, overlap)[0])
            springs[c, 1] = tangential_stiffness(kind, q, r_eff, overlap)
            springs[c, 2] = np.sqrt(rx * rx + ry * ry + rz * rz)
        normal[c, 0], normal[c, 1], normal[c, 2] = nx, ny, nz


@njit(cache=True)
def _bound(contacts, springs, radius, inverse_mass, inverse_inertia, cell):
    """Upper bound of ω²: (a − b)² ≤ 2a² + 2b² in every contact, (a − b + c + d)² ≤ 4 (a² + b² + c² + d²) along it.

    With a free cell there is one term more, and `cell` (3, 3) holds 1/(M ℓ²) of its free components.
    """
    moves, turns, strains = np.zeros(len(radius)), np.zeros(len(radius)), 0.0
    more = 1.0 if cell.max() > 0.0 else 0.0
    for c in range(contacts.count[0]):
        for a in (contacts.i[c], contacts.j[c]):
            moves[a] += max((2 + more) * springs[c, 0], (4 + more) * springs[c, 1]) * inverse_mass[a]
            turns[a] += (4 + more) * springs[c, 1] * radius[a] ** 2 * inverse_inertia[a]
        strains += 5 * max(springs[c, 0], springs[c, 1]) * springs[c, 2] ** 2 * cell.max()
    return max(moves.max(), turns.max(), strains)


@njit(cache=True)
def _largest(contacts, normal, springs, radius, inverse_mass, inverse_inertia, cell, rounds):
    """Largest ω² by power iteration on M^(−1/2) K M^(−1/2)."""
    bodies = len(radius)
    root = np.empty((bodies, 6))
    for a in range(bodies):
        for k in range(3):
            root[a, k], root[a, 3 + k] = np.sqrt(inverse_mass[a]), radius[a] * np.sqrt(inverse_inertia[a])
    x, value = np.empty((bodies, 6)), 0.0
    e, weight = np.sqrt(cell), np.sqrt(cell)
    for a in range(bodies):
        for k in range(6):
            x[a, k] = np.sin(1.0 + 7.0 * a + 3.1 * k)
    for _ in range(rounds):
        size = np.sqrt((x * x).sum() + (e * e).sum())
        if size == 0.0:
            return 0.0
        x *= root / size
        e *= weight / size
        y, pull = np.zeros((bodies, 6)), np.zeros((3, 3))
        for c in range(contacts.count[0]):
            i, j, n = contacts.i[c], contacts.j[c], normal[c]
            d, w = x[i, :3] - x[j, :3], x[i, 3:] + x[j, 3:]
            for a in range(3):
                for b in range(3):
                    d[a] += e[a, b] * n[b] * springs[c, 2]
            t = d + np.array([n[1] * w[2] - n[2] * w[1], n[2] * w[0] - n[0] * w[2], n[0] * w[1] - n[1] * w[0]])
            along = (d * n).sum()
            f = springs[c, 0] * along * n + springs[c, 1] * (t - (t * n).sum() * n)
            q = np.array([n[2] * f[1] - n[1] * f[2], n[0] * f[2] - n[2] * f[0], n[1] * f[0] - n[0] * f[1]])
            for a in range(3):
                for b in range(3):
                    pull[a, b] += f[a] * n[b] * springs[c, 2]
            y[i, :3] += f
            y[j, :3] -= f
            y[i, 3:] += q
            y[j, 3:] += q
        x, e = y * root, pull * weight
        value = size
    return value


def _network(state: State, law: Law, here: Bodies):
    count = int(state.contacts.count[0])
    normal, springs = np.empty((count, 3)), np.empty((count, 3))
    shift = shifts(state.contacts, state.cell.vectors)
    _springs(law.kind, state.cell.dim, here, state.contacts, shift, law.table, normal, springs)
    return normal, springs


def _inverse_cell(state: State) -> np.ndarray:
    """(3, 3) 1/(M ℓ²) of the free components of the cell, else zero [1/(mass length²)]."""
    free = state.control.cell_free
    return free / (cell_mass(state) * volume(state) ** (2 / state.cell.dim)) if free.any() else np.zeros((3, 3))


def _of_springs(state: State, here: Bodies) -> float:
    """Largest ω² of a body, or of a rigid group, on its springs to load points alone [1/time²]."""
    total = state.control.spring.copy()
    for members in groups(state.control):
        total[members] = total[members].sum(axis=0)
    return float((total.max(axis=1) * here.inverse_mass).max())


def stable_time_step(state: State, law: Law) -> float:
    """2/ω_max of the springs of all contacts that touch, sliding or not [time]; infinite without contacts.

    Springs to load points and springs of rolling make it shorter, by no less than what is needed.

    Beyond it velocity Verlet blows up. A tenth of it gives four digits of a contact's force.

    Examples
    --------
    >>> from stickslip import assembly, linear, spheres
    >>> pair = assembly(spheres([[0, 0, 0], [0.99, 0, 0]], 0.5))
    >>> round(stable_time_step(pair, linear(kn=1.0, kt=0.0)), 6)  # ω² = 2 k_n/m
    1.414214
    """
    check_materials(state, law)
    state = updated(state, law)
    here = bodies(state)
    normal, springs = _network(state, law, here)
    largest = _largest(
        state.contacts, normal, springs, here.radius, here.inverse_mass, inverse_inertia_of(state),
        _inverse_cell(state), 300,
    )  # fmt: skip
    largest += _of_springs(state, here) + of_rolling(state, law, here, inverse_inertia_of(state))
    return float(2 / np.sqrt(largest)) if largest > 0 else np.inf


def check_time_step(state: State, law: Law, here: Bodies, dt: float) -> None:
    """Raise ValueError with the largest stable time step if `dt` is above it; the list must be up to date."""
    if not (state.contacts.count[0] or state.control.spring.any()):
        return
    _, springs = _network(state, law, here)
    bound = (
        _of_springs(state, here)
        + of_rolling(state, law, here, inverse_inertia_of(state))
        + _bound(
            state.contacts, springs, here.radius, here.inverse_mass, inverse_inertia_of(state), _inverse_cell(state)
        )
    )
    if dt * dt * bound <= 4.0:
        return
    longest = stable_time_step(state, law)
    if dt > longest:
        raise ValueError(
            f"dt = {dt:g} was given, but contacts as stiff as these are stable up to {longest:.4g} only: "
            f"use at most that, and a tenth of it for accuracy"
        )
