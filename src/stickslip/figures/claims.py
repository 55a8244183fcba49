"""Chart of the claims of a paper: every measurement in units of its tolerance, next to the paper's value."""

from typing import NamedTuple

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from .style import BLACK, BLUE, GREEN, ORANGE, PAGE, PURPLE, RED, OwnFigure, styled

GREY = "0.55"
MARKS = {  # colour, marker, filled: distinguishable without colours
    "reproduced": (GREEN, "o", True),
    "partly": (ORANGE, "D", True),
    "not reproduced": (RED, "X", True),
    "refuted": (PURPLE, "P", True),
    "not refuted": (GREEN, "^", False),
    "undecided": (BLUE, "s", False),
    "no reference": (GREY, "o", False),
}
REACH = 4.0  # range of the axis in tolerances; values beyond it are arrows at the edge
PITCH = 0.165  # height of a row [inch]
MARGIN = 1.15  # height of title, axis and legend [inch]
LEFT, WIDE = 2.0, 1.15  # left edge and width of the axes [inch]
SIZE = 7  # font size of texts [points]
SHORT = 32  # longest label [characters]


class Row(NamedTuple):
    """One row of the chart of claims."""

    label: str
    group: str  # figure of the paper
    verdict: str
    deviation: tuple[float, ...]  # deviation in tolerances: one number, two ends of a window, or empty
    error: float  # error in tolerances; 0 if there is none
    measured: str
    paper: str
    beside_reference: bool  # True if deviation and value refer to a reference instead of the paper
    unit: str = ""
    own: bool = True  # False for a variant of the paper's model, which counts separately
    instead: str = ""  # drawn in place of a deviation: the answer to a statement, or the reason for a missing value


@styled
def claims_chart(rows: list[Row], title: str):
    """Deviation of every measurement from the paper's value, with error, tolerance and verdict, one row per claim."""
    height = PITCH * (len(rows) + 1) + MARGIN
    figure = OwnFigure(figsize=(PAGE, height))
    bottom = 0.75 * MARGIN / height
    axes = figure.add_axes((LEFT / PAGE, bottom, WIDE / PAGE, PITCH * (len(rows) + 1) / height))
    axes.axvspan(-1, 1, color="0.9", lw=0, zorder=0)
    axes.axvline(0, color=BLACK, lw=0.7, zorder=1)
    groups = [row.group for row in rows]
    for k, row in enumerate(rows):
        _draw_row(axes, k, row)
        if k and groups[k] != groups[k - 1]:
            axes.axhline(k - 0.5, color="0.75", lw=0.4, zorder=0)
    axes.set(xlim=(-1.15 * REACH, 1.15 * REACH), ylim=(len(rows) - 0.5, -0.5))
    axes.set_yticks(range(len(rows)), [_label(groups, k, row) for k, row in enumerate(rows)])
    axes.tick_params(axis="y", length=0, labelsize=SIZE)
    axes.set_xticks(range(-int(REACH), int(REACH) + 1, 2))
    axes.set_xlabel("(measured − paper) / tolerance", fontsize=7, labelpad=2)
    for x, heading in zip(COLUMNS, ("measured", "paper", "unit", "verdict"), strict=True):
        axes.text(x, 1.0, heading, transform=axes.transAxes, fontsize=SIZE, weight="bold", va="bottom")
    figure.text(0.01, 1 - 0.06 / height, title, fontsize=8, va="top")
    seen = [word for word in MARKS if any(row.verdict == word for row in rows)]
    handles = [
        Line2D([], [], ls="", marker=MARKS[w][1], color=MARKS[w][0], mfc=MARKS[w][0] if MARKS[w][2] else "white", ms=4)
        for w in seen
    ]
    labels = [f"{word} ({_count(rows, word)})" for word in seen]  # the same words as on the terminal
    handles.append(Patch(color="0.9"))
    labels.append("tolerance; arrows: outside the range")
    if any(row.beside_reference for row in rows):
        handles.append(Line2D([], [], ls=""))
        labels.append("italic: a reference, not the paper's value")
    figure.legend(handles, labels, loc="lower left", ncol=3, fontsize=SIZE, handletextpad=0.4, columnspacing=1.4)
    return figure


COLUMNS = (1.04, 1.98, 2.56, 3.55)  # left edges of the texts, in widths of the axes


def _label(groups: list[str], k: int, row: Row) -> str:
    """Label of a claim; in the first row of a group, the number of the figure in the paper comes first."""
    text = row.label if len(row.label) <= SHORT else row.label[: SHORT - 1] + "…"
    return text if k and groups[k] == groups[k - 1] else f"{row.group}:  {text}"


def _draw_row(axes, k: int, row: Row) -> None:
    if row.verdict not in MARKS:
        raise ValueError(f"a verdict must be one of {', '.join(MARKS)}, got {row.verdict!r}")
    color, marker, filled = MARKS[row.verdict]
    face = color if filled else "white"
    style = {"marker": marker, "ms": 4, "color": color, "mfc": face, "mew": 0.9, "ls": "", "clip_on": False}
    inside = [x for x in row.deviation if abs(x) <= REACH]
    for x in row.deviation:
        if abs(x) > REACH:
            side = np.sign(x)
            axes.plot(1.05 * side * REACH, k, **style | {"marker": ">" if side > 0 else "<"}, zorder=3)
    if len(row.deviation) > 1:
        axes.plot(np.clip(row.deviation, -REACH, REACH), [k, k], color=color, lw=0.7, zorder=2)
    for x in inside:
        if row.error:
            ends = np.clip([x - row.error, x + row.error], -1.15 * REACH, 1.15 * REACH)
            axes.plot(ends, [k, k], color=color, lw=1.0, zorder=2, solid_capstyle="butt")
        axes.plot(x, k, **style, zorder=3)
    if row.instead:
        box = {"facecolor": "white", "edgecolor": color, "lw": 0.5, "pad": 1.2}
        axes.text(0, k, row.instead, fontsize=SIZE, ha="center", va="center", color=color, bbox=box, zorder=4)
    grey = {"color": "0.45", "style": "italic"} if row.beside_reference else {}
    place = {"transform": axes.get_yaxis_transform(), "fontsize": SIZE, "va": "center"}
    axes.text(COLUMNS[0], k, row.measured, **place)
    axes.text(COLUMNS[1], k, row.paper, **place, **grey)
    axes.text(COLUMNS[2], k, row.unit, **place)
    axes.plot(COLUMNS[3] + 0.01, k, **style | {"transform": axes.get_yaxis_transform()})
    axes.text(COLUMNS[3] + 0.05, k, row.verdict, **place, color=color if row.verdict != "no reference" else "0.4")


def _count(rows: list[Row], verdict: str) -> str:
    """Number of claims on the paper's own model, and, separately, on variants of it."""
    own, others = (sum(row.verdict == verdict and row.own == kind for row in rows) for kind in (True, False))
    return f"{own} + {others} of variants" if others else str(own)
