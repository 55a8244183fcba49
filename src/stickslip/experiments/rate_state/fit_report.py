"""Fits of a laboratory record: tables, JSON and a figure."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table

from ...data.manifest import find_foreign, write_file
from ...figures import rate_state as figures
from ...figures.style import png
from ...friction.fitting import Fit, fit
from ...friction.laboratory import read_csv, record_data
from ...friction.model import Data
from ...friction.model_comparison import LawComparison, compare_laws
from ..run_folder import foreign_files_message
from ..terminal import STYLE, console, show_table

NUMBERS, FIGURE = "fit.json", "fit.png"
CREDIBLE = 1e-8, 0.1  # D_c [m] of rocks and gouge in experiments, with a margin of a factor of ten
UNITS = {
    "dc": "m",
    "dc2": "m",
    "v1": "m/s",
    "v2": "m/s",
    "stiffness": "1/m",
    "trend": "1/m",
    "v0": "m/s",
    "damping": "s/m",
}


class RecordFits(NamedTuple):
    """A record, its fits, and their comparison."""

    file: Path
    data: Data
    fits: tuple[Fit, ...]
    comparison: LawComparison | None


def fit_record(
    file: Path, *, laws, stiffness: float | None, free_stiffness: bool, v0: float | None, before: float | None,
    detrend: bool, normal: bool, out: Path | None, overwrite: bool, columns: str | None = None,
    form: str = "logarithmic", more_free: tuple[str, ...] = (),
) -> RecordFits:  # fmt: skip
    """Read a record and fit each law to it; the output folder is checked first."""
    if out is not None:
        _check_folder(out, overwrite)
    if stiffness is not None and free_stiffness:
        raise ValueError("--stiffness and --free-stiffness were both given: choose one")
    record = record_data(read_csv(file, columns=_parse_columns(columns)), before=before, normal=normal)
    sprung = len(record.legs) > 0
    if sprung and stiffness is None and not free_stiffness:
        raise ValueError("the stiffness of the apparatus is unknown: give --stiffness K [1/m], or --free-stiffness")
    if not sprung and (stiffness is not None or free_stiffness):
        raise ValueError(
            f"{file} has a slip velocity but no load_point, so there is no spring: leave out the stiffness"
        )
    changes = normal and np.ptp([leg.normal for leg in record.legs]) > 0
    free = tuple(name for name, on in (("stiffness", free_stiffness), ("alpha", changes), ("trend", detrend)) if on)
    free = tuple(dict.fromkeys(free + more_free))
    given = {"stiffness": stiffness, "v0": v0}
    fixed = {name: value for name, value in given.items() if value is not None}
    fits = tuple(fit(record, law=law, form=form, fixed=fixed, free=free) for law in laws)
    return RecordFits(file, record, fits, compare_laws(*fits) if len(fits) == 2 else None)


def _parse_columns(text: str | None) -> dict[str, int] | None:
    """Parse column numbers, such as "time=0,friction=3"."""
    if text is None:
        return None
    pairs = [item.rpartition("=") for item in text.split(",")]
    if not all(name.strip() and number.strip().isdecimal() for name, _, number in pairs):
        raise ValueError(f"--columns {text!r} was given: use NAME=NUMBER, counted from 0, as in 'time=0,friction=3'")
    return {name.strip(): int(number) for name, _, number in pairs}


def _check_folder(out: Path, overwrite: bool) -> None:
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is a file, not a folder: choose another --out")
    if overwrite:
        return
    if others := find_foreign(out, lambda name: name in (NUMBERS, FIGURE)):
        raise ValueError(foreign_files_message(out, others))
    if (out / NUMBERS).exists():
        raise ValueError(f"{out} contains the results of a fit: choose another --out, or add --overwrite")


def as_json(found: RecordFits) -> str:
    """Return one JSON object with the documented keys; unknown values are null."""
    out = {"file": found.file.name, "units": "m, s", "fits": {one.law: _fit_dict(one) for one in found.fits}}
    if found.comparison is not None:
        out["comparison"] = found.comparison._asdict()
    out["doubts"] = doubts(found)
    return json.dumps(_replace_nonfinite(out), indent=1, allow_nan=False)


def _fit_dict(one: Fit) -> dict:
    names = (
        "values",
        "errors",
        "intervals",
        "names",
        "form",
        "fixed",
        "identifiable",
        "sentence",
        "sigma",
        "effective",
        "aic",
        "bic",
    )
    more = {"covariance": one.covariance.tolist(), "noise": one.noise.tolist(), "samples": one.samples}
    return {name: getattr(one, name) for name in names} | more | {"a_minus_b": one.difference}


def _replace_nonfinite(thing):
    """Replace non-finite numbers with None."""
    if isinstance(thing, dict):
        return {k: _replace_nonfinite(v) for k, v in thing.items()}
    if isinstance(thing, list | tuple):
        return [_replace_nonfinite(v) for v in thing]
    if isinstance(thing, float | np.floating):
        return float(thing) if np.isfinite(thing) else None
    return thing


def show(found: RecordFits) -> None:
    """Print a table for each law, and the comparison."""
    for one in found.fits:
        table = Table(title=f"{one.law.capitalize()} law", **STYLE)
        for name in ("parameter", "value", "95 % interval", "unit"):
            table.add_column(name, justify="left" if name in ("parameter", "unit") else "right", no_wrap=True)
        for name in one.names:
            table.add_row(name, *_format_cells(one.values[name], *one.intervals[name]), UNITS.get(name, ""))
        if {"a", "b"} & set(one.names):
            table.add_row("a − b", *_format_cells(*one.difference), "")
        for name in ("stiffness", "v0"):
            if name in one.fixed:
                table.add_row(name, f"{one.fixed[name]:.5g}", "fixed", UNITS[name])
        show_table(table)
        count = f"equivalent to {one.effective:.0f} independent ones" if len(one.noise) else "independent of each other"
        console.print(f"  noise {one.sigma:.2e}; {one.samples} samples, {count}")
        if not (one.identifiable and one.adequate):
            console.print(f"  {one.sentence}", style="yellow")
        console.print()
    for sentence in doubts(found):
        console.print(sentence, style="yellow")
    if found.comparison is not None:
        console.print(found.comparison.sentence, style="bold")


def doubts(found: RecordFits) -> list[str]:
    """Return one sentence for each fit with a D_c that suggests a wrong unit of length."""
    low, high = CREDIBLE
    return [
        f"{one.law} law: D_c = {dc:.3g} m is outside the range of {low:g} to {high:g} m found in experiments: "
        f"is the unit of the displacement right? In {unit}, D_c would be {dc * factor:.3g} m"
        for one in found.fits
        if np.isfinite(dc := one.values.get("dc", np.nan)) and not low <= dc <= high
        for unit, factor in [_likelier_unit(dc)]
    ]


def _likelier_unit(dc: float) -> tuple[str, float]:
    """Likely unit of the displacements, and the conversion factor from the unit stated in the file."""
    factors = [10.0**k for k in (-9, -6, -3, 3, 6, 9)]
    factor = min(factors, key=lambda one: abs(np.log(dc * one / 1e-5)))  # nearest to ten micrometres
    return f"a unit {1 / factor:g} times smaller" if factor < 1 else f"a unit {factor:g} times larger", factor


def conclusions(found: RecordFits) -> list[str]:
    """Return the conclusion: the law that the data prefer, or the sentence for a single fit."""
    return [found.comparison.sentence] if found.comparison is not None else [one.sentence for one in found.fits]


def _format_cells(value: float, low: float, high: float) -> tuple[str, str]:
    if not np.isfinite(value):
        return "unknown", "–"
    return f"{value:.5g}", f"{low:.5g} … {high:.5g}" if np.isfinite(low) else "–"


def write(out: Path, found: RecordFits) -> list[Path]:
    """Write the JSON file and the figure, and return their paths."""
    out.mkdir(parents=True, exist_ok=True)
    write_file(out, FIGURE, png(figures.fitted(found.data, found.fits)))
    write_file(out, NUMBERS, f"{as_json(found)}\n".encode())  # last, since it marks the fit as complete
    return [out / NUMBERS, out / FIGURE]
