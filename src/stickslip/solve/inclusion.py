"""Inflation of grains in a packing: the displacements around them, in linear response, and those of an elastic body."""

from typing import NamedTuple

import numpy as np

from ..core.arguments import Bodies, checked, require_not_negative
from ..core.contacts.forces import forces
from ..core.contacts.jacobian import blocks_of, linearise
from ..core.contacts.memory import FREE, HELD
from ..core.control import body_numbers
from ..core.laws.builtin import Law
from ..core.measure import overlaps, volume
from ..core.progress import Report, silent
from ..core.readable import pluralize, readable
from ..core.sizes import Size, require_sizes
from ..core.state import State
from .balance import balanced
from .freedom import Freedom, displaced, residual_vector, resized, stiffness_of
from .linearised import LinearisedState
from .moduli import elastic_moduli, solve_resisted
from .response import stress_change
from .screening import INNER, Rings, ScreeningFits, rings_of, screening_fits

STENCIL = ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12))  # central differences of fourth order
SMALL = 0.02  # their step over the smallest overlap or gap of a grain that grows
RANGE = 0.25  # largest displacement over the skin of the list of contacts, up to which it is valid
NARROW = 1e-3  # relative accuracy of the growth at which the first contact changes


@readable(head=lambda field: field.summary)
class Inflation(NamedTuple):
    """Displacements of the grains of a packing around grains that are inflated, each in its own experiment."""

    growth: float  # relative growth of their radii
    centers: np.ndarray  # (M,) inflated grains
    offset: np.ndarray  # (M, N, dim) position relative to the center before, of the nearest image [length]
    displacement: np.ndarray  # (M, N, dim) without its mean if nothing holds the packing in place [length]
    counted: np.ndarray  # (M, N) grains that count: free, no rattlers, not inflated
    width: float  # of rings: mean diameter, half of it in three dimensions [length]
    outer: float  # largest distance up to which shells around all centers are whole [length]
    volume: float  # of the periodic cell; NaN if grains are held, or there are walls or open sides
    lame: np.ndarray  # (M,) A of u_r = A/r^(dim−1) + B r from moduli and change of pressure; NaN as above [length^dim]
    states: list[State]  # packings at the end of quasi-static steps; none in linear response
    changes: np.ndarray  # (M, K, 3) contacts that opened, closed, and began to slide in each step

    @property
    def dim(self) -> int:
        """Number of dimensions."""
        return self.offset.shape[2]

    @property
    def summary(self) -> str:
        """What was inflated, and how."""
        kind = "linear response" if not self.states else f"{self.changes.shape[1]} quasi-static steps"
        return f"{pluralize(len(self.centers), 'grain')} inflated by {self.growth:g}, {kind}"

    @property
    def components(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(M, N) distance from the center, radial displacement and, in the plane, tangential, else zero [length]."""
        distance = np.linalg.norm(self.offset, axis=2)
        normal = self.offset / np.where(distance == 0, 1.0, distance)[..., None]
        radial = (normal * self.displacement).sum(axis=2)
        if self.dim == 3:
            return distance, radial, np.zeros_like(radial)
        return distance, radial, normal[..., 0] * self.displacement[..., 1] - normal[..., 1] * self.displacement[..., 0]

    def elastic(self, distance: np.ndarray) -> np.ndarray:
        """Radial displacement of an elastic body with the moduli of the packing, nothing fitted; see `inflate`."""
        away, body = distance ** (1.0 - self.dim), {2: np.pi, 3: 4 * np.pi / 3}[self.dim] / self.volume
        return self.lame.mean() * (away - body * distance)

    def rings(self, *, inner: float | None = None, outer: float | None = None) -> Rings:
        """Means over rings (shells in three dimensions) of the distance and displacement, and their errors.

        Errors are those of the scatter between centers, if there are at least ten; otherwise of that between eight
        equal sectors around each. So they hold although neighbors move together.

        Parameters
        ----------
        inner, outer : range of distances; default: two mean diameters, and `outer` [length]
        """
        inner = INNER * self.width * (self.dim - 1) if inner is None else inner
        outer = self.outer if outer is None else outer
        require_not_negative(inner=inner, outer=outer)
        return rings_of(self.offset, *self.components, self.counted, self.width, (inner, outer))

    def fit(self, *, inner: float | None = None, outer: float | None = None) -> ScreeningFits:
        """Fits of elasticity and of screening to the rings, and their comparison; see `screening_fits`.

        Raises
        ------
        ValueError
            if there are fewer than five rings.
        """
        return screening_fits(self.rings(inner=inner, outer=outer), float(self.lame.mean()))


@checked
def inflate(
    state: State, law: Law, grain: Bodies | None = None, *, growth: float = 1e-6, within: float = 0.0,
    report: Report = silent,
) -> Inflation:  # fmt: skip
    """Linear response to the inflation of a grain: u = −J⁻¹ ∂f/∂R · growth · R, each contact held in its mode.

    In an isotropic elastic body the mean of u_r over a circle or sphere is A/r^(dim−1) + B r (Lamé). In a periodic cell
    of area or volume V, B = −πA/V or −4πA/3V, and A = M/(2π(K + G)) or M/(4π(K + 4G/3)), with the force dipole M =
    V ΔP for the change ΔP of the pressure of the packing, in which the answer of the neighbors is included.

    Parameters
    ----------
    grain : number of the grain, or of several, each inflated alone, whose displacements are averaged; default: the
        grain nearest to the middle. All of them take one factorisation
    growth : relative change of the radius, at most that at which a contact opens, closes or begins to slide
    within : grains whose centers are at most so far from the given one grow with it [length]
    report : called as report(stage, share done, text)

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
    free, radius = here.backbone, state.grains.radius
    matrix = stiffness_of(here.state, here.line, blocks_of(here.state, law, here.line)[0], free)
    pulls, virials = [], []
    for k, rows in enumerate(grown):
        report("inflation", k / len(centers), f"grain {centers[k]}")
        pull, virial = _pull_of(here, rows, free)
        pulls.append(pull)
        virials.append(virial)
    unit = np.abs(radius).mean()  # pulls of the order of J
    motion = unit * solve_resisted(matrix, np.array(pulls).T / unit, free, "an inflated grain")
    for rows, moves in zip(grown, motion.T, strict=True):
        _check_contacts(here, lambda g, rows=rows, moves=moves: _moved(here, rows, free, g, moves), growth)
    spread = np.array([free.spread(moves) for moves in motion.T])
    rise = growth * _pressure_rise(here, spread, np.array(virials)) if is_whole(here) else None
    return as_inflation(here, centers, grown, growth * spread[:, : len(radius), :3], growth, rise)


def inflated_grains(here: LinearisedState, grain, growth: float, within: float) -> tuple[np.ndarray, np.ndarray]:
    """Centers (M,), and which grains grow with each, (M, N) bool."""
    state, n = here.state, len(here.loose)
    if not growth > -1 or growth == 0:
        raise ValueError(f"growth = {growth:g} was given: it must be above −1 and not zero")
    require_not_negative(within=within)
    if state.control.cell_free.any():
        raise ValueError("a cell that follows a stress was given: hold it fixed while a grain is inflated")
    moves = _moves(here)
    if not moves.any():
        raise ValueError("nothing is held by contacts and free to move: an inflation needs grains that bear forces")
    if grain is None:
        place = np.linalg.norm(_nearest(state, state.grains.position - _middle(state)), axis=1)
        centers = np.array([np.where(moves, place, np.inf).argmin()])
    else:
        centers = body_numbers(state.control, grain)
    if not len(centers):
        raise ValueError("no grain was given: give at least one to inflate")
    for worst in centers[centers >= n]:
        raise ValueError(f"body {worst} was given, a wall: only grains, 0 to {n - 1}, are inflated")
    for worst in centers[~moves[centers]]:
        kind = "a rattler, which touches nothing firmly" if here.loose[worst] else "held in place"
        raise ValueError(f"grain {worst} was given, which is {kind}: inflate one that bears forces and is free")
    size = 64.0 * len(centers) * n
    require_sizes([Size(f"{len(centers)} inflations of {n} grains take", size, "bytes", "inflate fewer grains")])
    offset = _offsets(state, centers)
    grown = np.linalg.norm(offset, axis=2) <= within
    grown[np.arange(len(centers)), centers] = True
    return centers, grown


def as_inflation(
    here: LinearisedState, centers, grown, displacement, growth, rise, states=(), changes=None
) -> Inflation:
    """Result for displacements (M, N, 3) and changes of the pressure (M,), None if there are no moduli.

    A common translation is subtracted if nothing resists it.
    """
    state, moves, dim = here.state, _moves(here), here.state.cell.dim
    if is_adrift(here):
        displacement = displacement - displacement[:, moves].mean(axis=1)[:, None] * moves[:, None]
    offset, width = _offsets(state, centers), (2.0 if dim == 2 else 1.0) * state.grains.radius.mean()
    lame = np.full(len(centers), np.nan) if rise is None else lame_amplitudes(here, rise)
    size = np.nan if rise is None else volume(state)
    outer = min(_distance_to_boundary(state, g, off) for g, off in zip(centers, offset, strict=True))
    changes = np.zeros((len(centers), 0, 3), int) if changes is None else changes
    return Inflation(
        growth, centers, offset[..., :dim], displacement[..., :dim], moves & ~grown, width, outer, size, lame,
        list(states), changes,
    )  # fmt: skip


def _moves(here: LinearisedState) -> np.ndarray:
    """(N,) grains that are free in all directions of translation, and no rattlers."""
    return here.state.control.free[: len(here.loose), : here.state.cell.dim].all(axis=1) & ~here.loose


def is_adrift(here: LinearisedState) -> bool:
    """Return True if nothing resists a common translation of the grains."""
    control, walls = here.state.control, len(here.state.walls.mass)
    return not walls and not control.spring.any() and bool(control.free[:, : here.state.cell.dim].all())


def _nearest(state: State, vectors: np.ndarray) -> np.ndarray:
    """Nearest periodic images of vectors (…, 3), as long as they are shorter than half the height of the cell."""
    cell = np.where(state.cell.periodic[:, None], state.cell.vectors, np.eye(3))
    turns = np.round(vectors @ np.linalg.inv(cell)) * state.cell.periodic
    return vectors - turns @ cell


def _offsets(state: State, centers: np.ndarray) -> np.ndarray:
    return _nearest(state, state.grains.position - state.grains.position[centers, None])


def _middle(state: State) -> np.ndarray:
    """(3,) middle of the cell, along axes that are not periodic that of the grains."""
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


def _pull_of(here: LinearisedState, grown: np.ndarray, free: Freedom) -> tuple[np.ndarray, np.ndarray]:
    """(n,) generalised force and (3, 3) Σ f ⊗ r at fixed positions, per relative growth of the radii of some grains."""
    state, radius = here.state, here.state.grains.radius
    strained = np.zeros((3, 3), bool)
    strained[: state.cell.dim, : state.cell.dim] = True
    bodies = np.append(grown, np.zeros(len(state.walls.mass), bool))
    count = len(here.line.closed)
    near = bodies[state.contacts.i[:count]] | bodies[state.contacts.j[:count]]
    step = SMALL * np.abs(overlaps(state)[near]).min() / radius[grown].max()
    pull, virial = np.zeros(len(free)), np.zeros((3, 3))
    for k, weight in STENCIL:
        there = resized(state, radius * (1 + k * step * grown))
        open_cell = there.control._replace(cell_free=strained)  # so that forces include their virial
        loads, _ = forces(there._replace(control=open_cell), here.law, memory=HELD)
        pull += weight / step * residual_vector(there, loads, free)
        virial += weight / step * loads.virial
    return pull, virial


def _moved(here: LinearisedState, grown: np.ndarray, free: Freedom, growth: float, motion: np.ndarray) -> State | None:
    """State at a growth in linear response; None beyond the range of its list of contacts."""
    state = here.state
    largest = max(np.abs(motion).max(), state.grains.radius[grown].max())
    if abs(growth) * largest > RANGE * state.contacts.skin:
        return None
    return displaced(resized(state, state.grains.radius * (1 + growth * grown)), free, growth * motion)


def _check_contacts(here: LinearisedState, state_at, growth: float) -> None:
    """Raise ValueError with the first contact that changes, if one does below a growth."""
    change = _first_change(here, state_at(growth))
    if not change:
        return
    low, high = 0.0, growth
    while abs(high - low) > NARROW * abs(high) and abs(high) > 1e-15:
        middle = 0.5 * (low + high)
        sooner = _first_change(here, state_at(middle))
        low, high, change = (low, middle, sooner) if sooner else (middle, high, change)
    raise ValueError(
        f"growth = {growth:g} was given, and at {high:.2g} {change}: give a smaller one for a linear response, or use "
        "protocols.inflate"
    )


def _first_change(here: LinearisedState, state: State | None) -> str:
    """What changes first among the contacts of a linear response; empty if nothing does."""
    if state is None:
        return "grains move too far"
    there, line, ends = linearise(state, here.law, memory=FREE), here.line, here.state.contacts
    kinds = {
        "opens": (line.closed > 0) & (there.closed == 0),
        "closes": (line.closed == 0) & (there.closed > 0),
        "begins to slide": (line.closed > 0) & (line.slides == 0) & (line.limit > 0) & (there.slides > 0),
    }
    for kind, rows in kinds.items():
        for row in np.flatnonzero(rows & here.supported):
            return f"the contact ({ends.i[row]}, {ends.j[row]}) {kind}"
    return ""


def lame_amplitudes(here: LinearisedState, rise) -> np.ndarray:
    """(M,) A of Lamé's solution for changes of the pressure (M,), in a periodic cell of free grains [length^dim]."""
    state, dim, moduli = here.state, here.state.cell.dim, elastic_moduli(here.state, here.law)
    stiff = {2: 2 * np.pi * (moduli.bulk + moduli.shear), 3: 4 * np.pi * (moduli.bulk + 4 / 3 * moduli.shear)}[dim]
    return np.asarray(rise) * volume(state) / stiff


def is_whole(here: LinearisedState) -> bool:
    """Return True if the cell is periodic in all its dimensions and its grains are free, so that it has moduli."""
    state = here.state
    whole = state.cell.periodic[: state.cell.dim].all() and not (state.control.group >= 0).any()
    return bool(whole and is_adrift(here))


def _pressure_rise(here: LinearisedState, motion: np.ndarray, virials: np.ndarray) -> np.ndarray:
    """(M,) change of the pressure for motions (M, B, 6) and Σ f ⊗ r (M, 3, 3) that inflation itself adds."""
    state, dim = here.state, here.state.cell.dim
    answer = np.einsum("sbk,mbk->ms", stress_change(state, here.law), motion).reshape(-1, dim, dim)
    return (np.einsum("maa->m", answer) + np.einsum("maa->m", virials) / volume(state)) / dim
