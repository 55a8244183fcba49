"""Arrays that describe a deforming cell to the kernels."""

from typing import NamedTuple

import numpy as np

VECTORS, RATE, RATE_AHEAD, STRETCH, TURN, INVERSE_HALF, SINCE, PULL = range(8)


class Flow(NamedTuple):
    """What moves every grain and every contact in a step, written in place; few arrays, or kernels compile slowly."""

    matrix: np.ndarray  # (8, 3, 3)
    factor: np.ndarray  # (2, C + 1) of courses, mean over the step and at its end; the last is 1, for what follows none
    rate: np.ndarray  # (B, 6) of bodies, in the order of memory
    follows: np.ndarray  # (B, 6)
