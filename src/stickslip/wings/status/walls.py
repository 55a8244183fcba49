"""Rotating walls: one additional coordinate for each wall, arm × angle about its point.

A disk at x_i and a wall with point p, normal n and tangent t touch on the surface of the wall, at p + a t with a = (x_i
− p)·t. This point is at R − δ from the centre of the disk, while the disk itself has the lever arm R. If the wall
rotates at the rate Ω, its surface at this point moves with velocity Ω a n. The torque of (F_n, F_t) on the wall is
therefore −a F_n, without a contribution from F_t. n and t rotate with the wall, dn = −Ω t and dt = Ω n, and da = (v_i −
v_w)·t + (R − δ) Ω; this is the contribution to the geometric stiffness −(dc/dt) F. `displaced` moves such walls, but
does not rotate them.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. III E, which counts three rigid motions.
With lever arms R, the third one causes slip comparable to the overlap: vᵀkv/vᵀv is not zero, but of the order of the
squared overlap over the squared size of the packing.
"""

import numpy as np
from scipy import sparse

from ... import State
from ...core.fields import LARGEST
from ...measure import branch_vectors
from ...results import Freedom


def append_wall_rotations(state: State, matrix, arm: float):
    """Append the rotations of all walls, in the order of the walls, to the coordinates of a `LinearSystem`.

    Parameters
    ----------
    matrix : LinearSystem of disks between walls that only translate
    arm : factor on the angle of a wall [length]
    """
    _check_walls(state, arm)
    rows, c, free = matrix.rows, matrix.c, matrix.free
    n, count = len(state.grains.radius), len(state.walls.mass)
    mine = np.flatnonzero(state.contacts.j[rows] >= n)
    body, wall = state.contacts.i[rows[mine]], state.contacts.j[rows[mine]]
    normal = state.walls.normal[wall - n]
    along = np.stack([normal[:, 1], -normal[:, 0], np.zeros(len(mine))], axis=1)
    apart = state.grains.position[body] - state.walls.point[wall - n]
    lever, height = np.einsum("ck,ck->c", apart, along), np.einsum("ck,ck->c", apart, normal)
    c_more = sparse.csr_array((-lever / arm, (wall - n, 2 * mine)), shape=(count, c.shape[1]))

    f_n, f_t = matrix.force[mine].T
    own, size, held = len(free) + wall - n, len(free) + count, np.append(free.place, -1)
    entries = [(own, own, f_n * height / arm**2)]
    for k in range(2):
        bends = (f_n * along[:, k] - f_t * normal[:, k]) / arm
        pulls = f_n * along[:, k] / arm
        for end, sign in ((body, 1.0), (wall, -1.0)):
            place = held[6 * end + k]
            entries += [(place, own, sign * bends), (own, place, sign * pulls)]
    row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    kept = (row >= 0) & (column >= 0)
    more = sparse.csr_array((value[kept], (row[kept], column[kept])), shape=(size, size))
    still = sparse.csr_array((count, count))
    padded, machine = (sparse.block_diag([a, still], format="csr") for a in (matrix.geometric, matrix.machine))
    return matrix._replace(
        c=sparse.csr_array(sparse.vstack([c, c_more])), geometric=sparse.csr_array(padded + more),
        machine=sparse.csr_array(machine), free=_append_angles(state, free),
    )  # fmt: skip


def _append_angles(state: State, free: Freedom) -> Freedom:
    """Freedom with the rotation of each wall about z appended; the arm serves as its radius of gyration."""
    n, count = len(state.grains.radius), len(state.walls.mass)
    component = 6 * (n + np.arange(count)) + 5
    place = free.place.copy()
    place[component] = len(free) + np.arange(count)
    mass = np.append(free.mass, state.walls.mass)
    return Freedom(np.append(free.component, component), mass, free.dim, place, free.length)


def _check_walls(state: State, arm: float) -> None:
    n = len(state.grains.radius)
    if not 1 / LARGEST <= arm <= LARGEST:
        raise ValueError(f"wall_arm = {arm} was given: it must be positive, such as half the length of a wall")
    if state.cell.dim != 2:
        raise ValueError(
            "wall_arm was given for a packing in three dimensions, where walls only translate: leave it out"
        )
    if not len(state.walls.mass):
        raise ValueError("wall_arm was given for a packing without walls: leave it out")
    if state.cell.periodic.any():
        raise ValueError("wall_arm was given in a periodic cell, where a wall cannot rotate: leave it out")
    if (state.control.group[n:] >= 0).any():
        raise ValueError(
            "wall_arm was given for a wall in a rigid group, which cannot rotate: remove the wall from the group"
        )


def rigid_rotation(state: State, free: Freedom, arm: float) -> np.ndarray:
    """(n,) velocities of a rigid rotation with unit angular velocity about the mean position of all moving bodies.

    Parameters
    ----------
    free : coordinates of `linear_system(..., wall_arm=arm)`
    """
    place = np.concatenate([state.grains.position, state.walls.point])
    radius = np.append(state.grains.radius, np.full(len(state.walls.mass), arm))
    x, y = place[free.body, 0], place[free.body, 1]
    out = radius[free.body]
    for axis, value in ((0, -y), (1, x)):
        mine = free.axis == axis
        out[mine] = (value - value[mine].mean())[mine] if mine.any() else 0.0
    return out


def resists_turning(state: State, rows, relative: np.ndarray) -> bool:
    """Return True if a rotation with unit angular velocity moves contacts by more than their overlaps.

    Parameters
    ----------
    relative : (M, 2) V = cᵀ v of the contacts `rows` [length]
    """
    radius = np.append(state.grains.radius, np.zeros(len(state.walls.mass)))
    i, j = state.contacts.i[rows], state.contacts.j[rows]
    overlap = radius[i] + radius[j] - np.linalg.norm(branch_vectors(state)[rows], axis=1)
    slack = 1e-9 * float(state.grains.radius.max())
    return bool((np.abs(relative[:, 0]) > slack).any() or (np.abs(np.abs(relative[:, 1]) - overlap) > slack).any())
