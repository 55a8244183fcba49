"""Growing exponents of a packing with dashpots, from the first-order form of M q̈ = J q + C q̇."""

import numpy as np
from scipy import sparse
from scipy.linalg import eig
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, splu

from .freedom import PAIR_ABOVE, ZERO_BELOW, Freedom
from .linear import suitable_threads

DENSE_UP_TO = 1_250  # coordinates, solved within seconds; the first-order form has twice as many
DENSE_AT_MOST = 4_000  # coordinates, solved within minutes
NEAR = 4  # exponents computed near each one of the undamped motion
NEAR_ZERO = 18  # exponents computed near zero, where translations take six
TOLERANCE = 1e-10  # relative, of the inverse distance from the shift
STARTS = 8  # undamped pairs near which exponents are sought, the fastest first


def check_damped_method(method: str, size: int) -> None:
    """Raise ValueError if a method of `stability` cannot treat `size` coordinates with dashpots."""
    if method == "certify":
        raise ValueError("method 'certify' was given for a law with dashpots: use 'all', or leave the dashpots out")
    if method == "dense" and size > DENSE_AT_MOST:
        raise ValueError(
            f"{size} coordinates were given: the method 'dense' with dashpots takes at most {DENSE_AT_MOST}; use "
            f"'pairs' or 'fastest', or leave the dashpots out"
        )


def growing_exponents(
    pull, dampers, free: Freedom, undamped: np.ndarray, method: str, report
) -> tuple[np.ndarray, np.ndarray, complex | None, str]:
    """Growing exponents s of exp(st) with dashpots, each contact held in its mode.

    Parameters
    ----------
    pull : (n, n) sparse A of `dynamical_matrix` [1/time²]
    dampers : (n, n) sparse ∂(Pᵀf)/∂q̇ [force time/length]
    undamped : (P,) complex, growing exponents without dashpots, near which others are sought in large packings [1/time]
    method : of `stability`; "dense", "all", "auto" and "fastest" compute all exponents of up to 1250 coordinates

    Returns
    -------
    exponents : (K,) Re s > 0, Im s ≤ 0, one of each conjugate pair, fastest growing first [1/time]
    modes : (n, K) complex: generalised displacements of unit mass-weighted norm
    slowest : exponent of the slowest decay [1/time]; None if not all were computed
    scope : limits of the search, in words

    Source
    ------
    Tisseur & Meerbergen, doi:10.1137/S0036144500381988, Sec. 3.4, for the first-order form of the quadratic
    eigenvalue problem.
    """
    root = 1 / np.sqrt(free.mass)
    drag = sparse.csr_array(sparse.diags_array(-root) @ dampers @ sparse.diags_array(root))
    unit = np.sqrt(np.abs(pull.data).max())  # [1/time]: in this unit both blocks are of order one
    pull, drag = pull / unit**2, drag / unit
    if method == "dense" or (method in ("auto", "all", "fastest") and len(free) <= DENSE_UP_TO):
        values, vectors, slowest, scope = *_solve_dense(pull, drag), ""
    else:
        values, vectors = _search_near_shifts(pull, drag, undamped / unit, report)
        slowest = None
        scope = (
            f"exponents were sought near the {min(len(undamped), STARTS)} fastest of the undamped motion and near zero"
            "; growth caused by dashpots alone was not sought"
        )
    order = np.lexsort((values.imag, -values.real))
    modes = vectors[:, order].conj() * root[:, None]
    return unit * values[order].conj(), modes, None if slowest is None else unit * slowest, scope


def _is_growing(values: np.ndarray) -> np.ndarray:
    """Mask of growing nonzero exponents, one of each pair. Translations give s = 0 twice, split by round-off."""
    return (values.real > PAIR_ABOVE) & (values.imag >= 0) & (np.abs(values) ** 2 > ZERO_BELOW)


def _solve_dense(pull, drag) -> tuple[np.ndarray, np.ndarray, complex]:
    """Growing exponents, their mass-weighted modes, and the slowest decay, in units of the largest λ."""
    n = pull.shape[0]
    form = np.block([[np.zeros((n, n)), np.eye(n)], [-pull.toarray(), -drag.toarray()]])
    with suitable_threads(n):
        values, vectors = eig(form, overwrite_a=True)
    chosen = np.flatnonzero(_is_growing(values))
    decaying = values[(np.abs(values) ** 2 > ZERO_BELOW) & (values.real <= PAIR_ABOVE)]
    slowest = complex(decaying[np.argmax(decaying.real)]) if len(decaying) else None
    return values[chosen], _normalise_columns(vectors[:n, chosen]), slowest


def _normalise_columns(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=0, keepdims=True)


def _search_near_shifts(pull, drag, starts: np.ndarray, report) -> tuple[np.ndarray, np.ndarray]:
    """Growing exponents near those of the undamped motion and near zero, by shift and invert, without duplicates."""
    n = pull.shape[0]
    chosen = starts[np.argsort(-starts.real)][:STARTS]
    shifts = [1e-3, *(complex(s.real, abs(s.imag)) for s in chosen)]
    values, vectors = np.zeros(0, complex), np.zeros((n, 0), complex)
    for k, shift in enumerate(shifts):
        if report:
            report("exponents with dashpots", k / len(shifts), f"{len(values)} growing so far")
        exponents, modes = _exponents_near(pull, drag, complex(shift), NEAR if k else NEAR_ZERO)
        exponents = np.where(np.abs(exponents.imag) <= PAIR_ABOVE, exponents.real, exponents)  # round-off of a real one
        exponents, modes = exponents[_is_growing(exponents)], modes[:, _is_growing(exponents)]
        new = [not np.any(np.abs(values - s) < 1e-8) for s in exponents]
        values, vectors = np.append(values, exponents[new]), np.hstack([vectors, modes[:, new]])
    return values, _normalise_columns(vectors)


def _exponents_near(pull, drag, shift: complex, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Exponents nearest to a shift σ, and their modes; (A − σ)⁻¹ takes one factorisation of σ² + σ C + K."""
    n = pull.shape[0]
    quadratic = sparse.csc_array(shift**2 * sparse.eye_array(n) + shift * drag + pull)
    # the pattern is symmetric: an ordering that uses this has a tenth of the fill of the default
    solve = splu(quadratic, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-2, options={"SymmetricMode": True})

    def inverse(x):
        u, v = x[:n].astype(complex), x[n:].astype(complex)
        top = -solve.solve(v + drag @ u + shift * u)
        return np.concatenate([top, u + shift * top])

    operator = LinearOperator((2 * n, 2 * n), matvec=inverse, dtype=complex)
    start = np.random.default_rng(0).normal(size=2 * n).astype(complex)
    try:
        theta, vectors = eigs(operator, k=min(count, n - 2), which="LM", v0=start, tol=TOLERANCE)
    except ArpackNoConvergence as problem:
        theta, vectors = problem.eigenvalues, problem.eigenvectors
    return shift + 1 / theta, vectors[:n]
