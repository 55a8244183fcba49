"""Plastic contacts: stiffness kn as the overlap grows, k_unload as it decreases.

Walton & Braun, doi:10.1122/1.549893: the force vanishes at the plastic overlap
(1 − kn/k_unload) deepest. Beyond the deepest overlap, it is again kn overlap.
Spheres rebound with the fraction √(kn/k_unload) of their speed.
"""

parameters = {"kn": 1.0, "kt": 0.8, "mu": 0.5, "k_unload": 2.0}
memory = {"deepest": 0.0}


def update(deepest, overlap):
    return max(overlap, deepest)


def normal_force(overlap, deepest, kn, k_unload):
    plastic = (1 - kn / k_unload) * deepest
    return k_unload * max(overlap - plastic, 0.0)


def normal_energy(overlap, deepest, kn, k_unload):
    elastic = max(overlap - (1 - kn / k_unload) * deepest, 0.0)
    return 0.5 * k_unload * elastic * elastic
