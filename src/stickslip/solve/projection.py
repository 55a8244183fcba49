"""Nearest point that fulfils linear equations and inequalities, by an interior-point method."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

ITERATIONS, GAP, RESIDUAL = 60, 1e-11, 1e-9  # steps, complementarity, and residuals in units of the variables
BACK = 0.995  # share of the way to the nearest bound
SOFT = 1e-12  # compliance of equations, so that redundant ones have multipliers


class Projection(NamedTuple):
    """Nearest point, and the number of equations and inequalities that bind it."""

    point: np.ndarray  # (n,)
    binding: int


def nearest_point(a, b: np.ndarray, g, h: np.ndarray) -> Projection | None:
    """Minimise |z|²/2 under A z = b and G z ≥ h; None if no point is found, as where there is none.

    Parameters
    ----------
    a, g : (m, n) and (k, n) sparse, k > 0
    b, h : (m,) and (k,)

    Source
    ------
    Nocedal & Wright, doi:10.1007/978-0-387-40065-5, Algorithm 16.4 (Mehrotra's predictor and corrector).
    """
    z, y, w = np.zeros(a.shape[1]), np.zeros(len(b)), np.maximum(-h, 1.0)
    v = 1 / w  # multipliers of G z − w = h
    for _ in range(ITERATIONS):
        dual, equal, above, gap = z - a.T @ y - g.T @ v, a @ z - b, g @ z - w - h, v @ w / len(h)
        if gap < GAP and max(np.abs(r).max(initial=0.0) for r in (dual, equal, above / (1 + w))) < RESIDUAL:
            return Projection(z, len(b) + int((v > w).sum()))
        stiff = sparse.eye_array(len(z)) + g.T @ sparse.diags_array(v / w) @ g
        whole = sparse.block_array([[stiff, a.T], [a, -SOFT * sparse.eye_array(len(b))]])
        try:
            solve = splu(sparse.csc_array(whole)).solve  # its order by columns fills ten times less than by degrees
        except RuntimeError:  # singular
            return None
        excess = -v * w
        for corrected in (False, True):  # v w is to change by the excess
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
    """Longest step along which all values stay positive, at most that which makes the length one."""
    falls = step < 0
    return min(1 / BACK, (-value[falls] / step[falls]).min(initial=np.inf))
