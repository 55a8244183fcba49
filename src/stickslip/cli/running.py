"""Commands that run experiments: a paper's, one's own, a sweep, and what is left of one that was stopped."""

import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from ..experiments.rooms import ALONE, PAPERS, REPORTS, WORDS
from .app import ENGINES, AsJson, Out, Overwrite, Quiet, Scheduler, Workers, app, completes, ended, examples, one_of
from .ending import FailedError, working

REPRODUCE = examples(
    ("reproduce disk-array --quick", "a minute; results/disk-array-quick, with figures and claims"),
    ("reproduce disk-array --quick --json", "the same again, for programs: claims and measures as one object"),
    ("reproduce gouge --quick --workers 2", "minutes; stopped by ctrl-C, the same call goes on"),
)
RUN = examples(
    ("run examples/rate_state.toml --out results/rate-state", "a slider with rate-and-state friction: seconds"),
    ("run examples/rate_state_sweep.toml --out results/sweep --workers 2", "many of them, by the table [sweep]"),
    ("run examples/rate_state.toml --out results/rate-state --json", "again, told as one object"),
    ("run examples/disk_array.toml --out results/mine --quiet", "a minute or two; tells nothing but paths"),
)
RESUME = examples(
    ("resume results/rate-state", "a run that has ended has nothing left, and says so"),
    ("resume results/sweep --workers 2", "members of a sweep that are missing, with --figures if they had it"),
)


@app.command(epilog=REPRODUCE, short_help="Run a paper's experiment and judge its claims.")
def reproduce(
    experiment: Annotated[
        str,
        typer.Argument(
            help="Which paper: disk-array, sphere-shear, quasi-rigid or gouge.", autocompletion=completes(WORDS)
        ),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer realizations and shorter runs; says what it cuts.")
    ] = False,
    full: Annotated[
        bool, typer.Option("--full", help="Of gouge: velocity steps and other slides, too; hours, and says how many.")
    ] = False,
    out: Out = None,
    seed: Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Seed of all random velocities.")] = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Run a paper's experiment end to end: figures, raw numbers, and every claim judged (claims.md, claims.png)."""
    one_of("experiment", experiment, PAPERS)
    if full and (quick or experiment != "gouge"):
        raise ValueError(
            "--full was given with --quick: give one of them" if quick else f"{experiment} has no --full: leave it out"
        )
    spread = _spread(workers, scheduler)
    from ..data.lock import alone
    from ..experiments import report

    chosen = _room(PAPERS[experiment]).paper_scenario(quick=quick, seed=seed)
    folder = out or Path("results") / (experiment + ("-quick" if quick else ""))
    how = {"quiet": quiet, "as_json": as_json}
    with report.speaking(**how), alone(folder):
        report.claim_folder(folder, chosen, overwrite=overwrite)
        asked = {"experiment": experiment, "quick": quick, "seed": seed} | ({"full": True} if full else {})
        report.begin_reproduction(folder, chosen, **asked)
        _reproduced("reproduce", folder, spread, how, **asked)


def _reproduced(command: str, folder: Path, spread, how: dict, *, experiment: str, quick: bool, **asked) -> None:
    """Run a paper's experiment in a folder, or what is left of it."""
    from ..experiments import answers, report
    from ..experiments.claims_report import show_claims

    paper, its_report = _room(PAPERS[experiment]), _room(REPORTS[experiment])
    if quick:
        report.console.print(f"--quick cuts: {paper.CUTS}.")
    with working(), report.progress() as tell:
        found = paper.reproduce(quick=quick, **asked, folder=folder, workers=spread, report=tell)
        tell("figures", 0.0, str(folder))
        paths = its_report.write_reproduction(folder, found)
    ended(
        lambda: answers.of_run(command, folder, found.main, paths, found.claims), paths,
        lambda: show_claims(found.claims, its_report.SHOWS), **how,
    )  # fmt: skip


@app.command(epilog=RUN, short_help="Run your own scenario, or many.")
def run(
    scenario: Annotated[Path, typer.Argument(help="A scenario in TOML, such as examples/disk_array.toml.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for results; made if it does not exist.")],
    engine: Annotated[
        str | None,
        typer.Option("--engine", help="stickslip or lammps, of fault gouge.", autocompletion=completes(ENGINES)),
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    yes: Annotated[bool, typer.Option("--yes", help="Run a sweep of however many members.")] = False,
    figures: Annotated[bool, typer.Option("--figures", help="Draw figures of every member of a sweep.")] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Run your own scenario, or with a table [sweep] many: arrays, packings, tests, flows, gouge, sliders."""
    from ..data.lock import alone
    from ..data.scenario import scenario as judged
    from ..data.scenario import tables_of
    from ..experiments import report

    tables, how = tables_of(scenario), {"quiet": quiet, "as_json": as_json}
    if "sweep" in tables:
        tables, spread = _swept(tables, engine), _spread(workers, scheduler)
        with report.speaking(**how), alone(out):
            return _sweep("run", tables, out, spread, how, overwrite=overwrite, yes=yes, figures=figures)
    chosen = judged(**tables)
    if engine is not None:
        chosen = _with_engine(chosen, engine)
    spread = _spread(workers, scheduler, chosen)
    with report.speaking(**how), alone(out):
        report.claim_folder(out, chosen, overwrite=overwrite)
        return _ran("run", chosen, out, spread, how)


def _ran(command: str, chosen, folder: Path, spread, how: dict) -> None:
    """Run a scenario in a folder, or what is left of it."""
    from ..experiments import answers, report

    its_report = _room(REPORTS[chosen.experiment])
    getattr(its_report, "foretell", lambda chosen: None)(chosen)
    with working(), report.progress() as tell:
        found = its_report.simulate(chosen, folder=folder, workers=spread, report=tell)
        tell("figures", 0.0, str(folder))
        paths = its_report.write_result(folder, found)
    ended(
        lambda: answers.of_run(command, folder, found, paths), paths, lambda: its_report.show_result(found), **how
    )  # fmt: skip


@app.command(epilog=RESUME, short_help="Go on with a run that was stopped or killed.")
def resume(
    folder: Annotated[Path, typer.Argument(help="The folder of a run that was stopped or killed.")],
    workers: Workers = None,
    scheduler: Scheduler = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Go on with a run that was killed: dynamics to the last bit, quasi-static steps to their solver's tolerance."""
    from ..data.lock import alone
    from ..experiments import report

    how = {"quiet": quiet, "as_json": as_json}
    with report.speaking(**how):
        if report.begun(folder) is None:
            return _nothing_left(folder, how)
        with alone(folder):
            found = report.begun(folder)  # again: another process may have ended in between
            if found is None:
                return _nothing_left(folder, how)
            spread = _spread(workers, scheduler, found.scenario)
            if found.reproduction:
                return _reproduced("resume", folder, spread, how, **found.reproduction)
            if found.sweep:
                return _sweep("resume", found.sweep, folder, spread, how, yes=True, figures=found.figures)
            return _ran("resume", found.scenario, folder, spread, how)


def _nothing_left(folder: Path, how: dict) -> None:
    """Say that a run has ended, and what it left."""
    from ..data.kept import SCENARIO
    from ..data.scenario import read
    from ..experiments import answers, report

    words, paths = f"{folder} is finished: there is nothing to go on with.", report.files_of(folder)
    ended(
        lambda: answers.of_finished("resume", folder, read(folder / SCENARIO)), paths,
        lambda: report.console.print(words), **how,
    )  # fmt: skip


def _sweep(
    command: str, tables: dict, out: Path, spread, how: dict, *, yes: bool, figures: bool, overwrite: bool = False
) -> None:
    """Many runs; those that fail end with exit code 1, and the others are kept."""
    from ..data.sweep import sweep
    from ..experiments import answers

    its_report, chosen = _room("sweep_report"), sweep(**tables)

    def confirm() -> bool:
        if yes or not sys.stdin.isatty() or how["as_json"] or how["quiet"]:
            if not yes:
                raise ValueError(f"{chosen.count} members are many, and there is no terminal to ask: add --yes")
            return True
        return typer.confirm(f"Run {chosen.count} members?")

    found = its_report.simulate(
        chosen, out, workers=spread, overwrite=overwrite, figures=figures, confirm=confirm
    )  # fmt: skip
    if found is None:
        return print("nothing was run")
    answer, sentence = answers.of_sweep(command, out, found, its_report.ranges(found)), its_report.verdict(found)
    if sentence and how["as_json"]:
        raise FailedError(sentence, answers.finite(answer))
    ended(lambda: answer, answer["files"], lambda: its_report.show(found), **how)
    if sentence:
        raise RuntimeError(sentence)
    return None


def _swept(tables: dict, engine: str | None) -> dict:
    """The tables of a sweep, run by another engine."""
    if engine is None:
        return tables
    one_of("engine", engine, ENGINES)
    return tables | {"engine": engine}


def _spread(workers: int | None, scheduler: str | None, chosen=None) -> int | str | None:
    """Where independent runs of a scenario go, tried before anything starts."""
    if scheduler and chosen and chosen.experiment in ALONE:
        raise ValueError(f"--scheduler was given, but experiment = {chosen.experiment!r} is one run: leave it out")
    if scheduler is None:
        return workers
    if workers is not None:
        raise ValueError("--workers and --scheduler were both given: a cluster has its own workers, give one of them")
    from ..ensemble import reach

    reach(scheduler)
    return scheduler


def _with_engine(chosen, engine: str):
    """The scenario, run by another engine."""
    one_of("engine", engine, ENGINES)
    if chosen.experiment != "gouge":
        raise ValueError(f'--engine was given with experiment = {chosen.experiment!r}: only "gouge" has a choice')
    return chosen.model_copy(update={"engine": engine})


def _room(name: str):
    """A module of the experiments, loaded when needed."""
    return import_module(f"..experiments.{name}", __package__)
