"""Figures of a flow: snapshots coloured by speed, time series, and the velocity profile."""

from typing import Annotated, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from ....kit import (
    APART,
    ASIDE,
    BLACK,
    BLUE,
    COLORS,
    GREEN,
    ORANGE,
    PAGE,
    Array,
    OwnFigure,
    Result,
    Series,
    Zoom,
    body_limits,
    column_axes,
    draw_grains_by_speed,
    label_axes,
    legend_above,
    outside,
    outside_words,
    plot_fast,
    styled,
    unit_name,
    with_unit,
    zoomed,
)
from ....measure import wrapped

PANELS = 6
# largest height of a row, height of its text, and widths of the room beside a panel and of the bar [inches]
MOST, BELOW, BESIDE, BAR = 2.8, 0.45, 0.5, 0.55
WALL = "0.25"


@styled
def snapshots(result: Annotated[Any, Result("FlowResult", ("frames", "stages", "poured"))], *, zoom: Zoom = 1.0):
    """Snapshots viewed along z: poured grains coloured by speed, plates grey, walls as lines.

    Parameters
    ----------
    zoom : as in `stickslip.figures.packing`
    """
    shown = _select_frames(result)
    places = [wrapped(state) for state in shown]
    low, high = _view_limits(result, shown, places, zoom)
    wide, tall = high - low
    columns = min(1 if wide > 2.2 * tall else 2 if wide > 1.3 * tall else 3, len(shown))
    boxes = np.array([[low, high]] * len(shown))
    if low_heap := columns == 1 and zoom == 1:  # each panel ends at its grains, and each row has its own scale
        own = np.array([_view_limits(result, [s], [p], zoom)[1] for s, p in zip(shown, places, strict=True)])
        boxes[:, 1] = np.clip(own, np.add(low, [0.0, 0.05 * tall]), high)
    sizes = np.ptp(boxes, axis=1)
    rows = _fill_rows(sizes[:, 0], columns * wide * (1 + 1e-9))
    ratios = [sizes[row, 0] if low_heap else np.full(columns, wide) for row in rows]
    heights = [
        min((PAGE - BESIDE * len(row)) * sizes[row, 1].max() / r.sum(), MOST)
        for row, r in zip(rows, ratios, strict=True)
    ]
    heights = [*np.add(heights, BELOW)[:-1], heights[-1] + 1.3 * BELOW, BAR]
    figure = OwnFigure(figsize=(PAGE, min(sum(heights) + 0.4, 9.5)), layout="constrained")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    panels: list[list[Axes]] = []
    for k, row in enumerate(rows):
        cells = grid[k].subgridspec(1, len(ratios[k]), width_ratios=ratios[k])
        panels.append([figure.add_subplot(cells[column]) for column in range(len(row))])
    loose = result.poured.loose
    speeds = [np.linalg.norm(state.grains.velocity[loose], axis=1) for state in shown]
    top = max(float(np.quantile(s, 0.99)) for s in speeds) or 1.0
    drawn = None
    every = [axes for row in panels for axes in row]
    for axes, state, position, corners in zip(every, shown, places, boxes, strict=True):
        away = int(outside(position[:, :2], *corners).sum())
        drawn = draw_grains_by_speed(axes, state, position, loose, top)
        # lines where walls intersect the plane of the drawing; walls parallel to it are omitted
        for point, normal in zip(state.walls.point, state.walls.normal, strict=True):
            if np.hypot(normal[0], normal[1]) > 1e-9:
                axes.axline(point[:2], (point[0] - normal[1], point[1] + normal[0]), color=WALL, lw=1.0)
        axes.set(xlim=corners[:, 0], ylim=corners[:, 1], aspect="equal")
        time = with_unit(f"{state.time:.4g}", "time", unnamed="time units")
        words = f"{'; ' if low_heap else chr(10)}{outside_words(away)}" if away else ""
        axes.set_title(f"$t$ = {time}{words}", fontsize=7, pad=2)
    length = _length_unit(result, shown[0])
    for row in panels:
        for axes in row:
            axes.tick_params(labelbottom=low_heap or row is panels[-1], labelleft=low_heap or axes is row[0])
    for axes in panels[-1]:
        label_axes(axes, x=("$x$", length))
    for row in panels if columns > 1 else [panels[int(np.argmax(heights))]]:  # low panels have no room for words
        label_axes(row[0], y=("$y$", length))
    below = figure.add_subplot(grid[-1].subgridspec(1, 3, width_ratios=(1, 3, 1))[1], label="<colorbar>")
    bar = figure.colorbar(drawn, cax=below, orientation="horizontal", extend="max")
    label_axes(bar.ax, x=("speed", "length/time" if length == "length" else f"{length} / time unit"))
    handles = [Line2D([], [], color=WALL, lw=1, label="walls")] if len(shown[0].walls.point) else []
    if len(loose) < len(shown[0].grains.radius):
        handles.append(Line2D([], [], ls="", marker="o", mfc="0.6", mec=BLACK, mew=0.3, label="grains of the plates"))
    if handles:
        figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


def _fill_rows(widths: np.ndarray, room: float) -> list[list[int]]:
    """Distribute panels over rows of a given width; return the numbers of the panels in each row."""
    rows: list[list[int]] = [[]]
    for k, width in enumerate(widths):
        if rows[-1] and widths[rows[-1]].sum() + width > room:
            rows.append([])
        rows[-1].append(k)
    return rows


def _length_unit(result, state) -> str:
    """Unit of length: diameters if the mean diameter is 1 and the scenario names no units."""
    mean = 2 * state.grains.radius[result.poured.loose].mean()
    return "diameters" if unit_name("length") == "length" and abs(mean - 1) < 0.05 else "length"


def _select_frames(result) -> list:
    """Frames at nearly equal intervals, including the first and the last.

    If there are several stages, only frames of the last one are shown.
    """
    start = result.stages[-1].start if len(result.stages) > 1 else -np.inf
    frames = [state for state in result.frames if state.time >= start * (1 - 1e-9)] or list(result.frames)
    wanted = np.linspace(frames[0].time, frames[-1].time, PANELS)
    times = np.array([state.time for state in frames])
    return [frames[k] for k in dict.fromkeys(int(np.abs(times - t).argmin()) for t in wanted)]


def _view_limits(result, shown, places, zoom):
    """Lower and upper corners of the drawing."""
    radius, periodic = shown[0].grains.radius.max(), shown[0].cell.periodic
    share = 0.0 if zoom == "all" else ASIDE
    corners = np.array([body_limits(p[:, :2], 2 * APART * radius, share) for p in places])
    low, high = corners[:, 0].min(axis=0) - 2 * radius, corners[:, 1].max(axis=0) + 2 * radius
    for k in np.flatnonzero(periodic[:2]):
        low[k], high[k] = 0.0, result.frames[0].cell.vectors[k, k]
    return zoomed(np.array([low, high]), np.concatenate(places)[:, :2], zoom)


@styled
def time_series(result: Annotated[Any, Result("FlowResult", ("series", "stages"))]):
    """Energies, contacts, and either the extent of the flow or the friction and the distance between plates."""
    series, plates = result.series, list(result.poured.plates)
    sheared = len(plates) > 1
    figure, panels = column_axes(5 if sheared else 4, 7.0 if sheared else 6.0, sharex=True)
    time = series.time
    for axes in panels[:2]:
        axes.set_yscale("log")
    for energy, color, label in (
        (series.kinetic_energy, BLUE, "kinetic"), (series.elastic_energy, ORANGE, "elastic")
    ):  # fmt: skip
        plot_fast(panels[0], time, np.maximum(energy, 1e-300), color=color, label=label)
    top = max(series.kinetic_energy.max(), series.elastic_energy.max()) or 1.0
    least = min((e[e > 0].min() for e in (series.kinetic_energy, series.elastic_energy) if (e > 0).any()), default=1e-9)
    panels[0].set_ylim(max(least, 1e-9 * top) / 2, 4 * top)
    label_axes(panels[0], y=("energy\n", "energy"))
    panels[0].legend(loc="best", ncol=2)
    finite = np.isfinite(series.unbalanced) & (series.unbalanced > 0)
    plot_fast(panels[1], time[finite], series.unbalanced[finite], color=BLUE)
    label_axes(panels[1], y="unbalanced force\nover contact force")
    _plot_contacts(panels[2], series)
    if sheared:
        _plot_plates(panels[3], panels[4], series, plates)
    else:
        # the centre of mass, and the coordinate below which 99 % of the grains lie
        for k, color, end in ((0, BLUE, "front, $x$"), (1, GREEN, "top, $y$")):
            panels[3].plot(time, series.center[:, k], color=color, label=f"centre of mass, ${'xy'[k]}$")
            panels[3].plot(time, series.high[:, k], color=color, ls="--", label=end)
        label_axes(panels[3], y=("position\n", "length"))
        legend_above(panels[3])
    for axes in panels:
        for stage in result.stages[1:]:
            axes.axvline(stage.start, color="0.6", lw=0.6, ls=":")
    for stage in result.stages:
        panels[0].text(
            0.5 * (stage.start + stage.end), 1.02, stage.name, transform=panels[0].get_xaxis_transform(), ha="center",
            fontsize=7,
        )  # fmt: skip
    label_axes(panels[-1], x=("time $t$", "time"))
    panels[-1].set_xlim(0, time[-1])
    figure.align_ylabels(panels)
    return figure


def _plot_contacts(axes, series) -> None:
    defined = series.coordination > 0  # undefined while all grains are rattlers
    plot_fast(axes, series.time[defined], series.coordination[defined], color=BLUE)
    label_axes(axes, y="coordination $z$")
    axes.yaxis.label.set_color(BLUE)
    axes.set_ylim(bottom=0)
    other = axes.twinx()
    plot_fast(other, series.time, series.sliding_fraction, color=ORANGE)
    label_axes(other, y="sliding fraction")
    other.yaxis.label.set_color(ORANGE)
    other.set_ylim(0, float(np.clip(1.8 * np.quantile(series.sliding_fraction, 0.98), 0.05, 1.05)))


def _plot_plates(top, bottom, series, names) -> None:
    """Plot shear over normal force on each plate, its running mean, and the distance between outermost plates."""
    span = max(1, len(series.time) // 40)
    seen = [0.1]
    for k, name in enumerate(names):
        shear, normal = -series.plate_force[:, k, 0] * np.sign(series.plate_force[:, k, 1]), series.plate_force[:, k, 1]
        size = np.abs(normal)
        held = size > 0.1 * np.median(size)
        ratio = np.where(held, shear / np.where(held, size, 1.0), np.nan)
        color = COLORS[2 * k % len(COLORS)]
        top.plot(series.time, ratio, color=color, lw=0.4, alpha=0.25, label="as sampled" if k == 0 else None)
        means = [np.convolve(force, np.ones(span), "same") for force in (shear, size)]
        good = means[1] > 0.1 * np.median(size)
        smooth = np.where(good, means[0] / np.where(good, means[1], 1.0), np.nan)
        top.plot(series.time, smooth, color=color, lw=1.0, label=f"{name}, running mean")
        seen += [float(v) for v in np.abs(smooth[np.isfinite(smooth)])]
    limit = 2 * float(np.quantile(seen, 0.95))
    top.set_ylim(-limit, limit)
    label_axes(top, y="shear force\nover normal force")
    legend_above(top)
    height = np.ptp(series.plate_position[:, :, 1], axis=1)
    bottom.plot(series.time, height, color=BLUE)
    label_axes(bottom, y=("plate distance\n", "length"))


_Profile = Annotated[Any, Array((2,), finite=False)]  # NaN where there are no grains


@styled
def velocity_profile(edges: Series, velocity: _Profile, deviation: _Profile):
    """Mean velocity along x, with its standard deviation over time, against height.

    Parameters
    ----------
    edges : edges of the height bins [length]
    velocity, deviation : (bins, 3) [length/time]
    """
    if not len(velocity) == len(deviation) == len(edges) - 1:
        raise ValueError(
            f"velocity must have one value for each bin, but there are {len(velocity)} values and {len(edges)} edges"
        )
    figure, axes = column_axes(1, 2.6)
    height = 0.5 * (edges[:-1] + edges[1:])
    axes.errorbar(
        velocity[:, 0], height, xerr=deviation[:, 0], fmt="o-", color=BLUE, lw=0.7, elinewidth=0.5, capsize=1.2
    )
    label_axes(axes, x=("mean velocity $v_x$ ± deviation over time", "length/time"), y=("height $y$", "length"))
    axes.set_title("second half of the last stage", fontsize=7)
    return figure
