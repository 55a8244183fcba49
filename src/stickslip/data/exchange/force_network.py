"""Measured positions and contact forces of disks: two tables, or the structure of PeGS (Photoelastic Grain Solver)."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.arguments import checked
from ...core.readable import readable
from ..sample import PackingError
from .columns import plain_name
from .content import HEAD, read_content
from .table_file import read, read_columns

WIDEST = 0.5  # gap between grains in contact, over the smaller radius
PIXELS = ("px", "pix", "pixel", "pixels")
PEGS = ("x", "y", "r", "neighbours", "forces", "alphas")  # fields of a grain
FORCES = ("fn", "ft", "fnerror", "fterror", "fx", "fy")
NEEDED = "i j fn ft"


@readable
class MeasuredForces(NamedTuple):
    """Disks and the forces at their contacts, as they were measured; overlaps and slips are not known.

    A tangential force is positive if it turns both grains from x to y; on grain i it points along n × z, n from j to i.
    """

    position: np.ndarray  # (N, 2) [length]
    radius: np.ndarray  # (N,) [length]
    free: np.ndarray  # (N,) bool; others are held, as at walls, and need not balance
    load: np.ndarray  # (N, 2) external forces [force]
    pair_i: np.ndarray  # (C,) grains from 0
    pair_j: np.ndarray  # (C,)
    force_n: np.ndarray  # (C,) normal forces, not negative [force]
    force_t: np.ndarray  # (C,) tangential forces [force]
    position_error: np.ndarray  # (N,) of each coordinate; NaN: not known [length]
    force_n_error: np.ndarray  # (C,) NaN: not known [force]
    force_t_error: np.ndarray  # (C,) NaN: not known [force]
    ids: np.ndarray  # (N,) numbers by which messages name the grains
    notes: list[str]

    @property
    def ends(self) -> np.ndarray:
        """(2, C) grains of each contact."""
        return np.stack([self.pair_i, self.pair_j])

    def select(self, rows: np.ndarray) -> "MeasuredForces":
        """Network with some of the contacts."""
        names = [name for name in self._fields if name.startswith(("pair", "force"))]
        return self._replace(**{name: getattr(self, name)[rows] for name in names})


@checked
def measured_forces(
    position, radius, pair_i, pair_j, force_n, force_t=0.0, *, held=(), load=0.0, position_error=np.nan,
    force_n_error=np.nan, force_t_error=np.nan, ids=None, notes=(),
) -> MeasuredForces:  # fmt: skip
    """Disks and the forces at their contacts as they were measured.

    Parameters
    ----------
    position : (N, 2) [length]; radius : float or (N,) [length]
    pair_i, pair_j : (C,) grains from 0, each contact once
    force_n : (C,), not negative [force]; force_t : float or (C,), positive if it turns both grains from x to y [force]
    held : grains that need not balance, such as those at walls whose forces were not measured
    load : (N, 2), external forces such as weights [force]
    position_error, force_n_error, force_t_error : float, (N,) or (C,), standard deviations; NaN if not known
    ids : (N,) numbers by which messages name the grains, default from 0

    Raises
    ------
    PackingError
        if these cannot be the forces of a packing; the message is one sentence.

    Examples
    --------
    >>> pair = measured_forces([[0, 0], [1.01, 0]], 0.5, [0], [1], [2.0], held=[0, 1])
    >>> pair.force_n
    array([2.])
    """
    position = np.asarray(position, float)
    if position.ndim != 2 or position.shape[1] != 2:
        raise PackingError(f"position has shape {position.shape}: (N, 2) is needed, as forces are measured in a plane")
    n, count = len(position), np.size(pair_i)
    free = np.ones(n, bool)
    free[np.asarray(held, int)] = False
    ends = [_filled(end, count, name, int) for name, end in (("pair_i", pair_i), ("pair_j", pair_j))]
    values = {"radius": (radius, n), "position_error": (position_error, n)}
    values |= {"force_n": (force_n, count), "force_t": (force_t, count)}
    values |= {"force_n_error": (force_n_error, count), "force_t_error": (force_t_error, count)}
    full = {name: _filled(value, size, name) for name, (value, size) in values.items()}
    load = np.broadcast_to(np.asarray(load, float), (n, 2))
    ids = np.arange(n) if ids is None else np.asarray(ids)
    network = MeasuredForces(
        position, full["radius"], free, load, *ends, full["force_n"], full["force_t"], full["position_error"],
        full["force_n_error"], full["force_t_error"], ids, list(notes),
    )  # fmt: skip
    _check(network)
    return network


def _filled(value, size: int, name: str, kind=float) -> np.ndarray:
    try:
        return np.array(np.broadcast_to(np.asarray(value, kind), (size,)))
    except ValueError:
        raise PackingError(f"{name} has shape {np.shape(value)}: ({size},) is needed") from None


def _check(m: MeasuredForces) -> None:
    """Raise PackingError if a network has no contacts, or some that are impossible."""
    if not len(m.pair_i):
        raise PackingError(f"no contacts were given: measured forces are needed, {NEEDED}")
    if not (0 <= m.ends.min() and m.ends.max() < len(m.radius)):
        raise PackingError(f"contacts name grains {m.ends.min()} to {m.ends.max()}: use 0 to {len(m.radius) - 1}")
    for name in ("position", "radius", "load", "force_n", "force_t"):
        if not np.isfinite(getattr(m, name)).all():
            raise PackingError(f"{name} contains NaN or infinity: every entry must be a finite number")
    for name in ("radius", "position_error", "force_n_error", "force_t_error"):
        if (getattr(m, name) <= 0).any():
            raise PackingError(f"{name} = {getattr(m, name).min():g} was given: it must be positive")
    i, j = np.sort(m.ends, axis=0)
    pairs, times = np.unique(np.stack([i, j], axis=1), axis=0, return_counts=True)
    wrong = pairs[(times > 1) | (pairs[:, 0] == pairs[:, 1])]
    if len(wrong):
        a, b = (int(m.ids[k]) for k in wrong[0])
        what = "touches itself" if a == b else f"and grain {b} touch twice"
        raise PackingError(f"grain {a} {what} in the list of contacts: give each contact once")
    if (m.force_n < 0).any():
        c = int(np.argmin(m.force_n))
        a, b = (int(m.ids[k]) for k in m.ends[:, c])
        raise PackingError(
            f"grains {a} and {b} pull each other with {-m.force_n[c]:.4g}: normal forces press, and are positive"
        )
    if not m.force_n.any():
        raise PackingError("all normal forces are zero: nothing presses the grains together")
    if m.free.all() and not m.load.any():
        raise PackingError(
            "no grain is held, and there are no loads: grains that press each other need something around them; mark "
            "those at the edge as fixed"
        )
    reach = m.radius[m.ends].sum(axis=0)
    gap = np.linalg.norm(m.position[m.pair_i] - m.position[m.pair_j], axis=1) - reach
    share = np.abs(gap) / m.radius[m.ends].min(axis=0)
    c = int(np.argmax(share))
    if share[c] > WIDEST:
        a, b = (int(m.ids[k]) for k in m.ends[:, c])
        how = f"are {gap[c]:.4g} apart" if gap[c] > 0 else f"overlap by {-gap[c]:.4g}"
        raise PackingError(
            f"grains {a} and {b}, which are said to touch, {how}, {share[c]:.2g} of a radius: check positions, radii "
            f"and their unit, and the numbers of the grains"
        )


@checked
def read_forces(path: str | Path, contacts: str | Path | None = None) -> MeasuredForces:
    """Read measured positions and contact forces, from two tables or a file of PeGS.

    Tables are text with names of columns. Grains: x, y, radius; optional id, fixed (1: held, 0: free), fx and fy (loads),
    position_error. Contacts: i and j (ids, or rows from 0), fn, ft (positive if it turns both grains from x to y);
    optional fn_error and ft_error. Units in brackets, as in "fn [N]", are not converted: give all lengths in one unit,
    all forces in one, and the law in these.

    Files of PeGS hold the structure `particle` (`pres` in version 1): x, y, r in pixels, rm in metres, and for each
    grain its neighbours, forces in newtons, and angles betas and alphas. They are read in SI units; y points down as in
    the image. A grain with a wall among its neighbours is held. Each contact is seen from both grains: forces are
    averaged, and the root-mean-square of half the differences is their error. Contacts that one grain alone sees, or
    that do not press, are left out.

    Parameters
    ----------
    path : table of grains, or .mat
    contacts : table of contacts; not with .mat

    Raises
    ------
    PackingError
        if a file cannot be used; the message is one sentence.

    Source
    ------
    Daniels, Kollmer & Puckett, doi:10.1063/1.4983049.
    """
    path = Path(path)
    for file in filter(None, (path, contacts)):
        if not Path(file).is_file():
            raise PackingError(f"{file} is not a file: give measured grains, and a table of their contacts")
    if _is_matlab(path):
        if contacts is not None:
            raise PackingError(f"{contacts} was given with {path.name}, which holds the contacts: leave it out")
        return _read_pegs(path)
    if contacts is None:
        raise PackingError(f"{path} has no forces: give the table of contacts as well, {NEEDED}")
    return _read_tables(path, Path(contacts))


def _is_matlab(path: Path) -> bool:
    """Return True for a file of MATLAB, up to version 7 or later."""
    return path.is_file() and read_content(path, HEAD).startswith(b"MATLAB ")


def _is_force_table(path: Path) -> bool:
    """Return True for a table with a column fn."""
    if not path.is_file() or b"\0" in (head := read_content(path, HEAD)):
        return False
    lines = head.decode("utf-8", errors="replace").splitlines()
    return any("fn" in {plain_name(word) for word in re.split(r"[;,\t]+| +(?!\[)", line)} for line in lines[:20])


def is_measured(path: Path, contacts: Path | None) -> bool:
    """Return True for a file of PeGS, or tables of grains and measured forces."""
    return _is_matlab(path) or (contacts is not None and _is_force_table(contacts))


def _read_tables(path: Path, contacts: Path) -> MeasuredForces:
    """Network from a table of grains and one of contacts."""
    packing = read(path)[0]
    grains, forces = _plain(path), _plain(contacts)
    for name in NEEDED.split():
        if name not in forces:
            raise PackingError(f"{contacts} has no column {name}: it has {' '.join(forces)}, and {NEEDED} are needed")
    n, count = len(packing.arrays["radius"]), len(forces["i"])
    order = np.arange(n) if packing.ids is None else np.argsort(grains["id"], kind="stable")
    grains = {name: values[order] for name, values in grains.items()}
    ids = np.arange(n) if packing.ids is None else packing.ids
    ends = np.stack([forces["i"], forces["j"]])
    wrong = ends[~np.isin(ends, ids)]
    if len(wrong):
        numbers = "the ids of grains" if packing.ids is not None else f"rows of grains, 0 to {n - 1}"
        raise PackingError(f"{contacts} names grain {wrong[0]:g}, which {path.name} does not have: use {numbers}")
    load = np.stack([grains.get(name, np.zeros(n)) for name in ("fx", "fy")], axis=1)
    held = np.flatnonzero(grains.get("fixed", np.zeros(n)))
    pairs = np.searchsorted(ids, ends)
    unknown = np.full(count, np.nan)
    return measured_forces(
        np.asarray(packing.arrays["position"])[:, :2], packing.arrays["radius"], *pairs, forces["fn"], forces["ft"],
        held=held, load=load, position_error=grains.get("positionerror", np.nan),
        force_n_error=forces.get("fnerror", unknown), force_t_error=forces.get("fterror", unknown), ids=ids,
    )  # fmt: skip


def _plain(path: Path) -> dict[str, np.ndarray]:
    """Columns of a table by plain names; PackingError if lengths are in pixels or forces in several units."""
    columns, _ = read_columns(path)
    units = {name: match[1].strip() for name in columns if (match := re.search(r"[\[(](.*?)[\])]", name))}
    for name, unit in units.items():
        if unit.lower() in PIXELS:
            raise PackingError(f"{path} has {name!r} in pixels: give lengths in the unit of length of the law")
    forces = {unit for name, unit in units.items() if plain_name(name) in FORCES}
    if len(forces) > 1:
        raise PackingError(f"{path} has forces in {' and '.join(sorted(forces))}: give them in one unit")
    return {plain_name(name): values for name, values in columns.items()}


def _read_pegs(path: Path) -> MeasuredForces:
    """Network from a file of PeGS."""
    grains = _particles(path)
    ids = np.array([int(_number(grain, "id", k + 1)) for k, grain in enumerate(grains)])
    scale = np.array([_number(grain, "rm", 0.0) / _number(grain, "r", 1.0) for grain in grains])
    if not (scale > 0).all():
        raise PackingError(f"{path} has no radii in metres (rm): units of length are missing; set the scale in PeGS")
    place = np.array([[_number(grain, "x"), _number(grain, "y")] for grain in grains]) * np.median(scale)
    seen: dict[tuple[int, int], list[tuple[float, float]]] = {}
    held = []
    for k, grain in enumerate(grains):
        near, size, angle = (np.atleast_1d(np.asarray(getattr(grain, n), float)) for n in PEGS[3:])
        if not len(near) == len(size) == len(angle):
            raise PackingError(f"{path} has {len(near)} neighbours and {len(size)} forces of grain {ids[k]}: solve it")
        held += [k] if (near <= 0).any() else []
        for other, force, alpha in zip(near, size, angle, strict=True):
            if other > 0 and np.isfinite(force) and other in ids:
                j = int(np.flatnonzero(ids == other)[0])
                seen.setdefault((min(k, j), max(k, j)), []).append((force * np.cos(alpha), force * np.sin(alpha)))
    both = {pair: np.array(values) for pair, values in seen.items() if len(values) == 2}
    if not both:
        raise PackingError(f"{path} has no contact that both of its grains see: solve for the forces in PeGS first")
    means = np.array([values.mean(axis=0) for values in both.values()])
    error = np.sqrt((np.array([np.subtract(*values) for values in both.values()]) ** 2).mean(axis=0)) / 2
    kept = means[:, 0] > 0
    pairs = np.array(list(both))[kept].T
    left = len(seen) - int(kept.sum())
    notes = [
        f"{path.name} is read in metres and newtons, y down as in the image; errors of forces {error[0]:.3g} N "
        f"(normal) and {error[1]:.3g} N (tangential) are half the differences between the two grains of a contact"
    ]
    notes += [f"{left} contacts were left out, which only one grain sees or which do not press"] if left else []
    return measured_forces(
        place, [_number(grain, "rm") for grain in grains], *pairs, *means[kept].T, held=held, ids=ids, notes=notes,
        force_n_error=error[0] or np.nan, force_t_error=error[1] or np.nan,
    )  # fmt: skip


def _particles(path: Path) -> list:
    """Grains of a file of PeGS, structures with its fields."""
    from scipy.io import loadmat

    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        raise PackingError(f"{path} is of MATLAB 7.3: save it with save(…, '-v7')") from None
    except Exception as problem:
        said = (str(problem) or type(problem).__name__).splitlines()[0][:80]
        raise PackingError(f"{path} is a damaged MATLAB file ({said}): save it again") from None
    name = next((name for name in ("particle", "pres") if name in content), None)
    if name is None:
        raise PackingError(f"{path} has no structure particle or pres: give a file that PeGS solved")
    grains = np.atleast_1d(content[name]).tolist()
    for field in PEGS:
        if not all(hasattr(grain, field) for grain in grains):
            raise PackingError(f"{path} has grains without {field}: give a file that PeGS solved")
    return grains


def _number(grain, field: str, default: float = np.nan) -> float:
    """Number in a field of a grain of PeGS; the default if there is none."""
    value = np.ravel(getattr(grain, field, default))
    return float(value[0]) if value.size else default
