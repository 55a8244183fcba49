"""Classification of the null modes of the stiffness matrix, motions that the quasi-static balance leaves undetermined.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. III E.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space, qr, svd

from ... import Law, State
from ...kit import Numbers, checked, readable
from ...measure import rattlers
from .matrices import LinearSystem, linear_system, stiffness_matrix
from .walls import resists_turning, rigid_rotation

ZERO = 1e-10  # share of the largest singular value below which one is zero
ALIKE = 0.9  # share of the rigid rotation in the null modes above which it is counted as one of them
DENSE_UP_TO = 6000  # coordinates up to which singular values are computed
RIGID, RATTLER, IDLE, DRIVEN = (
    "a rigid motion of the apparatus",
    "a rattler, which supports nothing",
    "a mechanism that the load does not excite",
    "a mechanism that the load drives: the packing collapses",
)


@readable
class Mechanism(NamedTuple):
    """Null mode of k, a motion that nothing resists."""

    kind: str  # RIGID, RATTLER, IDLE or DRIVEN
    vector: np.ndarray  # (n,) of unit length, in the coordinates of `linear_system(state, law, rattlers=True)`
    power: float  # |load · left null vector| over |load|; the balance has a solution if it is zero
    deforms: bool  # whether some contact moves, which then slides; otherwise no contact is affected
    quotient: float = 0.0  # vᵀkv, zero except for the rigid rotation, which slips by the overlaps [force/length]

    def __str__(self):
        return self.kind


@checked
def mechanisms(
    state: State,
    law: Law,
    load: np.ndarray | None = None,
    sliding: Numbers | None = None,
    *,
    wall_arm: float | None = None,
) -> list[Mechanism]:
    """Find all null modes of k, each in one of the classes of Sec. III E.

    Parameters
    ----------
    load : (n,) rate of the external load on all free coordinates, including those of rattlers [force/time]; default:
        none
    sliding : (M,) bool, statuses of the contacts of `linear_system(state, law, rattlers=True)`; default: those at
        the limit
    wall_arm : if given, walls may also rotate, as in `linear_system`; then the rotation of the whole packing about one
        point is also RIGID if only the overlaps resist it, and has a correspondingly small `quotient`

    Returns
    -------
    list of Mechanism
        rigid motions, then rattlers, then mechanisms that the load does not excite, then those that it drives

    Raises
    ------
    ValueError
        beyond 6000 coordinates, where singular values take too long to compute.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, law = ss.packings.biaxial_box(30, pressure=1e-3, seed=1)
    >>> found = ss.quasirigid.mechanisms(state, law)
    >>> sum(one.deforms for one in found)
    0
    """
    matrix = linear_system(state, law, rattlers=True, wall_arm=wall_arm)
    size = len(matrix.free)
    if size > DENSE_UP_TO:
        raise ValueError(f"{size} coordinates were given: null modes are computed for at most {DENSE_UP_TO}")
    load = np.zeros(size) if load is None else np.asarray(load, float)
    if load.shape != (size,):
        raise ValueError(
            f"a load of shape {load.shape} was given: shape {(size,)} is needed, one component for each coordinate"
        )
    if not np.isfinite(load).all():
        raise ValueError("a load that is not finite was given: every component must be a finite number")
    k = stiffness_matrix(matrix, sliding, geometric=False).toarray()
    rigid = _rigid_motions(matrix)
    turn = np.zeros((size, 0)) if wall_arm is None else _rigid_rotation(state, matrix, wall_arm)
    loose = rattlers(state, 2)
    own = np.flatnonzero(np.append(loose, np.zeros(state.n_bodies - len(loose) + 1, bool))[matrix.free.body])
    out = [Mechanism(RIGID, v, _load_share(load, v), False) for v in rigid.T]
    out += [Mechanism(RIGID, v, _load_share(load, v), True, float(v @ k @ v)) for v in turn.T]
    out += [Mechanism(RATTLER, np.eye(size)[c], _load_share(load, np.eye(size)[c]), False) for c in own]
    rest = np.setdiff1d(np.arange(size), own)
    return out + _find_mechanisms(matrix, k, rest, rigid[rest], turn[rest], load)


def _load_share(load: np.ndarray, vector: np.ndarray) -> float:
    size = np.linalg.norm(load)
    return float(abs(load @ vector) / size) if size else 0.0


def _rigid_motions(matrix: LinearSystem) -> np.ndarray:
    """(n, r) orthonormal translations of the whole packing that no contact and no fixed body resists."""
    moves = []
    for axis in range(matrix.free.dim):
        move = (matrix.free.axis == axis).astype(float)
        if move.any() and np.abs(matrix.c.T @ move).max(initial=0.0) < 1e-12:
            moves.append(move / np.linalg.norm(move))
    return np.stack(moves, axis=1) if moves else np.zeros((len(matrix.free), 0))


def _rigid_rotation(state: State, matrix: LinearSystem, arm: float) -> np.ndarray:
    """(n, 1) unit vector of the rotation of the whole packing, or (n, 0) if anything but the overlaps resists it."""
    move = rigid_rotation(state, matrix.free, arm)
    if resists_turning(state, matrix.rows, (matrix.c.T @ move).reshape(-1, 2)):
        return np.zeros((len(move), 0))
    return (move / np.linalg.norm(move))[:, None]


def _find_mechanisms(matrix: LinearSystem, k, rest, rigid, turn, load) -> list[Mechanism]:
    """Null modes of the coordinates `rest` without rigid motions, idle ones first, then those driven by the load."""
    if not len(rest):
        return []
    part = k[np.ix_(rest, rest)]
    left, values, right = svd(part)
    zero = values < ZERO * values.max(initial=0.0)
    null, co = right[zero].T, left[:, zero]
    if rigid.shape[1]:
        base = qr(rigid, mode="economic")[0]
        null, co = _complement(null, base), _complement(co, base)
    if turn.shape[1]:  # with very small overlaps k has it as a null mode, which must not be counted again
        null, co = _without_rotation(null, turn, rigid), _without_rotation(co, turn, rigid)
    if not null.shape[1]:
        return []
    # one direction of the left null space takes all of the load; the corresponding motion is the driven one
    taken = co.T @ load[rest]
    size = np.linalg.norm(load)
    power = float(np.linalg.norm(taken) / size) if size else 0.0
    driven = []
    if power > 1e-9:
        answer = null @ _driven_amplitudes(null, load[rest])
        driven = [_make_mechanism(DRIVEN, matrix, rest, answer, power)]
        null = _complement(null, (answer / np.linalg.norm(answer))[:, None])
    return [_make_mechanism(IDLE, matrix, rest, v, 0.0) for v in null.T] + driven


def _driven_amplitudes(null: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Amplitudes of null modes driven by a load; the first mode if the load is orthogonal to all of them."""
    along = null.T @ load
    return along if np.linalg.norm(along) > 1e-12 * np.linalg.norm(load) else np.eye(null.shape[1])[0]


def _complement(vectors: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the part of the span of `vectors` that is orthogonal to `base`."""
    inside = null_space(base.T @ vectors, rcond=1e-8) if vectors.shape[1] else np.zeros((0, 0))
    return vectors @ inside


def _without_rotation(vectors: np.ndarray, turn: np.ndarray, rigid: np.ndarray) -> np.ndarray:
    """Null vectors without the rigid rotation, if it is among them."""
    base = qr(rigid, mode="economic")[0]
    turn = turn - base @ (base.T @ turn)
    inside = vectors @ (vectors.T @ turn) / np.linalg.norm(turn)
    return _complement(vectors, inside) if np.linalg.norm(inside) > ALIKE else vectors


def _make_mechanism(kind: str, matrix: LinearSystem, rest, vector, power: float) -> Mechanism:
    full = np.zeros(len(matrix.free))
    full[rest] = vector / np.linalg.norm(vector)
    return Mechanism(kind, full, power, bool(np.abs(matrix.c.T @ full).max(initial=0.0) > 1e-8))
