"""What a gouge experiment shows: means over realizations against slip or time, peaks, healing, compaction.

Errors are standard errors over realizations; bands in figures are two standard deviations over realizations, as in the
figures of paper 003.
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
        return Number(float(self.mean[k]), float(self.error[k]), len(self.rows))


class Number(NamedTuple):
    """A number, its standard error (NaN with one realization), and how many realizations it rests on."""

    value: float
    error: float
    realizations: int

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
    window = result.scenario.preparation.window * result.scenario.grains.mean
    means = [steady_friction(one, velocity, window) for one in result.realizations]
    values = np.array([m.mean for m in means])
    if len(values) == 1:
        return Number(float(values[0]), float(means[0].error), 1)
    return Number(float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values))), len(values))


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
            grid = np.linspace(0, min(_slid(result, c if twin else t)[-1] for t, c in pairs), POINTS)
        rows.append(np.mean([_stepped(result, t, c, grid) for t, c in pairs], axis=0))
    return Curve(grid, np.array(rows), f"{before:g} → {after:g} m/s")


def _twin_of(one: Realization, step: Test) -> Test | None:
    """The copy that went on from where a step was made: what ran just before it."""
    place = next(k for k, test in enumerate(one.tests) if test is step)
    twin = one.tests[place - 1]
    return twin if twin.kind == "twin" else None


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
    return found._replace(value=found.value / size, error=found.error / abs(size))


def just_after(curve: Curve) -> Number:
    """Mean over slips up to `EARLY`: a fixed window, since the largest of what fluctuates would always be positive."""
    near = curve.x <= EARLY
    return _read_off(curve, lambda mean: mean[near].mean())


def holds(result: GougeResult) -> list[float]:
    """Velocities before holds."""
    return sorted({t.before for t in result.realizations[0].of("hold")})


def hold_curve(result: GougeResult, before: float, column: str = "friction") -> Curve:
    """Change of a column since a hold began, against the time held [s], on a logarithmic grid.

    Several holds of one realization are averaged first. The start is the mean of the first interval of a sample.
    """
    rows, grid = [], None
    for one in result.realizations:
        tests = [t for t in one.of("hold") if t.before == before]
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
    place = next(k for k, test in enumerate(one.tests) if test is hold)
    slide = next(t for t in reversed(one.tests[:place]) if t.kind == "slide" and t.velocity == hold.before)
    return float(getattr(slide.series, column)[-1])


def compaction(result: GougeResult, before: float) -> Number:
    """How much thinner the layer gets in a hold, per e-fold of time, over its thickness."""
    curve = hold_curve(result, before, "thickness")
    late = curve.x > 0.05 * curve.x[-1]
    thickness = np.mean([one.tests[0].series.thickness[-1] for one in result.realizations])
    return _read_off(curve, lambda mean: -np.polyfit(np.log(curve.x[late]), mean[late], 1)[0] / thickness)


def reslides(result: GougeResult) -> list[tuple[float, float, float]]:
    """(velocity before, hold, velocity after) of all slides after holds, each once."""
    return sorted({(t.before, t.hold, t.velocity) for t in result.realizations[0].of("reslide")})


def reslide_curve(result: GougeResult, before: float, hold: float, after: float, *, twin: bool = False) -> Curve | None:
    """Friction after a hold against the load point's slip [D], less the mean steady friction at the velocity before.

    With `twin`, less that of the copy that went on without a hold; None if there was none.
    """
    level, rows, grid = mean_friction(result, before).value, [], None
    for one in result.realizations:
        tests = [t for t in one.of("reslide") if (t.before, t.hold, t.velocity) == (before, hold, after)]
        twins = [_twin_without_hold(one, t) for t in tests] if twin else [None] * len(tests)
        if twin and None in twins:
            return None
        if grid is None:
            grid = np.linspace(0, min(_slid(result, t)[-1] for t in (*tests, *twins) if t is not None), POINTS)
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
    place = next(k for k, test in enumerate(one.tests) if test is reslide)
    last = next((test for test in reversed(one.tests[:place]) if test.kind in ("twin", "slide")), None)
    return last if last is not None and last.kind == "twin" else None


def peak(curve: Curve) -> Number:
    """Largest value of the mean curve."""
    return _read_off(curve, lambda mean: mean.max())


def _read_off(curve: Curve, read) -> Number:
    """A number read off the mean curve, with its error by drawing realizations again (bootstrap)."""
    value, number = float(read(curve.mean)), len(curve.rows)
    if number == 1:
        return Number(value, np.nan, 1)
    rng = np.random.default_rng(0)
    drawn = [read(curve.rows[rng.integers(number, size=number)].mean(axis=0)) for _ in range(DRAWS)]
    wider = np.sqrt(number / (number - 1))  # what is drawn from a sample scatters less than what that was drawn from
    return Number(value, float(wider * np.std(drawn, ddof=1)), number)


def average(numbers: list[Number]) -> Number:
    """Mean of independent numbers."""
    return Number(
        float(np.mean([n.value for n in numbers])),
        float(np.sqrt(sum(n.error**2 for n in numbers)) / len(numbers)),
        min(n.realizations for n in numbers),
    )


def slope(x, numbers: list[Number]) -> Number:
    """Slope of a straight line through numbers, with the larger error of what theirs and the residuals give."""
    x, y = np.asarray(x, float), np.array([n.value for n in numbers])
    centred = x - x.mean()
    spread = float(centred @ centred)
    value = float(centred @ y) / spread
    errors = np.array([n.error for n in numbers])
    told = float(np.sqrt((centred**2) @ (errors**2))) / spread
    rest = y - y.mean() - value * centred
    seen = float(np.sqrt(rest @ rest / (len(x) - 2) / spread)) if len(x) > 2 else 0.0
    return Number(value, max(told, seen) if np.isfinite(told) else np.nan, min(n.realizations for n in numbers))


def step_records(result: GougeResult, *, samples: int = 400) -> list[Data]:
    """Velocity steps of every realization as records of a laboratory: friction against time, with the legs of the load.

    Parameters
    ----------
    samples : at most so many of each realization, means over as many neighbouring ones as that takes
    """
    return [_record(one, samples) for one in result.realizations if one.of("step")]


def _record(one: Realization, samples: int) -> Data:
    tests = one.of("slide", "step")
    last = next(k for k in reversed(range(len(tests))) if tests[k].kind == "step")
    first = next(k for k in range(last, -1, -1) if tests[k].kind == "slide")
    chain, time, friction, legs, start = tests[first : last + 1], [], [], [], 0.0
    bunch = -(-sum(len(test.series.time) for test in chain) // samples)
    for test in chain:
        series, count = test.series, len(test.series.time) // bunch * bunch
        interval = float(series.time[1] - series.time[0])
        inside = interval * np.arange(1, len(series.time) + 1)
        time.append(start + inside[:count].reshape(-1, bunch).mean(axis=1))
        friction.append(series.friction[:count].reshape(-1, bunch).mean(axis=1))
        legs.append(Leg(float(inside[-1]), test.velocity))
        start += float(inside[-1])
    return Data(np.concatenate(time), np.concatenate(friction), tuple(legs))
