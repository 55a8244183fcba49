"""Fixes of a run of LAMMPS and what each of them does here: walls, loads and held grains."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...core.laws.builtin import Law
from ...core.readable import pluralize
from ...core.sizes import Size, require_sizes
from ...core.text import parse_number
from ...known import HARMLESS, UNKNOWN, USED, plain_style
from ..sample import Assumption, Obstacle, PackingError
from .content import Packing
from .lammps_commands import Region, Run, group_members, numbers_in
from .lammps_laws import WALL_CLASSIC, Contact, wall_contact


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
        self.stored: list[float] = []  # coefficients that a restart file of the same run has
        self.met: dict[str, list[str]] = {USED: [], HARMLESS: [], UNKNOWN: []}

    def members(self, group: str) -> np.ndarray:
        """(N,) bool, members of a group; ValueError if they are not known."""
        if any(words[0] == "dynamic" for words in self.run.groups.get(group, ())[-1:]):
            raise ValueError(f"the members of group {group} change with time (`group {group} dynamic`)")
        mask = self.masks.get(group)
        mask = group_members(self.run, group, self.packing.ids, self.types, self.n) if mask is None else mask
        if mask is None:
            raise ValueError(
                f"the members of group {group} are not known for certain: restart files have them, and commands only "
                f"if they choose types or ids that nothing changes later"
            )
        return mask

    def wall_number(self, name: str) -> int:
        """Number of a fix among those of walls, in whose order restart files store memory."""
        return [key for key, tokens in self.run.fixes.items() if tokens[1].startswith("wall/gran")].index(name)

    def obstacle(self, text: str, about: str = "") -> None:
        """Note that something acts, or may act, that was not taken over."""
        self.notes.append(Obstacle(text, about))
        self.met[UNKNOWN].append(text)

    def hold(self, group: str, axes: Sequence[int]) -> None:
        """Hold components of the grains of a group; ValueError if they move."""
        members = self.members(group)
        for name, first, how in (
            ("velocity", 0, f"velocities, with which they move on: `velocity {group} set 0 0 0` stops them"),
            ("spin", 3, f"spins, with which they turn on: `set group {group} omega 0 0 0` stops them"),
        ):
            motion = self.packing.arrays.get(name, np.zeros((self.n, 3)))
            if motion[np.ix_(members & self.moved, [k - first for k in axes if first <= k < first + 3])].any():
                raise ValueError(f"its grains have {how}")
        self.free[np.ix_(members, axes)] = False

    def push(self, members: np.ndarray) -> None:
        """Check that forces of a fix act on no grain that a fix before it holds; ValueError otherwise."""
        if (members & self.moved & ~self.free[:, :3].all(axis=1)).any():
            raise ValueError("it comes after the fix that holds some of its grains, which therefore move")


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
    course.hold(group, range(6))
    course.frozen |= course.members(group)


def _take_setforce(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Forces of zero, which leave torques as they are."""
    forces = arguments[:3]
    if len(arguments) != 3 or any(parse_number(word) for word in forces if word != "NULL"):
        raise ValueError("only forces of zero, or NULL, in the whole box are read")
    course.hold(group, [k for k, word in enumerate(forces) if word != "NULL"])


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


CENTRED = ("momentum", "recenter")  # fixes that come after all others, whose loads they may act against


def _take_momentum(course: Course, name: str, group: str, arguments: list[str]) -> None:
    """Check that a fix which removes momentum, or moves grains back to a place, has nothing to do.

    Contacts between grains keep their total momentum, and a periodic box does not keep their angular one.
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
    "wall/gran": _take_wall, "wall/gran/region": _take_plane, "gravity": _take_gravity, "freeze": _take_freeze,
    "setforce": _take_setforce, "addforce": _take_addforce, "deform": _take_deform,
    **dict.fromkeys(CENTRED, _take_momentum),
}  # fmt: skip
