"""Fits of elasticity and of screening by dipoles, even and odd, to displacements around a center."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import jv, spherical_jn, spherical_yn, stdtrit, yv

from ..core.readable import readable
from ..core.sizes import Size, require_sizes

FEWEST, GRAINS = 5, 10  # rings of a fit, and grains of a ring
MANY = 10  # centers from which errors are those of the scatter between them
STRONG = 6.0  # smallest significant difference of AICc: a likelihood ratio of 20
CONFIDENCE = 0.95  # of intervals
ELASTIC_BELOW = 1e-6  # |κ| r below which the functions of elasticity are used
ROUND_OFF = 1e-12  # smallest scatter over the radial displacement
MODELS = ("elastic", "dipole", "odd")  # with 0, 1 and 2 components of κ²
ANGLES = 8  # of κ² from which fits start


@readable
class Rings(NamedTuple):
    """Mean displacements in rings around a center, in shells in three dimensions."""

    radius: np.ndarray  # (Q,) [length]
    spread: np.ndarray  # (Q,) standard deviation of the distances in each [length]
    mean: np.ndarray  # (k, Q) radial and, in the plane (k = 2), tangential displacement [length]
    error: np.ndarray  # (k, Q) standard errors: scatter in the ring, enlarged because neighbors move together [length]
    covariance: np.ndarray  # (kQ, kQ) of `mean.ravel()`, from the scatter between parts [length²]
    count: np.ndarray  # (Q,) displacements in each ring
    parts: int  # independent parts whose scatter is the error: centers, or sectors around them


@readable
class DisplacementFit(NamedTuple):
    """Fit of w'' + w'/r − w/r² = −κ² w to w = u_r + i u_θ, κ² = κ_e² + iκ_o², or of its like in three dimensions.

    w = near f(r) + far g(r), with f → 1/r^(dim−1) and g → r where |κ| r is small.
    """

    model: str  # "elastic" (κ² = 0), "dipole" (κ_o² = 0) or "odd"
    near: complex  # amplitude of 1/r^(dim−1) [length^dim]
    far: complex  # amplitude of r
    screening: complex  # κ² = κ_e² + iκ_o² [1/length²]
    errors: np.ndarray  # half 95 % intervals of Re near, Re far, Im near, Im far, κ_e², κ_o², as far as fitted
    misfit: float  # χ²
    aicc: float  # AICc, χ² over its excess in the richest model; compare those of fits to the same rings
    rings: Rings

    def displacement(self, distance: np.ndarray) -> np.ndarray:
        """Complex u_r + i u_θ at distances (K,) [length]."""
        near = np.array([self.near, self.far])
        return _functions(self.screening, np.asarray(distance, float), self.rings) @ near


@readable(head=lambda fits: fits.verdict)
class ScreeningFits(NamedTuple):
    """Fits of elasticity, screening by dipoles and odd screening to the same rings, with free amplitudes.

    The amplitudes are free, so that the fits hold inside any boundary. κ_e² may be negative. Intervals follow from the
    covariance of the rings, which move together. AICc is that of overdispersed data (Burnham & Anderson,
    doi:10.1007/b97636, § 2.5).

    Source
    ------
    Lemaître et al., doi:10.1103/PhysRevE.104.024904, for screening by dipoles; Cohen et al.,
    doi:10.48550/arXiv.2310.09942, and Livne et al., doi:10.1039/d4sm01429d, for odd screening.
    """

    rings: Rings
    models: list[DisplacementFit]  # "elastic", "dipole" and, in the plane, "odd"
    lame: float  # A that the moduli predict; NaN if they do not [length^dim]

    @property
    def preferred(self) -> str:
        """Simplest model whose AICc is within 6 of the lowest."""
        low = min(fit.aicc for fit in self.models)
        return next(fit.model for fit in self.models if fit.aicc <= low + STRONG)

    @property
    def verdict(self) -> str:
        """Sentence that says whether the sample answered as an elastic body."""
        elastic, best = self.models[0], self.models[MODELS.index(self.preferred)]
        if best is elastic:
            gain = elastic.aicc - min(fit.aicc for fit in self.models[1:])
            expected = "" if np.isnan(self.lame) else f"; {self.lame:.3g} from the moduli"
            how = f"as an elastic body: A = {elastic.near.real:.3g} ± {elastic.errors[0]:.2g}{expected}"
            return f"{how} (screening {'lowers' if gain > 0 else 'raises'} AICc by {abs(gain):.2g})"
        values, errors = (best.screening.real, best.screening.imag), best.errors[2 * len(self.rings.mean) :]
        parts = zip(("κ_e²", "κ_o²"), values, errors, strict=False)
        text = ", ".join(f"{name} = {value:.3g} ± {error:.2g}" for name, value, error in parts)
        return f"screened by dipoles: {text} (ΔAICc = {elastic.aicc - best.aicc:.3g} to an elastic body)"


def rings_of(offset, components, counted, width: float, within: tuple[float, float]) -> Rings:
    """Means over rings of a width between two distances, whose errors are those of centers or sectors.

    Parameters
    ----------
    offset : (M, N, dim) [length]
    components : distance, radial and tangential displacement, (M, N) each [length]
    counted : (M, N) bool
    """
    ring = np.floor((components[0] - within[0]) / width)
    whole = max(int(np.floor((within[1] - within[0]) / width + 1e-9)), 0)
    require_sizes([Size("rings to that distance are", whole, "points", "use a smaller outer distance")])
    counted = counted & (ring >= 0) & (ring < whole)
    number = np.bincount(ring[counted].astype(int), minlength=whole)
    full = number >= GRAINS
    if full.sum() < FEWEST:
        raise ValueError(
            f"{full.sum()} rings of width {width:.3g} between the distances {within[0]:.3g} and {within[1]:.3g} have "
            f"{GRAINS} grains: a fit needs {FEWEST}; use a larger packing or more centers"
        )
    counted[counted] = full[ring[counted].astype(int)]
    ring = (np.cumsum(full) - 1)[ring[counted].astype(int)]
    values = [part[counted] for part in components[: 5 - offset.shape[2]]]
    return _ring_means(ring, values, *_parts(offset, counted))


def _parts(offset: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, int]:
    """Independent part of each displacement that counts: its center, or its sector of eight; and how many there are."""
    center = np.broadcast_to(np.arange(len(offset))[:, None], counted.shape)[counted]
    if len(offset) >= MANY:
        return center, len(offset)
    away = offset[counted]
    if away.shape[1] == 2:
        return 8 * center + np.floor(np.arctan2(away[:, 1], away[:, 0]) / (np.pi / 4)).astype(int) % 8, 8 * len(offset)
    return 8 * center + (away > 0) @ np.array([1, 2, 4]), 8 * len(offset)


def _ring_means(ring: np.ndarray, values: list[np.ndarray], part: np.ndarray, parts: int) -> Rings:
    """Rings of distances and displacements, from the ring and the part of each."""
    count = np.bincount(ring)
    means = np.array([np.bincount(ring, value) / count for value in values])
    deviations = np.array(values) - means[:, ring]
    variance = np.array([np.bincount(ring, deviation**2) / count for deviation in deviations])
    place = part * len(count) + ring
    sums = [np.bincount(place, deviation, parts * len(count)).reshape(parts, -1) / count for deviation in deviations]
    apart = np.hstack(sums[1:])
    covariance = apart.T @ apart * parts / (parts - 1)
    naive = (variance[1:] + ROUND_OFF**2 * np.square(values[1]).mean()) / count
    enlarged = (np.diag(covariance).reshape(naive.shape) / naive).mean(axis=1, keepdims=True)
    return Rings(means[0], np.sqrt(variance[0]), means[1:], np.sqrt(enlarged * naive), covariance, count, parts)


def screening_fits(rings: Rings, lame: float) -> ScreeningFits:
    """Fit all models to rings; `lame` is the amplitude that the moduli predict."""
    minima = [_minimum(rings, unknowns) for unknowns in range(len(rings.mean) + 1)]
    parts, left = minima[-1]
    excess = max(1.0, left @ left / (len(left) - 2 * len(rings.mean) - len(parts)))
    return ScreeningFits(rings, [_fit(rings, *minimum, excess) for minimum in minima], float(lame))


def _functions(screening: complex, distance: np.ndarray, rings: Rings) -> np.ndarray:
    """(K, 2) solutions f and g, which are analytic in κ² and are those of elasticity at κ² = 0."""
    scale, k = float(np.sqrt(rings.radius[0] * rings.radius[-1])), np.sqrt(complex(screening))
    planar = len(rings.mean) == 2
    if abs(k) * scale < ELASTIC_BELOW:
        return np.stack([distance ** (-1.0 if planar else -2.0), distance], axis=1).astype(complex)
    x = k * distance
    if not planar:
        return np.stack([-(k**2) * spherical_yn(1, x), 3 * spherical_jn(1, x) / k], axis=1)
    far = 2 * jv(1, x) / k
    return np.stack([-np.pi / 2 * k * yv(1, x) + k**2 / 2 * np.log(k * scale) * far, far], axis=1)


def _design(screening: complex, rings: Rings) -> np.ndarray:
    """(kQ, 2k) displacements in rings per real amplitude: Re near, Re far and, in the plane, Im near, Im far.

    The mean over a ring is that of two distances with the mean and variance of its own, exact to third order.
    """
    f = sum(_functions(screening, rings.radius + side * rings.spread, rings) for side in (-1, 1)) / 2
    return f.real if len(rings.mean) == 1 else np.block([[f.real, -f.imag], [f.imag, f.real]])


def _solve(screening: complex, rings: Rings) -> tuple[np.ndarray, np.ndarray]:
    """Best real amplitudes, and residuals in units of the errors (kQ,)."""
    weight = 1 / rings.error.ravel()
    design = _design(screening, rings) * weight[:, None]
    size = np.linalg.norm(design, axis=0)
    amplitude = np.linalg.lstsq(design / size, rings.mean.ravel() * weight, rcond=None)[0] / size
    return amplitude, rings.mean.ravel() * weight - design @ amplitude


def _minimum(rings: Rings, unknowns: int) -> tuple[np.ndarray, np.ndarray]:
    """κ² (its real and imaginary part, as far as unknown), and residuals, of the best fit from many starts.

    Waves are not shorter than four rings.
    """
    if not unknowns:
        return np.zeros(0), _solve(0.0, rings)[1]
    extent, width = np.ptp(rings.radius), np.diff(rings.radius).min()
    unit, top = (np.pi / 2 / extent) ** 2, (np.pi / 2 / width) ** 2

    def residuals(x: np.ndarray) -> np.ndarray:
        return _solve(_screening(unit * x), rings)[1]

    sizes = np.arange(1, np.sqrt(top / unit)) ** 2
    turns = np.exp(2j * np.pi * np.arange(ANGLES) / ANGLES)[:: 1 if unknowns == 2 else ANGLES // 2]
    starts = [np.array([(size * turn).real, (size * turn).imag])[:unknowns] for size in sizes for turn in turns]
    starts = sorted(starts, key=lambda x: (residuals(x) ** 2).sum())[:unknowns]
    bound = top / unit
    ends = [least_squares(residuals, x, bounds=(-bound, bound)) for x in [*starts, np.zeros(unknowns)]]
    best = min(ends, key=lambda end: end.cost)
    return unit * best.x, best.fun


def _screening(parts: np.ndarray) -> complex:
    return complex(*np.append(parts, np.zeros(2 - len(parts))))


def _fit(rings: Rings, parts: np.ndarray, left: np.ndarray, excess: float) -> DisplacementFit:
    """Fit at a minimum, with intervals and AICc."""
    screening = _screening(parts)
    amplitude, _ = _solve(screening, rings)
    step = 1e-4 / rings.radius[-1] ** 2
    slopes = [
        (_design(screening + step * way, rings) - _design(screening - step * way, rings)) @ amplitude / (2 * step)
        for way in (1, 1j)[: len(parts)]
    ]
    weight = 1 / rings.error.ravel()
    jacobian = np.column_stack([_design(screening, rings), *slopes]) * weight[:, None]
    size = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.pinv(jacobian / size) / size[:, None] * weight
    covariance = inverse @ rings.covariance @ inverse.T
    quantile = stdtrit(rings.parts - 1, (1 + CONFIDENCE) / 2)
    unknowns, data = len(amplitude) + len(parts), len(left)
    aicc = left @ left / excess + 2 * unknowns + 2 * unknowns * (unknowns + 1) / (data - unknowns - 1)
    near, far = amplitude[:2] if len(amplitude) == 2 else amplitude[:2] + 1j * amplitude[2:]
    errors = quantile * np.sqrt(np.diag(covariance))
    return DisplacementFit(
        MODELS[len(parts)], complex(near), complex(far), screening, errors, float(left @ left), float(aicc), rings
    )
