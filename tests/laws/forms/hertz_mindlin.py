"""Python form of `laws.hertz_mindlin`."""

from math import sqrt

parameters = {"kn": 1.0, "kt": 2 / 7, "mu": 0.5}


def normal_force(overlap, kn):
    return kn * overlap * sqrt(overlap)


def tangential_stiffness(overlap, kt):
    return kt * sqrt(overlap)


def cap(normal_force, mu):
    return mu * max(normal_force, 0.0)
