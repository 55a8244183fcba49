"""Effects of the commands of a run of LAMMPS: the law of each pair of types, walls, loads and held grains."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...builtin_laws import BY_NAME
from ...core.laws.builtin import PARAMETERS, Law
from ...core.laws.properties import resists_rolling
from ...core.readable import pluralize
from ...core.state import State, empty_contacts, flat_walls, loads
from ...core.text import parse_number
from ...known import HARMLESS, UNKNOWN, USED, find_row, plain_style
from ..sample import UNDECIDED, Absent, Assumption, NoTypes, Obstacle, PackingError
from . import lammps_restart
from .content import Packing
from .lammps_commands import Region, Run, group_members, numbers_in
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

MOST_TYPES = 1000
HEAVY = "held grains count as infinitely heavy in dashpots, as under fix freeze, where LAMMPS takes their masses"
MOVERS = {  # fixes that move grains, and whether these also turn
    "nve": False, "nve/limit": False, "nve/noforce": False, "nve/sphere": True, "nve/bpm/sphere": True, "move": True,
    "rigid": True, "rigid/small": True, "npt/sphere": True, "nvt/sphere": True, "nph/sphere": True, "npt": False,
    "nvt": False, "nph": False,
}  # fmt: skip


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
        if self.kinds > MOST_TYPES:
            raise PackingError(f"the grains have types up to {self.kinds}: up to {MOST_TYPES} are read")
        self.contacts: dict[tuple[int, int], Contact] = {}
        self.walls: list[Plane] = []
        self.gravity, self.force = np.zeros(3), np.zeros((self.n, 3))
        self.free = np.ones((self.n, 6), bool)  # as in `Control`
        self.frozen, self.moved, self.turned = (np.zeros(self.n, bool) for _ in range(3))
        self.law: Law | None = None
        self.stored: list[float] = []  # coefficients that a restart file of the same run has
        self.met: dict[str, list[str]] = {USED: [], HARMLESS: [], UNKNOWN: []}

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
        """Note that something acts, or may act, that was not taken over."""
        self.notes.append(Obstacle(f"{UNDECIDED}{text}"))
        self.met[UNKNOWN].append(text)

    def hold(self, members: np.ndarray, axes: Sequence[int]) -> None:
        """Hold components of grains; ValueError if they move."""
        zero = np.zeros((self.n, 3))
        motion = np.hstack([self.packing.arrays.get(name, zero) for name in ("velocity", "spin")])
        if motion[np.ix_(members & self.moved, axes)].any():
            raise ValueError("the grains that it drives move")
        self.free[np.ix_(members, axes)] = False

    def push(self, members: np.ndarray) -> None:
        """Check that forces of a fix act on no grain that a fix before it holds; ValueError otherwise."""
        if (members & self.moved & ~self.free[:, :3].all(axis=1)).any():
            raise ValueError("it comes after the fix that holds some of its grains, which therefore move")


def with_wall_numbers(memory: lammps_restart.Restart, course: Course) -> lammps_restart.Restart:
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


def take_over(course: Course) -> None:
    """Take over the commands of a run, in the order in which they matter."""
    run = course.run
    for command in run.unknown:
        what = "the variables in " if command.startswith(("fix", "pair")) else "what follows from "
        course.obstacle(f"{what}`{command}` is not known without running LAMMPS; its log.lammps has it")
    for sentence in run.acts.values():
        course.obstacle(sentence)
    for part in run.settings.get("exclude", []):
        course.obstacle(f"neigh_modify exclude {part} was not taken over: contacts that it leaves out are there here")
    units = run.settings.get("units", ["lj"])[0]
    if units not in SAME_UNITS:
        course.obstacle(f"units {units}, in which LAMMPS converts forces, were not taken over")
    _take_pairs(course)
    for name, (group, style, *_) in run.fixes.items():
        if style in MOVERS:
            _try(course, name, lambda group=group, style=style: _take_mover(course, group, style))
    for name, (group, style, *arguments) in run.fixes.items():
        _try(course, name, lambda *given: _take_fix(course, *given), name, style, group, arguments)
    _hold_the_rest(course)
    _finish_law(course)


def _try(course: Course, name: str, take, *given) -> None:
    """Take over a fix, or note why it was not."""
    group, style, *_ = course.run.fixes[name]
    try:
        take(*given)
        return
    except RecursionError:
        why = f"group {group} is defined by itself"
    except (ValueError, IndexError, KeyError, TypeError) as problem:
        why = str(problem)
    text = f"fix {name} ({style}) was not taken over: {why} ({course.run.places[name]})"
    if text not in course.met[UNKNOWN]:
        course.obstacle(text)


def _take_mover(course: Course, group: str, style: str) -> None:
    course.moved |= course.members(group)
    course.turned |= course.members(group) & MOVERS[style]


def _take_fix(course: Course, name: str, style: str, group: str, arguments: list[str]) -> None:
    row = find_row("fix", style)
    if style in TAKEN:
        TAKEN[style](course, name, group, arguments)
    elif row.group not in (USED, HARMLESS):
        raise ValueError(row.why or "whether it acts on the grains is not known")
    if course.packing.arrays.get("dim") == 2 and style == "nve/sphere":
        course.packing.arrays["i0"] = 0.5 if "disc" in arguments else 0.4
    course.met[row.group].append(f"fix {name} ({style})")


def _hold_the_rest(course: Course) -> None:
    """Hold grains that no fix moves, and the rotations of those that no fix turns."""
    rest, still = ~course.moved, course.moved & ~course.turned
    if not course.moved.any():
        return
    if rest.any():
        course.free[rest] = False
        course.notes.append(f"{pluralize(int(rest.sum()), 'grain')} that no fix moves are held")
    if still.any():
        spin = course.packing.arrays.get("spin")
        course.free[still, 3:] = False
        course.notes.append(f"fix nve does not turn {pluralize(int(still.sum()), 'grain')}: their rotations are held")
        if spin is not None and spin[still].any():
            course.obstacle("grains that no fix turns rotate at constant rates")


def _take_pairs(course: Course) -> None:
    """Laws of pairs of types."""
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
            raise ValueError(f"it adds several styles ({' '.join(arguments)}), and one contact law is read")
        else:
            raise ValueError("no law here is equal to it")
        course.met[USED].append(f"pair_style {style}")
    except (ValueError, IndexError, KeyError, TypeError) as problem:
        place = course.run.places.get("pair_style", course.run.source)
        course.obstacle(f"pair_style {style} was not taken over: {problem} ({place})")


def _take_coefficients(course: Course) -> None:
    """Laws of the style granular, whose types may be unknown if all have the same law."""
    if course.types is None:
        words = [word for first, second, *_ in course.run.pair_coeff for word in (first, second)]
        course.kinds = max([1, *(int(n) for word in words for n in re.findall(r"\d{1,3}", word))])
    given = {}
    for first, second, *arguments in course.run.pair_coeff:
        contact, _ = contact_of("granular", arguments)
        ends = [(a, b) for a in _types(first, course.kinds) for b in _types(second, course.kinds)]
        given |= {(min(pair), max(pair)): (contact, arguments) for pair in ends}
    course.contacts |= {pair: contact for pair, (contact, _) in given.items()}
    course.stored += [number for _, arguments in given.values() for number in numbers_in(arguments)]
    for a in range(course.kinds):
        for b in range(a + 1, course.kinds):
            if (a, b) not in course.contacts and {(a, a), (b, b)} <= set(course.contacts):
                course.contacts[a, b] = mix(course.contacts[a, a], course.contacts[b, b])
    if course.types is None:
        laws = list(course.contacts.values())
        alike, course.kinds = all(law == laws[0] for law in laws), 1
        course.contacts = {(0, 0): laws[0]} if alike and laws else {}
        if not alike:
            text = "the grains have no types (a column type), and pair_coeff gives types different laws"
            course.notes.append(NoTypes(f"{UNDECIDED}{text}"))
            course.met[UNKNOWN].append(text)


def _types(word: str, kinds: int) -> range:
    """Types, from 0, that a word such as 1, *, 2* or 1*3 means."""
    low, star, high = word.partition("*")
    if not (low + high).isdecimal() and low + high:
        raise ValueError(f"the type {word} is no number")
    first = int(low or 1)
    return range(first - 1, (int(high or kinds) if star else first))


def _take_wall(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Flat walls of `fix wall/gran`, each with its own row in the law's table."""
    number = course.wall_number(name)
    contact, (kind, *rest) = _wall_law(arguments)
    rest = rest[:-1] if rest[-1:] == ["contacts"] else rest  # adds output only
    if kind not in ("xplane", "yplane", "zplane") or len(rest) != 2 or not course.members(group).all():
        raise ValueError(
            f"only fixed planes that touch all grains are read, not `{' '.join([kind, *rest])}` of group {group}"
        )
    axis = "xyz".index(kind[0])
    for word, side in zip(rest, (1.0, -1.0), strict=True):
        if word != "NULL":
            _add_wall(course, name, Plane(side * _finite(word), side * np.eye(3)[axis], number))
            _add_wall_law(course, contact, arguments)


def _wall_law(arguments: list[str]) -> tuple[Contact, list[str]]:
    """Law of a wall, and the words that follow it."""
    if numbers_in(arguments[:1]):
        raise ValueError(
            "its arguments begin with numbers, not with the name of a style, as in LAMMPS before 2019, and are not read"
        )
    return wall_contact(plain_style(arguments[0]), arguments[1:])


def _add_wall(course: Course, name: str, wall: Plane) -> None:
    """Add a wall; grains behind it are between the walls of no packing here."""
    place, radius = course.packing.arrays["position"], course.packing.arrays["radius"]
    course.push(wall.overlap(place, radius) > 0)
    course.walls.append(wall)
    behind = int((place @ wall.normal < wall.height).sum())
    if behind:
        course.obstacle(
            f"{pluralize(behind, 'grain')} behind the wall of fix {name}: LAMMPS pushes them out on the other side or "
            f"not at all, and here a wall is solid behind its surface"
        )


def _finite(word: str) -> float:
    """Number of a word; ValueError if it is NaN or infinite."""
    if word.startswith("v_"):
        raise ValueError(f"{word} is a variable, whose value only LAMMPS knows")
    if not np.isfinite(value := parse_number(word)):
        raise ValueError(f"{word} is no finite number")
    return value


def _add_wall_law(course: Course, contact: Contact, arguments: list[str]) -> None:
    """Law of the newest wall with all types."""
    own = _classic(course, contact) if plain_style(arguments[0]) == "hooke/history" else contact
    course.contacts |= {(a, course.kinds + len(course.walls) - 1): own for a in range(course.kinds)}


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


OPTIONS = {"side": 1, "units": 1, "open": 1, "move": 3, "rotate": 7}  # of regions, and the number of their arguments


def _take_plane(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Plane of `fix wall/gran/region`."""
    number = course.wall_number(name)
    contact, rest = _wall_law(arguments)
    region = course.run.regions[rest[rest.index("region") + 1]]
    style, *words = region.words
    rest = rest[:-1] if rest[-1:] == ["contacts"] else rest
    given, k = {}, 6
    while style == "plane" and k < len(words):
        given[words[k]], k = words[k + 1 : k + 1 + OPTIONS[words[k]]], k + 1 + OPTIONS[words[k]]
    if style != "plane" or {"move", "rotate"} & set(given) or len(rest) != 2 or not course.members(group).all():
        told = f"`{' '.join([style, *words, *rest[2:]])}` of group {group}"
        raise ValueError(f"only regions that are fixed planes and touch all grains are read, not {told}")
    scale = np.ones(3) if given.get("units") == ["box"] else _spacing(region)
    point, normal = np.array([_finite(w) for w in words[:6]]).reshape(2, 3) * scale
    normal = (-1.0 if given.get("side") == ["out"] else 1.0) * normal / np.linalg.norm(normal)
    _add_wall(course, name, Plane(float(point @ normal), normal, number))
    _add_wall_law(course, contact, arguments)


def _spacing(region: Region) -> np.ndarray:
    """(3,) unit of length of a region, which is that of the lattice if there is one; ValueError if it is not known."""
    if region.spacing == []:
        raise ValueError("its region is in units of the lattice, whose spacing is in log.lammps only")
    return np.array([_finite(word) for word in region.spacing or ("1", "1", "1")])


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
    course.push(members)
    if members.all():
        course.gravity += _finite(size) * direction
    else:
        course.force[members] += _finite(size) * mass[members, None] * direction


def _take_freeze(course: Course, name: str, group: str, arguments: list[str]) -> None:
    course.hold(course.members(group), range(6))
    course.frozen |= course.members(group)


def _take_setforce(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Forces of zero, which leave torques as they are."""
    forces, members = arguments[:3], course.members(group)
    if len(arguments) != 3 or any(parse_number(word) for word in forces if word != "NULL"):
        raise ValueError("only forces of zero, or NULL, in the whole box are read")
    course.hold(members, [k for k, word in enumerate(forces) if word != "NULL"])


def _take_addforce(course: Course, name: str, group: str, arguments: list[str]) -> None:
    if len(arguments) > 3:
        raise ValueError(f"its options `{' '.join(arguments[3:])}` are not read")
    course.push(course.members(group))
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
    heavy = ~course.free[:, :3].any(axis=1) & ~course.frozen
    if heavy.any() and any(c.values["damping_n"] and c.damping != "velocity" for c in given.values()):
        course.notes.append(Assumption(HEAVY))
    if resists_rolling(course.law) and course.packing.memory is None:
        course.notes.append(Absent("the memory of rolling and twisting is in restart files only: it is zero here"))


def describe(course: Course) -> str:
    """Describe the law, walls and loads of a run in a few words."""
    loaded = [name for name, there in (("gravity", course.gravity.any()), ("forces", course.force.any())) if there]
    parts = [" ".join(course.run.pair_style[:1]) or "no pair_style"]
    parts += [pluralize(len(course.walls), "wall")] if course.walls else []
    held, turns = ~course.free[:, :3].any(axis=1), course.free[:, 3:].any(axis=1)
    parts += loaded + ([pluralize(int(held.sum()), "held grain")] if held.any() else [])
    parts += [f"{int((held & turns).sum())} of them free to turn"] if (held & turns).any() else []
    return ", ".join(parts)


def setting(course: Course):
    """Function that puts a state between the walls and under the loads of its run."""

    def put(state: State) -> State:
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
