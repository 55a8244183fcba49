"""Forces, torques and trial memory of all contacts.

`forces` returns loads and *trial* contacts and leaves the state unchanged; only `accept` commits them. The kernel
`sweep_contacts` works in place on the list it receives: a copy here, the stepper's own list in `run`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from ..arguments import checked
from ..control import spring_forces
from ..laws.builtin import (
    DAMPING_N,
    DAMPING_T,
    Law,
    cap,
    contact_damping,
    damping_model,
    least_force,
    normal_force,
    reach,
    rescaling_flag,
    row,
    tangential_stiffness,
)
from ..laws.dispatch import check_kind
from ..options import INNER
from ..readable import pluralize, readable
from ..state import OPEN, SLIDE, State, groups
from .geometry import (
    at_contact,
    mid_normal,
    normal_and_overlap,
    onto_plane,
    pair_vector,
    shifts,
    slip_increment,
    surface_rotation,
    touching_fraction,
)
from .mechanics import (
    FREE,
    FROZEN,
    HELD,
    effective_values,
    out_of_range,
    rescale_slip,
    return_mapping,
    tangential_force,
    with_dashpot,
    with_tangential_dashpot,
)
from .neighbors import body_positions, body_radii, join_bodies, with_neighbor_list
from .rolling import add_rolling, forget_rolling

CLOSED, OPENED, REACHED_LIMIT = 0, 1, 2
EVENT_COLUMNS = ("kind", "time", "i", "j", "image_x", "image_y", "image_z", "x", "y", "z")


class Bodies(NamedTuple):
    """Grains and walls in one set of arrays, as kernels expect them."""

    position: np.ndarray  # (B, 3)
    angle: np.ndarray  # (B, 3)
    velocity: np.ndarray  # (B, 3)
    spin: np.ndarray  # (B, 3)
    radius: np.ndarray  # (B,)
    material: np.ndarray  # (B,)
    inverse_mass: np.ndarray  # (B,) 1/m, zero for what does not translate
    normal: np.ndarray  # (W, 3)
    rate: np.ndarray  # (3, 3) velocity gradient of the cell


@readable
class ContactLoads(NamedTuple):
    """Resultants of the contacts on every body; external loads are not included."""

    force: np.ndarray  # (N + W, 3) [force]
    torque: np.ndarray  # (N + W, 3) [force length]
    virial: np.ndarray  # (3, 3) Σ f ⊗ r over contacts between grains, elastic; only where the cell is free [energy]


def moved_masses(state: State) -> np.ndarray:
    """Mass that moves with each body, (B,): its own, or that of its rigid group."""
    own = np.concatenate([state.grains.mass, state.walls.mass])
    for members in groups(state.control):
        own[members] = own[members].sum()
    return own


def bodies(state: State) -> Bodies:
    """New arrays of all bodies, grains followed by walls. Radii and materials must not be written to."""
    grains, walls = state.grains, state.walls
    still = np.zeros((len(walls.mass), 3))
    return Bodies(
        body_positions(state),
        np.concatenate([grains.angle, still]),
        np.concatenate([grains.velocity, walls.velocity]),
        np.concatenate([grains.spin, still]),
        body_radii(state),
        join_bodies(grains.material, walls.material),
        state.control.free[:, : state.cell.dim].any(axis=1) / moved_masses(state),
        walls.normal,
        state.cell.rate.copy(),
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def relative_velocity(dim, velocity, spin, radius, rate, i, j, rx, ry, rz, nx, ny, nz):
    """Normal component and tangential vector of the velocity of i relative to j at the contact [length/time].

    `rate` is the velocity gradient L of the cell, which adds L r.
    """
    wx, wy, wz = surface_rotation(dim, spin, radius, i, j)
    vx, vy = velocity[i, 0] - velocity[j, 0], velocity[i, 1] - velocity[j, 1]
    vz = velocity[i, 2] - velocity[j, 2] if dim == 3 else 0.0
    vx += rate[0, 0] * rx + rate[0, 1] * ry + rate[0, 2] * rz
    vy += rate[1, 0] * rx + rate[1, 1] * ry + rate[1, 2] * rz
    if dim == 3:
        vz += rate[2, 0] * rx + rate[2, 1] * ry + rate[2, 2] * rz
    vx, vy, vz = at_contact(nx, ny, nz, vx, vy, vz, wx, wy, wz)
    vn = vx * nx + vy * ny + vz * nz
    return vn, vx - vn * nx, vy - vn * ny, vz - vn * nz


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def is_unmoved(dim, pair, roll, c, rx, ry, rz, ax, ay, az):
    """Return True if the pair vector and rolled angle are those at which the contact's memory was committed."""
    plane = rx == pair[c, 0] and ry == pair[c, 1] and az == roll[c, 2]
    return plane and (dim == 2 or (rz == pair[c, 2] and ax == roll[c, 0] and ay == roll[c, 1]))


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def record_event(events, event_count, kind, time, i, j, image, c, place, at):
    """Append one row of EVENT_COLUMNS. Rows beyond the capacity are counted but not stored."""
    k = event_count[0]
    event_count[0] = k + 1
    if k >= len(events):
        return
    events[k, 0], events[k, 1], events[k, 2], events[k, 3] = kind, time, i, j
    for m in range(3):
        events[k, 4 + m] = image[c, m]
        events[k, 7 + m] = place[at, m]


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True, **INNER)
def sweep_contacts(
    kind, coulomb, dim, bodies, contacts, shift, p, viscous, memory, step, force, torque, time, events, event_count,
    rescaled,
):  # fmt: skip
    """Add the loads of all contacts and update their memory in place. The function is inlined into its callers.

    `step` holds the velocities, spins and length of the step that ends here. They determine the fraction of the
    step during which a closing contact touched. If the length is zero, the contact starts without slip. `rescaled`: see
    `builtin.rescaling_flag`.
    """
    position, angle, velocity, spin, radius, material, inverse_mass, wall_normal, rate = bodies
    n_grains = len(radius) - len(wall_normal)
    slip, mode, pair, roll = contacts.slip, contacts.mode, contacts.pair, contacts.roll
    for c in range(contacts.count[0]):
        is_wall = contacts.j[c] >= n_grains
        # unsigned, so that indices are not checked for negative values
        i, j, wall = np.uint64(contacts.i[c]), np.uint64(contacts.j[c]), np.uint64(contacts.j[c] - n_grains)
        rx, ry, rz = pair_vector(dim, position, shift, c, i, j)
        nx, ny, nz, overlap, inverse = normal_and_overlap(i, j, is_wall, wall, radius, wall_normal, rx, ry, rz)
        before = mode[c]
        if out_of_range(kind, p, material, radius, inverse_mass, i, j, is_wall, overlap):
            if before != OPEN:
                mode[c] = OPEN
                contacts.reached[c] = False
                slip[c, 0] = slip[c, 1] = slip[c, 2] = 0.0
                forget_rolling(kind, contacts.rolling, c)
                record_event(events, event_count, OPENED, time, i, j, contacts.image, c, position, i)
            continue
        q = row(kind, p, np.uint64(material[i]), np.uint64(material[j]))
        r_eff, m_eff = effective_values(kind, viscous, radius, inverse_mass, i, j, is_wall)
        ax, ay, az = surface_rotation(dim, angle, radius, i, j)
        kept = memory == FROZEN and before != OPEN and is_unmoved(dim, pair, roll, c, rx, ry, rz, ax, ay, az)
        # previous slip rotated with the contact, its increment, and the mid-step normal
        sx = sy = sz = dx = dy = dz = 0.0
        mx, my, mz, part, whole, fade = nx, ny, nz, 1.0, 1.0, 1.0
        if kept:
            sx, sy, sz = slip[c, 0], slip[c, 1], slip[c, 2] if dim == 3 else 0.0
        elif before != OPEN:
            dx, dy, dz = rx - pair[c, 0], ry - pair[c, 1], rz - pair[c, 2] if dim == 3 else 0.0
            wx, wy = (ax - roll[c, 0], ay - roll[c, 1]) if dim == 3 else (0.0, 0.0)
            mx, my, mz = mid_normal(nx, ny, nz, inverse, dx, dy, dz)
            sx, sy, sz = slip[c, 0], slip[c, 1], slip[c, 2] if dim == 3 else 0.0
            sx, sy, sz = onto_plane(nx, ny, nz, mx, my, mz, sx, sy, sz)
            if rescaled is not None:
                fade, sx, sy, sz = rescale_slip(overlap, nx, ny, nz, inverse, dx, dy, dz, sx, sy, sz)
            dx, dy, dz = slip_increment(nx, ny, nz, mx, my, mz, dx, dy, dz, wx, wy, az - roll[c, 2])
            if rescaled is not None:  # the increment before the overlap decreased is shortened, too
                half = 0.5 * (1.0 + fade)
                dx, dy, dz = half * dx, half * dy, half * dz
        elif step[2] > 0.0:
            dt, v, w = step[2], step[0], step[1]
            dx, dy = dt * (v[i, 0] - v[j, 0]), dt * (v[i, 1] - v[j, 1])
            dz = dt * (v[i, 2] - v[j, 2]) if dim == 3 else 0.0
            wx, wy, wz = surface_rotation(dim, w, radius, i, j)
            mx, my, mz = mid_normal(nx, ny, nz, inverse, dx, dy, dz)
            part, whole = touching_fraction(nx, ny, nz, inverse, overlap + reach(kind, q, r_eff), dx, dy, dz)
            dx, dy, dz = slip_increment(nx, ny, nz, mx, my, mz, dx, dy, dz, dt * wx, dt * wy, dt * wz)
        fn = normal_force(kind, q, r_eff, overlap)
        vx = vy = vz = factor = 0.0
        if viscous:
            vn, vx, vy, vz = relative_velocity(dim, velocity, spin, radius, rate, i, j, rx, ry, rz, nx, ny, nz)
            factor = contact_damping(kind, viscous, r_eff, m_eff, overlap)
            fn = with_dashpot(viscous, fn, factor * q[DAMPING_N], vn, least_force(kind, fn))
        limit = cap(kind, q, r_eff, overlap, fn)
        stiffness = tangential_stiffness(kind, q, r_eff, overlap)
        after = before
        if not kept:
            if rescaled is not None:
                sx, sy, sz, after = return_mapping(
                    dim, stiffness, limit, sx, sy, sz, dx, dy, dz, part, whole, before, memory, fade
                )
            else:
                sx, sy, sz, after = return_mapping(
                    dim, stiffness, limit, sx, sy, sz, dx, dy, dz, part, whole, before, memory
                )
            slip[c, 0], slip[c, 1], pair[c, 0], pair[c, 1], roll[c, 2] = sx, sy, rx, ry, az
            if dim == 3:
                slip[c, 2], pair[c, 2], roll[c, 0], roll[c, 1] = sz, rz, ax, ay
            if after != before:
                mode[c] = after
                if before == OPEN:
                    record_event(events, event_count, CLOSED, time, i, j, contacts.image, c, position, i)
                if after == SLIDE and limit > 0.0 and not contacts.reached[c]:
                    contacts.reached[c] = True
                    record_event(events, event_count, REACHED_LIMIT, time, i, j, contacts.image, c, position, i)
        tx, ty, tz = tangential_force(coulomb, stiffness, limit, sx, sy, sz)
        if viscous:
            tx, ty, tz = with_tangential_dashpot(tx, ty, tz, factor * q[DAMPING_T], limit, vx, vy, vz)
        fx, fy, fz = fn * nx + tx, fn * ny + ty, fn * nz + tz
        qx, qy, qz = nz * ty - ny * tz, nx * tz - nz * tx, ny * tx - nx * ty
        add_rolling(
            kind, dim, memory, kept, q, r_eff, overlap, fn, angle, step, part, whole, (nx, ny, nz, mx, my, mz),
            contacts.rolling, c, i, j, before, torque,
        )  # fmt: skip
        force[i, 0] += fx
        force[i, 1] += fy
        force[j, 0] -= fx
        force[j, 1] -= fy
        torque[i, 2] += radius[i] * qz
        torque[j, 2] += radius[j] * qz
        if dim == 3:
            force[i, 2] += fz
            force[j, 2] -= fz
            torque[i, 0] += radius[i] * qx
            torque[i, 1] += radius[i] * qy
            torque[j, 0] += radius[j] * qx
            torque[j, 1] += radius[j] * qy


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def elastic_pair(kind, coulomb, dim, p, bodies, contacts, shift, c):
    """Pair vector and elastic force on i, for a touching pair of grains whose memory is committed."""
    i, j = contacts.i[c], contacts.j[c]
    rx, ry, rz = pair_vector(dim, bodies.position, shift, c, i, j)
    nx, ny, nz, overlap, _ = normal_and_overlap(i, j, False, 0, bodies.radius, bodies.normal, rx, ry, rz)
    q = row(kind, p, bodies.material[i], bodies.material[j])
    r_eff, _ = effective_values(kind, 0, bodies.radius, bodies.inverse_mass, i, j, False)
    fn = normal_force(kind, q, r_eff, overlap)
    s = contacts.slip[c]
    limit = cap(kind, q, r_eff, overlap, fn)
    tx, ty, tz = tangential_force(coulomb, tangential_stiffness(kind, q, r_eff, overlap), limit, s[0], s[1], s[2])
    return (rx, ry, rz), (fn * nx + tx, fn * ny + ty, fn * nz + tz)


@njit(cache=True)
def _add_virial(kind, coulomb, dim, p, bodies, contacts, shift, out):
    """Add Σ f ⊗ r over all touching pairs of grains whose memory is committed."""
    n_grains = len(bodies.radius) - len(bodies.normal)
    for c in range(contacts.count[0]):
        if contacts.mode[c] != OPEN and contacts.j[c] < n_grains:
            r, f = elastic_pair(kind, coulomb, dim, p, bodies, contacts, shift, c)
            for a in range(3):
                for b in range(3):
                    out[a, b] += f[a] * r[b]


@njit(cache=True, fastmath=True, error_model="numpy")
def evaluate(
    kind, coulomb, dim, viscous, bodies, contacts, shift, p, memory, force, torque, events, event_count, rescaled
):  # fmt: skip
    """Evaluate all contacts with zero velocities. A single kernel serves all built-in laws, unlike in the time loop."""
    still = (bodies.velocity, bodies.spin, 0.0)
    sweep_contacts(
        kind, coulomb, dim, bodies, contacts, shift, p, viscous, memory, still, force, torque, 0.0, events, event_count,
        rescaled,
    )  # fmt: skip


NO_EVENTS = np.zeros((0, len(EVENT_COLUMNS)))


@checked
def forces(state: State, law: Law, *, memory: int = FREE):
    """Contact loads on every body, and the trial memory; the state is unchanged.

    F_ij = F_n n + F_t on body i, T_i = −R_i n × F_t. As in the papers, the lever arms are R rather than R −
    δ/2, so that the total angular momentum changes by O(δ).

    Parameters
    ----------
    state : State; positions may differ from those at which its memory was committed
    law : Law
    memory : FREE (default), HELD (no contact changes between stick and slide) or FROZEN (contacts that have not moved
        since their memory was committed keep it bit for bit)

    Returns
    -------
    Loads
        (N + W, 3) forces and torques of the contacts
    Contacts
        trial memory: `accept(state, trial)` commits it

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Eqs 1–5, supplement Eqs 5–7 and 25.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> loads, trial = ss.forces(state, law)
    >>> loads.force.shape
    (50, 3)
    >>> state = ss.accept(state, trial)  # keeps the new slips
    """
    check_materials(state, law)
    check_memory(memory)
    state = with_neighbor_list(state, law)
    contacts = state.contacts
    trial = contacts._replace(
        slip=contacts.slip.copy(),
        mode=contacts.mode.copy(),
        pair=contacts.pair.copy(),
        roll=contacts.roll.copy(),
        reached=contacts.reached.copy(),
        rolling=contacts.rolling.copy(),
    )
    loads = ContactLoads(np.zeros((state.n_bodies, 3)), np.zeros((state.n_bodies, 3)), np.zeros((3, 3)))
    here, shift = bodies(state), shifts(trial, state.cell.vectors)
    check_kind(law.kind)
    evaluate(
        law.kind, law.coulomb, state.cell.dim, damping_model(law), here, trial, shift, law.table, memory, loads.force,
        loads.torque, NO_EVENTS, np.zeros(1, np.int64), rescaling_flag(law.kind),
    )  # fmt: skip
    if state.control.cell_free.any():
        _add_virial(law.kind, law.coulomb, state.cell.dim, law.table, here, trial, shift, loads.virial)
    return loads, trial


def check_memory(memory: int) -> None:
    """Raise ValueError if a number does not denote a treatment of contact memory."""
    if memory not in (FROZEN, HELD, FREE):
        raise ValueError(f"memory = {memory} was given: FREE, HELD and FROZEN are allowed")


@checked
def accept(state: State, trial) -> State:
    """State with the trial memory committed.

    Raises
    ------
    ValueError
        if the trial memory belongs to a state with another number of bodies.
    """
    if len(trial.origin) != state.n_bodies:
        raise ValueError(
            f"the trial memory is that of {len(trial.origin)} bodies, but the state has {state.n_bodies}: "
            "give what `forces` returned for this state"
        )
    return state._replace(contacts=trial)


def check_materials(state: State, law: Law) -> None:
    """Raise ValueError if the material of a body has no row in the law's table."""
    used = np.concatenate([state.grains.material, state.walls.material])
    worst = int(used.min()) if used.min() < 0 else int(used.max())
    if not 0 <= worst < len(law.table):
        raise ValueError(
            f"material {worst} is used, but the law has {pluralize(len(law.table), 'material')}: "
            "add it with laws.for_pair(law, a, b)"
        )


@checked
def unbalanced_forces(state: State, loads: ContactLoads):
    """Force and torque/R on every body, (N + W, 6), external loads included; zero where not free.

    Parameters
    ----------
    loads : first value that `forces` returns
    """
    grains, control = state.grains, state.control
    n = len(grains.radius)
    total = np.zeros((state.n_bodies, 6))
    total[:, :3] = loads.force + control.force + spring_forces(control, body_positions(state), state.time)
    total[:n, :3] += grains.mass[:, None] * control.gravity
    total[n:, :3] += state.walls.mass[:, None] * control.gravity
    total[:n, 3:] = (loads.torque[:n] + control.torque[:n]) / grains.radius[:, None]
    for members in groups(control):
        total[members, :3] = total[members, :3].sum(axis=0)
    total[~control.free] = 0.0
    if state.cell.dim == 2:
        total[:, 2:5] = 0.0
    return total
