"""The piecewise-linear path of a packing under a slowly changing load, from event to event.

Between events velocities are proportional to the load rate, k(S) dq = df_ext, and every contact force changes linearly:
the times at which a contact reaches Coulomb's cone, opens, or closes are exact. At each of them the statuses are found
anew by the principle of minimum sliding. c, K and the geometric stiffness are frozen within an increment of load and
made anew after it; what the turning of contacts leaves out of balance goes into the next increment, so that the path
converges with the increment.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Secs. II A, III D and V.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from ..core.control import between_controls
from ..core.forces import Loads, accept, forces
from ..core.jacobian import linearised
from ..core.laws import KN, KT, LINEAR, MU, Law
from ..core.measure import mean_normal_force, rattlers, touching
from ..core.neighbors import updated
from ..core.state import OPEN, SLIDE, STICK, Control, State
from ..solve.freedom import Freedom, displaced, freedom, residual_vector
from .matrices import Matrices, matrices, statuses
from .opening import decided
from .rattling import NUDGE, gaps, moved_aside, with_modes
from .status import Choice, Verdict, status

BALANCED = 1e-6  # largest unbalanced force at the start, in mean normal forces
APEX = 1e-6  # normal force, in mean normal forces, at which a contact is at the apex of the cone
TOGETHER = 1e-9  # of an increment, within which contacts meet an event together
SMALLEST = 1e-6  # share of an increment to which it is halved
OUT_OF_BALANCE = 1e-3  # force, in mean normal forces, beyond which an increment is halved
CROWD = 200  # events without progress after which a path is said to be stuck
REACHES, CLOSES, RETURNS = "reaches the cone", "closes", "is wedged and carries again"
NOT_UNIQUE = "choices of statuses are consistent: the statuses are not unique"
IN_CIRCLES = "events follow one another without progress of the load: the path does not know how to go on"


class Event(NamedTuple):
    """What ends a linear piece."""

    load: float  # in legs of the load
    kind: str  # "reaches the cone", "sticks again", "opens", "closes", …, or why the path ends
    i: int  # the contact's bodies, or the body; −1 where none is meant
    j: int


class Point(NamedTuple):
    """The path where an increment of load ended."""

    load: float  # in legs: 1.5 is the middle of the second one
    state: State
    sliding: int  # contacts that slide
    contacts: int
    residual: float  # out-of-balance force over the mean normal force


class Path(NamedTuple):
    """A path, until its last leg was done or stability was lost."""

    points: tuple[Point, ...]
    events: tuple[Event, ...]
    verdict: Verdict  # CONSISTENT if the whole load was reached; the last event says where and why not
    unchecked: int  # times when contacts opened or closed among too many critical ones to check uniqueness
    law: Law

    @property
    def load(self) -> np.ndarray:
        """(T,) load of each point."""
        return np.array([p.load for p in self.points])

    @property
    def states(self) -> list[State]:
        """State of each point."""
        return [p.state for p in self.points]


def quasirigid_path(
    state: State, law: Law, *legs: Control, increment: float = 0.01, geometric: bool = True, report=None
) -> Path:
    """Follow a packing while its control goes in straight lines through the given ones.

    Parameters
    ----------
    state : State in equilibrium under its own control, in two dimensions
    law : Law with sharp friction, linear in the overlap (`linear`)
    legs : Control, the ends of the legs; forces, torques, gravity and stress change linearly on the way
    increment : largest increment of load between two updates of the geometry, in legs
    geometric : whether the geometric stiffness enters k
    report : called as report(share done, words) after every increment

    Raises
    ------
    ValueError
        with one sentence, if the packing is out of balance, the load acts on a body that nothing holds, or the
        controls move different components.
    """
    here = _accepted(updated(state), law)
    _check_start(here, law, legs, increment)
    nothing = np.zeros(len(here.contacts.mode), bool)
    place = _Place(here, rattlers(here, 2), nothing, nothing)
    points, events, unchecked = [_point(place, law, 0.0)], [], 0
    for number, end in enumerate(legs):
        begin, share, size, seeking = place.state.control, 0.0, increment, False
        while share < 1.0:
            # what is out of balance is made good within a whole increment: in a part of it, only its part
            piece = _Piece(place, law, begin, end, share, min(size, 1.0 - share), geometric, size / increment)
            after, used, verdict = piece.run(number + share)
            after, wedge = _aside(after, law)
            coarse = size > SMALLEST * increment
            if coarse and (len(wedge) or _misses(after, law, points[-1])):
                size, seeking = 0.5 * size, len(wedge) > 0
                continue
            if len(wedge):
                after, told = _carrying(after, law, wedge, number + share + used)
                piece.events += told
            load = number + share + used
            events, unchecked = events + piece.events, unchecked + piece.unchecked
            points.append(_point(after, law, load))
            if verdict is not Verdict.CONSISTENT:
                events.append(Event(load, verdict.value, -1, -1))
                return Path(tuple(points), tuple(events), verdict, unchecked, law)
            size = 0.5 * size if seeking and not len(wedge) else increment
            seeking = seeking and not len(wedge)
            place, share = after, 1.0 if 1.0 - share - used < 1e-12 else share + used
            if report:
                report((number + share) / len(legs), _words(points[-1]))
            if _crowded(events, number + share):
                events.append(Event(number + share, IN_CIRCLES, -1, -1))
                return Path(tuple(points), tuple(events), Verdict.UNSTABLE, unchecked, law)
        place = place._replace(state=place.state._replace(control=end))
    return Path(tuple(points), tuple(events), Verdict.CONSISTENT, unchecked, law)


def _misses(place: "_Place", law: Law, before: Point) -> bool:
    """True if what is out of balance has grown beyond what is allowed in an increment."""
    residual = _point(place, law, 0.0).residual
    return residual > OUT_OF_BALANCE and residual > 2 * before.residual


def _carrying(place: "_Place", law: Law, wedge: np.ndarray, load: float) -> tuple["_Place", list[Event]]:
    """The place in which wedged rattlers are grains like the others, and the events that say so."""
    contacts, loose = place.state.contacts, place.loose.copy()
    ends = np.concatenate([contacts.i[wedge], contacts.j[wedge]])
    caught = np.unique(ends[ends < len(loose)])
    caught = caught[loose[caught]]
    loose[caught] = False
    fresh = place.fresh.copy()
    fresh[wedge] = True
    after = _Place(with_modes(place.state, wedge, STICK), loose, place.parted & ~fresh, fresh)
    return _aside(after, law)[0], [Event(load, RETURNS, int(g), -1) for g in caught]


def _aside(place: "_Place", law: Law) -> tuple["_Place", np.ndarray]:
    """The place with rattlers moved aside, and the rows of contacts that wedge some of them."""
    before = place.state.contacts
    state, wedge = moved_aside(place.state, law, place.loose)
    after = state.contacts
    if after is before:
        return place, wedge
    marks = [_carried(mark, before, after) & (after.mode != OPEN) for mark in (place.parted, place.fresh)]
    return _Place(state, place.loose, *marks), wedge


def _carried(mark: np.ndarray, before, after) -> np.ndarray:
    """Marks of contacts in another list, by their keys."""
    out = np.zeros(len(after.mode), bool)
    out[: int(after.count[0])] = np.isin(after.key[: int(after.count[0])], before.key[np.flatnonzero(mark)])
    return out


def external(state: State, free: Freedom) -> np.ndarray:
    """(n,) generalised external force on the free coordinates [force]."""
    nothing = np.zeros((state.n_bodies, 3))
    return residual_vector(state, Loads(nothing, nothing, np.zeros((3, 3))), free)


class _Piece:
    """One increment of load at frozen c, K and geometric stiffness."""

    def __init__(self, place: "_Place", law, begin: Control, end: Control, share, increment, geometric, mends):
        self.law, self.increment, self.geometric, self.mends = law, increment, geometric, mends
        self.begin, self.end, self.share = begin, end, share
        self.events, self.unchecked, self.undecided = [], False, False
        self._start(place)
        if place.fresh.any():
            self._decide_at_apex(place)

    def _start(self, place: "_Place") -> None:
        self.place, self.state, self.loose = place, place.state, place.loose
        self.matrix = _held_matrices(place, self.law)
        self.mean = float(self.matrix.force[:, 0].mean())
        at = self.state._replace(control=between_controls(self.begin, self.end, self.share))
        to = self.state._replace(control=between_controls(self.begin, self.end, self.share + self.increment))
        missing = residual_vector(at, forces(at, self.law)[0], self.matrix.free)
        self.load = external(to, self.matrix.free) - external(at, self.matrix.free) + self.mends * missing

    def _decide_at_apex(self, place: "_Place") -> None:
        """Contacts without force open, stick or slide either way; bodies without any are released."""
        m = self.matrix
        found = decided(m, self.load, np.isin(m.rows, np.flatnonzero(place.fresh)), geometric=self.geometric)
        if found is None:
            self.undecided = True
            return
        self.unchecked = found.count is None
        at = np.flatnonzero(found.apex)
        if found.count not in (None, 1):
            self.events.append(Event(0.0, f"{found.count} {NOT_UNIQUE}", *self._bodies(at[0])))
        self.events += [Event(0.0, found.words(k), *self._bodies(k)) for k in at]
        parted = place.parted.copy()
        parted[m.rows[found.opens]] = True
        loose = rattlers(with_modes(place.state, np.flatnonzero(parted), OPEN), 2, place.loose)
        state = with_modes(place.state, m.rows[found.apex & (found.side != 0)], SLIDE)
        self._start(_Place(state, loose, parted, np.zeros_like(parted)))
        kept = np.searchsorted(m.rows, self.matrix.rows)
        side = found.side[kept]
        self.matrix = self.matrix._replace(sign=np.where(side != 0, side, self.matrix.sign))

    def run(self, start: float):
        """The place at the end, the share of the leg that was used, and the verdict."""
        m = self.matrix
        self.events = [e._replace(load=start) for e in self.events]
        if self.undecided:
            return self.place, 0.0, Verdict.UNSTABLE
        force, critical = m.force.copy(), m.limit.copy()
        slides, sign, moved, done = m.limit.copy(), m.sign.copy(), np.zeros(len(m.free)), 0.0
        for _ in range(20 * max(m.count, 50)):
            now = m._replace(sign=sign, limit=critical)
            choice = status(now, self.load, start=slides, geometric=self.geometric)
            if not choice.ok:
                return self._ended(force, moved, critical, sign, (), done), done * self.increment, choice.verdict
            self._told(choice, slides, critical, start + done * self.increment)
            slides = choice.sliding
            critical &= slides  # what sticks again has left the cone
            rate = _rates(now, slides, choice)
            step, contacts, kind = self._next(force, rate, slides, choice, 1.0 - done)
            force, moved, done = force + step * rate, moved + step * choice.velocity, done + step
            if kind == "increment":
                break
            load = start + done * self.increment
            if kind == CLOSES:
                self.events += [Event(load, CLOSES, *self._bodies(c)) for c in contacts]
            if kind != REACHES:
                return self._ended(force, moved, slides, sign, contacts, done), done * self.increment, choice.verdict
            self.events += [Event(load, REACHES, *self._bodies(c)) for c in contacts]
            critical[contacts], slides[contacts] = True, True
            sign[contacts] = -np.sign(force[contacts, 1])
        end = self._ended(force, moved, slides, sign, (), done)
        return end, done * self.increment, Verdict.CONSISTENT

    def _bodies(self, contact) -> tuple[int, int]:
        row = self.matrix.rows[contact] if contact < self.matrix.count else self.gap_rows[contact - self.matrix.count]
        return int(self.state.contacts.i[row]), int(self.state.contacts.j[row])

    def _told(self, choice: Choice, before, critical, load) -> None:
        for contact in np.flatnonzero(critical & before & ~choice.sliding):
            self.events.append(Event(load, "sticks again", *self._bodies(contact)))

    def _next(self, force, rate, slides, choice, left):
        """Share of the increment to the next event, its contacts (all that meet it together), and what it is."""
        m = self.matrix
        soonest, contacts, kind, reached = left, np.zeros(0, int), "increment", np.full(m.count, np.inf)
        for side in (1.0, -1.0):  # F̃ of a contact that sticks, on either side of the cone
            margin = m.mu * force[:, 0] - side * force[:, 1]
            slope = m.mu * rate[:, 0] - side * rate[:, 1]
            leaves = ~slides & (slope < -1e-14 * np.abs(rate).max(initial=0.0))
            time = np.where(leaves, np.maximum(margin, 0.0) / np.where(leaves, -slope, 1.0), np.inf)
            reached = np.minimum(reached, time)
        if reached.min(initial=np.inf) < soonest:
            soonest, kind = float(reached.min()), REACHES
            contacts = np.flatnonzero(reached <= soonest + TOGETHER)
        falls = rate[:, 0] < 0
        above = np.maximum(force[:, 0] - APEX * self.mean, 0.0)
        time = np.where(falls, above / np.where(falls, -rate[:, 0], 1.0), np.inf)
        if time.min(initial=np.inf) <= soonest:
            soonest, kind = float(time.min()), "at the apex"
            contacts = self._with_partners(np.flatnonzero(time <= soonest + TOGETHER))
        time = self._closing(choice)
        if time.min(initial=np.inf) < soonest:
            soonest, kind = float(time.min()), CLOSES
            contacts = m.count + np.flatnonzero(time <= soonest + TOGETHER)
        return soonest, contacts, kind

    def _with_partners(self, contacts: np.ndarray) -> np.ndarray:
        """The contacts, and the second ones of disks with two contacts: these reach the apex together."""
        state, rows, n = self.state, self.matrix.rows, len(self.state.grains.radius)
        ends = np.stack([state.contacts.i[rows], state.contacts.j[rows]], axis=1)
        number = np.bincount(ends.ravel(), minlength=state.n_bodies)
        number[n:] = 0
        chosen = np.zeros(len(rows), bool)
        chosen[contacts] = True
        while True:
            pulled = np.zeros(state.n_bodies, bool)
            pulled[ends[chosen].ravel()] = True
            more = ((pulled & (number == 2))[ends]).any(axis=1) | chosen
            if np.array_equal(more, chosen):
                return np.flatnonzero(chosen)
            chosen = more

    def _closing(self, choice: Choice) -> np.ndarray:
        """Shares of the increment after which pairs of held bodies that do not touch will touch."""
        state, m = self.state, self.matrix
        rows = np.setdiff1d(np.arange(int(state.contacts.count[0])), m.rows)
        held = np.append(~self.loose, np.ones(state.n_bodies - len(self.loose), bool))
        rows = rows[held[state.contacts.i[rows]] & held[state.contacts.j[rows]]]
        self.gap_rows = rows
        moves = m.free.spread(choice.velocity)[:, :3]
        normal, gap = gaps(state, rows)
        closing = np.einsum("ck,ck->c", moves[state.contacts.i[rows]] - moves[state.contacts.j[rows]], normal)
        reach = np.maximum(gap, 0.0) + NUDGE * float(state.grains.radius.min())  # a little beyond: they touch then
        return np.where(closing < 0, reach / np.where(closing < 0, -closing, 1.0), np.inf)

    def _ended(self, force, moved, slides, sign, contacts, done: float) -> "_Place":
        """The place after the increment: bodies moved, memory as the path has it, contacts at the apex marked."""
        m, before = self.matrix, self.state
        state = updated(displaced(before, m.free, moved))
        _, trial = forces(state, self.law)
        count = int(trial.count[0])
        where = np.searchsorted(trial.key[:count], before.contacts.key[m.rows])
        born = np.array([c for c in contacts if c >= m.count], int) - m.count
        new = np.searchsorted(trial.key[:count], before.contacts.key[self.gap_rows[born]]) if len(born) else born
        line = linearised(accept(state, trial), self.law)
        normal, stiffness = line.normal[where], np.where(line.stiffness_t[where] > 0, line.stiffness_t[where], 1.0)
        along = np.stack([normal[:, 1], -normal[:, 0], np.zeros(m.count)], axis=1)
        length = np.where(slides, sign * line.mu[where] * line.force_n[where], -force[:, 1]) / stiffness
        mode, slip = np.zeros_like(trial.mode), np.zeros_like(trial.slip)
        mode[where], slip[where] = np.where(slides, SLIDE, STICK), length[:, None] * along
        mode[new] = STICK
        fresh = np.zeros(len(mode), bool)
        fresh[new] = True
        fresh[where[[c for c in contacts if c < m.count]]] = True
        # pairs beside those of the matrix overlap where they part and were not quite apart, or met on a curved way
        parted = np.zeros(len(mode), bool)
        parted[:count] = (mode[:count] == OPEN) & (trial.mode[:count] != OPEN)
        mode[parted] = STICK
        control = between_controls(self.begin, self.end, self.share + done * self.increment)
        state = accept(state._replace(control=control), trial._replace(mode=mode, slip=slip, reached=mode == SLIDE))
        return _Place(state, self.loose, parted, fresh)


class _Place(NamedTuple):
    """Where a path is."""

    state: State
    loose: np.ndarray  # (N,) bool: rattlers
    parted: np.ndarray  # (C,) bool: pairs that still overlap a little but do not hold each other
    fresh: np.ndarray  # (C,) bool: contacts at the apex of the cone, whose status is to be decided


def _rates(matrix: Matrices, slides, choice: Choice) -> np.ndarray:
    """(M, 2) dF of all contacts over an increment."""
    relative = (matrix.c.T @ choice.velocity).reshape(-1, 2)
    turned = np.einsum("mab,mb->ma", statuses(matrix, slides), relative)
    return -np.einsum("mab,mb->ma", matrix.springs, turned)


def _accepted(state: State, law: Law) -> State:
    return accept(state, forces(state, law)[1])


def _check_start(state: State, law: Law, legs, increment: float) -> None:
    if not legs:
        raise ValueError("no leg of the load was given: give at least one Control to go to")
    if law.kind != LINEAR:
        raise ValueError(
            "a law that is not linear in the overlap was given: a path is piecewise linear for `linear` only"
        )
    if not 0 < increment <= 1:
        raise ValueError(f"increment = {increment} was given: it must be above 0 and at most 1, in legs of the load")
    for end in legs:
        if not (np.array_equal(end.free, state.control.free) and np.array_equal(end.group, state.control.group)):
            raise ValueError("the legs' controls free other components than the state's: only loads may change")
    matrix = matrices(state, law)
    if not len(matrix.free):
        raise ValueError("nothing but rattlers was given: a path needs grains that hold each other")
    mean = mean_normal_force(state, law)
    residual = np.abs(residual_vector(state, forces(state, law)[0], matrix.free)).max()
    if not residual < BALANCED * mean:
        raise ValueError(
            f"the packing is out of balance by {residual / mean:.1e} of its mean normal force, at most {BALANCED:g} is "
            f"allowed: bring it to rest with relax or equilibrate first"
        )
    whole = freedom(state)
    carried = np.isin(whole.component, matrix.free.component)
    for end in legs:
        pull = np.abs(external(state._replace(control=end), whole))
        bad = np.flatnonzero((pull > 0) & ~carried)
        if len(bad):
            raise ValueError(
                f"body {whole.body[bad[0]]} is loaded but holds nothing (a rattler): load bodies that others hold"
            )


def _point(place: "_Place", law: Law, load: float) -> Point:
    state = place.state
    loads, _ = forces(state, law)
    rows = touching(state)
    free = freedom(state).without(np.append(place.loose, np.zeros(state.n_bodies - len(place.loose), bool)))
    mean = mean_normal_force(state, law)
    residual = float(np.abs(residual_vector(state, loads, free)).max(initial=0.0))
    sliding = int((state.contacts.mode[rows] == SLIDE).sum())
    return Point(load, state, sliding, len(rows), residual / mean if mean else np.inf)


def _held_matrices(place: _Place, law: Law) -> Matrices:
    """The matrices of what holds each other, with the springs of contacts that are about to touch, too."""
    state = place.state
    m = matrices(state, law, rattlers=place.loose)
    kept = np.flatnonzero(~place.parted[m.rows])
    rows = m.rows[kept]
    material = np.concatenate([state.grains.material, state.walls.material])
    q = law.table[material[state.contacts.i[rows]], material[state.contacts.j[rows]]]
    springs = np.zeros((len(rows), 2, 2))
    springs[:, 0, 0], springs[:, 1, 1] = q[:, KN], q[:, KT]
    both = np.stack([2 * kept, 2 * kept + 1], axis=1).ravel()
    parts = {name: getattr(m, name)[kept] for name in ("rows", "damping", "sign", "force", "limit")}
    slope = q[:, MU] * q[:, KN] / q[:, KT]
    return m._replace(c=sparse.csr_array(m.c.tocsc()[:, both]), springs=springs, mu=q[:, MU], slope=slope, **parts)


def _crowded(events: list[Event], load: float) -> bool:
    """True if the last events all happened at one load: they go round in circles."""
    return len(events) >= CROWD and events[-CROWD].load >= load - 1e-12


def _words(point: Point) -> str:
    return (
        f"load {point.load:.4f}, {point.sliding} of {point.contacts} contacts slide, out of balance "
        f"{point.residual:.0e} of the mean force"
    )
