"""Figures of the disk array (Charan et al. 2020)."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from scipy.special import chdtrc

from ....kit import FILLED, Result, animation, require_index, style
from ....results import Spectrum

_KIND = "DiskArrayResult"
_WithPairs = Annotated[Any, Result(_KIND, ("families",))]
_WithRuns = Annotated[Any, Result(_KIND, ("free_runs",))]
_WithSliding = Annotated[Any, Result(_KIND, ("free_runs", "sliding"))]
_Front = Annotated[Any, Result("Front", ("delay", "distance", "error", "speed", "speed_error"))]
_Line = Annotated[Any, Result("fit of velocities", ("push", "velocity", "error", "intercept", "slope"))]
LOAD = r"push $F_x$"
DIAMETER = "diameters"
SPEED = "diameters / time unit"
STRAIGHT = 1e-3  # probability of a larger χ² below which a front has no single speed, and no line is drawn
MOVED = (r"$\Delta C^x_\mathrm{mass}$", DIAMETER)


@style.styled
def complex_pairs(results: Annotated[dict[str, _WithPairs], FILLED], paper: dict[float, float] | None = None):
    """Im λ of every complex pair against the push, with births and deaths; one panel per result (Fig 2).

    Parameters
    ----------
    results : title -> DiskArrayResult
    paper : load -> Im λ printed in the paper, drawn as crosses
    """
    figure, panels = style.column_axes(len(results), 1.0 + 1.45 * len(results), sharex=True, squeeze=False)
    for axes, (title, result) in zip(panels[:, 0], results.items(), strict=True):
        for k, family in enumerate(result.families):
            color = style.COLORS[k % len(style.COLORS)]
            loads, values = family.loads, family.eigenvalues.imag
            ends = [(c.load, 0.0) for c in (family.birth, family.death) if c]
            if family.birth:
                loads, values = np.r_[family.birth.load, loads], np.r_[0.0, values]
            if family.death:
                loads, values = np.r_[loads, family.death.load], np.r_[values, 0.0]
            axes.plot(loads, values, color=color)
            if ends:
                axes.plot(*np.transpose(ends), "o", color=color, mfc="white", ms=3)
        if not result.families:
            axes.text(0.5, 0.5, "all eigenvalues real", ha="center", transform=axes.transAxes)
        if paper:
            axes.plot(paper.keys(), list(paper.values()), "x", color=style.BLACK, ms=5, label="paper", zorder=5)
        if result.families:
            axes.plot([], [], "o-", color=style.BLACK, mfc="white", label="complex pair, ○ birth and death")
        style.legend_above(axes, title=title)
        style.label_axes(axes, y=(r"$\mathrm{Im}\,\lambda$", r"$k_n\sqrt{2R}/m$"))
        axes.set_ylim(bottom=-0.03 * axes.get_ylim()[1])
    style.label_axes(panels[-1, 0], x=(LOAD, "force"))
    return figure


@style.styled
def mean_square_displacement(result: _WithRuns):
    """M(t) at every load, with the predicted growth (Fig 3)."""
    figure, axes = style.column_axes(height=2.7)
    axes.set_yscale("log")
    for color, (load, free) in zip(style.COLORS * 5, result.free_runs.items(), strict=False):
        shown = free.msd > 0
        style.plot_fast(axes, free.time[shown], free.msd[shown], color=color, label=f"{load:.3f}", middle=False)
        if free.growth:
            t = np.array([free.growth.start, free.growth.stop])
            inside = (free.time >= t[0]) & (free.time <= t[1])
            level = np.mean(np.log(free.msd[inside]) - 2 * free.predicted_growth * free.time[inside])
            axes.semilogy(t, np.exp(level + 2 * free.predicted_growth * t), "--", color=style.BLACK, lw=0.8, zorder=4)
    if any(f.growth for f in result.free_runs.values()):
        axes.plot([], [], "--", color=style.BLACK, lw=0.8, label=r"$\propto e^{2\omega_i t}$, predicted")
    axes.legend(title=LOAD, loc="lower right", ncol=2)
    style.label_axes(axes, x=style.TIME, y=(r"$M(t)=\Sigma_i|\mathbf{r}_i(t)-\mathbf{r}_i(0)|^2$", "diameters²"))
    axes.set_ylim(bottom=0.1 * min(np.percentile(f.msd[f.msd > 0], 1) for f in result.free_runs.values()))
    return figure


@style.styled
def trajectory(result: Annotated[Any, Result(_KIND, ("trajectory",))], grain: int = 3):
    """Path of one disk in the x–y plane, coloured by time: growing spiral, and path until breaching (Fig 4)."""
    data = result.trajectory
    require_index(len(data.breach), grain=grain)
    figure, panels = style.column_axes(2, 4.6)
    end = data.breach[grain] if np.isfinite(data.breach[grain]) else data.time[-1]
    first = data.first_limit if np.isfinite(data.first_limit) else end
    windows = (
        (
            (first - 150, first),
            f"disk {grain + 1}, $F_x$ = {data.load:.3f}, before any contact\nreaches the Coulomb limit",
        ),
        ((first, end), "from there until its contact with the\nsubstrate is broken"),
    )
    for axes, ((start, stop), title) in zip(panels, windows, strict=True):
        shown = (data.time >= start) & (data.time <= max(stop, start + 150))
        xy = data.position[shown, grain] - data.position[shown, grain].mean(axis=0)
        lines = LineCollection(np.stack([xy[:-1], xy[1:]], axis=1), cmap="viridis", array=data.time[shown][1:], lw=0.5)
        axes.add_collection(lines)
        axes.autoscale()
        style.label_axes(axes, x=(r"$\Delta x$", DIAMETER), y=(r"$\Delta y$", DIAMETER))
        axes.set_title(title, fontsize=7)
        style.label_axes(figure.colorbar(lines, ax=axes, pad=0.02).ax, y=style.TIME)
    return figure


def _plot_front(axes, front, color, name: str) -> None:
    """Plot the delays of a front, and the line of its speed unless χ² rejects a single speed."""
    known = front.error > 0
    degrees = max(np.count_nonzero(known) - 1, 1)
    squares = float((((front.distance / front.speed - front.delay)[known] / front.error[known]) ** 2).sum())
    straight = chdtrc(degrees, squares) > STRAIGHT
    about = rf"$\chi^2$ = {squares:.3g}, {degrees} degrees of freedom"
    speed = style.power_of_ten(front.speed, front.speed_error)
    label = f"{name} = {speed}, {about}" if straight else f"{name}: no single speed, {about}"
    axes.errorbar(front.delay, front.distance, xerr=front.error, fmt="o", color=color, label=label, capsize=1.5, lw=0.7)
    if straight:
        reach = np.array([0, front.distance[-1]])
        axes.plot(reach / front.speed, reach, "--", color=color, lw=0.8)


@style.styled
def traveling_fronts(forward: dict[float, _Front | None], backward: _Front | None, threshold: float):
    """Mean times of breaching (forward) and of sliding (backward), with speeds where a single one fits (Fig 5).

    The legend shows χ² of the delays about the fitted line, and its degrees of freedom.

    Parameters
    ----------
    forward : load -> Front
    backward : Front or None
    """
    figure, (top, bottom) = style.column_axes(2, 4.8)
    for color, (load, front) in zip((style.BLUE, style.GREEN, style.RED, style.ORANGE), forward.items(), strict=False):
        if front:
            _plot_front(top, front, color, f"$V_1$({load:.3f})")
    style.label_axes(
        top, x=(r"mean delay of breaching $\tau_i-\tau_1$", style.TIME[1]), y=("distance\nfrom disk 1", DIAMETER)
    )
    if backward:
        _plot_front(bottom, backward, style.PURPLE, "$V_2$")
    style.label_axes(
        bottom, x=(f"mean delay of sliding by {threshold:g} diameters", style.TIME[1]),
        y=("distance\nfrom last disk", DIAMETER),
    )  # fmt: skip
    for axes in (top, bottom):
        if axes.get_legend_handles_labels()[0]:
            if any(line.get_linestyle() == "--" for line in axes.lines):
                axes.plot([], [], "--", color=style.BLACK, lw=0.8, label=f"fitted speed $V(F_x)$ [{SPEED}]")
            style.legend_above(axes, ncol=1)
        else:
            axes.text(0.5, 0.5, "no front", ha="center", transform=axes.transAxes)
    return figure


@style.styled
def mode_shape(spectrum: Spectrum, index: int):
    """Components of one mode by coordinate: x, y and R·angle of all disks (Fig 6)."""
    require_index(spectrum.modes.shape[1], index=index)
    index = int(index)  # as an index, True would be a mask
    figure, axes = style.column_axes(height=2.3)
    mode = spectrum.modes[:, index]
    mode = mode * np.exp(-1j * np.angle(mode[np.argmax(np.abs(mode))]))
    value = mode.real * np.sqrt(spectrum.free.mass)
    n = int(np.sum(spectrum.free.axis == 0))
    for k, (axis, name, color) in enumerate(
        ((0, "$x$", style.BLUE), (1, "$y$", style.GREEN), (5, r"$R\,\theta$", style.ORANGE))
    ):
        part = value[spectrum.free.axis == axis]
        axes.bar(k * n + 1 + np.arange(len(part)), part, color=color, label=name, width=0.8)
    axes.axhline(0, color=style.BLACK, lw=0.5)
    share = spectrum.shares()[index]
    axes.set_title(rf"$\omega$ = {spectrum.frequency[index]:.4f}, fraction in $y$ {share[1]:.3f}")
    style.label_axes(axes, x=r"degree of freedom $q_\ell$", y="mass-weighted component", whole="x")
    axes.legend(ncol=3, loc="best")
    return figure


@style.styled
def center_of_mass(
    result: _WithSliding, load: float, line: _Line | None = None, printed: tuple[float, float] | None = None
):
    """Displacement of the centre of mass through the transition, and sliding velocity against push (Fig 7, Eq 10).

    Parameters
    ----------
    load : load of the upper panel
    line : measured velocities with their fit, or None
    printed : (slope, intercept) shown in the paper's figure, drawn dashed
    """
    if load not in result.free_runs:
        raise ValueError(f"there is no run at load = {load}: there are runs at {', '.join(map(str, result.free_runs))}")
    rows = 2 + bool(result.sliding) + bool(line)
    figure, panels = style.column_axes(rows, 0.4 + 1.7 * rows)
    free, left = result.free_runs[load], list(panels[2:])
    x, y = (free.center[:, k] - free.center[0, k] for k in (0, 1))
    panels[0].plot(free.time, x, color=style.BLUE)
    style.plot_fast(panels[1], free.time, y, color=style.GREEN, middle=False)
    panels[0].set_title(f"$F_x$ = {load:.3f}")
    panels[0].sharex(panels[1])
    panels[0].tick_params(labelbottom=False)
    style.label_axes(panels[0], y=MOVED)
    style.label_axes(panels[1], x=style.TIME, y=(r"$\Delta C^y_\mathrm{mass}$", DIAMETER))
    if result.sliding:
        axes = left.pop(0)
        for color, (push, ensemble) in zip(style.COLORS, sorted(result.sliding.items()), strict=False):
            axes.plot(ensemble.time, ensemble.center[:, 0] - ensemble.center[0, 0], color=color, label=f"{push:.3f}")
        style.label_axes(axes, x=style.TIME, y=MOVED)
        axes.legend(title=f"{LOAD}, mean of runs", loc="upper left", ncol=2)
    if line:
        axes = left.pop(0)
        axes.errorbar(
            line.push, line.velocity, line.error, fmt="o", color=style.RED, capsize=1, lw=0.6, label="mean of runs"
        )
        ends = np.array([line.push.min(), line.push.max()])
        axes.plot(ends, line.intercept + line.slope * ends, "-", color=style.RED, lw=0.7, label="fit")
        if printed:
            axes.plot(ends, printed[1] + printed[0] * ends, "--", color=style.BLACK, lw=0.7, label="paper")
        style.label_axes(axes, x=(LOAD, "force"), y=("sliding velocity\n", SPEED.replace(" /", "\n/")))
        axes.legend(loc="upper left")
    return figure


STUCK, AT_LIMIT, SLIDES = "stuck", "has reached the Coulomb limit at the substrate", "has slid by a tenth of a diameter"


@style.styled
def transition_movie(
    result: Annotated[Any, Result("DiskArrayResult", ("trajectory", "pressed"))],
    path: str | Path,
    frames: int = round(animation.FPS * animation.SECONDS),
) -> Path:
    """Write an animation of the transition as a GIF, with disks coloured by their state."""
    data, radius = result.trajectory, result.pressed.grains.radius
    events = np.concatenate([data.breach, data.slide])
    events = events[np.isfinite(events)]
    start, stop = events.min() - 200, min(np.max(events) + 200, data.time[-1])
    times = np.linspace(max(start, data.time[0]), stop, frames)
    length, n = result.pressed.cell.vectors[0, 0], len(radius)
    with style.common_style(**{"savefig.dpi": "figure"}):
        figure = style.OwnFigure(figsize=(6.4, 1.6), dpi=150)
        axes = figure.add_axes([0.02, 0.2, 0.96, 0.62])
        axes.set(xlim=(-0.1, length + 0.1), ylim=(-0.15, 2.3 * radius.max()), aspect="equal")
        axes.axis("off")
        axes.axhspan(-0.15, 0, color="0.75")
        title = figure.text(0.5, 0.87, "", ha="center", fontsize=9)
        colors = {STUCK: style.SKY, AT_LIMIT: style.ORANGE, SLIDES: style.RED}
        marks = [Line2D([], [], marker="o", ls="", color=c, ms=7) for c in colors.values()]
        figure.legend(marks, colors, loc="lower center", ncol=3, fontsize=7)
        patches = PatchCollection([], edgecolor=style.BLACK, linewidth=0.6)
        axes.add_collection(patches)
        spokes = LineCollection([], colors=style.BLACK, linewidths=0.8)
        axes.add_collection(spokes)

        def draw(time):
            k = min(int(np.searchsorted(data.time, time)), len(data.time) - 1)
            center = np.stack([np.mod(data.position[k, :, 0], length), data.position[k, :, 1]], axis=1)
            tip = (
                np.stack([np.cos(data.angle[k] + np.pi / 2), np.sin(data.angle[k] + np.pi / 2)], axis=1)
                * radius[:, None]
            )
            face = [
                style.RED if time >= data.slide[i] else style.ORANGE if time >= data.breach[i] else style.SKY
                for i in range(n)
            ]
            copies = [
                (c + np.array([shift, 0.0]), r, f)
                for c, r, f in zip(center, radius, face, strict=True)
                for shift in (0.0, length, -length)
                if -r < c[0] + shift < length + r
            ]
            patches.set_paths([Circle(c, r) for c, r, _ in copies])
            patches.set_facecolor([f for *_, f in copies])
            spokes.set_segments(np.stack([center, center + tip], axis=1))
            moved = data.position[k, :, 0].mean() - data.position[0, :, 0].mean()
            title.set_text(f"$F_x$ = {data.load:.3f}, $t$ = {time:.0f}: centre of mass moved by {moved:.3f} diameters")

        with animation.GifWriter(fps=animation.FPS).saving(figure, path, figure.dpi) as writer:
            for time in times:
                draw(time)
                writer.grab_frame()
    return Path(path)
