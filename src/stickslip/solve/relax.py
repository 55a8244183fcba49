"""Equilibrium by strongly damped dynamics."""

import numpy as np

from ..core.arguments import checked
from ..core.contacts.forces import forces, unbalanced_forces
from ..core.dynamics.run import run
from ..core.laws.builtin import Law
from ..core.outcome import Status
from ..core.scales import natural_scales
from ..core.state import OPEN, State, reset_reached, resting

BALANCED, DRAG, STEP = 1e-14, 0.05, 0.1  # defaults of tolerance, drag and time step, in natural units


@checked
def residual(state: State, law: Law):
    """Largest component of an unbalanced force or torque/R of a state [force], and the body on which it acts."""
    size = np.abs(unbalanced_forces(state, forces(state, law)[0])).max(axis=1)
    return float(size.max()), int(size.argmax())


@checked
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
    tolerance : float [force]; default: 1e-14 F, where F is the normal force that the law gives, extrapolated to an
        overlap of the smallest diameter d, such as k_n d^{3/2}
    drag, spin_drag : float [1/time]; default: 0.05/√(m d/F), m the mass of the lightest grain; both alike
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
    tolerance = BALANCED * scales.force if tolerance is None else tolerance
    drag = DRAG / scales.time if drag is None else drag
    dt = STEP * scales.time if dt is None else dt
    end, _, outcome = run(state, law, steps, dt, drag=drag, spin_drag=spin_drag, tolerance=tolerance)
    if outcome.ok:
        end = resting(end)._replace(contacts=reset_reached(end.contacts), time=state.time)
    elif not outcome.broken and not (end.contacts.mode[: end.contacts.count[0]] != OPEN).any():
        outcome = outcome._replace(status=Status.CONTACT_LOST)
    return end, outcome
