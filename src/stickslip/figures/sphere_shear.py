"""Figures of the sheared packing (paper 001)."""

import numpy as np
from matplotlib import pyplot as plt

from .style import BLACK, BLUE, COLORS, GREEN, ORANGE, RED, TIME, WIDTH, axes_of, styled

IM = r"$\mathrm{Im}\,\lambda$ [$k_n\sqrt{2\sigma_1}/m$]"


@styled
def pairs_along_strain(paths, fine: float):
    """Smallest and largest Im λ of one packing up to `fine`, and the number of pairs of all packings (Fig 1)."""
    figure, (top, bottom) = axes_of(2, 4.2)
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
    if alive.any():
        top.set_ylim(0, 1.25 * 1e5 * path.largest[near].max())
        top.legend(loc="upper left", ncol=2)
    for color, p in zip(COLORS, paths, strict=False):
        bottom.plot(1e2 * p.strain, p.pairs, color=color, lw=0.8, label=f"packing {p.seed}")
    bottom.set(xlabel=r"strain $10^2\,\gamma$", ylabel="complex pairs")
    bottom.set_ylim(0, 1.05 * max(1, max(p.pairs.max() for p in paths)))
    bottom.legend(loc="upper left")
    return figure


@styled
def spectrum_in_time(run):
    """Im λ of all eigenvalues of the momentary state during a Newtonian run, above M(t) (Fig 2)."""
    figure, (top, bottom) = axes_of(2, 3.8, sharex=True)
    time = np.repeat(run.snapshot_time, run.snapshots.shape[1])
    im = run.snapshots.imag.ravel()
    top.plot(time, im, ".", ms=1.2, color=BLUE, rasterized=True)
    top.set_yscale("symlog", linthresh=10 ** np.floor(np.log10(0.3 * abs(run.eigenvalue.imag))), linscale=0.6)
    top.set(ylabel=IM)
    top.set_title(f"strain {run.strain:.3g}, {run.pairs} pair(s) at the start", fontsize=7.5)
    bottom.semilogy(run.time[1:], run.msd[1:], color=BLUE, lw=0.6)
    bottom.semilogy(run.snapshot_time, run.snapshot_msd, ".", color=ORANGE, ms=2.5, label="spectrum taken")
    if np.isfinite(run.constant[0]):
        bottom.axhline(run.constant[0], color=RED, ls=":", lw=0.8, label="spectrum constant below")
    bottom.set(xlabel=TIME, ylabel=r"$M$ [$(2\sigma_1)^2$]")
    bottom.legend(loc="lower right")
    return figure


@styled
def growth(run):
    """M(t) with the growth that the spectrum predicts, and the fitted oscillation in close-up (Fig 3)."""
    figure, (top, bottom) = axes_of(2, 4.2)
    time, msd = run.time[1:], run.msd[1:]
    top.semilogy(time, msd, color=BLUE, lw=0.7)
    if run.growth:
        middle = 0.5 * (run.growth.start + run.growth.stop)
        period = np.pi / run.growth.frequency
        level = np.exp(np.log(msd[np.abs(time - middle) < 8 * period]).mean())
        t = np.linspace(run.growth.start - 0.1 * run.growth.stop, run.growth.stop * 1.1, 200)
        rise = level * np.exp(2 * run.corrected_rate * (t - middle))
        words = rf"predicted $e^{{2\omega_i t}}$, $\omega_i$ = {run.growth_rate:.3e}"
        top.semilogy(t, rise, "--", color=RED, lw=0.8, label=words)
        top.legend(loc="lower right")
        near = np.abs(time - middle) < 3 * period
        x, y = time[near] - middle, msd[near]
        phase = 2 * run.growth.frequency * x
        shape = np.exp(2 * run.growth.growth_rate * x)[:, None]
        shape = shape * np.stack([np.ones_like(x), np.cos(phase), np.sin(phase)], axis=1)
        a = np.linalg.lstsq(shape, y, rcond=None)[0]
        fine = np.linspace(x.min(), x.max(), 400)
        turn = 2 * run.growth.frequency * fine
        fit = np.exp(2 * run.growth.growth_rate * fine) * (a[0] + a[1] * np.cos(turn) + a[2] * np.sin(turn))
        power = int(np.floor(np.log10(y.max())))
        bottom.plot(x, y / 10.0**power, "o", color=BLUE, ms=2, label=r"$M$")
        bottom.plot(fine, fit / 10.0**power, "--", color=RED, lw=0.8, label="fit")
        bottom.set(xlabel=f"time $t$ − {middle:.0f}", ylabel=rf"$10^{{{-power}}}\,M$ [$(2\sigma_1)^2$]")
        bottom.legend(loc="upper left", ncol=2)
        bottom.set_ylim(top=1.2 * y.max() / 10.0**power)
    else:
        bottom.text(0.5, 0.5, "M did not cross the window of the fit", ha="center", transform=bottom.transAxes)
    top.set(xlabel=TIME, ylabel=r"$M$ [$(2\sigma_1)^2$]")
    top.set_title(f"strain {run.strain:.4g}", fontsize=7.5)
    return figure


@styled
def trajectories(run, dim: int, grains: int = 5):
    """Displacements of the grains that move most while the instability grows (Fig 4)."""
    figure = plt.figure(figsize=(WIDTH, 3.1))
    size = np.abs(run.track).max(axis=(0, 2))
    power = -int(np.floor(np.log10(size.max()))) if size.max() > 0 else 0
    track = run.track[:, np.argsort(-size)[:grains]] * 10.0**power
    if dim == 2:
        axes = figure.add_subplot()
        for color, k in zip(COLORS, range(track.shape[1]), strict=False):
            axes.plot(track[:, k, 0], track[:, k, 1], color=color, lw=0.4)
        axes.set(xlabel=rf"$10^{{{power}}}\,\Delta x$", ylabel=rf"$10^{{{power}}}\,\Delta y$", aspect="equal")
        return figure
    axes = figure.add_subplot(projection="3d")
    axes.set_box_aspect((1, 1, 1), zoom=0.82)
    for color, k in zip(COLORS, range(track.shape[1]), strict=False):
        axes.plot(*track[:, k].T, color=color, lw=0.35)
    for axis, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_label_text(rf"$10^{{{power}}}\,\Delta {name}$")
        axis.set_tick_params(pad=-3, labelsize=5.5)
        axis.labelpad = -7
        axis.set_major_locator(plt.MaxNLocator(4))
    return figure


@styled
def stress_through_failure(runs):
    """Shear stress over pressure, and contacts, against time in growth times, for several runs (Fig 5)."""
    figure, (top, middle, bottom) = axes_of(3, 5.0, sharex=False)
    for color, run in zip((BLUE, RED, GREEN, BLACK), runs, strict=False):
        time = run.time * run.growth_rate
        words = rf"$\gamma$ = {run.strain:.2g}, {run.pairs} pair(s)"
        top.plot(time, run.shear_stress / run.pressure[0], color=color, lw=0.7, label=words, rasterized=True)
        bottom.plot(time, run.touching, color=color, lw=0.7, rasterized=True)
    first = runs[0]
    early = (first.msd > 1e-14) & (first.msd < 1e-11)
    if early.any():
        change = first.shear_stress - first.shear_stress[0]
        power = -int(np.floor(np.log10(np.abs(change[early]).max() or 1.0)))
        middle.plot(first.time[early] * first.growth_rate, change[early] * 10.0**power, color=BLUE, lw=0.2)
        middle.set_ylabel(rf"$-10^{{{power}}}\,\Delta\sigma_{{xy}}$")
        middle.set_title("the linear stage of the first, in close-up", fontsize=7)
    top.set_ylabel(r"$-\sigma_{xy}/p(0)$")
    low, high = top.get_ylim()
    top.set_ylim(low, high + 0.45 * (high - low))
    top.legend(loc="upper left")
    bottom.set(xlabel=r"time $\omega_i t$, in growth times of each", ylabel="contacts")
    return figure
