"""Paper 003, at a reduced scale: Ferdowsi and Rubin, slide-hold-slide and velocity steps of granular fault gouge.

The paper's cell has about 4800 grains and velocities down to 0.2 mm/s, at time steps of 20 ns: months of one core. Here
a tenth of the grains slides at a tenth of a metre a second. `examples/gouge_paper.toml` is the paper's own scale.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..data.gouge_scenario import GougeScenario
from ..data.scenario import scenario
from ..ensemble import Workers
from ..friction.evidence import compare
from ..friction.fit import fit
from ..loading import gouge_measures as measures
from ..loading.gouge_ensemble import GougeResult, simulate_gouge
from ..loading.gouge_numbers import INERTIAL, stiffness
from .claims import PARTLY, Claim, claim
from .gouge_report import after_longest, foretell, healed, predicted

CUTS = (
    "4 realizations of 340 grains instead of 16 of 500, in a shorter cell; one hold at 0.3 m/s instead of three; "
    "holds up to 10 ms instead of 50 ms; velocities from 0.1 instead of 0.03 m/s; less slip before it all"
)
FAST, MIDDLE, SLOW = 0.3, 0.1, 0.03  # velocities [m/s]
A, B, DC = 0.0247, 0.0178, 5.3e-3  # of paper 003
STEADY = (0.33, 0.42)  # steady friction of such gouge
PEAK_SLOPE = 0.0155
TELLING = 0.05  # difference of steady friction that must be told from zero before samples are called alike
EARLY = f"over slips of the load point up to {measures.EARLY:g} D"

Report = Callable[[str, float, str], None]


class Reproduction(NamedTuple):
    """The scenario, run, its twin with strongly damped contacts, and the claims that both support."""

    main: GougeResult
    damped: GougeResult
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> GougeScenario:
    """Steady sliding, velocity steps down and up, and slides after holds, at the reduced scale."""
    number, length, runs = (340, 0.024, 4) if quick else (500, 0.03, 16)
    velocities = (FAST, MIDDLE, FAST) if quick else (FAST, SLOW, FAST, SLOW, FAST)
    cycle = {
        "kind": "slide-hold-slide", "before": (FAST,), "holds": (1e-3, 1e-2) if quick else (1e-3, 1e-2, 5e-2),
        "after": (FAST,) if quick else (MIDDLE, FAST), "approach": 1.0, "slip": 0.4, "twin": 0.4,
    }  # fmt: skip
    slow = cycle | {"before": (MIDDLE if quick else SLOW,), "after": (MIDDLE, FAST) if quick else (SLOW, MIDDLE, FAST)}
    slow["holds"] = cycle["holds"][-1:]
    return scenario(
        experiment="gouge", seed=seed, realizations=runs, dt=2e-7, sample_every=250, ledger_steps=2000,
        grains={"number": number}, cell={"length": length}, preparation={"slip": 5.0 if quick else 8.0},
        protocol=[
            {"kind": "velocity-steps", "velocities": velocities, "slip": 1.0, "twin": 0.3},
            *[cycle] * (1 if quick else 3),
            slow,
        ],
    )  # fmt: skip


def damped_scenario(chosen: GougeScenario) -> GougeScenario:
    """The same with restitution 0.3: steady sliding, the shorter holds, and slides after them."""
    cycle = chosen.protocol[1]
    protocol = [part.model_dump() for part in chosen.protocol[1:-1][:2]]
    for part in protocol:
        part |= {"holds": cycle.holds[:2], "after": (FAST,)}
    law = chosen.law.model_copy(update={"restitution": 0.3})
    return scenario(**chosen.model_dump() | {"law": law.model_dump(), "protocol": protocol, "ledger_steps": 0})


def reproduce(
    *,
    quick: bool = False,
    seed: int = 0,
    folder: Path | None = None,
    workers: Workers = None,
    report: Report = lambda stage, share, words: None,
) -> Reproduction:
    """Run both scenarios and judge the claims; arguments as in `simulate_gouge`."""
    chosen = paper_scenario(quick=quick, seed=seed)
    foretell(chosen)
    main = simulate_gouge(chosen, folder=folder, workers=workers, report=report)
    second = damped_scenario(chosen)
    damped = simulate_gouge(
        second, folder=folder, workers=workers, report=lambda stage, *rest: report(f"restitution 0.3: {stage}", *rest)
    )
    return Reproduction(main, damped, judged(main, damped))


def judged(main: GougeResult, damped: GougeResult) -> list[Claim]:
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


def _yes(id: str, source: str, measured: bool | None, note: str) -> Claim:
    """Something that the paper says is so; partly if it was measured but cannot be decided."""
    if measured is None:
        note = f"{note}; its interval is too wide: too few realizations to decide"
        return claim(id, source, True, None, "", 0.0, note)._replace(verdict=PARTLY)
    return claim(id, source, True, measured, "", 0.0, note)


def _steady(main: GougeResult) -> Claim:
    found = {v: measures.mean_friction(main, v) for v in measures.velocities(main)}
    words = ", ".join(f"{_told(n)} at {v:g} m/s" for v, n in found.items())
    middle, half = sum(STEADY) / 2, (STEADY[1] - STEADY[0]) / 2
    return claim(
        "steady-friction", "gouge of such grains", middle, found[FAST].value, "1", half / middle,
        f"known values lie between {STEADY[0]} and {STEADY[1]}; {words}; {_scale(main)}", error=found[FAST].half / 2,
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
    return [
        _yes(
            "direct-effect-sign", "a = 0.0247", _decided(both),
            f"{words}; differences to copies that go on at the old velocity; the paper's a is {A}; {_scale(main)}",
        ),
        _yes(
            "velocity-step-symmetry", "Ferdowsi and Rubin 2020", alike,
            f"up less down {_told(apart)} where their mean is {_told(both)}; {words}; {_scale(main)}",
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
        "a-minus-b", "slip-law fits", A - B, value, "1", 0.3,
        f"a − b = {value:.4f}, {interval}, by the slip law, all steps at once, k known"
        f"{'; ' + told if told else ''}; {slip.sentence or 'all parameters are known'}; "
        f"{compare(slip, aging).sentence}; paper: a {A}, b {B}, dc {DC:g} m; not comparable: a − b lies "
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
    apart = abs(laws["slip"] - laws["aging"])
    words = (
        f"change of friction after {curve.x[-1]:g} s at V_i = {before:g} m/s: {_told(drop)}; slip law "
        f"{laws['slip']:.4f}, aging law {laws['aging']:.4f} with the paper's a, b and dc"
    )
    if apart < drop.half:
        words += f"; the laws differ by {apart:.1e}, less than its interval: such short holds do not tell them apart"
    words += f"; not comparable: holds of seconds, and those after slow sliding; {_scale(main)}"
    return [
        claim("hold-relaxation-law", "Fig S1", laws["slip"], drop.value, "1", 0.3, words, error=drop.half / 2),
        _yes("compaction-in-holds", "Fig S1", _decided(thinner) if _decided(late) else None,
             f"thickness lost in {thickness.x[-1]:g} s at V_i = {before:g} m/s: {1e6 * thinner.value:.1f} ± "
             f"{1e6 * thinner.half:.1f} µm; in its last nineteen twentieths {late.value:.1e} ± {late.half:.0e} of the "
             f"thickness per e-fold of time, where the paper has it go on with the logarithm of time; {_scale(main)}"),
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
        "healing-rate", "b/2 to b per e-fold", 0.75 * B, slope.value, "1", 1 / 3,
        f"excess of friction over copies without a hold, {EARLY}, per e-fold of hold: {_told(slope)}; paper "
        f"{B / 2:.4f} to {B}; {words}; {_scale(main)}", error=slope.half / 2,
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
        "peak-vs-velocity-ratio", "Fig S2a, inset", PEAK_SLOPE, slope.value, "1", 0.3,
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
    return _yes(
        "restitution-insensitivity", "supplement, text", alike if halves["steady friction"] <= TELLING else None,
        f"restitution 0.98 and 0.3, alike within their 95 % intervals: {words}; hold of {hold:g} s; {_scale(main)}",
    )  # fmt: skip


def _inertial(main: GougeResult) -> Claim:
    largest = max(one.range.inertial_number for one in main.realizations)
    return _yes(
        "inertial-number", "quasi-static range", bool(largest < INERTIAL),
        f"at most {largest:.1e} at {FAST:g} m/s, (V/H) D √(ρ/σ); quasi-static below {INERTIAL:g}",
    )  # fmt: skip


def _energies(main: GougeResult) -> Claim:
    """The ledger of a stretch of sliding: where the work of the spring goes."""
    books = [one.ledger for one in main.realizations if one.ledger]
    work, coulomb, viscous, curl = (
        np.mean([b[name][-1] - b[name][0] for b in books])
        for name in ("external", "coulomb", "viscous", "nonpotential")
    )
    defect = max(float(np.abs(b["defect"]).max()) for b in books) / max(abs(coulomb + viscous), 1e-300)
    return _yes(
        "energy-balance", "this package", bool(defect < 1e-2),
        f"the ledger closes to {defect:.0e} of what is dissipated; of this, friction takes "
        f"{coulomb / (coulomb + viscous):.1%}; work of loads {work:.3g} J, created by tangential springs {curl:.1e} J",
    )  # fmt: skip
