"""Laboratory tables as stored in files: text with any header, HDF5, MATLAB, binary XLOOK."""

import csv
import re
import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..core.readable import pluralize
from ..core.reading import Budget, check_matlab, read_bytes
from ..core.tables import marks_of_groups, split_rows
from ..core.text import decode_text, parse_number

HDF5, MATLAB = b"\x89HDF\r\n\x1a\n", b"MATLAB 5.0 MAT-file"
SPREADSHEETS = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"  # first bytes of zip archives (XLSX and ODS), and of old XLS files
REMEDY = "give a text table, or an HDF5, MATLAB or binary XLOOK file"
TITLE = struct.Struct(">20s4i")  # header of XLOOK: name, samples, columns, two unused
CHANNEL = struct.Struct(">13s13si50si")  # name, unit, unused, comment, samples
CHANNELS = (32, 16)  # number of channels in the header of current and of old files
USUAL = 1e-20, 1e20  # magnitudes of plausible numbers, which identify the byte order
MARKS = (";", "\t", ",", None)  # None: white space; commas come late, as they may be decimal commas
COUNTS = re.compile(r"(\s*\d+\s*recs?\b)+\s*")  # numbers of records that XLOOK writes below the units
COMMENTS = "#%"
COMMENT = re.compile(r"\s*(#|%(?!\s*[;,\t]))")  # "%;kPa" is a row of units
LEAST = 3  # smallest number of consecutive integers for which a first column counts as row numbers


class Sheet(NamedTuple):
    """Columns of a table as stored, with K headings."""

    headings: list[str]  # (K,), empty where a column has none
    units: list[str | None]  # (K,) units from a row of units or an attribute
    rows: list[tuple[int, list[str]]] | None = None  # for text: number of each line and its K fields
    values: list[np.ndarray] | None = None  # (K,) for files of arrays: values of the columns


def read_sheet(path: Path, known: Callable[[str], bool], *, named: bool, example: str, remedy: str = "") -> Sheet:
    """Columns of a file; its format is detected from its content.

    Parameters
    ----------
    known : function that returns True for a wanted heading; it is used to find the row of headings
    named : whether the user gave column numbers, so headings are not needed
    example : example of headings, for messages
    remedy : advice for a table without headings, besides adding them

    Raises
    ------
    ValueError
        If the file cannot be used.
    """
    try:
        content = read_bytes(path, remedy=REMEDY)
    except OSError as problem:
        raise ValueError(f"{path} cannot be read: {(problem.strerror or str(problem)).lower()}") from None
    if content.startswith(SPREADSHEETS):
        raise ValueError(f"{path} is a spreadsheet: save its sheet as CSV, with one row of headings above the numbers")
    if HDF5 in (content[:8], content[512:520]):
        return _array_sheet(path, _hdf5_arrays(path, content), known)
    if content.startswith(MATLAB):
        return _array_sheet(path, _matlab_arrays(path, content), known)
    if (sheet := _look_sheet(path, content)) is not None:
        return sheet
    text = decode_text(content, path, remedy=REMEDY, fallback="cp1252")
    return _text_sheet(path, text, known, named, example, remedy)


def _text_sheet(
    path: Path, text: str, known: Callable[[str], bool], named: bool, example: str, remedy: str
) -> Sheet:  # fmt: skip
    """Parse a text table: a header line, optionally a line of units, and rows of numbers."""
    lines = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip()]
    body = [(k, line) for k, line in lines if not COMMENT.match(line)]
    first, mark = _find_numbers(body)
    if first is None:
        seen = f": it has no numbers below {body[0][1].strip()[:60]!r}" if body else ""
        raise ValueError(f"{path} contains no data{seen}; give a header such as '{example}', and rows of numbers")
    rows = split_rows(path, body[first:], mark)
    width = len(rows[0][1])
    above = [line for _, line in body[:first]]
    above = above or [line.lstrip(COMMENTS + " ") for k, line in lines if k < body[0][0]]  # as numpy.savetxt does
    titles = [_fit_width(_split_titles(line, mark, width), rows) for line in above]
    index = max(range(len(titles)), key=lambda k: (sum(map(known, titles[k])), k), default=None)
    if index is None or not any(map(known, titles[index])):
        titles = [title for title in titles if len(title) == width]
        if named or titles:
            return Sheet(titles[-1] if titles else [""] * width, [None] * width, rows=rows)
        raise ValueError(f"{path} has no row of headings above its numbers: add one, such as '{example}'{remedy}")
    if any(line.count('"') % 2 for line in above[index:]):
        raise ValueError(f"{path} has a quotation mark that is not closed on the same line: remove it")
    headings, below = titles[index], [line for line in above[index + 1 :] if not COUNTS.fullmatch(line)]
    units = _fit_width(_split_titles(below[0], mark, width), rows) if below else []
    for number, row in rows:
        if len(row) != len(headings):
            raise ValueError(
                f"{path}, line {number}, has {pluralize(len(row), 'field')}, but the header has {len(headings)}: "
                "correct the line, or separate columns by semicolons if numbers have decimal commas"
            )
    given = [unit.strip("[]() ") or None for unit in units]
    return Sheet(headings, given if len(given) == width else [None] * width, rows=rows)


def _find_numbers(body: list[tuple[int, str]]) -> tuple[int | None, str | None]:
    """Index of the first line that consists mostly of numbers, and their separator."""
    for k, (_, line) in enumerate(body):
        for mark in MARKS:
            fields = line.rstrip(mark).split(mark)
            count = sum(_is_number(field.strip().strip('"')) for field in fields)
            if len(fields) > 1 and 2 * count > len(fields):
                return k, mark
    return None, None


def _is_number(field: str) -> bool:
    if marks_of_groups(field):
        return True
    try:
        parse_number(field.replace(",", ".", 1))
    except ValueError:
        return False
    return True


def _split_titles(line: str, mark: str | None, width: int) -> list[str]:
    """Headings in a line; if they are separated by blanks, a unit in brackets belongs to the preceding word."""
    if mark is not None:
        try:
            return [title.strip() for title in next(csv.reader([line], delimiter=mark, skipinitialspace=True))]
        except csv.Error:  # such as a quotation that is not closed
            return []
    apart = [title for title in re.split(r"\s{2,}|\t", line.strip()) if title]
    return apart if len(apart) == width else re.split(r"\s+(?![\[(])", line.strip())


def _fit_width(titles: list[str], rows: list[tuple[int, list[str]]]) -> list[str]:
    """Headings of all columns. A first column that numbers the rows, or an empty last column, may lack a heading."""
    if len(titles) == len(rows[0][1]) - 1 and not any(row[-1] for _, row in rows):
        return [*titles, ""]
    numbers = [row[0] for _, row in rows[:LEAST]]
    if len(titles) != len(rows[0][1]) - 1 or len(rows) < LEAST or not all(map(str.isdecimal, numbers)):
        return titles
    if not any("." in field for _, row in rows[:LEAST] for field in row):  # commas may be decimal commas
        return titles
    return ["", *titles] if len(set(np.diff([int(number) for number in numbers]))) == 1 else titles


def _hdf5_arrays(path: Path, content: bytes) -> dict[str, tuple[np.ndarray, str | None]]:
    """Arrays of an HDF5 file or a MATLAB 7.3 file, with their units; each field of a compound table is an array."""
    import h5py

    arrays: dict[str, tuple[np.ndarray, str | None]] = {}
    budget = Budget(path, len(content), remedy="copy it again")

    def collect(name: str, item) -> None:
        if not isinstance(item, h5py.Dataset) or not item.shape or name.startswith("#"):
            return
        budget.take(item.nbytes, name)
        unit = next((item.attrs[key] for key in ("units", "unit") if key in item.attrs), None)
        unit = unit.flat[0] if isinstance(unit, np.ndarray) and unit.size == 1 else unit
        unit = unit.decode() if isinstance(unit, bytes) else unit if isinstance(unit, str) else None
        if item.dtype.names:
            arrays.update({f"{name}/{field}": (item[field], None) for field in item.dtype.names})
        elif item.dtype.kind in "iuf":
            arrays[name] = (item[()], unit)

    try:
        with h5py.File(BytesIO(content)) as file:
            file.visititems(collect)
    except (OSError, RuntimeError, ValueError, KeyError) as problem:
        raise ValueError(
            f"{path} is a damaged HDF5 file ({str(problem).splitlines()[0][:80]}): copy it again"
        ) from None
    return arrays


def _matlab_arrays(path: Path, content: bytes) -> dict[str, tuple[np.ndarray, str | None]]:
    """Arrays of a MATLAB file up to version 7, including those in a structure."""
    from scipy.io import loadmat

    try:
        check_matlab(content, Budget(path, len(content), remedy="save it again"))
        variables = loadmat(BytesIO(content), squeeze_me=True, struct_as_record=True)
    except Exception as problem:
        said = (str(problem) or type(problem).__name__).splitlines()[0][:80]
        raise ValueError(f"{path} is a damaged MATLAB file ({said}): save it again") from None
    arrays: dict[str, tuple[np.ndarray, str | None]] = {}
    for name, value in variables.items():
        parts = getattr(getattr(value, "dtype", None), "names", None)
        single = parts and value.size == 1
        fields = {f"{name}/{part}": value[part].item() for part in parts} if single else {name: value}
        arrays.update({key: (np.asarray(array), None) for key, array in fields.items()})
    return {name: (array, unit) for name, (array, unit) in arrays.items() if array.dtype.kind in "iuf"}


def _look_sheet(path: Path, content: bytes) -> Sheet | None:
    """Sheet of a binary XLOOK file; None if the file is not one.

    A header of 16 or 32 channels, whose integers are big-endian, is followed by the columns, one after the other, as
    floating-point numbers of 4 or 8 bytes in the byte order of the machine that wrote them. The file states neither:
    the size of numbers follows from the length of the file, and the byte order from the magnitudes of the numbers.

    Source
    ------
    Header layout as read by pylook (Leeman Geophysical), checked against XLOOK's example files.
    """
    if len(content) < TITLE.size + CHANNELS[-1] * CHANNEL.size:
        return None
    _, samples, count, _, _ = TITLE.unpack_from(content)
    if not (0 < count <= CHANNELS[0] and 0 < samples < len(content)):
        return None
    for channels in CHANNELS:
        start = TITLE.size + channels * CHANNEL.size
        if len(content) < start:
            continue
        every = [CHANNEL.unpack_from(content, TITLE.size + k * CHANNEL.size) for k in range(channels)]
        words = [[part.partition(b"\0")[0].decode("cp1252", "replace").strip() for part in each[:2]] for each in every]
        used = [(name, unit, each[-1]) for (name, unit), each in zip(words, every, strict=True) if name[:6] != "no_val"]
        total = sum(length for *_, length in used)
        kind = {start + 4 * total: "f4", start + 8 * total: "f8"}.get(len(content))
        if len(used) == count and kind and total > 0:
            break
    else:
        raise ValueError(
            f"{path} is a damaged XLOOK file: its length does not match its {count} columns; copy it again"
        )
    _check_lengths(path, [(name, length) for name, _, length in used])

    def usual(values: np.ndarray) -> float:
        size = np.abs(values)
        return float(((size == 0) | (size > USUAL[0]) & (size < USUAL[1])).mean())

    with np.errstate(invalid="ignore", over="ignore"):  # NaN in the other byte order
        values = max((np.frombuffer(content, order + kind, total, start) for order in "<>"), key=usual).astype(float)
    names, units, _ = zip(*used, strict=True)
    return Sheet(list(names), [unit.strip("[]() ") or None for unit in units], values=np.split(values, count))


def _array_sheet(path: Path, arrays: dict[str, tuple[np.ndarray, str | None]], known: Callable[[str], bool]) -> Sheet:
    """Sheet of the columns found among the arrays of a file, which may be in groups or in a single matrix."""
    columns = {
        name: (array.ravel(), unit) for name, (array, unit) in arrays.items() if 1 < array.size == max(array.shape)
    }
    matrices = [array for array, _ in arrays.values() if array.ndim == 2 and min(array.shape) > 1]
    if len(matrices) == 1 and not any(known(name.rpartition("/")[2]) for name in columns):
        matrix = matrices[0] if matrices[0].shape[0] > matrices[0].shape[1] else matrices[0].T
        return Sheet([""] * matrix.shape[1], [None] * matrix.shape[1], values=list(matrix.T))
    groups = {name.rpartition("/")[0] for name in columns if known(name.rpartition("/")[2])}
    if len(groups) > 1:
        raise ValueError(f"{path} has records in {len(groups)} groups ({', '.join(sorted(groups)[:5])}): keep only one")
    group = next(iter(groups), "")
    columns = {name.rpartition("/")[2]: value for name, value in columns.items() if name.rpartition("/")[0] == group}
    lengths = [(name, len(array)) for name, (array, _) in columns.items() if known(name)]
    _check_lengths(path, lengths)
    columns = {name: value for name, value in columns.items() if not lengths or len(value[0]) == lengths[0][1]}
    units = [unit for _, unit in columns.values()]
    return Sheet(list(columns), units, values=[array.astype(float) for array, _ in columns.values()])


def _check_lengths(path: Path, lengths: list[tuple[str, int]]) -> None:
    """Raise ValueError if columns, given with their lengths, do not have the same length."""
    if len({length for _, length in lengths}) > 1:
        told = ", ".join(f"{name} {length}" for name, length in lengths[:5])
        raise ValueError(
            f"{path} has columns of different lengths ({told}): every column needs one value for each sample"
        )
