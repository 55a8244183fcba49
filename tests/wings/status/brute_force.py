"""Contact status the slow obvious way: dense matrices, every status by itself, linear programmes where k is singular.

It shares nothing with the solver but the fields of `Matrices` and `stiffness_matrix`.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from stickslip.wings.status.matrices import stiffness_matrix

# share of the largest singular value of k below which one is zero
NULL = 1e-9
# a singular value of A_SS is certainly zero below the first share of the unit of its entries, certainly not above the
# second: what is exactly singular comes out below 1e-16, whatever else above 1e-11
RANK = (1e-14, 1e-12)
MISSED = (1e-14, 1e-9)  # share of q outside of the range of a singular A_SS, certainly none and certainly some
FAR = 1e9  # over q: slip rates that come of dividing by round-off
EDGE = 1e-8  # share of the largest rate within which round-off may decide on its sign, amplified as the rates are
SAME = 1e-6  # share of the largest rate up to which two answers are one


class Dense(NamedTuple):
    """The problem of the critical contacts, from dense matrices."""

    a: np.ndarray
    q: np.ndarray
    drives: bool  # no status balances the load: a motion that moves no contact takes it
    k0: np.ndarray
    inverse: np.ndarray  # of k0, on loads that do not drive its null motions
    h: np.ndarray
    load: np.ndarray


class One(NamedTuple):
    """A status that is consistent to within round-off."""

    slides: np.ndarray
    slip: np.ndarray
    rate: np.ndarray
    sign: float  # of det k(S)/det k0, 0 if singular, NaN if round-off decides whether it is


class Answer(NamedTuple):
    """Statuses with the same rates."""

    rate: np.ndarray
    slip: np.ndarray
    slides: np.ndarray
    signs: frozenset  # of all of them
    sure: bool  # that an answer exists whatever round-off does


def dense(m, load, critical) -> Dense:
    """A = 1 − Gᵀ k₀⁺ H and q = −Gᵀ k₀⁺ b, where k₀⁺ leaves out motions that nothing resists."""
    k0 = stiffness_matrix(m, np.zeros(m.count, bool)).toarray()
    c = m.c.toarray()
    normal, along = c[:, 0 :: m.width][:, critical], c[:, 1 :: m.width][:, critical]
    h = along * (m.springs[critical, 1, 1] * m.sign[critical])
    g = normal * m.slope[critical] + along * m.sign[critical]
    u, values, _ = np.linalg.svd(k0)
    left = u[:, values < NULL * values[0]]
    # along the null motions: no mean translation, no spin of spheres that roll, nothing of grains without contacts
    moves = [move for move in (m.free.axis == np.arange(3)[:, None]).astype(float) if np.abs(move @ k0).max() < NULL]
    own = left.T * ((m.free.axis >= 3) | ~c.any(axis=1))
    still = np.linalg.svd(np.array([*moves, *own]).reshape(-1, len(k0)))[2][: left.shape[1]]
    bordered = np.block([[k0, left], [still, np.zeros((len(still),) * 2)]])
    inverse = np.linalg.inv(bordered)[: len(k0), : len(k0)]
    assert np.abs(left.T @ h).max(initial=0.0) < 1e-9  # so that it is left out of every k(S)
    drives = np.abs(left.T @ load).max(initial=0.0) > 1e-9 * np.abs(load).max()
    both = _refined(k0, inverse, np.column_stack([h, load]) - left @ (left.T @ np.column_stack([h, load])))
    seen = (g.astype(np.longdouble).T @ both).astype(float)
    return Dense(np.eye(len(critical)) - seen[:, :-1], -seen[:, -1], drives, k0, inverse, h, load)


def _refined(k0, inverse, columns):
    """The answers of k₀ to columns, refined with residuals in extended precision."""
    wide, out = k0.astype(np.longdouble), (inverse @ columns).astype(np.longdouble)
    for _ in range(3):
        out = out + inverse @ (columns - wide @ out).astype(float)
    return out


def subsets(n):
    """Every status of n contacts."""
    return [np.array([(number >> k) & 1 for k in range(n)], bool) for number in range(1 << n)]


def smallest(part, unit):
    """Smallest singular value of a square part of A, over the unit of its entries."""
    return np.linalg.svd(part, compute_uv=False)[-1] / unit if len(part) else 1.0


def minor_signs(a, unit) -> np.ndarray:
    """Signs of det A_SS of all statuses; 0 where it is singular, NaN where round-off decides whether it is."""
    out = []
    for slides in subsets(len(a)):
        part = a[np.ix_(slides, slides)]
        value = smallest(part, unit)
        out.append(0 if value < RANK[0] else np.nan if value < RANK[1] else round(np.linalg.slogdet(part)[0]))
    return np.array(out, float)


def answers(a, q, unit, floor=0.0) -> list[Answer]:
    """All solutions of w = A λ + q ≥ 0, λ ≥ 0, wᵀλ = 0 that differ; of a face of solutions its ends.

    Rates below `floor` are round-off.
    """
    results = []
    for slides in subsets(len(q)):
        part = a[np.ix_(slides, slides)]
        value, candidates = smallest(part, unit), []
        if value > RANK[0]:
            slip = np.zeros(len(q))
            slip[slides] = np.linalg.solve(part, -q[slides])
            if value > RANK[1] or np.abs(slip).max() < FAR * np.abs(q).max():
                candidates.append((slip, np.linalg.slogdet(part)[0] if value > RANK[1] else np.nan))
        if value < RANK[1]:
            ends, sure = on_a_face(a, q, slides)
            candidates += [(slip, 0.0 if sure and value < RANK[0] else np.nan) for slip in ends]
        for slip, sign in candidates:
            rate = np.where(slides, slip, -(a @ slip + q))
            inside = np.where(slides, rate, -rate).min(initial=np.inf)
            if inside >= -max(EDGE * np.abs(rate).max(initial=0.0), floor):
                results.append(One(slides, slip, rate, sign))
    return gathered(results, floor)


def gathered(solutions: list[One], floor) -> list[Answer]:
    """Statuses with the same rates, together.

    On an edge, k rates are zero. If all 2^k statuses that differ there have one sign, the answer stays whatever
    round-off does, since the map of rates is one-to-one around it; where signs differ it may part in two or vanish.
    """
    groups = []
    for solution in solutions:
        for group in groups:
            if same(solution.rate, group[0].rate, floor):
                group.append(solution)
                break
        else:
            groups.append([solution])
    return [_answer(group, floor) for group in groups]


def _answer(group: list[One], floor) -> Answer:
    best = min(group, key=lambda answer: {1: 0, -1: 1, 0: 2}.get(answer.sign, 3))
    edge = (np.abs(best.rate) <= max(EDGE * np.abs(best.rate).max(initial=0.0), floor)).sum()
    signs = frozenset(answer.sign for answer in group)
    vague = any(np.isnan(sign) for sign in signs)
    sure = not vague and (0.0 in signs or (len(signs) == 1 and len(group) == 1 << edge))
    return Answer(best.rate, best.slip, best.slides, signs, sure)


def same(rates, other, floor=0.0):
    """Whether two vectors of rates are one; differences below `floor` are round-off."""
    size = max(np.abs(rates).max(initial=0.0), np.abs(other).max(initial=0))
    return np.abs(rates - other).max(initial=0.0) <= max(SAME * size, floor)


def on_a_face(a, q, slides) -> tuple[list[np.ndarray], bool]:
    """Ends of the slip rates of a singular status, by linear programmes; and whether it has any beyond round-off."""
    part, size = a[np.ix_(slides, slides)], max(np.abs(q).max(), 1e-300)
    u, values, vt = np.linalg.svd(part)
    null = values <= max(1e-10 * values[0], values[-1])
    missed = np.abs(u[:, null].T @ q[slides]).max() / size
    if missed > MISSED[1]:
        return [], True
    base = -vt[~null].T @ ((u[:, ~null].T @ q[slides] / size) / values[~null])
    turn = vt[null].T
    rows = np.vstack([turn, a[np.ix_(~slides, slides)] @ turn])
    at = np.concatenate([base, a[np.ix_(~slides, slides)] @ base + q[~slides] / size])
    rows = np.where(np.abs(rows) < 1e-10, 0.0, rows)
    out = []
    for way in (1.0, -1.0):
        program = linprog(way * turn.sum(axis=0), A_ub=-rows, b_ub=at + 1e-10, bounds=(None, None))
        if program.status == 0:
            slip = np.zeros(len(q))
            slip[slides] = size * (base + turn @ program.x)
            out.append(slip)
    if len(out) == 1:  # the other end is at infinity
        out.append(_further(out[0], slides, turn, size))
    return out, missed < MISSED[0]


def _further(slip, slides, turn, size):
    """Another place on a face with one end at infinity."""
    beyond = slip.copy()
    beyond[slides] += size * turn.sum(axis=1) * np.sign(turn.sum())
    return beyond


def force_rates(m, problem: Dense, critical, answer: Answer) -> np.ndarray:
    """(M, 2) rates of all contact forces."""
    v = problem.inverse @ (problem.load + problem.h @ answer.slip)
    relative = (m.c.T @ v).reshape(-1, m.width)
    stretch = relative.copy()
    rows = critical[answer.slides]
    stretch[rows, 1] = -m.slope[rows] * m.sign[rows] * relative[rows, 0]
    return np.stack([-(m.springs[k] @ stretch[k]) for k in range(m.count)])


def alike(m, problem: Dense, critical, group: list[Answer]) -> bool:
    """Whether all answers have the same contact forces.

    Slip rates that differ by x and leave all forces alike have A x = 0, so that A is singular on what slides in either.
    """
    slides = np.any([answer.slides for answer in group], axis=0)
    if smallest(problem.a[np.ix_(slides, slides)], max(1.0, np.abs(problem.a).max())) > RANK[1]:
        return False
    forces = [force_rates(m, problem, critical, answer) for answer in group]
    size = max(np.abs(f).max() for f in forces)
    return all(np.abs(f - forces[0]).max() <= 1e-7 * size for f in forces)
