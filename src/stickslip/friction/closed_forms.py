"""Closed-form solutions of rate-and-state friction, for tests and for interpreting records by hand.

All are for μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c) (`RateState`), after Ruina 1983 (doi:10.1029/JB088iB12p10359) and
Marone 1998 (doi:10.1146/annurev.earth.26.1.643). Those for holds are derived here.
"""

import numpy as np

from .ratestate import RateState, check


def steady_friction(rs: RateState, velocity):
    """Steady friction μ_ss = μ0 + (a − b) ln(V/V0), with θ_ss = D_c/V.

    Examples
    --------
    >>> print(round(steady_friction(RateState(0.0247, 0.0178, 5.3e-3, 0.4, 0.02), 0.2) - 0.4, 5))
    0.01589
    """
    check(rs)
    return rs.mu0 + (rs.a - rs.b) * np.log(np.asarray(velocity, float) / rs.v0)


def stiff_step(rs: RateState, old: float, new: float, slip):
    """Friction at slip x ≥ 0 after a step in slip velocity from V1 to V2, as with an infinitely stiff spring.

    Slip law: μ_ss(V2) + b ln(V2/V1) e^{−x/D_c}. Aging law: μ_ss(V2) + b ln[1 + (V2/V1 − 1) e^{−x/D_c}].
    Both start at μ_ss(V1) + a ln(V2/V1).

    Parameters
    ----------
    old, new : velocities V1 and V2 [length/time]
    slip : since the step [length]
    """
    fading = np.exp(-np.asarray(slip, float) / rs.dc)
    if rs.law == "slip":
        above = np.log(new / old) * fading
    else:
        above = np.log1p((new / old - 1) * fading)
    return steady_friction(rs, new) + rs.b * above


def stiff_healing(rs: RateState, velocity: float, hold):
    """Peak above steady friction after a hold of duration t without slip, with sliding at V before and after it.

    Aging law: b ln(1 + V t/D_c). Slip law: 0, because its state evolves only with slip.
    """
    check(rs)
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
    check(rs)
    if rs.law != "slip":
        raise ValueError(f"law = {rs.law!r} was given: this closed form is for the slip law")
    x = np.asarray(slip, float)
    u = (rs.a - rs.b) / (rs.a * rs.dc) * x
    near = np.abs(u) < 1e-4  # avoids cancellation; the series of (u − 1 + e^{−u})/u² is accurate to 1e-18
    far = np.where(near, 1.0, u)
    shape = np.where(near, 0.5 - u / 6 + u**2 / 24 - u**3 / 120, (far + np.expm1(-far)) / far**2)
    y = stiffness / (rs.a * rs.dc) * x**2 * shape
    return velocity * np.exp(-(stiffness * x + rs.b * y) / rs.a)
