"""The command line: thin; every command calls one function of the layer below and shows what came back."""

import errno
import sys
from contextlib import contextmanager
from importlib import import_module
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

STOPPED = 130  # what shells expect of a process that ctrl-C ended

Out = Annotated[Path | None, typer.Option("--out", help="Folder for results; made if it does not exist.")]
Workers = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes of independent runs, threads of a flow; default: all.")
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", help="Address or JSON file of a Dask scheduler that runs them instead.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace results of another scenario in the folder.")]


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
    from .data.scenario import scenario as judged
    from .data.scenario import tables_of
    from .experiments import report
    from .experiments.rooms import ALONE, SWEEP

    tables = tables_of(scenario)
    if "sweep" in tables:
        return _sweep(_swept(tables, engine), out, _spread(workers, scheduler), overwrite, yes, figures)
    chosen = judged(**tables)
    if engine is not None:
        chosen = _with_engine(chosen, engine)
    if scheduler and chosen.experiment in ALONE:
        raise ValueError(f"--scheduler was given, but experiment = {chosen.experiment!r} is one run: leave it out")
    if (out / SWEEP).exists():
        raise ValueError(f"{out} holds the results of a sweep: choose another --out")
    spread = _spread(workers, scheduler)
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
    spread = _spread(workers, scheduler)
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


def _spread(workers: int | None, scheduler: str | None) -> int | str | None:
    """Where independent runs go, tried before anything starts."""
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
def stability(
    file: Annotated[Path, typer.Argument(help="A packing: .npz with position, radius, …, or an archive with a state.")],
    law: Annotated[str | None, typer.Option("--law", help="hertz_mindlin or linear; wins over the file.")] = None,
    coulomb: Annotated[str | None, typer.Option("--coulomb", help="smooth or sharp.")] = None,
    kn: Annotated[float | None, typer.Option("--kn", help="Normal stiffness.")] = None,
    kt: Annotated[float | None, typer.Option("--kt", help="Tangential stiffness.")] = None,
    mu: Annotated[float | None, typer.Option("--mu", help="Friction coefficient.")] = None,
    i0: Annotated[float | None, typer.Option("--i0", help="Moment of inertia I0 m R²: 0.4 for spheres.")] = None,
    frame: Annotated[str | None, typer.Option("--frame", help="Which state of an archive.")] = None,
    method: Annotated[str, typer.Option("--method", help="auto, dense, pairs or fastest.")] = "auto",
    modes: Annotated[
        Path | None, typer.Option("--modes", help="Where modes go; default: FILE's name with -modes.npz, here.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one object; write modes only with --modes.")] = False,
) -> None:
    """Is this packing stable? Complex pairs, buckling, floppy modes and rattlers of anybody's packing."""
    import warnings

    from .data.sample import SampleWarning, read_sample
    from .experiments import report, stability_report
    from .solve import stability as room

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SampleWarning)
        state, its_law, words = read_sample(file, law=law, coulomb=coulomb, kn=kn, kt=kt, mu=mu, i0=i0, frame=frame)
    words = [*words, *(str(w.message) for w in caught if issubclass(w.category, SampleWarning))]
    if as_json:
        for line in words:
            print(f"stickslip: {line}", file=sys.stderr)
        found = room.stability(state, its_law, method=method)
        print(stability_report.as_json(found))
    else:
        with report.progress(transient=True) as tell:
            found = room.stability(state, its_law, method=method, report=tell)
        stability_report.show(found, its_law, words)
    if modes or (not as_json and found.modes.shape[1]):
        path = stability_report.write_modes(modes or Path(f"{file.stem}-modes.npz"), found)
        if not as_json:
            report.show_paths([path])


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
    from .data.scenario import read
    from .data.sources import bibtex
    from .experiments.report import SCENARIO

    print(bibtex(read(scenario / SCENARIO if scenario.is_dir() else scenario)), end="")


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
        _fail("stopped by the user; nothing that was not reported as written was left behind", STOPPED)
    sys.exit(code or 0)


def _words(problem: Exception) -> str:
    if isinstance(problem, OSError) and problem.strerror:
        remedy = ""
        if problem.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS):
            remedy = "; what was kept before is whole: make room, then go on with stickslip resume"
        return f"{problem.filename}: {problem.strerror.lower()}{remedy}"
    return str(problem)


def _fail(sentence: str, code: int) -> None:
    print(f"stickslip: {sentence}", file=sys.stderr)
    sys.stderr.flush()
    sys.exit(code)
