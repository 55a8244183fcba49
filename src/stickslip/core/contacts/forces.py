"""Forces, torques and trial memory of all contacts.

`forces` returns loads and *trial* contacts and leaves the state unchanged; only `accept` commits them.
"""

from typing import NamedTuple

import numpy as np

from ..arguments import checked, knows_bonds
from ..control import spring_forces
from ..fields import Field, check_entry
from ..laws.builtin import Law
from ..laws.compiled import FORCES, law_struct
from ..library import core
from ..readable import pluralize, readable
from ..state import Contacts, State, groups
from .bonds import add_bond_loads, follow_rotations
from .neighbors import body_positions, body_radii, join_bodies, shifts, with_neighbor_list

# treatments of the memory of contacts, as in `mechanics.h`. FREE: transport it, but keep it bit for bit where nothing
# has moved since it was committed; HELD: the same, while every contact stays in its mode; FROZEN: like FREE, but keep
# the memory even where it contradicts the law
FROZEN, HELD, FREE = 0, 1, 2
GIVEN = 4  # added to HELD or FREE: the memory was imported, not committed during motion
MIN_WEIGHT = 0.6  # least weight of an increment (see `turning_weight`); above 1/2, so that a slip can change its sign
ROUND_OFF = (
    1e-11  # tolerance of slip in units of R_i + R_j: sliding ends when the slip is below the limit by more than this
)
AT_LIMIT = 1e-3  # fraction by which the slip of a sliding contact at rest may fall short of its limit, due to dashpots


class Bodies(NamedTuple):
    """Grains and walls in common arrays, as kernels expect them."""

    position: np.ndarray  # (B, 3)
    angle: np.ndarray  # (B, 3)
    velocity: np.ndarray  # (B, 3)
    spin: np.ndarray  # (B, 3)
    radius: np.ndarray  # (B,)
    material: np.ndarray  # (B,)
    inverse_mass: np.ndarray  # (B,) 1/m, zero for bodies that do not translate
    normal: np.ndarray  # (W, 3)
    rate: np.ndarray  # (3, 3) velocity gradient of the cell


@readable
class ContactLoads(NamedTuple):
    """Resultants of the contacts on every body; external loads are not included."""

    force: np.ndarray  # (N + W, 3) [force]
    torque: np.ndarray  # (N + W, 3) [force length]
    virial: np.ndarray  # (3, 3) elastic Σ f ⊗ r over contacts between grains; only where the cell is free [energy]

    def check_entries(self) -> None:
        """Raise ValueError if an entry has a wrong type or shape, or is not finite."""
        for name, field in _LOADS.items():
            check_entry(f"loads.{name}", getattr(self, name), field, {"bodies": len(np.atleast_1d(self.force))})

    def check_belongs(self, others) -> None:
        """Raise ValueError if any state among the given values has a different number of bodies."""
        for state in others:
            if isinstance(state, State) and state.n_bodies != len(self.force):
                raise ValueError(f"the loads are those of {len(self.force)} bodies, but the state has {state.n_bodies}")


_LOADS = {
    "force": Field(np.float64, ("bodies", 3)), "torque": Field(np.float64, ("bodies", 3)),
    "virial": Field(np.float64, (3, 3)),
}  # fmt: skip


def moving_masses(state: State) -> np.ndarray:
    """Mass that moves with each body, (B,): its own, or that of its rigid group."""
    own = np.concatenate([state.grains.mass, state.walls.mass])
    for members in groups(state.control):
        own[members] = own[members].sum()
    return own


def bodies(state: State) -> Bodies:
    """New arrays of all bodies, grains followed by walls. Radii and materials must not be written to."""
    grains, walls = state.grains, state.walls
    still = np.zeros((len(walls.mass), 3))
    return Bodies(
        body_positions(state),
        np.concatenate([grains.angle, still]),
        np.concatenate([grains.velocity, walls.velocity]),
        np.concatenate([grains.spin, still]),
        body_radii(state),
        join_bodies(grains.material, walls.material),
        state.control.free[:, : state.cell.dim].any(axis=1) / moving_masses(state),
        walls.normal,
        state.cell.rate.copy(),
    )


@checked
@knows_bonds
def forces(state: State, law: Law, *, memory: int = FREE):
    """Contact loads on every body, and the trial memory; the state is unchanged.

    F_ij = F_n n + F_t on body i, T_i = −R_i n × F_t. As in the papers, lever arms are R rather than R − δ/2 unless
    changed by `laws.with_lever`, so that the total angular momentum changes by O(δ).

    Parameters
    ----------
    state : State; positions may differ from those at which its memory was committed
    law : Law
    memory : FREE (default), HELD (no contact changes between stick and slide) or FROZEN (contacts that have not moved
        keep their memory even if this contradicts the law)

    Returns
    -------
    Loads
        (N + W, 3) forces and torques of the contacts
    Contacts
        trial memory: `accept(state, trial)` commits it. Contacts that have not moved since their memory was committed
        under this law keep it bit for bit

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Eqs 1–5, supplement Eqs 5–7 and 25.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> loads, trial = ss.forces(state, law)
    >>> loads.force.shape
    (50, 3)
    >>> state = ss.accept(state, trial)  # keeps the new slips
    """
    check_materials(state, law)
    check_memory(memory)
    state = with_neighbor_list(state, law)
    contacts = state.contacts
    trial = contacts._replace(
        slip=contacts.slip.copy(),
        mode=contacts.mode.copy(),
        pair=contacts.pair.copy(),
        roll=contacts.roll.copy(),
        reached=contacts.reached.copy(),
        rolling=None if contacts.rolling is None else contacts.rolling.copy(),
    )
    loads = ContactLoads(np.zeros((state.n_bodies, 3)), np.zeros((state.n_bodies, 3)), np.zeros((3, 3)))
    here, struct = bodies(state), law_struct(law, members=FORCES)
    core.evaluate_contacts(struct, state.cell.dim, here, trial, state.cell.vectors, memory, loads.force, loads.torque)
    if state.control.cell_free.any():
        shift = shifts(trial, state.cell.vectors)
        core.add_virial(struct, state.cell.dim, here, trial, shift, loads.virial)
    if state.bonds:
        add_bond_loads(state.bonds, state.cell.dim, here, state.cell.vectors, *loads)
    return loads, trial


def check_memory(memory: int) -> None:
    """Raise ValueError if a number does not denote a treatment of contact memory."""
    if memory not in (FROZEN, HELD, FREE, HELD | GIVEN, FREE | GIVEN):
        raise ValueError(f"memory must be FREE, HELD or FROZEN, got {memory}")


@checked
@knows_bonds
def accept(state: State, trial: Contacts) -> State:
    """State with the trial memory committed.

    Raises
    ------
    ValueError
        If the trial memory belongs to a state with a different number of bodies.
    """
    if len(trial.origin) != state.n_bodies:
        raise ValueError(
            f"the trial memory is that of {len(trial.origin)} bodies, but the state has {state.n_bodies}: use the "
            "result of `forces` for this state"
        )
    bonds = state.bonds and follow_rotations(state.bonds, state.cell.dim, bodies(state), state.cell.vectors)
    return state._replace(contacts=trial, bonds=bonds)


def check_materials(state: State, law: Law) -> None:
    """Raise ValueError if the material of a body has no row in the law's table."""
    used = np.concatenate([state.grains.material, state.walls.material])
    worst = int(used.min()) if used.min() < 0 else int(used.max())
    if not 0 <= worst < len(law.table):
        raise ValueError(
            f"material {worst} is used, but the law has {pluralize(len(law.table), 'material')}: "
            "add it with laws.for_pair(law, a, b)"
        )


@checked
@knows_bonds
def unbalanced_forces(state: State, loads: ContactLoads):
    """Force and torque/R on every body, (N + W, 6), external loads included; zero for components that are not free.

    Parameters
    ----------
    loads : first result of `forces`
    """
    grains, control = state.grains, state.control
    n = len(grains.radius)
    total = np.zeros((state.n_bodies, 6))
    total[:, :3] = loads.force + control.force + spring_forces(control, body_positions(state), state.time)
    total[:n, :3] += grains.mass[:, None] * control.gravity
    total[n:, :3] += state.walls.mass[:, None] * control.gravity
    total[:n, 3:] = (loads.torque[:n] + control.torque[:n]) / grains.radius[:, None]
    for members in groups(control):
        total[members, :3] = total[members, :3].sum(axis=0)
    total[~control.free] = 0.0
    if state.cell.dim == 2:
        total[:, 2:5] = 0.0
    return total
