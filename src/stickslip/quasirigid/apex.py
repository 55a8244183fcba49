"""Contacts that open and close: four statuses at the apex of Coulomb's cone, as one piecewise-linear map.

A contact without force answers to the relative velocity V of its bodies in one of four ways. The cells of V are
disjoint and cover the plane, and the force rate −K S V is continuous from one to the next:

    opens            V_n > 0                              S = 0
    slides with s    V_n < 0,  m V_n + s V_t > 0          S = ((1, 0), (−m s, 0)),  s = ±1
    sticks           V_n < 0,  m V_n ± V_t ≤ 0            S = 1

A contact at the limit with a force has the two statuses of the principle of minimum sliding. With V₀ the velocities if
all these contacts stuck, Z = Cᵀ k₀⁻¹ C their compliance and Δ(σ) = K (S(σ) − 1), the statuses obey

    g(V) = V + Z Δ(σ(V)) V = V₀,        det(1 + Z Δ(σ)) = det k(σ) / det k₀.

At most four cells meet in a face of codimension two. So g is one-to-one, and the statuses are unique for every load, if
and only if det k(σ) has the same sign for all σ: the four statuses exclude each other as long as no choice of them has
lost its stability. This is the question that the paper leaves open.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. V B, for the question; Kuhn and Löwen,
doi:10.1016/0024-3795(87)90338-4, Theorem 5.3, and Scholtes, doi:10.1287/moor.21.4.955, for one-to-one; Katzenelson,
Bell Syst. Tech. J. 44, 1605 (1965), for the way along the pieces.
"""

import itertools
from typing import NamedTuple

import numpy as np

STICKS, SLIDES, SLIDES_BACK, OPENS = range(4)  # slides with s = +1, with s = −1
WORDS = ("sticks", "slides", "slides back", "opens")
SIDE = np.array([0.0, 1.0, -1.0, 0.0])  # s of each status
ROUNDS = 60  # of giving every contact the status of its cell, before the pieces are followed one by one
PIECES = 4000  # that are followed at most
ENUMERATED = 4096  # choices of statuses that are gone through at most
SINGULAR = 1e12  # condition of a piece beyond which it counts as singular
SLACK = 1e-9  # share of the largest velocity below which a velocity may have either sign


class Apex(NamedTuple):
    """The piecewise-linear map of E contacts that may change their status; V is (E, 2): normal and tangential."""

    compliance: np.ndarray  # (2E, 2E) Z [length/force]
    velocity: np.ndarray  # (E, 2) V₀, if all of them stuck
    springs: np.ndarray  # (E, 2, 2) K [force/length]
    slope: np.ndarray  # (E,) m
    sign: np.ndarray  # (E,) s of a contact with a force; 0 at the apex, where it has all four statuses

    @property
    def allowed(self) -> list[tuple[int, ...]]:
        """Statuses that each contact may have."""
        both = {1.0: (STICKS, SLIDES), -1.0: (STICKS, SLIDES_BACK), 0.0: (STICKS, SLIDES, SLIDES_BACK, OPENS)}
        return [both[float(s)] for s in self.sign]


class Found(NamedTuple):
    """Statuses that are consistent with the velocities that they lead to, or None if none was found."""

    status: np.ndarray | None  # (E,)
    velocity: np.ndarray | None  # (E, 2)
    method: str


def piece(apex: Apex, status: np.ndarray) -> np.ndarray:
    """(2E, 2E) matrix 1 + Z Δ(σ) of the piece on which the contacts have the given statuses."""
    size = len(status)
    columns = apex.compliance.reshape(2 * size, size, 2)
    turned = np.einsum("aeb,ebc->aec", columns, changed(apex, status))
    return np.eye(2 * size) + turned.reshape(2 * size, 2 * size)


def changed(apex: Apex, status: np.ndarray) -> np.ndarray:
    """(E, 2, 2) Δ(σ) = K (S(σ) − 1)."""
    change = np.zeros((len(status), 2, 2))
    slides = (status == SLIDES) | (status == SLIDES_BACK)
    change[slides, 1, 0], change[slides, 1, 1] = -(apex.slope * SIDE[status])[slides], -1.0
    change[status == OPENS] = -np.eye(2)
    return apex.springs @ change


def cell(apex: Apex, velocity: np.ndarray, now: np.ndarray, slack: float = 0.0) -> np.ndarray:
    """(E,) the status that belongs to V; on a boundary, to within `slack`, the one that a contact has now."""
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
        out = np.where(_fits(apex, forward, back, normal, now, slack), now, out)
    return out


def _fits(apex: Apex, forward, back, normal, status, slack: float):
    """Whether V lies in the cell of a status, or no more than `slack` beside it."""
    touches = apex.sign == 0
    closed = ~touches | (normal <= slack)
    sticks = closed & (~(touches | (apex.sign > 0)) | (forward <= slack))
    sticks &= ~(touches | (apex.sign < 0)) | (back <= slack)
    by_status = (sticks, closed & (forward >= -slack), closed & (back >= -slack), touches & (normal >= -slack))
    return np.choose(status, by_status)


def statuses_at_apex(apex: Apex, start: np.ndarray | None = None) -> Found:
    """Consistent statuses: by giving every contact that of its cell, round by round; else along the pieces.

    Parameters
    ----------
    start : (E,) statuses to begin with; default: all stick

    Returns
    -------
    Found
        verified: V solves the piece of the statuses, and lies in its cell. Nothing is found where the way along the
        pieces turns back (det k changes its sign) or a piece is singular.
    """
    now = np.full(len(apex.sign), STICKS) if start is None else np.asarray(start)
    seen = set()
    for _ in range(ROUNDS):
        if now.tobytes() in seen:
            break
        seen.add(now.tobytes())
        velocity = _velocity(apex, now)
        if velocity is None:
            break
        fits = cell(apex, velocity, now, SLACK * np.abs(velocity).max(initial=0.0))
        if np.array_equal(fits, now):
            return Found(now, velocity, "all at once")
        now = fits
    return _along_the_pieces(apex)


def _velocity(apex: Apex, status: np.ndarray) -> np.ndarray | None:
    """(E, 2) V that a choice of statuses leads to, or None if it is singular."""
    out = _solved(piece(apex, status), apex.velocity.ravel())
    return None if out is None else out.reshape(-1, 2)


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray | None:
    """The solution, or None if the matrix is singular to round-off: a disk all of whose contacts slide, or open."""
    if not len(matrix):
        return right
    if not np.linalg.cond(matrix) < SINGULAR:
        return None
    return np.linalg.solve(matrix, right)


def _along_the_pieces(apex: Apex) -> Found:
    """From g(V₀) straight to V₀ in the image of g, piece after piece (Katzenelson)."""
    nothing = Found(None, None, "along the pieces")
    here = apex.velocity.copy()
    now = cell(apex, here, np.full(len(apex.sign), STICKS))
    left = apex.velocity.ravel() - piece(apex, now) @ here.ravel()
    for _ in range(PIECES):
        move = _solved(piece(apex, now), left)
        if move is None:
            return nothing
        move = move.reshape(-1, 2)
        share, contact, to = _crossing(apex, here, move, now)
        if share >= 1:
            velocity = _velocity(apex, now)
            if velocity is None:
                return nothing
            slack = SLACK * np.abs(velocity).max(initial=0.0)
            good = np.array_equal(cell(apex, velocity, now, slack), now)
            return Found(now, velocity, "along the pieces") if good else nothing
        if np.linalg.det(piece(apex, now)) < 0:
            return nothing  # the way would turn back
        here, left, now = here + share * move, (1 - share) * left, now.copy()
        now[contact] = to
    return nothing


def _crossing(apex: Apex, here: np.ndarray, move: np.ndarray, now: np.ndarray):
    """Share of a move after which the first contact leaves its cell, that contact, and the cell that it enters."""
    best, contact, to = np.inf, -1, STICKS
    slack = 1e-12 * np.abs(move).max(initial=0.0)
    for k in range(len(now)):
        touches = apex.sign[k] == 0
        bounds = {
            STICKS: [(apex.slope[k], s, other) for s, other in ((1, SLIDES), (-1, SLIDES_BACK))
                     if touches or apex.sign[k] == s],
            SLIDES: [(-apex.slope[k], -1, STICKS), (1.0, 0, OPENS)],
            SLIDES_BACK: [(-apex.slope[k], 1, STICKS), (1.0, 0, OPENS)],
            OPENS: [(-1.0, 0, SLIDES if move[k, 1] + here[k, 1] > 0 else SLIDES_BACK)],
        }[int(now[k])]  # fmt: skip
        for along_n, along_t, other in bounds:
            if other == OPENS and not touches:
                continue
            value = along_n * here[k, 0] + along_t * here[k, 1]
            rate = along_n * move[k, 0] + along_t * move[k, 1]
            if rate > slack and (share := max(-value, 0.0) / rate) < best:
                best, contact, to = share, k, other
    if now[contact] == OPENS and best < 1:  # which of the sliding cells lies beyond V_n = 0
        to = SLIDES if here[contact, 1] + best * move[contact, 1] > 0 else SLIDES_BACK
    return best, contact, to


def choices(apex: Apex) -> int:
    """Number of choices of statuses."""
    return int(np.prod([float(len(a)) for a in apex.allowed]))


def consistent_statuses(apex: Apex) -> tuple[np.ndarray, bool]:
    """All consistent choices of statuses, gone through one by one, and whether det k has the same sign for all choices.

    Returns
    -------
    (K, E) statuses, bool

    Raises
    ------
    ValueError
        for more than 4096 choices.
    """
    if choices(apex) > ENUMERATED:
        raise ValueError(
            f"{len(apex.sign)} contacts with {choices(apex):.3g} choices of statuses were given: at most {ENUMERATED} "
            f"can be gone through; `statuses_at_apex` finds one that is consistent"
        )
    found, coherent = [], True
    for choice in itertools.product(*apex.allowed):
        status = np.array(choice, int)
        coherent &= bool(np.linalg.det(piece(apex, status)) > 0)
        velocity = _velocity(apex, status)
        if velocity is not None and np.array_equal(cell(apex, velocity, status), status):
            found.append(status)
    return np.array(found, int).reshape(-1, len(apex.sign)), coherent
