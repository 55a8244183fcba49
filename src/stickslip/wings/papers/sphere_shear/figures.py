"""Figures of the sheared packing (Bonfanti et al. 2020)."""

from typing import Annotated, Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import CubicSpline

from ....kit import FILLED, Result, pluralize, style

IM = (r"$\mathrm{Im}\,\lambda$", r"$k_n\sqrt{2\sigma_1}/m$")  # quantity and unit
M = ("$M$", "diameters²")
FINE = 8  # number of points drawn from one stored point of a path to the next

_KIND = "run of a ShearResult"
_Path = Annotated[Any, Result("ShearPath", ("pairs", "strain", "onset", "largest"))]
_Failure = Annotated[Any, Result(_KIND, ("time", "msd", "shear_stress", "growth_rate", "pairs"))]


@style.styled
def pairs_along_strain(paths: Annotated[list[_Path], FILLED], fine: float):
    """Smallest and largest Im λ of one packing up to `fine`, and number of pairs for all packings (Fig 1)."""
    figure, (top, bottom) = style.column_axes(2, 4.2)
    path = max(paths, key=lambda p: (p.pairs[p.strain <= fine] > 0).sum())
    near = path.strain <= fine
    for value, color, label in ((path.largest, style.GREEN, "largest"), (path.smallest, style.BLUE, "smallest")):
        alive = near & (path.pairs > 0)
        top.plot(
            path.strain[near], np.where(alive, value, np.nan)[near], ".-", ms=2.5, color=color, lw=0.7, label=label
        )
    if path.onset:
        top.axvline(path.onset.strain, color=style.RED, ls=":", lw=0.8, label=r"first pair, $\gamma_c$")
        near_onset = path.onset.strain + path.onset.offset
        top.plot(near_onset, path.onset.im_lambda, "+", color=style.RED, ms=3, label=r"closer to $\gamma_c$")
    top.set_yscale("log")
    style.label_axes(top, x=r"strain $\gamma$", y=IM)
    onset = rf", $\gamma_c$ = {path.onset.strain:.6f}" if path.onset else ""
    if alive.any():
        style.legend_above(top, ncol=2, title=f"packing {path.seed}{onset}")
    for color, p in zip(style.COLORS, paths, strict=False):
        bottom.plot(p.strain, p.pairs, color=color, lw=0.8, label=f"packing {p.seed}")
    style.label_axes(bottom, x=r"strain $\gamma$", y="complex pairs", whole="y")
    bottom.set_ylim(0, 1.05 * max(1, max(p.pairs.max() for p in paths)))
    bottom.legend(loc="upper left")
    return figure


@style.styled
def spectrum_in_time(run: Annotated[Any, Result(_KIND, ("snapshot_time", "snapshots", "eigenvalue"))]):
    """Im λ of all eigenvalues of the current state during a Newtonian run, above M(t) (Fig 2)."""
    figure, (top, bottom) = style.column_axes(2, 3.8, sharex=True)
    time = np.repeat(run.snapshot_time, run.snapshots.shape[1])
    im = run.snapshots.imag.ravel()
    top.plot(time, im, ".", ms=1.2, color=style.BLUE, rasterized=True)
    top.set_yscale("symlog", linthresh=10 ** np.floor(np.log10(0.3 * abs(run.eigenvalue.imag))), linscale=0.6)
    style.label_axes(top, y=IM)
    top.set_title(rf"$\gamma$ = {run.strain:.2g}, {pluralize(run.pairs, 'pair')} at the start")
    bottom.set_yscale("log")
    style.plot_fast(bottom, run.time[1:], run.msd[1:], color=style.BLUE, label="$M$", middle=False)
    bottom.semilogy(run.snapshot_time, run.snapshot_msd, ".", color=style.ORANGE, ms=2.5, label="spectrum taken")
    if np.isfinite(run.constant[0]):
        bottom.axhline(run.constant[0], color=style.RED, ls=":", lw=0.8, label="spectrum constant below")
    style.label_axes(bottom, x=style.TIME, y=M)
    bottom.legend(loc="lower right")
    return figure


@style.styled
def growth(run: Annotated[Any, Result(_KIND, ("time", "msd", "growth", "close_time"))]):
    """M(t) with the growth predicted by the spectrum, and a close-up of the fitted oscillation (Fig 3)."""
    figure, (top, bottom) = style.column_axes(2, 4.2)
    time, msd = run.time[1:], run.msd[1:]
    top.set_yscale("log")
    style.plot_fast(top, time, msd, color=style.BLUE, label="$M$", middle=False)
    if run.growth and len(run.close_time):
        x, y = run.close_time - run.close_time[0], run.close_msd
        t = np.linspace(run.growth.start, run.growth.stop, 200)
        rise = np.exp(np.log(y).mean() + 2 * run.corrected_rate * (t - run.close_time.mean()))
        label = rf"predicted $e^{{2\omega_i t}}$, $\omega_i$ = {style.power_of_ten(run.growth_rate)}"
        top.semilogy(t, rise, "--", color=style.RED, lw=0.9, label=label)
        top.legend(loc="lower right")
        fine = np.linspace(x.min(), x.max(), 600)
        shape, drawn = _oscillation(x, run.growth), _oscillation(fine, run.growth)
        fit = drawn @ np.linalg.lstsq(shape, y, rcond=None)[0]
        bottom.plot(x, y, "o", color=style.BLUE, ms=2, label="$M$")
        bottom.plot(fine, fit, "--", color=style.RED, lw=0.8, label="fit")
        style.label_axes(bottom, x=(f"$t$ − {run.close_time[0]:.0f}", style.TIME[1]), y=M)
        style.legend_above(bottom)
    else:
        bottom.text(0.5, 0.5, "M did not cross the fit window", ha="center", transform=bottom.transAxes)
    style.label_axes(top, x=style.TIME, y=M)
    top.set_title(rf"$\gamma$ = {run.strain:.3g}")
    return figure


def _oscillation(time, growth):
    """Columns e^{2ω_i t} [1, cos 2ω_r t, sin 2ω_r t] of the fit."""
    turn = 2 * growth.frequency * time
    rise = np.exp(2 * growth.growth_rate * time)[:, None]
    return rise * np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=1)


@style.styled
def trajectories(run: Annotated[Any, Result(_KIND, ("turns", "turn_time", "frequency"))], dim: int, grains: int = 4):
    """Displacements during a few periods of growth: trajectories of grains, and one grain against time (Fig 4)."""
    figure = style.OwnFigure(figsize=(style.WIDTH, 5.4 if dim == 3 else 4.6), layout="constrained")
    if not len(run.turns):
        figure.text(0.5, 0.5, "M did not grow far enough", ha="center")
        return figure
    size = np.abs(run.turns).max(axis=(0, 1, 3))
    path = _smooth(run.turns)
    gap = np.full((len(path), 1, len(size), 3), np.nan)  # breaks the lines between turns
    joined = np.concatenate([path, gap], axis=1).reshape(-1, len(size), 3)
    most = np.argsort(-size)[:grains]
    above = figure.add_subplot(2, 1, 1, **({"projection": "3d"} if dim == 3 else {"aspect": "equal"}))
    for color, k in zip((style.BLUE, style.GREEN, style.ORANGE, style.RED), most, strict=False):
        above.plot(*joined[:, k, :dim].T, color=color, lw=0.5, label=f"grain {k}")
    names = above.get_legend_handles_labels()
    figure.legend(*names, title="displacements in diameters", loc="outside upper center", ncols=4, columnspacing=1.0)
    funnel = figure.add_subplot(2, 1, 2, projection="3d")
    track = path[:, :, most[0]]
    axes = np.linalg.svd(track.reshape(-1, 3), full_matrices=False)[2][:2]
    turned = np.concatenate([track @ axes.T, np.full((len(track), 1, 2), np.nan)], axis=1)
    step = np.arange(track.shape[1] + 1) * 2 * np.pi / run.frequency / 10 / FINE
    time = (run.turn_time[:, None] + step - run.turn_time[0]) * run.growth_rate
    funnel.plot(*turned.reshape(-1, 2).T, time.ravel(), color=style.BLUE, lw=0.5)
    _label_space(above, [rf"$\Delta {c}$" for c in "xyz"[:dim]], dim)
    _label_space(funnel, ["major axis", "minor axis", r"$\omega_i t$"], 3)
    funnel.set_title(f"grain {most[0]} against time", y=0.95)
    return figure


def _smooth(turns: np.ndarray) -> np.ndarray:
    """Paths with `FINE` times as many points, by cubic splines through the stored ones along axis 1."""
    old = np.arange(turns.shape[1])
    new = np.linspace(0, old[-1], FINE * old[-1] + 1)
    return CubicSpline(old, turns, axis=1)(new) if len(old) > 2 else turns


def _label_space(axes, labels, dim: int) -> None:
    """Label axes; in three dimensions, labels are close to the ticks."""
    style.label_axes(axes, **dict(zip("xyz", labels, strict=False)))
    if dim == 3:
        axes.set_box_aspect((1, 1, 0.8), zoom=0.85)
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_tick_params(pad=1 if axis is axes.zaxis else -3, labelsize=7)
            axis.labelpad = 1 if axis is axes.zaxis else -5
            axis.set_major_locator(MaxNLocator(4))


@style.styled
def stress_through_failure(first: _Failure, later: _Failure | None = None):
    """Shear stress over initial pressure, and number of contacts, during one or two runs (Fig 5)."""
    rows = 2 if later is None else 3
    figure, (top, middle, *bottom) = style.column_axes(rows, 0.4 + 1.6 * rows)
    _plot_stress_and_contacts(top, first)
    early = first.msd < 1e-11
    early &= first.time * first.growth_rate > (first.time[early] * first.growth_rate).max() - 3
    change = first.shear_stress - first.shear_stress[0]
    style.plot_fast(middle, first.time[early], change[early], color=style.BLUE, middle=False)
    style.label_axes(middle, x=style.TIME, y=(r"$-\Delta\sigma_{xy}$", "stress"))
    middle.set_title("the same in its linear stage", fontsize=7)
    if later is not None:
        _plot_stress_and_contacts(bottom[0], later)
    return figure


def _plot_stress_and_contacts(axes, run) -> None:
    style.plot_fast(axes, run.time, run.shear_stress / run.pressure[0], color=style.BLUE)
    style.label_axes(axes, x=style.TIME, y=r"$-\sigma_{xy}/p(0)$")
    axes.yaxis.label.set_color(style.BLUE)
    other = axes.twinx()
    axes.set_zorder(other.get_zorder() + 1)  # stress in front
    axes.patch.set_visible(False)
    style.plot_fast(other, run.time, run.touching, color=style.ORANGE)
    style.label_axes(other, y="contacts", whole="y")
    other.yaxis.label.set_color(style.ORANGE)
    axes.set_title(rf"$\gamma$ = {run.strain:.2g}, {pluralize(run.pairs, 'pair')} at the start", fontsize=7)


@style.styled
def births_by_law(laws: list, packings: list):
    """Fraction of packings that have had a pair, against strain, with one line per law.

    Parameters
    ----------
    laws : summaries by law, with `kind`, `coulomb` and `mu`
    packings : dictionaries with the same keys and `strain`, NaN without a pair
    """
    figure, axes = style.column_axes(2, 4.2, sharex=True)
    for panel, kind in zip(axes, ("hertz_mindlin", "linear"), strict=True):
        for k, law in enumerate(candidate for candidate in laws if candidate.kind == kind):
            strain = np.sort(
                [p["strain"] for p in packings if all(p[n] == getattr(law, n) for n in ("kind", "coulomb", "mu"))]
            )
            label = f"{law.coulomb}, $\\mu$ = {law.mu:g}" if law.mu < 1e6 else "no limit"
            born = strain[np.isfinite(strain)]
            share = np.arange(1, len(born) + 1) / len(strain)
            panel.step(np.append(born, 0.02), np.append(share, share[-1:] if len(born) else 0.0), where="post",
                       color=style.COLORS[k], label=label)  # fmt: skip
        panel.set_xscale("log")
        panel.set_ylim(0, 1.02)
        panel.set_title("Hertz" if kind == "hertz_mindlin" else "linear")
        style.label_axes(panel, y="share of packings with a pair")
        panel.legend()
    style.label_axes(axes[-1], x=r"strain $\gamma$")
    return figure
