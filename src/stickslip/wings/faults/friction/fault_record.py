"""Records of a simulated fault: samples at stations, slip profiles, and events with their source parameters.

The source of an event comprises its moment, stress drops, rupture speed and energies. With u the slip in excess of
plate motion and K the stress transfer, the shear stress on the fault is τ = τ₀ + K u; it exceeds friction by the
radiation damping η V. D is the slip of an event and −K Δu its static stress drop. Sums are over cells of length h. All
quantities are per unit length along strike, because the fault is two-dimensional.
"""

from typing import Annotated, NamedTuple

import numpy as np

from ....kit import YEAR, Size, Values, checked, pluralize, readable, require_sizes
from .fault import Fault
from .fault_state import FaultState, friction_of
from .ranges import ALL_POSITIVE, Places, Positive
from .stress_transfer import surface_displacement


@readable(head=lambda events: pluralize(len(events.start), "event"))
class FaultEvents(NamedTuple):
    """Earthquakes: E intervals in which the maximum slip velocity exceeds the threshold."""

    start: np.ndarray  # [s]
    end: np.ndarray  # [s]
    depth: np.ndarray  # position of the fastest cell when the threshold is reached [m]
    nucleation_length: np.ndarray  # length around that cell with at least a tenth of the largest slip velocity [m]
    top: np.ndarray  # shallowest and deepest points at which slip reached the threshold velocity [m]
    bottom: np.ndarray  # [m]
    max_velocity: np.ndarray  # [m/s]
    surface_velocity: np.ndarray  # largest slip velocity of the first cell [m/s]
    max_slip: np.ndarray  # [m]
    surface_slip: np.ndarray  # slip of the first cell [m]
    moment: np.ndarray  # G × slip, integrated over depth: moment per length along strike [N]
    radiated: np.ndarray  # radiated energy, the work of radiation damping, per length along strike [J/m]
    rupture_length: np.ndarray  # length of the cells in which slip reached the threshold velocity [m]
    rupture_speed: np.ndarray  # mean speed from the first cell at the threshold velocity to the farther end [m/s]
    stress_drop: np.ndarray  # mean of the static stress drop over the rupture [Pa]
    slip_weighted_stress_drop: np.ndarray  # mean weighted by slip, which determines the energy released [Pa]
    seismological_stress_drop: np.ndarray  # stress drop of a crack with the same moment and length [Pa]
    released: np.ndarray  # elastic energy released, per length along strike [J/m]
    loading: np.ndarray  # work of the plates during the event, per length along strike [J/m]
    frictional: np.ndarray  # work of friction, per length along strike [J/m]
    fracture: np.ndarray  # work of friction in excess of slip × final shear stress [J/m]
    first: np.ndarray  # True for the first event after an artificial start, which depends on that start

    @property
    def recurrence(self) -> np.ndarray:
        """Times between the starts of events (E − 1,) [s]."""
        return np.diff(self.start)

    @property
    def energy_residual(self) -> np.ndarray:
        """Residual of the energy balance, released + loading − frictional − radiated, over the released energy (E,)."""
        return (self.released + self.loading - self.frictional - self.radiated) / self.released


NAMES = FaultEvents._fields


@checked
def moment_magnitude(moment: Annotated[Values, ALL_POSITIVE]):
    """Moment magnitude M_w = (2/3) (log10 M₀ − 9.1), with the seismic moment M₀ in N m.

    Source
    ------
    T. C. Hanks and H. Kanamori 1979, doi:10.1029/JB084iB05p02348, with the constant in SI units.

    Examples
    --------
    >>> print(round(float(moment_magnitude(1.1e20)), 2))
    7.29
    """
    return 2 / 3 * (np.log10(np.asarray(moment, float)) - 9.1)


def crack_stress_drop(fault: Fault, moment: float, length: float, *, surface: bool) -> float:
    """Uniform stress drop of a crack of length L with moment M per length along strike, C (G*/G) M/L² [Pa].

    A crack of length L in an infinite body, with the slip (2 Δτ/G*) √(L²/4 − x²), has the moment (G/G*) π Δτ L²/4, so C
    = 4/π. A crack that breaks the free surface is half of a crack of length 2L: C = 2/π. This value is exact for
    antiplane shear. A dipping fault that breaks the surface slips more, so the result is 17 % too large for a dip of 30
    or 60 degrees, and 26 % for 90 degrees.

    Source
    ------
    Antiplane: L. Knopoff, Geophys. J. 1, 44 (1958); in-plane: A. T. Starr, Proc. Camb. Phil. Soc. 24, 489 (1928).
    """
    return (2 if surface else 4) / np.pi * fault.modulus / fault.shear_modulus * moment / length**2


def measure_source(fault: Fault, prestress: np.ndarray, begin, end, arrival: np.ndarray) -> dict[str, float]:
    """Moment, stress drops, rupture speed and energies of an event, by the field names of `FaultEvents`.

    Parameters
    ----------
    prestress : (N,) shear stress at the start of the simulation [Pa]
    begin, end : `Moment` before and after the event
    arrival : (N,) times at which slip reached the threshold velocity, infinite where it did not [s]
    """
    h, change = fault.cell, end.excess_slip - begin.excess_slip
    slip = change + fault.plate_rate * (end.time - begin.time)
    drop, ruptured = -fault.transfer(change), np.isfinite(arrival)
    middle = prestress + fault.transfer(0.5 * (begin.excess_slip + end.excess_slip))  # elastic energy is quadratic in u
    loading, frictional, radiated = map(float, end.energy - begin.energy)
    length, moment = h * int(ruptured.sum()), fault.shear_modulus * h * float(slip.sum())
    endless = fault.boundary == "periodic" and bool(ruptured.all())
    surface = fault.boundary == "surface" and bool(ruptured[0])
    first = int(np.argmin(arrival))  # the first cell to rupture; the speed is measured from it to the farthest
    distance = np.abs(fault.depth - fault.depth[first])
    if fault.boundary == "periodic":
        distance = np.minimum(distance, fault.width - distance)
    far = int(np.argmax(np.where(ruptured, distance, -1.0)))
    took = arrival[far] - arrival[first]
    return {
        "moment": moment,
        "rupture_length": length,
        "rupture_speed": float(distance[far] / took) if took > 0 else np.nan,
        "stress_drop": float(drop[ruptured].mean()),
        "slip_weighted_stress_drop": float(drop @ slip / slip.sum()),
        "seismological_stress_drop": np.nan if endless else crack_stress_drop(fault, moment, length, surface=surface),
        "released": h * float(change @ middle),
        "loading": loading,
        "frictional": frictional,
        "radiated": radiated,
        "fracture": frictional - h * float(slip @ (middle - 0.5 * drop)),
    }  # fmt: skip


CHANGE = 0.05  # largest change between two samples in log10 of the maximum slip velocity
ZONE = 0.1  # slip velocity at the edge of a nucleation zone, relative to the largest


@readable
class Recording(NamedTuple):
    """Stations, intervals and thresholds of a recording."""

    stations: Places = ()  # depths at which time series are recorded [m]
    surface: Places = ()  # surface stations: distances from the trace, > 0 on the hanging wall [m]
    threshold: Positive = 1e-3  # an event lasts while the maximum slip velocity is at least this [m/s]
    quiet_sampling: Positive = 0.1 * YEAR  # time between samples, and longest step if the normal stress changes [s]
    seismic_sampling: Positive = 0.1  # time between samples within events [s]
    quiet_profiles: Positive = 5 * YEAR  # time between slip profiles, outside and within events [s]
    seismic_profiles: Positive = 1.0
    spacing: Positive = 500.0  # spacing of the points of a profile [m]


def profiles_size(fault: Fault, name: str, pause: float, number: float, points: float) -> Size:
    """Memory of a number of profiles, which an interval in a recording makes."""
    tables = 3 if fault.dips else 1  # of slip and, for a dipping fault, stresses
    return Size(f"recording.{name} = {pause:g} s makes profiles of", 8.0 * tables * number * points, "bytes", LONGER)


LONGER = "use a longer interval, or a larger recording.spacing"


class Points(NamedTuple):
    """Linear interpolation from the cells to points."""

    depth: np.ndarray  # (P,) [m]
    cells: np.ndarray  # (P, 2)
    weights: np.ndarray  # (P, 2)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Interpolate values of the cells (..., N) to the points (..., P)."""
        return (values[..., self.cells] * self.weights).sum(axis=-1)


def points(fault: Fault, depths) -> Points:
    """Prepare the interpolation at given depths.

    Between a free surface and the first cell centre, values follow the even parabola through the first two cells or,
    for in-plane shear, a straight line. Elsewhere beyond the outermost centres, they are constant.
    """
    depths = np.atleast_1d(np.asarray(depths, float))
    last = len(fault.depth) - 2
    place = depths / fault.cell - 0.5
    first = np.clip(np.floor(place).astype(int), 0, last)
    share = np.clip(place - first, 0.0, 1.0)
    if fault.dips:
        share = np.minimum(place - first, 1.0)
    elif fault.boundary == "surface":
        share = np.where(place < 0, (depths / fault.cell) ** 2 / 2 - 0.125, share)
    return Points(depths, np.stack([first, first + 1], axis=1), np.stack([1 - share, share], axis=1))


def origin_of_value(fault: Fault, depth: float) -> str:
    """Description of the cells and the interpolation used for values at a depth."""
    at = points(fault, depth)
    places, weights = fault.depth[at.cells[0]], at.weights[0]
    cells = f"cells at {places[0]:g} and {places[1]:g} m"
    if (weights >= 0).all():
        used = places[weights > 0]
        if len(used) == 2:
            return f"interpolated linearly between {cells}"
        return f"those of the cell at {used[0]:g} m"
    curve = "linearly" if fault.dips else "along the parabola, even about the free surface,"
    return f"extrapolated {curve} from {cells}"


class Surface:
    """Displacement of Q surface stations beside a dipping fault whose sides slide past each other at the plate rate.

    Each side moves rigidly by half the plate motion; slip in excess of plate motion deforms both (SEAS benchmark
    problem BP3-QD, equation 4).
    """

    def __init__(self, fault: Fault, places):
        places, edges = np.array(places, float), np.arange(len(fault.depth) + 1) * fault.cell
        self._moved = fault.sense * surface_displacement(places, edges, fault.dip)
        side = np.where(places < 0, 0.5, -0.5)
        self._rigid = fault.sense * fault.plate_rate * side * np.exp(1j * np.radians(fault.dip))

    def __call__(self, excess_slip: np.ndarray, time: float) -> np.ndarray:
        """Horizontal displacement, positive from foot to hanging wall, plus i times the downward displacement (Q,)."""
        return self._moved @ excess_slip + self._rigid * time


class Moment(NamedTuple):
    """The fault after an accepted step."""

    time: float
    excess_slip: np.ndarray
    rate: np.ndarray  # rate of the excess slip
    log_states: np.ndarray  # (S, N) logarithms of one or two states, plus `Fault.state_shift`
    log_velocity: np.ndarray
    fastest: float  # maximum slip velocity
    energy: np.ndarray  # (3,) work of plates, friction and radiation damping since the start [J/m]


class Recorder:
    """Growing lists of samples, profiles and events of a simulation."""

    def __init__(self, fault: Fault, wanted: Recording, start: FaultState):
        self.fault, self.wanted, self.prestress = fault, wanted, start.prestress
        self.sampled, self.past = np.array(start.sampled, float), start.events
        self.stations = points(fault, wanted.stations)
        self._near, places = np.unique(self.stations.cells, return_inverse=True)  # cells beside stations
        self._between = self.stations._replace(cells=places.reshape(-1, 2))
        self.surface = Surface(fault, wanted.surface)
        self.profile = points(fault, np.arange(0.0, fault.width + 1e-6 * fault.cell, wanted.spacing))
        self.samples: list[tuple] = []
        self.profiles: list[tuple] = []
        self.events: list[tuple] = []
        self.event: dict | None = None  # the event under way

    def begin(self, now: Moment) -> None:
        """Record the start of a simulation."""
        self._sample(now)
        self._add_profile(now.time, False, now.fastest, now.excess_slip, now.rate)

    def step(self, before: Moment, now: Moment) -> None:
        """Record the samples due after an accepted step."""
        seismic = now.fastest >= self.wanted.threshold
        if self.event is None:
            pause, until = self.wanted.quiet_profiles, self._crossing(before, now) if seismic else now.time
            self._profiles(before, now, (np.floor(before.time / pause) + 1) * pause, until, seismic=False)
            if seismic:
                self._begin_event(before, now)
        else:
            np.maximum(self.event["peak"], now.log_velocity, out=self.event["peak"])
            self.event["fastest"] = max(self.event["fastest"], now.fastest)
            self._arrive(before, now)
        if self.event is not None:
            pause, start = self.wanted.seismic_profiles, self.event["start"]
            done = np.floor((before.time - start) / pause) + 1 if before.time >= start else 0
            self._profiles(before, now, start + done * pause, now.time, seismic=True)
            if not seismic:
                self._end_event(before, now)
        pause = self.wanted.seismic_sampling if seismic else self.wanted.quiet_sampling
        if now.time - self.sampled[0] >= pause or abs(np.log10(now.fastest) - self.sampled[1]) > CHANGE:
            self._sample(now)

    def _sample(self, now: Moment) -> None:
        """Append the values of cells beside stations, and surface displacements."""
        fault, at, near = self.fault, self.stations, self._near
        clamped = fault.transfer.tractions(now.excess_slip)[1] if fault.dips else 0.0
        every = fault.normal_at(now.time) + clamped
        normal = sum((change.change(at.depth, now.time) for change in fault.changes), at(fault.normal + clamped))
        states = now.log_states[:, near] - fault.state_shift(every)[near]
        rate = fault.shear_modulus * fault.cell * fault.v0 * float(np.exp(now.log_velocity).sum())
        moved = self.surface(now.excess_slip, now.time), self.surface(now.rate, 1.0)
        cells = now.excess_slip[near], now.log_velocity[near], states, every[near]
        self.samples.append((now.time, now.fastest, rate, *cells, normal, *moved))
        self.sampled[:] = now.time, np.log10(now.fastest)

    def series(self) -> list[np.ndarray]:
        """Time, maximum velocity and moment rate (M,); slip, velocity, stress, normal stress (M, S) and θ (M, V, S) at
        S stations; displacement and velocity of the surface (M, Q).
        """
        fault, at, near = self.fault, self._between, self._near
        many, width, beside = len(self.samples), len(near), len(self.wanted.surface)
        shapes = [
            (),
            (),
            (),
            (width,),
            (width,),
            (fault.states, width),
            (width,),
            (len(at.depth),),
            (beside,),
            (beside,),
        ]
        columns = list(zip(*self.samples, strict=True)) or [()] * len(shapes)
        arrays = [np.array(column).reshape(many, *shape) for column, shape in zip(columns, shapes, strict=True)]
        time, fastest, rate, excess, w, states, every, normal, *moved = arrays
        slip = at(excess) + fault.plate_rate * time[:, None]
        stress = at(every * friction_of(fault, w, states.swapaxes(0, 1), near))
        slips = np.array(np.broadcast_arrays(fault.dc, fault.dc2))[: fault.states]
        thetas = self.stations(slips) / fault.v0 * np.exp(at(states))
        return [time, fastest, rate, slip, fault.v0 * np.exp(at(w)), stress, normal, thetas, *moved]

    def _add_profile(self, time: float, seismic: bool, fastest: float, excess: np.ndarray, rate: np.ndarray) -> None:
        """Append a slip profile and, for a dipping fault, stress profiles."""
        fault, at = self.fault, self.profile
        stress, normal = np.zeros((2, 0))
        if fault.dips:
            shear, clamped = fault.transfer.tractions(excess)
            stress = at(self.prestress + shear - fault.damping * (rate + fault.plate_rate))
            normal = at(fault.normal_at(time) + clamped)
        self.profiles.append((time, seismic, fastest, at(excess) + fault.plate_rate * time, stress, normal))

    def _profiles(self, before: Moment, now: Moment, first: float, until: float, *, seismic: bool) -> None:
        """Append profiles at `first` and then at regular intervals up to `until`, interpolated within the step."""
        pause = self.wanted.seismic_profiles if seismic else self.wanted.quiet_profiles
        number = int(np.floor((until - first) / pause)) + 1 if until >= first else 0
        if number:
            name = "seismic_profiles" if seismic else "quiet_profiles"
            require_sizes(
                [profiles_size(self.fault, name, pause, len(self.profiles) + number, self.profile.depth.size)]
            )
        for k in range(number):
            time = first + k * pause
            share = (time - before.time) / (now.time - before.time)
            fastest = before.fastest ** (1 - share) * now.fastest**share
            self._add_profile(time, seismic, fastest, hermite(before, now, share), hermite_rate(before, now, share))

    def _crossing(self, before: Moment, now: Moment) -> float:
        """Time at which the maximum slip velocity crosses the threshold, interpolated in ln V."""
        share = np.log(self.wanted.threshold / before.fastest) / np.log(now.fastest / before.fastest)
        return before.time + (now.time - before.time) * float(np.clip(share, 0.0, 1.0))

    def _begin_event(self, before: Moment, now: Moment) -> None:
        cell = int(np.argmax(now.log_velocity))
        fast = now.log_velocity >= now.log_velocity[cell] + np.log(ZONE)
        low = cell - int(np.argmin(fast[cell::-1])) if not fast[: cell + 1].all() else -1
        high = cell + int(np.argmin(fast[cell:])) if not fast[cell:].all() else len(fast)
        self.event = {
            "start": self._crossing(before, now), "before": before, "peak": now.log_velocity.copy(),
            "depth": self.fault.depth[cell], "fastest": now.fastest, "zone": (high - low - 1) * self.fault.cell,
            "arrival": np.full(len(self.fault.depth), np.inf),
        }  # fmt: skip
        self._arrive(before, now)

    def _arrive(self, before: Moment, now: Moment) -> None:
        """Record when cells first reach the threshold velocity, interpolated in ln V."""
        assert self.event is not None
        w, threshold = before.log_velocity, np.log(self.wanted.threshold / self.fault.v0)
        new = np.isinf(self.event["arrival"]) & (now.log_velocity >= threshold)
        gain = now.log_velocity - w
        share = np.clip((threshold - w) / np.where(gain > 0, gain, 1.0), 0.0, 1.0)
        self.event["arrival"][new] = (before.time + (now.time - before.time) * share)[new]

    def _end_event(self, before: Moment, now: Moment) -> None:
        fault, event = self.fault, self.event
        assert event is not None
        begin = event["before"]
        slip = now.excess_slip - begin.excess_slip + fault.plate_rate * (now.time - begin.time)
        moved = fault.depth[np.isfinite(event["arrival"])]
        row = measure_source(fault, self.prestress, begin, now, event["arrival"]) | {
            "start": event["start"], "end": self._crossing(before, now), "depth": event["depth"],
            "nucleation_length": event["zone"], "top": moved[0] - 0.5 * fault.cell,
            "bottom": moved[-1] + 0.5 * fault.cell, "max_velocity": event["fastest"],
            "surface_velocity": fault.v0 * np.exp(event["peak"][0]), "max_slip": slip.max(), "surface_slip": slip[0],
            "first": self.past + len(self.events) == 0,
        }  # fmt: skip
        self.events.append(tuple(row[name] for name in NAMES))
        self.event = None


def hermite(before: Moment, now: Moment, x: float) -> np.ndarray:
    """Interpolate the excess slip within a step from its values and rates at both ends."""
    h = now.time - before.time
    change = now.excess_slip - before.excess_slip
    return before.excess_slip + change * x * x * (3 - 2 * x) + h * x * (1 - x) * ((1 - x) * before.rate - x * now.rate)


def hermite_rate(before: Moment, now: Moment, x: float) -> np.ndarray:
    """Rate of the excess slip within a step: the time derivative of `hermite`."""
    change = (now.excess_slip - before.excess_slip) / (now.time - before.time)
    return 6 * change * x * (1 - x) + (1 - x) * (1 - 3 * x) * before.rate + x * (3 * x - 2) * now.rate
