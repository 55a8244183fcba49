"""Contacts evaluated one after another, row by row of the list.

`sweep_contacts` works in place on the list that it receives: a copy in `forces`, the list of a run of few grains in the
time loop. Many grains are evaluated in vectorised blocks instead, see `simd.blocks`; both compose the functions of
`mechanics`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from ..laws.oracle import reach, row
from ..options import INNER
from ..state import OPEN, SLIDE, STICK
from .geometry import at_contact, normal_and_overlap, pair_vector, surface_rotation, touching_fraction
from .mechanics import FROZEN, contact_forces, effective_values, out_of_range, transport_slip
from .rolling import add_rolling, forget_rolling

CLOSED, OPENED, REACHED_LIMIT = 0, 1, 2
EVENT_COLUMNS = ("kind", "time", "i", "j", "image_x", "image_y", "image_z", "x", "y", "z")
NO_EVENTS = np.zeros((0, len(EVENT_COLUMNS)))


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def _is_unmoved(dim, pair, roll, c, rx, ry, rz, ax, ay, az):
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


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def relative_motion(dim, velocity, i, j):
    """Velocity of i relative to j, without the flow of a deforming cell."""
    vz = velocity[i, 2] - velocity[j, 2] if dim == 3 else 0.0
    return velocity[i, 0] - velocity[j, 0], velocity[i, 1] - velocity[j, 1], vz


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def add_gradient(rate, rx, ry, rz, vx, vy, vz):
    """Add the contribution L r of a velocity gradient to a relative velocity."""
    return (
        vx + rate[0, 0] * rx + rate[0, 1] * ry + rate[0, 2] * rz,
        vy + rate[1, 0] * rx + rate[1, 1] * ry + rate[1, 2] * rz,
        vz + rate[2, 0] * rx + rate[2, 1] * ry + rate[2, 2] * rz,
    )


class Step(NamedTuple):
    """Motion of bodies during a step of a run."""

    velocity: np.ndarray  # (B, 3) at the half step
    spin: np.ndarray  # (B, 3)
    gradient: np.ndarray  # (3, 3) velocity gradient L of the cell, used with a flow
    back: np.ndarray  # (3, 3) (1 + ½ dt L)⁻¹


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def _mean_velocity(dim, step, flow, i, j, rx, ry, rz):
    """Change of the pair vector during a step, divided by dt.

    In a deforming cell this is (1 + ½ dt L)⁻¹ (Δv + L r), with r at the end of the step.
    """
    vx, vy, vz = relative_motion(dim, step.velocity, i, j)
    if flow is not None:
        m = step.back
        x, y, z = add_gradient(step.gradient, rx, ry, rz, vx, vy, vz)
        vx, vy = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z, m[1, 0] * x + m[1, 1] * y + m[1, 2] * z
        vz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z
    return vx, vy, vz


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True, **INNER)
def sweep_contacts(
    kind, coulomb, dim, viscous, rate, rescaled, memory, step, dt, hold, flow, bodies, contacts, shift, p, force,
    torque, virial, time, events, event_count,
):  # fmt: skip
    """Add the loads of all contacts and update their memory in place. The function is inlined into its callers.

    Parameters
    ----------
    rate : see `run`; `rescaled`: see `oracle.rescaling_flag`
    memory : treatment of the memory, see `mechanics`
    step : the step that ends here, or None: contacts have moved from their committed `pair` and `roll`, which are then
        updated
    dt, hold : length of the step, and whether the memory is kept, both used with a step
    flow : motion of a deforming cell, or None
    bodies : with the velocities that dashpots use
    virial : (B, 9) to which f ⊗ r is added at body i, used with a flow
    """
    position, angle, velocity, spin, radius, material, inverse_mass, wall_normal, gradient = bodies
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
        ax = ay = az = dx = dy = dz = wx = wy = wz = vx = vy = vz = 0.0
        kept, part, whole = hold, 1.0, 1.0
        if step is None:
            ax, ay, az = surface_rotation(dim, angle, radius, i, j)
            kept = memory == FROZEN and before != OPEN and _is_unmoved(dim, pair, roll, c, rx, ry, rz, ax, ay, az)
            if before != OPEN:
                dx, dy, dz = rx - pair[c, 0], ry - pair[c, 1], rz - pair[c, 2] if dim == 3 else 0.0
                wx, wy = (ax - roll[c, 0], ay - roll[c, 1]) if dim == 3 else (0.0, 0.0)
                wz = az - roll[c, 2]
        else:
            vx, vy, vz = _mean_velocity(dim, step, flow, i, j, rx, ry, rz)
            wx, wy, wz = surface_rotation(dim, step.spin, radius, i, j)
            dx, dy, dz, wx, wy, wz = dt * vx, dt * vy, dt * vz, dt * wx, dt * wy, dt * wz
            if before == OPEN and not rate:
                depth = overlap + reach(kind, q, r_eff)
                part, whole = touching_fraction(nx, ny, nz, inverse, depth, dx, dy, dz)
        sx, sy, sz = slip[c, 0], slip[c, 1], slip[c, 2] if dim == 3 else 0.0
        ox, oy, oz, dx, dy, dz, mx, my, mz, fade = transport_slip(
            rate, rescaled, nx, ny, nz, inverse, overlap, dx, dy, dz, wx, wy, wz, sx, sy, sz
        )
        if kept:
            ox, oy, oz, dx, dy, dz = sx, sy, sz, 0.0, 0.0, 0.0
        if viscous:
            if not rate:
                vx, vy, vz = relative_motion(dim, velocity, i, j)
                vx, vy, vz = add_gradient(gradient, rx, ry, rz, vx, vy, vz)
            ux, uy, uz = surface_rotation(dim, spin, radius, i, j)
            vx, vy, vz = at_contact(nx, ny, nz, vx, vy, vz, ux, uy, uz)
        slid = before == SLIDE and not rate
        fn, tx, ty, tz, sx, sy, sz, limit, slides = contact_forces(
            kind, coulomb, dim, viscous, rate, rescaled, memory, kept, True, q, r_eff, m_eff, nx, ny, nz, overlap, ox,
            oy, oz, dx, dy, dz, fade, part, whole, slid, vx, vy, vz,
        )  # fmt: skip
        if not (kept and before != OPEN):
            slip[c, 0], slip[c, 1], slip[c, 2] = sx, sy, sz
            after = SLIDE if slides else STICK
            if after != before:
                mode[c] = after
                if before == OPEN:
                    record_event(events, event_count, CLOSED, time, i, j, contacts.image, c, position, i)
            # not only if the mode changes: a contact may have slid while its limit was zero
            if after == SLIDE and limit > 0.0 and not contacts.reached[c]:
                contacts.reached[c] = True
                record_event(events, event_count, REACHED_LIMIT, time, i, j, contacts.image, c, position, i)
            if step is None:
                pair[c, 0], pair[c, 1], roll[c, 2] = rx, ry, az
                if dim == 3:
                    pair[c, 2], roll[c, 0], roll[c, 1] = rz, ax, ay
        add_rolling(
            kind, dim, memory, kept, q, r_eff, overlap, fn, angle, step, dt, part, whole, (nx, ny, nz, mx, my, mz),
            contacts.rolling, c, i, j, before, torque,
        )  # fmt: skip
        fx, fy, fz = fn * nx + tx, fn * ny + ty, fn * nz + tz
        qx, qy, qz = nz * ty - ny * tz, nx * tz - nz * tx, ny * tx - nx * ty
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
        if flow is not None:
            for k, f in enumerate((fx, fy, fz)):
                virial[i, 3 * k] += f * rx
                virial[i, 3 * k + 1] += f * ry
                virial[i, 3 * k + 2] += f * rz
