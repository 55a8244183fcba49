"""Amplitude of shaking or of a pulse at which a contact first reaches the Coulomb limit, in theory and in dynamics."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from ..core.arguments import NotNegative, Numbers, Positive, Series, checked
from ..core.dynamics.run import run, stable_time_step
from ..core.laws.builtin import SHARP, Law
from ..core.progress import Size, require_sizes
from ..core.readable import pluralize, readable
from ..core.state import State
from .birth import PHASES, first_changes
from .linear import FrontalFactor, dissect
from .response import ForcedMotion, as_patterns, forced_motion, solve_at

SOFT = 1e-9  # stiffness of the springs that exert forces, over that of contacts
FINE = 0.1  # time step over the largest stable one
SNAPSHOTS = 200  # number of times during a pulse at which contacts are examined
SLOWLY = 200  # number of decay times in which slowly raised shaking reaches the predicted amplitude
NARROW = 1e-3  # relative accuracy of the amplitude found by pulses
MOST_RUNS = 60  # largest number of pulses


@readable
class Trigger(NamedTuple):
    """Amplitude, a factor of the drive, at which the first sticking contact reaches the Coulomb limit or opens."""

    predicted: float  # from the linear response and the exact contact law; inf if none was found
    contact: tuple[int, int]  # bodies of this contact; (−1, −1) if none
    measured: float  # from dynamics; NaN if not computed
    first: tuple[int, int]  # bodies of the first contact at the limit in dynamics; (−1, −1) if not computed


@checked
def trigger_amplitude(
    state: State, law: Law, drive: Numbers, *, frequency: Positive | None = None, times: Series | None = None,
    factors: Series | None = None, duration: Positive | None = None, drag: NotNegative = 0.0,
    spin_drag: NotNegative | None = None,
    dynamics: bool = True,
) -> Trigger:  # fmt: skip
    """Smallest amplitude of a drive, such as a wave, at which a contact first reaches the Coulomb limit.

    The prediction moves the grains along the linear response, with its velocities, and finds the first contact that
    slides under the exact law, dashpots included. In the dynamics, steady shaking is raised slowly, over 200 decay
    times, or a pulse is repeated with bisected amplitudes, and the first contact at the limit is recorded.

    In 96 shaken packings of 16 disks without tangential dashpots, the prediction differed from dynamics by 1 %
    (median), and by less than 5 % in nine tenths of them, but by up to 40 % near a weakly damped resonance. Tangential
    dashpots are truncated at the limit together with the spring, before the contact slides. The linear response does
    not include this, so the prediction is too high, by 3 % (up to 20 %) with c_t = 0.2 c_n, and by 50 % (up to 120 %)
    with c_t = c_n.

    Parameters
    ----------
    drive : (N + W, 6), as in `frequency_response`; dynamics does not support torques
    frequency : ω of steady shaking [1/time]
    times, factors : (K,) times that increase from zero, and factors of the drive at these times, interpolated linearly
        and zero afterwards; instead of a frequency
    duration : time after the start of a pulse during which contacts are examined; default: twice its length [time]
    drag, spin_drag : ν of translations and of rotations [1/time]
    dynamics : if False, only the prediction is computed

    Raises
    ------
    ValueError
        If the law has smooth friction, or a contact is already at the limit; if neither or both of frequency and
        pulse are given; as in `frequency_response`.

    Source
    ------
    Charan, Pomyalov & Procaccia, doi:10.48550/arXiv.2106.11616, for the problem and for pulses.

    Examples
    --------
    >>> import numpy as np
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.68, seed=1)
    >>> push = np.zeros((20, 6))
    >>> push[3, 0] = 1
    >>> found = trigger_amplitude(
    ...     state, law, push, frequency=0.3, drag=0.1, dynamics=False
    ... )
    >>> 0 < found.predicted < 0.1
    True
    """
    drive = as_patterns(state, drive=drive)
    _check_drive(drive, frequency, times, factors)
    if law.coulomb != SHARP:
        raise ValueError("the law has smooth friction, so contacts never reach the Coulomb limit: use coulomb='sharp'")
    motion = forced_motion(state, law, drag, spin_drag)
    if count := len(motion.here.at_limit):
        raise ValueError(f"{pluralize(count, 'contact')} at the Coulomb limit: any disturbance can make them slide")
    if frequency is not None:
        if dynamics and not motion.drag.diagonal().any():
            raise ValueError(
                "the motion is undamped, so that shaking never becomes steady: give drag, or dynamics=False"
            )
        still, moving, prescribed = motion.drives(drive)
        x = motion.all_coordinates(solve_at(motion, [frequency], still[:, 0], moving[:, 0]), prescribed)[:, 0]
        turns = np.exp(2j * np.pi * np.arange(PHASES) / PHASES)[:, None]  # phases of a period
        ways = (turns * np.stack([x, 1j * frequency * x])[:, None]).real
    else:
        times, factors = np.asarray(times, float), np.asarray(factors, float)
        duration = 2 * times[-1] if duration is None else duration
        ways = _pulse_ways(motion, drive, times, factors, duration, _time_step(motion, motion.here.state))
    displacement, speed = ways * np.sqrt(motion.whole.mass)
    start = 1e-6 * state.grains.radius.min() / np.abs(ways[0]).max()
    amplitude, contact = first_changes(
        motion.here, motion.whole, lambda a: a * displacement, start, lambda a: a * speed
    )[0]
    amplitude = float(amplitude)
    if not dynamics or not np.isfinite(amplitude):
        return Trigger(amplitude, contact, np.nan, (-1, -1))
    control = state.control
    turned = (drive[0] * control.free)[:, 3:].any()
    if turned or control.spring.any() or len(control.knots) or (control.group >= 0).any():
        raise ValueError(
            "dynamics=True does not support torques, springs, rigid groups or time profiles: use dynamics=False"
        )
    drags = {"drag": drag, "spin_drag": spin_drag}
    if frequency is not None:
        return Trigger(amplitude, contact, *_raise_slowly(motion, drive[0], frequency, amplitude, drags))
    return Trigger(amplitude, contact, *_bisect_pulses(motion, drive[0], times, factors, duration, amplitude, drags))


def _check_drive(drive, frequency, times, factors) -> None:
    if len(drive) != 1:
        raise ValueError(f"expected one drive, got {len(drive)}: combine them first")
    if (frequency is None) == (times is None) or (times is None) != (factors is None):
        raise ValueError("give either a frequency, or the times and factors of a pulse")
    if frequency is None and (
        np.shape(times) != np.shape(factors) or len(times) < 2 or times[0] != 0 or not (np.diff(times) > 0).all()
    ):
        raise ValueError("a pulse needs as many factors as times, and times that increase from zero")


def _pulse_ways(motion: ForcedMotion, drive, times, factors, duration: float, dt: float) -> np.ndarray:
    """(2, K, N) displacements and velocities after the start of a pulse, by the trapezoidal rule."""
    still, moving, prescribed = (part[:, 0] for part in motion.drives(drive))
    steps = int(np.ceil(duration / dt))
    require_sizes([Size(f"duration = {duration:g} takes", steps, "time steps", "use a shorter one")])
    grid = dt * np.arange(steps + 1)
    factor = np.interp(grid, times, factors, right=0.0)
    rate = np.gradient(factor, dt)
    matrix = sparse.csr_array(motion.pull + motion.drag * (2 / dt) + sparse.eye_array(len(motion.free)) * (4 / dt**2))
    solve = FrontalFactor(matrix, dissect(motion.here.state, motion.free, np.arange(len(motion.free)), matrix)).solve
    y, v = np.zeros((2, len(motion.free)))
    a, out = factor[0] * still + rate[0] * moving, []
    for k in range(steps + 1):
        if k % max(steps // SNAPSHOTS, 1) == 0:
            parts = (y, factor[k] * prescribed), (v, rate[k] * prescribed)
            out.append([motion.all_coordinates(*part) for part in parts])
        if k < steps:
            b = (
                factor[k + 1] * still
                + rate[k + 1] * moving
                + a
                + (4 / dt) * v
                + (4 / dt**2) * y
                + motion.drag @ (v + (2 / dt) * y)
            )
            old, y = y, solve(b[:, None])[:, 0]
            v, a = (2 / dt) * (y - old) - v, (4 / dt**2) * (y - old) - (4 / dt) * v - a
    return np.stack(out, axis=1)


def _raise_slowly(motion, drive, frequency, predicted: float, drags) -> tuple[float, tuple[int, int]]:
    """Amplitude of steadily raised shaking when a contact first reaches the limit, and the bodies of this contact."""
    reach = SLOWLY * max(2 / motion.drag.diagonal().mean(), 2 * np.pi / frequency)
    grid = np.arange(0.0, 2 * reach, 2 * np.pi / frequency / 64)
    factor = predicted * grid / reach * np.cos(frequency * grid)
    event = _first_event(motion, drive, grid, factor, drags)
    if event is None:
        return np.inf, (-1, -1)
    return predicted * event[0] / reach, event[1]


def _bisect_pulses(motion, drive, times, factors, duration, predicted: float, drags):
    """Smallest amplitude of a pulse at which a contact reaches the limit, and its bodies."""
    grid = np.linspace(0.0, duration, 1 + 16 * max(int(duration / np.diff(times).min()), 1))
    shape = np.interp(grid, times, factors, right=0.0)
    low, high, contact = 0.0, predicted, (-1, -1)
    for _ in range(MOST_RUNS):
        middle = 0.5 * (low + high) if contact[0] >= 0 else high
        event = _first_event(motion, drive, grid, middle * shape, drags)
        if event:
            high, contact = middle, event[1]
        else:
            low, high = middle, high if contact[0] >= 0 else 1.5 * middle
        if contact[0] >= 0 and high - low <= NARROW * high:
            return high, contact
    return np.inf, (-1, -1)


def _first_event(motion: ForcedMotion, drive, grid, factor, drags) -> tuple[float, tuple[int, int]] | None:
    """Time since the start at which a contact, not of a rattler, first slides or opens, and its bodies; or None."""
    state = with_drive(motion, drive, grid, factor)
    dt = _time_step(motion, state)
    events = run(state, motion.here.law, int(grid[-1] / dt), dt, events=True, **drags)[1].events
    loose = np.append(motion.here.loose, np.zeros(len(state.walls.mass), bool))
    events = events[(events["kind"] != "closed") & ~loose[events["i"]] & ~loose[events["j"]]]
    if not len(events):
        return None
    return float(events["time"][0] - state.time), (int(events["i"][0]), int(events["j"][0]))


def _time_step(motion: ForcedMotion, state: State) -> float:
    """Fraction FINE of the largest time step that is stable for contacts and, by a bound, for dashpots and drag."""
    fastest = float(np.abs(motion.drag).sum(axis=1).max())
    return FINE * min(stable_time_step(state, motion.here.law), 2 / fastest if fastest else np.inf)


def with_drive(motion: ForcedMotion, drive: np.ndarray, grid, factor) -> State:
    """State whose control exerts a drive (B, 6) times a factor, which is given at times relative to the state's.

    Forces are exerted by springs so soft, and with load points so far away, that motion does not change the forces.
    """
    state = motion.here.state
    control, force = state.control, (drive * state.control.free)[:, :3]
    far = max(np.abs(force).max() / (SOFT * motion.here.mean_stiffness), 1e-300)
    rate = drive * ~control.free
    rate[: len(state.grains.radius), 3:] /= state.grains.radius[:, None]
    course = np.stack([far * factor, -far * factor, np.gradient(factor, grid)], axis=1)
    return state._replace(
        control=control._replace(
            knots=state.time + grid, course=course, spring=np.abs(force) / far, rate=rate,
            anchor=np.concatenate([state.grains.position, state.walls.point]),
            leads=np.select([force > 0, force < 0], [0, 1], -1).astype(control.leads.dtype),
            follows=np.where(rate != 0, 2, -1).astype(control.follows.dtype),
        )
    )  # fmt: skip
