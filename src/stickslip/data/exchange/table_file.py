"""Packings as text: CSV and other tables, MercuryDPM's .data, extended XYZ, EDEM exports, jamBashBulk, PackLSD, MFIX.

Extended XYZ files, for ASE and OVITO, store the grains as atoms of species X, further columns, the cell and the law.
They are written without ASE, which would write only eight decimals.

Sources: MUSEN's reader of EDEM exports; `Pack_Nomenclature.md` of jamBashBulk; A. Donev's instructions for PackLSD;
the routine READ_PART_INPUT_V2P0 of MFIX.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...core.state import SLIDE
from ...core.tables import split_rows, write_table
from ...core.text import parse_numbers
from ..run_files import replace_atomically
from ..sample import COLUMNS, NO_CONTACTS, Assumption, Obstacle, PackingError, refusing
from .columns import (
    HEAD,
    LENGTHS,
    NEEDED,
    TIMES,
    UNIT,
    Packing,
    choice_note,
    chosen_frames,
    extent_note,
    first_lines,
    head_text,
    identify_columns,
    names_by_content,
    only_state,
    packing_of_columns,
    plain_name,
    read_content,
    read_lines,
    split_frames,
)
from .frame import Frame, exported, law_from_dict, law_to_dict, list_losses

MERCURY = {  # numbers in the header, and numbers of columns
    8: ["x", "y", "z", "vx", "vy", "vz", "r", "a", "b", "g", "wx", "wy", "wz", "info"],
    6: ["x", "y", "vx", "vy", "r", "a", "w", "info"],
}  # fmt: skip
COMMENT = ("#", "%")
TOTALS = re.compile(r"(grand )?totals?|sums?|means?|averages?|mittelwert|summe|count|min|max|std|end", re.IGNORECASE)
LAYOUTS = "x y z radius, id x y z radius or id x y radius with ids that count the rows, and those of MFIX and PeGS2"
NUMBER = re.compile(r"[-+.\d]+(e[-+]?\d+)?|nan|[-+]?inf")


def recognize(head: bytes) -> bool:
    """Return True for a table whose first line names positions and radii, or whose unnamed columns describe grains."""
    text = head_text(head)[:4000]
    lines = _content_lines(text)
    if not lines:
        return False
    names = names_of(lines[0])
    if names is not None:
        return has_grains(names) or lines[0].startswith("#format")
    width = len(_split(lines[0]))
    if width == 4:
        return True
    whole = lines[: max(1, len(lines) - (not text.endswith("\n")))]  # the last line may be cut off
    rows = [_split(line) for line in whole if names_of(line) is None]
    if any(len(row) != width for row in rows):
        return False
    try:
        numbers = np.array([[float(word.replace(",", ".")) for word in row] for row in rows])
    except ValueError:  # a damaged number
        return False
    return names_by_content(numbers) is not None


def has_grains(names: list[str] | None) -> bool:
    """Return True if the names include those of positions and radii."""
    arrays, _ = identify_columns(dict.fromkeys(names or [], np.zeros(0)))
    return "position" in arrays and bool({"radius", "diameter"} & set(arrays))


def read(path: Path, frame: str | None = None) -> list[Packing]:
    """Read the grains of a table, or of each of its time steps if there is a column of times."""
    columns, notes = read_columns(path)
    ids = identify_columns(columns)[0].get("id")
    times = next((values for name, values in columns.items() if _are_times(name, values, ids)), None)
    if times is None:
        only_state(path, frame)
        packings = [packing_of_columns(columns, path.name, path.stem)]
    else:
        steps = np.unique(times)
        names = [f"{step:g}" for step in steps]
        chosen = chosen_frames(path, names, frame)
        parts = [{name: values[times == steps[k]] for name, values in columns.items()} for k in chosen]
        packings = [packing_of_columns(part, path.name, names[k]) for k, part in zip(chosen, parts, strict=True)]
        notes = [*notes, *choice_note(path, names, frame, "time steps")]
    more = Assumption(extent_note(path.name))
    return [packing._replace(notes=[*notes, *packing.notes, more]) for packing in packings]


def _are_times(name: str, values: np.ndarray, ids: np.ndarray | None) -> bool:
    """Return True for a column of times, each in several rows, and sorted unless there are ids."""
    counts = np.unique(values, return_counts=True)[1]
    if plain_name(name) not in TIMES or len(counts) < 2:
        return False
    if ids is None:
        return counts.min() > 1 and bool((np.diff(values) >= 0).all())
    pairs = np.unique(np.stack([ids, values]), axis=1)
    return len(np.unique(ids)) < len(ids) == pairs.shape[1]


def read_columns(
    path: Path, nameless: dict[int, list[str]] | None = None, heads: Callable = has_grains
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns of a table by name, or by content if it has no names, and notes on assumptions.

    Incomplete rows, and totals below the grains, are left out. Lengths in several units are converted to the first
    unit.

    Parameters
    ----------
    nameless : names of unnamed columns by the number of columns; default: by content
    heads : function that returns True if names in a comment are those of the columns
    """
    lines = _content_lines(read_lines(path, fallback="cp1252"), heads)
    names = names_of(lines[0]) if lines else None
    if nameless is not None and not lines:
        raise PackingError(f"{path} has no rows: it is empty, or contains only comments")
    named, notes = names is not None, []
    if not named and nameless is not None and lines and (names := nameless.get(len(_split(lines[0])))) is None:
        allowed = " or ".join(f"{n} ({' '.join(known)})" for n, known in nameless.items())
        raise PackingError(
            f"{path} has {len(_split(lines[0]))} columns without names: {allowed} are recognised, others need names"
        )
    below = [line for line in lines[named:] if not line.startswith(COMMENT)]
    while len(below) > 1 and TOTALS.fullmatch(next(filter(None, _split(below[-1])), "").strip(" :.")):
        notes.append(Assumption(f"{path.name}: the last row, {below[-1][:40]!r}, is treated as a total and left out"))
        below.pop()
    rows = _numbers(path, below, len(names or (_split(lines[0]) if lines else ())))
    if len(rows) and (empty := np.isnan(rows).all(axis=1)).any() and not empty.all():
        without = f"{path.name} has {empty.sum()} of {len(rows)} rows without a number: left out"
        notes.append(Assumption(without, COLUMNS))
        rows = rows[~empty]
    if names is None and (names := names_by_content(rows)) is None:
        raise PackingError(
            f"{path} has {rows.shape[1]} columns without names: {LAYOUTS} are recognised, others need names"
        )
    if not named:
        notes.append(Assumption(f"{path.name} does not name its columns: {' '.join(names)} is assumed", COLUMNS))
    columns = {name: values for name, values in zip(names, rows.T, strict=True) if name or np.isfinite(values).any()}
    return columns, [*notes, *_convert_lengths(path, columns)]


def _content_lines(text: str, heads: Callable = has_grains) -> list[str]:
    """Lines with content; comments before the data are dropped, unless they name its columns."""
    lines = [line.strip() for line in text.split("\n") if line.strip()]
    first = next((k for k, line in enumerate(lines) if not line.startswith(COMMENT)), len(lines))
    named = next((k for k in range(first - 1, -1, -1) if heads(names_of(lines[k]))), None)
    return lines[first if named is None else named :]


def _separator(line: str) -> str | None:
    """Separator of the entries of a line; None stands for white space, which permits decimal commas in numbers."""
    mark = next((mark for mark in ";\t," if mark in line), None)
    return None if mark == "," and re.search(r"\d\s+[-+.]?\d", line) else mark


def _split(line: str) -> list[str]:
    """Entries of a line separated by commas, semicolons, tabs or spaces."""
    mark = _separator(line)
    return [word.strip().strip('"') for word in (line.split(mark) if mark else line.split())]


def names_of(line: str) -> list[str] | None:
    """Names of columns in a line; None if the line has numbers."""
    fields = _split(line.lstrip("#%").strip())
    if line.startswith("#format"):
        fields = line.split()[1].split("_") if len(line.split()) > 1 else []
    return None if not fields or all(NUMBER.fullmatch(word.lower().replace(",", ".")) for word in fields) else fields


def _convert_lengths(path: Path, columns: dict[str, np.ndarray]) -> list[str]:
    """Convert lengths in place to the unit of the first column; return a note; an unknown unit raises PackingError."""
    found = {name: UNIT.search(name) for name in columns if plain_name(name) in LENGTHS}
    units = {name: (match[1] or match[2]).strip().lower() for name, match in found.items() if match}
    if len(set(units.values())) < 2:
        return []
    from ..laboratory_table import LENGTH

    if not set(units.values()) <= set(LENGTH) or len(units) < len(found):
        several = " and ".join(dict.fromkeys(units.values()))
        raise PackingError(f"{path} has lengths in {several} ({' '.join(found)}): give them in one unit")
    first, *_ = units.values()
    changed = [name for name, unit in units.items() if unit != first]
    for name in changed:
        columns[name] = columns[name] * (LENGTH[units[name]] / LENGTH[first])
    return [Assumption(f"{path.name} has lengths in several units: {', '.join(changed)} converted to {first}", COLUMNS)]


def _numbers(path: Path, lines: list[str], width: int) -> np.ndarray:
    """(rows, width) numbers in lines of equal length; commas are decimal unless they separate entries."""
    with refusing():
        mark = _separator(lines[0]) if lines else None
        rows = [row for _, row in split_rows(path, list(enumerate(lines, 1)), mark)]
    for number, row in enumerate(rows, 1):
        if len(row) != width:
            raise PackingError(f"{path} has {len(row)} entries in row {number}, but {width} columns: it is damaged")
    return _parse(path, [word or "nan" for row in rows for word in row], "correct it", (-1, width))


def recognize_mercury(head: bytes) -> bool:
    """Return True for a MercuryDPM .data file: the number of grains, the time and the domain, then the grains."""
    lines = head_text(head).split("\n")
    names = MERCURY.get(len(lines[0].split()))
    if names is None or len(lines) < 2 or names_of(lines[0]) is not None:
        return False
    return len(lines[1].split()) in (len(names), 0)


def read_mercury(path: Path, frame: str | None = None) -> list[Packing]:
    """Read time steps of a MercuryDPM .data file, which are named by their number."""
    packings = []
    walls = "no walls and periodic boundaries were read, as MercuryDPM's .data has none; they are in its .restart"
    notes = [Assumption(walls), Assumption(extent_note(path.name))]
    needed = "N t and the domain are needed, as in MercuryDPM"
    for name, lines in split_frames(path, frame, MERCURY, 1, "time step", needed):
        names = MERCURY[len(lines[0].split())]
        rows = _numbers(path, lines[1:], len(names))
        packings.append(packing_of_columns(dict(zip(names, rows.T, strict=True)), path.name, name, notes))
    return packings


def refuse(path: Path) -> PackingError:
    """Error for a file in an unknown format; its message quotes the beginning of the file and names a remedy."""
    text = first_lines(path)
    lines = _content_lines(head_text(read_content(path, HEAD))[:4000])
    known = identify_columns(dict.fromkeys(names_of(lines[0]) or [] if lines else [], np.zeros(0)))[0]
    if known.keys() & {"position", "radius", "diameter"}:
        lacks = "no radii" if "position" in known else "no positions"
        return PackingError(
            f"{path} has columns {' '.join(names_of(lines[0]))}: {lacks} among them; {NEEDED} are needed, under such "
            f"names"
        )
    return PackingError(
        f"{path} is in an unknown format: {text}; give {NEEDED} as a table with these names, or another format of "
        "`stickslip docs exchange`"
    )


def contact_table_path(path: Path) -> Path:
    """Path of the table of contacts: packing-contacts.csv for packing.csv."""
    return path.with_name(f"{path.stem}-contacts{path.suffix}")


def write_csv(path: str | Path, frame: Frame) -> list[str]:
    """Write a table of grains and one of contacts, both or neither; return notes on data that they do not store."""
    path, grains = Path(path), frame.state.grains
    columns = {"": grains.position, "radius": grains.radius, "mass": grains.mass, "velocity": grains.velocity}
    columns |= {"spin": grains.spin, "material": grains.material, **exported(frame.grains)}
    with replace_atomically(path) as part, replace_atomically(contact_table_path(path)) as other:
        _write_columns(part, columns)
        _write_columns(other, frame.contacts | {"mode": np.where(frame.contacts["mode"] == SLIDE, "slide", "stick")})
    return [f"CSV does not store {', '.join(['the cell', *list_losses(frame)])}"]


def _write_columns(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Write columns, exact to the last bit; vectors become three columns, such as velocity_x."""
    flat = {}
    for name, values in columns.items():
        parts = dict(zip("xyz", values.T, strict=True)) if values.ndim == 2 else {"": values}
        flat |= {"_".join(filter(None, (name, axis))): part.tolist() for axis, part in parts.items()}
    write_table(path, flat, zip(*flat.values(), strict=True), digits=None)


PAIR = re.compile(r'(\w+)=("(?:[^"\\]|\\.)*"|\S+)')


def write_xyz(path: str | Path, frames: list[Frame]) -> list[str]:
    """Write frames one after the other, with numbers exact to the last bit.

    Return notes on data that the format does not store.
    """
    with replace_atomically(Path(path)) as part, part.open("w", encoding="utf-8") as file:
        for frame in frames:
            grains, cell = frame.state.grains, frame.state.cell
            named = {"pos": grains.position, "radius": grains.radius, "mass": grains.mass, "velo": grains.velocity}
            named |= {name: getattr(grains, name) for name in ("spin", "angle", "inertia", "material")}
            named |= exported(frame.grains)
            columns, kinds = [], []
            for name, values in named.items():
                width = 1 if values.ndim == 1 else values.shape[1]
                kinds.append(f"{name}:{'I' if values.dtype.kind in 'iu' else 'R'}:{width}")
                columns.append([" ".join(map(repr, row)) for row in values.reshape(-1, width).tolist()])
            lattice = " ".join(map(repr, cell.vectors.ravel().tolist()))
            flags = " ".join("T" if p else "F" for p in cell.periodic)
            law = json.dumps(json.dumps(law_to_dict(frame.law)))  # quoted, with inner quotes escaped
            head = [f'Lattice="{lattice}"'] if cell.periodic.any() else []
            head += [f'pbc="{flags}"', f"Properties=species:S:1:{':'.join(kinds)}"]
            head += [f"time={frame.state.time!r}", f"dim={cell.dim}", f"law={law}"]
            file.write(f"{len(grains.radius)}\n{' '.join(head)}\n")
            file.writelines(f"X {' '.join(row)}\n" for row in zip(*columns, strict=True))
    lost = ["contacts and their memory", *list_losses(frames[0], law=False)]
    return [f"extended XYZ does not store {', '.join(lost)}"]


def recognize_xyz(head: bytes) -> bool:
    """Return True for XYZ: a count of grains, then a comment, which in extended XYZ names the columns."""
    lines = head_text(head).split("\n", 3)
    if len(lines) < 3 or not lines[0].strip().isdecimal():
        return False
    words, names = lines[2].split(), names_of(lines[1])
    plain = len(words) in (4, 5) and all(NUMBER.fullmatch(word.lower()) for word in words[1:])
    said = bool(names) or not lines[1].strip()
    return "Properties=" in lines[1] or (plain and said and not has_grains(names))


def read_xyz(path: Path, frame: str | None = None) -> list[Packing]:
    """Read frames of an XYZ file, which are named by their number; the law is read if stickslip wrote it.

    Without names, columns are the species, x, y, z, and the radius.
    """
    frames = split_frames(path, frame, (1,), 2, "frame", "it is truncated or damaged")
    return [_read_frame(path, *part) for part in frames]


def _read_frame(path: Path, name: str, lines: list[str]) -> Packing:
    about, notes = dict(PAIR.findall(lines[1])), []
    if "Properties" not in about:
        if any(len(line.split()) != 5 for line in lines[2:]):
            raise PackingError(
                f"{path} has no radii after species x y z: add them as a fifth column, or name the columns in the "
                f"second line, as in Properties=species:S:1:pos:R:3:radius:R:1"
            )
        about["Properties"] = "species:S:1:pos:R:3:radius:R:1"
        notes = [Assumption(f"{path.name} does not name its columns: species x y z radius is assumed", COLUMNS)]
    end = "its second line must name its columns"
    with refusing(lambda what: f"{path} has a damaged frame {name} ({what}): {end}", KeyError, IndexError, TypeError):
        kinds = about["Properties"].strip('"').split(":")
        columns = _columns(kinds, [line.split() for line in lines[2:]])
        more, law = _box(about), law_from_dict(json.loads(json.loads(about["law"]))) if "law" in about else None
    packing = packing_of_columns(columns, path.name, name, **more)
    notes += [*packing.notes, NO_CONTACTS] if law else packing.notes
    return packing._replace(law=law, notes=notes if "cell" in more else [*notes, extent_note(path.name)])


def _columns(kinds: list[str], rows: list[list[str]]) -> dict[str, np.ndarray]:
    """Columns of numbers by their names in `Properties`."""
    out, at = {}, 0
    for name, kind, width in zip(kinds[::3], kinds[1::3], map(int, kinds[2::3]), strict=True):
        if kind in "RI":
            values = parse_numbers([word for row in rows for word in row[at : at + width]]).reshape(len(rows), width)
            out[name] = values[:, 0] if width == 1 else values
        elif name == "species" and len({row[at] for row in rows}) > 1:
            out[name] = np.unique([row[at] for row in rows], return_inverse=True)[1].astype(float)
        at += width
    if any(len(row) != at for row in rows):
        raise ValueError(f"rows that do not have {at} entries")
    return out


def _box(about: dict[str, str]) -> dict:
    """Cell and its periodic flags, as arguments of `from_arrays`."""
    if "Lattice" not in about:
        return {}
    flags = about.get("pbc", '"T T T"').strip('"').split()
    more = {
        "cell": parse_numbers(about["Lattice"].strip('"').split()).reshape(3, 3),
        "periodic": [f in "T1" for f in flags],
    }
    return more | ({"dim": int(about["dim"])} if about.get("dim") in ("2", "3") else {})


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
MFIX_NAMES = {"phase_id": ["type"], "diameter": ["diameter"], "density": ["density"]}  # others are vectors


def recognize_edem(head: bytes) -> bool:
    """Return True for an EDEM export, with a list of values below each query."""
    return bool(QUERY.search(head_text(head)))


def read_edem(path: Path, frame: str | None = None) -> list[Packing]:
    """Read the states of an EDEM export, named by time; each query has a value for each particle."""
    times = TIME.split(read_lines(path))[1:]
    if not times:
        raise PackingError(f"{path} has EDEM queries but no line `TIME:` above them: export it with its header")
    names, packings = times[::2], []
    choice = choice_note(path, names, frame, "states")
    for k in chosen_frames(path, names, frame):
        queries = QUERY.split(times[2 * k + 1])[1:]
        lists = [re.findall(r"[^\s,;\"]+", values) for values in queries[1::2]]
        most = max(map(len, lists), default=0)
        columns: dict[str, np.ndarray] = {}
        for query, words in zip(queries[::2], lists, strict=True):
            if query in columns:
                raise PackingError(
                    f"{path} has the query {query!r} twice at time {names[k]}: export it once, for all particles"
                )
            if len(words) == most:
                columns[query] = _parse(path, words)
            elif not query.startswith("Total"):  # single numbers are left out
                raise PackingError(
                    f"{path} has {len(words)} values of {query!r} at time {names[k]}, but {most} values of others"
                )
        packings.append(packing_of_columns(columns, path.name, names[k], [Assumption(extent_note(path.name))]))
    return [packing._replace(notes=[*choice, *packing.notes]) for packing in packings]


def _parse(path: Path, words: list[str], remedy: str = "write it again", shape: tuple[int, ...] = (-1,)) -> np.ndarray:
    with refusing(lambda problem: f"{path} contains an entry that is not a number ({problem}): {remedy}"):
        return parse_numbers(words).reshape(shape)


def recognize_jambash(head: bytes) -> bool:
    """Return True for jamBashBulk packings: N, lattice vectors and pressure, then x, y and R in braces."""
    return bool(re.search(r"(?m)^N *= *\d+ *, *L *= *\S+ *, *L1 *=", head_text(head)))


def read_jambash(path: Path, frame: str | None = None) -> list[Packing]:
    """Read packings of disks in periodic cells, which are named by their number in the file."""
    found = JAMBASH.findall(read_lines(path))
    if not found:
        raise PackingError(f"{path} is truncated: N, L1, L2 and the disks in braces are needed, as in jamBashBulk")
    names = [str(k) for k in range(len(found))]
    choice = choice_note(path, names, frame, "states")
    packings, more = [], {"dim": 2, "periodic": [True, True, False]}
    for k in chosen_frames(path, names, frame):
        count, *lists = found[k]
        first, second, rows = (_parse(path, words.replace(",", " ").split()) for words in lists)
        if len(rows) != 3 * int(count) or len(first) != 2 or len(second) != 2:
            raise PackingError(f"{path} has {len(rows)} numbers for {count} disks in packing {k}: it is damaged")
        cell = np.eye(3)
        cell[:2, :2] = first, second
        columns = dict(zip(("x", "y", "radius"), rows.reshape(-1, 3).T, strict=True))
        packings.append(packing_of_columns(columns, path.name, names[k], cell=cell, **more))
    return [packing._replace(notes=[*choice, *packing.notes]) for packing in packings]


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
            f"{path} declares {count} spheres, but its kinds have {numbers.sum():g} in total: it is damaged"
        )
    diameter = np.repeat(_parse(path, sizes), numbers.astype(int)) if sizes else rows[:, dim]
    cell = np.eye(3)
    cell[:dim, :dim] = _parse(path, head[len(head) - dim**2 :]).reshape(dim, dim)
    periodic = [flag == "T" for flag in flags] + [False] * (3 - dim)
    columns = {**dict(zip("xyz", rows[:, :dim].T, strict=False)), "diameter": diameter}
    notes = [Assumption(f"{path.name}: positions are assumed to be lengths, not lattice fractions", COLUMNS)]
    notes += [] if all(periodic[:dim]) else [Obstacle(f"hard walls of {path.name} (F) were not imported")]
    return [packing_of_columns(columns, path.name, path.stem, notes, dim=dim, cell=cell, periodic=periodic)]


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
    notes = [Assumption(extent_note(path.name))]
    if more := max(map(len, rows), default=0) - len(names):  # temperature, species, scalars
        notes.append(f"{path.name}: columns after {' '.join(names)} are not used: {more}")
    return [packing_of_columns(columns, path.name, path.stem, notes)]
