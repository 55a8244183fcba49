"""Copies of bodies between arrays of the state and rows in memory order; displacement limits of the blocks."""

import numpy as np
from numba import njit

from .transpose import KICK, KICK_T, RADIUS, SPIN, SPIN_AHEAD, VELOCITY, VELOCITY_AHEAD


@njit(cache=True, fastmath=False, _nrt=False)
def speeds(moving):
    """Largest and root-mean-square speed of the bodies [length/time]."""
    most, total = 0.0, 0.0
    for g in range(len(moving.order)):
        square = 0.0
        for k in range(3):
            square += moving.body[g, VELOCITY + k] ** 2
        most, total = max(most, square), total + square
    return np.sqrt(most), np.sqrt(total / max(len(moving.order), 1))


@njit(cache=True, fastmath=False, _nrt=False)
def displacement_limits(moving, base, span, least, most, out):
    """Displacement limit of each body until blocks are chosen again: `base` + `span` times its speed, within bounds."""
    for g in range(len(moving.order)):
        square = 0.0
        for k in range(3):
            square += moving.body[g, VELOCITY + k] ** 2
        out[g] = min(max(base + span * np.sqrt(square), least), most)


@njit(cache=True, fastmath=False, _nrt=False)
def limit_displacements(moving, origin, most, room):
    """Reduce `room` so that no body moves further than `most` from its `origin`, which is in the state's order.

    Returns False if this takes more than half of any body's limit.
    """
    for g in range(len(moving.order)):
        square = 0.0
        for m in range(3):
            d = moving.body[g, m] - origin[moving.order[g], m]
            square += d * d
        left = most - np.sqrt(square)
        if not left >= 0.5 * room[g]:
            return False
        room[g] = min(room[g], left)
    return True


@njit(cache=True, fastmath=False, _nrt=False)
def gather_bodies(order, here, kick, kick_t, body, ahead):
    """Copy all bodies from the state's order to rows of `body`, and of `ahead` if it has any."""
    for g in range(len(order)):
        a = np.uint64(order[g])
        for k in range(3):
            body[g, k], body[g, VELOCITY + k] = here.position[a, k], here.velocity[a, k]
            body[g, SPIN + k] = here.spin[a, k]
        body[g, RADIUS], body[g, KICK], body[g, KICK_T] = here.radius[a], kick[a], kick_t[a]
        if len(ahead):
            ahead[g, VELOCITY_AHEAD + 3] = ahead[g, SPIN_AHEAD + 3] = 0.0
            for k in range(3):
                ahead[g, VELOCITY_AHEAD + k], ahead[g, SPIN_AHEAD + k] = here.velocity[a, k], here.spin[a, k]


@njit(cache=True, fastmath=False, _nrt=False)
def scatter_bodies(moving, out):
    """Copy positions, angles, velocities and spins back to arrays in the state's order."""
    for g in range(len(moving.order)):
        a = moving.order[g]
        for k in range(3):
            out.position[a, k], out.velocity[a, k] = moving.body[g, k], moving.body[g, VELOCITY + k]
            out.spin[a, k], out.angle[a, k] = moving.body[g, SPIN + k], moving.angle[g, k]
