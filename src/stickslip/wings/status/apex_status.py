"""Contact status under a load rate, also with contacts at the apex of the cone, which carry no force.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. V B; see `opening`.
"""

import numpy as np

from ...kit import checked
from .cone_apex import SIDE, SLACK, Apex, status_of_velocity, stiffness_change
from .events import APEX
from .lcp import critical_numbers
from .matrices import LinearSystem
from .opening import ApexStatuses, decide_statuses
from .round_cone import round_cone_stretch
from .status import ContactStatus, Verdict, status_of_critical
from .system import RESIDUAL, driven_motions, roll_springs


@checked
def contact_status(
    matrix: LinearSystem, load: np.ndarray, *, critical: np.ndarray | None = None, start: np.ndarray | None = None,
    geometric: bool = True, unique: bool | None = None,
) -> ContactStatus:  # fmt: skip
    """Find the contact status by the principle of minimum sliding.

    A contact slides if and only if it would otherwise leave the Coulomb cone. All inconsistent contacts are flipped
    together, which nearly always converges after a few rounds. If this cycles, principal pivoting flips one contact at
    a time (if A may be a P-matrix), and then Lemke's algorithm is used. Every status found is verified contact by
    contact with a factor of k(S) itself. For up to 14 critical contacts, all statuses are enumerated unless A is a
    P-matrix: those with det k > 0 come first, and the absence of a status is proven. If many statuses are singular,
    solutions may exist to within the error bounds, of which none balances the load as k(S) itself shows: nothing is
    proven then, and the verdict is NOT_FOUND. Beyond that, a proof of absence needs a Farkas certificate.

    A critical contact without force may also open (`ContactStatus.opens`), and in space it may slide in any direction.
    A status is then sought as on a load path, and verified by the balance of the force rates that the law itself gives
    at the velocities. The verdict is CONSISTENT, NEGATIVE or NOT_FOUND; others are not sought.

    Parameters
    ----------
    load : (n,) rate of the external load on the free coordinates [force/time]
    critical : indices of the contacts at the Coulomb limit; default: those of `matrix.limit`, and those without force
    start : (M,) bool, initial status, such as that of the last step; default: all critical contacts slide
    geometric : whether the forces rotate with the contacts
    unique : whether stability and uniqueness of the status are tested; default: only for up to 14 critical contacts

    Returns
    -------
    ContactStatus
    """
    faint = matrix.force[:, 0] <= APEX * matrix.force[:, 0].mean() if matrix.count else np.zeros(0, bool)
    numbers = critical_numbers(matrix, matrix.limit | faint if critical is None else critical)
    if not faint[numbers].any() or len(driven_motions(matrix, load, geometric)):
        return status_of_critical(
            matrix, load, critical=numbers, start=start, geometric=geometric, unique=unique
        )  # fmt: skip
    mask = np.isin(np.arange(matrix.count), numbers)
    return _status_at_apex(matrix._replace(limit=mask & ~faint), np.asarray(load, float), mask & faint, geometric)


def _status_at_apex(matrix: LinearSystem, load: np.ndarray, apex: np.ndarray, geometric: bool) -> ContactStatus:
    """Verified status with contacts at the apex, (M,) bool, or NOT_FOUND."""
    critical = np.flatnonzero(apex | matrix.limit)
    choice = decide_statuses(matrix, load, apex, geometric=geometric)
    if choice.status is None or not is_balanced(matrix, load, choice, geometric):
        nothing, unknown = np.zeros(matrix.count, bool), np.full(len(critical), np.nan)
        return ContactStatus(
            Verdict.NOT_FOUND, nothing, critical, np.full(len(load), np.nan), unknown, "", 0, opens=nothing
        )  # fmt: skip
    verdict = Verdict.CONSISTENT if choice.stable else Verdict.NEGATIVE
    normal, along = _relative_velocities(matrix, choice.motion)[critical, :2].T
    across = np.linalg.norm(_relative_velocities(matrix, choice.motion)[critical, 1:], axis=1)
    sign = np.where(apex, SIDE[choice.status], matrix.sign)[critical]
    out = matrix.slope[critical] * normal
    out += np.where(apex[critical] & (matrix.width == 3), across, sign * along)
    rate = np.where(choice.opens[critical], np.nan, out)
    return ContactStatus(
        verdict, choice.side != 0, critical, choice.motion, rate, "at the apex", 0, choice.stable, opens=choice.opens
    )  # fmt: skip


def _relative_velocities(matrix: LinearSystem, motion: np.ndarray) -> np.ndarray:
    """(M, d) V of all contacts."""
    return (matrix.c.T @ motion).reshape(-1, matrix.width)


def is_balanced(matrix: LinearSystem, load: np.ndarray, choice: ApexStatuses, geometric: bool) -> bool:
    """Return True if the law gives force rates at the velocities that balance the load, with these statuses."""
    velocity = _relative_velocities(matrix, choice.motion)
    special = np.flatnonzero(choice.apex | matrix.limit)
    part = Apex(
        np.zeros((0, 0)), velocity[special], matrix.springs[special], matrix.slope[special],
        np.where(choice.apex, 0.0, matrix.sign)[special], np.zeros(len(special), bool),
    )  # fmt: skip
    stretch = np.einsum("mab,mb->ma", matrix.springs, velocity)
    status, slack = choice.status[special], SLACK * np.abs(velocity).max(initial=0.0)
    if matrix.width == 2:
        if not np.array_equal(status_of_velocity(part, part.velocity, status, slack), status):
            return False
        stretch[special] += np.einsum("mab,mb->ma", stiffness_change(part, status), part.velocity)
    else:
        stretch[special] = np.einsum("mab,mb->ma", part.springs, round_cone_stretch(part, part.velocity)[0])
    held = matrix.machine + roll_springs(matrix, geometric) + geometric * matrix.geometric
    missed = matrix.c @ stretch.ravel() + held @ choice.motion - load
    return bool(np.abs(missed).max(initial=0.0) <= RESIDUAL * np.abs(load).max(initial=0.0))
