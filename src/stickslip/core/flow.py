"""Arrays that describe a deforming cell to the kernels."""

from typing import NamedTuple

import numpy as np

# rows of `Flow.matrix`: the cell's vectors at the positions; L; L predicted at the end of the step, for dashpots; A;
# effect of half a step of L on a velocity; (1 + ½ dt L)⁻¹; deformation since blocks were chosen; L̇ of free components
VECTORS, RATE, RATE_AHEAD, STRETCH, TURN, INVERSE_HALF, SINCE, PULL = range(8)


class Flow(NamedTuple):
    """Cell deformation and time profiles of a step, written in place. Only a few arrays are used, because
    many would slow compilation."""

    matrix: np.ndarray  # (8, 3, 3)
    factor: np.ndarray  # (2, C + 1) of courses, mean over the step and at its end; the last is 1, for none
    rate: np.ndarray  # (B, 6) of bodies, in the order of memory
    follows: np.ndarray  # (B, 6)

    @property
    def courses(self) -> int:
        """Number of time profiles."""
        return self.factor.shape[1] - 1
