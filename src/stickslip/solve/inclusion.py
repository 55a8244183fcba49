"""Inflation of grains in a packing: displacements around them, and fits of an elastic response or of screening."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import jv, spherical_jn, spherical_yn, stdtrit, yv

from ..core.arguments import Bodies, NotNegative, checked, require_not_negative
from ..core.contacts.forces import FREE, HELD, forces
from ..core.contacts.jacobian import blocks_of, linearise
from ..core.control import body_numbers
from ..core.laws.builtin import Law
from ..core.measure import overlaps, pressure, volume
from ..core.progress import Size, require_sizes
from ..core.readable import pluralize, readable
from ..core.state import State
from .balance import LinearisedState, balanced
from .freedom import Freedom, displaced, residual_vector, resized, stiffness_of
from .gradient import STENCIL
from .moduli import elastic_moduli, solve_resisted

FEWEST, GRAINS = 5, 10  # smallest numbers of rings in a fit, and of grains in a ring
MANY = 10  # smallest number of centres whose scatter gives the errors; with fewer centres, sectors are used
STRONG = 6.0  # smallest significant difference of AICc: a likelihood ratio of 20
CONFIDENCE = 0.95  # confidence of intervals
ELASTIC_BELOW = 1e-6  # |κ| r below which the solutions without screening are used
ROUND_OFF = 1e-12  # smallest scatter over the radial displacement
MODELS = ("elastic", "dipole", "odd")  # models with 0, 1 and 2 components of κ²
ANGLES = 8  # number of angles of κ² from which fits start
SMALL = 0.02  # step of finite differences over the smallest overlap or gap of a grain that grows
LEAST = 1e-9  # smallest growth of a grain, above the round-off of positions and pressures
RANGE = 0.25  # largest displacement over the skin of the contact list for which the list is valid
INNER = 2.0  # inner radius of a fit, in mean diameters


@readable
class Rings(NamedTuple):
    """Mean displacements in rings around a centre (shells in three dimensions)."""

    radius: np.ndarray  # (Q,) [length]
    spread: np.ndarray  # (Q,) standard deviation of the distances in each ring [length]
    mean: np.ndarray  # (k, Q) radial and, in the plane (k = 2), tangential displacement [length]
    error: np.ndarray  # (k, Q) standard errors: scatter in the ring, enlarged because neighbours move together [length]
    covariance: np.ndarray  # (kQ, kQ) covariance of `mean.ravel()`, from the scatter between parts [length²]
    count: np.ndarray  # (Q,) number of displacements in each ring
    parts: int  # number of independent parts whose scatter gives the errors: centres, or sectors around them


@readable
class DisplacementFit(NamedTuple):
    """Fit of w'' + w'/r − w/r² = −κ² w to w = u_r + i u_θ, κ² = κ_e² + iκ_o², or of its three-dimensional counterpart.

    w = near f(r) + far g(r), with f → 1/r^(dim−1) and g → r where |κ| r is small.
    """

    model: str  # "elastic" (κ² = 0), "dipole" (κ_o² = 0) or "odd"
    near: complex  # amplitude of 1/r^(dim−1) [length^dim]
    far: complex  # amplitude of r
    screening: complex  # κ² = κ_e² + iκ_o² [1/length²]
    errors: np.ndarray  # half-widths of 95 % intervals: Re near, Re far, Im near, Im far, κ_e², κ_o², if fitted
    misfit: float  # χ²
    aicc: float  # AICc, with χ² divided by the overdispersion in the richest model; comparable for the same rings
    rings: Rings

    def displacement(self, distance: np.ndarray) -> np.ndarray:
        """Complex u_r + i u_θ at distances (K,) [length]."""
        near = np.array([self.near, self.far])
        return _functions(self.screening, np.asarray(distance, float), self.rings) @ near


@readable(head=lambda fits: fits.verdict)
class ScreeningFits(NamedTuple):
    """Fits of elasticity, of screening by dipoles and of odd screening to the same rings, with free amplitudes.

    The amplitudes are free, so that the fits are valid inside any boundary. κ_e² may be negative. Intervals follow from
    the covariance of the rings, whose displacements are correlated. AICc is that of overdispersed data (Burnham &
    Anderson, doi:10.1007/b97636, § 2.5).

    Source
    ------
    Lemaître et al., doi:10.1103/PhysRevE.104.024904, for screening by dipoles; Cohen et al.,
    doi:10.48550/arXiv.2310.09942, and Livne et al., doi:10.1039/d4sm01429d, for odd screening.
    """

    rings: Rings
    models: list[DisplacementFit]  # "elastic", "dipole" and, in the plane, "odd"
    lame: float  # A predicted by the moduli; NaN without a prediction [length^dim]

    @property
    def preferred(self) -> str:
        """Simplest model whose AICc is within 6 of the lowest."""
        low = min(fit.aicc for fit in self.models)
        return next(fit.model for fit in self.models if fit.aicc <= low + STRONG)

    @property
    def verdict(self) -> str:
        """Sentence on whether the packing responded like an elastic body."""
        elastic, best = self.models[0], self.models[MODELS.index(self.preferred)]
        if best is elastic:
            gain = elastic.aicc - min(fit.aicc for fit in self.models[1:])
            expected = "" if np.isnan(self.lame) else f"; {self.lame:.3g} from the moduli"
            how = f"like an elastic body: A = {elastic.near.real:.3g} ± {elastic.errors[0]:.2g}{expected}"
            return f"{how} (screening {'lowers' if gain > 0 else 'raises'} AICc by {abs(gain):.2g})"
        values, errors = (best.screening.real, best.screening.imag), best.errors[2 * len(self.rings.mean) :]
        parts = zip(("κ_e²", "κ_o²"), values, errors, strict=False)
        text = ", ".join(f"{name} = {value:.3g} ± {error:.2g}" for name, value, error in parts)
        return f"screened by dipoles: {text} (ΔAICc = {elastic.aicc - best.aicc:.3g} relative to an elastic body)"


def rings_of(offset, components, counted, width: float, within: tuple[float, float]) -> Rings:
    """Means over rings of a given width between two distances; errors follow from the scatter of centres or sectors.

    Parameters
    ----------
    offset : (M, N, dim) positions relative to the centres [length]
    components : distance, radial and tangential displacement, (M, N) each [length]
    counted : (M, N) bool, True for displacements that count
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
            f"at least {GRAINS} grains: a fit needs {FEWEST}; use a larger packing or more centres"
        )
    counted[counted] = full[ring[counted].astype(int)]
    ring = (np.cumsum(full) - 1)[ring[counted].astype(int)]
    values = [part[counted] for part in components[: 5 - offset.shape[2]]]
    return _ring_means(ring, values, *_parts(offset, counted))


def _parts(offset: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, int]:
    """Part to which each counted displacement belongs, a centre or one of eight sectors, and the number of parts."""
    center = np.broadcast_to(np.arange(len(offset))[:, None], counted.shape)[counted]
    if len(offset) >= MANY:
        return center, len(offset)
    away = offset[counted]
    if away.shape[1] == 2:
        return 8 * center + np.floor(np.arctan2(away[:, 1], away[:, 0]) / (np.pi / 4)).astype(int) % 8, 8 * len(offset)
    return 8 * center + (away > 0) @ np.array([1, 2, 4]), 8 * len(offset)


def _ring_means(ring: np.ndarray, values: list[np.ndarray], part: np.ndarray, parts: int) -> Rings:
    """Means of distances and displacements over rings, given the ring and the part of each value."""
    count = np.bincount(ring)
    means = np.array([np.bincount(ring, value) / count for value in values])
    deviations = np.array(values) - means[:, ring]
    variance = np.array([np.bincount(ring, deviation**2) / count for deviation in deviations])
    index = part * len(count) + ring
    sums = [np.bincount(index, deviation, parts * len(count)).reshape(parts, -1) / count for deviation in deviations]
    apart = np.hstack(sums[1:])
    covariance = apart.T @ apart * parts / (parts - 1)
    naive = (variance[1:] + ROUND_OFF**2 * np.square(values[1]).mean()) / count
    enlarged = (np.diag(covariance).reshape(naive.shape) / naive).mean(axis=1, keepdims=True)
    return Rings(means[0], np.sqrt(variance[0]), means[1:], np.sqrt(enlarged * naive), covariance, count, parts)


def screening_fits(rings: Rings, lame: float) -> ScreeningFits:
    """Fit all models to rings; `lame` is the amplitude predicted by the moduli."""
    minima = [_minimum(rings, unknowns) for unknowns in range(len(rings.mean) + 1)]
    parts, left = minima[-1]
    excess = max(1.0, left @ left / (len(left) - 2 * len(rings.mean) - len(parts)))
    return ScreeningFits(rings, [_fit(rings, *minimum, excess) for minimum in minima], float(lame))


def _functions(screening: complex, distance: np.ndarray, rings: Rings) -> np.ndarray:
    """(K, 2) solutions f and g, which are analytic in κ² and equal those of elasticity at κ² = 0."""
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

    The mean over a ring is replaced by that at two distances with the same mean and variance, exact to third order.
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
    """Unknown real and imaginary parts of κ² in the best fit from many starts, and its residuals.

    Wavelengths shorter than four rings are excluded.
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


@readable(head=lambda field: f"{pluralize(len(field.centers), 'grain')} inflated by {field.growth:g}")
class Inflation(NamedTuple):
    """Displacements in a packing around inflated grains, each in a separate experiment."""

    growth: float  # relative growth of the radii
    centers: np.ndarray  # (M,) numbers of the inflated grains
    offset: np.ndarray  # (M, N, dim) initial position of each grain's nearest image relative to the centre [length]
    displacement: np.ndarray  # (M, N, dim) displacements, less their mean if nothing holds the packing [length]
    counted: np.ndarray  # (M, N) True for grains that count: free, and neither rattlers nor inflated
    diameter: float  # mean diameter [length]
    outer: float  # distance up to which circles or spheres around all centres are whole [length]
    volume: float  # volume of the periodic cell; NaN if grains are held, or if there are walls or open sides
    lame: np.ndarray  # (M,) A of u_r = A/r^(dim−1) + B r from moduli and change of pressure; NaN as above [length^dim]
    states: list[State]  # states at the end of quasi-static steps; empty for a linear response
    changes: np.ndarray  # (M, K, 4) numbers of contacts that opened, closed, began or ceased to slide in each step

    @property
    def dim(self) -> int:
        """Number of dimensions."""
        return self.offset.shape[2]

    @property
    def components(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(M, N) distance from the centre, and radial and (zero in 3D) tangential displacement [length]."""
        distance = np.linalg.norm(self.offset, axis=2)
        n, u = self.offset / np.where(distance == 0, 1.0, distance)[..., None], self.displacement
        turning = n[..., 0] * u[..., 1] - n[..., 1] * u[..., 0] if self.dim == 2 else np.zeros_like(distance)
        return distance, (n * u).sum(axis=2), turning

    def elastic(self, distance: np.ndarray) -> np.ndarray:
        """Radial displacement of an elastic body with the moduli of the packing, without a fit; see `inflate`."""
        share = {2: np.pi, 3: 4 * np.pi / 3}[self.dim] / self.volume
        return self.lame.mean() * (distance ** (1.0 - self.dim) - share * distance)

    def fit(self, *, inner: float | None = None, outer: float | None = None) -> ScreeningFits:
        """Fits of elasticity and of screening to means over rings, and their comparison; see `ScreeningFits`.

        Rings are one mean diameter wide, and shells in three dimensions half as wide. Their errors follow from the
        scatter between centres if there are at least ten, otherwise between eight equal sectors around each, so they
        are valid although neighbours move together.

        Parameters
        ----------
        inner, outer : range of distances; default: from two mean diameters to the attribute `outer` [length]

        Raises
        ------
        ValueError
            If there are fewer than five rings with at least ten grains.
        """
        ends = INNER * self.diameter if inner is None else inner, self.outer if outer is None else outer
        require_not_negative(inner=ends[0], outer=ends[1])
        width = self.diameter / (self.dim - 1)
        return screening_fits(rings_of(self.offset, self.components, self.counted, width, ends), self.lame.mean())


@checked
def inflate(
    state: State, law: Law, grain: Bodies | None = None, *, growth: float = 1e-6, within: NotNegative = 0.0
) -> Inflation:
    """Linear response to the inflation of a grain: u = −J⁻¹ ∂f/∂R · growth · R, with each contact held in its mode.

    A contact that slides keeps sliding, even if it would stick in a step of `protocols.inflate`. Both results agreed to
    0.02 % of the largest displacement for a growth of 1e-6, and to 0.2 % for 1e-5 (`tests/modes/test_inclusion.py`).

    In an isotropic elastic body, u_r averaged over a circle or sphere is A/r^(dim−1) + B r (Lamé). In a periodic cell
    of area or volume V, B = −πA/V or −4πA/3V, and A = M/(2π(K + G)) or M/(4π(K + 4G/3)), with the force dipole M =
    V ΔP for the change ΔP of the pressure of the packing, which includes the response of the neighbours.

    Parameters
    ----------
    grain : number of the grain, or numbers of several grains, which are inflated one at a time; fits use averages over
        all of them; default: the grain nearest to the middle. One factorisation serves all of them
    growth : relative change of the radius; it must be so small that no contact opens, closes or begins to slide
    within : distance from the given centre within which other grains grow with it [length]

    Raises
    ------
    ValueError
        If the forces do not balance; if a grain is a rattler or held; if a contact changes; if nothing resists
        inflation.

    Source
    ------
    Lemaître et al., doi:10.1103/PhysRevE.104.024904, for the problem; Landau & Lifshitz, Theory of Elasticity, § 7.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(300, packing_fraction=0.95, dim=2, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.0)
    >>> field = inflate(state, law, range(0, 300, 6))
    >>> field.fit().preferred
    'elastic'
    """
    here = balanced(state, law)
    centers, grown = inflated_grains(here, grain, growth, within)
    free = here.backbone
    matrix = stiffness_of(here.state, here.line, blocks_of(here.state, law, here.line)[0], free)
    pulls = np.array([_pull(here, rows, free) for rows in grown]).T
    scale = state.grains.radius.mean()  # forces divided by it are of the order of J
    motion = scale * solve_resisted(matrix, pulls / scale, free, "an inflated grain").T

    def at(k: int, growth: float) -> State:
        larger = resized(here.state, state.grains.radius * (1 + growth * grown[k]))
        return displaced(larger, free, growth * motion[k])

    for k, moves in enumerate(motion):
        _check_contacts(here, lambda g, k=k: at(k, g), growth, np.abs(moves).max())
    displacement = growth * np.array([free.spread(moves)[: len(here.loose), :3] for moves in motion])
    return as_inflation(here, centers, grown, growth, displacement, [at(k, growth) for k in range(len(centers))])


def inflated_grains(here: LinearisedState, grain, growth: float, within: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres (M,), and masks of the grains that grow with each, (M, N) bool; raise ValueError if they cannot grow."""
    state, n, moves = here.state, len(here.loose), _moves(here)
    if not (-1 < growth <= 1 and abs(growth) >= LEAST):
        raise ValueError(f"growth must be above −1 and at most 1, and at least {LEAST:g} in size, got {growth:g}")
    if state.control.cell_free.any():
        raise ValueError("the cell follows a stress: hold it while a grain is inflated")
    if not moves.any():
        raise ValueError("no free grain is held by contacts: an inflation needs grains that carry forces")
    if grain is None:
        away = np.linalg.norm(_offsets(state, _middle(state)[None])[0], axis=1)
        grain = np.where(moves, away, np.inf).argmin()
    centers = body_numbers(state.control, grain)
    if not len(centers) or len(np.unique(centers)) < len(centers):
        raise ValueError("give at least one grain, and each grain once")
    for worst in centers[centers >= n]:
        raise ValueError(f"only grains (0 to {n - 1}) can be inflated, but body {worst} is a wall")
    for worst in centers[~moves[centers]]:
        kind = "a rattler" if here.loose[worst] else "held in place"
        raise ValueError(f"grain {worst} is {kind}: inflate a free grain that carries forces")
    size = 100.0 * len(centers) * n
    require_sizes([Size(f"{len(centers)} inflations of {n} grains take", size, "bytes", "inflate fewer grains")])
    grown = np.linalg.norm(_offsets(state, state.grains.position[centers]), axis=2) <= within
    grown[np.arange(len(centers)), centers] = True
    return centers, grown


def as_inflation(here: LinearisedState, centers, grown, growth, displacement, ends, changes=None) -> Inflation:
    """Result for displacements (M, N, 3), less any free translation, and final states."""
    state, law, moves, dim = here.state, here.law, _moves(here), here.state.cell.dim
    lame, size, control = np.full(len(centers), np.nan), np.nan, state.control
    if not len(state.walls.mass) and not control.spring.any() and control.free[:, :dim].all():
        displacement = displacement - displacement[:, moves].mean(axis=1)[:, None] * moves[:, None]
        if state.cell.periodic[:dim].all() and not (control.group >= 0).any():
            moduli, size = elastic_moduli(state, law), volume(state)
            rise = np.array([pressure(end, law) for end in ends]) - pressure(state, law)
            lame = rise * size / (2 * np.pi * (dim - 1) * (moduli.bulk + (2 - 2 / dim) * moduli.shear))
    offset = _offsets(state, state.grains.position[centers])
    outer = min(_distance_to_boundary(state, g, off) for g, off in zip(centers, offset, strict=True))
    steps, changes = ([], np.zeros((len(centers), 0, 4), int)) if changes is None else (ends, np.array(changes))
    return Inflation(
        growth, centers, offset[..., :dim], displacement[..., :dim], moves & ~grown, 2 * state.grains.radius.mean(),
        outer, size, lame, steps, changes,
    )  # fmt: skip


def _moves(here: LinearisedState) -> np.ndarray:
    """(N,) grains that are free in all directions of translation and are not rattlers."""
    return here.state.control.free[: len(here.loose), : here.state.cell.dim].all(axis=1) & ~here.loose


def _offsets(state: State, points: np.ndarray) -> np.ndarray:
    """(M, N, 3) positions of nearest images relative to points, within half the height of the cell [length]."""
    away = state.grains.position - points[:, None]
    cell = np.where(state.cell.periodic[:, None], state.cell.vectors, np.eye(3))
    return away - np.round(away @ np.linalg.inv(cell)) * state.cell.periodic @ cell


def _middle(state: State) -> np.ndarray:
    """(3,) middle of the cell or, along axes that are not periodic, of the grains [length]."""
    position = state.grains.position
    middle = (position.min(axis=0) + position.max(axis=0)) / 2
    return np.where(state.cell.periodic, state.cell.vectors.sum(axis=0) / 2, middle)


def _distance_to_boundary(state: State, center: int, offset: np.ndarray) -> float:
    """Radius of the largest circle or sphere around a centre that lies in the cell and among free grains [length]."""
    dim, from_center = state.cell.dim, state.grains.position - state.grains.position[center]
    height = 1 / np.linalg.norm(np.linalg.inv(state.cell.vectors), axis=0)
    sides = np.where(state.cell.periodic, height / 2, np.minimum(from_center.max(axis=0), -from_center.min(axis=0)))
    to_walls = ((state.grains.position[center] - state.walls.point) * state.walls.normal).sum(axis=1)
    held = ~state.control.free[: len(offset), :dim].all(axis=1)
    return float(min([*sides[:dim], *to_walls, *np.linalg.norm(offset[held], axis=1)]))


def _pull(here: LinearisedState, grown: np.ndarray, free: Freedom) -> np.ndarray:
    """(n,) change of the generalised force at fixed positions, per relative growth of the radii of some grains."""
    contacts, count, radius = here.state.contacts, len(here.line.closed), here.state.grains.radius
    bodies = np.append(grown, np.zeros(len(here.state.walls.mass), bool))
    near = bodies[contacts.i[:count]] | bodies[contacts.j[:count]]
    step = SMALL * np.abs(overlaps(here.state)[near]).min() / radius[grown].max()
    pull = np.zeros(len(free))
    for k, weight in STENCIL:
        there = resized(here.state, radius * (1 + k * step * grown))
        pull += weight / step * residual_vector(there, forces(there, here.law, memory=HELD)[0], free)
    return pull


def _check_contacts(here: LinearisedState, state_at, growth: float, largest: float) -> None:
    """Raise ValueError for the first contact that changes, if any; `largest` is the largest motion per growth."""
    contacts, change, allowed = here.state.contacts, "", growth
    reach = RANGE * contacts.skin / max(largest, here.state.grains.radius.max())
    if abs(growth) > reach:
        change, allowed = "grains move too far", np.copysign(reach, growth)
    while row_and_kind := _changed_contact(here, state_at(allowed)):
        row, kind = row_and_kind
        change, allowed = f"the contact ({contacts.i[row]}, {contacts.j[row]}) {kind}", allowed / 2
    if change:
        raise ValueError(
            f"before growth = {growth:g}, {change}: use {allowed:.2g} for a linear response, or protocols.inflate"
        )


def _changed_contact(here: LinearisedState, state: State) -> tuple[int, str] | None:
    """Row of a contact that changes its mode in a linear response, and the change."""
    there, line = linearise(state, here.law, memory=FREE), here.line
    kinds = {
        "opens": (line.closed > 0) & (there.closed == 0),
        "closes": (line.closed == 0) & (there.closed > 0),
        "begins to slide": (line.closed > 0) & (line.slides == 0) & (line.limit > 0) & (there.slides > 0),
    }
    return next(((row, kind) for kind, rows in kinds.items() for row in np.flatnonzero(rows & here.supported)), None)
