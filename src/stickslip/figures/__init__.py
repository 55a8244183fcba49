"""Figures: each function takes a result and returns a matplotlib Figure.

Figures of an experiment are in the module `figures` of its package, such as `figures.flow.snapshots`. A notebook shows
a figure as a picture; pyplot and its backend are not used. `figure.savefig` or `save` writes it to a file.

    save                   write a figure as PNG, PDF or SVG, one or two columns wide, with lettered panels
    Look                   formats, width and panel letters of the figures of a sweep

Any packing

    packing                grains, contacts, walls, cell, and the orbits of a mode
    forces                 distribution, force chains, strong network and directions of contact forces
    view                   three-dimensional view for a notebook (a K3D plot)
    movie                  animation of the frames of a run, written to a file

Course of an instability

    failure_path           stress, growth and softest mode of a packing until it fails, with forecasts
    growth_by_amplitude    growth rate of a pair at finite amplitude
    response_envelopes     stress and second-order work of small strains in all directions
    dispersion             frequency and damping of waves against the wave number, with lines from the moduli
    inclusion              displacements around an inflated grain, with fits of elasticity and screening
    bursts                 amplitude of a pair in a free run, with the predicted envelopes
    static_and_kinetic     share of kicked runs that slide, time until they do, and static thresholds

Claims

    claims_chart           measurements of a reproduction against the paper's values
"""

from ..lazy import attach
from ..wing import figure_modules

__getattr__, __dir__, _ = attach(__name__, __file__, figure_modules)
