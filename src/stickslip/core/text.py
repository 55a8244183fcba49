"""Text written by users: files in UTF-8, with or without a byte order mark, and the numbers and tables in them.

Tables are CSV files: lines of comments after #, one row of headings such as `time [s]`, rows of numbers and words.
"""

import codecs
import csv
import io
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from .reading import read_bytes

LONGEST = 1000  # of a message [characters]
_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_BE)  # UTF-32-LE's starts with the first
_SAMPLE_BYTES = 64  # bytes examined to detect text with two bytes per letter
# all but tabs and line feeds, and marks that turn the direction of writing
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
_MAX_DIGITS = 40  # of a whole number in a file; valid ones have at most twenty


def read_text(path: str | Path, *, remedy: str, fallback: str | None = None) -> str:
    r"""Read a text file, with line endings converted to \n.

    Parameters
    ----------
    remedy : what to do if the file is not text, for the error message
    fallback : encoding of files that are not UTF-8, such as "cp1252"; by default they are rejected

    Raises
    ------
    ValueError
        with a one-sentence message, if it is not a regular file of UTF-8 text.
    OSError
        if the file cannot be read.
    """
    return decode_text(read_bytes(path, remedy=remedy), path, remedy=remedy, fallback=fallback)


def decode_text(content: bytes, path: str | Path, *, remedy: str, fallback: str | None = None) -> str:
    r"""Text of the bytes of a file, with line endings converted to \n; `path` is for messages, see `read_text`."""
    if has_wide_letters(content):
        raise ValueError(f"{path} is text in UTF-16 or UTF-32: save it as UTF-8")
    if b"\0" in content:
        raise ValueError(f"{path} is a binary file, not a text file: {remedy}")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        if fallback:
            return content.decode(fallback, errors="replace").replace("\r\n", "\n").replace("\r", "\n")
        raise ValueError(f"{path} is not a UTF-8 text file: {remedy}") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def has_wide_letters(content: bytes) -> bool:
    """Return True if characters take two or four bytes, judging by a byte order mark or by zeros in between."""
    halves = [set(content[:_SAMPLE_BYTES][k::2]) == {0} for k in (0, 1)]
    return content.startswith(_MARKS) or halves[0] != halves[1]


def parse_integer(word: str) -> int:
    """Convert a word in a file to an integer.

    The message of the ValueError raised on failure can be part of a sentence.
    """
    _check_digits(word)
    if len(word.strip()) > _MAX_DIGITS:
        raise ValueError(f"{word.strip()[:20]!r} … has {len(word.strip())} digits: at most {_MAX_DIGITS} are allowed")
    return int(word)


class SentenceError(ValueError):
    """Base of errors whose message is one sentence for the user, of at most LONGEST characters."""

    def __init__(self, sentence: str = ""):
        super().__init__(bounded(sentence))


def bounded(sentence: str) -> str:
    """Return a message with what it quotes shortened; its beginning, what was got, and its end, what to do, stay."""
    sentence = printable(sentence)
    if len(sentence) <= LONGEST:
        return sentence
    sentence = re.sub(rf"\S{{{LONGEST // 10},}}", lambda word: shortened(word[0]), sentence)
    cut = LONGEST // 2 - 2
    return sentence if len(sentence) <= LONGEST else f"{sentence[:cut]} … {sentence[-cut:]}"


def printable(text: str) -> str:
    r"""Text with its control characters written as in Python: a terminal obeys those of a foreign text.

    Examples
    --------
    >>> print(printable("a\x1b[2J title"))
    a\x1b[2J title
    """
    return _CONTROL.sub(lambda found: repr(found[0])[1:-1], text)


def parse_number(word: str) -> float:
    """Convert a word in a file to a number; `float` takes 1_1 for 11, and the digits of other scripts."""
    _check_digits(word)
    return float(word)


def parse_numbers(tokens: Sequence[str]) -> np.ndarray:
    """Convert words in a file to an array of numbers, as `parse_number` does."""
    _check_digits("".join(tokens))
    return np.array(tokens, float)


def _check_digits(text: str) -> None:
    if "_" in text or not text.isascii():
        odd = next(letter for letter in text if letter == "_" or not letter.isascii())
        raise ValueError(f"{odd!r} is not part of a number: use the digits 0 to 9, signs, a point and e")


def shortened(word: str, most: int = 60) -> str:
    """Word for a message, shortened if it is long."""
    return word if len(word) <= most else f"{word[:most]} … ({len(word)} characters)"


def quoted(value) -> str:
    """Short `repr` of a value on one line, for a message."""
    return shortened(" ".join(repr(value).split()))


_DECIMAL_COMMA = re.compile(r"^([+-]?\d*),(\d+(?:[eE][+-]?\d+)?)$")
_DECIMAL_POINT = re.compile(r"^[+-]?\d*\.\d+(?:[eE][+-]?\d+)?$")
_THOUSANDS = re.compile(r"^[+-]?[1-9]\d{0,2}[.,]\d{3}$")


def heading_of(name: str, unit: str) -> str:
    """Heading of a column in a file, such as `time [s]`; numbers have the unit `-`."""
    return f"{name} [{'-' if unit == '1' else unit}]"


def split_label(heading: str) -> tuple[str, str | None]:
    """Name and unit of a heading such as `dc [m]` or `dc (m)`; None without a unit."""
    name, bracket, unit = heading.replace("(", "[").partition("[")
    return name.strip(), unit.rstrip("]) ").strip() if bracket else None


def format_table(
    headings: Iterable[str], rows: Iterable[Iterable], *, digits: int | None = 9, comments: Iterable[str] = ()
) -> str:
    """CSV of rows of numbers and words; None is an empty cell.

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
    """Line number and fields of every row of a table, that of the headings first.

    Separators are commas, semicolons or tabs; with the last two, numbers may have decimal commas. Lines that start with
    # are comments. Files that are not UTF-8 are read as Windows-1252.

    Raises
    ------
    ValueError
        with one sentence that names the line.
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
    mark = next((mark for mark in ";\t" if mark in lines[0][1]), ",")  # commas may be decimal ones
    rows = split_rows(path, lines, mark)
    for number, row in rows:
        if len(row) != len(rows[0][1]):
            raise ValueError(
                f"{path}, line {number}, has {len(row)} fields but the header has {len(rows[0][1])}: correct the line"
            )
    return rows


def split_rows(path: str | Path, lines: list[tuple[int, str]], mark: str | None) -> list[tuple[int, list[str]]]:
    """Number and fields of each numbered line; separated by `mark`, or by white space if it is None.

    Decimal commas become points unless commas separate. Files with both are refused if one of them may separate
    thousands throughout.
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
    if mark != ",":
        _check_decimals(path, [(number, field) for (number, _), row in zip(lines, split, strict=True) for field in row])
        split = [[_DECIMAL_COMMA.sub(r"\1.\2", field) for field in row] for row in split]
    return [(number, row) for (number, _), row in zip(lines, split, strict=True)]


def _check_decimals(path: str | Path, fields: list[tuple[int, str]]) -> None:
    """Raise ValueError if numbers have commas and points, one of which may separate thousands throughout."""
    commas = [field for field in fields if _DECIMAL_COMMA.match(field[1])]
    points = [field for field in fields if commas and _DECIMAL_POINT.match(field[1])]
    if points and any(all(_THOUSANDS.match(number) for _, number in marked) for marked in (commas, points)):
        raise ValueError(
            f"{path} has numbers with points and with commas ({points[0][1]!r} in line {points[0][0]}, "
            f"{commas[0][1]!r} in line {commas[0][0]}), of which one may separate thousands: write all with points"
        )
