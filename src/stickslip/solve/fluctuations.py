"""Fluctuations of a packing under noise, and how far its linearised dynamics are from an instability."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, eig, eigvals, solve_continuous_lyapunov, solve_triangular, svdvals

from ..core.arguments import Numbers, checked, require_not_negative, require_positive
from ..core.laws.builtin import Law
from ..core.readable import readable
from ..core.state import State
from .freedom import Freedom
from .linear import suitable_threads
from .response import as_patterns, forced_motion
from .spectrum import REAL_BELOW
from .transient import raise_unstable, reduced_matrices

AT_MOST = 400  # coordinates; matrices of four times this size are diagonalised within a minute
CLOSE = 1e-6  # relative accuracy of the distance to instability


@readable
class Fluctuations(NamedTuple):
    """Stationary covariances under noise, and three measures of what amplifies it."""

    displacement: np.ndarray  # (n, n) ⟨q qᵀ⟩ in the coordinates `free`, without common translations [length²]
    velocity: np.ndarray  # (n, n) ⟨q̇ q̇ᵀ⟩, without common translations, too [length²/time²]
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
        """decay/distance: how much nearer an instability is than the spectrum says; 1 for orthogonal modes."""
        return self.decay / self.distance


@checked
def stationary_fluctuations(
    state: State, law: Law, *, temperature: float = 1.0, noise: Numbers | None = None, drag: float = 0.0,
    spin_drag: float | None = None,
) -> Fluctuations:  # fmt: skip
    """Stationary covariance L Σ + Σ Lᵀ + Q = 0 of M q̈ = J q + C q̇ − M ν q̇ + ξ, and its distance from instability.

    Thermal noise has ⟨ξ ξᵀ⟩ = 2T (M ν − C) δ(t − t′), so that every mode would have the energy T/2 twice if forces had
    a potential; friction has none, and feeds or cools modes. Distance and condition number are those in the norm of
    the elastic and kinetic energy, in which symmetric undamped motion is a rotation.

    Common translations that nothing resists (the centre of mass in a periodic cell), and coordinates that nothing
    resists, are taken out of motion and noise; what a run adds to velocities is T/(Σm) for each translation. The number
    of modes is that of the coordinates that are left.

    In runs of 2000 decay times under noise on one grain, the variance of its displacement was 2 to 5 % smaller, with a
    statistical error of 3 % (`tests/modes/test_response.py`).

    Parameters
    ----------
    temperature : T of thermal noise [energy]
    noise : (k, N + W, 6) forces and torques/R that are multiplied by k independent white noises of unit spectral
        density, instead of thermal noise [force √time]
    drag, spin_drag : ν of translations and of rotations, as in `run` [1/time]

    Raises
    ------
    ValueError
        if nothing damps a mode, or if one grows; if there are more than 400 coordinates; if the forces do not balance;
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
    require_positive(temperature=temperature)
    require_not_negative(drag=drag, spin_drag=spin_drag)
    motion = forced_motion(state, law, drag, spin_drag)
    free = motion.free
    if len(free) > AT_MOST:
        raise ValueError(f"{len(free)} coordinates were given: covariances take at most {AT_MOST}")
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
        _check_decay(values)
        inner = np.zeros((2 * n, 2 * n))
        inner[n:, n:] = force
        covariance = solve_continuous_lyapunov(dynamics, -inner)
        distance, condition = distance_to_instability(dynamics), float(np.linalg.cond(vectors))
    wide = root[:, None] * (basis @ lift), root[:, None] * basis
    parts = covariance[:n, :n], covariance[n:, n:]
    cov = [side @ part @ side.T for side, part in zip(wide, parts, strict=True)]
    energy = [0.5 * float(np.trace(part)) / n for part in parts]
    return Fluctuations(*cov, energy[1], energy[0], float(-values.real.max()), distance, condition, free)


def energy_dynamics(pull: np.ndarray, drag: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrix L of ż = L z for z = (R y, ẏ), |z|² twice the energy, and R⁻¹; RᵀR is the symmetric part of A."""
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


def _check_decay(values: np.ndarray) -> None:
    rate, scale = float(values.real.max()), float(np.abs(values).max())
    if rate > REAL_BELOW * scale:
        raise_unstable(rate)
    if rate > -REAL_BELOW * scale:
        raise ValueError(
            "a mode that nothing damps was found, which noise heats without limit: give drag and spin_drag"
        )


def distance_to_instability(dynamics: np.ndarray) -> float:
    """Smallest spectral norm of a change of a stable matrix L that brings an eigenvalue to the imaginary axis.

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
