"""Packings of other programs in text with a layout of its own: EDEM's export, jamBashBulk, PackLSD.

Sources: the reader of EDEM's text in MUSEN; `Pack_Nomenclature.md` of jamBashBulk; A. Donev's instructions for PackLSD.
"""

import re
from pathlib import Path

import numpy as np

from ...core.text import parse_numbers
from ..sample import COLUMNS, Assumption, Obstacle, PackingError
from .columns import packing_of_columns
from .content import Packing, chosen_frames, extent_note, head_text, only_state, read_lines

QUERY = re.compile(r"(?m)^[ \t\"]*Q\d+[ \t]*:[ \t]*(?:Particle )?([^:\n]*):")
TIME = re.compile(r"(?m)^[ \t\"]*TIME:[\s,;]*([-+.\deE]+)")
JAMBASH = re.compile(
    r"(?m)^N *= *(\d+) *, *L *=[^{}\n]*L1 *= *\{([^{}]*)\} *, *L2 *= *\{([^{}]*)\}[^{}\n]*\n?\s*\{([^{}]*)\}"
)
PACKLSD = re.compile(r"\A\s*[23][^\n\S]*(![^\n]*)?\n\s*\d+[^\n\S]+\d+[^\n\S]*(![^\n]*)?\n")


def recognize_edem(head: bytes) -> bool:
    """Return True for a table that EDEM exports, with a list of values below each query."""
    return bool(QUERY.search(head_text(head)))


def read_edem(path: Path, frame: str | None = None) -> list[Packing]:
    """Read the times of an export of EDEM, named by them; each query has a value for each particle."""
    times = TIME.split(read_lines(path))[1:]
    if not times:
        raise PackingError(f"{path} has queries of EDEM but no line `TIME:` above them: export it with its header")
    names = times[::2]
    packings = [_edem_time(path, names[k], times[2 * k + 1]) for k in chosen_frames(path, names, frame)]
    return _with_choice(path, names, frame, packings)


def _edem_time(path: Path, name: str, text: str) -> Packing:
    """Packing at one time; queries of single numbers, as of totals, are left out."""
    queries = QUERY.split(text)[1:]
    lists = [re.findall(r"[^\s,;\"]+", values) for values in queries[1::2]]
    most = max(map(len, lists), default=0)
    columns: dict[str, np.ndarray] = {}
    for query, words in zip(queries[::2], lists, strict=True):
        if query in columns:
            raise PackingError(
                f"{path} has the query {query!r} twice at time {name}: export it once, for all particles"
            )
        if len(words) != most and not query.startswith("Total"):
            raise PackingError(f"{path} has {len(words)} values of {query!r} at time {name}, and {most} of others")
        if len(words) == most:
            columns[query] = _parse(path, words)
    packing = packing_of_columns(columns, path.name, name)
    return packing._replace(notes=[*packing.notes, Assumption(extent_note(path.name))])


def _parse(path: Path, words: list[str]) -> np.ndarray:
    try:
        return parse_numbers(words)
    except ValueError as problem:
        raise PackingError(f"{path} contains an entry that is not a number ({problem}): write it again") from None


def _with_choice(path: Path, names: list[str], frame: str | None, packings: list[Packing]) -> list[Packing]:
    """Packings with a note on the one that is read of several."""
    if frame is not None or len(names) == 1:
        return packings
    last = f"{path.name} has {len(names)} states: the last, {names[-1]}, is used; choose another with --frame"
    return [packing._replace(notes=[last, *packing.notes]) for packing in packings]


def recognize_jambash(head: bytes) -> bool:
    """Return True for packings of jamBashBulk: N, lattice vectors and pressure, then x, y and R in braces."""
    return bool(re.search(r"(?m)^N *= *\d+ *, *L *= *\S+ *, *L1 *=", head_text(head)))


def read_jambash(path: Path, frame: str | None = None) -> list[Packing]:
    """Read disks in periodic cells, named by their number in the file."""
    found = JAMBASH.findall(read_lines(path))
    if not found:
        raise PackingError(f"{path} is truncated: N, L1, L2 and the disks in braces are needed, as in jamBashBulk")
    names = [str(k) for k in range(len(found))]
    packings = [_jambash_packing(path, names[k], *found[k]) for k in chosen_frames(path, names, frame)]
    return _with_choice(path, names, frame, packings)


def _jambash_packing(path: Path, name: str, count: str, *lists: str) -> Packing:
    first, second, rows = (_parse(path, words.replace(",", " ").split()) for words in lists)
    if len(rows) != 3 * int(count) or len(first) != 2 or len(second) != 2:
        raise PackingError(f"{path} has {len(rows)} numbers for {count} disks in packing {name}: it is damaged")
    cell = np.eye(3)
    cell[:2, :2] = first, second
    columns = dict(zip(("x", "y", "radius"), rows.reshape(-1, 3).T, strict=True))
    return packing_of_columns(columns, path.name, name, dim=2, cell=cell, periodic=[True, True, False])


def recognize_packlsd(head: bytes) -> bool:
    """Return True for packings of PackLSD: dimension, numbers of spheres and kinds, lattice, T or F, positions."""
    text = head_text(head)
    return bool(PACKLSD.match(text)) and bool(re.search(r"(?m)^\s*[TF]([^\n\S]+[TF]){1,2}\s*(!.*)?$", text))


def read_packlsd(path: Path, frame: str | None = None) -> list[Packing]:
    """Read spheres or disks in a lattice, with a diameter for each kind, or for each after its position."""
    only_state(path, frame)
    words = re.sub(r"!.*", "", read_lines(path)).split()
    dim, start = int(words[0]), next(k for k, word in enumerate(words) if word in ("T", "F"))
    head, flags, rest = words[:start], words[start : start + dim], _parse(path, words[start + dim :])
    count, kinds = (int(word) for word in head[1:3])
    sizes = head[3 + kinds : len(head) - dim**2]
    width = dim + (not sizes)
    if len(head) != 3 + kinds + len(sizes) + dim**2 or len(sizes) not in (0, kinds) or len(rest) != width * count:
        raise PackingError(f"{path} has {len(rest)} numbers for {count} positions in {dim} dimensions: it is damaged")
    rows, numbers = rest.reshape(count, width), _parse(path, head[3 : 3 + kinds])
    if numbers.sum() != count or (numbers < 0).any() or (numbers % 1).any():
        raise PackingError(f"{path} has {count} spheres, and {numbers.sum():g} of all kinds: it is damaged")
    diameter = np.repeat(_parse(path, sizes), numbers.astype(int)) if sizes else rows[:, dim]
    cell = np.eye(3)
    cell[:dim, :dim] = _parse(path, head[len(head) - dim**2 :]).reshape(dim, dim)
    periodic = [flag == "T" for flag in flags] + [False] * (3 - dim)
    columns = {**dict(zip("xyz", rows[:, :dim].T, strict=False)), "diameter": diameter}
    packing = packing_of_columns(columns, path.name, path.stem, dim=dim, cell=cell, periodic=periodic)
    notes = [Assumption(f"{path.name}: positions are assumed to be lengths, not lattice fractions", COLUMNS)]
    notes += [] if all(periodic[:dim]) else [Obstacle(f"hard walls of {path.name} (F) were not taken over")]
    return [packing._replace(notes=[*packing.notes, *notes])]
