"""Pages and movies of packings: their content and their files; a page is one self-contained file.

In a run folder, they count as run files.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import __version__
from ..core.progress import Report, silent
from ..core.reading import read_arrays
from ..core.units import unit_name, with_unit
from ..data import archive
from ..data.exchange.files import capture_warnings, is_measured
from ..data.exchange.force_network import read_forces
from ..data.exchange.frame import Frame, frame_of, mode_frames, read_mode
from ..data.run_files import (
    FILM,
    PAGE,
    add_to_manifest,
    check_free,
    digest,
    find_foreign,
    read_manifest,
    replace_atomically,
    write_manifest,
)
from ..data.sample import Obstacle, with_one_account
from ..figures import animation as film
from ..figures import page, scene
from ..figures.analyses import enough_contacts, forces
from ..figures.grains import count_outside, layout_of, packing
from ..figures.style import render
from ..loading.reading import read_packing
from ..solve.balance import BALANCED_BELOW, imbalance, no_equilibrium_message
from ..solve.stability import DENSE_UP_TO, stability
from .packing import Settling, describe_law, find_birth_form, growing_modes, let_settle, likely_causes, verdict

SEARCHED = 30_000  # number of coordinates up to which the verdict takes about a minute and is computed by default
DRAWN = 2000  # number of grains up to which a packing and its forces are also drawn as figures
FORCES = "distribution, chains, strong network and directions of contact forces"
MODES = 6  # number of modes that a page animates
REMEDY = "Give the missing data, or settle the packing with --settle"
MARK_RANGE = 4096  # bytes at the beginning and end of a file that may contain the mark
HELP = (
    "Drag to rotate, scroll or pinch to zoom, drag with the right button to pan. Contacts across periodic boundaries "
    "extend out of the cell to the image of their second grain. Rotations are not drawn."
)


class PageContent(NamedTuple):
    """Content of the page for a run or a packing."""

    title: str
    about: str
    frames: list[Frame]
    labels: list[str]
    at: int  # index of the frame that `modes` belong to
    modes: list  # translation, rotation and exponent of each mode, fastest first
    sections: list[tuple[str, str]]  # heading and HTML, without the view
    without: str = ""  # reason why there is no view in three dimensions
    warning: str = ""  # prominent warning: no equilibrium, or a settled packing
    unjudged: str = ""  # reason why modes of the frame `at` are not instabilities: its forces do not balance
    verdict: str = ""  # sentence on the stability of a packing, if computed and in equilibrium
    stages: tuple[str, ...] = ()  # stage of each frame, for a run with stages
    source: str = "file"  # origin of the units of the frames
    decided: bool = True  # whether the verdict includes all actions on the grains


def packing_content(
    file: Path, *, modes: Path | None = None, options: dict, settle: bool = False,
    dashpots: bool = True, search: bool | None = True, zoom: scene.Zoom = 1.0, report: Report = silent,
) -> PageContent:  # fmt: skip
    """Load a packing file with `read_packing`, together with its verdict and modes.

    Parameters
    ----------
    modes : file written by `stickslip stability`; without it, the verdict is computed
    options : options of `read_packing`
    settle : if True, the packing is settled first
    dashpots : if False, dashpots of the law are ignored
    zoom : zoom of the figure
    search : if False and no file of modes is given, neither verdict nor modes are computed; None acts as False if they
        would take minutes
    """
    (state, law, notes), warnings = capture_warnings(read_packing, file, **options)
    notes, calm = [*notes, *warnings], None
    if settle:
        state, calm = let_settle(state, law)
        notes.append(f"settled: {calm.how}")
    n, facts = len(state.grains.radius), []
    why, warning, sentence = "", str(calm) if calm else "", ""
    large = search is None and n * (3 if state.cell.dim == 2 else 6) > SEARCHED
    if modes is None and search is not False and not large:
        try:
            result = stability(state, law, dashpots=dashpots, report=report)
        except ArithmeticError as problem:
            raise RuntimeError(f"the spectrum could not be computed ({problem}): give --modes") from None
        # modes of a packing out of equilibrium are not instabilities, so none is shown
        mine, facts = growing_modes(result)[:MODES] if result.balanced else [], _verdict_rows(result, calm, notes)
        if result.balanced:
            sentence = verdict(result, calm, notes)
            if mine and len(result.free) <= DENSE_UP_TO:
                form = find_birth_form(state, law, dashpots=dashpots)
                facts.append(["after the instability", form if isinstance(form, str) else form.verdict])
        else:
            why = verdict(result, None, notes)
            warning = f"{why}. Likely causes: {'; '.join(likely_causes(result, options, notes))}. {REMEDY}."
    else:
        mine = _read_modes(modes, n) if modes else []
        notes += [] if modes else ["the spectrum was not computed, so there is no verdict"]
        if large and not modes:
            warning = f"no verdict was computed, as it takes minutes for {n} grains: add --verdict. {warning}".strip()
        if not (rest := imbalance(state, law)) <= BALANCED_BELOW:
            why = warning = no_equilibrium_message(rest)
    frame = frame_of(state, law)
    facts = [["grains", str(n)], ["contacts", str(len(frame.contacts["i"]))], *facts, ["law", describe_law(law, state)]]
    facts += [["note", line] for line in notes]
    sections = [("Packing", page.table(["", "value"], facts))]
    if mine:
        sections.append(("Modes out of equilibrium: no verdict" if why else "Growing modes", _mode_table(mine)))
    if n <= DRAWN:
        drawn, caption = packing(state, law, mode=mine[0] if mine else None, zoom=zoom), "contacts"
        caption += ", and the fastest mode" if mine else ""
        sections.append(("Figure", page.pictures({caption: render(drawn)})))
        if enough_contacts(state, law):
            sections.append(("Contact forces", page.pictures({FORCES: render(forces(state, law))})))
    about = f"stickslip {__version__}, {archive.versions()}"
    return PageContent(
        file.name, about, [frame], [""], 0, mine, sections, warning=warning, unjudged=why, verdict=sentence,
        decided=not any(isinstance(note, Obstacle) for note in notes),
    )  # fmt: skip


def write_forces(file: Path, path: Path, options: dict) -> list[str]:
    """Write a figure of the contact forces in a packing as PDF, PNG or SVG; return notes on the input.

    Measured forces are drawn as read, without balancing; options of the law are then ignored.
    """
    contacts = options.get("contacts")
    if is_measured(file, contacts and Path(contacts)):
        source, law = read_forces(file, contacts, frame=options.get("frame")), None
        notes = [*with_one_account(source.notes), f"{file.name}: forces are drawn as measured, not balanced"]
    else:
        (source, law, notes), said = capture_warnings(read_packing, file, **options)
        notes = [*notes, *said]
        if not (rest := imbalance(source, law)) <= BALANCED_BELOW:
            notes.append(no_equilibrium_message(rest))
    drawn = forces(source, law)
    with staged_file(path) as part:
        part.write_bytes(render(drawn, path.suffix.lower().removeprefix(".")))
    return notes


def _read_modes(path: Path, n: int) -> list:
    first = read_mode(path, 0, n)  # checks the file
    count = len(read_arrays(path, remedy="write the modes again", names=("exponent",))["exponent"])
    return [first, *(read_mode(path, k, n) for k in range(1, min(MODES, count)))]


def _verdict_rows(result, calm: Settling | None, notes: list[str]) -> list[list[str]]:
    out = [["verdict", verdict(result, calm, notes)], ["method", result.way], ["rattlers", str(len(result.rattlers))]]
    out += [["without the dashpots", result.undamped.motion]] if result.undamped else []
    limit = f"at most {BALANCED_BELOW:g} in equilibrium"
    out.append(["residual", f"{result.residual:.2g} of the mean contact force; {limit}"])
    if result.grows and not result.balanced:
        out.append(["spectrum of the initial motion, no verdict", result.motion])
    return out + ([["scope", result.scope]] if result.scope else [])


def _mode_table(modes: list) -> str:
    rows = []
    for k, (*_, s) in enumerate(modes):
        period = f"{2 * np.pi / abs(s.imag):.5g}" if s.imag else "–"
        rows.append([str(k), f"{s.real:.5g}", f"{abs(s.imag):.5g}", period, f"{1 / s.real:.5g}" if s.real > 0 else "–"])
    kinds = {"growth rate": "1/time", "ω": "1/time", "period": "time", "e-folding time": "time"}
    columns = ["mode", *(f"{name} [{unit_name(unit)}]" for name, unit in kinds.items())]
    return page.table(columns, rows, classes=dict.fromkeys(columns, "number"))


def write_page(shown: PageContent, path: Path, *, colour: str | None = None, zoom: scene.Zoom = 1.0) -> None:
    """Write the page to a file."""
    view = ""
    if shown.frames:
        inside = scene.page_view(
            shown.frames, shown.modes, at=shown.at, labels=shown.labels, colour=colour, zoom=zoom
        )  # fmt: skip
        several = len(shown.frames) > 1
        if shown.modes:
            which = f" of the state at {shown.labels[shown.at]}" if several else ""
            sentences = [f"The view shows the fastest-growing mode{which}, enlarged so that it can be seen."]
        elif several:
            sentences = ["The view shows the run from its beginning: press play, or move the slider."]
        else:
            sentences = ["The view shows the packing."]
        sentences.append("Lines are contacts, wider for larger forces; blue ones stick, vermilion ones slide.")
        if any(frame.state.bonds for frame in shown.frames):
            sentences.append("Sand-coloured bands are bonds, and purple ones are broken.")
        view = page.paragraph(" ".join([*sentences, *(f"{note}." for note in notes_on_view(shown, zoom))]))
        view += page.embedded_document(inside, "the packing in three dimensions")
        view += page.paragraph(HELP, kind="soft")
    warning = shown.warning[:1].upper() + shown.warning[1:]
    view = (page.paragraph(warning, kind="warning") if warning else "") + view
    if shown.verdict:
        view = page.paragraph(shown.verdict[:1].upper() + shown.verdict[1:] + ".", kind="verdict") + view
    first = [("View", view)] if view else []
    text = page.page(shown.title, shown.about, [*first, *shown.sections])
    with staged_file(path) as part:
        part.write_bytes(text.encode())


def notes_on_view(shown: PageContent, zoom: scene.Zoom) -> list[str]:
    """Note on grains outside the initial view of a page, if there are any."""
    away = scene.count_out_of_view(shown.frames, zoom) if shown.frames else 0
    return [f"{scene.outside_words(away)}: zoom out to see {'it' if away == 1 else 'them'}"] if away else []


def describe_growth(s: complex) -> str:
    """Describe the growth rate and the period of a motion exp(s t)."""
    growth = (
        with_unit(f"grows by a factor of e in {1 / s.real:.4g}", "time")
        if s.real > 0
        else with_unit(f"growth rate {s.real:.3g}", "1/time")
    )
    return f"{with_unit(f'period {2 * np.pi / abs(s.imag):.4g}', 'time')}, {growth}" if s.imag else growth


def _run_frames(shown: PageContent, count: int, whole: bool) -> tuple[list[Frame], list[str]]:
    """Frames and labels of the movie of a run, from the first state of its last stage or of the whole run."""
    # the state with which the last stage begins
    first = 0 if whole else max((k for k, name in enumerate(shown.stages) if name != shown.stages[-1]), default=0)
    stored = shown.frames[first:]
    frames = film.frames_between(stored, count)
    times = [frame.state.time for frame in stored]
    if min(np.diff(times), default=0) <= 0:  # a load path: time does not advance
        at = first + np.linspace(0, len(stored) - 1, count).round().astype(int)
        return frames, [shown.labels[k] for k in at]
    out = []
    for t in (frame.state.time for frame in frames):  # the first state of a stage is the last one of the previous stage
        stage = (
            shown.stages[first + min(max(1, int(np.searchsorted(times, t))), len(times) - 1)] if shown.stages else ""
        )
        time = with_unit(f"time {t:.4g}", "time", unnamed=f"in units of the {shown.source}")
        out.append((f"{stage}, " if stage else "") + time)
    return frames, out


def write_movie(
    shown: PageContent, path: Path, *, colour: str | None = None, fps: int = film.FPS, count: int = 48,
    amplitude: float = 0.3, mode: int | None = None, whole: bool = False, zoom: scene.Zoom = 1.0, slides: bool = False,
    report: Report = silent,
) -> list[str]:  # fmt: skip
    """Write the frames of a run, or one period of a mode, as a GIF or MP4; return notes on grains outside the view.

    Parameters
    ----------
    colour : one of `quantities`; by default the speed for a run and the displacement for a mode
    mode : number of a mode; None shows the frames of a run, or the first mode if there is only one frame
    fps : frames per second
    count, amplitude : number of frames in one period of a mode, and its amplitude; see `mode_frames`
    whole : True to show all stages of a run, instead of only the last
    zoom, slides : see `stickslip.figures.movie`
    """
    if not shown.frames:
        raise ValueError(f"there are no frames for a movie: {shown.without}")
    if mode is None and len(shown.frames) == 1:
        mode = 0
    if mode is None:
        frames, labels = _run_frames(shown, round(fps * film.SECONDS), whole)
        chosen = None
    else:
        if not 0 <= mode < len(shown.modes):
            has = f"has 0 to {len(shown.modes) - 1}" if shown.modes else "is stable or has no growing mode"
            if not (shown.modes or shown.verdict or shown.unjudged):
                has = "was not searched for modes"
            if shown.unjudged:
                has = f"is {shown.unjudged}; {REMEDY.lower()}"
            elif shown.warning:
                has += f" ({shown.warning})"
            raise ValueError(f"there is no mode {mode}: {shown.title} {has}")
        chosen = shown.modes[mode]
        frames = mode_frames(shown.frames[shown.at], *chosen, count=count, amplitude=amplitude)
        note = "; NOT IN EQUILIBRIUM" if shown.unjudged else "; settled packing" if shown.warning else ""
        labels = [f"mode {mode}, enlarged: {describe_growth(chosen[2])}{note}"] * len(frames)
    colour = colour or ("speed" if mode is None else scene.DISPLACEMENT)
    with staged_file(path) as part:
        film.movie(
            frames, part, labels=labels, mode=chosen, colour=colour, fps=fps, zoom=zoom, slides=slides, report=report
        )
    away = count_outside(frames, layout_of(frames, zoom=zoom))
    return [f"{scene.outside_words(away)}: --zoom all shows every grain"] if away else []


def default_path(place: Path, name: str) -> Path:
    """Default output path: inside the run folder if there is one, otherwise in the current directory."""
    return place / name if place.is_dir() else Path(f"{place.stem}-{name}")


def check_output(path: Path, endings: tuple[str, ...], *, overwrite: bool = False, made_from=()) -> None:
    """Raise ValueError before any computation if an output path is unsuitable or names a file that must be kept.

    Parameters
    ----------
    overwrite : whether any existing file may be replaced; pages and movies of this package may always be replaced
    made_from : files that are never replaced
    """
    if path.suffix.lower() not in endings:
        raise ValueError(f"--out must end with {' or '.join(endings)}, got {path}")
    if not path.parent.is_dir():
        raise ValueError(f"{path.parent} is not a folder: create it first, or give another --out")
    belongs = _belongs_to_run(path)
    if belongs and not overwrite and find_foreign(path.parent, lambda name: name == path.name):
        raise ValueError(
            f"{path} was not written by stickslip or has changed since: give another --out, or add --overwrite"
        )
    check_free([path], overwrite=overwrite or belongs or _is_own_file(path), made_from=made_from)


@contextmanager
def staged_file(path: Path) -> Iterator[Path]:
    """Context manager for a temporary file that replaces a page or movie.

    A page or movie in a run folder is replaced or removed by the next run.
    """
    with replace_atomically(path) as part:
        yield part
        if _belongs_to_run(path):  # recorded before it exists, so that a killed process does not leave an unknown file
            manifest = read_manifest(path.parent)
            write_manifest(path.parent, manifest | {path.name: [*manifest.get(path.name, []), digest(part)]})
    if _belongs_to_run(path):
        add_to_manifest(path.parent, path.name)


def _is_own_file(path: Path) -> bool:
    """Return True for a page or movie written by this package, recognised by a mark near its beginning or end."""
    if path.is_symlink() or not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(MARK_RANGE)
        file.seek(max(0, path.stat().st_size - MARK_RANGE))
        return page.MARK.encode() in head + file.read(MARK_RANGE)


def _belongs_to_run(path: Path) -> bool:
    return path.name in (PAGE, FILM) and bool(read_manifest(path.parent))
