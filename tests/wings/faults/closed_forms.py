"""Closed-form solutions of rate-and-state friction.

`friction_of` and `stiff_step` are for all laws of `RateState`; the others are for the usual law,
μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c). After Ruina 1983 (doi:10.1029/JB088iB12p10359) and Marone 1998
(doi:10.1146/annurev.earth.26.1.643). Those for holds are derived here.
"""

import numpy as np

from stickslip.wings.faults.friction.ratestate import RateState, steady_friction


def friction_of(rs: RateState, velocity, theta, theta2=None):
    """Friction coefficient at a slip velocity and a state, in NumPy."""
    v = np.asarray(velocity, float)
    states = [(rs.b, rs.v0 * np.asarray(theta, float) / rs.dc)]
    states += [(rs.b2, rs.v0 * np.asarray(theta2, float) / rs.dc2)] if theta2 is not None else []
    if rs.form == "regularized":
        scale = np.exp((rs.mu0 + sum(b * np.log(s) for b, s in states)) / rs.a)
        return rs.a * np.arcsinh(v / (2 * rs.v0) * scale)
    return rs.mu0 - rs.a * np.log(rs.v0 / v + rs.v0 / rs.v1) + sum(b * np.log(s + rs.v0 / rs.v2) for b, s in states)


def stiff_step(rs: RateState, old: float, new: float, slip):
    """Friction at slip x ≥ 0 after a step in slip velocity from V1 to V2, as with an infinitely stiff spring.

    Slip law: μ_ss(V2) + b ln(V2/V1) e^{−x/D_c}. Aging law: μ_ss(V2) + b ln[1 + (V2/V1 − 1) e^{−x/D_c}]. Both start at
    μ_ss(V1) + a ln(V2/V1). In other forms, friction is that of the states, which relax in the same way.

    Parameters
    ----------
    old, new : velocities V1 and V2 [length/time]
    slip : since the step [length]
    """
    if rs.form == "regularized" or not np.isinf(rs.v2):
        states = [dc / new * np.exp(_above(rs, old, new, slip, dc)) for dc in (rs.dc, rs.dc2)]
        return friction_of(rs, new, *states)
    above = rs.b * _above(rs, old, new, slip, rs.dc) + rs.b2 * _above(rs, old, new, slip, rs.dc2)
    return steady_friction(rs, new) + above


def _above(rs: RateState, old: float, new: float, slip, dc: float):
    """ln(θ V2/D_c) after slip x."""
    fading = np.exp(-np.asarray(slip, float) / dc)
    return np.log(new / old) * fading if rs.law == "slip" else np.log1p((new / old - 1) * fading)


def stiff_healing(rs: RateState, velocity: float, hold):
    """Peak above steady friction after a hold of duration t without slip, with sliding at V before and after it.

    Aging law: b ln(1 + V t/D_c). Slip law: 0, because its state evolves only with slip.
    """
    hold = np.asarray(hold, float)
    return rs.b * np.log1p(velocity * hold / rs.dc) if rs.law == "aging" else np.zeros_like(hold)


def frozen_hold(a: float, stiffness: float, velocity: float, time):
    """Slip velocity during a hold of the load point while the state is constant, V = V_i/(1 + k V_i t/a).

    This follows from a V'/V = −k V. This is valid for slip well below D_c a/(k D_c + b), and for all times if b = 0.
    Friction decreases by a ln(1 + k V_i t/a).

    Parameters
    ----------
    stiffness : k per unit normal stress [1/length]
    velocity : V_i at the start [length/time]
    """
    return velocity / (1 + stiffness * velocity * np.asarray(time, float) / a)


def slip_law_hold(rs: RateState, stiffness: float, velocity: float, slip):
    """Slip velocity after slip x during a hold of the load point that follows steady sliding at V_i, for the slip law.

    With y = ln(θ V_i/D_c) and z = ln(V/V_i), the force balance is a z + b y = −k x and the law is dy/dx = −(z + y)/D_c,
    hence dy/dx + λ y = k x/(a D_c) with λ = (a − b)/(a D_c). The solution is y = (k/(a D_c)) [x/λ − (1 − e^{−λx})/λ²],
    or y = k x²/(2 a D_c) for a = b, and V = V_i e^{−(kx + by)/a}. Friction decreases by k x.

    Parameters
    ----------
    stiffness : k per unit normal stress [1/length]
    velocity : V_i [length/time]
    slip : x ≥ 0 since the start of the hold [length]
    """
    x = np.asarray(slip, float)
    u = (rs.a - rs.b) / (rs.a * rs.dc) * x
    near = np.abs(u) < 1e-4  # avoids cancellation; the series of (u − 1 + e^{−u})/u² is accurate to 1e-18
    far = np.where(near, 1.0, u)
    shape = np.where(near, 0.5 - u / 6 + u**2 / 24 - u**3 / 120, (far + np.expm1(-far)) / far**2)
    y = stiffness / (rs.a * rs.dc) * x**2 * shape
    return velocity * np.exp(-(stiffness * x + rs.b * y) / rs.a)
