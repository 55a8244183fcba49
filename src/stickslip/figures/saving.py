"""Figures as files: PNG, PDF and SVG, one or two columns wide or for slides, with lettered panels."""

from contextlib import contextmanager
from io import BytesIO
from itertools import product
from pathlib import Path
from string import ascii_lowercase
from typing import Literal, NamedTuple

from ..core.arguments import checked
from ..core.readable import readable
from .style import SLIDE_PIXELS, common_style, fit_slide

FORMATS, WIDTHS = ("png", "pdf", "svg"), (86, 178)  # [mm]: one column, and two
UNDATED = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}  # the same figure has the same bytes


@readable
class Look(NamedTuple):
    """Formats, width and panel letters of figures."""

    formats: tuple[str, ...] = ("png",)
    width: Literal[86, 178] = 86  # in mm
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
    """Extent of the numbers of the vertical axis to its left [pixels]; its label may be taller than the axis."""
    boxes = [label.get_window_extent() for label in axes.get_yticklabels() if label.get_text() and label.get_visible()]
    return max((axes.bbox.x0 - box.x0 for box in boxes), default=0.0)


def _letter(figure) -> list:
    """Write (a), (b) … above the numbers at the left of each panel."""
    seen: dict = {}
    for axes in figure.axes:
        if axes.get_visible() and axes.axison and axes.get_label() != "<colorbar>":
            seen.setdefault(axes.get_subplotspec() or axes, axes)  # only the first of twins
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
