"""Rate-and-state friction: a spring-slider under any load history, and friction at a prescribed slip velocity.

μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c), where the state θ follows the aging law (Dieterich 1979,
doi:10.1029/JB084iB05p02161) or the slip law (Ruina 1983, doi:10.1029/JB088iB12p10359).
"""

from enum import Enum
from typing import NamedTuple

import numpy as np

from ..core.arguments import checked
from ..core.readable import readable
from . import kernel
from .loads import check_times, leg_arrays

LAWS = {"aging": kernel.AGING, "slip": kernel.SLIP}
EARLY, POINTS = 1e-5, 60  # default times of a leg: first fraction of it, and number on a logarithmic and a linear grid


@readable
class RateState(NamedTuple):
    """Rate-and-state parameters of a surface.

    μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c); aging law θ' = 1 − Vθ/D_c, slip law θ' = −(Vθ/D_c) ln(Vθ/D_c). If the normal
    stress σ changes, −(α/b) θ σ'/σ is added to both (Linker and Dieterich 1992, doi:10.1029/92JB00017).

    Examples
    --------
    >>> RateState(0.0247, 0.0178, 5.3e-3, law="slip").alpha
    0.0
    """

    a: float
    b: float
    dc: float  # [length]
    mu0: float = 0.6
    v0: float = 1e-6  # velocity at which steady friction is mu0 [length/time]
    law: str = "aging"  # or "slip"
    alpha: float = 0.0


@readable
class Spring(NamedTuple):
    """Spring that drives the slider: n μ = k (x_lp − x) − η V, with n the normal stress over its reference."""

    stiffness: float  # k, stress per displacement over the reference normal stress [1/length]
    damping: float = 0.0  # η, radiation damping over the reference normal stress; 0 is quasi-static [time/length]


class End(Enum):
    """Reason why a history ended; each member is a sentence."""

    DONE = "the history reached its end"
    RUNAWAY = "slip ran away, as it does below the critical stiffness: use a stiffer spring, or damping > 0"
    STEPS_SPENT = "the integration used up its steps between two samples: loosen the tolerance, or request more samples"


@readable
class SlipHistory(NamedTuple):
    """History of a slider at N times; after a failure, up to the last time reached."""

    time: np.ndarray
    load_point: np.ndarray  # displacement since the start [length]
    slip: np.ndarray  # [length]
    velocity: np.ndarray  # of slip
    theta: np.ndarray  # [time]
    friction: np.ndarray  # μ(V, θ); the spring force over n is this + η V/n
    normal: np.ndarray  # normal stress over its reference; at a jump, the value before it
    end: End = End.DONE
    reached: float = 0.0  # time at which the history ended

    @property
    def ok(self) -> bool:
        """Return True if the history is complete."""
        return self.end is End.DONE


def check(rs: RateState) -> None:
    """Raise ValueError if the parameters of a surface are not valid."""
    if rs.law not in LAWS:
        raise ValueError(f"law = {rs.law!r} was given: use 'aging' or 'slip'")
    for name in ("a", "dc", "v0"):
        if not (getattr(rs, name) > 0 and np.isfinite(getattr(rs, name))):
            raise ValueError(f"{name} = {getattr(rs, name)} was given: use a positive, finite number")
    for name in ("b", "alpha"):
        if not (getattr(rs, name) >= 0 and np.isfinite(getattr(rs, name))):
            raise ValueError(f"{name} = {getattr(rs, name)} was given: use a finite number that is not negative")
    if not np.isfinite(rs.mu0):
        raise ValueError(f"mu0 = {rs.mu0} was given: use a finite number")
    if rs.alpha > 0 and rs.b == 0:
        raise ValueError(f"alpha = {rs.alpha} was given with b = 0: normal stress acts on the state, so use b > 0")


@checked
def spring_slider(
    rs: RateState,
    spring: Spring,
    legs,
    *,
    times=None,
    before: float | None = None,
    theta: float | None = None,
    tolerance: float = 1e-10,
) -> SlipHistory:
    """History of a slider pulled by a spring.

    (n a + η V) d ln V/dt = k (V_lp − V) − n b d ln θ/dt, with θ' given by the law. ln V and ln θ are integrated with a
    stiff method that restarts at every leg. With η = 0, the motion is quasi-static, and slip may run away
    below the critical stiffness.

    Parameters
    ----------
    legs : of the load point, see `LoadStep`, `velocity_steps`, `slide_hold_slide` and `load_steps`
    times : (N,) ascending, within the legs; default: about 120 per leg, denser at its start [time]
    before : initial slip velocity; default: that of the first leg [length/time]
    theta : initial state; default: the steady state D_c/V [time]
    tolerance : error of ln V and ln θ in each step

    Raises
    ------
    ValueError
        if parameters, legs or times are not valid. Runaway slip is not an error; see `SlipHistory.end`.

    Examples
    --------
    >>> from stickslip import friction
    >>> rs = friction.RateState(0.010, 0.015, 1e-5, law="slip")
    >>> legs = (friction.LoadStep(10.0, 1e-6), friction.LoadStep(100.0, 1e-5))
    >>> h = friction.spring_slider(rs, friction.Spring(1e5), legs)
    >>> print(round(h.friction[-1] - h.friction[0], 6))  # (a − b) ln 10
    -0.011513
    """
    check(rs)
    duration, velocity, normal = leg_arrays(legs)
    check_spring(spring)
    start = float(velocity[0]) if before is None else before
    if not (start > 0 and np.isfinite(start)):
        raise ValueError(f"slip starts at the velocity {start}: give `before`, the positive slip velocity at the start")
    if theta is not None and not (theta > 0 and np.isfinite(theta)):
        raise ValueError(f"theta = {theta} was given: use a positive, finite number")
    ends = np.cumsum(duration)
    times = _default_times(duration, ends) if times is None else _times_within(times, ends[-1])
    w, f = np.log(start / rs.v0), np.log(rs.v0 * (theta or rs.dc / start) / rs.dc)
    p = kernel_parameters(rs, spring)
    out, code, reached = kernel.integrate(w, f, p, rs.alpha, duration, velocity, normal, normal[0], times, tolerance)
    kept = ~np.isnan(out[:, 0])
    factor = normal[np.minimum(np.searchsorted(ends, times[kept]), len(ends) - 1)]
    place = np.interp(times[kept], np.r_[0.0, ends], np.r_[0.0, np.cumsum(duration * velocity)])
    return _build_history(rs, spring, times[kept], place, out[kept], factor, (w, f, normal[0]))._replace(
        end=tuple(End)[code], reached=float(reached)
    )


def kernel_parameters(rs: RateState, spring: Spring) -> np.ndarray:
    """Parameters as an array for kernels."""
    return np.array([rs.a, rs.b, rs.dc, rs.mu0, rs.v0, spring.stiffness, spring.damping, LAWS[rs.law]], float)


def check_spring(spring: Spring) -> None:
    """Raise ValueError if the parameters of a spring are not valid."""
    if not (spring.stiffness > 0 and np.isfinite(spring.stiffness)):
        raise ValueError(f"stiffness = {spring.stiffness} was given: use a positive, finite number [1/length]")
    if not (spring.damping >= 0 and np.isfinite(spring.damping)):
        raise ValueError(f"damping = {spring.damping} was given: use 0 (quasi-static) or a positive, finite number")


def _build_history(rs, spring, time, place, out, normal, start) -> SlipHistory:
    """Compute all columns from ln(V/V0) and ln(V0 θ/D_c); slip follows from the balance of spring and friction."""
    w, f = out.T
    velocity, friction = rs.v0 * np.exp(w), rs.mu0 + rs.a * w + rs.b * f
    w0, f0, n0 = start
    force = n0 * (rs.mu0 + rs.a * w0 + rs.b * f0) + spring.damping * rs.v0 * np.exp(w0)
    slip = place - (normal * friction + spring.damping * velocity - force) / spring.stiffness
    return SlipHistory(time, place, slip, velocity, rs.dc / rs.v0 * np.exp(f), friction, normal)


def _times_within(times, end: float) -> np.ndarray:
    times = np.atleast_1d(np.asarray(times, float))
    if len(times) > 1:
        check_times(times)
    slack = 1e-9 * end
    if times[0] < 0 or not times[-1] <= end + slack:
        raise ValueError(f"times go from {times[0]:g} to {times[-1]:g}: use times within the legs, 0 to {end:g}")
    return np.minimum(times, end)


def _default_times(duration, ends) -> np.ndarray:
    share = np.unique(np.r_[np.geomspace(EARLY, 1.0, POINTS), np.linspace(0, 1, POINTS + 1)[1:]])
    each = [end - d + d * share for d, end in zip(duration, ends, strict=True)]
    return np.unique(np.r_[0.0, np.concatenate(each)])


@checked
def prescribed(rs: RateState, time, velocity, *, theta: float | None = None) -> SlipHistory:
    """Friction of a surface with prescribed, piecewise constant slip velocity.

    Exact for each piece of constant V: aging law θ = D_c/V + (θ₀ − D_c/V) e^{−Vt/D_c}, or θ₀ + t for V = 0; slip law
    ln(Vθ/D_c) ∝ e^{−Vt/D_c}, or θ = θ₀ for V = 0, where friction is −∞ and returned as NaN.

    Parameters
    ----------
    time : (N + 1,) edges of the pieces, increasing [time]
    velocity : (N,) velocity of each piece, not negative [length/time]
    theta : state at time[0]; default: the steady state of the first piece

    Returns
    -------
    SlipHistory
        at the N ends of the pieces; `load_point` is the slip.
    """
    check(rs)
    time, velocity = np.asarray(time, float), np.asarray(velocity, float)
    check_times(time)
    if velocity.shape != (len(time) - 1,):
        raise ValueError(f"velocity has shape {velocity.shape} for {len(time)} times: give {len(time) - 1} pieces")
    if not (np.isfinite(velocity).all() and (velocity >= 0).all()):
        worst = velocity[np.flatnonzero(~(velocity >= 0))[:1]]
        raise ValueError(f"a slip velocity of {worst} was given: use finite velocities that are not negative")
    if theta is None and velocity[0] == 0:
        raise ValueError("slip starts with velocity 0, where no state is steady: give theta")
    start = rs.dc / velocity[0] if theta is None else theta
    f = kernel.state_history(np.log(rs.v0 * start / rs.dc), np.diff(time), velocity, rs.v0, rs.dc, LAWS[rs.law])
    slip = np.cumsum(np.diff(time) * velocity)
    moves = velocity > 0
    w = np.where(moves, np.log(np.where(moves, velocity, 1.0) / rs.v0), np.nan)
    theta_at = rs.dc / rs.v0 * np.exp(f)
    friction = rs.mu0 + rs.a * w + rs.b * f
    return SlipHistory(
        time[1:], slip, slip, velocity, theta_at, friction, np.ones(len(slip)), End.DONE, float(time[-1])
    )
