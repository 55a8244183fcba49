"""Quench of a packing without friction: the elastic energy is minimised by FIRE, in one compiled loop.

A step needs the normal forces of all pairs of the neighbour list and no energy. The loop is left only for a new list.

Source: Bitzek et al., doi:10.1103/PhysRevLett.97.170201, with their parameters, and the step back of Guénolé et al.,
doi:10.1016/j.commatsci.2020.109584, when the motion turns uphill. The longest time step follows the stiffness.
"""

import numpy as np
from numba import njit

from ..core.contacts.forces import bodies
from ..core.contacts.geometry import pair_vector, shifts
from ..core.contacts.mechanics import effective_values, out_of_range
from ..core.contacts.neighbors import with_neighbor_list
from ..core.laws.builtin import Law
from ..core.laws.kinds import check_kind
from ..core.laws.oracle import normal_force, row, tangents
from ..core.options import INNER
from ..core.state import Grains, State, empty_contacts

STEPS = 100_000  # largest number
SKIN = 0.5  # of the neighbour list over the smallest radius: grains move far at first
SMALL = 1e-4  # largest unbalanced force over the mean contact force, at most
LATENCY, FASTER, SLOWER, MIXING, LESS_MIXING = 5, 1.1, 0.5, 0.1, 0.99
CHECK_EVERY = 50  # steps between two measurements of the stiffness
DT, MIX, DOWNHILL, LIMIT = range(4)  # entries of `pace`: time step, mixing, steps downhill, longest time step


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def _add_normal_forces(kind, dim, bodies, contacts, shift, p, force):
    """Add the normal forces of all pairs; return the mean of |F_n| over those that touch."""
    radius, material, total, touching = bodies.radius, bodies.material, 0.0, 0
    for c in range(contacts.count[0]):
        i, j = np.uint64(contacts.i[c]), np.uint64(contacts.j[c])
        rx, ry, rz = pair_vector(dim, bodies.position, shift, c, i, j)
        distance = np.sqrt(rx * rx + ry * ry + rz * rz)
        overlap = radius[i] + radius[j] - distance
        if out_of_range(kind, p, material, radius, bodies.inverse_mass, i, j, False, overlap):
            continue
        q = row(kind, p, np.uint64(material[i]), np.uint64(material[j]))
        r_eff, _ = effective_values(kind, 0, radius, bodies.inverse_mass, i, j, False)
        fn = normal_force(kind, q, r_eff, overlap)
        f = fn / distance
        total += abs(fn)
        touching += 1
        force[i, 0] += f * rx
        force[i, 1] += f * ry
        force[j, 0] -= f * rx
        force[j, 1] -= f * ry
        if dim == 3:
            force[i, 2] += f * rz
            force[j, 2] -= f * rz
    return total / max(touching, 1)


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def _largest_stiffness(kind, dim, bodies, contacts, shift, p, stiffness):
    """Largest sum of |dF_n/dδ| over the contacts of a grain, which bounds ω² ≤ 2 Σ k for m = 1."""
    radius, material, most = bodies.radius, bodies.material, 0.0
    stiffness[:] = 0.0
    for c in range(contacts.count[0]):
        i, j = np.uint64(contacts.i[c]), np.uint64(contacts.j[c])
        rx, ry, rz = pair_vector(dim, bodies.position, shift, c, i, j)
        overlap = radius[i] + radius[j] - np.sqrt(rx * rx + ry * ry + rz * rz)
        if not out_of_range(kind, p, material, radius, bodies.inverse_mass, i, j, False, overlap):
            q = row(kind, p, np.uint64(material[i]), np.uint64(material[j]))
            r_eff, _ = effective_values(kind, 0, radius, bodies.inverse_mass, i, j, False)
            k = abs(tangents(kind, q, r_eff, overlap)[0])
            stiffness[i] += k
            stiffness[j] += k
            most = max(most, stiffness[i], stiffness[j])
    return most


@njit(cache=True, fastmath=True, error_model="numpy")
def _descend(kind, dim, bodies, contacts, shift, p, v, force, stiffness, pace, tolerance, steps):
    """Steps of FIRE until the forces balance or the list expires; return their number, whether they balance, and why.

    `v`, `force` and `pace` are continued from the last call.
    """
    x, f, u, origin = bodies.position.reshape(-1), force.reshape(-1), v.reshape(-1), contacts.origin.reshape(-1)
    reach = 0.5 * contacts.skin / np.sqrt(dim)
    f[:] = 0.0
    mean = _add_normal_forces(kind, dim, bodies, contacts, shift, p, force)
    for step in range(steps):
        worst = power = speed = size = 0.0
        for q in range(len(f)):
            worst = max(worst, abs(f[q]))
            power += u[q] * f[q]
            speed += u[q] * u[q]
            size += f[q] * f[q]
        if worst <= tolerance and (worst <= SMALL * mean or mean <= SMALL * tolerance):
            return step, True
        if step % CHECK_EVERY == 0:
            k = _largest_stiffness(kind, dim, bodies, contacts, shift, p, stiffness)
            pace[LIMIT] = np.sqrt(2.0 / k) if k > 0.0 else pace[LIMIT]
            pace[DT] = min(pace[DT], pace[LIMIT]) if pace[DT] > 0.0 else 0.1 * pace[LIMIT]
        if power > 0.0:
            pace[DOWNHILL] += 1.0
            if pace[DOWNHILL] > LATENCY:
                pace[DT], pace[MIX] = min(FASTER * pace[DT], pace[LIMIT]), LESS_MIXING * pace[MIX]
        else:
            pace[DOWNHILL], pace[MIX] = 0.0, MIXING
            pace[DT] *= SLOWER if step > LATENCY else 1.0
            for q in range(len(f)):
                x[q] -= 0.5 * pace[DT] * u[q]
                u[q] = 0.0
            speed = 0.0
        dt, keep, far = pace[DT], 1.0 - pace[MIX], 0.0
        along = pace[MIX] * np.sqrt(speed / size) if size > 0.0 else 0.0
        for q in range(len(f)):
            u[q] += dt * f[q]
            u[q] = keep * u[q] + along * f[q]
            x[q] += dt * u[q]
            far = max(far, abs(x[q] - origin[q]))
            f[q] = 0.0
        if far > reach:
            return step + 1, False
        mean = _add_normal_forces(kind, dim, bodies, contacts, shift, p, force)
    return steps, False


def quench(state: State, law: Law, tolerance: float, steps: int = STEPS) -> State:
    """State at a minimum of the elastic energy of its normal forces; contact memory is not committed.

    Parameters
    ----------
    state : State without walls, all of whose grains are free
    law : Law without friction
    tolerance : float, largest unbalanced force [force]. It is also at most 1e-4 of the mean contact force, so that
        grains which lose all contacts are not taken for jammed
    steps : int, largest number of steps; if they do not suffice, the last positions are returned
    """
    check_kind(law.kind)
    order = _order_in_space(state)
    contacts = empty_contacts(state.n_bodies, 0, SKIN * state.grains.radius.min())._replace(gap=state.contacts.gap)
    here = state._replace(grains=Grains(*(part[order] for part in state.grains)), contacts=contacts)
    v, force, stiffness = np.zeros((state.n_bodies, 3)), np.zeros((state.n_bodies, 3)), np.zeros(state.n_bodies)
    pace, balanced = np.array([0.0, MIXING, 0.0, 1.0]), False
    while steps > 0 and not balanced:
        here = with_neighbor_list(here, law)
        moving = bodies(here)
        done, balanced = _descend(
            law.kind, here.cell.dim, moving, here.contacts, shifts(here.contacts, here.cell.vectors), law.table, v,
            force, stiffness, pace, tolerance, steps,
        )  # fmt: skip
        steps -= max(done, 1)
        here = here._replace(
            grains=here.grains._replace(position=moving.position), contacts=here.contacts._replace(stale=True)
        )
    position = np.empty_like(state.grains.position)
    position[order] = here.grains.position
    return state._replace(grains=state.grains._replace(position=position), contacts=state.contacts._replace(stale=True))


def _order_in_space(state: State) -> np.ndarray:
    """Order of grains in which neighbours in space are close in memory, (N,)."""
    edge = 2 * state.grains.radius.max()
    return np.lexsort(np.floor(state.grains.position / edge).T)
