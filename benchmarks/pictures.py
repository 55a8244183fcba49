"""Pictures of the documentation, with fewer pixels and colours than other figures, and with text of a single size."""

from pathlib import Path

from PIL import Image

from stickslip.figures.style import save

SHRINK, COLORS = 0.7, 256  # scale of figures with 300 dots per inch, and number of colours


def save_picture(figure, path: Path) -> Path:
    """Save a figure as a picture of the documentation."""
    return shrink(save(figure, path), path)


def shrink(path: Path, to: Path, size: float = SHRINK) -> Path:
    """Save a picture with fewer colours, scaled to a fraction of its size in pixels."""
    picture = Image.open(path).convert("RGB")
    small = picture.resize([round(size * k) for k in picture.size], Image.Resampling.LANCZOS)
    # MAXCOVERAGE keeps colours of few pixels, such as those of thin lines
    small.quantize(COLORS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(to, optimize=True)
    return to
