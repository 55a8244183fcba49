"""Deformation of a periodic cell, steps of a sample from equilibrium to equilibrium, and slow dynamics.

The cell may follow the stress.
"""

from collections.abc import Callable
from math import ceil
from typing import Literal, NamedTuple

import numpy as np

from ..core.arguments import NotNegative, Positive, checked
from ..core.contacts.bonding import with_strength_of, without_failure
from ..core.control import between, strained_at
from ..core.dynamics.cell_motion import strained
from ..core.dynamics.ledger import PathLedger
from ..core.dynamics.run import run, stable_time_step
from ..core.laws.builtin import Law
from ..core.measure import volume
from ..core.progress import NotInEquilibriumError, Outcome, Report, silent
from ..core.readable import readable
from ..core.state import Control, State
from ..solve.equilibrate import breaking, patience_for
from ..solve.newton import Factorisation, approach, at_rest
from ..solve.shear_response import XY
from .compression import Scales, critical_mass, stopped
from .packing import shear_strain

# unbalanced forces at which Newton's method is tried again, relative to that of a contact that carries the pressure
LEVELS = (1e-2, 1e-3, 1e-4)
REST, MORE = (
    1e-6,
    20_000,
)  # if Newton's method fails at all of these levels: the force at which dynamics ends, and the largest number of steps
SETTLING_DRAG = 2.0  # drag times the time scale: the softest motions come to rest soonest at critical drag
OFFSET = 1e-3  # largest deviation of a controlled stress due to the drag on the cell, in units of the pressure
BLOCK, LONGEST = 500, 400_000  # steps of dynamics between two checks of the forces, and largest number in a load step
POSTED = 20  # steps of dynamics between two entries in a ledger
SLOW = 3.0  # duration of a strain step made by dynamics, in units of the time scale
STEPS = 500  # number of steps of the load in slow dynamics
SHARE = 0.1  # time step of slow dynamics, in units of the stable one


def settle(
    state: State, law: Law, scales: Scales, *, tolerance: float, keep: Factorisation,
    broke: Callable[[State, State], None] = lambda before, after: None,
) -> tuple[State, Outcome]:  # fmt: skip
    """Equilibrium after a step of the load: by Newton's method or, where grains rearrange, by damped dynamics first.

    The drag is that of `compressed`, on the time scale on which the pressure moves a grain. Where Newton's method
    stalls, this is much faster than the drag of `equilibrate`, on the time scale of a contact. Bonds break as in
    `equilibrate`.

    Parameters
    ----------
    tolerance : largest unbalanced force or torque/R [force]
    broke : called as broke(before, after) with the equilibrium in which a bond breaks, and the state without it

    Returns
    -------
    State, Outcome
        `outcome.fallback` is True if dynamics was needed. If Newton's method then fails, as with grains that are about
        to lose their contacts, the residual is below 1e-4 of the force of a contact that carries the pressure

    Raises
    ------
    NotInEquilibriumError
        If the sample does not come to rest.
    """

    def find(here: State, keep: Factorisation) -> tuple[State, Outcome]:
        point, first = approach(here, law, tolerance=tolerance, patience=patience_for(here), keep=keep)
        if first.ok:
            return at_rest(point), first
        keep.solve = None
        end, outcome = _come_to_rest(without_failure(here), law, scales, tolerance)
        return with_strength_of(end, here), outcome

    return breaking(find, state, keep, broke)


def strain_step(
    state: State, law: Law, scales: Scales, gradient: np.ndarray, *, tolerance: float, keep: Factorisation,
    account: PathLedger,
) -> tuple[State, Outcome]:  # fmt: skip
    """Equilibrium after a small strain step of the cell, whose energies are added to a ledger.

    If Newton's method stalls, or ends on another branch so that energies do not balance, dynamics strains the cell at a
    constant rate within a few time scales. Grains rearrange under stress, and the sample is then brought to rest.

    Parameters
    ----------
    state : an equilibrium, whose cell follows the stress along its free components
    gradient : (3, 3) displacement gradient of the step
    tolerance, keep : see `settle`
    account : ledger of the path so far
    """
    there, patience = strained(state, gradient), patience_for(state)
    point, first = approach(there, law, tolerance=tolerance, patience=patience, keep=keep)
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
    state: State, law: Law, scales: Scales, tolerance: float, account: PathLedger | None = None
) -> tuple[State, Outcome]:
    """Equilibrium reached by damped dynamics."""
    here, spent = state, 0
    for share in LEVELS:
        here, outcome, steps = _damp(here, law, scales, share * scales.force, LONGEST - spent, account)
        spent += steps
        if not outcome.ok:
            raise NotInEquilibriumError("the sample does not come to rest", outcome)
        rest = stopped(here)._replace(time=state.time)
        point, solved = approach(rest, law, tolerance=tolerance, patience=patience_for(state), keep=Factorisation())
        if solved.ok:
            end = at_rest(point)
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
    state: State, law: Law, scales: Scales, level: float, most: int, account: PathLedger | None
) -> tuple[State, Outcome, int]:
    """Run damped dynamics until the largest unbalanced force is below a level [force]; also return its step count."""
    spent = 0
    while True:
        state, outcome = _advance(state, law, scales, BLOCK, level, account)
        spent += BLOCK
        if outcome.ok or outcome.broken or spent >= most:
            return state, outcome, spent


def _advance(
    state: State, law: Law, scales: Scales, steps: int, level: float, account: PathLedger | None
) -> tuple[State, Outcome]:
    """Run damped dynamics for some steps, or until the largest unbalanced force is below a nonzero level."""
    kept = {"every": POSTED, "ledger": POSTED} if account else {}
    dt = min(scales.dt, SHARE * stable_time_step(state, law)) if state.bonds else scales.dt  # bonds may be stiffer
    state, record, outcome = run(state, law, steps, dt, drag=SETTLING_DRAG / scales.time, tolerance=level, **kept)
    if account:
        account.post_run(state, record.ledger)
    return state, outcome


def servo_mass(state: State, pressure: float, scales: Scales, rate: float = 0.0) -> float:
    """Mass of a cell whose stress stays within `OFFSET` of the pressure during deformation at a rate [mass].

    Under the drag ν, the stress exceeds its target by M ℓ² ν L/V. The mass is at most the critical one.
    """
    dim, drag, most = state.cell.dim, SETTLING_DRAG / scales.time, critical_mass(state, pressure, scales)
    return min(OFFSET * pressure * volume(state) ** (1 - 2 / dim) / (drag * rate), most) if rate else most


@readable
class SlowRun(NamedTuple):
    """Slow dynamics over T load steps."""

    time: float  # duration of a whole leg [time]
    load: np.ndarray  # (T,) load at the end of each step, in completed legs
    states: tuple[State, ...]
    kinetic_energy: np.ndarray  # (T,) largest kinetic energy during each step [energy]


@checked
def slow_dynamics(
    state: State, law: Law, *legs: Control, time: Positive, until: Positive, drag: NotNegative, report: Report = silent
) -> SlowRun:
    """Follow a packing by dynamics while its control changes linearly from one given control to the next.

    The first leg begins at the control of the state, which may be in motion. Loads are absolute, not increments.

    Parameters
    ----------
    legs : as in `load_path`
    time : duration of each leg [time]
    until : load at which to stop, in completed legs
    drag : drag on translations and rotations [1/time]
    report : called as report(stage, share done, text)

    Raises
    ------
    RuntimeError
        If a position is not a number.
    """
    if not 0 < until <= len(legs):
        raise ValueError(f"until must be above 0 and at most {len(legs)} for {len(legs)} legs, got {until}")
    dt = SHARE * stable_time_step(state, law)
    points, here, loads, states, energy = (state.control, *legs), state, [], [], []
    steps = max(1, round(time * until / STEPS / dt))
    for load in np.linspace(0, until, STEPS + 1)[1:]:
        leg = min(int(np.ceil(load)) - 1, len(legs) - 1)
        here = here._replace(control=between(points[leg], points[leg + 1], load - leg))
        here, record, outcome = run(here, law, steps, dt, drag=drag, every=max(1, steps // 20))
        if not outcome.ok:
            raise RuntimeError(f"slow dynamics ended at load {load:.4g}: {outcome}")
        loads.append(load)
        states.append(here)
        energy.append(float(record.kinetic_energy.max(initial=0.0)))
        report("slow dynamics", load / until, f"load {load:.4f}, kinetic energy {energy[-1]:.1e}")
    return SlowRun(time, np.array(loads), tuple(states), np.array(energy))


Mode = Literal["simple", "pure", "isotropic", "uniaxial"]
MODES = {
    "simple": "simple shear γ along x, with the gradient along y",
    "pure": "pure shear: longer along x and shorter along y, γ = ln(Lx/Ly)",
    "isotropic": "compression on all sides, ε = −ln V",
    "uniaxial": "compression along y between fixed sides, ε = −ln Ly",
}


class Deformation(NamedTuple):
    """Homogeneous deformation of a cell by one strain: x → exp(G ε) x.

    The stress conjugate to the strain is −σ:G, with the stress σ positive in compression: −σ_xy in simple shear,
    (σ_yy − σ_xx)/2 in pure shear, the pressure in isotropic and σ_yy in uniaxial compression.
    """

    mode: Mode
    gradient: np.ndarray  # (3, 3) G, displacement gradient for a small unit strain
    sign: int  # −1 if the strain decreases along the path

    def finite(self, strain: float) -> np.ndarray:
        """(3, 3) exp(G ε) − 1; G is nilpotent or diagonal."""
        diagonal = np.diag(self.gradient)
        return strain * (self.gradient - np.diag(diagonal)) + np.diag(np.expm1(strain * diagonal))

    def apply(self, state: State, strain: float, *, slip: bool = True) -> State:
        """State after an affine deformation by a strain, not in equilibrium; see `strained`."""
        return strained(state, self.finite(strain), slip=slip)

    def place(self, state: State) -> float:
        """Strain of the cell, from an arbitrary origin."""
        across, along = np.abs(state.cell.vectors[: state.cell.dim, :2]).sum(axis=0)
        if self.mode == "simple":
            return self.sign * shear_strain(state)
        if self.mode == "isotropic":
            return -self.sign * float(np.log(volume(state)))
        return self.sign * float(np.log(across / along) if self.mode == "pure" else -np.log(along))


@checked
def deformation(mode: Mode = "simple", dim: Literal[2, 3] = 3, sign: Literal[1, -1] = 1) -> Deformation:
    """Deformation of the cell with a given name.

    Examples
    --------
    >>> deformation("isotropic", dim=2).finite(0.02)[0, 0].round(6)
    np.float64(-0.00995)
    """
    flat = {"pure": [0.5, -0.5, 0.0], "isotropic": [-1 / dim] * dim + [0.0] * (3 - dim), "uniaxial": [0.0, -1.0, 0.0]}
    return Deformation(mode, sign * (XY if mode == "simple" else np.diag(flat[mode])), sign)


SIMPLE = deformation()
