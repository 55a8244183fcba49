"""Shear under a given stress, of a periodic cell or of a layer under a plate; the load is the macroscopic friction."""

import warnings

import numpy as np

from ..core.arguments import Bodies, checked, require_positive
from ..core.contacts.neighbors import TooFarApartError
from ..core.control import body_numbers, stress_controlled
from ..core.laws.builtin import Law
from ..core.outcome import NotInEquilibriumError, Outcome, Status
from ..core.state import State
from ..solve.equilibrate import UnstableEquilibriumWarning, equilibrate
from .protocols import Protocol

BALANCED = 1e-9  # default tolerance, in units of the normal force on a grain


@checked
def cell_shear(law: Law, normal_stress: float, *, tolerance: float = BALANCED) -> Protocol:
    """Protocol of simple shear of a periodic cell under stress: the load is −σ_xy/σ_yy, absolute, not an increment.

    The cell's height follows the normal stress, and its shear along x follows the shear stress. Its other dimensions
    stay as they are. Each step ends with `equilibrate`.

    Parameters
    ----------
    normal_stress : σ_yy, compression positive [force/length^(dim−1)]
    tolerance : largest unbalanced force or torque/R, in units of σ_yy D^(dim−1) with the mean diameter D

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(30, pressure=1e-3, dim=2, seed=1)
    >>> path = ss.protocols.ramp(state, [0.0, 0.05], ss.protocols.cell_shear(law, 1e-3))
    >>> ss.measure.stress(path[-1].state, law)[[0, 1], 1].round(9).tolist()
    [-5e-05, 0.001]
    """
    require_positive(normal_stress=normal_stress, tolerance=tolerance)

    def apply(state, load):
        control = stress_controlled(state.control, {"yy": normal_stress, "xy": -load * normal_stress})
        return state._replace(control=control)

    def settle(state, load):
        area = (2 * state.grains.radius.mean()) ** (state.cell.dim - 1)
        return _settle(state, load, law, tolerance * normal_stress * area)

    return Protocol(law, apply, settle, modes=False)


@checked
def plate_shear(law: Law, plate: Bodies, *, tolerance: float = BALANCED) -> Protocol:
    """Protocol of shear by a plate: the load is the force on it along x, over that which presses it along −y.

    It is absolute: the force replaces one along x that acts already.

    Parameters
    ----------
    plate : numbers of the bodies of the plate: a rigid group that is pressed along −y
    tolerance : largest unbalanced force or torque/R, in units of the normal force on a body of the plate

    Raises
    ------
    ValueError
        if the given bodies are not pressed along −y; on the first step.

    Examples
    --------
    A single grain on a fixed one, as a plate:

    >>> import numpy as np
    >>> import stickslip as ss
    >>> law = ss.laws.linear(kn=1.0, kt=0.5, mu=0.5)
    >>> control = ss.control.rigid(ss.control.fixed(ss.control.loads(2), [0]), [1])
    >>> control = ss.control.force_controlled(control, [1], [0, -0.01])
    >>> state = ss.assembly(ss.spheres([[0, 0, 0], [0, 0.99, 0]], 0.5), control=control)
    >>> path = ss.protocols.ramp(state, [0.0, 0.2], plate_shear(law, [1]))
    >>> start, end = (point.state.grains.position for point in path[:2])
    >>> float((end - start)[1, 0].round(4))
    0.0041
    """
    require_positive(tolerance=tolerance)

    def apply(state, load):
        control, bodies = state.control, body_numbers(state.control, plate)
        force, free, rate = control.force.copy(), control.free.copy(), control.rate.copy()
        if not (force[bodies, 1] < 0).all():
            raise ValueError(f"bodies {np.asarray(plate).tolist()} were given: a plate is pressed along −y")
        free[bodies, 0], rate[bodies, 0] = True, 0.0
        force[bodies, 0] = -load * force[bodies, 1]
        return state._replace(control=control._replace(force=force, free=free, rate=rate))

    def settle(state, load):
        return _settle(state, load, law, tolerance * float(np.abs(state.control.force[plate, 1]).mean()))

    return Protocol(law, apply, settle, modes=False)


def _settle(state: State, load: float, law: Law, tolerance: float) -> tuple[State, Outcome]:
    """Equilibrium at a load, by `equilibrate`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnstableEquilibriumWarning)  # the path contains the spectrum
            end, outcome = equilibrate(state, law, tolerance=tolerance, check="nothing")
    except TooFarApartError:
        end, outcome = state, Outcome(Status.STEPS_SPENT, np.inf, 0)  # the sample flowed without end
    if not outcome.ok:
        raise NotInEquilibriumError(f"no equilibrium at a load of {load:.4g}", outcome)
    return end, outcome
