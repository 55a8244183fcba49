"""Laboratory tests for comparison with element tests, converted to the units, strains and signs of series."""

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from ....kit import Comparison, checked, estimate, laboratory_table, pluralize
from . import figures as figures_of
from .report import drawn, for_engineers
from .scenario import ElementTestScenario
from .simulate import ElementRun, ElementSeries, SmallStrain

WANTED = laboratory_table.Wanted(
    ("axial_strain", "log_axial_strain", "volumetric_strain", "log_volumetric_strain", "q", "axial_stress",
     "total_axial_stress", "cell_pressure", "effective_radial_stress", "p", "pore_pressure", "u",
     "excess_pore_pressure", "void_ratio"),
    "axial strain [%], q [kPa], volumetric strain [%]", "column of a test of soil",
)  # fmt: skip
FIGURE = "fig8_laboratory.png"
LEAST = 5  # smallest number of rows
NEAR_START = 0.02  # ratio of last to first axial strain below which rows are in reverse order
WORDS = {
    "q": "deviatoric stress", "volumetric_strain": "volumetric strain", "pore_pressure": "excess pore pressure",
    "sigma_zz": "axial stress",
}  # fmt: skip
CLOSE = 0.1  # largest relative deviation between quantities that follow from each other


@checked
def read_test(path: str | Path) -> dict[str, np.ndarray]:
    """Read a laboratory soil test from a table, as columns of `series.csv` in pascals, compression positive.

    Columns are recognised by usual names, such as `Axial strain (%)`, `σ1 − σ3 [kPa]`, `εv`, `u`, `e` or `p'`. Units
    may be in brackets, after the name or in a row below, and numbers may have decimal commas, as in
    `friction.read_record`. Strains are assumed to be nominal (change over initial size) unless they are named
    logarithmic, and are converted to logarithmic strains. A warning lists unknown columns and assumptions.

    Returns
    -------
    dict of arrays (T,): axial_strain and volumetric_strain [1], q, p, axial_stress and pore_pressure (in excess of that
    at the start) [Pa], and void_ratio [1], as far as the table contains them

    Raises
    ------
    ValueError
        If a unit is missing or unknown, or if columns contradict each other.
    """
    path = Path(path)
    table = laboratory_table.open_table(path, WANTED)
    if not table.places:
        seen = table.list_columns() or "without headings"
        raise ValueError(f"{path} has no soil-test columns: its columns are {seen}; name some as in '{WANTED.example}'")
    if told := table.list_unknown():
        warnings.warn(f"{path}: unknown columns, not drawn: {told}", stacklevel=2)
    values = table.numbers()
    if len(next(iter(values.values()))) < LEAST:
        raise ValueError(
            f"{path} has {pluralize(len(next(iter(values.values()))), 'row')} of numbers: give at least {LEAST}"
        )
    _check_strains(table, values)
    axial = np.abs(next((values[name] for name in WANTED.columns[:2] if name in values), np.zeros(1)))
    if axial[-1] < NEAR_START * axial[0] and not axial[0] < axial.max():
        warnings.warn(f"{path}: rows begin with the largest axial strain: their order was reversed", stacklevel=2)
        values = {name: column[::-1] for name, column in values.items()}
    out = {name: values[name] for name in ("q", "p", "axial_stress", "void_ratio") if name in values}
    for name in ("axial_strain", "volumetric_strain"):
        if f"log_{name}" in values:
            out[name] = values[f"log_{name}"]
        elif name in values:
            out[name] = -np.log1p(-values[name])
    total = next((values[name] for name in ("pore_pressure", "u") if name in values), None)
    if "excess_pore_pressure" in values:
        out["pore_pressure"] = values["excess_pore_pressure"]
    elif total is not None:
        out["pore_pressure"] = total - total[0]
    _add_stresses(table, values, out)
    _turn_signs(path, out)
    if "void_ratio" in out:
        e = out["void_ratio"]
        out.setdefault("volumetric_strain", -np.log((1 + e) / (1 + e[0])))
    _check_stresses(path, out)
    return out


def _check_strains(table: laboratory_table.LaboratoryTable, values: dict[str, np.ndarray]) -> None:
    """Raise ValueError for strains that no sample can have, such as values in per cent without a unit."""
    for name in WANTED.columns[:4]:
        if name in values and not (largest := float(np.abs(values[name]).max())) < 1:
            raise ValueError(
                f"{table.path}: {table.heading_of(name)!r} reaches {largest:.3g} times the size of the sample: write "
                f"it as '{name.replace('_', ' ')} [%]' if it is in per cent, or correct its unit"
            )
    bare = [name for name in WANTED.columns[:4] if name in values and not table.has_unit(name)]
    if bare and "sample" not in table.headings:  # series.csv of a run, whose strains are fractions
        told = ", ".join(f"{table.heading_of(name)!r} up to {np.abs(values[name]).max():.3g}" for name in bare)
        warnings.warn(
            f"{table.path}: strains without a unit are read as fractions, {told}: add [%] to the headings if they are "
            f"in per cent", stacklevel=3,
        )  # fmt: skip


def _add_stresses(table: laboratory_table.LaboratoryTable, values: dict[str, np.ndarray], out: dict) -> None:
    """Add q, p and the effective axial stress where they follow from other stresses, or check them.

    With a pore pressure, an axial stress is total unless its heading has a prime or the word "effective".
    """
    path, total = table.path, values.get("total_axial_stress")
    pressure = next((values[name] for name in ("pore_pressure", "u") if name in values), None)
    if (lateral := values.get("effective_radial_stress")) is not None:
        if "axial_stress" in values and (pressure is None or _is_effective(table)):
            out.setdefault("q", values["axial_stress"] - lateral)
        if "q" in out:
            out.setdefault("p", lateral + out["q"] / 3)
    if total is None and "axial_stress" in values:
        total, heading = values["axial_stress"], table.heading_of("axial_stress")
        if pressure is not None and _is_effective(table):
            total = total + pressure
        elif pressure is not None:
            warnings.warn(f"{path}: {heading!r} is treated as a total stress: name it effective if it is", stacklevel=3)
            out["axial_stress"] = total - pressure
    elif total is not None and pressure is not None:
        out.setdefault("axial_stress", total - pressure)
    if total is not None and "cell_pressure" in values and not {"pore_pressure", "q"} <= set(out):
        difference = total - values["cell_pressure"]
        q = out.setdefault("q", difference)
        if np.abs(q - difference).max() > CLOSE * np.abs(q).max():
            raise ValueError(
                f"{path}: q reaches {_kpa(q)}, but the axial stress minus the cell pressure reaches "
                f"{_kpa(difference)}: correct the wrong column or unit"
            )
    if "cell_pressure" in values and not {"p", "q", "axial_stress", "pore_pressure"} & set(out):
        out["p"] = values["cell_pressure"]
    if "p" not in out and {"q", "cell_pressure"} <= {*out, *values} and pressure is not None:
        out["p"] = out["q"] / 3 + values["cell_pressure"] - pressure


def _is_effective(table: laboratory_table.LaboratoryTable) -> bool:
    """Return True if the heading of the axial stress has a prime or the word "effective"."""
    word = laboratory_table.plain_word(table.heading_of("axial_stress"))
    return "'" in word or "eff" in word


def _turn_signs(path: Path, out: dict[str, np.ndarray]) -> None:
    """Make compression positive, with a warning if signs change."""
    axial, q = out.get("axial_strain"), out.get("q")
    if axial is not None and q is not None and (axial[np.abs(axial).argmax()] * q[np.abs(q).argmax()]) < 0:
        warnings.warn(f"{path}: strains and q have opposite signs: the signs of strains were reversed", stacklevel=3)
        for name in ("axial_strain", "volumetric_strain"):
            if name in out:
                out[name] = -out[name]
    if {"void_ratio", "volumetric_strain"} <= set(out):
        strain, e = out["volumetric_strain"], out["void_ratio"]
        expected = -np.log((1 + e) / (1 + e[0]))
        ratio = float(strain @ expected) / max(float(expected @ expected), 1e-300)
        if ratio < 0:
            warnings.warn(
                f"{path}: the void ratio shows that dilation is positive in the volumetric strain: its sign was "
                "reversed", stacklevel=3,
            )  # fmt: skip
            out["volumetric_strain"] = -strain
        if not 0.5 < abs(ratio) < 2:
            raise ValueError(
                f"{path}: the volumetric strain is {abs(ratio):.3g} times that implied by the void ratio: correct the "
                f"wrong unit"
            )


def _check_stresses(path: Path, out: dict[str, np.ndarray]) -> None:
    """Raise ValueError if q and p require tension between grains, as with a wrong unit, or q changes without strain."""
    if {"p", "q"} <= set(out):
        share = out["q"] / np.where(out["q"] < 0, -1.5, 3.0)  # least p: σ₃ is zero
        k = int((share - out["p"]).argmax())
        if share[k] > (1 + CLOSE) * max(out["p"][k], 0.0):
            times = "1.5" if out["q"][k] < 0 else "three"
            raise ValueError(
                f"{path}: q is {_kpa(out['q'][k])} where p' is {_kpa(out['p'][k])}, more than {times} times as large, "
                f"which grains without cohesion cannot support: correct the wrong unit"
            )
    if "axial_strain" in out and not np.ptp(out["axial_strain"]) > 0 and np.ptp(out.get("q", 0.0)) > 0:
        raise ValueError(f"{path}: the axial strain is constant in all rows while q changes: give the measured strain")


def _kpa(values) -> str:
    return f"{1e-3 * np.ravel(values)[np.abs(np.ravel(values)).argmax()]:.4g} kPa"


def overlay(scenario: ElementTestScenario, path: Path) -> Callable[[dict], Comparison]:
    """Read a laboratory test; return a function that draws it over the figure of a run, given the run's archive.

    Raises
    ------
    ValueError
        If the table cannot be read or lacks the quantities of this kind of test.
    """
    kind = scenario.path.kind
    if scenario.sample.dim == 2 or scenario.units != "SI" or kind == "simple-shear":
        what = "disks" if scenario.sample.dim == 2 else "simple shear" if kind == "simple-shear" else "these units"
        raise ValueError(f"--compare does not apply to {what}: it needs tests of spheres along an axis, in SI units")
    test = read_test(path)
    known = {"sigma_zz" if name == "axial_stress" else name for name in test}
    pairs = [pair for pair in pairs_of(kind) if set(pair) <= known]
    if not pairs:
        wanted = " or ".join(f"{y} with {x}" for x, y in pairs_of(kind))
        raise ValueError(f"{path} has columns for {', '.join(test)}, but a {kind} test shows {wanted}: add columns")
    if kind not in ("isotropic", "oedometric") and len(scenario.path.turns) == 1 and "axial_strain" in test:
        ways = [np.sign(scenario.path.turns[0]), np.sign(test["axial_strain"][np.abs(test["axial_strain"]).argmax()])]
        if ways[0] * ways[1] < 0:
            ours, theirs = ("in extension" if way < 0 else "in compression" for way in ways)
            raise ValueError(f"{path} is a test {theirs}, but path.strain is {ours}: give path.strain the other sign")
    confining = scenario.confining
    if "p" in test and abs(test["p"][0] - confining) > CLOSE * (confining or test["p"].max()):
        warnings.warn(
            f"{path}: the test begins at p' = {_kpa(test['p'][0])}, the samples at {_kpa(confining)}", stacklevel=2
        )
    return partial(_compared, scenario, Path(path).stem, test, pairs)


def pairs_of(kind: str) -> list[tuple[str, str]]:
    """Return the columns along x and y of each panel for a kind of test."""
    if kind == "isotropic":
        return [("p", "void_ratio"), ("p", "volumetric_strain")]
    if kind == "oedometric":
        return [("sigma_zz", "void_ratio"), ("axial_strain", "sigma_zz")]
    drained = "pore_pressure" if kind == "undrained" else "volumetric_strain"
    last = ("p", "q") if kind == "undrained" else ("p", "void_ratio")
    return [("axial_strain", "q"), ("axial_strain", drained), last]


def _compared(
    scenario: ElementTestScenario, name: str, test: dict[str, np.ndarray], pairs: list[tuple[str, str]], tree: dict
) -> Comparison:
    """Return a figure and sentences that compare a run, read from its archive, with a laboratory test."""
    runs = [
        ElementRun(int(seed), None, SmallStrain(**sample["elastic"]), ElementSeries(**sample["series"]), None, "")
        for seed, sample in tree["samples"].items() if seed != "halved"
    ]  # fmt: skip
    tables = [drawn(run, scenario) for run in runs]
    unit = for_engineers(0, "Pa")[1]
    theirs = {}
    for key, values in test.items():
        signed = values if key in ("pore_pressure", "void_ratio") else scenario.sign * values
        plain = key.endswith("strain") or key == "void_ratio"
        theirs["sigma_zz" if key == "axial_stress" else key] = signed if plain else for_engineers(signed, "Pa")[0]
    figure = figures_of.laboratory(tables, theirs, pairs, unit, name)
    return Comparison({FIGURE: figure}, tuple(_differences(tables, theirs, pairs, unit, name)))


def _differences(tables: list[dict], test: dict, pairs: list[tuple[str, str]], unit: str, name: str):
    """Sentences on the largest q, and on the difference between the curves against axial strain."""
    for x, y in pairs:
        if x != "axial_strain":
            continue
        label, words = WORDS[y], "" if y == "volumetric_strain" else f" {unit}"
        ours = [table[y][np.abs(table[y]).argmax()] for table in tables]
        at = [table[x][np.abs(table[y]).argmax()] for table in tables]
        top = int(np.abs(test[y]).argmax())
        yield (
            f"Largest {label}: {test[y][top]:.3g}{words} at an axial strain of {test[x][top]:.3g} in {name}, and "
            f"{estimate(ours)}{words} at {np.mean(at):.3g} in the samples."
        )
        reach = min(np.abs(test[x]).max(), *(np.abs(table[x]).max() for table in tables))
        grid = np.linspace(0, 1, 101) * reach * np.sign(test[x][np.abs(test[x]).argmax()])
        curves = []  # the first branch of each curve
        for table in (test, *tables):
            end = int(np.abs(table[x]).argmax()) + 1
            sign = np.sign(table[x][end - 1])
            order = np.argsort(sign * table[x][:end], kind="stable")
            curves.append(np.interp(sign * grid, sign * table[x][:end][order], table[y][:end][order]))
        off = float(np.sqrt(np.mean((np.mean(curves[1:], axis=0) - curves[0]) ** 2)))
        yield (
            f"Up to a strain of {reach:.3g}, the mean of the samples differs by {off:.3g}{words} rms from the {label} "
            f"of {name}."
        )
