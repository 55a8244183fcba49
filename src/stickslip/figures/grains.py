"""Drawing of a packing in two or three dimensions: grains, force chains, contact status, and a mode."""

from typing import NamedTuple

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.path import Path

from ..core.arguments import require_positive
from ..core.laws.builtin import Law
from ..core.measure import Committed, branch_vectors, least_supports, rattlers, touching, wrapped
from ..core.state import OPEN, SLIDE, State
from ..data.exchange.frame import Frame, frame_of
from .outlines import cell_edges, unit_mode, view_basis, wall_edges
from .quantities import Mode, quantities
from .style import BLACK, BLUE, PURPLE, RED, WIDTH, plt, styled

GREY, PALE = "#b4bac0", "#e4e9ee"
NEAR = 0.01  # largest gap of open pairs that are drawn, over the mean radius
SLABS = 16  # number of depth slabs, drawn from back to front: balls hide the lines behind them
BALL = {2: 1.0, 3: 0.6}  # drawn over true radius, by dimension: in space, lines between balls must be visible
THICK = 1.1  # line width of a contact with the mean force [points]
MOST = 6.0  # multiple of the mean force above which lines do not get thicker
WIDEST = 100.0  # figure [inches]
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


@styled
def packing(
    state: Committed, law: Law | None = None, *, mode: Mode | None = None, colour: str | None = None, title: str = "",
    width: float = WIDTH,
):  # fmt: skip
    """Draw grains, contacts (width by normal force, colour by status), walls, cell, and the orbits of a mode.

    A mode moves grain i along Re(u_i exp(−iωt)), an ellipse. It is drawn at each grain, with an arrow at t = 0. All
    ellipses are enlarged by the same factor, so that the largest reaches one mean radius. In three dimensions, balls
    are drawn at 0.6 times their size.

    Parameters
    ----------
    state : accepted state
    law : contact law; without it, forces are not known, and all contacts have the same width
    mode : translation, rotation and exponent, as returned by `read_mode`
    colour : one of `quantities`; without it, rattlers are white and other grains grey
    width : width of the figure [inches]

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        if there is no such quantity.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> ss.figures.packing(ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law), law).axes[0].get_title()
    ''
    """
    require_positive(width=width)
    if width > WIDEST:
        raise ValueError(f"width = {width:g} was given: at most {WIDEST:g} inches are drawn")
    frame = frame_of(state, law) if law is not None else bare_frame(state)
    layout = layout_of([frame], colour=colour, mode=mode)
    wide, tall = layout.high - layout.low
    figure, axes = plt.subplots(figsize=(width, min(width * tall / wide, 1.6 * width) + (1.0 if colour else 0.6)))
    drawn = draw(axes, frame, layout, mode=mode)
    if mode is not None:
        draw_orbits(axes, frame, mode)
    if colour:
        draw_colour_bar(figure, drawn, layout, ax=axes, location="bottom", shrink=0.7, aspect=30, pad=0.02)
    draw_legend(axes, frame, mode)
    axes.set_title(title, fontsize=7.5)
    return figure


def bare_frame(state: State) -> Frame:
    """Frame of a state whose law is not known, with contacts but without forces."""
    c, rows = state.contacts, touching(state)
    contacts = {name: getattr(c, name)[rows] for name in ("i", "j", "mode")} | {"branch": branch_vectors(state)[rows]}
    ends = np.concatenate([contacts["i"], contacts["j"]])
    n = len(state.grains.radius)
    return Frame(state, law=None, grains={"coordination": np.bincount(ends[ends < n], minlength=n)}, contacts=contacts)


def layout_of(frames: list[Frame], *, colour: str | None = None, mode: Mode | None = None) -> Layout:
    """Common limits of the drawing and of the colours for all frames."""
    corners = [_drawing_limits(frame) for frame in frames]
    low, high = np.min([c[0] for c in corners], axis=0), np.max([c[1] for c in corners], axis=0)
    forces = np.concatenate([_normal_forces(frame) for frame in frames])
    mean = float(forces.mean()) if len(forces) and forces.mean() > 0 else 1.0
    layout = Layout(frames[0].state.cell.dim, low, high, mean)
    if colour is None:
        return layout
    values, units = [], ""
    for frame in frames:
        found = quantities(frame, first=frames[0], mode=mode)
        if colour == "displacement" and frame is frames[0] and len(frames) > 1:
            continue
        if colour not in found:
            raise ValueError(f"colour {colour!r} was requested: these grains have {', '.join(found)}")
        values.append(found[colour][0])
        units = found[colour][1]
    every = np.concatenate(values)
    limits = (float(every.min()), float(np.quantile(every, 0.995)))
    return layout._replace(colour=colour, unit=units, limits=limits, whole=every.dtype.kind in "iu")


def draw(
    axes, frame: Frame, layout: Layout, *, mode: Mode | None = None, first: Frame | None = None,
    near: bool = True,
):  # fmt: skip
    """Draw one frame from back to front; return the mappable for a colour bar."""
    state, dim = frame.state, layout.dim
    basis, radius = view_basis(frame), BALL[dim] * state.grains.radius
    place = wrapped(state) @ basis.T
    slab = _depth_slabs(place[:, 2], dim)
    colors = _face_colours(frame, layout, mode, first)
    drawn = plt.cm.ScalarMappable(plt.Normalize(*layout.limits), cmap="viridis")
    start, ends, width, color = _contact_lines(frame, layout, place, basis)
    back = np.minimum(slab[frame.contacts["i"]], _depth_slabs(ends[:, 2], dim, place[:, 2])) if dim == 3 else None
    edges = LineCollection(_projected(cell_edges(frame), basis), colors=BLACK, linewidths=0.5, zorder=1)
    axes.add_collection(edges, autolim=False)
    for number in range(SLABS if dim == 3 else 1):
        rows = slab == number
        balls = EllipseCollection(
            2 * radius[rows], 2 * radius[rows], 0 * radius[rows], units="xy", offsets=place[rows, :2],
            offset_transform=axes.transData, facecolors=colors[rows], edgecolors="0.45", linewidths=0.3,
            zorder=2 + 2 * number,
        )  # fmt: skip
        axes.add_collection(balls, autolim=False)
        lines = slice(None) if dim == 2 else back == number
        drawn_lines = _segments(axes, start[lines, :2], ends[lines, :2], width[lines], color[lines])
        drawn_lines.set_zorder(3 + 2 * number - 2 * (dim == 3))
        axes.add_collection(drawn_lines, autolim=False)
    walls = LineCollection(_projected(wall_edges(frame), basis), colors="0.25", linewidths=0.9, zorder=50)
    axes.add_collection(walls, autolim=False)
    if near:
        gaps = LineCollection(_open_segments(frame, place, basis), colors="0.35", linewidths=0.5, ls=":", zorder=49)
        axes.add_collection(gaps, autolim=False)
    margin = 0.01 * (layout.high - layout.low).max()
    low = layout.low - [margin, 6 * margin]  # room for the bar
    axes.set(xlim=(low[0], layout.high[0] + margin), ylim=(low[1], layout.high[1] + margin))
    axes.set_aspect("equal")
    axes.axis("off")
    _draw_scale_bar(axes, frame, layout)
    return drawn


def _segments(axes, start: np.ndarray, ends: np.ndarray, width: np.ndarray, color: np.ndarray) -> EllipseCollection:
    """Line segments as ellipses of no height, with one path for all: a `LineCollection` makes a path for each."""
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
    """Draw the ellipse along which a mode moves each grain, with an arrow at its start."""
    basis, radius = view_basis(frame), frame.state.grains.radius.mean()
    place = wrapped(frame.state) @ basis.T
    u = unit_mode(mode, frame) @ basis.T
    u = (u.conj() if mode[2].imag > 0 else u)[:, :2] * (0.9 * radius / np.abs(unit_mode(mode, frame)).max())
    seen = np.abs(u).max(axis=1) > 0.02 * radius
    path = place[seen, None, :2] + (u[seen, None] * ORBIT.conj()[None, :, None]).real
    axes.add_collection(LineCollection(path, colors=BLACK, linewidths=0.7, zorder=60))
    tip = u[seen].real
    axes.quiver(
        *place[seen, :2].T, *tip.T, angles="xy", scale_units="xy", scale=1, color=PURPLE, width=0.005, headwidth=4,
        headlength=4, headaxislength=3.5, zorder=61,
    )  # fmt: skip


def draw_legend(axes, frame: Frame, mode: Mode | None = None, *, near: bool = True) -> None:
    """Draw the legend of lines and balls below the drawing."""
    slides = int((frame.contacts["mode"] == SLIDE).sum())
    handles = [
        Line2D([], [], color=BLUE, lw=2, label=f"sticks ({len(frame.contacts['mode']) - slides})"),
        Line2D([], [], color=RED, lw=2, label=f"slides ({slides})"),
    ]
    if near and (number := len(_nearly_touching(frame))):
        handles.append(Line2D([], [], color="0.35", lw=0.8, ls=":", label=f"open ({number})"))
    if free := int(_rattlers(frame).sum()):
        handles.append(Line2D([], [], ls="", marker="o", mfc="white", mec="0.45", ms=5, label=f"rattlers ({free})"))
    if mode is not None:
        handles.append(Line2D([], [], color=PURPLE, lw=1.2, marker=">", ms=3, label="mode (enlarged)"))
    axes.legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=min(len(handles), 3), columnspacing=1.2
    )


def draw_colour_bar(figure, drawn, layout: Layout, **place) -> None:
    """Draw a colour bar with few numbers; `place` goes to `Figure.colorbar`."""
    label = f"{layout.colour} [{layout.unit}]" if layout.unit else layout.colour
    bar = figure.colorbar(drawn, label=label, **place)
    bar.locator = plt.MaxNLocator(5, integer=layout.whole)
    bar.formatter.set_powerlimits((-2, 4))
    bar.update_ticks()


def _rattlers(frame: Frame) -> np.ndarray:
    """(N,) bool; a frame without a law is drawn as if it had friction."""
    return rattlers(frame.state, least_supports(frame.law, frame.state.cell.dim) if frame.law else 2)


def _face_colours(frame: Frame, layout: Layout, mode, first) -> np.ndarray:
    if layout.colour is None:
        loose = _rattlers(frame)
        return np.where(loose[:, None], to_rgba("white"), to_rgba(PALE))
    found = quantities(frame, first=first, mode=mode)
    values = found[layout.colour][0] if layout.colour in found else np.zeros(len(frame.state.grains.radius))
    return plt.get_cmap("viridis")(plt.Normalize(*layout.limits)(values.astype(float)))


def _contact_lines(frame: Frame, layout: Layout, place: np.ndarray, basis: np.ndarray):
    """Starts, ends, widths and colours of contact lines."""
    c = frame.contacts
    start = place[c["i"]]
    size = np.clip(_normal_forces(frame) / layout.mean, 0.12, MOST)
    color = np.where((c["mode"] == SLIDE)[:, None], to_rgba(RED), to_rgba(BLUE))
    scale = THICK * min(1.0, 12 / np.sqrt(len(frame.state.grains.radius))) if layout.dim == 2 else 0.8 * THICK
    return start, start - c["branch"] @ basis.T, scale * size, color


def _normal_forces(frame: Frame) -> np.ndarray:
    return np.abs(frame.contacts.get("force_n", np.ones(len(frame.contacts["i"]))))


def _nearly_touching(frame: Frame) -> np.ndarray:
    """Rows of the contact list for pairs of grains that nearly touch."""
    state, c = frame.state, frame.state.contacts
    count, radius = int(c.count[0]), frame.state.grains.radius
    rows = np.flatnonzero((c.mode[:count] == OPEN) & (c.j[:count] < len(radius)))
    gap = np.linalg.norm(branch_vectors(state)[rows], axis=1) - radius[c.i[rows]] - radius[c.j[rows]]
    return rows[(gap > 0) & (gap < NEAR * radius.mean())]


def _open_segments(frame: Frame, place: np.ndarray, basis: np.ndarray) -> np.ndarray:
    rows = _nearly_touching(frame)
    start = place[frame.state.contacts.i[rows]]
    return np.stack([start, start - branch_vectors(frame.state)[rows] @ basis.T], axis=1)[..., :2]


def _depth_slabs(depth: np.ndarray, dim: int, of: np.ndarray | None = None) -> np.ndarray:
    """Number of the depth slab of each entry, 0 for the farthest."""
    if dim == 2:
        return np.zeros(len(depth), int)
    low, high = (of if of is not None else depth).min(), (of if of is not None else depth).max()
    return np.clip(((depth - low) / ((high - low) or 1.0) * SLABS).astype(int), 0, SLABS - 1)


def _projected(edges: np.ndarray, basis: np.ndarray) -> np.ndarray:
    return (edges @ basis.T)[..., :2]


def _drawing_limits(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    basis, radius = view_basis(frame), BALL[frame.state.cell.dim] * frame.state.grains.radius[:, None]
    place = (wrapped(frame.state) @ basis.T)[:, :2]
    lines = np.concatenate([_projected(cell_edges(frame), basis), _projected(wall_edges(frame), basis)]).reshape(-1, 2)
    return (
        np.min([(place - radius).min(axis=0), *lines], axis=0),
        np.max([(place + radius).max(axis=0), *lines], axis=0),
    )


def _draw_scale_bar(axes, frame: Frame, layout: Layout) -> None:
    """Draw a scale bar one mean diameter long."""
    long = 2 * float(frame.state.grains.radius.mean())
    x, y = layout.low[0], layout.low[1] - 0.04 * (layout.high - layout.low).max()
    axes.plot([x, x + long], [y, y], color=BLACK, lw=1.5, solid_capstyle="butt", zorder=70)
    axes.annotate(" mean diameter", (x + long, y), va="center", fontsize=6.5, zorder=70)
