"""Read packings in a format detected from the content, and write them in the format of the file extension."""

import difflib
import re
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...core.arguments import checked, knows_bonds, require_filled
from ...core.contacts.forces import FROZEN
from ...core.contacts.neighbors import with_neighbor_list
from ...core.laws.builtin import SHARP, Law, laws_equal, parameter_names, with_values
from ...core.readable import format_value, pluralize, readable
from ...core.state import State
from ...core.units import Units
from ...lazy import lazy_function
from ...wing import FileFormat, Wing, wings
from ..archive import named_units
from ..run_files import replace_atomically
from ..sample import (
    COLUMNS,
    LAW,
    NO_CONTACTS,
    Absent,
    Assumption,
    PackingError,
    PackingWarning,
    accepted,
    account_of,
    law_by_name,
    law_note,
    law_text,
    naming,
    notes_about,
    refusing,
    with_one_account,
)
from .arrays import (
    check_arrays,
    law_from_options,
    load_arrays,
    recognize,
    recognize_archive,
    write_archive,
    write_gsd,
    write_npz,
)
from .columns import (
    HEAD,
    Packing,
    at_rest,
    chosen_frames,
    extent_note,
    is_compressed,
    is_matlab,
    mass_note,
    placed_state,
    read_content,
)
from .frame import Frame, frame_of, unbonded, with_bonds, write_graph

if TYPE_CHECKING:
    from .lammps_file import Pairs


class Format(NamedTuple):
    """A format, with functions that recognise it from the first (decompressed) bytes of a file and read the file."""

    name: str
    recognize: Callable[[bytes], bool]
    read: Callable[..., list[Packing]]
    of_lammps: bool = False  # whether the options for LAMMPS files apply
    packs: bool = True  # whether files that are compressed as a whole can be read


_here = partial(lazy_function, __package__)  # modules of formats are imported on demand

FORMATS = (
    Format("NumPy .npz and .npy", _here("arrays.recognize"), _here("arrays.read"), packs=False),
    Format("stickslip archives (.h5)", _here("arrays.recognize_archive"), _here("arrays.read_archive"), packs=False),
    Format("GSD", _here("arrays.recognize_gsd"), _here("arrays.read_gsd"), packs=False),
    Format("LAMMPS restart", _here("lammps_restart.recognize"), _here("lammps_restart.read")),
    Format("part of a LAMMPS restart", _here("lammps_restart.recognize_part"), _here("lammps_restart.read")),
    Format("LAMMPS dump", _here("lammps_file.recognize_dump"), _here("lammps_file.read_grain_dump"), of_lammps=True),
    Format("LAMMPS data", _here("lammps_file.recognize_data"), _here("lammps_text.read_data_file"), of_lammps=True),
    Format("VTK", _here("vtk_file.recognize"), _here("vtk_file.read")),
    Format("extended XYZ", _here("table_file.recognize_xyz"), _here("table_file.read_xyz")),
    Format("MercuryDPM .data", _here("table_file.recognize_mercury"), _here("table_file.read_mercury")),
    Format("EDEM's export", _here("table_file.recognize_edem"), _here("table_file.read_edem")),
    Format("jamBashBulk", _here("table_file.recognize_jambash"), _here("table_file.read_jambash")),
    Format("PackLSD", _here("table_file.recognize_packlsd"), _here("table_file.read_packlsd")),
    Format("MFIX", _here("table_file.recognize_mfix"), _here("table_file.read_mfix")),
    Format("CSV, YADE and other tables", _here("table_file.recognize"), _here("table_file.read")),
)


def is_measured(path: Path, contacts: Path | None) -> bool:
    """Return True for a MATLAB file, or if there is a table of contact forces that is not from LAMMPS."""
    if contacts is None or not contacts.is_file():
        return is_matlab(path)
    from .force_lists import is_table_of_forces

    return is_table_of_forces(path, contacts)


def find_format(path: Path) -> Format:
    """Format of a file; raise PackingError, with the first lines of the file, if it is unknown."""
    head = read_content(path, HEAD)
    of_wings = [  # tried before tables, which have no fixed beginning, but after the other formats of the package
        Format(one.name, partial(re.match, one.start), partial(_read_by_wing, wing, one), packs=False)
        for wing in wings().values() for one in wing.formats if one.start and one.read
    ]  # fmt: skip
    form = next((form for form in (*FORMATS[:-1], *of_wings, FORMATS[-1]) if form.recognize(head)), None)
    if form is None:
        from .table_file import refuse

        raise refuse(path)
    if is_compressed(path) and not form.packs:
        raise PackingError(
            f"{path} is compressed: decompress it first; only text and LAMMPS restart files can be read compressed"
        )
    return form


def _read_by_wing(wing: Wing, form: FileFormat, path: Path, frame: str | None = None) -> list[Packing]:
    try:
        frames = {str(name): dict(arrays) for name, arrays in dict(wing.function(form.read)(path)).items()}
        if not frames:
            raise ValueError("it has no frames")
        for law in (arrays.get("law") for arrays in frames.values()):
            if not isinstance(law, Law | dict | None):
                raise TypeError(f"its law must be a Law or a dict of options, got {law!r}")
    except (Exception, SystemExit) as problem:  # code of third parties may raise any exception
        said = str(problem) or type(problem).__name__
        raise PackingError(
            f"{path} cannot be read as {form.name} ({said}): the file is damaged, or its wing is faulty"
        ) from problem
    names, packings = list(frames), []
    for name in (names[k] for k in chosen_frames(path, names, frame)):
        arrays = {key: value for key, value in frames[name].items() if key != "law"}
        notes = [] if {"mass", "density"} & set(arrays) else [mass_note(path.name)]
        notes += [*at_rest(path.name, arrays), *([] if "cell" in arrays else [extent_note(path.name)])]
        packings.append(Packing(name, arrays, notes, law=frames[name].get("law")))
    return packings


def writers_of_wings() -> dict[str, Callable]:
    """Functions of wings that write frames, by file extension."""
    pairs = [(wing, one) for wing in wings().values() for one in wing.formats if one.suffix and one.write]
    return {one.suffix: partial(_write_by_wing, wing, one) for wing, one in pairs}


def _write_by_wing(wing: Wing, form: FileFormat, path: Path, frames: list[Frame]) -> list[str]:
    with replace_atomically(path) as part:
        try:
            return [str(note) for note in wing.function(form.write)(part, frames)]
        except (Exception, SystemExit) as problem:  # code of third parties may raise any exception
            said = str(problem) or type(problem).__name__
            raise PackingError(f"{path} cannot be written as {form.name} ({said}): its wing is faulty") from problem


ARCHIVE, LAMMPS_DATA = (".h5", ".hdf5"), (".data", ".lmp", ".lammps")
SHOWN = (".vtu", ".graphml")  # formats in which lines or edges show bonds
SERIES = {".gsd": write_gsd, ".vtu": _here("vtk_file.write_vtk")}
SERIES |= dict.fromkeys((".xyz", ".extxyz"), _here("table_file.write_xyz"))
SINGLE = {".npz": write_npz, ".csv": _here("table_file.write_csv"), ".graphml": write_graph}
SINGLE |= dict.fromkeys(LAMMPS_DATA, _here("lammps_text.write_lammps"))
LAW_OPTIONS = ("--law", "--kn", "--kt", "--mu", "--damping-n", "--damping-t")
LAMMPS_OPTIONS = ("contacts", "columns", "boundary", "atom_style")
WHOLE = ("coulomb", "young", "poisson", "damping", "tension")  # options that a complete law contains
OPTIONS = {  # types of the options of `read_packing`, except numbers, which laws check
    "law": str | Path | Law, "coulomb": str, "damping": str, "tension": bool, "parameters": dict, "i0": float,
    "contacts": str | Path, "columns": str, "boundary": str, "atom_style": str,
}  # fmt: skip


def written() -> tuple[str, ...]:
    """File extensions of the formats that can be written."""
    return (*SINGLE, *ARCHIVE, *SERIES, *writers_of_wings())


@readable(head=lambda r: f"{format_value(r.state)}; {format_value(r.law)}; {pluralize(len(r.notes), 'note')}")
class Reading(NamedTuple):
    """A packing read from a file, with its law and notes."""

    state: State
    law: Law
    notes: list[str]

    @property
    def assumed(self) -> list[str]:
        """Notes on assumptions about data missing from the file, such as a law, masses, a box or slip."""
        return [note for note in self.notes if isinstance(note, Assumption)]

    @property
    def met(self) -> dict[str, list[str]]:
        """Names in a foreign file, grouped into those that are used, without influence on forces, or unknown."""
        return account_of(self.notes)


def read_states(path: Path, frame: str | None, options: dict) -> list[tuple[str, State, Law, list[str]]]:
    """States of a file or a LAMMPS run folder, each with its name, law and notes.

    Parameters
    ----------
    frame : as in `read_packing`, or "all"
    options : other options of `read_packing`

    Raises
    ------
    PackingError
        If a file cannot be used; the message does not always name the file.
    """
    if not (path.is_file() or path.is_dir()):
        raise PackingError(f"{path} is not a file or folder: give a packing; `stickslip docs exchange` lists formats")
    given, file_law = separate_law({name: value for name, value in options.items() if value is not None})
    i0, of_lammps = given.pop("i0", None), {name: given.pop(name) for name in LAMMPS_OPTIONS if name in given}
    if path.is_dir():
        from .lammps_folder import read_folder

        if of_lammps:
            raise PackingError(
                f"{', '.join(of_lammps)} does not apply to the folder {path}, whose files contain this information: "
                "give one of these files"
            )
        packing, contacts = read_folder(path, None if frame == "all" else frame)
        if contacts and packing.law is None and not given and file_law is None:
            unused = Absent(f"the memory of contacts in {contacts.name} needs the law: give {', '.join(LAW_OPTIONS)}")
            packing, contacts = packing._replace(notes=[*packing.notes, unused]), None
        return [_build(path, packing, given, file_law, i0, contacts)]
    form = find_format(path)
    if of_lammps and not form.of_lammps:
        raise PackingError(
            f"{', '.join(of_lammps)} does not apply to {path.name} ({form.name}): this option is for LAMMPS data and "
            "dump files, or for a table of grains together with a table of contacts with columns i j fn ft"
        )
    contacts, columns = of_lammps.pop("contacts", None), of_lammps.pop("columns", None)
    if contacts is not None and not Path(contacts).is_file():
        raise PackingError(f"{contacts} is not a file: give the contacts that LAMMPS's `dump local` wrote")
    if contacts is not None and "boundary" not in of_lammps:
        from .lammps_file import read_boundary

        of_lammps["boundary"] = read_boundary(Path(contacts))
    packings = form.read(path, frame, **of_lammps)
    return [_build(path, packing, given, file_law, i0, contacts, columns) for packing in packings]


def _build(
    path: Path, packing: Packing, given: dict, own: Law | None, i0: float | None,
    contacts: str | Path | None, columns: str | None = None,
):  # fmt: skip
    """Name, state, law and notes of a packing, built with the given options and the contacts of a `dump local`.

    Memory is unchanged if the law stays the same; otherwise slip is truncated at the limit of the new law.
    """
    its, notes = packing.law, packing.notes
    with naming(path):
        law = chosen_law(packing, given, own, memory=contacts is not None)
    if own is not None or given:
        notes = [note for note in notes if note not in notes_about(notes, LAW)]
        if isinstance(its, Law) and not laws_equal(its, law):
            replaced = f"the law of the file ({law_text(its)}) is replaced by {law_text(law)}"
            notes = [*notes, replaced]
    elif its is None:
        notes = [*notes, law_note(law)]
    if packing.types is not None and packing.types.max() > 0 and len(law.table) == 1 and (given or own is not None):
        several = f"one law is used for all grains, although they are of {packing.types.max() + 1} types"
        notes = [*notes, Absent(several)]
    pairs = None
    if contacts is not None and packing.state is None:
        from .lammps_file import read_pairs

        pairs = read_pairs(Path(contacts), packing, columns)
    with naming(path):
        if packing.state is not None:
            same = isinstance(its, Law) and not given and (own is None or laws_equal(own, its))
            state = with_neighbor_list(with_inertia(packing.state, i0))
            return packing.name, accepted(state, law, **({"memory": FROZEN} if same else {})), law, notes
        try:
            state, said = build_state(packing, pairs, law)
        except PackingError as problem:
            if told := "; ".join(notes_about(notes, COLUMNS)):
                raise PackingError(f"{problem}; {told}") from None
            raise
        return packing.name, with_inertia(state, i0), law, with_one_account([*notes, *said])


def build_state(packing: Packing, pairs: "Pairs | None", law: Law) -> tuple[State, list[str]]:
    """Accepted state of a packing, with the memory of its contacts if known, and notes on it."""
    if pairs is not None:
        from .lammps_file import state_of_pairs

        return state_of_pairs(packing, pairs, law)
    state = placed_state(packing, law)
    if packing.memory is not None:
        from .lammps_restart import restore_memory

        return restore_memory(state, law, packing.memory), []
    return state, [] if "pair_i" in packing.arrays else [NO_CONTACTS]


def chosen_law(packing: Packing, given: dict, own: Law | None, *, memory: bool) -> Law:
    """The given law, or the packing's law with the given parameters, or else the default law."""
    its = packing.law
    numbers = isinstance(its, Law) and own is None and {*given} <= {*parameter_names(its)}
    if numbers:
        return with_values(its, **given)
    law = own or lammps_law(its | given if isinstance(its, dict) else given, memory=memory)
    if packing.setting and isinstance(its, Law):  # every type of grain and every wall is a material
        law = law._replace(table=np.tile(law.table[:1, :1], (len(its.table), len(its.table), 1)))
    return law


@checked
def packing_units(path: str | Path) -> Units | None:
    """Units named in a packing or a run folder; None if there are none.

    In an .npz file, the entry `units` contains "SI", or names of length, mass and time as in "mm, g, s". Archives store
    the units of the scenario. `units_in_use` prints numbers in these units.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = f"{folder}/one.npz"
    ...     np.savez(path, position=[[0, 0, 0]], radius=[0.5], units="mm, g, s")
    ...     print(packing_units(path))
    mm, g, s
    """
    path = Path(path)
    path = path / "results.h5" if path.is_dir() else path
    if not path.is_file():
        return None
    with path.open("rb") as file:
        head = file.read(HEAD)
    if recognize(head):
        arrays = load_arrays(path)
        return check_arrays(path, arrays)[0]["units"] if "units" in arrays else None
    if not recognize_archive(head):
        return None
    return named_units(path)


def separate_law(given: dict) -> tuple[dict, Law | None]:
    """Return the options that do not concern the law, and the law if the user gave one or a Python file."""
    more = given.get("parameters", {})
    given = {name: value for name, value in given.items() if name != "parameters"}
    law = given.get("law", "")
    is_file = not isinstance(law, Law)
    if is_file and not str(law).endswith(".py"):
        return given | more, None
    from ...core.laws.user import from_file

    values = {name: value for name, value in given.items() if name not in (*OPTIONS, *WHOLE)}
    with refusing():
        law = with_values(from_file(law) if is_file else law, **values, **more)
    rest = {name: value for name, value in given.items() if name not in values}
    lost = [name for name in WHOLE if name in rest]
    if lost:
        whole = f"a law from a file: set it in {given['law']}" if is_file else "a complete law: set it in that law"
        raise PackingError(f"{lost[0]} does not apply to {whole}")
    return {name: value for name, value in rest.items() if name != "law"}, law


def lammps_law(given: dict, *, memory: bool) -> Law:
    """Law for LAMMPS files; all of its parameters are required if the `memory` of contacts follows from forces."""
    if not memory:
        return law_from_options(given)
    from .lammps_file import complete_law_options

    return law_by_name(**complete_law_options(given))


def with_inertia(state: State, i0: float | None) -> State:
    """State whose grains have the moments of inertia i0 m R²; unchanged if `i0` is None."""
    if i0 is None:
        return state
    if not (i0 > 0 and i0 < float("inf")):
        raise PackingError(f"i0 must be positive, got {i0}")
    grains = state.grains
    return state._replace(grains=grains._replace(inertia=i0 * grains.mass * grains.radius**2))


@checked
@knows_bonds
def write_packing(path: str | Path, states: State | list[Frame], law: Law | None = None) -> list[str]:
    """Write an accepted state, or several as a trajectory, in the format selected by the file extension.

    Parameters
    ----------
    path : .npz, .h5, .gsd (OVITO), .vtu (ParaView), .xyz (ASE), .data (LAMMPS), .csv (grains, and contacts in a second
    file), .graphml (contact network). Files are replaced atomically
    states : State with `law`, or a list of Frame from `frame_of` or `mode_frames`

    Returns
    -------
    list of str
        notes on data that the format does not store

    Examples
    --------
    >>> import tempfile
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    ...     write_packing(f"{folder}/p.xyz", pair, law)
    ['extended XYZ does not store contacts and their memory']
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in written():
        raise PackingError(unknown_suffix(path))
    if isinstance(states, State):
        if law is None:
            raise PackingError("a law is needed to compute forces: give the law of the state")
        states = [frame_of(states, law)]
    require_filled("states", states)
    frames: list[Frame] = list(states)
    if suffix in (".npz", *ARCHIVE, ".gsd", *LAMMPS_DATA) or not any(frame.state.bonds for frame in frames):
        return _write(path, suffix, frames)
    if suffix in SHOWN:
        return [*_write(path, suffix, frames), f"{suffix} shows bonds, but not their laws and memory"]
    return [*_write(path, suffix, [unbonded(frame) for frame in frames]), f"{suffix} does not store bonds"]


def _write(path: Path, suffix: str, frames: list[Frame]) -> list[str]:
    """Write frames in a known format; return notes on data that it does not store."""
    if suffix not in (*SINGLE, *ARCHIVE):
        return (writers_of_wings() | SERIES)[suffix](path, frames)
    if any(frame.moving for frame in frames):
        raise PackingError(f"an animation cannot be written as {suffix}: use {', '.join(SERIES)}")
    if suffix in ARCHIVE:
        return write_archive(path, frames)
    if len(frames) > 1:
        raise PackingError(
            f"{len(frames)} states cannot be written as {suffix}, which stores one: choose one with --frame, or use "
            f"{', '.join((*SERIES, ARCHIVE[0]))}"
        )
    return SINGLE[suffix](path, frames[0])


def output_files(to: Path, frames: list[Frame]) -> list[Path]:
    """Output files for the frames of a packing, beginning with those of the first frame."""
    if to.suffix.lower() == ".vtu":
        from .vtk_file import vtk_paths

        pairs = zip(vtk_paths(to, len(frames)), frames, strict=True)
        return [
            path for (grains, lines), f in pairs for path in (grains, *([lines] if len(with_bonds(f)["i"]) else []))
        ]
    if to.suffix.lower() == ".csv":
        from .table_file import contact_table_path

        return [to, contact_table_path(to)]
    from .lammps_text import contacts_path

    holds = to.suffix.lower() in LAMMPS_DATA and frames[0].law.coulomb == SHARP
    return [to, *([contacts_path(to)] if holds else [])]


def unknown_suffix(path: Path) -> str:
    """Return the message on an unsupported file extension."""
    near = difflib.get_close_matches(path.suffix.lower(), written(), n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"{', '.join(written())} can be written"
    ending = f"ends with {path.suffix!r}, an unsupported output format" if path.suffix else "has no extension"
    return f"{path} {ending}: {hint}"


def capture_warnings(call, *given, **options):
    """Call a function and return its result together with the messages of its PackingWarnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", PackingWarning)
        result = call(*given, **options)
    return result, list(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, PackingWarning)))
