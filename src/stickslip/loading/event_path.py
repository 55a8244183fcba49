"""Points of a quasi-static path, and the dynamics that decide where a path goes when it is interrupted."""

from functools import cached_property

import numpy as np

from ..core.contacts.forces import accept, forces
from ..core.contacts.neighbors import with_neighbor_list
from ..core.dynamics.timestep import stable_time_step
from ..core.laws.builtin import Law
from ..core.measure import contact_forces, mean_normal_force, touching, volume
from ..core.state import State
from ..solve.balance import with_modes_under
from ..solve.equilibrate import equilibrate, relax
from ..solve.freedom import displaced
from ..solve.linear import suitable_threads
from ..solve.newton import Factorisation, newton
from ..solve.shear_response import PRUNE, Response, damped_exponents, root_mean_square, support
from .deformation import SIMPLE, Deformation

BEND = 0.05  # distance of a step from the motions predicted at its ends, over the larger of them, in a continuous path
JUMP = 10.0  # motion over that predicted in a bracket, from which it is a jump
STILL = 1e-7  # displacement below which nothing jumped, in mean overlaps
BALANCED = 5e-11  # largest unbalanced force, over the mean normal force
ITERATIONS, PATIENCE = 30, 3  # of Newton's method, and its steps that may leave more than half of the residual
RESTING = (1e-6, 1e-8, 1e-10)  # residuals at which dynamics hands over to Newton's method, over the mean normal force
KICK = 1e-3  # largest displacement along a growing mode from which dynamics starts, in mean overlaps
LEFT = 10.0  # distance from an unstable equilibrium at which it has been left, over that of the start
TIME_STEP = 0.2  # of dynamics, in units of the longest stable one
MOST_STEPS = 500_000  # of dynamics
# dynamics from an unstable equilibrium: times of growth, then of decay, and steps at most
E_FOLDS, DECAYS, MOST_KICKED = 40.0, 1000.0, 200_000
AROUND = 0.3  # distance from an equilibrium around which a packing oscillates without end, in mean overlaps
MOST_DEPARTURES = 5  # from one unstable equilibrium to another
GROWS_ABOVE = 1e-9  # exponent above which a mode grows, in units of the highest frequency


class Judge:
    """The law, the drag and the scales of a search for events."""

    def __init__(
        self, state: State, law: Law, drag: float, prune: float = PRUNE, *, slip: bool = True,
        way: Deformation = SIMPLE,
    ):  # fmt: skip
        self.law, self.drag, self.prune, self.slip, self.way = law, drag, prune, slip, way
        self.force = mean_normal_force(state, law)
        self.diameter = float(2 * state.grains.radius.mean())
        self.overlap = mean_overlap(state)
        self.keep = Factorisation()

    def newton(self, state: State, *, thorough: bool = False) -> State | None:
        """State at rest from Newton's method, or None; by default it gives up early and starts with an old matrix."""
        end, outcome = newton(
            state, self.law, tolerance=BALANCED * self.force, iterations=ITERATIONS,
            patience=None if thorough else PATIENCE, keep=Factorisation() if thorough else self.keep,
        )  # fmt: skip
        return end if outcome.ok else None

    def exponents(self, eigenvalues: np.ndarray) -> np.ndarray:
        """Exponents of growth under the drag [1/time]."""
        return damped_exponents(eigenvalues, self.drag)

    def supported_grains(self, state: State) -> np.ndarray:
        """(N,) grains of a state that are left after pruning."""
        return support(state, self.law, prune=self.prune).grains

    def rest(self, state: State, steps: int = MOST_STEPS) -> tuple[State, bool]:
        """State to which damped dynamics leads, and whether it came to rest; Newton's method only removes residuals."""
        here = state
        for share in RESTING:
            dt = TIME_STEP * stable_time_step(here, self.law)
            if not np.isfinite(dt):
                return here, False
            here, outcome = relax(
                here, self.law, tolerance=share * self.force, drag=self.drag, spin_drag=self.drag, dt=dt, steps=steps
            )
            if not outcome.ok:
                return here, False
            end = self.newton(here, thorough=True)
            if end is not None and distance(here, end, self.supported_grains(here)) < 1e3 * share * self.overlap:
                return end, True
        return here, True


class Point:
    """One equilibrium of a path with its linear response, computed as needed."""

    def __init__(self, strain: float, state: State, judge: Judge, *, tolerated: bool = False):
        self.strain, self.state, self.judge = strain, state, judge
        self.tolerated = tolerated  # whether dynamics was found to stay near here although the spectrum is unstable

    @cached_property
    def response(self) -> Response:
        """Linear response."""
        judge = self.judge
        return Response(self.state, judge.law, judge.prune, slip=judge.slip, gradient=judge.way.gradient)

    @cached_property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of the supported grains; of all, if only these are stable, because a contact is about to open."""
        pruned = self.response.eigenvalues
        return (
            self.response.with_all_contacts
            if self._grows(pruned) and not self._grows(self.response.with_all_contacts)
            else pruned
        )

    def _grows(self, eigenvalues: np.ndarray) -> bool:
        highest = np.sqrt(np.abs(eigenvalues).max(initial=0.0))
        return bool(self.judge.exponents(eigenvalues).max(initial=-np.inf) > GROWS_ABOVE * highest)

    @cached_property
    def exponents(self) -> np.ndarray:
        """Exponents of growth under the drag [1/time]."""
        return self.judge.exponents(self.eigenvalues)

    @cached_property
    def stable(self) -> bool:
        """True if no mode grows under the drag."""
        return not self._grows(self.eigenvalues)

    @property
    def oscillates(self) -> bool:
        """True if the mode that grows fastest belongs to a complex pair."""
        return bool(self.eigenvalues[np.argmax(self.exponents)].imag)

    @property
    def stress(self) -> tuple[float, float]:
        """Stress that does work on the strain, −σ_xy in simple shear, and the pressure [force/length^(dim−1)]."""
        force, branch, dim = contact_forces(self.state, self.judge.law), self.response.branch, self.state.cell.dim
        sigma = np.einsum("ca,cb->ab", force, branch) / volume(self.state)
        return -float((sigma * self.judge.way.gradient).sum()), float(np.trace(sigma)) / dim

    def strained_to(self, strain: float) -> State:
        """State strained affinely from here to a given strain, not in equilibrium."""
        return self.judge.way.apply(self.state, strain - self.strain, slip=self.judge.slip)

    def newton(self, strain: float, *, thorough: bool = False) -> "Point | None":
        """Equilibrium of Newton's method at another strain, in one step; None if it fails."""
        end = self.judge.newton(self.strained_to(strain), thorough=thorough)
        return None if end is None else Point(strain, end, self.judge)

    def equilibrium(self, strain: float) -> "Point | None":
        """Equilibrium at another strain by `equilibrate`, whose damped dynamics helps where grains become loose."""
        state, judge = self.strained_to(strain), self.judge
        end, outcome = equilibrate(state, judge.law, tolerance=BALANCED * judge.force, keep=judge.keep, check="nothing")
        return Point(strain, end, judge) if outcome.ok else None

    def with_kick(self) -> State:
        """State displaced along its fastest growing mode, in the direction in which the path moves."""
        response = self.response
        with suitable_threads(len(response.matrix)):
            values, vectors = np.linalg.eig(response.matrix)
        mode = vectors[:, np.argmax(self.judge.exponents(values))]
        mode = mode * np.exp(-0.5j * np.angle((mode * mode).sum()))
        moved = mode.real / np.sqrt(response.free.mass)
        along = (response.free.spread(moved)[: len(response.rate)] * response.rate).sum()
        size = KICK * self.judge.overlap / np.abs(moved).max() * (1.0 if along >= 0 else -1.0)
        return displaced(self.state, response.free, size * moved)


def commit(state: State, law: Law) -> State:
    """State with the memory of its contacts committed, each in its mode under a given law.

    Contacts of packings made without friction slide without slip, which has no meaning under a law with friction.
    """
    here = with_neighbor_list(state, law)
    return with_modes_under(accept(here, forces(here, law)[1]), law)


def mean_overlap(state: State) -> float:
    """Mean overlap of touching contacts [length]; zero without contacts."""
    rows, contacts = touching(state), state.contacts
    if not len(rows):
        return 0.0
    radius = state.grains.radius
    apart = np.linalg.norm(contacts.pair[rows], axis=1)
    return float((radius[contacts.i[rows]] + radius[contacts.j[rows]] - apart).mean())


def displacement(a: State, b: State, strain: float = 0.0, way: Deformation = SIMPLE) -> np.ndarray:
    """(N, 6) motion (x, y, z, R·angle) from one state to another beyond an affine deformation [length]."""
    moved = b.grains.position - a.grains.position - a.grains.position @ way.finite(strain).T
    turned = (b.grains.angle - a.grains.angle) * a.grains.radius[:, None]
    return np.hstack([moved, turned])


def distance(a: State, b: State, grains: np.ndarray) -> float:
    """Root mean square motion of some grains from one state to another at the same strain [length]."""
    return root_mean_square(displacement(a, b), grains)


def continuous(a: Point, b: Point, bend: float = BEND) -> bool:
    """Return True if grains moved from one point to the next as the linear responses at both ends predict.

    If a contact changes in between, the motion lies between the two predictions. So the distance from the line between
    them counts, not that from either of them; `bend` is the largest one, over the larger prediction.
    """
    both, strain = a.response.support.grains & b.response.support.grains, b.strain - a.strain
    if not both.any():
        return False
    moved = displacement(a.state, b.state, strain, a.judge.way)
    first, last = strain * a.response.rate, strain * b.response.rate
    moved, first, last = (_subtract_mean(x[both]) for x in (moved, first, last))
    line = last - first
    share = np.clip(((moved - first) * line).sum() / max((line * line).sum(), np.finfo(float).tiny), 0.0, 1.0)
    beside, size = (np.sqrt((x * x).sum() / both.sum()) for x in (moved - first - share * line, _larger(first, last)))
    return bool(beside <= bend * size + STILL * a.judge.overlap)


def is_jump(a: Point, b: Point) -> bool:
    """Return True if grains moved too far over a short step for any continuous motion, not only for the linear one.

    Where contacts switch between stick and slide, dynamics need not follow the linear response at either end.
    """
    both, strain = a.response.support.grains & b.response.support.grains, b.strain - a.strain
    moved = root_mean_square(displacement(a.state, b.state, strain, a.judge.way), both)
    return not both.any() or moved > JUMP * strain * min(a.response.speed, b.response.speed)


def _subtract_mean(motion: np.ndarray) -> np.ndarray:
    return np.hstack([motion[:, :3] - motion[:, :3].mean(axis=0), motion[:, 3:]])


def _larger(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a if (a * a).sum() >= (b * b).sum() else b


def depart(point: Point) -> tuple[Point | None, bool]:
    """Start dynamics at a small distance from an unstable equilibrium, along its fastest growing mode.

    Returns
    -------
    Point or None
        where dynamics comes to rest elsewhere; None if it returns, or oscillates without end around the equilibrium
    bool
        whether it came to rest at all
    """
    start, grains = point.with_kick(), point.response.support.grains
    time = E_FOLDS / point.exponents.max() + DECAYS / point.judge.drag
    steps = time / (TIME_STEP * stable_time_step(start, point.judge.law))
    end, rested = point.judge.rest(start, int(min(steps, MOST_KICKED)))
    if not rested or distance(point.state, end, grains) <= LEFT * distance(point.state, start, grains):
        return None, rested
    return Point(point.strain, end, point.judge), True


def fall(point: Point, strain: float) -> Point | None:
    """Point to which dynamics leads from the state of another point at an advanced strain.

    If it oscillates without end around an equilibrium, the result is that equilibrium; otherwise None.
    """
    end, rested = point.judge.rest(point.strained_to(strain))
    if rested:
        return settle(Point(strain, end, point.judge))
    centre = point.judge.newton(end, thorough=True)
    if centre is None or distance(end, centre, point.judge.supported_grains(centre)) > AROUND * point.judge.overlap:
        return None
    return Point(strain, centre, point.judge, tolerated=True)


def settle(point: Point) -> Point:
    """Point that dynamics reaches from one that may be an unstable equilibrium; it may oscillate around the last."""
    for _ in range(MOST_DEPARTURES):
        if point.stable:
            return point
        other, _ = depart(point)
        if other is None:
            break
        point = other
    point.tolerated = not point.stable
    return point
