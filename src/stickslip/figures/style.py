"""Common style of all figures: width, palette, labels and ticks of axes, envelopes of fast oscillations, and legends.

Figures are one column wide (86 mm), or two (178 mm), in the colour-blind-safe palette of Okabe and Ito. For slides,
they are laid out on a small 16:9 canvas, which is enlarged together with type and lines. Files are PNG, PDF and SVG,
with lettered panels.
"""

import re
import warnings
from contextlib import contextmanager
from functools import wraps
from io import BytesIO
from itertools import combinations, product
from pathlib import Path
from string import ascii_lowercase
from threading import RLock
from typing import Literal, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.ticker import AutoLocator, LogFormatterMathtext, LogLocator, ScalarFormatter

from ..core.arguments import checked
from ..core.readable import readable
from ..core.scales import ROUND_OFF
from ..core.units import current_units, unit_name

WIDTH, PAGE = 86 / 25.4, 178 / 25.4  # inches, one column and two
SLIDE, SLIDE_STEP = 2.7, 1.1  # height of the canvas for slides [inches], and factor of its growth until panels fit
# (type of 8 points on this canvas is as large as one of 22 points on a slide 7.5 inches high)
PANEL, DRAWING = 0.4, 0.9  # smallest heights on slides: of a panel, and of a drawing with axes [inches]
LEAST_LABEL = 0.7  # fraction of its size to which a long label is shrunk on slides
SLIDE_PIXELS = 1920  # width of figures on slides
SLIDE_MOVIE, SLIDE_DPI = (5.12, 2.88), 250  # canvas of a movie on slides [inches], of 1280 × 720 pixels
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, BLACK = "#CC79A7", "#56B4E9", "#000000"
BOND, BROKEN = "#C9A66B", PURPLE  # colours of bonds, which are drawn under contacts
COLORS = (BLUE, SKY, GREEN, ORANGE, RED, PURPLE, BLACK)
STYLE = {
    "figure.dpi": 200,
    "savefig.dpi": 300,
    "font.size": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 7,
    "legend.title_fontsize": 7,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.linewidth": 0.7,
    "axes.titlesize": 7.5,
    "lines.linewidth": 1.0,
    "lines.markersize": 3,
    "legend.frameon": False,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "axes.formatter.use_mathtext": False,  # tick labels without mathematics take a third less time
    "axes.prop_cycle": matplotlib.cycler(color=COLORS),
    "figure.constrained_layout.use": False,  # figures choose their layout; otherwise saving would add one
    "pdf.fonttype": 42,  # TrueType: journals do not accept Type 3
    "ps.fonttype": 42,
    "svg.fonttype": "none",  # text remains text
    "svg.hashsalt": "stickslip",  # the same figure has the same bytes
}
TIME = ("time $t$", r"$\sqrt{m/(k_n\sqrt{2R})}$")  # quantity and unit
STRESS = "force/length^(dim-1)"  # unit of stress without named units
DIMENSIONS = re.compile(r"(?:(?:length|time|mass|force|energy|stress)\b|[\d^²³()/ ])+")
POWERS = (-3, 4)  # powers of ten from which on the power moves from the tick labels of an axis to its unit
TICK_SIZE = STYLE["xtick.labelsize"]
DIGIT = 0.65  # width of a digit over the size of the font
BIN = 1.0  # width of the bins of an envelope [points], below which oscillations are visible


Words = str | tuple[str, str]  # quantity, or quantity and unit


_DRAWING = RLock()  # matplotlib settings are global: threads would restore each other's


@contextmanager
def common_style(**more):
    """Context manager for drawing in the common style with optional further settings; restores the user's settings."""
    with _DRAWING, matplotlib.rc_context(STYLE | more):
        yield


def styled(function):
    """Decorate a drawing function so that it uses the common style and checks its arguments."""
    drawn = checked(function)

    @wraps(function)
    def inner(*args, **options):
        with common_style():
            return drawn(*args, **options)

    return inner


class OwnFigure(Figure):
    """Figure in the common style wherever it is shown or saved, unknown to pyplot and its backend."""

    def __init__(self, *args, **options) -> None:
        super().__init__(*args, **options)
        FigureCanvasAgg(self)

    def draw(self, renderer) -> None:
        """Draw in the common style, which also affects ticks that are created only here."""
        with common_style():
            super().draw(renderer)

    def savefig(self, *args, **options) -> None:
        """Save the figure; see matplotlib."""
        with common_style():
            super().savefig(*args, **options)

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        self.savefig(content, format="png", dpi="figure")
        return content.getvalue()


def subplots(rows: int = 1, columns: int = 1, *, figsize: tuple[float, float], **options):
    """Create a figure with a grid of axes; see `matplotlib.figure.Figure.subplots`."""
    figure = OwnFigure(figsize=figsize, layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def fit_slide(figure) -> dict:
    """Set a 16:9 canvas, as small as the panels allow, so that type is large after enlargement.

    Labels longer than their axes are shrunk. Returns the previous sizes of these labels.
    """
    height, most, sizes = SLIDE, 2 * max(figure.get_size_inches()), {}
    with warnings.catch_warnings(action="ignore"):  # matplotlib's warning that panels have no room
        while True:
            for text, size in sizes.items():
                text.set_fontsize(size)
            figure.set_size_inches(height * 16 / 9, height)
            figure.draw_without_rendering()
            for axes in _shown_axes(figure):
                for text, along in ((axes.xaxis.label, "width"), (axes.yaxis.label, "height")):
                    room, long = getattr(axes.bbox, along), getattr(text.get_window_extent(), along)
                    if long > room:
                        sizes.setdefault(text, text.get_fontsize())
                        text.set_fontsize(sizes[text] * max(LEAST_LABEL, room / long))
            if height > most or not _is_crowded(figure):
                return sizes
            height *= SLIDE_STEP


def _shown_axes(figure) -> list[Axes]:
    return [axes for axes in figure.axes if axes.get_visible() and axes.axison]


def _is_crowded(figure) -> bool:
    """Return True if labels of axes and titles overlap or leave the figure, or if panels are too small."""
    shown = _shown_axes(figure)
    texts = [text for axes in shown for text in (axes.xaxis.label, axes.yaxis.label, axes.title)]
    boxes = [text.get_window_extent() for text in texts if text.get_text() and text.get_visible()]
    legends = [legend.get_window_extent() for legend in (*map(Axes.get_legend, shown), *figure.legends) if legend]
    page = figure.bbox.padded(1)
    leave = any(box.x0 < page.x0 or box.y0 < page.y0 or box.x1 > page.x1 or box.y1 > page.y1 for box in boxes + legends)
    panels = [(axes.bbox.height, axes.get_aspect()) for axes in shown if axes.get_label() != "<colorbar>"]
    small = any(height < (PANEL if aspect == "auto" else DRAWING) * figure.dpi for height, aspect in panels)
    return leave or small or any(a.overlaps(b) for a, b in combinations(boxes, 2))


def column_axes(rows: int = 1, height: float = 2.5, **options):
    """Create a figure one column wide with stacked axes; height in inches."""
    return subplots(rows, figsize=(WIDTH, height), **options)


def axis_label(quantity: str, unit: str = "", power: int = 0) -> str:
    """Label of an axis whose numbers are multiples of 10^power times the unit, as in "time [10³ s]"."""
    inside = " ".join(word for word in (f"$10^{{{power}}}$" if power else "", unit) if word)
    gap = "" if quantity.endswith("\n") else " "
    return f"{quantity}{gap}[{inside}]" if inside else quantity


def _power(number: float) -> int:
    """Power of ten that is written apart from a number; 0 if it is of order one."""
    power = int(np.floor(np.log10(abs(number)))) if number else 0
    return 0 if POWERS[0] < power < POWERS[1] else power


def power_of_ten(number: float, error: float | None = None) -> str:
    """Text of a number and its error with three digits, as in (1.23 ± 0.05) × 10⁻³; no power if it is of order one."""
    power = _power(number)
    mantissa = f"{number / 10.0**power:.3g}"
    if error is not None:
        mantissa = f"({mantissa} ± {error / 10.0**power:.2g})" if power else f"{mantissa} ± {error:.2g}"
    if not power:
        return mantissa
    return rf"$10^{{{power}}}$" if mantissa == "1" else rf"${mantissa}\times 10^{{{power}}}$"


def label_axes(
    axes, *, x: Words | None = None, y: Words | None = None, z: Words | None = None, whole: str = "",
    least: dict[str, float] | None = None,
) -> None:  # fmt: skip
    """Label axes with a quantity, or a pair of quantity and unit, after their scales have been chosen.

    Dimensions such as "length" become the units in use, or "units of length".

    `whole` contains the names of axes with integers, and `least` the smallest ranges of axes by name, which prevent
    zooming into noise. No linear axis zooms into round-off.

    All axes of figures are labelled by this function. Linear axes get as many ticks as fit side by side; if their
    numbers are large or small, a power of ten moves to the label, as in "strain [10⁻⁵]". Logarithmic axes of little
    more than a decade also have labels at 2 and 5.
    """
    for name, label in (("x", x), ("y", y), ("z", z)):
        if label is None:
            continue
        quantity, unit = (label, "") if isinstance(label, str) else label
        unit = unit_name(unit).replace(STRESS, "stress")
        if current_units() is None and DIMENSIONS.fullmatch(unit) and unit != "1":
            unit = f"units of {unit}"
        axis = getattr(axes, f"{name}axis")
        axis.set_label_text(axis_label(quantity, unit))
        if axis.get_scale() == "linear":
            axis.set_major_locator(_FittingLocator(integer=name in whole, least=(least or {}).get(name, 0.0)))
            axis.set_major_formatter(_PowerFormatter(quantity, unit))
        elif axis.get_scale() == "log":
            axis.set_major_locator(LogLocator(numticks=7))
            axis.set_minor_formatter(_MinorFormatter())


class _PowerFormatter(ScalarFormatter):
    """Numbers without offset; their common power of ten is in the label of the axis."""

    def __init__(self, quantity: str, unit: str) -> None:
        super().__init__(useOffset=False, useMathText=True)
        self.set_scientific(False)
        self.words = quantity, unit

    def format_ticks(self, values) -> list[str]:
        power = _power(np.abs(values).max(initial=0.0))
        text = axis_label(*self.words, power)
        if self.axis.get_label_text() != text:
            self.axis.set_label_text(text)
        return super().format_ticks(np.asarray(values) / 10.0**power)


class _FittingLocator(AutoLocator):
    """Locator of as many round numbers as fit side by side."""

    def __init__(self, *, integer: bool, least: float = 0.0) -> None:
        super().__init__()
        self.set_params(integer=integer)
        self.least = least

    def nonsingular(self, v0: float, v1: float) -> tuple[float, float]:
        """Limits of an axis without margins, wider than the data if these differ only by noise."""
        low, high = sorted((v0, v1))
        size = max(abs(low), abs(high))
        noise = self.least if high - low < self.least else 0.05 * size if high - low <= ROUND_OFF * size else 0.0
        return super().nonsingular(low - 0.5 * noise, high + 0.5 * noise)

    def __call__(self):
        low, high = self.axis.get_view_interval()
        for count in range(int(np.clip(self.axis.get_tick_space(), 5 if self.axis.axis_name == "x" else 2, 9)), 0, -1):
            self.set_params(nbins=count, min_n_ticks=1 if count < 3 and self.axis.axis_name == "x" else 2)
            places = self.tick_values(low, high)
            if count == 1 or self._fit(places, abs(high - low)):
                return places
        return places

    def _fit(self, places, span: float) -> bool:
        if self.axis.axis_name != "x" or len(places) < 2 or not span:
            return True
        how = self.axis.get_tick_params()
        texts = self.axis.get_major_formatter().format_ticks(places)
        longest = max(len(re.sub(r"\$|\\mathdefault|[{}]", "", text)) for text in texts)
        size = FontProperties(size=how.get("labelsize", TICK_SIZE)).get_size_in_points()
        axes = self.axis.axes
        room = axes.bbox.width * 72 / axes.figure.dpi * (places[1] - places[0]) / span
        wide = 1.5 if how.get("rotation") else DIGIT * longest + 0.7
        return wide * size <= room


class _MinorFormatter(LogFormatterMathtext):
    """Labels at 2 and 5 times powers of ten, on axes that span little more than a decade."""

    def __call__(self, value, pos=None) -> str:
        low, high = sorted(self.axis.get_view_interval())
        power = int(np.floor(np.log10(value) + 1e-9))
        first = round(value / 10.0**power)
        if first not in (2, 5) or not low > 0 or np.log10(high / low) > 1.6:
            return ""
        return rf"${first}\times 10^{{{power}}}$"


def plot_fast(axes, x, y, *, color, label: str | None = None, lw: float = 0.7, middle: bool = True) -> None:
    """Plot a signal, or its envelope if it oscillates too fast for separate lines.

    The envelope is a pale band from the smallest to the largest value in each bin; `middle` adds the mean as a line.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[finite], y[finite]
    bins = max(8, round(axes.get_position().width * axes.figure.get_figwidth() * 72 / BIN))
    turns = _count_turns(y)
    if turns <= bins or x[-1] <= x[0]:
        axes.plot(x, y, color=color, lw=lw, label=label)
        return
    bins = min(bins, turns // 4)  # two or more oscillations per bin, as part of one may not reach the envelope
    starts = np.unique(np.searchsorted(x, np.linspace(x[0], x[-1], bins, endpoint=False)))
    count = np.diff(np.r_[starts, len(x)])
    at, mean = (np.add.reduceat(values, starts) / count for values in (x, y))
    low, high = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
    axes.fill_between(at, low, high, facecolor=color, edgecolor="none", alpha=0.35, label=None if middle else label)
    if middle:
        axes.plot(at, mean, color=color, lw=lw, label=label)
    else:
        for edge in (low, high):
            if _count_turns(edge) < bins / 4:
                axes.plot(at, edge, color=color, lw=0.5 * lw)


def _count_turns(y: np.ndarray) -> int:
    """Number of minima and maxima of a signal."""
    slope = np.sign(np.diff(y))
    return np.count_nonzero(np.diff(slope[slope != 0]))


def legend_above(axes, *handles, title: str = "", ncol: int = 2, **options) -> None:
    """Draw the legend above the axes and below the title."""
    if not handles and not axes.get_legend_handles_labels()[0]:
        axes.set_title(title)
        return
    legend = axes.legend(
        *handles, title=title or None, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=ncol, columnspacing=1.0,
        **options,
    )  # fmt: skip
    for line in legend.get_lines():
        line.set_linewidth(max(1.0, line.get_linewidth()))


FORMATS, WIDTHS = ("png", "pdf", "svg"), (86, 178)  # [mm]: one column, and two
UNDATED = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}  # the same figure has the same bytes


@readable
class Look(NamedTuple):
    """Formats, width and panel letters of figures."""

    formats: tuple[str, ...] = ("png",)
    width: Literal[86, 178] = 86  # [mm]
    letters: bool = True  # letters of panels, if there are several
    slides: bool = False  # 16:9 with large type, instead of a width


PLAIN = Look()


@checked
def save(
    figure, path: str | Path, *, width: Literal[86, 178] | None = None, letters: bool = True, slides: bool = False
) -> Path:
    """Write a figure as PNG, PDF or SVG, according to the extension; text remains text in PDF (TrueType) and SVG.

    Parameters
    ----------
    figure : figure of this package, or any other matplotlib figure
    width : 86 for one column (default), 178 for two [mm]; figures with panels side by side are always 178 wide
    letters : whether panels are lettered (a), (b) …, if there are several
    slides : whether the figure is 16:9, with type and lines large enough for a lecture hall, instead of a width
    """
    path = Path(path)
    if (kind := path.suffix.lower().removeprefix(".")) not in FORMATS:
        raise ValueError(f"the name of a figure must end with .png, .pdf or .svg, got {path}")
    path.write_bytes(render(figure, kind, look_of(width=width, letters=letters, slides=slides)))
    return path


def look_of(formats: tuple[str, ...] = ("png",), *, width: int | None, letters: bool, slides: bool) -> Look:
    """Look of figures; raise ValueError if slides are combined with a width."""
    if slides and width is not None:
        raise ValueError(f"width {width} does not apply to slides, which are 16:9: leave out one of the two")
    return Look(formats, width or PLAIN.width, letters, slides)


def render(figure, kind: str = "png", look: Look = PLAIN) -> bytes:
    """Return a figure as the content of a file; the figure itself is not changed."""
    content = BytesIO()
    with common_style(), _arranged(figure, look):
        dpi = {"dpi": SLIDE_PIXELS / figure.get_figwidth()} if look.slides and kind == "png" else {}
        figure.savefig(content, format=kind, metadata=UNDATED[kind], **dpi)
    return content.getvalue()


def render_all(name: str, figure, look: Look) -> dict[str, bytes]:
    """Contents of the files of a figure by name; `name` is that of the PNG file, which is always written."""
    stem = name.removesuffix(".png")
    return {f"{stem}.{kind}": render(figure, kind, look) for kind in dict.fromkeys(("png", *look.formats))}


@contextmanager
def _arranged(figure, look: Look):
    """Widen a figure and letter its panels while it is written."""
    wide, tall = figure.get_size_inches()
    factor = max(1.0, look.width / 25.4 / wide)
    equal = any(axes.get_aspect() != "auto" for axes in figure.axes)
    sizes, letters = {}, []
    try:
        if look.slides:
            sizes = fit_slide(figure)
        else:
            figure.set_size_inches(factor * wide, (factor if equal else 1.0) * tall)
        if look.letters:
            letters = _letter(figure)
        yield
    finally:
        figure.set_size_inches(wide, tall)
        for text, before in sizes.items():
            text.set_fontsize(before)
        for letter in letters:
            letter.remove()


def _reach(axes) -> float:
    """Extent of the tick labels to the left of the vertical axis [pixels], without the label of the axis."""
    boxes = [label.get_window_extent() for label in axes.get_yticklabels() if label.get_text() and label.get_visible()]
    return max([0.0, *(axes.bbox.x0 - box.x0 for box in boxes)])


def _letter(figure) -> list:
    """Write (a), (b) … above the numbers at the left of each panel."""
    seen: dict = {}
    for axes in figure.axes:
        shown = getattr(axes, "_axis3don", axes.axison)  # in three dimensions, `axison` is always False
        if axes.get_visible() and shown and axes.get_label() != "<colorbar>":
            seen.setdefault(axes.get_subplotspec() or axes, axes)  # only the first of twin axes
    if len(seen) < 2:
        return []
    figure.draw_without_rendering()
    letters = [*ascii_lowercase, *map("".join, product(ascii_lowercase, repeat=2))]
    reach = {axes: _reach(axes) for axes in seen.values()}
    out = []
    for letter, axes in zip(letters, reach, strict=False):
        left = max(far for other, far in reach.items() if abs(other.bbox.x0 - axes.bbox.x0) < 1)
        place = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "left", "va": "bottom"}
        out.append(axes.annotate(f"({letter})", (0, 1), (-left * 72 / figure.dpi, 4), **place, fontsize=8))
        box = out[-1].get_window_extent()
        beside = [words.get_window_extent() for words in (axes.title, axes.get_legend()) if words]
        if hidden := [words.y1 for words in beside if words.overlaps(box)]:
            out[-1].xyann = out[-1].xyann[0], (max(hidden) - axes.bbox.y1) * 72 / figure.dpi + 2
    return out
