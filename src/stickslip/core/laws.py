"""Contact laws, each written once as scalar functions; kernels do the vector algebra.

A law is an integer `kind`, an integer `coulomb` and a table of parameters by pair of materials. The scalar functions
take real or complex arguments (they branch on the real part), so that their tangents come from the same source by a
complex step: f'(x) = Im f(x + ih)/h, exact to round-off because nothing is subtracted.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

HERTZ_MINDLIN, LINEAR = 0, 1
SHARP, SMOOTH = 0, 1
COULOMB = {"sharp": SHARP, "smooth": SMOOTH}
PARAMETERS = ("kn", "kt", "mu", "damping_n", "damping_t")
KN, KT, MU, DAMPING_N, DAMPING_T = range(5)

_H = 1e-60  # step of the complex derivative: its square vanishes in double precision


class Law(NamedTuple):
    """A contact law with its parameters."""

    kind: int
    coulomb: int
    table: np.ndarray  # (materials, materials, parameters), symmetric in the first two


def hertz_mindlin(kn=1.0, kt=2 / 7, mu=0.5, *, coulomb="sharp", damping_n=0.0, damping_t=0.0) -> Law:
    """F_n = k_n δ^{3/2}; F_t = −k_t √δ s, truncated at |F_t| = μ F_n.

    The model force of the papers, without R_eff. With `coulomb="smooth"`, F_t = −k_t √δ (1 + x − x²) s with
    x = |s|/s*, s* = μ (k_n/k_t) δ, whose derivative vanishes at the limit.

    Parameters
    ----------
    kn, kt : float [force/length^{3/2}]
    mu : float, not negative
    coulomb : "sharp" or "smooth"
    damping_n, damping_t : float [force time/length], constant dashpots along the normal and the tangent

    Source
    ------
    Charan et al., doi:10.48550/arXiv.1908.11724, Eqs 1, 3, 5.

    Examples
    --------
    >>> law = hertz_mindlin(kn=1.0, mu=0.5)
    >>> float(normal_force(law.kind, law.table, 0, 0, 0.01))
    0.001
    """
    return _law(HERTZ_MINDLIN, coulomb, kn, kt, mu, damping_n, damping_t)


def linear(kn=1.0, kt=2 / 7, mu=0.5, *, coulomb="sharp", damping_n=0.0, damping_t=0.0) -> Law:
    """F_n = k_n δ; F_t = −k_t s, truncated at |F_t| = μ F_n (smooth: with the factor of `hertz_mindlin`).

    Parameters are those of `hertz_mindlin`, with k_n, k_t in [force/length].

    Source
    ------
    Cundall & Strack, doi:10.1680/geot.1979.29.1.47.
    """
    return _law(LINEAR, coulomb, kn, kt, mu, damping_n, damping_t)


def _law(kind, coulomb, *values) -> Law:
    if coulomb not in COULOMB:
        raise ValueError(f"coulomb={coulomb!r} was given: 'sharp' and 'smooth' are allowed")
    for name, value in zip(PARAMETERS, values, strict=True):
        _check_parameter(name, value)
    return Law(kind, COULOMB[coulomb], np.array(values, float)[None, None, :].copy())


def _check_parameter(name, value):
    if name not in PARAMETERS:
        raise ValueError(f"a law has no parameter {name!r}: it has {', '.join(PARAMETERS)}")
    low_ok = value > 0 if name == "kn" else value >= 0
    if not (np.isfinite(value) and low_ok):
        raise ValueError(
            f"{name} = {value} was given: it must be finite and {'positive' if name == 'kn' else 'not negative'}"
        )


def between(law: Law, a: int, b: int, **parameters) -> Law:
    """The same law with other parameters between materials `a` and `b`; new materials start as copies of material 0.

    Examples
    --------
    >>> law = between(hertz_mindlin(mu=0.5), 0, 1, mu=0.2)   # grains are material 0, walls material 1
    >>> [float(law.table[0, m, MU]) for m in (0, 1)]
    [0.5, 0.2]
    """
    size = max(len(law.table), a + 1, b + 1)
    table = np.empty((size, size, len(PARAMETERS)))
    table[:] = law.table[0, 0]
    old = len(law.table)
    table[:old, :old] = law.table
    for name, value in parameters.items():
        _check_parameter(name, value)
        table[a, b, PARAMETERS.index(name)] = table[b, a, PARAMETERS.index(name)] = value
    return law._replace(table=table)


@njit(fastmath=True, error_model="numpy")
def normal_force(kind, p, a, b, overlap):
    """Elastic normal force [force], positive for repulsion; overlap > 0."""
    if kind == HERTZ_MINDLIN:
        return p[a, b, KN] * overlap * np.sqrt(overlap)
    return p[a, b, KN] * overlap


@njit(fastmath=True, error_model="numpy")
def normal_energy(kind, p, a, b, overlap):
    """Work done against the elastic normal force [energy]; overlap > 0."""
    power = 2.5 if kind == HERTZ_MINDLIN else 2.0
    return normal_force(kind, p, a, b, overlap) * overlap / power


@njit(fastmath=True, error_model="numpy")
def tangential_stiffness(kind, p, a, b, overlap):
    """Stiffness of the unmobilised tangential spring [force/length]; overlap > 0."""
    if kind == HERTZ_MINDLIN:
        return p[a, b, KT] * np.sqrt(overlap)
    return p[a, b, KT] + 0.0 * overlap


@njit(fastmath=True, error_model="numpy")
def mobilised(coulomb, x):
    """Factor on the tangential stiffness of a spring whose force k_t |s| is the share x of Coulomb's limit."""
    if coulomb == SMOOTH:
        return 1.0 + x - x * x
    return 1.0 + 0.0 * x


@njit(fastmath=True, error_model="numpy")
def tangents(kind, p, a, b, overlap):
    """d(normal force)/d(overlap) and d(tangential stiffness)/d(overlap), by a complex step."""
    z = complex(overlap, _H)
    return normal_force(kind, p, a, b, z).imag / _H, tangential_stiffness(kind, p, a, b, z).imag / _H


@njit(fastmath=True, error_model="numpy")
def mobilised_tangent(coulomb, x):
    """d(mobilised)/dx, by a complex step."""
    return mobilised(coulomb, complex(x, _H)).imag / _H
