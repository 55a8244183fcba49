"""Stability of steady sliding on a spring: critical stiffness and eigenvalues of the linearised slider."""

from typing import NamedTuple

import numpy as np

from ....kit import checked, readable
from .laws import slopes
from .ratestate import RateState, Spring, check, check_spring, slider_of
from .slider import rates


@readable
class Sliding(NamedTuple):
    """Steady sliding at one velocity, and the evolution of small disturbances."""

    stable: bool
    critical: float  # stiffness below which it is unstable; not positive if it is always stable [1/length]
    eigenvalues: np.ndarray  # (2,) complex, (3,) with two states: a disturbance is a sum of e^{λt} [1/time]
    growth_rate: float  # largest real part; negative if disturbances decay [1/time]
    frequency: float  # angular, 0 without oscillation [1/time]
    sentence: str


@checked
def critical_stiffness(rs: RateState, velocity: float = 0.0, damping: float = 0.0) -> float:
    """Critical stiffness k_c per unit normal stress: steady sliding is unstable if and only if k < k_c.

    With one state, k_c = (B − A − η V)/D_c for both evolution laws (Ruina 1983, doi:10.1029/JB088iB12p10359; Rice and
    Ruina 1983, doi:10.1115/1.3167042), where A = ∂μ/∂ln V and B = ∂μ/∂ln θ in steady sliding at V; for the usual law
    A = a and B = b. Radiation damping η adds η V to A. With two states, k_c is the larger root of the quadratic
    equation that follows from Hurwitz's criterion for the cubic characteristic polynomial (compare Gu et al. 1984,
    doi:10.1016/0022-5096(84)90007-3), and −∞ if there is none.

    Parameters
    ----------
    velocity : V, relevant only with damping, cut-off velocities or the regularized form; 0: slopes are those at v0
        [length/time]
    damping : η over the normal stress [time/length]

    Examples
    --------
    >>> print(round(critical_stiffness(RateState(0.010, 0.015, 1e-5)), 6))
    500.0
    """
    check(rs)
    direct, slope, slope2 = steady_slopes(rs, velocity or rs.v0)
    direct += damping * velocity
    if rs.b2 == 0:
        return (slope - direct) / rs.dc
    first, second = rs.dc, rs.dc2
    # of the cubic in λ/V: M D D2, D D2 k + p, (D + D2) k + q, k
    p, q = direct * (first + second) - slope * second - slope2 * first, direct - slope - slope2
    roots = np.roots(
        [first * second * (first + second), first * second * q + (first + second) * p - direct * first * second, p * q]
    )
    return float(max(roots.real)) if np.isreal(roots).all() else -np.inf


def steady_slopes(rs: RateState, velocity: float) -> tuple[float, float, float]:
    """Derivatives of friction with respect to ln V, ln θ and ln θ2 in steady sliding."""
    w, slider = np.log(velocity / rs.v0), slider_of(rs, Spring(1.0))
    return tuple(slopes(slider.form, (w, -w, -w), slider[:6])[0].tolist())


@checked
def steady_sliding(rs: RateState, spring: Spring, velocity: float) -> Sliding:
    """Stability of steady sliding at V: eigenvalues of the linearised equations for ln V and ln θ.

    For the usual law, trace = (V/D_c) [(b − k D_c)/(a + ηV) − 1] and determinant = k V²/[D_c (a + ηV)] > 0; at k = k_c
    the frequency is (V/D_c) √((b − a − ηV)/(a + ηV)).

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
    matrix = rates(slider_of(rs, spring), (w, -w, -w), velocity, 1.0)[1].astype(complex)
    values = np.linalg.eigvals(matrix if rs.b2 > 0 else matrix[:2, :2])
    critical = critical_stiffness(rs, velocity, spring.damping)
    growth, frequency = float(values.real.max()), float(np.abs(values.imag).max())
    stable = spring.stiffness > critical
    direct, *effects = steady_slopes(rs, velocity)
    sentence = _sentence(rs, spring, stable, critical, growth, direct + spring.damping * velocity, sum(effects))
    return Sliding(stable, critical, values, growth, frequency, sentence)


def _sentence(rs, spring, stable: bool, critical: float, growth: float, direct: float, evolution: float) -> str:
    if critical <= 0:
        name = "b" if rs.b2 == 0 else "b + b2"
        name += " at this velocity" * bool(np.isfinite([rs.v1, rs.v2]).any())
        what = "direct effect and damping, " if spring.damping else "direct effect, "
        return (
            f"steady sliding is stable with any spring: {name} = {evolution:.4g} does not exceed the {what}{direct:.4g}"
        )
    ratio = f"stiffness {spring.stiffness:.4g} is {spring.stiffness / critical:.4g} times the critical {critical:.4g}"
    if stable:
        return f"steady sliding is stable: {ratio}; disturbances decay by a factor of e in {-1 / growth:.4g}"
    return f"steady sliding is unstable: {ratio}; disturbances grow by a factor of e in {1 / max(growth, 1e-300):.4g}"
