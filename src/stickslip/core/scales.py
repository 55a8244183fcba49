"""Natural units of length, force and time of a packing and its law, in which defaults are stated.

If k_n, the mass of the grains and the smallest diameter are 1, all three units are 1.
"""

from typing import NamedTuple

import numpy as np

from .laws.builtin import Law
from .laws.compiled import evaluate
from .laws.kinds import Kind
from .state import State

ROUND_OFF = 1e-8  # fraction of cancelling terms below which their sum is meaningless
VALIDATED = 0.1  # overlap, in diameters, up to which user-defined laws are validated


class Scales(NamedTuple):
    """Natural units of a packing."""

    length: float  # diameter d of the smallest grain [length]
    force: float  # k_n d^{3/2}, k_n d or k_n d²: normal force of a built-in law extrapolated to an overlap of d [force]
    time: float  # √(m d/force) of the lightest grain [time]


def natural_scales(state: State, law: Law, length: float | None = None) -> Scales:
    """Natural units of a packing; under a change of units, they transform like any quantity of their dimension.

    Another length may be given. The force is that of the stiffest pair of materials. A user-defined law is extrapolated
    linearly from an overlap of a tenth of the length.
    """
    length = 2.0 * float(state.grains.radius.min()) if length is None else length
    a, b = np.indices(law.table.shape[:2])
    if isinstance(law.kind, Kind):
        force = abs(evaluate(law, "force", a=a, b=b, overlap=VALIDATED * length, r_eff=0.5 * length)).max() / VALIDATED
    else:
        force = evaluate(law, "force", a=a, b=b, overlap=length, r_eff=length).max()
    return Scales(length, float(force), float(np.sqrt(state.grains.mass.min() * length / force)))


def clear_round_off(values, scale):
    """Values, with zeros in place of round-off of terms of size `scale`.

    Examples
    --------
    >>> clear_round_off(np.array([3e-12, 1e-4]), 0.1).tolist()
    [0.0, 0.0001]
    """
    return np.where(np.abs(values) <= ROUND_OFF * np.max(np.abs(scale), initial=0.0), 0.0, values)
