"""LAMMPS run folder: grains and memory from its files, and law, walls, gravity and fixes from the commands."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ...known import HARMLESS, UNKNOWN, USED, group_of
from ..sample import (
    BONDS,
    FIXES,
    GROUP,
    PAIRS,
    WALLS,
    Absent,
    Account,
    Assumption,
    Obstacle,
    PackingError,
    naming,
    notes_about,
)
from . import lammps_restart
from .columns import HEAD, Packing, head_text, is_compressed, read_content
from .lammps_bonds import can_break, replay, with_lengths
from .lammps_commands import (
    BEGINNING,
    FILING,
    WRITING,
    Dump,
    Run,
    means,
    numbers_in,
    read_commands,
    read_lines_of,
    recognize_log,
    recognize_script,
)
from .lammps_course import Course, describe, setting, take_over, with_wall_numbers
from .lammps_file import Pairs, read_boundary, read_grain_dump, read_pairs, recognize_data, recognize_dump
from .lammps_text import read_data_file

LOOKED_AT = 50  # number of newest dumps whose last time step is read
TAIL = 2**20  # size of the end of a dump that is first searched for its last time step [bytes]


class Files(NamedTuple):
    """Files of a folder, grouped by content."""

    restarts: list[Path]
    grains: list[Path]  # dumps
    data: list[Path]
    contacts: list[Path]  # `dump local`
    logs: list[Path]
    scripts: list[Path]
    others: list[Path]
    words: dict[Path, list[list[str]]]  # lines of logs and scripts, split into words by `read_folder`

    @property
    def packings(self) -> list[Path]:
        """Files with grains."""
        return [*self.restarts, *self.grains, *self.data]


def is_run_folder(folder: Path) -> bool:
    """Return True if a folder has grains written by LAMMPS."""
    return folder.is_dir() and bool(list_files(folder).packings)


def list_files(folder: Path) -> Files:
    """Group the files of a folder by their content."""
    files = Files([], [], [], [], [], [], [], {})
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not path.is_file():
            continue
        try:
            head = read_content(path, HEAD)
        except (OSError, PackingError):
            files.others.append(path)
            continue
        text = head_text(head)
        if lammps_restart.recognize(head):
            files.restarts.append(path)
        elif recognize_dump(head):
            (files.contacts if "NUMBER OF ENTRIES" in text else files.grains).append(path)
        elif recognize_log(text):
            files.logs.append(path)
        elif recognize_data(head):
            files.data.append(path)
        elif recognize_script(text):
            files.scripts.append(path)
        else:
            files.others.append(path)
    return files


def read_folder(folder: Path, frame: str | None = None) -> tuple[Packing, Path | None]:
    """Packing of a run, and the dump of its contacts unless their memory is in a restart file."""
    every = list_files(folder)
    if not every.packings:
        raise PackingError(
            f"{folder} has no LAMMPS restart file, dump of atoms or data file: give a LAMMPS run folder, or a packing"
        )
    for source in (*every.logs, *every.scripts):
        every.words[source] = [line.split() for line in read_lines_of(source).split("\n") if line[:1].isalpha()]
    files, left = _of_newest_run(every) if frame is None else (every, [])
    path, run, packing = _newest_packing(files, frame)
    notes, contacts = [f"grains from {path.name}, time step {packing.step}", *left], None
    notes += _origin_notes(files, path, packing, run)
    if strange := _strange_files(every):
        notes.append(f"files in unknown formats, not used: {', '.join(strange)}")
    if packing.memory is None:
        contacts, why = _matching_contacts(files.contacts, packing)
        notes += [f"contacts in {contacts.name}"] if contacts else map(Absent, why)
    if run is None:
        notes.append(Absent("the folder has no log.lammps and no input script: walls, gravity and fixes are unknown"))
        notes.append(_account_of_files(every, path, contacts))
        return packing._replace(notes=[*notes, *packing.notes]), contacts
    packing, said = _with_bonds(packing, path, every, run)
    notes += said
    masks = lammps_restart.group_masks(path, packing.memory) if packing.memory is not None else {}
    with naming(path):
        course = Course(run, packing, masks)
    take_over(course)
    for doubt in _contradictions(path, run, course.stored) if path in files.restarts else ():
        course.obstacle(doubt)
    notes += [f"law, walls and loads from {run.source}: {describe(course)}", *course.notes]
    whole = run.atoms == course.n
    walls = bool(course.walls) or not course.free.all()
    known = notes_about(packing.notes, PAIRS, FIXES, BONDS, *[WALLS] * walls, *[GROUP] * whole)
    kept = [note for note in packing.notes if note not in known]
    sources = [other for other in (*every.logs, *every.scripts) if other.name in run.sources]
    words = {group: [f"command {word}" for word in sorted(names)] for group, names in course.run.met.items()}
    words[UNKNOWN] = []  # `course.met` contains them with their places
    kept += [Account.of(words, course.met), _account_of_files(every, path, contacts, *sources)]
    memory = packing.memory and with_wall_numbers(packing.memory, course)
    law = course.law or packing.law
    return packing._replace(notes=[*notes, *kept], law=law, setting=setting(course), memory=memory), contacts


def _account_of_files(files: Files, *taken: Path | None) -> Account:
    """Files of a folder by their use; files named in commands are classified with the commands."""
    strange, groups = _strange_files(files), {USED: [], HARMLESS: [], UNKNOWN: []}
    for path in sorted({*files.packings, *files.contacts, *files.logs, *files.scripts, *files.others}):
        group = USED if path in taken else UNKNOWN if path.name in strange else HARMLESS
        groups[group].append(f"file {path.name}")
    return Account.of(groups)


def _strange_files(files: Files) -> list[str]:
    """Names of files in unknown formats that no command mentions and whose names are not known either."""
    named = {word for lines in files.words.values() for words in lines for word in words[1:]}
    rest = [path.name for path in files.others if group_of("file", path.name) == UNKNOWN]
    return [name for name in rest if not any(means(word, name) for word in named)]


def _of_newest_run(files: Files) -> tuple[Files, list[str]]:
    """Grain files of the newest run according to its log, and a note on the others; all grain files without a log."""
    if not files.logs:
        return files, []
    log = max(files.logs, key=lambda path: path.stat().st_mtime)
    before = _logs_before(log, files)
    run = read_commands(log, "", before)
    why = {}
    for path in files.packings:
        step = _step_of(path, files)
        if not any(_names(files, other, path.name) for other in (*before, log)):
            why[path] = f"{log.name} does not name it"
        elif not run.has_step(step):
            why[path] = f"time step {step}, {_steps_of(run)}"
    mine = [path for path in files.packings if path not in why]
    if not mine or not why:
        return files, []
    parts = files._replace(
        **{name: [path for path in getattr(files, name) if path in mine] for name in ("restarts", "grains", "data")}
    )
    told = "; ".join(f"{path.name} ({reason})" for path, reason in why.items())
    return parts, [f"left out, as they do not belong to the run of {log.name}: {told}"]


def _steps_of(run: Run) -> str:
    first, last = run.steps() or (0, 0)
    return f"and {run.source} goes from {first} to {last}"


def _step_of(path: Path, files: Files) -> int:
    """Time step of the newest grains in a file; −1 if unknown."""
    if path in files.restarts:
        return lammps_restart.time_step(path)
    return _last_frame(path)[1] if path in files.grains else _data_step(path)


def _newest_packing(files: Files, frame: str | None) -> tuple[Path, Run | None, Packing]:
    """File of the newest readable grains, the commands of its run, and the packing."""
    path = _newest_grains(files, frame)
    step = int(frame) if frame and frame.isdecimal() else _step_of(path, files)
    source = _newest_commands(files, path, step)
    run = None if source is None else read_commands(source, path.name, _logs_before(source, files), step)
    try:
        return path, run, _read_grains(path, files, frame, run)
    except PackingError as problem:
        if path not in files.restarts or len(files.packings) == 1:
            raise
        rest = files._replace(restarts=[other for other in files.restarts if other != path])
        path, run, packing = _newest_packing(rest, frame)
        return path, run, packing._replace(notes=[Absent(str(problem)), *packing.notes])


def _newest_grains(files: Files, frame: str | None) -> Path:
    """The newest restart file, or else the newest dump or data file, by time step."""
    place = _places(files)
    if files.restarts and frame is None:
        steps = {path: lammps_restart.time_step(path) for path in files.restarts}
        return max(steps, key=lambda path: (place(path, steps[path]), steps[path], path.stat().st_mtime))
    numbers = {path: [int(digits) for digits in re.findall(r"\d{1,18}", path.name)] for path in files.grains}
    newest = sorted(files.grains, key=lambda path: (path.stat().st_mtime, numbers[path]))[-LOOKED_AT:]
    frames = [(*_last_frame(path), path) for path in newest]
    dumps = [tuple(key) for radii, *key in frames if radii] or [tuple(key) for _, *key in frames]
    data = [] if dumps and frame is not None else [(_data_step(path), path) for path in files.data]
    times = {path: 0.0 if path in files.data else path.stat().st_mtime for _, path in (*dumps, *data)}
    return max((place(path, step), step, times[path], path) for step, path in (*dumps, *data))[3]


def _places(files: Files) -> Callable[[Path, int], int]:
    """Function that returns the position of a file and time step in the newest log; 0 unless time steps go back."""
    log = max(files.logs, key=lambda path: path.stat().st_mtime, default=None)
    before = [] if log is None else _logs_before(log, files)
    if log is None or not read_commands(log, "", before).goes_back():
        return lambda path, step: 0
    return lambda path, step: read_commands(log, path.name, before, step).place


def _read_grains(path: Path, files: Files, frame: str | None, run: Run | None) -> Packing:
    """Packing of a file, with the boundaries and the atom style of the run if the file lacks them."""
    if path in files.restarts:
        return lammps_restart.read(path)[0]
    settings = {} if run is None else run.settings
    boundary = "".join(word[0] for word in settings.get("boundary", [])) or None
    if path in files.grains:
        dump = _dump_of(path, run)
        return read_grain_dump(path, frame, boundary, names=dump and dump.names)[0]
    if boundary is None:
        boundary = next((read_boundary(other) for other in [*files.contacts, *files.grains]), None)
    style = " ".join(settings.get("atom_style", ()))
    return read_data_file(path, frame, boundary, style if style.startswith("hybrid") else None)[0]


def _with_bonds(packing: Packing, path: Path, files: Files, run: Run) -> tuple[Packing, list[str]]:
    """Packing with bonds listed in another file of its run, if its own format has none, and with their rest lengths.

    A data file lists bonds at its time step. Those of the initial file also apply later, if the run does not change
    them.
    """
    told = replay(run.bonds)
    data = [other for other in files.data if other != path] if told.style or told.made else []
    others: dict[Path, Packing | None] = dict.fromkeys(data)
    failed: list[str] = []
    for other in data:
        try:
            others[other] = _read_grains(other, files, None, run)
        except PackingError as problem:
            failed.append(str(problem))
    then = next((others[other] for other in others if told.origin and means(told.origin, other.name)), None)
    bonds, notes = packing.bonds, []
    if bonds is None:
        written = {other for other in others if any(_names(files, log, other.name, WRITING) for log in files.words)}
        now = [other for name, other in others.items() if name in written and other and other.step == packing.step >= 0]
        listing = now[0] if now else then if then and not told.made and not told.deleted else None
        known = listing and listing.ids is not None and packing.ids is not None
        if known and len(listing.ids) == len(packing.ids) and (listing.ids == packing.ids).all():
            bonds = listing.bonds
            notes = [f"bonds in {bonds.source}"] if len(bonds.i) else []
            if not now and len(bonds.i) and can_break(told):
                notes.append(Obstacle(f"bonds of {bonds.source} may have broken since: `write_data` lists the others"))
    if bonds is None:
        notes += [Absent(f"bonds were not read: {problem}") for problem in failed]
    if bonds is not None and bonds.length is None and told.strained and then:
        bonds = with_lengths(bonds, packing, then)
    return packing._replace(bonds=bonds), notes


def _last_frame(path: Path) -> tuple[bool, int]:
    """Presence of radii in the last frame of a dump, and the time step of this frame; −1 if it cannot be found."""
    if is_compressed(path):
        content = read_content(path)
    else:
        with path.open("rb") as file:
            file.seek(max(file.seek(0, 2) - TAIL, 0))
            content = file.read()
        content = content if b"ITEM: TIMESTEP" in content else read_content(path)
    match = re.findall(rb"ITEM: TIMESTEP\s+(\d{1,18})\s", content)
    columns = content[content.rfind(b"ITEM: ATOMS") :].split(b"\n", 1)[0].split()
    return bool({b"radius", b"diameter"} & set(columns)), int(match[-1]) if match else -1


def _data_step(path: Path) -> int:
    match = re.search(r"timestep = (\d{1,18})", head_text(read_content(path, HEAD)).split("\n", 1)[0])
    return int(match[1]) if match else -1


def _matching_contacts(paths: list[Path], packing: Packing) -> tuple[Path | None, list[str]]:
    """The first dump of contacts that belongs to the packing, and reasons why others do not."""
    mark, why = re.compile(rb"ITEM: TIMESTEP\s+%d\s" % packing.step), []
    for path in paths:
        if packing.step >= 0 and not mark.search(read_content(path)):
            why.append(f"{path.name} has no contacts at time step {packing.step}")
            continue
        try:
            pairs: Pairs = read_pairs(path, packing)
        except PackingError as problem:
            why.append(f"contacts were not read: {problem}")
            continue
        if len(pairs.i):
            return path, []
        why.append(f"{path.name} has no contacts")
    return None, why


def _origin_notes(files: Files, grains: Path, packing: Packing, run: Run | None) -> list[str]:
    """Notes on grains that are the initial ones of a run, or that may not belong to the run of the commands."""
    sources, notes = files.logs or files.scripts, []
    writes = any(_names(files, path, grains.name, tuple({*FILING} - {*BEGINNING})) for path in sources)
    if not writes and any(_names(files, path, grains.name, BEGINNING) for path in sources):
        others = [path.name for path in files.packings if path != grains]
        rest = f"; {others[0]} may have a later one: give that file" if others else ", which left no later one"
        notes.append(Absent(f"{grains.name} is the initial state of the run{rest}"))
    naming = [path for path in sources if _names(files, path, grains.name)]
    doubts = [_mismatch(grains, packing, run)] if run else []
    if run and not run.blocks and "reset_timestep" in run.met[USED] and len(files.packings) > 1:
        doubts.append(
            f"{run.source} resets the time step, and only its log.lammps shows which of {len(files.packings)} grain "
            f"files is the newest: {grains.name} was used; give the log, or the file itself"
        )
    if len(sources) > 1 and not naming:
        several = ", ".join(path.name for path in sources[:3])
        doubts.append(
            f"none of {several} names {grains.name}, which may belong to another run: use a separate folder for each "
            "run"
        )
    elif run and not naming:
        notes.append(Assumption(f"{run.source} does not name {grains.name}, which is assumed to belong to its run"))
    runs = [read_commands(path, grains.name, _logs_before(path, files), packing.step) for path in naming]
    runs = [other for other in runs if other.has_step(packing.step) and not _differs(grains, files, other)]
    laws = [(other.pair_style, other.pair_coeff, other.fixes) for other in runs]
    if any(law != laws[0] for law in laws):
        several = " and ".join(other.source for other in runs[:3])
        doubts.append(f"{several} name {grains.name} with different laws or fixes: keep only one of them")
    return [*notes, *map(Obstacle, filter(None, doubts))]


def _differs(path: Path, files: Files, run: Run) -> bool:
    """Return True if a restart file lacks coefficients of the pair style of a run, and so belongs to another run."""
    given = numbers_in(run.pair_style[1:6])
    return path in files.restarts and bool(lammps_restart.compare_pair_style(path, given)[1])


def _dump_of(path: Path, run: Run | None) -> Dump | None:
    """The last command that wrote a dump; None if unknown."""
    found = [dump for dump in run.dumps.values() if means(dump.file, path.name)] if run else []
    return found[-1] if found else None


def _mismatch(path: Path, packing: Packing, run: Run) -> str:
    """Sentence on a time step or number of grains that does not occur in the run of a log; empty if both occur."""
    n = len(packing.arrays["radius"])
    if not run.has_step(packing.step):
        return f"the grains have time step {packing.step}, {_steps_of(run)}: they belong to another run"
    count, dump = run.atoms, _dump_of(path, run)
    if dump and dump.selection and count != n:
        of = f", of {count} in the run of {run.source}" if count else ""
        return (
            f"{path.name} contains {n} grains{of}: `{dump.selection}` leaves out others, which may touch them; "
            "give a dump of all grains"
        )
    return "" if count in (None, n) else f"{n} grains were read, but the run of {run.source} had {count} at that time"


def _contradictions(path: Path, run: Run, numbers: list[float]) -> list[str]:
    """Sentences on differences in pair style, coefficients and fixes between a restart file and the commands."""
    style, lacking = lammps_restart.compare_pair_style(path, numbers)
    told = []
    if style and run.pair_style and run.pair_style[0].removeprefix("gran/") != style.removeprefix("gran/"):
        told.append(f"has pair_style {run.pair_style[0]}, but the restart file has {style}")
    elif style and lacking:
        told.append(f"has coefficients of its pair_style that are not in {path.name} ({', '.join(map(str, lacking))})")
    there = [style for _, style, *_ in run.fixes.values()]
    for name, style in lammps_restart.read_stored_fixes(path).items():
        if style not in there and (style.startswith(lammps_restart.WALL) or group_of("fix", style) == UNKNOWN):
            told.append(f"has no fix {style} at that time, but {path.name} has one, {name}")
    return [f"{run.source} {text}: it belongs to another run" for text in told]


def _names(files: Files, path: Path, name: str, commands: tuple[str, ...] = FILING) -> bool:
    """Return True if a command in a log or script names a file, directly, by a pattern or as part of a series."""
    lines = [words for words in files.words[path] if words[0] in commands]
    return any(means(word, name, series=words[0] == "restart") for words in lines for word in words[1:])


def _newest_commands(files: Files, grains: Path, step: int) -> Path | None:
    """The log that names the grain file and agrees with it, or else the newest log, or else the newest script."""
    for paths in (files.logs, files.scripts):
        some = [path for path in paths if _names(files, path, grains.name)] or paths
        if len(some) > 1:
            runs = {path: read_commands(path, grains.name, _logs_before(path, files), step) for path in some}
            agree = [path for path in some if runs[path].has_step(step) and not _differs(grains, files, runs[path])]
            some = agree or some
        if some:
            return max(some, key=lambda path: path.stat().st_mtime)
    return None


def _logs_before(log: Path, files: Files) -> list[Path]:
    """Earlier logs of the same run, in their order, written before a command `log` began this one."""
    before = [path for path in files.logs if path != log and _names(files, path, log.name, ("log",))]
    if len(before) != 1:
        return []
    rest = files._replace(logs=[path for path in files.logs if path != log])
    return [*_logs_before(before[0], rest), *before]
