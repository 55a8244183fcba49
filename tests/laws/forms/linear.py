"""Python form of `laws.linear`."""

parameters = {"kn": 1.0, "kt": 2 / 7, "mu": 0.5}


def normal_force(overlap, kn):
    return kn * overlap


def normal_energy(overlap, kn):
    return kn * overlap * overlap / 2


def cap(normal_force, mu):
    return mu * max(normal_force, 0.0)
