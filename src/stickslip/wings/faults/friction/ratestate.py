"""Rate-and-state friction: a spring-slider under any load history, and friction at a given slip velocity.

μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c), where the state θ follows the aging law (Dieterich 1979,
doi:10.1029/JB084iB05p02161) or the slip law (Ruina 1983, doi:10.1029/JB088iB12p10359). Variants: a second state
variable, cut-off velocities, and a form that is regular at rest.
"""

from collections.abc import Iterable
from enum import Enum
from typing import NamedTuple

import numpy as np

from ....kit import Selfcheck, Series, check_types, checked, readable, require_positive
from . import laws
from .laws import EVOLUTIONS, FORMS
from .loads import LoadStep, check_times, leg_arrays, slide_hold_slide

EARLY, POINTS = 1e-5, 60  # default times of a leg: first, as a fraction, and number on each grid (logarithmic, linear)


@readable
class RateState(NamedTuple):
    """Rate-and-state parameters of a surface.

    μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c); aging law θ' = 1 − Vθ/D_c, slip law θ' = −(Vθ/D_c) ln(Vθ/D_c). If the normal
    stress σ changes, −(α/b) θ σ'/σ is added to both (Linker and Dieterich 1992, doi:10.1029/92JB00017).

    With b2, the term b2 ln(V0 θ2/D_c2) of a second state with the same evolution law is added (Ruina 1983; Gu et al.
    1984, doi:10.1016/0022-5096(84)90007-3); changes of σ then act on both states, with α/(b + b2). With cut-off
    velocities, a ln(V/V0) becomes −a ln(V0/V + V0/V1) and b ln(V0 θ/D_c) becomes b ln(V0 θ/D_c + V0/V2): the direct
    effect ends above V1 and the evolution effect above V2 (Okubo 1989, doi:10.1029/JB094iB09p12321). The regularized
    form is a arcsinh[V/(2 V0) exp((μ0 + b ln(V0 θ/D_c))/a)], which is 0 at rest (Rice, Lapusta and Ranjith 2001,
    doi:10.1016/S0022-5096(01)00042-4).

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
    form: str = "logarithmic"  # or "regularized"
    b2: float = 0.0  # evolution effect of a second state
    dc2: float = 1.0  # its characteristic slip; has no effect if b2 = 0 [length]
    v1: float = np.inf  # cut-off velocity of the direct effect [length/time]
    v2: float = np.inf  # cut-off velocity of the evolution effect [length/time]

    check_entries = check_types


@readable
class Spring(NamedTuple):
    """Spring that drives the slider: n μ = k (x_lp − x) − η V, with n the normal stress over its reference."""

    stiffness: float  # k, stress per displacement over the reference normal stress [1/length]
    damping: float = 0.0  # η, radiation damping over the reference normal stress; 0 is quasi-static [time/length]

    check_entries = check_types


class End(Enum):
    """Reason for the end of a history; each member is a sentence."""

    DONE = "the history reached its end"
    RUNAWAY = "slip ran away, as it does below the critical stiffness: use a stiffer spring, or damping > 0"
    STEPS_SPENT = "the integration used up its steps between two samples: loosen the tolerance, or request more samples"


@readable
class SlipHistory(NamedTuple):
    """History of a slider at N times; after a failure, up to the last time reached."""

    time: np.ndarray  # [time]
    load_point: np.ndarray  # displacement since the start [length]
    slip: np.ndarray  # [length]
    velocity: np.ndarray  # slip velocity [length/time]
    theta: np.ndarray  # [time]
    friction: np.ndarray  # μ(V, θ); the spring force over n is μ + η V/n [1]
    normal: np.ndarray  # normal stress over its reference; at a jump, the value before it
    end: End = End.DONE
    reached: float = 0.0  # time at which the history ended
    theta2: np.ndarray | None = None  # second state, if the surface has one [time]

    @property
    def ok(self) -> bool:
        """Return True if the history is complete."""
        return self.end is End.DONE


def check(rs: RateState) -> None:
    """Raise ValueError if the parameters of a surface are not valid."""
    for name, allowed in (("law", EVOLUTIONS), ("form", FORMS)):
        if getattr(rs, name) not in allowed:
            raise ValueError(f"{name} must be {' or '.join(map(repr, allowed))}, got {getattr(rs, name)!r}")
    for name in ("a", "dc", "v0", "dc2"):
        if not (getattr(rs, name) > 0 and np.isfinite(getattr(rs, name))):
            raise ValueError(f"{name} must be positive and finite, got {getattr(rs, name)}")
    for name in ("v1", "v2"):
        if not getattr(rs, name) > 0:
            raise ValueError(f"{name} must be a positive velocity, or inf for no cut-off, got {getattr(rs, name)}")
    if rs.form == "regularized" and not np.isinf([rs.v1, rs.v2]).all():
        raise ValueError("cut-off velocities require the logarithmic form, not the regularized one")
    for name in ("b", "alpha", "b2"):
        if not (getattr(rs, name) >= 0 and np.isfinite(getattr(rs, name))):
            raise ValueError(f"{name} must be finite and not negative, got {getattr(rs, name)}")
    if not np.isfinite(rs.mu0):
        raise ValueError(f"mu0 must be finite, got {rs.mu0}")
    if rs.alpha > 0 and rs.b + rs.b2 == 0:
        raise ValueError(f"alpha = {rs.alpha} requires b > 0, as normal stress acts on the state")


@checked
def spring_slider(
    rs: RateState,
    spring: Spring,
    legs: Iterable[LoadStep],
    *,
    times: Series | None = None,
    before: float | None = None,
    theta: float | None = None,
    tolerance: float = 1e-10,
) -> SlipHistory:
    """History of a slider pulled by a spring.

    (n A + η V) d ln V/dt = k (V_lp − V) − n B d ln θ/dt, with θ' given by the law, A = ∂μ/∂ln V and B = ∂μ/∂ln θ, which
    are a and b in the usual law. ln V and ln θ are integrated with a stiff method that restarts at every leg. With η =
    0, the motion is quasi-static, and slip may run away below the critical stiffness.

    Parameters
    ----------
    legs : legs of the load point, see `LoadStep`, `velocity_steps`, `slide_hold_slide` and `load_steps`
    times : (N,) ascending, within the legs; default: about 120 per leg, denser at its start [time]
    before : initial slip velocity; default: that of the first leg [length/time]
    theta : initial state; default: the steady state D_c/V. A second state starts at the same ratio to its steady value
        [time]
    tolerance : error of ln V and ln θ in each step

    Raises
    ------
    ValueError
        If parameters, legs or times are not valid. Runaway slip is not an error; see `SlipHistory.end`.

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
    arrays = leg_arrays(legs)
    duration, velocity, normal = arrays
    check_spring(spring)
    require_positive(tolerance=tolerance)
    start = float(velocity[0]) if before is None else before
    if not (start > 0 and np.isfinite(start)):
        raise ValueError(f"slip starts at the velocity {start}: give `before`, the positive slip velocity at the start")
    if theta is not None and not (theta > 0 and np.isfinite(theta)):
        raise ValueError(f"theta must be positive and finite, got {theta}")
    ends = np.cumsum(duration)
    times = _default_times(duration, ends) if times is None else _times_within(times, ends[-1])
    w, f = np.log(start / rs.v0), np.log(rs.v0 * (theta or rs.dc / start) / rs.dc)
    out, code, reached = laws.history(slider_of(rs, spring), (w, f, f), arrays, times, tolerance)
    kept = ~np.isnan(out[:, 0])
    factor = normal[np.minimum(np.searchsorted(ends, times[kept]), len(ends) - 1)]
    displacement = np.interp(times[kept], np.r_[0.0, ends], np.r_[0.0, np.cumsum(duration * velocity)])
    rows = np.vstack([(w, f, f), out[kept]])
    displacement, factor, at = np.r_[0.0, displacement], np.r_[normal[0], factor], np.r_[0.0, times[kept]]
    return _build_history(rs, spring, at, displacement, rows, factor)._replace(end=tuple(End)[code], reached=reached)


def slider_of(rs: RateState, spring: Spring) -> laws.Slider:
    """Build the slider of a surface and a spring."""
    return laws.build_slider({**rs._asdict(), **spring._asdict()}, rs.law, rs.form)


def check_spring(spring: Spring) -> None:
    """Raise ValueError if the parameters of a spring are not valid."""
    if not (spring.stiffness > 0 and np.isfinite(spring.stiffness)):
        raise ValueError(f"stiffness must be positive and finite [1/length], got {spring.stiffness}")
    if not (spring.damping >= 0 and np.isfinite(spring.damping)):
        raise ValueError(f"damping must be 0 (quasi-static) or positive and finite, got {spring.damping}")


def _build_history(rs, spring, time, place, out, normal) -> SlipHistory:
    """Compute all columns from rows of w, ln(V0 θ/D_c) and ln(V0 θ2/D_c2), the first of which is the start.

    Slip follows from the balance of spring force and friction.
    """
    velocity, friction = rs.v0 * np.exp(out[:, 0]), slider_of(rs, spring).friction(out)
    force = normal[0] * friction[0] + spring.damping * velocity[0]
    slip = place - (normal * friction + spring.damping * velocity - force) / spring.stiffness
    columns = time, place, slip, velocity, rs.dc / rs.v0 * np.exp(out[:, 1]), friction, normal
    return SlipHistory(*(column[1:] for column in columns), theta2=_second_state(rs, out[1:, 2]))


def _second_state(rs: RateState, g: np.ndarray) -> np.ndarray | None:
    return rs.dc2 / rs.v0 * np.exp(g) if rs.b2 > 0 else None


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
def prescribed(rs: RateState, time: Series, velocity: Series, *, theta: float | None = None) -> SlipHistory:
    """Friction of a surface under prescribed, piecewise constant slip velocity.

    Exact for each piece of constant V: aging law θ = D_c/V + (θ₀ − D_c/V) e^{−Vt/D_c}, or θ₀ + t for V = 0; slip law
    ln(Vθ/D_c) ∝ e^{−Vt/D_c}, or θ = θ₀ for V = 0. At rest, friction is −∞ in the logarithmic form, returned as NaN, and
    0 in the regularized form.

    Parameters
    ----------
    time : (N + 1,) edges of the pieces, increasing [time]
    velocity : (N,) velocity of each piece, not negative [length/time]
    theta : state at time[0]; default: the steady state of the first piece. A second state starts at the same ratio to
        its steady value

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
        raise ValueError(f"slip velocities must be finite and not negative, got {worst}")
    if theta is None and velocity[0] == 0:
        raise ValueError("slip starts with velocity 0, where no state is steady: give theta")
    start = rs.dc / velocity[0] if theta is None else theta
    first = np.log(rs.v0 * start / rs.dc)
    f, g = (laws.state_history(first, np.diff(time), velocity, rs.v0, dc, rs.law) for dc in (rs.dc, rs.dc2))
    slip = np.cumsum(np.diff(time) * velocity)
    w = np.log(np.where(velocity > 0, velocity, np.nan) / rs.v0)
    mu = slider_of(rs, Spring(1.0)).friction(np.stack([w, f, g], axis=1))
    if rs.form == "regularized":
        mu[velocity == 0] = 0.0
    return SlipHistory(
        time[1:], slip, slip, velocity, rs.dc / rs.v0 * np.exp(f), mu, np.ones(len(slip)), End.DONE, float(time[-1]),
        _second_state(rs, g),
    )  # fmt: skip


def friction_of(rs: RateState, velocity, theta, theta2=None):
    """Friction coefficient at a slip velocity and a state, in NumPy."""
    check(rs)
    v = np.asarray(velocity, float)
    states = [(rs.b, rs.v0 * np.asarray(theta, float) / rs.dc)]
    states += [(rs.b2, rs.v0 * np.asarray(theta2, float) / rs.dc2)] if theta2 is not None else []
    if rs.form == "regularized":
        scale = np.exp((rs.mu0 + sum(b * np.log(s) for b, s in states)) / rs.a)
        return rs.a * np.arcsinh(v / (2 * rs.v0) * scale)
    return rs.mu0 - rs.a * np.log(rs.v0 / v + rs.v0 / rs.v1) + sum(b * np.log(s + rs.v0 / rs.v2) for b, s in states)


def steady_friction(rs: RateState, velocity):
    """Steady friction, with θ_ss = D_c/V: μ0 + (a − b) ln(V/V0) for the usual law.

    Regularized: a arcsinh[V/(2 V0) exp((μ0 − b ln(V/V0))/a)]. With cut-off velocities: μ0 + (a − b) ln(V/V0) − a ln(1 +
    V/V1) + b ln(1 + V/V2). A second state adds b2 to b.

    Examples
    --------
    >>> print(round(steady_friction(RateState(0.0247, 0.0178, 5.3e-3, 0.4, 0.02), 0.2) - 0.4, 5))
    0.01589
    """
    check(rs)
    v = np.asarray(velocity, float)
    w, b = np.log(v / rs.v0), rs.b + rs.b2
    if rs.form == "regularized":
        return rs.a * np.arcsinh(v / (2 * rs.v0) * np.exp((rs.mu0 - b * w) / rs.a))
    return rs.mu0 + (rs.a - b) * w - rs.a * np.log1p(v / rs.v1) + b * np.log1p(v / rs.v2)


def selfchecks() -> dict[str, Selfcheck]:
    """Check friction right after a hold, from the slip law with the parameters of Ferdowsi & Rubin 2021."""
    surface = RateState(a=0.0247, b=0.0178, dc=5.3e-3, mu0=0.4, v0=0.02, law="slip")
    legs = slide_hold_slide([1.0], velocity=0.02, distance=0.05)
    history = spring_slider(surface, Spring(200.0), legs, times=np.linspace(0, 5, 51))
    measured = float(history.friction.min())
    return {
        "rate and state, after a hold": Selfcheck(measured, 0.27764026555526716, 1e-6, "tolerance of the integrator")
    }
