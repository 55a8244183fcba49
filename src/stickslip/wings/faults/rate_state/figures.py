"""Figures of rate-and-state friction: history of a slider, fits to a record, their posterior, and cycles of a sweep."""

from typing import Annotated, Any

import numpy as np
from scipy.ndimage import gaussian_filter

from ....kit import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PAGE,
    SKY,
    WIDTH,
    YEAR,
    Array,
    Result,
    Series,
    column_axes,
    label_axes,
    legend_above,
    require_shape,
    styled,
    subplots,
)

LAW_COLORS = {"aging": BLUE, "slip": ORANGE}
GREY = "0.6"
SYMBOLS = {
    "a": "$a$", "b": "$b$", "dc": "$D_c$", "mu0": r"$\mu_0$", "b2": "$b_2$", "dc2": "$D_{c2}$", "v1": "$V_1$",
    "v2": "$V_2$", "stiffness": "$k$", "damping": r"$\eta$", "alpha": r"$\alpha$", "theta": r"$\theta_0$",
}  # fmt: skip
NARROW = 1e-4  # relative range of draws below which an axis shows differences from the median
BINS, SMOOTH, SHARES = 28, 1.0, (0.95, 0.68)  # two-dimensional histograms: cells per axis, filter width, contours
UNITS = ((YEAR, "years"), (86400.0, "days"), (3600.0, "h"), (1.0, "s"))
PERCENTS = (2.5, 16.0, 50.0, 84.0, 97.5)  # percentiles of the members of a sweep
BOTTOM = 1e-12  # smallest velocity drawn, over the largest

_History = Annotated[Any, Result("SlipHistory", ("time", "load_point", "friction", "velocity", "theta"))]
_Leg = Annotated[Any, Result("LoadStep", ("duration", "velocity"))]
_Data = Annotated[Any, Result("Data", ("time", "friction", "legs"))]
_Fit = Annotated[Any, Result("Fit", ("law", "models", "residuals"))]


@styled
def slid(history: _History, recorded: Series, legs: list[_Leg] | tuple[_Leg, ...]):
    """Friction, velocity and state against load-point displacement, or against time if the load point ever stops."""
    figure, panels = column_axes(3, 4.6, sharex=True)
    x, label, ends = _abscissa(history.time, history.load_point, legs)
    noisy = not np.array_equal(recorded, history.friction)
    if noisy:
        panels[0].plot(x, recorded, ".", color=GREY, ms=1.5, label="recorded")
    panels[0].plot(x, history.friction, color=BLUE, label="friction")
    label_axes(panels[0], y="friction")
    panels[1].semilogy(x, np.maximum(history.velocity, BOTTOM * history.velocity.max()), color=BLUE, label="slider")
    for k, leg in enumerate(legs):
        if leg.velocity > 0:
            panels[1].plot(
                ends[k : k + 2],
                [leg.velocity] * 2,
                color=BLACK,
                ls="--",
                lw=0.7,
                label="load point" if k == 0 else None,
            )
    label_axes(panels[1], y=("velocity", "m/s"))
    panels[2].semilogy(x, history.theta, color=GREEN)
    label_axes(panels[2], x=label, y=(r"state $\theta$", "s"))
    for axes in panels[: 2 if noisy else 1]:
        axes.legend(loc="best")
    panels[1].legend(loc="best")
    if x[-1] > x[0]:
        panels[2].set_xlim(x[0], x[-1])
    figure.align_ylabels(panels)
    return figure


@styled
def fitted(data: _Data, fits: list[_Fit] | tuple[_Fit, ...]):
    """Record with fits and their residuals."""
    figure, (top, bottom) = column_axes(2, 3.6, sharex=True, height_ratios=(2, 1))
    time = np.asarray(data.time)
    if data.legs:
        ends = np.cumsum([leg.duration for leg in data.legs])
        run = np.cumsum([leg.duration * leg.velocity for leg in data.legs])
        displacement = np.interp(time, np.r_[0.0, ends], np.r_[0.0, run])
    else:
        displacement = np.r_[0.0, np.cumsum(0.5 * (data.velocity[1:] + data.velocity[:-1]) * np.diff(time))]
    x, label, _ = _abscissa(time, displacement, data.legs)
    top.plot(x, data.friction, ".", color=GREY, ms=1.5, label="record")
    for k, fit in enumerate(fits):
        color, style = LAW_COLORS[fit.law], ("-", "--")[k % 2]
        top.plot(x, fit.models[0], color=color, ls=style, label=f"{fit.law} law")
        bottom.plot(x, fit.residuals[0], color=color, lw=0.6, alpha=0.8)
    bottom.axhline(0, color=BLACK, lw=0.5)
    label_axes(top, y="friction")
    top.legend(loc="best")
    label_axes(bottom, x=label, y="record − fit")
    bottom.set_xlim(x[0], x[-1])
    figure.align_ylabels((top, bottom))
    return figure


@styled
def corner(columns: dict, intervals: dict, units: dict):
    """Histograms of draws for each parameter, with the interval of the fit, and contours for each pair.

    Contours contain 68 and 95 % of the draws. A parameter whose range is too narrow for readable numbers, such as that
    of a fit without noise, is drawn as the difference Δ from its median.

    Parameters
    ----------
    columns : name → draws
    intervals : name → (low, high), shaded
    units : name → unit
    """
    names, many = list(columns), len(columns)
    bases = {name: name.partition("[")[0] for name in names}
    labels = {name: (SYMBOLS.get(base, name), units.get(base, "")) for name, base in bases.items()}
    columns, intervals = dict(columns), dict(intervals)
    for name, draws in columns.items():
        middle = np.median(draws)
        if 0 < np.ptp(draws) < NARROW * abs(middle):
            columns[name], intervals[name] = draws - middle, np.subtract(intervals[name], middle)
            labels[name] = (rf"$\Delta${labels[name][0]}", labels[name][1])
    figure, panels = subplots(many, many, figsize=(np.clip(1.05 * many, WIDTH, PAGE),) * 2, sharex="col", squeeze=False)
    for row, below in enumerate(names):
        for column, across in enumerate(names):
            axes = panels[row, column]
            if column > row:
                axes.set_axis_off()
            elif column == row:
                axes.axvspan(*intervals[across], color=SKY, alpha=0.25, lw=0)
                axes.hist(columns[across], BINS, histtype="step", color=BLUE)
                axes.set_yticks([])
            else:
                _contour_pair(axes, columns[across], columns[below])
                label_axes(axes, y=labels[below])
                axes.tick_params(labelleft=column == 0)
                axes.yaxis.label.set_visible(column == 0)
            if row == many - 1:
                axes.tick_params(axis="x", rotation=45)
                label_axes(axes, x=labels[across])
    figure.align_labels()
    return figure


def _contour_pair(axes, x, y) -> None:
    """Filled contours of the smoothed density of draws."""
    counts, xs, ys = np.histogram2d(x, y, BINS)
    density = gaussian_filter(counts, SMOOTH, mode="constant")
    ordered = np.sort(density.ravel())[::-1]
    whole = np.cumsum(ordered) / ordered.sum()
    levels = [float(ordered[np.searchsorted(whole, share)]) for share in SHARES]
    centres = (0.5 * (edges[1:] + edges[:-1]) for edges in (xs, ys))
    axes.contourf(*centres, density.T, [*levels, float(ordered[0]) * 1.01], colors=[SKY, BLUE], alpha=0.8)


def _abscissa(time, place, legs):
    """Values, quantity and unit of the horizontal axis, and the ends of the legs."""
    ends = np.r_[0.0, np.cumsum([leg.duration for leg in legs])]
    if any(leg.velocity <= 0 for leg in legs):
        return time, ("time", "s"), ends
    run = np.r_[0.0, np.cumsum([leg.duration * leg.velocity for leg in legs])]
    long = abs(run[-1]) or abs(place[-1])
    unit, size = next(
        (u, s) for u, s in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9)) if long >= 3 * s or s == 1e-9
    )
    return place / size, ("displacement", unit), run / size


@styled
def cycles(since: Series, curves: Annotated[Any, Array((2,), empty=False)], recurrence: Series, *, without: int = 0):
    """Slip against time since an event, above a histogram of recurrence times.

    Bands contain 68 and 95 % of the members; the line is their median.

    Parameters
    ----------
    since : (N,) times since an event [s]
    curves : (M, N) slip of M members since the event [m]
    recurrence : (K,) recurrence times [s]
    without : number of members without cycles
    """
    require_shape((np.shape(curves)[0], len(since)), curves=curves)
    size, unit = next((pair for pair in UNITS if np.median(recurrence) > pair[0]), UNITS[-1])
    figure, (top, bottom) = column_axes(2, 3.8, height_ratios=(3, 2))
    low, first, middle, third, high = np.percentile(curves, PERCENTS, axis=0)
    top.fill_between(since / size, low, high, color=SKY, alpha=0.35, lw=0, label="95 % of the members")
    top.fill_between(since / size, first, third, color=BLUE, alpha=0.35, lw=0, label="68 %")
    top.plot(since / size, middle, color=BLUE, label="median")
    label_axes(top, x=("time since an event", unit), y=("slip", "m"))
    top.set_xlim(since[0] / size, since[-1] / size)
    legend_above(top, ncol=3)
    low, first, middle, third, high = np.percentile(recurrence, PERCENTS) / size
    bottom.axvspan(low, high, color=SKY, alpha=0.35, lw=0)
    bottom.axvspan(first, third, color=BLUE, alpha=0.35, lw=0)
    bottom.hist(recurrence / size, min(30, max(8, len(recurrence) // 8)), histtype="step", color=BLACK)
    bottom.axvline(middle, color=BLUE)
    missing = f"; {without} members without cycles" if without else ""
    bottom.set_title(f"recurrence {middle:.3g} {unit}, 95 %: {low:.3g} to {high:.3g}{missing}", fontsize=7)
    label_axes(bottom, x=("recurrence time", unit), y="members", whole="y")
    figure.align_ylabels((top, bottom))
    return figure
