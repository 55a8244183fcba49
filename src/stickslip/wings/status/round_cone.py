"""Contacts of spheres that open and close: the map g of `cone_apex` with round cones, by Newton's method.

A contact without force slides along V_t, which may have any direction, so that g is smooth within its cells but not
linear. A solution is verified by the rate of the return mapping; if none is found, nothing is proven.
"""

import numpy as np

from .cone_apex import (
    OPENS,
    ROUNDS,
    SLACK,
    SLIDES,
    SLIDES_BACK,
    STICKS,
    Apex,
    StatusSolution,
    solve_piece,
    stiffness_change,
)


def force_change(apex: Apex, solution: StatusSolution) -> np.ndarray:
    """(E, d) K (S − 1) V, what the statuses change in the force rates."""
    if apex.velocity.shape[1] == 2:
        return np.einsum("eab,eb->ea", stiffness_change(apex, solution.status), solution.velocity)
    return np.einsum("eab,eb->ea", apex.springs, round_cone_stretch(apex, solution.velocity)[0] - solution.velocity)


def round_cone_stretch(apex: Apex, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stretching of the springs at velocities in space: (E, 3) S V, its derivatives (E, 3, 3), and statuses (E,).

    This is the rate of the return mapping: V_t is shortened to −m V_n at a contact without force, and its component
    along the force to −m V_n at a contact on the cone.
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
    """Search for statuses in space by Newton's method from several velocities.

    Returns
    -------
    StatusSolution, int
        verified: S V is the rate of the return mapping. The sign of the determinant of the derivative of g, which is
        that of det k/det k₀; 0 if nothing is found, which proves nothing
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
    """(3E, 3E) 1 + Z K (S′ − 1)."""
    size = apex.velocity.size
    change = np.einsum("eab,ebc->eac", apex.springs, by - np.eye(3))
    columns = apex.compliance.reshape(size, -1, 3)
    return np.eye(size) + np.einsum("aeb,ebc->aec", columns, change).reshape(size, size)


def _newton_on_round_cones(apex: Apex, velocity: np.ndarray) -> np.ndarray | None:
    """V with g(V) = V₀ by Newton's method with shorter steps where the residual would not fall; None if it fails."""

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
