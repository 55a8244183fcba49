"""Cohesive law for wet grains: Hertz–Mindlin contacts with a liquid bridge.

The attraction decays across a gap until the bridge ruptures, as in the model of
Richefeu, El Youssoufi & Radjai, doi:10.1103/PhysRevE.73.051304, with 2 r_eff as the
radius of equal grains. The attraction at rupture is subtracted, so the force
vanishes continuously. The bridge does not contribute to the friction cap.
"""

from math import exp, sqrt

parameters = {"kn": 1.0, "kt": 2 / 7, "mu": 0.5}
parameters |= {"tension": 1e-4, "decay": 0.02, "rupture": 0.05}


def contact_range(rupture):
    return rupture


def elastic(overlap, kn):
    pressed = max(overlap, 0.0)
    return kn * pressed * sqrt(pressed)


def normal_force(overlap, r_eff, kn, tension, decay, rupture):
    gap, rest = max(-overlap, 0.0), exp(-rupture / decay)
    bridge = 2 * r_eff * tension * (exp(-gap / decay) - rest) / (1 - rest)
    return elastic(overlap, kn) - bridge


def tangential_stiffness(overlap, kt):
    return kt * sqrt(max(overlap, 0.0))


def cap(overlap, kn, mu):
    return mu * elastic(overlap, kn)
