"""Friction after a step of velocity, in closed form."""

import numpy as np

from stickslip.wings.faults.friction.laws import RateState, friction_of, steady_friction


def stiff_step(rs: RateState, old: float, new: float, slip):
    """Friction at slip x ≥ 0 after a step of slip velocity from V1 to V2, as with an infinitely stiff spring.

    Slip law: μ_ss(V2) + b ln(V2/V1) e^{−x/D_c}. Aging law: μ_ss(V2) + b ln[1 + (V2/V1 − 1) e^{−x/D_c}]. Both start at
    μ_ss(V1) + a ln(V2/V1). In other forms the states relax in the same way, and friction follows from them.

    Parameters
    ----------
    old, new : velocities V1 and V2 [length/time]
    slip : slip since the step [length]
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
