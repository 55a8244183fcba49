"""Validation of states and laws from files: compiled code does not check indices."""

import numpy as np

from ..builtin_laws import NAMES
from ..core.contacts.neighbors import pack_keys
from ..core.contacts.rolling import WIDTH
from ..core.laws.builtin import COULOMB, DAMPING, NO_TENSION, Law, parameter_names
from ..core.laws.dispatch import Kind
from ..core.state import OPEN, SLIDE, STICK, Cell, Contacts, Control, Grains, Instant, State, Walls

# types and shapes of entries, for n grains, w walls, b bodies, c contacts and k knots; None: any size
_FLOAT, _WHOLE, _BOOL = "f", "iu", "b"
_SHAPES = {
    Grains: {
        **dict.fromkeys(("position", "angle", "velocity", "spin"), (_FLOAT, "n", 3)),
        **dict.fromkeys(("radius", "mass", "inertia"), (_FLOAT, "n")),
        "material": (_WHOLE, "n"),
    },
    Walls: {
        **dict.fromkeys(("point", "normal", "velocity"), (_FLOAT, "w", 3)),
        "mass": (_FLOAT, "w"),
        "material": (_WHOLE, "w"),
    },
    Cell: {"vectors": (_FLOAT, 3, 3), "periodic": (_BOOL, 3), "rate": (_FLOAT, 3, 3)},
    Contacts: {
        **dict.fromkeys(("i", "j", "key", "mode"), (_WHOLE, "c")),
        **dict.fromkeys(("slip", "pair", "roll"), (_FLOAT, "c", 3)),
        "image": (_WHOLE, "c", 3),
        "reached": (_BOOL, "c"),
        "origin": (_FLOAT, "b", 3),
        "count": (_WHOLE, 1),
        "rolling": (_FLOAT, "c", WIDTH),
    },
    Control: {
        **dict.fromkeys(("force", "torque", "spring", "anchor"), (_FLOAT, "b", 3)),
        **dict.fromkeys(("cell_rate", "stress"), (_FLOAT, 3, 3)),
        "free": (_BOOL, "b", 6),
        "rate": (_FLOAT, "b", 6),
        "gravity": (_FLOAT, 3),
        "group": (_WHOLE, "b"),
        "cell_free": (_BOOL, 3, 3),
        "knots": (_FLOAT, "k"),
        "course": (_FLOAT, "k", None),
        "follows": (_WHOLE, "b", 6),
        "cell_follows": (_WHOLE, 3, 3),
        "leads": (_WHOLE, "b", 3),
    },
    Instant: {"force": (_FLOAT, "b", 6), "pull": (_FLOAT, 3, 3)},
}


def restore_contacts(fields: dict) -> Contacts:
    """Contact list from its fields in a file.

    Up to schema 4 of archives, and schema 1 of GSD files, the skin was an array, the gap its second entry, infinite
    positions meant a stale list, and a law without rolling memory had an array without rows.
    """
    fields = {name: v.item() if isinstance(v, np.ndarray) and not v.ndim else v for name, v in fields.items()}
    if "stale" not in fields:
        skin, known = np.atleast_1d(fields["skin"]), np.isfinite(fields["origin"])
        fields |= {"skin": float(skin[0]), "gap": float(skin[1:].sum()), "stale": not known.all()}
        fields["origin"] = np.where(known, fields["origin"], 0.0)
        if not len(fields.get("rolling", ())):
            fields["rolling"] = None
    return Contacts(**fields)


def validate_state(state: State) -> State:
    """Return the state if all of its arrays have valid shapes and types and all of its indices are in range.

    Raises
    ------
    ValueError
        with one sentence that names the invalid entry.
    """
    nouns = {Grains: state.grains, Walls: state.walls, Cell: state.cell, Control: state.control}
    nouns |= {Contacts: state.contacts} | ({Instant: state.instant} if state.instant is not None else {})
    for kind, noun in nouns.items():
        if not isinstance(noun, kind):
            raise ValueError(f"a state without {kind.__name__.lower()}")
    sizes = {name: len(np.atleast_1d(array)) for name, array in (
        ("n", state.grains.radius), ("w", state.walls.mass), ("c", state.contacts.i), ("k", state.control.knots),
    )}  # fmt: skip
    sizes["b"] = sizes["n"] + sizes["w"]
    for kind, noun in nouns.items():
        for name, (types, *shape) in _SHAPES[kind].items():
            value, wanted = getattr(noun, name), [sizes.get(s, s) for s in shape]
            if value is not None or name != "rolling":
                _check_array(f"{kind.__name__.lower()}.{name}", value, types, wanted)
    if state.cell.dim not in (2, 3):
        raise ValueError(f"a cell of {state.cell.dim} dimensions")
    _check_indices(state)
    return state


def validate_law(law: Law) -> Law:
    """Return the law if compiled code knows its kinds and its table has a valid shape and finite numbers.

    Raises
    ------
    ValueError
        with one sentence that names the invalid entry.
    """
    dampings = [model + more for model in DAMPING.values() for more in (0, NO_TENSION)]
    entries = {"kind": range(len(NAMES)), "coulomb": COULOMB.values(), "damping": dampings}
    for name, known in entries.items():
        value = getattr(law, name)
        if not (isinstance(value, int | np.integer) and value in known) and not isinstance(value, Kind):
            raise ValueError(f"law.{name} is {value!r}")
    materials = len(np.atleast_1d(law.table))
    _check_array("law.table", law.table, _FLOAT, [materials, materials, len(parameter_names(law))])
    if not np.isfinite(law.table).all():
        raise ValueError("law.table contains entries that are not finite")
    return law


def _check_array(name: str, array, types: str, shape: list) -> None:
    if not isinstance(array, np.ndarray) or array.dtype.kind not in types:
        raise ValueError(f"{name} has type {getattr(array, 'dtype', type(array).__name__)}")
    if array.ndim != len(shape) or any(s not in (None, got) for s, got in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if s is None else str(s) for s in shape)
        got = ", ".join(map(str, array.shape))
        raise ValueError(f"{name} has shape [{got}] where [{wanted}] is needed")


def _check_indices(state: State) -> None:
    contacts, control, n, bodies = state.contacts, state.control, len(state.grains.radius), state.n_bodies
    columns = control.course.shape[1]
    bounds = {
        "contacts.count": (contacts.count, len(contacts.i), len(contacts.i)),
        "contacts.i": (contacts.i, 0, n - 1),
        "contacts.j": (contacts.j, 0, bodies - 1),
        "contacts.mode": (contacts.mode, min(OPEN, STICK, SLIDE), max(OPEN, STICK, SLIDE)),
        "grains.material": (state.grains.material, 0, None),
        "walls.material": (state.walls.material, 0, None),
        "control.group": (control.group, -1, bodies),
        "control.follows": (control.follows, -1, columns - 1),
        "control.cell_follows": (control.cell_follows, -1, columns - 1),
        "control.leads": (control.leads, -1, columns - 1),
    }
    for name, (array, low, high) in bounds.items():
        if array.size and (array.min() < low or (high is not None and array.max() > high)):
            raise ValueError(f"{name} has values from {array.min()} to {array.max()}, outside {low} to {high}")
    for name, kind in (("skin", float), ("gap", float), ("stale", bool)):
        if not isinstance(getattr(contacts, name), kind):
            raise ValueError(f"contacts.{name} has type {type(getattr(contacts, name)).__name__}")
    if not np.array_equal(pack_keys(contacts), contacts.key) or (np.diff(contacts.key) <= 0).any():
        raise ValueError("contacts are not sorted, or their keys do not match them")
