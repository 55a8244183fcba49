"""Linear solvers for −J: dense LAPACK for small systems, GMRES, and PARDISO where installed, otherwise SuperLU."""

import os
import weakref
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, get_lapack_funcs
from scipy.sparse.linalg import LinearOperator, gmres, splu
from threadpoolctl import ThreadpoolController

from ..extras import MissingExtraError, broken_extra, is_installed, require

DENSE_BELOW = 700  # coordinates below which LAPACK is faster than a sparse factorisation
RESTART = 100  # vectors that GMRES stores
Solve = Callable[[np.ndarray], np.ndarray]


@cache
def _thread_controller() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread():
    """Context manager that limits BLAS to one thread.

    Systems of a few hundred coordinates are solved faster this way, up to ten times faster on a shared machine.
    """
    return _thread_controller().limit(limits=1, user_api="blas")


def suitable_threads(size: int):
    """Context manager for dense linear algebra with `size` coordinates: one BLAS thread below DENSE_BELOW."""
    return one_thread() if size < DENSE_BELOW else nullcontext()


@cache
def has_pardiso() -> bool:
    """Return True if the extra `fast` is installed and its library can be loaded; otherwise SuperLU is used."""
    try:
        return is_installed("pypardiso") and _pardiso_solver() is not None
    except MissingExtraError:
        return False


def factorised(matrix, *, method: str | None = None, ordered: bool = False) -> Solve:
    """Return a function that solves linear systems with a square sparse matrix, which is factorised once.

    Parameters
    ----------
    matrix : (n, n) sparse, all diagonal entries stored
    method : "dense", "pardiso" or "superlu"; default: chosen by size and by what is installed
    ordered : whether the coordinates are already in a fill-reducing order, so that SuperLU need not compute one

    Raises
    ------
    LinAlgError
        if the matrix is singular to round-off.
    """
    method = method or ("dense" if matrix.shape[0] < DENSE_BELOW else "pardiso" if has_pardiso() else "superlu")
    if method == "superlu":
        # with so little fill there are no wide supernodes that would benefit from panels
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
    """PARDISO solver for unsymmetric matrices."""
    room = require("pypardiso", "fast")
    try:
        return room.PyPardisoSolver(mtype=11)
    except (ImportError, OSError) as problem:  # MKL is loaded here, not on import
        raise broken_extra("pypardiso", "fast", problem) from problem


def _factorise_pardiso(matrix) -> Solve:
    matrix = sparse.csr_matrix(matrix)
    matrix.sort_indices()
    solver = _pardiso_solver()
    os.environ.setdefault("PYPARDISO_MKL_RT", solver.libmkl._name)  # otherwise the next solver searches the disk again
    solver.factorize(matrix)

    def solve(b: np.ndarray) -> np.ndarray:
        return solver.solve(matrix, b)

    weakref.finalize(solve, solver.free_memory, everything=True)  # allocated outside Python
    return solve


def block_diagonal_solve(matrix, groups: np.ndarray) -> Solve:
    """Return a function that solves with the diagonal blocks of a sparse matrix, a preconditioner for `iterate`.

    Parameters
    ----------
    matrix : (n, n) sparse
    groups : (n,) int, sorted; coordinates of the same group form a block
    """
    starts = np.flatnonzero(np.diff(groups, prepend=-1))
    block = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(groups)))
    place = np.arange(len(groups)) - starts[block]
    rows = np.repeat(np.arange(len(groups)), np.diff(matrix.indptr))
    inside = np.flatnonzero(block[rows] == block[matrix.indices])
    rows, cols = rows[inside], matrix.indices[inside]
    width = int(place.max(initial=0)) + 1
    blocks = np.zeros((len(starts), width, width))
    blocks[:, np.arange(width), np.arange(width)] = 1.0
    blocks[block, place, place] = 1e-9 * np.abs(matrix.data).max(initial=0.0)  # regular even without a contact
    np.add.at(blocks, (block[rows], place[rows], place[cols]), matrix.data[inside])
    inverse, slot = np.linalg.inv(blocks), width * block + place

    def solve(b: np.ndarray) -> np.ndarray:
        padded = np.zeros(width * len(starts))
        padded[slot] = b
        return (inverse @ padded.reshape(-1, width, 1)).ravel()[slot]

    return solve


def iterate(matrix, b: np.ndarray, precondition: Solve, relative: float, limit: int) -> tuple[np.ndarray, int]:
    """Solve a linear system by GMRES, to a residual of `relative` times that of zero.

    Returns the solution and the number of iterations; if that is `limit`, the solution may be less accurate.
    """
    spent = [0]

    def count(_):
        spent[0] += 1

    before = LinearOperator(matrix.shape, matvec=precondition, dtype=float)
    restart = min(RESTART, limit)
    rounds = -(-limit // restart)
    options = {"restart": restart, "maxiter": rounds, "callback": count, "callback_type": "pr_norm"}
    with one_thread():
        x, _ = gmres(matrix, b, M=before, rtol=relative, **options)
    return x, spent[0]
