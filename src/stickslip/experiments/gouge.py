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
from ..loading import gouge_measures as measures
from ..loading.gouge_ensemble import GougeResult, simulate_gouge
from ..loading.gouge_numbers import INERTIAL
from .claims import Claim, claim
from .gouge_report import after_longest, foretell, healed, predicted

CUTS = (
    "2 realizations of 340 grains instead of 8 of 500, in a shorter cell; one hold at 0.3 m/s instead of three; "
    "holds up to 10 ms instead of 50 ms; velocities from 0.1 instead of 0.03 m/s; less slip before it all"
)
FAST, MIDDLE, SLOW = 0.3, 0.1, 0.03  # velocities [m/s]
A, B, DC = 0.0247, 0.0178, 5.3e-3  # of paper 003
STEADY = (0.33, 0.42)  # steady friction of such gouge
PEAK_SLOPE = 0.0155
EARLY = "at slips of the load point from {} to {} D".format(*measures.EARLY)

Report = Callable[[str, float, str], None]


class Reproduction(NamedTuple):
    """The scenario, run, its twin with strongly damped contacts, and the claims that both support."""

    main: GougeResult
    damped: GougeResult
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> GougeScenario:
    """Steady sliding, velocity steps down and up, and slides after holds, at the reduced scale."""
    number, length, runs = (340, 0.024, 2) if quick else (500, 0.03, 8)
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
    workers: int | None = None,
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
        _steady(main), *_steps(main), *_holds(main), _healing(main), _peaks(main), _restitution(main, damped),
        _inertial(main), _energies(main),
    ]  # fmt: skip


def _scale(result: GougeResult) -> str:
    """At which reduced scale something was measured."""
    chosen, runs = result.scenario, len(result.realizations)
    return (
        f"{runs} realizations of {chosen.grains.number} grains of 2 to 4 mm at {SLOW:g} to {FAST:g} m/s "
        f"(paper: 8 of some 4800 grains of 1 to 5 mm, down to 2e-4 m/s)"
    )


def _told(number: measures.Number) -> str:
    return f"{number.value:.4f} ± {number.error:.4f}"


def _decided(number: measures.Number) -> bool | None:
    """Whether a number is positive; None if its sign is not known to two errors."""
    return None if not abs(number.value) > 2 * number.error else bool(number.value > 0)


def _steady(main: GougeResult) -> Claim:
    found = {v: measures.mean_friction(main, v) for v in measures.velocities(main)}
    words = ", ".join(f"{_told(n)} at {v:g} m/s" for v, n in found.items())
    middle, half = sum(STEADY) / 2, (STEADY[1] - STEADY[0]) / 2
    return claim(
        "steady-friction", "gouge of such grains", middle, found[FAST].value, "1", half / middle,
        f"known values lie between {STEADY[0]} and {STEADY[1]}; {words}; {_scale(main)}", error=found[FAST].error,
    )  # fmt: skip


def _steps(main: GougeResult) -> list[Claim]:
    """Direct effects of steps down and up, from pairs that share their fluctuations."""
    curves = {pair: measures.step_curve(main, *pair, twin=True) for pair in measures.steps(main)}
    effects = {pair: measures.direct_effect(curve, *pair) for pair, curve in curves.items()}
    down = measures.average([n for (v, w), n in effects.items() if w < v])
    up = measures.average([n for (v, w), n in effects.items() if w > v])
    both = measures.average([down, up])
    words = f"per e-fold of velocity, {EARLY}: down {_told(down)}, up {_told(up)}"
    ratio = up.value / down.value if down.value else np.nan
    error = abs(ratio) * float(np.hypot(up.error / up.value, down.error / down.value))
    return [
        claim("direct-effect-sign", "a = 0.0247", True, _decided(both), "", 0.0,
              f"{words}; differences to copies that go on at the old velocity; the paper's a is {A}; {_scale(main)}"),
        claim("velocity-step-symmetry", "Ferdowsi and Rubin 2020", 1.0, ratio, "1", 0.5,
              f"direct effect up over down; {words}; {_scale(main)}", error=error),
    ]  # fmt: skip


def _holds(main: GougeResult) -> list[Claim]:
    """Relaxation and compaction in the longest hold, after the highest velocity."""
    before = measures.holds(main)[-1]
    curve = measures.hold_curve(main, before)
    laws = {law: float(change[-1]) for law, (_, change) in predicted(main, before, curve.x).items()}
    drop = measures.Number(float(curve.mean[-1]), float(curve.error[-1]))
    thinner = measures.compaction(main, before)
    apart = abs(laws["slip"] - laws["aging"])
    words = (
        f"change of friction after {curve.x[-1]:g} s at V_i = {before:g} m/s: {_told(drop)}; slip law "
        f"{laws['slip']:.4f}, aging law {laws['aging']:.4f} with the paper's a, b and dc"
    )
    if apart < 2 * drop.error:
        words += (
            f"; the laws differ by {apart:.1e}, less than two errors: holds as short as this do not tell them apart"
        )
    return [
        claim("hold-relaxation-law", "Fig S1", laws["slip"], drop.value, "1", 0.3, f"{words}; {_scale(main)}",
              error=drop.error),
        claim("compaction-in-holds", "Fig S1", True, _decided(thinner), "", 0.0,
              f"thickness lost per e-fold of hold: {thinner.value:.1e} ± {thinner.error:.0e} of it; {_scale(main)}"),
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
        f"{B / 2:.4f} to {B}; {words}; {_scale(main)}", error=slope.error,
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
        f"after holds of {hold:g} s at V_i = {before:g} m/s; {_scale(main)}", error=slope.error,
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
            "change in the hold": measures.Number(float(curve.mean[at]), float(curve.error[at])),
            "excess after it": measures.just_after(measures.reslide_curve(result, before, hold, after, twin=True)),
        }

    pairs = {name: (a, seen(damped)[name]) for name, a in seen(main).items()}
    alike = [bool(abs(a.value - b.value) <= 2 * np.hypot(a.error, b.error)) for a, b in pairs.values()]
    words = "; ".join(f"{name} {_told(a)} and {_told(b)}" for name, (a, b) in pairs.items())
    return claim(
        "restitution-insensitivity", "supplement, text", True, all(alike), "", 0.0,
        f"restitution 0.98 and 0.3, alike within two errors: {words}; hold of {hold:g} s; {_scale(main)}",
    )  # fmt: skip


def _inertial(main: GougeResult) -> Claim:
    largest = max(one.range.inertial_number for one in main.realizations)
    return claim(
        "inertial-number", "quasi-static range", True, bool(largest < INERTIAL), "", 0.0,
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
    return claim(
        "energy-balance", "this package", True, bool(defect < 1e-2), "", 0.0,
        f"the ledger closes to {defect:.0e} of what is dissipated; of this, friction takes "
        f"{coulomb / (coulomb + viscous):.1%}; work of loads {work:.3g} J, created by tangential springs {curl:.1e} J",
    )  # fmt: skip
