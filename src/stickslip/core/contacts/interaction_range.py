"""What some laws require of the neighbour list: pairs across gaps, and rows for memory."""

import numpy as np

from ..laws.builtin import Law
from ..laws.kinds import bridges_gaps, own_memory
from ..laws.properties import angular_columns
from ..laws.values import evaluate
from ..state import Contacts, State


def largest_gap(state: State, law: Law) -> float:
    """Largest gap across which a law acts between bodies of a state [length]."""
    if not bridges_gaps(law.kind):
        return 0.0
    r_eff = float(state.grains.radius.max()) * (1.0 if len(state.walls.mass) else 0.5)
    a, b = np.indices(law.table.shape[:2])
    return float(evaluate(law, "range", a=a, b=b, overlap=0.0, r_eff=r_eff).max())


def with_range(state: State, law: Law) -> Contacts:
    """Contact list of a state, marked for a rebuild with a larger gap if the range of the law requires it."""
    contacts, gap = state.contacts, largest_gap(state, law)
    return contacts._replace(gap=gap, stale=True) if gap > contacts.gap else contacts


def with_own_memory(contacts: Contacts, law: Law) -> Contacts:
    """List with a row of memory for each pair, if the law has one for rotations or of its own."""
    row = np.append(np.zeros(angular_columns(law)), [*own_memory(law.kind).values()])
    if not len(row) or (contacts.rolling is not None and contacts.rolling.shape[1] == len(row)):
        return contacts
    return contacts._replace(rolling=np.tile(row, (len(contacts.i), 1)))
