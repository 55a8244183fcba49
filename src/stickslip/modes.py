"""Linearised dynamics beyond `spectrum` and `stability`.

Complex pairs
    complex_pairs       all pairs of a large packing
    fastest_pair        the fastest growing pair of a very large one
    track_pairs         pairs along a load path, with births and deaths
    match_pairs         pairs matched from one spectrum to the next
    contact_sensitivity  effect of each contact on a pair
    birth_form          what follows the instability: bursts, runaway, or a contact that is lost

With dashpots and drag
    damped_growth       exponents with drag

Density of states and response
    density_of_states, participation_ratio  distribution of frequencies; extent of modes
    elastic_moduli      elastic moduli with their non-affine part
    transient_growth    largest transient amplification of a stable packing

Matrices
    dynamical_matrix    −M^(−1/2) J M^(−1/2), sparse
    contact_blocks      derivatives of each contact force
    assembled           matrix in generalised coordinates, assembled from such blocks
    residual_vector     unbalanced forces in generalised coordinates
    displaced           state with displaced coordinates
    backbone            coordinates without rattlers
    UnstableEquilibriumWarning  forces balance, but the equilibrium is unstable
"""

from .core.contacts.jacobian import contact_blocks
from .lazy import unknown
from .loading.protocols import track_pairs
from .solve.birth import birth_form
from .solve.density import density_of_states, participation_ratio
from .solve.equilibrate import UnstableEquilibriumWarning
from .solve.fastest import fastest_pair
from .solve.freedom import assembled, backbone, displaced, dynamical_matrix, residual_vector
from .solve.moduli import elastic_moduli
from .solve.pairs import complex_pairs
from .solve.sensitivity import contact_sensitivity
from .solve.spectrum import damped_growth, match_pairs
from .solve.transient import transient_growth

__all__ = [
    "UnstableEquilibriumWarning",
    "assembled",
    "backbone",
    "birth_form",
    "complex_pairs",
    "contact_blocks",
    "contact_sensitivity",
    "damped_growth",
    "density_of_states",
    "displaced",
    "dynamical_matrix",
    "elastic_moduli",
    "fastest_pair",
    "match_pairs",
    "participation_ratio",
    "residual_vector",
    "track_pairs",
    "transient_growth",
]

__getattr__ = unknown(__name__)
