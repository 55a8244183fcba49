"""Contact law with rolling resistance: linear, elastic-plastic rolling spring.

Model C of Ai, Chen, Rotter & Ooi, doi:10.1016/j.powtec.2010.09.030, without its
dashpot: the moment is k_r times the relative rotation, at most mu_r r_eff F_n, with
k_r = 2.25 kn (mu_r r_eff)².
"""

parameters = {"kn": 1.0, "kt": 0.8, "mu": 0.5, "mu_r": 0.1}


def normal_force(overlap, kn):
    return kn * overlap


def rolling_stiffness(r_eff, kn, mu_r):
    return 2.25 * kn * (mu_r * r_eff) ** 2


def rolling_cap(normal_force, r_eff, mu_r):
    return mu_r * r_eff * max(normal_force, 0.0)
