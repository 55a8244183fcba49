"""Outlines, view, and quantities shown by colour, shared by drawings, movies and the interactive view."""

from numbers import Real
from typing import Annotated, Any

import numpy as np

from ..core.arguments import Requirement, require_shape
from ..core.contacts.bonds import bond_vectors
from ..core.measure import wrapped
from ..core.readable import pluralize
from ..core.state import SLIDE
from ..core.text import quoted
from ..core.units import current_units, unit_name
from ..data.exchange.frame import Frame

ASIDE = 0.05  # largest share of the grains that may be out of view at each side
FEW = 10  # number of grains below which all are in view
APART = 3.0  # gap to the others, in largest diameters, beyond which grains may be out of view
FAR = 3.0  # distance from the middle half of the grains, in widths of that half, beyond which they also may
PARTED = 1.3  # distance of the grains of a broken bond, over that at rest, beyond which it is not drawn
ZOOMS = (0.01, 1000.0)  # smallest and largest enlargement
Mode = tuple[np.ndarray, np.ndarray, complex]  # translation, rotation (N, 3) complex; exponent, as from `read_mode`
DISPLACEMENT = "mode displacement"


def unit_mode(mode: Mode, frame: Frame) -> np.ndarray:
    """Translations of a mode, scaled so that the largest, divided by the grain's radius, is one."""
    radius = frame.state.grains.radius[:, None]
    require_shape((len(radius), 3), translation=mode[0], rotation=mode[1])
    largest = (np.sqrt((np.abs(mode[0]) ** 2).sum(axis=1, keepdims=True)) / radius).max()
    return mode[0] / largest if largest > 0 else mode[0]


def check_zoom(name: str, zoom) -> None:
    """Raise ValueError if a zoom is neither a number within bounds nor "all"."""
    (low, high), number = ZOOMS, isinstance(zoom, Real) and not isinstance(zoom, bool)
    if not (low <= zoom <= high if number else isinstance(zoom, str) and zoom == "all"):
        got = f"{zoom:g}" if number else quoted(zoom)
        raise ValueError(f"{name} must be from {low:g} to {high:g}, or all for every grain, got {got}")


Zoom = Annotated[Any, Requirement(check_zoom)]  # enlargement of the view on grains that are together, or "all"


def body_limits(place: np.ndarray, gap: float, share: float = ASIDE) -> np.ndarray:
    """(2, d) corners of positions (N, d), without grains far from the others, which would shrink the picture.

    These are at most a fraction of the grains at each side, beyond a gap or far beyond the middle half.
    """
    corners, most = [], int(np.ceil(share * len(place))) if len(place) >= FEW else 0
    for x in np.sort(place, axis=0).T:
        low, high = np.quantile(x, (0.25, 0.75))
        reach = FAR * (high - low) + gap
        wide = np.diff(x) > gap
        left = np.flatnonzero(wide | (x[1:] >= low - reach) & (x[:-1] < low - reach))
        right = np.flatnonzero(wide | (x[:-1] <= high + reach) & (x[1:] > high + reach))
        below, above = left[left < most], right[right >= len(x) - 1 - most]
        corners.append((x[below[-1] + 1] if len(below) else x[0], x[above[0]] if len(above) else x[-1]))
    return np.array(corners).T


def zoomed(box: np.ndarray, place: np.ndarray, zoom: Zoom) -> np.ndarray:
    """(2, d) corners of an enlarged view: within the box, around the median position, or around the box if zoom < 1."""
    if zoom == "all":
        return box
    half = 0.5 * (box[1] - box[0]) / zoom
    ends = np.sort([box[0] + half, box[1] - half], axis=0)
    return np.clip(np.median(place, axis=0), *ends) + np.array([-half, half])


def outside(place: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(N,) bool, True for grains whose centres are outside a view."""
    return ((place < low) | (place > high)).any(axis=-1)


def outside_words(count: int) -> str:
    """Sentence on grains outside a view."""
    return f"{pluralize(count, 'grain')} {'is' if count == 1 else 'are'} outside the view"


def drawn_bonds(frame: Frame) -> dict[str, np.ndarray]:
    """Columns i, j, branch and intact of the bonds of a frame; broken ones only while their grains are near."""
    state, bonds = frame.state, frame.state.bonds
    if not bonds:
        nothing = np.zeros(0, np.int32)
        return {"i": nothing, "j": nothing, "branch": np.zeros((0, 3)), "intact": np.zeros(0, bool)}
    branch = bond_vectors(bonds, state.grains.position, state.cell.vectors)
    rows = bonds.intact | (np.linalg.norm(branch, axis=1) <= PARTED * bonds.length)
    return {"i": bonds.i[rows], "j": bonds.j[rows], "branch": branch[rows], "intact": bonds.intact[rows]}


def cell_edges(frame: Frame) -> np.ndarray:
    """(E, 2, 3) end points of the cell's edges along its periodic directions; none if nothing is periodic."""
    cell = frame.state.cell
    around = np.flatnonzero(cell.periodic)
    corners = np.array([[(m >> k) & 1 for k in range(len(around))] for m in range(2 ** len(around))], float)
    position = corners.reshape(len(corners), -1) @ cell.vectors[around]
    pairs = [(m, m | 1 << k) for m in range(len(corners)) for k in range(len(around)) if not m >> k & 1]
    return position[np.array(pairs, int).reshape(-1, 2)]


def wall_edges(frame: Frame) -> np.ndarray:
    """(E, 2, 3) end points of lines that show the walls: squares that span the packing, or lines in two dimensions."""
    state = frame.state
    position, radius, dim = wrapped(state), state.grains.radius[:, None], state.cell.dim
    low, high = (position - radius).min(axis=0), (position + radius).max(axis=0)
    center, half = 0.5 * (low + high), 0.5 * (high - low)
    out = []
    for point, normal in zip(state.walls.point, state.walls.normal, strict=True):
        middle = center - ((center - point) @ normal) * normal
        first = np.cross(normal, [0, 0, 1.0]) if dim == 2 or abs(normal[2]) < 0.9 else np.cross(normal, [0, 1.0, 0])
        first /= np.linalg.norm(first)
        a = first * (np.abs(first) @ half)
        if dim == 2:
            out.append([middle - a, middle + a])
            continue
        second = np.cross(normal, first)
        b = second * (np.abs(second) @ half)
        ring = [middle - a - b, middle + a - b, middle + a + b, middle - a + b]
        out += [[p, q] for p, q in zip(ring, ring[1:] + ring[:1], strict=True)]
    return np.array(out).reshape(-1, 2, 3)


def view_basis(frame: Frame) -> np.ndarray:
    """(3, 3) unit vectors to the right, up and towards the viewer.

    Three-dimensional packings are viewed obliquely from above.
    """
    up = np.array(up_direction(frame))
    if frame.state.cell.dim == 2:
        return np.eye(3)
    side = np.cross(up, [1.0, 0, 0]) if abs(up[0]) < 0.9 else np.cross(up, [0, 1.0, 0])
    toward = -0.9 * side + 0.55 * np.cross(side, up) + 0.45 * up
    toward /= np.linalg.norm(toward)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right), toward])


def up_direction(frame: Frame) -> list[float]:
    """Upward direction: against gravity if there is any; else y in two dimensions, or the only open direction, or z."""
    gravity, cell = np.asarray(frame.state.control.gravity, float), frame.state.cell
    if gravity.any():
        return [float(v) for v in -gravity / np.linalg.norm(gravity)]
    bounded = np.flatnonzero(~cell.periodic)
    axis = 1 if cell.dim == 2 else int(bounded[0]) if len(bounded) == 1 else 2
    return np.eye(3)[axis].tolist()


def quantities(
    frame: Frame, *, first: Frame | None = None, mode: Mode | None = None
) -> dict[str, tuple[np.ndarray, str]]:
    """Quantities by which the grains of a frame can be coloured, as {name: (values per grain, unit)}.

    The pressure of a grain is p = (1/(d V)) Σ_c f·l, with l from its centre to the contact, V its own volume (area in
    two dimensions) and compression positive. It is absent if the law, and therefore the forces, are unknown.

    Parameters
    ----------
    frame : from `frame_of`
    first : an earlier frame, for displacements since then
    mode : translation, rotation and exponent; its displacements are relative to the largest

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> quantities(ss.io.frame_of(pair, law))["coordination"][0]
    array([1, 1])
    """
    grains, dim = frame.state.grains, frame.state.cell.dim
    length, speed = unit_name("length"), unit_name("length/time")
    slides = (frame.contacts["mode"] == SLIDE).astype(float)
    out = {
        "radius": (grains.radius, length),
        "material": (grains.material, ""),
        "coordination": (frame.grains["coordination"], ""),
        "sliding contacts": (_by_grain(frame, slides, slides).astype(int), ""),
    }
    if "force_n" in frame.contacts:
        plain = "force/length" if dim == 2 else "force/length²"
        unit = unit_name("force/length^(dim-1)", dim) if current_units() else plain
        out["pressure"] = (_pressure(frame), unit)
    out["speed"] = (np.linalg.norm(grains.velocity, axis=1), speed)
    if first is not None and first is not frame and len(first.state.grains.radius) == len(grains.radius):
        moved = grains.position - first.state.grains.position
        out["displacement"] = (np.linalg.norm(moved, axis=1), length)
    if mode is not None:
        for name, part in ((DISPLACEMENT, mode[0]), ("mode rotation", mode[1])):
            size = np.sqrt((np.abs(part) ** 2).sum(axis=1))
            out[name] = (size / size.max() if size.max() > 0 else size, "fraction of the largest")
    return {name: (np.asarray(values), unit) for name, (values, unit) in out.items()}


def _by_grain(frame: Frame, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Sum contributions of contacts to their two grains; walls are ignored."""
    c, n = frame.contacts, len(frame.state.grains.radius)
    ends, values = np.concatenate([c["i"], c["j"]]), np.concatenate([i, j])
    return np.bincount(ends[ends < n], values[ends < n], minlength=n)


def _pressure(frame: Frame) -> np.ndarray:
    c, radius, dim = frame.contacts, frame.state.grains.radius, frame.state.cell.dim
    force = c["force_n"] * np.linalg.norm(
        c["branch"], axis=1
    )  # f·l: the tangential force has no component along the branch
    other = np.where(c["j"] < len(radius), radius[np.minimum(c["j"], len(radius) - 1)], 0.0)
    share = radius[c["i"]] / (radius[c["i"]] + other)
    volume = np.pi * radius**2 if dim == 2 else 4 / 3 * np.pi * radius**3
    return _by_grain(frame, share * force, (1 - share) * force) / (dim * volume)
