"""Figure of a sweep: stick–slip cycles of many members with bands of probability."""

import numpy as np

from .style import BLACK, BLUE, SKY, column_axes, label_axes, legend_above, styled

YEAR = 365.25 * 86400.0
UNITS = ((YEAR, "years"), (86400.0, "days"), (3600.0, "h"), (1.0, "s"))
PERCENTS = (2.5, 16.0, 50.0, 84.0, 97.5)


@styled
def cycles(since, curves, recurrence, *, without: int = 0):
    """Slip against the time since an event, above a histogram of recurrence times.

    Bands contain 68 and 95 % of the members, and the line is their median.

    Parameters
    ----------
    since : (N,) times since an event [s]
    curves : (M, N) slip of M members since the event [m]
    recurrence : (K,) recurrence times [s]
    without : number of members without cycles
    """
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
