"""Nearest point that fulfils linear equations and inequalities, by an interior-point method."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

ITERATIONS, GAP, RESIDUAL = 60, 1e-11, 1e-9  # steps, complementarity, and residuals in units of the variables
BACK = 0.995  # share of the way to the nearest bound
SOFT = 1e-12  # compliance of equations, so that redundant ones have multipliers


class Projection(NamedTuple):
    """Nearest point z with its multipliers: z = Aᵀl + Gᵀv."""

    point: np.ndarray  # (n,) z
    of_equations: np.ndarray  # (m,) l
    of_inequalities: np.ndarray  # (k,) v, not negative
    slack: np.ndarray  # (k,) G z − h, positive


def nearest_point(a, b: np.ndarray, g, h: np.ndarray) -> Projection | None:
    """Minimise |z|²/2 under A z = b and G z ≥ h; None if no point is found, as where there is none.

    Parameters
    ----------
    a, g : (m, n) and (k, n) sparse
    b, h : (m,) and (k,)

    Source
    ------
    Nocedal & Wright, doi:10.1007/978-0-387-40065-5, Algorithm 16.4 (Mehrotra's predictor and corrector).
    """
    z, l, w = np.zeros(a.shape[1]), np.zeros(len(b)), np.maximum(-h, 1.0)
    v = 1 / w
    for _ in range(ITERATIONS):
        dual, equal, above = z - a.T @ l - g.T @ v, a @ z - b, g @ z - w - h
        gap = v @ w / max(len(h), 1)
        if gap < GAP and max(np.abs(r).max(initial=0.0) for r in (dual, equal, above / (1 + w))) < RESIDUAL:
            return Projection(z, l, v, w)
        stiff = sparse.eye_array(len(z)) + g.T @ sparse.diags_array(v / w) @ g
        whole = sparse.block_array([[stiff, a.T], [a, -SOFT * sparse.eye_array(len(b))]])
        try:
            solve = splu(
                sparse.csc_array(whole)
            ).solve  # by columns: the order of linear.factorised fills 10 times more
        except RuntimeError:  # singular
            return None

        def step(product, solve=solve, z=z, v=v, w=w, dual=dual, equal=equal, above=above):
            """Newton step towards v w = v w + product."""
            right = -dual + g.T @ ((product - v * above) / w)
            dz, dl = np.split(solve(np.concatenate([right, -equal])), [len(z)])
            dw = g @ dz + above
            return dz, -dl, (product - v * dw) / w, dw

        _, _, dv, dw = step(-v * w)
        aim = ((v + _reach(v, dv) * dv) @ (w + _reach(w, dw) * dw) / max(len(h), 1) / gap) ** 3 * gap
        dz, dl, dv, dw = step(aim - v * w - dv * dw)
        length = BACK * min(_reach(v, dv), _reach(w, dw)) if len(h) else 1.0
        z, l, v, w = z + length * dz, l + length * dl, v + length * dv, w + length * dw
        if not np.isfinite(z).all():
            return None
    return None


def _reach(value: np.ndarray, step: np.ndarray) -> float:
    """Longest step, at most 1/BACK, along which all values stay positive."""
    falls = step < 0
    return min(1 / BACK, (-value[falls] / step[falls]).min(initial=np.inf))
