"""Built-in laws whose normal force has parameters of its own: adhesion, liquid bridges, plasticity.

All take the parameters of `hertz_mindlin`, `coulomb`, `damping` and `tension` included, and their own. Dashpots act
where the overlap is positive, and take part in no cap but that of `walton_braun`; viscoelastic ones of `jkr` take the
radius √(δ R_eff), those of LAMMPS a.
"""

from ..arguments import checked
from .builtin import Law, make_law


@checked
def jkr(
    kn=1.0, kt=2 / 7, mu=0.5, *, work, coulomb="sharp", damping="viscoelastic", damping_n=0.0, damping_t=0.0,
    tension: bool = True,
) -> Law:  # fmt: skip
    """F_n = k_n a³/R_eff − √(6π w k_n a³), δ = a²/R_eff − √(8πwa/(3k_n)); F_t = −k_t a s, |F_t| ≤ μ |F_n + 3πwR_eff|.

    Adhesive elastic spheres. Contacts form at touch, attract by at most 1.5 π w R_eff, and pull off at a gap of
    (27 c²/256)^{1/3}/R_eff, c = 8πwR_eff²/(3k_n). Without adhesion this is `hertz_mindlin_reff`.

    Parameters
    ----------
    kn, kt : float [force/length²], k_n = 4E*/3; see `elastic_constants`
    work : w, work of adhesion, twice the surface energy that LAMMPS `granular jkr` takes [energy/length²]

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

    Small, stiff adhesive spheres: the attraction acts from touch to touch and jumps there, so that energy is conserved
    only as far as the time step resolves the jump.

    Parameters
    ----------
    kn, kt : float [force/length²]
    work : w, work of adhesion, twice the surface energy that LAMMPS `granular dmt` takes [energy/length²]

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

    Plastic contacts, which keep δ_m as their memory. Spheres rebound with √(k_n/k_u) of their speed.

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

    Wet spheres with a contact angle of zero. Bridges form at touch and break at a gap of V^{1/3}; the attraction there
    is subtracted. F_t = −k_t √(δ R_eff) s, at most μ k_n √R_eff δ^{3/2}.

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
