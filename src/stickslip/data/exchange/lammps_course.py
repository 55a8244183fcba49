"""Effects of the commands of a LAMMPS run: laws of pairs of types, walls, loads, held grains, and omissions."""

from collections.abc import Sequence
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from ...builtin_laws import BY_NAME
from ...core.contacts.bonding import bonded_at_rest
from ...core.laws.builtin import PARAMETERS, Law, linear
from ...core.laws.properties import resists_rolling
from ...core.measure import touching
from ...core.progress import Size, require_sizes
from ...core.readable import pluralize
from ...core.state import State, empty_contacts, flat_walls, loads
from ...core.text import parse_number
from ...known import BETWEEN, BONDED, HARMLESS, UNKNOWN, USED, find_row, plain_style
from ..sample import LAW, Absent, Assumption, Obstacle, PackingError, from_arrays, refusing
from . import lammps_restart
from .columns import Packing
from .lammps_bonds import laws_of_bonds, note_on_contacts, notes_on_rest, replay
from .lammps_commands import Run, group_members, numbers_in, types_in
from .lammps_laws import (
    HISTORY,
    LIMITED,
    SAME_UNITS,
    TSUJI,
    WALL_CLASSIC,
    Contact,
    contact_of,
    differences,
    law_of_contacts,
    memory_layout,
    mix,
    no_equal,
    of_release,
    wall_contact,
)


class Plane(NamedTuple):
    """A flat wall of a run."""

    height: float  # along the normal [length]
    normal: np.ndarray  # (3,) towards the grains
    number: int  # index of the fix among the wall fixes
    scale: float = 0.0  # mean contact radius if LAMMPS multiplies k_t by it [length]
    face: int = 0  # face of its region, from 0

    def overlap(self, position: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(N,) overlaps of grains with the wall [length]."""
        return radius - (position @ self.normal - self.height)


class Course:
    """Effects of the commands of a run: the law, walls and loads, and notes on omissions."""

    def __init__(self, run: Run, packing: Packing, masks: dict[str, np.ndarray]):
        self.packing, self.masks = packing, masks
        self.run = run._replace(labels=(packing.labels or {}) | run.labels)
        self.notes: list[str] = []
        self.n, self.types = len(packing.arrays["radius"]), packing.types
        self.kinds = int(self.types.max()) + 1 if self.types is not None else 1
        require_sizes([Size("the grains are of", self.kinds, "types", "leave out the column type")], PackingError)
        self.contacts: dict[tuple[int, int], Contact] = {}
        self.walls: list[Plane] = []
        self.gravity, self.force = np.zeros(3), np.zeros((self.n, 3))
        self.free = np.ones((self.n, 6), bool)  # as in `Control`
        self.frozen, self.moved, self.turned = (np.zeros(self.n, bool) for _ in range(3))
        self.law: Law | None = None
        self.stored: list[float] = []  # coefficients in a restart file of the same run
        self.bonds: list[tuple] = []  # arguments of `bonded_at_rest`, except the state, for each type of bond
        self.met: dict[str, list[str]] = {USED: [], HARMLESS: [], UNKNOWN: []}

    def members(self, group: str) -> np.ndarray:
        """(N,) mask of the grains in a group; raise ValueError if they are unknown."""
        if any(words[0] == "dynamic" for words in self.run.groups.get(group, ())[-1:]):
            raise ValueError(f"the members of group {group} change with time (`group {group} dynamic`)")
        mask = self.masks.get(group)
        mask = group_members(self.run, group, self.packing.ids, self.types, self.n) if mask is None else mask
        if mask is None:
            raise ValueError(
                f"the members of group {group} are uncertain: they are known only from restart files, or from "
                "commands that select types or ids which do not change later"
            )
        return mask

    def wall_number(self, name: str) -> int:
        """Index of a fix among the wall fixes; restart files store the memory of walls in this order."""
        return [key for key, tokens in self.run.fixes.items() if tokens[1].startswith("wall/gran")].index(name)

    def obstacle(self, text: str, about: str = "") -> None:
        """Add a note on something that acts, or may act, and was not imported."""
        self.notes.append(Obstacle(text, about))
        self.met[UNKNOWN].append(text)

    def contacts_of_grains(self) -> np.ndarray:
        """(2, C) grains that touch."""
        arrays = {name: self.packing.arrays.get(name) for name in ("position", "radius", "cell", "periodic")}
        state = from_arrays(**arrays, law=linear(), dim=self.packing.arrays.get("dim", 3))
        rows = touching(state)
        return np.stack([state.contacts.i[rows], state.contacts.j[rows]])

    def hold(self, group: str, axes: Sequence[int]) -> None:
        """Hold components of the motion of a group; raise ValueError if its grains are moving."""
        members = self.members(group)
        for name, first, how in (
            ("velocity", 0, f"velocities and would move on: `velocity {group} set 0 0 0` stops them"),
            ("spin", 3, f"spins and would go on turning: `set group {group} omega 0 0 0` stops them"),
        ):
            motion = self.packing.arrays.get(name, np.zeros((self.n, 3)))
            if motion[np.ix_(members & self.moved, [k - first for k in axes if first <= k < first + 3])].any():
                raise ValueError(f"its grains have {how}")
        self.free[np.ix_(members, axes)] = False

    def push(self, members: np.ndarray) -> None:
        """Check that a fix does not act on grains held by a previous fix; raise ValueError otherwise."""
        if (members & self.moved & ~self.free[:, :3].all(axis=1)).any():
            raise ValueError("it follows the fix that holds some of its grains, so these move")


def _take_wall(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Import flat walls of `fix wall/gran`, each with a separate row in the table of the law."""
    number = course.wall_number(name)
    contact, (kind, *rest) = _wall_law(course, arguments)
    rest = rest[:-1] if rest[-1:] == ["contacts"] else rest  # adds output only
    if kind not in ("xplane", "yplane", "zplane") or len(rest) != 2 or not course.members(group).all():
        raise ValueError(
            f"only fixed planes for all grains are supported, not `{' '.join([kind, *rest])}` for group {group}"
        )
    axis = "xyz".index(kind[0])
    for word, side in zip(rest, (1.0, -1.0), strict=True):
        if word != "NULL":
            wall = Plane(side * _finite(word), side * np.eye(3)[axis], number)
            _add_wall(course, name, wall, contact, arguments[0])


def _wall_law(course: Course, arguments: list[str]) -> tuple[Contact, list[str]]:
    """Law of a wall, and the words that follow it; old releases used the pair style if no style was named."""
    if not numbers_in(arguments[:1]):
        return wall_contact(plain_style(arguments[0]), arguments[1:])
    style = next(iter(course.run.pair_style), "none").removeprefix("gran/")
    if style not in HISTORY:
        raise ValueError(
            f"it names no style, as in old releases, which used that of pair_style {style}: {no_equal(style)}"
        )
    return wall_contact(style, arguments)


def _add_wall(course: Course, name: str, wall: Plane, contact: Contact, style: str) -> None:
    """Add a wall and its law for all types, and note grains behind it, which would be inside the wall here."""
    position, radius, year = course.packing.arrays["position"], course.packing.arrays["radius"], course.run.year
    overlap = wall.overlap(position, radius)
    touches, classic = overlap > 0, year == 0 or 2022 <= year <= 2025
    course.push(touches)
    behind = int((position @ wall.normal < wall.height).sum())
    if behind:
        course.obstacle(
            f"{pluralize(behind, 'grain')} behind the wall of fix {name}: LAMMPS pushes them to the other side or not "
            "at all, but here walls are solid behind their surface"
        )
    if plain_style(style) == "hooke/history" and classic and touches.any():
        # LAMMPS multiplies its k_t by the contact radius √(δ R); here, the mean radius is used
        wall = wall._replace(scale=float(np.sqrt(overlap[touches] * radius[touches]).mean()))
        values = contact.values | {"kt": contact.values["kt"] * wall.scale}
        contact = contact._replace(values=values, lacks=(*contact.lacks, WALL_CLASSIC))
    course.walls.append(wall)
    course.contacts |= {(a, course.kinds + len(course.walls) - 1): contact for a in range(course.kinds)}


def _finite(word: str) -> float:
    """Number of a word; raise ValueError if it is NaN or infinite."""
    if word.startswith("v_"):
        raise ValueError(f"{word} is a variable whose value is unknown outside LAMMPS")
    if not np.isfinite(value := parse_number(word)):
        raise ValueError(f"{word} is not a finite number")
    return value


OPTIONS = {"side": 1, "units": 1, "open": 1, "move": 3, "rotate": 7}  # number of arguments of each option of regions
FLAT = ("plane", "block")  # regions with flat faces


def _take_region(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Import the plane, or the faces of the block, of `fix wall/gran/region`."""
    number = course.wall_number(name)
    contact, rest = _wall_law(course, arguments)
    region = course.run.regions[rest[rest.index("region") + 1]]
    style, *words = region.words
    rest = rest[:-1] if rest[-1:] == ["contacts"] else rest
    given, k = {}, 6
    while style in FLAT and k < len(words):
        given.setdefault(words[k], []).extend(words[k + 1 : k + 1 + OPTIONS[words[k]]])
        k += 1 + OPTIONS[words[k]]
    if style not in FLAT or {"move", "rotate"} & set(given) or len(rest) != 2 or not course.members(group).all():
        told = f"`{' '.join([style, *words, *rest[2:]])}` of group {group}"
        raise ValueError(f"only fixed planes or blocks for all grains are supported, not {told}")
    lattice = given.get("units") != ["box"]
    if lattice and region.spacing == []:
        raise ValueError("its region is in lattice units, and only log.lammps contains the lattice spacing")
    scale = np.array([_finite(word) for word in (region.spacing if lattice else None) or ("1", "1", "1")])
    outside = given.get("side") == ["out"]
    if style == "plane":
        point, normal = np.array([_finite(w) for w in words[:6]]).reshape(2, 3) * scale
        normal = (-1.0 if outside else 1.0) * normal / np.linalg.norm(normal)
        walls = [Plane(float(point @ normal), normal, number)]
    else:
        ends = zip(words[:6], (-np.inf, np.inf) * 3, strict=True)
        numbers = [end if word == "INF" else _finite(word) for word, end in ends]
        bounds = np.array(numbers).reshape(3, 2) * scale[:, None]
        if outside and "open" in given:
            raise ValueError("a block with open faces and grains outside is not supported")
        walls = (
            [_touched_face(course, bounds, number)] if outside else _inner_faces(bounds, given.get("open", ()), number)
        )
    for wall in walls:
        _add_wall(course, name, wall, contact, arguments[0])


def _inner_faces(bounds: np.ndarray, left_open: Sequence[str], number: int) -> list[Plane]:
    """Faces of a block with grains inside, without open faces; LAMMPS numbers faces from 1 in this order."""
    faces = []
    for face, bound in enumerate(bounds.ravel()):
        side = 1.0 - 2.0 * (face % 2)
        if np.isfinite(bound) and str(face + 1) not in left_open:
            faces.append(Plane(side * bound, side * np.eye(3)[face // 2], number, face=face))
    return faces


def _touched_face(course: Course, bounds: np.ndarray, number: int) -> Plane:
    """Face of a block that is a wall for grains outside; raise ValueError if they touch several faces, or an edge."""
    position, radius = course.packing.arrays["position"], course.packing.arrays["radius"]
    for wall in _inner_faces(bounds, (), number):
        axis, wall = wall.face // 2, Plane(-wall.height, -wall.normal, number)
        above = np.delete((position >= bounds[:, 0]) & (position <= bounds[:, 1]), axis, axis=1).all(axis=1)
        if (position @ wall.normal >= wall.height).all() and above[wall.overlap(position, radius) > 0].all():
            return wall
    raise ValueError("grains touch several faces of its block from outside, or its edges, but walls here have no edges")


def _take_gravity(course: Course, name: str, group: str, arguments: list[str]) -> None:
    size, kind, *numbers = arguments
    values = [_finite(word) for word in numbers[: {"vector": 3, "spherical": 2, "chute": 1}[kind]]]
    members, mass = course.members(group), course.packing.arrays.get("mass")
    if not members.all() and mass is None:
        raise ValueError(f"it acts on group {group} only, and masses are unknown")
    if kind == "vector":
        direction = np.array(values) / np.linalg.norm(values)
    else:
        phi, theta = np.deg2rad(values if kind == "spherical" else [0.0, 180.0 - values[0]])
        direction = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        if course.packing.arrays.get("dim") == 2:  # gravity is in the plane for any phi
            direction = np.array([np.sin(theta), np.cos(theta), 0.0])
    course.push(members)
    if members.all():
        course.gravity += _finite(size) * direction
    else:
        course.force[members] += _finite(size) * mass[members, None] * direction


def _take_freeze(course: Course, name: str, group: str, arguments: list[str]) -> None:
    course.hold(group, range(6))
    course.frozen |= course.members(group)


def _take_setforce(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Hold components whose forces are set to zero; rotations remain free."""
    forces = arguments[:3]
    if len(arguments) != 3 or any(parse_number(word) for word in forces if word != "NULL"):
        raise ValueError("only zero or NULL forces in the whole box are supported")
    course.hold(group, [k for k, word in enumerate(forces) if word != "NULL"])


def _take_addforce(course: Course, name: str, group: str, arguments: list[str]) -> None:
    if len(arguments) > 3:
        raise ValueError(f"its options `{' '.join(arguments[3:])}` are not supported")
    course.push(course.members(group))
    course.force[course.members(group)] += [_finite(word) for word in arguments[:3]]


def _take_deform(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Add a note on the deformation of the cell, which is fixed here."""
    end = next((k for k, word in enumerate(arguments) if word in ("remap", "flip", "units", "vmax")), len(arguments))
    places = [k for k, word in enumerate(arguments[:end]) if word in ("x", "y", "z", "xy", "xz", "yz")]
    if not places:
        raise ValueError(f"`{' '.join(arguments)}` is not supported")
    how = ", ".join(" ".join(arguments[a:b]) for a, b in zip(places, [*places[1:], end], strict=True))
    strained = f"fix {name} (deform) was straining the cell ({how})"
    course.notes.append(Assumption(f"{strained}: the verdict is for the instant, with the cell fixed"))


CENTRED = ("momentum", "recenter")  # fixes that follow all others, whose loads they may counteract


def _take_momentum(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Check that a fix that removes momentum or recentres grains has no effect.

    Contacts between grains conserve momentum but, in a periodic box, not angular momentum.
    """
    style, whole = course.run.fixes[name][1], course.members(group).all()
    loaded = course.walls or course.gravity.any() or course.force.any() or not course.free[:, :3].all()
    box = course.packing.arrays.get("periodic", np.zeros(3, bool))
    turns = "angular" in arguments and np.any(box)
    if style == "recenter" and arguments[3:4] == ["shift"]:
        whole = whole and course.members(arguments[4]).all()
    if whole and not loaded and not turns:
        return
    why = (
        "walls, loads and held grains change the momentum of the others" if loaded
        else f"contacts change the momentum of group {group}" if not whole
        else "contacts across a periodic box change the angular momentum"
    )  # fmt: skip
    raise ValueError(f"{'it removes momentum' if style == 'momentum' else 'it moves grains back'}, and {why}")


TAKEN = {
    "wall/gran": _take_wall, "wall/gran/region": _take_region, "gravity": _take_gravity, "freeze": _take_freeze,
    "setforce": _take_setforce, "addforce": _take_addforce, "deform": _take_deform,
    **dict.fromkeys(CENTRED, _take_momentum),
}  # fmt: skip


BESIDE, LINEAR = "style beside the pair style", "pair style whose force is proportional to its first coefficient"
HEAVY = "held grains count as infinitely heavy in dashpots, as under fix freeze, although LAMMPS uses their masses"
MOVERS = {  # fixes that move grains, and whether they also rotate them
    "nve": False, "nve/limit": False, "nve/noforce": False, "nve/sphere": True, "nve/bpm/sphere": True, "move": True,
    "rigid": True, "rigid/small": True, "npt/sphere": True, "nvt/sphere": True, "nph/sphere": True, "npt": False,
    "nvt": False, "nph": False,
}  # fmt: skip


def with_wall_numbers(memory: lammps_restart.Restart, course: Course) -> lammps_restart.Restart:
    """Memory with the wall numbers used here; if a fix has two planes, a grain touches the nearer one."""
    position, radius = (course.packing.arrays[name][memory.grain] for name in ("position", "radius"))
    wall, deepest = np.full(len(memory.wall), -1), np.full(len(memory.wall), -np.inf)
    slip, turned = memory.wall_slip.copy(), np.zeros((len(wall), lammps_restart.ROTATIONS))
    for k, plane in enumerate(course.walls):
        overlap, contact = plane.overlap(position, radius), course.contacts[0, course.kinds + k]
        touches, slips, more = lammps_restart.wall_values(memory, BY_NAME[contact.law].bonds)
        mine = (memory.wall == plane.number) & ((memory.face == plane.face) | (memory.face < 0))
        mine &= (overlap > deepest) & touches
        wall[mine], deepest[mine], slip[mine] = k, overlap[mine], slips[mine]
        turned[mine] = lammps_restart.rotations(more[mine], *memory_layout([contact]))
        if plane.scale:  # so that the k_t common to all grains gives the force of LAMMPS
            slip[mine] *= (np.sqrt(np.maximum(overlap, 0.0) * radius) / plane.scale)[mine, None]
    at_wall = wall >= 0
    pairs = [contact for pair, contact in course.contacts.items() if max(pair) < course.kinds]
    return memory._replace(
        wall=wall[at_wall], grain=memory.grain[at_wall], wall_slip=slip[at_wall], wall_more=turned[at_wall],
        more=lammps_restart.rotations(memory.more, *memory_layout(pairs)),
    )  # fmt: skip


def take_over(course: Course) -> None:
    """Import the commands of a run, each after those on which it depends."""
    run = course.run
    _take_bonds(course)
    for command in run.unknown:
        what = "the variables in " if command.startswith(("fix", "pair")) else "what follows from "
        course.obstacle(f"{what}`{command}` is unknown without running LAMMPS; its log.lammps contains it")
    for sentence in run.acts.values():
        course.obstacle(sentence)
    for part in run.settings.get("exclude", []):
        course.obstacle(f"neigh_modify exclude {part} was not imported: contacts that it excludes exist here")
    units = run.settings.get("units", ["lj"])[0]
    if units not in SAME_UNITS:
        course.obstacle(f"units {units}, in which LAMMPS converts forces, were not imported")
    restored = "read_restart" in run.met[USED]  # the restart file contains the dimension
    if course.packing.arrays.get("dim") == 2 and run.settings.get("dimension") != ["2"] and not restored:
        course.obstacle(
            "grains at z = 0 are read in two dimensions, although the run has three: motion along z is left out"
        )
    _take_pairs(course)
    for name, (group, style, *_) in run.fixes.items():
        if style in MOVERS:
            _try(course, name, _take_mover, group, style)
    for name, (group, style, *arguments) in sorted(run.fixes.items(), key=lambda fix: fix[1][1] in CENTRED):
        _try(course, name, _take_fix, name, style, group, arguments)
    _hold_the_rest(course)
    _finish_law(course)


def _try(course: Course, name: str, take, *given) -> None:
    """Import a fix, or note why this is impossible."""
    group, style, *_ = course.run.fixes[name]
    try:
        take(course, *given)
        return
    except RecursionError:
        why = f"group {group} is composed of too many others"
    except (ValueError, IndexError, KeyError, TypeError) as problem:
        why = str(problem).replace("could not convert string to float:", "a number is expected in place of")
    text = f"fix {name} ({style}) was not imported: {why} ({course.run.places[name]})"
    if text not in course.met[UNKNOWN]:
        course.obstacle(text)


def _take_mover(course: Course, group: str, style: str) -> None:
    members = course.members(group)
    twice = int((course.moved & members).sum())
    course.moved |= members
    course.turned |= members & MOVERS[style]
    if twice:
        raise ValueError(f"it moves {pluralize(twice, 'grain')} that another fix also moves, so they move twice a step")


def _take_fix(course: Course, name: str, style: str, group: str, arguments: list[str]) -> None:
    row = find_row("fix", style)
    if style in TAKEN:
        TAKEN[style](course, name, group, arguments)
    elif row.group not in (USED, HARMLESS):
        raise ValueError(row.why or "whether it acts on the grains is unknown")
    if course.packing.arrays.get("dim") == 2 and style in ("nve/sphere", "nve/bpm/sphere"):
        course.packing.arrays["i0"] = 0.5 if "disc" in arguments else 0.4
    course.met[row.group].append(f"fix {name} ({style})")


def _hold_the_rest(course: Course) -> None:
    """Hold grains that no fix moves, and the rotations of grains that no fix rotates."""
    rest, still = ~course.moved, course.moved & ~course.turned
    if not course.moved.any():
        return
    if rest.any():
        course.free[rest] = False
        course.notes.append(f"{pluralize(int(rest.sum()), 'grain')} that no fix moves are held")
        speed = np.linalg.norm(course.packing.arrays.get("velocity", np.zeros((course.n, 3))), axis=1)
        if speed[rest].max() > speed[course.moved].max():
            course.obstacle(
                "grains that no fix moves have velocities, on which dashpots of their contacts act: `velocity GROUP "
                "set 0 0 0` stops them"
            )
    if still.any():
        spin = course.packing.arrays.get("spin")
        course.free[still, 3:] = False
        course.notes.append(f"fix nve does not rotate {pluralize(int(still.sum()), 'grain')}: their rotations are held")
        if spin is not None and spin[still].any():
            course.obstacle("grains that no fix rotates turn at constant rates")


def _take_bonds(course: Course) -> None:
    """Import bonds with the laws of `bond_style` and `bond_coeff`."""
    told, listed = replay(course.run.bonds), course.packing.bonds
    style = f"bond_style {' '.join(told.style[:2])}"
    if listed is None:
        remedy = "no file lists the bonds at that time; write one with `write_data` or `write_restart`"
        for command in told.made:
            course.obstacle(f"{command} was not imported: {BONDED}; {remedy}")
        if told.style and find_row("bond style", told.style[0]).group != HARMLESS:
            course.obstacle(f"{style} ({told.place}) was not imported: {BETWEEN}; {remedy}")
        return
    course.run.acts.pop("(bonds) bonds", None)
    if not len(listed.i):
        return
    off = int((listed.kind <= 0).sum())
    if off:
        text = (
            f"{pluralize(off, 'bond')} of {listed.source} with types that are not positive (broken or turned off) "
            "left out"
        )
        course.notes.append(Assumption(text))
    for command in told.deleted:
        if " remove" not in command:
            course.obstacle(f"{command}: {listed.source} does not state which bonds it turned off")
    acting: list[str] = []
    try:
        course.bonds, acting = laws_of_bonds(told, listed)
        course.met[USED].append(style)
    except (ValueError, IndexError, TypeError) as problem:
        source = told.place or course.run.source
        course.obstacle(f"bonds of {listed.source} were not imported: {problem} ({source})")
    course.notes += notes_on_rest(told, listed, acting)
    left = note_on_contacts(told, listed, course.n, *course.contacts_of_grains())
    course.notes += [] if left is None or isinstance(left, Obstacle) else [left]
    if isinstance(left, Obstacle):
        course.obstacle(left.reason)


def _take_pairs(course: Course) -> None:
    """Import the contact laws of pairs of types."""
    style, *arguments = course.run.pair_style or ["none"]
    stored, everywhere = course.packing.law, [(a, b) for a in range(course.kinds) for b in range(a, course.kinds)]
    try:
        if not course.run.pair_style and isinstance(stored, dict):  # restored from a restart file
            values = {name: stored[name] for name in PARAMETERS}
            course.contacts |= dict.fromkeys(everywhere, Contact(stored["law"], stored["damping"], values))
        elif style.removeprefix("gran/") in HISTORY:
            contact, _ = contact_of(style.removeprefix("gran/"), arguments)
            course.contacts |= dict.fromkeys(everywhere, contact)
            course.stored += numbers_in(arguments[:5])
        elif style == "granular":
            _take_coefficients(course)
        elif style.startswith("hybrid"):
            _take_hybrid(course, style, arguments)
        else:
            raise ValueError(no_equal(style))
        if not any(max(pair) < course.kinds for pair in course.contacts):
            raise ValueError("no pair_coeff defines a law for the types of the grains")
        course.met[USED].append(f"pair_style {style}")
    except (ValueError, IndexError, KeyError, TypeError) as problem:
        source = course.run.places.get("pair_style", course.run.source)
        course.obstacle(f"pair_style {style} was not imported: {problem} ({source})")


def _take_hybrid(course: Course, style: str, arguments: list[str]) -> None:
    """Import the laws of the parts of a hybrid style; at most one part may act between two types."""
    parts, factors = _split_hybrid(arguments, {line[2] for line in course.run.pair_coeff if len(line) > 2})
    if any(word not in ("1", "1.0") for word in factors):
        raise ValueError(f"it multiplies forces by factors ({' '.join(factors)}), but only factors of 1 are supported")
    acting: dict[tuple[int, int], dict[str, list[str]]] = {}
    for first, second, part, *rest in course.run.pair_coeff:
        for pair in set(_pairs(course, first, second)):
            others = acting.get(pair, {}) if style != "hybrid" and part != "none" else {}
            acting[pair] = others | {plain_style(part): rest}
    for pair, own in acting.items():
        acts = {}  # parts with forces between these types
        for part, rest in own.items():
            zero = numbers_in(rest[:1]) == [0.0] and find_row(LINEAR, part).group == HARMLESS
            if not (zero or find_row(BESIDE, part).group == HARMLESS):
                acts[part] = rest
        if len(acts) > 1:
            raise ValueError(f"it adds the forces of {' and '.join(acts)}, but only one contact law is supported")
        for part, rest in acts.items():
            if part not in parts or (part != "granular" and part.removeprefix("gran/") not in HISTORY):
                raise ValueError(f"its part {part} acts between some types: {no_equal(part)}")
            words = rest if part == "granular" else parts[part]
            course.contacts[pair] = contact_of(part.removeprefix("gran/"), words)[0]
            course.stored += [] if part == "granular" else numbers_in(words[:5])
    _mix_the_rest(course, set(acting))
    apart = {pair for pair in acting if pair not in course.contacts}
    if course.types is None and (apart or len({str(contact) for contact in course.contacts.values()}) > 1):
        raise ValueError("its parts act between some types only, but the grains have no types (a column type)")
    if not apart:
        return
    ends = np.sort(course.types[course.contacts_of_grains()], axis=0)
    for a, b in sorted(apart):  # types whose contacts have no forces in LAMMPS, but have forces here
        count = int(((ends[0] == a) & (ends[1] == b)).sum())
        what = f"pair_coeff defines no forces between types {a + 1} and {b + 1}"
        if count:
            course.obstacle(f"{what}, but {pluralize(count, 'contact')} between them would have some here")
        else:
            course.notes.append(Assumption(f"{what}: none of them touch now, but contacts would have forces here"))


def _split_hybrid(arguments: list[str], given: set[str]) -> tuple[dict[str, list[str]], list[str]]:
    """Words that follow each part of a hybrid style, and the factors before the parts of hybrid/scaled."""
    parts: dict[str, list[str]] = {}
    factors: list[str] = []
    name = ""
    scaled = bool(numbers_in(arguments[:1])) or arguments[0].startswith("v_")
    for word in arguments:
        if word in given or word == "granular" or "/" in word:
            if scaled:
                factors.append(parts[name].pop())
            name = plain_style(word)
            if name in parts:
                raise ValueError(f"it has the part {name} twice, which is not supported")
            parts[name] = []
        else:
            parts.setdefault(name, []).append(word)
    return parts, factors


def _mix_the_rest(course: Course, given: set[tuple[int, int]] = frozenset()) -> None:
    """Add laws of pairs of types for which commands define none, mixed from those of both types."""
    own = [a for a in range(course.kinds) if (a, a) in course.contacts]
    for a, b in combinations(own, 2):
        if (a, b) not in {*course.contacts, *given}:
            course.contacts[a, b] = mix(course.contacts[a, a], course.contacts[b, b])


def _take_coefficients(course: Course) -> None:
    """Import the laws of the style granular, which must be the same for all types if the grains have no types."""
    lines: dict[tuple[str, str], tuple[str, ...]] = {}
    for first, second, *arguments in course.run.pair_coeff:  # the last one for the same types counts
        lines.pop((first, second), None)
        lines[first, second] = tuple(arguments)
    if course.types is None and len({*lines.values()}) > 1:
        text = "pair_coeff defines different laws for types, but the grains have no types (a column type)"
        course.obstacle(text, LAW)  # types do not matter if all have the same law
        return
    if course.types is None and lines:
        lines = {("1", "1"): next(iter(lines.values()))}
    given = {}
    for (first, second), arguments in lines.items():
        given |= dict.fromkeys(_pairs(course, first, second), arguments)
    laws = {arguments: contact_of("granular", arguments)[0] for arguments in dict.fromkeys(given.values())}
    course.contacts |= {pair: laws[arguments] for pair, arguments in given.items()}
    course.stored += [number for arguments in laws for number in numbers_in(arguments)]
    _mix_the_rest(course)


def _pairs(course: Course, first: str, second: str) -> list[tuple[int, int]]:
    """Pairs of types, from 0, selected by two words such as 1, *, 2* or 1*3, or by labels."""
    ends = [types_in(word, course.kinds) for word in course.run.numbers([first, second])]
    return [(min(pair) - 1, max(pair) - 1) for pair in product(*ends)]


def _finish_law(course: Course) -> None:
    """Combine the laws of all pairs of types and walls."""
    if not any(max(pair) < course.kinds for pair in course.contacts):
        return
    given = course.contacts
    if course.types is not None:
        for kind in {*np.unique(course.types).tolist()} - {a for a, b in given if a == b}:
            course.obstacle(f"{course.run.source} defines no law for grains of type {kind + 1}")
    course.contacts = {pair: of_release(contact, course.run.year) for pair, contact in given.items()}
    course.law, lacks = law_of_contacts(course.contacts, course.kinds, len(course.walls))
    for lack in lacks:
        course.obstacle(f"{lack}: the law here differs")
    course.notes += map(Assumption, differences(course.contacts))
    changed = {given[pair].damping for pair, contact in course.contacts.items() if contact != given[pair]}
    course.notes += [Assumption(TSUJI if damping == "tsuji" else LIMITED) for damping in sorted(changed)]
    heavy = ~course.free[:, :3].any(axis=1) & ~course.frozen
    if heavy.any() and any(c.values["damping_n"] and c.damping != "velocity" for c in given.values()):
        course.notes.append(Assumption(HEAVY))
    if resists_rolling(course.law) and course.packing.memory is None:
        course.notes.append(
            Absent("the memory of rolling and twisting is stored in restart files only: it is zero here")
        )


def describe(course: Course) -> str:
    """Describe the law, walls and loads of a run in a few words."""
    loaded = [name for name, there in (("gravity", course.gravity.any()), ("forces", course.force.any())) if there]
    parts = [" ".join(course.run.pair_style[:1]) or "no pair_style"]
    parts += [pluralize(len(course.walls), "wall")] if course.walls else []
    held, turns = ~course.free[:, :3].any(axis=1), course.free[:, 3:].any(axis=1)
    parts += loaded + ([pluralize(int(held.sum()), "held grain")] if held.any() else [])
    parts += [f"{int((held & turns).sum())} of them free to turn"] if (held & turns).any() else []
    count = sum(len(pairs) for _, pairs, *_ in course.bonds)
    parts += [pluralize(count, "bond")] if count else []
    return ", ".join(parts)


def setting(course: Course):
    """Function that adds the walls and loads of a run to a state."""

    def put(state: State) -> State:
        with refusing():
            for part in course.bonds:
                state = bonded_at_rest(state, *part)
        if not (course.walls or not course.free.all() or course.gravity.any() or course.force.any()):
            return state
        count = len(course.walls)
        walls = flat_walls(
            [plane.height * plane.normal for plane in course.walls], [plane.normal for plane in course.walls],
            material=[course.kinds + k if course.law else 0 for k in range(count)],
        )  # fmt: skip
        control = loads(course.n, count, gravity=course.gravity)
        control.force[: course.n] = course.force
        control.free[: course.n] &= course.free
        bare = empty_contacts(course.n + count, 0, state.contacts.skin)
        return state._replace(walls=walls, control=control, contacts=bare)

    return put
