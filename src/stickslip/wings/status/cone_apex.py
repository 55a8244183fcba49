"""Contacts that open and close: the four statuses at the apex of the Coulomb cone, as one piecewise-linear map.

A contact without force responds to the relative velocity V of its bodies in one of four ways. The four cells of V are
disjoint and cover the plane; the force rate −K S V is continuous across their boundaries:

    opens            V_n > 0                              S = 0
    slides with s    V_n < 0,  m V_n + s V_t > 0          S = ((1, 0), (−m s, 0)),  s = ±1
    sticks           V_n < 0,  m V_n ± V_t ≤ 0            S = 1

A contact with a force at the limit has only the two statuses of the principle of minimum sliding. With V₀ the
velocities if all these contacts stick, Z = Cᵀ k₀⁻¹ C their compliance, and Δ(σ) = K (S(σ) − 1), the statuses obey

    g(V) = V + Z Δ(σ(V)) V = V₀,        det(1 + Z Δ(σ)) = det k(σ) / det k₀.

At most four cells meet in a face of codimension two. Hence g is one-to-one, and the statuses are unique for every load,
if and only if det k(σ) has the same sign for all σ: the four statuses are mutually exclusive as long as no combination
of them has lost stability. The paper leaves this question open.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. V B, for the question; Kuhn and Löwen's
Theorem 5.3, as quoted by Ralph (Cornell University TR 92-1283), and Scholtes, doi:10.1287/moor.21.4.955, for the
one-to-one property; Katzenelson's algorithm for following the pieces.
"""

import itertools
from typing import NamedTuple

import numpy as np

from ...kit import check_types, checked, readable, require_shape

STICKS, SLIDES, SLIDES_BACK, OPENS = range(4)  # SLIDES has s = +1, SLIDES_BACK has s = −1
STATUS_NAMES = ("sticks", "slides", "slides back", "opens")
SIDE = np.array([0.0, 1.0, -1.0, 0.0])  # s of each status
ROUNDS = 60  # largest number of iterations before pieces are followed one by one
PIECES = 4000  # largest number of pieces followed
ENUMERATED = 4096  # largest number of combinations of statuses enumerated
HELPING = 1e-4  # fraction of the spring stiffness that disks without other support keep while pieces are followed
SINGULAR = 1e12  # condition number of a piece beyond which it is treated as singular
SAME = 1e-6  # fraction of the largest velocity within which two velocities are equal
SLACK = 1e-9  # fraction of the largest velocity below which a velocity may have either sign


@readable
class Apex(NamedTuple):
    """Map for E contacts that may change status; V is (E, d), with d = 2 in a plane, where g is piecewise linear."""

    compliance: np.ndarray  # (dE, dE) Z [length/force]
    velocity: np.ndarray  # (E, d) V₀, the velocities if all contacts stick
    springs: np.ndarray  # (E, d, d) K [force/length]
    slope: np.ndarray  # (E,) m
    sign: np.ndarray  # (E,) s of a contact with a force; 0 at the apex, where all four statuses are possible
    alone: np.ndarray  # (E,) bool, contacts of disks with all contacts at the apex, free if all of them open or slide

    def check_entries(self) -> None:
        """Raise ValueError if an entry has a wrong type, shape or value."""
        check_types(self)
        require_shape(2 * (np.size(self.velocity),), compliance=self.compliance)
        if not np.isin(self.sign, (-1.0, 0.0, 1.0)).all():
            raise ValueError("sign must contain only −1, 0 and 1")

    @property
    def allowed(self) -> list[tuple[int, ...]]:
        """Possible statuses of each contact."""
        both = {1.0: (STICKS, SLIDES), -1.0: (STICKS, SLIDES_BACK), 0.0: (STICKS, SLIDES, SLIDES_BACK, OPENS)}
        return [both[float(s)] for s in self.sign]


@readable
class StatusSolution(NamedTuple):
    """Statuses that are consistent with their velocities, or None if none were found."""

    status: np.ndarray | None  # (E,)
    velocity: np.ndarray | None  # (E, d)
    method: str


def piece_matrix(apex: Apex, status: np.ndarray, helped: bool = False) -> np.ndarray:
    """Matrix 1 + Z Δ(σ) (..., 2E, 2E) of the piece with the statuses (..., E)."""
    size = status.shape[-1]
    columns = apex.compliance.reshape(2 * size, size, 2)
    turned = np.einsum("aeb,...ebc->...aec", columns, stiffness_change(apex, status, helped))
    return np.eye(2 * size) + turned.reshape(*status.shape[:-1], 2 * size, 2 * size)


def stiffness_change(apex: Apex, status: np.ndarray, helped: bool = False) -> np.ndarray:
    """Δ(σ) = K (S(σ) − 1) (..., E, 2, 2); with `helped`, disks without other support keep a small stiffness."""
    change = np.zeros((*status.shape, 2, 2))
    slides = (status == SLIDES) | (status == SLIDES_BACK)
    change[slides, 1, 0], change[slides, 1, 1] = -(apex.slope * SIDE[status])[slides], -1.0
    change[status == OPENS] = -np.eye(2)
    return (1 - HELPING * helped * apex.alone)[:, None, None] * (apex.springs @ change)


def status_of_velocity(apex: Apex, velocity: np.ndarray, now: np.ndarray, slack: float = 0.0) -> np.ndarray:
    """Return the status (E,) whose cell contains V or, within `slack` of a boundary, the current status."""
    normal, along = velocity.T
    forward, back = apex.slope * normal + along, apex.slope * normal - along
    touches = apex.sign == 0
    out = np.full(len(now), STICKS)
    may = touches | (apex.sign > 0)
    out[may & (forward > slack)] = SLIDES
    may = touches | (apex.sign < 0)
    out[may & (back > slack)] = SLIDES_BACK
    out[touches & (normal > 0)] = OPENS
    if slack:
        out = np.where(_in_cell(apex, forward, back, normal, now, slack), now, out)
    return out


def _in_cell(apex: Apex, forward, back, normal, status, slack: float):
    """Return True where V lies in the cell of a status, to within `slack`."""
    touches = apex.sign == 0
    closed = ~touches | (normal <= slack)
    sticks = closed & (~(touches | (apex.sign > 0)) | (forward <= slack))
    sticks &= ~(touches | (apex.sign < 0)) | (back <= slack)
    by_status = (sticks, closed & (forward >= -slack), closed & (back >= -slack), touches & (normal >= -slack))
    return np.choose(status, by_status)


@checked
def statuses_at_apex(apex: Apex, *starts: np.ndarray) -> StatusSolution:
    """Find consistent statuses by iteration, then by following the pieces, then by enumeration.

    Each iteration assigns every contact the status of its cell.

    Parameters
    ----------
    starts : initial statuses (E,), tried one after the other; default: all stick

    Returns
    -------
    StatusSolution
        verified: V solves the piece of the statuses and lies in its cell. If nothing is found, none of up to 4096
        combinations is consistent; with more combinations, it is only known that the search along pieces found none.
    """
    for start in starts or (np.full(len(apex.sign), STICKS),):
        solution = _iterate_statuses(apex, np.asarray(start))
        if solution is not None:
            return solution
    solution = follow_pieces(apex)
    if solution.status is None and count_choices(apex) <= ENUMERATED:
        every = enumerate_statuses(apex)
        for status, velocity in zip(every.status[:1], every.velocity[:1], strict=True):
            return StatusSolution(status, velocity, "one by one")
    return solution


def _iterate_statuses(apex: Apex, now: np.ndarray) -> StatusSolution | None:
    """Assign every contact the status of its cell until nothing changes; return None if there is no convergence."""
    seen = set()
    for _ in range(ROUNDS):
        if now.tobytes() in seen:
            return None
        seen.add(now.tobytes())
        velocity = _velocity(apex, now)
        if velocity is None:
            return None
        fits = status_of_velocity(apex, velocity, now, SLACK * np.abs(velocity).max(initial=0.0))
        if np.array_equal(fits, now):
            return StatusSolution(now, velocity, "iteration")
        now = fits
    return None


def _velocity(apex: Apex, status: np.ndarray) -> np.ndarray | None:
    """Return the velocities V (E, 2) for given statuses, or None if their piece is singular."""
    out = solve_piece(piece_matrix(apex, status), apex.velocity.ravel())
    return None if out is None else out.reshape(-1, 2)


def solve_piece(matrix: np.ndarray, right: np.ndarray) -> np.ndarray | None:
    """Solve a piece; None if its matrix is singular to round-off, as for a disk whose contacts all slide or open."""
    if not len(matrix):
        return right
    if not np.linalg.cond(matrix) < SINGULAR:
        return None
    return np.linalg.solve(matrix, right)


def follow_pieces(apex: Apex) -> StatusSolution:
    """Follow pieces from g(V₀) towards V₀ in the image of g; where det k changes sign, the path turns back.

    Nothing is found if the path runs to infinity without meeting a consistent combination of statuses.
    """
    nothing = StatusSolution(None, None, "along the pieces")
    here, size = apex.velocity.copy(), apex.velocity.size
    now = status_of_velocity(apex, here, np.full(len(apex.sign), STICKS))
    aim = apex.velocity.ravel() - piece_matrix(apex, now, True) @ here.ravel()
    share, inwards = 0.0, None
    for _ in range(PIECES):
        # line on which g(V) − g(V₀) is a fraction of the target, even if a piece is singular
        line = np.linalg.svd(np.hstack([piece_matrix(apex, now, True), -aim[:, None]]))[2][-1]
        forward = line[-1] if inwards is None else _crossing_rate(inwards, line[:size].reshape(-1, 2))
        move, gain = np.sign(forward) * line[:size].reshape(-1, 2), np.sign(forward) * line[-1]
        length, contact, to, inwards = _next_crossing(apex, here, move, now)
        if gain > 0 and share + length * gain >= 1:
            velocity = _velocity(apex, now)
            if velocity is None:
                return nothing
            fits = status_of_velocity(apex, velocity, now, SLACK * np.abs(velocity).max(initial=0.0))
            return StatusSolution(now, velocity, "along the pieces") if np.array_equal(fits, now) else nothing
        if not np.isfinite(length):
            return nothing
        here, share, now = here + length * move, share + length * gain, now.copy()
        now[contact] = to
    return nothing


def _crossing_rate(bound, move: np.ndarray) -> float:
    """Rate at which a move crosses a boundary (contact, a, b), a V_n + b V_t = 0."""
    contact, of_normal, of_along = bound
    return of_normal * move[contact, 0] + of_along * move[contact, 1]


def _next_crossing(apex: Apex, here: np.ndarray, move: np.ndarray, now: np.ndarray):
    """Return how far a move goes before a contact leaves its cell, and that contact, its new cell and the boundary."""
    best, contact, to, crossed = np.inf, -1, STICKS, None
    slack = 1e-12 * np.abs(move).max(initial=0.0)
    for k, status in enumerate(now):
        touches, m = apex.sign[k] == 0, apex.slope[k]
        bounds = {
            STICKS: [(m, s, way) for s, way in ((1.0, SLIDES), (-1.0, SLIDES_BACK)) if touches or apex.sign[k] == s],
            SLIDES: [(-m, -1.0, STICKS), (1.0, 0.0, OPENS)][: 1 + touches],
            SLIDES_BACK: [(-m, 1.0, STICKS), (1.0, 0.0, OPENS)][: 1 + touches],
            OPENS: [(-1.0, 0.0, None)],
        }[int(status)]
        for of_normal, of_along, way in bounds:
            bound = (k, of_normal, of_along)
            rate = _crossing_rate(bound, move)
            if rate > slack and (length := max(-_crossing_rate(bound, here), 0.0) / rate) < best:
                best, contact, to, crossed = length, k, way, bound
    if to is None:  # from open to one of the sliding cells
        to = SLIDES if here[contact, 1] + best * move[contact, 1] > 0 else SLIDES_BACK
    return best, contact, to, crossed


def count_choices(apex: Apex) -> int:
    """Number of combinations of statuses."""
    return int(np.prod([float(len(a)) for a in apex.allowed]))


class AllStatuses(NamedTuple):
    """The K consistent combinations of statuses with distinct velocities, and properties of all combinations."""

    status: np.ndarray  # (K, E)
    velocity: np.ndarray  # (K, E, 2)
    stable: np.ndarray  # (K,) bool, det k has the same sign as if all stick
    coherent: bool  # True if det k has the same sign for all combinations
    decided: bool  # True if no combination with singular k can be consistent, so there are no others


def enumerate_statuses(apex: Apex) -> AllStatuses:
    """Enumerate all combinations of statuses, as `consistent_statuses` does; stable ones come first."""
    if count_choices(apex) > ENUMERATED:
        raise ValueError(
            f"{len(apex.sign)} contacts have {count_choices(apex):.3g} combinations of statuses, of which at most "
            f"{ENUMERATED} can be enumerated: use `statuses_at_apex` to find one that is consistent"
        )
    every = list(itertools.product(*apex.allowed))
    status = np.array(every, int).reshape(len(every), len(apex.sign))
    matrix, sign, regular, velocity = _all_velocities(apex, status)
    scale = np.abs(velocity).max(axis=(1, 2), initial=0.0)[:, None]
    normal, along = velocity[..., 0], velocity[..., 1]
    fits = _in_cell(apex, apex.slope * normal + along, apex.slope * normal - along, normal, status, SLACK * scale)
    good = list(np.flatnonzero(regular & fits.all(axis=1)))
    good.sort(key=lambda k: (sign[k] < 0, np.abs(velocity[k]).max(initial=0.0)))
    kept = []
    for k in good:
        same = SAME * np.abs(velocity[k]).max(initial=0.0)  # equal for statuses on either side of a cell boundary
        if not any(np.abs(velocity[k] - velocity[other]).max(initial=0.0) <= same for other in kept):
            kept.append(k)
    # a disk that slides or opens at its only two contacts is free: `apex_status` releases it as a body
    free = (status[:, apex.alone] != STICKS).sum(axis=1) >= 2
    open_ends = any(_has_solution(matrix[k], apex.velocity.ravel()) for k in np.flatnonzero(~regular & ~free))
    return AllStatuses(
        status[kept], velocity[kept], sign[kept] > 0, bool((sign[regular] > 0).all() & regular.all()), not open_ends
    )


def _all_velocities(apex: Apex, status: np.ndarray):
    """Return matrices of pieces (K, 2E, 2E), signs of det k, the mask of regular pieces, and velocities V (K, E, 2)."""
    matrix = piece_matrix(apex, status)
    sign = np.linalg.slogdet(matrix)[0]
    sound = np.where((sign == 0)[:, None, None], np.eye(matrix.shape[1]), matrix)
    inverse = np.linalg.inv(sound)
    size = np.abs(matrix).sum(axis=1).max(axis=1, initial=0.0) * np.abs(inverse).sum(axis=1).max(axis=1, initial=0.0)
    regular = (sign != 0) & (size < SINGULAR) | (matrix.shape[1] == 0)
    velocity = np.zeros((len(status), *apex.velocity.shape))
    velocity[regular] = np.linalg.solve(
        sound[regular], np.broadcast_to(apex.velocity.reshape(-1, 1), (int(regular.sum()), matrix.shape[1], 1))
    ).reshape(int(regular.sum()), *apex.velocity.shape)
    return matrix, sign, regular, velocity


def _has_solution(matrix: np.ndarray, right: np.ndarray) -> bool:
    """Return True if the equation of a singular piece has a solution to half of the significant digits."""
    rest = matrix @ np.linalg.lstsq(matrix, right, rcond=1 / SINGULAR)[0] - right
    return bool(np.abs(rest).max(initial=0.0) <= SAME * np.abs(right).max(initial=0.0))


@checked
def consistent_statuses(apex: Apex) -> tuple[np.ndarray, bool]:
    """Find all consistent statuses by enumeration, and test whether det k has the same sign for all combinations.

    Combinations with the same velocities, which lie on a boundary of their cells, count once. At most 4096
    combinations are enumerated.

    Returns
    -------
    (K, E) statuses, bool
    """
    every = enumerate_statuses(apex)
    return every.status, every.coherent


def force_change(apex: Apex, solution: StatusSolution) -> np.ndarray:
    """Change of force rates due to the statuses, K (S − 1) V (E, d)."""
    if apex.velocity.shape[1] == 2:
        return np.einsum("eab,eb->ea", stiffness_change(apex, solution.status), solution.velocity)
    return np.einsum("eab,eb->ea", apex.springs, round_cone_stretch(apex, solution.velocity)[0] - solution.velocity)


def round_cone_stretch(apex: Apex, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spring stretching in three dimensions, S V (E, 3), its derivatives (E, 3, 3), and statuses (E,).

    This is the rate of the return mapping: at a contact without force, V_t is shortened to −m V_n; at a contact on the
    cone, the component of V_t along the force is shortened to −m V_n.
    """
    touches, slope = apex.sign == 0, apex.slope
    normal, size = velocity[:, 0], np.linalg.norm(velocity[:, 1:], axis=1)
    slides = np.where(touches, slope * normal + size, slope * normal + apex.sign * velocity[:, 1]) > 0
    opens = touches & (normal > 0)
    by = np.tile(np.eye(3), (len(normal), 1, 1))
    along = slides & ~touches
    by[along, 1, 1], by[along, 1, 0] = 0.0, -(slope * apex.sign)[along]
    turns = slides & touches & ~opens
    hat = velocity[turns, 1:] / size[turns, None]
    share = (-slope * normal)[turns] / size[turns]
    by[turns, 1:, 0] = -slope[turns, None] * hat
    by[turns, 1:, 1:] = share[:, None, None] * (np.eye(2) - hat[:, :, None] * hat[:, None, :])
    by[opens] = 0.0
    status = np.where(opens, OPENS, np.where(slides, np.where(apex.sign < 0, SLIDES_BACK, SLIDES), STICKS))
    return np.einsum("eab,eb->ea", by, velocity), by, status  # S V is homogeneous of degree one


def status_on_round_cones(apex: Apex) -> tuple[StatusSolution, int]:
    """Search for statuses in three dimensions by Newton's method from several velocities.

    Returns
    -------
    StatusSolution, int
        verified: S V is the rate of the return mapping. The integer is the sign of the determinant of the derivative
        of g, which equals that of det k/det k₀; 0 if nothing is found, which proves nothing
    """
    count, touches = len(apex.sign), apex.sign == 0
    starts = [apex.velocity]
    for kept in (0.0, 1.0):  # all contacts without force open, or slide without friction
        part = np.tile(np.eye(3), (count, 1, 1))
        part[touches] = np.diag([kept, 0.0, 0.0])
        start = solve_piece(_derivative(apex, part), apex.velocity.ravel())
        starts += [] if start is None else [start.reshape(-1, 3)]
    for start in starts:
        velocity = _newton_on_round_cones(apex, start)
        if velocity is not None:
            _, by, status = round_cone_stretch(apex, velocity)
            sign = int(np.linalg.slogdet(_derivative(apex, by))[0])
            return StatusSolution(status, velocity, "Newton"), sign
    return StatusSolution(None, None, "Newton"), 0


def _derivative(apex: Apex, by: np.ndarray) -> np.ndarray:
    """Derivative 1 + Z K (S′ − 1) (3E, 3E)."""
    size = apex.velocity.size
    change = np.einsum("eab,ebc->eac", apex.springs, by - np.eye(3))
    columns = apex.compliance.reshape(size, -1, 3)
    return np.eye(size) + np.einsum("aeb,ebc->aec", columns, change).reshape(size, size)


def _newton_on_round_cones(apex: Apex, velocity: np.ndarray) -> np.ndarray | None:
    """Solve g(V) = V₀ by Newton's method, with shorter steps where the residual would not decrease; None on failure."""

    def rest(v: np.ndarray) -> np.ndarray:
        lost = np.einsum("eab,eb->ea", apex.springs, round_cone_stretch(apex, v)[0] - v)
        return v.ravel() + apex.compliance @ lost.ravel() - apex.velocity.ravel()

    for _ in range(ROUNDS):
        missed = rest(velocity)
        if np.abs(missed).max(initial=0.0) <= SLACK * np.abs(velocity).max(initial=0.0):
            return velocity
        step = solve_piece(_derivative(apex, round_cone_stretch(apex, velocity)[1]), -missed)
        if step is None:
            return None
        for length in 0.5 ** np.arange(12):
            there = velocity + length * step.reshape(-1, 3)
            if np.linalg.norm(rest(there)) < (1 - 1e-4 * length) * np.linalg.norm(missed):
                break
        velocity = there
    return None
