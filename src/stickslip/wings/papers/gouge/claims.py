"""Evaluation of the claims of Ferdowsi & Rubin 2021, the supplement to their slide-hold-slide study.

The supplement prints a, b, D_c and the slope of the peaks, and states that restitution does not matter. Other claims
follow from closed forms or from measured curves. Statements from the study itself or from other sources serve as
references. Tolerances were fixed before anything was measured.
"""

import numpy as np
from scipy.special import chdtri

from ....kit import Claim, claim, pluralize, statement
from ....laws import collision, elastic_constants, hertz_mindlin_reff
from ...faults.friction.fitting import Fit, fit
from ...faults.friction.inference import LawComparison, compare_laws
from ...faults.friction.laws import RateState, Spring, spring_slider
from ...faults.friction.loads import LoadStep
from ...faults.friction.model import Data
from . import measures
from .sample import INERTIAL, damping, inertial_numbers, normalised_hold, stiffness
from .scenario import GougeScenario
from .simulate import GougeResult
from .statistics import Number, combine, difference, slope


def predict_hold(result: GougeResult, before: float, times) -> dict:
    """Predict the change in friction during a hold from rate-and-state friction with the scenario's a, b and dc.

    Returns {law: (times, change in friction)} for the slip law and the aging law.
    """
    scales, scenario = result.scenario.scales, result.scenario
    spring = Spring(stiffness(scenario) / scenario.load.normal_stress)
    out = {}
    for law in ("slip", "aging"):
        rs = RateState(scales.a, scales.b, scales.dc, mu0=0.0, v0=before, law=law)
        history = spring_slider(rs, spring, (LoadStep(float(times[-1]) * (1 + 1e-9), 0.0),), times=times, before=before)
        out[law] = (times, history.friction)
    return out


def predict_per_efold(result: GougeResult, before: float, times, law: str) -> float:
    """Slope of predicted friction in a hold against the logarithm of time, over the times of `measures.per_efold`."""
    time, change = predict_hold(result, before, times)[law]
    late = time >= min(measures.EARLIEST, time[-1] / 10)
    return float(np.polyfit(np.log(time[late]), change[late], 1)[0])


def reslides_after_longest(result: GougeResult, before: float):
    """Return curves, velocities and peaks of slides after the longest hold, slowest first, and the hold time."""
    longest = max(h for v, h, _ in measures.reslides(result) if v == before)
    after = [w for v, h, w in measures.reslides(result) if (v, h) == (before, longest)]
    curves = [measures.reslide_curve(result, before, longest, w) for w in after]
    return curves, np.array(after), [measures.peak(c) for c in curves], longest


def holds_with_common_velocity(result: GougeResult, before: float) -> tuple[list[float], float]:
    """Return the hold times followed by slides at one common velocity, and that velocity.

    This is the velocity before the hold if there are such slides, otherwise the slowest.
    """
    holds = [(h, w) for v, h, w in measures.reslides(result) if v == before]
    chosen = before if any(w == before for _, w in holds) else min(w for _, w in holds)
    return sorted(h for h, w in holds if w == chosen), chosen


def healing_peaks(result: GougeResult, before: float):
    """Return hold times, the peaks after them at one velocity, and the slope of the peaks per e-fold of hold time."""
    times, after = holds_with_common_velocity(result, before)
    peaks = [measures.peak(measures.reslide_curve(result, before, h, after)) for h in times]
    return times, peaks, slope(np.log(times), peaks)


A, B, DC, PEAK_SLOPE, COLLAPSE = 0.0247, 0.0178, 5.3e-3, 0.0155, 5.0  # captions of Figs S1 and S2, inset of S2
STIFFNESS, HOLD, BEFORE = 425.0, 1650.0, 0.02  # k̄_d; t̄_hold; V_i of Fig S2 [m/s]
SMALLEST, SPEED, STEP = (1e-3, 25.0, 2e-8)  # diameter (not printed) [m]; speed [m/s]; Δt of Table S1 [s]
ROUNDED = 0.25  # tolerance of Δt, which is printed with one digit: 1.5e-8 to 2.5e-8
PEAK = 0.3  # tolerance of the peak, the same as for all numbers of rate-and-state friction
STUDY = "Ferdowsi and Rubin 2021, doi:10.1029/2021JB022125, abstract"
FULL = "not run: part of stickslip reproduce gouge --full"
UNDEFINED = (
    f"t̄ = {HOLD:g} is interpreted as k V_i t/(a σ), 1.43 s; as V_i t/D_c it would be 437 s. By both laws the slope "
    "does not "
    f"depend on the hold"
)


def _peaks(result: GougeResult | None) -> list[Claim]:
    """Claims about peaks after holds: their slope, the peak at V_r = V_i, their collapse, and a slope below b."""
    ratio = "peak-vs-velocity-ratio", "Fig S2: inset of panel a, slope = 0.0155", PEAK_SLOPE
    paper, where = COLLAPSE * PEAK_SLOPE, "Fig S2: panel b and inset, C ≈ 5 times the slope 0.0155"
    collapse = "Fig S2: caption, (μ − μ_ss)/(C + ln(V_r/V_i)) with C ≈ 5"
    below = "Fig S2: inset of panel a, slope 0.0155 < b = 0.0178"
    if result is None:
        return [
            claim(*ratio, None, "1", TOLERANCE["rate and state"], FULL),
            claim("peak-at-equal-velocities", where, paper, None, "1", PEAK, FULL),
            statement("collapse-of-peaks", collapse, None, FULL),
            statement("slope-below-b", below, None, FULL),
        ]
    before = measures.holds(result)[0]
    _, after, peaks, hold = reslides_after_longest(result, before)
    x = np.log(after / before)
    first, rate, off = peaks[int(np.argmin(np.abs(x)))], slope(x, peaks), collapse_defect(x, peaks)
    listed = "; ".join(f"{_interval(p)} at V_r/V_i = {r:.3g}" for r, p in zip(after / before, peaks, strict=True))
    return [
        claim(
            *ratio, rate.value, "1", TOLERANCE["rate and state"],
            f"peak after elastic reloading minus steady friction, per e-fold of the ratio: {_interval(rate)}; "
            f"{listed}; after holds of {hold:g} s at V_i = {before:g} m/s; {UNDEFINED}; {_scale_note(result)}",
            error=rate.half / 2,
        ),
        claim(
            "peak-at-equal-velocities", where, paper, None, "1", PEAK,
            "t̄ = V_i t/D_c, 437 s, is the only definition for which the printed peak lies between the laws: see "
            "definition-of-hold-time; slides after such a hold would decide it",
        ),
        claim(
            "peak-at-equal-velocities@frozen", where, paper, first.value, "1", PEAK,
            f"after 1.43 s, t̄ = k V_i t/(a σ): {_interval(first)}", error=first.half / 2,
        ),
        statement(
            "collapse-of-peaks", collapse, False if abs(off.value) > off.half else None,
            f"slope of peaks minus a fifth of the peak at V_r = V_i: {_interval(off)}, zero if peaks "
            f"are proportional to 5 + ln(V_r/V_i); an interval that contains zero does not show that they collapse",
        ),
        statement(
            "slope-below-b", below, below_or_not(rate, B),
            f"slope {_interval(rate)} per e-fold of V_r/V_i, b = {B}",
        ),
    ]  # fmt: skip


def collapse_defect(x: np.ndarray, peaks: list[Number]) -> Number:
    """Slope of peaks against x = ln(V_r/V_i), minus their value at x = 0 over C; zero if peaks are ∝ C + x."""
    return combine(peaks, lambda y: np.subtract(*np.polyfit(x, y, 1) * (1, 1 / COLLAPSE)))


def below_or_not(number: Number, limit: float) -> bool | None:
    """Return True if a number is below a limit; None if its 95 % interval contains the limit or is unknown."""
    return bool(number.value < limit) if abs(number.value - limit) > number.half else None


def _time_step(scenario: GougeScenario) -> Claim:
    """Claim about the time step: a hundredth of the collision time of two of the smallest grains."""
    law = hertz_mindlin_reff(*elastic_constants(scenario.law.young, scenario.law.poisson))
    mass = scenario.grains.density * np.pi / 6 * SMALLEST**3
    step = collision(law, radius=SMALLEST / 2, mass=mass, speed=SPEED).duration / 100
    return claim(
        "time-step", "Text: Δt = t_col/100 at 25 m/s; Table S1: 2e-8 s", STEP, step, "s", ROUNDED,
        f"two elastic grains of 1 mm, a size that the paper does not print; t_col is proportional to the diameter, and "
        f"{STEP:g} s would belong to "
        f"{1e3 * SMALLEST * STEP / step:.2f} mm", error=0.0,
    )  # fmt: skip


def hold_time(scenario: GougeScenario, definition: str, spring: float) -> float:
    """Hold time [s] for t̄ = 1650 by a definition of `normalised_hold`, with a spring of stiffness k [Pa/m]."""
    unit = normalised_hold(scenario, 1.0, BEFORE)[definition]
    return HOLD / unit * (stiffness(scenario) / spring if definition == "frozen" else 1.0)


def predict_peaks(law: str, spring: float, hold: float, after: np.ndarray) -> np.ndarray:
    """Peaks after a hold [s] at V_i = 0.02 m/s, for slides at `after` [m/s], with the paper's a, b and D_c.

    `spring` is the stiffness per unit normal stress [1/m].
    """
    peaks = []
    for velocity in after:
        long = 5 * DC / velocity
        legs = (LoadStep(hold, 0.0), LoadStep(1.001 * long, float(velocity)))
        times = hold + np.linspace(long / 2000, long, 2000)
        rs = RateState(A, B, DC, mu0=0.0, v0=BEFORE, law=law)
        peaks.append(spring_slider(rs, Spring(spring), legs, times=times, before=BEFORE).friction.max())
    return np.array(peaks)


def _definitions(scenario: GougeScenario) -> Claim:
    """Claim about the definitions of k̄ and t̄: the printed peak must lie between the peaks of the two laws."""
    stress, rows, fits = scenario.load.normal_stress, [], []
    for kind in ("grain", "rate_state"):
        spring = stiffness(scenario, STIFFNESS, kind)
        for name in ("load_point", "frozen", "inertial"):
            hold = hold_time(scenario, name, spring)
            slip, aging = (
                predict_peaks(law, spring / stress, hold, np.array([BEFORE]))[0] for law in ("slip", "aging")
            )
            rows.append(f"{kind} and {name} ({hold:.3g} s) {slip:.3f} to {aging:.3f}")
            fits += [name] if slip <= COLLAPSE * PEAK_SLOPE <= aging else []
    source = "Fig S2: caption, k̄ ≈ 425 and t̄ ≈ 1650, both without definition"
    return claim(
        "definition-of-hold-time", source, None, set(fits) == {"load_point"}, "", 0.0,
        f"peak at V_r = V_i by the slip and the aging law, with the printed a, b and D_c: {'; '.join(rows)}. The "
        f"printed {COLLAPSE * PEAK_SLOPE:.4f} lies between the laws only for {', '.join(sorted(set(fits))) or 'none'}; "
        f"the definition of k̄ does not matter for it",
        reference=True, reference_source="t̄ = V_i t/D_c",
    )  # fmt: skip


def compare_hold_laws(time: np.ndarray, friction: np.ndarray, before: float, spring: float) -> LawComparison:
    """Compare the slip and aging laws for a hold by likelihood, with the paper's a, b and D_c and a fitted μ0.

    Only times from `measures.EARLIEST` on are used.

    Parameters
    ----------
    time, friction : (T,) since the start of the hold [s], [1]
    before : velocity before the hold [m/s]
    spring : stiffness per unit normal stress [1/m]
    """
    last = float(time[-1]) * (1 + 1e-9)
    data = Data(time, friction, (LoadStep(last, 0.0),), before=before)
    fixed = {"a": A, "b": B, "dc": DC, "stiffness": spring}
    window = [(min(measures.EARLIEST, last / 10), last)]
    return compare_laws(*(fit(data, law=law, fixed=fixed, windows=window) for law in ("slip", "aging")))


def _law_of_holds(main: GougeResult) -> list[Claim]:
    """Claims about the law that holds follow, the bands of their curves, and the damping ratio."""
    before = measures.holds(main)[-1]
    curve, rate = measures.hold_curve(main, before), measures.per_efold(measures.hold_curve(main, before))
    made = compare_hold_laws(curve.x, curve.mean, before, stiffness(main.scenario) / main.scenario.load.normal_stress)
    expected = {law: predict_per_efold(main, before, curve.x, law) for law in ("slip", "aging")}
    inside = {law: abs(rate.value - value) <= rate.half for law, value in expected.items()}
    measured = None if made.preferred is None else made.preferred == "slip" and inside["slip"]
    slopes = ", ".join(f"{law} law {value:.4f}" for law, value in expected.items())
    return [
        _statement(
            "slip-law-in-holds", "Fig S1: curves of both laws; no statement in the supplement",
            measured if measured is None or inside["slip"] != inside["aging"] else None,
            f"{made.sentence}, from {min(measures.EARLIEST, curve.x[-1] / 10):g} s on with a free level; slope per "
            f"e-fold {_interval(rate)}: {slopes}. Both laws predict a larger decrease before that time", STUDY,
        ),
        claim(
            "bands-of-holds", "Fig S1: shaded, 2σ of 8 realisations; no number is printed", None, float(curve.band[-1]),
            "1", PEAK, f"2σ over {len(curve.rows)} branches at the end of the longest hold",
        ),
        statement(
            "damping-ratio", 'Text: "the choices of the ratio have little impact"', None,
            "γ_t = γ_n/2 was used throughout; holds with γ_t = 0 and γ_t = γ_n in as many samples would decide it",
        ),
    ]  # fmt: skip


STEADY = (0.33, 0.42)  # known range of steady friction of such gouge
LEDGER = 1e-2  # largest defect of the ledger over the dissipated energy, for fractions accurate to one per cent
ENERGY = 1e-2  # kinetic over elastic energy below which grains count as quasi-static
TELLING = 0.015  # largest half width of a difference's interval at which two holds may count as equal
TOLERANCE = {
    "steady": (STEADY[1] - STEADY[0]) / (STEADY[1] + STEADY[0]),  # the known range
    "rate and state": 0.3,  # b is 28 % less than a: with a larger deviation they could be confused
    "healing": 1 / 3,  # the range from b/2 to b
}
LAW = "slip law for this hold, with the a, b and D_c printed in the paper"
EARLIER = "Ferdowsi and Rubin 2020, doi:10.1029/2019JB019016, abstract"
SHOWS = {
    "Fig S1": ("friction in holds; a, b and D_c of velocity steps", "hold-relaxation-per-e-fold"),
    "Fig S2": ("slides after holds", "peak-vs-velocity-ratio"),
    "Text": ("restitution and the range of the model", "restitution-insensitivity"),
}


def evaluate_claims(holds: dict[str, GougeResult], more: dict[str, GougeResult]) -> list[Claim]:
    """Evaluate all claims.

    Parameters
    ----------
    holds : results with holds for each damping, the paper's damping first
    more : additional results of a full run
    """
    main = next(iter(holds.values()))
    steps = more.get("steps")
    return [
        *_relaxation(main), _healing(main), *_peaks(more.get("reslides")), _time_step(main.scenario),
        _definitions(main.scenario), *_law_of_holds(main), *_rate_state_fit(steps), _symmetry(steps),
        _restitution(holds), *_collisions(holds), *_steady_sliding(main, more), *_energies(main),
    ]  # fmt: skip


def _scale_note(result: GougeResult) -> str:
    """Describe the scale of a result: its samples, grains and damping."""
    chosen, first = result.scenario, result.realizations[0]
    branches = len({(t.part, t.branch) for t in first.tests if t.kind in ("hold", "step", "reslide")})
    return (
        f"{len(result.realizations)} samples of {chosen.grains.number} mobile grains, "
        f"{pluralize(max(branches, 1), 'state')} of each, γ_n = {damping(chosen):.2g} 1/(m s); paper 8 × 4800 grains"
    )


def _interval(number: Number) -> str:
    return f"{number.value:.4f} ± {number.half:.4f}"


def _error_note(number: Number) -> str:
    if not np.isfinite(number.alike):
        return "95 % intervals"
    return f"95 % intervals; two states of one sample have a correlation of {number.alike:.2f}"


def _statement(id: str, source: str, measured: bool | None, note: str, study: str) -> Claim:
    """Make a claim about a statement of another source."""
    return claim(id, source, None, measured, "", 0.0, note, reference=True, reference_source=study)


def _relaxation(main: GougeResult) -> list[Claim]:
    """Claims about the longest hold: friction against the logarithm of time and at the end, and compaction."""
    before = measures.holds(main)[-1]
    curve = measures.hold_curve(main, before)
    last = float(curve.x[-1])
    rate, end = measures.per_efold(curve), curve.at(last)
    expected = predict_per_efold(main, before, curve.x, "slip")
    laws = {law: float(change[-1]) for law, (_, change) in predict_hold(main, before, curve.x).items()}
    points = ", ".join(f"{_interval(curve.at(t))} after {t:g} s" for t in (1e-2, 1e-1, 1.0) if t <= last * 1.01)
    thickness = measures.hold_curve(main, before, "thickness")
    lost = thickness._replace(rows=-thickness.rows / main.scenario.grains.mean)
    loss = measures.per_efold(lost)
    return [
        claim(
            "hold-relaxation-per-e-fold", "Fig S1: curves; no number is printed", None, rate.value, "1",
            TOLERANCE["rate and state"],
            f"change in friction per e-fold of hold time, from {min(measures.EARLIEST, last / 10):g} to {last:g} s "
            f"after {before:g} m/s: {_interval(rate)}, {_error_note(rate)}; aging law "
            f"{predict_per_efold(main, before, curve.x, 'aging'):.4f}; {_scale_note(main)}",
            error=rate.half / 2, reference=expected, reference_source=LAW,
        ),
        claim(
            "hold-relaxation-at-end", "Fig S1: curves; no number is printed", None, end.value, "1",
            TOLERANCE["rate and state"],
            f"change in friction: {points}; predictions after {last:g} s: slip law {laws['slip']:.4f}, aging law "
            f"{laws['aging']:.4f}; {_scale_note(main)}",
            error=end.half / 2, reference=laws["slip"], reference_source=LAW,
        ),
        _statement(
            "compaction-in-holds", "Text: not in the supplement",
            bool(loss.value > 0) if abs(loss.value) > loss.half else None,  # None if the interval contains zero
            f"thickness lost per e-fold of hold time: {_interval(loss)} D, {_error_note(loss)}; "
            f"{_interval(lost.at(lost.x[-1]))} D after {lost.x[-1]:g} s; {_scale_note(main)}", study=STUDY,
        ),
    ]  # fmt: skip


def _healing(main: GougeResult) -> Claim:
    where = "Text: not in the supplement"
    reference = {"reference": 0.75 * B, "reference_source": f"midpoint of b/2 to b per e-fold of hold, {STUDY}"}
    if not measures.reslides(main):
        note = "no slides after holds were run"
        return claim("healing-rate", where, None, None, "1", TOLERANCE["healing"], note, **reference)
    before = measures.holds(main)[-1]
    times, peaks, rate = healing_peaks(main, before)
    curves = [measures.reslide_curve(main, before, t, before) for t in times]
    listed = "; ".join(
        f"{_interval(p)} after {t:g} s, at a slip of {measures.peak_slip(c):.2g} D, overestimated by at most "
        f"{measures.peak_bias(c):.4f}, as noise affects the maximum"
        for t, p, c in zip(times, peaks, curves, strict=True)
    )
    return claim(
        "healing-rate", where, None, rate.value, "1", TOLERANCE["healing"],
        f"peak after elastic reloading minus steady friction, per e-fold of hold: {_interval(rate)}; reference "
        f"{B / 2:.4f} to {B}; peaks {listed}; {_scale_note(main)}", error=rate.half / 2, **reference,
    )  # fmt: skip


def _rate_state_fit(result: GougeResult | None) -> list[Claim]:
    """Claims about a, b and D_c, from a slip-law fit to mean velocity steps with radiation damping."""
    printed = {"a": A, "b": B, "a-minus-b": A - B, "dc": DC}
    units, tolerance = {"dc": "m"}, TOLERANCE["rate and state"]

    def where(name):
        return f"Fig S1: caption, {'a − b' if name == 'a-minus-b' else name} = {printed[name]:.3g}"

    if result is None:
        return [claim(n, where(n), v, None, units.get(n, "1"), tolerance, FULL) for n, v in printed.items()]
    records = [steps.data for steps in measures.mean_records(result)]
    seen = measures.response(result)
    eta = max(seen.impedance.value, 0.0)
    known = {"stiffness": stiffness(result.scenario) / result.scenario.load.normal_stress, "damping": eta}
    slip, aging = (fit(records, law=law, fixed=known) for law in ("slip", "aging"))
    value, low, high = slip.difference
    parameters = {n: (slip.values[n], slip.errors[n]) for n in ("a", "b", "dc")}
    parameters["a-minus-b"] = value, (high - low) / (2 * 1.96)
    speeds = [speed for speed in measures.velocities(result) if measures.steady_slip(result, speed) >= DC]
    levels = [measures.mean_friction(result, speed) for speed in speeds]
    steady = slope(np.log(speeds), levels) if len(speeds) > 1 else None  # per e-fold of velocity, a − b
    if steady and not np.isfinite(value):
        parameters["a-minus-b"] = steady.value, steady.half / 1.96
    note = (
        f"slip law fitted to steps averaged over branches, with known k and radiation damping η = {eta:.3f} s/m from "
        f"the peaks; from the peaks alone a = {_interval(seen.a)}, η = {_interval(seen.impedance)} s/m; "
        f"{f'a − b from steady friction {_interval(steady)}; ' if steady else ''}"
        f"{slip.sentence}{_joint_interval(slip)}; {compare_laws(slip, aging).sentence}; {_scale_note(result)}"
    )
    return [
        claim(n, where(n), printed[n], parameters[n][0], units.get(n, "1"), tolerance, note, error=parameters[n][1])
        for n in printed
    ]


def _joint_interval(found: Fit) -> str:
    """Describe the joint 95 % region of b and D_c, an ellipse; empty if the data do not determine both."""
    k, m = (found.names.index(name) for name in ("b", "dc"))
    (var_b, both), (_, var_dc) = found.covariance[np.ix_([k, m], [k, m])]
    if not np.isfinite(both):
        return ""
    half_b, half_dc = np.sqrt(chdtri(2, 0.05) * np.array([var_b, var_dc]))
    return (
        f"; joint 95 % region of b and D_c: {found.values['b']:.4f} ± {half_b:.4f} and {found.values['dc']:.2g} ± "
        f"{half_dc:.1g} m with a correlation of {both / np.sqrt(var_b * var_dc):.2f}"
    )


def _symmetry(result: GougeResult | None) -> Claim:
    where = "Text: not in the supplement"
    if result is None:
        note = "velocity steps were not run: part of stickslip reproduce gouge --full"
        return _statement("velocity-step-symmetry", where, None, note, study=STUDY)
    seen = measures.response(result)
    (v, w), *_ = [pair for pair in seen.peaks if (pair[1], pair[0]) in seen.peaks]
    forward, back = ((seen.peaks[pair], pair) for pair in ((v, w), (w, v)))
    sizes = [abs(n.value - seen.impedance.value * (pair[1] - pair[0])) for n, pair in (forward, back)]
    halves = float(np.hypot(forward[0].half, back[0].half))
    difference = sizes[0] - sizes[1]
    same = abs(difference) + halves <= TOLERANCE["rate and state"] * np.mean(sizes)  # otherwise equality is unknown
    alike = False if abs(difference) > halves else True if same else None
    return _statement(
        "velocity-step-symmetry", where, alike,
        f"peaks after {v:g} → {w:g} and {w:g} → {v:g} m/s minus radiation damping: {sizes[0]:.4f} and {sizes[1]:.4f}, "
        f"difference {difference:.4f} ± {halves:.4f}; {_scale_note(result)}", study=STUDY,
    )  # fmt: skip


def _compare_dampings(first: GougeResult, second: GougeResult) -> tuple[dict[str, tuple[Number, Number]], str]:
    """Relaxation (at the end of the shorter hold, per e-fold) and steady friction for two dampings, also as text."""
    before = measures.holds(first)[0]
    curves = [measures.hold_curve(result, before) for result in (first, second)]
    last = min(float(curve.x[-1]) for curve in curves)
    cut = [c._replace(x=c.x[c.x <= last * 1.01], rows=c.rows[:, c.x <= last * 1.01]) for c in curves]
    pairs = {
        f"change in friction over {last:.2g} s": tuple(c.at(last) for c in cut),
        "per e-fold": tuple(measures.per_efold(c) for c in cut),
        "steady friction": tuple(measures.mean_friction(result, before) for result in (first, second)),
    }
    return pairs, "; ".join(f"{name} {_interval(a)} and {_interval(b)}" for name, (a, b) in pairs.items())


def _restitution(holds: dict[str, GougeResult]) -> Claim:
    """Claim about holds with restitution 0.98 and 0.3, both according to Eq 8 as printed."""
    id, source = "restitution-insensitivity", 'Text: "restitution coefficient exerted no significant influence"'
    by_eq8 = [r for r in holds.values() if r.scenario.law.reading == "eq8"]
    if len(by_eq8) < 2:
        return statement(id, source, None, "only one restitution was run")
    pairs, listed = _compare_dampings(*by_eq8[:2])
    differences = {name: difference(*pair) for name, pair in pairs.items()}
    telling = all(half <= TELLING for name, (_, half) in differences.items() if name != "steady friction")
    apart = any(abs(value) > half for value, half in differences.values())
    gammas = " and ".join(f"{damping(r.scenario):.2g}" for r in by_eq8[:2])
    return statement(
        id, source, False if apart else True if telling else None,
        f"ε = 0.98 and 0.3 by Eq 8, γ_n = {gammas} 1/(m s); alike if all differences lie within their 95 % intervals: "
        f"{listed}; {_scale_note(by_eq8[1])}",
    )  # fmt: skip


def _collisions(holds: dict[str, GougeResult]) -> list[Claim]:
    """Claims about a damping with which collisions under the contact law do have the stated restitution of 0.98.

    With Eq 8 as printed, restitution is nearly 1. Both dampings and the resulting relaxation are compared.
    """
    id, said = "restitution-of-collisions", 'Text: "exerted no significant influence", from "nearly zero" to "nearly 1"'
    source = "Text: not in the paper; the other reading of its restitution"
    main = next(iter(holds.values()))
    other = next((r for r in holds.values() if r.scenario.law.reading == "collision"), None)
    if other is None:
        return [
            statement(id, said, None, "needs holds with a restitution of 0.98 under the contact law"),
            claim("calibrated-damping", source, None, None, "1", 0.5, "not run"),
        ]
    pairs, listed = _compare_dampings(main, other)
    apart = {name: difference(*pair) for name, pair in pairs.items()}
    differ = [name for name, (value, half) in apart.items() if abs(value) > half]
    plain, strong = next(iter(pairs.values()))
    error = np.hypot(strong.half, plain.half * strong.value / plain.value) / abs(2 * plain.value)
    return [
        statement(
            id, said, False if differ else None,
            f"if ε is the restitution of a collision under Eq 1, at 1.00 and 0.98: {listed}; outside their 95 % "
            f"intervals: {', '.join(differ) or 'none'}; {_scale_note(other)}",
        ),
        claim(
            "calibrated-damping", source, None, strong.value / plain.value, "1", 0.5,
            f"relaxation with γ_n = {damping(other.scenario):.2g} 1/(m s), which gives collisions a restitution of "
            f"0.98, over that with {damping(main.scenario):.2g}: {listed}; {_scale_note(other)}", error=float(error),
        ),
    ]  # fmt: skip


def _steady_sliding(main: GougeResult, more: dict[str, GougeResult]) -> list[Claim]:
    """Claims about steady friction, and about the granular temperature over the normal stress.

    The note on the temperature gives the direct effect.
    """
    runs = [main, *(r for name, r in more.items() if name in ("velocities", "steps"))]
    levels = {v: measures.mean_friction(r, v) for r in runs for v in measures.velocities(r)}
    listed = ", ".join(f"{_interval(n)} at {v:g} m/s" for v, n in sorted(levels.items()))
    steps, before = more.get("steps"), measures.holds(main)[-1]
    result = steps or main
    chosen = result.scenario
    mean = measures.mean_of(result, before, "temperature")
    normalised = mean.value * chosen.grains.density / chosen.load.normal_stress
    seen = measures.response(steps) if steps else None
    direct = f"a = {_interval(seen.a)}" if seen else f"a was not measured; the paper's value is {A}"
    ratio = measures.sliding_energy_ratio(main, before)
    return [
        claim(
            "steady-friction", "Text: no steady friction is printed", None, levels[before].value, "1",
            TOLERANCE["steady"],
            f"{listed}; friction is correlated over {measures.correlation_slip(main, before):.2g} D of slip; "
            f"{_scale_note(main)}",
            error=levels[before].half / 2, reference=sum(STEADY) / 2,
            reference_source=f"midpoint of {STEADY[0]} to {STEADY[1]}, known for gouge made of such grains",
        ),
        claim(
            "granular-temperature", "Text: not in the supplement", None, normalised, "1", 0.5,
            f"ρ T/σ at {before:g} m/s, where T = {mean.value:.2g} ± {mean.half:.1g} m²/s² is the mean of v_y² and "
            f"v_z²; its square root {normalised**0.5:.1e}, kinetic over elastic energy {ratio.value:.1e} ± "
            f"{ratio.half:.0e}; {direct}; {EARLIER}, states that a suitable normalisation by the confining pressure "
            f"gives an estimate of a, but its formula was not available; {_scale_note(result)}",
            error=mean.half / 2 / mean.value * normalised,
        ),
    ]  # fmt: skip


def _energies(main: GougeResult) -> list[Claim]:
    """Claims that sliding and holds are quasi-static, and that the energy ledger closes.

    The former follows from the inertial number, the kinetic energy and creep; the latter shows where the work of the
    spring goes.
    """
    chosen, before = main.scenario, measures.holds(main)[-1]
    thickness = main.realizations[0].range.thickness * chosen.grains.mean
    number = inertial_numbers(chosen, before, thickness)["mean_grain"]
    sliding = measures.sliding_energy_ratio(main, before)
    held, creep = measures.energy_ratio(main, before), measures.creep_velocity(main, before)
    last = float(held.x[-1])
    ratios = ", ".join(f"{held.at(t).value:.1e} after {t:g} s" for t in (1e-3, 1e-2, 1e-1, 1.0) if t <= last * 1.01)
    quasi_static = _statement(
        "quasi-static", "Text: the supplement calls its simulations quasi-static and prints no number",
        bool(number < INERTIAL and sliding.value + np.nan_to_num(sliding.half) < ENERGY),
        f"at {before:g} m/s inertial number {number:.1e}, kinetic over elastic energy {sliding.value:.1e} ± "
        f"{sliding.half:.0e}; in holds {ratios}; the plate creeps at {creep.at(last / 1.4).value:.1e} m/s at the end "
        f"of {last:g} s; {_scale_note(main)}",
        study=f"inertial number below {INERTIAL:g} (da Cruz et al. 2005), kinetic over elastic energy below {ENERGY:g}",
    )  # fmt: skip
    books = [sample.ledger for sample in main.realizations if sample.ledger]
    source, study = "Text: not in the paper; a check of this package", "conservation of energy"
    if not books:
        return [quasi_static, _statement("energy-balance", source, None, "no ledger was recorded", study=study)]
    work, coulomb, rolling, viscous, curl = (
        np.mean([b[name][-1] - b[name][0] for b in books])
        for name in ("external", "coulomb", "rolling", "viscous", "nonpotential")
    )
    friction = coulomb + rolling
    defect = max(float(np.abs(b["defect"]).max()) for b in books) / max(abs(friction + viscous), 1e-300)
    balance = _statement(
        "energy-balance", source, bool(defect < LEDGER),
        f"the ledger closes to within {defect:.0e} of the dissipated energy, of which friction accounts for "
        f"{friction / (friction + viscous):.1%}; work of loads {work:.3g} J, energy created by tangential springs "
        f"{curl:.1e} J",
        study=study,
    )  # fmt: skip
    return [quasi_static, balance]
