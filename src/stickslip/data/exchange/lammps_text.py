"""LAMMPS text files: data files and dumps of style `custom` and `local` are parsed, and data files are written.

A second file contains the contacts in the format of LAMMPS dumps, as LAMMPS cannot import their memory; `read_packing`
reads it back.
"""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.contacts.jacobian import linearise
from ...core.laws.builtin import SHARP, damping_model
from ...core.measure import contact_velocity, touching
from ...core.readable import pluralize
from ...core.state import SLIDE
from ...core.text import parse_integer, parse_numbers
from ...known import HARMLESS, USED, group_of
from ..run_files import replace_atomically
from ..sample import GROUP, HUGE, WALLS, Absent, Assumption, PackingError, account_for, refusing
from .columns import Packing, arrange_grains, digits_note, first_lines, identify_columns, only_state, read_lines
from .frame import Frame, bounding_box, list_losses, unbonded, without_walls, wrapped_into
from .lammps_bonds import FormattedBonds, bonds_of_data, format_bonds, list_bonds, note_on_bonds

HEADER = re.compile(r"(?m)^[ \t]*([A-Z][A-Za-z /]*?)[ \t]*(?:#[ \t]*(\S.*?)[ \t]*)?$")  # heading of a section
ORDER = ["i", "j", "dist", "dx", "dy", "dz", "fx", "fy", "fz", "tx", "ty", "tz"]  # order of columns of contacts
VOLUME = 4 / 3 * np.pi
AXES = ("x", "y", "z")
FORCE = ("fx", "fy", "fz")
STYLES = {  # columns of the section Atoms; three image flags may follow
    "sphere": "id type diameter density x y z",
    "bpm/sphere": "id molecule type diameter density x y z",
    "atomic": "id type x y z",
    "charge": "id type charge x y z",
    "bond": "id molecule type x y z",
    "angle": "id molecule type x y z",
    "molecular": "id molecule type x y z",
    "full": "id molecule type charge x y z",
    "ellipsoid": "id type flag density x y z",
    "line": "id molecule type flag density x y z",
    "tri": "id molecule type flag density x y z",
    "body": "id type flag mass x y z",
    "dipole": "id type charge x y z mux muy muz",
    "peri": "id type volume density x y z",
}
MOST_IMAGES = 25  # largest number of box periods by which positions are unwrapped
WHOLE = ("id", "molecule", "type", "flag")
NO_WALLS = "no walls were read, as the file contains none; those of `fix wall/gran` are read from a run folder"
RENAMED = "`dump_modify colname` may have renamed them"
SPHERES = "x y z, diameter and density"


class Table(NamedTuple):
    """One time step of a dump: box and columns."""

    step: int
    vectors: np.ndarray  # (3, 3) box vectors as rows [length]
    corner: np.ndarray  # (3,) corner of the box [length]
    periodic: np.ndarray | None  # (3,) bool; None if not in the file
    columns: dict[str, list[str]]  # words, one list per column
    grains: bool = True  # False for a dump of contacts
    items: tuple[str, ...] = ()  # headings except the time step
    file: str = ""  # name of the file, for messages

    def numbers(self, *names: str) -> np.ndarray:
        """(rows, len(names)) columns as numbers; (rows,) for a single name."""
        try:
            values = np.stack([parse_numbers(self.columns[name]) for name in names]).T
        except ValueError:
            raise PackingError(f"{self.file}: column {' or '.join(names)} has entries that are not numbers") from None
        return np.ascontiguousarray(values[:, 0] if len(names) == 1 else values)

    def has(self, *names: str) -> bool:
        """Return True if all columns exist."""
        return all(name in self.columns for name in names)


def read_dump(path: Path, wanted: str | None = None) -> tuple[list[Table], list[int]]:
    """Read time steps of a dump (`wanted`: one of them, "all", or None for the last), and list all step numbers."""
    pieces = read_lines(path).split("ITEM: TIMESTEP")[1:]
    if not pieces:
        raise PackingError(
            f"{path} contains no ITEM: TIMESTEP ({first_lines(path)}): give a dump that LAMMPS wrote as text"
        )
    with refusing(lambda problem: f"{path} is truncated or not a LAMMPS dump ({problem})", IndexError, KeyError):
        steps = [parse_integer(piece.split("\n", 2)[1]) for piece in pieces]
        if wanted not in (None, "all") and wanted not in map(str, steps):
            some = ", ".join(map(str, steps[:6])) + (" …" if len(steps) > 6 else "")
            raise PackingError(f"{path} has no time step {wanted}: it has {some}")
        last = [len(pieces) - 1]
        if wanted is not None:  # the last of several with the same step, as after `reset_timestep`
            last = [k for k, s in enumerate(steps) if wanted in ("all", str(s))][0 if wanted == "all" else -1 :]
        return [parse_step(path, steps[k], pieces[k]) for k in last], steps


def parse_step(path: Path, step: int, piece: str) -> Table:
    """Parse one time step; raise ValueError, IndexError or KeyError if it is truncated."""
    items = {}
    for item in piece.split("ITEM: ")[1:]:
        head, _, body = item.partition("\n")
        name = re.split(r" (?![A-Z]+\b)", head.strip(), maxsplit=1)[0] if head[:3] == "BOX" else head.split()[0]
        items[name] = head, body
    rows = parse_integer(items["NUMBER"][1].split()[0])
    vectors, corner, periodic = _parse_bounds(*items["BOX BOUNDS"])
    head, body = items["ATOMS"] if "ATOMS" in items else items["ENTRIES"]
    names, tokens = head.split()[1:], body.split()
    if len(tokens) != rows * len(names):
        raise ValueError(f"step {step} declares {rows} rows of {len(names)} numbers but has {len(tokens)} numbers")
    columns: dict[str, list[str]] = {}
    for k, name in enumerate(names):
        column = tokens[k :: len(names)]
        if columns.setdefault(name, column) != column:
            raise ValueError(f"step {step} has two columns {name} with different numbers")
    named = tuple(item.split()[0] for item in items)
    return Table(step, vectors, corner, periodic, columns, "ATOMS" in items, named, path.name)


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
    low[0] -= min(0.0, xy, xz, xy + xz)  # the file contains the bounds of the tilted box
    high[0] -= max(0.0, xy, xz, xy + xz)
    low[1] -= min(0.0, yz)
    high[1] -= max(0.0, yz)
    return restricted_box(high - low, xy, xz, yz), low, periodic


def restricted_box(size, xy: float, xz: float, yz: float) -> np.ndarray:
    """(3, 3) vectors, as rows, of LAMMPS's restricted triclinic box; raise ValueError if they do not span one."""
    if not (np.isfinite([*size, xy, xz, yz]).all() and (np.asarray(size) > 0).all()):
        lengths = " ".join(f"{length:g}" for length in size)
        raise ValueError(f"a box of lengths {lengths} along x y z, which must be positive: give low bounds, then high")
    return np.array([[size[0], 0, 0], [xy, size[1], 0], [xz, yz, size[2]]], float)


def add_box(table: Table, arrays: dict, boundary: str | None, notes: list[str]) -> tuple[dict, list[str]]:
    """Add cell, periodic flags and dimension to the arrays."""
    periodic = table.periodic
    if boundary is not None:
        if not re.fullmatch("[pfsm]{3}", boundary):
            raise PackingError(f"boundary must have three letters, such as ppp or ppf, got {boundary!r}")
        given = np.array([letter == "p" for letter in boundary])
        if periodic is not None and (given != periodic).any():
            has = "".join("p" if flag else "f" for flag in periodic)
            notes = [*notes, f"boundary {boundary} replaces that of the file, {has}"]
        periodic = given
    elif periodic is None:
        periodic = np.ones(3, bool)
        missing = "the file does not state periodic directions: all are assumed to be periodic (--boundary)"
        notes = [*notes, Absent(missing)]
    flat = [arrays["position"], arrays.get("velocity", np.zeros((1, 3)))]
    cell = table.vectors.copy()
    if not any(a[:, 2].any() for a in flat):
        arrays, notes = arrays | {"dim": 2}, [*notes, "all grains lie at z = 0: treated as two-dimensional"]
        periodic, cell[2], cell[:2, 2] = periodic & [True, True, False], (0, 0, 1), 0
    if not periodic.all() and arrays.get("dim", 3) == 3:
        axes = " and ".join(np.array(["x", "y", "z"])[~periodic])
        notes = [*notes, Absent(f"the box is open along {axes}: {NO_WALLS}", WALLS)]
    return arrays | ({"cell": cell, "periodic": periodic} if periodic.any() else {}), notes


def packing_from_table(table: Table, path: Path, boundary: str | None = None, said: Sequence[str] = ()) -> Packing:
    """Packing from one time step of a dump of grains, sorted by id; `said` are notes on the file."""
    used = [name for name in table.columns if group_of("column of a dump", name) == USED and name != "type"]
    known, _ = identify_columns({name: table.numbers(name) for name in used})
    known = {name: column for name, column in known.items() if name not in ("velocity", "spin") or column.shape[1] == 3}
    known["position"] = _position(table, path)
    if not {"radius", "diameter"} & set(known):
        raise PackingError(
            f"{path} has columns {' '.join(table.columns)}: radius or diameter is not among them; add one to the dump "
            f"command ({RENAMED}), or convert the run's restart file with write_data"
        )
    known |= {"force": table.numbers(*FORCE)} if table.has(*FORCE) else {}
    if table.has("type") and all(word.isdecimal() for word in table.columns["type"]):
        known["types"] = table.numbers("type").astype(np.int64) - 1
    ids, arrays, notes = arrange_grains(path.name, known, volume=VOLUME)
    words = next(words for name, words in table.columns.items() if name in ("x", "xu", "xs", "xsu"))
    notes = [*digits_note(words), *notes]
    charges = {"q": HARMLESS} if table.has("q") and not table.numbers("q").any() else {}
    notes += account_for("column of a dump", table.columns, path.name, charges)
    notes += account_for("item of a dump", table.items, path.name)
    if ids is not None:
        check_ids(path, ids)
        if len(ids) and ids[-1] > len(ids):
            gaps = f"ids go up to {ids[-1]}, but {len(ids)} grains are in the file"
            notes.append(Absent(f"{gaps}: if it is the dump of a group, others may touch them", GROUP))
    types, force = arrays.pop("types", None), arrays.pop("force", None)
    arrays, notes = add_box(table, arrays, boundary, [*notes, *said])
    return Packing(str(table.step), arrays, notes, table.step, ids, types, force)


def check_ids(path: Path, ids: np.ndarray) -> None:
    """Raise PackingError if two of these sorted ids are the same."""
    if not np.diff(ids).all():
        twice = ids[:-1][np.diff(ids) == 0]
        raise PackingError(
            f"{path} has grain {twice[0]} twice in one time step, so several files or steps were merged: give "
            "the original dump"
        )


def whole_periods(image: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(N, 3) displacements by box images; zero if grains are too far apart for the images of contacts."""
    return image @ vectors if np.abs(image).max(initial=0) <= MOST_IMAGES else np.zeros(image.shape)


def _position(table: Table, path: Path) -> np.ndarray:
    """(N, 3) positions, unwrapped if the columns allow it [length]."""
    vectors, corner = table.vectors, table.corner
    whole = whole_periods(table.numbers("ix", "iy", "iz"), vectors) if table.has("ix", "iy", "iz") else 0.0
    for mark in ("u", "", "su", "s"):
        names = [axis + mark for axis in AXES]
        if table.has(*names):
            position = table.numbers(*names)
            position = corner + position @ vectors if "s" in mark else position
            return position if "u" in mark else position + whole
    raise PackingError(
        f"{path} has columns {' '.join(table.columns)}: it needs x y z, xu yu zu, xs ys zs or xsu ysu zsu ({RENAMED})"
    )


def read_data_file(
    path: Path, frame: str | None = None, boundary: str | None = None, atom_style: str | None = None
) -> list[Packing]:
    """Read the packing of a data file, with the time step −1 if it is unknown.

    Parameters
    ----------
    boundary : three letters as in LAMMPS, such as ppf; all directions are periodic by default
    atom_style : style of the atoms if the section Atoms does not name it; by default, the only one that fits
    """
    text = read_lines(path)
    first = text.partition("\n")[0]
    sections = _split_sections(text.partition("\n")[2])
    head = sections.pop("")[1]
    with refusing(lambda problem: f"{path} is truncated or not a LAMMPS data file ({problem})", IndexError, TypeError):
        if "Atoms" not in sections:
            raise PackingError(f"{path} has no section Atoms ({first_lines(path)}): give a LAMMPS data file, or a dump")
        style, body = sections["Atoms"]
        count = parse_integer(re.search(r"(?m)^\s*(\d+)\s+atoms\b", head)[1])
        labels = _type_labels(sections, "Atom")
        rows = _parse_rows(body, count, "Atoms", labels)
        vectors, corner = _parse_data_box(head)
        names, notes = _columns_of_atoms(path, style, atom_style, rows, head)
        step = re.search(r"timestep = ([^\s,]+)", first)
        box = Table(parse_integer(step[1]) if step else -1, vectors, corner, None, {})
        motion = _parse_rows(sections["Velocities"][1], count, "Velocities") if "Velocities" in sections else None
        bonds = _parse_bonds(sections, head)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    known = dict(zip(names, rows.T, strict=False))
    known |= {"position": np.stack([known[axis] for axis in AXES], axis=1), "types": known["type"].astype(np.int64) - 1}
    if rows.shape[1] == len(names) + 3:
        known["position"] += whole_periods(rows[:, -3:], vectors)
    if motion is not None:
        motion = motion[np.argsort(motion[:, 0], kind="stable")]
        known |= {"velocity": motion[:, 1:4]} | ({"spin": motion[:, 4:7]} if motion.shape[1] >= 7 else {})
    check_ids(path, rows[:, 0])
    ids, arrays, said = arrange_grains(path.name, known, volume=VOLUME)
    listed = list_bonds(path.name, ids, *bonds)
    try:
        setting, why = bonds_of_data(head, listed), ""
    except (ValueError, IndexError, TypeError) as problem:
        setting, why = None, str(problem)
    said += [] if setting else note_on_bonds(listed, why)
    notes += [*said, *account_for("section", sections, path.name)]
    notes += account_for("heading of a data file", _headings(head), path.name)
    only_state(path, frame)
    types, numbers = arrays.pop("types"), {label: int(number) for label, number in labels.items()}
    arrays, notes = add_box(box, arrays, boundary, notes)
    return [Packing(str(box.step), arrays, notes, box.step, ids, types, setting=setting, labels=numbers, bonds=listed)]


def _type_labels(sections: dict[str, tuple[str | None, str]], kind: str) -> dict[str, str]:
    """Numbers of atom or bond types by label."""
    name = f"{kind} Type Labels"
    return dict(line.split()[1::-1] for line in sections[name][1].strip().split("\n")) if name in sections else {}


def _parse_bonds(sections: dict[str, tuple[str | None, str]], head: str):
    """Types and ends of bonds in a data file, and type labels; raise ValueError if their number is not as declared."""
    given, labels = re.search(r"(?m)^\s*(\d+)\s+bonds\b", head), _type_labels(sections, "Bond")
    count = parse_integer(given[1]) if given else 0
    if not count and "Bonds" not in sections:
        return np.zeros(0, np.int64), np.zeros((0, 2), np.int64), labels
    rows = _parse_rows(sections.get("Bonds", ("", ""))[1], count, "Bonds", labels, "bonds").reshape(count, -1)
    if rows.shape[1] != 4 or (rows != np.round(rows)).any():
        raise ValueError("section Bonds must have four whole numbers in a line: a number, the type and two atoms")
    return rows[:, 1].astype(np.int64), rows[:, 2:].astype(np.int64), labels


def _headings(head: str) -> list[str]:
    """Names of the header lines, except those with a count of zero."""
    lines = [line.partition("#")[0].split() for line in head.split("\n")]
    words = [[word for word in line if not re.fullmatch(r"[-+.\d]+([eE][-+]?\d+)?", word)] for line in lines]
    counts = zip(words, lines, strict=True)
    return [" ".join(name) for name, line in counts if name and not (line[0] == "0" and len(line) == len(name) + 1)]


def _columns_of_atoms(
    path: Path, style: str | None, asked: str | None, rows: np.ndarray, head: str
) -> tuple[list[str], list[str]]:
    """Names of the columns of the section Atoms, and a note if its style was inferred."""
    if asked and style not in (None, asked, asked.split()[0]):
        raise PackingError(f"atom_style = {asked!r} contradicts {path}, whose atoms are of style {style}: leave it out")
    if kind := asked or style:
        names = style_columns(kind, rows.shape[1])
        if names is None or "diameter" not in names or rows.shape[1] - len(names) not in (0, 3):
            shown = " ".join(names) if names else "unknown"
            raise PackingError(
                f"{path} has atoms of style {kind} with {rows.shape[1]} columns ({shown}): atom_style sphere is "
                f"supported, and others with {SPHERES}, such as hybrid sphere bond; name the parts of a hybrid style "
                "with --atom-style"
            )
        return names, []
    # the only style that fits the rows
    types = re.search(r"(?m)^\s*(\d+)\s+atom\s+types\b", head)
    most = int(types[1]) if types else np.inf
    fits = [style for style in STYLES if _fits(STYLES[style].split(), style, rows, most, head)]
    if fits in (["sphere"], ["bpm/sphere"]):
        return STYLES[fits[0]].split(), [Assumption(f"the section Atoms names no style: {fits[0]} is assumed")]
    if "sphere" in fits:
        raise PackingError(
            f"{path} does not name the style of its atoms, whose {rows.shape[1]} columns could be those of "
            f"{', '.join(fits[:-1])} or {fits[-1]}: give --atom-style sphere (atom_style in Python) if the third "
            f"column is the diameter"
        )
    which = f"could be those of {' or '.join(fits)}" if fits else "fit no style that is known here"
    raise PackingError(
        f"{path} does not name the style of its atoms, whose {rows.shape[1]} columns {which}: {SPHERES} are needed, as "
        f"write_data writes them for atom_style sphere"
    )


def style_columns(style: str, width: int) -> list[str] | None:
    """Columns of an atom style; hybrid styles begin with the common columns. None for an unknown style."""
    kind, *parts = style.split()
    if kind != "hybrid":
        return STYLES[kind].split() if kind in STYLES else None
    if not parts and width in (7, 10):
        parts = ["sphere"]
    if not parts or not set(parts) <= set(STYLES):
        return None
    own = [name for part in parts for name in STYLES[part].split() if name not in ("id", "type", *AXES)]
    return list(dict.fromkeys(["id", "type", *AXES, *own]))


def _fits(names: list[str], style: str, rows: np.ndarray, types: float, head: str) -> bool:
    """Return True if rows fit a style: whole numbers, types and positive sizes in its columns."""
    if rows.shape[1] - len(names) not in (0, 3) or style == "peri":
        return False
    part = dict(zip(names, rows.T, strict=False))
    whole = all((part[name] == np.round(part[name])).all() for name in names if name in WHOLE)
    images = (rows[:, len(names) :] == np.round(rows[:, len(names) :])).all()
    sizes = all((part[name] > 0).all() for name in ("diameter", "density", "mass") if name in part)
    kind = bool(((part["type"] >= 1) & (part["type"] <= types)).all())
    flagged = "flag" in part and part["flag"].any()
    shaped = not flagged or bool(re.search(rf"(?m)^\s*\d+\s+{PLURAL.get(style)}\b", head))
    return bool(whole and images and sizes and kind and shaped)


PLURAL = {"ellipsoid": "ellipsoids", "line": "lines", "tri": "triangles", "body": "bodies"}


def _split_sections(text: str) -> dict[str, tuple[str | None, str]]:
    """Split a data file into its header and its sections, keyed by name, each with the comment in its heading."""
    sections, name, hint, start = {}, "", None, 0
    for mark in HEADER.finditer(text):
        sections[name] = hint, text[start : mark.start()]
        name, hint, start = mark[1], mark[2], mark.end()
    sections[name] = hint, text[start:]
    return sections


def _parse_rows(
    body: str, rows: int, name: str, labels: dict[str, str] | None = None, what: str = "atoms"
) -> np.ndarray:
    lines = body.strip().split("\n")
    if "#" in body:
        lines = [line.partition("#")[0] for line in lines]
    lines = [line for line in lines if line.strip()]
    if len(lines) != rows:
        raise ValueError(f"section {name} has {len(lines)} lines but the file declares {rows} {what}")
    tokens = " ".join(lines).split()
    values = parse_numbers([labels.get(word, word) for word in tokens] if labels else tokens).reshape(rows, -1)
    if not (np.abs(values) < HUGE).all():
        raise ValueError(f"section {name} contains NaN, infinity or numbers beyond {HUGE:g}")
    return values


def _parse_data_box(head: str) -> tuple[np.ndarray, np.ndarray]:
    def line(*names):
        match = re.search(r"(?m)^\s*(.+?)\s+" + r"\s+".join(names) + r"\b", head)
        values = None if match is None else parse_numbers(match[1].split())
        if values is not None and not (np.abs(values) < HUGE).all():
            raise ValueError(f"the box has {match[0].strip()!r}")
        return values

    general = [line(name) for name in ("avec", "bvec", "cvec")]
    if all(v is not None for v in general):
        return np.array(general), line("abc", "origin")
    bounds = np.array([line(f"{axis}lo", f"{axis}hi") for axis in AXES])
    tilt = line("xy", "xz", "yz")
    return restricted_box(bounds[:, 1] - bounds[:, 0], *((0, 0, 0) if tilt is None else tilt)), bounds[:, 0]


def contacts_path(path: Path) -> Path:
    """Path of the contacts of a data file: packing.contacts.dump for packing.data."""
    return path.with_name(f"{path.stem}.contacts.dump")


def write_lammps(path: str | Path, frame: Frame) -> list[str]:
    """Write a data file and its contacts; return notes on data that they do not store."""
    path, held = Path(path), format_bonds(frame.state) if frame.state.bonds else None
    frame = unbonded(frame)
    state = frame.state
    vectors, corner = bounding_box(state, "LAMMPS")
    if state.cell.dim == 2:
        vectors, corner = vectors.copy(), corner.copy()
        vectors[2], corner[2] = (0, 0, 1), -0.5
    notes = [f"LAMMPS data files do not store {', '.join(lost)}" for lost in [list_losses(frame)] if lost]
    if not state.cell.periodic[: state.cell.dim].all():
        letters = "".join("p" if p else "f" for p in state.cell.periodic[: state.cell.dim]) + "p" * (3 - state.cell.dim)
        notes.append(f"LAMMPS data files do not store periodic directions: use `boundary {' '.join(letters)}`")
    i0 = state.grains.inertia / (state.grains.mass * state.grains.radius**2)
    if np.abs(i0 - 0.4).max() > 1e-12:
        notes.append(
            "LAMMPS uses the moment of inertia of spheres, 2/5 m R², or with `disc` 1/2 m R²: set it here with --i0"
        )
    if state.grains.angle.any():
        notes.append("LAMMPS data files do not store angles")
    with replace_atomically(path) as part:
        part.write_text(_format_data(frame, vectors, corner, held), encoding="utf-8")
        notes += _write_contacts(contacts_path(path), frame, vectors, corner)
    return [*notes, *(held.notes if held else [])]


def _format_rows(rows) -> list[str]:
    """Format rows of numbers so that they can be read back exactly, to the last bit."""
    return [" ".join(map(repr, row)) for row in rows]


def _format_data(frame: Frame, vectors, corner, held: FormattedBonds | None) -> str:
    before, after, counts, sections, _ = held or FormattedBonds([], [], [], [], [])
    state, grains = frame.state, frame.state.grains
    inside, image = wrapped_into(grains.position, vectors, corner, state.cell.periodic)
    size, tilt = np.diag(vectors), (vectors[1, 0], vectors[2, 0], vectors[2, 1])
    density = grains.mass / (VOLUME * grains.radius**3)
    numbers = _format_rows(np.column_stack([2 * grains.radius, density, inside]).tolist())
    whole = _format_rows(image.tolist())
    kinds = (grains.material + 1).tolist()
    molecule = "0 " if before else ""
    atoms = [f"{k} {molecule}{t} {a} {b}" for k, (t, a, b) in enumerate(zip(kinds, numbers, whole, strict=True), 1)]
    motion = _format_rows(np.hstack([grains.velocity, grains.spin]).tolist())
    head = [f"LAMMPS data file of grains, timestep = 0, written by stickslip ({state.cell.dim} dimensions)"]
    head += [f"# {command}" for command in [*before, *(["read_data FILE"] if before else []), *after]] + [""]
    head += [f"{len(kinds)} atoms", f"{max(kinds)} atom types", *counts, ""]
    head += [f"{float(c)!r} {float(c + s)!r} {a}lo {a}hi" for c, s, a in zip(corner, size, "xyz", strict=True)]
    if any(tilt):
        head.append(" ".join(repr(float(t)) for t in tilt) + " xy xz yz")
    moving = ["", "Velocities", "", *(f"{k} {row}" for k, row in enumerate(motion, 1))]
    style = "bpm/sphere" if before else "sphere"
    return "\n".join([*head, "", f"Atoms # {style}", "", *atoms, *moving, *sections, ""])


def _write_contacts(path: Path, frame: Frame, vectors, corner) -> list[str]:
    """Write the contacts between grains as `compute pair/local` does; return notes on omitted data."""
    state, law = frame.state, frame.law
    pairs, notes = without_walls(frame)
    if law.coulomb != SHARP:
        return [*notes, "friction is sharp in LAMMPS but smooth in this law: the memory of contacts is not written"]
    rows = touching(state)
    rows = rows[state.contacts.j[rows] < len(state.grains.radius)]
    c = linearise(state, law)
    vn, vt = contact_velocity(state, rows, c.normal[rows])
    normal = (c.force_n[rows] - c.damping_n[rows] * vn)[:, None] * c.normal[rows]
    tangential = pairs["tangential"] - c.damping_t[rows, None] * vt
    length = np.linalg.norm(pairs["branch"], axis=1)
    numbers = _format_rows(np.column_stack([length, pairs["branch"], normal, tangential]).tolist())
    ends = zip((pairs["i"] + 1).tolist(), (pairs["j"] + 1).tolist(), numbers, strict=True)
    flags = ["pp" if p else "ff" for p in state.cell.periodic]
    xy, xz, yz = vectors[1, 0], vectors[2, 0], vectors[2, 1]
    low, high = corner.copy(), corner + np.diag(vectors)
    low[0] += min(0.0, xy, xz, xy + xz)
    high[0] += max(0.0, xy, xz, xy + xz)
    low[1] += min(0.0, yz)
    high[1] += max(0.0, yz)
    bounds = _format_rows(np.column_stack([low, high, (xy, xz, yz)]).tolist())
    head = ["ITEM: TIMESTEP", "0", "ITEM: NUMBER OF ENTRIES", str(len(rows))]
    head += [f"ITEM: BOX BOUNDS xy xz yz {' '.join(flags)}", *bounds, f"ITEM: ENTRIES {' '.join(ORDER)}"]
    with replace_atomically(path) as part:
        part.write_text("\n".join([*head, *(f"{i} {j} {row}" for i, j, row in ends), ""]), encoding="utf-8")
    sliding = int(((pairs["mode"] == SLIDE) & (vt.any(axis=1) | (vn != 0))).sum())
    if damping_model(law) and sliding:
        notes.append(
            f"the slip of {pluralize(sliding, 'sliding contact')} in motion is stored without the part of the force "
            "in dashpots"
        )
    back = f"read it back with --contacts {shlex.quote(str(path))}"
    return [*notes, f"LAMMPS cannot import the memory of contacts, which is in {path.name}: {back}"]
