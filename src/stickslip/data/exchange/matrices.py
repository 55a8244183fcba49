"""Matrices and vectors in files for other programs: one NumPy file, or a folder of Matrix Market files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.io import mmwrite

from ...core.arguments import checked
from ..run_files import replace_atomically

PARTS = ("data", "indices", "indptr", "shape")  # parts of a sparse matrix in compressed rows
COORDINATES = ("mass", "body", "axis")  # of the `free` coordinates of a result, to which rows of matrices refer


@checked
def write_matrices(path: str | Path, *sources, overwrite: bool = False) -> list[Path]:
    """Write all matrices and vectors of some results, such as `modes.equations_of_motion`.

    Parameters
    ----------
    path : `NAME.npz`, or a new folder for Matrix Market files
    sources : named tuples or dictionaries whose arrays, sparse matrices and numbers are written under their names:
        `modes.equations_of_motion`, `quasirigid.linear_system`, `quasirigid.complementarity`; of `free` coordinates,
        only `mass`, `body` and `axis` are written
    overwrite : whether files of the same names are replaced

    Returns
    -------
    list of Path

    Raises
    ------
    ValueError
        If a name occurs twice, there is nothing to write, or a file already exists.

    Notes
    -----
    A sparse matrix `k` in `NAME.npz` consists of the arrays of its compressed rows:
    `scipy.sparse.csr_array((f["k.data"], f["k.indices"], f["k.indptr"]), shape=f["k.shape"])`. In Matrix Market files,
    arrays of more than two dimensions are flattened to two, keeping the first; in both formats, bodies, contacts and
    coordinates are numbered from 0.

    Examples
    --------
    >>> import tempfile
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.7, seed=1)
    >>> motion = ss.modes.equations_of_motion(state, ss.laws.hertz_mindlin())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [path.name for path in ss.io.write_matrices(f"{folder}/m", motion)]
    ['jacobian.mtx', 'damping.mtx', 'mass.mtx', 'force.mtx', 'body.mtx', 'axis.mtx']
    """
    path, parts = Path(path), _parts_of(sources)
    flat = check_name(path)
    paths = [path] if flat else [path / f"{name}.mtx" for name in parts]
    if not overwrite and (there := [str(one) for one in paths if one.exists()]):
        raise ValueError(f"{there[0]} exists: give another name, or move it away")
    if flat:
        arrays = {key: array for name, value in parts.items() for key, array in _arrays_of(name, value).items()}
        with replace_atomically(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **arrays)
        return paths
    path.mkdir(exist_ok=True)
    for one, value in zip(paths, parts.values(), strict=True):
        with replace_atomically(one) as part, part.open("wb") as file:
            mmwrite(file, value if sparse.issparse(value) else _table(value), precision=17, symmetry="general")
    return paths


def check_name(path: Path) -> bool:
    """Return True if the path is a single file, `NAME.npz`; raise ValueError if it is unsuitable."""
    flat = path.suffix.lower() == ".npz"
    if not flat and path.suffix:
        raise ValueError(f"expected NAME.npz, or a folder for Matrix Market files, got {path}")
    if not path.parent.is_dir():
        raise ValueError(f"{path.parent} is not a folder: create it first")
    if path.is_dir() if flat else path.is_file():
        raise ValueError(f"{path} is a {'folder' if flat else 'file'}: give another name")
    return flat


def _parts_of(sources) -> dict:
    """Arrays, sparse matrices and numbers of some results by name."""
    found: dict = {}
    for source in sources:
        entries = source if isinstance(source, Mapping) else getattr(source, "_asdict", dict)()
        parts = {name: _as_array(value) for name, value in entries.items()}
        parts = {name: value for name, value in parts.items() if value is not None}
        if (free := entries.get("free")) is not None:
            parts |= {name: getattr(free, name) for name in COORDINATES}
        if not any(np.ndim(value) or sparse.issparse(value) for value in parts.values()):
            raise ValueError(
                f"{type(source).__name__} has no matrices: give results such as modes.equations_of_motion(state, law)"
            )
        if twice := sorted(set(found) & set(parts)):
            raise ValueError(f"{', '.join(twice)} occurs twice: write the results to separate files")
        found |= parts
    if not found:
        raise ValueError("there is nothing to write: give results such as modes.equations_of_motion(state, law)")
    return found


def _as_array(value):
    """Sparse matrix or array of numbers, or None for everything else."""
    if sparse.issparse(value):
        return value
    array = np.asarray(value) if isinstance(value, np.ndarray | float | int) else np.array("")
    return array if array.dtype.kind in "biuf" else None


def _arrays_of(name: str, value) -> dict[str, np.ndarray]:
    if not sparse.issparse(value):
        return {name: value}
    rows = sparse.csr_array(value)
    return {f"{name}.{part}": np.asarray(getattr(rows, part)) for part in PARTS}


def _table(value: np.ndarray) -> np.ndarray:
    """Array in two dimensions; truth values as 0 and 1."""
    value = value.astype(np.int64) if value.dtype.kind in "bu" else value
    return value.reshape(len(value) if value.ndim else 1, -1)
