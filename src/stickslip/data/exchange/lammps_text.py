"""Parsing of LAMMPS text files: data files of `atom_style sphere`, and dumps of `custom` and `local` style."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.text import parse_integer, parse_numbers, read_text
from ..sample import HUGE, PackingError

HEADER = re.compile(r"(?m)^\s*([A-Z][A-Za-z /]*?)\s*(?:#\s*(\S+)\s*)?$")  # of a section in a data file
VOLUME = 4 / 3 * np.pi
AXES = ("x", "y", "z")
VELOCITY, SPIN = ("vx", "vy", "vz"), ("omegax", "omegay", "omegaz")


class Table(NamedTuple):
    """One time step of a dump: box and columns."""

    step: int
    vectors: np.ndarray  # (3, 3) box vectors as rows [length]
    corner: np.ndarray  # (3,) of the box [length]
    periodic: np.ndarray | None  # (3,) bool; None if the file does not say
    columns: dict[str, list[str]]  # words, one list per column

    def numbers(self, *names: str) -> np.ndarray:
        """(rows, len(names)) columns as numbers; (rows,) for a single name."""
        try:
            found = np.stack([parse_numbers(self.columns[name]) for name in names]).T
        except ValueError:
            raise PackingError(f"column {' or '.join(names)} contains entries that are not numbers") from None
        return np.ascontiguousarray(found[:, 0] if len(names) == 1 else found)

    def has(self, *names: str) -> bool:
        """Return True if all columns exist."""
        return all(name in self.columns for name in names)


def read_dump(path: Path, wanted: str | None = None) -> tuple[list[Table], list[int]]:
    """Read time steps of a dump (`wanted`: one of them, "all", or None for the last), and list all step numbers."""
    pieces = _read_text(path).split("ITEM: TIMESTEP")[1:]
    if not pieces:
        raise PackingError(f"{path} contains no ITEM: TIMESTEP: give a dump that LAMMPS wrote as text")
    try:
        steps = [parse_integer(piece.split("\n", 2)[1]) for piece in pieces]
        if wanted not in (None, "all") and wanted not in map(str, steps):
            some = ", ".join(map(str, steps[:6])) + (" …" if len(steps) > 6 else "")
            raise PackingError(f"{path} has no time step {wanted}: it has {some}")
        chosen = [k for k, s in enumerate(steps) if wanted == "all" or (wanted is not None and str(s) == wanted)]
        return [parse_step(steps[k], pieces[k]) for k in (chosen or [len(pieces) - 1])], steps
    except (ValueError, IndexError, KeyError) as problem:
        if isinstance(problem, PackingError):
            raise
        raise PackingError(f"{path} is truncated or not a LAMMPS dump ({problem})") from None


def _read_text(path: Path) -> str:
    try:
        text = read_text(path, remedy="give LAMMPS files as text, not binary or compressed")
    except ValueError as problem:
        raise PackingError(str(problem)) from None
    if text and not text.endswith("\n"):  # a truncated number is still a number
        raise PackingError(f"{path} ends in the middle of a line: it is truncated, or its last line has no newline")
    return text


def parse_step(step: int, piece: str) -> Table:
    """Parse one time step; ValueError, IndexError or KeyError if it is truncated."""
    items = {}
    for item in piece.split("ITEM: ")[1:]:
        head, _, body = item.partition("\n")
        items[re.split(r" (?![A-Z]+\b)", head.strip(), maxsplit=1)[0] if head[:3] == "BOX" else head.split()[0]] = (
            head,
            body,
        )
    rows = parse_integer(items["NUMBER"][1].split()[0])
    vectors, corner, periodic = _parse_bounds(*items["BOX BOUNDS"])
    head, body = items["ATOMS"] if "ATOMS" in items else items["ENTRIES"]
    names, words = head.split()[1:], body.split()
    if len(words) != rows * len(names):
        raise ValueError(f"step {step} declares {rows} rows of {len(names)} numbers but has {len(words)} numbers")
    if len(set(names)) != len(names):
        raise ValueError(f"step {step} has two columns with the same name")
    return Table(step, vectors, corner, periodic, {name: words[k :: len(names)] for k, name in enumerate(names)})


def _parse_bounds(head: str, body: str):
    """Vectors, corner and periodic flags of ITEM: BOX BOUNDS in any of its variants."""
    marks = head.split()[2:]
    flags = [mark for mark in marks if len(mark) == 2 and set(mark) <= set("pfsm")]
    periodic = np.array([mark == "pp" for mark in flags]) if len(flags) == 3 else None
    rows = np.array([parse_numbers(line.split()) for line in body.strip().split("\n")[:3]])
    if "abc" in marks and rows.shape == (3, 4):  # general triclinic
        return rows[:, :3].copy(), rows[:, 3].copy(), periodic
    if rows.shape not in ((3, 2), (3, 3)):
        raise ValueError(f"a box of shape {rows.shape}")
    xy, xz, yz = rows[:, 2] if rows.shape[1] == 3 else (0.0, 0.0, 0.0)
    low, high = rows[:, 0].copy(), rows[:, 1].copy()
    low[0] -= min(0.0, xy, xz, xy + xz)  # the file has the bounds of the tilted box
    high[0] -= max(0.0, xy, xz, xy + xz)
    low[1] -= min(0.0, yz)
    high[1] -= max(0.0, yz)
    return restricted_box(high - low, xy, xz, yz), low, periodic


def restricted_box(size, xy: float, xz: float, yz: float) -> np.ndarray:
    """(3, 3) vectors, as rows, of LAMMPS's restricted triclinic box."""
    return np.array([[size[0], 0, 0], [xy, size[1], 0], [xz, yz, size[2]]], float)


def grains_from_dump(table: Table, path: Path) -> tuple[np.ndarray | None, dict, list[str]]:
    """Ids, arrays for `from_arrays` and notes from a dump of grains, sorted by id."""
    words, arrays = [], {"position": _position(table, path)}
    if table.has("radius") or table.has("diameter"):
        arrays["radius"] = table.numbers("radius") if table.has("radius") else table.numbers("diameter") / 2
    else:
        raise PackingError(f"{path} has no column radius or diameter: add one to the dump command")
    if table.has("mass"):
        arrays["mass"] = table.numbers("mass")
    elif table.has("density"):
        arrays["mass"] = table.numbers("density") * VOLUME * arrays["radius"] ** 3
    else:
        words.append(f"{path.name} has no column mass: all masses are set to 1")
    for name, columns in (("velocity", VELOCITY), ("spin", SPIN)):
        if table.has(*columns):
            arrays[name] = table.numbers(*columns)
    ids = table.numbers("id").astype(np.int64) if table.has("id") else None
    if ids is not None:
        order = np.argsort(ids, kind="stable")
        ids, arrays = ids[order], {name: column[order] for name, column in arrays.items()}
    return ids, arrays, words


def _position(table: Table, path: Path) -> np.ndarray:
    """(N, 3) positions, unwrapped if the columns allow it [length]."""
    vectors, corner = table.vectors, table.corner
    whole = table.numbers("ix", "iy", "iz") @ vectors if table.has("ix", "iy", "iz") else 0.0
    for mark in ("u", ""):
        if table.has(*(axis + mark for axis in AXES)):
            place = table.numbers(*(axis + mark for axis in AXES))
            return place if mark else place + whole
    for mark in ("su", "s"):
        if table.has(*(axis + mark for axis in AXES)):
            place = corner + table.numbers(*(axis + mark for axis in AXES)) @ vectors
            return place + (whole if mark == "s" else 0.0)
    raise PackingError(f"{path} has no positions: it needs columns x y z, xu yu zu, xs ys zs or xsu ysu zsu")


def read_data(path: Path, asked: str | None = None) -> tuple[np.ndarray, dict, Table, list[str]]:
    """Read ids, arrays for `from_arrays`, the box (with the time step, −1 if unknown) and notes from a data file.

    Its atom style is the one that its section Atoms names, or else the one `asked` for.
    """
    text = _read_text(path)
    first = text.partition("\n")[0]
    sections = _split_sections(text.partition("\n")[2])
    head = sections.pop("")[1]
    try:
        if "Atoms" not in sections:
            raise PackingError(f"{path} has no section Atoms: give a LAMMPS data file, or a dump")
        style, body = sections["Atoms"]
        count = parse_integer(re.search(r"(?m)^\s*(\d+)\s+atoms\b", head)[1])
        rows = _parse_rows(body, count, "Atoms")
        words = _check_style(path, style, asked, rows)
        vectors, corner = _parse_data_box(head)
        step = re.search(r"timestep = ([^\s,]+)", first)
        box = Table(parse_integer(step[1]) if step else -1, vectors, corner, None, {})
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        motion = _parse_rows(sections["Velocities"][1], count, "Velocities") if "Velocities" in sections else None
    except (ValueError, IndexError, TypeError) as problem:
        if isinstance(problem, PackingError):
            raise
        raise PackingError(f"{path} is truncated or not a LAMMPS data file ({problem})") from None
    radius = rows[:, 2] / 2
    arrays = {"position": rows[:, 4:7], "radius": radius, "mass": rows[:, 3] * VOLUME * radius**3}
    if rows.shape[1] == 10:
        arrays["position"] = arrays["position"] + rows[:, 7:] @ vectors
    if motion is not None and motion.shape[1] == 7:
        motion = motion[np.argsort(motion[:, 0], kind="stable")]
        arrays |= {"velocity": motion[:, 1:4], "spin": motion[:, 4:7]}
    return rows[:, 0].astype(np.int64), arrays, box, words


def _check_style(path: Path, style: str | None, asked: str | None, rows: np.ndarray) -> list[str]:
    """Return a note if a style is assumed; raise PackingError for atoms that are, or may be, of another one.

    The styles full, ellipsoid and body have as many columns as sphere, but whole numbers in place of the diameter.
    """
    if asked and style not in (None, asked):
        raise PackingError(f"atom_style = {asked!r} was given, but {path} names atoms of style {style}: leave it out")
    if style not in (None, "sphere") or rows.shape[1] not in (7, 10):
        raise PackingError(
            f"{path} has atoms of style {style or 'unknown'} with {rows.shape[1]} columns: atom_style sphere is "
            f"supported, with id type diameter density x y z and optionally ix iy iz"
        )
    if style or asked:
        return []
    if (rows[:, 2] == np.round(rows[:, 2])).all():
        raise PackingError(
            f"{path} does not name the style of its atoms, whose third column has whole numbers, as in other styles: "
            f"give --atom-style sphere (atom_style in Python) if it is the diameter"
        )
    return ["the section Atoms names no style: sphere is assumed"]


def _split_sections(text: str) -> dict[str, tuple[str | None, str]]:
    """Split a data file into its header and its sections, keyed by name, each with the comment in its heading."""
    found, name, hint, start = {}, "", None, 0
    for mark in HEADER.finditer(text):
        found[name] = hint, text[start : mark.start()]
        name, hint, start = mark[1], mark[2], mark.end()
    found[name] = hint, text[start:]
    return found


def _parse_rows(body: str, rows: int, name: str) -> np.ndarray:
    lines = body.strip().split("\n")
    if "#" in body:
        lines = [line.partition("#")[0] for line in lines]
    lines = [line for line in lines if line.strip()]
    if len(lines) != rows:
        raise ValueError(f"section {name} has {len(lines)} lines but the file declares {rows} atoms")
    values = parse_numbers(" ".join(lines).split()).reshape(rows, -1)
    if not (np.abs(values) < HUGE).all():
        raise ValueError(f"section {name} contains NaN, infinity or numbers beyond {HUGE:g}")
    return values


def _parse_data_box(head: str) -> tuple[np.ndarray, np.ndarray]:
    def line(*names):
        found = re.search(r"(?m)^\s*(.+?)\s+" + r"\s+".join(names) + r"\b", head)
        values = None if found is None else parse_numbers(found[1].split())
        if values is not None and not (np.abs(values) < HUGE).all():
            raise ValueError(f"the box has {found[0].strip()!r}")
        return values

    general = [line(name) for name in ("avec", "bvec", "cvec")]
    if all(v is not None for v in general):
        return np.array(general), line("abc", "origin")
    bounds = np.array([line(f"{axis}lo", f"{axis}hi") for axis in AXES])
    tilt = line("xy", "xz", "yz")
    return restricted_box(bounds[:, 1] - bounds[:, 0], *((0, 0, 0) if tilt is None else tilt)), bounds[:, 0]
