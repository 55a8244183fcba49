"""Figures of the sheared packing (Bonfanti et al. 2020)."""

from typing import Annotated, Any

import numpy as np
from matplotlib import pyplot as plt

from ..core.arguments import Requirement, Result, require_filled
from ..core.readable import pluralize
from .style import BLUE, COLORS, GREEN, ORANGE, RED, TIME, WIDTH, column_axes, styled

IM = r"$\mathrm{Im}\,\lambda$ [$k_n\sqrt{2\sigma_1}/m$]"

_KIND = "run of a ShearResult"
_Path = Annotated[Any, Result("ShearPath", ("pairs", "strain", "onset", "largest"))]
_Failure = Annotated[Any, Result(_KIND, ("time", "msd", "shear_stress", "growth_rate", "pairs"))]


@styled
def pairs_along_strain(paths: Annotated[list[_Path], Requirement(require_filled)], fine: float):
    """Smallest and largest Im λ of one packing up to `fine`, and the number of pairs for all packings (Fig 1)."""
    figure, (top, bottom) = column_axes(2, 4.2)
    path = max(paths, key=lambda p: (p.pairs[p.strain <= fine] > 0).sum())
    near = path.strain <= fine
    for value, color, label in ((path.largest, GREEN, "largest"), (path.smallest, BLUE, "smallest")):
        alive = near & (path.pairs > 0)
        top.plot(1e4 * path.strain[alive], 1e5 * value[alive], ".", ms=2.5, color=color)
        top.plot(1e4 * path.strain[near], 1e5 * np.where(alive, value, np.nan)[near], color=color, lw=0.7, label=label)
    if path.onset:
        top.axvline(1e4 * path.onset.strain, color=RED, ls=":", lw=0.8)
        top.plot(1e4 * (path.onset.strain + path.onset.offset), 1e5 * path.onset.im_lambda, "+", color=RED, ms=3)
        top.set_title(rf"packing {path.seed}, first pair at $\gamma_c$ = {path.onset.strain:.6f}", fontsize=7.5)
    top.set(xlabel=r"strain $10^4\,\gamma$", ylabel="$10^5$ " + IM)
    top.set_yscale("log")
    if alive.any():
        top.set_ylim(top=6e5 * path.largest[near].max())
        top.legend(loc="upper left", ncol=2)
    for color, p in zip(COLORS, paths, strict=False):
        bottom.plot(1e2 * p.strain, p.pairs, color=color, lw=0.8, label=f"packing {p.seed}")
    bottom.set(xlabel=r"strain $10^2\,\gamma$", ylabel="complex pairs")
    bottom.set_ylim(0, 1.05 * max(1, max(p.pairs.max() for p in paths)))
    bottom.legend(loc="upper left")
    return figure


@styled
def spectrum_in_time(run: Annotated[Any, Result(_KIND, ("snapshot_time", "snapshots", "eigenvalue"))]):
    """Im λ of all eigenvalues of the current state during a Newtonian run, above M(t) (Fig 2)."""
    figure, (top, bottom) = column_axes(2, 3.8, sharex=True)
    time = np.repeat(run.snapshot_time, run.snapshots.shape[1])
    im = run.snapshots.imag.ravel()
    top.plot(time, im, ".", ms=1.2, color=BLUE, rasterized=True)
    top.set_yscale("symlog", linthresh=10 ** np.floor(np.log10(0.3 * abs(run.eigenvalue.imag))), linscale=0.6)
    top.set(ylabel=IM)
    top.set_title(rf"$\gamma$ = {run.strain:.2g}, {pluralize(run.pairs, 'pair')} at the start", fontsize=7.5)
    bottom.semilogy(run.time[1:], run.msd[1:], color=BLUE, lw=0.6)
    bottom.semilogy(run.snapshot_time, run.snapshot_msd, ".", color=ORANGE, ms=2.5, label="spectrum taken")
    if np.isfinite(run.constant[0]):
        bottom.axhline(run.constant[0], color=RED, ls=":", lw=0.8, label="spectrum constant below")
    bottom.set(xlabel=TIME, ylabel=r"$M$ [$(2\sigma_1)^2$]")
    bottom.legend(loc="lower right")
    return figure


@styled
def growth(run: Annotated[Any, Result(_KIND, ("time", "msd", "growth", "close_time"))]):
    """M(t) with the growth predicted by the spectrum, and a close-up of the fitted oscillation (Fig 3)."""
    figure, (top, bottom) = column_axes(2, 4.2)
    time, msd = run.time[1:], run.msd[1:]
    top.semilogy(time, msd, color=BLUE, lw=0.7)
    if run.growth and len(run.close_time):
        x, y = run.close_time - run.close_time[0], run.close_msd
        t = np.linspace(run.growth.start, run.growth.stop, 200)
        rise = np.exp(np.log(y).mean() + 2 * run.corrected_rate * (t - run.close_time.mean()))
        words = rf"predicted $e^{{2\omega_i t}}$, $\omega_i$ = {run.growth_rate:.3e}"
        top.semilogy(t, rise, "--", color=RED, lw=0.9, label=words)
        top.legend(loc="lower right")
        fine = np.linspace(x.min(), x.max(), 600)
        shape, drawn = _oscillation(x, run.growth), _oscillation(fine, run.growth)
        fit = drawn @ np.linalg.lstsq(shape, y, rcond=None)[0]
        power = int(np.floor(np.log10(y.max())))
        bottom.plot(x, y / 10.0**power, "o", color=BLUE, ms=2, label=r"$M$")
        bottom.plot(fine, fit / 10.0**power, "--", color=RED, lw=0.8, label="fit")
        bottom.set(
            xlabel=rf"$t$ − {run.close_time[0]:.0f} [$\sqrt{{m/(k_n\sqrt{{2R}})}}$]",
            ylabel=rf"$10^{{{-power}}}\,M$ [$(2\sigma_1)^2$]",
        )
        bottom.legend(loc="upper left", ncol=2)
        bottom.set_ylim(top=1.25 * y.max() / 10.0**power)
    else:
        bottom.text(0.5, 0.5, "M did not cross the fit window", ha="center", transform=bottom.transAxes)
    top.set(xlabel=TIME, ylabel=r"$M$ [$(2\sigma_1)^2$]")
    top.set_title(rf"$\gamma$ = {run.strain:.3g}", fontsize=7.5)
    return figure


def _oscillation(time, growth):
    """Columns e^{2ω_i t} [1, cos 2ω_r t, sin 2ω_r t] of the fit."""
    turn = 2 * growth.frequency * time
    rise = np.exp(2 * growth.growth_rate * time)[:, None]
    return rise * np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=1)


@styled
def trajectories(run: Annotated[Any, Result(_KIND, ("turns", "turn_time", "frequency"))], dim: int, grains: int = 4):
    """Displacements during a few of the many turns of growth: grains in space, and one grain against time (Fig 4)."""
    figure = plt.figure(figsize=(WIDTH, 5.4 if dim == 3 else 4.6))
    if not len(run.turns):
        figure.text(0.5, 0.5, "M did not grow far enough", ha="center")
        return figure
    size = np.abs(run.turns).max(axis=(0, 1, 3))
    power = -int(np.floor(np.log10(size.max())))
    gap = np.full((len(run.turns), 1, len(size), 3), np.nan)  # between turns
    path = np.concatenate([run.turns, gap], axis=1).reshape(-1, len(size), 3) * 10.0**power
    most = np.argsort(-size)[:grains]
    above = figure.add_subplot(2, 1, 1, **({"projection": "3d"} if dim == 3 else {"aspect": "equal"}))
    for color, k in zip((BLUE, GREEN, ORANGE, RED), most, strict=False):
        above.plot(*path[:, k, :dim].T, color=color, lw=0.5)
    funnel = figure.add_subplot(2, 1, 2, projection="3d")
    one = run.turns[:, :, most[0]]
    axes = np.linalg.svd(one.reshape(-1, 3), full_matrices=False)[2][:2]
    turned = np.concatenate([one @ axes.T, np.full((len(one), 1, 2), np.nan)], axis=1) * 10.0**power
    step = np.arange(one.shape[1] + 1) * 2 * np.pi / run.frequency / 10
    time = (run.turn_time[:, None] + step - run.turn_time[0]) * run.growth_rate
    funnel.plot(*turned.reshape(-1, 2).T, time.ravel(), color=BLUE, lw=0.5)
    names = [rf"$10^{{{power}}}\,\Delta {c}$" for c in "xyz"[:dim]]
    _label_axes(above, names, dim)
    _label_axes(funnel, ["major axis", "minor axis", r"$\omega_i t$"], 3)
    return figure


def _label_axes(axes, names, dim: int) -> None:
    """Label the axes, close to the ticks in three dimensions."""
    axes.set(**{f"{c}label": name for c, name in zip("xyz", names, strict=False)})
    if dim == 3:
        axes.set_box_aspect((1, 1, 0.8), zoom=0.85)
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_tick_params(pad=-3, labelsize=6)
            axis.labelpad = -6
            axis.set_major_locator(plt.MaxNLocator(4))


@styled
def stress_through_failure(first: _Failure, later: _Failure | None = None):
    """Shear stress over the initial pressure, and number of contacts, during one or two runs (Fig 5)."""
    figure, (top, middle, bottom) = column_axes(3, 5.2)
    _plot_stress_and_contacts(top, first)
    early = first.msd < 1e-11
    early &= first.time * first.growth_rate > (first.time[early] * first.growth_rate).max() - 3
    change = first.shear_stress - first.shear_stress[0]
    power = -int(np.floor(np.log10(np.abs(change[early]).max() or 1.0)))
    middle.plot(first.time[early], change[early] * 10.0**power, color=BLUE, lw=0.2, rasterized=True)
    middle.set(xlabel=TIME, ylabel=rf"$-10^{{{power}}}\,\Delta\sigma_{{xy}}$ [stress]")
    middle.set_title("the same in its linear stage", fontsize=7)
    if later is None:
        bottom.axis("off")
    else:
        _plot_stress_and_contacts(bottom, later)
    return figure


def _plot_stress_and_contacts(axes, run) -> None:
    axes.plot(run.time, run.shear_stress / run.pressure[0], color=BLUE, lw=0.5, rasterized=True)
    axes.set(xlabel=TIME, ylabel=r"$-\sigma_{xy}/p(0)$")
    axes.yaxis.label.set_color(BLUE)
    other = axes.twinx()
    axes.set_zorder(other.get_zorder() + 1)  # stress in front
    axes.patch.set_visible(False)
    other.plot(run.time, run.touching, color=ORANGE, lw=0.4, rasterized=True)
    other.set_ylabel("contacts", color=ORANGE)
    other.yaxis.set_major_locator(plt.MaxNLocator(5, integer=True))
    pairs = "1 pair" if run.pairs == 1 else f"{run.pairs} pairs"
    axes.set_title(rf"$\gamma$ = {run.strain:.2g}, {pairs} at the start", fontsize=7)
