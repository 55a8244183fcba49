"""Which critical contacts slide: the principle of minimum sliding as a linear complementarity problem.

With k(S) = k₀ − H_S G_Sᵀ, columns h = K_t s c e_t and g = c (m e_n + s e_t), s = sgn D_t, the velocities under a load
rate b obey k(S) v = b. A critical contact that sticks leaves Coulomb's cone at the rate Ṽ = gᵀ v; one that slides does
so at the slip rate λ = Ṽ. Each does what it must: with w = (dF̃/dt)/K_t,

    w = A λ + q ≥ 0,   λ ≥ 0,   wᵀ λ = 0,      A = 1 − Gᵀ k₀⁻¹ H,   q = −Gᵀ k₀⁻¹ b.

The status is unique for every load if and only if A is a P-matrix, det A_SS = det k(S)/det k₀ > 0 for all S.

A status with det k(S)/det k₀ < 0 is unstable whatever masses and dashpots are: det(m z² + γ z + k) has a root z > 0.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. IV, where it is proved under a stronger
premise; Cottle, Pang, Stone, The Linear Complementarity Problem (Academic Press 1992), for the algebra.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ..core.readable import readable
from ..solve.linear import one_thread
from .absence import Absence, Motion, driven, farkas, loose, ray_of
from .enumeration import BLUR, MAPPED, Solution, solved
from .lcp import Complementarity, lemke, numbers, of_system, pivoted, scaled, slack_of, wrong
from .matrices import LinearSystem, force_rates
from .system import System, pins, unheld
from .uniqueness import Uniqueness, certificate, may_be_p, regular, sign_of_minor

ROUNDS = 60  # of flipping all that is inconsistent, before pivoting begins
ALIKE = 1e-6  # share of the largest rate up to which two statuses have the same rates
SAME = 1e-7  # share of the largest force rate up to which forces of two statuses are the same: half the digits


class Verdict(Enum):
    """How the search for a status ended; each value is a sentence."""

    CONSISTENT = (
        "every critical contact slides if, and only if, it would leave Coulomb's cone otherwise; other statuses were "
        "not looked for"
    )
    UNIQUE = "this status, and no other one, is consistent under this load"
    NOT_UNIQUE = (
        "several statuses are consistent under this load: what happens is not determined by it; `others` has the rest"
    )
    SINGULAR = (
        "several slip rates give the same forces: forces are determined, the motion of a grain that slides at all of "
        "its contacts is not; `others` has the rest"
    )
    NEGATIVE = "the consistent status has det k < 0: the packing loses its stability here; load it in another way"
    UNSTABLE = "no status is consistent, which is proven: the packing loses its stability here; follow it by dynamics"
    NO_PROGRESS = (
        "200 events followed one another without progress of the load: the path does not know how to go on; follow it "
        "by dynamics"
    )
    MECHANISM = (
        "the load drives a motion that nothing resists, and no status balances it: the packing collapses; balance the "
        "load, or follow it by dynamics"
    )
    NOT_FOUND = (
        "no consistent status was found (not proven absent): begin with another `start`, or with fewer critical "
        "contacts"
    )


class Alternative(NamedTuple):
    """Another consistent status under the same load."""

    sliding: np.ndarray  # (M,) bool
    velocity: np.ndarray  # (n,)
    rate: np.ndarray  # (Mc,) Ṽ
    stable: bool | None


@readable
class ContactStatus(NamedTuple):
    """The status of all contacts under a load rate, what moves, and what the verdict rests on."""

    verdict: Verdict
    sliding: np.ndarray  # (M,) bool
    critical: np.ndarray  # (Mc,) numbers of the contacts that may slide
    velocity: np.ndarray  # (n,) dq/d(load)
    rate: np.ndarray  # (Mc,) Ṽ: slip rate of what slides, and how fast the others move away from the cone if negative
    method: str  # what found it: "flip all", "principal pivoting", "Lemke" or "enumeration"
    solves: int  # factorisations and pivots
    stable: bool | None = None  # det k(S) has the sign of det k₀; None if it is zero to round-off, or not computed
    others: tuple[Alternative, ...] = ()  # as far as they were looked for
    uniqueness: Uniqueness | None = None  # under every load, if that was asked for
    proof: Absence | Motion | None = None  # why no status is consistent, or the motion that the load drives
    marginal: np.ndarray | None = None  # (Mc,) bool: neither slips nor leaves the cone, may have either status

    @property
    def ok(self) -> bool:
        """True if a consistent status was found that is not known to be unstable."""
        return self.verdict in (Verdict.CONSISTENT, Verdict.UNIQUE, Verdict.NOT_UNIQUE, Verdict.SINGULAR)


class Answer(NamedTuple):
    """A status whose velocities balance the load."""

    slides: np.ndarray  # (Mc,) bool
    velocity: np.ndarray
    rate: np.ndarray
    method: str
    stable: bool | None = None


def contact_status(
    matrix: LinearSystem, load: np.ndarray, *, critical: np.ndarray | None = None, start: np.ndarray | None = None,
    geometric: bool = True, unique: bool | None = None,
) -> ContactStatus:  # fmt: skip
    """The status by the principle of minimum sliding: what slides is what would leave Coulomb's cone otherwise.

    All inconsistent contacts are flipped at once, which nearly always ends after a few rounds; a cycle hands over to
    principal pivoting of one contact at a time (if A may be a P-matrix), and that to Lemke's algorithm. Whatever found
    it, the status is verified contact by contact with a factor of k(S) itself. Up to 14 critical contacts all statuses
    are gone through unless A is a P-matrix: stable ones come first, and "none" is proven. Beyond, "none" needs a
    certificate of Farkas.

    Parameters
    ----------
    load : (n,) rate of the external load on the free coordinates [force/time]
    critical : numbers of the contacts that are at Coulomb's limit; default: those of `matrix.limit`
    start : (M,) bool, a status to begin with, such as that of the last step; default: all critical contacts slide
    geometric : whether the forces turn with the contacts
    unique : whether stability and uniqueness of what is found are looked at; default: up to 14 critical contacts

    Returns
    -------
    Choice
    """
    system = System(matrix, load, numbers(matrix, critical), geometric)
    if start is not None and np.shape(start) != (matrix.count,):
        raise ValueError(
            f"start has the shape {np.shape(start)}: give one bool for each of the {matrix.count} contacts"
        )
    slides = np.ones(len(system.critical), bool) if start is None else np.asarray(start, bool)[system.critical]
    if unheld(matrix, system.load):
        return _nothing(matrix, system, Verdict.MECHANISM, _carried_off(matrix, system))
    unique = len(slides) <= MAPPED if unique is None else unique
    with one_thread():
        return _searched(matrix, system, slides, unique) or _without_idle_motions(
            matrix, system, slides, unique, geometric
        )


def _searched(matrix: LinearSystem, system: System, slides: np.ndarray, unique: bool) -> ContactStatus | None:
    """The choice, or None if k₀ is singular."""
    found = _flipped(system, slides)
    if found is not None and not unique:
        return _choice(matrix, system, Verdict.CONSISTENT, found)
    try:
        problem = of_system(system)
    except LinAlgError:
        return None
    if len(slides) <= MAPPED:
        return _among_few(matrix, system, problem, found)
    return _among_many(matrix, system, problem, found, unique)


def _without_idle_motions(
    matrix: LinearSystem, system: System, slides: np.ndarray, unique: bool, geometric
) -> ContactStatus:
    """The choice where k₀ is singular: its null motions are held still, if the load does not drive them."""
    idle = loose(system)
    if idle is not None and idle.motion is not None:
        return _nothing(matrix, system, Verdict.MECHANISM, idle.motion)
    if idle is not None:
        held = System(matrix, system.load, system.critical, geometric, idle.coordinates)
        choice = _searched(matrix, held, slides, unique)
        if choice is not None:
            return choice
    found = _flipped(system, slides)
    return _nothing(matrix, system, Verdict.NOT_FOUND) if found is None else _choice(
        matrix, system, Verdict.CONSISTENT, found
    )  # fmt: skip


def _carried_off(matrix: LinearSystem, system: System) -> Motion:
    """The translation of everything along which nothing holds the load."""
    move = np.zeros(len(system.load))
    for pin in pins(matrix):
        along = matrix.free.axis == matrix.free.axis[pin]
        move[along] = system.load[along].sum()
    move /= np.linalg.norm(move)
    power = float(move @ system.load) / np.linalg.norm(system.load)
    return Motion(move, move, power, np.zeros(len(system.critical), bool))


def _choice(
    matrix: LinearSystem, system: System, verdict: Verdict, answer: Answer, others=(), known=None
) -> ContactStatus:
    marginal = np.abs(answer.rate) <= slack_of(answer.rate, system.blur(answer.velocity))
    also = tuple(Alternative(_of_all(matrix, system, a.slides), a.velocity, a.rate, a.stable) for a in others)
    return ContactStatus(
        verdict, _of_all(matrix, system, answer.slides), system.critical, answer.velocity, answer.rate, answer.method,
        system.solves, answer.stable, also, known, None, marginal,
    )  # fmt: skip


def _nothing(matrix: LinearSystem, system: System, verdict: Verdict, proof=None, known=None) -> ContactStatus:
    unknown = np.full(len(system.critical), np.nan)
    return ContactStatus(
        verdict, np.zeros(matrix.count, bool), system.critical, np.full(len(system.load), np.nan), unknown, "",
        system.solves, None, (), known, proof,
    )  # fmt: skip


def _of_all(matrix: LinearSystem, system: System, slides: np.ndarray) -> np.ndarray:
    """(M,) bool from a status of the critical contacts."""
    sliding = np.zeros(matrix.count, bool)
    sliding[system.critical] = slides
    return sliding


def _verified(system: System, slides: np.ndarray | None, method: str) -> Answer | None:
    """A status with its velocities, by a factor of its own, if it is consistent and balances the load."""
    if slides is None:
        return None
    try:
        if system.factored is None or not np.array_equal(system.factored, slides):
            system.renew(slides)
        velocity, rate = system.rates(slides)
    except LinAlgError:
        return None
    if not _consistent(system, slides, velocity, rate):
        return None
    return Answer(slides, velocity, rate, method)


def _consistent(system: System, slides: np.ndarray, velocity: np.ndarray, rate: np.ndarray, slack=0.0) -> bool:
    """True if every contact does what it must; False if a rate is not a number."""
    slack = np.maximum(slack, system.blur(velocity))
    return bool(np.isfinite(rate).all()) and not wrong(slides, rate, slack).any()


def _flipped(system: System, slides: np.ndarray) -> Answer | None:
    """The status to which flipping all inconsistent contacts leads, or None if it goes round in circles.

    Where k(S) is singular, all contacts stick in the next round: a status on the way need not be one that can be.
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
        bad = wrong(slides, rate, system.blur(velocity))
        if not bad.any():
            return _verified(system, slides, "flip all")
        slides = slides ^ bad
    return None


def _among_few(matrix: LinearSystem, system: System, problem: Complementarity, found: Answer | None) -> ContactStatus:
    """The choice of which all statuses are known, or of a P-matrix."""
    known = certificate(problem)
    if known.unique:
        found = found or _verified(system, pivoted(problem)[0], "principal pivoting")
        if found is not None:
            return _choice(matrix, system, Verdict.UNIQUE, found._replace(stable=True), (), known)
    every = solved(problem, lambda slides: _rates_again(system, slides))
    if not every.solutions:
        for ray in every.rays:
            motion = driven(system, ray) if ray.drive else None
            if motion is not None:
                return _nothing(matrix, system, Verdict.MECHANISM, motion, known)
        absent = Absence("enumeration", 1 << len(problem.vector))
        return _nothing(matrix, system, Verdict.UNSTABLE, absent, known)
    answers = [a for a in (_answer(system, s) for s in every.solutions) if a is not None]
    if not answers:
        return _nothing(matrix, system, Verdict.NOT_FOUND, None, known)
    # stable ones first, and of these the one that flipping led to
    answers.sort(key=lambda a: (_rank(a), not _agrees(a, found)))
    verdict, first, others = _verdict(matrix, system, problem, answers), answers[0], answers[1:]
    if _agrees(first, found):
        first = found._replace(stable=first.stable)
    elif verdict is Verdict.SINGULAR and found is not None and not any(_agrees(a, found) for a in answers):
        first, others = found, answers  # between the ends: what slid before goes on to do so
    return _choice(matrix, system, verdict, first, others, known)


def _rates_again(system: System, slides: np.ndarray):
    """Ṽ of a status, with k(S) itself, and its error bound; None if it is not consistent."""
    try:
        system.renew(slides)
        velocity, rate = system.rates(slides)
    except LinAlgError:
        return np.full(len(slides), np.nan), np.zeros(len(slides))  # not decided: what follows does not verify it
    slack = slack_of(rate, system.blur(velocity))
    return None if wrong(slides, rate, slack).any() else (rate, slack)


def _answer(system: System, solution: Solution) -> Answer | None:
    """A solution of the complementarity problem, verified with k(S)."""
    stable = {1: True, -1: False}.get(solution.sign)
    if solution.sign:
        answer = _verified(system, solution.slides, "enumeration")
        return answer and answer._replace(stable=stable)
    try:
        velocity, rate = system.moved(solution.slides, solution.slip)
    except LinAlgError:
        return None
    slack = np.minimum(BLUR * solution.doubt, ALIKE * np.abs(rate).max(initial=0.0))
    if not _consistent(system, solution.slides, velocity, rate, slack):
        return None
    return Answer(solution.slides, velocity, rate, "enumeration")


def _rank(answer: Answer) -> int:
    return {True: 0, None: 1, False: 2}[answer.stable]


def _agrees(answer: Answer, found: Answer | None) -> bool:
    """True if both have the same rates; a contact on an edge may have either status."""
    if found is None:
        return False
    return bool(np.abs(answer.rate - found.rate).max(initial=0.0) <= ALIKE * np.abs(found.rate).max(initial=0.0))


def _verdict(matrix: LinearSystem, system: System, problem: Complementarity, answers: list[Answer]) -> Verdict:
    """The verdict on all consistent statuses, the best one first.

    Answers are the same in forces if what slides in one or the other makes A singular; forces that differ by little do
    not tell, since a weak contact may have them.
    """
    if answers[0].stable is False:
        return Verdict.NEGATIVE
    if len(answers) == 1:
        return Verdict.UNIQUE
    here, slides = scaled(problem), answers[0].slides
    if any(regular(here, np.flatnonzero(slides | other.slides)) for other in answers[1:]):
        return Verdict.NOT_UNIQUE
    forces = [force_rates(matrix, _of_all(matrix, system, a.slides), a.velocity) for a in answers]
    limit = SAME * max(np.abs(f).max() for f in forces)
    alike = all(np.abs(f - forces[0]).max() <= limit for f in forces)
    return Verdict.SINGULAR if alike else Verdict.NOT_UNIQUE


def _among_many(
    matrix: LinearSystem, system: System, problem: Complementarity, found: Answer | None, unique: bool
) -> ContactStatus:
    """The choice by one algorithm after the other until a stable status is found; "none" only with a certificate."""
    known = certificate(problem) if unique else None
    answers = _one_after_the_other(system, problem, found)
    if answers:
        verdict = _verdict(matrix, system, problem, answers)
        if verdict is Verdict.UNIQUE and not (known and known.unique):
            verdict = Verdict.CONSISTENT
        return _choice(matrix, system, verdict, answers[0], answers[1:], known)
    absent = farkas(problem)
    if absent is None:
        return _nothing(matrix, system, Verdict.NOT_FOUND, None, known)
    ray = ray_of(problem, absent)
    motion = ray and driven(system, ray)
    return _nothing(matrix, system, Verdict.MECHANISM if motion else Verdict.UNSTABLE, motion or absent, known)


def _one_after_the_other(system: System, problem: Complementarity, found: Answer | None) -> list[Answer]:
    """What flipping, pivoting and Lemke's algorithm find, until it is stable; the best one first."""
    here, answers = scaled(problem), []
    for way in (lambda: found, lambda: _by_pivoting(system, problem), lambda: _by_lemke(system, problem)):
        answer = way()
        if answer is None or any(_agrees(answer, other) for other in answers):
            continue
        sign = sign_of_minor(here, np.flatnonzero(answer.slides))
        answers.append(answer._replace(stable={1: True, -1: False}.get(sign)))
        if sign > 0:
            break
    return sorted(answers, key=_rank)


def _by_pivoting(system: System, problem: Complementarity) -> Answer | None:
    slides, pivots = pivoted(problem) if may_be_p(problem) else (None, 0)
    system.solves += pivots
    return _verified(system, slides, "principal pivoting")


def _by_lemke(system: System, problem: Complementarity) -> Answer | None:
    slip = lemke(problem)
    system.solves += len(problem.vector)
    return None if slip is None else _verified(system, slip > 0, "Lemke")
