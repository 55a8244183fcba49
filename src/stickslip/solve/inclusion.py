"""Inflation of grains in a packing: the displacements around them, in linear response, and those of an elastic body."""

from typing import NamedTuple

import numpy as np

from ..core.arguments import Bodies, checked, require_not_negative
from ..core.contacts.forces import forces
from ..core.contacts.jacobian import blocks_of, linearise
from ..core.contacts.memory import FREE, HELD
from ..core.control import body_numbers
from ..core.laws.builtin import Law
from ..core.measure import overlaps, pressure, volume
from ..core.readable import pluralize, readable
from ..core.sizes import Size, require_sizes
from ..core.state import State
from .balance import balanced
from .freedom import Freedom, displaced, residual_vector, resized, stiffness_of
from .gradient import STENCIL
from .linearised import LinearisedState
from .moduli import elastic_moduli, solve_resisted
from .screening import ScreeningFits, rings_of, screening_fits

SMALL = 0.02  # step of differences over the smallest overlap or gap of a grain that grows
LEAST = 1e-9  # growth, above the round-off of positions and pressures
RANGE = 0.25  # largest displacement over the skin of the list of contacts, up to which it is valid
INNER = 2.0  # inner radius of a fit, in mean diameters


@readable(head=lambda field: f"{pluralize(len(field.centers), 'grain')} inflated by {field.growth:g}")
class Inflation(NamedTuple):
    """Displacements of the grains of a packing around grains that are inflated, each in its own experiment."""

    growth: float  # relative growth of their radii
    centers: np.ndarray  # (M,) inflated grains
    offset: np.ndarray  # (M, N, dim) position relative to the center before, of the nearest image [length]
    displacement: np.ndarray  # (M, N, dim) without its mean if nothing holds the packing in place [length]
    counted: np.ndarray  # (M, N) grains that count: free, no rattlers, not inflated
    diameter: float  # mean [length]
    outer: float  # distance up to which circles or spheres around all centers are whole [length]
    volume: float  # of the periodic cell; NaN if grains are held, or there are walls or open sides
    lame: np.ndarray  # (M,) A of u_r = A/r^(dim−1) + B r from moduli and change of pressure; NaN as above [length^dim]
    states: list[State]  # at the end of quasi-static steps; none in linear response
    changes: np.ndarray  # (M, K, 4) contacts that opened, closed, began and stopped sliding in each step

    @property
    def dim(self) -> int:
        """Number of dimensions."""
        return self.offset.shape[2]

    @property
    def components(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(M, N) distance from the center, radial displacement and, in the plane, tangential, else zero [length]."""
        distance = np.linalg.norm(self.offset, axis=2)
        n, u = self.offset / np.where(distance == 0, 1.0, distance)[..., None], self.displacement
        turning = n[..., 0] * u[..., 1] - n[..., 1] * u[..., 0] if self.dim == 2 else np.zeros_like(distance)
        return distance, (n * u).sum(axis=2), turning

    def elastic(self, distance: np.ndarray) -> np.ndarray:
        """Radial displacement of an elastic body with the moduli of the packing, nothing fitted; see `inflate`."""
        share = {2: np.pi, 3: 4 * np.pi / 3}[self.dim] / self.volume
        return self.lame.mean() * (distance ** (1.0 - self.dim) - share * distance)

    def fit(self, *, inner: float | None = None, outer: float | None = None) -> ScreeningFits:
        """Fits of elasticity and of screening to means over rings, and their comparison; see `ScreeningFits`.

        Rings are a mean diameter wide, shells in three dimensions half of it. Their errors are those of the scatter
        between centers, if there are at least ten, else of that between eight equal sectors around each, so that they
        hold although neighbors move together.

        Parameters
        ----------
        inner, outer : range of distances; default: two mean diameters, and `outer` [length]

        Raises
        ------
        ValueError
            if there are fewer than five rings with ten grains.
        """
        ends = INNER * self.diameter if inner is None else inner, self.outer if outer is None else outer
        require_not_negative(inner=ends[0], outer=ends[1])
        width = self.diameter / (self.dim - 1)
        return screening_fits(rings_of(self.offset, self.components, self.counted, width, ends), self.lame.mean())


@checked
def inflate(
    state: State, law: Law, grain: Bodies | None = None, *, growth: float = 1e-6, within: float = 0.0
) -> Inflation:
    """Linear response to the inflation of a grain: u = −J⁻¹ ∂f/∂R · growth · R, each contact held in its mode.

    A contact that slides keeps sliding, even if it would stick in a step of `protocols.inflate`. They differed by up to
    0.02 % of the largest displacement for a growth of 1e-6, and by 0.2 % for 1e-5 (`tests/modes/test_inclusion.py`).

    In an isotropic elastic body the mean of u_r over a circle or sphere is A/r^(dim−1) + B r (Lamé). In a periodic cell
    of area or volume V, B = −πA/V or −4πA/3V, and A = M/(2π(K + G)) or M/(4π(K + 4G/3)), with the force dipole M =
    V ΔP for the change ΔP of the pressure of the packing, in which the answer of the neighbors is included.

    Parameters
    ----------
    grain : number of the grain, or of several, each inflated alone, whose displacements are averaged; default: the
        grain nearest to the middle. All of them take one factorisation
    growth : relative change of the radius, below that at which a contact opens, closes or begins to slide
    within : grains whose centers are at most so far from the given one grow with it [length]

    Raises
    ------
    ValueError
        if the forces do not balance; if a grain is a rattler or held; if a contact changes; if nothing resists.

    Source
    ------
    Lemaître et al., doi:10.1103/PhysRevE.104.024904, for the question; Landau & Lifshitz, Theory of Elasticity, § 7.

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
    scale = state.grains.radius.mean()  # pulls over it are of the order of J
    motion = scale * solve_resisted(matrix, pulls / scale, free, "an inflated grain").T

    def at(k: int, growth: float) -> State:
        larger = resized(here.state, state.grains.radius * (1 + growth * grown[k]))
        return displaced(larger, free, growth * motion[k])

    for k, moves in enumerate(motion):
        _check_contacts(here, lambda g, k=k: at(k, g), growth, np.abs(moves).max())
    displacement = growth * np.array([free.spread(moves)[: len(here.loose), :3] for moves in motion])
    return as_inflation(here, centers, grown, growth, displacement, [at(k, growth) for k in range(len(centers))])


def inflated_grains(here: LinearisedState, grain, growth: float, within: float) -> tuple[np.ndarray, np.ndarray]:
    """Centers (M,), and which grains grow with each, (M, N) bool; ValueError if they cannot."""
    state, n, moves = here.state, len(here.loose), _moves(here)
    if not (-1 < growth <= 1 and abs(growth) >= LEAST):
        raise ValueError(
            f"growth = {growth:g} was given: it must be above −1, at most 1, and not below {LEAST:g} in size"
        )
    require_not_negative(within=within)
    if state.control.cell_free.any():
        raise ValueError("a cell that follows a stress was given: hold it while a grain is inflated")
    if not moves.any():
        raise ValueError("nothing is held by contacts and free to move: an inflation needs grains that bear forces")
    if grain is None:
        away = np.linalg.norm(_offsets(state, _middle(state)[None])[0], axis=1)
        grain = np.where(moves, away, np.inf).argmin()
    centers = body_numbers(state.control, grain)
    if not len(centers) or len(np.unique(centers)) < len(centers):
        raise ValueError("no grain was given, or one of them twice: give each grain once")
    for worst in centers[centers >= n]:
        raise ValueError(f"body {worst} was given, a wall: only grains, 0 to {n - 1}, are inflated")
    for worst in centers[~moves[centers]]:
        kind = "a rattler" if here.loose[worst] else "held in place"
        raise ValueError(f"grain {worst} was given, which is {kind}: inflate one that bears forces and is free")
    size = 100.0 * len(centers) * n
    require_sizes([Size(f"{len(centers)} inflations of {n} grains take", size, "bytes", "inflate fewer grains")])
    grown = np.linalg.norm(_offsets(state, state.grains.position[centers]), axis=2) <= within
    grown[np.arange(len(centers)), centers] = True
    return centers, grown


def as_inflation(here: LinearisedState, centers, grown, growth, displacement, ends, changes=None) -> Inflation:
    """Result for displacements (M, N, 3) and states at the end, without a translation that nothing resists."""
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
    """(N,) grains that are free in all directions of translation, and no rattlers."""
    return here.state.control.free[: len(here.loose), : here.state.cell.dim].all(axis=1) & ~here.loose


def _offsets(state: State, points: np.ndarray) -> np.ndarray:
    """(M, N, 3) positions relative to points, of nearest images within half the height of the cell [length]."""
    away = state.grains.position - points[:, None]
    cell = np.where(state.cell.periodic[:, None], state.cell.vectors, np.eye(3))
    return away - np.round(away @ np.linalg.inv(cell)) * state.cell.periodic @ cell


def _middle(state: State) -> np.ndarray:
    """(3,) middle of the cell, along axes that are not periodic that of the grains [length]."""
    place = state.grains.position
    middle = (place.min(axis=0) + place.max(axis=0)) / 2
    return np.where(state.cell.periodic, state.cell.vectors.sum(axis=0) / 2, middle)


def _distance_to_boundary(state: State, center: int, offset: np.ndarray) -> float:
    """Radius of the largest circle or sphere around a center that is in the cell, among free grains [length]."""
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
    """Raise ValueError with the first contact that changes, if one does; `largest` is the displacement per growth."""
    contacts, change, allowed = here.state.contacts, "", growth
    reach = RANGE * contacts.skin / max(largest, here.state.grains.radius.max())
    if abs(growth) > reach:
        change, allowed = "grains move too far", np.copysign(reach, growth)
    while row_and_kind := _changed_contact(here, state_at(allowed)):
        row, kind = row_and_kind
        change, allowed = f"the contact ({contacts.i[row]}, {contacts.j[row]}) {kind}", allowed / 2
    if change:
        raise ValueError(
            f"growth = {growth:g} was given, before which {change}: give {allowed:.2g} for a linear response, or use "
            "protocols.inflate"
        )


def _changed_contact(here: LinearisedState, state: State) -> tuple[int, str] | None:
    """Row of a contact that is in another mode in a linear response, and what it does."""
    there, line = linearise(state, here.law, memory=FREE), here.line
    kinds = {
        "opens": (line.closed > 0) & (there.closed == 0),
        "closes": (line.closed == 0) & (there.closed > 0),
        "begins to slide": (line.closed > 0) & (line.slides == 0) & (line.limit > 0) & (there.slides > 0),
    }
    return next(((row, kind) for kind, rows in kinds.items() for row in np.flatnonzero(rows & here.supported)), None)
