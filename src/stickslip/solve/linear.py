"""Solving with −J: dense LAPACK when small, PARDISO where it is installed, SuperLU elsewhere."""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, get_lapack_funcs
from scipy.sparse.linalg import splu

DENSE_BELOW = 700  # coordinates; below it LAPACK is faster than a sparse factorisation
Solve = Callable[[np.ndarray], np.ndarray]


def has_pardiso() -> bool:
    """True if the extra `fast` is installed."""
    return find_spec("pypardiso") is not None


def factorised(matrix, *, method: str | None = None) -> Solve:
    """A function that solves with a square sparse matrix, factorised once.

    Parameters
    ----------
    matrix : (n, n) sparse, all diagonal entries stored
    method : "dense", "pardiso" or "superlu"; default: by size and by what is installed

    Raises
    ------
    LinAlgError
        if the matrix is singular to round-off.
    """
    method = method or ("dense" if matrix.shape[0] < DENSE_BELOW else "pardiso" if has_pardiso() else "superlu")
    return {"dense": _dense, "pardiso": _pardiso, "superlu": _superlu}[method](matrix)


def _dense(matrix) -> Solve:
    full = matrix.toarray(order="F")
    getrf, getrs = get_lapack_funcs(("getrf", "getrs"), (full,))
    lu, pivots, info = getrf(full, overwrite_a=True)
    diagonal = np.abs(np.diag(lu))
    if info or not diagonal.min(initial=np.inf) > 1e-15 * diagonal.max(initial=0.0):
        raise LinAlgError("singular")
    return lambda b: getrs(lu, pivots, b)[0]


def _superlu(matrix) -> Solve:
    try:
        factor = splu(
            sparse.csc_array(matrix),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=1e-3,
            options={"SymmetricMode": True},
        )
    except RuntimeError as problem:
        raise LinAlgError(str(problem)) from None
    return factor.solve


class _pardiso:  # noqa: N801 - used as a function; holds memory outside Python that it must give back
    def __init__(self, matrix):
        from pypardiso import PyPardisoSolver

        self.matrix = sparse.csr_matrix(matrix)
        self.matrix.sort_indices()
        self.solver = PyPardisoSolver(mtype=11)
        self.solver.factorize(self.matrix)

    def __call__(self, b: np.ndarray) -> np.ndarray:
        return self.solver.solve(self.matrix, b)

    def __del__(self):
        if solver := getattr(self, "solver", None):
            solver.free_memory(everything=True)
