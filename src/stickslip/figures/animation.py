"""Movies of a packing as GIF or MP4: frames of a run, stored or interpolated, or one period of a mode."""

from pathlib import Path
from shutil import which
from subprocess import CalledProcessError
from typing import Annotated

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from PIL import Image

from ..core.arguments import FILLED, require_shape
from ..core.progress import Report, silent
from ..data.exchange.frame import Frame
from ..extras import MissingExtraError, require
from .grains import draw, draw_colour_bar, draw_legend, layout_of, legend_columns, legend_handles, view_limits
from .page import MARK
from .scene import Mode, Zoom
from .style import SLIDE_DPI, SLIDE_MOVIE, OwnFigure, common_style, styled

ENDINGS = (".gif", ".mp4")
FPS, SECONDS = 25, 8.0  # frames per second of a movie, and duration of the movie of a run [s]
PIXELS, DPI = 900, 150  # width of the picture (up to 1.5 times as much for wide ones); type is readable at half of it
ROW = 0.17  # height of a row of the legend [inches]
BITS = 6  # bits per channel of the colours from which the palette of a GIF is made
WHITE = 247  # colours whose channels all reach this value become white: Pillow would mistake some of them for white
STRETCH = 1.02  # largest length of a contact between two stored frames, over the stored length; longer ones are omitted


@styled
def movie(
    frames: Annotated[list[Frame], FILLED], path: str | Path, *, labels: list[str],
    mode: Mode | None = None, colour: str | None = None,
    fps: int = FPS, zoom: Zoom = 1.0, slides: bool = False, report: Report = silent,
) -> Path:  # fmt: skip
    """Draw frames one after another, with common limits for axes and colours.

    Parameters
    ----------
    frames : from `frame_of` or `mode_frames`
    path : its extension selects the format: .gif, or .mp4, which requires ffmpeg
    labels : titles of the frames
    mode : the mode that the frames show, for the colour "mode displacement"
    colour : one of `quantities`
    fps : frames per second
    zoom : as in `packing`
    slides : whether the movie is 16:9, with larger type and thicker lines
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If the extension or the colour is unknown, or the zoom is not allowed.
    MissingExtraError
        If an MP4 is requested but ffmpeg is not available.
    RuntimeError
        If ffmpeg exits prematurely.
    """
    path = Path(path)
    check_movie(path, fps)
    require_shape((len(frames),), labels=labels)
    layout = layout_of(frames, colour=colour, mode=mode, zoom=zoom)
    low, high = view_limits(layout)
    wide, tall = high - low
    inches = PIXELS / DPI * float(np.clip(wide / tall / 1.5, 1.0, 1.5))  # a low, wide packing gets a wider picture
    dpi, settings = DPI, {"font.size": 11, "legend.fontsize": 9, "axes.labelsize": 9, "xtick.labelsize": 9}
    if slides:
        (inches, height), dpi, settings = SLIDE_MOVIE, SLIDE_DPI, {"font.size": 10, "legend.fontsize": 8}
    handles = legend_handles(frames[0], near=False, colour=colour)
    rows = -(-len(handles) // legend_columns(inches))
    below, above = (0.66 if colour else 0.2) + ROW * rows, 0.3  # room for legend and colour bar, and for the title
    if not slides:
        height = min(0.98 * inches * tall / wide, 1.3 * inches) + below + above
        inches, height = (round(DPI / 2 * size) / (DPI / 2) for size in (inches, height))  # even, as H.264 requires
    settings["savefig.dpi"] = dpi
    if path.suffix.lower() == ".mp4":
        settings["animation.ffmpeg_path"] = _find_ffmpeg()
    with common_style(**settings):
        figure = OwnFigure(figsize=(inches, height), dpi=dpi)
        axes = figure.add_axes([0.01, below / height, 0.98, 1 - (below + above) / height])
        writer: GifWriter | FFMpegWriter = GifWriter(fps=fps)
        if path.suffix.lower() == ".mp4":
            extra = ["-pix_fmt", "yuv420p", "-loglevel", "error"]
            writer = FFMpegWriter(fps=fps, codec="libx264", extra_args=extra, metadata={"comment": MARK})
        try:
            with writer.saving(figure, str(path), dpi):
                for k, frame in enumerate(frames):
                    axes.clear()
                    drawn = draw(axes, frame, layout, mode=mode, first=frames[0], near=False)
                    draw_legend(axes, frame, near=False, colour=colour)
                    axes.set_title(labels[k], fontsize=settings["font.size"], pad=4)
                    _fit_texts(axes)
                    if colour and k == 0:
                        place = figure.add_axes([0.25, 0.42 / height, 0.5, 0.1 / height])
                        draw_colour_bar(figure, drawn, layout, cax=place, orientation="horizontal")
                    writer.grab_frame()
                    report("movie", (k + 1) / len(frames), f"frame {k + 1} of {len(frames)}")
        except (CalledProcessError, BrokenPipeError) as problem:
            how = f"exit code {problem.returncode}" if isinstance(problem, CalledProcessError) else "it closed its pipe"
            raise RuntimeError(
                f"ffmpeg ended before the movie was complete ({how}): free some space if the disk is full, or write a "
                ".gif"
            ) from None
    return path


def _fit_texts(axes) -> None:
    """Shrink the title and the text beside the scale bar if they would exceed the picture."""
    axes.apply_aspect()
    page = axes.figure.bbox
    for text in (axes.title, *axes.texts):
        box = text.get_window_extent()
        room = page.width if text is axes.title else page.x1 - box.x0
        if box.width > 0.98 * room:
            text.set_fontsize(text.get_fontsize() * 0.98 * room / box.width)


def check_movie(path: Path, fps: int) -> None:
    """Raise ValueError or MissingExtraError if a movie cannot be written."""
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"the name of a movie must end with {' or '.join(ENDINGS)}, got {path}")
    if not 1 <= fps <= 100:
        raise ValueError(f"frames per second must be from 1 to 100, got {fps}")
    if path.suffix.lower() == ".mp4":
        _find_ffmpeg()


class GifWriter(PillowWriter):
    """GIF writer with one palette for all frames, which keeps rare colours, such as those of sliding contacts."""

    def finish(self):
        """Write the file."""
        frames = [frame.convert("RGB") for frame in self._frames]
        palette = _palette_of(frames)
        frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
        frames[0].save(
            self.outfile, save_all=True, append_images=frames[1:], duration=round(1000 / self.fps), loop=0, comment=MARK
        )  # fmt: skip


def _palette_of(frames: list[Image.Image]) -> Image.Image:
    """Image whose palette of 256 colours represents those of all frames; the background stays white.

    Colours are distinguished by `BITS` bits per channel and weighted by the square root of their numbers of pixels.
    """
    count, most = np.zeros(2 ** (3 * BITS), np.int64), 2**BITS - 1
    for frame in frames:
        red, green, blue = (np.asarray(frame) >> 8 - BITS).reshape(-1, 3).T.astype(np.int32)
        count += np.bincount(red << 2 * BITS | green << BITS | blue, minlength=len(count))
    bins = np.flatnonzero(count)
    colours = np.stack([bins >> 2 * BITS, bins >> BITS & most, bins & most], axis=1)
    weight = np.ceil(np.sqrt(count[bins] / len(frames)) / 4).astype(int)
    pixels = np.repeat(np.round(255 / most * colours).astype(np.uint8), weight, axis=0)
    image = Image.fromarray(pixels[None]).quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1)
    palette = np.array(image.getpalette()).reshape(-1, 3)
    least = palette.min(axis=1)
    palette[least >= min(WHITE, least.max())] = 255
    image.putpalette(palette.ravel().tolist())
    return image


def _find_ffmpeg() -> str:
    """Path to ffmpeg: the system's own, or the one installed by a wheel."""
    if found := which("ffmpeg"):
        return found
    try:
        return require("imageio_ffmpeg", "mp4").get_ffmpeg_exe()
    except MissingExtraError as problem:
        raise MissingExtraError(f"an MP4 needs ffmpeg: {problem}; or write a .gif") from None


def frames_between(frames: list[Frame], count: int) -> list[Frame]:
    """`count` frames at equal intervals from the first stored frame to the last.

    Positions and angles follow monotone cubic interpolation in time (in frame number, if time does not advance): smooth
    curves through the stored values that do not overshoot. Cells, walls and velocities are interpolated linearly.
    The force of a contact that is in both neighbouring stored frames is interpolated; a contact in only one of them
    fades with the distance to that frame, and is omitted while its grains are apart. Everything else is taken from the
    nearer stored frame.

    Parameters
    ----------
    frames : of the same grains, in order

    Source
    ------
    Fritsch and Butland, doi:10.1137/0905021.
    """
    from scipy.interpolate import PchipInterpolator  # slow to import

    times = np.array([frame.state.time for frame in frames], float)
    if not (np.diff(times) > 0).all():
        times = np.arange(len(frames), dtype=float)
    if len(frames) < 2:
        return frames * count
    position, angle = (
        PchipInterpolator(times, np.stack([getattr(frame.state.grains, name) for frame in frames]))
        for name in ("position", "angle")
    )
    out = []
    for t in np.linspace(times[0], times[-1], count):
        k = int(np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2))
        share = float((t - times[k]) / (times[k + 1] - times[k]))
        out.append(_mix_frames(frames[k], frames[k + 1], share, position(t), angle(t)))
    return out


def _mix_frames(before: Frame, after: Frame, share: float, position: np.ndarray, angle: np.ndarray) -> Frame:
    """Frame between two others, with given positions and angles; `share` is 0 at the first and 1 at the second."""
    first, last, near = before.state, after.state, before if share < 0.5 else after

    def mix(a, b):
        return (1 - share) * a + share * b

    velocity, spin = (mix(getattr(first.grains, name), getattr(last.grains, name)) for name in ("velocity", "spin"))
    grains = near.state.grains._replace(position=position, angle=angle, velocity=velocity, spin=spin)
    cell = near.state.cell._replace(vectors=mix(first.cell.vectors, last.cell.vectors))
    walls = near.state.walls
    if first.walls.point.shape == last.walls.point.shape:
        walls = walls._replace(point=mix(first.walls.point, last.walls.point))
    state = near.state._replace(grains=grains, cell=cell, walls=walls, time=float(mix(first.time, last.time)))
    contacts = _mix_contacts(before, after, share, position)
    return Frame(state, near.law, near.grains, contacts, moving=True)


def _mix_contacts(before: Frame, after: Frame, share: float, position: np.ndarray) -> dict[str, np.ndarray]:
    """Contacts of two frames: their branch vectors at given positions, and weighted forces."""
    parts = []
    for frame, weight in ((before, 1 - share), (after, share)):
        c, n, shift = frame.contacts, len(position), position - frame.state.grains.position
        step = shift[c["i"]] - np.where((c["j"] < n)[:, None], shift[np.minimum(c["j"], n - 1)], 0.0)
        branch = c["branch"] + step
        long, stored = (np.linalg.norm(b, axis=1) for b in (branch, c["branch"]))
        force = weight * c.get("force_n", np.ones(len(c["i"])))
        key = np.column_stack([c["i"], c["j"], c.get("image", np.zeros(len(c["i"]), int))])
        kept = (long <= STRETCH * stored) & (weight > 0)
        parts.append([column[kept] for column in (key, branch, force, c["mode"], np.full(len(key), weight))])
    key, branch, force, mode, weight = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    _, rows, number = np.unique(key, axis=0, return_index=True, return_inverse=True)
    number, total = number.ravel(), np.zeros(len(rows))
    np.add.at(total, number, weight)
    mean = np.zeros((len(rows), 3))
    np.add.at(mean, number, weight[:, None] * branch)
    loads = np.bincount(number, force, minlength=len(rows))
    order = np.lexsort((weight, number))  # the mode is that of the nearer frame, the last of each group
    last = np.zeros(len(rows), int)
    last[number[order]] = order
    mean /= total[:, None]
    return {"i": key[rows, 0], "j": key[rows, 1], "mode": mode[last], "branch": mean, "force_n": loads}
