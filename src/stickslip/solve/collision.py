"""One head-on collision: its restitution, duration and peak force, and the damping that gives a stated restitution."""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ..core.contacts.mechanics import with_dashpot
from ..core.laws.builtin import (
    DAMPING_N,
    DAMPING_T,
    LINEAR,
    Law,
    damping_factor,
    elastic_constants,
    hertz_mindlin_reff,
    normal_force,
    parameters,
)
from ..core.laws.dispatch import Kind
from ..core.readable import readable


@readable
class Collision(NamedTuple):
    """Two grains that meet head-on and part."""

    restitution: float  # speed after over speed before
    duration: float  # [time]
    peak_force: float  # largest normal force, dashpot included [force]
    peak_overlap: float  # [length]


def collision(law: Law, *, radius: float, mass: float, speed: float, pair: tuple[int, int] = (0, 0)) -> Collision:
    """m_eff δ'' = −F_n(δ, −δ') from δ = 0, δ' = `speed` until the grains part, integrated to 1e-10.

    Parameters
    ----------
    radius, mass : of each of two alike grains [length], [mass]; R_eff and m_eff are half of them
    speed : relative speed before, positive [length/time]
    pair : materials

    Examples
    --------
    >>> import stickslip as ss
    >>> found = collision(ss.laws.linear(kn=1.0), radius=0.5, mass=2.0, speed=0.1)
    >>> round(found.duration, 6)  # half a period of √(m_eff/k_n)
    3.141593
    """
    for name, value in (("radius", radius), ("mass", mass), ("speed", speed)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} was given: it must be positive")
    if isinstance(law.kind, Kind):
        raise ValueError("a collision was asked of a user's law: only built-in laws have one, run the pair instead")
    q, r_eff, m_eff = parameters(law.table, *pair), radius / 2, mass / 2

    def force(x, v):
        x = max(x, 0.0)
        damping = damping_factor(law.damping, r_eff, m_eff, x) * q[DAMPING_N]
        return with_dashpot(law.damping, normal_force(law.kind, q, r_eff, x), damping, -v)

    # scales of an elastic collision, in which the equation is well conditioned whatever the units are
    unit = normal_force(law.kind, q, r_eff, 1.0)
    power = 1.0 if law.kind == LINEAR else 1.5
    depth = ((power + 1) / 2 * m_eff * speed**2 / unit) ** (1 / (power + 1))
    span = depth / speed

    def motion(_, y):
        return [y[1], -force(y[0] * depth, y[1] * speed) * span / (m_eff * speed)]

    def gone(_, y):
        return y[0] if y[1] < 0 else 1.0

    gone.terminal = True
    run = solve_ivp(
        motion,
        (0, 1e6),
        [0.0, 1.0],
        method="DOP853",
        rtol=1e-10,
        atol=1e-13,
        events=gone,
        max_step=0.1,
        dense_output=True,
    )
    course = run.sol(np.linspace(0, run.t[-1], 4001))
    peak = max(force(x * depth, v * speed) for x, v in course.T)
    return Collision(-float(run.y[1, -1]), float(run.t[-1] * span), peak, float(course[0].max() * depth))


def with_restitution(
    law: Law, restitution: float, *, radius: float, mass: float, speed: float, ratio: float = 0.5
) -> Law:
    """The law with that γ_n which gives `restitution` to two alike grains at this size and speed, and γ_t = ratio γ_n.

    Only a linear law with mass-weighted dashpots has a restitution that does not depend on size and speed; hence both
    must be said.

    Parameters
    ----------
    restitution : float, above 0 and at most 1
    radius, mass, speed : as in `collision`
    ratio : γ_t/γ_n, 0.5 as in LAMMPS

    Examples
    --------
    >>> import stickslip as ss
    >>> rock = ss.laws.hertz_mindlin_reff(*ss.laws.elastic_constants(50e9, 0.3))
    >>> mass = 2500 * 4 / 3 * np.pi * 0.0015**3
    >>> law = with_restitution(rock, 0.98, radius=0.0015, mass=mass, speed=25.0)
    >>> f"{law.table[0, 0, DAMPING_N]:.1e}"
    '6.0e+07'
    """
    if not 0 < restitution <= 1:
        raise ValueError(f"restitution = {restitution} was given: it must be above 0 and at most 1")
    if not (np.isfinite(ratio) and ratio >= 0):
        raise ValueError(f"ratio = {ratio} was given: it must be zero or positive")

    def damped(gamma):
        table = law.table.copy()
        table[..., DAMPING_N], table[..., DAMPING_T] = gamma, ratio * gamma
        return law._replace(table=table)

    if restitution == 1:
        return damped(0.0)

    def excess(gamma):
        return collision(damped(gamma), radius=radius, mass=mass, speed=speed).restitution - restitution

    elastic = collision(damped(0.0), radius=radius, mass=mass, speed=speed)
    unit = damping_factor(law.damping, radius / 2, mass / 2, elastic.peak_overlap)
    low, high = 0.0, (1 - restitution) * mass / elastic.duration / unit
    while excess(high) > 0:
        low, high = high, 2 * high
    return damped(brentq(excess, low, high, rtol=1e-9))


def eq8_damping(
    restitution: float, *, young: float, poisson: float, radius: float, mass: float, speed: float, ratio: float = 0.5
) -> float:
    """γ_n by Eq 8 of the supplement of paper 003 (fault gouge), read literally [1/(length time)].

    The collision obeys m_eff δ'' + K (δ^{3/2} + (3/2) A √δ δ') = 0 with K = (2/3) E/(1 − ν²) √R_eff, and

        A = (1/3) (3γ_t − γ_n)²/(3γ_t + 2γ_n) · (1 − ν²)(1 − 2ν)/(E ν²),   γ_t = ratio γ_n.

    The restitution determines A, and this formula then γ_n. In its source γ_n and γ_t are viscosities [Pa s]; their
    numbers are taken here for the coefficients 1/(m s) of `hertz_mindlin_reff`, so that all arguments must be in SI.
    The law damps a collision far less than the restitution says; compare `with_restitution`.

    Parameters
    ----------
    restitution : float, above 0 and at most 1
    young [Pa], poisson : of the grains; poisson between −1/2 and 1/2, not 0
    radius, mass, speed : as in `collision` [m], [kg], [m/s]
    ratio : γ_t/γ_n; not 1/3, where A is zero

    Raises
    ------
    ValueError
        with one sentence, if no γ_n solves the equation.

    Source
    ------
    Ferdowsi & Rubin, supplement of paper 003, Eq 8; Brilliantov et al., doi:10.1103/PhysRevE.53.5382, for A.

    Examples
    --------
    >>> mass = 2500 * 4 / 3 * np.pi * 0.0015**3
    >>> gamma = eq8_damping(0.98, young=50e9, poisson=0.3, radius=0.0015, mass=mass, speed=25.0)
    >>> f"{gamma:.2e}"
    '1.01e+04'
    """
    if not (0 < abs(poisson) < 0.5 and np.isfinite(young) and young > 0) or abs(3 * ratio - 1) < 1e-9:
        raise ValueError(
            f"young = {young}, poisson = {poisson}, ratio = {ratio} were given: Eq 8 has a solution for positive E, "
            f"ν between −1/2 and 1/2 except 0, and γ_t/γ_n other than 1/3 only"
        )
    law = hertz_mindlin_reff(*elastic_constants(young, poisson), 0.0)
    law = with_restitution(law, restitution, radius=radius, mass=mass, speed=speed, ratio=ratio)
    kn, collided = parameters(law.table, 0, 0)[0], law.table[0, 0, DAMPING_N]
    a = 2 * (mass / 2) * collided / (3 * kn)  # m_eff γ_n √(δ R_eff) = K (3/2) A √δ
    elastic = (1 - poisson**2) * (1 - 2 * poisson) / (young * poisson**2)
    return float(3 * a * (3 * ratio + 2) / ((3 * ratio - 1) ** 2 * elastic))
