"""Contact laws: choose one, combine several, or write your own.

Built-in laws
    hertz_mindlin       F_n = k_n δ^(3/2), as in Charan et al. 2020 and Bonfanti et al. 2020
    hertz_mindlin_reff  F_n = k_n √(R_eff) δ^(3/2), as in Ferdowsi & Rubin 2021 and LAMMPS `gran/hertz/history`
    linear              F_n = k_n δ, as in McNamara & Herrmann 2006
    jkr, dmt            adhesive spheres, pulled apart at a gap or at zero overlap
    liquid_bridge       wet spheres
    walton_braun        plastic contacts
    elastic_constants   k_n and k_t from Young's modulus and Poisson's ratio
    for_pair            other parameters for one pair of materials
    frictionless        the same normal force without friction and dashpots

Properties of any law
    with_lever          lever arms R or R − δ/2
    with_memory         memory of slips, or of tangential forces
    with_rolling        resistance to rolling: constant, viscous, or a spring with a cap
    with_twisting       resistance to twisting: a spring with a cap, or Marshall's

Bonds, which act in addition to a contact law; `packings.bonded` makes them
    spring_bond         a spring along the line of centres, as in LAMMPS `bpm/spring`
    beam_bond           tension, shear, bending and twisting, as in LAMMPS `bpm/rotational`
    parallel_bond       cement between grains, as in Potyondy & Cundall 2004

User-defined laws
    custom              a law from Python functions of scalars
    from_file           a law from a Python file
    LawWarning          warning about an unusual property of a user-defined law

Dashpots
    with_restitution    choose γ_n for a coefficient of restitution at a given size and speed
    collision           integrate the head-on collision of two grains
    eq8_damping         γ_n from Eq 8 of Ferdowsi & Rubin 2021, taken literally
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
