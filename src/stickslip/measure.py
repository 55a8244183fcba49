"""Quantities of a state.

Contacts are those at the positions of the state. A state that has moved since its contacts were committed, for example
by `packings.strained`, is refused: evaluate and commit it first, `accept(state, forces(state, law)[1])`.

Contacts
    contact_forces      elastic force on body i of every pair
    contact_numbers     contacts of each grain
    coordination        mean number of contacts without rattlers
    rattlers            grains that nothing holds
    touching            rows of the contact list whose bodies touch, or act on each other across a gap
    overlaps            overlaps of all pairs, negative for gaps
    branch_vectors      vectors from body j to body i of all pairs

Continuum
    stress, pressure    virial stress, compression positive; its mean
    fabric              mean of n ⊗ n
    packing_fraction    volume of the grains over that of the cell
    inertial_number     dimensionless shear rate
    shear_strain        strain of a sheared cell
    elastic_energy      energy stored in the contacts
    dissipation         energy that each contact dissipates in a step, by sliding and by dashpots

Equilibrium
    unbalanced_forces   generalised force on every body
    residual            the largest of them
    imbalance, BALANCED_BELOW   the residual over the mean contact force, and its limit for a verdict
    likely_causes       likely reasons why forces do not balance

Space and time
    heights             distances of points from walls
    wrapped             positions within the periodic cell
    stable_time_step    largest stable time step
"""

from .core.contacts.forces import unbalanced_forces
from .core.dynamics.ledger import dissipation
from .core.dynamics.timestep import stable_time_step
from .core.measure import (
    branch_vectors,
    contact_forces,
    contact_numbers,
    coordination,
    elastic_energy,
    fabric,
    inertial_number,
    overlaps,
    packing_fraction,
    pressure,
    rattlers,
    stress,
    touching,
    wrapped,
)
from .core.state import heights
from .lazy import unknown
from .loading.shear import shear_strain
from .solve.balance import BALANCED_BELOW, imbalance, likely_causes
from .solve.relax import residual

__all__ = [
    "BALANCED_BELOW",
    "branch_vectors",
    "contact_forces",
    "contact_numbers",
    "coordination",
    "dissipation",
    "elastic_energy",
    "fabric",
    "heights",
    "imbalance",
    "inertial_number",
    "likely_causes",
    "overlaps",
    "packing_fraction",
    "pressure",
    "rattlers",
    "residual",
    "shear_strain",
    "stable_time_step",
    "stress",
    "touching",
    "unbalanced_forces",
    "wrapped",
]

__getattr__ = unknown(__name__)
