"""Identifiability of fitted parameters: covariance, intervals, and an explanation of trade-offs."""

from typing import NamedTuple

import numpy as np

SINGULAR = (
    1e-5  # singular value of the scaled Jacobian, over the largest, below which it is an error of finite differences
)
WIDEST = np.log(10.0)  # half width of the interval of a logarithm above which its parameter is not determined
PART = 0.25  # component of a parameter in a direction, over the largest, above which it is named


class Estimates(NamedTuple):
    """Fitted values, with NaN for those that the data do not determine."""

    values: dict
    errors: dict
    intervals: dict
    covariance: np.ndarray  # (m, m), NaN for undetermined parameters
    identifiable: bool
    sentence: str
    gap: float  # a − b
    error: float  # half width of its interval


def covariance(jacobian) -> tuple[np.ndarray, np.ndarray]:
    """Covariance (JᵀJ)⁻¹ from singular values, and the parameters involved in directions that do not change the model.

    Parameters
    ----------
    jacobian : (N, m) of filtered residuals over their size
    """
    size = np.linalg.norm(jacobian, axis=0)
    size = np.maximum(size, SINGULAR**2 * max(size.max(), 1e-300))
    _, singular, right = np.linalg.svd(jacobian / size, full_matrices=False)
    floor = np.maximum(singular, SINGULAR * singular[0])
    blind = np.zeros(len(size), bool)
    for row in right[singular < SINGULAR * singular[0]]:
        blind |= np.abs(row) > PART * np.abs(row).max()
    return (right.T / floor**2) @ right / np.outer(size, size), blind


def estimate(inner, blind, x, names, logs, reach: float, open_sides: dict) -> Estimates:
    """Values with intervals and identifiability.

    A parameter is not determined if it is involved in a direction that does not change the model, if the 95 % interval
    of its logarithm is wider than a factor of 10 either way, or if values far beyond that interval fit equally well.

    Parameters
    ----------
    inner, blind : from `covariance`
    x : (m,) logarithms where `logs`, else values
    reach : Student t quantile
    open_sides : name → (limit, "above" or "below") of parameters whose values fit equally well without bound
    """
    half = reach * np.sqrt(np.diag(inner))
    unknown = blind | (logs & (half > WIDEST)) | np.array([name in open_sides for name in names])
    raw = np.where(logs, np.exp(np.where(logs, x, 0.0)), x)
    slope = np.where(logs, raw, 1.0)
    full = inner * np.outer(slope, slope)
    ratio = np.exp(np.minimum(half, 300.0) * logs)
    low, high = np.where(logs, raw / ratio, x - half), np.where(logs, raw * ratio, x + half)
    shown = [np.where(unknown, np.nan, column) for column in (raw, np.sqrt(np.diag(full)), low, high)]
    cover = full.copy()
    cover[unknown], cover[:, unknown] = np.nan, np.nan
    values, errors = dict(zip(names, shown[0].tolist(), strict=True)), dict(zip(names, shown[1].tolist(), strict=True))
    intervals = {name: (float(i), float(j)) for name, i, j in zip(names, shown[2], shown[3], strict=True)}
    gap, error = difference(names, raw, full, reach)
    if unknown.any() and not error < 0.5 * max((raw[k] for k, n in enumerate(names) if n in ("a", "b")), default=1.0):
        gap, error = np.nan, np.nan
    sentence = _sentence(names, unknown, inner, open_sides, (gap, error))
    return Estimates(values, errors, intervals, cover, not unknown.any(), sentence, gap, error)


def without_intervals(estimates: Estimates, reason: str) -> Estimates:
    """Return the same values without errors and intervals, which are not known unless the noise is."""
    nothing = dict.fromkeys(estimates.errors, np.nan)
    sentence = reason if estimates.identifiable else f"{reason}; {estimates.sentence}"
    return estimates._replace(
        errors=nothing, intervals=dict.fromkeys(nothing, (np.nan, np.nan)), sentence=sentence, error=np.nan,
        covariance=np.full_like(estimates.covariance, np.nan),
    )  # fmt: skip


def difference(names, raw, full, reach: float) -> tuple[float, float]:
    """a − b of the free parameters (a fixed one counts as 0), and the half width of its interval."""
    weights = np.array([{"a": 1.0, "b": -1.0}.get(name, 0.0) for name in names])
    return float(weights @ raw), reach * float(np.sqrt(max(weights @ full @ weights, 0.0)))


def _sentence(names, unknown, inner, open_sides: dict, gap) -> str:
    if not unknown.any():
        return "these data determine all parameters"
    among = np.flatnonzero(unknown)
    lost = ", ".join(names[k] for k in among)
    _, vectors = np.linalg.eigh(inner[np.ix_(among, among)])
    part = among[np.abs(vectors[:, -1]) > PART * np.abs(vectors[:, -1]).max()]
    involved = [names[k] for k in part]
    if open_sides:
        limits = " and ".join(f"any {name} {side} {limit:.2g}" for name, (limit, side) in open_sides.items())
        hint = f"{limits} fits equally well: fix {' or '.join(open_sides)}, or add data that depend on it"
    elif len(part) == 1:
        hint = f"{involved[0]} hardly affects the data: fix it, or add data that depend on it"
    else:
        hint = f"{' and '.join(involved)} trade off against each other: fix one of them, or add data that separate them"
    if {"a", "b"} <= {names[k] for k in among} and np.isfinite(gap[1]):
        hint = f"only a − b = {gap[0]:.3g} ± {gap[1]:.1g} is known; {hint}"
    return f"these data do not determine {lost}: {hint}"
