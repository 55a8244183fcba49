"""Solving with −J: dense LAPACK when small, PARDISO where it is installed, SuperLU elsewhere."""

import os
import weakref
from collections.abc import Callable
from functools import cache

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, get_lapack_funcs
from scipy.sparse.linalg import splu
from threadpoolctl import ThreadpoolController

from ..extras import MissingExtraError, broken, needed, present

DENSE_BELOW = 700  # coordinates; below it LAPACK is faster than a sparse factorisation
Solve = Callable[[np.ndarray], np.ndarray]


@cache
def _thread_controller() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread():
    """Within it BLAS uses one thread.

    A few hundred coordinates are solved sooner that way, and on a machine that others use, too, ten times sooner.
    """
    return _thread_controller().limit(limits=1, user_api="blas")


@cache
def has_pardiso() -> bool:
    """True if the extra `fast` is installed and its library can be loaded; SuperLU serves where it is broken."""
    try:
        return present("pypardiso") and _pardiso_solver() is not None
    except MissingExtraError:
        return False


def factorised(matrix, *, method: str | None = None, ordered: bool = False) -> Solve:
    """A function that solves with a square sparse matrix, factorised once.

    Parameters
    ----------
    matrix : (n, n) sparse, all diagonal entries stored
    method : "dense", "pardiso" or "superlu"; default: by size and by what is installed
    ordered : whether the coordinates stand in an order of little fill, so that SuperLU need not look for one

    Raises
    ------
    LinAlgError
        if the matrix is singular to round-off.
    """
    method = method or ("dense" if matrix.shape[0] < DENSE_BELOW else "pardiso" if has_pardiso() else "superlu")
    if method == "superlu":
        # a matrix with so little fill that its order is known has no wide supernodes to gain from panels
        return (
            _factorise_superlu(matrix, "NATURAL", relax=1, panel_size=1)
            if ordered
            else _factorise_superlu(matrix, "MMD_AT_PLUS_A")
        )
    return {"dense": _factorise_dense, "pardiso": _factorise_pardiso}[method](matrix)


def _factorise_dense(matrix) -> Solve:
    full = matrix.toarray(order="F")
    getrf, getrs = get_lapack_funcs(("getrf", "getrs"), (full,))
    with one_thread():
        lu, pivots, info = getrf(full, overwrite_a=True)
    diagonal = np.abs(np.diag(lu))
    if info or not diagonal.min(initial=np.inf) > 1e-15 * diagonal.max(initial=0.0):
        raise LinAlgError("singular")

    def solve(b: np.ndarray) -> np.ndarray:
        with one_thread():
            return getrs(lu, pivots, b)[0]

    return solve


def _factorise_superlu(matrix, order: str, **sizes) -> Solve:
    try:
        factor = splu(sparse.csc_array(matrix), order, diag_pivot_thresh=1e-3, options={"SymmetricMode": True}, **sizes)
    except RuntimeError as problem:
        raise LinAlgError(str(problem)) from None
    return factor.solve


def _pardiso_solver():
    """PARDISO for matrices without symmetry."""
    room = needed("pypardiso", "fast")
    try:
        return room.PyPardisoSolver(mtype=11)
    except (ImportError, OSError) as problem:  # it looks for MKL here, not when it is imported
        raise broken("pypardiso", "fast", problem) from problem


def _factorise_pardiso(matrix) -> Solve:
    matrix = sparse.csr_matrix(matrix)
    matrix.sort_indices()
    solver = _pardiso_solver()
    os.environ.setdefault("PYPARDISO_MKL_RT", solver.libmkl._name)  # or the next one searches the disk again
    solver.factorize(matrix)

    def solve(b: np.ndarray) -> np.ndarray:
        return solver.solve(matrix, b)

    weakref.finalize(solve, solver.free_memory, everything=True)  # it lies outside of Python's memory
    return solve
