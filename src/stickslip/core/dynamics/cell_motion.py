"""Motion of the deforming cell, and rates with a time profile.

The cell deforms with a velocity gradient L and carries the grains along, ẋ = v + L x, v̇ = F/m − L v. For simple shear,
this is Newton's law with Lees–Edwards boundary conditions, written for velocities relative to the flow. Over a step,
with A = (1 − ½ dt L)⁻¹ (1 + ½ dt L), every vector h of the cell becomes A h, and a position becomes
A (x + ½ dt v) + ½ dt v, so that pair vectors do not depend on the origin. The term −L v is applied in two halves,
before and after the drift. Where the cell is free, M ℓ² L̇ = V (σ − wanted).

Sources: the equations of motion are those of Evans and Morriss, doi:10.1103/PhysRevA.30.1528; the inertia of the cell
is that of Parrinello and Rahman, doi:10.1063/1.328693, with one mass.
"""

from typing import NamedTuple

import numpy as np

from ..arguments import Numbers, checked, knows_bonds
from ..control import factors_at
from ..state import State, as_numbers, deforms

MIN_VOLUME_RATIO = 1e-6  # smallest allowed ratio of the volume of a cell after one strain to its previous volume


class Flow(NamedTuple):
    """Cell deformation and time profiles of a step, updated in place."""

    # (8, 3, 3), rows as in `core.h`: the cell's vectors at the positions; L; L predicted at the end of the step, for
    # dashpots; A; effect of half a step of L on a velocity; (1 + ½ dt L)⁻¹; deformation since blocks were chosen; L̇ of
    # free components
    matrix: np.ndarray
    factor: (
        np.ndarray
    )  # (2, C + 1) time profiles: mean over the step, value at its end; the last is 1, for rates without a profile
    rate: np.ndarray  # (B, 6) rates of bodies, in memory order
    follows: np.ndarray  # (B, 6)

    @property
    def courses(self) -> int:
        """Number of time profiles."""
        return self.factor.shape[1] - 1


class Frame(NamedTuple):
    """Frame of reference that moves with the cell, and time profiles of rates; its arrays are updated in place."""

    free: np.ndarray  # (3, 3) bool
    given: np.ndarray  # (3, 3) rates of components that are not free
    follows: np.ndarray  # (3, 3) column of the time profile; the last stands for a constant
    wanted: np.ndarray  # (3, 3) stress
    mass: float
    knots: np.ndarray  # (K,)
    course: np.ndarray  # (K, C)
    area: np.ndarray  # (K, C) integral of `course` from the first knot
    place: np.ndarray  # (N,) position of each grain in memory
    grain_mass: np.ndarray  # (N,)
    made: np.ndarray  # (3, 3) vectors of the cell for which the list of contacts was built
    clock: np.ndarray  # (1,) time, accumulated step by step, so a continued run has bitwise identical profiles
    reach: np.ndarray  # (1,) distance within which pairs were selected
    widest: float  # largest sum of two radii

    @property
    def courses(self) -> int:
        """Number of time profiles."""
        return self.course.shape[1]


@checked
@knows_bonds
def strained(state: State, gradient: Numbers, *, slip: bool = True) -> State:
    """State after an affine displacement x → x + G x of grains and cell, in general not in equilibrium.

    The cell is always spanned by its vectors, so simple shear makes it triclinic (Lees–Edwards conditions).

    Parameters
    ----------
    gradient : (3, 3) or (dim, dim) displacement gradient G; G[0, 1] = δγ is simple shear along x with gradient y
    slip : whether the affine displacement of i relative to j enters the slip of their contact. True (default): grains
        move with the flow and do not rotate, and contacts slip accordingly. False: the memory is unaffected, as in
        codes that remap the box.

    Raises
    ------
    ValueError
        If G has a wrong shape or leaves the plane, or if the state has walls (they would have to bend).
    """
    dim = state.cell.dim
    gradient = as_numbers(gradient)
    if not np.isfinite(gradient).all():
        raise ValueError("the gradient contains NaN or infinity: every entry must be finite")
    if gradient.shape not in ((3, 3), (dim, dim)):
        raise ValueError(f"the gradient must have shape (3, 3) or {(dim, dim)}, got {gradient.shape}")
    g = np.zeros((3, 3))
    g[: len(gradient), : len(gradient)] = gradient
    if dim == 2 and (g[2].any() or g[:, 2].any()):
        raise ValueError("z components of the gradient must be zero in two dimensions")
    if len(state.walls.mass):
        raise ValueError("the state has walls: only periodic cells can be strained")
    vectors = state.cell.vectors + state.cell.vectors @ g.T
    if not np.linalg.det(vectors) > MIN_VOLUME_RATIO * abs(np.linalg.det(state.cell.vectors)):
        raise ValueError("the gradient collapses or inverts the cell: use a smaller one")
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
    """Return True if a run needs a `Frame`: the cell deforms, or a rate has a time profile."""
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
    eye = np.eye(3)
    flow = Flow(
        np.stack([used, rate, rate, eye, eye, eye, eye, 0 * eye]), np.stack([factor, factor]), control.rate[order],
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


def remaining_skin(vectors, made_at, skin: float, widest: float) -> tuple[float, np.ndarray]:
    """Skin that remains after the deformation F of the cell since a list was built, and F itself."""
    deformation = np.linalg.solve(made_at, vectors).T
    strain = float(np.sqrt(((deformation - np.eye(3)) ** 2).sum()))
    return skin - strain * (widest + skin), deformation
