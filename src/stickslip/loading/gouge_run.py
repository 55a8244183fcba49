"""One realization of a gouge experiment: prepared, slid to steadiness, then taken through its protocol."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..core.control import factors_at
from ..core.integrate import run
from ..core.measure import branches, touching
from ..core.record import Record
from ..core.state import State
from ..core.timestep import stable_time_step
from ..data.gouge_scenario import GougeScenario, Slide, SlideHoldSlide, VelocitySteps
from ..data.kept import Kept, piece
from ..friction.measure import steady
from .gouge import BOTTOM, TOP, Gouge, settled, sprung
from .gouge_numbers import Range, range_of, stiffness

CHUNK = 100  # samples between two words of progress
Tell = Callable[[float, str], None]


class Series(NamedTuple):
    """What was measured, T rows."""

    time: np.ndarray  # (T,) from the start of sliding [s]
    load_point: np.ndarray  # (T,) displacement of the spring's load point [m]
    slip: np.ndarray  # (T,) displacement of the upper plate along x [m]
    velocity: np.ndarray  # (T,) of the upper plate along x [m/s]
    friction: np.ndarray  # (T,) force of the spring over σ A
    contact_friction: np.ndarray  # (T,) −force of the contacts on the upper plate along x over σ A
    normal: np.ndarray  # (T,) force of the contacts on the upper plate along y over σ A
    thickness: np.ndarray  # (T,) between the mean heights of the plates' grains [m]; its growth is dilation
    kinetic_energy: np.ndarray  # (T,) of the mobile grains, translations and rotations [J]
    temperature: np.ndarray  # (T,) granular: mean of v_y² and v_z² of the mobile grains, by mass [m²/s²]
    coordination: np.ndarray  # (T,) contacts of a grain that is no rattler, plates' grains included
    sliding_fraction: np.ndarray  # (T,) share of contacts at Coulomb's limit
    fabric: np.ndarray  # (T, 3, 3) mean of n ⊗ n over contacts

    def __getitem__(self, rows):
        """Rows of all columns."""
        return Series(*(column[rows] for column in self))


class Test(NamedTuple):
    """One leg of a protocol: from when the load point takes a velocity until it takes another."""

    kind: str  # "steady" (preparation), "slide", "step", "twin" (no step), "hold", "reslide"
    before: float  # velocity of the load point until here [m/s]
    velocity: float  # of the load point [m/s]
    hold: float  # time held just before [s]
    series: Series


class Realization(NamedTuple):
    """What became of one sample."""

    seed: int
    range: Range
    tests: tuple[Test, ...]
    states: dict[str, State]  # settled, steady, end
    ledger: dict[str, np.ndarray]  # energies at the end of the protocol, columns of `Ledger`; empty if not asked for

    def of(self, *kinds: str) -> list[Test]:
        """Tests of some kinds, in the order in which they ran."""
        return [test for test in self.tests if test.kind in kinds]


class Engine(NamedTuple):
    """What runs legs: `start` from a settled sample, `leg` for some steps at a velocity, `state` as ours has it.

    A place that `start` or `leg` returned stays valid: legs may branch from it, in another process, too.
    """

    start: Callable[[GougeScenario, Gouge], Any]  # -> place
    leg: Callable[[GougeScenario, Any, float, int], tuple[Any, Series]]  # place, velocity, steps -> place, series
    state: Callable[[Any], Any]  # place -> State
    nouns: tuple[type, ...]  # classes of NamedTuples in a place


def realization(
    scenario: GougeScenario, seed: int, engine: Engine, tell: Tell, kept: Kept | None = None
) -> Realization:
    """Prepare one sample and take it through the protocol.

    Parameters
    ----------
    kept : where the sample and pieces of its legs are kept; one that was killed goes on from the last of them, to the
        bits of one that was not

    Raises
    ------
    RuntimeError
        with one sentence, if the sample does not settle, does not become steady, or blows up.
    """
    done, total = 0.1 * scenario.steps, 1.1 * scenario.steps
    kept = kept and kept._replace(nouns=(Gouge, Series, *engine.nouns))

    def say(stage, share, words):
        tell(share / 33, f"{stage}: {words}")

    gouge = piece(kept, "settled", lambda: settled(scenario, seed, report=say))
    runner = _Runner(scenario, engine, tell, kept, done, total)
    place = engine.start(scenario, gouge)
    states = {"settled": gouge.state}
    place = runner.steady(place)
    states["steady"] = engine.state(place)
    for part in scenario.protocol:
        place = runner.part(place, part)
    states["end"] = engine.state(place)
    fastest = max(test.velocity for test in runner.tests)
    state = states["steady"]
    overlap, thickness = _mean_overlap(state) / scenario.grains.mean, float(runner.tests[0].series.thickness[-1])
    found = range_of(scenario, fastest, thickness, overlap, stable_time_step(state, gouge.law))
    counted = scenario.ledger_steps and engine is OURS  # states of other engines have no memory of contacts
    ledger = _ledger(scenario, gouge._replace(state=states["end"])) if counted else {}
    return Realization(seed, found, tuple(runner.tests), states, ledger)


class _Runner:
    """The protocol of one realization, with what it has measured so far."""

    def __init__(self, scenario: GougeScenario, engine: Engine, tell: Tell, kept: Kept | None, done, total):
        self.scenario, self.engine, self.tell, self.kept = scenario, engine, tell, kept
        self.done, self.total, self.legs = done, total, 0
        self.tests: list[Test] = []
        self.velocity = 0.0

    def part(self, place, part):
        """One entry of the protocol; returns the place from which the next goes on."""
        if isinstance(part, Slide):
            return self._slide(place, part)
        if isinstance(part, VelocitySteps):
            return self._steps(place, part)
        return self._holds(place, part)

    def steady(self, place):
        """Slide until two windows of friction agree."""
        chosen = self.scenario.preparation
        place, series = self._until_steady(place, chosen.velocity, chosen.slip, chosen.longest)
        if series is None:
            raise RuntimeError(
                f"the sample was not steady after a slip of {chosen.longest:g} D: allow more change or a longer slip"
            )
        self._keep("steady", 0.0, chosen.velocity, 0.0, series)
        return place

    def _until_steady(self, place, velocity: float, least: float, longest: float):
        """Place and series once steady, or series None; slips in D."""
        chosen, size = self.scenario.preparation, self.scenario.grains.mean
        parts, slid, wanted = [], 0.0, max(least, 2 * chosen.window)
        while slid < longest:
            place, part = self._leg(place, velocity, wanted * size / velocity, "to steady sliding")
            parts.append(part)
            slid, wanted = slid + wanted, 0.5 * chosen.window
            series = _joined(parts)
            if _is_steady(series, chosen.window * size, chosen.change):
                return place, series
        return place, None

    def _slide(self, place, part: Slide):
        if part.steady:
            place, series = self._until_steady(place, part.velocity, 0.0, part.slip)
            if series is None:
                raise RuntimeError(f"a slide at {part.velocity:g} m/s was not steady after {part.slip:g} D")
        else:
            seconds = part.time or part.slip * self.scenario.grains.mean / part.velocity
            place, series = self._leg(place, part.velocity, seconds, f"slide at {part.velocity:g} m/s")
        self._keep("slide", self.velocity, part.velocity, 0.0, series)
        return place

    def _steps(self, place, part: VelocitySteps):
        size = self.scenario.grains.mean
        for k, velocity in enumerate(part.velocities):
            words = f"step from {self.velocity:g} to {velocity:g} m/s"
            if k and part.twin:
                _, series = self._leg(place, self.velocity, part.twin * size / self.velocity, f"{words}, twin")
                self._keep("twin", self.velocity, self.velocity, 0.0, series, went_on=False)
            place, series = self._leg(place, velocity, part.slip * size / velocity, words)
            self._keep("step" if k else "slide", self.velocity, velocity, 0.0, series)
        return place

    def _holds(self, place, part: SlideHoldSlide):
        size = self.scenario.grains.mean
        for before in part.before:
            place, series = self._leg(place, before, part.approach * size / before, f"slide at {before:g} m/s")
            self._keep("slide", self.velocity, before, 0.0, series)
            if part.twin:
                _, series = self._leg(place, before, part.twin * size / before, f"slide at {before:g} m/s, no hold")
                self._keep("twin", before, before, 0.0, series, went_on=False)
            held, parts, last, interval = place, [], 0, self.scenario.interval
            for hold in sorted(part.holds):
                until = round(hold / interval)
                held, series = self._leg(held, 0.0, (until - last) * interval, f"hold after {before:g} m/s")
                parts.append(series)
                last = until
                for after in part.after or (before,):
                    words = f"slide at {after:g} m/s after a hold of {hold:g} s"
                    _, again = self._leg(held, after, part.slip * size / after, words)
                    self._keep("reslide", before, after, hold, again, went_on=False)
            self._keep("hold", before, 0.0, 0.0, _joined(parts), went_on=False)
        return place

    def _leg(self, place, velocity: float, seconds: float, words: str):
        """A leg, in pieces between which progress is told; each ends with a sample."""
        every = self.scenario.sample_every
        samples = max(1, round(seconds / self.scenario.dt / every))
        name, self.legs = f"leg-{self.legs:04d}", self.legs + 1
        pieces = self.kept and self.kept.of(name)

        def run_pieces(place=place):
            parts = []
            for first in range(0, samples, CHUNK):
                steps = min(CHUNK, samples - first) * every
                leg = partial(self.engine.leg, self.scenario, place, velocity, steps)
                place, part = piece(pieces, f"{first:09d}", leg)
                parts.append(part)
                self._went(steps, part, words)
            return place, _joined(parts)

        before = self.done
        place, series = piece(self.kept, name, run_pieces)
        if pieces:
            pieces.clear()
        if self.done == before:  # all of it was kept
            self._went(samples * every, series, words)
        return place, series

    def _went(self, steps: int, series: Series, words: str) -> None:
        """Tell how far it is, and what the sample does."""
        self.done += steps
        self.total = max(self.total, self.done)
        self.tell(
            self.done / self.total,
            f"{words}: load point {series.load_point[-1] * 1e3:.2f} mm, friction {series.friction[-1]:.3f}, "
            f"kinetic energy {series.kinetic_energy[-1]:.1e} J, thickness {series.thickness[-1] * 1e3:.2f} mm, "
            f"{series.sliding_fraction[-1]:.0%} of contacts slide",
        )

    def _keep(self, kind, before, velocity, hold, series, *, went_on=True):
        self.tests.append(Test(kind, before, velocity, hold, series))
        self.velocity = velocity if went_on else self.velocity


def _joined(parts: list[Series]) -> Series:
    return Series(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _is_steady(series: Series, window: float, change: float) -> bool:
    """Whether friction over the last window of slip is that over the window before."""
    slip = series.load_point - series.load_point[-1]
    late, early = slip > -window, (slip > -2 * window) & (slip <= -window)
    begin = slip[0] - (slip[1] - slip[0])  # samples begin one interval after the slide did
    if begin > -2 * window * (1 - 1e-9):
        return False
    a, b = steady(series.friction[early]), steady(series.friction[late])
    return abs(a.mean - b.mean) <= max(change, float(np.hypot(a.error, b.error)))


def _start(scenario: GougeScenario, gouge: Gouge) -> Gouge:
    """A settled sample, on its spring."""
    return sprung(gouge, stiffness(scenario) * scenario.area, [gouge.state.time], [0.0])


def _leg(scenario: GougeScenario, place: Gouge, velocity: float, steps: int) -> tuple[Gouge, Series]:
    """Some steps of our own engine, sampled, without the sample at their start."""
    begin, seconds, ahead = place.state.time, steps * scenario.dt, lead(place)
    course = np.array([begin, begin + seconds]), np.array([ahead, ahead + velocity * seconds])
    here = sprung(place, stiffness(scenario) * scenario.area, *course)
    end, record, outcome = run(here.state, here.law, steps, scenario.dt, every=scenario.sample_every, threads=1)
    if not outcome.ok:
        raise RuntimeError(f"the sample ended at time {end.time:.4g}: {outcome}")
    return here._replace(state=end), _series(record, here, np.interp(record.time, *course))[1:]


def _ledger(scenario: GougeScenario, gouge: Gouge) -> dict[str, np.ndarray]:
    """Energies while the spring goes on at the velocity of preparation, with our own engine."""
    begin, velocity = gouge.state.time, scenario.preparation.velocity
    seconds, ahead = scenario.ledger_steps * scenario.dt, lead(gouge)
    here = sprung(
        gouge, stiffness(scenario) * scenario.area, [begin, begin + seconds], [ahead, ahead + velocity * seconds]
    )
    every = max(1, min(scenario.sample_every, scenario.ledger_steps // 10))
    _, record, outcome = run(
        here.state, here.law, scenario.ledger_steps, scenario.dt, every=every, ledger=True, threads=1
    )
    if not outcome.ok:
        raise RuntimeError(f"the sample ended while its energies were counted: {outcome}")
    return {"time": record.time, **record.ledger._asdict(), "defect": record.ledger.defect}


def lead(place: Gouge) -> float:
    """How far the load point is from where the spring was attached [m]."""
    control = place.state.control
    return float(factors_at(control, place.state.time)[control.leads[place.top[0], 0]])


def _series(record: Record, gouge: Gouge, load_point: np.ndarray) -> Series:
    grains, top, whole = gouge.state.grains, gouge.top, gouge.normal_stress * gouge.area
    moved, loose = grains.mass[top].sum(), grains.mass[gouge.loose].sum()
    velocity, force = record.group_velocity[:, TOP], record.group_force[:, TOP]
    flux = record.momentum_flux[:, 1, 1] + record.momentum_flux[:, 2, 2] - moved * velocity[:, 1] ** 2
    return Series(
        record.time,
        load_point,
        record.group_position[:, TOP, 0] - gouge.state.control.anchor[top, 0].mean(),
        velocity[:, 0],
        record.group_pull[:, TOP, 0] / whole,
        -force[:, 0] / whole,
        force[:, 1] / whole,
        record.group_position[:, TOP, 1] - record.group_position[:, BOTTOM, 1],
        record.kinetic_energy - 0.5 * moved * (velocity**2).sum(axis=1),
        flux / (2 * loose),
        record.held_coordination,
        record.sliding_fraction,
        record.fabric,
    )


def _mean_overlap(state: State) -> float:
    """Of all contacts [m]."""
    rows = touching(state)
    i, j, radius = state.contacts.i[rows], state.contacts.j[rows], state.grains.radius
    distance = np.linalg.norm(branches(state)[rows], axis=1)
    return float((radius[i] + radius[j] - distance).mean()) if len(rows) else 0.0


OURS = Engine(_start, _leg, lambda place: place.state, (Gouge,))
