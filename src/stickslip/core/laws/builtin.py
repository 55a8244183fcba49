"""Contact laws: an integer `kind`, an integer `coulomb`, and a table of parameters for each pair of materials.

The kind of a built-in law is its index in the table `builtin_laws`, which also contains its properties. The compiled
core evaluates the law.
"""

from collections.abc import Callable
from functools import partial
from numbers import Integral, Real
from typing import NamedTuple

import numpy as np

from ...builtin_laws import BUILTIN_LAWS, NAMES
from ..arguments import checked
from ..fields import LARGEST, Field, check_entry
from ..readable import readable
from ..text import quoted
from .kinds import USER_LAWS, Kind, check_kind, find_user_law

SHARP, SMOOTH = 0, 1
COULOMB = {"sharp": SHARP, "smooth": SMOOTH}
VELOCITY, MASS, VISCOELASTIC, TSUJI, RESTITUTION = 1, 2, 3, 8, 9
DAMPING = {
    "velocity": VELOCITY, "mass_velocity": MASS, "viscoelastic": VISCOELASTIC, "tsuji": TSUJI,
    "coeff_restitution": RESTITUTION,
}  # fmt: skip
NO_TENSION = 4  # added to the damping model if dashpots must not make a contact attractive
# properties: lever arms between grains are R − δ/2; rolling resistance, whose dashpot may grow with F_n; twisting,
# whose coefficients may be multiples of a²; a memory of tangential forces
LEVER, ROLLING, VISCOUS, TWISTING, SCALED, KEEPS_FORCE = 1, 2, 4, 8, 16, 32
MOMENTS = {  # parameters of properties, with their units and meanings
    ROLLING: {
        "k_roll": ("force/length", "rolling stiffness over R_eff²"), "mu_roll": ("1", "rolling friction"),
        "gamma_roll": ("force time/length", "rolling dashpot over R_eff²"),
    },
    TWISTING: {
        "k_twist": ("force length", "twisting stiffness"), "mu_twist": ("length", "largest twisting moment over F_n"),
        "gamma_twist": ("force length time", "twisting dashpot"),
    },
}  # fmt: skip
PARAMETERS = ("kn", "kt", "mu", "damping_n", "damping_t")
KN, KT, MU, DAMPING_N, DAMPING_T = range(5)

STEP = 2.0**-200  # step of complex derivatives: its square vanishes, and dividing by a power of two is exact


@readable(head=lambda law: _describe(law), rows=lambda law: _rows(law))
class Law(NamedTuple):
    """Contact law with its parameters."""

    kind: int
    coulomb: int
    table: np.ndarray  # (materials, materials, parameters), symmetric in the first two indices
    damping: int = VELOCITY  # model that converts damping coefficients to dashpot constants, possibly plus NO_TENSION
    properties: int = 0  # sum of flags, which are defined in `laws.properties`

    def check_entries(self) -> None:
        """Raise ValueError if compiled code does not know this law."""
        dampings = [model + more for model in DAMPING.values() for more in (0, NO_TENSION)]
        known_values = ("coulomb", COULOMB.values()), ("damping", dampings), ("properties", range(64)), ("kind", None)
        for name, known in known_values:
            value = getattr(self, name)
            if not isinstance(value, Integral) or (known and value not in known):
                raise ValueError(f"law.{name} is {value!r}: create the law with a function in stickslip.laws")
        check_kind(self.kind)
        sizes, names = {"materials": len(np.atleast_1d(self.table))}, parameter_names(self)
        check_entry("law.table", self.table, Field(np.float64, ("materials", "materials", len(names))), sizes)
        for k, name in enumerate(names):
            low = 1 / MAX_PARAMETER if name == "kn" else -LARGEST if name in _names_of_any_sign(self) else 0.0
            check_entry(f"{name} in law.table", self.table[..., k], Field(np.float64, ("materials",) * 2, low), sizes)


@checked
def hertz_mindlin(
    kn=1.0, kt=2 / 7, mu=0.5, *, coulomb="sharp", damping="velocity", damping_n=0.0, damping_t=0.0,
    tension: bool = True, rescaled: bool = False,
) -> Law:  # fmt: skip
    """F_n = k_n δ^{3/2} − c_n v_n; F_t = −k_t √δ s − c_t v_t, truncated at |F_t| = μ max(F_n, 0).

    Force model of the papers, without R_eff. With `coulomb="smooth"`, F_t = −k_t √δ (1 + x − x²) s with
    x = |s|/s*, s* = μ (k_n/k_t) δ; the derivative of F_t vanishes at the limit.

    Parameters
    ----------
    kn, kt : float [force/length^{3/2}]
    mu : float, not negative
    coulomb : "sharp" or "smooth"
    damping : factor that converts `damping_n` and `damping_t` (γ, not negative) to c_n and c_t [force time/length]:
        "velocity", one; "mass_velocity", the effective mass m_eff = m_i m_j/(m_i + m_j); "viscoelastic", m_eff times
        the contact radius √(δ R_eff), R_eff = R_i R_j/(R_i + R_j). Walls and bodies held by `Control` count as
        infinitely heavy, walls also as flat. With "coeff_restitution", `damping_n` is the coefficient of restitution e
        of a head-on collision at any size and speed, with and without `tension` (0: no dashpots), `damping_t` is
        c_t/c_n, and c_n = α(e) √(m_eff F_n/δ), where F_n/δ is that of the spring. "tsuji" is the same with another
        α(e), for which e is only nominal: see the table on the page on contact laws
    tension : False clips F_n at zero where the dashpot would make the contact attractive
    rescaled : True shortens the slip as the contact radius √(δ R_eff) shrinks, ds = (s/2δ) dδ where dδ < 0. A growing
        overlap does not change s. Over an increment, s ← f s with f = √(δ/δ_old) before s is rotated, and s grows by
        (1 + f)/2 of the displacement (by all of it with `slip_update="rate"`). Where the memory was committed, forces
        are only directionally differentiable; tangents there are those for a growing overlap

    Source
    ------
    Charan et al., doi:10.48550/arXiv.1908.11724, Eqs 1, 3, 5; rescaling: LAMMPS, `pair_style granular` with
    `tangential mindlin_rescale`.

    Examples
    --------
    >>> hertz_mindlin(kn=1.0, mu=0.5)
    Law: hertz_mindlin, sharp Coulomb, kn = 1, kt = 0.285714, mu = 0.5
    """
    name = "hertz_mindlin_rescaled" if rescaled else "hertz_mindlin"
    return make_law(name, coulomb, damping, tension, kn, kt, mu, damping_n, damping_t)


@checked
def linear(
    kn=1.0, kt=2 / 7, mu=0.5, *, coulomb="sharp", damping="velocity", damping_n=0.0, damping_t=0.0,
    tension: bool = True,
) -> Law:  # fmt: skip
    """F_n = k_n δ − c_n v_n; F_t = −k_t s − c_t v_t, truncated at |F_t| = μ max(F_n, 0).

    Smooth friction is defined as in `hertz_mindlin`.

    Parameters are those of `hertz_mindlin`, with k_n, k_t in [force/length]. With `damping="mass_velocity"`, this is
    the law of LAMMPS `gran/hooke/history`.

    Source
    ------
    Cundall & Strack, doi:10.1680/geot.1979.29.1.47.
    """
    return make_law("linear", coulomb, damping, tension, kn, kt, mu, damping_n, damping_t)


@checked
def hertz_mindlin_reff(
    kn=1.0, kt=2 / 7, mu=0.5, *, coulomb="sharp", damping="viscoelastic", damping_n=0.0, damping_t=0.0,
    tension: bool = True, rescaled: bool = False,
) -> Law:  # fmt: skip
    """F_n = p (k_n δ − m_eff γ_n v_n); F_t = −p (k_t s + m_eff γ_t v_t), p = √(δ R_eff).

    |F_t| ≤ μ max(F_n, 0). In a run with `slip_update="rate"`, the limit is μ |F_n|, as in LAMMPS `gran/hertz/history`.
    With `rescaled=True`, this is the law of LAMMPS `granular hertz` with `damping viscoelastic tangential
    mindlin_rescale`.

    Parameters are those of `hertz_mindlin`, with k_n, k_t in [force/length²] and γ in [1/(time length)];
    `elastic_constants` gives k_n and k_t of elastic grains.

    Source
    ------
    Silbert et al., doi:10.1103/PhysRevE.64.051302, Eqs 2–3; Zhang & Makse, doi:10.1103/PhysRevE.72.011301.
    """
    name = "hertz_mindlin_reff_rescaled" if rescaled else "hertz_mindlin_reff"
    return make_law(name, coulomb, damping, tension, kn, kt, mu, damping_n, damping_t)


# Laws whose normal force has additional parameters: adhesion, liquid bridges, plasticity. All also have the parameters
# of `hertz_mindlin`, including `coulomb`, `damping` and `tension`. Dashpots act where the overlap is positive, and
# contribute to no cap except that of `walton_braun`. Viscoelastic dashpots of `jkr` use the radius √(δ R_eff), whereas
# those of LAMMPS use a.


@checked
def jkr(
    kn=1.0, kt=2 / 7, mu=0.5, *, work, coulomb="sharp", damping="viscoelastic", damping_n=0.0, damping_t=0.0,
    tension: bool = True,
) -> Law:  # fmt: skip
    """F_n = k_n a³/R_eff − √(6π w k_n a³), δ = a²/R_eff − √(8πwa/(3k_n)); F_t = −k_t a s, |F_t| ≤ μ |F_n + 3πwR_eff|.

    Adhesive elastic spheres. Contacts form at zero gap, attract with at most 1.5 π w R_eff, and pull off at a gap of
    (27 c²/256)^{1/3}/R_eff, c = 8πwR_eff²/(3k_n). Without adhesion, this is `hertz_mindlin_reff`.

    Parameters
    ----------
    kn, kt : float [force/length²], k_n = 4E*/3; see `elastic_constants`
    work : w, work of adhesion, twice the surface energy of LAMMPS `granular jkr` [energy/length²]

    Source
    ------
    Johnson, Kendall & Roberts, doi:10.1098/rspa.1971.0141; closed form of a: Parteli et al., doi:10.1038/srep06227;
    friction: Thornton, doi:10.1088/0022-3727/24/11/007.

    Examples
    --------
    >>> jkr(kn=1.0, work=1e-3)
    Law: jkr, sharp Coulomb, kn = 1, kt = 0.285714, mu = 0.5, work = 0.001
    """
    return make_law("jkr", coulomb, damping, tension, kn, kt, mu, damping_n, damping_t, work=work)


@checked
def dmt(
    kn=1.0, kt=2 / 7, mu=0.5, *, work, coulomb="sharp", damping="viscoelastic", damping_n=0.0, damping_t=0.0,
    tension: bool = True,
) -> Law:  # fmt: skip
    """F_n = k_n √R_eff δ^{3/2} − 2πwR_eff; F_t = −k_t √(δ R_eff) s, |F_t| ≤ μ |F_n + 4πwR_eff|.

    Small, stiff adhesive spheres: the attraction appears and vanishes at zero overlap, so that energy is conserved
    only to the extent that the time step resolves the jump.

    Parameters
    ----------
    kn, kt : float [force/length²]
    work : w, work of adhesion, twice the surface energy of LAMMPS `granular dmt` [energy/length²]

    Source
    ------
    Derjaguin, Muller & Toporov, doi:10.1016/0021-9797(75)90018-1; friction as in LAMMPS.

    Examples
    --------
    >>> dmt(kn=1.0, work=1e-3)
    Law: dmt, sharp Coulomb, kn = 1, kt = 0.285714, mu = 0.5, work = 0.001
    """
    return make_law("dmt", coulomb, damping, tension, kn, kt, mu, damping_n, damping_t, work=work)


@checked
def walton_braun(
    kn=1.0, kt=2 / 7, mu=0.5, *, k_unload, coulomb="sharp", damping="velocity", damping_n=0.0, damping_t=0.0,
    tension: bool = True,
) -> Law:  # fmt: skip
    """F_n = k_n δ where the overlap is the largest so far, δ_m, else k_u max(δ − (1 − k_n/k_u) δ_m, 0); F_t = −k_t s.

    Plastic contacts with the memory δ_m. Spheres rebound with √(k_n/k_u) of their impact speed.

    Parameters
    ----------
    kn, kt : float [force/length]
    k_unload : k_u, at least k_n [force/length]

    Source
    ------
    Walton & Braun, doi:10.1122/1.549893.

    Examples
    --------
    >>> walton_braun(kn=1.0, k_unload=4.0)
    Law: walton_braun, sharp Coulomb, kn = 1, kt = 0.285714, mu = 0.5, k_unload = 4
    """
    return make_law("walton_braun", coulomb, damping, tension, kn, kt, mu, damping_n, damping_t, k_unload=k_unload)


@checked
def liquid_bridge(
    kn=1.0, kt=2 / 7, mu=0.5, *, surface_tension, volume, coulomb="sharp", damping="viscoelastic", damping_n=0.0,
    damping_t=0.0, tension: bool = True,
) -> Law:  # fmt: skip
    """F_n = k_n √R_eff δ^{3/2} − 4πγR_eff [h(g) − h(V^{1/3})], h(g) = 1 − g/√(g² + V/(πR_eff)), g = max(−δ, 0).

    Wet spheres with a contact angle of zero. Bridges form at zero gap and break at a gap of V^{1/3}; the attraction at
    this gap is subtracted. F_t = −k_t √(δ R_eff) s, at most μ k_n √R_eff δ^{3/2}.

    Parameters
    ----------
    kn, kt : float [force/length²]
    surface_tension : γ [force/length]
    volume : V of a bridge [length³]

    Source
    ------
    Rabinovich, Esayanur & Moudgil, doi:10.1021/la0517639, for spheres of radius 2 R_eff; rupture: Lian, Thornton &
    Adams, doi:10.1006/jcis.1993.1452.

    Examples
    --------
    >>> liquid_bridge(surface_tension=1e-4, volume=1e-3).table[0, 0, 5:].tolist()
    [0.0001, 0.001]
    """
    own = {"surface_tension": surface_tension, "volume": volume}
    return make_law("liquid_bridge", coulomb, damping, tension, kn, kt, mu, damping_n, damping_t, **own)


# constructors by the name of the law; some have an argument `rescaled`
CONSTRUCTORS: dict[str, Callable[..., "Law"]] = {
    law.name: partial(globals()[law.name.removesuffix("_rescaled")], rescaled=True)
    if law.rescales
    else globals()[law.name]
    for law in BUILTIN_LAWS
}


@checked
def elastic_constants(young: float, poisson: float) -> tuple[float, float]:
    """Stiffnesses k_n = (2/3) E/(1 − ν²), k_t = 2E/((1 + ν)(2 − ν)) of `hertz_mindlin_reff` for equal elastic grains.

    Parameters
    ----------
    young : float, positive [force/length²]
    poisson : float, above −1 and at most 1/2

    Source
    ------
    Mindlin & Deresiewicz, doi:10.1115/1.4010702, in the form given by Ferdowsi & Rubin 2021.

    Examples
    --------
    >>> [f"{k:.4g}" for k in elastic_constants(50e9, 0.3)]
    ['3.663e+10', '4.525e+10']
    """
    if not (np.isfinite(young) and young > 0 and -1 < poisson <= 0.5):
        raise ValueError(f"young must be positive and poisson between −1 and 1/2, got {young} and {poisson}")
    return 2 / 3 * young / (1 - poisson**2), 2 * young / ((1 + poisson) * (2 - poisson))


def make_law(law_name, coulomb, damping, tension, *values, **own) -> Law:
    """Law from the values of its parameters; `own` contains parameters that only this law has."""
    if not isinstance(coulomb, str) or coulomb not in COULOMB:
        raise ValueError(f"coulomb must be 'sharp' or 'smooth', got {quoted(coulomb)}")
    if not isinstance(damping, str) or damping not in DAMPING:
        raise ValueError(f"damping must be one of {', '.join(map(repr, DAMPING))}, got {quoted(damping)}")
    for name, value in (*zip(PARAMETERS, values, strict=True), *own.items()):
        check_parameter(name, value, (*PARAMETERS, *own))
    table = np.array([*values, *own.values()], float)[None, None, :].copy()
    law = Law(NAMES.index(law_name), COULOMB[coulomb], table, DAMPING[damping] + (0 if tension else NO_TENSION))
    return _checked_values(law)


def _checked_values(law: Law) -> Law:
    most = law.table[..., DAMPING_N].max()
    if law.damping & ~NO_TENSION in (TSUJI, RESTITUTION) and most > 1:
        raise ValueError(
            "damping_n is the coefficient of restitution in this damping model and must be from 0 (no dashpots) to 1, "
            f"got {most:g}"
        )
    names = parameter_names(law)
    if not isinstance(law.kind, Kind) and "k_unload" in names:
        ratio = (law.table[..., names.index("k_unload")] / law.table[..., KN]).min()
        if ratio < 1:
            raise ValueError(f"k_unload must be at least kn, or contacts create energy, got {ratio:g} kn")
    return law


def _names_of_any_sign(law: Law) -> tuple[str, ...]:
    """Names of parameters that may be negative."""
    return tuple({*find_user_law(law.kind).names} - {*PARAMETERS}) if isinstance(law.kind, Kind) else ()


_DASHPOTS = "gamma_roll", "gamma_twist"
MAX_PARAMETER = 1e100  # largest value: parameters are squared and multiplied by each other


def damping_model(law: Law) -> int:
    """Damping model of the law; 0 if no pair of materials has dashpots, for forces or moments."""
    dashpots = DAMPING_N, DAMPING_T, *(k for k, name in enumerate(parameter_names(law)) if name in _DASHPOTS)
    return law.damping if law.table[..., dashpots].any() else 0


def check_parameter(name, value, names=PARAMETERS, signed=()):
    """Raise ValueError if a law has no such parameter, or if the value is not allowed."""
    if name not in names:
        raise ValueError(f"a law has no parameter {name!r}: it has {', '.join(names)}")
    if isinstance(value, np.ndarray | np.generic) and not value.shape and value.dtype.kind in "fiu":
        value = value.item()
    if not isinstance(value, Real):
        raise ValueError(f"{name} must be a number, got {quoted(value)}")
    low_ok = value > 0 if name == "kn" else value >= 0 or name in signed
    if not (abs(value) < np.inf and low_ok):
        raise ValueError(f"{name} must be finite and {'positive' if name == 'kn' else 'not negative'}, got {value}")
    if abs(value) > MAX_PARAMETER or (name == "kn" and value < 1 / MAX_PARAMETER):
        raise ValueError(
            f"{name} must be at most {MAX_PARAMETER:g}, and kn at least {1 / MAX_PARAMETER:g}, so that products stay "
            f"finite, got {quoted(value)}; use other units"
        )


MOST_MATERIALS = 1000


@checked
def for_pair(law: Law, a: int, b: int, **parameters) -> Law:
    """Law with changed parameters between materials `a` and `b`. New materials start as copies of material 0.

    Examples
    --------
    >>> law = for_pair(hertz_mindlin(mu=0.5), 0, 1, mu=0.2)  # grains are 0, walls 1
    >>> [float(law.table[0, m, MU]) for m in (0, 1)]
    [0.5, 0.2]
    """
    names = parameter_names(law)
    for number in (a, b):
        if not 0 <= number < MOST_MATERIALS:
            raise ValueError(f"materials are numbered from 0 to {MOST_MATERIALS - 1}, got {number}")
    size = max(len(law.table), a + 1, b + 1)
    table = np.empty((size, size, len(names)))
    table[:] = law.table[0, 0]
    old = len(law.table)
    table[:old, :old] = law.table
    for name, value in parameters.items():
        check_parameter(name, value, _given_names(law), _names_of_any_sign(law))
        table[a, b, names.index(name)] = table[b, a, names.index(name)] = value
    return _checked_values(_derive_twisting(law._replace(table=table)))


def laws_equal(a: Law, b: Law) -> bool:
    """Return True if two laws have the same kind and parameters."""
    return a[:2] == b[:2] and a[3:] == b[3:] and np.array_equal(a.table, b.table)


def with_values(law: Law, **parameters) -> Law:
    """Law with changed parameters for all pairs of materials."""
    names, table = parameter_names(law), law.table.copy()
    for name, value in parameters.items():
        check_parameter(name, value, _given_names(law), _names_of_any_sign(law))
        table[..., names.index(name)] = value
    return _checked_values(_derive_twisting(law._replace(table=table)))


def marshall_values(kt, mu) -> dict:
    """Parameters of Marshall's twisting, as multiples of a², a P and a² c_t."""
    return {"k_twist": kt / 2, "mu_twist": 2 / 3 * mu, "gamma_twist": 0.5}


def _derive_twisting(law: Law) -> Law:
    """Law with parameters of Marshall's twisting, if any, derived from kt and mu for each pair of materials."""
    if not law.properties & SCALED:
        return law
    names, table = parameter_names(law), law.table.copy()
    twists = table[..., names.index("gamma_twist")] > 0
    for name, values in marshall_values(table[..., KT], table[..., MU]).items():
        table[..., names.index(name)] = np.where(twists, values, table[..., names.index(name)])
    return law._replace(table=table)


def _given_names(law: Law) -> tuple[str, ...]:
    """Names of the parameters that do not follow from others."""
    derived = MOMENTS[TWISTING] if law.properties & SCALED else {}
    return tuple(name for name in parameter_names(law) if name not in derived)


def rescales(law: Law) -> bool:
    """Return True if a decreasing overlap shortens the slip: see `hertz_mindlin`."""
    return not isinstance(law.kind, Kind) and BUILTIN_LAWS[law.kind].rescales


def parameter_names(law: Law) -> tuple[str, ...]:
    """Names of a law's parameters, in the order of its table."""
    if isinstance(law.kind, Kind):
        names = find_user_law(law.kind).names
    else:
        names = *PARAMETERS, *(p.name for p in BUILTIN_LAWS[law.kind].parameters)
    return *names, *(name for part, own in MOMENTS.items() if law.properties & part for name in own)


def _name(law: Law) -> str:
    own = USER_LAWS.get(law.kind)
    return own.name if own else NAMES[law.kind] if 0 <= law.kind < len(NAMES) else "user-defined law"


def _describe(law: Law) -> str:
    shown = [_name(law), f"{'smooth' if law.coulomb == SMOOTH else 'sharp'} Coulomb"]
    shown += [f"{len(law.table)} materials"] if len(law.table) > 1 else []
    for parameter, values in _parameters(law).items():
        low, high = values.min(), values.max()
        shown.append(f"{parameter} = {low:.6g}" + ("" if low == high else f" to {high:.6g}"))
    shown += ["memory of forces"] if law.properties & KEEPS_FORCE else []
    shown += ["lever arms R - δ/2"] if law.properties & LEVER else []
    return ", ".join(shown)


def _parameters(law: Law) -> dict[str, np.ndarray]:
    """Parameters by name, (materials, materials); those of dashpots only if some pair has dashpots."""
    known = law.kind in USER_LAWS or 0 <= law.kind < len(NAMES)
    columns = zip(parameter_names(law) if known else PARAMETERS, np.moveaxis(law.table, -1, 0), strict=False)
    return {name: values for name, values in columns if name in PARAMETERS[:3] or values.any()}


_VISCOUS = {"gamma_roll": ("time/length", "rolling dashpot over R_eff² F_n")}
_SCALED = {  # parameters scaled with the contact radius a
    "k_twist": ("force/length", "twisting stiffness over a²"), "mu_twist": ("1", "largest twisting moment over a F_n"),
    "gamma_twist": ("1", "twisting dashpot over a² times the tangential one"),
}  # fmt: skip
DASHPOTS = {  # unit of the coefficients of a damping model, and the force in words
    VELOCITY: ("force time/length", "proportional to the velocity"),
    MASS: ("1/time", "proportional to effective mass and velocity"),
    VISCOELASTIC: ("1/(time length)", "proportional to effective mass, contact radius and velocity"),
    TSUJI: ("1", "with a coefficient of restitution, damping_n"),
    RESTITUTION: ("1", "with a coefficient of restitution, damping_n"),
}


def _rows(law: Law):
    """Table rows of a law: parameters common to all pairs of materials, then those that differ, by pair."""
    damping, dashpots = DASHPOTS.get(law.damping & ~NO_TENSION, ("", ""))
    built_in = BUILTIN_LAWS[law.kind] if 0 <= law.kind < len(NAMES) else None
    stiffness = built_in.stiffness_unit if built_in else ""
    known = {
        "kn": (stiffness, "normal stiffness"), "kt": (stiffness, "tangential stiffness"),
        "mu": ("1", "coefficient of friction"), "damping_n": (damping, "normal dashpot"),
        "damping_t": (damping, "tangential dashpot"),
    }  # fmt: skip
    known |= {p.name: (p.unit, p.words) for p in built_in.parameters} if built_in else {}
    known |= MOMENTS[ROLLING] | (_VISCOUS if law.properties & VISCOUS else {})
    known |= _SCALED if law.properties & SCALED else MOMENTS[TWISTING]
    given = _parameters(law)
    differ = {name: values for name, values in given.items() if np.ptp(values) > 0}
    yield "contact law", _name(law), "", built_in.words.partition(", ")[0] if built_in else "a user-defined law"
    if law.coulomb == SMOOTH:
        yield "Coulomb friction", "smooth", "", "the tangential stiffness decreases to zero towards the limit"
    else:
        yield "Coulomb friction", "sharp", "", "contacts stick up to the limit"
    for name, values in given.items():
        if name not in differ:
            yield name, float(values[0, 0]), *known.get(name, ())
    if law.properties & KEEPS_FORCE:
        yield "memory", "force", "", "sticking contacts keep their tangential force as the overlap changes"
    if law.properties & LEVER:
        yield "lever arms", "R - δ/2", "", "between grains; R at walls"
    if damping_model(law):
        pull = "contacts never attract" if law.damping & NO_TENSION else "contacts may attract as they open"
        yield "dashpots", dashpots, "", pull
    for a, b in zip(*np.triu_indices(len(law.table)), strict=True) if differ else ():
        pair = ", ".join(f"{name} = {values[a, b]:.6g}" for name, values in differ.items())
        yield f"materials {a} and {b}", pair
