"""Means over samples and branches of a gouge experiment, and the errors of what is read off them.

Samples (seeds) are independent; branches of one sample start from states along one slide and may be alike. From three
samples on, errors therefore rest on the scatter of samples, each the mean of its branches. With fewer, they rest on all
branches, and are widened by how alike these are.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

LEAST = 3  # samples from which on their scatter is the error
DRAWS = 400  # of samples, with replacement, for the error of what is read off a mean curve


class Number(NamedTuple):
    """A number read off the mean over samples and branches; its standard error is NaN if there is one branch only.

    `draws` are its values for samples (with fewer than three of them, branches) drawn again with replacement, the same
    ones for all numbers of a result.
    """

    value: float
    error: float
    samples: int
    branches: int  # of all samples together
    draws: np.ndarray  # (DRAWS,), or (0,) with one branch
    alike: float = np.nan  # correlation of two branches of one sample; NaN if no sample has two

    def __repr__(self) -> str:
        return f"Number({self.value:.4g} ± {self.half:.2g}, 95 %, {self.samples} samples, {self.branches} branches)"

    @property
    def half(self) -> float:
        """Half width of its 95 % interval by Student's t."""
        units = self.samples if self.samples >= LEAST else self.branches
        return self.error * float(student.ppf(0.975, units - 1)) if units > 1 else np.nan


class Curve(NamedTuple):
    """Branches of one kind on one grid, and their mean."""

    x: np.ndarray  # (G,)
    rows: np.ndarray  # (R, G), one for each branch
    seeds: np.ndarray  # (R,) sample of each branch
    label: str

    @property
    def means(self) -> np.ndarray:
        """(S, G) of each sample over its branches."""
        return np.array([self.rows[self.seeds == seed].mean(axis=0) for seed in np.unique(self.seeds)])

    @property
    def mean(self) -> np.ndarray:
        """(G,) over samples."""
        return self.means.mean(axis=0)

    @property
    def band(self) -> np.ndarray:
        """(G,) two standard deviations over branches; zero with one of them."""
        return 2 * self.rows.std(axis=0, ddof=1) if len(self.rows) > 1 else np.zeros(len(self.x))

    @property
    def error(self) -> np.ndarray:
        """(G,) standard error of the mean; NaN with one branch."""
        units = self.units
        return units.std(axis=0, ddof=1) / np.sqrt(len(units)) if len(units) > 1 else np.full(len(self.x), np.nan)

    @property
    def units(self) -> np.ndarray:
        """(U, G) what counts as independent: samples, or branches of fewer than three samples."""
        means = self.means
        return means if len(means) >= LEAST else self.rows

    def at(self, x: float) -> Number:
        """The mean at the grid's point that is nearest to x."""
        k = int(np.abs(self.x - x).argmin())
        return self.read(lambda mean: mean[k])

    def read(self, function: Callable) -> Number:
        """A number read off the mean curve, as function((G,)), with its error."""
        return read_off(self.rows, self.seeds, function)


def read_off(rows: np.ndarray, seeds: np.ndarray, function: Callable) -> Number:
    """A number read off the mean of (R, G) rows of branches, with its error by drawing again (bootstrap)."""
    groups = [rows[seeds == seed] for seed in np.unique(seeds)]
    means = np.array([group.mean(axis=0) for group in groups])
    value, alike = (
        float(function(means.mean(axis=0))),
        intraclass_correlation([[float(function(row)) for row in g] for g in groups]),
    )
    units = means if len(means) >= LEAST else rows
    count, wider = len(units), 1.0
    if count == 1:
        return Number(value, np.nan, 1, 1, np.zeros(0))
    if len(means) < LEAST and np.isfinite(alike):
        wider = np.sqrt(1 + (len(rows) / len(means) - 1) * max(alike, 0.0))
    rng = np.random.default_rng(0)
    draws = np.array([function(units[rng.integers(count, size=count)].mean(axis=0)) for _ in range(DRAWS)])
    return _with_bootstrap_error(Number(value, np.nan, len(means), len(rows), draws, alike), wider)


def _with_bootstrap_error(number: Number, wider: float = 1.0) -> Number:
    """The number with the error that its draws give."""
    count = number.samples if number.samples >= LEAST else number.branches
    # what is drawn from a few values scatters less than what these were drawn from
    return number._replace(error=float(wider * np.sqrt(count / (count - 1)) * number.draws.std(ddof=1)))


def intraclass_correlation(groups: list[list[float]]) -> float:
    """Correlation of two values of one group (intraclass, by analysis of variance); NaN without groups of two.

    Source: R. A. Fisher, Statistical Methods for Research Workers (1925), §40.
    """
    sizes = np.array([len(g) for g in groups])
    if len(groups) < 2 or sizes.max() < 2:
        return np.nan
    total, whole = sizes.sum(), np.concatenate(groups)
    mean = np.array([np.mean(g) for g in groups])
    between = sizes @ (mean - whole.mean()) ** 2 / (len(groups) - 1)
    within = sum(((np.asarray(g) - m) ** 2).sum() for g, m in zip(groups, mean, strict=True)) / (total - len(groups))
    size = (total - (sizes**2).sum() / total) / (len(groups) - 1)
    below = between + (size - 1) * within
    return float((between - within) / below) if below > 0 else np.nan


def combine(numbers: list[Number], function: Callable) -> Number:
    """function(values) of numbers of one result, with the error that samples drawn again for all at once give."""
    first = numbers[0]
    value = float(function(np.array([n.value for n in numbers])))
    if min(len(n.draws) for n in numbers) == 0:
        return Number(value, np.nan, first.samples, first.branches, np.zeros(0))
    draws = np.array([function(one) for one in np.array([n.draws for n in numbers]).T])
    wider = max(_widening(n) for n in numbers)
    return _with_bootstrap_error(Number(value, np.nan, first.samples, first.branches, draws, first.alike), wider)


def _widening(number: Number) -> float:
    """By how much the error of a number exceeds the scatter of its draws."""
    plain = _with_bootstrap_error(number).error
    return number.error / plain if plain > 0 else 1.0


def average(numbers: list[Number]) -> Number:
    """Mean of numbers of one result."""
    return combine(numbers, np.mean)


def slope(x, numbers: list[Number]) -> Number:
    """Slope of a straight line through numbers of one result, least squares; at least two different x."""
    x = np.asarray(x, float)
    if len(set(x.tolist())) < 2:
        raise ValueError(f"a slope through {len(x)} points was asked for: give at least two different x")
    centred = x - x.mean()
    return combine(numbers, lambda y: centred @ y / (centred @ centred))


def difference(a: Number, b: Number) -> tuple[float, float]:
    """Difference a − b of numbers of two results, and half its 95 % interval (Welch)."""
    variances = np.array([a.error**2, b.error**2])
    units = np.array([n.samples if n.samples >= LEAST else n.branches for n in (a, b)])
    if not variances.sum() > 0:
        return a.value - b.value, float(np.sqrt(variances.sum()))
    freedom = variances.sum() ** 2 / (variances**2 / np.maximum(units - 1, 1)).sum()
    return a.value - b.value, float(np.sqrt(variances.sum()) * student.ppf(0.975, freedom))
