"""Text written by users: files in UTF-8, with or without a byte order mark, and the numbers in them."""

import codecs
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .reading import read_bytes

LONGEST = 1000  # longest message [characters]
_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_BE)  # that of UTF-32-LE starts with the first
_SAMPLE_BYTES = 64  # bytes examined to detect text with two bytes per letter
# all control characters except tabs and line feeds, and marks that change the direction of writing
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
_MAX_DIGITS = 40  # longest whole number in a file [digits]; valid ones have at most twenty


def read_text(path: str | Path, *, remedy: str, fallback: str | None = None) -> str:
    r"""Read a text file, with line endings converted to \n.

    Parameters
    ----------
    remedy : advice in the error message if the file is not text
    fallback : encoding of files that are not UTF-8, such as "cp1252"; by default they are rejected

    Raises
    ------
    ValueError
        If it is not a regular file of UTF-8 text.
    OSError
        If the file cannot be read.
    """
    return decode_text(read_bytes(path, remedy=remedy), path, remedy=remedy, fallback=fallback)


def decode_text(content: bytes, path: str | Path, *, remedy: str, fallback: str | None = None) -> str:
    r"""Text of the bytes of a file, with line endings converted to \n; `path` is for messages (see `read_text`)."""
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
    """Return True if characters take two or four bytes, judging by a byte order mark or by zero bytes in between."""
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
    """Base class of errors whose message is one sentence for the user, of at most LONGEST characters."""

    def __init__(self, sentence: str = ""):
        super().__init__(bounded(sentence))


def bounded(sentence: str) -> str:
    """Shorten a message: first its long words, then its middle; its end, which contains the remedy, is kept."""
    sentence = printable(sentence)
    if len(sentence) <= LONGEST:
        return sentence
    sentence = re.sub(rf"\S{{{LONGEST // 10},}}", lambda word: shortened(word[0]), sentence)
    cut = LONGEST // 2 - 2
    return sentence if len(sentence) <= LONGEST else f"{sentence[:cut]} … {sentence[-cut:]}"


def printable(text: str) -> str:
    r"""Text with control characters escaped as in Python, because a terminal would obey them.

    Examples
    --------
    >>> print(printable("a\x1b[2J title"))
    a\x1b[2J title
    """
    return _CONTROL.sub(lambda found: repr(found[0])[1:-1], text)


def parse_number(word: str) -> float:
    """Convert a word in a file to a number; `float` would read 1_1 as 11, and accept digits of other scripts."""
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
