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

from ..core.forces import Loads, accept, forces
from ..core.geometry import shifts
from ..core.laws import Law
from ..core.measure import branches, mean_normal_force, rattlers, touching
from ..core.neighbors import updated
from ..core.state import OPEN, SLIDE, STICK, Control, State
from ..solve.freedom import Freedom, displaced, freedom, residual_vector
from .matrices import Matrices, matrices, statuses
from .status import Choice, Verdict, status

BALANCED = 1e-6  # largest unbalanced force at the start, in mean normal forces
NUDGE = 1e-12  # overlap, in radii, with which a contact that closes is born
WEDGED = 1e-10  # overlap, in radii, with which a rattler re-enters
TOGETHER = 1e-9  # of an increment, within which contacts reach the cone together
SMALLEST = 1e-9  # share of an increment to which it is halved in search of the load at which a rattler re-enters
CROWD = 200  # events without progress after which a path is said to be stuck
IN_CIRCLES = "events follow one another without progress of the load: the path does not know how to go on"


class Event(NamedTuple):
    """What ends a linear piece."""

    load: float  # in legs of the load
    kind: str  # "reaches the cone", "sticks again", "opens", "closes", or why the path ends
    i: int  # the contact's bodies, −1 where none is meant
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
    points, events = [_point(here, law, 0.0)], []
    for number, end in enumerate(legs):
        begin, share, size = here.control, 0.0, increment
        while share < 1.0:
            piece = _Piece(here, law, begin, end, share, min(size, 1.0 - share), geometric)
            after, used, verdict, told = piece.run(number + share)
            if verdict is not Verdict.CONSISTENT:
                events += [*told, Event(number + share + used, verdict.value, -1, -1)]
                points.append(_point(after, law, number + share + used))
                return Path(tuple(points), tuple(events), verdict, law)
            after = pushed_out(after)
            if size > SMALLEST * increment and _wedged(here, after) > WEDGED:  # a rattler re-enters sooner than that
                size *= 0.5
                continue
            here, size, events = after, increment, events + told
            share = 1.0 if 1.0 - share - used < 1e-12 else share + used
            points.append(_point(here, law, number + share))
            if report:
                report((number + share) / len(legs), _words(points[-1]))
            if _crowded(events, number + share):
                events.append(Event(number + share, IN_CIRCLES, -1, -1))
                return Path(tuple(points), tuple(events), Verdict.UNSTABLE, law)
        here = here._replace(control=end)
    return Path(tuple(points), tuple(events), Verdict.CONSISTENT, law)


def between_controls(begin: Control, end: Control, share: float) -> Control:
    """The control a share of the way from one to another."""
    mixed = {
        name: (1 - share) * getattr(begin, name) + share * getattr(end, name)
        for name in ("force", "torque", "gravity", "stress")
    }
    return begin._replace(**mixed)


def external(state: State, free: Freedom) -> np.ndarray:
    """(n,) generalised external force on the free coordinates [force]."""
    nothing = np.zeros((state.n_bodies, 3))
    return residual_vector(state, Loads(nothing, nothing, np.zeros((3, 3))), free)


class _Piece:
    """One increment of load at frozen c, K and geometric stiffness."""

    def __init__(self, state, law, begin, end, share, increment, geometric):
        self.state, self.law, self.increment, self.geometric = state, law, increment, geometric
        self.begin, self.end, self.share = begin, end, share
        self.matrix = matrices(state, law)
        free = self.matrix.free
        at = state._replace(control=between_controls(begin, end, share))
        to = state._replace(control=between_controls(begin, end, share + increment))
        # what is out of balance now is made good within this increment
        missing = residual_vector(at, forces(at, law)[0], free)
        self.load = external(to, free) - external(at, free) + missing

    def run(self, start: float):
        """The state at the end, the share of the leg that was used, the verdict, and the events."""
        m, events = self.matrix, []
        force, critical = m.force.copy(), m.limit.copy()
        slides, sign, moved, done = m.limit.copy(), m.sign.copy(), np.zeros(len(m.free)), 0.0
        for _ in range(20 * max(m.count, 50)):
            now = m._replace(sign=sign, limit=critical)
            choice = status(now, self.load, start=slides, geometric=self.geometric)
            if not choice.ok:
                end = self._ended(force, moved, critical, sign, None, "", done)
                return end, done * self.increment, choice.verdict, events
            self._told(choice, slides, critical, events, start + done * self.increment)
            slides = choice.sliding
            critical &= slides  # what sticks again has left the cone
            rate = _rates(now, slides, choice)
            step, contact, kind = self._next(force, rate, slides, choice, 1.0 - done)
            force, moved, done = force + step * rate, moved + step * choice.velocity, done + step
            if kind == "increment":
                break
            events += [Event(start + done * self.increment, kind, *self._bodies(c)) for c in np.atleast_1d(contact)]
            if kind != "reaches the cone":
                end = self._ended(force, moved, slides, sign, contact, kind, done)
                return end, done * self.increment, choice.verdict, events
            critical[contact], slides[contact] = True, True
            sign[contact] = -np.sign(force[contact, 1])
        end = self._ended(force, moved, slides, sign, None, "", done)
        return end, done * self.increment, Verdict.CONSISTENT, events

    def _bodies(self, contact) -> tuple[int, int]:
        row = self.matrix.rows[contact] if contact < self.matrix.count else self.gap_rows[contact - self.matrix.count]
        return int(self.state.contacts.i[row]), int(self.state.contacts.j[row])

    def _told(self, choice: Choice, before, critical, events, load) -> None:
        for contact in np.flatnonzero(critical & before & ~choice.sliding):
            events.append(Event(load, "sticks again", *self._bodies(contact)))

    def _next(self, force, rate, slides, choice, left):
        """Share of the increment to the next event, its contact (all that reach the cone together), and what it is."""
        m = self.matrix
        soonest, contact, kind, reached = left, -1, "increment", np.full(m.count, np.inf)
        for side in (1.0, -1.0):  # F̃ of a contact that sticks, on either side of the cone
            margin = m.mu * force[:, 0] - side * force[:, 1]
            slope = m.mu * rate[:, 0] - side * rate[:, 1]
            leaves = ~slides & (slope < -1e-14 * np.abs(rate).max(initial=0.0))
            time = np.where(leaves, np.maximum(margin, 0.0) / np.where(leaves, -slope, 1.0), np.inf)
            reached = np.minimum(reached, time)
        if reached.min(initial=np.inf) < soonest:
            soonest, kind = float(reached.min()), "reaches the cone"
            contact = np.flatnonzero(reached <= soonest + TOGETHER)
        opening = rate[:, 0] < 0
        time = np.where(opening & slides, force[:, 0] / np.where(opening, -rate[:, 0], 1.0), np.inf)
        k = int(np.argmin(time)) if len(time) else -1
        if k >= 0 and time[k] <= soonest:
            soonest, contact, kind = float(max(time[k], 0.0)), k, "opens"
        time = self._closing(choice)
        if len(time) and time.min() < soonest:
            soonest, contact, kind = float(time.min()), m.count + int(np.argmin(time)), "closes"
        return soonest, contact, kind

    def _closing(self, choice: Choice) -> np.ndarray:
        """Shares of the increment after which pairs of held bodies that do not touch will touch."""
        state, m = self.state, self.matrix
        rows = np.flatnonzero(state.contacts.mode[: state.contacts.count[0]] == OPEN)
        held = _held(state)
        rows = rows[held[state.contacts.i[rows]] & held[state.contacts.j[rows]]]
        self.gap_rows = rows
        moves = m.free.spread(choice.velocity)[:, :3]
        branch, gap = _gaps(state, rows)
        closing = np.einsum("ck,ck->c", moves[state.contacts.i[rows]] - moves[state.contacts.j[rows]], branch)
        reach = np.maximum(gap, 0.0) + NUDGE * float(state.grains.radius.min())  # a little beyond: they touch then
        return np.where(closing < 0, reach / np.where(closing < 0, -closing, 1.0), np.inf)

    def _ended(self, force, moved, slides, sign, contact, kind, done: float) -> State:
        """The state after the increment: bodies moved, memory as the path has it."""
        m, before = self.matrix, self.state
        state = updated(displaced(before, m.free, moved))
        keys = before.contacts.key[m.rows]
        _, trial = forces(state, self.law)
        count = int(trial.count[0])
        mode, slip = np.zeros_like(trial.mode), np.zeros_like(trial.slip)
        where = np.searchsorted(trial.key[:count], keys)
        branch, gap = _gaps(state, np.arange(count))
        along = np.stack([branch[:, 1], -branch[:, 0], np.zeros(count)], axis=1)
        kept = np.ones(m.count, bool)
        if kind == "opens":
            kept[contact] = False
        pull = m.springs[:, 1, 1]
        at = where[kept]
        mode[at] = np.where(slides[kept], SLIDE, STICK)
        limit = m.mu * m.springs[:, 0, 0] * np.maximum(-gap[where], 0.0) / pull
        length = np.where(slides, sign * limit, -force[:, 1] / pull)[kept]
        slip[at] = length[:, None] * along[at]
        if kind == "closes":
            row = np.searchsorted(trial.key[:count], before.contacts.key[self.gap_rows[contact - m.count]])
            mode[row], slip[row] = STICK, 0.0
        touches = gap < 0
        mode[:count] = np.where(touches, np.where(mode[:count] == OPEN, STICK, mode[:count]), OPEN)
        slip[mode == OPEN] = 0.0
        contacts = trial._replace(mode=mode, slip=slip, reached=mode == SLIDE)
        share = self.share + done * self.increment
        control = between_controls(self.begin, self.end, share)
        return accept(state._replace(control=control), contacts)


def _rates(matrix: Matrices, slides, choice: Choice) -> np.ndarray:
    """(M, 2) dF of all contacts over an increment."""
    relative = (matrix.c.T @ choice.velocity).reshape(-1, 2)
    turned = np.einsum("mab,mb->ma", statuses(matrix, slides), relative)
    return -np.einsum("mab,mb->ma", matrix.springs, turned)


def _gaps(state: State, rows):
    """Normals (C, 3) and gaps (C,) of pairs of the list; a negative gap is an overlap."""
    n, radius = len(state.grains.radius), np.append(state.grains.radius, np.zeros(len(state.walls.mass)))
    branch = branches(state)[rows]
    contacts, distance = state.contacts, np.linalg.norm(branch, axis=1)
    normal = branch / distance[:, None]
    wall = contacts.j[rows] >= n
    if wall.any():
        place = np.concatenate([state.grains.position, state.walls.point])
        normal[wall] = state.walls.normal[contacts.j[rows][wall] - n]
        apart = place[contacts.i[rows][wall]] - place[contacts.j[rows][wall]]
        distance[wall] = np.einsum("ck,ck->c", apart, normal[wall])
    return normal, distance - radius[contacts.i[rows]] - radius[contacts.j[rows]]


def _held(state: State) -> np.ndarray:
    """(B,) bool: walls, and grains that are no rattlers."""
    loose = rattlers(state, 2)
    return np.append(~loose, np.ones(state.n_bodies - len(loose), bool))


def pushed_out(state: State, rounds: int = 200) -> State:
    """The state with rattlers moved out of what they touch, as far as there is room: then they hold nothing.

    One that is wedged between two others stays where it is: it has re-entered, and carries what it is pressed with.
    """
    for _ in range(rounds):
        loose = ~_held(state)[: len(state.grains.radius)]
        rows = touching(state)
        i, j = state.contacts.i[rows], state.contacts.j[rows]
        body = np.append(loose, np.zeros(state.n_bodies - len(loose), bool))
        mine = body[i] | body[j]
        if not mine.any():
            return state
        rows, i, j = rows[mine], i[mine], j[mine]
        normal, gap = _gaps(state, rows)
        away = normal * (NUDGE - 1.0001 * gap)[:, None]
        move = np.zeros((state.n_bodies, 3))
        np.add.at(move, i[body[i]], away[body[i]])
        np.add.at(move, j[body[j]], -away[body[j]])
        grains = state.grains
        moved = updated(state._replace(grains=grains._replace(position=grains.position + move[: len(loose)])))
        state = _as_loose(moved, loose)
    return state


def _wedged(before: State, after: State) -> float:
    """Deepest overlap, in radii, of a grain that was a rattler before: zero as long as it could be pushed out."""
    loose = ~_held(before)
    rows = touching(after)
    rows = rows[loose[after.contacts.i[rows]] | loose[after.contacts.j[rows]]]
    return float(-_gaps(after, rows)[1].min(initial=0.0)) / float(after.grains.radius.min())


def _as_loose(state: State, loose) -> State:
    """The state with open contacts where rattlers do not touch, and fresh ones where they do; others are kept."""
    count = int(state.contacts.count[0])
    contacts, body = state.contacts, np.append(loose, np.zeros(state.n_bodies - len(loose), bool))
    mine = np.flatnonzero(body[contacts.i[:count]] | body[contacts.j[:count]])
    _, gap = _gaps(state, mine)
    mode, slip, pair, roll = (a.copy() for a in (contacts.mode, contacts.slip, contacts.pair, contacts.roll))
    mode[mine], slip[mine] = np.where(gap < 0, STICK, OPEN), 0.0
    place = np.concatenate([state.grains.position, state.walls.point])
    turned = np.concatenate([state.grains.angle * state.grains.radius[:, None], np.zeros((len(state.walls.mass), 3))])
    i, j = contacts.i[mine], contacts.j[mine]
    pair[mine] = place[i] - place[j] + shifts(contacts, state.cell.vectors)[mine]
    roll[mine] = turned[i] + turned[j]
    return state._replace(contacts=contacts._replace(mode=mode, slip=slip, pair=pair, roll=roll))


def _accepted(state: State, law: Law) -> State:
    return accept(state, forces(state, law)[1])


def _check_start(state: State, law: Law, legs, increment: float) -> None:
    if not legs:
        raise ValueError("no leg of the load was given: give at least one Control to go to")
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


def _point(state: State, law: Law, load: float) -> Point:
    loads, _ = forces(state, law)
    rows = touching(state)
    free = freedom(state).without(~_held(state))
    mean = mean_normal_force(state, law)
    residual = float(np.abs(residual_vector(state, loads, free)).max(initial=0.0))
    sliding = int((state.contacts.mode[rows] == SLIDE).sum())
    return Point(load, state, sliding, len(rows), residual / mean if mean else np.inf)


def _crowded(events: list[Event], load: float) -> bool:
    """True if the last events all happened at one load: they go round in circles."""
    return len(events) >= CROWD and events[-CROWD].load >= load - 1e-12


def _words(point: Point) -> str:
    return (
        f"load {point.load:.4f}, {point.sliding} of {point.contacts} contacts slide, out of balance "
        f"{point.residual:.0e} of the mean force"
    )
