"""Mechanics of one contact; functions take and return scalars.

Both the sweeps over a few contacts and the vectorised blocks of many contacts call these functions, so that the physics
is written only once.
"""

import numpy as np
from numba import njit

from ..laws.builtin import DAMPING_N, DAMPING_T, MASS, NO_TENSION, SMOOTH, VISCOELASTIC
from ..laws.oracle import (
    acts_across_gaps,
    cap,
    contact_damping,
    least_force,
    masked,
    mobilisation,
    normal_force,
    rate_cap,
    reach,
    row,
    tangential_stiffness,
    uses_radius,
)
from ..options import INNER
from ..state import SLIDE, STICK
from .geometry import mid_normal, onto_plane, overlap_increment, slip_increment

# treatment of the memory in an evaluation. FROZEN: transport it, but keep it bit for bit where nothing has moved since
# it was committed; HELD: transport it with every contact in its mode; FREE: transport it
FROZEN, HELD, FREE = 0, 1, 2
MIN_WEIGHT = 0.6  # of an increment, see `turning_weight`; above 1/2, so that a slip can change its sign


@njit(cache=True)
def needs_radius(kind, viscous):
    """Return True if the law uses R_eff."""
    return uses_radius(kind) or viscous & 3 == VISCOELASTIC


@njit(cache=True, **INNER)
def needs_mass(viscous):
    """Return True if the law uses m_eff."""
    return viscous & 3 in (MASS, VISCOELASTIC)


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def effective_radius(radius, i, j, is_wall):
    """Effective radius R_eff of a pair."""
    return radius[i] if is_wall else radius[i] * radius[j] / (radius[i] + radius[j])


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def effective_mass(inverse_mass, i, j):
    """Effective mass m_eff of a pair; bodies that do not move are infinitely heavy."""
    inverse = inverse_mass[i] + inverse_mass[j]
    return 1.0 / inverse if inverse > 0.0 else 0.0


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def effective_values(kind, viscous, radius, inverse_mass, i, j, is_wall):
    """R_eff and m_eff of a pair, 1 where the law does not use them."""
    r_eff = m_eff = 1.0
    if needs_radius(kind, viscous):
        r_eff = effective_radius(radius, i, j, is_wall)
    if needs_mass(viscous):
        m_eff = effective_mass(inverse_mass, i, j)
    return r_eff, m_eff


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def out_of_range(kind, p, material, radius, inverse_mass, i, j, is_wall, overlap):
    """Return True if a pair is beyond the range of the law."""
    if not acts_across_gaps(kind):
        return overlap <= 0.0
    r_eff, _ = effective_values(kind, 0, radius, inverse_mass, i, j, is_wall)
    return overlap <= -reach(kind, row(kind, p, np.uint64(material[i]), np.uint64(material[j])), r_eff)


@njit(cache=True, fastmath=True, error_model="numpy")
def with_dashpot(viscous, elastic, damping, vn, least=0.0):
    """Normal force with its dashpot, clipped at `least` if the law has no tension."""
    fn = elastic - damping * vn
    if viscous & NO_TENSION:
        return fn if fn > least else least
    return fn


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def contact_radius_ratio(overlap, gained):
    """Ratio of contact radii √(δ/δ_old) where the overlap has decreased, else 1."""
    falls = gained < 0.0 and overlap > 0.0
    root = np.sqrt((overlap if falls else 1.0) / (overlap - gained if falls else 1.0))
    return root if falls else 1.0


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def rescale_slip(overlap, nx, ny, nz, inverse, dx, dy, dz, sx, sy, sz):
    """Factor f by which a law rescales the slip s after a displacement dr that ends at n, and the rescaled slip f s."""
    fade = contact_radius_ratio(overlap, overlap_increment(nx, ny, nz, inverse, dx, dy, dz))
    return fade, fade * sx, fade * sy, fade * sz


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def scale_to_length(ax, ay, az, bx, by, bz):
    """Vector a scaled to the length of b, as LAMMPS `granular` does when it rotates its memory."""
    square = ax * ax + ay * ay + az * az
    factor = np.sqrt((bx * bx + by * by + bz * bz) / (square if square > 0.0 else 1.0))
    return factor * ax, factor * ay, factor * az


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def turning_weight(stiffness, limit, ax, ay, az, dx, dy, dz, fade=None):
    """Factor κ of the increment d such that a + κ d has the direction to which the slip `a` of a sliding contact turns.

    A slip of length R turns towards d by dψ = −sin ψ |d|/R, and its final direction is that of a + κ d with
    κ = 1 + a·d/(2R²) + (a² − R²)/(4R²) to second order. The last term uses the mean of R before and after. Returns κ
    as a numerator and a denominator.

    A slip that was shortened by a factor f, `fade`, turns as if it had not been shortened. With d
    multiplied by (1 + f)/2, κ is 2f/(1 + f) times its value for a/f.

    Source: Krieg and Krieg, doi:10.1115/1.3454568, for the exact rotation.
    """
    scale, square = stiffness * stiffness, limit * limit
    if fade is not None:
        bx, by, bz, share = ax / fade, ay / fade, az / fade, 2.0 * fade / (1.0 + fade)
        change = scale * (bx * (bx + 2.0 * dx) + by * (by + 2.0 * dy) + bz * (bz + 2.0 * dz))
        return share * max(0.75 * square + 0.25 * change, MIN_WEIGHT * square), square
    change = scale * (ax * (ax + 2.0 * dx) + ay * (ay + 2.0 * dy) + az * (az + 2.0 * dz))
    # the bound lets a contact sheared in the opposite direction reverse, although κ is derived for small steps
    return max(0.75 * square + 0.25 * change, MIN_WEIGHT * square), square


@njit(cache=True, fastmath=True, error_model="numpy")
def return_mapping(dim, stiffness, limit, ax, ay, az, dx, dy, dz, part, whole, mode, memory, fade=None):
    """Slip a + d part/whole truncated at the Coulomb limit, and the resulting mode. With HELD memory the mode is fixed.

    `a` is the previous slip, rotated with the contact and shortened by `fade`, d the increment, and part/whole the
    fraction of it that counts. In three dimensions the slip of a contact that keeps sliding turns; see
    `turning_weight`. The slip of a contact that starts to slide is truncated along a + d part/whole. One division
    serves all cases, because a vector division takes as long as ten multiplications.
    """
    bx, by, bz = whole * ax + part * dx, whole * ay + part * dy, whole * az + part * dz
    scale, bound = stiffness * stiffness, whole * limit
    pull = scale * (bx * bx + by * by + bz * bz)
    # without slip there is no sliding direction to hold: such contacts slid under a law without friction
    held = mode == SLIDE and (ax != 0.0 or ay != 0.0 or az != 0.0)
    slides = limit == 0.0 or (held if memory == HELD else pull > bound * bound)
    if dim == 3:
        some, unit = turning_weight(stiffness, limit, ax, ay, az, dx, dy, dz, fade)
        turns = slides and mode == SLIDE and limit > 0.0
        some, unit = some if turns else part, unit if turns else whole
        bx, by, bz = unit * ax + some * dx, unit * ay + some * dy, unit * az + some * dz
        pull = scale * (bx * bx + by * by + bz * bz)
    below = np.sqrt(pull) if slides else whole
    factor = (limit if slides else 1.0) / below if below > 0.0 else 0.0
    return factor * bx, factor * by, factor * bz, SLIDE if slides else STICK


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def tangential_force(coulomb, stiffness, limit, sx, sy, sz):
    """Tangential force −k_t (mobilisation) s on i due to the slip."""
    factor = -stiffness
    if coulomb == SMOOTH:
        if limit > 0.0:
            factor *= mobilisation(coulomb, stiffness * np.sqrt(sx * sx + sy * sy + sz * sz) / limit)
        else:
            factor = 0.0
    return factor * sx, factor * sy, factor * sz


@njit(cache=True, fastmath=True, error_model="numpy", **INNER)
def with_tangential_dashpot(tx, ty, tz, damping, limit, vx, vy, vz):
    """Tangential force with its dashpot, truncated at the Coulomb limit."""
    tx, ty, tz = tx - damping * vx, ty - damping * vy, tz - damping * vz
    square = tx * tx + ty * ty + tz * tz
    factor = limit / np.sqrt(square) if square > limit * limit else 1.0
    return tx * factor, ty * factor, tz * factor


@njit(cache=True, fastmath=True, error_model="numpy")
def truncate_as_lammps(stiffness, damping, limit, sx, sy, sz, vx, vy, vz, hold):
    """Tangential force and slip if spring and dashpot together are truncated at the Coulomb limit, as in LAMMPS.

    s ← f (s + c v_t/k_t) − c v_t/k_t, F_t ← f F_t, f = limit/|F_t|. Returns the force, the slip, and whether the
    contact slides.
    """
    tx, ty, tz = -stiffness * sx - damping * vx, -stiffness * sy - damping * vy, -stiffness * sz - damping * vz
    square = tx * tx + ty * ty + tz * tz
    slides = square > limit * limit
    share = limit / np.sqrt(square) if slides else 1.0
    # a contact that slides without ever having been sheared transmits no tangential force
    grip = share if not slides or sx * sx + sy * sy + sz * sz > 0.0 else 0.0
    slides = slides and not hold
    less = share - 1.0 if slides else 0.0
    stretch = damping / stiffness if stiffness > 0.0 else 0.0
    sx, sy, sz = sx + less * (sx + stretch * vx), sy + less * (sy + stretch * vy), sz + less * (sz + stretch * vz)
    return grip * tx, grip * ty, grip * tz, sx, sy, sz, slides


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True, **INNER)
def transport_slip(rate, rescaled, nx, ny, nz, inverse, overlap, dx, dy, dz, wx, wy, wz, sx, sy, sz):
    """Move the slip s of a contact along with a displacement dr and a rotation d(roll) that end at n.

    Returns the slip, rotated with the contact and shortened by the law, its increment, the mid-step normal, and the
    factor by which it was shortened. `rate`: as LAMMPS, see `run`; `rescaled`: see `oracle.rescaling_flag`.
    """
    mx, my, mz, fade = nx, ny, nz, 1.0
    if not rate:
        mx, my, mz = mid_normal(nx, ny, nz, inverse, dx, dy, dz)
    ox, oy, oz = onto_plane(nx, ny, nz, mx, my, mz, sx, sy, sz)
    if rescaled is not None:
        if rate:
            ox, oy, oz = scale_to_length(ox, oy, oz, sx, sy, sz)
        fade, ox, oy, oz = rescale_slip(overlap, nx, ny, nz, inverse, dx, dy, dz, ox, oy, oz)
    dx, dy, dz = slip_increment(nx, ny, nz, mx, my, mz, dx, dy, dz, wx, wy, wz)
    if rescaled is not None and not rate:
        half = 0.5 * (1.0 + fade)
        dx, dy, dz = half * dx, half * dy, half * dz
    return ox, oy, oz, dx, dy, dz, mx, my, mz, fade


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True, **INNER)
def truncated_slip(dim, rescaled, stiffness, limit, ax, ay, az, dx, dy, dz, part, whole, mode, memory, fade):
    """`return_mapping` for laws that may rescale; kernels of all other laws are the same as without `fade`."""
    if rescaled is not None:
        return return_mapping(dim, stiffness, limit, ax, ay, az, dx, dy, dz, part, whole, mode, memory, fade)
    return return_mapping(dim, stiffness, limit, ax, ay, az, dx, dy, dz, part, whole, mode, memory)


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True, **INNER)
def normal_force_and_limit(kind, viscous, rate, touches, q, r_eff, m_eff, overlap, vn):
    """Elastic and total normal force, factor on the damping coefficients, and Coulomb limit of a contact.

    `vn` is the normal velocity. Forces of a pair that does not touch are zero; its overlap is minus the law's range.
    """
    elastic = masked(kind, touches, normal_force(kind, q, r_eff, overlap))
    fn, factor = elastic, 0.0
    if viscous:
        factor = contact_damping(kind, viscous, r_eff, m_eff, overlap)
        factor = factor if touches else 0.0
        fn = with_dashpot(viscous, elastic, factor * q[DAMPING_N], vn, least_force(kind, elastic))
    largest = rate_cap(kind, q, r_eff, overlap, fn) if rate and viscous else cap(kind, q, r_eff, overlap, fn)
    limit = masked(kind, touches, largest)
    return elastic, fn, factor, limit


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True, **INNER)
def contact_forces(
    kind, coulomb, dim, viscous, rate, rescaled, memory, hold, touches, q, r_eff, m_eff, nx, ny, nz, overlap, ox, oy,
    oz, dx, dy, dz, fade, part, whole, slid, vx, vy, vz,
):  # fmt: skip
    """Forces of one contact from its transported slip o and the increment d: law, dashpots, Coulomb limit.

    `slid`: the contact was sliding before; `v`: velocity of the surface of i relative to that of j; for the other
    arguments see `transport_slip`, `return_mapping` and `normal_force_and_limit`. With `hold` the slip is o.

    Returns the normal force, the tangential force, the slip, the Coulomb limit, and True if the contact slides.
    """
    vn = vx * nx + vy * ny + vz * nz
    vx, vy, vz = vx - vn * nx, vy - vn * ny, vz - vn * nz
    _, fn, factor, limit = normal_force_and_limit(kind, viscous, rate, touches, q, r_eff, m_eff, overlap, vn)
    stiffness, damping = tangential_stiffness(kind, q, r_eff, overlap), factor * q[DAMPING_T]
    if viscous and rate:
        sx, sy, sz = ox + dx, oy + dy, oz + dz
        tx, ty, tz, sx, sy, sz, slides = truncate_as_lammps(stiffness, damping, limit, sx, sy, sz, vx, vy, vz, hold)
    else:
        sx, sy, sz, after = truncated_slip(
            dim, rescaled, stiffness, limit, ox, oy, oz, dx, dy, dz, part, whole, SLIDE if slid else STICK, memory, fade
        )
        slides = after == SLIDE
        sx, sy, sz = (ox, oy, oz) if hold else (sx, sy, sz)
        tx, ty, tz = tangential_force(coulomb, stiffness, limit, sx, sy, sz)
        if viscous:
            tx, ty, tz = with_tangential_dashpot(tx, ty, tz, damping, limit, vx, vy, vz)
    if acts_across_gaps(kind):  # a pair without friction across a gap does not touch: it does not slide either
        slides = slides and (limit > 0.0 or overlap > 0.0)
    return fn, tx, ty, tz, sx, sy, sz, limit, slides
