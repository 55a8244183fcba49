"""Numbers of contact status for `stickslip doctor`."""

import numpy as np

from ... import SLIDE, STICK
from ...core.contacts.neighbors import with_neighbor_list
from ...kit import Selfcheck
from ...laws import for_pair, linear
from ...packings import disk_array
from .apex_status import contact_status
from .matrices import linear_system

SOLVE = 1e-9, "one sparse or dense solve"


def selfchecks() -> dict[str, Selfcheck]:
    """Status of four critical contacts in a row of disks, given their slip (McNamara & Herrmann 2006)."""
    law = for_pair(linear(kn=1.0, kt=0.5, mu=0.5), 0, 1)
    state = disk_array(5, press=1e-3, gap=-1e-3)
    lifted = state.grains.position - [0, 1e-3, 0]
    state = with_neighbor_list(state._replace(grains=state.grains._replace(position=lifted)))
    contacts, near = state.contacts, state.contacts.count[0]
    mode, slip = np.zeros_like(contacts.mode), np.zeros_like(contacts.slip)
    mode[:near] = STICK
    critical = np.flatnonzero((contacts.j[:near] >= 5) & (contacts.i[:near] < 4))  # on the floor, the last disk's not
    mode[critical], slip[critical, 0] = SLIDE, 1e-3
    matrix = linear_system(state._replace(contacts=contacts._replace(mode=mode, slip=slip)), law)
    load = np.zeros(matrix.c.shape[0])
    load[0], load[9] = 0.3, -0.4  # along x on the first disk and on the fourth
    choice = contact_status(matrix, load)
    sliding = float(choice.sliding.sum()) if choice.ok else -1.0
    return {
        "quasi-rigid, number sliding": Selfcheck(sliding, 2.0, *SOLVE),
        "quasi-rigid, slip rate": Selfcheck(float(np.abs(choice.rate).max()), 0.20790189518075392, *SOLVE),
    }
