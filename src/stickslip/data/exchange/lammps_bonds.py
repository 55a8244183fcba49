"""Import LAMMPS bonds listed in a file, with laws from the commands of the run; write bonds as text of a data file.

`bpm/spring` and `bpm/rotational` keep the length and the direction that each bond had when LAMMPS first evaluated it
after `bond_style`. Restart files contain this length and direction, but data files and dumps do not. When LAMMPS reads
a data file, it uses the present lengths and directions. `harmonic` has the energy K (r − r₀)², so its stiffness is 2K.

Source: LAMMPS documentation of `bond_style bpm/spring`, `bpm/rotational`, `harmonic` and `special_bonds`; the
exponents 8 and 4, with which loads fade, were measured with LAMMPS 2022 to 2025.
"""

import re
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.contacts.bonding import bond_limits, bonded_at_rest
from ...core.contacts.bonds import bond_vectors
from ...core.laws.bonds import BY_BEAM, BY_STRETCH, UNBREAKABLE, Bond, beam_bond, spring_bond
from ...core.readable import pluralize
from ...core.state import Bonds, State
from ...core.text import parse_number
from ...known import BONDED, HARMLESS, UNKNOWN, find_row, group_of, plain_style
from ..sample import BONDS, Assumption, Obstacle, PackingError
from .columns import ListedBonds, Packing
from .lammps_commands import types_in

YES = {"yes": True, "on": True, "true": True, "no": False, "off": False, "false": False}
STORED = ("id1", "id2", "time", "x", "y", "z", "x/ref", "y/ref", "z/ref")  # quantities that `store/local` may write
WEIGHTS = {"amber": "0 0 0.5", "charmm": "0 0 0", "dreiding": "0 0 1", "fene": "0 1 1"}  # special_bonds by keyword
MOVING = ("displace_atoms", "change_box", "read_dump", "replicate")  # commands that move grains without a run
RUNNING = ("run", "minimize", "rerun")
COEFFICIENTS = {"harmonic": 2, "bpm/spring": 3, "bpm/rotational": 12}  # numbers of coefficients, by style
REST = 1e-20  # energy of a bond at rest over k_n r₀²
ENDLESS = 1e200  # strength above which a bond counts as unbreakable


def list_bonds(source: str, ids: np.ndarray, kind: np.ndarray, ends: np.ndarray, labels: dict[str, str]) -> ListedBonds:
    """Bonds of a file whose `ends` are ids of grains; raise PackingError if a bond is impossible."""
    for a, b in ends[~np.isin(ends, ids).all(axis=1)][:1]:
        raise PackingError(
            f"{source} has a bond between atoms {a} and {b}, which are not both among its {len(ids)} atoms"
        )
    for a, _ in ends[ends[:, 0] == ends[:, 1]][:1]:
        raise PackingError(f"{source} has a bond from atom {a} to itself: a bond needs two atoms")
    i, j = np.sort(np.searchsorted(ids, ends), axis=1).T
    order = np.lexsort((j, i))
    i, j = i[order], j[order]
    for k in np.flatnonzero((np.diff(i) == 0) & (np.diff(j) == 0))[:1]:
        raise PackingError(
            f"{source} has the bond between atoms {ids[i[k]]} and {ids[j[k]]} twice: list each bond once"
        )
    return ListedBonds(i, j, kind[order], source, labels)


def note_on_bonds(bonds: ListedBonds, why: str = "") -> list[Obstacle]:
    """Note that bonds were not imported; the reason is `why` or, by default, that their laws are in the run folder."""
    if not len(bonds.i):
        return []
    text = f"{pluralize(len(bonds.i), 'bond')} of {bonds.source} were not imported: "
    return [Obstacle(text + (why or "give the run folder, whose log contains their laws"), BONDS)]


def bonds_of_data(head: str, listed: ListedBonds) -> Callable[[State], State] | None:
    """Return the function that adds the bonds of a data file with their laws to its state.

    The laws come from commands in comments of the header, as `format_bonds` writes them. Return None if there are no
    such comments, or if contacts between bonded grains do not act fully.
    """
    commands = re.findall(r"(?m)^# ((?:bond_style|bond_coeff|special_bonds) .*)$", head)
    told = replay([*(["", *line.split()] for line in commands), ["", "read_data", listed.source]])
    if not told.style or any(parse_number(weight) != 1 for weight in told.weights):
        return None
    parts, _ = laws_of_bonds(told, listed)

    def put(state: State) -> State:
        for part in parts:
            state = bonded_at_rest(state, *part)
        return state

    return put


class FormattedBonds(NamedTuple):
    """Bonds of a state as text of a data file."""

    before: list[str]  # commands that LAMMPS needs before `read_data`
    after: list[str]  # commands that LAMMPS needs after `read_data`
    counts: list[str]  # lines of the header
    sections: list[str]
    notes: list[str]


def format_bonds(state: State) -> FormattedBonds:
    """Text of intact bonds, with a bond type for each law, and notes on data that the file does not store."""
    bonds = state.bonds
    way = bond_vectors(bonds, state.grains.position, state.cell.vectors)
    apart = np.where(state.cell.periodic, way @ np.linalg.inv(state.cell.vectors), 0.0)
    far = bonds.intact & (np.abs(apart) > 0.5).any(axis=1)
    rows = np.flatnonzero(bonds.intact & ~far)
    limited = (bonds.strength < ENDLESS).any(axis=1) & (bonds.form != BY_BEAM)
    breaks = bool(limited[rows].any())  # the same for all styles of a hybrid
    springs = (bonds.form == BY_STRETCH) & ~limited & ~bonds.damping.any(axis=1)
    laws = [_bond_coefficients(bonds, k, harmonic=bool(springs[rows].all())) for k in rows]
    kinds = {law: number for number, law in enumerate(dict.fromkeys(laws), 1)}
    options, unfading = {}, 0
    for style in dict.fromkeys(style for style, *_ in laws):
        fades = [bonds.fading[k] > 0 for k, law in zip(rows, laws, strict=True) if law[0] == style and limited[k]]
        unfading += 0 if all(fades) else sum(fades)
        fade = "yes" if fades and all(fades) else "no"
        more = f" overlay/pair yes break {'yes' if breaks else 'no'} smooth {fade}"
        options[style] = more if style.startswith("bpm/") else ""
    one = len(options) == 1
    named = " ".join(style + more for style, more in options.items())
    before = ["newton on off", "atom_style bpm/sphere", "comm_modify vel yes", "special_bonds lj/coul 1 1 1"]
    after = [f"bond_style {'' if one else 'hybrid '}{named}"]
    after += [
        " ".join(["bond_coeff", str(k), *([] if one else law[:1]), *map(repr, law[1:])]) for law, k in kinds.items()
    ]
    ends = zip(laws, (bonds.i[rows] + 1).tolist(), (bonds.j[rows] + 1).tolist(), strict=True)
    listed = [f"{k} {kinds[law]} {i} {j}" for k, (law, i, j) in enumerate(ends, 1)]
    stored = np.array([style == "harmonic" for style, *_ in laws], bool)
    strained = bond_limits(state).energy[rows] > REST * bonds.stiffness[rows, 0] * bonds.length[rows] ** 2
    lost = [
        (strained & ~stored, "the deformation of {}, which LAMMPS takes to be at rest"),
        (~bonds.intact, "{} that broke"), (far, "{} to images that are not the nearest"),
        (np.ones(unfading, bool), "that {} fade before they break, unlike others of their style"),
    ]  # fmt: skip
    said = "; ".join(text.format(pluralize(int(some.sum()), "bond")) for some, text in lost if some.any())
    notes = [f"LAMMPS data files do not store {said}"] if said else []
    parallel = bonds.form[rows] == BY_BEAM
    if parallel.any():
        moved = ", with shear forces at their middle" if (bonds.arm[rows[parallel]] != 0.5).any() else ""
        notes.append(
            f"LAMMPS has no parallel bonds: {pluralize(int(parallel.sum()), 'bond')} written as bpm/rotational of the "
            f"same stiffnesses, without strength{moved}"
        )
    if not len(rows):
        return FormattedBonds([], [], [], [], notes)
    notes.append(
        f"LAMMPS needs the commands in comments at the head of the file: `{'`, `'.join(before)}` before `read_data`, "
        f"then `{after[0]}` and its `bond_coeff`"
    )
    counts = [f"{len(rows)} bonds", f"{len(kinds)} bond types"]
    return FormattedBonds(before, after, counts, ["", "Bonds", "", *listed], notes)


def _bond_coefficients(bonds: Bonds, k: int, *, harmonic: bool) -> tuple:
    """Style and coefficients of one bond; only `harmonic`, which excludes other styles, stores rest lengths."""
    stiffness, strength, damping = (part[k].tolist() for part in (bonds.stiffness, bonds.strength, bonds.damping))
    if bonds.form[k] == BY_STRETCH:
        length = float(bonds.length[k])
        if harmonic:
            return "harmonic", 0.5 * stiffness[0], length
        most = UNBREAKABLE if strength[0] > ENDLESS else strength[0] / (stiffness[0] * length)
        return "bpm/spring", stiffness[0], most, damping[0]
    tension, shear, bending, twisting = [UNBREAKABLE] * 4 if bonds.form[k] == BY_BEAM else strength
    limits = tension, shear, twisting, bending
    return "bpm/rotational", *stiffness[:2], stiffness[3], stiffness[2], *limits, *damping


class Commands(NamedTuple):
    """Bonds at the end of a run, according to its commands."""

    style: list[str]  # bond style and its options; empty if there is none
    place: str  # place of the command that sets the style
    coefficients: list[list[str]]  # words of each bond_coeff after the style was set
    weights: list[str]  # factors of special_bonds for contacts of grains one, two and three bonds apart
    made: list[str]  # the commands create_bonds, with their places
    deleted: list[str]  # the commands delete_bonds, with their places
    labels: dict[str, str]  # types by label
    strained: bool  # grains may have moved since LAMMPS first evaluated the bonds
    turned: bool  # grains may have turned before LAMMPS first evaluated the bonds
    origin: str  # data file with the positions at which LAMMPS first evaluated the bonds, or empty


def replay(commands: Sequence[Sequence[str]]) -> Commands:
    """Evaluate the commands that concern bonds; the first word of each is its place in the log or script."""
    now = Commands([], "", [], ["0", "0", "0"], [], [], {}, strained=False, turned=False, origin="")
    first = True  # LAMMPS has not evaluated the bonds yet
    there = False  # there may be bonds
    source = ""  # data file with the present positions
    restored = False  # a restart file contains the stored memory of bonds
    for place, key, *rest in commands:
        if key == "bond_style" and rest:
            first = not restored
            style = [plain_style(rest[0]), *rest[1:]]
            turned = now.turned or now.strained
            now = now._replace(style=style, place=place, coefficients=[], strained=restored, turned=turned)
        elif key == "bond_coeff":
            now.coefficients.append(rest)
        elif key == "special_bonds":
            now = now._replace(weights=_weights(rest, now.weights))
        elif key == "create_bonds":
            there, source = True, ""
            now.made.append(f"{' '.join([key, *rest][:6])} ({place})")
        elif key == "delete_bonds":
            now.deleted.append(f"{' '.join([key, *rest])} ({place})")
        elif key == "labelmap" and rest[:1] == ["bond"]:
            now.labels.update(dict(zip(rest[2::2], rest[1::2], strict=False)))
        elif key in ("read_data", "read_restart") and rest:
            there, source = True, "" if key == "read_restart" or source else rest[0]
            restored = restored or key == "read_restart"
            first = first and not restored
            now = now._replace(strained=now.strained or restored)
        elif key in MOVING or (key in RUNNING and rest[:1] != ["0"]):
            evaluates = key in RUNNING and first and there and bool(now.style)
            now = now._replace(
                origin=source if evaluates else now.origin if not first else "",
                strained=there and (evaluates or not first),
                turned=now.turned or (key in RUNNING and not evaluates and first),
            )
            first, source = first and not evaluates, ""
        elif key in RUNNING and first and there and now.style:
            first, now = False, now._replace(origin=source)
    return now if there else now._replace(strained=True)


def _weights(words: list[str], before: list[str]) -> list[str]:
    """Weights of Lennard-Jones forces, which also apply to contacts, after a command `special_bonds`."""
    for k, word in enumerate(words):
        if word in WEIGHTS:
            before = WEIGHTS[word].split()
        elif word in ("lj", "lj/coul"):
            before = words[k + 1 : k + 4]
    return before


def can_break(told: Commands) -> bool:
    """Return True if bonds may break in a run."""
    kept = any(key == "break" and not YES.get(word, True) for key, word in pairwise(told.style))
    return any(word.startswith("bpm/") for word in told.style) and not kept


def with_lengths(bonds: ListedBonds, now: Packing, then: Packing) -> ListedBonds:
    """Bonds whose rest lengths are their lengths in another packing of the same grains."""
    if now.ids is None or then.ids is None or not np.isin(now.ids, then.ids).all():
        return bonds
    i, j = (np.searchsorted(then.ids, now.ids[ends]) for ends in (bonds.i, bonds.j))
    way = then.arrays["position"][i] - then.arrays["position"][j]
    if "cell" in then.arrays:
        cell = then.arrays["cell"]
        way -= np.where(then.arrays["periodic"], np.round(way @ np.linalg.inv(cell)), 0.0) @ cell
    return bonds._replace(length=np.linalg.norm(way, axis=1))


def laws_of_bonds(told: Commands, listed: ListedBonds) -> tuple[list[tuple], list[str]]:
    """Arguments of `bonded_at_rest`, except the state, for each active type of bond, and the styles of these types.

    Raises
    ------
    ValueError
        If a law is unknown or not supported.
    """
    if not told.style:
        raise ValueError("there is no bond_style: if it came from a restart file, add it with its bond_coeff")
    labels = listed.labels | told.labels
    bonds, acting = [], []
    for kind in np.unique(listed.kind[listed.kind > 0]).tolist():
        style, bond, length = _law_of(told, labels, kind)
        if bond is None:
            continue
        mine, acting = listed.kind == kind, [*acting, style]
        parts = [None if part is None else part[mine] for part in (listed.length, listed.direction, listed.turn)]
        if length is not None:
            parts[0] = np.full(mine.sum(), length)
        bonds.append((bond, np.stack([listed.i[mine], listed.j[mine]], axis=1), *parts))
    return bonds, acting


def _law_of(told: Commands, labels: dict[str, str], kind: int) -> tuple[str, Bond | None, float | None]:
    """Style of the bonds of one type, their law (None without force), and the rest length if the law has one."""
    named = [(labels.get(words[0], words[0]), words[1:]) for words in told.coefficients if words]
    given = [words for word, words in named if kind in types_in(word, kind, "the type {} of a bond_coeff")]
    style, options = told.style[0], told.style[1:]
    if style == "hybrid" and given:
        style = plain_style(given[-1][0])
        options = _parts(told.style[1:], {words[1] for words in told.coefficients if len(words) > 1}).get(style, [])
        given = [words[1:] for words in given]
    row = find_row("bond style", style)
    if row.group == UNKNOWN:
        raise ValueError(f"{style}: {row.why}")
    if row.group == HARMLESS:
        return style, None, None
    if not given:
        raise ValueError(f"no bond_coeff defines a law for bonds of type {kind}")
    numbers = [parse_number(word) for word in given[-1]]
    if len(numbers) != COEFFICIENTS[style]:
        raise ValueError(f"{style} needs {COEFFICIENTS[style]} coefficients, got {len(numbers)}: {' '.join(given[-1])}")
    if not all(0 <= number < np.inf for number in numbers):
        raise ValueError(f"coefficients of {style} must be finite and not negative, got {' '.join(given[-1])}")
    if style == "harmonic":
        k, length = numbers
        if not length:
            raise ValueError("springs of length 0 at rest are not supported")
        return style, spring_bond(2 * k) if k else None, length
    return style, _bpm(style, options, numbers), None


def _parts(words: list[str], given: set[str]) -> dict[str, list[str]]:
    """Options of each part of a hybrid style."""
    parts: dict[str, list[str]] = {}
    own: list[str] = []
    for word in words:
        if word in given or group_of("bond style", plain_style(word)) != UNKNOWN:
            own = parts.setdefault(plain_style(word), [])
        else:
            own.append(word)
    return parts


def _bpm(style: str, options: list[str], numbers: list[float]) -> Bond:
    """Law of `bpm/spring` or `bpm/rotational`."""
    flags, k = {"break": True, "smooth": True, "normalize": False, "overlay/pair": False, "volume/factor": False}, 0
    while k < len(options):
        if options[k] == "store/local":  # affects output only
            k += 3
            while k < len(options) and options[k] in STORED:
                k += 1
        elif options[k] in flags and set(options[k + 1 : k + 2]) & {*YES}:
            flags[options[k]] = YES[options[k + 1]]
            k += 2
        else:
            raise ValueError(f"its option {' '.join(options[k : k + 2])} is not supported")
    if flags["volume/factor"]:
        raise ValueError("its option volume/factor yes is not supported")
    how = {"smooth": flags["smooth"], "normalized": flags["normalize"]}
    limits = numbers[1:2] if style == "bpm/spring" else numbers[4:8]
    if not min(numbers[:1] + limits * flags["break"]) > 0:
        raise ValueError("its first stiffness, and strengths of bonds that break, must be positive")
    if style == "bpm/spring":
        stiffness, stretch, damping = numbers
        return spring_bond(stiffness, stretch if flags["break"] else None, damping=damping, **how)
    tension, shear, twisting, bending = numbers[:4]
    strength = (limits[0], limits[1], limits[3], limits[2]) if flags["break"] else None
    normal, sliding, rolling, spinning = numbers[8:]
    damping = normal, sliding, rolling, spinning
    return beam_bond(tension, shear, bending, twisting, strength=strength, damping=damping, **how)


def notes_on_rest(told: Commands, listed: ListedBonds, acting: Sequence[str]) -> list[Assumption]:
    """Notes on assumptions about the rest configurations of bonds."""
    bpm = " and ".join(sorted({style for style in acting if style.startswith("bpm/")}))
    if bpm and listed.length is None and told.strained:
        how = (
            "rest lengths are stored in restart files only, and LAMMPS makes the same assumption when it reads a "
            "data file"
        )
        return [Assumption(f"bonds of {bpm} are assumed to be at rest in this state: {how}")]
    if "bpm/rotational" in bpm and listed.turn is None and (told.strained or told.turned):
        how = "orientations are stored in restart files only"
        return [Assumption(f"bonds of bpm/rotational are assumed not to be bent, twisted or sheared: {how}")]
    return []


def note_on_contacts(told: Commands, listed: ListedBonds, n: int, i: np.ndarray, j: np.ndarray) -> Assumption | None:
    """Note on contacts i–j of n grains that `special_bonds` removes or changes; None if it changes none.

    This command affects contacts of grains that are one to three bonds apart. Restart files store its weights.
    """
    weights = listed.weights or tuple(parse_number(word) for word in told.weights)
    if all(weight == 1 for weight in weights):
        return None
    there = listed.kind != 0
    near = sp.csr_array((np.ones(there.sum()), (listed.i[there], listed.j[there])), (n, n))
    near = ((near + near.T) > 0).astype(float)
    apart, reached = np.zeros(len(i), int), sp.eye_array(n, format="csr")
    for bonds in (1, 2, 3):
        reached = ((reached @ near) > 0).astype(float)
        pairs = reached.tocoo()
        apart[(apart == 0) & np.isin(i.astype(np.int64) * n + j, pairs.row.astype(np.int64) * n + pairs.col)] = bonds
    changed = (apart > 0) & (i != j) & (np.array([1.0, *weights])[apart] != 1)
    what = f"special_bonds lj {' '.join(f'{weight:g}' for weight in weights)}: {BONDED}"
    if changed.any():
        return Obstacle(f"{what}, but {pluralize(int(changed.sum()), 'such contact')} would act fully here")
    return Assumption(f"{what}: none of these grains touch now, but if they did, they would repel each other here")
