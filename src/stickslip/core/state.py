"""Data types: grains, walls, cell, contacts, control, and the state that holds them. All are plain values.

Two-dimensional systems are three-dimensional ones restricted to a plane: every vector has three components, of which
only the first `cell.dim` vary. A *body* is a grain or a wall: bodies 0…N−1 are the grains, N…N+W−1 the walls.
"""

from typing import NamedTuple

import numpy as np

from .arguments import Numbers, Series, checked, knows_bonds, require_shape
from .fields import COURSE_DTYPE, FIELDS, LARGEST, check_parts
from .progress import Size, require_sizes
from .readable import pluralize, readable

OPEN, STICK, SLIDE = 0, 1, 2  # mode of a contact
FAILURES = "", "tension", "shear", "bending", "twisting", "compression"  # loads that break a bond
MAX_IN_CUBE = 100  # largest number of centres in a cube whose edge is the smallest radius; without overlaps, one


@readable(head=lambda value: _describe_grains(value))
class Grains(NamedTuple):
    """Disks or spheres, one row each."""

    position: np.ndarray  # (N, 3) [length], unwrapped
    angle: np.ndarray  # (N, 3) [rad], time integral of spin
    velocity: np.ndarray  # (N, 3) [length/time]
    spin: np.ndarray  # (N, 3) [rad/time]
    radius: np.ndarray  # (N,) [length]
    mass: np.ndarray  # (N,) [mass]
    inertia: np.ndarray  # (N,) [mass length²]
    material: np.ndarray  # (N,) row of the law's table

    def check_entries(self) -> None:
        """Raise ValueError if an entry is not allowed (see `fields`)."""
        check_parts({"grains": self})


@readable(head=lambda walls: pluralize(len(walls.mass), "flat wall"))
class Walls(NamedTuple):
    """Flat walls that may translate; grains are on the side to which the normal points."""

    point: np.ndarray  # (W, 3) [length]
    normal: np.ndarray  # (W, 3) unit vectors
    velocity: np.ndarray  # (W, 3) [length/time]
    mass: np.ndarray  # (W,) [mass]
    material: np.ndarray  # (W,)

    def check_entries(self) -> None:
        """Raise ValueError if an entry is not allowed (see `fields`)."""
        check_parts({"walls": self})


@readable(head=lambda value: _describe_cell(value))
class Cell(NamedTuple):
    """Simulation cell: vectors as rows, their periodicity, the number of dimensions, and the deformation rate.

    Grains are carried along: ẋ = v + L x. The velocities v of grains in a deforming cell are relative to this flow.
    """

    vectors: np.ndarray  # (3, 3) [length]
    periodic: np.ndarray  # (3,) bool
    dim: int
    rate: np.ndarray  # (3, 3) velocity gradient L_ab = ∂v_a/∂x_b; each vector h changes as L h [1/time]

    def check_entries(self) -> None:
        """Raise ValueError if an entry is not allowed (see `fields`)."""
        check_parts({"cell": self})


@readable(head=lambda value: _describe_contacts(value), rows=lambda value: _contact_rows(value))
class Contacts(NamedTuple):
    """Neighbour list: pairs within range, sorted by key, each with its memory. The first `count[0]` rows are valid.

    The list holds all pairs closer than a skin, so that it stays valid for many steps. `mode` marks pairs that touch.
    r_ij = r_i − r_j + cellᵀ·image. `pair` and `roll` contain r_ij and R_i angle_i + R_j angle_j at the last commit of
    `slip`. `origin` holds the positions of the bodies when the list was built. The list is rebuilt before its next use
    if a body has moved by half the skin since then, or if it is `stale`.
    """

    i: np.ndarray  # (C,) int32
    j: np.ndarray  # (C,) int32
    image: np.ndarray  # (C, 3) int16
    key: np.ndarray  # (C,) packed (i, j, image)
    slip: np.ndarray  # (C, 3) [length], perpendicular to the normal
    mode: np.ndarray  # (C,) int8: OPEN, STICK or SLIDE
    pair: np.ndarray  # (C, 3) [length]
    roll: np.ndarray  # (C, 3) [length]
    reached: np.ndarray  # (C,) bool: whether the contact has been at the Coulomb limit since it closed
    origin: np.ndarray  # (N + W, 3) [length]
    skin: float  # [length]
    gap: float  # largest gap across which pairs are listed even without the skin, as some laws require [length]
    stale: bool  # whether the list is invalid at the present positions, for example after a deformation of the cell
    count: np.ndarray  # (1,)
    rolling: np.ndarray | None = (
        None  # (C, columns) memory of rotations (7) and additional memory of the law; None if there is neither
    )

    def check_entries(self) -> None:
        """Raise ValueError if an entry is not allowed (see `fields`)."""
        check_parts({"contacts": self})


# fields of `Contacts` with one row for each pair
PER_PAIR = tuple(name for name, field in FIELDS["contacts"].items() if field.shape and field.shape[0] == "rows")


@readable(head=lambda value: _describe_control(value))
class Control(NamedTuple):
    """Imposed loads and motions. A component that is not free moves at its `rate`: it is frozen if this is zero.

    Bodies of a group move as one and do not rotate; their forces and masses add up. A free component of the cell's
    velocity gradient obeys M ℓ² L̇ = V (σ − `stress`), ℓ = V^(1/dim). A rate may have a time profile, its `course`: it
    is then multiplied by a function of time that is linear between `knots` and constant beyond them. A spring pulls a
    body towards its load point, which is at `anchor` plus the value of its time profile.
    """

    force: np.ndarray  # (N + W, 3) [force]
    torque: np.ndarray  # (N + W, 3) [force length]
    free: np.ndarray  # (N + W, 6) bool: x, y, z, then rotation about x, y, z
    rate: np.ndarray  # (N + W, 6) [length/time], [rad/time]
    gravity: np.ndarray  # (3,) [length/time²]
    group: np.ndarray  # (N + W,) number of the rigid group of each body, −1 for none
    cell_free: np.ndarray  # (3, 3) bool: components of the cell's velocity gradient that follow the stress
    cell_rate: np.ndarray  # (3, 3) rates of components that do not follow the stress [1/time]
    stress: np.ndarray  # (3, 3) target where the cell is free, compression positive [force/length^(dim−1)]
    cell_mass: float  # M, inertia of the cell [mass]; 0: the mass of all grains
    knots: np.ndarray  # (K,) [time], increasing
    course: np.ndarray  # (K, C) factors of rates, or displacements of load points, one column per course
    follows: np.ndarray  # (N + W, 6) column of `course` that a rate follows, −1: none
    cell_follows: np.ndarray  # (3, 3) column of `course` that a component of `cell_rate` follows, −1: none
    spring: np.ndarray  # (N + W, 3) stiffness along x, y, z, zero if there is none [force/length]
    anchor: np.ndarray  # (N + W, 3) position of load points at zero displacement [length]
    leads: np.ndarray  # (N + W, 3) column of `course` that is added to `anchor` [length], −1: none

    def check_entries(self) -> None:
        """Raise ValueError if an entry is not allowed (see `fields`)."""
        check_parts({"control": self})


@readable(head=lambda value: _describe_bonds(value))
class Bonds(NamedTuple):
    """Bonds between grains, one row each, from `packings.bonded`. Four columns: tension, shear, bending, twisting.

    A bond acts in addition to the contact law, even across a gap. Its forces follow from the present positions and
    orientations of its two grains and from their rest configuration, stored in its memory. See
    `core/contacts/bonds.py`.
    """

    i: np.ndarray  # (K,) int32, less than j
    j: np.ndarray  # (K,) int32
    image: np.ndarray  # (K, 3) int16
    intact: np.ndarray  # (K,) bool: not broken
    length: np.ndarray  # (K,) length at rest [length]
    arm: np.ndarray  # (K,) position of the point at which the shear force acts, from 0 at j to 1 at i
    direction: np.ndarray  # (K, 3) unit vector from j to i at rest, rotated with j
    turn: np.ndarray  # (K, 4) quaternion of the rotation of i relative to j since the rest configuration
    angle_i: np.ndarray  # (K, 3) angle of i to which `direction` and `turn` belong [rad]
    angle_j: np.ndarray  # (K, 3) angle of j to which `direction` and `turn` belong [rad]
    stiffness: np.ndarray  # (K, 4) [force/length] twice, [force length] twice
    damping: np.ndarray  # (K, 4) [force time/length] twice, [force time] twice
    strength: np.ndarray  # (K, 4) [force] twice, [force length] twice; 1e300: none
    form: np.ndarray  # (K,) int8: combination of strengths, see `bond_shares`
    fading: np.ndarray  # (K,) int8: p, loads are multiplied by 1 − (load/strength)^p; 0: unchanged until failure
    failed: np.ndarray  # (K,) int8: load that broke the bond (see `FAILURES`); 0 if intact or unknown

    def check_entries(self) -> None:
        """Raise ValueError if an entry is not allowed (see `fields`)."""
        check_parts({"bonds": self})


@readable(head=lambda value: "forces of the last step of a run")
class Instant(NamedTuple):
    """Forces of the last step of a run, from which a continued run starts; see `dynamics.coefficients`."""

    force: np.ndarray  # (N + W, 6) forces and torques, external ones included
    pull: np.ndarray  # (3, 3) L̇ of the cell's free components [1/time²]
    mark: int  # checksum of the state to which the forces belong


@readable(
    head=lambda value: _describe_state(value), rows=lambda value: _rows(value), picture=lambda value: _draw_svg(value)
)
class State(NamedTuple):
    """Complete state of an assembly, except for the law."""

    grains: Grains
    walls: Walls
    cell: Cell
    contacts: Contacts
    control: Control
    time: float  # [time]
    instant: Instant | None = None  # forces stored by a run with dashpots
    bonds: Bonds | None = None

    @property
    def n_bodies(self) -> int:
        """Number of grains plus number of walls."""
        return len(self.grains.radius) + len(self.walls.mass)

    def check_entries(self) -> None:
        """Raise ValueError if an entry is not allowed or if parts contradict each other."""
        parts = {name: part for name, part in zip(self._fields, self, strict=True) if name != "time"}
        parts = {name: part for name, part in parts.items() if part is not None or name not in ("instant", "bonds")}
        check_parts(parts | {"": self})
        _check_space(self)
        _check_bonds(self.bonds)
        _check_control(self)


def as_numbers(value, dtype=float) -> np.ndarray:
    """Array of real or whole numbers.

    Raise ValueError if a value cannot be converted exactly.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "biufO" or any(isinstance(v, complex) for v in array.ravel() if array.dtype.kind == "O"):
        what = {"c": "complex numbers", "M": "dates", "m": "time differences", "O": "complex numbers"}
        raise ValueError(f"expected real numbers, got {what.get(array.dtype.kind, 'words')}")
    if np.issubdtype(dtype, np.integer) and array.dtype.kind in "fO":
        for value in array[(array != np.round(array.astype(float))) | (abs(array) > 2**53)].flat:
            raise ValueError(f"expected whole numbers of at most 2^53 in size, got {value:g}")
    return np.asarray(array, dtype)


def as_rows(value, n, width=None, dtype=float):
    """Contiguous copy of `value`, broadcast to (n,) or (n, width). Vectors in the plane get a third component, zero."""
    array = np.asarray(value, bool) if dtype is bool else as_numbers(value, dtype)
    if width == 3 and array.shape[-1:] == (2,):
        array = np.concatenate([array, np.zeros((*array.shape[:-1], 1))], axis=-1)
    shape = (n,) if width is None else (n, width)
    try:
        return np.array(np.broadcast_to(array, shape), order="C")
    except ValueError:
        raise ValueError(
            f"expected an array of shape {shape}, one row for each body or one for all, got {array.shape}"
        ) from None


@checked
def disks(
    position: Numbers, radius: Numbers, *, mass: Numbers = 1.0, i0: Numbers = 0.5, material: Numbers = 0,
    velocity: Numbers = 0.0, spin: Numbers = 0.0, angle: Numbers = 0.0,
) -> Grains:  # fmt: skip
    """Grains, at rest by default, with moment of inertia i0 m R².

    Parameters
    ----------
    position : (N, 2) or (N, 3) [length]
    radius, mass : float or (N,) [length], [mass]
    i0 : float, 1/2 for disks, 2/5 for spheres
    material : int or (N,), row of the law's table
    velocity, spin, angle : broadcast to (N, 3)

    Examples
    --------
    >>> disks([[0, 0.5], [1, 0.5]], 0.5).inertia
    array([0.125, 0.125])
    """
    position = np.atleast_2d(as_numbers(position))
    n = len(position)
    radius, mass = as_rows(radius, n), as_rows(mass, n)
    return Grains(
        as_rows(position, n, 3),
        as_rows(angle, n, 3),
        as_rows(velocity, n, 3),
        as_rows(spin, n, 3),
        radius,
        mass,
        as_rows(i0, n) * mass * radius**2,
        as_rows(material, n, dtype=np.int64),
    )


@checked
def spheres(
    position: Numbers, radius: Numbers, *, mass: Numbers = 1.0, i0: Numbers = 0.4, material: Numbers = 0,
    velocity: Numbers = 0.0, spin: Numbers = 0.0, angle: Numbers = 0.0,
) -> Grains:  # fmt: skip
    """Like `disks`, with the moment of inertia of a homogeneous sphere."""
    more = {"material": material, "velocity": velocity, "spin": spin, "angle": angle}
    return disks(position, radius, mass=mass, i0=i0, **more)


@checked
def flat_walls(
    point: Numbers = (), normal: Numbers = (), *, mass: Numbers = 1.0, material: Numbers = 0, velocity: Numbers = 0.0
) -> Walls:
    """Flat walls through `point`, with a `normal` of any nonzero length that points towards the grains."""
    point, normal = as_numbers(point), as_numbers(normal)
    point, normal = (np.atleast_2d(a) if a.size else np.zeros((0, 3)) for a in (point, normal))
    n = max(len(point), len(normal))
    normal = as_rows(normal, n, 3)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    if not (size > 0).all():
        raise ValueError("the normal of a wall has zero length: give a vector that points towards the grains")
    return Walls(
        as_rows(point, n, 3),
        normal / size,
        as_rows(velocity, n, 3),
        as_rows(mass, n),
        as_rows(material, n, dtype=np.int64),
    )


@checked
def box(
    size: Numbers = (1.0, 1.0, 1.0), periodic: tuple[bool, ...] | list[bool] | np.ndarray = (False,) * 3, dim: int = 3
) -> Cell:
    """Orthogonal or skewed cell, periodic along chosen vectors.

    Parameters
    ----------
    size : three lengths of an orthogonal cell, or three vectors as rows; in two dimensions also two of each [length]
    periodic : whether the cell repeats along each vector
    dim : 3, or 2 for disks in the plane of x and y

    Examples
    --------
    >>> box([10, 5], periodic=(True, False), dim=2).vectors.diagonal()
    array([10.,  5.,  1.])
    """
    size = as_numbers(size)
    if size.ndim not in (1, 2) or not np.isfinite(size).all() or (size.ndim == 1 and not (size > 0).all()):
        raise ValueError(f"cell must be positive lengths or a matrix with the box vectors as rows, got {size.tolist()}")
    vectors = np.diag(size) if size.ndim == 1 else size
    if dim == 2 and vectors.shape == (2, 2):
        vectors = np.block([[vectors, np.zeros((2, 1))], [np.zeros((1, 2)), 1.0]])
    if dim == 2 and len(periodic) == 2:
        periodic = (*periodic, False)
    return Cell(np.ascontiguousarray(vectors), np.array(periodic, bool), int(dim), np.zeros((3, 3)))


def empty_contacts(n_bodies: int, capacity: int, skin: float, bare=False, keyed=True) -> Contacts:
    """Empty contact list with room for `capacity` pairs; the first evaluation of forces fills it.

    `bare` omits `pair` and `roll`, which a run of many grains writes only at the end. `keyed=False` omits `key`.
    """
    c, anchors, keys = capacity, 0 if bare else capacity, capacity if keyed else 0
    return Contacts(
        np.zeros(c, np.int32),
        np.zeros(c, np.int32),
        np.zeros((c, 3), np.int16),
        np.zeros(keys, np.int64),
        np.zeros((c, 3)),
        np.zeros(c, np.int8),
        np.zeros((anchors, 3)),
        np.zeros((anchors, 3)),
        np.zeros(c, np.bool_),
        np.zeros((n_bodies, 3)),
        float(skin),
        0.0,
        True,
        np.zeros(1, np.int64),
    )


def resting(state: State) -> State:
    """State whose grains, walls and cell do not move."""
    grains, walls = state.grains, state.walls
    return state._replace(
        grains=grains._replace(velocity=np.zeros_like(grains.velocity), spin=np.zeros_like(grains.spin)),
        walls=walls._replace(velocity=np.zeros_like(walls.velocity)),
        cell=state.cell._replace(rate=np.zeros((3, 3))),
    )


def reset_reached(contacts: Contacts) -> Contacts:
    """Contacts of an equilibrium: only those that are sliding count as having reached the Coulomb limit.

    Sliding contacts whose slip is zero have no friction and have not reached a limit.
    """
    return contacts._replace(reached=(contacts.mode == SLIDE) & contacts.slip.any(axis=1))


@checked
def loads(
    n_grains: int, n_walls: int = 0, *, force: Numbers = 0.0, torque: Numbers = 0.0, gravity: Series = (0.0, 0.0, 0.0)
) -> Control:
    """Control with free grains, frozen walls, and the given loads on the grains.

    Parameters
    ----------
    force, torque : broadcast to (n_grains, 3) [force], [force length]
    gravity : (3,) [length/time²]
    """
    if min(n_grains, n_walls) < 0:
        raise ValueError(f"numbers of grains and walls must not be negative, got {n_grains} and {n_walls}")
    n = n_grains + n_walls
    require_sizes([Size("these are", n, "bodies", "use fewer")])
    control = Control(
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.ones((n, 6), bool),
        np.zeros((n, 6)),
        as_rows(gravity, 1, 3)[0],
        np.full(n, -1),
        np.zeros((3, 3), bool),
        np.zeros((3, 3)),
        np.zeros((3, 3)),
        0.0,
        np.zeros(0),
        np.zeros((0, 0)),
        np.full((n, 6), -1, COURSE_DTYPE),
        np.full((3, 3), -1),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.full((n, 3), -1, COURSE_DTYPE),
    )
    for part, load in ((control.force, force), (control.torque, torque)):
        if np.any(load):  # arrays of zeros take no memory until they are written to
            part[:n_grains] = as_rows(load, n_grains, 3)
    control.free[n_grains:] = False
    return control


def groups(control: Control) -> list[np.ndarray]:
    """Numbers of the bodies in each rigid group."""
    return [np.flatnonzero(control.group == g) for g in range(control.group.max(initial=-1) + 1)]


@checked
def heights(position: np.ndarray, walls: Walls) -> np.ndarray:
    """Distances of points from walls, (N, W), positive in front of them [length].

    Examples
    --------
    >>> points = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    >>> heights(points, flat_walls([0, 0], [0, 1]))
    array([[ 1.],
           [-1.]])
    """
    require_shape((len(np.atleast_1d(position)), 3), position=position)
    return np.einsum("nwk,wk->nw", position[:, None] - walls.point, walls.normal)


@checked
def assembly(
    grains: Grains,
    walls: Walls | None = None,
    cell: Cell | None = None,
    control: Control | None = None,
    *,
    skin: float | None = None,
    time: float = 0.0,
) -> State:
    """State made of these parts, after validation. Its contact list is built at the first evaluation of forces.

    Without a cell, the grains are in open space: a plane for disks (z = 0, I = m R²/2), otherwise three dimensions.

    Raises
    ------
    ValueError
        If the parts do not fit together or contain invalid values, or if the centre of a grain is behind a wall.
    """
    walls = flat_walls() if walls is None else walls
    cell = box(dim=2 if _are_disks(grains) else 3) if cell is None else cell
    control = loads(len(grains.radius), len(walls.mass)) if control is None else control
    skin = 0.2 * float(np.min(grains.radius, initial=LARGEST)) if skin is None else skin
    contacts = empty_contacts(len(grains.radius) + len(walls.mass), 0, skin)
    state = State(grains, walls, cell, contacts, control, float(time))
    check(state)
    grain, wall = np.nonzero(heights(grains.position, walls) < 0)
    if len(grain):
        place = ", ".join(f"{x:.4g}" for x in grains.position[grain[0], : cell.dim])
        raise ValueError(
            f"grain {grain[0]} at ({place}) lies behind wall {wall[0]}, which would expel it: move one of them, or "
            f"turn the wall's normal towards the grains"
        )
    return state


def _are_disks(grains: Grains) -> bool:
    solid = np.isclose(grains.inertia, 0.5 * grains.mass * grains.radius**2, rtol=1e-9, atol=0)
    return bool(len(solid) and solid.all() and not grains.position[:, 2].any())


@checked
@knows_bonds
def check(state: State) -> None:
    """Raise ValueError if a state is not valid."""
    state.check_entries()
    grains, skin = state.grains, state.contacts.skin
    if len(grains.radius) > MAX_IN_CUBE:
        _check_crowding(grains)
    least = 1e-4 * float(grains.radius.min())
    if not skin >= least:
        raise ValueError(
            f"skin must be at least {least:g}, 1e-4 of the smallest radius, or contact lists would be rebuilt at "
            f"every step, got {skin:g}"
        )


def _check_space(state: State) -> None:
    """Raise ValueError if the cell or a wall is degenerate."""
    walls, cell = state.walls, state.cell
    if not len(state.grains.radius):
        raise ValueError("a state needs at least one grain")
    if cell.periodic.any() and abs(np.linalg.det(cell.vectors)) < 1e-300:
        raise ValueError("the cell's vectors span no volume: give three independent vectors")
    if cell.dim == 2 and cell.periodic.any() and abs(np.linalg.det(cell.vectors[:2, :2])) < 1e-300:
        raise ValueError("the first two of the cell's vectors span no area: give two independent vectors in the plane")
    if cell.dim == 2 and (cell.periodic[2] or walls.normal[:, 2].any()):
        raise ValueError("a two-dimensional cell must not be periodic or have walls along z")
    size = np.linalg.norm(walls.normal, axis=1)
    if not (abs(size - 1) < 1e-6).all():
        raise ValueError(
            f"the normal of a wall must be a unit vector, got one of length {size[abs(size - 1).argmax()]:g}"
        )


def _check_bonds(bonds: Bonds | None) -> None:
    """Raise ValueError if bonds are not as `packings.bonded` makes them, because their forces would be wrong."""
    if bonds is None or not len(bonds.i):
        return
    units = np.linalg.norm(bonds.turn, axis=1), np.linalg.norm(bonds.direction, axis=1)
    if not (bonds.i < bonds.j).all() or max(abs(size - 1).max() for size in units) > 1e-6:
        raise ValueError("bonds need i < j, and unit vectors as turn and direction: make them with packings.bonded")


def _check_crowding(grains: Grains) -> None:
    """Raise ValueError if the local density of grains is so large that a list of all pairs would exhaust the memory."""
    cells = np.floor(grains.position / grains.radius.min()) % 2.0**20
    _, place, count = np.unique(cells @ [1.0, 2.0**20, 2.0**40], return_index=True, return_counts=True)
    if count.max() > MAX_IN_CUBE:
        x = ", ".join(f"{v:.4g}" for v in grains.position[place[count.argmax()]])
        raise ValueError(f"{count.max()} grains lie within one grain radius of ({x}): move them apart")


def grain_volumes(state: State) -> np.ndarray:
    """Volume of each sphere, (N,), or area of each disk."""
    radius = state.grains.radius
    return np.pi * radius**2 if state.cell.dim == 2 else 4 / 3 * np.pi * radius**3


def volume(state: State) -> float:
    """Volume of the cell; in two dimensions, its area. Raises ValueError as `cell_volumes` does."""
    return float(cell_volumes(state.cell.vectors, state.cell.periodic, state.cell.dim))


def cell_volumes(vectors: np.ndarray, periodic: np.ndarray, dim: int) -> np.ndarray:
    """Volumes of cells with the given vectors, (..., 3, 3); in two dimensions, their areas.

    Raises
    ------
    ValueError
        If the cells are not periodic in all their dimensions.
    """
    if not periodic[:dim].all():
        raise ValueError("the cell is not periodic along all its axes: it has no volume to average over")
    return np.abs(np.linalg.det(vectors[..., :dim, :dim]))


def deforms(state: State) -> bool:
    """Return True if the cell moves or may move."""
    control = state.control
    return bool(control.cell_free.any() or control.cell_rate.any() or state.cell.rate.any())


def _check_control(state: State) -> None:
    """Raise ValueError if the control contradicts itself or the cell."""
    control, cell = state.control, state.cell
    for members in groups(control):
        if not len(members):
            continue
        alike = (control.free[members] == control.free[members[0]]).all() and not control.free[members, 3:].any()
        alike &= (control.follows[members] == control.follows[members[0]]).all()
        if not (alike and (control.rate[members] == control.rate[members[0]]).all()):
            raise ValueError(
                f"the rigid group of bodies {members[0]} … {members[-1]} has contradictory control: all its members "
                f"must be free, frozen or driven alike along each direction, and none may rotate"
            )
    if (np.diff(control.knots) <= 0).any():
        raise ValueError("knots must increase: each time must be later than the previous one")
    held = (control.spring > 0) & ~control.free[:, :3]
    if held.any():
        body, axis = np.argwhere(held)[0]
        raise ValueError(
            f"a spring pulls body {body} along {'xyz'[axis]}, where it is frozen or driven: leave it free there"
        )
    if not deforms(state):
        return
    moves = control.cell_free | (control.cell_rate != 0) | (cell.rate != 0)
    periodic = cell.periodic & (np.arange(3) < cell.dim)
    if moves[~periodic].any() or moves[:, ~periodic].any():
        raise ValueError("a cell deforms only along periodic axes: make this axis periodic, or omit its deformation")
    if len(state.walls.mass) or (control.group >= 0).any():
        raise ValueError("a cell with walls or rigid groups cannot deform: remove them, or omit the deformation")


def _describe_grains(grains: Grains) -> str:
    radius = grains.radius
    sizes = f", radii {radius.min():.4g} to {radius.max():.4g}, mass {grains.mass.sum():.4g}" if len(radius) else ""
    return pluralize(len(radius), "grain") + sizes


def _describe_cell(cell: Cell) -> str:
    lengths = " × ".join(f"{x:.4g}" for x in np.linalg.norm(cell.vectors, axis=1)[: cell.dim])
    axes = "".join(name for name, around in zip("xyz", cell.periodic[: cell.dim], strict=False) if around)
    moving = ", deforming" if cell.rate.any() else ""
    return f"{cell.dim} dimensions, {lengths}, {f'periodic along {axes}' if axes else 'not periodic'}{moving}"


def _describe_contacts(contacts: Contacts) -> str:
    return f"{_describe_modes(contacts)} in a list of {pluralize(int(contacts.count[0]), 'pair')}"


def _describe_bonds(bonds: Bonds) -> str:
    broken = len(bonds.i) - int(bonds.intact.sum())
    return pluralize(len(bonds.i), "bond") + (f" ({broken} broken)" if broken else "")


def _describe_modes(contacts: Contacts) -> str:
    if contacts.stale and not contacts.count[0]:
        return "contacts not yet searched"
    touching, sliding = _count_contacts(contacts)
    moved = " when last evaluated" if contacts.stale else ""
    return f"{pluralize(touching, 'contact')} ({sliding} sliding){moved}"


def _count_contacts(contacts: Contacts) -> tuple[int, int]:
    """Numbers of contacts that touch, and of those whose slip has reached the Coulomb limit; see `reset_reached`."""
    mode, slip = contacts.mode[: contacts.count[0]], contacts.slip[: contacts.count[0]]
    return int((mode != OPEN).sum()), int(((mode == SLIDE) & slip.any(axis=1)).sum())


def _contact_rows(contacts: Contacts):
    count = int(contacts.count[0])
    touching, sliding = _count_contacts(contacts)
    if contacts.stale and not count:
        yield "contacts", "not yet searched: the first evaluation of forces finds them"
        return
    longest = float(np.linalg.norm(contacts.slip[:count][contacts.mode[:count] != OPEN], axis=1).max(initial=0.0))
    yield "contacts that touch", touching, "", "when last evaluated" if contacts.stale else ""
    yield "contacts that slide", sliding, "", "at the Coulomb limit"
    yield "largest slip", longest, "length"
    yield "listed pairs", count, "", f"closer than a gap of {contacts.skin:.4g}"


def _describe_control(control: Control) -> str:
    held = int((~control.free[:, :3].any(axis=1)).sum())
    parts = [pluralize(len(control.force), "body").replace("bodys", "bodies"), f"{held} of them fixed or driven"]
    if groups := len(np.unique(control.group[control.group >= 0])):
        parts.append(pluralize(groups, "rigid group"))
    if springs := int(control.spring.any(axis=1).sum()):
        parts.append(f"{springs} pulled by springs")
    if control.gravity.any():
        parts.append(f"gravity ({', '.join(f'{g:.4g}' for g in control.gravity)})")
    if control.cell_free.any():
        parts.append("stress-controlled cell")
    return ", ".join(parts)


def _describe_state(state: State) -> str:
    kind = "disk" if state.cell.dim == 2 else "sphere"
    around = state.cell.periodic[: state.cell.dim]
    cell = "a periodic cell" if around.all() else "a partly periodic cell" if around.any() else "open space"
    walls = f", {pluralize(len(state.walls.mass), 'wall')}" if len(state.walls.mass) else ""
    grains, contacts = pluralize(len(state.grains.radius), kind), _describe_modes(state.contacts)
    bonds = f", {_describe_bonds(state.bonds)}" if state.bonds else ""
    return f"{grains} in {cell}{walls}, {contacts}{bonds}, t = {state.time:.6g}"


def _rows(state: State):
    """Table rows of a state, without the pressure, which depends on the law."""
    grains, cell = state.grains, state.cell
    yield "grains", pluralize(len(grains.radius), "disk" if cell.dim == 2 else "sphere")
    yield "radii", grains.radius, "length"
    yield "walls", pluralize(len(state.walls.mass), "flat wall") if len(state.walls.mass) else None
    yield "cell", _describe_cell(cell), "length"
    yield from _contact_rows(state.contacts)
    if state.bonds:
        yield "bonds", _describe_bonds(state.bonds)
    if cell.periodic[: cell.dim].all():
        yield "packing fraction", float(grain_volumes(state).sum()) / volume(state)
    yield "loads and motions", _describe_control(state.control)
    yield "time", state.time, "time"


def _draw_svg(state: State) -> str:
    """SVG of at most 3000 grains, those with the largest z, viewed along z."""
    r, radius = state.grains.position, state.grains.radius
    if not len(radius) or not np.isfinite(r).all():
        return ""
    order = np.argsort(r[:, 2])[-3000:]
    low, high = (r - radius[:, None]).min(axis=0), (r + radius[:, None]).max(axis=0)
    size = max(high[0] - low[0], high[1] - low[1])
    circles = "".join(
        f"<circle cx='{(r[k, 0] - low[0]) / size:.4f}' cy='{(high[1] - r[k, 1]) / size:.4f}' "
        f"r='{radius[k] / size:.4f}'/>"
        for k in order
    )
    wide, tall = (high[0] - low[0]) / size, (high[1] - low[1]) / size
    style = "fill='#9db4c8' stroke='#2b3a4a' stroke-width='0.002'"
    box = f"width='{200 * wide:.0f}' height='{200 * tall:.0f}' viewBox='0 0 {wide:.4f} {tall:.4f}'"
    return f"<svg {box} xmlns='http://www.w3.org/2000/svg'><g {style}>{circles}</g></svg>"
