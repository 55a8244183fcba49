"""Python form of `laws.hertz_mindlin_reff`."""

from math import sqrt

parameters = {"kn": 1.0, "kt": 2 / 7, "mu": 0.5}
damping = "viscoelastic"


def normal_force(overlap, r_eff, kn):
    return kn * overlap * sqrt(overlap * r_eff)


def tangential_stiffness(overlap, r_eff, kt):
    return kt * sqrt(overlap * r_eff)


def cap(normal_force, mu):
    return mu * max(normal_force, 0.0)
