"""Wet spheres: Hertz–Mindlin contacts, and liquid bridges that form at touch.

Attraction of a bridge of volume V between equal spheres of radius R at a gap g,
2πγR [1 − (1 + 2V/(πRg²))^(−1/2)] for a contact angle of zero: Rabinovich,
Esayanur & Moudgil, doi:10.1021/la0517639. It breaks at V^(1/3), as found by Lian,
Thornton & Adams, doi:10.1006/jcis.1993.1452; the attraction there is subtracted.
"""

from math import pi, sqrt

parameters = {"kn": 1.0, "kt": 2 / 7, "mu": 0.5}
parameters |= {"surface_tension": 1e-4, "volume": 1e-4}
bonds, damping = True, "viscoelastic"


def contact_range(volume):
    return volume ** (1 / 3)


def elastic(overlap, r_eff, kn):
    pressed = max(overlap, 0.0)
    return kn * pressed * sqrt(pressed * r_eff)


def hold(gap, r_eff, volume):
    wide = pi * r_eff * gap * gap  # R = 2 R_eff
    return 1 - sqrt(wide / (wide + volume))


def normal_force(overlap, r_eff, kn, surface_tension, volume):
    end = hold(volume ** (1 / 3), r_eff, volume)
    bridge = hold(max(-overlap, 0.0), r_eff, volume) - end
    return elastic(overlap, r_eff, kn) - 4 * pi * surface_tension * r_eff * bridge


def tangential_stiffness(overlap, r_eff, kt):
    return kt * sqrt(max(overlap, 0.0) * r_eff)


def cap(overlap, r_eff, kn, mu):
    return mu * elastic(overlap, r_eff, kn)
