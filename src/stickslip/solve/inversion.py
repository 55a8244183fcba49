"""From forces to a packing: overlap and slip of contacts with given forces, and nearest points under constraints."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ..core.contacts.jacobian import Linearisation, linearise
from ..core.contacts.neighbors import with_neighbor_list
from ..core.laws.builtin import Law
from ..core.measure import branch_vectors
from ..core.state import STICK, assembly, box, disks

INVERSIONS, BISECTIONS = 30, 60
ROUND_OFF = 1e-15  # round-off of a force, and of the sum of two radii
ITERATIONS, GAP, RESIDUAL = 60, 1e-11, 1e-9  # nearest point: most steps, largest complementarity gap and residual
BACK = 0.995  # share of the way to the nearest bound that a step takes
SOFT = 1e-12  # compliance of the equations, so that redundant ones have multipliers too


def overlap_of_force(law: Law, radius: np.ndarray, force_n: np.ndarray) -> tuple[np.ndarray, Linearisation]:
    """(C,) overlaps that give normal forces `force_n`, by Newton iteration, and the law evaluated at them."""
    most = radius.min(axis=0)
    overlap = 1e-3 * most
    for _ in range(INVERSIONS):
        line = _evaluate(law, radius, overlap)
        if not (line.force_n > 0).all():
            break
        if (np.abs(line.force_n / force_n - 1) < ROUND_OFF * (1 + radius.sum(axis=0) / overlap)).all():
            return overlap, line
        overlap = overlap * (force_n / line.force_n) ** (line.force_n / (overlap * line.slope_n))
        if not (overlap < most).all():
            c = int(np.argmax(overlap / most))
            raise ValueError(
                f"the normal force {force_n[c]:.4g} needs an overlap above the radius {most[c]:.4g}: check kn, which "
                f"must be in the units of the forces and lengths"
            )
    raise ValueError("the normal force of the law must grow from zero with the overlap: use another law")


def slip_of_force(law: Law, radius: np.ndarray, overlap: np.ndarray, force_t: np.ndarray, line: Linearisation):
    """(C,) magnitudes of the slips that give tangential forces `force_t`, by bisection up to the Coulomb limit."""
    low, high = np.zeros(len(overlap)), line.limit / line.stiffness_t
    for _ in range(BISECTIONS):
        slip = (low + high) / 2
        short = _evaluate(law, radius, overlap, slip).secant * slip < force_t
        low, high = np.where(short, slip, low), np.where(short, high, slip)
    return (low + high) / 2


def _evaluate(law: Law, radius: np.ndarray, overlap: np.ndarray, slip=0.0) -> Linearisation:
    """Law evaluated at separate contacts of disks."""
    count = len(overlap)
    place = np.zeros((2, count, 2))
    place[1, :, 0], place[..., 1] = radius.sum(axis=0) - overlap, 4 * radius.max() * np.arange(count)
    state = with_neighbor_list(assembly(disks(place.reshape(-1, 2), radius.ravel()), cell=box(dim=2)), law)
    contacts = state.contacts._replace(slip=state.contacts.slip.copy(), mode=state.contacts.mode.copy())
    contacts.pair[:count], contacts.mode[:count], contacts.slip[:count, 1] = branch_vectors(state), STICK, slip
    return linearise(state._replace(contacts=contacts), law)


class Projection(NamedTuple):
    """Nearest point, and the number of equations and active inequalities."""

    point: np.ndarray  # (n,)
    binding: int
    pushes: np.ndarray  # (k,) multipliers of the inequalities


def nearest_point(a, b: np.ndarray, g, h: np.ndarray, bent=None, around=0.0) -> Projection | None:
    """Minimise |z|²/2 subject to A z = b and G z ≥ h; None if no point is found.

    Parameters
    ----------
    a, g : (m, n) and (k, n) sparse, k > 0
    b, h : (m,) and (k,)
    bent, around : (n, n) sparse H and (n,) z₀ of a further term (z − z₀)ᵀ H (z − z₀)/2; default: no such term

    Source
    ------
    Nocedal & Wright, doi:10.1007/978-0-387-40065-5, Algorithm 16.4 (Mehrotra's predictor and corrector).
    """
    z, y, w = np.zeros(a.shape[1]), np.zeros(len(b)), np.maximum(-h, 1.0)
    metric = sparse.eye_array(len(z)) if bent is None else sparse.eye_array(len(z)) + bent
    pull = np.zeros(len(z)) if bent is None else bent @ around
    v = 1 / w  # multipliers of G z − w = h
    for _ in range(ITERATIONS):
        dual, equal, above, gap = metric @ z - pull - a.T @ y - g.T @ v, a @ z - b, g @ z - w - h, v @ w / len(h)
        if gap < GAP and max(np.abs(r).max(initial=0.0) for r in (dual, equal, above / (1 + w))) < RESIDUAL:
            return Projection(z, len(b) + int((v > w).sum()), v)
        stiff = metric + g.T @ sparse.diags_array(v / w) @ g
        whole = sparse.block_array([[stiff, a.T], [a, -SOFT * sparse.eye_array(len(b))]])
        try:
            solve = splu(
                sparse.csc_array(whole)
            ).solve  # the default column ordering causes a tenth of the fill of a minimum-degree ordering
        except RuntimeError:  # singular
            return None
        excess = -v * w
        for corrected in (False, True):  # predictor, then corrector: the products v w change by `excess`
            step = solve(np.concatenate([g.T @ ((excess - v * above) / w) - dual, -equal]))
            dz, dy = step[: len(z)], -step[len(z) :]
            dw = g @ dz + above
            dv = (excess - v * dw) / w
            if not corrected:
                ahead = (v + _reach(v, dv) * dv) @ (w + _reach(w, dw) * dw) / len(h)
                excess = (ahead / gap) ** 3 * gap - v * w - dv * dw
        length = BACK * min(_reach(v, dv), _reach(w, dw))
        z, y, v, w = z + length * dz, y + length * dy, v + length * dv, w + length * dw
        if not np.isfinite(z).all():
            return None
    return None


def _reach(value: np.ndarray, step: np.ndarray) -> float:
    """Longest step along which no value becomes negative, at most 1/BACK, which times BACK is a full step."""
    falls = step < 0
    return min(1 / BACK, (-value[falls] / step[falls]).min(initial=np.inf))
