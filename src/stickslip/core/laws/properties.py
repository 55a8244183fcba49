"""Properties that any contact law can have: lever arms, memory of forces, rolling, twisting, restitution.

Where dashpots are given by a coefficient of restitution, a contact with F_n = k δ^p and
c_n = α √(m_eff k δ^{p−1}) is a damped linear oscillator in δ^{(p+1)/2}. The restitution of a head-on collision then
depends neither on size nor on speed, only on D = α/√(2(p + 1)).
"""

from functools import lru_cache
from math import cos, cosh, exp, hypot, log, pi, tan, tanh
from typing import Annotated

import numpy as np

from ...builtin_laws import BUILTIN_LAWS
from ..arguments import checked, one_of
from .builtin import (
    DAMPING_N,
    DAMPING_T,
    KEEPS_FORCE,
    KT,
    LEVER,
    MOMENTS,
    MU,
    NO_TENSION,
    RESTITUTION,
    ROLLING,
    SCALED,
    TSUJI,
    TWISTING,
    VISCOUS,
    Law,
    check_parameter,
    marshall_values,
    parameter_names,
)
from .kinds import USER_LAWS, Kind, own_memory

ARMS = {"radius": 0, "overlap": LEVER}
MEMORIES = {"slip": 0, "force": KEEPS_FORCE}
# columns of `Contacts.rolling`: ψ; angle_i − angle_j at its commit; 1 if ψ was at its cap; with twisting, also the
# twist, and 1 if it was at its cap
COLUMNS, TWISTED = 7, 2
TWISTINGS = "spring", "marshall"
MODELS = {"constant": ("mu_roll", "gamma_roll"), "viscous": ("gamma_roll",), "spring": ("k_roll", "mu_roll")}


@checked
def with_lever(law: Law, arm: Annotated[str, one_of(*ARMS)]) -> Law:
    """Law with chosen lever arms of the tangential force, T_i = −a_i n × F_t.

    The surfaces move relative to each other with v_t = P v − (a_i ω_i + a_j ω_j) × n. With a_i = R_i − δ/2, the arms of
    two grains add up to their distance, so that contacts conserve angular momentum, and two grains that rotate as one
    body do not slip.

    Parameters
    ----------
    arm : "radius" (a_i = R_i, as in the papers and in LAMMPS `gran/hooke/history`) or "overlap" (a_i = R_i − δ/2
        between grains, R_i at walls). LAMMPS `pair_style granular` uses R_i − δ/2 for torques but R_i for the slip,
        and so does a run with `slip_update="rate"`

    Source
    ------
    LAMMPS, `GranularModel::calculate_forces`; Luding, doi:10.1007/s10035-008-0099-x, Eqs 5–8.

    Examples
    --------
    >>> import stickslip as ss
    >>> ss.laws.with_lever(ss.laws.linear(mu=0.5), "overlap")
    Law: linear, sharp Coulomb, kn = 1, kt = 0.285714, mu = 0.5, lever arms R - δ/2
    """
    return law._replace(properties=law.properties & ~LEVER | ARMS[arm])


@checked
def with_memory(law: Law, of: Annotated[str, one_of(*MEMORIES)]) -> Law:
    """Law whose contact memory is the slip s, or the force of the tangential spring.

    With slip as memory, F_t = −k_t(δ) s changes with the overlap. With force as memory, dF_t = −k_t(δ) ds: a
    sticking contact keeps F_t as its overlap changes, and `Contacts.slip` holds −F_t/k_t. With `rescaled=True`, F_t
    also shrinks with k_t where the overlap decreases. Under a built-in law whose k_t is constant, both are the same,
    and the law is returned unchanged.

    Parameters
    ----------
    of : "slip" (as in the papers and in LAMMPS `mindlin` and `mindlin_rescale`) or "force" (as in LAMMPS
        `mindlin/force` and `mindlin_rescale/force`)

    Source
    ------
    Thornton, Cummins & Cleary, doi:10.1016/j.powtec.2012.08.012, Eq 18.

    Examples
    --------
    >>> import stickslip as ss
    >>> ss.laws.with_memory(ss.laws.hertz_mindlin(1, 1, 1), "force")
    Law: hertz_mindlin, sharp Coulomb, kn = 1, kt = 1, mu = 1, memory of forces
    """
    constant = not isinstance(law.kind, Kind) and BUILTIN_LAWS[law.kind].exponent == 1
    return law._replace(properties=law.properties & ~KEEPS_FORCE | (0 if constant else MEMORIES[of]))


@checked
def with_rolling(
    law: Law, model: Annotated[str, one_of(*MODELS)] = "spring", *, k_roll: float = 0.0, mu_roll: float = 0.0,
    gamma_roll: float = 0.0,
) -> Law:  # fmt: skip
    """Law with a moment that resists rolling, M_i = −M_j, perpendicular to the normal.

    Rolling is the relative rotation ω = ω_i − ω_j without its part along the normal; common rotation is not resisted.
    P is the Coulomb limit divided by μ (by default max(F_n, 0); zero if μ is zero):

        constant  M = −min(γ R_eff² |ω|, μ_r R_eff P) ω/|ω|
        viscous   M = −γ P R_eff² ω
        spring    M = −k R_eff² ψ − γ R_eff² ω, |k R_eff² ψ| ≤ μ_r R_eff P and |M| ≤ μ_r R_eff P, dψ/dt = ω

    These are types A, B and C of Ai et al. Type A is regularised by its dashpot: the moment is constant once
    |ω| > μ_r P/(γ R_eff). The first two exert no moment at rest, so that static solutions do not depend on them.
    `spring` is LAMMPS `rolling sds`.

    Parameters
    ----------
    model : "constant", "viscous" or "spring"
    k_roll : k [force/length]
    mu_roll : μ_r [1]
    gamma_roll : γ [force time/length], or [time/length] for a viscous moment

    Source
    ------
    Ai et al., doi:10.1016/j.powtec.2010.09.030; pseudo-force: Luding, doi:10.1007/s10035-008-0099-x; rolling velocity:
    Wang et al., Particuology 23 (2015) 49, as in LAMMPS.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.with_rolling(ss.laws.linear(), k_roll=0.5, mu_roll=0.1)
    >>> law.table[0, 0, 5:].tolist()
    [0.5, 0.1, 0.0]
    """
    values = {"k_roll": k_roll, "mu_roll": mu_roll, "gamma_roll": gamma_roll}
    for name, value in values.items():
        needed = name in MODELS[model]
        if (needed and not value > 0) or (value and not needed and (model, name) != ("spring", "gamma_roll")):
            need = "must be positive" if needed else "does not apply: leave it out, or use another model"
            raise ValueError(f"with model = {model!r}, {name} {need}, got {value}")
    if resists_rolling(law._replace(properties=0)):
        raise ValueError("the law already has a rolling moment: use one without it")
    new = _with_parameters(law, ROLLING, values)
    return new._replace(properties=new.properties & ~VISCOUS | (VISCOUS if model == "viscous" else 0))


@checked
def with_twisting(
    law: Law, model: Annotated[str, one_of(*TWISTINGS)] = "spring", *, k_twist: float = 0.0, mu_twist: float = 0.0,
    gamma_twist: float = 0.0,
) -> Law:  # fmt: skip
    """Law with a moment along the normal that resists twisting.

    The twist τ is the relative rotation about the normal since the contact closed, and ω_n is its rate; P is as in
    `with_rolling`, a is the contact radius, and c_t is the tangential dashpot constant:

        spring    M = −k τ − γ ω_n, |k τ| and |M| ≤ μ_t P
        marshall  M = −½ k_t a² τ − ½ c_t a² ω_n, |½ k_t a² τ| and |M| ≤ ⅔ a μ P

    These are LAMMPS `twisting sds` and `twisting marshall`. With `marshall`, k_t is the parameter `kt`, as in LAMMPS;
    Marshall multiplies the k_t of Hertzian contacts by a. The coefficients ½ k_t, ⅔ μ and ½ become parameters of the
    law for each pair of materials. In two dimensions, there is no twisting.

    Parameters
    ----------
    model : "spring" or "marshall", which needs no further parameters
    k_twist : k, positive [force length]
    mu_twist : μ_t [length]
    gamma_twist : γ [force length time]

    Source
    ------
    Marshall, J. Comput. Phys. 228 (2009) 1541; Luding, doi:10.1007/s10035-008-0099-x.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.with_twisting(ss.laws.linear(), k_twist=0.1, mu_twist=0.02)
    >>> law.table[0, 0, 5:].tolist()
    [0.1, 0.02, 0.0]
    """
    values = {"k_twist": k_twist, "mu_twist": mu_twist, "gamma_twist": gamma_twist}
    if model == "spring":
        if not k_twist > 0:
            raise ValueError(f"k_twist must be positive, got {k_twist}")
        new = _with_parameters(law, TWISTING, values)
        return new._replace(properties=new.properties & ~SCALED)
    if any(values.values()):
        raise ValueError(f"with model = {model!r}, the twisting parameters follow from kt and mu: omit them")
    new = _with_parameters(law, TWISTING, values)
    table, names = new.table.copy(), parameter_names(new)
    for name, column in marshall_values(table[..., KT], table[..., MU]).items():
        table[..., names.index(name)] = column
    return new._replace(table=table, properties=new.properties | SCALED)


def _with_parameters(law: Law, part: int, values: dict[str, float]) -> Law:
    """Law with a property whose parameters are the same for all pairs of materials."""
    new = law._replace(properties=law.properties | part)
    names, former = parameter_names(new), parameter_names(law)
    if not law.properties & part and {*values} & {*former}:
        raise ValueError(f"the law already has a parameter {min({*values} & {*former})}: rename it")
    table = np.zeros((*law.table.shape[:2], len(names)))
    table[..., [names.index(name) for name in former]] = law.table
    for name, value in values.items():
        check_parameter(name, value, names)
        table[..., names.index(name)] = value
    return new._replace(table=table)


def resists_rolling(law: Law) -> bool:
    """Return True if a law has moments that resist rolling or twisting."""
    own = USER_LAWS[law.kind].functions if isinstance(law.kind, Kind) and law.kind in USER_LAWS else {}
    return bool(law.properties & sum(MOMENTS)) or "rolling_stiffness" in own


def remembers_more(law: Law) -> bool:
    """Return True if contacts resist rotations, keep their force, or have additional memory."""
    return resists_rolling(law) or bool(own_memory(law.kind) or law.properties & KEEPS_FORCE)


def angular_columns(law: Law) -> int:
    """Number of columns of `Contacts.rolling` for rotations; those of additional memory follow."""
    twisted = TWISTED if law.properties & TWISTING else 0
    return COLUMNS + twisted if resists_rolling(law) or law.properties & LEVER else 0


HALVINGS = 60  # number of bisections of the interval in which D is sought, enough to reach round-off
_TSUJI = 1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218


@checked
def dashpot_coefficients(law: Law) -> np.ndarray:
    """Coefficients that the factors of the damping model convert to c_n and c_t, (materials, materials, 2).

    With coeff_restitution, these are α = √5 D for Hertzian contacts and 2 D for linear ones. If the contact may attract
    as it opens, ln e = −π D/√(1 − D²). With `tension=False`, it opens where F_n = 0, and ln e is
    −2 D arccos(D)/√(1 − D²), or −2 D arcosh(D)/√(D² − 1) beyond D = 1. Both are exact for k δ and k δ^{3/2}. With
    tsuji, α is a polynomial in e that was fitted to Hertzian contacts that may attract. With the other models, these
    are `damping_n` and `damping_t`.

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
    """α of critical damping, √(2(p + 1)); for a user-defined law, the value for Hertzian contacts."""
    power = 1.5 if isinstance(kind, Kind) else BUILTIN_LAWS[kind].exponent
    return float(np.sqrt(2 * (power + 1)))


@lru_cache
def damping_ratio(restitution: float, *, tension: bool) -> float:
    """Damping ratio D of a head-on collision with a coefficient of restitution above 0."""
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
    """Coefficient of restitution at a damping ratio D; 0 if contacts that may attract never open."""
    if tension:
        return exp(-pi * ratio / np.sqrt(1 - ratio**2)) if ratio < 1 else 0.0
    return exp(-_lost_by_opening(-float(np.arccos(ratio)) if ratio < 1 else float(np.arccosh(ratio))))


def _lost_by_opening(angle: float) -> float:
    """−ln e of a contact that opens where F_n = 0, with D = cos(angle) for negative angles, else D = cosh(angle)."""
    return 2 * angle / (tan(angle) if angle < 0 else tanh(angle)) if angle else 2.0
