"""Spikes in a record: single samples that no noise explains, left out of a fit and told."""

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import least_squares

from .laws import EVOLUTIONS
from .problem import MAX_SHIFT, RUNAWAY_RESIDUAL, Task, jacobian, pieces, residual

AROUND = 7  # samples of the running median with which each residual is compared
FAR = 6.0  # standard deviations beyond which a sample is a spike; one Gaussian sample in 5e8 is
MOST = 0.05  # share of the samples; more of them are noise with long tails, or a law that does not fit
LEAST_NOISE = 1e-6  # over the scatter of friction, below which residuals are errors of integration
TO_DEVIATION = 1.4826  # standard deviation of Gaussian noise over its median absolute deviation


def find_spikes(task: Task, x: np.ndarray) -> list[np.ndarray]:
    """Numbers of the samples of each record that are spikes, given the least-squares estimate of the parameters.

    The estimate is first made robust (soft L1 loss, which grows in proportion to large residuals). A residual is then
    compared with the median of its neighbours, so that a slow misfit of the law is no spike.

    Source
    ------
    Huber, Robust Statistics, doi:10.1002/9780470434697; the loss is that of `scipy.optimize.least_squares`.
    """
    marks = _spikes(task, residual(task, x))
    for law in EVOLUTIONS if marks.any() else ():  # a sample that one of the laws explains is no spike
        other = task._replace(law=law)
        rest = residual(other, _robust(other, x))
        marks &= _spikes(other, rest) | bool(np.abs(rest).max() > 0.5 * RUNAWAY_RESIDUAL * task.scatter)
    if marks.mean() > MOST:
        marks[:] = False
    ends = np.cumsum([int(case.used.sum()) for case in task.cases])[:-1]
    return [np.flatnonzero(case.used)[part] for case, part in zip(task.cases, np.split(marks, ends), strict=True)]


def _robust(task: Task, x: np.ndarray) -> np.ndarray:
    """Estimate that large residuals move little."""
    size = max(TO_DEVIATION * float(np.median(np.abs(residual(task, x)))), LEAST_NOISE * task.scatter)
    span = np.where(task.logs, MAX_SHIFT, np.inf)
    return least_squares(
        lambda y: residual(task, y), x, jac=lambda y: jacobian(task, y), loss="soft_l1", f_scale=1.5 * size,
        x_scale="jac", bounds=(x - span, x + span), max_nfev=30,
    ).x  # fmt: skip


def _spikes(task: Task, rest: np.ndarray) -> np.ndarray:
    """Whether each residual is far from the median of its neighbours."""
    apart = np.concatenate([rest[run] - median_filter(rest[run], AROUND, mode="nearest") for run in pieces(task)])
    size = max(TO_DEVIATION * float(np.median(np.abs(apart))), LEAST_NOISE * task.scatter)
    return np.abs(apart) > FAR * size


def without(used: np.ndarray, spikes: np.ndarray) -> np.ndarray:
    """Mask of the samples that are fitted, without spikes."""
    kept = used.copy()
    kept[spikes] = False
    return kept
