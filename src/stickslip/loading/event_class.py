"""Events of quasi-static paths: kinds, precursors, triggering contacts, and changes."""

from enum import Enum
from typing import NamedTuple

import numpy as np
import scipy  # scipy.optimize, whose import takes a tenth of a second, is imported on first use

from ..core.contacts.bonding import bond_shares, broken_since, without_failure
from ..core.contacts.forces import FREE
from ..core.contacts.jacobian import linearise
from ..core.contacts.neighbors import with_neighbor_list
from ..core.dynamics.run import run, stable_time_step
from ..core.measure import touching
from ..core.readable import pluralize, readable
from ..core.state import OPEN, SLIDE, STICK, State
from ..solve.freedom import displaced
from ..solve.shear_response import margin, softest
from ..solve.spectrum import REAL_BELOW
from .event_path import TIME_STEP, Judge, Point, displacement

EVENT_RATIO = 8.0  # ratio of successive distances from an event at which the spectrum is computed
VANISHES, STEEPEST = 0.25, 8.0  # smallest and largest exponent of a quantity that tends to zero at an event
PROBE, TRIED = (
    1e-3,
    10,
)  # fraction of a strain step for extrapolating forces, and number of contacts tried on the motion ahead
BEYOND = (1.0, 2.0, 4.0, 8.0)  # distances, in widths of the bracket, at which contacts are examined for changes
NEAREST, ALMOST = 5, 0.99  # number of most mobilised sticking contacts also tried, and their least mobilisation
RUN, SAMPLE = 20_000, 5  # number of steps of a run that measures a growth rate, and of steps between its samples
LOW, HIGH = 0.01, 0.5  # kinetic energies between which the growth rate is measured, in units of the largest one


class EventKind(Enum):
    """Precursor and start of an event. The value of each member is a description."""

    SADDLE_NODE = "a real eigenvalue reaches zero"
    PAIR = "a complex pair with growing oscillations"
    SLIDING = "a contact starts to slide"
    OPENING = "a contact opens"
    BREAKING = "a bond breaks"
    UNSTABLE = "the state before was already unstable"
    UNRESOLVED = "unresolved"


@readable(head=lambda event: f"{event.kind.value} at strain {event.strain:.6g}, drop {event.stress_drop:.3g} of p")
class Event(NamedTuple):
    """Discontinuity of a quasi-static path; see `find_events`. Strains count from the first state."""

    strain: float  # upper end of the bracket [1]
    below: float  # lower end of the bracket, the last strain before a jump or loss of stability
    kind: EventKind
    exponent: float  # p of (γ_c − γ)^p for λ_min or, for pairs, Re λ − (Im λ/drag)²; see `fit_power`; NaN if flat
    exponent_error: float  # standard error of the exponent
    distances: np.ndarray  # (K,) strains before the event, step · 8^(−k)
    softest: np.ndarray  # (K,) smallest real eigenvalue λ_min at these distances [1/time²]
    re_pair: np.ndarray  # (K,) Re λ of the fastest-growing pair, NaN without a pair [1/time²]
    growth: np.ndarray  # (K,) growth rate |Im √λ| of the fastest-growing pair without drag, 0 without a pair [1/time]
    trigger: tuple[int, int]  # grains of the contact whose sliding or opening starts the event, or (−1, −1)
    mobilisation: float  # |F_t|/(μ F_n) of the triggering contact in the last stable state, or NaN
    # smallest λ or, for pairs, Re λ − (Im λ/drag)² of the last stable state with the triggering contact sliding or
    # open, which is negative (unstable); NaN without a triggering contact [1/time²]
    switched: float  # [1/time²]
    growth_rate: float  # initial growth rate of the instability under the drag [1/time]
    stress_drop: float  # change of σ_xy divided by the pressure before the event; positive if −σ_xy decreases
    jump: float  # root mean square non-affine displacement, in mean diameters
    participation: float  # participation of the jump, (Σ u²)²/(N Σ u⁴), from 1/N to 1
    opened: int  # contacts that opened
    closed: int  # contacts that closed
    # root mean square distance, in mean diameters, between the state at the end of the strain step and the state that
    # Newton's method alone reaches in one step; NaN if Newton's method fails
    newton_distance: float
    broken: np.ndarray = np.zeros((0, 3), int)  # (B, 3) bonds that broke in the event: grains, index in `FAILURES`


@readable(head=lambda steps: pluralize(len(steps.strain), "strain step"))
class StrainStep(NamedTuple):
    """Predictors at the beginning of each strain step of a path, as arrays (S,)."""

    strain: np.ndarray  # counted from the first state [1]
    softest: np.ndarray  # smallest real eigenvalue λ_min [1/time²]
    nonaffine_rate: np.ndarray  # root mean square of dq/dγ over the supported grains, from J alone [length]
    growth: np.ndarray  # growth rate |Im √λ| of the fastest pair without drag, 0 without a pair [1/time]
    tangent_modulus: np.ndarray  # d(−σ_xy)/dγ, from J alone [force/length^(dim−1)]
    switch: np.ndarray  # smallest λ_min if one of the most mobilised sticking contacts slid [1/time²]
    shear_stress: np.ndarray  # −σ_xy [force/length^(dim−1)]
    pressure: np.ndarray  # [force/length^(dim−1)]
    loss_ahead: np.ndarray  # strain at which, along the linear motion, the loss of a contact makes the state unstable


@readable(head=lambda record: f"{pluralize(len(record.events), 'event')}; {record.end}")
class Events(NamedTuple):
    """Events of a quasi-static path, and predictors along it."""

    events: tuple[Event, ...]
    steps: StrainStep
    state: State  # state at the end of the path
    drag: float  # drag of the dynamics that determine the end of an event [1/time]
    step: float  # largest strain step
    resolution: float  # largest width of a bracket
    end: str  # reason why the search ended


class Break(NamedTuple):
    """Interruption of a path: the points around it."""

    history: list[Point]  # points of the path before the interruption, since the last event
    last: Point  # last stable point, in the finer bracket
    upper: float  # upper end of the finer bracket
    before: Point  # last point of the path
    beyond: Point | None  # unstable equilibrium at the upper end, if the branch continues
    after: Point  # point at which dynamics ends
    goal: float  # upper end of the bracket
    snaps: bool = False  # whether a bond at its strength starts the interruption


class Profile(NamedTuple):
    """Spectra at given strains before an event; see `Event`."""

    distances: np.ndarray
    softest: np.ndarray
    re_pair: np.ndarray
    growth: np.ndarray
    margin: np.ndarray  # Re λ − (Im λ/drag)² of the pair for which it is smallest, NaN without a pair [1/time²]


def describe(event: Break, step: float, bracket: tuple[float, float]) -> Event:
    """Describe an event, except for its `newton_distance`, which is NaN."""
    judge, before, after = event.before.judge, event.before, event.after
    # spectra at distances step · 8^(−k) down to a few widths of the finer bracket
    width, rows = event.upper - event.last.strain, []
    critical, away = event.upper - 0.5 * width, step
    while away >= 4 * width:
        point = _point_at(event, critical - away)
        if point is not None and (point.stable or not event.last.stable):  # otherwise, Newton's method left the path
            rows.append((away, *_softness(point)))
        away /= EVENT_RATIO
    profile = Profile(*np.array(rows).reshape(-1, 5).T)
    broken = broken_since(after.state, before.state)
    kind, (power, error) = (EventKind.BREAKING, (np.nan,) * 2) if event.snaps else _classify(event, profile)
    trigger, row, values = None, -1, None
    if kind is EventKind.UNRESOLVED and (trigger := find_trigger(event.last, event.upper)):
        kind, row, values = trigger
    elif kind is EventKind.UNRESOLVED and event.beyond is not None and event.beyond.oscillates:
        kind = EventKind.PAIR
    contacts = event.last.state.contacts
    # growth rate of the unstable equilibrium or, without one, of the switched state or, without one, of the motion
    if event.beyond is not None:
        growth = float(event.beyond.exponents.max())
    elif values is not None:
        growth = float(judge.exponents(values).max())
    elif event.snaps:
        growth = np.nan
    else:
        growth = motion_growth(before, event.upper, judge)
    moved = displacement(before.state, after.state, after.strain - before.strain, judge.way)
    jump, participation = jump_size(moved, before.response.support.grains)
    (shear, pressure), end = before.stress, after.stress[0]
    # contacts without force count as neither opened nor closed
    (held, touched), (holds, touches) = (
        (set(p.state.contacts.key[np.flatnonzero(p.response.support.contacts)].tolist()),
         set(p.state.contacts.key[touching(p.state)].tolist())) for p in (before, after)
    )  # fmt: skip
    grains = (int(contacts.i[row]), int(contacts.j[row])) if trigger else (-1, -1)
    grains = _weakest(event.last) if event.snaps else grains
    broken = broken[np.argsort((broken[:, :2] != grains).any(axis=1), kind="stable")]  # the trigger is first
    return Event(
        bracket[1], bracket[0], kind, power, error, profile.distances, profile.softest, profile.re_pair,
        profile.growth, grains,
        float(event.last.response.mobilisation[row]) if trigger else np.nan,
        margin(values, judge.drag) if trigger else np.nan, growth, (shear - end) / pressure,
        jump / judge.diameter, participation, len(held - touches), len(holds - touched), np.nan, broken,
    )  # fmt: skip


def _weakest(point: Point) -> tuple[int, int]:
    """Grains of the bond with the largest ratio of load to strength."""
    bonds, first = point.state.bonds, int(bond_shares(point.state).argmax())
    return int(bonds.i[first]), int(bonds.j[first])


def _point_at(event: Break, strain: float) -> Point | None:
    """Point of the path at a strain, by one step of Newton's method from the nearest point below it."""
    below = [point for point in event.history if point.strain <= strain]
    if not below or below[-1].strain == strain:
        return below[-1] if below else None
    point = below[-1].newton(strain, thorough=True)
    return point if point is not None and (point.stable or not below[-1].stable) else None


def _softness(point: Point) -> tuple[float, float, float, float]:
    values = point.eigenvalues
    pairs = values[values.imag > 0]
    if not len(pairs):
        return softest(values), np.nan, 0.0, np.nan
    rates = np.abs(np.sqrt(pairs).imag)
    fastest = int(np.argmax(rates))
    rest = margin(pairs, point.judge.drag)
    return softest(values), float(pairs.real[fastest]), float(rates[fastest]), rest


def fit_power(distances: np.ndarray, values: np.ndarray, width: float) -> tuple[float, float]:
    """Exponent p of values ∝ distances^p, as the distances tend to zero, and its standard error.

    The nearest three values determine 1/value = α distance^(−p) + β. Where a solution branch ends, or a real part
    vanishes, both quantities are analytic in the same coordinate, so the first correction to the power is
    proportional to the values: this is the constant β. The leading effect of another mode that takes over far from the
    event has the same form.

    The error has two parts: the strain of the event is only known to lie within a bracket, and corrections of higher
    order are neglected. The latter are estimated by the first correction, or by the change without the nearest value if
    that is larger. If the distance is A λ² + B λ³, as when a contact whose stiffness is proportional to √overlap is
    about to open, p is between 1/3 and 1/2 until A λ² dominates.

    Parameters
    ----------
    distances, values : (K,) from far to near
    width : width of the bracket that contains the event, from whose middle distances are measured

    Returns
    -------
    float, float
        both NaN if there are fewer than three values, or if these are not positive or do not decrease

    Examples
    --------
    >>> d = np.array([512.0, 64.0, 8.0, 1.0])
    >>> power, error = fit_power(d, 0.01 * d**0.5, width=0.01)
    >>> round(power, 6), round(error, 4)
    (0.5, 0.0009)
    """
    x, y = distances[-3:], values[-3:]
    power = _power(x, y)
    if np.isnan(power):
        return np.nan, np.nan
    ends = [_power(x + 0.5 * shift, y) for shift in (-width, width)]
    rough = [np.log(y[1] / y[2]) / np.log(x[1] / x[2]), _power(distances[-4:-1], values[-4:-1])]
    return power, float(np.hypot(np.ptp(ends) / np.sqrt(12), np.nanmax(np.abs(power - np.array(rough)))))


def _power(x: np.ndarray, y: np.ndarray) -> float:
    """Exponent p of 1/y = α x^(−p) + β through three points; NaN if none is between ±STEEPEST."""
    if len(x) < 3 or not (y > 0).all() or not (y[0] > y[1] > y[2]):
        return np.nan
    far, near = np.log(x[:-1] / x[1:])
    wanted = np.log(np.divide(*np.diff(1 / y)[::-1]))

    def excess(p: float) -> float:
        return float(np.log(np.expm1(p * near) / -np.expm1(-p * far)) if p else np.log(near / far)) - wanted

    return scipy.optimize.brentq(excess, -STEEPEST, STEEPEST) if excess(-STEEPEST) < 0 < excess(STEEPEST) else np.nan


def _classify(event: Break, profile: Profile) -> tuple[EventKind, tuple[float, float]]:
    """Kind of an event as far as spectra determine it, and the exponent with its error."""
    if not event.last.stable:
        return EventKind.UNSTABLE, (np.nan, np.nan)
    for kind, values in ((EventKind.SADDLE_NODE, profile.softest), (EventKind.PAIR, profile.margin)):
        power, error = fit_power(profile.distances, values, event.upper - event.last.strain)
        if vanishes(power, error):
            return kind, (power, error)
    return EventKind.UNRESOLVED, (np.nan, np.nan)


def vanishes(power: float, error: float) -> bool:
    """Return True if a quantity with this exponent tends to zero at an event."""
    return power >= VANISHES and power > 2 * error


def find_trigger(last: Point, upper: float) -> tuple[EventKind, int, np.ndarray] | None:
    """Contact that slides or opens within the bracket and thereby makes the last stable state unstable.

    Contacts that reach the Coulomb limit or open are predicted from the linear motion ahead. In this switch test, the
    trigger is the first one whose sliding or opening gives the Jacobian of the last stable state a growing mode.

    Returns
    -------
    kind, row of the contact in the list, eigenvalues after it slides or opens; None if there is no such contact
    """
    response, drag = last.response, last.judge.drag
    for row, mode in dict.fromkeys([*_upcoming(last, upper), *((int(k), SLIDE) for k in response.sticking(NEAREST))]):
        values = response.eigenvalues_if(row, mode)
        near = mode == OPEN or response.mobilisation[row] > ALMOST
        if near and _grows(values, drag):
            return EventKind.OPENING if mode == OPEN else EventKind.SLIDING, row, values
    return None


def _grows(values: np.ndarray, drag: float) -> bool:
    """Return True if an eigenvalue belongs to a mode that grows under the drag."""
    return margin(values, drag) < -REAL_BELOW * np.abs(values).max()


def _upcoming(last: Point, upper: float):
    """Yield rows and new modes of supported contacts that open or slide along the linear motion, one after another."""
    state, response, law = last.state, last.response, last.judge.law
    for widths in BEYOND:
        advance = widths * (upper - last.strain)
        there = displaced(last.strained_to(last.strain + advance), response.free, _coordinates(response, advance))
        there = with_neighbor_list(there, law)
        line, key = linearise(there, law, memory=FREE), there.contacts.key[: there.contacts.count[0]].tolist()
        contacts = dict(zip(key, zip(line.closed, line.slides, strict=True), strict=True))
        for row in np.flatnonzero(response.support.contacts).tolist():
            closed, slides = contacts.get(int(state.contacts.key[row]), (0.0, 0.0))
            if not response.line.closed[row]:  # a bond across a gap
                continue
            if not closed:
                yield row, OPEN
            elif slides and state.contacts.mode[row] == STICK:
                yield row, SLIDE


def loss_ahead(point: Point, strain: float) -> float:
    """Strain at which the linear motion ahead loses a contact and the state becomes unstable; ∞ if there is none.

    A contact is lost when it reaches the Coulomb limit or opens. Forces and distances to the limit are extrapolated
    from their change over a small part of `strain`. Contacts are tried one by one in the order of their loss.

    The law is evaluated at rest, as in quasi-static loading. In tests, sliding started at most a twentieth of a strain
    step from the strain predicted at the beginning of that step (50 disks, `tests/events/test_loss_ahead.py`).
    """
    response, state, part = point.response, point.state, PROBE * strain
    there = displaced(point.strained_to(point.strain + part), response.free, _coordinates(response, part))
    there = with_neighbor_list(there, point.judge.law)
    known, keys = there.contacts.key[: there.contacts.count[0]].tolist(), state.contacts.key
    later = dict(zip(known, _margins(there, point), strict=True))
    now, losses = _margins(state, point), []
    for row in np.flatnonzero(response.support.contacts):
        then = later.get(int(keys[row]), np.zeros(2))
        for mode, here, rest in zip((SLIDE, OPEN), now[row], then, strict=True):
            if here > rest and (mode == OPEN or state.contacts.mode[row] == STICK):
                losses.append((part * here / (here - rest), row, mode))
    for left, row, mode in sorted(losses)[:TRIED]:
        if _grows(response.eigenvalues_if(row, mode), point.judge.drag):
            return float(left)
    return np.inf


def _margins(state, point: Point) -> np.ndarray:
    """(C, 2) μ F_n − |F_t|, and F_n, of every pair in the list; both change linearly while no contact changes mode."""
    line = linearise(state, point.judge.law, memory=FREE)
    pull = line.secant * np.linalg.norm(line.slip, axis=1)
    return np.stack([np.maximum(line.limit - pull, 0), line.force_n * line.closed], axis=1)


def _coordinates(response, strain: float) -> np.ndarray:
    """Coordinates of the supported grains along the linear motion."""
    flat = np.append(response.rate.ravel(), np.zeros(6 * response.free.bodies - response.rate.size + 9))
    return strain * flat[response.free.component]


def motion_growth(point: Point, strain: float, judge: Judge) -> float:
    """Growth rate of the motion that follows a strain step, from its kinetic energy K(t) ~ exp(2 g t) [1/time].

    The rate is averaged over the last rise of K from 1 % to 50 % of its maximum.
    """
    start = without_failure(point.strained_to(strain))
    dt = TIME_STEP * stable_time_step(start, judge.law)
    _, record, outcome = run(start, judge.law, RUN, dt, drag=judge.drag, spin_drag=judge.drag, every=SAMPLE, threads=1)
    energy = record.kinetic_energy
    top = int(np.argmax(energy))
    if outcome.broken or not top:
        return np.nan
    low = np.flatnonzero((energy[:top] < LOW * energy[top]) & (energy[:top] > 0))
    high = np.flatnonzero(energy[:top] < HIGH * energy[top])
    if not len(low) or high[-1] <= low[-1]:
        return np.nan
    rise = 0.5 * np.log(energy[high[-1]] / energy[low[-1]])
    return float(rise / ((high[-1] - low[-1]) * SAMPLE * dt))


def jump_size(moved: np.ndarray, grains: np.ndarray) -> tuple[float, float]:
    """Root mean square displacement of the given grains, without its mean, and its participation ratio."""
    moved = moved[grains][:, :3]
    square = ((moved - moved.mean(axis=0)) ** 2).sum(axis=1)
    if not square.any():
        return 0.0, 1.0
    return float(np.sqrt(square.mean())), float(square.sum() ** 2 / (len(square) * (square**2).sum()))
