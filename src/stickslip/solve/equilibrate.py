"""Search for equilibrium: Newton's method with strongly damped dynamics as a fallback, damped dynamics alone, and FIRE.

A quench of a packing without friction minimises the elastic energy by FIRE, in one compiled loop. Each step evaluates
the normal forces of all pairs in the neighbour list, but no energy. The loop is interrupted only to renew the list.

Source of FIRE: Bitzek et al., doi:10.1103/PhysRevLett.97.170201, with their parameters, and the step back of Guénolé et
al., doi:10.1016/j.commatsci.2020.109584, when the motion turns uphill. The stiffness limits the time step.
"""

import warnings
from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.linalg import LinAlgError, cholesky, eigvals

from ..core.arguments import Positive, checked, knows_bonds
from ..core.contacts.bonding import with_strength_of, with_weakest_broken, without_failure
from ..core.contacts.forces import accept, bodies, forces
from ..core.contacts.jacobian import linearise
from ..core.contacts.neighbors import shifts, with_neighbor_list
from ..core.dynamics.run import run
from ..core.laws.builtin import Law
from ..core.laws.compiled import law_struct
from ..core.laws.kinds import check_kind
from ..core.library import core
from ..core.measure import mean_normal_force
from ..core.progress import Outcome, Status
from ..core.readable import pluralize
from ..core.scales import natural_scales
from ..core.state import OPEN, Grains, State, empty_contacts, reset_reached, resting
from .balance import BALANCED_BELOW, LinearisedState, force_imbalance, linearised, no_equilibrium_message, residual
from .freedom import dynamical_matrix, freedom, translations
from .linear import DENSE_BELOW, suitable_threads
from .newton import Factorisation, approach, at_rest, newton
from .spectrum import soft_modes, symmetric_part_is_positive

BALANCED = 5e-14  # default tolerance, in natural units of force
# residuals over the mean normal force at which Newton's method is tried again after damped dynamics
STAGES = (3e-3, 3e-5, 3e-7, 3e-9)
SHARES = (3e-1, 1e-2, 3e-4)  # the same, as fractions of the residual at which Newton's method stalled
FEW = 3000  # largest number of steps in a stage of damped dynamics that continues from where Newton's method stalled
PATIENCE = (8, 1)  # numbers of slow steps in small and in large systems, see `patience_for`
CHECKED = 12  # number of softest eigenvalues computed where dense algebra is too slow
DRAG, STEP = 0.3, 0.2  # damped dynamics: drag over the highest frequency, and time step times this frequency
# weaker drags, tried in turn: with these, the softest modes of a nearly unjammed packing come to rest sooner, and a
# packing that creeps endlessly along one path may reach equilibrium along another
WEAK_DRAGS = (0.03, 0.01, 0.003)
RELAXED, RELAX_DRAG, RELAX_STEP = 1e-14, 0.05, 0.1  # defaults of `relax`, in natural units
STEPS = 100_000  # quench: largest number of steps
SKIN = 0.5  # quench: skin of the neighbour list over the smallest radius, large because grains move far at first
# quench: time step, mixing, steps downhill, longest time step, and whether the forces balance
PACE, AT_MINIMUM = (0.0, 0.1, 0.0, 1.0, 0.0), 4


class UnstableEquilibriumWarning(UserWarning):
    """The forces balance, but the equilibrium is unstable."""


class LeftPathError(RuntimeError):
    """A step of a load path ended at an unstable equilibrium or on another branch; the message gives the load."""


@checked
@knows_bonds
def equilibrate(
    state: State,
    law: Law,
    *,
    tolerance: Positive | None = None,
    keep: Factorisation | None = None,
    check: Literal["buckling", "spectrum", "nothing"] = "buckling",
    steps: int = 30_000,
):
    """Bring a packing back to equilibrium after a step in load or strain.

    Newton's method with the exact Jacobian is tried first. If it stalls, strongly damped dynamics continues from there
    until the residual has fallen to 30 %, and Newton's method is tried again; the same is done at 1 % and 0.03 %. If
    that fails, dynamics starts from the beginning of the step, and Newton's method is tried at residuals of 3e-3, 3e-5,
    3e-7 and 3e-9 of the mean contact force, each stage starting at the end of the previous one; finally, this is
    repeated with weaker and weaker drag. Bonds that have reached their strength in the equilibrium then break one by
    one, the one with the largest load over strength first, with a new equilibrium after each. During damped dynamics,
    only fading bonds may break.

    Parameters
    ----------
    tolerance : float, largest unbalanced force or torque/R [force]; default: 5e-14 of the normal force of the law,
        extrapolated to an overlap of the smallest diameter d, such as k_n d^{3/2}, or the round-off of forces if that
        is larger, as among grains of very different sizes
    keep : Factorisation, reused from one step of a path to the next
    check : stability check of the equilibrium. "buckling" looks for directions of negative stiffness whenever a new
        matrix was needed. (As long as one matrix leads from equilibrium to equilibrium, the Jacobian is nearly the one
        already checked.) It examines all directions if there are fewer than 700 coordinates, otherwise the 12 softest,
        unless the symmetric part of the stiffness is positive. "spectrum" also looks for complex pairs every time, by a
        dense eigenvalue computation. "nothing" skips the check
    steps : int, largest number of steps of damped dynamics in each stage; at most 3000 while dynamics continues from
        where Newton's method stalled

    Returns
    -------
    State, Outcome
        `outcome.how` describes the method used. `outcome.fallback` is True if damped dynamics was needed.
        `outcome.unstable` is True if the equilibrium is unstable; an UnstableEquilibriumWarning is then also issued.
        `outcome.warning` contains the message, or states that the tolerance is too large to judge stability. Unless the
        outcome is CONVERGED, the given state is returned.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> end, outcome = ss.equilibrate(ss.packings.sheared(state, 1e-4), law)
    >>> outcome.ok
    True
    """
    if tolerance is None:
        tolerance = max(BALANCED * natural_scales(state, law).force, _round_off(state, law))
    keep = keep or Factorisation()
    end, outcome = breaking(lambda here, keep: _newton_or_dynamics(here, law, tolerance, keep, steps), state, keep)
    end = end if outcome.ok else state
    if not outcome.ok or (check == "buckling" and keep.found_stable == keep.renewals):
        return end, outcome
    if check == "nothing":
        keep.found_stable = keep.renewals
        return end, outcome
    here = linearised(end, law)
    if (rest := force_imbalance(here)) > BALANCED_BELOW:
        return end, outcome._replace(warning=no_equilibrium_message(rest))
    instability = _describe_instability(here, check)
    if instability and len(here.at_limit):
        instability += ", if contacts at the Coulomb limit keep sliding"
    keep.found_stable = -1 if instability else keep.renewals
    if instability:
        outcome = outcome._replace(warning=instability, unstable=True)
        warnings.warn(instability, UnstableEquilibriumWarning, stacklevel=2)
    return end, outcome


def breaking(
    find: Callable[[State, Factorisation], tuple[State, Outcome]], state: State, keep: Factorisation,
    broke: Callable[[State, State], None] = lambda before, after: None,
):  # fmt: skip
    """Equilibrium found by `find`; bonds at their strength then break one by one, with a new equilibrium after each.

    `broke` is called for each bond with the equilibrium before the break, and with the same state without the bond.
    """
    end, outcome = find(state, keep)
    while outcome.ok and (weaker := with_weakest_broken(end)) is not end:
        broke(end, weaker)
        end, outcome = find(weaker, Factorisation())
    lost = int((state.bonds.intact & ~end.bonds.intact).sum()) if state.bonds else 0
    if lost:
        keep.solve, keep.found_stable = None, -1
        outcome = outcome._replace(how=f"{outcome.how}; {pluralize(lost, 'bond')} broke")
    return end, outcome


def _newton_or_dynamics(state: State, law: Law, tolerance: float, keep: Factorisation, steps: int):
    """Newton's method; if it stalls, damped dynamics from there, and finally from the start of the step."""
    point, first = approach(state, law, tolerance=tolerance, patience=patience_for(state), keep=keep)
    if first.ok:
        return at_rest(point), first
    keep.solve, keep.found_stable = None, -1
    if point.vector.any() and np.isfinite(point.worst):
        stages = [share * point.worst for share in SHARES]
        end, outcome = _damped_dynamics(point.state, law, tolerance, stages, min(steps, FEW), first)
        if outcome.ok:
            return end, outcome
    here = with_neighbor_list(state, law)
    held = accept(here, forces(here, law)[1])
    force = mean_normal_force(held, law) or residual(state, law)[0]
    stages = [share * force for share in STAGES]
    for drag in (DRAG, *WEAK_DRAGS):
        end, outcome = _damped_dynamics(state, law, tolerance, stages, steps, first, drag)
        if outcome.ok:
            break
    return end, outcome


def patience_for(state: State) -> int:
    """Number of slow steps of Newton's method after which damped dynamics is faster."""
    return PATIENCE[len(freedom(state)) >= DENSE_BELOW]


def _damped_dynamics(state: State, law: Law, tolerance: float, stages, steps: int, first: Outcome, drag: float = DRAG):
    """Run damped dynamics, with Newton's method after each stage; `stages` are residuals [force]."""
    here, spent = with_neighbor_list(without_failure(state), law), 0
    held = accept(here, forces(here, law)[1])
    pace = np.sqrt(np.abs(dynamical_matrix(held, law, freedom(held))).sum(axis=1).max(initial=0.0)) or 1.0
    for stage in stages:
        here, moved = relax(here, law, tolerance=max(stage, tolerance), drag=drag * pace, dt=STEP / pace, steps=steps)
        spent += moved.iterations
        if moved.broken:
            return state, moved
        patient = None if stage == stages[-1] else patience_for(state)
        whole = with_strength_of(here, state, mended=True)
        end, outcome = newton(whole, law, tolerance=tolerance, patience=patient, keep=Factorisation())
        if outcome.ok:
            how = f"damped dynamics, {spent} steps, then {outcome.how}; Newton alone: {first.status.name.lower()}"
            return end, outcome._replace(how=how, fallback=True)
    here, moved = relax(here, law, tolerance=tolerance, drag=drag * pace, dt=STEP / pace, steps=steps)
    spent += moved.iterations
    return (with_strength_of(here, state) if moved.ok else state), moved._replace(
        how=f"damped dynamics, {spent} steps", fallback=True
    )


def _round_off(state: State, law: Law) -> float:
    """Unbalanced force due to the rounding of positions, for the stiffest of all bodies [force]."""
    here = with_neighbor_list(without_failure(state), law)
    held = accept(here, forces(here, law)[1])
    contacts, slope = held.contacts, np.abs(linearise(held, law).slope_n)  # zero if open
    count = len(slope)
    stiffness = np.bincount(np.append(contacts.i[:count], contacts.j[:count]), np.tile(slope, 2), 1).max()
    return float(0.5 * np.finfo(float).eps * np.abs(here.grains.position).max() * stiffness)


def _describe_instability(here: LinearisedState, check: str) -> str:
    """Describe the instability of an equilibrium; empty if none was found."""
    free, pairs, rate = freedom(here.state), 0, 0.0
    matrix = here.dynamical_matrix(free)
    if matrix.shape[0] >= DENSE_BELOW and check == "buckling":
        # without rattlers, whose zero eigenvalues would crowd out the others
        held = np.flatnonzero(np.abs(matrix).sum(axis=1) > 0)
        if symmetric_part_is_positive(matrix[held][:, held], translations(matrix, free)[held]):
            return ""
        buckling = len(soft_modes(matrix[held][:, held], CHECKED, 1e-4)[0])
    else:
        full = matrix.toarray()
        scale = np.abs(full).max(initial=0.0)
        with suitable_threads(len(full)):
            if check == "buckling" and _is_definite(full + full.T, scale):
                return ""
            values = eigvals(full, check_finite=False)
        buckling = int((values.real < -1e-8 * scale).sum())
        if check == "spectrum":
            pairs, rate = int((values.imag > 1e-9 * scale).sum()), float(np.abs(np.sqrt(values).imag).max(initial=0.0))
    motions = [f"{pluralize(buckling, 'direction')} of negative stiffness"] if buckling else []
    motions += [f"{pluralize(pairs, 'complex pair')}, growing as exp({rate:.2e} t)"] if pairs else []
    return f"the equilibrium is unstable: {' and '.join(motions)}" if motions else ""


def _is_definite(twice: np.ndarray, scale: float) -> bool:
    """Return True if `twice` = A + Aᵀ is positive definite: every eigenvalue of A then has a positive real part."""
    try:
        cholesky(0.5 * twice + 1e-8 * scale * np.eye(len(twice)), overwrite_a=True, check_finite=False)
    except LinAlgError:
        return False
    return True


@checked
@knows_bonds
def relax(
    state: State,
    law: Law,
    *,
    tolerance: float | None = None,
    drag: float | None = None,
    spin_drag: float | None = None,
    dt: float | None = None,
    steps: int = 2_000_000,
):
    """Run damped Newtonian dynamics until the state is at rest: the quasi-static limit of the papers' protocol.

    The drag acts on translations and rotations. It must exceed twice the growth rate of any instability that is to be
    suppressed.

    Parameters
    ----------
    tolerance : float [force]; default: 1e-14 F, where F is the normal force of the law, extrapolated to an overlap of
    the smallest diameter d, such as k_n d^{3/2}
    drag, spin_drag : float [1/time]; default for both: 0.05/√(m d/F), with the mass m of the lightest grain
    dt : float [time]; default: 0.1 √(m d/F)
    steps : int, largest number allowed

    Returns
    -------
    State, Outcome
        the state at rest on success; if the outcome is not CONVERGED, the state at the end of the run.

    Source
    ------
    doi:10.48550/arXiv.1908.11724, computational protocol of the supplement.
    """
    scales = natural_scales(state, law)
    tolerance = RELAXED * scales.force if tolerance is None else tolerance
    drag = RELAX_DRAG / scales.time if drag is None else drag
    dt = RELAX_STEP * scales.time if dt is None else dt
    end, _, outcome = run(state, law, steps, dt, drag=drag, spin_drag=spin_drag, tolerance=tolerance)
    if outcome.ok:
        end = resting(end)._replace(contacts=reset_reached(end.contacts), time=state.time)
    elif not outcome.broken and not (end.contacts.mode[: end.contacts.count[0]] != OPEN).any():
        outcome = outcome._replace(status=Status.CONTACT_LOST)
    return end, outcome


def quench(state: State, law: Law, tolerance: float, steps: int = STEPS) -> State:
    """State at a minimum of the elastic energy of its normal forces; contact memory is not committed.

    Parameters
    ----------
    state : State without walls, all of whose grains are free
    law : Law without friction
    tolerance : float, largest unbalanced force [force]. This force must also be at most 1e-4 of the mean contact force,
    so that a packing that loses its contacts does not count as jammed
    steps : int, largest number of steps; if they do not suffice, the last positions are returned
    """
    check_kind(law.kind)
    # sorted by position, so that neighbours in space are close in memory
    order = np.lexsort(np.floor(state.grains.position / (2 * state.grains.radius.max())).T)
    contacts = empty_contacts(state.n_bodies, 0, SKIN * state.grains.radius.min())._replace(gap=state.contacts.gap)
    here = state._replace(grains=Grains(*(part[order] for part in state.grains)), contacts=contacts)
    velocity, force = np.zeros((2, state.n_bodies, 3))
    stiffness, pace, reach = np.empty(state.n_bodies), np.array(PACE), 0.5 * contacts.skin / np.sqrt(state.cell.dim)
    struct = law_struct(law, members=("force", "slopes", "range"))
    while steps > 0 and not pace[AT_MINIMUM]:
        here = with_neighbor_list(here, law)
        moving = bodies(here)
        done = core.descend(
            struct, here.cell.dim, moving, here.contacts, shifts(here.contacts, here.cell.vectors), reach,
            velocity, force, stiffness, pace, tolerance, steps,
        )  # fmt: skip
        steps -= max(done, 1)
        here = here._replace(
            grains=here.grains._replace(position=moving.position), contacts=here.contacts._replace(stale=True)
        )
    position = np.empty_like(state.grains.position)
    position[order] = here.grains.position
    return state._replace(grains=state.grains._replace(position=position), contacts=state.contacts._replace(stale=True))
