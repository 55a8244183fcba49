"""Steps of a sample from equilibrium to equilibrium, and its slow motion, in a cell that may follow the stress."""

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
DRAG = 2.0  # times the time scale: the softest motions come to rest soonest when it is about critical
OFFSET = 1e-3  # largest deviation of a controlled stress due to the drag on the cell, over the pressure
BLOCK, LONGEST = 500, 400_000  # steps of dynamics between two looks at the forces, and largest number in a step


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
    keep.solve, here, spent = None, state, 0
    for share in LEVELS:
        here, outcome, steps = _damp(here, law, scales, share * scales.force, LONGEST - spent)
        spent += steps
        if not outcome.ok:
            raise NotInEquilibriumError("the sample does not come to rest", outcome)
        rest = stopped(here)._replace(time=state.time)
        end, solved = newton(rest, law, tolerance=tolerance, patience=patience)
        if solved.ok:
            return end, solved._replace(how=f"damped dynamics, {spent} steps, then {solved.how}", fallback=True)
    here, later, steps = _damp(rest, law, scales, REST * scales.force, MORE)
    if not later.broken and later.residual < outcome.residual:
        rest, outcome = stopped(here)._replace(time=state.time), later
    return rest, outcome._replace(how=f"damped dynamics, {spent + steps} steps", fallback=True)


def _damp(state: State, law: Law, scales: Scales, level: float, most: int) -> tuple[State, Outcome, int]:
    """Damped dynamics until the largest unbalanced force is below a level [force], and its number of steps."""
    spent = 0
    while True:
        state, _, outcome = run(state, law, BLOCK, scales.dt, drag=DRAG / scales.time, tolerance=level)
        spent += BLOCK
        if outcome.ok or outcome.broken or spent >= most:
            return state, outcome, spent


def servo_mass(state: State, pressure: float, scales: Scales, rate: float = 0.0) -> float:
    """Mass of a cell that follows the stress to within `OFFSET` of the pressure while it deforms at a rate [mass].

    Under the drag ν the stress exceeds the wanted one by M ℓ² ν L/V. The mass is at most the critical one.
    """
    dim, drag, most = state.cell.dim, DRAG / scales.time, critical_mass(state, pressure, scales)
    return min(OFFSET * pressure * volume(state) ** (1 - 2 / dim) / (drag * rate), most) if rate else most
