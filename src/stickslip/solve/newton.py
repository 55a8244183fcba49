"""Equilibrium by Newton's method with incremental memory."""

import warnings

import numpy as np
from scipy.linalg import LinAlgError, LinAlgWarning, lu_factor, lu_solve
from scipy.sparse.linalg import splu

from ..core.forces import FREE, accept, forces
from ..core.jacobian import contact_blocks
from ..core.laws import Law
from ..core.neighbors import updated
from ..core.outcome import Outcome, Status
from ..core.state import State, at_rest
from .freedom import Freedom, displaced, freedom, residual_vector, restricted

DENSE_BELOW = 400  # coordinates; below it LAPACK is faster than a sparse factorisation


def newton(state: State, law: Law, *, tolerance: float = 1e-14, iterations: int = 30):
    """Solve Pᵀf(q) = 0 for the present loads; one increment of memory, committed only on success.

    The slip of the whole load step is added in one increment along the final normal, which is a first-order rule: the
    equilibrium differs from that of a slow ramp by O(step²) per step. Steps are halved until the residual falls.

    Parameters
    ----------
    tolerance : float, largest unbalanced force or torque/R [force]
    iterations : int, largest number of linear solves

    Returns
    -------
    State, Outcome
        the state at rest in equilibrium, or the given one unless the outcome is CONVERGED
    """
    free = freedom(state)
    here = updated(state)
    reach = 0.5 * float(here.contacts.skin[0])
    vector, trial = _evaluate(here, law, free)
    used = 0
    while not (worst := np.abs(vector).max(initial=0.0)) <= tolerance:
        if not np.isfinite(worst):
            return state, _failure(Status.NOT_A_NUMBER, vector, free, used)
        if used == iterations:
            return state, _failure(Status.STALLED, vector, free, used)
        used += 1
        try:
            step = _solve(here, law, free, vector)
        except (LinAlgError, RuntimeError):
            return state, _failure(Status.SINGULAR, vector, free, used)
        step *= min(1.0, reach / max(np.abs(step).max(), reach))
        for _ in range(12):
            candidate = updated(displaced(here, free, step))
            new_vector, new_trial = _evaluate(candidate, law, free)
            if np.abs(new_vector).max() < worst:
                break
            step *= 0.5
        else:
            return state, _failure(Status.STALLED, vector, free, used)
        here, vector, trial = candidate, new_vector, new_trial
    grains = here.grains
    rest = here._replace(grains=grains._replace(velocity=0 * grains.velocity, spin=0 * grains.spin))
    return accept(rest, at_rest(trial)), Outcome(Status.CONVERGED, float(worst), used)


def _evaluate(state: State, law: Law, free: Freedom):
    loads, trial = forces(state, law)
    return residual_vector(state, loads, free), trial


def _failure(status: Status, vector: np.ndarray, free: Freedom, used: int) -> Outcome:
    worst = int(np.argmax(np.abs(vector)))
    return Outcome(status, float(np.abs(vector[worst])), used, int(free.body[worst]))


def _solve(state: State, law: Law, free: Freedom, vector: np.ndarray) -> np.ndarray:
    """The displacement that the linearised contacts need to take up the unbalanced force."""
    stiffness, _ = contact_blocks(state, law, memory=FREE)
    jacobian = restricted(state, stiffness, free)
    # what nothing resists (a rattler, a rotation without friction) stays where it is, if nothing loads it
    idle = (np.abs(jacobian).sum(axis=1) == 0) & (vector == 0)
    step, held = np.zeros(len(free)), np.flatnonzero(~idle)
    jacobian, load = jacobian[held][:, held], vector[held]
    if len(held) >= DENSE_BELOW:
        step[held] = -splu(jacobian.tocsc()).solve(load)
        return step
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)  # singularity is judged below
        factor = lu_factor(jacobian.toarray())
    if np.abs(np.diag(factor[0])).min() <= 1e-14 * np.abs(jacobian.data).max(initial=0.0):
        raise LinAlgError("singular")
    step[held] = -lu_solve(factor, load)
    return step
