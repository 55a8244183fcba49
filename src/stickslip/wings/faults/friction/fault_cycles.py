"""Simulation of earthquakes and aseismic slip on a straight fault, and conversion of its history to a dataset.

The time step is controlled by the embedded Runge–Kutta formula DOP853 of order 8, with compiled stages.
`python -m benchmarks fault` compares this method with the solvers of SciPy at equal error.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from ....kit import Report, Size, check_types, checked, readable, require_shape, require_sizes, silent, units_of
from .fault import Fault, check_normal
from .fault_record import YEAR, FaultEvents, Moment, Recorder, Recording, profiles_size
from .fault_state import EXPONENT, NUMBER, STAGES, FaultState, Machine, check_state, initial_state
from .ranges import Positive, Tolerance, allowed

if TYPE_CHECKING:
    import xarray

SAFETY, LEAST, MOST = 0.9, 0.2, 5.0  # safety factor, and limits of the ratio of successive step sizes
TOLERANCE = 1e-4  # tolerated error per step of slip/D_c and of ln θ
MOST_YEARS = 1e6  # about 10,000 earthquakes
REPORTED = 2000  # number of steps between two reports
# fields of `FaultHistory` whose first dimension is neither M samples nor P profiles
ALONE = ("fault", "station", "surface", "profile_depth", "events", "energy", "state", "steps", "rejected")


@readable
class Energy(NamedTuple):
    """Energy balance of a simulation, per length along strike [J/m]: loading = frictional + radiated + elastic."""

    loading: float  # work of the plates
    frictional: float
    radiated: float  # work of radiation damping
    elastic: float  # increase of elastic energy

    @property
    def residual(self) -> float:
        """Integration error: loading minus the other terms, over loading or, if it is larger, dissipation."""
        largest = max(abs(self.loading), self.frictional + self.radiated)
        return (self.loading - self.frictional - self.radiated - self.elastic) / largest


@readable(head=lambda h: f"{len(h.events.start)} events in {h.state.time / YEAR:.6g} years, {h.steps} steps")
class FaultHistory(NamedTuple):
    """History of a fault: M samples at S stations, P profiles at R points, and events."""

    fault: Fault
    time: np.ndarray  # (M,) [s]
    max_velocity: np.ndarray  # (M,) largest slip velocity on the fault [m/s]
    moment_rate: np.ndarray  # (M,) per length along strike [N/s]
    station: np.ndarray  # (S,) depths; values there are interpolated or extrapolated from cell centres [m]
    slip: np.ndarray  # (M, S) [m]
    velocity: np.ndarray  # (M, S) [m/s]
    stress: np.ndarray  # (M, S) frictional shear stress [Pa]
    normal: np.ndarray  # (M, S) effective normal stress [Pa]
    theta: np.ndarray  # (M, S) [s]
    theta2: np.ndarray | None  # (M, S) second state, if the fault has one [s]
    surface: np.ndarray  # (Q,) distances of stations beside a dipping fault from its trace [m]
    horizontal: np.ndarray  # (M, Q) displacement at these stations, positive from the foot wall to the hanging wall [m]
    down: np.ndarray  # (M, Q) vertical displacement, positive downwards [m]
    horizontal_velocity: np.ndarray  # (M, Q) [m/s]
    down_velocity: np.ndarray  # (M, Q) [m/s]
    profile_time: np.ndarray  # (P,) [s]
    profile_seismic: np.ndarray  # (P,) True within events
    profile_max_velocity: np.ndarray  # (P,) [m/s]
    profile_depth: np.ndarray  # (R,) [m]
    profile_slip: np.ndarray  # (P, R) [m]
    profile_stress: np.ndarray | None  # (P, R) shear stress on a dipping fault [Pa]
    profile_normal: np.ndarray | None  # (P, R) effective normal stress on a dipping fault [Pa]
    events: FaultEvents
    energy: Energy
    state: FaultState  # state at the end
    steps: int
    rejected: int

    check_entries = check_types


@checked
def simulate_fault(
    fault: Fault,
    years: Annotated[Positive, allowed(f"at most {MOST_YEARS:g}", lambda years: years <= MOST_YEARS)],
    *,
    start: FaultState | None = None,
    recording: Recording | None = None,
    tolerance: Tolerance = TOLERANCE,
    report: Report = silent,
) -> FaultHistory:
    """Simulate earthquakes and aseismic slip.

    The equations are (1)–(12) of the SEAS benchmark problem BP1-QD (Erickson et al. 2020, doi:10.1785/0220190248), with
    arbitrary properties along the fault.

    Parameters
    ----------
    years : duration in years of 365.25 days; the simulation ends after this time, with the first step outside an event
    start : initial state; default: `initial_state(fault)`; the `state` of a history continues that simulation bit for
        bit
    recording : recorded quantities; default: no stations, profiles of slip every 5 years, and every second in events
    tolerance : tolerated error per step of slip/D_c and of ln θ
    report : called as report(stage, share done, text)

    Raises
    ------
    RuntimeError
        If the step becomes too small.

    Examples
    --------
    >>> from stickslip import friction
    >>> fault = friction.line_fault(10e3, 100.0, a=0.02, b=0.015, dc=8e-3, normal=50e6)
    >>> len(friction.simulate_fault(fault, 10.0).events.start)
    0
    """
    check_normal(fault, years * YEAR)
    recording = recording or Recording()
    check_recording(fault, recording)
    state = initial_state(fault) if start is None else start
    check_state(fault, state)
    require_sizes(_sizes(fault, recording, years * YEAR - state.time))
    recorder = Recorder(fault, recording, state)
    if start is None or not np.isfinite(state.sampled[0]):
        recorder.begin(_moment(fault, state))
    with threadpool_limits(1, "blas"):  # the products involve tables of only a few hundred rows
        end, steps, rejected = _integrate(fault, state, years * YEAR, recorder, tolerance, report)
    return _history(fault, recorder, state, end, steps, rejected)


def check_recording(fault: Fault, recording: Recording) -> None:
    """Raise ValueError if stations or the threshold do not suit a fault."""
    stations, surface = np.asarray(recording.stations, float), np.asarray(recording.surface, float)
    outside = ~((stations >= 0) & (stations <= fault.width))
    if outside.any():
        raise ValueError(f"stations must be at depths from 0 to {fault.width:g} m, got {stations[outside][0]:g} m")
    if len(surface) and not fault.dips:
        raise ValueError("stations at the surface require in-plane shear and boundary = 'surface'")
    if not (np.isfinite(surface) & (surface != 0)).all():
        raise ValueError(
            "surface must contain finite, nonzero distances from the trace (use 0.01 and −0.01 m for its two sides), "
            f"got {recording.surface}"
        )
    if recording.threshold <= fault.plate_rate:
        raise ValueError(
            f"threshold must exceed the plate velocity of {fault.plate_rate:g} m/s, got {recording.threshold:g} m/s: "
            "use a larger one, such as 1e-3"
        )


def _sizes(fault: Fault, recording: Recording, span: float) -> Iterator[Size]:
    """Sizes of a recording over a span of time, apart from the profiles within events."""
    points, quiet = fault.width / recording.spacing + 1, recording.quiet_profiles
    yield Size(f"recording.spacing = {recording.spacing:g} m makes", points, "points", "use a larger spacing")
    yield profiles_size(fault, "quiet_profiles", quiet, span / quiet, points)
    if fault.changes:  # which bound the time step
        pause = recording.quiet_sampling
        yield Size(f"recording.quiet_sampling = {pause:g} s makes", span / pause, "samples", "use a longer interval")


def _integrate(fault: Fault, state: FaultState, until: float, recorder: Recorder, tolerance: float, report):
    """Integrate to the end; return the last state and the numbers of accepted and rejected steps."""
    machine = Machine(fault, state.prestress)
    y, w = state.unknowns, state.log_velocity.copy()
    stages, powers = np.empty((NUMBER + 1, *y.shape)), np.zeros((NUMBER + 1, 3))
    require_shape(y.shape, rates=state.rates)
    stages[0], powers[0], energy = state.rates, state.power, state.energy.copy()
    trial, w_trial = np.empty_like(y), w.copy()
    time, h, last, steps, rejected = state.time, state.step, state.error, 0, 0
    now = _moment(fault, state)
    # times at which a step must end because the normal stress is not smooth; the last is infinite
    breaks = np.array(sorted({np.inf, *(time for change in fault.changes for time in change.breaks)}))
    longest = recorder.wanted.quiet_sampling if fault.changes else np.inf
    while time < until or recorder.event is not None:
        w_trial[:] = w
        h = min(h, longest)
        then, stop = time + h, breaks[np.searchsorted(breaks, time, side="right")]
        if then > stop:
            h, then = stop - time, stop
        error = machine.step(y, w_trial, stages, powers, h, trial, time) / tolerance
        if not error <= 1.0:
            rejected += 1
            h *= max(LEAST, SAFETY * error**-EXPONENT) if np.isfinite(error) else LEAST
            if time + h == time:
                raise RuntimeError(_too_small(fault, time, y[0]))
            continue
        energy += h * (STAGES[-1] @ powers[:-1])
        time, steps = then, steps + 1
        y, trial, w, w_trial = trial, y, w_trial, w
        stages[0], powers[0] = stages[-1], powers[-1]
        error = max(error, 1e-4)
        h *= min(MOST, max(LEAST, SAFETY * (error**-0.7 * last**0.4) ** EXPONENT))
        last = error
        before, now = (
            now,
            Moment(time, y[0].copy(), stages[0, 0].copy(), y[1:], w, fault.v0 * float(np.exp(w.max())), energy.copy()),
        )
        recorder.step(before, now)
        if steps % REPORTED == 0:
            text = f"{time / YEAR:.1f} years, fastest slip {now.fastest:.1e} m/s"
            report("fault", min(1.0, time / until), text)
    end = FaultState(
        time, y[0].copy(), y[1].copy(), w.copy(), state.prestress, stages[0].copy(), powers[0].copy(), energy, h, last,
        recorder.sampled.copy(), y[2].copy() if fault.states > 1 else None, recorder.past + len(recorder.events),
        state.kernel,
    )  # fmt: skip
    return end, steps, rejected


def _too_small(fault: Fault, time: float, excess_slip: np.ndarray) -> str:
    """Error message for a step that became too small."""
    normal = fault.normal_at(time, excess_slip)
    if normal.min() > 1e-3 * fault.normal.min():
        return f"the time step became too small at {time / YEAR:g} years: use shorter cells"
    location = f"{fault.depth[normal.argmin()]:g} m"
    return f"slip opens the fault at {location} after {time / YEAR:g} years: use a larger normal stress there"


def _moment(fault: Fault, state: FaultState) -> Moment:
    fastest = fault.v0 * float(np.exp(state.log_velocity.max()))
    u, *states = state.unknowns
    return Moment(state.time, u, state.rates[0], np.array(states), state.log_velocity, fastest, state.energy)


def _history(fault: Fault, recorder: Recorder, start: FaultState, end: FaultState, steps: int, rejected: int):
    stations, points = recorder.stations.depth, recorder.profile.depth
    surface = np.array(recorder.wanted.surface, float)
    *series, theta, displaced, moving = recorder.series()
    thetas = [*theta.swapaxes(0, 1), None][:2]
    moved = displaced.real, displaced.imag, moving.real, moving.imag
    times, seismic, fastest, *tables_of = list(zip(*recorder.profiles, strict=True)) or [()] * 6
    profiles = [np.array(table, float).reshape(len(times), -1 if times else len(points)) for table in tables_of]
    width = len(FaultEvents._fields)
    events = FaultEvents(*np.array(recorder.events, float).reshape(-1, width).T)
    events = events._replace(first=events.first.astype(bool))
    work = end.energy - start.energy
    energy = Energy(*map(float, work), end.elastic_energy(fault) - start.elastic_energy(fault))
    return FaultHistory(
        fault, *series[:3], stations, *series[3:], *thetas, surface, *moved, np.array(times, float),
        np.array(seismic, bool), np.array(fastest, float), points, profiles[0],
        *(profiles[1:] if fault.dips else (None, None)), events, energy, end, steps, rejected,
    )  # fmt: skip


def join_histories(parts: list[FaultHistory]) -> FaultHistory:
    """Join consecutive histories; each continues the previous one."""
    first, last = parts[0], parts[-1]
    along = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in FaultHistory._fields
        if name not in ALONE and getattr(first, name) is not None
    }
    events = FaultEvents(*(np.concatenate(column) for column in zip(*(part.events for part in parts), strict=True)))
    energy = Energy(*(sum(terms) for terms in zip(*(part.energy for part in parts), strict=True)))
    return first._replace(
        **along, events=events, energy=energy, state=last.state, steps=sum(p.steps for p in parts),
        rejected=sum(p.rejected for p in parts),
    )  # fmt: skip


@checked
def fault_dataset(history: FaultHistory) -> "xarray.Dataset":
    """Convert a history to a dataset with units.

    Variables are max_velocity and moment_rate (time); slip, velocity, stress and theta (time, station); for two states,
    theta2 (time, station); if the normal stress changes, normal (time, station); beside a dipping fault, horizontal,
    down and their velocities (time, surface); profile_slip (profile_time, profile_depth); and the columns of the events
    (event), with the prefix `event_`.

    Examples
    --------
    >>> from stickslip import friction
    >>> fault = friction.line_fault(10e3, 100.0, a=0.02, b=0.015, dc=8e-3, normal=50e6)
    >>> found = friction.simulate_fault(
    ...     fault, 10.0, recording=friction.Recording(stations=(0.0, 5e3))
    ... )
    >>> dict(fault_dataset(found).sizes)["station"]
    2
    """

    known = units_of(FaultEvents) | units_of(FaultHistory)

    def units(name: str) -> dict[str, str]:
        return {"units": known[name]} if name in known else {}

    series, tables = ("max_velocity", "moment_rate"), ["slip", "velocity", "stress", "theta"]
    tables += ["theta2"] if history.theta2 is not None else []
    tables += ["normal"] if history.fault.changes or history.fault.dips else []
    variables = {name: ("time", getattr(history, name), units(name)) for name in series}
    variables |= {name: (("time", "station"), getattr(history, name), units(name)) for name in tables}
    if len(history.surface):
        moved = ("horizontal", "down", "horizontal_velocity", "down_velocity")
        variables |= {name: (("time", "surface"), getattr(history, name), units(name)) for name in moved}
    variables["profile_slip"] = (("profile_time", "profile_depth"), history.profile_slip, units("profile_slip"))
    for name in ("profile_seismic", "profile_max_velocity"):
        variables[name] = ("profile_time", getattr(history, name), units(name))
    for name, values in history.events._asdict().items():
        variables[f"event_{name}"] = ("event", values, units(name))
    axes = ["time", "station", "profile_time", "profile_depth", *(["surface"] if len(history.surface) else [])]
    coordinates = {name: (name, getattr(history, name), units(name)) for name in axes}
    coordinates["event"] = ("event", np.arange(len(history.events.start)), {})
    import xarray as xr

    return xr.Dataset(
        variables,
        coordinates,
        attrs={"law": history.fault.law, "cell": history.fault.cell, "kernel": history.state.kernel},
    )
