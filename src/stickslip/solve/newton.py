"""Equilibrium by Newton's method with incremental memory."""

from typing import Annotated, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError

from ..core.arguments import NOT_NEGATIVE, Positive, checked, require_positive
from ..core.contacts.forces import FREE, accept, forces
from ..core.contacts.neighbors import with_neighbor_list
from ..core.laws.builtin import Law
from ..core.measure import branch_vectors, least_supports, overlaps
from ..core.progress import Outcome, Status
from ..core.scales import natural_scales
from ..core.state import OPEN, State, reset_reached, resting
from .freedom import Freedom, displaced, freedom, jacobian, residual_vector
from .linear import DENSE_BELOW, Solve, block_diagonal_solve, factorised, iterate

BALANCED = 1e-14  # default tolerance, in natural units of force
SHIFTS = (1e-9, 1e-5, 1e-3, 1e-1)  # shifts of −J in units of its largest diagonal entry, tried in turn
CHORD = 0.2  # a step with a stored factor must reduce the residual to this fraction
KRYLOV = 20  # number of iterations above which a preconditioner is too old
ITERATIONS = 300  # number of iterations without a factor after which a factorisation is worthwhile
FORCING = 1e-2  # relative residual to which linear systems are solved by iteration
SLOW = 0.05  # a step that leaves a larger fraction of the residual is too short, or its matrix too old
LOOSE = 1e-4  # fraction of the largest stiffness below which a coordinate is loose
VANISHING = 0.45  # largest fraction of its overlap that a vanishing contact keeps in a step; in theory 1/3
OPENING = 1.6  # factor by which a step is lengthened to open contacts; in theory, 3/2 is enough


class Factorisation:
    """Solver for −J that later steps of a path reuse as long as this saves time.

    Small systems are factorised. Systems of at least DENSE_BELOW coordinates are solved by iteration, and factorised
    only if the iteration does not converge; later steps then use the factor as a preconditioner.
    """

    solve: Solve | None = None
    size = 0  # number of coordinates of the stored solver
    factored = False  # True if the stored solver is a factorisation
    factorisations = 0
    renewals = 0  # number of matrices for which a solver was made
    solves = 0
    found_stable = -1  # number of renewals when an equilibrium was last checked and found stable

    def __repr__(self) -> str:
        return f"Factorisation: {self.factorisations} factorisations for {self.solves} solves"

    def renew(self, matrix) -> Solve:
        """Factorise a matrix; the old factor is freed first."""
        self.solve = None
        self.solve, self.factored = factorised(matrix), True
        self.factorisations += 1
        self.renewals += 1
        return self.solve

    def first_step(self, matrix, shift: float, b: np.ndarray, bodies: np.ndarray) -> np.ndarray:
        """Solve a system with a new matrix, whose diagonal is increased by `shift`, and store the solver.

        `bodies` (n,) contains the body of each coordinate.
        """
        self.solves, self.size = self.solves + 1, len(b)
        if shift:
            matrix = sparse.csr_array(matrix + shift * sparse.eye_array(len(b), format="csr"))
        if len(b) >= DENSE_BELOW:
            precondition = block_diagonal_solve(matrix, bodies)
            step, spent = iterate(matrix, b, precondition, FORCING, ITERATIONS)
            if spent < ITERATIONS:
                diagonal = matrix.diagonal()
                held = diagonal > LOOSE * diagonal.max()  # a stored matrix would displace loose bodies too far
                self.solve = lambda b: iterate(matrix, np.where(held, b, 0.0), precondition, FORCING, ITERATIONS)[0]
                self.factored = False
                self.renewals += 1
                return step
        return self.renew(matrix)(b)


class TrialPoint(NamedTuple):
    """Trial position with its unbalanced forces."""

    state: State
    trial: object
    vector: np.ndarray  # (n,) unbalanced force

    @property
    def size(self) -> float:
        """Euclidean norm of the unbalanced forces [force]."""
        return float(np.linalg.norm(self.vector))

    @property
    def worst(self) -> float:
        """Largest unbalanced force or torque/R [force]."""
        return float(np.abs(self.vector).max(initial=0.0))


@checked
def newton(
    state: State,
    law: Law,
    *,
    tolerance: Positive | None = None,
    iterations: Annotated[int, NOT_NEGATIVE] = 30,
    patience: Annotated[int, NOT_NEGATIVE] | None = None,
    keep: Factorisation | None = None,
):
    """Solve Pᵀf(q) = 0 for the present loads, with one increment of memory that is committed only on success.

    The slip of the whole load step is added in one increment along the final normal. This rule is of first order: the
    equilibrium differs from that of a slow ramp by O(step²) per step. Steps are halved until the residual falls.
    Rattlers (grains without load and with at most one contact, or at most `dim` without friction) are pushed out of
    contact, because their last contact would vanish at a rate of only 3^−3/2 per iteration.

    Parameters
    ----------
    tolerance : float, largest unbalanced force or torque/R [force]; default: 1e-14 of the force defined in
    `equilibrate`
    iterations : int, largest number of linear solves
    patience : int, number of steps that may each leave more than half of the residual; default: all
    keep : Factorisation, used as a first guess and updated, for reuse along a path

    Returns
    -------
    State, Outcome
        the state at rest in equilibrium or, if the outcome is not CONVERGED, the given state
    """
    tolerance = BALANCED * natural_scales(state, law).force if tolerance is None else tolerance
    require_positive(tolerance=tolerance)
    point, outcome = approach(
        state, law, tolerance=tolerance, iterations=iterations, patience=patience, keep=keep or Factorisation()
    )
    return (at_rest(point) if outcome.ok else state), outcome


def at_rest(point: TrialPoint) -> State:
    """State of a trial point at rest, with its memory committed."""
    return accept(resting(point.state), reset_reached(point.trial))


def approach(
    state: State, law: Law, *, tolerance: float, iterations: int = 30, patience: int | None = None, keep: Factorisation
) -> tuple[TrialPoint, Outcome]:
    """Last trial point of Newton's method, with the smallest residual found, and its outcome; see `newton`."""
    patience = iterations if patience is None else patience
    state = resting(state)  # dashpots of a moving state would exert forces
    free, control, n = freedom(state), state.control, len(state.grains.radius)
    acted = control.force[:n].any(axis=1) | control.torque[:n].any(axis=1) | control.gravity.any()
    loose = ~acted & control.free[:n, : state.cell.dim].all(axis=1)  # free to move, and only contacts act
    if state.bonds:  # bonded grains are not loose
        held = state.bonds.intact
        loose[np.append(state.bonds.i[held], state.bonds.j[held])] = False
    least = least_supports(law, state.cell.dim)
    here = _evaluate(with_neighbor_list(state, law), law, free)
    before = keep.factorisations
    for used in range(iterations + 1):
        if np.isfinite(here.worst) and here.worst > tolerance:
            here = _push_out_loose(here, law, free, loose, least)
        if not np.isfinite(here.worst):
            return here, _failure(Status.NOT_A_NUMBER, here, free, used)
        if here.worst <= tolerance:
            how = f"Newton's method, {used} steps, {keep.factorisations - before} factorisations"
            return here, Outcome(Status.CONVERGED, here.worst, used, how=how)
        if used == iterations:
            break
        try:
            closer = _step_with_stored_solver(here, law, free, keep) or _step_with_new_matrix(here, law, free, keep)
        except LinAlgError:
            return here, _failure(Status.SINGULAR, here, free, used)
        if closer is None:
            break
        patience -= closer.size > 0.5 * here.size
        if not keep.factored and (closer.size > SLOW * here.size or _contacts_changed(here, closer)):
            keep.solve = None
        here = closer
        if patience < 0:
            break
    return here, _failure(Status.STALLED, here, free, used)


def _evaluate(state: State, law: Law, free: Freedom) -> TrialPoint:
    state = with_neighbor_list(state, law)
    loads, trial = forces(state, law)
    return TrialPoint(state, trial, residual_vector(state, loads, free))


def _failure(status: Status, point: TrialPoint, free: Freedom, used: int) -> Outcome:
    worst = int(np.argmax(np.abs(point.vector)))
    return Outcome(status, float(np.abs(point.vector[worst])), used, int(free.body[worst]))


def _push_out_loose(point: TrialPoint, law: Law, free: Freedom, loose: np.ndarray, least: int) -> TrialPoint:
    """Move unloaded grains with fewer than `least` contacts until they touch nothing."""
    n = len(loose)
    for _ in range(20):
        state, trial = point.state, point.trial
        rows = np.flatnonzero(trial.mode[: trial.count[0]] != OPEN)
        ends = np.stack([trial.i[rows], trial.j[rows]], axis=1)
        out = np.append(loose, np.zeros(state.n_bodies - n, bool))
        out &= np.bincount(ends.ravel(), minlength=state.n_bodies) < least
        branch = branch_vectors(state._replace(contacts=trial))[rows]
        distance = np.linalg.norm(branch, axis=1)
        normal, total = branch / distance[:, None], np.zeros((len(out), 3))
        np.add.at(total, ends[:, 0], normal)
        np.add.at(total, ends[:, 1], -normal)
        # their contacts are on one side only, unlike those of grains held between others
        out &= np.linalg.norm(total, axis=1) > 0.3 * np.bincount(ends.ravel(), minlength=len(out))
        mine = out[ends].any(axis=1)
        ends, branch, distance = ends[mine], branch[mine], distance[mine]
        if not len(ends):
            break
        radius = np.append(state.grains.radius, np.zeros(state.n_bodies - n))[ends].sum(axis=1)
        away = branch * ((radius * (1 + 1e-9) - distance) * 1.1 / distance)[:, None]
        move = np.zeros((state.n_bodies, 3))
        for side, sign in ((0, 1.0), (1, -1.0)):
            mine = out[ends[:, side]]
            np.add.at(move, ends[mine, side], sign * away[mine])
        grains = state.grains
        point = _evaluate(state._replace(grains=grains._replace(position=grains.position + move[:n])), law, free)
    return point


def _move(point: TrialPoint, law: Law, free: Freedom, step: np.ndarray) -> TrialPoint:
    return _evaluate(displaced(point.state, free, step), law, free)


def _contacts_changed(before: TrialPoint, after: TrialPoint) -> bool:
    """Return True if a contact opened, closed, stuck or began to slide."""
    old, other = before.trial, after.trial
    count = old.count[0]
    return count != other.count[0] or not (
        np.array_equal(old.mode[:count], other.mode[:count]) and np.array_equal(old.key[:count], other.key[:count])
    )


def _limit_step(step: np.ndarray, point: TrialPoint) -> np.ndarray:
    """Limit a step so that no coordinate moves beyond the range of the neighbour list."""
    reach = 0.5 * point.state.contacts.skin
    return step * min(1.0, reach / max(float(np.abs(step).max(initial=0.0)), reach))


def _step_with_stored_solver(point: TrialPoint, law: Law, free: Freedom, keep: Factorisation) -> TrialPoint | None:
    """Take one step with the stored solver, or with a large factor as preconditioner for the present Jacobian."""
    if keep.solve is None or keep.size != len(free):
        return None
    keep.solves += 1
    step = keep.solve(point.vector)
    if not np.isfinite(step).all():
        return None
    closer = _move(point, law, free, _limit_step(step, point))
    if closer.size <= CHORD * point.size:
        return closer
    if not keep.factored or len(free) < DENSE_BELOW:
        return None
    matrix = -jacobian(point.state, law, free, memory=FREE)
    step, spent = iterate(matrix, point.vector, keep.solve, FORCING, KRYLOV + 20)
    keep.solves += spent
    closer = _search(point, law, free, step)
    if spent > KRYLOV:
        keep.solve = None
    return closer if closer is not None and closer.size <= 0.5 * point.size else None


def _step_with_new_matrix(point: TrialPoint, law: Law, free: Freedom, keep: Factorisation) -> TrialPoint | None:
    """Take one step with the present Jacobian; if no step along it reduces the residual, increase the shift."""
    pull = jacobian(point.state, law, free, memory=FREE)
    scale = np.abs(pull.data).max(initial=0.0)
    if ((np.abs(pull).sum(axis=1) == 0) & (point.vector != 0)).any():
        raise LinAlgError("nothing resists a load")
    matrix = sparse.csr_array(-pull)
    for shift in SHIFTS[:: 2 if len(free) >= DENSE_BELOW else 1]:
        step = keep.first_step(matrix, shift * scale, point.vector, free.body)
        if (closer := _search(point, law, free, step)) is not None:
            return closer
    return None


def _search(point: TrialPoint, law: Law, free: Freedom, step: np.ndarray) -> TrialPoint | None:
    """Trial point along a step that is halved until the residual falls; None if it never does."""
    step = _limit_step(step, point)
    for _ in range(8):
        closer = _move(point, law, free, step)
        if closer.size < point.size:
            return _open_vanishing(point, closer, law, free, step)
        step = 0.5 * step
    return None


def _open_vanishing(point: TrialPoint, closer: TrialPoint, law: Law, free: Freedom, step: np.ndarray) -> TrialPoint:
    """Trial point with a longer step of the bodies that lose all contacts, if that reduces the residual further.

    In such contacts F ~ overlap^(3/2), so that each step leaves a third of the overlap, and Newton's method alone would
    never end.
    """
    rows = np.flatnonzero(point.trial.mode[: point.trial.count[0]] != OPEN)
    ends = np.stack([point.trial.i[rows], point.trial.j[rows]], axis=1)
    before, after = (overlaps(p.state._replace(contacts=point.trial))[rows] for p in (point, closer))
    vanishing = ends[after < VANISHING * before]
    total, lost = (np.bincount(e.ravel(), minlength=point.state.n_bodies + 1) for e in (ends, vanishing))
    leaves = (lost > 0) & (lost == total)
    if not leaves.any():
        return closer
    beyond = _move(point, law, free, np.where(leaves[free.body], OPENING, 1.0) * step)
    return beyond if beyond.size < closer.size else closer
