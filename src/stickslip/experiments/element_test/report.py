"""Output of element tests: series, gradings, figures, archive and terminal summary."""

from functools import partial
from pathlib import Path

import numpy as np

from ...core.readable import pluralize
from ...core.tables import write_table
from ...core.units import heading, unit_name
from ...data.nodes import archive_fields
from ...data.run_files import SERIES
from ...figures import element_test as figures_of
from ...reports.terminal import console, new_table, show_table
from .measures import MEANING, STRESS, UNITS, estimates, face_stress, friction_angle, invariants, sentences, work
from .scenario import ElementTestScenario
from .simulate import ElementRun, ElementTestResult

COLUMNS = {
    "axial_strain": "1", "volumetric_strain": "1", "gamma": "1", "p": STRESS, "q": STRESS, "sigma_xx": STRESS,
    "sigma_yy": STRESS, "sigma_zz": STRESS, "sigma_xy": STRESS, "void_ratio": "1", "coordination": "1",
    "fabric_anisotropy": "1", "sliding_fraction": "1", "phi": "degrees", "work": "energy/length^dim", "unbalanced": "1",
}  # fmt: skip


def columns(run: ElementRun, scenario: ElementTestScenario) -> dict[str, np.ndarray]:
    """Columns of the series of a sample, with the signs of the scenario."""
    series, dim, stress = run.series, scenario.sample.dim, face_stress(run.series, scenario.path.kind)
    p, q = invariants(stress, dim)
    signed = {
        "axial_strain": series.strain[:, dim - 1], "volumetric_strain": series.strain[:, :3].sum(axis=1),
        "p": p, "q": q,
        **{f"sigma_{a}{b}": series.stress[:, "xyz".index(a), "xyz".index(b)] for a, b in ("xx", "yy", "zz", "xy")},
    }  # fmt: skip
    plain = {
        "gamma": series.strain[:, 3], "void_ratio": series.void_ratio, "coordination": series.coordination,
        "fabric_anisotropy": series.fabric_anisotropy, "sliding_fraction": series.sliding_fraction,
        "phi": friction_angle(stress, dim), "work": work(series), "unbalanced": series.unbalanced,
    }  # fmt: skip
    table = {name: scenario.sign * values for name, values in signed.items()} | plain
    return {name: table[name] for name in COLUMNS}


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


def files(result: ElementTestResult):
    """Yield (file name, function that writes it) for the series of all samples."""
    yield SERIES, partial(_write_series, result)


def _write_series(result: ElementTestResult, path: Path) -> None:
    names = ["sample", *(heading(name, unit) for name, unit in COLUMNS.items())]
    rows = (
        (run.seed, *map(float, row))
        for run, table in zip(result.runs, _tables(result), strict=True)
        for row in zip(*table.values(), strict=True)
    )
    write_table(path, names, rows)


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
            }
            for name, run in zip(names, runs, strict=True)
        },
        "failures": "\n".join(result.failures),
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
    for sentence in (*sentences(result), *result.failures):
        console.print(f"  {sentence}", soft_wrap=True)
