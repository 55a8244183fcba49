"""Build an accepted state from the arrays of a packing; `exchange.files` reads such arrays from files."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import numpy as np

from ..builtin_laws import BY_NAME
from ..core.arguments import checked
from ..core.contacts.forces import AT_LIMIT, FREE, FROZEN, GIVEN, HELD, accept, forces
from ..core.contacts.neighbors import grid_of, with_neighbor_list
from ..core.fields import pack_keys
from ..core.laws.builtin import CONSTRUCTORS as LAWS
from ..core.laws.builtin import COULOMB, DAMPING, PARAMETERS, Law, elastic_constants
from ..core.laws.kinds import bridges_gaps
from ..core.measure import branch_vectors, overlaps
from ..core.readable import pluralize
from ..core.state import OPEN, SLIDE, STICK, State, assembly, box, disks, loads, spheres
from ..core.text import SentenceError, printable
from ..known import HARMLESS, UNKNOWN, USED, find_row

HUGE = 1e30  # larger numbers make products overflow
NO_LAW = "the contact law is missing"
FORMER_NO_LAW = "no contact law was given"  # wording in files of version 0.3
UNDECIDED = "undecided: "  # beginning of notes on actions on the grains that were not imported
LAW, PAIRS, WALLS, FIXES, GROUP, COLUMNS = "law", "pair style", "walls", "fixes", "group", "columns"  # note subjects
BONDS = "bonds"


class PackingError(SentenceError):
    """Raised for a packing that cannot be used; the message is one sentence for the user."""


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Add the name of a file to errors of calls that receive only its arrays."""
    try:
        yield
    except PackingError as problem:
        raise PackingError(f"{path}: {problem}") from None


@contextmanager
def refusing(text: Callable[[Exception], str] = str, *kinds: type[Exception]) -> Iterator[None]:
    """Raise PackingError in place of ValueError and errors of further kinds; `text` converts an error to a message."""
    try:
        yield
    except PackingError:
        raise
    except (ValueError, *kinds) as problem:
        raise PackingError(text(problem)) from None


class Note(str):
    """A note on a packing; code decides by its class and its subject `about`, never by its wording."""

    about: str

    def __new__(cls, text: str, about: str = "") -> Self:  # noqa: D102
        note = super().__new__(cls, text)
        note.about = about
        return note


class Assumption(Note):
    """A note on an assumption about a packing; files made from the packing repeat it."""


class Absent(Assumption):
    """A note on information missing from a file, which may be why forces do not balance."""


class Obstacle(Assumption):
    """A note on an action on the grains that was not imported, which leaves any verdict undecided."""

    reason: str

    def __new__(cls, reason: str, about: str = "") -> Self:  # noqa: D102
        reason = reason.removeprefix(UNDECIDED)  # already in a copy, or in a note that a file repeats
        note = super().__new__(cls, f"{UNDECIDED}{reason}", about)
        note.reason = reason
        return note


class Account(str):
    """A note on all names that a reader found, in the three groups of `known`."""

    groups: dict[str, list[str]]

    @classmethod
    def of(cls, *parts: dict[str, list[str]]) -> "Account":
        """Combine the names of several parts, by group, into one note."""
        groups = {
            group: list(dict.fromkeys(name for part in parts for name in part.get(group, ())))
            for group in (USED, HARMLESS, UNKNOWN)
        }
        note = cls(f"met: {', '.join(f'{len(names)} {group}' for group, names in groups.items())} (--json lists them)")
        note.groups = groups
        return note


RENAMED = {"column of a dump": ", or, if `dump_modify colname` renamed it, give its name in LAMMPS"}


def account_for(
    kind: str, names: Iterable[str], what: str, known: Mapping[str, str] | None = None, plain: Callable = str
) -> list[str]:
    """Account of the contents of a file, and a note on each unknown part that may exert or change a force.

    Parameters
    ----------
    kind : kind of the names; the table of `known` for this kind contains them in the form that `plain` returns
    known : groups of names known to the reader
    """
    groups: dict[str, list[str]] = {}
    notes: list[str] = []
    for name in dict.fromkeys(names):
        row = find_row(kind, plain(name))
        group = (known or {}).get(name, row.group)
        groups.setdefault(group, []).append(f"{kind} {name}")
        if group == UNKNOWN:
            word = kind.partition(" ")[0]
            why = row.why or f"remove the {word} if it has no influence on forces{RENAMED.get(kind, '')}"
            notes.append(Obstacle(f"{word} {name} of {what} is unknown: {why}"))
    return [Account.of(groups), *notes]


def with_one_account(notes: list[str]) -> list[str]:
    """Notes in which a single account of all names that readers found replaces all accounts."""
    parts = [note.groups for note in notes if isinstance(note, Account)]
    rest = [note for note in dict.fromkeys(notes) if not isinstance(note, Account)]
    return [*rest, Account.of(*parts)] if parts else rest


def account_of(notes) -> dict[str, list[str]]:
    """Names that readers found, by group; empty if they kept no account."""
    return next((note.groups for note in notes if isinstance(note, Account)), {})


class MemoryNote(Note):
    """A note on the memory of contacts, made for every frame of a series."""


class NoMemory(MemoryNote, Assumption):
    """A note on contacts without memory."""


KINDS = {kind.__name__: kind for kind in (Assumption, Absent, Obstacle, NoMemory)}  # classes of notes in files


def stored_note(note: str) -> str:
    """Line of a file for an assumption: its class, its subject and its sentence, separated by tabs."""
    about = note.about if isinstance(note, Note) else ""
    return "\t".join((type(note).__name__, about, " ".join(note.split())))


def repeated_note(line: str) -> Assumption:
    """Note from a line of a file; files of version 0.3 have only its sentence, whose beginning identifies its class."""
    kind, about, text = line.split("\t", 2) if line.count("\t") >= 2 else ("", "", line)
    text = printable(text)
    if not kind:
        kind = Obstacle.__name__ if text.startswith(UNDECIDED) else ""
        about = LAW if text.startswith((NO_LAW, FORMER_NO_LAW)) else ""
    return KINDS.get(kind, Assumption)(text, about)


NO_CONTACTS = NoMemory("contacts were found from positions, without memory (zero slip)")


def law_note(law: Law) -> Assumption:
    """Return the note that no law was given and the default law is assumed."""
    return Assumption(f"{NO_LAW}: the defaults are assumed ({law_text(law)})", LAW)


def assumes_law(notes) -> bool:
    """Return True if the contact law was assumed."""
    return bool(notes_about(notes, LAW))


def notes_about(notes, *subjects: str) -> list[str]:
    """Notes about one of the given subjects."""
    return [note for note in notes if isinstance(note, Note) and note.about in subjects]


def law_text(law: Law) -> str:
    """Describe a law in one line."""
    return " ".join(repr(law).removeprefix("Law: ").split())


class PackingWarning(UserWarning):
    """Issued if part of a packing was changed or is missing, although the packing is still usable."""


@checked
def from_arrays(
    position, radius, law: Law, *, mass=None, density=None, cell=None, periodic=None, pair_i=None, pair_j=None,
    image=None, slip=None, mode=None, velocity=None, spin=None, angle=None, external_force=None, dim: int = 3, i0=None,
) -> State:  # fmt: skip
    """Accepted state from arrays, with r_ij = r_i − r_j + cellᵀ·image.

    Parameters
    ----------
    position : (N, 3) [length]; radius : (N,) [length]
    mass : float or (N,) [mass], default 1; or density : float or (N,), mass over the volume of a sphere, or over the
        area of a disk [mass/length^dim]
    law : Law, which limits the slip
    cell : (3, 3) box vectors as rows, sheared or not [length]; without it, nothing is periodic
    periodic : (3,) bool, default all (in two dimensions all but z)
    pair_i, pair_j : (M,) integers from 0, each pair once; exchanging i and j flips the signs of image and slip. By
        default, contacts are found from positions, with zero slip
    image : (M, 3) integers, default zero; slip : (M, 3) [length], default zero
    mode : (M,) 1 for sticking contacts, 2 for sliding ones. The slip of a sliding contact is set to the Coulomb limit
        if it is beyond the limit or within 0.1 % of it (a contact further below it slid under another law). By default,
        the slip determines the mode; for a contact at its limit, the result depends on round-off
    velocity : (N, 3) [length/time]; spin : (N, 3) [rad/time]; angle : (N, 3) [rad]; default zero
    external_force : (N, 3) [force]
    dim : 2 or 3; with 2, all vectors may have two components
    i0 : float or (N,), factor in the moment of inertia i0 m R², default 2/5, or 1/2 in two dimensions

    Raises
    ------
    PackingError
        If the arrays cannot be used.

    Warns
    -----
    PackingWarning
        if slip was projected or truncated, or touching pairs are not in the list.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> pair.contacts.mode[:1]
    array([1], dtype=int8)
    """
    if dim not in (2, 3):
        raise PackingError(f"dim must be 2 or 3, got {dim}")
    given = {
        "position": position, "radius": radius, "mass": mass, "cell": cell, "image": image, "slip": slip,
        "velocity": velocity, "spin": spin, "angle": angle, "external_force": external_force, "i0": i0,
        "density": density, "periodic": periodic, "mode": mode, "pair_i": pair_i, "pair_j": pair_j,
    }  # fmt: skip
    for name, rows in given.items():
        try:
            np.shape(rows)
        except ValueError:
            raise PackingError(f"{name} has rows of different lengths: give an array of numbers") from None
        if np.ma.is_masked(rows):
            raise PackingError(f"{name} has masked entries: leave them out")
    if dim == 3 and np.ndim(position) == 2 and np.shape(position)[1] == 2:
        raise PackingError("position has shape (N, 2), without z: give dim=2 for disks")
    if density is not None and mass is not None:
        raise PackingError("mass and density exclude each other: give one")
    if density is not None:
        size = _check_array("radius", radius, (None,))
        density = _check_array("density", density, () if np.ndim(density) == 0 else (len(size),))
        if not (density > 0).all():
            raise PackingError(f"density must be positive, got {density.min():g}")
        mass = density * (np.pi * size**2 if dim == 2 else 4 / 3 * np.pi * size**3)
    mass = 1.0 if mass is None else mass
    motion = {"velocity": velocity, "spin": spin, "angle": angle}
    if dim == 2:
        position, image, slip, external_force = map(_padded, (position, image, slip, external_force))
        motion["velocity"] = _padded(velocity)
    state = _build_state(position, radius, mass, motion, _build_cell(cell, periodic, dim), external_force, i0)
    if dim == 2 and slip is not None and np.any(np.asarray(slip)[..., 2:]):
        raise PackingError("position or slip leaves the plane although dim is 2: z must be zero")
    if pair_i is not None or pair_j is not None:
        state = _with_contacts(with_neighbor_list(state, law), law, pair_i, pair_j, image, slip, mode)
    elif image is not None or slip is not None or mode is not None:
        raise PackingError("image, slip and mode require pair_i and pair_j")
    return accepted(state, law, modes=mode is not None)


def _build_state(position, radius, mass, motion: dict, cell, force, i0) -> State:
    """State without memory, with its box and overlaps checked."""
    position, radius = _check_array("position", position, (None, 3)), _check_array("radius", radius, (None,))
    n, dim = len(position), cell.dim
    if len(radius) != n:
        raise PackingError(f"radius has {len(radius)} entries for {n} positions: give one for each grain")
    if dim == 2 and position[:, 2].any():
        raise PackingError("position or slip leaves the plane although dim is 2: z must be zero")
    rest = {name: _check_array(name, value, (n, 3)) for name, value in motion.items() if value is not None}
    mass = _check_array("mass", np.broadcast_to(mass, (n,)) if np.ndim(mass) == 0 else mass, (n,))
    force = 0.0 if force is None else _check_array("external_force", force, (n, 3))
    if i0 is not None:
        rest["i0"] = _check_array("i0", i0, () if np.ndim(i0) == 0 else (n,))
    with refusing():
        grains = (disks if dim == 2 else spheres)(position, radius, mass=mass, **rest)
        state = assembly(grains, cell=cell, control=loads(n, force=force))
    height, largest = grid_of(state.cell).height, 2 * float(state.grains.radius.max())
    for k in np.flatnonzero(state.cell.periodic):
        if height[k] < largest:
            raise PackingError(
                f"the box is {height[k]:.4g} wide across its vector {k}, less than the diameter of the largest grain "
                f"({largest:.4g}): replicate it until it is wider"
            )
    state = with_neighbor_list(state)
    contacts, count = state.contacts, int(state.contacts.count[0])
    i, j = contacts.i[:count], contacts.j[:count]
    overlap = overlaps(state)
    share = overlap / np.minimum(radius[i], radius[j])
    if count and share.max() > 1:
        c = int(share.argmax())
        raise PackingError(
            f"grains {i[c]} and {j[c]} overlap by {overlap[c]:.4g}, more than a radius, where no contact law is "
            "valid: check positions, radii and cell"
        )
    return state


def law_by_name(
    law="hertz_mindlin", coulomb="smooth", kn=None, kt=None, mu=10.0, *, young=None, poisson=None, damping=None, **more,
) -> Law:  # fmt: skip
    """Contact law by name.

    Parameters
    ----------
    kn, kt : default 1 and 2/7; or `young` and `poisson` of identical elastic grains, see `elastic_constants`
    damping : model of damping, default that of the law
    more : `damping_n`, `damping_t`, `tension`, and parameters that only this law has, such as `work`

    Raises
    ------
    PackingError
        If a name is unknown, or parameters are missing or inconsistent.

    Examples
    --------
    >>> law_by_name("jkr", "sharp", mu=0.5, work=1e-3)
    Law: jkr, sharp Coulomb, kn = 1, kt = 0.285714, mu = 0.5, work = 0.001
    """
    for name, value, known in (("law", law, LAWS), ("coulomb", coulomb, COULOMB), ("damping", damping, DAMPING)):
        if not (isinstance(value, str) and value in known) and not (name == "damping" and value is None):
            raise PackingError(f"{name} must be {' or '.join(known)}, got {value!r}")
    if (young is None) != (poisson is None):
        raise PackingError("young and poisson must be given together: give both, or kn and kt")
    if young is not None and (not BY_NAME[law].uses_radius or kn is not None or kt is not None):
        raise PackingError("young and poisson replace kn and kt of hertz_mindlin_reff: give them only with that law")
    needed = {p.name: f"{p.words} [{p.unit}]" for p in BY_NAME[law].parameters}
    extra = {*more} - {"damping_n", "damping_t", "tension"}
    for name in sorted({*needed} - extra):
        raise PackingError(f"{law} needs {name}, {needed[name]}: give it (--parameter {name}=…)")
    for name in sorted(extra - {*needed}):
        raise PackingError(f"{law} has no parameter {name}: it has {', '.join((*PARAMETERS, *needed))}")
    model = {} if damping is None else {"damping": damping}
    with refusing(str, TypeError):
        if young is not None:
            kn, kt = elastic_constants(young, poisson)
        kn, kt = 1.0 if kn is None else kn, 2 / 7 if kt is None else kt
        return LAWS[law](kn, kt, mu, coulomb=coulomb, **model, **more)


def _check_array(name: str, value, shape: tuple, kind=float) -> np.ndarray:
    try:
        array = np.asarray(value)
        if array.dtype.kind in "cmM":
            raise TypeError
        if kind is int and array.dtype.kind == "f" and not ((array == np.round(array)) & (abs(array) < 2**53)).all():
            raise TypeError
        array = array.astype(np.int64 if kind is int else kind)
    except (TypeError, ValueError):
        what = "integers" if kind is int else "numbers"
        raise PackingError(f"{name} contains entries that are not {what}: give an array of {what}") from None
    good = len(array.shape) == len(shape) and all(w is None or w == g for w, g in zip(shape, array.shape, strict=True))
    if not good:
        wanted = "(" + ", ".join("any" if w is None else str(w) for w in shape) + ("," if len(shape) == 1 else "") + ")"
        raise PackingError(f"{name} has shape {array.shape}: {wanted} is needed")
    if kind is float and not np.isfinite(array).all():
        raise PackingError(f"{name} contains NaN or infinity: every entry must be a finite number")
    if kind is float and (np.abs(array) > HUGE).any():
        raise PackingError(f"{name} contains {np.abs(array).max():.3g}, which exceeds {HUGE:g}: use other units")
    return array


def _padded(rows):
    """Append a zero component to rows of two components; return anything else unchanged."""
    if rows is None or np.ndim(rows) != 2 or np.shape(rows)[1] != 2:
        return rows
    return np.pad(np.asarray(rows), ((0, 0), (0, 1)))


def _build_cell(cell, periodic, dim: int):
    if cell is None:
        if periodic is not None and np.any(periodic):
            raise PackingError("periodic requires a cell: give the box vectors as rows of cell")
        return box(dim=dim)
    if dim == 2 and np.shape(cell) in ((2,), (2, 2)):
        cell = np.diag([*cell, 1.0]) if np.ndim(cell) == 1 else np.vstack([_padded(cell), [0.0, 0.0, 1.0]])
    cell = _check_array("cell", np.diag(cell) if np.shape(cell) == (3,) else cell, (3, 3))
    short = np.linalg.norm(cell, axis=1).min()
    if short < 1 / HUGE:
        raise PackingError(f"the cell has a vector of length {short:.3g}: give three vectors that span the box")
    flags = [True, True, dim == 3] if periodic is None else _check_array("periodic", periodic, (3,), bool)
    if dim == 2:
        if cell[2, :2].any() or cell[:2, 2].any():
            raise PackingError(
                "cell leaves the plane although dim is 2: its third row must be along z, the others in the plane"
            )
        flags = [bool(flags[0]), bool(flags[1]), False]
    return box(cell, flags, dim)


def _with_contacts(state: State, law: Law, pair_i, pair_j, image, slip, mode) -> State:
    """State with a given list of contacts and their slip, which is not yet projected onto the contact plane."""
    if pair_i is None or pair_j is None:
        raise PackingError("pair_i and pair_j must be given together")
    n = len(state.grains.radius)
    i = _check_array("pair_i", pair_i, (None,), int)
    m = len(i)
    j = _check_array("pair_j", pair_j, (m,), int)
    image = np.zeros((m, 3), int) if image is None else _check_array("image", image, (m, 3), int)
    slip = np.zeros((m, 3)) if slip is None else _check_array("slip", slip, (m, 3))
    mode = np.full(m, STICK) if mode is None else _check_array("mode", mode, (m,), int)
    if not np.isin(mode, (STICK, SLIDE)).all():
        raise PackingError("mode must be 1 for sticking and 2 for sliding contacts, but has other values")
    if m and not (min(i.min(), j.min()) >= 0 and max(i.max(), j.max()) < n):
        raise PackingError(f"pairs name grains {min(i.min(), j.min())} to {max(i.max(), j.max())}: use 0 to {n - 1}")
    if np.abs(image).max(initial=0) > 60:
        raise PackingError("images must be within 60 boxes: shift positions by whole boxes")
    lead = np.take_along_axis(image, np.argmax(image != 0, axis=1)[:, None], axis=1)[:, 0] if m else np.zeros(0)
    flip = (i > j) | ((i == j) & (lead < 0))
    i, j = np.where(flip, j, i), np.where(flip, i, j)
    image, slip = np.where(flip[:, None], -image, image), np.where(flip[:, None], -slip, slip)
    key = pack_keys(i, j, image)
    order = np.argsort(key, kind="stable")
    alone = np.flatnonzero((i == j) & ~image.any(axis=1))
    if len(alone):
        raise PackingError(f"pair {alone[0]} joins grain {i[alone[0]]} with itself: it needs an image other than zero")
    twice = order[1:][np.diff(key[order]) == 0]
    if len(twice):
        c = int(twice[0])
        raise PackingError(
            f"the pair of grains {i[c]} and {j[c]} with image {image[c].tolist()} is given twice: give each pair once"
        )
    contacts, count = state.contacts, int(state.contacts.count[0])
    row = np.searchsorted(contacts.key[:count], key)
    there = row < count
    there[there] = contacts.key[row[there]] == key[there]
    copied = {name: getattr(contacts, name).copy() for name in ("slip", "mode", "pair", "roll")}
    new, turned = contacts._replace(**copied), state.grains.radius[:, None] * state.grains.angle
    branch = branch_vectors(state)
    reach = state.grains.radius[contacts.i[:count]] + state.grains.radius[contacts.j[:count]]
    touches = np.linalg.norm(branch, axis=1) < reach
    if bridges_gaps(law.kind):
        listed = contacts._replace(mode=contacts.mode.copy())  # bonds across gaps exist if they are listed
        listed.mode[row[there]] = mode[there]
        touches = forces(state._replace(contacts=listed), law)[1].mode[:count] != OPEN
    there[there] = touches[row[there]]
    lost = ~there & slip.any(axis=1)
    if lost.any():
        c = int(np.flatnonzero(lost)[0])
        raise PackingError(
            f"grains {i[c]} and {j[c]} with image {image[c].tolist()} have slip but do not touch: check the sign of "
            f"the image, r_ij = r_i - r_j + cell^T image"
        )
    new.slip[row[there]], new.mode[row[there]], new.pair[row[there]] = slip[there], mode[there], branch[row[there]]
    new.roll[row[there]] = turned[i[there]] + turned[j[there]]
    missing = int((touches & (new.mode[:count] == OPEN)).sum())
    if missing:
        message = f"{pluralize(missing, 'touching pair')} not in the list: assumed to have zero slip"
        warnings.warn(message, PackingWarning, stacklevel=3)
    return state._replace(contacts=new)


def accepted(state: State, law: Law, *, memory: int = FREE, modes: bool = False, within: float = AT_LIMIT) -> State:
    """State with its memory committed: slip perpendicular to the normal and within the Coulomb limit.

    Parameters
    ----------
    memory : as in `forces`; FROZEN leaves contacts unchanged where nothing has moved
    modes : if True, keep the given modes: slip of sliding contacts near the Coulomb limit is set to the limit, and
        slip of sticking contacts is truncated there
    within : relative distance to the limit that counts as near

    Raises
    ------
    PackingError
        If a slip is unreasonably long.
    """
    state = with_neighbor_list(state, law)
    count = int(state.contacts.count[0])
    longest = np.abs(state.contacts.slip[:count]).max(initial=0.0)
    if longest > HUGE:
        raise PackingError(f"slip must be at most {HUGE:g}, got {longest:.3g}; the file may be damaged")
    _, trial = forces(state, law, memory=memory if memory == FROZEN else memory | GIVEN)
    branch = branch_vectors(state)
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    slip = np.where(trial.mode[:count, None] != OPEN, state.contacts.slip[:count], 0.0)
    along = np.einsum("ck,ck->c", slip, normal)
    size, most = np.linalg.norm(slip, axis=1).max(initial=0.0), np.abs(along).max(initial=0.0)
    if most > 1e-8 * size > 0:
        message = f"slip was projected onto the contact plane: its normal part was up to {most:.3g}"
        warnings.warn(f"{message}, {most / size:.2g} of the largest slip", PackingWarning, stacklevel=3)
    wanted = np.linalg.norm(slip - along[:, None] * normal, axis=1)
    cut = np.linalg.norm(trial.slip[:count], axis=1) < wanted * (1 - 1e-9)
    if modes:
        cut &= state.contacts.mode[:count] != SLIDE
        # copy modes, and the limiting slip of sliding contacts, to trial memory, except where slip was cut; a contact
        # marked as sliding far below the limit slid under another law, such as one without friction: its slip
        # determines its mode
        given = state.contacts.mode
        _, held = forces(state, law, memory=HELD | GIVEN)
        size, limit = (np.linalg.norm(contacts.slip[:count], axis=1) for contacts in (trial, held))
        elsewhere = (given[:count] == SLIDE) & ((size < (1 - within) * limit) | (limit == 0))
        rows = np.flatnonzero((given[:count] != OPEN) & (trial.mode[:count] != OPEN) & ~cut & ~elsewhere)
        trial.mode[rows] = given[rows]
        rows = rows[given[rows] == SLIDE]
        trial.slip[rows] = held.slip[rows]
        trial.reached[rows] = True
    if cut.any():
        message = f"slip beyond the Coulomb limit at {pluralize(int(cut.sum()), 'contact')}: truncated at the limit"
        warnings.warn(message, PackingWarning, stacklevel=3)
    return accept(state, trial)
