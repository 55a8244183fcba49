"""Wet grains: a linear contact, and the pull of a liquid bridge, which fades across a gap and is gone at rupture.

Richefeu, El Youssoufi & Radjai, doi:10.1103/PhysRevE.73.051304, with 2 r_eff for the radius of alike grains, and less
the pull at rupture, so that the force ends without a jump. Dry friction is that of the repulsive part.
"""

from math import exp

parameters = {"kn": 1.0, "kt": 0.3, "mu": 0.5, "tension": 1e-3, "decay": 0.02, "rupture": 0.05}


def contact_range(rupture):
    return rupture


def bridge(gap, r_eff, tension, decay, rupture):
    rest = exp(-rupture / decay)
    return 2.0 * r_eff * tension * (exp(-gap / decay) - rest) / (1.0 - rest)


def normal_force(overlap, r_eff, kn, tension, decay, rupture):
    return kn * max(overlap, 0.0) - bridge(max(-overlap, 0.0), r_eff, tension, decay, rupture)


def cap(overlap, kn, mu):
    return mu * kn * max(overlap, 0.0)
