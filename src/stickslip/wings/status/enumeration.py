"""Enumeration of the statuses of a few critical contacts: solutions of the complementarity problem, and rays.

A status is regular if A_SS has full rank to within the errors in its entries; it then has exactly one solution. A
singular status may have no solution, or a whole face of solutions, whose ends are returned. Rays are motions that need
no load.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from ...kit import checked, readable
from .lcp import Complementarity, ScaledProblem, scale_problem

MAPPED = 14  # contacts up to which all statuses are enumerated: 16,384
AT_ONCE = 2048  # statuses solved together; more do not fit into the cache
SURE = 0.1  # largest errors of the entries of A_SS, over those that would make it singular
SAME = 1e-6  # share of the largest rate up to which two solutions are the same: half of the digits
BLUR = 10.0  # factor on the error bounds for null vectors and quantities derived from them


class AllStatusRates(NamedTuple):
    """Rates of every status, in the order of its bits and in the units of `ScaledProblem`."""

    slides: np.ndarray  # (2^Mc, Mc) bool
    rate: np.ndarray  # (2^Mc, Mc) Ṽ: λ of sliding contacts, −w of the others
    error: np.ndarray  # (2^Mc, Mc) error bound of Ṽ
    sign: np.ndarray  # (2^Mc,) of det A_SS; 0 where it is singular to round-off
    minor: np.ndarray  # (2^Mc,) det A_SS

    @property
    def consistent(self) -> np.ndarray:
        """Indices of the regular statuses that are consistent, to within the error bounds."""
        good = np.where(self.slides, self.rate >= -self.error, self.rate <= self.error).all(axis=1)
        return np.flatnonzero(good & (self.sign != 0))


class Solution(NamedTuple):
    """Solution of the complementarity problem."""

    slides: np.ndarray  # (Mc,) bool
    slip: np.ndarray  # (Mc,) λ
    rate: np.ndarray  # (Mc,) Ṽ
    error: np.ndarray  # (Mc,) error bound of Ṽ
    sign: int  # of det A_SS = det k(S)/det k₀; 0 if singular to round-off


class Ray(NamedTuple):
    """Slip rates x ≥ 0 of a singular status without load: A_SS x = 0, and no contact leaves the cone."""

    slides: np.ndarray  # (Mc,) bool
    slip: np.ndarray  # (Mc,) x
    left: np.ndarray  # (Mc,) y with yᵀA = 0 on the sliding contacts
    drive: float  # yᵀq: not zero if the load drives the motion


class AllSolutions(NamedTuple):
    """All distinct solutions and rays of a complementarity problem; each end of a face is a solution."""

    solutions: tuple[Solution, ...]
    rays: tuple[Ray, ...]


def enumerate_rates(problem: ScaledProblem) -> AllStatusRates:
    """Compute the rates of all statuses with error bounds, for at most 14 critical contacts."""
    size = len(problem.vector)
    slides = (np.arange(1 << size)[:, None] >> np.arange(size)) & 1 > 0
    rate, error = np.zeros(slides.shape), np.full(slides.shape, np.inf)
    sign, minor, count = np.zeros(len(slides), int), np.zeros(len(slides)), slides.sum(axis=1)
    for k in range(size + 1):
        alike = np.flatnonzero(count == k)
        for begin in range(0, len(alike), AT_ONCE):
            part = alike[begin : begin + AT_ONCE]
            rate[part], error[part], sign[part], minor[part] = _solve_statuses(problem, slides[part], k)
    return AllStatusRates(slides, rate, error, sign, minor)


def _solve_statuses(problem: ScaledProblem, slides: np.ndarray, k: int):
    """Ṽ with error bounds, and sign and value of the minor, for statuses with k sliding contacts each."""
    chosen = np.nonzero(slides)[1].reshape(len(slides), k)
    square = (chosen[:, :, None], chosen[:, None, :])
    a, error, q = problem.matrix[square], problem.error[square], problem.vector[chosen]
    sign, size = np.linalg.slogdet(a)
    a = np.where((sign == 0)[:, None, None], np.eye(k), a)
    inverse = np.linalg.inv(a)
    # A_SS stays regular for all changes E of its entries with a largest row sum of |A_SS⁻¹| |E| below 1
    blurred = (np.abs(inverse) @ error).sum(axis=2).max(axis=1, initial=0.0)
    slip = -_batched_matvec(inverse, q)
    slip -= _batched_matvec(inverse, _batched_matvec(a, slip) + q)
    slip_error = _batched_matvec(np.abs(inverse), _batched_matvec(error, np.abs(slip)) + problem.vector_error[chosen])
    whole, whole_error = np.zeros(slides.shape), np.zeros(slides.shape)
    np.put_along_axis(whole, chosen, slip, axis=1)
    np.put_along_axis(whole_error, chosen, slip_error, axis=1)
    gap = whole @ problem.matrix.T + problem.vector
    gap_error = np.abs(whole) @ problem.error.T + whole_error @ np.abs(problem.matrix).T + problem.vector_error
    sure = np.where(blurred < SURE, sign, 0).astype(int)
    return np.where(slides, whole, -gap), np.where(slides, whole_error, gap_error), sure, sign * np.exp(size)


def _batched_matvec(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(m, k) products of (m, k, k) matrices and (m, k) vectors."""
    return np.einsum("mij,mj->mi", matrices, vectors)


def enumerate_solutions(problem: Complementarity, again: Callable | None = None) -> AllSolutions:
    """Find all solutions and rays, for at most 14 critical contacts.

    Of several statuses with the same rates (a contact is then on a boundary), only one is returned, preferably one with
    det A_SS > 0.

    Parameters
    ----------
    again : called as again(slides) for statuses that are consistent only to within the error bounds; returns (Ṽ, error
        bound) from more accurate data than A, or None if these show that the status is not consistent
    """
    here = scale_problem(problem)
    through = enumerate_rates(here)
    solutions, rays = [], []
    for number in through.consistent:
        solution = _make_solution(here, through, number)
        if again is not None and (np.abs(solution.rate) <= solution.error).any():
            solution = _replace_rates(solution, again(solution.slides))
        solutions += [] if solution is None else [solution]
    for number in np.flatnonzero(through.sign == 0):
        face = _solution_face(here, through.slides[number])
        solutions += [_solution_in_units(here, end) for end in _face_ends(face)]
        rays += [_ray_in_units(here, ray) for ray in _find_rays(here, face)]
    kept = []
    for solution in sorted(solutions, key=lambda s: {1: 0, -1: 1, 0: 2}[s.sign]):
        if not any(_same_rates(solution, other) for other in kept):
            kept.append(solution)
    return AllSolutions(tuple(kept), tuple(rays))


def _make_solution(problem: ScaledProblem, through: AllStatusRates, number: int) -> Solution:
    slides, rate = through.slides[number], through.rate[number]
    slip = np.where(slides, rate, 0.0)
    return _solution_in_units(problem, Solution(slides, slip, rate, through.error[number], int(through.sign[number])))


def _replace_rates(solution: Solution, better: tuple[np.ndarray, np.ndarray] | None) -> Solution | None:
    """Solution with more accurate rates, or None if these show that it is not consistent."""
    if better is None:
        return None
    rate, error = better
    return solution._replace(rate=rate, error=error, slip=np.where(solution.slides, rate, 0.0))


def _same_rates(solution: Solution, other: Solution) -> bool:
    largest = max(np.abs(solution.rate).max(initial=0.0), np.abs(other.rate).max(initial=0.0))
    return bool((np.abs(solution.rate - other.rate) <= BLUR * (solution.error + other.error) + SAME * largest).all())


def _solution_in_units(problem: ScaledProblem, end: Solution) -> Solution:
    unit = np.where(end.slides, problem.slip_unit, problem.gap_unit)
    return end._replace(slip=problem.slip_unit * end.slip, rate=unit * end.rate, error=unit * end.error)


def _ray_in_units(problem: ScaledProblem, ray: Ray) -> Ray:
    left = ray.left / problem.gap_unit
    return ray._replace(slip=problem.slip_unit * ray.slip, left=left, drive=ray.drive)


class SolutionFace(NamedTuple):
    """Quantities at + turn t ≥ 0 on the null space of a singular status: λ of the sliding contacts, w of the others."""

    slides: np.ndarray  # (Mc,) bool
    at: np.ndarray  # (Mc,)
    turn: np.ndarray  # (Mc, d)
    left: np.ndarray  # (k, d) left null vectors of A_SS
    missed: np.ndarray  # (d,) their products with q; if not zero, no slip rates balance the load
    at_error: np.ndarray  # (Mc,) error bounds of `at`, of `turn` and of `missed`
    turn_error: np.ndarray
    missed_error: np.ndarray


def _solution_face(problem: ScaledProblem, slides: np.ndarray) -> SolutionFace:
    a, error, q = problem.matrix[:, slides], problem.error[:, slides], problem.vector
    left, values, right = np.linalg.svd(a[slides])
    null = values <= max(BLUR * len(values) * np.linalg.norm(error[slides]), values[-1])
    inverse = (right[~null].T / values[~null]) @ left[:, ~null].T
    left, right = left[:, null], right[null].T
    slip = -inverse @ q[slides]
    at = np.where(slides, 0.0, a @ slip + q)
    turn = np.where(slides[:, None], 0.0, a @ right)
    at[slides], turn[slides] = slip, right
    # errors of null vectors are those of A over the next singular value
    spread = BLUR * max(1.0, np.linalg.norm(inverse))
    at_error = spread * (error @ np.abs(slip) + problem.vector_error + error.max())
    missed_error = BLUR * np.abs(left.T) @ problem.vector_error[slides]
    missed_error += spread * np.linalg.norm(error[slides]) * np.linalg.norm(q[slides])
    turn_error = spread * (error.sum(axis=1) + error.max())
    return SolutionFace(slides, at, turn, left, np.abs(left.T @ q[slides]), at_error, turn_error, missed_error)


def _face_ends(face: SolutionFace) -> list[Solution]:
    """Ends of the solution set {t: at + turn t ≥ 0}, or none; an end at infinity is replaced by a finite point."""
    still = (np.abs(face.turn) <= face.turn_error[:, None]).all(axis=1)
    if (face.missed > face.missed_error).any() or (face.at[still] < -face.at_error[still]).any():
        return []
    at, turn, slack = face.at[~still], face.turn[~still], face.at_error[~still]
    if not len(turn):
        places = [np.zeros(turn.shape[1])]
    elif turn.shape[1] == 1:
        places = _interval_ends(at, turn[:, 0], slack)
    else:
        aim, places = turn.sum(axis=0), []
        for way in (1.0, -1.0, 0.0):
            program = linprog(way * aim, A_ub=-turn, b_ub=at + slack, bounds=(None, None))
            places += [program.x] if program.status == 0 else []
    ends = []
    for place in places:
        rate = face.at + face.turn @ place
        slip = np.where(face.slides, rate, 0.0)
        ends.append(Solution(face.slides, slip, np.where(face.slides, rate, -rate), face.at_error, 0))
    return ends


def _interval_ends(at: np.ndarray, turn: np.ndarray, slack: np.ndarray) -> list[np.ndarray]:
    """Both ends of {t: at + turn t ≥ 0}; empty if there is no solution even with at + slack."""
    bound, give, rising = -at / turn, slack / np.abs(turn), turn > 0
    if np.max((bound - give)[rising], initial=-np.inf) > np.min((bound + give)[~rising], initial=np.inf):
        return []
    far = 1.0 + np.abs(bound).max()
    low = np.max(bound[rising], initial=-np.inf) if rising.any() else bound.min() - far
    high = np.min(bound[~rising], initial=np.inf) if (~rising).any() else low + far
    return [np.array([low]), np.array([high])]


def _find_rays(problem: ScaledProblem, face: SolutionFace) -> list[Ray]:
    """Nonnegative slip rates of the null space for which no contact leaves the cone."""
    turn, slides = face.turn, face.slides
    if turn.shape[1] == 1:
        ways = [np.array([1.0]), np.array([-1.0])]
    else:
        total = turn[slides].sum(axis=0)
        bound = np.append(face.turn_error, 1.0)
        program = linprog(-total, A_ub=np.vstack([-turn, total]), b_ub=bound, bounds=(None, None))
        ways = [program.x] if program.status == 0 and program.fun < -0.5 else []
    rays = []
    for move in (turn @ way for way in ways):
        if (move >= -face.turn_error).all() and move[slides].max(initial=0.0) > 0:
            y = np.zeros(len(slides))
            y[slides] = face.left @ (face.left.T @ problem.vector[slides])
            driven = (face.missed > face.missed_error).any()
            slip = np.where(slides, np.maximum(move, 0.0), 0.0)
            rays.append(Ray(slides, slip, y, float(y @ problem.vector) if driven else 0.0))
    return rays


@readable
class StatusMap(NamedTuple):
    """Map C: S ↦ C(S). Bits of S mark the critical contacts that slide; bits of C(S) mark those that are consistent."""

    image: np.ndarray  # (2^Mc,) C(S) for S = 0 … 2^Mc − 1; −1 where k(S) is singular

    @property
    def bijective(self) -> bool:
        """True if every pattern of consistency belongs to exactly one status."""
        return len(np.unique(self.image)) == len(self.image) and self.image.min() >= 0

    @property
    def consistent(self) -> np.ndarray:
        """All globally consistent statuses."""
        return np.flatnonzero(self.image == len(self.image) - 1)


@checked
def status_map(problem: Complementarity) -> StatusMap:
    """Compute the map of the paper's Eq. 5 for all statuses, for at most 14 critical contacts."""
    size = len(problem.vector)
    if size > MAPPED:
        raise ValueError(
            f"{size} critical contacts were given, {2.0**size:.3g} combinations of statuses: at most {MAPPED} "
            f"are allowed; `contact_status` finds a consistent status, `certificate` tests uniqueness"
        )
    through = enumerate_rates(scale_problem(problem))
    fits = np.where(through.slides, through.rate > 0, through.rate < 0)
    return StatusMap(np.where(through.sign == 0, -1, fits @ (1 << np.arange(size))))
