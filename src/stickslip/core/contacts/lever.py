"""Jacobian of contacts with lever arms R − δ/2, from that with ρ' = ρ − (δ/2)(angle_i + angle_j) instead of ρ.

With ρ = R_i angle_i + R_j angle_j, θ = angle_i − angle_j, s = 1/(R_i + R_j) and d = (R_j − R_i) s this is
ρ' = (1 − s δ) ρ − ½ d δ θ. Loads transform with the transpose: T/R = (1 − s δ) T', M = −½ d δ T', with T' = −n × F.
Torques take δ at the end of an increment, the slip takes it halfway.
"""

import numpy as np

from .tangent import column, outer


def with_shorter_arms(state, line, stiff: np.ndarray, damp: np.ndarray):
    """Derivatives (C, 9, 9) of (F, T/R, M) with respect to (r, ρ, θ) from those of (F, T') with respect to (r, ρ')."""
    count = len(stiff)
    radius = np.append(state.grains.radius, np.zeros(len(state.walls.mass)))
    own, other = radius[state.contacts.i[:count]], radius[state.contacts.j[:count]]
    whole, apart = 1 / (own + other), (other - own) / (own + other)
    ends, middle = (_shares(whole, apart, half) for half in (line.half, line.half_mid))
    # dδ/dr = −n, and half as much halfway
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
