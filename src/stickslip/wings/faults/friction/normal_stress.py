"""Changes of the effective normal stress on a fault in time: injected fluid, an oscillation, a table.

Each kind has `change(depth, time)`, which is added to the normal stress of the fault, and times `breaks` at which it
is not smooth or extreme, where time steps end.
"""

import csv
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.special import erfc

from ....kit import Array, Series, check_types, checked, read_text, readable, require_positive

INSTANTS = 400  # times at which the normal stress is checked before a simulation


@readable
class Injection(NamedTuple):
    """Fluid that enters a fault at one place at a constant rate, and spreads along it by diffusion in one dimension.

    The fault is taken as infinitely long for the fluid, with a constant diffusivity c and without losses. At a
    distance x the pressure after a time t of injection is p = q √(t/c) ierfc[x/√(4ct)]/S, with ierfc(y) = exp(−y²)/√π −
    y erfc(y); after the end, that of a second source of −q is added. This is the pressure of the SEAS benchmark
    problem BP6-QD (Lambert et al. 2025, doi:10.1029/2024JB030601).

    Examples
    --------
    >>> source = Injection(flux=1.25e-6, storage=1e-9, diffusivity=0.1, stop=8.64e6)
    >>> print(f"{source.pressure(np.array([0.0]), 8.64e6)[0] / 1e6:.3f} MPa")
    6.555 MPa
    """

    flux: float  # q, volume per time and area of the fault's cross-section; half of it goes to each side [m/s]
    storage: float  # S = φ β, porosity × compressibility of pores and fluid [1/Pa]
    diffusivity: float  # c, hydraulic [m²/s]
    stop: float = np.inf  # end of the injection [s]
    start: float = 0.0  # [s]
    at: float = 0.0  # depth of the source, or its position along the fault [m]

    check_entries = check_types

    def check(self) -> None:
        """Raise ValueError if a field is not valid."""
        self.check_entries()
        require_positive(flux=self.flux, storage=self.storage, diffusivity=self.diffusivity)
        if not (0 <= self.start < self.stop and np.isfinite(self.at)):
            raise ValueError(
                f"an injection from {self.start:g} to {self.stop:g} s at {self.at:g} m was given: use a start that is "
                f"not negative, a later end and a finite place"
            )

    @property
    def breaks(self) -> tuple[float, ...]:
        """Start and end [s]."""
        return self.start, self.stop

    def pressure(self, depth: np.ndarray, time: float) -> np.ndarray:
        """Pore pressure in excess of that before the injection (N,) [Pa]."""
        return self._spread(depth, time - self.start) - self._spread(depth, time - self.stop)

    def change(self, depth: np.ndarray, time: float) -> np.ndarray:
        """Minus the pressure (N,) [Pa]."""
        return -self.pressure(depth, time)

    def _spread(self, depth: np.ndarray, time: float) -> np.ndarray:
        if time <= 0:
            return np.zeros(len(depth))
        y = np.abs(depth - self.at) / np.sqrt(4 * self.diffusivity * time)
        shape = np.exp(-y * y) / np.sqrt(np.pi) - y * erfc(y)
        return self.flux / self.storage * np.sqrt(time / self.diffusivity) * shape


@readable
class Oscillation(NamedTuple):
    """Normal stress that oscillates everywhere, as under tides: A sin(2πt/T) is added."""

    amplitude: float  # A [Pa]
    period: float  # T [s]

    check_entries = check_types

    def check(self) -> None:
        """Raise ValueError if a field is not valid."""
        self.check_entries()
        require_positive(amplitude=self.amplitude, period=self.period)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Times of the first largest and least values [s]."""
        return 0.25 * self.period, 0.75 * self.period

    def change(self, depth: np.ndarray, time: float) -> np.ndarray:
        """Change of the normal stress (N,) [Pa]."""
        return np.full(len(depth), self.amplitude * np.sin(2 * np.pi * time / self.period))


@readable
class StressTable(NamedTuple):
    """Changes of the effective normal stress at times and depths, linear between both and constant beyond them.

    Examples
    --------
    A fall by 2 MPa at all depths within a day, after a year:

    >>> table = StressTable([3.15e7, 3.15e7 + 86400], [0.0], [[0.0], [-2e6]])
    >>> table.change(np.array([5e3]), 3.2e7)
    array([-2000000.])
    """

    time: Series  # (K,) increasing [s]
    depth: Series  # (D,) increasing [m]
    values: Annotated[Any, Array((2,))]  # (K, D) added to the normal stress: minus a pore pressure [Pa]

    check_entries = check_types

    @property
    def breaks(self) -> tuple[float, ...]:
        """All times [s]."""
        return tuple(np.asarray(self.time, float).tolist())

    def check(self) -> None:
        """Raise ValueError if the table is not valid."""
        self.check_entries()
        for name, axis in (("times", self.time), ("depths", self.depth)):
            axis = np.asarray(axis, float)
            if axis.ndim != 1 or not len(axis) or not np.isfinite(axis).all() or (np.diff(axis) <= 0).any():
                raise ValueError(f"the {name} of a table of normal stress do not increase: use finite, sorted {name}")
        shape, values = (len(self.time), len(self.depth)), np.asarray(self.values, float)
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(
                f"a table of normal stress has {shape[0]} times, {shape[1]} depths and values of the shape "
                f"{values.shape}: use a finite value for each time and depth"
            )

    def change(self, depth: np.ndarray, time: float) -> np.ndarray:
        """Change of the normal stress (N,) [Pa]."""
        times, values = np.asarray(self.time, float), np.asarray(self.values, float)
        last = min(int(np.searchsorted(times, time)), len(times) - 1)
        first = max(last - 1, 0)
        share = np.clip((time - times[first]) / (times[last] - times[first]), 0.0, 1.0) if last > first else 1.0
        return np.interp(depth, self.depth, (1 - share) * values[first] + share * values[last])


@checked
def read_stress_table(path: str | Path) -> StressTable:
    """Read a table of changes of the normal stress: depths [m] in the first row, times [s] in the first column.

    Parameters
    ----------
    path : CSV file; what stands in the corner does not matter

    Raises
    ------
    ValueError
        with one sentence, if it is not such a table.
    """
    try:
        text = read_text(path, remedy="give a CSV file")
    except OSError as problem:
        raise ValueError(f"{path} cannot be read: {problem.strerror}") from None
    try:
        head, *rows = [row for row in csv.reader(text.splitlines()) if row]
        depth, body = np.array(head[1:], float), np.array(rows, float)
        table = StressTable(body[:, 0], depth, body[:, 1:])
    except (ValueError, IndexError, csv.Error):
        raise ValueError(
            f"{path} is not a table of numbers: give depths in m in the first row, after a first cell with any "
            f"text, then rows of a time in s and changes of normal stress in Pa"
        ) from None
    try:
        table.check()
    except ValueError as problem:
        raise ValueError(f"{path}: {problem}") from None
    return table
