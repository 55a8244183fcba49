"""Evaluation of statements of Ferdowsi & Rubin 2021 that follow from closed forms or from measured curves."""

import numpy as np

from ....kit import Claim, claim
from ....laws import collision, elastic_constants, hertz_mindlin_reff
from ...faults.friction.fitting import fit
from ...faults.friction.loads import LoadStep
from ...faults.friction.model import Data
from ...faults.friction.model_comparison import LawComparison, compare_laws
from ...faults.friction.ratestate import RateState, Spring, spring_slider
from . import measures
from .curves import predict_per_efold, reslides_after_longest
from .dimensionless import normalised_hold, stiffness
from .scenario import GougeScenario
from .simulate import GougeResult
from .statistics import Number, combine, slope

A, B, DC, PEAK_SLOPE, COLLAPSE = 0.0247, 0.0178, 5.3e-3, 0.0155, 5.0  # captions of Figs S1 and S2, inset of S2
STIFFNESS, HOLD, BEFORE = 425.0, 1650.0, 0.02  # k̄_d; t̄_hold; V_i of Fig S2 [m/s]
SMALLEST, SPEED, STEP = (1e-3, 25.0, 2e-8)  # diameter (not printed) [m]; speed [m/s]; Δt of Table S1 [s]
ROUNDED = 0.25  # tolerance of Δt: it is printed with one digit, from 1.5e-8 to 2.5e-8
PEAK = 0.3  # tolerance of the peak, as of all numbers of rate-and-state friction
STUDY = "Ferdowsi and Rubin 2021, doi:10.1029/2021JB022125, abstract"
FULL = "not run: part of stickslip reproduce gouge --full"
UNDEFINED = (
    f"t̄ = {HOLD:g} is read as k V_i t/(a σ), 1.43 s; as V_i t/D_c it would be 437 s. By both laws the slope does not "
    f"depend on the hold"
)


def evaluate_text(main: GougeResult, reslides: GougeResult | None) -> list[Claim]:
    """Evaluate the statements; `reslides` is the result with slides at several velocities after one hold."""
    return [
        *_peaks(reslides), _time_step(main.scenario), _definitions(main.scenario), _law_of_holds(main), _bands(main),
        _damping_ratio(),
    ]  # fmt: skip


def _peaks(result: GougeResult | None) -> list[Claim]:
    """Claims about the peak at V_r = V_i, the collapse of normalised peaks, and the slope of peaks below b."""
    paper, where = COLLAPSE * PEAK_SLOPE, "Fig S2: panel b and inset, C ≈ 5 times the slope 0.0155"
    collapse = "Fig S2: caption, (μ − μ_ss)/(C + ln(V_r/V_i)) with C ≈ 5"
    below = "Fig S2: inset of panel a, slope 0.0155 < b = 0.0178"
    if result is None:
        return [
            claim("peak-at-equal-velocities", where, paper, None, "1", PEAK, FULL),
            claim("collapse-of-peaks", collapse, True, None, "", 0.0, FULL),
            claim("slope-below-b", below, True, None, "", 0.0, FULL),
        ]
    before = measures.holds(result)[0]
    _, after, peaks, _ = reslides_after_longest(result, before)
    x = np.log(after / before)
    first, rate, off = peaks[int(np.argmin(np.abs(x)))], slope(x, peaks), collapse_defect(x, peaks)
    return [
        claim(
            "peak-at-equal-velocities", where, paper, None, "1", PEAK,
            "t̄ = V_i t/D_c, 437 s, is the only definition for which the printed peak lies between the laws: see "
            "definition-of-hold-time; slides after such a hold would decide it",
        ),
        claim(
            "peak-at-equal-velocities@frozen", where, paper, first.value, "1", PEAK,
            f"after 1.43 s, t̄ = k V_i t/(a σ): {first.value:.4f} ± {first.half:.4f}", error=first.half / 2,
        ),
        claim(
            "collapse-of-peaks", collapse, True, False if abs(off.value) > off.half else None, "", 0.0,
            f"slope of peaks minus a fifth of the peak at V_r = V_i: {off.value:.4f} ± {off.half:.4f}, zero if peaks "
            f"are proportional to 5 + ln(V_r/V_i); an interval that contains zero does not show that they collapse",
        ),
        claim(
            "slope-below-b", below, True, below_or_not(rate, B), "", 0.0,
            f"slope {rate.value:.4f} ± {rate.half:.4f} per e-fold of V_r/V_i, b = {B}",
        ),
    ]  # fmt: skip


def collapse_defect(x: np.ndarray, peaks: list[Number]) -> Number:
    """Slope of peaks against x = ln(V_r/V_i), minus their value at x = 0 over C; zero if they are ∝ C + x."""
    return combine(peaks, lambda y: np.subtract(*np.polyfit(x, y, 1) * (1, 1 / COLLAPSE)))


def below_or_not(number: Number, limit: float) -> bool | None:
    """Whether a number is below a limit; None if the limit lies in its 95 % interval, or if that is not known."""
    return bool(number.value < limit) if abs(number.value - limit) > number.half else None


def _time_step(scenario: GougeScenario) -> Claim:
    """Claim about a hundredth of the duration of a collision between two of the smallest grains."""
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
    """Hold time [s] that is t̄ = 1650 by one of the definitions of `normalised_hold`, for a spring k [Pa/m]."""
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
    """Claim about the definitions of k̄ and t̄: the printed peak must lie between those of the two laws."""
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
    """Compare slip and aging law for a hold by likelihood, with the paper's a, b and D_c and a free level.

    Only times from `measures.EARLIEST` on are used.

    Parameters
    ----------
    time, friction : (T,) since the start of the hold [s], [1]
    before : velocity before it [m/s]
    spring : stiffness per unit normal stress [1/m]
    """
    last = float(time[-1]) * (1 + 1e-9)
    data = Data(time, friction, (LoadStep(last, 0.0),), before=before)
    fixed = {"a": A, "b": B, "dc": DC, "stiffness": spring}
    window = [(min(measures.EARLIEST, last / 10), last)]
    return compare_laws(*(fit(data, law=law, fixed=fixed, windows=window) for law in ("slip", "aging")))


def _law_of_holds(main: GougeResult) -> Claim:
    before = measures.holds(main)[-1]
    curve, rate = measures.hold_curve(main, before), measures.per_efold(measures.hold_curve(main, before))
    made = compare_hold_laws(curve.x, curve.mean, before, stiffness(main.scenario) / main.scenario.load.normal_stress)
    expected = {law: predict_per_efold(main, before, curve.x, law) for law in ("slip", "aging")}
    inside = {law: abs(rate.value - value) <= rate.half for law, value in expected.items()}
    measured = None if made.preferred is None else made.preferred == "slip" and inside["slip"]
    slopes = ", ".join(f"{law} law {value:.4f}" for law, value in expected.items())
    return claim(
        "slip-law-in-holds", "Fig S1: curves of both laws; no statement in the supplement", None,
        measured if measured is None or inside["slip"] != inside["aging"] else None, "", 0.0,
        f"{made.sentence}, from {min(measures.EARLIEST, curve.x[-1] / 10):g} s on with a free level; slope per e-fold "
        f"{rate.value:.4f} ± {rate.half:.4f}: {slopes}. Both laws predict a larger decrease before that time",
        reference=True, reference_source=STUDY,
    )  # fmt: skip


def _bands(main: GougeResult) -> Claim:
    curve = measures.hold_curve(main, measures.holds(main)[-1])
    return claim(
        "bands-of-holds", "Fig S1: shaded, 2σ of 8 realizations; no number is printed", None, float(curve.band[-1]),
        "1", PEAK, f"2σ over {len(curve.rows)} branches at the end of the longest hold",
    )  # fmt: skip


def _damping_ratio() -> Claim:
    return claim(
        "damping-ratio", 'Text: "the choices of the ratio have little impact"', True, None, "", 0.0,
        "γ_t = γ_n/2 was used throughout; holds with γ_t = 0 and γ_t = γ_n in as many samples would decide it",
    )  # fmt: skip
