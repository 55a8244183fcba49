"""Rate-and-state friction: a spring slider under any load, its stability, and friction at a given slip velocity.

μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c), where the state θ follows the aging law (Dieterich 1979,
doi:10.1029/JB084iB05p02161) or the slip law (Ruina 1983, doi:10.1029/JB088iB12p10359). Variants: a second state
variable, cut-off velocities, and a form that is regular at rest.

Rows (w, s, s2) contain w = ln(V/V0), s = ln(V0 θ/D_c), and s2 for a second state θ2 with D_c2. Rows (a, b, b2, mu0,
cut, cut2) contain the parameters of a surface: cut = V0/V1 and cut2 = V0/V2, with the cut-off velocities V1 of the
direct and V2 of the evolution effect; b2 = 0 with one state. The laws are in `_core/rate_state.h`. `python -m
benchmarks rate_state` compares the speed of the integrator with that of LSODA.
"""

from collections.abc import Iterable
from enum import Enum
from typing import Literal, NamedTuple

import numpy as np

from ....kit import Selfcheck, Series, check_types, checked, core, readable
from .loads import LoadStep, check_times, leg_arrays, slide_hold_slide
from .ranges import Bounded, NotNegative, NotNegativeSeries, Positive, Tolerance, Unbounded

EvolutionLaw = Literal["aging", "slip"]
Form = Literal["logarithmic", "regularized"]
EVOLUTIONS = {"aging": 0, "slip": 1}
REFERENCES = {"aging": ("Dieterich1979", "Ruina1983"), "slip": ("Ruina1983",)}  # keys of references.bib
FORMS = {"logarithmic": 0, "regularized": 1}
CUT_OFF = 2


def form_code(form: str, cut: float, cut2: float) -> int:
    """Code of a form of the law in the compiled core; the law with cut-off velocities has a separate code."""
    return CUT_OFF if cut > 0 or cut2 > 0 else FORMS[form]


def friction(form: int, logs, surface) -> np.ndarray:
    """Friction coefficients (N,) of rows (w, s, s2); `surface` is one row of parameters, or one per row of `logs`."""
    return _evaluate(form, logs, surface, 0)


def slopes(form: int, logs, surface) -> np.ndarray:
    """Derivatives (N, 3) of the friction coefficient with respect to w, s and s2."""
    return _evaluate(form, logs, surface, 1)


def curvatures(form: int, logs, surface) -> np.ndarray:
    """Second derivatives (N, 6) of the friction coefficient, in the order ww, ws, ws2, ss, ss2, s2s2."""
    return _evaluate(form, logs, surface, 2)


def _evaluate(form: int, logs, surface, order: int) -> np.ndarray:
    logs, surfaces = np.array(logs, float, order="C", ndmin=2), np.array(surface, float, order="C", ndmin=2)
    out = np.empty((len(logs), (1, 3, 6)[order]))
    results = [out if k == order else None for k in range(3)]
    core.friction_of_rows(form, len(logs), logs, surfaces, len(surfaces), *results)
    return out if order else out[:, 0]


DONE = 0  # code of a complete history; other codes follow the order of `End`


class Slider(NamedTuple):
    """Parameters of a surface and its spring, in the units of `RateState` and `Spring`."""

    a: float
    b: float
    b2: float
    mu0: float
    cut: float  # V0/V1
    cut2: float  # V0/V2
    dc: float
    dc2: float
    v0: float
    alpha: float
    stiffness: float
    damping: float
    form: int
    evolution: int

    def friction(self, logs) -> np.ndarray:
        """Friction coefficients (N,) of rows (w, s, s2)."""
        return friction(self.form, logs, self[:6])


def build_slider(values: dict, law: str, form: str) -> Slider:
    """Build a slider from named values: a, b, b2, mu0, v1, v2, dc, dc2, v0, alpha, stiffness and damping."""
    cuts = {"cut": values["v0"] / values["v1"], "cut2": values["v0"] / values["v2"]}
    codes = {"form": form_code(form, *cuts.values()), "evolution": EVOLUTIONS[law]}
    given = {name: values[name] for name in Slider._fields if name in values}
    return Slider(**{**given, **cuts, **codes})


def history(slider: Slider, start, legs: np.ndarray, times: np.ndarray, tolerance: float):
    """Integrate w, s and s2 from their values `start` to the ascending `times`, counted from the start of the legs.

    Parameters
    ----------
    legs : (3, L), see `loads.leg_arrays`

    Returns
    -------
    tuple
        rows (w, s, s2) at the N times, NaN after a failure; code of the end; time reached. Where two legs meet, a row
        has the values at the end of the first.
    """
    out, reached = np.full((len(times), 3), np.nan), np.zeros(1)
    code = core.slider_history(slider, *start, legs, legs.shape[1], times, len(times), tolerance, out, reached)
    return out, code, float(reached[0])


def rates(slider: Slider, logs, velocity: float, normal: float) -> tuple[np.ndarray, np.ndarray]:
    """Time derivatives (3,) of w, s and s2, and their Jacobian (3, 3); the derivatives of s2 are 0 if b2 = 0.

    Parameters
    ----------
    velocity : velocity of the load point
    normal : normal stress over its reference value
    """
    out, jacobian = np.empty(3), np.empty((3, 3))
    core.slider_rates(slider, np.array(logs, float), velocity, normal, out, jacobian)
    return out, jacobian


def state_history(start: float, duration, velocity, v0: float, dc: float, law: str) -> np.ndarray:
    """Exact ln(V0 θ/D_c) at the ends of intervals of constant slip velocity; `start` is its initial value."""
    duration, velocity = np.ascontiguousarray(duration, float), np.ascontiguousarray(velocity, float)
    out = np.empty(len(duration))
    core.state_history(EVOLUTIONS[law], start, len(out), duration, velocity, v0, dc, out)
    return out


EARLY, POINTS = 1e-5, 60  # default times in a leg: the first, over its duration; the number on each grid (log, linear)


@readable
class RateState(NamedTuple):
    """Rate-and-state parameters of a surface.

    μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c); aging law θ' = 1 − Vθ/D_c, slip law θ' = −(Vθ/D_c) ln(Vθ/D_c). If the normal
    stress σ changes, −(α/b) θ σ'/σ is added to θ' in both laws (Linker and Dieterich 1992, doi:10.1029/92JB00017).

    If b2 > 0, the term b2 ln(V0 θ2/D_c2) of a second state with the same evolution law is added (Ruina 1983; Gu et al.
    1984, doi:10.1016/0022-5096(84)90007-3); changes of σ then act on both states, with the factor α/(b + b2). With
    cut-off velocities, a ln(V/V0) becomes −a ln(V0/V + V0/V1) and b ln(V0 θ/D_c) becomes b ln(V0 θ/D_c + V0/V2): the
    direct effect saturates above V1, the evolution effect above V2 (Okubo 1989, doi:10.1029/JB094iB09p12321). The
    regularized form is a arcsinh[V/(2 V0) exp((μ0 + b ln(V0 θ/D_c))/a)], which is 0 at rest (Rice, Lapusta and Ranjith
    2001, doi:10.1016/S0022-5096(01)00042-4).

    Examples
    --------
    >>> RateState(0.0247, 0.0178, 5.3e-3, law="slip").alpha
    0.0
    """

    a: Positive
    b: NotNegative
    dc: Positive  # [length]
    mu0: Bounded = 0.6
    v0: Positive = 1e-6  # velocity at which steady friction is mu0 [length/time]
    law: EvolutionLaw = "aging"
    alpha: NotNegative = 0.0
    form: Form = "logarithmic"
    b2: NotNegative = 0.0  # evolution effect of a second state
    dc2: Positive = 1.0  # characteristic slip of the second state; has no effect if b2 = 0 [length]
    v1: Unbounded = np.inf  # cut-off velocity of the direct effect [length/time]
    v2: Unbounded = np.inf  # cut-off velocity of the evolution effect [length/time]

    def check_entries(self) -> None:
        """Raise an error if an entry, or a combination of entries, is not allowed."""
        check_types(self)
        check_variant(self, self.b + self.b2)


def check_variant(surface, evolution) -> None:
    """Raise ValueError if cut-off velocities or alpha do not agree with the form and the evolution effects."""
    if surface.form == "regularized" and not np.isinf([surface.v1, surface.v2]).all():
        raise ValueError("cut-off velocities require the logarithmic form, not the regularized one")
    if surface.alpha > 0 and not np.all(evolution > 0):
        raise ValueError(f"alpha = {surface.alpha} requires b > 0, because normal stress acts on the state")


@readable
class Spring(NamedTuple):
    """Spring that drives the slider: n μ = k (x_lp − x) − η V, where n is the normal stress over a reference value."""

    stiffness: Positive  # k: stress per displacement, divided by the reference normal stress [1/length]
    damping: NotNegative = 0.0  # η: radiation damping over the reference normal stress; 0: quasi-static [time/length]

    check_entries = check_types


class End(Enum):
    """Reason for the end of a history; its value is a sentence."""

    DONE = "the history reached its end"
    RUNAWAY = "slip ran away, as it does below the critical stiffness: use a stiffer spring, or damping > 0"
    STEPS_SPENT = "the integration used up its steps between two samples: loosen the tolerance, or request more samples"


@readable
class SlipHistory(NamedTuple):
    """History of a slider at N times; if the integration fails, it ends at the last time reached."""

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


@checked
def spring_slider(
    rs: RateState,
    spring: Spring,
    legs: Iterable[LoadStep],
    *,
    times: Series | None = None,
    before: float | None = None,
    theta: Positive | None = None,
    tolerance: Tolerance = 1e-10,
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
    tolerance : tolerated error of ln V and ln θ per step

    Returns
    -------
    SlipHistory
        Runaway slip is not an error; see `SlipHistory.end`.

    Examples
    --------
    >>> from stickslip import friction
    >>> rs = friction.RateState(0.010, 0.015, 1e-5, law="slip")
    >>> legs = (friction.LoadStep(10.0, 1e-6), friction.LoadStep(100.0, 1e-5))
    >>> h = friction.spring_slider(rs, friction.Spring(1e5), legs)
    >>> print(round(h.friction[-1] - h.friction[0], 6))  # (a − b) ln 10
    -0.011513
    """
    arrays = leg_arrays(legs)
    duration, velocity, normal = arrays
    start = float(velocity[0]) if before is None else before
    if not (start > 0 and np.isfinite(start)):
        raise ValueError(f"slip starts at the velocity {start}: give `before`, the positive slip velocity at the start")
    ends = np.cumsum(duration)
    if times is None:
        share = np.unique(np.r_[np.geomspace(EARLY, 1.0, POINTS), np.linspace(0, 1, POINTS + 1)[1:]])
        each = [end - d + d * share for d, end in zip(duration, ends, strict=True)]
        times = np.unique(np.r_[0.0, np.concatenate(each)])
    else:
        times = _times_within(times, ends[-1])
    w, f = np.log(start / rs.v0), np.log(rs.v0 * (theta or rs.dc / start) / rs.dc)
    slider = slider_of(rs, spring)
    out, code, reached = history(slider, (w, f, f), arrays, times, tolerance)
    kept = ~np.isnan(out[:, 0])
    factor = normal[np.minimum(np.searchsorted(ends, times[kept]), len(ends) - 1)]
    displacement = np.interp(times[kept], np.r_[0.0, ends], np.r_[0.0, np.cumsum(duration * velocity)])
    rows = np.vstack([(w, f, f), out[kept]])
    displacement, factor, at = np.r_[0.0, displacement], np.r_[normal[0], factor], np.r_[0.0, times[kept]]
    speed, mu = rs.v0 * np.exp(rows[:, 0]), slider.friction(rows)
    force = factor[0] * mu[0] + spring.damping * speed[0]
    # slip follows from the balance of spring force and friction
    slip = displacement - (factor * mu + spring.damping * speed - force) / spring.stiffness
    columns = at, displacement, slip, speed, rs.dc / rs.v0 * np.exp(rows[:, 1]), mu, factor
    return SlipHistory(*(c[1:] for c in columns), tuple(End)[code], reached, _second_state(rs, rows[1:, 2]))


def slider_of(rs: RateState, spring: Spring) -> Slider:
    """Build the slider of a surface and a spring."""
    return build_slider({**rs._asdict(), **spring._asdict()}, rs.law, rs.form)


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


@checked
def prescribed(
    rs: RateState, time: Series, velocity: NotNegativeSeries, *, theta: Positive | None = None
) -> SlipHistory:
    """Friction of a surface under a prescribed, piecewise constant slip velocity.

    The state is exact in each piece of constant V. With the aging law, θ = D_c/V + (θ₀ − D_c/V) e^{−Vt/D_c}, or θ₀ + t
    for V = 0. With the slip law, ln(Vθ/D_c) ∝ e^{−Vt/D_c}, or θ = θ₀ for V = 0. At rest, friction is −∞ in the
    logarithmic form (returned as NaN), and 0 in the regularized form.

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
    time, velocity = np.asarray(time, float), np.asarray(velocity, float)
    check_times(time)
    if velocity.shape != (len(time) - 1,):
        raise ValueError(f"velocity has shape {velocity.shape} for {len(time)} times: give {len(time) - 1} velocities")
    if theta is None and velocity[0] == 0:
        raise ValueError("slip starts with velocity 0, where no state is steady: give theta")
    start = rs.dc / velocity[0] if theta is None else theta
    first = np.log(rs.v0 * start / rs.dc)
    f, g = (state_history(first, np.diff(time), velocity, rs.v0, dc, rs.law) for dc in (rs.dc, rs.dc2))
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
    """Friction coefficient at a slip velocity and a state, computed with NumPy."""
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
    v = np.asarray(velocity, float)
    w, b = np.log(v / rs.v0), rs.b + rs.b2
    if rs.form == "regularized":
        return rs.a * np.arcsinh(v / (2 * rs.v0) * np.exp((rs.mu0 - b * w) / rs.a))
    return rs.mu0 + (rs.a - b) * w - rs.a * np.log1p(v / rs.v1) + b * np.log1p(v / rs.v2)


@readable
class Sliding(NamedTuple):
    """Stability of steady sliding at one velocity against small disturbances."""

    stable: bool
    critical: float  # stiffness below which sliding is unstable; not positive if sliding is always stable [1/length]
    eigenvalues: np.ndarray  # (2,) complex, (3,) with two states; a disturbance is a sum of terms e^{λt} [1/time]
    growth_rate: float  # largest real part; negative if disturbances decay [1/time]
    frequency: float  # angular frequency; 0 if disturbances do not oscillate [1/time]
    sentence: str


@checked
def critical_stiffness(rs: RateState, velocity: NotNegative = 0.0, damping: NotNegative = 0.0) -> float:
    """Critical stiffness k_c per unit normal stress: steady sliding is unstable if and only if k < k_c.

    With one state, k_c = (B − A − η V)/D_c for both evolution laws (Ruina 1983, doi:10.1029/JB088iB12p10359; Rice and
    Ruina 1983, doi:10.1115/1.3167042), where A = ∂μ/∂ln V and B = ∂μ/∂ln θ in steady sliding at V; for the usual law
    A = a and B = b. Radiation damping η adds η V to A. With two states, k_c is the larger root of the quadratic
    equation from Hurwitz's criterion for the cubic characteristic polynomial (compare Gu et al. 1984,
    doi:10.1016/0022-5096(84)90007-3), and −∞ if its roots are not real.

    Parameters
    ----------
    velocity : V, relevant only with damping, cut-off velocities or the regularized form; 0: use the slopes at v0
        [length/time]
    damping : η over the normal stress [time/length]

    Examples
    --------
    >>> print(round(critical_stiffness(RateState(0.010, 0.015, 1e-5)), 6))
    500.0
    """
    direct, slope, slope2 = steady_slopes(rs, velocity or rs.v0)
    direct += damping * velocity
    if rs.b2 == 0:
        return (slope - direct) / rs.dc
    first, second = rs.dc, rs.dc2
    # coefficients of the cubic in λ/V: M D D2, D D2 k + p, (D + D2) k + q, k
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
def steady_sliding(rs: RateState, spring: Spring, velocity: Positive) -> Sliding:
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


def selfchecks() -> dict[str, Selfcheck]:
    """Check the friction of the slip law right after a hold, with the parameters of Ferdowsi and Rubin (2021)."""
    surface = RateState(a=0.0247, b=0.0178, dc=5.3e-3, mu0=0.4, v0=0.02, law="slip")
    legs = slide_hold_slide([1.0], velocity=0.02, distance=0.05)
    history = spring_slider(surface, Spring(200.0), legs, times=np.linspace(0, 5, 51))
    measured = float(history.friction.min())
    return {
        "rate and state, after a hold": Selfcheck(measured, 0.27764026555526716, 1e-6, "tolerance of the integrator")
    }
