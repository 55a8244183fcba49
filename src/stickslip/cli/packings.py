"""Commands that read a packing: stability, conversion, reports with a three-dimensional view, and movies."""

import sys
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from .. import reports, runs
from ..builtin_laws import BUILTIN_LAWS
from ..data.run_files import FILM, PAGE
from ..known import with_keys
from .app import Output, OverwriteFile, Slides, Trust, command, examples, finish, numbers_by_name

LAWS = {law.name: law.words for law in BUILTIN_LAWS}
COULOMB = {"smooth": "friction approaches its limit", "sharp": "friction is truncated at its limit"}
DAMPING = {
    "velocity": "by velocity", "mass_velocity": "by mass and velocity", "viscoelastic": "also by overlap",
    "tsuji": "for a restitution", "coeff_restitution": "for a restitution, exactly",
}  # fmt: skip
METHODS = {
    "auto": "by the number of grains", "fastest": "only the fastest growth", "all": "all complex pairs, cheapest way",
    "certify": "also certify real eigenvalues", "dense": "all eigenvalues", "pairs": "all complex pairs",
}  # fmt: skip
NO_VERDICT = 3  # exit code if there is no verdict
PackingFile = Annotated[
    Path, typer.Argument(help="A packing in any format (stickslip docs exchange), or a LAMMPS run folder.")
]
Dashpots = Annotated[
    bool, typer.Option("--dashpots/--no-dashpots", help="Include the dashpots of the law, or leave them out.")
]
REMEDY = (
    "give the missing data, or let the packing come to rest with --settle; the result then refers to the settled "
    "packing"
)
BARE = (
    "for a verdict, give the law (--law, --kn, --kt, --mu) and the memory of contacts: a LAMMPS run folder with a "
    "restart file, or --contacts; --settle finds an equilibrium near this one, without its history"
)
STABILITY = examples(
    ("stability examples/sheared_spheres.npz", "verdict and pairs; writes modes to sheared_spheres-modes.npz"),
    ("stability examples/sheared_spheres.npz --modes modes.npz --json", "one JSON object, and modes in a file"),
    ("stability examples/sheared_spheres.npz --after", "bursts or runaway, and the contact that is lost first"),
    (
        "stability examples/sheared_spheres.npz --position-error 1e-4",
        "probability of the verdict, and the decisive contact",
    ),
    ("stability examples/sheared_spheres.npz --more", "moduli, transient growth, decisive contacts"),
    (
        "stability examples/sheared_spheres.npz --coulomb sharp --settle -q",
        "only the verdict, at rest under another law",
    ),
    (
        "stability examples/measured_disks.csv \\\n      --contacts examples/measured_forces.csv --mu 0.3",
        "measured forces: the nearest balanced state",
    ),
    ("stability examples/sheared_spheres.npz --fastest", "the fastest pair, and bounds on the others"),
)
CONVERT = examples(
    ("convert examples/sheared_spheres.npz --to packing.data", "for LAMMPS, contacts in a second file"),
    ("convert examples/sheared_spheres.npz --to packing.gsd", "for OVITO; needs the exchange extra"),
    ("convert examples/sheared_spheres.npz --to m.gsd --modes modes.npz", "animate the mode that `stability` found"),
)


class PackingOptions(NamedTuple):
    """Options of all commands that read a packing; see `read_packing`."""

    law: Annotated[
        str | None,
        f"{', '.join(law.name for law in BUILTIN_LAWS if not law.rescales)} (hertz_mindlin and "
        "hertz_mindlin_reff also …_rescaled) or your own Python file; takes precedence over the law in FILE.",
        LAWS,
    ] = None
    coulomb: Annotated[str | None, "smooth or sharp.", COULOMB] = None
    kn: Annotated[float | None, "Normal stiffness."] = None
    kt: Annotated[float | None, "Tangential stiffness."] = None
    mu: Annotated[float | None, "Friction coefficient."] = None
    young: Annotated[float | None, "Young's modulus, with --poisson instead of --kn, --kt."] = None
    poisson: Annotated[float | None, "Poisson's ratio."] = None
    damping: Annotated[str | None, "velocity, mass_velocity, viscoelastic, tsuji or coeff_restitution.", DAMPING] = None
    damping_n: Annotated[float | None, "Coefficient of the normal dashpots."] = None
    damping_t: Annotated[float | None, "Coefficient of the tangential dashpots."] = None
    parameter: Annotated[list[str] | None, "Another parameter of the law, such as work=1e-3 for jkr; repeatable."] = (
        None
    )
    i0: Annotated[float | None, "I0 in the moment of inertia I0 m R²: 0.4 for spheres."] = None
    frame: Annotated[str | None, "State to read from an archive, GSD file or dump."] = None
    contacts: Annotated[Path | None, "LAMMPS `dump local` with contact forces, or a table of measured forces."] = None
    columns: Annotated[str | None, 'Columns of --contacts: "i j dist … tx ty tz".'] = None
    boundary: Annotated[str | None, "Boundaries as in LAMMPS, e.g. ppf, if not given in the file."] = None
    atom_style: Annotated[str | None, "Atom style, such as sphere, if a LAMMPS data file does not name it."] = None

    def values(self) -> dict:
        """Options as keyword arguments of `read_packing`."""
        values = self._asdict()
        return values | {"parameters": numbers_by_name(values.pop("parameter"))}


def in_units_of_packing(command):
    """Make a command print in the units of its packing."""

    @wraps(command)
    def call(**given):
        from ..core.units import units_in_use
        from ..data.exchange.files import packing_units

        with units_in_use(packing_units(given.get("file") or given["place"])):
            return command(**given)

    return call


class MethodOptions(NamedTuple):
    """Options that select the eigenvalues to compute, and the method."""

    method: Annotated[str, "auto, fastest, all, certify, dense or pairs.", METHODS] = "auto"
    fastest: Annotated[bool, "Find the fastest-growing pair only."] = False
    every: Annotated[bool, typer.Option("--all", help="Find all complex pairs.")] = False
    certify: Annotated[bool, "Also certify the real eigenvalues; reports the estimated time first."] = False

    def name(self, default: str) -> str:
        """Name of the requested method, or else the default."""
        flags = (("fastest", self.fastest), ("all", self.every), ("certify", self.certify))
        asked = [name for name, on in flags if on] + [self.method] * (self.method != "auto")
        if len(asked) > 1:
            raise ValueError("--fastest, --all, --certify and --method exclude each other: choose one")
        return asked[0] if asked else default


@command(epilog=STABILITY)
@in_units_of_packing
def stability(
    *,
    file: PackingFile,
    search: MethodOptions,
    settle: Annotated[bool, "First let it come to rest under this law; analyse that state."] = False,
    modes: Annotated[
        Path | None, "Output file for modes; default: FILE's name with -modes.npz, in this folder; none with --json."
    ] = None,
    matrices: Annotated[
        str | None,
        typer.Option(metavar="<path>", help="Also write J, C and M: NAME.npz, or a folder for Matrix Market files."),
    ] = None,
    beyond: Annotated[
        bool, typer.Option("--more", help="Also elastic moduli, transient growth, decisive contacts.")
    ] = False,
    after: Annotated[bool, "Also the course of the instability: bursts, or a lost contact."] = False,
    position_error: Annotated[
        float | None, "Also the probability of the verdict for this error of positions, in radii."
    ] = None,
    dashpots: Dashpots = True,
    output: Output,
    options: PackingOptions,
) -> None:
    """Is this packing stable? Complex pairs, buckling, floppy modes and rattlers of any packing.

    For cemented grains, it also finds decisive bonds, and the first to break under growing strains, by linear response.

    Only an equilibrium is analysed: forces must balance to within 0.002 of the mean contact force. A search in more
    than 15,000 spheres takes minutes. It is saved in this folder as FILE-search.npz, and the same command continues it.
    Exit codes: 0 stable or unstable, 1 analysis or settling failed, 2 bad input, 3 no verdict: not in equilibrium, or
    undecided.
    """
    from ..core.text import printable
    from ..data.exchange.files import capture_warnings
    from ..loading.reading import read_packing
    from ..solve.freedom import equations_of_motion
    from ..solve.linear import FACTORS_UP_TO
    from ..solve.stability import DENSE_UP_TO
    from ..solve.stability import stability as analyse

    method = search.name("all" if modes else "auto")
    named = file if file.name.strip(".") else file.resolve()  # . and .. have no names
    shapes = modes or Path(f"{named.stem}-modes.npz")
    if modes or not output.as_json:
        reports.packing.check_modes(shapes, file, asked=modes is not None)
    if matrices is not None:
        from ..data.exchange.frame import check_name, write_matrices

        if not matrices:
            raise ValueError("--matrices has no name: give NAME.npz, or a folder")
        check_name(Path(matrices))
        if Path(matrices).absolute() == shapes.absolute():
            raise ValueError(f"--matrices and --modes name the same file {shapes}: give different names")
    with reports.terminal.console_output(*output):
        with reports.terminal.progress(transient=True) as tell:
            (state, its_law, notes), said = capture_warnings(read_packing, file, **options.values())
            notes, calm = [*notes, *said], None
            if settle:
                state, calm = reports.packing.let_settle(state, its_law)
                notes.append(f"settled: {calm.how}")
            written = []
            if matrices:
                motion = equations_of_motion(state, its_law)
                c = motion.damping if dashpots else type(motion.damping)(motion.damping.shape)
                written = write_matrices(matrices, motion._replace(damping=c))
        large = 6 * len(state.grains.radius) > FACTORS_UP_TO
        with reports.terminal.progress(transient=not large) as tell:
            saved = Path(f"{named.stem}-search.npz") if large else None
            if saved and saved.exists():
                reports.terminal.console.print(
                    f"{saved}: the search saved there is continued if it belongs to this packing"
                )
            result = analyse(state, its_law, method=method, dashpots=dashpots, saved=saved, report=tell)
            parts: dict = {"calm": calm}
            if beyond or (file.is_dir() and result.grows and result.balanced and len(result.free) <= DENSE_UP_TO):
                parts["more"] = reports.details.compute_details(state, its_law, result, report=tell)
            if state.bonds and result.balanced:
                parts["bonds"] = reports.details.compute_bonds(state, its_law)
            if after:
                parts["form"] = reports.packing.find_birth_form(state, its_law, dashpots=dashpots)
            sure = position_error is not None and reports.packing.find_probability(
                state, its_law, position_error, dashpots=dashpots, report=tell
            )
        if not result.balanced:
            parts["why"] = reports.packing.likely_causes(result, options.values(), notes)
        if reports.packing.missing_parts(notes):
            parts["shape"] = reports.packing.geometry(state)
        paths = written
        if modes or (not output.as_json and result.balanced and result.modes.shape[1]):
            paths = [reports.packing.write_modes(shapes, result), *written]
    if output.as_json:
        for line in notes:
            print(printable(f"stickslip: {line}"), file=sys.stderr)
        about = {"notes": notes, "verdict": reports.packing.verdict(result, calm, notes)}
        if sure:
            about |= {"position_error": reports.packing.probability_dict(sure)}
        runs.json_output.show("stability", about | reports.packing.to_dict(result, notes=notes, **parts), files=paths)
    elif output.quiet:
        print(printable(reports.packing.verdict(result, calm, notes)))
    else:
        remedy = "" if settle else BARE if "shape" in parts else REMEDY
        reports.packing.show(result, its_law, notes, remedy=remedy, state=state, **parts)
        if sure:
            reports.packing.show_probability(sure)
        if paths:
            reports.terminal.show_paths(paths)
    if reports.packing.is_stable(result, notes) is None:
        raise typer.Exit(NO_VERDICT)


@command(epilog=CONVERT)
@in_units_of_packing
def convert(
    *,
    file: PackingFile,
    to: Annotated[Path, "Output file: .gsd, .vtu, .xyz, .data, .csv, .graphml, .npz or .h5."],
    modes: Annotated[Path | None, "Animate a mode that `stability` wrote."] = None,
    mode: Annotated[int, typer.Option(min=0, metavar="N", help="Number of the mode, fastest first.")] = 0,
    frames: Annotated[int, typer.Option(min=2, metavar="N", help="Frames per period.")] = 48,
    amplitude: Annotated[float, "Largest displacement over the radius."] = 0.3,
    grow: Annotated[bool, "Include the growth of the mode."] = False,
    overwrite: OverwriteFile = False,
    output: Output,
    options: PackingOptions,
) -> None:
    """Write a packing for OVITO, ParaView, ASE or LAMMPS; with --modes, the animation of a mode."""
    from ..data.exchange.files import capture_warnings
    from ..data.sample import account_of
    from ..loading.reading import convert

    with reports.terminal.console_output(*output):
        (paths, notes), said = capture_warnings(
            convert, file, to, modes=modes, mode=mode, count=frames, amplitude=amplitude, grow=grow,
            overwrite=overwrite, **options.values(),
        )  # fmt: skip
    notes = [*notes, *said]
    _finish_with_notes("convert", paths, {"notes": notes, "met": with_keys(account_of(notes))}, output)


def _finish_with_notes(command: str, paths: list[Path], fields: dict, output: Output) -> None:
    """Print the result of a command; `fields` contains notes and possibly a verdict."""

    def show() -> None:
        if sentence := fields.get("verdict"):
            reports.terminal.console.print(sentence)
        for line in fields["notes"]:
            reports.terminal.console.print(line, style="yellow")

    finish(lambda: runs.json_output.common_fields(command, files=paths) | fields, paths, show, output)


REPORT = examples(
    ("report examples/sheared_spheres.npz", "sheared_spheres-report.html, with the unstable mode animated"),
    ("run examples/rate_state.toml --out results/rate-state", "any run"),
    ("report results/rate-state", "measures, figures and scenario: results/rate-state/report.html"),
    (
        "report examples/measured_disks.csv \\\n      --contacts examples/measured_forces.csv --out forces.pdf",
        "distribution of forces, chains, strong network, anisotropies",
    ),
)
MOVIE = examples(
    ("movie examples/sheared_spheres.npz --out packing.gif", "its fastest mode; .mp4 needs the mp4 extra"),
    ("run examples/column_collapse.toml --out results/column", "a flow: a minute or two"),
    ("movie results/column --colour speed", "results/column/movie.gif"),
)
Place = Annotated[Path, typer.Argument(help="A run folder, or a packing in any format that `stability` reads.")]


class ViewOptions(NamedTuple):
    """Options for the content of a report or a movie."""

    modes: Annotated[Path | None, "Modes that `stability` wrote; default: computed."] = None
    settle: Annotated[bool, "Let a packing come to equilibrium first."] = False
    colour: Annotated[
        str | None, "Quantity shown by the colour of grains; default in a movie: speed, or displacement."
    ] = None
    zoom: Annotated[
        str | None,
        typer.Option(
            metavar="<float>|all", help="Enlarge the view on the grains, or show all, even if they rolled away."
        ),
    ] = None
    trust: Trust = False

    def enlargement(self):
        """Zoom of figures; raise ValueError if it is not allowed."""
        from ..core.text import parse_number
        from ..figures.scene import check_zoom

        zoom = "1" if self.zoom is None else self.zoom
        with suppress(ValueError):
            zoom = parse_number(zoom)
        check_zoom("--zoom", zoom)
        return zoom


@command(epilog=REPORT)
@in_units_of_packing
def report(
    *,
    place: Place,
    out: Annotated[
        Path | None,
        "Output file, by default report.html in the run, or FILE-report.html; .pdf, .png, .svg: forces only.",
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
    """Write a self-contained HTML page: claims or measures, figures, and the packing in three dimensions.

    With --out NAME.pdf, .png or .svg, write only the figure of the contact forces in a packing, or of measured forces:
    their distribution, force chains, the strong network, and the anisotropies of contacts and forces.
    """
    from ..figures.style import FORMATS

    path, zoom = out or reports.page.default_path(place, PAGE), view.enlargement()
    figures = tuple(f".{kind}" for kind in FORMATS)
    made_from = _input_files(place, view, options)
    reports.page.check_output(path, (".html", ".htm", *figures), overwrite=overwrite, made_from=made_from)
    if path.suffix.lower() in figures:
        _check_figure(path, place if runs.page.is_run(place) else None, view, verdict)
        with reports.terminal.console_output(*output):
            notes = reports.page.write_forces(place, path, options.values())
        _finish_with_notes("report", [path], {"verdict": None, "notes": notes}, output)
        return
    with reports.terminal.console_output(*output), reports.terminal.progress(transient=True) as tell:
        content = runs.page.load_content(
            place, modes=view.modes, options=options.values(), settle=view.settle, dashpots=dashpots, report=tell,
            search=verdict, trust=view.trust, zoom=zoom,
        )  # fmt: skip
        reports.page.write_page(content, path, colour=view.colour, zoom=zoom)
    notes = [content.warning] if content.warning else []
    notes += reports.page.notes_on_view(content, zoom)
    _finish_with_notes("report", [path], {"verdict": content.verdict or None, "notes": notes}, output)


def _check_figure(path: Path, folder: Path | None, view: ViewOptions, verdict: bool | None) -> None:
    """Raise ValueError for a run folder, or for options that the figure of contact forces does not use."""
    if folder is not None:
        raise ValueError(f"{folder} is a run folder, for which --out must end in .html, got {path}")
    asked = {"modes": view.modes, "settle": view.settle or None, "colour": view.colour, "zoom": view.zoom}
    asked["verdict"] = verdict
    if given := [name for name, value in asked.items() if value is not None]:
        raise ValueError(f"--{given[0]} has no effect on --out {path}, which shows contact forces only: use .html")


class FilmOptions(NamedTuple):
    """Options of a movie."""

    mode: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="Number of the mode, 0 for the fastest; default: the run itself, or mode 0 of a packing.",
        ),
    ] = None
    fps: Annotated[int, typer.Option(metavar="N", help="Frames per second; the movie of a run lasts 8 s.")] = 25
    whole: Annotated[bool, "Show all stages of a run; default: the last one."] = False
    frames: Annotated[int, typer.Option(min=2, metavar="N", help="Frames per period of a mode.")] = 48
    amplitude: Annotated[float, "Largest displacement over the radius."] = 0.3
    slides: Slides = False


@command(epilog=MOVIE)
@in_units_of_packing
def movie(
    *,
    place: Place,
    out: Annotated[
        Path | None, ".gif or .mp4; default: movie.gif in the run, or FILE-movie.gif in the current folder."
    ] = None,
    view: ViewOptions,
    film: FilmOptions,
    overwrite: OverwriteFile = False,
    output: Output,
    options: PackingOptions,
) -> None:
    """Write a movie of a run, or of a mode of a packing, as GIF or MP4."""
    path, zoom = out or reports.page.default_path(place, FILM), view.enlargement()
    reports.page.check_output(
        path, reports.page.film.ENDINGS, overwrite=overwrite, made_from=_input_files(place, view, options)
    )
    reports.page.film.check_movie(path, film.fps)
    with reports.terminal.console_output(*output), reports.terminal.progress(transient=True) as tell:
        content = runs.page.load_content(
            place, modes=view.modes, options=options.values(), settle=view.settle, report=tell,
            search=film.mode is not None or not runs.page.is_run(place), trust=view.trust,
        )  # fmt: skip
        away = reports.page.write_movie(
            content, path, colour=view.colour, fps=film.fps, count=film.frames, amplitude=film.amplitude,
            mode=film.mode, whole=film.whole, zoom=zoom, slides=film.slides, report=tell,
        )  # fmt: skip
    notes = [*([content.warning] if content.warning else []), *away]
    notes += [content.verdict] if content.verdict and not content.decided else []
    _finish_with_notes("movie", [path], {"notes": notes}, output)


def _input_files(place: Path, view: ViewOptions, options: PackingOptions) -> tuple:
    """Files that a command reads."""
    return place, view.modes, options.contacts, options.law
