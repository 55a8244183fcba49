"""Fits of a laboratory record: tables, JSON, figures, and draws from the posterior."""

import json
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....figures import Look
from ....kit import (
    FORMATS,
    PLAIN,
    Report,
    console,
    find_foreign,
    foreign_files_message,
    format_table,
    heading_of,
    known,
    new_table,
    parse_integer,
    progress,
    render_all,
    require,
    show_table,
    silent,
    within,
    write_file,
)
from ..friction.fitting import Fit, Solution, build_fit, solve_fit
from ..friction.inference import PERCENTS, LawComparison, Posterior, compare_laws, gain_by, posterior, stiffness_doubt
from ..friction.laboratory import LabRecord, read_record, record_columns, record_data
from ..friction.model import Data
from . import figures as figures

NUMBERS, FIGURE = "fit.json", "fit.png"
DRAWS, CORNER = "posterior.csv", "posterior.png"
FILES = (NUMBERS, DRAWS, *(name.replace("png", kind) for name in (FIGURE, CORNER) for kind in FORMATS))
CREDIBLE = 1e-8, 0.1  # range of D_c [m] of rocks and gouge in experiments, with a margin of a factor of ten
UNITS = {
    "dc": "m",
    "dc2": "m",
    "v1": "m/s",
    "v2": "m/s",
    "stiffness": "1/m",
    "trend": "1/m",
    "trend_length": "m",
    "drift": "1/s",
    "v0": "m/s",
    "damping": "s/m",
}


class RecordFits(NamedTuple):
    """A record, its fits, and their comparison."""

    file: Path
    data: Data
    fits: tuple[Fit, ...]
    comparison: LawComparison | None
    posterior: Posterior | None = None
    remedies: tuple[str, ...] = ()  # possible errors in the input, tested by second fits
    met: dict[str, list[str]] | None = None  # columns of the record: used, without effect, and unknown


def fit_record(
    file: Path, *, laws, fixed: dict[str, float], free: tuple[str, ...] = (), before: float | None = None,
    normal: bool = False, columns: str | None = None, form: str = "logarithmic", steps: int | None = None,
    velocity: str | None = None,
) -> RecordFits:  # fmt: skip
    """Read a record and fit each law to it.

    If `steps` is a number, the posterior of the law, or of the preferred law, is sampled as well.
    """
    if "stiffness" in fixed and "stiffness" in free:
        raise ValueError("--stiffness and --free-stiffness exclude each other: choose one")
    raw = read_record(file, columns=_parse_columns(columns), motion=velocity is None)
    try:
        record = record_data(raw, before=before, normal=normal, velocity=velocity)
    except ValueError as problem:
        raise ValueError(re.sub("^velocity", "--velocity", str(problem))) from None
    sprung, has_stiffness = len(record.legs) > 0, "stiffness" in fixed or "stiffness" in free
    if sprung and not has_stiffness:
        raise ValueError("the stiffness of the apparatus is unknown: give --stiffness K [1/m], or --free-stiffness")
    if not sprung and has_stiffness:
        raise ValueError(
            f"{file} has a slip velocity but no load_point, so there is no spring: leave out the stiffness"
        )
    if normal and np.ptp([leg.normal for leg in record.legs]) > 0:
        free = tuple(dict.fromkeys([*(name for name in free if name == "stiffness"), "alpha", *free]))
    if steps is not None:
        require("emcee", "posterior")
    with progress() as tell:
        solutions = [
            solve_fit(record, law=law, form=form, fixed=fixed, free=free, report=within(tell, stage=f"{law} law"))
            for law in laws
        ]
        fits = tuple(map(build_fit, solutions))
        comparison = compare_laws(*fits) if len(fits) == 2 else None
        best = [s for s in solutions if comparison is None or comparison.preferred in (None, s.task.law)]
        met = record_columns(file, columns=_parse_columns(columns))
        remedies = (
            *_remedies(raw, record, best, tell),
            *(f"column {text}" for text in met[known.UNKNOWN] if text.endswith("normal stress")),
        )
        result = RecordFits(file, record, fits, comparison, remedies=remedies, met=met)
        return result if steps is None else result._replace(posterior=_sample(result, form, fixed, free, steps, tell))


def _remedies(raw: LabRecord, record: Data, solutions: list[Solution], tell: Report = silent) -> tuple[str, ...]:
    """Sentences on possible errors in the input (missing trend, wrong stiffness), for laws that the data allow."""
    out, normal = [], None if raw.normal_stress is None else float(np.median(raw.normal_stress))
    solutions = [
        solution._replace(task=solution.task._replace(report=within(tell, stage=f"doubts about the {law} law")))
        for solution in solutions
        for law in (solution.task.law,)
    ]
    found = [stiffness_doubt(record, solution, normal) for solution in solutions]
    some = any(doubt and np.isfinite(doubt.interval[0]) for doubt in found)
    for solution, doubt in zip(solutions, found, strict=True):
        if doubt:  # a law that does not describe the record is irrelevant if another law does
            out += [f"{solution.task.law} law: {doubt}"] if np.isfinite(doubt.interval[0]) or not some else []
            continue
        trend, state = gain_by("trend", solution), gain_by("theta", solution)
        if trend.helps and trend.after <= state.after:
            out.append(
                f"{solution.task.law} law: friction has a trend of {trend.values[0]:.3g} 1/m, which was not fitted; "
                f"with it, the standard deviation of the residuals falls by {100 * trend.fall:.0f} %, from "
                f"{trend.before:.2g} to {trend.after:.2g}: --detrend may help"
            )
        elif state.helps:
            shifts = ", ".join(
                f"{name} by {100 * state.shifts[name]:+.2g} %" for name in ("a", "b", "dc") if name in state.shifts
            )
            out.append(
                f"{solution.task.law} law: the record does not start in steady state, but with {state.values[0]:.3g} "
                f"times the steady θ; this changes {shifts}: use --free theta, or remove the start"
            )
    return tuple(out)


def _sample(result: RecordFits, form: str, fixed: dict, free, steps: int, tell: Report) -> Posterior:
    """Sample the posterior of the only law, or of the preferred one."""
    law = result.fits[0].law if result.comparison is None else result.comparison.preferred
    if law is None:
        raise RuntimeError(
            f"{result.comparison.sentence}: choose the law of the posterior with --law aging or --law slip"
        )
    return posterior(
        result.data, law=law, form=form, fixed=fixed, free=free, steps=steps,
        report=within(tell, stage=f"posterior, {law} law"),
    )  # fmt: skip


def _parse_columns(text: str | None) -> dict[str, int | str] | None:
    """Parse numbers or headings of columns, such as "time=0,load_point [um]=LVDT 2"."""
    if text is None:
        return None
    pairs = [[part.strip() for part in item.partition("=")] for item in text.split(",")]
    if not all(name and place for name, _, place in pairs):
        raise ValueError(
            f"--columns must be NAME=NUMBER, counted from 0, or NAME=HEADING, as in 'time=0,friction=mu2', got {text!r}"
        )
    return {name: parse_integer(place) if place.isdecimal() else place for name, _, place in pairs}


def check_folder(out: Path, overwrite: bool) -> None:
    """Raise ValueError if a fit must not be written to a folder."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is a file, not a folder: choose another --out")
    if overwrite:
        return
    if others := find_foreign(out, lambda name: name in FILES):
        raise ValueError(foreign_files_message(out, others))
    if (out / NUMBERS).exists():
        raise ValueError(f"{out} contains the results of a fit: choose another --out, or add --overwrite")


FIELDS = (  # fields of a fit in the JSON object
    "values", "errors", "intervals", "names", "form", "fixed", "identifiable", "sentence", "sigma", "effective",
    "adequate", "reduced", "aic", "bic",
)  # fmt: skip


def as_json(result: RecordFits) -> str:
    """Return one JSON object with the documented keys; unknown values are null."""
    fits = {}
    for fit in result.fits:
        fits[fit.law] = {name: getattr(fit, name) for name in FIELDS} | {"covariance": fit.covariance.tolist()}
        fits[fit.law] |= {"noise": fit.noise.tolist(), "samples": fit.samples, "a_minus_b": fit.difference}
    out = {"file": result.file.name, "units": "m, s", "fits": fits}
    if result.comparison is not None:
        out["comparison"] = result.comparison._asdict()
    if result.posterior is not None:
        found = result.posterior
        percentiles = {k: dict(zip(map(str, PERCENTS), row, strict=True)) for k, row in found.percentiles.items()}
        chain = {"autocorrelation_times": found.times, "steps": found.steps, "acceptance": found.acceptance}
        out["posterior"] = {"law": found.fit.law, "percentiles": percentiles, "draws": len(found.draws), **chain}
    out["doubts"] = doubts(result)
    out["met"] = known.with_keys(result.met or {})
    return json.dumps(_replace_nonfinite(out), indent=1, allow_nan=False)


def _replace_nonfinite(thing):
    """Replace non-finite numbers with None."""
    if isinstance(thing, dict):
        return {k: _replace_nonfinite(v) for k, v in thing.items()}
    if isinstance(thing, list | tuple):
        return [_replace_nonfinite(v) for v in thing]
    if isinstance(thing, float | np.floating):
        return float(thing) if np.isfinite(thing) else None
    return thing


def show(result: RecordFits) -> None:
    """Print a table for each law, and the comparison."""
    for fit in result.fits:
        names, title = ("parameter", "value", "95 % interval", "unit"), f"{fit.law.capitalize()} law"
        table = new_table(*names, title=title, left=("parameter", "unit"))
        for name in fit.names:
            table.add_row(name, *_format_cells(fit.values[name], *fit.intervals[name]), UNITS.get(name, ""))
        if {"a", "b"} & set(fit.names):
            table.add_row("a − b", *_format_cells(*fit.difference), "")
        for name in ("stiffness", "v0"):
            if name in fit.fixed:
                table.add_row(name, f"{fit.fixed[name]:.5g}", "fixed", UNITS[name])
        show_table(table)
        count = f"equivalent to {fit.effective:.0f} independent ones" if len(fit.noise) else "independent of each other"
        console.print(f"  noise {fit.sigma:.2e}; {fit.samples} samples, {count}")
        if together := _trade_offs(fit):
            console.print(f"  {together}")
        if not (fit.identifiable and fit.adequate):
            console.print(f"  {fit.sentence}", style="yellow")
        console.print()
    if (found := result.posterior) is not None:
        names = ("parameter", *(f"{percent:g} %" for percent in PERCENTS), "unit")
        table = new_table(*names, title=f"Posterior, {found.fit.law} law", left=("parameter", "unit"))
        for name in found.names:
            table.add_row(name, *(f"{value:.4g}" for value in found.percentiles[name]), UNITS.get(name, ""))
        show_table(table)
        slowest = max(found.times.values())
        console.print(
            f"  {len(found.draws)} draws; the chain is {found.steps / slowest:.0f} autocorrelation times long "
            f"(τ = {slowest:.1f} steps, acceptance {found.acceptance:.2f})"
        )
        console.print()
    for sentence in doubts(result):
        console.print(sentence, style="yellow")
    if result.comparison is not None:
        console.print(result.comparison.sentence, style="bold")


def _trade_offs(fit: Fit) -> str:
    """Sentence on parameters correlated with a fitted stiffness; empty if there are none."""
    if "stiffness" not in fit.names or not np.isfinite(fit.values["stiffness"]):
        return ""
    size = np.sqrt(np.diag(fit.covariance))
    row = (fit.covariance / np.outer(size, size))[fit.names.index("stiffness")]
    pairs = [(name, r) for name, r in zip(fit.names, row, strict=True) if name != "stiffness" and np.isfinite(r)]
    return f"correlation of the stiffness with {', '.join(f'{name} {r:+.2f}' for name, r in pairs)}" if pairs else ""


def doubts(result: RecordFits) -> list[str]:
    """Return one sentence per possible error: spikes, a wrong unit of length or stiffness, or a missing trend."""
    low, high = CREDIBLE
    fit = result.fits[0]
    count = sum(map(len, fit.spikes))
    total = f"{count} of {count + fit.samples} samples are spikes, farther from their neighbours than noise explains"
    spikes = [f"{total}; they were excluded"] if count else []
    lengths = [
        f"{fit.law} law: D_c = {dc:.3g} m is outside the range of {low:g} to {high:g} m found in experiments: "
        f"is the unit of the displacement right? In {unit}, D_c would be {dc * factor:.3g} m"
        for fit in result.fits
        if np.isfinite(dc := fit.values.get("dc", np.nan)) and not low <= dc <= high
        for unit, factor in [_likelier_unit(dc)]
    ]
    return [*spikes, *result.remedies, *lengths]


def _likelier_unit(dc: float) -> tuple[str, float]:
    """Likely unit of the displacements, and the conversion factor from the unit stated in the file."""
    factors = [10.0**k for k in (-9, -6, -3, 3, 6, 9)]
    factor = min(factors, key=lambda size: abs(np.log(dc * size / 1e-5)))  # nearest to ten micrometres
    return f"a unit {1 / factor:g} times smaller" if factor < 1 else f"a unit {factor:g} times larger", factor


def conclusions(result: RecordFits) -> list[str]:
    """Return the conclusion: the law that the data prefer, or the sentence for a single fit."""
    return [result.comparison.sentence] if result.comparison is not None else [fit.sentence for fit in result.fits]


def _format_cells(value: float, low: float, high: float) -> tuple[str, str]:
    if not np.isfinite(value):
        return "unknown", "–"
    return f"{value:.5g}", f"{low:.5g} … {high:.5g}" if np.isfinite(low) else "–"


def write(out: Path, result: RecordFits, look: Look = PLAIN) -> list[Path]:
    """Write the JSON file, the figures and the draws, and return their paths."""
    out.mkdir(parents=True, exist_ok=True)
    contents = render_all(FIGURE, figures.fitted(result.data, result.fits), look)
    if (sampled := result.posterior) is not None:
        law, form, known_values = sampled.fit.law, sampled.fit.form, sampled.fit.fixed.items()
        fixed = ", ".join(f"{name} = {value:.6g}" for name, value in known_values)
        notes = f"draws from the posterior of {result.file.name}, {law} law, {form} form", f"fixed: {fixed}"
        labels = [heading_of(name, UNITS.get(name, "1")) for name in sampled.names]
        contents[DRAWS] = format_table(labels, sampled.draws, digits=8, comments=notes).encode()
        contents |= render_all(CORNER, figures.corner(sampled.columns, sampled.fit.intervals, UNITS), look)
    for name in FILES:
        if name not in (NUMBERS, *contents):
            (out / name).unlink(missing_ok=True)  # files of an earlier fit
    for name, data in contents.items():
        write_file(out, name, data)
    write_file(out, NUMBERS, f"{as_json(result)}\n".encode())  # written last, because it marks the fit as complete
    return [out / name for name in (NUMBERS, *contents)]
