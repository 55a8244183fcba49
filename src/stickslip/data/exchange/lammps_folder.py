"""Folder of a run of LAMMPS as it lies: grains and memory, with the law, walls, gravity and fixes of its commands."""

import re
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...builtin_laws import BY_NAME
from ...core.control import fixed
from ...core.laws.builtin import PARAMETERS, Law
from ...core.laws.properties import resists_rolling
from ...core.readable import pluralize
from ...core.state import State, empty_contacts, flat_walls, loads
from ...core.text import parse_number
from ..sample import UNDECIDED, Absent, Assumption, Obstacle, PackingError
from . import lammps_restart
from .content import HEAD, Packing, head_text, is_compressed, read_content
from .lammps_commands import Run, group_members, read_commands, recognize_log, recognize_script
from .lammps_file import (
    Pairs,
    read_boundary,
    read_data_file,
    read_grain_dump,
    read_pairs,
    recognize_data,
    recognize_dump,
)
from .lammps_laws import (
    HISTORY,
    SAME_UNITS,
    TSUJI,
    WALL_CLASSIC,
    Contact,
    contact_of,
    differences,
    law_of_contacts,
    memory_layout,
    mix,
    of_release,
    wall_contact,
)
from .lammps_text import NO_WALLS

LOOKED_AT = 50  # dumps whose last time step is read, the newest
TAIL = 2**20  # bytes at the end of a dump in which its last time step is sought first
SILENT = (  # fixes that exert no forces on grains at rest
    "nve", "nve/sphere", "nve/limit", "enforce2d", "print", "ave/time", "ave/chunk", "ave/histo", "ave/atom", "vector",
    "ave/correlate", "balance", "property/atom", "store/state", "store/force", "halt", "momentum", "pour", "deposit",
    "dt/reset", "heat/flow", "NEIGH_HISTORY", "controller",
)  # fmt: skip
MOVERS = ("nve", "nve/sphere", "nve/limit", "nve/noforce", "move", "rigid", "rigid/small")


class Files(NamedTuple):
    """Files of a run, by what they contain."""

    restarts: list[Path]
    grains: list[Path]  # dumps
    data: list[Path]
    contacts: list[Path]  # `dump local`
    logs: list[Path]
    scripts: list[Path]


class Plane(NamedTuple):
    """A flat wall of a run."""

    height: float  # along the normal [length]
    normal: np.ndarray  # (3,) towards the grains
    number: int  # of the fix, among those of walls
    scale: float = 0.0  # mean contact radius, if LAMMPS multiplies k_t by it [length]

    def overlap(self, position: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(N,) overlaps of grains with the wall [length]."""
        return radius - (position @ self.normal - self.height)


class Course:
    """Effects of the commands of a run: the law, walls and loads, and notes on what was not taken over."""

    def __init__(self, run: Run, packing: Packing, masks: dict[str, np.ndarray]):
        self.run, self.packing, self.masks = run, packing, masks
        self.notes: list[str] = []
        self.n, self.types = len(packing.arrays["radius"]), packing.types
        self.kinds = int(self.types.max()) + 1 if self.types is not None else 1
        self.contacts: dict[tuple[int, int], Contact] = {}
        self.walls: list[Plane] = []
        self.gravity, self.force = np.zeros(3), np.zeros((self.n, 3))
        self.frozen, self.moved = np.zeros(self.n, bool), np.zeros(self.n, bool)
        self.law: Law | None = None

    def members(self, group: str) -> np.ndarray:
        """(N,) bool, members of a group; ValueError if they are not known."""
        mask = self.masks.get(group)
        mask = group_members(self.run, group, self.packing.ids, self.types, self.n) if mask is None else mask
        if mask is None:
            raise ValueError(f"the members of group {group} are not in the files (restart files have them)")
        return mask

    def wall_number(self, name: str) -> int:
        """Number of a fix among those of walls, in whose order restart files store memory."""
        return [key for key, tokens in self.run.fixes.items() if tokens[1].startswith("wall/gran")].index(name)

    def obstacle(self, text: str) -> None:
        """Note that something acts that was not taken over."""
        self.notes.append(Obstacle(f"{UNDECIDED}{text}"))


def is_run_folder(folder: Path) -> bool:
    """Return True if a folder has grains that LAMMPS wrote."""
    files = list_files(folder) if folder.is_dir() else None
    return bool(files and (files.restarts or files.grains or files.data))


def list_files(folder: Path) -> Files:
    """Files of a run, by what they contain."""
    files = Files([], [], [], [], [], [])
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not path.is_file():
            continue
        try:
            head = read_content(path, HEAD)
        except (OSError, PackingError):
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
    return files


def read_folder(folder: Path, frame: str | None = None) -> tuple[Packing, Path | None]:
    """Packing of a run, and the dump of its contacts if their memory is not in a restart file."""
    files = list_files(folder)
    if not (files.restarts or files.grains or files.data):
        raise PackingError(
            f"{folder} has no restart file, dump of atoms or data file of LAMMPS: give the folder of a run of "
            f"LAMMPS, or a packing"
        )
    path, run, packing = _newest_packing(files, frame)
    notes, contacts = [f"grains from {path.name}, time step {packing.step}", *_origin_notes(files, path)], None
    if packing.memory is None:
        contacts = _matching_contacts(files.contacts, packing)
        notes += [f"contacts in {contacts.name}"] if contacts else []
    if run is None:
        notes.append(Absent("the folder has no log.lammps and no input script: walls, gravity and fixes are not known"))
        return packing._replace(notes=[*notes, *packing.notes]), contacts
    masks = lammps_restart.group_masks(path, packing.memory) if packing.memory is not None else {}
    course = Course(run, packing, masks)
    _take_over(course)
    notes += [f"law, walls and loads from {run.source}: {_describe(course)}", *course.notes]
    known = [NO_WALLS if course.walls else "", "pair_style" if course.law else ""]
    kept = [note for note in packing.notes if not isinstance(note, Obstacle)]
    kept = [note for note in kept if not any(part and part in note for part in known)]
    memory = packing.memory and _with_wall_numbers(packing.memory, course)
    law, setting = course.law or packing.law, _setting(course)
    return packing._replace(notes=[*notes, *kept], law=law, setting=setting, memory=memory), contacts


def _with_wall_numbers(memory: lammps_restart.Restart, course: Course) -> lammps_restart.Restart:
    """Memory whose walls have the numbers that they have here; of two planes of a fix, a grain touches the nearer."""
    place, radius = (course.packing.arrays[name][memory.grain] for name in ("position", "radius"))
    wall, deepest = np.full(len(memory.wall), -1), np.full(len(memory.wall), -np.inf)
    slip, turned = memory.wall_slip.copy(), np.zeros((len(wall), lammps_restart.ROTATIONS))
    for k, plane in enumerate(course.walls):
        overlap, contact = plane.overlap(place, radius), course.contacts[0, course.kinds + k]
        touches, slips, more = lammps_restart.wall_values(memory, BY_NAME[contact.law].bonds)
        mine = (memory.wall == plane.number) & (overlap > deepest) & touches
        wall[mine], deepest[mine], slip[mine] = k, overlap[mine], slips[mine]
        turned[mine] = lammps_restart.rotations(more[mine], *memory_layout([contact]))
        if plane.scale:  # the force of LAMMPS, under a k_t that is the same for all grains
            slip[mine] *= (np.sqrt(np.maximum(overlap, 0.0) * radius) / plane.scale)[mine, None]
    known = wall >= 0
    pairs = [contact for pair, contact in course.contacts.items() if max(pair) < course.kinds]
    return memory._replace(
        wall=wall[known], grain=memory.grain[known], wall_slip=slip[known], wall_more=turned[known],
        more=lammps_restart.rotations(memory.more, *memory_layout(pairs)),
    )  # fmt: skip


def _newest_packing(files: Files, frame: str | None) -> tuple[Path, Run | None, Packing]:
    """File of the newest grains that can be read, the commands of its run, and the packing."""
    path = _newest_grains(files, frame)
    source = _newest_commands(files, path)
    run = None if source is None else read_commands(source, path.name, _logs_before(source, files.logs))
    try:
        return path, run, _read_grains(path, files, frame, run)
    except PackingError as problem:
        if path not in files.restarts or not (files.grains or files.data):
            raise
        rest = files._replace(restarts=[other for other in files.restarts if other != path])
        path, run, packing = _newest_packing(rest, frame)
        return path, run, packing._replace(notes=[Absent(str(problem)), *packing.notes])


def _newest_grains(files: Files, frame: str | None) -> Path:
    """The newest restart file, else the newest dump or data file, by time step."""
    if files.restarts and frame is None:
        return max(files.restarts, key=lambda path: (lammps_restart.time_step(path), path.stat().st_mtime))
    newest = sorted(files.grains, key=lambda path: (path.stat().st_mtime, _numbers(path)))[-LOOKED_AT:]
    frames = [(*_last_frame(path), path.stat().st_mtime, path) for path in newest]
    dumps = [tuple(key) for radii, *key in frames if radii] or [tuple(key) for _, *key in frames]
    data = [] if dumps and frame is not None else [(_data_step(path), 0.0, path) for path in files.data]
    return max([*dumps, *data])[2]


def _read_grains(path: Path, files: Files, frame: str | None, run: Run | None) -> Packing:
    """Packing of a file, with the boundaries and the atom style of the run if the file lacks them."""
    if path in files.restarts:
        return lammps_restart.read(path)[0]
    settings = {} if run is None else run.settings
    boundary = "".join(word[0] for word in settings.get("boundary", [])) or None
    if path in files.grains:
        return read_grain_dump(path, frame, boundary)[0]
    if boundary is None:
        boundary = next((read_boundary(other) for other in [*files.contacts, *files.grains]), None)
    style = " ".join(settings.get("atom_style", ()))
    return read_data_file(path, frame, boundary, style if style.startswith("hybrid") else None)[0]


def _numbers(path: Path) -> list[int]:
    """Numbers in the name of a file, such as its time step."""
    return [int(digits) for digits in re.findall(r"\d{1,18}", path.name)]


def _last_frame(path: Path) -> tuple[bool, int]:
    """Whether the last frame of a dump has radii, and its time step; −1 if it cannot be found."""
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


def _matching_contacts(paths: list[Path], packing: Packing) -> Path | None:
    """The first dump of contacts that belongs to the packing."""
    mark = re.compile(rb"ITEM: TIMESTEP\s+%d\s" % packing.step)
    for path in paths:
        if packing.step >= 0 and not mark.search(read_content(path)):
            continue
        try:
            pairs: Pairs = read_pairs(path, packing)
        except PackingError:
            continue
        if len(pairs.i):
            return path
    return None


def _origin_notes(files: Files, grains: Path) -> list[str]:
    """Notes on grains that a run began from, and on several runs in a folder."""
    sources, notes = files.logs or files.scripts, []
    if grains in files.data and any(_names(path, grains.name, ("read_data",)) for path in sources):
        notes.append(Absent(f"{grains.name} is where the run began: it left no later state"))
    naming = [path for path in sources if _names(path, grains.name)]
    if len(sources) > 1 and not naming:
        several = ", ".join(path.name for path in sources[:3])
        doubt = f"none of {several} names {grains.name}, which may be of another run: give each run a folder of its own"
        notes.append(Obstacle(f"{UNDECIDED}{doubt}"))
    runs = [read_commands(path, grains.name, _logs_before(path, files.logs)) for path in naming]
    laws = [(run.pair_style, run.pair_coeff, run.fixes) for run in runs]
    if any(law != laws[0] for law in laws):
        several = " and ".join(path.name for path in naming[:3])
        notes.append(
            Obstacle(f"{UNDECIDED}{several} name {grains.name} with different laws or fixes: keep one of them")
        )
    return notes


FILING = ("restart", "write_restart", "write_data", "dump", "write_dump", "read_data")  # commands that name files


def _names(path: Path, name: str, commands: tuple[str, ...] = FILING) -> bool:
    """Return True if a command in a log or script names a file, also by a pattern or as the beginning of a series."""
    lines = [line.split() for line in head_text(read_content(path)).split("\n")]
    names = [Path(word).name for line in lines if line[:1] and line[0] in commands for word in line[1:] if word != "*"]
    return any(fnmatchcase(name, word) or name.startswith(f"{word}.") for word in names)


def _newest_commands(files: Files, grains: Path) -> Path | None:
    """The log that names the file of the grains, or else the newest log, or else such a script."""
    for paths in (files.logs, files.scripts):
        naming = [path for path in paths if _names(path, grains.name)]
        if naming or paths:
            return max(naming or paths, key=lambda path: path.stat().st_mtime)
    return None


def _logs_before(log: Path, logs: list[Path]) -> list[Path]:
    """Logs that LAMMPS wrote in the same run before a command `log` began this one, the first one first."""
    before = [path for path in logs if path != log and _names(path, log.name, ("log",))]
    if len(before) != 1:
        return []
    return [*_logs_before(before[0], [path for path in logs if path != log]), *before]


def _take_over(course: Course) -> None:
    """Take over the commands of a run, in the order in which they matter."""
    run = course.run
    for command in run.unknown:
        what = "the variables in " if command.startswith(("fix", "pair")) else "what follows from "
        course.obstacle(f"{what}`{command}` is not known without running LAMMPS; its log.lammps has it")
    for part in run.settings.get("exclude", []):
        course.obstacle(f"neigh_modify exclude {part} was not taken over: contacts that it leaves out are there here")
    units = run.settings.get("units", ["lj"])[0]
    if units not in SAME_UNITS:
        course.obstacle(f"units {units}, in which LAMMPS converts forces, were not taken over")
    _take_pairs(course)
    for name, (group, style, *arguments) in run.fixes.items():
        take = TAKEN.get(style)
        try:
            if take is not None:
                take(course, name, group, arguments)
            elif style not in SILENT:
                raise ValueError("it acts on the grains")
            if style in MOVERS:
                course.moved |= course.members(group)
            if course.packing.arrays.get("dim") == 2 and style == "nve/sphere":
                course.packing.arrays["i0"] = 0.5 if "disc" in arguments else 0.4
        except RecursionError:
            course.obstacle(f"fix {name} ({style}) was not taken over: group {group} is defined by itself")
        except (ValueError, IndexError, KeyError, TypeError) as problem:
            course.obstacle(f"fix {name} ({style}) was not taken over: {problem}")
    if course.moved.any() and not course.moved.all():
        course.frozen |= ~course.moved
        course.notes.append(f"{pluralize(int((~course.moved).sum()), 'grain')} that no fix moves are held")
    _finish_law(course)


def _check_stored(course: Course, style: str) -> None:
    """Note that a restart file has another style than the commands, which are then not those of its run."""
    stored = course.packing.law if isinstance(course.packing.law, dict) else {}
    same = HISTORY.get(style.removeprefix("gran/"), ("",))[0] == stored.get("law")
    if stored and style != "none" and not same:
        course.obstacle(
            f"{course.run.source} has pair_style {style}, and the restart file another: it is of another run"
        )


def _take_pairs(course: Course) -> None:
    """Laws of pairs of types."""
    style, *arguments = course.run.pair_style or ["none"]
    _check_stored(course, style)
    stored, everywhere = course.packing.law, [(a, b) for a in range(course.kinds) for b in range(a, course.kinds)]
    try:
        if style == "none" and isinstance(stored, dict):  # restored from a restart file
            values = {name: stored[name] for name in PARAMETERS}
            course.contacts |= dict.fromkeys(everywhere, Contact(stored["law"], stored["damping"], values))
        elif style.removeprefix("gran/") in HISTORY:
            contact, _ = contact_of(style.removeprefix("gran/"), arguments)
            course.contacts |= dict.fromkeys(everywhere, contact)
        elif style == "granular":
            _take_coefficients(course)
        else:
            raise ValueError("no law here is equal to it")
    except (ValueError, IndexError, KeyError, TypeError) as problem:
        course.obstacle(f"pair_style {style} was not taken over: {problem}")


def _take_coefficients(course: Course) -> None:
    for first, second, *arguments in course.run.pair_coeff:
        contact, _ = contact_of("granular", arguments)
        ends = [(a, b) for a in _types(first, course.kinds) for b in _types(second, course.kinds)]
        course.contacts |= {(min(pair), max(pair)): contact for pair in ends}
    for a in range(course.kinds):
        for b in range(a + 1, course.kinds):
            if (a, b) not in course.contacts and {(a, a), (b, b)} <= set(course.contacts):
                course.contacts[a, b] = mix(course.contacts[a, a], course.contacts[b, b])


def _types(word: str, kinds: int) -> range:
    """Types, from 0, that a word such as 1, *, 2* or 1*3 means."""
    low, star, high = word.partition("*")
    first = int(low or 1)
    return range(first - 1, (int(high or kinds) if star else first))


def _take_wall(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Flat walls of `fix wall/gran`, each with its own row in the law's table."""
    number = course.wall_number(name)
    contact, (kind, *rest) = wall_contact(arguments[0], arguments[1:])
    rest = rest[:-1] if rest[-1:] == ["contacts"] else rest  # adds output only
    if kind not in ("xplane", "yplane", "zplane") or len(rest) != 2 or not course.members(group).all():
        raise ValueError(
            f"only fixed planes that touch all grains are read, not `{' '.join([kind, *rest])}` of group {group}"
        )
    axis = "xyz".index(kind[0])
    for word, side in zip(rest, (1.0, -1.0), strict=True):
        if word != "NULL":
            _add_wall(course, name, Plane(side * _finite(word), side * np.eye(3)[axis], number))
            own = _classic(course, contact) if arguments[0] == "hooke/history" else contact
            course.contacts |= {(a, course.kinds + len(course.walls) - 1): own for a in range(course.kinds)}


def _add_wall(course: Course, name: str, wall: Plane) -> None:
    """Add a wall; grains behind it are between the walls of no packing here."""
    course.walls.append(wall)
    behind = int((course.packing.arrays["position"] @ wall.normal < wall.height).sum())
    if behind:
        course.obstacle(
            f"{pluralize(behind, 'grain')} behind the wall of fix {name}: LAMMPS pushes them out on the other side or "
            f"not at all, and here a wall is solid behind its surface"
        )


def _finite(word: str) -> float:
    """Number of a word; ValueError if it is NaN or infinite."""
    if not np.isfinite(value := parse_number(word)):
        raise ValueError(f"{word} is no finite number")
    return value


def _classic(course: Course, contact: Contact) -> Contact:
    """Law of the newest wall, whose k_t LAMMPS multiplies by the contact radius √(δ R): that of the mean radius."""
    radius = course.packing.arrays["radius"]
    overlap = course.walls[-1].overlap(course.packing.arrays["position"], radius)
    touches = overlap > 0
    if course.run.year > 2025 or not touches.any():
        return contact
    scale = float(np.sqrt(overlap[touches] * radius[touches]).mean())
    course.walls[-1] = course.walls[-1]._replace(scale=scale)
    values = contact.values | {"kt": contact.values["kt"] * scale}
    return contact._replace(values=values, lacks=(*contact.lacks, WALL_CLASSIC))


def _take_plane(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Plane of `fix wall/gran/region`."""
    number = course.wall_number(name)
    contact, rest = wall_contact(arguments[0], arguments[1:])
    style, *numbers = course.run.regions[rest[rest.index("region") + 1]]
    rest = rest[:-1] if rest[-1:] == ["contacts"] else rest
    side = -1.0 if numbers[6:] == ["side", "out"] else 1.0
    if style != "plane" or numbers[6:] not in ([], ["side", "in"], ["side", "out"]) or len(rest) != 2:
        raise ValueError(f"only regions that are fixed planes are read, not `{' '.join([style, *numbers, *rest[2:]])}`")
    point, normal = np.array([_finite(w) for w in numbers[:6]]).reshape(2, 3)
    normal = side * normal / np.linalg.norm(normal)
    _add_wall(course, name, Plane(float(point @ normal), normal, number))
    course.contacts |= {(a, course.kinds + len(course.walls) - 1): contact for a in range(course.kinds)}


def _take_gravity(course: Course, name: str, group: str, arguments: list[str]) -> None:
    size, kind, *numbers = arguments
    values = [_finite(word) for word in numbers[: {"vector": 3, "spherical": 2, "chute": 1}[kind]]]
    members, mass = course.members(group), course.packing.arrays.get("mass")
    if not members.all() and mass is None:
        raise ValueError(f"it acts on group {group} only, and masses are not known")
    if kind == "vector":
        direction = np.array(values) / np.linalg.norm(values)
    else:
        phi, theta = np.deg2rad(values if kind == "spherical" else [0.0, 180.0 - values[0]])
        direction = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        if course.packing.arrays.get("dim") == 2:  # in the plane, whatever phi
            direction = np.array([np.sin(theta), np.cos(theta), 0.0])
    if members.all():
        course.gravity += _finite(size) * direction
    else:
        course.force[members] += _finite(size) * mass[members, None] * direction


def _take_freeze(course: Course, name: str, group: str, arguments: list[str]) -> None:
    course.frozen |= course.members(group)


def _take_setforce(course: Course, name: str, group: str, arguments: list[str]) -> None:
    members, forces = course.members(group), arguments[:3]
    velocity = course.packing.arrays.get("velocity")
    if any(parse_number(word) for word in forces if word != "NULL") or "NULL" in forces:
        raise ValueError("only setforce 0 0 0 is read")
    if velocity is not None and velocity[members].any():
        raise ValueError("the grains that it drives move")
    course.frozen |= members


def _take_addforce(course: Course, name: str, group: str, arguments: list[str]) -> None:
    if len(arguments) > 3:
        raise ValueError(f"its options `{' '.join(arguments[3:])}` are not read")
    if (course.frozen & course.members(group)).any():
        raise ValueError("it comes after the fix that holds some of its grains, which therefore move")
    course.force[course.members(group)] += [_finite(word) for word in arguments[:3]]


def _take_deform(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Note how the cell was being strained: it is fixed here."""
    end = next((k for k, word in enumerate(arguments) if word in ("remap", "flip", "units", "vmax")), len(arguments))
    places = [k for k, word in enumerate(arguments[:end]) if word in ("x", "y", "z", "xy", "xz", "yz")]
    if not places:
        raise ValueError(f"`{' '.join(arguments)}` is not read")
    how = ", ".join(" ".join(arguments[a:b]) for a, b in zip(places, [*places[1:], end], strict=True))
    strained = f"fix {name} (deform) was straining the cell ({how})"
    course.notes.append(Assumption(f"{strained}: judged at the instant, with the cell fixed"))


TAKEN = {
    "wall/gran": _take_wall, "wall/gran/region": _take_plane, "gravity": _take_gravity, "freeze": _take_freeze,
    "setforce": _take_setforce, "addforce": _take_addforce, "deform": _take_deform,
}  # fmt: skip


def _finish_law(course: Course) -> None:
    """The law of all pairs of types and walls."""
    if not any(max(pair) < course.kinds for pair in course.contacts):
        return
    given = course.contacts
    course.contacts = {pair: of_release(contact, course.run.year) for pair, contact in given.items()}
    course.law, lacks = law_of_contacts(course.contacts, course.kinds, len(course.walls))
    for lack in lacks:
        course.obstacle(f"{lack}: the law here differs")
    course.notes += map(Assumption, differences(course.contacts))
    if course.contacts != given:
        course.notes.append(Assumption(TSUJI))
    if resists_rolling(course.law) and course.packing.memory is None:
        course.notes.append(Absent("the memory of rolling and twisting is in restart files only: it is zero here"))


def _describe(course: Course) -> str:
    loaded = [name for name, there in (("gravity", course.gravity.any()), ("forces", course.force.any())) if there]
    parts = [" ".join(course.run.pair_style[:1]) or "no pair_style"]
    parts += [pluralize(len(course.walls), "wall")] if course.walls else []
    parts += loaded + ([pluralize(int(course.frozen.sum()), "held grain")] if course.frozen.any() else [])
    return ", ".join(parts)


def _setting(course: Course):
    """Function that puts a state between the walls and under the loads of its run."""

    def put(state: State) -> State:
        if not (course.walls or course.frozen.any() or course.gravity.any() or course.force.any()):
            return state
        count = len(course.walls)
        walls = flat_walls(
            [plane.height * plane.normal for plane in course.walls], [plane.normal for plane in course.walls],
            material=[course.kinds + k if course.law else 0 for k in range(count)],
        )  # fmt: skip
        control = loads(course.n, count, gravity=course.gravity)
        control.force[: course.n] = course.force
        if course.frozen.any():
            control = fixed(control, np.flatnonzero(course.frozen))
        bare = empty_contacts(course.n + count, 0, state.contacts.skin)
        return state._replace(walls=walls, control=control, contacts=bare)

    return put
