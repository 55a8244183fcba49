"""Common style of all figures: single-column width (86 mm) and the colour-blind-safe palette of Okabe and Ito."""

import re
from functools import wraps
from io import BytesIO
from pathlib import Path

import matplotlib

matplotlib.use("Agg", force=False)
from matplotlib import pyplot as plt

from ..core.arguments import checked
from ..core.units import unit_name

WIDTH = 3.39  # inches, one column
BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
    "#000000",
)
COLORS = (BLUE, SKY, GREEN, ORANGE, RED, PURPLE, BLACK)
STYLE = {
    "figure.dpi": 200,
    "savefig.dpi": 300,
    "font.size": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 6.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.linewidth": 0.7,
    "lines.linewidth": 1.0,
    "lines.markersize": 3,
    "legend.frameon": False,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "axes.formatter.use_mathtext": True,
    "axes.prop_cycle": plt.cycler(color=COLORS),
    "figure.constrained_layout.use": True,
}
TIME = r"time $t$ [$\sqrt{m/(k_n\sqrt{2R})}$]"


def styled(function):
    """Decorate a drawing function to use the common style; its arguments are checked."""
    drawn = checked(function)

    @wraps(function)
    def inner(*args, **options):
        with plt.rc_context(STYLE):
            return drawn(*args, **options)

    return inner


def column_axes(rows: int = 1, height: float = 2.5, **options):
    """Create a figure one column wide with stacked axes; height in inches."""
    return plt.subplots(rows, 1, figsize=(WIDTH, height), **options)


def _name_units(figure) -> None:
    """Replace dimensions in the labels of axes by the units in use, as "[length]" by "[mm]"."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_label_text(re.sub(r"\[(.+?)\]", lambda found: f"[{unit_name(found[1])}]", axis.get_label_text()))


@styled
def save(figure, path: str | Path) -> Path:
    """Write a figure (the extension selects the format) and close it."""
    _name_units(figure)
    figure.savefig(path)
    plt.close(figure)
    return Path(path)


@styled
def png(figure) -> bytes:
    """Return a figure as the content of a PNG file, and close the figure."""
    content = BytesIO()
    _name_units(figure)
    figure.savefig(content, format="png")
    plt.close(figure)
    return content.getvalue()
