"""Status of the critical contacts by the principle of minimum sliding, as a linear complementarity problem.

With k(S) = k₀ − H_S G_Sᵀ, columns h = K_t s c e_t and g = c (m e_n + s e_t), s = sgn D_t, the velocities under a load
rate b obey k(S) v = b. A sticking critical contact leaves the Coulomb cone at the rate Ṽ = gᵀ v; a sliding one has the
slip rate λ = Ṽ. The status is consistent if, with w = (dF̃/dt)/K_t,

    w = A λ + q ≥ 0,   λ ≥ 0,   wᵀ λ = 0,      A = 1 − Gᵀ k₀⁻¹ H,   q = −Gᵀ k₀⁻¹ b.

The status is unique for every load if and only if A is a P-matrix, that is, det A_SS = det k(S)/det k₀ > 0 for all S.

A status with det k(S)/det k₀ < 0 is unstable for any masses and dashpots: det(m z² + γ z + k) has a root z > 0.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. IV, with a proof under a stronger
assumption; Cottle, Pang, Stone, The Linear Complementarity Problem (Academic Press 1992), for the algebra.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ...kit import one_thread, readable
from .complementarity import (
    BLUR,
    MAPPED,
    Complementarity,
    Solution,
    complementarity_of_system,
    critical_numbers,
    enumerate_solutions,
    inconsistent,
    lemke,
    principal_pivoting,
    scale_problem,
    sign_slack,
)
from .matrices import LinearSystem, force_rates, stiffness_matrix
from .system import StatusSolver, driven_motions
from .uniqueness import (
    Absence,
    Uniqueness,
    UnresistedMotion,
    certificate,
    farkas,
    farkas_ray,
    find_idle_motions,
    is_regular,
    may_be_p_matrix,
    motion_of_ray,
    sign_of_minor,
)

ROUNDS = 60  # largest number of rounds that flip all inconsistent contacts, before pivoting begins
ALIKE = 1e-6  # largest difference, over the largest rate, between rates that count as the same
SAME = 1e-7  # largest difference, over the largest rate, between force rates that count as the same


class Verdict(Enum):
    """Outcome of the search for a status; each value is a sentence."""

    CONSISTENT = (
        "every critical contact slides if and only if it would otherwise leave the Coulomb cone; other statuses were "
        "not examined"
    )
    UNIQUE = "this status is the only consistent one under this load"
    NOT_UNIQUE = (
        "several statuses are consistent under this load, so the response is not determined; `others` lists the rest"
    )
    SINGULAR = (
        "several slip rates give the same forces: the forces are determined, but the motion of a grain that slides at "
        "all of its contacts is not; `others` lists the rest"
    )
    NEGATIVE = "the consistent status has det k < 0: the packing loses its stability here; use another load"
    UNSTABLE = (
        "it is proven that no status is consistent: the packing loses its stability here; follow it using dynamics"
    )
    NO_PROGRESS = (
        "200 events or parts of increments passed while the load hardly advanced: the path ends here; follow it using "
        "dynamics"
    )
    MECHANISM = (
        "the load drives an unresisted motion, and no status balances it: the packing collapses; balance the "
        "load, or follow it using dynamics"
    )
    FLOWS = (
        "the packing did not come to rest within the stated time and displacement: it flows under this load, "
        "or creeps, if the drag is large; use a smaller load, a stiffer machine, less drag, or a longer duration"
    )
    NOT_FOUND = "no consistent status was found, but one may exist: try another `start` or fewer critical contacts"


class Alternative(NamedTuple):
    """Alternative consistent status under the same load."""

    sliding: np.ndarray  # (M,) bool
    velocity: np.ndarray  # (n,)
    rate: np.ndarray  # (Mc,) Ṽ
    stable: bool | None  # see `ContactStatus.stable`


@readable
class ContactStatus(NamedTuple):
    """Status of all contacts under a load rate, with velocities, a verdict and its justification.

    `stable` is a statement on det k(S) alone: if it is False, a motion grows without oscillating. If it is True, this
    status causes no such motion, but oscillations may grow; the eigenvalues of `stability` show them.
    """

    verdict: Verdict
    sliding: np.ndarray  # (M,) bool
    critical: np.ndarray  # (Mc,) numbers of the contacts that may slide
    velocity: np.ndarray  # (n,) dq/d(load)
    rate: np.ndarray  # (Mc,) Ṽ: slip rate of sliding contacts; the others move away from the cone if Ṽ is negative
    method: str  # "flip all", "principal pivoting", "Lemke" or "enumeration"
    solves: int  # number of factorisations and pivots
    stable: bool | None = None  # det k(S) has the sign of det k₀; None if it is zero to round-off, or not computed
    others: tuple[Alternative, ...] = ()  # other consistent statuses that were found, if there was a search
    uniqueness: Uniqueness | None = None  # uniqueness under every load, if requested
    proof: Absence | UnresistedMotion | None = None  # proof that no status is consistent, or motion driven by the load
    marginal: np.ndarray | None = None  # (Mc,) bool: contacts on the cone that do not slip and may have either status
    opens: np.ndarray | None = None  # (M,) bool: contacts without force that open; None if all contacts carry force

    @property
    def ok(self) -> bool:
        """True if a consistent status was found whose det k is not known to be negative."""
        return self.verdict in (Verdict.CONSISTENT, Verdict.UNIQUE, Verdict.NOT_UNIQUE, Verdict.SINGULAR)


class VerifiedStatus(NamedTuple):
    """Status whose velocities balance the load."""

    slides: np.ndarray  # (Mc,) bool
    velocity: np.ndarray
    rate: np.ndarray
    method: str
    stable: bool | None = None


def status_of_critical(
    matrix: LinearSystem, load: np.ndarray, *, critical: np.ndarray | None = None, start: np.ndarray | None = None,
    geometric: bool = True, unique: bool | None = None,
) -> ContactStatus:  # fmt: skip
    """Find the status of critical contacts that all carry a force; arguments are those of `contact_status`."""
    system = StatusSolver(matrix, load, critical_numbers(matrix, critical), geometric)
    if start is not None and np.shape(start) != (matrix.count,):
        raise ValueError(f"start must be one bool for each of the {matrix.count} contacts, got shape {np.shape(start)}")
    slides = np.ones(len(system.critical), bool) if start is None else np.asarray(start, bool)[system.critical]
    if len(driven := driven_motions(matrix, system.load, geometric)):
        return _make_failure(system, Verdict.MECHANISM, _unbalanced_motion(system, driven))
    unique = len(slides) <= MAPPED if unique is None else unique
    with one_thread():
        return _search(system, slides, unique) or _search_without_idle_motions(system, slides, unique)


def _search(system: StatusSolver, slides: np.ndarray, unique: bool) -> ContactStatus | None:
    """Search for a status; return None if k₀ is singular."""
    flipped = _flip_inconsistent(system, slides)
    if flipped is not None and not unique:
        return _make_status(system, Verdict.CONSISTENT, flipped)
    try:
        problem = complementarity_of_system(system)
    except LinAlgError:
        return None
    if len(slides) <= MAPPED:
        return _enumerate(system, problem, flipped)
    return _search_many(system, problem, flipped, unique)


def _search_without_idle_motions(system: StatusSolver, slides: np.ndarray, unique: bool) -> ContactStatus:
    """Search if k₀ is singular: its null motions are held fixed, unless the load drives them."""
    idle = find_idle_motions(system)
    if idle is not None and idle.motion is not None:
        return _make_failure(system, Verdict.MECHANISM, idle.motion)
    if idle is not None:
        held = StatusSolver(system.matrix, system.load, system.critical, system.geometric, idle.coordinates)
        choice = _search(held, slides, unique)
        if choice is not None:
            return choice
    flipped = _flip_inconsistent(system, slides)
    return _make_failure(system, Verdict.NOT_FOUND) if flipped is None else _make_status(
        system, Verdict.CONSISTENT, flipped
    )  # fmt: skip


def _unbalanced_motion(system: StatusSolver, driven: np.ndarray) -> UnresistedMotion:
    """Return a translation of the packing, or a rolling motion of a sphere, along which no force balances the load."""
    balance = driven.T @ (driven @ system.load)
    move = balance / np.linalg.norm(balance)
    nothing = np.zeros(len(system.critical), bool)
    turned = stiffness_matrix(system.matrix, np.zeros(system.matrix.count, bool), geometric=system.geometric) @ move
    velocity = move.copy()
    # the forces on a rolling sphere do not turn with it
    if system.matrix.free.dim == 3 and np.abs(turned).max() > 0:
        system.factorise(nothing)
        velocity -= system.expand(system.factor(system.reduce(turned)))
    power = float(move @ system.load) / np.linalg.norm(system.load)
    return UnresistedMotion(velocity / np.linalg.norm(velocity), move, power, nothing)


def _make_status(
    system: StatusSolver, verdict: Verdict, answer: VerifiedStatus, others=(), known=None
) -> ContactStatus:
    marginal = np.abs(answer.rate) <= sign_slack(answer.rate, system.round_off(answer.velocity))
    also = tuple(Alternative(_expand_status(system, a.slides), a.velocity, a.rate, a.stable) for a in others)
    return ContactStatus(
        verdict, _expand_status(system, answer.slides), system.critical, answer.velocity, answer.rate,
        answer.method, system.solves, answer.stable, also, known, None, marginal,
    )  # fmt: skip


def _make_failure(system: StatusSolver, verdict: Verdict, proof=None, known=None) -> ContactStatus:
    unknown = np.full(len(system.critical), np.nan)
    return ContactStatus(
        verdict, np.zeros(system.matrix.count, bool), system.critical, np.full(len(system.load), np.nan), unknown, "",
        system.solves, None, (), known, proof,
    )  # fmt: skip


def _expand_status(system: StatusSolver, slides: np.ndarray) -> np.ndarray:
    """Return the mask (M,) of all sliding contacts, given the status of the critical contacts."""
    sliding = np.zeros(system.matrix.count, bool)
    sliding[system.critical] = slides
    return sliding


def _verify(system: StatusSolver, slides: np.ndarray | None, method: str) -> VerifiedStatus | None:
    """Compute the velocities of a status from its k(S); return None unless it is consistent and balances the load."""
    if slides is None:
        return None
    try:
        if system.factored is None or not np.array_equal(system.factored, slides):
            system.factorise(slides)
        velocity, rate = system.rates(slides)
    except LinAlgError:
        return None
    if not _is_consistent(system, slides, velocity, rate):
        return None
    return VerifiedStatus(slides, velocity, rate, method)


def _is_consistent(system: StatusSolver, slides: np.ndarray, velocity: np.ndarray, rate: np.ndarray, slack=0.0) -> bool:
    """Return True if the status of every contact is consistent; False if a rate is not a number."""
    slack = np.maximum(slack, system.round_off(velocity))
    return bool(np.isfinite(rate).all()) and not inconsistent(slides, rate, slack).any()


def _flip_inconsistent(system: StatusSolver, slides: np.ndarray) -> VerifiedStatus | None:
    """Flip all inconsistent contacts until the status is consistent; return None if this cycles.

    If k(S) is singular, all contacts stick in the next round, since intermediate statuses need not be admissible.
    """
    seen = set()
    for _ in range(ROUNDS):
        if slides.tobytes() in seen:
            return None
        seen.add(slides.tobytes())
        try:
            velocity, rate = system.rates(slides)
        except LinAlgError:
            slides = np.zeros(len(slides), bool)
            continue
        bad = inconsistent(slides, rate, system.round_off(velocity))
        if not bad.any():
            return _verify(system, slides, "flip all")
        slides = slides ^ bad
    return None


def _enumerate(system: StatusSolver, problem: Complementarity, flipped: VerifiedStatus | None) -> ContactStatus:
    """Find the status by enumeration, or directly for a P-matrix."""
    uniqueness = certificate(problem)
    if uniqueness.unique:
        flipped = flipped or _verify(system, principal_pivoting(problem)[0], "principal pivoting")
        if flipped is not None:
            return _make_status(system, Verdict.UNIQUE, flipped._replace(stable=True), (), uniqueness)
    every = enumerate_solutions(problem, lambda slides: _recompute_rates(system, slides))
    if not every.solutions:
        for ray in every.rays:
            motion = motion_of_ray(system, ray) if ray.drive else None
            if motion is not None:
                return _make_failure(system, Verdict.MECHANISM, motion, uniqueness)
        absent = Absence("enumeration", 1 << len(problem.vector))
        return _make_failure(system, Verdict.UNSTABLE, absent, uniqueness)
    answers = [a for a in (_verify_solution(system, s) for s in every.solutions) if a is not None]
    if not answers:  # singular solutions that do not balance the load to the accuracy of k(S)
        if flipped is not None:
            return _make_status(system, Verdict.CONSISTENT, flipped, (), uniqueness)
        return _make_failure(system, Verdict.NOT_FOUND, None, uniqueness)
    # stable statuses first, and among these the one found by flipping
    answers.sort(key=lambda a: (_stability_rank(a), not _same_rates(a, flipped)))
    verdict, first, others = _verdict(system, problem, answers), answers[0], answers[1:]
    if _same_rates(first, flipped):
        first = flipped._replace(stable=first.stable)
    elif verdict is Verdict.SINGULAR and flipped is not None and not any(_same_rates(a, flipped) for a in answers):
        first, others = flipped, answers  # between the ends of a face: contacts that slid keep sliding
    return _make_status(system, verdict, first, others, uniqueness)


def _recompute_rates(system: StatusSolver, slides: np.ndarray):
    """Return Ṽ of a status and its error bound, computed from k(S) itself; None if the status is not consistent."""
    try:
        system.factorise(slides)
        velocity, rate = system.rates(slides)
    except LinAlgError:
        # undecided: the verification that follows rejects the status
        return np.full(len(slides), np.nan), np.zeros(len(slides))
    slack = sign_slack(rate, system.round_off(velocity))
    return None if inconsistent(slides, rate, slack).any() else (rate, slack)


def _verify_solution(system: StatusSolver, solution: Solution) -> VerifiedStatus | None:
    """Verify a solution of the complementarity problem with k(S); return None if this fails."""
    stable = {1: True, -1: False}.get(solution.sign)
    if solution.sign:
        answer = _verify(system, solution.slides, "enumeration")
        return answer and answer._replace(stable=stable)
    try:
        velocity, rate = system.rates_for_slip(solution.slides, solution.slip)
    except LinAlgError:
        return None
    slack = np.minimum(BLUR * solution.error, ALIKE * np.abs(rate).max(initial=0.0))
    if not _is_consistent(system, solution.slides, velocity, rate, slack):
        return None
    return VerifiedStatus(solution.slides, velocity, rate, "enumeration")


def _stability_rank(answer: VerifiedStatus) -> int:
    return {True: 0, None: 1, False: 2}[answer.stable]


def _same_rates(answer: VerifiedStatus, other: VerifiedStatus | None) -> bool:
    """Return True if both statuses have the same rates; a contact on a boundary may have either status."""
    if other is None:
        return False
    return bool(np.abs(answer.rate - other.rate).max(initial=0.0) <= ALIKE * np.abs(other.rate).max(initial=0.0))


def _verdict(system: StatusSolver, problem: Complementarity, answers: list[VerifiedStatus]) -> Verdict:
    """Return the verdict on all consistent statuses, which are listed best first.

    Two statuses have the same forces if A is singular on the union of their sliding contacts. A small difference in
    the forces alone is not conclusive, since it may be due to a weak contact.
    """
    if answers[0].stable is False:
        return Verdict.NEGATIVE
    if len(answers) == 1:
        return Verdict.UNIQUE
    here, slides = scale_problem(problem), answers[0].slides
    if any(is_regular(here, np.flatnonzero(slides | other.slides)) for other in answers[1:]):
        return Verdict.NOT_UNIQUE
    forces = [force_rates(system.matrix, _expand_status(system, a.slides), a.velocity) for a in answers]
    limit = SAME * max(np.abs(f).max() for f in forces)
    alike = all(np.abs(f - forces[0]).max() <= limit for f in forces)
    return Verdict.SINGULAR if alike else Verdict.NOT_UNIQUE


def _search_many(
    system: StatusSolver, problem: Complementarity, flipped: VerifiedStatus | None, unique: bool
) -> ContactStatus:
    """Try one algorithm after the other until a stable status is found; absence is reported only with a proof."""
    uniqueness = certificate(problem) if unique else None
    answers = _try_algorithms(system, problem, flipped)
    if answers:
        verdict = _verdict(system, problem, answers)
        if verdict is Verdict.UNIQUE and not (uniqueness and uniqueness.unique):
            verdict = Verdict.CONSISTENT
        return _make_status(system, verdict, answers[0], answers[1:], uniqueness)
    absent = farkas(problem)
    if absent is None:
        return _make_failure(system, Verdict.NOT_FOUND, None, uniqueness)
    ray = farkas_ray(problem, absent)
    motion = ray and motion_of_ray(system, ray)
    return _make_failure(system, Verdict.MECHANISM if motion else Verdict.UNSTABLE, motion or absent, uniqueness)


def _try_algorithms(
    system: StatusSolver, problem: Complementarity, flipped: VerifiedStatus | None
) -> list[VerifiedStatus]:
    """Return the statuses found by flipping, pivoting and Lemke's algorithm, up to the first stable one; best first."""
    here, answers = scale_problem(problem), []
    for answer in _candidates(system, problem, flipped):
        if answer is None or any(_same_rates(answer, other) for other in answers):
            continue
        sign = sign_of_minor(here, np.flatnonzero(answer.slides))
        answers.append(answer._replace(stable={1: True, -1: False}.get(sign)))
        if sign > 0:
            break
    return sorted(answers, key=_stability_rank)


def _candidates(system: StatusSolver, problem: Complementarity, flipped: VerifiedStatus | None):
    """Yield the status that each algorithm finds in turn, or None if it finds none."""
    yield flipped
    slides, pivots = principal_pivoting(problem) if may_be_p_matrix(problem) else (None, 0)
    system.solves += pivots
    yield _verify(system, slides, "principal pivoting")
    slip = lemke(problem)
    system.solves += len(problem.vector)
    yield None if slip is None else _verify(system, slip > 0, "Lemke")
