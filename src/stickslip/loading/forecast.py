"""Forecasts of the next event of a quasi-static path, from quantities that vanish there as a known power.

Near a saddle node the strain that is left is d = A λ² + B λ³ + …, where λ is the smallest real eigenvalue; the second
term dominates far from it if a contact of stiffness √overlap is about to open. Near the birth of a complex pair the
squared gap between two real eigenvalues is linear in the strain. A contact reaches the Coulomb limit, or opens, where
the linear motion ahead says so.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..core.readable import readable

COUPLED = 0.5  # overlap of the modes of two real eigenvalues from which these are followed
SAME = 0.05  # relative change of their mean from step to step
WINDOWS = (3, 4, 5, 6)  # steps from which the strain of an event is extrapolated
FAR = 6.0  # strain steps beyond which nothing is forecast
LEVEL = 0.8  # of the intervals
SADDLE, PAIR, CONTACT = "softest eigenvalue", "gap of two real eigenvalues", "motion of contacts ahead"
# Quantiles of ln(strain left / strain left by the extrapolation) where the event came, that with the scatter of the
# windows contain LEVEL of them: of packings that `python -m benchmarks forecast` does not use, and of the saddle nodes
# of the reference catalogue with even numbers of packings
CALIBRATED = {SADDLE: (-1.0, 0.1, 1.4), PAIR: (-0.7, 0.4, 1.7), CONTACT: (-0.45, -0.03, 0.9)}


class Signs(NamedTuple):
    """Series along a path since its last event; strains count upwards."""

    strain: np.ndarray  # (S,)
    softest: np.ndarray  # (S,) smallest real eigenvalue [1/time²]
    loss_ahead: np.ndarray  # (S,) strain to the loss of a contact that leaves an unstable state
    couples: list[np.ndarray]  # (K, 3) of each step: mean eigenvalue, squared gap, overlap of coupled real modes
    pairs: np.ndarray  # (S,) complex pairs
    events: np.ndarray  # (E,) strains of all events so far


@readable(head=lambda one: str(one))
class Forecast(NamedTuple):
    """Forecast of the strain of the next event, or of the next complex pair, with an interval of 80 %.

    The interval holds if the event comes at all: it contained the strain of 80 % of those that came in other packings.
    It is widened by the scatter of the extrapolations from several windows of steps. Many announced events do not come,
    or much later, because the contact that is lost only makes the packing move a little: see the documentation.
    """

    of: str  # "event" or "pair"
    basis: str  # what it rests on
    made: float  # strain at which it was made
    strain: float
    low: float
    high: float
    windows: int  # number of extrapolations

    def __str__(self) -> str:
        return (
            f"next {self.of} forecast at strain {self.strain:.6g} ({100 * LEVEL:.0f} % interval {self.low:.6g} to "
            f"{self.high:.6g}), from the {self.basis} up to {self.made:.6g}"
        )

    def signed(self, sign: int) -> "Forecast":
        """Forecast of a path whose strain falls, if the sign is −1."""
        return self._replace(**{name: sign * getattr(self, name) for name in ("made", "strain", "low", "high")})


def forecast(signs: Signs) -> list[Forecast]:
    """Forecast of the next event, and of the next pair, from the last steps of a path; without a sign there is none.

    Of an event it is the earlier one of a saddle node and of the loss of a contact.
    """
    if not len(signs.strain):
        return []
    events = [left for left in (extrapolations(signs, SADDLE), extrapolations(signs, CONTACT)) if len(left[1])]
    chosen = [("event", *min(events, key=lambda one: np.median(one[1])))] if events else []
    couples = extrapolations(signs, PAIR)
    chosen += [("pair", *couples)] if len(couples[1]) else []
    return [_with_interval(of, basis, float(signs.strain[-1]), left) for of, basis, left in chosen]


def extrapolations(signs: Signs, basis: str) -> tuple[str, np.ndarray]:
    """Strains that are left from the last step, extrapolated from several windows; none if most windows give none."""
    step = float(np.diff(signs.strain[-2:]).sum())
    found = {SADDLE: _to_saddle_node, PAIR: _to_pair, CONTACT: _to_loss}[basis](signs)
    left = np.array([value for value in found if 0 < value <= FAR * step])
    return basis, left if 2 * len(left) > len(found) else left[:0]


def _with_interval(of: str, basis: str, made: float, left: np.ndarray) -> Forecast:
    middle = float(np.median(left))
    low, shift, high = CALIBRATED[basis]
    scatter = float(np.abs(np.log(left / middle)).max())
    ends = (middle * np.exp(low - scatter), middle * np.exp(shift), middle * np.exp(high + scatter))
    low, strain, high = (made + float(end) for end in ends)
    return Forecast(of, basis, made, strain, low, high, len(left))


def _to_saddle_node(signs: Signs) -> list[float]:
    """Strains to the zero of the softest eigenvalue, with γ = γ_c − A λ² − B λ³ in each window."""
    found = []
    for width in WINDOWS:
        strain, value = signs.strain[-width:], signs.softest[-width:]
        if len(strain) < width or not (np.isfinite(value).all() and (value > 0).all() and (np.diff(value) < 0).all()):
            continue
        found.append(zero_of_power(strain, value) - strain[-1])
    return found


def zero_of_power(strain: np.ndarray, value: np.ndarray) -> float:
    """Strain γ_c at which λ vanishes, from γ = γ_c − A λ² − B λ³ by least squares; exact for three points.

    Examples
    --------
    >>> strain = np.array([0.0, 0.1, 0.2])
    >>> round(zero_of_power(strain, np.sqrt(1 - strain)), 9)
    1.0
    """
    size = value / value[0]
    columns = np.stack([np.ones_like(size), -(size**2), -(size**3)], axis=1)
    return float(np.linalg.lstsq(columns, strain - strain[-1], rcond=None)[0][0] + strain[-1])


def _to_loss(signs: Signs) -> list[float]:
    """Strains to the loss of a contact, as announced at each of the last steps."""
    last = signs.strain[-WINDOWS[0] :]
    left = last + signs.loss_ahead[-WINDOWS[0] :] - last[-1]
    return left.tolist() if np.isfinite(left[-1]) and left[-1] > 0 else []


def _to_pair(signs: Signs) -> list[float]:
    """Strains to the zero of the squared gap of two coupled real eigenvalues, for those that meet first."""
    best: list[float] = []
    for mean, *_ in signs.couples[-1]:
        strain, square = _history(signs, mean)
        found = []
        for width in (2, *WINDOWS):
            if len(strain) < width or not (np.diff(square[-width:]) < 0).all():
                continue
            slope, zero = np.polyfit(strain[-width:] - strain[-1], square[-width:], 1)
            found.append(-zero / slope)
        if found and (not best or np.median(found) < np.median(best)):
            best = found
    return best


def _history(signs: Signs, mean: float) -> tuple[np.ndarray, np.ndarray]:
    """Strains and squared gaps of a couple, followed back from the last step by the mean of its eigenvalues."""
    rows = list(_back(signs, mean))[::-1]
    return np.array([signs.strain[k] for k, _ in rows]), np.array([square for _, square in rows])


def _back(signs: Signs, mean: float) -> Iterator[tuple[int, float]]:
    for k in range(len(signs.strain) - 1, -1, -1):
        here = signs.couples[k]
        near = np.argmin(np.abs(here[:, 0] - mean)) if len(here) else -1
        if near < 0 or abs(here[near, 0] - mean) > SAME * mean:
            return
        mean = here[near, 0]
        yield k, float(here[near, 1])
