"""Piecewise-linear path of a packing under a slowly changing load, from event to event.

Between events, velocities are proportional to the load rate (k(S) dq = df_ext) and contact forces change linearly, so
the loads at which a contact reaches the Coulomb cone, opens, or closes are exact. At each event, statuses are
determined again by the principle of minimum sliding. c, K and the geometric stiffness are frozen within a load
increment and recomputed after it. At the end of an increment, a few Newton steps remove the imbalance due to the
rotation of contacts.

The load of a bond that breaks is not lost at once: forces on its two grains replace it, and decrease to zero while all
other loads are held.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Secs. II A, III D and V.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ... import OPEN, SLIDE, STICK, Control, Law, State, accept, forces, freedom
from ...control import between
from ...kit import (
    FAILURES,
    UNBREAKABLE,
    Report,
    broken_since,
    builtin,
    checked,
    is_beam,
    knows_bonds,
    pluralize,
    readable,
    require_positive,
    silent,
    volume,
    with_neighbor_list,
    with_strength_of,
    with_weakest_broken,
)
from ...laws import linear
from ...measure import bond_shares, touching
from ...modes import residual_vector
from .collapse import Collapse, describe_collapse, displacements, run_to_rest
from .events import BREAKS, Event, Fork, gaps, move_aside, with_modes
from .increment import CROWD, OUT_OF_BALANCE, Increment, PathState, force_scale, unbalanced_force, without_bonds_of
from .matrices import joined_bodies, linear_system, loose_grains
from .status import Verdict
from .system import driven_motions, external_force, lowest_eigenvalue, relax_clusters

SMALLEST = 1e-8  # fraction of a leg down to which increments are halved; wedged rattlers then overlap by round-off
SHRINKS = 0.9  # an increment is halved further only while each halving reduces the imbalance to this fraction
PROGRESS = 1e-5  # fraction of a leg; the load stalls if CROWD events and parts of increments raise it by less
RETURNS = "is wedged and carries load again"
BREAK_KINDS = tuple(f"{BREAKS} by {load}" for load in FAILURES)  # kinds of events, by the index in `FAILURES`
COLLAPSE, PASSES = "collapse", "dynamics continues without a collapse"
OFFSET = 1e-4  # fraction of a leg by which the load is raised to make a packing collapse; doubled if nothing moves
JUMP = 10.0  # a motion larger than the previous one by this factor, for the same load change, is a collapse
CRAWLS = 1e-4  # fraction of an increment; the path ends after CROWD parts shorter than this that have no event
PARTED = 1e-9  # ratio of gap to radius beyond which contacts at the apex have parted; the uncertainty of positions
ROUND_OFF = 1e-9  # relative round-off of the forces of a state in which a bond breaks
REMOVAL = 0.25  # largest share of the load of a broken bond that is removed between two updates of the geometry
AGAIN = 5  # number of times a disk must be wedged before its path counts as dependent on the increment


class PathPoint(NamedTuple):
    """Point on a load path at the end of an increment."""

    load: float  # in legs: 1.5 is the middle of the second leg
    state: State
    sliding: int  # number of sliding contacts
    contacts: int  # number of contacts
    residual: float  # unbalanced force over the larger of the mean normal force and `force_scale`


@readable
class LoadPath(NamedTuple):
    """Load path up to the end of its last leg or to the loss of stability."""

    points: tuple[PathPoint, ...]
    events: tuple[Event, ...]
    verdict: Verdict  # CONSISTENT if the full load was reached; otherwise the last event gives the load and reason
    alternatives: tuple[Fork, ...]  # loads at which other statuses were consistent, too
    unchecked: int  # number of times that uniqueness could not be decided because too many contacts were critical
    law: Law
    collapses: tuple[Collapse, ...] = ()  # collapses through which dynamics carried the packing, if `drag` was given

    @property
    def complete(self) -> bool:
        """True if the full load was reached."""
        return self.verdict is Verdict.CONSISTENT

    @property
    def loses_stability(self) -> bool:
        """True if the packing loses its stability at the end of the path."""
        return self.verdict in (Verdict.UNSTABLE, Verdict.NEGATIVE, Verdict.MECHANISM, Verdict.FLOWS)

    @property
    def summary(self) -> str:
        """Sentence about the end of the path and the uniqueness of its statuses."""
        end = "the full load was reached" if self.complete else self.verdict.value
        if falls := sum(not event.quiet and event.rests for event in self.collapses):
            end += f", after {pluralize(falls, 'collapse')}"
        if quiet := sum(event.quiet for event in self.collapses):
            end += f"; dynamics passed {pluralize(quiet, 'end')} of the path without a collapse"
        if broken := sum(e.kind in BREAK_KINDS for e in self.events):
            end += f"; {pluralize(broken, 'bond')} broke"
        disks, times = np.unique([e.i for e in self.events if e.kind == RETURNS], return_counts=True)
        if len(disks) and times.max() >= AGAIN:
            end += (
                f"; disk {disks[times.argmax()]} was wedged and freed {times.max()} times, so that the end may depend "
                f"on the increment: compare several, or slow dynamics"
            )
        if forks := len(self.alternatives):
            end += f"; other statuses were also consistent at {forks} load{'s'[: forks > 1]}: see `alternatives`"
        if self.unchecked:
            end += f"; {self.unchecked} times it is unknown whether other statuses were consistent"
        return end

    @property
    def load(self) -> np.ndarray:
        """Loads (T,) of all points, in legs."""
        return np.array([p.load for p in self.points])

    @property
    def states(self) -> list[State]:
        """States of all points."""
        return [p.state for p in self.points]


@checked
@knows_bonds
def load_path(
    state: State, law: Law, *legs: Control, increment: float = 0.01, geometric: bool = True, drag: float | None = None,
    duration: float | None = None, travel: float | None = None, report: Report = silent,
) -> LoadPath:  # fmt: skip
    """Follow a packing while its control changes linearly from one given control to the next.

    The first leg begins at the control of the state. The loads of the given controls are absolute, not increments.
    If no stable equilibrium continues the path, it ends or, if `drag` is given, damped dynamics under a constant load
    leads to the next equilibrium, from which the path continues. Forces are dead loads. To prescribe a displacement,
    pull with a stiff spring whose load point moves (`with_machine`).

    Bonds are elastic springs, as in `linear_system(..., bonds="elastic")`: a state stores their loads as deformations,
    which rigid bonds do not have. A bond breaks where its load reaches its strength; the event states the mode of
    failure. Its load then passes to other bonds, while the external load stays the same. Where no equilibrium
    continues the path, it ends or, with `drag`, continues by dynamics. In cemented boxes, steps of `equilibrate` and
    slow dynamics broke the same bonds (`tests/wings/status/test_cemented_path.py`).

    In slow dynamics with 200 load steps, the motion of the lid agreed with the path to within 0.1 % (median) and 0.9 %
    (largest), and the strains of sheared cells agreed to within 0.06 %, event by event, where only one status was
    consistent (`tests/wings/status/test_path.py`).

    Parameters
    ----------
    state : State in equilibrium under its own control; its bonds must be beams that do not fade
    law : Law with sharp friction, linear in the overlap (`linear`)
    legs : Control at the end of each leg; forces, torques, gravity, stress and the anchors of springs change linearly
        within each leg
    increment : largest increment of load between two updates of the geometry, as a fraction of a leg
    geometric : whether k includes the geometric stiffness
    drag : drag on all motion in a collapse; default: the path ends where stability is lost [1/time]
    duration : longest time of a collapse; default: 1e5 natural units (see `relax`) [time]
    travel : largest displacement of a body in a collapse; default: 5 mean diameters. If the packing is not at rest
        within both limits, it flows, and the path ends [length]
    report : called as report(stage, share done, text) after every increment

    Raises
    ------
    ValueError
        If the packing is out of balance or unstable, the law is not linear, bonds fade or are mere springs, the load
        acts on an unsupported body, or the controls have different free components.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, law = ss.packings.biaxial_box(30, pressure=1e-3, seed=1)
    >>> lid = 30 + 3  # body of the upper wall
    >>> path = ss.quasirigid.load_path(
    ...     state, law, ss.quasirigid.with_load(state.control, lid, 1.05), increment=0.1
    ... )
    >>> path.verdict.name
    'CONSISTENT'
    """
    here = with_neighbor_list(state)
    here = accept(here, forces(here, law)[1])
    check_start(here, law, legs, increment)
    if drag is not None:
        check_dynamics(state.control, drag, duration, travel)
    place = _place(here)
    way = _PathRecord(_path_point(place, law, 0.0), law)
    for number, (begin, end) in enumerate(pairwise((state.control, *legs))):
        leg = _Leg(law, begin, end, number, len(legs), increment, geometric)
        share = 0.0
        while share < 1.0:
            place, share, verdict = _follow_leg(place, share, leg, way, report)
            if verdict is Verdict.CONSISTENT:
                break
            if drag is None:
                return way.path(verdict)
            report("load path", (number + share) / len(legs), f"load {number + share:.4f}, dynamics: {verdict.value}")
            rest, share = _go_through(place, share, leg, way, verdict, (drag, duration, travel))
            if rest is None:
                return way.path(Verdict.FLOWS)
            place = rest
        place = place._replace(state=place.state._replace(control=end))
    return way.path(Verdict.CONSISTENT)


class _Leg(NamedTuple):
    """Leg of a path, and how it is followed."""

    law: Law
    begin: Control
    end: Control
    number: int
    count: int  # number of legs
    increment: float
    geometric: bool
    removes: bool = False  # whether this leg removes the load of a broken bond, with other loads held at `number`


def _place(state: State) -> PathState:
    """Return the state at the beginning of a path."""
    nothing = np.zeros(len(state.contacts.mode), bool)
    return PathState(state, loose_grains(state), nothing, nothing, True, -np.inf)


class _PathRecord:
    """Record of a path: points, events, forks and collapses so far."""

    def __init__(self, first: PathPoint, law: Law):
        self.points, self.events, self.forks, self.unchecked, self.law = [first], [], [], 0, law
        self.anchor, self.since, self.collapses, self.offset = 0.0, 0, [], OFFSET
        self.crawled = 0  # number of very short parts of increments since the last event

    def add(self, piece: Increment, point: PathPoint) -> None:
        self.points.append(point)
        self.events += piece.events
        self.unchecked += piece.unchecked
        last = self.forks[-1] if self.forks else None
        for fork in piece.forks:
            if last is None or fork[1:] != last[1:]:  # a motion that stays undetermined is recorded once
                self.forks.append(fork)
            last = fork
        # count events and parts of increments since the load last advanced
        if point.load > self.anchor + PROGRESS:
            self.anchor, self.since = point.load, 0
        else:
            self.since += 1 + len(piece.events)

    def include(self, other: "_PathRecord", load: float) -> None:
        """Add the events of another record under one load."""
        self.events += [event._replace(load=load) for event in other.events]
        self.forks += [fork._replace(load=load) for fork in other.forks]
        self.unchecked += other.unchecked
        self.anchor, self.since = load, 0

    def raised_by(self, load: float, most: float) -> float:
        """Return the share of a leg by which the load is raised; larger if dynamics near it found no collapse."""
        last = self.collapses[-1] if self.collapses else None
        self.offset = min(2 * self.offset, most) if last and last.quiet and load < last.held + most else OFFSET
        return self.offset

    def motion_before(self, load: float, width: float, held: np.ndarray) -> float:
        """Displacement of the given bodies per load, over the last `width` of the path [length]."""
        since = self.collapses[-1].held if self.collapses else -np.inf
        earlier = [p for p in self.points if since <= p.load <= load - width]
        begin = earlier[-1] if earlier else self.points[0]
        moved = displacements(begin.state, self.points[-1].state)[held, :3]
        return float(np.linalg.norm(moved) / (load - begin.load)) if load > begin.load else 0.0

    def collapse(self, event: Collapse, point: PathPoint, broken: np.ndarray) -> None:
        self.points.append(point)
        self.collapses.append(event)
        self.events += [
            Event(event.load, event.reason, -1, -1), Event(event.held, PASSES if event.quiet else COLLAPSE, -1, -1),
            *_break_events(event.held, broken),
        ]  # fmt: skip
        self.anchor, self.since = point.load, 0

    def path(self, verdict: Verdict) -> LoadPath:
        if verdict is not Verdict.CONSISTENT:
            self.events.append(Event(self.points[-1].load, verdict.value, -1, -1))
        return LoadPath(
            tuple(self.points), tuple(self.events), verdict, tuple(self.forks), self.unchecked, self.law,
            tuple(self.collapses),
        )  # fmt: skip


def _go_through(
    place: PathState, share: float, leg: _Leg, way: _PathRecord, verdict: Verdict, through: tuple
) -> tuple[PathState | None, float]:
    """Run dynamics from the end of the path; return the state, or None without rest, and the share of the leg."""
    load, raised = leg.number + share, min(1.0, share + way.raised_by(leg.number + share, leg.increment))
    before = place.state._replace(control=place.state.control if place.breaking else between(leg.begin, leg.end, share))
    motion = run_to_rest(before, leg.law, between(leg.begin, leg.end, raised), *through)
    free, held = freedom(before), np.append(~place.loose, np.zeros(len(before.walls.mass), bool))
    ends = (external_force(before._replace(control=c), free) for c in (leg.begin, leg.end))
    quiet = JUMP * (raised - share) * way.motion_before(load, 0.5 * leg.increment, held)
    known = {"load": load, "reason": verdict.value, "held": leg.number + raised}
    event = describe_collapse(before, motion, leg.law, -np.subtract(*ends), quiet, **known)
    after = _place(motion.state)
    way.collapse(event, _path_point(after, leg.law, leg.number + raised), broken_since(motion.state, before))
    return (after if motion.rests else None), raised


def _follow_leg(place: PathState, share: float, leg: _Leg, way: _PathRecord, report: Report):
    """Follow a leg from a given share of it; return the state and the share at which it stops, and the verdict."""
    law, increment, size, missed = leg.law, leg.increment, leg.increment, np.inf
    wedged = 0.0  # share at which a rattler was found to be wedged, slightly after it became so
    while share < 1.0:
        # an imbalance is removed over a whole increment; part of an increment removes only a share of it
        piece = Increment(
            place, law, leg.begin, leg.end, share, min(size, 1.0 - share), leg.geometric, size / increment
        )
        after, used, verdict = piece.run(leg.number + share)
        after, wedge = _move_rattlers(after, law, place.state)
        load = leg.number + share + used
        if size > SMALLEST and (len(wedge) or OUT_OF_BALANCE < piece.missed < SHRINKS * missed):
            if len(wedge):
                wedged = share + used
            size, missed = max(0.5 * min(size, used), SMALLEST), piece.missed
            continue
        missed = np.inf
        if len(wedge):
            after, told = _reinstate_wedged(after, law, wedge, load)
            piece.events += told
        point = _path_point(after, law, load)
        way.add(piece, point)
        way.crawled = 0 if piece.events or used > CRAWLS * increment else way.crawled + 1
        if piece.broke and verdict is Verdict.CONSISTENT:
            if leg.removes:  # the loads of the earlier bond and of this one decrease together
                place, share, size = _break_weakest(after, law, leg.end, leg.number, way), 0.0, increment
                leg, way.anchor, way.since = leg._replace(begin=place.state.control), leg.number, 0
                continue
            after, verdict = _remove_load(after, leg, share + used, way)
        if verdict is not Verdict.CONSISTENT:
            return after, share + used, verdict
        place, share = after, 1.0 if 1.0 - share - used < 1e-12 else share + used
        left = wedged - share if not len(wedge) else 0.0
        size = max(0.5 * left, SMALLEST) if left > SMALLEST else min(2 * size, increment)
        slide = f"{point.sliding} of {point.contacts} contacts slide"
        text = f"load {point.load:.4f}, {slide}, unbalanced {point.residual:.0e} of the mean force"
        report("load path", (leg.number + share) / leg.count, text)
        if max(way.since, way.crawled) > CROWD:
            return place, share, Verdict.NO_PROGRESS
    return place, share, Verdict.CONSISTENT


def _break_events(load: float, broken: np.ndarray) -> list[Event]:
    return [Event(load, BREAK_KINDS[how], i, j) for i, j, how in broken.tolist()]


def _break_weakest(place: PathState, law: Law, control: Control, load: float, way: _PathRecord) -> PathState:
    """Break the weakest bond, and add forces that replace its load to the control.

    Grains that only this bond supported become rattlers, and forces also replace their contact forces.
    """
    before, strength = place.state, place.state.bonds.strength
    held = without_bonds_of(before, place.loose).bonds.intact
    most = (1 - ROUND_OFF) * min(1.0, bond_shares(before)[held].max())
    lowered = np.where(held[:, None] & (strength < UNBREAKABLE), most * strength, UNBREAKABLE)
    weak = with_weakest_broken(before._replace(bonds=before.bonds._replace(strength=lowered), control=control))
    state = with_strength_of(weak, before)
    way.events += _break_events(load, broken_since(state, before))
    loose = loose_grains(with_modes(state, np.flatnonzero(place.parted), OPEN), place.loose, loaded=False)
    place, wedge = _move_rattlers(place._replace(state=state, loose=loose, breaking=True, looked=-np.inf), law)
    if len(wedge):
        place, told = _reinstate_wedged(place, law, wedge, load)
        way.events += told
    return place._replace(state=place.state._replace(control=_balancing_control(place, law)))


def _balancing_control(place: PathState, law: Law) -> Control:
    """Return the control with the additional forces, torques and stresses under which a state is in balance."""
    state, control, n = place.state, place.state.control, len(place.loose)
    free = freedom(state).without(np.append(place.loose, np.zeros(state.n_bodies - n, bool)))
    missing = unbalanced_force(place, law, free)
    missing[np.abs(missing) < ROUND_OFF * np.abs(missing).max(initial=0.0)] = 0.0
    full = np.zeros(len(free.place))
    full[free.component] = missing
    body, torque = full[:-9].reshape(-1, 6), control.torque.copy()
    torque[:n] -= body[:n, 3:] * state.grains.radius[:, None]
    if free.length:
        control = control._replace(stress=control.stress + full[-9:].reshape(3, 3) * free.length / volume(state))
    return control._replace(force=control.force - body[:, :3], torque=torque)


def _remove_load(place: PathState, leg: _Leg, share: float, way: _PathRecord) -> tuple[PathState, Verdict]:
    """Break a bond and those that break as they take over its load; return the state and the verdict."""
    load, control, record = leg.number + share, between(leg.begin, leg.end, share), _PathRecord(way.points[-1], leg.law)
    place, record.anchor = _break_weakest(place, leg.law, control, load, record), load
    removal = _Leg(leg.law, place.state.control, control, load, 1, REMOVAL, leg.geometric, removes=True)
    place, _, verdict = _follow_leg(place, 0.0, removal, record, silent)
    way.include(record, load)
    if verdict is Verdict.CONSISTENT:
        place = place._replace(state=place.state._replace(control=control), breaking=False, looked=-np.inf)
        way.points.append(_path_point(place, leg.law, load))
    return place, verdict


def _reinstate_wedged(place: PathState, law: Law, wedge: np.ndarray, load: float) -> tuple[PathState, list[Event]]:
    """Make wedged rattlers ordinary grains again; return the state and the corresponding events.

    Rattlers wedged in turn by these grains are reinstated as well, until all remaining rattlers can be moved aside.
    """
    events = []
    while len(wedge):
        contacts, loose = place.state.contacts, place.loose.copy()
        ends = np.concatenate([contacts.i[wedge], contacts.j[wedge]])
        caught, unit = np.unique(ends[ends < len(loose)]), joined_bodies(place.state)
        caught = np.flatnonzero(np.isin(unit[: len(loose)], unit[caught[loose[caught]]]))
        loose[caught] = False
        # in addition to the wedging contacts, all other contacts that overlap
        count, whole = int(contacts.count[0]), np.append(loose, np.zeros(place.state.n_bodies - len(loose), bool))
        rows = np.flatnonzero(np.isin(contacts.i[:count], caught) | np.isin(contacts.j[:count], caught))
        rows = rows[~(whole[contacts.i[rows]] | whole[contacts.j[rows]])]
        rows = rows[unit[contacts.i[rows]] != unit[contacts.j[rows]]]
        wedge = np.union1d(wedge, rows[gaps(place.state, rows)[1] < 0])
        fresh = place.fresh.copy()
        fresh[wedge] = True
        stuck = with_modes(place.state, wedge, STICK)
        place = place._replace(state=stuck, loose=loose, parted=place.parted & ~fresh, fresh=fresh, wedged=True)
        place, wedge = _move_rattlers(place, law)
        events += [Event(load, RETURNS, int(g), -1) for g in caught]
    return place, events


def _move_rattlers(place: PathState, law: Law, start: State | None = None) -> tuple[PathState, np.ndarray]:
    """Move rattlers aside; return the state and the rows of contacts that wedge some of them."""
    before = place.state.contacts
    state, wedge = move_aside(place.state, law, place.loose, start)
    if not len(wedge) and (relaxed := relax_clusters(state, law, place.loose)) is not state:
        state, wedge = move_aside(relaxed, law, place.loose, start)
    after = state.contacts
    if state is place.state:
        return place, wedge
    known, marks = after.key[: int(after.count[0])], np.zeros((2, len(after.mode)), bool)
    for row, mark in zip(marks, (place.parted, place.fresh), strict=True):
        row[: len(known)] = np.isin(known, before.key[np.flatnonzero(mark)])
    parted, fresh = marks & (after.mode != OPEN)
    return place._replace(state=state, parted=parted, fresh=fresh), wedge


def _path_point(place: PathState, law: Law, load: float) -> PathPoint:
    rows = touching(place.state)
    parted = gaps(place.state, rows)[1] > PARTED * place.state.grains.radius.min()
    state = with_modes(place.state, rows[parted], OPEN)
    loads, _ = forces(without_bonds_of(state, place.loose), law)
    rows = touching(state)
    free = freedom(state).without(np.append(place.loose, np.zeros(state.n_bodies - len(place.loose), bool)))
    mean = force_scale(state, law, external_force(state, free))
    residual = float(np.abs(residual_vector(state, loads, free)).max(initial=0.0))
    modes = state.contacts.mode[rows]
    number, relative = int((modes != OPEN).sum()), residual / mean if mean else np.inf if residual else 0.0
    return PathPoint(load, state, int((modes == SLIDE).sum()), number, relative)


BALANCED = 1e-6  # largest unbalanced force at the start, over the mean normal force


def check_start(state: State, law: Law, legs, increment: float) -> None:
    """Raise ValueError if no path can begin in a state, or if a leg cannot be followed."""
    if not legs:
        raise ValueError("a path needs at least one leg: give a Control for the end of each leg")
    if law.kind != linear().kind or law.properties:
        raise ValueError("paths are piecewise linear only for the law `linear` with lever arms R: use this law")
    if not law.table[..., builtin.KT].min() > 0:
        raise ValueError("kt must be positive, as no contact sticks without tangential springs")
    if not 0 < increment <= 1:
        raise ValueError(f"increment must be above 0 and at most 1 leg of the load, got {increment}")
    for end in legs:
        _check_leg(state.control, end)
    if state.bonds:
        _check_bonds(state)
    matrix = linear_system(state, law, bonds="elastic")
    if not len(matrix.free):
        raise ValueError("the packing has only rattlers: a path needs grains that support each other")
    mean = force_scale(state, law, *(external_force(state._replace(control=end), matrix.free) for end in legs))
    residual = np.abs(residual_vector(state, forces(state, law)[0], matrix.free)).max()
    if not residual < BALANCED * mean:
        raise ValueError(
            f"the packing is out of balance by {residual / mean:.1e} of its mean normal force: at most {BALANCED:g} is "
            f"allowed; use `relax` or `equilibrate` first"
        )
    lowest = lowest_eigenvalue(matrix)
    if lowest < 0:
        raise ValueError(
            f"the packing is not stable: k has the eigenvalue {lowest:.1e} although all contacts stick; bring the "
            f"packing to rest under this control, with drag"
        )
    whole = freedom(state)
    carried = np.isin(whole.component, matrix.free.component)
    for end in legs:
        at = state._replace(control=end)
        for motion in driven_motions(matrix, external_force(at, matrix.free)):
            axis, body = (values[motion != 0] for values in (matrix.free.axis, matrix.free.body))
            spheres = np.unique(body)
            load = f"torque on sphere {body[0]} about its two contacts"
            if axis[0] < 3 and (axis == axis[0]).all():
                load = f"net force along {'xyz'[axis[0]]}"
            elif len(spheres) > 1:
                load = f"torque on spheres {spheres[0]} to {spheres[-1]}, which bonds join, about their two contacts"
            raise ValueError(f"a leg has an unbalanced {load}: give loads without it")
        pull = np.abs(external_force(state._replace(control=end), whole))
        bad = np.flatnonzero((pull > 0) & ~carried)
        if len(bad):
            raise ValueError(
                f"body {whole.body[bad[0]]} is loaded but is a rattler: load only bodies that are supported by others"
            )


def _check_bonds(state: State) -> None:
    """Raise ValueError for bonds that a path cannot follow."""
    bonds = state.bonds
    if (bonds.fading[bonds.intact] > 0).any():
        raise ValueError(
            "bonds that fade before they break soften within an increment: give them smooth=False on a load path"
        )
    if (bonds.intact & ~is_beam(bonds, state.cell.dim)).any():
        raise ValueError(
            "bonds on a load path must resist shear, bending and, in three dimensions, twisting, as a grain on mere "
            "springs hangs freely: use beam_bond or parallel_bond"
        )


def check_dynamics(control: Control, drag: float, duration: float | None, travel: float | None) -> None:
    """Raise ValueError if dynamics cannot hold the load of a control."""
    require_positive(drag=drag, **{k: v for k, v in (("duration", duration), ("travel", travel)) if v is not None})
    if control.rate.any() or control.cell_rate.any() or control.course.any():
        raise ValueError(
            "drag requires all rates and time profiles of bodies and cell to be zero, as dynamics holds the load "
            "constant: instead, pull with a spring whose anchor moves"
        )


def _check_leg(begin: Control, end: Control) -> None:
    for name in ("free", "group", "cell_free"):
        if not np.array_equal(getattr(end, name), getattr(begin, name)):
            raise ValueError(
                "the controls of the legs do not free the same components as the state's control: only loads may change"
            )
    for name in set(Control._fields) - {"free", "group", "cell_free", "force", "torque", "gravity", "stress", "anchor"}:
        if not np.array_equal(getattr(end, name), getattr(begin, name)):
            raise ValueError(
                f"the controls of the legs change {name}: only forces, torques, gravity, stress and anchors of "
                f"springs may change; to control a displacement, pull with a stiff spring (see `with_machine`)"
            )
    if ((end.stress != begin.stress) & ~begin.cell_free).any():
        raise ValueError(
            "the legs change the stress of a cell component that is not free: free it with `stress_controlled`"
        )
