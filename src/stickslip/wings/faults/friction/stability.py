"""Stability of steady sliding, on a spring and on a fault: critical stiffness, eigenvalues, lengths, nucleation."""

from typing import NamedTuple

import numpy as np

from ....kit import checked, readable, require_positive
from .fault import SEISMIC, Fault, check_fault
from .laws import rates, slopes
from .ratestate import RateState, Spring, check, check_spring, slider_of


@readable
class Sliding(NamedTuple):
    """Stability of steady sliding at one velocity against small disturbances."""

    stable: bool
    critical: float  # stiffness below which it is unstable; not positive if it is always stable [1/length]
    eigenvalues: np.ndarray  # (2,) complex, (3,) with two states; a disturbance is a sum of terms e^{λt} [1/time]
    growth_rate: float  # largest real part; negative if disturbances decay [1/time]
    frequency: float  # angular, 0 without oscillation [1/time]
    sentence: str


@checked
def critical_stiffness(rs: RateState, velocity: float = 0.0, damping: float = 0.0) -> float:
    """Critical stiffness k_c per unit normal stress: steady sliding is unstable if and only if k < k_c.

    With one state, k_c = (B − A − η V)/D_c for both evolution laws (Ruina 1983, doi:10.1029/JB088iB12p10359; Rice and
    Ruina 1983, doi:10.1115/1.3167042), where A = ∂μ/∂ln V and B = ∂μ/∂ln θ in steady sliding at V; for the usual law
    A = a and B = b. Radiation damping η adds η V to A. With two states, k_c is the larger root of the quadratic
    equation from Hurwitz's criterion for the cubic characteristic polynomial (compare Gu et al. 1984,
    doi:10.1016/0022-5096(84)90007-3), and −∞ if there is none.

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
    check(rs)
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
        raise ValueError(f"velocity must be positive and finite for steady sliding, got {velocity}")
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


LOCALIZED = 0.3781  # a/b below which nucleation zones have a fixed length
FIXED = 1.3774  # half-length of such zones, over L_b


@checked
def cohesive_length(modulus: float, b: float, dc: float, normal: float) -> float:
    """Length L_b = G D_c/(b σ) over which stress drops behind the tip of a rupture.

    Rubin and Ampuero 2005, doi:10.1029/2005JB003686, equation 7. For in-plane shear, G is divided by 1 − ν.

    Examples
    --------
    >>> print(round(cohesive_length(32.04e9, 0.015, 8e-3, 50e6), 1))
    341.8
    """
    require_positive(modulus=modulus, b=b, dc=dc, normal=normal)
    return modulus * dc / (b * normal)


@checked
def critical_wavelength(modulus: float, a: float, b: float, dc: float, normal: float) -> float:
    """Wavelength 2π/k above which steady slip of an infinite fault is unstable; infinite if a ≥ b.

    The stiffness G k/2 of a sinusoid then equals the critical stiffness (b − a) σ/D_c of `critical_stiffness`, hence
    π G D_c/[(b − a) σ], for both laws (J. R. Rice and A. L. Ruina 1983, doi:10.1115/1.3167042). With cut-off
    velocities, a and b are A = a/(1 + V/V1) and B = b/(1 + V/V2) at the velocity of sliding (see `Fault.sliding_at`).

    Examples
    --------
    >>> print(round(critical_wavelength(32.04e9, 0.010, 0.015, 8e-3, 50e6), 1))
    3221.0
    """
    require_positive(modulus=modulus, a=a, dc=dc, normal=normal)
    return np.pi * modulus * dc / ((b - a) * normal) if b > a else np.inf


@checked
def nucleation_half_length(modulus: float, a: float, b: float, dc: float, normal: float) -> float:
    """Half-length of the nucleation zone of the aging law; infinite if a ≥ b.

    For a/b < 0.3781 it is 1.3774 L_b, and zones keep this length while they accelerate. Otherwise it is the length
    L_b/[π (1 − a/b)²] towards which they grow, if that is larger (Rubin and Ampuero 2005, doi:10.1029/2005JB003686,
    equations 13 and 31). With the slip law, zones become shorter as they accelerate (Ampuero and Rubin 2008,
    doi:10.1029/2007JB005082). With cut-off velocities, a and b are A = a/(1 + V/V1) and B = b/(1 + V/V2) at the slip
    velocity of the zone (see `Fault.sliding_at`).

    Examples
    --------
    >>> print(round(nucleation_half_length(32.04e9, 0.010, 0.015, 8e-3, 50e6), 1))
    979.1
    """
    require_positive(modulus=modulus, a=a, dc=dc, normal=normal)
    return _half_length(modulus, a, b, dc, dc, normal)


def _half_length(modulus: float, a: float, b: float, fast: float, mean: float, normal: float) -> float:
    """Half-length of the nucleation zone. With two states, b is the sum of both evolution effects.

    The characteristic slip is `fast` = b/(b1/D_1 + b2/D_2) at a rupture tip, where friction falls at the combined rate
    of both states. It is `mean` = (b1 D_1 + b2 D_2)/b in the fracture energy, which determines long zones.
    """
    if a >= b:
        return np.inf
    ratio = a / b
    short = FIXED * cohesive_length(modulus, b, fast, normal)
    if ratio < LOCALIZED:
        return short
    return max(short, cohesive_length(modulus, b, mean, normal) / (np.pi * (1 - ratio) ** 2))


@readable
class Nucleation(NamedTuple):
    """Possibility of earthquake nucleation on a fault. Lengths are the smallest of all velocity-weakening cells [m]."""

    possible: bool
    weakening: float  # length of the longest velocity-weakening part [m]
    cohesive_length: float
    half_length: float  # half length of a nucleation zone
    sentence: str


@checked
def nucleation(fault: Fault, velocity: float | None = None) -> Nucleation:
    """Compare the velocity-weakening part of a fault with the length required for nucleation of an earthquake.

    The comparison is a guide: it uses the length of nucleation zones in an infinite body, and counts a zone at the free
    surface as half a zone. With two states, for which we know of no published theory, the estimate is rough: it is the
    shortest of three zones, for both states and for each alone.

    With cut-off velocities, the effects are A = a/(1 + V/V1) and B = b/(1 + V/V2), those of steady sliding at the given
    velocity. The sentence also states if the sign of the rate dependence changes at velocities up to 1 m/s: earthquakes
    then also depend on disturbances of the plate motion, and slip may stay slow. Far above V1, zones are shorter than
    with constant effects, 0.579 L_b instead of 1.3774 L_b, as without a direct effect (K. Uenishi and J. R. Rice 2003,
    doi:10.1029/2001JB001681).

    Parameters
    ----------
    velocity : V, relevant only with cut-off velocities; default: the plate rate, or v0 without plate motion [m/s]

    Examples
    --------
    >>> from stickslip import friction
    >>> strong = friction.line_fault(10e3, 100.0, a=0.02, b=0.015, dc=8e-3, normal=50e6)
    >>> print(nucleation(strong).sentence)
    no earthquake can nucleate: the fault is velocity-strengthening (a ≥ b) everywhere
    """
    check_fault(fault)
    velocity = fault.plate_rate or fault.v0 if velocity is None else velocity
    require_positive(velocity=velocity)
    slow, effects = _lengths(fault.sliding_at(velocity)), "b" if fault.states == 1 else "b + b2"
    if any(fault.cuts):
        sentence = _sentence_with_cuts(fault, velocity, slow, f"a ≥ {effects}")
    elif slow.longest == 0:
        sentence = f"no earthquake can nucleate: the fault is velocity-strengthening (a ≥ {effects}) everywhere"
    else:
        sentence = f"{'earthquakes can nucleate' if slow.possible else 'no earthquake is expected'}: {slow.ratio('')}"
    return Nucleation(slow.possible, slow.longest, slow.cohesive, slow.half, sentence)


class _Lengths(NamedTuple):
    longest: float
    cohesive: float = np.inf
    half: float = np.inf

    @property
    def possible(self) -> bool:
        return self.longest > 2 * self.half

    def ratio(self, place: str) -> str:
        zone = 2 * self.half
        return (
            f"its longest velocity-weakening part{place} is {self.longest / zone:.3g} times a nucleation zone of "
            f"{zone:.4g} m"
        )


def _lengths(fault: Fault) -> _Lengths:
    """Lengths for a fault without cut-off velocities."""
    weak = fault.a < fault.evolution
    if not weak.any():
        return _Lengths(0.0)
    edges = np.flatnonzero(np.diff(np.r_[0, weak.astype(int), 0]))
    spans = (edges[1::2] - edges[::2]) * fault.cell
    if fault.boundary == "surface" and weak[0]:
        spans[0] *= 2  # including its image
    cohesive = float((fault.modulus / (fault.weakening * fault.normal)[weak]).min())
    return _Lengths(float(spans.max()), cohesive, _shortest_half_length(fault, weak))


def _sentence_with_cuts(fault: Fault, velocity: float, slow: _Lengths, strengthens: str) -> str:
    """Sentence on steady slip at V, and on the change of its stability up to 1 m/s."""
    location, fast = f" at {velocity:.3g} m/s", _lengths(fault.sliding_at(max(SEISMIC, velocity)))
    if slow.longest == fast.longest == 0:
        ends = f"from {velocity:.3g} to {SEISMIC:g} m/s"
        return f"no earthquake can nucleate: the fault is velocity-strengthening everywhere at all velocities {ends}"
    if slow.longest == 0:
        sentence = f"the fault is velocity-strengthening ({strengthens} with the cut-offs) everywhere{location}"
    else:
        sentence = slow.ratio(location)
    if slow.possible:
        slows = "" if fast.longest else f"; slip above {_transition(fault, max):.3g} m/s strengthens and may stay slow"
        return f"earthquakes can nucleate: {sentence}{slows}"
    sentence = f"no earthquake is expected from steady slip: {sentence}"
    if not fast.possible:
        return sentence
    above = "" if slow.longest else f" weakens above {_transition(fault, min):.3g} m/s, and"
    zone = f"slip{above} has a zone of {2 * fast.half:.4g} m at {SEISMIC:g} m/s"
    return f"{sentence}; {zone}: a disturbance can make it an earthquake"


def _shortest_half_length(fault: Fault, weak: np.ndarray) -> float:
    """Smallest half-length of the nucleation zones of velocity-weakening cells, for a fault without cut-offs."""
    b, slip = fault.evolution[weak], (fault.b * fault.dc + fault.b2 * np.asarray(fault.dc2))[weak]
    rows = np.stack([fault.a[weak], b, b / fault.weakening[weak], slip / b, fault.normal[weak]])
    half = min(_half_length(fault.modulus, *row) for row in np.unique(rows.T, axis=0).tolist())
    if fault.states > 1:  # a state hardly changes during slip shorter than its characteristic slip
        first = fault.a, fault.b, fault.dc, fault.normal
        second = fault.a, *np.broadcast_arrays(fault.b2, fault.dc2, fault.normal)
        for rows in (np.stack(first), np.stack(second)):
            alone = np.unique(rows[:, rows[0] < rows[1]].T, axis=0).tolist()
            half = min([half, *(nucleation_half_length(fault.modulus, *row) for row in alone)])
    return half


def _transition(fault: Fault, of) -> float:
    """Smallest or largest velocity at which a cell changes between weakening and strengthening.

    A = B at V = (B0 − a)/(a/V2 − B0/V1), with B0 = b + b2.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        values = (fault.evolution - fault.a) / (fault.a / fault.v2 - fault.evolution / fault.v1)
    return float(of(values[np.isfinite(values) & (values > 0)]))
