"""Outlines of a packing and the direction of view, shared by drawings and the interactive view."""

import numpy as np

from ..core.arguments import require_shape
from ..core.measure import wrapped
from ..data.exchange.frame import Frame
from .quantities import Mode

ASIDE = 0.01  # largest share of the grains that may be out of view at each side of a movie or of snapshots
APART = 3.0  # gap to the others, in largest diameters, beyond which they may


def unit_mode(mode: Mode, frame: Frame) -> np.ndarray:
    """Translations of a mode, scaled so that the largest, divided by the grain's radius, is one."""
    radius = frame.state.grains.radius[:, None]
    require_shape((len(radius), 3), translation=mode[0], rotation=mode[1])
    largest = (np.sqrt((np.abs(mode[0]) ** 2).sum(axis=1, keepdims=True)) / radius).max()
    return mode[0] / largest if largest > 0 else mode[0]


def body_limits(place: np.ndarray, gap: float, share: float = ASIDE) -> np.ndarray:
    """(2, d) corners of positions (N, d), without grains that have left the others by more than a gap.

    At each side this leaves out at most a share of the grains, as those that roll away would shrink the picture.
    """
    corners, most = [], int(share * len(place))
    for x in np.sort(place, axis=0).T:
        wide = np.flatnonzero(np.diff(x) > gap)
        below, above = wide[wide < most], wide[wide >= len(x) - 1 - most]
        corners.append((x[below[-1] + 1] if len(below) else x[0], x[above[0]] if len(above) else x[-1]))
    return np.array(corners).T


def cell_edges(frame: Frame) -> np.ndarray:
    """(E, 2, 3) end points of the cell's edges along its periodic directions; none if nothing is periodic."""
    cell = frame.state.cell
    around = np.flatnonzero(cell.periodic)
    corners = np.array([[(m >> k) & 1 for k in range(len(around))] for m in range(2 ** len(around))], float)
    place = corners.reshape(len(corners), -1) @ cell.vectors[around]
    pairs = [(m, m | 1 << k) for m in range(len(corners)) for k in range(len(around)) if not m >> k & 1]
    return place[np.array(pairs, int).reshape(-1, 2)]


def wall_edges(frame: Frame) -> np.ndarray:
    """(E, 2, 3) end points of lines that show the walls: squares that span the packing, or lines in two dimensions."""
    state = frame.state
    place, radius, dim = wrapped(state), state.grains.radius[:, None], state.cell.dim
    low, high = (place - radius).min(axis=0), (place + radius).max(axis=0)
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
    """(3, 3) unit vectors to the right, up and toward the viewer.

    Three-dimensional packings are seen obliquely from above.
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
