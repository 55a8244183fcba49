"""What a folder of results holds, as an xarray dataset with units: states by frame, contacts as ragged arrays, tables.

Contacts of all frames stand one after the other along the dimension `contact`, those that touch, and `contact_count`
says how many each frame has: CF's contiguous ragged array.
"""

from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from ..core.laws import Law
from ..core.measure import contact_forces, touching
from ..core.state import OPEN, SLIDE, STICK, State
from . import archive
from .kept import SWEEP, UNFINISHED
from .sweep_data import is_sweep, open_sweep
from .units import unit_of

RESULTS = "results.h5"
_AXES = {"axis": ["x", "y", "z"]}
_GRAINS = ("position", "angle", "velocity", "spin", "radius", "mass", "inertia", "material")
_WALLS = ("point", "normal", "velocity", "mass", "material")
_PAIRS = ("i", "j", "image", "slip", "mode")
MODES = {OPEN: "open", STICK: "stick", SLIDE: "slide"}


def open(place: str | Path) -> xr.Dataset:
    """Results of a run, of a sweep, or what an unfinished run has kept so far.

    Dimensions are `frame` (by name, in order), `grain`, `wall`, `axis` (x, y, z), `contact` (ragged, see
    `contact_table`) and one for each table of numbers, such as `series`. A variable `series.friction` is the entry
    `friction` of the group `series`. Units are in the attribute `units`, as dimensions where the scenario has units of
    its own. The scenario's text and versions are attributes of the dataset.

    Parameters
    ----------
    place : the folder that `--out` named, or a file results.h5

    Raises
    ------
    ValueError
        with one sentence, if there are no results, or they cannot be read.

    Examples
    --------
    >>> import stickslip
    >>> stickslip.open("results/column").position.sel(axis="y").max("grain")  # doctest: +SKIP
    """
    path = Path(place)
    if is_sweep(path):
        return open_sweep(path)
    if (path / SWEEP).is_file():
        raise ValueError(
            f"{path} holds a sweep that was stopped: stickslip resume {path} goes on, and ends in a dataset"
        )
    if path.is_dir() and not (path / RESULTS).is_file():
        return _unfinished(path)
    path = path / RESULTS if path.is_dir() else path
    if not path.is_file():
        raise ValueError(f"{path} does not exist: give the folder of a run, or its results.h5")
    tree, about, units = archive.read(path), archive.attributes(path), archive.units(path)
    return _dataset(tree, units).assign_attrs(about)


def contact_table(data: xr.Dataset, frame) -> pd.DataFrame:
    """Contacts of one frame, a row for each that touches.

    Columns are `i` and `j` (grains, and walls from the number of grains on), image_x …, slip_x … [length], `mode`
    (stick or slide), and, where the law is known, force_x … on `i` [force], without dashpots.

    Parameters
    ----------
    data : what `open` gives
    frame : name of a frame, or its number

    Raises
    ------
    ValueError
        if there is no such frame.
    """
    if "contact_count" not in data:
        raise ValueError("the dataset has no contacts: open the folder of a run that keeps states")
    names = [str(name) for name in data.frame.values]
    if str(frame) not in names and not (isinstance(frame, int | np.integer) and -len(names) <= frame < len(names)):
        some = ", ".join(names[:4]) + (" …" if len(names) > 4 else "")
        raise ValueError(
            f"frame {frame!r} was asked for: the dataset has {some}, or numbers from 0 to {len(names) - 1}"
        )
    number = names.index(str(frame)) if str(frame) in names else range(len(names))[frame]
    ends = np.cumsum(data.contact_count.values)
    rows = slice(ends[number] - int(data.contact_count[number]), ends[number])
    columns = {}
    for name in ("i", "j", "image", "slip", "mode", "force"):
        if (variable := f"contact_{name}") in data:
            values = data[variable].values[rows]
            columns |= (
                {name: values} if values.ndim == 1 else {f"{name}_{a}": values[:, k] for k, a in enumerate("xyz")}
            )
    columns["mode"] = pd.Series(columns["mode"]).map(MODES)
    return pd.DataFrame(columns)


def _unfinished(folder: Path) -> xr.Dataset:
    """Pieces that a run has kept so far."""
    paths = sorted((folder / UNFINISHED).rglob("*.h5")) if (folder / UNFINISHED).is_dir() else []
    paths = [path for path in paths if not path.name.startswith(".")]
    if not paths:
        raise ValueError(f"{folder} holds no results: give the folder of a run, or its results.h5")
    names = [str(path.relative_to(folder / UNFINISHED).with_suffix("")) for path in paths]
    tree = {name: archive.read(path)["piece"] for name, path in zip(names, paths, strict=True)}
    units = {
        f"{name}/{inner.removeprefix('piece/')}": unit
        for name, path in zip(names, paths, strict=True)
        for inner, unit in archive.units(path).items()
    }
    return _dataset(tree, units).assign_attrs(archive.attributes(paths[0]) | {"finished": "no"})


def _dataset(tree: dict, units: dict[str, str]) -> xr.Dataset:
    states, tables, laws = {}, {}, {}
    _gathered(tree, "", tree.get("law"), states, tables, laws)
    states = {name: state for name, state in states.items() if len(state.grains.radius) == _most(states)}
    variables = _frames(states, laws, units, _wall_rows(tree, states)) if states else {}
    for group, entries in tables.items():
        variables |= _table(group, entries, units)
    names = list(states)
    if len({name.rpartition("/")[0] for name in names}) == 1:
        names = [name.rpartition("/")[2] for name in names]
    out = xr.Dataset(variables, {"frame": names} | _AXES if states else {})
    return out.assign_attrs(units_of_scenario=tree["units"]) if isinstance(tree.get("units"), str) else out


def _most(states: dict[str, State]) -> int:
    """The number of grains that most states have."""
    return Counter(len(state.grains.radius) for state in states.values()).most_common(1)[0][0]


def _gathered(tree, above: str, law, states: dict, tables: dict, laws: dict) -> None:
    """Sort a tree into states with their laws, and tables of arrays and numbers by the path of their group."""
    law = tree.get("law", law) if isinstance(tree, dict) else law
    items = tree.items() if isinstance(tree, dict) else ((f"{k:06d}", item) for k, item in enumerate(tree))
    for name, value in items:
        path = f"{above}{name}"
        if isinstance(value, State):
            states[path], laws[path] = value, law
        elif isinstance(value, dict | tuple | list) and not isinstance(value, Law):
            _gathered(value._asdict() if hasattr(value, "_asdict") else value, f"{path}/", law, states, tables, laws)
        elif isinstance(value, np.ndarray | int | float | complex) and not isinstance(value, Law):
            tables.setdefault(above, {})[name] = np.asarray(value)


def _wall_rows(tree: dict, states: dict[str, State]) -> dict[str, np.ndarray]:
    """Which wall of the whole run each wall of a state is: others may have been removed before it."""
    names = tree["walls"].split("\n") if isinstance(tree.get("walls"), str) else []
    left = tree.get("frame_walls", {})
    out = {}
    for path, state in states.items():
        mine = left.get(path.rpartition("/")[2], "").split("\n")
        known = len(mine) == len(state.walls.mass) and set(mine) <= set(names)
        out[path] = np.array([names.index(name) for name in mine] if known else range(len(state.walls.mass)), int)
    return out


def _frames(states: dict[str, State], laws: dict, units: dict, walls: dict[str, np.ndarray]) -> dict:
    """Variables of states."""
    first, many = next(iter(states)), list(states.values())

    def unit(noun, name):
        found = units.get(f"{first}/{noun}/{name}" if noun else f"{first}/{name}", unit_of(name))
        return {"units": found} if found else {}

    out = {"time": ("frame", np.array([state.time for state in many]), unit("", "time"))}
    for name in _GRAINS:
        values = np.stack([getattr(state.grains, name) for state in many])
        out[name] = (("frame", "grain", "axis")[: values.ndim], values, unit("grains", name))
    if most := max(len(state.walls.mass) for state in many):
        for name in _WALLS:
            values = np.stack([_placed(getattr(s.walls, name), walls[path], most) for path, s in states.items()])
            out[f"wall_{name}"] = (("frame", "wall", "axis")[: values.ndim], values, unit("walls", name))
    out["cell"] = (("frame", "vector", "axis"), np.stack([s.cell.vectors for s in many]), unit("cell", "vectors"))
    return out | _contacts(states, laws, unit, walls)


def _placed(values: np.ndarray, rows: np.ndarray, number: int) -> np.ndarray:
    """Rows of walls, NaN for those that are gone."""
    out = np.full((number, *values.shape[1:]), np.nan)
    out[rows] = values
    return out


def _contacts(states: dict[str, State], laws: dict, unit, walls: dict[str, np.ndarray]) -> dict:
    """Variables of all contacts that touch, frame after frame."""
    rows = [touching(state) for state in states.values()]
    counts = np.array([len(r) for r in rows])
    out = {"contact_count": ("frame", counts, {"sample_dimension": "contact"})}
    for name in _PAIRS:
        values = np.concatenate([getattr(s.contacts, name)[r] for s, r in zip(states.values(), rows, strict=True)])
        out[f"contact_{name}"] = (("contact", "axis")[: values.ndim], values, unit("contacts", name))
    for (path, state), ends in zip(states.items(), np.split(out["contact_j"][1], np.cumsum(counts)[:-1]), strict=True):
        n = len(state.grains.radius)
        at_wall = ends >= n
        ends[at_wall] = n + walls[path][ends[at_wall] - n]
    if all(laws[name] is not None for name in states):
        force = [
            contact_forces(state, laws[name])[r] if len(r) else np.zeros((0, 3))
            for (name, state), r in zip(states.items(), rows, strict=True)
        ]
        about = unit("control", "force") | {"long_name": "elastic force on i"}
        out["contact_force"] = (("contact", "axis"), np.concatenate(force), about)
    return out


def _table(group: str, entries: dict[str, np.ndarray], units: dict) -> dict:
    """Variables of a group, with a dimension of the group's name where they are as long as most of them."""
    lengths = Counter(len(values) for values in entries.values() if values.ndim)
    common = lengths.most_common(1)[0][0] if lengths else 0
    label, out = group.strip("/").replace("/", "."), {}
    for name, values in entries.items():
        if not values.size:
            continue
        variable, kind = f"{label}.{name}" if label else name, name.split("_")[0]
        dims = [f"{label}.{kind}" if k == 1 else f"{variable}.{k}" for k in range(values.ndim)]
        if values.ndim and len(values) == common and label:
            dims[0] = label
        if values.ndim > 1 and values.shape[-1] == 3:
            dims[-1] = "axis"
        found = units.get(f"{group}{name}", unit_of(name))
        out[variable] = (dims, values, {"units": found} if found else {})
    return out
