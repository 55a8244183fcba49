"""Commands for reports with a three-dimensional view, and for movies."""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from .app import Output, OverwriteFile, Trust, command, examples, finish, number_option
from .packings import Dashpots, PackingOptions, in_units_of_packing

REPORT = examples(
    ("report examples/sheared_spheres.npz", "sheared_spheres-report.html, with the unstable mode animated"),
    ("run examples/rate_state.toml --out results/rate-state", "any run"),
    ("report results/rate-state", "measures, figures and scenario: results/rate-state/report.html"),
)
MOVIE = examples(
    ("movie examples/sheared_spheres.npz --out packing.gif", "its fastest mode; .mp4 needs the mp4 extra"),
    ("run examples/column_collapse.toml --out results/column", "a flow: a minute or two"),
    ("movie results/column --colour speed", "results/column/movie.gif"),
)
Place = Annotated[Path, typer.Argument(help="The folder of a run, or a packing in any format that `stability` reads.")]


class ViewOptions(NamedTuple):
    """Options of what is shown, in a report or a movie."""

    modes: Annotated[Path | None, typer.Option("--modes", help="Modes that `stability` wrote; default: computed.")] = (
        None
    )
    settle: Annotated[bool, typer.Option("--settle", help="Let a packing come to equilibrium first.")] = False
    colour: Annotated[
        str | None,
        typer.Option("--colour", help="Quantity that colours the grains; default of a movie: speed, or displacement."),
    ] = None
    trust: Trust = False


@command(epilog=REPORT, short_help="Write an HTML report on a run or a packing.")
@in_units_of_packing
def report(
    *,
    place: Place,
    out: Annotated[
        Path | None, typer.Option("--out", help="Output file; default: report.html in the run, or FILE-report.html.")
    ] = None,
    view: ViewOptions,
    verdict: Annotated[
        bool | None,
        typer.Option(
            "--verdict/--no-verdict", help="With verdict and modes; default: up to about 5000 spheres or 10,000 disks."
        ),
    ] = None,
    dashpots: Dashpots = True,
    overwrite: OverwriteFile = False,
    output: Output,
    options: PackingOptions,
) -> None:
    """Write a self-contained HTML page: claims or measures, figures, the packing in three dimensions."""
    from ..data.run_files import PAGE
    from ..reports import output_file as look_out
    from ..reports import terminal
    from ..runs import json_output
    from ..runs import page as look

    path = out or look_out.default_path(place, PAGE)
    look_out.check_output(path, (".html", ".htm"), overwrite=overwrite, made_from=_input_files(place, view, options))
    with terminal.console_output(*output), terminal.progress(transient=True) as tell:
        content = look.load_content(
            place, modes=view.modes, options=options.values(), settle=view.settle, dashpots=dashpots, report=tell,
            search=verdict, trust=view.trust,
        )  # fmt: skip
        look.write_page(content, path, colour=view.colour)
    notes = [content.warning] if content.warning else []

    def show() -> None:
        if content.verdict:
            terminal.console.print(content.verdict)
        for line in notes:
            terminal.console.print(line, style="yellow")

    def as_object() -> dict:
        return json_output.common_fields("report", files=[path]) | {"verdict": content.verdict or None, "notes": notes}

    finish(as_object, [path], show, output)


class FilmOptions(NamedTuple):
    """Options of a movie."""

    mode: Annotated[
        int | None,
        typer.Option(
            "--mode",
            min=0,
            metavar="N",
            help="Number of the mode, 0 for the fastest; default: the run, or mode 0 of a packing.",
        ),
    ] = None
    fps: Annotated[int, typer.Option("--fps", metavar="N", help="Frames per second; the movie of a run lasts 8 s.")] = (
        25
    )
    whole: Annotated[bool, typer.Option("--whole", help="Film all stages of a run; default: the last.")] = False
    frames: Annotated[int, typer.Option("--frames", min=2, metavar="N", help="Frames per period of a mode.")] = 48
    amplitude: Annotated[float, number_option("--amplitude", help="Largest displacement over the radius.")] = 0.3


@command(epilog=MOVIE, short_help="Write a movie of a run or a mode, GIF or MP4.")
@in_units_of_packing
def movie(
    *,
    place: Place,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help=".gif or .mp4; default: movie.gif in the run, or FILE-movie.gif in the current folder."
        ),
    ] = None,
    view: ViewOptions,
    film: FilmOptions,
    overwrite: OverwriteFile = False,
    output: Output,
    options: PackingOptions,
) -> None:
    """Write a movie of a run, or of a mode of a packing, as GIF or MP4."""
    from ..data.run_files import FILM
    from ..reports import output_file as look_out
    from ..reports import terminal
    from ..runs import json_output
    from ..runs import page as look

    path = out or look_out.default_path(place, FILM)
    look_out.check_output(path, look.film.ENDINGS, overwrite=overwrite, made_from=_input_files(place, view, options))
    look.film.check_movie(path, film.fps)
    with terminal.console_output(*output), terminal.progress(transient=True) as tell:
        content = look.load_content(
            place, modes=view.modes, options=options.values(), settle=view.settle, report=tell,
            search=film.mode is not None or not look.is_run(place), trust=view.trust,
        )  # fmt: skip
        look.write_movie(
            content, path, colour=view.colour, fps=film.fps, count=film.frames, amplitude=film.amplitude,
            mode=film.mode, whole=film.whole, report=tell,
        )  # fmt: skip
    notes = [content.warning] if content.warning else []
    notes += [content.verdict] if content.verdict and not content.decided else []

    def show() -> None:
        for line in notes:
            terminal.console.print(line, style="yellow")

    def fields() -> dict:
        return json_output.common_fields("movie", files=[path]) | {"notes": notes}

    finish(fields, [path], show, output)


def _input_files(place: Path, view: ViewOptions, options: PackingOptions) -> tuple:
    """Input files of a command."""
    return place, view.modes, options.contacts, options.law
