"""Gradings: curves of passing by mass against size, and grains that reproduce them."""

from typing import NamedTuple

import numpy as np

from ....kit import Positive, checked

MISFIT = 0.05  # largest deviation of a representative sample from the curve, as a fraction of the mass
LARGEST_SAMPLE = 10**7  # largest sample considered in the search for the number of grains that a curve needs
WIDEST = 100.0  # largest ratio of the sizes of a grading
POINTS = 4001  # number of points of the distribution by number


def require_span(smallest: float, largest: float) -> None:
    """Raise ValueError if sizes span more than a factor of `WIDEST`."""
    if not largest <= WIDEST * smallest:
        raise ValueError(
            f"a grading may span at most a factor of {WIDEST:g} in size, got {smallest:g} to {largest:g}: cut off the "
            "fines"
        )


class Grading(NamedTuple):
    """Curve of passing against size, linear in the logarithm of the size between its points."""

    size: np.ndarray  # (K,) diameters, increasing [length]
    passing: np.ndarray  # (K,) fraction of the mass in smaller grains, from 0 to 1 [1]

    def passing_at(self, diameter: np.ndarray) -> np.ndarray:
        """Fraction of the mass in grains smaller than given diameters."""
        return np.interp(np.log(diameter), np.log(self.size), self.passing)

    def size_at(self, passing: np.ndarray) -> np.ndarray:
        """Diameters below which given fractions of the mass lie, such as D50 at 0.5 [length]."""
        return np.exp(np.interp(passing, self.passing, np.log(self.size)))


@checked
def from_d10_d50_d60(d10: Positive, d50: Positive, d60: Positive) -> Grading:
    """Grading through D10, D50 and D60, with the first and last segments extended to 0 and 100 % passing.

    Examples
    --------
    >>> from_d10_d50_d60(1.0, 2.0, 2.2).size_at(0.5).round(9).item()
    2.0
    """
    if not d10 < d50 < d60:
        raise ValueError(f"D10, D50 and D60 must increase, got {d10:g}, {d50:g} and {d60:g}")
    require_span(d10, d60)
    low, high = d10 * (d10 / d50) ** (1 / 4), d60 * (d60 / d50) ** 4
    return Grading(np.array([low, d10, d50, d60, high]), np.array([0.0, 0.1, 0.5, 0.6, 1.0]))


@checked
def diameters(grading: Grading, n: int, dim: int = 3) -> np.ndarray:
    """Return increasing diameters (n,) that follow a curve of passing by mass, without random numbers [length].

    Grain k is the quantile (k + 1/2)/n of the distribution by number, whose density is dP/dD over the mass D^dim.

    Examples
    --------
    >>> curve = Grading(np.array([1.0, 2.0]), np.array([0.0, 1.0]))
    >>> round(passing_of(diameters(curve, 2000), 1.5), 3), round(float(curve.passing_at(1.5)), 3)
    (0.585, 0.585)
    """
    step = np.interp(np.linspace(0, len(grading.size) - 1, POINTS), np.arange(len(grading.size)), grading.passing)
    middle = 0.5 * (step[1:] + step[:-1])
    number = np.cumsum(np.diff(step) / (grading.size_at(middle) / grading.size[0]) ** dim)
    at = np.interp((np.arange(n) + 0.5) / n, np.append(0.0, number) / number[-1], step)
    return grading.size_at(at)


@checked
def passing_of(diameter: np.ndarray, size: float, dim: int = 3) -> float:
    """Mass fraction of given grains that are smaller than a size; grains of that size count half."""
    mass = diameter**dim
    return float((mass[diameter < size].sum() + 0.5 * mass[diameter == size].sum()) / mass.sum())


def misfit(grading: Grading, diameter: np.ndarray, dim: int) -> float:
    """Largest deviation of the grading curve of given grains, at their sizes, from the prescribed curve [1]."""
    mass = diameter**dim
    passed = (np.cumsum(mass) - 0.5 * mass) / mass.sum()
    return float(np.abs(passed - grading.passing_at(diameter)).max(initial=0.5 * mass[-1] / mass.sum()))


def grains_needed(grading: Grading, dim: int) -> int:
    """Smallest number of grains, a power of two up to `LARGEST_SAMPLE`, that reproduces a curve within `MISFIT`."""
    n = 16
    while n < LARGEST_SAMPLE and misfit(grading, diameters(grading, n, dim), dim) > MISFIT:
        n *= 2
    return n
