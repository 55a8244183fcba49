"""Content of foreign files: bytes, decompressed if necessary, and packings as these files describe them."""

import bz2
import gzip
import lzma
import re
import shlex
import zlib
from collections.abc import Callable, Container, Sequence
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.laws.builtin import Law
from ...core.reading import Budget, read_bytes
from ...core.state import State
from ...core.text import decode_text, has_wide_letters
from ..sample import Absent, PackingError, accepted, from_arrays

HEAD = 2**14  # bytes at the beginning of a file by which its format is detected
FEW_DIGITS, SAMPLED = 9, 3000  # digits of positions that are few, and words that are examined
ALL_DIGITS = "`dump_modify ID format float %20.15g` makes LAMMPS write all digits"
MOST_DIGITS = 12  # largest number of digits in a number of grains
LONGEST_LINE = 60  # length of lines quoted in messages [characters]
COMPRESSED = {b"\x1f\x8b": gzip.open, b"\xfd7zXZ\x00": lzma.open, b"BZh": bz2.open, b"\x28\xb5\x2f\xfd": None}


class ListedBonds(NamedTuple):
    """Bonds as listed in a file, each once; their laws follow from the commands of the run."""

    i: np.ndarray  # (K,) grain, less than j
    j: np.ndarray  # (K,)
    kind: np.ndarray  # (K,) type from 1; others are broken or turned off
    source: str  # name of the file
    labels: dict[str, str]  # types by their labels
    length: np.ndarray | None = None  # (K,) at rest, zero where unknown; None: not in any file [length]
    direction: np.ndarray | None = None  # (K, 3) as in `Bonds`; None: grains have no orientations
    turn: np.ndarray | None = None  # (K, 4), likewise
    weights: tuple[float, ...] = ()  # three of special_bonds, of contacts; empty if they are not in the file


class Packing(NamedTuple):
    """A packing as a file describes it: arrays for `from_arrays`, or the state itself."""

    name: str  # name of the state in its file: a time step, the number of a frame, a path in an archive
    arrays: dict  # for `from_arrays`
    notes: list[str]  # on assumptions and omissions
    step: int = -1  # time step; −1: unknown
    ids: np.ndarray | None = None  # (N,) ids that contacts refer to, increasing
    types: np.ndarray | None = None  # (N,) from 0, rows of the law's table
    force: np.ndarray | None = None  # (N, 3) resultant on each grain [force]
    state: State | None = None  # complete, with its memory
    setting: Callable[[State], State] | None = None  # adds walls and loads to the grains
    memory: tuple | None = None  # `Restart`, which holds the memory of contacts
    law: Law | dict | None = None  # or options of `law_by_name`
    labels: dict[str, int] | None = None  # types of atoms by their labels, from 1
    bonds: ListedBonds | None = None  # None: the format has no bonds


def placed_state(packing: Packing, law: Law) -> State:
    """Accepted state of the grains with the materials of their types, and the walls and loads of their run."""
    state = from_arrays(law=law, **packing.arrays)
    if packing.types is not None and len(law.table) > 1:
        state = state._replace(grains=state.grains._replace(material=packing.types.copy()))
    elif packing.setting is None:
        return state
    return accepted(state if packing.setting is None else packing.setting(state), law)


def _zstandard(path: Path):
    """Module that opens Zstandard files: part of the standard library from Python 3.14 on, or the package zstandard."""
    for name in ("compression.zstd", "zstandard"):
        try:
            return import_module(name)
        except ModuleNotFoundError:
            continue
    raise PackingError(
        f"{path} is compressed with Zstandard, which Python reads from version 3.14 on: decompress it with "
        f"`unzstd {shlex.quote(path.name)}`, or `pip install zstandard`"
    )


def read_content(path: Path, size: int = -1) -> bytes:
    """Bytes of a file, decompressed if necessary; at most `size` of them unless `size` is negative."""
    # function that opens the compressed file; None for others
    start = _read(path, 6)
    mark = next((mark for mark in COMPRESSED if start.startswith(mark)), None)
    opener = None if mark is None else COMPRESSED[mark] or _zstandard(path).open
    if opener is None:
        return _read(path, size)
    budget = Budget(path, path.stat().st_size, remedy="copy it again", error=PackingError)
    try:
        with opener(path, "rb") as file:
            content = file.read(size) if size >= 0 else budget.expand(file)
    except (EOFError, lzma.LZMAError, zlib.error, gzip.BadGzipFile) as problem:
        raise PackingError(f"{path} cannot be decompressed ({problem}): it is truncated or damaged") from None
    except PackingError:
        raise
    except Exception as problem:
        if type(problem).__name__ != "ZstdError":
            raise
        raise PackingError(f"{path} cannot be decompressed ({problem}): it is truncated or damaged") from None
    if not content:
        raise PackingError(f"{path} is compressed and has no content: it is truncated or damaged")
    return content


def _read(path: Path, size: int = -1) -> bytes:
    try:
        return read_bytes(path, remedy="give a file of a packing", size=size)
    except ValueError as problem:
        raise PackingError(str(problem)) from None


def is_compressed(path: Path) -> bool:
    """Return True if a file is compressed as a whole."""
    return _read(path, 6).startswith(tuple(COMPRESSED))


def read_lines(
    path: Path,
    remedy: str = "give a text file, or a binary one that is listed in `stickslip docs exchange`",
    fallback: str | None = None,
) -> str:
    """Text of a file, in UTF-8 or another encoding; raise PackingError if it is binary or ends within a line."""
    try:
        text = decode_text(read_content(path), path, remedy=remedy, fallback=fallback)
    except ValueError as problem:
        raise PackingError(str(problem)) from None
    if text and not text.endswith("\n"):  # a truncated number is still a number
        raise PackingError(f"{path} ends in the middle of a line: it is truncated, or its last line has no newline")
    return text


def head_text(head: bytes) -> str:
    """Text at the beginning of a file; empty if it is binary."""
    if b"\0" in head:
        return ""
    return head.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")


def first_lines(path: Path) -> str:
    """The first lines of a file for a message, or its kind if it is not plain text."""
    if has_wide_letters(head := read_content(path, HEAD)):
        raise PackingError(f"{path} is text in UTF-16 or UTF-32: save it as UTF-8")
    text = head_text(head)
    lines = [line.strip()[:LONGEST_LINE] for line in text.splitlines() if line.strip()][:2]
    return f"it begins with {' | '.join(lines)!r}" if lines else "it is binary" if head.strip() else "it is empty"


def only_state(path: Path, frame: str | None) -> None:
    """Raise PackingError if a frame is requested from a file with a single state."""
    if frame not in (None, "all"):
        raise PackingError(f"frame {frame!r} does not apply to {path}, which has only one state: leave it out")


def chosen_frames(path: Path, names: list[str], frame: str | None) -> list[int]:
    """Indices of the states to read among these names: all, one, or the last by default."""
    if frame == "all":
        return list(range(len(names)))
    if frame is not None and frame not in names:
        some = ", ".join(names[:6]) + (" …" if len(names) > 6 else "")
        raise PackingError(f"{path} has no frame {frame!r}: it has {some}")
    return [len(names) - 1 if frame is None else names.index(frame)]


def split_frames(
    path: Path, frame: str | None, widths: Container[int], above: int, what: str, needed: str
) -> list[tuple[str, list[str]]]:
    """Number and lines of the frames to read from a text in which each frame begins with its number of grains.

    Parameters
    ----------
    widths : allowed numbers of words in the first line of a frame
    above : number of lines before those of the grains
    what, needed : words for a frame and for its first line, in messages
    """
    lines, starts, at = read_lines(path).rstrip("\n").split("\n"), [], 0
    while at < len(lines):
        fields = lines[at].split()
        if len(fields) not in widths or not fields[0].isdecimal() or len(fields[0]) > MOST_DIGITS:
            raise PackingError(f"{path} has {lines[at][:60]!r} at the beginning of {what} {len(starts)}: {needed}")
        starts.append(at)
        at += above + int(fields[0])
    if at > len(lines):
        raise PackingError(f"{path} ends within {what} {len(starts) - 1}: it is truncated, or still being written")
    chosen = chosen_frames(path, [str(k) for k in range(len(starts))], frame)
    return [(str(k), lines[start:end]) for k, (start, end) in enumerate(pairwise([*starts, at])) if k in chosen]


def digits_note(texts: Sequence[str]) -> list[str]:
    """Note on positions with few digits; None if they have many."""
    most = max((len(re.sub(r"[eE].*|[-+.]", "", word).lstrip("0")) for word in texts[:SAMPLED]), default=FEW_DIGITS + 1)
    few = f"positions have at most {most} digits, but overlaps are small differences of positions; {ALL_DIGITS}"
    return [Absent(few)] if most <= FEW_DIGITS else []


def extent_note(what: str) -> str:
    """Note on a file without a box."""
    return f"{what} has no box: the grains are treated as an unconfined cluster"
