"""Errors from samples and branches: closed forms, coverage, and what noise does to a largest value."""

import numpy as np
import pytest

from stickslip.wings.papers.gouge import measures
from stickslip.wings.papers.gouge.statistics import Curve, combine, difference, intraclass_correlation, read_off


def level(values, seeds):
    return read_off(np.asarray(values, float)[:, None], np.asarray(seeds), lambda mean: mean[0])


def test_from_three_samples_on_the_error_is_that_of_their_means():
    """However many branches each has: six equal ones in a sample are one value."""
    means = np.array([0.1, 0.4, 0.3, 0.9])
    found = level(np.repeat(means, 6), np.repeat(np.arange(4), 6))
    assert found.value == pytest.approx(means.mean())
    # 400 draws tell a standard deviation to 3.5 %
    assert found.error == pytest.approx(means.std(ddof=1) / 2, rel=0.1)
    assert found.half == pytest.approx(3.182 * found.error, rel=1e-3)  # Student, three degrees of freedom
    assert found.alike == pytest.approx(1.0)
    assert (found.samples, found.branches) == (4, 24)


def test_of_two_samples_branches_that_are_equal_count_once():
    """Eight values that are two: the error of the mean of two, s/√2 with the s of eight."""
    values, seeds = np.repeat([0.0, 1.0], 4), np.repeat([0, 1], 4)
    found = level(values, seeds)
    assert found.error == pytest.approx(values.std(ddof=1) / np.sqrt(2), rel=0.1)


def test_of_one_sample_branches_are_the_units():
    values = np.array([0.1, 0.5, 0.2, 0.7])
    found = level(values, np.zeros(4))
    assert found.error == pytest.approx(values.std(ddof=1) / 2, rel=0.1)
    assert np.isnan(found.alike)


def test_similarity_of_made_up_groups():
    """Half of the variance is the groups': 1/2, to the error of 2000 groups; none: 0; equal ones: 1."""
    rng = np.random.default_rng(3)
    shared = rng.normal(size=(2000, 1))
    assert intraclass_correlation(list(shared + rng.normal(size=(2000, 3)))) == pytest.approx(0.5, abs=0.05)
    assert intraclass_correlation(list(rng.normal(size=(2000, 3)))) == pytest.approx(0.0, abs=0.05)
    assert intraclass_correlation([[1.0, 1.0], [2.0, 2.0]]) == pytest.approx(1.0)
    assert np.isnan(intraclass_correlation([[1.0, 2.0]]))
    assert np.isnan(intraclass_correlation([[1.0], [2.0]]))


@pytest.mark.parametrize(("samples", "branches", "shared"), [(4, 3, 1.0), (1, 8, 0.0)])
def test_intervals_cover_what_they_promise(samples, branches, shared):
    """95 % over 150 made-up experiments, a share with a standard error of 1.8 %; plus that of the draws.

    Branches taken for samples hold 72 % where samples differ, and the scatter taken for the error of a mean all.
    """
    rng, hits = np.random.default_rng(4), 0
    seeds = np.repeat(np.arange(samples), branches)
    for _ in range(150):
        values = shared * np.repeat(rng.normal(size=samples), branches) + rng.normal(size=len(seeds))
        found = level(values, seeds)
        hits += abs(found.value) <= found.half
    assert 0.89 <= hits / 150 <= 0.99


def test_the_bias_of_a_largest_value_is_told():
    """Of noise all of the peak is bias, to the error of a mean; of a peak that stands out there is next to none."""
    rng, x = np.random.default_rng(5), np.linspace(0, 1, 50)
    rows, seeds = rng.normal(0, 0.1, (24, 50)), np.repeat(np.arange(8), 3)
    noise = Curve(x, rows, seeds, "")
    found = measures.peak(noise).value
    assert found > 0.03
    assert measures.peak_bias(noise) == pytest.approx(found, abs=2 * 0.1 / np.sqrt(24))
    clear = Curve(x, rows + 2 * np.exp(-(((x - 0.4) / 0.05) ** 2)), seeds, "")
    assert abs(measures.peak_bias(clear)) < 0.02
    assert np.isnan(measures.peak_bias(Curve(x, rows[:1], seeds[:1], "")))


def test_a_band_is_of_branches_and_an_error_of_samples():
    rows, seeds = np.array([[0.0], [2.0], [4.0], [6.0], [8.0], [10.0]]), np.repeat([0, 1, 2], 2)
    curve = Curve(np.zeros(1), rows, seeds, "")
    assert curve.band == pytest.approx(2 * np.std([0, 2, 4, 6, 8, 10], ddof=1))
    assert curve.error == pytest.approx(np.std([1, 5, 9], ddof=1) / np.sqrt(3))


def test_numbers_of_one_result_are_combined_with_the_errors_that_they_share():
    """A difference of equal numbers has no error, also where branches widen it."""
    for seeds in (np.repeat(np.arange(4), 2), np.repeat([0, 1], 4)):
        found = level(np.random.default_rng(6).normal(size=8), seeds)
        assert combine([found, found], lambda v: v[0] - v[1]).error == 0.0
        twice = combine([found, found], np.sum)
        assert (twice.value, twice.error) == (pytest.approx(2 * found.value), pytest.approx(2 * found.error))


def test_differences_of_two_results_have_welchs_interval():
    a, b = (level(np.arange(4.0) * size, np.arange(4)) for size in (1.0, 3.0))
    value, half = difference(a, b)
    assert value == pytest.approx(1.5 - 4.5)
    freedom = (a.error**2 + b.error**2) ** 2 / ((a.error**4 + b.error**4) / 3)
    from scipy.stats import t

    assert half == pytest.approx(np.hypot(a.error, b.error) * t.ppf(0.975, freedom))


def test_groups_of_unequal_sizes_have_fishers_mean_size():
    """Sizes 1, 2 and 3: the mean size of the analysis of variance is (6 − 14/6)/2 = 11/6."""
    groups = [[0.0], [2.0, 3.0], [1.0, 2.0, 1.5]]
    means, whole = [0.0, 2.5, 1.5], np.mean([0.0, 2.0, 3.0, 1.0, 2.0, 1.5])
    between = sum(len(g) * (m - whole) ** 2 for g, m in zip(groups, means, strict=True)) / 2
    within = (0.5 + 0.5) / 3
    assert intraclass_correlation(groups) == pytest.approx((between - within) / (between + (11 / 6 - 1) * within))
