"""An accepted state with what analyses of its stability share: linearised contacts, touching pairs and rattlers."""

from typing import NamedTuple

import numpy as np

from ..core.contacts.jacobian import Linearisation, blocks_of, linearise
from ..core.laws.builtin import SHARP, Law
from ..core.measure import touching
from ..core.state import SLIDE, State
from .freedom import Freedom, freedom, mass_weighted, stiffness_of, unsupported_grains


class LinearisedState(NamedTuple):
    """A state under a law, each contact held in its mode."""

    state: State
    law: Law
    line: Linearisation  # of all pairs in the list
    rows: np.ndarray  # touching pairs
    loose: np.ndarray  # (N,) bool, rattlers

    @property
    def backbone(self) -> Freedom:
        """Free coordinates without those of rattlers."""
        return freedom(self.state).without(self._loose_bodies)

    @property
    def supported(self) -> np.ndarray:
        """(C,) mask of the pairs in the list, without those of rattlers."""
        contacts, count, loose = self.state.contacts, len(self.line.closed), self._loose_bodies
        return ~loose[contacts.i[:count]] & ~loose[contacts.j[:count]]

    @property
    def mean_force(self) -> float:
        """Mean |F_n| of touching contacts [force]; zero without contacts."""
        return float(np.abs(self.line.force_n[self.rows]).mean()) if len(self.rows) else 0.0

    @property
    def mean_stiffness(self) -> float:
        """Mean dF_n/dδ of touching contacts [force/length]; zero without contacts."""
        return self.line.slope_n[self.rows].mean() if len(self.rows) else 0.0

    @property
    def at_limit(self) -> np.ndarray:
        """Rows of contacts at the Coulomb limit under sharp friction, without those of rattlers."""
        if self.law.coulomb != SHARP:
            return np.zeros(0, np.int64)
        slides = (self.state.contacts.mode[self.rows] == SLIDE) & (self.line.limit[self.rows] > 0)
        return self.rows[slides & self.supported[self.rows]]

    def dynamical_matrix(self, free: Freedom):
        """(n, n) sparse A = −M^(−1/2) J M^(−1/2) in the coordinates `free` [1/time²]."""
        blocks, _ = blocks_of(self.state, self.law, self.line)
        return mass_weighted(stiffness_of(self.state, self.line, blocks, free), free)

    @property
    def _loose_bodies(self) -> np.ndarray:
        return np.append(self.loose, np.zeros(len(self.state.walls.mass), bool))

    def with_modes(self, state: State) -> "LinearisedState":
        """The same contacts in the modes and with the slips of another state."""
        return self if state is self.state else self._replace(state=state, line=linearise(state, self.law))


def linearised(state: State, law: Law) -> LinearisedState:
    """Linearise an accepted state."""
    return LinearisedState(state, law, linearise(state, law), touching(state), unsupported_grains(state, law))
