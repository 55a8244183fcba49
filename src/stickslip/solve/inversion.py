"""Overlap and slip of a contact from its normal and tangential force: the inverse of a law."""

import numpy as np

from ..core.contacts.jacobian import Linearisation, linearise
from ..core.contacts.neighbors import with_neighbor_list
from ..core.laws.builtin import Law
from ..core.measure import branch_vectors
from ..core.state import STICK, assembly, box, disks

INVERSIONS, BISECTIONS = 30, 60
ROUND_OFF = 1e-15  # of a force, and of the sum of two radii


def overlap_of_force(law: Law, radius: np.ndarray, force_n: np.ndarray) -> tuple[np.ndarray, Linearisation]:
    """(C,) overlaps of contacts with radii (2, C) and normal forces, and the law there: Newton's method for ln F_n."""
    most = radius.min(axis=0)
    overlap = 1e-3 * most
    for _ in range(INVERSIONS):
        line = _evaluate(law, radius, overlap)
        if not (line.force_n > 0).all():
            break
        if (np.abs(line.force_n / force_n - 1) < ROUND_OFF * (1 + radius.sum(axis=0) / overlap)).all():
            return overlap, line
        overlap = overlap * (force_n / line.force_n) ** (line.force_n / (overlap * line.slope_n))
        if not (overlap < most).all():
            c = int(np.argmax(overlap / most))
            raise ValueError(
                f"the normal force {force_n[c]:.4g} needs an overlap above the radius {most[c]:.4g}: check kn, which "
                f"must be in the units of the forces and lengths"
            )
    raise ValueError("a law whose normal force does not grow from zero with the overlap was given: give another")


def slip_of_force(law: Law, radius: np.ndarray, overlap: np.ndarray, force_t: np.ndarray, line: Linearisation):
    """(C,) sizes of the slips with given sizes of the tangential forces, by bisection up to the Coulomb limit."""
    low, high = np.zeros(len(overlap)), line.limit / line.stiffness_t
    for _ in range(BISECTIONS):
        slip = (low + high) / 2
        short = _evaluate(law, radius, overlap, slip).secant * slip < force_t
        low, high = np.where(short, slip, low), np.where(short, high, slip)
    return (low + high) / 2


def _evaluate(law: Law, radius: np.ndarray, overlap: np.ndarray, slip=0.0) -> Linearisation:
    """Law at separate contacts of disks."""
    count = len(overlap)
    place = np.zeros((2, count, 2))
    place[1, :, 0], place[..., 1] = radius.sum(axis=0) - overlap, 4 * radius.max() * np.arange(count)
    state = with_neighbor_list(assembly(disks(place.reshape(-1, 2), radius.ravel()), cell=box(dim=2)), law)
    contacts = state.contacts._replace(slip=state.contacts.slip.copy(), mode=state.contacts.mode.copy())
    contacts.pair[:count], contacts.mode[:count], contacts.slip[:count, 1] = branch_vectors(state), STICK, slip
    return linearise(state._replace(contacts=contacts), law)
