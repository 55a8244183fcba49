"""Measured positions and contact forces: two tables, or the structure of PeGS, a Photoelastic Grain Solver."""

from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ...core.arguments import Array, Numbers, Several, check_computed, checked
from ...core.readable import readable
from ...core.reading import Budget, check_matlab, read_bytes
from ..sample import PackingError, naming
from .columns import is_matlab, only_state
from .force_lists import NEEDED, WIDEST, frames_of_lists, read_lists

SAID = 0.05  # largest gap, over the smaller radius, that is not mentioned in a note
SLIGHT = 0.01  # mean tangential over mean normal force below which the sign of tangential forces does not matter
CLEAR = 1.2  # ratio of the imbalances for both signs of tangential forces above which the smaller one is conclusive
PEGS = ("x", "y", "r", "neighbours", "forces", "alphas")  # fields of a grain in PeGS files


Unknown = Annotated[Any, Array((0, 1), finite=False)]  # errors, NaN where unknown


@readable
class MeasuredForces(NamedTuple):
    """Disks or spheres and measured forces at their contacts; overlaps and slips are unknown."""

    MADE_BY = "io.read_forces"

    position: np.ndarray  # (N, D), D = 2 for disks, 3 for spheres [length]
    radius: np.ndarray  # (N,) [length]
    free: np.ndarray  # (N,) bool; all others are held, such as those at walls, and need not balance
    load: np.ndarray  # (N, D) external forces [force]
    pair_i: np.ndarray  # (C,) grains from 0
    pair_j: np.ndarray  # (C,)
    force_n: np.ndarray  # (C,) normal forces, not negative [force]
    force_t: np.ndarray  # disks: (C,), positive if they turn both from x to y; spheres: (C, 3), on i [force]
    position_error: np.ndarray  # (N,) error of each coordinate; NaN: unknown [length]
    force_n_error: np.ndarray  # (C,) NaN: unknown [force]
    force_t_error: np.ndarray  # (C,) NaN: unknown [force]
    ids: np.ndarray  # (N,) grain numbers for messages
    notes: list[str]

    def check_entries(self) -> None:
        """Raise PackingError if these forces are impossible in a packing."""
        check_computed(self)
        wanted = {2: (len(self.pair_i),), 3: (len(self.pair_i), 3)}.get(self.dim)
        if np.shape(self.force_t) != wanted:
            raise PackingError(
                "force_t must have shape (C,) for C contacts of disks or (C, 3) for spheres, got "
                f"{np.shape(self.force_t)} for positions of shape {self.position.shape}"
            )
        if self.pair_i.dtype.kind not in "iu" or self.pair_j.dtype.kind not in "iu":
            raise PackingError("grain numbers of contacts must be whole numbers from 0")
        _check_contacts(self)

    @property
    def dim(self) -> int:
        """2 for disks, 3 for spheres."""
        return self.position.shape[1]

    @property
    def ends(self) -> np.ndarray:
        """(2, C) grains of each contact."""
        return np.stack([self.pair_i, self.pair_j])

    def select(self, rows: np.ndarray) -> "MeasuredForces":
        """Network with a subset of the contacts."""
        names = [name for name in self._fields if name.startswith(("pair", "force"))]
        return self._replace(**{name: getattr(self, name)[rows] for name in names})


@checked
def measured_forces(
    position: Numbers, radius: Several, pair_i: Several, pair_j: Several, force_n: Several, force_t: Numbers = 0.0, *,
    held: Several = (), load: Numbers = 0.0, position_error: Unknown = np.nan, force_n_error: Unknown = np.nan,
    force_t_error: Unknown = np.nan, ids: Several | None = None, notes: list[str] | tuple[str, ...] = (),
) -> MeasuredForces:  # fmt: skip
    """Disks or spheres and measured forces at their contacts.

    Parameters
    ----------
    position : (N, 2) or (N, 3) [length]; radius : float or (N,) [length]
    pair_i, pair_j : (C,) grains from 0, each contact once
    force_n : (C,), not negative [force]
    force_t : tangential forces. Disks: float or (C,), the torque on the grains divided by their radius, positive if it
    turns both from x to y. Spheres: (C, 3), the force on grain i, whose normal part is ignored [force]
    held : grains that need not balance, such as those at walls whose forces were not measured
    load : as `position`, external forces such as weights [force]
    position_error, force_n_error, force_t_error : float, (N,) or (C,), standard deviations; NaN if not known
    ids : (N,) grain numbers for messages, by default from 0

    Raises
    ------
    PackingError
        If these forces are impossible in a packing.

    Examples
    --------
    >>> pair = measured_forces([[0, 0], [1.01, 0]], 0.5, [0], [1], [2.0], held=[0, 1])
    >>> pair.force_n
    array([2.])
    """
    n, count = len(np.atleast_1d(position)), np.size(pair_i)
    dim = 3 if np.shape(position) == (n, 3) else 2
    each = {"radius": radius, "position_error": position_error, "ids": np.arange(n) if ids is None else ids}
    pairs = {"pair_i": pair_i, "pair_j": pair_j, "force_n": force_n, "force_t": force_t}
    pairs |= {"force_n_error": force_n_error, "force_t_error": force_t_error}
    shapes = {"position": (position, (n, dim)), "load": (load, (n, dim))}
    shapes |= {name: (value, (n,)) for name, value in each.items()}
    shapes |= {name: (value, (count,)) for name, value in pairs.items()}
    shapes |= {"force_t": (force_t, (count,) if dim == 2 else (count, 3))}
    full = {}
    for name, (value, shape) in shapes.items():
        kind = int if name in ("pair_i", "pair_j", "ids") else float
        try:
            full[name] = np.array(np.broadcast_to(np.asarray(value, kind), shape))
        except (TypeError, ValueError, OverflowError):
            raise PackingError(f"{name} has shape {np.shape(value)}: numbers of shape {shape} are needed") from None
    network = MeasuredForces(**full, free=~np.isin(np.arange(n), held), notes=list(notes))
    _check_contacts(network)
    if dim == 2:
        return network
    normal = unit_branches(network)
    return network._replace(force_t=network.force_t - np.einsum("ck,ck,cl->cl", network.force_t, normal, normal))


def unit_branches(m: MeasuredForces) -> np.ndarray:
    """Contact normals, (C, D), from j to i."""
    branch = m.position[m.pair_i] - m.position[m.pair_j]
    return branch / np.linalg.norm(branch, axis=1, keepdims=True)


def _check_contacts(m: MeasuredForces) -> None:
    """Raise PackingError without contacts, or if numbers or contacts are impossible: repeated, pulling or far apart."""
    n = len(m.radius)
    if not len(m.pair_i):
        raise PackingError(f"measured contact forces are missing: give {' '.join(NEEDED)}")
    if not 0 <= m.ends.min() <= m.ends.max() < n:
        raise PackingError(f"contacts name grains {m.ends.min()} to {m.ends.max()}: use numbers from 0 to {n - 1}")
    for name in ("position", "radius", "load", "force_n", "force_t"):
        if not np.isfinite(getattr(m, name)).all():
            raise PackingError(f"{name} contains NaN or infinity: every entry must be a finite number")
    for name in ("radius", "position_error", "force_n_error", "force_t_error"):
        if (getattr(m, name) <= 0).any():
            raise PackingError(f"{name} must be positive, got {getattr(m, name).min():g}")
    if not m.force_n.any():
        raise PackingError("all normal forces are zero: nothing presses the grains together")
    low, high = np.sort(m.ends, axis=0)
    _, first = np.unique(low * n + high, return_index=True)
    again = np.ones(len(low), bool)
    again[first] = False
    share, size = _gaps(m), m.radius[m.ends].min(axis=0)
    for wrong, text in (
        (low == high, "are the same grain, which cannot touch itself: check the grain numbers"),
        (again, "have two entries in the list of contacts: give each contact once"),
        (m.force_n < 0, "pull each other: normal forces press, and are positive"),
        (np.abs(share) > WIDEST, "should touch, but {how} {gap:.4g}, {share:.2g} of a radius: check positions, radii "
        "and their unit, and the grain numbers"),
    ):  # fmt: skip
        for c in np.flatnonzero(wrong):
            how = "have a gap of" if share[c] > 0 else "overlap by"
            told = text.format(how=how, gap=abs(share[c]) * size[c], share=abs(share[c]))
            raise PackingError(f"grains {m.ids[m.pair_i[c]]} and {m.ids[m.pair_j[c]]} {told}")


@checked
def read_forces(path: str | Path, contacts: str | Path | None = None, *, frame: str | None = None) -> MeasuredForces:
    """Read measured positions and contact forces from two tables or a PeGS file.

    Tables are text. Columns of grains are x, y, radius, for spheres also z, and optionally id, fixed (1: held, 0:
    free), edge (held if not 0), load_x, load_y, load_z, position_error. Columns of contacts are i and j (ids, or rows
    from 0), fn, ft (positive if it turns both grains from x to y), and optionally fn_error, ft_error. The force on
    grain i, fx, fy, fz, may replace fn and ft, and its tangential part, tx, ty, tz, may replace ft; spheres need one of
    these. Units in brackets, as in "fn [N]", are not converted: give all lengths in one unit, all forces in one unit,
    and the law in the same units.

    Tables without names of columns are read as lists of PeGS2 and RigidLibrary. Their columns are frame, id, x, y,
    radius, edge, or x, y, radius for grains, and frame, i, j, ft, fn, or i, j, fn, ft, or i, j, a flag, ft, fn for
    contacts. For matrices (N, N) of RigidLibrary, give that of normal forces, and put that of tangential forces into
    the same folder. Negative grain numbers stand for walls, whose contacts are left out; grains in contact with walls
    are held. The two forces of a contact listed for both grains are averaged, and the root mean square of half the
    differences is their error. Contacts whose normal force is negative by less than five times its error are left out.

    PeGS files contain the structure `particle` (`pres` in version 1): x, y, r in pixels, rm in metres, and for each
    grain its neighbours, forces in newtons, and angles alphas. They are read in SI units; y points down as in the
    image. A grain with a wall among its neighbours is held. Each contact is measured at both grains: forces are
    averaged, and the root mean square of half the differences is their error. Contacts that were found at one grain
    only, or that do not press, are left out.

    Parameters
    ----------
    path : table of grains, or .mat
    contacts : table of contacts; not with .mat
    frame : frame to read from tables that have a column frame, by default the last

    Raises
    ------
    PackingError
        If a file cannot be used.

    Source
    ------
    Daniels, Kollmer & Puckett, doi:10.1063/1.4983049.
    """
    path = Path(path)
    for file in filter(None, (path, contacts)):
        if not Path(file).is_file():
            raise PackingError(f"{file} is not a file: give measured grains, and a table of their contacts")
    if is_matlab(path):
        if contacts is not None:
            raise PackingError(f"{path.name} contains the contacts: leave out {contacts}")
        only_state(path, frame)
        measured = _read_pegs(path)
        return measured._replace(notes=[*measured.notes, *_notes_on_sign(measured)])
    if contacts is None:
        raise PackingError(f"{path} has no forces: give the table of contacts as well, {' '.join(NEEDED)}")
    fields, notes = read_lists(path, Path(contacts), frame)
    with naming(f"{path} and {contacts}"):
        measured = measured_forces(**fields, notes=notes)
    gap = _gaps(measured)
    note = (
        f"grains in contact have gaps of up to {gap.max():.2g} of a radius, with a median of {np.median(gap):.2g}: "
        "overlaps follow from the forces"
    )
    return measured._replace(notes=[*notes, *([note] if gap.max() > SAID else []), *_notes_on_sign(measured)])


def _notes_on_sign(m: MeasuredForces) -> list[str]:
    """Note for free disks whose forces do not balance better with the tangential forces as read than with −ft."""
    inner = m.free & (np.bincount(m.ends.ravel(), minlength=len(m.radius)) > 1)
    mean = m.force_n.mean()
    if m.dim == 3 or not inner.any() or np.abs(m.force_t).mean() < SLIGHT * mean:
        return []
    normal = unit_branches(m)
    turned = np.stack([normal[:, 1], -normal[:, 0]], axis=1)

    def imbalance(sign: float) -> float:
        """Root mean square of the sums of forces on grains, over the mean force."""
        total, force = m.load.copy(), m.force_n[:, None] * normal + sign * m.force_t[:, None] * turned
        np.add.at(total, m.pair_i, force)
        np.add.at(total, m.pair_j, -force)
        return float(np.sqrt((total[inner] ** 2).sum(axis=1).mean()) / mean)

    given, opposite = imbalance(1.0), imbalance(-1.0)
    if opposite > CLEAR * given:
        return []
    end = (
        "they would balance better: ft must be positive if it turns both grains from x to y; change its sign if not"
        if given > CLEAR * opposite
        else "this does not show whether ft has the sign that is read, positive if it turns both grains from x to y"
    )
    sums = f"{given:.3g} mean forces (rms), and to {opposite:.3g} with the opposite ft"
    return [f"the forces on free grains sum to {sums}; {end}"]


def _gaps(m: MeasuredForces) -> np.ndarray:
    """(C,) gaps of grains in contact over the smaller radius, negative for overlaps."""
    size = np.linalg.norm(m.position[m.pair_i] - m.position[m.pair_j], axis=1)
    return (size - m.radius[m.ends].sum(axis=0)) / m.radius[m.ends].min(axis=0)


def measured_frames(path: Path, contacts: Path | None) -> list[str | None]:
    """Names of the frames of measured forces; None in files without frame names."""
    return [None] if contacts is None or is_matlab(path) else [*frames_of_lists(path, contacts)] or [None]


def _read_pegs(path: Path) -> MeasuredForces:
    """Network from a PeGS file; the force on a grain is −f (cos(β − α), sin(β − α)) at its contact in direction β."""
    grains = _particles(path)
    ids = [int(_number(grain, "id", k + 1)) for k, grain in enumerate(grains)]
    number = {name: k for k, name in enumerate(ids)}
    radius, pixels = (np.array([_number(grain, field) for grain in grains]) for field in ("rm", "r"))
    for unit, field, values in (("metres", "rm", radius), ("pixels", "r", pixels)):
        if not ((values > 1e-12) & (values < 1e12)).all():
            raise PackingError(f"{path} has no radii in {unit} ({field}): set the scale in PeGS")
    scale = np.median(radius / pixels)
    position = scale * np.array([[_number(grain, "x"), _number(grain, "y")] for grain in grains])
    seen: dict[tuple[int, int], list[tuple[float, float]]] = {}
    held = set()
    for k, grain in enumerate(grains):
        near, force, alpha = (np.ravel(getattr(grain, name)).astype(float) for name in PEGS[3:])
        if not len(near) == len(force) == len(alpha):
            told = f"{len(force)} forces for {len(near)} neighbours of grain {ids[k]}"
            raise PackingError(f"{path} has {told}: solve for the forces in PeGS first")
        for other, f, a in zip(near.tolist(), force, alpha, strict=True):
            if other in number and np.isfinite(f):
                pair = min(k, number[other]), max(k, number[other])
                seen.setdefault(pair, []).append((f * np.cos(a), f * np.sin(a)))
            held |= {k} if other <= 0 else set()
    both = [pair for pair, values in seen.items() if len(values) == 2]
    if not both:
        raise PackingError(
            f"{path} has no contact that was found at both of its grains: solve for the forces in PeGS first"
        )
    values = np.array([seen[pair] for pair in both])
    (mean_n, mean_t), error = values.mean(axis=1).T, np.sqrt((np.diff(values, axis=1) ** 2).mean(axis=(0, 1))) / 2
    kept = mean_n > 0
    note = (
        f"{path.name} is read in metres and newtons, y down as in the image; errors of forces, {error[0]:.3g} N "
        f"normal and {error[1]:.3g} N tangential, are half the differences between both grains of contacts; contacts "
        f"found at one grain only or without pressure are left out: {len(seen) - kept.sum()}"
    )
    with naming(path):
        return measured_forces(
        position, radius, *np.array(both)[kept].T, mean_n[kept], mean_t[kept], held=sorted(held), ids=ids, notes=[note],
        force_n_error=error[0] or np.nan, force_t_error=error[1] or np.nan,
    )  # fmt: skip


def _particles(path: Path) -> list:
    """Grains of a PeGS file, as structures with the fields `PEGS`."""
    from scipy.io import loadmat

    try:
        stored = read_bytes(path, remedy="give a PeGS file")
        if stored.startswith(b"MATLAB 5"):
            check_matlab(stored, Budget(path, len(stored), remedy="save it again"))
        content = loadmat(BytesIO(stored), squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        raise PackingError(f"{path} is a MATLAB 7.3 file: save it with save(…, '-v7')") from None
    except Exception as problem:
        said = (str(problem) or type(problem).__name__).splitlines()[0][:80]
        raise PackingError(f"{path} is a damaged MATLAB file ({said}): save it again") from None
    name = next((name for name in ("particle", "pres") if name in content), None)
    grains = np.ravel(content[name]).tolist() if name else []
    if not grains or not all(hasattr(grain, field) for grain in grains for field in PEGS):
        raise PackingError(
            f"{path} has no structure particle or pres with fields {', '.join(PEGS)}: give a file with forces solved "
            "by PeGS"
        )
    return grains


def _number(grain, field: str, default: float = np.nan) -> float:
    """Number in a field of a PeGS grain; the default if there is none."""
    value = np.ravel(getattr(grain, field, default))
    return float(value[0]) if value.size else default
