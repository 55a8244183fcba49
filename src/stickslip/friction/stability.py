"""Stability of steady sliding on a spring: critical stiffness and eigenvalues of the linearised slider."""

from typing import NamedTuple

import numpy as np

from ..core.arguments import checked
from ..core.readable import readable
from .kernel import rate_derivatives
from .ratestate import RateState, Spring, check, check_spring, kernel_parameters


@readable
class Sliding(NamedTuple):
    """Steady sliding at one velocity, and the evolution of small disturbances."""

    stable: bool
    critical: float  # stiffness below which it is unstable; not positive if it is always stable [1/length]
    eigenvalues: np.ndarray  # (2,) complex: a disturbance is a sum of e^{λt} [1/time]
    growth_rate: float  # largest real part; negative if disturbances decay [1/time]
    frequency: float  # angular, 0 without oscillation [1/time]
    sentence: str


@checked
def critical_stiffness(rs: RateState, velocity: float = 0.0, damping: float = 0.0) -> float:
    """k_c = (b − a − η V)/D_c per unit normal stress: steady sliding is unstable if and only if k < k_c.

    This holds for both laws (Ruina 1983, doi:10.1029/JB088iB12p10359; Rice and Ruina 1983, doi:10.1115/1.3167042);
    radiation damping η adds η V to the direct effect a.

    Parameters
    ----------
    velocity : V, relevant only with damping [length/time]
    damping : η over the normal stress [time/length]

    Examples
    --------
    >>> print(round(critical_stiffness(RateState(0.010, 0.015, 1e-5)), 6))
    500.0
    """
    check(rs)
    return (rs.b - rs.a - damping * velocity) / rs.dc


@checked
def steady_sliding(rs: RateState, spring: Spring, velocity: float) -> Sliding:
    """Stability of steady sliding at V: eigenvalues of the linearised equations for ln V and ln θ.

    trace = (V/D_c) [(b − k D_c)/(a + ηV) − 1], determinant = k V²/[D_c (a + ηV)] > 0; at k = k_c the frequency is
    (V/D_c) √((b − a − ηV)/(a + ηV)).

    Parameters
    ----------
    velocity : V of slider and load point [length/time]

    Examples
    --------
    >>> found = steady_sliding(RateState(0.010, 0.015, 1e-5), Spring(400.0), 1e-6)
    >>> found.stable, print(round(found.growth_rate, 6))
    0.005
    (False, None)
    """
    check(rs)
    check_spring(spring)
    if not (velocity > 0 and np.isfinite(velocity)):
        raise ValueError(f"velocity = {velocity} was given: use a positive, finite velocity for steady sliding")
    w = np.log(velocity / rs.v0)
    ww, wf, fw, ff = rate_derivatives(w, -w, kernel_parameters(rs, spring), velocity, 1.0)
    values = np.linalg.eigvals(np.array([[ww, wf], [fw, ff]], complex))
    critical = critical_stiffness(rs, velocity, spring.damping)
    growth, frequency = float(values.real.max()), float(np.abs(values.imag).max())
    stable = spring.stiffness > critical
    return Sliding(stable, critical, values, growth, frequency, _sentence(rs, spring, stable, critical, growth))


def _sentence(rs, spring, stable: bool, critical: float, growth: float) -> str:
    if critical <= 0:
        return f"steady sliding is stable with any spring: b = {rs.b:g} does not exceed the direct effect"
    ratio = f"stiffness {spring.stiffness:.4g} is {spring.stiffness / critical:.4g} times the critical {critical:.4g}"
    if stable:
        return f"steady sliding is stable: {ratio}; disturbances decay by a factor of e in {-1 / growth:.4g}"
    return f"steady sliding is unstable: {ratio}; disturbances grow by a factor of e in {1 / max(growth, 1e-300):.4g}"
