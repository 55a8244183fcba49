"""Formats that packings are read from, one line each: a file's content, not its name, tells which it is."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ..sample import PackingError
from . import arrays, gsd_file, lammps_file, lammps_restart, table_file, vtk_file, xyz_file
from .content import HEAD, Packing, is_compressed, read_content


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
    form = next((form for form in FORMATS if form.recognize(head)), None)
    if form is None:
        raise table_file.refuse(path)
    if is_compressed(path) and not form.packs:
        raise PackingError(
            f"{path} is compressed: decompress it first; text and LAMMPS's restart files are read as they are"
        )
    return form
