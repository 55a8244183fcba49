"""Forecasts of the next event of a quasi-static path, from quantities that vanish there as a known power."""

from typing import NamedTuple

import numpy as np

COUPLED = 0.5  # overlap of two real modes from which they are followed


class Signs(NamedTuple):
    """Series along a path since its last event; strains count upwards."""

    strain: np.ndarray  # (S,)
    softest: np.ndarray  # (S,) smallest real eigenvalue [1/time²]
    loss_ahead: np.ndarray  # (S,) strain to the loss of a contact that leaves an unstable state
    couples: list[np.ndarray]  # (K, 3) of each step: mean eigenvalue, squared gap, overlap of coupled real modes
    pairs: np.ndarray  # (S,) complex pairs
    events: np.ndarray  # (E,) strains of all events so far


class Forecast(NamedTuple):
    what: str
    made: float
    strain: float
    low: float
    high: float

    def signed(self, sign):
        return self


def forecast(signs: Signs) -> list[Forecast]:
    return []
