"""Effects of the commands of a run of LAMMPS: the law of each pair of types, walls, loads and held grains."""

from itertools import combinations

import numpy as np

from ...builtin_laws import BY_NAME
from ...core.laws.builtin import PARAMETERS, linear
from ...core.laws.properties import resists_rolling
from ...core.measure import touching
from ...core.readable import pluralize
from ...core.state import State, empty_contacts, flat_walls, loads
from ...known import HARMLESS, UNKNOWN, USED, find_row, plain_style
from ..sample import LAW, Absent, Assumption, from_arrays
from . import lammps_restart
from .lammps_commands import numbers_in
from .lammps_fixes import CENTRED, TAKEN, Course
from .lammps_laws import (
    HISTORY,
    LIMITED,
    SAME_UNITS,
    TSUJI,
    Contact,
    contact_of,
    differences,
    law_of_contacts,
    memory_layout,
    mix,
    no_equal,
    of_release,
)

BESIDE = "style beside the pair style"
HEAVY = "held grains count as infinitely heavy in dashpots, as under fix freeze, where LAMMPS takes their masses"
MOVERS = {  # fixes that move grains, and whether these also turn
    "nve": False, "nve/limit": False, "nve/noforce": False, "nve/sphere": True, "nve/bpm/sphere": True, "move": True,
    "rigid": True, "rigid/small": True, "npt/sphere": True, "nvt/sphere": True, "nph/sphere": True, "npt": False,
    "nvt": False, "nph": False,
}  # fmt: skip


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
    restored = "read_restart" in run.met[USED]  # with the dimension
    if course.packing.arrays.get("dim") == 2 and run.settings.get("dimension") != ["2"] and not restored:
        course.obstacle("grains at z = 0 are read in two dimensions, and the run has three: motion along z is left out")
    _take_pairs(course)
    for name, (group, style, *_) in run.fixes.items():
        if style in MOVERS:
            _try(course, name, lambda group=group, style=style: _take_mover(course, group, style))
    for name, (group, style, *arguments) in sorted(run.fixes.items(), key=lambda fix: fix[1][1] in CENTRED):
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
        why = f"group {group} is made of too many others"
    except (ValueError, IndexError, KeyError, TypeError) as problem:
        why = str(problem)
    text = f"fix {name} ({style}) was not taken over: {why} ({course.run.places[name]})"
    if text not in course.met[UNKNOWN]:
        course.obstacle(text)


def _take_mover(course: Course, group: str, style: str) -> None:
    members = course.members(group)
    twice = int((course.moved & members).sum())
    course.moved |= members
    course.turned |= members & MOVERS[style]
    if twice:
        raise ValueError(f"it moves {pluralize(twice, 'grain')} that another fix moves as well, twice in a step")


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
        speed = np.linalg.norm(course.packing.arrays.get("velocity", np.zeros((course.n, 3))), axis=1)
        if speed[rest].max() > speed[course.moved].max():
            course.obstacle(
                "grains that no fix moves have velocities, on which dashpots of their contacts act: `velocity GROUP "
                "set 0 0 0` stops them"
            )
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
            _take_hybrid(course, style, arguments)
        else:
            raise ValueError(no_equal(style))
        if not any(max(pair) < course.kinds for pair in course.contacts):
            raise ValueError("no pair_coeff gives the types of the grains a law")
        course.met[USED].append(f"pair_style {style}")
    except (ValueError, IndexError, KeyError, TypeError) as problem:
        place = course.run.places.get("pair_style", course.run.source)
        course.obstacle(f"pair_style {style} was not taken over: {problem} ({place})")


def _take_hybrid(course: Course, style: str, arguments: list[str]) -> None:
    """Laws of the parts of a hybrid style, of which at most one may act between two types."""
    parts, factors = _split_hybrid(arguments, {line[2] for line in course.run.pair_coeff if len(line) > 2})
    if any(word not in ("1", "1.0") for word in factors):
        raise ValueError(f"it multiplies forces by factors ({' '.join(factors)}), and only factors of 1 are read")
    acting: dict[tuple[int, int], dict[str, list[str]]] = {}
    for first, second, part, *rest in course.run.pair_coeff:
        ends = {(min(a, b), max(a, b)) for a in _types(course, first) for b in _types(course, second)}
        for pair in ends:
            others = acting.get(pair, {}) if style != "hybrid" and part != "none" else {}
            acting[pair] = others | {plain_style(part): rest}
    for pair, own in acting.items():
        own = {part: rest for part, rest in own.items() if find_row(BESIDE, part).group != HARMLESS}
        if len(own) > 1:
            raise ValueError(f"it adds the forces of {' and '.join(own)}, and one contact law is read")
        for part, rest in own.items():
            if part not in parts or (part != "granular" and part.removeprefix("gran/") not in HISTORY):
                raise ValueError(f"its part {part} acts between some types: {no_equal(part)}")
            words = rest if part == "granular" else parts[part]
            course.contacts[pair] = contact_of(part.removeprefix("gran/"), words)[0]
            course.stored += [] if part == "granular" else numbers_in(words[:5])
    _mix_the_rest(course, set(acting))
    apart = {pair for pair in acting if pair not in course.contacts}
    if course.types is None and (apart or len({str(contact) for contact in course.contacts.values()}) > 1):
        raise ValueError("the grains have no types (a column type), and its parts act between some types only")
    _check_apart(course, apart)


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
                raise ValueError(f"it has the part {name} twice, which is not read")
            parts[name] = []
        else:
            parts.setdefault(name, []).append(word)
    return parts, factors


def _check_apart(course: Course, apart: set[tuple[int, int]]) -> None:
    """Note contacts of types between which LAMMPS has no forces, and which are there here."""
    if not apart or course.types is None:
        return
    arrays = {name: course.packing.arrays.get(name) for name in ("position", "radius", "cell", "periodic")}
    state = from_arrays(**arrays, law=linear(), dim=course.packing.arrays.get("dim", 3))
    rows = touching(state)
    ends = np.sort(np.stack([course.types[state.contacts.i[rows]], course.types[state.contacts.j[rows]]]), axis=0)
    for a, b in sorted(apart):
        count = int(((ends[0] == a) & (ends[1] == b)).sum())
        what = f"pair_coeff gives types {a + 1} and {b + 1} no forces"
        if count:
            course.obstacle(f"{what}, and {pluralize(count, 'contact')} between them would have some here")
        else:
            course.notes.append(
                Assumption(f"{what}: none of them touch, and if they came to, they would have some here")
            )


def _mix_the_rest(course: Course, given: set[tuple[int, int]] = frozenset()) -> None:
    """Laws of pairs of types that have none of their own, from those of both types."""
    own = [a for a in range(course.kinds) if (a, a) in course.contacts]
    for a, b in combinations(own, 2):
        if (a, b) not in {*course.contacts, *given}:
            course.contacts[a, b] = mix(course.contacts[a, a], course.contacts[b, b])


def _take_coefficients(course: Course) -> None:
    """Laws of the style granular; without types, all must have the same."""
    lines: dict[tuple[str, str], tuple[str, ...]] = {}
    for first, second, *arguments in course.run.pair_coeff:  # the last of the same types counts
        lines.pop((first, second), None)
        lines[first, second] = tuple(arguments)
    if course.types is None and len({*lines.values()}) > 1:
        text = "the grains have no types (a column type), and pair_coeff gives types different laws"
        course.obstacle(text, LAW)  # which one law for all types does away with
        return
    if course.types is None and lines:
        lines = {("1", "1"): next(iter(lines.values()))}
    given = {}
    for (first, second), arguments in lines.items():
        ends = [(a, b) for a in _types(course, first) for b in _types(course, second)]
        given |= {(min(pair), max(pair)): arguments for pair in ends}
    laws = {arguments: contact_of("granular", arguments)[0] for arguments in dict.fromkeys(given.values())}
    course.contacts |= {pair: laws[arguments] for pair, arguments in given.items()}
    course.stored += [number for arguments in laws for number in numbers_in(arguments)]
    _mix_the_rest(course)


def _types(course: Course, word: str) -> range:
    """Types, from 0, that a word such as 1, *, 2* or 1*3, or a label, means."""
    (word,), kinds = course.run.numbers([word]), course.kinds
    low, star, high = word.partition("*")
    if not (low + high).isdecimal() and low + high:
        raise ValueError(f"the type {word} is no number, and no labelmap gives it one")
    first = int(low or 1)
    return range(first - 1, min(int(high or kinds) if star else first, kinds))


def _finish_law(course: Course) -> None:
    """The law of all pairs of types and walls."""
    if not any(max(pair) < course.kinds for pair in course.contacts):
        return
    given = course.contacts
    if course.types is not None:
        for kind in {*np.unique(course.types).tolist()} - {a for a, b in given if a == b}:
            course.obstacle(f"{course.run.source} gives grains of type {kind + 1} no law")
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
