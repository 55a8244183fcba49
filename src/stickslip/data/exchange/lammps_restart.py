"""LAMMPS restart files: grains and the memory of their contacts, read and written to the last bit.

At the end of a restart file, each rank has a block of doubles with a record for every grain: its length, position, id,
type, mask, image, velocity, radius, mass and spin, then one entry for each fix that stores data on grains. `fix
NEIGH_HISTORY`, created by every history pair style, comes first: it lists the partners of the grain and the memory of
each contact, for the grain relative to its partner. Entries of walls follow, in the order of their fixes. Most integers
are stored in the bits of doubles.
"""

import re
import struct
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...builtin_laws import BUILTIN_LAWS
from ...core.contacts.forces import FROZEN, accept, forces
from ...core.contacts.jacobian import linearise
from ...core.laws.builtin import KEEPS_FORCE, ROLLING, SCALED, TWISTING, Law, parameter_names, rescales
from ...core.laws.compiled import evaluate
from ...core.laws.kinds import Kind, bridges_gaps
from ...core.laws.properties import resists_rolling
from ...core.measure import branch_vectors, contact_velocity, overlaps, touching
from ...core.reading import Reader
from ...core.state import OPEN, SLIDE, STICK, State, empty_contacts
from ...known import UNKNOWN, USED, group_of, plain_style
from ..sample import FIXES, PAIRS, Absent, Note, Obstacle, PackingError, account_for, refusing
from .columns import HEAD, ListedBonds, Packing, only_state, read_content
from .lammps_bonds import list_bonds, note_on_bonds
from .lammps_laws import HISTORY as HISTORY_LAWS
from .lammps_laws import SAME_UNITS, no_equal
from .lammps_text import Table, add_box, restricted_box, whole_periods

MAGIC = b"LammpS RestartT\x00"
# end of the header (flag 44, one file for all ranks, and −1), and the flag before the block of a rank
HEADER_END, BLOCK = struct.pack("<iii", 44, 0, -1), struct.pack("<i", 47)
# up to 2023 the header ended with another flag, 45, which is 0 unless LAMMPS used MPI-IO
OLD_END = re.compile(rb"(\x2c\0\0\0[^\xff]{4})\x2d\0{7}(\xff{4}(?:\x2f\0\0\0|LammpS))", re.DOTALL)
PART = struct.pack("<i", 46)  # flag at the beginning of a part, before its number of blocks
POSITION, TAG, TYPE, IMAGE, VELOCITY, OWN, EXTRA = 1, 4, 5, 7, 8, 11, 16  # OWN: first column of the atom style
SIZES = ("radius", "mass", "spin")
OWN_COLUMNS = {  # columns of atom styles after the common ones; hybrid styles have those of all their parts
    "sphere": SIZES, "bond": ("molecule", "bonds"), "bpm/sphere": ("molecule", "bonds", *SIZES, "orientation"),
    "atomic": (),
}  # fmt: skip
WIDTHS = {"spin": 3, "orientation": 4}  # widths of columns that are wider than 1
BOND_MEMORY = {"bpm/spring": 1, "bpm/rotational": 4}  # numbers stored for each bond by these styles
AT_LIMIT = 1e-9  # relative distance to the Coulomb limit within which a contact without dashpots slides
HISTORY, WALL, REGION = "NEIGH_HISTORY", "wall/gran", "wall/gran/region"  # fixes that store memory of grains
LONGEST_LIST, LONGEST_NAME = 4096, 200  # largest sizes of the list of fixes, and of a name [bytes]
AT_CAP, TWIST, TWIST_AT_CAP = 6, 7, 8  # columns of `Contacts.rolling`
MOST = 7  # number of values after the slip: contact radius, rolling and twisting
ROTATIONS = 4  # number of values of rolling and twisting
PULL_OFF = ((9 / 16) ** (1 / 6) - (9 / 16) ** (2 / 3)) / (27 / 256) ** (1 / 3)  # gap at separation over pull-off gap
SHARE = 0.05  # fraction by which the dashpot force may change in half a step


INT, BIG, DOUBLE, INTS, DOUBLES, STRING = range(6)
FLAGS = {  # types of the values after the flags of a header
    **dict.fromkeys((0, 4, 15, 59), STRING), **dict.fromkeys((5, 16, 18, 21, 24, 27, 71), BIG),
    **dict.fromkeys((8, 14), INTS),
    **dict.fromkeys((31, 32, 36, 37, 49), DOUBLES),
    **dict.fromkeys((33, 34, 35, 50, 55, 57, 66, 67, 68, 69, 70), DOUBLE),
    **dict.fromkeys((1, 2, 3, 6, 7, 9, 10, 11, 12, 13, 17, 19, 20, 22, 23, 25, 26, 28, 29, 30, 48, 73, 75), INT),
    **dict.fromkeys((51, 52, 53, 54, 56, 58, *range(60, 66)), INT),
}  # fmt: skip
UNITS, STEP, BOUNDARY, STYLE, ATOMS, LOW, HIGH, XY, XZ, YZ, SPECIAL = 4, 5, 14, 15, 16, 31, 32, 33, 34, 35, 36
MOST_GROUPS = 32
LABELS = 72  # flag before labels of types
NO_PLACE = "restart files do not contain its position; give the run folder, whose log or input script does"


class Restart(NamedTuple):
    """Content of a restart file, with grains sorted by id and numbered from 0."""

    position: np.ndarray  # (N, 3) in the box [length]
    image: np.ndarray  # (N, 3)
    velocity: np.ndarray  # (N, 3) [length/time]
    spin: np.ndarray  # (N, 3) [rad/time]
    radius: np.ndarray  # (N,) [length]
    mass: np.ndarray  # (N,) [mass]
    types: np.ndarray  # (N,) types, counted from 0
    mask: np.ndarray  # (N,) bit masks of the groups
    i: np.ndarray  # (C,) contacts, each once, i < j
    j: np.ndarray  # (C,)
    slip: np.ndarray  # (C, 3) slip of i relative to j [length]
    wall: np.ndarray  # (K,) index of the fix of the wall that a grain touches
    grain: np.ndarray  # (K,)
    wall_slip: np.ndarray  # (K, 3) [length]
    more: np.ndarray  # (C, 7) values after the slip, or their `rotations`, (C, 4)
    wall_more: np.ndarray  # (K, 7), or (K, 4)
    ids: np.ndarray  # (N,) ids of the grains in LAMMPS, increasing
    face: np.ndarray  # (K,) face of the region, from 0; −1 for walls that are not regions
    bonds: ListedBonds | None = None


def is_complete(path: Path) -> bool:
    """Return True if a restart file is complete."""
    if not path.is_file() or path.stat().st_size < 2 * len(MAGIC):
        return False
    with path.open("rb") as file:
        file.seek(-len(MAGIC), 2)
        return file.read() == MAGIC


def _read_whole(path: Path) -> bytes:
    """Content of a restart file, with the blocks in its other parts if LAMMPS wrote several (% in the name).

    The base ends with the header, which contains the number of parts; each part has the blocks of some ranks.
    """
    content = OLD_END.sub(rb"\1\2", read_content(path), count=1)
    if recognize_part(content):
        numbers = re.finditer(r"\d+", path.name)
        names = [f"{path.name[: number.start()]}base{path.name[number.end() :]}" for number in numbers]
        base = next((path.with_name(name) for name in names if path.with_name(name).is_file()), None)
        if base is None:
            raise PackingError(f"{path} is one part of a restart file: give the file named base, beside all its parts")
        return _read_whole(base)
    end = len(content) - len(MAGIC) - len(HEADER_END)
    flag, count, last = struct.unpack("<iii", content[end : -len(MAGIC)]) if end > 0 else (0, 0, 0)
    if not (content.startswith(MAGIC) and content.endswith(MAGIC) and (flag, last) == (44, -1) and count > 0):
        return content
    before, _, after = path.name.rpartition("base")
    parts = []
    for place in (path.with_name(f"{before}{k}{after}") for k in range(count)):
        if not place.is_file():
            raise PackingError(
                f"{path} lacks its part {place.name}: copy all parts, or write the restart file without % in its name"
            )
        part = read_content(place)
        if not (recognize_part(part) and part.endswith(MAGIC)):
            raise PackingError(f"{place} is not a complete part of the restart file {path.name}: copy it again")
        parts.append(part[2 * len(PART) : -len(MAGIC)])
    return b"".join([content[:end], HEADER_END, *parts, MAGIC])


def _blocks(content: bytes) -> tuple[int, list[np.ndarray]]:
    """Start of the first block of a restart file, and the doubles of each block; raise ValueError for other files."""
    mark, start = HEADER_END + BLOCK, 0
    if not content.startswith(MAGIC) or not content.endswith(MAGIC):
        raise ValueError("not a complete LAMMPS restart file")
    while (start := content.find(mark, start)) >= 0:
        offset, blocks = start + len(HEADER_END), []
        while content[offset : offset + 4] == BLOCK:
            reader = Reader(content, offset + len(BLOCK))
            try:
                blocks.append(reader.array("<f8", reader.number("<i")))
            except ValueError:
                break
            offset = reader.at
        if offset == len(content) - len(MAGIC):
            return start + len(HEADER_END), blocks
        start += 1
    raise ValueError("a LAMMPS restart file in an unknown format")


def _record_starts(block: np.ndarray) -> np.ndarray:
    """Start of each grain's record in a block, and end of the last one; raise ValueError if one does not fit."""
    starts = [0]
    while starts[-1] < len(block):
        starts.append(int(_ends(block, np.array(starts[-1:]), len(block), EXTRA)[0]))
    return np.array(starts, np.int64)


def _ends(block: np.ndarray, start: np.ndarray, stop, least: int = 2) -> np.ndarray:
    """Ends of records or entries that begin with their length; raise ValueError if one is short or passes `stop`."""
    length = block[np.minimum(start, len(block) - 1)]
    if not ((length >= least) & (length <= stop - start)).all():
        raise ValueError("a LAMMPS restart file with a record of wrong length: it is damaged")
    return start + length.astype(np.int64)


def read_restart(path: Path, *, walls: int | None = None, values: int | None = None) -> Restart:
    """Read a restart file.

    Parameters
    ----------
    walls : number of wall fixes, default those named in the file
    values : number of doubles in the memory of a contact between grains, of which the first three are the slip;
    default: as many as fit into the records

    Raises
    ------
    ValueError
        If the file is incomplete or in another format.
    """
    content = _read_whole(path)
    start, blocks = _blocks(content)
    fixes, style = _fixes(content[:start])[1], str(_header(content)[0].get(STYLE, "sphere"))
    marks = {f"_{kind.upper().replace('/', '_')}_FIX_PROP": kind for kind in BOND_MEMORY}  # fixes for bond styles
    named = [next((marks[mark] for mark in marks if mark in name), kind) for name, kind in fixes]
    stores = named if walls is None else [HISTORY, *[REGION] * walls]
    columns = own_columns(style)
    parts = [_read_block(block, columns, stores, values) for block in blocks if len(block)]
    if not parts:
        raise ValueError("a LAMMPS restart file without grains")
    groups = ([np.concatenate(columns) for columns in zip(*group, strict=True)] for group in zip(*parts, strict=True))
    (tag, *grains), pairs, touched, bonds = groups
    order = np.argsort(tag)
    ids = tag[order]
    orientation = grains.pop()
    if not np.diff(ids).all() or not np.isin(np.concatenate([pairs[0], pairs[1], touched[1]]), ids).all():
        raise ValueError("a LAMMPS restart file with a contact of a missing grain")
    pairs[:2], touched[1] = (np.searchsorted(ids, column) for column in pairs[:2]), np.searchsorted(ids, touched[1])
    once = pairs[0] < pairs[1]
    # LAMMPS evaluates a contact at the first of its grains in the file, and reverses the signs in the copy of the other
    # grain, even those of rolling and twisting, which should be equal for both grains
    low, high = np.minimum(*pairs[:2]), np.maximum(*pairs[:2])
    _, first, copy = np.unique(low * (high.max(initial=0) + 1) + high, return_index=True, return_inverse=True)
    more = pairs.pop()[first[copy]][once]
    ends, face, wall_more = (column[once] for column in pairs), touched.pop(), touched.pop()
    held = _list_bonds(path.name, ids, *bonds, orientation[order])
    return Restart(*(column[order] for column in grains), *ends, *touched, more, wall_more, ids, face, held)


def own_columns(style: str) -> list[str]:
    """Columns of an atom style in a record, after the common ones; raise ValueError if it is unknown."""
    parts = style.split()[1:] if style.startswith("hybrid") else [style]
    if not {*parts} <= {*OWN_COLUMNS}:
        raise ValueError(f"atoms of style {style}")
    return list(dict.fromkeys(name for part in parts for name in OWN_COLUMNS[part]))


def _list_bonds(
    source: str, ids: np.ndarray, ends: np.ndarray, kind: np.ndarray, memory: np.ndarray, turned: np.ndarray
) -> ListedBonds:
    """Bonds with their rest configurations; both grains may have a copy of a bond.

    LAMMPS stores the rest direction from the grain with the larger id, in the unrotated frame of that grain.
    """
    from scipy.spatial.transform import Rotation  # slow to import

    low, high = np.sort(ends, axis=1).T
    _, once = np.unique(low * (high.max(initial=0) + 1) + high, return_index=True)
    bonds = list_bonds(source, ids, kind[once], ends[once], {})
    length, direction = memory[once, 0], memory[once, 1:]
    i, j = (Rotation.from_quat(turned[rows][:, [1, 2, 3, 0]]) for rows in (bonds.i, bonds.j))
    complete = direction.any(axis=1) & (length > 0)
    now = (i * j.inv()).as_quat()[:, [3, 0, 1, 2]]
    return bonds._replace(
        length=length,
        direction=np.where(complete[:, None], j.apply(direction), 0.0),
        turn=np.where(complete[:, None], now, 0.0),
    )


def rotations(values: np.ndarray, rolls: int, twists: int) -> np.ndarray:
    """(C, 4) rolling displacement and twist, at given positions in the values after slip; zero if a position is −1."""
    out = np.zeros((len(values), ROTATIONS))
    if rolls >= 0:
        out[:, :3] = values[:, rolls : rolls + 3]
    if twists >= 0:
        out[:, 3] = values[:, twists]
    return out


def recognize_part(head: bytes) -> bool:
    """Return True for one part of a LAMMPS restart file, which holds the grains of some ranks only."""
    return head.startswith(PART) and head[2 * len(PART) :].startswith(BLOCK)


def recognize(head: bytes) -> bool:
    """Return True for a LAMMPS restart file."""
    return head.startswith(MAGIC)


def read(path: Path, frame: str | None = None) -> list[Packing]:
    """Read the grains of a restart file, the memory of their contacts, and the law if its pair style stores it."""
    only_state(path, frame)
    content = _read_whole(path)
    whole = path.name.replace(".base", ".%")
    remedy = f"convert it with LAMMPS: `read_restart {whole}`, then `write_data packing.data`"
    with refusing(lambda problem: f"{path} cannot be read ({problem}): {remedy}", KeyError, IndexError):
        return [_packing(path, content, remedy)]


def _packing(path: Path, content: bytes, remedy: str) -> Packing:
    """Packing of a restart file; raise ValueError, KeyError or IndexError if it is damaged."""
    start, _ = _blocks(content)
    about = _header(content)[0]
    try:
        spheres = {*SIZES} <= {*own_columns(about[STYLE])}
    except ValueError:
        spheres = False
    if not spheres:
        read = "supported are sphere, bpm/sphere, and hybrids of sphere and bond"
        raise PackingError(f"{path} has atoms of style {about[STYLE]}, but {read}: {remedy}")
    restart = read_restart(path)
    if len(restart.ids) != about[ATOMS]:
        raise PackingError(
            f"{path} contains only {len(restart.ids)} of {about[ATOMS]} grains: its parts belong to different runs or "
            "times"
        )
    vectors = restricted_box(about[HIGH] - about[LOW], about.get(XY, 0.0), about.get(XZ, 0.0), about.get(YZ, 0.0))
    arrays = {
        "position": restart.position + whole_periods(restart.image, vectors), "radius": restart.radius,
        "mass": restart.mass, "velocity": restart.velocity, "spin": restart.spin,
    }  # fmt: skip
    flags = about[BOUNDARY].reshape(3, 2)
    box = Table(int(about[STEP]), vectors, about[LOW], (flags == 0).all(axis=1), {})
    arrays, notes = add_box(box, arrays, None, [])
    law, said = _law_of_pair_style(content[:start])
    stored = stored_fixes(content[:start])
    walls = [style for style in stored.values() if style.startswith(WALL)]
    left_out = [
        f"fix {name} ({style}) {'acts on the grains' if style in walls else 'is unknown'}: {NO_PLACE}"
        for name, style in stored.items()
        if style in walls or group_of("fix", style) == UNKNOWN
    ]
    notes = [*([] if walls else notes), *said, *(Obstacle(part, FIXES) for part in left_out)]
    bonds = restart.bonds._replace(weights=tuple(about.get(SPECIAL, np.zeros(0)).tolist()[-3:]))
    notes += note_on_bonds(bonds)
    if about[UNITS] not in SAME_UNITS:
        notes.append(Obstacle(f"units {about[UNITS]}, in which LAMMPS converts forces, were not imported"))
    notes += account_for("fix", stored.values(), path.name, dict.fromkeys(stored.values(), USED))[:1]
    labels = _groups_and_labels(content, restart.mask)[1]
    return Packing(
        str(box.step), arrays, notes, box.step, restart.ids, restart.types,
        memory=restart, law=law, labels=labels, bonds=bonds,
    )  # fmt: skip


def stored_fixes(head: bytes) -> dict[str, str]:
    """Styles of the fixes with data in a restart file, by id."""
    return {name: plain_style(style) for fixes in _fixes(head) for name, style in fixes}


def read_stored_fixes(path: Path) -> dict[str, str]:
    """Styles of the fixes with data in a restart file, by id, without internal fixes of LAMMPS."""
    content = _read_whole(path)
    fixes = stored_fixes(content[: _blocks(content)[0]])
    return {name: style for name, style in fixes.items() if style == style.lower()}


def time_step(path: Path) -> int:
    """Time step of a restart file; −1 if unreadable."""
    try:
        return int(_header(read_content(path, HEAD))[0][STEP])
    except (KeyError, ValueError):
        return -1


def group_masks(path: Path, memory: Restart) -> dict[str, np.ndarray]:
    """(N,) masks of the grains in each group named in the file."""
    return _groups_and_labels(_read_whole(path), memory.mask)[0]


def _groups_and_labels(content: bytes, mask: np.ndarray) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """Members of each named group, and types by label."""
    masks, names, labels = {}, [], []
    try:
        _, at = _header(content)
        reader = Reader(content, at - 4)
        if reader.number("<i") != -1:
            return {}, {}
        count = reader.number("<i")
        while len(masks) < count <= MOST_GROUPS and len(names) < MOST_GROUPS:
            named = content[reader.at : reader.at + 4] != bytes(4)
            name = _string(reader) if named else reader.take(4) and ""
            if name:
                masks[name] = (mask >> len(names) & 1).astype(bool)
            names.append(name)
    except ValueError:
        return {}, {}
    with suppress(ValueError):  # the end of the labels
        if reader.number("<i") == LABELS and reader.number("<i"):
            while len(labels) < LONGEST_NAME:
                labels.append(_string(reader))
    return masks, {label: k for k, label in enumerate(labels, start=1) if label}


def _header(content: bytes) -> tuple[dict, int]:
    """Values of a header by flag, up to its end or the first unknown flag, and the position after that flag."""
    out, reader = {}, Reader(content, len(MAGIC) + 8)
    while True:
        flag = reader.number("<i")
        kind = FLAGS.get(flag)
        if kind is None:
            return out, reader.at
        if kind == STRING:
            out[flag] = _string(reader)
            if flag == STYLE:
                parts = [_string(reader) for _ in range(min(reader.number("<i"), 20))]
                out[flag] = " ".join(map(plain_style, [out[flag], *parts]))
        elif kind in (INTS, DOUBLES):
            out[flag] = reader.array("<i4" if kind == INTS else "<f8", reader.number("<i"))
        else:
            out[flag] = reader.number({INT: "<i", BIG: "<q", DOUBLE: "<d"}[kind])


def _pair_style(head: bytes) -> tuple[str, int]:
    """Pair style named in a header, without the suffix of an accelerated style, and the position after it."""
    match = re.search(rb"\x27\0\0\0(.)\0\0\0([a-z0-9/_]+)\0", head, re.DOTALL)
    return (plain_style(match[2].decode()), match.end()) if match else ("none", 0)


def compare_pair_style(path: Path, numbers: Sequence[float]) -> tuple[str, list[float]]:
    """Pair style of a restart file (empty without one), and the given coefficients that are not in the file."""
    content = _read_whole(path)
    head = content[: _blocks(content)[0]]
    style, at = _pair_style(head)
    lacking = [number for number in dict.fromkeys(numbers) if struct.pack("<d", number) not in head[at:]]
    return ("" if style == "none" else style), lacking


def _law_of_pair_style(head: bytes) -> tuple[dict | None, list[str]]:
    """Options of `law_by_name` for the pair style in a header, or a note on why there is no law."""
    style, at = _pair_style(head)
    if style not in ("none", "granular") and style.removeprefix("gran/") not in HISTORY_LAWS and style[:6] != "hybrid":
        return None, [Obstacle(f"pair_style {style} of the restart file was not imported: {no_equal(style)}", PAIRS)]
    if style.removeprefix("gran/") not in HISTORY_LAWS:
        text = f"the coefficients of pair_style {style}: give the run folder, or the law with --law"
        return None, [Absent(text, PAIRS)]
    reader = Reader(head, at)
    (kn, kt, damping_n, damping_t, mu), flag = reader.array("<f8", 5).tolist(), reader.number("<i")
    law, damping = HISTORY_LAWS[style.removeprefix("gran/")]
    return {
        "law": law, "coulomb": "sharp", "kn": kn, "kt": kt, "mu": mu, "damping_n": damping_n,
        "damping_t": damping_t if flag else 0.0, "damping": damping,
    }, [Note(f"law from the restart file: pair_style {style}", PAIRS)]  # fmt: skip


def _fixes(head: bytes) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Ids and styles of the fixes with a global state, and of those that store data of grains."""
    end = len(head) - len(HEADER_END)
    start, of_grains = _find_list(head, end, blobs=False)
    return _find_list(head, start, blobs=True)[1], of_grains


def _find_list(head: bytes, end: int, *, blobs: bool) -> tuple[int, list[tuple[str, str]]]:
    """Start of the list of fixes that ends at `end`, and their ids and styles; with `blobs`, data follow each fix."""
    first = max(end - LONGEST_LIST, 0)
    tail = head[first:end]
    for start in range(len(tail) - 4, 0, -1):
        if tail[start + 1 : start + 4] != bytes(3):
            continue
        reader, fixes = Reader(tail, start), []
        try:
            for _ in range(reader.number("<i")):
                fixes.append((_string(reader), _string(reader)))
                size = reader.number("<i")
                reader.take(max(size, 0) if blobs else 0)
        except ValueError:
            continue
        if fixes and not reader.left and all(re.fullmatch(r"[\w/]+", style) for _, style in fixes):
            return first + start, fixes
    return end - 4, []


def _string(reader: Reader) -> str:
    """String stored after its length; raise ValueError if the length is impossible for a name."""
    size = reader.number("<i")
    if not 0 < size < LONGEST_NAME:
        raise ValueError(f"a name of {size} characters")
    return reader.take(size)[:-1].decode("latin-1")


def _read_own(block: np.ndarray, start: np.ndarray, columns: Sequence[str]):
    """Columns of an atom style in a block; number of bonds of each grain, position of its first bond, and their end."""
    extra = {"orientation": np.tile([1.0, 0, 0, 0], (len(start), 1))}
    at, count, first = start + OWN, np.zeros(len(start), np.int64), start
    for name in columns:
        if name == "bonds":
            count, first = block.view("<i8")[np.minimum(at, len(block) - 1)], at + 1
            if not ((count >= 0) & (count < len(block))).all():
                raise ValueError("a LAMMPS restart file with more bonds than fit into a record: it is damaged")
            at = at + 1 + 2 * count
        else:
            places = at[:, None] + np.arange(WIDTHS.get(name, 1))
            extra[name] = block[np.minimum(places, len(block) - 1)]
            at = at + places.shape[1]
    return extra, count, first, at


def _read_bonds(block: np.ndarray, tag: np.ndarray, count: np.ndarray, first: np.ndarray, memories: dict):
    """Ids of the ends of the bonds in a block, their types, and rest configurations, (K, 4), zero if there are none.

    Parameters
    ----------
    memories : start and end of the entry of each style that stores data on bonds
    """
    number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)  # number of each bond on its grain
    row = np.repeat(first, count) + number
    kind, other = (block.view("<i8")[np.minimum(at, len(block) - 1)] for at in (row, row + np.repeat(count, count)))
    memory = np.zeros((len(number), 4))
    # in a hybrid, each style stores its numbers for all bonds: the most complete set counts
    for style, (entry, end) in sorted(memories.items(), key=lambda item: BOND_MEMORY[item[0]]):
        width = BOND_MEMORY[style]
        at = np.repeat(entry, count) + 1 + width * number
        own = np.zeros((len(number), 4))
        own[:, :width] = _values_after(block, at, np.minimum(at + width, np.repeat(end, count)))[:, :width]
        memory = np.where(own[:, :1] > 0, own, memory)
    return np.stack([np.repeat(tag, count), other], axis=1), kind, memory


def _read_block(block: np.ndarray, columns: Sequence[str], stores: list[str], values: int | None):
    """Columns of the grains, of the contacts, of the contacts with walls and of the bonds in the block of a rank."""
    whole, bounds = block.view("<i8"), _record_starts(block)
    start, stop = bounds[:-1], bounds[1:]
    tag, bits = whole[start + TAG], whole[start + IMAGE]
    image = np.stack([bits & 1023, bits >> 10 & 1023, bits >> 20 & 4095], axis=1) - 512
    position, velocity = (block[start[:, None] + k + np.arange(3)] for k in (POSITION, VELOCITY))
    own, count, first, entry = _read_own(block, start, columns)
    if not (entry <= stop).all():
        raise ValueError("a LAMMPS restart file with a record of wrong length: it is damaged")
    sizes = own["radius"][:, 0], own["mass"][:, 0], whole[start + TYPE] - 1, whole[start + TYPE + 1]
    walls, memories = 0, {}
    none = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, MOST))
    pairs, touched = [none], [(*none, none[0])]  # contacts of each part of a hybrid style, and of each wall
    for style in stores:
        end = _ends(block, entry, stop)
        if style.startswith(HISTORY):
            pairs.append(_read_pairs(block, entry, end, tag, block[entry + 1], values))
        elif style.startswith(REGION):
            on, face, slip, more = _read_pairs(block, entry, end, tag, whole[entry + 1])
            touched.append((np.full(len(on), walls), on, slip, more, face))
            walls += 1
        elif style.startswith(WALL):
            _ends(block, entry, stop, 4)
            slip, more = block[entry[:, None] + 1 + np.arange(3)], _values_after(block, entry + 4, end)
            touched.append((np.full(len(tag), walls), tag, slip, more, np.full(len(tag), -1)))
            walls += 1
        elif style in BOND_MEMORY:
            memories[style] = entry, end
        entry = end
    bonds = _read_bonds(block, tag, count, first, memories)
    joined = (tuple(map(np.concatenate, zip(*parts, strict=True))) for parts in (pairs, touched))
    return (tag, position, image, velocity, own["spin"], *sizes, own["orientation"]), *joined, bonds


def _read_pairs(block: np.ndarray, entry: np.ndarray, end: np.ndarray, tag: np.ndarray, count: np.ndarray, values=None):
    """Ids of grains, the ids or faces that they touch, and the memory of each contact, as listed by each grain."""
    whole = block.view("<i8")
    if not ((count >= 0) & (count < len(block))).all():
        raise ValueError("a LAMMPS restart file with more contacts than fit into a record: it is damaged")
    count = count.astype(np.int64)
    if values is None:
        some = np.flatnonzero(count)
        values = int((end - entry - 2)[some[0]] // count[some[0]]) - 1 if len(some) else 3
    if values < 3 or not (2 + (values + 1) * count <= end - entry).all():
        raise ValueError("a LAMMPS restart file with more contacts than fit into a record: it is damaged")
    number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)  # number of each contact on its grain
    first = np.repeat(entry + 2, count) + (values + 1) * number
    more = _values_after(block, first + 4, first + 1 + values)
    plain = (block[first] >= 1) & (block[first] < 2**53)  # up to 2022, ids were stored as plain numbers
    other = np.where(plain, np.where(plain, block[first], 0.0).astype(np.int64), whole[first])
    return np.repeat(tag, count), other, block[first[:, None] + 1 + np.arange(3)], more


def _values_after(block: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(C, 7) values of a block from each start to the corresponding end, followed by zeros."""
    at = start[:, None] + np.arange(MOST)
    return np.where(at < end[:, None], block[np.minimum(at, len(block) - 1)], 0.0)


def restore_memory(state: State, law: Law, saved: Restart) -> State:
    """State with the memory of a restart file; the grains of `state` already have their positions in LAMMPS."""
    n = len(state.grains.radius)
    bare = state._replace(contacts=empty_contacts(state.n_bodies, 0, state.contacts.skin), instant=None)
    bare = accept(bare, forces(bare, law)[1])
    listed, count = bare.contacts, int(bare.contacts.count[0])
    key = listed.i[:count].astype(np.int64) * state.n_bodies + listed.j[:count]
    theirs = np.append(saved.i * state.n_bodies + saved.j, saved.grain * state.n_bodies + n + saved.wall)
    values, more = (np.concatenate(parts) for parts in ((saved.slip, saved.wall_slip), (saved.more, saved.wall_more)))
    order = np.argsort(theirs)
    index = np.searchsorted(theirs, key, sorter=order)
    index = order[np.minimum(index, len(order) - 1)] if len(order) else index
    found = theirs[index] == key if len(order) else np.zeros(count, bool)
    mode, pair, slip = listed.mode.copy(), listed.pair.copy(), np.zeros_like(listed.slip)
    if bridges_gaps(law.kind):  # LAMMPS also keeps jkr bonds of grains beyond the contact range
        bonds = np.flatnonzero(found & (mode[:count] == OPEN) & (-overlaps(bare) < _ranges(bare, law)))
        mode[bonds], pair[bonds] = STICK, branch_vectors(bare)[bonds]
    found &= mode[:count] != OPEN
    slip[:count][found] = values[index[found]]
    full = accept(bare, listed._replace(slip=slip, mode=mode, pair=pair))
    if law.properties & KEEPS_FORCE:  # the memory of LAMMPS is the force on i
        k = linearise(full, law, memory=FROZEN).stiffness_t[:, None]
        slip[:count] = np.divide(-slip[:count], k, out=np.zeros((count, 3)), where=k > 0)
        full = accept(full, full.contacts._replace(slip=slip))
    rows = np.flatnonzero(full.contacts.mode[:count] != OPEN)
    slides, frictional = _slides(full, law, rows)
    mode[rows[frictional]] = np.where(slides, SLIDE, STICK)[frictional]
    full = accept(full, full.contacts._replace(mode=mode, reached=listed.reached | (mode == SLIDE)))
    return _with_rotations(full, law, np.flatnonzero(found), more[index[found]]) if resists_rolling(law) else full


def _ranges(state: State, law: Law) -> np.ndarray:
    """(C,) gaps up to which jkr contacts last in LAMMPS, where the contact radius is that of the largest attraction."""
    r_eff, a, b = _pair_sizes(state, np.arange(state.contacts.count[0]))
    return PULL_OFF * evaluate(law, "range", a=a, b=b, overlap=0.0, r_eff=r_eff)


def _pair_sizes(state: State, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R_eff of contacts, and the materials of both bodies."""
    flat, i, j = np.zeros(len(state.walls.mass)), state.contacts.i[rows], state.contacts.j[rows]
    curvature, kind = np.append(1 / state.grains.radius, flat), np.append(state.grains.material, state.walls.material)
    return 1 / (curvature[i] + curvature[j]), kind[i], kind[j]


def _with_rotations(state: State, law: Law, rows: np.ndarray, more: np.ndarray) -> State:
    """State with the rolling displacement R_eff ψ × n and the twist of some contacts, which may be at their caps."""
    contacts, own = state.contacts, state.contacts.rolling.copy()
    r_eff, a, b = _pair_sizes(state, rows)
    values = dict(zip(parameter_names(law), np.moveaxis(law.table[a, b], -1, 0), strict=True))
    c = linearise(state, law, memory=FROZEN)
    normal, limit = c.normal[rows], c.limit[rows]
    turn = np.concatenate([state.grains.spin, np.zeros((len(state.walls.mass), 3))])
    spin = turn[contacts.i[rows]] - turn[contacts.j[rows]]
    pressing = limit / np.where(values["mu"] > 0, values["mu"], 1.0)
    own[rows, :3] = np.cross(normal, more[:, :3]) / r_eff[:, None]
    if law.properties & ROLLING:
        across = spin - np.einsum("ck,ck->c", spin, normal)[:, None] * normal
        rolls = values["k_roll"], values["gamma_roll"], values["mu_roll"] * pressing / r_eff
        own[rows, AT_CAP] = _at_cap(own[rows, :3], across, *rolls)
    if law.properties & TWISTING:
        own[rows, TWIST] = more[:, 3]
        along = np.einsum("ck,ck->c", spin, normal)[:, None]
        twists = values["k_twist"], values["gamma_twist"], values["mu_twist"] * pressing
        if law.properties & SCALED:
            radius = np.sqrt(np.maximum(overlaps(state)[rows], 0.0) * r_eff)
            if not isinstance(law.kind, Kind) and BUILTIN_LAWS[law.kind].uses_radius:  # k_t(δ) contains the radius
                radius = np.divide(c.stiffness_t[rows], values["kt"], out=radius, where=values["kt"] > 0)
            twists = twists[0] * radius**2, twists[1] * radius**2 * c.damping_t[rows], twists[2] * radius
        own[rows, TWIST_AT_CAP] = _at_cap(more[:, 3:], along, *twists)
    return accept(state, contacts._replace(rolling=own))


def _at_cap(memory: np.ndarray, rate: np.ndarray, stiffness, damping, cap) -> np.ndarray:
    """Mask of the moments at their cap, with spring and dashpot together as in `_slides`."""
    dashpot = damping[:, None] * rate
    load = np.linalg.norm(stiffness[:, None] * memory + dashpot, axis=1)
    return load >= (1 - AT_LIMIT) * cap - SHARE * np.linalg.norm(dashpot, axis=1)


def _slides(state: State, law: Law, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masks of the contacts at the Coulomb limit, and of those whose limit is not zero.

    LAMMPS keeps the total force of spring and dashpot of a sliding contact at the limit, with the velocities of the
    half step; at the full step, it may have changed by a fraction of the dashpot force.
    """
    if not len(rows):
        return np.zeros(0, bool), np.zeros(0, bool)
    c, contacts = linearise(state, law, memory=FROZEN), state.contacts
    mu = c.mu[rows]
    pace, tangent = contact_velocity(state, rows, c.normal[rows])
    spring = -c.stiffness_t[rows, None] * contacts.slip[rows]
    dashpot = c.damping_t[rows, None] * tangent
    limit = np.abs(c.limit[rows] - mu * c.damping_n[rows] * pace)
    slack = SHARE * (np.linalg.norm(dashpot, axis=1) + mu * c.damping_n[rows] * np.abs(pace))
    return np.linalg.norm(spring - dashpot, axis=1) >= (1 - AT_LIMIT) * limit - slack, limit > 0


class Places(NamedTuple):
    """Layout of contact memory in LAMMPS: the slip or force comes first."""

    size: int  # number of doubles
    rolls: int = -1  # position of the rolling displacement after the slip; -1 if there is none
    twists: int = -1  # position of the twist

    @classmethod
    def of(cls, law: Law) -> "Places":
        """Layout of the memory of a law."""
        rolls, twists = law.properties & ROLLING > 0, law.properties & TWISTING > 0
        first = int(rescales(law))
        return cls(3 + first + 3 * rolls + 3 * twists, first if rolls else -1, first + 3 * rolls if twists else -1)


def wall_values(saved: Restart, bonds: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mask of the existing contacts with walls, their slip, and the values after it.

    In laws with bonds, the first number is nonzero if the bond exists.
    """
    values = np.hstack([saved.wall_slip, saved.wall_more, np.zeros((len(saved.wall), 1))])
    return (values[:, 0] > 0) | (not bonds), values[:, bonds : bonds + 3], values[:, bonds + 3 :]


def write_memory(template: Path, target: Path, state: State, law: Law) -> None:
    """Write a restart file with the memory of a state; `template` is one with the same grains and any memory.

    Parameters
    ----------
    template : restart file that LAMMPS wrote from a data file of the state
    """
    content, n, walls = read_content(template), len(state.grains.radius), len(state.walls.mass)
    start, blocks = _blocks(content)
    extra = _entries(state, law, n, walls)
    written = [content[:start]]
    for block in blocks:
        records = []
        tags = block.view("<i8")
        for first in _record_starts(block)[:-1]:
            mine = extra[int(tags[first + TAG]) - 1]
            record = np.concatenate([block[first : first + EXTRA], mine])
            record[0] = len(record)
            records.append(record)
        doubles = np.concatenate([*records, np.zeros(0)])
        written += [BLOCK, struct.pack("<i", len(doubles)), doubles.astype("<f8").tobytes()]
    target.write_bytes(b"".join([*written, MAGIC]))


def _entries(state: State, law: Law, n: int, walls: int) -> list[np.ndarray]:
    """Entries of the pair style and of the walls for each grain."""
    contacts, rows = state.contacts, touching(state)
    partners, touched = [[] for _ in range(n)], [{} for _ in range(n)]
    places, own = Places.of(law), contacts.rolling
    memories = np.zeros((len(rows), places.size))
    memories[:, :3] = contacts.slip[rows]
    c = linearise(state, law, memory=FROZEN) if law.properties & (KEEPS_FORCE | ROLLING) else None
    if law.properties & KEEPS_FORCE:
        memories[:, :3] *= -c.stiffness_t[rows, None]
    r_eff = _pair_sizes(state, rows)[0]
    if rescales(law):
        memories[:, 3] = np.sqrt(overlaps(state)[rows] * r_eff)
    if law.properties & ROLLING:
        memories[:, 3 + places.rolls : 6 + places.rolls] = r_eff[:, None] * np.cross(own[rows, :3], c.normal[rows])
    if law.properties & TWISTING:
        memories[:, 3 + places.twists] = own[rows, TWIST]
    for row, memory in zip(rows, memories, strict=True):
        i, j = int(contacts.i[row]), int(contacts.j[row])
        if j >= n:
            touched[i][j - n] = memory
            continue
        partners[i].append((j, memory))
        partners[j].append((i, np.append(-memory[:3], memory[3:])))
    entries = []
    for i in range(n):
        entry = [2 + sum(len(memory) + 1 for _, memory in partners[i]), len(partners[i])]
        for j, memory in partners[i]:
            entry += [_bits(j + 1), *memory]
        for wall in range(walls):
            memory = touched[i].get(wall)
            entry += [2.0, _bits(0)] if memory is None else [3.0 + len(memory), _bits(1), _bits(0), *memory]
        entries.append(np.array(entry, float))
    return entries


def _bits(number: int) -> float:
    """Double with the bits of a whole number."""
    return struct.unpack("<d", struct.pack("<q", number))[0]
