"""Density of states and participation ratio of modes."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import eigvals
from scipy.sparse.linalg import eigsh

from ..core.arguments import Seed, checked
from ..core.laws.builtin import Law
from ..core.readable import readable
from ..core.sizes import Size, require_sizes
from ..core.state import State
from .freedom import ZERO_BELOW, Freedom, backbone, dynamical_matrix, translations
from .linear import suitable_threads
from .spectrum import REAL_BELOW

DENSE_UP_TO = 2_500  # coordinates, solved within half a minute
PROBES = 16  # random vectors for the trace
MARGIN = 0.01  # margin beyond the bounds, over the width of the spectrum; the bounds are computed to a tenth of it
SHARP = 4.0  # ratio of the bin width to the resolution of the polynomials


@checked
def participation_ratio(modes: np.ndarray, free: Freedom) -> np.ndarray:
    """Participation ratio of modes, the fraction of bodies that take part.

    p = (Σ_b w_b)²/(N Σ_b w_b²), where w_b = Σ m |q|² over the coordinates of body b. It is 1 if all bodies move alike,
    as in a plane wave, and 1/N if only one moves. The weights include mass, rotations and |q|² of complex modes; for
    grains of equal mass they are the squares of polarisation vectors. A rigid group counts as one body with the mass of
    all its members, and so does a free cell.

    Parameters
    ----------
    modes : (n, K) real or complex generalised displacements, as in `Spectrum`, `Stability` and `ComplexPairs`
    free : Freedom of the modes, with N bodies; those of `stability` and `density_of_states` exclude rattlers

    Returns
    -------
    (K,) between 1/N and 1

    Source
    ------
    Bell & Dean, doi:10.1039/df9705000055; Silbert, Liu & Nagel, doi:10.1103/PhysRevE.79.021308, for
    polarisation vectors.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.linear()
    >>> state = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> pair = ss.spectrum(state, law)
    >>> round(float(participation_ratio(pair.modes, pair.free)[-1]), 6)
    1.0
    """
    modes = np.asarray(modes)
    if modes.ndim != 2 or len(modes) != len(free):
        raise ValueError(f"modes of shape {modes.shape} were given: (n, K) with n = {len(free)} as in `free` is needed")
    bodies, where = np.unique(free.body, return_inverse=True)
    weight = np.zeros((len(bodies), modes.shape[1]))
    np.add.at(weight, where, free.mass[:, None] * np.abs(modes) ** 2)
    return weight.sum(axis=0) ** 2 / (len(bodies) * (weight**2).sum(axis=0))


@readable
class DensityOfStates(NamedTuple):
    """D(ω) of an undamped packing. Σ density · Δω is the fraction of its n modes with frequencies within the edges."""

    edges: np.ndarray  # (B + 1,) [1/time]
    density: np.ndarray  # (B,) D, with real λ > 0 at ω = √λ and both members of complex pairs at ω = |Re √λ| [time]
    error: np.ndarray  # (B,) standard error from the random probes; zero if all eigenvalues were computed [time]
    of_pairs: np.ndarray  # (B,) contribution of complex pairs to `density`; NaN if it was not computed [time]
    frequency: np.ndarray  # (K,) of all oscillating modes, sorted; empty if not all eigenvalues were computed [1/time]
    n: int  # number of modes: coordinates without those of rattlers
    zero: int  # modes that do not oscillate, λ = 0
    negative: int  # modes with λ < 0; −1 if they were not counted
    resolution: float  # resolution of frequencies; 0 if all eigenvalues were computed [1/time]
    method: str  # "dense" or "polynomials"

    @property
    def middle(self) -> np.ndarray:
        """(B,) centres of the bins [1/time]."""
        return (self.edges[1:] + self.edges[:-1]) / 2


@checked
def density_of_states(
    state: State, law: Law, *, bins: int | np.ndarray = 50, method: str = "auto", probes: int = PROBES, seed: Seed = 0,
    report: Callable | None = None,
) -> DensityOfStates:  # fmt: skip
    """Density of states D(ω) = (1/n) Σ_k δ(ω − ω_k), ω_k = |Re √λ_k| of the n eigenvalues of −M⁻¹J.

    Rattlers are excluded. J is not symmetric: a pair λ_r ± iλ_i counts twice, at its ω_r, and is also reported
    separately in `of_pairs`. Modes with λ = 0 and λ < 0 have no frequency and are counted separately.

    Parameters
    ----------
    bins : number of bins between 0 and the largest frequency, or their edges [1/time]
    method : "dense" computes all eigenvalues (at most 10,000 coordinates); "polynomials" estimates the counts by the
        kernel polynomial method: (1/n) tr T_k(A) with random probes, the Jackson kernel and bins integrated in closed
        form. It uses Re λ of pairs, with errors of order (λ_i/λ_max)², and counts negative λ and zero modes
        other than translations in the lowest bin. "auto": dense up to 2500 coordinates
    probes, seed : number of random vectors of ±1, and their seed; the error falls as 1/√(probes n)
    report : called as report(stage, share done, words)

    Source
    ------
    Weiße, Wellein, Alvermann & Fehske, doi:10.1103/RevModPhys.78.275, Sec. II.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.linear()
    >>> state = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> pair = density_of_states(state, law, bins=2)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    ValueError: the packing has only rattlers: a density of states needs grains ...
    """
    if method not in ("auto", "dense", "polynomials"):
        raise ValueError(f"method {method!r} was given: use auto, dense or polynomials")
    if isinstance(bins, int | np.integer):
        require_sizes([Size(f"bins = {bins} makes", bins, "points", "use fewer bins")])
    free = backbone(state, law)
    if not len(free):
        raise ValueError("the packing has only rattlers: a density of states needs grains that support each other")
    if method == "auto":
        method = "dense" if len(free) <= DENSE_UP_TO else "polynomials"
    if method == "dense" and len(free) > 10_000:
        raise ValueError(
            f"{len(free)} coordinates were given: the method 'dense' takes at most 10000; use 'polynomials'"
        )
    matrix = dynamical_matrix(state, law, free)
    if method == "dense":
        with suitable_threads(len(free)):
            return _count_modes(eigvals(matrix.toarray(), overwrite_a=True), bins)
    return _estimate_density(matrix, translations(matrix, free), bins, probes, seed, report)


def _bin_edges(bins, largest: float) -> np.ndarray:
    if np.ndim(bins) == 0 and not (isinstance(bins, int | np.integer) and bins > 0):
        raise ValueError(f"bins = {bins} was given: a number of bins, at least 1, or their edges are needed")
    edges = np.linspace(0.0, largest, bins + 1) if np.ndim(bins) == 0 else np.asarray(bins, float)
    if edges.ndim != 1 or len(edges) < 2 or not (np.diff(edges) > 0).all() or edges[0] < 0:
        raise ValueError("the bin edges must be at least two increasing frequencies, none of them negative")
    return edges


def _count_modes(values: np.ndarray, bins) -> DensityOfStates:
    n, scale = len(values), np.abs(values).max(initial=0.0)
    zero, complex_ones = np.abs(values) < ZERO_BELOW * scale, np.abs(values.imag) > REAL_BELOW * scale
    negative = ~zero & ~complex_ones & (values.real < 0)
    rings = ~zero & ~negative
    frequency = np.abs(np.sqrt(values).real)
    # keep the largest frequency in the last bin in spite of round-off
    edges = _bin_edges(bins, frequency.max(initial=0.0) * (1 + 1e-12) or 1.0)
    per = n * np.diff(edges)
    density, of_pairs = (np.histogram(frequency[chosen], edges)[0] / per for chosen in (rings, rings & complex_ones))
    return DensityOfStates(
        edges, density, np.zeros(len(per)), of_pairs, np.sort(frequency[rings]), n, int(zero.sum()),
        int(negative.sum()), 0.0, "dense",
    )  # fmt: skip


def _estimate_density(matrix, rigid: np.ndarray, bins, probes: int, seed: int, report) -> DensityOfStates:
    """Density from Chebyshev moments.

    With λ = centre + half cos θ, a resolution of π/K in θ corresponds to √λ_max/2 π/K in ω.
    """
    if probes < 2:
        raise ValueError(f"probes = {probes} was given: at least 2 are needed to estimate the error")
    n, rng = matrix.shape[0], np.random.default_rng(seed)
    low, high = _spectral_bounds(matrix, rng.standard_normal(n))
    edges = _bin_edges(bins, float(np.sqrt(high)))
    half, centre = (high - low) / 2, (high + low) / 2
    order = int(np.ceil(SHARP * np.pi * np.sqrt(high) / 2 / np.diff(edges).min()))
    moments = np.empty((order, probes))
    vectors = rng.choice([-1.0, 1.0], (n, probes))
    vectors -= rigid @ (rigid.T @ vectors)
    before, now = vectors, (matrix @ vectors - centre * vectors) / half
    moments[0] = np.einsum("ij,ij->j", vectors, vectors)
    for k in range(1, order):
        moments[k] = np.einsum("ij,ij->j", vectors, now)
        before, now = now, 2 / half * (matrix @ now - centre * now) - before
        if report and k % 50 == 0:
            report("density of states", k / order, f"{k} of {order} polynomials")
    moments *= (n - rigid.shape[1]) / moments[0]
    angle = np.arccos(np.clip((edges**2 - centre) / half, -1.0, 1.0))
    angle[0] = np.pi if edges[0] == 0 else angle[0]  # the part smeared below zero belongs to the first bin
    k = np.arange(1, order)
    weights = 2 * _jackson_factors(order)[1:, None] * np.sin(k[:, None] * angle) / k[:, None]
    above = (angle[:, None] * moments[0] + weights.T @ moments[1:]) / np.pi  # number of λ above each edge
    share = -np.diff(above, axis=0) / (n * np.diff(edges)[:, None])
    error = share.std(axis=1, ddof=1) / np.sqrt(probes)
    return DensityOfStates(
        edges, share.mean(axis=1), error, np.full(len(error), np.nan), np.zeros(0), n, rigid.shape[1], -1,
        float(np.sqrt(high) / 2 * np.pi / order), "polynomials",
    )  # fmt: skip


def _spectral_bounds(matrix, start: np.ndarray) -> tuple[float, float]:
    """Interval that contains all real parts and zero, from the symmetric part with a margin."""
    symmetric, identity = (matrix + matrix.T) / 2, sparse.eye_array(matrix.shape[0])

    def top(of) -> float:
        return float(eigsh(of, k=1, which="LA", tol=0.1 * MARGIN, v0=start, return_eigenvectors=False)[0])

    high = top(symmetric)
    low = min(
        high - top(high * identity - symmetric), 0.0
    )  # the smallest may be zero, where a relative tolerance fails
    return low - MARGIN * (high - low), high + MARGIN * (high - low)


def _jackson_factors(order: int) -> np.ndarray:
    """(K,) factors of the Jackson kernel, which keep the density positive."""
    k, step = np.arange(order), np.pi / (order + 1)
    return ((order - k + 1) * np.cos(k * step) + np.sin(k * step) / np.tan(step)) / (order + 1)
