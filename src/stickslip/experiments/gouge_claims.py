"""Claims of paper 003, judged: the supplement of Ferdowsi and Rubin's study of slide-hold-slide.

The supplement prints a, b, D_c, a slope of peaks, and that restitution does not matter. What the study itself or others
say is a reference.
"""

import numpy as np

from ..friction.evidence import compare
from ..friction.fit import fit
from ..loading import gouge_measures as measures
from ..loading.gouge_ensemble import GougeResult
from ..loading.gouge_numbers import INERTIAL, stiffness
from .claims import Claim, claim
from .gouge_curves import after_longest, healed, predicted

FAST = 0.3  # velocity at which steady friction is compared [m/s]
A, B, DC = 0.0247, 0.0178, 5.3e-3  # caption of Fig S1
STEADY = (0.33, 0.42)  # steady friction of such gouge
PEAK_SLOPE = 0.0155
TELLING = 0.05  # difference of steady friction that must be told from zero before samples are called alike
EARLY = f"over slips of the load point up to {measures.EARLY:g} D"
LEDGER = 1e-2  # of what is dissipated: what the ledger may miss, so that its shares are good to a per cent
TOLERANCE = {
    "steady": (STEADY[1] - STEADY[0]) / (STEADY[1] + STEADY[0]),  # the range that is known
    "rate and state": 0.3,  # b is 28 % less than a: what is farther off could be the other
    "healing": 1 / 3,  # the range from b/2 to b
}
STUDY = "the study whose supplement the paper is, Ferdowsi and Rubin; its text was not at hand"
SHOWS = {
    "Fig S1": ("friction in holds; a, b and D_c of velocity steps", "a-minus-b"),
    "Fig S2": ("slides after holds", "peak-vs-velocity-ratio"),
    "Text": ("restitution and the range of the model", "restitution-insensitivity"),
}


def evaluated(main: GougeResult, damped: GougeResult) -> list[Claim]:
    """All claims, each with the scale at which it was measured."""
    return [
        _steady(main), *_steps(main), _fitted(main), *_holds(main), _healing(main), _peaks(main),
        _restitution(main, damped), _inertial(main), _energies(main),
    ]  # fmt: skip


def _scale(result: GougeResult) -> str:
    """At which reduced scale something was measured."""
    chosen, speeds = result.scenario, [t.velocity for t in result.realizations[0].tests if t.velocity > 0]
    return (
        f"{len(result.realizations)} × {chosen.grains.number} grains at {min(speeds):g} to {max(speeds):g} m/s, "
        f"paper 8 × 4800 down to 2e-4 m/s"
    )


def _told(number: measures.Number) -> str:
    return f"{number.value:.4f} ± {number.half:.4f}"


def _decided(number: measures.Number) -> bool | None:
    """Whether a number is positive; None if its 95 % interval holds zero."""
    return bool(number.value > 0) if abs(number.value) > number.half else None


def _statement(id: str, source: str, measured: bool | None, note: str, *, study: str = "") -> Claim:
    """Something that the paper says is so, or, with an origin, something else does."""
    if measured is None:
        note = f"{note}; its interval is too wide: too few realizations to decide"
    if study:
        return claim(id, source, None, measured, "", 0.0, note, reference=True, reference_source=study)
    return claim(id, source, True, measured, "", 0.0, note)


def _steady(main: GougeResult) -> Claim:
    found = {v: measures.mean_friction(main, v) for v in measures.velocities(main)}
    words = ", ".join(f"{_told(n)} at {v:g} m/s" for v, n in found.items())
    return claim(
        "steady-friction", "Text: no steady friction is printed", None, found[FAST].value, "1", TOLERANCE["steady"],
        f"{words}; {_scale(main)}", error=found[FAST].half / 2, reference=sum(STEADY) / 2,
        reference_source=f"middle of {STEADY[0]} to {STEADY[1]}, known of gouge of such grains",
    )  # fmt: skip


def _steps(main: GougeResult) -> list[Claim]:
    """Direct effects of steps down and up, from pairs that share their fluctuations."""
    curves = {pair: measures.step_curve(main, *pair, twin=True) for pair in measures.steps(main)}
    effects = {pair: measures.direct_effect(curve, *pair) for pair, curve in curves.items()}
    down = measures.average([n for (v, w), n in effects.items() if w < v])
    up = measures.average([n for (v, w), n in effects.items() if w > v])
    words = f"per e-fold of velocity, {EARLY}: down {_told(down)}, up {_told(up)}"
    apart = measures.combined([up, down], lambda pair: pair[0] - pair[1])
    both = measures.average([down, up])
    alike = None if not abs(both.value) > apart.half else bool(abs(apart.value) <= apart.half)
    note = f"{words}; differences to copies that go on at the old velocity; {_scale(main)}"
    return [
        claim("direct-effect", "Fig S1: caption, a = 0.0247", A, both.value, "1", TOLERANCE["rate and state"], note,
              error=both.half / 2),
        _statement("direct-effect-sign", "Fig S1: caption, a = 0.0247 is positive", _decided(both), note),
        _statement(
            "velocity-step-symmetry", "Text: not in the supplement", alike,
            f"up less down {_told(apart)} where their mean is {_told(both)}; {words}; {_scale(main)}", study=STUDY,
        ),
    ]  # fmt: skip


def _fitted(main: GougeResult) -> Claim:
    """Rate-and-state fits to the velocity steps of all realizations at once, as a laboratory would do them."""
    records = [steps.data for steps in measures.step_records(main, samples=200)]
    known = {"stiffness": stiffness(main.scenario) / main.scenario.load.normal_stress}
    slip, aging = (fit(records, law=law, fixed=known) for law in ("slip", "aging"))
    value, low, high = slip.difference
    interval = f"95 % interval {low:.4f} to {high:.4f}" if np.isfinite(low) else "without an interval"
    told = ", ".join(f"{name} = {slip.values[name]:.3g}" for name in ("a", "b", "dc") if np.isfinite(slip.values[name]))
    return claim(
        "a-minus-b", "Fig S1: caption, a = 0.0247 and b = 0.0178", A - B, value, "1", TOLERANCE["rate and state"],
        f"a − b = {value:.4f}, {interval}, by the slip law, all steps at once, k known"
        f"{'; ' + told if told else ''}; {slip.sentence or 'all parameters are known'}; "
        f"{compare(slip, aging).sentence}; paper: a {A}, b {B}, dc {DC:g} m; a − b lies "
        f"below the noise of a cell this small, and D_c in metres belongs to grains of other sizes; {_scale(main)}",
        error=(high - low) / (2 * 1.96),
    )  # fmt: skip


def _holds(main: GougeResult) -> list[Claim]:
    """Relaxation and compaction in the longest hold, after the highest velocity."""
    before = measures.holds(main)[-1]
    curve = measures.hold_curve(main, before)
    laws = {law: float(change[-1]) for law, (_, change) in predicted(main, before, curve.x).items()}
    drop = curve.at(len(curve.x) - 1)
    thickness = measures.hold_curve(main, before, "thickness")
    thinner, late = thickness.at(len(thickness.x) - 1), measures.compaction(main, before)
    thinner = thinner._replace(value=-thinner.value)
    words = (
        f"change of friction after {curve.x[-1]:g} s at V_i = {before:g} m/s: {_told(drop)}; slip law "
        f"{laws['slip']:.4f}, aging law {laws['aging']:.4f} with the paper's a, b and dc"
    )
    apart = abs(laws["slip"] - laws["aging"])
    if apart < drop.half:
        words += f"; the laws differ by {apart:.1e}, less than its interval: such short holds do not tell them apart"
    words += f"; holds of seconds, and those after slow sliding, are out of reach; {_scale(main)}"
    return [
        claim(
            "hold-relaxation-law", "Fig S1: curves; no number is printed", None, drop.value, "1",
            TOLERANCE["rate and state"], words, error=drop.half / 2, reference=laws["slip"],
            reference_source="slip law at this hold, with the a, b and D_c that the paper prints",
        ),
        _statement(
            "compaction-in-holds", "Text: not in the supplement", _decided(thinner) if _decided(late) else None,
            f"thickness lost in {thickness.x[-1]:g} s at V_i = {before:g} m/s: {1e6 * thinner.value:.1f} ± "
            f"{1e6 * thinner.half:.1f} µm; in its last nineteen twentieths {late.value:.1e} ± {late.half:.0e} of the "
            f"thickness per e-fold of time, where the study has it go on with the logarithm of time; {_scale(main)}",
            study=STUDY,
        ),
    ]  # fmt: skip


def _healing(main: GougeResult) -> Claim:
    before = measures.holds(main)[-1]
    times, peaks, _ = healed(main, before)
    excess = [measures.just_after(measures.reslide_curve(main, before, t, before, twin=True)) for t in times]
    slope = measures.slope(np.log(times), excess)
    words = "; ".join(
        f"{_told(e)} after {t:g} s, peak less steady friction {_told(p)}"
        for t, e, p in zip(times, excess, peaks, strict=True)
    )
    return claim(
        "healing-rate", "Text: not in the supplement", None, slope.value, "1", TOLERANCE["healing"],
        f"excess of friction over copies without a hold, {EARLY}, per e-fold of hold: {_told(slope)}; reference "
        f"{B / 2:.4f} to {B}; {words}; {_scale(main)}", error=slope.half / 2, reference=0.75 * B,
        reference_source=f"middle of b/2 to b per e-fold of hold, {STUDY}",
    )  # fmt: skip


def _peaks(main: GougeResult) -> Claim:
    before = measures.holds(main)[0]
    _, after, peaks, hold = after_longest(main, before)
    excess = [measures.just_after(measures.reslide_curve(main, before, hold, v, twin=True)) for v in after]
    slope = measures.slope(np.log(after / before), excess)
    words = "; ".join(
        f"{_told(e)} at V_r/V_i = {r:.3g}, peak less steady friction {_told(p)}"
        for r, e, p in zip(after / before, excess, peaks, strict=True)
    )
    return claim(
        "peak-vs-velocity-ratio", "Fig S2: inset of panel a, slope = 0.0155", PEAK_SLOPE, slope.value, "1",
        TOLERANCE["rate and state"],
        f"excess of friction over copies without a hold, {EARLY}, per e-fold of the ratio: {_told(slope)}; {words}; "
        f"after holds of {hold:g} s at V_i = {before:g} m/s; {_scale(main)}", error=slope.half / 2,
    )  # fmt: skip


def _restitution(main: GougeResult, damped: GougeResult) -> Claim:
    """Steady friction, relaxation in a hold and peak after it, with restitution 0.98 and 0.3."""
    before = measures.holds(damped)[0]
    hold, after = next((h, w) for v, h, w in measures.reslides(damped) if v == before)

    def seen(result):
        curve = measures.hold_curve(result, before)
        at = int(np.abs(curve.x - hold).argmin())
        return {
            "steady friction": measures.mean_friction(result, FAST),
            "change in the hold": curve.at(at),
            "excess after it": measures.just_after(measures.reslide_curve(result, before, hold, after, twin=True)),
        }

    pairs = {name: (a, seen(damped)[name]) for name, a in seen(main).items()}
    halves = {name: float(np.hypot(a.half, b.half)) for name, (a, b) in pairs.items()}
    alike = all(abs(a.value - b.value) <= halves[name] for name, (a, b) in pairs.items())
    words = "; ".join(f"{name} {_told(a)} and {_told(b)}" for name, (a, b) in pairs.items())
    return _statement(
        "restitution-insensitivity", 'Text: "restitution coefficient exerted no significant influence"',
        alike if halves["steady friction"] <= TELLING else None,
        f"restitution 0.98 and 0.3, alike within their 95 % intervals: {words}; hold of {hold:g} s; {_scale(main)}",
    )  # fmt: skip


def _inertial(main: GougeResult) -> Claim:
    largest = max(one.range.inertial_number for one in main.realizations)
    return _statement(
        "inertial-number", "Text: the supplement calls its simulations quasi-static and prints no number",
        bool(largest < INERTIAL),
        f"at most {largest:.1e} at {FAST:g} m/s, (V/H) D √(ρ/σ)",
        study=f"quasi-static below {INERTIAL:g}, da Cruz et al. 2005",
    )  # fmt: skip


def _energies(main: GougeResult) -> Claim:
    """The ledger of a stretch of sliding: where the work of the spring goes."""
    books = [one.ledger for one in main.realizations if one.ledger]
    work, coulomb, viscous, curl = (
        np.mean([b[name][-1] - b[name][0] for b in books])
        for name in ("external", "coulomb", "viscous", "nonpotential")
    )
    defect = max(float(np.abs(b["defect"]).max()) for b in books) / max(abs(coulomb + viscous), 1e-300)
    return _statement(
        "energy-balance", "Text: not in the paper, a check of this package", bool(defect < LEDGER),
        f"the ledger closes to {defect:.0e} of what is dissipated; of this, friction takes "
        f"{coulomb / (coulomb + viscous):.1%}; work of loads {work:.3g} J, created by tangential springs {curl:.1e} J",
        study="conservation of energy",
    )  # fmt: skip
