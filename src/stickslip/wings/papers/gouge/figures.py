"""Figures of fault gouge: steady sliding, velocity steps, holds, slides after holds, healing, and the sample itself."""

from typing import Annotated, Any

import numpy as np

from ....kit import FILLED, Result, Series, draw_grains_by_speed, style
from ....measure import wrapped

HELD = ("time held", "s")  # quantity and unit
FRICTION = r"friction $\tau/\sigma$"
LONGER = 3.0  # ratio of the lengths of curves above which their axis is logarithmic
MOST_NAMED = 8  # largest number of realisations named in a legend

_Realization = Annotated[Any, Result("realisation of a GougeResult", ("states",))]
_WithTests = Annotated[Any, Result("realisation of a GougeResult", ("tests",))]
_Curve = Annotated[Any, Result("Curve", ("x", "mean", "error", "band", "label"))]
_Number = Annotated[Any, Result("Number", ("value", "half"))]
_Panel = tuple[list[_Curve], dict[str, Any]]


@style.styled
def steady_sliding(realizations: list[_WithTests] | tuple[_WithTests, ...], diameter: float):
    """Friction and thickness against slip for all realisations, from rest to steady sliding.

    Parameters
    ----------
    realizations : realisations of a `GougeResult`
    diameter : D, the unit of slip and thickness [m]
    """
    figure, (above, below) = style.column_axes(2, 3.4, sharex=True)
    for number, realization in enumerate(realizations):
        series, color = realization.tests[0].series, style.COLORS[number % len(style.COLORS)]
        style.plot_fast(above, series.slip / diameter, series.friction, color=color, label=f"realisation {number + 1}")
        style.plot_fast(below, series.slip / diameter, series.thickness / diameter, color=color)
    style.label_axes(above, y=FRICTION)
    style.label_axes(below, x="slip of the upper plate / $D$", y="thickness / $D$")
    if len(realizations) <= MOST_NAMED:
        style.legend_above(above)
    return figure


@style.styled
def velocity_steps(curves: Annotated[list[_Curve], FILLED], *, twins: bool = True):
    """Change in friction after each step, ± two standard errors.

    Parameters
    ----------
    curves : one `Curve` per step
    twins : whether the change is relative to copies without a step, or to steady friction before the step
    """
    figure, axes = style.column_axes(1, 2.4)
    for number, curve in enumerate(curves):
        _plot_band(axes, curve, style.COLORS[2 * number % len(style.COLORS)], errors=True)
    axes.axhline(0, color=style.BLACK, lw=0.5)
    ends = [curve.x[-1] for curve in curves]
    if max(ends) > LONGER * min(ends):
        axes.set_xscale("log")
        axes.set_xlim(min(curve.x[curve.x > 0][0] for curve in curves), max(ends))
    style.label_axes(
        axes, x="slip of the load point / $D$",
        y=r"$\Delta\mu$, step minus no step" if twins else r"$\mu - \mu_{ss}$ after the step",
    )  # fmt: skip
    _name_band(axes, "mean ± two standard errors")
    style.legend_above(axes)
    return figure


@style.styled
def holds(panels: Annotated[list[_Panel], FILLED]):
    """Change in friction during holds against time, mean and 2σ over branches, with predictions of both laws.

    Parameters
    ----------
    panels : pairs of curves (each a `Curve`) and predictions, {law: (times, change in friction)}
    """
    figure, rows = style.column_axes(len(panels), 0.6 + 2.6 * len(panels), sharex=False, squeeze=False)
    for axes, (curves, laws) in zip(rows[:, 0], panels, strict=True):
        for number, curve in enumerate(curves):
            _plot_band(axes, curve, (style.BLUE, style.ORANGE, style.RED)[number % 3])
        for (law, (time, change)), color in zip(laws.items(), (style.PURPLE, style.GREEN), strict=False):
            axes.plot(time, change, color=color, label=f"{law} law", ls="--")
        axes.set_xscale("log")
        style.label_axes(axes, x=HELD if axes is rows[-1, 0] else None, y=r"$\mu - \mu(0)$")
        _name_band(axes, "two standard deviations")
        style.legend_above(axes, ncol=1)
    return figure


@style.styled
def energies_in_holds(ratios: list[_Curve], creep: list[_Curve], sliding: float | None = None):
    """Kinetic over elastic energy, and velocity of the plate, against the hold time.

    Parameters
    ----------
    ratios, creep : one `Curve` per damping
    sliding : kinetic over elastic energy in steady sliding before the holds, or None
    """
    figure, (above, below) = style.column_axes(2, 4.4, sharex=True)
    for number, (ratio, velocity) in enumerate(zip(ratios, creep, strict=True)):
        color = (style.BLUE, style.ORANGE, style.RED)[number % 3]
        above.plot(ratio.x, ratio.mean, color=color)
        below.plot(velocity.x, np.where(velocity.mean > 0, velocity.mean, np.nan), color=color, label=ratio.label)
    if sliding is not None:
        above.axhline(sliding, color=style.BLACK, lw=0.7, ls=":")
        above.text(1, sliding, "steady sliding ", ha="right", va="top", transform=above.get_yaxis_transform())
    for axes in (above, below):
        axes.set(xscale="log", yscale="log")
    style.label_axes(above, y="kinetic / elastic energy")
    style.label_axes(below, x=HELD, y=("creep of the plate", "m/s"))
    figure.legend(*below.get_legend_handles_labels(), loc="outside upper center", ncols=1)
    return figure


@style.styled
def reslides(curves: list[_Curve], ratios: Series, peaks: list[_Number], slope: _Number | None, offset: float):
    """Friction after holds for each velocity, with two standard errors; the same over C + ln(V_r/V_i); and the peaks.

    Parameters
    ----------
    curves : one `Curve` per velocity ratio
    ratios : V_r/V_i
    peaks : one `Number` per ratio
    slope : `Number`, slope of peaks against the logarithm of the ratio
    offset : C, the constant for which the curves collapse
    """
    rows = 3 if len(ratios) > 1 else 2
    figure, panels = style.column_axes(rows, 1.7 * rows + 0.4)
    above, below = panels[:2]
    for number, (curve, ratio) in enumerate(zip(curves, ratios, strict=True)):
        color = style.COLORS[2 * number % len(style.COLORS)]
        above.plot(curve.x, curve.mean, color=color, label=f"$V_r/V_i$ = {ratio:.3g}")
        width = 2 * np.nan_to_num(curve.error)
        above.fill_between(curve.x, curve.mean - width, curve.mean + width, color=color, alpha=0.15, lw=0)
        if offset + np.log(ratio) > 0.1 * offset:  # otherwise the collapse is meaningless
            below.plot(curve.x, curve.mean / (offset + np.log(ratio)), color=color)
    style.label_axes(above, y=r"$\mu - \mu_{ss}$")
    _name_band(above, "mean ± two standard errors")
    style.legend_above(above)
    style.label_axes(below, x="slip of the load point / $D$", y=rf"$(\mu - \mu_{{ss}})/({offset:.2g} + \ln V_r/V_i)$")
    if rows == 3:
        x, y = np.log(ratios), [p.value for p in peaks]
        panels[2].errorbar(x, y, yerr=np.nan_to_num([p.half for p in peaks]), fmt="o", color=style.BLACK, lw=0.7)
        label = f"slope {slope.value:.3f}" + (f" ± {slope.half:.3f}" if np.isfinite(slope.half) else "")
        panels[2].plot(x, np.mean(y) + slope.value * (x - x.mean()), color=style.RED, lw=0.8, label=label)
        style.label_axes(panels[2], x=r"$\ln V_r/V_i$", y=r"peak of $\mu - \mu_{ss}$")
        style.legend_above(panels[2])
    return figure


@style.styled
def healing(times: Series, peaks: list[_Number], slope: _Number, b: float, thickness: _Curve):
    """Peak friction after holds against hold time, with the slopes b and b/2, and thickness during holds.

    Parameters
    ----------
    times : hold times [s]
    peaks : one `Number` per hold
    slope : `Number`, peak per e-fold of hold time
    b : parameter of rate-and-state friction
    thickness : `Curve` of the change in thickness over D during holds
    """
    figure, (above, below) = style.column_axes(2, 3.8, sharex=True)
    x, y = np.asarray(times), np.array([p.value for p in peaks])
    above.errorbar(x, y, yerr=np.nan_to_num([p.half for p in peaks]), fmt="o", color=style.BLUE, label="peak")
    middle = np.exp(np.log(x).mean())
    for rate, label, color, dash in (
        (slope.value, "fit", style.BLUE, "-"), (b, "$b$", style.ORANGE, "--"), (b / 2, "$b/2$", style.ORANGE, ":")
    ):  # fmt: skip
        above.plot(x, y.mean() + rate * np.log(x / middle), color=color, ls=dash, label=label)
    _plot_band(below, thickness, style.GREEN)
    _name_band(below, "thickness, two standard deviations", style.GREEN)
    for axes in (above, below):
        axes.set_xscale("log")
    style.label_axes(above, y=r"$\mu_{peak} - \mu_{ss}$")
    style.label_axes(below, x=HELD, y=r"$\Delta H/D$")
    style.legend_above(above, ncol=4)
    below.legend(loc="lower left")
    return figure


@style.styled
def sample(realization: _Realization, scenario: Annotated[Any, Result("GougeScenario", ("cell",))]):
    """Sample in steady sliding, viewed along z: mobile grains coloured by speed, plates grey."""
    state = realization.states["steady"]
    loose = np.flatnonzero(state.control.group[: len(state.grains.radius)] < 0)
    position, radius = wrapped(state), float(state.grains.radius.max())
    low, high = 1e3 * (position[:, 1].min() - 1.2 * radius), 1e3 * (position[:, 1].max() + 1.2 * radius)
    length = 1e3 * scenario.cell.length
    figure, axes = style.subplots(figsize=(style.WIDTH, 0.8 * style.WIDTH * (high - low) / length + 0.7))
    speed = np.linalg.norm(state.grains.velocity[loose], axis=1)
    shown = state._replace(
        grains=state.grains._replace(radius=1e3 * state.grains.radius),
        cell=state.cell._replace(vectors=1e3 * state.cell.vectors),
    )
    drawn = draw_grains_by_speed(axes, shown, 1e3 * position, loose, float(np.quantile(speed, 0.95)) or 1.0)
    axes.set(xlim=(0, length), ylim=(low, high), aspect="equal")
    style.label_axes(axes, x=("$x$", "mm"), y=("$y$", "mm"))
    axes.set_title("grey: grains of the plates", fontsize=7)
    style.label_axes(
        figure.colorbar(drawn, ax=axes, location="bottom", shrink=0.8, aspect=30, extend="max").ax, x=("speed", "m/s")
    )
    return figure


def _plot_band(axes, curve, color, *, errors: bool = False):
    """Plot the mean with a band of two standard deviations over branches, or of two standard errors."""
    width = 2 * np.nan_to_num(curve.error) if errors else curve.band
    axes.plot(curve.x, curve.mean, color=color, label=curve.label)
    axes.fill_between(curve.x, curve.mean - width, curve.mean + width, color=color, alpha=0.2, lw=0)


def _name_band(axes, label: str, color=style.BLACK) -> None:
    """Add a band to the legend."""
    axes.fill_between([], [], color=color, alpha=0.2, lw=0, label=label)


@style.styled
def stick_slip(
    realization: Annotated[Any, Result("realisation of a GougeResult", ("of", "seed"))],
    slips: Annotated[Any, Result("result of find_slips", ("realization", "load_point", "drop", "velocity"))],
    diameter: float,
):
    """Friction and velocity of the upper plate in slides through a soft spring, with the slips marked.

    Parameters
    ----------
    realization : one realisation of a `GougeResult`
    slips : result of `find_slips`; slips of this realisation are marked
    diameter : D, the unit of displacements [m]
    """
    figure, (above, below) = style.column_axes(2, 3.6, sharex=True)
    below.set_yscale("log")
    for test in realization.of("slide"):
        x = test.series.load_point / diameter
        above.plot(x, test.series.friction, color=style.BLUE, lw=0.6)
        style.plot_fast(below, x, np.abs(test.series.velocity), color=style.BLUE)
        below.plot(x[[0, -1]], [test.velocity] * 2, "--", color=style.BLACK, lw=0.8)
    mine = slips.realization == realization.seed
    x = slips.load_point[mine] / diameter
    series = [test.series for test in realization.of("slide")]
    moved, friction = (np.concatenate([getattr(s, name) for s in series]) for name in ("load_point", "friction"))
    start = np.interp(x, moved / diameter, friction)
    above.vlines(x, start - slips.drop[mine], start, color=style.RED, lw=0.8, label="drop in a slip")
    below.plot(x, slips.velocity[mine], ".", color=style.RED, ms=4, label="largest velocity of a slip")
    below.plot([], [], "--", color=style.BLACK, lw=0.8, label="load point")
    style.label_axes(above, y=FRICTION)
    style.label_axes(below, x="displacement of the load point / $D$", y=("velocity of the plate", "m/s"))
    below.set_ylim(bottom=0.1 * min(test.velocity for test in realization.of("slide") if test.velocity > 0))
    style.legend_above(above)
    style.legend_above(below)
    return figure
