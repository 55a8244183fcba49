"""Figures: each function takes a result and returns a matplotlib Figure.

Those of an experiment are in its own module, as `figures.flow.snapshots`. A notebook shows a figure as a picture;
pyplot and its backend are left alone. `figure.savefig` or `save` writes it.

    save                   write a figure as PNG, PDF or SVG, one or two columns wide, with letters of its panels
    Look                   formats, width and letters of the figures of a sweep

Any packing

    packing                grains, contacts, walls, cell, and the orbits of a mode
    view                   three-dimensional view for a notebook (a K3D plot)
    movie                  animation of the frames of a run, written to a file

What follows an instability

    growth_by_amplitude    growth rate of a pair at finite amplitude
    response_envelopes     stress and second-order work of small strains in all directions
    dispersion             frequency and damping of waves against the wave number, with the lines of the moduli
    inclusion              displacements around an inflated grain, with elasticity and screening
    bursts                 amplitude of a pair in a free run, with the predicted envelopes
    static_and_kinetic     share of kicked runs that slide and their lifetimes, with static thresholds

Experiments, a module each

    disk_array             complex pairs along a push, M(t), trajectories, fronts (Charan et al. 2020)
    sphere_shear           complex pairs along a strain, growth, stress through failure (Bonfanti et al. 2020)
    quasi_rigid            load paths, contact forces in the Coulomb cone, stiffness (McNamara & Herrmann 2006)
    gouge                  sliding, velocity steps, holds, healing, stick-slip (Ferdowsi & Rubin 2021)
    rate_state             spring-sliders, and records with their fits
    fault                  slip, velocity and stations of a fault
    flow                   snapshots, time series and profiles of flows
    element_test           stress paths, stress-strain curves, void ratio and contacts of element tests
    cyclic_shear           loops, modulus and damping against amplitude, work, and return of grains
    catalogue              events of sheared packings, and what announces them

Claims

    claims_chart           measurements of a reproduction against the paper's values
"""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
