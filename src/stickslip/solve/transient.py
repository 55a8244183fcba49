"""How much a stable packing amplifies a disturbance before it does not: transient growth of a non-normal motion."""

from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, eig, eigh, null_space, solve_triangular
from scipy.optimize import minimize_scalar
from scipy.sparse.linalg import LinearOperator, svds

from ..core.contacts.jacobian import contact_blocks
from ..core.laws.builtin import Law, dashpots
from ..core.readable import readable
from ..core.state import State
from .freedom import ZERO_BELOW, Freedom, assembled, backbone, dynamical_matrix, translations
from .linear import DENSE_BELOW, one_thread
from .spectrum import REAL_BELOW

AT_MOST = 1_500  # coordinates: eigenvectors, and some hundred largest singular values, within minutes
NOTHING = 1e-9  # beyond 1, up to which a bound leaves nothing to look for
COARSE = 1e-3  # relative residual of a singular vector; its value is then good to about the square of that
SMALL = 150  # size up to which LAPACK finds a largest singular value sooner than Lanczos' method
UNCERTAIN = 1e10  # condition number of the modes beyond which their round-off spoils what is made of them
SYMMETRIC = 1e-13  # of the largest entry
PAIRS = 8  # of modes, those that nearly coincide, at whose beats is looked
PERIODS = 20  # of the slowest mode: the window where no beat is longer
FINE = 24  # times around each of the best ones, first between samples, then within a period on either side


@readable
class TransientGrowth(NamedTuple):
    """The largest amplification that was found, when, of what, and what none exceeds."""

    amplitude: float  # largest ‖end‖/‖start‖ found; its square is that of the energy
    time: float  # when [time]
    bound: float  # of the amplitude at all times: condition number of the modes in this norm
    of_pair: float  # that two modes alone reach, those which nearly coincide most; with dashpots an estimate
    pair: np.ndarray  # (2,) their frequencies |Im s| [1/time]; they are in opposite phase at π over the difference
    times: np.ndarray  # (T,) that were looked at, sorted, from 0 to the end of the window [time]
    amplitudes: np.ndarray  # (T,)
    start: np.ndarray  # (2, n) the disturbance that grows most: displacement and velocity, of unit norm
    end: np.ndarray  # (2, n) what becomes of it: displacement and velocity at `time`
    norm: str  # "energy" or "displacement"
    free: Freedom  # coordinates of start and end; rattlers are left out

    @property
    def energy(self) -> float:
        """Largest amplification of the energy, or of the square of displacements."""
        return self.amplitude**2


class _ModalMotion(NamedTuple):
    """(y, ẏ)(t) = Re X exp(st) W u of a start u, and its norm |Re P exp(st) W u|; one of each conjugate pair of s."""

    exponents: np.ndarray  # (k,)
    modes: np.ndarray  # (2n, k) X
    norms: np.ndarray  # (m, k) P
    parts: np.ndarray  # (k, m) W


def transient_growth(
    state: State, law: Law, *, norm: str = "energy", duration: float | None = None, samples: int = 100, report=None
) -> TransientGrowth:
    """sup_t ‖exp(Bt)‖ of the linearised motion M q̈ = J q + C q̇ of a packing whose spectrum is stable.

    Eigenvalues say what remains; J is not symmetric, its modes are not orthogonal, and their sum may grow before. Both
    norms never grow where J is symmetric, so that all growth is the work of the curl of friction.

    Parameters
    ----------
    norm : "energy": E = ½ q̇ᵀMq̇ + ½ qᵀKq, K the symmetric part of −J, which must be positive: dE/dt is the power of
        the skew part, less what dashpots take. "displacement": |q|² = qᵀMq of what starts at rest. (Without dashpots
        velocities that start from the equilibrium's positions grow by the same factor.)
    duration : window that is searched [time]; default: 20 periods of the slowest mode, or if that is longer a whole
        beat of the two modes that nearly coincide most. Without dashpots the motion is quasi-periodic and comes near
        its supremum again and again, which may take longer: `amplitude` is what was found, `bound` what none exceeds
    samples : times looked at, evenly spaced, besides a third as many early ones and those at which nearly coinciding
        modes are in opposite phase
    report : called as report(stage, share done, words)

    Raises
    ------
    ValueError
        if something grows exponentially; if floppy modes are left; if there are more than 1500 coordinates; if K is not
        positive and the norm is "energy"; if modes coincide to round-off.

    Source
    ------
    Schmid, doi:10.1146/annurev.fluid.38.050304.092139, for the largest growth and the condition number;
    Trefethen & Embree, Spectra and Pseudospectra (Princeton 2005), § 14, for the bounds.

    Examples
    --------
    A lattice without tangential forces has a symmetric J, and amplifies nothing:

    >>> import numpy as np
    >>> import stickslip as ss
    >>> site = np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [1.5, 0.75**0.5]])
    >>> place = np.concatenate([site, site + [0, 3**0.5], site + [2, 0], site + [2, 3**0.5]])
    >>> law = ss.laws.linear(1.0, 0.5, 0.5)
    >>> state = ss.packings.from_arrays(place, np.full(16, 0.5005), law, cell=[4, 2 * 3**0.5], dim=2)
    >>> found = transient_growth(state, law, samples=9)
    >>> round(found.amplitude, 6), round(found.bound, 6)
    (1.0, 1.0)
    """
    if norm not in ("energy", "displacement"):
        raise ValueError(f"norm {norm!r} was given: use energy or displacement")
    free = backbone(state, law)
    if len(free) > AT_MOST:
        raise ValueError(f"{len(free)} coordinates were given: transient growth takes at most {AT_MOST}, all its modes")
    basis, pull, drag = _reduced_matrices(state, law, free)
    with one_thread() if len(pull) < DENSE_BELOW else nullcontext():
        motion, root = _modal_motion(pull, drag, norm)
        bound = _amplitude_bound(motion)
        if bound > UNCERTAIN:
            raise ValueError(
                f"modes of this packing coincide to round-off (condition number {bound:.1g}): it is at the birth of a "
                f"complex pair, and its transient growth can't be told from modes"
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
        np.concatenate([start, 0 * start]) if root is None else np.append(_from_energy_norm(root, start[:n]), start[n:])
    )
    of_pair = pairs[0][0] if pairs else 1.0
    return TransientGrowth(
        amplitude, float(times[best]), max(bound, 1.0), of_pair, np.array(pairs[0][2:] if pairs else []), times,
        amplitudes, begin.reshape(2, n) @ lift, end.real.reshape(2, n) @ lift, norm, free,
    )  # fmt: skip


def _amplitude_bound(motion: _ModalMotion) -> float:
    """‖[Re P, Im P]‖ ‖[Re W; Im W]‖: what is between them turns and decays."""
    p, w = motion.norms, motion.parts
    return float(np.linalg.norm(np.hstack([p.real, p.imag]), 2) * np.linalg.norm(np.vstack([w.real, w.imag]), 2))


def _from_energy_norm(root: np.ndarray, u: np.ndarray) -> np.ndarray:
    return solve_triangular(root, u)


def _reduced_matrices(state: State, law: Law, free: Freedom):
    """Orthonormal basis (n, r) of what is held, and −A and the dashpots in it; translations are left out."""
    if not len(free):
        raise ValueError("nothing but rattlers was given: transient growth needs grains that hold each other")
    matrix = dynamical_matrix(state, law, free)
    rigid, size = translations(matrix, free), np.abs(matrix).sum(axis=1)
    held = size > REAL_BELOW * size.max()  # rotations without friction are not
    basis = np.eye(len(free))[:, held]
    if rigid.shape[1]:
        basis = basis @ null_space(rigid[held].T)
    pull = basis.T @ (matrix @ basis)
    if not dashpots(law):
        return basis, pull, None
    root = 1 / np.sqrt(free.mass)
    drag = root[:, None] * assembled(state, contact_blocks(state, law)[1], free).toarray() * root
    return basis, pull, basis.T @ drag @ basis


def _modal_motion(pull: np.ndarray, drag: np.ndarray | None, norm: str) -> tuple[_ModalMotion, np.ndarray | None]:
    """Modes of ÿ = −A y + D ẏ in the norm, and the Cholesky factor of the symmetric part of A if it is needed."""
    n = len(pull)
    exponents, modes, inverse = _undamped_modes(pull) if drag is None else _damped_modes(pull, drag)
    if norm == "displacement":
        return _normalise_modes(exponents, modes, modes[:n], inverse[:, :n]), None
    try:
        root = cholesky((pull + pull.T) / 2)
    except LinAlgError:
        raise ValueError(
            "the symmetric part of the stiffness is not positive, so that no elastic energy can measure growth: take "
            "norm='displacement'"
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
            _raise_unstable(float(np.abs(np.sqrt(values).imag).max()))
        order = np.argsort(values.real)
        values, vectors = values.real[order], vectors.real[:, order]
        inverse = _invert(vectors)
    if values[0] < -ZERO_BELOW * scale:
        _raise_unstable(float(np.sqrt(-values[0])))
    if values[0] < ZERO_BELOW * scale:
        raise ValueError("a packing with floppy modes was given: what nothing resists moves ever further")
    speed = np.sqrt(values)
    modes = np.concatenate([vectors + 0j, -1j * vectors * speed])
    return -1j * speed, modes, np.hstack([inverse + 0j, 1j * inverse / speed[:, None]])


def _damped_modes(pull: np.ndarray, drag: np.ndarray):
    n, unit = len(pull), np.sqrt(np.abs(pull).max())
    form = np.block([[np.zeros((n, n)), np.eye(n)], [-pull / unit**2, drag / unit]])  # both of order one
    values, vectors = eig(form)
    if values.real.max() > REAL_BELOW:
        _raise_unstable(float(unit * values.real.max()))
    if np.abs(values).min() ** 2 < ZERO_BELOW:
        raise ValueError("a packing with floppy modes was given: what nothing resists moves ever further")
    inverse = _invert(vectors)
    chosen = np.flatnonzero(values.imag <= 0)
    vectors, inverse = vectors[:, chosen], np.where(values[chosen].imag < 0, 2, 1)[:, None] * inverse[chosen]
    factor = np.repeat([1.0, unit], n)
    return unit * values[chosen], factor[:, None] * vectors, inverse / factor


def _invert(vectors: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        return np.full_like(vectors, UNCERTAIN)  # refused by the bound that they lead to


def _raise_unstable(rate: float) -> None:
    raise ValueError(f"an unstable packing was given, which grows as exp({rate:.4g} t): give a stable one")


def _normalise_modes(exponents, modes, norms, parts) -> _ModalMotion:
    """Modes of unit norm, which makes the bound nearly the least that scaling can give."""
    size = np.linalg.norm(norms, axis=0)
    return _ModalMotion(exponents, modes / size, norms / size, parts * size[:, None])


def _find_beats(motion: _ModalMotion, undamped: bool) -> list[tuple[float, float, float, float]]:
    """(amplitude, time of opposite phase, two frequencies) of the modes that nearly coincide, the largest first.

    Two unit modes with cosine c are a disturbance that their being in opposite phase turns into √((1 + c)/(1 − c)).
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
    found = []
    for flat in np.argsort(-gain, axis=None)[:PAIRS]:
        j, k = np.unravel_index(flat, gain.shape)
        if gain[j, k] > 1:
            found.append((float(gain[j, k]), float(time[j, k]), float(speed[j]), float(speed[k])))
    return found


def _search_times(motion: _ModalMotion, pairs, duration: float | None, samples: int, report):
    """Times looked at, sorted, and the amplitude at each."""
    slowest = np.abs(motion.exponents).min()
    if duration is None:
        duration = max([PERIODS * 2 * np.pi / slowest, *(2 * time for _, time, *_ in pairs[:1])])
    if not (np.isfinite(duration) and duration > 0 and samples >= 2):
        raise ValueError(f"duration = {duration} with {samples} samples was given: a positive time and at least 2")
    beats = [time for _, time, *_ in pairs if time <= duration]
    amplitude = _amplitude_function(motion)
    early = np.geomspace(0.1 / np.abs(motion.exponents).max(), duration, samples // 3)
    times = np.unique(np.concatenate([np.linspace(0.0, duration, samples), early[early < duration], beats]))
    found = np.empty(len(times))
    for k, t in enumerate(times):
        if report and k % 10 == 0:
            report("transient growth", 0.6 * k / len(times), f"{k} of {len(times)} times up to {duration:.4g}")
        found[k] = amplitude(t)
    # the envelope first, then the phase of what swings below it
    reaches = duration / (samples - 1), 2 * np.pi / (max(pairs[0][2:]) if pairs else slowest)
    starts = np.unique([*times[np.argsort(-found)[:2]], *beats[:1]])
    for k, t in enumerate(starts):
        if report:
            report("transient growth", 0.6 + 0.4 * k / len(starts), f"×{found.max():.4g} so far")
        for reach in reaches:
            near = np.clip(t + np.linspace(-reach, reach, FINE), 0.0, duration)
            values = np.array([amplitude(t) for t in near])
            times, found, t = np.append(times, near), np.append(found, values), near[np.argmax(values)]
        step = 2 * reach / (FINE - 1)
        top = minimize_scalar(
            lambda t: -amplitude(t), bounds=(max(t - step, 0.0), min(t + step, duration)), method="bounded",
            options={"xatol": 1e-4 * step},
        )  # fmt: skip
        times, found = np.append(times, top.x), np.append(found, -top.fun)
    times, first = np.unique(times, return_index=True)
    return times, found[first]


def _amplitude_function(motion: _ModalMotion):
    """A function of t: the largest singular value of Re P exp(st) W."""
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
    """The largest amplitude at t, and the unit start (m,) that is amplified by it."""
    if motion.norms.shape[0] <= SMALL:
        _, values, starts = np.linalg.svd(_propagator(motion, t))
    else:
        guess = np.random.default_rng(0).normal(size=motion.norms.shape[0])
        _, values, starts = svds(_propagator_operator(motion, t), k=1, v0=guess, solver="arpack")
    return float(values[0]), starts[0]
