"""Spikes in a record: single samples that no noise explains, left out of a fit and told."""

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from .model import Prepared

AROUND = 7  # samples of the running median with which each sample is compared
FAR = 6.0  # standard deviations beyond which a sample is a spike; one Gaussian sample in 5e8 is
MOST = 0.02  # share of the samples; more of them are noise with long tails
LEAST_NOISE = 1e-6  # over the scatter of friction, below which a record has no noise but round-off
TO_DEVIATION = 1.4826  # standard deviation of Gaussian noise over its median absolute deviation
SPREAD = np.sqrt(70.0)  # standard deviation of the fourth difference of white noise over its own
ABRUPT, STEP = 0.5, 1e-2  # relative changes of the velocity and of the normal stress after which friction may peak
BEFORE, AFTER = -1, 3  # samples next to such a change, of which none is a spike


def find_spikes(case: Prepared) -> np.ndarray:
    """Numbers of the samples that are spikes, from the record alone: they are the same for every law.

    A spike is farther from the median of its neighbours than six standard deviations of the noise, and than this median
    itself changes around it, so that neither a resolved peak nor a stress drop is one. At an abrupt change of the load
    no sample is, because it may be the peak of the response.
    """
    middle = _middle(case)
    apart = np.abs(case.friction - middle)
    far = case.used & (apart / case.sigma > FAR * noise_level([case]))
    if far.sum() > MOST * case.used.sum():
        return np.zeros(0, int)
    width = 2 * AROUND + 1
    moves = maximum_filter1d(middle, width) - minimum_filter1d(middle, width)
    return np.flatnonzero(far & (apart > moves) & ~_load_changes(case))


def noise_level(cases: list[Prepared]) -> float:
    """Standard deviation of the noise between neighbouring samples over `sigma`, from fourth differences of friction.

    These vanish for smooth signals. It is that of the part of the noise that changes from sample to sample, of which
    correlated noise has less.
    """
    runs = [(case.friction / case.sigma)[case.used][run] for case in cases for run in case.pieces]
    fourth = np.abs(np.concatenate([np.diff(run, 4) for run in runs]))
    if not len(fourth):
        return 0.0
    values = np.unique(np.concatenate(runs))
    digit = np.diff(values).min(initial=np.inf) / np.sqrt(12.0)  # of numbers with few digits
    size = max(TO_DEVIATION * float(np.median(fourth)) / SPREAD, digit if np.isfinite(digit) else 0.0)
    return max(size, LEAST_NOISE * float(np.std(np.concatenate(runs))))


def _middle(case: Prepared) -> np.ndarray:
    """Running median of friction within runs of samples that are fitted; friction itself elsewhere."""
    out = case.friction.copy()
    rows = np.flatnonzero(case.used)
    for run in case.pieces:
        out[rows[run]] = median_filter(case.friction[rows[run]], AROUND, mode="nearest")
    return out


def _load_changes(case: Prepared) -> np.ndarray:
    """Whether the load changes abruptly at each sample or just before it, where a peak may be that narrow."""
    out = np.zeros(len(case.time), bool)
    if case.legs is None:
        first = np.flatnonzero(_abrupt(case.velocity)) + 1
    else:
        duration, velocity, normal = case.legs
        changes = _abrupt(velocity) | (np.abs(np.diff(normal)) > STEP)
        first = np.searchsorted(case.time, np.cumsum(duration)[:-1][changes])
    for shift in range(BEFORE, AFTER + 1):
        out[np.clip(first + shift, 0, len(out) - 1)] = True
    return out


def _abrupt(velocity: np.ndarray) -> np.ndarray:
    """Whether each velocity differs much from the one before."""
    size = np.abs(velocity)
    return np.abs(np.diff(velocity)) > ABRUPT * np.maximum(size[1:], size[:-1])


def without(used: np.ndarray, spikes: np.ndarray) -> np.ndarray:
    """Mask of the samples that are fitted, without spikes."""
    kept = used.copy()
    kept[spikes] = False
    return kept
