"""Linear complementarity problem of the critical contacts, with round-off bounds on its data, and two solvers.

    w = A λ + q ≥ 0,   λ ≥ 0,   wᵀ λ = 0,      A = 1 − Gᵀ k₀⁻¹ H,   q = −Gᵀ k₀⁻¹ b.

Decisions on signs and ranks take the round-off of A and q into account, and are made in units in which the entries of A
and q are about 1. Rows and columns are scaled by powers of two, which changes neither the sign of a minor nor any
status.

Source: Cottle, Pang, Stone, The Linear Complementarity Problem (Academic Press 1992); Ruiz, RAL-TR-2001-034, for the
scaling.
"""

from typing import NamedTuple

import numpy as np

from ...kit import checked, readable
from ...solve.linear import one_thread
from .matrices import LinearSystem
from .system import StatusSolver

SLACK = 1e-9  # share of the largest rate below which a rate may have either sign
ROUND_OFF = 1e-14  # relative error of an entry: 45 units in the last place, for sums of a few dozen terms
SPARE = 10.0  # safety factor on errors estimated from two right-hand sides
SWEEPS = 6  # scaling sweeps; each halves the logarithms of the largest entries


@readable
class Complementarity(NamedTuple):
    """w = A λ + q ≥ 0, λ ≥ 0, wᵀλ = 0 for the critical contacts."""

    matrix: np.ndarray  # (Mc, Mc) A
    vector: np.ndarray  # (Mc,) q
    matrix_error: float = 0.0  # error of an entry of A beyond its own round-off, such as that of solving with k₀
    vector_error: float = 0.0  # likewise of q


class ScaledProblem(NamedTuple):
    """Complementarity problem in units in which the largest entries of rows, columns and q are about 1."""

    matrix: np.ndarray  # (Mc, Mc)
    vector: np.ndarray  # (Mc,)
    error: np.ndarray  # (Mc, Mc) error bounds of the matrix
    vector_error: np.ndarray  # (Mc,) error bounds of the vector
    slip_unit: np.ndarray  # (Mc,) λ = slip_unit · its value here
    gap_unit: np.ndarray  # (Mc,) w = gap_unit · its value here

    def submatrix(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A_SS with its error bounds."""
        box = np.ix_(chosen, chosen)
        return self.matrix[box], self.error[box]


@checked
def complementarity(
    matrix: LinearSystem, load: np.ndarray, *, critical: np.ndarray | None = None, geometric: bool = True
) -> Complementarity:
    """Compute A and q of the critical contacts under a load rate; arguments are those of `contact_status`.

    Raises
    ------
    LinAlgError
        if k is singular while all contacts stick.
    """
    with one_thread():
        return complementarity_of_system(StatusSolver(matrix, load, critical_numbers(matrix, critical), geometric))


def critical_numbers(matrix: LinearSystem, critical) -> np.ndarray:
    """Indices of the critical contacts, from indices or from a mask of all contacts."""
    if critical is None:
        return np.flatnonzero(matrix.limit)
    critical = np.asarray(critical)
    if critical.dtype == bool and critical.shape == (matrix.count,):
        return np.flatnonzero(critical)
    known = critical.dtype.kind in "iu" or not critical.size
    if critical.dtype == bool or critical.ndim != 1 or not known or len(np.unique(critical)) < len(critical):
        raise ValueError(
            f"critical = {critical.tolist()!r:.60} was given: distinct numbers of contacts, or one bool for each of "
            f"the {matrix.count} contacts, are needed"
        )
    if critical.size and not 0 <= critical.min() <= critical.max() < matrix.count:
        raise ValueError(
            f"critical contacts {critical.min()} to {critical.max()} were given: contacts have the numbers 0 to "
            f"{matrix.count - 1}"
        )
    return critical.astype(np.int64)


def complementarity_of_system(system: StatusSolver) -> Complementarity:
    """A and q with errors, which are estimated by one refinement step for two columns and for the load."""
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
    # the difference 1 − Gᵀ k₀⁻¹ H may be far smaller than both terms
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
    # entries that may be zero must not become the unit of a row or column
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
    """Magnitude below which a rate may have either sign: a fraction of the largest rate, but at least `slack`."""
    return np.maximum(slack, SLACK * np.abs(rate).max(initial=0.0))


def inconsistent(slides: np.ndarray, rate: np.ndarray, slack=0.0) -> np.ndarray:
    """Mask of contacts with an inconsistent status; a rate near zero is consistent with either status."""
    slack = sign_slack(rate, slack)
    return np.where(slides, rate < -slack, rate > slack)


def principal_pivoting(problem: Complementarity) -> tuple[np.ndarray | None, int]:
    """Solve by Murty's principal pivoting, which flips the inconsistent contact with the largest index.

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
    """Ṽ of all critical contacts for a status, or None if the status is singular."""
    slip = np.zeros(len(slides))
    if slides.any():
        try:
            slip[slides] = np.linalg.solve(problem.matrix[np.ix_(slides, slides)], -problem.vector[slides])
        except np.linalg.LinAlgError:
            return None
    rate = np.where(slides, slip, -(problem.matrix @ slip + problem.vector))
    return rate if np.isfinite(rate).all() else None


def lemke(problem: Complementarity) -> np.ndarray | None:
    """Solve for λ by Lemke's algorithm with covering vector 1; None if it ends on a ray.

    A ray proves nothing: a solution may still exist. The algorithm uses the units of `ScaledProblem`, in which the size
    of a pivot is meaningful.
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
        able = column > 1e-11 * max(1.0, np.abs(column).max())  # for entries of about 1, after a few hundred pivots
        if not able.any():
            return None
        ratio = np.where(able, table[:, -1] / np.where(able, column, 1.0), np.inf)
        ties = np.flatnonzero(ratio <= ratio.min() * (1 + 1e-12) + 1e-300)
        if not len(ties):  # entries became NaN
            return None
        row = int(ties[np.argmax(basis[ties] == 2 * size)]) if (basis[ties] == 2 * size).any() else int(ties[0])
    return None
