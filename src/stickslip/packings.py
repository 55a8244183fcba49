"""Packings: generate them, build them from arrays, and prepare them for tests.

Generate
    jammed          frictionless jammed packing of disks or spheres in a periodic box
    compressed      packing of disks or spheres in a periodic box, compressed with friction to a pressure
    disk_array      row of disks on a substrate, as in Charan et al. 2020
    biaxial_box     disks between four walls under a pressure
    LEFT, BOTTOM, RIGHT, TOP    numbers of the walls of `biaxial_box`, counted from the last disk
    sheared_box     disks in a periodic cell under a pressure
    poured          grains, walls and plates of a flow scenario
    from_arrays     state from positions, radii and, if known, contacts with their slip
    from_forces     balanced state nearest to measured positions and contact forces

Modify
    strained, sheared   affine deformation of cell and grains; simple shear
    reduced_cell        the same packing in its least skewed cell
    with_push           disk array with a different force on one disk
    perturbed           random velocities
    bonded              bonds between nearby grains, or between chosen ones
    without_walls       some walls removed
    without_bonds       all bonds removed

Check
    check           raise an error if a state is not valid
    PackingError    a packing cannot be used
    PackingWarning  part of a packing was changed or is missing
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
