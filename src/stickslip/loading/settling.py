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
LEVELS = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
DRAG = 2.0  # times the time scale: the softest motions come to rest soonest when it is about critical
BLOCK, LONGEST = 500, 400_000  # steps of dynamics between two looks at the forces, and largest number in a step


def settle(
    state: State, law: Law, scales: Scales, *, tolerance: float, keep: Factorisation
) -> tuple[State, Outcome]:
    """Equilibrium after a step of the load: by Newton's method or, where grains rearrange, by damped dynamics first.

    The drag is that of `compressed`, on the time scale on which the pressure moves a grain. Where Newton's method
    stalls, this is much faster than drag on the time scale of a contact, as in `equilibrate`.

    Parameters
    ----------
    tolerance : largest unbalanced force or torque/R [force]

    Returns
    -------
    State, Outcome
        `outcome.fallback` is True if dynamics was needed

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
    levels = [level for share in LEVELS if (level := share * scales.force) > tolerance]
    for level in (*levels, 0.5 * tolerance):
        here, outcome, steps = _damp(here, law, scales, level, LONGEST - spent)
        spent += steps
        if outcome.ok:
            end, outcome = newton(stopped(here)._replace(time=state.time), law, tolerance=tolerance, patience=patience)
        if outcome.ok:
            return end, outcome._replace(how=f"damped dynamics, {spent} steps, then {outcome.how}", fallback=True)
        if outcome.broken or spent >= LONGEST:
            break
    raise NotInEquilibriumError("the sample does not come to rest", outcome)


def _damp(state: State, law: Law, scales: Scales, level: float, most: int) -> tuple[State, Outcome, int]:
    """Damped dynamics until the largest unbalanced force is below a level [force], and its number of steps."""
    spent = 0
    while True:
        state, _, outcome = run(state, law, BLOCK, scales.dt, drag=DRAG / scales.time, tolerance=level)
        spent += BLOCK
        if outcome.ok or outcome.broken or spent >= most:
            return state, outcome, spent


def servo_mass(state: State, pressure: float, scales: Scales, rate: float, share: float) -> float:
    """Mass of a cell that follows the stress to within a share of the pressure while it deforms at a rate [mass].

    Under the drag ν the stress exceeds the wanted one by M ℓ² ν L/V. The mass is at most the critical one.
    """
    dim, drag = state.cell.dim, DRAG / scales.time
    return min(share * pressure * volume(state) ** (1 - 2 / dim) / (drag * rate), critical_mass(state, pressure, scales))
