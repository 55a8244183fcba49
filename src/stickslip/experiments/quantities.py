"""Tables of quantities: each quantity of a result is one row, with its name, unit, meaning and function.

The rows determine columns of files, measures with their intervals, terminal output, axis labels, tables in notebooks
and reference pages:

    LOOP = Quantities([
        Quantity("G", STRESS, "secant modulus between the turns", lambda loop: loop.tau_a / loop.gamma_a),
        Quantity("damping", "1", "damping ratio", label="$D$"),  # the attribute `damping` of a loop
    ])
    LOOP.write(path, loops)
"""

from collections.abc import Callable, Iterable, Mapping
from itertools import chain, repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy  # scipy.special is imported on first use, as this takes a tenth of a second

from ..core.readable import words
from ..core.tables import write_table
from ..core.units import heading, in_readable_units, meanings_of, unit_name, units_of

NAN = float("nan")
ERROR = "_error"  # ending of the name of the half-width of a 95 % interval


class Estimate(NamedTuple):
    """Mean of a number over samples, and half the width of its 95 % interval; NaN with fewer than two samples."""

    mean: float
    half_width: float
    scatter: float  # standard deviation between samples

    def __str__(self) -> str:
        spread = f" ± {self.half_width:.2g}" if np.isfinite(self.half_width) else ""
        return "–" if np.isnan(self.mean) else f"{self.mean:.4g}{spread}"


def estimate(values) -> Estimate:
    """Mean of independent values and half the width of its 95 % interval by Student's t; NaN if any value is NaN.

    Examples
    --------
    >>> str(estimate([1.0, 2.0, 3.0]))
    '2 ± 2.5'
    """
    values, n = np.asarray(values, float), len(values)
    if n < 2:
        return Estimate(float(values.mean()) if n else NAN, NAN, NAN)
    scatter = float(values.std(ddof=1))
    return Estimate(float(values.mean()), float(scipy.special.stdtrit(n - 1, 0.975)) * scatter / np.sqrt(n), scatter)


def median(values) -> float:
    """Median of the finite values; NaN if there are none."""
    good = [float(value) for value in values if np.isfinite(value)]
    return float(np.median(good)) if good else NAN


class Quantity(NamedTuple):
    """One quantity of a subject, such as the damping ratio of a cycle.

    Its value is a number, a string, or an array with an entry for each instant of a series. A dictionary {place: value}
    stands for values at several places, with names such as `damping@0.001`; None means that a subject does not have it.
    """

    name: str  # name of columns, measures and datasets
    unit: str  # dimensions such as "force/length^(dim-1)", or a unit; "1" for numbers and texts
    meaning: str  # description in a few words
    # function of the subject, or its attribute (by default `name`); "packed.pressure" is NaN if `packed` is None
    of: Callable[[Any], Any] | str = ""
    label: str = ""  # label of axes; by default, the name in words
    partial: bool = False  # True if means skip samples without this quantity; otherwise, they are NaN if one lacks it

    def at(self, subject) -> dict[str, Any]:
        """Values of a subject by name: one value, one for each condition such as a load, or none."""
        value = self.of(subject) if callable(self.of) else _attribute(subject, self.of or self.name)
        if isinstance(value, Mapping):
            return {f"{self.name}@{at if isinstance(at, str) else f'{at:g}'}": each for at, each in value.items()}
        return {} if value is None else {self.name: value}

    @property
    def axis(self) -> str | tuple[str, str]:
        """Words for `label_axes`, with the unit if there is one."""
        label = self.label or words(self.name)
        return label if self.unit == "1" else (label, self.unit)


def _attribute(value, path: str):
    for name in path.split("."):
        if value is None:
            return NAN
        value = getattr(value, name)
    return value


class Quantities(dict[str, Quantity]):
    """Table of the quantities of one kind of subject, by name and in the order of columns."""

    def __init__(self, rows: Iterable[Quantity]):
        rows = list(rows.values() if isinstance(rows, Mapping) else rows)
        super().__init__((row.name, row) for row in rows)
        if len(self) < len(rows):
            raise ValueError(f"two of these quantities have the same name: {', '.join(row.name for row in rows)}")

    def row(self, name: str) -> Quantity:
        """Quantity with a name, which may end in a place (`damping@0.001`) or in `_error`."""
        name = name if name in self else name.removesuffix(ERROR)
        return self[name.partition("@")[0]]

    def of(self, subject) -> dict[str, Any]:
        """Values of a subject by name."""
        return {name: value for row in self.values() for name, value in row.at(subject).items()}

    def columns(self, subjects: Iterable) -> dict[str, np.ndarray]:
        """Columns by name, with one row for each subject; NaN where a subject does not have a quantity."""
        rows = [self.of(subject) for subject in subjects]
        return {name: np.array([row.get(name, NAN) for row in rows]) for name in dict.fromkeys(chain(*rows))}

    def write(self, path: Path, subjects: Iterable, **options) -> None:
        """Write a CSV file with a row for each subject or each instant of its series; `options` as in `write_table`."""
        tables = [self.of(subject) for subject in subjects]
        names = [*dict.fromkeys(chain(*tables))] or [*self]
        headings = [heading(name, self.row(name).unit) for name in names]
        rows = (row for table in tables for row in _rows([table.get(name, NAN) for name in names]))
        write_table(path, headings, rows, **options)

    def show_rows(self, subjects: Iterable, *names: str, title: str | None = None) -> None:
        """Print a table with a row for each subject; by default, its columns are all quantities."""
        from ..reports.terminal import new_table, show_table

        columns = {name.replace("_", " "): self[name] for name in names or self}
        table = new_table(*columns, title=title, units={name: row.unit for name, row in columns.items()})
        for subject in subjects:
            table.add_row(*(_cell(row.at(subject).get(row.name, NAN)) for row in columns.values()))
        show_table(table)


def quantities_of(kind: type, *names: str, of: Callable[[str], Callable | str] = str, **labels: str) -> Quantities:
    """Fields of a NamedTuple, all or those named or labelled, with units and meanings from the comments on them.

    `of` returns `Quantity.of` for the name of a field: `"series.{}".format` for the field of an attribute `series`.
    """
    units, meanings, names = units_of(kind), meanings_of(kind), (*names, *labels) or kind._fields
    return Quantities(
        Quantity(name, units.get(name, "1"), meanings.get(name, ""), of(name), labels.get(name, "")) for name in names
    )


def _cell(value) -> str:
    if isinstance(value, float):
        return "–" if np.isnan(value) else f"{value:.4g}"
    return str(value)


def _rows(values: list) -> Iterable[tuple]:
    """Rows of one subject; single values are repeated in each row of its series."""
    if not any(np.ndim(value) for value in values):
        return [tuple(int(value) if isinstance(value, bool) else value for value in values)]
    (length,) = {len(value) for value in values if np.ndim(value)}
    return zip(*(np.asarray(v, float).tolist() if np.ndim(v) else repeat(v, length) for v in values), strict=True)


class Measures(Quantities):
    """Quantities that a run provides for sweeps and datasets: the function `measures` of an experiment.

    Parameters
    ----------
    rows : quantities of a result, of its `subject`, or of one of its samples
    subject : function of the result that returns the object with the quantities
    samples : function of the result that returns its samples
    over : function of the values of all samples, such as `estimate`, `median` or `np.mean`; without `samples`, of the
    values of each quantity
    """

    def __init__(
        self, rows: Iterable[Quantity], *, subject: Callable = lambda result: result, samples: Callable | None = None,
        over: Callable | None = None,
    ):  # fmt: skip
        super().__init__(rows)
        self.subject, self.samples, self.over = subject, samples, over

    def of(self, result) -> dict[str, float | Estimate]:
        """Values of a result by name."""
        if self.samples:
            values = {name: column.tolist() for name, column in Quantities(self).columns(self.samples(result)).items()}
        else:
            values = super().of(self.subject(result))
        if not self.over:
            return values
        reduced = {}
        for name, value in values.items():
            finite = [one for one in value if np.isfinite(one)] if self.row(name).partial else value
            reduced[name] = self.over(finite if len(finite) else value)
        return reduced

    def __call__(self, result) -> dict[str, tuple[float, str]]:
        """Return {name: (value, unit)}; estimates also have `name_error`, half the width of their 95 % interval."""
        out = {}
        for name, value in self.of(result).items():
            unit, known = self.row(name).unit, isinstance(value, Estimate)
            out[name] = (value.mean if known else value, unit)
            out |= {f"{name}{ERROR}": (value.half_width, unit)} if known else {}
        return out

    def finite_values(self, result) -> dict[str, Any]:
        """Finite values of a result by name."""
        values = self.of(result)
        return {k: v for k, v in values.items() if np.isfinite(v.mean if isinstance(v, Estimate) else v)}

    def show(self, result, *, title: str, readable: Callable = in_readable_units, without=()) -> None:
        """Print the finite values with their intervals, units and meanings.

        Parameters
        ----------
        readable : function of values and their unit that returns them in a readable unit
        without : names that are left out
        """
        from ..reports.terminal import new_table, show_table

        table = new_table("", "mean", "95 % ±", "unit", "", title=title, left=("", "unit"))
        for name, value in self.finite_values(result).items():
            if name in without:
                continue
            pair = value[:2] if isinstance(value, Estimate) else (value, NAN)
            (mean, half), unit = readable(np.array(pair), unit_name(self.row(name).unit))
            width = f"{half:.2g}" if np.isfinite(half) else "–"
            table.add_row(name, f"{mean:.4g}", width, "" if unit == "1" else unit, self.row(name).meaning)
        show_table(table)
