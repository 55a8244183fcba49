"""Loads and motions imposed on bodies and on the cell. Each function returns an extended copy of a control."""

from typing import Annotated, Any

import numpy as np

from .arguments import Array, Bodies, Numbers, Positive, Requirement, Series, checked, one_of, require_shape
from .state import Control, as_numbers, as_rows


def body_numbers(control: Control, bodies) -> np.ndarray:
    """Body numbers, (k,) integers, from numbers, a range, a slice, or a mask over all bodies."""
    count = len(control.force)
    if isinstance(bodies, slice):
        return np.arange(count)[bodies]
    numbers = np.atleast_1d(bodies)
    if numbers.dtype == bool and numbers.shape == (count,):
        return np.flatnonzero(numbers)
    if numbers.size and (numbers.dtype.kind not in "iu" or numbers.ndim != 1):
        raise ValueError(f"bodies must be body numbers or a mask of all {count} bodies, got {bodies!r}")
    for worst in numbers[(numbers < 0) | (numbers >= count)]:
        raise ValueError(f"body {worst} does not exist: bodies have numbers 0 to {count - 1}, grains first, then walls")
    return numbers.astype(int)


@checked
def fixed(control: Control, bodies: Bodies) -> Control:
    """Control in which the given bodies do not move."""
    return driven(control, bodies, 0.0)


@checked
def driven(control: Control, bodies: Bodies, rate: Numbers) -> Control:
    """Control in which all components of the given bodies move at `rate`, which is broadcast to (bodies, 6)."""
    bodies, free, speed = body_numbers(control, bodies), control.free.copy(), control.rate.copy()
    free[bodies] = False
    speed[bodies] = as_rows(rate, len(bodies), 6)
    return control._replace(free=free, rate=speed)


@checked
def rigid(control: Control, bodies: Bodies) -> Control:
    """Control in which the given bodies form one rigid body without rotation, such as a plate or a glued layer.

    Along each direction, the rigid body is free, frozen, driven or force-controlled like its members, which must all
    agree. Forces on members add up. The velocity at the start of a run is that of the centre of mass.

    Examples
    --------
    A plate of grains 3 and 4, pressed along y and pulled along x at a given speed:

    >>> import stickslip as ss
    >>> control = rigid(ss.control.loads(5), [3, 4])
    >>> control.force[3, 1] = -0.1
    >>> control.free[[3, 4], 0], control.rate[[3, 4], 0] = False, 1e-3
    >>> control.group
    array([-1, -1, -1,  0,  0])
    """
    bodies, group = body_numbers(control, bodies), control.group.copy()
    free, rate = control.free.copy(), control.rate.copy()
    free[bodies, 3:], rate[bodies, 3:] = False, 0.0
    group[bodies] = group.max() + 1
    return control._replace(free=free, rate=rate, group=group)


@checked
def force_controlled(control: Control, bodies: Bodies, force: Numbers) -> Control:
    """Control in which walls or rigid groups are servo-controlled: they move under a force until contacts balance it.

    Parameters
    ----------
    bodies : numbers of walls, or of grains of a rigid group
    force : (3,) or (2,) on each of them; nonzero components are controlled. It is the pressure times the loaded area
        or, for a rigid group, the total force divided by the number of its members [force]

    Examples
    --------
    A lid, body 101, pressed down with a force of 0.5:

    >>> import stickslip as ss
    >>> bodies = ss.control.loads(100, 2)
    >>> control = ss.control.force_controlled(bodies, [101], [0, -0.5])
    >>> control.free[101, :3]
    array([False,  True, False])
    """
    bodies, whole = body_numbers(control, bodies), as_rows(force, 1, 3)[0]
    free, rate, forces = control.free.copy(), control.rate.copy(), control.force.copy()
    for k in np.flatnonzero(whole):
        free[bodies, k], rate[bodies, k], forces[bodies, k] = True, 0.0, whole[k]
    return control._replace(free=free, rate=rate, force=forces)


@checked
def strained_at(control: Control, rate: Annotated[Any, Array(shapes=((2, 2), (3, 3)))]) -> Control:
    """Control in which the cell deforms with a velocity gradient L and carries the grains along: ẋ = v + L x.

    Components that follow the stress (`stress_controlled`) stay free where `rate` is zero. Shear at constant pressure
    therefore needs both calls.

    Parameters
    ----------
    rate : (3, 3) or (2, 2) L_ab = ∂v_a/∂x_b [1/time]; L[0, 1] = γ̇ is simple shear along x with gradient y, L[1, 1] < 0
        compresses along y

    Examples
    --------
    Shear at constant pressure: the cell's height follows the normal stress.

    >>> import stickslip as ss
    >>> control = ss.control.strained_at(ss.control.loads(100), [[0, 1e-4], [0, 0]])
    >>> control = ss.control.stress_controlled(control, {"yy": 1e-3})
    >>> float(control.cell_rate[0, 1]), bool(control.cell_free[1, 1])
    (0.0001, True)
    """
    gradient, rate = np.zeros((3, 3)), np.asarray(rate, float)
    gradient[: len(rate), : len(rate)] = rate
    return control._replace(cell_rate=gradient, cell_free=control.cell_free & (gradient == 0))


@checked
def stress_controlled(control: Control, stress: dict[str, float] | Numbers, *, mass: float = 0.0) -> Control:
    """Control in which components of the cell's strain follow the stress: M ℓ² L̇_ab = V (σ_ab − target), ℓ = V^(1/dim).

    Targets are absolute, independent of the present stress; the strain starts from the cell of the state.
    σ includes the contributions of contacts and of velocity fluctuations; compression is positive. Each of these
    components is a degree of freedom in dynamics, in J, and in Newton's method.

    Parameters
    ----------
    stress : component -> target value, as in {"xx": p, "yy": p, "zz": p} or {"xy": tau}; the first letter is the
        direction of displacement and force, the second that of the gradient and of the area's normal; or a tensor,
        (dim, dim), whose components on and above the diagonal are imposed, so that the cell does not rotate
        [force/length^(dim−1)]
    mass : float, M [mass]; 0: the mass of all grains, for which the cell oscillates about as fast as sound crosses it

    Raises
    ------
    ValueError
        If a component does not consist of two letters, each of them x, y or z.
    """
    if not isinstance(stress, dict):
        tensor = as_numbers(stress)
        if tensor.shape not in ((2, 2), (3, 3)):
            raise ValueError(
                f"a stress must be a (dim, dim) tensor or components by name, got an array of shape {tensor.shape}"
            )
        stress = {"xyz"[a] + "xyz"[b]: float(tensor[a, b]) for a, b in zip(*np.triu_indices(len(tensor)), strict=True)}
    free, wanted = control.cell_free.copy(), control.stress.copy()
    for name, value in stress.items():
        if len(name) != 2 or not set(name) <= set("xyz"):
            raise ValueError(f"a stress component has two letters, each x, y or z, such as 'yy', got {name!r}")
        where = tuple("xyz".index(letter) for letter in name)
        free[where], wanted[where] = True, value
    rate = np.where(free, 0.0, control.cell_rate)
    return control._replace(cell_free=free, stress=wanted, cell_rate=rate, cell_mass=float(mass))


@checked
def time_dependent(
    control: Control, bodies: str | Bodies, times: Series, factors: Series, *, axes: Bodies = slice(None)
) -> Control:
    """Control in which the rates of driven components of the given bodies are multiplied by a function of time.

    Parameters
    ----------
    bodies : numbers of grains and walls, or "cell" for the cell's velocity gradient
    times : (K,) increasing [time]; factors : (K,) dimensionless, linear between times, constant beyond
    axes : indices from 0 to 5 of x, y, z, and of the rotations about them; default: all

    Examples
    --------
    A floor, body 10, shaken sideways with a velocity amplitude of 0.1 and a period of 50 time units:

    >>> import numpy as np
    >>> import stickslip as ss
    >>> control = ss.control.driven(ss.control.loads(10, 1), [10], [0.1, 0, 0, 0, 0, 0])
    >>> times = np.linspace(0, 200, 401)
    >>> swing = np.cos(2 * np.pi * times / 50)
    >>> ss.control.time_dependent(control, [10], times, swing).follows[10, :3]
    array([0, 0, 0], dtype=int16)
    """
    control = control._replace(course=_add_column(control.course))
    column = control.course.shape[1] - 1
    knots, course = _merge_course(control, times, factors, column)
    follows, cell_follows = control.follows.copy(), control.cell_follows.copy()
    if isinstance(bodies, str):
        if bodies != "cell":
            raise ValueError(f"bodies must be body numbers or 'cell', got {bodies!r}")
        cell_follows[:] = column
    else:
        axes = np.arange(6)[axes] if isinstance(axes, slice) else _axis_numbers(axes)
        follows[body_numbers(control, bodies)[:, None], axes] = column
    return control._replace(knots=knots, course=course, follows=follows, cell_follows=cell_follows)


@checked
def spring_loaded(
    control: Control,
    bodies: Bodies,
    position: Numbers,
    stiffness: Positive,
    *,
    axis: Annotated[int, one_of(0, 1, 2)] = 0,
    times: Series = (0.0,),
    displacement: Series = (0.0,),
) -> Control:
    """Control in which a spring pulls bodies along an axis: F = k (x₀ + d(t) − x), where x₀ + d is the load point.

    The bodies are free along that axis, and move as one if they are a rigid group. A second call replaces the motion of
    the load point.

    Parameters
    ----------
    bodies : numbers of walls, of grains, or of grains of a rigid group
    position : (n, 3) x₀, positions of the bodies at which a spring with d = 0 exerts no force [length]
    stiffness : k of the single spring that pulls all bodies, divided equally among them [force/length]
    axis : 0, 1, 2 for x, y, z
    times : (K,) increasing [time]; displacement : (K,) d, linear between times, constant beyond [length]

    Examples
    --------
    A slider, body 0, pulled at a velocity of 0.1 for 20 time units, then held:

    >>> import stickslip as ss
    >>> pull = {"times": [0, 20], "displacement": [0, 2]}
    >>> control = spring_loaded(ss.control.loads(1), [0], [[0, 0, 0]], 2.0, **pull)
    >>> spring_forces(control, np.zeros((1, 3)), 5.0)[0]
    array([1., 0., 0.])
    """
    bodies = body_numbers(control, bodies)
    if not len(bodies):
        raise ValueError("a spring needs at least one body")
    column = control.leads[bodies[0], axis]
    others = control.leads == column
    others[bodies, axis] = False
    column = -1 if others.any() else column  # keep a course that other bodies also follow
    control = control if column >= 0 else control._replace(course=_add_column(control.course))
    column = column if column >= 0 else control.course.shape[1] - 1
    knots, course = _merge_course(control, times, displacement, column)
    arrays = {name: getattr(control, name).copy() for name in ("free", "rate", "spring", "anchor", "leads")}
    arrays["free"][bodies, axis], arrays["rate"][bodies, axis] = True, 0.0
    arrays["spring"][bodies, axis] = stiffness / len(bodies)
    arrays["anchor"][bodies, axis] = as_rows(position, len(bodies), 3)[:, axis]
    arrays["leads"][bodies, axis] = column
    return control._replace(knots=knots, course=course, **arrays)


@checked
def spring_forces(control: Control, position: Numbers, time: float) -> np.ndarray:
    """Forces of springs, (B, 3), on bodies at (B, 3) positions [force]."""
    require_shape(control.spring.shape, position=position)
    if not control.spring.any():
        return np.zeros_like(control.spring)
    displacement = np.append(factors_at(control, time)[:-1], 0.0)[control.leads]
    return control.spring * (control.anchor + displacement - position)


def _axis_numbers(axes) -> np.ndarray:
    """Numbers of axes, (k,) integers from 0 to 5."""
    numbers = np.atleast_1d(axes)
    if numbers.dtype.kind not in "iu" or not ((numbers >= 0) & (numbers < 6)).all():
        raise ValueError(f"axes must be from 0 to 5 (x, y, z, and rotations about them), got {axes!r}")
    return numbers


def _add_column(course):
    return np.concatenate([course, np.zeros((len(course), 1))], axis=1)


def _merge_course(control: Control, times, values, column: int) -> tuple[np.ndarray, np.ndarray]:
    """Knots and time profiles with one column replaced by the given times and values."""
    times, values = np.atleast_1d(as_numbers(times)), np.atleast_1d(as_numbers(values))
    if times.ndim != 1 or times.shape != values.shape or not len(times) or (np.diff(times) <= 0).any():
        raise ValueError(f"times must increase, one for each value, got {len(times)} times and {len(values)} values")
    knots = np.union1d(control.knots, times)
    old = [np.interp(knots, control.knots, c) if len(control.knots) else np.zeros(len(knots)) for c in control.course.T]
    course = np.stack(old, axis=1)
    course[:, column] = np.interp(knots, times, values)
    return knots, course


def factors_at(control: Control, time: float) -> np.ndarray:
    """Factor of each time profile at a time, (C + 1,). The last is 1, for rates without a profile."""
    return np.array([*(np.interp(time, control.knots, column) for column in control.course.T), 1.0])


def _require_share(name: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must be from 0 to 1, got {value}")


@checked
def between(begin: Control, end: Control, share: Annotated[float, Requirement(_require_share)]) -> Control:
    """Interpolate between two controls, at a fraction `share` of the way, from 0 to 1.

    Forces, torques, gravity, stress and the anchors of springs are interpolated.
    """
    mixed = {
        name: (1 - share) * getattr(begin, name) + share * getattr(end, name)
        for name in ("force", "torque", "gravity", "stress", "anchor")
    }
    return begin._replace(**mixed)
