"""Uniqueness of the status for every load: certificates for P-matrices, and verifiable counterexamples.

The status is unique for every load if and only if A is a P-matrix: all principal minors, det A_SS = det k(S)/det k₀,
are positive. Signs are decided to within the errors in the entries of A: a minor that may be zero within these errors
counts as zero, and A is then reported as singular rather than as being or not being a P-matrix.

Source: Cottle, Pang, Stone, The Linear Complementarity Problem (Academic Press 1992), Theorem 3.3.7 and Sec. 3.3.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np

from ...kit import checked, readable
from .enumeration import BLUR, MAPPED, enumerate_rates
from .lcp import Complementarity, ScaledProblem, scale_problem


class UniquenessVerdict(Enum):
    """Uniqueness of the status for every load; each value is a sentence."""

    UNIQUE = "the status is unique for every load"
    NOT_UNIQUE = (
        "the status is not unique for every load: under some loads none or several are consistent; see `contact_status`"
    )
    SINGULAR = (
        "singular: several slip rates give the same forces under some loads; see `contact_status` for a given load"
    )
    UNDECIDED = "not known: no fast test is conclusive; all minors are computed only for up to 14 critical contacts"


@readable
class Uniqueness(NamedTuple):
    """Verdict on uniqueness and its justification; A_SS denotes the rows and columns `contacts` of A."""

    verdict: UniquenessVerdict
    reason: str
    contacts: np.ndarray  # numbers among the critical contacts
    value: float = np.nan  # det A_SS; its smallest singular value if singular; the margin of a sufficient condition
    vector: np.ndarray | None = None  # x with A_SS x = 0 if singular; weights that make A diagonally dominant

    @property
    def unique(self) -> bool | None:
        """True, False, or None if it is not known."""
        return {UniquenessVerdict.UNIQUE: True, UniquenessVerdict.UNDECIDED: None}.get(self.verdict, False)

    def __str__(self):
        return f"{self.verdict.value} ({self.reason})"


@checked
def certificate(problem: Complementarity) -> Uniqueness:
    """Test whether the status is unique for every load, by the fastest criterion that holds beyond round-off.

    A is a P-matrix if its symmetric part is positive definite, or if it is an H-matrix with a positive diagonal.
    Otherwise all principal minors are computed for up to 14 contacts. Beyond that, the minors of one and two contacts
    and of all contacts may still show that A is not a P-matrix.
    """
    size = len(problem.vector)
    if not size:
        return Uniqueness(UniquenessVerdict.UNIQUE, "no contact is critical", np.arange(0))
    here = scale_problem(problem)
    sufficient = _sufficient_condition(here)
    if sufficient is not None:
        return sufficient
    negative = _find_negative_minor(here)
    if negative is not None:
        return _make_not_unique(problem, negative, "minors of one and two contacts and of all were computed")
    return _check_all_minors(problem, here) if size <= MAPPED else _check_small_minors(here)


def _sufficient_condition(here: ScaledProblem) -> Uniqueness | None:
    """Sufficient condition for a P-matrix, tested without minors; None if it does not hold."""
    a, everything = here.matrix, np.arange(len(here.vector))
    # no change within the error bounds moves an eigenvalue of the symmetric part by more than their norm
    margin = float(np.linalg.eigvalsh(0.5 * (a + a.T))[0] - np.linalg.norm(here.error))
    if margin > 0:
        return Uniqueness(
            UniquenessVerdict.UNIQUE, "the symmetric part of the scaled A is positive definite", everything, margin
        )
    compared = np.diag(2 * np.diag(a)) - np.abs(a)
    weight = np.linalg.lstsq(compared, np.ones(len(a)), rcond=None)[0]
    margin = float((compared @ weight - here.error @ np.abs(weight)).min())
    if (weight > 0).all() and margin > 0:
        weight = here.slip_unit * weight
        return Uniqueness(
            UniquenessVerdict.UNIQUE, "A is an H-matrix with a positive diagonal", everything, margin, weight
        )
    return None


def _check_all_minors(problem: Complementarity, here: ScaledProblem) -> Uniqueness:
    """Verdict from all 2^Mc − 1 principal minors."""
    through = enumerate_rates(here)
    reason = f"all {len(through.sign) - 1} principal minors were computed"
    if (through.sign < 0).any():
        return _make_not_unique(problem, _fewest_sliding(through, through.sign < 0), reason)
    if (through.sign == 0).any():
        return _make_singular(here, _fewest_sliding(through, through.sign == 0), reason)
    least = np.flatnonzero(through.slides[1 + int(np.argmin(through.minor[1:]))])
    value = float(np.linalg.det(problem.matrix[np.ix_(least, least)]))
    return Uniqueness(UniquenessVerdict.UNIQUE, f"{reason}; the smallest is {value:.3g}", least, value)


def _fewest_sliding(through, which: np.ndarray) -> np.ndarray:
    """Status with the fewest sliding contacts among the given ones."""
    rows = through.slides[which]
    return np.flatnonzero(rows[int(np.argmin(rows.sum(axis=1)))])


def _find_negative_minor(here: ScaledProblem) -> np.ndarray | None:
    """Find a set of one, two or all contacts whose minor is negative beyond round-off."""
    diagonal, pair, blur = minors_of_one_and_two(here)
    for contact in np.flatnonzero(diagonal < -np.diag(here.error)):
        return np.array([contact])
    for two in np.argwhere(np.triu(pair < -blur, 1)):
        return two
    everything = np.arange(len(diagonal))
    return everything if sign_of_minor(here, everything) < 0 else None


def _check_small_minors(here: ScaledProblem) -> Uniqueness:
    """Singular if a minor of one, two or all contacts is zero; otherwise undecided."""
    diagonal, pair, blur = minors_of_one_and_two(here)
    everything = np.arange(len(diagonal))
    zero = [np.array([k]) for k in np.flatnonzero(diagonal <= np.diag(here.error))]
    zero += list(np.argwhere(np.triu(pair <= blur, 1))[:1])
    zero += [] if is_regular(here, everything) else [everything]
    reason = "minors of one and two contacts and of all were computed"
    if zero:
        return _make_singular(here, zero[0], reason)
    return Uniqueness(
        UniquenessVerdict.UNDECIDED, f"{reason}; {len(diagonal)} contacts have too many minors", np.arange(0)
    )


def is_regular(here: ScaledProblem, chosen: np.ndarray) -> bool:
    """Return True if A_SS has full rank beyond the errors in its entries."""
    a, error = here.submatrix(chosen)
    return not len(a) or bool(np.linalg.svd(a, compute_uv=False)[-1] > BLUR * np.linalg.norm(error))


def sign_of_minor(here: ScaledProblem, chosen: np.ndarray) -> int:
    """Sign of det A_SS, 0 if it is singular to round-off."""
    return int(np.linalg.slogdet(here.submatrix(chosen)[0])[0]) if is_regular(here, chosen) else 0


def _make_not_unique(problem: Complementarity, chosen: np.ndarray, reason: str) -> Uniqueness:
    value = float(np.linalg.det(problem.matrix[np.ix_(chosen, chosen)]))
    named = ", ".join(map(str, chosen[:MAPPED]))
    return Uniqueness(
        UniquenessVerdict.NOT_UNIQUE, f"critical contacts {named} have the minor {value:.3g}; {reason}", chosen, value
    )


def _make_singular(here: ScaledProblem, chosen: np.ndarray, minors: str) -> Uniqueness:
    _, values, right = np.linalg.svd(here.submatrix(chosen)[0])
    x = here.slip_unit[chosen] * right[-1]
    named = ", ".join(map(str, chosen[:MAPPED]))
    reason = f"A of critical contacts {named} has the singular value {values[-1]:.1e}, zero to round-off; {minors}"
    return Uniqueness(UniquenessVerdict.SINGULAR, reason, chosen, float(values[-1]), x / np.abs(x).max())


def minors_of_one_and_two(here: ScaledProblem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(Mc,) minors of one contact, (Mc, Mc) of two with infinite diagonal, and error bounds for the latter."""
    a, error = here.matrix, here.error
    diagonal, own = np.diag(a), np.diag(error)
    pair = np.outer(diagonal, diagonal) - a * a.T
    blur = np.outer(own, np.abs(diagonal)) + np.abs(a) * error.T
    np.fill_diagonal(pair, np.inf)
    return diagonal, pair, blur + blur.T


def may_be_p_matrix(problem: Complementarity) -> bool:
    """Return False if a minor of one or two contacts is not positive.

    Principal pivoting may then cycle for a long time.
    """
    diagonal, pair, _ = minors_of_one_and_two(scale_problem(problem))
    return bool((diagonal > 0).all() and (pair > 0).all())
