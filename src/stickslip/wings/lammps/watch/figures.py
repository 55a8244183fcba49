"""Charts of a watched simulation against the time step."""

from typing import Annotated, Any

import numpy as np

from ....kit import BLUE, GREEN, ORANGE, RED, SKY, Array, column_axes, label_axes, legend_above, styled

Column = Annotated[Any, Array((1,), finite=False)]  # NaN where a quantity is not known
COLOURS = {"stable": GREEN, "unstable": RED}  # of a verdict; others have none


def _line(axes, step, values, color, label=None, quantity=None):
    known = np.isfinite(values)
    axes.plot(step[known], values[known], "o-", color=color, ms=2, lw=0.8, label=label)
    if quantity:
        label_axes(axes, y=quantity)


@styled
def watched_stress(step: Column, pressure: Column, shear: Column):
    """Pressure, and shear stress over pressure, against the time step."""
    figure, (above, below) = column_axes(2, 2.8, sharex=True)
    _line(above, step, pressure, BLUE, quantity=("pressure", "stress"))
    ratio = np.divide(shear, pressure, out=np.full(len(step), np.nan), where=np.abs(pressure) > 0)
    _line(below, step, ratio, ORANGE, quantity="shear / pressure")
    label_axes(below, x="time step")
    return figure


@styled
def watched_contacts(step: Column, coordination: Column, sliding: Column):
    """Coordination and the fraction of sliding contacts against the time step."""
    figure, (above, below) = column_axes(2, 2.8, sharex=True)
    _line(above, step, coordination, BLUE, quantity="contacts per grain")
    _line(below, step, sliding, ORANGE, quantity="sliding fraction")
    below.set_ylim(0, 1.1 * max(np.nanmax(sliding, initial=0.0), 0.01))
    if not np.isfinite(sliding).any():
        below.text(0.5, 0.5, "unknown without memory", ha="center", va="center", transform=below.transAxes)
        below.set_yticks([])
    label_axes(below, x="time step")
    return figure


@styled
def watched_spectrum(step: Column, softest: Column, growth: Column, verdicts: list[str]):
    """Softest eigenvalue, and growth rate of the fastest pair, against the time step; filled where there is a verdict.

    Parameters
    ----------
    growth : growth rates, zero if no pair grows, NaN without a spectrum
    verdicts : for each frame, stable, unstable, or another word
    """
    figure, (above, below) = column_axes(2, 2.8, sharex=True)
    _line(above, step, softest, BLUE, quantity=(r"softest $\lambda$", "1/time$^2$"))
    if (softest < 0).any():
        above.axhline(0, color="0.6", lw=0.6)
    known = np.isfinite(growth)
    below.plot(step[known], growth[known], "-", color="0.7", lw=0.8, zorder=1)
    for word, color in COLOURS.items():
        chosen = known & np.array([verdict == word for verdict in verdicts], bool)
        if chosen.any():
            below.plot(step[chosen], growth[chosen], "o", color=color, ms=2.5, label=word)
    rest = known & np.array([verdict not in COLOURS for verdict in verdicts], bool)
    if rest.any():
        below.plot(step[rest], growth[rest], "o", mfc="white", mec=SKY, ms=2.5, mew=0.7, label="no verdict")
    if known.any():
        legend_above(below, ncol=3)
    label_axes(below, y=("growth rate", "1/time"))
    below.set_ylim(bottom=0)
    label_axes(below, x="time step")
    return figure


@styled
def watched_balance(step: Column, residual: Column, limit: float):
    """Largest unbalanced force over the mean contact force against the time step, with the limit for a verdict."""
    figure, axes = column_axes(1, 1.7)
    good = np.where(residual > 0, residual, np.nan)
    _line(axes, step, good, BLUE)
    axes.axhline(limit, color=RED, lw=0.7, ls="--", label="limit for a verdict")
    axes.set_yscale("log")
    label_axes(axes, x="time step", y="unbalanced force / mean")
    legend_above(axes)
    return figure
