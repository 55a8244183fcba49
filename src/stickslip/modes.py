"""Linearised dynamics beyond `spectrum` and `stability`.

Complex pairs
    complex_pairs       all pairs of a large packing
    fastest_pair        the fastest-growing pair of a very large one
    track_pairs         pairs along a load path, with births and deaths
    match_pairs         pairs matched from one spectrum to the next
    contact_sensitivity  effect of each contact on a pair
    eigenvalue_gradient  derivatives of the decisive eigenvalue with respect to forces, radii, parameters, positions
    modulus_gradient    derivatives of a modulus with respect to these quantities
    residual_gradient   derivatives of the norm of the unbalanced forces with respect to these quantities
    verdict_probability  probability of the verdict given errors of positions
    birth_form          course of the instability: bursts, runaway, or a lost contact

Bonds
    decisive_bonds      bonds on which the growing or softest mode depends most
    first_break         first bond to break under a strain or a stress, by linear response

With dashpots and drag
    damped_growth       exponents with drag

Density of states and response
    density_of_states, participation_ratio  distribution of frequencies; extent of modes
    elastic_moduli      elastic moduli with their non-affine part
    transient_growth    largest transient amplification of a stable packing

Response to forces, motions and noise
    frequency_response  transfer function from drives to observables, with drag and dashpots
    complex_moduli      storage and loss moduli in a cell whose strain oscillates
    plane_wave          forces of a wave, as drives
    contact_slip, stress_change  observables
    inflate             displacements around an inflated grain: elasticity or screening
    stationary_fluctuations  covariances under noise, and distance from instability
    trigger_amplitude   amplitude of shaking or of a pulse at which a contact slides

Waves
    dispersion          frequency and damping of P, S and rotational waves
    wave_spectrum       modes projected on plane waves: dynamical structure factor, complex pairs
    allowed_wavevectors  wave vectors of a periodic cell
    elastic_speeds      speeds of long waves from the moduli
    moduli_bounds       elastic moduli, with the bounds of Voigt and Reuss

Matrices
    equations_of_motion  J, C, M and the unbalanced force; io.write_matrices writes them
    dynamical_matrix    −M^(−1/2) J M^(−1/2), sparse
    contact_blocks      derivatives of each contact force
    assembled           matrix in generalised coordinates, assembled from contact blocks
    residual_vector     unbalanced forces in generalised coordinates
    displaced           state with displaced coordinates
    backbone            coordinates without rattlers
    UnstableEquilibriumWarning  forces balance, but the equilibrium is unstable
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
