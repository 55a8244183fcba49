"""Quench of a packing without friction: the elastic energy is minimised by FIRE, in one compiled loop.

A step needs the normal forces of all pairs of the neighbour list and no energy. The loop is left only for a new list.

Source: Bitzek et al., doi:10.1103/PhysRevLett.97.170201, with their parameters, and the step back of Guénolé et al.,
doi:10.1016/j.commatsci.2020.109584, when the motion turns uphill. The longest time step follows the stiffness.
"""

import numpy as np

from ..core.contacts.forces import bodies
from ..core.contacts.neighbors import shifts, with_neighbor_list
from ..core.laws.builtin import Law
from ..core.laws.compiled import law_struct
from ..core.laws.kinds import check_kind
from ..core.library import core
from ..core.state import Grains, State, empty_contacts

STEPS = 100_000  # largest number
SKIN = 0.5  # of the neighbour list over the smallest radius: grains move far at first
# time step, mixing, steps downhill, longest time step, and whether the forces balance
PACE, BALANCED = (0.0, 0.1, 0.0, 1.0, 0.0), 4


def quench(state: State, law: Law, tolerance: float, steps: int = STEPS) -> State:
    """State at a minimum of the elastic energy of its normal forces; contact memory is not committed.

    Parameters
    ----------
    state : State without walls, all of whose grains are free
    law : Law without friction
    tolerance : float, largest unbalanced force [force]. It is also at most 1e-4 of the mean contact force, so that
        grains which lose all contacts are not taken for jammed
    steps : int, largest number of steps; if they do not suffice, the last positions are returned
    """
    check_kind(law.kind)
    order = _order_in_space(state)
    contacts = empty_contacts(state.n_bodies, 0, SKIN * state.grains.radius.min())._replace(gap=state.contacts.gap)
    here = state._replace(grains=Grains(*(part[order] for part in state.grains)), contacts=contacts)
    velocity, force = np.zeros((2, state.n_bodies, 3))
    stiffness, pace, reach = np.empty(state.n_bodies), np.array(PACE), 0.5 * contacts.skin / np.sqrt(state.cell.dim)
    struct = law_struct(law, members=("force", "slopes", "range"))
    while steps > 0 and not pace[BALANCED]:
        here = with_neighbor_list(here, law)
        moving = bodies(here)
        done = core.descend(
            struct, here.cell.dim, moving, here.contacts, shifts(here.contacts, here.cell.vectors), reach,
            velocity, force, stiffness, pace, tolerance, steps,
        )  # fmt: skip
        steps -= max(done, 1)
        here = here._replace(
            grains=here.grains._replace(position=moving.position), contacts=here.contacts._replace(stale=True)
        )
    position = np.empty_like(state.grains.position)
    position[order] = here.grains.position
    return state._replace(grains=state.grains._replace(position=position), contacts=state.contacts._replace(stale=True))


def _order_in_space(state: State) -> np.ndarray:
    """Order of grains in which neighbours in space are close in memory, (N,)."""
    edge = 2 * state.grains.radius.max()
    return np.lexsort(np.floor(state.grains.position / edge).T)
