"""Adhesive spheres: Johnson, Kendall & Roberts, doi:10.1098/rspa.1971.0141.

Contacts form at touch and pull off at a gap; as work goes to zero this becomes
hertz_mindlin_reff, E* = 3 kn/4. The contact radius a, δ = a²/R − √(2πwa/E*), has a
closed form: Parteli et al., doi:10.1038/srep06227. Friction is that of Thornton,
doi:10.1088/0022-3727/24/11/007: at most μ |F_n + 2 F_c|, F_c = 1.5 πwR, without
dashpots.
"""

from math import pi, sqrt

parameters = {"kn": 1.0, "kt": 0.8, "mu": 0.5, "work": 1e-3}
bonds, damping = True, "viscoelastic"


def spread(r_eff, kn, work):
    return 8 / 3 * pi * work * r_eff**2 / kn


def contact_range(r_eff, kn, work):
    return (27 / 256 * spread(r_eff, kn, work) ** 2) ** (1 / 3) / r_eff


def contact_radius(overlap, r_eff, kn, work):
    c, x = spread(r_eff, kn, work), r_eff * overlap  # (a² − x)² = ca
    x3 = x * x * x  # x**3 of a negative complex number would lose its imaginary part
    cube = c * sqrt(max(c * c / 256 + x3 / 27, 0.0)) + c * c / 16 + 8 / 27 * x3
    u = cube ** (1 / 3)
    w = sqrt(2 * u + 8 / 9 * x * x / u + 4 / 3 * x)
    return 0.5 * (w + sqrt(max(4 * x - w * w + 2 * c / w, 0.0)))


def normal_force(overlap, r_eff, kn, work):
    a = contact_radius(overlap, r_eff, kn, work)
    return kn / r_eff * a**3 - sqrt(6 * pi * work * kn * a**3)


def normal_energy(overlap, r_eff, kn, work):
    a, c = contact_radius(overlap, r_eff, kn, work), spread(r_eff, kn, work)
    b = (c / 16) ** (1 / 3)  # a at pull-off
    return stored(a, r_eff, kn, work) - stored(b, r_eff, kn, work)


def stored(a, r_eff, kn, work):
    force, root = kn / r_eff, sqrt(6 * pi * work * kn)
    return 0.4 * force / r_eff * a**5 - 2 / 3 * root / r_eff * a**3 * sqrt(a) + pi * work * a * a


def tangential_stiffness(overlap, r_eff, kn, kt, work):
    return kt * contact_radius(overlap, r_eff, kn, work)


def cap(overlap, r_eff, kn, mu, work):
    return mu * abs(normal_force(overlap, r_eff, kn, work) + 3 * pi * work * r_eff)
