"""Forces at the end of a run, stored so that the next run continues as if there had been no stop.

Dashpots use velocities predicted from the previous forces. If their forces were evaluated anew from the velocities in
a state, they would differ by the error of the prediction. The forces of the last step of a run are therefore stored in
the state that it returns, with a checksum of everything they depend on, and used only if the checksum still agrees.
"""

import zlib

import numpy as np

from ..contacts.forces import Bodies, bodies
from ..laws.builtin import Law, damping_model
from ..state import Instant, State
from .coefficients import driven_bodies

# follow from the rest, or do not affect forces
_IGNORED = ("pair", "roll", "origin", "skin", "gap", "stale", "i", "j", "image")


def state_checksum(state: State, law: Law, memory: str) -> int:
    """Checksum of everything that forces depend on: all arrays of a state, the law and the mode of memory."""
    models = law[3:] if law.properties else law.damping
    out = zlib.crc32(f"{law.kind} {law.coulomb} {models} {memory} {float(state.time)!r}".encode())
    count = int(state.contacts.count[0])
    for noun in (state.grains, state.walls, state.cell, state.contacts, state.control):
        for name, array in zip(noun._fields, noun, strict=True):
            if noun is state.contacts and (name in _IGNORED or array is None):
                continue
            rows = array[:count] if noun is state.contacts and name != "count" else array
            out = zlib.crc32(_bytes(rows), out)
    return zlib.crc32(_bytes(law.table), out)


def with_mark(state: State, law: Law, memory: str) -> State:
    """State at the end of a run, with its instant marked, or with none if a new run would reproduce it bit for bit.

    Without dashpots, forces are reproduced, but the mean velocity of a rigid group is not.
    """
    if not (damping_model(law) or (state.control.group >= 0).any()):
        return state._replace(instant=None)
    return state._replace(instant=state.instant._replace(mark=state_checksum(state, law, memory)))


def matching_instant(state: State, law: Law, memory: str) -> Instant | None:
    """Forces stored by an earlier run, if they belong to this state."""
    instant = state.instant
    return instant if instant is not None and instant.mark == state_checksum(state, law, memory) else None


def bodies_at_start(state: State, instant: Instant | None) -> Bodies:
    """New arrays of all bodies, with the velocities of the previous step, or those prescribed by `Control`."""
    return driven_bodies(state) if instant is None else bodies(state)


def _bytes(values) -> np.ndarray:
    return np.ascontiguousarray(values).reshape(-1).view(np.uint8)
