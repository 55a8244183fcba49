"""The command line: thin; every command calls one function of the layer below and shows what came back."""

import errno
import sys
from contextlib import contextmanager
from functools import wraps
from importlib import import_module
from inspect import Signature, signature
from pathlib import Path
from typing import Annotated

import typer

from . import __version__
from .extras import MissingExtraError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="A laboratory for frictional grains: build them, load them, know when and how they will slip.",
)

LONGEST = 1000  # characters of a sentence
STOPPED = 130  # what shells expect of a process that ctrl-C ended

Out = Annotated[Path | None, typer.Option("--out", help="Folder for results; made if it does not exist.")]
Workers = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes of independent runs, threads of a flow; default: all.")
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", help="Address or JSON file of a Dask scheduler that runs them instead.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace results of another scenario in the folder.")]


def _packing(
    law: Annotated[
        str | None,
        typer.Option(help="hertz_mindlin, linear, hertz_mindlin_reff or a Python file of yours; wins over the file."),
    ] = None,
    coulomb: Annotated[str | None, typer.Option(help="smooth or sharp.")] = None,
    kn: Annotated[float | None, typer.Option(help="Normal stiffness.")] = None,
    kt: Annotated[float | None, typer.Option(help="Tangential stiffness.")] = None,
    mu: Annotated[float | None, typer.Option(help="Friction coefficient.")] = None,
    young: Annotated[float | None, typer.Option(help="Young's modulus, with --poisson instead of --kn, --kt.")] = None,
    poisson: Annotated[float | None, typer.Option(help="Poisson's ratio.")] = None,
    damping: Annotated[str | None, typer.Option(help="velocity, mass_velocity or viscoelastic.")] = None,
    damping_n: Annotated[float | None, typer.Option(help="Coefficient of the normal dashpots.")] = None,
    damping_t: Annotated[float | None, typer.Option(help="Coefficient of the tangential dashpots.")] = None,
    i0: Annotated[float | None, typer.Option(help="Moment of inertia I0 m R²: 0.4 for spheres.")] = None,
    frame: Annotated[str | None, typer.Option(help="Which state of an archive, GSD file or dump.")] = None,
    contacts: Annotated[Path | None, typer.Option(help="LAMMPS's `dump local` with the forces of contacts.")] = None,
    columns: Annotated[str | None, typer.Option(help='Names of its columns: "i j dist … tx ty tz".')] = None,
    boundary: Annotated[str | None, typer.Option(help="As in LAMMPS, ppf, where the file does not say.")] = None,
):
    """Options of every command that reads a packing; see `read_sample`."""


def _reads_packing(command):
    """Give a command the options of `_packing`, which reach it as one dictionary called `options`."""
    own, more = (list(signature(f).parameters.values()) for f in (command, _packing))
    names = [parameter.name for parameter in more]

    @wraps(command)
    def called(**given):
        options = {name: given.pop(name) for name in names}
        return command(**given, options=options)

    del called.__wrapped__
    called.__signature__ = Signature([*(p for p in own if p.name != "options"), *more])
    called.__annotations__ = {p.name: p.annotation for p in called.__signature__.parameters.values()}
    return called


def _version(wanted: bool) -> None:
    if wanted:
        print(f"stickslip {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


@app.command()
def reproduce(
    experiment: Annotated[str, typer.Argument(help="Which paper: disk-array, sphere-shear, quasi-rigid or gouge.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer realizations and shorter runs; says what it cuts.")
    ] = False,
    out: Out = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of all random velocities.")] = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
) -> None:
    """Run a paper's experiment end to end: figures, an animation, raw numbers and the claims table."""
    from .experiments import report
    from .experiments.rooms import PAPERS

    _one_of("experiment", experiment, list(PAPERS))
    spread = _spread(workers, scheduler)
    paper = _room(PAPERS[experiment])
    folder = out or Path("results") / (experiment + ("-quick" if quick else ""))
    chosen = paper.paper_scenario(quick=quick, seed=seed)
    report.claim_folder(folder, chosen, overwrite=overwrite)
    report.begin_reproduction(folder, chosen, experiment=experiment, quick=quick, seed=seed)
    _reproduced(folder, spread, experiment=experiment, quick=quick, seed=seed)


def _reproduced(folder: Path, spread, *, experiment: str, quick: bool, seed: int) -> None:
    """Run a paper's experiment in a folder, or what is left of it."""
    from .experiments import report
    from .experiments.rooms import PAPERS, REPORTS

    paper, its_report = _room(PAPERS[experiment]), _room(REPORTS[experiment])
    if quick:
        report.console.print(f"--quick cuts: {paper.CUTS}.")
    with _working(), report.progress() as tell:
        found = paper.reproduce(quick=quick, seed=seed, folder=folder, workers=spread, report=tell)
        tell("figures", 0.0, str(folder))
        paths = its_report.write_reproduction(folder, found)
    report.show_claims(found.claims)
    report.show_paths(paths)


@app.command()
def run(
    scenario: Annotated[Path, typer.Argument(help="A scenario in TOML, such as examples/disk_array.toml.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for results; made if it does not exist.")],
    engine: Annotated[str | None, typer.Option("--engine", help="stickslip or lammps, of fault gouge.")] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    yes: Annotated[bool, typer.Option("--yes", help="Run a sweep of however many members.")] = False,
    figures: Annotated[bool, typer.Option("--figures", help="Draw figures of every member of a sweep.")] = False,
) -> None:
    """Run your own scenario, or with a table [sweep] many: arrays, packings, tests, flows, gouge, sliders."""
    from .data.kept import SWEEP
    from .data.scenario import scenario as judged
    from .data.scenario import tables_of
    from .experiments import report

    tables = tables_of(scenario)
    if "sweep" in tables:
        return _sweep(_swept(tables, engine), out, _spread(workers, scheduler), overwrite, yes, figures)
    chosen = judged(**tables)
    if engine is not None:
        chosen = _with_engine(chosen, engine)
    if (out / SWEEP).exists():
        raise ValueError(f"{out} holds the results of a sweep: choose another --out")
    spread = _spread(workers, scheduler, chosen)
    report.claim_folder(out, chosen, overwrite=overwrite)
    return _ran(chosen, out, spread)


def _ran(chosen, folder: Path, spread) -> None:
    """Run a scenario in a folder, or what is left of it."""
    from .experiments import report
    from .experiments.rooms import REPORTS

    its_report = _room(REPORTS[chosen.experiment])
    getattr(its_report, "foretell", lambda chosen: None)(chosen)
    with _working(), report.progress() as tell:
        found = its_report.simulate(chosen, folder=folder, workers=spread, report=tell)
        tell("figures", 0.0, str(folder))
        paths = its_report.write_result(folder, found)
    its_report.show_result(found)
    report.show_paths(paths)


@app.command()
def resume(
    folder: Annotated[Path, typer.Argument(help="The folder of a run that was stopped or killed.")],
    workers: Workers = None,
    scheduler: Scheduler = None,
) -> None:
    """Go on with a run that was killed: dynamics to the last bit, quasi-static steps to their solver's tolerance."""
    from .experiments import report

    found = report.begun(folder)
    if found is None:
        report.console.print(f"{folder} is finished: there is nothing to go on with.", highlight=False)
        return report.show_paths(report.files_of(folder))
    spread = _spread(workers, scheduler, found.scenario)
    if found.reproduction:
        return _reproduced(folder, spread, **found.reproduction)
    if found.sweep:
        return _sweep(found.sweep, folder, spread, overwrite=False, yes=True, figures=False)
    return _ran(found.scenario, folder, spread)


def _sweep(tables: dict, out: Path, spread, overwrite: bool, yes: bool, figures: bool) -> None:
    """Many runs; those that fail end with exit code 1, and the others are kept."""
    from .data.sweep import sweep

    its_report, chosen = _room("sweep_report"), sweep(**tables)

    def confirm() -> bool:
        if yes or not sys.stdin.isatty():
            if not yes:
                raise ValueError(f"{chosen.count} members are many, and there is no terminal to ask: add --yes")
            return True
        return typer.confirm(f"Run {chosen.count} members?")

    found = its_report.simulate(
        chosen, out, workers=spread, overwrite=overwrite, figures=figures, confirm=confirm
    )  # fmt: skip
    if found is None:
        return print("nothing was run")
    its_report.show(found, out)
    if sentence := its_report.verdict(found):
        raise RuntimeError(sentence)
    return None


def _swept(tables: dict, engine: str | None) -> dict:
    """The tables of a sweep, run by another engine."""
    if engine is None:
        return tables
    _one_of("engine", engine, ["stickslip", "lammps"])
    return tables | {"engine": engine}


def _spread(workers: int | None, scheduler: str | None, chosen=None) -> int | str | None:
    """Where independent runs of a scenario go, tried before anything starts."""
    from .experiments.rooms import ALONE

    if scheduler and chosen and chosen.experiment in ALONE:
        raise ValueError(f"--scheduler was given, but experiment = {chosen.experiment!r} is one run: leave it out")
    if scheduler is None:
        return workers
    if workers is not None:
        raise ValueError("--workers and --scheduler were both given: a cluster has its own workers, give one of them")
    from .ensemble import reach

    reach(scheduler)
    return scheduler


def _with_engine(chosen, engine: str):
    """The scenario, run by another engine."""
    _one_of("engine", engine, ["stickslip", "lammps"])
    if chosen.experiment != "gouge":
        raise ValueError(f'--engine was given with experiment = {chosen.experiment!r}: only "gouge" has a choice')
    return chosen.model_copy(update={"engine": engine})


@app.command()
@_reads_packing
def stability(
    file: Annotated[Path, typer.Argument(help="A packing: .npz, .h5, .gsd, LAMMPS .data or .dump.")],
    options: dict,
    method: Annotated[str, typer.Option("--method", help="auto, dense, pairs or fastest.")] = "auto",
    modes: Annotated[
        Path | None, typer.Option("--modes", help="Where modes go; default: FILE's name with -modes.npz, here.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one object; write modes only with --modes.")] = False,
) -> None:
    """Is this packing stable? Complex pairs, buckling, floppy modes and rattlers of anybody's packing."""
    from .data.exchange.files import listened, read_sample
    from .experiments import report, stability_report

    (state, its_law, words), said = listened(read_sample, file, **options)
    words = [*words, *said]
    if as_json:
        for line in words:
            print(f"stickslip: {line}", file=sys.stderr)
        found = stability_report.judged(state, its_law, method=method)
        print(stability_report.as_json(found))
    else:
        with report.progress(transient=True) as tell:
            found = stability_report.judged(state, its_law, method=method, report=tell)
        stability_report.show(found, its_law, words)
    if modes or (not as_json and found.modes.shape[1]):
        path = stability_report.write_modes(modes or Path(f"{file.stem}-modes.npz"), found)
        if not as_json:
            report.show_paths([path])


@app.command()
@_reads_packing
def convert(
    file: Annotated[Path, typer.Argument(help="A packing: .npz, .h5, .gsd, LAMMPS .data or .dump.")],
    to: Annotated[Path, typer.Option("--to", help="Where: .gsd, .vtu, .xyz, .data, .npz or .h5.")],
    options: dict,
    modes: Annotated[Path | None, typer.Option("--modes", help="Animate a mode that `stability` wrote.")] = None,
    mode: Annotated[int, typer.Option("--mode", min=0, help="Which one, the fastest first.")] = 0,
    frames: Annotated[int, typer.Option("--frames", min=2, help="Frames of one period.")] = 48,
    amplitude: Annotated[float, typer.Option("--amplitude", help="Largest displacement over the radius.")] = 0.3,
    grow: Annotated[bool, typer.Option("--grow", help="Let the mode grow as it does.")] = False,
) -> None:
    """Write a packing for OVITO, ParaView, ASE or LAMMPS; with --modes, the animation of a mode."""
    from .data.exchange.files import convert, listened
    from .experiments import report

    (paths, words), said = listened(
        convert, file, to, modes=modes, mode=mode, count=frames, amplitude=amplitude, grow=grow, **options
    )
    for line in [*words, *said]:
        report.console.print(f"[yellow]{line}[/]")
    report.show_paths(paths)


@app.command()
def fit(
    file: Annotated[Path, typer.Argument(help="A record as CSV: time [s], load_point [um], friction [-], …")],
    law: Annotated[str, typer.Option("--law", help="aging, slip or both.")] = "both",
    stiffness: Annotated[
        float | None, typer.Option("--stiffness", help="Friction per displacement, known [1/m].")
    ] = None,
    free_stiffness: Annotated[bool, typer.Option("--free-stiffness", help="Fit the stiffness, too.")] = False,
    v0: Annotated[
        float | None, typer.Option("--v0", help="Velocity at which friction is mu0; default: the first [m/s].")
    ] = None,
    before: Annotated[
        float | None, typer.Option("--before", help="Slip velocity before the record starts [m/s].")
    ] = None,
    detrend: Annotated[bool, typer.Option("--detrend", help="Fit a trend, linear in displacement, too.")] = False,
    normal: Annotated[bool, typer.Option("--normal", help="Let measured changes of normal stress act.")] = False,
    out: Out = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier fit in the folder.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one object instead of tables.")] = False,
) -> None:
    """Fit rate-and-state friction to a record: a, b, D_c and more with intervals, and which law the data prefer."""
    _one_of("law", law, ["aging", "slip", "both"])
    from .experiments import fit_report, report

    found = fit_report.fitted(
        file, laws=("aging", "slip") if law == "both" else (law,), stiffness=stiffness, free_stiffness=free_stiffness,
        v0=v0, before=before, detrend=detrend, normal=normal, out=out, overwrite=overwrite,
    )  # fmt: skip
    if as_json:
        print(fit_report.as_json(found))
    else:
        fit_report.show(found)
    if out:
        paths = fit_report.write(out, found)
        if not as_json:
            report.show_paths(paths)


@app.command()
def cite(
    scenario: Annotated[Path, typer.Argument(help="A scenario in TOML, or the folder of a run's results.")],
) -> None:
    """BibTeX of what a run rests on: this package, papers, laws, libraries."""
    from .data.sources import bibtex, scenarios_of

    print(bibtex(*scenarios_of(scenario)), end="")


@app.command()
def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print one object instead of tables.")] = False,
) -> None:
    """Is this installation sound? Versions, threads, caches, optional parts, a self-check; exit code 1 if it fails."""
    from .doctor.report import told

    raise typer.Exit(0 if told(as_json=as_json) else 1)


def _room(name: str):
    """A module of the experiments, loaded when needed."""
    return import_module(f".experiments.{name}", __package__)


def _one_of(name: str, got: str, allowed: list[str]) -> None:
    if got not in allowed:
        raise ValueError(f"{name} {got!r} is not known: use {', '.join(allowed)}")


@contextmanager
def _working():
    """What goes wrong after the input was accepted is a failed run, not bad input."""
    from .data.archive import ArchiveError
    from .data.parts import ScenarioError

    try:
        yield
    except (ScenarioError, ArchiveError, MissingExtraError):
        raise  # seen late: grains that do not fit, pieces that belong to another run, parts that are not installed
    except (ValueError, ArithmeticError, MemoryError) as problem:
        raise RuntimeError(f"the run failed ({type(problem).__name__}: {problem})") from problem


def main() -> None:
    """Entry point: bad input ends with one sentence and exit code 2, a failed run with one and exit code 1."""
    try:
        code = app(standalone_mode=False)
    except (ValueError, OSError) as problem:
        _fail(_words(problem), 2)
    except RuntimeError as problem:
        _fail(str(problem), 1)
    except KeyboardInterrupt:
        code = STOPPED
    except Exception as problem:
        if not hasattr(problem, "format_message"):
            raise
        _fail(problem.format_message().rstrip(".") or "say what to do, as listed above", 2)
    if code == STOPPED:
        _fail("stopped by the user: stickslip resume FOLDER goes on with what is kept", STOPPED)
    sys.exit(code or 0)


def _words(problem: Exception) -> str:
    if isinstance(problem, OSError) and problem.strerror:
        full = problem.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        remedy = ": what was there before is whole; make room, then stickslip resume goes on with a run" if full else ""
        place = f"{problem.filename}: " if problem.filename else ""
        return f"{place}{problem.strerror.lower()}{remedy}"
    return str(problem)


def _fail(sentence: str, code: int) -> None:
    line = " ".join(sentence.split())
    print(f"stickslip: {line if len(line) <= LONGEST else line[:LONGEST] + ' …'}", file=sys.stderr)
    sys.stderr.flush()
    sys.exit(code)
