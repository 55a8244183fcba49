"""Quantities of a state.

Measures use the contacts at the positions of the state. They reject a state whose grains have moved since its contacts
were committed, for example by `packings.strained`: first commit them with `accept(state, forces(state, law)[1])`.

Contacts
    contact_forces      elastic force on body i of every pair
    contact_numbers     contacts of each grain
    coordination        mean number of contacts of a grain, without rattlers
    rattlers            grains without support
    touching            rows of the contact list whose bodies touch, or act on each other across a gap
    bond_shares         ratio of load to strength of each bond
    overlaps            overlaps of all pairs, negative for gaps
    branch_vectors      vectors from body j to body i of all pairs

Continuum
    stress, pressure    virial stress, compression positive; its mean
    fabric              mean of n ⊗ n
    packing_fraction    volume of the grains divided by that of the cell
    inertial_number     dimensionless shear rate
    shear_strain        strain of a sheared cell
    elastic_energy      energy stored in the contacts
    dissipation         energy dissipated by each contact in a step, by sliding and dashpots
    coarse_grained      density, velocity and stress as fields on a grid

Force network of a state, or a measured one
    force_network       contacts that touch and their forces
    force_chains        chains of grains that carry more than the mean force
    strong_network      contacts above the mean force, and their largest cluster
    force_anisotropy    anisotropies of contacts, normal forces and tangential forces

Equilibrium
    unbalanced_forces   generalised force on every body
    residual            largest unbalanced force
    imbalance, BALANCED_BELOW   the residual divided by the mean contact force, and its limit for a verdict
    likely_causes       likely reasons why forces do not balance

Space and time
    heights             distances of points from walls
    wrapped             positions within the periodic cell
    stable_time_step    largest stable time step
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
