"""Packings from files, run folders and measured forces, for all commands, and conversion to other formats."""

from pathlib import Path

from ..core.arguments import check_value, checked
from ..core.laws.builtin import Law
from ..core.state import State
from ..data.exchange.files import (
    OPTIONS,
    Reading,
    is_measured,
    output_files,
    read_states,
    unknown_suffix,
    write_packing,
    written,
)
from ..data.exchange.frame import frame_of, mode_frames, read_mode
from ..data.run_files import NUMBERS, check_free
from ..data.sample import Assumption, PackingError


@checked
def read_packing(path: str | Path, **options) -> Reading:
    """Read one packing from a file in any known format, a run folder, or tables of measured forces.

    The format is detected from the content of a file, not from its name: .npz (names as in `from_arrays`) and .npy,
    archives, GSD, LAMMPS restart, data and dump files, MercuryDPM's .data, extended XYZ, VTK, and tables with columns
    such as x, y, z, radius (CSV, YADE, PFC). Text files may be compressed. In a LAMMPS run folder, the newest restart
    file, or data and dump files, are read together with laws, walls, gravity and fixes from the log or input script.
    From a run folder of this package, the archive is read. For measured forces (`contacts` is a table with a column fn,
    or the file is a PeGS file), the result is the nearest balanced state (see `packings.from_forces`).

    Returns
    -------
    Reading
        the state, its law, and notes on assumptions and changes; `assumed` lists the assumptions

    Parameters
    ----------
    law, coulomb, kn, kt, mu, young, poisson, damping, damping_n, damping_t : options of `law_by_name`, or None; `law`
        may also be a Law or a Python file. They take precedence over the law in the file. LAMMPS data and dump files
        contain no law; to read contacts from a dump, give all parameters of the law
    parameters : dict, other parameters of the law, such as {"work": 1e-3} for jkr, or those of a Python file
    i0 : float, moment of inertia I0 m R²
    frame : the state to read: a path in an archive such as main/frames/0.030000, the number of a frame, or a time step
        in a dump; the last one by default, except in archives
    contacts : path of the `dump local` that contains the contact memory of the grains, of the table of measured
        forces (see `read_forces`), or of a table of bonds with columns i, j, kn, ks … (YADE) or pb_kn, pb_ks … (PFC)
    columns : names of the columns of that table, i j dist dx dy dz fx fy fz tx ty tz, if not detected correctly
    boundary : three letters as in LAMMPS, such as ppf, if the file does not state the periodic directions
    atom_style : as in LAMMPS, such as "sphere" or "hybrid sphere bond", if a data file does not name it

    Raises
    ------
    PackingError
        If a file cannot be used.

    Warns
    -----
    PackingWarning
        If something in the packing was changed.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path, place = f"{folder}/pair.npz", [[0, 0, 0], [0.99, 0, 0]]
    ...     np.savez(path, position=place, radius=[0.5, 0.5])
    ...     state, law, _ = read_packing(path, law="linear", coulomb="sharp", mu=0.5)
    ...     state.contacts.count
    array([1])
    """
    ((_, *parts),) = read_packings(path, **{"frame": None, **options})
    return Reading(*parts)


@checked
def read_packings(
    path: str | Path, *, frame: str | int | None = "all", **options
) -> list[tuple[str, State, Law, list[str]]]:
    """Read all states of a file, each with its name, law and notes; options as in `read_packing`."""
    for name, value in options.items():
        if value is not None and name in OPTIONS:
            check_value(name, value, OPTIONS[name], given=True)
    frame = None if frame is None else str(frame)
    path, contacts = Path(path), options.get("contacts")
    if contacts and Path(contacts).is_file():
        from ..data.exchange.bond_tables import is_table_of_bonds, with_listed_bonds

        if is_table_of_bonds(Path(contacts)):
            found = read_packings(path, frame=frame, **options | {"contacts": None})
            held = [with_listed_bonds(state, Path(contacts)) for _, state, *_ in found]
            rest = zip(found, held, strict=True)
            return [(name, state, law, [*notes, *more]) for (name, _, law, notes), (state, more) in rest]
    if path.is_dir() and (path / NUMBERS).is_file():
        path = path / NUMBERS
    if is_measured(path, contacts and Path(contacts)):
        from ..data.exchange.force_network import measured_frames
        from .measured import read_measured

        frames = measured_frames(path, contacts and Path(contacts)) if frame == "all" else [frame]
        return [(name or "", *read_measured(path, **options | {"frame": name})) for name in frames]
    return read_states(path, frame, options)


def convert(
    path: str | Path, to: str | Path, *, modes: str | Path | None = None, mode: int = 0, count: int = 48,
    amplitude: float = 0.3, grow: bool = False, overwrite: bool = False, **options,
) -> tuple[list[Path], list[str]]:  # fmt: skip
    """Convert all states of a packing, or a chosen one, to another format, or animate one of its modes.

    Parameters
    ----------
    modes : file of modes that `stickslip stability` wrote; `mode`, `count`, `amplitude` and `grow`: see `mode_frames`
    overwrite : True if existing files may be replaced; input files are never replaced
    options : as in `read_packing`

    Returns
    -------
    list of Path
        files that were written
    list of str
        notes on the input, and on data that the new format does not store
    """
    path, to = Path(path), Path(to)
    if to.suffix.lower() not in written():
        raise PackingError(unknown_suffix(to))
    if modes is None:
        chosen = {} if options.get("frame") is None else {"frame": options["frame"]}
        packings = read_packings(path, **{**options, "frame": "all", **chosen})
        frames = [
            frame_of(state, law)._replace(assumed=tuple(note for note in said if isinstance(note, Assumption)))
            for _, state, law, said in packings
        ]
        notes = list(dict.fromkeys(note for *_, said in packings for note in said))
    else:
        state, law, notes = read_packing(path, **options)
        of_mode = read_mode(modes, mode, len(state.grains.radius))
        frames = mode_frames(frame_of(state, law), *of_mode, count=count, amplitude=amplitude, grow=grow)
        notes = [*notes, f"mode {mode}: s = {of_mode[2]:.4g}, {count} frames of one period"]
    targets = output_files(to, frames)
    sources = (path, modes, options.get("contacts"), options.get("law"))
    check_free(targets, overwrite=overwrite, made_from=(one for one in sources if not isinstance(one, Law)))
    notes += write_packing(to, frames)
    if to.suffix.lower() == ".vtu" and len(frames) > 1:
        notes.append(f"{len(frames)} frames: numbered files, which ParaView opens as a series")
        targets = targets[:2]
    return targets, notes
