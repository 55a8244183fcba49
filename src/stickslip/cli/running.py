"""Commands that run experiments: reproduce a paper, run a scenario or a sweep, and resume a stopped run."""

import sys
from collections.abc import Callable
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from .. import reports, runs
from ..data.run_files import SCENARIO, lock_folder, resume_command
from ..wing import wings
from .app import (
    DEVICES,
    EngineOptions,
    FailedError,
    FigureOptions,
    Out,
    Output,
    Overwrite,
    ProcessOptions,
    StoppedError,
    Trust,
    check_choice,
    command,
    complete_from,
    convert_errors,
    examples,
    finish,
)

REPRODUCE = examples(
    ("reproduce disk-array --quick", "a minute; results/disk-array-quick, with figures and claims"),
    ("reproduce disk-array --quick --json", "the same for programs: claims and measures as one JSON object"),
    ("reproduce gouge --quick --workers 2", "minutes; after ctrl-C, the same command continues"),
)
RUN = examples(
    ("run examples/rate_state.toml --out results/rate-state", "a slider with rate-and-state friction: seconds"),
    ("run examples/rate_state_sweep.toml --out results/sweep --workers 2", "many of them, through the [sweep] table"),
    ("run examples/plane_shear.toml --engine lammps --out results/mpi", "a flow in LAMMPS; --ranks N: with MPI"),
    ("run examples/plane_shear.toml --engine lammps --export job", "the same for a queue; then stickslip resume job"),
    ("run examples/rate_state.toml --out results/rate-state --json", "the same, with a JSON object as output"),
    ("run examples/disk_array.toml --out results/mine --quiet", "a minute or two; prints only paths"),
)
RESUME = examples(
    ("resume results/rate-state", "reports that a finished run has nothing left to do"),
    ("resume results/sweep --workers 2", "missing members of a sweep, with --figures as before"),
)


def _papers() -> dict[str, str]:
    """Names of papers with their descriptions, without those whose experiments cannot be imported."""
    from ..experiments.registry import papers

    found = {}
    for name in papers():
        with suppress(Exception):  # third-party code
            found[name] = papers()[name].words
    return found


def _names_of_papers() -> str:
    names = [paper for wing in wings().values() for entry in wing.experiments.values() for paper in entry.papers]
    return " or ".join(filter(None, [", ".join(names[:-1]), *names[-1:]])) or "none is installed"


def _about_run() -> str:
    """Help of `run`, with the experiments of all installed wings."""
    names = ", ".join(name for wing in wings().values() for name in wing.experiments) or "none is installed"
    return f"Run a scenario, or many with a [sweep] table. Experiments: {names}."


@command(epilog=REPRODUCE)
def reproduce(
    *,
    experiment: Annotated[
        str, typer.Argument(help=f"Name of the paper: {_names_of_papers()}.", autocompletion=complete_from(_papers))
    ],
    quick: Annotated[bool, "Fewer realisations and shorter runs; omissions are reported."] = False,
    full: Annotated[
        bool, "Gouge only: also velocity steps and other slides; the estimated hours are reported."
    ] = False,
    paper_size: Annotated[
        bool, "Gouge only: 4800 grains as in the paper instead, a day on one core or minutes with --device cuda."
    ] = False,
    realizations: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="With --paper-size: number of samples; default: 8.")
    ] = None,
    samples: Annotated[
        Path | None, "With --paper-size: evaluate the samples stored in a folder; --realizations N adds to them."
    ] = None,
    out: Out = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of all random velocities.")] = 0,
    processes: ProcessOptions,
    overwrite: Overwrite = False,
    drawing: FigureOptions,
    output: Output,
) -> None:
    """Run a paper's experiment: figures, raw numbers, and a verdict on every claim (claims.md, claims.png)."""
    from ..experiments.registry import papers

    if not papers():
        raise ValueError(f"{experiment!r} is not available, as no installed wing has papers: install stickslip again")
    check_choice("experiment", experiment, papers())
    look = drawing.look()
    size = {"quick": quick, "full": full, "paper-size": paper_size}
    given = [f"--{name}" for name, value in size.items() if value]
    if len(given) > 1:
        raise ValueError(f"{given[1]} and {given[0]} exclude each other: give only one")
    for name, value in (("--realizations", realizations), ("--samples", samples)):
        if value and not paper_size:
            raise ValueError(f"{name} requires --paper-size, the only run with samples")
    more = {"full": full, "paper_size": paper_size, "realizations": realizations}
    more |= {"samples": samples and samples.absolute()}
    more = {name: value for name, value in more.items() if value}
    if unknown := [name for name in more if name not in runs.folder.reproduction_arguments(experiment).model_fields]:
        raise ValueError(f"{experiment} has no --{unknown[0].replace('_', '-')}: leave it out")
    asked = {"quick": quick, "seed": seed} | more
    chosen = papers()[experiment].paper.scenario(**{name: value for name, value in asked.items() if name != "full"})
    spread = _choose_processes(processes, chosen)
    folder = out or Path("results") / (experiment + ("-quick" if quick else "-paper-size" if paper_size else ""))
    with _working_in(folder, output):
        runs.folder.prepare_folder(folder, chosen, overwrite=overwrite)
        runs.folder.mark_reproduction(folder, chosen, experiment, **asked)
        runs.folder.mark_look(folder, chosen, look)
        _reproduce_in("reproduce", folder, spread, output, look, experiment=experiment, **asked)


@contextmanager
def _working_in(folder: Path, output: Output):
    """Lock a run folder and direct the output; after ctrl-C or SIGTERM, print the command that continues the run."""
    from ..data.checkpoint import is_worth_resuming

    with reports.terminal.console_output(*output), lock_folder(folder):
        try:
            yield
        except KeyboardInterrupt as problem:
            said = f"stopped by {str(problem) or 'the user'}"
            if is_worth_resuming(folder):
                raise StoppedError(f"{said}: continue with {resume_command(folder)}") from None
            raise StoppedError(f"{said} before anything was saved: run the command again") from None


def _note_levels(folder: Path) -> None:
    """Print a note if checkpoints were computed with a build of the core for other processors."""
    from ..data.checkpoint import note_on_levels

    if note := note_on_levels(folder):
        reports.terminal.console.print(note, style="yellow")


def _reproduce_in(
    command: str, folder: Path, spread, output: Output, look, *, experiment: str, quick: bool, **asked
) -> None:  # fmt: skip
    """Run or continue a paper's experiment in a folder."""
    from ..experiments.registry import papers

    chosen = papers()[experiment]
    if quick:
        reports.terminal.console.print(f"--quick cuts: {chosen.paper.cuts}.")
    _note_levels(folder)
    with convert_errors(), reports.terminal.progress() as tell:
        reproduction = chosen.paper.reproduce(quick=quick, **asked, folder=folder, **spread, report=tell)
        tell("figures", 0.0, str(folder))
        paths = runs.folder.write_reproduction(folder, chosen, reproduction, look)
    finish(
        lambda: runs.json_output.describe_run(command, folder, reproduction.main, paths, reproduction.claims), paths,
        lambda: reports.claims.show_claims(reproduction.claims, chosen.paper.shows()), output,
    )  # fmt: skip


class SweepOptions(NamedTuple):
    """Options of sweeps."""

    yes: Annotated[bool, "Run a sweep with any number of members."] = False
    figures: Annotated[bool, "Draw figures of every member of a sweep."] = False
    part: Annotated[
        str | None, typer.Option(metavar="K/N", help="Run the K-th of N parts of a sweep, for arrays of jobs.")
    ] = None
    gather: Annotated[
        list[Path] | None,
        typer.Option(help="Take finished members from the folder of a part; repeatable.", metavar="FOLDER"),
    ] = None

    def numbers(self) -> tuple[int, int] | None:
        """K and N of `--part K/N`; None without this option."""
        if self.part is None:
            return None
        k, _, n = self.part.partition("/")
        if not (k.isdecimal() and n.isdecimal() and 1 <= int(k) <= int(n)):
            raise ValueError(f"--part must be K/N with 1 ≤ K ≤ N, such as 3/16, got {self.part}")
        return int(k), int(n)


@command(epilog=RUN, help=_about_run)
def run(
    *,
    scenario: Annotated[Path, typer.Argument(help="A scenario in TOML, such as examples/disk_array.toml.")],
    out: Annotated[Path | None, "Folder for results; default: results/SCENARIO."] = None,
    engine: EngineOptions,
    export: Annotated[
        Path | None, "Write a folder that LAMMPS runs in a queue instead; read it back with stickslip resume."
    ] = None,
    compare: Annotated[
        Path | None, "Table of a laboratory test, such as test.csv, to compare with an element test."
    ] = None,
    processes: ProcessOptions,
    overwrite: Overwrite = False,
    trust: Trust = False,
    sweeps: SweepOptions,
    drawing: FigureOptions,
    output: Output,
) -> None:
    """Run a scenario, or many with a [sweep] table."""
    from ..data.law_schema import check_law_files, trust_law_files
    from ..experiments.registry import read_tables
    from ..experiments.registry import scenario as make_scenario

    look = drawing.look()
    if out is not None and export is not None:
        raise ValueError("--out and --export exclude each other: results, or LAMMPS input")
    piece = sweeps.numbers()
    out = out or Path("results") / (scenario.stem + (f"-{piece[0]}-of-{piece[1]}" if piece else ""))
    tables = read_tables(scenario)
    if trust:
        trust_law_files(tables)
    if "sweep" in tables:
        for name, given in (("export", export), ("compare", compare)):
            if given:
                raise ValueError(f"--{name} does not apply to a sweep: {name} its members one by one")
        tables, spread = tables | engine.values(), _choose_processes(processes)
        with _working_in(out, output):
            options = {"overwrite": overwrite, "yes": sweeps.yes, "figures": sweeps.figures, "look": look}
            options |= {"part": piece, "gather": sweeps.gather or []}
            return _run_sweep_in("run", tables, out, spread, output, **options)
    if piece or sweeps.gather:
        raise ValueError(
            f"--{'part' if piece else 'gather'} applies to sweeps only, but {scenario} has no table [sweep]"
        )
    chosen = _with_engine(make_scenario(**tables), engine)
    draw = _open_laboratory(chosen, compare) if compare else None
    if export:
        return _export_to(export, chosen, output, overwrite=overwrite)
    check_law_files(chosen.model_dump())
    spread = _choose_processes(processes, chosen)
    with _working_in(out, output):
        if draw and not overwrite and runs.folder.is_finished(out, chosen):
            reports.terminal.console.print(f"{out} is finished, and its results are used.", markup=False)
            remarks = runs.folder.write_comparison(out, chosen, draw, look)
            return _report_finished("run", out, output, lambda: reports.terminal.show_lines(remarks), chosen)
        runs.folder.prepare_folder(out, chosen, overwrite=overwrite)
        runs.folder.mark_look(out, chosen, look)
        return _run_in("run", chosen, out, spread, output, look, draw)


def run_scenario(
    command: str, chosen, folder: Path, output: Output, look, *, overwrite: bool = False, begin=lambda: None
) -> None:  # fmt: skip
    """Run a scenario in a folder, for a command; `begin` saves the input already read by the command."""
    with _working_in(folder, output):
        runs.folder.prepare_folder(folder, chosen, overwrite=overwrite)
        runs.folder.mark_look(folder, chosen, look)
        begin()
        _run_in(command, chosen, folder, {}, output, look)


def _export_to(folder: Path, chosen, output: Output, *, overwrite: bool) -> None:
    """Write LAMMPS input to a folder, in which `stickslip resume` continues once LAMMPS has run."""
    from ..data.checkpoint import checkpoint_in
    from ..experiments.registry import experiment_of

    write = experiment_of(chosen).export
    if write is None or chosen.engine != "lammps":
        what = f"experiment = {chosen.experiment!r}" if write is None else f"engine = {chosen.engine!r}"
        raise ValueError(f"--export writes flows and fault gouge for LAMMPS, not {what}; add --engine lammps")
    with _working_in(folder, output):
        runs.folder.prepare_folder(folder, chosen, overwrite=overwrite)
        paths = write(chosen, folder)
        checkpoint_in(folder, chosen).announce()
    message = f"Submit job.slurm, or run sh run.sh; then {resume_command(folder)}."
    finish(
        lambda: runs.json_output.common_fields("run", files=paths), paths,
        lambda: reports.terminal.console.print(message), output,
    )  # fmt: skip


def _open_laboratory(chosen, path: Path):
    """Read the table of a laboratory test, and return a function that compares it with the run of a scenario."""
    from ..experiments.registry import experiment_of, with_feature

    if experiment_of(chosen).overlay is None:
        able = with_feature(lambda one: one.overlay)
        raise ValueError(
            f"--compare does not apply to experiment = {chosen.experiment!r}: only {able} can be compared with "
            "laboratory tests"
        )
    return experiment_of(chosen).overlay(chosen, path)


def _run_in(command: str, chosen, folder: Path, spread, output: Output, look, draw=None) -> None:
    """Run or continue a scenario in a folder, and draw comparisons."""
    from ..core.units import units_in_use
    from ..experiments.registry import experiment_of, list_files

    experiment = experiment_of(chosen)
    experiment.announce(chosen)
    _note_levels(folder)
    with convert_errors(), reports.terminal.progress() as tell:
        result = experiment.simulate(chosen, folder=folder, **spread, report=tell)
        tell("figures", 0.0, str(folder))
        paths, remarks = runs.folder.write_result(folder, experiment, result, look), ()
        if draw:
            remarks, paths = runs.folder.write_comparison(folder, chosen, draw, look), list_files(folder)

    def show() -> None:
        experiment.show(result)
        reports.terminal.show_lines(remarks)

    with units_in_use(chosen.named_units):
        finish(lambda: runs.json_output.describe_run(command, folder, result, paths), paths, show, output)


@command(epilog=RESUME)
def resume(
    *,
    folder: Annotated[Path, typer.Argument(help="The run folder of a stopped or killed run.")],
    processes: ProcessOptions,
    trust: Trust = False,
    output: Output,
) -> None:
    """Continue a stopped run: dynamics bit for bit, quasi-static steps to within the tolerance of the solver."""
    from ..data.law_schema import check_law_files, trust_law_files

    def finished() -> None:
        message = f"{folder} is finished: there is nothing to resume."
        _report_finished("resume", folder, output, lambda: reports.terminal.console.print(message))

    with reports.terminal.console_output(*output):
        if runs.folder.find_unfinished(folder) is None:
            return finished()
        with _working_in(folder, output):
            saved = runs.folder.find_unfinished(folder)  # again, because another process may have finished the run
            if saved is None:
                return finished()
            tables = saved.sweep or saved.scenario.model_dump()
            if trust:
                trust_law_files(tables)
            check_law_files(tables)
            spread = _choose_processes(processes, saved.scenario)
            if saved.reproduction:
                return _reproduce_in("resume", folder, spread, output, saved.look, **saved.reproduction)
            if saved.sweep:
                _note_levels(folder)
                options = {"yes": True, "figures": saved.figures, "look": saved.look, "part": saved.part}
                return _run_sweep_in("resume", saved.sweep, folder, spread, output, **options)
            return _run_in("resume", saved.scenario, folder, spread, output, saved.look)


def _report_finished(command: str, folder: Path, output: Output, show: Callable[[], None], chosen=None) -> None:
    """Print the result of a command that found a run finished, and list its files."""
    from ..experiments.registry import list_files, read_scenario

    def answer() -> dict:
        scenario = read_scenario(folder / SCENARIO) if chosen is None else chosen
        return runs.json_output.describe_finished_run(command, folder, scenario)

    finish(answer, list_files(folder), show, output)


def _run_sweep_in(command: str, tables: dict, out: Path, spread, output: Output, *, yes: bool, **options) -> None:
    """Run or continue a sweep in a folder; if members fail, the others are saved and the exit code is 1.

    Options are those of `run_with_progress`.
    """
    from ..runs.sweep import run as sweep_run
    from ..runs.sweep.definition import sweep

    chosen = sweep(**tables)

    def confirm() -> bool:
        if yes:
            return True
        if not sys.stdin.isatty() or output.as_json or output.quiet:
            raise ValueError(f"the sweep has {chosen.count} members and there is no terminal to confirm: add --yes")
        return typer.confirm(f"Run {chosen.count} members?")

    swept = sweep_run.run_with_progress(chosen, out, **spread, confirm=confirm, **options)
    if swept is None:
        return print("nothing was run")
    answer = runs.json_output.describe_sweep(command, out, swept, sweep_run.ranges(swept))
    sentence = sweep_run.failure_summary(swept)
    if sentence and output.as_json:
        raise FailedError(sentence, runs.json_output.to_jsonable(answer))
    finish(lambda: answer, answer["files"], lambda: sweep_run.show(swept), output)
    if sentence:
        raise RuntimeError(sentence)
    return None


def _choose_processes(processes: ProcessOptions, chosen=None) -> dict:
    """Check the options for parallel runs, and return them as arguments of `simulate`."""
    from ..ensemble import reach
    from ..experiments.registry import experiment_of, with_feature

    workers, scheduler, device = processes
    if device is not None:
        from ..core.dynamics.device import open_device

        check_choice("device", device, DEVICES)
        if not chosen or not experiment_of(chosen).device:
            raise ValueError(f"--device is available for single runs of {with_feature(lambda one: one.device)} only")
        open_device(device)
    if scheduler is None:
        return {"workers": workers} | ({"device": device} if device else {})
    if chosen and not experiment_of(chosen).parallel:
        raise ValueError(f"--scheduler requires several runs, but experiment = {chosen.experiment!r} is a single one")
    if workers is not None or device is not None:
        other = "workers" if device is None else "device"
        raise ValueError(f"--{other} and --scheduler exclude each other: a cluster has its own workers")
    reach(scheduler)
    return {"workers": scheduler}


def _with_engine(chosen, engine: EngineOptions):
    """Return the scenario with another engine or number of MPI processes, if given."""
    from ..data.schema import require_lammps_for_ranks
    from ..experiments.registry import with_feature

    given = engine.values()
    if not given:
        return chosen
    if not hasattr(chosen, "engine"):
        able = with_feature(lambda one: "engine" in one.scenario.model_fields)
        raise ValueError(f"--{next(iter(given))} applies to the experiments {able} only, not to {chosen.experiment!r}")
    chosen = chosen.model_copy(update=given)
    require_lammps_for_ranks(chosen.engine, chosen.ranks)
    return chosen
