"""Largest stable time step of velocity Verlet: 2/ω of the stiffest mode of the contact network."""

import numpy as np

from ..arguments import checked
from ..contacts.forces import Bodies, bodies, check_materials
from ..contacts.neighbors import shifts, with_neighbor_list
from ..contacts.rolling import rolling_bound
from ..laws.builtin import Law
from ..laws.compiled import law_struct
from ..library import core
from ..measure import volume
from ..state import State, groups
from .cell_motion import cell_mass
from .coefficients import inverse_inertia_of

ROUNDS = 300  # of the power iteration


def _network(state: State, law: Law, here: Bodies) -> tuple:
    """Contacts with their law and inertia, as the functions of the core take them."""
    struct, shift = law_struct(law, members=("force", "slopes", "range")), shifts(state.contacts, state.cell.vectors)
    free, inverse = state.control.cell_free, np.zeros((3, 3))  # 1/(M ℓ²) of the free components of the cell
    if free.any():
        inverse = free / (cell_mass(state) * volume(state) ** (2 / state.cell.dim))
    return struct, state.cell.dim, here, state.contacts, shift, inverse_inertia_of(state), inverse


def _spring_bound(state: State, law: Law, here: Bodies) -> float:
    """Upper bound on ω² due to rolling springs, and to springs of a body or rigid group to load points [1/time²]."""
    total = state.control.spring.copy()
    for members in groups(state.control):
        total[members] = total[members].sum(axis=0)
    loads = float((total.max(axis=1) * here.inverse_mass).max()) if total.any() else 0.0
    return loads + rolling_bound(state, law, here, inverse_inertia_of(state))


@checked
def stable_time_step(state: State, law: Law) -> float:
    """Largest stable time step 2/ω_max of all touching contacts, sliding or not [time]; infinite without contacts.

    Springs to load points and rolling springs are included through upper bounds on their ω². Dashpots are not: where
    they act, steps must also be below 2/ν of the fastest decay rate ν, at most the sum of c/m over contacts.

    Velocity Verlet is unstable beyond this time step. A tenth of this limit gives the force of a contact to four
    digits. The stress that contacts bear is left out: the limit was up to 3 % shorter than that of the spectrum of
    sheared disks, and 0.5 % shorter for spheres (`tests/unit/test_timestep.py`).

    Examples
    --------
    >>> import stickslip as ss
    >>> pair = ss.assembly(ss.spheres([[0, 0, 0], [0.99, 0, 0]], 0.5))
    >>> round(stable_time_step(pair, ss.laws.linear(kn=1.0, kt=0.0)), 6)  # ω² = 2 k_n/m
    1.414214
    """
    check_materials(state, law)
    state = with_neighbor_list(state, law)
    here = bodies(state)
    # of the contact network by power iteration on M^(−1/2) K M^(−1/2)
    start = np.sin(1.0 + 7.0 * np.arange(state.n_bodies)[:, None] + 3.1 * np.arange(6))
    scratch = np.empty_like(start), np.empty((len(state.contacts.i), 6))
    largest = core.largest_squared_frequency(*_network(state, law, here), ROUNDS, start, *scratch)
    largest += _spring_bound(state, law, here)
    return float(2 / np.sqrt(largest)) if largest > 0 else np.inf


def check_time_step(state: State, law: Law, here: Bodies, dt: float) -> None:
    """Raise ValueError with the largest stable time step if `dt` is above it; the list must be up to date."""
    if not (state.contacts.count[0] or state.control.spring.any()):
        return
    bound = _spring_bound(state, law, here)
    bound += core.frequency_bound(*_network(state, law, here), np.zeros((state.n_bodies, 2)))
    if dt * dt * bound <= 4.0:
        return
    longest = stable_time_step(state, law)
    if dt > longest:
        raise ValueError(
            f"dt = {dt:g} was given, but with contacts this stiff steps are stable only up to {longest:.4g}: "
            f"use at most that, or a tenth of it for accuracy"
        )
