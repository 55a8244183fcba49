"""What data can tell: covariance of fitted parameters, and the sentence where they trade off."""

from typing import NamedTuple

import numpy as np

SINGULAR = 1e-5  # singular value of the scaled Jacobian, over the largest, below which nothing is known: differences' error
WIDEST = np.log(10.0)  # half width of an interval of a logarithm above which its parameter counts as unknown
PART = 0.25  # share of a parameter in a direction, over the largest, from which on it is named


class Known(NamedTuple):
    """Values, and which of them mean something."""

    values: dict
    errors: dict
    intervals: dict
    covariance: np.ndarray  # (m, m), NaN for what is not known
    identifiable: bool
    sentence: str
    raw: dict  # values even of what is not known
    full: np.ndarray  # covariance even of what is not known


def known(jacobian, x, names, logs, reach: float) -> Known:
    """Covariance (JᵀJ)⁻¹ by singular values, and the verdict.

    A parameter is not known if it takes part in a direction in which the data do not change, or if the 95 % interval of its
    logarithm is wider than a factor of 10 either way.

    Parameters
    ----------
    jacobian : (N, m) of filtered residuals over their size, by x
    x : (m,) logarithms where `logs`, else values
    reach : Student's quantile
    """
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0, size, 1e-300)
    _, singular, right = np.linalg.svd(jacobian / size, full_matrices=False)
    floor = np.maximum(singular, SINGULAR * singular[0])
    inner = (right.T / floor**2) @ right / np.outer(size, size)
    blind = singular < SINGULAR * singular[0]
    unknown = logs & (reach * np.sqrt(np.diag(inner)) > WIDEST)
    for row in right[blind]:
        unknown |= np.abs(row) > PART * np.abs(row).max()
    raw = np.where(logs, np.exp(np.where(logs, x, 0.0)), x)
    slope = np.where(logs, raw, 1.0)
    full = inner * np.outer(slope, slope)
    error = np.sqrt(np.diag(full))
    half = reach * np.sqrt(np.diag(inner))
    low = np.where(logs, raw * np.exp(-np.minimum(half, 700) * logs), x - half)
    high = np.where(logs, raw * np.exp(np.minimum(half, 300) * logs), x + half)
    shown = [np.where(unknown, np.nan, column) for column in (raw, error, low, high)]
    cover = full.copy()
    cover[unknown], cover[:, unknown] = np.nan, np.nan
    values, errors = dict(zip(names, shown[0].tolist(), strict=True)), dict(zip(names, shown[1].tolist(), strict=True))
    intervals = {name: (float(i), float(j)) for name, i, j in zip(names, shown[2], shown[3], strict=True)}
    raws = dict(zip(names, raw.tolist(), strict=True))
    sentence = _sentence(names, unknown, inner, raws, full, reach)
    return Known(values, errors, intervals, cover, not unknown.any(), sentence, raws, full)


def _sentence(names, unknown, inner, raw: dict, full, reach: float) -> str:
    if not unknown.any():
        return "all parameters are known from these data"
    among = np.flatnonzero(unknown)
    block = inner[np.ix_(among, among)]
    values, vectors = np.linalg.eigh(block)
    direction = vectors[:, -1] / vectors[np.abs(vectors[:, -1]).argmax(), -1]
    part = [k for k in range(len(among)) if abs(direction[k]) > PART]
    involved = [names[among[k]] for k in part]
    lost = ", ".join(names[k] for k in among)
    if len(part) == 1:
        hint = f"{involved[0]} hardly changes what was measured: fix it, or add data in which it matters"
    else:
        hint = f"{' and '.join(involved)} trade off against each other: fix one of them, or add data that separate them"
        hint = _only(names, involved, raw, full, reach) + hint
    return f"these data do not tell {lost}: {hint}"


def _only(names, involved, raw: dict, full, reach: float) -> str:
    """What is known of two parameters that are not known by themselves."""
    if not {"a", "b"} <= set(involved):
        return ""
    weights = np.array([{"a": 1.0, "b": -1.0}.get(name, 0.0) for name in names])
    error = reach * float(np.sqrt(max(weights @ full @ weights, 0.0)))
    if error > 0.5 * max(raw["a"], raw["b"]):
        return ""
    return f"only a − b = {raw['a'] - raw['b']:.3g} ± {error:.1g} is known, "
