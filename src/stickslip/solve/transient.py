"""Non-normal dynamics of a stable packing: transient growth of disturbances, and fluctuations under noise."""

from typing import Literal, NamedTuple

import numpy as np
import scipy  # scipy.optimize is imported on first use
from scipy.linalg import (
    LinAlgError,
    cholesky,
    eig,
    eigh,
    eigvals,
    null_space,
    solve_continuous_lyapunov,
    solve_triangular,
    svdvals,
)
from scipy.sparse.linalg import LinearOperator, svds

from ..core.arguments import NotNegative, Numbers, Positive, checked
from ..core.contacts.jacobian import contact_blocks
from ..core.laws.builtin import Law, damping_model
from ..core.progress import Report, Size, require_sizes, silent
from ..core.readable import readable
from ..core.state import State
from .freedom import ZERO_BELOW, Freedom, assembled, backbone, dynamical_matrix, translations
from .linear import suitable_threads
from .response import as_patterns, forced_motion
from .spectrum import REAL_BELOW

AT_MOST = 1_500  # number of coordinates for which eigenvectors and a few hundred singular values take minutes
NOTHING = 1e-9  # excess of the bound over 1 up to which no search is needed
COARSE = 1e-3  # relative residual of a singular vector; the singular value is accurate to about its square
SMALL = 150  # matrix size up to which LAPACK finds the largest singular value faster than Lanczos' method
UNCERTAIN = 1e10  # condition number of the modes beyond which round-off spoils the result
SYMMETRIC = 1e-13  # largest asymmetry of a symmetric matrix, over its largest entry
PAIRS = 8  # number of pairs of nearly coinciding modes whose beats are examined
PERIODS = 20  # number of periods of the slowest mode in the default window, unless a beat is longer
FINE = 24  # number of instants tried around each best one: between samples, then within a period on either side
COVARIANCES_UP_TO = 400  # number of coordinates; matrices of four times this size are diagonalised within a minute
CLOSE = 1e-6  # relative accuracy of the distance to instability


@readable
class TransientGrowth(NamedTuple):
    """Largest amplification found, its time and disturbance, and an upper bound."""

    amplitude: float  # largest ‖end‖/‖start‖ found; its square is the amplification of the energy
    time: float  # time of the largest amplification [time]
    bound: float  # upper bound of the amplitude at all times: condition number of the modes in this norm
    of_pair: float  # amplitude from the two most nearly coinciding modes alone; an estimate with dashpots
    pair: np.ndarray  # (2,) frequencies |Im s| of these modes, in opposite phase after π over their difference [1/time]
    times: np.ndarray  # (T,) times evaluated, sorted, from 0 to the end of the window [time]
    amplitudes: np.ndarray  # (T,) largest amplitude at each time
    start: np.ndarray  # (2, n) displacement and velocity of the disturbance that grows most, of unit norm
    end: np.ndarray  # (2, n) displacement and velocity of this disturbance at `time`
    norm: str  # "energy" or "displacement"
    free: Freedom  # coordinates of start and end, without rattlers

    @property
    def energy(self) -> float:
        """Largest amplification of the energy, or of the squared displacement."""
        return self.amplitude**2


class NoElasticEnergyError(ValueError):
    """The stiffness is not positive definite, so growth cannot be measured by the elastic energy."""


class _ModalMotion(NamedTuple):
    """(y, ẏ)(t) = Re X exp(st) W u from a start u, with norm |Re P exp(st) W u|; one s of each conjugate pair."""

    exponents: np.ndarray  # (k,)
    modes: np.ndarray  # (2n, k) X
    norms: np.ndarray  # (m, k) P
    parts: np.ndarray  # (k, m) W


@checked
def transient_growth(
    state: State,
    law: Law,
    *,
    norm: Literal["energy", "displacement"] = "energy",
    duration: float | None = None,
    samples: int = 100,
    report: Report = silent,
) -> TransientGrowth:
    """Largest transient growth sup_t ‖exp(Bt)‖ of the motion M q̈ = J q + C q̇ of a packing with a stable spectrum.

    Eigenvalues describe the long-time behaviour. J is not symmetric and its modes are not orthogonal, so a sum of modes
    may grow at first. Neither norm can grow if J is symmetric; all growth is due to the curl of friction.

    A run of 12 disks with a thirtieth of `stable_time_step` went from a small `start` to within 0.8 % of `end`; the
    difference is proportional to the square of the time step (`tests/modes/test_transient.py`).

    Parameters
    ----------
    norm : "energy": E = ½ q̇ᵀMq̇ + ½ qᵀKq, with K the symmetric part of −J, which must be positive definite; dE/dt is
        the power of the skew part minus the dissipation of dashpots. "displacement": |q|² = qᵀMq of a motion that
        starts at rest. (Without dashpots, initial velocities at the equilibrium positions grow by the same
        factor.)
    duration : window that is searched [time]; default: 20 periods of the slowest mode, or a whole beat of the two most
        nearly coinciding modes if that is longer. Without dashpots, the motion is quasi-periodic and approaches its
        supremum repeatedly, possibly only beyond this window: `amplitude` is the largest value found, and `bound` an
        upper bound
    samples : number of evenly spaced times, in addition to a third as many early times and the times at which nearly
        coinciding modes are in opposite phase
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If a mode grows exponentially; if there are floppy modes; if there are more than 1500 coordinates; if K is not
        positive definite and the norm is "energy"; if modes coincide to round-off.

    Source
    ------
    Schmid, doi:10.1146/annurev.fluid.38.050304.092139, for the largest growth and the condition number;
    Trefethen & Embree, Spectra and Pseudospectra (Princeton 2005), § 14, for the bounds.

    Examples
    --------
    A lattice without tangential forces has a symmetric J and does not amplify disturbances:

    >>> import numpy as np
    >>> import stickslip as ss
    >>> site = np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [1.5, 0.75**0.5]])
    >>> shifts = [[0, 0], [0, 3**0.5], [2, 0], [2, 3**0.5]]
    >>> place = np.concatenate([site + shift for shift in shifts])
    >>> law = ss.laws.linear(1.0, 0.5, 0.5)
    >>> state = ss.packings.from_arrays(
    ...     place, np.full(16, 0.5005), law, cell=[4, 2 * 3**0.5], dim=2
    ... )
    >>> found = transient_growth(state, law, samples=9)
    >>> round(found.amplitude, 6), round(found.bound, 6)
    (1.0, 1.0)
    """
    require_sizes([Size(f"samples = {samples} makes", samples, "samples", "use fewer")])
    free = backbone(state, law)
    if len(free) > AT_MOST:
        raise ValueError(f"transient growth needs all modes: use at most {AT_MOST} coordinates, got {len(free)}")
    basis, pull, drag = reduced_matrices(state, law, free)
    with suitable_threads(len(pull)):
        motion, root = _modal_motion(pull, drag, norm)
        bound = _amplitude_bound(motion)
        if bound > UNCERTAIN:
            raise ValueError(
                f"modes of this packing coincide to round-off (condition number {bound:.1g}): it is at the birth of a "
                f"complex pair, and its transient growth cannot be computed from modes"
            )
        pairs = _find_beats(motion, drag is None)
        if bound <= 1 + NOTHING:
            times, amplitudes = np.zeros(1), np.ones(1)
        else:
            times, amplitudes = _search_times(motion, pairs, duration, samples, report)
        best = int(np.argmax(amplitudes))
        amplitude, start = _optimal_start(motion, times[best])
        amplitudes[best] = amplitude
    lift = (basis / np.sqrt(free.mass)[:, None]).T
    n, end = len(pull), (motion.modes * np.exp(motion.exponents * times[best])) @ (motion.parts @ start)
    begin = (
        np.concatenate([start, 0 * start]) if root is None else np.append(solve_triangular(root, start[:n]), start[n:])
    )
    of_pair = pairs[0][0] if pairs else 1.0
    return TransientGrowth(
        amplitude, float(times[best]), max(bound, 1.0), of_pair, np.array(pairs[0][2:] if pairs else []), times,
        amplitudes, begin.reshape(2, n) @ lift, end.real.reshape(2, n) @ lift, norm, free,
    )  # fmt: skip


def _amplitude_bound(motion: _ModalMotion) -> float:
    """Bound ‖[Re P, Im P]‖ ‖[Re W; Im W]‖, since exp(st) only rotates and decays."""
    p, w = motion.norms, motion.parts
    return float(np.linalg.norm(np.hstack([p.real, p.imag]), 2) * np.linalg.norm(np.vstack([w.real, w.imag]), 2))


def reduced_matrices(state: State, law: Law, free: Freedom):
    """Orthonormal basis (n, r) of resisted motions without translations, and −A and the dashpots in this basis."""
    if not len(free):
        raise ValueError("the packing has only rattlers: vibrations need grains that support each other")
    matrix = dynamical_matrix(state, law, free)
    rigid, size = translations(matrix, free), np.abs(matrix).sum(axis=1)
    held = size > REAL_BELOW * size.max()  # rotations without friction are not resisted
    basis = np.eye(len(free))[:, held]
    if rigid.shape[1]:
        basis = basis @ null_space(rigid[held].T)
    pull = basis.T @ (matrix @ basis)
    if not damping_model(law):
        return basis, pull, None
    root = 1 / np.sqrt(free.mass)
    drag = root[:, None] * assembled(state, contact_blocks(state, law)[1], free).toarray() * root
    return basis, pull, basis.T @ drag @ basis


def _modal_motion(pull: np.ndarray, drag: np.ndarray | None, norm: str) -> tuple[_ModalMotion, np.ndarray | None]:
    """Modes of ÿ = −A y + D ẏ in a norm and, if the norm needs it, the Cholesky factor of the symmetric part of A."""
    n = len(pull)
    exponents, modes, inverse = _undamped_modes(pull) if drag is None else _damped_modes(pull, drag)
    if norm == "displacement":
        return _normalise_modes(exponents, modes, modes[:n], inverse[:, :n]), None
    try:
        root = cholesky((pull + pull.T) / 2)
    except LinAlgError:
        raise NoElasticEnergyError(
            "the symmetric part of the stiffness is not positive definite, so there is no elastic energy to measure "
            "growth: use norm='displacement'"
        ) from None
    norms = np.concatenate([root @ modes[:n], modes[n:]])
    first = solve_triangular(root, inverse[:, :n].T, trans="T").T
    return _normalise_modes(exponents, modes, norms, np.hstack([first, inverse[:, n:]])), root


def _undamped_modes(pull: np.ndarray):
    scale = np.abs(pull).max()
    if np.abs(pull - pull.T).max() <= SYMMETRIC * scale:
        values, vectors = eigh((pull + pull.T) / 2)
        inverse = vectors.T
    else:
        values, vectors = eig(pull)
        if (np.abs(values.imag) > REAL_BELOW * np.abs(values).max()).any():
            raise_unstable(float(np.abs(np.sqrt(values).imag).max()))
        order = np.argsort(values.real)
        values, vectors = values.real[order], vectors.real[:, order]
        inverse = _invert(vectors)
    if values[0] < -ZERO_BELOW * scale:
        raise_unstable(float(np.sqrt(-values[0])))
    if values[0] < ZERO_BELOW * scale:
        raise ValueError(
            "the packing has floppy modes, which move without limit: transient growth needs a rigid packing"
        )
    speed = np.sqrt(values)
    modes = np.concatenate([vectors + 0j, -1j * vectors * speed])
    return -1j * speed, modes, np.hstack([inverse + 0j, 1j * inverse / speed[:, None]])


def _damped_modes(pull: np.ndarray, drag: np.ndarray):
    n, unit = len(pull), np.sqrt(np.abs(pull).max())
    form = np.block([[np.zeros((n, n)), np.eye(n)], [-pull / unit**2, drag / unit]])  # both blocks are of order one
    values, vectors = eig(form)
    if values.real.max() > REAL_BELOW:
        raise_unstable(float(unit * values.real.max()))
    if np.abs(values).min() ** 2 < ZERO_BELOW:
        raise ValueError(
            "the packing has floppy modes, which move without limit: transient growth needs a rigid packing"
        )
    inverse = _invert(vectors)
    chosen = np.flatnonzero(values.imag <= 0)
    vectors, inverse = vectors[:, chosen], np.where(values[chosen].imag < 0, 2, 1)[:, None] * inverse[chosen]
    factor = np.repeat([1.0, unit], n)
    return unit * values[chosen], factor[:, None] * vectors, inverse / factor


def _invert(vectors: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        return np.full_like(vectors, UNCERTAIN)  # rejected by the resulting bound


def raise_unstable(rate: float) -> None:
    """Raise ValueError for a growing mode."""
    raise ValueError(f"the packing is unstable, with growth as exp({rate:.4g} t): a stable packing is needed")


def _normalise_modes(exponents, modes, norms, parts) -> _ModalMotion:
    """Scale modes to unit norm, which makes the bound nearly as small as scaling can make it."""
    size = np.linalg.norm(norms, axis=0)
    return _ModalMotion(exponents, modes / size, norms / size, parts * size[:, None])


def _find_beats(motion: _ModalMotion, undamped: bool) -> list[tuple[float, float, float, float]]:
    """(amplitude, time of opposite phase, two frequencies) of nearly coinciding modes, the largest first.

    A disturbance of two unit modes with cosine c is amplified by √((1 + c)/(1 − c)) when they are in opposite phase.
    """
    swings = np.flatnonzero(motion.exponents.imag != 0)
    s, p = motion.exponents[swings], motion.norms[:, swings]
    cosine = np.minimum(np.abs(p.conj().T @ p), 1 - 1e-15)
    speed = np.abs(s.imag)
    apart = np.abs(speed[:, None] - speed)
    apart[apart == 0] = np.inf
    time = np.pi / np.minimum(apart, np.finfo(float).max)
    decay = 0.0 if undamped else -(s.real[:, None] + s.real) / 2
    gain = np.triu(np.where(np.isfinite(apart), np.sqrt((1 + cosine) / (1 - cosine)), 0.0) * np.exp(-decay * time), 1)
    beats = []
    for flat in np.argsort(-gain, axis=None)[:PAIRS]:
        j, k = np.unravel_index(flat, gain.shape)
        if gain[j, k] > 1:
            beats.append((float(gain[j, k]), float(time[j, k]), float(speed[j]), float(speed[k])))
    return beats


def _search_times(motion: _ModalMotion, pairs, duration: float | None, samples: int, report):
    """Sorted times at which the amplitude was evaluated, and the amplitude at each."""
    slowest = np.abs(motion.exponents).min()
    if duration is None:
        duration = max([PERIODS * 2 * np.pi / slowest, *(2 * time for _, time, *_ in pairs[:1])])
    if not (np.isfinite(duration) and duration > 0 and samples >= 2):
        raise ValueError(f"duration must be positive and samples at least 2, got {duration} and {samples}")
    beats = [time for _, time, *_ in pairs if time <= duration]
    amplitude = _amplitude_function(motion)
    early = np.geomspace(0.1 / np.abs(motion.exponents).max(), duration, samples // 3)
    times = np.unique(np.concatenate([np.linspace(0.0, duration, samples), early[early < duration], beats]))
    amplitudes = np.empty(len(times))
    for k, t in enumerate(times):
        if k % 10 == 0:
            report("transient growth", 0.6 * k / len(times), f"{k} of {len(times)} times up to {duration:.4g}")
        amplitudes[k] = amplitude(t)
    # first the envelope, then the phase of the oscillation under it
    reaches = duration / (samples - 1), 2 * np.pi / (max(pairs[0][2:]) if pairs else slowest)
    starts = np.unique([*times[np.argsort(-amplitudes)[:2]], *beats[:1]])
    for k, t in enumerate(starts):
        report("transient growth", 0.6 + 0.4 * k / len(starts), f"×{amplitudes.max():.4g} so far")
        for reach in reaches:
            near = np.clip(t + np.linspace(-reach, reach, FINE), 0.0, duration)
            values = np.array([amplitude(t) for t in near])
            times, amplitudes, t = np.append(times, near), np.append(amplitudes, values), near[np.argmax(values)]
        step = 2 * reach / (FINE - 1)
        top = scipy.optimize.minimize_scalar(
            lambda t: -amplitude(t), bounds=(max(t - step, 0.0), min(t + step, duration)), method="bounded",
            options={"xatol": 1e-4 * step},
        )  # fmt: skip
        times, amplitudes = np.append(times, top.x), np.append(amplitudes, -top.fun)
    times, first = np.unique(times, return_index=True)
    return times, amplitudes[first]


def _amplitude_function(motion: _ModalMotion):
    """Return a function of t, the largest singular value of Re P exp(st) W."""
    if motion.norms.shape[0] <= SMALL:
        return lambda t: float(np.linalg.norm(_propagator(motion, t), 2))
    guess = [np.random.default_rng(0).normal(size=motion.norms.shape[0])]

    def amplitude(t: float) -> float:
        _, value, right = svds(_propagator_operator(motion, t), k=1, v0=guess[0], tol=COARSE, solver="arpack")
        guess[0] = right[0]
        return float(value[0])

    return amplitude


def _propagator(motion: _ModalMotion, t: float) -> np.ndarray:
    return ((motion.norms * np.exp(motion.exponents * t)) @ motion.parts).real


def _propagator_operator(motion: _ModalMotion, t: float) -> LinearOperator:
    turn, m = np.exp(motion.exponents * t), motion.norms.shape[0]
    return LinearOperator(
        (m, m), dtype=float,
        matvec=lambda u: (motion.norms @ (turn * (motion.parts @ u.ravel()))).real,
        rmatvec=lambda u: ((turn * (u.ravel() @ motion.norms)) @ motion.parts).real,
    )  # fmt: skip


def _optimal_start(motion: _ModalMotion, t: float) -> tuple[float, np.ndarray]:
    """Largest amplitude at t, and the unit initial vector (m,) that reaches it."""
    if motion.norms.shape[0] <= SMALL:
        _, values, starts = np.linalg.svd(_propagator(motion, t))
    else:
        guess = np.random.default_rng(0).normal(size=motion.norms.shape[0])
        _, values, starts = svds(_propagator_operator(motion, t), k=1, v0=guess, solver="arpack")
    return float(values[0]), starts[0]


@readable
class Fluctuations(NamedTuple):
    """Stationary covariances under noise, and three measures of its amplification."""

    displacement: np.ndarray  # (n, n) ⟨q qᵀ⟩ in the coordinates `free`, without common translations [length²]
    velocity: np.ndarray  # (n, n) ⟨q̇ q̇ᵀ⟩, likewise without common translations [length²/time²]
    kinetic: (
        float  # ½⟨q̇ᵀ M q̇⟩ over the number of modes [energy]; T/2 where forces have a potential and noise is thermal
    )
    elastic: float  # ½⟨qᵀ K q⟩ over the number of modes, K the symmetric part of −J [energy]
    decay: float  # rate of the slowest decay: distance of the spectrum from the imaginary axis [1/time]
    distance: float  # spectral norm of the smallest change of the dynamics that makes a mode grow [1/time]
    condition: float  # condition number of the modes; 1 if they are orthogonal in the energy norm
    free: Freedom

    @property
    def non_normality(self) -> float:
        """decay/distance: the factor by which the spectrum overestimates the distance; 1 if modes are orthogonal."""
        return self.decay / self.distance


@checked
def stationary_fluctuations(
    state: State, law: Law, *, temperature: Positive = 1.0, noise: Numbers | None = None,
    drag: NotNegative = 0.0, spin_drag: NotNegative | None = None,
) -> Fluctuations:  # fmt: skip
    """Stationary covariance Σ, L Σ + Σ Lᵀ + Q = 0, of M q̈ = J q + C q̇ − M ν q̇ + ξ, and distance to instability.

    Thermal noise has ⟨ξ ξᵀ⟩ = 2T (M ν − C) δ(t − t′), so every mode would have a kinetic and an elastic energy of
    T/2 each if forces had a potential. Frictional forces have none, and heat or cool modes. Distance and condition
    number are defined in the norm of the elastic and kinetic energy, in which symmetric undamped motion is a rotation.

    Unresisted common translations (the centre of mass in a periodic cell) and unresisted coordinates are removed from
    motion and noise; each translation adds T/(Σm) to the mean-square velocities of a run. The number of modes is that
    of the remaining coordinates.

    In runs of 2000 decay times under noise on one grain, the variance of its displacement was 2 to 5 % below the value
    computed here, with a statistical error of 3 % (`tests/modes/test_response.py`).

    Parameters
    ----------
    temperature : T of thermal noise [energy]
    noise : (k, N + W, 6) forces and torques/R that are multiplied by k independent white noises of unit spectral
        density, instead of thermal noise [force √time]
    drag, spin_drag : ν of translations and of rotations, as in `run` [1/time]

    Raises
    ------
    ValueError
        If a mode is undamped or grows; if there are more than 400 coordinates; if the forces do not balance;
        if the symmetric part of the stiffness is not positive definite.

    Source
    ------
    Troude & Sornette, doi:10.48550/arXiv.2506.01996, for distance and condition number as the two parameters of
    amplification; Byers, doi:10.1137/0909059, and Boyd & Balakrishnan, doi:10.1016/0167-6911(90)90037-U, for the
    distance.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.68, seed=1)
    >>> noisy = stationary_fluctuations(state, law, temperature=1e-9, drag=0.1)
    >>> bool(noisy.distance <= noisy.decay)
    True
    """
    motion = forced_motion(state, law, drag, spin_drag)
    free = motion.free
    if len(free) > COVARIANCES_UP_TO:
        raise ValueError(f"covariances support at most {COVARIANCES_UP_TO} coordinates, got {len(free)}")
    basis, pull, _ = reduced_matrices(motion.here.state, law, free)
    drags = basis.T @ (motion.drag @ basis)
    force = temperature * (drags + drags.T)
    if noise is not None:
        kicks = basis.T @ motion.drives(as_patterns(state, noise=noise), "noise")[0]
        force = kicks @ kicks.T
    n, root = len(pull), 1 / np.sqrt(free.mass)
    with suitable_threads(2 * n):
        dynamics, lift = energy_dynamics(pull, drags)
        values, vectors = eig(dynamics)
        rate, scale = float(values.real.max()), float(np.abs(values).max())
        if rate > REAL_BELOW * scale:
            raise_unstable(rate)
        if rate > -REAL_BELOW * scale:
            raise ValueError("an undamped mode is heated by noise without limit: give drag and spin_drag")
        inner = np.zeros((2 * n, 2 * n))
        inner[n:, n:] = force
        covariance = solve_continuous_lyapunov(dynamics, -inner)
        distance, condition = distance_to_instability(dynamics), float(np.linalg.cond(vectors))
    wide = root[:, None] * (basis @ lift), root[:, None] * basis
    parts = covariance[:n, :n], covariance[n:, n:]
    cov = [side @ part @ side.T for side, part in zip(wide, parts, strict=True)]
    energy = [0.5 * float(np.trace(part)) / n for part in parts]
    return Fluctuations(*cov, energy[1], energy[0], -rate, distance, condition, free)


def energy_dynamics(pull: np.ndarray, drag: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrix L of ż = L z for z = (R y, ẏ), where |z|² is twice the energy, and R⁻¹; RᵀR is the symmetric part of A."""
    n = len(pull)
    try:
        root = cholesky((pull + pull.T) / 2)
    except np.linalg.LinAlgError:
        raise ValueError(
            "the symmetric part of the stiffness is not positive definite: fluctuations need a packing that resists "
            "every motion"
        ) from None
    inverse = solve_triangular(root, np.eye(n))
    return np.block([[np.zeros((n, n)), root], [-pull @ inverse, -drag]]), inverse


def distance_to_instability(dynamics: np.ndarray) -> float:
    """Smallest spectral norm of a perturbation that moves an eigenvalue of a stable matrix L to the imaginary axis.

    It is the minimum over ω of the smallest singular value of L − iω. A value β is reached at those ω for which iω is
    an eigenvalue of a Hamiltonian matrix; between them the singular value is smaller, which gives the next β.
    """
    one, values = np.eye(len(dynamics)), eigvals(dynamics)
    trials = np.append(np.abs(values.imag[np.argsort(-values.real)[:4]]), 0.0)
    best = np.inf
    while len(trials):
        lowest = min(svdvals(dynamics - 1j * w * one)[-1] for w in trials)
        if lowest >= best * (1 - CLOSE):
            return float(min(best, lowest))
        best = lowest
        beta = best * (1 - CLOSE)
        crossing = eigvals(np.block([[dynamics, -beta * one], [beta * one, -dynamics.T]]))
        scale = np.abs(crossing).max()
        levels = np.unique(np.abs(crossing.imag[np.abs(crossing.real) <= 1e-8 * scale]))
        trials = (levels[1:] + levels[:-1]) / 2
    return float(best)
