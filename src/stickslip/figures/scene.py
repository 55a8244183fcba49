"""Outlines, view, and quantities shown by colour, shared by drawings, movies and the interactive view with K3D.

The interactive view is a self-contained page, or appears in a notebook. No other module imports K3D. The controls of
the page, for colours and motion, are in `view.js`, which calls K3D's interface in the browser.
"""

import base64
import json
import re
import zlib
from importlib.resources import files
from numbers import Real
from typing import Annotated, Any

import numpy as np
from matplotlib import colormaps

from ..core.arguments import FILLED, Requirement, checked, require_shape
from ..core.contacts.bonds import bond_vectors
from ..core.measure import wrapped
from ..core.readable import pluralize
from ..core.state import OPEN, SLIDE
from ..core.text import quoted
from ..core.units import current_units, unit_name, with_unit
from ..data.exchange.frame import Frame
from .style import BLUE, BOND, BROKEN, COLORS, RED

ASIDE = 0.05  # largest share of the grains that may be out of view on each side
FEW = 10  # number of grains below which all are in view
APART = 3.0  # gap to the others, in largest diameters, beyond which grains may be out of view
FAR = 3.0  # distance from the middle half of the grains, in its widths, beyond which grains may be out of view
PARTED = 1.3  # distance of the grains of a broken bond, over that at rest, beyond which the bond is not drawn
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


Zoom = Annotated[Any, Requirement(check_zoom)]  # enlargement of the view of grains that are together, or "all"


def body_limits(place: np.ndarray, gap: float, share: float = ASIDE) -> np.ndarray:
    """(2, d) corners of a box around positions (N, d), without grains far from the others, which would shrink the view.

    At most a fraction `share` of the grains is left out on each side: those beyond a gap, or far from the middle half.
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
    """(2, d) corners of the view: around the median position but within the box; if zoom < 1, larger than the box."""
    if zoom == "all":
        return box
    half = 0.5 * (box[1] - box[0]) / zoom
    ends = np.sort([box[0] + half, box[1] - half], axis=0)
    return np.clip(np.median(place, axis=0), *ends) + np.array([-half, half])


def outside(place: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(N,) bool, True for grains whose centres are outside a view."""
    return ((place < low) | (place > high)).any(axis=-1)


def outside_words(count: int) -> str:
    """Sentence on the number of grains outside a view."""
    return f"{pluralize(count, 'grain')} {'is' if count == 1 else 'are'} outside the view"


def drawn_bonds(frame: Frame) -> dict[str, np.ndarray]:
    """Columns i, j, branch and intact of the bonds of a frame; broken bonds only while their grains are close."""
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

    The pressure of a grain is p = (1/(d V)) Σ_c f·l, compression positive, with l from its centre to the contact and
    the volume V of the grain (area in two dimensions). It is absent if the law, and therefore the forces, are unknown.

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
    force = c["force_n"] * np.linalg.norm(c["branch"], axis=1)  # f·l, as tangential forces are normal to the branch
    other = np.where(c["j"] < len(radius), radius[np.minimum(c["j"], len(radius) - 1)], 0.0)
    share = radius[c["i"]] / (radius[c["i"]] + other)
    volume = np.pi * radius**2 if dim == 2 else 4 / 3 * np.pi * radius**3
    return _by_grain(frame, share * force, (1 - share) * force) / (dim * volume)


SMOOTH = 3000  # largest number of grains with antialiasing, which is slow without a graphics card
MOST = 24e6  # largest size of the frames in a page, before compression [bytes]
WIDTHS = (0.5, 1.0, 2.0, 4.0)  # widths of contact lines; also the upper limits of force over its mean, except the last
LINE = {2: 0.22, 3: 0.07}  # line width of a contact with the mean force, over the mean radius
LINES = {"stick": BLUE, "slide": RED, "bond": BOND, "broken": BROKEN}  # names and colours of lines
CEMENT = 2  # index of the width of bonds
KINDS = 8  # largest number of separate colours for materials
FOV = {2: 12.0, 3: 30.0}  # field of view [degrees], by dimension; rays are almost parallel in two dimensions
WITHOUT_WEBGL = """<script>
addEventListener("DOMContentLoaded", () => {
  if (!document.createElement("canvas").getContext("webgl2")) {
    document.body.textContent = "This browser has no WebGL 2, which the view in three dimensions needs: switch on "
      + "hardware acceleration in its settings, or open the page in another browser.";
  }
});
</script>"""
CONTENT = {"material", "coordination", "sliding contacts"}  # quantities with integer values


@checked
def view(
    frames: Annotated[list[Frame], FILLED], modes: list[Mode] | None = None, *,
    colour: str | None = None, height: int = 480, zoom: Zoom = 1.0,
):  # fmt: skip
    """Three-dimensional view of a packing for a notebook, as a K3D plot.

    Grains are balls coloured by a quantity. Contacts are lines from centre to centre, wider for larger normal forces,
    blue if they stick and red if they slide; bonds are sand-coloured, and purple once they are broken. The
    first mode, if any is given, is animated.

    Parameters
    ----------
    frames : from `frame_of`; the first is drawn
    modes : of the packing, from `read_mode`
    colour : one of `quantities`; default: the displacement of the mode, else the coordination
    height : height of the view [pixels]
    zoom : as in `packing`

    Raises
    ------
    ValueError
        If there is no such quantity, or the zoom is not allowed.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, law, _ = ss.io.read_packing("packing.npz")  # doctest: +SKIP
    >>> ss.figures.view([ss.io.frame_of(state, law)])  # doctest: +SKIP
    """
    data = view_data(frames[:1], modes or [], zoom=zoom)
    shown = _choose_quantity(data, colour)
    plot = _plot(data, shown, height)
    if modes:
        balls = next(item for item in plot.objects if item.name == "grains")
        start, u = np.asarray(balls.positions), unit_mode(modes[0], frames[0])
        turns, turn = np.arange(25) / 24, 2j * np.pi * (1 if modes[0][2].imag > 0 else -1)
        balls.positions = {f"{t:.4f}": (start + 0.3 * (u * np.exp(turn * t)).real).astype(np.float32) for t in turns}
    return plot


def page_view(
    frames: list[Frame], modes: list[Mode], *, at: int = 0, labels: list[str],
    colour: str | None = None, zoom: Zoom = 1.0,
) -> str:  # fmt: skip
    """Self-contained HTML document with controls, for frames and the modes of the frame `at`."""
    data = view_data(frames, modes, at=at, labels=labels, zoom=zoom)
    plot = _plot(data, _choose_quantity(data, colour), 480)
    here = files(__package__)
    packed = _in_base64(zlib.compress(json.dumps(data, default=_in_base64).encode(), 6))
    code = here.joinpath("view.js").read_text(encoding="utf-8").replace("[DATA]", packed)
    text = plot.get_snapshot(6, additional_js_code=code)
    # K3D's title contains the time of day
    return re.sub(r"<title>.*?</title>", "<title>packing</title>" + WITHOUT_WEBGL, text, count=1)


def view_data(
    frames: list[Frame], modes: list[Mode], *, at: int = 0, labels: list[str] | None = None, zoom: Zoom = 1.0
) -> dict:
    """Data for `view.js`, in which arrays are base64-encoded: float32 (int32 for i and j, uint8 for mode and size)."""
    size = max(40 * len(f.state.grains.radius) + 25 * len(f.contacts["i"]) for f in frames)
    count = min(len(frames), max(2, int(MOST / size)))  # as many as fit on a page, evenly spaced, with both ends
    chosen = sorted({at, *(round(k) for k in np.linspace(0, len(frames) - 1, count))})
    first, mode = frames[0], modes[0] if modes else None
    for translation, rotation, _ in modes:
        require_shape((len(first.state.grains.radius), 3), translation=translation, rotation=rotation)
    columns = [quantities(frames[k], first=first, mode=mode) for k in chosen]
    if len(chosen) > 1:
        columns[0]["displacement"] = (np.zeros(len(first.state.grains.radius)), columns[-1]["displacement"][1])
    names = [name for name in columns[0] if all(name in c for c in columns)]
    about = [_describe_quantity(name, [c[name] for c in columns]) for name in names]
    moves = []
    for one in modes:
        u, s = unit_mode(one, frames[at]), one[2]
        period = with_unit(f"period {2 * np.pi / abs(s.imag):.4g}", "time") if s.imag else "no period"
        grows = with_unit(f", e-folding time {1 / s.real:.4g}", "time") if s.real > 0 else ""
        u = u.conj() if s.imag > 0 else u  # `view.js` animates all modes as exp(-iωt)
        moves.append({"words": f"{period}{grows}", "re": np.float32(u.real), "im": np.float32(u.imag)})
    about = [a for a in about if a["low"] < a["high"] or a["name"] == "coordination"]
    out = [_frame_data(frames[k], labels[k] if labels else "") for k in chosen]
    for item, column in zip(out, columns, strict=True):
        item["values"] = {a["name"]: np.float32(column[a["name"]][0]) for a in about}
    radius, dim = first.state.grains.radius, first.state.cell.dim
    red, green, blue = np.round(255 * colormaps["viridis"](np.arange(256))[:, :3]).astype(int).T
    # a motion begins with its first frame, a load path is shown at its end
    start = 0 if first.state.time < frames[-1].state.time else len(chosen) - 1
    return {
        "dim": dim, "n": len(radius), "radius": np.float32(radius), "frames": out,
        "left_out": len(frames) - len(chosen), "quantities": about, "mode_frame": chosen.index(at), "start": start,
        "modes": moves,
        "eye": view_basis(first).tolist(), "box": view_box([frames[k] for k in chosen], zoom).tolist(), "fov": FOV[dim],
        "map": (red << 16 | green << 8 | blue).tolist(),  # 0xrrggbb
        "lines": list(LINES) if any(frame.state.bonds for frame in frames) else list(LINES)[:2],
        "colours": {name: _to_int(c) for name, c in LINES.items()} | {"kinds": [_to_int(c) for c in COLORS]},
        "widths": [float(LINE[dim] * w * radius.mean()) for w in WIDTHS],
    }  # fmt: skip


def _describe_quantity(name: str, series: list[tuple[np.ndarray, str]]) -> dict:
    """Name, unit and range of a quantity; for the material, also `kinds`, the values with separate colours."""
    values = np.concatenate([v for v, _ in series]).astype(float)
    low, high = float(values.min()), float(values.max())
    if name == "material":
        return {"name": name, "unit": "", "low": low, "high": high, "kinds": sorted({int(v) for v in values})[:KINDS]}
    beyond = float(np.quantile(values, 0.995))
    cut = name not in CONTENT and high > 2 * beyond > 0
    return {"name": name, "unit": series[0][1], "low": low, "high": beyond if cut else high, "cut": bool(cut)}


def _frame_data(frame: Frame, label: str) -> dict:
    state, bonds, touch = frame.state, drawn_bonds(frame), frame.contacts["mode"] != OPEN
    c = {name: column[touch] for name, column in frame.contacts.items()}
    force = np.asarray(c.get("force_n", np.ones(len(c["i"]))), float)
    mean = force.mean() if len(force) and force.mean() > 0 else 1.0
    i, j, branch = (np.concatenate([c[name], bonds[name]]) for name in ("i", "j", "branch"))
    kind = np.concatenate([c["mode"] == SLIDE, np.where(bonds["intact"], 2, 3)])
    size = np.append(np.searchsorted(WIDTHS[:-1], force / mean), np.full(len(bonds["i"]), CEMENT))
    return {
        "label": label, "position": np.float32(wrapped(state)), "i": np.int32(i), "j": np.int32(j),
        "branch": np.float32(branch), "mode": np.uint8(kind), "size": np.uint8(size),
        "edges": np.float32(cell_edges(frame)), "walls": np.float32(wall_edges(frame)),
    }  # fmt: skip


def _choose_quantity(data: dict, colour: str | None) -> int:
    """Index of the quantity that initially colours the grains."""
    names = [a["name"] for a in data["quantities"]]
    if colour is not None and colour not in names:
        raise ValueError(f"the colour {colour!r} is not available: these grains have {', '.join(names)}")
    wanted = [colour, DISPLACEMENT, "speed", "coordination"]
    data["shown"] = next((names.index(name) for name in wanted if name in names), 0)
    return data["shown"]


def _plot(data: dict, shown: int, height: int):
    """K3D plot of the first frame."""
    import k3d  # the import takes a third of a second, and only this function needs it

    frame, about = data["frames"][0], data["quantities"][shown]
    position, branch, values = frame["position"], frame["branch"], frame["values"][about["name"]]
    span = (about["high"] - about["low"]) or 1.0
    share = np.clip((values - about["low"]) / span, 0, 1)
    colors = np.array(data["map"], np.uint32)[(255 * share).astype(int)]
    sizes = 2 * data["radius"]
    plot = k3d.plot(
        height=height, grid_visible=False, menu_visibility=False, camera_auto_fit=False, background_color=0xFFFFFF,
        camera_fov=data["fov"], camera_no_rotate=data["dim"] == 2, colorbar_object_id=0, axes_helper=0.6,
        lighting=1.6, antialias=2 if data["n"] <= SMOOTH else 0,
    )  # fmt: skip
    plot += k3d.points(position, point_sizes=sizes, colors=colors, shader="3d", name="grains")
    start = position[frame["i"]] + ([0, 0, 1.05 * sizes.max() / 2] if data["dim"] == 2 else 0)
    for kind, name in enumerate(data["lines"]):
        for number, width in enumerate(data["widths"]):
            if kind > 1 and number != CEMENT:
                continue
            rows = (frame["mode"] == kind) & (frame["size"] == number)
            ends = np.stack([start[rows], start[rows] - branch[rows]], axis=1)
            plot += _lines(k3d, ends, f"{name} {number}", data["colours"][name], width)
    for name, color in (("edges", 0x555555), ("walls", 0x8A6D3B)):
        plot += _lines(k3d, frame[name], name, color, 0.1 * float(sizes.mean() / 2))
    low, high = np.array(data["box"])
    _, up, toward = np.array(data["eye"])
    center, reach = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))  # sphere around the box
    away = 0.9 * reach / np.sin(np.radians(data["fov"] / 2))
    plot.camera = [float(v) for v in (*(center + away * toward), *center, *up)]  # position, target and up vector
    return plot


def _lines(k3d, ends: np.ndarray, name: str, color: int, width: float):
    """Line segments (E, 2, 3); a single segment of zero length if there are none, because K3D requires at least one."""
    ends = ends.astype(np.float32).reshape(-1, 3) if len(ends) else np.zeros((2, 3), np.float32)
    rows = np.arange(len(ends), dtype=np.uint32)
    return k3d.lines(ends, rows, indices_type="segment", color=color, width=width, shader="thick", name=name)


def view_box(frames: list[Frame], zoom: Zoom = 1.0) -> np.ndarray:
    """(2, 3) corners of the box shown by the camera: grains that are together, and cells, in all frames."""
    share, places, corners = 0.0 if zoom == "all" else ASIDE, [], []
    for frame in frames:
        position, radius = wrapped(frame.state), frame.state.grains.radius.max()
        limits = body_limits(position, 2 * APART * radius, share) + radius * np.array([[-1.0], [1.0]])
        places.append(position)
        corners += [*limits, *cell_edges(frame).reshape(-1, 3)]
    return zoomed(np.array([np.min(corners, axis=0), np.max(corners, axis=0)]), np.concatenate(places), zoom)


def count_out_of_view(frames: list[Frame], zoom: Zoom = 1.0) -> int:
    """Number of grains outside the box in at least one frame."""
    box = view_box(frames, zoom)
    return int(np.any([outside(wrapped(frame.state), *box) for frame in frames], axis=0).sum())


def _in_base64(content: bytes | np.ndarray) -> str:
    return base64.b64encode(bytes(content)).decode()


def _to_int(color: str) -> int:
    return int(color[1:], 16)
