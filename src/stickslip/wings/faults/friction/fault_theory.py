"""Lengths that decide whether slip on a fault is stable, and how long an earthquake takes to nucleate."""

from typing import NamedTuple

import numpy as np

from ....kit import checked, readable, require_positive
from .fault import SEISMIC, Fault, check_fault

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
    velocities, a and b are A = a/(1 + V/V1) and B = b/(1 + V/V2) at the velocity of sliding, see `Fault.sliding_at`.

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

    1.3774 L_b for a/b < 0.3781, where zones keep this length while they accelerate, otherwise the length L_b/[π (1 −
    a/b)²] towards which they grow (Rubin and Ampuero 2005, doi:10.1029/2005JB003686, equations 13 and 31), but no less
    than the former. With the slip law, zones become shorter as they accelerate (Ampuero and Rubin 2008,
    doi:10.1029/2007JB005082). With cut-off velocities, a and b are A = a/(1 + V/V1) and B = b/(1 + V/V2) at the slip
    velocity of the zone, see `Fault.sliding_at`.

    Examples
    --------
    >>> print(round(nucleation_half_length(32.04e9, 0.010, 0.015, 8e-3, 50e6), 1))
    979.1
    """
    require_positive(modulus=modulus, a=a, dc=dc, normal=normal)
    return _half_length(modulus, a, b, dc, dc, normal)


def _half_length(modulus: float, a: float, b: float, fast: float, mean: float, normal: float) -> float:
    """Half-length of the nucleation zone. With two states, b is the sum of both effects.

    The characteristic slip is `fast` = b/(b1/D_1 + b2/D_2) at the tip of a rupture, where friction falls at the rate of
    both states, and `mean` = (b1 D_1 + b2 D_2)/b in the fracture energy, from which the long zones follow.
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
    """Whether earthquakes can nucleate on a fault. Lengths are the least over its velocity-weakening cells [m]."""

    possible: bool
    weakening: float  # length of the longest velocity-weakening part [m]
    cohesive_length: float
    half_length: float  # of a nucleation zone
    sentence: str


@checked
def nucleation(fault: Fault, velocity: float | None = None) -> Nucleation:
    """Compare the velocity-weakening part of a fault with the length that an earthquake needs to nucleate.

    The comparison is a guide: it uses the length of nucleation zones in an infinite body, and counts a zone at the free
    surface as half of one. With two states, for which no theory was published, it is a rough one: the shortest zone
    counts of those with both states and with each alone.

    With cut-off velocities, the effects are A = a/(1 + V/V1) and B = b/(1 + V/V2), those of steady sliding at the given
    velocity. Whether slip at other velocities up to 1 m/s weakens or strengthens instead is part of the sentence:
    earthquakes then also depend on disturbances of the plate motion, and slip may stay slow. Zones far above V1 become
    shorter than with constant effects, 0.579 L_b instead of 1.3774 L_b, as without a direct effect (K. Uenishi and
    J. R. Rice 2003, doi:10.1029/2001JB001681).

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
    """Lengths of a fault without cut-off velocities."""
    weak = fault.a < fault.evolution
    if not weak.any():
        return _Lengths(0.0)
    edges = np.flatnonzero(np.diff(np.r_[0, weak.astype(int), 0]))
    spans = (edges[1::2] - edges[::2]) * fault.cell
    if fault.boundary == "surface" and weak[0]:
        spans[0] *= 2  # with its image
    cohesive = float((fault.modulus / (fault.weakening * fault.normal)[weak]).min())
    return _Lengths(float(spans.max()), cohesive, _shortest_half_length(fault, weak))


def _sentence_with_cuts(fault: Fault, velocity: float, slow: _Lengths, strengthens: str) -> str:
    """Sentence on steady slip at V, and on what changes on the way to 1 m/s."""
    place, fast = f" at {velocity:.3g} m/s", _lengths(fault.sliding_at(max(SEISMIC, velocity)))
    if slow.longest == fast.longest == 0:
        ends = f"from {velocity:.3g} to {SEISMIC:g} m/s"
        return f"no earthquake can nucleate: the fault is velocity-strengthening everywhere at all velocities {ends}"
    if slow.longest == 0:
        sentence = f"the fault is velocity-strengthening ({strengthens} with the cut-offs) everywhere{place}"
    else:
        sentence = slow.ratio(place)
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
    """Least half-length of the nucleation zones of velocity-weakening cells, for a fault without cut-offs."""
    b, slip = fault.evolution[weak], (fault.b * fault.dc + fault.b2 * np.asarray(fault.dc2))[weak]
    rows = np.stack([fault.a[weak], b, b / fault.weakening[weak], slip / b, fault.normal[weak]])
    half = min(_half_length(fault.modulus, *row) for row in np.unique(rows.T, axis=0).tolist())
    if fault.states > 1:  # at slips shorter than its characteristic one, a state stays as it is
        first = fault.a, fault.b, fault.dc, fault.normal
        second = fault.a, *np.broadcast_arrays(fault.b2, fault.dc2, fault.normal)
        for rows in (np.stack(first), np.stack(second)):
            alone = np.unique(rows[:, rows[0] < rows[1]].T, axis=0).tolist()
            half = min([half, *(nucleation_half_length(fault.modulus, *row) for row in alone)])
    return half


def _transition(fault: Fault, of) -> float:
    """Least or greatest velocity at which a cell turns between weakening and strengthening.

    A = B at V = (B0 − a)/(a/V2 − B0/V1), with B0 = b + b2.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        values = (fault.evolution - fault.a) / (fault.a / fault.v2 - fault.evolution / fault.v1)
    return float(of(values[np.isfinite(values) & (values > 0)]))
