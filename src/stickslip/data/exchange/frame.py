"""Exports for other programs: frames of states and animated modes, the contact network, and matrices of results.

A frame is a state with columns per grain and contact. Matrices go into one NumPy file, or a folder of Matrix Market
files.

Files are written to a temporary path and then renamed, so that no partially written file has the final name.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...builtin_laws import NAMES
from ...core.arguments import checked, knows_bonds, require_shape
from ...core.contacts.bonding import without_bonds
from ...core.contacts.bonds import bond_vectors
from ...core.contacts.forces import forces
from ...core.fields import pack_keys
from ...core.laws.builtin import COULOMB, DAMPING, NO_TENSION, Law
from ...core.laws.kinds import Kind, describe_law, restore_kind
from ...core.measure import branch_vectors, contact_forces, contact_numbers, touching
from ...core.progress import STATE, Size, require_sizes
from ...core.readable import pluralize, readable
from ...core.reading import read_arrays
from ...core.state import OPEN, SLIDE, State
from ...extras import require
from ..run_files import replace_atomically
from ..sample import HUGE, PackingError

if TYPE_CHECKING:
    import networkx


@readable
class Frame(NamedTuple):
    """A state with derived columns for export; frames of an animation have further columns."""

    MADE_BY = "io.frame_of"

    state: State
    law: Law
    grains: dict[str, np.ndarray]  # derived columns per grain, (N,) or (N, 3)
    contacts: dict[str, np.ndarray]  # columns per touching contact, (M,) or (M, 3), including i, j, image and branch
    turned: np.ndarray | None = None  # (N, 3) rotation since the first frame [rad]; None if only plane angles are known
    moving: bool = False  # True in an animation of a mode, which is not a state to continue from
    assumed: tuple[str, ...] = ()  # assumptions about the packing


def exported(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns under the names used in files, in which a plain `force` or `torque` might seem to be an external one."""
    return {f"contact_{name}" if name in ("force", "torque") else name: column for name, column in columns.items()}


@checked
@knows_bonds
def frame_of(state: State, law: Law) -> Frame:
    """Columns of an accepted state: resultants for each grain, and the elastic force on i for each contact [force].

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> frame_of(pair, law).contacts["force_n"]
    array([0.001])
    """
    rows, c, n = touching(state), state.contacts, len(state.grains.radius)
    branch = branch_vectors(state)[rows]
    force = contact_forces(state, law)[rows]
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    size = np.einsum("ck,ck->c", force, normal)
    tangential = force - size[:, None] * normal
    contacts = {
        "i": c.i[rows], "j": c.j[rows], "image": c.image[rows], "branch": branch, "force_n": size,
        "force_t": np.linalg.norm(tangential, axis=1), "tangential": tangential, "slip": c.slip[rows],
        "mode": c.mode[rows],
    }  # fmt: skip
    loads = forces(state, law)[0]
    grains = {"force": loads.force[:n], "torque": loads.torque[:n], "coordination": contact_numbers(state)}
    return Frame(state, law, grains, contacts)


def unbonded(frame: Frame) -> Frame:
    """Frame with the contacts and forces that remain without bonds."""
    if not frame.state.bonds:
        return frame
    bare = frame_of(without_bonds(frame.state), frame.law)
    return frame._replace(state=bare.state, grains=bare.grains, contacts=bare.contacts)


def with_bonds(frame: Frame) -> dict[str, np.ndarray]:
    """Columns whose rows are contacts, followed by bonds if there are any.

    The column `bond` is 0 for contacts, 1 for bonds and 2 for broken ones, and `failed` is the index in `FAILURES` of
    the load that broke them. Where bonded grains touch, the row of the contact has the sum of both forces, and that of
    the bond has none.
    """
    state, c = frame.state, frame.contacts
    if not state.bonds:
        return c
    bonds, touch = state.bonds, c["mode"] != OPEN
    across = np.isin(pack_keys(bonds.i, bonds.j, bonds.image), pack_keys(c["i"], c["j"], c["image"])[~touch])
    rest = ~(across & bonds.intact)
    branch = bond_vectors(bonds, state.grains.position, state.cell.vectors)
    more = {name: getattr(bonds, name)[rest] for name in ("i", "j", "image")} | {"branch": branch[rest]}
    out = {
        name: np.concatenate([column, more.get(name, np.zeros((rest.sum(), *column.shape[1:]), column.dtype))])
        for name, column in c.items()
    }
    out["bond"] = np.concatenate([np.where(touch, 0, 1), np.where(bonds.intact[rest], 1, 2)]).astype(np.int32)
    out["failed"] = np.concatenate([np.zeros(len(touch), np.int32), bonds.failed[rest]]).astype(np.int32)
    return out


def without_walls(frame: Frame) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns of the contacts between grains, and a note on contacts with walls."""
    columns = with_bonds(frame)
    between = columns["j"] < len(frame.state.grains.radius)
    walls = int((~between).sum())
    notes = [f"{pluralize(walls, 'contact')} with walls are not written, as they have no second grain"] if walls else []
    return {name: column[between] for name, column in columns.items()}, notes


def law_to_dict(law: Law) -> dict:
    """Convert a law to names and numbers, which JSON stores to the last bit."""
    own = {"own": describe_law(law)} if isinstance(law.kind, Kind) else {}
    return own | {
        "law": f"own {int(law.kind):x}" if own else NAMES[law.kind],
        "coulomb": next(name for name, number in COULOMB.items() if number == law.coulomb),
        "damping": next(name for name, number in DAMPING.items() if number == law.damping & ~NO_TENSION),
        "tension": not law.damping & NO_TENSION,
        "table": law.table.tolist(), "properties": law.properties,
    }  # fmt: skip


def law_from_dict(about: dict) -> Law:
    """Rebuild a law from `law_to_dict`; raise ValueError, KeyError or TypeError if there is no such law."""
    table = np.array(about["table"], float)
    if table.ndim != 3 or table.shape[0] != table.shape[1] or table.shape[2] < 5 or not np.isfinite(table).all():
        raise ValueError(f"a law's table of shape {table.shape}")
    damping = DAMPING[about["damping"]] + (0 if about["tension"] else NO_TENSION)
    kind = restore_kind(int(about["own"]["digest"], 16), about["own"]) if "own" in about else NAMES.index(about["law"])
    return Law(kind, COULOMB[about["coulomb"]], table, damping, about.get("properties", 0))


def bounding_box(state: State, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Vectors and corner of a box that contains all grains: the cell along periodic directions, tight along others.

    Returns
    -------
    (3, 3) vectors as rows; (3,) corner [length]
    """
    grains, cell = state.grains, state.cell
    vectors, corner = np.diag([1.0, 1.0, 1.0]), np.zeros(3)
    if cell.periodic.any():
        if np.triu(cell.vectors, 1).any() or not (np.diag(cell.vectors) > 0).all():
            raise PackingError(
                f"{name} requires the first box vector along x and the second in the x-y plane, which this cell does "
                "not satisfy: write .npz, .h5 or .vtu"
            )
        vectors = np.where(cell.periodic[:, None], cell.vectors, 0.0)
    low = (grains.position - grains.radius[:, None]).min(axis=0)
    high = (grains.position + grains.radius[:, None]).max(axis=0)
    for k in np.flatnonzero(~cell.periodic):
        vectors[k], vectors[k, k] = 0.0, 1.02 * (high[k] - low[k])
        corner[k] = low[k] - 0.01 * (high[k] - low[k])
    return vectors, corner


def wrapped_into(position: np.ndarray, vectors, corner, periodic) -> tuple[np.ndarray, np.ndarray]:
    """Positions wrapped into a box with a given corner, and their periodic images: x = wrapped + image @ vectors."""
    share = (position - corner) @ np.linalg.inv(vectors)
    image = np.where(periodic, np.floor(share), 0.0)
    inside = position - image @ vectors
    return inside, image.astype(np.int64)


def list_losses(frame: Frame, *, law: bool = True) -> list[str]:
    """List data that a format does not store: walls, the law, and anything in `Control` other than free grains."""
    state, losses = frame.state, []
    control, n = state.control, len(state.grains.radius)
    if len(state.walls.mass):
        losses.append(f"{len(state.walls.mass)} wall(s)")
    if law:
        losses.append("the contact law")
    acts = control.force.any() or control.torque.any() or control.gravity.any() or control.spring.any()
    held = not control.free[:n, : state.cell.dim].all() or control.cell_free.any() or control.cell_rate.any()
    if acts or held or (control.group >= 0).any():
        losses.append("loads and boundary conditions")
    return losses


REQUIRED = ("translation", "rotation", "exponent")


@checked
def read_mode(path: str | Path, number: int, n: int) -> tuple[np.ndarray, np.ndarray, complex]:
    """Read the translation and rotation, (N, 3) complex, and the exponent s of a mode exp(st) written by `stability`.

    Raises
    ------
    PackingError
        If the file does not contain modes, or belongs to another packing.
    """
    if not Path(path).is_file():
        raise PackingError(f"{path} is not a file: give the modes that `stickslip stability` wrote")
    try:
        arrays = read_arrays(path, remedy="write the modes again", names=REQUIRED)
    except Exception:  # numpy and zipfile raise various errors for a damaged file
        raise PackingError(f"{path} contains no modes: give the .npz that `stickslip stability` wrote") from None
    translation, rotation, exponent = (arrays[name] for name in REQUIRED)
    if any(array.dtype.kind not in "fciu" for array in (translation, rotation, exponent)):
        raise PackingError(f"{path} contains entries that are not numbers: write the modes again")
    if exponent.ndim != 1 or translation.shape != (len(exponent), *translation.shape[1:2], 3):
        raise PackingError(f"{path} contains arrays that do not belong together: write the modes again")
    if not len(exponent):
        raise PackingError(f"{path} contains no modes: the packing has no growing mode")
    if not 0 <= number < len(exponent):
        raise PackingError(f"mode {number} does not exist: {path} has modes 0 to {len(exponent) - 1}, fastest first")
    if translation.shape[1] != n or rotation.shape != translation.shape:
        raise PackingError(
            f"{path} has modes of {translation.shape[1]} grains, but the packing has {n}: give modes of this packing"
        )
    if not (np.isfinite(translation).all() and np.isfinite(rotation).all() and np.isfinite(exponent).all()):
        raise PackingError(f"{path} contains NaN or infinity: write the modes again")
    return translation[number], rotation[number], complex(exponent[number])


@checked
def mode_frames(
    frame: Frame, translation: np.ndarray, rotation: np.ndarray, exponent: complex, *, count: int = 48,
    amplitude: float = 0.3, grow: bool = False,
) -> list[Frame]:  # fmt: skip
    """Frames of Re(mode exp(st)) over one period 2π/|Im s|.

    A non-oscillating mode is animated with the period 2π/|s|, or 2π if s = 0.

    Parameters
    ----------
    frame : frame of the packing; its contacts and forces are not changed
    translation, rotation : (N, 3) complex displacements, and R·angle
    exponent : s [1/time]
    count : number of frames per period
    amplitude : largest displacement of any grain, divided by its radius
    grow : if False, growth is omitted, so that the animation can be looped; if True, the mode grows to `amplitude`
    """
    state, radius = frame.state, frame.state.grains.radius[:, None]
    memory = 2 * STATE * len(radius) * count
    require_sizes([Size(f"{count} frames take", memory, "bytes", "use fewer")], PackingError)
    if count < 2 or not 0 < amplitude <= HUGE:
        raise PackingError(
            f"an animation needs at least 2 frames and an amplitude above 0 and at most {HUGE:g}, got {count} frames "
            f"and {amplitude:g}"
        )
    require_shape((len(radius), 3), translation=translation, rotation=rotation)
    largest = float((np.sqrt((np.abs(translation) ** 2).sum(axis=1, keepdims=True)) / radius).max())
    turning = float((np.abs(rotation) / radius).max())
    if not max(largest, turning) > 0:
        raise PackingError("the mode does not move any grain: choose another mode")
    scale = amplitude / (largest or turning)
    period = 2 * np.pi / (abs(exponent.imag) or abs(exponent) or 1.0)
    if not np.isfinite(period):
        raise PackingError(f"the mode has the exponent {exponent:.3g}, whose period is not finite: choose another mode")
    out, c, n = [], frame.contacts, len(radius)
    for t in np.arange(count) / count * period:
        factor = np.exp(1j * (exponent.imag * t if exponent.imag else 2 * np.pi * t / period))
        if grow:
            factor *= np.exp(exponent.real * (t - period))
        shift, roll = ((scale * factor * part).real for part in (translation, rotation))
        angle = state.grains.angle + roll / radius
        grains = state.grains._replace(position=state.grains.position + shift, angle=angle)
        step = shift[c["i"]] - np.where((c["j"] < n)[:, None], shift[np.minimum(c["j"], n - 1)], 0.0)
        columns = frame.grains | {"displacement": shift, "rotation": roll / radius}
        turned = angle if state.cell.dim == 2 else roll / radius
        moved = state._replace(grains=grains, time=float(state.time + t))
        out.append(Frame(moved, frame.law, columns, c | {"branch": c["branch"] + step}, turned, moving=True))
    return out


@checked
@knows_bonds
def contact_graph(state: State, law: Law) -> "networkx.MultiGraph":
    """Network of the touching contacts of an accepted state.

    Parameters
    ----------
    state : State, accepted
    law : Law

    Returns
    -------
    networkx.MultiGraph
        Nodes are bodies (walls after grains) with the attributes `wall`, `radius`, x, y, z [length]. Edges are contacts
        with `force_n`, `force_t` [force] and `slides`; grains that touch through several images have several edges. In
        a cemented packing, bonds are also edges, and `bond` is 0 for contacts, 1 for bonds and 2 for broken bonds

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> list(contact_graph(pair, law).edges())
    [(0, 1)]
    """
    return _graph_of(frame_of(state, law))


def write_graph(path: str | Path, frame: Frame) -> list[str]:
    """Write the contact network as GraphML; return notes on data that it does not store."""
    graph = _graph_of(frame)
    with replace_atomically(path) as part:
        require("networkx", "exchange").write_graphml(graph, part)
    return [f"GraphML stores positions and forces, but not {', '.join(['the cell', *list_losses(frame)])}"]


def _graph_of(frame: Frame) -> "networkx.MultiGraph":
    """Build the contact network from the columns of a frame."""
    graph, columns, state = require("networkx", "exchange").MultiGraph(), with_bonds(frame), frame.state
    n = len(state.grains.radius)
    places = [*state.grains.position.tolist(), *state.walls.point.tolist()]
    sizes = [*state.grains.radius.tolist(), *[0.0] * len(state.walls.mass)]
    for body, (position, radius) in enumerate(zip(places, sizes, strict=True)):
        graph.add_node(body, wall=body >= n, radius=radius, **dict(zip("xyz", position, strict=True)))
    names = "i", "j", "force_n", "force_t", "mode"
    more = [{"bond": bond} for bond in columns["bond"].tolist()] if "bond" in columns else [{}] * len(columns["i"])
    for about, i, j, force_n, force_t, mode in zip(more, *(columns[name].tolist() for name in names), strict=True):
        graph.add_edge(i, j, force_n=force_n, force_t=force_t, slides=mode == SLIDE, **about)
    return graph


PARTS = ("data", "indices", "indptr", "shape")  # parts of a sparse matrix in compressed rows
COORDINATES = ("mass", "body", "axis")  # data on the `free` coordinates of a result, to which rows of matrices refer


@checked
def write_matrices(path: str | Path, *sources, overwrite: bool = False) -> list[Path]:
    """Write all matrices and vectors of some results, such as `modes.equations_of_motion`.

    Parameters
    ----------
    path : `NAME.npz`, or a new folder for Matrix Market files
    sources : named tuples or dictionaries whose arrays, sparse matrices and numbers are written under their names:
        `modes.equations_of_motion`, `quasirigid.linear_system`, `quasirigid.complementarity`; of `free` coordinates,
        only `mass`, `body` and `axis` are written
    overwrite : whether existing files with the same names are replaced

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
    arrays of more than two dimensions are flattened to two dimensions, of which the first is kept. In both formats,
    bodies, contacts and coordinates are numbered from 0.

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
        arrays = {}
        for name, value in parts.items():
            rows = value.tocsr() if _is_sparse(value) else None
            arrays |= {name: value} if rows is None else {f"{name}.{part}": getattr(rows, part) for part in PARTS}
        with replace_atomically(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **arrays)
        return paths
    from scipy.io import mmwrite

    path.mkdir(exist_ok=True)
    for one, value in zip(paths, parts.values(), strict=True):
        with replace_atomically(one) as part, part.open("wb") as file:
            if not _is_sparse(value):  # two-dimensional, with truth values as 0 and 1
                value = value.astype(np.int64) if value.dtype.kind in "bu" else value
                value = value.reshape(len(value) if value.ndim else 1, -1)
            mmwrite(file, value, precision=17, symmetry="general")
    return paths


def check_name(path: Path) -> bool:
    """Return True if the path denotes a single file, `NAME.npz`; raise ValueError if it is unsuitable."""
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
        known = {n: v for n, v in entries.items() if _is_sparse(v) or isinstance(v, np.ndarray | float | int)}
        parts = {name: value if _is_sparse(value) else np.asarray(value) for name, value in known.items()}
        parts = {name: value for name, value in parts.items() if _is_sparse(value) or value.dtype.kind in "biuf"}
        if (free := entries.get("free")) is not None:
            parts |= {name: getattr(free, name) for name in COORDINATES}
        if not any(_is_sparse(value) or np.ndim(value) for value in parts.values()):
            raise ValueError(
                f"{type(source).__name__} has no matrices: give results such as modes.equations_of_motion(state, law)"
            )
        if twice := sorted(set(found) & set(parts)):
            raise ValueError(f"{', '.join(twice)} occurs twice: write the results to separate files")
        found |= parts
    if not found:
        raise ValueError("there is nothing to write: give results such as modes.equations_of_motion(state, law)")
    return found


def _is_sparse(value) -> bool:
    return hasattr(value, "tocsr")
