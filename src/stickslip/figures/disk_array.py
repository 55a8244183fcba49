"""Figures of the disk array (paper 000)."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from ..core.arguments import Requirement, Result, require_filled, require_index
from ..solve.spectrum import Spectrum
from .style import BLACK, BLUE, COLORS, GREEN, ORANGE, PURPLE, RED, SKY, TIME, column_axes, styled

_KIND = "DiskArrayResult"
_WithPairs = Annotated[Any, Result(_KIND, ("families",))]
_WithRuns = Annotated[Any, Result(_KIND, ("free_runs",))]
_WithSliding = Annotated[Any, Result(_KIND, ("free_runs", "sliding"))]
_Front = Annotated[Any, Result("Front", ("delay", "distance", "error", "speed", "speed_error"))]
_Line = Annotated[Any, Result("fit of velocities", ("push", "velocity", "error", "intercept", "slope"))]
LOAD = r"push $F_x$"


@styled
def complex_pairs(
    results: Annotated[dict[str, _WithPairs], Requirement(require_filled)], paper: dict[float, float] | None = None
):
    """Im λ of every complex pair against the push, one panel per result, with births and deaths (Fig 2).

    Parameters
    ----------
    results : title -> DiskArrayResult
    paper : load -> Im λ printed in the paper, drawn as crosses
    """
    figure, panels = column_axes(len(results), 1.0 + 1.45 * len(results), sharex=True, squeeze=False)
    for axes, (title, result) in zip(panels[:, 0], results.items(), strict=True):
        for k, family in enumerate(result.families):
            color = COLORS[k % len(COLORS)]
            loads, values = family.loads, family.eigenvalues.imag
            ends = [(c.load, 0.0) for c in (family.birth, family.death) if c]
            if family.birth:
                loads, values = np.r_[family.birth.load, loads], np.r_[0.0, values]
            if family.death:
                loads, values = np.r_[loads, family.death.load], np.r_[values, 0.0]
            axes.plot(loads, 1e3 * values, color=color)
            if ends:
                axes.plot(*np.transpose(ends), "o", color=color, mfc="white", ms=3)
        if not result.families:
            axes.text(0.5, 0.5, "all eigenvalues real", ha="center", transform=axes.transAxes)
        if paper:
            axes.plot(
                paper.keys(), 1e3 * np.array(list(paper.values())), "x", color=BLACK, ms=5, label="paper", zorder=5
            )
            axes.legend(loc="upper left")
        axes.set_ylabel(r"$10^3\,\mathrm{Im}\,\lambda$ [$k_n\sqrt{2R}/m$]")
        axes.set_title(title, fontsize=7.5)
        axes.set_ylim(bottom=-0.03 * axes.get_ylim()[1])
    panels[-1, 0].set_xlabel(f"{LOAD} [force]")
    return figure


@styled
def mean_square_displacement(result: _WithRuns):
    """M(t) at every load, with the predicted growth (Fig 3)."""
    figure, axes = column_axes(height=2.7)
    for color, (load, free) in zip(COLORS * 5, result.free_runs.items(), strict=False):
        shown = free.msd > 0
        axes.semilogy(free.time[shown], free.msd[shown], color=color, lw=0.6, label=f"{load:.3f}", rasterized=True)
        if free.growth:
            t = np.array([free.growth.start, free.growth.stop])
            inside = (free.time >= t[0]) & (free.time <= t[1])
            level = np.mean(np.log(free.msd[inside]) - 2 * free.predicted_growth * free.time[inside])
            axes.semilogy(t, np.exp(level + 2 * free.predicted_growth * t), "--", color=BLACK, lw=0.8, zorder=4)
    handles, labels = axes.get_legend_handles_labels()
    if any(f.growth for f in result.free_runs.values()):
        handles.append(Line2D([], [], ls="--", color=BLACK, lw=0.8))
        labels.append(r"$\propto e^{2\omega_i t}$, predicted")
    legend = axes.legend(handles, labels, title=LOAD, loc="lower right", ncol=2, title_fontsize=6.5)
    for line in legend.get_lines():
        line.set_linewidth(1.5)
    axes.set(xlabel=TIME, ylabel=r"$M(t)=\Sigma_i|\mathbf{r}_i(t)-\mathbf{r}_i(0)|^2$ [$(2R)^2$]")
    axes.set_ylim(bottom=0.1 * min(np.percentile(f.msd[f.msd > 0], 1) for f in result.free_runs.values()))
    return figure


@styled
def trajectory(result: Annotated[Any, Result(_KIND, ("trajectory",))], grain: int = 3):
    """Path of one disk in the x–y plane, coloured by time: the growing spiral, and the path until breaching (Fig 4)."""
    data = result.trajectory
    require_index(len(data.breach), grain=grain)
    figure, panels = column_axes(2, 4.6)
    end = data.breach[grain] if np.isfinite(data.breach[grain]) else data.time[-1]
    first = data.first_limit if np.isfinite(data.first_limit) else end
    windows = (
        (
            (first - 150, first),
            f"disk {grain + 1}, $F_x$ = {data.load:.3f}, before any contact reaches the Coulomb limit",
        ),
        ((first, end), "from there until its contact with the substrate does"),
    )
    for axes, ((start, stop), title) in zip(panels, windows, strict=True):
        shown = (data.time >= start) & (data.time <= max(stop, start + 150))
        power = -int(np.floor(np.log10(np.ptp(data.position[shown, grain], axis=0).max())))
        xy = 10.0**power * (data.position[shown, grain] - data.position[shown, grain].mean(axis=0))
        lines = LineCollection(np.stack([xy[:-1], xy[1:]], axis=1), cmap="viridis", array=data.time[shown][1:], lw=0.5)
        axes.add_collection(lines)
        axes.autoscale()
        axes.set(xlabel=rf"$10^{{{power}}}\,\Delta x$ [$2R$]", ylabel=rf"$10^{{{power}}}\,\Delta y$ [$2R$]")
        axes.set_title(title, fontsize=7)
        figure.colorbar(lines, ax=axes, label=TIME, pad=0.02)
    return figure


def _plot_front(axes, found, color, label, sign=1):
    axes.errorbar(
        sign * found.delay, found.distance, xerr=found.error, fmt="o", color=color, label=label, capsize=1.5, lw=0.7
    )
    reach = np.array([0, found.distance[-1]])
    axes.plot(sign * reach / found.speed, reach, "--", color=color, lw=0.8)


@styled
def traveling_fronts(forward: dict[float, _Front | None], backward: _Front | None, threshold: float):
    """Mean times of breaching (forward) and of sliding (backward) with the fitted speeds (Fig 5).

    Parameters
    ----------
    forward : load -> Front; backward : Front or None
    """
    figure, (top, bottom) = column_axes(2, 4.2)
    for color, (load, found) in zip((BLUE, GREEN, RED, ORANGE), forward.items(), strict=False):
        if found:
            words = (
                rf"$F_x$ = {load:.3f}: $V_1$ = {1e3 * found.speed:.2f}({1e3 * found.speed_error:.2f})$\times 10^{{-3}}$"
            )
            _plot_front(top, found, color, words)
    top.set(
        xlabel=r"mean delay of breaching $\tau_i-\tau_1$ [$\sqrt{m/(k_n\sqrt{2R})}$]",
        ylabel=r"distance from disk 1 [$2R$]",
    )
    if backward:
        words = f"$V_2$ = {backward.speed:.3f}({backward.speed_error:.3f})"
        _plot_front(bottom, backward, PURPLE, words)
    bottom.set(
        xlabel=rf"mean delay of sliding by {threshold:g} $\times 2R$ [$\sqrt{{m/(k_n\sqrt{{2R}})}}$]",
        ylabel="distance from the last disk [$2R$]",
    )
    for axes in (top, bottom):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="upper left")
        else:
            axes.text(0.5, 0.5, "no front", ha="center", transform=axes.transAxes)
        axes.set_ylim(-0.4, axes.get_ylim()[1] * (1.55 if axes is top else 1.2))
    return figure


@styled
def mode_shape(spectrum: Spectrum, index: int):
    """Components of one mode by coordinate: x, y and R·angle of all disks (Fig 6)."""
    require_index(spectrum.modes.shape[1], index=index)
    figure, axes = column_axes(height=2.3)
    mode = spectrum.modes[:, index]
    mode = mode * np.exp(-1j * np.angle(mode[np.argmax(np.abs(mode))]))
    value = mode.real * np.sqrt(spectrum.free.mass)
    n = int(np.sum(spectrum.free.axis == 0))
    for k, (axis, name, color) in enumerate(((0, "$x$", BLUE), (1, "$y$", GREEN), (5, r"$R\,\theta$", ORANGE))):
        part = value[spectrum.free.axis == axis]
        axes.bar(k * n + 1 + np.arange(len(part)), part, color=color, label=name, width=0.8)
    axes.axhline(0, color=BLACK, lw=0.5)
    share = spectrum.shares()[index]
    axes.set_title(rf"$\omega$ = {spectrum.frequency[index]:.4f}, share in $y$ {share[1]:.1%}", fontsize=7.5)
    axes.set(xlabel=r"degree of freedom $q_\ell$", ylabel="mass-weighted component")
    axes.set_ylim(*1.35 * np.array(axes.get_ylim()))
    axes.legend(ncol=3, loc="upper right")
    return figure


@styled
def center_of_mass(
    result: _WithSliding, load: float, line: _Line | None = None, printed: tuple[float, float] | None = None
):
    """Centre of mass through the transition, and sliding velocity against push (Fig 7, Eq 10).

    Parameters
    ----------
    load : load of the upper panel
    line : measured velocities with their fit, or None
    printed : (slope, intercept) shown in the paper's figure, drawn dashed
    """
    if load not in result.free_runs:
        raise ValueError(f"load = {load} was given: there are runs at {', '.join(map(str, result.free_runs))}")
    figure, (top, bottom) = column_axes(2, 5.0)
    free = result.free_runs[load]
    x = free.center[:, 0] - free.center[0, 0]
    top.plot(free.time, x, color=BLUE)
    top.set(xlabel=TIME, ylabel=r"$C^x_\mathrm{mass}-C^x_\mathrm{mass}(0)$ [$2R$]")
    top.set_title(f"$F_x$ = {load:.3f}", fontsize=7.5)
    top.set_ylim(top=1.12 * x.max() if x.max() > 0 else None)
    inset = top.inset_axes([0.15, 0.55, 0.36, 0.36])
    y = 1e4 * (free.center[:, 1] - free.center[0, 1])
    inset.plot(free.time, y, color=GREEN, lw=0.3, rasterized=True)
    inset.set_title(r"$10^4\,\Delta C^y_\mathrm{mass}$", fontsize=6, pad=2)
    started = int(np.argmax(np.abs(x) > 0.02)) if (np.abs(x) > 0.02).any() else len(x) - 1
    zoom = top.inset_axes([0.72, 0.1, 0.26, 0.3])
    near = slice(max(started - 900, 0), started + 600)
    zoom.plot(free.time[near], x[near], color=BLUE, lw=0.7)
    zoom.set_title(r"$\Delta C^x_\mathrm{mass}$", fontsize=6, pad=2)
    for small in (inset, zoom):
        small.tick_params(labelsize=6, length=2)
        small.xaxis.set_major_locator(plt.MaxNLocator(3))
        small.set_facecolor("white")
    for color, (push, ensemble) in zip(COLORS, sorted(result.sliding.items()), strict=False):
        bottom.plot(ensemble.time, ensemble.center[:, 0] - ensemble.center[0, 0], color=color, label=f"{push:.3f}")
    bottom.set(xlabel=TIME, ylabel=r"$C^x_\mathrm{mass}-C^x_\mathrm{mass}(0)$ [$2R$]")
    bottom.xaxis.set_major_locator(plt.MaxNLocator(5))
    bottom.set_ylim(top=2.1 * max(1e-3, bottom.get_ylim()[1]))
    if result.sliding:
        bottom.legend(title=LOAD, loc="upper left", ncol=2, title_fontsize=6.5)
    if line:
        small = bottom.inset_axes([0.64, 0.56, 0.34, 0.4])
        small.errorbar(line.push, 1e5 * line.velocity, 1e5 * line.error, fmt="o", color=RED, ms=2, capsize=1, lw=0.6)
        ends = np.array([line.push.min(), line.push.max()])
        small.plot(ends, 1e5 * (line.intercept + line.slope * ends), "-", color=RED, lw=0.7, label="fit")
        if printed:
            small.plot(ends, 1e5 * (printed[1] + printed[0] * ends), "--", color=BLACK, lw=0.7, label="paper")
        small.set_ylabel(r"$10^5\,V^x_\mathrm{mass}$", fontsize=6)
        small.set_xlabel("$F_x$", fontsize=6, labelpad=0)
        small.tick_params(labelsize=6, length=2)
        small.legend(fontsize=6, loc="upper left")
    return figure


STUCK, AT_LIMIT, SLIDES = "stuck", "has reached the Coulomb limit at the substrate", "has slid by a tenth of a diameter"


@styled
def transition_movie(result, path: str | Path, frames: int = 90) -> Path:
    """Write an animation of the transition as a GIF, with disks coloured by their state."""
    data, radius = result.trajectory, result.pressed.grains.radius
    events = np.concatenate([data.breach, data.slide])
    events = events[np.isfinite(events)]
    start, stop = events.min() - 200, min(np.max(events) + 200, data.time[-1])
    times = np.linspace(max(start, data.time[0]), stop, frames)
    length, n = result.pressed.cell.vectors[0, 0], len(radius)
    with plt.rc_context({"figure.constrained_layout.use": False, "savefig.dpi": "figure"}):
        figure = plt.figure(figsize=(6.4, 1.6), dpi=110)
        axes = figure.add_axes([0.02, 0.2, 0.96, 0.62])
        axes.set(xlim=(-0.1, length + 0.1), ylim=(-0.15, 2.3 * radius.max()), aspect="equal")
        axes.axis("off")
        axes.axhspan(-0.15, 0, color="0.75")
        title = figure.text(0.5, 0.87, "", ha="center", fontsize=9)
        colors = {STUCK: SKY, AT_LIMIT: ORANGE, SLIDES: RED}
        marks = [Line2D([], [], marker="o", ls="", color=c, ms=7) for c in colors.values()]
        figure.legend(marks, colors, loc="lower center", ncol=3, fontsize=7)
        patches = PatchCollection([], edgecolor=BLACK, linewidth=0.6)
        axes.add_collection(patches)
        spokes = LineCollection([], colors=BLACK, linewidths=0.8)
        axes.add_collection(spokes)

        def draw(time):
            k = min(int(np.searchsorted(data.time, time)), len(data.time) - 1)
            center = np.stack([np.mod(data.position[k, :, 0], length), data.position[k, :, 1]], axis=1)
            tip = (
                np.stack([np.cos(data.angle[k] + np.pi / 2), np.sin(data.angle[k] + np.pi / 2)], axis=1)
                * radius[:, None]
            )
            face = [RED if time >= data.slide[i] else ORANGE if time >= data.breach[i] else SKY for i in range(n)]
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
            title.set_text(
                f"$F_x$ = {data.load:.3f}   t = {time:8.0f}   centre of mass moved by {moved:6.3f} diameters"
            )
            return patches, spokes, title

        FuncAnimation(figure, draw, frames=times, blit=False).save(path, writer=PillowWriter(fps=15))
    plt.close(figure)
    return Path(path)
