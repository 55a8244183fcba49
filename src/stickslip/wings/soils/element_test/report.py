"""Output of element tests: series, gradings, figures, archive and terminal summary."""

from functools import partial
from pathlib import Path

import numpy as np

from ....data.run_files import ENVELOPES, PROBES, SERIES
from ....figures import response_envelopes
from ....kit import archive_fields, console, heading, new_table, pluralize, show_table, unit_name, write_table
from . import figures as figures_of
from .measures import (
    MEANING,
    STRESS,
    UNITS,
    estimates,
    face_stress,
    friction_angle,
    invariants,
    pore_pressure,
    sentences,
    volumetric_strain,
    work,
)
from .probes import SIGNS, ProbedState, directions_seen, first_seen, plane_of
from .scenario import ElementTestScenario
from .simulate import ElementRun, ElementTestResult

DRAWN = 4  # largest number of envelopes in one figure
COLUMNS = {
    "axial_strain": "1", "volumetric_strain": "1", "gamma": "1", "p": STRESS, "q": STRESS, "pore_pressure": STRESS,
    "sigma_xx": STRESS, "sigma_yy": STRESS, "sigma_zz": STRESS, "sigma_xy": STRESS, "void_ratio": "1",
    "coordination": "1", "fabric_anisotropy": "1", "sliding_fraction": "1", "phi": "degrees",
    "work": "energy/length^dim", "unbalanced": "1",
}  # fmt: skip


def columns(run: ElementRun, scenario: ElementTestScenario) -> dict[str, np.ndarray]:
    """Columns of the series of a sample, with the signs of the scenario."""
    series, dim, stress = run.series, scenario.sample.dim, face_stress(run.series, scenario.path.kind)
    p, q = invariants(stress, dim)
    signed = {
        "axial_strain": series.strain[:, dim - 1], "volumetric_strain": volumetric_strain(series),
        "p": p, "q": q,
        **{f"sigma_{a}{b}": series.stress[:, "xyz".index(a), "xyz".index(b)] for a, b in ("xx", "yy", "zz", "xy")},
    }  # fmt: skip
    plain = {
        "gamma": series.strain[:, 3], "void_ratio": series.void_ratio, "coordination": series.coordination,
        "fabric_anisotropy": series.fabric_anisotropy, "sliding_fraction": series.sliding_fraction,
        "phi": friction_angle(stress, dim), "work": work(series), "unbalanced": series.unbalanced,
    }  # fmt: skip
    if scenario.path.kind == "undrained":
        plain["pore_pressure"] = pore_pressure(series, dim)
    table = {name: scenario.sign * values + 0.0 for name, values in signed.items()} | plain  # no zero is negative
    return {name: table[name] for name in COLUMNS if name in table}


def _tables(result: ElementTestResult) -> list[dict[str, np.ndarray]]:
    return [columns(run, result.scenario) for run in result.runs]


def for_engineers(values, unit: str):
    """Values and their unit for people: stresses in kPa instead of Pa."""
    return (1e-3 * values, "kPa") if unit == "Pa" else (values, unit)


def _drawn(table: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Table of a series with stresses in the unit of figures."""
    return {
        name: for_engineers(values, unit_name(COLUMNS[name]))[0] if COLUMNS[name] == STRESS else values
        for name, values in table.items()
    }


def figures(result: ElementTestResult):
    """Yield (file name, Figure) of a run."""
    scenario, tables, unit = (
        result.scenario,
        [_drawn(t) for t in _tables(result)],
        for_engineers(0, unit_name(STRESS))[1],
    )
    halved = result.checked and _drawn(columns(result.checked, scenario))
    strain = {"simple-shear": "gamma", "isotropic": "volumetric_strain"}.get(scenario.path.kind, "axial_strain")
    yield "fig1_stress_strain.png", figures_of.stress_strain(tables, strain, unit, halved)
    if scenario.path.kind != "isotropic":
        yield "fig2_stress_path.png", figures_of.stress_path(tables, unit)
    yield "fig3_void_ratio.png", figures_of.void_ratio(tables, unit)
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
    """Yield (file name, function that writes it) for the series of all samples."""
    yield SERIES, partial(_write_series, result)
    if result.runs[0].probes:
        yield PROBES, partial(_write_probes, result)
        yield ENVELOPES, partial(_write_envelopes, result)


def _write_series(result: ElementTestResult, path: Path) -> None:
    tables = _tables(result)
    names = ["sample", *(heading(name, COLUMNS[name]) for name in tables[0])]
    rows = (
        (run.seed, *map(float, row))
        for run, table in zip(result.runs, tables, strict=True)
        for row in zip(*table.values(), strict=True)
    )
    write_table(path, names, rows)


def _write_probes(result: ElementTestResult, path: Path) -> None:
    """One row for each probed state."""
    units = {
        "strain": "1", "phi": "degrees", "least_work": "1", "direction": "degrees", "determinant": "1",
        **{f"{kind}_fixed_{what}": "1/time" for kind in ("pair", "divergence") for what in ("strain", "stress")},
        "uniqueness": "1",
    }  # fmt: skip
    names = [*(heading(name, unit) for name, unit in units.items()), *SIGNS]
    write_table(path, names, (_probe_row(each, result.scenario) for each in result.runs[0].probes))


def _probe_row(each: ProbedState, scenario: ElementTestScenario) -> tuple:
    nan, envelope = float("nan"), each.envelope
    phi = float(
        friction_angle(face_stress(each._replace(stress=each.stress[None]), scenario.path.kind), scenario.sample.dim)[0]
    )
    least = float(np.nanmin(envelope.normalised_work)) if np.isfinite(each.weakest) else nan
    determinant = each.band.determinant if each.band else nan
    return (
        scenario.strain_sign * each.load, phi, least, float(np.degrees(each.weakest)), determinant,
        *map(float, (*each.pair, *each.real)), each.unique.lower(), *map(int, each.signs.values()),
    )  # fmt: skip


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
    table = new_table("", "mean", "95 % ±", "unit", "", title=title, left=("", "unit"))
    for name, number in estimates(result).items():
        (mean, half), unit = for_engineers(np.array(number[:2]), unit_name(UNITS[name]))
        width = f"{half:.2g}" if np.isfinite(half) else "–"
        table.add_row(name, f"{mean:.4g}", width, "" if unit == "1" else unit, MEANING[name])
    show_table(table)
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
