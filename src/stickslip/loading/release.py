"""Newtonian dynamics from an unstable equilibrium of a packing, with its spectrum followed until failure."""

from typing import NamedTuple

import numpy as np

from ..core.arguments import Seed, checked
from ..core.contacts.neighbors import with_neighbor_list
from ..core.dynamics.run import run
from ..core.laws.builtin import Law
from ..core.measure import rattlers
from ..core.outcome import NotInEquilibriumError
from ..core.progress import Report, silent
from ..core.readable import readable
from ..core.scales import natural_scales
from ..core.state import State
from ..solve.spectrum import Spectrum, spectrum
from .protocols import Growth, fit_growth

# M between noise and the first change of the spectrum, where growth is fitted, over the square of the smallest diameter
WINDOW = (1e-22, 1e-11)
CHANGED = 0.01  # relative change of Im λ of the fastest pair beyond which the spectrum is not constant
FUNNEL = (1e-17, 1e-13)  # likewise, range of M in which single turns of the trajectories are saved for the figure
LEAST, DURATION, STEP, VELOCITY = 5e4, 6e5, 0.1, 1e-13  # defaults of `release`, in natural units
TURN, TURNS = 11, 16  # samples per turn, turns per chunk
KEPT = 20_000  # samples of a time series that are saved


@readable
class Released(NamedTuple):
    """Run from an unstable state. Compressive stress is positive; shear stress is −σ_xy, which opposes γ > 0."""

    pairs: int  # complex pairs at the start
    eigenvalue: complex  # λ of the fastest pair [1/time²]
    growth_rate: float  # predicted ω_i [1/time]
    frequency: float  # predicted ω_r [1/time]
    dt: float  # [time]
    time: np.ndarray  # (T,) [time]
    msd: np.ndarray  # (T,) M = mean of |Δr|² + R²|Δangle|² over grains that are not rattlers [length²]
    shear_stress: np.ndarray  # (T,) [force/length^(dim−1)]
    pressure: np.ndarray  # (T,) [force/length^(dim−1)]
    touching: np.ndarray  # (T,) number of contacts
    kinetic_energy: np.ndarray  # (T,) [energy]
    growth: Growth | None  # fitted; compare with the rates corrected for velocity Verlet
    snapshot_time: np.ndarray  # (S,) [time]
    snapshot_msd: np.ndarray  # (S,) [length²]
    snapshots: np.ndarray  # (S, n) eigenvalues λ [1/time²]
    constant: tuple[float, float]  # M at the snapshots before and after the fastest Im λ had changed by 1 %, or NaN
    turn_time: np.ndarray  # (L,) start times of single turns of the motion while M is within FUNNEL [time]
    turns: np.ndarray  # (L, TURN, H, 3) displacements of the grains that are not rattlers [length]
    close_time: np.ndarray  # (K,) times of all samples of a few turns [time]
    close_msd: np.ndarray  # (K,) [length²]
    strain: float = np.nan  # of the state, if the caller knows it [1]

    @property
    def corrected_rate(self) -> float:
        """ω_i corrected for velocity Verlet, ω_i (1 + ω_r² dt²/8)."""
        return self.growth_rate * (1 + (self.frequency * self.dt) ** 2 / 8)

    @property
    def corrected_frequency(self) -> float:
        """ω_r corrected for velocity Verlet, ω_r (1 + ω_r² dt²/24)."""
        return self.frequency * (1 + (self.frequency * self.dt) ** 2 / 24)

    @property
    def drop(self) -> float:
        """Drop in shear stress from the mean over the first tenth to that over the last."""
        part = max(1, len(self.time) // 10)
        return float(self.shear_stress[:part].mean() - self.shear_stress[-part:].mean())

    @property
    def contacts_lost(self) -> int:
        """Number of contacts at the start minus the mean number over the last tenth."""
        return round(float(self.touching[0] - self.touching[-max(1, len(self.time) // 10) :].mean()))


def mean_square_motion(position, angle, reference: State, held: np.ndarray) -> np.ndarray:
    """M(t) = mean over `held` grains of |Δr|² + R²|Δangle|² [length²].

    Parameters
    ----------
    position, angle : (T, H, 3) of the held grains, unwrapped
    held : (H,) numbers of the held grains, without rattlers, which drift

    Source
    ------
    Bonfanti et al., doi:10.1103/PhysRevE.101.052902, Eq 10.
    """
    grains = reference.grains
    moved = ((position - grains.position[held]) ** 2).sum(axis=2)
    turned = ((angle - grains.angle[held]) ** 2).sum(axis=2) * grains.radius[held] ** 2
    return (moved + turned).mean(axis=1)


def with_random_velocity(state: State, modes: Spectrum, seed: int, velocity: float) -> State:
    """State with random velocities in all resisted modes, without drift and without spinning rattlers.

    Parameters
    ----------
    velocity : standard deviation of each mode's amplitude [length/time]
    """
    size = np.abs(modes.eigenvalues)
    stiff = size > 1e-6 * size.max()
    amplitude = np.random.default_rng(seed).normal(0.0, velocity, stiff.sum())
    full = modes.free.spread((modes.modes[:, stiff] @ amplitude).real)
    grains, n = state.grains, len(state.grains.radius)
    return state._replace(
        grains=grains._replace(velocity=full[:n, :3].copy(), spin=full[:n, 3:] / grains.radius[:, None])
    )


@checked
def release(
    state: State,
    law: Law,
    *,
    seed: Seed = 0,
    e_folds: float = 45.0,
    least: float | None = None,
    duration: float | None = None,
    dt: float | None = None,
    velocity: float | None = None,
    snapshots: int = 40,
    report: Report = silent,
) -> Released:
    """Run undamped dynamics from an equilibrium with complex pairs, for `e_folds` growth times.

    The run lasts at least `least` and at most `duration`. It is divided into chunks; between them, the spectrum of the
    current state is computed, `snapshots` times during the growth and the same number of times afterwards.

    Parameters
    ----------
    least, duration, dt : default: 5e4, 6e5 and 0.1 of the natural unit of time, see `relax` [time]
    seed, velocity : of the initial perturbation: random velocities in all resisted modes, with this standard deviation,
        by default 1e-13 smallest diameters per natural unit of time [length/time]
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        if the state has no complex pair.
    NotInEquilibriumError
        if the run diverges.
    """
    scales = natural_scales(state, law)
    least = LEAST * scales.time if least is None else least
    duration = DURATION * scales.time if duration is None else duration
    dt = STEP * scales.time if dt is None else dt
    velocity = VELOCITY * scales.length / scales.time if velocity is None else velocity
    window, funnel = (tuple(m * scales.length**2 for m in ends) for ends in (WINDOW, FUNNEL))
    modes = spectrum(state, law)
    if not len(modes.pairs):
        raise ValueError("the state has no complex pair, so nothing grows: release a state beyond the onset")
    fastest = int(modes.pair_indices[0])
    rate, frequency = float(modes.growth_rate[fastest]), float(modes.frequency[fastest])
    held = np.flatnonzero(~rattlers(state))
    every = max(1, round(2 * np.pi / frequency / 10 / dt))
    chunks = _chunk_sizes(
        min(e_folds / rate, duration) / dt / every, min(least, duration) / dt / every, max(20, snapshots)
    )
    here, series, taken, turns = with_random_velocity(state, modes, seed, velocity), [], [], []
    close = (np.zeros(0), np.zeros(0))
    for k, chunk in enumerate(chunks):
        here, record, outcome = run(here, law, chunk * every, dt, every=every, probes=held)
        if outcome.broken:
            raise NotInEquilibriumError("the run diverged", outcome)
        msd = mean_square_motion(record.position, record.angle, state, held)
        part = slice(0 if k == 0 else 1, None)  # a chunk starts where the last one ended
        columns = (record.time, msd, record.shear_stress, record.pressure, record.touching, record.kinetic_energy)
        series.append(np.stack([c[part] for c in columns]))
        if funnel[0] <= msd[-1] <= funnel[1]:
            starts = np.linspace(0, len(msd) - TURN, min(TURNS, len(msd) // TURN)).astype(int)
            turns += [(record.time[s], record.position[s : s + TURN] - state.grains.position[held]) for s in starts]
            close = (record.time[-6 * TURN :], msd[-6 * TURN :])
        if snapshots:
            now = spectrum(with_neighbor_list(here), law, modes=False)
            taken.append((record.time[-1], msd[-1], now.eigenvalues, now.im_lambda.max()))
        text = f"growth rate {rate:.1e}, M = {msd[-1]:.0e}"
        report("release", sum(chunks[: k + 1]) / sum(chunks), text)
    table = np.concatenate(series, axis=1)
    time, msd = table[:2]
    growth = fit_growth(
        time, msd, growth_rate=rate, frequency=frequency * (1 + (frequency * dt) ** 2 / 24), window=window, within=1e-3
    )
    before = modes.im_lambda[fastest]
    changed = [abs(im - before) > CHANGED * before for *_, im in taken]
    at = changed.index(True) if True in changed else len(changed)
    constant = (taken[at - 1][1] if at else np.nan, taken[at][1] if at < len(taken) else np.nan)
    return Released(
        len(modes.pairs), complex(modes.eigenvalues[fastest]), rate, frequency, dt,
        *table[:, _envelope_rows(table[2], KEPT)], growth,
        np.array([t for t, *_ in taken]), np.array([m for _, m, *_ in taken]), np.array([v for _, _, v, _ in taken]),
        constant, np.array([t for t, _ in turns]), np.array([x for _, x in turns]).reshape(-1, TURN, len(held), 3),
        *close,
    )  # fmt: skip


def _chunk_sizes(growing: float, least: float, count: int) -> list[int]:
    """Samples per chunk: `count` chunks for the growth, and as many afterwards if the run must be longer."""
    first = [max(1, int(growing / count))] * count
    rest = int(least) - sum(first)
    return first + [max(1, rest // count)] * (count if rest > 0 else 0)


def _envelope_rows(values: np.ndarray, most: int) -> np.ndarray:
    """Rows to save: the smallest and largest value of each interval, which preserves the envelope of oscillations."""
    size = 2 * -(-len(values) // most)
    if size <= 2:
        return np.arange(len(values))
    starts = np.arange(0, len(values), size)
    ends = [(s + np.argmin(values[s : s + size]), s + np.argmax(values[s : s + size])) for s in starts]
    return np.unique(np.append(ends, [0, len(values) - 1]))
