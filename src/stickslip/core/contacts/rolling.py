"""Rolling resistance of user-defined laws: a moment with its own memory.

The memory ψ of a contact is the rotation of i relative to j since it closed, perpendicular to the normal. It is
truncated at the cap of the law and transported like the slip:

    ψ ← T (ψ + Δ(angle_i − angle_j)),   T = I − m nᵀ,   |ψ| ≤ cap/k_r,   M_i = −k_r ψ,   M_j = +k_r ψ,

with m the mid-step normal, see `geometry.mid_normal`.

A pair that rotates as one body has angle_i = angle_j and no moment. M and angle_i − angle_j are conjugate, so that the
transpose of the matrix that maps coordinates to r, ρ and θ = angle_i − angle_j maps F, T/R and M to loads. Twisting
about the normal is free.

Sources: Iwashita & Oda, doi:10.1061/(ASCE)0733-9399(1998)124:3(285); Ai et al., doi:10.1016/j.powtec.2010.09.030 (model
C without its dashpot); the same memory for slip and rolling: Luding, doi:10.1007/s10035-008-0099-x, Sec. 2.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from ..laws.builtin import STEP, Law
from ..laws.kinds import USER_LAWS, Kind
from ..laws.oracle import FAST, KindType, by_kind, normal_force, row
from ..options import INNER
from ..state import OPEN, SLIDE, STICK
from .geometry import mid_normal, normal_and_overlap, onto_plane, pair_vector, shifts
from .mechanics import effective_values, out_of_range, return_mapping, turning_weight
from .tangent import Turn, column, memory_tangent, outer, spring_tangent

# columns of `Contacts.rolling`: ψ; angle_i − angle_j at which it was committed; 1 if it was at the cap
WIDTH, ANCHOR, AT_CAP = 7, 3, 6


@by_kind
def rolling_stiffness(kind, q, r_eff, overlap):
    """Rolling stiffness k_r [force length/rad]; zero for built-in laws."""
    return 0.0


@by_kind
def rolling_cap(kind, q, r_eff, overlap, fn):
    """Largest rolling moment [force length]."""
    return 0.0


@by_kind
def rolling_cap_slopes(kind, q, r_eff, overlap, fn):
    """Derivatives of the rolling cap with respect to the normal force and the overlap."""
    return 0.0, 0.0


def resists_rolling(kind: int) -> bool:
    """Return True if a law has rolling resistance."""
    return isinstance(kind, Kind) and kind in USER_LAWS and "rolling_stiffness" in USER_LAWS[kind].functions


def _if_rolling(function):
    """Decorate a part of a kernel that is compiled for laws with rolling resistance and does nothing for all others."""

    def step(kind, *rest):
        return function(kind, *rest) if resists_rolling(kind) else None

    def nothing(kind, *rest):
        return None

    @overload(step, jit_options=FAST, strict=False)
    def _(kind, *rest):
        return function if isinstance(kind, KindType) and resists_rolling(Kind(kind.number)) else nothing

    return step


@njit(cache=True, **FAST)
def _relative_angle(dim, angle, i, j):
    """Relative rotation angle_i − angle_j."""
    z = angle[i, 2] - angle[j, 2]
    if dim == 2:
        return 0.0, 0.0, z
    return angle[i, 0] - angle[j, 0], angle[i, 1] - angle[j, 1], z


@_if_rolling
def add_rolling(
    kind, dim, memory, kept, q, r_eff, overlap, fn, angle, step, dt, part, whole, normals, rolling, c, i, j, before,
    torque,
):  # fmt: skip
    """Add the moments of a contact and update its ψ; arguments as in `rows.sweep_contacts`."""
    tx, ty, tz = _relative_angle(dim, angle, i, j)
    own = rolling[c]
    rests = kept and tx == own[3] and ty == own[4] and tz == own[5]
    stiffness, limit = rolling_stiffness(kind, q, r_eff, overlap), rolling_cap(kind, q, r_eff, overlap, fn)
    if rests:
        px, py, pz = own[0], own[1], own[2]
    else:
        px = py = pz = dx = dy = dz = 0.0
        if before != OPEN:
            px, py, pz = onto_plane(*normals, own[0], own[1], own[2])
            dx, dy, dz = onto_plane(*normals, tx - own[3], ty - own[4], tz - own[5])
        elif step is not None:
            wx, wy, wz = _relative_angle(dim, step.spin, i, j)
            dx, dy, dz = onto_plane(*normals, dt * wx, dt * wy, dt * wz)
        mode = SLIDE if own[AT_CAP] > 0.0 else STICK
        px, py, pz, mode = return_mapping(dim, stiffness, limit, px, py, pz, dx, dy, dz, part, whole, mode, memory)
        own[0], own[1], own[2], own[3], own[4], own[5] = px, py, pz, tx, ty, tz
        own[AT_CAP] = 1.0 if mode == SLIDE else 0.0
    for k, moment in enumerate((stiffness * px, stiffness * py, stiffness * pz)):
        torque[i, k] -= moment
        torque[j, k] += moment


@_if_rolling
def forget_rolling(kind, rolling, c):
    """Clear the rolling memory of a contact that has opened."""
    for k in range(WIDTH):
        rolling[c, k] = 0.0


@_if_rolling
def add_rolling_energy(
    kind, dim, p, old, new, shift0, shift, normals, fraction, before, m, after, c, i, j, known, closed, free, first,
    at, books,
):  # fmt: skip
    """Add one step of rolling to a ledger's row: stored and dissipated energy, and work on imposed rotations.

    `fraction` is the fraction of the step during which the contact touched.
    """
    stored_at, coulomb_at, nonpotential_at, external_at = at
    mine, own = before.rolling[m if known else 0], after.rolling[c]
    k1 = _rolling_stiffness_at(kind, dim, p, new, shift, c, i, j)
    size1 = own[0] ** 2 + own[1] ** 2 + own[2] ** 2 if closed else 0.0
    books[stored_at] += 0.5 * k1 * size1
    if first:
        return
    k0 = _rolling_stiffness_at(kind, dim, p, old, shift0, c, i, j)
    size0 = mine[0] ** 2 + mine[1] ** 2 + mine[2] ** 2 if known else 0.0
    books[nonpotential_at] += 0.25 * (size1 + size0) * (k1 - k0)
    x1, y1, z1 = _relative_angle(dim, new.angle, i, j)
    x0, y0, z0 = _relative_angle(dim, old.angle, i, j)
    if known or closed:
        had, has = 1.0 if known else 0.0, 1.0 if closed else 0.0
        x, y, z = fraction * (x1 - x0), fraction * (y1 - y0), fraction * (z1 - z0)
        px, py, pz = onto_plane(*normals, had * mine[0] + x, had * mine[1] + y, had * mine[2] + z)
        slid = np.sqrt((px - has * own[0]) ** 2 + (py - has * own[1]) ** 2 + (pz - has * own[2]) ** 2)
        books[coulomb_at] += 0.5 * (k1 * np.sqrt(size1) + k0 * np.sqrt(size0)) * slid
    for a, sign in ((i, -1.0), (j, 1.0)):
        for k in range(3):
            if not free[a, 3 + k]:
                moment = k1 * (own[k] if closed else 0.0) + k0 * (mine[k] if known else 0.0)
                books[external_at] -= 0.5 * sign * moment * (new.angle[a, k] - old.angle[a, k])


@njit(cache=True, **FAST, **INNER)
def _evaluate_pair(kind, dim, p, bodies, shift, c, i, j):
    """Normal, 1/|r|, overlap, parameters and R_eff of a pair, and True if it is out of range."""
    n_grains = len(bodies.radius) - len(bodies.normal)
    rx, ry, rz = pair_vector(dim, bodies.position, shift, c, i, j)
    is_wall, radius = j >= n_grains, bodies.radius
    nx, ny, nz, overlap, inverse = normal_and_overlap(i, j, is_wall, j - n_grains, radius, bodies.normal, rx, ry, rz)
    r_eff, _ = effective_values(kind, 0, radius, bodies.inverse_mass, i, j, is_wall)
    q = row(kind, p, bodies.material[i], bodies.material[j])
    away = out_of_range(kind, p, bodies.material, radius, bodies.inverse_mass, i, j, is_wall, overlap)
    return (nx, ny, nz), inverse, overlap, q, r_eff, away


@njit(cache=True, **FAST)
def _rolling_stiffness_at(kind, dim, p, bodies, shift, c, i, j):
    """Rolling stiffness k_r, zero if the pair is out of range."""
    _, _, overlap, q, r_eff, away = _evaluate_pair(kind, dim, p, bodies, shift, c, i, j)
    return 0.0 if away else rolling_stiffness(kind, q, r_eff, overlap)


class _MomentLinearisation(NamedTuple):
    """Quantities of the linearisation of M, one row per contact."""

    before: np.ndarray  # (C, 3) ψ when the memory was committed
    way: np.ndarray  # (C, 3) Δθ since then
    secant: np.ndarray  # (C,) φ/|ψ|
    along: np.ndarray  # (C,) ∂φ/∂|ψ|
    by_overlap: np.ndarray  # (C,) ∂φ/∂δ at fixed ψ
    by_force: np.ndarray  # (C,) ∂φ/∂F_n, as a dashpot changes F_n
    reach: np.ndarray  # (C,) |ψ| at the cap
    reach_by_overlap: np.ndarray  # (C,)
    reach_by_force: np.ndarray  # (C,)
    weighted: np.ndarray  # (C,) as in `jacobian.Linearisation`


@njit(cache=True, error_model="numpy")
def _fill_moments(kind, dim, bodies, contacts, shift, p, memory, out):
    for c in range(contacts.count[0]):
        i, j = contacts.i[c], contacts.j[c]
        (nx, ny, nz), inverse, overlap, q, r_eff, away = _evaluate_pair(kind, dim, p, bodies, shift, c, i, j)
        if away:
            continue
        px = py = pz = dx = dy = dz = 0.0
        if contacts.mode[c] != OPEN:
            own, old = contacts.rolling[c], contacts.pair[c]
            rx, ry, rz = pair_vector(dim, bodies.position, shift, c, i, j)
            tx, ty, tz = _relative_angle(dim, bodies.angle, i, j)
            tx, ty, tz = tx - own[3], ty - own[4], tz - own[5]
            out.before[c, 0], out.before[c, 1], out.before[c, 2] = own[0], own[1], own[2]
            out.way[c, 0], out.way[c, 1], out.way[c, 2] = tx, ty, tz
            mx, my, mz = mid_normal(nx, ny, nz, inverse, rx - old[0], ry - old[1], rz - old[2])
            px, py, pz = onto_plane(nx, ny, nz, mx, my, mz, own[0], own[1], own[2])
            dx, dy, dz = onto_plane(nx, ny, nz, mx, my, mz, tx, ty, tz)
        z, fn = complex(overlap, STEP), normal_force(kind, q, r_eff, overlap)
        stiffness, slope = rolling_stiffness(kind, q, r_eff, overlap), rolling_stiffness(kind, q, r_eff, z).imag / STEP
        limit = rolling_cap(kind, q, r_eff, overlap, fn)
        before = SLIDE if contacts.rolling[c, AT_CAP] > 0.0 else STICK
        _, _, _, mode = return_mapping(dim, stiffness, limit, px, py, pz, dx, dy, dz, 1.0, 1.0, before, memory)
        weight = 1.0
        if mode == SLIDE:
            by_force, by_overlap = rolling_cap_slopes(kind, q, r_eff, overlap, fn)
            slope_n = normal_force(kind, q, r_eff, z).imag / STEP
            out.by_force[c], out.by_overlap[c] = by_force, by_force * slope_n + by_overlap
            if stiffness > 0.0:
                out.reach[c] = limit / stiffness
                out.reach_by_overlap[c] = (out.by_overlap[c] - out.reach[c] * slope) / stiffness
                out.reach_by_force[c] = by_force / stiffness
            if dim == 3 and before == SLIDE and limit > 0.0:
                top, below = turning_weight(stiffness, limit, px, py, pz, dx, dy, dz)
                out.weighted[c], weight = 1.0, top / below
        px, py, pz = px + weight * dx, py + weight * dy, pz + weight * dz
        size = np.sqrt(px * px + py * py + pz * pz)
        if mode == SLIDE:
            out.secant[c] = limit / size if size > 0.0 else 0.0
        else:
            out.secant[c] = out.along[c] = stiffness
            out.by_overlap[c] = slope * size


def with_moments(state, law: Law, here, line, turn: Turn, memory: int, stiff: np.ndarray, damp: np.ndarray):
    """Derivatives (C, 9, 9) of (F, T/R, M) with respect to (r, ρ, θ) from those of (F, T/R), at rest; see `jacobian`.

    dM = −[φ/|ψ| (I − ψ̂ψ̂ᵀ) + ∂φ/∂|ψ| ψ̂ψ̂ᵀ] dψ + ∂φ/∂δ ψ̂ (n·dr), with dψ as in `tangent`.
    """
    count = len(stiff)
    out = _MomentLinearisation(
        np.zeros((count, 3)), np.zeros((count, 3)), *np.zeros((len(_MomentLinearisation._fields) - 2, count))
    )
    shift = shifts(state.contacts, state.cell.vectors)
    _fill_moments(law.kind, state.cell.dim, here, state.contacts, shift, law.table, memory, out)
    by_way = np.zeros((count, 3, 6))  # with respect to r and θ
    by_way[:, :, 3:] = np.eye(3)
    psi, by_psi, by_reach = memory_tangent(
        turn, out.before, out.way, by_way, out.reach, out.reach_by_overlap, out.weighted > 0
    )  # fmt: skip
    spring, hat = spring_tangent(psi, line.remembers * line.closed, out.secant, out.along)
    hat_n, moved = outer(hat, line.normal), spring @ by_psi
    whole, rub = np.zeros((2, count, 9, 9))
    whole[:, :6, :6], rub[:, :6, :6] = stiff, damp
    whole[:, 6:, :3] = moved[:, :, :3] + column(out.by_overlap) * hat_n
    whole[:, 6:, 6:] = moved[:, :, 3:]
    by_force = out.by_force[:, None] * hat - np.einsum("ckl,cl->ck", spring, by_reach * out.reach_by_force[:, None])
    rub[:, 6:, :3] = column(line.damping_n) * outer(by_force, line.normal)
    return whole, rub


@njit(cache=True, error_model="numpy")
def _largest_bound(kind, dim, bodies, contacts, shift, p, inverse_inertia):
    """Largest sum of 2 k_r/I over the contacts of a body."""
    total = np.zeros(len(bodies.radius))
    for c in range(contacts.count[0]):
        i, j = contacts.i[c], contacts.j[c]
        k = _rolling_stiffness_at(kind, dim, p, bodies, shift, c, i, j)
        total[i] += 2.0 * k * inverse_inertia[i]
        total[j] += 2.0 * k * inverse_inertia[j]
    return total.max()


def rolling_bound(state, law: Law, here, inverse_inertia) -> float:
    """Upper bound on ω² of the rolling springs alone: |θ_i − θ_j|² ≤ 2 |θ_i|² + 2 |θ_j|² [1/time²]."""
    if not resists_rolling(law.kind):
        return 0.0
    shift = shifts(state.contacts, state.cell.vectors)
    return float(_largest_bound(law.kind, state.cell.dim, here, state.contacts, shift, law.table, inverse_inertia))
