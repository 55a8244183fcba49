"""Laws of rate-and-state friction: their names, and friction with its derivatives from logarithms.

Rows (w, s, s2) hold w = ln(V/V0), s = ln(V0 θ/D_c), and s2 for a second state θ2 with D_c2. Rows (a, b, b2, mu0, cut,
cut2) hold the parameters of a surface, with cut = V0/V1 and cut2 = V0/V2 for the cut-off velocities of the direct and
the evolution effect; b2 = 0 with one state. The laws themselves are in `_core/rate_state.h`.
"""

import numpy as np

from ....core.library import core

EVOLUTIONS = {"aging": 0, "slip": 1}
REFERENCES = {"aging": ("Dieterich1979", "Ruina1983"), "slip": ("Ruina1983",)}  # keys of references.bib
FORMS = {"logarithmic": 0, "regularized": 1}
CUT_OFF = 2


def form_code(form: str, cut: float, cut2: float) -> int:
    """Code of a form of the law, which is another one with cut-off velocities."""
    return CUT_OFF if cut > 0 or cut2 > 0 else FORMS[form]


def friction(form: int, logs, surface) -> np.ndarray:
    """Friction coefficient at rows of logarithms, for one surface or one for each row (N,)."""
    return _evaluate(form, logs, surface, 0)


def slopes(form: int, logs, surface) -> np.ndarray:
    """Derivatives of friction with respect to w, s and s2 (N, 3)."""
    return _evaluate(form, logs, surface, 1)


def curvatures(form: int, logs, surface) -> np.ndarray:
    """Second derivatives of friction: ww, ws, ws2, ss, ss2, s2s2 (N, 6)."""
    return _evaluate(form, logs, surface, 2)


def _evaluate(form: int, logs, surface, order: int) -> np.ndarray:
    logs, surfaces = np.array(logs, float, order="C", ndmin=2), np.array(surface, float, order="C", ndmin=2)
    out = np.empty((len(logs), (1, 3, 6)[order]))
    results = [out if k == order else None for k in range(3)]
    core.friction_of_rows(form, len(logs), logs, surfaces, len(surfaces), *results)
    return out if order else out[:, 0]
