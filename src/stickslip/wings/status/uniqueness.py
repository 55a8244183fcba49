"""Proofs that the status is unique for every load, or that no status balances a given load.

The status is unique for every load if and only if A is a P-matrix: all principal minors, det A_SS = det k(S)/det k₀,
are positive. Signs are decided to within the errors of the entries of A. A minor that may be zero within these errors
counts as zero; A is then reported as singular, and not as being or not being a P-matrix.

If y ≥ 0, Aᵀ y ≤ 0 and qᵀ y < 0, then no λ ≥ 0 has w = A λ + q ≥ 0, since 0 ≤ yᵀ w = (Aᵀ y)ᵀ λ + qᵀ y < 0. A linear
programme proposes such a Farkas certificate y; the inequalities are then verified, allowing for the errors of A and q.
An unresisted motion that the load drives proves the same.

Source: Cottle, Pang, Stone, The Linear Complementarity Problem (Academic Press 1992), Theorem 3.3.7 and Sec. 3.3.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, qr, solve_triangular
from scipy.optimize import linprog

from ...kit import checked, factorised, readable
from .complementarity import BLUR, MAPPED, Complementarity, Ray, ScaledProblem, enumerate_rates, scale_problem
from .system import StatusSolver


class UniquenessVerdict(Enum):
    """Uniqueness of the status for every load; each value is a sentence."""

    UNIQUE = "the status is unique for every load"
    NOT_UNIQUE = (
        "the status is not unique for every load: under some loads none or several are consistent; see `contact_status`"
    )
    SINGULAR = (
        "singular: several slip rates give the same forces under some loads; see `contact_status` for a given load"
    )
    UNDECIDED = "unknown: no fast test is conclusive; all minors are computed only for up to 14 critical contacts"


@readable
class Uniqueness(NamedTuple):
    """Verdict on uniqueness and its justification; A_SS denotes the rows and columns `contacts` of A."""

    verdict: UniquenessVerdict
    reason: str
    contacts: np.ndarray  # indices among the critical contacts
    value: float = np.nan  # det A_SS; its smallest singular value if singular; or the margin of a sufficient condition
    vector: np.ndarray | None = None  # x with A_SS x = 0 if singular; or weights that make A diagonally dominant

    @property
    def unique(self) -> bool | None:
        """True if the status is unique, False if it is not, None if this is unknown."""
        return {UniquenessVerdict.UNIQUE: True, UniquenessVerdict.UNDECIDED: None}.get(self.verdict, False)

    def __str__(self):
        return f"{self.verdict.value} ({self.reason})"


@checked
def certificate(problem: Complementarity) -> Uniqueness:
    """Test whether the status is unique for every load, by the fastest criterion that holds beyond round-off.

    A is a P-matrix if its symmetric part is positive definite, or if it is an H-matrix with a positive diagonal.
    Otherwise, for up to 14 contacts, all principal minors are computed. For more contacts, the minors of one, two and
    all contacts may still show that A is not a P-matrix.
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
    """Test sufficient conditions for a P-matrix, which need no minors; return None if none of them holds."""
    a, everything = here.matrix, np.arange(len(here.vector))
    # no change within the error bounds moves an eigenvalue of the symmetric part by more than the norm of the bounds
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
    """Return the verdict from all 2^Mc − 1 principal minors."""
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
    """Return the sliding contacts of that one of the given statuses in which the fewest contacts slide."""
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
    """Return the verdict "singular" if a minor of one, two or all contacts is zero, otherwise "undecided"."""
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
    """Sign of det A_SS; 0 if it is singular to round-off."""
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
    """Return minors of one contact (Mc,) and of two (Mc, Mc), infinite on the diagonal, and errors of the latter."""
    a, error = here.matrix, here.error
    diagonal, errors = np.diag(a), np.diag(error)
    pair = np.outer(diagonal, diagonal) - a * a.T
    blur = np.outer(errors, np.abs(diagonal)) + np.abs(a) * error.T
    np.fill_diagonal(pair, np.inf)
    return diagonal, pair, blur + blur.T


def may_be_p_matrix(problem: Complementarity) -> bool:
    """Return False if a minor of one or two contacts is not positive.

    Principal pivoting may then cycle for a long time.
    """
    diagonal, pair, _ = minors_of_one_and_two(scale_problem(problem))
    return bool((diagonal > 0).all() and (pair > 0).all())


FAR = 1e9  # slip rates, in units of q, that a consistent status must exceed for a certificate to be valid
TIGHT = 1e-6  # ten times the tolerance of HiGHS; inequalities this tight are turned into equations
DENSE_UP_TO = 3000  # largest number of coordinates for which null vectors are computed, which takes seconds
ZERO = 1e-11  # fraction of the largest entry of k below which a pivot is zero
NULL = 1e-9  # largest residual of a null vector of unit size, over the largest entry of k


class Absence(NamedTuple):
    """Proof that no status is consistent, by "enumeration" or a "Farkas" vector."""

    by: str
    statuses: int  # number of statuses enumerated
    vector: np.ndarray | None = None  # (Mc,) y ≥ 0 with Aᵀy ≤ 0 and qᵀy < 0, to round-off
    slip: float = np.inf  # smallest sum of λ of a consistent status; infinite if Aᵀy ≤ 0 beyond round-off


class UnresistedMotion(NamedTuple):
    """Unresisted motion driven by the load."""

    velocity: np.ndarray  # (n,) v of unit length, k(S) v = 0
    balance: np.ndarray  # (n,) u of unit length, uᵀ k(S) = 0; as uᵀ b is nonzero, S cannot balance the load b
    power: float  # uᵀ b over |b|
    sliding: np.ndarray  # (Mc,) bool, S; all False for a motion that moves no contact


def farkas(problem: Complementarity) -> Absence | None:
    """Find a verified proof that no λ ≥ 0 has A λ + q ≥ 0; None if there is none."""
    here = scale_problem(problem)
    size = len(here.vector)
    if not size:
        return None
    # maximise the margin t over y with sum 1: Aᵀ y + t ≤ 0, qᵀ y + t ≤ 0
    above = np.hstack([np.vstack([here.matrix.T, here.vector]), np.ones((size + 1, 1))])
    program = linprog(
        np.append(np.zeros(size), -1.0), A_ub=above, b_ub=np.zeros(size + 1),
        A_eq=np.append(np.ones(size), 0.0)[None], b_eq=[1.0], bounds=[(0, None)] * size + [(None, None)],
    )  # fmt: skip
    if program.status != 0 or program.x[-1] < -TIGHT:
        return None
    y = np.maximum(program.x[:-1], 0.0)
    for candidate in (y, _sharpen(here, y)):
        slip = _required_slip(here, candidate)
        if slip > FAR:
            return Absence("Farkas", 0, candidate / here.gap_unit, slip * float(here.slip_unit.min()))
    return None


def _sharpen(here: ScaledProblem, y: np.ndarray) -> np.ndarray:
    """Return y after turning nearly tight inequalities into equations, which they are for an unresisted motion."""
    held = y > TIGHT
    tight = np.abs(here.matrix.T @ y) <= TIGHT
    a = here.matrix[np.ix_(held, tight)].T
    out = np.zeros(len(y))
    out[held] = y[held] - np.linalg.pinv(a, rcond=TIGHT) @ (a @ y[held])
    return np.maximum(out, 0.0)


def _required_slip(here: ScaledProblem, y: np.ndarray) -> float:
    """Return the sum of slip rates that every λ ≥ 0 with A λ + q ≥ 0 must exceed; 0 if y proves nothing."""
    short = -(here.vector @ y) - here.vector_error @ y
    if not (np.isfinite(y).all() and short > 0):
        return 0.0
    excess = float(np.maximum(here.matrix.T @ y + here.error.T @ y, 0.0).max())
    return np.inf if excess == 0 else short / excess


def farkas_ray(problem: Complementarity, absence: Absence) -> Ray | None:
    """Return slip rates, without load, of the contacts in a Farkas vector; None if this motion is resisted."""
    here = scale_problem(problem)
    y = absence.vector * here.gap_unit
    slides = y > TIGHT * y.max()
    a, error = here.submatrix(slides)
    _, values, right = np.linalg.svd(a)
    x = np.zeros(len(y))
    x[slides] = right[-1] * np.sign(right[-1].sum())
    small = BLUR * len(values) * np.linalg.norm(error)
    if values[-1] > small or (x < -small).any() or (here.matrix @ x < -small).any():
        return None
    left = np.where(slides, absence.vector, 0.0)
    return Ray(slides, here.slip_unit * np.maximum(x, 0.0), left, float(left @ problem.vector))


def motion_of_ray(system: StatusSolver, ray: Ray) -> UnresistedMotion | None:
    """Return the motion of a ray, verified by k(S) v = 0, uᵀ k(S) = 0 and uᵀ b ≠ 0; None if one of these fails."""
    stuck = np.zeros(len(system.critical), bool)
    if system.factored is None or not np.array_equal(system.factored, stuck):
        system.factorise(stuck)
    velocity = system.factor(system.pull @ ray.slip)
    try:
        balance = factorised(system.stuck.T.tocsc())(system.sees @ ray.left)
    except LinAlgError:
        return None
    return _verify_motion(system, velocity, balance, ray.slides)


def _verify_motion(
    system: StatusSolver, velocity: np.ndarray, balance: np.ndarray, slides: np.ndarray
) -> UnresistedMotion | None:
    """Return a motion whose two vectors have unit length and all coordinates; None if the verification fails."""
    sizes = np.linalg.norm(velocity), np.linalg.norm(balance)
    if not (np.isfinite(sizes).all() and min(sizes) > 0):
        return None
    v, u = velocity / sizes[0], balance / sizes[1]
    k = system.stiffness(slides)
    small = NULL * np.abs(k.data).max(initial=0.0)
    power = float(u @ system.right)
    size = np.linalg.norm(system.right)
    if np.abs(k @ v).max() > small or np.abs(k.T @ u).max() > small or not abs(power) > NULL * size:
        return None
    return UnresistedMotion(system.expand(v), system.expand(u), power / size, slides)


class IdleMotions(NamedTuple):
    """Motions that are unresisted even if all contacts stick, and do not move any critical contact."""

    coordinates: np.ndarray  # coordinates that may be held fixed to exclude these motions
    motion: UnresistedMotion | None  # motion driven by the load, if any; no status then balances the load


def find_idle_motions(system: StatusSolver) -> IdleMotions | None:
    """Find null vectors of k₀ that are null vectors of every k(S); None if this cannot be decided."""
    if not 0 < len(system.kept) <= DENSE_UP_TO or system.basis is not None:
        return None
    k = system.stuck.toarray()
    scale = np.abs(k).max()
    q, r, pivots = qr(k, pivoting=True)
    rank = int((np.abs(np.diag(r)) > ZERO * scale).sum())
    free = pivots[rank:]
    null = np.zeros((len(k), len(free)))
    null[free] = np.eye(len(free))
    null[pivots[:rank]] = -solve_triangular(r[:rank, :rank], r[:rank, rank:])
    left = q[:, rank:]
    apart = np.abs(system.sees.T @ null).max(initial=0.0) + np.abs(system.pull.T @ left).max(initial=0.0) / scale
    if not len(free) or apart > NULL * np.abs(null).max(initial=0.0):
        return None
    pushed = left.T @ system.right
    nothing = np.zeros(len(system.critical), bool)
    if np.abs(pushed).max() > NULL * np.abs(system.right).max(initial=0.0):
        return IdleMotions(
            system.kept[free], _verify_motion(system, null @ (null.T @ system.right), left @ pushed, nothing)
        )
    # fixing these coordinates must exclude the motions and the corresponding balance equations
    return IdleMotions(system.kept[free], None) if np.linalg.cond(left[free]) < 1 / ZERO else None
