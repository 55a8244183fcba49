"""Figures of a flow: snapshots coloured by speed, time series, and the velocity profile."""

from typing import Annotated, Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.collections import EllipseCollection
from matplotlib.ticker import MaxNLocator

from ..core.arguments import Array, Result, Series
from ..core.measure import wrapped
from .style import BLACK, BLUE, COLORS, GREEN, ORANGE, RED, WIDTH, column_axes, styled

WIDE = 2.07 * WIDTH  # two columns and the gap between them
PANELS = 6
HIDDEN = 0.002  # fraction of grains that may be out of view at either end: grains that roll away would shrink the rest


@styled
def snapshots(result: Annotated[Any, Result("FlowResult", ("frames", "stages", "poured"))]):
    """Snapshots seen along z: poured grains coloured by speed, plates grey, walls as lines."""
    shown = _select_frames(result)
    places = [wrapped(state) for state in shown]
    low, high = _view_limits(result, shown, places)
    wide, tall = high - low
    columns = 1 if wide > 2.2 * tall else 2 if wide > 1.3 * tall else 3
    columns = min(columns, len(shown))
    rows = -(-len(shown) // columns)
    width = WIDTH if columns == 1 else WIDE
    height = min(rows * (width / columns * tall / wide + 0.22) + 0.55, 9.0)
    figure, panels = plt.subplots(rows, columns, figsize=(width, height), squeeze=False, sharex=True, sharey=True)
    loose = result.poured.loose
    speeds = [np.linalg.norm(state.grains.velocity[loose], axis=1) for state in shown]
    top = max(float(np.quantile(s, 0.99)) for s in speeds) or 1.0
    drawn = None
    for axes, state, place in zip(panels.flat, shown, places, strict=False):
        drawn = draw_grains_by_speed(axes, state, place, loose, top)
        _draw_walls(axes, state)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_title(f"$t$ = {state.time:.4g}", fontsize=7, pad=2)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.yaxis.set_major_locator(MaxNLocator(4))
    for axes in panels.flat[len(shown) :]:
        axes.axis("off")
    for axes in panels[-1]:
        axes.set_xlabel("$x$ [length]")
    for axes in panels[:, 0]:
        axes.set_ylabel("$y$ [length]")
    figure.colorbar(drawn, ax=panels, location="bottom", label="speed [length/time]", shrink=0.6, aspect=30, pad=0.02)
    return figure


def _select_frames(result) -> list:
    """Frames at nearly equal intervals, including the first and the last.

    If there are several stages, only the last is shown.
    """
    start = result.stages[-1].start if len(result.stages) > 1 else -np.inf
    frames = [state for state in result.frames if state.time >= start * (1 - 1e-9)] or list(result.frames)
    wanted = np.linspace(frames[0].time, frames[-1].time, PANELS)
    times = np.array([state.time for state in frames])
    return [frames[k] for k in dict.fromkeys(int(np.abs(times - t).argmin()) for t in wanted)]


def _view_limits(result, shown, places):
    """Lower and upper corners of the drawing."""
    radius, periodic = shown[0].grains.radius.max(), shown[0].cell.periodic
    low = np.min([np.quantile(p[:, :2], HIDDEN, axis=0) for p in places], axis=0) - 2 * radius
    high = np.max([np.quantile(p[:, :2], 1 - HIDDEN, axis=0) for p in places], axis=0) + 2 * radius
    for k in np.flatnonzero(periodic[:2]):
        low[k], high[k] = 0.0, result.frames[0].cell.vectors[k, k]
    return low, high


def draw_grains_by_speed(axes, state, place, loose, top: float):
    """Draw disks coloured by speed, nearer ones on top; return the mappable for a colour bar."""
    n = len(state.grains.radius)
    speed = np.full(n, np.nan)
    speed[loose] = np.linalg.norm(state.grains.velocity[loose], axis=1)
    glued = np.setdiff1d(np.arange(n), loose)
    size = 2 * state.grains.radius
    order = loose[np.argsort(place[loose, 2], kind="stable")]
    options = {"units": "xy", "offset_transform": axes.transData, "linewidths": 0.1, "edgecolors": BLACK}
    around = state.cell.vectors[0, 0] if state.cell.periodic[0] else 0.0
    drawn = None
    for shift in (around, -around, 0.0) if around else (0.0,):  # grains at an edge are drawn at both edges
        at = place[:, :2] + [shift, 0.0]
        for rows, color in ((glued, {"facecolors": "0.6"}), (order, {"array": speed[order], "clim": (0.0, top)})):
            drawn = axes.add_collection(
                EllipseCollection(
                    size[rows], size[rows], np.zeros(len(rows)), offsets=at[rows], cmap="viridis", **color, **options
                )
            )
    return drawn


def _draw_walls(axes, state) -> None:
    """Draw lines where walls intersect the plane of the drawing; walls parallel to it are omitted."""
    for point, normal in zip(state.walls.point, state.walls.normal, strict=True):
        if np.hypot(normal[0], normal[1]) > 1e-9:
            axes.axline(point[:2], (point[0] - normal[1], point[1] + normal[0]), color=RED, lw=0.8)


@styled
def time_series(result: Annotated[Any, Result("FlowResult", ("series", "stages"))]):
    """Energies, contacts, and either the extent of the flow or the friction and the distance between plates."""
    series, plates = result.series, list(result.poured.plates)
    sheared = len(plates) > 1
    figure, panels = column_axes(5 if sheared else 4, 6.6 if sheared else 5.6, sharex=True)
    time = series.time
    panels[0].semilogy(time, np.maximum(series.kinetic_energy, 1e-300), color=BLUE, label="kinetic")
    panels[0].semilogy(time, np.maximum(series.elastic_energy, 1e-300), color=ORANGE, label="elastic")
    top = max(series.kinetic_energy.max(), series.elastic_energy.max()) or 1.0
    least = min((e[e > 0].min() for e in (series.kinetic_energy, series.elastic_energy) if (e > 0).any()), default=1e-9)
    panels[0].set_ylim(max(least, 1e-9 * top) / 2, 4 * top)
    panels[0].set_ylabel("energy [energy]")
    panels[0].legend(loc="best", ncol=2)
    known = np.isfinite(series.unbalanced)
    panels[1].semilogy(time[known], series.unbalanced[known], color=BLUE)
    panels[1].set_ylabel("unbalanced force\nover contact force")
    _plot_contacts(panels[2], series)
    if sheared:
        _plot_plates(panels[3], panels[4], series, plates)
    else:
        _plot_extent(panels[3], series)
    for axes in panels:
        for stage in result.stages[1:]:
            axes.axvline(stage.start, color="0.6", lw=0.6, ls=":")
    for stage in result.stages:
        panels[0].text(
            0.5 * (stage.start + stage.end), 1.02, stage.name, transform=panels[0].get_xaxis_transform(), ha="center",
            fontsize=6.5,
        )  # fmt: skip
    panels[-1].set_xlabel("time $t$ [time]")
    panels[-1].set_xlim(0, time[-1])
    figure.align_ylabels(panels)
    return figure


def _plot_contacts(axes, series) -> None:
    axes.plot(series.time, series.coordination, color=BLUE)
    axes.set_ylabel("coordination $z$", color=BLUE)
    axes.set_ylim(bottom=0)
    other = axes.twinx()
    other.plot(series.time, series.sliding_fraction, color=ORANGE, lw=0.7)
    other.set_ylabel("sliding fraction", color=ORANGE)
    other.set_ylim(0, float(np.clip(1.8 * np.quantile(series.sliding_fraction, 0.98), 0.05, 1.05)))


def _plot_extent(axes, series) -> None:
    """Plot the centre of mass and the largest coordinates of the grains along x and y."""
    for k, color, end in ((0, BLUE, "front, $x$"), (1, GREEN, "top, $y$")):
        axes.plot(series.time, series.center[:, k], color=color, label=f"centre of mass, ${'xy'[k]}$")
        axes.plot(series.time, series.high[:, k], color=color, ls="--", label=f"{end} (99 %)")
    axes.set_ylabel("position [length]")
    axes.set_ylim(top=1.45 * max(series.high[:, :2].max(), series.center[:, :2].max()))
    axes.legend(loc="upper left", ncol=2, columnspacing=1.0, fontsize=6)


def _plot_plates(top, bottom, series, names) -> None:
    """Plot shear over normal force on each plate, its running mean, and the distance between the outermost plates."""
    span = max(1, len(series.time) // 40)
    seen = [0.1]
    for k, name in enumerate(names):
        shear, normal = -series.plate_force[:, k, 0] * np.sign(series.plate_force[:, k, 1]), series.plate_force[:, k, 1]
        size = np.abs(normal)
        held = size > 0.1 * np.median(size)
        ratio = np.where(held, shear / np.where(held, size, 1.0), np.nan)
        color = COLORS[2 * k % len(COLORS)]
        top.plot(series.time, ratio, color=color, lw=0.4, alpha=0.25)
        means = [np.convolve(force, np.ones(span), "same") for force in (shear, size)]
        good = means[1] > 0.1 * np.median(size)
        smooth = np.where(good, means[0] / np.where(good, means[1], 1.0), np.nan)
        top.plot(series.time, smooth, color=color, lw=1.0, label=f"plate {name!r}")
        seen += [float(v) for v in np.abs(smooth[np.isfinite(smooth)])]
    limit = 2 * float(np.quantile(seen, 0.95))
    top.set_ylim(-limit, 1.4 * limit)
    top.set_ylabel("shear force\nover normal force")
    top.legend(loc="upper left", ncol=2)
    height = np.ptp(series.plate_position[:, :, 1], axis=1)
    bottom.plot(series.time, height, color=BLUE)
    bottom.set_ylabel("distance of the\nplates [length]")


_Profile = Annotated[Any, Array((2,), finite=False)]  # NaN where there are no grains


@styled
def velocity_profile(edges: Series, velocity: _Profile, deviation: _Profile):
    """Mean velocity along x against height, with its standard deviation over time.

    Parameters
    ----------
    edges : edges of the height bins [length]
    velocity, deviation : (bins, 3) [length/time]
    """
    if not len(velocity) == len(deviation) == len(edges) - 1:
        raise ValueError(f"{len(velocity)} velocities were given for {len(edges)} edges of bins: give one for each bin")
    figure, axes = column_axes(1, 2.6)
    height = 0.5 * (edges[:-1] + edges[1:])
    axes.errorbar(
        velocity[:, 0], height, xerr=deviation[:, 0], fmt="o-", color=BLUE, lw=0.7, elinewidth=0.5, capsize=1.2
    )
    axes.set(xlabel="mean velocity $v_x$ ± deviation over time [length/time]", ylabel="height $y$ [length]")
    axes.set_title("second half of the last stage", fontsize=7)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    return figure
