"""Derivatives of the memory update of contacts, for slip and for rolling, as arrays with one row per contact.

Let n be the current normal, Δr the displacement of the pair vector since the memory was committed and g = P Δr its
tangential part. The mid-step normal is m = n − g/(2|r|); see `mechanics.h`. A vector w is mapped to T w = w − (n·w) m.
Therefore

    dn = P dr/|r|,   dg = P dr − dn (n·Δr) − n (dn·Δr),   dm = dn − dg/(2|r|) + g (n·dr)/(2|r|²),
    d(T w) = dw − m (dn·w + n·dw) − (n·w) dm.

For laws that rescale, the previous memory is multiplied by f = √(δ/δ_old) where δ < δ_old, and its increment by (1 +
f)/2; df = −f/(2δ) n·dr. At δ = δ_old, this factor has a kink. There, f = 1 and df = 0 are used, as for a growing
overlap.
"""

from typing import NamedTuple

import numpy as np

from .forces import MIN_WEIGHT


class Turn(NamedTuple):
    """Normals of C contacts and their derivatives with respect to the pair vector r."""

    normal: np.ndarray  # (C, 3) n
    by_normal: np.ndarray  # (C, 3, 3) dn/dr
    mid: np.ndarray  # (C, 3) m
    by_mid: np.ndarray  # (C, 3, 3) dm/dr


def column(a: np.ndarray) -> np.ndarray:
    """Reshape factors of matrices, one per contact, from (C,) to (C, 1, 1)."""
    return a[:, None, None]


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products of rows, (C,)."""
    return np.einsum("ck,ck->c", a, b)


def outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Outer products a bᵀ of rows, (C, 3, 3)."""
    return a[:, :, None] * b[:, None, :]


def rowwise(a: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Products aᵀ M of rows with (C, 3, K) matrices, (C, K)."""
    return np.einsum("ck,ckl->cl", a, matrix)


def make_turn(normal: np.ndarray, inverse: np.ndarray, way: np.ndarray) -> Turn:
    """Normal and mid-step normal with derivatives; `inverse` (C,) is 1/|r|, zero for walls, and `way` (C, 3) is Δr."""
    project = np.eye(3) - outer(normal, normal)
    along = dot(normal, way)
    g = way - along[:, None] * normal
    by_normal = column(inverse) * project
    by_g = project - column(along) * by_normal - outer(normal, rowwise(way, by_normal))
    half = 0.5 * inverse
    by_mid = by_normal - column(half) * by_g + column(half * inverse) * outer(g, normal)
    return Turn(normal, by_normal, normal - half[:, None] * g, by_mid)


def projected(turn: Turn, w: np.ndarray, by_w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T w (C, 3) and its derivative (C, 3, K). The first three of the K coordinates are r, and `by_w` is dw."""
    along = dot(turn.normal, w)
    by_along = rowwise(turn.normal, by_w)
    by_along[:, :3] += rowwise(w, turn.by_normal)
    out = by_w - turn.mid[:, :, None] * by_along[:, None, :]
    out[:, :, :3] -= column(along) * turn.by_mid
    return w - along[:, None] * turn.mid, out


def memory_tangent(
    turn: Turn, before, way, by_way, reach, by_overlap, weighted, fade=None, fading=None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Memory f a + κ d (C, 3), its derivative (C, 3, K), and its derivative with respect to `reach` (C, 3).

    Here, a = T `before` and d = (1 + f)/2 T `way`.

    Parameters
    ----------
    before : (C, 3) previous memory
    way, by_way : (C, 3) and (C, 3, K) increment of the memory, and its derivative
    reach, by_overlap : (C,) length at the Coulomb limit, and its derivative with respect to the overlap
    weighted : (C,) bool, True where κ is not 1: see `turning_weight` in `mechanics.h`
    fade, fading : (C,) factor f by which a decreasing overlap shortens the memory, and df/dδ; default 1 and 0
    """
    a, by_a = projected(turn, before, np.zeros_like(by_way))
    d, by_d = projected(turn, way, by_way)
    if fade is not None:
        by_fade = np.zeros((len(a), by_way.shape[2]))
        by_fade[:, :3] = -fading[:, None] * turn.normal
        half = 0.5 * (1.0 + fade)
        by_d = column(half) * by_d + 0.5 * d[:, :, None] * by_fade[:, None, :]
        d = half[:, None] * d
    kappa, by_kappa, by_reach = np.ones(len(a)), np.zeros((len(a), by_way.shape[2])), np.zeros(len(a))
    if weighted.any():
        square = np.where(weighted, reach, 1.0) ** 2
        change = dot(a, a + 2.0 * d)
        by_change = 2.0 * (rowwise(a + d, by_a) + rowwise(a, by_d))
        by_change[:, :3] += (2.0 * change / np.sqrt(square) * by_overlap)[:, None] * turn.normal
        weight = 0.75 + 0.25 * change / square
        small = weight <= MIN_WEIGHT
        kappa = np.where(weighted, np.where(small, MIN_WEIGHT, weight), 1.0)
        by_kappa = np.where((weighted & ~small)[:, None], 0.25 * by_change / square[:, None], 0.0)
        by_reach = np.where(weighted & ~small, -0.5 * change / square**1.5, 0.0)
    if fade is not None:  # a sliding memory rotates as if it had not been shortened
        share, by_share = np.where(weighted, fade / half, 1.0), np.where(weighted, 0.5 / half**2, 0.0)
        by_a = column(fade) * by_a + a[:, :, None] * by_fade[:, None, :]
        by_kappa = share[:, None] * by_kappa + (kappa * by_share)[:, None] * by_fade
        a, kappa, by_reach = fade[:, None] * a, share * kappa, share * by_reach
    by = by_a + column(kappa) * by_d + d[:, :, None] * by_kappa[:, None, :]
    return a + kappa[:, None] * d, by, by_reach[:, None] * d


def spring_tangent(vector: np.ndarray, remembers, secant, along) -> tuple[np.ndarray, np.ndarray]:
    """Tangent −[φ/|u| (I − û ûᵀ) + ∂φ/∂|u| û ûᵀ] (C, 3, 3), zero without memory, and û (C, 3), for memory vectors u."""
    size = np.linalg.norm(vector, axis=1)[:, None]
    hat = np.divide(vector, size, out=np.zeros_like(vector), where=size > 0)
    hh = outer(hat, hat)
    return -column(remembers) * (column(secant) * (np.eye(3) - hh) + column(along) * hh), hat


# ---- jacobian of contacts with lever arms R − δ/2, from that with ρ' = ρ − (δ/2)(angle_i + angle_j) instead of ρ


def with_shorter_arms(state, line, stiff: np.ndarray, damp: np.ndarray):
    """Derivatives (C, 9, 9) of (F, T/R, M) with respect to (r, ρ, θ) from those of (F, T') with respect to (r, ρ')."""
    count = len(stiff)
    radius = np.append(state.grains.radius, np.zeros(len(state.walls.mass)))
    own, other = radius[state.contacts.i[:count]], radius[state.contacts.j[:count]]
    whole, apart = 1 / (own + other), (other - own) / (own + other)
    ends, middle = (_shares(whole, apart, half) for half in (line.half, line.half_mid))
    # dδ/dr = −n, and half of that for the overlap at mid-step
    stiff_at = stiff.copy()
    stiff_at[:, :, :3] += stiff[:, :, 3:] @ outer(0.25 * line.together, line.normal)
    torque = -np.cross(line.normal, line.force_n[:, None] * line.normal - line.secant[:, None] * line.slip)
    change = np.zeros((count, 9, 3))
    shorter = (line.half != 0)[:, None, None] * outer(torque, line.normal)
    change[:, 3:6], change[:, 6:] = column(whole) * shorter, column(0.5 * apart) * shorter
    back = ends.transpose(0, 2, 1)
    out, rub = back @ stiff_at @ middle, back @ damp @ ends
    out[:, :, :3] += change
    return out, rub


def _shares(whole, apart, half) -> np.ndarray:
    """Matrices (C, 6, 9) that map (r, ρ, θ) to (r, ρ'); `half` is δ/2."""
    out = np.zeros((len(half), 6, 9))
    out[:, :3, :3] = np.eye(3)
    out[:, 3:, 3:6] = column(1 - 2 * half * whole) * np.eye(3)
    out[:, 3:, 6:] = column(-half * apart) * np.eye(3)
    return out
