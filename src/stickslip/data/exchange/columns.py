"""Content of foreign files: bytes, decompressed if necessary, and packings as these files describe them.

Columns of grains are identified by the names that programs use or, without names, by their content.
"""

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
from ...known import HARMLESS, USED
from ..sample import COLUMNS, Absent, Assumption, Obstacle, PackingError, accepted, account_for, from_arrays, refusing

HEAD = 2**14  # number of bytes at the beginning of a file that identify its format
FEW_DIGITS, SAMPLED = 9, 3000  # largest number of digits that counts as few, and number of words examined
ALL_DIGITS = "`dump_modify ID format float %20.15g` makes LAMMPS write all digits"
MOST_DIGITS = 12  # largest number of digits of a count of grains
LONGEST_LINE = 60  # length of lines quoted in messages [characters]
DAMAGED = (EOFError, lzma.LZMAError, zlib.error, gzip.BadGzipFile)  # errors raised for damaged compressed files
COMPRESSED = {b"\x1f\x8b": gzip.open, b"\xfd7zXZ\x00": lzma.open, b"BZh": bz2.open, b"\x28\xb5\x2f\xfd": None}


class ListedBonds(NamedTuple):
    """Bonds listed in a file, each once; the commands of the run define their laws."""

    i: np.ndarray  # (K,) grain, less than j
    j: np.ndarray  # (K,)
    kind: np.ndarray  # (K,) type from 1; others are broken or turned off
    source: str  # name of the file
    labels: dict[str, str]  # types by their labels
    length: np.ndarray | None = None  # (K,) length at rest, zero where unknown; None: no file contains it [length]
    direction: np.ndarray | None = None  # (K, 3) as in `Bonds`; None: grains have no orientations
    turn: np.ndarray | None = None  # (K, 4) as in `Bonds`; None: grains have no orientations
    weights: tuple[float, ...] = ()  # three weights of special_bonds for contacts; empty if not in the file


class Packing(NamedTuple):
    """A packing as a file describes it: arrays for `from_arrays`, or the state itself."""

    name: str  # name of the state in its file: a time step, the number of a frame, a path in an archive
    arrays: dict  # arguments of `from_arrays`
    notes: list[str]  # notes on assumptions and omissions
    step: int = -1  # time step; −1: unknown
    ids: np.ndarray | None = None  # (N,) ids that contacts refer to, increasing
    types: np.ndarray | None = None  # (N,) types from 0, which are rows of the law's table
    force: np.ndarray | None = None  # (N, 3) resultant on each grain [force]
    state: State | None = None  # complete state with its memory
    setting: Callable[[State], State] | None = None  # function that adds walls and loads to the grains
    memory: tuple | None = None  # `Restart`, which holds the memory of contacts
    law: Law | dict | None = None  # law, or options of `law_by_name`
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
        f"`unzstd {shlex.quote(path.name)}`, or run `pip install zstandard`"
    )


def read_content(path: Path, size: int = -1) -> bytes:
    """Bytes of a file, decompressed if necessary; at most `size` of them unless `size` is negative."""
    # function that opens the compressed file; None if the file is not compressed
    start = _read(path, 6)
    mark = next((mark for mark in COMPRESSED if start.startswith(mark)), None)
    opener = None if mark is None else COMPRESSED[mark] or _zstandard(path).open
    if opener is None:
        return _read(path, size)
    budget = Budget(path, path.stat().st_size, remedy="copy it again", error=PackingError)
    try:
        with opener(path, "rb") as file:
            content = file.read(size) if size >= 0 else budget.expand(file)
    except Exception as problem:
        if not isinstance(problem, DAMAGED) and type(problem).__name__ != "ZstdError":
            raise
        raise PackingError(f"{path} cannot be decompressed ({problem}): it is truncated or damaged") from None
    if not content:
        raise PackingError(f"{path} is compressed and has no content: it is truncated or damaged")
    return content


def _read(path: Path, size: int = -1) -> bytes:
    with refusing():
        return read_bytes(path, remedy="give a file of a packing", size=size)


def is_compressed(path: Path) -> bool:
    """Return True if a file is compressed as a whole."""
    return _read(path, 6).startswith(tuple(COMPRESSED))


def read_lines(path: Path, fallback: str | None = None) -> str:
    """Text of a file, in UTF-8 or another encoding; raise PackingError if it is binary or ends within a line."""
    remedy = "give a text file, or a binary one that is listed in `stickslip docs exchange`"
    with refusing():
        text = decode_text(read_content(path), path, remedy=remedy, fallback=fallback)
    if text and not text.endswith("\n"):  # a truncated number would still be a number
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
    """Indices of the states to read among those with these names: all, the chosen one or, by default, the last one."""
    if frame == "all":
        return list(range(len(names)))
    if frame is not None and frame not in names:
        some = ", ".join(names[:6]) + (" …" if len(names) > 6 else "")
        raise PackingError(f"{path} has no frame {frame!r}: it has {some}")
    return [len(names) - 1 if frame is None else names.index(frame)]


def choice_note(path: Path, names: list[str], frame: str | None, what: str) -> list[str]:
    """Note that the last of several states is used if none was chosen; `what` is the noun for states in this note."""
    last = f"{path.name} has {len(names)} {what}: the last, {names[-1]}, is used; choose another with --frame"
    return [last] if frame is None and len(names) > 1 else []


def split_frames(
    path: Path, frame: str | None, widths: Container[int], above: int, what: str, needed: str
) -> list[tuple[str, list[str]]]:
    """Numbers and lines of the frames to read from a text in which every frame begins with its number of grains.

    Parameters
    ----------
    widths : allowed numbers of words in the first line of a frame
    above : number of lines of a frame before its first grain
    what, needed : name of a frame, and requirement on its first line, in messages
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
    """Note on positions with few digits; empty if they have many."""
    most = max((len(re.sub(r"[eE].*|[-+.]", "", word).lstrip("0")) for word in texts[:SAMPLED]), default=FEW_DIGITS + 1)
    few = f"positions have at most {most} digits, but overlaps are small differences of positions; {ALL_DIGITS}"
    return [Absent(few)] if most <= FEW_DIGITS else []


def extent_note(what: str) -> str:
    """Note on a file without a box."""
    return f"{what} has no box: the grains are treated as an unconfined cluster"


PLACES = (
    "", "pos", "position", "positions", "point", "points", "coord", "coordinate", "coordinates", "coords", "center",
    "centers", "centre", "centres", "c", "p", "x",
)  # fmt: skip
MOTIONS = ("v", "vel", "velo", "velocity", "velocities", "linvel", "linvelvec")
TURNS = ("w", "omega", "spin", "angvel", "angvelvec", "angularvelocity")
SINGLE = {
    "radius": ("r", "rad", "radius", "radii", "ballradius", "particleradius", "cradius"),
    "diameter": ("d", "dia", "diam", "diameter", "diameters", "particlediameter", "cdiameter", "durchmesser"),
    "mass": ("m", "mass", "masses", "particlemass"),
    "density": ("rho", "density", "densities"),
    "id": ("id", "ids", "particleid", "ballid", "atomid", "grainid", "trackid", "particle", "grain", "track"),
}
KINDS = (
    "type", "types", "material", "materials", "mat", "matid", "materialid", "species", "kind", "atomtype",
    "particletype", "particlematerial",
)  # fmt: skip
TIMES = ("time", "t", "step", "timestep", "frame", "times")
VECTORS = {"position": PLACES, "velocity": MOTIONS, "spin": TURNS}
LENGTHS = {p + a for p in PLACES for a in "xyz"} | {a + p for p in PLACES for a in "xyz"}  # columns of lengths
LENGTHS |= {*SINGLE["radius"], *SINGLE["diameter"]}
CLOSE = 1e-3  # relative tolerance for numbers with few digits
NEEDED = "x y z (or x y, in a plane) and radius (or diameter)"
UNIT = re.compile(r"[\[(](.*?)[\])]|[_ ](m|cm|mm|um|µm|μm|micron|nm)$", re.IGNORECASE)  # after the name of a column
PHASES = 10  # largest number of kinds of grains in MFIX, each with one radius and density


def plain_name(name: str) -> str:
    """Name of a column in lower case, without units and punctuation: "Pos_X [mm]" and "pos_x_mm" become "posx"."""
    return re.sub(r"[^a-z0-9]", "", UNIT.sub("", name.lower().strip()))


def names_by_content(rows: np.ndarray) -> list[str] | None:
    """Names for unnamed columns of grains, from their content; None if no known layout fits.

    A first column that counts the rows, from 0 or 1, is read as ids, unless it may be the coordinate of grains in a
    row. Eight columns, or six for disks, are read as version 1 of MFIX's particle_input.dat. Any other six columns are
    read as lists of PeGS2 and RigidLibrary.
    """
    count, width = rows.shape
    counts = count > 0 and rows[0, 0] in (0, 1) and bool((rows[:, 0] == rows[0, 0] + np.arange(count)).all())
    if width == 5:
        return ["id", "x", "y", "z", "radius"] if counts else None
    if width == 4:
        spread = counts and np.ptp(rows[:, 1:3], axis=0).all()
        return ["id", "x", "y", "radius"] if spread else ["x", "y", "z", "radius"]
    if width == 6 and (rows[:, :2] == np.round(rows[:, :2])).all() and np.isin(rows[:, 5], (-1, 0, 1)).all():
        return ["frame", "id", "x", "y", "radius", "edge"]
    size = width // 2 - 1  # index of the column of radii; densities are in the next one
    if width in (6, 8) and (sizes := rows[:, size : size + 2]).min(initial=1.0) > 0:
        names = [*"xyz"[:size], "radius", "density", *("vx", "vy", "vz")[:size]]
        return names if len(np.unique(sizes, axis=0)) <= PHASES else None
    return None


def is_matlab(path: Path) -> bool:
    """Return True for a MATLAB file."""
    return path.is_file() and read_content(path, HEAD).startswith(b"MATLAB ")


def identify_columns(columns: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns under the names used here, vectors as (N, 2) or (N, 3), others as (N,); and names of unused columns."""
    plain = {plain_name(name): np.asarray(value) for name, value in columns.items()}
    out, taken = {}, set()
    for noun, names in SINGLE.items():
        match = next((name for name in names if name in plain and plain[name].ndim == 1), None)
        if match is not None:
            out[noun] = plain[match]
            taken |= set(names)
    for noun, prefixes in VECTORS.items():
        vector, names = _find_vector(plain, prefixes)
        if vector is not None:
            out[noun] = vector
            taken |= set(names)
    return out, [name for name in columns if plain_name(name) not in taken]


def _find_vector(plain: dict[str, np.ndarray], prefixes) -> tuple[np.ndarray | None, list[str]]:
    """Vector from one column with two or three components, or from a column for each, and the names of the columns."""
    for prefix in prefixes:
        whole = plain.get(prefix)
        if whole is not None and whole.ndim == 2 and whole.shape[1] in (2, 3):
            return whole, [prefix]
        for axes in ("xyz", "012", "123"):
            parts = [n for a in axes for n in (prefix + a, a + prefix) if n in plain and plain[n].ndim == 1]
            parts = list(dict.fromkeys(parts))
            if len(parts) >= 2 and (prefix or axes == "xyz"):
                return np.stack([plain[name] for name in parts], axis=1), parts
    return None, []


def packing_of_columns(
    columns: dict[str, np.ndarray], what: str, name: str = "", further: Sequence[str] = (), **more
) -> Packing:
    """Packing from the columns of a file, which messages call `what`, with further notes and more arrays.

    Raises
    ------
    PackingError
        If positions or radii are missing; the message lists the columns.
    """
    known, rest = identify_columns(columns)
    if "position" not in known or not {"radius", "diameter"} & set(known):
        some = " ".join(list(columns)[:20])
        lacks = "no positions" if "position" not in known else "no radii"
        there = f"columns {some}: {lacks} among them;" if some else "no columns:"
        raise PackingError(f"{what} has {there} {NEEDED} are needed, with these names")
    count = len(known["position"])
    for column, values in columns.items():
        if column not in rest and np.ndim(values) and len(values) != count:
            raise PackingError(f"{what} has {len(values)} values of {column} for {count} grains: write it again")
    notes = []
    whole = [name for name in rest if np.ndim(columns[name]) and len(columns[name]) != count]  # not one row per grain
    if whole:
        has = "has" if len(whole) == 1 else "have"
        notes.append(Assumption(f"{what}: {', '.join(whole)} {has} no row for each grain", COLUMNS))
    if known["position"].shape[1] == 2 or not np.any(known["position"][:, 2:]):
        more = {**more, "dim": 2}
        notes.append(Assumption(f"{what} has no third coordinate: its grains are treated as disks in a plane"))
    if known.get("spin", np.zeros((0, 3))).shape[1] != 3:
        del known["spin"]
    if "spin" not in known and more.get("dim") == 2 and (turn := _column_of(TURNS, rest, columns)):
        known["spin"] = np.outer(columns[turn], [0.0, 0.0, 1.0])
        rest = [name for name in rest if name != turn]
    if kind := _column_of(KINDS, rest, columns):
        kinds, rest = np.asarray(columns[kind]), [name for name in rest if name != kind]
        counted = (kinds == np.round(kinds)).all() and kinds.min(initial=0) == 0  # numbered from 0
        known["types"] = kinds.astype(np.int64) if counted else np.unique(kinds, return_inverse=True)[1]
    ids = known.get("id")
    if ids is not None and not (len(np.unique(ids)) == len(ids) and (ids == np.round(ids)).all()):
        del known["id"]
        value, times = max(zip(*np.unique(ids, return_counts=True), strict=True), key=lambda one: one[1])
        why = f"has grain {value:g} {times} times" if times > 1 else "has ids that are not whole numbers"
        notes.append(Assumption(f"{what} {why}: ids are ignored, and each row is treated as a grain", COLUMNS))
    ids, arrays, said = arrange_grains(what, known, more.get("dim", 3))
    types = arrays.pop("types", None)
    notes += [*said, *_notes_on_columns(what, columns, rest), *further]
    return Packing(name, arrays | more, notes, ids=ids, types=types)


def arrange_grains(
    what: str, known: dict[str, np.ndarray], dim: int = 3, *, volume: float | None = None
) -> tuple[np.ndarray | None, dict, list[str]]:
    """Ids and arrays of grains sorted by id, and notes on missing or contradictory data.

    Parameters
    ----------
    known : columns by the names of `from_arrays`, `radius` or `diameter`, and `id`, `types`, `force`
    volume : volume of a grain of radius 1, for formats in which densities always refer to spheres
    """
    arrays = {n: known[n] for n in ("position", "velocity", "spin", "mass", "types", "force") if n in known}
    arrays["radius"] = known["radius"] if "radius" in known else known["diameter"] / 2
    notes = contradictions(what, known, dim)
    if "mass" not in known:
        density = known.get("density", 1.0)
        arrays |= {"density": density} if volume is None else {"mass": density * volume * arrays["radius"] ** 3}
        notes += [] if "density" in known else [mass_note(what)]
    notes += at_rest(what, known)
    if "id" not in known:
        return None, arrays, notes
    order = np.argsort(known["id"], kind="stable")
    ids = known["id"][order].astype(np.int64)
    return ids, {name: column[order] if np.ndim(column) else column for name, column in arrays.items()}, notes


def _column_of(names: tuple[str, ...], rest: list[str], columns: dict[str, np.ndarray]) -> str | None:
    """The first remaining scalar column with one of these names."""
    return next((name for name in rest if plain_name(name) in names and np.ndim(columns[name]) == 1), None)


def _notes_on_columns(what: str, columns: dict[str, np.ndarray], rest: list[str]) -> list[str]:
    """Account of the columns of a file, and notes on unknown ones.

    Columns of zeros count as harmless. So do accelerations that differ between grains, as contacts contribute to them.
    """
    groups = {name: USED for name in columns if name not in rest}
    for name in rest:
        column = np.atleast_1d(columns[name])
        own = len(column) and re.fullmatch(r"accel.*|a.", plain_name(name)) and np.ptp(column, axis=0).any()
        if np.ndim(columns[name]) and (own or not np.any(column)):
            groups[name] = HARMLESS
    return account_for("column of a table", columns, what, groups, plain_name)


def contradictions(what: str, known: dict[str, np.ndarray], dim: int = 3) -> list[str]:
    """Notes on radii and masses that contradict the diameters and densities of the same grains.

    A factor that all grains share, such as another unit of density, does not change the sign of an eigenvalue.
    """
    radius = known["radius"] if "radius" in known else known["diameter"] / 2
    if not len(radius):
        return []
    pairs = [("radius", "half the diameter", radius, known["diameter"] / 2)] if "diameter" in known else []
    if {"mass", "density"} <= set(known):
        volumes = [4 / 3 * np.pi * radius**3, *([np.pi * radius**2] if dim == 2 else [])]
        weighed = min((known["density"] * volume for volume in volumes), key=lambda m: np.abs(m - known["mass"]).max())
        pairs.append(("mass", "density times volume", known["mass"], weighed))
    notes = []
    for name, other, ours, theirs in pairs:
        k = int(np.argmax(np.abs(ours - theirs)))
        told = f"{what}: {name} is {ours[k]:.4g}, and {other} {theirs[k]:.4g}"
        same = np.ptp(ours * theirs[k] - theirs * ours[k]) <= CLOSE * abs(ours[k] * theirs[k])
        if abs(ours[k] - theirs[k]) <= CLOSE * abs(ours[k]):
            continue
        if name == "mass" and same:
            notes.append(Assumption(f"{told}: {name} is used"))
        else:
            notes.append(Obstacle(f"{told}, in row {k + 1} of {len(ours)}: leave out one of them"))
    return notes


def at_rest(what: str, known: dict) -> list[Assumption]:
    """Note stating that motion missing from a file is assumed to be zero."""
    lacking = [word for name, word in (("velocity", "velocities"), ("spin", "spins")) if name not in known]
    if not lacking:
        return []
    how = {"velocities": "not to move", "spins": "not to turn"}[lacking[0]] if len(lacking) == 1 else "to be at rest"
    return [Assumption(f"{what} has no {' and no '.join(lacking)}: the grains are assumed {how}")]


def mass_note(what: str) -> Assumption:
    """Note on missing masses."""
    return Assumption(f"{what} has no masses: a density of 1 is assumed")
