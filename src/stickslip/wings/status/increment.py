"""One increment of a load path, linear in the load until a contact reaches the cone, opens, or closes.

c, K and the geometric stiffness are frozen. Events that only change statuses at the cone are processed within the
increment. If a contact opens or closes, the increment ends. The status of this contact is determined at the start of
the next increment, together with those of all contacts without force.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Secs. II A and III D.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError

from ... import FREE, HELD, OPEN, SLIDE, STICK, Control, Law, State, accept, forces
from ...control import between
from ...kit import builtin, factorised, incidence, linearise, mean_normal_force, with_neighbor_list
from ...measure import contact_forces
from ...modes import displaced, residual_vector
from ...results import Freedom
from .apex_status import decide_statuses
from .complementarity import complementarity, inconsistent
from .cone_apex import OPENS, SLIDES, SLIDES_BACK, STATUS_NAMES, STICKS
from .events import (
    APEX,
    BREAKS,
    CLOSES,
    INCREMENT,
    NUDGE,
    REACHES,
    Event,
    Fork,
    gaps,
    next_event,
    open_pairs,
    with_modes,
)
from .matrices import LinearSystem, force_rates, linear_system, loose_grains
from .status import ContactStatus, Verdict, status_of_critical
from .system import RESIDUAL, external_force, lowest_eigenvalue, pinned_coordinates, regular_stiffness
from .uniqueness import certificate

AT_CONE = 1e-10  # round-off of the distance from the cone over the mean normal force, at a condition number of k of 1e5
BLURRED = 10.0  # ratio of force to unbalanced force below which disks with two contacts are not checked for the cone
CROWD = 200  # number of events without progress in load after which a path ends; no observed avalanche was as large
OUT_OF_BALANCE = 1e-4  # ratio of unbalanced to mean force that halves increments; the accuracy of event loads
ROUND_OFF = 1e-8  # error of the rate of a force over the largest rate
BALANCED = 1e-10  # residual over the mean normal force after balancing; far below the force of a contact at the apex
TOUCHES = 1e-7  # gap up to which a pair touches, as a force over the mean normal force; below the error due to APEX
STRAYS = 1e-3  # ratio of estimated force error to mean normal force beyond which an increment of spheres is halved
BRACKET = 1e-3  # error of the load at which a sliding contact in 3D sticks again, as a fraction of an increment
CORRECTIONS = 6  # largest number of balance corrections; each leaves about a thousandth of the residual
LEAST = 0.01  # smallest force to which forces of a packing with bonds are compared, over the largest external force
UNLOADED = 1e-9  # the same, over the force that stretches the stiffest contact or bond by a diameter, for round-off
LOOK = 0.01  # fraction of a leg after which other statuses are searched for; c changes little within it
NO_P_MATRIX = "the status is no longer unique for every load"
NOT_UNIQUE = "combinations of statuses are consistent: the statuses are not unique"


class PathState(NamedTuple):
    """State on a load path, with masks of its rattlers and of contacts near the apex."""

    state: State
    loose: np.ndarray  # (N,) bool: rattlers
    parted: np.ndarray  # (C,) bool: pairs that still overlap slightly but carry no force
    fresh: np.ndarray  # (C,) bool: contacts at the apex of the cone, whose status must be decided
    unique: bool  # whether the status was unique for every load when last tested
    looked: float  # load of the last test for uniqueness and for other statuses
    wedged: bool = False  # whether a rattler has just been wedged
    breaking: bool = False  # whether forces of the control still replace a part of the load of a broken bond


class Increment:
    """One increment of load with frozen c, K and geometric stiffness."""

    def __init__(self, place: PathState, law, begin: Control, end: Control, share, increment, geometric, mends):
        self.law, self.increment, self.geometric, self.mends = law, increment, geometric, mends
        self.begin, self.end, self.share = begin, end, share
        self.events, self.forks, self.unchecked, self.lost, self.unique = [], [], 0, None, place.unique
        self.last, self.solve, self.missed, self.looked, self.ahead = None, None, 0.0, place.looked, None
        self.broke = False  # whether the increment ended because a bond broke
        self._set_state(place)
        self.decided = bool(place.fresh.any())  # whether contacts without force have been decided
        if self.decided:
            self._decide_at_apex(place)
        # bonds lose their stiffness, or buckle
        if self.lost is None and self.state.bonds and lowest_eigenvalue(self.matrix) < 0:
            self.lost = Verdict.NEGATIVE

    def _set_state(self, place: PathState) -> None:
        self.place, self.state, self.loose = place, place.state, place.loose
        self.matrix = _increment_matrices(place, self.law)
        contacts, rows, n = self.state.contacts, self.matrix.rows, len(self.loose)
        self.ends = np.stack([contacts.i[rows], contacts.j[rows]], axis=1)
        # both forces on a disk with two contacts lie along one line, so both reach the cone, or its apex, together
        self.has_two = np.bincount(self.ends.ravel(), minlength=self.state.n_bodies) == 2
        self.has_two[n:] = False
        if self.matrix.unit is not None:
            self.has_two &= np.bincount(self.matrix.unit, minlength=self.state.n_bodies)[self.matrix.unit] == 1
        self.paired = self.has_two[self.ends].any(axis=1)
        at = self.state._replace(control=between(self.begin, self.end, self.share))
        to = self.state._replace(control=between(self.begin, self.end, self.share + self.increment))
        missing = unbalanced_force(place._replace(state=at), self.law, self.matrix.free)
        loads = [external_force(state, self.matrix.free) for state in (at, to)]
        self.mean = (
            force_scale(self.state, self.law, *loads) if self.state.bonds else float(self.matrix.force[:, 0].mean())
        )
        self.load = loads[1] - loads[0] + self.mends * missing
        self.stiffest = float(self.matrix.springs[:, 0, 0].max(initial=0.0))
        self.gap_rows = open_pairs(self.state, self.loose, rows)
        self.faint = max(APEX * self.mean, BLURRED * np.abs(missing).max())

    def _decide_at_apex(self, place: PathState) -> None:
        """Decide whether contacts without force open, stick or slide; bodies without contact forces are released.

        Statuses of contacts without force are decided together; decisions made one by one could undo each other.
        """
        before, place = place, self._with_touching_pairs(place)
        self._set_state(place)
        m = self.matrix
        faint = m.force[:, 0] <= APEX * self.mean
        apex = faint | np.isin(m.rows, np.flatnonzero(place.fresh))
        choice = decide_statuses(m, self.load, apex, geometric=self.geometric, wedged=place.wedged)
        self.unchecked += not choice.complete
        if choice.status is None or not choice.stable:
            absent = Verdict.UNSTABLE if choice.complete else Verdict.NOT_FOUND
            self.lost = absent if choice.status is None else Verdict.NEGATIVE
            return
        if choice.others and (np.array(choice.others) != choice.status).any():
            self._record_fork(choice.status, choice.others)
        was = np.where(before.parted[m.rows], OPENS, _statuses_from_side(np.where(m.limit, m.sign, 0.0)))
        told = np.isin(m.rows, np.flatnonzero(before.fresh)) | (was != choice.status)
        self.events += [
            Event(0.0, STATUS_NAMES[choice.status[k]], *self._bodies_of(k)) for k in np.flatnonzero(apex & told)
        ]
        parted = place.parted.copy()
        parted[m.rows[choice.opens]] = True
        loose = loose_grains(with_modes(place.state, np.flatnonzero(parted), OPEN), place.loose)
        sides = choice.side
        state = with_modes(place.state, m.rows[apex & (sides == 0)], STICK)
        begins = np.flatnonzero(apex & (sides != 0))
        state = with_modes(state, m.rows[begins], SLIDE)
        if m.width == 3:  # the memory keeps the direction of the slip; its length does not matter
            state.contacts.slip[m.rows[begins]] = (
                NUDGE
                * np.einsum("ma,mak->mk", choice.velocity[begins, 1:], m.frame[begins, 1:])
                / np.abs(choice.velocity).max()
            )
        self._set_state(place._replace(state=state, loose=loose, parted=parted, fresh=np.zeros_like(parted)))
        side = sides[np.searchsorted(m.rows, self.matrix.rows)]
        self.matrix = self.matrix._replace(sign=np.where(side != 0, side, self.matrix.sign))

    def _with_touching_pairs(self, place: PathState) -> PathState:
        """Put parted pairs that still touch back at the apex of the cone, and return the state."""
        contacts, loose = place.state.contacts, np.append(place.loose, np.zeros(len(place.state.walls.mass), bool))
        back = np.flatnonzero(place.parted & ~place.fresh)
        back = back[~(loose[contacts.i[back]] | loose[contacts.j[back]])]
        parted, fresh = place.parted.copy(), place.fresh.copy()
        parted[back], fresh[back] = False, True
        return place._replace(state=with_modes(place.state, back, STICK), parted=parted, fresh=fresh)

    def _record_fork(self, taken: np.ndarray, others, forces: bool = True) -> None:
        """Record other consistent combinations; the statuses are those of all contacts, as in `cone_apex`."""
        others = np.array(others)
        differ = np.flatnonzero((others != taken).any(axis=0))
        fork = Fork(
            0.0, tuple(self._bodies_of(k) for k in differ), tuple(STATUS_NAMES[k] for k in taken[differ]),
            tuple(tuple(STATUS_NAMES[k] for k in other[differ]) for other in others), forces,
        )  # fmt: skip
        self.forks.append(fork)
        self.events.append(Event(0.0, f"{1 + len(others)} {NOT_UNIQUE}", *self._bodies_of(differ[0])))

    def run(self, start: float):
        """Run the increment; return the state at its end, the fraction of the leg that was used, and the verdict."""
        m = self.matrix
        self.events = [event._replace(load=start) for event in self.events]
        self.forks = [fork._replace(load=start) for fork in self.forks]
        if self.lost is not None:
            return self.place, 0.0, self.lost
        force, slides, sign = m.force.copy(), m.limit.copy(), m.sign.copy()
        moved, done = np.zeros(len(m.free)), 0.0
        for _ in range(CROWD):
            # contacts that reached the cone in several events at one load are decided together
            beside = self._at_cone(force, slides)
            sign[beside] = np.where(force[beside, 1] > 0, -1.0, 1.0)
            now = m._replace(sign=sign, limit=slides | beside)
            load = start + done * self.increment
            choice = self._choose_status(now, slides, load)
            if not choice.ok:
                # at the apex of a round cone, statuses for a single direction of slip prove nothing
                faint = m.width == 3 and (force[now.limit, 0] <= APEX * self.mean).any()
                verdict = Verdict.NOT_FOUND if faint else choice.verdict
                return self._finish(force, moved, slides, sign, (), done), done * self.increment, verdict
            if not self.decided and not done and self._leaves_apex(now, choice):
                self.decided = True
                self._decide_at_apex(self.place)
                return self.run(start)
            if self.looked == load and not self._is_stable(now, choice, load):
                end = self._finish(force, moved, slides, sign, (), done)
                return end, done * self.increment, Verdict.NEGATIVE
            self._record_changes(choice, slides, sign, load)
            slides = choice.sliding
            rate = force_rates(now, slides, choice.velocity)
            self.last = now, slides
            step, contacts, kind = next_event(self, force, rate, now.limit, choice, 1.0 - done, moved)
            force, moved, done = force + step * rate, moved + step * choice.velocity, done + step
            self.ahead = step, rate
            if kind == INCREMENT:
                break
            load = start + done * self.increment
            if kind != REACHES or m.width == 3:  # directions of spheres turn: c is computed again before sliding
                end = self._finish(force, moved, slides, sign, () if kind == REACHES else contacts, done)
                self.broke = kind == BREAKS
                if kind == CLOSES and end.fresh.any():
                    self.events += [Event(load, CLOSES, *self._bodies_of(c)) for c in contacts]
                return end, done * self.increment, Verdict.CONSISTENT
            self.events += [Event(load, REACHES, *self._bodies_of(c)) for c in contacts]
            slides = slides.copy()
            slides[contacts] = True
            sign[contacts] = -np.sign(force[contacts, 1])
        end = self._finish(force, moved, slides, sign, (), done)
        return end, done * self.increment, Verdict.CONSISTENT

    def _choose_status(self, now: LinearSystem, slides: np.ndarray, load: float) -> ContactStatus:
        """Return the status at a load; others are searched for after events and at intervals of LOOK."""
        changed = (self.events and self.events[-1].load == load) or (now.limit & ~slides).any()
        if not changed and load < self.looked + LOOK and (same := self._previous_status(now, slides)):
            return same
        self.looked, self.solve = load, None
        return status_of_critical(now, self.load, start=slides, geometric=self.geometric)

    def _previous_status(self, now: LinearSystem, slides: np.ndarray) -> ContactStatus | None:
        """Return the previous status if it is still consistent, otherwise None."""
        try:
            self.solve = _make_solver(now, slides, self.geometric)
            velocity = self.solve(self.load)
        except LinAlgError:
            return None
        critical = np.flatnonzero(now.limit)
        normal, along = (now.c.T @ velocity).reshape(-1, now.width)[critical, :2].T
        rate = now.slope[critical] * normal + now.sign[critical] * along
        if not np.isfinite(rate).all() or inconsistent(slides[critical], rate).any():
            return None
        return ContactStatus(Verdict.CONSISTENT, slides, critical, velocity, rate, "as before", 1)

    def _leaves_apex(self, now: LinearSystem, choice: ContactStatus) -> bool:
        """Return True if a contact that sticks without force would carry forces beyond Coulomb's limit."""
        rate = force_rates(now, choice.sliding, choice.velocity)
        sticks = ~choice.sliding & (now.force[:, 0] <= APEX * self.mean) & (rate[:, 0] > 0)
        beyond = np.linalg.norm(rate[:, 1:], axis=1) - now.mu * rate[:, 0]
        return bool((beyond[sticks] > ROUND_OFF * np.abs(rate).max(initial=0.0)).any())

    def _at_cone(self, force: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """Return the mask (M,) of sticking contacts that carry a force and are on the cone to within round-off."""
        m = self.matrix
        margin = m.mu * force[:, 0] - np.linalg.norm(force[:, 1:], axis=1)
        blurred = force[:, 0] <= np.where(self.paired, self.faint, APEX * self.mean)
        return ~slides & ~blurred & (margin <= AT_CONE * self.mean)

    def _is_stable(self, matrix: LinearSystem, choice: ContactStatus, load: float) -> bool:
        """Return False if det k < 0 for the status; record an event if statuses cease to be unique for every load."""
        if not len(choice.critical):
            self.unique = True
            return True
        uniqueness = choice.uniqueness
        if uniqueness is None:  # `contact_status` does not test uniqueness with too many contacts
            try:
                problem = complementarity(matrix, self.load, geometric=self.geometric)
            except LinAlgError:
                return True
            slides = choice.sliding[choice.critical]
            if np.linalg.slogdet(problem.matrix[np.ix_(slides, slides)])[0] < 0:
                return False
            uniqueness = certificate(problem)
        uniqueness = uniqueness.unique
        if uniqueness is False and self.unique:
            self.events.append(Event(load, NO_P_MATRIX, -1, -1))
        self.unique = uniqueness is not False
        self.unchecked += uniqueness is None
        return True

    def _bodies_of(self, contact) -> tuple[int, int]:
        row = self.matrix.rows[contact] if contact < self.matrix.count else self.gap_rows[contact - self.matrix.count]
        return int(self.state.contacts.i[row]), int(self.state.contacts.j[row])

    def _record_changes(self, choice: ContactStatus, before, sign, load) -> None:
        if self.matrix.width == 3:
            for contact in np.flatnonzero(choice.sliding & ~before):
                self.events.append(Event(load, REACHES, *self._bodies_of(contact)))
        for contact in np.flatnonzero(before & ~choice.sliding):
            self.events.append(Event(load, "sticks again", *self._bodies_of(contact)))
        if choice.verdict in (Verdict.NOT_UNIQUE, Verdict.SINGULAR):
            taken = _statuses_from_side(np.where(choice.sliding, sign, 0.0))
            others = [_statuses_from_side(np.where(other.sliding, sign, 0.0)) for other in choice.others]
            if (np.array(others) != taken).any():
                self._record_fork(taken, others, choice.verdict is Verdict.NOT_UNIQUE)
                self.forks[-1] = self.forks[-1]._replace(load=load)
                self.events[-1] = self.events[-1]._replace(load=load)

    def _finish(self, force, moved, slides, sign, contacts, done: float) -> PathState:
        """Return the state after the increment, with balance restored under the statuses of its last piece.

        The rotation of contacts leaves unbalanced forces of second order. If left to the next increment, they would
        add to its load and determine the statuses where that load is small.
        """
        place = self._advance(force, moved, slides, sign, contacts, done)
        if self.last is None:
            return place
        now, last = self.last
        missing, solve = unbalanced_force(place, self.law, self.matrix.free), self.solve
        self.missed = np.abs(missing).max(initial=0.0) / self.mean
        for _ in range(CORRECTIONS):
            if not BALANCED < np.abs(missing).max(initial=0.0) / self.mean < OUT_OF_BALANCE:
                break
            try:
                solve = solve or _make_solver(now, last, self.geometric)
                velocity = solve(missing)
            except LinAlgError:
                break
            force, moved = force + force_rates(now, last, velocity), moved + velocity
            better = self._advance(force, moved, slides, sign, contacts, done)
            left = unbalanced_force(better, self.law, self.matrix.free)
            if not np.abs(left).max(initial=0.0) < 0.5 * np.abs(missing).max(initial=0.0):
                break
            place, missing = better, left
        if np.abs(missing).max(initial=0.0) > APEX * self.mean:
            self.missed = max(self.missed, OUT_OF_BALANCE * (1 + np.abs(missing).max() / self.mean))
        if self.matrix.width == 3:
            self._compare_rates(place, slides, done)
        return place

    def _compare_rates(self, place: PathState, slides: np.ndarray, done: float) -> None:
        """Estimate the error of a piece in three dimensions, where directions turn, from the rates at both ends.

        The estimate is half their difference times the step. If the slip of a contact has changed its sign, the piece
        is halved until the load at which this happens is known to a fraction BRACKET of an increment.
        """
        after, (step, rate) = _increment_matrices(place, self.law), self.ahead
        if not np.array_equal(place.state.contacts.key[after.rows], self.state.contacts.key[self.matrix.rows]):
            return
        try:
            velocity = _make_solver(after, slides, self.geometric)(self.load)
        except LinAlgError:
            return
        begin, end = (
            np.einsum("ma,mak->mk", values, m.frame)
            for values, m in ((rate, self.matrix), (force_rates(after, slides, velocity), after))
        )
        off = 0.5 * step * np.abs(end - begin).max(initial=0.0) / self.mean
        self.missed = max(self.missed, OUT_OF_BALANCE * off / STRAYS)
        normal, along = (after.c.T @ velocity).reshape(-1, 3)[:, :2].T
        if inconsistent(slides, np.where(slides, after.slope * normal + along, -1.0)).any() and done > BRACKET:
            self.missed = max(self.missed, OUT_OF_BALANCE * (1 + done * self.increment))

    def _advance(self, force, moved, slides, sign, contacts, done: float) -> PathState:
        """Return the state after the increment: move bodies, set the contact memory, and mark contacts at the apex."""
        m, before, solid = self.matrix, self.state, self.matrix.width == 3
        held = before.contacts.mode.copy()
        held[m.rows] = np.where(slides, SLIDE, STICK)
        held = before._replace(contacts=before.contacts._replace(mode=held))
        state = with_neighbor_list(displaced(held if solid else before, m.free, moved))
        _, trial = forces(state, self.law, memory=HELD if solid else FREE)
        count = int(trial.count[0])
        where = np.searchsorted(trial.key[:count], before.contacts.key[m.rows])
        born = np.array([c for c in contacts if c >= m.count], int) - m.count
        new = np.searchsorted(trial.key[:count], before.contacts.key[self.gap_rows[born]]) if len(born) else born
        # pairs still apart after balancing close in the next piece
        new = new[self.stiffest * gaps(state, new)[1] <= TOUCHES * self.mean]
        line = linearise(accept(state, trial), self.law)
        normal, stiffness = line.normal[where], np.where(line.stiffness_t[where] > 0, line.stiffness_t[where], 1.0)
        along = np.stack([normal[:, 1], -normal[:, 0], np.zeros(m.count)], axis=1)
        length = np.where(slides, sign * line.mu[where] * line.force_n[where], -force[:, 1]) / stiffness
        mode, slip = np.zeros_like(trial.mode), np.zeros_like(trial.slip)
        mode[where] = np.where(slides, SLIDE, STICK)
        slip[where] = trial.slip[where] if solid else length[:, None] * along
        mode[new] = STICK
        fresh = np.zeros(len(mode), bool)
        fresh[new] = True
        fresh[where[[c for c in contacts if c < m.count]]] = True
        # pairs outside the matrix overlap if they have parted incompletely, or met on a curved path
        more = np.flatnonzero((mode[:count] == OPEN) & (trial.mode[:count] != OPEN))
        loose = np.append(self.loose, np.zeros(state.n_bodies - len(self.loose), bool))
        known = np.isin(trial.key[more], before.contacts.key[np.flatnonzero(self.place.parted)])
        known |= loose[trial.i[more]] | loose[trial.j[more]]
        parted = np.zeros(len(mode), bool)
        parted[more[known]], fresh[more[~known]], mode[more] = True, True, STICK
        control = between(self.begin, self.end, self.share + done * self.increment)
        state = accept(state._replace(control=control), trial._replace(mode=mode, slip=slip, reached=mode == SLIDE))
        return PathState(state, self.loose, parted, fresh, self.unique, self.looked)


def force_scale(state: State, law: Law, *loads: np.ndarray) -> float:
    """Return the reference force: the mean normal force or, with bonds, at least a fraction of the loads (n,)."""
    mean = mean_normal_force(state, law)
    if not state.bonds:
        return mean
    stiffest = max(law.table[..., builtin.KN].max(), state.bonds.stiffness[:, 0].max(initial=0.0))
    round_off = UNLOADED * stiffest * 2 * state.grains.radius.min()
    return max(mean, LEAST * float(np.abs(loads).max(initial=0.0)), float(round_off))


def unbalanced_force(place: PathState, law: Law, free: Freedom) -> np.ndarray:
    """Return the unbalanced force (n,) of a state.

    Excluded are forces on rattlers, which are moved aside, forces within clusters of rattlers, and forces of parted
    pairs with a small overlap.
    """
    state, count = without_bonds_of(place.state, place.loose), int(place.state.contacts.count[0])
    out = residual_vector(state, forces(state, law)[0], free)
    whole = np.append(place.loose, np.zeros(state.n_bodies - len(place.loose), bool))
    loose = whole[state.contacts.i[:count]] | whole[state.contacts.j[:count]]
    rows = np.flatnonzero(loose | place.parted[:count])
    push = np.zeros((count, 6))
    push[rows, :3] = contact_forces(state._replace(bonds=None), law)[rows]
    return out - incidence(state, count, free) @ push.ravel() if push.any() else out


def without_bonds_of(state: State, loose: np.ndarray) -> State:
    """Return the state without the bonds of rattlers (N,), whose forces vanish only once the rattlers have moved."""
    if not state.bonds:
        return state
    intact = state.bonds.intact & ~(loose[state.bonds.i] | loose[state.bonds.j])
    return state._replace(bonds=state.bonds._replace(intact=intact), instant=None)


def _statuses_from_side(side: np.ndarray) -> np.ndarray:
    """Return statuses, as in `cone_apex`, of contacts with force from sgn D_t of sliding contacts, and 0 for others."""
    return np.where(side > 0, SLIDES, np.where(side < 0, SLIDES_BACK, STICKS))


def _make_solver(matrix: LinearSystem, slides, geometric: bool):
    """Return a function that solves k(S) v = f; it raises LinAlgError if k(S) is singular to round-off."""
    size = len(matrix.free)
    kept = np.setdiff1d(np.arange(size), pinned_coordinates(matrix))
    k = regular_stiffness(matrix, slides, geometric)[kept][:, kept]
    solve = factorised(k)

    def spread(load: np.ndarray) -> np.ndarray:
        out = np.zeros(size)
        out[kept] = solve(load[kept])
        if not np.abs(k @ out[kept] - load[kept]).max(initial=0.0) <= RESIDUAL * np.abs(load[kept]).max(initial=0.0):
            raise LinAlgError("singular")
        return out

    return spread


def _increment_matrices(place: PathState, law: Law) -> LinearSystem:
    """Return the matrices of grains that support each other, including the springs of pairs about to touch."""
    state = place.state
    m = linear_system(state, law, rattlers=place.loose, bonds="elastic")
    kept = np.flatnonzero(~place.parted[m.rows])
    rows = m.rows[kept]
    material = np.concatenate([state.grains.material, state.walls.material])
    q = law.table[material[state.contacts.i[rows]], material[state.contacts.j[rows]]]
    springs = np.zeros((len(rows), m.width, m.width))
    springs[:, 0, 0], springs[:, 1, 1], springs[:, -1, -1] = q[:, builtin.KN], q[:, builtin.KT], q[:, builtin.KT]
    columns = (m.width * kept[:, None] + np.arange(m.width)).ravel()
    parts = {name: getattr(m, name)[kept] for name in ("rows", "frame", "damping", "sign", "force", "limit")}
    slope = q[:, builtin.MU] * q[:, builtin.KN] / q[:, builtin.KT]
    return m._replace(
        c=sparse.csr_array(m.c.tocsc()[:, columns]), springs=springs, mu=q[:, builtin.MU], slope=slope, **parts
    )
