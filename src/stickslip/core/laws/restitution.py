"""Dashpots whose parameter is a coefficient of restitution.

A contact with F_n = k δ^p and c_n = α √(m_eff k δ^{p−1}) is a damped linear oscillator of δ^{(p+1)/2}, so that the
restitution of a head-on collision depends neither on size nor on speed, only on D = α/√(2(p + 1)).
"""

from functools import lru_cache
from math import cos, cosh, exp, hypot, log, pi, tan, tanh

import numpy as np

from ...builtin_laws import BUILTIN_LAWS
from ..arguments import checked
from .builtin import DAMPING_N, DAMPING_T, NO_TENSION, RESTITUTION, TSUJI, Law
from .kinds import Kind

HALVINGS = 60  # of the interval in which D is sought, down to round-off
_TSUJI = 1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218


@checked
def dashpot_coefficients(law: Law) -> np.ndarray:
    """Coefficients that factors of the damping model convert to c_n and c_t, (materials, materials, 2).

    With coeff_restitution these are α = √5 D of Hertzian contacts and 2 D of linear ones. If the contact may attract
    as it opens, ln e = −π D/√(1 − D²). With `tension=False` it opens where F_n = 0, and ln e is
    −2 D arccos(D)/√(1 − D²), or −2 D arcosh(D)/√(D² − 1) beyond D = 1. Both are exact for k δ and k δ^{3/2}. With tsuji
    α is a polynomial of e that was fitted to Hertzian contacts that may attract. With the other models these are
    `damping_n` and `damping_t`.

    Source
    ------
    Antypov & Elliott, doi:10.1209/0295-5075/94/50004; Schwager & Pöschel, doi:10.1007/s10035-007-0065-z, for contacts
    that do not attract; Tsuji et al., doi:10.1016/0032-5910(92)88030-L, whose polynomial is Eq 53 of Marshall, J.
    Comput. Phys. 228 (2009) 1541, times √2 for the effective mass; LAMMPS, `pair_style granular`.

    Examples
    --------
    >>> from stickslip import laws
    >>> law = laws.hertz_mindlin(damping="coeff_restitution", damping_n=0.5)
    >>> dashpot_coefficients(law)[0, 0].round(4).tolist()
    [0.4818, 0.0]
    """
    model, given = law.damping & ~NO_TENSION, law.table[..., [DAMPING_N, DAMPING_T]]
    if model not in (TSUJI, RESTITUTION):
        return given
    e = given[..., 0]
    if model == TSUJI:
        alpha = np.maximum(np.sqrt(2) * np.polynomial.Polynomial(_TSUJI)(e), 0.0)
    else:
        values, places = np.unique(e, return_inverse=True)
        ratios = [damping_ratio(value, tension=not law.damping & NO_TENSION) if value else 0.0 for value in values]
        alpha = critical_coefficient(law.kind) * np.array(ratios)[places].reshape(e.shape)
    alpha = np.where(e > 0, alpha, 0.0)
    return np.stack([alpha, given[..., 1] * alpha], axis=-1)


def critical_coefficient(kind: int) -> float:
    """α of critical damping, √(2(p + 1)); that of Hertzian contacts for a user's law."""
    power = 1.5 if isinstance(kind, Kind) else BUILTIN_LAWS[kind].exponent
    return float(np.sqrt(2 * (power + 1)))


@lru_cache
def damping_ratio(restitution: float, *, tension: bool) -> float:
    """D of a head-on collision with a coefficient of restitution above 0."""
    lost = -log(restitution)
    if tension:
        return lost / hypot(pi, lost)
    if not lost:
        return 0.0
    low, high = -pi / 2, lost / 2
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if _lost_by_opening(middle) > lost else (middle, high)
    return cos(low) if low < 0 else cosh(low)


def restitution_of(ratio: float, *, tension: bool) -> float:
    """Coefficient of restitution of a head-on collision with D; 0 if contacts that may attract never open."""
    if tension:
        return exp(-pi * ratio / np.sqrt(1 - ratio**2)) if ratio < 1 else 0.0
    return exp(-_lost_by_opening(-float(np.arccos(ratio)) if ratio < 1 else float(np.arccosh(ratio))))


def _lost_by_opening(angle: float) -> float:
    """−ln e of a contact that opens where F_n = 0; D is cos `angle` if this is negative, else cosh `angle`."""
    return 2 * angle / (tan(angle) if angle < 0 else tanh(angle)) if angle else 2.0
