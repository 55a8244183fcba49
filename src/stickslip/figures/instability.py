"""Figures of what follows an instability: growth at finite amplitude, and the thresholds of sliding."""

import numpy as np
from scipy.special import expit

from .style import BLACK, BLUE, COLORS, GREEN, ORANGE, RED, column_axes, styled


@styled
def growth_by_amplitude(form):
    """Growth rate of a pair against the displacement of the grain that moves most, with burst and first limit."""
    figure, axes = column_axes(1, 2.4)
    move = np.array([form.displacement(a) for a in form.amplitudes])
    seen = np.isfinite(form.rates)
    x = np.linspace(0, move[-1] if len(move) else form.displacement(form.first), 200)
    square = form.growth_rate**2 + 0.5 * form.beta * (x / form.displacement(1.0)) ** 2
    below = square > 0
    axes.plot(x[below], np.sqrt(square[below]), "--", color=ORANGE, label="third order")
    axes.plot(move[seen], form.rates[seen], ".-", color=BLUE, label="harmonic balance")
    axes.axhline(form.growth_rate, color=BLACK, lw=0.6, ls=":", label="linear")
    inside = x[-1] * 1.02 if len(x) else np.inf
    if form.displacement(form.peak) <= inside:
        axes.axvline(form.displacement(form.peak), color=GREEN, label="burst turns back")
    if form.displacement(form.first) <= inside:
        axes.axvline(form.displacement(form.first), color=RED, label="a contact is lost")
    axes.set_ylim(bottom=0)
    axes.set_xlim(0, x[-1] * 1.03)
    axes.set_xlabel("largest displacement [length]")
    axes.set_ylabel("growth rate [1/time]")
    axes.legend(loc="best")
    return figure


@styled
def static_and_kinetic(found, *, label: str = "load", strength: float = np.nan):
    """Share of kicked runs that slide against the load, and their lifetimes, beside the static thresholds.

    Shaded bands are 95 % intervals of the fitted thresholds; `strength` is the load at which the sample slides by
    itself.
    """
    figure, (axes, below) = column_axes(2, 4.0, sharex=True, height_ratios=(3, 2))
    loads = found.loads
    top = loads[-1] if np.isnan(strength) else max(strength, loads[-1])
    x = np.linspace(loads[0], top, 400)
    for k, kick in enumerate(found.kicks):
        color = COLORS[k % len(COLORS)]
        axes.plot(loads, found.probability[:, k], "o", color=color, ms=3.5, label=f"velocities of {kick:.3g}")
        below.plot(loads, found.lifetime[:, k], "o-", color=color, ms=3.5, lw=0.6)
        if np.isfinite(found.threshold[k]):
            axes.plot(x, expit((x - found.threshold[k]) / found.width[k]), color=color)
            axes.axvspan(*np.clip(found.interval[k], loads[0], top), color=color, alpha=0.12, lw=0)
    if found.arrest:
        axes.axvspan(*found.arrest, color=BLACK, alpha=0.25, lw=0, label="a sliding sample stops")
    static = (
        (found.first_pair, "first pair", ":"), (found.first_limit, "first limit", "--"),
        (strength, "slides by itself", "-"),
    )  # fmt: skip
    for load, words, style in static:
        if x[0] <= load <= top:
            axes.axvline(load, color=BLACK, ls=style, lw=0.8, label=words)
            below.axvline(load, color=BLACK, ls=style, lw=0.8)
    axes.set_ylim(-0.03, 1.03)
    axes.set_ylabel("share of runs that slide")
    below.set_ylabel("median lifetime [time]")
    below.set_ylim(0, 1.1 * found.duration)
    below.axhline(found.duration, color=BLACK, lw=0.5, ls=":")
    below.set_xlabel(label)
    figure.legend(loc="outside upper center", ncols=2)
    return figure
