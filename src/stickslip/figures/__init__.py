"""Figures: each function takes a result and returns a matplotlib Figure.

Any packing

    packing                grains, contacts, walls, cell, and the orbits of a mode
    view                   three-dimensional view for a notebook (a K3D plot)
    movie                  animation of the frames of a run, written to a file

What follows an instability

    growth_by_amplitude    growth rate of a pair at finite amplitude
    bursts                 amplitude of a pair in a free run, with the predicted envelopes
    static_and_kinetic     share of kicked runs that slide and their lifetimes, with static thresholds

Events of sheared packings

    eigenvalue_before_events   smallest eigenvalue before saddle nodes, and across contacts that start to slide
    classes                share of every class of events, by law
    drops                  distributions of stress drops and jumps
    roc_curves             what is announced, against false alarms

Disk array (Charan et al. 2020)

    complex_pairs          Im λ of all complex pairs against the push
    mean_square_displacement   M(t) at every load, with the predicted growth
    trajectory             path of one disk, coloured by time
    traveling_fronts       forward and backward fronts with their speeds
    mode_shape             components of one mode
    center_of_mass         centre of mass through the transition, and sliding velocity

Spheres in shear (Bonfanti et al. 2020)

    pairs_along_strain     complex pairs against strain
    spectrum_in_time       eigenvalues during a run, above M(t)
    growth                 M(t) with the predicted growth and the fitted oscillation
    trajectories           displacements during growth
    stress_through_failure  shear stress and contacts through failure

Quasi-rigid loading (McNamara & Herrmann 2006)

    curves                 stress ratio and volumetric strain against strain
    cone                   contact forces in the Coulomb cone
    stiffness              sliding contacts, smallest eigenvalues and complex pairs along a path
    errors                 difference between path and slow dynamics

Fault gouge (Ferdowsi & Rubin 2021), rate and state

    steady_sliding         friction and thickness against slip
    velocity_steps         change in friction after velocity steps
    holds, reslides        friction during holds and in slides after them
    healing                peak friction against hold time
    stick_slip             friction and velocity of a plate that is driven through a soft spring
    sample                 the sample in steady sliding
    slid                   spring-slider: friction, velocity and state
    fitted                 a record with fits and their residuals

Faults

    slip_contours          slip against depth, between earthquakes and during them
    max_slip_velocity      maximum slip velocity over the fault
    station_series         slip velocity and shear stress at stations

Flows and claims

    snapshots              poured grains coloured by speed
    time_series            energies, contacts, extent of the flow
    velocity_profile       mean velocity against height
    claims_chart           measurements of a reproduction against the paper's values
"""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
