"""k(S) v = b for changing contact status S: one factor, corrected for few changes and made anew for many."""

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError
from scipy.sparse.linalg import splu

from ..solve.linear import factorised
from .matrices import LinearSystem, stiffness_matrix

# a factor is corrected for up to so many changed contacts, and made anew beyond: at 3000 disks 48 cost the same, but
# what comes of a correction is verified with a factor of its own
FEW = 24
RESIDUAL = 1e-6  # share of the load that k(S) v may miss: beyond it k(S) is as good as singular
ROUND_OFF = 1e-13  # of a velocity, over the largest one around: k has conditions of some hundreds around a body
AT_ONCE = 16  # right-hand sides of one call: more do not fit into the cache


class StatusSolver:
    """Velocities of a packing under one load rate, for whatever status of its critical contacts.

    Coordinates stand in the order in which bodies are eliminated with little fill, which is found once. Beside one for
    each free translation of the whole, those in `held` stand still.
    """

    def __init__(self, matrix: LinearSystem, load: np.ndarray, critical: np.ndarray, geometric: bool, held=()):
        self.critical, self.solves = critical, 0
        self.load = np.asarray(load, float)
        if self.load.shape != (len(matrix.free),):
            raise ValueError(
                f"a load of {self.load.shape} was given where {(len(matrix.free),)} is needed: one for each coordinate"
            )
        if not np.isfinite(self.load).all():
            raise ValueError("a load that is not finite was given: every component must be a number")
        order = elimination_order(matrix.c, matrix.free.body)
        self.kept = order[~np.isin(order, np.append(pins(matrix), np.asarray(held, np.int64)))]
        c = sparse.csr_array(matrix.c[self.kept])
        self.right = self.load[self.kept]
        turned = matrix.geometric[self.kept][:, self.kept] if geometric else matrix.geometric
        ordered = matrix._replace(c=c, geometric=turned)
        self.stuck = sparse.csc_array(stiffness_matrix(ordered, np.zeros(matrix.count, bool), geometric=geometric))
        columns = sparse.csc_array(c)
        normal, along = columns[:, 2 * critical], columns[:, 2 * critical + 1]
        sign, slope = matrix.sign[critical], matrix.slope[critical]
        self.pull = sparse.csc_array(along * (matrix.springs[critical, 1, 1] * sign))
        self.sees = sparse.csc_array(normal * slope + along * sign)
        self.reading = np.abs(self.sees).T
        self.factor, self.factored, self.answer, self.reached = None, None, None, {}

    def stiffness(self, slides: np.ndarray):
        """k(S) of the kept coordinates."""
        if not slides.any():
            return self.stuck
        return sparse.csc_array(self.stuck - self.pull[:, slides] @ self.sees[:, slides].T)

    def factorise(self, slides: np.ndarray) -> None:
        """Factorise k(S)."""
        self.factored, self.factor = None, None
        self.factor = factorised(self.stiffness(slides), method="superlu", ordered=True)
        self.answer, self.reached = self.factor(self.right), {}
        self.factored = slides.copy()
        self.solves += 1

    def solve_columns(self, columns: np.ndarray) -> np.ndarray:
        """(kept, m) answers of the last factor to columns."""
        out = np.empty_like(columns)
        for k in range(0, columns.shape[1], AT_ONCE):
            out[:, k : k + AT_ONCE] = self.factor(np.asfortranarray(columns[:, k : k + AT_ONCE]))
        return out

    def rates(self, slides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocities (n,) of a status, and Ṽ of the critical contacts.

        Raises
        ------
        LinAlgError
            if k(S) v misses the load: k(S) is singular to round-off.
        """
        v = self._woodbury(slides)
        if v is None:
            if self.factored is None or not np.array_equal(slides, self.factored):
                self.factorise(slides)
            v = self.answer
            if not self._is_balanced(slides, v):
                raise LinAlgError("singular")
        return self._expand(v), self.sees.T @ v

    def rates_for_slip(self, slides: np.ndarray, slip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocities (n,) and Ṽ for given slip rates of a status, whose k(S) may be singular.

        Raises
        ------
        LinAlgError
            if k(S) v misses the load.
        """
        stuck = np.zeros(len(slides), bool)
        if self.factored is None or not np.array_equal(self.factored, stuck):
            self.factorise(stuck)
        v = self.answer + self.factor(self.pull @ slip)
        if not self._is_balanced(slides, v):
            raise LinAlgError("singular")
        return self._expand(v), self.sees.T @ v

    def round_off(self, velocity: np.ndarray) -> np.ndarray:
        """(Mc,) round-off of Ṽ, the difference of what bodies that touch do: a share of what each does."""
        return ROUND_OFF * (self.reading @ np.abs(velocity[self.kept]))

    def _expand(self, v: np.ndarray) -> np.ndarray:
        full = np.zeros(len(self.load))
        full[self.kept] = v
        return full

    def _woodbury(self, slides: np.ndarray) -> np.ndarray | None:
        """v from the factor of a status that differs in few contacts (Woodbury), or None where that is no use."""
        if self.factored is None:
            return None
        flipped = np.flatnonzero(slides != self.factored)
        if not 0 < len(flipped) <= FEW:
            return None
        new = [k for k in flipped if k not in self.reached]  # others were flipped in an earlier round, too
        self.reached.update(zip(new, self.solve_columns(self.pull[:, new].toarray(order="F")).T, strict=True))
        turn, sees = np.where(slides[flipped], -1.0, 1.0), self.sees[:, flipped]
        reach = np.stack([self.reached[k] for k in flipped], axis=1) * turn
        try:
            v = self.answer - reach @ np.linalg.solve(np.eye(len(flipped)) + sees.T @ reach, sees.T @ self.answer)
        except np.linalg.LinAlgError:
            return None
        return v if self._is_balanced(slides, v) else None

    def _is_balanced(self, slides: np.ndarray, v: np.ndarray) -> bool:
        """Whether k(S) v is the load; not for NaN."""
        slip = np.where(slides, self.sees.T @ v, 0.0)
        missed = self.stuck @ v - self.pull @ slip - self.right
        return bool(np.abs(missed).max(initial=0.0) <= RESIDUAL * np.abs(self.right).max(initial=0.0))


def pins(matrix: LinearSystem) -> np.ndarray:
    """Coordinates that may be held still without changing any contact: one for each free translation of the whole."""
    held = []
    for axis in range(2):
        whole = np.flatnonzero(matrix.free.axis == axis)
        move = np.zeros(len(matrix.free))
        move[whole] = 1.0
        if len(whole) and np.abs(matrix.c.T @ move).max(initial=0.0) < 1e-12:
            held.append(whole[0])
    return np.array(held, np.int64)


def unbalanced_axes(matrix: LinearSystem, load: np.ndarray) -> str:
    """Along which axes, "x", "y" or both, a load has a net force that nothing holds; empty if there is none."""
    out = ""
    for pin in pins(matrix):
        along = load[matrix.free.axis == matrix.free.axis[pin]]
        if abs(along.sum()) > RESIDUAL * np.abs(load).sum():
            out += "xy"[matrix.free.axis[pin]]
    return out


def elimination_order(c, body: np.ndarray) -> np.ndarray:
    """(n,) order of coordinates in which k has little fill: minimum degree on the graph of bodies in contact.

    Parameters
    ----------
    c : (n, 2M) sparse, as in `LinearSystem`
    body : (n,) to which body each coordinate belongs

    Notes
    -----
    SuperLU orders what it factorises; a graph of bodies is a ninth of that of coordinates, and orders as well.
    """
    _, lead, node = np.unique(body, return_index=True, return_inverse=True)
    if len(lead) < 2:
        return np.arange(len(body))
    # the first coordinate of a body takes part in all its contacts
    part = sparse.csr_array(c[lead])
    row = np.repeat(np.arange(len(lead)), np.diff(part.indptr))
    shape = (len(lead), c.shape[1] // 2)
    touch = sparse.csr_array((np.ones(len(row)), (row, part.indices // 2)), shape=shape)
    graph = sparse.csc_array(touch @ touch.T)
    graph.data[:] = -1.0
    graph.setdiag(1.0 + np.diff(graph.indptr))  # larger than the rest of its column: nothing is pivoted
    rank = splu(graph, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).perm_c
    return np.argsort(rank[node], kind="stable")
