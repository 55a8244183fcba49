"""Adhesive spheres: Derjaguin, Muller & Toporov, doi:10.1016/0021-9797(75)90018-1."""

from math import pi, sqrt

parameters = {"kn": 1.0, "kt": 0.8, "mu": 0.5, "work": 1e-3}
damping = "viscoelastic"


def normal_force(overlap, r_eff, kn, work):
    return kn * overlap * sqrt(overlap * r_eff) - 2 * pi * work * r_eff


def tangential_stiffness(overlap, r_eff, kt):
    return kt * sqrt(overlap * r_eff)


def cap(overlap, r_eff, kn, mu, work):
    return mu * abs(normal_force(overlap, r_eff, kn, work) + 4 * pi * work * r_eff)
