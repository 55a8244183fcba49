"""Contact laws, each written once as scalar functions; kernels do the vector algebra.

A law is an integer `kind`, an integer `coulomb` and a table of parameters by pair of materials. The scalar functions
take real or complex arguments (they branch on the real part), so that their tangents come from the same source by a
complex step: f'(x) = Im f(x + ih)/h, exact to round-off because nothing is subtracted.
"""

from numbers import Real
from typing import NamedTuple

import numpy as np
from numba import njit

from ..readable import readable
from .dispatch import Kind, by_kind, known

HERTZ_MINDLIN, LINEAR, HERTZ_MINDLIN_REFF, HERTZ_MINDLIN_RESCALED, HERTZ_MINDLIN_REFF_RESCALED = range(5)
KINDS = ("hertz_mindlin", "linear", "hertz_mindlin_reff", "hertz_mindlin_rescaled", "hertz_mindlin_reff_rescaled")
SHARP, SMOOTH = 0, 1
COULOMB = {"sharp": SHARP, "smooth": SMOOTH}
VELOCITY, MASS, VISCOELASTIC = 1, 2, 3
DAMPING = {"velocity": VELOCITY, "mass_velocity": MASS, "viscoelastic": VISCOELASTIC}
NO_TENSION = 4  # added to the model of damping where dashpots must not make a contact pull
PARAMETERS = ("kn", "kt", "mu", "damping_n", "damping_t")
KN, KT, MU, DAMPING_N, DAMPING_T = range(5)

STEP = 1e-60  # step of the complex derivative: its square vanishes in double precision


@readable(head=lambda law: _describe(law))
class Law(NamedTuple):
    """A contact law with its parameters."""

    kind: int
    coulomb: int
    table: np.ndarray  # (materials, materials, parameters), symmetric in the first two
    damping: int = VELOCITY  # what the dashpots' coefficients multiply, plus NO_TENSION


def hertz_mindlin(
    kn=1.0, kt=2 / 7, mu=0.5, *, coulomb="sharp", damping="velocity", damping_n=0.0, damping_t=0.0, tension=True,
    rescaled=False,
) -> Law:  # fmt: skip
    """F_n = k_n δ^{3/2} − c_n v_n; F_t = −k_t √δ s − c_t v_t, truncated at |F_t| = μ max(F_n, 0).

    The model force of the papers, without R_eff. With `coulomb="smooth"`, F_t = −k_t √δ (1 + x − x²) s with
    x = |s|/s*, s* = μ (k_n/k_t) δ, whose derivative vanishes at the limit.

    Parameters
    ----------
    kn, kt : float [force/length^{3/2}]
    mu : float, not negative
    coulomb : "sharp" or "smooth"
    damping : what `damping_n` and `damping_t` (γ, not negative) are multiplied with to give c_n and c_t
        [force time/length]: "velocity", nothing; "mass_velocity", the effective mass m_eff = m_i m_j/(m_i + m_j);
        "viscoelastic", m_eff and the contact's radius √(δ R_eff), R_eff = R_i R_j/(R_i + R_j). Walls and what `Control`
        does not let move count as infinitely heavy, walls as flat.
    tension : False clips F_n at zero where the dashpot would make the contact pull
    rescaled : True shortens the slip as the contact's radius √(δ R_eff) shrinks, ds = (s/2δ) dδ where dδ < 0; as the
        overlap grows nothing happens. Over an increment s ← f s before it turns, f = √(δ/δ_old), and grows by (1 + f)/2
        of its displacement (by all of it with `slip_update="rate"`). Forces are only directionally differentiable where
        the memory was committed; tangents there are those of a growing overlap

    Source
    ------
    Charan et al., doi:10.48550/arXiv.1908.11724, Eqs 1, 3, 5; rescaling: LAMMPS, `pair_style granular` with
    `tangential mindlin_rescale`.

    Examples
    --------
    >>> law = hertz_mindlin(kn=1.0, mu=0.5)
    >>> float(normal_force(law.kind, parameters(law.table, 0, 0), 1.0, 0.01))
    0.001
    """
    kind = HERTZ_MINDLIN_RESCALED if rescaled else HERTZ_MINDLIN
    return _make_law(kind, coulomb, damping, tension, kn, kt, mu, damping_n, damping_t)


def linear(
    kn=1.0, kt=2 / 7, mu=0.5, *, coulomb="sharp", damping="velocity", damping_n=0.0, damping_t=0.0, tension=True
) -> Law:
    """F_n = k_n δ − c_n v_n; F_t = −k_t s − c_t v_t, truncated at |F_t| = μ max(F_n, 0).

    Smooth friction is that of `hertz_mindlin`.

    Parameters are those of `hertz_mindlin`, with k_n, k_t in [force/length]. With `damping="mass_velocity"` it is the
    law of LAMMPS `gran/hooke/history`.

    Source
    ------
    Cundall & Strack, doi:10.1680/geot.1979.29.1.47.
    """
    return _make_law(LINEAR, coulomb, damping, tension, kn, kt, mu, damping_n, damping_t)


def hertz_mindlin_reff(
    kn=1.0, kt=2 / 7, mu=0.5, *, coulomb="sharp", damping="viscoelastic", damping_n=0.0, damping_t=0.0, tension=True,
    rescaled=False,
) -> Law:  # fmt: skip
    """F_n = p (k_n δ − m_eff γ_n v_n); F_t = −p (k_t s + m_eff γ_t v_t), p = √(δ R_eff).

    |F_t| ≤ μ max(F_n, 0); run with `slip_update="rate"` μ |F_n|, as LAMMPS `gran/hertz/history` has it; with
    `rescaled=True` the law of `granular hertz` with `damping viscoelastic tangential mindlin_rescale`.

    Parameters are those of `hertz_mindlin`, with k_n, k_t in [force/length²] and γ in [1/(time length)];
    `elastic_constants` gives k_n and k_t of elastic grains.

    Source
    ------
    Silbert et al., doi:10.1103/PhysRevE.64.051302, Eqs 2–3; Zhang & Makse, doi:10.1103/PhysRevE.72.011301.
    """
    kind = HERTZ_MINDLIN_REFF_RESCALED if rescaled else HERTZ_MINDLIN_REFF
    return _make_law(kind, coulomb, damping, tension, kn, kt, mu, damping_n, damping_t)


def elastic_constants(young: float, poisson: float) -> tuple[float, float]:
    """k_n = (2/3) E/(1 − ν²) and k_t = 2E/((1 + ν)(2 − ν)) of `hertz_mindlin_reff` for alike elastic grains.

    Parameters
    ----------
    young : float, positive [force/length²]
    poisson : float, above −1 and at most 1/2

    Source
    ------
    Mindlin & Deresiewicz, doi:10.1115/1.4010702, in the form that the supplement of paper 003 (fault gouge) gives.

    Examples
    --------
    >>> [f"{k:.4g}" for k in elastic_constants(50e9, 0.3)]
    ['3.663e+10', '4.525e+10']
    """
    if not (np.isfinite(young) and young > 0 and -1 < poisson <= 0.5):
        raise ValueError(
            f"young = {young}, poisson = {poisson} were given: E must be positive and ν between −1 and 1/2"
        )
    return 2 / 3 * young / (1 - poisson**2), 2 * young / ((1 + poisson) * (2 - poisson))


MAX_PARAMETER = 1e100  # parameters are squared, and multiplied with each other


def _make_law(kind, coulomb, damping, tension, *values) -> Law:
    if not isinstance(coulomb, str) or coulomb not in COULOMB:
        raise ValueError(f"coulomb={coulomb!r} was given: 'sharp' and 'smooth' are allowed")
    if not isinstance(damping, str) or damping not in DAMPING:
        raise ValueError(f"damping={damping!r} was given: {', '.join(map(repr, DAMPING))} are allowed")
    for name, value in zip(PARAMETERS, values, strict=True):
        check_parameter(name, value)
    table = np.array(values, float)[None, None, :].copy()
    return Law(kind, COULOMB[coulomb], table, DAMPING[damping] + (0 if tension else NO_TENSION))


def dashpots(law: Law) -> int:
    """The law's model of damping, 0 if no pair of materials has any: an integer, as kernels are cached by it."""
    return law.damping if law.table[..., [DAMPING_N, DAMPING_T]].any() else 0


def check_parameter(name, value, names=PARAMETERS):
    """Raise ValueError with one sentence if a law has no such parameter, or it no such value."""
    if name not in names:
        raise ValueError(f"a law has no parameter {name!r}: it has {', '.join(names)}")
    if not isinstance(value, Real) and not (np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu"):
        raise ValueError(f"{name} = {value!r} was given: it must be a number")
    low_ok = value > 0 if name == "kn" else value >= 0 or name not in PARAMETERS
    if not (np.isfinite(value) and low_ok):
        raise ValueError(
            f"{name} = {value} was given: it must be finite and {'positive' if name == 'kn' else 'not negative'}"
        )
    if abs(float(value)) > MAX_PARAMETER or (name == "kn" and value < 1 / MAX_PARAMETER):
        raise ValueError(
            f"{name} = {value:g} was given: beyond {MAX_PARAMETER:g}, or below {1 / MAX_PARAMETER:g}, its square is no number; "
            f"take other units"
        )


def for_pair(law: Law, a: int, b: int, **parameters) -> Law:
    """The same law with other parameters between materials `a` and `b`; new materials start as copies of material 0.

    Examples
    --------
    >>> law = for_pair(hertz_mindlin(mu=0.5), 0, 1, mu=0.2)   # grains are material 0, walls material 1
    >>> [float(law.table[0, m, MU]) for m in (0, 1)]
    [0.5, 0.2]
    """
    names = names_of(law)
    size = max(len(law.table), a + 1, b + 1)
    table = np.empty((size, size, len(names)))
    table[:] = law.table[0, 0]
    old = len(law.table)
    table[:old, :old] = law.table
    for name, value in parameters.items():
        check_parameter(name, value, names)
        table[a, b, names.index(name)] = table[b, a, names.index(name)] = value
    return law._replace(table=table)


def alike(a: Law, b: Law) -> bool:
    """True if two laws are the same in kind and parameters."""
    return a[:2] == b[:2] and a.damping == b.damping and np.array_equal(a.table, b.table)


def with_values(law: Law, **parameters) -> Law:
    """The same law with other parameters between all materials."""
    names, table = names_of(law), law.table.copy()
    for name, value in parameters.items():
        check_parameter(name, value, names)
        table[..., names.index(name)] = value
    return law._replace(table=table)


@njit(cache=True, fastmath=True, error_model="numpy")
def parameters(p, a, b):
    """Row of a built-in law's table for a pair of materials, as scalars."""
    return p[a, b, KN], p[a, b, KT], p[a, b, MU], p[a, b, DAMPING_N], p[a, b, DAMPING_T]


@by_kind
def row(kind, p, a, b):
    """Row of the law's table for a pair of materials, as scalars."""
    return parameters(p, a, b)


@by_kind
def uses_radius(kind):
    """True if the law's functions ask for R_eff."""
    return kind in (HERTZ_MINDLIN_REFF, HERTZ_MINDLIN_REFF_RESCALED)


@by_kind
def rescales(kind):
    """True if a falling overlap shortens the slip: see `hertz_mindlin`."""
    return kind in (HERTZ_MINDLIN_RESCALED, HERTZ_MINDLIN_REFF_RESCALED)


def rescaling_flag(kind: int) -> bool | None:
    """True of laws that rescale, None of others: of None Numba leaves branches out before anything is optimised.

    Kernels of all other laws are so to the bit what they would be without rescaled ones.
    """
    return True if rescales(kind) else None


@by_kind
def acts_across_gaps(kind):
    """True if grains may act on each other across a gap."""
    return False


@by_kind
def reach(kind, q, r_eff):
    """Largest gap across which grains act on each other [length]."""
    return 0.0


@by_kind
def normal_force(kind, q, r_eff, overlap):
    """Elastic normal force [force], positive for repulsion; q from `parameters`, overlap > 0."""
    if kind in (HERTZ_MINDLIN, HERTZ_MINDLIN_RESCALED):
        return q[KN] * overlap * np.sqrt(overlap)
    if kind in (HERTZ_MINDLIN_REFF, HERTZ_MINDLIN_REFF_RESCALED):
        return q[KN] * overlap * np.sqrt(overlap * r_eff)
    return q[KN] * overlap


@by_kind
def normal_energy(kind, q, r_eff, overlap):
    """Work done against the elastic normal force [energy]; overlap > 0."""
    power = 2.0 if kind == LINEAR else 2.5
    return normal_force(kind, q, r_eff, overlap) * overlap / power


@by_kind
def tangential_stiffness(kind, q, r_eff, overlap):
    """Stiffness of the unmobilised tangential spring [force/length]; overlap > 0."""
    if kind in (HERTZ_MINDLIN, HERTZ_MINDLIN_RESCALED):
        return q[KT] * np.sqrt(overlap)
    if kind in (HERTZ_MINDLIN_REFF, HERTZ_MINDLIN_REFF_RESCALED):
        return q[KT] * np.sqrt(overlap * r_eff)
    return q[KT] + 0.0 * overlap


@by_kind
def cap(kind, q, r_eff, overlap, fn):
    """Largest tangential force of a contact with normal force fn [force], not negative."""
    return q[MU] * max(fn, 0.0)


@by_kind
def cap_slopes(kind, q, r_eff, overlap, fn):
    """d(cap)/d(fn) and d(cap)/d(overlap), taken where fn > 0."""
    return q[MU], 0.0


@by_kind
def least_force(kind, elastic):
    """Normal force below which a dashpot may not pull where the law knows no tension: bridges pull by themselves."""
    return 0.0


@by_kind
def masked(kind, touches, value):
    """Zero where a pair is out of reach: built-in laws end there with zero anyway."""
    return value


@njit(cache=True, fastmath=True, error_model="numpy")
def contact_damping(kind, viscous, r_eff, m_eff, overlap):
    """What the coefficients of the dashpots are multiplied with; they act only where grains touch."""
    if acts_across_gaps(kind) and overlap <= 0.0:
        return 0.0
    return damping_factor(viscous, r_eff, m_eff, overlap)


@njit(cache=True, fastmath=True, error_model="numpy")
def damping_factor(viscous, r_eff, m_eff, overlap):
    """What the coefficients of the dashpots are multiplied with; see `hertz_mindlin`."""
    model = viscous & 3
    if model == VISCOELASTIC:
        return m_eff * np.sqrt(overlap * r_eff)
    if model == MASS:
        return m_eff + 0.0 * overlap
    return 1.0 + 0.0 * overlap


@njit(cache=True, fastmath=True, error_model="numpy")
def mobilisation(coulomb, x):
    """Factor on the tangential stiffness of a spring whose force k_t |s| is the share x of Coulomb's limit."""
    if coulomb == SMOOTH:
        return 1.0 + x - x * x
    return 1.0 + 0.0 * x


@njit(cache=True, fastmath=True, error_model="numpy")
def tangents(kind, q, r_eff, overlap):
    """d(normal force)/d(overlap) and d(tangential stiffness)/d(overlap), by a complex step."""
    z = complex(overlap, STEP)
    return normal_force(kind, q, r_eff, z).imag / STEP, tangential_stiffness(kind, q, r_eff, z).imag / STEP


@njit(cache=True, fastmath=True, error_model="numpy")
def mobilisation_tangent(coulomb, x):
    """d(mobilised)/dx, by a complex step."""
    return mobilisation(coulomb, complex(x, STEP)).imag / STEP


def complex_step_slopes(function):
    """Derivatives of f(kind, q, r_eff, overlap, fn) with respect to fn and overlap, by a complex step."""

    @njit(fastmath=True, error_model="numpy")
    def slopes(kind, q, r_eff, overlap, fn):
        by_force = function(kind, q, r_eff, overlap, complex(fn, STEP))
        return by_force.imag / STEP, function(kind, q, r_eff, complex(overlap, STEP), fn).imag / STEP

    return slopes


_GAUSS = tuple(zip(*np.polynomial.legendre.leggauss(8), strict=True))


def energy_by_quadrature(force, reach):
    """∫F dδ from −reach to the overlap, by Gauss's rule: over √δ where grains touch, over δ in the gap."""

    @njit(fastmath=True, error_model="numpy")
    def energy(kind, q, r_eff, overlap):
        end, total = -reach(kind, q, r_eff), 0.0
        root, gap = np.sqrt(max(overlap, 0.0)), min(overlap, 0.0) - end
        for place, weight in _GAUSS:
            t, x = 0.5 * root * (1.0 + place), end + 0.5 * gap * (1.0 + place)
            total += 0.5 * weight * root * 2.0 * t * force(kind, q, r_eff, t * t)
            total += 0.5 * weight * gap * force(kind, q, r_eff, x)
        return total

    return energy


def names_of(law: Law) -> tuple[str, ...]:
    """Names of a law's parameters, in the order of its table."""
    if not isinstance(law.kind, Kind):
        return PARAMETERS
    return known(law.kind).names


def _describe(law: Law) -> str:
    kind = KINDS[law.kind] if 0 <= law.kind < len(KINDS) else "a law by the user"
    materials = f"{len(law.table)} materials" if len(law.table) > 1 else "1 material"
    first = law.table[0, 0]
    numbers = f", kn = {first[KN]:.6g}, kt = {first[KT]:.6g}, mu = {first[MU]:.6g}" if len(law.table) == 1 else ""
    return f"{kind}, {'smooth' if law.coulomb == SMOOTH else 'sharp'} Coulomb, {materials}{numbers}"
