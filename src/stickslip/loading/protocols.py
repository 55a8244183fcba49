"""Load paths: quasi-static ramps with spectra, births and deaths of complex pairs, free runs, release to failure."""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy  # scipy.optimize, whose import takes a tenth of a second, is imported on first use

from ..core.arguments import NotNegative, Positive, Seed, Series, Several, checked, knows_bonds
from ..core.contacts.neighbors import with_neighbor_list
from ..core.dynamics.run import run
from ..core.laws.builtin import Law
from ..core.measure import rattlers
from ..core.progress import NotInEquilibriumError, Outcome, Report, Size, require_sizes, silent
from ..core.readable import readable
from ..core.scales import natural_scales
from ..core.state import State
from ..data.checkpoint import Checkpoint
from ..solve.equilibrate import relax
from ..solve.newton import newton
from ..solve.spectrum import Spectrum, match_pairs, mode_overlap, spectrum

SAME_LOAD = 1e-9  # relative difference within which a load equals that of a state
SAME_PAIR = 0.5  # overlap of modes above which pairs at neighbouring loads are the same
# range of M in which growth is fitted, between noise and the first change of the spectrum [smallest diameter²]
WINDOW = (1e-22, 1e-11)
CHANGED = 0.01  # relative change of Im λ of the fastest pair beyond which the spectrum is not constant
FUNNEL = (1e-17, 1e-13)  # range of M [smallest diameter²] in which single turns of trajectories are saved
LEAST, DURATION, STEP, VELOCITY = 5e4, 6e5, 0.1, 1e-13  # defaults of `release`, in natural units
TURN, TURNS = 11, 16  # samples per turn, turns per chunk
KEPT = 20_000  # largest number of saved samples of a time series


@readable
class Equilibrium(NamedTuple):
    """One point of a quasi-static path."""

    MADE_BY = "protocols.ramp"

    load: float
    state: State
    spectrum: Spectrum
    outcome: Outcome


class Change(NamedTuple):
    """Bracket of a birth (death): the pair is absent (present) at `below` and present (absent) at `above`."""

    below: float
    above: float

    @property
    def load(self) -> float:
        """Middle of the bracket."""
        return 0.5 * (self.below + self.above)


class Family(NamedTuple):
    """A complex pair followed along a path."""

    loads: np.ndarray  # (K,)
    eigenvalues: np.ndarray  # (K,) complex [1/time²]
    birth: Change | None  # None if the pair exists at the first point
    death: Change | None  # None if the pair exists at the last point


@checked
def load_path(turning_points: Series, step: Positive, through: Several = ()) -> np.ndarray:
    """Loads from one turning point to the next in increments of at most `step`, including the loads in `through`.

    They are loads for `ramp`, which documents whether they are absolute or relative to its first state.

    Examples
    --------
    >>> load_path([0.0, 0.02, 0.01], 0.01, through=[0.015])
    array([0.   , 0.01 , 0.015, 0.02 , 0.01 ])
    """
    steps = float(np.abs(np.diff(turning_points)).sum()) / step
    require_sizes([Size(f"step = {step:g} makes", steps, "load steps", "use a larger step")])
    loads, waiting = [turning_points[0]], list(dict.fromkeys(np.atleast_1d(through)))
    for a, b in pairwise(turning_points):
        inside = [x for x in waiting if min(a, b) <= x <= max(a, b)]
        waiting = [x for x in waiting if x not in inside]
        n = max(1, round(abs(b - a) / step, 6).__ceil__())
        leg = np.union1d(np.round(np.linspace(a, b, n + 1), 12), inside)
        loads += list((leg if b > a else leg[::-1])[1:]) if a != b else []
    if waiting:
        raise ValueError(f"load {waiting[0]} of `through` lies outside the turning points")
    return np.array(loads)


def equilibrium(state: State, law: Law, *, method: str = "dynamics", what: str = "this load", **options):
    """Bring a state to rest by `relax` ("dynamics") or `newton`.

    Raises
    ------
    NotInEquilibriumError
        If there is no equilibrium; the message gives the load, the outcome of the solver, and a remedy.
    """
    end, outcome = newton(state, law, **options) if method == "newton" else relax(state, law, **options)
    if not outcome.ok:
        raise NotInEquilibriumError(f"no equilibrium at {what}", outcome)
    return end, outcome


@readable
class Protocol(NamedTuple):
    """Rules for applying loads and finding equilibria.

    Loads are absolute, such as forces, unless `place` returns the load of a state: then `ramp` measures them from the
    first state of a path.
    """

    law: Law
    apply: Callable[[State, float], State]  # the state under a new load
    settle: Callable[[State, float], tuple[State, Outcome]]  # the equilibrium at that load, or NotInEquilibriumError
    modes: bool = True  # whether spectra contain modes, which are needed to track pairs
    check: Callable[[State, Equilibrium], Equilibrium] | None = None  # check of each step, given the previous state
    place: Callable[[State], float] | None = None  # load of a state, if it is a property of the state such as strain

    def starting(self, state: State, load: float = 0.0) -> "Protocol":
        """Protocol whose loads are measured such that a state is at a given load; unchanged if loads are absolute."""
        if self.place is None:
            return self
        apply, origin = self.apply, self.place(state) - load
        return self._replace(apply=lambda state, load: apply(state, origin + load))

    def step(self, state: State, load: float) -> Equilibrium:
        """Apply one increment of the load, to a given value, and find the equilibrium.

        A load that is a property of the state, such as the strain of `aqs`, counts from the origin that `starting` has
        chosen; by default, it is the strain of the cell.
        """
        end, outcome = self.settle(self.apply(state, load), load)
        point = Equilibrium(float(load), end, spectrum(end, self.law, modes=self.modes), outcome)
        return self.check(state, point) if self.check else point


@checked
@knows_bonds
def ramp(
    state: State, loads: Series, protocol: Protocol, report: Report = silent, *, kept: Checkpoint | None = None
) -> list[Equilibrium]:
    """Equilibria along a path of loads, each found from the previous one.

    Loads of `aqs` are strains measured from the given state, which is at strain 0 for any tilt of its cell. If the
    first load is the strain of the cell, however, the path continues from this strain. Other loads are absolute, such
    as forces. A moving state is first brought to rest.

    `report` is called as report(stage, share done, text) after each equilibrium.
    Equilibria saved in `kept` are loaded instead of computed. The continued path then agrees with an uninterrupted
    one to within the tolerance of the solver.
    """
    path, begin = [], 0.0
    if protocol.place and len(loads) and np.isclose(loads[0], protocol.place(state), rtol=SAME_LOAD, atol=0.0):
        begin = float(loads[0])
    protocol = protocol.starting(state, begin)
    for k, load in enumerate(loads):
        point = solve_point(state, load, protocol, kept, f"{k:06d}")
        modes = f"{len(point.spectrum.pairs)} pairs, growth rate {point.spectrum.growth_rate.max(initial=0.0):.2e}"
        report("ramp", (k + 1) / len(loads), f"load {load:.4g}, {modes}, unbalanced {point.outcome.residual:.0e}")
        path.append(point)
        state = point.state
    return path


def solve_point(state: State, load: float, protocol: Protocol, kept: Checkpoint | None, name: str) -> Equilibrium:
    """Equilibrium at the next load of a path, or the one saved under a name."""
    if kept and kept.has(name):
        state, outcome = kept.load(name, tuple[State, Outcome])
        return Equilibrium(float(load), state, spectrum(state, protocol.law, modes=protocol.modes), outcome)
    point = protocol.step(state, load)
    if kept:
        kept.save(name, (point.state, point.outcome))
    return point


def bisect_change(
    start: Equilibrium,
    target: float,
    protocol: Protocol,
    present: Callable[[Spectrum], bool],
    *,
    relative: float = 1e-6,
) -> Change:
    """Load at which `present` changes, by bisection between `start` and `target`.

    Every trial is one load step from the fixed state `start`, so that the path does not depend on the search. The state
    at `start` itself depends on the load steps that led to it; report them together with the result.
    """
    before, low, high = present(start.spectrum), start.load, target
    protocol = protocol.starting(start.state, start.load)
    while abs(high - low) > relative * max(abs(low), abs(high)):
        middle = 0.5 * (low + high)
        if present(protocol.step(start.state, middle).spectrum) == before:
            low = middle
        else:
            high = middle
    return Change(low, high)


def follow_pair(
    path: list[Equilibrium], members: dict[int, int], protocol: Protocol, *, relative: float = 1e-6
) -> Family:
    """Follow one pair, given as a mapping from points of the path to eigenvalues, to its birth and death.

    Both loads are located to a relative accuracy of `relative`.
    """
    first, last = min(members), max(members)

    def same_mode(k):
        spectrum = path[k].spectrum
        mode, mass = spectrum.modes[:, members[k]], spectrum.free.mass
        return lambda s: any(mode_overlap(mode, s.modes[:, p], mass) >= SAME_PAIR for p in s.pair_indices)

    birth = death = None
    if first > 0:
        birth = bisect_change(path[first - 1], path[first].load, protocol, same_mode(first), relative=relative)
    if last < len(path) - 1:
        death = bisect_change(path[last], path[last + 1].load, protocol, same_mode(last), relative=relative)
    index = sorted(members)
    return Family(
        np.array([path[k].load for k in index]),
        np.array([path[k].spectrum.eigenvalues[members[k]] for k in index]),
        birth,
        death,
    )


@checked
def track_pairs(path: list[Equilibrium], protocol: Protocol, report: Report = silent) -> list[Family]:
    """Track all complex pairs along a path, with births and deaths.

    Call `report(stage, share done, text)` before each pair.
    """
    chains, out = match_pairs([p.spectrum for p in path], at_least=SAME_PAIR), []
    for k, members in enumerate(chains):
        first = path[min(members)]
        rate = first.spectrum.growth_rate[members[min(members)]]
        report(
            "pairs", k / len(chains), f"pair {k + 1} of {len(chains)}, load {first.load:.4g}, growth rate {rate:.2e}"
        )
        out.append(follow_pair(path, members, protocol))
    return out


def dominant_family(path: list[Equilibrium], protocol: Protocol) -> Family | None:
    """Track the pair with the largest Im λ at the end of a path back to its birth; None if there is no pair."""
    last = path[-1].spectrum
    if not len(last.pairs):
        return None
    top = int(np.argmax(last.im_lambda))
    chains = match_pairs([p.spectrum for p in path], at_least=SAME_PAIR)
    return follow_pair(path, next(f for f in chains if f.get(len(path) - 1) == top), protocol)


@checked
def stable_window(path: list[Equilibrium], near: float, protocol: Protocol) -> list[float] | None:
    """Window [low, high] of loads without complex pairs that is nearest to `near`; None if there is none.

    Loads must increase along the path. A window that reaches an end of the path ends there.
    """
    quiet = [k for k, point in enumerate(path) if not len(point.spectrum.pairs)]
    if not quiet:
        return None
    first = last = min(quiet, key=lambda k: abs(path[k].load - near))
    while first - 1 in quiet:
        first -= 1
    while last + 1 in quiet:
        last += 1

    def has_pairs(spectrum):
        return bool(len(spectrum.pairs))

    low, high = path[first].load, path[last].load
    if first > 0:
        low = bisect_change(path[first - 1], low, protocol, has_pairs).load
    if last < len(path) - 1:
        high = bisect_change(path[last], path[last + 1].load, protocol, has_pairs).load
    return [low, high]


@checked
@knows_bonds
def perturbed(state: State, seed: Seed, velocity: NotNegative) -> State:
    """State with normally distributed velocities of standard deviation `velocity` [length/time] in free coordinates."""
    rng = np.random.default_rng(seed)
    grains, n = state.grains, len(state.grains.radius)
    kick = rng.normal(0.0, velocity, (n, 6)) * state.control.free[:n]
    if state.cell.dim == 2:
        kick[:, 2:5] = 0.0
    return state._replace(
        grains=grains._replace(velocity=kick[:, :3].copy(), spin=kick[:, 3:] / grains.radius[:, None])
    )


class Growth(NamedTuple):
    """Exponential growth fitted to M(t) = e^{2 ω_i t} [A + B cos(2 ω_r t + φ)]."""

    growth_rate: float  # ω_i [1/time]
    frequency: float  # ω_r [1/time]
    start: float  # window of the fit [time]
    stop: float  # [time]
    decades: float  # decades of M inside the window


@checked
def fit_growth(
    time: Series,
    msd: Series,
    *,
    growth_rate: float,
    frequency: float,
    window: tuple[float, float] = (1e-19, 1e-11),
    within: float = 0.05,
) -> Growth | None:
    """Fit growth rate and frequency while `msd` lies in the window; None if `msd` does not cross it.

    The window must lie in the linear range, which ends near M = 1e-11 for nearly open contacts with overlaps of 1e-6.

    Parameters
    ----------
    time, msd : (T,) [time], [length²]
    growth_rate, frequency : initial guesses from the spectrum, one accurate to a factor of two, the other to `within`
        [1/time]
    within : float, relative range of frequencies that is searched
    """
    above_top = np.flatnonzero(msd > window[1])
    above_floor = np.flatnonzero(msd > window[0])
    if not len(above_top) or not len(above_floor) or above_top[0] - above_floor[0] < 20:
        return None
    inside = slice(above_floor[0], above_top[0])
    t = time[inside] - time[inside][0]
    y = msd[inside]

    def misfit(x):
        shape = np.stack([np.ones_like(t), np.cos(2 * x[1] * t), np.sin(2 * x[1] * t)], axis=1)
        flat = y * np.exp(-2 * x[0] * t) / y[0]
        return shape @ np.linalg.lstsq(shape, flat, rcond=None)[0] / flat.mean() - flat / flat.mean()

    # the misfit has a minimum every π/T in frequency: first evaluate all of them near the guess
    trials = frequency + np.arange(-within * frequency, within * frequency, np.pi / (4 * t[-1]))
    nearest = min(trials, key=lambda f: np.sum(misfit((growth_rate, f)) ** 2))
    best = scipy.optimize.least_squares(misfit, [growth_rate, nearest], x_scale=[growth_rate * 1e-2, frequency * 1e-5])
    return Growth(
        float(best.x[0]),
        float(best.x[1]),
        float(time[inside][0]),
        float(time[inside][-1]),
        float(np.log10(y[-1] / y[0])),
    )


@checked
def free_run(
    state: State,
    law: Law,
    *,
    duration: Positive,
    dt: Positive,
    sample: Positive,
    drag: float = 0.0,
    spin_drag: float | None = None,
):
    """Run Newtonian dynamics and record contact events and, at intervals of `sample` [time], all grains."""
    probes = np.arange(len(state.grains.radius))
    return run(
        state,
        law,
        round(duration / dt),
        dt,
        drag=drag,
        spin_drag=spin_drag,
        every=max(1, round(sample / dt)),
        probes=probes,
        events=True,
    )


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
    close_time: np.ndarray  # (K,) times of all samples in a few turns [time]
    close_msd: np.ndarray  # (K,) [length²]
    strain: float = np.nan  # strain of the state, if given by the caller [1]

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
        """Drop in shear stress from the mean over the first tenth to that over the last tenth."""
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
    least, duration, dt : by default, 5e4, 6e5 and 0.1 natural units of time (see `relax`) [time]
    seed, velocity : seed and standard deviation of the initial random velocities in all resisted modes, by default
        1e-13 smallest diameters per natural unit of time [length/time]
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If the state has no complex pair.
    NotInEquilibriumError
        If the run diverges.
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
    # number of chunks of the growth; a longer run appends the same number. `chunks` contains the samples of each
    count = max(20, snapshots)
    chunks = [max(1, int(min(e_folds / rate, duration) / dt / every / count))] * count
    rest = int(min(least, duration) / dt / every) - sum(chunks)
    chunks += [max(1, rest // count)] * (count if rest > 0 else 0)
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


def _envelope_rows(values: np.ndarray, most: int) -> np.ndarray:
    """Rows to save: the smallest and largest value of each interval, which preserves the envelope of oscillations."""
    size = 2 * -(-len(values) // most)
    if size <= 2:
        return np.arange(len(values))
    starts = np.arange(0, len(values), size)
    ends = [(s + np.argmin(values[s : s + size]), s + np.argmax(values[s : s + size])) for s in starts]
    return np.unique(np.append(ends, [0, len(values) - 1]))
