"""Formats that packings are read from, one line each: a file's content, not its name, tells which it is."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from ...wing import FileFormat, Wing, wings
from ..atomic import replace_atomically
from ..sample import PackingError
from . import arrays, gsd_file, lammps_file, lammps_restart, table_file, vtk_file, xyz_file
from .columns import at_rest, mass_note
from .content import HEAD, Packing, chosen_frames, extent_note, is_compressed, read_content
from .frame import Frame


class Format(NamedTuple):
    """A format: whether the first bytes of a file, decompressed, are in it, and how to read the file."""

    name: str
    recognize: Callable[[bytes], bool]
    read: Callable[..., list[Packing]]
    of_lammps: bool = False  # whether it takes the options for LAMMPS's files
    packs: bool = True  # whether files compressed as a whole are read


FORMATS = (
    Format(".npz and .npy of NumPy", arrays.recognize, arrays.read, packs=False),
    Format("archives of stickslip (.h5)", arrays.recognize_archive, arrays.read_archive, packs=False),
    Format("GSD", gsd_file.recognize, gsd_file.read, packs=False),
    Format("LAMMPS restart", lammps_restart.recognize, lammps_restart.read),
    Format("LAMMPS dump", lammps_file.recognize_dump, lammps_file.read_grain_dump, of_lammps=True),
    Format("LAMMPS data", lammps_file.recognize_data, lammps_file.read_data_file, of_lammps=True),
    Format("VTK", vtk_file.recognize, vtk_file.read),
    Format("extended XYZ", xyz_file.recognize, xyz_file.read),
    Format("MercuryDPM .data", table_file.recognize_mercury, table_file.read_mercury),
    Format("CSV, YADE and other tables", table_file.recognize, table_file.read),
)


def find_format(path: Path) -> Format:
    """Format of a file; PackingError with its first lines if it is in none of these."""
    head = read_content(path, HEAD)
    form = next((form for form in (*_formats_of_wings(), *FORMATS) if form.recognize(head)), None)
    if form is None:
        raise table_file.refuse(path)
    if is_compressed(path) and not form.packs:
        raise PackingError(
            f"{path} is compressed: decompress it first; text and LAMMPS's restart files are read as they are"
        )
    return form


def _formats_of_wings() -> list[Format]:
    """Formats that wings read, which come before those of the laboratory."""
    pairs = [(wing, one) for wing in wings().values() for one in wing.formats if one.start and one.read]
    return [
        Format(one.name, partial(re.match, one.start), partial(_read_by_wing, wing, one), packs=False)
        for wing, one in pairs
    ]


def _read_by_wing(wing: Wing, form: FileFormat, path: Path, frame: str | None = None) -> list[Packing]:
    try:
        frames = dict(wing.function(form.read)(path))
    except Exception as problem:  # code of other people
        said = str(problem) or type(problem).__name__
        raise PackingError(f"{path} cannot be read as {form.name} ({said}): it is damaged, or its wing is") from problem
    names = list(frames)
    return [_packing_of(path, names[k], frames[names[k]]) for k in chosen_frames(path, names, frame)]


def _packing_of(path: Path, name: str, given: dict) -> Packing:
    arrays = {key: value for key, value in given.items() if key != "law"}
    notes = [] if {"mass", "density"} & set(arrays) else [mass_note(path.name)]
    notes += [*at_rest(path.name, arrays), *([] if "cell" in arrays else [extent_note(path.name)])]
    return Packing(name, arrays, notes, law=given.get("law"))


def writers_of_wings() -> dict[str, Callable]:
    """Functions that write frames, by the file extensions of the formats that wings write."""
    pairs = [(wing, one) for wing in wings().values() for one in wing.formats if one.suffix and one.write]
    return {one.suffix: partial(_write_by_wing, wing, one) for wing, one in pairs}


def _write_by_wing(wing: Wing, form: FileFormat, path: Path, frames: list[Frame]) -> list[str]:
    with replace_atomically(path) as part:
        return list(wing.function(form.write)(part, frames))
