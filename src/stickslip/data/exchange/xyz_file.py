"""Extended XYZ files, which ASE and OVITO read: grains as atoms of species X, further columns, the cell, and the law.

They are written without a library, because ASE would write only eight decimals.
"""

import json
import re
from pathlib import Path

import numpy as np

from ...core.text import parse_numbers
from ..atomic import replace_atomically
from ..sample import NO_CONTACTS, PackingError
from .columns import packing_of_columns
from .content import Packing, chosen_frames, extent_note, head_text, read_lines
from .frame import Frame, exported, law_from_dict, law_to_dict, list_losses

PAIR = re.compile(r'(\w+)=("(?:[^"\\]|\\.)*"|\S+)')


def write_xyz(path: str | Path, frames: list[Frame]) -> list[str]:
    """Write frames one after the other, with numbers exact to the last bit.

    Return notes on what the format does not store.
    """
    with replace_atomically(Path(path)) as part, part.open("w", encoding="utf-8") as file:
        for frame in frames:
            file.write(_format_frame(frame))
    lost = ["contacts and their memory", *list_losses(frames[0], law=False)]
    return [f"extended XYZ does not store {', '.join(lost)}"]


def _format_frame(frame: Frame) -> str:
    grains, cell = frame.state.grains, frame.state.cell
    named = {"pos": grains.position, "radius": grains.radius, "mass": grains.mass, "velo": grains.velocity}
    named |= {"spin": grains.spin, "angle": grains.angle, "inertia": grains.inertia, "material": grains.material}
    named |= exported(frame.grains)
    columns, kinds = [], []
    for name, values in named.items():
        width = 1 if values.ndim == 1 else values.shape[1]
        kinds.append(f"{name}:{'I' if values.dtype.kind in 'iu' else 'R'}:{width}")
        columns.append([" ".join(map(repr, row)) for row in values.reshape(-1, width).tolist()])
    lattice = " ".join(repr(v) for v in cell.vectors.ravel().tolist())
    flags = " ".join("T" if p else "F" for p in cell.periodic)
    law = json.dumps(json.dumps(law_to_dict(frame.law)))  # quoted, with inner quotes escaped
    head = [f'Lattice="{lattice}"'] if cell.periodic.any() else []
    head += [f'pbc="{flags}"', f"Properties=species:S:1:{':'.join(kinds)}"]
    head += [f"time={frame.state.time!r}", f"dim={cell.dim}", f"law={law}"]
    rows = (f"X {' '.join(row)}\n" for row in zip(*columns, strict=True))
    return f"{len(grains.radius)}\n{' '.join(head)}\n{''.join(rows)}"


def recognize(head: bytes) -> bool:
    """Return True for extended XYZ: a count of grains, and a line that names the columns."""
    lines = head_text(head).split("\n", 2)
    return len(lines) > 1 and lines[0].strip().isdecimal() and "Properties=" in lines[1]


def read(path: Path, frame: str | None = None) -> list[Packing]:
    """Read frames, named by their number; the law is read if stickslip wrote it."""
    lines, starts, at = read_lines(path).rstrip("\n").split("\n"), [], 0
    while at < len(lines):
        if not re.fullmatch(r"\s*\d{1,12}\s*", lines[at]) or at + 2 + int(lines[at]) > len(lines):
            raise PackingError(
                f"{path} has {lines[at][:40]!r} where frame {len(starts)} begins: it is truncated or damaged"
            )
        starts.append(at)
        at += 2 + int(lines[at])
    chosen = chosen_frames(path, [str(k) for k in range(len(starts))], frame)
    return [_read_frame(path, str(k), lines[starts[k] :][: 2 + int(lines[starts[k]])]) for k in chosen]


def _read_frame(path: Path, name: str, lines: list[str]) -> Packing:
    about = dict(PAIR.findall(lines[1]))
    try:
        kinds = about["Properties"].strip('"').split(":")
        columns = _columns(kinds, [line.split() for line in lines[2:]])
        more, law = _box(about), law_from_dict(json.loads(json.loads(about["law"]))) if "law" in about else None
    except (KeyError, ValueError, IndexError, TypeError) as problem:
        raise PackingError(
            f"{path} has a damaged frame {name} ({problem}): its second line must name its columns"
        ) from None
    packing = packing_of_columns(columns, path.name, name, **more)
    notes = [*packing.notes, NO_CONTACTS] if law else packing.notes
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
