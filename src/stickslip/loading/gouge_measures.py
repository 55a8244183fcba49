"""What a gouge experiment shows: means over realizations against slip or time, peaks, healing, compaction.

Errors are standard errors over realizations. Several tests of one kind in one realization are averaged first.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from ..friction.loads import Leg
from ..friction.measure import Mean, steady
from ..friction.model import Data
from .gouge_ensemble import GougeResult
from .gouge_run import Realization, Test

POINTS = 200  # of a mean curve
EARLIEST = 1e-3  # of a hold, from which on its logarithm of time is followed
EARLY = 0.05  # slip of the load point in which state hardly changes: 3 % of the dc of paper 003 [D]
DRAWS = 400  # of realizations, with replacement, for the error of what is read off a mean curve


class Curve(NamedTuple):
    """Realizations of one thing on one grid, and their mean."""

    x: np.ndarray  # (G,)
    rows: np.ndarray  # (R, G), one for each realization
    label: str

    @property
    def mean(self) -> np.ndarray:
        """(G,) over realizations."""
        return self.rows.mean(axis=0)

    @property
    def band(self) -> np.ndarray:
        """(G,) two standard deviations over realizations; zero with one of them."""
        return 2 * self.rows.std(axis=0, ddof=1) if len(self.rows) > 1 else np.zeros(len(self.x))

    @property
    def error(self) -> np.ndarray:
        """(G,) standard error of the mean; NaN with one realization."""
        return self.band / 2 / np.sqrt(len(self.rows)) if len(self.rows) > 1 else np.full(len(self.x), np.nan)

    def at(self, k: int) -> "Number":
        """The mean at one point."""
        return _read_off(self.rows, lambda mean: mean[k])


class Number(NamedTuple):
    """A number that rests on realizations: its standard error is NaN with one of them.

    `draws` are its values for realizations drawn again with replacement, the same ones for all numbers of a result.
    """

    value: float
    error: float
    realizations: int
    draws: np.ndarray  # (DRAWS,), or (0,) with one realization

    def __repr__(self) -> str:
        return f"Number({self.value:.4g} ± {self.half:.2g}, 95 %, {self.realizations} realizations)"

    @property
    def half(self) -> float:
        """Half width of its 95 % interval by Student's t: with two realizations 12.7 standard errors."""
        return self.error * float(student.ppf(0.975, self.realizations - 1)) if self.realizations > 1 else np.nan


def steady_friction(found: Realization, velocity: float, window: float) -> Mean | None:
    """Mean friction of a realization at a velocity; None if it was never steady there.

    From the last two windows [m] of the preparation, from slides that went on at this velocity, and from the second
    halves of those that had just come to it. The error respects the correlation of friction along the slip; see
    `friction.measure.steady`.
    """
    pieces = []
    for test in found.of("steady", "slide", "step"):
        series = test.series
        if test.velocity != velocity:
            continue
        late = series.load_point > series.load_point[-1] - 2 * window
        if test.kind != "steady":
            late = slice(0 if test.before == velocity else len(late) // 2, None)
        pieces.append(series.friction[late])
    return steady(np.concatenate(pieces)) if pieces else None


def velocities(result: GougeResult) -> list[float]:
    """Velocities at which friction is steady somewhere, slowest first."""
    found = {t.velocity for one in result.realizations for t in one.of("steady", "slide", "step")}
    return sorted(v for v in found if v > 0)


def mean_friction(result: GougeResult, velocity: float) -> Number:
    """Mean over realizations of the steady friction at a velocity.

    The error is the scatter of realizations over √R, or with one of them the error of its own mean.
    """
    means = _levels(result, velocity)
    found = _read_off(np.array([[m.mean] for m in means]), lambda mean: mean[0])
    return found._replace(error=means[0].error) if len(means) == 1 else found


def _levels(result: GougeResult, velocity: float) -> list[Mean]:
    """Steady friction of every realization at a velocity."""
    window = result.scenario.preparation.window * result.scenario.grains.mean
    return [steady_friction(one, velocity, window) for one in result.realizations]


def steps(result: GougeResult) -> list[tuple[float, float]]:
    """Velocity steps (before, after) that the protocol holds, each once."""
    return list(dict.fromkeys((t.before, t.velocity) for t in result.realizations[0].of("step")))


def step_curve(result: GougeResult, before: float, after: float, *, twin: bool) -> Curve | None:
    """Friction after a velocity step against the load point's slip [D].

    With `twin`, less that of the copy that went on at the old velocity; else less the mean steady friction at the new
    velocity over the second half of the slip. Several such steps of one realization are averaged first.
    """
    rows, grid = [], None
    for one in result.realizations:
        pairs = [(t, _twin_of(one, t) if twin else None) for t in one.of("step")]
        pairs = [(t, c) for t, c in pairs if (t.before, t.velocity) == (before, after) and (c is not None or not twin)]
        if not pairs:
            return None
        if grid is None:
            grid = _grid(_slid(result, one)[-1] for pair in pairs for one in pair if one is not None)
        rows.append(np.mean([_stepped(result, t, c, grid) for t, c in pairs], axis=0))
    return Curve(grid, np.array(rows), f"{before:g} → {after:g} m/s")


def _grid(ends) -> np.ndarray:
    """Slips up to the shortest of some [D], close enough to average over the first `EARLY` of them."""
    end = float(min(ends))
    return np.linspace(0, end, max(POINTS, int(20 * end / EARLY)))


def _twin_of(one: Realization, step: Test) -> Test | None:
    """The copy that went on from where a step was made: what ran just before it."""
    twin = _before(one, step)[-1]
    return twin if twin.kind == "twin" else None


def _before(one: Realization, test: Test) -> tuple[Test, ...]:
    """Everything that ran before a test."""
    return one.tests[: next(k for k, other in enumerate(one.tests) if other is test)]


def _slid(result: GougeResult, test: Test) -> np.ndarray:
    """Slip of the load point since the test began, over D; samples are even, and the first is one interval in."""
    series = test.series
    begin = series.load_point[0] - (series.load_point[1] - series.load_point[0])
    return (series.load_point - begin) / result.scenario.grains.mean


def _stepped(result: GougeResult, step: Test, twin: Test | None, grid) -> np.ndarray:
    slip, friction = _slid(result, step), step.series.friction
    if twin is None:
        return np.interp(grid, slip, friction) - friction[len(friction) // 2 :].mean()
    return np.interp(grid, slip, friction) - np.interp(grid, _slid(result, twin), twin.series.friction)


def direct_effect(curve: Curve, before: float, after: float) -> Number:
    """Change of friction just after a step over ln(V2/V1): about the a that a laboratory would read off."""
    found, size = just_after(curve), np.log(after / before)
    return Number(found.value / size, found.error / abs(size), found.realizations, found.draws / size)


def just_after(curve: Curve) -> Number:
    """Mean over slips up to `EARLY`: a fixed window, since the largest of what fluctuates would always be positive."""
    near = curve.x <= EARLY
    return _read_off(curve.rows, lambda mean: mean[near].mean())


def holds(result: GougeResult) -> list[float]:
    """Velocities before holds."""
    return sorted({t.before for t in result.realizations[0].of("hold")})


def hold_curve(result: GougeResult, before: float, column: str = "friction") -> Curve:
    """Change of a column since a hold began, against the time held [s], on a logarithmic grid.

    Of the holds after one velocity the longest count; several of one realization are averaged first. The start is the
    last sample before the hold.
    """
    rows, grid = [], None
    for one in result.realizations:
        tests = [t for t in one.of("hold") if t.before == before]
        longest = max(_held(result, t)[-1] for t in tests)
        tests = [t for t in tests if _held(result, t)[-1] > longest * (1 - 1e-6)]
        if grid is None:
            last = min(_held(result, t)[-1] for t in tests)
            grid = np.geomspace(max(EARLIEST * last, _held(result, tests[0])[0]), last, POINTS)
        mine = []
        for test in tests:
            values = getattr(test.series, column)
            mine.append(np.interp(grid, _held(result, test), values) - _just_before(one, test, column))
        rows.append(np.mean(mine, axis=0))
    return Curve(grid, np.array(rows), f"$V_i$ = {before:g} m/s")


def _held(result: GougeResult, test: Test) -> np.ndarray:
    """Time since a test began [s]."""
    series, scenario = test.series, result.scenario
    return series.time - series.time[0] + scenario.sample_every * scenario.dt


def _just_before(one: Realization, hold: Test, column: str) -> float:
    """The last sample of the slide that a hold ended."""
    slide = next(t for t in reversed(_before(one, hold)) if t.kind == "slide" and t.velocity == hold.before)
    return float(getattr(slide.series, column)[-1])


def compaction(result: GougeResult, before: float) -> Number:
    """How much thinner the layer gets in a hold, per e-fold of time, over its thickness."""
    curve = hold_curve(result, before, "thickness")
    late = curve.x > 0.05 * curve.x[-1]
    thickness = np.mean([one.tests[0].series.thickness[-1] for one in result.realizations])
    return _read_off(curve.rows, lambda mean: -np.polyfit(np.log(curve.x[late]), mean[late], 1)[0] / thickness)


def reslides(result: GougeResult) -> list[tuple[float, float, float]]:
    """(velocity before, hold, velocity after) of all slides after holds, each once."""
    return sorted({(t.before, t.hold, t.velocity) for t in result.realizations[0].of("reslide")})


def reslide_curve(result: GougeResult, before: float, hold: float, after: float, *, twin: bool = False) -> Curve | None:
    """Friction after a hold against the load point's slip [D], less each sample's steady friction before it.

    With `twin`, less that of the copy that went on without a hold; None if there was none.
    """
    rows, grid = [], None
    for one, level in zip(result.realizations, (m.mean for m in _levels(result, before)), strict=True):
        tests = [t for t in one.of("reslide") if (t.before, t.hold, t.velocity) == (before, hold, after)]
        twins = [_twin_without_hold(one, t) for t in tests] if twin else [None] * len(tests)
        if twin and None in twins:
            return None
        if grid is None:
            grid = _grid(_slid(result, t)[-1] for t in (*tests, *twins) if t is not None)
        mine = [np.interp(grid, _slid(result, t), t.series.friction) - level for t in tests]
        if twin:
            mine = [
                row + level - np.interp(grid, _slid(result, c), c.series.friction)
                for row, c in zip(mine, twins, strict=True)
            ]
        rows.append(np.mean(mine, axis=0))
    return Curve(grid, np.array(rows), f"$V_r$ = {after:g} m/s, $t$ = {hold:g} s")


def _twin_without_hold(one: Realization, reslide: Test) -> Test | None:
    """The copy that went on from where the hold before a slide began."""
    last = next((test for test in reversed(_before(one, reslide)) if test.kind in ("twin", "slide")), None)
    return last if last is not None and last.kind == "twin" else None


def peak(curve: Curve) -> Number:
    """Largest value of the mean curve."""
    return _read_off(curve.rows, lambda mean: mean.max())


def _read_off(rows: np.ndarray, read) -> Number:
    """A number read off the mean of (R, G) rows, with its error by drawing realizations again (bootstrap)."""
    value, number = float(read(rows.mean(axis=0))), len(rows)
    if number == 1:
        return Number(value, np.nan, 1, np.zeros(0))
    rng = np.random.default_rng(0)
    draws = np.array([read(rows[rng.integers(number, size=number)].mean(axis=0)) for _ in range(DRAWS)])
    return _drawn(value, number, draws)


def _drawn(value: float, number: int, draws: np.ndarray) -> Number:
    wider = np.sqrt(number / (number - 1))  # what is drawn from a sample scatters less than what that was drawn from
    return Number(value, float(wider * draws.std(ddof=1)), number, draws)


def combined(numbers: list[Number], read) -> Number:
    """read(values) of numbers of one result, with the error that realizations drawn again for all at once give."""
    value, number = float(read(np.array([n.value for n in numbers]))), numbers[0].realizations
    if number == 1:
        return Number(value, np.nan, 1, np.zeros(0))
    return _drawn(value, number, np.array([read(one) for one in np.array([n.draws for n in numbers]).T]))


def average(numbers: list[Number]) -> Number:
    """Mean of numbers of one result."""
    return combined(numbers, np.mean)


def slope(x, numbers: list[Number]) -> Number:
    """Slope of a straight line through numbers of one result, least squares; at least two different x."""
    x = np.asarray(x, float)
    if len(set(x.tolist())) < 2:
        raise ValueError(f"a slope through {len(x)} points was asked for: give at least two different x")
    centred = x - x.mean()
    return combined(numbers, lambda y: centred @ y / (centred @ centred))


class Steps(NamedTuple):
    """A slide and the velocity steps after it, as a record of a laboratory."""

    seed: int  # of the realization
    part: int  # of its protocol, counted from 0
    data: Data


def step_records(result: GougeResult, *, samples: int = 400) -> list[Steps]:
    """Velocity steps of every realization as records: friction against time, with the legs of the load.

    Parameters
    ----------
    samples : of each record at most, as many in each leg, means over neighbouring ones
    """
    found = []
    for one in result.realizations:
        tests = one.of("slide", "step")
        starts = [k for k in range(len(tests) - 1) if tests[k].kind == "slide" and tests[k + 1].kind == "step"]
        for part, first in enumerate(starts):
            last = next((k for k in range(first + 1, len(tests)) if tests[k].kind != "step"), len(tests))
            found.append(Steps(one.seed, part, _record(tests[first:last], samples)))
    return found


def _record(chain: list[Test], samples: int) -> Data:
    """The record of a chain. After a hold it begins in the middle of the first leg, where sliding is steady again."""
    time, friction, legs, start = [], [], [], 0.0
    for number, test in enumerate(chain):
        interval = float(test.series.time[1] - test.series.time[0])
        values = test.series.friction
        values = values[len(values) // 2 :] if number == 0 and test.before == 0 else values
        bunch = -(-len(values) * len(chain) // samples)
        count = len(values) // bunch * bunch
        inside = interval * np.arange(1, len(values) + 1)
        time.append(start + inside[:count].reshape(-1, bunch).mean(axis=1))
        friction.append(values[:count].reshape(-1, bunch).mean(axis=1))
        legs.append(Leg(float(inside[-1]), test.velocity))
        start += float(inside[-1])
    return Data(np.concatenate(time), np.concatenate(friction), tuple(legs), before=chain[0].before or None)
