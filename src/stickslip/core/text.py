"""Text of files that people wrote: UTF-8, with or without the mark that some editors put before it."""

import codecs
from pathlib import Path

_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_BE)  # that of UTF-32-LE begins with the first
_SAMPLE_BYTES = 64  # bytes in which text of two bytes a letter shows itself
_MAX_DIGITS = 40  # of a whole number in a file; those that are meant have twenty


def text_of(path: str | Path, *, remedy: str) -> str:
    r"""The text of a file, its lines ended by \n.

    Parameters
    ----------
    remedy : what to do if the file is no text, for the sentence

    Raises
    ------
    ValueError
        with one sentence, if it is no text in UTF-8.
    OSError
        if it cannot be read.
    """
    content = Path(path).read_bytes()
    if _has_wide_letters(content):
        raise ValueError(f"{path} is text in UTF-16 or UTF-32: save it as UTF-8")
    if b"\0" in content:
        raise ValueError(f"{path} is a binary file, not a text file: {remedy}")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not a text file in UTF-8: {remedy}") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _has_wide_letters(content: bytes) -> bool:
    """Whether letters have two bytes or four: marked, or as letters of English are, every other byte zero."""
    halves = [set(content[:_SAMPLE_BYTES][k::2]) == {0} for k in (0, 1)]
    return content.startswith(_MARKS) or halves[0] != halves[1]


def whole_number(word: str) -> int:
    """The integer that a word in a file is; ValueError in words that fit into a sentence."""
    if len(word.strip()) > _MAX_DIGITS:
        raise ValueError(f"{word.strip()[:20]!r} … has {len(word.strip())} digits, at most {_MAX_DIGITS} are read")
    return int(word)


def shortened(word: str, most: int = 60) -> str:
    """A word for a sentence, cut if it is long."""
    return word if len(word) <= most else f"{word[:most]} … ({len(word)} letters)"
