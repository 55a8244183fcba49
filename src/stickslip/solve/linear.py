"""Linear solvers for −J: dense LAPACK, GMRES, PARDISO where installed, otherwise SuperLU, and multifrontal factors.

Multifrontal factors are those of the dynamical matrix, ordered by nested dissection of the grains. A box of grains is
divided into two halves, and the grains of one half that touch the other are eliminated last, at every level. The
remainder of each part is a dense matrix, so nearly all work is done by BLAS. From a few thousand spheres on, these
factors take less time than those of SuperLU. The fronts also count eigenvalues of a symmetric matrix below a shift.
"""

import os
import weakref
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, get_lapack_funcs
from scipy.sparse.linalg import LinearOperator, gmres, splu
from threadpoolctl import ThreadpoolController

from ..core.library import core
from ..core.state import State
from ..extras import MissingExtraError, broken_extra, is_installed, require
from .freedom import Freedom

DENSE_BELOW = 700  # number of coordinates below which LAPACK is faster than a sparse factorisation
RESTART = 100  # number of vectors that GMRES stores
Solve = Callable[[np.ndarray], np.ndarray]
LEAF = 24  # number of bodies in a part that nested dissection does not divide further
HUB = 8  # bodies with more than this multiple of the mean number of neighbours, such as walls, are eliminated last
FACTORS_UP_TO = 90_000  # number of coordinates; factors for 60,000 take 3 GiB, those for 120,000 take 7 GiB


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
    matrix : (n, n) sparse, with all diagonal entries stored
    method : "dense", "pardiso" or "superlu"; default: chosen by size and installed libraries
    ordered : whether the coordinates are already in a fill-reducing order, so that SuperLU need not compute one

    Raises
    ------
    LinAlgError
        If the matrix is singular to round-off.
    """
    method = method or ("dense" if matrix.shape[0] < DENSE_BELOW else "pardiso" if has_pardiso() else "superlu")
    if method == "superlu":
        # with so little fill, there are no wide supernodes that would benefit from panels
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
    """Return a function that inverts the diagonal blocks of a sparse matrix, as a preconditioner for `iterate`.

    Parameters
    ----------
    matrix : (n, n) sparse
    groups : (n,) int, sorted; coordinates of the same group form a block
    """
    starts = np.flatnonzero(np.diff(groups, prepend=-1))
    block = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(groups)))
    offset = np.arange(len(groups)) - starts[block]
    rows = np.repeat(np.arange(len(groups)), np.diff(matrix.indptr))
    inside = np.flatnonzero(block[rows] == block[matrix.indices])
    rows, cols = rows[inside], matrix.indices[inside]
    width = int(offset.max(initial=0)) + 1
    blocks = np.zeros((len(starts), width, width))
    blocks[:, np.arange(width), np.arange(width)] = 1.0
    blocks[block, offset, offset] = 1e-9 * np.abs(matrix.data).max(initial=0.0)  # regular even without contacts
    np.add.at(blocks, (block[rows], offset[rows], offset[cols]), matrix.data[inside])
    inverse, slot = np.linalg.inv(blocks), width * block + offset

    def solve(b: np.ndarray) -> np.ndarray:
        padded = np.zeros(width * len(starts))
        padded[slot] = b
        return (inverse @ padded.reshape(-1, width, 1)).ravel()[slot]

    return solve


def iterate(matrix, b: np.ndarray, precondition: Solve, relative: float, limit: int) -> tuple[np.ndarray, int]:
    """Solve a linear system by GMRES, to a residual of `relative` times the initial one.

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


class Dissection(NamedTuple):
    """Order of elimination: one entry for each part, children before their parents."""

    pivots: list[np.ndarray]  # coordinates that are eliminated with each part
    children: list[list[int]]


class _Front(NamedTuple):
    """One part: its pivots are rows first … last of the permuted matrix."""

    first: int
    last: int
    border: np.ndarray  # later rows coupled to the pivots
    lu: np.ndarray
    swaps: np.ndarray
    upper: np.ndarray  # P⁻¹ A_PB
    lower: np.ndarray  # A_BP


def dissect(state: State, free: Freedom, coordinates: np.ndarray, matrix) -> Dissection:
    """Order the given coordinates of `free`, which are the rows of a sparse matrix, by nested dissection."""
    bodies, of = np.unique(free.body[coordinates], return_inverse=True)
    member = sparse.csr_array((np.ones(len(of)), (of, np.arange(len(of)))), shape=(len(bodies), len(of)))
    graph = sparse.csr_array(member @ abs(matrix) @ member.T)
    position = np.zeros((len(bodies), 3))
    grains = bodies < len(state.grains.radius)
    position[grains] = state.grains.position[bodies[grains]]
    fraction = np.linalg.solve(state.cell.vectors.T, position.T).T
    fraction = np.where(state.cell.periodic, fraction - np.floor(fraction), fraction)
    rows = np.split(np.argsort(of, kind="stable"), np.cumsum(np.bincount(of))[:-1])
    degree = np.diff(graph.indptr)
    hub = (degree > HUB * degree.mean()) | ~grains
    pivots, children, side = [], [], np.zeros(len(bodies), np.int8)

    def add(nodes, below):
        pivots.append(np.concatenate([rows[k] for k in nodes]) if len(nodes) else np.zeros(0, int))
        children.append(below)
        return len(pivots) - 1

    def divide(nodes):
        if len(nodes) <= LEAF:
            return add(nodes, [])
        left, right, between = min(
            (_cut(graph, side, nodes[np.argsort(fraction[nodes, axis], kind="stable")]) for axis in range(3)),
            key=lambda parts: len(parts[2]),
        )
        return add(between, [divide(part) for part in (left, right) if len(part)])

    ordinary = np.flatnonzero(~hub)
    below = [divide(ordinary)] if len(ordinary) else []
    if hub.any():
        add(np.flatnonzero(hub), below)
    return Dissection(pivots, children)


def _cut(graph, side: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two halves of sorted nodes without the smaller of the two sets that can separate them, and this set."""
    half = len(nodes) // 2
    first, second = nodes[:half], nodes[half:]
    side[first], side[second] = 1, 2
    of_first, of_second = _touches(graph, first, side == 2), _touches(graph, second, side == 1)
    side[nodes] = 0
    if of_first.sum() <= of_second.sum():
        return first[~of_first], second, first[of_first]
    return first, second[~of_second], second[of_second]


def _touches(graph, nodes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Mask of the nodes with a neighbour in `others`, which is a mask of all nodes."""
    own = graph[nodes]
    return np.bincount(np.repeat(np.arange(len(nodes)), np.diff(own.indptr)), others[own.indices], len(nodes)) > 0


class FrontalFactor:
    """LU factors of a sparse matrix with a symmetric pattern; rows are exchanged only within each part.

    Raises
    ------
    LinAlgError
        If a block of pivots is singular to round-off.
    """

    def __init__(self, matrix, order: Dissection):
        self._permutation = np.concatenate(order.pivots)
        rows = sparse.csr_array(sparse.csr_array(matrix)[self._permutation][:, self._permutation])
        columns = sparse.csc_array(rows)
        self._getrf, self._getrs = get_lapack_funcs(("getrf", "getrs"), dtype=rows.dtype)
        self._fronts, self._dtype, self.negative = [], rows.dtype, 0
        local, waiting, last = np.empty(len(self._permutation), np.int64), {}, 0
        for k, (pivots, children) in enumerate(zip(order.pivots, order.children, strict=True)):
            first, last = last, last + len(pivots)
            parts = [waiting.pop(child) for child in children]
            front, border = _assemble(rows, columns, first, last, parts, local)
            waiting[k] = border, self._eliminate(front, first, last, border)

    def _eliminate(self, front: np.ndarray, first: int, last: int, border: np.ndarray) -> np.ndarray:
        """Store the factors of the pivots, and return the Schur complement on their border."""
        m = last - first
        if not m:
            return front
        lu, swaps, _ = self._getrf(front[:m, :m])
        diagonal = np.abs(np.diag(lu))
        if not diagonal.min() > 1e-15 * diagonal.max():
            raise LinAlgError("singular")
        lower = np.asfortranarray(front[m:, :m])
        upper = self._getrs(lu, swaps, front[:m, m:])[0] if len(border) else front[:m, m:]
        self._fronts.append(_Front(first, last, border, lu, swaps, upper, lower))
        return front[m:, m:] - lower @ upper

    def solve(self, b: np.ndarray) -> np.ndarray:
        """Solve for the columns of b, (n, k)."""
        x = b[self._permutation].astype(self._dtype, copy=False)
        for front in self._fronts:
            pivots = self._getrs(front.lu, front.swaps, x[front.first : front.last])[0]
            x[front.first : front.last] = pivots
            x[front.border] -= front.lower @ pivots
        for front in reversed(self._fronts):
            x[front.first : front.last] -= front.upper @ x[front.border]
        out = np.empty_like(x)
        out[self._permutation] = x
        return out


def _assemble(rows, columns, first: int, last: int, parts, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Dense matrix of the pivots first … last and their border, and the border."""
    m, a, b = last - first, rows.indptr, columns.indptr
    right, below = rows.indices[a[first] : a[last]], columns.indices[b[first] : b[last]]
    near = np.concatenate([right, below, *(border for border, _ in parts)])
    border = np.unique(near[near >= last])
    local[first:last], local[border] = np.arange(m), m + np.arange(len(border))
    front = np.zeros((m + len(border),) * 2, rows.dtype, order="F")
    at, kept = np.repeat(np.arange(m), np.diff(a[first : last + 1])), right >= first
    front[at[kept], local[right[kept]]] = rows.data[a[first] : a[last]][kept]
    at, kept = np.repeat(np.arange(m), np.diff(b[first : last + 1])), below >= last
    front[local[below[kept]], at[kept]] = columns.data[b[first] : b[last]][kept]
    for rest, complement in parts:
        part, width = np.asfortranarray(complement).T, 1 + np.iscomplexobj(front)
        # NumPy's indexing would take half the time of a factorisation
        core.extend_add(len(rest), width, local[rest], part.view(float), len(front), front.T.view(float))
    return front, border


def count_below(matrix, shift: float, order: Dissection) -> int:
    """Number of eigenvalues of a symmetric sparse matrix below a shift, by Sylvester's law of inertia."""
    identity = sparse.eye_array(matrix.shape[0], format="csr")
    try:
        return _SignCount(matrix - shift * identity, order).negative
    except LinAlgError:  # the shift is an eigenvalue of a part
        return _SignCount(matrix - shift * (1 + 1e-9) * identity, order).negative


class _SignCount(FrontalFactor):
    """Number of negative eigenvalues of a symmetric matrix: the sum over all blocks of pivots (Haynsworth)."""

    def _eliminate(self, front: np.ndarray, first: int, last: int, border: np.ndarray) -> np.ndarray:
        m = last - first
        if not m:
            return front
        sysv, work = get_lapack_funcs(("sysv", "sysv_lwork"), dtype=float)
        right = front[:m, m:] if len(border) else np.zeros((m, 1))
        factor, swaps, upper, info = sysv(front[:m, :m], right, lwork=int(work(m)[0]))
        if info > 0:
            raise LinAlgError("singular")
        # Bunch and Kaufman's blocks of two, with negative swaps, have one eigenvalue of each sign
        self.negative += int((np.diag(factor)[swaps > 0] < 0).sum() + (swaps < 0).sum() // 2)
        return front[m:, m:] - front[m:, :m] @ upper[:, : len(border)]
