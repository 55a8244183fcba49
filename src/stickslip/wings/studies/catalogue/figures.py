"""Figures of an event catalogue; tables are dictionaries of columns, as in events.csv."""

from typing import Annotated, Any

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from ....kit import (
    BLACK,
    BLUE,
    COLORS,
    GREEN,
    ORANGE,
    PAGE,
    PURPLE,
    RED,
    SKY,
    WIDTH,
    Result,
    column_axes,
    label_axes,
    legend_above,
    styled,
    subplots,
)

# class of an event: its label and colour
CLASSES = {
    "saddle_node": (r"real $\lambda \to 0$", BLUE),
    "pair": ("complex pair", SKY),
    "sliding": ("contact starts to slide", RED),
    "opening": ("contact opens", ORANGE),
    "unstable": ("already unstable", PURPLE),
    "unresolved": ("unresolved", "#BBBBBB"),
}
PREDICTORS = {
    "softest": (r"smallest $\lambda$", BLUE),
    "nonaffine_rate": (r"$|dq/d\gamma|$", GREEN),
    "growth": ("growth rate", SKY),
    "tangent_modulus": ("modulus", ORANGE),
    "switch": ("switch test", PURPLE),
    "loss_ahead": ("loss ahead", RED),
}
LINES = 60  # largest number of events drawn individually
_Table = Annotated[Any, Result("table of events", keys=("kind", "distances", "softest", "switched"))]
_Drops = Annotated[Any, Result("table of events", keys=("stress_drop", "jump"))]
_Skill = Annotated[Any, Result("skill of a predictor", ("predictor", "band", "roc", "low", "high"))]
BEFORE = r"strain before the event $\gamma_c - \gamma$"


@styled
def eigenvalue_before_events(events: _Table):
    """Square of the smallest eigenvalue λ before saddle nodes, and λ before a contact starts to slide.

    Distances are strains before the event. Eigenvalues are divided by those at the largest distance. At a saddle node,
    λ² decreases in proportion to the distance. Before a contact starts to slide, λ stays constant; if this contact is
    set to slide, λ is negative (points at the right).
    """
    figure, (top, bottom) = column_axes(2, 4.4)
    distance, ratio, _ = _ratios(events, "saddle_node")
    for x, y in zip(distance[:LINES], ratio[:LINES], strict=True):
        above = y > 0
        top.loglog(x[above], y[above] ** 2, color=BLUE, lw=0.5, alpha=0.35)
    if len(distance):
        x = np.nanmedian(distance, axis=0)
        top.loglog(x, np.nanmedian(np.clip(ratio, 0, None), axis=0) ** 2, "o-", color=BLACK, ms=3, label="median")
        top.loglog(x, x / x[0], "--", color=ORANGE, label=r"$\propto \gamma_c - \gamma$")
        top.invert_xaxis()
        top.legend(loc="lower left")
    label_axes(top, x=BEFORE, y=r"$(\lambda/\lambda_{\rm far})^2$")
    top.set_title(f"real eigenvalue reaches zero: {_events(len(distance))}")
    distance, ratio, switched = _ratios(events, "sliding")
    for x, y in zip(distance[:LINES], ratio[:LINES], strict=True):
        bottom.plot(x, y, color=BLUE, lw=0.5, alpha=0.35)
    bottom.axhline(0, color=BLACK, lw=0.6)
    bottom.set_xscale("log")
    bottom.set_yscale("symlog", linthresh=2)
    label_axes(bottom, x=BEFORE, y=r"$\lambda/\lambda_{\rm far}$")
    if len(distance):
        x = np.nanmedian(distance, axis=0)
        bottom.plot(x, np.nanmedian(ratio, axis=0), "o-", color=BLACK, ms=3, label="median")
        right = np.nanmin(distance) / 10
        spread = right * 2.0 ** np.linspace(-0.7, 0.7, min(LINES, len(switched)))
        bottom.plot(spread, switched[:LINES], ".", color=RED, ms=3, label="at the event, its contact set to slide")
        bottom.axvline(3 * right, color=BLACK, lw=0.6, ls=":")
        bottom.set_xlim(2 * np.nanmax(distance), right / 3)
        bottom.xaxis.set_major_locator(LogLocator(subs=(1.0,)))
        bottom.xaxis.set_major_formatter(
            FuncFormatter(lambda x, _: f"$10^{{{round(np.log10(x))}}}$" if x > 3 * right else "")
        )
        bottom.xaxis.set_minor_locator(NullLocator())
        bottom.legend(loc="lower left")
    bottom.set_title(f"a contact starts to slide: {_events(len(distance))}")
    return figure


def _ratios(events, kind: str):
    """Return distances, relative λ, and relative λ with the contact set to slide, for one class of events."""
    rows = events["kind"] == kind
    distance, softest = events["distances"][rows], events["softest"][rows]
    far = softest[:, :1] if softest.shape[1] else np.full((len(softest), 1), np.nan)
    good = (np.isfinite(far) & (far > 0))[:, 0]
    return distance[good], softest[good] / far[good], events["switched"][rows][good] / far[good, 0]


def _events(number: int) -> str:
    return f"{number} event{'' if number == 1 else 's'}"


@styled
def classes(counts: dict[str, dict[str, int]]):
    """Fractions of event classes, one bar per law.

    Parameters
    ----------
    counts : {label of the law: {class: number of events}}
    """
    figure, axes = column_axes(1, 1.2 + 0.32 * len(counts))
    for row, count in enumerate(counts.values()):
        total, left = max(1, sum(count.values())), 0.0
        for kind, (_, color) in CLASSES.items():
            share = count.get(kind, 0) / total
            axes.barh(row, share, left=left, color=color, height=0.7)
            if share > 0.07:
                axes.text(left + share / 2, row, str(count[kind]), ha="center", va="center", color="white", fontsize=7)
            left += share
    axes.set_yticks(range(len(counts)), counts)
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.set_xlim(0, 1)
    label_axes(axes, x="fraction of events")
    handles = [
        axes.barh(0, 0, color=color, label=label)
        for kind, (label, color) in CLASSES.items()
        if any(count.get(kind) for count in counts.values())
    ]
    figure.legend(handles=handles, loc="outside upper center", ncol=2)
    return figure


@styled
def drops(tables: dict[str, _Drops]):
    """Distributions of stress drop over pressure and of jump size, by law.

    Fractions refer to all events, including events with rising stress, which are not drawn.

    Parameters
    ----------
    tables : {label of the law: table of events}
    """
    figure, panels = column_axes(2, 4.2)
    labels = {"stress_drop": r"stress drop over pressure $\Delta\sigma_{xy}/p$", "jump": ("jump", "mean diameters")}
    for axes, (column, quantity) in zip(panels, labels.items(), strict=True):
        for color, (law, events) in zip(COLORS, tables.items(), strict=False):
            values = np.sort(events[column][np.isfinite(events[column]) & (events[column] > 0)])
            share = np.arange(len(values), 0, -1) / max(1, len(events[column]))
            axes.step(values, share, where="post", color=color, label=law)
        axes.set(xscale="log", yscale="log")
        label_axes(axes, x=quantity, y="fraction of larger events")
    panels[0].legend(loc="lower left")
    return figure


@styled
def roc_curves(found: list[_Skill] | list[list[_Skill]], titles: list[str] | tuple[str, ...] = ("",)):
    """Receiver operating characteristics of all predictors with 95 % bands, one panel per law.

    Parameters
    ----------
    found : list of skills, or list of such lists
    titles : titles of the panels
    """
    panels = found if found and isinstance(found[0], list) else [found]
    rows = -(-len(panels) // 2)
    width = min(2, len(panels))
    figure, grid = subplots(rows, width, figsize=((WIDTH, PAGE)[width - 1], 3.9 * rows), squeeze=False)
    for axes, skills, title in zip(grid.flat, panels, titles, strict=False):
        for skill in skills:
            (label, color), roc = PREDICTORS[skill.predictor], skill.roc
            x = np.linspace(0, 1, skill.band.shape[1])
            axes.fill_between(x, *skill.band, color=color, alpha=0.15, lw=0)
            interval = f" ({skill.low:.2f}–{skill.high:.2f})" if np.isfinite(skill.low) else ""
            words = f"{label} {roc.area:.2f}{interval}"
            axes.plot(roc.false_alarms, roc.hits, color=color, label=words, clip_on=False)
        axes.plot([0, 1], [0, 1], ":", color=BLACK, lw=0.7)
        axes.set(xlim=(0, 1), ylim=(0, 1))
        label_axes(axes, x="fraction of false alarms", y="fraction of announced events")
        axes.fill_between([], [], color=BLACK, alpha=0.15, lw=0, label="95 % band")
        legend_above(axes, title=f"{title}: area under the curve (95 % interval)".removeprefix(": "), handlelength=1.2)
    for axes in grid.flat[len(panels) :]:
        axes.axis("off")
    return figure
