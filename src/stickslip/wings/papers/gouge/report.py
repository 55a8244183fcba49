"""Output of gouge experiments: files in the run folder, and terminal summary."""

from collections import Counter
from functools import partial
from pathlib import Path
from types import SimpleNamespace as Made

import numpy as np

from ....kit import (
    Measures,
    Quantities,
    Quantity,
    archive_fields,
    console,
    heading_of,
    pluralize,
    power_of_ten,
    units_of,
    write_table,
)
from ...faults.friction.laboratory import LabRecord, write_csv
from . import figures as figures_of
from . import measures as measured
from .claims import healing_peaks, holds_with_common_velocity, predict_hold, reslides_after_longest
from .protocol import Series, Slips, find_slips
from .sample import damping, inertial_numbers, normalised_hold, normalised_stiffness, stiffness
from .simulate import GougeResult, Sample
from .statistics import slope

STEPS = "steps_{:04d}_{}.csv"  # realisation, and number of its sequence of steps
COLLAPSE = 5.0  # C of Ferdowsi & Rubin 2021, Fig S2b
LONG = 0.1  # fraction of a realisation above which the cost of a single hold is announced


def announce(*scenarios) -> None:
    """Print the expected cost of runs before they start."""
    for scenario in scenarios:
        console.print(
            f"{scenario.realizations} realisations, each of about {scenario.steps:.2g} steps of {scenario.dt:g} s with "
            f"{scenario.grains.number} grains, {scenario.expected_cost}.", soft_wrap=True,
        )  # fmt: skip
        if scenario.longest_hold > LONG * scenario.duration:
            console.print(
                f"Each hold of {scenario.longest_hold:g} s takes {scenario.longest_hold / scenario.dt:.2g} of these "
                f"steps, {scenario.estimate_cost(scenario.longest_hold)}.", soft_wrap=True,
            )  # fmt: skip
    console.print(
        "To shorten runs, use higher velocities, shorter holds or slips, or softer grains (law.young) and a longer dt."
    )


def announce_samples(folder: Path, stored: dict[str, dict[int, Sample]], before: set[str]) -> None:
    """Print the samples that are evaluated, and their origin; `before` contains names of earlier files."""
    for name, samples in stored.items():
        versions = Counter(sample.version for sample in samples.values() if sample.path.name in before)
        parts = [f"{number} from {folder} (stickslip {version})" for version, number in versions.items()]
        new = len(samples) - versions.total()
        seeds = ", ".join(map(str, samples)) or "none"
        parts += [f"{new} computed now and added to {folder}"] if new else []
        console.print(
            f"{name}: {pluralize(len(samples), 'sample')} (seeds {seeds}), {'; '.join(parts) or 'not evaluated'}.",
            soft_wrap=True,
        )


def figures(result: GougeResult):
    """Yield (file name, Figure) for everything measured by the protocol."""
    yield "fig1_steady_sliding.png", figures_of.steady_sliding(result.realizations, result.scenario.grains.mean)
    yield from _step_figures(result)
    before = measured.holds(result)
    if before:
        curves = [measured.hold_curve(result, v) for v in before]
        shown = [([c], predict_hold(result, v, c.x)) for v, c in zip(before, curves, strict=True)]
        yield "fig3_holds.png", figures_of.holds(shown)
        yield "fig4_rest.png", _rest_figure({f"$V_i$ = {v:g} m/s": (result, v) for v in before})
        yield from _reslide_figures(result, result)
    yield "fig7_sample.png", figures_of.sample(result.realizations[0], result.scenario)
    slips = _slips(result)
    if len(slips.time):
        yield "fig8_slips.png", figures_of.stick_slip(result.realizations[0], slips, result.scenario.grains.mean)


def _slips(result: GougeResult) -> Slips:
    return find_slips(result.realizations, result.scenario.slip_threshold, result.scenario.grains.mean)


def files(result: GougeResult):
    """Yield (file name, function that writes it) for the series, slips, and laboratory records of velocity steps."""
    yield "series.csv", partial(_write_series, result)
    if len((slips := _slips(result)).time):
        names, rows = _labels(slips._fields, units_of(Slips)), list(zip(*slips, strict=True))
        yield "slips.csv", partial(write_table, headings=names, rows=rows, digits=7)
    yield from _step_files(result)


def paper_files(reproduction):
    """Yield (file name, function that writes it) for the paper's experiments."""
    yield "series.csv", partial(_write_series, reproduction.main)
    yield from _step_files(reproduction.more.get("steps", reproduction.main))
    yield "curves.csv", partial(_write_curves, reproduction)


def paper_failures(reproduction) -> tuple[str, ...]:
    """One sentence for each failed realisation of any run."""
    return tuple(f"{name}: {failure}" for name, result in reproduction.results.items() for failure in result.failures)


def paper_figures(reproduction):
    """Yield (file name, Figure) for the paper's experiments: holds with all damping values, and all other runs."""
    main, before = reproduction.main, measured.holds(reproduction.main)[-1]
    yield "fig1_steady_sliding.png", figures_of.steady_sliding(main.realizations, main.scenario.grains.mean)
    if "steps" in reproduction.more:
        yield from _step_figures(reproduction.more["steps"])
    gammas = {name: power_of_ten(damping(r.scenario)) for name, r in reproduction.holds.items()}
    labelled = [(f"{name}: $\\gamma_n$ = {gammas[name]}", r) for name, r in reproduction.holds.items()]
    curves = [measured.hold_curve(r, before)._replace(label=label) for label, r in labelled]
    yield "fig3_holds.png", figures_of.holds([(curves, predict_hold(main, before, curves[0].x))])
    yield "fig4_rest.png", _rest_figure({label: (r, before) for label, r in labelled})
    yield from _reslide_figures(reproduction.more.get("reslides", main), main)
    if main.realizations[0].states:  # stored samples have none
        yield "fig7_sample.png", figures_of.sample(main.realizations[0], main.scenario)


def _step_figures(result: GougeResult):
    steps = measured.steps(result)
    if steps:
        paired = [measured.step_curve(result, *pair, twin=True) for pair in steps]
        twins = all(curve is not None for curve in paired)
        curves = paired if twins else [measured.step_curve(result, *pair, twin=False) for pair in steps]
        yield "fig2_velocity_steps.png", figures_of.velocity_steps(curves, twins=twins)


def _rest_figure(runs: dict):
    ratios = [measured.energy_ratio(*run)._replace(label=label) for label, run in runs.items()]
    creep = [measured.creep_velocity(*run) for run in runs.values()]
    return figures_of.energies_in_holds(ratios, creep, measured.sliding_energy_ratio(*next(iter(runs.values()))).value)


def _reslide_figures(result: GougeResult, healing: GougeResult):
    """Yield figures of slides: several velocities after one hold, and one velocity after several holds."""
    slides = {v: reslides_after_longest(result, v) for v in {v for v, _, _ in measured.reslides(result)}}
    if slides:
        before = max(slides, key=lambda v: len(slides[v][0]))
        curves, after, peaks, _ = slides[before]
        fitted = slope(np.log(after / before), peaks) if len(after) > 1 else None
        yield "fig5_reslides.png", figures_of.reslides(curves, after / before, peaks, fitted, COLLAPSE)
    times = {v: holds_with_common_velocity(healing, v)[0] for v in {v for v, _, _ in measured.reslides(healing)}}
    most = max(times, key=lambda v: len(times[v]), default=None)
    if most and len(times[most]) > 1:
        curve = measured.hold_curve(healing, most, "thickness")
        thinner = curve._replace(rows=curve.rows / healing.scenario.grains.mean)
        shown = figures_of.healing(*healing_peaks(healing, most), healing.scenario.scales.b, thinner)
        yield "fig6_healing.png", shown


def numbers(result: GougeResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    scenario, first = result.scenario, result.realizations[0]
    thickness = first.range.thickness * scenario.grains.mean
    return {
        "scenario": scenario.text,
        "units": "SI units; groups are named after the velocity before the hold and the hold time",
        "stiffness": normalised_stiffness(scenario),
        "hold": {
            f"{hold:g} after {before:g}": normalised_hold(scenario, hold, before)
            for before, hold, _ in measured.reslides(result)
        },
        "inertial_number": {
            f"{velocity:g}": inertial_numbers(scenario, velocity, thickness) for velocity in measured.velocities(result)
        },
        "realizations": {f"{sample.seed:04d}": sample for sample in result.realizations},
        "failures": "\n".join(result.failures),
        "slips": archive_fields(_slips(result)),
        "steady_friction": {f"{v:g}": measured.mean_friction(result, v)._asdict() for v in measured.velocities(result)},
    }


def _write_series(result: GougeResult, path: Path) -> None:
    """Write one row per sample: realisation, test, its kind and velocities, and all `Series` columns except fabric."""
    names = [name for name in result.realizations[0].tests[0].series._fields if name != "fabric"]
    labels = ["realization [-]", "test [-]", "part [-]", "branch [-]", "kind", "before [m/s]", "load_velocity [m/s]"]
    rows = (
        (sample.seed, k, test.part, test.branch, test.kind, test.before, test.velocity, test.hold, *row)
        for sample in result.realizations
        for k, test in enumerate(sample.tests)
        for row in zip(*(getattr(test.series, name) for name in names), strict=True)
    )
    write_table(path, [*labels, "hold [s]", *_labels(names, units_of(Series))], rows, digits=7)


def _labels(names, units: dict[str, str]) -> list[str]:
    return [heading_of(name, units.get(name, "1").replace("^", "")) for name in names]


def _write_curves(reproduction, path: Path) -> None:
    """Write mean curves of a reproduction, one row per point, with standard error and deviation over branches."""
    names = "run", "kind", "before [m/s]", "hold [s]", "after [m/s]", "x", "unit of x", "mean", "error", "deviation"
    rows = (
        (run.replace(",", ";"), kind, *where, x, unit, *numbers)
        for run, result in reproduction.results.items()
        for kind, where, unit, curve in _mean_curves(result)
        for x, *numbers in zip(curve.x, curve.mean, curve.error, curve.band / 2, strict=True)
    )
    write_table(path, names, rows, digits=5)


def _mean_curves(result: GougeResult):
    """Yield (kind, (before, hold, after), unit of x, curve) for every mean curve of a result."""
    for v in measured.holds(result):
        for column in ("friction", "thickness"):
            yield f"{column} in a hold", (v, None, None), "s", measured.hold_curve(result, v, column)
        yield "kinetic over elastic energy in a hold", (v, None, None), "s", measured.energy_ratio(result, v)
        yield "velocity of the plate in a hold", (v, None, None), "s", measured.creep_velocity(result, v)
    for v, hold, w in measured.reslides(result):
        yield "friction after a hold", (v, hold, w), "D", _thin_out(measured.reslide_curve(result, v, hold, w))
    for v, w in measured.steps(result):
        yield "friction after a step", (v, None, w), "D", _thin_out(measured.step_curve(result, v, w, twin=False))


def _thin_out(curve: measured.Curve) -> measured.Curve:
    """Smooth a curve and keep about two hundred points."""
    soft, every = measured.smoothed(curve), max(1, len(curve.x) // measured.POINTS)
    return soft._replace(x=soft.x[::every], rows=soft.rows[:, ::every])


def _step_files(result: GougeResult):
    """Yield the velocity steps of every realisation as laboratory records, which `stickslip fit` reads."""
    k = stiffness(result.scenario) / result.scenario.load.normal_stress
    count = Counter()
    for seed, _, _, data in measured.step_records(result):
        file, count[seed] = STEPS.format(seed, count[seed]), count[seed] + 1
        ends = np.cumsum([0.0, *(leg.duration for leg in data.legs)])
        displacement = np.interp(data.time, ends, np.cumsum([0.0, *(leg.duration * leg.velocity for leg in data.legs)]))
        before = data.before or data.legs[0].velocity
        comment = (
            f"velocity steps of fault gouge, realisation {seed}; the spring's stiffness over the normal stress is "
            f"{k:.6g} 1/m, the velocity before {before:g} m/s",
            f"stickslip fit {file} --stiffness {k:.6g} --before {before:g}",
        )
        yield file, partial(write_csv, record=LabRecord(data.time, data.friction, displacement), comments=comment)


def show(result: GougeResult) -> None:
    """Print steady friction, holds and warnings on the terminal."""
    scenario, first = result.scenario, result.realizations[0]
    console.print(f"{len(result.realizations)} realisations; ± is the half-width of a 95 % interval.")
    STEADY.show_rows(_friction(result))
    if slides := _reslides(result):
        RESLIDE.show_rows(slides, title="Slides after holds")
    slips = _slips(result)
    if len(slips.time):
        console.print(
            f"Stick–slip: {pluralize(len(slips.time), 'slip')} faster than {result.scenario.slip_threshold:g} times "
            f"the load point. Friction drops by {np.median(slips.drop):.3g} (median), at most {slips.drop.max():.3g}; "
            f"the plate reaches {(slips.velocity / slips.load_velocity).max():.3g} times the load point's velocity."
        )
    k = normalised_stiffness(scenario)
    console.print(
        f"Stiffness: k = {k['per_area']:.3g} Pa/m, k/σ = {k['per_stress']:.4g} 1/m, k D/σ = {k['grain']:.3g}, "
        f"k dc/(b σ) = {k['rate_state']:.4g}. Inertial number at the largest velocity: "
        f"{first.range.inertial_number:.1e}. Layer: {first.range.thickness:.1f} D. dt: {first.range.time_step:.2f} of "
        f"the largest stable time step."
    )
    for warning in dict.fromkeys(warning for sample in result.realizations for warning in sample.range.warnings):
        console.print(f"warning: {warning}", style="yellow")
    for failure in result.failures:
        console.print(failure, style="yellow")
    if result.reused:
        console.print(f"{result.reused} realisations had finished earlier and were not run again.")


def _friction(result: GougeResult) -> list[Made]:
    return [Made(velocity=v, friction=measured.mean_friction(result, v)) for v in measured.velocities(result)]


def _reslides(result: GougeResult) -> list[Made]:
    return [
        Made(before=v, hold=t, after=w, peak=measured.peak(measured.reslide_curve(result, v, t, w)),
             scaled=Made(**normalised_hold(result.scenario, t, v)))
        for v, t, w in measured.reslides(result)
    ]  # fmt: skip


STEADY = Quantities([
    Quantity("velocity", "m/s", "velocity of the load point"),
    Quantity("steady friction", "1", "mean over samples, ± half of its 95 % interval", "friction.estimate"),
])  # fmt: skip
RESLIDE = Quantities([
    Quantity("V before", "m/s", "velocity before the hold", "before"), Quantity("hold", "s", "hold time"),
    Quantity("V t/dc", "1", "slip of the load point at this velocity during the hold", "scaled.load_point"),
    Quantity("k V t/(a σ)", "1", "stress of this slip", "scaled.frozen"),
    Quantity("V after", "m/s", "velocity after the hold", "after"),
    Quantity("peak − steady", "1", "peak of friction above steady friction", "peak.estimate"),
])  # fmt: skip
MEASURES = Measures([
    Quantity("thickness", "m", "thickness of the layer of the first sample",
             lambda result: result.realizations[0].range.thickness * result.scenario.grains.mean),
    Quantity("inertial_number", "1", "inertial number of the first sample at the largest velocity",
             lambda result: result.realizations[0].range.inertial_number),
    Quantity("stiffness_over_b", "1", "k dc/(b σ)", lambda result: normalised_stiffness(result.scenario)["rate_state"]),
    Quantity("steady_friction", "1", "steady friction at a velocity [m/s]",
             lambda result: {one.velocity: one.friction.value for one in _friction(result)}),
    Quantity("steady_friction_half", "1", "half of its 95 % interval",
             lambda result: {one.velocity: one.friction.half for one in _friction(result)}),
    Quantity("peak", "1", "peak of friction above steady friction: velocity [m/s], hold, velocity after the hold [m/s]",
             lambda result: {f"{s.before:g},{s.hold:g}s,{s.after:g}": s.peak.value for s in _reslides(result)}),
    Quantity("slips", "1", "slips faster than the load point", lambda result: len(_slips(result).time)),
    Quantity("largest_friction_drop", "1", "largest decrease of friction in a slip",
             lambda result: _slips(result).drop.max(initial=0.0)),
])  # fmt: skip
