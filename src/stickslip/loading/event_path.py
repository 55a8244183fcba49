"""Points of a quasi-static path, forecasts of its next event, and the dynamics that determine its continuation.

Forecasts are made from quantities that vanish at the event as a known power of the remaining strain. Near a saddle
node, the remaining strain is d = A λ² + B λ³ + …, where λ is the smallest real eigenvalue; the second term dominates
far from the event if a contact with a stiffness ∝ √overlap is about to open. Near the birth of a complex pair, the
squared gap between two real eigenvalues is linear in the strain. Linear extrapolation predicts when contacts reach the
Coulomb limit or open.
"""

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..core.contacts.bonding import bond_shares, with_strength_of, with_weakest_broken, without_failure
from ..core.contacts.forces import accept, forces
from ..core.contacts.neighbors import with_neighbor_list
from ..core.dynamics.run import stable_time_step
from ..core.laws.builtin import Law
from ..core.measure import contact_forces, mean_normal_force, touching, volume
from ..core.readable import readable
from ..core.scales import natural_scales
from ..core.state import OPEN, State
from ..solve.balance import with_modes_under
from ..solve.equilibrate import equilibrate, relax
from ..solve.freedom import displaced
from ..solve.linear import suitable_threads
from ..solve.newton import Factorisation, newton
from ..solve.shear_response import PRUNE, Response, damped_exponents, root_mean_square, support
from .settling import SIMPLE, Deformation

BEND = 0.05  # largest deviation of a continuous motion from the predictions at its ends, over the larger prediction
JUMP = 10.0  # ratio of the motion in a bracket to its prediction, above which it is a jump
TINY = 1e-4  # overlap that replaces the mean one in a cemented packing without overlaps, in mean diameters
UNLOADED = 1e-3  # force that replaces the mean one in a cemented packing at rest, in natural units
STILL = 1e-7  # displacement, in mean overlaps, below which there was no jump
BALANCED = 5e-11  # largest unbalanced force, in units of the mean normal force
ITERATIONS, PATIENCE = 30, 3  # largest number of Newton steps, and of those that leave more than half of the residual
RESTING = (1e-6, 1e-8, 1e-10)  # residuals, relative to the mean normal force, at which Newton's method follows dynamics
KICK = 1e-3  # largest displacement along a growing mode at the start of dynamics, in mean overlaps
LEFT = 10.0  # distance from an unstable equilibrium, in units of the initial one, at which it counts as left
TIME_STEP = 0.2  # time step of dynamics, in units of the longest stable one
MOST_STEPS = 500_000  # largest number of steps of dynamics
# dynamics from an unstable equilibrium: e-foldings of growth, then of decay, and largest number of steps
E_FOLDS, DECAYS, MOST_KICKED = 40.0, 1000.0, 200_000
AROUND = 0.3  # largest distance, in mean overlaps, from an equilibrium about which a packing oscillates endlessly
MOST_DEPARTURES = 5  # largest number of departures from one unstable equilibrium to another
GROWS_ABOVE = 1e-9  # exponent above which a mode grows, in units of the highest frequency


class Judge:
    """The law, the drag and the scales of a search for events."""

    def __init__(
        self, state: State, law: Law, drag: float, prune: float = PRUNE, *, slip: bool = True,
        way: Deformation = SIMPLE,
    ):  # fmt: skip
        self.law, self.drag, self.prune, self.slip, self.way = law, drag, prune, slip, way
        self.force = mean_normal_force(state, law) or UNLOADED * natural_scales(state, law).force
        self.diameter = float(2 * state.grains.radius.mean())
        self.overlap = mean_overlap(state)
        self.keep = Factorisation()

    def newton(self, state: State, *, thorough: bool = False) -> State | None:
        """State at rest from Newton's method, or None; by default this gives up early and starts with an old matrix."""
        end, outcome = newton(
            state, self.law, tolerance=BALANCED * self.force, iterations=ITERATIONS,
            patience=None if thorough else PATIENCE, keep=Factorisation() if thorough else self.keep,
        )  # fmt: skip
        return end if outcome.ok else None

    def exponents(self, eigenvalues: np.ndarray) -> np.ndarray:
        """Exponents of growth under the drag [1/time]."""
        return damped_exponents(eigenvalues, self.drag)

    def supported_grains(self, state: State) -> np.ndarray:
        """(N,) grains of a state that remain after pruning."""
        return support(state, self.law, prune=self.prune).grains

    def rest(self, state: State, steps: int = MOST_STEPS) -> tuple[State, bool]:
        """Final state of damped dynamics, and whether it came to rest; Newton's method only removes residuals.

        Before that, bonds do not break unless they fade. Bonds at their strength then break one by one, first the one
        with the largest ratio of load to strength, and dynamics follows each break.
        """
        end, rested = self._rest(state, steps)
        while rested and (weaker := with_weakest_broken(end)) is not end:
            end, rested = self._rest(weaker, steps)
        return end, rested

    def _rest(self, state: State, steps: int) -> tuple[State, bool]:
        here, rested = self._calm(without_failure(state), steps)
        return with_strength_of(here, state), rested

    def _calm(self, here: State, steps: int) -> tuple[State, bool]:
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
        self.tolerated = tolerated  # whether dynamics stays near this state although the spectrum is unstable

    @cached_property
    def response(self) -> Response:
        """Linear response of the equilibrium."""
        judge = self.judge
        return Response(self.state, judge.law, judge.prune, slip=judge.slip, gradient=judge.way.gradient)

    @cached_property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of the supported grains, or of all if only these are stable (a contact is about to open)."""
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

    @cached_property
    def holds(self) -> bool:
        """True if no bond is at its strength."""
        return bool(bond_shares(self.state).max(initial=0.0) < 1)

    @property
    def oscillates(self) -> bool:
        """True if the mode that grows fastest belongs to a complex pair."""
        return bool(self.eigenvalues[np.argmax(self.exponents)].imag)

    @property
    def stress(self) -> tuple[float, float]:
        """Stress conjugate to the strain, −σ_xy in simple shear, and the pressure [force/length^(dim−1)]."""
        force, branch, dim = contact_forces(self.state, self.judge.law), self.response.branch, self.state.cell.dim
        sigma = np.einsum("ca,cb->ab", force, branch) / volume(self.state)
        return -float((sigma * self.judge.way.gradient).sum()), float(np.trace(sigma)) / dim

    def strained_to(self, strain: float) -> State:
        """State strained affinely from here to a given strain, not in equilibrium."""
        return self.judge.way.apply(self.state, strain - self.strain, slip=self.judge.slip)

    def newton(self, strain: float, *, thorough: bool = False) -> "Point | None":
        """Equilibrium found by Newton's method at another strain, in one step; None if it fails."""
        end = self.judge.newton(self.strained_to(strain), thorough=thorough)
        return None if end is None else Point(strain, end, self.judge)

    def equilibrium(self, strain: float) -> "Point | None":
        """Equilibrium at another strain by `equilibrate`, whose damped dynamics helps where grains become loose."""
        state, judge = self.strained_to(strain), self.judge
        end, outcome = equilibrate(state, judge.law, tolerance=BALANCED * judge.force, keep=judge.keep, check="nothing")
        return Point(strain, end, judge) if outcome.ok else None

    def with_kick(self) -> State:
        """State displaced along its fastest-growing mode, in the direction in which the path moves."""
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

    Contacts of packings made without friction are marked as sliding without slip, which means nothing under a law with
    friction.
    """
    here = with_neighbor_list(state, law)
    return with_modes_under(accept(here, forces(here, law)[1]), law)


def mean_overlap(state: State) -> float:
    """Mean overlap of touching contacts [length]; zero without contacts.

    For a cemented packing without overlaps, the result is 1e-4 mean diameters.
    """
    rows, contacts = touching(state), state.contacts
    if not len(rows):
        return 0.0
    radius = state.grains.radius
    apart = np.linalg.norm(contacts.pair[rows], axis=1)
    overlap = radius[contacts.i[rows]] + radius[contacts.j[rows]] - apart
    if state.bonds:
        overlap = overlap[contacts.mode[rows] != OPEN]
    return float(overlap.mean()) if len(overlap) else TINY * 2 * float(radius.mean())


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

    If a contact changes in between, the motion lies between the two predictions. The criterion is therefore the
    distance from the line between them; `bend` is its largest ratio to the larger prediction.
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
    """Start dynamics at a small distance from an unstable equilibrium, along its fastest-growing mode.

    Returns
    -------
    Point or None
        point where dynamics comes to rest elsewhere; None if it returns, or oscillates endlessly about the equilibrium
    bool
        whether dynamics came to rest
    """
    start, grains = point.with_kick(), point.response.support.grains
    time = E_FOLDS / point.exponents.max() + DECAYS / point.judge.drag
    steps = time / (TIME_STEP * stable_time_step(start, point.judge.law))
    end, rested = point.judge.rest(start, int(min(steps, MOST_KICKED)))
    if not rested or distance(point.state, end, grains) <= LEFT * distance(point.state, start, grains):
        return None, rested
    return Point(point.strain, end, point.judge), True


def fall(point: Point, strain: float) -> Point | None:
    """Point to which dynamics leads from another point after its strain has been changed.

    If dynamics does not come to rest, the result is the equilibrium about which it oscillates; None if there is none.
    """
    end, rested = point.judge.rest(point.strained_to(strain))
    if rested:
        return settle(Point(strain, end, point.judge))
    centre = point.judge.newton(end, thorough=True)
    if centre is None or distance(end, centre, point.judge.supported_grains(centre)) > AROUND * point.judge.overlap:
        return None
    return Point(strain, centre, point.judge, tolerated=True)


def settle(point: Point) -> Point:
    """Point reached by dynamics from a possibly unstable equilibrium; the motion may oscillate about this point."""
    for _ in range(MOST_DEPARTURES):
        if point.stable:
            return point
        other, _ = depart(point)
        if other is None:
            break
        point = other
    point.tolerated = not point.stable
    return point


COUPLED = 0.5  # overlap of the modes of two real eigenvalues above which the two are followed
SAME = 0.05  # largest relative change of the mean of the two from one step to the next
WINDOWS = (3, 4, 5, 6)  # numbers of steps from which the strain of an event is extrapolated
FAR = 6.0  # number of strain steps beyond which no forecast is made
LEVEL = 0.8  # confidence level of the intervals
SADDLE, PAIR, CONTACT = "softest eigenvalue", "gap of two real eigenvalues", "motion of contacts ahead"
# Quantiles of ln(strain left / extrapolated strain left) for events that occurred. Widened by the scatter of the
# windows, the intervals contain LEVEL of the events in packings that `python -m benchmarks forecast` does not use; for
# saddle nodes, these are the packings with even numbers in the reference catalogue
CALIBRATED = {SADDLE: (-1.0, 0.1, 1.4), PAIR: (-0.7, 0.4, 1.7), CONTACT: (-0.45, -0.03, 0.9)}


class Signs(NamedTuple):
    """Series along a path since its last event, with absolute values of strain, so that they never decrease."""

    strain: np.ndarray  # (S,)
    softest: np.ndarray  # (S,) smallest real eigenvalue [1/time²]
    loss_ahead: np.ndarray  # (S,) strain to the loss of a contact that causes instability
    couples: list[np.ndarray]  # for each step, (K, 3) mean eigenvalue, squared gap, overlap of coupled real modes
    pairs: np.ndarray  # (S,) complex pairs
    events: np.ndarray  # (E,) strains of all events so far


@readable(head=lambda one: str(one))
class Forecast(NamedTuple):
    """Forecast of the strain of the next event, or of the next complex pair, with an 80 % interval.

    The interval is valid if the event occurs at all: it contained the strains of 80 % of the events that occurred in
    other packings. It is widened by the scatter of extrapolations from several windows of steps. Many predicted events
    do not occur, or only much later, because the lost contact causes only a small motion: see the documentation.
    """

    of: str  # "event" or "pair"
    basis: str  # basis of the forecast
    made: float  # strain at which the forecast was made
    strain: float
    low: float
    high: float
    windows: int  # number of extrapolations

    def __str__(self) -> str:
        return (
            f"next {self.of} forecast at strain {self.strain:.6g} ({100 * LEVEL:.0f} % interval {self.low:.6g} to "
            f"{self.high:.6g}), from the {self.basis} up to {self.made:.6g}"
        )

    def signed(self, sign: int) -> "Forecast":
        """Forecast in the strain of the path, which decreases if the sign is −1."""
        return self._replace(**{name: sign * getattr(self, name) for name in ("made", "strain", "low", "high")})


def forecast(signs: Signs) -> list[Forecast]:
    """Forecasts of the next event and the next pair from the last steps of a path, where signs of them exist.

    An event is forecast as a saddle node or as the loss of a contact, whichever is earlier.
    """
    if not len(signs.strain):
        return []
    events = [left for left in (extrapolations(signs, SADDLE), extrapolations(signs, CONTACT)) if len(left[1])]
    chosen = [("event", *min(events, key=lambda one: np.median(one[1])))] if events else []
    couples = extrapolations(signs, PAIR)
    chosen += [("pair", *couples)] if len(couples[1]) else []
    return [_with_interval(of, basis, float(signs.strain[-1]), left) for of, basis, left in chosen]


def extrapolations(signs: Signs, basis: str) -> tuple[str, np.ndarray]:
    """Strains that remain after the last step, extrapolated from several windows; empty if most windows give none."""
    step = float(np.diff(signs.strain[-2:]).sum())
    found = {SADDLE: _to_saddle_node, PAIR: _to_pair, CONTACT: _to_loss}[basis](signs)
    left = np.array([value for value in found if 0 < value <= FAR * step])
    return basis, left if 2 * len(left) > len(found) else left[:0]


def _with_interval(of: str, basis: str, made: float, left: np.ndarray) -> Forecast:
    middle = float(np.median(left))
    low, shift, high = CALIBRATED[basis]
    scatter = float(np.abs(np.log(left / middle)).max())
    ends = (middle * np.exp(low - scatter), middle * np.exp(shift), middle * np.exp(high + scatter))
    low, strain, high = (made + float(end) for end in ends)
    return Forecast(of, basis, made, strain, low, high, len(left))


def _to_saddle_node(signs: Signs) -> list[float]:
    """Strains to the zero of the softest eigenvalue, from fits of γ = γ_c − A λ² − B λ³ in each window."""
    found = []
    for width in WINDOWS:
        strain, value = signs.strain[-width:], signs.softest[-width:]
        if len(strain) < width or not (np.isfinite(value).all() and (value > 0).all() and (np.diff(value) < 0).all()):
            continue
        found.append(zero_of_power(strain, value) - strain[-1])
    return found


def zero_of_power(strain: np.ndarray, value: np.ndarray) -> float:
    """Strain γ_c at which λ vanishes, from γ = γ_c − A λ² − B λ³ by least squares; exact for three points.

    Examples
    --------
    >>> strain = np.array([0.0, 0.1, 0.2])
    >>> round(zero_of_power(strain, np.sqrt(1 - strain)), 9)
    1.0
    """
    size = value / value[0]
    columns = np.stack([np.ones_like(size), -(size**2), -(size**3)], axis=1)
    return float(np.linalg.lstsq(columns, strain - strain[-1], rcond=None)[0][0] + strain[-1])


def _to_loss(signs: Signs) -> list[float]:
    """Strains to the loss of a contact, as predicted at each of the last steps."""
    last = signs.strain[-WINDOWS[0] :]
    left = last + signs.loss_ahead[-WINDOWS[0] :] - last[-1]
    return left.tolist() if np.isfinite(left[-1]) and left[-1] > 0 else []


def _to_pair(signs: Signs) -> list[float]:
    """Strains to the zero of the squared gap of two coupled real eigenvalues, for the two that meet first."""
    best: list[float] = []
    for mean, *_ in signs.couples[-1]:
        strain, square = _history(signs, mean)
        found = []
        for width in (2, *WINDOWS):
            if len(strain) < width or not (np.diff(square[-width:]) < 0).all():
                continue
            slope, zero = np.polyfit(strain[-width:] - strain[-1], square[-width:], 1)
            found.append(-zero / slope)
        if found and (not best or np.median(found) < np.median(best)):
            best = found
    return best


def _history(signs: Signs, mean: float) -> tuple[np.ndarray, np.ndarray]:
    """Strains and squared gaps of coupled eigenvalues, followed back from the last step by their mean."""
    rows = list(_back(signs, mean))[::-1]
    return np.array([signs.strain[k] for k, _ in rows]), np.array([square for _, square in rows])


def _back(signs: Signs, mean: float) -> Iterator[tuple[int, float]]:
    for k in range(len(signs.strain) - 1, -1, -1):
        here = signs.couples[k]
        near = np.argmin(np.abs(here[:, 0] - mean)) if len(here) else -1
        if near < 0 or abs(here[near, 0] - mean) > SAME * mean:
            return
        mean = here[near, 0]
        yield k, float(here[near, 1])
