"""Results of a run as an xarray DataTree with units: states by frame, ragged arrays of contacts, and tables.

The touching contacts of all frames are concatenated along the dimension `contact`, and `contact_count` is their number
in each frame. The CF conventions call this format a contiguous ragged array.
"""

from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from ..core.arguments import checked
from ..core.fields import FIELDS
from ..core.laws.builtin import Law
from ..core.measure import contact_forces, touching
from ..core.state import OPEN, SLIDE, STICK, State
from ..data import archive
from ..data.archive import known_nouns, refuse_damage, restore, units_within
from ..data.checkpoint import read_pieces
from ..data.run_files import SWEEP, resume_command
from .sweep.dataset import is_sweep, open_sweep

RESULTS = "results.h5"
_ALONG = ("time", "strain", "load", "load_point", "slip")  # coordinate of a table: the first one that increases
_ACROSS = ("station", "depth")  # coordinate of the second dimension of a table, if the length fits
_AXES = {"axis": ["x", "y", "z"]}
_GRAINS, _WALLS = (tuple(FIELDS[part]) for part in ("grains", "walls"))
_PAIRS = ("i", "j", "image", "slip", "mode")
MODES = {OPEN: "open", STICK: "stick", SLIDE: "slide"}


@checked
def open_dataset(place: str | Path) -> xr.DataTree:
    """Open the results of a run or a sweep, or the parts saved so far by an unfinished run.

    The node `frames` holds the states: position, velocity, … along `time` (along `load` if the frames are those of a
    quasi-static path, otherwise along `frame`), and contacts as a ragged array (see `contact_table`). Every group of
    the archive, such as `series`, is a node of the same name. Its arrays have `time`, `strain` or `load` as their
    coordinate if that quantity increases. The attribute `units` contains SI units, or dimensions if the scenario
    defines its own units. The scenario's text and the versions are attributes of the root. The table of a sweep
    is the root's dataset; see `open_sweep`.

    Parameters
    ----------
    place : the folder given by `--out`, or a file results.h5

    Raises
    ------
    ValueError
        If there are no results or they cannot be read.

    Examples
    --------
    >>> import stickslip as ss
    >>> data = ss.io.open_dataset("results/column")  # doctest: +SKIP
    >>> data["frames"].position.sel(time=20, method="nearest")  # doctest: +SKIP
    >>> data["series"].kinetic_energy.plot()  # doctest: +SKIP
    """
    path = Path(place)
    if is_sweep(path):
        return xr.DataTree(open_sweep(path))
    if (path / SWEEP).is_file():
        raise ValueError(
            f"{path} contains an unfinished sweep: finish it with {resume_command(path)} to get its dataset"
        )
    if path.is_dir() and not (path / RESULTS).is_file():
        pieces, about = read_pieces(path)
        if not pieces:
            raise ValueError(f"{path} contains no results: give a run folder, or its results.h5")
        with refuse_damage(path, "results", "resume the run, which reports the damaged part"):
            tree = {name: restore(node, known_nouns(())) for name, node in pieces.items()}
        units = {f"{name}/{inner}": unit for name, node in pieces.items() for inner, unit in units_within(node).items()}
        return _build_tree(tree, units, about | {"finished": "no"})
    path = path / RESULTS if path.is_dir() else path
    if not path.is_file():
        raise ValueError(f"{path} does not exist: give a run folder, or its results.h5")
    tree, about, units = archive.read(path), archive.attributes(path), archive.units(path)
    return _build_tree(tree, units, about)


@checked
def contact_table(data: xr.DataTree | xr.Dataset, frame: int | str) -> pd.DataFrame:
    """Return the touching contacts of one frame as a table.

    Columns are `i` and `j` (walls are numbered after the grains), image_x …, slip_x … [length], `mode` (stick or slide)
    and, if the law is known, force_x … on `i` [force], without dashpots.

    Parameters
    ----------
    data : result of `open_dataset`, or its node `frames`
    frame : name or number of a frame

    Raises
    ------
    ValueError
        If there is no such frame.
    """
    data = data["frames"].to_dataset() if isinstance(data, xr.DataTree) and "frames" in data else data
    if "contact_count" not in data:
        raise ValueError("the dataset has no contacts: open a run folder with saved states")
    names = [str(name) for name in data.frame.values]
    if str(frame) not in names and not (isinstance(frame, int | np.integer) and -len(names) <= frame < len(names)):
        some = ", ".join(names[:4]) + (" …" if len(names) > 4 else "")
        raise ValueError(f"there is no frame {frame!r}: use {some}, or a number from 0 to {len(names) - 1}")
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


def _build_tree(tree: dict, units: dict[str, str], about: dict) -> xr.DataTree:
    """Build all nodes; a dimension that clashes with a parent node's dimension is prefixed with the node's name."""
    states, tables, laws = {}, {}, {}
    _collect(tree, "", tree.get("law"), states, tables, laws)
    sizes = Counter(len(state.grains.radius) for state in states.values()).most_common(1)  # usual number of grains
    states = {name: state for name, state in states.items() if len(state.grains.radius) == sizes[0][0]}
    nodes = {}
    if states:
        # indices of the walls of each state among those of the whole run, since some may have been removed
        walls, remaining = tree["walls"].split("\n") if isinstance(tree.get("walls"), str) else [], {}
        for path, state in states.items():
            mine = tree.get("frame_walls", {}).get(path.rpartition("/")[2], "").split("\n")
            known = len(mine) == len(state.walls.mass) and set(mine) <= set(walls)
            remaining[path] = np.array(list(map(walls.index, mine)) if known else range(len(state.walls.mass)), int)
        nodes["frames"] = _frame_node(states, _frame_variables(states, laws, units, remaining))
    for group, entries in tables.items():
        node = _group_dataset(group, entries, units)
        if node.variables:
            nodes[group.strip("/") or "numbers"] = node
    for path, node in nodes.items():
        parts = path.split("/")
        above = [nodes[name] for k in range(1, len(parts)) if (name := "/".join(parts[:k])) in nodes]
        taken = {dim for other in above for dim in other.dims} & set(node.dims) - {"axis"}
        nodes[path] = node.rename({dim: f"{parts[-1]}_{dim}" for dim in taken})
    attributes = {"units_of_scenario": tree["units"]} if isinstance(tree.get("units"), str) else {}
    root = xr.Dataset(coords=_AXES, attrs=about | attributes)
    return xr.DataTree.from_dict({"/": root} | {f"/{path}": node for path, node in nodes.items()})


def _frame_node(states: dict[str, State], variables: dict) -> xr.Dataset:
    """Build the node of states, along `time` if it increases, or along `load` if the names are increasing loads."""
    names = list(states)
    if len({name.rpartition("/")[0] for name in names}) == 1:
        names = [name.rpartition("/")[2] for name in names]
    time = np.array([state.time for state in states.values()])
    if (np.diff(time) > 0).all() and len(time) > 1:
        node = xr.Dataset(variables).swap_dims(frame="time").set_coords("time")
        return node.assign_coords(frame=("time", names))
    with suppress(ValueError):
        loads = np.array([float(name) for name in names])
        if _is_increasing(loads, len(names)) and not all(name.isdigit() for name in names):
            node = xr.Dataset(variables).rename(frame="load").assign_coords(load=loads)
            return node.assign_coords(frame=("load", names))
    return xr.Dataset(variables, {"frame": names})


def _collect(tree, above: str, law, states: dict, tables: dict, laws: dict) -> None:
    """Collect the states of a tree with their laws, and arrays and numbers, keyed by the path of their group."""
    law = tree.get("law", law) if isinstance(tree, dict) else law
    rows = list(tree.values()) if isinstance(tree, dict) else []
    if (  # two or more groups with the same plain fields, such as stages, form the rows of a table
        len(rows) > 1
        and all(isinstance(row, dict) and row.keys() == rows[0].keys() for row in rows)
        and all(isinstance(v, str | int | float | np.number) for row in rows for v in row.values())
    ):
        tables[above] = {"": tree}
        return
    items = tree.items() if isinstance(tree, dict) else ((f"{k:06d}", item) for k, item in enumerate(tree))
    for name, value in items:
        path = f"{above}{name}"
        if isinstance(value, State):
            states[path], laws[path] = value, law
        elif isinstance(value, dict | tuple | list) and not isinstance(value, Law):
            _collect(value._asdict() if hasattr(value, "_asdict") else value, f"{path}/", law, states, tables, laws)
        elif isinstance(value, np.ndarray | int | float | complex) and not isinstance(value, Law):
            tables.setdefault(above, {})[name] = np.asarray(value)


def _frame_variables(states: dict[str, State], laws: dict, units: dict, walls: dict[str, np.ndarray]) -> dict:
    """Return the variables of the states."""
    first, many = next(iter(states)), list(states.values())

    def unit(noun, name):
        symbol = units.get(f"{first}/{noun}/{name}" if noun else f"{first}/{name}")
        return {"units": symbol} if symbol else {}

    out = {"time": ("frame", np.array([state.time for state in many]), unit("", "time"))}
    for name in _GRAINS:
        values = np.stack([getattr(state.grains, name) for state in many])
        out[name] = (("frame", "grain", "axis")[: values.ndim], values, unit("grains", name))
    if most := max(len(state.walls.mass) for state in many):
        for name in _WALLS:
            shape = getattr(many[0].walls, name).shape[1:]
            values = np.full((len(many), most, *shape), np.nan)  # NaN for removed walls
            for k, (path, state) in enumerate(states.items()):
                values[k, walls[path]] = getattr(state.walls, name)
            out[f"wall_{name}"] = (("frame", "wall", "axis")[: values.ndim], values, unit("walls", name))
    out["cell"] = (("frame", "vector", "axis"), np.stack([s.cell.vectors for s in many]), unit("cell", "vectors"))
    return out | _contact_variables(states, laws, unit, walls)


def _contact_variables(states: dict[str, State], laws: dict, unit, walls: dict[str, np.ndarray]) -> dict:
    """Return the variables of all touching contacts, frame after frame."""
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


def _group_dataset(group: str, entries: dict, units: dict) -> xr.Dataset:
    """Build the dataset of a group.

    Arrays of the most common length share a dimension: the first coordinate that increases or, if none does, the
    group's name. The second dimension of tables is a coordinate of `_ACROSS` of the same length.
    """
    label = group.strip("/").rpartition("/")[2]
    if "" in entries:
        return _row_dataset(group, label, entries[""], units)
    lengths = Counter(len(values) for values in entries.values() if values.ndim)
    common = lengths.most_common(1)[0][0] if lengths else 0
    along = next((n for n in (*_ALONG, *_ACROSS) if _is_increasing(entries.get(n), common)), label or "row")
    across = next(
        (n for n in _ACROSS if n in entries and n != along and _is_increasing(entries[n], len(entries[n]))), ""
    )
    variables = {}
    for name, values in entries.items():
        if not values.size:
            continue
        kind = name.split("_")[0]
        dims = [f"{kind}_row" if k == 0 else f"{name}_{k}" for k in range(values.ndim)]
        if values.ndim and len(values) == common:
            dims[0] = along
        if values.ndim > 1 and values.shape[-1] == 3:
            dims[-1] = "axis"
        if across and values.ndim and values.shape[-1] == len(entries[across]) and (values.ndim > 1 or name == across):
            dims[-1] = across
        unit = units.get(f"{group}{name}")
        # a multidimensional variable must not share its name with one of its dimensions
        own = dims == [name] and name in (along, across)
        key = f"{name}_values" if name in dims and not own else name
        variables[key] = (dims, values, {"units": unit} if unit else {})
    return xr.Dataset(variables)


def _row_dataset(group: str, label: str, rows: dict, units: dict) -> xr.Dataset:
    """Build the dataset of a table; its dimension is named after the group (singular) and labelled by `name` or key."""
    first, dim = next(iter(rows)), label.removesuffix("s") or "row"
    columns = {name: np.array([row[name] for row in rows.values()]) for name in rows[first]}
    labels = columns.pop("name", np.array(list(rows)))
    variables = {
        name: (dim, values, {"units": unit} if (unit := units.get(f"{group}{first}/{name}")) else {})
        for name, values in columns.items()
        if name != dim
    }
    return xr.Dataset(variables, {dim: labels})


def _is_increasing(values: np.ndarray | None, length: int) -> bool:
    """Return True for an array of `length` strictly increasing numbers."""
    return (
        values is not None
        and values.shape == (length,)
        and values.dtype.kind in "fiu"
        and length > 1
        and bool((np.diff(values) > 0).all())
    )
