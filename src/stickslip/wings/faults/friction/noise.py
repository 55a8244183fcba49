"""Correlated noise: autoregressive models of residuals, and whitening filters."""

import numpy as np
from scipy.linalg import cholesky, toeplitz

MOST = 4  # largest order
WHITE = (np.zeros(0), np.zeros((0, 0)))


def autocovariance(pieces, lags: int) -> np.ndarray:
    """γ_l = Σ r_i r_{i+l} / N over pieces of a series, (lags + 1,); the biased form, which is positive definite."""
    total = sum(len(r) for r in pieces)
    return (
        np.array([sum(float(r[: len(r) - k] @ r[k:]) for r in pieces if len(r) > k) for k in range(lags + 1)]) / total
    )


def autoregression(pieces, most: int = MOST, *, taken=()) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients φ of r_i = Σ φ_m r_{i−m} + e_i, with order selected by BIC, and the head of the whitening filter.

    Uses Levinson's recursion on the autocovariance (Yule and Walker). Noise absorbed by a fit is added: residuals of
    generalised least squares have the covariance Σ − J C Jᵀ, where C is that of the parameters, so the noise looks
    less correlated than it is.

    Parameters
    ----------
    pieces : residuals without gaps, each (n_i,)
    taken : columns g, each in the same pieces, with Σ_k g_k g_kᵀ = J C Jᵀ; empty if the pieces are the noise itself

    Returns
    -------
    φ : (p,)
    head : (p, p) lower triangular matrix that whitens the first p values: L⁻¹, with LLᵀ their covariance over the
        variance of e
    """
    total = sum(len(r) for r in pieces)
    lags = min(most, max(total // 20, 0))
    gamma = sum((autocovariance(column, lags) for column in taken), autocovariance(pieces, lags))
    if gamma[0] <= 1e-300:
        return np.zeros(0), np.zeros((0, 0))
    phi, variance = np.zeros(0), gamma[0]
    best, score = (phi, variance), total * np.log(variance)
    for order in range(1, len(gamma)):
        reflection = (gamma[order] - phi @ gamma[order - 1 : 0 : -1]) / variance
        phi = np.append(phi - reflection * phi[::-1], reflection)
        variance = max(variance * (1 - reflection**2), 1e-300)
        bic = total * np.log(variance) + order * np.log(total)
        if bic < score:
            best, score = (phi, variance), bic
    phi, variance = best
    if len(phi) == 0:
        return WHITE
    return phi, np.linalg.inv(cholesky(toeplitz(gamma[: len(phi)]) / variance, lower=True))


def whitened(rows, noise, pieces) -> np.ndarray:
    """Rows (N, …) of a series, filtered so that the noise becomes white with the variance of e.

    Parameters
    ----------
    noise : φ and head, from `autoregression`
    pieces : slices of contiguous rows, which together cover all rows
    """
    phi, head = noise
    out = np.array(rows, float)
    for piece in pieces:
        part = np.asarray(rows[piece], float)
        done = part.copy()
        for m, coefficient in enumerate(phi, start=1):
            done[m:] -= coefficient * part[:-m]
        n = min(len(phi), len(part))
        if n:
            done[:n] = head[:n, :n] @ part[:n]
        out[piece] = done
    return out


def effective_samples(noise, total: int) -> float:
    """Number of independent samples that carry the same information about a mean as `total` samples with this noise."""
    phi, head = noise
    if len(phi) == 0:
        return float(total)
    return min(total / head[0, 0] ** 2 * (1 - phi.sum()) ** 2, float(total))


def log_head_volume(noise, pieces) -> float:
    """Contribution of the heads of the pieces to the log-determinant of the noise."""
    phi, head = noise
    logs = -np.cumsum(np.log(np.diag(head))) if len(phi) else np.zeros(0)
    return sum(float(logs[min(len(phi), piece.stop - piece.start) - 1]) for piece in pieces) if len(phi) else 0.0
