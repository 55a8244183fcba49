"""Events at the end of a linear piece of a path: a contact reaches the cone or its apex, or a pair closes.

Within a piece, forces and positions are linear in the load. Where the nonlinearity of the packing would matter, an
event is approached in several steps. Otherwise the two contacts of a disk, whose forces vanish together, would seem to
reach the cone just before the forces are zero.
"""

from typing import NamedTuple

import numpy as np

from ... import State
from ...measure import branch_vectors
from .lcp import SLACK
from .rattling import NUDGE, gaps
from .status import ContactStatus

APEX = 1e-6  # normal force, in mean normal forces, at which a contact is at the apex of the cone
NEAR_APEX = 1e-4  # normal force, in mean normal forces, below which a linear step reaches the apex to within APEX
NEAR_CONE = 1e-5  # distance from the cone over the normal force, below which a linear step reaches the cone
APPROACH = 0.9  # share of the distance to an event that a linear step would miss; then c is recomputed
TOGETHER = 1e-9  # share of an increment within which events are simultaneous
REACHES, CLOSES, AT_APEX, NEARS, INCREMENT = "reaches the cone", "closes", "at the apex", "nears an event", "increment"


class Event(NamedTuple):
    """Event on a load path."""

    load: float  # in legs of the load
    kind: str  # "reaches the cone", "sticks again", "opens", "closes", …, or why the path ends
    i: int  # bodies of the contact, or one body; −1 if there is none
    j: int


class Fork(NamedTuple):
    """Load at which several combinations of statuses were consistent, and the one chosen."""

    load: float  # in legs of the load
    contacts: tuple[tuple[int, int], ...]  # bodies of the contacts whose statuses differ
    taken: tuple[str, ...]  # status of each of them: "sticks", "slides", "slides back" or "opens"
    others: tuple[tuple[str, ...], ...]  # the same for the other combinations
    forces: bool  # True if the force rates differ; False if only a motion is undetermined


class NextEvent(NamedTuple):
    """End of a linear piece."""

    step: float  # share of the increment
    contacts: np.ndarray  # numbers of all simultaneous contacts; from M on: pairs that do not touch yet
    kind: str


def next_event(
    increment, force: np.ndarray, rate: np.ndarray, known: np.ndarray, choice: ContactStatus, left: float
) -> NextEvent:
    """Find the end of a linear piece that begins with given forces.

    Parameters
    ----------
    increment : Increment
    force, rate : (M, 2) forces and their rates over the whole increment [force]
    known : (M,) bool, contacts that were on the cone with a consistent status; those that stick leave the cone
    left : remaining fraction of the increment
    """
    first = NextEvent(left, np.zeros(0, int), INCREMENT)
    reached = _shares_to_cone(increment, force, rate, known, choice)
    first = _first_on_cone(increment, force, reached, first)
    first = _first_on_apex(increment, force, rate, first, left)
    return _first_closing(increment, choice, first)


def _shares_to_cone(increment, force, rate, known, choice) -> np.ndarray:
    """(M,) fractions of the increment after which sticking contacts reach the cone, on either side."""
    m, reached = increment.matrix, np.full(len(force), np.inf)
    if m.width == 3:
        sticks = ~choice.sliding
        reached[sticks] = _shares_to_round_cone(m.mu[sticks], force[sticks], rate[sticks], known[sticks])
        reached[increment.paired & (force[:, 0] <= increment.faint)] = np.inf
        return reached
    for side in (1.0, -1.0):
        margin = m.mu * force[:, 0] - side * force[:, 1]
        slope = m.mu * rate[:, 0] - side * rate[:, 1]
        here = known & (side * force[:, 1] > 0)
        leaves = ~choice.sliding & ~here & (slope < -SLACK * np.abs(rate).max(initial=0.0))
        time = np.where(leaves, np.maximum(margin, 0.0) / np.where(leaves, -slope, 1.0), np.inf)
        reached = np.minimum(reached, time)
    at = np.where(np.isfinite(reached), reached, 0.0)
    reached[increment.paired & (force[:, 0] + at * rate[:, 0] <= increment.faint)] = np.inf
    return reached


def _shares_to_round_cone(mu: np.ndarray, force: np.ndarray, rate: np.ndarray, on: np.ndarray) -> np.ndarray:
    """(C,) fractions after which |F_t| = μ F_n, the first positive root of a quadratic; infinite if there is none.

    Contacts `on` the cone, (C,) bool, leave it first.
    """
    sign = np.append(np.ones(1), -np.ones(force.shape[1] - 1))
    weight = np.where(np.arange(force.shape[1]) == 0, mu[:, None], 1.0)
    start, slope = weight * force, weight * rate
    # (μ F_n)² − |F_t|² = a x² + 2 b x + c, positive at first
    a, b, c = (slope * slope) @ sign, (start * slope) @ sign, (start * start) @ sign
    c = np.where(on, 0.0, np.maximum(c, 0.0))
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    falls = (b < 0) & ~on & (b * b >= a * c)
    rises = (b > 0) & (a < 0)
    out = np.where(falls, c / np.where(falls, root - b, 1.0), np.inf)
    return np.where(rises, (b + root) / np.where(rises, -a, 1.0), out)


def _first_on_cone(increment, force, reached, first: NextEvent) -> NextEvent:
    """First contact that reaches the cone, if it does so before the end found so far."""
    m, soonest = increment.matrix, reached.min(initial=np.inf)
    # the force on a disk with two contacts turns with the line between them, which a linear step predicts poorly
    far = m.mu * force[:, 0] - np.linalg.norm(force[:, 1:], axis=1) > NEAR_CONE * force[:, 0]
    early = np.where(increment.paired & far, APPROACH * reached, np.inf).min(initial=np.inf)
    if early < min(soonest, first.step):
        return NextEvent(float(early), first.contacts, NEARS)
    if soonest < first.step:
        return NextEvent(float(soonest), np.flatnonzero(reached <= soonest + TOGETHER), REACHES)
    return first


def _first_on_apex(increment, force, rate, first: NextEvent, left: float) -> NextEvent:
    """First contact whose force vanishes."""
    falls = rate[:, 0] < -SLACK * np.abs(rate).max(initial=0.0)
    time = np.where(falls, np.maximum(force[:, 0], 0.0) / np.where(falls, -rate[:, 0], 1.0), np.inf)
    soonest = time.min(initial=np.inf)
    early = np.where(force[:, 0] > NEAR_APEX * increment.mean, APPROACH * time, np.inf).min(initial=np.inf)
    if early < first.step and soonest <= left:
        return NextEvent(float(early), np.zeros(0, int), NEARS)
    if soonest <= first.step:
        # contacts of disks that are held by nothing else lose their forces together, to within APEX
        faint = force[:, 0] + soonest * rate[:, 0] <= APEX * increment.mean
        return NextEvent(
            float(soonest), with_partners(increment, np.flatnonzero(faint | (time <= soonest + TOGETHER))), AT_APEX
        )
    met = first.contacts
    if first.kind == REACHES and (force[met, 0] + first.step * rate[met, 0] <= APEX * increment.mean).any():
        return first._replace(kind=AT_APEX)
    return first


def with_partners(increment, contacts: np.ndarray) -> np.ndarray:
    """Given contacts plus the other contact of each disk that has two, since both reach the apex together."""
    chosen = np.zeros(increment.matrix.count, bool)
    chosen[contacts] = True
    while True:
        pulled = np.zeros(increment.state.n_bodies, bool)
        pulled[increment.ends[chosen].ravel()] = True
        more = ((pulled & increment.has_two)[increment.ends]).any(axis=1) | chosen
        if np.array_equal(more, chosen):
            return np.flatnonzero(chosen)
        chosen = more


def open_pairs(state: State, loose: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows of the pair list that are not among `rows` and do not involve rattlers."""
    rest = np.setdiff1d(np.arange(int(state.contacts.count[0])), rows)
    held = np.append(~loose, np.ones(state.n_bodies - len(loose), bool))
    return rest[held[state.contacts.i[rest]] & held[state.contacts.j[rest]]]


def _first_closing(increment, choice: ContactStatus, first: NextEvent) -> NextEvent:
    """First pair that closes."""
    state, rows = increment.state, increment.gap_rows
    moves = increment.matrix.free.spread(choice.velocity)[:, :3]
    normal, gap = gaps(state, rows)
    apart = moves[state.contacts.i[rows]] - moves[state.contacts.j[rows]]
    if increment.matrix.free.length:
        apart = apart + branch_vectors(state)[rows] @ increment.matrix.free.strain(choice.velocity).T
    closing = np.einsum("ck,ck->c", apart, normal)
    small = float(state.grains.radius.min())
    reach = np.maximum(gap, 0.0) + NUDGE * small  # slightly beyond zero, so that they touch
    time = np.where(closing < 0, reach / np.where(closing < 0, -closing, 1.0), np.inf)
    soonest = time.min(initial=np.inf)
    if not soonest < first.step:
        return first
    # a pair whose bodies move past each other overlaps more than a linear step predicts
    aside = float((apart[time.argmin()] ** 2).sum() - closing[time.argmin()] ** 2) * soonest**2
    if increment.matrix.springs[:, 0, 0].max() * aside / (2 * small) > APEX * increment.mean:
        return NextEvent(float(APPROACH * soonest), np.zeros(0, int), NEARS)
    return NextEvent(float(soonest), increment.matrix.count + np.flatnonzero(time <= soonest + TOGETHER), CLOSES)
