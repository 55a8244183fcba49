"""Units of length, force and time that a packing and its law have of themselves, in which defaults are stated.

With k_n = 1, grains of mass 1 and a smallest diameter of 1, all of them are 1.
"""

from typing import NamedTuple

import numpy as np

from .laws.builtin import Law, normal_force
from .laws.dispatch import Kind, evaluate_role
from .state import State

VALIDATED = 0.1  # overlap, over the diameter, up to which user-defined laws are validated


class Scales(NamedTuple):
    """Natural units of a packing."""

    length: float  # diameter d of the smallest grain [length]
    force: float  # k_n d^{3/2}, k_n d or k_n d²: normal force of a built-in law extrapolated to an overlap of d [force]
    time: float  # √(m d/force) of the lightest grain [time]


def natural_scales(state: State, law: Law, length: float | None = None) -> Scales:
    """Natural units of a packing; under a change of units they change as quantities of their kind do.

    Another length may be given. The force is that of the stiffest pair of materials. A user-defined law is extrapolated
    linearly from a tenth of it.
    """
    length = 2.0 * float(state.grains.radius.min()) if length is None else length
    force = max(_force_at(law, row, length) for row in law.table.reshape(-1, law.table.shape[2]).tolist())
    return Scales(length, force, float(np.sqrt(state.grains.mass.min() * length / force)))


def _force_at(law: Law, row: list[float], overlap: float) -> float:
    """Normal force at a large overlap, with an R_eff of the same size [force]."""
    if isinstance(law.kind, Kind):
        at = {"overlap": VALIDATED * overlap, "r_eff": 0.5 * overlap}
        return abs(float(evaluate_role(law.kind, "normal_force", row, **at))) / VALIDATED
    return float(normal_force(law.kind, tuple(row), overlap, overlap))
