"""Head-on collision of two grains: restitution, duration, peak force, and the damping for a given restitution."""

from itertools import count
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ..builtin_laws import BUILTIN_LAWS
from ..core.arguments import NotNegative, Positive, checked
from ..core.fields import LARGEST
from ..core.laws.builtin import (
    DAMPING_N,
    DAMPING_T,
    KN,
    NO_TENSION,
    RESTITUTION,
    TSUJI,
    VISCOELASTIC,
    Law,
    elastic_constants,
    hertz_mindlin_reff,
)
from ..core.laws.compiled import evaluate
from ..core.laws.kinds import Kind
from ..core.laws.properties import dashpot_coefficients
from ..core.readable import readable

ROUND_OFF = 2e-12  # accuracy of γ_n in natural units
LONGEST = 100.0  # longest integrated duration, in units in which an elastic collision takes about 3
MOST_CALLS = 200_000  # largest number of force evaluations, about a hundred times that of a collision
LEAST = 1e-4  # smallest restitution; below it, collisions last long, and their final speed is round-off
DOUBLINGS = 60


@readable
class Collision(NamedTuple):
    """Result of a head-on collision of two grains."""

    restitution: float  # relative speed after the collision over that before it
    duration: float  # [time]
    peak_force: float  # largest normal force, dashpot included [force]
    peak_overlap: float  # [length]


@checked
def collision(
    law: Law, *, radius: Positive, mass: Positive, speed: Positive, pair: tuple[int, int] = (0, 0)
) -> Collision:
    """Simulate a head-on collision of two grains.

    Integrates m_eff δ'' = −F_n(δ, −δ') from δ = 0, δ' = `speed` until the grains separate, to a tolerance of 1e-10.
    Grains that are damped so strongly that they do not separate within about 30 durations of the elastic collision
    have a restitution of zero and an infinite duration.

    Parameters
    ----------
    radius, mass : of each of the two identical grains [length], [mass]; R_eff and m_eff are half of these
    speed : relative speed before the collision, positive [length/time]
    pair : materials of the two grains

    Examples
    --------
    >>> import stickslip as ss
    >>> found = collision(ss.laws.linear(kn=1.0), radius=0.5, mass=2.0, speed=0.1)
    >>> round(found.duration, 6)  # half a period, π √(m_eff/k_n)
    3.141593
    """
    for number in pair:
        if number not in range(len(law.table)):
            raise ValueError(
                f"the law has {len(law.table)} materials, numbered from 0, but not material {number}: add it with "
                "laws.for_pair(law, a, b)"
            )
    run, force, depth, span = _integrate(law, radius, mass, speed, pair, dense_output=True)
    course = run.sol(np.linspace(0, run.t[-1], 4001))
    peak = max(force(x * depth, v * speed) for x, v in course.T)
    return Collision(
        _restitution(run), float(run.t[-1] * span) if run.t[-1] < LONGEST else np.inf, peak,
        float(course[0].max() * depth),
    )  # fmt: skip


def _restitution(run) -> float:
    return -float(run.y[1, -1]) if run.t[-1] < LONGEST else 0.0


def _integrate(law: Law, radius: float, mass: float, speed: float, pair: tuple[int, int], *, dense_output: bool):
    """Integrate a collision; return the solution from SciPy, the force, and the units of length and time used in it."""
    if isinstance(law.kind, Kind) or BUILTIN_LAWS[law.kind].parameters:
        raise ValueError(
            "`collision` supports the normal forces k δ and k δ^(3/2) only: for this law, simulate the two grains "
            "with `run`"
        )
    m_eff, power = mass / 2, BUILTIN_LAWS[law.kind].exponent
    damping_power = {VISCOELASTIC: 0.5, TSUJI: (power - 1) / 2, RESTITUTION: (power - 1) / 2}.get(
        law.damping & ~NO_TENSION, 0.0
    )
    at = {"overlap": 1.0, "r_eff": radius / 2, "m_eff": m_eff, "a": pair[0], "b": pair[1]}
    unit, dashpot = (float(value) for value in evaluate(law, "force", "damping", **at))
    dashpot *= float(dashpot_coefficients(law)[*pair, 0])

    def force(x, v):
        x = max(x, 0.0)
        out = unit * x**power + dashpot * x**damping_power * v
        return max(out, 0.0) if law.damping & NO_TENSION else out

    # scale by the elastic collision, so that the equation is well conditioned in any units
    with np.errstate(all="ignore"):
        depth = ((power + 1) / 2 * m_eff * np.float64(speed) ** 2 / unit) ** (1 / (power + 1))
        span = depth / speed
    if not all(1 / LARGEST < size < LARGEST for size in (depth, span, m_eff * speed)):
        raise ValueError(
            f"mass = {mass:g} and speed = {speed:g} give an overlap of {depth:.3g} and a duration of {span:.3g}, "
            "beyond the range of floating-point numbers: use other units"
        )
    calls = count()

    def motion(_, y):
        if next(calls) > MOST_CALLS:
            raise ValueError("damping_n of this law is so large that the collision cannot be integrated: reduce it")
        return [y[1], -force(y[0] * depth, y[1] * speed) * span / (m_eff * speed)]

    def overlap(_, y):
        return y[0] if y[1] < 0 else 1.0

    overlap.terminal = True
    run = solve_ivp(
        motion,
        (0, LONGEST),
        [0.0, 1.0],
        method="DOP853",
        rtol=1e-10,
        atol=1e-13,
        events=overlap,
        max_step=0.1,
        dense_output=dense_output,
    )
    return run, force, depth, span


@checked
def with_restitution(
    law: Law, restitution: float, *, radius: Positive, mass: Positive, speed: Positive, ratio: NotNegative = 0.5
) -> Law:
    """Law with γ_n chosen to give a head-on collision of two identical grains the given restitution; γ_t = ratio γ_n.

    The restitution is independent of size and speed only for a linear law with mass-weighted dashpots, so `radius`,
    `mass` and `speed` must be given.

    Parameters
    ----------
    restitution : float, at least 1e-4 and at most 1
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
    if not LEAST <= restitution <= 1:
        raise ValueError(f"restitution must be from {LEAST:g} to 1, got {restitution}")
    if law.damping & ~NO_TENSION in (TSUJI, RESTITUTION):
        raise ValueError("damping_n of this law is already a coefficient of restitution: set it when creating the law")

    def with_damping(gamma):
        table = law.table.copy()
        table[..., DAMPING_N], table[..., DAMPING_T] = gamma, ratio * gamma
        return law._replace(table=table)

    if restitution == 1:
        return with_damping(0.0)

    def excess(gamma):
        run, *_ = _integrate(with_damping(gamma), radius, mass, speed, (0, 0), dense_output=False)
        return _restitution(run) - restitution

    elastic = collision(with_damping(0.0), radius=radius, mass=mass, speed=speed)
    unit = evaluate(law, "damping", overlap=elastic.peak_overlap, r_eff=radius / 2, m_eff=mass / 2)
    low, high = 0.0, (1 - restitution) * mass / elastic.duration / unit
    for _ in range(DOUBLINGS):
        if not excess(high) > 0:
            break
        low, high = high, 2 * high
    else:
        raise ValueError(f"no damping gives a restitution of {restitution}: the law damps collisions too little")
    size = 2 * radius
    force, factor = evaluate(law, "force", "damping", overlap=size, r_eff=size, m_eff=mass)
    natural = np.sqrt(force / size * mass) / factor
    return with_damping(brentq(excess, low, high, rtol=1e-9, xtol=ROUND_OFF * natural))


@checked
def eq8_damping(
    restitution: float,
    *,
    young: float,
    poisson: float,
    radius: Positive,
    mass: Positive,
    speed: Positive,
    ratio: NotNegative = 0.5,
) -> float:
    """Damping γ_n from Eq 8 of Ferdowsi & Rubin 2021, taken literally [1/(length time)].

    The collision obeys m_eff δ'' + K (δ^{3/2} + (3/2) A √δ δ') = 0 with K = (2/3) E/(1 − ν²) √R_eff, and

        A = (1/3) (3γ_t − γ_n)²/(3γ_t + 2γ_n) · (1 − ν²)(1 − 2ν)/(E ν²),   γ_t = ratio γ_n.

    The restitution determines A, and A determines γ_n. In the source, γ_n and γ_t are viscosities [Pa s]. Here their
    values are used as the coefficients [1/(m s)] of `hertz_mindlin_reff`, so all arguments must be in SI units. The
    resulting law damps a collision far less than `restitution` requires; compare `with_restitution`.

    Parameters
    ----------
    restitution : float, at least 1e-4 and at most 1
    young [Pa], poisson : of the grains; poisson between −1/2 and 1/2, not 0
    radius, mass, speed : as in `collision` [m], [kg], [m/s]
    ratio : γ_t/γ_n; must not be 1/3, where A is zero

    Raises
    ------
    ValueError
        If no γ_n solves the equation.

    Source
    ------
    Ferdowsi & Rubin 2021, Eq 8; Brilliantov et al., doi:10.1103/PhysRevE.53.5382, for A.

    Examples
    --------
    >>> mass = 2500 * 4 / 3 * np.pi * 0.0015**3
    >>> gamma = eq8_damping(
    ...     0.98, young=50e9, poisson=0.3, radius=0.0015, mass=mass, speed=25.0
    ... )
    >>> f"{gamma:.2e}"
    '1.01e+04'
    """
    if not (abs(poisson) < 0.5 and poisson**2 > 0 and np.isfinite(young) and young > 0) or abs(3 * ratio - 1) < 1e-9:
        raise ValueError(
            "Eq 8 has a solution only for positive young, poisson between −1/2 and 1/2 except 0, and a ratio γ_t/γ_n "
            f"other than 1/3, got {young}, {poisson} and {ratio}"
        )
    law = hertz_mindlin_reff(*elastic_constants(young, poisson), 0.0)
    law = with_restitution(law, restitution, radius=radius, mass=mass, speed=speed, ratio=ratio)
    kn, collided = law.table[0, 0, [KN, DAMPING_N]]
    a = 2 * (mass / 2) * collided / (3 * kn)  # m_eff γ_n √(δ R_eff) = K (3/2) A √δ
    elastic = (1 - poisson**2) * (1 - 2 * poisson) / (young * poisson**2)
    return float(3 * a * (3 * ratio + 2) / ((3 * ratio - 1) ** 2 * elastic))
