"""Means over samples and branches of a gouge experiment, and errors of numbers read off them.

Samples (seeds) are independent, but branches of one sample start from states along the same slide and may be
correlated. With three or more samples, errors are therefore based on the scatter among samples, each represented by the
mean of its branches. With fewer samples, errors are based on all branches and widened according to their correlation.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from ....kit import Estimate

LEAST = 3  # smallest number of samples for errors based on their scatter
DRAWS = 400  # bootstrap draws for the error of a number read off a mean curve


class Number(NamedTuple):
    """Number read off the mean over samples and branches; its standard error is NaN with only one branch.

    `draws` are its values for samples (branches if there are fewer than three samples) drawn with replacement. The
    draws are the same for all numbers of a result.
    """

    value: float
    error: float
    samples: int
    branches: int  # number of branches of all samples together
    draws: np.ndarray  # (DRAWS,), or (0,) with one branch
    alike: float = np.nan  # correlation of two branches of one sample; NaN if no sample has two branches

    def __repr__(self) -> str:
        return f"Number({self.value:.4g} ± {self.half:.2g}, 95 %, {self.samples} samples, {self.branches} branches)"

    @property
    def half(self) -> float:
        """Half-width of the 95 % confidence interval from Student's t distribution."""
        units = self.samples if self.samples >= LEAST else self.branches
        return self.error * float(stdtrit(units - 1, 0.975)) if units > 1 else np.nan

    @property
    def estimate(self) -> Estimate:
        """Value with the half-width of its 95 % interval."""
        return Estimate(self.value, self.half, self.error)


class Curve(NamedTuple):
    """Branches of one kind on a common grid."""

    x: np.ndarray  # (G,)
    rows: np.ndarray  # (R, G), one row per branch
    seeds: np.ndarray  # (R,) sample of each branch
    label: str

    @property
    def means(self) -> np.ndarray:
        """Mean over the branches of each sample, shape (S, G)."""
        return np.array([self.rows[self.seeds == seed].mean(axis=0) for seed in np.unique(self.seeds)])

    @property
    def mean(self) -> np.ndarray:
        """Mean over samples, shape (G,)."""
        return self.means.mean(axis=0)

    @property
    def band(self) -> np.ndarray:
        """Two standard deviations over branches, shape (G,); zero with one branch."""
        return 2 * self.rows.std(axis=0, ddof=1) if len(self.rows) > 1 else np.zeros(len(self.x))

    @property
    def error(self) -> np.ndarray:
        """Standard error of the mean, shape (G,); NaN with one branch."""
        units = self.units
        return units.std(axis=0, ddof=1) / np.sqrt(len(units)) if len(units) > 1 else np.full(len(self.x), np.nan)

    @property
    def units(self) -> np.ndarray:
        """Independent curves, shape (U, G): those of samples, or of branches with fewer than three samples."""
        return self.means if len(self.means) >= LEAST else self.rows

    def at(self, x: float) -> Number:
        """Return the mean at the grid point nearest to x."""
        k = int(np.abs(self.x - x).argmin())
        return self.read(lambda mean: mean[k])

    def read(self, function: Callable) -> Number:
        """Return function(mean) for the mean curve (G,), with its error."""
        return read_off(self.rows, self.seeds, function)


def read_off(rows: np.ndarray, seeds: np.ndarray, function: Callable) -> Number:
    """Return function(mean) for branches given as rows (R, G), with its bootstrap error."""
    groups = [rows[seeds == seed] for seed in np.unique(seeds)]
    means = np.array([group.mean(axis=0) for group in groups])
    value = float(function(means.mean(axis=0)))
    alike = intraclass_correlation([[float(function(row)) for row in g] for g in groups])
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
    """Return the number with the error estimated from its draws."""
    count = number.samples if number.samples >= LEAST else number.branches
    # draws from a few values scatter less than the distribution of the values
    return number._replace(error=float(wider * np.sqrt(count / (count - 1)) * number.draws.std(ddof=1)))


def intraclass_correlation(groups: list[list[float]]) -> float:
    """Intraclass correlation between two values of a group, by analysis of variance; NaN if all groups are single.

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
    """Return the value of a function of several numbers of one result, with the error from their common draws."""
    first = numbers[0]
    value = float(function(np.array([n.value for n in numbers])))
    if min(len(n.draws) for n in numbers) == 0:
        return Number(value, np.nan, first.samples, first.branches, np.zeros(0))
    draws = np.array([function(draw) for draw in np.array([n.draws for n in numbers]).T])
    # the largest factor by which the error of a number exceeds the scatter of its draws
    plain = [_with_bootstrap_error(n).error for n in numbers]
    wider = max(n.error / alone if alone > 0 else 1.0 for n, alone in zip(numbers, plain, strict=True))
    return _with_bootstrap_error(Number(value, np.nan, first.samples, first.branches, draws, first.alike), wider)


def slope(x, numbers: list[Number]) -> Number:
    """Fit the slope of a line to numbers of one result by least squares.

    At least two different values of x are required.
    """
    x = np.asarray(x, float)
    if len(set(x.tolist())) < 2:
        raise ValueError(f"a slope through {len(x)} points was requested: give at least two different values of x")
    centred = x - x.mean()
    return combine(numbers, lambda y: centred @ y / (centred @ centred))


def difference(a: Number, b: Number) -> tuple[float, float]:
    """Return the difference a − b of numbers from two results, and half the width of its 95 % interval (Welch).

    The interval is unknown if one of the results has a single sample with a single branch.
    """
    variances = np.array([a.error**2, b.error**2])
    units = np.array([n.samples if n.samples >= LEAST else n.branches for n in (a, b)])
    if units.min() < 2:
        return a.value - b.value, np.nan
    if not variances.sum() > 0:
        return a.value - b.value, float(np.sqrt(variances.sum()))
    freedom = variances.sum() ** 2 / (variances**2 / np.maximum(units - 1, 1)).sum()
    return a.value - b.value, float(np.sqrt(variances.sum()) * stdtrit(freedom, 0.975))
