"""How a leg looks to LAMMPS: steps before the first one, atom types, rigid groups, numbers to the last digit."""

import numpy as np

from ... import State
from ...core.dynamics.engine import Leg

LOOSE = 1  # atom type of grains that belong to no rigid group; group g has type g + 2


def warm_up(leg: Leg) -> int:
    """Return the number of steps of duration zero before the first one."""
    return 2 if leg.state.control.cell_rate.any() or leg.state.control.cell_free.any() else 0


def digits(*numbers: float) -> str:
    """Numbers with seventeen digits, from which they are read back exactly."""
    return " ".join(f"{number:.17g}" for number in numbers)


def atom_types(state: State) -> np.ndarray:
    """Atom type of each grain, (N,)."""
    group = state.control.group[: len(state.grains.radius)]
    return np.where(group < 0, LOOSE, group + 2)


def members_of(state: State) -> dict[int, np.ndarray]:
    """Indices of the grains of each rigid group, by its number."""
    group = state.control.group[: len(state.grains.radius)]
    return {int(g): np.flatnonzero(group == g) for g in np.unique(group[group >= 0])}


def is_held(state: State, members: np.ndarray) -> bool:
    """Return True if no component of a rigid group is free."""
    return not state.control.free[members[0], : state.cell.dim].any()


def inertia_factor(state: State) -> float:
    """I0 of the grains that turn, NaN if they differ."""
    grains, loose = state.grains, state.control.group[: len(state.grains.radius)] < 0
    i0 = (grains.inertia / (grains.mass * grains.radius**2))[loose]
    if not len(i0):
        return 0.4
    return float(i0[0]) if np.allclose(i0, i0[0], rtol=1e-9) else np.nan
