"""Complementarity problem of critical contacts, those at the Coulomb limit: error bounds, two solvers, enumeration.

    w = A λ + q ≥ 0,   λ ≥ 0,   wᵀ λ = 0,      A = 1 − Gᵀ k₀⁻¹ H,   q = −Gᵀ k₀⁻¹ b.

Decisions on signs and ranks allow for the round-off of A and q, and are made in units in which the entries of A and q
are about 1. Rows and columns are scaled by powers of two, which changes neither the sign of a minor nor any status.

For few contacts, all statuses are enumerated. A status is regular if A_SS has full rank to within the errors of its
entries; it then has exactly one solution. A singular status may have no solution, or a face of solutions, whose ends
are returned. Rays are motions that require no load.

Source: Cottle, Pang, Stone, The Linear Complementarity Problem (Academic Press 1992); Ruiz, RAL-TR-2001-034, for the
scaling.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from ...kit import Numbers, checked, one_thread, readable
from .matrices import LinearSystem
from .system import StatusSolver

SLACK = 1e-9  # fraction of the largest rate below which a rate may have either sign
ROUND_OFF = 1e-14  # relative error of an entry: 45 units in the last place, as in sums of a few dozen terms
SPARE = 10.0  # safety factor on errors estimated from two right-hand sides
SWEEPS = 6  # scaling sweeps; each halves the logarithms of the largest entries


@readable
class Complementarity(NamedTuple):
    """w = A λ + q ≥ 0, λ ≥ 0, wᵀλ = 0 for the critical contacts."""

    MADE_BY = "quasirigid.complementarity"

    matrix: np.ndarray  # (Mc, Mc) A
    vector: np.ndarray  # (Mc,) q
    matrix_error: float = 0.0  # error of entries of A beyond their round-off, such as the error of solving with k₀
    vector_error: float = 0.0  # error of entries of q beyond their round-off


class ScaledProblem(NamedTuple):
    """Complementarity problem in units in which the largest entries of rows, columns and q are about 1."""

    matrix: np.ndarray  # (Mc, Mc)
    vector: np.ndarray  # (Mc,)
    error: np.ndarray  # (Mc, Mc) error bounds of the matrix
    vector_error: np.ndarray  # (Mc,) error bounds of the vector
    slip_unit: np.ndarray  # (Mc,) unit of λ
    gap_unit: np.ndarray  # (Mc,) unit of w

    def submatrix(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return A_SS, the rows and columns of A of the chosen contacts, with its error bounds."""
        box = np.ix_(chosen, chosen)
        return self.matrix[box], self.error[box]


@checked
def complementarity(
    matrix: LinearSystem, load: Numbers, *, critical: np.ndarray | None = None, geometric: bool = True
) -> Complementarity:
    """Compute A and q of the critical contacts under a load rate; arguments are those of `contact_status`.

    Raises
    ------
    LinAlgError
        If k is singular while all contacts stick.
    """
    with one_thread():
        try:
            return complementarity_of_system(StatusSolver(matrix, load, critical_numbers(matrix, critical), geometric))
        except np.linalg.LinAlgError as problem:
            raise np.linalg.LinAlgError(
                "the stiffness matrix is singular although all contacts stick: there are unresisted motions, as in a "
                "packing without friction or with loose grains; quasirigid.mechanisms lists them"
            ) from problem


def critical_numbers(matrix: LinearSystem, critical) -> np.ndarray:
    """Return the indices of the critical contacts, given as indices or as a mask; default: contacts at the limit."""
    if critical is None:
        return np.flatnonzero(matrix.limit)
    critical = np.asarray(critical)
    if critical.dtype == bool and critical.shape == (matrix.count,):
        return np.flatnonzero(critical)
    valid = critical.dtype.kind in "iu" or not critical.size
    if critical.dtype == bool or critical.ndim != 1 or not valid or len(np.unique(critical)) < len(critical):
        raise ValueError(
            f"critical must be distinct contact numbers, or one bool for each of the {matrix.count} contacts, got "
            f"{critical.tolist()!r:.60}"
        )
    if critical.size and not 0 <= critical.min() <= critical.max() < matrix.count:
        raise ValueError(
            f"contacts are numbered from 0 to {matrix.count - 1}, but critical has {critical.min()} to {critical.max()}"
        )
    return critical.astype(np.int64)


def complementarity_of_system(system: StatusSolver) -> Complementarity:
    """Return A and q with their errors, estimated by one step of refinement for two columns and for the load."""
    size = len(system.critical)
    stuck = np.zeros(size, bool)
    system.factorise(stuck)
    velocity, rate = system.rates(stuck)
    pull = system.pull.toarray(order="F")
    reach = system.solve_columns(pull)
    probes = np.stack([np.ones(size), np.where(np.arange(size) % 2, -1.0, 1.0)], axis=1)
    answers = np.column_stack([reach @ probes, system.answer])
    missed = np.column_stack([pull @ probes, system.right]) - system.stuck @ answers
    error = np.abs(system.sees.T @ system.solve_columns(missed))
    drawn = system.sees.T @ reach
    # the difference 1 − Gᵀ k₀⁻¹ H may be far smaller than either term
    lost = ROUND_OFF * np.abs(drawn).max(initial=1.0)
    matrix_error = SPARE * error[:, :2].max(initial=0.0) + lost
    vector_error = SPARE * error[:, 2].max(initial=0.0) + system.round_off(velocity).max(initial=0.0)
    return Complementarity(np.eye(size) - drawn, -rate, float(matrix_error), float(vector_error))


def scale_problem(problem: Complementarity) -> ScaledProblem:
    """Scale a problem so that its largest entries are about 1, with error bounds for all entries."""
    a, q = problem.matrix, problem.vector
    if not (np.isfinite(a).all() and np.isfinite(q).all()):
        raise ValueError("A or q is not finite: every entry must be a number; look for NaN in positions and forces")
    error = problem.matrix_error + ROUND_OFF * np.abs(a)
    # an entry that may be zero must not become the unit of a row or column
    nothing = np.abs(a) <= error
    a, error = np.where(nothing, 0.0, a), np.where(nothing, error + np.abs(a), error)
    rows, columns = np.ones(len(q)), np.ones(len(q))
    for _ in range(SWEEPS):
        now = rows[:, None] * np.abs(a) * columns
        across, down = now.max(axis=1, initial=0.0), now.max(axis=0, initial=0.0)
        rows, columns = rows / np.sqrt(np.where(across > 0, across, 1)), columns / np.sqrt(np.where(down > 0, down, 1))
    rows, columns = np.exp2(np.round(np.log2(rows))), np.exp2(np.round(np.log2(columns)))
    largest = np.abs(rows * q).max(initial=0.0)
    unit = np.exp2(np.round(np.log2(largest))) if largest else 1.0
    vector_error = problem.vector_error + ROUND_OFF * np.abs(q)
    return ScaledProblem(
        rows[:, None] * a * columns, rows * q / unit, rows[:, None] * error * columns, rows * vector_error / unit,
        columns * unit, unit / rows,
    )  # fmt: skip


def sign_slack(rate: np.ndarray, slack=0.0):
    """Magnitude below which a rate may have either sign: a fraction of the largest rate, at least `slack`."""
    return np.maximum(slack, SLACK * np.abs(rate).max(initial=0.0))


def inconsistent(slides: np.ndarray, rate: np.ndarray, slack=0.0) -> np.ndarray:
    """Return the mask of contacts with an inconsistent status; a rate near zero is consistent with either status."""
    slack = sign_slack(rate, slack)
    return np.where(slides, rate < -slack, rate > slack)


def principal_pivoting(problem: Complementarity) -> tuple[np.ndarray | None, int]:
    """Solve by Murty's principal pivoting, which flips the inconsistent contact with the highest index.

    Returns
    -------
    (Mc,) bool or None, int
        sliding contacts, and the number of pivots. For a P-matrix, no status occurs twice; if one does, None is
        returned.
    """
    size, seen = len(problem.vector), set()
    slides = np.zeros(size, bool)
    for pivots in range(20 * size + 20):
        rate = _rates_of_status(problem, slides)
        if rate is None or slides.tobytes() in seen:
            return None, pivots
        bad = np.flatnonzero(inconsistent(slides, rate))
        if not len(bad):
            return slides, pivots
        seen.add(slides.tobytes())
        slides[bad[-1]] ^= True
    return None, pivots


def _rates_of_status(problem: Complementarity, slides: np.ndarray) -> np.ndarray | None:
    """Return the rates Ṽ (λ or −w) of all critical contacts for a status, or None if the status is singular."""
    slip = np.zeros(len(slides))
    if slides.any():
        try:
            slip[slides] = np.linalg.solve(problem.matrix[np.ix_(slides, slides)], -problem.vector[slides])
        except np.linalg.LinAlgError:
            return None
    rate = np.where(slides, slip, -(problem.matrix @ slip + problem.vector))
    return rate if np.isfinite(rate).all() else None


def lemke(problem: Complementarity) -> np.ndarray | None:
    """Solve for λ by Lemke's algorithm with the covering vector 1; None if it ends on a ray.

    A ray proves nothing, as a solution may still exist. The algorithm uses the units of `ScaledProblem`, in which the
    size of a pivot is meaningful.
    """
    here = scale_problem(problem)
    size, q = len(here.vector), here.vector
    if not size or q.min() >= 0:
        return np.zeros(size)
    # columns: w, λ, the covering variable; w is basic at first
    table = np.hstack([np.eye(size), -here.matrix, -np.ones((size, 1)), q[:, None]])
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
            return here.slip_unit * slip[size : 2 * size]
        entering = leaving + size if leaving < size else leaving - size
        column = table[:, entering]
        able = column > 1e-11 * max(1.0, np.abs(column).max())  # round-off of entries near 1 after a few hundred pivots
        if not able.any():
            return None
        ratio = np.where(able, table[:, -1] / np.where(able, column, 1.0), np.inf)
        ties = np.flatnonzero(ratio <= ratio.min() * (1 + 1e-12) + 1e-300)
        if not len(ties):  # entries became NaN
            return None
        row = int(ties[np.argmax(basis[ties] == 2 * size)]) if (basis[ties] == 2 * size).any() else int(ties[0])
    return None


MAPPED = 14  # largest number of contacts for enumeration of all statuses (16,384)
AT_ONCE = 2048  # statuses solved together; more would not fit into the cache
SURE = 0.1  # largest ratio of the errors of A_SS to errors that would make it singular
SAME = 1e-6  # fraction of the largest rate within which two solutions count as equal: half of the digits
BLUR = 10.0  # factor on the error bounds for null vectors and quantities derived from them


class AllStatusRates(NamedTuple):
    """Rates for every status, ordered by the bits of the status, in the units of `ScaledProblem`."""

    slides: np.ndarray  # (2^Mc, Mc) bool
    rate: np.ndarray  # (2^Mc, Mc) Ṽ: λ of sliding contacts, −w of the others
    error: np.ndarray  # (2^Mc, Mc) error bound of Ṽ
    sign: np.ndarray  # (2^Mc,) sign of det A_SS; 0 where it is singular to round-off
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
    sign: int  # sign of det A_SS = det k(S)/det k₀; 0 if singular to round-off


class Ray(NamedTuple):
    """Slip rates x ≥ 0 of a singular status that require no load: A_SS x = 0, and no contact leaves the cone."""

    slides: np.ndarray  # (Mc,) bool
    slip: np.ndarray  # (Mc,) x
    left: np.ndarray  # (Mc,) y with yᵀA = 0 on the sliding contacts
    drive: float  # yᵀq, nonzero if the load drives the motion


class AllSolutions(NamedTuple):
    """All distinct solutions and rays of a complementarity problem, including both ends of each face."""

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
    """Return Ṽ with error bounds, and sign and value of the minor, for statuses with k sliding contacts."""
    chosen = np.nonzero(slides)[1].reshape(len(slides), k)
    square = (chosen[:, :, None], chosen[:, None, :])
    a, error, q = problem.matrix[square], problem.error[square], problem.vector[chosen]
    sign, size = np.linalg.slogdet(a)
    a = np.where((sign == 0)[:, None, None], np.eye(k), a)
    inverse = np.linalg.inv(a)
    # A_SS stays regular for all changes E of its entries for which the largest row sum of |A_SS⁻¹| |E| is below 1
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
    """Products (m, k) of matrices (m, k, k) and vectors (m, k)."""
    return np.einsum("mij,mj->mi", matrices, vectors)


def enumerate_solutions(problem: Complementarity, again: Callable | None = None) -> AllSolutions:
    """Find all solutions and rays, for at most 14 critical contacts.

    If a contact is on a boundary, several statuses have the same rates; only one is returned, preferably one with
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
        slides, rate = through.slides[number], through.rate[number]
        found = Solution(slides, np.where(slides, rate, 0.0), rate, through.error[number], int(through.sign[number]))
        solution = _solution_in_units(here, found)
        if again is not None and (np.abs(solution.rate) <= solution.error).any():
            if (better := again(slides)) is None:
                continue
            rate, error = better
            solution = solution._replace(rate=rate, error=error, slip=np.where(slides, rate, 0.0))
        solutions.append(solution)
    for number in np.flatnonzero(through.sign == 0):
        face = _solution_face(here, through.slides[number])
        solutions += [_solution_in_units(here, end) for end in _face_ends(face)]
        rays += [
            ray._replace(slip=here.slip_unit * ray.slip, left=ray.left / here.gap_unit)
            for ray in _find_rays(here, face)
        ]
    kept = []
    for solution in sorted(solutions, key=lambda s: {1: 0, -1: 1, 0: 2}[s.sign]):
        if not any(_same_rates(solution, other) for other in kept):
            kept.append(solution)
    return AllSolutions(tuple(kept), tuple(rays))


def _same_rates(solution: Solution, other: Solution) -> bool:
    largest = max(np.abs(solution.rate).max(initial=0.0), np.abs(other.rate).max(initial=0.0))
    return bool((np.abs(solution.rate - other.rate) <= BLUR * (solution.error + other.error) + SAME * largest).all())


def _solution_in_units(problem: ScaledProblem, end: Solution) -> Solution:
    unit = np.where(end.slides, problem.slip_unit, problem.gap_unit)
    return end._replace(slip=problem.slip_unit * end.slip, rate=unit * end.rate, error=unit * end.error)


class SolutionFace(NamedTuple):
    """Solutions `at` + `turn` t ≥ 0 of a singular status: λ of sliding contacts and w of the others."""

    slides: np.ndarray  # (Mc,) bool
    at: np.ndarray  # (Mc,)
    turn: np.ndarray  # (Mc, d)
    left: np.ndarray  # (k, d) left null vectors of A_SS
    missed: np.ndarray  # (d,) products of left null vectors with q; if nonzero, no slip rates balance the load
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
    # errors of null vectors are the errors of A divided by the next singular value
    spread = BLUR * max(1.0, np.linalg.norm(inverse))
    at_error = spread * (error @ np.abs(slip) + problem.vector_error + error.max())
    missed_error = BLUR * np.abs(left.T) @ problem.vector_error[slides]
    missed_error += spread * np.linalg.norm(error[slides]) * np.linalg.norm(q[slides])
    turn_error = spread * (error.sum(axis=1) + error.max())
    return SolutionFace(slides, at, turn, left, np.abs(left.T @ q[slides]), at_error, turn_error, missed_error)


def _face_ends(face: SolutionFace) -> list[Solution]:
    """Ends of the solution set {t: at + turn t ≥ 0}, if any; an end at infinity is replaced by a finite point."""
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
    """Return both ends of the interval {t: at + turn t ≥ 0}; no ends if it is empty even with `slack` added to `at`."""
    bound, give, rising = -at / turn, slack / np.abs(turn), turn > 0
    if np.max((bound - give)[rising], initial=-np.inf) > np.min((bound + give)[~rising], initial=np.inf):
        return []
    far = 1.0 + np.abs(bound).max()
    low = np.max(bound[rising], initial=-np.inf) if rising.any() else bound.min() - far
    high = np.min(bound[~rising], initial=np.inf) if (~rising).any() else low + far
    return [np.array([low]), np.array([high])]


def _find_rays(problem: ScaledProblem, face: SolutionFace) -> list[Ray]:
    """Find nonnegative slip rates in the null space for which no contact leaves the cone."""
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
    """Map C from a status S to C(S). Bits of S mark critical contacts that slide; bits of C(S) mark consistent ones."""

    image: np.ndarray  # (2^Mc,) C(S) for S = 0 … 2^Mc − 1; −1 where k(S) is singular

    @property
    def bijective(self) -> bool:
        """True if every pattern of consistency belongs to exactly one status."""
        return len(np.unique(self.image)) == len(self.image) and self.image.min() >= 0

    @property
    def consistent(self) -> np.ndarray:
        """Statuses in which every contact is consistent."""
        return np.flatnonzero(self.image == len(self.image) - 1)


@checked
def status_map(problem: Complementarity) -> StatusMap:
    """Compute the map of Eq. 5 of McNamara and Herrmann for all statuses of at most 14 critical contacts."""
    size = len(problem.vector)
    if size > MAPPED:
        raise ValueError(
            f"{size} critical contacts have {2.0**size:.3g} combinations of statuses, more than the limit of "
            f"{MAPPED}: `contact_status` finds a consistent status, `certificate` tests uniqueness"
        )
    through = enumerate_rates(scale_problem(problem))
    fits = np.where(through.slides, through.rate > 0, through.rate < 0)
    return StatusMap(np.where(through.sign == 0, -1, fits @ (1 << np.arange(size))))
