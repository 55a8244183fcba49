"""What contacts do that have no force, because they open or have just closed: the four statuses, in a packing.

A disk that has lost the force of all its contacts is released as a body. It is drawn along by none of them if the least
motion that follows its neighbours lets all of its contacts open; else it carries again.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. V B, where the question is left open.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ..solve.linear import factorised
from .apex import OPENS, SIDE, SLACK, WORDS, Apex, Found, changed, choices, consistent_statuses, statuses_at_apex
from .matrices import Matrices, stiffness_matrix
from .system import pins

CHECKED = 256  # choices of statuses up to which uniqueness is checked while a path is followed


class Reduced(NamedTuple):
    """The map of some contacts of a packing, and the way back from their velocities to all."""

    apex: Apex
    free: np.ndarray  # (n,) velocities if all these contacts stuck
    reach: np.ndarray  # (n, 2E) velocities per unit force of each contact on its first body

    def velocities(self, found: Found) -> np.ndarray:
        """(n,) velocities of all coordinates."""
        lost = np.einsum("eab,eb->ea", changed(self.apex, found.status), found.velocity)
        return self.free - self.reach @ lost.ravel()


def reduced(
    matrix: Matrices, load: np.ndarray, contacts: np.ndarray, sign: np.ndarray, *, geometric: bool = True,
    without: np.ndarray | None = None, alone: np.ndarray | None = None,
) -> Reduced:  # fmt: skip
    """The map g of some contacts of a packing under a load rate.

    Parameters
    ----------
    load : (n,) rate of the external load on the free coordinates [force/time]
    contacts : (E,) numbers of the contacts that may change their status; all others stick
    sign : (E,) sgn D_t of those that are at Coulomb's limit with a force, 0 for those at the apex
    without : coordinates that stand still
    alone : (M,) bool, contacts of disks all of whose contacts are at the apex

    Raises
    ------
    LinAlgError
        if k is singular while all contacts stick.
    """
    size, held = len(matrix.free), pins(matrix)
    kept = np.setdiff1d(np.arange(size), held if without is None else np.union1d(held, without))
    stuck = stiffness_matrix(matrix, np.zeros(matrix.count, bool), geometric=geometric)[kept][:, kept]
    solve = factorised(stuck)
    columns = matrix.c.tocsc()[kept][:, np.stack([2 * contacts, 2 * contacts + 1], axis=1).ravel()].toarray()
    reach, free = np.zeros((size, columns.shape[1])), np.zeros(size)
    free[kept] = solve(load[kept])
    for k, column in enumerate(columns.T):
        reach[kept, k] = solve(column)
    apex = Apex(
        columns.T @ reach[kept], (columns.T @ free[kept]).reshape(-1, 2), matrix.springs[contacts],
        matrix.slope[contacts], np.asarray(sign, float),
        np.zeros(len(contacts), bool) if alone is None else alone[contacts],
    )  # fmt: skip
    return Reduced(apex, free, reach)


class Decided(NamedTuple):
    """What contacts at the apex do, for all M contacts."""

    apex: np.ndarray  # (M,) bool: these were to be decided
    status: np.ndarray  # (M,) as in `apex`; of the other contacts, whether they slide
    count: int | None  # consistent choices of statuses, None where there are too many to go through

    @property
    def opens(self) -> np.ndarray:
        """(M,) bool."""
        return self.status == OPENS

    @property
    def side(self) -> np.ndarray:
        """(M,) sgn D_t of what slides, 0 elsewhere."""
        return SIDE[self.status]

    def words(self, contact: int) -> str:
        """The status of a contact."""
        return WORDS[self.status[contact]]


def decided(matrix: Matrices, load: np.ndarray, apex: np.ndarray, *, geometric: bool = True) -> Decided | None:
    """The statuses of contacts at the apex, (M,) bool, and of those at the limit, under a load rate.

    Returns
    -------
    Decided, or None if no choice of statuses was found to be consistent: stability is lost
    """
    ours = _contacts_of_bodies(matrix)
    released = (ours.sum(axis=1) > 0) & ~(ours & ~apex).any(axis=1)
    alone = (ours & released[:, None]).any(axis=0)
    while True:
        gone = (ours & released[:, None]).any(axis=0)
        special = np.flatnonzero((apex | matrix.limit) & ~gone)
        sign = np.where(apex, 0.0, matrix.sign)[special]
        loose = np.flatnonzero(np.append(released, False)[matrix.free.body])
        rest = matrix._replace(springs=np.where(gone[:, None, None], 0.0, matrix.springs))
        try:
            map_of = reduced(rest, load, special, sign, geometric=geometric, without=loose, alone=alone)
            found = statuses_at_apex(map_of.apex)
        except LinAlgError:
            found = None
        if found is None or found.status is None:
            if not released.any():
                return None
            released[:] = False  # without these bodies nothing holds the others: they may have to carry
            continue
        caught = released & _drawn(matrix, map_of.velocities(found), loose, gone, ours)
        if not caught.any():
            break
        released &= ~caught
    status = np.zeros(matrix.count, int)
    status[special], status[gone] = found.status, OPENS
    count = len(consistent_statuses(map_of.apex)[0]) if choices(map_of.apex) <= CHECKED else None
    return Decided(apex, status, count)


def _contacts_of_bodies(matrix: Matrices) -> np.ndarray:
    """(B, M) bool: which contacts each grain with a free rotation has; empty rows for all other bodies."""
    body, c = matrix.free.body, matrix.c.tocoo()
    out = np.zeros((int(body.max(initial=-1)) + 1, matrix.count), bool)
    out[body[c.row[c.data != 0]], c.col[c.data != 0] // 2] = True
    turns = np.zeros(len(out), bool)
    turns[body[matrix.free.axis == 5]] = True
    return out & turns[:, None]


def _drawn(matrix: Matrices, velocity: np.ndarray, loose: np.ndarray, gone: np.ndarray, ours: np.ndarray) -> np.ndarray:
    """(B,) bool: released bodies some of whose contacts close although the bodies follow their neighbours."""
    if not len(loose):
        return np.zeros(len(ours), bool)
    columns = np.repeat(gone, 2)
    apart = (matrix.c.T @ velocity)[columns]
    own = matrix.c[loose][:, np.flatnonzero(columns)].toarray()
    follow = np.linalg.lstsq(own.T, -apart, rcond=None)[0]
    normal = (own.T @ follow + apart)[::2]
    closes = np.zeros(matrix.count, bool)
    closes[gone] = normal < -SLACK * np.abs(velocity).max(initial=0.0)
    return (ours & closes).any(axis=1)
