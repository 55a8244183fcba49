"""Laws of bonds between grains: springs, elastic beams, and parallel bonds; used by `packings.bonded`."""

from typing import NamedTuple

import numpy as np

from ..arguments import NotNegative, Positive, checked
from ..fields import LARGEST
from ..readable import readable

# how the strengths in tension, shear, bending and twisting are combined, see `core.h`
BY_STRETCH, BY_SUM, BY_BEAM = 0, 1, 2
UNBREAKABLE = 1e300
_NAMES = {BY_STRETCH: "spring", BY_SUM: "beam", BY_BEAM: "parallel bond"}
_NO = 0.0, 0.0, 0.0, 0.0


@readable(head=lambda bond: _NAMES[bond.form])
class Bond(NamedTuple):
    """Law of a bond, from a function such as `laws.spring_bond`. Tuples contain tension, shear, bending, twisting."""

    MADE_BY = "laws.spring_bond"

    form: int  # how strengths are combined
    stiffness: tuple[float, float, float, float]  # parallel bonds: two per area [force/length³], then zeros
    strength: tuple[float, float, float, float]  # springs: a strain; parallel bonds: two stresses, then zeros
    damping: tuple[float, float, float, float] = _NO
    fading: int = 0  # exponent p: before failure, loads are multiplied by 1 − (load/strength)^p; 0: they are not
    normalized: bool = False  # the first two stiffnesses are divided by the length at rest
    size: float | np.ndarray = 1.0  # radius of a parallel bond in radii of the smaller grain, (K,) in `coefficients`


@checked
def spring_bond(
    k: Positive, stretch: Positive | None = None, *, damping: NotNegative = 0.0, smooth: bool = True,
    normalized: bool = False,
) -> Bond:  # fmt: skip
    """Bond as a spring along the line of centres, as in LAMMPS `bpm/spring`: F = k (r₀ − r) − γ v_n on i.

    Parameters
    ----------
    k : stiffness [force/length]
    stretch : |r − r₀|/r₀ at which the bond breaks; by default, it never breaks
    damping : γ [force time/length]
    smooth : before the bond breaks, its load is multiplied by 1 − (fraction of `stretch`)⁸
    normalized : k is a force that is divided by r₀

    Examples
    --------
    >>> spring_bond(10.0, 0.05)
    Bond: spring
    """
    strength = UNBREAKABLE if stretch is None else stretch
    fading = 8 if smooth and stretch is not None else 0
    return Bond(
        BY_STRETCH, (k, 0.0, 0.0, 0.0), (strength, *[UNBREAKABLE] * 3), (damping, 0.0, 0.0, 0.0), fading, normalized
    )


@checked
def beam_bond(
    tension: Positive, shear: NotNegative, bending: NotNegative, twisting: NotNegative, *,
    strength: tuple[float, float, float, float] | None = None,
    damping: tuple[float, float, float, float] = _NO, smooth: bool = True, normalized: bool = False,
) -> Bond:  # fmt: skip
    """Bond that resists tension, shear, bending and twisting, as in LAMMPS `bpm/rotational`; see `contacts/bonds.py`.

    It breaks when F_n/F_c + |F_s|/F_s,c + |M_b|/M_b,c + |M_t|/M_t,c = 1, with F_n < 0 in compression.

    Parameters
    ----------
    tension, shear : stiffnesses [force/length]
    bending, twisting : stiffnesses [force length]
    strength : the four denominators, two in [force] and two in [force length]; by default, the bond never breaks
    damping : γ of the normal, tangential, rolling and twisting velocities, as in LAMMPS
    smooth : before the bond breaks, its loads are multiplied by 1 − (fraction of the strength)⁴
    normalized : the first two stiffnesses are forces that are divided by the length at rest

    Source
    ------
    doi:10.1007/978-3-540-85879-9_6

    Examples
    --------
    >>> beam_bond(10.0, 5.0, 1.0, 1.0, strength=(0.1, 0.1, 0.05, 0.05))
    Bond: beam
    """
    stiffness = tension, shear, bending, twisting
    fading = 4 if smooth and strength is not None else 0
    limits = (UNBREAKABLE,) * 4 if strength is None else strength
    _require_four("strength", limits, least=1 / LARGEST)
    _require_four("damping", damping, least=0.0)
    return Bond(BY_SUM, stiffness, tuple(map(float, limits)), tuple(map(float, damping)), fading, normalized)


@checked
def parallel_bond(
    normal: Positive, shear: NotNegative, tensile_strength: Positive | None = None,
    shear_strength: Positive | None = None, *, radius: Positive = 1.0,
) -> Bond:  # fmt: skip
    """Parallel bond of Potyondy & Cundall: a disk of cement between two grains, or a strip between two disks.

    The cement has the radius R = `radius` min(R_i, R_j), the area A and the moments of inertia I and J (for disks of
    unit thickness, A = 2R and I = 2R³/3). It breaks when F_n/A + |M_b| R/I reaches the tensile strength, or |F_s|/A +
    |M_t| R/J the shear strength.

    Parameters
    ----------
    normal, shear : stiffnesses per area [force/length³]
    tensile_strength, shear_strength : stresses [force/length²]; unbreakable by default

    Source
    ------
    doi:10.1016/j.ijrmms.2004.09.011, here in total rather than incremental form: equal to first order in the rotations.

    Examples
    --------
    >>> parallel_bond(1e9, 4e8, 1e6, 2e6)
    Bond: parallel bond
    """
    limits = tuple(UNBREAKABLE if limit is None else limit for limit in (tensile_strength, shear_strength))
    return Bond(BY_BEAM, (normal, shear, 0.0, 0.0), (*limits, 0.0, 0.0), size=radius)


def _require_four(name: str, values, least: float) -> None:
    if not (len(values) == 4 and all(least <= value < np.inf for value in values)):
        kind = f"finite numbers of at least {least:g}" if least else "finite nonnegative numbers"
        remedy = " (1e300: never)" if least else ""
        raise ValueError(f"{name} must be four {kind}, for tension, shear, bending and twisting{remedy}, got {values}")


def coefficients(bond: Bond, dim: int, radius_i, radius_j, length):
    """Stiffness, damping and strength (K, 4), and the distance from j to the shear force, in bond lengths, (K,)."""
    k = len(length)
    stiffness, damping, strength = (np.tile(row, (k, 1)) for row in (bond.stiffness, bond.damping, bond.strength))
    if bond.normalized:
        stiffness[:, :2] /= length[:, None]
    if bond.form == BY_STRETCH:
        strength[:, 0] = np.minimum(strength[:, 0] * stiffness[:, 0] * length, UNBREAKABLE)
    if bond.form != BY_BEAM:
        return stiffness, damping, strength, np.full(k, 0.5)
    size = bond.size * np.minimum(radius_i, radius_j)
    area, bending, twisting = np.pi * size**2, np.pi * size**4 / 4, np.pi * size**4 / 2
    if dim == 2:
        area, bending, twisting = 2 * size, 2 * size**3 / 3, 0 * size
    normal, shear = bond.stiffness[:2]
    stiffness = np.stack([normal * area, shear * area, normal * bending, shear * twisting], axis=1)
    tensile, sheared = bond.strength[:2]
    with np.errstate(over="ignore"):  # strengths beyond UNBREAKABLE
        twisted = sheared * twisting / size if dim == 3 else np.full(k, UNBREAKABLE)
        strength = np.stack([tensile * area, sheared * area, tensile * bending / size, twisted], axis=1)
    return stiffness, damping, np.minimum(strength, UNBREAKABLE), 0.5 + (radius_j - radius_i) / (2 * length)
