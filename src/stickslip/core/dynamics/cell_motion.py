"""Motion of the deforming cell, and rates with a time profile.

The cell deforms at a velocity gradient L and carries the grains along, ẋ = v + L x, v̇ = F/m − L v. For simple shear
this is Newton's law with Lees–Edwards boundary conditions, written for velocities relative to the flow. Over a step,
with A = (1 − ½ dt L)⁻¹ (1 + ½ dt L), every vector h of the cell becomes A h, and a position becomes
A (x + ½ dt v) + ½ dt v, so that pair vectors do not depend on the origin. The term −L v is applied in two halves,
before and after the drift. Where the cell is free, M ℓ² L̇ = V (σ − wanted).

Sources: the equations of motion are those of Evans and Morriss, doi:10.1103/PhysRevA.30.1528; the inertia of the cell
is that of Parrinello and Rahman, doi:10.1063/1.328693, with one mass.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from ..arguments import Numbers, checked
from ..control import factors_at
from ..flow import INVERSE_HALF, PULL, RATE, RATE_AHEAD, SINCE, STRETCH, TURN, VECTORS, Flow
from ..options import INNER
from ..simd.transpose import VELOCITY
from ..state import State, as_numbers, deforms

MIN_VOLUME_RATIO = 1e-6  # smallest volume of a cell after one strain, over its previous volume


class Frame(NamedTuple):
    """Frame of reference that moves with the cell, and the time profiles of rates, during a run. Arrays are written in
    place."""

    free: np.ndarray  # (3, 3) bool
    given: np.ndarray  # (3, 3) rates of components that are not free
    follows: np.ndarray  # (3, 3) course, or the last column: constant
    wanted: np.ndarray  # (3, 3) stress
    mass: float
    knots: np.ndarray  # (K,)
    course: np.ndarray  # (K, C)
    area: np.ndarray  # (K, C) integral of `course` from the first knot
    place: np.ndarray  # (N,) position of each grain in memory
    grain_mass: np.ndarray  # (N,)
    made: np.ndarray  # (3, 3) vectors of the cell for which the list of contacts was built
    clock: np.ndarray  # (1,) time, accumulated step by step, so that a continued run has bitwise identical courses
    reach: np.ndarray  # (1,) distance within which pairs were selected
    widest: float  # largest sum of two radii

    @property
    def courses(self) -> int:
        """Number of time profiles."""
        return self.course.shape[1]


@checked
def strained(state: State, gradient: Numbers, *, slip: bool = True) -> State:
    """State after an affine displacement x → x + G x of grains and cell; not in equilibrium.

    The cell is always spanned by its vectors, so that simple shear makes it triclinic (Lees–Edwards conditions).

    Parameters
    ----------
    gradient : (3, 3) or (dim, dim) displacement gradient G; G[0, 1] = δγ is simple shear along x with gradient y
    slip : whether the affine displacement of i relative to j enters the slip of their contact. True (default): grains
        move with the flow and do not rotate, and contacts slip accordingly. False: the memory is unaffected, as in
        codes that remap the box.

    Raises
    ------
    ValueError
        if G has another shape or leaves the plane, or if the state has walls (they would have to bend).
    """
    dim = state.cell.dim
    gradient = as_numbers(gradient)
    if not np.isfinite(gradient).all():
        raise ValueError("a gradient with NaN or infinity was given: every entry must be a finite number")
    if gradient.shape not in ((3, 3), (dim, dim)):
        raise ValueError(f"a gradient of shape {gradient.shape} was given: (3, 3) or {(dim, dim)} is needed")
    g = np.zeros((3, 3))
    g[: len(gradient), : len(gradient)] = gradient
    if dim == 2 and (g[2].any() or g[:, 2].any()):
        raise ValueError("a gradient with z components was given in two dimensions: they must be zero")
    if len(state.walls.mass):
        raise ValueError("a state with walls was given: only periodic cells can be strained")
    vectors = state.cell.vectors + state.cell.vectors @ g.T
    if not np.linalg.det(vectors) > MIN_VOLUME_RATIO * abs(np.linalg.det(state.cell.vectors)):
        raise ValueError("a gradient that collapses or inverts the cell was given: use a smaller one")
    contacts = state.contacts._replace(stale=True)
    if not slip:
        contacts = contacts._replace(pair=contacts.pair + contacts.pair @ g.T)
    grains = state.grains
    return state._replace(
        grains=grains._replace(position=grains.position + grains.position @ g.T),
        cell=state.cell._replace(vectors=vectors),
        contacts=contacts,
    )


def needs_frame(state: State) -> bool:
    """Return True if a run needs a frame."""
    control = state.control
    return deforms(state) or bool((control.follows >= 0).any())


def cell_mass(state: State) -> float:
    """Cell mass M [mass]."""
    return float(state.control.cell_mass or state.grains.mass.sum())


def make_frame(state: State, order: np.ndarray) -> tuple[Frame, Flow]:
    """Make the frame and flow at the start of a run; `order` is that of the bodies in memory."""
    control, cell, n = state.control, state.cell, len(state.grains.radius)
    columns, place = control.course.shape[1], np.empty(state.n_bodies, np.int64)
    place[order] = np.arange(len(order))
    factor = factors_at(control, state.time)
    rate = np.where(control.cell_free, cell.rate, control.cell_rate * factor[control.cell_follows])
    spans = np.diff(control.knots)[:, None] * 0.5 * (control.course[1:] + control.course[:-1])
    area = np.concatenate([np.zeros((min(1, len(control.knots)), columns)), np.cumsum(spans, axis=0)])
    used = np.where(cell.vectors.any(axis=1)[:, None], cell.vectors, np.eye(3))
    one = np.eye(3)
    flow = Flow(
        np.stack([used, rate, rate, one, one, one, one, 0 * one]), np.stack([factor, factor]), control.rate[order],
        control.follows[order].astype(int) % (columns + 1),
    )  # fmt: skip
    frame = Frame(
        *map(np.ascontiguousarray, (
            control.cell_free, control.cell_rate, control.cell_follows % (columns + 1), control.stress,
        )),
        cell_mass(state),
        *map(np.ascontiguousarray, (control.knots, control.course, area, place[:n], state.grains.mass)),
        used.copy(), np.full(1, state.time), np.zeros(1),
        2.0 * float(state.grains.radius.max()) + state.contacts.gap,
    )  # fmt: skip
    return frame, flow


@njit(cache=True, fastmath=False, error_model="numpy", **INNER)
def course_at(knots, course, c, time):
    """Last knot before a time, −1 if there is none, and the value of a time profile at that time."""
    last = len(knots) - 1
    if time <= knots[0]:
        return -1, course[0, c]
    if time >= knots[last]:
        return last, course[last, c]
    k = np.searchsorted(knots, time, side="right") - 1
    part = (time - knots[k]) / (knots[k + 1] - knots[k])
    return k, course[k, c] + part * (course[k + 1, c] - course[k, c])


@njit(cache=True, fastmath=False, error_model="numpy", **INNER)
def _course_and_integral(frame, c, time):
    """Value of a time profile at a time, and its integral from the first knot."""
    knots, course = frame.knots, frame.course
    k, value = course_at(knots, course, c, time)
    if k < 0:
        return value, (time - knots[0]) * value
    return value, frame.area[k, c] + 0.5 * (time - knots[k]) * (course[k, c] + value)


# scalars and loops here and below, because every array expression costs seconds of compile time


@njit(cache=True, fastmath=False, error_model="numpy")
def _invert(m, out):
    """Invert a 3 × 3 matrix into `out`."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        for k in range(3):
            q, r = (k + 1) % 3, (k + 2) % 3
            out[k, a] = m[b, q] * m[c, r] - m[b, r] * m[c, q]
    determinant = m[0, 0] * out[0, 0] + m[0, 1] * out[1, 0] + m[0, 2] * out[2, 0]
    for a in range(3):
        for k in range(3):
            out[k, a] /= determinant


@njit(cache=True, fastmath=False, error_model="numpy", **INNER)
def _multiply(a, b, out):
    """Multiply two 3 × 3 matrices into `out`, always in the same order of operations."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(cache=True, fastmath=False, error_model="numpy", **INNER)
def _one_plus(factor, m, out):
    """Write 1 + factor m to `out`."""
    for a in range(3):
        for b in range(3):
            out[a, b] = (1.0 if a == b else 0.0) + factor * m[a, b]


@njit(cache=True, fastmath=False, error_model="numpy")
def begin_cell_step(frame, flow, pace):
    """Begin a step: rates, matrices and the cell at its end.

    Returns the square of the allowed displacement, or −1 if there is none left.
    """
    dt, half, time = pace.dt, 0.5 * pace.dt, frame.clock[0]
    frame.clock[0] = time + dt
    for c in range(frame.course.shape[1]):
        _, before = _course_and_integral(frame, c, time)
        flow.factor[1, c], after = _course_and_integral(frame, c, frame.clock[0])
        flow.factor[0, c] = (after - before) / dt
    matrix = flow.matrix
    rate, ahead, pull = matrix[RATE], matrix[RATE_AHEAD], matrix[PULL]
    for a in range(3):
        for b in range(3):
            if frame.free[a, b]:
                rate[a, b] = pace.keep * rate[a, b] + half * pull[a, b]
                ahead[a, b] = pace.slow * (rate[a, b] + half * pull[a, b])
            else:
                rate[a, b] = frame.given[a, b] * flow.factor[0, frame.follows[a, b]]
                ahead[a, b] = frame.given[a, b] * flow.factor[1, frame.follows[a, b]]
    work = np.empty((2, 3, 3))
    one, other = work[0], work[1]
    _one_plus(-half, rate, one)
    _invert(one, other)
    _one_plus(half, rate, one)
    _multiply(other, one, matrix[STRETCH])
    _invert(one, matrix[INVERSE_HALF])
    _one_plus(0.5 * half, rate, one)
    _invert(one, other)
    _one_plus(-0.5 * half, rate, one)
    _multiply(other, one, matrix[TURN])
    stretch, since, vectors = matrix[STRETCH], matrix[SINCE], matrix[VECTORS]
    _multiply(stretch, since, one)
    square = 0.0
    for a in range(3):
        for b in range(3):
            since[a, b] = one[a, b]
            square += (one[a, b] - (1.0 if a == b else 0.0)) ** 2
            other[a, b] = vectors[a, 0] * stretch[b, 0] + vectors[a, 1] * stretch[b, 1] + vectors[a, 2] * stretch[b, 2]
    for a in range(3):
        for b in range(3):
            vectors[a, b] = other[a, b]
    # a pair further apart than s + reach stays apart while the deformation uses no more than the remaining reach
    strain = np.sqrt(square)
    left = frame.reach[0] - strain * (frame.widest + frame.reach[0])
    # −1 triggers a new choice of blocks even if all grains are at rest in the flow
    return (0.5 * left) ** 2 if left > 0.0 else -1.0


@njit(cache=True, fastmath=False, error_model="numpy", **INNER)
def _volume(dim, h):
    """Volume of a cell, or its area in two dimensions."""
    space = h[0, 0] * h[1, 1] - h[0, 1] * h[1, 0]
    if dim == 3:
        space = space * h[2, 2] + h[0, 2] * (h[1, 0] * h[2, 1] - h[1, 1] * h[2, 0])
        space += h[1, 2] * (h[0, 1] * h[2, 0] - h[0, 0] * h[2, 1])
    return abs(space)


@njit(cache=True, fastmath=False, error_model="numpy", **INNER)
def end_cell_step(dim, frame, flow, pace, moving, fresh):
    """End a step: sum the stress in order of grain number, and accelerate the cell."""
    total = np.zeros((3, 3))
    for a in range(len(frame.place)):
        g = frame.place[a]
        for k in range(3):
            for m in range(3):
                flux = frame.grain_mass[a] * moving.body[g, VELOCITY + k] * moving.body[g, VELOCITY + m]
                total[k, m] += moving.virial[g, 3 * k + m] + flux
    rate, pull, space = flow.matrix[RATE], flow.matrix[PULL], _volume(dim, flow.matrix[VECTORS])
    inertia = frame.mass * (space if dim == 2 else space ** (2.0 / 3.0))
    for a in range(3):
        for b in range(3):
            if frame.free[a, b]:
                pull[a, b] = (total[a, b] - space * frame.wanted[a, b]) / inertia
                if not fresh:
                    rate[a, b] = (rate[a, b] + 0.5 * pace.dt * pull[a, b]) * pace.slow
            elif not fresh:
                rate[a, b] = frame.given[a, b] * flow.factor[1, frame.follows[a, b]]


@njit(cache=True, fastmath=False, error_model="numpy", **INNER)
def unbalanced_cell(dim, frame, flow, drag):
    """Largest force or drag force on a free component of the cell, divided by ℓ [force]; NaN if one is NaN."""
    pull, rate, most = flow.matrix[PULL], flow.matrix[RATE], 0.0
    for a in range(3):
        for b in range(3):
            if frame.free[a, b]:
                size = max(abs(pull[a, b]), drag * abs(rate[a, b])) + 0.0 * pull[a, b] * rate[a, b]
                most = size if not size <= most else most
    return frame.mass * _volume(dim, flow.matrix[VECTORS]) ** (1.0 / dim) * most


def remaining_skin(vectors, made_at, skin: float, widest: float) -> tuple[float, np.ndarray]:
    """Skin that remains after the deformation F of the cell since a list was built, and F itself."""
    deformation = np.linalg.solve(made_at, vectors).T
    strain = float(np.sqrt(((deformation - np.eye(3)) ** 2).sum()))
    return skin - strain * (widest + skin), deformation
