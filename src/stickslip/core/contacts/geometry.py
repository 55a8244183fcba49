"""Geometry of pairs."""

import numpy as np

from ..library import core


def shifts(contacts, cell) -> np.ndarray:
    """Periodic shift cellᵀ·image of every pair, (C, 3) [length]."""
    out = np.empty((int(contacts.count[0]), 3))
    core.find_shifts(contacts.image, len(out), np.ascontiguousarray(cell), out)
    return out
