"""Output of element tests: series, gradings, figures, archive and terminal summary."""

from functools import partial
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from ....figures import response_envelopes
from ....kit import archive_fields, console, heading, new_table, pluralize, show_table, unit_name, write_table
from . import figures as figures_of
from .measures import MEASURES, PROBE, SAMPLE, SERIES, STEADY, STRESS, LoadedSample, Probed
from .probes import SIGNS, ProbedState, describe_direction, directions_seen, first_seen, plane_of
from .scenario import ElementTestScenario
from .simulate import MODULI_UP_TO, ElementRun, ElementTestResult

DRAWN = 4  # largest number of envelopes in one figure
COMPARED = {  # measures that half the step may change, of which the first that a path gives counts: words, digits, unit
    "phi_peak": ("peak angle", 2, " degrees"), "compression_index": ("compression index", 4, ""),
    "swelling_index": ("swelling index", 4, ""),
}  # fmt: skip


def columns(run: ElementRun, scenario: ElementTestScenario) -> dict[str, np.ndarray]:
    """Columns of the series of a sample, with the signs of the scenario."""
    return SERIES.of(LoadedSample(run, scenario))


def for_engineers(values, unit: str):
    """Values and their unit for people: stresses in kPa instead of Pa."""
    return (1e-3 * values, "kPa") if unit == "Pa" else (values, unit)


def drawn(run: ElementRun, scenario: ElementTestScenario) -> dict[str, np.ndarray]:
    """Series of a sample with stresses in the unit of figures."""
    return {
        name: for_engineers(values, unit_name(SERIES[name].unit))[0] for name, values in columns(run, scenario).items()
    }


def figures(result: ElementTestResult):
    """Yield (file name, Figure) of a run."""
    scenario, unit = result.scenario, for_engineers(0, unit_name(STRESS))[1]
    tables = [drawn(run, scenario) for run in result.runs]
    halved = result.checked and drawn(result.checked, scenario)
    strain = {"simple-shear": "gamma", "isotropic": "volumetric_strain"}.get(scenario.path.kind, "axial_strain")
    axial = f"sigma_{'xyz'[scenario.sample.dim - 1] * 2}" if scenario.path.kind == "oedometric" else ""
    yield "fig1_stress_strain.png", figures_of.stress_strain(tables, strain, unit, halved, axial)
    if scenario.path.kind != "isotropic":
        yield "fig2_stress_path.png", figures_of.stress_path(tables, unit)
    yield "fig3_void_ratio.png", figures_of.void_ratio(tables, unit, axial or "p")
    yield "fig4_contacts.png", figures_of.contacts(tables, strain)
    curve, diameters = scenario.sample.grading.curve(), scenario.sample.diameters
    yield "fig5_grading.png", figures_of.grading(curve, diameters, scenario.sample.dim)
    if probed := [each for each in result.runs[0].probes if each.envelope is not None]:
        first = {name: scenario.strain_sign * each.load for name, each in first_seen(tuple(probed)).items() if each}
        yield (
            "fig6_directions.png",
            figures_of.failure_directions(
                probed,
                tables[0],
                (strain, scenario.strain_sign),
                first,
                plane_of(scenario.path, scenario.sample.dim)[1],
            ),
        )
        yield "fig7_envelopes.png", _envelopes(probed, scenario)


def _envelopes(probed: list[ProbedState], scenario: ElementTestScenario):
    """Envelopes of a few states, up to the first in which a direction fails."""
    seen = directions_seen(tuple(probed))
    until = probed[: probed.index(seen) + 1] if seen else probed
    some = [until[k] for k in np.unique(np.linspace(0, len(until) - 1, DRAWN).round().astype(int))]
    labels = [f"ε = {scenario.strain_sign * each.load:.3g}" for each in some]
    return response_envelopes([each.envelope for each in some], labels, plane_of(scenario.path, scenario.sample.dim)[1])


def files(result: ElementTestResult):
    """Yield (file name, function that writes it) for the series of all samples and the probes of the first."""
    scenario, probes = result.scenario, result.runs[0].probes
    yield "series.csv", lambda path: SERIES.write(path, (LoadedSample(run, scenario) for run in result.runs))
    if probes:
        yield "probes.csv", lambda path: PROBE.write(path, (Probed(each, scenario) for each in probes))
        yield "envelopes.csv", partial(_write_envelopes, result)


def _write_envelopes(result: ElementTestResult, path: Path) -> None:
    """One row for each direction of each probed state."""
    scenario = result.scenario
    kinds = {"strain": "1", "stress": STRESS, "elastic": STRESS}
    parts = plane_of(scenario.path, scenario.sample.dim)[1]
    names = ["strain", heading("angle", "degrees")]
    names += [heading(f"{kind}_{part}", unit) for kind, unit in kinds.items() for part in parts]
    rows = (
        (scenario.strain_sign * each.load, float(np.degrees(each.envelope.angle[k])), *map(float, row), int(slides))
        for each in result.runs[0].probes if each.envelope is not None
        for k, (row, slides) in enumerate(zip(
            scenario.sign * np.hstack([each.envelope.components(kind) for kind in kinds]), each.envelope.slides,
            strict=True,
        ))
    )  # fmt: skip
    write_table(path, [*names, "slides"], rows)


def sentences(result: ElementTestResult) -> list[str]:
    """Remarks for readers of the numbers: scatter, what the path did not reach, rate, and halved steps."""
    return [*_first_failure(result), *_scatter(result), *_missing(result), *_quasi_static(result), *_finer(result)]


def _first_failure(result: ElementTestResult) -> list[str]:
    """Direction in which the first sample could fail first, and its peak."""
    run, scenario = result.runs[0], result.scenario
    if not run.probes:
        return []
    here, sign = directions_seen(run.probes), scenario.strain_sign
    unanswered = [
        f"No equilibrium could be probed at a strain of {sign * each.load:.3g}: {each.reason}."
        for each in run.probes if each.envelope is None
    ]  # fmt: skip
    if here is None:
        last = sign * run.probes[-1].load
        return [
            f"No direction was seen in which sample {run.seed} could fail, up to a strain of {last:.3g}.",
            *unanswered,
        ]
    numbers = SAMPLE.of(LoadedSample(run, scenario))
    why = "second-order work is negative" if here.signs["negative work"] else "no equilibrium is nearby"
    where = describe_direction(here.failing, scenario.path, scenario.sample.dim, scenario.sign)
    peak = f"; the peak angle is at {top:.3g}" if np.isfinite(top := numbers["strain_at_peak"]) else ""
    return [
        f"Sample {run.seed} wanted to fail in the direction {where} first at a strain of {sign * here.load:.3g}, where "
        f"{why}{peak}.",
        *unanswered,
    ]


def _scatter(result: ElementTestResult) -> list[str]:
    n, peak = result.scenario.sample.grains, MEASURES.known(result).get("phi_peak")
    if len(result.runs) < 2:
        return ["One sample gives no interval: use more realizations."]
    if peak is None or not peak.scatter > 0:
        return []
    share = peak.scatter / peak.mean
    size = f"{n * (share / 0.01) ** 2:.2g} grains" if share > 0.01 else f"{n} grains suffice"
    return [
        f"The peak angle of samples of {n} grains scatters by {share:.1%}. If the scatter falls as 1/√N, a scatter of "
        f"1 % needs {size.replace(' suffice', ', which is what the samples have')}."
    ]


def _missing(result: ElementTestResult) -> list[str]:
    out = [f"Sample {run.seed} ended early: {run.ended}." for run in result.runs if run.ended]
    rigid = sum(bool(np.isfinite(run.elastic.shear)) for run in result.runs)
    if rigid < len(result.runs):
        out.append(
            f"{rigid} of {len(result.runs)} samples have elastic moduli; in others a strain drives motions that "
            f"nothing resists, or they have more than {MODULI_UP_TO} grains."
        )
    samples = [LoadedSample(run, result.scenario) for run in result.runs]
    last = sum(sample.sheared and sample.top == len(sample.first.load) - 1 for sample in samples)
    if last:
        out.append(
            f"The angle is largest where the path ends, or first turns, in {last} of {len(samples)} samples, and may "
            f"have no peak before; use a larger strain."
        )
    number = sum(sample.steady is not None for sample in samples)
    if samples[0].sheared and number < len(samples):
        volume, ratio, p = np.max([sample.drifts for sample in samples], axis=0)
        out.append(
            f"{number} of {len(samples)} samples reached a critical state, so that the residual angle is undecided: "
            f"over the last third of the path the volumetric strain changes by up to {volume:.2g} of the imposed one, "
            f"q/p by {ratio:.1%} and p by {p:.1%}, and each must be below {STEADY:.0%}; use a larger strain or more "
            f"grains."
        )
    return out


def _quasi_static(result: ElementTestResult) -> list[str]:
    scenario, numbers = result.scenario, MEASURES.known(result)
    if scenario.path.integrator == "dynamic":
        return [
            f"The strain rate of {scenario.rate:.3g} is an inertial number of {scenario.rate * scenario.time:.2g}; the "
            f"mean unbalanced force was at most {numbers['largest_unbalanced'].mean:.2g} of the mean contact force."
        ]
    share = numbers["rearranged_share"].mean if "rearranged_share" in numbers else 0.0
    return [f"Grains rearranged in {share:.0%} of the steps, whose equilibria were found by damped dynamics."]


def _finer(result: ElementTestResult) -> list[str]:
    what = "step" if result.scenario.path.integrator == "quasi-static" else "rate"
    if result.checked is None:
        return [f"It was not checked whether half the {what} gives the same: use check = true."]
    pair = (LoadedSample(run, result.scenario) for run in (result.runs[0], result.checked))
    both = SAMPLE.columns(pair)
    name = next((name for name in COMPARED if np.isfinite(both[name]).all()), None)
    if name is None:
        return [f"The path gives no number in which half the {what} could be compared."]
    (before, after), (words, digits, unit) = both[name], COMPARED[name]
    scatter = MEASURES.of(result)[name].scatter
    change = (
        f"With half the {what}, the {words} of the first sample is {after:.{digits}f} instead of "
        f"{before:.{digits}f}{unit}"
    )
    if not np.isfinite(scatter):
        return [f"{change}."]
    reach = float(stdtrit(len(result.runs) - 1, 0.975)) * scatter
    verdict = "less" if abs(after - before) <= reach else "more"
    return [f"{change}, a change of {verdict} than the scatter of samples (95 %: {reach:.{digits}f}{unit})."]


def numbers(result: ElementTestResult) -> dict:
    """Return the contents of the archive, besides scenario and version."""
    runs = result.runs + ((result.checked,) if result.checked else ())
    names = [f"{run.seed:04d}" for run in result.runs] + (["halved"] if result.checked else [])
    return {
        "law": result.law,
        "samples": {
            name: {
                "series": archive_fields(run.series), "packed": archive_fields(run.packed),
                "elastic": archive_fields(run.elastic), "end": run.end, "ended": run.ended,
                "probes": run.probes,
            }
            for name, run in zip(names, runs, strict=True)
        },
        "failures": "\n".join(result.failures), "remarks": "\n".join(sentences(result)),
    }  # fmt: skip


def show(result: ElementTestResult) -> None:
    """Print the numbers of a test with their intervals, and what limits them."""
    scenario = result.scenario
    title = f"{scenario.path.kind} test of {pluralize(len(result.runs), 'sample')} of {scenario.sample.grains} grains"
    MEASURES.show(result, title=title, readable=for_engineers)
    if result.runs[0].probes:
        _show_signs(result)
    for sentence in (*sentences(result), *result.failures):
        console.print(f"  {sentence}", soft_wrap=True)


def _show_signs(result: ElementTestResult) -> None:
    """Print the strain at which each sign of failure is first seen."""
    run, sign = result.runs[0], result.scenario.strain_sign
    table = new_table("", "first at", "", title=f"Signs of failure of sample {run.seed}", left=("",))
    for name, each in first_seen(run.probes).items():
        table.add_row(name, f"{sign * each.load:.3g}" if each else "–", SIGNS[name])
    show_table(table)
