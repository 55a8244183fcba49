"""What a gouge experiment leaves in its folder and on the terminal."""

from pathlib import Path

import numpy as np
from rich.table import Table

from ..ensemble import Workers
from ..figures import gouge as figures
from ..figures.style import save as save_figure
from ..friction.laboratory import Record, write_csv
from ..loading import gouge_measures as measures
from ..loading.gouge_ensemble import GougeResult, simulate_gouge
from ..loading.gouge_numbers import inertial_numbers, normalised_hold, normalised_stiffness, stiffness
from .claims_report import write_claims
from .gouge_claims import SHOWS
from .gouge_curves import after_longest, healed, predicted, same_velocity
from .report import SERIES, STYLE, complete, console, files_of, save

STEPS = "steps_{:04d}_{}.csv"  # realization, part of the protocol
COLLAPSE = 5.0  # C of paper 003, Fig S2b


def simulate(scenario, *, folder: Path, workers: Workers, report) -> GougeResult:
    """Run a scenario; realizations that the folder holds are not run again."""
    return simulate_gouge(scenario, folder=folder, workers=workers, report=report)


def foretell(scenario) -> None:
    """Say how long it will take, before it starts."""
    console.print(
        f"{scenario.realizations} realizations, each of about {scenario.steps:.2g} steps of {scenario.dt:g} s with "
        f"{scenario.grains.number} grains, {scenario.words}. Higher velocities, shorter holds and slips, or softer "
        f"grains (law.young) with a longer dt make it shorter."
    )


def write_result(folder: Path, result: GougeResult) -> list[Path]:
    """Figures, series as CSV, scenario and raw numbers; returns their paths."""
    return _write(folder, result, None)


def write_reproduction(folder: Path, found) -> list[Path]:
    """The same and the claims, of the paper's experiment."""
    failures = [*found.main.failures, *(f"restitution 0.3: {words}" for words in found.damped.failures)]
    return _write(folder, found.main, found.claims, failures)


def _write(folder: Path, result: GougeResult, claims, failures=()) -> list[Path]:
    with complete(folder, failures=result.failures) as room:
        save(room, result.scenario, numbers(result))
        _write_series(room / SERIES, result)
        _write_steps(room, result)
        for name, figure in _figures(result):
            save_figure(figure, room / name)
        if claims is not None:
            write_claims(room, claims, SHOWS, "Paper 003: fault gouge at a reduced scale", failures)
    return files_of(folder)


def _figures(result: GougeResult):
    """(file, figure) of everything that the protocol has measured."""
    size = result.scenario.grains.mean
    yield "fig1_steady_sliding.png", figures.steady_sliding(result.realizations, size)
    steps = measures.steps(result)
    if steps:
        paired = [measures.step_curve(result, *pair, twin=True) for pair in steps]
        plain_ones = [measures.step_curve(result, *pair, twin=False) for pair in steps]
        twins = all(curve is not None for curve in paired)
        yield "fig2_velocity_steps.png", figures.velocity_steps(paired if twins else plain_ones, twins=twins)
    before = measures.holds(result)
    if before:
        curves = [measures.hold_curve(result, v) for v in before]
        laws = [predicted(result, v, c.x) for v, c in zip(before, curves, strict=True)]
        yield "fig3_holds.png", figures.holds(curves, laws)
        yield "fig4_reslides.png", _reslides(result, max(before, key=lambda v: len(after_longest(result, v)[0])))
        most = max(before, key=lambda v: len(same_velocity(result, v)[0]))
        if len(same_velocity(result, most)[0]) > 1:
            yield "fig5_healing.png", _healing(result, most)
    yield "fig6_sample.png", figures.sample(result.realizations[0], result.scenario)


def _reslides(result: GougeResult, before: float):
    curves, after, peaks, _ = after_longest(result, before)
    ratios = after / before
    fitted = measures.slope(np.log(ratios), peaks) if len(ratios) > 1 else None
    return figures.reslides(curves, ratios, peaks, fitted, COLLAPSE)


def _healing(result: GougeResult, before: float):
    curve = measures.hold_curve(result, before, "thickness")
    thinner = curve._replace(rows=curve.rows / result.scenario.grains.mean)
    return figures.healing(*healed(result, before), result.scenario.scales.b, thinner)


def numbers(result: GougeResult) -> dict:
    """What the archive holds besides scenario and version."""
    scenario, first = result.scenario, result.realizations[0]
    thickness = first.range.thickness * scenario.grains.mean
    return {
        "scenario": scenario.text,
        "units": "SI; names of groups are velocities before, and hold times",
        "stiffness": normalised_stiffness(scenario),
        "hold": {
            f"{hold:g} after {before:g}": normalised_hold(scenario, hold, before)
            for before, hold, _ in measures.reslides(result)
        },
        "inertial_number": {
            f"{velocity:g}": inertial_numbers(scenario, velocity, thickness) for velocity in measures.velocities(result)
        },
        "realizations": {f"{one.seed:04d}": one for one in result.realizations},
        "failures": "\n".join(result.failures),
        "steady_friction": {f"{v:g}": measures.mean_friction(result, v)._asdict() for v in measures.velocities(result)},
    }


def _write_series(path: Path, result: GougeResult) -> None:
    """One row a sample: realization, test, its kind and velocities, and the columns of `Series` without the fabric."""
    names = [name for name in result.realizations[0].tests[0].series._fields if name != "fabric"]
    units = {
        "time": "s", "load_point": "m", "slip": "m", "velocity": "m/s", "thickness": "m", "kinetic_energy": "J",
        "temperature": "m2/s2",
    }  # fmt: skip
    header = ["realization [-]", "test [-]", "kind", "before [m/s]", "load_velocity [m/s]", "hold [s]"]
    lines = [",".join(header + [f"{name} [{units.get(name, '-')}]" for name in names])]
    for one in result.realizations:
        for k, test in enumerate(one.tests):
            head = f"{one.seed},{k},{test.kind},{test.before:g},{test.velocity:g},{test.hold:g},"
            table = np.stack([getattr(test.series, name) for name in names], axis=1)
            lines += [head + ",".join(f"{x:.7g}" for x in row) for row in table]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_steps(room: Path, result: GougeResult) -> None:
    """The velocity steps of every realization as a laboratory's record, which `stickslip fit` reads."""
    k = stiffness(result.scenario) / result.scenario.load.normal_stress
    for seed, part, data in measures.step_records(result):
        ends = np.cumsum([0.0, *(leg.duration for leg in data.legs)])
        place = np.interp(data.time, ends, np.cumsum([0.0, *(leg.duration * leg.velocity for leg in data.legs)]))
        words = (
            f"velocity steps of fault gouge, realization {seed}; the spring's stiffness over the normal stress is "
            f"{k:.6g} 1/m, the velocity before {data.before or data.legs[0].velocity:g} m/s",
            f"stickslip fit {STEPS.format(seed, part)} --stiffness {k:.6g} "
            f"--before {data.before or data.legs[0].velocity:g}",
        )
        write_csv(room / STEPS.format(seed, part), Record(data.time, data.friction, place), words)


def show_result(result: GougeResult) -> None:
    """Steady friction, holds and warnings on the terminal."""
    scenario, first = result.scenario, result.realizations[0]
    console.print(f"{len(result.realizations)} realizations; ± is half a 95 % interval.")
    table = Table(**STYLE)
    for name in ("velocity [m/s]", "steady friction", "±"):
        table.add_column(name, justify="right", no_wrap=True)
    for velocity in measures.velocities(result):
        found = measures.mean_friction(result, velocity)
        table.add_row(f"{velocity:g}", f"{found.value:.4f}", f"{found.half:.4f}")
    console.print(table)
    if measures.reslides(result):
        _show_holds(result)
    k = normalised_stiffness(scenario)
    console.print(
        f"Stiffness: k = {k['per_area']:.3g} Pa/m, k/σ = {k['per_stress']:.4g} 1/m, k D/σ = {k['grain']:.3g}, "
        f"k dc/(b σ) = {k['rate_state']:.4g}. Inertial number at the largest velocity: "
        f"{first.range.inertial_number:.1e}. Layer: {first.range.thickness:.1f} D. dt: {first.range.time_step:.2f} of "
        f"the largest stable one."
    )
    for words in dict.fromkeys(words for one in result.realizations for words in one.range.warnings):
        console.print(f"warning: {words}", style="yellow")
    for words in result.failures:
        console.print(words, style="yellow")
    if result.reused:
        console.print(f"{result.reused} realizations were finished before and not run again.")


def _show_holds(result: GougeResult) -> None:
    table = Table(title="Slides after holds", **STYLE)
    for name in ("V_i [m/s]", "hold [s]", "V_i t/dc", "k V_i t/(a σ)", "V_r [m/s]", "peak − steady", "±"):
        table.add_column(name, justify="right", no_wrap=True)
    for before, hold, after in measures.reslides(result):
        found = measures.peak(measures.reslide_curve(result, before, hold, after))
        scaled = normalised_hold(result.scenario, hold, before)
        table.add_row(
            f"{before:g}", f"{hold:g}", f"{scaled['load_point']:.3g}", f"{scaled['frozen']:.3g}", f"{after:g}",
            f"{found.value:+.4f}", f"{found.half:.4f}",
        )  # fmt: skip
    console.print(table)


def scalars(result: GougeResult) -> dict[str, tuple[float, str]]:
    """{name: (value, unit)} of a run, for sweeps; velocities [m/s] and holds [s] are in the names."""
    k = normalised_stiffness(result.scenario)
    out = {
        "thickness": (result.realizations[0].range.thickness, "mean diameters"),
        "inertial_number": (result.realizations[0].range.inertial_number, "1"),
        "stiffness_over_b": (k["rate_state"], "1"),
    }
    for velocity in measures.velocities(result):
        found = measures.mean_friction(result, velocity)
        out |= {
            f"steady_friction@{velocity:g}": (found.value, "1"),
            f"steady_friction_half@{velocity:g}": (found.half, "1"),
        }
    for before, hold, after in measures.reslides(result):
        found = measures.peak(measures.reslide_curve(result, before, hold, after))
        out[f"peak@{before:g},{hold:g}s,{after:g}"] = found.value, "1"
    return out
