"""Waves of a packing in a periodic cell: dispersion, damping and structure factor of P, S and rotational waves.

Plane waves are unit vectors of the mass-weighted coordinates: displacements along k (P) and across k (S), and rotations
(R; in three dimensions, first about k, then about the axes across k).
"""

from typing import Annotated, NamedTuple

import numpy as np
import scipy  # scipy.optimize is imported on first use, as this takes a tenth of a second
from scipy import sparse
from scipy.linalg import eig

from ..core.arguments import POSITIVE, NotNegative, Numbers, checked, require_not_negative
from ..core.laws.builtin import Law
from ..core.measure import volume
from ..core.progress import Report, Size, require_sizes, silent
from ..core.readable import readable
from ..core.state import State
from .freedom import Freedom
from .linear import factorised, suitable_threads
from .moduli import check_cell, elastic_moduli
from .response import ALLOWED, ForcedMotion, forced_motion, in_plane, require_allowed, require_direction
from .spectrum import REAL_BELOW
from .transient import reduced_matrices

ALL_UP_TO = 2_000  # number of coordinates up to which all modes are computed within minutes
NAMES = {2: ("P", "S", "R"), 3: ("P", "S", "S", "R", "R", "R")}


@readable
class Dispersion(NamedTuple):
    """Branches of waves, exp(st + ik·r), in the order of `names`; of two shear waves, the faster one comes first."""

    wavevector: np.ndarray  # (K, dim) k [1/length]
    exponent: np.ndarray  # (K, p) complex s = −damping ± iω; p = 3 in two dimensions, 6 in three [1/time]
    polarisation: np.ndarray  # (K, p, p) shares of the plane waves P, S, …, R in each branch; each row adds up to 1
    scattered: (
        np.ndarray
    )  # (K,) fraction of the forces of plane waves that drive other motions; 0 in a lattice, where results are exact

    @property
    def names(self) -> tuple[str, ...]:
        """P, S or R for each branch: the plane wave to which its polarisation is assigned."""
        return NAMES[self.wavevector.shape[1]]

    @property
    def frequency(self) -> np.ndarray:
        """(K, p) ω [1/time]."""
        return np.abs(self.exponent.imag)

    @property
    def damping(self) -> np.ndarray:
        """(K, p) decay rate −Re s of amplitudes [1/time]; negative if a wave grows."""
        return -self.exponent.real

    @property
    def speed(self) -> np.ndarray:
        """(K, p) phase speed ω/|k| [length/time]."""
        return self.frequency / np.linalg.norm(self.wavevector, axis=1)[:, None]


@readable
class WaveSpectrum(NamedTuple):
    """Spectrum of a packing, projected onto plane waves: ⟨w, v(t)⟩ = Σ_j weight_j exp(s_j t) after v(0) = w."""

    wavevector: np.ndarray  # (K, dim) k [1/length]
    exponent: np.ndarray  # (M,) complex s of all modes except translations [1/time]
    weight: np.ndarray  # (K, p, M) complex weights for P, S, …, R; their sum is one minus the share of translations
    pair: np.ndarray  # (M,) True for modes of complex pairs, by Im s² if undamped, and otherwise by their growth

    def structure_factor(self, frequency: Numbers, width: float = 0.0) -> np.ndarray:
        """(K, p, F) S(k, ω) = (1/π) Re ∫ ⟨w, v(t)⟩ exp(−iωt − width·t) dt over t > 0; its integral over all ω is one.

        Parameters
        ----------
        frequency : (F,) ω [1/time]
        width : rate that widens each peak [1/time]; without damping, peaks are infinitely sharp, and a width is needed
        """
        require_not_negative(width=width)
        decay = width - self.exponent.real
        if not decay.min() > 0:
            raise ValueError(f"width = {width:g} is too small for a mode that does not decay: use a larger one")
        distance = decay + 1j * (np.atleast_1d(frequency)[:, None] - self.exponent.imag)
        return (self.weight @ (1 / distance).T).real / np.pi


@checked
def allowed_wavevectors(state: State, count: Annotated[int, POSITIVE] = 12) -> np.ndarray:
    """(count, dim) shortest wave vectors k with k·a = 2π × integer for all vectors a of the cell, one of each ±k.

    Raises
    ------
    ValueError
        If the cell is not periodic in all its dimensions.
    """
    check_cell(state, "waves")
    dim = state.cell.dim
    require_sizes([Size("these are", count, "wave vectors", "use fewer")])
    cell = state.cell.vectors[:dim, :dim]
    base = 2 * np.pi * np.linalg.inv(cell)
    sizes, side = np.linalg.norm(base, axis=0), np.ceil(((2 * count + 1) ** (1 / dim) - 1) / 2)
    far = min(count * sizes.min(), side * sizes.sum())  # no wanted vector is longer
    most = np.floor(far * np.linalg.norm(cell, axis=1) / (2 * np.pi) + ALLOWED)
    whole = np.stack(np.meshgrid(*[np.arange(-m, m + 1) for m in most], indexing="ij"), axis=-1).reshape(-1, dim)
    whole = whole[len(whole) // 2 + 1 :]  # vectors before the middle are the negatives of these
    k = whole @ base.T
    return k[np.argsort(np.round(np.linalg.norm(k, axis=1), 9), kind="stable")[:count]]


@checked
def dispersion(
    state: State, law: Law, wavevector: Numbers | None = None, *, drag: NotNegative = 0.0,
    spin_drag: NotNegative | None = None,
    report: Report = silent,
) -> Dispersion:  # fmt: skip
    """Dispersion relation of P, S and rotational waves, with the damping by drag, dashpots, friction and disorder.

    For each k, χ(s) = W†(A + sD + s²)⁻¹W of the p plane waves W is replaced by the response of p coupled damped
    oscillators, (m s² + Γ s + K)⁻¹, with the same value and first two derivatives at s₀. For P and S, s₀ is √Re⟨P|A|P⟩;
    for R, it is √Re⟨R|A|R⟩ of the first R, or the s₀ of P if ⟨R|A|R⟩ is not positive, or √max|A| if neither is. The
    branches are poles of this response, chosen among the p poles with the largest Im s: with the first s₀, the poles
    whose vectors have the largest shares in P and S, and with the second, those with the largest shares in R.

    A = −M^(−1/2) J M^(−1/2) and D = ν − M^(−1/2) C M^(−1/2), in the coordinates of `backbone`. The column of P in W is
    √m k̂ exp(ik·r), normalised; the column of S has a unit vector across k in place of k̂, and that of R is √I e
    exp(ik·r), where I is the moment of inertia. Common translations are not removed from W or A.

    In a lattice with one grain per cell, the plane waves are invariant under A and D, and the poles are exact. In a
    disordered packing, a wave is a group of modes, and the poles give the frequency and decay of the group: s₀ is so
    far from the modes that single modes do not matter. Each k takes two sparse factorisations. In 300 disks, the
    structure factor of all modes peaked within 2 % of P and S, and within 8 % of R (`tests/modes/test_waves.py`).

    Parameters
    ----------
    wavevector : (K, dim) k, allowed by the cell; default: the twelve shortest of `allowed_wavevectors` [1/length]
    drag, spin_drag : ν of translations and of rotations, as in `run`; spin_drag defaults to drag [1/time]
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If the cell is not periodic, the forces do not balance, or the cell does not allow a wave vector.

    Source
    ------
    Schwartz, Johnson & Feng, doi:10.1103/PhysRevLett.52.831, for waves with rotations of grains; Gelin, Tanaka &
    Lemaître, doi:10.1038/nmat4736, for ⟨w, v(t)⟩ of disordered solids.

    Examples
    --------
    Disks on a square lattice, waves along a row: ω² = (4k_n/m) sin²(k/2) for P, with four grains per wavelength.

    >>> import numpy as np
    >>> import stickslip as ss
    >>> law = ss.laws.linear(1.0, 0.5, 0.5)
    >>> place = np.argwhere(np.ones((4, 4)))
    >>> state = ss.packings.from_arrays(
    ...     place, np.full(16, 0.5 + 1e-9), law, cell=[4, 4], dim=2
    ... )
    >>> waves = dispersion(state, law, [[np.pi / 2, 0]])
    >>> round(float(waves.frequency[0, 0]) ** 2 * state.grains.mass.item(0), 6)
    2.0
    """
    motion, k = _waves_of(state, law, wavevector, drag, spin_drag)
    transposed = sparse.csr_array(motion.pull.T)
    exponents, shares, scattered = [], [], []
    for row, vector in enumerate(k):
        report("dispersion", row / len(k), f"wave vector {row + 1} of {len(k)}")
        waves = _plane_waves(motion.here.state, motion.free, vector)
        pulled = motion.pull @ waves
        left = pulled - waves @ (waves.conj().T @ pulled)
        scattered.append(np.linalg.norm(left) / np.linalg.norm(pulled))
        s, weight = _branches(motion, waves, transposed)
        exponents.append(s)
        shares.append(weight)
    return Dispersion(k, np.array(exponents), np.array(shares), np.array(scattered))


@checked
def wave_spectrum(
    state: State, law: Law, wavevector: Numbers | None = None, *, drag: NotNegative = 0.0,
    spin_drag: NotNegative | None = None,
) -> WaveSpectrum:  # fmt: skip
    """Project all modes, damped by drag and dashpots, onto plane waves: dynamical structure factor and complex pairs.

    Waves W and matrices are those of `dispersion`, without common translations: A, D and W are restricted to the space
    orthogonal to √m in each direction. weight_j = w†r_j l_j†w, with the velocity part r_j of mode j and its dual l_j.

    The dense solution supports at most 2000 coordinates. For larger packings, `dispersion` needs no modes, and
    `frequency_response` with `plane_wave` as drive and observable gives χ(iω). Then S = −(ω/π) Im χ, if the common
    translation is first removed from the waves: drive − m Σ drive/Σ m, with sums over all grains but rattlers.

    Parameters
    ----------
    wavevector, drag, spin_drag : as in `dispersion`

    Raises
    ------
    ValueError
        As in `dispersion`, and beyond 2000 coordinates.
    """
    motion, k = _waves_of(state, law, wavevector, drag, spin_drag)
    if (n := len(motion.free)) > ALL_UP_TO:
        raise ValueError(f"computing all modes is limited to {ALL_UP_TO} coordinates, got {n}: use `dispersion`")
    basis = reduced_matrices(motion.here.state, law, motion.free)[0]
    size = 32.0 * n * len(k) * 3 * (state.cell.dim - 1)
    require_sizes([Size(f"{len(k)} wave vectors of {n} coordinates take", size, "bytes", "use fewer of them")])
    s, right, left = _all_modes(basis.T @ motion.pull @ basis, basis.T @ motion.drag @ basis)
    weight = []
    for vector in k:
        waves = basis.T @ _plane_waves(motion.here.state, motion.free, vector)
        weight.append((waves.conj().T @ right) * (left @ waves).T)
    floor = REAL_BELOW * np.abs(s).max()
    pair = s.real > floor if motion.drag.nnz else np.abs((s**2).imag) > floor * np.abs(s).max()
    return WaveSpectrum(k, s, np.array(weight), pair)


@checked
def elastic_speeds(state: State, law: Law, direction: Numbers) -> np.ndarray:
    """(K, dim) speeds of long waves from the moduli, fastest first: ρc² u_a = C_abcd n_b n_d u_c (Christoffel).

    ρ is the mass of all grains but rattlers, divided by the volume. A uniform stress drops out of the equation if C is
    the response of the Cauchy stress, as here. Speeds are NaN where a wave is unstable.

    In 300 disks, the speeds from `dispersion` were 2 % lower at a wavelength of 18 diameters, and 6 to 9 % lower at 6
    diameters (`tests/modes/test_waves.py`).

    Parameters
    ----------
    direction : (K, dim) vectors of any nonzero length, such as wave vectors
    """
    free, n = elastic_moduli(state, law), in_plane(state, direction=direction)
    require_direction(direction=n)
    n = n / np.linalg.norm(n, axis=1)[:, None]
    density = free.free.mass[free.free.axis == 0].sum() / volume(state)
    square = np.linalg.eigvals(np.einsum("kb,abcd,kd->kac", n, free.tensor, n)).real / density
    return np.sqrt(np.where(square >= 0, square, np.nan))[np.arange(len(n))[:, None], np.argsort(-square, axis=1)]


def _waves_of(state: State, law: Law, wavevector, drag, spin_drag) -> tuple[ForcedMotion, np.ndarray]:
    """Linearised motion in a cell at rest, and the wave vectors (K, dim)."""
    check_cell(state, "waves")
    k = allowed_wavevectors(state) if wavevector is None else in_plane(state, wavevector=wavevector)
    require_allowed(state, k)
    require_direction(wavevector=k)
    control = state.control._replace(cell_free=np.zeros((3, 3), bool))
    return forced_motion(state._replace(control=control), law, drag, spin_drag), k


def _plane_waves(state: State, free: Freedom, k: np.ndarray) -> np.ndarray:
    """(n, p) complex unit vectors of mass-weighted plane waves."""
    dim, axis = len(k), free.axis
    along = k / np.linalg.norm(k)
    if dim == 2:
        frame = np.array([[along[0], along[1], 0.0], [-along[1], along[0], 0.0]])
        turns = np.array([[0.0, 0.0, 1.0]])
    else:
        across = np.eye(3)[np.argmin(np.abs(along))]
        across = np.cross(along, across) / np.linalg.norm(np.cross(along, across))
        frame = turns = np.array([along, across, np.cross(along, across)])
    radius = np.where(axis < 3, 1.0, state.grains.radius[free.body])
    field = np.where(axis < 3, frame[:, axis % 3], 0.0), np.where(axis < 3, 0.0, turns[:, axis % 3])
    phase = np.exp(1j * (state.grains.position[free.body, :dim] @ k))
    out = (np.concatenate(field) * radius * np.sqrt(free.mass) * phase).T
    return out / np.linalg.norm(out, axis=0)


def _branches(motion: ForcedMotion, waves: np.ndarray, transposed) -> tuple[np.ndarray, np.ndarray]:
    """Exponents (p,) of the branches P to R and their polarisation (p, p): P and S expanded near P, R near R."""
    dim, p = motion.free.dim, waves.shape[1]
    exponents, shares = np.zeros(p, complex), np.zeros((p, p))
    square = [(wave.conj() @ ((motion.pull + transposed) @ wave)).real / 2 for wave in waves[:, [0, dim]].T]
    scale, most = np.sqrt(np.maximum(square, 0.0)), np.sqrt(np.abs(motion.pull.data).max())
    scale[0] = scale[0] if scale[0] > REAL_BELOW * most else most
    for at, part in zip(scale, (slice(0, dim), slice(dim, p)), strict=True):
        s, vectors = _poles(*_oscillators(motion, waves, at if at > REAL_BELOW * scale[0] else scale[0]))
        weight = np.abs(vectors) ** 2 / (np.abs(vectors) ** 2).sum(axis=0)
        order = scipy.optimize.linear_sum_assignment(-weight)[1]
        across = slice(1, dim)
        order[across] = order[across][np.argsort(-s[order[across]].imag, kind="stable")]
        exponents[part], shares[part] = s[order[part]], weight[:, order[part]].T
    return exponents, shares


def _oscillators(motion: ForcedMotion, waves: np.ndarray, s: float):
    """m, Γ and K, (p, p), for which m s² + Γ s + K has the value and first two derivatives of χ⁻¹ at s."""
    solve = _solver(motion, s)
    slope = motion.drag + 2 * s * sparse.eye_array(len(waves))
    once = solve(waves)
    moved = slope @ once
    twice = solve(moved)
    values = once, -twice, 2 * solve(slope @ twice) - 2 * solve(once)
    value, first, second = (waves.conj().T @ part for part in values)
    inverse = np.linalg.inv(value)
    z1 = -inverse @ first @ inverse
    mass = (2 * inverse @ first @ inverse @ first @ inverse - inverse @ second @ inverse) / 2
    drag = z1 - 2 * s * mass
    return mass, drag, inverse - s * drag - s**2 * mass


def _solver(motion: ForcedMotion, s: float):
    """Function that solves (A + sD + s²) x = b for complex b (n, p)."""
    shift = s**2 * sparse.eye_array(len(motion.free))
    solve = factorised(sparse.csr_array(motion.pull + s * motion.drag + shift))

    def solve_complex(b):
        parts = solve(np.hstack([b.real, b.imag]))
        return parts[:, : b.shape[1]] + 1j * parts[:, b.shape[1] :]

    return solve_complex


def _poles(mass: np.ndarray, drag: np.ndarray, stiff: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The p roots s with the largest Im s (of overdamped ones, the slowest), and their vectors (p, p)."""
    p, unit = len(mass), np.sqrt(np.abs(stiff).max() / np.abs(mass).max()) or 1.0
    m = mass * unit**2
    lower = np.hstack([-np.linalg.solve(m, stiff), -np.linalg.solve(m, drag * unit)])
    s, vectors = eig(np.vstack([np.eye(p, 2 * p, p), lower]))
    order = np.lexsort((np.abs(s), np.where(s.imag > REAL_BELOW, -1, np.where(s.imag < -REAL_BELOW, 1, 0))))[:p]
    return unit * s[order], vectors[:p, order]


def _all_modes(pull: np.ndarray, drag: np.ndarray):
    """Exponents s (M,), velocity parts of their modes (r, M), and left modes (M, r) for an initial velocity."""
    n, unit = len(pull), np.sqrt(np.abs(pull).max())
    with suitable_threads(2 * n):
        if not drag.any():
            values, right = eig(pull)
            s, left = np.sqrt(-values + 0j), np.linalg.inv(right)
            return np.append(s, -s), np.hstack([right, right]), np.vstack([left, left]) / 2
        form = np.block([[np.zeros((n, n)), np.eye(n)], [-pull / unit**2, -drag / unit]])
        values, right = eig(form)
        return unit * values, right[n:], np.linalg.inv(right)[:, n:]
