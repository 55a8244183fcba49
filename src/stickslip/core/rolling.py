"""Resistance to rolling: a moment with a memory of its own, for laws by users that have one.

The memory ψ of a contact is the rotation of i relative to j since it closed, perpendicular to the normal and cut to
what the law bears, and carried along as slip is:

    ψ ← P (ψ + Δ(angle_i − angle_j)),   P = I − n nᵀ,   |ψ| ≤ cap/k_r,   M_i = −k_r ψ,   M_j = +k_r ψ.

A pair that turns as one body has angle_i = angle_j and feels nothing. M and angle_i − angle_j are conjugate, so that
forces F, T/R and M follow from coordinates r, ρ and θ = angle_i − angle_j by the same matrix, transposed. Twisting
about the normal is free.

Sources: Iwashita & Oda, doi:10.1061/(ASCE)0733-9399(1998)124:3(285); Ai et al., doi:10.1016/j.powtec.2010.09.030 (model
C without its dashpot); of the same memory for slip and rolling: Luding, doi:10.1007/s10035-008-0099-x, Sec. 2.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from .contact import apart, carried_memory, effective, held_mode
from .geometry import normal_and_overlap, pair_vector, shifts, tangential
from .kinds import FAST, OWN, Kind, KindType
from .laws import STEP, Law, by_kind, normal_force, row
from .state import OPEN, SLIDE, STICK

# columns of `Contacts.rolling`: ψ; angle_i − angle_j at which it was committed; whether it was at the cap
WIDTH, ANCHOR, AT_CAP = 7, 3, 6


@by_kind
def rolling_stiffness(kind, q, r_eff, overlap):
    """k_r [force length/rad]; built-in laws have none."""
    return 0.0


@by_kind
def rolling_cap(kind, q, r_eff, overlap, fn):
    """Largest rolling moment [force length]."""
    return 0.0


@by_kind
def rolling_cap_slopes(kind, q, r_eff, overlap, fn):
    """Its derivatives with respect to the normal force and the overlap."""
    return 0.0, 0.0


def rolls(kind: int) -> bool:
    """True if a law resists rolling."""
    return isinstance(kind, Kind) and "rolling_stiffness" in OWN.get(kind, {})


def _if_rolling(function):
    """A step of a kernel that is compiled for laws with rolling resistance, and nothing for all others."""

    def step(kind, *rest):
        return function(kind, *rest) if rolls(kind) else None

    def nothing(kind, *rest):
        return None

    @overload(step, jit_options=FAST, strict=False)
    def _(kind, *rest):
        return function if isinstance(kind, KindType) and rolls(Kind(kind.number)) else nothing

    return step


@njit(cache=True, **FAST)
def _turned(dim, angle, i, j):
    """angle_i − angle_j."""
    z = angle[i, 2] - angle[j, 2]
    if dim == 2:
        return 0.0, 0.0, z
    return angle[i, 0] - angle[j, 0], angle[i, 1] - angle[j, 1], z


@njit(cache=True, **FAST)
def _rolled_on(rolling, c, tx, ty, tz):
    """ψ + Δ(angle_i − angle_j), before it is projected."""
    own = rolling[c]
    return own[0] + tx - own[3], own[1] + ty - own[4], own[2] + tz - own[5]


@_if_rolling
def add_rolling(kind, dim, memory, kept, q, r_eff, overlap, fn, angle, nx, ny, nz, rolling, c, i, j, before, torque):
    """Add the moments of a contact, and carry its ψ along; `kept` and FROZEN as in `forces.sweep`."""
    tx, ty, tz = _turned(dim, angle, i, j)
    own, px, py, pz = rolling[c], 0.0, 0.0, 0.0
    rests = kept and tx == own[3] and ty == own[4] and tz == own[5]
    stiffness, limit = rolling_stiffness(kind, q, r_eff, overlap), rolling_cap(kind, q, r_eff, overlap, fn)
    if rests:
        px, py, pz = own[0], own[1], own[2]
    else:
        if before != OPEN:
            px, py, pz = _rolled_on(rolling, c, tx, ty, tz)
            px, py, pz = tangential(nx, ny, nz, px, py, pz)
        mode = held_mode(SLIDE if own[AT_CAP] > 0.0 else STICK, own[0], own[1], own[2])
        px, py, pz, mode = carried_memory(stiffness, limit, px, py, pz, mode, memory)
        own[0], own[1], own[2], own[3], own[4], own[5] = px, py, pz, tx, ty, tz
        own[AT_CAP] = 1.0 if mode == SLIDE else 0.0
    for k, part in enumerate((px, py, pz)):
        torque[i, k] -= stiffness * part
        torque[j, k] += stiffness * part


@_if_rolling
def forget_rolling(kind, rolling, c):
    """A contact has opened."""
    for k in range(WIDTH):
        rolling[c, k] = 0.0


@_if_rolling
def add_rolling_books(
    kind, dim, p, old, new, shift0, shift, before, m, after, c, i, j, known, closed, free, first, at, books
):  # fmt: skip
    """Add to a ledger's row what rolling stores, spends and does to bodies whose rotation is imposed, in one step."""
    stored_at, coulomb_at, nonpotential_at, external_at = at
    mine, own = before.rolling[m if known else 0], after.rolling[c]
    k1, nx, ny, nz = _stiffness_at(kind, dim, p, new, shift, c, i, j)
    size1 = own[0] ** 2 + own[1] ** 2 + own[2] ** 2 if closed else 0.0
    books[stored_at] += 0.5 * k1 * size1
    if first:
        return
    k0, _, _, _ = _stiffness_at(kind, dim, p, old, shift0, c, i, j)
    size0 = mine[0] ** 2 + mine[1] ** 2 + mine[2] ** 2 if known else 0.0
    books[nonpotential_at] += 0.25 * (size1 + size0) * (k1 - k0)
    x1, y1, z1 = _turned(dim, new.angle, i, j)
    x0, y0, z0 = _turned(dim, old.angle, i, j)
    if known and closed:
        px, py, pz = tangential(nx, ny, nz, mine[0] + x1 - x0, mine[1] + y1 - y0, mine[2] + z1 - z0)
        slid = np.sqrt((px - own[0]) ** 2 + (py - own[1]) ** 2 + (pz - own[2]) ** 2)
        books[coulomb_at] += 0.5 * (k1 * np.sqrt(size1) + k0 * np.sqrt(size0)) * slid
    for a, sign in ((i, -1.0), (j, 1.0)):
        for k in range(3):
            if not free[a, 3 + k]:
                moment = k1 * (own[k] if closed else 0.0) + k0 * (mine[k] if known else 0.0)
                books[external_at] -= 0.5 * sign * moment * (new.angle[a, k] - old.angle[a, k])


@njit(cache=True, **FAST)
def _at(kind, dim, p, bodies, shift, c, i, j):
    """Normal, 1/|r|, overlap, parameters, R_eff of a pair, and whether it is out of reach."""
    n_grains = len(bodies.radius) - len(bodies.normal)
    rx, ry, rz = pair_vector(dim, bodies.position, shift, c, i, j)
    is_wall, radius = j >= n_grains, bodies.radius
    nx, ny, nz, overlap, inverse = normal_and_overlap(i, j, is_wall, j - n_grains, radius, bodies.normal, rx, ry, rz)
    r_eff, _ = effective(kind, 0, radius, bodies.inverse_mass, i, j, is_wall)
    q = row(kind, p, bodies.material[i], bodies.material[j])
    away = apart(kind, p, bodies.material, radius, bodies.inverse_mass, i, j, is_wall, overlap)
    return (nx, ny, nz), inverse, overlap, q, r_eff, away


@njit(cache=True, **FAST)
def _stiffness_at(kind, dim, p, bodies, shift, c, i, j):
    """k_r and the normal; no stiffness where the pair is out of reach."""
    (nx, ny, nz), _, overlap, q, r_eff, away = _at(kind, dim, p, bodies, shift, c, i, j)
    return 0.0 if away else rolling_stiffness(kind, q, r_eff, overlap), nx, ny, nz


class _Moments(NamedTuple):
    """What the linearisation of M is made of, one row a contact."""

    carried: np.ndarray  # (C, 3) ψ + Δθ before projection
    secant: np.ndarray  # (C,) φ/|ψ|
    along: np.ndarray  # (C,) ∂φ/∂|ψ|
    by_overlap: np.ndarray  # (C,) ∂φ/∂δ at fixed ψ
    by_force: np.ndarray  # (C,) ∂φ/∂F_n, as a dashpot changes F_n


@njit(cache=True, error_model="numpy")
def _linearise(kind, dim, bodies, contacts, shift, p, memory, out):
    for c in range(contacts.count[0]):
        i, j = contacts.i[c], contacts.j[c]
        (nx, ny, nz), _, overlap, q, r_eff, away = _at(kind, dim, p, bodies, shift, c, i, j)
        if away:
            continue
        px = py = pz = 0.0
        if contacts.mode[c] != OPEN:
            tx, ty, tz = _turned(dim, bodies.angle, i, j)
            px, py, pz = _rolled_on(contacts.rolling, c, tx, ty, tz)
        out.carried[c, 0], out.carried[c, 1], out.carried[c, 2] = px, py, pz
        px, py, pz = tangential(nx, ny, nz, px, py, pz)
        z, fn = complex(overlap, STEP), normal_force(kind, q, r_eff, overlap)
        stiffness, slope = rolling_stiffness(kind, q, r_eff, overlap), rolling_stiffness(kind, q, r_eff, z).imag / STEP
        limit, size = rolling_cap(kind, q, r_eff, overlap, fn), np.sqrt(px * px + py * py + pz * pz)
        own = contacts.rolling[c]
        mode = held_mode(SLIDE if own[AT_CAP] > 0.0 else STICK, own[0], own[1], own[2])
        _, _, _, mode = carried_memory(stiffness, limit, px, py, pz, mode, memory)
        if mode == SLIDE:
            by_force, by_overlap = rolling_cap_slopes(kind, q, r_eff, overlap, fn)
            slope_n = normal_force(kind, q, r_eff, z).imag / STEP
            out.secant[c] = limit / size if size > 0.0 else 0.0
            out.by_force[c], out.by_overlap[c] = by_force, by_force * slope_n + by_overlap
        else:
            out.secant[c] = out.along[c] = stiffness
            out.by_overlap[c] = slope * size


def with_moments(state, law: Law, here, line, memory: int, stiff: np.ndarray, damp: np.ndarray):
    """Blocks (C, 9, 9) of (F, T/R, M) by (r, ρ, θ) from those of (F, T/R) by (r, ρ), all at rest; see `jacobian`.

    dM = −[φ/|ψ| (I − ψ̂ψ̂ᵀ) + ∂φ/∂|ψ| ψ̂ψ̂ᵀ] dψ + ∂φ/∂δ ψ̂ (n·dr),  dψ = P dθ − dn (n·w) − n (ψ·dn),  w = ψ + Δθ.
    """
    count = len(stiff)
    out = _Moments(np.zeros((count, 3)), *np.zeros((4, count)))
    shift = shifts(state.contacts, state.cell.vectors)
    _linearise(law.kind, state.cell.dim, here, state.contacts, shift, law.table, memory, out)

    def col(a):
        return a[:, None, None]

    normal, eye = line.normal, np.eye(3)
    along = np.einsum("ca,ca->c", normal, out.carried)
    psi = out.carried - along[:, None] * normal
    size = np.linalg.norm(psi, axis=1)
    hat = np.divide(psi, size[:, None], out=np.zeros_like(psi), where=size[:, None] > 0)
    hh, project = hat[:, :, None] * hat[:, None, :], eye - normal[:, :, None] * normal[:, None, :]
    dn = col(line.inverse) * project
    turn = -col(along) * dn - normal[:, :, None] * np.einsum("ca,cab->cb", psi, dn)[:, None, :]
    spring = -col(line.remembers * line.closed) * (col(out.secant) * (eye - hh) + col(out.along) * hh)
    outer = hat[:, :, None] * normal[:, None, :]
    whole, rub = np.zeros((2, count, 9, 9))
    whole[:, :6, :6], rub[:, :6, :6] = stiff, damp
    whole[:, 6:, :3] = spring @ turn + col(out.by_overlap) * outer
    whole[:, 6:, 6:] = spring @ project
    rub[:, 6:, :3] = col(line.damping_n * out.by_force) * outer
    return whole, rub


@njit(cache=True, error_model="numpy")
def _stiffest(kind, dim, bodies, contacts, shift, p, inverse_inertia):
    """Largest sum over a body's contacts of 2 k_r/I."""
    total = np.zeros(len(bodies.radius))
    for c in range(contacts.count[0]):
        i, j = contacts.i[c], contacts.j[c]
        k, _, _, _ = _stiffness_at(kind, dim, p, bodies, shift, c, i, j)
        total[i] += 2.0 * k * inverse_inertia[i]
        total[j] += 2.0 * k * inverse_inertia[j]
    return total.max()


def of_rolling(state, law: Law, here, inverse_inertia) -> float:
    """Upper bound of ω² of the springs of rolling alone: |θ_i − θ_j|² ≤ 2 |θ_i|² + 2 |θ_j|² [1/time²]."""
    if not rolls(law.kind):
        return 0.0
    shift = shifts(state.contacts, state.cell.vectors)
    return float(_stiffest(law.kind, state.cell.dim, here, state.contacts, shift, law.table, inverse_inertia))
