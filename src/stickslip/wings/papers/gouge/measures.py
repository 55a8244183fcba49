"""Measures of gouge experiments: friction, thickness and energies in holds, after holds, and after velocity steps."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ....kit import checked
from ...faults.friction.laboratory import Mean, steady_mean
from ...faults.friction.loads import LoadStep
from ...faults.friction.model import Data
from .protocol import Realization, Test
from .simulate import GougeResult
from .statistics import Curve, Number, combine, read_off

POINTS = 200  # minimum number of points of a mean curve
EARLIEST = 1e-2  # smallest hold time in fits of slopes against its logarithm [s]
EARLY = 0.05  # load-point slip during which the state hardly changes, 3 % of the dc of Ferdowsi & Rubin 2021 [D]
BEFORE = 0.02  # slip over which the value before a hold is averaged [D]
SMOOTH = 0.02  # slip over which curves are averaged before the peak is determined [D]


@checked
def steady_friction(found: Realization, velocity: float, window: float) -> Mean | None:
    """Mean steady friction of a realisation at a velocity; None if sliding was never steady.

    The mean is over the last two windows [m] of the preparation, slides that continued at this velocity, and the second
    halves of slides and steps that changed to it. The error accounts for the correlation of friction along slip; see
    `friction.steady_mean`.
    """
    pieces = _steady_pieces(found, velocity, window, "friction")
    return steady_mean(np.concatenate(pieces)) if pieces else None


def _steady_pieces(sample: Realization, velocity: float, window: float, column: str) -> list[np.ndarray]:
    pieces = []
    for test in sample.of("steady", "slide", "step"):
        series = test.series
        if test.velocity != velocity:
            continue
        late = series.load_point > series.load_point[-1] - 2 * window
        if test.kind != "steady":
            late = slice(0 if test.before == velocity else len(late) // 2, None)
        pieces.append(getattr(series, column)[late])
    return pieces


@checked
def steady_slip(result: GougeResult, velocity: float) -> float:
    """Slip over which steady friction at a velocity is averaged in a sample: the smallest of all samples [m]."""
    rows = [_steady_pieces(sample, velocity, _window(result), "friction") for sample in result.realizations]
    return velocity * result.scenario.interval * min(sum(map(len, pieces)) for pieces in rows)


@checked
def velocities(result: GougeResult) -> list[float]:
    """Velocities with steady friction in at least one realisation, slowest first."""
    values = {t.velocity for sample in result.realizations for t in sample.of("steady", "slide", "step")}
    return sorted(v for v in values if v > 0)


@checked
def mean_friction(result: GougeResult, velocity: float) -> Number:
    """Mean over samples of the steady friction at a velocity.

    The error is based on the scatter between samples; with only one sample, it is the error of that sample's mean.
    """
    means = [steady_friction(sample, velocity, _window(result)) for sample in result.realizations]
    friction = read_off(np.array([[m.mean] for m in means]), _seeds(result), lambda mean: mean[0])
    return friction._replace(error=means[0].error) if len(means) == 1 else friction


@checked
def mean_of(result: GougeResult, velocity: float, column: str) -> Number:
    """Mean over samples of a series column in steady sliding at a velocity."""
    window = _window(result)
    rows = [[np.concatenate(_steady_pieces(sample, velocity, window, column)).mean()] for sample in result.realizations]
    return read_off(np.array(rows), _seeds(result), lambda mean: mean[0])


@checked
def correlation_slip(result: GougeResult, velocity: float) -> float:
    """Slip over which friction is correlated in steady sliding, 2τ with its integrated autocorrelation length τ [D]."""
    lengths = []
    for sample in result.realizations:
        pieces = _steady_pieces(sample, velocity, _window(result), "friction")
        whole = np.concatenate(pieces)
        slid = velocity * result.scenario.interval * len(whole) / result.scenario.grains.mean
        lengths.append(slid / steady_mean(whole).effective)
    return float(np.mean(lengths))


def _window(result: GougeResult) -> float:
    return result.scenario.preparation.window * result.scenario.grains.mean


def _seeds(result: GougeResult) -> np.ndarray:
    return np.array([sample.seed for sample in result.realizations])


@checked
def steps(result: GougeResult) -> list[tuple[float, float]]:
    """Distinct velocity steps (before, after) of the protocol."""
    return list(dict.fromkeys((t.before, t.velocity) for t in result.realizations[0].of("step")))


@checked
def step_curve(
    result: GougeResult, before: float, after: float, *, twin: bool, column: str = "friction"
) -> Curve | None:
    """Change in friction, or in another column, after a velocity step, against the slip of the load point [D].

    With `twin`, the change is relative to the copy that continued at the old velocity; otherwise, to the mean of the
    sample in steady sliding at the old velocity. Returns None if there is no such step or copy.
    """

    def level(sample: Realization) -> float:
        return np.concatenate(_steady_pieces(sample, before, _window(result), column)).mean()

    tests = [
        (sample, test)
        for sample in result.realizations
        for test in sample.of("step")
        if (test.before, test.velocity) == (before, after)
    ]
    return _change(result, tests, None if twin else level, column, f"{before:g} → {after:g} m/s")


def _change(
    result: GougeResult, tests: list[tuple[Realization, Test]], level: Callable | None, column: str, label: str
) -> Curve | None:
    """Change of a column during tests against load-point slip [D], relative to level(sample) or to the twin tests.

    The grid of slips is fine enough for a mean over slips up to `EARLY`. None if there are no tests, or no twin.
    """
    chains = [[test] if level else [test, _find_twin(sample, test)] for sample, test in tests]
    if not tests or any(None in chain for chain in chains):
        return None
    end = float(min(_load_point_slip(result, test)[-1] for chain in chains for test in chain))
    grid, rows = np.linspace(0, end, max(POINTS, int(20 * end / EARLY))), []
    for (sample, _), chain in zip(tests, chains, strict=True):
        row, *copy = (np.interp(grid, _load_point_slip(result, t), getattr(t.series, column)) for t in chain)
        rows.append(row - (copy[0] if copy else level(sample)))
    return Curve(grid, np.array(rows), np.array([sample.seed for sample, _ in tests]), label)


def _find_twin(sample: Realization, test: Test) -> Test | None:
    """Find the copy that continued from the start of a step, or of the hold before a slide; None if there is none."""
    for other in reversed(sample.tests[: next(k for k, t in enumerate(sample.tests) if t is test)]):
        if (other.part, other.branch) != (test.part, test.branch):
            return None
        if other.kind == "twin" and other.before == test.before:
            return other
    return None


def _load_point_slip(result: GougeResult, test: Test) -> np.ndarray:
    """Slip of the load point since the test began [D].

    The first of the evenly spaced samples is one interval after the start.
    """
    series = test.series
    begin = series.load_point[0] - (series.load_point[1] - series.load_point[0])
    return (series.load_point - begin) / result.scenario.grains.mean


@checked
def direct_effect(curve: Curve, before: float, after: float) -> Number:
    """Change in friction just after a step, divided by ln(V2/V1), without correction for inertia.

    See `Response.impedance`.
    """
    jump, size = just_after(curve), np.log(after / before)
    return jump._replace(value=jump.value / size, error=jump.error / abs(size), draws=jump.draws / size)


@checked
def just_after(curve: Curve) -> Number:
    """Mean over slips up to `EARLY`; the window is fixed, as the maximum of a fluctuating curve is biased upward."""
    near = curve.x <= EARLY
    return curve.read(lambda mean: mean[near].mean())


class Response(NamedTuple):
    """Peaks just after velocity steps, split into parts that depend on ln V and on V."""

    a: Number  # direct effect
    impedance: Number  # impedance of plate and layer over the normal stress: Δμ = impedance ΔV [s/m]
    peaks: dict[tuple[float, float], Number]  # by (before, after)


@checked
def response(result: GougeResult) -> Response | None:
    """Fit the direct effect and the radiation impedance to peaks after velocity steps of different sizes.

    The peak Δμ after a step from V1 to V2 is the largest change of the smoothed mean curve in the step's direction. The
    sum a ln(V2/V1) + η (V2 − V1) is fitted to the peaks by least squares. The second term is due to waves radiated by
    plate and layer; their resistance is proportional to the change in velocity, not to that of its logarithm. Returns
    None unless there are steps with different ratios of ln(V2/V1) to V2 − V1.
    """
    curves = {pair: step_curve(result, *pair, twin=False) for pair in steps(result)}
    pairs = list(curves)
    design = np.array([[np.log(w / v), w - v] for v, w in pairs])
    if len(pairs) < 2 or np.linalg.cond(design / np.abs(design).max(axis=0)) > 1e3:
        return None
    peaks = {(v, w): peak(curves[v, w], sign=np.sign(w - v)) for v, w in pairs}
    solve = np.linalg.pinv(design)
    a, eta = (combine(list(peaks.values()), lambda y, row=row: row @ y) for row in solve)
    return Response(a, eta, peaks)


@checked
def holds(result: GougeResult) -> list[float]:
    """Velocities before holds, slowest first."""
    return sorted({t.before for t in result.realizations[0].of("hold")})


@checked
def hold_curve(result: GougeResult, before: float, column: str = "friction") -> Curve:
    """Change in a column since the start of a hold against the hold time [s], on a logarithmic grid.

    Only the longest holds after this velocity are used. The value before a hold is the mean over the last `BEFORE`
    diameters of the preceding slide.
    """
    pairs = []
    for sample in result.realizations:
        tests = [t for t in sample.of("hold") if t.before == before]
        longest = max(_hold_time(result, t)[-1] for t in tests)
        pairs += [(sample, t) for t in tests if _hold_time(result, t)[-1] > longest * (1 - 1e-6)]
    times = [_hold_time(result, test) for _, test in pairs]
    grid = np.geomspace(max(t[0] for t in times), min(t[-1] for t in times), POINTS)
    rows = []
    for (sample, test), time in zip(pairs, times, strict=True):
        before_it = sample.slide_to(test).series
        near = before_it.load_point > before_it.load_point[-1] - BEFORE * result.scenario.grains.mean
        start = float(getattr(before_it, column)[near].mean())
        rows.append(np.interp(np.log(grid), np.log(time), getattr(test.series, column)) - start)
    return Curve(grid, np.array(rows), np.array([sample.seed for sample, _ in pairs]), f"$V_i$ = {before:g} m/s")


def _hold_time(result: GougeResult, test: Test) -> np.ndarray:
    """Time since a test began [s]; the first sample is one interval after the start."""
    return test.series.time - test.series.time[0] + result.scenario.interval


@checked
def creep_velocity(result: GougeResult, before: float) -> Curve:
    """Velocity of the plate in a hold [m/s] against the hold time [s], from the slope of its slip over an e-fold."""
    slip = hold_curve(result, before, "slip")
    x = np.log(slip.x)
    ahead, back = (np.interp(x + d, x, np.arange(len(x))).round().astype(int) for d in (0.5, -0.5))
    rows = (slip.rows[:, ahead] - slip.rows[:, back]) / (slip.x[ahead] - slip.x[back])
    return slip._replace(rows=rows)


@checked
def energy_ratio(result: GougeResult, before: float) -> Curve:
    """Kinetic over elastic energy of the mobile grains in a hold against the hold time [s].

    The elastic energy is taken from the end of the hold, because it hardly changes under a constant stress.
    """
    curve = hold_curve(result, before, "kinetic_energy")
    tests = [(sample, t) for sample in result.realizations for t in sample.of("hold") if t.before == before]
    rows = [
        np.interp(np.log(curve.x), np.log(_hold_time(result, t)), t.series.kinetic_energy) / t.elastic for _, t in tests
    ]
    return curve._replace(rows=np.array(rows), seeds=np.array([sample.seed for sample, _ in tests]))


@checked
def sliding_energy_ratio(result: GougeResult, velocity: float) -> Number:
    """Kinetic over elastic energy in steady sliding at a velocity."""
    rows = []
    for sample in result.realizations:
        stored = [t.elastic for t in sample.of("steady", "slide") if t.velocity == velocity]
        kinetic = np.concatenate(_steady_pieces(sample, velocity, _window(result), "kinetic_energy")).mean()
        rows.append([kinetic / np.mean(stored)])
    return read_off(np.array(rows), _seeds(result), lambda mean: mean[0])


@checked
def per_efold(curve: Curve, earliest: float = EARLIEST) -> Number:
    """Slope of a curve against the logarithm of the hold time, from `earliest` [s] on."""
    late = curve.x >= min(earliest, curve.x[-1] / 10)
    x = np.log(curve.x[late])
    x = x - x.mean()
    return curve.read(lambda mean: x @ mean[late] / (x @ x))


@checked
def reslides(result: GougeResult) -> list[tuple[float, float, float]]:
    """Distinct (velocity before, hold, velocity after) of all slides that follow a hold."""
    return sorted({(t.before, t.hold, t.velocity) for t in result.realizations[0].of("reslide")})


@checked
def reslide_curve(result: GougeResult, before: float, hold: float, after: float, *, twin: bool = False) -> Curve | None:
    """Change in friction after a hold against the slip of the load point [D].

    The change is relative to the steady friction of each sample before the hold or, with `twin`, to the copy that
    continued without a hold. Returns None if there is no such slide or copy.
    """

    def level(sample: Realization) -> float:
        return steady_friction(sample, before, _window(result)).mean

    tests = [
        (sample, test)
        for sample in result.realizations
        for test in sample.of("reslide")
        if (test.before, test.hold, test.velocity) == (before, hold, after)
    ]
    label = f"$V_r$ = {after:g} m/s, $t$ = {hold:g} s"
    return _change(result, tests, None if twin else level, "friction", label)


@checked
def smoothed(curve: Curve, window: float = SMOOTH) -> Curve:
    """Average a curve over windows of its grid; windows are truncated at its ends."""
    width = max(1, round(window / (curve.x[1] - curve.x[0])))
    kernel = np.ones(width)
    weight = np.convolve(np.ones(len(curve.x)), kernel, "same")
    return curve._replace(rows=np.array([np.convolve(row, kernel, "same") / weight for row in curve.rows]))


@checked
def peak(curve: Curve, *, sign: float = 1.0) -> Number:
    """Largest value of the smoothed mean curve, or smallest value for sign −1.

    After a hold, this peak marks the end of elastic reloading. Noise increases the peak; see `peak_bias`.
    """
    return smoothed(curve).read(lambda mean: sign * (sign * mean).max())


@checked
def peak_bias(curve: Curve) -> float:
    """Upper bound on the bias of the peak due to noise.

    The bound is the difference between the peak and the mean of the samples' values, each at the peak position of the
    other samples. These values are not biased by the selection of a maximum, but lie below the true peak if the peak
    positions of the others are wrong. NaN for a single branch.
    """
    units = smoothed(curve).units
    if len(units) < 2:
        return np.nan
    whole = units.sum(axis=0)
    elsewhere = [unit[(whole - unit).argmax()] for unit in units]
    return float((whole / len(units)).max() - np.mean(elsewhere))


@checked
def peak_slip(curve: Curve) -> float:
    """Slip at which the smoothed mean curve is largest [D]."""
    soft = smoothed(curve)
    return float(soft.x[soft.mean.argmax()])


class Steps(NamedTuple):
    """Slide and subsequent velocity steps as a laboratory record."""

    seed: int  # seed of the realisation; −1 for the mean over all branches
    part: int  # entry of the protocol, counted from 0
    branch: int
    data: Data


@checked
def step_records(result: GougeResult, *, samples: int = 400) -> list[Steps]:
    """Return the velocity steps of every branch as records of friction against time, with the load legs.

    Parameters
    ----------
    samples : maximum number of samples in each record, equally spaced in slip; each is a mean over neighbours
    """
    records = []
    for sample in result.realizations:
        for part, branch in dict.fromkeys((t.part, t.branch) for t in sample.of("step")):
            tests = [t for t in sample.of("step") if (t.part, t.branch) == (part, branch)]
            records.append(Steps(sample.seed, part, branch, _make_record([sample.slide_to(tests[0]), *tests], samples)))
    return records


@checked
def mean_records(result: GougeResult, *, samples: int = 400) -> list[Steps]:
    """Average velocity steps over all branches of all samples.

    Return one record for each part of the protocol with velocity steps.
    """
    means, records = [], step_records(result, samples=samples)
    for part in dict.fromkeys(record.part for record in records):
        mine = [record.data for record in records if record.part == part and record.branch > 0] or [
            record.data for record in records if record.part == part
        ]
        friction = np.mean([data.friction for data in mine], axis=0)
        means.append(Steps(-1, part, -1, mine[0]._replace(friction=friction)))
    return means


def _make_record(chain: list[Test], samples: int) -> Data:
    """Make one record of consecutive tests, with samples equally spaced in slip.

    After a change of velocity, the record begins in the middle of the first leg.
    """
    columns = [test.series.friction for test in chain]
    if chain[0].before != chain[0].velocity:
        columns[0] = columns[0][len(columns[0]) // 2 :]
    intervals = [float(test.series.time[1] - test.series.time[0]) for test in chain]
    slips = [test.velocity * interval for test, interval in zip(chain, intervals, strict=True)]
    spacing = sum(slip * len(values) for slip, values in zip(slips, columns, strict=True)) / samples
    time, friction, legs, start = [], [], [], 0.0
    for test, values, interval, slip in zip(chain, columns, intervals, slips, strict=True):
        bunch = min(len(values), max(1, math.ceil(spacing / slip * (1 - 1e-9))))
        count = len(values) // bunch * bunch
        inside = interval * np.arange(1, len(values) + 1)
        time.append(start + inside[:count].reshape(-1, bunch).mean(axis=1))
        friction.append(values[:count].reshape(-1, bunch).mean(axis=1))
        legs.append(LoadStep(float(inside[-1]), test.velocity))
        start += float(inside[-1])
    return Data(np.concatenate(time), np.concatenate(friction), tuple(legs), before=chain[0].before or None)
