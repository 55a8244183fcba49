"""Events of quasi-static shear: discontinuities of the path of equilibria, bracketed, classified and measured."""

from typing import Annotated, Literal

import numpy as np

from ..core.arguments import POSITIVE, Positive, checked, knows_bonds
from ..core.contacts.bonding import broken_since
from ..core.laws.builtin import KEEPS_FORCE, Law, damping_model, rescales
from ..core.measure import touching
from ..core.progress import NotInEquilibriumError, Report, silent
from ..core.state import State
from ..solve.equilibrate import equilibrate
from ..solve.shear_response import PRUNE, softest
from .event_class import Break, Event, Events, StrainStep, describe, jump_size, loss_ahead
from .event_path import (
    BALANCED,
    Judge,
    Point,
    commit,
    continuous,
    depart,
    displacement,
    distance,
    fall,
    is_jump,
    settle,
)
from .packing import reduced_cell
from .settling import Deformation, Mode, deformation

SMALLEST = 0.02  # smallest displacement of an event, in mean overlaps
FINER = 1024  # ratio of the width of a bracket to that of the finer one, from which distances to an event are measured
MOST_STEPS = 1_000_000  # largest number of strain steps of a search
TRIALS = 200  # largest number of steps to find the finer bracket
THOROUGH = 4  # largest step, in widths of a bracket, for which Newton's method may converge slowly
SWITCHED = 5  # number of most mobilised sticking contacts tried in the switch test of each strain step
SKEW = 0.5  # shear of the cell at which it is replaced by a less skewed one


@checked
@knows_bonds
def find_events(
    state: State, law: Law, *, to: Positive, drag: Positive, step: Positive = 4e-4,
    resolution: Positive = 1e-6, most: Annotated[int, POSITIVE] | None = None, smallest: Positive = SMALLEST,
    prune: Positive = PRUNE, mode: Mode = "simple", sign: Literal[1, -1] = 1,
    report: Report = silent,
) -> Events:  # fmt: skip
    """Shear or compress a packing quasi-statically and find the discontinuities of its path.

    The path is followed by Newton's method. A step counts as continuous if it ends at an equilibrium that is stable
    under the drag and if the grains moved as the linear responses at both ends predict. Any other step is halved
    repeatedly, down to `resolution`; from the last stable state, dynamics with the drag then determines the next state.
    If this is not a continuation of the path, there is an *event*; `EventKind` and `Event` list its properties. Breaks
    of bonds are also events: when the first bond reaches its strength, it breaks, and dynamics determines the next
    state; other bonds may break on the way.

    Parameters
    ----------
    state : packing in a periodic cell, without walls
    law : Law without dashpots; drag is the only dissipation
    to : strain at which the search ends, counted from the given state
    drag : ν in m r̈ = F − m ν ṙ, for translations and rotations, without a default: a complex pair λ grows only if
        Re λ < (Im λ/ν)², so the drag is part of the definition of an event. Usual values are 0.2 to 2 divided by
        `stable_time_step`, or 0.1 to 1 times the highest frequency [1/time]
    step : largest strain step
    resolution : largest width of a bracket
    smallest : root mean square non-affine displacement of grains, in mean overlaps of the given state, above which a
        jump is an event; smaller jumps, such as stick-slip of a single contact, are part of the path
    most : number of events after which the search ends, at the end of the strain step
    prune : fraction of the mean overlap below which a contact does not support grains; see `solve.shear_response`
    mode, sign : deformation of the cell (see `aqs`); stresses are work-conjugate to the strain
    report : called as report(stage, share done, text) after each strain step

    Raises
    ------
    ValueError
        If the packing has walls, open sides, loads or held grains, if the law has dashpots or forces without a tangent,
        or if `to`, `step` and `resolution` do not fit together.
    NotInEquilibriumError
        If the first state cannot be brought to rest.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.86, dim=2, seed=1)
    >>> found = find_events(state, ss.laws.hertz_mindlin(mu=0.5), to=8e-4, drag=0.2)
    >>> len(found.events), found.end
    (0, 'the last strain was reached')
    """
    check_packing(state, law)
    _check(to, step, resolution)
    way = deformation(mode, 2 if state.cell.dim == 2 else 3, sign)
    search = Search(settle(first_point(state, law, drag, prune, way)), step, resolution, smallest)
    end, rows = "the last strain was reached", []
    for k in range(int(np.ceil(round(to / step, 9)))):
        if most is not None and len(search.events) >= most:
            end = "the number of events was reached"
            break
        goal = min(to, (k + 1) * step)
        rows.append((*_predictors(search.point), loss_ahead(search.point, step)))
        if not search.advance(goal):
            end = f"at strain {search.point.strain:.6g} dynamics did not come to rest"
            break
        if search.fell_apart:
            end = f"at strain {search.point.strain:.6g} the packing fell apart and no longer carries any load"
            break
        report("search for events", goal / to, f"strain {goal:.4g}, {len(search.events)} events")
    steps = StrainStep(*np.array(rows).reshape(-1, len(StrainStep._fields)).T)
    return Events(tuple(search.events), steps, search.point.state, drag, step, resolution, end)


def check_packing(state: State, law: Law) -> None:
    """Raise ValueError for an unsuitable law, or for a packing that is not loaded by strain alone."""
    control, dim = state.control, state.cell.dim
    if len(state.walls.mass):
        raise ValueError("the packing has walls: events can be searched for only in a periodic cell under shear")
    if not state.cell.periodic[:dim].all():
        raise ValueError("the cell of the packing must be periodic in all dimensions")
    acts = (control.force, control.torque, control.gravity, control.spring, control.rate, control.cell_free)
    if any(part.any() for part in acts) or not control.free[:, :dim].all() or (control.group >= 0).any():
        raise ValueError("the packing has loads, springs or grains that are not free: only strain may act")
    if damping_model(law):
        raise ValueError("the law has dashpots, but drag must be the only dissipation: omit damping")
    if rescales(law):
        raise ValueError("the law must not have rescaled=True: its forces have no tangent at an accepted state")
    if law.properties & KEEPS_FORCE:
        raise ValueError(
            "the law has a memory of forces, but the search for events requires a memory of slips: use "
            "with_memory(law, 'slip')"
        )


def _check(to: float, step: float, resolution: float) -> None:
    if to > MOST_STEPS * step:
        raise ValueError(f"to = {to:g} with step = {step:g} exceeds the limit of {MOST_STEPS} steps")
    if resolution > step:
        raise ValueError(f"resolution must not exceed step, got {resolution:g} and {step:g}")


def first_point(state: State, law: Law, drag: float, prune: float, way: Deformation) -> Point:
    """First point of a path, the given state at rest; contacts of a packing made without friction are made to stick."""
    here = commit(state, law)
    if not len(touching(here)):
        raise ValueError("the packing has no contacts and carries no load: compress it first")
    judge = Judge(here, law, drag, prune, way=way)
    end, outcome = equilibrate(here, law, tolerance=BALANCED * judge.force, check="nothing")
    if not outcome.ok:
        raise NotInEquilibriumError("the first state of the path could not be brought to rest", outcome)
    point = Point(0.0, end, Judge(end, law, drag, prune, way=way))
    if not point.response.support.grains.any():
        raise ValueError("all grains of the packing are rattlers: compress it first")
    return point


class Search:
    """A path followed from one strain step to the next, and the events found on it."""

    def __init__(self, point: Point, step: float, resolution: float, smallest: float):
        self.point, self.step, self.resolution = point, step, resolution
        self.least = smallest * point.judge.overlap  # smallest displacement of an event
        self.events: list[Event] = []
        self.history = [point]  # since the last event
        self.loss: Break | None = None  # interruption at which stability was lost, if the path continued

    def advance(self, goal: float) -> bool:
        """Follow the path to a strain; return False if dynamics does not come to rest."""
        first, known = self.point, len(self.events)
        waiting, trial = [goal], first.newton(goal)
        while waiting and not self.fell_apart:
            if self._continues(trial):
                self._accept(trial)
                waiting.pop()
            elif waiting[-1] - self.point.strain > self.resolution:
                waiting.append(0.5 * (waiting[-1] + self.point.strain))
            elif self._judge(trial, waiting[-1]):
                waiting.pop()
            else:
                return False
            trial = self._try(waiting[-1]) if waiting and not self.fell_apart else None
        if self.fell_apart:
            return True
        if len(self.events) > known:
            off = self._distance_from(first.newton(goal, thorough=True))
            self.events[known:] = [event._replace(newton_distance=off) for event in self.events[known:]]
        self._choose_cell()
        return True

    @property
    def fell_apart(self) -> bool:
        """True if only rattlers remain."""
        return not self.point.response.support.grains.any()

    def _distance_from(self, other: Point | None) -> float:
        """Distance of a point from the present one, in mean diameters; NaN without a point."""
        if other is None:
            return np.nan
        both = self.point.response.support.grains & other.response.support.grains
        return distance(other.state, self.point.state, both) / self.point.judge.diameter

    def _choose_cell(self) -> None:
        vectors = self.point.state.cell.vectors
        if abs(vectors[1, 0]) > SKEW * vectors[0, 0]:
            self.point = Point(
                self.point.strain, reduced_cell(self.point.state), self.point.judge, tolerated=self.point.tolerated
            )

    def _try(self, strain: float) -> Point | None:
        """Point found by Newton's method at a strain, with enough iterations where failure matters."""
        return self.point.newton(strain, thorough=strain - self.point.strain <= THOROUGH * self.resolution)

    def _continues(self, trial: Point | None) -> bool:
        """Return True if a trial point continues the path."""
        if trial is None or not trial.holds or not continuous(self.point, trial):
            return False
        trial.tolerated = not trial.stable and self.point.tolerated and depart(trial)[0] is None
        return trial.stable or trial.tolerated

    def _accept(self, point: Point) -> None:
        self.point = point
        self.history = [p for p in self.history if p.strain >= point.strain - 2 * self.step] + [point]
        if point.stable:
            self.loss = None

    def _judge(self, trial: Point | None, goal: float) -> bool:
        """Let dynamics determine the end of a step as short as a bracket; return False if it does not come to rest."""
        before = self.point
        reached = trial if trial is not None and continuous(before, trial) else None
        snaps = reached is not None and not reached.holds
        beyond = reached if reached is not None and not snaps and not reached.stable else None
        if snaps:
            end, rested = before.judge.rest(reached.state)
            if not rested:
                return False
            after, jumps = settle(Point(goal, end, before.judge)), True
        elif beyond is not None:
            other = depart(beyond)[0]
            beyond.tolerated = other is None
            after = settle(other) if other else beyond
            jumps = self._is_far(beyond, after)
        else:
            after = fall(before, goal)
            if after is None:
                return False
            jumps = self._is_far(before, after) and is_jump(before, after) and not continuous(before, after)
        jumps = jumps or len(broken_since(after.state, before.state)) > 0
        lost = before.stable and not after.stable
        if not (jumps or lost):
            self._accept(after)
            return True
        path, upper = self._refine_break(before, goal) if before.stable else ([before], goal)
        break_ = Break(self.history + path[1:], path[-1], upper, before, beyond, after, goal, snaps)
        if path[-1].strain == goal:  # even shorter steps succeed
            self._accept(path[-1])
        elif jumps:
            self._record(break_)
        else:
            self._accept(after)
            self.loss = break_
        return True

    def _is_far(self, a: Point, b: Point) -> bool:
        moved = displacement(a.state, b.state, b.strain - a.strain, a.judge.way)
        return jump_size(moved, a.response.support.grains)[0] > self.least

    def _record(self, event: Break) -> None:
        """Add an event; if stability was lost within the last strain step, the instability has grown since then."""
        loss = self.loss
        if loss is not None and not event.snaps and event.goal - loss.goal <= self.step:
            bracket, beyond = (loss.before.strain, loss.goal), loss.after
            event = event._replace(history=loss.history, last=loss.last, upper=loss.upper, beyond=beyond)
        else:
            bracket = (event.before.strain, event.goal)
        self.events.append(describe(event, self.step, bracket))
        self.point, self.history, self.loss = event.after, [event.after], None

    def _refine_break(self, start: Point, goal: float) -> tuple[list[Point], float]:
        """Points of the path up to a break, and the strain beyond it; the goal if there is no break.

        If the path is too rough for long steps, the bracket extends to the goal.
        """
        waiting, path = [goal], [start]
        for _ in range(TRIALS):
            if not waiting:
                break
            trial = path[-1].newton(waiting[-1], thorough=True)
            if trial is not None and trial.holds and continuous(path[-1], trial) and trial.stable:
                path.append(trial)
                waiting.pop()
            elif waiting[-1] - path[-1].strain > self.resolution / FINER:
                waiting.append(0.5 * (path[-1].strain + waiting[-1]))
            else:
                return path, waiting[-1]
        return path, goal


def _predictors(point: Point) -> tuple:
    """Row of `StrainStep`, without its last column."""
    response, (shear, pressure) = point.response, point.stress
    values = point.eigenvalues
    growth = np.abs(np.sqrt(values[values.imag > 0]).imag).max(initial=0.0)
    switch = min((softest(response.eigenvalues_if(row)) for row in response.sticking(SWITCHED)), default=np.nan)
    return (
        point.strain, softest(values), response.speed, float(growth), response.modulus, switch, shear, pressure,
    )  # fmt: skip
