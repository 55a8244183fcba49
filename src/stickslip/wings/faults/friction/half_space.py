"""Stress and displacement due to slip on a dipping fault below a free surface, in plane strain.

Points are ζ = x + iz, with x horizontal and the depth z ≥ 0. The fault is ζ = ξ t with t = e^{iψ}, dip ψ and distance ξ
down dip; its hanging wall is at larger x. Slip δ is that of a thrust: the foot wall moves along t, relative to the
hanging wall. A fault that slips by δ from the end s₁ down to s₂ has the potentials φ(s₁) − φ(s₂) and ψ(s₁) − ψ(s₂) of
two edge dislocations (N. I. Muskhelishvili, Some Basic Problems of the Mathematical Theory of Elasticity, 1953),

    φ = γ ln(ζ − s) − γ ln(ζ − s*) − γ* (s* − s)/(ζ − s*),   γ = i G t δ/[4π (1 − ν)],

with * for the conjugate and the first term for an infinite body; the others remove the tractions at the surface. The
solution is that of A. K. Head, Proc. Phys. Soc. B 66, 793 (1953); P. Segall (2010), chapter 3, has it for faults.
"""

import numpy as np


def half_space_stress(at, ends, dip: float, *, image: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Stress due to unit slip of cells, over G/(1 − ν); tension is positive.

    Parameters
    ----------
    at : (P,) complex points x + iz
    ends : (N + 1,) distances down dip between which the N cells slip
    dip : ψ [degrees]
    image : only the part that the free surface adds to the stress in an infinite body

    Returns
    -------
    (σ_xx + σ_zz)/2 and (σ_zz − σ_xx)/2 + i σ_xz, each (P, N) [1/length]. On a plane of dip ψ, the normal stress σ_n and
    the shear stress τ that drives a thrust are σ_n + i τ = first + e^{2iψ} second.

    Examples
    --------
    >>> mean, deviator = half_space_stress([3.0 + 0j], [1.0, 2.0], 30.0)
    >>> surface = mean + deviator  # σ_zz + i σ_xz at the surface
    >>> print(abs(surface).max() < 1e-15)
    True
    """
    zeta, t = np.asarray(at, complex)[:, None], np.exp(1j * np.radians(dip))
    s, gamma = np.asarray(ends) * t, 0.25j / np.pi * t
    away = zeta - s.conj()
    drop = gamma.conj() * (s.conj() - s)
    first = -gamma / away + drop / away**2  # φ'
    deviator = (zeta.conj() - zeta) * (gamma / away**2 - 2 * drop / away**3) - gamma.conj() / away - first
    if not image:
        near = zeta - s
        first = first + gamma / near
        deviator = deviator + gamma.conj() / near - gamma * near.conj() / near**2
    return -np.diff(2 * first.real, axis=1), -np.diff(deviator, axis=1)


def surface_displacement(x, ends, dip: float) -> np.ndarray:
    """Displacement of points of the surface due to unit slip of cells: horizontal, and i times downward (P, N).

    It does not depend on Poisson's ratio.

    Parameters
    ----------
    x : (P,) distances from the trace, not 0, positive above the hanging wall
    ends, dip : as in `half_space_stress`

    Examples
    --------
    A vertical fault that slips by 1 down to a great depth moves both sides by a half:

    >>> print(np.round(surface_displacement([1.0, -1.0], [0.0, 1e9], 90.0).imag.ravel(), 3))
    [-0.5  0.5]
    """
    x, t = np.asarray(x, float)[:, None], np.exp(1j * np.radians(dip))
    s = np.asarray(ends) * t
    turn = np.angle((x - s[:-1]) / (x - s[1:]))
    return (-t * turn - t.conj() * np.diff(s.imag / (x - s.conj()), axis=1)) / np.pi
