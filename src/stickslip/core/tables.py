"""Tables in CSV files: comment lines after #, a row of headings such as `time [s]`, and rows of numbers and words."""

import csv
import io
import re
from collections.abc import Iterable
from pathlib import Path

from .text import read_text

_DECIMAL_COMMA = re.compile(r"^([+-]?\d*),(\d+(?:[eE][+-]?\d+)?)$")
_DECIMAL_POINT = re.compile(r"^[+-]?\d*\.\d+(?:[eE][+-]?\d+)?$")
_GROUPED = {  # numbers with separators between groups of three digits
    marks: re.compile(rf"([+-]?\d{{1,3}}(?:[{marks}]\d{{3}})+)([{decimal}]\d+)?$")
    for marks, decimal in ((",", "."), (".", ","), (" '’\u00a0\u2009\u202f", ".,"))
}
_THOUSANDS = re.compile(r"^[+-]?[1-9]\d{0,2}[.,]\d{3}$")


def heading_of(name: str, unit: str) -> str:
    """Heading of a column in a file, such as `time [s]`; the unit of dimensionless numbers is `-`."""
    return f"{name} [{'-' if unit == '1' else unit}]"


def split_label(heading: str) -> tuple[str, str | None]:
    """Name and unit of a heading such as `dc [m]` or `dc (m)`; None without a unit."""
    name, bracket, unit = heading.replace("(", "[").partition("[")
    return name.strip(), unit.rstrip("]) ").strip() if bracket else None


def format_table(
    headings: Iterable[str], rows: Iterable[Iterable], *, digits: int | None = 9, comments: Iterable[str] = ()
) -> str:
    """CSV text from rows of numbers and words; None is an empty cell.

    Parameters
    ----------
    digits : significant digits of floating-point numbers; None: as many as they need
    """
    text, form = io.StringIO(), str if digits is None else f"{{:.{digits}g}}".format
    text.writelines(f"# {line}\n" for line in comments)
    sheet = csv.writer(text, lineterminator="\n")
    sheet.writerow(headings)
    sheet.writerows([form(x) if isinstance(x, float) else x for x in row] for row in rows)
    return text.getvalue()


def write_table(path: Path, headings: Iterable[str], rows: Iterable[Iterable], **options) -> None:
    """Write a table; see `format_table`."""
    path.write_text(format_table(headings, rows, **options), encoding="utf-8")


def read_table(path: str | Path, *, remedy: str = "give a CSV file") -> list[tuple[int, list[str]]]:
    """Line number and fields of every row of a table, the row of headings first.

    Separators are commas, semicolons or tabs; numbers may have decimal commas. Lines that start with # are comments.
    Files that are not UTF-8 are read as Windows-1252.

    Raises
    ------
    ValueError
        If the file is not a table; the message names the line.
    """
    try:
        text = read_text(path, remedy=remedy, fallback="cp1252")
    except OSError as problem:
        raise ValueError(f"{path} cannot be read: {(problem.strerror or str(problem)).lower()}") from None
    lines = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip() and line.lstrip()[0] != "#"]
    if not lines:
        raise ValueError(
            f"{path} contains no data: give a header such as 'time [s], load_point [um], friction [-]' and rows"
        )
    mark = next((mark for mark in ";\t" if mark in lines[0][1]), ",")  # commas may be decimal commas
    rows = split_rows(path, lines, mark)
    for number, row in rows:
        if len(row) != len(rows[0][1]):
            raise ValueError(
                f"{path}, line {number}, has {len(row)} fields but the header has {len(rows[0][1])}: correct the line"
            )
    return rows


def split_rows(path: str | Path, lines: list[tuple[int, str]], mark: str | None) -> list[tuple[int, list[str]]]:
    """Number and fields of each numbered line, with fields separated by `mark`, or by white space if it is None.

    Decimal commas, which are in quotation marks if commas separate the fields, become points, and thousands separators
    are removed. Files with both points and commas are rejected if either may separate thousands in all numbers.
    """
    if mark is None:
        split = [line.split() for _, line in lines]
    else:
        rows = csv.reader((line for _, line in lines), delimiter=mark, skipinitialspace=True)
        try:
            split = [[field.strip() for field in row] for row in rows]
        except csv.Error as problem:
            raise ValueError(f"{path}, line {lines[rows.line_num - 1][0]}, cannot be read ({problem})") from None
        if len(split) != len(lines):
            raise ValueError(f"{path} has a quotation mark that is not closed on the same line: remove it")
    for marks in {mark for row in split for field in row if (mark := marks_of_groups(field))}:
        split = [[_without_groups(field, marks) for field in row] for row in split]
    _check_decimals(path, [(number, field) for (number, _), row in zip(lines, split, strict=True) for field in row])
    split = [[_DECIMAL_COMMA.sub(r"\1.\2", field) for field in row] for row in split]
    return [(number, row) for (number, _), row in zip(lines, split, strict=True)]


def marks_of_groups(field: str) -> str:
    """Thousands separators in a number, if they cannot be decimal marks; empty otherwise."""
    for marks, form in _GROUPED.items():
        if (number := form.match(field)) and (number[2] or marks not in ",." or number[1].count(marks) > 1):
            return marks
    return ""


def _without_groups(field: str, marks: str) -> str:
    """Number without thousands separators; other fields are unchanged."""
    number = _GROUPED[marks].match(field)
    return re.sub(f"[{marks}]", "", number[1]) + (number[2] or "") if number else field


def _check_decimals(path: str | Path, fields: list[tuple[int, str]]) -> None:
    """Raise ValueError if numbers have commas and points, one of which may separate thousands throughout."""
    commas = [field for field in fields if _DECIMAL_COMMA.match(field[1])]
    points = [field for field in fields if commas and _DECIMAL_POINT.match(field[1])]
    if points and any(all(_THOUSANDS.match(number) for _, number in marked) for marked in (commas, points)):
        raise ValueError(
            f"{path} has numbers with points and commas ({points[0][1]!r} in line {points[0][0]}, {commas[0][1]!r} in "
            f"line {commas[0][0]}), one of which may separate thousands: write all numbers with decimal points"
        )
