"""Figures of cyclic shear; tables are dictionaries of columns with one entry per amplitude."""

from typing import Annotated, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.ticker import PercentFormatter

from ....kit import (
    BLACK,
    BLUE,
    COLORS,
    FILLED,
    GREEN,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    WIDTH,
    Result,
    column_axes,
    label_axes,
    styled,
    subplots,
)
from .simulate import CYCLE, PARTS

_Table = Annotated[Any, Result("table of the last cycles", keys=("amplitude", "G_ratio", "damping"))]
SHADES = dict(zip(PARTS, (BLUE, GREEN, ORANGE, RED, PURPLE, SKY, "0.6", BLACK), strict=True))
WORDS = {"nonpotential": "changed springs", "normal": r"less work of $\sigma_{yy}$"}
MARKERS = {"elastic": "o", "reversible": "s", "periodic": "D", "irreversible": "x", "undecided": "+"}
GREY = "0.85"


@styled
def loops(curves: Annotated[dict[float, tuple[np.ndarray, np.ndarray]], FILLED]):
    """Loops at up to six amplitudes, relative to the mean stress of the last cycle, which is drawn dark.

    Parameters
    ----------
    curves : γ/γ₀ and τ/(Gmax γ₀) for each amplitude, two arrays (cycles, steps + 1)
    """
    chosen = sorted(curves)[-6:]
    rows = -(-len(chosen) // 2)
    size = (WIDTH, 0.5 + 1.35 * rows)
    figure, panels = subplots(rows, 2, figsize=size, sharex=True, sharey=True, squeeze=False)
    for axes, amplitude in zip(panels.flat, chosen, strict=False):
        gamma, tau = curves[amplitude]
        tau = tau - 0.5 * (tau[-1].max() + tau[-1].min())
        for x, y in zip(gamma[:-1], tau[:-1], strict=True):
            axes.plot(x, y, color=SKY, lw=0.6)
        axes.plot(gamma[-1], tau[-1], color=BLUE)
        axes.text(0.05, 0.95, rf"$\gamma_0$ = {amplitude:g}", transform=axes.transAxes, va="top", size=7)
    for axes in panels.flat[len(chosen) :]:
        axes.set_axis_off()
    for axes in panels[-1]:
        label_axes(axes, x=r"$\gamma/\gamma_0$")
        axes.set_xticks([-1, 0, 1])
    for axes in panels[:, 0]:
        label_axes(axes, y=r"$\tau/(G_\mathrm{max}\gamma_0)$")
    return figure


@styled
def modulus_and_damping(tables: Annotated[list[_Table], FILLED], sands: dict | None = None):
    """G/Gmax and damping ratio against the amplitude, one line per sample.

    Parameters
    ----------
    sands : range for sands: amplitudes, and the smallest and largest `G_ratio` and `damping` at each
    """
    figure, panels = column_axes(2, 4.0, sharex=True)
    for axes, name in zip(panels, ("G_ratio", "damping"), strict=True):
        if sands:
            axes.fill_between(sands["amplitude"], *sands[name], color=GREY, lw=0, label="sands (Darendeli, Menq)")
        for k, table in enumerate(tables):
            color = COLORS[k % len(COLORS)]
            label = "grains" if k == 0 else None
            axes.plot(table["amplitude"], table[name], "o-", color=color, label=label)
        axes.set_xscale("log")
        label_axes(axes, y=CYCLE[name].axis, least={"y": 0.01})  # the axis spans at least one per cent
    label_axes(panels[1], x=CYCLE["amplitude"].axis)
    panels[1].yaxis.set_major_formatter(PercentFormatter(1))
    panels[0].set_ylim(0, 1.05 * panels[0].dataLim.y1)
    panels[0].legend(loc="lower left")
    return figure


@styled
def complex_modulus(tables: list[_Table], scales: list[float]):
    """G′ and G″ over Gmax against the amplitude; `scales` are the values of Gmax of the samples."""
    figure, axes = column_axes()
    for k, (table, scale) in enumerate(zip(tables, scales, strict=True)):
        for name, color, marker in (("storage", BLUE, "o"), ("loss", RED, "s")):
            values, label = np.where(table[name] > 0, table[name], np.nan) / scale, CYCLE[name].label
            axes.plot(table["amplitude"], values, f"{marker}-", color=color, label=label if k == 0 else None)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(1e-4, 2)
    label_axes(axes, x=CYCLE["amplitude"].axis, y=r"modulus$/G_\mathrm{max}$")
    axes.legend()
    return figure


@styled
def work(table: _Table):
    """Contributions to the area of the last loop at each amplitude: stacked bars, negative ones below zero."""
    figure, axes = column_axes(1, 2.8)
    clear = np.isfinite(table["sliding"])
    place = np.arange(clear.sum())
    above, below = np.zeros(len(place)), np.zeros(len(place))
    for name, color in SHADES.items():
        share = table[name][clear]
        if not np.abs(share).max(initial=0.0) > 1e-4:
            continue
        axes.bar(place, share, 0.7, bottom=np.where(share > 0, above, below), color=color, label=WORDS.get(name, name))
        above, below = above + np.maximum(share, 0), below + np.minimum(share, 0)
    axes.axhline(0, color=BLACK, lw=0.5)
    label_axes(axes, x=CYCLE["amplitude"].axis, y="fraction of the area of the loop")
    axes.set_xticks(place, [f"{amplitude:g}" for amplitude in table["amplitude"][clear]])
    axes.set_xlim(-0.6, max(len(place), 1) - 0.4)
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    if len(place):
        figure.legend(loc="outside upper center", ncols=3)
    return figure


@styled
def returns(displacements: dict, kinds: dict[float, str]):
    """Net displacement of grains in each cycle, over γ₀ times the diameter, one line per amplitude."""
    figure, axes = column_axes(1, 2.8)
    for k, (amplitude, values) in enumerate(displacements.items()):
        kind, number = kinds[amplitude], np.arange(1, len(values) + 1)
        color = colormaps["viridis"](0.9 * k / max(len(displacements) - 1, 1))
        axes.plot(number, values, f"{MARKERS[kind]}-", color=color, label=f"{amplitude:g} {kind}")
    axes.axhline(1e-2, color=BLACK, lw=0.6, ls="--")
    axes.set_yscale("log")
    label_axes(axes, x="cycle", y=r"net displacement$/(\gamma_0 D)$", whole="x")
    figure.legend(loc="outside upper center", ncols=2)
    return figure
