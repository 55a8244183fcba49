"""Packings from LAMMPS data files and dumps, with the memory of contacts reconstructed from a `dump local`.

LAMMPS does not write the slip of `pair_style gran/hertz/history` and `gran/hooke/history`, only the tangential force
F_t = −(k_t s + c_t v_t), with k_t and c_t at the contact's overlap. Hence

    s = −(F_t + c_t v_t)/k_t,    v_t = (v_i − v_j − (R_i ω_i + R_j ω_j) × n) less its normal part

for contacts below the Coulomb limit; at the limit, s is the slip after LAMMPS's next truncation. The signs were checked
against a real run (tests/peers): the forces act on the first atom of a pair, and the branch vector dx dy dz points from
the second atom to the first.

Source: LAMMPS documentation of `pair_style gran` and `compute pair/local`; doi:10.1103/PhysRevE.64.051302.
"""

import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.contacts.forces import FROZEN, forces
from ...core.contacts.jacobian import linearise
from ...core.laws.builtin import SHARP, Law, damping_model
from ...core.measure import branch_vectors, contact_velocity, touching
from ...core.readable import pluralize
from ...core.state import OPEN, SLIDE, STICK, State
from ...known import UNKNOWN, USED, group_of
from ..sample import HUGE, Assumption, MemoryNote, PackingError, PackingWarning, accepted, account_for
from .columns import ALL_DIGITS, HEAD, Packing, choice_note, head_text, placed_state, read_content
from .lammps_text import FORCE, ORDER, Table, packing_from_table, read_dump

NEEDED = ("law", "kn", "kt", "mu", "damping_n", "damping_t")
ALIASES = {"patom1": "i", "patom2": "j", "id1": "i", "id2": "j", "p1": "tx", "p2": "ty", "p3": "tz"}
SKIPPED = "-"  # name of a skipped column
AT_LIMIT = 1e-5  # relative distance to the Coulomb limit within which a contact slides: dumps have at least six digits
OTHER_LAW = 0.05  # deviation from LAMMPS's normal forces, over their mean, above which the law must be wrong
NEGLIGIBLE = 1e-6  # deviation from these forces below which no warning is issued


class Pairs(NamedTuple):
    """Contacts as LAMMPS wrote them; grains are counted from 0."""

    i: np.ndarray  # (M,)
    j: np.ndarray  # (M,)
    branch: np.ndarray | None  # (M, 3) from j to i [length]
    distance: np.ndarray | None  # (M,) [length]
    normal: np.ndarray | None  # (M, 3) normal force on i [force]
    tangential: np.ndarray  # (M, 3) tangential force on i [force]
    notes: tuple[str, ...] = ()  # notes on the columns


def recognize_dump(head: bytes) -> bool:
    """Return True for a text dump of grains or contacts."""
    return head_text(head).lstrip().startswith("ITEM:")


def recognize_data(head: bytes) -> bool:
    """Return True for a data file, by the number of atoms and the box in its header."""
    return bool(re.search(r"(?m)^\s*(\d+\s+atoms|\S+\s+\S+\s+xlo\s+xhi)\b", head_text(head)))


def read_grain_dump(
    path: Path, frame: str | None = None, boundary: str | None = None, atom_style: str | None = None,
    names: Mapping[str, str] | None = None,
):  # fmt: skip
    """Read packings from a dump of grains; `frame` is a time step, "all", or None for the last.

    `names` maps the names of columns in the dump to their names in LAMMPS.
    """
    if atom_style:
        raise PackingError(f"atom_style does not apply to the dump {path}, which names its columns: leave it out")
    tables, steps = read_dump(path, frame)
    if not tables[-1].grains:
        raise PackingError(
            f"{path} is a dump of contacts, with columns {' '.join(tables[-1].columns)}: give the grains, a dump of "
            f"atoms or a data file, and this file as --contacts"
        )
    said = choice_note(path, [*map(str, steps)], frame, "time steps")
    own = {new: name for new, name in (names or {}).items() if group_of("column of a dump", name) == USED}
    tables = [t._replace(columns={own.get(name, name): words for name, words in t.columns.items()}) for t in tables]
    return [packing_from_table(table, path, boundary, said) for table in tables]


def read_pairs(path: Path, packing: Packing, columns: str | None = None) -> Pairs:
    """Read the contacts of a `dump local` at the time step of a packing; `columns` names unnamed columns."""
    tables, steps = read_dump(path, None if packing.step < 0 else str(packing.step))
    if packing.step < 0 and len(steps) > 1:
        warnings.warn(f"{path.name} has {len(steps)} time steps: the last is used", PackingWarning, stacklevel=3)
    return pairs_from_table(tables[0], path, packing, columns)


def pairs_from_table(table: Table, path: Path, packing: Packing, columns: str | None = None) -> Pairs:
    """Contacts of a packing from one time step of a `dump local`."""
    if packing.ids is None:
        raise PackingError(f"{path} refers to grains by ids, but the grains have none: add the column id to their dump")
    table = _rename_columns(table, path, columns, packing)
    ends = _finite_numbers(table, path, "i", "j").astype(np.int64)
    strange = ~np.isin(ends, packing.ids)
    if strange.any():
        raise PackingError(
            f"{path} names grain {ends[strange][0]}, which is not among the {len(packing.ids)} grains of the packing: "
            f"{group_hint(packing) or 'give all grains, from the same run'}"
        )

    def vectors(*names):
        return _finite_numbers(table, path, *names) if table.has(*names) else None

    index, normal = np.searchsorted(packing.ids, ends), vectors("fx", "fy", "fz")
    branch, tangential = vectors("dx", "dy", "dz"), vectors("tx", "ty", "tz")
    if tangential is None:
        n, total = pair_branches(packing, *index.T), _finite_numbers(table, path, *TOTAL)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        normal = np.einsum("ck,ck->c", total, n)[:, None] * n
        tangential = total - normal
    named = [name for name in table.columns if name and not name.startswith(SKIPPED)]
    notes = account_for("column of contacts", named, path.name)
    return Pairs(*index.T, branch, vectors("dist"), normal, tangential, tuple(notes))


def _finite_numbers(table: Table, path: Path, *names: str) -> np.ndarray:
    """Columns as numbers; raise PackingError if one of them is NaN or infinite."""
    values = table.numbers(*names)
    if not (np.abs(values) < HUGE).all():
        raise PackingError(
            f"{path} contains NaN, infinity or numbers beyond {HUGE:g} in {' '.join(names)}: it is damaged"
        )
    return values


def _rename_columns(table: Table, path: Path, columns: str | None, packing: Packing) -> Table:
    """Rename the columns of a table to the names used here."""
    names = list(table.columns)
    if columns is not None:
        given = columns.split()
        known = {*ORDER, *ALIASES, *TOTAL, SKIPPED}
        for name in given:
            if name not in known and group_of("column of contacts", name) == UNKNOWN:
                raise PackingError(
                    f"{path}: unknown column {name!r}; use {' '.join(ORDER)}, or {SKIPPED} for a column to skip"
                )
        if len(given) != len(names):
            raise PackingError(
                f"{path} has {len(names)} columns, but --columns has {len(given)} names: {' '.join(names)}"
            )
        names = given
    elif all(re.fullmatch(r"[cfv]_\w+(\[\d+\])?", name) for name in names):
        rows = len(table.columns[names[0]])
        values = _finite_numbers(table, path, *names)
        names = name_contact_columns(values, packing, path) if rows else ORDER[: len(names)]
    names = [ALIASES.get(name, name) for name in names]
    names = [f"{name}{k}" if name == SKIPPED else name for k, name in enumerate(names)]
    if "periodic" in names and "tx" not in names:  # LIGGGHTS's pair/gran/local
        names = [name.replace("f", "F") if name in FORCE else name for name in names]
    renamed = table._replace(columns=dict(zip(names, table.columns.values(), strict=True)))
    if not renamed.has("i", "j") or not (renamed.has("tx", "ty", "tz") or renamed.has(*TOTAL)):
        raise PackingError(
            f"{path} has columns {' '.join(table.columns)}: i j tx ty tz are needed, named by `dump_modify colname` "
            "or --columns; unnamed columns are identified by their content"
        )
    return renamed


def reconstruct_memory(packing: Packing, pairs: Pairs, law: Law) -> State:
    """Accepted state of a packing, with slip reconstructed from tangential forces.

    Raises
    ------
    PackingError
        If the law is not LAMMPS's, if velocities needed by the dashpots are missing, or if contacts and grains do not
        match.

    Warns
    -----
    PackingWarning
        if slip was changed or is missing, or the normal forces differ from LAMMPS's.
    """
    if law.coulomb != SHARP:
        raise PackingError("friction is sharp in LAMMPS: use --coulomb sharp instead of smooth")
    missing = {"velocity", "spin"} - set(packing.arrays)
    if damping_model(law) and missing:
        raise PackingError(
            f"the slip of contacts with dashpots needs every grain's {' and '.join(sorted(missing))}: add vx vy vz "
            f"omegax omegay omegaz to the dump of grains, or a section Velocities to the data file"
        )
    state = placed_state(packing, law)
    rows, entries, sign = _match_pairs(state, pairs)
    _check_columns(pairs, branch_vectors(state)[rows], entries, sign)
    c = linearise(state, law)
    vn, vt = contact_velocity(state, rows, c.normal[rows])
    tangential = sign[:, None] * pairs.tangential[entries]
    stiffness = c.stiffness_t[rows, None]
    pull = tangential + c.damping_t[rows, None] * vt
    force_n = c.force_n[rows] - c.damping_n[rows] * vn
    if pairs.normal is not None:
        theirs = sign * np.einsum("ck,ck->c", pairs.normal[entries], c.normal[rows])
        miss = float(np.abs(force_n - theirs).max(initial=0.0)) / (float(np.abs(theirs).mean()) if len(theirs) else 1.0)
        told = "normal forces of the law differ from those in the dump by up to"
        if miss > OTHER_LAW:
            raise PackingError(
                f"{told} {miss:.2g} of their mean, so the law, the types or the run differ: give the law, kn and "
                f"damping_n used in LAMMPS, and enough digits ({ALL_DIGITS})"
            )
        if miss > NEGLIGIBLE:
            warnings.warn(f"{told} {miss:.1g} of their mean: {ALL_DIGITS}", PackingWarning, stacklevel=3)
        force_n = theirs
    slip = np.divide(-pull, stiffness, out=np.zeros_like(pull), where=stiffness > 0)
    contacts, limit = state.contacts, np.abs(c.limit[rows] + c.mu[rows] * (force_n - c.force_n[rows]))
    slides = np.linalg.norm(tangential, axis=1) >= (1 - AT_LIMIT) * limit
    new = contacts._replace(slip=contacts.slip.copy(), mode=contacts.mode.copy())
    new.slip[:] = 0.0
    new.slip[rows], new.mode[rows] = slip, np.where(slides, SLIDE, STICK)
    # if dashpots carry part of the force, LAMMPS keeps the slip of sliding contacts below the limit
    return accepted(state._replace(contacts=new), law, modes=True, within=1.0)


def _check_columns(pairs: Pairs, branch: np.ndarray, entries: np.ndarray, sign: np.ndarray) -> None:
    """Raise PackingError if the geometry of the grains contradicts the names of columns of contacts."""
    tangential, length = pairs.tangential[entries], np.linalg.norm(branch, axis=1)
    along = np.abs(np.einsum("ck,ck->c", tangential, branch)) / length
    slack = 0.0 if pairs.normal is None else NEGLIGIBLE * np.linalg.norm(pairs.normal[entries], axis=1).sum()
    most = OTHER_LAW * length.sum()
    checks = {
        "tx ty tz": along.sum() > OTHER_LAW * np.linalg.norm(tangential, axis=1).sum() + slack,
        "dx dy dz": pairs.branch is not None and np.abs(sign[:, None] * pairs.branch[entries] - branch).sum() > most,
        "dist": pairs.distance is not None and np.abs(pairs.distance[entries] - length).sum() > most,
    }
    if wrong := [name for name, is_wrong in checks.items() if is_wrong]:
        raise PackingError(
            f"the columns {' and '.join(wrong)} of the contacts do not agree with the positions of the grains: name "
            "all columns in their order with --columns"
        )


def _match_pairs(state: State, pairs: Pairs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Match pairs to rows of the contact list.

    Return the rows, the indices of the pairs, and their signs (−1 if the grains are swapped).
    """
    rows, n = np.flatnonzero(state.contacts.mode[: state.contacts.count[0]] != OPEN), len(state.grains.radius)
    rows = rows[state.contacts.j[rows] < n]
    key = state.contacts.i[rows].astype(np.int64) * n + state.contacts.j[rows]
    low, high = np.minimum(pairs.i, pairs.j), np.maximum(pairs.i, pairs.j)
    sign = np.where(pairs.i <= pairs.j, 1.0, -1.0)
    first, last = (np.searchsorted(key, low.astype(np.int64) * n + high, side) for side in ("left", "right"))
    open_pair = first == last
    lost = np.flatnonzero(open_pair & pairs.tangential.any(axis=1))
    if len(lost):
        a, b = pairs.i[lost[0]], pairs.j[lost[0]]
        raise PackingError(
            f"{pluralize(len(lost), 'pair')}, such as grains {a} and {b} (counted from 0), carry force but do not "
            f"touch: contacts and grains are from different time steps or runs, or the box differs"
        )
    entries = np.flatnonzero(~open_pair)
    chosen = first[entries].copy()
    for k in np.flatnonzero(last[entries] - first[entries] > 1):  # a grain touches two images of another grain
        entry = entries[k]
        own = branch_vectors(state)[rows[first[entry] : last[entry]]]
        if pairs.branch is not None:
            miss = np.linalg.norm(own - sign[entry] * pairs.branch[entry], axis=1)
        elif pairs.distance is not None:
            miss = np.abs(np.linalg.norm(own, axis=1) - pairs.distance[entry])
        else:
            raise PackingError(
                f"grains {pairs.i[entry]} and {pairs.j[entry]} touch more than once across the periodic box: add dx dy "
                "dz to the contacts to distinguish them"
            )
        chosen[k] = first[entry] + int(np.argmin(miss))
    matched = rows[chosen]
    if len(np.unique(matched)) < len(matched):
        raise PackingError("a contact is listed twice: give each contact once, from a single time step, with dx dy dz")
    if len(matched) < len(rows):
        message = f"{pluralize(len(rows) - len(matched), 'touching pair')} not in the dump: slip set to zero"
        warnings.warn(message, PackingWarning, stacklevel=3)
    return matched, entries, sign[entries]


def complete_law_options(given: dict) -> dict:
    """Options for `law_by_name` if slip is to be reconstructed; all parameters of the law are required."""
    known = dict(given)
    if "young" in known and "poisson" in known:
        known |= {"kn": None, "kt": None}
    missing = [name for name in NEEDED if name not in known]
    if missing:
        options = ", ".join(f"--{name.replace('_', '-')}" for name in missing)
        raise PackingError(
            "the slip of LAMMPS contacts is reconstructed from forces with the parameters of the law: also give "
            f"{options} as in its pair_style"
        )
    out = {"coulomb": "sharp"} | given
    if given["law"] == "linear":
        out = {"damping": "mass_velocity"} | out
    return out


def read_boundary(contacts: Path) -> str | None:
    """Read the boundaries of the box from the header of a dump; a data file does not contain them."""
    text = head_text(read_content(contacts, HEAD))
    head = re.search(r"ITEM: BOX BOUNDS.*?([pfsm]{2}) ([pfsm]{2}) ([pfsm]{2})\s*\n", text)
    return None if head is None else "".join("p" if mark == "pp" else "f" for mark in head.groups())


def state_of_pairs(packing: Packing, pairs: Pairs, law: Law) -> tuple[State, list[str]]:
    """Accepted state of a packing with the memory of its contacts, and notes on this memory."""
    state = reconstruct_memory(packing, pairs, law)
    mode = state.contacts.mode[: state.contacts.count[0]]
    count, sliding = int((mode != OPEN).sum()), int((mode == SLIDE).sum())
    said = MemoryNote(f"slip of {count} contacts reconstructed, {sliding} of them at the Coulomb limit")
    notes = [*pairs.notes, said]
    return with_wall_memory(state, law, packing.force, notes) if len(state.walls.mass) else (state, notes)


def with_wall_memory(state: State, law: Law, net: np.ndarray | None, notes: list[str]) -> tuple[State, list[str]]:
    """State with slip at walls, which is not in dumps but follows from the remaining force on each grain; and notes.

    Parameters
    ----------
    net : (N, 3) resultants on the grains, from the dump; zero by default, as at rest [force]
    """
    n, rows = len(state.grains.radius), touching(state)
    rows = rows[state.contacts.j[rows] >= n]
    rows = rows[np.bincount(state.contacts.i[rows], minlength=n)[state.contacts.i[rows]] == 1]
    i, c = state.contacts.i[rows], linearise(state, law, memory=FROZEN)
    ours = forces(state, law, memory=FROZEN)[0].force
    missing = (0.0 if net is None else net[i]) - ours[i]
    normal, k = c.normal[rows], c.stiffness_t[rows, None]
    missing = missing - np.einsum("ck,ck->c", missing, normal)[:, None] * normal
    slip = state.contacts.slip.copy()
    slip[rows] += np.divide(-missing, k, out=np.zeros_like(missing), where=k > 0)
    how = "the assumption that the grains are at rest" if net is None else "the resultants on the grains, fx fy fz"
    note = Assumption(
        f"slip of {pluralize(len(rows), 'contact')} with walls, stored in restart files only, follows from {how}"
    )
    return accepted(state._replace(contacts=state.contacts._replace(slip=slip)), law), [*notes, note]


SLACK = 1e-3  # relative tolerance for numbers with few digits
MOST = 40  # largest number of columns
TOTAL = "Fx", "Fy", "Fz"


def pair_branches(packing: Packing, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(M, 3) vectors from grain j to the nearest image of grain i [length]."""
    position = np.asarray(packing.arrays["position"])
    branch = position[i] - position[j]
    if "cell" in packing.arrays:
        cell, periodic = np.asarray(packing.arrays["cell"]), np.asarray(packing.arrays.get("periodic", (True,) * 3))
        for axis in (2, 1, 0):
            if periodic[axis]:
                branch = branch - np.round(branch[:, axis] / cell[axis, axis])[:, None] * cell[axis]
    return branch


def group_hint(packing: Packing) -> str:
    """Sentence stating that gaps in the ids suggest that only a group was written; empty without gaps."""
    ids = packing.ids
    if not len(ids) or ids[-1] == len(ids):
        return ""
    return f"the {len(ids)} grains have ids up to {ids[-1]}, as in the dump of a group: give a dump of all grains"


def name_contact_columns(values: np.ndarray, packing: Packing, path: Path) -> list[str]:
    """Names of columns of contacts in their order; "" for unused columns.

    The two id columns name grains that touch. The distance and the branch vector of each pair follow from the
    positions of its grains. A normal force is parallel to the branch vector, a tangential one perpendicular to it.
    If neither exists, the last three columns that are neither positions nor distances are the total force.

    Parameters
    ----------
    values : (M, columns)

    Raises
    ------
    PackingError
        If no columns fit.
    """
    names, ids = [""] * values.shape[1], packing.ids
    ends = next((k for k in range(min(values.shape[1], MOST) - 1) if _are_pairs(values[:, k : k + 2], packing)), None)
    if ends is None:
        raise PackingError(
            f"{path} has {values.shape[1]} unnamed columns, none of which contain ids of touching grains: "
            f"{group_hint(packing) or 'give contacts of the same step and run as the grains, or name the columns'}"
        )
    i, j = np.searchsorted(ids, values[:, ends : ends + 2].astype(np.int64)).T
    names[ends : ends + 2] = "i", "j"
    branch = pair_branches(packing, i, j)
    length = np.linalg.norm(branch, axis=1)
    for k in range(values.shape[1]):
        if not names[k] and _is_small(values[:, k] - length, length):
            names[k] = "dist"
            break
    normal, at = branch / length[:, None], 0
    while at + 3 <= min(values.shape[1], MOST):
        kind = "" if any(names[at : at + 3]) else _kind_of_vector(values[:, at : at + 3], branch, normal, names)
        names[at : at + 3] = [kind + axis for axis in "xyz"] if kind else names[at : at + 3]
        at += 3 if kind else 1
    if "tx" in names:
        return names
    # the columns of the total force on the first grain, which presses the grains apart
    position = np.asarray(packing.arrays["position"])
    flags = (values == np.round(values)).all(axis=0)
    for at in range(values.shape[1] - 3, -1, -1):
        vector = values[:, at : at + 3]
        known = any(names[at : at + 3]) or flags[at : at + 3].all()
        if known or any(_is_small(vector - position[end], position[end]) for end in (i, j)):
            continue
        along = np.einsum("ck,ck->c", vector, normal)
        if along.sum() > 0.5 * np.linalg.norm(vector, axis=1).sum():
            names[at : at + 3] = TOTAL
            break
    return names


def _is_small(rest: np.ndarray, whole: np.ndarray) -> bool:
    """Return True if the remainder is a small fraction of the whole."""
    return bool(np.abs(rest).sum() <= SLACK * np.abs(whole).sum())


def _are_pairs(columns: np.ndarray, packing: Packing) -> bool:
    """Return True if two columns are ids of grains and nearly all pairs touch."""
    if not (columns == np.round(columns)).all() or not np.isin(columns, packing.ids).all():
        return False
    i, j = np.searchsorted(packing.ids, columns.astype(np.int64)).T
    reach = np.asarray(packing.arrays["radius"])[i] + np.asarray(packing.arrays["radius"])[j]
    near = np.linalg.norm(pair_branches(packing, i, j), axis=1) < (1 + SLACK) * reach
    return bool((i != j).all() and near.mean() > 0.9)


def _kind_of_vector(vector: np.ndarray, branch: np.ndarray, normal: np.ndarray, names: list[str]) -> str:
    """Kind of three columns: "d" branch vector, "f" normal force, "t" tangential force, "" otherwise."""
    along = np.einsum("ck,ck->c", vector, normal)
    across = vector - along[:, None] * normal
    if "dx" not in names and _is_small(vector - branch, branch):
        return "d"
    if "fx" not in names and along.any() and _is_small(across, along) and along.sum() > 0:
        return "f"
    known = across.any() or "fx" in names  # without friction, tangential forces are zero
    return "t" if "tx" not in names and known and _is_small(along, across) else ""
