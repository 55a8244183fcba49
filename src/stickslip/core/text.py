"""Reading text files written by users: UTF-8, with or without a byte order mark."""

import codecs
from pathlib import Path

_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_BE)  # UTF-32-LE's starts with the first
_SAMPLE_BYTES = 64  # bytes examined to detect text with two bytes per letter
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
        with a one-sentence message, if the file is not UTF-8 text.
    OSError
        if the file cannot be read.
    """
    content = Path(path).read_bytes()
    if _has_wide_letters(content):
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


def _has_wide_letters(content: bytes) -> bool:
    """Return True if characters take two or four bytes, judging by a byte order mark or by zeros in between."""
    halves = [set(content[:_SAMPLE_BYTES][k::2]) == {0} for k in (0, 1)]
    return content.startswith(_MARKS) or halves[0] != halves[1]


def parse_integer(word: str) -> int:
    """Convert a word in a file to an integer.

    The message of the ValueError raised on failure can be part of a sentence.
    """
    if len(word.strip()) > _MAX_DIGITS:
        raise ValueError(f"{word.strip()[:20]!r} … has {len(word.strip())} digits: at most {_MAX_DIGITS} are allowed")
    return int(word)


def shortened(word: str, most: int = 60) -> str:
    """Word for a message, shortened if it is long."""
    return word if len(word) <= most else f"{word[:most]} … ({len(word)} characters)"


def quoted(value) -> str:
    """Short `repr` of a value on one line, for a message."""
    return shortened(" ".join(repr(value).split()))
