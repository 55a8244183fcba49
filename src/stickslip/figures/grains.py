"""Drawing of a packing in two or three dimensions: grains, force chains, contact status, and a mode."""

from typing import NamedTuple

import numpy as np
from matplotlib import colormaps, rcParams
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.lines import Line2D
from matplotlib.path import Path

from ..core.arguments import Bodies, Numbers, Positive, checked, knows_bonds
from ..core.laws.builtin import Law
from ..core.measure import Committed, branch_vectors, least_supports, rattlers, touching, wrapped
from ..core.state import OPEN, SLIDE, STICK, State
from ..data.exchange.frame import Frame, frame_of
from .scene import (
    APART,
    ASIDE,
    Mode,
    Zoom,
    body_limits,
    cell_edges,
    drawn_bonds,
    outside,
    outside_words,
    quantities,
    unit_mode,
    view_basis,
    wall_edges,
    zoomed,
)
from .style import BLACK, BLUE, BOND, BROKEN, PURPLE, RED, WIDTH, label_axes, styled, subplots

GREY, PALE = "#b4bac0", "#e4e9ee"
NEAR = 0.01  # largest gap of open pairs that are drawn, over the mean radius
SLABS = 32  # number of slabs by depth, drawn from back to front, of balls and pieces of lines
PIECES = 6  # largest number of pieces of a contact line, each in its own slab
SHINING = 2000  # number of grains up to which balls have a highlight, which would be invisible on smaller balls
SHINE = (-0.35, 0.4, 0.3)  # position and size of the highlight on a ball, over its radius
BALL = {2: 1.0, 3: 0.6}  # ratio of drawn to true radius, by dimension; lines between balls must be visible
THICK = 1.1  # line width of a contact with the mean force [points], unless `THIN` limits it
CASING = 0.7  # additional width of the white lines beneath contact lines on coloured grains [points]
CEMENT = 3.0  # width of a bond over that of a contact with the mean force
THIN = 0.1  # largest line width of such a contact over the mean diameter, so that lines do not hide the grains
MOST = 6.0  # multiple of the mean force above which lines do not get thicker
WIDEST = 100.0  # largest width of a figure [inches]
LEGEND = 1.6  # width of a column of the legend [inches]
ORBIT = np.exp(2j * np.pi * np.arange(49) / 48)


class Layout(NamedTuple):
    """Settings of a drawing, common to all frames of a movie."""

    dim: int
    low: np.ndarray  # corners of the drawing, in its plane
    high: np.ndarray
    mean: float  # contact force drawn with line width THICK
    colour: str | None = None
    unit: str = ""
    limits: tuple[float, float] = (0.0, 1.0)
    whole: bool = False  # True if the coloured quantity is an integer
    cut: bool = False  # True if some values are above the limits


@styled
@knows_bonds
def packing(
    state: Committed, law: Law | None = None, *, mode: Mode | None = None, colour: str | None = None, title: str = "",
    width: Positive = WIDTH, zoom: Zoom = 1.0,
):  # fmt: skip
    """Grains, contacts (width by normal force, colour by status), bonds, walls, cell, and the orbits of a mode.

    A mode moves grain i along Re(u_i exp(−iωt)), an ellipse. It is drawn at each grain, with an arrow at t = 0. All
    ellipses are enlarged by the same factor, so that the largest reaches one mean radius. In three dimensions, balls
    are drawn at 0.6 times their size.

    Parameters
    ----------
    state : accepted state
    law : contact law; without it, forces are unknown, and all contacts have the same width
    mode : translation, rotation and exponent, as returned by `read_mode`
    colour : one of `quantities`; without it, rattlers are white and other grains grey
    width : width of the figure [inches]
    zoom : enlargement of the view of the grains. A few grains far from the others, at most 5 % on each side, are left
    outside the view, and the figure states their number; "all" shows every grain

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If there is no such quantity, or the zoom is not allowed.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> ss.figures.packing(pair, law).axes[0].get_title()
    ''
    """
    if width > WIDEST:
        raise ValueError(f"width must be at most {WIDEST:g} inches, got {width:g}")
    frame = frame_of(state, law) if law is not None else bare_frame(state)
    layout = layout_of([frame], colour=colour, mode=mode, zoom=zoom)
    wide, tall = layout.high - layout.low
    figure, axes = subplots(figsize=(width, min(width * tall / wide, 1.6 * width) + (1.0 if colour else 0.6)))
    drawn = draw(axes, frame, layout, mode=mode)
    if mode is not None:
        draw_orbits(axes, frame, mode)
    if colour:
        draw_colour_bar(figure, drawn, layout, ax=axes, location="bottom", shrink=0.7, aspect=30, pad=0.02)
    draw_legend(axes, frame, mode, colour=colour)
    axes.set_title(title)
    return figure


def bare_frame(state: State) -> Frame:
    """Frame of a state whose law is unknown: its contacts have no forces."""
    c, rows = state.contacts, touching(state)
    contacts = {name: getattr(c, name)[rows] for name in ("i", "j", "mode")} | {"branch": branch_vectors(state)[rows]}
    ends = np.concatenate([contacts["i"], contacts["j"]])
    n = len(state.grains.radius)
    return Frame(state, law=None, grains={"coordination": np.bincount(ends[ends < n], minlength=n)}, contacts=contacts)


def layout_of(frames: list[Frame], *, colour: str | None = None, mode: Mode | None = None, zoom: Zoom = 1.0) -> Layout:
    """Common limits of the drawing and of the colours for all frames."""
    corners = []
    for frame in frames:  # grains, cell, and nearby parts of walls
        basis, radius = view_basis(frame), BALL[frame.state.cell.dim] * frame.state.grains.radius
        gap = 2 * APART * frame.state.grains.radius.max()
        low, high = body_limits(_places(frame), gap, 0.0 if zoom == "all" else ASIDE)
        low, high = low - radius.max(), high + radius.max()
        walls = np.clip(_projected(wall_edges(frame), basis).reshape(-1, 2), low - radius.max(), high + radius.max())
        corners += [low, high, *_projected(cell_edges(frame), basis).reshape(-1, 2), *walls]
    box = np.array([np.min(corners, axis=0), np.max(corners, axis=0)])
    low, high = zoomed(box, np.concatenate([_places(frame) for frame in frames]), zoom)
    forces = np.concatenate([_normal_forces(frame) for frame in frames])
    mean = float(forces.mean()) if len(forces) and forces.mean() > 0 else 1.0
    layout = Layout(frames[0].state.cell.dim, low, high, mean)
    if colour is None:
        return layout
    values, units = [], ""
    for frame in frames:
        fields = quantities(frame, first=frames[0], mode=mode)
        if colour == "displacement" and frame is frames[0] and len(frames) > 1:
            continue
        if colour not in fields:
            raise ValueError(f"the colour {colour!r} is not available: these grains have {', '.join(fields)}")
        values.append(fields[colour][0])
        units = fields[colour][1]
    every = np.concatenate(values)
    limits = (float(every.min()), float(np.quantile(every, 0.995)))
    return layout._replace(
        colour=colour, unit=units, limits=limits, whole=every.dtype.kind in "iu", cut=bool(every.max() > limits[1])
    )


def draw(
    axes, frame: Frame, layout: Layout, *, mode: Mode | None = None, first: Frame | None = None,
    near: bool = True,
):  # fmt: skip
    """Draw one frame from back to front; return the mappable for a colour bar."""
    state, dim = frame.state, layout.dim
    basis, radius = view_basis(frame), BALL[dim] * state.grains.radius
    position = wrapped(state) @ basis.T
    colors = _face_colours(frame, layout, mode, first)
    drawn = ScalarMappable(Normalize(*layout.limits), cmap="viridis")
    i, j, start, ends, width, color = _contact_lines(axes, frame, layout, position, basis)
    casing = CASING if layout.colour else 0.0
    slab, back = np.zeros(len(position), int), np.zeros(len(start), int)
    if dim == 3:
        start, ends, width, color = _visible_pieces(frame, i, j, start, ends, width, color)
        slab, back = (_depth_slabs(z, position[:, 2]) for z in (position[:, 2], 0.5 * (start[:, 2] + ends[:, 2])))
    for number in np.unique(slab):
        rows = slab == number
        draw_disks(axes, position[rows, :2], radius[rows], facecolors=colors[rows], linewidths=0.3, zorder=2 + number)
        if dim == 3 and len(position) <= SHINING:
            x, y, size = SHINE
            draw_disks(
                axes, position[rows, :2] + radius[rows, None] * [x, y], size * radius[rows],
                facecolors=(1.0, 1.0, 1.0, 0.35), edgecolors="none", linewidths=0.3, zorder=2.3 + number,
            )  # fmt: skip
    for number in np.unique(back):
        rows = back == number
        for more, shade in ((casing, to_rgba("white")), (0.0, color[rows]))[not casing :]:
            drawn_lines = _segments(axes, start[rows, :2], ends[rows, :2], width[rows] + more, shade)
            drawn_lines.set_zorder(2.7 + number)
            axes.add_collection(drawn_lines, autolim=False)
    _draw_outlines(axes, cell_edges(frame) @ basis.T, position[:, 2], dim, zorder=1, colors=BLACK, linewidths=0.5)
    _draw_outlines(axes, wall_edges(frame) @ basis.T, position[:, 2], dim, zorder=50, colors="0.25", linewidths=0.9)
    if near:
        rows, c = _nearly_touching(frame), state.contacts
        _, _, _, *gaps = _split_at_edges(frame, position, c.i[rows], c.j[rows], branch_vectors(state)[rows] @ basis.T)
        gaps = np.stack(gaps, axis=1)
        if casing:
            _draw_outlines(axes, gaps, position[:, 2], dim, zorder=2.65, colors="white", linewidths=0.5 + casing)
        _draw_outlines(axes, gaps, position[:, 2], dim, zorder=49, colors=BLACK, linewidths=0.6, linestyles=":")
    low, high = view_limits(layout)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal")
    axes.axis("off")
    margin = high[1] - layout.high[1]  # white covers grains below the view, and the row of pixels at the cut
    below = low[1] - 0.5 * margin, layout.low[1] - margin
    axes.axhspan(*below, -0.01, 1.01, facecolor="white", lw=0, zorder=60, clip_on=False)
    long = 2 * float(state.grains.radius.mean())  # width of the scale bar
    x, y = layout.low[0], layout.low[1] - 0.04 * (layout.high - layout.low).max()
    axes.plot([x, x + long], [y, y], color=BLACK, lw=1.5, solid_capstyle="butt", zorder=70)
    away = int(outside(position[:, :2], layout.low, layout.high).sum())
    words = " mean diameter" + (f"; {outside_words(away)}" if away else "")
    axes.annotate(words, (x + long, y), va="center", fontsize=rcParams["legend.fontsize"], zorder=70)
    return drawn


def count_outside(frames: list[Frame], layout: Layout) -> int:
    """Number of grains outside the view in at least one frame."""
    return int(np.any([outside(_places(frame), layout.low, layout.high) for frame in frames], axis=0).sum())


def view_limits(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the drawing with its margins, and room for the scale bar below."""
    margin = 0.01 * (layout.high - layout.low).max()
    return layout.low - [margin, 6 * margin], layout.high + margin


def draw_disks(axes, place: np.ndarray, radius: np.ndarray, *, edgecolors: str = "0.45", **style) -> EllipseCollection:
    """Draw disks in data coordinates, without changing the limits of the axes; return the collection."""
    disks = EllipseCollection(
        2 * radius, 2 * radius, 0 * radius, units="xy", offsets=place, offset_transform=axes.transData,
        edgecolors=edgecolors, **style,
    )  # fmt: skip
    return axes.add_collection(disks, autolim=False)


def _draw_outlines(axes, lines: np.ndarray, depth: np.ndarray, dim: int, *, zorder: float, **style) -> None:
    """Draw lines (E, 2, 3), in three dimensions in pieces between the balls, whose depths are `depth`."""
    if dim == 2 or not len(lines):
        axes.add_collection(LineCollection(lines[..., :2], zorder=zorder, **style), autolim=False)
        return
    share = np.linspace(0, 1, SLABS + 1)[:, None]
    path = lines[:, :1] + share * (lines[:, 1:] - lines[:, :1])
    pieces = np.stack([path[:, :-1], path[:, 1:]], axis=2).reshape(-1, 2, 3)
    slab = _depth_slabs(pieces[..., 2].mean(axis=1), depth)
    for number in np.unique(slab):
        collection = LineCollection(pieces[slab == number, :, :2], zorder=2.6 + number, **style)
        axes.add_collection(collection, autolim=False)


def _visible_pieces(frame: Frame, i, j, start: np.ndarray, ends: np.ndarray, width: np.ndarray, color: np.ndarray):
    """Pieces of the lines between the surfaces of drawn balls, each with its own depth."""
    radius = BALL[3] * frame.state.grains.radius
    long = np.linalg.norm(ends - start, axis=1)
    other = np.where(j < len(radius), radius[np.minimum(j, len(radius) - 1)], 0.0)
    first, last = radius[i] / long, 1 - other / long
    reach = (np.ptp(start[:, 2]) if len(start) else 0.0) or 1.0
    count = int(np.clip(np.ceil(SLABS * long.max(initial=0.0) / reach), 1, PIECES))
    share = first[:, None] + (last - first)[:, None] * np.linspace(0, 1, count + 1)
    path = start[:, None] + share[..., None] * (ends - start)[:, None]
    pieces = (path[:, :-1].reshape(-1, 3), path[:, 1:].reshape(-1, 3))
    return *pieces, np.repeat(width, count), np.repeat(color, count, axis=0)


def _segments(axes, start: np.ndarray, ends: np.ndarray, width: np.ndarray, color: np.ndarray) -> EllipseCollection:
    """Line segments as ellipses of zero height with a common path, as a `LineCollection` makes a path for each line."""
    along = ends - start
    angle = np.degrees(np.arctan2(along[:, 1], along[:, 0]))
    lines = EllipseCollection(
        np.hypot(*along.T), 0 * angle, angle, units="xy", offsets=0.5 * (start + ends), offset_transform=axes.transData,
        facecolors="none", edgecolors=color, capstyle="round",
    )  # fmt: skip
    lines.set_linewidth(width)
    lines.set_paths([Path([[-1.0, 0.0], [1.0, 0.0]])])
    return lines


def draw_orbits(axes, frame: Frame, mode: Mode) -> None:
    """Draw the ellipse along which a mode moves each grain, with an arrow at its start, in front of the grain."""
    basis, radius = view_basis(frame), frame.state.grains.radius.mean()
    position = wrapped(frame.state) @ basis.T
    u = unit_mode(mode, frame) @ basis.T
    u = (u.conj() if mode[2].imag > 0 else u)[:, :2] * (0.9 * radius / np.abs(unit_mode(mode, frame)).max())
    seen = np.abs(u).max(axis=1) > 0.02 * radius
    slab = _depth_slabs(position[:, 2], position[:, 2]) if frame.state.cell.dim == 3 else np.zeros(len(position), int)
    for number in np.unique(slab[seen]):
        rows = seen & (slab == number)
        path = position[rows, None, :2] + (u[rows, None] * ORBIT.conj()[None, :, None]).real
        axes.add_collection(LineCollection(path, colors=BLACK, linewidths=0.7, zorder=2.8 + number))
        axes.quiver(
            *position[rows, :2].T, *u[rows].real.T, angles="xy", scale_units="xy", scale=1, color=PURPLE, width=0.005,
            headwidth=4, headlength=4, headaxislength=3.5, zorder=2.9 + number,
        )  # fmt: skip


def draw_legend(axes, frame: Frame, mode: Mode | None = None, *, near: bool = True, colour: str | None = None) -> None:
    """Draw the legend of lines and balls below the drawing."""
    handles = legend_handles(frame, mode, near=near, colour=colour)
    columns = min(len(handles), legend_columns(axes.figure.get_figwidth()))
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=columns, columnspacing=1.2)


def legend_columns(inches: float) -> int:
    """Number of columns of the legend of a figure of this width."""
    return max(1, int(inches // LEGEND))


def legend_handles(frame: Frame, mode: Mode | None = None, *, near: bool = True, colour: str | None = None) -> list:
    """Legend entries for the lines and balls in a drawing, with their names and counts."""
    sticks, slides = (int((frame.contacts["mode"] == mode).sum()) for mode in (STICK, SLIDE))
    handles = [
        Line2D([], [], color=BLUE, lw=2, label=f"contact sticks ({sticks})"),
        Line2D([], [], color=RED, lw=2, label=f"slides ({slides})"),
    ]
    if frame.state.bonds:
        held = int(frame.state.bonds.intact.sum())
        handles.append(Line2D([], [], color=BOND, lw=4, label=f"bond ({held})"))
        handles.append(Line2D([], [], color=BROKEN, lw=4, label=f"broken ({len(frame.state.bonds.i) - held})"))
    if near and (number := len(_nearly_touching(frame))):
        handles.append(Line2D([], [], color="0.35", lw=0.8, ls=":", label=f"open ({number})"))
    if colour is None and (free := int(_rattlers(frame).sum())):
        handles.append(Line2D([], [], ls="", marker="o", mfc="white", mec="0.45", ms=5, label=f"rattlers ({free})"))
    if mode is not None:
        handles.append(Line2D([], [], color=BLACK, lw=0.7, label="orbit (enlarged)"))
        handles.append(Line2D([], [], color=PURPLE, lw=1.2, marker=">", ms=3, label="start of the orbit"))
    if frame.state.cell.periodic.any():
        handles.append(Line2D([], [], color=BLACK, lw=0.5, label="periodic cell"))
    if len(frame.state.walls.mass):
        handles.append(Line2D([], [], color="0.25", lw=0.9, label="walls"))
    return handles


def draw_colour_bar(figure, drawn, layout: Layout, **place) -> None:
    """Draw a horizontal colour bar; `place` is passed to `Figure.colorbar`."""
    bar = figure.colorbar(drawn, extend="max" if layout.cut else "neither", **place)
    label_axes(bar.ax, x=(layout.colour, layout.unit), whole="x" if layout.whole else "")


def _rattlers(frame: Frame) -> np.ndarray:
    """(N,) bool, True for rattlers; a frame without a law is drawn as if it had friction."""
    return rattlers(frame.state, least_supports(frame.law, frame.state.cell.dim) if frame.law else 2)


def _face_colours(frame: Frame, layout: Layout, mode, first) -> np.ndarray:
    if layout.colour is None:
        loose = _rattlers(frame)
        return np.where(loose[:, None], to_rgba("white"), to_rgba(PALE))
    fields = quantities(frame, first=first, mode=mode)
    values = fields[layout.colour][0] if layout.colour in fields else np.zeros(len(frame.state.grains.radius))
    return colormaps["viridis"](Normalize(*layout.limits)(values.astype(float)))


def start_drawing(frame: Frame, layout: Layout, width: float):
    """Figure and axes with balls in pale grey, walls and cell, but without contacts."""
    wide, tall = layout.high - layout.low
    figure, axes = subplots(figsize=(width, min(width * tall / wide, 1.6 * width) + 0.6))
    none = {name: value[:0] for name, value in frame.contacts.items()}
    draw(axes, frame._replace(contacts=none, state=frame.state._replace(bonds=None)), layout, near=False)
    return figure, axes


def contact_segments(frame: Frame) -> np.ndarray:
    """(M, 2, 2) end points of the lines of contacts, in the plane of the drawing."""
    basis, c = view_basis(frame), frame.contacts
    start = (wrapped(frame.state) @ basis.T)[c["i"]]
    return np.stack([start, start - c["branch"] @ basis.T], axis=1)[..., :2]


def _contact_lines(axes, frame: Frame, layout: Layout, place: np.ndarray, basis: np.ndarray):
    """Bodies, starts, ends, widths and colours of the lines of bonds and, in front of these, of contacts."""
    bonds, touch = drawn_bonds(frame), frame.contacts["mode"] != OPEN  # open pairs are bonds across gaps
    c = {name: frame.contacts[name][touch] for name in ("i", "j", "branch", "mode")}
    size = np.clip(_normal_forces(frame)[touch] / layout.mean, 0.12, MOST)
    color = np.where((c["mode"] == SLIDE)[:, None], to_rgba(RED), to_rgba(BLUE))
    held = np.where(bonds["intact"][:, None], to_rgba(BOND), to_rgba(BROKEN))
    points = (72 / axes.figure.dpi * np.array(axes.bbox.size) / (layout.high - layout.low)).min()  # per unit of length
    scale = min(THICK if layout.dim == 2 else 0.8 * THICK, THIN * points * 2 * frame.state.grains.radius.mean())
    band = min(CEMENT * THICK, 2 * THIN * points * 2 * frame.state.grains.radius.mean())
    i, j, branch = (np.concatenate([bonds[name], c[name]]) for name in ("i", "j", "branch"))
    width = np.concatenate([np.full(len(bonds["i"]), band), scale * size])
    rows, i, j, start, ends = _split_at_edges(frame, place, i, j, branch @ basis.T)
    return i, j, start, ends, width[rows], np.concatenate([held, color])[rows]


def _split_at_edges(frame: Frame, place: np.ndarray, i: np.ndarray, j: np.ndarray, branch: np.ndarray):
    """Rows, bodies, starts and ends of lines between bodies; each line ends at the grain that is drawn.

    A line across a periodic edge becomes two lines, from each grain to the contact; neither has a second body.
    """
    radius = frame.state.grains.radius
    n, rows, start, ends = len(radius), np.arange(len(i)), place[i], place[i] - branch
    far = np.zeros(len(i), bool)
    inner = np.flatnonzero(j < n)
    far[inner] = np.linalg.norm(ends[inner] - place[j[inner]], axis=1) > radius.mean()
    share = (radius[i[far]] / (radius[i[far]] + radius[j[far]]))[:, None]
    ends[far] = start[far] - share * branch[far]
    start, ends = (
        np.concatenate([start, place[j[far]]]), np.concatenate([ends, place[j[far]] + (1 - share) * branch[far]])
    )  # fmt: skip
    none = np.full(np.count_nonzero(far), n)
    return np.append(rows, rows[far]), np.append(i, j[far]), np.concatenate([np.where(far, n, j), none]), start, ends


def _normal_forces(frame: Frame) -> np.ndarray:
    return np.abs(frame.contacts.get("force_n", np.ones(len(frame.contacts["i"]))))


def _nearly_touching(frame: Frame) -> np.ndarray:
    """Rows of the contact list for pairs of grains that nearly touch."""
    state, c = frame.state, frame.state.contacts
    count, radius = int(c.count[0]), frame.state.grains.radius
    rows = np.flatnonzero((c.mode[:count] == OPEN) & (c.j[:count] < len(radius)))
    gap = np.linalg.norm(branch_vectors(state)[rows], axis=1) - radius[c.i[rows]] - radius[c.j[rows]]
    return rows[(gap > 0) & (gap < NEAR * radius.mean())]


def _depth_slabs(depth: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Number of the depth slab of each entry, 0 for the farthest of the depths `of`."""
    low, high = of.min(), of.max()
    return np.clip(((depth - low) / ((high - low) or 1.0) * SLABS).astype(int), 0, SLABS - 1)


def _projected(edges: np.ndarray, basis: np.ndarray) -> np.ndarray:
    return (edges @ basis.T)[..., :2]


def _places(frame: Frame) -> np.ndarray:
    """(N, 2) positions in the plane of the drawing."""
    return _projected(wrapped(frame.state), view_basis(frame))


@checked
def draw_grains_by_speed(axes: Axes, state: State, place: Numbers, loose: Bodies, top: float):
    """Draw disks coloured by speed, nearer ones on top; return the mappable for a colour bar."""
    n = len(state.grains.radius)
    speed = np.full(n, np.nan)
    speed[loose] = np.linalg.norm(state.grains.velocity[loose], axis=1)
    glued = np.setdiff1d(np.arange(n), loose)
    radius, order = state.grains.radius, loose[np.argsort(place[loose, 2], kind="stable")]
    around = state.cell.vectors[0, 0] if state.cell.periodic[0] else 0.0
    drawn = None
    for shift in (around, -around, 0.0) if around else (0.0,):  # grains at an edge are drawn at both edges
        at = place[:, :2] + [shift, 0.0]
        for rows, color in ((glued, {"facecolors": "0.6"}), (order, {"array": speed[order], "clim": (0.0, top)})):
            style = {"edgecolors": BLACK, "linewidths": 0.1, "cmap": "viridis"}
            drawn = draw_disks(axes, at[rows], radius[rows], **style, **color)
    return drawn
