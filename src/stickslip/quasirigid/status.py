"""Which critical contacts slide: the principle of minimum sliding as a linear complementarity problem.

With k(S) = k₀ − H_S G_Sᵀ, columns h = K_t s c e_t and g = c (m e_n + s e_t), s = sgn D_t, the velocities under a load
rate b obey k(S) v = b. A critical contact that sticks leaves Coulomb's cone at the rate Ṽ = gᵀ v; one that slides does
so at the slip rate λ = Ṽ. Each does what it must: with w = (dF̃/dt)/K_t,

    w = A λ + q ≥ 0,   λ ≥ 0,   wᵀ λ = 0,      A = 1 − Gᵀ k₀⁻¹ H,   q = −Gᵀ k₀⁻¹ b.

The status is unique for every load if and only if A is a P-matrix, det A_SS = det k(S)/det k₀ > 0 for all S.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. IV, where it is proved under a stronger
premise; Cottle, Pang, Stone, The Linear Complementarity Problem (Academic Press 1992), for the algebra.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor

from ..solve.linear import one_thread
from .matrices import Matrices
from .system import System, unheld

ROUNDS = 60  # of flipping all that is inconsistent, before pivoting begins
MAPPED = 14  # contacts up to which all statuses are gone through
SLACK = 1e-9  # share of the largest rate below which a rate may have either sign


class Verdict(Enum):
    """How the search for a status ended; each value is a sentence."""

    CONSISTENT = "every critical contact slides if, and only if, it would leave Coulomb's cone otherwise"
    UNSTABLE = "no consistent status exists on the way of the algorithm: the packing loses its stability here"
    NEGATIVE = "the consistent status has det k < 0: the packing loses its stability here"
    CIRCLES = "events follow one another without progress of the load: the path does not know how to go on"
    MECHANISM = "the load drives a motion that nothing resists: the packing collapses"


class Choice(NamedTuple):
    """The status of all contacts under a load rate, and what moves."""

    verdict: Verdict
    sliding: np.ndarray  # (M,) bool
    critical: np.ndarray  # (Mc,) numbers of the contacts that may slide
    velocity: np.ndarray  # (n,) dq/d(load)
    rate: np.ndarray  # (Mc,) Ṽ: slip rate of what slides, and how fast the others move away from the cone if negative
    method: str  # what found it: "flip all", "principal pivoting" or "Lemke"
    solves: int  # factorisations and pivots

    @property
    def ok(self) -> bool:
        """True if the status is consistent."""
        return self.verdict is Verdict.CONSISTENT


class Uniqueness(NamedTuple):
    """Whether the status is unique for every load: True, False, or None if that is not known; and why."""

    unique: bool | None
    reason: str


class Complementarity(NamedTuple):
    """w = A λ + q ≥ 0, λ ≥ 0, wᵀλ = 0 for the critical contacts."""

    matrix: np.ndarray  # (Mc, Mc) A
    vector: np.ndarray  # (Mc,) q


def status(
    matrix: Matrices,
    load: np.ndarray,
    *,
    critical: np.ndarray | None = None,
    start: np.ndarray | None = None,
    geometric: bool = True,
) -> Choice:
    """The status by the principle of minimum sliding: what slides is what would leave Coulomb's cone otherwise.

    All inconsistent contacts are flipped at once, which nearly always ends after a few rounds; a cycle hands over to
    principal pivoting of one contact at a time (if A may be a P-matrix), and that to Lemke's algorithm. Whatever found
    it, the status is verified contact by contact with a factor of k(S) itself.

    Parameters
    ----------
    load : (n,) rate of the external load on the free coordinates [force/time]
    critical : numbers of the contacts that are at Coulomb's limit; default: those of `matrix.limit`
    start : (M,) bool, a status to begin with, such as that of the last step; default: all critical contacts slide
    geometric : whether the forces turn with the contacts

    Returns
    -------
    Choice
    """
    critical = _numbers(matrix, critical)
    system = System(matrix, load, critical, geometric)
    if start is not None and np.shape(start) != (matrix.count,):
        raise ValueError(
            f"start has the shape {np.shape(start)}: give one bool for each of the {matrix.count} contacts"
        )
    slides = np.ones(len(critical), bool) if start is None else np.asarray(start, bool)[critical]
    method = "flip all"
    if unheld(matrix, system.load):
        return _nothing(matrix, system, Verdict.MECHANISM, method)
    try:
        with one_thread():
            found = _flipped(system, slides)
            if found is None:
                found, method = _solved(system)
            if found is None:
                return _nothing(matrix, system, Verdict.MECHANISM if system.singular else Verdict.UNSTABLE, method)
            if not np.array_equal(system.factored, found):
                system.renew(found)
            velocity, rate = system.rates(found)
    except LinAlgError:
        return _nothing(matrix, system, Verdict.MECHANISM, method)
    if not np.isfinite(rate).all() or _wrong(found, rate).any():
        return _nothing(matrix, system, Verdict.UNSTABLE, method)
    sliding = np.zeros(matrix.count, bool)
    sliding[critical] = found
    return Choice(Verdict.CONSISTENT, sliding, critical, velocity, rate, method, system.solves)


def _numbers(matrix: Matrices, critical) -> np.ndarray:
    """Numbers of the critical contacts, from numbers or from a mask of all contacts."""
    if critical is None:
        return np.flatnonzero(matrix.limit)
    critical = np.asarray(critical)
    if critical.dtype == bool and critical.shape == (matrix.count,):
        return np.flatnonzero(critical)
    known = critical.dtype.kind in "iu" or not critical.size
    if critical.dtype == bool or critical.ndim != 1 or not known or len(np.unique(critical)) < len(critical):
        raise ValueError(
            f"critical = {str(critical)[:60]} was given: it takes different numbers of contacts, or one bool for each "
            f"of the {matrix.count} contacts"
        )
    if critical.size and not 0 <= critical.min() <= critical.max() < matrix.count:
        raise ValueError(
            f"critical contacts {critical.min()} to {critical.max()} were given: contacts have the numbers 0 to "
            f"{matrix.count - 1}"
        )
    return critical.astype(np.int64)


def _nothing(matrix: Matrices, system: System, verdict: Verdict, method: str) -> Choice:
    unknown = np.full(len(system.critical), np.nan)
    velocity = np.full(len(system.load), np.nan)
    return Choice(verdict, np.zeros(matrix.count, bool), system.critical, velocity, unknown, method, system.solves)


def _wrong(slides: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Contacts whose status is not consistent; a rate of nearly zero is consistent with either."""
    slack = SLACK * np.abs(rate).max(initial=0.0)
    return np.where(slides, rate < -slack, rate > slack)


def _flipped(system: System, slides: np.ndarray) -> np.ndarray | None:
    """The status to which flipping all inconsistent contacts leads, or None if it goes round in circles.

    Where k(S) is singular, all contacts stick in the next round: a status on the way need not be one that can be.
    """
    seen = set()
    for _ in range(ROUNDS):
        if slides.tobytes() in seen:
            return None
        seen.add(slides.tobytes())
        try:
            _, rate = system.rates(slides)
        except LinAlgError:
            system.singular = True
            slides = np.zeros(len(slides), bool)
            continue
        wrong = _wrong(slides, rate)
        if not wrong.any():
            return slides
        slides = slides ^ wrong
    return None


def complementarity(
    matrix: Matrices, load: np.ndarray, *, critical: np.ndarray | None = None, geometric: bool = True
) -> Complementarity:
    """A and q of the critical contacts under a load rate; arguments as in `status`."""
    critical = _numbers(matrix, critical)
    with one_thread():
        return _complementarity(System(matrix, load, critical, geometric))


def _complementarity(system: System) -> Complementarity:
    stuck = np.zeros(len(system.critical), bool)
    system.renew(stuck)
    _, rate = system.rates(stuck)
    reach = system.reach(system.pull.toarray(order="F"))
    return Complementarity(np.eye(len(stuck)) - system.sees.T @ reach, -rate)


def _solved(system: System) -> tuple[np.ndarray | None, str]:
    """The status from A and q, and which algorithm found it."""
    problem = _complementarity(system)
    found, pivots = pivoted(problem) if _may_be_p(problem.matrix) else (None, 0)
    system.solves += pivots
    if found is not None:
        return found, "principal pivoting"
    slip = lemke(problem)
    system.solves += len(problem.vector)
    return (None if slip is None else slip > 0), "Lemke"


def pivoted(problem: Complementarity) -> tuple[np.ndarray | None, int]:
    """Murty's principal pivoting: of the inconsistent contacts the one with the largest number is flipped.

    Returns
    -------
    (Mc,) bool or None, int
        what slides, and the number of pivots. For a P-matrix no status occurs twice; where one does, it is None.
    """
    size, seen = len(problem.vector), set()
    slides = np.zeros(size, bool)
    for pivots in range(20 * size + 20):
        rate = _rates_of(problem, slides)
        if rate is None or slides.tobytes() in seen:
            return None, pivots
        wrong = np.flatnonzero(_wrong(slides, rate))
        if not len(wrong):
            return slides, pivots
        seen.add(slides.tobytes())
        slides[wrong[-1]] ^= True
    return None, pivots


def _rates_of(problem: Complementarity, slides: np.ndarray) -> np.ndarray | None:
    """Ṽ of all critical contacts for a status, or None if it is singular."""
    slip = np.zeros(len(slides))
    if slides.any():
        try:
            slip[slides] = np.linalg.solve(problem.matrix[np.ix_(slides, slides)], -problem.vector[slides])
        except np.linalg.LinAlgError:
            return None
    return np.where(slides, slip, -(problem.matrix @ slip + problem.vector))


def lemke(problem: Complementarity) -> np.ndarray | None:
    """λ by Lemke's algorithm with covering vector 1, or None where it ends on a ray: no status is found."""
    size, q = len(problem.vector), problem.vector
    if not size or q.min() >= 0:
        return np.zeros(size)
    # columns: w, λ, the covering variable; basic at first: w
    table = np.hstack([np.eye(size), -problem.matrix, -np.ones((size, 1)), q[:, None]])
    basis, entering = np.arange(size), 2 * size
    row = int(np.argmin(q))
    for _ in range(50 * size + 50):
        table[row] /= table[row, entering]
        others = np.arange(size) != row
        table[others] -= np.outer(table[others, entering], table[row])
        leaving, basis[row] = basis[row], entering
        if leaving == 2 * size:
            slip = np.zeros(2 * size + 1)
            slip[basis] = table[:, -1]
            return slip[size : 2 * size]
        entering = leaving + size if leaving < size else leaving - size
        column = table[:, entering]
        able = column > 1e-11 * max(1.0, np.abs(column).max())
        if not able.any():
            return None
        ratio = np.where(able, table[:, -1] / np.where(able, column, 1.0), np.inf)
        ties = np.flatnonzero(ratio <= ratio.min() * (1 + 1e-12) + 1e-300)
        row = int(ties[np.argmax(basis[ties] == 2 * size)]) if (basis[ties] == 2 * size).any() else int(ties[0])
    return None


def certificate(problem: Complementarity) -> Uniqueness:
    """Whether the status is unique for every load, by the cheapest argument that decides.

    A is a P-matrix if its symmetric part is positive definite, or if it is an H-matrix with a positive diagonal; it is
    none if some minor of one or two contacts is not positive. Up to 14 contacts all minors are gone through.
    """
    a = problem.matrix
    if not len(a):
        return Uniqueness(True, "no contact is critical")
    diagonal, pair = _small_minors(a)
    if (diagonal <= 0).any():
        k = int(np.argmin(diagonal))
        return Uniqueness(False, f"critical contact {k} alone has the minor {diagonal[k]:.3g}")
    if (pair <= 0).any():
        i, j = np.unravel_index(np.argmin(pair), pair.shape)
        return Uniqueness(False, f"critical contacts {i} and {j} have the minor {pair[i, j]:.3g}")
    try:
        cho_factor(0.5 * (a + a.T))
        return Uniqueness(True, "the symmetric part of A is positive definite")
    except LinAlgError:
        pass
    compared = np.diag(2 * diagonal) - np.abs(a)
    weight = np.linalg.lstsq(compared, np.ones(len(a)), rcond=None)[0]
    if (weight > 0).all() and (compared @ weight > 0).all():
        return Uniqueness(True, "A is an H-matrix with a positive diagonal")
    if len(a) <= MAPPED:
        whole = is_p_matrix(a)
        return Uniqueness(whole, f"all {2 ** len(a) - 1} principal minors were gone through")
    return Uniqueness(None, f"not known: {len(a)} critical contacts have too many minors, and no cheap test decides")


def _small_minors(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(Mc,) minors of one contact and (Mc, Mc) of two."""
    diagonal = np.diag(a)
    pair = np.outer(diagonal, diagonal) - a * a.T
    np.fill_diagonal(pair, np.inf)
    return diagonal, pair


def _may_be_p(a: np.ndarray) -> bool:
    """False if a minor of one or two contacts is not positive: principal pivoting may then go round for long."""
    return all((minors > 0).all() for minors in _small_minors(a))


def is_p_matrix(a: np.ndarray) -> bool:
    """True if all principal minors are positive, by recursion on the Schur complement of the first entry."""
    if not len(a):
        return True
    if not a[0, 0] > 0:
        return False
    rest = a[1:, 1:]
    return is_p_matrix(rest) and is_p_matrix(rest - np.outer(a[1:, 0], a[0, 1:]) / a[0, 0])


class StatusMap(NamedTuple):
    """C: S ↦ C(S); bits of S say which critical contacts slide, those of C(S) which are consistent."""

    image: np.ndarray  # (2^Mc,) C(S) for S = 0 … 2^Mc − 1; −1 where k(S) is singular

    @property
    def bijective(self) -> bool:
        """True if every pattern of consistency belongs to exactly one status."""
        return len(np.unique(self.image)) == len(self.image) and self.image.min() >= 0

    @property
    def consistent(self) -> np.ndarray:
        """All globally consistent statuses."""
        return np.flatnonzero(self.image == len(self.image) - 1)


def status_map(problem: Complementarity) -> StatusMap:
    """The map of the paper's Eq. 5, gone through whole, for at most 14 critical contacts."""
    size = len(problem.vector)
    if size > MAPPED:
        raise ValueError(
            f"{size} critical contacts were given: their {2.0**size:.3g} statuses cannot be gone through, at most "
            f"{MAPPED} can; `status` finds the consistent one and `certificate` says what is known of uniqueness"
        )
    bits = 1 << np.arange(size)
    image = np.full(1 << size, -1)
    for number in range(1 << size):
        slides = (number & bits) > 0
        rate = _rates_of(problem, slides)
        if rate is not None:
            image[number] = bits @ np.where(slides, rate > 0, rate < 0).astype(np.int64)
    return StatusMap(image)
