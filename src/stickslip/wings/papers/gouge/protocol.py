"""One realisation of a gouge experiment: a trunk that slides steadily, and tests that branch off its states.

The trunk is prepared, slides until friction is steady, and goes through the slides of the protocol. Steps and holds
start from copies of its state, so that they can run in parallel. A slip is an interval during which the upper plate
runs ahead of the load point, in a slide through a soft spring.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from .... import State, run
from ....kit import Checkpoint, Engine, Leg, Report, factors_at, load_or_compute, within
from ....measure import elastic_energy, overlaps, stable_time_step, touching
from ....results import Record
from ...faults.friction.laboratory import steady_mean
from .sample import BOTTOM, TOP, Gouge, Range, attach_spring, gouge_law, make_range, prepare_sample, stiffness
from .scenario import GougeScenario, Slide, SlideHoldSlide, VelocitySteps

DECADE = 20  # samples of a hold per decade of time
TRUNK = "trunk"  # name of the pieces of an unfinished trunk
SKIN = 0.02  # skin of LAMMPS's neighbour lists in mean diameters, the fastest value in `benchmarks/gouge.py`


class Series(NamedTuple):
    """Time series of T rows."""

    time: np.ndarray  # (T,) from the start of sliding [s]
    load_point: np.ndarray  # (T,) displacement of the spring's load point [m]
    slip: np.ndarray  # (T,) displacement of the upper plate along x [m]
    velocity: np.ndarray  # (T,) velocity of the upper plate along x [m/s]
    friction: np.ndarray  # (T,) force of the spring over σ A [1]
    contact_friction: np.ndarray  # (T,) minus the force of the contacts on the upper plate along x, over σ A [1]
    normal: np.ndarray  # (T,) force of the contacts on the upper plate along y, over σ A [1]
    thickness: np.ndarray  # (T,) distance between the mean heights of the plates' grains [m]; growth is dilation
    kinetic_energy: np.ndarray  # (T,) of translations and rotations of the mobile grains [J]
    temperature: np.ndarray  # (T,) granular temperature: mass-weighted mean of v_y² and v_z² of mobile grains [m²/s²]
    coordination: np.ndarray  # (T,) mean number of contacts of grains, plate grains included and rattlers excluded [1]
    sliding_fraction: np.ndarray  # (T,) fraction of contacts at the Coulomb limit [1]
    fabric: np.ndarray  # (T, 3, 3) mean of n ⊗ n over contacts [1]

    def __getitem__(self, rows):
        """Select rows of all columns."""
        return Series(*(column[rows] for column in self))


class Test(NamedTuple):
    """One leg of a protocol, with a constant velocity of the load point.

    A slide leads to the state from which its branch starts. Samples of a hold are means over intervals that grow with
    hold time.
    """

    kind: str  # "steady" (preparation), "slide", "step", "twin" (no step), "hold", "reslide"
    before: float  # velocity of the load point before this leg [m/s]
    velocity: float  # velocity of the load point [m/s]
    hold: float  # duration of the hold just before this leg [s]
    series: Series
    part: int = 0  # entry of the protocol, counted from 0
    branch: int = 0  # index of the state on the trunk
    elastic: float = np.nan  # energy stored in the contacts at the end [J]


class Branch(NamedTuple):
    """State of the trunk from which tests start."""

    part: int  # entry of the protocol
    number: int  # index of the state along the slide
    before: float  # velocity of the load point [m/s]
    place: Gouge


class Trunk(NamedTuple):
    """Realisation without its branches."""

    tests: tuple[Test, ...]
    branches: tuple[Branch, ...]
    states: dict[str, State]  # states "settled", "steady" and "end"
    ledger: dict[str, np.ndarray]  # see `Realization`


class Realization(NamedTuple):
    """Outcome of one sample."""

    seed: int
    range: Range
    tests: tuple[Test, ...]  # tests of the trunk, then of the branches
    states: dict[str, State]  # states "settled", "steady" and "end"
    ledger: dict[str, np.ndarray]  # energies after the protocol, columns of `Ledger`; empty if not requested

    def of(self, *kinds: str) -> list[Test]:
        """Return the tests of given kinds, in the order in which they ran."""
        return [test for test in self.tests if test.kind in kinds]

    def slide_to(self, test: Test) -> Test:
        """Return the slide that leads to the state where a hold, a slide after a hold, or a first step branches off."""
        mine = (test.part, test.branch, test.before)
        return next(t for t in self.of("slide") if (t.part, t.branch, t.velocity) == mine)


def run_trunk(
    scenario: GougeScenario, seed: int, engine: Engine, report: Report, kept: Checkpoint | None = None
) -> Trunk:
    """Prepare one sample and take it through the slides of the protocol.

    Parameters
    ----------
    kept : storage for the sample and pieces of its legs; a killed run resumes from the last piece, with a result
        bitwise identical to that of an uninterrupted run

    Raises
    ------
    RuntimeError
        If the sample does not settle, does not become steady, or becomes unstable.
    """
    kept = kept and kept._replace(nouns=(Gouge, Series))
    return slide_trunk(scenario, settled_sample(scenario, seed, report, kept), engine, report, kept)


def settled_sample(scenario: GougeScenario, seed: int, report: Report, kept: Checkpoint | None) -> Gouge:
    """Return the sample at rest; arguments as in `run_trunk`."""
    return load_or_compute(kept, "settled", partial(prepare_sample, scenario, seed, report=within(report, 0.0, 0.0)))


def slide_trunk(
    scenario: GougeScenario, gouge: Gouge, engine: Engine, report: Report, kept: Checkpoint | None = None
) -> Trunk:
    """Take a settled sample through the slides of the protocol; arguments as in `run_trunk`."""
    legs = _LegRunner(scenario, engine, report, kept, scenario.trunk_duration, f"{scenario.seed}/{TRUNK}")
    place, tests, branches = gouge, [], []
    states, velocity = {"settled": gouge.state}, 0.0
    chosen = scenario.preparation
    if not chosen.steady:
        seconds = chosen.slip * scenario.grains.mean / chosen.velocity
        reached = legs.run(place, chosen.velocity, seconds, "preparation")
    elif not (reached := _run_until_steady(legs, place, chosen.velocity, chosen.slip, chosen.longest)):
        raise RuntimeError(
            f"the sample was not steady after a slip of {chosen.longest:g} D: raise preparation.change or "
            f"preparation.longest"
        )
    place, series, elastic = reached
    tests.append(Test("steady", 0.0, chosen.velocity, 0.0, series, elastic=elastic))
    states["steady"], velocity = place.state, chosen.velocity
    for number, part in enumerate(scenario.protocol):
        for new in part.starts:
            for k, seconds in enumerate(part.trunk(new, scenario.grains.mean)):
                place, series, elastic = _run_slide(legs, place, part, new, seconds)
                tests.append(Test("slide", velocity, new, 0.0, series, number, k, elastic))
                velocity = new
                if part.branches:
                    branches.append(Branch(number, k, new, place))
    states["end"] = place.state
    ledger = _run_ledger(scenario, gouge._replace(state=states["end"])) if scenario.ledger_steps else {}
    return Trunk(tuple(tests), tuple(branches), states, ledger)


def run_branch(
    scenario: GougeScenario, start: Branch, engine: Engine, report: Report, kept: Checkpoint | None = None
) -> tuple[Test, ...]:
    """Run the tests that start from one state of the trunk; arguments and errors as in `run_trunk`."""
    kept = kept and kept._replace(nouns=(Gouge, Series))
    part = scenario.protocol[start.part]
    duration, name = sum(part.branch(start.before, scenario.grains.mean)), f"branch-{start.part}-{start.number}"
    legs = _LegRunner(scenario, engine, report, kept, duration, f"{scenario.seed}/{name}")
    make = _run_steps if isinstance(part, VelocitySteps) else _run_holds
    return tuple(test._replace(part=start.part, branch=start.number) for test in make(legs, start, part))


def make_realization(scenario: GougeScenario, seed: int, trunk: Trunk, tests) -> Realization:
    """Make a `Realization` from a trunk and the tests of its branches, in branch order."""
    everything = (*trunk.tests, *(test for branch in tests for test in branch))
    fastest = max(test.velocity for test in everything)
    state, thickness = trunk.states["steady"], float(trunk.tests[0].series.thickness[-1])
    overlap = _mean_overlap(state) / scenario.grains.mean
    stable = stable_time_step(state, gouge_law(scenario, scenario.law.mu))
    good = make_range(scenario, fastest, thickness, overlap, stable)
    return Realization(seed, good, everything, trunk.states, trunk.ledger)


def _run_until_steady(legs: "_LegRunner", place, velocity: float, least: float, longest: float):
    """Return place, series and elastic energy once sliding is steady, or None if it never is; slips are in D."""
    chosen, size = legs.scenario.preparation, legs.scenario.grains.mean
    parts, slid, wanted = [], 0.0, max(least, 2 * chosen.window)
    while slid < longest:
        place, part, elastic = legs.run(place, velocity, wanted * size / velocity, "to steady sliding")
        parts.append(part)
        slid, wanted = slid + wanted, 0.5 * chosen.window
        series = _concatenate(parts)
        if _is_steady(series, chosen.window * size, chosen.change):
            return place, series, elastic
    return None


def _run_slide(legs: "_LegRunner", place, part, velocity: float, seconds: float):
    """Run one slide of the trunk."""
    if isinstance(part, Slide) and part.steady:
        reached = _run_until_steady(legs, place, velocity, 0.0, part.slip)
        if reached is None:
            raise RuntimeError(f"a slide at {velocity:g} m/s was not steady after {part.slip:g} D")
        return reached
    return legs.run(place, velocity, seconds, f"slide at {velocity:g} m/s")


def _run_steps(legs: "_LegRunner", start: Branch, part: VelocitySteps):
    """Yield the tests of one sequence of velocity steps."""
    size, place, old = legs.scenario.grains.mean, start.place, start.before
    for velocity, slip in zip(part.velocities[1:], part.slips[1:], strict=True):
        stage = f"step from {old:g} to {velocity:g} m/s"
        if part.twin:
            _, series, elastic = legs.run(place, old, part.twin * size / old, f"{stage}, twin")
            yield Test("twin", old, old, 0.0, series, elastic=elastic)
        place, series, elastic = legs.run(place, velocity, slip * size / velocity, stage)
        yield Test("step", old, velocity, 0.0, series, elastic=elastic)
        old = velocity


def _run_holds(legs: "_LegRunner", start: Branch, part: SlideHoldSlide):
    """Yield the tests of one hold, and of the slides after each of its hold times."""
    size, interval, before = legs.scenario.grains.mean, legs.scenario.interval, start.before
    if part.twin:
        _, series, elastic = legs.run(start.place, before, part.twin * size / before, f"slide at {before:g} m/s, twin")
        yield Test("twin", before, before, 0.0, series, elastic=elastic)
    place, parts, last = start.place, [], 0
    for hold in sorted(part.holds):
        until = round(hold / interval)
        place, series, elastic = legs.run(place, 0.0, (until - last) * interval, f"hold after {before:g} m/s")
        parts.append(series)
        last = until
        for after in part.reslides(before):
            stage = f"slide at {after:g} m/s after a hold of {hold:g} s"
            _, series, stored = legs.run(place, after, part.slip * size / after, stage)
            yield Test("reslide", before, after, hold, series, elastic=stored)
    yield Test("hold", before, 0.0, 0.0, _log_binned(_concatenate(parts)), elastic=elastic)


def _log_binned(series: Series) -> Series:
    """Average over intervals that grow with hold time, `DECADE` of them per decade."""
    count = len(series.time)
    edges = np.unique(np.round(np.geomspace(1, count + 1, max(2, round(DECADE * np.log10(count + 1)) + 1))).astype(int))
    starts = edges[:-1] - 1
    sizes = np.diff(np.append(starts, count))
    means = [np.add.reduceat(column, starts) / sizes.reshape(-1, *[1] * (column.ndim - 1)) for column in series]
    return Series(*means)


class _LegRunner:
    """Runs the legs of a trunk or branch in pieces, saves them, and reports progress."""

    def __init__(self, scenario: GougeScenario, engine: Engine, report: Report, kept, duration: float, name: str):
        self.scenario, self.engine, self.report, self.kept, self.name = scenario, engine, report, kept, name
        self.done, self.total, self.number = 0, duration / scenario.dt, 0

    def run(self, place, velocity: float, seconds: float, stage: str):
        """Run a leg in pieces that end with a sample; return place, series and elastic energy at its end."""
        every = self.scenario.sample_every
        samples = max(1, round(seconds / self.scenario.dt / every))
        name, self.number = f"leg-{self.number:04d}", self.number + 1
        pieces = self.kept and self.kept.of(name)

        def run_pieces(place=place) -> tuple[Gouge, Series]:
            parts, first = [], 0
            while first < samples:  # the length of saved pieces depends on the engine that ran them
                steps, piece = min(self.engine.samples, samples - first) * every, f"{first:09d}"
                leg = partial(self._run_leg, place, velocity, steps, f"{self.name}/{name}/{piece}")
                place, part = load_or_compute(pieces, piece, leg)
                parts.append(part)
                first += len(part.time)
                self._report_progress(len(part.time) * every, part, stage)
            return place, _concatenate(parts)

        before = self.done
        place, series = load_or_compute(self.kept, name, run_pieces)
        if pieces:
            pieces.clear()
        if self.done == before:  # the whole leg was loaded
            self._report_progress(samples * every, series, stage)
        return place, series, elastic_energy(place.state, place.law)

    def _run_leg(self, gouge: Gouge, velocity: float, steps: int, name: str) -> tuple[Gouge, Series]:
        """Run a number of steps; the series does not include the sample at the start."""
        leg = slide_leg(self.scenario, gouge, velocity, steps)._replace(name=name, after=gouge.leg)
        ((end, record),) = self.engine.pieces(leg)
        here = gouge._replace(state=leg.state)
        return here._replace(state=end, leg=name), measure_series(record, here)[1:]

    def _report_progress(self, steps: int, series: Series, stage: str) -> None:
        """Report progress and the current state of the sample."""
        self.done += steps
        self.total = max(self.total, self.done)
        self.report(
            stage, self.done / self.total,
            f"load point {series.load_point[-1] * 1e3:.2f} mm, friction {series.friction[-1]:.3f}, "
            f"kinetic energy {series.kinetic_energy[-1]:.1e} J, thickness {series.thickness[-1] * 1e3:.2f} mm, "
            f"{series.sliding_fraction[-1]:.0%} of contacts slide",
        )  # fmt: skip


def _concatenate(parts: list[Series]) -> Series:
    return Series(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _is_steady(series: Series, window: float, change: float) -> bool:
    """Return True if friction over the last window of slip agrees with that over the previous window."""
    slip = series.load_point - series.load_point[-1]
    late, early = slip > -window, (slip > -2 * window) & (slip <= -window)
    begin = slip[0] - (slip[1] - slip[0])  # the first sample is one interval after the start of the slide
    if begin > -2 * window * (1 - 1e-9):
        return False
    a, b = steady_mean(series.friction[early]), steady_mean(series.friction[late])
    return abs(a.mean - b.mean) <= max(change, float(np.hypot(a.error, b.error)))


def slide_leg(scenario: GougeScenario, gouge: Gouge, velocity: float, steps: int) -> Leg:
    """Return the leg in which the load point of the spring moves at a velocity."""
    begin, seconds, ahead = gouge.state.time, steps * scenario.dt, load_point_lead(gouge)
    course = [begin, begin + seconds], [ahead, ahead + velocity * seconds]
    state = attach_spring(gouge, stiffness(scenario) * scenario.area, *course).state
    skin = SKIN * gouge.diameter / (2 * float(state.grains.radius.mean()))
    return Leg(state, gouge.law, scenario.dt, steps, every=scenario.sample_every, skin_diameters=skin)


def _run_ledger(scenario: GougeScenario, gouge: Gouge) -> dict[str, np.ndarray]:
    """Record energies with this package's engine while the spring moves at the velocity of the preparation."""
    begin, velocity = gouge.state.time, scenario.preparation.velocity
    seconds, ahead = scenario.ledger_steps * scenario.dt, load_point_lead(gouge)
    here = attach_spring(
        gouge, stiffness(scenario) * scenario.area, [begin, begin + seconds], [ahead, ahead + velocity * seconds]
    )
    every = max(1, min(scenario.sample_every, scenario.ledger_steps // 10))
    _, record, outcome = run(
        here.state, here.law, scenario.ledger_steps, scenario.dt, every=every, ledger=True, threads=1
    )
    if not outcome.ok:
        raise RuntimeError(f"the run stopped while its energies were recorded: {outcome}")
    return {"time": record.time, **record.ledger._asdict(), "defect": record.ledger.defect}


def load_point_lead(place: Gouge) -> float:
    """Displacement of the load point from the point where the spring was attached [m]."""
    control = place.state.control
    if not control.spring[place.top, 0].any():
        return 0.0
    return float(factors_at(control, place.state.time)[control.leads[place.top[0], 0]])


def measure_series(record: Record, gouge: Gouge) -> Series:
    """Return the series for a record of gouge with an attached spring."""
    state, lead = gouge.state, gouge.state.control.leads[gouge.top[0], 0]
    load_point = np.array([factors_at(state.control, time)[lead] for time in record.time])
    grains, top, whole = gouge.state.grains, gouge.top, gouge.normal_stress * gouge.area
    moved, loose = grains.mass[top].sum(), grains.mass[gouge.loose].sum()
    velocity, force = record.group_velocity[:, TOP], record.group_force[:, TOP]
    flux = record.momentum_flux[:, 1, 1] + record.momentum_flux[:, 2, 2] - moved * velocity[:, 1] ** 2
    return Series(
        record.time, load_point, record.group_position[:, TOP, 0] - gouge.state.control.anchor[top, 0].mean(),
        velocity[:, 0], record.group_pull[:, TOP, 0] / whole, -force[:, 0] / whole, force[:, 1] / whole,
        record.group_position[:, TOP, 1] - record.group_position[:, BOTTOM, 1],
        record.kinetic_energy - 0.5 * moved * (velocity**2).sum(axis=1), flux / (2 * loose), record.held_coordination,
        record.sliding_fraction, record.fabric,
    )  # fmt: skip


def _mean_overlap(state: State) -> float:
    """Mean overlap of all contacts [m]."""
    rows = touching(state)
    return float(overlaps(state)[rows].mean()) if len(rows) else 0.0


JOINED = 0.01  # displacement of the load point within which rebounds after a slip belong to this slip [D]


class Slips(NamedTuple):
    """K slips in slides at constant velocity of the load point.

    A slip begins with the first sample at which the plate moves faster than `threshold` times the load point, and ends
    with the first sample at which it is no longer faster than the load point. Rebounds that begin before the load point
    has moved by 0.01 D belong to the slip. Slips not completely within a slide are excluded.
    """

    realization: np.ndarray  # (K,) seed
    load_velocity: np.ndarray  # (K,) velocity of the load point [m/s]
    time: np.ndarray  # (K,) time of the last sample before the slip, from the start of sliding [s]
    load_point: np.ndarray  # (K,) displacement of the load point at that time [m]
    duration: np.ndarray  # (K,) [s]
    slip: np.ndarray  # (K,) displacement of the plate [m]
    drop: np.ndarray  # (K,) decrease of friction, the force of the spring over σ A [1]
    velocity: np.ndarray  # (K,) largest velocity of the plate [m/s]


def find_slips(realizations: tuple[Realization, ...], threshold: float, diameter: float) -> Slips:
    """Find the slips in all slides of several realisations.

    Parameters
    ----------
    threshold : ratio of plate to load-point velocity above which the plate slips
    diameter : D [m]
    """
    rows = [
        (sample.seed, test.velocity, *_measure(test, begin, end))
        for sample in realizations
        for test in sample.of("slide")
        if test.velocity > 0
        for begin, end in _slips_of(test, threshold, JOINED * diameter)
    ]
    return Slips(*np.array(rows, float).reshape(-1, len(Slips._fields)).T)


def _slips_of(test: Test, threshold: float, joined: float) -> list[tuple[int, int]]:
    """Return the first sample of each slip and the first after it; slips closer than `joined` are merged."""
    series, last = test.series, len(test.series.time)
    fast = np.flatnonzero(series.velocity > threshold * test.velocity)
    slow = np.flatnonzero(series.velocity <= test.velocity)
    out: list[tuple[int, int]] = []
    for begin in fast:
        if out and begin < out[-1][1]:
            continue
        later = slow[slow > begin]
        end = int(later[0]) if len(later) else last
        if out and series.load_point[begin] - series.load_point[min(out[-1][1], last - 1)] < joined:
            begin = out.pop()[0]
        out.append((int(begin), end))
    return [(begin, end) for begin, end in out if begin > 0 and end < last]


def _measure(test: Test, begin: int, after: int) -> tuple:
    """Return time, load point, duration, slip, drop and largest velocity of one slip."""
    series, before = test.series, begin - 1
    return (
        series.time[before],
        series.load_point[before],
        series.time[after] - series.time[before],
        series.slip[after] - series.slip[before],
        series.friction[before] - series.friction[after],
        series.velocity[begin:after].max(),
    )
