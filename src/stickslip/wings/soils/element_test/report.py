"""Output of element tests: series, gradings, figures, archive, terminal summary, and Mohr circles of a sweep."""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from ....figures import response_envelopes
from ....kit import (
    Comparison,
    SweepMember,
    archive_fields,
    checked,
    console,
    estimate,
    format_table,
    heading,
    heading_of,
    new_table,
    pluralize,
    show_table,
    unit_name,
    write_table,
)
from . import figures as figures_of
from .measures import MEASURES, PROBE, SAMPLE, SERIES, STEADY, STRESS, LoadedSample, Probed
from .sample import SIGNS, describe_direction, directions_seen, first_seen, has_failed, plane_of
from .scenario import ElementTestScenario
from .simulate import MODULI_UP_TO, ElementRun, ElementTestResult

DRAWN = 4  # largest number of envelopes in one figure
COMPARED = {  # measures compared with a run at half the step; the first available one is used: words, digits, unit
    "phi_peak": ("peak angle", 2, " degrees"), "compression_index": ("compression index", 4, ""),
    "swelling_index": ("swelling index", 4, ""), "strength": ("strength", 1, ""),
}  # fmt: skip


def columns(run: ElementRun, scenario: ElementTestScenario) -> dict[str, np.ndarray]:
    """Columns of the series of a sample, with the signs of the scenario."""
    return SERIES.of(LoadedSample(run, scenario))


def for_engineers(values, unit: str):
    """Convert values and their unit for display: stresses are in kPa instead of Pa."""
    return (1e-3 * values, "kPa") if unit == "Pa" else (values, unit)


def drawn(run: ElementRun, scenario: ElementTestScenario) -> dict[str, np.ndarray]:
    """Series of a sample, with stresses in the unit of figures."""
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
    if "cell_pressure" in tables[0]:
        yield "fig2_pore_pressure.png", figures_of.pore_pressure(tables, unit)
    if scenario.path.kind != "isotropic":
        yield "fig2_stress_path.png", figures_of.stress_path(tables, unit)
    yield "fig3_void_ratio.png", figures_of.void_ratio(tables, unit, axial or "p")
    yield "fig4_contacts.png", figures_of.contacts(tables, strain)
    curve, diameters = scenario.sample.grading.curve(), scenario.sample.diameters
    yield "fig5_grading.png", figures_of.grading(curve, diameters, scenario.sample.dim)
    if probed := [each for each in result.runs[0].probes if each.envelope is not None]:
        first = {name: scenario.strain_sign * each.load for name, each in first_seen(tuple(probed)).items() if each}
        plane, drawn_strain = plane_of(scenario.path, scenario.sample.dim)[1], (strain, scenario.strain_sign)
        figure = figures_of.failure_directions(probed, tables[0], drawn_strain, first, plane)
        yield "fig6_directions.png", figure
        seen = directions_seen(tuple(probed))  # envelopes of a few states, up to the first in which a direction fails
        until = probed[: probed.index(seen) + 1] if seen else probed
        some = [until[k] for k in np.unique(np.linspace(0, len(until) - 1, DRAWN).round().astype(int))]
        labels = [f"ε = {scenario.strain_sign * each.load:.3g}" for each in some]
        yield "fig7_envelopes.png", response_envelopes([each.envelope for each in some], labels, plane)
    if scenario.cement:
        yield "fig9_broken_bonds.png", figures_of.broken_bonds(tables, strain, unit)


def files(result: ElementTestResult):
    """Yield (file name, function that writes it) for the series of all samples and the probes of the first."""
    scenario, probes = result.scenario, result.runs[0].probes
    yield "series.csv", lambda path: SERIES.write(path, (LoadedSample(run, scenario) for run in result.runs))
    if probes:
        yield "probes.csv", lambda path: PROBE.write(path, (Probed(each, scenario) for each in probes))
        yield "envelopes.csv", partial(_write_envelopes, result)
    if scenario.cement:
        yield "breaks.csv", partial(_write_breaks, result)


def _write_breaks(result: ElementTestResult, path: Path) -> None:
    """Write one row per broken bond."""
    names = ["sample", "axial_strain", "i", "j", "mode", heading("energy", "energy")]
    names += [heading(axis, "length") for axis in "xyz"]
    rows = (
        (run.seed, float(strain[row]), int(i), int(j), "tension" if tension else "shear", float(energy), *map(float, x))
        for run in result.runs
        for strain in [columns(run, result.scenario)["axial_strain"]]
        for row, i, j, tension, energy, x in zip(*run.breaks, strict=True)
    )
    write_table(path, names, rows)


def _write_envelopes(result: ElementTestResult, path: Path) -> None:
    """Write one row per direction of each probed state."""
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
    """Remarks on the numbers: scatter, states not reached, rate, and halved steps."""
    parts = (_first_failure, _scatter, _missing, _cement, _fluid, _quasi_static, _finer)
    return [sentence for part in parts for sentence in part(result)]


def _first_failure(result: ElementTestResult) -> list[str]:
    """Sentences on the first direction in which the first sample could fail, and on its peak."""
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
            f"No direction was found in which sample {run.seed} could fail, up to a strain of {last:.3g}.",
            *unanswered,
        ]
    numbers = SAMPLE.of(LoadedSample(run, scenario))
    why = "second-order work is negative" if here.signs["negative work"] else "no equilibrium is nearby"
    where = describe_direction(here.failing, scenario.path, scenario.sample.dim, scenario.sign)
    peak = f"; the peak angle is at {top:.3g}" if np.isfinite(top := numbers["strain_at_peak"]) else ""
    return [
        f"Sample {run.seed} first tended to fail at a strain of {sign * here.load:.3g}, in the direction {where}, "
        f"where {why}{peak}.",
        *unanswered,
    ]


def _scatter(result: ElementTestResult) -> list[str]:
    n, peak = result.scenario.sample.grains, MEASURES.finite_values(result).get("phi_peak")
    if len(result.runs) < 2:
        return ["One sample gives no interval: use more realisations."]
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
            f"{rigid} of {len(result.runs)} samples have elastic moduli; in the others, a strain drives unresisted "
            f"motions, or there are more than {MODULI_UP_TO} grains."
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
            f"{number} of {len(samples)} samples reached a critical state, so the residual angle is undecided: "
            f"over the last third of the path, the volumetric strain changes by up to {volume:.2g} of the imposed one, "
            f"q/p by {ratio:.1%} and p by {p:.1%}, and each must be below {STEADY:.0%}; use a larger strain or more "
            f"grains."
        )
    return out


def _cement(result: ElementTestResult) -> list[str]:
    """Return sentences on broken bonds and their modes, and on samples that did not fail."""
    cement = result.scenario.cement
    if cement is None:
        return []
    samples = [LoadedSample(run, result.scenario) for run in result.runs]
    out = []
    for sample in samples:
        tension, shear = (int((sample.breaks.tension == mode).sum()) for mode in (True, False))
        before = int((sample.breaks.row == 0).sum())
        out.append(
            f"Of {pluralize(len(sample.run.end.bonds.i), 'bond')} of sample {sample.run.seed}, {tension} broke in "
            f"tension and {shear} in shear{f', {before} of them before the test' * bool(before)}."
        )
    whole = [f"{sample.run.seed}" for sample in samples
             if not has_failed(sample.series.stress, cement, sample.dim)]  # fmt: skip
    if whole:
        out.append(
            f"The strength is a lower bound in sample {', '.join(whole)}, whose deviatoric stress did not fall to "
            f"{cement.until:g} of its peak; use a larger strain."
        )
    return out


def _fluid(result: ElementTestResult) -> list[str]:
    """Sentence on B with a compressible pore fluid, measured or from the elastic moduli of the samples."""
    path = result.scenario.path
    if path.fluid_modulus is None:
        return []
    samples = [LoadedSample(run, result.scenario) for run in result.runs]
    elastic = np.array([sample.elastic_b for sample in samples])
    closed = f"{elastic[np.isfinite(elastic)].mean():.3g}" if np.isfinite(elastic).any() else "not known"
    if path.kind == "undrained":
        return [f"With the stated fluid_modulus, B is {closed} before the test, from the elastic bulk modulus."]
    measured = np.mean([sample.skempton_b for sample in samples])
    return [
        f"As measured over the first change of the cell pressure, B is {measured:.3g}; before the test it is {closed}, "
        f"from the elastic bulk modulus."
    ]


def _quasi_static(result: ElementTestResult) -> list[str]:
    scenario, numbers = result.scenario, MEASURES.finite_values(result)
    if scenario.path.integrator == "dynamic":
        return [
            f"The strain rate of {scenario.rate:.3g} gives an inertial number of {scenario.rate * scenario.time:.2g}; "
            f"the mean unbalanced force was at most {numbers['largest_unbalanced'].mean:.2g} of the mean contact force."
        ]
    share = numbers["rearranged_share"].mean if "rearranged_share" in numbers else 0.0
    return [f"Grains rearranged in {share:.0%} of the steps, in which equilibria were found by damped dynamics."]


def _finer(result: ElementTestResult) -> list[str]:
    what = "step" if result.scenario.path.integrator == "quasi-static" else "rate"
    if result.checked is None:
        return [f"Convergence with half the {what} was not checked: use check = true."]
    pair = (LoadedSample(run, result.scenario) for run in (result.runs[0], result.checked))
    both = SAMPLE.columns(pair)
    name = next((name for name in COMPARED if name in both and np.isfinite(both[name]).all()), None)
    if name is None:
        return [f"The path gives no number for a comparison with half the {what}."]
    (before, after), (words, digits, unit) = both[name], COMPARED[name]
    scatter = MEASURES.of(result)[name].scatter
    if SAMPLE[name].unit == STRESS:
        (before, unit), (after, _) = (for_engineers(value, unit_name(STRESS)) for value in (before, after))
        scatter, unit = for_engineers(scatter, unit_name(STRESS))[0], f" {unit}"
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
            } | ({"breaks": archive_fields(run.breaks)} if run.breaks else {})
            for name, run in zip(names, runs, strict=True)
        },
        "failures": "\n".join(result.failures), "remarks": "\n".join(sentences(result)),
    }  # fmt: skip


def show(result: ElementTestResult) -> None:
    """Print the numbers of a test with their intervals and limitations."""
    scenario = result.scenario
    kind = f"{'cemented ' * bool(scenario.cement)}{scenario.path.kind}"
    title = f"{kind} test of {pluralize(len(result.runs), 'sample')} of {scenario.sample.grains} grains"
    MEASURES.show(result, title=title, readable=for_engineers)
    if result.runs[0].probes:
        # the strain at which each sign of failure first appears
        run, sign = result.runs[0], result.scenario.strain_sign
        table = new_table("", "first at", "", title=f"Signs of failure of sample {run.seed}", left=("",))
        for name, each in first_seen(run.probes).items():
            table.add_row(name, f"{sign * each.load:.3g}" if each else "–", SIGNS[name])
        show_table(table)
    for sentence in (*sentences(result), *result.failures):
        console.print(f"  {sentence}", soft_wrap=True)


PRESSURES, SEED = ("cement.confining", "sample.pressure"), "seed"  # the first of these keys that is swept counts
STATES = {  # suffixes of the names of stresses, and their descriptions
    "peak": "at the peak", "critical": "at the critical state", "end": "over the last third of the path, not steady",
}  # fmt: skip
FIGURE, TABLE, LINES = "mohr.png", "mohr.csv", "critical_state.png"
ROWS = 3  # largest number of groups drawn


def with_error(value: float, error: float, unit: str = "") -> str:
    """Format a value with two digits of its error in parentheses, and its unit; without error, with three digits."""
    if not error > 0:
        return f"{value:.3g}{unit}".replace("-", "−")
    digits = min(max(0, 1 - int(np.floor(np.log10(error)))), 6)
    text = f"{round(value, digits) + 0.0:.{digits}f} ± {error:.{digits}f}"
    return (f"({text}){unit}" if unit else text).replace("-", "−")


class Envelope(NamedTuple):
    """Envelope τ = c + σ tan φ of Mohr circles, with half-widths of 95 % intervals (NaN for two circles)."""

    phi: float  # [degrees]
    cohesion: float  # in the unit of the stresses
    phi_error: float
    cohesion_error: float

    def describe(self, factor: float = 1.0, unit: str = "") -> str:
        """φ and c with their errors; stresses are multiplied by a factor."""
        cohesion = with_error(factor * self.cohesion, factor * self.cohesion_error, f" {unit}".rstrip())
        return f"φ = {with_error(self.phi, self.phi_error, '°')}, c = {cohesion}"


@checked
def fit_envelope(sigma1: np.ndarray, sigma3: np.ndarray) -> Envelope:
    """Envelope of Mohr circles with major and minor principal stresses (K,), compression positive.

    All circles touch τ = c + σ tan φ if σ₁ = N σ₃ + 2 c √N with N = (1 + sin φ)/(1 − sin φ). This line is fitted by
    least squares with weights 1/(σ₁ + σ₃)², because the angle scatters between samples, and σ₁ therefore scatters in
    proportion to the stress. Errors follow from the deviations, by Student's t with K − 2 degrees of freedom.

    Raises
    ------
    ValueError
        If there are fewer than two circles, or all have the same σ₃.

    Examples
    --------
    >>> fit_envelope(np.array([300.0, 600.0, 1200.0]), np.array([100.0, 200.0, 400.0])).phi.round(6)
    np.float64(30.0)
    """
    sigma1, sigma3 = np.asarray(sigma1, float), np.asarray(sigma3, float)
    count = len(sigma3)
    if count < 2 or not np.ptp(sigma3) > 1e-6 * np.abs(sigma3).max():
        raise ValueError(f"an envelope needs Mohr circles at two or more values of σ₃, but all {count} have the same")
    weight = 1 / (sigma1 + sigma3)
    (n, b), spread = _least_squares(weight[:, None] * np.column_stack([sigma3, np.ones(count)]), weight * sigma1)
    by_phi = np.array([1 / ((n + 1) * np.sqrt(n)), 0.0])  # derivatives with respect to n and b
    by_c = np.array([-b / (4 * n**1.5), 1 / (2 * np.sqrt(n))])
    return Envelope(
        np.degrees(np.arcsin((n - 1) / (n + 1))),
        b / (2 * np.sqrt(n)),
        np.degrees(np.sqrt(by_phi @ spread @ by_phi)),
        np.sqrt(by_c @ spread @ by_c),
    )


def _least_squares(basis: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (2,) of a line, and their covariance (2, 2) times Student's t², which is NaN with two values."""
    found, *_ = np.linalg.lstsq(basis, values)
    rest, free = values - basis @ found, len(values) - 2
    if not free:
        return found, np.full((2, 2), np.nan)
    return found, np.linalg.inv(basis.T @ basis) * (rest @ rest) / free * stdtrit(free, 0.975) ** 2


class CriticalLine(NamedTuple):
    """Critical-state line q = M p, e = Γ − λ ln p, with half-widths of 95 % intervals (NaN for two states)."""

    ratio: float  # M
    intercept: float  # Γ, void ratio at p = 1
    slope: float  # λ
    ratio_error: float
    intercept_error: float
    slope_error: float

    def describe(self, unit: str = "") -> str:
        """Both equations, with stresses in a given unit."""
        values = (
            f"{name} = {with_error(value, error)}" for name, value, error in zip("MΓλ", self[:3], self[3:], strict=True)
        )
        return f"q = M p, e = Γ − λ ln(p{f' / {unit}' * bool(unit)}) with {', '.join(values)}"


@checked
def fit_critical_line(p: np.ndarray, q: np.ndarray, void_ratio: np.ndarray) -> CriticalLine:
    """Critical-state line through critical states (K,), from mean stress, deviatoric stress and void ratio.

    M is the mean of |q|/p; Γ and λ are from a least-squares fit of e against ln p.

    Raises
    ------
    ValueError
        If there are fewer than two states, all have the same p, or some p is not positive.

    Source
    ------
    Roscoe, Schofield & Wroth, doi:10.1680/geot.1958.8.1.22.

    Examples
    --------
    >>> p = np.array([50.0, 100.0, 400.0])
    >>> round(fit_critical_line(p, 0.9 * p, 0.8 - 0.02 * np.log(p)).slope, 6)
    0.02
    """
    p, q, e = (np.asarray(values, float) for values in (p, q, void_ratio))
    if len(p) < 2 or not np.ptp(p) > 1e-6 * np.abs(p).max():
        raise ValueError(f"a critical-state line needs states at two mean stresses, but all {len(p)} have the same one")
    if not (p > 0).all():
        raise ValueError(f"mean stresses of a critical-state line must be positive, got {p.min():.3g}")
    (intercept, fall), spread = _least_squares(np.column_stack([np.ones(len(p)), np.log(p)]), e)
    ratio = estimate(np.abs(q) / p)
    errors = np.sqrt(np.diag(spread))
    return CriticalLine(
        ratio.mean, float(intercept), float(-fall), ratio.half_width if len(p) > 2 else np.nan, *map(float, errors)
    )


class Circles(NamedTuple):
    """Mohr circles, at one state, of members that differ in pressure, and the envelope of these circles."""

    group: str  # values of other swept keys
    state: str
    sigma1: np.ndarray  # (K,)
    sigma3: np.ndarray  # (K,)
    members: int  # number of members, including those without this state
    envelope: Envelope


class Ends(NamedTuple):
    """States over the last third of the path, for members that differ in pressure."""

    group: str  # values of other swept keys
    p: np.ndarray  # (K,)
    q: np.ndarray  # (K,) magnitude
    void_ratio: np.ndarray  # (K,)
    critical: np.ndarray  # (K,) bool, True if all samples of the member are in a critical state
    line: CriticalLine | None  # through the critical states; None if these have fewer than two mean stresses


def compare(members: list[SweepMember]) -> Comparison:
    """Compare tests at several pressures: Mohr circles, their envelopes, and critical-state line or uniaxial strengths.

    The pressure is `sample.pressure` or, with cement, `cement.confining`. Circles are drawn at the peak and, without
    cement, at the critical state. If fewer than two pressures lead to a critical state, circles for the last third of
    the path are drawn instead, without a line. Members that differ in other swept keys have separate envelopes and
    lines, unless these keys vary only together with the pressure. Circles of tension tests are drawn, but not used for
    the envelope.
    """
    swept = [key for key in PRESSURES if any(key in member.values for member in members)]
    members = [member for member in members if swept and "sigma1_peak" in member.measures]
    if not members:
        return Comparison()
    pressure, cemented = swept[0], swept[0] == PRESSURES[0]
    without = (pressure, SEED, *(("path.strain", "path.step") if cemented else ()))
    pairs = {
        key: {(member.values[pressure], str(member.values[key])) for member in members}
        for key in members[0].values if key not in without
    }  # fmt: skip
    pressures = len({member.values[pressure] for member in members})
    keys = [key for key, values in pairs.items() if len(values) > pressures]  # keys with several values at one pressure
    groups: dict[str, list[SweepMember]] = {}
    for member in members:
        values = ((key, member.values[key]) for key in keys)
        name = ", ".join(
            f"{key} = {value:.6g}" if isinstance(value, float) else f"{key} = {value}" for key, value in values
        )
        groups.setdefault(name, []).append(member)
    unit = members[0].measures["sigma1_peak"][1]
    factor, shown = (1e-3, "kPa") if unit == "Pa" else (1.0, unit)
    circles, ends, remarks = [], [], []
    for name, group in groups.items():
        late = _circles(name, group, "critical") or _circles(name, group, "end")
        for each in filter(None, (_circles(name, group, "peak"), late)):
            circles.append(each)
            fitted = int(_in_compression(each.sigma1, each.sigma3).sum())
            remarks.append(
                f"Mohr circles {STATES[each.state]}{f' ({each.group})' * bool(each.group)}: "
                f"{each.envelope.describe(factor, shown)}, from {fitted} of {each.members} members."
            )
        if cemented:
            remarks += _describe_strengths(name, group, factor, shown)
        else:
            ends.append(_ends(name, group, factor))
            remarks.append(_describe_ends(ends[-1], group, shown))
    if not circles:
        return Comparison(remarks=tuple(remarks) if cemented else ())
    drawn = [each for each in circles if each.group in list(groups)[:ROWS]]
    files = {FIGURE: figures_of.mohr_circles(drawn, factor, shown), TABLE: _table(members, remarks, pressure)}
    if any(len(each.p) for each in ends[:ROWS]):
        files[LINES] = figures_of.critical_state(ends[:ROWS], shown)
    return Comparison(files, tuple(remarks))


def _describe_strengths(name: str, group: list[SweepMember], factor: float, unit: str) -> list[str]:
    """Sentence on the uniaxial strengths of a group of cemented samples, and their ratio."""
    strengths = {
        words: factor * estimate(values[np.isfinite(values)]).mean
        for key, words in (("UCS", "uniaxial compressive strength"), ("tensile_strength", "direct tensile strength"))
        for values in [_column(group, key)] if np.isfinite(values).any()
    }  # fmt: skip
    if not strengths:
        return []
    told = ", ".join(f"{words} {value:.3g} {unit}".rstrip() for words, value in strengths.items())
    ratio = np.divide(*strengths.values()) if len(strengths) == 2 else 0.0
    return [f"{told[0].upper()}{told[1:]}{f': a ratio of {ratio:.2g}' * bool(ratio)}{f' ({name})' * bool(name)}."]


def _describe_ends(ends: Ends, group: list[SweepMember], unit: str) -> str:
    """Sentence on φ_cs and the critical-state line of a group, or the reason for their absence."""
    reached, where = int(ends.critical.sum()), f" ({ends.group})" * bool(ends.group)
    count = f"{reached} of {pluralize(len(group), 'member')}"
    if ends.line is None:
        return f"{count} reached a critical state{where}; a critical-state line needs two, at different mean stresses."
    angle = estimate(_column(group, "phi_residual")[_column(group, "critical_reached") == 1])
    error = angle.half_width if reached > 2 else np.nan
    return (
        f"Critical-state line{where}: {ends.line.describe(unit)}, φ_cs = {with_error(angle.mean, error, '°')} without "
        f"cohesion, from {count}."
    )


def _column(group: list[SweepMember], name: str) -> np.ndarray:
    """Values of a measure (K,); NaN for members that lack it."""
    return np.array([member.measures.get(name, (np.nan,))[0] for member in group], float)


def _circles(name: str, group: list[SweepMember], state: str) -> Circles | None:
    """Return the circles of the members that reached a state; None if these have fewer than two pressures."""
    pairs = np.column_stack([_column(group, f"sigma{k}_{state}") for k in (1, 3)])
    sigma1, sigma3 = pairs[np.isfinite(pairs).all(axis=1)].T
    pressed = _in_compression(sigma1, sigma3)
    try:
        return Circles(name, state, sigma1, sigma3, len(group), fit_envelope(sigma1[pressed], sigma3[pressed]))
    except ValueError:
        return None


def _in_compression(sigma1: np.ndarray, sigma3: np.ndarray) -> np.ndarray:
    """Return the mask of the circles to which the envelope is fitted."""
    return sigma1 > -sigma3


def _ends(name: str, group: list[SweepMember], factor: float) -> Ends:
    """Return the ends of the paths of a group, with stresses multiplied by a factor."""
    p, ratio, e = (_column(group, each) for each in ("p_end", "end_ratio", "e_end"))
    there = np.isfinite(p + ratio + e)
    p, q, e = factor * p[there], (factor * p * ratio)[there], e[there]
    critical = (_column(group, "critical_reached") == 1)[there]
    try:
        line = fit_critical_line(p[critical], q[critical], e[critical])
    except ValueError:
        line = None
    return Ends(name, p, q, e, critical, line)


def _table(members: list[SweepMember], remarks: list[str], pressure: str) -> str:
    """CSV with one row per member: swept values, stresses, angles and void ratios, with errors if known."""
    names = [f"sigma{k}_{state}" for state in STATES for k in (3, 1)]
    names += ["phi_peak", "phi_residual", "critical_reached", "p_end", "end_ratio", "e_end"]
    names += ["E", "nu", "UCS", "tensile_strength", "broken_tension", "broken_shear"]
    names = [part for name in names for part in (name, f"{name}_error")]
    units = {name: unit for member in members for name, (_, unit) in member.measures.items()}
    names = [name for name in names if name in units]  # members computed by earlier versions lack some
    keys = list(members[0].values)
    stress = units["sigma1_peak"]
    headings = [heading_of(key, stress) if key == pressure else key for key in keys]
    headings += [heading_of(name, units[name]) for name in names]
    columns = [_column(members, name) for name in names]
    rows = ([*member.values.values(), *row] for member, row in zip(members, np.transpose(columns), strict=True))
    return format_table(headings, rows, comments=remarks)
