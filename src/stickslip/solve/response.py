"""Response of a packing to periodic forces, motions and strains: the transfer function of its linearised dynamics.

Drives and observables are arrays (…, N + W, 6) over the components x, y, z and R·angle of all bodies. A drive is a
force or torque/R on each free component, and a displacement of each prescribed one. An observable is a weighted sum of
displacements. In a free cell, grains are driven and observed relative to the affine motion of the cell.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, eig

from ..core.arguments import NotNegative, Numbers, Values, checked, require_filled, require_index, require_shape
from ..core.contacts.jacobian import blocks_of, cross_matrix, linearise
from ..core.fields import LARGEST
from ..core.laws.builtin import Law
from ..core.measure import branch_vectors, volume
from ..core.progress import Report, Size, require_sizes, silent
from ..core.readable import readable
from ..core.state import State, as_rows, groups
from .balance import LinearisedState, balanced, with_modes_under
from .freedom import Freedom, assembled, freedom, jacobian, mass_weighted, stiffness_of
from .linear import FrontalFactor, dissect, one_thread
from .moduli import check_cell, elastic_moduli, isotropic, with_free_cell

DIRECT_UP_TO = 300  # number of coordinates up to which LAPACK solves for each frequency
STEPS, ROUNDS = 300, 6  # number of Arnoldi steps between checks of convergence, and largest number of checks
ALLOWED = 1e-6  # largest deviation of k·a/2π from an integer
SOLVED = 1e-8  # largest relative residual of a solution
WITHOUT_LIMIT = 1e12  # response, over that of the largest stiffness, above which round-off dominates


@readable
class FrequencyResponse(NamedTuple):
    """Transfer function of a packing: complex amplitudes of observables per unit of each drive."""

    frequency: np.ndarray  # (F,) ω, in the order given [1/time]
    matrix: np.ndarray  # (F, m, k) complex: for drives Re d exp(iωt), the observables are Re (matrix @ d) exp(iωt)
    free: Freedom  # coordinates that respond, without rattlers; without `observe`, they are the observables

    @property
    def gain(self) -> np.ndarray:
        """(F,) largest amplitude of the observables over that of the drives: the largest singular value."""
        return np.linalg.norm(self.matrix, 2, axis=(1, 2))

    @property
    def worst_frequency(self) -> float:
        """Frequency of the largest gain [1/time]."""
        return float(self.frequency[np.argmax(self.gain)])

    @property
    def worst_drive(self) -> np.ndarray:
        """(k,) complex unit combination of the drives with the largest gain."""
        return np.linalg.svd(self.matrix[np.argmax(self.gain)], full_matrices=False)[2][0].conj()

    @property
    def worst_answer(self) -> np.ndarray:
        """(m,) complex observables in response to `worst_drive` at `worst_frequency`."""
        return self.matrix[np.argmax(self.gain)] @ self.worst_drive


class ForcedMotion(NamedTuple):
    """ÿ = −A y − D ẏ + b of the mass-weighted free coordinates, with their coupling to prescribed ones."""

    here: LinearisedState
    free: Freedom  # without rattlers
    whole: Freedom  # all coordinates, including prescribed ones
    inner: np.ndarray  # (n,) index of each free coordinate among all coordinates
    pull: sparse.csr_array  # (n, n) A [1/time²]
    drag: sparse.csr_array  # (n, n) D [1/time]
    stiff: sparse.csr_array  # J of all coordinates
    damp: sparse.csr_array  # ∂f/∂q̇ of all coordinates

    def drives(self, drive: np.ndarray, name: str = "drive") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forces (n, k) that drives (k, B, 6) and their velocities exert on free coordinates, and motions (N, k).

        The forces are mass-weighted. The motions are those prescribed by the drives, and zero for free coordinates.
        """
        _check_groups(self.here.state, drive, name)
        flat, prescribed = _gather(self.whole, drive), ~self.here.state.control.free.ravel()
        prescribed = np.append(prescribed, np.zeros(9, bool))[self.whole.component]
        lead = np.hstack([drive.reshape(len(drive), -1), np.zeros((len(drive), 9))])[:, self.whole.component]
        motion, root = np.where(prescribed, lead, 0.0).T, np.sqrt(self.free.mass)[:, None]
        forces = flat.T[self.inner] + (self.stiff @ motion)[self.inner]
        resists = (self.damp @ motion)[self.inner]
        if not (forces.any(axis=0) | resists.any(axis=0)).all():
            raise ValueError(
                f"the {name} moves nothing: it needs a force on a grain held by others, or a motion of a prescribed "
                "body that touches such a grain"
            )
        return forces / root, resists / root, motion

    def matrix(self, frequency: float):
        """(n, n) sparse A + iωD − ω²."""
        return sparse.csr_array(
            self.pull + 1j * frequency * self.drag - frequency**2 * sparse.eye_array(len(self.free), format="csr")
        )

    def all_coordinates(self, y: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """(N, …) displacements of all coordinates for y (n, …) and prescribed motions (N, …)."""
        out = motion.astype(y.dtype)
        out[self.inner] += y / np.sqrt(self.free.mass).reshape(-1, *np.ones(y.ndim - 1, int))
        return out


def _check_groups(state: State, drive: np.ndarray, name: str) -> None:
    """Raise ValueError if a drive (k, B, 6) deforms or rotates a prescribed rigid group."""
    motion = np.where(state.control.free, 0.0, drive)
    for members in filter(len, groups(state.control)):
        if motion[:, members, 3:].any() or np.ptp(motion[:, members], axis=1).any():
            raise ValueError(
                f"the {name} deforms or rotates the rigid group of bodies {', '.join(map(str, members))}: give all of "
                "them the same displacement, and no rotation"
            )


def _gather(whole: Freedom, weights: np.ndarray) -> np.ndarray:
    """(k, N) generalised components of weights (k, B, 6), summed over the members of rigid groups."""
    place = whole.place[:-9]
    out = np.zeros((len(weights), len(whole) + 1))
    np.add.at(out, (slice(None), place), weights.reshape(len(weights), -1))
    return out[:, :-1]


def forced_motion(state: State, law: Law, drag: float, spin_drag: float | None) -> ForcedMotion:
    """Linearised motion of a balanced packing with drag and dashpots."""
    here = balanced(state, law)
    state, free = here.state, here.backbone
    if not len(free):
        raise ValueError("no free grain is held by contacts: a response needs grains that support each other")
    control = state.control
    everything = state._replace(control=control._replace(free=np.ones_like(control.free)))
    whole = freedom(everything)
    inner = np.searchsorted(whole.component, free.component)
    blocks, dampers = blocks_of(state, law, here.line)
    stiff, damp = stiffness_of(everything, here.line, blocks, whole), assembled(everything, dampers, whole)
    rate = drag_rates(free.axis, drag, spin_drag)
    pull, resists = (mass_weighted(sparse.csr_array(part[inner][:, inner]), free) for part in (stiff, damp))
    drags = sparse.csr_array(resists + sparse.diags_array(rate))
    return ForcedMotion(here, free, whole, inner, pull, drags, stiff, damp)


def drag_rates(axis: np.ndarray, drag: float, spin_drag: float | None) -> np.ndarray:
    """(n,) drag rate ν of each coordinate, given its axis [1/time]."""
    return np.where((axis < 3) | (axis == 6), drag, drag if spin_drag is None else spin_drag).astype(float)


@checked
def frequency_response(
    state: State, law: Law, drive: Numbers, frequency: Values, *, observe: Numbers | None = None,
    drag: NotNegative = 0.0, spin_drag: NotNegative | None = None, report: Report = silent,
) -> FrequencyResponse:  # fmt: skip
    """Transfer function C (A + iωD − ω²)⁻¹ B of the motion M q̈ = J q + C q̇ − M ν q̇ around an equilibrium.

    This is the steady response to small drives Re d exp(iωt), with each contact held in its mode. If a mode grows, the
    function exists, but no motion settles to it: see `damped_growth`. Rattlers do not move. In a free cell,
    displacements of grains are those beyond the affine motion ε x of the cell, and a force on a grain does not strain
    it directly.

    Velocities enter through drag and the dashpots of the law. Runs under small forces agreed with this gain and phase
    to within 0.2 % (`tests/modes/test_response.py`); under larger forces, contacts stiffen, slide and open.

    Parameters
    ----------
    drive : (N + W, 6), or (k, N + W, 6) for k drives: forces and torques/R on free components, displacements of
        prescribed ones (walls, fixed grains). For example, 1 at [wall, 0] shakes a wall along x, and 1 at [grain, 0]
        pushes a grain; `plane_wave` creates waves
    frequency : ω, scalar or (F,), zero or positive [1/time]
    observe : (N + W, 6) or (m, N + W, 6), weights of the displacements in each observable: see `contact_slip` and
        `stress_change`; default: the displacements of `free`
    drag, spin_drag : ν of translations and of rotations, as in `run`; spin_drag defaults to drag [1/time]
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If the forces do not balance; if a frequency is negative, or that of an undamped resonance; if a drive moves
        nothing, or deforms or rotates a prescribed rigid group; if a component does not exist, such as the rotation of
        a wall.

    Source
    ------
    Trefethen & Embree, Spectra and Pseudospectra (Princeton 2005), § 17, for the largest singular value. Large packings
    are projected on one Krylov space for all frequencies: Ruhe, doi:10.1016/0024-3795(84)90221-0.

    Examples
    --------
    The displacement of a grain that is pushed:

    >>> import numpy as np
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.68, seed=1)
    >>> push = np.zeros((20, 6))
    >>> push[3, 0] = 1
    >>> answer = frequency_response(
    ...     state, law, push, [0.2, 0.4], observe=push, drag=0.1
    ... )
    >>> answer.matrix.shape, answer.worst_frequency
    ((2, 1, 1), 0.4)
    """
    drive, observe = as_patterns(state, drive=drive), None if observe is None else as_patterns(state, observe=observe)
    frequency = as_frequencies(frequency)
    motion = forced_motion(state, law, drag, spin_drag)
    rows = len(motion.free) if observe is None else len(observe)
    size = 16.0 * len(frequency) * len(drive) * (rows + len(motion.free))
    require_sizes(
        [Size(f"{len(frequency)} frequencies of {state.n_bodies} bodies take", size, "bytes", "use fewer of them")]
    )
    still, moving, prescribed = motion.drives(drive)
    out = np.empty((len(frequency), rows, len(drive)), complex)
    for k in range(len(drive)):
        y = solve_at(motion, frequency, still[:, k], moving[:, k], report)
        if observe is None:
            out[:, :, k] = (y / np.sqrt(motion.free.mass)[:, None]).T
        else:
            x = motion.all_coordinates(y, np.repeat(prescribed[:, k, None], len(frequency), axis=1))
            out[:, :, k] = (_gather(motion.whole, observe) @ x).T
    return FrequencyResponse(frequency, out, motion.free)


def as_frequencies(frequency: Values) -> np.ndarray:
    """(F,) array of frequencies; raise ValueError if one is negative or not finite."""
    frequency = np.atleast_1d(np.asarray(frequency, float))
    for worst in frequency[~((frequency >= 0) & np.isfinite(frequency))]:
        raise ValueError(f"frequency must be zero or positive, got {worst:g}")
    return frequency


def as_patterns(state: State, **named) -> np.ndarray:
    """(k, B, 6) array of patterns over all bodies."""
    ((name, value),) = named.items()
    value = np.asarray(value, float)
    require_shape((*value.shape[: value.ndim == 3], state.n_bodies, 6), **{name: value})
    require_filled(name, value)
    value = value.reshape(-1, state.n_bodies, 6)
    absent = np.zeros((state.n_bodies, 6), bool)
    absent[len(state.grains.radius) :, 3:] = True
    absent[:, 2:5] |= state.cell.dim == 2
    for _, body, axis in np.argwhere((value != 0) & absent):
        raise ValueError(
            f"{name} must be zero at component {axis} of body {body}, a component that does not exist: walls do not "
            "rotate, and disks have the components 0, 1 and 5 (x, y, rotation about z)"
        )
    return value


def solve_at(motion: ForcedMotion, frequency, still, moving, report: Report = silent) -> np.ndarray:
    """(n, F) complex y of (A + iωD − ω²) y = b + iω c for mass-weighted forces b and c (n,)."""
    size = len(motion.free)
    out, solved = np.zeros((size, len(frequency)), complex), np.zeros(len(frequency), bool)
    if size > DIRECT_UP_TO and motion.drag.diagonal().any():
        for force, factor in ((still, np.ones(len(frequency))), (moving, 1j * frequency)):
            out += factor * _project(motion, frequency, force, report) if force.any() else 0.0
        b = still[:, None] + 1j * moving[:, None] * frequency
        left = motion.pull @ out + 1j * (motion.drag @ out) * frequency - out * frequency**2 - b
        solved = np.linalg.norm(left, axis=0) <= SOLVED * np.linalg.norm(b, axis=0)
    order, missing = None, np.flatnonzero(~solved)
    for k, row in enumerate(missing):
        report("frequency response", k / len(missing), f"frequency {frequency[row]:.4g}")
        if order is None and size > DIRECT_UP_TO:
            order = dissect(motion.here.state, motion.free, np.arange(size), motion.pull)
        b, scale = still + 1j * frequency[row] * moving, np.abs(motion.pull.data).max()
        out[:, row] = solve_directly(motion.matrix(frequency[row]), b[:, None], order, frequency[row], scale)[:, 0]
    return out


def solve_directly(matrix, b: np.ndarray, order, frequency: float, scale: float) -> np.ndarray:
    """Solve at one frequency for columns b (n, k) by factorisation; `scale` is the magnitude of the stiffnesses."""
    try:
        with one_thread():
            y = np.linalg.solve(matrix.toarray(), b) if order is None else FrontalFactor(matrix, order).solve(b)
    except LinAlgError:
        y = np.full(b.shape, np.inf)
    if not np.linalg.norm(y) * scale < WITHOUT_LIMIT * np.linalg.norm(b):
        raise ValueError(
            f"at frequency = {frequency:.9g}, the response is unbounded, as at an undamped resonance: use drag, a law "
            "with dashpots, or another frequency"
        )
    return y


def _project(motion: ForcedMotion, frequency, force, report: Report) -> np.ndarray:
    """(n, F) approximate y for a force, from one Krylov space of the first-order system for all frequencies.

    Time is measured in units in which both blocks of this system are of order one.
    """
    n, unit = len(force), np.sqrt(np.abs(motion.pull.data).max())
    pull, drag, shifts = motion.pull / unit**2, motion.drag / unit, 1j * frequency / unit
    most = min(STEPS * ROUNDS, 2 * n)
    basis, h = np.empty((most + 1, 2 * n)), np.zeros((most + 1, most))
    size = np.linalg.norm(force)
    basis[0] = np.append(0 * force, force / size)
    for step in range(most):
        z = np.append(basis[step, n:], -(pull @ basis[step, :n]) - drag @ basis[step, n:])
        for _ in range(2):
            part = basis[: step + 1] @ z
            z -= part @ basis[: step + 1]
            h[: step + 1, step] += part
        h[step + 1, step] = np.linalg.norm(z)
        ends = h[step + 1, step] <= 1e-14
        if not ends:
            basis[step + 1] = z / h[step + 1, step]
        if ends or (step + 1) % STEPS == 0 or step + 1 == most:
            report("frequency response", (step + 1) / most, f"{step + 1} vectors")
            with one_thread():  # (s − H) y = e₁
                values, vectors = eig(h[: step + 1, : step + 1])
                first = np.linalg.solve(vectors, np.eye(step + 1)[:, 0].astype(complex))
            distance = shifts - values[:, None]
            y = vectors @ (first[:, None] / np.where(distance == 0, 1e-300, distance))
            if ends or np.abs(h[step + 1, step] * y[-1]).max() <= 0.1 * SOLVED:
                break
    return (size / unit**2) * (basis[: len(y), :n].T @ y)


def in_plane(state: State, **named) -> np.ndarray:
    """(K, dim) array of one or more vectors, given with two or three components."""
    ((name, value),) = named.items()
    rows, dim = as_rows(value, len(np.atleast_2d(value)), 3), state.cell.dim
    for row in rows[rows[:, dim:].any(axis=1)]:
        raise ValueError(f"the z component of {name} must be zero for disks, got {row}")
    return rows[:, :dim]


def require_direction(**named) -> None:
    """Raise ValueError if a vector (K, dim) is zero, or nearly so."""
    for name, value in named.items():
        if not (np.abs(value).max(axis=1) >= 1 / LARGEST).all():
            raise ValueError(f"{name} = 0 has no direction: give a nonzero vector")


def require_allowed(state: State, k: np.ndarray) -> None:
    """Raise ValueError if the cell does not allow a wave vector (K, dim)."""
    dim = state.cell.dim
    turns = k @ state.cell.vectors[:dim, :dim][state.cell.periodic[:dim].astype(bool)].T / (2 * np.pi)
    for worst in k[(np.abs(turns - np.round(turns)) > ALLOWED).any(axis=1)]:
        raise ValueError(
            "the product of a wave vector with each vector of the periodic cell must be 2π times an integer, got "
            f"{worst}; see `allowed_wavevectors`"
        )


@checked
def plane_wave(state: State, wavevector: Numbers, direction: Numbers) -> np.ndarray:
    """(2, N + W, 6) forces m e cos(k·r) and m e sin(k·r) on the grains: body forces per unit of acceleration.

    Parameters
    ----------
    wavevector : (3,) or (2,) k, allowed by the cell where it is periodic [1/length]
    direction : (3,) or (2,) e, along k for a compressional wave, perpendicular to k for a shear wave

    Raises
    ------
    ValueError
        If the cell does not allow k, if e is zero, or if one of them leaves the plane of disks.
    """
    k, e = in_plane(state, wavevector=wavevector), in_plane(state, direction=direction)
    require_shape((1, state.cell.dim), wavevector=k, direction=e)
    require_allowed(state, k)
    require_direction(direction=e)
    n, dim, out = len(state.grains.radius), state.cell.dim, np.zeros((2, state.n_bodies, 6))
    phase = state.grains.position[:, :dim] @ k[0]
    out[:, :n, :dim] = (np.stack([np.cos(phase), np.sin(phase)]) * state.grains.mass)[:, :, None] * e
    return out


@checked
def contact_slip(state: State, contact: int) -> np.ndarray:
    """(dim − 1, N + W, 6) weights of the tangential displacement of body i relative to body j at a contact.

    It is t·(u_i − u_j − (R_i angle_i + R_j angle_j) × n) along each tangent t. For disks, t is (−n_y, n_x). For
    spheres, the tangents are e × n and n × (e × n), normalised, with the axis e of the smallest component of n.

    Parameters
    ----------
    contact : row of the contact list, see `measure.touching`
    """
    require_index(int(state.contacts.count[0]), contact=contact)
    contact = int(contact)  # True is 1
    normal = branch_vectors(state)[contact]
    normal = normal / np.linalg.norm(normal)
    if state.cell.dim == 2:
        tangents = np.array([[-normal[1], normal[0], 0.0]])
    else:
        across = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
        tangents = np.stack([across, np.cross(normal, across)]) / np.linalg.norm(across)
    out = np.zeros((len(tangents), state.n_bodies, 6))
    for body, sign in ((state.contacts.i[contact], 1.0), (state.contacts.j[contact], -1.0)):
        out[:, body, :3] += sign * tangents
        if body < len(state.grains.radius):
            out[:, body, 3:] += tangents @ cross_matrix(normal[None])[0]
    return out


@checked
def stress_change(state: State, law: Law) -> np.ndarray:
    """(dim², N + W, 6) weights of the change of the stress σ_xx, σ_xy, …, row by row; compression positive.

    They are the derivatives of `measure.stress` with respect to displacements in the fixed cell. Forces and branch
    vectors change, and each contact is held in its mode.

    Raises
    ------
    ValueError
        If the cell is not periodic in all its dimensions.
    """
    dim = state.cell.dim
    if len(state.walls.mass) or not state.cell.periodic[:dim].all():
        raise ValueError(
            "the packing has walls or open sides, but a stress needs a cell that is periodic in all dimensions"
        )
    free_cell = np.zeros((3, 3), bool)
    free_cell[:dim, :dim] = True
    control = state.control._replace(cell_free=free_cell, free=np.ones_like(state.control.free))
    whole = freedom(strained := with_modes_under(state, law)._replace(control=control))
    rows = jacobian(strained, law, whole)[np.flatnonzero(whole.axis == 6)].toarray()
    rows[:, whole.axis == 6] = 0.0
    out = np.zeros((dim**2, 6 * state.n_bodies + 9))
    out[:, whole.component] = rows * whole.length / volume(state)
    return out[:, :-9].reshape(dim**2, -1, 6)


@readable
class ComplexModuli(NamedTuple):
    """C*_abcd(ω) of a strain Re G exp(iωt): the stress is −Re C* G exp(iωt) [force/length^(dim−1)]."""

    frequency: np.ndarray  # (F,) ω, in the order given [1/time]
    tensor: np.ndarray  # (F, dim, dim, dim, dim) complex: storage + i loss
    affine: np.ndarray  # the same tensor if grains moved affinely with the cell and did not rotate

    @property
    def bulk(self) -> np.ndarray:
        """(F,) complex K* = K′ + iK″ of the nearest isotropic tensor."""
        return _isotropic(self.tensor)[:, 0]

    @property
    def shear(self) -> np.ndarray:
        """(F,) complex G* = G′ + iG″ of the nearest isotropic tensor."""
        return _isotropic(self.tensor)[:, 1]


def _isotropic(tensor: np.ndarray) -> np.ndarray:
    """(F, 2) complex bulk and shear moduli."""
    return np.array([np.array(isotropic(c.real)) + 1j * np.array(isotropic(c.imag)) for c in tensor]).reshape(-1, 2)


@checked
def complex_moduli(
    state: State, law: Law, frequency: Values, *, drag: NotNegative = 0.0, spin_drag: NotNegative | None = None,
    report: Report = silent,
) -> ComplexModuli:  # fmt: skip
    """Storage and loss moduli C* = −(ℓ²/V) (K_cc + K_cg u), (−ω²M + iωMν − K_gg) u = K_gc, K = J + iωC.

    c denotes the coordinates ℓG of the cell, g those of the grains, and C the derivatives of forces with respect to
    velocities, so that dashpots also resist the affine motion. As in `run`, velocities are relative to the flow of the
    cell, ẋ = v + Lx: the affine motion has no inertia, and drag acts on v only. Each contact is held in its mode. At
    ω = 0, the moduli are those of `elastic_moduli`. Without dashpots, grains move affinely at high frequencies.
    Rattlers are excluded.

    In runs of 20 disks whose cell was sheared back and forth by 1e-7, the storage and loss moduli of the elastic forces
    differed from this prediction by 2e-5 of the modulus (`tests/modes/test_complex_moduli.py`).

    Parameters
    ----------
    state : State, in equilibrium, in a fully periodic cell, without walls, rigid groups or springs
    frequency : ω, scalar or (F,), zero or positive [1/time]
    drag, spin_drag : ν of translations and of rotations, as in `run`; spin_drag defaults to drag [1/time]
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If the forces do not balance; if the state has walls, rigid groups, springs or open sides; if a frequency is
        negative, or that of a resonance without damping; at ω = 0 as in `elastic_moduli`.

    Source
    ------
    Lemaître & Maloney, doi:10.1007/s10955-005-9015-5, for the viscoelastic moduli of a damped packing.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.68, seed=1)
    >>> answer = complex_moduli(state, law, [0.1, 0.2], drag=0.5)
    >>> answer.tensor.shape, bool((answer.shear.imag > 0).all())
    ((2, 3, 3, 3, 3), True)
    """
    frequency = as_frequencies(frequency)
    check_cell(state, "complex moduli")
    state, stiff, free, grain, cell = with_free_cell(balanced(state, law).state, law)
    size = 32.0 * len(frequency) * len(cell) ** 2
    require_sizes([Size(f"{len(frequency)} frequencies take", size, "bytes", "use fewer of them")])
    damp = assembled(state, blocks_of(state, law, linearise(state, law))[1], free)
    inertia, rate = free.mass[grain], drag_rates(free.axis[grain], drag, spin_drag)
    scale, order = np.abs(stiff.data).max(), None
    answer = np.empty((2, len(frequency), len(cell), len(cell)), complex)
    for k, omega in enumerate(frequency):
        report("complex moduli", k / len(frequency), f"frequency {omega:.4g}")
        if omega == 0:
            still = elastic_moduli(state, law)
            answer[:, k] = np.reshape([still.tensor, still.affine], answer[:, k].shape)
            continue
        whole = sparse.csr_array(stiff + 1j * omega * damp)
        rows, columns = whole[cell], whole[grain][:, cell].toarray()
        own = sparse.diags_array(inertia * (1j * omega * rate - omega**2))
        matrix = sparse.csr_array(own - whole[grain][:, grain])
        if order is None:
            order = dissect(state, free, grain, matrix)
        motion = solve_directly(matrix, columns, order, omega, scale)
        affine = rows[:, cell].toarray()
        answer[:, k] = -(free.length**2) / volume(state) * np.array([affine + rows[:, grain] @ motion, affine])
    tensor, affine = answer.reshape(2, len(frequency), *(state.cell.dim,) * 4)
    return ComplexModuli(frequency, tensor, affine)
