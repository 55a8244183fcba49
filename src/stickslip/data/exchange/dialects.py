"""Packings in the text formats of other programs: EDEM exports, jamBashBulk, PackLSD, MFIX.

Sources: MUSEN's reader of EDEM exports; `Pack_Nomenclature.md` of jamBashBulk; A. Donev's instructions for PackLSD;
the routine READ_PART_INPUT_V2P0 of MFIX.
"""

import re
from pathlib import Path

import numpy as np

from ...core.text import parse_numbers
from ..sample import COLUMNS, Assumption, Obstacle, PackingError
from .columns import Packing, chosen_frames, extent_note, head_text, only_state, packing_of_columns, read_lines

QUERY = re.compile(r"(?m)^[ \t\"]*Q\d+[ \t]*:[ \t]*(?:Particle )?([^:\n]*):")
TIME = re.compile(r"(?m)^[ \t\"]*TIME:[\s,;]*([-+.\deE]+)")
JAMBASH = re.compile(
    r"(?m)^N *= *(\d+) *, *L *=[^{}\n]*L1 *= *\{([^{}]*)\} *, *L2 *= *\{([^{}]*)\}[^{}\n]*\n?\s*\{([^{}]*)\}"
)
PACKLSD = re.compile(r"\A\s*[23][^\n\S]*(HS[^\n\S][^\n]*|![^\n]*)?\n\s*\d+[^\n\S]+\d+[^\n\S]*(![^\n]*)?\n")

MFIX = re.compile(r"\A\s*Version[ \t]+(\d+\.\d+)", re.IGNORECASE)
MFIX_HEAD = re.compile(r"(?im)^[ \t\"]*(Dimension|Particles)(?:[ \t]+to[ \t]+read)?[^\s,]*[\s,]+(\d+)[^\n]*$")
MFIX_OPTION = re.compile(
    r"(?im)^[ \t\"]*(Coordinates|Phase_ID|Diameter|Density|Velocity)[^\s,]*[\s,]+\.?([TF])\w*\.?([^\n]*)$"
)
MFIX_NAMES = {
    "phase_id": ["type"],
    "diameter": ["diameter"],
    "density": ["density"],
}  # the lattice vectors follow the dimension


def recognize_edem(head: bytes) -> bool:
    """Return True for an EDEM export, with a list of values below each query."""
    return bool(QUERY.search(head_text(head)))


def read_edem(path: Path, frame: str | None = None) -> list[Packing]:
    """Read the states of an EDEM export, named by time; each query has a value for each particle."""
    times = TIME.split(read_lines(path))[1:]
    if not times:
        raise PackingError(f"{path} has EDEM queries but no line `TIME:` above them: export it with its header")
    names = times[::2]
    packings = [_edem_time(path, names[k], times[2 * k + 1]) for k in chosen_frames(path, names, frame)]
    return _with_choice(path, names, frame, packings)


def _edem_time(path: Path, name: str, text: str) -> Packing:
    """Packing at one time; queries with single numbers, such as totals, are left out."""
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
            raise PackingError(
                f"{path} has {len(words)} values of {query!r} at time {name}, but {most} of other queries"
            )
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
    """Packings, with a note on the choice among several."""
    if frame is not None or len(names) == 1:
        return packings
    last = f"{path.name} has {len(names)} states: the last, {names[-1]}, is used; choose another with --frame"
    return [packing._replace(notes=[last, *packing.notes]) for packing in packings]


def recognize_jambash(head: bytes) -> bool:
    """Return True for jamBashBulk packings: N, lattice vectors and pressure, then x, y and R in braces."""
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
    """Return True for PackLSD packings: dimension, numbers of spheres and kinds, lattice, T or F, positions."""
    text = head_text(head)
    return bool(PACKLSD.match(text)) and bool(re.search(r"(?m)^\s*[TF]([^\n\S]+[TF]){1,2}\s*(!.*)?$", text))


def read_packlsd(path: Path, frame: str | None = None) -> list[Packing]:
    """Read spheres or disks in a lattice, with a diameter for each kind or, after its position, for each grain."""
    only_state(path, frame)
    words = re.sub(r"!.*|\bHS\s.*", "", read_lines(path)).split()  # "3 HS poly": spheres, each with its diameter
    dim, start = int(words[0]), next(k for k, word in enumerate(words) if word in ("T", "F"))
    head, flags, rest = words[:start], words[start : start + dim], _parse(path, words[start + dim :])
    count, kinds = (int(word) for word in head[1:3])
    sizes = head[3 + kinds : len(head) - dim**2]
    width = dim + (not sizes)
    if len(head) != 3 + kinds + len(sizes) + dim**2 or len(sizes) not in (0, kinds) or len(rest) != width * count:
        raise PackingError(f"{path} has {len(rest)} numbers for {count} positions in {dim} dimensions: it is damaged")
    rows, numbers = rest.reshape(count, width), _parse(path, head[3 : 3 + kinds])
    if numbers.sum() != count or (numbers < 0).any() or (numbers % 1).any():
        raise PackingError(
            f"{path} declares {count} spheres, but {numbers.sum():g} of all kinds together: it is damaged"
        )
    diameter = np.repeat(_parse(path, sizes), numbers.astype(int)) if sizes else rows[:, dim]
    cell = np.eye(3)
    cell[:dim, :dim] = _parse(path, head[len(head) - dim**2 :]).reshape(dim, dim)
    periodic = [flag == "T" for flag in flags] + [False] * (3 - dim)
    columns = {**dict(zip("xyz", rows[:, :dim].T, strict=False)), "diameter": diameter}
    packing = packing_of_columns(columns, path.name, path.stem, dim=dim, cell=cell, periodic=periodic)
    notes = [Assumption(f"{path.name}: positions are assumed to be lengths, not lattice fractions", COLUMNS)]
    notes += [] if all(periodic[:dim]) else [Obstacle(f"hard walls of {path.name} (F) were not imported")]
    return [packing._replace(notes=[*packing.notes, *notes])]


def recognize_mfix(head: bytes) -> bool:
    """Return True for MFIX's particle_input.dat with a header; version 1 has none and is a table."""
    return bool(MFIX.match(head_text(head))) and bool(MFIX_OPTION.search(head_text(head)))


def read_mfix(path: Path, frame: str | None = None) -> list[Packing]:
    """Read a particle_input.dat of version 2.0: each property is a column (T) or one value for all grains (F)."""
    only_state(path, frame)
    text = read_lines(path)
    if (version := MFIX.match(text)[1]) != "2.0":
        raise PackingError(
            f"{path} has version {version} of MFIX's particle_input.dat: convert it to version 2.0 or a table"
        )
    numbers = {name.lower(): int(value) for name, value in MFIX_HEAD.findall(text)}
    options = list(MFIX_OPTION.finditer(text))
    dim, count = numbers.get("dimension"), numbers.get("particles")
    rows = [line.split() for line in text[options[-1].end() :].split("\n")]
    rows = [row for row in rows if row and re.fullmatch(r"[-+.\deEdD]+", row[0])]
    if dim not in (2, 3) or len(rows) != count:
        raise PackingError(f"{path} has {len(rows)} rows for {count} particles in {dim} dimensions: it is damaged")
    names, columns = [], {}
    for option in options:
        name, given, rest = option[1].lower(), option[2].upper(), option[3].replace(",", " ").split()
        each = MFIX_NAMES.get(name, [("v" if name == "velocity" else "") + axis for axis in "xyz"[:dim]])
        if given == "T":
            names += each
        else:
            columns |= dict(zip(each, np.outer(_parse(path, rest[: len(each)]), np.ones(count)), strict=False))
    if any(len(row) < len(names) for row in rows):
        raise PackingError(f"{path} has rows with fewer numbers than its {len(names)} columns: it is damaged")
    values = _parse(path, [re.sub("[dD]", "e", word) for row in rows for word in row[: len(names)]])
    columns |= dict(zip(names, values.reshape(count, -1).T, strict=True))
    packing = packing_of_columns(columns, path.name, path.stem)
    notes = [*packing.notes, Assumption(extent_note(path.name))]
    if more := max(map(len, rows), default=0) - len(names):  # temperature, species, scalars
        notes.append(f"{path.name}: columns after {' '.join(names)} are not used: {more}")
    return [packing._replace(notes=notes)]
