"""Steps of a sample from equilibrium to equilibrium, and its slow motion, in a cell that may follow the stress."""

from math import ceil

import numpy as np

from ..core.control import strained_at
from ..core.dynamics.cell_motion import strained
from ..core.dynamics.ledger import Account
from ..core.dynamics.run import run
from ..core.laws.builtin import Law
from ..core.measure import volume
from ..core.outcome import NotInEquilibriumError, Outcome
from ..core.state import State
from ..solve.equilibrate import PATIENCE
from ..solve.freedom import freedom
from ..solve.linear import DENSE_BELOW
from ..solve.newton import Factorisation, approach, at_rest, newton
from .compression import Scales, critical_mass, stopped

# unbalanced forces at which Newton's method is tried again, over the force of a contact that carries the pressure
LEVELS = (1e-2, 1e-3, 1e-4)
REST, MORE = 1e-6, 20_000  # where it fails at all of them: the force at which dynamics ends, and its most steps
SETTLING_DRAG = 2.0  # times the time scale: the softest motions come to rest soonest when it is about critical
OFFSET = 1e-3  # largest deviation of a controlled stress due to the drag on the cell, over the pressure
BLOCK, LONGEST = 500, 400_000  # steps of dynamics between two looks at the forces, and largest number in a step
POSTED = 20  # steps of dynamics between two entries in a ledger
SLOW = 3.0  # times the time scale: duration of a step of the strain that dynamics makes


def settle(state: State, law: Law, scales: Scales, *, tolerance: float, keep: Factorisation) -> tuple[State, Outcome]:
    """Equilibrium after a step of the load: by Newton's method or, where grains rearrange, by damped dynamics first.

    The drag is that of `compressed`, on the time scale on which the pressure moves a grain. Where Newton's method
    stalls, this is much faster than drag on the time scale of a contact, as in `equilibrate`.

    Parameters
    ----------
    tolerance : largest unbalanced force or torque/R [force]

    Returns
    -------
    State, Outcome
        `outcome.fallback` is True if dynamics was needed. If Newton's method then fails, as with grains that are about
        to lose their contacts, the residual is below 1e-4 of the force of a contact that carries the pressure

    Raises
    ------
    NotInEquilibriumError
        if the sample does not come to rest.
    """
    patience = PATIENCE[len(freedom(state)) >= DENSE_BELOW]
    point, first = approach(state, law, tolerance=tolerance, patience=patience, keep=keep)
    if first.ok:
        return at_rest(point), first
    keep.solve = None
    return _come_to_rest(state, law, scales, tolerance)


def strain_step(
    state: State, law: Law, scales: Scales, gradient: np.ndarray, *, tolerance: float, keep: Factorisation,
    account: Account,
) -> tuple[State, Outcome]:  # fmt: skip
    """Equilibrium after a small step of the strain of the cell, whose energies are posted to an account.

    Where Newton's method stalls, or ends on another branch, so that energies do not balance, dynamics strains the cell
    at a constant rate within a few time scales, so that grains rearrange under the stress that they bear, and then
    brings the sample to rest.

    Parameters
    ----------
    state : an equilibrium, whose cell follows the stress along its free components
    gradient : (3, 3) displacement gradient of the step
    tolerance, keep : see `settle`
    account : ledger of the path so far
    """
    patience = PATIENCE[len(freedom(state)) >= DENSE_BELOW]
    point, first = approach(strained(state, gradient), law, tolerance=tolerance, patience=patience, keep=keep)
    if first.ok and account.balances(end := at_rest(point)):
        account.post(end)
        return end, first
    keep.solve = None
    steps = POSTED * ceil(SLOW * scales.time / scales.dt / POSTED)
    moving = state._replace(control=strained_at(state.control, gradient / (steps * scales.dt)))
    moving, outcome = _advance(moving, law, scales, steps, 0.0, account)
    if outcome.broken:
        raise NotInEquilibriumError("the sample does not come to rest", outcome)
    still = moving._replace(control=state.control, cell=moving.cell._replace(rate=np.zeros((3, 3))), instant=None)
    return _come_to_rest(still, law, scales, tolerance, account)


def _come_to_rest(
    state: State, law: Law, scales: Scales, tolerance: float, account: Account | None = None
) -> tuple[State, Outcome]:
    """Equilibrium that damped dynamics leads to."""
    patience, here, spent = PATIENCE[len(freedom(state)) >= DENSE_BELOW], state, 0
    for share in LEVELS:
        here, outcome, steps = _damp(here, law, scales, share * scales.force, LONGEST - spent, account)
        spent += steps
        if not outcome.ok:
            raise NotInEquilibriumError("the sample does not come to rest", outcome)
        rest = stopped(here)._replace(time=state.time)
        end, solved = newton(rest, law, tolerance=tolerance, patience=patience)
        if solved.ok:
            if account:
                account.stop(rest)
                account.post(end)
            return end, solved._replace(how=f"damped dynamics, {spent} steps, then {solved.how}", fallback=True)
    here, later, steps = _damp(rest, law, scales, REST * scales.force, MORE, account)
    if not later.broken and later.residual < outcome.residual:
        rest, outcome = stopped(here)._replace(time=state.time), later
    if account:
        account.stop(rest)
    return rest, outcome._replace(how=f"damped dynamics, {spent + steps} steps", fallback=True)


def _damp(
    state: State, law: Law, scales: Scales, level: float, most: int, account: Account | None
) -> tuple[State, Outcome, int]:
    """Damped dynamics until the largest unbalanced force is below a level [force], and its number of steps."""
    spent = 0
    while True:
        state, outcome = _advance(state, law, scales, BLOCK, level, account)
        spent += BLOCK
        if outcome.ok or outcome.broken or spent >= most:
            return state, outcome, spent


def _advance(
    state: State, law: Law, scales: Scales, steps: int, level: float, account: Account | None
) -> tuple[State, Outcome]:
    """Damped dynamics of some steps, or until the largest unbalanced force is below a level that is not 0."""
    kept = {"every": POSTED, "ledger": POSTED} if account else {}
    state, record, outcome = run(
        state, law, steps, scales.dt, drag=SETTLING_DRAG / scales.time, tolerance=level, **kept
    )
    if account:
        account.post_run(state, record.ledger)
    return state, outcome


def servo_mass(state: State, pressure: float, scales: Scales, rate: float = 0.0) -> float:
    """Mass of a cell that follows the stress to within `OFFSET` of the pressure while it deforms at a rate [mass].

    Under the drag ν the stress exceeds the wanted one by M ℓ² ν L/V. The mass is at most the critical one.
    """
    dim, drag, most = state.cell.dim, SETTLING_DRAG / scales.time, critical_mass(state, pressure, scales)
    return min(OFFSET * pressure * volume(state) ** (1 - 2 / dim) / (drag * rate), most) if rate else most
