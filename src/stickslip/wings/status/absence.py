"""Proofs that no status balances a load: Farkas certificates, and motions that nothing resists.

If y ≥ 0, Aᵀ y ≤ 0 and qᵀ y < 0, then no λ ≥ 0 has w = A λ + q ≥ 0, since 0 ≤ yᵀ w = (Aᵀ y)ᵀ λ + qᵀ y < 0. A linear
programme proposes y. The inequalities are then verified, allowing for the errors in A and q.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, qr, solve_triangular
from scipy.optimize import linprog

from ...solve.linear import factorised
from .enumeration import BLUR, Ray
from .lcp import Complementarity, ScaledProblem, scale_problem
from .system import StatusSolver

FAR = 1e9  # in units of q: a certificate is valid if a consistent status would need larger slip rates
TIGHT = 1e-6  # ten times the tolerance of HiGHS; inequalities tight to within it are turned into equations
DENSE_UP_TO = 3000  # coordinates up to which null vectors are computed, which takes seconds
ZERO = 1e-11  # share of the largest entry of k below which a pivot is zero
NULL = 1e-9  # residual of a null vector of unit size, over the largest entry of k


class Absence(NamedTuple):
    """Proof that no status is consistent, by "enumeration" or by a "Farkas" vector."""

    by: str
    statuses: int  # number of statuses enumerated
    vector: np.ndarray | None = None  # (Mc,) y ≥ 0 with Aᵀy ≤ 0 and qᵀy < 0, to round-off
    slip: float = np.inf  # smallest sum of λ of a consistent status; infinite if Aᵀy ≤ 0 beyond round-off


class UnresistedMotion(NamedTuple):
    """Motion that nothing resists and that the load drives."""

    velocity: np.ndarray  # (n,) v of unit length, k(S) v = 0
    balance: np.ndarray  # (n,) u of unit length, uᵀ k(S) = 0; since uᵀ b is not zero, S cannot balance the load b
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
    """y with nearly tight inequalities turned into equations, as for a motion that nothing resists."""
    held = y > TIGHT
    tight = np.abs(here.matrix.T @ y) <= TIGHT
    a = here.matrix[np.ix_(held, tight)].T
    out = np.zeros(len(y))
    out[held] = y[held] - np.linalg.pinv(a, rcond=TIGHT) @ (a @ y[held])
    return np.maximum(out, 0.0)


def _required_slip(here: ScaledProblem, y: np.ndarray) -> float:
    """Sum of slip rates that any λ ≥ 0 with A λ + q ≥ 0 would exceed; 0 if y proves nothing."""
    short = -(here.vector @ y) - here.vector_error @ y
    if not (np.isfinite(y).all() and short > 0):
        return 0.0
    excess = float(np.maximum(here.matrix.T @ y + here.error.T @ y, 0.0).max())
    return np.inf if excess == 0 else short / excess


def farkas_ray(problem: Complementarity, absence: Absence) -> Ray | None:
    """Slip rates, without load, of the contacts in a Farkas vector; None if this motion is resisted."""
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
    """Motion of a ray, verified by k(S) v = 0, uᵀ k(S) = 0 and uᵀ b ≠ 0; None if one of these fails."""
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
    """Motion with both vectors in all coordinates and of unit length; None if the verification fails."""
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
    whole = np.zeros((2, len(system.load)))
    whole[:, system.kept] = v, u
    return UnresistedMotion(*whole, power / size, slides)


class IdleMotions(NamedTuple):
    """Motions that nothing resists although all contacts stick, and that do not move any critical contact."""

    coordinates: np.ndarray  # coordinates that may be held fixed to exclude these motions
    motion: UnresistedMotion | None  # motion driven by the load, if any; then no status balances the load


def find_idle_motions(system: StatusSolver) -> IdleMotions | None:
    """Find null vectors of k₀ that are null vectors of every k(S); None if this cannot be decided."""
    if not 0 < len(system.kept) <= DENSE_UP_TO:
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
