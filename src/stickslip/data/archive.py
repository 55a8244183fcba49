"""One HDF5 file a run: scenario text, versions, frames with full contact memory, and numbers.

Schema 3. The file is a tree of groups and datasets that mirrors nested dictionaries and the NamedTuples of `core`;
a group that was a NamedTuple carries its name in the attribute `noun`. The root has the attributes `schema`,
`stickslip` (version) and `scenario` (canonical text). Contact lists are stored up to their count, whole.

A file is written beside its place and then renamed, so that a killed process never leaves a broken one behind.
"""

import os
from pathlib import Path

import h5py
import numpy as np

from ..core.laws import Law
from ..core.state import Cell, Contacts, Control, Grains, State, Walls

SCHEMA = 3
_NOUNS = {noun.__name__: noun for noun in (State, Grains, Walls, Cell, Contacts, Control, Law)}


def write(path: str | Path, tree: dict, *, scenario: str = "", version: str = "") -> None:
    """Write nested dictionaries of arrays, numbers, strings and states to an HDF5 file, all or nothing."""
    path = Path(path)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with h5py.File(beside, "w") as file:
            file.attrs["schema"], file.attrs["scenario"], file.attrs["stickslip"] = SCHEMA, scenario, version
            for name, value in tree.items():
                _put(file, name, value)
        os.replace(beside, path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def read(path: str | Path) -> dict:
    """The tree that `write` was given; states come back as State.

    Raises
    ------
    ValueError
        if the file is not an archive or of a later schema.
    """
    try:
        with h5py.File(path) as file:
            if file.attrs.get("schema") != SCHEMA:
                raise ValueError(
                    f"{path} has archive schema {file.attrs.get('schema')}: this version reads schema {SCHEMA}"
                )
            return {name: _take(value) for name, value in file.items()}
    except OSError:
        raise ValueError(f"{path} is not an archive that can be read: give the results.h5 of a run") from None


def _put(group, name: str, value) -> None:
    if isinstance(value, Contacts):
        count = int(value.count[0])
        value = value._replace(
            **{f: getattr(value, f)[:count] for f in Contacts._fields if f not in ("origin", "skin", "count")}
        )
    if isinstance(value, dict) or hasattr(value, "_fields"):
        child = group.create_group(name)
        if not isinstance(value, dict):
            child.attrs["noun"] = type(value).__name__
            value = value._asdict()
        for key, item in value.items():
            _put(child, str(key), item)
        return
    array = np.asarray(value)
    if array.dtype.kind == "U":
        array = np.asarray(value, dtype=h5py.string_dtype())
    options = {"compression": "gzip", "shuffle": True} if array.size > 1000 else {}
    group.create_dataset(name, data=array, **options)


def _take(item):
    if isinstance(item, h5py.Dataset):
        value = item[()]
        if h5py.check_string_dtype(item.dtype) is not None:
            return value.decode() if isinstance(value, bytes) else np.array([v.decode() for v in value.ravel()])
        return value.item() if np.ndim(value) == 0 else value
    tree = {name: _take(child) for name, child in item.items()}
    noun = _NOUNS.get(item.attrs.get("noun"))
    return noun(**tree) if noun else tree
