"""Figures of rate-and-state friction: the history of a slider, and fits to a record."""

import numpy as np

from .style import BLACK, BLUE, GREEN, ORANGE, column_axes, styled

LAW_COLORS = {"aging": BLUE, "slip": ORANGE}
GREY = "0.6"
BOTTOM = 1e-12  # smallest velocity that is drawn, over the largest


@styled
def slid(history, recorded, legs):
    """Friction, velocity and state against load-point displacement, or against time if the load point ever stops."""
    figure, panels = column_axes(3, 4.6, sharex=True)
    x, label, ends = _abscissa(history.time, history.load_point, legs)
    noisy = not np.array_equal(recorded, history.friction)
    if noisy:
        panels[0].plot(x, recorded, ".", color=GREY, ms=1.5, label="recorded")
    panels[0].plot(x, history.friction, color=BLUE, label="friction")
    panels[0].set_ylabel("friction")
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
    panels[1].set_ylabel("velocity [m/s]")
    panels[2].semilogy(x, history.theta, color=GREEN)
    panels[2].set_ylabel(r"state $\theta$ [s]")
    panels[2].set_xlabel(label)
    for axes in panels[: 2 if noisy else 1]:
        axes.legend(loc="best")
    panels[1].legend(loc="best")
    if x[-1] > x[0]:
        panels[2].set_xlim(x[0], x[-1])
    figure.align_ylabels(panels)
    return figure


@styled
def fitted(data, fits):
    """Record with fits and their residuals."""
    figure, (top, bottom) = column_axes(2, 3.6, sharex=True, height_ratios=(2, 1))
    time = np.asarray(data.time)
    if data.legs:
        ends = np.cumsum([leg.duration for leg in data.legs])
        run = np.cumsum([leg.duration * leg.velocity for leg in data.legs])
        place = np.interp(time, np.r_[0.0, ends], np.r_[0.0, run])
    else:
        place = np.r_[0.0, np.cumsum(0.5 * (data.velocity[1:] + data.velocity[:-1]) * np.diff(time))]
    x, label, _ = _abscissa(time, place, data.legs)
    top.plot(x, data.friction, ".", color=GREY, ms=1.5, label="record")
    for k, one in enumerate(fits):
        color, style = LAW_COLORS[one.law], ("-", "--")[k % 2]
        top.plot(x, one.models[0], color=color, ls=style, label=f"{one.law} law")
        bottom.plot(x, one.residuals[0], color=color, lw=0.6, alpha=0.8)
    bottom.axhline(0, color=BLACK, lw=0.5)
    top.set_ylabel("friction")
    top.legend(loc="best")
    bottom.set_ylabel("record − fit")
    bottom.set_xlabel(label)
    bottom.set_xlim(x[0], x[-1])
    figure.align_ylabels((top, bottom))
    return figure


def _abscissa(time, place, legs):
    """Values and label of the horizontal axis, and the ends of the legs."""
    ends = np.r_[0.0, np.cumsum([leg.duration for leg in legs])]
    if any(leg.velocity <= 0 for leg in legs):
        return time, "time [s]", ends
    run = np.r_[0.0, np.cumsum([leg.duration * leg.velocity for leg in legs])]
    long = abs(run[-1]) or abs(place[-1])
    unit, size = next(
        (u, s) for u, s in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9)) if long >= 3 * s or s == 1e-9
    )
    return place / size, f"displacement [{unit}]", run / size
