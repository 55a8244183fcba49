"""Geometry of one contact for all laws, in two and three dimensions: pair vector, normal, overlap, slip.

Functions take and return scalars. In two dimensions the z components are literal zeros that the compiler removes.
"""

import numpy as np
from numba import njit

from ..library import core
from ..options import INNER


def shifts(contacts, cell) -> np.ndarray:
    """Periodic shift cellᵀ·image of every pair, (C, 3) [length]."""
    out = np.empty((contacts.count[0], 3))
    core.shifts(contacts.image, cell, len(out), out)
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def pair_vector(dim, x, shift, c, i, j):
    """Pair vector r_i − r_j + cellᵀ·image [length]; x are the positions of all bodies."""
    rz = x[i, 2] - x[j, 2] + shift[c, 2] if dim == 3 else 0.0
    return x[i, 0] - x[j, 0] + shift[c, 0], x[i, 1] - x[j, 1] + shift[c, 1], rz


@njit(cache=True, fastmath=True, error_model="numpy")
def normal_and_overlap(i, j, is_wall, wall, radius, wall_normal, rx, ry, rz):
    """Normal from j to i, overlap δ, and 1/|r_ij|. The last is zero for walls, whose normal does not rotate."""
    if not is_wall:
        distance = np.sqrt(rx * rx + ry * ry + rz * rz)
        inverse = 1.0 / distance
        return rx * inverse, ry * inverse, rz * inverse, radius[i] + radius[j] - distance, inverse
    nx, ny, nz = wall_normal[wall, 0], wall_normal[wall, 1], wall_normal[wall, 2]
    return nx, ny, nz, radius[i] - (rx * nx + ry * ny + rz * nz), 0.0


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def surface_rotation(dim, angle, radius, i, j):
    """Rolled length R_i angle_i + R_j angle_j [length]; the radius of a wall is zero."""
    z = radius[i] * angle[i, 2] + radius[j] * angle[j, 2]
    if dim == 2:
        return 0.0, 0.0, z
    return radius[i] * angle[i, 0] + radius[j] * angle[j, 0], radius[i] * angle[i, 1] + radius[j] * angle[j, 1], z


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def at_contact(nx, ny, nz, dx, dy, dz, ax, ay, az):
    """Displacement of the surface of i relative to that of j, dr + n × d(roll). The same formula holds for velocities.

    Source: doi:10.48550/arXiv.1908.11724, Eq 2 and supplement Eq 7.
    """
    return dx + ny * az - nz * ay, dy + nz * ax - nx * az, dz + nx * ay - ny * ax


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def mid_normal(nx, ny, nz, inverse, dx, dy, dz):
    """Normal halfway through a displacement dr that ends at n, scaled so that n·m = 1: m = n − P dr/(2|r|).

    If `inverse` is zero, as for walls, it is n.
    """
    half = 0.5 * inverse
    along = nx * dx + ny * dy + nz * dz
    return nx - half * (dx - along * nx), ny - half * (dy - along * ny), nz - half * (dz - along * nz)


@njit(cache=True, fastmath=True, error_model="numpy")
def onto_plane(nx, ny, nz, mx, my, mz, wx, wy, wz):
    """Project w along the mid-step normal m onto the plane of contact: w − (n·w) m.

    The projection rotates a slip from the plane of contact before the step to that after it, to third order in the
    angle, and removes the component along which the grains approach or separate. With m = n, the projection is
    orthogonal.
    """
    along = wx * nx + wy * ny + wz * nz
    return wx - along * mx, wy - along * my, wz - along * mz


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def slip_increment(nx, ny, nz, mx, my, mz, dx, dy, dz, ax, ay, az):
    """Slip increment of a displacement dr and a rotation d(roll), in the plane of contact at the end."""
    wx, wy, wz = at_contact(mx, my, mz, dx, dy, dz, ax, ay, az)
    return onto_plane(nx, ny, nz, mx, my, mz, wx, wy, wz)


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def overlap_increment(nx, ny, nz, inverse, dx, dy, dz):
    """Overlap increment of a displacement dr that ends at n: |r − dr| − |r|, exactly zero if dr = 0.

    If `inverse` is zero, as for walls, it is −n·dr.
    """
    twice = inverse * (dx * dx + dy * dy + dz * dz) - 2.0 * (nx * dx + ny * dy + nz * dz)
    return twice / (1.0 + np.sqrt(max(1.0 + inverse * twice, 0.0)))


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def touching_fraction(nx, ny, nz, inverse, depth, dx, dy, dz):
    """Fraction of a step during which a closing contact touched, as a numerator and a denominator.

    `depth` is the overlap at the end. During the step, the overlap grew by |P dr|²/(2|r|) − n·dr, to third order in dr.
    """
    along = nx * dx + ny * dy + nz * dz
    gained = 0.5 * inverse * (dx * dx + dy * dy + dz * dz - along * along) - along
    part = gained > depth
    return depth if part else 1.0, gained if part else 1.0
