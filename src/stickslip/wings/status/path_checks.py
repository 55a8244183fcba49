"""Checks of the state, law, legs and options of a load path."""

import numpy as np
from scipy.linalg import eigvals

from ... import Control, Law, State, forces, freedom
from ...builtin_laws import NAMES
from ...core.laws.builtin import KT
from ...core.measure import mean_normal_force
from ...kit import require_positive
from ...modes import residual_vector
from .increment import external_force
from .matrices import LinearSystem, linear_system
from .system import driven_motions, pinned_coordinates, regular_stiffness

BALANCED = 1e-6  # largest unbalanced force at the start, in mean normal forces
CHECKED_UP_TO = 2500  # coordinates up to which the stability of the initial state is checked


def check_start(state: State, law: Law, legs, increment: float) -> None:
    """Raise ValueError, with one sentence, if no path can begin in a state, or if a leg cannot be followed."""
    if not legs:
        raise ValueError("no leg was given: at least one Control is needed")
    if law.kind != NAMES.index("linear") or law.properties:
        raise ValueError(
            "a law that is not linear in the overlap was given, or other lever arms: paths are piecewise linear "
            "only for `linear`"
        )
    if not law.table[..., KT].min() > 0:
        raise ValueError("a law with kt = 0 was given: no contact sticks without tangential springs; use a positive kt")
    if not 0 < increment <= 1:
        raise ValueError(f"increment = {increment} was given: it must be above 0 and at most 1, in legs of the load")
    for end in legs:
        _check_leg(state.control, end)
    matrix = linear_system(state, law)
    if not len(matrix.free):
        raise ValueError("the packing has only rattlers: a path needs grains that support each other")
    mean = mean_normal_force(state, law)
    residual = np.abs(residual_vector(state, forces(state, law)[0], matrix.free)).max()
    if not residual < BALANCED * mean:
        raise ValueError(
            f"the packing is out of balance by {residual / mean:.1e} of its mean normal force: at most {BALANCED:g} is "
            f"allowed; use `relax` or `equilibrate` first"
        )
    lowest = _lowest_eigenvalue(matrix)
    if lowest < 0:
        raise ValueError(
            f"the packing is not stable: k has the eigenvalue {lowest:.1e} although all contacts stick; bring the "
            f"packing to rest under this control, with drag"
        )
    whole = freedom(state)
    carried = np.isin(whole.component, matrix.free.component)
    for end in legs:
        at = state._replace(control=end)
        for motion in driven_motions(matrix, external_force(at, matrix.free)):
            axis, body = (values[motion != 0] for values in (matrix.free.axis, matrix.free.body))
            whole = (axis == axis[0]).all()
            load = (
                f"net force along {'xyz'[axis[0]]}" if whole else f"torque on sphere {body[0]} about its two contacts"
            )
            raise ValueError(f"a leg has a {load} that nothing balances: give loads without it")
        pull = np.abs(external_force(state._replace(control=end), whole))
        bad = np.flatnonzero((pull > 0) & ~carried)
        if len(bad):
            raise ValueError(
                f"body {whole.body[bad[0]]} is loaded but is a rattler: load only bodies that are supported by others"
            )


def _lowest_eigenvalue(matrix: LinearSystem) -> float:
    """Smallest real part of the eigenvalues of k while all contacts stick; 0 if none is negative, or if k is large.

    If the symmetric part of k is positive, so are the real parts. Spins of spheres with two contacts do not count.
    """
    kept = np.setdiff1d(np.arange(len(matrix.free)), pinned_coordinates(matrix))
    if len(kept) > CHECKED_UP_TO:
        return 0.0
    part = regular_stiffness(matrix, np.zeros(matrix.count, bool), True)[kept][:, kept].toarray()
    least = -1e-9 * np.abs(part).max()
    if np.linalg.eigvalsh(0.5 * (part + part.T))[0] >= least:
        return 0.0
    lowest = float(eigvals(part).real.min())
    return lowest if lowest < least else 0.0


def check_dynamics(control: Control, drag: float, duration: float | None, travel: float | None) -> None:
    """Raise ValueError, with one sentence, if dynamics cannot hold the load of a control."""
    require_positive(drag=drag, **{k: v for k, v in (("duration", duration), ("travel", travel)) if v is not None})
    if control.rate.any() or control.cell_rate.any() or control.course.any():
        raise ValueError(
            "a drag was given with bodies or a cell that move at a rate: dynamics holds the load, so all rates and "
            "time profiles must be zero; pull with a spring whose anchor moves instead"
        )


def _check_leg(begin: Control, end: Control) -> None:
    for name in ("free", "group", "cell_free"):
        if not np.array_equal(getattr(end, name), getattr(begin, name)):
            raise ValueError(
                "the controls of the legs do not free the same components as the state's control: only loads may change"
            )
    for name in set(Control._fields) - {"free", "group", "cell_free", "force", "torque", "gravity", "stress", "anchor"}:
        if not np.array_equal(getattr(end, name), getattr(begin, name)):
            raise ValueError(
                f"the controls of the legs change {name}: only forces, torques, gravity, stress and anchors of "
                f"springs may change; to control a displacement, pull with a stiff spring, see `with_machine`"
            )
    if ((end.stress != begin.stress) & ~begin.cell_free).any():
        raise ValueError(
            "the legs change the stress of a cell component that is not free: free it with `stress_controlled`"
        )
